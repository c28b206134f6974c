"""Heights of the slices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.planning.plan import Plan

# Adaptive spacing starts with so many slices inside the body, and one beyond either end by this share of its height.
FIRST_SLICES = 8
OVERSHOOT = 0.02
# Smallest distance of the slices beyond the ends, as a share of the height.
MARGIN = 1e-4
# Gap in a cap over that in another slab of the same weight: how a body closes past its end slice is least known.
_CAP_WEIGHT = 1.5
# Where a cap is entered, as a fraction of the distance from its end slice to its worst corner: just before the tip of a
# vertex, so that the slice is small but not empty; at a third of a smooth pole, whose cap is shallower than its corner.
_AT_VERTEX, _AT_POLE = 0.98, 0.35
# Slices closer to each other than this share of the height tell nothing new.
CLOSEST = 1e-7


def heights(low: float, high: float, plan: Plan) -> Array:
    """Heights (slices,) between the ends of the body; cosine spacing puts them at Chebyshev's nodes."""
    share = (np.arange(plan.slices) + 0.5) / plan.slices
    if plan.spacing == "cosine":
        share = (1 - np.cos(np.pi * share)) / 2
    return low + (high - low) * share


def first_heights(low: float, high: float, plan: Plan) -> Array:
    """Heights that are scanned before any contact is known: one on either side beyond the body is among them."""
    if plan.spacing == "adaptive":
        few = replace(plan, slices=max(2, min(FIRST_SLICES, plan.slices - 2)), spacing="cosine")
        inside = heights(low, high, few)
        beyond = OVERSHOOT * (high - low)
    else:
        inside = heights(low, high, plan)
        beyond = max(float(inside[0]) - low, MARGIN * (high - low))
    return np.concatenate([inside, [low - beyond, high + beyond]])


def heights_at_gaps(
    known: Array, slab: Index, corners: Array, gaps: Array, creases: Mask, count: int, left: int
) -> Array:
    """About `count` further heights, no more than `left`, where the enclosure is widest.

    known (s,): heights scanned, rising, with the nearest empty ones at both ends.  Of the outer body's corners: slab (w,),
    number of the lower known height; corners (w,), their own heights; gaps (w,), their distances from the inner body;
    creases (w,), whether the body goes on straight on both sides.

    A slab gets the height of its worst corner, which for a polyhedron is a vertex's own.  Where the body bends all along,
    its gap falls with the square of the slab's parts: a slab that will need three of them, with what is left, gets two
    heights at once.  A corner on an empty slice says only that the body ends before it, one on an end slice only that the
    body may end right behind it: there the height between is halved.
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
        share = (corner - end) / (beyond - end)
    in_cap = end + np.where(share > 1 - 1e-9, 0.5, np.where(crease, _AT_VERTEX, _AT_POLE) * share) * (beyond - end)
    on_slice = np.minimum(corner - low, high - corner) <= CLOSEST * size
    single = np.where(first | last, in_cap, np.where(on_slice, (low + high) / 2, corner))
    useful = np.minimum(single - low, high - single) > CLOSEST * size
    thirds = ~(first | last | crease) & (_parts(weight, left) == 3)

    chosen: list[float] = []
    for i in np.argsort(-weight, kind="stable"):
        if len(chosen) >= count:
            break
        if useful[i]:
            new = [low[i] + (high[i] - low[i]) * k / 3 for k in (1, 2)] if thirds[i] else [single[i]]
            chosen += new[: left - len(chosen)]
    return np.array(chosen)


def _parts(weight: Array, left: int) -> Index:
    """Parts (n,) into which slabs come if `left` cuts make the largest ``weight / parts`` as small as they can."""
    parts = np.ones(len(weight), dtype=np.int64)
    for _ in range(left if len(weight) else 0):
        parts[np.argmax(weight / parts)] += 1
    return parts
