"""Slices that follow: spaced by a rule, or chosen where the contacts so far leave most room for the body.

This module knows no simulation: a simulated scan and a real rig both ask it for slices, sweep there, and ask again.

What contacts leave open between slices is widest at a corner of the outer body.  Where the body goes on straight to it,
a vertex or an edge ends there, and one slice through it closes the gap.  Elsewhere the body is bent, and the gap falls with the
square of the distance between the slices.  So slabs, or cells of several axes, with the largest gaps are cut, through their
corners or into as many parts as make the largest gap least, until the gaps are within the tolerance, or as narrow as what the
contacts of a slice leave open in its plane, which further slices do not close.

A cell of several axes is as wide as the narrowest of its strips, on the body's surface, and that axis is cut with which
the slices that are left make the largest gap least: strips of several axes that cross each other do not add up.  Where more
cells are open than slices are left, all are along one axis; so are those of very many slices, after the first ones.

Of a polyhedron the planes of known facets meet in corners.  One that is not known to be a vertex may be cut off by further
facets, which a slice between the corner and the body would cross; once all corners are vertices, slices through these make the
contacts' hull the body itself.  A plane, in any direction, goes through three such places, those with the largest gaps first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from scan3d.arrays import Array, Index, Mask, evenly, ratio, unit
from scan3d.bounds import enclosure
from scan3d.bounds.cells import MOST_CROSSINGS, Gap, Slab, SlabKey, cells_of_cloud, crossings, slab_keys, slabs
from scan3d.bounds.enclosures import slice_enclosure
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import distance_from_hull, hull
from scan3d.geometry.support import inertia
from scan3d.geometry.triangles import representatives
from scan3d.planning.plan import Plan, cosine_fractions
from scan3d.reconstruction.facets import POLYHEDRON, polyhedron
from scan3d.reconstruction.slices import SAME_AXIS, Slice, SliceStack, stacks

FIRST_SLICES, FIRST_TOGETHER = 8, 3
"""Slices inside the body with which adaptive spacing starts along one axis, and along each of several."""
BEYOND = 2
"""Slices beyond the ends of the body that every spacing adds to the slices of a plan."""
LEAST_OVERSHOOT = 1e-4
"""Least distance of the slices beyond the ends from the ends, as a fraction of the body's height."""
CLOSEST = 1e-7
"""Part of the body's size below which two slices or two corners are one, and a gap is rounding."""
AT_VERTEX, AT_POLE = 0.98, 0.35
"""Where a cap is cut, as a fraction of the distance from its end slice to its worst corner: just before the tip of a vertex,
and at about a third at a smooth pole, whose cap is shallower than its corner."""
AT_ONCE = 4
"""Largest number of parts into which a slab is cut at once."""
# Decimals of the gaps' roots, over the largest, by which slabs are compared, so that rounding decides nothing.
_TIED_DECIMALS = 4


def heights(low: float, high: float, plan: Plan) -> Array:
    """Heights (slices,) between the ends of the body; those of cosine spacing are Chebyshev's nodes."""
    even = (np.arange(plan.slices) + 0.5) / plan.slices
    return low + (high - low) * (cosine_fractions(plan.slices) if plan.spacing == "cosine" else even)


def first_heights(low: float, high: float, plan: Plan, *, together: bool = False) -> Array:
    """Heights (k,) that are scanned before any contact is known, one beyond either end of the body included.

    Adaptive spacing starts with a few of the heights of cosine spacing; with those of all slices, if from then on all were
    along this one of several axes, where the contacts along all of them are looked at `together`.
    """
    adaptive, axes = plan.spacing == "adaptive", len(plan.axes()) if together else 1
    few = min(FIRST_TOGETHER, plan.slices) if together else FIRST_SLICES
    cosine = replace(plan, slices=axes * plan.slices - (axes - 1) * few, spacing="cosine")
    inside = heights(low, high, cosine if adaptive else plan)
    beyond = max(float(inside[0]) - low, LEAST_OVERSHOOT * (high - low))
    if adaptive:
        inside = inside[np.unique(np.linspace(0, len(inside) - 1, few).round().astype(np.intp))]
    return np.concatenate([inside, [low - beyond, high + beyond]])


