"""The sensor's zero, its drift and its noise, from the stretches of a log in the air, in which the rod touches nothing.

In the air a wrench is the sensor's zero plus noise: it keeps the value that it has most often, which may drift slowly.  Between
the stretches the zero is interpolated linearly.

A low-pass without a shift in time leaves less of the noise.  After a snap-off a rod swings about its rest until damping ends
that.  A rod in the air is linear.  Swinging with one frequency, in whatever direction across itself, each channel of its wrench
obeys

    ``w(t + s) = a w(t) - b w(t - s)``,   ``a = 2 cos(ω s) exp(-δ s)``,   ``b = exp(-2 δ s)``,

with the same two numbers in all channels and no constant, at any sampling rate, also where the swing is sampled more slowly
than it moves.  A contact pushes: its wrench does not swing about zero, and the axial force swings twice as often as the
forces across the rod.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from scan3d.arrays import MEDIAN_OF_NORMAL, NEGLIGIBLE, SOME, Array, Mask, evenly
from scan3d.errors import InputError
from scan3d.unmeasured import Jump, noise_of, reach_of

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
    mad = median / MEDIAN_OF_NORMAL
    # steps of a converter make more than half of the residuals equal
    inside = absolute <= 3 * np.maximum(mad, most / MEDIAN_OF_NORMAL)
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
                f"{where} has no row from {start:g} s to {end:g} s, which [tare] air of the map names; the table "
                f"covers {clock[0]:g} s to {clock[-1]:g} s"
            )
        if found and first < found[-1][1]:
            raise InputError(
                f"{where}: the stretches of [tare] air overlap at {clock[first]:g} s; join or shorten them"
            )
        found.append((first, last))
    return found


def find_air(wrench: Array, clock: Array, calm: Mask, where: str, measured: Mask | None = None) -> Stretches:
    """The stretches of a wrench (n, c), forces first, in the air: where it keeps the value that it has most often.

    Only rows that are `calm` (n,) are taken, and those that were not `measured` (n,) say nothing of the value.  Raises
    InputError if there is no such stretch.
    """
    known = slice(None) if measured is None or measured.all() else measured
    scale = _scales(wrench[known])
    zero = _followed(wrench[known], clock[known], scale)
    if len(zero) < len(wrench):
        zero = np.stack([np.interp(clock, clock[known], column) for column in zero.T], axis=1)
    near: Mask = np.asarray((np.abs(wrench - zero) <= scale).all(axis=1))
    runs = _runs(near & calm)
    stretches = _consistent(wrench, clock, _refined(wrench, clock, runs, scale))
    again = _consistent(wrench, clock, _within_noise(wrench, clock, stretches, calm)) if stretches else []
    # the second pass finds more, unless the zero drifts in a way that it does not follow
    if sum(b - a for a, b in again) >= 0.8 * sum(b - a for a, b in stretches):
        stretches = again
    if not stretches:
        raise InputError(
            f"{where}: no stretch is found in which the rod is in the air, so that force and moment can't be tared; "
            "state such "
            'stretches as [tare] air = [[from_s, to_s]] in the map, or air = "none" if they are tared already'
        )
    return stretches


def separated(stretches: Stretches, calm: Mask, found: list[Jump]) -> Stretches:
    """The parts of stretches whose rows are all `calm` (n,), and between which the zero jumps."""
    cuts = {jump.stop for jump in found}
    parts: Stretches = []
    for start, stop in stretches:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], calm[start:stop], [False]]).astype(np.int8))) + start
        for a, b in edges.reshape(-1, 2).tolist():
            inner = [a, *sorted(cut for cut in cuts if a < cut < b), b]
            parts += [(one, other) for one, other in pairwise(inner) if other - one >= min(_FEWEST, b - a)]
    return parts or stretches


def measured_jumps(wrench: Array, found: list[Jump], stretches: Stretches) -> list[Jump]:
    """The jumps with sizes by the nearest stretches in the air before and after, which have less noise than two rows."""
    better: list[Jump] = []
    for jump in found:
        before = [
            np.median(wrench[a:b], axis=0) for a, b in stretches if b <= jump.row and not _any_in(found, b, jump.row)
        ]
        after = [
            np.median(wrench[a:b], axis=0) for a, b in stretches if a >= jump.stop and not _any_in(found, jump.stop, a)
        ]
        known = bool(before and after)
        better.append(jump._replace(size=after[0] - before[-1]) if known else jump)
    return better


def _any_in(found: list[Jump], start: int, stop: int) -> bool:
    """Whether the zero jumps between rows."""
    return any(start <= jump.row < stop and jump.stop < stop for jump in found)


def roughly_air(wrench: Array) -> Mask:
    """The rows (n,) of a wrench (n, c) that are near its zero, which is followed through the log.

    Rows that repeat the one before, or a channel for a tenth of the log, count once in finding it.
    """
    differs = np.concatenate([np.ones((1, wrench.shape[1]), dtype=bool), np.diff(wrench, axis=0) != 0])
    fresh: Mask = np.asarray(differs.any(axis=1))
    for column in differs[:, differs[1:].any(axis=0)].T:
        start = np.flatnonzero(column)
        length = np.diff(np.append(start, len(column)))
        fresh &= column | np.repeat(length <= len(column) / 10, length)
    fresh[0] = True
    known = wrench[fresh]
    scale = _scales(known)
    near: Mask = np.asarray(
        (np.abs(known - _followed(known, np.flatnonzero(fresh).astype(np.float64), scale)) <= scale).all(axis=1)
    )
    return np.asarray(near[np.cumsum(fresh) - 1])


def _scales(wrench: Array) -> Array:
    """(c,) deviations within which a channel counts as near its zero: 2 % of the range, or the noise."""
    return np.asarray(np.maximum(0.02 * reach_of(wrench), _SIGMAS * noise_of(wrench)))


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
    noise = np.median([np.median(line, axis=0) / MEDIAN_OF_NORMAL for _, line in level], axis=0)
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
        kept = (away <= _SIGMAS / MEDIAN_OF_NORMAL * np.median(away, axis=0)).all(axis=1)
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
    slack = 6 / MEDIAN_OF_NORMAL * np.median(np.abs(level), axis=0) + NEGLIGIBLE * np.abs(wrench).max(axis=0)
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
        usual = np.median(deviation, axis=0) / MEDIAN_OF_NORMAL
        excess = (deviation / (6 * usual * weight + harmless)).max(axis=1)
        if excess.max() <= 1:
            break
        kept = np.delete(kept, int(np.argmax(excess)))
    return [stretches[k] for k in kept]


# Rows of a window, in steps s between the rows that the equation connects.
_WINDOW = 8


def sampling_rate(clock: Array | None, where: str) -> float:
    """Rows per second.  Raises InputError without times (n,), and if their steps are too uneven for a filter."""
    if clock is None or clock[0] == clock[-1]:
        raise InputError(f"{where}: [filter] needs the time of the rows; name its column as time under [columns]")
    steps = np.diff(clock)
    median = float(np.median(steps))
    if median <= 0:
        return len(steps) / float(clock[-1] - clock[0])
    if np.percentile(np.abs(steps - median), 95) > median / 2:
        raise InputError(
            f"{where}: [filter] needs even time steps, and those of the table differ by more than half of their "
            f"median of {median:.3g} s in 5 % of the rows or more; leave [filter] out"
        )
    return 1 / median


def low_pass(values: Array, clock: Array, limit_hz: float, rate: float, where: str) -> Array:
    """The values (n, c) without what is faster than `limit_hz`; parts that long pauses separate are filtered separately."""
    if limit_hz >= rate / 2:
        raise InputError(
            f"{where}: [filter] lowpass_hz = {limit_hz:g} must be below half of the table's rate of {rate:.6g} Hz; "
            "lower it, or leave it out"
        )
    filter_ = _filter(limit_hz, rate)
    filtered = values.copy()
    for start, stop in parts(clock, rate):
        # the edges are continued by reflection, over as many rows as the part has at most
        pad = min(stop - start - 1, round(3 * rate / limit_hz))
        if stop - start > 3:
            filtered[start:stop] = signal.sosfiltfilt(filter_, values[start:stop], axis=0, padlen=pad)
    return filtered


def blurred(values: Array, filtered: Array, clock: Array, limit_hz: float, rate: float, where: str) -> Mask:
    """The rows (n,) that the low-pass changes by more than their noise, as at touch-down and where the rod snaps off.

    What the filter takes away is noise, but for these rows; slower than twice the limit, little of the noise is left in it.
    """
    taken = np.abs(low_pass(values - filtered, clock, min(2 * limit_hz, 0.45 * rate), rate, where))
    noise = np.median(taken, axis=0) / MEDIAN_OF_NORMAL
    # in a log without noise all changes stand out: those below 1e-4 of the largest force or moment are no harm
    smallest = 1e-4 * np.repeat([np.abs(values[:, :3]).max(), np.abs(values[:, 3:]).max()], 3)
    changed = (taken > np.maximum(6 * noise, smallest)).any(axis=1)
    around = 2 * max(1, round(rate / limit_hz / 4)) + 1  # between the places where the change has its zeros
    return np.asarray(maximum_filter1d(changed, around))


def noise_factor(limit_hz: float, rate: float) -> float:
    """Standard deviation of white noise that the filter leaves, over that before it."""
    _, response = signal.freqz_sos(_filter(limit_hz, rate), worN=4096)
    # forwards and backwards: the amplitude is that of both
    return float(np.sqrt(np.mean(np.abs(response) ** 4)))


def _filter(limit_hz: float, rate: float) -> Array:
    # of the second order: of a higher one, steps overshoot more
    return np.asarray(signal.butter(2, limit_hz, fs=rate, output="sos"))


def parts(clock: Array, rate: float) -> list[tuple[int, int]]:
    """The parts of a log that have no pause within them: first row, and the one after the last."""
    breaks = np.flatnonzero(np.diff(clock) > 5 / rate) + 1  # five median steps
    edges = [0, *breaks.tolist(), len(clock)]
    return list(zip(edges[:-1], edges[1:], strict=True))


def thinned(sweep: NDArray[np.int64], every: int) -> NDArray[np.int64]:
    """Rows of which every so many are kept in each sweep (n,), from its first one on."""
    starts = np.flatnonzero(np.diff(sweep, prepend=sweep[:1] - 1))
    since = np.arange(len(sweep)) - np.repeat(starts, np.diff(np.append(starts, len(sweep))))
    return np.flatnonzero(since % every == 0)


# --- a rod that rings in the air ---


def ringing(wrench: Array, noise: Array, run: NDArray[np.int64]) -> Mask:
    """Rows (n,) of a tared wrench (n, c) that belong to a swing about zero.

    noise
        (c,) standard deviations; 0 where they are no more than rounding.
    run
        (n,) numbers of the stretches within which rows follow one another evenly.
    """
    found = np.zeros(len(wrench), dtype=bool)
    half = wrench.shape[1] // 2
    largest = np.repeat([np.abs(part).max(initial=0.0) for part in (wrench[:, :half], wrench[:, half:])], half)
    unit = np.hypot(noise, 1e-3 * largest)  # the weaker channels of a sensor without noise count as well
    scaled = wrench / np.where(unit > 0, unit, 1.0)
    variance = float(((noise / np.where(unit > 0, unit, 1.0)) ** 2).sum())
    edges = np.flatnonzero(np.diff(run, prepend=run[:1] - 1, append=run[-1:] + 1))
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        step = 1
        while _WINDOW * step <= last - first:
            _mark(found[first:last], scaled[first:last], step, variance)
            step *= 2
    return found


def _mark(found: Mask, wrench: Array, step: int, variance: float) -> None:
    """Mark the rows (n,) of a run in windows that swing by at least the least angle a step.

    Windows with rows that are found already are left out: longer ones would reach into contact.  `variance` is that of a
    row's noise.
    """
    before, now, after = wrench[: -2 * step], wrench[step:-step], wrench[2 * step :]
    size = (before**2).sum(axis=1) + (now**2).sum(axis=1) + (after**2).sum(axis=1)
    # rows count alike, however far the swing has died away, so that none of them is a contact
    weight = 1 / np.where(size > 0, np.maximum(size, 3 * variance), 1.0)
    products = [
        weight * (one * other).sum(axis=1)
        for one, other in ((now, now), (before, before), (before, now), (now, after), (before, after), (after, after))
    ]
    stands_out = size > 3 * 4 * variance  # with four times the mean square of the noise
    sums = np.stack([*products, variance * weight, stands_out], axis=1)
    total = np.cumsum(np.pad(sums, ((1, 0), (0, 0))), axis=0)
    count = (_WINDOW - 2) * step
    xx, yy, xy, xz, yz, zz, share, felt = ((total[count:] - total[:-count]) / count).T
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = xx * yy - xy**2
        a, b = (xz * yy - xy * yz) / determinant, (xy * xz - xx * yz) / determinant
        left = zz - a * xz + b * yz
        # over two steps a swing keeps a quarter of its square, and each turns it by a radian at least: a window is more than a
        # period, so that the sign has changed more often than that of any sweep past a convex body
        swings = (b > 0.25) & (b < 1.02) & (a < 2 * np.cos(1.0) * np.sqrt(b)) & (felt > 0.6)
        # the equation leaves other modes, a frequency that changes with the bend, and noise
        swings &= left < 0.02 * xx + 1.5 * share * (1 + a**2 + b**2)
    known = np.cumsum(np.pad(found, (1, 0)))
    start = np.flatnonzero(swings & (known[_WINDOW * step :] == known[: -_WINDOW * step]))
    begins, ends = (np.bincount(rows, minlength=len(wrench) + 1) for rows in (start, start + _WINDOW * step))
    found |= np.cumsum(begins - ends)[:-1] > 0
