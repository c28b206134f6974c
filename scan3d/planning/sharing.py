"""How many further slices each slab of a bent body needs, and where they divide it."""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array, Index

TIED_DECIMALS = 4
"""Decimals of the gaps' roots, over the largest, by which slabs are compared.  More, and rounding decides between slabs of a
symmetric body; fewer, and slabs count as equal that are not."""
AT_ONCE = 4
"""Largest number of parts into which a slab of a smooth body is cut at once.  Larger, heights are chosen by gaps that are known
poorly; smaller, slabs are halved that need three parts, which makes some parts smaller than they need be."""
# Halvings of the interval in which the least gap lies: to rounding.
_BISECTIONS = 60
# Steps towards the gaps of slabs with even neighbours, and the least root of a gap.  Fewer steps, and the present neighbours
# count; more change the gaps by less than a hundred-thousandth.  A larger root is that of gaps that matter; a smaller one has
# no square.
_EVENINGS, _LEAST_ROOT = 20, 1e-100


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
