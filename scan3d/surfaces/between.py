"""An estimate of where the true surface lies between the inner and the outer body.

Notation.  At a fixed angle θ of the in-plane normal, the support function h(θ, z) is concave in the height z.  A slab of
thickness d lies between two slices, and its *chord* is the straight line between the values of h at the two.  Let σ be the
slope of the chord, and let the slope ∂h/∂z be σ + ρ at the lower and σ - φ at the upper end.  By concavity, ρ and φ are not
negative.  The sum τ = ρ + φ is the *turn* of the slope in the slab.

Between the slices, h runs above the chord and below the tangents at its ends, which meet at the *tangents' apex*, φ/τ of the
thickness above the lower slice and d ρφ/τ above the chord.  The slopes are not measured.  What is certain is only that h stays
below the neighbouring secants, which join each slice to the one behind it: extrapolated into the slab, they meet at the
*secants' apex*, a corner of the outer body.  How close to that corner the true surface comes depends on how the turn is
distributed over the slab:

- If the slopes behind both ends are constant, the body is taken for a polyhedron, whose turn is concentrated in a crease. The
  surface reaches the corner.
- If they change steadily, the turn is taken to be distributed evenly.  Then h is a parabola, which passes d τ/8 above the chord
  at mid-height, half as high as the tangents' apex.
- If the slope is constant behind one end only, the body is taken to go over from a straight part into an arc about the
  tangents' apex, with the curvature found behind the other end.  The arc is a parabola from tangent to tangent, and passes
  d τl/4 below the apex, where 2l is the length of the arc relative to d.  If the slope of the straight part falls slightly
  towards the slab, the arc has begun before the slice.

In the cells between slices along several axes the estimate is a fraction of the way from the hull to the corners.  Of a
polyhedron the surface reaches them; of a body that is bent evenly it passes at a quarter of the way, as a parabola does.  Which
fraction predicts held-out slices best is tried.

The estimate rests on assumptions about the body.  The certificate does not: it holds whether or not the estimate is good.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from scan3d.arrays import Array, Index, Mask
from scan3d.bounds.cells import applicable, cells_of_cloud
from scan3d.cloud import Cloud
from scan3d.geometry.hulls import hull
from scan3d.reconstruction.slices import Slice, SliceStack, stacks

FRACTIONS = (0.25, 0.4, 0.7, 1.0)
"""Fractions of the way from the hull of the contacts to the corners."""
# Gaps, over the size of the body, that are left out.
_LEAST = 1e-7
# Where between two slices contours are estimated, as fractions of the slab's thickness.
_CONTOUR_FRACTIONS = (1 / 3, 2 / 3)
# Every second point of an estimated contour is left out that is nearer to the chord of its neighbours than this fraction of the
# widest slice: contours have the angles of two slices.
_SAGITTA = 2e-5


@dataclass(frozen=True)
class Tuning:
    """Numbers of the estimate between the bounds; a fraction is 0 at the inner body and 1 at an outer corner.

    None of them affects the enclosure.  ``tests/benchmarks/tuning.py`` prints the error over each of them.
    """

    unknown: float = 0.5
    """Fraction in the caps and where slices lack normals: the error is at most half the gap."""
    damping: float = 0.6
    """Weight by which every estimated fraction is drawn towards `unknown`, unless the body is bent everywhere: where the
    estimate is wrong, as where facets end within two slices of each other, the error is smaller."""
    unseen_corners: float = 0.3
    """Fraction of the remaining distance to the corner that is added for a polyhedron where too few slices show its planes."""
    straight: float = 0.03
    """Slopes beyond a slab are equal if they differ by less than this fraction of their difference to the slab's."""
    parabola: float = 0.25
    """Height of an evenly sliced parabola above the chord, relative to that of the secants' apex: used where slices on one
    side only are known.  It follows from the geometry of a parabola."""
    crease: float = 0.7
    """Fraction where a curved body with some edges goes on straight on both sides of a slab."""
    sharp_advantage: float = 0.9
    """Sharp edges are chosen only if their error at held-out slices is below this many times that of bent ones."""
    round_advantage: float = 0.95
    """As `sharp_advantage`, for a body that is bent everywhere."""
    flat_advantage: float = 0.8
    """As `sharp_advantage`, for a body that is flat between its slices, which is the hull but for the caps."""
    fit_gain: float = 0.65
    """The fitted body is chosen if its error at held-out slices is below this many times that of the estimate between the
    bounds.  With all slices the error of the estimate falls to about two thirds, that of the fit stays."""
    fit_close: float = 0.1
    """The fitted body of exact contacts is chosen, and no estimate between the bounds is made, if its error at held-out slices
    is below this fraction of the hull's bound.  Of smooth bodies the best estimate has errors of 0.16 to 0.57 of the bound."""
    proven: float = 1e-4
    """A hull with a bound this small, relative to the diagonal, is taken as it is."""


