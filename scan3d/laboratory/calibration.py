"""Calibration of a rig by touches of a reference sphere: the rod, its clamp and its sensor, with their uncertainties.

The estimate is that of `calibration_fit`, from the equations of `calibration_model`.  Friction does not appear in them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from scan3d.arrays import Array, Mask
from scan3d.choices import TARES
from scan3d.errors import InputError
from scan3d.laboratory import calibration_words as words
from scan3d.laboratory.calibration_air import Unloaded, unloaded
from scan3d.laboratory.calibration_checks import Fitted
from scan3d.laboratory.calibration_colour import Colour, colour
from scan3d.laboratory.calibration_fit import Adjusted, Air, Noise, Problem, adjusted, information, started
from scan3d.laboratory.calibration_model import (
    CENTRE,
    CLAMP,
    LENGTH,
    SENSOR,
    STIFFNESS,
    TARE,
    TILT,
    TURN,
    Kind,
    Rig,
    Touches,
    bent,
    clamp_wrench,
)
from scan3d.laboratory.calibration_result import Calibration, of_fit
from scan3d.laboratory.calibration_rows import far_kinds, kinds, likelier_kinds, neighbours
from scan3d.laboratory.calibration_start import first_rig
from scan3d.reconstruction.resolution import noise_of
from scan3d.recording import Recording

# Forces in standard deviations of their noise from which a row is used for the first estimate.
_FELT = 20.0
# Standard deviation of a contact's place along the rod, over the sphere's radius, up to which a row is used.  Larger, the
# sphere curves within the errors of a row, and the linearised equations bias the result; smaller, rows are lost.
_ALONG = 0.12
# Rows in contact that a calibration needs.
_FEWEST = 30
# Widths within which parameters are known without any touch: those that the touches leave less certain are not determined.
# Of the stiffness's logarithm, lengths in rod lengths, angles in radians, and the tare in EI/L² and EI/L.
_WIDTHS = {STIFFNESS: 0.5, CLAMP: 0.1, TILT: 0.3, TURN: 0.5, SENSOR: 0.3, CENTRE: 1.0, LENGTH: 0.1, TARE: 1.0}
# Which of several parameters that are determined only together stays at its nominal value: the one with the largest number.
# The sphere's place and the tare have no nominal value.
_FIXED_FIRST = {STIFFNESS: 0.5, CLAMP: 1.0, TILT: 0.9, TURN: 0.6, SENSOR: 0.8, CENTRE: 0.0, LENGTH: 1.0, TARE: 0.0}
# Spread of the planes of planar sweeps, over the sphere's radius, up to which they count as one plane through the centre.
_PLANE = 0.1
# Standard deviation of the sensor's turn about the rod, in radians, from which it is not determined.  Without friction the
# contacts' distance from the sphere depends on it to the second order only, and linear uncertainties do not hold.
_ABOUT_ROD = 0.01
# Smallest eigenvalue of the normal matrix over its largest that is not rounding, and the least part of a parameter in it.
_ROUNDING, _PART = 1e-12, 1e-3
# Part of the rows whose contacts must be used, and the largest logarithm of the stiffness over the nominal one.
_USABLE, _STIFFEST = 0.3, 2.5
# Rounds in which the kinds of contacts come to rest, and in which the noise of the poses is estimated.
_ROUNDS, _NOISE_ROUNDS = 6, 3
# Relative error of the estimated noise of the poses.
_PLACE_STEP = 1e-3
# Noise of the poses in rod lengths: the first estimate, the bounds of the estimate, and the misfit beyond which the touches are
# not those of this sphere.
_PLACE, _PLACE_BOUNDS, _NO_SPHERE = 3e-4, (1e-9, 0.3), 0.01


def calibrate(
    recording: Recording, sphere: float, *, tare: str = "auto", pose_noise_m: float | None = None
) -> Calibration:
    """The rig that has touched a reference sphere of the diameter `sphere` in m, at a place that need not be known.

    tare
        what the sensor shows in the air: ``constant``, ``linear`` (drifts steadily over the recording), ``sweep`` (a value
        for each sweep), or ``auto``: linear if the rows in the air allow it, else sweep.
    pose_noise_m
        standard deviation of each coordinate of the recorded places of the clamp; None estimates it.

    The recording has six axes, or three for a rod in a plane, and the nominal rod; reactions are those of the sensor, neither
    tared nor turned.  Raises InputError for impossible arguments and for touches that do not determine the rig.
    """
    if not (isinstance(sphere, (int, float)) and math.isfinite(sphere) and sphere > 0):
        raise InputError(f"the reference sphere needs a diameter above 0, got {sphere!r}")
    if tare not in TARES:
        raise InputError(f"tare must be one of {', '.join(TARES)}, got {tare!r}")
    if pose_noise_m is not None and not 0 <= pose_noise_m < math.inf:
        raise InputError(f"the noise of the poses must be a number of metres >= 0, got {pose_noise_m!r}")
    measured = _measured(recording, sphere, tare)
    place = None if pose_noise_m is None else pose_noise_m / recording.rod.length_m
    return _fitted(measured, place, recording, sphere)


class _Measured(NamedTuple):
    problem: Problem
    sweep: NDArray[np.int64]
    """(n,) of the rows in contact."""
    rows: NDArray[np.intp]
    """(n,) their numbers in the recording."""
    colours: tuple[Colour, Colour]
    """Of the noise of force and moment."""
    around: Array
    """(n, 6) wrench of the neighbours of each row, which decides whether the row is used."""
    unloaded: Unloaded
    nominal: Rig
    world: Array
    """(3, 3) from the world to the frame of the equations."""


def _measured(recording: Recording, sphere: float, tare: str) -> _Measured:
    """The rows in contact and in the air, dimensionless."""
    rod, known = recording.rod, noise_of(recording)
    channels = np.full(6, recording.six_axis)
    if recording.six_axis:
        wrench = np.hstack(recording.wrench())
    else:
        channels[[0, 1, 5]] = True
        zero = np.zeros((len(recording), 3))
        wrench = np.column_stack([recording.force_N, zero, recording.moment_Nm])
    unit = np.repeat([rod.force_unit_N, rod.moment_unit_Nm], 3)
    wrench = wrench / unit
    noise = known.force_N / unit[0], known.moment_Nm / unit[3]
    found = unloaded(recording.sweep, wrench, channels, noise, tare)
    around = neighbours(wrench, recording.sweep, found.contact)
    force = np.linalg.norm((around - found.basis @ found.tare.T)[:, :3], axis=1)
    rows = np.flatnonzero(found.contact & (force > _FELT * found.force_noise))
    if len(rows) < _FEWEST:
        raise InputError(
            f"the recording has {len(rows)} rows in contact that stand out from the noise, and a calibration needs {_FEWEST}: "
            "touch the sphere in more sweeps, and bend the rod more"
        )
    # sweeps in a plane do not determine how far the sphere's centre is from it: the plane's normal is one of the axes
    world = np.eye(3) if recording.six_axis else recording.axes()[rows[0]]
    touches = Touches(
        wrench[rows],
        recording.position_m[rows] / rod.length_m @ world.T,
        world @ recording.axes()[rows].swapaxes(1, 2),
        found.basis[rows],
        np.full(len(rows), Kind.EITHER, dtype=np.int8),
    )
    k = found.basis.shape[1]
    free = np.ones(TARE + 6 * k, dtype=bool)
    if not recording.six_axis:
        free[[TILT, TURN, TURN + 1, SENSOR + 2]] = False
        free[TARE:] = np.repeat(channels, k)
        free[CENTRE + 2] = np.ptp(touches.position[:, 2]) > _PLANE * sphere / 2 / rod.length_m
    problem = Problem(
        touches,
        Air(wrench[found.air], found.basis[found.air], np.flatnonzero(found.air)),
        (sphere + rod.diameter_m) / 2 / rod.length_m,
        channels,
        free,
        _by_parameter(_WIDTHS, len(free)),
    )
    nominal = Rig(0.0, np.zeros(3), np.zeros(2), np.eye(3), np.zeros(3), touches.position.mean(axis=0), 1.0, found.tare)
    colours = (
        colour(wrench, found, channels, slice(0, 3), found.force_noise),
        colour(wrench, found, channels, slice(3, 6), found.moment_noise),
    )
    return _Measured(problem, recording.sweep[rows], rows, colours, around[rows], found, nominal, world)


def _fitted(measured: _Measured, place: float | None, recording: Recording, sphere: float) -> Calibration:
    """The calibration; `place` is the noise of the poses in rod lengths, None to estimate it."""
    nominal, sweep = measured.nominal, measured.sweep
    noise = Noise(
        measured.unloaded.force_noise,
        measured.unloaded.moment_noise,
        max(_PLACE if place is None else place, _PLACE_BOUNDS[0]),
    )
    first = first_rig(measured.problem, nominal, noise)
    strong = _strong(measured.problem, first, noise)
    if strong.sum() < _FEWEST:
        raise _no_sphere(
            sphere,
            f", or touch it too lightly: {strong.sum()} rows place the contact to a tenth of the sphere's radius, and a "
            f"calibration needs {_FEWEST}",
        )
    problem = replace(measured.problem, touches=measured.problem.touches.rows(strong))
    sweep = sweep[strong]
    first = _refined(problem, sweep, first, noise)
    kind, length = kinds(problem, sweep, first, noise)
    problem = _with_kinds(problem, kind, length, measured.problem.free)
    first = first if length is None else replace(first, length=length)
    free = _determined(problem, information(problem, first, noise))
    if (free != problem.free).any():
        problem = replace(problem, free=free)
        first = started(problem, _at_nominal(first, nominal, free), noise)[0]
    fit = adjusted(problem, first, noise)
    problem, chosen, fit = _chosen_by_neighbours(measured, problem, fit, noise)
    sweep = measured.sweep[chosen]
    kind = problem.touches.kind
    for _ in range(_ROUNDS if problem.free[LENGTH] else 0):
        before, kind = kind, likelier_kinds(problem, sweep, fit.rig, noise)
        problem = _with_kinds(problem, kind, fit.rig.length if (kind == Kind.TIP).any() else None, free)
        fit = adjusted(problem, fit.rig, noise)
        if (kind == before).all():
            break
    for _ in range(_NOISE_ROUNDS if place is None else 0):
        noise = noise._replace(place=_place_noise(fit, problem, noise))
        fit = adjusted(problem, fit.rig, noise)
    _check(fit, problem, noise, sphere, recording)
    fitted = Fitted(
        fit,
        problem,
        noise,
        measured.unloaded,
        measured.world,
        measured.rows[chosen],
        sweep,
        measured.colours,
        place is None,
    )
    return of_fit(fitted, recording, sphere)


def _refined(problem: Problem, sweep: NDArray[np.int64], rig: Rig, noise: Noise) -> Rig:
    """The rig by the contacts that are certainly not at the tip, if there are many; it tells the kinds of the others."""
    kind = far_kinds(problem, sweep, rig, noise)
    if (kind == Kind.TANGENTIAL).sum() < max(_FEWEST, _USABLE * len(kind)):
        return rig
    fit = adjusted(_with_kinds(problem, kind, None, problem.free), rig, noise)
    return fit.rig if fit.at_rest and abs(fit.rig.stiffness) < _STIFFEST else rig


def _with_kinds(problem: Problem, kind: NDArray[np.int8], length: float | None, free: Mask) -> Problem:
    """The problem with the kinds (n,) of its contacts; without tip contacts the free length is not sought."""
    free = free.copy()
    free[LENGTH] &= length is not None
    return replace(problem, touches=problem.touches._replace(kind=kind), free=free)


def _chosen_by_neighbours(
    measured: _Measured, problem: Problem, fit: Adjusted, noise: Noise
) -> tuple[Problem, Mask, Adjusted]:
    """The problem of the rows that their neighbours choose for a fitted rig, which these are, and its fit."""
    around = replace(measured.problem, touches=measured.problem.touches._replace(wrench=measured.around))
    strong = _strong(around, fit.rig, noise)
    sweep = measured.sweep[strong]
    chosen = replace(problem, touches=measured.problem.touches.rows(strong))
    if problem.free[LENGTH]:
        kind = likelier_kinds(chosen, sweep, fit.rig, noise)
    else:
        kind = kinds(chosen, sweep, fit.rig, noise)[0]
        kind[kind == Kind.TIP] = Kind.UNSURE
    chosen = replace(chosen, touches=chosen.touches._replace(kind=kind))
    return chosen, strong, adjusted(chosen, fit.rig, noise)


def _strong(problem: Problem, rig: Rig, noise: Noise) -> Mask:
    """Rows (n,) whose contacts are known well enough along the rod."""
    scale = np.exp(-rig.stiffness)
    force, moment = clamp_wrench(rig, problem.touches)
    by_s1 = scale * bent(scale * force, scale * moment).by_s1
    deviation = np.repeat([noise.force, np.hypot(noise.moment, np.linalg.norm(rig.sensor) * noise.force)], 3)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.linalg.norm(by_s1 * deviation, axis=1) < _ALONG * problem.radius)


def _by_parameter(table: dict[int, float], count: int) -> Array:
    first = np.array(sorted(table))
    return np.array([table[first[first <= number][-1]] for number in range(count)])


def _determined(problem: Problem, normal: Array) -> Mask:
    """The parameters (p,) that a normal matrix determines; of those it determines only together, some are left out."""
    free = problem.free.copy()
    widths, order = problem.widths, _by_parameter(_FIXED_FIRST, len(free))
    while True:
        rows = np.flatnonzero(free)
        scaled = (normal * widths[:, None] * widths)[np.ix_(rows, rows)]
        size, vectors = np.linalg.eigh(scaled)
        if size[0] > max(1.0, _ROUNDING * size[-1]):
            break
        part = np.abs(vectors[:, 0]) * order[rows]
        if part.max() < _PART:
            raise InputError(f"the touches do not determine the sphere's place: {words.MORE_SWEEPS}")
        free[rows[np.argmax(part)]] = False
    about_rod = rows == TURN + 1
    if about_rod.any():
        variance = float(((vectors[about_rod] * widths[TURN + 1]) ** 2 / size).sum())
        free[TURN + 1] = variance < _ABOUT_ROD**2
    return free


def _at_nominal(rig: Rig, nominal: Rig, free: Mask) -> Rig:
    """The rig with the parameters that are not determined at their nominal values."""
    return replace(
        rig,
        stiffness=rig.stiffness if free[STIFFNESS] else nominal.stiffness,
        clamp=np.where(free[CLAMP:TILT], rig.clamp, nominal.clamp),
        tilt=np.where(free[TILT:TURN], rig.tilt, nominal.tilt),
        turn=rig.turn if free[TURN:SENSOR].any() else nominal.turn,
        sensor=np.where(free[SENSOR:CENTRE], rig.sensor, nominal.sensor),
        centre=np.where(free[CENTRE:LENGTH], rig.centre, nominal.centre),
        length=rig.length if free[LENGTH] else nominal.length,
    )


def _place_noise(fit: Adjusted, problem: Problem, noise: Noise) -> float:
    """The noise of the poses with which the sum of squares of the misclosures is that of their degrees of freedom."""
    freedom = fit.used.sum() - min(int(problem.free[:TARE].sum()), int(fit.used.sum()) - 1)

    def excess(place: float) -> float:
        variances = noise._replace(place=place).variances(problem.channels)
        covariance = (fit.by_row * variances) @ fit.by_row.swapaxes(1, 2)
        covariance[:, range(4), range(4)] += ~fit.used
        solved = np.linalg.solve(covariance, fit.misclosure[:, :, None])[:, :, 0]
        return float((fit.misclosure * solved).sum()) - float(freedom)

    low, high = _PLACE_BOUNDS
    if excess(low) <= 0:
        return low
    if excess(high) >= 0:
        return high
    root = brentq(lambda logarithm: excess(math.exp(logarithm)), math.log(low), math.log(high), xtol=_PLACE_STEP)
    return math.exp(float(root))


def _check(fit: Adjusted, problem: Problem, noise: Noise, sphere: float, recording: Recording) -> None:
    """Raise InputError for a fit that is none."""
    if noise.place > _NO_SPHERE:
        deviation = 1000 * noise.place * recording.rod.length_m
        raise _no_sphere(sphere, f", from which they deviate by {deviation:.2g} mm")
    usable = fit.used[:, 2].sum() >= max(_FEWEST, _USABLE * len(fit.used))
    known = np.isfinite(fit.normal).all() and (np.diag(fit.normal)[problem.free] > 0).all()
    if not (fit.at_rest and usable and known and abs(fit.rig.stiffness) < _STIFFEST):
        raise _no_sphere(sphere, "")


def _no_sphere(sphere: float, detail: str) -> InputError:
    return InputError(
        f"the touches do not fit a sphere of {1000 * sphere:g} mm{detail}: check the diameter and its unit, the rod, the units "
        "and signs of forces and moments, that each sweep begins and ends in the air, and that the sphere did not move"
    )
