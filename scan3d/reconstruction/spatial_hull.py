"""Normals of tangential contacts from the hull of all contacts, whatever the friction (MODEL3D, S27).

A plane that supports the body at a tangential contact contains the rod's tangent, and all contacts lie on one side of it.  Seen
along the tangent the hull fills an angle at the contact: the normal lies between the perpendiculars to both its sides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from scan3d.arrays import Array, Mask

# Distances of the hull's corners, relative to its size, below which directions between them are rounding.
_ROUNDING = 1e-7


class HullNormals(NamedTuple):
    """Normals of contacts (n,), NaN where they are unknown: at tip contacts and inside faces and edges of the hull."""

    normal: Array
    """(n, 3) the middle of the interval."""
    half_width: Array
    """(n,) the largest angle to it, in radians; infinite where the normal is unknown."""


def hull_normals(points: Array, tangents: Array, tangential: Mask) -> HullNormals:
    """The normals of contacts (n, 3) with exact tangents (n, 3)."""
    unknown = HullNormals(np.full_like(points, np.nan), np.full(len(points), np.inf))
    middle = points.mean(axis=0)
    try:
        hull = ConvexHull(points - middle)
    except (QhullError, ValueError):
        return unknown
    first, second = (hull.simplices[:, [a, b]].T for a, b in ((0, 1), (1, 2)))
    third = hull.simplices[:, [2, 0]].T
    start, end = np.concatenate([first, second, third], axis=1)
    start, end = np.concatenate([start, end]), np.concatenate([end, start])
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    kept = tangential[start] & (np.linalg.norm(points[end] - points[start], axis=1) > _ROUNDING * size)
    start, end = start[kept], end[kept]

    # in the plane across the tangent, with the first axis towards the middle of the body
    inward = middle - points
    inward -= (inward * tangents).sum(axis=1, keepdims=True) * tangents
    with np.errstate(divide="ignore", invalid="ignore"):
        inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    side = np.cross(tangents, inward)
    step = points[end] - points[start]
    along, across = (step * inward[start]).sum(axis=1), (step * side[start]).sum(axis=1)
    seen = np.hypot(along, across) > _ROUNDING * size  # others lie along the tangent
    angle = np.arctan2(across, along)
    low, high = np.full(len(points), np.inf), np.full(len(points), -np.inf)
    np.minimum.at(low, start[seen], angle[seen])
    np.maximum.at(high, start[seen], angle[seen])
    with np.errstate(invalid="ignore"):
        half_width = (np.pi - (high - low)) / 2
        bisector = (low + high) / 2
    known = np.isfinite(half_width) & (half_width >= -_ROUNDING) & np.isfinite(inward[:, 0])
    normal = -(np.cos(bisector)[:, None] * inward + np.sin(bisector)[:, None] * side)
    return HullNormals(np.where(known[:, None], normal, np.nan), np.where(known, np.maximum(half_width, 0.0), np.inf))
