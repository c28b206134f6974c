"""Triangles (..., 3, 3): areas, halves, and the distances of points from them."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from scan3d.arrays import Array, Index, Mask

# Points and triangles whose offsets are computed at once.
_AT_ONCE = 8000

# The corners of a triangle from each of them on.
_FROM_CORNER = np.array([(0, 1, 2), (1, 2, 0), (2, 0, 1)])


def dot(a: Array, b: Array) -> Array:
    """Scalar products (...) of vectors (..., 3)."""
    products: Array = np.einsum("...x,...x->...", a, b)
    return products


def row_minima(values: Array, labels: Index) -> tuple[Array, Index]:
    """The smallest value (m,) of each row of values (m, k), and the label (m,) that stands at its place."""
    column = values.argmin(axis=1)[:, None]
    return np.take_along_axis(values, column, 1)[:, 0], np.take_along_axis(labels, column, 1)[:, 0]


def spanned(corners: Array) -> Array:
    """Products (m, 3) of the first two edges of triangles (m, 3, 3), from their first corner: normals, twice the area long."""
    product: Array = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return product


def largest_of_three(values: Array) -> Array:
    """The largest (m,) of each row of values (m, 3); several times as fast as ``max(axis=1)``."""
    largest: Array = np.maximum(np.maximum(values[:, 0], values[:, 1]), values[:, 2])
    return largest


def areas(corners: Array) -> Array:
    """Areas (m,) of triangles (m, 3, 3)."""
    doubled: Array = np.linalg.norm(spanned(corners), axis=1)
    return doubled / 2


def longest_first(corners: Array) -> Index:
    """Order (m, 3) of the corners of triangles (m, 3, 3) that puts the longest edge first and keeps the winding."""
    edges = np.roll(corners, -1, axis=1) - corners
    first, second, third = dot(edges, edges).T
    longest = np.where(third > np.maximum(first, second), 2, second > first)
    order: Index = _FROM_CORNER[longest]
    return order


def halve(corners: Array) -> tuple[Array, Index]:
    """Triangles (m, 3, 3), longest edge first, cut across that edge.

    Returns the halves (2m, 3, 3), longest edge first, all first halves before all second ones, and the order (2m, 3) into
    which their corners have been put.
    """
    halves = np.concatenate([corners, corners])
    halves[: len(corners), 1] = halves[len(corners) :, 0] = corners[:, :2].mean(axis=1)
    turn = longest_first(halves)
    return np.take_along_axis(halves, turn[:, :, None], axis=1), turn


def distance_to(points: Array, corners: Array) -> Array:
    """Distances (...) of points (..., 3) from triangles (..., 3, 3), longest edge first, slivers and single points included."""
    distance: Array = np.linalg.norm(offset_from(points, corners), axis=-1)
    return distance


def offset_from(points: Array, corners: Array) -> Array:
    """Vectors (..., 3) to points (..., 3) from the nearest points of triangles (..., 3, 3), longest edge first.

    They are computed in coordinates along the longest edge and across it, because the normal of a sliver has no correct digits.
    The leading axes, one at least, are broadcast.
    """
    shape = np.broadcast_shapes(points.shape[:-1], corners.shape[:-2])
    offset = np.empty((*shape, 3))
    points, corners = np.broadcast_to(points, offset.shape), np.broadcast_to(corners, (*shape, 3, 3))
    rows = max(1, _AT_ONCE // max(1, int(np.prod(shape[1:]))))
    for first in range(0, shape[0], rows):
        part = slice(first, first + rows)
        offset[part] = _offsets(points[part], corners[part])
    return offset


def _offsets(points: Array, corners: Array) -> Array:
    """`offset_from`, for as many as the processor's cache holds."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    r, e, f = points - a, b - a, c - a

    def ratio(x: Array, y: Array) -> Array:
        """Component of x along y, in lengths of y; 0 where y is 0."""
        return dot(x, y) / np.maximum(dot(y, y), np.finfo(np.float64).tiny)

    def to_edge(x: Array, y: Array) -> Array:
        return x - np.clip(ratio(x, y), 0, 1)[..., None] * y

    along, shear = ratio(r, e), ratio(f, e)
    v = ratio(r - along[..., None] * e, f - shear[..., None] * e)
    u = along - v * shear
    shortest = r - u[..., None] * e - v[..., None] * f
    distance = np.linalg.norm(shortest, axis=-1)
    distance[(u < 0) | (v < 0) | (u + v > 1)] = np.inf
    for offset in (to_edge(r, e), to_edge(r, f), to_edge(points - b, c - b)):
        nearer = np.linalg.norm(offset, axis=-1) < distance
        shortest[nearer] = offset[nearer]
        distance[nearer] = np.linalg.norm(offset[nearer], axis=-1)
    return shortest


def distinct_rows(rows: Array) -> tuple[Index, Index]:
    """Index (n,) of one row for each of the n distinct rows, and for every row (m,) the number of its distinct row.

    In less time than np.unique.
    """
    order = np.lexsort(rows.T)
    new = np.ones(len(rows), bool)
    new[1:] = False
    for column in rows.T:
        ordered = column[order]
        new[1:] |= ordered[1:] != ordered[:-1]
    inverse = np.empty(len(rows), np.int64)
    inverse[order] = np.cumsum(new) - 1
    return order[new], inverse


def mirrored_faces(faces: Index) -> Mask | None:
    """Which triangles (m,) of a closed surface, given by vertex numbers (m, 3), are wound against the first one.

    Two faces that are wound alike run through their common edge in opposite directions.  So neighbours decide, and no
    geometry: the normal of a sliver is rounding.  None if an edge does not belong to exactly two faces, or if the surface has
    several parts or one side only.
    """
    count = len(faces)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((high, low))
    if len(order) % 2:
        return None
    first, second = order.reshape(-1, 2).T
    pairs = (low[first] == low[second]) & (high[first] == high[second])
    separate = (low[second[:-1]] != low[first[1:]]) | (high[second[:-1]] != high[first[1:]])
    if not (pairs.all() and separate.all()):
        return None
    # each face stands twice in this graph, as it is and mirrored; neighbours that are wound alike are joined
    face, neighbour, against = first // 3, second // 3, start[first] == start[second]
    ends = (
        np.concatenate([face, face + count]),
        np.concatenate([neighbour + count * against, neighbour + count * ~against]),
    )
    links = coo_array((np.ones(len(ends[0])), ends), shape=(2 * count, 2 * count))
    parts, label = connected_components(links, directed=False)
    if parts != 2 or (label[:count] == label[count:]).any():
        return None
    mirrored: Mask = label[:count] != label[0]
    return mirrored
