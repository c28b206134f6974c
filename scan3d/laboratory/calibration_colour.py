"""The colour of a sensor's noise, and what it does to the uncertainties of a calibration.

Noise of successive rows is alike where the sensor has 1/f noise, or where a low-pass was applied.  Its autocovariance is that
of the rows in the air: a sum of exponentials with positive weights, which describes white noise, 1/f noise and low-passes of
the first order, and is the covariance of a random process whatever its weights.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls
from scipy.signal import lfilter

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
# Short lags of that test.
_SHORT = 5


class Colour(NamedTuple):
    """Autocorrelation of the noise of a component by the lag in rows: a sum of exponentials, one at the lag 0."""

    decay: Array
    """(m,) factors by which the exponentials fall from row to row; 0 for white noise."""
    weight: Array
    """(m,)"""

    def at(self, lag: int) -> float:
        """The autocorrelation at a lag."""
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
    weight = nnls(decay[None] ** lags[:, None] / error[:, None], correlation / error)[0]
    return Colour(decay, weight / weight.sum())


def summed(values: Array, colour: Colour) -> Array:
    """The covariance (p, p) of the sum of rows (n, p) that multiply noise of unit variance with a colour."""
    result = np.zeros((values.shape[1],) * 2)
    square = values.T @ values
    for decay, weight in zip(colour.decay, colour.weight, strict=True):
        if weight > 0:
            running = lfilter([1.0], [1.0, -decay], values, axis=0) if decay > 0 else values
            product = values.T @ running
            result += weight * (product + product.T - square)
    return result
