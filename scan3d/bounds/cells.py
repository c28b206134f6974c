"""The outer body in cells: what the half-spaces of all slices leave between the planes of the slices.

Along one axis the cells are slabs.  At a fixed normal angle θ a slice's support function is concave in the height z, so that
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

Along several axes a body K lies behind some plane that contains the rod's tangent at a contact p.  With the outward normal w of
the tangent in the slice, and the axis a, that plane is ``<w, x - p> = g <a, x - p>``.  The hull H of all contacts, of whatever
slices, lies behind it as well, which confines the slope g to an interval (S27).  Above its slice a contact therefore leaves of
K what lies behind the plane with the largest g, and below it what lies behind that with the smallest.

Each cell lies on one side of every slice, so that what these half-spaces leave of it is a convex polyhedron, and the distance
from H is largest at one of its corners.  No bound by contacts and tangents can be smaller: the hull of H and a point that is
left is a convex body with the same contacts and tangents.

Of the cells along several axes only those are evaluated in which K can lie outside H.  The surface of K is connected and
nowhere strictly inside H.  So from the cells that contain contacts it reaches others only across those faces of which something
is left that is not strictly inside H.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import IntEnum
from functools import cache
from itertools import chain, combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial import QhullError

from scan3d.arrays import NEGLIGIBLE, OCTANTS, ROUNDING, Array, Index, Mask, across, unit
from scan3d.bounds.constraints import HalfSpaces, by_arcs, by_secants
from scan3d.cloud import Cloud
from scan3d.geometry.distance import nearest_on
from scan3d.geometry.hulls import half_space_intersection
from scan3d.geometry.triangles import dot
from scan3d.reconstruction.slices import SliceStack, stacks

MOST_CROSSINGS = 6_000
"""Crossings of slices along different axes up to which the cells between them are evaluated, in about a millisecond each."""
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


class Cells(NamedTuple):
    """What is left of the cells (c,) in which the body can lie outside the hull of the contacts."""

    number: Index
    """(c, m) of each cell's slab along each axis, counted from below: slab i lies below slice i."""
    low: Array
    """(c, m) heights of the planes below the cells, along each axis."""
    high: Array
    """(c, m) and above."""
    corners: Array
    """(w, 3) in the world; infinite where nothing bounds a cell."""
    cell: Index
    """(w,) the corners' cells."""
    gap: Array
    """(w,) distances of the corners from the hull, infinite where nothing bounds the cell."""
    foot: Array
    """(w, 3) points of the hull nearest to the corners."""
    planes: list[Array]
    """(w,) the half-spaces (k, 4) that meet in each corner, a and b of ``a·x + b <= 0``."""


def has_cells(cloud: Cloud) -> bool:
    """Whether the contacts are exact, with slabs along several axes, and cells not too many."""
    exact = cloud.covariance is None and cloud.calibration is None and cloud.tilt is None and not cloud.noise
    counts = [len(stack.slices) for stack in stacks(cloud)]
    return exact and len(counts) > 1 and min(counts) > 1 and crossings(counts) <= MOST_CROSSINGS


def crossings(slices: Iterable[int]) -> int:
    """Number of crossings of slices along different axes, of which there are so many along each."""
    return sum(a * b for a, b in combinations(slices, 2))


def cells_of_cloud(cloud: Cloud, inner: Any) -> Cells:
    """The cells of a cloud of exact contacts, in slices along several axes, around `inner`, the hull of the contacts."""
    return _Flood(cloud, inner).cells()


def tighter_cells(cloud: Cloud, inner: Any, place: Array, bound: float) -> Cells | None:
    """As `cells_of_cloud`; None if the cell at a place (3,) reaches as far from the hull as a bound, which is found at once."""
    flood = _Flood(cloud, inner)
    return None if np.isfinite(place).all() and flood.gap_at(place) >= bound else flood.cells()


