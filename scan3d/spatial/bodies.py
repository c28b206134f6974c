"""Convex bodies that a rod can touch: smooth ones by their support functions, and polyhedra fattened by the rod's radius.

The support function ``h(n) = max <n, x>`` of a strictly convex body has the point with the outward normal n as its gradient,
and its Hessian is the derivative of that point by n (S21).  A rod of radius a touches with its centre line the body fattened
by a, whose support function is ``h + a``.

The fattened polyhedron has faces, cylinders about the edges and spheres about the vertices.  Its pieces are charts: on a face
the place is a point of the plane, on an edge a point of the edge and the angle of the normal, at a vertex the normal.  On every
piece the equations of the rod are smooth and regular however small the radius; a step of Newton's method that leaves a piece
ends at its border and goes on next door.

A place on a body's surface is a `feature` (n,), the number of a piece of the surface, and `coordinates` (3, n) on that piece,
which only the body understands.

Vectors of many places at once have their components along the first axis, for speed: arrays (3, n).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from scan3d.arrays import NEGLIGIBLE, Array, Index
from scan3d.geometry.triangles import linked, opposite_edges

LARGEST_TURN = 0.5
"""Largest turn of a normal in one step of Newton's method, in radians: beyond it the linearisation does not hold."""


def dot(a: Array, b: Array) -> Array:
    """Scalar products (n,) of vectors (3, n)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: Array, b: Array) -> Array:
    """Vector products (3, n) of vectors (3, n)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def unit(a: Array) -> Array:
    """Vectors (3, n) scaled to unit length."""
    return np.asarray(a / np.sqrt(dot(a, a)))


def basis(n: Array) -> tuple[Array, Array]:
    """Two unit vectors (3, n) across the unit vectors n (3, n), so that the three are right-handed.

    They are smooth functions of n but for the pole (0, 0, -1) (T. Duff and others, "Building an orthonormal basis, revisited",
    Journal of Computer Graphics Techniques 6 (2017) 1).
    """
    sign = np.copysign(1.0, n[2])
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return (
        np.stack([1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]]),
        np.stack([b, sign + n[1] * n[1] * a, -n[1]]),
    )


def sphere_directions(count: int = 2000) -> Array:
    """Unit vectors (3, count) spread evenly over the sphere: a Fibonacci lattice."""
    number = np.arange(count) + 0.5
    z, angle = 1 - 2 * number / count, np.pi * (1 + np.sqrt(5)) * number
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z])


def diameter(points: Array) -> float:
    """The largest distance between points (n, 3), found in many directions: at most 1 % too small."""
    return float(np.ptp(points @ sphere_directions(500), axis=0).max())


class Patch(NamedTuple):
    """The surface at n places: point, outward normal, and their derivatives by two local coordinates, each (3, n)."""

    point: Array
    normal: Array
    point_1: Array
    point_2: Array
    normal_1: Array
    normal_2: Array
    law_normal: Array
    """The normal that friction refers to: on a mesh of a smooth body, that of the smooth body."""
    law_normal_1: Array
    law_normal_2: Array


def _allowed(turn: Array) -> Array:
    """The parts (n,) of turns (n,) that one step may take."""
    return np.minimum(1.0, LARGEST_TURN / np.maximum(turn, 1e-300))


