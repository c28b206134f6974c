"""Vertices that readers of mesh files would merge.

Readers make one vertex of those that agree to their precision: trimesh of those that agree in eight decimals, every reader of
STL, and VTK in a PLY, of those that agree in float32.  Triangles with two such corners lose their area, and a closed surface
then counts as open.  So such vertices are merged before a surface is written, and the triangles between them are removed.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import Array, Index
from scan3d.geometry.triangles import distinct_rows, dot

# Decimals by which trimesh tells vertices apart (`trimesh.tol.merge`). It is a convention of that program, and no choice.
_READERS_DECIMALS = 1e-8
# Distance up to which vertices are merged for their readers, relative to the diagonal.
_LARGEST = 1e-5


def distance_of_readers(points: Array) -> float:
    """The distance beyond which two of the points (n, 3) remain two in every reader; 0 if that were too much of the body.

    Vertices remain two if a coordinate differs by more than 1e-8, and by more than the spacing of float32 at the largest
    coordinate.  A body far from the origin keeps only the former, and a body smaller than about 0.002 neither.
    """
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    single = float(np.finfo(np.float32).eps) * float(np.abs(points).max())
    for spacing in (max(single, _READERS_DECIMALS), _READERS_DECIMALS):
        distance = float(np.sqrt(3) * spacing)
        if distance <= _LARGEST * size:
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
    kept: Index = first[np.unique(representatives(points[first], distance))]
    return kept


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
