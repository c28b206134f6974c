"""The numbers by which a surface is estimated between the inner and the outer body.

None of them touches the certificate.  ``tests/benchmarks/tuning.py`` prints the error over each of them.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Numbers of the estimate between the bounds; fractions are of the way from the inner body to an outer corner."""

    unknown: float = 0.5
    """Fraction in the caps and where slices lack normals: half way, the error is at most half the gap."""
    damping: float = 0.6
    """Weight by which every estimated fraction is drawn towards `unknown`.  Larger, the error is smaller where the estimate
    is wrong, as where facets end within two slices of each other, and larger where it is right."""
    unseen_corners: float = 0.3
    """How much nearer than estimated a polyhedron's corners are to the outer body's, where too few slices show its planes."""
    straight: float = 0.03
    """Slopes beyond a slab are equal if they differ by less than this fraction of their difference to the slab's.  Larger,
    gentle curvature counts as straight; smaller, noise makes facets count as curved."""
    parabola: float = 0.25
    """Height of an evenly sliced parabola above the chord, relative to that of the secants' apex: used where slices on one
    side only are known.  Follows from the geometry of a parabola; other bodies differ."""
    crease: float = 0.7
    """Fraction where a body that is bent, with some edges, goes on straight on both sides of a slab; 1 would be an edge in
    every such place."""
    sharp_advantage: float = 0.9
    """Sharp edges are chosen only if they predict held-out slices with an error this many times that of bent ones: in a tie
    sharp edges err more."""
    fit_gain: float = 0.5
    """The fitted body is chosen if its error at held-out slices is below this many times that of the estimate between the
    bounds, whose error falls to about half with all slices, where the fit's stays."""
    proven: float = 5e-5
    """A hull certified this closely, relative to the diagonal, is taken as it is: no estimate can improve on it visibly."""
