"""A convex polyhedron fattened by the rod's radius: faces, cylinders about the edges, spheres about the vertices.

The centre line of a round rod touches this surface exactly.  Its pieces are charts: on a face the place is a point of the plane, on
an edge a point of the edge and the angle of the normal, at a vertex the normal.  On every piece the equations of the rod are smooth
and regular however small the radius; a step of Newton's method that leaves a piece ends at its border and goes on next door.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from scan3d.arrays import Array, Index
from scan3d.spatial.bodies import Patch, sphere_directions
from scan3d.spatial.vectors import basis, cross, dot, unit

# Directions whose highest vertices the search for a highest vertex begins with.
_COARSE = 500
# Largest turn of a normal in one step of Newton's method, in radians.
_LARGEST_TURN = 0.5
# A mesh is fine if the median angle between its faces is smaller than this, in radians.  Friction on it then refers to normals
# that are interpolated across all angles below the second: its facets stand for a smooth surface.
_FINE, _SMOOTH = 0.09, 0.44
# Angle between two faces, in radians, below which they count as one plane.
_FLAT = 1e-9


class RoundedPolyhedron:
    """The convex polyhedron with vertices (v, 3) and outward triangles (f, 3), fattened by the rod's radius.

    Raises ValueError if the triangles are not a closed surface, or the radius is below zero.
    """

    smooth = False

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, radius: float = 0.0) -> None:
        if not 0 <= radius < np.inf:
            raise ValueError(f"the rod's radius must be a number >= 0, got {radius}")
        self.radius = float(radius)
        self.vertices = np.asarray(vertices, dtype=float).T.copy()
        triangles = np.asarray(faces, dtype=np.intp)
        self._faces(triangles)
        self._edges(triangles)
        self._stars()
        self._smoothed(triangles)

    def _smoothed(self, triangles: Index) -> None:
        """Normals at the corners of the faces, averaged over the faces that meet there without a sharp edge."""
        count = len(triangles)
        turned = self.angle[self.angle > _FLAT]
        limit = _SMOOTH if len(turned) and np.median(turned) < _FINE else 0.0
        smooth = np.flatnonzero(self.angle < max(limit, _FLAT))
        pairs = []
        for end in (self.tail, self.head):
            sides = [
                face[smooth] + count * np.argmax(triangles[face[smooth]] == end[smooth, None], axis=1)
                for face in (self.left, self.right)
            ]
            pairs.append(np.stack(sides))
        first, second = np.concatenate(pairs, axis=1)
        graph = coo_array((np.ones(len(first)), (first, second)), shape=(3 * count, 3 * count))
        groups, group = connected_components(graph, directed=False)
        corners = self.vertices[:, triangles.T]  # (3, 3 corners, f)
        to_next, to_last = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
        cosine = dot(to_next, to_last) / np.sqrt(dot(to_next, to_next) * dot(to_last, to_last))
        weighted = np.arccos(np.clip(cosine, -1, 1))[None] * self.normals[:, None]
        sums = np.stack([np.bincount(group, component.ravel(), minlength=groups) for component in weighted])
        self.corner_normals = unit(sums)[:, group].reshape(3, 3, count).swapaxes(0, 1)
        self.centre = corners.mean(axis=1)
        height = np.stack([dot(self.out[(k + 1) % 3], corners[:, (k + 1) % 3] - corners[:, k]) for k in range(3)])
        self.barycentric = -np.roll(self.out, -1, axis=0) / height[:, None]
        self.edge_normals = [
            np.stack(
                [
                    self.corner_normals[np.argmax(triangles[face] == end[:, None], axis=1), :, face].T
                    for end in (self.tail, self.head)
                ]
            )
            for face in (self.left, self.right)
        ]
        vertex = triangles.T.ravel()
        low, high = np.full(self.vertices.shape[1], 3 * count), np.full(self.vertices.shape[1], -1)
        np.minimum.at(low, vertex, group)
        np.maximum.at(high, vertex, group)
        # how many smooth sides meet at a vertex; with sharp edges only, friction refers to the true normals
        pairs = np.unique(np.stack([vertex, group]), axis=1)
        self.sides = np.bincount(pairs[0], minlength=self.vertices.shape[1]) if limit else np.full(len(low), 3)
        normals = unit(sums)
        self.vertex_normals = np.stack(
            [normals[:, np.maximum(chosen, 0)] for chosen in (np.minimum(low, groups - 1), high)]
        )

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
        self._neighbours = np.where(forward, self.head[self.star], self.tail[self.star])
        everywhere = sphere_directions(_COARSE)
        self._coarse = np.unique(np.argmax(everywhere.T @ self.vertices, axis=1))

    def _parts(self, feature: Index) -> tuple[Index, Index, Index]:
        """The rows with features of each kind: faces, edges, vertices."""
        faces, edges = self.normals.shape[1], len(self.tail)
        is_face, is_vertex = feature < faces, feature >= faces + edges
        return np.flatnonzero(is_face), np.flatnonzero(~is_face & ~is_vertex), np.flatnonzero(is_vertex)

    def patch(self, feature: Index, coordinates: Array) -> Patch:
        faces, edges = self.normals.shape[1], len(self.tail)
        on_face, on_edge, at_vertex = self._parts(feature)
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
        self._smooth_normals(result, feature, coordinates)
        return result

    def _smooth_normals(self, result: Patch, feature: Index, coordinates: Array) -> None:
        """Fill in the normals that friction refers to, interpolated between those of the corners."""
        faces, edges = self.normals.shape[1], len(self.tail)
        on_face, on_edge, at_vertex = self._parts(feature)
        if len(on_face):
            number = feature[on_face]
            corner = self.corner_normals[:, :, number]
            slope = self.barycentric[:, :, number]
            weight = (slope * (coordinates[:, on_face] - self.centre[:, number])).sum(axis=1) + 1 / 3
            along = (self.first[:, number], self.second[:, number])
            slopes = (((slope * t).sum(axis=1)[:, None] * corner).sum(axis=0) for t in along)
            _put_unit(result, on_face, (weight[:, None] * corner).sum(axis=0), *slopes)
        if len(on_edge):
            number = feature[on_edge] - faces
            tau = coordinates[0, on_edge] / self.length[number]
            turn = np.maximum(self.angle[number], _FLAT)
            part = np.minimum(coordinates[1, on_edge] / turn, 1.0)
            (a, b), (c, d) = self.edge_normals[0][:, :, number], self.edge_normals[1][:, :, number]
            # the true normal, corrected by what the sides' normals differ from those of the faces
            left = a + tau * (b - a) - self.left_normal[:, number]
            right = c + tau * (d - c) - self.normals[:, self.right[number]]
            by_tau = ((b - a) + part * ((d - c) - (b - a))) / self.length[number]
            by_angle = result.normal_2[:, on_edge] + (right - left) / turn
            _put_unit(result, on_edge, result.normal[:, on_edge] + left + part * (right - left), by_tau, by_angle)
        if len(at_vertex):
            number = feature[at_vertex] - faces - edges
            n, u, v = (getattr(result, name)[:, at_vertex] for name in ("normal", "normal_1", "normal_2"))
            result.law_normal[:, at_vertex], result.law_normal_1[:, at_vertex], result.law_normal_2[:, at_vertex] = (
                n,
                u,
                v,
            )
            crease = self.sides[number] <= 2
            if crease.any():
                at, number, n = at_vertex[crease], number[crease], n[:, crease]
                _put_unit(result, at, *_in_plane(self.vertex_normals[:, :, number], n, u[:, crease], v[:, crease]))

    def _on_edge(self, number: Index, angle: Array) -> tuple[Array, Array, Array]:
        """Direction of edges, and normals at angles from their left faces with their derivatives."""
        cos, sin = np.cos(angle), np.sin(angle)
        left, turned = self.left_normal[:, number], self.turned[:, number]
        return self.direction[:, number], cos * left + sin * turned, cos * turned - sin * left

    def moved(self, feature: Index, coordinates: Array, patch: Patch, step: Array) -> tuple[Index, Array, Array]:
        feature, coordinates, part = feature.copy(), coordinates.copy(), np.ones(len(feature))
        on_face, on_edge, at_vertex = self._parts(feature)
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
        flat = self.angle[edge] < _FLAT
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
            across = self._neighbours[:, number[rows]]
            height = dot(self.vertices[:, across], normal[:, None, rows])
            best = height.argmax(axis=0)
            higher = height.max(axis=0) > dot(self.vertices[:, number[rows]], normal[:, rows])
            number[rows[higher]] = across[best, np.arange(len(rows))][higher]
            rows = rows[higher]
        feature = self.normals.shape[1] + len(self.tail) + number
        return feature, normal, self.vertices[:, number] + self.radius * normal


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
    crease = size > 1e-6
    k = across / np.where(crease, size, 1.0)
    projected = (np.where(crease, vector - dot(vector, k) * k, 0.0) for vector in (n, u, v))
    first, *rest = projected
    return np.where(crease, first, a), rest[0], rest[1]
