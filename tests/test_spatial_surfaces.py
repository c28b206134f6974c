"""Surfaces from contacts anywhere: their distance to the body, and the choice between them."""

import dataclasses

import numpy as np
import pytest
from spatial_bodies import Cylinder, Ellipsoid, Polyhedron, box, largest_difference, random_polyhedron, spatial_cloud

from scan3d.geometry.support import fit_support
from scan3d.surfaces import certificate, enclosure, estimates, surface

SMOOTH = Ellipsoid(np.array([1.0, 0.7, 0.5]))


def fitted(cloud, degree=4):
    return dataclasses.replace(cloud, fit=fit_support(cloud.points, cloud.normals, degree))


@pytest.mark.slow
def test_a_smooth_body_is_the_fitted_one():
    cloud = fitted(spatial_cloud(SMOOTH, 1500, 2, 0.01))
    mesh = surface(cloud)
    assert mesh.metadata["method"] == "support"
    assert "held-out sweeps lie within" in mesh.metadata["reason"]
    assert np.linalg.norm(np.asarray(mesh.vertices) / SMOOTH.semi_axes, axis=1) == pytest.approx(1, abs=1e-4)
    assert surface(cloud, "support").metadata["reason"].endswith("as requested")


@pytest.mark.slow
@pytest.mark.parametrize("radius", [pytest.param(0.0, marks=pytest.mark.trust), 0.005])
def test_a_polyhedron_has_its_vertices_though_no_contact_lies_there(radius):
    for seed in (1, 4):
        body = Polyhedron(random_polyhedron(seed).vertices, corners=0.0)
        cloud = spatial_cloud(body, 3000, seed, radius)
        mesh = surface(cloud)
        assert mesh.metadata["method"] == "bracket"
        assert "sharp edges" in mesh.metadata["reason"]
        assert largest_difference(mesh, body) < 1e-9
        assert largest_difference(surface(cloud, "hull"), body) > 1e-4


def test_contacts_that_the_rod_displaces_hide_no_face():
    """A few contacts with unsure normals, which stand out of the body, cost a polyhedron neither faces nor vertices."""
    body = Polyhedron(random_polyhedron(4).vertices, corners=0.0)
    cloud = spatial_cloud(body, 3000, 4, 0.005)
    rng = np.random.default_rng(0)
    rows = rng.choice(len(cloud), 60, replace=False)
    points, normals, sd = cloud.points.copy(), cloud.normals.copy(), np.full(len(cloud), 1e-6)
    points[rows] += 0.002 * body.size * normals[rows]
    normals[rows] += 0.1 * rng.normal(size=(60, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    sd[rows] = 0.1
    unsure = dataclasses.replace(cloud, points=points, normals=normals, normal_sd=sd)
    well_placed = np.delete(np.arange(len(cloud)), rows)
    assert largest_difference(estimates.with_edges(unsure), body) < 1e-6 * body.size
    assert largest_difference(estimates.with_edges(unsure.select(well_placed)), body) < 1e-6 * body.size


def test_long_edges_of_a_capsule_are_straight():
    """The ends of a generator lie in the caps, where normals lean; the contacts beside it show that it is straight."""
    rng = np.random.default_rng(3)
    normals = rng.normal(size=(4000, 3))
    normals[:600, 2] = 0  # on the cylinder
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    height = np.where(normals[:, 2] == 0, rng.uniform(-2, 2, 4000), 2 * np.sign(normals[:, 2]))
    points = normals + height[:, None] * np.array([0, 0, 1])
    cloud = spatial_cloud(SMOOTH, 4000, 3)
    capsule = dataclasses.replace(cloud, points=points, normals=normals, normal_sd=None)
    mesh = estimates.curved(capsule)
    vertices = np.asarray(mesh.vertices)
    axis = np.clip(vertices[:, 2:], -2, 2) * np.array([0, 0, 1])
    assert np.linalg.norm(vertices - axis, axis=1).max() < 1.002


@pytest.mark.parametrize(
    ("count", "largest_bound"),
    [pytest.param(5000, 7e-3, marks=pytest.mark.slow), pytest.param(20_000, 5e-3, marks=pytest.mark.trust)],
)
@pytest.mark.parametrize(
    "body",
    [
        box([0.4, 0.3, 0.25], corners=0.01),
        pytest.param(box([1, 0.7, 0.5], 0.1, corners=0.3), marks=pytest.mark.trust),
        pytest.param(Cylinder(0.5, 1.0), marks=pytest.mark.trust),
        pytest.param(SMOOTH, marks=pytest.mark.trust),
    ],
)
def test_many_contacts_give_close_surfaces_and_small_bounds(body, count, largest_bound):
    cloud = spatial_cloud(body, count, 11, 0.002 * body.size)
    bounds = enclosure(cloud)
    mesh = surface(cloud, bounds=bounds)
    assert largest_difference(mesh, body) < 1e-3 * body.size
    assert largest_difference(mesh, body) <= certificate(bounds, mesh).bound < largest_bound * body.size
