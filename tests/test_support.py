"""The fitted support function: its harmonics, and bodies whose support function is known."""

import numpy as np
import pytest
import trimesh
from scipy.integrate import lebedev_rule

from scan3d.geometry.support import _roughness, fit_support, fitted_body, harmonics


def test_harmonics_have_their_gradients():
    """Against central differences of the functions themselves, continued off the sphere as |u|^(1-l) R_lm."""
    rng = np.random.default_rng(0)
    u = rng.normal(size=(20, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    degree, step = 6, 1e-6
    value, gradient = harmonics(u, degree)

    def continued(points):
        # homogeneous of degree 1
        length = np.linalg.norm(points, axis=1)
        return length * harmonics(points / length[:, None], degree)[0]

    np.testing.assert_allclose((gradient * u.T).sum(axis=1), value, atol=1e-12)
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        np.testing.assert_allclose(
            (continued(u + shift) - continued(u - shift)) / (2 * step), gradient[:, axis], atol=1e-7
        )


@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (40.0, 2.0, 2.0), (40.0, 40.0, 2.0)])
def test_an_ellipsoid_of_any_aspect_is_fitted_exactly(axes):
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    scaled = normals * np.array(axes) ** 2
    points = scaled / np.sqrt((normals * scaled).sum(axis=1))[:, None]
    # the moments of inertia are those of the points' hull: the degrees above 1 make up for what it lacks
    fitted = fit_support(points, normals, 8)
    assert np.abs(fitted.points(normals) - points).max() < 1e-3 * min(axes)


@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (3.0, 2.0, 1.0), (5.0, 5.0, 0.5)])
def test_the_facets_of_a_fitted_body_lie_as_far_inside_as_its_vertices_outside(axes):
    semi_axes, normals = np.array(axes), directions(8000)
    scaled = normals * semi_axes**2
    body = fitted_body(fit_support(scaled / np.linalg.norm(normals * semi_axes, axis=1)[:, None], normals, 8))

    def outside(points):
        """Distances (n,) from the ellipsoid, to first order, over its diagonal."""
        slope = points / semi_axes**2
        return ((points * slope).sum(axis=1) - 1) / np.linalg.norm(slope, axis=1) / 2 / np.linalg.norm(2 * semi_axes)

    vertices, middles = outside(body.vertices), outside(body.triangles_center)
    assert vertices.min() > 0 > middles.max()
    assert vertices.max() == pytest.approx(-middles.min(), rel=0.2)
    assert vertices.max() < 1.6e-5  # 81,920 facets with their corners on the ellipsoid lie up to 3.4e-5 inside
    assert abs(body.volume / (4 / 3 * np.pi * semi_axes.prod()) - 1) < 5e-5


# --- bodies in any place and orientation, from contacts with inexact normals ---

TURN = trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.6, 0.8]))[:3, :3]


def directions(count, seed=3):
    """Unit vectors (count, 3)."""
    vectors = np.random.default_rng(seed).standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


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
    exact = ellipsoid(semi_axes, elsewhere)
    assert fitted.points(elsewhere) == pytest.approx(exact, abs=1e-4 * min(semi_axes))
    rough = elsewhere + 0.05 * directions(2500, seed=5)
    normals_there = fitted.normals(exact, rough / np.linalg.norm(rough, axis=1)[:, None])
    assert np.linalg.norm(normals_there, axis=1) == pytest.approx(1.0)
    assert np.abs(normals_there - elsewhere).max() < 2e-3


def test_rough_normals_are_enough():
    """The contacts are exact, their normals deviate by 3°: the fit follows the contacts."""
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


@pytest.mark.parametrize("table", [-0.06, 0.0, 5.0])
def test_a_body_stands_on_its_table(table):
    """An ellipsoid whose foot was not touched, with errors in its contacts: the table says where it ends."""
    semi_axes, lowest = np.array([20.0, 15.0, 25.0]), 0.15
    rng = np.random.default_rng(2)
    normals = rng.normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    scaled = normals * semi_axes**2
    points = scaled / np.sqrt((normals * scaled).sum(axis=1))[:, None] + [0.0, 0.0, 25.0 + table]
    felt = points[:, 2] > table + lowest * 50.0
    touched = points[felt] + 0.3 * rng.standard_normal((felt.sum(), 1)) * normals[felt]
    free, standing = (fit_support(touched, normals[felt], 8, table=known) for known in (None, table))
    down = np.array([[0.0, 0.0, -1.0]])
    assert standing.points(down)[0, 2] == pytest.approx(table, abs=1e-4)
    assert abs(free.points(down)[0, 2] - table) > 1e-3
    assert np.abs(standing.points(normals) - points).max() < np.abs(free.points(normals) - points).max()


# --- smoothing under noise ---


def test_the_roughness_is_the_mean_square_of_the_second_power_of_the_operator():
    """By Lebedev's quadrature: harmonics of degree l have (Δ + 2) h = -(l - 1)(l + 2) h."""
    degree = 8
    nodes, weights = lebedev_rule(41)
    value, _ = harmonics(nodes.T, degree)
    degrees = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
    expected = ((degrees - 1.0) * (degrees + 2)) ** 4 * (value**2 @ weights) / (4 * np.pi)
    np.testing.assert_allclose(_roughness(degree)[1:], expected[1:], rtol=1e-12, atol=1e-9)
    assert _roughness(degree)[0] == 0


def noisy(count, sd, seed):
    """Contacts (n, 3) of an ellipsoid with noise along the normals (n, 3), which are returned as well."""
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


def test_exact_contacts_are_not_smoothed_whatever_standard_deviations_are_stated():
    """How far the contacts agree with each other decides, not the noise that is stated."""
    corner = directions(3000, seed=9)
    # the support function of a body with more than an ellipsoid's harmonics
    height = 5 + 0.2 * corner[:, 0] ** 3
    slope = np.zeros_like(corner)
    slope[:, 0] = 0.6 * corner[:, 0] ** 2
    points = (height - (slope * corner).sum(axis=1))[:, None] * corner + slope
    plain, smoothed = (fit_support(points, corner, 8, sd) for sd in (None, np.full(3000, 0.3)))
    away = directions(500, seed=10)
    assert smoothed.points(away) == pytest.approx(plain.points(away), abs=1e-4)


def test_noisy_contacts_whose_normals_are_wrong_at_first_leave_no_dent():
    """As where slices give normals that are wrong by more than a right angle at one side of the body."""
    points, normals = noisy(6000, 0.1, 5)
    wrong = (normals[:, 0] > 0.5) & (np.arange(len(normals)) % 4 == 0)
    rough = np.where(wrong[:, None], -normals + directions(6000, 6), normals)
    rough /= np.linalg.norm(rough, axis=1)[:, None]
    assert np.degrees(np.arccos((rough * normals).sum(axis=1)[wrong].min())) > 150
    sd = np.full(len(points), 0.1)
    found, best = (errors_of(fit_support(points, start, 8, sd)) for start in (rough, normals))
    assert found < 1.3 * best
