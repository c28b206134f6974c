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
_TIED_DECIMALS = 4
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
# Halvings of the interval in which the least gap lies: to rounding.
_BISECTIONS = 60
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
        several = needed if needed <= _AT_ONCE else 2
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
    left: int | None = None,
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
    left
        number of heights that may be chosen in this call and all later ones, of bodies that are bent nearly everywhere;
        without it, bent slabs are halved.

    A slab gets the height of its worst corner; in a polyhedron that is the height of a vertex.  In a slab along which the body
    bends everywhere, the gap falls with the square of the number of parts into which further slices divide the slab.  From
    this follows how many parts of which slab make the largest gap least, and the slab gets the height between the lower and
    the upper half of its parts.  The parts have equal gaps if the density of slices is that of the root of the gap over the
    thickness, which is taken to change linearly from the middle of a slab to that of the next.  A corner on an empty slice
    means only that the body ends before it, and a corner on an end slice only that the body may end right behind it; there the
    new height is in the middle of the slab.
    """
    size = known[-1] - known[0]
    # of corners that are equal up to rounding, as in symmetric bodies, the lowest of those where the body goes on straight
    order = np.lexsort((corners, ~creases, -np.round(gaps / gaps.max(initial=1e-300), _TIED_DECIMALS), slab))
    worst = order[np.unique(slab[order], return_index=True)[1]]
    worst = worst[gaps[worst] > max(tolerance, NO_GAP * size)]
    slab, corner, crease = slab[worst], corners[worst], creases[worst]
    low, high = known[slab], known[slab + 1]
    first, last = slab == 0, slab == len(known) - 2
    weight = np.sqrt(np.where(first | last, _CAP_WEIGHT, 1.0) * gaps[worst])

    end, beyond = np.where(first, high, low), np.where(first, low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (corner - end) / (beyond - end)
    into_cap = np.where(depth > 1 - _ON_EMPTY_SLICE, 0.5, np.where(crease, AT_VERTEX, _AT_POLE) * depth)
    in_cap = end + into_cap * (beyond - end)
    on_slice = np.minimum(corner - low, high - corner) <= CLOSEST * size
    single = np.where(first | last, in_cap, np.where(on_slice, (low + high) / 2, corner))
    bent = ~(first | last | crease)
    most = np.where(bent & (left is not None), parts_within(weight**2, tolerance), 2)
    parts = least_parts(weight**2, left or 0, most)[0].clip(2)
    below = parts // 2 / parts
    single = np.where(bent, _cuts(slab, np.where(bent, weight / (high - low), np.nan), below, low, high), single)
    useful = np.minimum(single - low, high - single) > CLOSEST * size
    # of slabs that are equal up to rounding, as in symmetric bodies, the lowest first
    widest_first = np.argsort(-np.round(weight / weight.max(initial=1e-300), _TIED_DECIMALS), kind="stable")
    chosen: Array = single[widest_first[useful[widest_first]][:count]]
    return chosen


def least_parts(gaps: Array, left: int, most: Array | float = np.inf) -> tuple[Array, float]:
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
    parts = np.minimum(np.ceil(np.round(root / high, _TIED_DECIMALS)), most).clip(1) if high else np.ones(len(root))
    return parts, high**2


def _cuts(slab: Index, density: Array, below: Array, low: Array, high: Array) -> Array:
    """Heights (n,) between `low` and `high` (n,) with the fraction `below` (n,) of the slices to come below them.

    `slab` (n,) are the slabs' numbers, rising.  The densities (n,) of slices are those in the middles of the slabs, NaN if not
    known, and linear between them; where a neighbour is not known, the density is constant.
    """
    before = np.where(np.diff(slab, prepend=-2) == 1, np.roll(density, 1), np.nan)
    after = np.where(np.diff(slab, append=-2) == 1, np.roll(density, -1), np.nan)
    a, b = ((density + np.where(np.isnan(near), density, near)) / 2 for near in (before, after))
    # the fraction u with a u + (b - a) u²/2 = below (a + b)/2, without a difference of nearly equal numbers
    cuts: Array = low + (high - low) * below * (a + b) / (a + np.sqrt(a * a * (1 - below) + b * b * below))
    return cuts
