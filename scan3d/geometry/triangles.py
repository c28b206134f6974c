"""Triangles (..., 3, 3): areas, halves, the distances of points from them, and vertices that readers of files would merge.

Readers make one vertex of those that agree to their precision: trimesh of those that agree in eight decimals, every reader of
STL, and VTK in a PLY, of those that agree in float32.  Triangles with two such corners lose their area, and a closed surface
then counts as open.  So such vertices are merged before a surface is written, and the triangles between them are removed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from scan3d.arrays import NEGLIGIBLE, Array, Index, Mask, unit_or_zero


def dot(a: Array, b: Array) -> Array:
    """Scalar products (...) of vectors (..., 3)."""
    return np.einsum("...x,...x->...", a, b)


def spanned(corners: Array) -> Array:
    """Products (m, 3) of the first two edges of triangles (m, 3, 3), from their first corner: normals, twice the area long."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def face_normals(mesh: Any) -> Array:
    """Unit normals (m, 3) of a mesh's faces, zero for those without area; trimesh takes all below an absolute area for such."""
    return unit_or_zero(spanned(mesh.vertices.view(np.ndarray)[mesh.faces.view(np.ndarray)]))


def largest_of_three(values: Array) -> Array:
    """The largest (m,) of each row of values (m, 3); several times as fast as ``max(axis=1)``."""
    return np.maximum(np.maximum(values[:, 0], values[:, 1]), values[:, 2])


def areas(corners: Array) -> Array:
    """Areas (m,) of triangles (m, 3, 3)."""
    doubled: Array = np.linalg.norm(spanned(corners), axis=1)
    return doubled / 2


def longest_first(corners: Array) -> Index:
    """Order (m, 3) of the corners of triangles (m, 3, 3) that puts the longest edge first and keeps the winding.

    Of edges that are equally long but for rounding it is the first, which rounding does not decide.
    """
    edges = np.roll(corners, -1, axis=1) - corners
    first, second, third = dot(edges, edges).T
    than = 1 + NEGLIGIBLE
    longest = np.where(third > than * np.maximum(first, second), 2, second > than * first)
    return np.array([(0, 1, 2), (1, 2, 0), (2, 0, 1)])[longest]


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
    return np.linalg.norm(offset_from(points, corners), axis=-1)


