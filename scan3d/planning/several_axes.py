"""Heights of further slices along several axes, chosen together by what all contacts leave of the cells between the slices.

The largest gap of a cell is at one of its corners.  Where the planes that meet there touch contacts in three slices or more,
the body goes on straight to the corner, which is a vertex or lies on an edge: one slice through it, along any axis, closes the
gap.  Elsewhere the body is bent, and the gap of a cell falls with the square of its width on the body's surface: of the
narrowest of the strips, one for each axis, in which it lies.  Further slices make strips of one axis narrower.  Of all axes
that is chosen with which the slices that are left make the largest gap least; strips of several axes that cross each other do
not add up.  Where more cells are open than slices are left, the vertices are too many to be sliced one by one, and the rest of
the slices are planned as those of a scan along one axis; so are those of scans of very many slices, after the first ones.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.bounds.cells import MOST_CROSSINGS, cells_of_cloud, crossings
from scan3d.cloud import Cloud
from scan3d.geometry.hulls import hull
from scan3d.geometry.support import inertia
from scan3d.planning.heights import AT_ONCE, AT_VERTEX, CLOSEST, LEAST_OVERSHOOT, heights, next_heights
from scan3d.planning.plan import Plan
from scan3d.reconstruction.slices import SliceStack, stacks

# Slices inside the body along each axis with which a scan along several axes starts.
FIRST_SLICES = 3
# Gaps over the largest one of the cells whose corners are looked at for vertices.
_WIDE = 0.1
# Part of the body's size, of a gap, or of a radian that makes no difference, so that rounding does not choose between axes.
_SAME = 1e-6


class _Open(NamedTuple):
    """Cells (c,) with a gap, by their farthest corner."""

    number: Index
    """(c, m) of the cells' slabs along each axis."""
    gap: Array
    corner: Array
    """(c, 3)"""
    height: Array
    """(c, m) of the corner along each axis."""
    width: Array
    """(c, m) of the strips along each axis, on the surface of a body of the size of a ball."""
    on_slice: Mask
    """(c, m) whether the corner lies in the plane of a slice."""
    vertex: Mask
    """(c,) whether the body goes on straight to the corner."""


class _Cut(NamedTuple):
    axis: int
    height: float
    gap: float


class Further(NamedTuple):
    """What is to be swept next."""

    slices: list[tuple[Array, Array]]
    """Axes (3,) and heights (k,)."""
    alone: Array | None = None
    """(3,) the axis of all slices that are left, which are best planned as those of a scan along it alone; else None."""


def first_heights_together(low: float, high: float, plan: Plan) -> Array:
    """Heights (k,) along one of several axes that are scanned before any contact is known, one beyond either end included.

    They are some of those of cosine spacing of all slices, if from then on all were along this axis.
    """
    axes, few = len(plan.axes()), min(FIRST_SLICES, plan.slices)
    inside = heights(low, high, replace(plan, slices=axes * plan.slices - (axes - 1) * few, spacing="cosine"))
    beyond = max(float(inside[0]) - low, LEAST_OVERSHOOT * (high - low))
    chosen = np.unique(np.linspace(0, len(inside) - 1, few).round().astype(np.intp))
    return np.concatenate([inside[chosen], [low - beyond, high + beyond]])


def next_slices(cloud: Cloud, plan: Plan, left: int) -> Further:
    """The slices to be swept next: where the contacts so far leave most room for the body.

    cloud
        the contacts so far, exact ones in slices along several axes, and their slices, also those in which nothing was touched.
    plan
        its `tolerance` says when to stop.
    left
        number of slices along all axes that may still be swept.

    There are none if no slices are left, if the tolerance is met, or if further slices would add no information.  Raises
    InputError if the contacts span no body.
    """
    by_axis = stacks(cloud)
    size = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    # smaller gaps are errors of exact contacts
    tolerance = max(plan.tolerance, 1e-7) * size
    opened = _open(cloud, by_axis, size, tolerance)
    if left <= 0 or not len(opened.gap):
        return Further([])
    counts = np.array([len(stack.slices) for stack in by_axis])
    open_, done = len(opened.gap), int(counts.sum())
    # of bent bodies, also in the planes of slices, gaps fall with what is found beside them
    anywhere = opened._replace(on_slice=np.zeros_like(opened.on_slice))
    # with more open cells than slices left all further ones go along the axis with most slices, if it is early
    too_many = open_ > left and left > 0.5 * (done + left)
    # the cells between all slices must not become too many for the certificate
    if too_many or max(crossings(counts + left * unit) for unit in np.eye(len(counts), dtype=int)) > MOST_CROSSINGS:
        all_bent = anywhere._replace(vertex=np.zeros_like(opened.vertex))
        return Further([], by_axis[_cuts(all_bent, by_axis, np.empty(0), left, tolerance)[0]].frame[2])
    vertices = _vertices(opened, by_axis, size, main=open_ > 0.6 * left)
    wide = opened.gap > _WIDE * opened.gap.max()
    # bent nearly everywhere is a body with few vertices at the wide gaps of several cells
    bent = open_ >= 8 and bool(opened.vertex[wide].mean() < 0.1)
    opened = anywhere if bent else opened
    axis, cuts = _cuts(opened, by_axis, np.array([cut.gap for cut in vertices]), left, tolerance)
    if bent:
        stack = by_axis[axis]
        alone = replace(plan, slices=len(stack.slices) + left)
        further = next_heights(cloud, alone, axis=stack.frame[2], left=left)
        if len(further):
            return Further([(stack.frame[2], further)])
    count = max(1, round((0.4 if bent else 0.2) * done))
    # a short rest is taken together with the round
    count = left if left <= 1.3 * count else count
    chosen: list[list[float]] = [[] for _ in by_axis]
    cuts = sorted(cuts + vertices, key=lambda cut: -cut.gap)
    for cut in cuts + _halves(opened, by_axis, cuts):
        known = np.array([*by_axis[cut.axis].heights, *chosen[cut.axis]])
        if sum(map(len, chosen)) < count and np.abs(known - cut.height).min() > CLOSEST * size:
            chosen[cut.axis].append(cut.height)
    return Further(
        [(stack.frame[2], np.array(heights)) for stack, heights in zip(by_axis, chosen, strict=True) if heights]
    )


