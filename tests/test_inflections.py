"""Rods with an inflection between clamp and contact: solutions of the same equations that no sweep comes to.

A tip contact has further solutions, on which the curvature vanishes inside the rod before it does at the tip.  They are
made here by the differential equations (3): integrated beyond the first zero of the curvature to the second, a rod of that
length carries no moment at its tip either.  The sweep keeps to ``κ < 0`` on ``[0, s1)``, and the reconstruction, which
stops at the first zero, must not take them for tangential contacts.

Admissible is what the object can push: ``α̃ < φ1 < α̃ + π`` at the tip.  For a tip behind one inflection that means
``β < -ζ``, so that the sign of ``β`` tells.
"""

import numpy as np
import pytest

import planar
from planar import Phase, Status, shooting

SHARES = np.linspace(0.0, 1.0, 201)


def curvatures(swept):
    """κ (n, 201) from the clamp to the contact, by the differential equations."""
    f = np.hypot(swept.f0x, swept.f0y)
    alpha = np.arctan2(-swept.f0x, swept.f0y)
    return shooting.integrate(swept.x0, f, alpha, -swept.m0z, swept.s1, SHARES)[3]


def contours():
    rng = np.random.default_rng(60)
    for angle in np.radians([0, 20, 70, 90, 150]):
        a, b = 0.6, 0.6 / rng.choice([1, 3, 20])
        height = np.hypot(a * np.sin(angle), b * np.cos(angle)) + rng.uniform(0.05, 0.9)
        yield planar.Ellipse((a, b), (0.0, height), angle)
    for radius in (1e-3, 0.1, 3.0, 100.0):
        yield planar.Circle(radius, (0.0, radius + rng.uniform(0.05, 0.9)))
    for sides in (3, 4, 7):
        around = rng.uniform(0, 1) + 2 * np.pi * np.arange(sides) / sides
        yield planar.Polygon(np.stack([0.5 * np.cos(around), 0.6 + rng.uniform(0, 0.3) + 0.5 * np.sin(around)], axis=1))


@pytest.mark.parametrize("friction", [0.0, 0.3, 1.0, 5.0])
def test_sweeps_have_no_inflections(friction):
    for contour in contours():
        swept = planar.sweep(contour, friction, samples=40)
        assert (swept.phase != Phase.NONE).all()
        bent = planar.Sweep(**{name: column[1:] for name, column in vars(swept).items()})  # without touch-down
        assert (bent.m0z > 0).all()
        kappa = curvatures(bent)
        # a moment that vanishes at the contact and nowhere before
        assert (kappa[:, :-1] < 0).all(), contour
        assert np.abs(kappa[:, -1]).max() < 1e-9 * (1 + bent.m0z.max())


@pytest.mark.parametrize("friction", [0.0, 0.3, 1.0, 5.0])
def test_tips_are_pushed_and_not_pulled(friction):
    met = 0
    for contour in contours():
        swept = planar.sweep(contour, friction, samples=40)
        tip = np.flatnonzero((swept.phase == Phase.TIP) & (swept.m0z > 0))
        f, alpha = np.hypot(swept.f0x, swept.f0y)[tip], np.arctan2(-swept.f0x, swept.f0y)[tip]
        end = shooting.integrate(swept.x0[tip], f, alpha, -swept.m0z[tip], np.ones(len(tip)))[2, :, 0]
        rise = end - swept.slope[tip]
        assert (rise > -1e-9).all(), contour
        assert (rise < np.pi).all(), contour
        met += len(tip)
    assert met > 100


def test_elastic_lines_of_sweeps_turn_one_way_only():
    for contour in contours():
        swept = planar.sweep(contour, 0.3, samples=10)
        lines = planar.elastic_lines(swept.x0[1:], swept.f0x[1:], swept.f0y[1:], swept.m0z[1:], points=50)
        steps = np.diff(lines.curved, axis=1)
        turn = steps[:, :-1, 0] * steps[:, 1:, 1] - steps[:, :-1, 1] * steps[:, 1:, 0]
        assert (turn < 1e-15).all(), contour


