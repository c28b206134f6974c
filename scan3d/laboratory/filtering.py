"""Low-pass without a shift in time, fewer rows, and the noise that is left."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from scipy.ndimage import maximum_filter1d

from scan3d.arrays import Array, Mask
from scan3d.errors import InputError
from scan3d.laboratory.air import SD_OVER_MAD


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
            f"{where}: [filter] needs even time steps, and those of the table differ by more than half of their median of "
            f"{median:.3g} s in 5 % of the rows or more; leave [filter] out"
        )
    return 1 / median


def low_pass(values: Array, clock: Array, limit_hz: float, rate: float, where: str) -> Array:
    """The values (n, c) without what is faster than `limit_hz`; parts that long pauses separate are filtered separately."""
    if limit_hz >= rate / 2:
        raise InputError(
            f"{where}: [filter] lowpass_hz = {limit_hz:g} must be below half of the table's rate of {rate:.6g} Hz; lower it, "
            "or leave it out"
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
    noise = SD_OVER_MAD * np.median(taken, axis=0)
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
