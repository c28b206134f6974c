"""Distances of points to meshes, against brute force in extended precision and in 60 digits."""

import numpy as np
import pytest
import trimesh
from brute_force import far, far_in_60_digits, from_segments
from scipy.spatial import ConvexHull
from shapes import PAIRS

from scan3d.geometry.distance import Search, distances, nearest, signed_distances
from scan3d.geometry.triangles import areas, longest_first


@pytest.mark.slow
@pytest.mark.parametrize("height", [1e-1, 1e-3, 1e-6, 1e-8, 1e-9, 1e-11, 1e-13, 1e-15, 0.0])
def test_distances_to_slivers_against_60_digits(height):
    rng = np.random.default_rng(2)
    a, along = rng.random((200, 3)), 0.5 * rng.standard_normal((200, 3))
    c = a + rng.random((200, 1)) * along + height * rng.standard_normal((200, 3))
    c[:5], along[:2] = a[:5], 0.0  # single segments and points
    corners = np.stack([a, a + along, c], axis=1)
    close = corners[:100].mean(axis=1) + 10.0 ** rng.uniform(-10, -1, (100, 1)) * rng.standard_normal((100, 3))
    points = np.concatenate([close, rng.random((30, 3)), a[:20] + 1e-9])
    sorted_corners = np.take_along_axis(corners, longest_first(corners)[:, :, None], axis=1)
    distance, face = Search(sorted_corners).nearest(points)
    assert distance == pytest.approx(
        [far_in_60_digits(p, *corners[f]) for p, f in zip(points, face, strict=True)], abs=1e-15
    )
    # No triangle is nearer: the few that might be, from their edges, are tried.
    from_edges = from_segments(points, corners, np.roll(corners, -1, axis=1)).min(axis=2)
    width = 2 * areas(corners) / np.maximum(np.linalg.norm(np.diff(sorted_corners[:, :2], axis=1)[:, 0], axis=1), 1e-9)
    for i, j in np.argwhere(from_edges - width < distance[:, None]):
        assert far_in_60_digits(points[i], *corners[j]) >= distance[i] - 1e-15


@pytest.mark.slow
@pytest.mark.parametrize("tried", [1, 10])
@pytest.mark.parametrize("name", ["fine", "few faces", "crossing"])
def test_quick_estimates_and_their_lower_bounds_enclose_the_distance(name, tried):
    rng = np.random.default_rng(7)
    mesh = {"fine": trimesh.creation.icosphere(4), "few faces": trimesh.creation.icosphere(0)}.get(
        name, PAIRS["crossing"][1]
    )
    on = mesh.triangles.view(np.ndarray).mean(axis=1)[rng.integers(len(mesh.faces), size=60)]
    points = on + rng.choice([0.0, 1e-9, 1e-3, 0.3], (60, 1)) * rng.standard_normal((60, 3))
    corners = mesh.triangles.view(np.ndarray)
    corners = np.take_along_axis(corners, longest_first(corners)[:, :, None], axis=1)
    distance, face, lower = Search(corners).near(points, tried)
    true = far(points, mesh)
    assert (lower - 1e-12 <= true).all()
    assert (true <= distance + 1e-12).all()
    of_face = [
        far(p[None], trimesh.Trimesh(corners[f], [(0, 1, 2)], process=False))[0]
        for p, f in zip(points, face, strict=True)
    ]
    assert distance == pytest.approx(of_face, abs=1e-12)
    if name == "fine" and tried == 10:
        # close to a mesh of faces of about the same size the estimate is proven right
        close = true < 1e-2
        assert close.sum() > 30
        assert np.array_equal(lower[close], distance[close])


def test_distances_of_points_to_a_body():
    body = PAIRS["crossing"][0]
    points = np.random.default_rng(1).standard_normal((500, 3)) * 2
    hull = ConvexHull(body.vertices)
    above = (points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
    signed, face, foot = nearest(points, body)
    assert np.array_equal(signed < 0, above < 0)
    assert signed[above < 0] == pytest.approx(above[above < 0], rel=1e-12)
    assert np.abs(signed) == pytest.approx(far(points, body), rel=1e-12)
    one_face = [
        far(p[None], trimesh.Trimesh(body.vertices, [body.faces[f]], process=False))[0]
        for p, f in zip(points, face, strict=True)
    ]
    assert np.abs(signed) == pytest.approx(one_face, rel=1e-12)
    assert np.linalg.norm(points - foot, axis=1) == pytest.approx(np.abs(signed), rel=1e-12)
    assert np.abs(signed_distances(foot, body)).max() < 1e-12
    assert np.array_equal(signed_distances(points, body), signed)
    assert np.array_equal(distances(points, body), np.abs(signed))
    square = trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3)], process=False)
    assert distances(points, square) == pytest.approx(far(points, square), rel=1e-12)
    assert len(distances(np.empty((0, 3)), body)) == 0
