"""The rig that has touched a reference, by least squares with errors in all measured values.

The equations of `model` hold between the true values of a row (the Gauss-Helmert model: Helmert, 1872; Niemeier, 2008,
chapter 5).  For a rig the measured values of each row are adjusted by the least corrections, in standard deviations, with
which its equations hold.  Linearised there, the misclosures ``w`` of the measured values have the covariance ``B Σ Bᵀ``, and
the corrections have the sum of squares ``wᵀ (B Σ Bᵀ)⁻¹ w``: white misclosures, whose sum of squares depends on the rig alone,
and has the derivatives that the equations have at the adjusted values.  Weights and derivatives at the measured values
instead would be correlated with the noise, and bias the parameters.

Where the model holds, the four white misclosures of a row have the variance 1 each, and those of successive rows are as
independent as the noise.  Scatter beyond that enlarges all uncertainties: by its mean square (the Birge ratio), and by the
number of rows over which it is alike (the integrated autocorrelation).  Where it is more than noise could be, the model does
not fit: deviations with the sum of squares S may then be alike in all rows, and shift a parameter by no more than √S of its
standard deviations (the Cauchy-Schwarz inequality).

Kinds of contacts, rows, and the noise of the poses depend on the rig, and the rig on them: rounds of least squares end when
all of them are at rest.  Neither a row's use nor its kind is decided by its own noise, but by its neighbours in the sweep.

Least squares begin at a first rig.  The condition ``m0·t0 = 0`` in the sensor's frame is linear in the rod's direction u and in
``u × a``, with a the place of the sensor: it gives both without a body.  The turn about the rod, the distance along it and the
stiffness are then searched on a grid: with the right ones the contacts lie on the reference.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, least_squares
from scipy.spatial.transform import Rotation
from scipy.special import chdtri, ndtr

from planar.arrays import rows_of
from scan3d.arrays import NEGLIGIBLE, ROUNDING, Array, Index, Mask, evenly
from scan3d.calibration.model import (
    CLAMP,
    GAINS,
    LENGTH,
    MIXING,
    PLACE,
    SENSOR,
    SHAPE,
    STIFFNESS,
    TARE,
    TILT,
    TURN,
    Equations,
    Kind,
    Rig,
    Touches,
    bent,
    clamp_wrench,
    contacts,
    equations,
)
from scan3d.calibration.references import CHANCE, Plane, Reference, Sphere, Unloaded, neighbours, six_channels, unloaded
from scan3d.choices import TARES
from scan3d.errors import InputError
from scan3d.recording import CHANNELS, Recording
from scan3d.rigs import Frame
from scan3d.units import length, share

# Widths within which parameters are known without any touch: those that the touches leave less certain are not determined.
# Of the logarithms of stiffness and taper, curvatures over the rod's length, lengths in rod lengths, angles in radians, and the
# tare in EI/L² and EI/L.  And which of several that are determined only together stays at its nominal value: the one with the
# largest number; the reference's place and the tare have no nominal value.
_WIDTHS_AND_RANKS = {
    STIFFNESS: (0.5, 0.5),
    CLAMP: (0.1, 1.0),
    TILT: (0.3, 0.9),
    TURN: (0.5, 0.6),
    SENSOR: (0.3, 0.8),
    PLACE: (1.0, 0.0),
    LENGTH: (0.1, 1.0),
    SHAPE: (1.0, 0.95),
    GAINS: (1.0, 0.0),
    MIXING: (1.0, 0.0),
    TARE: (1.0, 0.0),
}


class Sensor(NamedTuple):
    """What is known of a sensor beforehand."""

    accuracy: Array
    """(6,) standard deviations of the gains of its channels."""
    frame: Frame
    """That of its channels in the clamp's, as it is stated."""


class Noise(NamedTuple):
    """Standard deviations of each component, dimensionless."""

    force: float
    moment: float
    place: float
    relative: float = 0.0
    """Of force and moment over their sizes, independent from row to row."""
    mixing: float = 0.0
    """Of gains and cross-talk that are the same in all rows, for channels as large as in the mean of the touches."""
    gains: float = 1.0
    """Standard deviations of the gains of the sensor's channels, over the stated ones; 0: gains are among the mixing."""
    contradiction: float = 0.0
    """Of force and moment to a single force, relative to them, where it is no chance and gains and cross-talk are nought."""

    def variances(self, problem: Problem) -> Array:
        """(n, 9) of a row's measured values; channels (6,) that were not measured are known to vanish."""
        reactions = np.array([self.force, self.moment]) ** 2 + self.relative**2 * problem.squares
        place = np.full((len(reactions), 3), self.place**2)
        return np.hstack([np.where(problem.channels, np.repeat(reactions, 3, axis=1), 0.0), place])


@dataclass(frozen=True)
class Problem:
    """What is measured, and which parameters are sought."""

    touches: Touches
    air: Unloaded
    channels: Mask
    """(6,) which components of force and moment were measured."""
    free: Mask
    """(p,) which parameters are sought."""
    accuracy: Array
    """(6,) stated standard deviations of the gains of the sensor's channels."""

    def rows(self, selected: Mask | Index) -> Problem:
        return replace(self, touches=rows_of(self.touches, selected))

    def with_kinds(self, kind: NDArray[np.int8]) -> Problem:
        """The problem with the kinds (n,) of its contacts."""
        return replace(self, touches=self.touches._replace(kind=kind))

    @property
    def widths_and_ranks(self) -> Array:
        """(2, p)"""
        group = np.searchsorted(list(_WIDTHS_AND_RANKS), np.arange(len(self.free)), side="right") - 1
        return np.array(list(_WIDTHS_AND_RANKS.values()))[group].T

    @property
    def squares(self) -> Array:
        """(n, 2) of force and moment, by the neighbours of each row."""
        wrench = self.touches.around - self.touches.basis @ self.air.tare.T
        return np.asarray((wrench.reshape(-1, 2, 3) ** 2).sum(axis=2))

    @property
    def mixing_units(self) -> Array:
        """(36,) gains and cross-talk of 1 between channels as large as the root mean squares of force and moment."""
        channel = np.repeat(np.sqrt(self.squares.mean(axis=0)), 3)
        return np.asarray(channel[:, None] / channel).ravel()

    def beforehand(self, noise: Noise) -> Array:
        """(42,) standard deviations with which gains, and further gains and cross-talk, are known to be nought beforehand."""
        gains = np.diag(self.accuracy).ravel()
        return np.concatenate([noise.gains * self.accuracy, np.hypot(noise.mixing * self.mixing_units, gains)])


