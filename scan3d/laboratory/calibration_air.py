"""Rows of a recording in which nothing touches the rod, the noise they show, and how the sensor drifts between them.

A sweep begins in the air, and most sweeps end there.  From each end a run of rows belongs to the air until the reactions leave
the level of that end by more than the noise; rows beyond, which may be light touches, are left out with a margin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array, Mask
from scan3d.errors import InputError

# Rows at an end of a sweep that give its level.  More, and a touch soon after the start counts as air; fewer, and the level is
# as noisy as a row.
_LEVEL = 5
# Deviations from the level, in standard deviations of the largest channel, up to which a row counts as air, and beyond which
# it counts as contact for certain.  The force of a touch grows steadily, so that the rows between the two are as many as
# those before the first, in which the noise hides the touch.
_AIR, _CONTACT = 4.0, 12.0
# Drift within a sweep, as a part of the largest reaction, that counts as noise while the air is sought.  Larger, the margin
# before a touch is wider; smaller, sensors with little noise seem to touch when they drift.
_DRIFT = 5e-4
# Range of the rows of an end in the air, and difference of the levels of both ends, at most, in the same units.
_CALM = 6.0
# Levels of ends of sweeps that deviate by more than this part of the largest reaction are those of rods in contact.  Sensors
# drift by less between sweeps.
_DRIFTED = 0.1
# Rows in the air that a calibration needs.
_FEWEST = 12
# Noise below this part of the largest reaction counts as this, so that data without noise have weights.
_EXACT = 1e-6
# Median of the absolute values of normally distributed numbers, in standard deviations.
_MEDIAN = 0.6745
# Smallest noise, so that recordings of zeros have weights.
_TINY = 1e-100
# Parts of the two components of a wrench.
_PARTS = (slice(0, 3), slice(3, 6))
# What the misfit may exceed one by where the noise is estimated from the same rows.
_UNSURE = 0.1
# A model of the drift is enough if the mean square deviation of the rows from it, in variances of the noise, exceeds one by no
# more than this many of its standard deviations.
_SIGMAS = 4.0


class Unloaded(NamedTuple):
    """What the rows in the air show; wrenches have the unit of those given."""

    air: Mask
    """(n,)"""
    contact: Mask
    """(n,) rows in which the rod is loaded for certain."""
    force_noise: float
    """The stated noise, or that of the rows in the air if it is not stated or they contradict it."""
    moment_noise: float
    basis: Array
    """(n, k) of the tare over the rows."""
    tare: Array
    """(6, k)"""
    model: str
    """One of `scan3d.choices.TARES`, but not ``auto``."""
    misfit: float
    """Mean square deviation of the rows in the air from the tare, over the variance of the noise."""


def unloaded(
    sweep: NDArray[np.int64], wrench: Array, channels: Mask, noise: tuple[float, float], model: str
) -> Unloaded:
    """The air of sweeps: `sweep` (n,) numbers them, `wrench` (n, 6) is what the sensor shows, `noise` 0 where unknown.

    Raises InputError for too few rows in the air.
    """
    runs = [np.flatnonzero(sweep == number) for number in np.unique(sweep)]
    largest = np.repeat([np.abs(wrench[:, part]).max() for part in _PARTS], 3)
    # stated noise may be understated
    rough = np.repeat([_noise(wrench[:, part][:, channels[part]], runs) for part in _PARTS], 3)
    rough = np.maximum(rough, np.repeat(noise, 3))
    # a sensor may drift by more than its noise within a sweep
    air, contact = _separated(
        np.where(channels, wrench / np.maximum(np.maximum(rough, _DRIFT * largest), _TINY), 0.0), runs
    )
    if air.sum() < _FEWEST:
        raise InputError(
            f"the recording has {air.sum()} rows in the air, and a calibration needs {_FEWEST}: let each sweep begin and end "
            "some rows before and after the rod touches the reference"
        )
    known = np.repeat(noise, 3)
    least = np.maximum(_EXACT * largest, _TINY)
    quick = np.maximum(np.where(known > 0, known, _quick_noise(wrench, air, sweep, channels)), least)
    for name in _models(model, sweep, air):
        basis = _basis(name, sweep)
        tare: Array = np.asarray(np.linalg.lstsq(basis[air], wrench[air], rcond=None)[0].T, dtype=float)
        freedom = max(int(air.sum()) - basis.shape[1], 1)
        square: Array = ((wrench[air] - basis[air] @ tare.T) ** 2).sum(axis=0) / freedom
        misfit = float((square / quick**2)[channels].mean())
        allowed = 1 + _SIGMAS * float(np.sqrt(2 / freedom / channels.sum())) + _UNSURE * (0 in noise)
        if misfit < allowed:
            break
    own = np.sqrt([square[part][channels[part]].mean() for part in _PARTS])
    # where the noise is not given, the deviations from the tare tell it better than the differences of rows
    deviation: Array = np.where(known > 0, known, np.repeat(own, 3))
    if misfit > allowed:
        deviation = np.asarray(np.maximum(deviation, np.repeat(own, 3)))
    deviation = np.maximum(deviation, least)
    return Unloaded(air, contact, float(deviation[0]), float(deviation[3]), basis, tare, name, misfit)


def _models(model: str, sweep: NDArray[np.int64], air: Mask) -> tuple[str, ...]:
    """The models of the tare that are tried one after the other; a tare for each sweep needs rows in the air of each."""
    without = np.setdiff1d(sweep, sweep[air])
    if model == "sweep" and len(without):
        raise InputError(
            f"sweep {without[0]} has no rows in the air, which a tare for each sweep needs; let it begin earlier"
        )
    return (model,) if model != "auto" else ("linear",) if len(without) else ("linear", "sweep")


def _noise(values: Array, runs: list[NDArray[np.intp]]) -> float:
    """The noise (n, c) by the second differences of the first and last rows of the sweeps, most of which are in the air."""
    ends = [
        values[rows[part]] for rows in runs for part in (slice(0, _LEVEL), slice(-_LEVEL, None)) if len(rows) > _LEVEL
    ]
    return float(np.median(np.abs(np.diff(np.stack(ends), n=2, axis=1)))) / _MEDIAN / 6**0.5 if ends else 0.0


def _quick_noise(wrench: Array, air: Mask, sweep: NDArray[np.int64], channels: Mask) -> Array:
    """(6,) the noise of force and moment by the second differences of successive rows in the air, which do not drift."""
    order = np.argsort(sweep, kind="stable")
    values, run, quiet = wrench[order], sweep[order], air[order]
    together = quiet[2:] & quiet[1:-1] & quiet[:-2] & (run[2:] == run[:-2])
    square = (np.diff(values, n=2, axis=0)[together] ** 2).mean(axis=0) / 6 if together.any() else np.zeros(6)
    return np.repeat([np.sqrt(square[part][channels[part]].mean()) for part in _PARTS], 3)


def _separated(scaled: Array, runs: list[NDArray[np.intp]]) -> tuple[Mask, Mask]:
    """Rows (n,) in the air, and rows in contact for certain; others are neither."""
    air, contact = np.zeros(len(scaled), dtype=bool), np.zeros(len(scaled), dtype=bool)
    for rows, levels in zip(runs, _levels(scaled, runs), strict=True):
        known = [level for level in levels if level is not None]
        for level, ordered in zip(levels, (rows, rows[::-1]), strict=True):
            if level is not None:
                air[ordered[: _quiet(np.abs(scaled[ordered] - level).max(axis=1))]] = True
        if known:
            contact[rows] = np.min([np.abs(scaled[rows] - level).max(axis=1) for level in known], axis=0) > _CONTACT
    return air, contact & ~air


def _quiet(away: Array) -> int:
    """How many of the first rows are in the air, by their deviations (k,) from its level, with a margin before the touch."""
    if not (away > _CONTACT).any():
        return len(away)
    pressed = int(np.argmax(away > _CONTACT))
    # single rows beyond the limit by chance lie before the touch
    calm = np.flatnonzero(away[:pressed] <= _AIR)
    touched = int(calm[-1]) + 1 if len(calm) else 0
    return max(touched - (pressed - touched) - 1, 0)


def _levels(scaled: Array, runs: list[NDArray[np.intp]]) -> list[tuple[Array | None, Array | None]]:
    """The level (6,) of both ends of each sweep, None for an end in contact.

    In the air the rows of an end are alike, and its level is that of the sweep's other end or near that of the other sweeps.
    """
    parts = [(scaled[rows[:_LEVEL]], scaled[rows[-_LEVEL:]]) for rows in runs]
    ends = np.array([[np.median(part, axis=0) for part in pair] for pair in parts])
    calm = np.array([[np.ptp(part, axis=0).max() <= _CALM for part in pair] for pair in parts])
    middle = np.median(ends[:, 0], axis=0)
    near = np.abs(ends - middle).max(axis=2) <= max(_DRIFTED * float(np.abs(scaled - middle).max()), _AIR)
    alike = np.abs(ends[:, 0] - ends[:, 1]).max(axis=1) <= _CALM
    free = calm & (near | alike[:, None])
    return [
        (first if starts else None, last if ended else None)
        for (first, last), (starts, ended) in zip(ends, free, strict=True)
    ]


def _basis(model: str, sweep: NDArray[np.int64]) -> Array:
    """(n, k) functions of the row whose sum is the tare of a channel."""
    n = len(sweep)
    if model == "constant":
        return np.ones((n, 1))
    if model == "linear":
        return np.column_stack([np.ones(n), np.linspace(-0.5, 0.5, n)])
    return np.asarray(sweep[:, None] == np.unique(sweep), dtype=float)
