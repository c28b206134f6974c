"""The numbers by which a surface is estimated between the inner and the outer body.

None of them affects the certificate's enclosure.  ``tests/benchmarks/tuning.py`` prints the error over each of them.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Numbers of the estimate between the bounds; a fraction is 0 at the inner body and 1 at an outer corner."""

    unknown: float = 0.5
    """Fraction in the caps and where slices lack normals: at one half, the error is at most half the gap.  Larger, the surface
    is too far out for round bodies; smaller, too far in for bodies with edges."""
    damping: float = 0.6
    """Weight by which every estimated fraction is drawn towards `unknown`, unless it is bent everywhere.  Larger, the error
    is smaller where the estimate is wrong, for example where facets end within two slices of each other, and larger where it is
    right."""
    unseen_corners: float = 0.3
    """Fraction of the remaining distance to the corner that is added for a polyhedron where too few slices show its planes.
    Larger, the surface is too far out where it is a plane; smaller, too far in where it has a corner."""
    straight: float = 0.03
    """Slopes beyond a slab are equal if they differ by less than this fraction of their difference to the slab's.  Larger,
    gentle curvature counts as straight; smaller, noise makes facets count as curved."""
    parabola: float = 0.25
    """Height of an evenly sliced parabola above the chord, relative to that of the secants' apex: used where slices on one
    side only are known.  It follows from the geometry of a parabola.  Larger suits bodies with edges, smaller suits bodies
    that are straight between their slices."""
    crease: float = 0.7
    """Fraction where a curved body with some edges goes on straight on both sides of a slab.  Larger, true edges are sharper,
    up to 1; smaller, the error is smaller where there is no edge."""
    sharp_advantage: float = 0.9
    """Sharp edges are chosen only if their error at held-out slices is below this many times that of bent ones.  Larger, they
    are chosen in a tie as well, where they have the larger error if wrong; smaller, some polyhedra are not recognised."""
    round_advantage: float = 0.95
    """As `sharp_advantage`, for a body that is bent everywhere.  Larger, it is chosen for bodies whose edges fall between the
    slices; smaller, the surfaces of smooth bodies lie too far out."""
    flat_advantage: float = 0.8
    """As `sharp_advantage`, for a body that is flat between its slices, which is the hull but for the caps.  Larger, the hull
    is taken for bodies of which one held-out contact lies far from the estimate; smaller, flat bodies get ridges."""
    fit_gain: float = 0.65
    """The fitted body is chosen if its error at held-out slices is below this many times that of the estimate between the
    bounds.  With all slices the error of the estimate falls to about two thirds, that of the fit stays.  Larger, the fit is
    chosen where the estimate would be better; smaller, the reverse."""
    fit_close: float = 0.1
    """The fitted body of exact contacts is chosen, and no estimate between the bounds is made, if its error at held-out slices
    is below this fraction of the hull's bound.  Of smooth bodies the best estimate has errors of 0.16 to 0.57 of the bound.
    Larger, the fit is chosen where an estimate would be better; smaller, scans of smooth bodies take longer."""
    proven: float = 1e-4
    """A hull with a bound this small, relative to the diagonal, is taken as it is.  Larger, estimates that are closer than the
    hull are not made; smaller, time is spent on improvements that cannot be seen."""
