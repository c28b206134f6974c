"""Least squares with errors in all measured values, by which touches of a reference give the rig.

The equations of `model` hold between the true values of a row (the Gauss-Helmert model: Helmert, 1872; Niemeier, 2008,
chapter 5).  For a rig the measured values of each row are adjusted by the least corrections, in standard deviations, with
which its equations hold.  Linearised there, the misclosures ``w`` of the measured values have the covariance ``B Σ Bᵀ``, and
the corrections have the sum of squares ``wᵀ (B Σ Bᵀ)⁻¹ w``: white misclosures, whose sum of squares depends on the rig alone,
and has the derivatives that the equations have at the adjusted values.  Weights and derivatives at the measured values
instead would be correlated with the noise, and bias the parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, least_squares

from scan3d.arrays import NEGLIGIBLE, ROUNDING, Array, Index, Mask
from scan3d.calibration.model import (
    CLAMP,
    LENGTH,
    MIXING,
    PLACE,
    SENSOR,
    STIFFNESS,
    TARE,
    TILT,
    TURN,
    Equations,
    Rig,
    Touches,
    equations,
)
from scan3d.calibration.references import Unloaded

# Widths within which parameters are known without any touch: those that the touches leave less certain are not determined.
# Of the stiffness's logarithm, lengths in rod lengths, angles in radians, and the tare in EI/L² and EI/L.
_WIDTHS = {
    STIFFNESS: 0.5,
    CLAMP: 0.1,
    TILT: 0.3,
    TURN: 0.5,
    SENSOR: 0.3,
    PLACE: 1.0,
    LENGTH: 0.1,
    MIXING: 1.0,
    TARE: 1.0,
}
# Rounds in which the measured values of a row are adjusted to a rig, and rigs that a fit tries at most.
_ADJUSTMENTS, _TRIALS = 3, 50
# What a row without a rod counts in standard deviations: more than rows that are far off, because rigs for which no row has
# a rod would fit best otherwise.
_NO_ROD = 100.0
# Length of the step, in standard deviations, that is left to the least sum of squares where a fit is at rest.
_SMALL = 0.03
# Standard deviations of a sum of squares that count as chance.
CHANCE = 4.5
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
        return by_parameter(_WIDTHS, len(self.free))

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


def by_parameter(table: dict[int, float], count: int) -> Array:
    """(p,) values of parameters from those of the groups that begin at the keys."""
    first = np.array(sorted(table))
    return np.array([table[first[first <= number][-1]] for number in range(count)])


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
    return np.asarray(np.isfinite(found.value).all(axis=1) & np.isfinite((found.by_row**2).sum(axis=(1, 2))))


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