class Rows(NamedTuple):
    """The equations of rows (n,) for a rig, linearised at adjusted values of what was measured."""

    used: Mask
    """(n, 4) which equations apply."""
    misclosure: Array
    """(n, 4) of the measured values; 0 where an equation does not apply."""
    by_row: Array
    """(n, 4, 9) derivatives by the measured values."""
    factor: Array
    """(n, 4, 4) that makes misclosures white."""
    white: Array
    """(n, 4) misclosures with the variance 1 if the premises hold; a large number for rows without a rod."""
    white_by_rig: Array
    """(n, 4, p) derivatives by the parameters."""


@dataclass(frozen=True)
class Fit:
    """A rig that fits to touches."""

    problem: Problem
    rig: Rig
    noise: Noise
    rows: Rows
    jacobian: Array
    """(m, p) derivatives of all white residuals, those of the rows first; zero for parameters that are not sought."""
    cost: float
    """Sum of squares of the white residuals."""
    left: float
    """Of the step to a least sum of squares, by how many standard deviations it moves a quantity at most."""

    @property
    def at_rest(self) -> bool:
        """Whether this is a least sum of squares; at a kink of it, where a row comes in or goes out, part of a step is left."""
        return self.left < 1

    @property
    def normal(self) -> Array:
        """(p, p) normal matrix."""
        return np.asarray(self.jacobian.T @ self.jacobian)

    @cached_property
    def inverse(self) -> Array:
        """(p, m) pseudo-inverse of the derivatives; its product with its transpose is the covariance of the parameters."""
        return np.asarray(np.linalg.pinv(self.jacobian), dtype=float)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the rows: the parameters that they determine count with them, the tare with the air."""
        determined = int(self.problem.free[:GAINS].sum()) + round(self.evidence(GAINS, TARE)[1])
        return max(int(self.rows.used.sum()) - determined, 1)

    def evidence(self, first: int, end: int) -> tuple[float, float]:
        """Of parameters that are known beforehand, the sum of squares over their variances then, and how many of them the rows
        determine rather than what is known beforehand."""
        free = first + np.flatnonzero(self.problem.free[first:end])
        if not len(free):
            return 0.0, 0.0
        known = self.problem.beforehand(self.noise)[free - GAINS]
        values = np.concatenate([self.rig.gains, self.rig.mixing.ravel()])[free - GAINS]
        left = float((((self.inverse[free] ** 2).sum(axis=1)) / known**2).sum())
        return float(((values / known) ** 2).sum()), len(free) - left


def adjusted(problem: Problem, rig: Rig, noise: Noise, slack: float = 0.0) -> Rows:
    """The rows for a rig; `slack` is a standard deviation of the fourth equation beside that by the noise."""
    variances = noise.variances(problem)
    # three channels are consistent by themselves
    applies = np.array([problem.channels.all()] * 2 + [True] * 2)
    found = equations(rig, problem.touches)
    good = _finite(found)
    used = good[:, None] & applies & (found.by_row != 0).any(axis=2)
    further = ~used + np.array([0, 0, 0, slack**2])
    correction = before = np.zeros((len(good), 9))
    for number in range(4):  # the first time at the measured values
        if number:
            moved = equations(rig, problem.touches.moved(correction))
            fine = _finite(moved)  # the rod is lost by adjusting some rows, which stay where they are
            correction[~fine] = before[~fine]
            for new, old in zip(moved, found, strict=True):
                old[fine] = new[fine]
        by_row = np.where(used[:, :, None], found.by_row, 0.0)
        misclosure = np.where(used, found.value, 0.0) - np.einsum("nij,nj->ni", by_row, correction)
        covariance = (by_row * variances[:, None]) @ by_row.swapaxes(1, 2)
        # positive also for equations that nearly follow from each other
        covariance[:, range(4), range(4)] = (covariance[:, range(4), range(4)] + further) * (1 + ROUNDING)
        factor = np.linalg.inv(np.linalg.cholesky(covariance))
        white = np.einsum("nij,nj->ni", factor, misclosure)
        multiplier = np.einsum("nji,nj->ni", factor, white)
        before, correction = correction, -variances * np.einsum("nij,ni->nj", by_row, multiplier)
    # more than rows that are far off, because rigs for which no row has a rod would fit best otherwise
    white[~good, 0] = 100.0
    white_by_rig = factor @ np.where(used[:, :, None], found.by_rig, 0.0)
    return Rows(used, misclosure, by_row, factor, white, white_by_rig)


def _finite(found: Equations) -> Mask:
    sizes = (found.value**2).sum(axis=1) + (found.by_row**2).sum(axis=(1, 2)) + (found.by_rig**2).sum(axis=(1, 2))
    return np.asarray(np.isfinite(sizes))


def fitted(problem: Problem, rig: Rig, noise: Noise, trials: int = 50) -> Fit:
    """The fit from a rig nearby, or the best of so many rigs that are tried.

    Parameters that nothing depends on do not move: a step of their width counts as much as a standard deviation.
    """
    free = np.flatnonzero(problem.free)
    widths = problem.widths_and_ranks[0, free]
    weight = problem.channels / np.repeat([noise.force, noise.moment], 3)
    known = np.flatnonzero(problem.free[GAINS:TARE])
    likely = np.zeros((len(known), len(problem.free)))
    likely[range(len(known)), GAINS + known] = 1 / problem.beforehand(noise)[known]
    # the product of this root with deviations of the tare is as long as the deviations of the rows in the air
    root = np.linalg.qr(problem.air.basis[problem.air.air])[1]
    in_air = np.zeros((rig.tare.size, len(problem.free)))
    in_air[:, TARE:] = np.kron(np.diag(weight), root)

    @lru_cache(maxsize=1)
    def at(given: bytes) -> tuple[Rig, Rows, Array, Array]:
        """The rig after a step of the free parameters, its rows, the residuals and their derivatives."""
        step, x = np.zeros(len(problem.free)), np.frombuffer(given)
        step[free] = x
        moved = rig.moved(step)
        rows = adjusted(problem, moved, noise)
        tare = in_air[:, TARE:] @ (moved.tare - problem.air.tare).ravel()
        gains = likely[:, GAINS:TARE] @ np.concatenate([moved.gains, moved.mixing.ravel()])
        residual = np.concatenate([rows.white.ravel(), tare, gains, x / widths])
        by_rig = np.vstack([rows.white_by_rig.reshape(-1, len(step)), in_air, likely])[:, free]
        return moved, rows, residual, np.vstack([by_rig, np.diag(1 / widths)])

    found = least_squares(
        lambda x: at(x.tobytes())[2],
        np.zeros(len(free)),
        lambda x: at(x.tobytes())[3],
        x_scale=widths,
        max_nfev=trials,
    )
    moved, rows, residual, slopes = at(found.x.tobytes())
    jacobian = np.vstack([rows.white_by_rig.reshape(-1, len(problem.free)), in_air, likely])
    jacobian[:, ~problem.free] = 0
    left = float(np.linalg.norm(np.linalg.qr(slopes)[0].T @ residual))
    return Fit(problem, moved, noise, rows, jacobian, 2 * float(found.cost), left)


def estimates(fit: Fit, place: bool) -> Noise:
    """The noise that the misclosures of a fit have; that of the poses is estimated only if `place` is true.

    Relative errors of the wrench follow from the equations that only the wrench is in, where these contradict a single force
    by more than chance.
    """
    noise, problem = fit.noise, fit.problem
    wider = 1.0
    if problem.free[GAINS:MIXING].any():
        total, count = fit.evidence(GAINS, MIXING)
        if count >= 1:
            wider = max(math.sqrt(total / count), 1 / noise.gains)
        noise = noise._replace(gains=noise.gains * wider)
    if problem.channels.all():
        total, count = fit.evidence(MIXING, TARE)
        alone = fit.rows.used[:, :2]
        freedom = max(float(alone.sum()) - int(problem.free[TURN:PLACE].sum()) - count, 1.0)
        if _excess(fit, noise._replace(relative=0.0), slice(0, 2)) > freedom + CHANCE * math.sqrt(2 * freedom):
            noise = _estimated(fit, noise, "relative", slice(0, 2), freedom)
            # gains that were held back by what was known of them explain more with more freedom
            if not count and wider < 1.1:
                if problem.free[GAINS:MIXING].any():
                    noise = noise._replace(gains=0.0)
                else:
                    noise = noise._replace(mixing=noise.relative, contradiction=noise.relative)
        else:
            noise = noise._replace(relative=0.0)
        if count > 1:
            # errors that are alike in all rows are not much larger than the contradiction that they explain
            mixing = fit.noise.mixing * math.sqrt(total / count)
            noise = noise._replace(mixing=min(max(mixing, NEGLIGIBLE), 2 * noise.contradiction))
    return _estimated(fit, noise, "place", slice(0, 4), fit.freedom) if place else noise


def _excess(fit: Fit, noise: Noise, which: slice) -> float:
    """Sum of squares of the misclosures of some equations over the variances of a noise."""
    used, by_row, misclosure = (part[:, which] for part in (fit.rows.used, fit.rows.by_row, fit.rows.misclosure))
    covariance = (by_row * noise.variances(fit.problem)[:, None]) @ by_row.swapaxes(1, 2)
    covariance[:, range(used.shape[1]), range(used.shape[1])] += np.where(used, 0.0, 1.0)
    return float((misclosure * np.linalg.solve(covariance, misclosure[:, :, None])[:, :, 0]).sum())


def _estimated(fit: Fit, noise: Noise, name: str, which: slice, freedom: float) -> Noise:
    """The noise whose component of a name makes the sum of squares of some equations equal to their degrees of freedom."""

    def excess(logarithm: float) -> float:
        return _excess(fit, noise._replace(**{name: math.exp(logarithm)}), which) - freedom

    # the largest is one of the poses in rod lengths, and of the wrench relative to it
    ends = NEGLIGIBLE, 0.3
    low, high = map(math.log, ends)
    if excess(low) <= 0 or excess(high) >= 0:
        return noise._replace(**{name: ends[not excess(low) <= 0]})
    return noise._replace(**{name: math.exp(brentq(excess, low, high, rtol=1e-4))})


def is_shaped(fit: Fit) -> bool:
    """Whether touches contradict the shape of the rod by more than chance: what its taper and curvature would explain of the
    sum of squares, to the first order, exceeds what they would of noise (the score test)."""
    problem = fit.problem
    if problem.free[SHAPE]:
        return False
    few = problem.rows(evenly(np.arange(len(problem.touches.kind)), 1000))
    rows = adjusted(few, replace(fit.rig, marched=True), fit.noise)
    columns = rows.white_by_rig.reshape(-1, len(problem.free))
    known = fit.jacobian[4 * len(problem.touches.kind) :, problem.free]
    rig = np.linalg.qr(np.vstack([columns[:, problem.free], known]))[0]

    def left(values: Array) -> Array:
        values = np.concatenate([values, np.zeros((len(known), *values.shape[1:]))])
        return np.asarray(values - rig @ (rig.T @ values))

    by_shape = columns[:, SHAPE : SHAPE + 2 + problem.channels.all()]
    white = np.where(rows.used, rows.white, 0.0)  # rows that are found without a rod tell nothing of its shape
    residual, axes = left(white.ravel()), np.linalg.qr(left(by_shape))[0]
    scatter = float(residual @ residual) / max(int(rows.used.sum()) - int(problem.free[:GAINS].sum()), 1)
    return bool(((axes.T @ residual) ** 2).sum() > scatter * chdtri(axes.shape[1], 2 * ndtr(-CHANCE)))


ROBOTS = 1e-3
"""Noise of a robot's poses, at most, in rod lengths."""


