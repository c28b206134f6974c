"""Where between the inner and the outer body the true one most likely lies.

At a fixed normal angle θ the support function is concave in the height z.  In the slab between two slices it runs above
their chord and below the tangents there, and the outer body's corner is where the extrapolated neighbouring secants meet.
How near to that corner the body comes depends on how the turn of the slope is spread over the slab:

- where the slopes beyond either end do not change, the body is a polyhedron's, and turns in one kink: it reaches the corner;
- where they change steadily, it turns all along, as a parabola does, which passes half way below the tangents' apex;
- between a flat and a curved part it turns in an arc about the apex, as long as the curvature beyond the slab makes it: a
  parabola from tangent to tangent, a quarter of the turn times its half length below the apex.  Where the flat part's slope
  falls a little towards the slab, the arc has begun before.

This is a guess, by the slices on either side, and where it fails the certificate still holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from scan3d.arrays import Array, Index, Mask
from scan3d.reconstruction.slices import Slice, SliceStack
from scan3d.surfaces.tuning import Tuning


class Edges(Enum):
    """What is assumed of the body where it goes on straight on both sides of a slab."""

    NONE = "none"
    """The body is flat between its slices: the surface stays with the hull, but for the caps."""
    SOME = "some"
    """The body is bent, with some edges: the surface goes `Tuning.crease` of the way to the outer corner."""
    SHARP = "sharp"
    """The body is a polyhedron: the surface goes to the outer corner itself."""


def fractions(stack: SliceStack, away: Array, slab: Index, straight: Mask, edges: Edges, tuning: Tuning) -> Array:
    """Fractions (w,) of the way to the outer body's corners, which are `away` (w, 3) from the inner body's nearest points.

    slab (w,) and straight (w, 2) are those of the `Enclosure`.
    """
    if edges is Edges.NONE:
        return np.where((slab == 0) | (slab == len(stack.slices)), tuning.unknown, 0.0)
    across = away @ stack.frame[:2].T
    angle = np.arctan2(across[:, 1], across[:, 0])
    fraction = np.full(len(angle), tuning.unknown)
    creased: Mask = np.asarray(straight.any(axis=1))
    for i in np.unique(slab):
        rows = slab == i
        turn = _turn(stack, int(i), angle[rows], tuning)
        # with slices on one side only, a parabola's fraction; in the caps nothing is known
        one_sided = tuning.unknown if i in (0, len(stack.slices)) else tuning.parabola
        fraction[rows] = (1 - tuning.damping) * turn.fraction(one_sided) + tuning.damping * tuning.unknown
        if edges is Edges.SOME:
            creased[rows] = turn.straight
        elif 0 < i < len(stack.slices):
            # a polyhedron is straight on either side, though three slices may not show it on both, or on any
            fraction[rows] += tuning.unseen_corners * (1 - fraction[rows])
    fraction[creased] = 1.0 if edges is Edges.SHARP else tuning.crease
    return fraction


def contours_between(stack: SliceStack, tuning: Tuning) -> Array:
    """Points (n, 3) in the world on the contours that the body most likely has a third and two thirds up between its slices.

    The outer body's corners are far between where a flat face ends inside a slab; these go all around it.
    """
    found = [np.empty((0, 3))]
    for i in range(1, len(stack.slices)):
        below, above = stack.slices[i - 1], stack.slices[i]
        if not (below.closed and above.closed):
            continue
        before = stack.slices[i - 2] if i > 1 else None
        after = stack.slices[i + 1] if i + 1 < len(stack.slices) else None
        angle = np.concatenate([below.angle, above.angle])
        turn = _turn(stack, i, angle, tuning)
        support = np.stack([slice_.support(angle) for slice_ in (below, above)])
        middle = np.stack([slice_.outline.mean(axis=0) for slice_ in (below, above)])
        for up in (1 / 3, 2 / 3):
            mix = np.array([1 - up, up])
            level = below.height + up * (above.height - below.height)
            most = np.concatenate([_beyond(below, before, level), _beyond(above, after, level)])
            contour = _contour(angle, np.minimum(mix @ support + turn.above_chord(up), most), mix @ middle)
            found.append(np.column_stack([contour, np.full(len(contour), level)]) @ stack.frame)
    return np.concatenate(found)


def _beyond(slice_: Slice, behind: Slice | None, level: float) -> Array:
    """Upper bound (a,) of the support function beyond a slice, at its angles; inf if no slice is behind it."""
    if behind is None:
        return np.full(len(slice_.angle), np.inf)
    normals = np.stack([np.cos(slice_.angle), np.sin(slice_.angle)], axis=1)
    secant = (slice_.value - behind.support_of_contacts(normals)) / (slice_.height - behind.height)
    return slice_.value + secant * (level - slice_.height)


def _contour(angle: Array, height: Array, inside: Array) -> Array:
    """Points (n, 2) where support lines at angles (k,), of heights (k,), touch the contour about the point `inside` (2,)."""
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    room = height - normals @ inside
    if not (room > 0).all():
        return np.empty((0, 2))
    try:
        edges = ConvexHull(normals / room[:, None]).equations
    except QhullError:  # too thin for Qhull, and then the slices say enough
        return np.empty((0, 2))
    corners = inside - edges[:, :2] / edges[:, 2:]
    corners = corners[np.argsort(np.arctan2(*(corners - inside).T))]
    # the contours_between of its sides: a corner of two support lines may be none of the body's
    return (corners + np.roll(corners, -1, axis=0)) / 2


@dataclass(frozen=True)
class _Turn:
    """How the slope of the support function turns in a slab, at angles (n,); NaN where there are too few slices."""

    step: float
    """The slab's thickness."""
    rise: Array
    """Slope at the lower end, less that of the chord."""
    fall: Array
    """Slope of the chord, less that at the upper end."""
    most: Array
    """Height above the chord of the certain secants' apex, in steps."""
    arc: Array
    """Half the length of the arc about the tangents' apex, in steps."""
    straight: Mask
    """Whether the body goes on straight beyond either end."""

    def fraction(self, unknown: float) -> Array:
        """Height above the chord at the tangents' apex, in that of the secants' apex, or `unknown`."""
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = self.rise + self.fall
            found = (self.rise * self.fall / turn - turn * self.arc / 4) / self.most
        return np.where(np.isfinite(found), np.clip(found, 0.0, 1.0), unknown)

    def above_chord(self, up: float) -> Array:
        """Height above the chord at a share of the way up; where it is known from one side only, that of a parabola."""
        rise, fall = np.fmax(self.rise, 0.0), np.fmax(self.fall, 0.0)
        rise, fall = np.where(np.isnan(self.rise), fall, rise), np.where(np.isnan(self.fall), rise, fall)
        turn, arc = rise + fall, np.where(np.isnan(self.arc), 0.5, self.arc)
        with np.errstate(divide="ignore", invalid="ignore"):
            inside = np.maximum(arc - np.abs(up - fall / turn), 0.0)
            height = np.minimum(up * rise, (1 - up) * fall) - np.where(inside > 0, turn * inside**2 / (4 * arc), 0.0)
        return self.step * np.fmax(height, 0.0)