def _open(cloud: Cloud, by_axis: list[SliceStack], size: float, tolerance: float) -> _Open:
    """The cells with a gap above the tolerance; where nothing bounds a cell, its gap is the body's size."""
    found = cells_of_cloud(cloud, by_axis, hull(cloud.points))
    order = np.lexsort((-found.gap, found.cell))
    worst = order[np.unique(found.cell[order], return_index=True)[1]]
    worst = worst[found.gap[worst] > tolerance]
    cell = found.cell[worst]
    number, low, high = found.number[cell], found.low[cell], found.high[cell]
    axes = np.array([stack.frame[2] for stack in by_axis])
    bounded = np.isfinite(found.gap[worst])
    ends = np.array([[stack.heights[0], stack.heights[-1], len(stack.slices)] for stack in by_axis]).T
    low, high = np.where(np.isfinite(low), low, ends[0]), np.where(np.isfinite(high), high, ends[1])
    middle = (low + high) / 2
    corner = np.where(bounded[:, None], found.corners[worst], middle @ np.linalg.pinv(axes).T)
    height = np.where(bounded[:, None], corner @ axes.T, middle)
    gap = np.where(bounded, found.gap[worst], size)
    outward = corner - np.where(bounded[:, None], found.foot[worst], cloud.points.mean(axis=0))
    depth = np.where(number == 0, high - height, np.where(number == ends[2], height - low, np.nan))
    width = _widths(cloud.points, axes, outward, high - low, depth, CLOSEST * size)
    on_slice = (np.minimum(height - low, high - height) <= CLOSEST * size) & bounded[:, None]
    vertex = np.zeros(len(gap), dtype=bool)
    wide = np.flatnonzero(bounded & ~on_slice.any(axis=1) & (gap > _WIDE * gap.max(initial=0.0)))
    # for speed, no more than 200
    for i in wide[np.argsort(-gap[wide], kind="stable")][:200]:
        planes = found.planes[worst[i]]
        # a straight side of the body has contacts in three slices, in the planes that meet there
        near = np.abs(cloud.points @ planes[:, :3].T + planes[:, 3]) < 1e-7 * size
        vertex[i] = all(len(np.unique(cloud.slice[rows])) >= 3 for rows in near.T)
    return _Open(number, gap, corner, height, width, on_slice, vertex)


def _widths(points: Array, axes: Array, outward: Array, thickness: Array, depth: Array, least: float) -> Array:
    """Widths (c, m) of strips between slices where the surface has the normals `outward` (c, 3).

    points
        (n, 3) the contacts, in whose isotropic frame the widths are.
    thickness, depth
        (c, m) of the slabs along each axis, and those of the caps, NaN elsewhere.
    """
    centre, shape = inertia(points)
    radius = float(np.linalg.norm((points - centre) @ np.linalg.inv(shape), axis=1).mean())
    across = axes @ shape
    length = np.linalg.norm(across, axis=1)
    normals = outward @ shape
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    sine = np.sqrt((1 - (normals @ (across / length[:, None]).T) ** 2).clip(_SAME**2))
    in_cap = np.sqrt(2 * radius * np.maximum(depth, least) / length)
    return np.where(np.isnan(depth), np.maximum(thickness, least) / length / sine, in_cap)


