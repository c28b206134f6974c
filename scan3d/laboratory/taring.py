"""Stretches in the air, in which the rod touches nothing: the zero of the sensor, its drift, and its noise.

In the air a wrench is the sensor's zero plus noise.  The zero drifts slowly; between the stretches it is interpolated linearly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scan3d.arrays import Array, Mask
from scan3d.errors import InputError

# Standard deviation over the median of the absolute deviations of a normal distribution.
SD_OVER_MAD = 1.4826
# Rows of a stretch at least.
FEWEST = 5
# A slope counts within a stretch if it exceeds this many standard errors.
_SLOPING = 4.0
# Residuals have the steps of a converter if so many of them have fewer different values.
_LOOKED_AT, _FEW_VALUES = 2000, 64
# Rounding, relative to the range of a channel.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Air:
    """The sensor's zero over a log."""

    stretches: tuple[tuple[int, int], ...]
    """First row of each stretch, and the one after its last."""
    zero: Array
    """(n, c) of each row."""
    noise: Array
    """(c,) standard deviation in the air; 0 where it is no more than rounding."""
    rows: Mask
    """(n,) rows in the air."""

    @property
    def drift(self) -> Array:
        """(c,) largest difference of the zero."""
        return np.ptp(self.zero, axis=0) if len(self.zero) else np.zeros(self.zero.shape[1])


def tare(wrench: Array, clock: Array, stretches: list[tuple[int, int]]) -> Air:
    """The zero of a wrench (n, c) at times (n,) by its stretches in the air, which follow one another."""
    scale = np.ptp(wrench, axis=0) + np.abs(wrench).max(axis=0) * ROUNDING
    knots, levels, residuals, rows = [], [], [], np.zeros(len(wrench), dtype=bool)
    for start, stop in stretches:
        time, values, kept = _line(clock[start:stop], wrench[start:stop], scale)
        knots += time
        levels += values
        residuals.append(kept - np.median(kept, axis=0))
        rows[start:stop] = True
    noise = robust_sd(np.concatenate(residuals))
    zero = _interpolated(clock, np.array(knots), np.array(levels))
    return Air(tuple(stretches), zero, np.where(noise > ROUNDING * scale, noise, 0.0), rows)


def _interpolated(clock: Array, at: Array, level: Array) -> Array:
    """Levels (k, c) at times (k,) interpolated at the times of a log; beyond them continued, as far as they reach at most."""
    first, last = at[0], at[-1]
    if len(at) > 1 and last > first:
        reach = last - first
        # through the level a quarter of the log away: that of a neighbour may be too close to give a slope
        for end, near, inner in ((clock[0], first, first + reach / 4), (clock[-1], last, last - reach / 4)):
            away = float(end - near)
            if 0 < abs(away) <= reach / 4:
                known = np.array([np.interp([near, inner], at, column) for column in level.T])
                beyond = known[:, 0] + (known[:, 0] - known[:, 1]) * abs(away) / (reach / 4)
                at, level = (
                    (np.insert(at, 0, end), np.vstack([beyond, level]))
                    if away < 0
                    else (np.append(at, end), np.vstack([level, beyond]))
                )
    return np.stack([np.interp(clock, at, column) for column in level.T], axis=1)


def _line(time: Array, values: Array, scale: Array) -> tuple[list[float], list[Array], Array]:
    """The knots of the zero within a stretch, their values, and the residuals (m, c) of its rows.

    There is one knot in the middle, or two at the ends if the zero drifts within the stretch.
    """
    middle = float(time.mean())
    centred = time - middle
    spread = float((centred**2).sum())
    level = values.mean(axis=0)
    if spread == 0 or len(time) < FEWEST:
        return [middle], [level], values - level
    slope = (centred[:, None] * values).sum(axis=0) / spread
    residual = values - level - slope * centred[:, None]
    error = np.sqrt((residual**2).sum(axis=0) / (len(time) - 2) / spread)
    counts = (np.abs(slope) > _SLOPING * error) & (np.abs(slope) * np.ptp(time) > ROUNDING * scale)
    if not counts.any():
        return [middle], [level], values - level
    slope = np.where(counts, slope, 0.0)
    ends = [float(time[0]), float(time[-1])]
    return ends, [level + slope * (end - middle) for end in ends], values - level - slope * centred[:, None]


def robust_sd(residuals: Array) -> Array:
    """Standard deviations (c,) of residuals (m, c), most of which are noise; also of noise that few steps resolve."""
    absolute = np.abs(residuals)
    median, most = np.percentile(absolute, [50, 90], axis=0)
    mad = SD_OVER_MAD * median
    # steps of a converter make more than half of the residuals equal
    limit = 3 * np.maximum(mad, SD_OVER_MAD * most)
    inside = absolute <= limit
    count = np.maximum(inside.sum(axis=0), 1)
    rms = np.sqrt(np.where(inside, residuals**2, 0.0).sum(axis=0) / count)
    coarse = np.array([len(np.unique(column[:_LOOKED_AT])) < _FEW_VALUES for column in residuals.T])
    deviation: Array = np.where((mad == 0) | coarse, rms, mad)
    return deviation


def given_air(clock: Array, intervals: tuple[tuple[float, float], ...], where: str) -> list[tuple[int, int]]:
    """The rows of stretches that are given in seconds.  Raises InputError for a stretch without rows."""
    found = []
    for start, end in sorted(intervals):
        first, last = int(np.searchsorted(clock, start)), int(np.searchsorted(clock, end, side="right"))
        if last <= first:
            raise InputError(
                f"{where} has no row from {start:g} s to {end:g} s, which [tare] air of the map names; the table covers "
                f"{clock[0]:g} s to {clock[-1]:g} s"
            )
        found.append((first, last))
    for (_, stop), (begin, _) in zip(found[:-1], found[1:], strict=True):
        if begin < stop:
            raise InputError(
                f"{where}: the stretches of [tare] air overlap at {clock[begin]:g} s; join or shorten them"
            )
    return found