class Ellipsoid:
    """An ellipsoid with three semi-axes along the rows of `axes`, fattened by the rod's radius."""

    smooth = True
    """Whether the coordinates are the normal, so that they can be extrapolated from place to place."""

    def __init__(
        self,
        semi_axes: ArrayLike,
        center: ArrayLike = (0.0, 0.0, 0.0),
        axes: ArrayLike | None = None,
        radius: float = 0.0,
    ) -> None:
        self.radius = radius
        lengths, turn = np.asarray(semi_axes, dtype=float), np.eye(3) if axes is None else np.asarray(axes, dtype=float)
        self.center = np.asarray(center, dtype=float).reshape(3, 1)
        self.matrix = turn.T * lengths**2 @ turn

    def support(self, n: Array) -> tuple[Array, Array]:
        """Gradient (3, n) and Hessian (3, 3, n) of the support function, without the rod's radius, at unit normals (3, n)."""
        image = self.matrix @ n
        height = np.sqrt(dot(image, n))
        gradient = image / height
        hessian = (self.matrix[:, :, None] - gradient[:, None] * gradient[None]) / height
        return self.center + gradient, hessian

    def patch(self, feature: Index, coordinates: Array) -> Patch:
        n = coordinates
        point, hessian = self.support(n)
        u, v = basis(n)
        point_1, point_2 = ((hessian * w).sum(axis=1) + self.radius * w for w in (u, v))
        return Patch(point + self.radius * n, n, point_1, point_2, u, v, n, u, v)

    def moved(self, feature: Index, coordinates: Array, patch: Patch, step: Array) -> tuple[Index, Array, Array]:
        part = _allowed(np.sqrt(step[0] ** 2 + step[1] ** 2))
        turned = coordinates + (part * step[0]) * patch.normal_1 + (part * step[1]) * patch.normal_2
        return feature, unit(turned), part

    def extreme(self, normal: Array) -> tuple[Index, Array, Array]:
        """Feature, coordinates and point (3, n) of the body's place with the outward normals (3, n)."""
        return np.zeros(normal.shape[1], dtype=np.intp), normal, self.support(normal)[0] + self.radius * normal


