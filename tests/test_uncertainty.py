"""Derivatives of the closed form by the reactions: against differences, numerical integration and random errors."""

import numpy as np
import pytest

import planar

CIRCLE = planar.Circle(0.9, (0.0, 1.3))


def reactions(friction, direction=-1, samples=60):
    sweep = planar.sweep(CIRCLE, friction=friction, samples=samples)
    rows = np.hypot(sweep.f0x, sweep.f0y) > 1e-3
    mirrored = -direction
    return np.stack([mirrored * sweep.f0x[rows], sweep.f0y[rows], mirrored * sweep.m0z[rows]])


def quantities(f0x, f0y, m0z, direction=-1, method="closed-form"):
    """(n, 5) place, arc length, force's direction and friction angle, as in the rows of the Jacobian."""
    contacts = planar.reconstruct(np.zeros(len(f0x)), f0x, f0y, m0z, method=method, tolerance=0.5, direction=direction)
    return np.column_stack([contacts.point, contacts.s1, contacts.force_angle, contacts.friction_angle_bound])


@pytest.mark.parametrize("direction", [-1, 1])
@pytest.mark.parametrize("friction", [0.0, 0.2, 0.6])
def test_the_jacobian_agrees_with_central_differences(friction, direction):
    measured = reactions(friction, direction)
    jacobian = planar.jacobian(*measured, direction=direction)
    assert jacobian.shape == (measured.shape[1], 5, 3)
    step = 1e-6
    for column in range(3):
        change = np.zeros((3, 1))
        change[column] = step
        ahead, behind = (quantities(*(measured + sign * change), direction=direction) for sign in (1, -1))
        difference = (ahead - behind) / (2 * step)
        scale = np.abs(jacobian).max(axis=(1, 2))
        assert np.isfinite(difference).all()
        assert (np.abs(jacobian[:, :, column] - difference) < 1e-8 * scale[:, None]).all()


def test_the_jacobian_agrees_with_differences_of_the_integrated_rod():
    """Against equation (3), integrated from the clamp: no elliptic integral has a part in it."""
    measured = reactions(0.3, samples=12)
    jacobian = planar.jacobian(*measured)
    for column in range(3):
        change = np.zeros((3, 1))
        change[column] = 1e-4
        ahead, behind = (quantities(*(measured + sign * change), method="scholz-rahn") for sign in (1, -1))
        difference = (ahead - behind)[:, :3] / 2e-4
        scale = np.abs(jacobian).max(axis=(1, 2))
        assert (np.abs(jacobian[:, :3, column] - difference) < 1e-6 * scale[:, None]).all()


def test_reactions_without_a_rod_have_no_derivatives():
    no_force, wrong_side, too_large = (0.0, 0.0, 0.0), (-1.0, 1.0, -1.0), (-1.0, 1.0, 9.0)
    jacobian = planar.jacobian(*np.transpose([no_force, wrong_side, too_large, reactions(0.2)[:, 5]]))
    assert np.isnan(jacobian[:3]).all()
    assert np.isfinite(jacobian[3]).all()


def test_rows_that_no_rod_has_have_no_deviation_without_noise_either():
    for noise in ((0.0, 0.0), (1e-9, 0.0)):
        found = planar.errors([1.0, -1.0], [1.0, 1.0], [9.0, 1.0], noise=noise)
        assert found.largest[0] == np.inf
        assert found.largest[1] <= 1e-8
    unknown = np.full((1, 3, 3), np.nan)
    assert planar.errors([-1.0], [1.0], [1.0], noise=(0.0, 0.0), covariance=unknown).largest == [np.inf]
    assert planar.errors(-1.0, 1.0, 1.0, noise=(0.0, 0.0)).largest == [0.0]
