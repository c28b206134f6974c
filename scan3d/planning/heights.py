"""Heights of the slices: spaced by a rule, or chosen where the enclosure of the body is widest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.planning.plan import Plan

# Slices inside the body with which adaptive spacing starts.  More are placed without knowing the body; with fewer, the first
# heights are chosen by loose bounds.
FIRST_SLICES = 8
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
# Decimals of the gaps' roots, over the largest, by which slabs are compared.  More, and rounding decides between slabs of a
# symmetric body; fewer, and slabs count as equal that are not.
_TIED_DECIMALS = 6
# Where a cap is sliced, as a fraction of the distance from its end slice to its worst corner: just before the tip of a
# vertex, and at about a third at a smooth pole, whose cap is shallower than its corner.  Larger, the slice may be empty;
# smaller, the cap that remains is larger.
_AT_VERTEX, _AT_POLE = 0.98, 0.35
# A worst corner counts as lying on the empty slice if it is nearer than this fraction of the cap's height.  Larger, corners
# of real caps would count as unknown ends; smaller, rounding would decide.
_ON_EMPTY_SLICE = 1e-9
# Slices closer to each other than this fraction of the height add no information.  Larger, the heights of two close vertices
# could not be told apart; smaller, slopes between two slices are rounding.
CLOSEST = 1e-7
# Largest number of parts into which a slab of a smooth body is cut at once.  Larger, heights are chosen by gaps that are known
# poorly; smaller, slabs are halved that need three parts, which makes some parts smaller than they need be.
_AT_ONCE = 4


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


def cosine_heights_left(known: Array, parts: Index, slices: int) -> Array:
    """Heights (k,) of cosine spacing that are still to be scanned, and that divide each slab into parts.

    known (s,)
        heights of the slices of the body, rising; the first and the last are the end slices of cosine spacing.
    parts (s - 1,)
        numbers of parts that the slabs between two slices need; those that need many are halved first.
    slices
        number of slices of cosine spacing.

    There are none if some of the known heights are others: the body has edges, by which those were chosen.
    """
    nodes = -np.cos(np.pi * (np.arange(slices) + 0.5) / slices)
    middle, half = (known[0] + known[-1]) / 2, (known[-1] - known[0]) / 2
    nodes = middle + half * nodes / nodes[-1]
    if np.abs(known[:, None] - nodes).min(axis=1).max() > _SAME_HEIGHT * 2 * half:
        return np.empty(0)
    near = CLOSEST * 2 * half
    chosen = []
    for low, high, needed in zip(known[:-1], known[1:], parts, strict=True):
        between = nodes[(nodes > low + near) & (nodes < high - near)]
        cuts = needed if needed <= _AT_ONCE else 2
        at = np.arange(1, cuts) * (len(between) + 1) / cuts - 1
        chosen.append(between[np.unique(np.clip(np.round(at), 0, None).astype(np.intp))] if len(between) else between)
    return np.concatenate([np.empty(0), *chosen])


def parts_within(gaps: Array, tolerance: float) -> Index:
    """Numbers of parts (n,) into which slabs with gaps (n,) are cut to come within a tolerance; without one, many."""
    if not tolerance:
        return np.full(len(gaps), np.iinfo(np.int32).max, dtype=np.intp)
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(np.ceil(np.sqrt(gaps / tolerance)), posinf=np.iinfo(np.int32).max).astype(np.intp)


def heights_at_gaps(
    known: Array,
    slab: Index,
    corners: Array,
    gaps: Array,
    creases: Mask,
    count: int,
    tolerance: float = 0.0,
) -> Array:
    """`count` further heights (k,) at most, where the enclosure of the body is widest.

    known (s,)
        heights that have been scanned, rising, with those of the nearest empty slices at both ends.
    slab, corners, gaps, creases (w,)
        the outer body's corners: number of the known height below each, the corner's own height, its distance from the inner
        body, and whether the body goes on straight on both sides of its slab.
    count
        number of heights wanted.
    tolerance
        gap that is small enough.

    A slab gets the height of its worst corner; in a polyhedron that is the height of a vertex.  In a slab along which the body
    bends everywhere, the gap falls with the square of the number of parts into which further slices divide the slab, and it
    gets a height that halves it: both parts have equal gaps if the density of slices is that of the root of the gap over the
    thickness, which is taken to change linearly from the middle of a slab to that of the next.  A corner on an empty slice
    means only that the body ends before it, and a corner on an end slice only that the body may end right behind it; there the
    new height is in the middle of the slab.
    """
    size = known[-1] - known[0]
    order = np.lexsort((-gaps, slab))
    worst = order[np.unique(slab[order], return_index=True)[1]]
    worst = worst[gaps[worst] > tolerance]
    slab, corner, crease = slab[worst], corners[worst], creases[worst]
    low, high = known[slab], known[slab + 1]
    first, last = slab == 0, slab == len(known) - 2
    weight = np.sqrt(np.where(first | last, _CAP_WEIGHT, 1.0) * gaps[worst])

    end, beyond = np.where(first, high, low), np.where(first, low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (corner - end) / (beyond - end)
    into_cap = np.where(depth > 1 - _ON_EMPTY_SLICE, 0.5, np.where(crease, _AT_VERTEX, _AT_POLE) * depth)
    in_cap = end + into_cap * (beyond - end)
    on_slice = np.minimum(corner - low, high - corner) <= CLOSEST * size
    single = np.where(first | last, in_cap, np.where(on_slice, (low + high) / 2, corner))
    bent = ~(first | last | crease)
    single = np.where(bent, _halves(slab, np.where(bent, weight / (high - low), np.nan), low, high), single)
    useful = np.minimum(single - low, high - single) > CLOSEST * size
    # of slabs that are equal up to rounding, as in symmetric bodies, the lowest first
    widest_first = np.argsort(-np.round(weight / weight.max(initial=1e-300), _TIED_DECIMALS), kind="stable")
    chosen: Array = single[widest_first[useful[widest_first]][:count]]
    return chosen


def _halves(slab: Index, density: Array, low: Array, high: Array) -> Array:
    """Heights (n,) between `low` and `high` (n,) that leave as many slices below as above, by densities of slices (n,).

    `slab` (n,) are the slabs' numbers, rising.  The densities are those in the middles of the slabs, NaN if not known, and
    linear between them; where a neighbour is not known, the density is constant.
    """
    before = np.where(np.diff(slab, prepend=-2) == 1, np.roll(density, 1), np.nan)
    after = np.where(np.diff(slab, append=-2) == 1, np.roll(density, -1), np.nan)
    a, b = ((density + np.where(np.isnan(near), density, near)) / 2 for near in (before, after))
    # the fraction u with a u + (b - a) u²/2 = (a + b)/4, without a difference of nearly equal numbers
    halves: Array = low + (high - low) * (a + b) / 2 / (a + np.sqrt((a * a + b * b) / 2))
    return halves
