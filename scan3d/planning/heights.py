"""Heights of the slices: spaced by a rule, or chosen where the contacts so far leave most room for the body.

This module knows no simulation: a simulated scan and a real rig both ask it for heights, sweep there, and ask again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.bounds.cells import Gap, Slab, SlabKey, slab_keys, slabs
from scan3d.bounds.enclosures import slice_enclosure
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.geometry.hulls import distance_from_hull
from scan3d.planning.aims import cosine_fractions
from scan3d.planning.plan import Plan
from scan3d.reconstruction.slices import SliceStack, stacks

# Slices inside the body with which adaptive spacing starts.
FIRST_SLICES = 8
FEW_STRAIGHT = 0.1
"""A body, or a slab, counts as smooth if the body goes on straight behind less than this fraction of the outer body's
corners."""
BEYOND = 2
"""Slices beyond the ends of the body that every spacing adds to the slices of a plan."""
# Lower bound, as a fraction of the body's height, of the distance of the slices beyond the ends, which is that of the end
# slices from the ends.
LEAST_OVERSHOOT = 1e-4
# Weight of a gap in a cap relative to one in another slab, because the body is known least beyond its end slices.
_CAP_WEIGHT = 1.5
# Heights of slices and of cosine spacing are equal if they differ by less than this fraction of the height.
_SAME_HEIGHT = 1e-5
# Where a cap is sliced, as a fraction of the distance from its end slice to its worst corner: just before the tip of a
# vertex, and at about a third at a smooth pole, whose cap is shallower than its corner.
AT_VERTEX, _AT_POLE = 0.98, 0.35
# A worst corner counts as lying on the empty slice if it is nearer than this fraction of the cap's height.
_ON_EMPTY_SLICE = 1e-9
# Slices closer to each other than this fraction of the height add no information.
CLOSEST = 1e-7
NO_GAP = 1e-10
"""Gaps below this fraction of the height are rounding."""
# Part of the slices left that are kept for slabs around which the body does not bend everywhere, in as far as slabs are such.
_KEPT = 0.5
TIED_DECIMALS = 4
"""Decimals of the gaps' roots, over the largest, by which slabs are compared, so that rounding decides nothing."""
AT_ONCE = 4
"""Largest number of parts into which a slab of a smooth body is cut at once."""
# Halvings of the interval in which the least gap lies: to rounding.
_BISECTIONS = 60
# Steps towards the gaps of slabs with even neighbours, and the least root of a gap.
_EVENINGS, _LEAST_ROOT = 20, 1e-100
# Fraction of the number of slices so far that is added in one round, and the smallest number of slices left for each height
# that it adds: of bodies that are bent nearly everywhere, and of others.
_GROWTH_OF_BENT, _LEFT_OF_BENT = 0.3, 2
_GROWTH, _LEFT_PER_HEIGHT = 0.12, 3
# Slices from which on rounds are that large for any body, and the fraction of the slices so far that the last rounds add even
# so.
_MANY, _LAST_ROUNDS = 128, 0.04
# Largest difference of the components of two unit normals that are the same axis: in the cloud, where slices along one axis
# have one normal up to rounding; and as given by the caller, who may have rounded them.
_SAME_AXIS, _GIVEN_AXIS = 1e-8, 1e-6
# Corners count for this if their gaps are wider than this fraction of the widest.
_WIDE = 0.01
# The heights of cosine spacing are taken if they leave at most this many times the gap of those that make it least, as far as
# the slices so far tell.
_AS_GOOD = 1.1
# Without a tolerance, all heights of cosine spacing that are left are taken at once if so many slices of the body are known,
# and no more are left than this multiple of them.
_WELL_KNOWN, _LEFT_PER_KNOWN = 24, 2
# Decimals of the axes in messages.
_AXIS_DECIMALS = 6


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


def cosine_heights_left(known: Array, parts: Index, slices: int, *, at_once: bool = False) -> Array:
    """Heights (k,) of cosine spacing that are still to be scanned, and that divide each slab into parts.

    known (s,)
        heights of the slices of the body, rising; the first and the last are the end slices of cosine spacing.
    parts (s - 1,)
        numbers of parts that the slabs between two slices need; those that need many are halved first.
    slices
        number of slices of cosine spacing.
    at_once
        all heights that are still to be scanned, whatever the parts.

    There are none if some of the known heights are others: the body has edges, by which those were chosen.
    """
    nodes = _cosine_nodes(known, slices)
    size = known[-1] - known[0]
    if np.abs(known[:, None] - nodes).min(axis=1).max() > _SAME_HEIGHT * size:
        return np.empty(0)
    near = CLOSEST * size
    chosen = []
    for low, high, needed in zip(known[:-1], known[1:], parts, strict=True):
        between = nodes[(nodes > low + near) & (nodes < high - near)]
        several = needed if needed <= AT_ONCE else 2
        cuts = len(between) + 1 if at_once else several
        at = np.arange(1, cuts) * (len(between) + 1) / cuts - 1
        chosen.append(between[np.unique(np.clip(np.round(at), 0, None).astype(np.intp))] if len(between) else between)
    return np.concatenate([np.empty(0), *chosen])


