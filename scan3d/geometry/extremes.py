"""The support function of many points in many directions."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from scan3d.arrays import Array, Index
from scan3d.geometry.normal_intervals import edges_of
from scan3d.geometry.vectors import highest

# Products of points and directions up to which all are computed.  Larger, more time is spent on them than on the hull.
_FEW = 10_000_000


def support_values(points: Array, directions: Array) -> Array:
    """(d,) the largest products of points (n, 3) with each of the directions (d, 3), unit vectors.

    From a vertex of the points' hull a linear function is followed along the hull's edges to ever larger values: where no
    neighbour has a larger one, none of the vertices has.  The search begins at the facet whose normal is the nearest.  Points
    that Qhull leaves out of the hull may lie outside by rounding, a few thousand units in the last place of their size.
    """
    if len(points) * len(directions) <= _FEW:
        return highest(points, directions)
    try:
        hull = ConvexHull(points)
    except QhullError:
        return highest(points, directions)
    vertices, edges = edges_of(hull)
    corners, start, neighbours = points[vertices], *_lists(edges, len(vertices))
    number = np.zeros(len(points), dtype=np.intp)
    number[vertices] = np.arange(len(vertices))
    here = number[hull.simplices[cKDTree(hull.equations[:, :3]).query(directions)[1], 0]]
    value: Array = (corners[here] * directions).sum(axis=1)
    active = np.arange(len(directions))
    while len(active):
        count = start[here[active] + 1] - start[here[active]]
        first = np.cumsum(count) - count
        entry = np.arange(int(count.sum())) - np.repeat(first - start[here[active]], count)
        trial = (corners[neighbours[entry]] * directions[np.repeat(active, count)]).sum(axis=1)
        best = np.maximum.reduceat(trial, first)
        is_best = np.where(trial == np.repeat(best, count), neighbours[entry], -1)
        better = best > value[active]
        here[active[better]] = np.maximum.reduceat(is_best, first)[better]
        active = active[better]
        value[active] = best[better]
    return value


def _lists(edges: Index, count: int) -> tuple[Index, Index]:
    """Where the neighbours of each vertex begin (count + 1,) in the list of all vertices' neighbours."""
    one, other = np.concatenate([edges, edges[:, ::-1]]).T
    order = np.argsort(one, kind="stable")
    return np.searchsorted(one[order], np.arange(count + 1)), other[order]
