"""Normals along sweeps in space agree with those of an ellipsoid, and are as uncertain as they say."""

import numpy as np
import pytest
from spatial_sweeps import ellipsoid_normal, track

from scan3d.spatial.normals import (
    Source,
    along_sweeps,
    angles,
    frictionless,
)

FRICTION = 0.3


@pytest.fixture(scope="module")
def rubbing():
    """Sweeps of 64 samples with friction against the slip."""
    return track((0.1125, 0.2, -0.25), 64, FRICTION)


@pytest.mark.slow
def test_normals_agree_with_the_ellipsoids(rubbing):
    normals, exact = along_sweeps(rubbing), ellipsoid_normal(rubbing.point)
    known = normals.source != Source.UNKNOWN
    assert known.mean() > 0.97
    error = np.degrees(angles(normals.normal[known], exact[known]))
    assert np.median(error) < 1e-4
    assert np.percentile(error, 95) < 0.005
    assert {Source.SLIP, Source.PATH} == set(normals.source[known])
    tips = ~rubbing.tangential[known]
    assert tips.sum() >= 10
    assert error[tips].max() < 0.05
    # what truncation is estimated to be covers the errors
    assert np.mean(np.radians(error) > normals.sd[known]) < 0.05
    assert np.isinf(normals.sd[~known]).all()
    assert np.isnan(normals.normal[~known]).all()
    ratio = np.tan(angles(normals.normal, rubbing.force / np.linalg.norm(rubbing.force, axis=1)[:, None])[known])
    assert np.median(np.abs(ratio - FRICTION)) < 1e-6


@pytest.mark.slow
def test_slip_and_path_agree_where_friction_acts_against_the_slip_and_not_else(rubbing):
    normals = along_sweeps(rubbing)
    both = np.isfinite(normals.disagreement)
    assert both.sum() > 50
    assert np.median(normals.disagreement[both] / normals.disagreement_sd[both]) < 1
    # friction across the slip, as of a rough thread
    force = rubbing.force + 0.1 * np.linalg.norm(rubbing.force, axis=1)[:, None] * np.cross(
        ellipsoid_normal(rubbing.point), rubbing.tangent
    )
    other = along_sweeps(rubbing._replace(force=force))
    both = np.isfinite(other.disagreement)
    assert np.median(other.disagreement[both] / other.disagreement_sd[both]) > 100


@pytest.mark.slow
@pytest.mark.parametrize("noise", [1e-6, 1e-5, 1e-4])
def test_noise_gives_the_errors_that_are_stated(rubbing, noise):
    n = len(rubbing.row)
    exact = ellipsoid_normal(rubbing.point)
    ratios = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        noisy = rubbing._replace(
            point=rubbing.point + noise * rng.normal(size=(n, 3)),
            s1=rubbing.s1 + noise * rng.normal(size=n) * rubbing.tangential,
            covariance=np.tile(noise**2 * np.eye(3), (n, 1, 1)),
            direction_sd=np.full(n, noise),
        )
        normals = along_sweeps(noisy)
        known = normals.source != Source.UNKNOWN
        assert known.mean() > 0.95
        ratios.append(angles(normals.normal[known], exact[known]) / normals.sd[known])
    ratio = np.concatenate(ratios)
    # a normal distribution has 0.67 and 1.96
    assert 0.4 < np.median(ratio) < 1.0
    assert np.percentile(ratio, 95) < 3.5


@pytest.mark.slow
def test_no_derivative_crosses_snaps_gaps_and_stick(rubbing):
    n = len(rubbing.row)
    exact = ellipsoid_normal(rubbing.point)
    sample = np.arange(n) % 64

    # a snap: the second half of each sweep lies elsewhere
    shifted = rubbing.point + np.where(sample < 32, 0.0, 0.5)[:, None]
    normals = along_sweeps(rubbing._replace(point=shifted))
    known = normals.source != Source.UNKNOWN
    assert np.degrees(angles(normals.normal[known], exact[known])).max() < 0.1

    # samples without a contact between them
    row = rubbing.row + np.where(sample < 32, 0, 7)
    normals = along_sweeps(rubbing._replace(point=shifted, row=row))
    assert np.degrees(angles(normals.normal[known], exact[known])).max() < 0.1

    # the clamp moves, and the rod's material point stays
    held = np.minimum(np.arange(n), np.arange(n) - sample + 40)
    normals = along_sweeps(
        rubbing._replace(**{name: getattr(rubbing, name)[held] for name in ("point", "s1", "tangent", "force")})
    )
    assert (normals.source[sample > 41] == Source.UNKNOWN).all()
    assert normals.sticks[sample > 41].all()
    assert not normals.sticks[sample < 39].any()


@pytest.mark.slow
def test_without_friction_the_angles_say_so(rubbing):
    rng = np.random.default_rng(2)
    assert frictionless(np.zeros(50))
    assert frictionless(1e-4 * rng.normal(size=50), 1e-4)
    assert not frictionless(np.full(50, 1e-3))
    assert not frictionless(np.zeros(3))
    assert not frictionless(np.full(50, np.nan))
