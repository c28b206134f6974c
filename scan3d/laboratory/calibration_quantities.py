"""The quantities of a calibration in their units, and when they count as well determined."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array
from scan3d.frames import euler_of
from scan3d.laboratory.calibration_body import Body
from scan3d.laboratory.calibration_fit import Noise, Problem
from scan3d.laboratory.calibration_model import CENTRE, CLAMP, LENGTH, SENSOR, SPIN, STIFFNESS, TARE, TILT, TURN, Rig
from scan3d.laboratory.calibration_reference import Flat, Reference
from scan3d.rods import Rod

COVERAGE_FACTOR = 2.0
"""Of expanded uncertainties: about 95 % of the errors of a normal distribution."""
CHANNELS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
# Expanded uncertainties up to which a quantity counts as well determined: relative for the stiffness, in rod lengths, in
# degrees, and for the tare in standard deviations of the noise of a row.
_WELL = {"stiffness": 0.01, "length": 0.005, "turn": 0.3, "tare": 1.0}
# Step of the difference quotients of Euler angles, in radians.
_STEP = 1e-6
# Derivatives of Euler angles, in degrees, and of places, in mm, that are those of rounding.
_NOTHING = 1e-4


Rows = list[tuple[str, float, dict[int, float]]]
"""Names, values, and derivatives by the parameters, by number."""


def quantities(rig: Rig, nominal: Rod, model: str, reference: Reference, world: Array) -> Rows:
    """The quantities of a rig that has touched a reference."""
    k = rig.tare.shape[1]
    stiffness, mm, degrees = (
        nominal.bending_stiffness_Nm2 * float(np.exp(rig.stiffness)),
        1000 * nominal.length_m,
        180 / np.pi,
    )
    slopes, angles = _euler_slopes(rig.turn), euler_of(rig.turn)
    rows: Rows = [
        ("bending_stiffness_Nm2", stiffness, {STIFFNESS: stiffness}),
        ("length_m", nominal.length_m * rig.length, {LENGTH: nominal.length_m}),
    ]
    rows += [(f"clamp_{axis}_mm", mm * rig.clamp[j], {CLAMP + j: mm}) for j, axis in enumerate("xyz")]
    rows += [(f"clamp_turn_{axis}_deg", degrees * rig.tilt[j], {TILT + j: degrees}) for j, axis in enumerate("xz")]
    rows += [(f"sensor_{axis}_mm", mm * rig.sensor[j], {SENSOR + j: mm}) for j, axis in enumerate("xyz")]
    rows += [
        (
            f"sensor_turn_{axis}_deg",
            angles[j],
            {TURN + i: slopes[j, i] for i in range(3) if abs(slopes[j, i]) > _NOTHING},
        )
        for j, axis in enumerate("xyz")
    ]
    rows += _of_reference(rig, mm, reference, world)
    units = np.repeat([nominal.force_unit_N, nominal.moment_unit_Nm], 3)
    for j, (name, unit) in enumerate(zip(CHANNELS, units, strict=True)):
        numbers = range(TARE + j * k, TARE + (j + 1) * k)
        if model == "sweep":
            rows.append((f"tare_{name}", unit * rig.tare[j].mean(), dict.fromkeys(numbers, unit / k)))
        else:
            titles = ("tare", "drift")[:k]
            rows += [(f"{title}_{name}", unit * rig.tare[j, i], {numbers[i]: unit}) for i, title in enumerate(titles)]
    return rows


def _of_reference(rig: Rig, mm: float, reference: Reference, world: Array) -> Rows:
    """Where the reference is; `mm` is the rod's length in mm, `world` (3, 3) from the world to the frame of the equations."""
    if isinstance(reference, Flat):
        normal = rig.axes[:, 2]
        by_turn = np.column_stack([-rig.axes[:, 1], rig.axes[:, 0]])
        rows: Rows = [
            (f"plane_normal_{axis}", float(normal[j]), {SPIN: by_turn[j, 0], SPIN + 1: by_turn[j, 1]})
            for j, axis in enumerate("xyz")
        ]
        lever = mm * rig.centre @ by_turn
        slopes = {CENTRE + 2: mm, SPIN: float(lever[0]), SPIN + 1: float(lever[1])}
        return [*rows, ("plane_offset_mm", mm * float(normal @ rig.centre), slopes)]
    if isinstance(reference, Body):
        turn, (x, y, z) = rig.axes, reference.middle
        by_turn = turn @ np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        place, angles, by_angle = rig.centre - turn @ reference.middle, euler_of(turn), _euler_slopes(turn) @ turn
        rows = [
            (f"mesh_{axis}_mm", mm * place[j], _by_pose(mm * turn[j], mm * by_turn[j])) for j, axis in enumerate("xyz")
        ]
        none = np.zeros(3)
        return rows + [
            (f"mesh_turn_{axis}_deg", angles[j], _by_pose(none, by_angle[j])) for j, axis in enumerate("xyz")
        ]
    centre = world.T @ rig.centre
    return [
        (f"sphere_{axis}_mm", mm * centre[j], {CENTRE + i: mm * world[i, j] for i in range(3) if world[i, j] != 0})
        for j, axis in enumerate("xyz")
    ]


def _by_pose(by_place: Array, by_turn: Array) -> dict[int, float]:
    """Derivatives (3,) by the place and the turn of a reference, by the number of the parameter, without those of rounding."""
    both = np.concatenate([by_place, by_turn])
    return {CENTRE + k: float(slope) for k, slope in enumerate(both) if abs(slope) > _NOTHING}


def measured(name: str, problem: Problem) -> bool:
    """Whether a quantity exists for the channels that were measured: a rod in a plane has fewer."""
    if problem.channels.all():
        return True
    planar = ("clamp_turn_x", "sensor_z", "sensor_turn_x", "sensor_turn_y")
    channel = name.removeprefix("tare_").removeprefix("drift_")
    return not name.startswith(planar) and (channel not in CHANNELS or bool(problem.channels[CHANNELS.index(channel)]))


def _euler_slopes(turn: Array) -> Array:
    """(3, 3) derivatives of the Euler angles in degrees by a rotation vector in the clamp's frame."""
    columns = []
    for axis in np.eye(3):
        one, other = (euler_of(Rotation.from_rotvec(sign * _STEP * axis).as_matrix() @ turn) for sign in (1, -1))
        columns.append(((one - other + 180) % 360 - 180) / (2 * _STEP))
    return np.column_stack(columns)


def limit(name: str, nominal: Rod, noise: Noise) -> float:
    """The expanded uncertainty up to which a quantity is well determined."""
    if name.startswith("bending"):
        return _WELL["stiffness"]
    if name == "length_m":
        return _WELL["length"] * nominal.length_m
    if name.endswith("_mm"):
        return _WELL["length"] * 1000 * nominal.length_m
    if name.endswith("_deg"):
        return _WELL["turn"]
    if name.startswith("plane_normal"):
        return float(np.radians(_WELL["turn"]))
    unit = nominal.force_unit_N * noise.force if name.endswith("_N") else nominal.moment_unit_Nm * noise.moment
    return _WELL["tare"] * unit