@pytest.fixture(scope="module")
def with_an_inflection():
    """α, f, m0z of rods with s1 = 1 whose curvature vanishes once inside, where it does, and their slope at the tip."""
    rng = np.random.default_rng(61)
    alpha = rng.uniform(-1.2, 2.4, 300)
    q = np.cos(alpha / 2) * rng.uniform(0.05, 0.95, 300)
    # f = 1, and as long as it takes: past the first zero of κ on to the second, where it is cut off
    length, shares = 25.0, np.linspace(0.0, 1.0, 20_001)
    _, _, phi, kappa = shooting.integrate(np.zeros(300), 1.0, alpha, -2 * q, length, shares)
    first, second, tip_slope = np.full((3, 300), np.nan)
    for i in range(300):
        zeros = np.flatnonzero(kappa[i, :-1] * kappa[i, 1:] <= 0)
        if len(zeros) > 1:
            at = shares[zeros] + np.diff(shares)[0] * kappa[i, zeros] / (kappa[i, zeros] - kappa[i, zeros + 1])
            (first[i], second[i]), tip_slope[i] = length * at[:2], np.interp(at[1], shares, phi[i])
    found = np.isfinite(second)
    alpha, q, first, second, tip_slope = (column[found] for column in (alpha, q, first, second, tip_slope))
    assert found.sum() > 250
    return alpha, second**2, 2 * q * second, first / second, tip_slope


def test_they_are_solutions_of_the_equations(with_an_inflection):
    alpha, f, m0z, first, tip_slope = with_an_inflection
    shares = np.linspace(0, 1, 101)
    _, _, phi, kappa = shooting.integrate(np.zeros_like(f), f, alpha, -m0z, 1.0, shares)
    assert (np.abs(kappa[:, -1]) < 1e-4 * np.abs(kappa).max(axis=1)).all()  # no moment at the tip (6)
    assert np.abs(phi[:, -1] - tip_slope).max() < 1e-4
    bows_first_one_way, then_the_other = shares < first[:, None] - 0.01, shares > first[:, None] + 0.01
    assert (kappa[bows_first_one_way] < 0).all()
    assert (kappa[:, :-1][then_the_other[:, :-1]] > 0).all()


def test_reconstruction_flags_every_one_that_an_object_could_push(with_an_inflection):
    alpha, f, m0z, _, tip_slope = with_an_inflection
    # α̃ = α - ζ < φ1 < α̃ + π: with some friction ζ >= 0 an object can push the tip so if φ1 < α + π, and else with none.
    pushed = tip_slope < alpha + np.pi - 1e-6
    contacts = planar.reconstruct(np.zeros_like(f), -f * np.sin(alpha), f * np.cos(alpha), m0z)
    assert 50 < pushed.sum() < len(f) - 50
    assert (contacts.status[pushed] == Status.INFLECTION).all()
    assert (contacts.phase[pushed] == Phase.NONE).all()
    assert np.isnan(contacts.point[pushed]).all()
    assert np.isnan(contacts.s1[pushed]).all()


def test_nothing_with_an_inflection_is_taken_for_a_tip(with_an_inflection):
    # The others are no equilibria with any object; their first zero is that of a tangential contact with the same reactions.
    alpha, f, m0z, first, _ = with_an_inflection
    contacts = planar.reconstruct(np.zeros_like(f), -f * np.sin(alpha), f * np.cos(alpha), m0z)
    assert (contacts.phase != Phase.TIP).all()
    tangential = contacts.phase == Phase.TANGENTIAL
    assert np.abs(contacts.s1 - first)[tangential].max() < 1e-5


def test_they_take_more_force_than_the_papers_sweep_ever_sees(with_an_inflection):
    _, f, *_ = with_an_inflection
    sweeps = [planar.sweep(planar.Circle(0.9, (0, 1.3)), mu, samples=50) for mu in (0, 0.6)]
    assert max(np.hypot(swept.f0x, swept.f0y).max() for swept in sweeps) < f.min()


def test_reconstruction_flags_rods_that_bow_against_the_sweep(with_an_inflection):
    alpha, f, m0z, *_ = with_an_inflection
    contacts = planar.reconstruct(np.zeros_like(f), -f * np.sin(alpha), f * np.cos(alpha), -m0z)
    assert (contacts.status == Status.WRONG_SIDE).all()
    assert np.isnan(contacts.point).all()
