"""The outer body, slab by slab: what the half-spaces of the slices leave between two neighbouring heights.

At a fixed normal angle θ a slice's support function is concave in the height z, so that beyond a slice it stays below the
extrapolated secant from the slice behind it,

    <n, p> <= h + σ (z - z_i),        σ = (h - h_before) / (z_i - z_before),

with h exact at the contact, and with the support function of the contacts as a lower bound of ``h_before``.  Between two
slices this holds from both sides; beyond an end slice it holds from one side, up to the height of the nearest empty slice.
The half-spaces cut each slab to a polyhedron, as does the table on which the body stands, if it is known.  Where
contacts are noisy, the half-spaces are moved outwards by a margin.

Where heights are uncertain by e, which may differ from contact to contact, the secants rise over
``z_i - z_before ± 2e``, whichever is less steep towards the slab's outside, and each slab reaches e beyond its planes.
Let s be the true slope of a half-space that begins at ``z_i + d``, with d between -e and e.  Within the slab it is
exceeded by at most e times the steeper of the secants from behind and from ahead, between which s lies; the half-spaces
are moved outwards by this.  Past an end slice, and where all slices ahead are nearer than 4e, no secant from ahead
is known, but there the slab before reaches to ``z_i + e``, beyond which the half-space holds.

The half-spaces hold beyond the next slices as well.  With exact contacts those of the nearest slice are the tightest; where
contacts are uncertain, a slab is also bounded by those of slices farther away, so that a slice that is known poorly, as
one near the end of a body, does not widen the outer body.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from scan3d.arrays import NEGLIGIBLE, ROUNDING, Array, Index, Mask
from scan3d.geometry.distance import locator
from scan3d.geometry.polytopes import half_space_intersection, volume_about
from scan3d.geometry.triangles import distance_to, dot, longest_first
from scan3d.reconstruction.slices import Slice, SliceStack

# Errors of heights that two slices lie apart at least for a secant between them; at 2 its slope is infinite.
_APART = 4.0
# Slices on each side of a slab that bound it where they are uncertain: the nearest may have few contacts, or light ones.
_ANCHORS = 4
# Corners farther than this many widths of the slices belong to half-spaces that do not close but for rounding.
_FAR = 1e6
# Slopes behind a slab are equal if they differ by less than this fraction of their difference to the slab's.
_STRAIGHT = 0.03
# Where between its two planes a point inside a slab past an end slice is sought, as fractions of the thickness from the
# slice: the middle is best conditioned, and a pointed cap leaves room near the slice only.
_INNER_FRACTIONS = (0.5, 0.1, 1e-2, 1e-3, 1e-5, 1e-8)
# A point is nearest to a face if its distance from the face is that from the face's plane, but for rounding.
_ROUNDING_OF_DISTANCE = 1e-14
# Corners times faces up to which the corners are held against the planes of all faces, whose time grows with their product.
_FEW = 1_000_000


class Gap(IntEnum):
    """The cause of a part of the uncertainty."""

    SLICES = 0
    """The body between two slices."""
    CONTACTS = 1
    """A slice's contour between two contacts."""
    CAPS = 2
    """The body past its end slices."""


class Slab(NamedTuple):
    """The outer body between two heights."""

    corners: Array
    """(w, 3) in the world; one infinite corner if nothing bounds the slab."""
    kind: NDArray[np.int8]
    """(w,) of `Gap`."""
    straight: Mask
    """(w, 2) whether the body goes on straight, below and above the slab, at all the corner's half-spaces from that side."""
    volume: float
    """Infinite if nothing bounds the slab; NaN if it was not wanted."""


SlabKey = tuple[float, ...]
"""Heights of the slices that a slab depends on, and their numbers of contacts."""


class _HalfSpaces(NamedTuple):
    """The half-spaces ``a·x + b <= 0`` whose intersection is a slab; the last two are the slab's planes, above and below."""

    planes: Array
    """(k, 4) a and b."""
    side: Array
    """(k,) 0 for those from the slices below, 1 for those from above, -1 for the slab's planes and the table's."""
    straight: Mask
    """(k,) whether the body goes on straight behind the slab at this normal."""


