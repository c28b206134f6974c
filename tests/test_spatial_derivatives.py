"""Derivatives along sweeps are exact for polynomials, at any distances of the samples."""

import numpy as np
import pytest

from scan3d.spatial.normals import extrapolating, fitting, interpolating, windows


def samples(width, count=50):
    rng = np.random.default_rng(width)
    position = np.cumsum(rng.uniform(0.5, 1.5, (count, width)), axis=1)
    return position, rng.integers(0, width, count), rng.normal(size=(count, width))


@pytest.mark.parametrize("width", [2, 3, 5, 7, 9])
def test_interpolation_is_exact_for_polynomials_through_all_samples(width):
    position, own, coefficients = samples(width)
    x = position / 10
    values = sum(c[:, None] * x**k for k, c in enumerate(coefficients.T))
    at = x[np.arange(len(x)), own]
    slope = sum(k * c * at ** (k - 1) for k, c in enumerate(coefficients.T) if k)
    np.testing.assert_allclose((interpolating(x, own) * values).sum(axis=1), slope, rtol=1e-7, atol=1e-8)
    outside = x[:, 0] - 0.07
    slope = sum(k * c * outside ** (k - 1) for k, c in enumerate(coefficients.T) if k)
    np.testing.assert_allclose((extrapolating(x, outside) * values).sum(axis=1), slope, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(("width", "degree"), [(5, 2), (7, 4), (41, 2), (41, 6)])
def test_fits_are_exact_for_polynomials_of_their_degree(width, degree):
    position, own, coefficients = samples(width)
    x = (position - position[:, :1]) / 10
    values = sum(c[:, None] * x**k for k, c in enumerate(coefficients.T[: degree + 1]))
    at = x[np.arange(len(x)), own]
    slope = sum(k * c * at ** (k - 1) for k, c in enumerate(coefficients.T[: degree + 1]) if k)
    weight = np.random.default_rng(0).uniform(1, 4, x.shape)
    weights, misfit = fitting(x, own, degree, weight, values[:, :, None])
    np.testing.assert_allclose((weights * values).sum(axis=1), slope, rtol=1e-5, atol=1e-5)
    assert misfit.max() < 1e-9
    # noise of the variance 1 / weight has the misfit 1
    noisy = np.random.default_rng(1).normal(size=(len(x), width)) / np.sqrt(weight)
    _, misfit = fitting(x, own, degree, weight, (values + noisy)[:, :, None])
    assert misfit.mean() == pytest.approx(1, abs=0.4)


def test_windows_stay_in_their_runs_and_are_shifted_at_the_ends():
    starts = np.zeros(13, dtype=bool)
    starts[[0, 7, 9]] = True
    found = windows(starts, 3)
    assert found.rows.tolist() == [0, 1, 2, 3, 4, 5, 6, 9, 10, 11, 12]
    assert found.members[0].tolist() == found.members[1].tolist() == [0, 1, 2]
    assert found.members[6].tolist() == [4, 5, 6]
    assert found.members[7].tolist() == [9, 10, 11]
    np.testing.assert_array_equal(found.members[np.arange(11), found.own], found.rows)
    assert len(windows(starts[:0], 3).rows) == 0
