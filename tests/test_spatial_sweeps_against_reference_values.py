"""Sweeps in space have the reference values of a prototype in plain numpy, to all digits given.

Ellipsoid with the semi-axes (0.9, 0.675, 0.45) about (0, 1.075, 0), base at (x0, 0, 0.1125) moving in -x from 0.92.
Columns: x0; contact; s1; support reaction; moment's x and z.  With friction the values are extrapolated to step 0.
"""

import numpy as np
import pytest
from rods_in_space import FRICTION_03, FRICTIONLESS, table

from scan3d.spatial.bodies import Ellipsoid
from scan3d.spatial.sweeping import sweep

BODY = Ellipsoid((0.9, 0.675, 0.45), (0.0, 1.075, 0.0))


def columns(base, friction, substeps):
    """Base positions with contacts and reactions (n, 10) of the sweep at z = 0.1125, in the order of the tables."""
    position = np.stack([base, 0 * base, 0 * base + 0.1125], axis=1)[None]
    swept = sweep(BODY, position, np.eye(3)[None], friction, substeps=substeps)
    parts = (base[:, None], swept.point[0], swept.s1[0][:, None], swept.force[0], swept.moment[0][:, [0, 2]])
    return np.concatenate(parts, axis=1)


def rows_at(found, base):
    return found[np.abs(found[:, :1] - base).argmin(axis=0)]


def test_without_friction():
    found = columns(np.linspace(0.92, -0.92, 93), 0.0, 1)
    expected = table(FRICTIONLESS)
    assert np.abs(rows_at(found, expected[:, 0]) - expected).max() < 0.51e-7
    # symmetric in x0
    mirrored = rows_at(found, -expected[:, 0])
    signs = np.array([-1, -1, 1, 1, 1, -1, 1, 1, 1, -1])
    assert np.abs(mirrored * signs - expected).max() < 0.51e-7


@pytest.mark.slow
def test_with_friction_extrapolated_to_step_zero():
    """Steps of 1/150 to 1/1200 as the prototype's; two extrapolations, because the error is h and then h²."""
    expected, base = table(FRICTION_03), np.linspace(0.92, -0.10, 154)
    one, two, four, eight = (rows_at(columns(base, 0.3, n), expected[:, 0]) for n in (1, 2, 4, 8))
    first = [2 * b - a for a, b in ((one, two), (two, four), (four, eight))]
    second = [(4 * b - a) / 3 for a, b in zip(first[:-1], first[1:], strict=True)]
    assert np.abs(second[1] - second[0]).max() < 1e-6
    assert np.abs(second[1] - expected).max() < 1.5e-6


@pytest.mark.slow
def test_friction_is_of_first_order_in_the_step():
    base = np.linspace(0.92, -0.10, 52)
    found = [columns(base, 0.3, n)[10:] for n in (1, 2, 4, 8)]
    steps = [np.abs(b - a).max() for a, b in zip(found[:-1], found[1:], strict=True)]
    ratios = np.array(steps[:-1]) / steps[1:]
    assert (np.abs(np.log2(ratios) - 1) < 0.1).all(), ratios
