"""From the quantities of a calibration to the errors of the rig that a corrected recording keeps (`scan3d.rigs`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from scan3d.arrays import Array
from scan3d.frames import turn_of
from scan3d.rigs import RIG_QUANTITIES, RigUncertainty

if TYPE_CHECKING:
    from scan3d.laboratory.calibration_result import Calibration

_DEGREE = np.pi / 180
_STIFFNESS, _LENGTH, _CLAMP, _CLAMP_TURN, _SENSOR, _SENSOR_TURN = 0, 1, 2, 5, 8, 11
# The quantities of a calibration that change contacts, in three axes.
QUANTITIES = (
    "bending_stiffness_Nm2",
    "length_m",
    *(f"clamp_{axis}_mm" for axis in "xyz"),
    *(f"clamp_turn_{axis}_deg" for axis in "xz"),
    *(f"sensor_{axis}_mm" for axis in "xyz"),
    *(f"sensor_turn_{axis}_deg" for axis in "xyz"),
)


def rig_uncertainty(rig: Calibration) -> RigUncertainty:
    """The covariance of the errors that remain in a recording corrected by a calibration, to the first order.

    Tare and drift are left out, because an import finds them again, and so is the place of the reference.  Quantities without
    an uncertainty stay at nominal values, which are taken as exact; a rig by hand states none.
    """
    chosen = [k for k, name in enumerate(rig.names) if name in QUANTITIES]
    known = [k for k in chosen if np.isfinite(rig.standard_deviations[k])]
    exact = tuple(rig.names[k] for k in chosen if k not in known) if chosen else QUANTITIES
    slopes = _slopes(rig)[:, [QUANTITIES.index(rig.names[k]) for k in known]]
    covariance = slopes @ rig.covariance[np.ix_(known, known)] @ slopes.T
    uncertain = np.flatnonzero(np.diag(covariance) > 0)
    covariance = covariance[np.ix_(uncertain, uncertain)]
    return RigUncertainty(tuple(RIG_QUANTITIES[k] for k in uncertain), (covariance + covariance.T) / 2, exact)


def _slopes(rig: Calibration) -> Array:
    """(14, 13) derivatives of `RIG_QUANTITIES` by `QUANTITIES`."""
    slopes = np.zeros((len(RIG_QUANTITIES), len(QUANTITIES)))
    slopes[_STIFFNESS, 0] = 1 / rig.rod.bending_stiffness_Nm2
    slopes[_LENGTH, 1] = 1 / rig.rod.length_m
    to_clamp = turn_of(rig.clamp_euler_deg).T
    slopes[_CLAMP:_CLAMP_TURN, 2:5] = to_clamp / 1000
    slopes[_CLAMP_TURN:_SENSOR, 5:7] = (to_clamp @ _axes(rig.clamp_euler_deg) * _DEGREE)[:, [0, 2]]
    slopes[_SENSOR:_SENSOR_TURN, 7:10] = np.eye(3) / 1000
    turns = _axes(rig.sensor_euler_deg) * _DEGREE
    slopes[_SENSOR_TURN:, 10:] = turns
    # a turn about the sensor's origin is one about the clamp's, and moves the sensor
    slopes[_SENSOR:_SENSOR_TURN, 10:] = -np.cross(turns.T, rig.sensor_position_m).T
    return slopes


def _axes(euler_deg: Array) -> Array:
    """(3, 3) the axes, as columns and in the outer frame, about which the three angles of fixed axes turn."""
    _, y, z = euler_deg
    return np.column_stack(
        [turn_of(np.array([0.0, y, z]))[:, 0], turn_of(np.array([0.0, 0.0, z]))[:, 1], [0.0, 0.0, 1.0]]
    )