def slabs(
    stack: SliceStack, margin: float = 0.0, known: dict[SlabKey, Slab] | None = None, *, volumes: bool = True
) -> list[Slab]:
    """The slabs of a stack from below; those in `known`, by key, are not computed again, and new ones are added to it.

    Without `volumes` those of bounded slabs are NaN.
    """
    known = {} if known is None else known
    keys = slab_keys(stack)
    missing = [i for i, key in enumerate(keys) if key not in known]
    known.update((keys[i], _slab(stack, i, margin, volumes=volumes)) for i in missing)
    return [known[key] for key in keys]


def slab_keys(stack: SliceStack) -> list[SlabKey]:
    """What each slab depends on: three slices, or ends of the body, on either side, and how many contacts they have."""
    heights = [-np.inf, -np.inf, stack.floor, *map(float, stack.heights), stack.ceiling, np.inf, np.inf]
    contacts = [0, 0, 0, *(len(slice_.rows) for slice_ in stack.slices), 0, 0, 0]
    return [(*heights[i : i + 6], *contacts[i : i + 6]) for i in range(len(stack.slices) + 1)]


def _slab(stack: SliceStack, i: int, margin: float, *, volumes: bool) -> Slab:
    """The slab below slice i."""
    slices, count = stack.slices, len(stack.slices)
    below, above = (slices[i - 1] if i else None), (slices[i] if i < count else None)
    low = below.height if below else stack.floor
    high = above.height if above else stack.ceiling
    inner_kind = Gap.CAPS if below is None or above is None else Gap.SLICES
    unbounded = Slab(
        np.full((1, 3), np.inf), np.array([inner_kind], dtype=np.int8), np.zeros((1, 2), dtype=bool), np.inf
    )
    if not (np.isfinite(low) and np.isfinite(high)):
        return unbounded
    low, high = low - stack.height_error, high + stack.height_error
    if high <= low:
        return Slab(np.empty((0, 3)), np.empty(0, dtype=np.int8), np.empty((0, 2), dtype=bool), 0.0)
    half_spaces = _half_spaces_of_slab(stack, i, low, high, margin)
    inside = _inner_point(below, above, low, high, half_spaces.planes[:-2])
    if inside is None:
        return unbounded
    thickness = high - low
    size = np.array([max(float(np.ptp(slice_.points)) for slice_ in (below, above) if slice_)] * 2 + [thickness])
    intersection = _intersection(half_spaces.planes, inside, size, with_volume=volumes)
    if intersection is None:
        return unbounded
    corners, facets, volume = intersection
    # corners in the plane of a slice: of one whose half-spaces bound it there, or of an end slice, where the body is narrower
    on_low, on_high = (np.abs(corners[:, 2] - z) <= NEGLIGIBLE * thickness for z in (low, high))
    in_plane = (on_low & (i >= 2)) | (on_high & (above is not None) & (i + 1 < count))
    on_end = (on_low & (i == 1)) | (on_high & (above is not None) & (i + 1 == count))
    kind = np.where(in_plane, Gap.CONTACTS, inner_kind).astype(np.int8)
    one_sided = above is None or below is None
    _, side, goes_on = half_spaces
    straight = _corners_are_straight(facets, side, goes_on, one_sided)
    return Slab(corners @ stack.frame, kind, straight & ~on_end[:, None], volume)


