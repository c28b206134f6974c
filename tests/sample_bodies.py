"""Bodies that several tests of the reconstruction scan, and their contacts."""

import importlib.util
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

import scan3d
from scan3d.geometry.distance import signed_distances
from scan3d.geometry.hulls import hull
from tests.shapes import unit

MESHES = Path(__file__).parents[1] / "meshes"
_spec = importlib.util.spec_from_file_location("make_meshes", MESHES / "make_meshes.py")
# The script that makes the meshes: `make(name, subdivisions)`, and the exact `normal(name, points)` of the smooth bodies.
formulas = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(formulas)


def random_body(seed):
    """Polytopes, ellipsoids, their Minkowski sums, needles and discs, in random orientations."""
    rng = np.random.default_rng(seed)
    directions = unit(rng.normal(size=(400, 3)))
    kind = seed % 4
    polytope = rng.normal(size=(12, 3))
    ellipsoid = directions * [1.0, 0.7, 0.5]
    if kind == 0:
        points = polytope
    elif kind == 1:
        points = ellipsoid
    elif kind == 2:
        points = (polytope[:, None] + 0.3 * ellipsoid[::4]).reshape(-1, 3)
    else:
        points = directions * ([1.0, 0.05, 0.05] if seed % 8 < 4 else [1.0, 1.0, 0.05])
    points = 20 * points @ trimesh.transformations.random_rotation_matrix(rng.uniform(size=3))[:3, :3].T
    return hull(points[ConvexHull(points).vertices])


def rotated(mesh, seed=1):
    matrix = trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).uniform(size=3))
    mesh.apply_transform(matrix)
    return mesh


def scanned(mesh, **plan):
    """Contacts with normals, of 24 slices and friction between 0 and 0.4 unless the plan says otherwise."""
    return scan3d.reconstruct(scan3d.simulate(mesh, scan3d.Plan(**{"slices": 24, "friction": (0.0, 0.4), **plan})))


def convex_hausdorff(first, second):
    """Hausdorff distance of two convex surfaces: the largest distance of a vertex of either from the other one."""
    return max(np.abs(signed_distances(a.vertices, b)).max() for a, b in ((first, second), (second, first)))
