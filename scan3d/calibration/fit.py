"""The rig that has touched a reference, by least squares with errors in all measured values.

The equations of `model` hold between the true values of a row (the Gauss-Helmert model: Helmert, 1872; Niemeier, 2008,
chapter 5).  Linearised at adjusted values of the measurements, their misclosures have the covariance ``B Σ Bᵀ``, which makes
them white; least squares of the white misclosures and new adjusted values alternate until both are at rest.  Weights and
derivatives taken at the measured values instead would be correlated with the noise, and bias the parameters.

A first rig follows from the condition ``m0·t0 = 0`` in the sensor's frame, which is linear in the rod's direction u and in
``u × a``, with a the place of the sensor: it gives both without a body.  The turn about the rod, the distance along it and
the stiffness are then searched on a grid: with the right ones the contacts lie on the reference.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, least_squares
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, Mask
from scan3d.calibration.model import (
    CLAMP,
    LENGTH,
    PLACE,
    SENSOR,
    STIFFNESS,
    TARE,
    TILT,
    TURN,
    Kind,
    Plane,
    Reference,
    Rig,
    Sphere,
    Touches,
    bent,
    clamp_wrench,
    contacts,
    equations,
)
from scan3d.calibration.rows import Unloaded, neighbours, unloaded
from scan3d.choices import TARES
from scan3d.errors import InputError
from scan3d.recording import Recording

FEWEST = 30
"""Rows in contact that a calibration needs."""
MORE_SWEEPS = (
    "sweep it in more directions of the rod, with the clamp turned about the rod's axis, and bend the rod more"
)
# Forces in standard deviations of their noise from which a row is used, and the standard deviation of a contact's place
# along the rod, over the reference's size, up to which it is: farther off, the reference curves within the errors of a row.
_FELT, _ALONG = 20.0, 0.12
# Widths within which parameters are known without any touch: those that the touches leave less certain are not determined.
# Of the stiffness's logarithm, lengths in rod lengths, angles in radians, and the tare in EI/L² and EI/L.
_WIDTHS = {STIFFNESS: 0.5, CLAMP: 0.1, TILT: 0.3, TURN: 0.5, SENSOR: 0.3, PLACE: 1.0, LENGTH: 0.1, TARE: 1.0}
# Which of several parameters that are determined only together stays at its nominal value: the one with the largest number.
# The reference's place and the tare have no nominal value.
_FIXED_FIRST = {STIFFNESS: 0.5, CLAMP: 1.0, TILT: 0.9, TURN: 0.6, SENSOR: 0.8, PLACE: 0.0, LENGTH: 1.0, TARE: 0.0}
# Standard deviation of the sensor's turn about the rod, in radians, from which it is not determined.  Without friction the
# contacts' distance from the reference depends on it to the second order only, and linear uncertainties do not hold.
_ABOUT_ROD = 0.01
# Smallest eigenvalue of the normal matrix over its largest that is not rounding, and the least part of a parameter in it.
_ROUNDING, _PART = 1e-12, 1e-3
# Spread of the planes of planar sweeps, over the sphere's radius, up to which they count as one plane through the centre.
_PLANE = 0.1
# Rounds of adjustment and of the choice of rows, and the step in standard deviations at which the first are at rest.
_ADJUSTMENTS, _CHOICES, _SMALL = 30, 8, 1e-3
# What a row without a rod counts in standard deviations: more than rows that are far off, because rigs for which no row has
# a rod would fit best otherwise.
_NO_ROD = 100.0
# Difference of the sums of squares of both kinds from which the rows around a row make its kind certain.
_LIKELIER = 12.0
# Standard deviation of s1, in rod lengths, from which a contact shows how long the rod is, and tip contacts that are needed.
_SURE, _FEWEST_TIPS = 0.02, 8
# Standard deviations, and the cosine between tangent and normal, from which a rod points into the reference by its tip.
_INWARD, _COSINE = 2.0, 0.01
# Contacts are far from the tip within this part of the quantile of s1 that serves as the largest.
_FAR, _FARTHEST = 0.85, 0.98
# Noise of the poses in rod lengths: the first estimate, the bounds of the estimate, and the misfit beyond which the touches
# are not those of this reference.
_PLACE_NOISE, _PLACE_BOUNDS, _NO_FIT = 3e-4, (1e-9, 0.3), 0.01
# Change of the logarithm of that estimate at which it is at rest.
_SAME_NOISE = 0.01
# Evaluations of a round of least squares, rounds of starts, and those of the adjusted values of a row for a known rig.
_EVALUATIONS, _FALL, _SHORT, _ROW_STEPS = 15, 1e-4, 3, 3
# Part of the rows whose contacts must be used, and the largest logarithm of the stiffness over the nominal one.
_USABLE, _STIFFEST = 0.3, 2.5
# Rows in contact by which the fit is begun, and those by which the first rig is sought on its grid and then improved.
_MANY, _SEARCHED, _STARTED = 10_000, 150, 400
# The grid: turns about the rod, distances along it in rod lengths, and logarithms of the stiffness; and the turns of a
# planar sensor about the normal of its plane.  From its best points the fit is begun, so many of them.
_TURNS, _DISTANCES = np.radians(np.arange(0, 360, 15)), np.linspace(-1.0, 1.0, 21)
_STIFFNESS, _PLANAR_TURNS = np.log([0.5, 0.7, 1.0, 1.4, 2.0]), np.radians(np.arange(-60, 61, 15))
_TRIED = 4
_ALONG_ROD = np.array([0.0, 1.0, 0.0])
# The second smallest singular value must exceed the smallest by this factor for the rod's direction to follow from the wrench.
_DISTINCT = 3.0


class Noise(NamedTuple):
    """Standard deviations of each component, dimensionless.  They are the place for further errors of the sensor."""

    force: float
    moment: float
    place: float

    def variances(self, channels: Mask) -> Array:
        """(9,) of a row's measured values; channels (6,) that were not measured are known to vanish."""
        reactions = np.repeat([self.force, self.moment], 3) ** 2
        return np.concatenate([np.where(channels, reactions, 0.0), np.full(3, self.place**2)])


