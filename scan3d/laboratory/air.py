"""The sensor's zero, its drift and its noise, from the stretches of a log in the air, in which the rod touches nothing.

In the air a wrench is the sensor's zero plus noise: it keeps the value that it has most often, which may drift slowly.  Between
the stretches the zero is interpolated linearly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from scan3d.arrays import NEGLIGIBLE, SOME, Array, Mask, evenly
from scan3d.errors import InputError

# Standard deviation over the median of the absolute deviations of a normal distribution.
SD_OVER_MAD = 1.4826
# Rows of a stretch at least.
_FEWEST = 5
# Standard deviations of the noise that a row in the air may deviate, and standard errors from which a slope counts.
_SIGMAS = 4.0

Stretches = list[tuple[int, int]]
"""First row of each stretch, and the one after its last."""


class Air(NamedTuple):
    """The sensor's zero over a log."""

    zero: Array
    """(n, c) of each row."""
    noise: Array
    """(c,) standard deviation in the air; 0 where it is no more than rounding."""
    rows: Mask
    """(n,) rows in the air."""


def tare(wrench: Array, clock: Array, stretches: Stretches) -> Air:
    """The zero of a wrench (n, c) at times (n,) by its stretches in the air, which follow one another.

    Each gives one knot in its middle, or two at its ends where the zero drifts by more than the noise within it.  Single
    disturbed rows do not count.
    """
    rounding = NEGLIGIBLE * np.ptp(wrench, axis=0)
    knots, levels, residuals, rows = [], [], [], np.zeros(len(wrench), dtype=bool)
    for start, stop in stretches:
        time, values = clock[start:stop], wrench[start:stop]
        distance, _ = _from_line(time, values)
        inside = (distance <= _SIGMAS * robust_sd(distance) + rounding).all(axis=1)
        if inside.sum() < _FEWEST:
            inside[:] = True
        middle, level, slope, spread = _line(time[inside], values[inside])
        away = (time - middle)[:, None]
        off = (values - level - slope * away)[inside]
        error = np.sqrt((off**2).sum(axis=0) / max(len(off) - 2, 1) / spread)
        drifts = (np.abs(slope) > _SIGMAS * error) & (np.abs(slope) * np.ptp(time) > rounding)
        slope = np.where(drifts & (len(time) >= _FEWEST), slope, 0.0)
        ends = [float(time[0]), float(time[-1])] if slope.any() else [middle]
        knots += ends
        levels += [level + slope * (end - middle) for end in ends]
        kept = values - level - slope * away
        residuals.append(kept - np.median(kept, axis=0))
        rows[start:stop] = True
    noise = robust_sd(np.concatenate(residuals))
    return Air(_interpolated(clock, np.array(knots), np.array(levels)), np.where(noise > rounding, noise, 0.0), rows)


def _line(time: Array, values: Array) -> tuple[float, Array, Array, float]:
    """The line nearest to values (m, c): the middle of its times, level (c,) there, slope (c,), and Σ (t - middle)²."""
    middle = float(time.mean())
    spread = float(((time - middle) ** 2).sum()) or np.inf
    return middle, values.mean(axis=0), (time - middle) @ values / spread, spread


def _interpolated(clock: Array, at: Array, level: Array) -> Array:
    """Levels (k, c) at times (k,) interpolated at the times of a log; beyond them continued, as far as they reach at most."""
    quarter = (at[-1] - at[0]) / 4
    known, levels = at, level
    for place, end, inner in ((0, clock[0], at[0] + quarter), (-1, clock[-1], at[-1] - quarter)):
        away = abs(float(end - at[place]))
        if 0 < away <= quarter:
            # through the level a quarter of the log away: that of a neighbour may be too close to give a slope
            other = np.array([np.interp(inner, at, column) for column in level.T])
            where = place % (len(known) + 1)
            known = np.insert(known, where, end)
            levels = np.insert(levels, where, level[place] + (level[place] - other) * away / quarter, axis=0)
    return np.stack([np.interp(clock, known, column) for column in levels.T], axis=1)


def robust_sd(residuals: Array) -> Array:
    """Standard deviations (c,) of residuals (m, c), most of which are noise; also of noise that few steps resolve."""
    absolute = np.abs(residuals)
    median, most = np.percentile(absolute, [50, 90], axis=0)
    mad = SD_OVER_MAD * median
    # steps of a converter make more than half of the residuals equal
    inside = absolute <= 3 * np.maximum(mad, SD_OVER_MAD * most)
    rms = np.sqrt(np.where(inside, residuals**2, 0.0).sum(axis=0) / np.maximum(inside.sum(axis=0), 1))
    coarse = np.array([len(np.unique(column[:SOME])) < 64 for column in residuals.T])
    return np.asarray(np.where((mad == 0) | coarse, rms, mad))