def slabs(stack: SliceStack, margin: float = 0.0, known: dict[SlabKey, Slab] | None = None) -> list[Slab]:
    """The slabs of a stack from below; those in `known`, by key, are not computed again, and new ones are added to it.

    margin
        largest error of a contact's place, by which half-spaces are moved outwards.
    """
    known = {} if known is None else known
    keys = slab_keys(stack)
    sides = cache(lambda _, side, i: by_secants(stack, i, side, margin))
    # where slices are uncertain, the nearest may have few contacts, or light ones
    arrangement = _Arrangement([stack], sides, stack.height_error, 4 if stack.confident or stack.height_error else 1)
    for i, key in enumerate(keys):
        if key not in known:
            known[key] = _slab(stack, arrangement, i)
    return [known[key] for key in keys]


def slab_keys(stack: SliceStack) -> list[SlabKey]:
    """What each slab depends on: three slices, or ends of the body, on either side, and how many contacts they have."""
    heights = [-np.inf, -np.inf, stack.floor, *map(float, stack.heights), stack.ceiling, np.inf, np.inf]
    contacts = [0, 0, 0, *(len(slice_.rows) for slice_ in stack.slices), 0, 0, 0]
    return [(*heights[i : i + 6], *contacts[i : i + 6]) for i in range(len(stack.slices) + 1)]


