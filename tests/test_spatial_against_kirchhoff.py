"""The closed form in space agrees with a Kirchhoff rod, integrated from the clamp by scipy's DOP853.

The integration starts from the reactions alone and knows no bending plane: position, rotation of the cross-sections, internal
force and moment in space, a torsional stiffness of its own, and a clamp turned about its axis.
"""

import numpy as np
from scipy.integrate import solve_ivp

from planar.elastica import bend
from scan3d.spatial.inverse import Status, reconstruct

AGREES = 1e-10
# Rods integrated in one system: the stiffest one determines the steps.
TOGETHER = 250


def integrate(force, moment, s1, torsional, turn):
    """Position, tangent and internal moment (n, 3) at s1 of rods with the support reactions (n, 3)."""
    n = len(s1)
    inner, start_moment = -force, -moment  # of the part past the clamp on the clamp
    zero, one = np.zeros(n), np.ones(n)
    first = np.stack([np.cos(turn), zero, np.sin(turn)], axis=1)
    along = np.stack([zero, one, zero], axis=1)
    frame = np.stack([first, np.cross(along, first), along], axis=1)

    def slopes(_, state):
        frame, moment = state.reshape(n, 5, 3)[:, 1:4], state.reshape(n, 5, 3)[:, 4]
        curvature = moment + (1 / torsional - 1)[:, None] * (moment * frame[:, 2]).sum(axis=1)[:, None] * frame[:, 2]
        result = np.empty((n, 5, 3))
        result[:, 0] = frame[:, 2]
        result[:, 1:4] = np.cross(curvature[:, None], frame)
        result[:, 4] = -np.cross(frame[:, 2], inner)
        return (result * s1[:, None, None]).ravel()

    start = np.concatenate([np.zeros((n, 1, 3)), frame, start_moment[:, None]], axis=1)
    end = solve_ivp(slopes, (0, 1), start.ravel(), method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1].reshape(n, 5, 3)
    return end[:, 0], end[:, 3], end[:, 4]


def states(n, seed):
    """Reactions of bent rods (n, 3) whose friction angles β are of both signs, in order of their stiffness, and s1."""
    rng = np.random.default_rng(seed)
    alpha = rng.uniform(-1.2, 2.4, n)
    q = np.cos(alpha / 2) * rng.uniform(0.02, 0.97, n)
    s1 = np.where(rng.random(n) < 0.3, 1.0, rng.uniform(0.2, 1.0, n))
    root = bend(alpha, q).length / s1
    order = np.argsort(root * s1)
    alpha, q, s1, root = alpha[order], q[order], s1[order], root[order]
    omega = rng.uniform(-np.pi, np.pi, n)
    across = np.stack([np.cos(omega), 0 * omega, np.sin(omega)], axis=1)
    normal = np.stack([-np.sin(omega), 0 * omega, np.cos(omega)], axis=1)
    force = -(root**2)[:, None] * (np.sin(alpha)[:, None] * across - np.cos(alpha)[:, None] * [0.0, 1.0, 0.0])
    return force, (2 * q * root)[:, None] * normal, s1


def check(n, seed):
    force, moment, s1 = states(n, seed)
    found = reconstruct(force, moment)
    assert (found.status == Status.OK).all()
    assert np.abs(found.s1 - s1).max() < AGREES
    assert (found.friction_angle_bound < 0).mean() > 0.1
    rng = np.random.default_rng(seed)
    for rows in np.array_split(np.arange(n), -(-n // TOGETHER)):
        torsional, turn = rng.uniform(0.4, 2.5, len(rows)), rng.uniform(-np.pi, np.pi, len(rows))
        point, tangent, end_moment = integrate(force[rows], moment[rows], found.s1[rows], torsional, turn)
        assert np.abs(point - found.point[rows]).max() < AGREES
        assert np.abs(tangent - found.tangent[rows]).max() < AGREES
        scale = 1 + np.linalg.norm(force[rows], axis=1)[:, None]
        assert np.abs(end_moment / scale).max() < AGREES


def test_ten_thousand_states_agree_with_the_integrated_rod():
    check(10_000, 2)
