"""The hull of the contacts bounds the normals of tangential contacts, whatever the friction."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from spatial_scans import recorded

import planar
import scan3d
from scan3d.reconstruction.spatial_hull import hull_normals
from scan3d.spatial.normals import angles


@pytest.fixture(scope="module")
def ellipsoid():
    recording, _, normals = recorded((0.0, 0.4), diameter=0.01, substeps=1, directions=6, heights=6)
    cloud = scan3d.reconstruct(recording)
    return cloud, normals[cloud.row]


def test_the_intervals_contain_the_normals(ellipsoid):
    cloud, exact = ellipsoid
    tangential = cloud.phase == planar.Phase.TANGENTIAL
    found = hull_normals(cloud.centre_points, cloud.tangents, tangential)
    known = np.isfinite(found.half_width)
    np.testing.assert_array_equal(known, tangential)  # all contacts of a smooth body are corners of their hull
    assert (angles(found.normal, exact)[known] <= found.half_width[known] + 1e-7).all()
    np.testing.assert_allclose((found.normal * cloud.tangents).sum(axis=1)[known], 0, atol=1e-12)
    assert np.isnan(found.normal[~known]).all()


def test_normals_on_straight_edges_are_exact():
    """Contacts along the edges of a cube whose tangents cross the edges: the two edges' ends leave one normal."""
    rng = np.random.default_rng(0)
    turn = Rotation.from_rotvec([0.3, 0.5, -0.2])
    along = np.sort(rng.uniform(-1, 1, 40))
    bulge = 1e-3 * (1 - along**2)  # so that all are corners of the hull
    points, tangents = [], []
    for sign in ([1, 1], [1, -1], [-1, 1], [-1, -1]):
        points.append(np.column_stack([along, (1 + bulge) * sign[0], (1 + bulge) * sign[1]]))
        tangents.append(np.tile([0.3, sign[0], -sign[1]], (40, 1)))
    points, tangents = turn.apply(np.concatenate(points)), turn.apply(np.concatenate(tangents))
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    found = hull_normals(points, tangents, np.ones(160, dtype=bool))
    inner = np.tile((np.arange(40) > 1) & (np.arange(40) < 38), 4)
    assert np.isfinite(found.half_width[inner]).all()
    assert found.half_width[inner].max() < 2e-3
    edge = turn.apply([1.0, 0, 0])
    assert np.abs(found.normal[inner] @ edge).max() < 3e-3
    outward = points - (points @ edge)[:, None] * edge
    assert ((found.normal * outward)[inner].sum(axis=1) > 0).all()


def test_few_flat_and_tip_contacts_have_no_intervals():
    rng = np.random.default_rng(1)
    tangents = np.tile([0.0, 1.0, 0.0], (10, 1))
    for points in (rng.normal(size=(3, 3)), rng.normal(size=(10, 3)) * [1, 1, 0], np.zeros((10, 3))):
        found = hull_normals(points, tangents[: len(points)], np.ones(len(points), dtype=bool))
        assert np.isinf(found.half_width).all()
    found = hull_normals(rng.normal(size=(10, 3)), tangents, np.zeros(10, dtype=bool))
    assert np.isinf(found.half_width).all()


def test_contacts_inside_the_hull_contradict_and_have_no_normal():
    points = np.vstack([np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T, [[0.0, 0.0, 0.0]]])
    found = hull_normals(points, np.tile([0.6, 0.8, 0.0], (9, 1)), np.ones(9, dtype=bool))
    assert np.isinf(found.half_width[8])
