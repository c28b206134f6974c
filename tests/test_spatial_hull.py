"""The hull of the contacts bounds the normals of tangential contacts, whatever the friction."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from spatial_scans import recorded

import planar
import scan3d
from scan3d.reconstruction.normals import hull_normals
from scan3d.spatial.normals import angles


@pytest.fixture(scope="module")
def ellipsoid():
    recording, _, normals = recorded((0.0, 0.4), diameter=0.01, substeps=1, directions=6, heights=6)
    cloud = scan3d.reconstruct(recording)
    return cloud, normals[cloud.row]


@pytest.mark.slow
def test_the_intervals_contain_the_normals(ellipsoid):
    cloud, exact = ellipsoid
    tangential = cloud.phase == planar.Phase.TANGENTIAL
    found = hull_normals(cloud.centre_points, cloud.tangents, tangential)
    assert np.isfinite(found.half_width).all()
    # those of tip contacts are cones about the means of the facets' normals
    assert (angles(found.normal, exact) <= found.half_width + 1e-7).mean() > 0.999
    assert (angles(found.normal, exact)[tangential] <= found.half_width[tangential] + 1e-7).all()
    np.testing.assert_allclose((found.normal * cloud.tangents).sum(axis=1)[tangential], 0, atol=1e-12)


@pytest.mark.slow
def test_contacts_on_faces_and_inside_edges_of_a_cube():
    """A tip contact on a face has the face's normal; a contact across an edge, whose neighbours lie on one line, one normal."""
    rng = np.random.default_rng(2)
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T.astype(float)
    faces = np.column_stack([rng.uniform(-0.9, 0.9, (20, 2)), np.ones(20)])
    edge = np.column_stack([rng.uniform(-0.9, 0.9, 20), np.ones(20), np.ones(20)])
    tangents = np.tile([0.0, 0.0, 1.0], (48, 1))
    tangents[28:] = np.array([0.2, 1.0, -0.6]) / np.sqrt(1.4)
    tangential = np.arange(48) >= 28
    turn = Rotation.from_rotvec([0.3, 0.5, -0.2])
    found = hull_normals(turn.apply(np.concatenate([corners, faces, edge])), turn.apply(tangents), tangential)
    normal = turn.inv().apply(found.normal)
    np.testing.assert_allclose(normal[8:28], np.tile([0, 0, 1], (20, 1)), atol=1e-9)
    assert found.half_width[8:28].max() < 1e-6
    np.testing.assert_allclose(normal[28:], np.tile([0, 0.6, 1] / np.sqrt(1.36), (20, 1)), atol=1e-9)
    assert found.half_width[28:].max() < 1e-10  # rounding
    # at a corner the normal is only known to lie between those of three faces
    assert (found.half_width[:8] > 0.9).all()


@pytest.mark.slow
def test_contacts_inside_the_hull_contradict_and_have_no_normal():
    points = np.vstack([np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T, [[0.0, 0.0, 0.0]]])
    tangents = np.tile([0.6, 0.8, 0.0], (9, 1))
    assert np.isinf(hull_normals(points, tangents, np.ones(9, dtype=bool)).half_width[8])
    for flat in (points[:3], points * [1, 1, 0], 0 * points):  # as have few and flat ones
        assert np.isinf(hull_normals(flat, tangents[: len(flat)], np.ones(len(flat), dtype=bool)).half_width).all()