def cosine_gap(known: Array, gaps: Array, slices: int) -> float:
    """The largest gap that all heights of cosine spacing leave, if that of a slab falls with the square of its parts.

    known (s,), slices
        as in `cosine_heights_left`.
    gaps (s - 1,)
        of the slabs between two slices.
    """
    # each slab counts the node at its upper end
    upper = known[1:] + _SAME_HEIGHT * (known[-1] - known[0])
    parts = np.bincount(np.searchsorted(upper, _cosine_nodes(known, slices)[1:]), minlength=len(upper))
    return float((gaps / parts.clip(1) ** 2).max(initial=0.0))


def _cosine_nodes(known: Array, slices: int) -> Array:
    """Heights (slices,) of cosine spacing whose end slices are those of the known heights (s,)."""
    nodes = -np.cos(np.pi * (np.arange(slices) + 0.5) / slices)
    middle, half = (known[0] + known[-1]) / 2, (known[-1] - known[0]) / 2
    heights: Array = middle + half * nodes / nodes[-1]
    return heights


def heights_at_gaps(
    known: Array,
    slab: Index,
    corners: Array,
    gaps: Array,
    straight: Mask,
    count: int,
    tolerance: float = 0.0,
    left: int | None = None,
) -> Array:
    """Further heights (k,) where the enclosure of the body is widest.

    known (s,)
        heights that have been scanned, rising, with those of the nearest empty slices at both ends.
    slab, corners, gaps (w,), straight (w, 2)
        the outer body's corners: number of the known height below each, the corner's own height, its distance from the inner
        body, and whether the body goes on straight below and above its slab.
    count
        number of heights wanted; there are more only if the last slab gets several.
    tolerance
        gap that is small enough.
    left
        number of heights that may be chosen in this call and all later ones, of bodies that are bent nearly everywhere;
        without it, bent slabs are halved.

    A slab gets the height of its worst corner; in a polyhedron that is the height of a vertex.  In a slab along which the body
    bends everywhere, the gap falls with the square of the number of parts into which further slices divide the slab.  From
    this follows how many parts of which slab make the largest gap least.  A slab that needs few parts, and around which the
    body bends everywhere, gets all of its heights; another one gets that between the lower and the upper half of its parts.  A
    corner on an empty slice means only that the body ends before it, and a corner on an end slice only that the body may end
    right behind it; there the new height is in the middle of the slab.
    """
    size = known[-1] - known[0]
    creases = straight[:, 0] & straight[:, 1]
    widest = np.zeros(len(known) - 1)
    np.maximum.at(widest, slab, gaps)
    # of corners that are equal up to rounding, as in symmetric bodies, the lowest of those where the body goes on straight
    order = np.lexsort((corners, ~creases, -np.round(gaps / gaps.max(initial=1e-300), TIED_DECIMALS), slab))
    worst = order[np.unique(slab[order], return_index=True)[1]]
    worst = worst[gaps[worst] > max(tolerance, NO_GAP * size)]
    straight_part = np.bincount(slab, straight.any(axis=1)) / np.bincount(slab).clip(1)
    slab, corner, crease = slab[worst], corners[worst], creases[worst]
    around = straight_part[slab] < FEW_STRAIGHT
    low, high = known[slab], known[slab + 1]
    first, last = slab == 0, slab == len(known) - 2
    weight = np.sqrt(np.where(first | last, _CAP_WEIGHT, 1.0) * gaps[worst])

    single = _at_corners(corner, crease, low, high, first, last, CLOSEST * size)
    bent = ~(first | last | crease)
    even = np.where(bent, np.concatenate([[0.0], evened(widest[1:-1]), [0.0]])[slab], weight**2)
    new, wanted = _divided(known, slab, single, even, bent, around, tolerance, left)
    wanted &= np.minimum(new - low, high - new) > CLOSEST * size
    # of slabs that are equal up to rounding, as in symmetric bodies, the lowest first
    widest_first = np.argsort(-np.round(weight / weight.max(initial=1e-300), TIED_DECIMALS), kind="stable")
    new, wanted = new[:, widest_first], wanted[:, widest_first]
    numbers = wanted.sum(axis=0)
    wanted &= np.cumsum(numbers) - numbers < count
    chosen: Array = new.T[wanted.T]
    return chosen if left is None else chosen[:left]


