"""Least squares with errors in all measured values, by which touches of a reference give the rig.

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
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, least_squares
from scipy.special import chdtri, ndtr

from scan3d.arrays import NEGLIGIBLE, ROUNDING, Array, Index, Mask, evenly
from scan3d.calibration.model import (
    CLAMP,
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
    Rig,
    Touches,
    equations,
)
from scan3d.calibration.references import CHANCE, Sphere, Unloaded
from scan3d.recording import Recording
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
    MIXING: (1.0, 0.0),
    TARE: (1.0, 0.0),
}
# Rounds in which the measured values of a row are adjusted to a rig, and rigs that a fit tries at most.
_ADJUSTMENTS, _TRIALS = 3, 50
# What a row without a rod counts in standard deviations: more than rows that are far off, because rigs for which no row has
# a rod would fit best otherwise.
_NO_ROD = 100.0
# Length of the step, in standard deviations, that is left to the least sum of squares where a fit is at rest.
_SMALL = 0.1
# The largest noise that is estimated: of the poses in rod lengths, and of the wrench relative to it.
_LARGEST = 0.3


class Noise(NamedTuple):
    """Standard deviations of each component, dimensionless."""

    force: float
    moment: float
    place: float
    relative: float = 0.0
    """Of force and moment over their sizes, independent from row to row."""
    mixing: float = 0.0
    """Of gains and cross-talk that are the same in all rows, for channels as large as in the mean of the touches."""
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

    def rows(self, selected: Mask | Index) -> Problem:
        return replace(self, touches=self.touches.rows(selected))

    def with_kinds(self, kind: NDArray[np.int8]) -> Problem:
        """The problem with the kinds (n,) of its contacts."""
        return replace(self, touches=self.touches._replace(kind=kind))

    @property
    def widths(self) -> Array:
        return self._groups[:, 0]

    @property
    def ranks(self) -> Array:
        """(p,) of those that are determined only together, the first to stay at its nominal value has the largest."""
        return self._groups[:, 1]

    @property
    def _groups(self) -> Array:
        first = np.array(list(_WIDTHS_AND_RANKS))
        group = np.searchsorted(first, np.arange(len(self.free)), side="right") - 1
        return np.array(list(_WIDTHS_AND_RANKS.values()))[group]

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
    at_rest: bool
    """Whether this is a least sum of squares."""

    @property
    def normal(self) -> Array:
        """(p, p) normal matrix."""
        return np.asarray(self.jacobian.T @ self.jacobian)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the rows: the parameters that they determine count with them, the tare with the air."""
        determined = int(self.problem.free[:MIXING].sum()) + round(self.mixing[1])
        return max(int(self.rows.used.sum()) - determined, 1)

    @property
    def mixing(self) -> tuple[float, float]:
        """The sum of squares of gains and cross-talk, and how many of them the rows determine rather than their own width."""
        free = np.flatnonzero(self.problem.free[MIXING:TARE])
        if not len(free):
            return 0.0, 0.0
        unit = self.problem.mixing_units[free]
        known = np.linalg.pinv(self.jacobian)[MIXING + free]
        unknown = float(((known**2).sum(axis=1) / unit**2).sum()) / self.noise.mixing**2
        return float(((self.rig.mixing.ravel()[free] / unit) ** 2).sum()), len(free) - unknown


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
    for number in range(_ADJUSTMENTS + 1):
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
    white[~good, 0] = _NO_ROD
    white_by_rig = factor @ np.where(used[:, :, None], found.by_rig, 0.0)
    return Rows(used, misclosure, by_row, factor, white, white_by_rig)


def _finite(found: Equations) -> Mask:
    sizes = (found.value**2).sum(axis=1) + (found.by_row**2).sum(axis=(1, 2)) + (found.by_rig**2).sum(axis=(1, 2))
    return np.asarray(np.isfinite(sizes))


def fitted(problem: Problem, rig: Rig, noise: Noise, trials: int = _TRIALS) -> Fit:
    """The fit from a rig nearby, or the best of so many rigs that are tried.

    Parameters that nothing depends on do not move: a step of their width counts as much as a standard deviation.
    """
    free = np.flatnonzero(problem.free)
    widths = problem.widths[free]
    weight = problem.channels / np.repeat([noise.force, noise.moment], 3)
    mixed = np.flatnonzero(problem.free[MIXING:TARE])
    likely = np.zeros((len(mixed), len(problem.free)))
    likely[range(len(mixed)), MIXING + mixed] = 1 / (noise.mixing * problem.mixing_units[mixed]) if len(mixed) else 0.0
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
        mixing = likely[:, MIXING:TARE] @ moved.mixing.ravel()
        residual = np.concatenate([rows.white.ravel(), tare, mixing, x / widths])
        by_rig = rows.white_by_rig.reshape(-1, len(step))
        return (
            moved,
            rows,
            residual,
            np.vstack([by_rig[:, free], in_air[:, free], likely[:, free], np.diag(1 / widths)]),
        )

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
    at_rest = bool(np.linalg.norm(np.linalg.qr(slopes)[0].T @ residual) < _SMALL)
    return Fit(problem, moved, noise, rows, jacobian, 2 * float(found.cost), at_rest)


