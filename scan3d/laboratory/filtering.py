"""What is no contact in a wrench: noise, which a low-pass without a shift in time leaves less of, and a rod that rings.

After a snap-off a rod swings about its rest until damping ends that.  A rod in the air is linear.  Swinging with one frequency,
in whatever direction across itself, each channel of its wrench obeys

    ``w(t + s) = a w(t) - b w(t - s)``,   ``a = 2 cos(ω s) exp(-δ s)``,   ``b = exp(-2 δ s)``,

with the same two numbers in all channels and no constant, at any sampling rate, also where the swing is sampled more slowly
than it moves.  A contact pushes: its wrench does not swing about zero, and the axial force swings twice as often as the
forces across the rod.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from scipy.ndimage import maximum_filter1d

from scan3d.arrays import Array, Mask
from scan3d.errors import InputError
from scan3d.laboratory.air import SD_OVER_MAD

# Rows of a window, in steps s between the rows that the equation connects, and the least angle ω s of a step: together more
# than a period, so that the sign has changed more often than that of any sweep past a convex body.
_WINDOW, _ANGLE = 8, 1.0
# Least part of its square that a swing keeps over two steps.
_DAMPED = 0.25
# Part of the mean square of a swing that its equation may leave: other modes, and a frequency that changes with the bend.
_LEFT = 0.02
# Mean square over the variance of the noise from which a swing stands out, in which part of the rows it does, and what noise
# leaves over its expectation.
_FELT, _NEARLY_ALL, _CHANCE = 4.0, 0.6, 1.5


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
    total = np.cumsum(
        np.pad(np.stack([*products, variance * weight, size > 3 * _FELT * variance], axis=1), ((1, 0), (0, 0))), axis=0
    )
    count = (_WINDOW - 2) * step
    xx, yy, xy, xz, yz, zz, share, felt = ((total[count:] - total[:-count]) / count).T
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = xx * yy - xy**2
        a, b = (xz * yy - xy * yz) / determinant, (xy * xz - xx * yz) / determinant
        left = zz - a * xz + b * yz
        swings = (b > _DAMPED) & (b < 1 + _LEFT) & (a < 2 * np.cos(_ANGLE) * np.sqrt(b)) & (felt > _NEARLY_ALL)
        swings &= left < _LEFT * xx + _CHANCE * share * (1 + a**2 + b**2)
    known = np.cumsum(np.pad(found, (1, 0)))
    start = np.flatnonzero(swings & (known[_WINDOW * step :] == known[: -_WINDOW * step]))
    inside = (
        np.bincount(start, minlength=len(wrench)) - np.bincount(start + _WINDOW * step, minlength=len(wrench) + 1)[:-1]
    )
    found |= np.cumsum(inside) > 0
