"""Types of arrays by their elements, and operations on their rows; shapes are given in the docstrings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from planar.arrays import ranges as ranges
from planar.arrays import ratio as ratio

Array = NDArray[np.float64]
Index = NDArray[np.integer[Any]]
Mask = NDArray[np.bool_]
Image = NDArray[np.uint8]
Table = NDArray[np.void]
"""A structured array: one row per contact or vertex, one named column per quantity."""

ROUNDING = 1e-12
"""Rounding of sums of products, relative to them: a few thousand units in the last place."""
NEGLIGIBLE = 1e-9
"""Part of a body's size that counts as nothing: far above the rounding of hulls, and far below what touch can tell."""
LARGEST = 1e60
"""Numbers beyond it have products that are none of a computer."""
SOME = 20_000
"""Rows, evenly spread over all, that statistics and fits take at most: their errors fall with the root of the number."""
AT_ONCE = 4_000_000
"""Entries of a matrix that are computed at once, which limits the memory."""
MEDIAN_OF_NORMAL = float(ndtri(0.75))
"""Median of the sizes of normal numbers, in their standard deviations."""
OCTANTS = 2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1
"""(8, 3) the signs of the coordinates in each octant: the corners of a cube."""


def evenly(rows: NDArray[Any], count: int) -> NDArray[Any]:
    """At most `count` of the rows (n, ...), evenly chosen, the first and the last among them."""
    return rows if len(rows) <= count else rows[np.linspace(0, len(rows) - 1, count).astype(np.intp)]


def weighted_quantiles(values: Array, weights: Array, shares: Sequence[float]) -> Array:
    """(s,) the values (n,) that these shares of the weights (n,) do not exceed; NaN values don't count."""
    order = np.argsort(values)[: np.count_nonzero(~np.isnan(values))]
    if not len(order):
        return np.full(len(shares), np.nan)
    total = np.cumsum(weights[order])
    return values[order][np.searchsorted(total, np.multiply(shares, total[-1])).clip(max=len(order) - 1)]


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) scaled to unit length, NaN where they have none."""
    return ratio(vectors, np.linalg.norm(vectors, axis=-1, keepdims=True))


def unit_or_zero(vectors: Array) -> Array:
    """Vectors (n, 3) scaled to unit length, zero where they have none."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def across(normals: Array) -> tuple[Array, Array]:
    """Two unit vectors (n, 3) across each of the unit normals (n, 3) and across each other."""
    first = unit(np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)]))
    return first, np.cross(normals, first)


def highest(points: Array, directions: Array) -> Array:
    """(d,) the largest products of points (n, 3) with each of the directions (d, 3): the support function of their hull."""
    blocks = np.array_split(directions, 1 + len(points) * len(directions) // AT_ONCE)
    return np.concatenate([(block @ points.T).max(axis=1) for block in blocks])