def given_air(clock: Array, intervals: tuple[tuple[float, float], ...], where: str) -> Stretches:
    """The rows of stretches that are given in seconds.  Raises InputError for a stretch without rows."""
    found: Stretches = []
    for start, end in sorted(intervals):
        first, last = int(np.searchsorted(clock, start)), int(np.searchsorted(clock, end, side="right"))
        if last <= first:
            raise InputError(
                f"{where} has no row from {start:g} s to {end:g} s, which [tare] air of the map names; the table covers "
                f"{clock[0]:g} s to {clock[-1]:g} s"
            )
        if found and first < found[-1][1]:
            raise InputError(
                f"{where}: the stretches of [tare] air overlap at {clock[first]:g} s; join or shorten them"
            )
        found.append((first, last))
    return found


def find_air(wrench: Array, clock: Array, calm: Mask, where: str) -> Stretches:
    """The stretches of a wrench (n, c), forces first, in the air: where it keeps the value that it has most often.

    Only rows that are `calm` (n,) are taken.  Raises InputError if there is no such stretch.
    """
    scale = _scales(wrench)
    near: Mask = np.asarray((np.abs(wrench - _followed(wrench, clock, scale)) <= scale).all(axis=1))
    runs = _runs(near & calm)
    stretches = _consistent(wrench, clock, _refined(wrench, clock, runs, scale))
    again = _consistent(wrench, clock, _within_noise(wrench, clock, stretches, calm)) if stretches else []
    # the second pass finds more, unless the zero drifts in a way that it does not follow
    if sum(b - a for a, b in again) >= 0.8 * sum(b - a for a, b in stretches):
        stretches = again
    if not stretches:
        raise InputError(
            f"{where}: no stretch is found in which the rod is in the air, so that force and moment can't be tared; state such "
            'stretches as [tare] air = [[from_s, to_s]] in the map, or air = "none" if they are tared already'
        )
    return stretches


