"""The normals of a mesh that friction refers to: where its facets stand for a smooth surface, interpolated between those of the
faces.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from scan3d.arrays import Array, Index
from scan3d.spatial.bodies import Patch
from scan3d.spatial.facets import FLAT, Facets
from scan3d.spatial.vectors import cross, dot, unit

# A mesh is fine if the median angle between its faces is smaller than this, in radians.  Friction on it then refers to normals
# that are interpolated across all angles below the second.
_FINE, _SMOOTH = 0.09, 0.44
# Sine of the angle between the normals of two sides of a crease, below which they count as one.
_ONE_SIDE = 1e-6
# Least angle by which the normal of a face counts at its corner.  Without it a corner of a sliver, whose angle is 0 but for
# rounding, would have no normal where all edges are sharp; larger, slivers would turn the normals of their neighbours.
_LEAST_ANGLE = 1e-9


class FrictionNormals:
    """Normals at the corners of the faces, averaged over the faces that meet there without a sharp edge."""

    def __init__(self, facets: Facets) -> None:
        self._facets = facets
        triangles, count = facets.triangles, len(facets.triangles)
        turned = facets.angle[facets.angle > FLAT]
        limit = _SMOOTH if len(turned) and np.median(turned) < _FINE else 0.0
        groups, group = _smooth_corners(facets, np.flatnonzero(facets.angle < max(limit, FLAT)))
        corners = facets.vertices[:, triangles.T]  # (3, 3 corners, f)
        to_next, to_last = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
        cosine = dot(to_next, to_last) / np.sqrt(dot(to_next, to_next) * dot(to_last, to_last))
        angle = np.maximum(np.arccos(np.clip(cosine, -1, 1)), _LEAST_ANGLE)
        weighted = angle * facets.normals[:, None]
        normals = unit(np.array([np.bincount(group, part.ravel(), minlength=groups) for part in weighted], dtype=float))
        self._corners = normals[:, group].reshape(3, 3, count).swapaxes(0, 1)
        # a point's weights of the corners of a face are 1/3 + slope·(point - centre)
        self._centre = corners.mean(axis=1)
        height = np.stack([dot(facets.out[(k + 1) % 3], corners[:, (k + 1) % 3] - corners[:, k]) for k in range(3)])
        self._slopes = -np.roll(facets.out, -1, axis=0) / height[:, None]
        self._edges = [
            [self._at_end(face, end) for end in (facets.tail, facets.head)] for face in (facets.left, facets.right)
        ]
        self._vertices(normals, group, smooth=limit > 0)

    def _at_end(self, face: Index, end: Index) -> Array:
        """Normals (3, e) of faces at their corners at the vertices `end` (e,)."""
        corner = np.argmax(self._facets.triangles[face] == end[:, None], axis=1)
        return np.asarray(self._corners[corner, :, face].T)

    def _vertices(self, normals: Array, group: Index, smooth: bool) -> None:
        """How many smooth sides meet at a vertex, and the normals of two of them."""
        count, vertex = self._facets.vertices.shape[1], self._facets.triangles.T.ravel()
        first, last = np.full(count, normals.shape[1] - 1), np.zeros(count, dtype=np.intp)
        np.minimum.at(first, vertex, group)
        np.maximum.at(last, vertex, group)
        self._sides = np.stack([normals[:, first], normals[:, last]])
        # between sharp edges only, friction refers to the true normals
        sides = np.bincount(np.unique(np.stack([vertex, group]), axis=1)[0], minlength=count)
        self._is_smooth = (sides <= 2) & smooth

    def put(self, result: Patch, feature: Index, coordinates: Array) -> None:
        """Fill in the normals that friction refers to, of places on the polyhedron."""
        on_face, on_edge, at_vertex = self._facets.parts(feature)
        if len(on_face):
            self._on_faces(result, on_face, feature[on_face], coordinates[:, on_face])
        if len(on_edge):
            number = feature[on_edge] - self._facets.normals.shape[1]
            self._on_edges(result, on_edge, number, coordinates[:2, on_edge])
        if len(at_vertex):
            number = feature[at_vertex] - self._facets.normals.shape[1] - len(self._facets.tail)
            self._at_vertices(result, at_vertex, number)

    def _on_faces(self, result: Patch, rows: Index, number: Index, point: Array) -> None:
        corner, slope = self._corners[:, :, number], self._slopes[:, :, number]
        weight = (slope * (point - self._centre[:, number])).sum(axis=1) + 1 / 3
        along = (self._facets.first[:, number], self._facets.second[:, number])
        slopes = (((slope * t).sum(axis=1)[:, None] * corner).sum(axis=0) for t in along)
        _put_unit(result, rows, (weight[:, None] * corner).sum(axis=0), *slopes)

    def _on_edges(self, result: Patch, rows: Index, number: Index, place: Array) -> None:
        facets = self._facets
        tau, turn = place[0] / facets.length[number], np.maximum(facets.angle[number], FLAT)
        part = np.minimum(place[1] / turn, 1.0)
        (a, b), (c, d) = ([end[:, number] for end in side] for side in self._edges)
        # the true normal, corrected by what the sides' normals differ from those of the faces
        left = a + tau * (b - a) - facets.left_normal[:, number]
        right = c + tau * (d - c) - facets.normals[:, facets.right[number]]
        by_tau = ((b - a) + part * ((d - c) - (b - a))) / facets.length[number]
        by_angle = result.normal_2[:, rows] + (right - left) / turn
        _put_unit(result, rows, result.normal[:, rows] + left + part * (right - left), by_tau, by_angle)

    def _at_vertices(self, result: Patch, rows: Index, number: Index) -> None:
        n, u, v = (column[:, rows] for column in (result.normal, result.normal_1, result.normal_2))
        for column, vector in zip(
            (result.law_normal, result.law_normal_1, result.law_normal_2), (n, u, v), strict=True
        ):
            column[:, rows] = vector
        smooth = self._is_smooth[number]
        if smooth.any():
            sides = self._sides[:, :, number[smooth]]
            _put_unit(result, rows[smooth], *_in_plane(sides, n[:, smooth], u[:, smooth], v[:, smooth]))


def _smooth_corners(facets: Facets, smooth: Index) -> tuple[int, Index]:
    """Number of the groups of corners that meet at a vertex across the edges `smooth`, and the group (3 f,) of every corner."""
    triangles, count = facets.triangles, len(facets.triangles)
    pairs = []
    for end in (facets.tail, facets.head):
        sides = [
            face[smooth] + count * np.argmax(triangles[face[smooth]] == end[smooth, None], axis=1)
            for face in (facets.left, facets.right)
        ]
        pairs.append(np.stack(sides))
    first, second = np.concatenate(pairs, axis=1)
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(3 * count, 3 * count))
    groups, group = connected_components(graph, directed=False)
    return groups, group


def _put_unit(patch: Patch, rows: Index, vector: Array, slope_1: Array, slope_2: Array) -> None:
    """Set the normals that friction refers to, and their derivatives, from vectors that are scaled to unit length."""
    size = np.sqrt(dot(vector, vector))
    n = vector / size
    patch.law_normal[:, rows] = n
    patch.law_normal_1[:, rows] = (slope_1 - dot(slope_1, n) * n) / size
    patch.law_normal_2[:, rows] = (slope_2 - dot(slope_2, n) * n) / size


def _in_plane(sides: Array, n: Array, u: Array, v: Array) -> tuple[Array, Array, Array]:
    """Normals (3, n) projected into the planes of the normals of two sides (2, 3, n), and so for their derivatives u and v.

    Where the sides are one, it is theirs, and the derivatives are zero.
    """
    a, b = sides
    across = cross(a, b)
    size = np.sqrt(dot(across, across))
    crease = size > _ONE_SIDE
    k = across / np.where(crease, size, 1.0)
    projected = (np.where(crease, vector - dot(vector, k) * k, 0.0) for vector in (n, u, v))
    first, *rest = projected
    return np.where(crease, first, a), rest[0], rest[1]
