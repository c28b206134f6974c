"""Slices that follow: spaced by a rule, or chosen where the contacts so far leave most room for the body.

This module knows no simulation: a simulated scan and a real rig both ask it for slices, sweep there, and ask again.

What contacts leave open between slices is widest at a corner of the outer body.  Where the body goes on straight to it,
a vertex or an edge ends there, and one slice through it closes the gap.  Elsewhere the body is bent, and the gap falls with the
square of the distance between the slices.  So slabs with the largest gaps are cut, through their
corners or into as many parts as make the largest gap least, until the gaps are within the tolerance, or as narrow as what the
contacts of a slice leave open in its plane, which further slices do not close.

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
from scan3d.bounds.enclosures import slice_enclosure
from scan3d.bounds.slabs import Gap, Slab, SlabKey, slab_keys, slabs
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import distance_from_hull, hull
from scan3d.geometry.triangles import representatives
from scan3d.planning.plan import Plan, cosine_fractions
from scan3d.reconstruction.facets import POLYHEDRON, polyhedron
from scan3d.reconstruction.slices import SAME_AXIS, Slice, SliceStack, stacks

FIRST_SLICES = 8
"""Slices inside the body with which adaptive spacing starts."""
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


def first_heights(low: float, high: float, plan: Plan) -> Array:
    """Heights (k,) that are scanned before any contact is known, one beyond either end of the body included.

    Adaptive spacing starts with a few of the heights of cosine spacing.
    """
    adaptive = plan.spacing == "adaptive"
    inside = heights(low, high, replace(plan, spacing="cosine") if adaptive else plan)
    beyond = max(float(inside[0]) - low, LEAST_OVERSHOOT * (high - low))
    if adaptive:
        inside = inside[np.unique(np.linspace(0, len(inside) - 1, FIRST_SLICES).round().astype(np.intp))]
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


class Further(NamedTuple):
    """What is to be swept next."""

    slices: list[tuple[Array, Array]]
    """Axes (3,) and heights (k,)."""
    alone: Array | None = None
    """(3,) the axis of all slices that are left, which are best planned as those of a scan along it alone; else None."""


FIRST_PART, FEW = 3 / 8, 64
"""Part of the slices, of so many at most, that go along one axis first, by which a body proves a polyhedron."""


class Aims:
    """The corners at which slices of a body were aimed: at none of them again before all others."""

    def __init__(self) -> None:
        self._outer: Array | None = None
        self._corners, self._rounds = np.empty((0, 3)), 0

    def next_slices(self, cloud: Cloud, plan: Plan, left: int) -> Further:
        """The slices to be swept next, of which `left` may still be: alone along one axis if contacts show no polyhedron.

        cloud
            the contacts so far, exact ones, and their slices, also those in which nothing was touched.

        There are none if the plan's tolerance is met, or if further slices would add no information.  Raises InputError if the
        contacts span no body.
        """
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