def _divided(
    known: Array, slab: Index, single: Array, even: Array, bent: Mask, around: Mask, tolerance: float, left: int | None
) -> tuple[Array, Mask]:
    """Heights (AT_ONCE - 1, n) that divide slabs, and which of them are to be swept.

    known (s,), slab (n,), tolerance, left
        as in `heights_at_gaps`.
    single, even (n,)
        the height of a slab that is not bent, and the gaps that the slabs would have with even neighbours.
    bent, around (n,)
        whether the body is bent at a slab's worst corner, and all around the slab.
    """
    most = np.where(bent & (left is not None), parts_within(even, tolerance), 2)
    kept = _KEPT * float(np.mean(~around[bent])) if bent.any() else 0.0
    parts = least_parts(even, (1 - kept) * (left or 0), most)[0].clip(2)
    whole = bent & around & (parts <= AT_ONCE)
    # (AT_ONCE - 1, n) numbers of the parts below the cuts
    below = np.arange(1, AT_ONCE)[:, None] * np.where(whole, 1, parts // 2)
    cuts = cuts_at(known, slab, np.where(bent, np.sqrt(even), np.nan), np.minimum(below / parts, 1.0))
    new = np.where(bent, cuts, single)
    wanted = np.where(whole, below < parts, (np.arange(AT_ONCE - 1) == 0)[:, None])
    return new, wanted


def _at_corners(corner: Array, crease: Mask, low: Array, high: Array, first: Mask, last: Mask, near: float) -> Array:
    """Heights (n,) of the worst corners, or where a slab is cut whose corner is none of the body's.

    corner, crease (n,)
        the corners' heights, and whether the body goes on straight on both sides of them.
    low, high, first, last (n,)
        the slabs' ends, and whether these are the caps below and above all slices of the body.
    near
        a corner is on a slice if it is no farther from it.
    """
    end, beyond = np.where(first, high, low), np.where(first, low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (corner - end) / (beyond - end)
    into_cap = np.where(depth > 1 - _ON_EMPTY_SLICE, 0.5, np.where(crease, AT_VERTEX, _AT_POLE) * depth)
    in_cap = end + into_cap * (beyond - end)
    on_slice = np.minimum(corner - low, high - corner) <= near
    chosen: Array = np.where(first | last, in_cap, np.where(on_slice, (low + high) / 2, corner))
    return chosen


def parts_within(gaps: Array, tolerance: float) -> Index:
    """Numbers of parts (n,) into which slabs with gaps (n,) are cut to come within a tolerance; without one, many."""
    if not tolerance:
        return np.full(len(gaps), np.iinfo(np.int32).max, dtype=np.intp)
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(np.ceil(np.sqrt(gaps / tolerance)), posinf=np.iinfo(np.int32).max).astype(np.intp)


def least_parts(gaps: Array, left: float, most: Array | float = np.inf) -> tuple[Array, float]:
    """Numbers of parts (n,) into which `left` slices divide slabs so that their largest gap is least, and that gap.

    gaps (n,)
        of the undivided slabs; they fall with the square of the number of parts.
    most (n,)
        largest numbers of parts; the gaps of slabs that have them count no more.
    """
    root = np.sqrt(gaps)
    low, high = 0.0, float(root.max(initial=0.0))
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        enough = middle > 0 and (np.minimum(np.ceil(root / middle), most) - 1).clip(0).sum() <= left
        low, high = (low, middle) if enough else (middle, high)
    # slabs that are equal up to rounding, as in symmetric bodies, get equal numbers
    parts = np.minimum(np.ceil(np.round(root / high, TIED_DECIMALS)), most).clip(1) if high else np.ones(len(root))
    return parts, high**2


def cuts_at(known: Array, slab: Index, roots: Array, below: Array) -> Array:
    """Heights (k, n) with the fractions `below` (k, n) of the slices to come in a slab below them.

    known (s,)
        heights that have been scanned, as in `heights_at_gaps`.
    slab, roots (n,)
        the slabs' numbers, rising, and the roots of their gaps; NaN where the body is not bent.

    The density of slices is that of the root of the gap over the angle on a sphere of the body's height.  It is taken to
    change linearly between the middles of neighbouring slabs; where a neighbour's is not known, it is constant.
    """
    # the body ends somewhere between its end slices and the empty ones
    bottom, top = (known[0] + known[1]) / 2, (known[-2] + known[-1]) / 2
    angles = np.arccos(np.clip(1 - 2 * (known - bottom) / (top - bottom), -1.0, 1.0))
    low, high = angles[slab], angles[slab + 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        density = roots / (high - low)
    before = np.where(np.diff(slab, prepend=-2) == 1, np.roll(density, 1), np.nan)
    after = np.where(np.diff(slab, append=-2) == 1, np.roll(density, -1), np.nan)
    a, b = ((density + np.where(np.isnan(near), density, near)) / 2 for near in (before, after))
    # the fraction u with a u + (b - a) u²/2 = below (a + b)/2, without a difference of nearly equal numbers
    at = low + (high - low) * below * (a + b) / (a + np.sqrt(a * a * (1 - below) + b * b * below))
    cuts: Array = bottom + (top - bottom) * (1 - np.cos(at)) / 2
    return cuts


def evened(gaps: Array) -> Array:
    """Gaps (n,) that slabs would have if the neighbours of each one had the same gap.

    gaps (n,)
        of the slabs between two slices, from the lowest to the highest.

    The half-spaces that bound a slab are those of the secants through its neighbours.  Where contours have the curvature k, a
    slab of thickness w between neighbours of thicknesses a and b has its corner at the distance
    k w (w + a) (w + b) / (2 (2 w + a + b)) from the inner body; with even neighbours at k w²/2.  Thicknesses are measured by
    the root of the even gap, so that the curvature is 2 everywhere; those of the slabs beyond the end slices are 0.
    """
    own = np.sqrt(gaps).clip(_LEAST_ROOT)
    roots = own
    for _ in range(_EVENINGS):
        a, b = np.pad(roots, (1, 0))[:-1], np.pad(roots, (0, 1))[1:]
        roots = own * np.sqrt((2 * roots + a + b) * roots / ((roots + a) * (roots + b)))
    even: Array = roots**2
    return even


Distances = Callable[[Array], Array]
"""From points (w, 3) to their distances (w,) from the hull of the contacts."""


@dataclass
class SlabMemory:
    """Slices, slabs and gaps that the last call of `next_heights` has computed, for the next call with the same cloud grown."""

    stacks: list[SliceStack] = field(default_factory=list)
    """The slices, which the next call finds in use."""
    slabs: dict[SlabKey, Slab] = field(default_factory=dict)
    gaps: dict[SlabKey, Array] = field(default_factory=dict)
    """(w,) distances of each slab's corners from the hull of the contacts in the first call with that slab: upper bounds of the
    present ones, because the hull only grows; (1,) infinite where the slab is unbounded."""

    def measured(self, stack: SliceStack, distances: Distances) -> tuple[list[Slab], Array]:
        """The slabs of a stack, and the gaps (w,) of all corners: of new slabs, by the distances."""
        parts, keys = slabs(stack, known=self.slabs, volumes=False), slab_keys(stack)
        for key, slab in zip(keys, parts, strict=True):
            if key not in self.gaps:
                bounded = np.isfinite(slab.corners).all()
                self.gaps[key] = distances(slab.corners) if bounded else np.full(1, np.inf)
        self.slabs, self.gaps = {key: self.slabs[key] for key in keys}, {key: self.gaps[key] for key in keys}
        return parts, np.concatenate([self.gaps[key] for key in keys])


def next_heights(
    cloud: Cloud,
    plan: Plan,
    *,
    axis: Array | None = None,
    left: int | None = None,
    memory: SlabMemory | None = None,
) -> Array:
    """Heights (k,) of the slices to be swept next along an axis: where the contacts so far leave most room for the body.

    cloud
        the contacts so far, and their slices, including those in which nothing was touched.
    plan
        its `slices` (number of slices along the axis) and its `tolerance` say when to stop.
    axis (3,)
        normal of the slices; needed only if the cloud has slices along several axes.
    left
        number of slices that may still be swept; by default `plan.slices` and the two beyond the ends, less the cloud's
        slices along the axis.
    memory
        speeds up repeated calls for the same scan; filled by this function.

    Returns an empty array if no slices are left, if the tolerance is met, or if further slices would add no information.
    Raises InputError if the axis is not among those of the cloud, or is not given where there are several, and if the contacts
    span no body.
    """
    memory = memory or SlabMemory()
    candidates = memory.stacks = stacks(cloud)
    stack = _stack(candidates, cloud, axis)
    done = int((np.abs(cloud.slice_axis - stack.frame[2]).max(axis=1) < _SAME_AXIS).sum())
    left = plan.slices + BEYOND - done if left is None else left
    if left <= 0:
        return np.empty(0)
    contours = np.concatenate([other.contour(i) for other in candidates for i in range(len(other.slices))])
    parts, gap = memory.measured(stack, distance_from_hull(contours))
    corners = np.concatenate([slab.corners for slab in parts])
    kind = np.concatenate([slab.kind for slab in parts])
    straight = np.concatenate([slab.straight for slab in parts])
    diagonal = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    if gap.max() <= plan.tolerance * diagonal:
        return np.empty(0)
    between = np.isfinite(gap) & (kind != Gap.CONTACTS)
    number = np.repeat(np.arange(len(parts)), [len(slab.corners) for slab in parts])
    tolerance = plan.tolerance * diagonal
    bent = _nearly_all_bent(gap[between], straight[between])
    if bent:
        widest = np.zeros(len(parts))
        np.maximum.at(widest, number, gap)
        further = _cosine_heights(np.array(stack.heights), widest[1:-1], plan.slices, tolerance, left)
        if len(further) or not between.any():
            return further[:left]
    number = number[between]
    ends = (stack.floor, stack.heights[0]), (stack.ceiling, stack.heights[-1])
    # an end that nothing bounds gets no height
    low, high = (end if np.isfinite(end) else nearest for end, nearest in ends)
    levels = np.array([low, *stack.heights, high])
    at = corners[between] @ stack.frame[2]
    count = _heights_of_round(plan.slices - left, left, bent=bent)
    return heights_at_gaps(
        levels, number, at, gap[between], straight[between], count, tolerance, left if bent else None
    )


def _nearly_all_bent(gaps: Array, straight: Mask) -> bool:
    """Whether the body is bent at nearly all corners that are still open; their gaps (w,) and where it is straight (w, 2)."""
    wide = gaps > _WIDE * gaps.max(initial=0.0)
    return not wide.any() or bool(straight[wide].any(axis=1).mean() < FEW_STRAIGHT)


def _heights_of_round(done: int, left: int, *, bent: bool) -> int:
    """Number of heights that a round adds to those that are done; `bent` says whether the body is bent nearly everywhere."""
    growth, each = (_GROWTH_OF_BENT, _LEFT_OF_BENT) if bent or done >= _MANY else (_GROWTH, _LEFT_PER_HEIGHT)
    least = int(_LAST_ROUNDS * done) if done >= _MANY else 1
    return max(1, min(round(growth * done), left // each), min(least, left))


def _cosine_heights(known: Array, gaps: Array, slices: int, tolerance: float, left: int) -> Array:
    """Heights (k,) of cosine spacing that are still to be swept in slabs with gaps (s - 1,); none if others are better."""
    if not (gaps > NO_GAP * (known[-1] - known[0])).any():  # a prism along the axis: its ends alone are not known
        return np.empty(0)
    if np.isfinite(gaps).all():
        gaps = evened(gaps)
        if cosine_gap(known, gaps, slices) > _AS_GOOD * least_parts(gaps, left)[1]:
            return np.empty(0)
    at_once = not tolerance and len(known) >= _WELL_KNOWN and left <= _LEFT_PER_KNOWN * len(known)
    return cosine_heights_left(known, parts_within(gaps, tolerance), slices, at_once=at_once)


def _stack(candidates: list[SliceStack], cloud: Cloud, axis: Array | None) -> SliceStack:
    """That of the cloud's stacks along an axis."""
    if axis is not None:
        unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
        candidates = [stack for stack in candidates if np.abs(stack.frame[2] - unit).max() < _GIVEN_AXIS]
    if len(candidates) != 1:
        normals = np.unique(np.round(cloud.slice_axis, _AXIS_DECIMALS), axis=0) + 0.0  # -0 becomes 0
        axes = ", ".join(str(tuple(map(float, row))) for row in normals)
        raise InputError(
            f"next heights are chosen along one axis, and the cloud has contacts in slices along {axes}; give one of them "
            f"as axis, got {axis if axis is None else tuple(np.asarray(axis).tolist())}"
        )
    return candidates[0]


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
