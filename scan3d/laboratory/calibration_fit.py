"""Least squares with errors in all measured values: the Gauss-Helmert model (Helmert, 1872; Niemeier, 2008, chapter 5).

The equations of `calibration_model` hold between the true values of a row.  Linearised at adjusted values of the measurements,
their misclosures have the covariance ``B Σ Bᵀ``; the adjusted values move with the parameters until both are at rest.  Weights
and derivatives taken at the measured values instead would be correlated with the noise, and bias the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array, Mask
from scan3d.laboratory.calibration_model import TARE, Equations, Rig, Touches, equations
from scan3d.laboratory.calibration_reference import Reference

# Iterations at most, of the damped start and of the adjustment, and the steps in standard deviations at which they end.
_START_STEPS, _STEPS, _ENOUGH, _SMALL = 60, 30, 0.05, 1e-4
# For bodies with edges, where contacts may alternate between an edge and a face next to it: iterations after which the adjusted
# values move by half of their steps; steps in standard deviations that need not fall any more; and the fraction to which a step
# must fall.
_WHOLE, _NEARLY, _FALLS = 5, 0.05, 0.8
# Iterations of the adjusted values of a row for a rig that is known.
_ROW_STEPS = 3
# Damping of the first step and by how much it falls or rises, relative to the normal matrix's diagonal (Marquardt).
_DAMPING, _EASED, _RAISED, _MOST = 1e-2, 0.2, 5.0, 1e8
# Longest step of a parameter in its widths.
_LONGEST = 2.0
# What a row without a rod adds to the sum of squares while the start is sought: more than rows that are far off, because rigs
# for which no row has a rod would fit best otherwise.
_NO_ROD = 1e4


class Noise(NamedTuple):
    """Standard deviations of each component, dimensionless."""

    force: float
    moment: float
    place: float

    def variances(self, channels: Mask) -> Array:
        """(9,) of a row's measured values; channels (6,) that were not measured are known to vanish."""
        reactions = np.repeat([self.force, self.moment], 3) ** 2
        return np.concatenate([np.where(channels, reactions, 0.0), np.full(3, self.place**2)])


class Air(NamedTuple):
    """Rows (n,) in which nothing touches."""

    wrench: Array
    """(n, 6)"""
    basis: Array
    """(n, k)"""
    rows: NDArray[np.intp]
    """(n,) their numbers in the recording."""


@dataclass(frozen=True)
class Problem:
    """What is measured, and which of it is used."""

    touches: Touches
    air: Air
    reference: Reference
    channels: Mask
    """(6,) which components of force and moment were measured."""
    free: Mask
    """(p,) which parameters are sought."""
    widths: Array
    """(p,) within which the parameters are known without any touch."""

    @property
    def applies(self) -> Mask:
        """(4,) equations that the measured channels have: three channels are consistent by themselves."""
        return np.array([self.channels.all(), self.channels.all(), True, True])


class Adjusted(NamedTuple):
    """A fitted rig."""

    rig: Rig
    normal: Array
    """(p, p) normal matrix, zero in rows and columns of parameters that are not sought."""
    misclosure: Array
    """(n, 4) of the equations at the measured values, linearised at the adjusted ones; 0 where an equation does not apply."""
    by_row: Array
    """(n, 4, 9) their derivatives by the measured values."""
    factor: Array
    """(n, 4, 4) that makes misclosures white."""
    white: Array
    """(n, 4) white misclosures, with the variance 1 if the premises hold."""
    white_by_rig: Array
    """(n, 4, p) their derivatives by the parameters."""
    air_residual: Array
    """(n, 6)"""
    used: Mask
    """(n, 4) equations that are used."""
    at_rest: bool
    """Whether the iteration converged."""


def started(problem: Problem, rig: Rig, noise: Noise, steps: int = _START_STEPS) -> tuple[Rig, float]:
    """A fit from afar by damped steps, with weights at the measured values, and its sum of squares."""
    damping = _DAMPING
    state = _linearised(problem, rig, noise, None)
    cost = _cost(state)
    for _ in range(steps):
        normal, gradient = _normal(problem, state)
        step = _solved(problem, normal, gradient, damping)
        trial = rig.moved(step)
        moved = _linearised(problem, trial, noise, None)
        new = _cost(moved)
        if new < cost:
            gain = cost - new
            rig, state, cost, damping = trial, moved, new, damping * _EASED
            if gain < _ENOUGH:
                break
        else:
            damping *= _RAISED
            if damping > _MOST:
                break
    return rig, cost


def adjusted(problem: Problem, rig: Rig, noise: Noise) -> Adjusted:
    """The fit with errors in all measured values, from a rig nearby."""
    correction: Array | None = None
    at_rest, before = False, np.inf
    for number in range(_STEPS):
        state = _linearised(problem, rig, noise, correction)
        normal, gradient = _normal(problem, state)
        step = _solved(problem, normal, gradient, 0.0)
        rig = rig.moved(step)
        adjusted_by = _correction(problem, state, step, noise)
        if correction is None or number < _WHOLE or problem.reference.smooth:
            correction = adjusted_by
        else:
            correction = (correction + adjusted_by) / 2
        size = float(np.sqrt(step @ normal @ step))
        if size < _SMALL or (not problem.reference.smooth and _FALLS * before < size < _NEARLY):
            at_rest = True
            break
        before = size
    state = _linearised(problem, rig, noise, correction)
    normal, _ = _normal(problem, state)
    return Adjusted(
        rig,
        normal,
        state.misclosure,
        state.by_row,
        state.factor,
        state.white,
        state.white_by_rig,
        state.air,
        state.used,
        at_rest,
    )