def _turn(stack: SliceStack, i: int, angle: Array, tuning: Tuning) -> _Turn:
    """The turn in the slab below slice i, at angles (n,)."""
    nothing = np.full(len(angle), np.nan)

    def slice_(j: int) -> tuple[float, Array]:
        usable = 0 <= j < len(stack.slices) and stack.slices[j].closed
        return (stack.slices[j].height, stack.slices[j].support(angle)) if usable else (np.nan, nothing)

    # three slices on either side; steps and secants 0 1 | 2 | 3 4, with the slab's own in the middle
    z, h = zip(*(slice_(j) for j in range(i - 3, i + 3)), strict=True)
    step = np.diff(np.array(z))
    secant = [(above - below) / width for below, above, width in zip(h[:-1], h[1:], step, strict=True)]
    below = _End(secant[0] - secant[2], secant[1] - secant[2], step[1], step[2], tuning.straight)
    above = _End(secant[2] - secant[4], secant[2] - secant[3], step[3], step[2], tuning.straight)
    bend = np.fmax(below.bend(), above.bend())
    rise, fall = below.turn(bend), above.turn(bend)
    with np.errstate(divide="ignore", invalid="ignore"):
        # the arc fits in on both sides of the apex, and is no longer than so much bending makes the turn
        fits = np.minimum(rise, fall) / (rise + fall)
        arc = fits * np.minimum(1.0, 2 * bend * fits * step[2] / (rise + fall))
        most = below.near * above.near / (below.near + above.near)
    return _Turn(float(step[2]), rise, fall, most, arc, below.flat & above.flat)


@dataclass(frozen=True)
class _End:
    """One end of a slab: how far the slopes of the two secants beyond it are from that of the slab's chord, at angles (n,)."""

    far: Array
    near: Array
    near_step: float
    step: float
    """The slab's thickness."""
    tolerance: float
    """Slopes that differ by less than this fraction of `near` are equal."""

    @property
    def flat(self) -> Mask:
        return np.abs(self.far - self.near) <= self.tolerance * np.abs(self.near)

    def bend(self) -> Array:
        """The slope's change with height around the end, 0 if it is flat."""
        return np.where(self.flat, 0.0, 2 * self.near / (self.near_step + self.step))

    def turn(self, bend: Array) -> Array:
        """How far the slope at the end itself is from the chord's: that of the parabola through three slices, if not flat.

        From a flat part on, the slope changes as beyond the other end, by `bend` with height: from where that makes the near
        secant of the far one, but by no more than from the middle of the slab on.
        """
        parabola = self.near * self.step / (self.near_step + self.step)
        with np.errstate(divide="ignore", invalid="ignore"):
            begun = np.minimum(np.sqrt(2 * np.abs(self.far - self.near) * self.near_step / bend), self.near_step)
        flat = np.minimum(self.near, np.maximum(self.far - bend * begun, bend * self.step / 2))
        return np.where(self.flat, np.where(bend > 0, flat, self.near), parabola)