def _half_spaces_of_slab(stack: SliceStack, i: int, low: float, high: float, margin: float) -> _HalfSpaces:
    """The half-spaces of the slab below slice i, between the heights `low` and `high`."""
    slices, count = stack.slices, len(stack.slices)
    below, above = (slices[i - 1] if i else None), (slices[i] if i < count else None)
    planes, side, straight = [np.empty((0, 4))], [np.empty(0)], [np.empty(0, dtype=bool)]
    for behind, ahead, number in ((slices[:i][::-1], slices[i:], 0.0), (slices[i:], slices[:i][::-1], 1.0)):
        for k in range(min(len(behind), _anchors(stack))):
            # from slice k behind the slab; between it and the slab lie k others
            secants_from = _secants_from(stack, behind[k + 1 :], behind[k])
            if secants_from:
                ahead_from = _secants_from(stack, behind[:k][::-1] + ahead, behind[k])
                planes.append(_half_spaces(behind[k], secants_from, margin, stack.height_error, ahead_from))
                side.append(np.full(len(planes[-1]), number))
                nearest = _goes_on_straight(behind, ahead[0] if ahead else None)
                straight.append(nearest if k == 0 else np.zeros(len(planes[-1]), dtype=bool))
    if stack.table is not None:
        planes.append(stack.table[None])
        side.append(np.array([-1.0]))
        straight.append(np.zeros(1, dtype=bool))
    # where an empty slice bounds the cap, the corner in its plane does not follow from the body's shape: not straight
    ends = [stack.bounded_by_others[1] and above is None, stack.bounded_by_others[0] and below is None]
    return _HalfSpaces(
        np.concatenate([*planes, [[0.0, 0.0, 1.0, -high], [0.0, 0.0, -1.0, low]]]),
        np.concatenate([*side, [-1.0, -1.0]]),
        np.concatenate([*straight, ends]),
    )


def _anchors(stack: SliceStack) -> int:
    """Slices on each side of a slab whose support lines bound it.

    If everything is exact, by concavity those of the nearest do so most tightly.
    """
    return _ANCHORS if stack.confident or stack.height_error else 1


def _secants_from(stack: SliceStack, behind: tuple[Slice, ...], slice_: Slice) -> tuple[Slice, ...]:
    """Those of the slices behind a slab's slice, from the nearest, that secants are taken from.

    If everything is exact, by concavity the nearest has the tightest.
    """
    if not (stack.confident or stack.height_error):
        return behind[:1]
    return tuple(b for b in behind if abs(b.height - slice_.height) > _APART * stack.height_error)


def _half_spaces(
    slice_: Slice,
    behind: tuple[Slice, ...],
    margin: float,
    height_error: float = 0.0,
    ahead: tuple[Slice, ...] = (),
) -> Array:
    """Rows (k, 4) a and b of ``a·x + b <= 0``: the slice's support lines, inclined along the tightest secant from behind.

    ahead
        the slices on the slab's side that secants are taken from; without any the slice counts as an end slice.
    """
    normals = np.stack([np.cos(slice_.angle), np.sin(slice_.angle)], axis=1)
    secant = secants(slice_.value, slice_.height, behind, normals, margin, height_error)
    value = slice_.value + margin
    if height_error:
        steepest = np.abs(secant)
        if ahead:
            from_ahead = secants(slice_.value, slice_.height, ahead, normals, margin, height_error)
            steepest = np.maximum(steepest, np.abs(from_ahead))
        value = value + height_error * steepest
    return np.column_stack([normals, -secant, secant * slice_.height - value])


def secants(
    value: Array, height: float, others: tuple[Slice, ...], normals: Array, margin: float, height_error: float
) -> Array:
    """The tightest slopes (k,) of secants from support lines at a height to other slices on one side of it.

    The lines have the unit normals (k, 2) and the values (k,).  Those to slices below bound the slope from above, those to
    slices above from below; they are infinite where the errors of heights and places leave the slope unknown.
    """
    rise = np.array([value + margin - (b.support_of_contacts(normals) - margin) for b in others])
    outwards = 1.0 if height > others[0].height else -1.0
    run = np.array([[height - b.height] for b in others]) - 2 * outwards * height_error * np.sign(rise)
    with np.errstate(divide="ignore"):
        slopes = np.where(outwards * run > 0, rise / run, outwards * np.inf)
    tightest: Array = outwards * (outwards * slopes).min(axis=0)
    return tightest


