"""Bodies of Delaunay's tetrahedra: which of them a body consists of is a mask (t,), and its border a closed surface.

Corners (t, 4) are numbers of points, and neighbours (t, 4) numbers of tetrahedra, that opposite each corner, -1 for none.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from scan3d.arrays import Array, Index, Mask, unit_or_zero
from scan3d.geometry.triangles import linked, opposite_edges, without_unused

OPPOSITE = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""The corners of the face opposite each corner."""
# Edges of a tetrahedron, and the corners that each does not have, opposite which lie the faces that contain it.
_EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])


def links(chosen: Mask, neighbours: Index, cost: Array) -> coo_array:
    """The steps between chosen tetrahedra, at the cost of the one that is entered."""
    row, column = np.nonzero(neighbours >= 0)
    other = neighbours[row, column]
    both = chosen[row] & chosen[other]
    return coo_array((cost[other[both]], (row[both], other[both])), shape=(len(chosen),) * 2)


def parts(chosen: Mask, neighbours: Index) -> Index:
    """(t,) number of the connected part of each chosen tetrahedron; t for the others."""
    steps = links(chosen, neighbours, np.ones(len(chosen)))
    return np.where(chosen, connected_components(steps, directed=False)[1], len(chosen))


def border(body: Mask, points: Array, corners: Index, neighbours: Index) -> tuple[Index, Index]:
    """Faces (f, 3), outward, between the body and the rest, and the tetrahedra (f,) of the body that they belong to."""
    outside = np.where(neighbours >= 0, ~body[neighbours], True)
    owner, column = np.nonzero(body[:, None] & outside)
    faces = corners[owner[:, None], OPPOSITE[column]]
    a, b, c = points[faces.T]
    inwards = ((np.cross(b - a, c - a)) * (points[corners[owner, column]] - a)).sum(axis=1) > 0
    faces[inwards] = faces[inwards, ::-1]
    return faces, owner


def shared(faces: Index) -> Index:
    """Edges (e, 2), rising, that belong to more than two faces (f, 3)."""
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1).astype(np.int64)
    size = int(faces.max()) + 1
    key, count = np.unique(ends[:, 0] * size + ends[:, 1], return_counts=True)
    return np.stack(np.divmod(key[count > 2], size), axis=1)


def mend(body: Mask, wrong: Index, corners: Index, neighbours: Index, cost: Array, only_add: bool) -> None:
    """Around each edge (e, 2) body and free space alternate more than once: the fan of least cost changes sides."""
    size = int(corners.max()) + 1
    at_edge = np.zeros(size, dtype=bool)
    at_edge[wrong] = True
    near = np.flatnonzero(at_edge[corners].sum(axis=1) >= 2)
    ends = np.sort(corners[near][:, _EDGES], axis=2).astype(np.int64)
    key = np.sort(wrong[:, 0] * size + wrong[:, 1])
    sought = ends[..., 0] * size + ends[..., 1]
    place = np.minimum(np.searchsorted(key, sought), len(key) - 1)
    row, column = np.nonzero(key[place] == sought)
    # tetrahedra at an edge, and their neighbours across the two faces that contain it
    edge, cell = place[row, column].astype(np.int64), near[row]
    count = len(corners)
    order = np.argsort(edge * count + cell)
    edge, cell, opposite = edge[order], cell[order], _EDGES[::-1][column[order]]
    node = edge * count + cell
    other = neighbours[cell[:, None], opposite]
    beyond = edge[:, None] * count + other
    found = np.minimum(np.searchsorted(node, beyond), len(node) - 1)
    same = (node[found] == beyond) & (other >= 0) & (body[other] == body[cell][:, None])
    start = np.nonzero(same)[0]
    fans, fan = linked(start, found[same], len(node))
    sizes, edge_of, inside = np.bincount(fan, cost[cell]), np.zeros(fans, dtype=np.int64), np.zeros(fans, dtype=bool)
    edge_of[fan], inside[fan] = edge, body[cell]
    sizes[inside] = np.inf if only_add else sizes[inside]
    by_size = np.lexsort((sizes, edge_of))
    smallest = np.zeros(fans, dtype=bool)
    smallest[by_size[np.diff(edge_of[by_size], prepend=-1) > 0]] = True
    change = smallest[fan]
    body[cell[change]] = ~inside[fan][change]


