"""Poisson reconstruction and ball pivoting, on clouds of known bodies: accuracy, invariances, and inputs that are refused."""

import numpy as np
import pytest
import trimesh

import scan3d
from scan3d.errors import InputError
from scan3d.surfaces.open3d_methods import ball_pivoting, poisson

pytestmark = pytest.mark.slow

METHODS = [poisson, ball_pivoting]


def slices_of(semi_axes, slices=32, around=200, seed=0):
    """Contacts on an ellipsoid as a scan finds them: cosine spacing, dense along a slice, every slice turned anew."""
    turn = np.random.default_rng(seed).uniform(0, 2 * np.pi, slices)
    z = -np.cos(np.pi * (np.arange(slices) + 0.5) / slices)
    angle = 2 * np.pi * np.arange(around) / around + turn[:, None]
    radius = np.sqrt(1 - z**2)[:, None]
    ball = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.broadcast_to(z[:, None], angle.shape)], axis=2)
    ball = ball.reshape(-1, 3)
    normals = ball / semi_axes
    return ball * semi_axes, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def cube(per_edge=21):
    """Contacts all over the faces of the cube of side 2; on edges and corners one for each face."""
    u, v = np.meshgrid(*[np.linspace(-1, 1, per_edge)] * 2)
    face = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1)
    points = [np.roll(face * [1, 1, side], axis, axis=1) for axis in range(3) for side in (-1, 1)]
    normals = [np.roll([[0, 0, side]] * u.size, axis, axis=1) for axis in range(3) for side in (-1, 1)]
    return np.concatenate(points), np.concatenate(normals).astype(float)


def ellipsoid(semi_axes):
    mesh = trimesh.creation.icosphere(subdivisions=4)
    mesh.apply_scale(semi_axes)
    return mesh


def check_well_made(mesh):
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)
    assert len(np.unique(np.sort(mesh.faces, axis=1), axis=0)) == len(mesh.faces)
    assert mesh.area_faces.min() > 0
    assert mesh.is_winding_consistent
    outwards = (mesh.face_normals * (mesh.triangles_center - mesh.bounds.mean(axis=0))).sum(axis=1)
    assert np.average(outwards, weights=mesh.area_faces) > 0


# Between 32 slices the surface lies up to (π/32)²/8 = 1.2e-3 radii inside a chord, three times as much where triangles meet
# askew; Poisson's cells are as wide as the slices are apart.
@pytest.mark.open3d
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("semi_axes", [(36.0, 26.0, 18.0), (2.0, 2.0, 40.0)])
def test_the_surface_of_a_smooth_body_is_closed_and_accurate(method, semi_axes):
    made = method(*slices_of(np.array(semi_axes)))
    result = scan3d.compare(made, ellipsoid(semi_axes))
    check_well_made(made)
    assert made.is_watertight
    assert made.body_count == 1
    if method is ball_pivoting:
        assert set(map(tuple, made.vertices)) <= set(map(tuple, slices_of(np.array(semi_axes))[0]))
    assert result.relative < 2e-3
    assert abs(result.volume_error) < 1e-2


@pytest.mark.open3d
@pytest.mark.parametrize(("method", "within"), [(poisson, 0.03), (ball_pivoting, 0.01)])
def test_a_cube_with_contacts_on_all_faces(method, within):
    made = method(*cube())
    check_well_made(made)
    assert scan3d.compare(made, trimesh.creation.box((2, 2, 2))).relative < within


@pytest.mark.open3d
def test_a_poisson_surface_that_does_not_close_is_refused():
    points, _ = slices_of(np.array([1.0, 1.0, 1.0]))
    with pytest.raises(InputError, match=r"does not close.*further axes.*auto or hull"):
        poisson(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)) + 0.01 * points)