def _scales(wrench: Array) -> Array:
    """(c,) deviations within which a channel counts as near its zero: 2 % of the range, or the noise."""
    steps = np.abs(np.diff(wrench, axis=0)) if len(wrench) > 1 else np.zeros((1, wrench.shape[1]))
    # the quartile of |x| is 0.3186 standard deviations, and those of differences are √2 times as large
    noise = np.percentile(steps[:: max(1, len(steps) // SOME)], 25, axis=0) / (0.3186 * np.sqrt(2))
    reach = np.ptp(wrench, axis=0)
    half = wrench.shape[1] // 2
    largest = np.repeat([reach[:half].max(), reach[half:].max()], half)
    return np.asarray(np.maximum(0.02 * largest, _SIGMAS * noise))


def _followed(wrench: Array, clock: Array, scale: Array) -> Array:
    """The zero (n, c) of a wrench, roughly: its most frequent value, followed from window to window."""
    some = evenly(wrench, 1500)
    near = [(np.abs(some - row) <= scale).all(axis=1) for row in some]
    start = np.median(some[max(near, key=np.count_nonzero)], axis=0)
    edges = np.linspace(0, len(wrench), min(60, len(wrench)) + 1).astype(np.intp)
    windows = [wrench[a:b] for a, b in zip(edges[:-1], edges[1:], strict=True)]
    best = int(np.argmax([(np.abs(window - start) <= scale).all(axis=1).sum() for window in windows]))
    levels = np.empty((len(windows), len(scale)))
    for order in (range(best, len(windows)), range(best, -1, -1)):
        level = start
        for k in order:
            inside = windows[k][(np.abs(windows[k] - level) <= scale).all(axis=1)]
            level = np.median(inside, axis=0) if len(inside) >= _FEWEST else level
            levels[k] = level
    middle = clock[(edges[:-1] + edges[1:] - 1) // 2]
    return np.stack([np.interp(clock, middle, column) for column in levels.T], axis=1)


def _runs(near: Mask) -> Stretches:
    """The runs of rows near the zero, single disturbed rows within them included."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], near, [False]]).astype(np.int8)))
    runs: Stretches = []
    for start, stop in edges.reshape(-1, 2).tolist():
        if runs and start - runs[-1][1] <= 2:
            runs[-1] = runs[-1][0], stop
        else:
            runs.append((start, stop))
    return [(start, stop) for start, stop in runs if stop - start >= _FEWEST]


def _trimmed(start: int, stop: int) -> tuple[int, int]:
    """A stretch without a twentieth at each of its ends, where contact may begin below the noise."""
    margin = round((stop - start) / 20) if stop - start > 2 * _FEWEST else 0
    return start + margin, stop - margin


def _refined(wrench: Array, clock: Array, runs: Stretches, scale: Array) -> Stretches:
    """The runs without the rows at their ends that deviate from a line by more than the noise of all runs.

    Runs that rise by more than the scale (c,) are contact.
    """
    lines = [_from_line(clock[a:b], wrench[a:b]) for a, b in runs]
    level = [(start, line) for (start, _), (line, rise) in zip(runs, lines, strict=True) if (rise <= scale).all()]
    if not level:
        return []
    noise = np.median([SD_OVER_MAD * np.median(line, axis=0) for _, line in level], axis=0)
    inner = np.concatenate([wrench[a:b] for a, b in runs])
    limit = _SIGMAS * noise + _steps(inner) + NEGLIGIBLE * np.abs(wrench).max(axis=0)
    found = []
    for start, line in level:
        parts = _runs((line <= limit).all(axis=1))
        if parts:
            first, last = max(parts, key=lambda part: part[1] - part[0])
            found.append(_trimmed(start + first, start + last))
    return found


def _from_line(time: Array, values: Array) -> tuple[Array, Array]:
    """The distances (m, c) from a line that most rows lie on, and by how much (c,) these rise from quarter to quarter."""
    some = slice(None, None, max(1, len(time) // (SOME // 10)))
    t, v, middle = time[some], values[some], float(time[0])
    half = len(t) // 2
    rise = np.median(v[-half:], axis=0) - np.median(v[:half], axis=0)
    slope = rise / (float(np.median(t[-half:]) - np.median(t[:half])) or np.inf)
    level = np.median(v - slope * (t - middle)[:, None], axis=0)
    for _ in range(3):
        away = np.abs(v - level - slope * (t - middle)[:, None])
        kept = (away <= _SIGMAS * SD_OVER_MAD * np.median(away, axis=0)).all(axis=1)
        if kept.sum() < _FEWEST:
            break
        middle, level, slope, _ = _line(t[kept], v[kept])
    return np.abs(values - level - slope * (time - middle)[:, None]), 1.5 * np.abs(rise)


def _steps(values: Array) -> Array:
    """The steps of a converter (c,) that channels (m, c) show: the smallest difference of values where there are few."""
    steps = np.zeros(values.shape[1])
    for k, column in enumerate(values.T):
        distinct = np.unique(column[:: max(1, len(column) // 4000)])
        if 1 < len(distinct) < 200:
            steps[k] = np.diff(distinct).min()
    return steps


def _within_noise(wrench: Array, clock: Array, stretches: Stretches, calm: Mask) -> Stretches:
    """The stretches whose rows, and whose means over some rows, differ from the zero of first stretches by noise only."""
    first = tare(wrench, clock, stretches)
    deviation = wrench - first.zero
    level = np.array([np.median(deviation[a:b], axis=0) for a, b in stretches])
    slack = 6 * SD_OVER_MAD * np.median(np.abs(level), axis=0) + NEGLIGIBLE * np.abs(wrench).max(axis=0)
    slack += _steps(wrench[first.rows])
    near = calm & (np.abs(deviation) <= _SIGMAS * first.noise + slack).all(axis=1)
    over = 15  # rows, by whose mean light contact is distinguished from noise
    if len(wrench) > over:
        # where some of the rows are in contact, the mean says nothing about the others
        mean = uniform_filter1d(deviation, over, axis=0, mode="nearest")
        light = (np.abs(mean) > 1.6 * first.noise + slack).any(axis=1)
        crowded = uniform_filter1d(near.astype(np.float64), over, mode="nearest") > 1 - 0.5 / over
        near &= ~(light & crowded)
    return [_trimmed(a, b) for a, b in _runs(near)]


def _consistent(wrench: Array, clock: Array, stretches: Stretches) -> Stretches:
    """The stretches whose zero agrees with that between two others: those on both sides, at the ends the next two."""
    if len(stretches) < 4:
        return stretches
    level = np.array([np.median(wrench[a:b], axis=0) for a, b in stretches])
    time = np.array([clock[a:b].mean() for a, b in stretches])
    count = np.array([b - a for a, b in stretches])
    inner = np.concatenate([wrench[a:b] - middle for (a, b), middle in zip(stretches, level, strict=True)])
    harmless = np.ptp(wrench, axis=0) * NEGLIGIBLE + 0.3 * robust_sd(inner) + np.finfo(float).tiny
    # much shorter ones are remains of contact, or hardly matter
    kept = np.flatnonzero(count >= 0.1 * np.median(count))
    while len(kept) >= 4:
        before, after = np.arange(len(kept)) - 1, np.arange(len(kept)) + 1
        before[[0, -1]], after[[0, -1]] = (1, len(kept) - 2), (2, len(kept) - 3)
        t, v = time[kept], level[kept]
        span = t[after] - t[before]
        part = ((t - t[before]) / np.where(span == 0, 1.0, span))[:, None]
        deviation = np.abs(v - v[before] - part * (v[after] - v[before]))
        # shorter stretches have less certain zeros
        variance = np.maximum(np.median(count[kept]) / count[kept], 1.0)
        weight = np.sqrt((variance + variance[before] + variance[after]) / 3)[:, None]
        usual = SD_OVER_MAD * np.median(deviation, axis=0)
        excess = (deviation / (6 * usual * weight + harmless)).max(axis=1)
        if excess.max() <= 1:
            break
        kept = np.delete(kept, int(np.argmax(excess)))
    return [stretches[k] for k in kept]