class RoundedPolyhedron:
    """The convex polyhedron with vertices (v, 3) and outward triangles (f, 3), fattened by the rod's radius.

    Its features are numbered: first the faces, then the edges, then the vertices.  Raises ValueError if the triangles are not a
    closed surface.
    """

    smooth = False

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, radius: float = 0.0) -> None:
        self.radius = radius
        self.vertices, self.triangles = np.asarray(vertices, dtype=float).T.copy(), np.asarray(faces, dtype=np.intp)
        self._faces(self.triangles)
        self._edges(self.triangles)
        self._stars()
        self._first_edge, self._first_vertex = len(self.triangles), len(self.triangles) + len(self.tail)
        self._friction_normals()
        self._coarse = np.unique(np.argmax(sphere_directions(500).T @ self.vertices, axis=1))

    def _faces(self, triangles: Index) -> None:
        a, b, c = (self.vertices[:, triangles[:, k]] for k in range(3))
        self.normals = unit(cross(b - a, c - a))
        self.first, self.second = basis(self.normals)
        # in-plane outward normal and offset of the side from corner k to the next
        corners = (a, b, c)
        self.out = np.stack([unit(cross(corners[(k + 1) % 3] - corners[k], self.normals)) for k in range(3)])
        self.out_offset = np.stack([dot(self.out[k], corners[k]) for k in range(3)])

    def _edges(self, triangles: Index) -> None:
        opposite = opposite_edges(triangles)
        if opposite is None:
            raise ValueError("the triangles of a polyhedron must be a closed surface, with every edge in two of them")
        tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
        # an edge runs forwards in its right face and backwards in its left one
        forwards = np.flatnonzero(tail < head)
        forwards = forwards[np.lexsort((head[forwards], tail[forwards]))]
        backwards = opposite.ravel()[forwards]
        self.tail, self.head = tail[forwards], head[forwards]
        self.left, self.right = backwards // 3, forwards // 3
        span = self.vertices[:, self.head] - self.vertices[:, self.tail]
        self.length = np.sqrt(dot(span, span))
        self.direction = span / self.length
        self.left_normal = self.normals[:, self.left]
        self.turned = cross(self.left_normal, self.direction)
        right_normal = self.normals[:, self.right]
        self.angle = np.maximum(np.arctan2(dot(right_normal, self.turned), dot(right_normal, self.left_normal)), 0.0)
        self.side = np.empty((3, len(triangles)), dtype=np.intp)
        self.side[backwards % 3, self.left] = self.side[forwards % 3, self.right] = np.arange(len(forwards))

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

    def _friction_normals(self) -> None:
        """Normals at the corners of the faces, averaged over the faces that meet there without a sharp edge.

        Where facets stand for a smooth surface, friction refers to the normals that are interpolated between these.
        """
        triangles, count = self.triangles, len(self.triangles)
        turned = self.angle[self.angle > NEGLIGIBLE]
        # a fine mesh stands for a smooth body; friction on it refers to normals that are interpolated across angles below 0.44
        limit = 0.44 if len(turned) and np.median(turned) < 0.09 else 0.0
        groups, group = self._smooth_corners(np.flatnonzero(self.angle < max(limit, NEGLIGIBLE)))
        corners = self.vertices[:, triangles.T]  # (3, 3 corners, f)
        to_next, to_last = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
        cosine = dot(to_next, to_last) / np.sqrt(dot(to_next, to_next) * dot(to_last, to_last))
        angle = np.maximum(np.arccos(np.clip(cosine, -1, 1)), NEGLIGIBLE)  # so that a sliver counts as well
        weighted = angle * self.normals[:, None]
        normals = unit(np.array([np.bincount(group, part.ravel(), minlength=groups) for part in weighted], dtype=float))
        self._corners = normals[:, group].reshape(3, 3, count).swapaxes(0, 1)
        # a point's weights of the corners of a face are 1/3 + slope·(point - centre)
        self._centre = corners.mean(axis=1)
        height = np.stack([dot(self.out[(k + 1) % 3], corners[:, (k + 1) % 3] - corners[:, k]) for k in range(3)])
        self._slopes = -np.roll(self.out, -1, axis=0) / height[:, None]
        self._ends = [
            [self._corners[self._corner(face, end), :, face].T for end in (self.tail, self.head)]
            for face in (self.left, self.right)
        ]
        # how many smooth sides meet at a vertex, and the normals of two of them
        vertices, vertex = self.vertices.shape[1], triangles.T.ravel()
        first, last = np.full(vertices, groups - 1), np.zeros(vertices, dtype=np.intp)
        np.minimum.at(first, vertex, group)
        np.maximum.at(last, vertex, group)
        self._sides = np.stack([normals[:, first], normals[:, last]])
        sides = np.bincount(np.unique(np.stack([vertex, group]), axis=1)[0], minlength=vertices)
        # between sharp edges only, friction refers to the true normals
        self._is_smooth = (sides <= 2) & (limit > 0)

    def _smooth_corners(self, smooth: Index) -> tuple[int, Index]:
        """Number of the groups of corners that meet at a vertex across the edges `smooth`, and the group (3 f,) of each."""
        count = len(self.triangles)
        pairs = [
            np.stack([face[smooth] + count * self._corner(face, end)[smooth] for face in (self.left, self.right)])
            for end in (self.tail, self.head)
        ]
        first, second = np.concatenate(pairs, axis=1)
        return linked(first, second, 3 * count)

    def _corner(self, face: Index, vertex: Index) -> Index:
        """Which corner (n,) of each face is a vertex."""
        return np.asarray(np.argmax(self.triangles[face] == vertex[:, None], axis=1))

    def _parts(self, feature: Index) -> tuple[Index, Index, Index]:
        """The rows with features of each kind: faces, edges, vertices."""
        is_face, is_vertex = feature < self._first_edge, feature >= self._first_vertex
        return np.flatnonzero(is_face), np.flatnonzero(~is_face & ~is_vertex), np.flatnonzero(is_vertex)

    def patch(self, feature: Index, coordinates: Array) -> Patch:
        on_face, on_edge, at_vertex = self._parts(feature)
        result = Patch(*(np.zeros_like(coordinates) for _ in Patch._fields))
        if len(on_face):
            self._patch_on_face(result, on_face, feature[on_face], coordinates[:, on_face])
        if len(on_edge):
            self._patch_on_edge(result, on_edge, feature[on_edge] - self._first_edge, coordinates[:, on_edge])
        if len(at_vertex):
            self._patch_at_vertex(result, at_vertex, feature[at_vertex] - self._first_vertex, coordinates[:, at_vertex])
        return result

    def _patch_on_face(self, result: Patch, rows: Index, number: Index, place: Array) -> None:
        n, along = self.normals[:, number], (self.first[:, number], self.second[:, number])
        result.point[:, rows], result.normal[:, rows] = place + self.radius * n, n
        result.point_1[:, rows], result.point_2[:, rows] = along
        corner, slope = self._corners[:, :, number], self._slopes[:, :, number]
        weight = (slope * (place - self._centre[:, number])).sum(axis=1) + 1 / 3
        slopes = (((slope * t).sum(axis=1)[:, None] * corner).sum(axis=0) for t in along)
        _put_law_normal(result, rows, (weight[:, None] * corner).sum(axis=0), *slopes)

    def _patch_on_edge(self, result: Patch, rows: Index, number: Index, place: Array) -> None:
        direction, n, turn = self.on_edge(number, place[1])
        result.point[:, rows] = self.vertices[:, self.tail[number]] + place[0] * direction + self.radius * n
        result.normal[:, rows], result.normal_2[:, rows] = n, turn
        result.point_1[:, rows], result.point_2[:, rows] = direction, self.radius * turn
        tau, whole = place[0] / self.length[number], np.maximum(self.angle[number], NEGLIGIBLE)
        part = np.minimum(place[1] / whole, 1.0)
        (a, b), (c, d) = ([end[:, number] for end in side] for side in self._ends)
        # the true normal, corrected by what the sides' normals differ from those of the faces
        left = a + tau * (b - a) - self.left_normal[:, number]
        right = c + tau * (d - c) - self.normals[:, self.right[number]]
        by_tau = ((b - a) + part * ((d - c) - (b - a))) / self.length[number]
        _put_law_normal(result, rows, n + left + part * (right - left), by_tau, turn + (right - left) / whole)

    def _patch_at_vertex(self, result: Patch, rows: Index, number: Index, n: Array) -> None:
        u, v = basis(n)
        result.point[:, rows], result.normal[:, rows] = self.vertices[:, number] + self.radius * n, n
        result.point_1[:, rows], result.point_2[:, rows] = self.radius * u, self.radius * v
        result.normal_1[:, rows], result.normal_2[:, rows] = u, v
        result.law_normal[:, rows], result.law_normal_1[:, rows], result.law_normal_2[:, rows] = n, u, v
        smooth = self._is_smooth[number]
        if smooth.any():
            sides = self._sides[:, :, number[smooth]]
            _put_law_normal(result, rows[smooth], *_in_plane(sides, n[:, smooth], u[:, smooth], v[:, smooth]))

    def on_edge(self, number: Index, angle: Array) -> tuple[Array, Array, Array]:
        """Direction of edges, and normals at angles from their left faces with their derivatives."""
        cos, sin = np.cos(angle), np.sin(angle)
        left, turned = self.left_normal[:, number], self.turned[:, number]
        return self.direction[:, number], cos * left + sin * turned, cos * turned - sin * left

    def moved(self, feature: Index, coordinates: Array, patch: Patch, step: Array) -> tuple[Index, Array, Array]:
        """Places moved by steps (2, n) in their local coordinates: features, coordinates, and parts (n,) of the steps taken.

        A step ends where it leaves its piece of the surface, and the place is then on the next piece.
        """
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
        number, p = feature[rows], coordinates[:, rows]
        delta = step[0, rows] * self.first[:, number] + step[1, rows] * self.second[:, number]
        out = self.out[:, :, number]
        crossed, taken = _first_border(self.out_offset[:, number] - (out * p).sum(axis=1), (out * delta).sum(axis=1))
        p = p + taken * delta
        leaves = taken < 1
        part[rows], coordinates[:, rows] = taken, p
        rows, number, p = rows[leaves], number[leaves], p[:, leaves]
        edge = self.side[crossed[leaves], number]
        other = np.where(self.left[edge] == number, self.right[edge], self.left[edge])
        flat = self.angle[edge] < NEGLIGIBLE
        feature[rows] = np.where(flat, other, self._first_edge + edge)
        along = np.clip(dot(p - self.vertices[:, self.tail[edge]], self.direction[:, edge]), 0, self.length[edge])
        on_edge = np.stack([along, np.where(self.left[edge] == number, 0.0, self.angle[edge]), np.zeros(len(rows))])
        coordinates[:, rows] = np.where(flat, p, on_edge)

    def _move_on_edge(self, rows: Index, feature: Index, coordinates: Array, step: Array, part: Array) -> None:
        number = feature[rows] - self._first_edge
        end = np.stack([self.length[number], self.angle[number]])
        place, scale = coordinates[:2, rows], _allowed(np.abs(step[1, rows]))
        delta = scale * step[:, rows]
        crossed, taken = _first_border(np.where(delta > 0, end - place, place), np.abs(delta))
        place = np.clip(place + taken * delta, 0.0, end)
        part[rows], coordinates[:2, rows] = taken * scale, place
        upper = delta[crossed, np.arange(len(rows))] > 0
        leaves = taken < 1
        to_vertex, to_face = leaves & (crossed == 0), leaves & (crossed == 1)
        at, e = rows[to_vertex], number[to_vertex]
        feature[at] = self._first_vertex + np.where(upper[to_vertex], self.head[e], self.tail[e])
        coordinates[:, at] = self.on_edge(e, place[1, to_vertex])[1]
        at, e = rows[to_face], number[to_face]
        feature[at] = np.where(upper[to_face], self.right[e], self.left[e])
        coordinates[:, at] = self.vertices[:, self.tail[e]] + place[0, to_face] * self.direction[:, e]

    def _move_at_vertex(
        self, rows: Index, feature: Index, coordinates: Array, patch: Patch, step: Array, part: Array
    ) -> None:
        number, n = feature[rows] - self._first_vertex, coordinates[:, rows]
        scale = _allowed(np.hypot(step[0, rows], step[1, rows]))
        w = scale * (step[0, rows] * patch.normal_1[:, rows] + step[1, rows] * patch.normal_2[:, rows])
        away = self.away[:, :, number]
        crossed, taken = _first_border(-(away * n[:, None]).sum(axis=0), (away * w[:, None]).sum(axis=0))
        part[rows] = taken * scale
        n = unit(n + taken * w)
        coordinates[:, rows] = n
        leaves = taken < 1
        at, vertex, n = rows[leaves], number[leaves], n[:, leaves]
        e = self.star[crossed[leaves], vertex]
        feature[at] = self._first_edge + e
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
        return self._first_vertex + number, normal, self.vertices[:, number] + self.radius * normal


def _first_border(gap: Array, rate: Array) -> tuple[Index, Array]:
    """Which of b borders (n,) a step reaches first, and the part (n,) of it that it takes until there, at most 1.

    The distances to the borders are `gap` (b, n), and the step lessens them by `rate` (b, n).
    """
    nearer = rate > 0
    limit = np.where(nearer, np.maximum(gap, 0.0) / np.where(nearer, rate, 1.0), np.inf)
    first = np.argmin(limit, axis=0)
    return first, np.minimum(limit[first, np.arange(limit.shape[1])], 1.0)


def _put_law_normal(patch: Patch, rows: Index, vector: Array, slope_1: Array, slope_2: Array) -> None:
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
    first, *rest = (np.where(crease, vector - dot(vector, k) * k, 0.0) for vector in (n, u, v))
    return np.where(crease, first, a), rest[0], rest[1]


Body = Ellipsoid | RoundedPolyhedron