def _intersection(
    planes: Array, inside: Array, size: Array, *, with_volume: bool
) -> tuple[Array, list[list[int]], float] | None:
    """Corners (w, 3) of the half-spaces' intersection, the half-spaces that meet in each, and the volume; None if open.

    The half-spaces are shifted to the inner point and scaled by `size` (3,), so that Qhull can handle thin slabs.
    """
    planes = planes.copy()
    planes[:, 3] += planes[:, :3] @ inside
    planes[:, :3] *= size
    planes /= np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    try:
        with np.errstate(divide="ignore", invalid="ignore"):
            intersection = half_space_intersection(planes, np.zeros(3))
    except (QhullError, ValueError):
        return None
    # the intersection is bounded only if the inner point lies inside the hull of the dual points
    if not (intersection.dual_equations[:, 3] < -ROUNDING).all():
        return None
    corners, facets = intersection.intersections, intersection.dual_facets
    if np.abs(corners[:, :2]).max() > _FAR:
        return None
    volume = volume_about(corners, planes[:, :3], facets) * float(np.prod(size)) if with_volume else np.nan
    return inside + corners * size, facets, volume


def _corners_are_straight(facets: list[list[int]], side: Array, straight: Mask, one_sided: bool) -> Mask:
    """(w, 2) whether the half-spaces from below, and from above, that meet in each corner all go on straight behind the slab.

    facets
        the half-spaces (k,) of each corner; `side` and `straight` are as in `_HalfSpaces`.

    Where the slab has slices on one side only, both say whether those of that side do.
    """
    rows = np.fromiter(chain.from_iterable(facets), dtype=np.intp)
    first = np.cumsum([0, *map(len, facets[:-1])])
    if one_sided:
        goes_on = np.logical_and.reduceat(straight[rows], first)
        return np.stack([goes_on, goes_on], axis=1)
    of_side = side[rows, None] == np.arange(2)
    all_straight = np.logical_and.reduceat(straight[rows, None] | ~of_side, first)
    return np.logical_or.reduceat(of_side, first) & all_straight


def _goes_on_straight(behind: tuple[Slice, ...], beyond: Slice | None) -> Mask:
    """Whether the body goes on straight behind a slab's slice, at the slice's normals (k,).

    `behind` begins with that slice and goes on with those ever farther from the slab; `beyond` is the slice on the
    slab's other side.  In a cap there is none, and the slopes may differ by rounding only.
    """
    if len(behind) < 3 or not len(behind[0].angle):
        return np.zeros(len(behind[0].angle), dtype=bool)
    normals = np.stack([np.cos(behind[0].angle), np.sin(behind[0].angle)], axis=1)
    near, far, across = (
        (b.support_of_contacts(normals) - a.support_of_contacts(normals)) / (b.height - a.height)
        for a, b in ((behind[0], behind[1]), (behind[1], behind[2]), (behind[0], beyond or behind[1]))
    )
    rounding = (
        ROUNDING
        * np.abs(behind[0].value).max(initial=0.0)
        / min(abs(a.height - b.height) for a, b in pairwise(behind[:3]))
    )
    straight: Mask = np.abs(near - far) <= _STRAIGHT * np.abs(near - across) + rounding
    return straight


def _inner_point(below: Slice | None, above: Slice | None, low: float, high: float, planes: Array) -> Array | None:
    """A point well inside a slab's half-spaces, above or below its slices' mean centre; None if no such point is found."""
    centres = [slice_.outline.mean(axis=0) for slice_ in (below, above) if slice_ is not None and len(slice_.outline)]
    if not centres or not len(planes):
        return None
    for fraction in _INNER_FRACTIONS:
        if below is not None and above is not None:
            z = (low + high) / 2
        else:
            z = low + fraction * (high - low) if below is not None else high - fraction * (high - low)
        point = np.array([*np.mean(centres, axis=0), z])
        if (planes[:, :3] @ point + planes[:, 3] < 0).all():
            return point
    return None