class Checked(NamedTuple):
    """The covariance of the parameters, and what the tests of the premises say."""

    covariance: Array
    """(p, p) zero for parameters that are not sought."""
    chi2: float
    """Sum of squares of the misclosures over their variances per degree of freedom."""
    consistency: float
    """The same of the two equations that only the wrench is in."""
    sentences: tuple[str, ...]
    spoiled: bool
    """Whether the model fits so badly that no quantity of the rig counts as well determined."""
    fits: bool
    """Whether nothing contradicts the model by more than chance."""


def checked(fit: Fit, recording: Recording, estimated: bool) -> Checked:
    """Test the premises of a fit, whose noise of the poses may be `estimated`."""
    rows, kind, air = fit.rows, fit.rig.reference.kind, fit.problem.air
    white = np.where(rows.used, rows.white, 0.0)
    total = float((white**2).sum())
    sentences = []
    # the noise is not stated where it is that of the same rows
    stated = recording.noise_force_N > 0 and recording.noise_moment_Nm > 0
    if stated and air.misfit > 1 + CHANCE * np.sqrt(2 / (6 * air.air.sum())):
        sentences.append(
            f"In the air the reactions scatter by {air.misfit**0.5:.2f} times the stated noise: the sensor drifts "
            "otherwise than the tare assumes, or the noise is larger than stated; what is found in the air was used "
            "instead."
        )
    rough = estimated and fit.noise.place > ROBOTS
    if rough:
        off = length(fit.noise.place * recording.rod.length_m, "m", digits=2)
        check = {"sphere": "the diameters of sphere and rod", "plane": "the flatness of the plane"}[kind]
        sentences.append(
            f"The contacts deviate from the {kind} as if the poses scattered by {off}, which is more than those of a "
            f"robot do: check {check}, and that the {kind} did not move."
        )
    if fit.noise.contradiction > 0:
        sentences.append(
            f"In contact force and moment contradict a single force by {share(fit.noise.contradiction)}, and the "
            f"noise in the air is {share(in_air(fit))}: gains and cross-talk of the sensor's channels are estimated "
            "with the rig, what the touches do not tell of them is part of all uncertainties, and scans with this "
            "sensor have them too."
        )
    if worse := _worse_gains(fit):
        sentences.append(worse)
    excess = [_above_one(white[rows.used[:, equation], equation] ** 2) for equation in range(4)]
    runs = [_alike(fit, white[:, equation], rows.used[:, equation]) for equation in range(4)]
    # of the equations that only the wrench is in, and of those of the contact
    groups = slice(0, 2), slice(2, 4)
    squares = [1 + max(excess[group]) for group in groups]
    alike = [max(run for run, _ in runs[group]) for group in groups]
    deviates = [max(excess[group]) > 0 or any(certain for _, certain in runs[group]) for group in groups]
    # with a variance of 1.3 the model does not fit
    planar_model = _in_plane(fit)
    spoiled = planar_model or (any(deviates) and (rough or max(excess) > 0.3))
    covariance = fit.inverse @ fit.inverse.T
    for deviating, square, run, sentence in zip(deviates, squares, alike, (_WRENCHES, _CONTACTS), strict=True):
        if deviating:
            cause = _cause(fit, white, covariance, recording)
            by = f"{square**0.5:.2f} times what noise explains" + f", alike over {run:.0f} rows" * (run >= 1.5)
            effect = _SPOILS if spoiled else _ENLARGES
            sentences.append(sentence.format(kind=kind, off=by, effect=effect, cause=cause))
    if planar_model:
        sentences.append(_PLANAR.format(kind=kind, effect=_SPOILS))
    scatter = [float((white[used, k] ** 2).mean()) * runs[k][0] for k, used in enumerate(rows.used.T) if used.any()]
    enlarged = max(1.0, total if spoiled else max(scatter)) * (1 + fit.left**2)
    both = rows.used[:, :2].all(axis=1)
    consistency = float((white[both, :2] ** 2).mean()) if both.any() else 1.0
    fits = not (any(deviates) or rough)
    # what is known of the gains beforehand is not enlarged by misclosures
    gains = np.flatnonzero(fit.problem.free[GAINS:MIXING])
    beforehand = covariance[:, GAINS + gains] / fit.problem.beforehand(fit.noise)[gains]
    covariance = enlarged * covariance - (enlarged - 1) * beforehand @ beforehand.T
    return Checked(covariance, total / fit.freedom, consistency, tuple(sentences), spoiled, fits)