class Edges(Enum):
    """What is assumed of the body where it goes on straight on both sides of a slab."""

    NONE = "none"
    """The body is flat between its slices: the surface is that of the hull, except in the caps."""
    SOME = "some"
    """The body is curved, with some edges: the surface lies at the fraction `Tuning.crease` of the distance to the corner."""
    ROUND = "round"
    """The body is curved everywhere: as `SOME`, but the estimated fractions are not drawn towards `Tuning.unknown`."""
    SHARP = "sharp"
    """The body is a polyhedron: the surface reaches the outer corner."""


def fractions(
    stack: SliceStack, away: Array, slab: Index, straight: Mask, assumed: Sequence[Edges], tuning: Tuning
) -> list[Array]:
    """Estimated distances (w,) of the surface from the inner body, as fractions of the distances to the outer body's corners,
    by each of the assumptions on the edges.

    away
        (w, 3) vectors from the inner body's nearest points to the corners.
    slab, straight
        (w,) and (w, 2), the corners' as in the `Enclosure`.
    """
    in_cap = (slab == 0) | (slab == len(stack.slices))
    flat = np.where(in_cap, tuning.unknown, 0.0)
    if all(edges is Edges.NONE for edges in assumed):
        return [flat for _ in assumed]
    across = away @ stack.frame[:2].T
    angle = np.arctan2(across[:, 1], across[:, 0])
    known, turn_is_straight = np.full(len(angle), tuning.unknown), np.zeros(len(angle), dtype=bool)
    for i in np.unique(slab):
        rows = slab == i
        turn = _turn(stack, int(i), angle[rows], tuning)
        # where slices on one side only are known, the fraction of a parabola; in the caps nothing is known
        one_sided = tuning.unknown if i in (0, len(stack.slices)) else tuning.parabola
        known[rows], turn_is_straight[rows] = turn.fraction(one_sided), turn.straight

    def by(edges: Edges) -> Array:
        if edges is Edges.NONE:
            return flat
        damping = 0.0 if edges is Edges.ROUND else tuning.damping
        fraction = (1 - damping) * known + damping * tuning.unknown
        if edges is Edges.SHARP:
            # a polyhedron is straight on both sides, even where too few slices show it
            fraction = np.where(in_cap, fraction, fraction + tuning.unseen_corners * (1 - fraction))
            return np.where(straight.any(axis=1), 1.0, fraction)
        return np.where(turn_is_straight, tuning.crease, fraction)

    return [by(edges) for edges in assumed]


def contours_between(stack: SliceStack, tuning: Tuning) -> Array:
    """Points (n, 3) in the world on estimated contours of the body, at one and two thirds of the height between its slices.

    Where a flat face ends inside a slab, the outer body has few corners; the contours go all around the body.
    """
    contours = [np.empty((0, 3))]
    size = max(float(np.ptp(slice_.points, axis=0).max()) for slice_ in stack.slices)
    for i in range(1, len(stack.slices)):
        below, above = stack.slices[i - 1], stack.slices[i]
        if not all(slice_.closed and len(slice_.outline) for slice_ in (below, above)):
            continue
        before = stack.slices[i - 2] if i > 1 else None
        after = stack.slices[i + 1] if i + 1 < len(stack.slices) else None
        angle = np.concatenate([below.angle, above.angle])
        turn = _turn(stack, i, angle, tuning)
        support = stack.supports(angle, i - 1, i + 1)
        middle = np.stack([slice_.outline.mean(axis=0) for slice_ in (below, above)])
        for up in _CONTOUR_FRACTIONS:
            mix = np.array([1 - up, up])
            level = below.height + up * (above.height - below.height)
            upper = np.concatenate([_extrapolated(below, before, level), _extrapolated(above, after, level)])
            contour = _contour(angle, np.minimum(mix @ support + turn.above_chord(up), upper), mix @ middle)
            contour = _thinned(contour, _SAGITTA * size)
            contours.append(np.column_stack([contour, np.full(len(contour), level)]) @ stack.frame)
    return np.concatenate(contours)


