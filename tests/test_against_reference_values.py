"""Sweeps over the paper's circle, r = 0.9 at (0, 1.3), agree with reference values.

The values were derived twice independently, by shooting on (3) with (5)-(7) and by elliptic integrals, and are given to
the digits on which both agree; half a unit of the last one is the tolerance.
"""

from typing import NamedTuple

import numpy as np
import pytest

import planar
from planar import EventKind

CIRCLE = planar.Circle(radius=0.9, center=(0.0, 1.3))


class Reference(NamedTuple):
    to_tangential_x0: float
    to_tip_x0: float
    to_tip_force: float
    to_tip_m0z: float
    snap_off_x0: float
    snap_off_slope_deg: float
    largest_m0z: float


# by coefficient of friction
TABLE = {
    0.0: Reference(0.5804765, -0.8616545, 3.691511, 2.711033, -1.2187178, -39.28, 3.250),
    0.2: Reference(0.5796126, -0.8528981, 3.499250, 2.884743, -1.2602951, -44.23, 3.386),
    0.4: Reference(0.5787763, -0.8453763, 3.471328, 3.029600, -1.2816569, -47.27, 3.504),
    0.6: Reference(0.5779661, -0.8387693, 3.557457, 3.154076, -1.2913050, -48.53, 3.609),
}


def half_a_unit(decimals):
    return 0.5 * 10.0**-decimals * (1 + 1e-6)


@pytest.mark.parametrize("friction", TABLE)
def test_events(friction):
    reference = TABLE[friction]
    events = planar.events(CIRCLE, friction)
    kinds = [EventKind.TOUCH_DOWN, EventKind.TO_TANGENTIAL, EventKind.TO_TIP, EventKind.SNAP_OFF]
    assert events.kind.tolist() == kinds
    assert abs(events.x0[0] - 0.848528) <= half_a_unit(6)
    assert abs(events.x0[0] - 0.9 * np.sqrt(8 / 9)) < 1e-12  # the circle at y = 1
    assert abs(np.degrees(events.slope[0, 1]) - 70.5288) <= half_a_unit(4)
    assert events.force[0].tolist() == [0, 0]
    expected = [reference.to_tangential_x0, reference.to_tip_x0, reference.snap_off_x0]
    assert np.abs(events.x0[1:] - expected).max() <= half_a_unit(7)
    # force and moment are continuous there
    assert np.abs(events.force[2] - reference.to_tip_force).max() <= half_a_unit(6)
    assert np.abs(events.m0z[2] - reference.to_tip_m0z).max() <= half_a_unit(6)
    assert abs(np.degrees(events.slope[-1, 0]) - reference.snap_off_slope_deg) <= half_a_unit(2)
    assert 4 < events.force[-1, 0] < 8  # the force does not vanish before the rod leaves
    assert events.force[-1, 1] == 0


@pytest.mark.parametrize("friction", TABLE)
def test_largest_moment(friction):
    swept = planar.sweep(CIRCLE, friction, samples=2000)
    assert abs(swept.m0z.max() - TABLE[friction].largest_m0z) <= half_a_unit(3)
