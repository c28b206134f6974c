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
# Largest number of parts into which a slab is cut at once.  Larger, heights are chosen by gaps that are known poorly; smaller,
# slabs are halved that need three or five parts, which makes some parts smaller than others.
_AT_ONCE = 4
# Points of a slab at which the density of slices is summed.
_STEPS = 65


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


def cosine_heights_left(known: Array, wide: Mask, slices: int) -> Array:
    """Heights (k,) of cosine spacing that are still to be scanned, one in the middle of those in each slab.

    known (s,)
        heights of the slices of the body, rising; the first and the last are the end slices of cosine spacing.
    wide (s - 1,)
        whether the slab between two slices is to be divided.
    slices
        number of slices of cosine spacing.
    """
    nodes = -np.cos(np.pi * (np.arange(slices) + 0.5) / slices)
    middle, half = (known[0] + known[-1]) / 2, (known[-1] - known[0]) / 2
    nodes = middle + half * nodes / nodes[-1]
    near = CLOSEST * 2 * half
    chosen = []
    for low, high in zip(known[:-1][wide], known[1:][wide], strict=True):
        between = nodes[(nodes > low + near) & (nodes < high - near)]
        if len(between):
            chosen.append(between[len(between) // 2])
    return np.array(chosen)


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
    bends everywhere, the gap falls with the square of the number of parts into which further slices divide the slab.  If it
    will need a few parts by the time that no slices are left, it gets all their heights at once, otherwise one that halves it.
    Parts have equal gaps if the density of slices is that of the root of the gap over the thickness, which is taken to change
    linearly from the middle of a slab to that of the next.  A corner on an empty slice
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
    bent = ~(first | last | crease)
    parts = np.where(bent, _parts(weight, left), 1)
    ends = _densities(slab, np.where(bent, weight / (high - low), np.nan))

    chosen: list[float] = []
    for i in np.argsort(-weight, kind="stable"):
        if len(chosen) >= count:
            break
        if useful[i]:
            cuts = parts[i] if parts[i] <= _AT_ONCE else 2
            new = _cuts(low[i], high[i], ends[i], cuts) if cuts > 1 else [single[i]]
            chosen += new[: left - len(chosen)]
    return np.array(chosen)


def _densities(slab: Index, density: Array) -> Array:
    """Densities (n, 2) of slices at the lower and upper ends of slabs, from those at their middles (n,), NaN if not known.

    `slab` (n,) are the slabs' numbers, rising; where a neighbour is not known the density is constant.
    """
    before = np.where(np.diff(slab, prepend=-2) == 1, np.roll(density, 1), np.nan)
    after = np.where(np.diff(slab, append=slab[-1] + 2 if len(slab) else 0) == 1, np.roll(density, -1), np.nan)
    ends: Array = np.stack(
        [(density + np.where(np.isnan(near), density, near)) / 2 for near in (before, after)], axis=1
    )
    return ends


def _cuts(low: float, high: float, ends: Array, parts: int) -> list[float]:
    """Heights that cut a slab into parts with equally many slices by a density that is linear between its ends (2,)."""
    up = np.linspace(0.0, 1.0, _STEPS)
    density = ends[0] + (ends[1] - ends[0]) * up
    total = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
    cuts: list[float] = (low + (high - low) * np.interp(np.arange(1, parts) / parts, total / total[-1], up)).tolist()
    return cuts


def _parts(weight: Array, left: int) -> Index:
    """Numbers of parts (n,) into which `left` cuts divide slabs so that the largest ``weight / parts`` is smallest."""
    parts = np.ones(len(weight), dtype=np.int64)
    for _ in range(left if len(weight) else 0):
        parts[np.argmax(weight / parts)] += 1
    return parts
