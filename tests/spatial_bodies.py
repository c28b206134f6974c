"""Convex bodies with exact contacts of a rod anywhere on them, for the tests of what contacts in space prove.

A body is known by its support function, and by points of its surface with their outward normals.  A rod of radius a touches it
along a random direction across the normal; its centre line touches the body fattened by a.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull
from shapes import unit

from planar import Phase
from scan3d.cloud import Cloud, NormalSource

AS_IT_IS = np.eye(3)


@dataclass(frozen=True)
class Ellipsoid:
    semi_axes: np.ndarray

    def support(self, u):
        return np.linalg.norm(u * self.semi_axes, axis=1)

    def touched(self, count, rng):
        """Points and normals, spread evenly over the ellipsoid as over the ball."""
        sphere = unit(rng.normal(size=(count, 3)))
        return sphere * self.semi_axes, unit(sphere / self.semi_axes), np.full(count, Phase.TANGENTIAL)

    @property
    def normals(self):
        return np.empty((0, 3))

    @property
    def size(self):
        return 2 * float(np.linalg.norm(self.semi_axes))


class Polyhedron:
    """The hull of some vertices, with a ball of the radius `rounding` added to it."""

    def __init__(self, vertices, rounding=0.0, *, faces=0.05, corners=0.03):
        self.vertices, self.rounding, self._fractions = np.asarray(vertices, float), rounding, (faces, corners)
        qhull = ConvexHull(self.vertices)
        self._triangles, self._planes = qhull.simplices, qhull.equations[:, :3]
        edges = []
        for face, around in enumerate(qhull.neighbors):
            for k, other in enumerate(around):
                if other > face and self._planes[face] @ self._planes[other] < 1 - 1e-9:
                    edges.append((*np.delete(qhull.simplices[face], k), face, other))
        self._edges = np.array(edges)
        self.size = float(np.linalg.norm(np.ptp(self.vertices, axis=0))) + 2 * rounding

    @property
    def normals(self):
        return self._planes

    def support(self, u):
        return (u @ self.vertices.T).max(axis=1) + self.rounding

    def touched(self, count, rng):
        """Most contacts lie across edges, some at the tip on faces, a few at vertices."""
        faces, corners = (int(count * fraction) for fraction in self._fractions)
        i, j, f, g = self._edges[self._by_length(count - faces - corners, rng)].T
        s = rng.uniform(size=(len(i), 1))
        w = rng.uniform(size=(len(i), 1))
        turn = np.arccos(np.clip((self._planes[f] * self._planes[g]).sum(axis=1), -1, 1))[:, None]
        n = unit(np.sin((1 - w) * turn) * self._planes[f] + np.sin(w * turn) * self._planes[g])
        points = [(1 - s) * self.vertices[i] + s * self.vertices[j]]
        normals = [n]
        corners_of = self.vertices[self._triangles]
        area = np.linalg.norm(
            np.cross(corners_of[:, 1] - corners_of[:, 0], corners_of[:, 2] - corners_of[:, 0]), axis=1
        )
        face = rng.choice(len(area), size=faces, p=area / area.sum())
        weight = rng.dirichlet(np.ones(3), size=faces)
        points.append((weight[:, :, None] * corners_of[face]).sum(axis=1))
        normals.append(self._planes[face])
        u = unit(rng.normal(size=(corners, 3)))
        points.append(self.vertices[(u @ self.vertices.T).argmax(axis=1)])
        normals.append(u)
        points, normals = np.concatenate(points), np.concatenate(normals)
        phase = np.full(count, Phase.TANGENTIAL)
        phase[len(i) : len(i) + faces] = Phase.TIP
        return points + self.rounding * normals, normals, phase

    def _by_length(self, count, rng):
        length = np.linalg.norm(self.vertices[self._edges[:, 0]] - self.vertices[self._edges[:, 1]], axis=1)
        return rng.choice(len(length), size=count, p=length / length.sum())


def box(extents, rounding=0.0, **fractions):
    signs = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T
    return Polyhedron(signs * (np.asarray(extents) - 2 * rounding), rounding, **fractions)


@dataclass(frozen=True)
class Cylinder:
    radius: float
    height: float

    def support(self, u):
        return self.radius * np.hypot(u[:, 0], u[:, 1]) + self.height / 2 * np.abs(u[:, 2])

    def touched(self, count, rng):
        angle = rng.uniform(0, 2 * np.pi, size=count)
        radial = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
        side = rng.uniform(size=count) < 0.4
        lean = np.where(side, 0.0, rng.uniform(-np.pi / 2, np.pi / 2, size=count))[:, None]
        axis = np.array([0.0, 0, 1])
        z = np.where(side, rng.uniform(-1, 1, size=count), np.sign(lean[:, 0])) * self.height / 2
        return (
            self.radius * radial + z[:, None] * axis,
            np.cos(lean) * radial + np.sin(lean) * axis,
            np.full(count, Phase.TANGENTIAL),
        )

    @property
    def normals(self):
        return np.array([[0.0, 0, 1], [0, 0, -1]])

    @property
    def size(self):
        return float(np.hypot(2 * np.sqrt(2) * self.radius, self.height))


def random_polyhedron(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(5, 20))
    return Polyhedron(unit(rng.normal(size=(count, 3))) * rng.uniform(0.4, 1.0, size=3))


def random_ellipsoid(seed):
    rng = np.random.default_rng(seed)
    return Ellipsoid(np.array([1.0, *rng.uniform(0.3, 1.0, size=2)]))


def random_shape(seed):
    """A body and a rod's radius, in turn an ellipsoid, a polyhedron, a box with round edges and a cylinder."""
    rng = np.random.default_rng(seed)
    kind = seed % 4
    if kind == 0:
        body = random_ellipsoid(seed)
    elif kind == 1:
        body = Polyhedron(random_polyhedron(seed).vertices, corners=0.02 * (seed % 8 < 4))
    elif kind == 2:
        body = box(rng.uniform(0.5, 1, size=3), rng.uniform(0.02, 0.2), corners=0.1)
    else:
        body = Cylinder(rng.uniform(0.2, 0.6), rng.uniform(0.3, 1))
    return body, (0.0, 0.005, 0.02)[seed % 3]