def _worse_gains(fit: Fit) -> str:
    """What the touches say against the stated accuracy of the sensor; empty if gains like those found may be chance.

    Touches do not tell a factor of all channels from the stiffness, so that of the moments is one against the forces.
    """
    free = np.flatnonzero(fit.problem.free[GAINS:MIXING])
    total, count = fit.evidence(GAINS, MIXING)
    if not len(free):
        return ""
    if not total * fit.noise.gains**2 > chdtri(max(count, 1.0), 2 * ndtr(-CHANCE)):
        return ""
    gains, moments = fit.rig.gains[free], free >= 3
    weight = np.linalg.inv(fit.inverse[GAINS + free] @ fit.inverse[GAINS + free].T)
    causes = {"moment-scale, the moments are": moments.astype(float)}
    causes |= {f"{CHANNELS[k]}-scale, {CHANNELS[k]} is": (free == k).astype(float) for k in free}
    # what the touches tell of each cause, by least squares
    sizes = {text: float(which @ weight @ gains / (which @ weight @ which)) for text, which in causes.items()}
    left = {text: float((off := gains - sizes[text] * causes[text]) @ weight @ off) for text in causes}
    best = min(left, key=lambda text: left[text])
    factors = [f"{CHANNELS[k]} {1 / (1 + fit.rig.gains[k]):.4g}" for k in free]
    # one cause is named where it explains nine tenths
    cause = f"several channels are recorded too large or too small, {', '.join(factors)} times"
    if left[best] < 0.1 * float(gains @ weight @ gains):
        cause = f"{best} recorded {1 / (1 + sizes[best]):.4g} times as large as the other channels say"
    stated = ", ".join(dict.fromkeys(map(share, fit.problem.accuracy[free])))
    return (
        f"The gains of the sensor that the touches show exceed its accuracy of {stated} {fit.noise.gains:.2g} times, and the "
        f"uncertainties are enlarged accordingly. The likeliest cause: {cause}; check the sensor's gains."
    )


def _above_one(square: Array) -> float:
    """By how much the mean of squares of normal numbers (n,) is above 1, and 0 where that may be chance."""
    if len(square) < 2:
        return 0.0
    above = float(square.mean()) - 1
    return above if above > CHANCE * float(square.std()) / np.sqrt(len(square)) else 0.0


def _alike(fit: Fit, white: Array, used: Mask) -> tuple[float, bool]:
    """Over how many rows white misclosures (n,) are alike, 1 for those of white noise, and whether more is no chance.

    The sum of autocorrelations ends where two that follow one another are not positive (Geyer, 1992).
    """
    touches = fit.problem.touches
    last, square = len(touches.number) - 1, float((white[used] ** 2).mean()) if used.any() else 1.0
    rows, pair, near, pairs_near = 1.0, 0.0, 0.0, 0
    for lag in range(1, 200):
        there = np.minimum(np.searchsorted(touches.number, touches.number + lag), last)
        both = (touches.number[there] == touches.number + lag) & (touches.sweep[there] == touches.sweep)
        both &= used & used[there]
        pairs, products = int(both.sum()), float((white * white[there])[both].sum())
        if not pairs:
            break
        pair += products / pairs / square
        if lag <= 3:
            near, pairs_near = near + products, pairs_near + pairs
        if lag % 2 == 0:
            if pair <= 0:
                break
            rows, pair = rows + 2 * pair, 0.0
    return rows, near > CHANCE * np.sqrt(max(pairs_near, 1))


