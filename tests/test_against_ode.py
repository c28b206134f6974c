"""The closed form agrees with the differential equations (3), integrated from the clamp by scipy's DOP853.

The integration starts from the reactions alone: it uses neither elliptic integrals nor the contour.  It runs at a relative
tolerance of 1e-13, and its error grows with the forces, here up to 700; together with the closed form's rounding it is 1e-13.
"""

from typing import NamedTuple

import numpy as np
import pytest
import shooting
from scipy.integrate import solve_ivp

import planar
from planar import segments
from planar.elastica import bend

AGREES = 1e-12
# Rods integrated in one system: the stiffest one determines the steps, so that rods of similar stiffness are grouped.
TOGETHER = 500


def integrate(x0, f, alpha, m0z, s1):
    """x, y, φ, κ (4, n) of the rods at s1."""
    order = np.argsort(f * s1**2)
    ends = np.empty((4, len(f)))
    for group in np.array_split(order, -(-len(order) // TOGETHER)):
        ends[:, group] = shooting.integrate(x0[group], f[group], alpha[group], -m0z[group], s1[group])[:, :, 0]
    return ends


class Equilibria(NamedTuple):
    slope: np.ndarray
    zeta: np.ndarray
    point: np.ndarray
    tangential: np.ndarray
    state: segments.State

    @property
    def alpha(self):
        return self.slope + self.zeta

    @property
    def f(self):
        return self.state.force

    @property
    def m0z(self):
        return self.state.m0z

    def __getitem__(self, rows):
        state = segments.State._make(column[rows] for column in self.state)
        return Equilibria(self.slope[rows], self.zeta[rows], self.point[rows], self.tangential[rows], state)


@pytest.fixture(scope="module")
def random_equilibria():
    rng = np.random.default_rng(20)
    count = 40_000
    slope = rng.uniform(-np.pi / 2, np.pi / 2, count)
    steep = np.arange(count) % 8 == 0  # touch-down on a steep contour: f -> 0
    slope[steep] = np.pi / 2 - 10 ** rng.uniform(-6, -1, steep.sum())
    zeta = np.arctan(rng.uniform(0, 2, count) * (np.arange(count) % 5 > 0))
    x, y = rng.normal(size=count), rng.uniform(0.05, 1.0, count)
    close = np.arange(count) % 8 == 1  # the same for tip contact
    y[close] = 1 - 10 ** rng.uniform(-12, -1, close.sum())
    tangential = segments.is_tangential(slope, y, zeta)
    state = segments.states(tangential, slope, x, y, zeta)
    exists = np.isfinite(state.x0) & (state.force > 0)
    chosen = np.concatenate([np.flatnonzero(exists & tangential)[:5000], np.flatnonzero(exists & ~tangential)[:5000]])
    assert len(chosen) == 10_000
    return Equilibria(slope, zeta, np.stack([x, y], axis=1), tangential, state)[chosen]


def test_the_equilibria_cover_extreme_cases(random_equilibria):
    contacts = random_equilibria
    for kind in (contacts.tangential, ~contacts.tangential):
        assert (contacts.alpha[kind] > np.pi / 2).sum() > 100
        assert (contacts.alpha[kind] < 0).sum() > 100
        assert (contacts.f[kind] < 1e-4).sum() > 100
        assert (contacts.f[kind] > 8).sum() > 30
    assert (contacts.zeta == 0).sum() > 1000
    assert (np.tan(contacts.zeta) > 1.9).sum() > 100


def test_rods_end_where_the_equilibrium_says_without_curvature(random_equilibria):
    contacts = random_equilibria
    state, tangential = contacts.state, contacts.tangential
    x, y, phi, kappa = integrate(state.x0, contacts.f, contacts.alpha, contacts.m0z, state.s1)
    assert np.abs(x - contacts.point[:, 0]).max() < AGREES
    assert np.abs(y - contacts.point[:, 1]).max() < AGREES
    assert np.abs(kappa).max() < 10 * AGREES  # curvatures go up to 50
    rise = phi - contacts.slope
    assert np.abs(rise)[tangential].max() < AGREES  # (7)
    assert rise[~tangential].min() > -AGREES  # (6)
    assert rise[~tangential].max() < np.pi


# scholz-rahn integrates at a tolerance of 1e-10 itself, and one rod at a time
@pytest.mark.parametrize(("method", "agrees", "step"), [("closed-form", AGREES, 1), ("scholz-rahn", 1e-8, 50)])
def test_reconstruction_finds_their_ends(random_equilibria, method, agrees, step):
    expected = random_equilibria[::step]
    f, alpha, s1 = expected.f, expected.alpha, expected.state.s1
    contacts = planar.reconstruct(expected.state.x0, -f * np.sin(alpha), f * np.cos(alpha), expected.m0z, method)
    assert (contacts.status == planar.Status.OK).all()
    assert np.abs(contacts.s1 - s1).max() < agrees
    assert np.abs(contacts.point - expected.point).max() < agrees
    assert np.abs(contacts.friction_angle - expected.zeta)[expected.tangential & (s1 < 1 - 1e-6)].max() < agrees


def test_bend_up_to_the_largest_moment_that_the_force_can_balance():
    # k -> 1: the rod approaches its asymptote, and errors grow as 1/(1 - k²)
    rng = np.random.default_rng(21)
    alpha = rng.uniform(-1.2, 2.5, 1000)
    rest = 10 ** rng.uniform(-4, -0.5, 1000)
    q = np.sqrt(np.maximum(np.cos(alpha / 2) ** 2 - rest, 0.0))
    alpha, q, rest = alpha[q > 0], q[q > 0], rest[q > 0]
    shape = bend(alpha, q)
    x, y, _, kappa = integrate(np.zeros_like(q), np.ones_like(q), alpha, 2 * q, shape.length)
    assert rest.min() < 2e-4
    for residual in (x - shape.x, y - shape.y, kappa):
        assert (np.abs(residual) < AGREES + 1e-15 / rest).all()


def test_the_integration_of_many_rods_agrees_with_that_of_one_rod_at_a_time(random_equilibria):
    # rods in one system are controlled by a common error norm; a single rod is held to the tolerance itself
    contacts = random_equilibria[::200]
    x0, s1 = contacts.state.x0, contacts.state.s1
    ends = integrate(x0, contacts.f, contacts.alpha, contacts.m0z, s1)
    for i, (f, alpha, m0z) in enumerate(zip(contacts.f, contacts.alpha, contacts.m0z, strict=True)):

        def rod(_, values, f=f, alpha=alpha):
            return [np.cos(values[2]), np.sin(values[2]), values[3], f * np.cos(values[2] - alpha)]

        start = [x0[i], 0, np.pi / 2, -m0z]
        end = solve_ivp(rod, (0, s1[i]), start, method="DOP853", rtol=3e-14, atol=1e-15).y[:, -1]
        assert np.abs(end - ends[:, i]).max() < AGREES
