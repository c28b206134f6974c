"""Meshes of known shape, for the tests of geometry."""

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from planar.contours import SmoothContour


class SupportCurve(SmoothContour):
    """A strictly convex contour by its support function ``h = <n, p>`` of the slope and the first two derivatives."""

    def __init__(self, *support):
        self.support = support

    def points(self, slope):
        c, s, (h, d, _) = np.cos(slope), np.sin(slope), [part(np.asarray(slope)) for part in self.support]
        return np.stack([h * s + d * c, -h * c + d * s], axis=-1)

    def radius_of_curvature(self, slope):
        return self.support[0](slope) + self.support[2](slope)

    def loops(self):
        raise NotImplementedError

    def distance(self, points):
        slopes = np.linspace(-np.pi / 2, np.pi / 2, 721)
        foot = slopes[np.linalg.norm(points[:, None] - self.points(slopes), axis=2).argmin(axis=1)]
        for _ in range(9):  # Newton's steps for the foot points of places next to the curve
            along = ((points - self.points(foot)) * np.stack([np.cos(foot), np.sin(foot)], axis=1)).sum(axis=1)
            foot = np.clip(foot + along / self.radius_of_curvature(foot), -np.pi / 2, np.pi / 2)
        return np.linalg.norm(points - self.points(foot), axis=1)


def as_mesh(vertices, faces):
    return trimesh.Trimesh(vertices, faces, process=False)


def rotation(seed):
    return Rotation.random(rng=np.random.default_rng(seed)).as_matrix()


def box(*sides):
    """About the origin."""
    return trimesh.creation.box(sides or (1, 1, 1))


def dimpled_box(depth):
    """A cube of side 1 whose face x = 1/2 has its centre pushed in; the dent has exactly that depth, below 1/4."""
    cube = box()
    lid = np.flatnonzero(cube.face_normals[:, 0] > 0.5)
    corners = np.unique(cube.faces[lid])
    corners = corners[np.argsort(np.arctan2(*cube.vertices[corners, 1:].T))]
    fan = [[8, corners[i], corners[(i + 1) % 4]] for i in range(4)]
    return as_mesh(
        np.vstack([cube.vertices, [0.5 - depth, 0, 0]]), np.vstack([np.delete(cube.faces, lid, axis=0), fan])
    )


def letter_l():
    """3 high; the reentrant edge x = y = 1 lies 1/√2 below the hull's face x + y = 3."""
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])
    vertices = np.vstack([np.column_stack([outline, np.full(6, z)]) for z in (0, 3)])
    walls = [f for i in range(6) for j in [(i + 1) % 6] for f in ([i, j, j + 6], [i, j + 6, i + 6])]
    lid = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    return as_mesh(vertices, [*walls, *(lid + 6), *lid[:, ::-1]])


def without(mesh, keep):
    return as_mesh(mesh.vertices, mesh.faces[keep])


def soup(mesh, jitter=0.0, seed=0):
    """The same triangles without common vertices, as an STL file has them, every corner moved by up to `jitter`."""
    corners = mesh.triangles.reshape(-1, 3)
    corners = corners + jitter * np.random.default_rng(seed).uniform(-1, 1, corners.shape)
    return as_mesh(corners, np.arange(len(corners)).reshape(-1, 3))


def polytope(seed, count=30, stretch=(1.0, 1.0, 1.0), shift=(0.0, 0.0, 0.0)):
    points = np.random.default_rng(seed).standard_normal((count, 3)) * stretch + shift
    return trimesh.Trimesh(points, process=False).convex_hull


def ball(seed, count=200, radius=1.0):
    """The hull of random points on a ball, or on an ellipsoid of three semi-axes."""
    return trimesh.Trimesh(
        radius * unit(np.random.default_rng(seed).standard_normal((count, 3))), process=False
    ).convex_hull


