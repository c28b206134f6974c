"""The result of a calibration: quantities with their uncertainties, and recordings corrected by them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.laboratory import calibration_words as words
from scan3d.laboratory.calibration_air import Unloaded, unloaded
from scan3d.laboratory.calibration_fit import Adjusted, Noise, Problem
from scan3d.laboratory.calibration_model import CENTRE, CLAMP, LENGTH, SENSOR, STIFFNESS, TARE, TILT, TURN, Rig
from scan3d.reconstruction.resolution import noise_of
from scan3d.recording import Recording
from scan3d.rods import Rod

COVERAGE_FACTOR = 2.0
"""Of expanded uncertainties: about 95 % of the errors of a normal distribution."""
CHANNELS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
# Expanded uncertainties up to which a quantity counts as well determined: relative for the stiffness, in rod lengths, in degrees, and
# for the tare in standard deviations of the noise of a row.
_WELL = {"stiffness": 0.01, "length": 0.005, "turn": 0.3, "tare": 1.0}
# Step of the difference quotients of Euler angles, in radians.
_STEP = 1e-6
# How many standard deviations of a mean square the tests of the premises allow.
_SIGMAS = 4.0
# The turns are in the convention "xyz" of scipy's Rotation: about fixed axes, first x, then y, then z.
EULER = "xyz"


@dataclass(frozen=True)
class Calibration:
    """A rig with its uncertainties, from `scan3d.calibrate` or from a file."""

    rod: Rod
    """With the free length and the bending stiffness that were found."""
    sensor_position_m: Array
    """(3,) origin of the sensor's frame in the clamp's."""
    sensor_euler_deg: Array
    """(3,) its turn."""
    clamp_position_m: Array
    """(3,) the clamp in the frame of the recorded poses."""
    clamp_euler_deg: Array
    """(3,) its turn; that about the rod's axis is zero, because the sensor's turn contains it."""
    tare: Array
    """(6,) what the sensor shows in the air, in the middle of the recording; N and N·m."""
    drift: Array
    """(6,) its change over the recording."""
    sphere_m: Array
    """(3,) centre of the sphere in the world."""
    names: tuple[str, ...]
    """The quantities, with their units."""
    values: Array
    """(k,)"""
    standard_deviations: Array
    """(k,) infinite for quantities that were not determined and stay at their nominal values."""
    covariance: Array
    """(k, k) zero for those."""
    well: tuple[bool, ...]
    """(k,) whether a quantity is well determined."""
    sentences: tuple[str, ...]
    """What is poorly determined, and which touches would determine it; and premises that the data contradict."""
    chi2: float
    """Sum of squares of the misclosures over their variances per degree of freedom, 1 on average; with an estimated noise of the
    poses it is 1 by construction."""
    consistency: float
    """The same of the two equations that only the wrench is in."""
    freedom: int
    pose_noise_m: float
    noise_force_N: float
    noise_moment_Nm: float
    diameter_m: float
    """Of the reference sphere."""
    details: Mapping[str, Any] = field(default_factory=dict)
    """Numbers of rows, and how the tare was modelled."""

    @property
    def expanded(self) -> Array:
        """(k,) expanded uncertainties, with the coverage factor 2."""
        return COVERAGE_FACTOR * self.standard_deviations

    def applied(self, recording: Recording, tare: str = "auto") -> Recording:
        """A recording of this rig, as `calibrate` takes it, with poses and reactions of the true clamp, and the true rod.

        The tare is found in its own rows in the air; `tare` as in `calibrate`, or ``calibration`` for that of the calibration.
        Raises InputError if there are too few rows in the air.
        """
        six = recording.six_axis
        channels = np.array([True, True, six, six, six, True])
        zero = np.zeros(len(recording))
        columns = (
            np.hstack(recording.wrench())
            if six
            else np.column_stack([recording.force_N, zero, zero, zero, recording.moment_Nm])
        )
        known = noise_of(recording)
        if tare == "calibration":
            columns = columns - self.tare
            force_noise, moment_noise = known.force_N, known.moment_Nm
        else:
            found = unloaded(recording.sweep, columns, channels, (known.force_N, known.moment_Nm), tare)
            columns = columns - found.basis @ found.tare.T
            force_noise, moment_noise = found.force_noise, found.moment_noise
        turn = Rotation.from_euler(EULER, self.sensor_euler_deg, degrees=True).as_matrix()
        force = columns[:, :3] @ turn.T
        moment = columns[:, 3:] @ turn.T + np.cross(self.sensor_position_m, force)
        pose = Rotation.from_quat(recording.quaternion, scalar_first=True)
        clamp = Rotation.from_euler(EULER, self.clamp_euler_deg, degrees=True)
        # the mean over the components of the variance that the lever adds
        lever = float(self.sensor_position_m @ self.sensor_position_m) * 2 / 3
        return dataclasses.replace(
            recording,
            position_m=recording.position_m + pose.apply(self.clamp_position_m),
            quaternion=(pose * clamp).as_quat(scalar_first=True),
            force_N=force[:, :2],
            moment_Nm=moment[:, 2],
            force_z_N=force[:, 2] if six else None,
            moment_x_Nm=moment[:, 0] if six else None,
            moment_y_Nm=moment[:, 1] if six else None,
            rod=self.rod,
            noise_force_N=force_noise,
            noise_moment_Nm=float(np.sqrt(moment_noise**2 + lever * force_noise**2)),
            source={**recording.source, "calibrated": True},
        )


def of_fit(
    fit: Adjusted,
    problem: Problem,
    noise: Noise,
    air: Unloaded,
    recording: Recording,
    sphere: float,
    estimated: bool,
) -> Calibration:
    """The calibration of a fitted rig."""
    nominal, rig = recording.rod, fit.rig
    length = nominal.length_m * rig.length
    free = np.flatnonzero(problem.free)
    covariance = np.zeros_like(fit.normal)
    scale = 1 / np.sqrt(np.diag(fit.normal)[free])
    inner = np.linalg.inv(fit.normal[np.ix_(free, free)] * scale[:, None] * scale)
    covariance[np.ix_(free, free)] = inner * scale[:, None] * scale
    names, values, jacobian, parameters = _quantities(rig, nominal, air.model)
    covariance = jacobian @ covariance @ jacobian.T
    known = np.array([problem.free[numbers].all() for numbers in parameters])
    measured = np.array([_measured(name, problem) for name in names])
    names = tuple(name for name, kept in zip(names, measured, strict=True) if kept)
    values, known, covariance = values[measured], known[measured], covariance[np.ix_(measured, measured)]
    covariance[~known] = covariance[:, ~known] = 0
    deviations = np.where(known, np.sqrt(np.maximum(np.diag(covariance), 0)), np.inf)
    limits = np.array([_limit(name, nominal, noise) for name in names])
    relative = np.where([name.startswith("bending") for name in names], np.abs(values), 1.0)
    well = COVERAGE_FACTOR * deviations <= limits * relative
    freedom = int(fit.used.sum()) + fit.air_residual.shape[0] * int(problem.channels.sum()) - len(free)
    chi2, consistency, count = _squares(fit, problem, noise, air)
    poor = [
        (name, f"{COVERAGE_FACTOR * deviation:.2g}")
        for name, deviation, good, is_known in zip(names, deviations, well, known, strict=True)
        if is_known and not good
    ]
    fixed = [name for name, is_known in zip(names, known, strict=True) if not is_known]
    air_freedom = max(fit.air_residual.size, 1)
    told = words.premises(
        chi2,
        _largest(freedom) if not estimated else np.inf,
        air.misfit,
        _largest(air_freedom) + (0.0 if recording.noise_force_N and recording.noise_moment_Nm else 1.0),
        consistency,
        _largest(count),
    )
    tare = rig.tare * np.repeat([nominal.force_unit_N, nominal.moment_unit_Nm], 3)[:, None]
    return Calibration(
        rod=Rod(length, nominal.bending_stiffness_Nm2 * float(np.exp(rig.stiffness)), nominal.diameter_m),
        sensor_position_m=nominal.length_m * rig.sensor,
        sensor_euler_deg=_euler(rig.turn),
        clamp_position_m=nominal.length_m * rig.clamp,
        clamp_euler_deg=np.degrees([rig.tilt[0], 0.0, rig.tilt[1]]),
        tare=tare.mean(axis=1) if air.model == "sweep" else tare[:, 0],
        drift=tare[:, 1] if air.model == "linear" else np.ptp(tare, axis=1),
        sphere_m=nominal.length_m * rig.centre,
        names=names,
        values=values,
        standard_deviations=deviations,
        covariance=covariance,
        well=tuple(map(bool, well)),
        sentences=words.sentences(poor, fixed) + told,
        chi2=chi2,
        consistency=consistency,
        freedom=freedom,
        pose_noise_m=nominal.length_m * noise.place,
        noise_force_N=nominal.force_unit_N * noise.force,
        noise_moment_Nm=nominal.moment_unit_Nm * noise.moment,
        diameter_m=sphere,
        details={
            "contacts": len(problem.touches.kind),
            "tip_contacts": int((problem.touches.kind == 1).sum()),
            "air": len(fit.air_residual),
            "tare": air.model,
            "pose_noise": "estimated" if estimated else "given",
        },
    )


def _quantities(rig: Rig, nominal: Rod, model: str) -> tuple[tuple[str, ...], Array, Array, list[list[int]]]:
    """Names, values (k,), derivatives (k, p) by the parameters, and the parameters that each quantity depends on."""
    count, k = TARE + rig.tare.size, rig.tare.shape[1]
    rows: list[tuple[str, float, dict[int, float]]] = []
    stiffness, length_mm = nominal.bending_stiffness_Nm2 * float(np.exp(rig.stiffness)), 1000 * nominal.length_m
    rows.append(("bending_stiffness_Nm2", stiffness, {STIFFNESS: stiffness}))
    rows.append(("length_m", nominal.length_m * rig.length, {LENGTH: nominal.length_m}))
    for title, first, place in (("clamp", CLAMP, rig.clamp), ("sensor", SENSOR, rig.sensor), ("sphere", CENTRE, rig.centre)):
        rows += [(f"{title}_{axis}_mm", length_mm * place[j], {first + j: length_mm}) for j, axis in enumerate("xyz")]
        if title == "clamp":
            degrees = float(np.degrees(1.0))
            rows += [(f"clamp_turn_{axis}_deg", degrees * rig.tilt[j], {TILT + j: degrees}) for j, axis in enumerate("xz")]
        elif title == "sensor":
            slopes = _euler_slopes(rig.turn)
            angles = _euler(rig.turn)
            rows += [
                (f"sensor_turn_{axis}_deg", angles[j], {TURN + i: slopes[j, i] for i in range(3)}) for j, axis in enumerate("xyz")
            ]
    units = np.repeat([nominal.force_unit_N, nominal.moment_unit_Nm], 3)
    for j, (name, unit) in enumerate(zip(CHANNELS, units, strict=True)):
        numbers = range(TARE + j * k, TARE + (j + 1) * k)
        if model == "sweep":
            rows.append((f"tare_{name}", unit * rig.tare[j].mean(), dict.fromkeys(numbers, unit / k)))
        else:
            titles = ("tare", "drift")[:k]
            rows += [(f"{title}_{name}", unit * rig.tare[j, i], {numbers[i]: unit}) for i, title in enumerate(titles)]
    jacobian = np.zeros((len(rows), count))
    for row, (_, _, slopes_by) in enumerate(rows):
        jacobian[row, list(slopes_by)] = list(slopes_by.values())
    return tuple(row[0] for row in rows), np.array([row[1] for row in rows]), jacobian, [list(row[2]) for row in rows]


def _measured(name: str, problem: Problem) -> bool:
    """Whether a quantity exists for the channels that were measured: a rod in a plane has fewer."""
    if problem.channels.all():
        return True
    planar = ("clamp_turn_x", "sensor_z", "sensor_turn_x", "sensor_turn_y")
    channel = name.removeprefix("tare_").removeprefix("drift_")
    return not name.startswith(planar) and (channel not in CHANNELS or bool(problem.channels[CHANNELS.index(channel)]))


def _euler(turn: Array) -> Array:
    return np.asarray(Rotation.from_matrix(turn).as_euler(EULER, degrees=True))


def _euler_slopes(turn: Array) -> Array:
    """(3, 3) derivatives of the Euler angles in degrees by a rotation vector in the clamp's frame."""
    columns = []
    for axis in np.eye(3):
        one, other = (_euler(Rotation.from_rotvec(sign * _STEP * axis).as_matrix() @ turn) for sign in (1, -1))
        columns.append(((one - other + 180) % 360 - 180) / (2 * _STEP))
    return np.column_stack(columns)