def _slab(stack: SliceStack, arrangement: _Arrangement, i: int) -> Slab:
    """The slab below slice i."""
    count = len(stack.slices)
    in_cap = i in (0, count)
    (low,), (high,) = arrangement.ends([i])
    if high <= low:
        return Slab(np.empty((0, 3)), np.empty(0, dtype=np.int8), np.empty((0, 2), dtype=bool))
    cell = arrangement.cell([i]) if np.isfinite(high - low) else None
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
    """The cells between the planes of slices, numbered as in `Cells`.

    sides
        the half-spaces by axis, side (0: below the slice, 1: above it) and slice.
    off
        how far cells reach beyond their planes.
    anchors
        number of slices on each side of a cell whose half-spaces bound it.
    """

    def __init__(
        self, by_axis: Sequence[SliceStack], sides: Callable[[int, int, int], HalfSpaces], off: float, anchors: int = 1
    ) -> None:
        self.stacks, self.off = by_axis, off
        self._sides, self._anchors = sides, anchors
        self._contour = cache(lambda k, j: by_axis[k].contour(j))
        self.axes = np.array([stack.frame[2] for stack in by_axis])
        self.levels = [np.array([stack.floor, *stack.heights, stack.ceiling]) for stack in by_axis]
        self._frame, self._bounded = _frame(by_axis)

    def ends(self, number: Sequence[int]) -> tuple[Array, Array]:
        """Heights (m,) between which a cell lies along each axis."""
        low = np.array([levels[i] for levels, i in zip(self.levels, number, strict=True)])
        high = np.array([levels[i + 1] for levels, i in zip(self.levels, number, strict=True)])
        return low - self.off, high + self.off

    def cell(self, number: Sequence[int]) -> _Cell:
        """What the half-spaces leave of a cell."""
        low, high = self.ends(number)
        origin, scale, tried, width = self._coordinates(number, low, high)
        box, straight = self._box(number, low, high)
        planes, side, goes_on, begin = [box], [np.full(len(box), -1)], [straight], [np.ones(len(box), dtype=bool)]
        for k, above, j, is_next in self._around(number):
            half = self._sides(k, above, j)
            planes.append(half.planes)
            side.append(np.full(len(half.planes), above))
            goes_on.append(half.straight & is_next)
            begin.append(np.full(len(half.planes), is_next))
            if len(half.points):
                heights = half.points @ self.axes.T
                in_cell = np.flatnonzero(((heights >= low) & (heights <= high)).all(axis=1))
                begin[-1][:] = False
                # some of a slice's half-spaces, where other axes cut it into many cells
                begin[-1][in_cell[:: 1 + len(in_cell) // 5]] = True
        cell = _Cell(np.empty((0, 3)), [], *map(np.concatenate, (planes, side, goes_on)))
        chosen = np.concatenate(begin)
        corners = origin + OCTANTS @ scale.T / 2
        closed = len(self._bounded) == 3 and bool(np.isfinite(high - low).all())
        if closed and (_heights(corners, cell.planes).min(axis=0) > 0).any():
            return cell
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

    def _around(self, number: Sequence[int]) -> Iterator[tuple[int, int, int, bool]]:
        """The slices that bound a cell: axis, whether the cell lies above them, number, and whether they are next to it."""
        for k, i in enumerate(number):
            for step in range(self._anchors):
                for above, j in ((1, i - 1 - step), (0, i + step)):
                    if 0 <= j < len(self.stacks[k].slices):
                        yield k, above, j, step == 0

    def _box(self, number: Sequence[int], low: Array, high: Array) -> tuple[Array, Mask]:
        """The half-spaces (b, 4) of a cell's planes and of the table, and whether the body goes on straight to them.

        Where an empty slice bounds a cap, the corner in its plane does not follow from the body's shape.
        """
        planes, straight = [np.empty((0, 4))], []
        for k, (stack, i) in enumerate(zip(self.stacks, number, strict=True)):
            at_ends = (i == 0, low[k], -1), (i == len(stack.slices), high[k], 1)
            for (in_cap, level, sign), by_others in zip(at_ends, stack.bounded_by_others, strict=True):
                if np.isfinite(level):
                    planes.append(sign * np.append(self.axes[k], -level)[None])
                    straight.append(in_cap and by_others)
            if stack.table is not None:
                planes.append(np.append(stack.table[:3] @ stack.frame, stack.table[3])[None])
                straight.append(False)
        return np.concatenate(planes), np.array(straight, dtype=bool)

    def _coordinates(self, number: Sequence[int], low: Array, high: Array) -> tuple[Array, Array, Array, float]:
        """Origin (3,) and map (3, 3) of coordinates in which a cell has the size of 1, points (t, 3) in these that may lie
        inside, and the width of the slices next to the cell."""
        places = np.concatenate([self._contour(k, j) for k, _, j, is_next in self._around(number) if is_next])
        heights = places @ self.axes.T
        inside = places[((heights >= low) & (heights <= high)).all(axis=1)]
        width = float(np.ptp(places, axis=0).max()) or 1.0  # of slices with one contact
        # of contacts in the cell, or next to it, the mean lies in the body
        start = (inside if len(inside) else places).mean(axis=0)
        middle, size = self._frame @ start, np.full(3, width)
        for row, k in enumerate(self._bounded):
            if np.isfinite(high[k] - low[k]):
                middle[row], size[row] = (low[k] + high[k]) / 2, max(high[k] - low[k], ROUNDING * width)
        inverse = np.linalg.inv(self._frame)
        start, towards = ((self._frame @ place - middle) / size for place in (start, places.mean(axis=0)))
        halfway = start.copy()
        halfway[: len(self._bounded)] = 0.0
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


def _frame(by_axis: Sequence[SliceStack]) -> tuple[Array, list[int]]:
    """Three directions (3, 3) that span space, and which of the axes the first of them are."""
    axes = np.array([stack.frame[2] for stack in by_axis])
    triples = [list(triple) for triple in combinations(range(len(axes)), 3)]
    volumes = [abs(np.linalg.det(axes[triple])) for triple in triples]
    spanning = 0.02
    if triples and max(volumes) > spanning:
        best = triples[int(np.argmax(volumes))]
        return axes[best], best
    if len(axes) > 1 and np.linalg.norm(across := np.cross(axes[0], axes[1])) > spanning:
        return np.array([axes[0], axes[1], across / np.linalg.norm(across)]), [0, 1]
    return by_axis[0].frame[[2, 0, 1]], [0]


class _Flood:
    """The cells that the surface of a body can reach outside the hull of its exact contacts."""

    def __init__(self, cloud: Cloud, inner: Any) -> None:
        by_axis = stacks(cloud)
        sides, off = by_arcs(cloud, by_axis)
        self._arrangement = _Arrangement(by_axis, lambda k, side, i: sides[k][side][i], off)
        self._distance, self._size = nearest_on(inner), float(np.linalg.norm(inner.extents))
        with_contacts = []
        for k, stack in enumerate(by_axis):
            for i, slice_ in enumerate(stack.slices):
                number = self._number(cloud.points[slice_.rows])
                for above in (0, 1):
                    number[:, k] = i + above
                    with_contacts.append(np.unique(number, axis=0))
        self._first = np.unique(np.concatenate(with_contacts), axis=0)

    def _number(self, points: Array) -> Index:
        """Numbers (n, m) of the cells of points (n, 3)."""
        heights = points @ self._arrangement.axes.T
        return np.column_stack(
            [np.searchsorted(levels[1:-1], h) for levels, h in zip(self._arrangement.levels, heights.T, strict=True)]
        )

    def gap_at(self, place: Array) -> float:
        """How far the cell at a place (3,) reaches from the hull, infinite where nothing bounds it."""
        corners = self._arrangement.cell(self._number(place[None])[0].tolist()).corners
        if not len(corners):
            return 0.0
        return float(self._distance(corners)[0].max()) if np.isfinite(corners).all() else np.inf

    def cells(self) -> Cells:
        """The cells that contain contacts, and those that the body's surface can reach from them."""
        wave = [tuple(number) for number in self._first.tolist()]
        seen = set(wave)
        numbers: list[tuple[int, ...]] = []
        found: list[_Cell] = []
        gaps, feet = [np.empty(0)], [np.empty((0, 3))]
        while wave:
            new = [(number, cell) for number in wave if len((cell := self._arrangement.cell(number)).corners)]
            wave = []
            if not new:
                break
            corners = np.concatenate([cell.corners for _, cell in new])
            finite = np.isfinite(corners).all(axis=1)
            signed, foot = np.full(len(corners), np.inf), np.full((len(corners), 3), np.inf)
            if finite.any():
                signed[finite], _, foot[finite] = self._distance(corners[finite])
            ends = np.cumsum([len(cell.corners) for _, cell in new])[:-1]
            for (number, cell), depth in zip(new, np.split(signed, ends), strict=True):
                reached = [beyond for beyond in self._reached(number, cell.corners, depth) if beyond not in seen]
                wave += reached
                seen.update(reached)
            numbers += [number for number, _ in new]
            found += [cell for _, cell in new]
            gaps.append(np.maximum(signed, 0.0))
            feet.append(foot)
        arrangement = self._arrangement
        ends_of = np.array([arrangement.ends(number) for number in numbers]).reshape(-1, 2, len(arrangement.axes))
        return Cells(
            np.array(numbers, dtype=np.intp).reshape(-1, len(arrangement.axes)),
            ends_of[:, 0],
            ends_of[:, 1],
            np.concatenate([np.empty((0, 3)), *(cell.corners for cell in found)]),
            np.repeat(np.arange(len(found)), [len(cell.corners) for cell in found]),
            np.concatenate(gaps),
            np.concatenate(feet),
            [cell.planes[rows] for cell in found for rows in cell.meeting],
        )

    def _reached(self, number: tuple[int, ...], corners: Array, signed: Array) -> list[tuple[int, ...]]:
        """The cells across faces of which something is left that is not strictly inside the inner body."""
        reached = []
        is_open = not np.isfinite(corners).all()
        outside = corners[np.isfinite(signed) & (signed >= -NEGLIGIBLE * self._size)]
        for k, (low, high) in enumerate(zip(*self._arrangement.ends(number), strict=True)):
            along = outside @ self._arrangement.axes[k]
            near = NEGLIGIBLE * min(high - low, self._size) + 2 * self._arrangement.off
            touched = (along <= low + near).any(), (along >= high - near).any()
            for touches, step in zip(touched, (-1, 1), strict=True):
                if 0 <= number[k] + step < len(self._arrangement.levels[k]) - 1 and (touches or is_open):
                    reached.append((*number[:k], number[k] + step, *number[k + 1 :]))
        return reached