def _cause(fit: Fit, white: Array, inverse: Array, recording: Recording) -> str:
    """The likeliest cause of contacts that deviate from the reference."""
    reference, rod = fit.rig.reference, recording.rod
    if isinstance(reference, Sphere):
        by_radius = np.where(fit.rows.used, -fit.rows.factor[:, :, 2], 0.0).ravel()
        by_rig = fit.jacobian[: len(by_radius)]
        left = by_radius - by_rig @ (inverse @ (by_rig.T @ by_radius))
        information, slope = float(left @ by_radius), float(left @ white.ravel())
        if information > 0 and slope**2 / information > 0.1 * float((white**2).sum()):
            diameter = 2 * rod.length_m * (reference.radius - slope / information) - rod.diameter_m
            return f"The likeliest cause is the diameter: one of {length(diameter, 'm', digits=4)} would fit better."
    return (
        f"The likeliest causes are {reference.unlike}, a rod that is not as stated, a second contact, one that "
        "sticks, poses that deviate from the clamp's path or by more than stated, and noise of the sensor that is "
        "alike in neighbouring rows."
    )


def in_air(fit: Fit) -> float:
    """The larger of the noises of force and moment, over the root mean square of those in contact."""
    noise = np.array([fit.noise.force, fit.noise.moment])
    return float((noise / np.sqrt(fit.problem.squares.mean(axis=0) / 3)).max())


def _in_plane(fit: Fit) -> bool:
    """Whether all of the six-axis forces lie in one plane of the sensor, as in a planar model, and the normals do not."""
    rig, touches = fit.rig, fit.problem.touches
    force = (touches.wrench - touches.basis @ rig.tare.T)[:, :3]
    out = np.linalg.svd(force, full_matrices=False)[2][-1]
    frame = touches.frame @ rig.clamp_axes()[0]
    point = touches.position + touches.frame @ rig.clamp + np.einsum("nij,nj->ni", frame, contacts(rig, touches)[0])
    normal = rig.reference.met(point, point).normal
    # without friction, which acts in the plane as long as the rod stays there
    expected = np.linalg.norm(force, axis=1) * np.einsum("ni,nij,j->n", normal, frame @ rig.turn, out)
    felt, due = (math.sqrt(np.nanmean(part**2)) for part in (force @ out, expected))
    return bool(fit.problem.channels.all()) and felt < 1.5 * fit.noise.force and due > CHANCE * fit.noise.force


_WRENCHES = (
    "In contact one of the moments about the rod and along the force deviates from zero by {off}: {effect}. Likely causes are "
    "noise of the sensor that is larger than stated or alike in neighbouring rows, friction across a thick rod, a second "
    "contact, a sensor whose channels mix, and a tare that changes within a sweep."
)
_CONTACTS = "The contacts deviate from the {kind}, or the rod from its tangent, by {off}: {effect}. {cause}"
_PLANAR = (
    "All forces lie in one plane, as those of a planar model or of a sensor with three channels, though the {kind} presses the "
    "rod out of it: {effect}."
)
_ENLARGES = "the uncertainties are enlarged by them"
_SPOILS = (
    "the model does not fit these touches, no quantity of the rig is called well determined, and the uncertainties "
    "are those of deviations that are alike in all rows"
)


FEWEST = 30
"""Rows in contact that a calibration needs."""
# Rigs that are tried where a fit is only begun.
_BEGUN = 12
_ALONG_ROD = np.array([0.0, 1.0, 0.0])


def calibrated(
    recording: Recording,
    reference: float | Literal["plane"],
    tare: str = "auto",
    pose_noise_m: float | None = None,
    sensor: Sensor | None = None,
) -> Fit:
    """The fit of a rig, as `scan3d.calibrate`; without a `sensor`, gains are exact."""
    if tare not in TARES:
        raise InputError(f"tare must be one of {', '.join(TARES)}, got {tare!r}")
    if pose_noise_m is not None and not 0 <= pose_noise_m < math.inf:
        raise InputError(f"the noise of the poses must be a number of metres >= 0, got {pose_noise_m!r}")
    rod = recording.rod
    if rod.bead_diameter_m:
        raise InputError(
            "a rod is calibrated by touches of itself, not of a bead on its tip; calibrate it without, and state "
            "bead_diameter_m in the rig's file afterwards"
        )
    touched = Plane.of(rod) if reference == Plane.kind else Sphere.of(reference, rod)
    place = pose_noise_m if pose_noise_m is not None else recording.noise_pose_m or None
    problem, nominal = measured(recording, touched, tare, sensor)
    first = 0.3 * ROBOTS if place is None else max(place / rod.length_m, NEGLIGIBLE)
    # relative errors of the wrench are usually some thousandths
    noise = Noise(problem.air.force_noise, problem.air.moment_noise, first, 2e-3 * problem.channels.all())
    fit = _of_rig(problem, nominal, noise, place)
    refusal = other = None
    try:
        _check(fit, recording)
    except InputError as error:
        refusal = error
    # where poses of a robot scatter as much as the contacts of a refused fit, no shape of the rod would mend it
    if is_shaped(fit) and (refusal is None or fit.noise.place > ROBOTS):
        other = _shaped(problem, nominal, noise, recording, place)
    if other is None and refusal is not None:
        raise refusal
    return other or fit