def estimates(fit: Fit, place: bool) -> Noise:
    """The noise that the misclosures of a fit have; that of the poses is estimated only if `place` is true.

    Relative errors of the wrench follow from the equations that only the wrench is in, where these contradict a single force
    by more than chance.
    """
    noise, problem = fit.noise, fit.problem
    if problem.channels.all():
        total, count = fit.mixing
        alone = fit.rows.used[:, :2]
        freedom = max(float(alone.sum()) - int(problem.free[TURN:PLACE].sum()) - count, 1.0)
        if _excess(fit, noise._replace(relative=0.0), slice(0, 2)) > freedom + CHANCE * math.sqrt(2 * freedom):
            noise = _estimated(fit, noise, "relative", slice(0, 2), freedom)
            if not count:
                noise = noise._replace(mixing=noise.relative, contradiction=noise.relative)
        else:
            noise = noise._replace(relative=0.0)
        if count > 1:
            # errors that are alike in all rows are not much larger than the contradiction that they explain
            noise = noise._replace(mixing=min(max(math.sqrt(total / count), NEGLIGIBLE), 2 * noise.contradiction))
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

    low, high = math.log(NEGLIGIBLE), math.log(_LARGEST)
    if excess(low) <= 0 or excess(high) >= 0:
        return noise._replace(**{name: NEGLIGIBLE if excess(low) <= 0 else _LARGEST})
    return noise._replace(**{name: math.exp(brentq(excess, low, high, rtol=1e-4))})


# Rows by which the shape of a rod is tested.
_TESTED = 1000


def is_shaped(fit: Fit) -> bool:
    """Whether touches contradict the shape of the rod by more than chance: what its taper and curvature would explain of the
    sum of squares, to the first order, exceeds what they would of noise (the score test)."""
    problem = fit.problem
    if problem.free[SHAPE]:
        return False
    few = problem.rows(evenly(np.arange(len(problem.touches.kind)), _TESTED))
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
    scatter = float(residual @ residual) / max(int(rows.used.sum()) - int(problem.free[:MIXING].sum()), 1)
    return bool(((axes.T @ residual) ** 2).sum() > scatter * chdtri(axes.shape[1], 2 * ndtr(-CHANCE)))


