"""Heights of the slices: spaced by a rule, or chosen where the enclosure of the body is widest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.planning.plan import Plan

# Slices inside the body with which adaptive spacing starts.  More are placed without knowing the body; with fewer, the first
# heights are chosen by loose bounds.
FIRST_SLICES = 8
# Distance of the slices beyond the ends in adaptive spacing, as a fraction of the body's height.  Larger, the caps are
# bounded more loosely at first; smaller, a real body that is higher than expected is not closed by them.
OVERSHOOT = 0.02
# Lower bound of that distance for the other spacings, where it is that of the end slices from the ends.  Larger, the caps of
# closely spaced scans are bounded more loosely; smaller, rounding could decide whether the slice is empty.
LEAST_OVERSHOOT = 1e-4
# Weight of a gap in a cap relative to one in another slab, because the body is known least beyond its end slices.  Larger,
# slices are spent on the ends of the body; smaller, on its middle.
_CAP_WEIGHT = 1.5
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
# Number of parts for which a slab gets two heights at once.
_THIRDS = 3


def heights(low: float, high: float, plan: Plan) -> Array:
    """Heights (slices,) between the ends of the body; those of cosine spacing are Chebyshev's nodes."""
    fraction = (np.arange(plan.slices) + 0.5) / plan.slices
    if plan.spacing == "cosine":
        fraction = (1 - np.cos(np.pi * fraction)) / 2
    return low + (high - low) * fraction


def first_heights(low: float, high: float, plan: Plan) -> Array:
    """Heights (k,) that are scanned before any contact is known, one beyond either end of the body included."""
    if plan.spacing == "adaptive":
        few = replace(plan, slices=max(2, min(FIRST_SLICES, plan.slices - 2)), spacing="cosine")
        inside = heights(low, high, few)
        beyond = OVERSHOOT * (high - low)
    else:
        inside = heights(low, high, plan)
        beyond = max(float(inside[0]) - low, LEAST_OVERSHOOT * (high - low))
    return np.concatenate([inside, [low - beyond, high + beyond]])


def heights_at_gaps(
    known: Array, slab: Index, corners: Array, gaps: Array, creases: Mask, count: int, left: int
) -> Array:
    """About `count` further heights (k,), no more than `left`, where the enclosure of the body is widest.

    known (s,)
        heights that have been scanned, rising, with those of the nearest empty slices at both ends.
    slab, corners, gaps, creases (w,)
        the outer body's corners: number of the known height below each, the corner's own height, its distance from the inner
        body, and whether the body goes on straight on both sides of its slab.
    count, left
        number of heights wanted, and of those that may still be scanned.

    A slab gets the height of its worst corner; in a polyhedron that is the height of a vertex.  In a slab along which the body
    bends everywhere, the gap falls with the square of the number of parts into which further slices divide the slab; if it
    will need three parts by the time that no slices are left, it gets two heights at once.  A corner on an empty slice
    means only that the body ends before it, and a corner on an end slice only that the body may end right behind it; there the
    new height is in the middle of the slab.
    """
    size = known[-1] - known[0]
    order = np.lexsort((-gaps, slab))
    worst = order[np.unique(slab[order], return_index=True)[1]]
    worst = worst[gaps[worst] > 0]
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
    useful = np.minimum(single - low, high - single) > CLOSEST * size
    thirds = ~(first | last | crease) & (_parts(weight, left) == _THIRDS)

    chosen: list[float] = []
    for i in np.argsort(-weight, kind="stable"):
        if len(chosen) >= count:
            break
        if useful[i]:
            new = [low[i] + (high[i] - low[i]) * k / _THIRDS for k in (1, 2)] if thirds[i] else [single[i]]
            chosen += new[: left - len(chosen)]
    return np.array(chosen)


def _parts(weight: Array, left: int) -> Index:
    """Numbers of parts (n,) into which `left` cuts divide slabs so that the largest ``weight / parts`` is smallest."""
    parts = np.ones(len(weight), dtype=np.int64)
    for _ in range(left if len(weight) else 0):
        parts[np.argmax(weight / parts)] += 1
    return parts
