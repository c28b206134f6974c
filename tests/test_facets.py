"""Facets of polyhedra from contacts in slices, against the planes of the bodies that were scanned."""

import numpy as np
import pytest
import trimesh
from scipy.optimize import nnls
from shapes import ball

import scan3d
from scan3d.cloud import NormalSource
from scan3d.geometry.hulls import hull
from scan3d.pipeline import analyse
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.facets import completed, facets, on_planes, vertices_among, with_facet_normals
from scan3d.reconstruction.normals import with_slice_normals
from tests.robustness.bounds import false_statements

pytestmark = pytest.mark.slow


def polytope(vertices, seed):
    """A random body, every vertex of which lies on an ellipsoid."""
    return ball(seed, vertices, np.array([40.0, 32.0, 24.0]))


def planes_of(body):
    planes = np.column_stack([body.face_normals, (body.face_normals * body.triangles[:, 0]).sum(axis=1)])
    return planes[np.unique(np.round(planes, 6), axis=0, return_index=True)[1]]


def error_of_normals(cloud, body, rows):
    """Angles (k,) in degrees of normals from the cone of the normals of the body's faces at a contact."""
    planes, found = planes_of(body), []
    for row in rows:
        meeting = planes[np.abs(planes[:, :3] @ cloud.points[row] - planes[:, 3]) < 1e-8 * body.scale, :3]
        nearest = meeting.T @ nnls(meeting.T, cloud.normals[row])[0]
        sine = np.linalg.norm(np.cross(cloud.normals[row], nearest))
        found.append(np.degrees(np.arctan2(sine, cloud.normals[row] @ nearest)))
    return np.array(found)


@pytest.fixture(scope="module")
def scanned():
    body = polytope(30, 1)
    recording = scan3d.simulate(body, scan3d.Plan(slices=40, friction=(0.0, 0.4), samples=48, seed=1))
    return body, recording, scan3d.reconstruct(recording)


def test_the_planes_are_those_of_the_body(scanned):
    body, _, cloud = scanned
    found, true = facets(cloud), planes_of(body)
    apart = np.abs(found[:, None] - true).max(axis=2)
    assert apart.min(axis=1).max() < 1e-9 * body.scale  # none is false
    assert (apart.min(axis=0) < 1e-9 * body.scale).sum() == len(found) > 0.9 * len(true)  # nor twice there


def test_contacts_on_facets_have_exact_normals_at_the_tip_as_well(scanned):
    body, _, cloud = scanned
    rows = np.flatnonzero(cloud.normal_source == NormalSource.FACET)[::11]
    assert len(rows) > 0.9 * len(cloud) / 11
    assert error_of_normals(cloud, body, rows).max() < 1e-5
    by_slices = with_slice_normals(cloud)
    tips, tangential = (np.isnan(by_slices.normals[rows, 0]) == tip for tip in (True, False))
    assert tips.any()
    assert np.percentile(error_of_normals(by_slices, body, rows[tangential]), 95) > 1  # what slices alone tell


def test_a_polyhedron_all_of_whose_contacts_lie_on_facets_is_exact():
    body = polytope(12, 4)
    cloud = scan3d.reconstruct(scan3d.simulate(body, scan3d.Plan(slices=24, spacing="cosine", samples=48)))
    surface = scan3d.surface(cloud)
    assert "on which the contacts lie" in surface.metadata["reason"]
    assert scan3d.compare(surface, body).hausdorff < 1e-9 * body.scale


def test_facets_are_found_beside_vertices_and_corners_and_the_polyhedron_is_exact():
    """Sides of a facet between vertices have one slope left, and one on which corners that may be vertices agree."""
    body = polytope(50, 7)
    cloud = scan3d.reconstruct(scan3d.simulate(body, scan3d.Plan(slices=48, friction=(0.0, 0.4), samples=48)))
    planes, true = facets(cloud), planes_of(body)
    for inner, corners in ((body.vertices, np.empty((0, 3))), (cloud.points, body.vertices)):
        found = completed(planes[6:], cloud, inner, corners)
        assert len(planes) - 6 < len(found) <= len(true)
        assert np.abs(found[:, None] - true).max(axis=2).min(axis=1).max() < 1e-9 * body.scale
    surface = scan3d.surface(cloud)
    assert f"{len(true)} facets" in surface.metadata["reason"]
    assert scan3d.compare(surface, body).relative < 1e-9  # 3e-5 by sides alone that contacts show


