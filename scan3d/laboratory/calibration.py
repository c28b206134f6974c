"""Calibration of a rig by touches of a reference: the rod, its clamp and its sensor, with their uncertainties.

The estimate is that of `calibration_fit`, from the equations of `calibration_model`.  Friction does not appear in them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from scan3d.arrays import Array, Mask
from scan3d.choices import TARES
from scan3d.errors import InputError
from scan3d.laboratory import calibration_words as words
from scan3d.laboratory.calibration_body import Body
from scan3d.laboratory.calibration_checks import Fitted
from scan3d.laboratory.calibration_fit import Adjusted, Noise, Problem, adjusted, information, started
from scan3d.laboratory.calibration_measured import FEWEST, Measured, by_parameter, measured
from scan3d.laboratory.calibration_model import (
    CENTRE,
    CLAMP,
    LENGTH,
    SENSOR,
    SPIN,
    STIFFNESS,
    TARE,
    TILT,
    TURN,
    Kind,
    Rig,
    bent,
    clamp_wrench,
    placed,
)
from scan3d.laboratory.calibration_reference import Flat, Reference, Spherical
from scan3d.laboratory.calibration_result import Calibration, of_fit
from scan3d.laboratory.calibration_rows import far_kinds, kinds, likelier_kinds
from scan3d.laboratory.calibration_start import first_rig
from scan3d.recording import Recording
from scan3d.units import UNITS_M

if TYPE_CHECKING:
    import trimesh

# Standard deviation of a contact's place along the rod, over the reference's size, up to which a row is used.  Larger, the
# reference curves within the errors of a row, and the linearised equations bias the result; smaller, rows are lost.
_ALONG = 0.12
# Which of several parameters that are determined only together stays at its nominal value: the one with the largest number.
# The reference's place and the tare have no nominal value.
_FIXED_FIRST = {STIFFNESS: 0.5, CLAMP: 1.0, TILT: 0.9, TURN: 0.6, SENSOR: 0.8, LENGTH: 1.0, TARE: 0.0}
# Standard deviation of the sensor's turn about the rod, in radians, from which it is not determined.  Without friction the
# contacts' distance from the sphere depends on it to the second order only, and linear uncertainties do not hold.
_ABOUT_ROD = 0.01
# Smallest eigenvalue of the normal matrix over its largest that is not rounding, and the least part of a parameter in it.
_ROUNDING, _PART = 1e-12, 1e-3
# Part of the rows whose contacts must be used, and the largest logarithm of the stiffness over the nominal one.
_USABLE, _STIFFEST = 0.3, 2.5
# Rounds in which the kinds of contacts come to rest, and in which the noise of the poses is estimated.
_ROUNDS, _NOISE_ROUNDS = 6, 3
# Rows in contact by which the fit is begun; all are used at its end.
_MANY = 10_000
# Relative error of the estimated noise of the poses.
_PLACE_STEP = 1e-3
# Noise of the poses in rod lengths: the first estimate, the bounds of the estimate, and the misfit beyond which the touches are
# not those of this reference.
_PLACE, _PLACE_BOUNDS, _NO_FIT = 3e-4, (1e-9, 0.3), 0.01


def calibrate(
    recording: Recording,
    reference: float | Literal["plane"] | trimesh.Trimesh | None = None,
    *,
    sphere: float | None = None,
    unit: str = "mm",
    tare: str = "auto",
    pose_noise_m: float | None = None,
) -> Calibration:
    """The rig that has touched a reference, which was at a place and in a pose that need not be known.

    reference
        the diameter of a sphere in m, ``"plane"``, or the `trimesh.Trimesh` of a closed and convex body.
    sphere
        the diameter of a sphere, in the place of `reference`.
    unit
        what the coordinates of the mesh mean.
    tare
        what the sensor shows in the air: ``constant``, ``linear`` (drifts steadily over the recording), ``sweep`` (a value
        for each sweep), or ``auto``: linear if the rows in the air allow it, else sweep.
    pose_noise_m
        standard deviation of each coordinate of the recorded clamps; None takes the recording's, or estimates it.

    The recording has six axes, or three for a rod in a plane past a sphere, and the nominal rod; reactions are those of the
    sensor, neither tared nor turned.  Raises InputError for impossible arguments and for touches that do not determine the rig.
    """
    if tare not in TARES:
        raise InputError(f"tare must be one of {', '.join(TARES)}, got {tare!r}")
    if pose_noise_m is not None and not 0 <= pose_noise_m < math.inf:
        raise InputError(f"the noise of the poses must be a number of metres >= 0, got {pose_noise_m!r}")
    if reference is not None and sphere is not None:
        raise InputError("give either a reference or the diameter of a sphere")
    if pose_noise_m is None and recording.noise_pose_m:
        pose_noise_m = recording.noise_pose_m
    touched = _touched(sphere if reference is None else reference, unit, recording)
    place = None if pose_noise_m is None else pose_noise_m / recording.rod.length_m
    return _fitted(measured(recording, touched, tare), place, recording)


def _touched(given: object, unit: str, recording: Recording) -> Reference:
    """The reference that was given."""
    if isinstance(given, str) and given == Flat.kind:
        return Flat(recording.rod)
    if isinstance(given, (int, float)):
        return Spherical(given, recording.rod)
    if unit not in UNITS_M:
        raise InputError(f"unit must be one of {', '.join(UNITS_M)}, got {unit!r}")
    if hasattr(given, "vertices"):
        return Body(given, unit, recording.rod)
    raise InputError(
        f"the reference sphere needs a diameter above 0, got {given!r}; other references are {Flat.kind!r} and the "
        "trimesh.Trimesh of a convex body"
    )


def _fitted(measured: Measured, place: float | None, recording: Recording) -> Calibration:
    """The calibration; `place` is the noise of the poses in rod lengths, None to estimate it."""
    step = max(1, len(measured.rows) // _MANY)
    few = measured.thinned(step) if step > 1 else measured
    problem, fit, noise = _first_fit(few, place, step)
    settled = _settled(few, problem, fit, noise, place is None, (_ROUNDS, _NOISE_ROUNDS))
    if step > 1:  # the fit of some rows is near that of all
        settled = _settled(measured, settled.problem, settled.fit, settled.noise, place is None, (0, 1))
    _check(settled.fit, settled.problem, settled.noise, recording)
    fit = settled.fit
    if not settled.problem.free[LENGTH]:  # the contacts at the tip may have turned out to be none
        fit = fit._replace(rig=replace(fit.rig, length=measured.nominal.length))
    fitted = Fitted(
        fit,
        settled.problem,
        settled.noise,
        measured.unloaded,
        measured.world,
        measured.rows[settled.chosen],
        measured.sweep[settled.chosen],
        measured.colours,
        place is None,
    )
    return of_fit(fitted, recording)


def _first_fit(measured: Measured, place: float | None, step: int) -> tuple[Problem, Adjusted, Noise]:
    """The fit of rows that they themselves choose, `step` times as few as there are, and the parameters that all determine."""
    nominal, sweep = measured.nominal, measured.sweep
    noise = Noise(
        measured.unloaded.force_noise,
        measured.unloaded.moment_noise,
        max(_PLACE if place is None else place, _PLACE_BOUNDS[0]),
    )
    first = first_rig(measured.problem, nominal, noise)
    strong = _strong(measured.problem, first, noise)
    if strong.sum() < FEWEST:
        raise _too_light(measured.problem.reference, int(strong.sum()))
    problem = replace(measured.problem, touches=measured.problem.touches.rows(strong))
    sweep = sweep[strong]
    first = _refined(problem, sweep, first, noise)
    kind, length = kinds(problem, sweep, first, noise)
    problem = _with_kinds(problem, kind, length, measured.problem.free, first)
    first = first if length is None else replace(first, length=length)
    free = _determined(problem, step * information(problem, first, noise))
    if (free != problem.free).any():
        problem = replace(problem, free=free)
        first = started(problem, _at_nominal(first, nominal, problem), noise)[0]
    return problem, adjusted(problem, first, noise), noise


class _Settled(NamedTuple):
    problem: Problem
    fit: Adjusted
    noise: Noise
    chosen: Mask
    """(n,) which rows in contact were used."""


def _settled(
    measured: Measured, problem: Problem, fit: Adjusted, noise: Noise, estimate: bool, rounds: tuple[int, int]
) -> _Settled:
    """The fit of the rows that their neighbours choose, with the kinds of contacts and the noise of the poses at rest."""
    free = problem.free
    problem, chosen, fit = _chosen_by_neighbours(measured, problem, fit, noise)
    sweep = measured.sweep[chosen]
    for _ in range(rounds[0] if problem.free[LENGTH] else 0):
        before, problem = problem.touches.kind, _with_likelier_kinds(problem, sweep, fit.rig, noise, free)
        fit = adjusted(problem, fit.rig, noise)
        if (problem.touches.kind == before).all():
            break
    for _ in range(rounds[1] if estimate else 0):
        noise = noise._replace(place=_place_noise(fit, problem, noise))
        if problem.reference.abrupt and problem.free[LENGTH] and rounds[0]:
            problem = _with_likelier_kinds(problem, sweep, fit.rig, noise, free)
        fit = adjusted(problem, fit.rig, noise)
    return _Settled(problem, fit, noise, chosen)


def _refined(problem: Problem, sweep: NDArray[np.int64], rig: Rig, noise: Noise) -> Rig:
    """The rig by the contacts that are certainly not at the tip, if there are many; it tells the kinds of the others."""
    kind = far_kinds(problem, sweep, rig, noise)
    if (kind == Kind.TANGENTIAL).sum() < max(FEWEST, _USABLE * len(kind)):
        return rig
    fit = adjusted(_with_kinds(problem, kind, None, problem.free, rig), rig, noise)
    return fit.rig if fit.at_rest and abs(fit.rig.stiffness) < _STIFFEST else rig


def _with_kinds(problem: Problem, kind: NDArray[np.int8], length: float | None, free: Mask, rig: Rig) -> Problem:
    """The problem with the kinds (n,) of its contacts for a rig; without tip contacts the free length is not sought."""
    kind = placed(rig, problem.touches, problem.reference, kind)
    free = free.copy()
    free[LENGTH] &= length is not None
    return replace(problem, touches=problem.touches._replace(kind=kind), free=free)


def _with_likelier_kinds(problem: Problem, sweep: NDArray[np.int64], rig: Rig, noise: Noise, free: Mask) -> Problem:
    """The problem with the kinds of contacts that their neighbours make likelier."""
    kind = likelier_kinds(problem, sweep, rig, noise)
    return _with_kinds(problem, kind, rig.length if (kind == Kind.TIP).any() else None, free, rig)


def _chosen_by_neighbours(
    measured: Measured, problem: Problem, fit: Adjusted, noise: Noise
) -> tuple[Problem, Mask, Adjusted]:
    """The problem of the rows that their neighbours choose for a fitted rig, which these are, and its fit."""
    around = replace(measured.problem, touches=measured.problem.touches._replace(wrench=measured.around))
    strong = _strong(around, fit.rig, noise)
    if strong.sum() < FEWEST:
        raise _too_light(problem.reference, int(strong.sum()))
    sweep = measured.sweep[strong]
    chosen = replace(problem, touches=measured.problem.touches.rows(strong), air=measured.problem.air)
    if problem.free[LENGTH]:
        kind = likelier_kinds(chosen, sweep, fit.rig, noise)
    else:
        kind = kinds(chosen, sweep, fit.rig, noise)[0]
        kind[kind == Kind.TIP] = Kind.UNSURE
    kind = placed(fit.rig, chosen.touches, chosen.reference, kind)
    chosen = replace(chosen, touches=chosen.touches._replace(kind=kind))
    return chosen, strong, adjusted(chosen, fit.rig, noise)


def _strong(problem: Problem, rig: Rig, noise: Noise) -> Mask:
    """Rows (n,) whose contacts are known well enough along the rod."""
    scale = np.exp(-rig.stiffness)
    force, moment = clamp_wrench(rig, problem.touches)
    by_s1 = scale * bent(scale * force, scale * moment).by_s1
    deviation = np.repeat([noise.force, np.hypot(noise.moment, np.linalg.norm(rig.sensor) * noise.force)], 3)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.linalg.norm(by_s1 * deviation, axis=1) < _ALONG * problem.reference.size)


def _determined(problem: Problem, normal: Array) -> Mask:
    """The parameters (p,) that a normal matrix determines; of those it determines only together, some are left out."""
    free = problem.free.copy()
    first = _FIXED_FIRST | dict(zip((CENTRE, SPIN), problem.reference.pose_order, strict=True))
    widths, order = problem.widths, by_parameter(first, len(free))
    while True:
        rows = np.flatnonzero(free)
        scaled = (normal * widths[:, None] * widths)[np.ix_(rows, rows)]
        size, vectors = np.linalg.eigh(scaled)
        if size[0] > max(1.0, _ROUNDING * size[-1]):
            break
        part = np.abs(vectors[:, 0]) * order[rows]
        if part.max() < _PART:
            raise InputError(f"the touches do not determine the {problem.reference.noun}'s place: {words.MORE_SWEEPS}")
        free[rows[np.argmax(part)]] = False
    about_rod = rows == TURN + 1
    if about_rod.any():
        variance = float(((vectors[about_rod] * widths[TURN + 1]) ** 2 / size).sum())
        free[TURN + 1] = variance < _ABOUT_ROD**2
    return free


def _at_nominal(rig: Rig, nominal: Rig, problem: Problem) -> Rig:
    """The rig with the parameters that are not determined at their nominal values."""
    free = problem.free
    return replace(
        rig,
        stiffness=rig.stiffness if free[STIFFNESS] else nominal.stiffness,
        clamp=np.where(free[CLAMP:TILT], rig.clamp, nominal.clamp),
        tilt=np.where(free[TILT:TURN], rig.tilt, nominal.tilt),
        turn=rig.turn if free[TURN:SENSOR].any() else nominal.turn,
        sensor=np.where(free[SENSOR:CENTRE], rig.sensor, nominal.sensor),
        # only a sphere has a nominal place, in the plane of all sweeps
        centre=np.where(free[CENTRE:SPIN], rig.centre, nominal.centre)
        if problem.reference.kind == "sphere"
        else rig.centre,
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


def _check(fit: Adjusted, problem: Problem, noise: Noise, recording: Recording) -> None:
    """Raise InputError for a fit that is none."""
    if noise.place > _NO_FIT:
        deviation = 1000 * noise.place * recording.rod.length_m
        raise _no_fit(problem.reference, f", from which they deviate by {deviation:.2g} mm")
    usable = fit.used[:, 2].sum() >= max(FEWEST, _USABLE * len(fit.used))
    known = np.isfinite(fit.normal).all() and (np.diag(fit.normal)[problem.free] > 0).all()
    plausible = usable and known and abs(fit.rig.stiffness) < _STIFFEST
    if plausible and not fit.at_rest and not problem.reference.smooth:
        raise InputError(
            f"the fit to {problem.reference.title} does not come to rest, because within their noise the contacts pass from "
            "facet to facet of the mesh: calibrate with a body of flat faces and sharp edges, a plane, or a sphere by its "
            "diameter"
        )
    if not (fit.at_rest and plausible):
        raise _no_fit(problem.reference, "")


def _too_light(reference: Reference, count: int) -> InputError:
    return _no_fit(
        reference,
        f", or touch it too lightly: {count} rows place the contact to {reference.extent}, and a calibration needs {FEWEST}",
    )


def _no_fit(reference: Reference, detail: str) -> InputError:
    return InputError(
        f"the touches do not fit {reference.title}{detail}: check {reference.check}, the rod, the units and signs of forces "
        f"and moments, that each sweep begins and ends in the air, and that the {reference.noun} did not move"
    )
