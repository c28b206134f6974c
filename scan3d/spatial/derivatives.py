"""Derivatives along sweeps by local polynomial fits, as weights on neighbouring samples.

A window of samples around each sample, shifted inwards at the ends of its run, determines a polynomial; its slope at the sample
is a weighted sum of the window's values.  Through as many coefficients as samples it is Lagrange's interpolation in barycentric
form; through fewer it is the weighted least-squares fit (Savitzky and Golay, for samples at any distances).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array, Mask

# Regularisation of the normal equations, in which all entries are at most the number of samples.
_RIDGE = 1e-14
Rows = NDArray[np.intp]


class Windows(NamedTuple):
    """Windows of w samples around some of the samples."""

    rows: Rows
    """(k,) the samples whose runs are long enough."""
    members: Rows
    """(k, w) the samples of their windows."""
    own: Rows
    """(k,) place of the sample in its window."""


def windows(starts: Mask, width: int) -> Windows:
    """Windows of `width` samples within runs; `starts` (n,) marks each run's first sample."""
    n = len(starts)
    first = np.flatnonzero(starts)
    run = np.cumsum(starts) - 1
    begin, end = first[run], np.append(first[1:], n)[run]
    rows = np.flatnonzero(end - begin >= width)
    left = np.clip(rows - width // 2, begin[rows], end[rows] - width)
    return Windows(rows, left[:, None] + np.arange(width), rows - left)


def interpolating(position: Array, own: Rows) -> Array:
    """Weights (k, w) of the slope, at the sample `own` (k,), of the polynomial through values at `position` (k, w)."""
    k, w = position.shape
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.ptp(position, axis=1)[:, None]
        x = (position - position[:, :1]) / scale
        difference = x[:, :, None] - x[:, None, :]
        difference[:, np.arange(w), np.arange(w)] = 1
        barycentric = 1 / difference.prod(axis=2)
        picked = np.arange(k)
        weights = barycentric / barycentric[picked, own][:, None] / difference[picked, own]
        weights[picked, own] = 0
        weights[picked, own] = -weights.sum(axis=1)
        return np.asarray(weights / scale)


def extrapolating(position: Array, at: Array) -> Array:
    """Weights (k, w) of the slope of the polynomial through values at `position` (k, w), at other places `at` (k,)."""
    _, w = position.shape
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.ptp(position, axis=1)[:, None]
        difference = (position[:, :, None] - position[:, None, :]) / scale[:, :, None]
        difference[:, np.arange(w), np.arange(w)] = 1
        away = (at[:, None] - position) / scale
        basis = away.prod(axis=1)[:, None] / away / difference.prod(axis=2)
        return np.asarray(basis * ((1 / away).sum(axis=1)[:, None] - 1 / away) / scale)


def fitting(position: Array, own: Rows, degree: int, weight: Array, values: Array) -> tuple[Array, Array]:
    """Weights (k, w) of the slope of a fitted polynomial, and the fit's misfit (k,).

    The polynomial has a degree below w and is fitted with `weight` (k, w), 1 / variance.  The misfit of the `values` (k, w, c)
    is the sum of their squared deviations, each over its variance, per degree of freedom: about 1 if they are smooth but for
    noise whose variance is that of all c components together.
    """
    k, width = position.shape
    relative = position - position[np.arange(k), own][:, None]
    scale = np.abs(relative).max(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        powers = (relative / scale[:, None])[:, None] ** np.arange(degree + 1)[:, None]
        weighted = powers * (weight / weight.max(axis=1, keepdims=True))[:, None]
        normal = weighted @ powers.transpose(0, 2, 1)
        good = np.isfinite(normal).all(axis=(1, 2))
        normal[~good] = np.eye(degree + 1)
        normal += _RIDGE * np.eye(degree + 1)
        slope = np.zeros((k, degree + 1, 1))
        slope[:, 1] = 1
        solved = np.linalg.solve(normal, np.concatenate([slope, weighted @ values], axis=2))
        result = (solved[:, :, 0][:, None] @ weighted)[:, 0] / scale[:, None]
        residual = ((values - powers.transpose(0, 2, 1) @ solved[:, :, 1:]) ** 2).sum(axis=2)
    result[~good] = np.nan
    return result, np.asarray((weight * residual).sum(axis=1) / max(width - degree - 1, 1))
