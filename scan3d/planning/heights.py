"""Heights of the slices: spaced by a rule, or chosen where the enclosure of the body is widest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.bounds.enclosures import slice_enclosure
from scan3d.bounds.slabs import Gap
from scan3d.cloud import Cloud
from scan3d.planning.plan import Plan
from scan3d.planning.sharing import AT_ONCE, TIED_DECIMALS, cuts_at, evened, least_parts, parts_within

# Slices inside the body with which adaptive spacing starts.  More are placed without knowing the body; with fewer, the first
# heights are chosen by loose bounds.
FIRST_SLICES = 8
FEW_STRAIGHT = 0.1
"""A body, or a slab, counts as smooth if the body goes on straight behind less than this fraction of the outer body's
corners.  Larger, edges are sliced without regard to where they are; smaller, heights for smooth bodies are chosen one by one,
which leaves some gaps wider than others."""
BEYOND = 2
"""Slices beyond the ends of the body that every spacing adds to the slices of a plan."""
# Lower bound, as a fraction of the body's height, of the distance of the slices beyond the ends, which is that of the end
# slices from the ends.  Larger, the caps of closely spaced scans are bounded more loosely; smaller, rounding could decide
# whether the slice is empty.
LEAST_OVERSHOOT = 1e-4
# Weight of a gap in a cap relative to one in another slab, because the body is known least beyond its end slices.  Larger,
# slices are spent on the ends of the body; smaller, on its middle.
_CAP_WEIGHT = 1.5
# Heights of slices and of cosine spacing are equal if they differ by less than this fraction of the height.  Larger, heights
# that were chosen by edges count as those of cosine spacing; smaller, the digits of a robot's poses make them different.
_SAME_HEIGHT = 1e-5
# Where a cap is sliced, as a fraction of the distance from its end slice to its worst corner: just before the tip of a
# vertex, and at about a third at a smooth pole, whose cap is shallower than its corner.  Larger, the slice may be empty;
# smaller, the cap that remains is larger.
AT_VERTEX, _AT_POLE = 0.98, 0.35
# A worst corner counts as lying on the empty slice if it is nearer than this fraction of the cap's height.  Larger, corners
# of real caps would count as unknown ends; smaller, rounding would decide.
_ON_EMPTY_SLICE = 1e-9
# Slices closer to each other than this fraction of the height add no information.  Larger, the heights of two close vertices
# could not be told apart; smaller, slopes between two slices are rounding.
CLOSEST = 1e-7
NO_GAP = 1e-10
"""Gaps below this fraction of the height are rounding.  Larger, gaps remain that further slices would close; smaller, slices
are spent on rounding."""
# Part of the slices left that are kept for slabs around which the body does not bend everywhere, in as far as slabs are such.
# Larger, slabs are cut into fewer parts at once than they need; smaller, no slices are left for edges that are found late.
_KEPT = 0.5


def heights(low: float, high: float, plan: Plan) -> Array:
    """Heights (slices,) between the ends of the body; those of cosine spacing are Chebyshev's nodes."""
    fraction = (np.arange(plan.slices) + 0.5) / plan.slices
    if plan.spacing == "cosine":
        fraction = (1 - np.cos(np.pi * fraction)) / 2
    return low + (high - low) * fraction


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