@dataclass
class SlabMemory:
    """Slices, slabs and gaps that the last call of `next_heights` has computed, for the next call with the same cloud grown."""

    slices: dict[float, Slice] = field(default_factory=dict)
    """By their heights, with what has been computed of their outlines."""
    slabs: dict[SlabKey, Slab] = field(default_factory=dict)
    gaps: dict[SlabKey, Array] = field(default_factory=dict)
    """(w,) distances of each slab's corners from the hull of the contacts in the first call with that slab: upper bounds of the
    present ones, because the hull only grows; (1,) infinite where the slab is unbounded."""

    def measured(self, stack: SliceStack, others: Sequence[Array]) -> tuple[list[Slab], Array]:
        """The slabs of a stack, and the gaps (w,) of all corners: of new slabs, from the hull of the two slices on
        either side, of a few of the others, and of the contours (v, 3) of slices along other axes."""
        for slice_ in stack.slices:
            before = self.slices.get(slice_.height)
            if before is None or not np.array_equal(before.rows, slice_.rows):
                self.slices[slice_.height] = slice_
        stack = replace(stack, slices=tuple(self.slices[slice_.height] for slice_ in stack.slices))
        parts, keys = slabs(stack, known=self.slabs), slab_keys(stack)
        new = np.flatnonzero([key not in self.gaps for key in keys])
        beside = (new[:, None] + np.arange(-2, 2)).clip(0, len(stack.slices) - 1)
        chosen = np.union1d(beside, evenly(np.arange(len(stack.slices)), FIRST_SLICES))
        distances = distance_from_hull(np.concatenate([*others, *(stack.contour(i) for i in chosen)]))
        for i in new:
            bounded = np.isfinite(parts[i].corners).all()
            self.gaps[keys[i]] = distances(parts[i].corners) if bounded else np.full(1, np.inf)
        self.slabs, self.gaps = {key: self.slabs[key] for key in keys}, {key: self.gaps[key] for key in keys}
        return parts, np.concatenate([self.gaps[key] for key in keys])


def next_heights(
    cloud: Cloud,
    axis: Array,
    left: int,
    *,
    tolerance: float = 0.0,
    count: int | None = None,
    memory: SlabMemory | None = None,
) -> Array:
    """Heights (k,) of the slices to be swept next along an axis: where the contacts so far leave most room for the body.

    cloud
        the contacts so far, and their slices, including those in which nothing was touched.
    axis (3,)
        unit normal of the slices.
    left
        number of slices that may still be swept, at least one.
    tolerance
        that of the plan, at which no more are needed.
    count
        number of heights in this call; by default a part of the slices so far, and of those that are left.
    memory
        speeds up repeated calls for the same scan; filled by this function.

    Returns an empty array if the tolerance is met, or where contacts leave as much open in the planes of slices, so that more
    slices would add no information.  Raises InputError if there are no contacts along the axis, or if they span no body.
    """
    memory = memory or SlabMemory()
    candidates = stacks(cloud)
    stack = next((stack for stack in candidates if np.abs(stack.frame[2] - axis).max() < 1e-6), None)
    if stack is None:
        raise InputError("no slice along this axis has contacts; scan more slices")
    done = int((np.abs(cloud.slice_axis - stack.frame[2]).max(axis=1) < SAME_AXIS).sum())
    others = [other.contour(i) for other in candidates if other is not stack for i in range(len(other.slices))]
    parts, gap = memory.measured(stack, others)
    kind, corners, straight = (
        np.concatenate([getattr(slab, name) for slab in parts]) for name in ("kind", "corners", "straight")
    )
    number = np.repeat(np.arange(len(parts)), [len(slab.corners) for slab in parts])
    enough = tolerance * float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    if gap.max() <= enough:
        return np.empty(0)
    between = np.isfinite(gap) & (kind != Gap.CONTACTS)
    if not cloud.noise:
        in_plane = np.zeros(len(parts))
        np.maximum.at(in_plane, number, np.where(kind == Gap.CONTACTS, gap, 0.0))
        # to which corners the body goes on straight is known where slabs are thicker than what the contacts leave open
        vertex = straight.all(axis=1) & (in_plane < np.diff(_levels(stack)))[number]
        # a gap that is hardly wider than what contacts leave open in the planes of its slab is due to them
        between &= vertex | (gap > 1.01 * in_plane[number])
        enough = max(enough, float(np.median(in_plane)))
    if not between.any():
        return np.empty(0)
    number, gap, straight = number[between], gap[between], straight[between]
    # bent everywhere is what goes on straight to few of the corners with gaps that count
    bent = bool(straight[gap >= gap.max() / 100].any(axis=1).mean() < 0.1)
    if count is None:
        # vertices are found one after another, until there are many slices, of which the last ones are chosen together
        of_done, of_left = (0.3, 1 / 2) if bent or done >= 128 else (0.12, 1 / 3)
        last = done // 20 if done >= 128 else 0
        count = max(1, min(round(of_done * done), int(of_left * left) + last))
    at = corners[between] @ stack.frame[2]
    return cuts(_levels(stack), number, at, gap, straight.all(axis=1), count, enough, left if bent else None)


