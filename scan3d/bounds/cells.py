"""The outer body by slices along several axes: what all contacts together leave of the cells between their planes.

A body K lies behind some plane that contains the rod's tangent at a contact p.  With the outward normal w of the tangent in
the slice, and the axis a, that plane is ``<w, x - p> = g <a, x - p>``.  The hull H of all contacts, of whatever slices, lies
behind it as well, which confines the slope g to an interval (S27).  Above its slice a contact therefore leaves of K what
lies behind the plane with the largest g, and below it what lies behind that with the smallest.

The planes of all slices cut space into cells.  Each cell lies on one side of every slice, so that what these half-spaces leave
of it is a convex polyhedron, and the distance from H is largest at one of its corners.  No bound by contacts and tangents can
be smaller: the hull of H and a point that is left is a convex body with the same contacts and tangents.

Only cells are evaluated in which K can lie outside H.  The surface of K is connected and nowhere strictly inside H.  So from
the cells that contain contacts it reaches others only across those faces of which something is left that is not strictly
inside H.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import linprog
from scipy.spatial import QhullError

from scan3d.arrays import NEGLIGIBLE, ROUNDING, Array, Index, Mask
from scan3d.bounds.constraints import exact_error, tangent_planes
from scan3d.bounds.slabs import secants
from scan3d.cloud import Cloud
from scan3d.geometry.distance import nearest_on
from scan3d.geometry.polytopes import half_space_intersection
from scan3d.reconstruction.slices import SliceStack

MOST_CROSSINGS = 6_000
"""Crossings of slices along different axes up to which the cells between them are evaluated, in about a millisecond each."""
# Axes up to which the codes of cells fit into 64 bits.
_MOST_AXES = 6
# Rounds in which the half-spaces are added that cut off most of a cell's corners, and those of contacts in the cell with which
# it is begun.
_ROUNDS, _FIRST = 20, 30
# Depth of a point inside a cell, over the cell's half thickness, that serves Qhull without a search for a better one, and steps
# from the contacts of a cell towards the middle of the body at which such a point is sought.
_INSIDE, _STEPS = 1e-6, np.array([0.5, 0.3, 0.1, 0.03, 0.01, 1e-3, 1e-4])
# Coordinates of corners, in half thicknesses of the cell, that count as infinite.
_FAR = 1e6
# Determinant of three axes that span space.
_SPANNING = 0.02
_SIGNS = np.array(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0], indexing="ij")).reshape(3, 8).T


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


def applicable(cloud: Cloud, by_axis: Sequence[SliceStack]) -> bool:
    """Whether the contacts are exact, along several axes, and axes and cells not too many."""
    exact = cloud.covariance is None and cloud.calibration is None and cloud.tilt is None and not cloud.noise
    return (
        exact
        and 1 < len(by_axis) <= _MOST_AXES
        and 0 < crossings([len(stack.slices) for stack in by_axis]) <= MOST_CROSSINGS
    )


def crossings(slices: Iterable[int]) -> int:
    """Number of crossings of slices along different axes, of which there are so many along each."""
    return sum(a * b for a, b in combinations(slices, 2))


def cells_of_cloud(cloud: Cloud, by_axis: Sequence[SliceStack], inner: Any) -> Cells:
    """The cells of a cloud of exact contacts, in slices along several axes, around `inner`, the hull of the contacts."""
    return _Arrangement(cloud, by_axis, inner).flooded()


def tighter_cells(cloud: Cloud, by_axis: Sequence[SliceStack], inner: Any, place: Array, bound: float) -> Cells | None:
    """As `cells_of_cloud`; None if the cell at a place (3,) reaches as far from the hull as a bound, which is found at once."""
    arrangement = _Arrangement(cloud, by_axis, inner)
    return None if arrangement.gap_at(place) >= bound else arrangement.flooded()


class _Cell(NamedTuple):
    """What is left of one cell."""

    corners: Array
    """(w, 3)"""
    planes: list[Array]
    """(w,) of (k, 4)"""


class _Arrangement:
    """The cells of the planes of all slices, numbered by one code each."""

    def __init__(self, cloud: Cloud, by_axis: Sequence[SliceStack], inner: Any) -> None:
        error = exact_error(cloud)
        self._axes = np.array([stack.frame[2] for stack in by_axis])
        heights = [stack.heights for stack in by_axis]
        self._levels = [np.array([s.floor - error, *s.heights, s.ceiling + error]) for s in by_axis]
        self._distance = nearest_on(inner)
        vertices = inner.vertices.view(np.ndarray)
        self._centre, self._size = vertices.mean(axis=0), float(np.linalg.norm(np.ptp(vertices, axis=0)))
        self._frame, self._bounded = _frame(self._axes)
        self._weights = (max(map(len, self._levels)) + 1) ** np.arange(len(by_axis))
        self._half = half = half_spaces(cloud, by_axis)
        first = np.cumsum([0, *map(len, heights)])
        member = first[half.axis] + half.slice
        finite: Mask = np.asarray(np.isfinite(half.planes).all(axis=2))
        self._rows = [
            [
                [np.flatnonzero((member == first[k] + i) & finite[side]) for i in range(len(heights[k]))]
                for side in (0, 1)
            ]
            for k in range(len(by_axis))
        ]
        number = np.column_stack(
            [np.searchsorted(h, half.points @ axis) for h, axis in zip(heights, self._axes, strict=True)]
        )
        codes = []
        for side in (0, 1):
            number[np.arange(len(number)), half.axis] = half.slice + side
            codes.append(number @ self._weights)
        order = np.argsort(np.concatenate(codes), kind="stable")
        known, start = np.unique(np.concatenate(codes)[order], return_index=True)
        within = np.split(np.tile(np.arange(len(number)), 2)[order], start[1:])
        self._contacts: dict[int, Index] = dict(zip(known.tolist(), within, strict=True))

    def flooded(self) -> Cells:
        """The cells that contain contacts, and those that the body's surface can reach from them."""
        wave, seen = list(self._contacts), set(self._contacts)
        codes: list[int] = []
        found: list[_Cell] = []
        gaps, feet = [np.empty(0)], [np.empty((0, 3))]
        while wave:
            new = [(code, cell) for code in wave if len((cell := self._cell(code)).corners)]
            wave = []
            if not new:
                break
            corners = np.concatenate([cell.corners for _, cell in new])
            finite = np.isfinite(corners).all(axis=1)
            signed, foot = np.full(len(corners), np.inf), np.full((len(corners), 3), np.inf)
            if finite.any():
                signed[finite], _, foot[finite] = self._distance(corners[finite])
            ends = np.cumsum([len(cell.corners) for _, cell in new])[:-1]
            for (code, cell), depth in zip(new, np.split(signed, ends), strict=True):
                for beyond in self._reached(code, cell.corners, depth):
                    if beyond not in seen:
                        seen.add(beyond)
                        wave.append(beyond)
            codes += [code for code, _ in new]
            found += [cell for _, cell in new]
            gaps.append(np.maximum(signed, 0.0))
            feet.append(foot)
        number = np.array([self._number(code) for code in codes], dtype=np.intp).reshape(-1, len(self._axes))
        low, high = (
            np.column_stack([levels[number[:, k] + side] for k, levels in enumerate(self._levels)]) for side in (0, 1)
        )
        return Cells(
            number,
            low,
            high,
            np.concatenate([np.empty((0, 3)), *(cell.corners for cell in found)]),
            np.repeat(np.arange(len(found)), [len(cell.corners) for cell in found]),
            np.concatenate(gaps),
            np.concatenate(feet),
            [planes for cell in found for planes in cell.planes],
        )

    def gap_at(self, place: Array) -> float:
        """How far the cell at a place (3,) reaches from the hull, infinite where nothing bounds it."""
        number = [
            np.searchsorted(levels[1:-1], place @ axis) for levels, axis in zip(self._levels, self._axes, strict=True)
        ]
        corners = self._cell(int(number @ self._weights)).corners
        if not len(corners):
            return 0.0
        return float(self._distance(corners)[0].max()) if np.isfinite(corners).all() else np.inf

    def _number(self, code: int) -> Index:
        return np.asarray(code // self._weights % (max(map(len, self._levels)) + 1))

    def _reached(self, code: int, corners: Array, signed: Array) -> list[int]:
        """Codes of the cells across faces of which something is left that is not strictly inside the inner body."""
        reached = []
        finite = bool(np.isfinite(corners).all())
        outside = corners[np.isfinite(signed) & (signed >= -NEGLIGIBLE * self._size)]
        for k, i in enumerate(self._number(code).tolist()):
            levels, along = self._levels[k], outside @ self._axes[k]
            # cells beside end slices reach beyond their planes
            near = NEGLIGIBLE * min(levels[i + 1] - levels[i], self._size) + 2 * self._half.off
            touched = (along <= levels[i] + near).any(), (along >= levels[i + 1] - near).any()
            for touches, step in zip(touched, (-1, 1), strict=True):
                if 0 <= i + step < len(levels) - 1 and (touches or not finite):
                    reached.append(code + step * int(self._weights[k]))
        return reached

    def _cell(self, code: int) -> _Cell:
        """What the contacts of the slices around a cell leave of it."""
        number = self._number(code)
        last = np.array([len(levels) - 3 for levels in self._levels])
        low = np.array([levels[i] for levels, i in zip(self._levels, number, strict=True)])
        high = np.array([levels[i + 1] for levels, i in zip(self._levels, number, strict=True)])
        low, high = low - self._half.off * (number == 1), high + self._half.off * (number == last)
        sides = [
            (side, rows)
            for k, i in enumerate(number.tolist())
            for side, j in ((1, i - 1), (0, i))
            if 0 <= j < len(self._levels[k]) - 2
            for rows in (self._rows[k][side][j],)
        ]
        rows = np.concatenate([rows for _, rows in sides]) if sides else np.empty(0, dtype=np.intp)
        planes = np.concatenate([np.empty((0, 4)), *(self._half.planes[side, rows] for side, rows in sides)])
        origin, scale, box = self._coordinates(low, high)
        corners = origin + _SIGNS @ scale.T
        chosen = np.empty(0, dtype=np.intp)
        if code in self._contacts:
            near = self._contacts[code]
            chosen = np.flatnonzero(np.isin(rows, near[:: -(-len(near) // _FIRST)]))
        closed = len(self._bounded) == 3 and bool(np.isfinite([low, high]).all())
        facets: list[list[int]] = []
        for rounds_done in range(_ROUNDS):
            beyond = corners @ planes[:, :3].T + planes[:, 3]
            if not rounds_done and closed and (beyond.min(axis=0, initial=np.inf) > 0).any():
                return _nothing()
            worst = beyond.argmax(axis=1)[beyond.max(axis=1) > NEGLIGIBLE * self._size] if len(planes) else chosen
            if rounds_done and not len(np.setdiff1d(worst, chosen)):
                break
            chosen = np.union1d(chosen, worst)
            left = self._left(np.concatenate([box, planes[chosen]]), origin, scale, self._contacts.get(code))
            if left is None:
                return _nothing()
            corners, facets = left
            if not np.isfinite(corners).all():
                return _Cell(corners, [np.empty((0, 4))])
        met = np.concatenate([box, planes[chosen]])
        return _Cell(corners, [met[facet] for facet in facets])

    def _coordinates(self, low: Array, high: Array) -> tuple[Array, Array, Array]:
        """Origin (3,) and map (3, 3) of coordinates in which a cell has the size of about 1, and its planes (b, 4)."""
        upper = np.column_stack([self._axes, -high])[np.isfinite(high)]
        lower = np.column_stack([-self._axes, low])[np.isfinite(low)]
        middle, half = self._frame @ self._centre, np.full(3, self._size)
        for row, k in enumerate(self._bounded):
            if np.isfinite(high[k] - low[k]):
                middle[row] = (low[k] + high[k]) / 2
                half[row] = max((high[k] - low[k]) / 2, ROUNDING * self._size)
        inverse = np.linalg.inv(self._frame)
        return inverse @ middle, inverse * half, np.concatenate([upper, lower])

    def _left(
        self, planes: Array, origin: Array, scale: Array, contacts: Index | None
    ) -> tuple[Array, list[list[int]]] | None:
        """Corners (w, 3) of an intersection of half-spaces (k, 4), and those that meet in each; None if it is empty."""
        open_ = np.full((1, 3), np.inf), [[0]]
        normals = planes[:, :3] @ scale
        size = np.linalg.norm(normals, axis=1)
        normals, offset = normals / size[:, None], -(planes[:, 3] + planes[:, :3] @ origin) / size
        inside = None
        if contacts is not None:
            start, centre = np.linalg.solve(
                scale, (np.array([self._half.points[contacts].mean(axis=0), self._centre]) - origin).T
            ).T
            trial = start + _STEPS[:, None] * (centre - start)
            depth = (offset - trial @ normals.T).min(axis=1)
            if depth.max() > _INSIDE:
                inside = trial[depth.argmax()]
        if inside is None:
            best = linprog(
                [0, 0, 0, -1],
                A_ub=np.column_stack([normals, np.ones(len(normals))]),
                b_ub=offset,
                bounds=[(None, None)] * 3 + [(None, 1)],
            )
            if best.status != 0:
                return open_
            inside, depth = best.x[:3], float((offset - normals @ best.x[:3]).min())
            if depth < -_INSIDE and best.x[3] < -_INSIDE:
                return None
            offset = offset + max(2 * _INSIDE - depth, 0.0)
        try:
            with np.errstate(divide="ignore", invalid="ignore"):
                found = half_space_intersection(np.column_stack([normals, -offset]), inside)
        except (QhullError, ValueError):
            return open_
        if not (found.dual_equations[:, 3] < -ROUNDING).all() or not np.abs(found.intersections).max() < _FAR:
            return open_
        return origin + found.intersections @ scale.T, found.dual_facets


def _nothing() -> _Cell:
    return _Cell(np.empty((0, 3)), [])


def _frame(axes: Array) -> tuple[Array, list[int]]:
    """Three directions (3, 3) that span space, and which of the axes the first of them are."""
    triples = [list(triple) for triple in combinations(range(len(axes)), 3)]
    volumes = [abs(np.linalg.det(axes[triple])) for triple in triples]
    if triples and max(volumes) > _SPANNING:
        best = triples[int(np.argmax(volumes))]
        return axes[best], best
    cross = np.cross(axes[0], axes[1])
    length = np.linalg.norm(cross)
    if length > _SPANNING:
        return np.array([axes[0], axes[1], cross / length]), [0, 1]
    first = np.linalg.svd(axes[:1])[2]
    return np.array([axes[0], first[1], first[2]]), [0]


class HalfSpaces(NamedTuple):
    """Half-spaces ``a·x + b <= 0`` by contacts (n,), below and above their slices."""

    planes: Array
    """(2, n, 4) a, unit vectors, and b; not finite where the slope is not bounded."""
    axis: Index
    """(n,) numbers of the slices' axes."""
    slice: Index
    """(n,) numbers of the slices along their axes, from below."""
    points: Array
    """(n, 3) the contacts."""
    off: float
    """Largest distance of a contact from the plane of its slice."""


def half_spaces(cloud: Cloud, by_axis: Sequence[SliceStack]) -> HalfSpaces:
    """The half-spaces of a cloud of exact contacts in slices along several axes."""
    error = exact_error(cloud)
    across = np.cross(cloud.in_plane_normals, cloud.slice_axis[cloud.slice])
    anywhere = replace(cloud, centre_points=cloud.points, tangents=across, rod_radius=0.0, table=None)
    tangent = tangent_planes(anywhere, np.full(len(cloud), error), np.zeros(len(cloud)))
    of_slice = np.full((len(cloud.slice_height), 2), -1)
    for k, stack in enumerate(by_axis):
        for i, slice_ in enumerate(stack.slices):
            of_slice[cloud.slice[slice_.rows[0]]] = k, i
    rows = tangent.rows
    ends = tangent.arcs.ends() @ np.linalg.inv(tangent.shape)
    axis, number = of_slice[cloud.slice[rows]].T
    along = np.array([stack.frame[2] for stack in by_axis])[axis]
    outward, points = cloud.in_plane_normals[rows], cloud.points[rows]
    first = np.cumsum([0, *(len(stack.slices) for stack in by_axis)])
    height = np.concatenate([stack.heights for stack in by_axis])[first[axis] + number]
    off = error + float(np.abs(height - (along * points).sum(axis=1)).max(initial=0.0))
    slopes, value = _slopes(ends, outward, along), (outward * points).sum(axis=1)
    for k, stack in enumerate(by_axis):
        for i in range(len(stack.slices)):
            member = np.flatnonzero((axis == k) & (number == i))
            normals = outward[member] @ stack.frame[:2].T
            slopes[member] = _narrowed(slopes[member], stack, i, normals, value[member], off)
    finite: Mask = np.asarray(np.isfinite(slopes))
    # past an end slice one slope is enough, since the cells on its other side reach beyond its plane
    last = first[axis + 1] - first[axis] - 1
    at_bottom, at_top = (number == 0) & (last > 0), (number == last) & (last > 0)
    usable = finite.all(axis=1) | (finite[:, 0] & at_bottom) | (finite[:, 1] & at_top)
    with np.errstate(invalid="ignore"):
        # a contact that lies off the plane of its slice has the other slope between the two
        out = error + 2 * off * np.where(finite, np.abs(slopes), 0.0).sum(axis=1)
        normals = outward - slopes.T[:, :, None] * along
        at = value + out - slopes.T * height
        planes = np.concatenate([normals, -at[:, :, None]], axis=2) / np.linalg.norm(normals, axis=2)[:, :, None]
    planes[:, ~usable] = np.nan
    return HalfSpaces(planes, axis, number, points, off)


def _slopes(ends: Array, outward: Array, along: Array) -> Array:
    """Least and largest slopes (n, 2) of planes whose normals are those at the ends (n, 2, 3) of their arcs."""
    ends = ends / np.linalg.norm(ends, axis=2)[:, :, None]
    level, rise = np.einsum("nej,nj->ne", ends, outward), np.einsum("nej,nj->ne", ends, along)
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.sort(np.where(level > NEGLIGIBLE, -rise / level, -np.copysign(np.inf, rise)), axis=1)
    # contacts whose arcs are not known are confined by the slices next to theirs only
    unknown: Mask = np.asarray(np.isnan(ends).any(axis=(1, 2)))
    return np.where(unknown[:, None], [-np.inf, np.inf], slopes)


def _narrowed(slopes: Array, stack: SliceStack, i: int, normals: Array, value: Array, off: float) -> Array:
    """Least and largest slopes (n, 2) of the contacts of slice i, confined by the slices next to it as well.

    The arcs come from a search among the contacts, which may miss the one that confines a slope most.  The errors of places and
    heights are at most `off`; normals (n, 2) and values (n,) are those of the contacts' support lines.
    """
    found = slopes.copy()
    if i > 0:
        below = secants(value, stack.heights[i], stack.slices[i - 1 : i], normals, off, off)
        found[:, 1] = np.minimum(found[:, 1], below)
    if i + 1 < len(stack.slices):
        above = secants(value, stack.heights[i], stack.slices[i + 1 : i + 2], normals, off, off)
        found[:, 0] = np.maximum(found[:, 0], above)
    return np.where((found[:, 0] <= found[:, 1])[:, None], found, slopes)