def _vertices(opened: _Open, by_axis: list[SliceStack], size: float, *, main: bool) -> list[_Cut]:
    """Slices through the vertices, those with the largest gaps first; vertices at the same height share one.

    With `main` they go along the axis with most slices, if the vertex is not at its end.
    """
    counts = np.array([len(stack.slices) for stack in by_axis])
    other = (counts < counts.max()) & main
    rows = np.flatnonzero(opened.vertex)
    rows = rows[np.argsort(-opened.gap[rows], kind="stable")]
    cuts = []
    while len(rows):
        row = rows[0]
        height = opened.height[rows]
        shared = (np.abs(height - height[0]) < _SAME * size).sum(axis=0)
        ends = [(opened.number[row, k] in (0, len(stack.slices))) for k, stack in enumerate(by_axis)]
        # in a cap the slice would lie at the end of the body; otherwise the widest strip gains most
        axis = int(np.lexsort((-opened.width[row], other, -shared, ends))[0])
        at = float(height[0, axis])
        if ends[axis]:
            end = by_axis[axis].heights[0 if opened.number[row, axis] == 0 else -1]
            at = end + AT_VERTEX * (at - end)
        cuts.append(_Cut(axis, at, float(opened.gap[row])))
        # the same place is the farthest corner of several cells
        same = np.linalg.norm(opened.corner[rows] - opened.corner[row], axis=1) < _SAME * size
        rows = rows[~same & (np.abs(height[:, axis] - height[0, axis]) >= _SAME * size)]
    return cuts


def _cuts(
    opened: _Open, by_axis: list[SliceStack], at_vertices: Array, left: int, tolerance: float
) -> tuple[int, list[_Cut]]:
    """The axis along which the slices that are left make the largest gap least, and slices between the others along it.

    Those through vertices, with gaps (v,), are counted as well.  The axis with most slices is preferred, because what is known
    of the others changes with every round.
    """
    bent = ~opened.vertex
    most = max(len(stack.slices) for stack in by_axis)
    best: tuple[float, int, Array] = (np.inf, 0, np.ones(1))
    for k, stack in enumerate(by_axis):
        # slices between two others change nothing in the planes of these
        rows = np.flatnonzero(bent & ~opened.on_slice[:, k])
        low, high = 0.0, float(opened.gap.max())
        for _ in range(40):
            target = (low + high) / 2
            enough = target >= tolerance and (
                (_parts(opened, rows, k, target, len(stack.slices)) - 1).sum() + (at_vertices > target).sum() <= left
            )
            low, high = (low, target) if enough else (target, high)
        reached = max(high, float(opened.gap[bent & opened.on_slice[:, k]].max(initial=0.0)))
        # another axis must do better than that with most slices
        reached *= 1.5 if len(stack.slices) < most else 1.0
        if reached < best[0] * (1 - _SAME):
            best = reached, k, _parts(opened, rows, k, high, len(stack.slices))
    _, k, parts = best
    gaps = np.zeros(len(by_axis[k].slices) + 1)
    movable = bent & ~opened.on_slice[:, k]
    np.maximum.at(gaps, opened.number[movable, k], opened.gap[movable])
    return k, [
        _Cut(k, height, float(gaps[i]))
        for i in np.flatnonzero(parts > 1)
        for height in _within(by_axis[k], int(i), int(parts[i]), opened, k)
    ]


def _halves(opened: _Open, by_axis: list[SliceStack], others: list[_Cut]) -> list[_Cut]:
    """Slices in the middle of slabs without others: of each cell that along the axis with its narrowest strip."""
    narrow = np.where(opened.on_slice, np.inf, opened.width).argmin(axis=1)
    cuts = []
    for k, stack in enumerate(by_axis):
        gaps = np.zeros(len(stack.slices) + 1)
        np.maximum.at(gaps, opened.number[narrow == k, k], opened.gap[narrow == k])
        gaps[[np.searchsorted(stack.heights, cut.height) for cut in others if cut.axis == k]] = 0.0
        cuts += [_Cut(k, _within(stack, int(i), 2, opened, k)[0], float(gaps[i])) for i in np.flatnonzero(gaps)]
    return sorted(cuts, key=lambda cut: -cut.gap)


def _parts(opened: _Open, rows: Index, k: int, target: float, count: int) -> Array:
    """Numbers of parts (count + 1,) of the slabs along axis k by which the gaps of some cells fall to `target`."""
    width, gap, number = opened.width[rows], opened.gap[rows], opened.number[rows, k]
    narrowest, others = width.min(axis=1), np.delete(width, k, axis=1).min(axis=1, initial=np.inf)
    needed = np.ceil(width[:, k] / narrowest * np.sqrt(gap / target))
    needed = np.where(gap * (others / narrowest) ** 2 <= target, 1.0, needed)
    parts = np.ones(count + 1)
    np.maximum.at(parts, number, needed)
    return parts


def _within(stack: SliceStack, i: int, parts: int, opened: _Open, k: int) -> list[float]:
    """Heights that divide slab i into parts that are equally wide on a ball: all of a few, and the middle one of many."""
    heights = stack.heights
    slab = opened.number[:, k] == i
    bottom = min(heights[0], opened.height[:, k].min())
    top = max(heights[-1], opened.height[:, k].max())
    low = heights[i - 1] if i else opened.height[slab, k].min()
    high = heights[i] if i < len(heights) else opened.height[slab, k].max()
    angle = np.arccos(np.clip(1 - 2 * (np.array([low, high]) - bottom) / (top - bottom), -1, 1))
    at = np.arange(1, parts) / parts if parts <= AT_ONCE else np.array([parts // 2 / parts])
    return (bottom + (top - bottom) * (1 - np.cos(angle[0] + (angle[1] - angle[0]) * at)) / 2).tolist()