def _extrapolated(slice_: Slice, behind: Slice | None, level: float) -> Array:
    """Upper bound (a,) of the support function at a height, at a slice's angles: the secant from the slice behind it.

    Infinite if there is no slice behind it.
    """
    if behind is None:
        return np.full(len(slice_.angle), np.inf)
    normals = np.stack([np.cos(slice_.angle), np.sin(slice_.angle)], axis=1)
    secant = (slice_.value - behind.support_of_contacts(normals)) / (slice_.height - behind.height)
    value: Array = slice_.value + secant * (level - slice_.height)
    return value


def _contour(angle: Array, support: Array, inside: Array) -> Array:
    """Middles (n, 2) of the sides of the polygon about `inside` (2,) that support lines bound; no points if they do not.

    The lines have their normals at the angles (k,) and the values (k,) of the support function.
    """
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    distance = support - normals @ inside
    if not (distance > 0).all():
        return np.empty((0, 2))
    try:
        # the polygon's corners are the edges of the dual polygon
        edges = ConvexHull(normals / distance[:, None]).equations
    except QhullError:  # too thin for Qhull; the slices alone then determine the surface closely enough
        return np.empty((0, 2))
    corners = inside - edges[:, :2] / edges[:, 2:]
    corners = corners[np.argsort(np.arctan2(*(corners - inside).T))]
    # the middles of the sides, since a corner of two support lines need not belong to the body
    middles: Array = (corners + np.roll(corners, -1, axis=0)) / 2
    return middles


def _thinned(points: Array, limit: float) -> Array:
    """The points (n, 2) around a contour, without every second one nearer than a limit to the chord of its neighbours."""
    odd = np.arange(1, len(points), 2)
    before, after = points[odd - 1], points[(odd + 1) % len(points)]
    chord, way = after - before, points[odd] - before
    off = np.abs(chord[:, 0] * way[:, 1] - chord[:, 1] * way[:, 0])
    kept: Array = np.delete(points, odd[off < limit * np.linalg.norm(chord, axis=1)], axis=0)
    return kept