@pytest.mark.trust
@pytest.mark.parametrize("seed", range(20))
def test_no_plane_is_false(seed):
    body = polytope(20 + 12 * seed, seed)
    cloud = scan3d.reconstruct(scan3d.simulate(body, scan3d.Plan(slices=32, friction=(0.0, 0.4), seed=seed)))
    apart = np.abs(facets(cloud)[:, None] - planes_of(body)).max(axis=2)
    assert apart.min(axis=1).max() < 1e-9 * body.scale


def test_a_double_pyramid_is_not_taken_for_a_prism():
    """Upper and lower facets are parallel in the slices, and a plane through sides on both would cut off the edge between."""
    body = hull(20 * np.concatenate([np.eye(3), -np.eye(3)]))
    cloud = scan3d.reconstruct(scan3d.simulate(body, scan3d.Plan(slices=12, spacing="uniform", samples=48)))
    found = facets(cloud)
    assert len(found) == 8
    assert np.abs(found[:, :3]) * np.sqrt(3) == pytest.approx(1, abs=1e-9)


def test_a_smooth_body_and_noisy_contacts_show_no_facets(scanned):
    body, recording, cloud = scanned
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=20)
    smooth = scan3d.reconstruct(scan3d.simulate(sphere, scan3d.Plan(slices=8, sweeps=6, samples=48)))
    assert not len(facets(smooth))  # though its facets above and below the middle are parallel in the slices
    noisy = scan3d.reconstruct(scan3d.simulate(body, scan3d.Plan(slices=8, sweeps=6, samples=48, noise=1e-4)))
    assert not len(facets(noisy))
    assert with_facet_normals(noisy) is noisy


def test_past_the_end_slices_a_polyhedron_ends_half_way():
    """No contact tells where a cube ends above its last slice, though all of them lie on known facets."""
    mesh = trimesh.creation.box((40, 40, 40))
    found = analyse(scan3d.simulate(mesh, scan3d.Plan(slices=12)), mesh)
    assert found.comparison.hausdorff == pytest.approx(found.bounds.bound / 2, rel=1e-3)
    assert found.certificate.bound == pytest.approx(found.bounds.bound / 2, rel=1e-3)


def test_a_corner_with_one_edge_touched_is_a_vertex_of_a_polyhedron_only():
    """Flat sides of a rounded body would meet in corners that it does not have."""
    planes = np.vstack([np.eye(3, 4), -np.eye(3, 4)])
    planes[:3, 3] = 1.0
    corners = np.array(list(np.ndindex(2, 2, 2)), dtype=float)
    touched = on_planes(np.array([[0.5, 0, 0], [0, 0.5, 0]]), planes, 1.0)
    for simple, found in ((False, [[0, 0, 0]]), (True, [[0, 0, 0], [0, 1, 0], [1, 0, 0]])):
        is_vertex, is_open = vertices_among(corners, planes, touched, 1.0, simple=simple)
        assert corners[is_vertex].tolist() == found
        assert (is_vertex ^ is_open).all()


def check_chosen_planes(body, gain, **settings):
    """The surface is right to 1e-5 of the diagonal, all bounds hold, and they are narrower than along one axis by a factor."""
    found, along = (
        analyse(scan3d.simulate(body, scan3d.Plan(friction=(0.0, 0.4), axis=axis, **settings)), body)
        for axis in ("free", "z")
    )
    assert found.comparison.relative < 1e-5
    assert false_statements(body, found) == []
    assert found.bounds.bound * gain < along.bounds.bound
    assert len(found.cloud.slice_height) <= len(along.cloud.slice_height)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.trust)])
def test_chosen_planes_make_a_polyhedron_and_its_bound_exact(seed):
    check_chosen_planes(polytope(20, seed), 10, slices=28, samples=48)


@pytest.mark.trust
@pytest.mark.parametrize(("vertices", "gain"), [(50, 30), (100, 10), (200, 0.8)])
def test_chosen_planes_of_64_slices(vertices, gain):
    check_chosen_planes(polytope(vertices, 5), gain)


def test_planes_of_bodies_without_facets_lie_along_the_axis():
    for body, noise in ((trimesh.creation.icosphere(subdivisions=3), 0.0), (trimesh.creation.box(), 1e-4)):
        plan = scan3d.Plan(axis="free", slices=12, samples=32, noise=noise)
        cloud = contacts(scan3d.simulate(body, plan))
        assert (cloud.slice_axis == [0.0, 0.0, 1.0]).all()
        assert len(cloud.slice_height) == 14
    assert not scan3d.Plan(axis=np.array([0, 0, 1.0])).is_free
