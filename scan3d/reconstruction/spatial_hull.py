"""Normals of contacts from the hull of all contacts, whatever the friction (S27).

A plane that supports the body at a contact has all contacts on one side: its normal lies between those of the hull's facets
that meet in the contact.  At a tangential contact the plane contains the rod's tangent as well.  Seen along the tangent the
hull fills an angle at the contact: the normal lies between the perpendiculars to both its sides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from scan3d.arrays import Array, Mask

# Distances of the hull's corners, relative to its size, below which directions between them are rounding.
_ROUNDING = 1e-7
# Depth below a facet, relative to the hull's size, at which a contact lies on it.  Larger, contacts count as lying on facets
# that they are below; smaller, rounding takes them from the facets that they lie on.
_SAME_PLANE = 1e-9
# Depth of a contact, in those of a contact on a facet, from which on it lies inside the hull.
_INSIDE = 1e3
# Half an angle, in radians, from which on the facets at a contact are asked as well: its neighbours may be too close to count.
_WIDE = 0.1
# Contacts whose depths below all facets are computed at once.
_BLOCK = 256


class HullNormals(NamedTuple):
    """Normals of contacts (n,), NaN where they are unknown."""

    normal: Array
    """(n, 3) the middle of the interval."""
    half_width: Array
    """(n,) the largest angle to it, in radians; infinite where the normal is unknown."""


def hull_normals(points: Array, tangents: Array, tangential: Mask) -> HullNormals:
    """The normals of exact contacts (n, 3), with exact tangents (n, 3) where they are tangential (n,)."""
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
    normal = np.where(known[:, None], normal, np.nan)
    half_width = np.where(known, np.maximum(half_width, 0.0), np.inf)
    # tip contacts, and contacts inside faces and edges of the hull
    rows = np.flatnonzero(~known | (half_width > _WIDE))
    axis, width, edge = _cones(hull, points[rows] - middle, _SAME_PLANE * size)
    sharp = tangential[rows] & np.isfinite(edge[:, 0])
    # the supporting plane contains the edge and the tangent
    exact = np.cross(tangents[rows], edge)
    with np.errstate(divide="ignore", invalid="ignore"):
        exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    cosine = (exact * axis).sum(axis=1)
    exact *= np.sign(cosine)[:, None]
    sharp &= np.abs(cosine) >= np.cos(np.minimum(width, np.pi)) - _ROUNDING  # it lies between the facets' normals
    by_facets = np.where(sharp, 0.0, width)
    better = by_facets < half_width[rows]
    normal[rows[better]] = np.where(sharp[:, None], exact, axis)[better]
    half_width[rows[better]] = by_facets[better]
    return HullNormals(normal, half_width)


def _cones(hull: ConvexHull, points: Array, near: float) -> tuple[Array, Array, Array]:
    """The middle (n, 3) of the normals of the hull's facets that points (n, 3) lie on, and the largest angle (n,) to it.

    The third is the direction (n, 3) of the edge for points inside an edge of the hull, where two planes meet, else NaN.
    """
    normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
    middle, width, edges = np.empty_like(points), np.empty(len(points)), np.empty_like(points)
    for first in range(0, len(points), _BLOCK):
        part = points[first : first + _BLOCK]
        depth = -(part @ normals.T + offsets)
        nearest = depth.min(axis=1)
        # pairs of points and facets that they lie on, of which every point has one at least
        point, facet = np.nonzero(depth <= np.maximum(near, nearest)[:, None])
        starts = np.searchsorted(point, np.arange(len(part)))
        normal = normals[facet]
        total = np.add.reduceat(normal, starts)
        with np.errstate(divide="ignore", invalid="ignore"):  # on a flat hull, whose facets are opposite
            axis = total / np.linalg.norm(total, axis=1, keepdims=True)
        cosine = (axis[point] * normal).sum(axis=1)
        smallest = np.minimum.reduceat(cosine, starts)
        # the facet of each point whose normal is farthest from the axis
        at_most = np.flatnonzero(~(cosine > smallest[point]))
        farthest = at_most[np.searchsorted(point[at_most], np.arange(len(part)))]
        rows = slice(first, first + _BLOCK)
        edge = np.cross(axis, normal[farthest])
        size = np.linalg.norm(edge, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            edge /= size[:, None]
        across = np.maximum.reduceat(np.abs((edge[point] * normal).sum(axis=1)), starts)
        edge[~(size > _ROUNDING) | ~(across < _ROUNDING)] = np.nan
        middle[rows], edges[rows] = axis, edge
        angle = np.arccos(np.clip(smallest, -1.0, 1.0))
        # a contact inside the hull contradicts the model
        width[rows] = np.where(np.isfinite(angle) & (nearest <= _INSIDE * near), angle, np.inf)
    return middle, width, edges