@dataclass(frozen=True)
class Problem:
    """What is measured, and which of it is used."""

    touches: Touches
    around: Array
    """(n, 6) wrench of the neighbours of each row, which decides whether the row is used."""
    numbers: NDArray[np.intp]
    """(n,) of the rows in the recording."""
    air: Unloaded
    root: Array
    """(k, k) of the tare's basis in the air: its product with deviations of the tare is as long as those of the rows."""
    channels: Mask
    """(6,) which components of force and moment were measured."""
    free: Mask
    """(p,) which parameters are sought."""
    world: Array
    """(3, 3) from the world to the frame of the equations."""
    kind: str
    """Of the reference."""

    def rows(self, selected: Mask | NDArray[np.intp]) -> Problem:
        return replace(
            self,
            touches=self.touches.rows(selected),
            around=self.around[selected],
            numbers=self.numbers[selected],
        )

    def with_kinds(self, kind: NDArray[np.int8]) -> Problem:
        """The problem with the kinds (n,) of its contacts."""
        return replace(self, touches=self.touches._replace(kind=kind))

    @property
    def widths(self) -> Array:
        return by_parameter(_WIDTHS, len(self.free))

    @property
    def applies(self) -> Mask:
        """(4,) equations that the measured channels have: three channels are consistent by themselves."""
        return np.array([self.channels.all(), self.channels.all(), True, True])


class Fit(NamedTuple):
    """A fitted rig."""

    problem: Problem
    rig: Rig
    noise: Noise
    jacobian: Array
    """(m, p) derivatives of all white residuals by the parameters, zero for those that are not sought."""
    misclosure: Array
    """(n, 4) of the equations at the measured values, linearised at the adjusted ones; 0 where an equation does not apply."""
    by_row: Array
    """(n, 4, 9) their derivatives by the measured values."""
    white: Array
    """(n, 4) white misclosures, with the variance 1 if the premises hold."""
    factor: Array
    """(n, 4, 4) that makes misclosures white."""
    used: Mask
    """(n, 4) equations that are used."""
    at_rest: bool
    """Whether the iteration converged."""
    cost: float
    """Sum of squares of the white residuals, with that of rows without a rod."""

    @property
    def normal(self) -> Array:
        """(p, p) normal matrix."""
        return np.asarray(self.jacobian.T @ self.jacobian)


def by_parameter(table: dict[int, float], count: int) -> Array:
    """(p,) values of parameters from those of the groups that begin at the keys."""
    first = np.array(sorted(table))
    return np.array([table[first[first <= number][-1]] for number in range(count)])


