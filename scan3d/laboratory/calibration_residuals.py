"""Whether the misclosures of a calibration are those of noise, and what they say of its uncertainties if they are not.

Where the model holds, the white misclosures of successive rows are as independent as the noise of the rows.  A body that is
not the sphere, a rod that is not that of the model, or a clamp that leaves its path shifts neighbouring rows alike.  The
autocovariance of the white misclosures along the sweeps, less that of the noise, is the variance of such systematic
deviations.

The four white misclosures of a row have the variance 1 as well.  An estimated noise of the poses makes that so on average,
but not for each equation: a body of facets, or a contact elsewhere than the model says, turns the rod's tangent away by more
than it moves the contact off the sphere.  A variance above 1 is a systematic deviation, too.

Two numbers follow.  If the deviations are as independent as their correlation length says, they enlarge the covariance of the
parameters.  If they are not, nothing but their size is known: by the Cauchy-Schwarz inequality deviations with the sum of
squares S shift a parameter by no more than sqrt(S) of its standard deviations.  A quantity counts as well determined only if
that is within the limit as well.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array, Mask
from scan3d.laboratory.calibration_colour import Colour, decaying, summed
from scan3d.laboratory.calibration_fit import Adjusted, Noise, Problem
from scan3d.laboratory.calibration_model import TARE

# Lags in rows whose mean autocovariance tells systematic deviations.
_LAGS = (1, 2, 3)
# Standard deviations of that mean from which the deviations are systematic.  No one of 200 logs without them exceeds it.
_SIGMAS = 4.5
# Lags up to which the correlation is followed, and its part of the first at which the correlation length is read.
_FARTHEST, _HALF = 200, 0.5
# The two groups of equations: the consistency of the wrench, and the contacts on the sphere.
_GROUPS = (slice(0, 2), slice(2, 4))


class Systematic(NamedTuple):
    """Deviations that noise does not explain, of the two groups of equations."""

    variance: tuple[float, float]
    """In variances of the noise; 0 where there are none."""
    correlation: tuple[float, float]
    """Autocorrelation of the deviations from row to row."""
    excess: Array
    """(4,) variances of the white misclosures of the equations less 1, or 0 where that may be chance."""
    square: tuple[float, float]
    """Sum of squares over all rows."""
    normal: tuple[Array, Array]
    """(q, q) normal matrices of both groups, as covariances of quantities for deviations of unit variance."""
    covariance: Array
    """(q, q) that they add to quantities."""

    def __bool__(self) -> bool:
        return any(self.square)

    @property
    def rows(self) -> float:
        """Rows over which the deviations from the sphere are alike, those of the wrench where there are no others."""
        correlation = self.correlation[1] or self.correlation[0]
        return float(np.log(_HALF) / np.log(correlation)) if correlation > 0 else 0.0


def noise_covariance(
    fit: Adjusted,
    problem: Problem,
    noise: Noise,
    colours: tuple[Colour, Colour],
    rows: NDArray[np.intp],
    by_gradient: Array,
) -> Array:
    """The covariance (q, q) of quantities under noise with its colour; `rows` (n,) numbers those in contact.

    `by_gradient` (p, q) are the derivatives of the quantities by the gradient of the fit.
    """
    result = np.asarray(by_gradient.T @ fit.normal @ by_gradient)
    if all(len(colour.decay) == 1 for colour in colours):
        return result
    k = problem.air.basis.shape[1]
    deviation = np.sqrt(noise.variances(problem.channels))
    count = int(max(rows.max(), problem.air.rows.max())) + 1
    for channel in np.flatnonzero(problem.channels):
        by_value = np.einsum("nij,nj->ni", fit.factor, fit.by_row[:, :, channel]) * deviation[channel]
        every = np.zeros((count, len(result)))
        every[rows] = np.einsum("ni,nip->np", by_value, fit.white_by_rig) @ by_gradient
        first = TARE + channel * k
        every[problem.air.rows] -= problem.air.basis @ by_gradient[first : first + k] / deviation[channel]
        result += summed(every, colours[channel // 3]) - every.T @ every
    return result


def systematic(
    fit: Adjusted,
    problem: Problem,
    noise: Noise,
    colours: tuple[Colour, Colour],
    rows: NDArray[np.intp],
    sweep: NDArray[np.int64],
    by_gradient: Array,
) -> Systematic:
    """The systematic deviations of rows (n,) in contact, which are numbered in the recording and belong to sweeps (n,).

    `by_gradient` (p, q) are the derivatives of quantities by the gradient of the fit.
    """
    by_noise = fit.factor @ fit.by_row[:, :, :6] * np.sqrt(noise.variances(problem.channels))[:6]
    variances, correlations = [0.0, 0.0], [0.0, 0.0]
    count = by_gradient.shape[1]
    square, normal = [0.0, 0.0], [np.zeros((count, count)), np.zeros((count, count))]
    covariance = np.zeros((count, count))
    excess = _excess(fit, colours)
    for number, group in enumerate(_GROUPS):
        deviations = _Deviations(fit.white[:, group], fit.used[:, group], by_noise[:, group], rows, sweep, colours)
        lags = np.array([deviations.excess(lag) for lag in _LAGS])
        pairs = lags[:, 1].sum()
        mean = float(lags[:, 0].sum() / pairs) if pairs else 0.0
        alike = mean * np.sqrt(pairs) >= _SIGMAS
        if not alike and not excess[group].any():
            continue
        by_white = fit.white_by_rig[:, group] @ by_gradient
        normal[number] = np.einsum("nep,neq->pq", by_white, by_white, optimize=True)
        counts = fit.used[:, group].sum(axis=0)
        variances[number] = variance = float((excess[group] * counts).sum() / counts.sum())
        covariance += np.einsum("nep,e,neq->pq", by_white, excess[group], by_white, optimize=True)
        if alike:
            correlations[number] = correlation = _correlation(mean, deviations)
            # the mean over the lags belongs to a lag of two rows
            variances[number] = max(variance, mean / correlation**2)
            covariance += mean / correlation**2 * _running(by_white, rows, sweep, correlation)
        square[number] = variances[number] * float(counts.sum())
    return Systematic(
        (variances[0], variances[1]),
        (correlations[0], correlations[1]),
        excess,
        (square[0], square[1]),
        (normal[0], normal[1]),
        covariance,
    )


def _excess(fit: Adjusted, colours: tuple[Colour, Colour]) -> Array:
    """(4,) variances of the white misclosures of each equation beyond 1, 0 where that may be chance."""
    # noise that is alike over several rows has fewer independent squares
    repeated = max(1 + 2 * sum(colour.at(lag) ** 2 for lag in range(1, _FARTHEST)) for colour in colours)
    result = np.zeros(4)
    for equation in range(4):
        square = fit.white[fit.used[:, equation], equation] ** 2
        if len(square) > 1:
            error = float(square.std()) * np.sqrt(repeated / len(square))
            above = float(square.mean()) - 1
            result[equation] = above if above > _SIGMAS * error else 0.0
    return result


class _Deviations(NamedTuple):
    """White misclosures of a group of equations, and what noise makes of them."""

    white: Array
    """(n, 2)"""
    used: Mask
    by_noise: Array
    """(n, 2, 6) derivatives by the wrench in standard deviations of its noise."""
    rows: NDArray[np.intp]
    sweep: NDArray[np.int64]
    colours: tuple[Colour, Colour]

    def excess(self, lag: int) -> tuple[float, float]:
        """The sum of products of rows at a lag, less that of the noise, and the number of pairs."""
        place = np.minimum(np.searchsorted(self.rows, self.rows + lag), len(self.rows) - 1)
        here = np.flatnonzero((self.rows[place] == self.rows + lag) & (self.sweep[place] == self.sweep))
        there = place[here]
        both = self.used[here] & self.used[there]
        product = float((self.white[here] * self.white[there])[both].sum())
        for part, colour in zip((slice(0, 3), slice(3, 6)), self.colours, strict=True):
            if len(colour.decay) > 1:
                alike = (self.by_noise[here][:, :, part] * self.by_noise[there][:, :, part]).sum(axis=2)
                product -= colour.at(lag) * float(alike[both].sum())
        return product, float(both.sum())


def _correlation(mean: float, deviations: _Deviations) -> float:
    """The autocorrelation from row to row, by the lag at which that of the deviations has fallen to half of that of lag 2."""
    lag = 2
    while lag < _FARTHEST:
        lag += max(1, lag // 8)
        product, pairs = deviations.excess(lag)
        if pairs == 0 or product / pairs < _HALF * mean:
            break
    return float(_HALF ** (1 / (lag - 2)))


def _running(by_white: Array, rows: NDArray[np.intp], sweep: NDArray[np.int64], correlation: float) -> Array:
    """The covariance (q, q) of sums over rows of derivatives (n, e, q) times deviations that are correlated within a sweep.

    The variance of single rows is left out, because the noise contains it.
    """
    result = np.zeros((by_white.shape[2],) * 2)
    for number in np.unique(sweep):
        mine = sweep == number
        values = np.zeros((int(np.ptp(rows[mine])) + 1, *by_white.shape[1:]))
        values[rows[mine] - rows[mine].min()] = by_white[mine]
        before = decaying(values, correlation) - values
        product = np.einsum("nep,neq->pq", values, before, optimize=True)
        result += product + product.T
    return result