def cube(half=1.0, shift=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.box(np.broadcast_to(2 * np.asarray(half), 3))
    return moved(mesh, shift)


def moved(mesh, shift=(0.0, 0.0, 0.0), scale=1.0, rotation=None):
    vertices = np.asarray(mesh.vertices) @ (np.eye(3) if rotation is None else rotation).T * scale + shift
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def quad(diagonal, height=0.5):
    """A bent quadrilateral, cut along one diagonal or the other."""
    corners = [(0.0, 0.0, 0.0), (1.0, 0.0, height), (1.0, 1.0, 0.0), (0.0, 1.0, height)]
    faces = {0: [(0, 1, 2), (0, 2, 3)], 1: [(0, 1, 3), (1, 2, 3)]}[diagonal]
    return trimesh.Trimesh(corners, faces, process=False)


def dented(depth):
    """A cube of side 2 with one face pushed in at its middle."""
    mesh = cube().subdivide()
    vertices = np.array(mesh.vertices)
    vertices[np.linalg.norm(vertices - [1.0, 0.0, 0.0], axis=1) < 1e-9, 0] -= depth
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def directions(count, seed=3):
    return unit(np.random.default_rng(seed).standard_normal((count, 3)))


def spread(mesh, steps):
    i, j = np.mgrid[: steps + 1, : steps + 1].reshape(2, -1) / steps
    i, j = i[i + j <= 1 + 1e-9], j[i + j <= 1 + 1e-9]
    return np.einsum("gk,mkx->mgx", np.column_stack([1 - i - j, i, j]), mesh.triangles).reshape(-1, 3)


PAIRS = {
    "apart": (polytope(0), polytope(1, shift=(5.0, 1.0, 0.0))),
    "crossing": (polytope(2), polytope(3, shift=(0.3, 0.0, 0.1))),
    "nested": (ball(4, 80, 0.5), ball(5, 120)),
    "alike": (ball(6, 100), moved(ball(6, 100), scale=1.001, shift=(1e-4, 0.0, 2e-4))),
    "needles": (polytope(7, stretch=(1.0, 0.01, 0.01)), polytope(8, stretch=(1.0, 0.01, 0.01))),
    "plates": (polytope(9, stretch=(1.0, 1.0, 1e-4)), polytope(10, stretch=(1.0, 1.0, 1e-4))),
    "few and many": (cube(0.6), ball(11, 300)),
}


def pinhole(side):
    """A cube of side 2 whose lid z = 1 lacks a small triangle, and that triangle (3, 3), with edges about as long as `side`."""
    body = cube()
    lid = np.flatnonzero(body.face_normals[:, 2] > 0.5)[0]
    corners = body.vertices[body.faces[lid]]
    middle = corners.mean(axis=0)
    hole = middle + side * (corners - middle) / 2
    outer, inner = body.faces[lid], np.arange(8, 11)
    ring = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        ring += [[outer[i], outer[j], inner[j]], [outer[i], inner[j], inner[i]]]
    faces = np.vstack([np.delete(body.faces, lid, axis=0), ring])
    return as_mesh(np.vstack([body.vertices, hole]), faces), hole


def inscribed_radius(triangle):
    """Radius of the largest circle in a triangle (3, 3)."""
    perimeter = np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1).sum()
    return 2 * trimesh.triangles.area(triangle[None])[0] / perimeter


def cassini(turn, count=2000, a=0.30, b=0.318, center=(0.0, 0.8)):
    """x and y of a peanut, the Cassini oval ``|p - e| |p + e| = b²`` with foci ±a."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    radius = np.sqrt(a * a * np.cos(2 * angle) + np.sqrt(b**4 - (a * a * np.sin(2 * angle)) ** 2))
    return polar(radius, angle, turn, center)


def star(turn, count=4000, center=(0.0, 0.85)):
    """x and y of the curve ``r = 0.3 (1 + 0.25 cos 5θ)``."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return polar(0.3 * (1 + 0.25 * np.cos(5 * angle)), angle, turn, center)


def polar(radius, angle, turn, center):
    return center[0] + radius * np.cos(angle + turn), center[1] + radius * np.sin(angle + turn)


def letter_l_outline(turn, center=(0.0, 0.75)):
    """Vertices (6, 2) of the letter L with arms of 0.4, scaled by 0.4."""
    x, y = 0.4 * np.array([[0, 0], [1, 0], [1, 0.4], [0.4, 0.4], [0.4, 1], [0, 1]]).T - 0.16
    c, s = np.cos(turn), np.sin(turn)
    return np.stack([center[0] + c * x - s * y, center[1] + s * x + c * y], axis=1)
