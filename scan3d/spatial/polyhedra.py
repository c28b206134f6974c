"""A convex polyhedron fattened by the rod's radius: faces, cylinders about the edges, spheres about the vertices.

The centre line of a round rod touches this surface exactly.  Its pieces are charts: on a face the place is a point of the
plane, on an edge a point of the edge and the angle of the normal, at a vertex the normal.  On every piece the equations of the
rod are smooth and regular however small the radius; a step of Newton's method that leaves a piece ends at its border and goes
on next door.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from scan3d.arrays import Array, Index
from scan3d.spatial.bodies import Patch, sphere_directions
from scan3d.spatial.facets import FLAT, Facets
from scan3d.spatial.friction_normals import FrictionNormals
from scan3d.spatial.vectors import basis, dot, unit

# Directions whose highest vertices the search for a highest vertex begins with.
_COARSE = 500
# Largest turn of a normal in one step of Newton's method, in radians.
_LARGEST_TURN = 0.5


class RoundedPolyhedron(Facets):
    """The convex polyhedron with vertices (v, 3) and outward triangles (f, 3), fattened by the rod's radius.

    Raises ValueError if the triangles are not a closed surface, or the radius is below zero.
    """

    smooth = False

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, radius: float = 0.0) -> None:
        if not 0 <= radius < np.inf:
            raise ValueError(f"the rod's radius must be a number >= 0, got {radius}")
        self.radius = float(radius)
        super().__init__(np.asarray(vertices, dtype=float).T.copy(), np.asarray(faces, dtype=np.intp))
        self._friction_normals = FrictionNormals(self)
        self._coarse = np.unique(np.argmax(sphere_directions(_COARSE).T @ self.vertices, axis=1))

    def patch(self, feature: Index, coordinates: Array) -> Patch:
        faces, edges = self.normals.shape[1], len(self.tail)
        on_face, on_edge, at_vertex = self.parts(feature)
        result = Patch(*(np.zeros_like(coordinates) for _ in Patch._fields))
        if len(on_face):
            number = feature[on_face]
            n = self.normals[:, number]
            result.point[:, on_face], result.normal[:, on_face] = coordinates[:, on_face] + self.radius * n, n
            result.point_1[:, on_face], result.point_2[:, on_face] = self.first[:, number], self.second[:, number]
        if len(on_edge):
            number = feature[on_edge] - faces
            along, angle = coordinates[0, on_edge], coordinates[1, on_edge]
            direction, n, turn = self._on_edge(number, angle)
            point = self.vertices[:, self.tail[number]] + along * direction + self.radius * n
            result.point[:, on_edge], result.normal[:, on_edge] = point, n
            result.point_1[:, on_edge], result.point_2[:, on_edge] = direction, self.radius * turn
            result.normal_2[:, on_edge] = turn
        if len(at_vertex):
            n = coordinates[:, at_vertex]
            u, v = basis(n)
            point = self.vertices[:, feature[at_vertex] - faces - edges] + self.radius * n
            result.point[:, at_vertex], result.normal[:, at_vertex] = point, n
            result.point_1[:, at_vertex], result.point_2[:, at_vertex] = self.radius * u, self.radius * v
            result.normal_1[:, at_vertex], result.normal_2[:, at_vertex] = u, v
        self._friction_normals.put(result, feature, coordinates)
        return result

    def _on_edge(self, number: Index, angle: Array) -> tuple[Array, Array, Array]:
        """Direction of edges, and normals at angles from their left faces with their derivatives."""
        cos, sin = np.cos(angle), np.sin(angle)
        left, turned = self.left_normal[:, number], self.turned[:, number]
        return self.direction[:, number], cos * left + sin * turned, cos * turned - sin * left

    def moved(self, feature: Index, coordinates: Array, patch: Patch, step: Array) -> tuple[Index, Array, Array]:
        feature, coordinates, part = feature.copy(), coordinates.copy(), np.ones(len(feature))
        on_face, on_edge, at_vertex = self.parts(feature)
        if len(on_face):
            self._move_on_face(on_face, feature, coordinates, step, part)
        if len(on_edge):
            self._move_on_edge(on_edge, feature, coordinates, step, part)
        if len(at_vertex):
            self._move_at_vertex(at_vertex, feature, coordinates, patch, step, part)
        return feature, coordinates, part

    def _move_on_face(self, rows: Index, feature: Index, coordinates: Array, step: Array, part: Array) -> None:
        faces, number, p = self.normals.shape[1], feature[rows], coordinates[:, rows]
        delta = step[0, rows] * self.first[:, number] + step[1, rows] * self.second[:, number]
        out = self.out[:, :, number]
        gap = np.maximum(self.out_offset[:, number] - (out * p).sum(axis=1), 0.0)
        rate = (out * delta).sum(axis=1)
        limit = np.where(rate > 0, gap / np.where(rate > 0, rate, 1.0), np.inf)
        crossed = np.argmin(limit, axis=0)
        taken = np.minimum(limit[crossed, np.arange(len(rows))], 1.0)
        p = p + taken * delta
        leaves = taken < 1
        part[rows], coordinates[:, rows] = taken, p
        rows, number, p = rows[leaves], number[leaves], p[:, leaves]
        edge = self.side[crossed[leaves], number]
        other = np.where(self.left[edge] == number, self.right[edge], self.left[edge])
        flat = self.angle[edge] < FLAT
        feature[rows] = np.where(flat, other, faces + edge)
        along = np.clip(dot(p - self.vertices[:, self.tail[edge]], self.direction[:, edge]), 0, self.length[edge])
        on_edge = np.stack([along, np.where(self.left[edge] == number, 0.0, self.angle[edge]), np.zeros(len(rows))])
        coordinates[:, rows] = np.where(flat, p, on_edge)

    def _move_on_edge(self, rows: Index, feature: Index, coordinates: Array, step: Array, part: Array) -> None:
        faces, edges = self.normals.shape[1], len(self.tail)
        number = feature[rows] - faces
        end = np.stack([self.length[number], self.angle[number]])
        place, delta = coordinates[:2, rows], step[:, rows]
        delta = delta * np.minimum(1.0, _LARGEST_TURN / np.maximum(np.abs(delta[1]), 1e-300))
        gap = np.where(delta > 0, end - place, place)
        limit = np.where(delta != 0, np.maximum(gap, 0.0) / np.where(delta != 0, np.abs(delta), 1.0), np.inf)
        crossed = np.argmin(limit, axis=0)
        taken = np.minimum(limit[crossed, np.arange(len(rows))], 1.0)
        place = np.clip(place + taken * delta, 0.0, end)
        part[rows] = taken * np.minimum(1.0, _LARGEST_TURN / np.maximum(np.abs(step[1, rows]), 1e-300))
        coordinates[:2, rows] = place
        upper = delta[crossed, np.arange(len(rows))] > 0
        leaves = taken < 1
        to_vertex, to_face = leaves & (crossed == 0), leaves & (crossed == 1)
        at, e = rows[to_vertex], number[to_vertex]
        feature[at] = faces + edges + np.where(upper[to_vertex], self.head[e], self.tail[e])
        coordinates[:, at] = self._on_edge(e, place[1, to_vertex])[1]
        at, e = rows[to_face], number[to_face]
        feature[at] = np.where(upper[to_face], self.right[e], self.left[e])
        coordinates[:, at] = self.vertices[:, self.tail[e]] + place[0, to_face] * self.direction[:, e]

    def _move_at_vertex(
        self, rows: Index, feature: Index, coordinates: Array, patch: Patch, step: Array, part: Array
    ) -> None:
        faces, edges = self.normals.shape[1], len(self.tail)
        number, n = feature[rows] - faces - edges, coordinates[:, rows]
        turn = np.hypot(step[0, rows], step[1, rows])
        scale = np.minimum(1.0, _LARGEST_TURN / np.maximum(turn, 1e-300))
        w = scale * (step[0, rows] * patch.normal_1[:, rows] + step[1, rows] * patch.normal_2[:, rows])
        away = self.away[:, :, number]
        gap = np.maximum(-(away * n[:, None]).sum(axis=0), 0.0)
        rate = (away * w[:, None]).sum(axis=0)
        limit = np.where(rate > 0, gap / np.where(rate > 0, rate, 1.0), np.inf)
        crossed = np.argmin(limit, axis=0)
        taken = np.minimum(limit[crossed, np.arange(len(rows))], 1.0)
        part[rows] = taken * scale
        n = unit(n + taken * w)
        coordinates[:, rows] = n
        leaves = taken < 1
        at, vertex, n = rows[leaves], number[leaves], n[:, leaves]
        e = self.star[crossed[leaves], vertex]
        feature[at] = faces + e
        angle = np.arctan2(dot(n, self.turned[:, e]), dot(n, self.left_normal[:, e]))
        along = np.where(self.tail[e] == vertex, 0.0, self.length[e])
        coordinates[:, at] = np.stack([along, np.clip(angle, 0.0, self.angle[e]), np.zeros(len(at))])

    def extreme(self, normal: Array) -> tuple[Index, Array, Array]:
        number = self._coarse[np.argmax(normal.T @ self.vertices[:, self._coarse], axis=1)]
        # from the best of some vertices upwards along edges: on a convex body that leads to the highest
        rows = np.arange(len(number))
        while len(rows):
            across = self.neighbours[:, number[rows]]
            height = dot(self.vertices[:, across], normal[:, None, rows])
            best = height.argmax(axis=0)
            higher = height.max(axis=0) > dot(self.vertices[:, number[rows]], normal[:, rows])
            number[rows[higher]] = across[best, np.arange(len(rows))][higher]
            rows = rows[higher]
        feature = self.normals.shape[1] + len(self.tail) + number
        return feature, normal, self.vertices[:, number] + self.radius * normal
