"""Stretches of a log in the air: there the wrench keeps the value that it has most often, which may drift slowly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from scan3d.arrays import Array, Index, Mask
from scan3d.errors import InputError
from scan3d.laboratory.taring import FEWEST, ROUNDING, SD_OVER_MAD, robust_sd, tare

# The zero is looked for within this fraction of the range of the forces, and of that of the moments.  Larger, light contacts
# count as air at first; smaller, a zero that drifts is lost.
_NEAR = 0.02
# Standard deviations of the noise that a row in the air may deviate.  Larger, the beginnings of contacts count as air; smaller,
# the noise is understated.
_SIGMAS = 4.0
# Rows among which the most frequent wrench is looked for, evenly spread.  More take longer; fewer may miss short stretches.
_SAMPLED = 1500
# Windows in which the zero is followed.  More follow faster drift; fewer find more air in each.
_WINDOWS = 60
# Rows of single disturbances within a stretch at most.
_DISTURBED = 2
# Fraction of a stretch that is left out at each of its ends, where contact may begin below the noise.
_MARGIN = 0.05
# A stretch is no air if its zero deviates from that between its neighbours by more than this many times the usual deviation.
# Larger, grazing contact of constant force counts as air; smaller, a zero that jumps is not followed.
_OUTLYING = 6.0
# Rows over which light contact is distinguished from noise by its mean, and standard deviations that the mean may deviate:
# there are as many means as rows.
_AVERAGED, _MEAN_SIGMAS = 15, 5.0
# Deviations of the zero below this fraction of the noise do no harm.
_HARMLESS = 0.3
# Fraction of the rows in the air that the second pass must find again.
_MOST = 0.8
# Stretches shorter than this fraction of the median one are left out.
_SHORT = 0.1
# Rows from which medians are taken, evenly spread.
_SOME = 20_000


def find_air(wrench: Array, clock: Array, where: str) -> list[tuple[int, int]]:
    """The stretches of a wrench (n, c), forces first, in the air: where it keeps the value that it has most often.

    Raises InputError if there is no such stretch.
    """
    channels = np.ptp(wrench, axis=0) > 0
    near_rows = np.ones(len(wrench), dtype=bool)
    scale = _scales(wrench)
    if channels.any():
        scaled = wrench[:, channels] / scale[channels]
        near_rows = (np.abs(scaled - _followed(scaled, clock)) <= 1).all(axis=1)
    runs = [run for run in _runs(near_rows) if _is_level(wrench[run[0] : run[1]], scale)]
    stretches = _consistent(wrench, clock, _refined(wrench, clock, runs))
    again = _consistent(wrench, clock, _within_noise(wrench, clock, stretches)) if stretches else []
    # the second pass finds more, unless the zero drifts in a way that it does not follow
    if sum(b - a for a, b in again) >= _MOST * sum(b - a for a, b in stretches):
        stretches = again
    if not stretches:
        raise InputError(
            f"{where}: no stretch is found in which the rod is in the air, so that force and moment can't be tared; state such "
            'stretches as [tare] air = [[from_s, to_s]] in the map, or air = "none" if they are tared already'
        )
    return stretches


def _scales(wrench: Array) -> Array:
    """(c,) deviations within which a channel counts as near its zero: a fraction of the range, or the noise."""
    steps = np.abs(np.diff(wrench, axis=0)) if len(wrench) > 1 else np.zeros((1, wrench.shape[1]))
    # the quartile of |x| is 0.3186 standard deviations, and those of differences are √2 times as large
    noise = np.percentile(steps[:: max(1, len(steps) // _SOME)], 25, axis=0) / (0.3186 * np.sqrt(2))
    reach = np.ptp(wrench, axis=0)
    half = wrench.shape[1] // 2
    group = np.concatenate([np.full(half, reach[:half].max()), np.full(len(reach) - half, reach[half:].max())])
    scale: Array = np.maximum(_NEAR * group, _SIGMAS * noise)
    return scale


def _followed(scaled: Array, clock: Array) -> Array:
    """The zero (n, c) of a wrench in units of its scales, roughly: most frequent value, followed from window to window."""
    some = scaled[np.linspace(0, len(scaled) - 1, min(len(scaled), _SAMPLED)).astype(np.intp)]
    count = np.zeros(len(some), dtype=np.intp)
    for k, row in enumerate(some):
        count[k] = (np.abs(some - row) <= 1).all(axis=1).sum()
    start = np.median(some[(np.abs(some - some[np.argmax(count)]) <= 1).all(axis=1)], axis=0)
    edges = np.linspace(0, len(scaled), min(_WINDOWS, len(scaled)) + 1).astype(np.intp)
    windows = list(zip(edges[:-1], edges[1:], strict=True))
    near = [int((np.abs(scaled[a:b] - start) <= 1).all(axis=1).sum()) for a, b in windows]
    levels = np.empty((len(windows), scaled.shape[1]))
    best = int(np.argmax(near))
    for order in (range(best, len(windows)), range(best, -1, -1)):
        level = start
        for k in order:
            a, b = windows[k]
            inside = scaled[a:b][(np.abs(scaled[a:b] - level) <= 1).all(axis=1)]
            level = np.median(inside, axis=0) if len(inside) >= FEWEST else level
            levels[k] = level
    middle = [float(clock[(a + b - 1) // 2]) for a, b in windows]
    return np.stack([np.interp(clock, middle, column) for column in levels.T], axis=1)


def _runs(near: Mask) -> list[tuple[int, int]]:
    """The runs of rows near the zero, single disturbed rows within them included."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], near, [False]]).astype(np.int8)))
    runs: list[tuple[int, int]] = []
    for start, stop in edges.reshape(-1, 2).tolist():
        if runs and start - runs[-1][1] <= _DISTURBED:
            runs[-1] = runs[-1][0], stop
        else:
            runs.append((start, stop))
    return [(start, stop) for start, stop in runs if stop - start >= FEWEST]


