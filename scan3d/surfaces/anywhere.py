"""Estimates of a convex surface from contacts anywhere, with normals.

Between neighbouring contacts i and j of a curved surface the middle of the chord lies ``<n_j - n_i, p_j - p_i> / 8`` below the
surface, to the third order of the chord's length.  A surface with edges is estimated by the planes in which several contacts
lie, which meet in its edges and vertices, and by the tangent planes of the contacts elsewhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from scan3d.arrays import Array, Index, Mask
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.geometry.hulls import hull
from scan3d.geometry.polytopes import cut_polytope, plane_faces

# Distance from a plane, in diagonals, of the contacts that lie in it.
_PLANE = 5e-6
# Depth, in diagonals, of the smallest cut by a contact's tangent plane.
_CUT = 1e-4
# Contacts beside a place whose normals tell how the body is bent there.
_BESIDE = 32
# Where contacts beside the ends of an edge of the hull, nearer than the first part of its length, leave no more than the second
# part of the turn from end to end, both lie on edges of the body. Of a surface that curves evenly they leave as much as 1 less
# twice the first part.
_AT_END, _AS_MUCH = 0.2, 0.55
# Tangent planes that are used at most.
_TANGENT_PLANES = 6000


def curved(cloud: Cloud) -> Any:
    """The hull with the middles of its edges moved out onto the curved surface, but for edges in plane faces."""
    points, normals = cloud.points, cloud.normals
    try:
        qhull = ConvexHull(points)
    except QhullError:
        raise InputError("the contacts span no body") from None
    faces = qhull.simplices
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    order = np.lexsort(sides.T)  # each edge is a side of two facets
    ends, opposite = sides[order[::2]], faces[:, [2, 0, 1]].T.ravel()[order].reshape(-1, 2)
    chord = points[ends[:, 1]] - points[ends[:, 0]]
    turn = normals[ends[:, 1]] - normals[ends[:, 0]]
    mean = normals[ends].sum(axis=1)
    length = np.linalg.norm(mean, axis=1)
    rise = (turn * chord).sum(axis=1) / 8
    if cloud.normal_sd is not None:  # no more than the errors of the normals leave
        rise -= cloud.normal_sd[ends].sum(axis=1) * np.linalg.norm(chord, axis=1) / 8
    rise = np.maximum(rise, 0.0)
    # no higher than the tangent planes at both ends
    for k in range(2):
        slope = (mean * normals[ends[:, k]]).sum(axis=1) / np.maximum(length, 1e-12)
        along = (1 - 2 * k) * (chord * normals[ends[:, k]]).sum(axis=1) / 2
        rise = np.where(slope > 0, np.minimum(rise, np.maximum(-along, 0.0) / np.maximum(slope, 1e-12)), 0.0)
    plane = plane_faces(points, _PLANE * _diagonal(cloud))
    for face in plane:
        inside = (face[3] - points[ends] @ face[:3] <= _PLANE * _diagonal(cloud)).all(axis=1)
        rise[inside] = 0.0
    rise[_between_edges(cloud, ends)] = 0.0
    curved = rise > 0
    middle, outward = points[ends].mean(axis=1)[curved], mean[curved] / length[curved, None]
    rise = np.minimum(rise[curved], _room(cloud, opposite[curved], middle, outward))
    return hull(np.concatenate([points, middle + rise[:, None] * outward]))


def _between_edges(cloud: Cloud, ends: Index) -> Mask:
    """Whether both ends (m, 2) of edges of the hull lie on edges of the body, so that it may be plane between them.

    At an edge of the body, normals of many directions belong to one place: those of contacts beside an end turn along the chord
    as much as from end to end, and say nothing of the surface in between.
    """
    points, normals = cloud.points, cloud.normals
    chord = points[ends[:, 1]] - points[ends[:, 0]]
    turn = ((normals[ends[:, 1]] - normals[ends[:, 0]]) * chord).sum(axis=1)
    near_to = _AT_END * np.linalg.norm(chord, axis=1)[:, None]
    known, end = np.unique(ends, return_inverse=True)
    distance, near = cKDTree(points).query(points[known], k=np.arange(1, min(_BESIDE, len(points)) + 1))
    least = np.zeros(len(ends))
    for rows, towards in zip(end.reshape(ends.shape).T, (-1, 1), strict=True):
        along = towards * np.einsum("nkj,nj->nk", normals[near[rows]], chord)
        least += np.where(distance[rows] <= near_to, along, np.inf).min(axis=1)  # the nearest is the end itself
    between: Mask = least <= _AS_MUCH * turn
    return between


def _room(cloud: Cloud, opposite: Index, places: Array, outward: Array) -> Array:
    """How far middles (n, 3) of edges can be moved along directions (n, 3) below the tangent planes of contacts beside them.

    An edge may be long, and its ends turned by curvature that is near them only: the contacts nearest to its middle and those
    opposite (n, 2) to the edge, in the facets on both sides, know better.
    """
    known = np.arange(len(cloud.points)) if cloud.normal_sd is None else _well_known(cloud)
    number = min(_BESIDE, len(known))
    near = known[cKDTree(cloud.points[known]).query(places, k=np.arange(1, number + 1))[1]]
    room = np.full(len(places), np.inf)
    for rows in np.column_stack([near, opposite]).T:
        step = cloud.points[rows] - places
        height, slope = (step * cloud.normals[rows]).sum(axis=1), (outward * cloud.normals[rows]).sum(axis=1)
        if cloud.normal_sd is not None:
            height += cloud.normal_sd[rows] * np.linalg.norm(step, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.minimum(room, np.where(slope > 0, np.maximum(height, 0.0) / slope, np.inf))
    return room


def _well_known(cloud: Cloud) -> Index:
    """The contacts whose normals are known better than in the median, or as well."""
    assert cloud.normal_sd is not None
    return np.flatnonzero(cloud.normal_sd <= np.median(cloud.normal_sd))


def with_edges(cloud: Cloud) -> Any:
    """The polytope of the plane faces, cut by the contacts' tangent planes."""
    if cloud.normal_sd is not None:
        cloud = cloud.select(_well_known(cloud))
    points, normals, diagonal = cloud.points, cloud.normals, _diagonal(cloud)
    faces = plane_faces(points, _PLANE * diagonal)
    if not len(faces):
        return hull(points)
    tangent = np.column_stack([normals, (normals * points).sum(axis=1)])
    tangent = tangent[:: -(-len(tangent) // _TANGENT_PLANES)]
    corners = cut_polytope(faces, tangent, points.mean(axis=0), diagonal, _CUT * diagonal)
    return hull(np.concatenate([points, corners]))


def _diagonal(cloud: Cloud) -> float:
    return float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
