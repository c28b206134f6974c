"""Convex hulls as meshes, and support functions fitted to contacts of bodies that have them in closed form."""

import numpy as np
import pytest
import trimesh

from scan3d.errors import InputError
from scan3d.hulls import hull
from scan3d.support import fit_support

RNG = np.random.default_rng(11)
TURN = trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.6, 0.8]))[:3, :3]


def directions(count, seed=3):
    found = np.random.default_rng(seed).standard_normal((count, 3))
    return found / np.linalg.norm(found, axis=1)[:, None]


# --- hulls ---


@pytest.mark.parametrize("shift", [0.0, 1000.0])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_a_hull_is_closed_and_outward_and_keeps_the_coordinates(scale, shift):
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-2, 2) for z in (-3, 3)], dtype=float)
    points = scale * (np.vstack([corners, RNG.uniform(-1, 1, (30, 3))]) @ TURN.T + shift)
    made = hull(points)
    assert made.is_watertight
    assert made.volume == pytest.approx(48 * scale**3, rel=1e-6)
    outward = np.cross(*(made.triangles[:, i] - made.triangles[:, 0] for i in (1, 2)))
    assert (((made.triangles_center - points.mean(axis=0)) * outward).sum(axis=1) > 0).all()
    # the vertices are the box's own corners, to the last digit
    assert {tuple(p) for p in np.asarray(made.vertices)} == {tuple(p) for p in points[:8]}


def test_all_faces_of_a_round_hull_are_outward():
    points = directions(500) * [1.0, 2.0, 0.1]
    made = hull(points)
    assert len(made.vertices) == 500
    assert len(made.faces) == 2 * 500 - 4
    outward = np.cross(*(made.triangles[:, i] - made.triangles[:, 0] for i in (1, 2)))
    assert ((made.triangles_center * outward).sum(axis=1) > 0).all()


@pytest.mark.parametrize("shift", [0.0, 7.0])
@pytest.mark.parametrize("thickness", [0.0, 1e-6, 1e-3])
def test_points_in_one_plane_span_no_body(thickness, shift):
    points = np.column_stack([RNG.uniform(-1, 1, (60, 2)), thickness * RNG.uniform(-1, 1, 60)]) @ TURN.T + shift
    if thickness > 1e-9:
        assert hull(points).volume > 0
    else:
        with pytest.raises(InputError, match="the 60 contacts span no body"):
            hull(points)


@pytest.mark.parametrize("points", [np.zeros((5, 3)), np.eye(3), np.outer(np.arange(6.0), [1, 2, 3])])
def test_points_that_are_too_few_or_in_one_place_span_no_body(points):
    with pytest.raises(InputError, match=f"the {len(points)} contacts span no body"):
        hull(points)


# --- fitted support functions ---

CENTER = np.array([3.0, -2.0, 7.0])


def ellipsoid(semi_axes, normals):
    """Points (n, 3) of an ellipsoid, turned and moved, with the given outward normals."""
    shape = TURN @ np.diag(np.square(semi_axes)) @ TURN.T
    scaled = normals @ shape
    return CENTER + scaled / np.sqrt((normals * scaled).sum(axis=1))[:, None]


@pytest.mark.parametrize("count", [1500, 9000])
@pytest.mark.parametrize("semi_axes", [(5.0, 5.0, 5.0), (9.0, 4.0, 2.0)])
def test_an_ellipsoid_is_found_with_its_place_and_axes(semi_axes, count):
    normals = directions(count)
    fitted = fit_support(ellipsoid(semi_axes, normals), normals, 6)
    # both are those of the hull of some thousand contacts
    assert fitted.center == pytest.approx(CENTER, abs=0.02 * max(semi_axes))
    values, axes = np.linalg.eigh(fitted.shape)
    assert values == pytest.approx(sorted(semi_axes), rel=0.03)
    assert fitted.shape == pytest.approx(fitted.shape.T)
    if len(set(semi_axes)) == 3:
        assert np.abs(axes.T @ TURN[:, ::-1]) == pytest.approx(np.eye(3), abs=0.05)
    assert fitted.rms < 1e-6
    elsewhere = directions(2500, seed=4)
    true = ellipsoid(semi_axes, elsewhere)
    assert fitted.points(elsewhere) == pytest.approx(true, abs=1e-4 * min(semi_axes))
    rough = elsewhere + 0.05 * directions(2500, seed=5)
    found = fitted.normals(true, rough / np.linalg.norm(rough, axis=1)[:, None])
    assert np.linalg.norm(found, axis=1) == pytest.approx(1.0)
    assert np.abs(found - elsewhere).max() < 2e-3


def test_rough_normals_are_enough():
    """The places are exact, the normals are 3° off: the fit follows the places."""
    normals = directions(3000)
    rough = normals + 0.05 * directions(3000, seed=6)
    rough /= np.linalg.norm(rough, axis=1)[:, None]
    semi_axes = (9.0, 4.0, 2.0)
    fitted = fit_support(ellipsoid(semi_axes, normals), rough, 4)
    assert fitted.rms < 1e-4
    assert fitted.points(normals) == pytest.approx(ellipsoid(semi_axes, normals), abs=0.02)


def pillow(normals, bulge=0.08):
    """Gradient of ``|u| + bulge z⁴/|u|³`` at unit vectors: a ball that is longer along z, and no ellipsoid."""
    z = normals[:, 2:]
    return normals + bulge * (4 * z**3 * [0, 0, 1] - 3 * z**4 * normals)


def test_a_body_that_is_no_ellipsoid_is_found_with_its_degree():
    normals = directions(3000)
    worst = [
        np.abs(fit_support(pillow(normals), normals, degree).points(normals) - pillow(normals)).max()
        for degree in (2, 4, 8)
    ]
    assert worst[0] > 5e-3
    assert worst[1] < 0.5 * worst[0]
    assert worst[2] < 1e-4
    fitted = fit_support(pillow(normals), normals, 8)
    off = ((pillow(normals) - fitted.points(normals)) * normals).sum(axis=1)
    assert fitted.rms == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.2)
