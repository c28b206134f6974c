"""The fitted support function: its harmonics, and bodies whose support function is known."""

import numpy as np
import pytest

from scan3d.geometry.support import fit_support, harmonics


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
