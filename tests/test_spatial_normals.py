"""Normals along sweeps in space agree with those of an ellipsoid, and are as uncertain as they say.

The sweeps are frictionless, by scipy's root finding on the planar closed form in the bending plane.
"""

import numpy as np
import pytest
from scipy.optimize import root

from planar.elastica import bend
from scan3d.spatial.normals import Source, Track, along_sweeps, angles, frictionless

pytestmark = pytest.mark.slow

AXES, CENTRE = np.array([0.9, 0.675, 0.45]), np.array([0.0, 1.075, 0.0])


def ellipsoid_normal(points):
    normal = (points - CENTRE) / AXES**2
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _state(unknowns):
    omega, alpha, q, s1 = unknowns
    shape = bend(np.array([alpha]), np.array([q]))
    scale = shape.length[0] / s1
    across, along = np.array([np.cos(omega), 0, np.sin(omega)]), np.array([0.0, 1.0, 0.0])
    point = (shape.x[0] * across + shape.y[0] * along) / scale
    beta = np.arcsin(2 * (np.sin(alpha / 2) ** 2 + q * q) - 1)
    tangent = np.cos(alpha - beta) * across + np.sin(alpha - beta) * along
    force = np.sin(alpha) * across - np.cos(alpha) * along
    return point, tangent, force, scale


def sweep(height, base):
    """Tangential and tip contacts (n, 4: ω, α, q, s1) of one frictionless sweep at base positions (n,), by continuation."""
    guess = np.array([0.8 * np.sign(height), 1.2, 0.3, 0.95])
    states = []
    approach = np.linspace(0.5, base[0], 30)
    for x0 in np.concatenate([approach, base]):
        origin = np.array([x0, 0, height])

        def residual(unknowns, tip=False, origin=origin):
            point, tangent, force, _ = _state(unknowns)
            offset = (point + origin - CENTRE) / AXES
            normal = offset / AXES / np.linalg.norm(offset / AXES)
            sideways = np.cross(force, normal)
            last = 1 - unknowns[3] if tip else tangent @ normal
            b = np.array([-np.sin(unknowns[0]), 0, np.cos(unknowns[0])])
            return [offset @ offset - 1, sideways @ b, sideways @ np.cross(b, force), last]

        solved = root(residual, guess, options={"xtol": 1e-13}).x
        if solved[3] > 1:
            solved = root(residual, [*solved[:3], 1.0], args=(True,), options={"xtol": 1e-13}).x
        assert np.abs(residual(solved, solved[3] > 1 - 1e-12)).max() < 1e-10
        guess = solved
        states.append(solved)
    return np.array(states[len(approach) :])


def track(heights, samples, friction=0.0):
    """Frictionless sweeps at heights over the base.

    With `friction` the force is turned against the slip, and the path stays: these are no equilibria of a rod, but the
    relations between path, slip, force and normal are those that normals are found from.
    """
    columns = {name: [] for name in ("sweep", "row", "travel", "point", "s1", "tangent", "force", "tangential")}
    base, step = np.linspace(0.72, -0.72, samples), 1e-4
    for number, height in enumerate(heights):
        states = sweep(height, (base[:, None] + [step, 0, -step]).ravel()).reshape(samples, 3, 4)
        for row, (x0, near) in enumerate(zip(base, states, strict=True)):
            (before, _, _, _), (point, tangent, force, scale), (after, _, _, _) = map(_state, near)
            point = point + np.array([x0, 0, height])
            tangential = near[1, 3] < 1 - 1e-9
            slip = (after - before) / 2 / step - [1, 0, 0] - tangential * (near[2, 3] - near[0, 3]) / 2 / step * tangent
            normal = ellipsoid_normal(point[None])[0]
            slip -= slip @ normal * normal
            force = scale**2 * (force - friction * slip / np.linalg.norm(slip))
            for column, value in zip(
                columns.values(), (number, row, -x0, point, near[1, 3], tangent, force, tangential), strict=True
            ):
                column.append(value)
    return Track(**{name: np.array(column) for name, column in columns.items()})


FRICTION = 0.3


@pytest.fixture(scope="module")
def rubbing():
    """Sweeps of 64 samples with friction against the slip."""
    return track((0.1125, 0.2, -0.25), 64, FRICTION)


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


def test_without_friction_the_angles_say_so(rubbing):
    rng = np.random.default_rng(2)
    assert frictionless(np.zeros(50))
    assert frictionless(1e-4 * rng.normal(size=50), 1e-4)
    assert not frictionless(np.full(50, 1e-3))
    assert not frictionless(np.zeros(3))
    assert not frictionless(np.full(50, np.nan))
