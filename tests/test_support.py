"""The fitted support function: its harmonics, and bodies whose support function is known."""

import numpy as np
import pytest
import trimesh
from shapes import directions

from scan3d.geometry.support import fit_support, fitted_body

TURN = trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.6, 0.8]))[:3, :3]


CENTER = np.array([3.0, -2.0, 7.0])


def ellipsoid(semi_axes, normals, turn=TURN, center=CENTER):
    """Points (n, 3) of an ellipsoid, turned and moved, with the given outward normals."""
    shape = turn @ np.diag(np.square(semi_axes)) @ turn.T
    scaled = normals @ shape
    return center + scaled / np.sqrt((normals * scaled).sum(axis=1))[:, None]


@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (40.0, 2.0, 2.0), (40.0, 40.0, 2.0)])
def test_an_ellipsoid_of_any_aspect_is_fitted_exactly(axes):
    normals = directions(4000)
    points = ellipsoid(axes, normals)
    # the moments of inertia are those of the points' hull: the degrees above 1 make up for what it lacks
    fitted = fit_support(points, normals, 8)
    assert np.abs(fitted.points(normals) - points).max() < 1e-3 * min(axes)


@pytest.mark.slow
@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (3.0, 2.0, 1.0), (5.0, 5.0, 0.5)])
def test_the_facets_of_a_fitted_body_lie_as_far_inside_as_its_vertices_outside(axes):
    semi_axes, normals = np.array(axes), directions(8000)
    body = fitted_body(fit_support(ellipsoid(axes, normals, np.eye(3), 0.0), normals, 8))

    def outside(points):
        """Distances (n,) from the ellipsoid, to first order, over its diagonal."""
        slope = points / semi_axes**2
        return ((points * slope).sum(axis=1) - 1) / np.linalg.norm(slope, axis=1) / 2 / np.linalg.norm(2 * semi_axes)

    vertices, middles = outside(body.vertices), outside(body.triangles_center)
    assert vertices.min() > 0 > middles.max()
    assert vertices.max() == pytest.approx(-middles.min(), rel=0.2)
    assert vertices.max() < 1.6e-5  # 81,920 facets with their corners on the ellipsoid lie up to 3.4e-5 inside
    assert abs(body.volume / (4 / 3 * np.pi * semi_axes.prod()) - 1) < 5e-5


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
    elsewhere = directions(2500, seed=4)
    exact = ellipsoid(semi_axes, elsewhere)
    assert fitted.points(elsewhere) == pytest.approx(exact, abs=1e-4 * min(semi_axes))
    rough = elsewhere + 0.05 * directions(2500, seed=5)
    normals_there = fitted.normals(exact, rough / np.linalg.norm(rough, axis=1)[:, None])
    assert np.linalg.norm(normals_there, axis=1) == pytest.approx(1.0)
    assert np.abs(normals_there - elsewhere).max() < 2e-3


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


@pytest.mark.parametrize("table", [-0.06, 0.0, 5.0])
def test_a_body_stands_on_its_table(table):
    """An ellipsoid whose foot was not touched, with errors in its contacts: the table says where it ends."""
    rng, normals = np.random.default_rng(2), directions(4000)
    points = ellipsoid((20.0, 15.0, 25.0), normals, np.eye(3), [0.0, 0.0, 25.0 + table])
    felt = points[:, 2] > table + 0.15 * 50.0
    touched = points[felt] + 0.3 * rng.standard_normal((felt.sum(), 1)) * normals[felt]
    free, standing = (fit_support(touched, normals[felt], 8, table=known) for known in (None, table))
    down = np.array([[0.0, 0.0, -1.0]])
    assert standing.points(down)[0, 2] == pytest.approx(table, abs=1e-4)
    assert abs(free.points(down)[0, 2] - table) > 1e-3
    assert np.abs(standing.points(normals) - points).max() < np.abs(free.points(normals) - points).max()


def noisy(count, sd, seed):
    normals = directions(count, seed)
    noise = sd * np.random.default_rng(seed + 100).standard_normal(count)
    return ellipsoid((9.0, 6.0, 5.0), normals) + noise[:, None] * normals, normals


def errors_of(fitted):
    elsewhere = directions(3000, seed=77)
    return np.sqrt(np.mean((fitted.points(elsewhere) - ellipsoid((9.0, 6.0, 5.0), elsewhere)) ** 2))


@pytest.mark.slow
def test_noise_is_smoothed_and_the_degree_hardly_matters():
    """An ellipsoid is mapped to a ball, whose series ends at once: whatever else is in the fit is noise."""
    for seed in range(3):
        points, normals = noisy(4000, 0.1, seed)
        plain = errors_of(fit_support(points, normals, 16))
        smoothed = [errors_of(fit_support(points, normals, degree, np.full(4000, 0.1))) for degree in (8, 16)]
        assert smoothed[1] < plain / 3
        assert smoothed[1] == pytest.approx(smoothed[0], rel=0.1)