def _limit(name: str, nominal: Rod, noise: Noise) -> float:
    """The expanded uncertainty up to which a quantity is well determined."""
    if name.startswith("bending"):
        return _WELL["stiffness"]
    if name == "length_m":
        return _WELL["length"] * nominal.length_m
    if name.endswith("_mm"):
        return _WELL["length"] * 1000 * nominal.length_m
    if name.endswith("_deg"):
        return _WELL["turn"]
    unit = nominal.force_unit_N * noise.force if name.endswith("_N") else nominal.moment_unit_Nm * noise.moment
    return _WELL["tare"] * unit


def _squares(fit: Adjusted, problem: Problem, noise: Noise, air: Unloaded) -> tuple[float, float, int]:
    """Mean squares of all misclosures, and of those of the wrench alone, in variances, and the number of the latter."""
    covariance = (fit.by_row * noise.variances(problem.channels)) @ fit.by_row.swapaxes(1, 2)
    covariance[:, range(4), range(4)] += ~fit.used
    solved = np.linalg.solve(covariance, fit.misclosure[:, :, None])[:, :, 0]
    deviation = np.repeat([noise.force, noise.moment], 3)
    in_air = float(((fit.air_residual / deviation)[:, problem.channels] ** 2).sum())
    freedom = int(fit.used.sum()) + fit.air_residual.shape[0] * int(problem.channels.sum()) - int(problem.free.sum())
    total = (float((fit.misclosure * solved).sum()) + in_air) / max(freedom, 1)
    used = fit.used[:, :2].all(axis=1)
    if not used.any():
        return total, 1.0, 0
    solved = np.linalg.solve(covariance[used, :2, :2], fit.misclosure[used, :2, None])[:, :, 0]
    return total, float((fit.misclosure[used, :2] * solved).sum()) / (2 * int(used.sum())), 2 * int(used.sum())


def _largest(count: int) -> float:
    """The largest mean square of `count` normal numbers that is no contradiction."""
    return 1 + _SIGMAS * float(np.sqrt(2 / max(count, 1)))