@dataclass(frozen=True)
class _Turn:
    """How the slope ∂h/∂z turns in a slab, at angles (n,) of the normal; NaN where there are too few slices.

    The symbols are those of the module's docstring.  Distances in z are in units of the thickness d.
    """

    thickness: float
    """d"""
    rise: Array
    """ρ, the slope at the lower end less that of the chord."""
    fall: Array
    """φ, the slope of the chord less that at the upper end."""
    secant_apex: Array
    """Height of the secants' apex above the chord, divided by d."""
    half_arc: Array
    """l, half the length of the arc about the tangents' apex, divided by d."""
    straight: Mask
    """Whether the body goes on straight behind both ends."""

    def fraction(self, unknown: float) -> Array:
        """Height of h above the chord at the tangents' apex, divided by that of the secants' apex; `unknown` if not known.

        That is ``(ρφ/τ - τl/4) / secant_apex``, clipped to the interval from 0 to 1.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = self.rise + self.fall
            fraction = (self.rise * self.fall / turn - turn * self.half_arc / 4) / self.secant_apex
        return np.where(np.isfinite(fraction), np.clip(fraction, 0.0, 1.0), unknown)

    def above_chord(self, up: float) -> Array:
        """Height (n,) of h above the chord at the fraction `up` of the thickness, u.

        It follows the lower of the two tangents, ``d min(uρ, (1 - u)φ)``, and the arc within l of the apex at ``u = φ/τ``:
        there it lies ``d τ (l - |u - φ/τ|)² / (4l)`` below the tangents.  Where the slope is known at one end only, it is
        taken to be the same at the other, and the arc to fill the slab.
        """
        rise, fall = np.fmax(self.rise, 0.0), np.fmax(self.fall, 0.0)
        rise, fall = np.where(np.isnan(self.rise), fall, rise), np.where(np.isnan(self.fall), rise, fall)
        turn, arc = rise + fall, np.where(np.isnan(self.half_arc), 0.5, self.half_arc)
        with np.errstate(divide="ignore", invalid="ignore"):
            inside = np.maximum(arc - np.abs(up - fall / turn), 0.0)
            height = np.minimum(up * rise, (1 - up) * fall) - np.where(inside > 0, turn * inside**2 / (4 * arc), 0.0)
        above: Array = self.thickness * np.fmax(height, 0.0)
        return above


def _turn(stack: SliceStack, i: int, angle: Array, tuning: Tuning) -> _Turn:
    """The turn in the slab below slice i, at angles (n,)."""
    # three slices on either side; of the five slabs between them, with their thicknesses and secants, number 2 is this one
    h = stack.supports(angle, i - 3, i + 3)
    z = [
        stack.heights[j] if 0 <= j < len(stack.slices) and stack.slices[j].closed else np.nan
        for j in range(i - 3, i + 3)
    ]
    thickness = np.diff(np.array(z))
    secant = np.diff(h, axis=0) / thickness[:, None]
    below = _End(secant[0] - secant[2], secant[1] - secant[2], thickness[1], thickness[2], tuning.straight)
    above = _End(secant[2] - secant[4], secant[2] - secant[3], thickness[3], thickness[2], tuning.straight)
    curvature = np.fmax(below.curvature(), above.curvature())
    rise, fall = below.slope(curvature), above.slope(curvature)
    with np.errstate(divide="ignore", invalid="ignore"):
        # The arc reaches at most to the nearer end.  If over that length the curvature turned the slope by less than τ, the
        # arc is shortened in proportion: the body turns more sharply.
        to_end = np.minimum(rise, fall) / (rise + fall)
        half_arc = to_end * np.minimum(1.0, 2 * curvature * to_end * thickness[2] / (rise + fall))
        secant_apex = below.near * above.near / (below.near + above.near)
    return _Turn(float(thickness[2]), rise, fall, secant_apex, half_arc, below.straight & above.straight)


@dataclass(frozen=True)
class _End:
    """One end of a slab, and the two slabs behind it, at angles (n,).

    Let ν be the difference between the slopes of the chord and of the secant in the first slab behind the end, and η that in
    the second, with signs such that both are positive for a concave function.  Let d' be the thickness of the first.
    """

    far: Array
    """η"""
    near: Array
    """ν"""
    near_thickness: float
    """d'"""
    thickness: float
    """d, the thickness of the slab itself."""
    tolerance: float
    """The body is straight behind the end if η and ν differ by no more than this fraction of ν."""

    @property
    def straight(self) -> Mask:
        """(n,) whether the body goes on straight behind the end."""
        equal: Mask = np.abs(self.far - self.near) <= self.tolerance * np.abs(self.near)
        return equal

    def curvature(self) -> Array:
        """The change κ of the slope with height around the end, ``κ = 2ν / (d + d')``; 0 if the body is straight there."""
        return np.where(self.straight, 0.0, 2 * self.near / (self.near_thickness + self.thickness))

    def slope(self, curvature: Array) -> Array:
        """Slope at the end itself, as its difference from that of the chord: ρ at the lower end and φ at the upper one.

        If the body is not straight behind the end, it is that of the parabola through the three slices: ``ν d / (d + d')``.

        If it is, the slope remains that of the far secant up to where the arc begins and then changes by κ, the curvature
        found behind the other end.  An arc that begins a height b before the end lowers the near secant's slope by
        ``η - ν = κb² / (2d')``, which gives b, at most d', and the slope ``η - κb``.  It is neither above ν nor below κd/2, the
        value for an arc that fills the slab.  If κ is 0, the slope is ν.
        """
        parabola = self.near * self.thickness / (self.near_thickness + self.thickness)
        with np.errstate(divide="ignore", invalid="ignore"):
            before = np.sqrt(2 * np.abs(self.far - self.near) * self.near_thickness / curvature)
            before = np.minimum(before, self.near_thickness)
        arc = np.minimum(self.near, np.maximum(self.far - curvature * before, curvature * self.thickness / 2))
        return np.where(self.straight, np.where(curvature > 0, arc, self.near), parabola)


def has_cells(cloud: Cloud) -> bool:
    """Whether a cloud has `between_cells`; a part of its slices may have them where all are too many."""
    return applicable(cloud, stacks(cloud))


def between_cells(cloud: Cloud, tried: Iterable[float] = FRACTIONS) -> Iterator[tuple[float, Any]]:
    """Fractions and their estimates; none unless the contacts are exact and in slices along several axes."""
    by_axis = stacks(cloud)
    if not applicable(cloud, by_axis):
        return
    inner = hull(cloud.points)
    found = cells_of_cloud(cloud, by_axis, inner)
    size = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    rows = np.isfinite(found.gap) & (found.gap > _LEAST * size)
    away = found.corners[rows] - found.foot[rows]
    for fraction in tried:
        yield fraction, hull(np.concatenate([cloud.points, found.foot[rows] + fraction * away]))
