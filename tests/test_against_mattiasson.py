"""A rod under a dead load across it agrees with K. Mattiasson, "Numerical results from large deflection beam and frame
problems analysed by means of elliptic integrals", Int. J. Numer. Meth. Eng. 17 (1981) 145-153.

The load keeps its direction across the undeformed rod, ``α = π/2``, and acts at the tip, ``s1 = 1``.  The table has five
decimals; half a unit of the last one is the tolerance.
"""

import numpy as np
import pytest
from scipy.optimize import brentq

import planar
from planar.elastica import bend

HALF_A_DIGIT = 0.5e-5 * (1 + 1e-6)

# P L²/EI, deflection w/L across the rod, u/L along it
TABLE = [(1, 0.30172, 0.05643), (2, 0.49346, 0.16064), (5, 0.71379, 0.38763), (10, 0.81061, 0.55500)]
TIP_ANGLE = {1: 0.46135}


def bend_under(load):
    """The rod's q = m0z / (2 √f) and its shape, by the root of f = P L²/EI."""

    def shape(q):
        return bend(np.array([np.pi / 2]), np.array([q]))

    q = brentq(lambda q: shape(q).length[0] ** 2 - load, 1e-3, np.sqrt(0.5) - 1e-9, xtol=1e-15)
    return q, shape(q)


@pytest.mark.parametrize(("load", "across", "along"), TABLE)
def test_deflection(load, across, along):
    _, shape = bend_under(load)
    assert abs(shape.x[0] / shape.length[0] - across) <= HALF_A_DIGIT
    assert abs(1 - shape.y[0] / shape.length[0] - along) <= HALF_A_DIGIT


@pytest.mark.parametrize(("load", "across", "along"), TABLE)
@pytest.mark.parametrize("method", ["closed-form", "scholz-rahn"])
def test_reconstruction_from_the_load(load, across, along, method):
    q, _ = bend_under(load)
    contacts = planar.reconstruct([0.0], [-load], [0.0], [2 * q * np.sqrt(load)], method)
    assert abs(contacts.s1[0] - 1) < 1e-8
    assert np.abs(contacts.point[0] - (across, 1 - along)).max() <= HALF_A_DIGIT
    if load in TIP_ANGLE:
        # π/2 - φ1 = π/2 - α + β (12)
        assert abs(contacts.friction_angle_bound[0] - TIP_ANGLE[load]) <= HALF_A_DIGIT


def test_the_root_of_the_moment_balance():
    # the clamp holds the load at its lever arm, the height of the tip: an equation that the closed form does not use
    for load, _, along in TABLE:
        q, _ = bend_under(load)
        assert abs(2 * q * np.sqrt(load) / load - (1 - along)) <= HALF_A_DIGIT