def _refined(wrench: Array, clock: Array, runs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The runs without the rows at their ends that deviate from a line by more than the noise of all runs."""
    if not runs:
        return []
    lines = [_robust_line(clock[a:b], wrench[a:b]) for a, b in runs]
    noise = np.median([SD_OVER_MAD * np.median(np.abs(line), axis=0) for line in lines], axis=0)
    step = np.array([_step(np.concatenate([wrench[a:b, k] for a, b in runs])) for k in range(wrench.shape[1])])
    limit = _SIGMAS * noise + step + ROUNDING * np.abs(wrench).max(axis=0)
    found = []
    for (start, _), line in zip(runs, lines, strict=True):
        inside = (np.abs(line) <= limit).all(axis=1)
        parts = _runs(inside)
        if not parts:
            continue
        first, last = max(parts, key=lambda part: part[1] - part[0])
        found.append(_trimmed(start + first, start + last))
    return found


def _within_noise(wrench: Array, clock: Array, stretches: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The stretches whose rows, and whose means over some rows, differ from the zero of first stretches by noise only."""
    first = tare(wrench, clock, stretches)
    deviation = np.abs(wrench - first.zero)
    level = np.array([np.median(wrench[a:b] - first.zero[a:b], axis=0) for a, b in stretches])
    slack = _OUTLYING * SD_OVER_MAD * np.median(np.abs(level), axis=0) + ROUNDING * np.abs(wrench).max(axis=0)
    step = np.array([_step(wrench[first.rows, k]) for k in range(wrench.shape[1])])
    single = (deviation <= _SIGMAS * first.noise + step + slack).all(axis=1)
    if len(wrench) <= _AVERAGED:
        return [_trimmed(a, b) for a, b in _runs(single)]
    mean = uniform_filter1d(wrench - first.zero, _AVERAGED, axis=0, mode="nearest")
    # where some of the rows are in contact, the mean says nothing about the others
    limit = (_MEAN_SIGMAS / np.sqrt(_AVERAGED) + _HARMLESS) * first.noise
    light = (np.abs(mean) > limit + step + slack).any(axis=1)
    crowded = uniform_filter1d(single.astype(np.float64), _AVERAGED, mode="nearest") > 1 - 0.5 / _AVERAGED
    return [_trimmed(a, b) for a, b in _runs(single & ~(light & crowded))]


def _trimmed(start: int, stop: int) -> tuple[int, int]:
    """A stretch without its margins."""
    margin = round(_MARGIN * (stop - start)) if stop - start > 2 * FEWEST else 0
    return start + margin, stop - margin


def _is_level(values: Array, scale: Array) -> bool:
    """Whether a wrench (m, c) hardly changes from the first to the last quarter, other than in contact."""
    quarter = max(1, len(values) // 4)
    change = np.abs(np.median(values[-quarter:], axis=0) - np.median(values[:quarter], axis=0))
    return bool((change <= scale).all())


def _robust_line(time: Array, values: Array) -> Array:
    """The residuals (m, c) from a line through the medians of both halves, fitted again to the rows close to it."""
    every = max(1, len(time) // (_SOME // 10))
    level, slope, middle = _fitted(time[::every], values[::every])
    return values - level - slope * (time - middle)[:, None]


def _fitted(time: Array, values: Array) -> tuple[Array, Array, float]:
    """That line: its level (c,) at a time, its slope (c,), and the time."""
    half = len(time) // 2
    early, late = np.median(values[:half], axis=0), np.median(values[-half:], axis=0)
    span = float(np.median(time[-half:]) - np.median(time[:half]))
    slope = (late - early) / span if span > 0 else np.zeros(values.shape[1])
    middle = float(time.mean())
    level = np.median(values - slope * (time - middle)[:, None], axis=0)
    for _ in range(3):
        residual = values - level - slope * (time - middle)[:, None]
        mad = SD_OVER_MAD * np.median(np.abs(residual), axis=0)
        kept = (np.abs(residual) <= _SIGMAS * mad).all(axis=1)
        if kept.sum() < FEWEST or np.ptp(time[kept]) == 0:
            break
        middle = float(time[kept].mean())
        centred = time[kept] - middle
        level = values[kept].mean(axis=0)
        slope = (centred[:, None] * (values[kept] - level)).sum(axis=0) / float((centred**2).sum())
    return level, slope, middle


def _step(values: Array) -> float:
    """The step of a converter that a channel shows: the smallest difference of its values where there are few of them."""
    distinct = np.unique(values[:: max(1, len(values) // 4000)])
    return float(np.diff(distinct).min()) if 1 < len(distinct) < 200 else 0.0


def _consistent(wrench: Array, clock: Array, stretches: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The stretches whose zero agrees with that between their neighbours."""
    if len(stretches) < 4:
        return stretches
    level = np.array([np.median(wrench[a:b], axis=0) for a, b in stretches])
    time = np.array([clock[a:b].mean() for a, b in stretches])
    count: NDArray[np.int64] = np.array([b - a for a, b in stretches])
    inner = np.concatenate([wrench[a:b] - middle for (a, b), middle in zip(stretches, level, strict=True)])
    reach = np.ptp(wrench, axis=0) * ROUNDING + _HARMLESS * robust_sd(inner)
    # much shorter ones are remains of contact, or hardly matter
    kept = np.flatnonzero(count >= _SHORT * np.median(count))
    for _ in range(len(stretches)):
        if len(kept) < 4:
            break
        deviation, before, after = _from_neighbours(time[kept], level[kept])
        usual = SD_OVER_MAD * np.median(np.abs(deviation), axis=0)
        # shorter stretches have less certain zeros
        variance = np.maximum(np.median(count[kept]) / count[kept], 1.0)
        weight = np.sqrt((variance + variance[before] + variance[after]) / 3)[:, None]
        excess = (np.abs(deviation) / (_OUTLYING * usual * weight + reach + np.finfo(float).tiny)).max(axis=1)
        if excess.max() <= 1:
            break
        kept = np.delete(kept, int(np.argmax(excess)))
    return [stretches[k] for k in kept]


def _from_neighbours(time: Array, level: Array) -> tuple[Array, Index, Index]:
    """Deviations (k, c) of levels from lines through two others, and those (k,): on both sides, at the ends the next two."""
    index = np.arange(len(time))
    before = np.clip(index - 1, 0, None)
    before[0] = 1
    after = np.clip(index + 1, None, len(time) - 1)
    after[0], before[-1], after[-1] = 2, len(time) - 2, len(time) - 3
    span = time[after] - time[before]
    part = ((time - time[before]) / np.where(span == 0, 1.0, span))[:, None]
    deviation: Array = level - level[before] - part * (level[after] - level[before])
    return deviation, before, after
