"""The outer body between slices along several axes: it contains the body, and no contact and tangent allows less."""

import functools

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import scan3d
from scan3d.bounds import enclosure
from scan3d.bounds.cells import _left, cells_of_cloud
from scan3d.geometry.distance import signed_distances
from scan3d.geometry.hulls import hull
from scan3d.geometry.sections import slice_frame
from scan3d.reconstruction.contacts import contacts


def body(seed):
    """A random polytope, a round polytope or an ellipsoid, turned."""
    random = np.random.default_rng(seed)
    if seed % 3 == 0:
        points = random.normal(size=(int(random.integers(5, 25)), 3)) * random.uniform(3, 20, 3)
    elif seed % 3 == 1:
        points = random.normal(size=(60, 3))
        points *= random.uniform(3, 20, 3) / np.linalg.norm(points, axis=1)[:, None]
    else:
        points = trimesh.creation.icosphere(3).vertices * random.uniform(2, 20, 3)
    return trimesh.convex.convex_hull(points @ Rotation.random(rng=random).as_matrix())


@functools.cache
def scanned(seed, slices=6, axes="xyz", spacing="cosine"):
    plan = scan3d.Plan(slices=slices, axis=axes, spacing=spacing, samples=24, friction=(0.0, 0.4), seed=seed)
    mesh = body(seed)
    return mesh, contacts(scan3d.simulate(mesh, plan))


def found_in(cloud):
    return cells_of_cloud(cloud, hull(cloud.points))


def test_a_thin_cell_that_no_tried_point_lies_in_has_its_corners():
    low, high = np.array([5.0, 3.0, -1.0]), np.array([6.0, 4.0, -0.99])
    planes = np.hstack([np.vstack([np.eye(3), -np.eye(3)]), np.concatenate([-high, low])[:, None]])
    corners, _ = _left(planes, np.zeros(3), np.eye(3), np.zeros((1, 3)))
    assert hull(corners).bounds == pytest.approx(np.stack([low, high]))


@pytest.mark.slow
def test_the_corners_of_a_polytope_are_its_vertices():
    """Where the hull misses vertices, the surface that held-out slices choose comes closer to the body."""
    mesh, cloud = scanned(22, 9, "xyz", "adaptive")
    surface = scan3d.surface(cloud)
    near, far = (scan3d.compare(shape, mesh).hausdorff for shape in (surface, hull(cloud.points)))
    assert near < far


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_no_contact_and_tangent_allows_a_smaller_bound(seed):
    """The hull of the contacts and the farthest corner is a convex body with the same contacts and tangents."""
    mesh, cloud = scanned(seed)
    found = found_in(cloud)
    size = np.linalg.norm(mesh.extents)
    largest = hull(np.concatenate([cloud.points, found.corners[[found.gap.argmax()]]]))
    assert signed_distances(cloud.points, largest).min() > -2e-6 * size
    tangential = np.isfinite(cloud.in_plane_normals).all(axis=1) & (cloud.phase == 2)
    rod = np.cross(cloud.in_plane_normals, cloud.slice_axis[cloud.slice])[tangential]
    for step in (-0.05, -0.002, 0.002, 0.05):
        assert signed_distances(cloud.points[tangential] + step * size * rod, largest).min() > -2e-6 * size


@pytest.mark.slow
@pytest.mark.parametrize("frame", [np.eye(3), slice_frame(np.array([1.0, 2.0, 0.5]))])
def test_a_box_is_found_exactly(frame):
    """Of a box that lies along the axes three slices show every face, and a slice near each end its extent."""
    mesh = trimesh.creation.box((20, 14, 9))
    mesh.apply_transform(np.block([[frame, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]]))
    cloud = contacts(scan3d.simulate(mesh, scan3d.Plan(slices=12, axis="xyz", samples=24)))
    bounds = enclosure(cloud)
    assert bounds.bound < 1e-5 * np.linalg.norm(mesh.extents)