def calibrated(
    recording: Recording,
    reference: float | Literal["plane"] | None,
    tare: str = "auto",
    pose_noise_m: float | None = None,
) -> Fit:
    """The fit of a rig, as `scan3d.calibrate`."""
    if tare not in TARES:
        raise InputError(f"tare must be one of {', '.join(TARES)}, got {tare!r}")
    if pose_noise_m is not None and not 0 <= pose_noise_m < math.inf:
        raise InputError(f"the noise of the poses must be a number of metres >= 0, got {pose_noise_m!r}")
    if isinstance(reference, str) and reference != Plane.kind:
        raise InputError(
            f"the reference sphere needs a diameter above 0, got {reference!r}; the other reference is {Plane.kind!r}"
        )
    rod = recording.rod
    touched = Plane.of(rod) if isinstance(reference, str) else Sphere.of(reference, rod)  # type: ignore[arg-type]
    place = pose_noise_m if pose_noise_m is not None else recording.noise_pose_m or None
    problem, nominal = _measured(recording, touched, tare)
    noise = Noise(
        problem.air.force_noise,
        problem.air.moment_noise,
        _PLACE_NOISE if place is None else max(place / rod.length_m, _PLACE_BOUNDS[0]),
    )
    step = max(1, len(problem.numbers) // _MANY)
    few = problem.rows(np.arange(0, len(problem.numbers), step))
    rig, free = _begun(few, nominal, noise, step)
    fit = _settled(replace(few, free=free), nominal, rig, noise, place is None)
    if step > 1:  # the fit of some rows is near that of all
        fit = _settled(replace(problem, free=free), nominal, fit.rig, fit.noise, place is None)
    _check(fit, recording)
    return fit


def _measured(recording: Recording, reference: Reference, tare: str) -> tuple[Problem, Rig]:
    """The rows in contact and in the air, dimensionless, and the nominal rig."""
    rod, known, six = recording.rod, recording.noise, recording.six_axis
    if not six and not isinstance(reference, Sphere):
        raise InputError(
            f"a calibration by touches of {reference.title} needs forces and moments with all six components; with three, "
            "touch a sphere"
        )
    channels, wrench = six_channels(recording)
    unit = np.repeat([rod.force_unit_N, rod.moment_unit_Nm], 3)
    wrench = wrench / unit
    air = unloaded(recording.sweep, wrench, channels, (known.force_N / unit[0], known.moment_Nm / unit[3]), tare)
    around = neighbours(wrench, recording.sweep, air.contact)
    force = np.linalg.norm((around - air.basis @ air.tare.T)[:, :3], axis=1)
    rows = np.flatnonzero(air.contact & (force > _FELT * air.force_noise))
    if len(rows) < FEWEST:
        raise InputError(
            f"the recording has {len(rows)} rows in contact that stand out from the noise, and a calibration needs {FEWEST}: "
            f"touch the {reference.kind} in more sweeps, and bend the rod more"
        )
    # sweeps in a plane do not determine how far the sphere's centre is from it: the plane's normal is one of the axes
    world = np.eye(3) if six else recording.axes()[rows[0]]
    touches = Touches(
        wrench[rows],
        recording.position_m[rows] / rod.length_m @ world.T,
        world @ recording.axes()[rows].swapaxes(1, 2),
        air.basis[rows],
        recording.sweep[rows],
        np.full(len(rows), Kind.EITHER, dtype=np.int8),
    )
    free = np.ones(TARE + air.tare.size, dtype=bool)
    if not six:
        free[[TILT, TURN, TURN + 1, SENSOR + 2]] = False
        free[TARE:] = np.repeat(channels, air.basis.shape[1])
        free[PLACE + 2] = np.ptp(touches.position[:, 2]) > _PLANE * reference.size
    middle = touches.position.mean(axis=0)
    placed = replace(reference, **{"centre" if isinstance(reference, Sphere) else "origin": middle})
    nominal = Rig(0.0, np.zeros(3), np.zeros(2), np.eye(3), np.zeros(3), placed, 1.0, air.tare)
    root = np.linalg.qr(air.basis[air.air])[1]
    return Problem(touches, around[rows], rows, air, root, channels, free, world, reference.kind), nominal


def six_channels(recording: Recording) -> tuple[Mask, Array]:
    """Which components of force and moment (6,) a recording has, and all of them (n, 6) in N and N·m, zero where it has not."""
    if recording.six_axis:
        return np.ones(6, dtype=bool), np.hstack(recording.wrench())
    wrench = np.zeros((len(recording), 6))
    wrench[:, :2], wrench[:, 5] = recording.force_N, recording.moment_Nm
    return np.array([True, True, False, False, False, True]), wrench


def _begun(problem: Problem, nominal: Rig, noise: Noise, step: int) -> tuple[Rig, Mask]:
    """A rig near that of the touches, of which `step` times as many were made, and the parameters (p,) that they determine."""
    rig = _first_rig(problem, nominal, noise)
    problem = _strong(problem, rig, noise)
    far = problem.with_kinds(_far_kinds(problem, rig, Kind.UNSURE))
    if (far.touches.kind == Kind.TANGENTIAL).sum() >= max(FEWEST, _USABLE * len(far.numbers)):
        fit = fitted(replace(far, free=far.free & (np.arange(len(far.free)) != LENGTH)), rig, noise)
        if fit.at_rest and abs(fit.rig.stiffness) < _STIFFEST:
            rig = fit.rig
    problem, rig = _with_kinds(problem, rig, noise)
    state = fitted(problem, rig, noise, rounds=0)
    free = _determined(problem, step * state.normal)
    if (free != problem.free).any():
        problem = replace(problem, free=free)
        rig = fitted(problem, _at_nominal(rig, nominal, free), noise, _SHORT, adjust=False).rig
    free[LENGTH] |= not problem.free[LENGTH]  # whether there are tip contacts may turn out later
    return rig, free


def _settled(problem: Problem, nominal: Rig, rig: Rig, noise: Noise, estimate: bool) -> Fit:
    """The fit of rows that their neighbours choose, with the kinds of contacts and the noise of the poses at rest."""
    before, length = None, None
    for _ in range(_CHOICES):
        chosen, rig = _with_kinds(_strong(problem, rig, noise), rig, noise, length)
        fit = fitted(chosen, rig, noise)
        rig, length = fit.rig, fit.rig.length if chosen.free[LENGTH] else None
        if estimate:
            noise = noise._replace(place=_place_noise(fit))
        now = chosen.numbers.tolist(), chosen.touches.kind.tolist()
        if now == before and abs(math.log(noise.place / fit.noise.place)) < _SAME_NOISE:
            break
        before = now
    return fit if length is not None else fit._replace(rig=replace(fit.rig, length=nominal.length))


def fitted(problem: Problem, rig: Rig, noise: Noise, rounds: int = _ADJUSTMENTS, adjust: bool = True) -> Fit:
    """The fit from a rig nearby; without `adjust` the equations hold at the measured values, as is enough from afar."""
    correction = np.zeros((len(problem.numbers), 9))
    variances = noise.variances(problem.channels)
    at_rest = False
    for _ in range(rounds):
        state = _State.at(problem, rig, noise, correction)
        step, white, size = _solved(problem, rig, state)
        rig = rig.moved(step)
        at_rest = size < _SMALL
        if at_rest:
            break
        if adjust:
            multiplier = np.einsum("nji,nj->ni", state.factor, np.where(state.used, white, 0.0))
            correction = -variances * np.einsum("nij,ni->nj", state.by_row, multiplier)
    state = _State.at(problem, rig, noise, correction)
    white, by_rig, lost = state.white(problem, rig)
    jacobian = np.concatenate([by_rig.reshape(-1, len(problem.free)), state.air])
    jacobian[:, ~problem.free] = 0
    cost = float((white**2).sum()) + float(((state.air @ state.tare_step(problem, rig)) ** 2).sum())
    white[lost] = 0
    return Fit(
        problem, rig, noise, jacobian, state.misclosure, state.by_row, white, state.factor, state.used, at_rest, cost
    )


class _State(NamedTuple):
    """The equations of rows (n,) linearised at adjusted values of what was measured."""

    touches: Touches
    """Adjusted."""
    offset: Array
    """(n, 4) by which a misclosure at the measured values is less than the value of its equation."""
    misclosure: Array
    by_row: Array
    used: Mask
    factor: Array
    air: Array
    """(6 k, p) derivatives of the white deviations of the tare in the air by the parameters."""

    @classmethod
    def at(cls, problem: Problem, rig: Rig, noise: Noise, correction: Array) -> _State:
        touches = problem.touches.moved(correction)
        found = equations(rig, touches)
        good = np.asarray(np.isfinite(found.value).all(axis=1) & np.isfinite(found.by_row).all(axis=(1, 2)))
        used = good[:, None] & problem.applies & (found.by_row != 0).any(axis=2)
        by_row = np.where(used[:, :, None], found.by_row, 0.0)
        offset = np.einsum("nij,nj->ni", by_row, correction)
        covariance = (by_row * noise.variances(problem.channels)) @ by_row.swapaxes(1, 2)
        covariance[:, range(4), range(4)] += ~used
        air = np.zeros((rig.tare.size, len(problem.free)))
        weight = problem.channels / np.repeat([noise.force, noise.moment], 3)
        air[:, TARE:] = np.kron(np.diag(weight), problem.root)
        return cls(
            touches,
            offset,
            np.where(used, found.value, 0.0) - offset,
            by_row,
            used,
            np.linalg.inv(np.linalg.cholesky(covariance)),
            air,
        )

    def white(self, problem: Problem, rig: Rig) -> tuple[Array, Array, Mask]:
        """White misclosures (n, 4) of a rig nearby, with derivatives (n, 4, p), and rows (n,) that have no rod."""
        found = equations(rig, self.touches)
        lost: Mask = ~np.asarray(np.isfinite(found.value).all(axis=1))
        used = self.used & ~lost[:, None]
        white = np.einsum("nij,nj->ni", self.factor, np.where(used, found.value, 0.0) - self.offset)
        by_rig = self.factor @ np.where(used[:, :, None], found.by_rig, 0.0)
        white[lost] = [_NO_ROD, 0, 0, 0]
        return white, by_rig, lost

    def tare_step(self, problem: Problem, rig: Rig) -> Array:
        """(p,) how far the tare is from that of the rows in the air."""
        return np.concatenate([np.zeros(TARE), (rig.tare - problem.air.tare).ravel()])


def _solved(problem: Problem, rig: Rig, state: _State) -> tuple[Array, Array, float]:
    """The step (p,) to the least sum of squares, the white misclosures (n, 4) there, and its size in standard deviations.

    Parameters that nothing depends on do not move: a step of their width counts as much as a standard deviation.
    """
    free = np.flatnonzero(problem.free)
    widths = problem.widths[free]
    known: dict[bytes, tuple[Array, Array, Array]] = {}

    def full(x: Array) -> Array:
        step = np.zeros(len(problem.free))
        step[free] = x
        return step

    def evaluated(x: Array) -> tuple[Array, Array, Array]:
        if x.tobytes() not in known:
            step = full(x)
            moved = rig.moved(step)
            white, by_rig, _ = state.white(problem, moved)
            residual = np.concatenate([white.ravel(), state.air @ state.tare_step(problem, moved), x / widths])
            slopes = by_rig.reshape(-1, len(step)) @ rig.by_step(step)[:, free]
            known.clear()
            known[x.tobytes()] = white, residual, np.concatenate([slopes, state.air[:, free], np.diag(1 / widths)])
        return known[x.tobytes()]

    found = least_squares(
        lambda x: evaluated(x)[1],
        np.zeros(len(free)),
        lambda x: evaluated(x)[2],
        x_scale=widths,
        ftol=_FALL,
        max_nfev=_EVALUATIONS,
    )
    white, _, slopes = evaluated(found.x)
    return full(found.x), white, float(np.linalg.norm(slopes @ found.x))


def _strong(problem: Problem, rig: Rig, noise: Noise) -> Problem:
    """The rows whose contacts are known well enough along the rod, by their neighbours."""
    scale = np.exp(-rig.stiffness)
    force, moment = clamp_wrench(rig, problem.touches._replace(wrench=problem.around))
    by_s1 = scale * bent(scale * force, scale * moment).by_s1
    deviation = np.repeat([noise.force, np.hypot(noise.moment, np.linalg.norm(rig.sensor) * noise.force)], 3)
    with np.errstate(invalid="ignore"):
        strong = np.linalg.norm(by_s1 * deviation, axis=1) < _ALONG * rig.reference.size
    if (count := int(strong.sum())) < FEWEST:
        raise _no_fit(
            rig.reference,
            f", or touch it too lightly: {count} rows place the contact to {rig.reference.extent}, and a calibration needs "
            f"{FEWEST}",
        )
    return problem.rows(strong)


def _far_kinds(problem: Problem, rig: Rig, other: Kind) -> NDArray[np.int8]:
    """Contacts (n,) that are certainly not at the tip are tangential, and the others of another kind; for a rough rig."""
    s1 = contacts(rig, problem.touches)[1]
    known = s1[np.isfinite(s1)]
    far = s1 < _FAR * np.quantile(known, _FARTHEST) if len(known) else np.zeros(len(s1), dtype=bool)
    return np.where(far, Kind.TANGENTIAL, other).astype(np.int8)


def _with_kinds(problem: Problem, rig: Rig, noise: Noise, length: float | None = None) -> tuple[Problem, Rig]:
    """The problem with the kinds of contacts that their neighbours make likelier, and the rig with its free length.

    `length` is the free length if it is known; without tip contacts it is not sought.
    """
    inward = np.zeros(len(problem.numbers), dtype=bool)
    if length is None:
        variances = noise.variances(problem.channels)
        as_tip, tangential = (equations(rig, problem.touches.all(kind)) for kind in (Kind.TIP, Kind.TANGENTIAL))
        s1, cosine = as_tip.value[:, 3] + rig.length, tangential.value[:, 3]
        with np.errstate(invalid="ignore"):
            s1_sd, cosine_sd = (np.sqrt(found.by_row[:, 3] ** 2 @ variances) for found in (as_tip, tangential))
            sure = s1_sd < _SURE
            # single contacts are put past the tip by noise
            farthest = float(np.sort(s1[sure])[-_FEWEST_TIPS:][0]) if sure.any() else rig.length
            inward = np.asarray(cosine < -_INWARD * cosine_sd - _COSINE)
            candidates = inward & sure & (s1 > _FAR * farthest)
        guess = float(np.median(s1[candidates])) if candidates.sum() >= _FEWEST_TIPS else farthest
        tips = sure & (_likelier(problem, replace(rig, length=guess), noise) == Kind.TIP)
        if tips.sum() >= _FEWEST_TIPS:
            length = float(np.median(s1[tips]))
        rig = replace(rig, length=guess)
    if length is not None:
        rig = replace(rig, length=length)
    kind = _likelier(problem, rig, noise)
    kind[inward & (kind == Kind.TANGENTIAL)] = Kind.UNSURE
    if length is None:
        kind[kind == Kind.TIP] = Kind.UNSURE
    free = problem.free.copy()
    free[LENGTH] &= bool((kind == Kind.TIP).any())
    return replace(problem.with_kinds(kind), free=free), rig


def _likelier(problem: Problem, rig: Rig, noise: Noise) -> NDArray[np.int8]:
    """The kinds (n,) of contacts that the rows around them in their sweep make likelier, for a rig of a known length."""
    difference = _misfits(problem, rig, noise, Kind.TANGENTIAL) - _misfits(problem, rig, noise, Kind.TIP)
    kind = np.full(len(difference), Kind.UNSURE, dtype=np.int8)
    for number in np.unique(problem.touches.sweep):
        rows = np.flatnonzero(problem.touches.sweep == number)
        around = _evidence(difference[rows]) + _evidence(difference[rows][::-1])[::-1]
        kind[rows[around < -_LIKELIER]] = Kind.TANGENTIAL
        kind[rows[around > _LIKELIER]] = Kind.TIP
    return kind


def _misfits(problem: Problem, rig: Rig, noise: Noise, kind: Kind) -> Array:
    """Sums of squares (n,) of the rows' corrections, in variances, beyond what is expected, if all are of one kind."""
    problem = replace(problem, touches=problem.touches.all(kind))
    correction = np.zeros((len(problem.numbers), 9))
    for _ in range(_ROW_STEPS):
        state = _State.at(problem, rig, noise, correction)
        white = np.einsum("nij,nj->ni", state.factor, state.misclosure)
        multiplier = np.einsum("nji,nj->ni", state.factor, white)
        correction = -noise.variances(problem.channels) * np.einsum("nij,ni->nj", state.by_row, multiplier)
    return np.asarray((white**2).sum(axis=1) - state.used.sum(axis=1))


def _evidence(difference: Array) -> Array:
    """What the rows before each row (n,) say of its kind: by how much one kind costs more than the other.

    Contacts change their kind now and then.  A change costs as much as the evidence that makes a kind certain, so that no
    more than this is handed on from row to row (the Viterbi algorithm for two states).
    """
    result, total = np.zeros(len(difference)), 0.0
    for row, value in enumerate(difference):
        result[row] = total
        total = min(max(total + float(value), -_LIKELIER), _LIKELIER)
    return result


def _determined(problem: Problem, normal: Array) -> Mask:
    """The parameters (p,) that a normal matrix determines; of those it determines only together, some are left out."""
    free = problem.free.copy()
    widths, order = problem.widths, by_parameter(_FIXED_FIRST, len(free))
    while True:
        rows = np.flatnonzero(free)
        size, vectors = np.linalg.eigh((normal * widths[:, None] * widths)[np.ix_(rows, rows)])
        if size[0] > max(1.0, _ROUNDING * size[-1]):
            break
        part = np.abs(vectors[:, 0]) * order[rows]
        if part.max() < _PART:
            raise InputError(f"the touches do not determine the {problem.kind}'s place: {MORE_SWEEPS}")
        free[rows[np.argmax(part)]] = False
    about_rod = rows == TURN + 1
    if about_rod.any():
        variance = float(((vectors[about_rod] * widths[TURN + 1]) ** 2 / size).sum())
        free[TURN + 1] = variance < _ABOUT_ROD**2
    return free


def _at_nominal(rig: Rig, nominal: Rig, free: Mask) -> Rig:
    """The rig with the parameters that are not determined at their nominal values."""
    reference = rig.reference
    if isinstance(reference, Sphere) and isinstance(nominal.reference, Sphere):
        # only a sphere has a nominal place, in the plane of all sweeps
        centre = np.where(free[PLACE:LENGTH], reference.centre, nominal.reference.centre)
        reference = replace(reference, centre=centre)
    return Rig(
        rig.stiffness if free[STIFFNESS] else nominal.stiffness,
        np.where(free[CLAMP:TILT], rig.clamp, nominal.clamp),
        np.where(free[TILT:TURN], rig.tilt, nominal.tilt),
        rig.turn if free[TURN:SENSOR].any() else nominal.turn,
        np.where(free[SENSOR:PLACE], rig.sensor, nominal.sensor),
        reference,
        rig.length if free[LENGTH] else nominal.length,
        rig.tare,
    )


def _place_noise(fit: Fit) -> float:
    """The noise of the poses with which the sum of squares of the misclosures is that of their degrees of freedom."""
    freedom = degrees_of_freedom(fit)

    def excess(logarithm: float) -> float:
        variances = fit.noise._replace(place=math.exp(logarithm)).variances(fit.problem.channels)
        covariance = (fit.by_row * variances) @ fit.by_row.swapaxes(1, 2)
        covariance[:, range(4), range(4)] += ~fit.used
        solved = np.linalg.solve(covariance, fit.misclosure[:, :, None])[:, :, 0]
        return float((fit.misclosure * solved).sum()) - freedom

    low, high = map(math.log, _PLACE_BOUNDS)
    if excess(low) <= 0 or excess(high) >= 0:
        return _PLACE_BOUNDS[int(excess(low) > 0)]
    return math.exp(brentq(excess, low, high, xtol=_SAME_NOISE / 10))


def degrees_of_freedom(fit: Fit) -> int:
    """Of the misclosures in contact: the parameters that they determine count with them, the tare with the air."""
    return max(int(fit.used.sum()) - int(fit.problem.free[:TARE].sum()), 1)


def _check(fit: Fit, recording: Recording) -> None:
    """Raise InputError for a fit that is none."""
    reference = fit.rig.reference
    if fit.noise.place > _NO_FIT:
        deviation = 1000 * fit.noise.place * recording.rod.length_m
        raise _no_fit(reference, f", from which they deviate by {deviation:.2g} mm")
    normal = np.diag(fit.normal)[fit.problem.free]
    usable = fit.used[:, 2].sum() >= max(FEWEST, _USABLE * len(fit.used))
    known = np.isfinite(normal).all() and (normal > 0).all()
    if not (fit.at_rest and usable and known and abs(fit.rig.stiffness) < _STIFFEST):
        raise _no_fit(reference, "")


def _no_fit(reference: Reference, detail: str) -> InputError:
    return InputError(
        f"the touches do not fit {reference.title}{detail}: check {reference.check}, the rod, the units and signs of forces "
        f"and moments, that each sweep begins and ends in the air, and that the {reference.kind} did not move"
    )


def _first_rig(problem: Problem, nominal: Rig, noise: Noise) -> Rig:
    """A rig whose contacts lie near the reference and, where they are far from the tip, are tangential."""
    free = problem.free.copy()
    free[LENGTH:] = False  # the tare is that of the rows in the air
    # contacts of light touches are far from linear in the noise
    force = np.linalg.norm((problem.touches.wrench - problem.touches.basis @ nominal.tare.T)[:, :3], axis=1)
    heavy = np.flatnonzero(force >= np.median(force))
    coarse = replace(problem.rows(_thinned(heavy, _STARTED)), free=free)
    turns = _TURNS
    if problem.channels.all():
        frames, offsets = _by_consistency(nominal, coarse.touches, noise)
    else:
        frames = [Rotation.from_euler("z", angle).as_matrix() for angle in _PLANAR_TURNS]
        offsets, turns = [nominal.sensor] * len(frames), np.zeros(1)
    searched = coarse.touches.rows(_thinned(np.arange(len(coarse.numbers)), _SEARCHED))
    grid = [
        scored
        for frame, offset in zip(frames, offsets, strict=True)
        for scored in _on_grid(replace(nominal, turn=frame, sensor=offset), searched, turns)
    ]
    rigs = [rig for _, rig in sorted(grid, key=lambda scored: scored[0])[:_TRIED]]
    rigs += [replace(nominal, reference=rig.reference) for rig in rigs[:1]]
    if not rigs:
        return nominal
    tried = []
    for rig in rigs:
        started = coarse.with_kinds(_far_kinds(coarse, rig, Kind.EITHER))
        tried.append(fitted(started, rig, noise, _SHORT, adjust=False))
    best = min(tried, key=lambda fit: fit.cost).rig
    return fitted(coarse.with_kinds(_far_kinds(coarse, best, Kind.EITHER)), best, noise, _SHORT, adjust=False).rig


def _thinned(rows: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), count)).astype(np.intp))]