class _State(NamedTuple):
    misclosure: Array
    by_row: Array
    used: Mask
    lost: int
    factor: Array
    """(n, 4, 4) inverse Cholesky factors of the misclosures' covariances."""
    white: Array
    """(n, 4)"""
    white_by_rig: Array
    """(n, 4, p)"""
    air: Array
    """(n, 6)"""
    white_air: Array
    air_basis: Array
    air_weight: Array


def _linearised(problem: Problem, rig: Rig, noise: Noise, correction: Array | None) -> _State:
    touches = problem.touches
    if correction is not None:
        touches = touches._replace(
            wrench=touches.wrench + correction[:, :6], position=touches.position + correction[:, 6:]
        )
    found = equations(rig, touches, problem.reference)
    good = _finite(found)
    if correction is not None and not good.all():  # there the adjusted values are left for the measured ones
        correction[~good] = 0
        touches = problem.touches._replace(
            wrench=problem.touches.wrench + correction[:, :6], position=problem.touches.position + correction[:, 6:]
        )
        found = equations(rig, touches, problem.reference)
        good = _finite(found)
    used = good[:, None] & problem.applies & (found.by_row != 0).any(axis=2)
    value, by_rig, by_row = (np.where(used.reshape(*used.shape, *[1] * (part.ndim - 2)), part, 0) for part in found)
    misclosure = value if correction is None else value - np.einsum("nij,nj->ni", by_row, correction)
    return _whitened(problem, rig, noise, Equations(misclosure, by_rig, by_row), used, int((~good).sum()))


def _finite(found: Equations) -> Mask:
    return np.asarray(np.isfinite(found.value).all(axis=1) & np.isfinite(found.by_row).all(axis=(1, 2)))


def _whitened(problem: Problem, rig: Rig, noise: Noise, found: Equations, used: Mask, lost: int) -> _State:
    covariance = (found.by_row * noise.variances(problem.channels)) @ found.by_row.swapaxes(1, 2)
    covariance[:, range(4), range(4)] += ~used
    factor = np.linalg.inv(np.linalg.cholesky(covariance))
    air = problem.air.wrench - problem.air.basis @ rig.tare.T
    deviation = np.repeat([noise.force, noise.moment], 3)
    return _State(
        found.value,
        found.by_row,
        used,
        lost,
        factor,
        np.einsum("nij,nj->ni", factor, found.value),
        factor @ found.by_rig,
        air,
        np.where(problem.channels, air / deviation, 0.0),
        problem.air.basis,
        np.where(problem.channels, 1 / deviation**2, 0.0),
    )


def _cost(state: _State) -> float:
    return float((state.white**2).sum() + (state.white_air**2).sum()) + _NO_ROD * state.lost


def _normal(problem: Problem, state: _State) -> tuple[Array, Array]:
    """Normal matrix (p, p) and gradient (p,)."""
    stacked = state.white_by_rig.reshape(-1, state.white_by_rig.shape[2])
    normal, gradient = stacked.T @ stacked, stacked.T @ state.white.ravel()
    inner = state.air_basis.T @ state.air_basis
    normal[TARE:, TARE:] += np.kron(np.diag(state.air_weight), inner)
    gradient[TARE:] -= (state.air_weight[:, None] * (state.air.T @ state.air_basis)).ravel()
    fixed = ~problem.free
    normal[fixed] = normal[:, fixed] = gradient[fixed] = 0
    return normal, gradient


def _solved(problem: Problem, normal: Array, gradient: Array, damping: float) -> Array:
    """The step (p,), zero for parameters that are not sought."""
    free = np.flatnonzero(problem.free)
    # parameters that nothing depends on do not move
    matrix = normal[np.ix_(free, free)] + np.diag(problem.widths[free] ** -2.0)
    scale = 1 / np.sqrt(np.diag(matrix))
    matrix = matrix * scale[:, None] * scale
    matrix[range(len(free)), range(len(free))] += damping
    step = np.zeros(len(normal))
    step[free] = -scale * np.linalg.solve(matrix, scale * gradient[free])
    return step / max(1.0, float((np.abs(step) / problem.widths).max()) / _LONGEST)


def _correction(problem: Problem, state: _State, step: Array, noise: Noise) -> Array:
    """(n, 9) the corrections of the measured values with which the linearised equations hold after a step."""
    white = state.white + state.white_by_rig @ step
    multiplier = np.einsum("nji,nj->ni", state.factor, white)
    correction: Array = -noise.variances(problem.channels) * np.einsum("nij,ni->nj", state.by_row, multiplier)
    return correction


def information(problem: Problem, rig: Rig, noise: Noise) -> Array:
    """The normal matrix (p, p) at a rig."""
    return _normal(problem, _linearised(problem, rig, noise, None))[0]


def misfits(problem: Problem, rig: Rig, noise: Noise, kind: NDArray[np.int8]) -> Array:
    """Sums of squares (n,) of the rows' corrections, in variances, beyond what is expected, for a rig that is known.

    `kind` (n,) is that of the rows.
    """
    problem = replace(problem, touches=problem.touches._replace(kind=kind))
    state = _linearised(problem, rig, noise, None)
    for _ in range(_ROW_STEPS):
        state = _linearised(problem, rig, noise, _correction(problem, state, np.zeros(len(problem.free)), noise))
    result: Array = (state.white**2).sum(axis=1) - state.used.sum(axis=1)
    return result
