"""The outer body in slabs: what the half-spaces of slices along one axis leave between their planes.

At a fixed normal angle θ a slice's support function is concave in the height z, so that
beyond a slice it stays below the extrapolated secant from the slice behind it,

    <n, p> <= h + σ (z - z_i),        σ = (h - h_before) / (z_i - z_before),

with h exact at the contact, and with the support function of the contacts as a lower bound of ``h_before``.  Between two
slices this holds from both sides; beyond an end slice it holds from one side, up to the height of the nearest empty slice.

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

from collections.abc import Iterator
from enum import IntEnum
from functools import cache
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial import QhullError

from scan3d.arrays import NEGLIGIBLE, ROUNDING, Array, Index, Mask, across, unit
from scan3d.bounds.constraints import by_secants
from scan3d.geometry.hulls import half_space_intersection
from scan3d.geometry.triangles import dot
from scan3d.reconstruction.slices import SliceStack

# Depth of a point inside a cell, in sizes of the cell, below which a better one is sought for Qhull.
_INSIDE = 1e-6


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
    cell: _Cell | None = None
    """What bounds the slab; None where nothing does, and where nothing is left of it."""

    @property
    def volume(self) -> float:
        """Infinite if nothing bounds the slab."""
        return _volume(self.cell) if self.cell else np.inf if len(self.corners) else 0.0


SlabKey = tuple[float, ...]
"""Heights of the slices that a slab depends on, and their numbers of contacts."""


def slabs(stack: SliceStack, margin: float = 0.0, known: dict[SlabKey, Slab] | None = None) -> list[Slab]:
    """The slabs of a stack from below; those in `known`, by key, are not computed again, and new ones are added to it.

    margin
        largest error of a contact's place, by which half-spaces are moved outwards.
    """
    known = {} if known is None else known
    keys = slab_keys(stack)
    # where slices are uncertain, the nearest may have few contacts, or light ones
    arrangement = _Arrangement(stack, margin, 4 if stack.confident or stack.height_error else 1)
    for i, key in enumerate(keys):
        if key not in known:
            known[key] = _slab(arrangement, i)
    return [known[key] for key in keys]


def slab_keys(stack: SliceStack) -> list[SlabKey]:
    """What each slab depends on: three slices, or ends of the body, on either side, and how many contacts they have."""
    heights = [-np.inf, -np.inf, stack.floor, *map(float, stack.heights), stack.ceiling, np.inf, np.inf]
    contacts = [0, 0, 0, *(len(slice_.rows) for slice_ in stack.slices), 0, 0, 0]
    return [(*heights[i : i + 6], *contacts[i : i + 6]) for i in range(len(stack.slices) + 1)]


def _slab(arrangement: _Arrangement, i: int) -> Slab:
    """The slab below slice i."""
    stack = arrangement.stack
    count = len(stack.slices)
    in_cap = i in (0, count)
    low, high = arrangement.ends(i)
    if high <= low:
        return Slab(np.empty((0, 3)), np.empty(0, dtype=np.int8), np.empty((0, 2), dtype=bool))
    cell = arrangement.cell(i) if np.isfinite(high - low) else None
    inner_kind = Gap.CAPS if in_cap else Gap.SLICES
    # a slab of which nothing is left contradicts the premises
    if cell is None or not len(cell.corners) or not np.isfinite(cell.corners).all():
        nothing = np.full((1, 3), np.inf)
        return Slab(nothing, np.array([inner_kind], dtype=np.int8), np.zeros((1, 2), dtype=bool))
    # corners in the plane of a slice: of one whose half-spaces bound it there, or of an end slice, where the body is narrower
    height = cell.corners @ stack.frame[2]
    on_low, on_high = (np.abs(height - z) <= NEGLIGIBLE * (high - low) for z in (low, high))
    in_plane = (on_low & (i >= 2)) | (on_high & (i + 1 < count))
    on_end = (on_low & (i == 1)) | (on_high & (i + 1 == count))
    kind = np.where(in_plane, Gap.CONTACTS, inner_kind).astype(np.int8)
    straight = _corners_are_straight(cell, one_sided=in_cap) & ~on_end[:, None]
    return Slab(cell.corners, kind, straight, cell)


def _volume(cell: _Cell) -> float:
    """Volume of a bounded cell: of the pyramids from the middle of its corners over its faces."""
    plane = np.fromiter(chain.from_iterable(cell.meeting), dtype=np.intp)
    corner, normals = np.repeat(np.arange(len(cell.meeting)), [*map(len, cell.meeting)]), unit(cell.planes[:, :3])
    places = (cell.corners - cell.corners.mean(axis=0))[corner]
    count = np.maximum(np.bincount(plane, minlength=len(normals)), 1)
    middle = np.stack([np.bincount(plane, x, minlength=len(normals)) for x in places.T], axis=1) / count[:, None]
    # around each face, its corners in their order
    u, v = across(normals)
    places -= middle[plane]
    order = np.lexsort((np.arctan2(dot(places, v[plane]), dot(places, u[plane])), plane))
    plane, places = plane[order], places[order]
    following = np.arange(1, len(plane) + 1)
    last = np.flatnonzero(np.diff(plane, append=-1))
    following[last] = np.append(0, last[:-1] + 1)
    twice = dot(np.cross(places, places[following]), normals[plane])
    return max(float((twice * dot(middle, normals)[plane]).sum()) / 6, 0.0)


def _corners_are_straight(cell: _Cell, *, one_sided: bool) -> Mask:
    """(w, 2) whether the half-spaces from below, and from above, that meet in each corner all go on straight behind the slab.

    Where the slab has slices on one side only, both say whether those of that side do.
    """
    rows = np.fromiter(chain.from_iterable(cell.meeting), dtype=np.intp)
    first = np.cumsum([0, *map(len, cell.meeting[:-1])])
    side, straight = cell.side[rows], cell.straight[rows]
    if one_sided:
        goes_on = np.logical_and.reduceat(straight, first)
        return np.stack([goes_on, goes_on], axis=1)
    of_side = side[:, None] == [1, 0]
    all_straight = np.logical_and.reduceat(straight[:, None] | ~of_side, first)
    return np.logical_or.reduceat(of_side, first) & all_straight


class _Cell(NamedTuple):
    """What is left of one cell."""

    corners: Array
    """(w, 3); one infinite corner if nothing bounds the cell, none if nothing is left of it."""
    meeting: list[list[int]]
    """(w,) the half-spaces that meet in each corner."""
    planes: Array
    """(k, 4) the half-spaces."""
    side: Index
    """(k,) 1 for those that hold above a slice, 0 for those that hold below one, -1 for the cell's planes and the table's."""
    straight: Mask
    """(k,) as in `HalfSpaces`."""


class _Arrangement:
    """The slabs between the slices of a stack, numbered from below.

    margin
        largest error of a contact's place.
    anchors
        number of slices on each side of a slab whose half-spaces bound it.
    """

    def __init__(self, stack: SliceStack, margin: float, anchors: int) -> None:
        self.stack, self._anchors = stack, anchors
        self._sides = cache(lambda side, i: by_secants(stack, i, side, margin))
        self._levels = np.array([stack.floor, *stack.heights, stack.ceiling])

    def ends(self, i: int) -> tuple[float, float]:
        """Heights between which a slab lies, which reaches beyond its planes by their errors."""
        low, high = self._levels[i : i + 2].tolist()
        return low - self.stack.height_error, high + self.stack.height_error

    def cell(self, i: int) -> _Cell:
        """What the half-spaces leave of a slab."""
        low, high = self.ends(i)
        origin, scale, tried, width = self._coordinates(i, low, high)
        box = self._box(low, high)
        planes, side = [box], [np.full(len(box), -1)]
        goes_on, begin = [np.zeros(len(box), dtype=bool)], [np.ones(len(box), dtype=bool)]
        for above, j, is_next in self._around(i):
            half = self._sides(above, j)
            planes.append(half.planes)
            side.append(np.full(len(half.planes), above))
            goes_on.append(half.straight & is_next)
            begin.append(np.full(len(half.planes), is_next))
        cell = _Cell(np.empty((0, 3)), [], *map(np.concatenate, (planes, side, goes_on)))
        chosen = np.concatenate(begin)
        while True:
            found = _left(cell.planes[chosen], origin, scale, tried)
            if found is None:
                return cell
            corners, meeting = found
            finite = bool(np.isfinite(corners).all())
            if finite and not chosen.all():
                heights = _heights(corners, cell.planes)
                worst = heights.argmax(axis=1)[heights.max(axis=1) > NEGLIGIBLE * width]
                if not chosen[worst].all():
                    chosen[worst] = True
                    continue
            if not finite and not chosen.all():
                chosen[:] = True
                continue
            return _Cell(corners, meeting, cell.planes[chosen], cell.side[chosen], cell.straight[chosen])

    def _around(self, i: int) -> Iterator[tuple[int, int, bool]]:
        """The slices that bound a slab: whether it lies above them, their number, and whether they are next to it."""
        for step in range(self._anchors):
            for above, j in ((1, i - 1 - step), (0, i + step)):
                if 0 <= j < len(self.stack.slices):
                    yield above, j, step == 0

    def _box(self, low: float, high: float) -> Array:
        """The half-spaces (b, 4) of a slab's planes and of the table."""
        axis, table = self.stack.frame[2], self.stack.table
        planes = [sign * np.append(axis, -level) for level, sign in ((low, -1), (high, 1))]
        if table is not None:
            planes.append(np.append(table[:3] @ self.stack.frame, table[3]))
        return np.array(planes)

    def _coordinates(self, i: int, low: float, high: float) -> tuple[Array, Array, Array, float]:
        """Origin (3,) and map (3, 3) of coordinates in which a slab has the size of 1, points (t, 3) in these that may lie
        inside, and the width of the slices next to the slab."""
        frame = self.stack.frame[[2, 0, 1]]
        places = np.concatenate([self.stack.contour(j) for _, j, is_next in self._around(i) if is_next])
        heights = places @ frame[0]
        inside = places[(heights >= low) & (heights <= high)]
        width = float(np.ptp(places, axis=0).max()) or 1.0  # of slices with one contact
        # of contacts in the slab, or next to it, the mean lies in the body
        start = (inside if len(inside) else places).mean(axis=0)
        middle, size = frame @ start, np.full(3, width)
        middle[0], size[0] = (low + high) / 2, max(high - low, ROUNDING * width)
        inverse = np.linalg.inv(frame)
        start, towards = ((frame @ place - middle) / size for place in (start, places.mean(axis=0)))
        halfway = start * [0.0, 1.0, 1.0]
        tried = np.concatenate([start + 0.2 ** np.arange(13)[:, None] * (end - start) for end in (halfway, towards)])
        return inverse @ middle, inverse * size, tried, width