def spatial_cloud(body, count, seed, radius=0.0, *, seen=None, turn=AS_IT_IS, scale=1.0, shift=(0.0, 0.0, 0.0)):
    """A cloud of exact contacts with a body; `seen` selects contacts by points and normals."""
    rng = np.random.default_rng(seed)
    points, normals, phase = body.touched(count, rng)
    tangents = unit(np.cross(normals, rng.normal(size=normals.shape)))
    kept = np.ones(count, dtype=bool) if seen is None else seen(points, normals)
    points, normals, phase, tangents = points[kept], normals[kept], phase[kept], tangents[kept]
    place = scale * (points @ turn.T) + np.asarray(shift)
    normals, tangents = normals @ turn.T, tangents @ turn.T
    return cloud_of(place, normals, tangents, phase, scale * radius, scale)


def cloud_of(points, normals, tangents, phase, radius=0.0, rod_length=1.0, sweep=None):
    count = len(points)
    return Cloud(
        points=points,
        normals=normals,
        normal_source=np.full(count, NormalSource.SLIP, dtype=np.int8),
        in_plane_normals=np.full((count, 3), np.nan),
        phase=np.asarray(phase, dtype=np.int8),
        slice=np.full(count, -1, dtype=np.int32),
        sweep=(np.arange(count) // 50 if sweep is None else sweep).astype(np.int32),
        row=np.arange(count, dtype=np.int32),
        force_N=np.ones(count),
        friction=np.full(count, np.nan),
        slice_axis=np.empty((0, 3)),
        slice_height=np.empty(0),
        unit="mm",
        rod_length=rod_length,
        noise=0.0,
        model="spatial",
        rod_radius=radius,
        centre_points=points + radius * normals,
        tangents=tangents,
    )


def largest_difference(surface, body, count=30_000, seed=0, turn=AS_IT_IS, scale=1.0, shift=(0.0, 0.0, 0.0)):
    """The largest difference of the support functions of a convex surface and of a body, over the surface's own normals, the
    body's, and random directions: their Hausdorff distance but for directions between these, so never above it."""
    vertices = (np.asarray(surface.vertices) - np.asarray(shift)) @ turn / scale
    hull = ConvexHull(vertices)
    vertices = vertices[hull.vertices]
    u = np.concatenate([unit(np.random.default_rng(seed).normal(size=(count, 3))), hull.equations[:, :3], body.normals])
    parts = np.array_split(u, 1 + len(u) // 1000)
    return scale * max(float(np.abs((part @ vertices.T).max(axis=1) - body.support(part)).max()) for part in parts)