ROBOTS = 1e-3
"""Noise of a robot's poses, at most, in rod lengths."""
# Variance beyond 1 of the misclosures of an equation with which the model does not fit.
_SPOILED = 0.3
# Lags in rows whose mean product tells deviations that are alike, and those up to which these are followed.
_NEAR, _FARTHEST = 3, 200
# Part of the deviations that one cause must explain to be named alone, and the scatter of the reactions across their plane,
# in standard deviations of the noise, up to which they lie in a plane.
_EXPLAINS, _FLAT = 0.1, 1.5


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
        sentences.append(_IN_THE_AIR.format(factor=air.misfit**0.5))
    rough = estimated and fit.noise.place > ROBOTS
    if rough:
        off = length(fit.noise.place * recording.rod.length_m, "m", digits=2)
        sentences.append(_ROUGH_POSES.format(off=off, kind=kind, check=_CHECK[kind]))
    if fit.noise.contradiction > 0:
        sentences.append(_CONTRADICTS.format(wrench=share(fit.noise.contradiction), air=share(in_air(fit))))
    excess = [_above_one(white[rows.used[:, equation], equation] ** 2) for equation in range(4)]
    runs = [_alike(fit, white[:, equation], rows.used[:, equation]) for equation in range(4)]
    # of the equations that only the wrench is in, and of those of the contact
    groups = slice(0, 2), slice(2, 4)
    squares, alike = (
        [1 + max(excess[group]) for group in groups],
        [max(run for run, _ in runs[group]) for group in groups],
    )
    deviates = [max(excess[group]) > 0 or any(certain for _, certain in runs[group]) for group in groups]
    spoiled = any(deviates) and (rough or max(excess) > _SPOILED or _in_plane(fit))
    inverse = np.linalg.pinv(fit.jacobian)
    covariance = inverse @ inverse.T
    for deviating, square, run, sentence in zip(deviates, squares, alike, (_WRENCHES, _CONTACTS), strict=True):
        if deviating:
            cause = _cause(fit, white, covariance, recording)
            by = f"{square**0.5:.2f} times what noise explains" + f", alike over {run:.0f} rows" * (run >= 1.5)
            effect = _SPOILS if spoiled else _ENLARGES
            sentences.append(sentence.format(kind=kind, off=by, effect=effect, cause=cause))
    scatter = [float((white[used, k] ** 2).mean()) * runs[k][0] for k, used in enumerate(rows.used.T) if used.any()]
    enlarged = max(1.0, total if spoiled else max(scatter))
    both = rows.used[:, :2].all(axis=1)
    consistency = float((white[both, :2] ** 2).mean()) if both.any() else 1.0
    return Checked(
        enlarged * covariance, total / fit.freedom, consistency, tuple(sentences), spoiled, not (any(deviates) or rough)
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
    for lag in range(1, _FARTHEST):
        there = np.minimum(np.searchsorted(touches.number, touches.number + lag), last)
        both = (touches.number[there] == touches.number + lag) & (touches.sweep[there] == touches.sweep)
        both &= used & used[there]
        pairs, products = int(both.sum()), float((white * white[there])[both].sum())
        if not pairs:
            break
        pair += products / pairs / square
        if lag <= _NEAR:
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
        if information > 0 and slope**2 / information > _EXPLAINS * float((white**2).sum()):
            diameter = 2 * rod.length_m * (reference.radius - slope / information) - rod.diameter_m
            return f"The likeliest cause is the diameter: one of {length(diameter, 'm', digits=4)} would fit better."
    return _PLANAR.format(kind=reference.kind) if _in_plane(fit) else _SHAPE.format(unlike=reference.unlike)


def in_air(fit: Fit) -> float:
    """The larger of the noises of force and moment, over the root mean square of those in contact."""
    noise = np.array([fit.noise.force, fit.noise.moment])
    return float((noise / np.sqrt(fit.problem.squares.mean(axis=0) / 3)).max())


def _in_plane(fit: Fit) -> bool:
    """Whether all of the six-axis forces lie in one plane of the sensor, as in a planar model."""
    touches = fit.problem.touches
    force = (touches.wrench - touches.basis @ fit.rig.tare.T)[:, :3]
    scatter = float(np.linalg.svd(force, compute_uv=False)[-1]) / np.sqrt(len(force))
    return bool(fit.problem.channels.all()) and scatter < _FLAT * fit.noise.force


_CHECK = {"sphere": "the diameters of sphere and rod", "plane": "the flatness of the plane"}
_ROUGH_POSES = (
    "The contacts deviate from the {kind} as if the poses scattered by {off}, which is more than those of a robot do: "
    "check {check}, and that the {kind} did not move."
)
_IN_THE_AIR = (
    "In the air the reactions scatter by {factor:.2f} times the stated noise: the sensor drifts otherwise than the tare "
    "assumes, or the noise is larger than stated; what is found in the air was used instead."
)
_CONTRADICTS = (
    "In contact force and moment contradict a single force by {wrench}, and the noise in the air is {air}: gains and "
    "cross-talk of the sensor's channels are estimated with the rig, what the touches do not tell of them is part of all "
    "uncertainties, and scans with this sensor have them too."
)
_WRENCHES = (
    "In contact the moments about the rod and along the force deviate from zero by {off}: {effect}. The likeliest causes are "
    "noise of the sensor that is larger than stated or alike in neighbouring rows, friction across a thick rod, a second "
    "contact, a sensor whose channels mix, and a tare that changes within a sweep."
)
_CONTACTS = "The contacts deviate from the {kind}, or the rod from its tangent, by {off}: {effect}. {cause}"
_ENLARGES = "the uncertainties are enlarged by them"
_SPOILS = (
    "the model does not fit these touches, no quantity of the rig is called well determined, and the uncertainties are those "
    "of deviations that are alike in all rows"
)
_PLANAR = (
    "The likeliest cause is a log whose forces lie in one plane, of a planar model or of a sensor with three channels; a rod "
    "that slides sideways over a {kind} has none such."
)
_SHAPE = (
    "The likeliest causes are {unlike}, a rod that is not as stated, a second contact, one that sticks, poses that deviate "
    "from the clamp's path or by more than stated, and noise of the sensor that is alike in neighbouring rows."
)
