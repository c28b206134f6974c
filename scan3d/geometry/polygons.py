"""Convex polygons as intersections of half-planes."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from scan3d.arrays import Array, Index


def beyond(corners: Array, points: Array, normals: Array, tangents: Array, offset: Array) -> tuple[Array, Array]:
    """Extents of the part of a convex polygon that lies beyond lines (k,): along each line from its point, and across.

    Both (k,); 0 where the polygon does not reach beyond the line.
    """
    across = normals @ corners.T - offset[:, None]
    along = tangents @ corners.T - (tangents * points).sum(axis=1)[:, None]
    height = np.maximum(across.max(axis=1), 0.0)
    extent = np.where(across >= 0, np.abs(along), 0.0).max(axis=1)
    # where a side of the polygon crosses the line
    next_across, next_along = np.roll(across, -1, axis=1), np.roll(along, -1, axis=1)
    line, side = np.nonzero((across >= 0) != (next_across >= 0))
    a, b = across[line, side], next_across[line, side]
    crossing = along[line, side] + (next_along[line, side] - along[line, side]) * a / (a - b)
    np.maximum.at(extent, line, np.abs(crossing))
    return extent, height


def polygon_of_lines(normals: Array, value: Array, inside: Array) -> tuple[Array, Index] | None:
    """Corners (v, 2), in order, of the polygon ``<normals, x> <= value``, and the lines (s,) that bound it.

    None if `inside` (2,) does not lie in its interior, or if it is not bounded.
    """
    distance = value - normals @ inside
    if not (distance > 0).all():
        return None
    dual = normals / distance[:, None]
    try:
        dual_hull = ConvexHull(dual / np.abs(dual).max())
    except QhullError:
        return None
    equations = dual_hull.equations
    if not (equations[:, 2] < 0).all():
        return None
    corners = -equations[:, :2] / equations[:, 2:] / np.abs(dual).max()
    corners = corners[np.argsort(np.arctan2(corners[:, 1], corners[:, 0]))]
    return inside + corners, np.asarray(dual_hull.vertices, dtype=np.intp)