def cuts(
    known: Array,
    slab: Index,
    corner: Array,
    gap: Array,
    straight: Mask,
    count: int,
    enough: float = 0.0,
    left: int | None = None,
) -> Array:
    """Heights (k,) that cut the slabs with the largest gaps.

    known (s,)
        heights that have been scanned, rising, with those of the nearest empty slices at both ends.
    slab, corner, gap, straight (w,)
        the outer body's corners: number of the known height below each, the corner's own height, its distance from the inner
        body, and whether the body goes on straight to it.
    count
        number of heights wanted; there are more only if the last slab gets several.
    enough
        gap that is small enough.
    left
        number of heights that may be chosen in this call and all later ones, of bodies that are bent everywhere; without it,
        bent slabs are halved.

    A slab is judged by its worst corner, and cut there if the body goes on straight to it.  Bent slabs are divided into as many
    parts as make the largest gap least; a slab that needs few gets all of them, another one is cut between their lower and
    their upper half.  A corner on an empty slice means only that the body ends before it, and a corner on an end slice only
    that the body may end right behind it; there the new height is in the middle of the slab.
    """
    near = CLOSEST * (known[-1] - known[0])
    widest = np.zeros(len(known) - 1)
    np.maximum.at(widest, slab, gap)
    # of corners that are equal up to rounding, as in symmetric bodies, the lowest of those to which the body goes on straight
    order = np.lexsort((corner, ~straight, -_tied(gap), slab))
    worst = order[np.unique(slab[order], return_index=True)[1]]
    worst = worst[gap[worst] > max(enough, near)]
    slab, corner, gap, straight = slab[worst], corner[worst], gap[worst], straight[worst]
    low, high, first, last = known[slab], known[slab + 1], slab == 0, slab == len(known) - 2
    end, beyond = np.where(first, high, low), np.where(first, low, high)
    depth = ratio(corner - end, beyond - end)
    depth = np.where(depth > 1 - CLOSEST, 0.5, np.where(straight, AT_VERTEX, AT_POLE) * depth)
    on_slice = np.minimum(corner - low, high - corner) <= near
    at_corner = np.where(first | last, end + depth * (beyond - end), corner)

    bent = ~(first | last) & (~straight | on_slice)
    even = np.where(bent, np.concatenate([[0.0], evened(widest[1:-1]), [0.0]])[slab], gap)
    parts = least_parts(even, left or 0, np.where(bent & (left is not None), np.inf, 2), enough)
    pieces = np.where(bent & (parts <= AT_ONCE), parts, 2)
    # (AT_ONCE - 1, n) numbers of the parts below the cuts
    cut = np.arange(1, AT_ONCE)[:, None]
    below = np.minimum(cut * parts // pieces, parts - 1) / parts
    at = np.where(bent, cuts_at(known, slab, np.where(bent, np.sqrt(even), np.nan), below), at_corner)
    wanted = (cut < pieces) & (np.minimum(at - low, high - at) > near)
    # of slabs that are equal up to rounding, as in symmetric bodies, the lowest first
    widest_first = np.argsort(-_tied(gap), kind="stable")
    at, wanted = at[:, widest_first], wanted[:, widest_first]
    numbers = wanted.sum(axis=0)
    wanted &= np.cumsum(numbers) - numbers < count
    return at.T[wanted.T][:left]


def _levels(stack: SliceStack) -> Array:
    """The heights of a stack with those of the nearest empty slices at both ends; an end that nothing bounds is its slice."""
    ends = (stack.floor, stack.heights[0]), (stack.ceiling, stack.heights[-1])
    low, high = (end if np.isfinite(end) else nearest for end, nearest in ends)
    return np.array([low, *stack.heights, high])


def _tied(gaps: Array) -> Array:
    """The roots of gaps (n,) over the largest, those that are equal up to rounding made equal."""
    return np.round(np.sqrt(gaps / gaps.max(initial=1e-300)), _TIED_DECIMALS)


def least_parts(gaps: Array, left: int, most: Array, enough: float = 0.0) -> Array:
    """Numbers of parts (n,), at least 2, into which `left` cuts divide slabs so that their largest gap is least.

    gaps (n,)
        of the undivided slabs; they fall with the square of the number of parts.
    most (n,)
        largest numbers of parts; the gaps of slabs that have them count no more.
    enough
        gap below which no slab is divided further.
    """
    root = np.sqrt(gaps)
    low, high = float(np.sqrt(enough)), float(root.max(initial=0.0))
    for _ in range(60):
        middle = (low + high) / 2
        fits = middle > 0 and (np.minimum(np.ceil(root / middle), most) - 1).clip(0).sum() <= left
        low, high = (low, middle) if fits else (middle, high)
    # slabs that are equal up to rounding, as in symmetric bodies, get equal numbers
    parts = np.ceil(np.round(root / high, _TIED_DECIMALS)) if high else np.ones(len(root))
    return np.minimum(parts, most).clip(2)


def cuts_at(known: Array, slab: Index, roots: Array, below: Array) -> Array:
    """Heights (k, n) with the fractions `below` (k, n) of the slices to come in a slab below them.

    known (s,)
        heights that have been scanned, as in `cuts`.
    slab, roots (n,)
        the slabs' numbers, rising, and the roots of their gaps; NaN where the body is not bent.

    The density of slices is that of the root of the gap over the angle on a sphere of the body's height.  It is taken to
    change linearly between the middles of neighbouring slabs; where a neighbour's is not known, it is constant.
    """
    # the body ends somewhere between its end slices and the empty ones
    bottom, top = (known[0] + known[1]) / 2, (known[-2] + known[-1]) / 2
    angles = np.arccos(np.clip(1 - 2 * (known - bottom) / (top - bottom), -1.0, 1.0))
    low, high = angles[slab], angles[slab + 1]
    density = ratio(roots, high - low)
    before = np.where(np.diff(slab, prepend=-2) == 1, np.roll(density, 1), np.nan)
    after = np.where(np.diff(slab, append=-2) == 1, np.roll(density, -1), np.nan)
    a, b = ((density + np.where(np.isnan(near), density, near)) / 2 for near in (before, after))
    # the fraction u with a u + (b - a) u²/2 = below (a + b)/2, without a difference of nearly equal numbers
    at = low + (high - low) * below * (a + b) / (a + np.sqrt(a * a * (1 - below) + b * b * below))
    return bottom + (top - bottom) * (1 - np.cos(at)) / 2


def evened(gaps: Array) -> Array:
    """Gaps (n,) that slabs would have if the neighbours of each one had the same gap.

    gaps (n,)
        of the slabs between two slices, from the lowest to the highest.

    The half-spaces that bound a slab are those of the secants through its neighbours.  Where contours have the curvature k, a
    slab of thickness w between neighbours of thicknesses a and b has its corner at the distance
    k w (w + a) (w + b) / (2 (2 w + a + b)) from the inner body; with even neighbours at k w²/2.  Thicknesses are measured by
    the root of the even gap, so that the curvature is 2 everywhere; those of the slabs beyond the end slices are 0.
    """
    own = np.sqrt(gaps).clip(1e-100)
    roots = own
    for _ in range(20):  # to rounding
        a, b = np.pad(roots, (1, 0))[:-1], np.pad(roots, (0, 1))[1:]
        roots = own * np.sqrt((2 * roots + a + b) * roots / ((roots + a) * (roots + b)))
    return roots**2


def open_contours(cloud: Cloud, tolerance: float) -> tuple[Array, float]:
    """Heights (k,) of the slices whose contours need more contacts, and the largest gap between two contacts of one contour.

    cloud
        contacts of slices along one axis.
    tolerance
        relative to the diagonal: how far the body may reach, in the plane of a slice, beyond the hull of the contacts.

    The gap is in the cloud's unit.  Raises InputError if the contacts span no body.
    """
    bounds = slice_enclosure(cloud)
    assert bounds.slabs is not None
    diagonal = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    in_plane = (bounds.slabs.kind == Gap.CONTACTS) & np.isfinite(bounds.gap)
    wide = in_plane & (bounds.gap > tolerance * diagonal)
    heights, at = bounds.slabs.stack.heights, bounds.corners[wide] @ bounds.slabs.stack.frame[2]
    nearest = np.abs(at[:, None] - heights).argmin(axis=1)
    return heights[np.unique(nearest)], float(bounds.gap[in_plane].max(initial=0.0))


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
    tolerance = max(plan.tolerance, CLOSEST) * size
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
        along = by_axis[axis].frame[2]
        further = next_heights(cloud, along, left, tolerance=plan.tolerance)
        if len(further):
            return Further([(along, further)])
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
    found = cells_of_cloud(cloud, hull(cloud.points))
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
        near = np.abs(cloud.points @ planes[:, :3].T + planes[:, 3]) < CLOSEST * size
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


FIRST_PART, FEW = 3 / 8, 64
"""Part of the slices, of so many at most, that go along one axis first, by which a body proves a polyhedron."""


class Aims:
    """The corners at which slices of a body were aimed: at none of them again before all others."""

    def __init__(self) -> None:
        self._outer: Array | None = None
        self._corners, self._rounds = np.empty((0, 3)), 0

    def next_slices(self, cloud: Cloud, plan: Plan, left: int) -> Further:
        """The slices to be swept next, as `next_slices`: alone along one axis if contacts show no polyhedron."""
        inner, size = hull(cloud.points), float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
        if plan.tolerance and enclosure(cloud).bound <= plan.tolerance * size:
            return Further([])
        if self._outer is None:
            self._outer = slice_enclosure(cloud).corners
        within = inner.vertices.view(np.ndarray)
        known = polyhedron(cloud, within, np.concatenate([within, self._outer]))
        # the share of the contacts on known facets rises from round to round: of polyhedra of 200 vertices it is 0.87,
        # 0.92 and 1, of a scanned aeroplane of slivers 0.87 to 0.9 in all rounds
        if known.share < min(0.8 + 0.075 * self._rounds, POLYHEDRON):
            return Further([], cloud.slice_axis[0])
        self._rounds += 1
        vertices, corners = known.corners[known.vertex], known.corners[~known.vertex]
        gap, _, foot = nearest(corners, hull(np.concatenate([cloud.points, vertices])))
        aimed = (np.linalg.norm(corners[:, None] - self._corners, axis=2) <= CLOSEST * size).sum(axis=1)
        # the gap of a corner counts less each time that it was aimed at
        gap = np.append(gap * 0.25**aimed, nearest(vertices, inner)[0])
        is_new = np.pad(aimed == 0, (0, len(vertices)))
        corners, places = np.concatenate([corners, vertices]), np.concatenate([(corners + foot) / 2, vertices])
        order = np.lexsort((-gap, ~is_new))
        order = order[gap[order] > CLOSEST * size]
        order = order[np.unique(representatives(corners[order], CLOSEST * size))]
        corners, places = corners[order], places[order]
        planes: list[Array] = []
        while len(places) and len(planes) < min(3, left):
            normals = np.concatenate([cloud.slice_axis, np.reshape(planes, (-1, 4))[:, :3]])
            plane, through = _plane_of(places, cloud.points, normals, size)
            planes += [] if plane is None else [plane]
            self._corners = np.concatenate([self._corners, corners[through]])
            corners, places = np.delete(corners, through, axis=0), np.delete(places, through, axis=0)
        return Further([(plane[:3], plane[3:]) for plane in planes])


def _plane_of(places: Array, points: Array, normals: Array, size: float) -> tuple[Array | None, list[int]]:
    """The plane (4,) through the first of some places and two others that parts points (n, 3) most evenly, and the places.

    No plane where all would be nearly parallel to slices with `normals` (s, 3), or pass by most of the body.
    """
    others = places[1:11] if len(places) > 2 else np.concatenate([places[1:], evenly(points, 10)])
    i, j = np.triu_indices(len(others), 1)
    across = np.cross(others[i] - places[0], others[j] - places[0])
    normal = unit(across)
    turn = np.minimum(*(np.abs(normal[:, None] + s * normals).max(axis=2).min(axis=1) for s in (-1, 1)))
    height = (points - places[0]) @ normal.T
    side = np.minimum(height.max(axis=0), -height.min(axis=0)) / np.ptp(height, axis=0)
    side[~((np.linalg.norm(across, axis=1) > 0.01 * size**2) & (turn > 0.01))] = 0.0
    best = int(side.argmax())
    if not side[best] > 0.1:
        return None, [0]
    through = [k for k in (0, 1 + int(i[best]), 1 + int(j[best])) if k < len(places)]
    return np.append(normal[best], normal[best] @ places[0]), through
