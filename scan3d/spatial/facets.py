"""Faces, edges and vertices of a polyhedron, and what lies next to what."""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array, Index
from scan3d.spatial.vectors import basis, cross, dot, unit

# Angle between two faces, in radians, below which they count as one plane.
FLAT = 1e-9


class Facets:
    """The polyhedron with vertices (3, v) and outward triangles (f, 3).

    Its features are numbered: first the faces, then the edges, then the vertices.  Raises ValueError if the triangles are not a
    closed surface.
    """

    def __init__(self, vertices: Array, triangles: Index) -> None:
        self.vertices, self.triangles = vertices, triangles
        self._faces(triangles)
        self._edges(triangles)
        self._stars()

    def _faces(self, triangles: Index) -> None:
        a, b, c = (self.vertices[:, triangles[:, k]] for k in range(3))
        self.normals = unit(cross(b - a, c - a))
        self.first, self.second = basis(self.normals)
        # in-plane outward normal and offset of the side from corner k to the next
        corners = (a, b, c)
        self.out = np.stack([unit(cross(corners[(k + 1) % 3] - corners[k], self.normals)) for k in range(3)])
        self.out_offset = np.stack([dot(self.out[k], corners[k]) for k in range(3)])

    def _edges(self, triangles: Index) -> None:
        count = len(triangles)
        face, side = np.tile(np.arange(count), 3), np.repeat(np.arange(3), count)
        tail, head = triangles[face, side], triangles[face, (side + 1) % 3]
        # an edge runs forwards in its right face and backwards in its left one
        low, high, forward = np.minimum(tail, head), np.maximum(tail, head), tail < head
        order = np.lexsort((forward, high, low))
        left, right = order[0::2], order[1::2]
        paired = (
            len(order) % 2 == 0 and np.array_equal(low[left], low[right]) and np.array_equal(high[left], high[right])
        )
        if not (paired and (~forward[left]).all() and forward[right].all()):
            raise ValueError("the triangles of a polyhedron must be a closed surface, with every edge in two of them")
        self.tail, self.head = low[left], high[left]
        self.left, self.right = face[left], face[right]
        span = self.vertices[:, self.head] - self.vertices[:, self.tail]
        self.length = np.sqrt(dot(span, span))
        self.direction = span / self.length
        self.left_normal = self.normals[:, self.left]
        self.turned = cross(self.left_normal, self.direction)
        right_normal = self.normals[:, self.right]
        self.angle = np.maximum(np.arctan2(dot(right_normal, self.turned), dot(right_normal, self.left_normal)), 0.0)
        self.side = np.empty((3, count), dtype=np.intp)
        number = np.arange(len(left))
        self.side[side[left], face[left]] = number
        self.side[side[right], face[right]] = number

    def _stars(self) -> None:
        """The edges at every vertex, padded by the first of them, and their directions away from it."""
        edges = len(self.tail)
        vertex = np.concatenate([self.tail, self.head])
        order = np.argsort(vertex, kind="stable")
        degree = np.bincount(vertex, minlength=self.vertices.shape[1])
        begin = np.cumsum(degree) - degree
        column = np.arange(degree.max())[:, None]
        chosen = order[np.minimum(begin + np.where(column < degree, column, 0), len(order) - 1)]
        self.star = chosen % edges
        forward = chosen < edges
        self.away = np.where(forward, 1.0, -1.0) * self.direction[:, self.star]
        self.neighbours = np.where(forward, self.head[self.star], self.tail[self.star])

    def parts(self, feature: Index) -> tuple[Index, Index, Index]:
        """The rows with features of each kind: faces, edges, vertices."""
        faces, edges = self.normals.shape[1], len(self.tail)
        is_face, is_vertex = feature < faces, feature >= faces + edges
        return np.flatnonzero(is_face), np.flatnonzero(~is_face & ~is_vertex), np.flatnonzero(is_vertex)
