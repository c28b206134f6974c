"""Rods with an inflection between clamp and contact: solutions of the same equations that do not occur in sweeps.

A tip contact has further solutions, on which the curvature vanishes inside the rod before it does at the tip.  They are
computed here by the differential equations (3): integrated beyond the first zero of the curvature to the second, a rod of that
length carries no moment at its tip either.  The sweep is restricted to ``κ < 0`` on ``[0, s1)``, and the reconstruction,
which stops at the first zero, must not mistake them for tangential contacts.

The object can only push the rod: ``α̃ < φ1 < α̃ + π`` at the tip.  For a tip beyond one inflection this means ``β < -ζ``, so
that the sign of ``β`` distinguishes these rods.
"""

from typing import NamedTuple

import numpy as np
import pytest
import shooting

import planar
from planar import Phase, Status

FRACTIONS = np.linspace(0.0, 1.0, 201)


def integrated(swept):
    """φ and κ (n, 201) from the clamp to the contact, by the differential equations."""
    f = np.hypot(swept.f0x, swept.f0y)
    alpha = np.arctan2(-swept.f0x, swept.f0y)
    return shooting.integrate(swept.x0, f, alpha, -swept.m0z, swept.s1, FRACTIONS)[2:]


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
@pytest.mark.slow
def test_sweeps_have_no_inflections_and_tips_are_pushed_and_not_pulled(friction):
    tips = 0
    for contour in contours():
        swept = planar.sweep(contour, friction, samples=40)
        assert (swept.phase != Phase.NONE).all()
        bent = planar.Sweep(**{name: column[1:] for name, column in vars(swept).items()})  # without touch-down
        assert (bent.m0z > 0).all()
        slope, kappa = integrated(bent)
        # the moment vanishes at the contact and nowhere before
        assert (kappa[:, :-1] < 0).all(), contour
        assert np.abs(kappa[:, -1]).max() < 1e-9 * (1 + bent.m0z.max())
        tip = bent.phase == Phase.TIP
        rise = (slope[:, -1] - bent.slope)[tip]
        assert (rise > -1e-9).all(), contour
        assert (rise < np.pi).all(), contour
        tips += len(rise)
    assert tips > 100


class InflectedRods(NamedTuple):
    """Rods (n,) with s1 = 1 whose curvature vanishes once before the tip."""

    alpha: np.ndarray
    f: np.ndarray
    m0z: np.ndarray
    inflection: np.ndarray
    """arc length at which the curvature vanishes"""
    tip_slope: np.ndarray

    def reconstruct(self, side=1):
        f0x, f0y = -self.f * np.sin(self.alpha), self.f * np.cos(self.alpha)
        return planar.reconstruct(np.zeros_like(self.f), f0x, f0y, side * self.m0z)


@pytest.fixture(scope="module")
def inflected_rods():
    rng = np.random.default_rng(61)
    alpha = rng.uniform(-1.2, 2.4, 300)
    q = np.cos(alpha / 2) * rng.uniform(0.05, 0.95, 300)
    # with f = 1, integrated past the first zero of κ to the second, where the rod ends
    length, fractions = 25.0, np.linspace(0.0, 1.0, 20_001)
    _, _, phi, kappa = shooting.integrate(np.zeros(300), 1.0, alpha, -2 * q, length, fractions)
    first, second, tip_slope = np.full((3, 300), np.nan)
    for i in range(300):
        zeros = np.flatnonzero(kappa[i, :-1] * kappa[i, 1:] <= 0)
        if len(zeros) > 1:
            at = fractions[zeros] + np.diff(fractions)[0] * kappa[i, zeros] / (kappa[i, zeros] - kappa[i, zeros + 1])
            (first[i], second[i]), tip_slope[i] = length * at[:2], np.interp(at[1], fractions, phi[i])
    rods = InflectedRods(alpha, second**2, 2 * q * second, first / second, tip_slope)
    has_two_zeros = np.isfinite(second)
    assert has_two_zeros.sum() > 250
    return InflectedRods(*(column[has_two_zeros] for column in rods))


@pytest.mark.slow
def test_inflected_rods_are_solutions_of_the_equations(inflected_rods):
    alpha, f, m0z, inflection, tip_slope = inflected_rods
    fractions = np.linspace(0, 1, 101)
    _, _, phi, kappa = shooting.integrate(np.zeros_like(f), f, alpha, -m0z, 1.0, fractions)
    assert (np.abs(kappa[:, -1]) < 1e-4 * np.abs(kappa).max(axis=1)).all()  # no moment at the tip (6)
    assert np.abs(phi[:, -1] - tip_slope).max() < 1e-4
    before, after = fractions < inflection[:, None] - 0.01, fractions > inflection[:, None] + 0.01
    assert (kappa[before] < 0).all()
    assert (kappa[:, :-1][after[:, :-1]] > 0).all()


def test_reconstruction_rejects_all_that_an_object_could_push(inflected_rods):
    # α̃ = α - ζ < φ1 < α̃ + π: an object can push the tip for some friction angle ζ >= 0 if and only if φ1 < α + π
    pushed = inflected_rods.tip_slope < inflected_rods.alpha + np.pi - 1e-6
    contacts = inflected_rods.reconstruct()
    assert 50 < pushed.sum() < len(pushed) - 50
    assert (contacts.status[pushed] == Status.INFLECTION).all()
    assert (contacts.phase[pushed] == Phase.NONE).all()
    assert np.isnan(contacts.point[pushed]).all()
    assert np.isnan(contacts.s1[pushed]).all()


def test_inflected_rods_are_not_mistaken_for_tip_contacts(inflected_rods):
    # Rods that cannot be pushed are not equilibria with any object; the first zero of their curvature is the contact point
    # of a tangential contact with the same reactions.
    contacts = inflected_rods.reconstruct()
    assert (contacts.phase != Phase.TIP).all()
    tangential = contacts.phase == Phase.TANGENTIAL
    assert np.abs(contacts.s1 - inflected_rods.inflection)[tangential].max() < 1e-5


def test_reconstruction_rejects_rods_bent_against_the_sweep(inflected_rods):
    contacts = inflected_rods.reconstruct(side=-1)
    assert (contacts.status == Status.WRONG_SIDE).all()
    assert np.isnan(contacts.point).all()
