"""Rods with an inflection between clamp and contact: solutions of the same equations that do not occur in sweeps.

A tip contact has further solutions, on which the curvature vanishes inside the rod before it does at the tip.  They are
computed here by the differential equations (3): integrated beyond the first zero of the curvature to the second, a rod of that
length carries no moment at its tip either.  The sweep is restricted to ``κ < 0`` on ``[0, s1)``, which `test_sweeping` asks of
its rods, and the reconstruction, which stops at the first zero, must not mistake them for tangential contacts.

The object can only push the rod: ``α̃ < φ1 < α̃ + π`` at the tip.  For a tip beyond one inflection this means ``β < -ζ``, so
that the sign of ``β`` distinguishes these rods.
"""

from typing import NamedTuple

import numpy as np
import pytest
import shooting

import planar
from planar import Phase, Status


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