def _of_rig(problem: Problem, nominal: Rig, noise: Noise, place: float | None) -> Fit:
    """The fit from a nominal rig, begun with some rows; of a rod with a shape, which takes long, they are all."""
    step = max(1, len(problem.touches.kind) // (400 if nominal.marched else 10_000))
    few = problem.rows(np.arange(0, len(problem.touches.kind), step))
    rig = first_rig(few, nominal, noise)
    # the cosine of a tangential contact, and s1 of a tip contact in rod lengths, may be off for a first rig
    strong, rig = _with_kinds(_strong(few, rig, noise), rig, noise, None, 0.01)
    begun = fitted(strong, rig, noise, 1)
    if nominal.marched and not _away(begun) < 3 * ROBOTS:  # a fit would take long, and be none
        raise _no_fit(rig.reference, "")
    free = _determined(strong, rig, step * begun.normal)
    if (free != strong.free).any():
        rig = fitted(replace(strong, free=free), _at_nominal(rig, nominal, free), noise).rig
    length = rig.length if strong.free[LENGTH] else None
    free[LENGTH] |= length is None  # tip contacts may turn up later
    fit = _settled(replace(few, free=free), rig, noise, length, place is None)
    if step > 1 and not nominal.marched:  # the fit of some rows is near that of all
        length = fit.rig.length if fit.problem.free[LENGTH] else None
        fit = _settled(replace(problem, free=free), fit.rig, fit.noise, length, place is None)
    return fit if fit.problem.free[LENGTH] else replace(fit, rig=replace(fit.rig, length=nominal.length))


def _shaped(problem: Problem, nominal: Rig, noise: Noise, recording: Recording, place: float | None) -> Fit | None:
    """The fit of a rod whose shape is sought as well, if that explains all that the touches deviate by and is certain.

    A shape may make up in part for a wrong diameter of a sphere, or for what no rod does.
    """
    free = problem.free.copy()
    free[SHAPE:GAINS] = [True, True, problem.channels.all()]
    try:
        fit = _of_rig(replace(problem, free=free), replace(nominal, marched=True), noise, place)
        _check(fit, recording)
    except InputError:
        return None
    found = checked(fit, recording, place is None)
    variances = np.diag(found.covariance)[SHAPE:GAINS]
    certain = (variances > 0) & (fit.rig.shape**2 > CHANCE**2 * variances)
    return fit if certain.any() and found.fits else None


def measured(
    recording: Recording, reference: Reference, tare: str, sensor: Sensor | None = None
) -> tuple[Problem, Rig]:
    """The rows in contact and in the air, dimensionless, and the nominal rig."""
    rod, known, six = recording.rod, recording.noise, recording.six_axis
    if not six and not isinstance(reference, Sphere):
        raise InputError(
            f"a calibration by touches of {reference.title} needs forces and moments with all six components; with "
            "three, touch a sphere"
        )
    channels, wrench = six_channels(recording)
    unit = np.repeat([rod.force_unit_N, rod.moment_unit_Nm], 3)
    wrench = wrench / unit
    air = unloaded(recording.sweep, wrench, channels, (known.force_N / unit[0], known.moment_Nm / unit[3]), tare)
    around = neighbours(wrench, recording.sweep, air.contact)
    force = np.linalg.norm((around - air.basis @ air.tare.T)[:, :3], axis=1)
    rows = np.flatnonzero(air.contact & (force > 20 * air.force_noise))
    if len(rows) < FEWEST:
        raise InputError(
            f"the recording has {len(rows)} rows in contact that stand out from the noise, and a calibration needs "
            f"{FEWEST}: touch the {reference.kind} in more sweeps, bend the rod more, and let each sweep begin and end with "
            "rows in the air, which show zero and noise"
        )
    position = recording.position_m[rows] / rod.length_m
    frame = recording.axes()[rows].swapaxes(1, 2)
    kind = np.full(len(rows), Kind.EITHER, dtype=np.int8)
    touches = Touches(wrench[rows], position, frame, air.basis[rows], recording.sweep[rows], rows, around[rows], kind)
    free = np.ones(TARE + air.tare.size, dtype=bool)
    free[SHAPE:TARE] = False
    accuracy, stated = sensor or Sensor(np.zeros(6), Frame(np.zeros(3), np.eye(3)))
    free[GAINS:MIXING] = channels & (accuracy > 0)
    reference = replace(reference, origin=position.mean(axis=0))
    if not six:
        free[[TILT, TURN, TURN + 1, SENSOR + 2]] = False
        free[TARE:] = np.repeat(channels, air.basis.shape[1])
        # sweeps in a plane tell how far it is from the sphere's centre by the square only: its normal is one of the axes
        reference = replace(reference, axes=frame[0])
        free[[CLAMP + 2, PLACE + 2]] = np.ptp(position @ frame[0, :, 2]) > 0.1 * reference.size
    light = replace(rod, weight_N=0.0)
    nominal = Rig(
        stiffness=0.0,
        clamp=np.zeros(3),
        tilt=np.zeros(2),
        turn=stated.turn,
        sensor=stated.position_m / rod.length_m,
        reference=reference,
        length=1.0,
        tare=air.tare,
        gains=np.zeros(6),
        mixing=np.zeros((6, 6)),
        stated=light.in_space(),
        shape=np.zeros(3),
        marched=not light.is_simple,
    )
    return Problem(touches, air, channels, free, accuracy), nominal


def _settled(problem: Problem, rig: Rig, noise: Noise, length: float | None, estimate: bool) -> Fit:
    """The fit of rows that their neighbours choose, with the kinds of contacts and the noise of the poses at rest."""
    seen: set[tuple[bytes, bytes]] = set()
    for _ in range(8):
        problem.free[GAINS:MIXING] &= noise.gains > 0
        rig = rig if noise.gains else replace(rig, gains=np.zeros(6))
        problem.free[MIXING:TARE] = noise.mixing > 0
        chosen, rig = _with_kinds(_strong(problem, rig, noise), rig, noise, length)
        # a rod whose shape is sought takes long, and a shape that is one is soon found from the first rig
        fit = fitted(chosen, rig, noise, *[_BEGUN] * bool(problem.free[SHAPE] and not seen))
        if problem.free[SHAPE] and not fit.at_rest:
            break
        rig, length = fit.rig, fit.rig.length if chosen.free[LENGTH] else None
        noise = estimates(fit, estimate)
        # few rows may alternate between two states
        state = chosen.touches.number.tobytes(), chosen.touches.kind.tobytes()
        if state in seen and np.allclose(noise, fit.noise, rtol=0.01, atol=NEGLIGIBLE):
            break
        seen.add(state)
    return fit


def _strong(problem: Problem, rig: Rig, noise: Noise) -> Problem:
    """The rows whose contacts are known well enough along the rod, by their neighbours."""
    scale = np.exp(-rig.stiffness)
    force, moment = clamp_wrench(rig, problem.touches._replace(wrench=problem.touches.around))
    by_s1 = scale * bent(rig, scale * force, scale * moment).by_s1
    deviation = np.repeat([noise.force, np.hypot(noise.moment, np.linalg.norm(rig.sensor) * noise.force)], 3)
    with np.errstate(invalid="ignore"):  # farther off, the reference curves within the errors of a row
        strong = np.linalg.norm(by_s1 * deviation, axis=1) < 0.12 * rig.reference.size
    if (count := int(strong.sum())) < FEWEST:
        raise _no_fit(
            rig.reference,
            f", or touch it too lightly: {count} rows place the contact to {rig.reference.extent}, and a calibration "
            f"needs {FEWEST}",
        )
    return problem.rows(strong)


def _with_kinds(
    problem: Problem, rig: Rig, noise: Noise, length: float | None, slack: float = 0.0
) -> tuple[Problem, Rig]:
    """The problem with the kinds of contacts that their neighbours make likelier, and the rig with its free length.

    `length` is that length if it is known; otherwise the contacts tell with which one they are likeliest.  Without tip
    contacts it is not sought.  A tangential contact does not lie past the tip, and at the tip the rod does not point away
    from the reference: what contradicts this counts as a misfit as well.
    """
    tangential, tip = (
        adjusted(problem.with_kinds(np.full_like(problem.touches.kind, kind)), rig, noise, slack=slack)
        for kind in (Kind.TANGENTIAL, Kind.TIP)
    )
    known = tangential.used[:, 3] & tip.used[:, 3]
    variances = noise.variances(problem)
    cosine_sd, s1_sd = (
        np.sqrt((rows.by_row[:, 3] ** 2 * variances).sum(axis=1) + slack**2 + ~known) for rows in (tangential, tip)
    )
    tried = [rig.length if length is None else length]
    if length is None and known.any():
        tried = list(rig.length + np.quantile(tip.misclosure[known, 3], np.linspace(0.3, 1.0, 71)))
    costs = []
    for shift in rig.length - np.array(tried):
        # a shorter rod moves the fourth equation of the tip only
        as_tip = tip.white + shift * tip.factor[:, :, 3]
        costs.append(
            (
                (tangential.white**2).sum(axis=1) + np.maximum((tip.misclosure[:, 3] + shift) / s1_sd, 0) ** 2,
                (as_tip**2).sum(axis=1) + np.maximum(tangential.misclosure[:, 3] / cosine_sd, 0) ** 2,
            )
        )
    best = int(np.argmin([np.minimum(*cost)[known].sum() for cost in costs]))
    likelier = np.where(known, costs[best][0] - costs[best][1], 0.0)
    kind = _by_neighbours(likelier, problem.touches.sweep)
    # a few rows that contradict their neighbours, such as those after a jump, would spoil the fit of all
    kind[np.where(kind == Kind.TIP, -likelier, likelier) > CHANCE**2] = Kind.UNSURE
    tips = kind == Kind.TIP
    if tips.sum() < 8:  # too few to tell the length
        kind[tips] = Kind.UNSURE
    free = problem.free.copy()
    free[LENGTH] &= bool((kind == Kind.TIP).any())
    return replace(problem.with_kinds(kind), free=free), replace(rig, length=float(tried[best]))


def _by_neighbours(likelier: Array, sweep: NDArray[np.int64]) -> NDArray[np.int8]:
    """The kinds (n,) of contacts, by how much likelier the tip is for the rows before and after them in their sweep.

    Contacts change their kind now and then.  A change costs as much as the evidence that makes a kind certain, so that no
    more than this is handed on from row to row (the Viterbi algorithm for two states).
    """
    kind, certain = np.full(len(likelier), Kind.UNSURE, dtype=np.int8), 12.0
    for number in np.unique(sweep):
        rows = np.flatnonzero(sweep == number)
        around = np.zeros(len(rows))
        for order in (slice(None), slice(None, None, -1)):
            total = 0.0
            for place in np.arange(len(rows))[order]:
                around[place] += total
                total = min(max(total + float(likelier[rows[place]]), -certain), certain)
        kind[rows[around <= -certain]] = Kind.TANGENTIAL
        kind[rows[around >= certain]] = Kind.TIP
    return kind


def _determined(problem: Problem, rig: Rig, normal: Array) -> Mask:
    """The parameters (p,) that a normal matrix determines; of those it determines only together, some are left out."""
    free = problem.free.copy()
    widths, order = problem.widths_and_ranks
    while True:
        rows = np.flatnonzero(free)
        size, vectors = np.linalg.eigh((normal * widths[:, None] * widths)[np.ix_(rows, rows)])
        if size[0] > max(1.0, ROUNDING * size[-1]):
            break
        part = np.abs(vectors[:, 0]) * order[rows]
        if part.max() < 1e-3:  # what is left has no nominal value
            raise InputError(
                f"the touches do not determine the {rig.reference.kind}'s place: sweep it in more directions of the "
                "rod, with the clamp turned about the rod's axis, and bend the rod more"
            )
        free[rows[np.argmax(part)]] = False
    about_rod = rows == TURN + 1
    if about_rod.any():
        variance = float(((vectors[about_rod] * widths[TURN + 1]) ** 2 / size).sum())
        # without friction the distance from the reference depends on this turn to the second order only, so that linear
        # uncertainties of more than a hundredth of a radian do not hold
        free[TURN + 1] = variance < 0.01**2
    return free


def _at_nominal(rig: Rig, nominal: Rig, free: Mask) -> Rig:
    """The rig with the parameters that are not determined at their nominal values."""
    return replace(
        rig,
        stiffness=rig.stiffness if free[STIFFNESS] else nominal.stiffness,
        clamp=np.where(free[CLAMP:TILT], rig.clamp, nominal.clamp),
        tilt=np.where(free[TILT:TURN], rig.tilt, nominal.tilt),
        turn=rig.turn if free[TURN:SENSOR].any() else nominal.turn,
        sensor=np.where(free[SENSOR:PLACE], rig.sensor, nominal.sensor),
        length=rig.length if free[LENGTH] else nominal.length,
        shape=np.where(free[SHAPE:GAINS], rig.shape, nominal.shape),
    )


def _check(fit: Fit, recording: Recording) -> None:
    """Raise InputError for a fit that is none, with what was seen."""
    used, noise = fit.rows.used[:, 2], fit.noise
    usable = used.sum() >= max(FEWEST, 0.3 * len(used))
    normal = np.diag(fit.normal)[fit.problem.free]
    known = np.isfinite(normal).all() and (normal > 0).all()
    # what deviates by more is not a rod, or not a sensor, that is read rightly, or not this reference
    fits = noise.relative <= 0.1 and noise.place <= 10 * ROBOTS
    if fits and fit.at_rest and usable and known and abs(fit.rig.stiffness) < 2.5:
        return
    seen = [f"the noise in the air is {share(in_air(fit))}"]
    if fit.problem.channels.all():
        seen.insert(0, f"force and moment contradict a single force by {share(noise.relative)}")
    if used.any():
        away = recording.rod.length_m * _away(fit)
        seen.append(f"{used.sum()} of {len(used)} contacts lie {length(away, 'm', digits=2)} from it in the median")
    raise _no_fit(fit.rig.reference, f" ({', '.join(seen)})")


def _away(fit: Fit) -> float:
    """The median distance of the contacts from the reference, in rod lengths; NaN without any."""
    away = np.abs(fit.rows.misclosure[fit.rows.used[:, 2], 2])
    return float(np.median(away)) if len(away) else math.nan


def _no_fit(reference: Reference, detail: str) -> InputError:
    return InputError(
        f"the touches do not fit {reference.title}{detail}: check {reference.check}, the rod, the units and signs of "
        f"forces and moments, that each sweep begins and ends in the air, and that the {reference.kind} did not move"
    )


def first_rig(problem: Problem, nominal: Rig, noise: Noise) -> Rig:
    """A rig whose contacts lie near the reference and, where they are far from the tip, are tangential.

    It is sought on a grid with some rows, and improved with more.
    """
    free = problem.free.copy()
    free[LENGTH:] = False  # the tare is that of the rows in the air
    # a straight and uniform rod, of which the fit in closed form is fast, is a start for one whose shape is sought
    nominal = replace(nominal, marched=not nominal.stated.is_straight_and_uniform)
    # contacts of light touches are far from linear in the noise
    force = np.linalg.norm((problem.touches.wrench - problem.touches.basis @ nominal.tare.T)[:, :3], axis=1)
    heavy = np.flatnonzero(force >= np.median(force))
    coarse = replace(problem.rows(evenly(heavy, 400)), free=free)
    searched = rows_of(coarse.touches, evenly(np.arange(len(coarse.touches.kind)), 150))
    if problem.channels.all():
        turns, frames, offsets = (
            np.radians(np.arange(0, 360, 15)),
            *_by_consistency(nominal, coarse.touches, noise),
        )
    else:
        frames = [Rotation.from_euler("z", angle).as_matrix() for angle in np.radians(np.arange(-60, 61, 15))]
        turns, offsets = np.zeros(1), [nominal.sensor] * len(frames)
    grid = [
        scored
        for frame, offset in zip(frames, offsets, strict=True)
        for scored in _on_grid(replace(nominal, turn=frame, sensor=offset), searched, turns, free)
    ]
    rigs = [rig for _, rig in sorted(grid, key=lambda scored: scored[0])[:4]]
    rigs += [replace(nominal, reference=rig.reference) for rig in rigs[:1]]
    if not rigs:
        return nominal
    # a rod that is not straight leads exact fits astray, unless contacts and wrenches may be off by its shape
    rough = noise._replace(place=0.03, relative=0.03)
    begun = [fitted(_far_from_tip(coarse, rig), rig, rough, _BEGUN) for rig in rigs]
    begun.sort(key=lambda fit: fit.cost)
    best = begun[0].rig
    if problem.free[SHAPE]:
        if not _away(begun[0]) < 10 * ROBOTS:  # as far as contacts of no fit
            raise _no_fit(best.reference, "")
        free[SHAPE:GAINS] = problem.free[SHAPE:GAINS]
        coarse = replace(problem.rows(evenly(heavy, 150)), free=free)
        return _with_shape(coarse, [fit.rig for fit in begun], noise, rough)
    return fitted(_far_from_tip(coarse, best), best, noise).rig


def _with_shape(problem: Problem, rigs: list[Rig], noise: Noise, rough: Noise) -> Rig:
    """The first of rigs with straight rods, the best ones first, from which a fit leads to a shape that noise explains, or
    the one with the best fit."""
    found: list[Fit] = []
    for rig in rigs[:3]:
        rig = replace(rig, marched=True)
        begun = fitted(_far_from_tip(problem, rig), rig, rough, _BEGUN).rig
        found.append(fitted(_far_from_tip(problem, begun), begun, noise, _BEGUN))
        if found[-1].at_rest and found[-1].cost < found[-1].freedom + CHANCE * math.sqrt(2 * found[-1].freedom):
            break
    return min(found, key=lambda fit: fit.cost).rig


def _far_from_tip(problem: Problem, rig: Rig) -> Problem:
    """The problem in which contacts that are certainly not at the tip are tangential; for a rough rig."""
    s1 = contacts(rig, problem.touches)[1]
    known = s1[np.isfinite(s1)]
    far = s1 < 0.85 * np.quantile(known, 0.98) if len(known) else np.zeros(len(s1), dtype=bool)
    return problem.with_kinds(np.where(far, Kind.TANGENTIAL, Kind.EITHER).astype(np.int8))


def _by_consistency(nominal: Rig, touches: Touches, noise: Noise) -> tuple[list[Array], list[Array]]:
    """Turns of the sensor, up to one about the rod, and its places, up to one along the rod."""
    tared = touches.wrench - touches.basis @ nominal.tare.T
    deviation = np.repeat([noise.moment, noise.force], 3)
    _, size, rows = np.linalg.svd(np.roll(tared, 3, axis=1) / deviation, full_matrices=False)
    along, offset = _ALONG_ROD, np.zeros(3)
    if size[-2] > 1.3 * size[-1]:  # else the rod's direction does not follow from the wrench
        solution = rows[-1] / deviation
        along, cross = solution[:3] / np.linalg.norm(solution[:3]), solution[3:] / np.linalg.norm(solution[:3])
        offset = np.cross(cross, along)
    frames = [Rotation.align_vectors([_ALONG_ROD], [axis])[0].as_matrix() for axis in (along, -along)]
    return frames, [frame @ offset for frame in frames]


def _on_grid(rig: Rig, touches: Touches, turns: Array, free: Mask) -> list[tuple[float, Rig]]:
    """Rigs of a grid about a rig: with turns about the rod, distances along it in rod lengths, and logarithms of the stiffness,
    and the median distance of their contacts from the reference."""
    scored = []
    outside = touches.position.mean(axis=0)
    turned = Rotation.from_rotvec(np.outer(turns, _ALONG_ROD)).as_matrix()
    for along in np.linspace(-1.0, 1.0, 21):
        for stiffness in np.log([0.5, 0.7, 1.0, 1.4, 2.0]):
            moved = replace(rig, sensor=rig.sensor + along * _ALONG_ROD, stiffness=float(stiffness))
            point = contacts(moved, touches)[0]
            known: Mask = np.asarray(np.isfinite(point).all(axis=1))
            if known.sum() < max(len(known) / 2, 8):
                continue
            world = np.einsum("nij,tjk,nk->tni", touches.frame[known], turned, point[known]) + touches.position[known]
            best, reference, misfit = rig.reference.nearest(world, outside)
            # what is not sought of its place is that of the nominal rig
            back = reference.axes.T @ (rig.reference.origin - reference.origin)
            reference = reference.moved(np.where(free[PLACE:LENGTH], 0.0, back))
            better = replace(
                moved,
                turn=turned[best] @ rig.turn,
                sensor=turned[best] @ moved.sensor,
                reference=reference,
            )
            scored.append((misfit + float((~known).mean()), better))
    return scored
