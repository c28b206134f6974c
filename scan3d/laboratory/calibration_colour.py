"""The colour of a sensor's noise, and what it does to the uncertainties of a calibration.

Noise of successive rows is alike where the sensor has 1/f noise, or where a low-pass was applied.  Its autocovariance is that
of the rows in the air: a sum of exponentials with positive weights, which describes white noise, 1/f noise and low-passes of
the first order, and is the covariance of a random process whatever its weights.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from scan3d.arrays import Array, Mask
from scan3d.laboratory.calibration_air import Unloaded

# Correlation times in rows of the exponentials.  Three per decade describe 1/f to some percent.
_TIMES = (1.0, 2.0, 4.6, 10.0, 22.0, 46.0, 100.0, 220.0, 460.0, 1000.0)
# Part of the rows of a recording that the longest correlation time may have: slower noise is the drift's.
_SLOWEST = 0.1
# Lags at which the autocovariance is taken, at most per decade, and pairs of rows that a lag needs.
_LAGS, _PAIRS = 10, 100
# Standard deviations of the autocovariance at short lags from which noise is not white.
_SIGMAS = 4.0
# Scatter over the noise below which the rows in the air are those of exact data.
_EXACT = 0.03
# Rows times functions of the tare up to which the noise that the tare takes away is computed; in longer logs it is little.
_LARGEST = 5_000_000
# Short lags of that test.
_SHORT = 5


class Colour(NamedTuple):
    """Autocovariance of the noise of a component by the lag in rows: a sum of exponentials, in variances of the noise."""

    decay: Array
    """(m,) factors by which the exponentials fall from row to row; 0 for white noise."""
    weight: Array
    """(m,)"""

    def at(self, lag: int) -> float:
        """The autocovariance at a lag."""
        return float((self.weight * self.decay**lag).sum())


WHITE = Colour(np.zeros(1), np.ones(1))


def colour(wrench: Array, found: Unloaded, channels: Mask, part: slice, noise: float) -> Colour:
    """The colour of the noise of force or moment, the components `part` of a wrench (n, 6), by the rows in the air.

    Where they scatter by far less than the noise, they have rounding errors only.
    """
    residual = np.where(found.air[:, None], wrench - found.basis @ found.tare.T, 0.0)[:, part][:, channels[part]]
    largest = min(int(_SLOWEST * len(residual)), int(_TIMES[-1]))
    lags = np.unique(np.round(np.logspace(0, np.log10(max(largest, 2)), int(_LAGS * np.log10(max(largest, 2))) + 1)))
    lags = np.concatenate([np.arange(0, _SHORT + 1), lags[lags > _SHORT]]).astype(int)
    pairs = np.array([(found.air[lag:] & found.air[: len(found.air) - lag]).sum() for lag in lags])
    covariance = np.array([(residual[lag:] * residual[: len(residual) - lag]).sum() for lag in lags])
    enough = pairs >= min(_PAIRS, pairs[0])
    lags, pairs, covariance = lags[enough], pairs[enough], covariance[enough]
    if covariance[0] <= (_EXACT * noise) ** 2 * pairs[0] * residual.shape[1]:
        return WHITE
    correlation = covariance / pairs / (covariance[0] / pairs[0])
    error = 1 / np.sqrt(pairs * residual.shape[1])
    short = slice(1, 1 + min(_SHORT, len(lags) - 1))
    total = float(correlation[short].sum()) / float(np.sqrt((error[short] ** 2).sum())) if len(lags) > 1 else 0.0
    if total < _SIGMAS:
        return WHITE
    decay = np.concatenate([[0.0], np.exp(-1 / np.array([time for time in _TIMES if time <= max(largest, 1)]))])
    expected = _expected(decay, lags, found) / pairs[:, None]
    scale = covariance[0] / pairs[0] / residual.shape[1]
    weight = nnls(expected / error[:, None], covariance / pairs / residual.shape[1] / scale / error)[0]
    # the variance of all of the noise is larger than what the tare has left of it
    return Colour(decay, weight * scale / noise**2)


def _expected(decay: Array, lags: NDArray[np.intp], found: Unloaded) -> Array:
    """Sums of products (l, m) at lags (l,) of rows in the air that are expected of exponentials (m,) of unit variance.

    The tare that was fitted to the rows takes the slow part of their noise away: with the projection P on its basis, noise of
    the covariance T has residuals of the covariance (1 - P) T (1 - P).
    """
    air = found.air.astype(float)
    basis = np.zeros_like(found.basis)
    basis[found.air] = np.linalg.qr(found.basis[found.air])[0]
    columns = []
    for factor in decay:
        column = factor**lags * np.array([_lagged(air, air, lag) for lag in lags])
        if basis.size <= _LARGEST:
            ahead, behind = decaying(basis, factor), decaying(basis[::-1], factor)[::-1]
            spread = (ahead + behind - basis) * air[:, None]
            inner = basis @ (basis.T @ spread)
            column -= [
                _lagged(basis, spread, lag) + _lagged(spread, basis, lag) - _lagged(inner, basis, lag) for lag in lags
            ]
        columns.append(column)
    return np.column_stack(columns)


def decaying(values: Array, factor: float) -> Array:
    """Sums (n, ...) of each row of values (n, ...) and all rows before it, which decay by a factor from row to row."""
    from scipy.signal import lfilter  # takes half a second, also where nothing is calibrated

    return np.asarray(lfilter([1.0], [1.0, -factor], values, axis=0))


def _lagged(one: Array, other: Array, lag: int) -> float:
    """The sum of products of rows (n, ...) and those that follow them at a lag."""
    return float((one[: len(one) - lag] * other[lag:]).sum())


def summed(values: Array, colour: Colour) -> Array:
    """The covariance (p, p) of the sum of rows (n, p) that multiply noise of unit variance with a colour."""
    result = np.zeros((values.shape[1],) * 2)
    square = values.T @ values
    for decay, weight in zip(colour.decay, colour.weight, strict=True):
        if weight > 0:
            running = decaying(values, decay) if decay > 0 else values
            product = values.T @ running
            result += weight * (product + product.T - square)
    return result