def _by_consistency(nominal: Rig, touches: Touches, noise: Noise) -> tuple[list[Array], list[Array]]:
    """Turns of the sensor, up to one about the rod, and its places, up to one along the rod."""
    tared = touches.wrench - touches.basis @ nominal.tare.T
    deviation = np.repeat([noise.moment, noise.force], 3)
    _, size, rows = np.linalg.svd(np.roll(tared, 3, axis=1) / deviation)
    along, offset = _ALONG_ROD, np.zeros(3)
    if size[-2] > _DISTINCT * size[-1]:
        solution = rows[-1] / deviation
        along, cross = solution[:3] / np.linalg.norm(solution[:3]), solution[3:] / np.linalg.norm(solution[:3])
        offset = np.cross(cross, along)
    frames = [Rotation.align_vectors([_ALONG_ROD], [axis])[0].as_matrix() for axis in (along, -along)]
    return frames, [frame @ offset for frame in frames]


def _on_grid(rig: Rig, touches: Touches, turns: Array) -> list[tuple[float, Rig]]:
    """Rigs of the grid about a rig, with the median distance of their contacts from the reference."""
    scored = []
    outside = touches.position.mean(axis=0)
    turned = Rotation.from_rotvec(np.outer(turns, _ALONG_ROD)).as_matrix()
    for along in _DISTANCES:
        for stiffness in _STIFFNESS:
            moved = replace(rig, sensor=rig.sensor + along * _ALONG_ROD, stiffness=float(stiffness))
            point = contacts(moved, touches)[0]
            known: Mask = np.asarray(np.isfinite(point).all(axis=1))
            if known.sum() < max(len(known) / 2, 8):
                continue
            world = np.einsum("nij,tjk,nk->tni", touches.frame[known], turned, point[known]) + touches.position[known]
            best, reference, misfit = rig.reference.nearest(world, outside)
            turn = turned[best]
            better = replace(moved, turn=turn @ rig.turn, sensor=turn @ moved.sensor, reference=reference)
            scored.append((misfit + float((~known).mean()), better))
    return scored
