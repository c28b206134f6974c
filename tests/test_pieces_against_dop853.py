"""Pieces of the elastica with a constant force, in every regime, against an integration of (C2) by DOP853."""

import numpy as np
import scipy

from planar.elastica import piece


def integrated(force, phi, kappa, length):
    """The end of one piece: x, y, φ, κ."""

    def slopes(_, state):
        return [np.cos(state[2]), np.sin(state[2]), state[3], force[0] * np.sin(state[2]) - force[1] * np.cos(state[2])]

    solved = scipy.integrate.solve_ivp(
        slopes, (0, length), [0, 0, phi, kappa], method="DOP853", rtol=3e-14, atol=1e-15, max_step=0.05
    )
    return solved.y[:, -1]


def compare(size, alpha, phi, kappa, length):
    fx, fy = size * np.sin(alpha), -size * np.cos(alpha)
    mine = np.stack(piece(fx, fy, phi, kappa, length), axis=1)
    truth = np.array([integrated((a, b), c, d, e) for a, b, c, d, e in zip(fx, fy, phi, kappa, length, strict=True)])
    return np.abs(mine - truth).max()


def test_random_pieces():
    # energies on both sides of the pendulum's separatrix, either sign of the curvature, also backwards along the rod
    rng = np.random.default_rng(43)
    n = 120
    size, alpha = 10 ** rng.uniform(-5, 1.3, n), rng.uniform(-np.pi, np.pi, n)
    phi, kappa = rng.uniform(-4, 4, n), rng.normal(size=n) * 10 ** rng.uniform(-3, 0.7, n)
    length = rng.uniform(0.05, 1, n) * np.where(rng.random(n) < 0.2, -1, 1)
    m = (size * np.sin((phi - alpha - np.pi / 2) / 2) ** 2 + kappa**2 / 4) / size
    assert min((m < 1).sum(), ((m > 1) & (m < 50)).sum(), (m > 50).sum()) >= 10
    assert compare(size, alpha, phi, kappa, length) < 5e-13


def test_limits():
    # no force: an arc of a circle; neither force nor curvature: straight; at rest in the force's line: straight
    zero = np.zeros(1)
    end = piece(zero, zero, np.array([0.3]), np.array([2.0]), np.array([0.7]))
    assert abs(end.phi[0] - 1.7) < 1e-15
    np.testing.assert_allclose(
        [end.x[0], end.y[0]], [(np.sin(1.7) - np.sin(0.3)) / 2, (np.cos(0.3) - np.cos(1.7)) / 2], atol=1e-15
    )
    end = piece(zero, zero, np.array([0.3]), zero, np.array([0.7]))
    np.testing.assert_allclose(np.ravel(end), [0.7 * np.cos(0.3), 0.7 * np.sin(0.3), 0.3, 0], atol=1e-15)
    # a strut and a tie: the force acts along the rod, pushes or pulls
    for sign in (-1.0, 1.0):
        end = piece(zero, np.array([3.0 * sign]), np.array([np.pi / 2]), zero, np.array([1.0]))
        np.testing.assert_allclose(np.ravel(end), [0, 1, np.pi / 2, 0], atol=1e-13)


def test_the_separatrix():
    # m = 1 up to its rounding, where the regimes meet
    size, alpha, phi = np.full(7, 4.0), np.full(7, 0.4), np.full(7, 0.2)
    theta = phi - alpha - np.pi / 2
    kappa = 2 * np.sqrt(size) * np.cos(theta / 2) * (1 + np.array([-1e-3, -1e-8, -1e-13, 0, 1e-13, 1e-8, 1e-3]))
    assert compare(size, alpha, phi, kappa, np.full(7, 0.9)) < 1e-12


def test_ties():
    # pulled along its own line the rod is an unstable pendulum at rest
    angle = np.array([0, 1e-12, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2])
    size, phi, kappa = np.full(9, 6.0), np.pi / 2 + angle, 0.3 * angle
    assert compare(size, np.zeros(9), phi, kappa, np.full(9, 0.9)) < 1e-10


def test_two_halves_are_the_whole():
    rng = np.random.default_rng(7)
    fx, fy, phi, kappa = rng.normal(size=(4, 500)) * np.array([[3], [3], [1.5], [3]])
    whole = piece(fx, fy, phi, kappa, np.full(500, 0.8))
    first = piece(fx, fy, phi, kappa, np.full(500, 0.3))
    second = piece(fx, fy, first.phi, first.kappa, np.full(500, 0.5))
    joined = np.stack([first.x + second.x, first.y + second.y, second.phi, second.kappa])
    assert np.abs(joined - np.stack(whole)).max() < 1e-12