def _heights(points: Array, planes: Array) -> Array:
    """How far points (p, 3) lie beyond planes (k, 4)."""
    return points @ planes[:, :3].T + planes[:, 3]


def _left(planes: Array, origin: Array, scale: Array, tried: Array) -> tuple[Array, list[list[int]]] | None:
    """Corners (w, 3) of an intersection of half-spaces (k, 4), and those that meet in each; None if it is empty.

    origin, scale
        of coordinates in which the intersection is of the size of 1, so that Qhull can handle thin cells.
    tried (t, 3)
        points that may lie inside, in these coordinates.

    One infinite corner if nothing bounds it.
    """
    open_ = np.full((1, 3), np.inf), [[0]]
    normals = planes[:, :3] @ scale
    size = np.linalg.norm(normals, axis=1)
    normals, offset = normals / size[:, None], -_heights(origin[None], planes)[0] / size
    depths = (offset - tried @ normals.T).min(axis=1)
    inside, depth = tried[depths.argmax()], float(depths.max())
    if depth < _INSIDE:
        best = linprog(
            [0, 0, 0, -1],
            A_ub=np.column_stack([normals, np.ones(len(normals))]),
            b_ub=offset,
            bounds=[(None, None)] * 3 + [(None, 1)],
        )
        if best.status == 0 and (reached := float((offset - normals @ best.x[:3]).min())) > depth:
            inside, depth = best.x[:3], reached
        if depth < -_INSIDE:
            return None if best.status == 0 else open_
        if depth < NEGLIGIBLE:  # moved outwards, so that there is an inside
            offset = offset + 2 * _INSIDE - depth
    try:
        with np.errstate(divide="ignore", invalid="ignore"):
            found = half_space_intersection(np.column_stack([normals, normals @ inside - offset]), np.zeros(3))
    except (QhullError, ValueError):
        return open_
    # the intersection is bounded only if the point lies inside the hull of the dual points
    corners = found.intersections
    # half-spaces close farther out by rounding only
    if not (found.dual_equations[:, 3] < -ROUNDING).all() or not np.abs(corners).max() < 1e6:
        return open_
    return origin + (inside + corners) @ scale.T, found.dual_facets