def offset_from(points: Array, corners: Array) -> Array:
    """Vectors (..., 3) to points (..., 3) from the nearest points of triangles (..., 3, 3), longest edge first.

    They are computed in coordinates along the longest edge and across it, because the normal of a sliver has no correct digits.
    The leading axes, one at least, are broadcast.
    """
    shape = np.broadcast_shapes(points.shape[:-1], corners.shape[:-2])
    offset = np.empty((*shape, 3))
    points, corners = np.broadcast_to(points, offset.shape), np.broadcast_to(corners, (*shape, 3, 3))
    # so many at once as the processor's cache holds
    rows = max(1, 8000 // max(1, int(np.prod(shape[1:]))))
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
        away = np.linalg.norm(offset, axis=-1)
        nearer = away < distance
        shortest[nearer], distance[nearer] = offset[nearer], away[nearer]
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


def opposite_edges(faces: Index) -> Index | None:
    """For each directed edge (m, 3) of faces (m, 3), from a corner to the next, the number of the same edge in the opposite
    direction, with ``3 f + k`` for the edge of the face f that begins at its corner k.

    None unless every edge belongs to exactly two faces, which run through it in opposite directions.
    """
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    up, down, count = np.flatnonzero(start < end), np.flatnonzero(start > end), int(faces.max(initial=-1)) + 1
    if len(up) != len(down) or len(up) + len(down) < faces.size:
        return None
    edge, reverse = start[up] * count + end[up], end[down] * count + start[down]
    order, reverse_order = np.argsort(edge), np.argsort(reverse)
    edge, up, down = edge[order], up[order], down[reverse_order]
    if (edge[1:] == edge[:-1]).any() or not np.array_equal(edge, reverse[reverse_order]):
        return None
    opposite = np.empty(faces.size, dtype=np.int64)
    opposite[up], opposite[down] = down, up
    return opposite.reshape(-1, 3)


def mirrored_faces(faces: Index) -> tuple[Mask, bool]:
    """Which triangles (m,), given by vertex numbers (m, 3), are wound against the first one of their part, and whether they are
    one closed surface with two sides.

    Two faces that are wound alike run through their common edge in opposite directions.  So neighbours decide, and no
    geometry: the normal of a sliver is rounding.  Faces are neighbours if they alone have an edge; in a part with one side only
    none counts as mirrored.
    """
    count = len(faces)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((high, low))
    same = (low[order[1:]] == low[order[:-1]]) & (high[order[1:]] == high[order[:-1]])
    pair = same & ~np.append(same[1:], False) & ~np.append(False, same[:-1])
    first, second = order[:-1][pair], order[1:][pair]
    # each face stands twice in this graph, as it is and mirrored; neighbours that are wound alike are joined
    face, neighbour, against = first // 3, second // 3, start[first] == start[second]
    beside = np.concatenate([neighbour + count * against, neighbour + count * ~against])
    parts, label = linked(np.concatenate([face, face + count]), beside, 2 * count)
    mirrored: Mask = label[:count] > label[count:]
    return mirrored, parts == 2 and 2 * len(first) == faces.size and bool((label[:count] != label[count:]).all())


def linked(one: Index, other: Index, count: int) -> tuple[int, Index]:
    """How many groups so many members are in, of which those of pairs (k,) belong together, and the group (count,) of each.

    Groups are numbered by their first members.
    """
    links = coo_array((np.ones(len(one)), (one, other)), shape=(count, count))
    groups, group = connected_components(links, directed=False)
    return groups, group


def distance_of_readers(points: Array) -> float:
    """The distance beyond which two of the points (n, 3) remain two in every reader; 0 if that were too much of the body.

    Vertices remain two if a coordinate differs by more than 1e-8, and by more than the spacing of float32 at the largest
    coordinate.  A body far from the origin keeps only the former, and a body smaller than about 0.002 neither.
    """
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    single = float(np.finfo(np.float32).eps) * float(np.abs(points).max())
    # trimesh tells vertices apart by 1e-8 (`trimesh.tol.merge`)
    for spacing in (max(single, 1e-8), 1e-8):
        distance = float(np.sqrt(3) * spacing)
        if distance <= 1e-5 * size:  # more would be seen
            return distance
    return 0.0


def representatives(points: Array, distance: float) -> Index:
    """For every point (n, 3) the index (n,) of the point it is merged with, which is its own if it is kept.

    The points that are kept are farther apart than the distance, and every other one lies within it of one of them.  Points
    far from the middle are kept first, so that the corners of a polyhedron remain where they are.
    """
    chosen = np.arange(len(points))
    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
    if not len(pairs):
        return chosen
    involved = np.unique(pairs)
    offset = points[involved] - points.mean(axis=0)
    neighbours: dict[int, list[int]] = {int(i): [] for i in involved}
    for i, j in pairs.tolist():
        neighbours[i].append(j)
        neighbours[j].append(i)
    free = set(neighbours)
    for i in involved[np.argsort(-dot(offset, offset), kind="stable")].tolist():
        if i in free:
            free.remove(i)
            for j in neighbours[i]:
                if j in free:
                    free.remove(j)
                    chosen[j] = i
    return chosen


def kept_apart(points: Array, distance: float) -> Index:
    """Numbers (k,), rising, of the points (n, 3) that remain where those closer than a distance are merged.

    Every other point lies within three times the distance of one that remains, and points far from the middle are kept first.
    Unlike `representatives`, this takes no time that grows with the square of the number of points that coincide.
    """
    if not distance:
        return np.arange(len(points))
    offset = points - points.mean(axis=0)
    number = distinct_rows(np.floor(points / distance))[1]
    # the first of each cube is the farthest from the middle
    order = np.lexsort((-dot(offset, offset), number))
    first = np.sort(order[np.diff(number[order], prepend=-1) > 0])
    return first[np.unique(representatives(points[first], distance))]


def collapsed(faces: Index, chosen: Index) -> Index:
    """Triangles (m, 3) after vertices have been merged as by `representatives`, without those that have lost their area.

    Two triangles that have come to lie on each other, with opposite sides, are both removed.  So a closed surface remains
    closed.
    """
    faces = chosen[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    if not len(faces):
        return faces
    first, number = distinct_rows(np.sort(faces, axis=1))
    # +1 for an even order of the corners, -1 for an odd one
    side = np.sign((faces[:, 1] - faces[:, 0]) * (faces[:, 2] - faces[:, 1]) * (faces[:, 2] - faces[:, 0]))
    balance = np.bincount(number, side, len(first))
    # of triangles on one another as many are kept as the sides differ by, in their own order
    kept = np.zeros(len(faces), dtype=bool)
    for sign in (1, -1):
        rows = np.flatnonzero(side == sign)
        order = rows[np.argsort(number[rows], kind="stable")]
        starts = np.r_[True, number[order[1:]] != number[order[:-1]]] if len(order) else np.zeros(0, dtype=bool)
        rank = np.arange(len(order)) - np.maximum.accumulate(np.where(starts, np.arange(len(order)), 0))
        kept[order] = rank < sign * balance[number[order]]
    return faces[kept]


def without_unused(faces: Index) -> tuple[Index, Index]:
    """The vertices (k,) that triangles (m, 3) use, and the triangles by the numbers of these."""
    is_used = np.zeros(int(faces.max(initial=-1)) + 1, dtype=bool)
    is_used[faces] = True
    return np.flatnonzero(is_used), (np.cumsum(is_used) - 1)[faces.reshape(-1, 3)]