class Edges(NamedTuple):
    """The edges (e,) of faces (f, 3)."""

    start: Index
    """(e,) vertices, of which the first has the smaller number."""
    end: Index
    number: Index
    """(f, 3) the edge after each of the corners."""

    @classmethod
    def of(cls, faces: Index) -> Edges:
        pairs = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2).astype(np.int64)
        count = int(faces.max()) + 1
        key, number = np.unique(pairs[..., 0] * count + pairs[..., 1], return_inverse=True)
        return cls(*np.divmod(key, count), number.reshape(-1, 3))


def refined(vertices: Array, faces: Index, longest: float) -> tuple[Array, Index]:
    """Vertices (n, 3) and faces (f, 3) of the same surface, without edges longer than that: they are halved."""
    used, faces = without_unused(faces)
    vertices = vertices[used]
    while True:
        edges = Edges.of(faces)
        halved = np.linalg.norm(vertices[edges.end] - vertices[edges.start], axis=1) > longest
        if not halved.any():
            return vertices, faces
        middle = (vertices[edges.start] + vertices[edges.end])[halved] / 2
        vertices, faces = np.concatenate([vertices, middle]), divided(faces, edges, halved, len(vertices))


def divided(faces: Index, edges: Edges, split: Mask, first: int) -> Index:
    """Faces (g, 3) whose edges (e,) have a vertex between their ends where they are split; these are numbered from `first`."""
    middle = np.cumsum(split) - 1 + first
    # turn each face so that its first edges are the split ones
    here = split[edges.number]
    count = here.sum(axis=1)
    begin = np.where(count == 1, here.argmax(axis=1), np.where(count == 2, (here.argmin(axis=1) + 1) % 3, 0))
    turn = (begin[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces, turn, axis=1).T
    ab, bc, ca = middle[np.take_along_axis(edges.number, turn, axis=1)].T
    parts = [faces[count == 0]]
    for k, triangles in enumerate(
        (
            ((a, ab, c), (ab, b, c)),
            ((ab, b, bc), (a, ab, bc), (a, bc, c)),
            ((a, ab, ca), (ab, b, bc), (bc, c, ca), (ab, bc, ca)),
        )
    ):
        parts += [np.stack(triangle, axis=1)[count == k + 1] for triangle in triangles]
    return np.concatenate(parts)


def manifold(points: Array, faces: Index, apart: float) -> tuple[Array, Index]:
    """Vertices (n, 3) and faces (f, 3) of a closed surface, outward, in which the faces at each vertex form one fan.

    Of points (m, 3) at which several fans meet each gets a vertex of its own, moved into the fan by the distance `apart`, so
    that readers of files do not merge them again.  Every edge of the faces belongs to two of them.
    """
    opposite = opposite_edges(faces)
    assert opposite is not None, "every edge belongs to two faces"
    corner = np.arange(faces.size)
    # the face across the edge that begins at a corner has the same point at the end of its own edge
    across = opposite.ravel()
    same = across // 3 * 3 + (across + 1) % 3
    count, fan = linked(corner, same, faces.size)
    point = np.empty(count, dtype=np.int64)
    point[fan] = faces.ravel()
    vertices = points[point]
    several = np.bincount(point, minlength=len(points))[point] > 1
    if several.any():
        middle = np.repeat(points[faces].mean(axis=1), 3, axis=0)
        total = np.stack([np.bincount(fan, middle[:, k]) for k in range(3)], axis=1)
        inwards = total / np.bincount(fan)[:, None] - vertices
        vertices[several] += apart * unit_or_zero(inwards[several])
    return vertices, fan.reshape(-1, 3)