class SlabGaps:
    """The hull of a stack's contacts, and the distances of points in its slabs from it.

    Nearly every corner of a slab lies straight above a face of the hull that crosses the slab or ends at one of its slices, or
    on the hull.  So these faces are tried first, and the nearest of all faces is searched for the few other corners only.

    Raises QhullError if the contacts span no body, or hardly one.
    """

    def __init__(self, stack: SliceStack) -> None:
        levels = [_level(slice_) for slice_ in stack.slices]
        points = np.concatenate(levels)
        self._frame, self._middle = stack.frame, points.mean(axis=0)
        self._size = float(np.ptp(points, axis=0).max())
        points = (points - self._middle) / self._size
        qhull = ConvexHull(points)
        if not qhull.volume > NEGLIGIBLE * qhull.area:
            raise QhullError
        number = np.repeat(np.arange(len(levels)), [len(level) for level in levels])[qhull.simplices]
        lowest, highest = number.min(axis=1), number.max(axis=1)
        triangles = points[qhull.simplices]
        self._triangles = np.take_along_axis(triangles, longest_first(triangles)[:, :, None], axis=1)
        self._planes = qhull.equations
        # a face that crosses several slabs, as on flat parts of the body, counts to each
        slabs = highest - lowest
        face = np.repeat(np.arange(len(slabs)), slabs)
        above = lowest[face] + np.arange(len(face)) - np.repeat(np.cumsum(slabs) - slabs, slabs)
        order = np.argsort(above, kind="stable")
        self._crossing = face[order]
        """Faces that cross each slab, from below."""
        self._first = np.searchsorted(above[order], np.arange(len(levels) + 1))
        """The first of them above each slice."""
        self._locate: Callable[[Array], tuple[Index, Array]] | None = None

    def at(self, i: int, corners: Array) -> Array:
        """Distances (w,) of corners (w, 3) of the slab below slice i from the hull; 0 inside."""
        corners = (corners @ self._frame.T - self._middle) / self._size
        distance, left = np.zeros(len(corners)), np.arange(len(corners))
        halfway = (corners[:, 2].min(initial=np.inf) + corners[:, 2].max(initial=-np.inf)) / 2
        for low, side in ((i - 1, 0), (i - 2, -1), (i, 1)):
            tried = left[side * (corners[left, 2] - halfway) >= 0]
            above, found = self._above(corners[tried], self._faces(low), within=side == 0)
            distance[tried[found]] = above[found]
            left = np.setdiff1d(left, tried[found], assume_unique=True)
        if len(left):
            self._locate = self._locate or locator(self._triangles)
            face, foot = self._locate(corners[left])
            outside = dot(corners[left] - foot, foot) > 0  # the hull's middle is at 0
            distance[left] = np.where(outside, distance_to(corners[left], self._triangles[face]), 0.0)
        return distance * self._size

    def _faces(self, low: int) -> Index:
        """The faces that cross the slab above slice `low`; none below the first slice and above the last."""
        return (
            self._crossing[self._first[low] : self._first[low + 1]]
            if 0 <= low < len(self._first) - 1
            else self._crossing[:0]
        )

    def _above(self, points: Array, faces: Index, *, within: bool) -> tuple[Array, Mask]:
        """Distances (w,) of points (w, 3) from those of some faces (m,) whose planes they are farthest from.

        The second result says where no other face of the hull is nearer: the point lies straight above the face, or, if it is
        `within` the slab that the faces cross, on the hull or inside, where the distance is 0.
        """
        if not 0 < len(faces) * len(points) <= _FEW:
            return np.zeros(len(points)), np.zeros(len(points), dtype=bool)
        heights = points @ self._planes[faces, :3].T + self._planes[faces, 3]
        best = heights.argmax(axis=1)
        height = np.take_along_axis(heights, best[:, None], axis=1)[:, 0]
        distance = distance_to(points, self._triangles[faces[best]])
        on_hull = height <= (_ROUNDING_OF_DISTANCE if within else -np.inf)
        above = (height > 0) & (distance <= (1 + NEGLIGIBLE) * height + _ROUNDING_OF_DISTANCE)
        return np.where(on_hull, 0.0, distance), above | on_hull


def _level(slice_: Slice) -> Array:
    """The corners (v, 3) of a slice's hull, in the slices' frame."""
    points = slice_.outline if len(slice_.outline) else slice_.points
    return np.column_stack([points, np.full(len(points), slice_.height)])
