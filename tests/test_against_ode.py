"""The closed form agrees with the differential equations (3), integrated from the clamp by scipy's DOP853.

The authority knows the reactions and nothing else: no elliptic integral, no contour.  It runs at a relative tolerance of
1e-13, and its error grows with the forces, here up to 700; what is left of it and of the closed form's rounding is 1e-13.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import planar
from planar import equilibria, shooting
from planar.elastica import bend

AGREES = 1e-12
# Rods of similar stiffness share their steps, which the stiffest of them dictates.
TOGETHER = 500


def integrate(x0, f, alpha, m0z, s1):
    """x, y, φ, κ (4, n) of the rods at s1."""
    order = np.argsort(f * s1**2)
    ends = np.empty((4, len(f)))
    for some in np.array_split(order, -(-len(order) // TOGETHER)):
        ends[:, some] = shooting.integrate(x0[some], f[some], alpha[some], -m0z[some], s1[some])[:, :, 0]
    return ends


@pytest.fixture(scope="module")
def equilibria_at_random():
    """10,000 equilibria: slope, friction angle, point, phase, and reactions."""
    rng = np.random.default_rng(20)
    count = 40_000
    slope = rng.uniform(-np.pi / 2, np.pi / 2, count)
    steep = np.arange(count) % 8 == 0  # touch-down on a steep contour: f -> 0
    slope[steep] = np.pi / 2 - 10 ** rng.uniform(-6, -1, steep.sum())
    zeta = np.arctan(rng.uniform(0, 2, count) * (np.arange(count) % 5 > 0))
    x, y = rng.normal(size=count), rng.uniform(0.05, 1.0, count)
    close = np.arange(count) % 8 == 1  # the same for tip contact
    y[close] = 1 - 10 ** rng.uniform(-12, -1, close.sum())
    lies = equilibria.is_tangential(slope, y, zeta)
    state = equilibria.states(lies, slope, x, y, zeta)
    # as many of either phase as there are
    exists = np.isfinite(state.x0) & (state.root_f > 0)
    chosen = np.concatenate([np.flatnonzero(exists & lies)[:5000], np.flatnonzero(exists & ~lies)[:5000]])
    assert len(chosen) == 10_000
    state = equilibria.State._make(column[chosen] for column in state)
    return slope[chosen], zeta[chosen], np.stack([x, y], axis=1)[chosen], lies[chosen], state


def test_the_equilibria_cover_the_corners(equilibria_at_random):
    slope, zeta, _, lies, state = equilibria_at_random
    alpha = slope + zeta
    for kind in (lies, ~lies):
        assert (alpha[kind] > np.pi / 2).sum() > 100
        assert (alpha[kind] < 0).sum() > 100
        assert (state.root_f[kind] ** 2 < 1e-4).sum() > 100
        assert (state.root_f[kind] ** 2 > 8).sum() > 30
    assert (zeta == 0).sum() > 1000
    assert (np.tan(zeta) > 1.9).sum() > 100


def test_rods_end_where_the_equilibrium_says_without_curvature(equilibria_at_random):
    slope, zeta, point, lies, state = equilibria_at_random
    f, m0z = state.root_f**2, 2 * state.q * state.root_f
    x, y, phi, kappa = integrate(state.x0, f, slope + zeta, m0z, state.s1)
    assert np.abs(x - point[:, 0]).max() < AGREES
    assert np.abs(y - point[:, 1]).max() < AGREES
    assert np.abs(kappa).max() < 10 * AGREES  # curvatures go up to 50
    assert np.abs(phi - slope)[lies].max() < AGREES  # (7)
    assert (phi - slope)[~lies].min() > -AGREES  # (6)
    assert (phi - slope)[~lies].max() < np.pi


# scholz-rahn integrates at a tolerance of 1e-10 itself, and one rod at a time
@pytest.mark.parametrize(("method", "agrees", "step"), [("closed-form", AGREES, 1), ("scholz-rahn", 1e-8, 50)])
def test_reconstruction_finds_their_ends(equilibria_at_random, method, agrees, step):
    slope, zeta, point, lies, state = equilibria_at_random
    few = slice(None, None, step)
    slope, zeta, point, lies = slope[few], zeta[few], point[few], lies[few]
    x0, q, root_f, s1 = (column[few] for column in state[:4])
    f, alpha = root_f**2, slope + zeta
    contacts = planar.reconstruct(x0, -f * np.sin(alpha), f * np.cos(alpha), 2 * q * root_f, method)
    assert (contacts.status == planar.Status.OK).all()
    assert np.abs(contacts.s1 - s1).max() < agrees
    assert np.abs(contacts.point - point).max() < agrees
    assert np.abs(contacts.friction_angle - zeta)[lies & (s1 < 1 - 1e-6)].max() < agrees


def test_bend_up_to_the_moment_that_the_force_can_hardly_hold():
    # k -> 1: the rod comes close to its asymptote, and errors grow as 1/(1 - k²)
    rng = np.random.default_rng(21)
    alpha = rng.uniform(-1.2, 2.5, 1000)
    rest = 10 ** rng.uniform(-4, -0.5, 1000)
    q = np.sqrt(np.maximum(np.cos(alpha / 2) ** 2 - rest, 0.0))
    alpha, q, rest = alpha[q > 0], q[q > 0], rest[q > 0]
    shape = bend(alpha, q)
    x, y, _, kappa = integrate(np.zeros_like(q), np.ones_like(q), alpha, 2 * q, shape.length)
    assert rest.min() < 2e-4
    for miss in (x - shape.x, y - shape.y, kappa):
        assert (np.abs(miss) < AGREES + 1e-15 / rest).all()


def test_the_authority_agrees_with_itself_one_rod_at_a_time(equilibria_at_random):
    # rods in one system share an error norm; alone, each is held to the tolerance
    slope, zeta, _, _, state = equilibria_at_random
    some = np.arange(0, len(slope), 200)
    f, alpha, m0z = state.root_f[some] ** 2, (slope + zeta)[some], (2 * state.q * state.root_f)[some]
    ends = integrate(state.x0[some], f, alpha, m0z, state.s1[some])
    for i, row in enumerate(some):

        def rod(_, values, i=i):
            return [np.cos(values[2]), np.sin(values[2]), values[3], f[i] * np.cos(values[2] - alpha[i])]

        start = [state.x0[row], 0, np.pi / 2, -m0z[i]]
        alone = solve_ivp(rod, (0, state.s1[row]), start, method="DOP853", rtol=3e-14, atol=1e-15).y[:, -1]
        assert np.abs(alone - ends[:, i]).max() < AGREES
