"""The faults of a rig applied to a log: the wrench lags, is seen by a sensor that is turned and offset, drifts, and is noisy.

The order is that of a real chain: the wrench at the clamp, the sensor's filter and clock, its frame and sign, bias, drift and
noise of its bridges, the steps of its converter, and rows that the logger loses.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len

from scan3d.arrays import Array, Mask
from scan3d.simulation.faults import SHOWS, Faults, Size

# Streams of random numbers: each fault draws from a separate one, so that one fault does not change the others.
_BIAS, _DRIFT, _WHITE, _PINK, _JITTER, _MISSING = range(6)


def _generator(faults: Faults, stream: int) -> np.random.Generator:
    return np.random.default_rng([faults.seed, 5, stream])


def measured(force: Array, moment: Array, faults: Faults, untouched: tuple[float, float] = (0.0, 0.0)) -> Array:
    """(n, 6) what the sensor logs of the true force (n, 3) and moment (n, 3) at the clamp, sampled at `faults.rate_hz`.

    untouched
        force and moment that fractions are relative to if nothing is touched.
    """
    largest = float(np.linalg.norm(force, axis=1).max()), float(np.linalg.norm(moment, axis=1).max())
    largest = largest if any(largest) else untouched
    delayed = lagged(np.concatenate([force, moment], axis=1), faults)
    wrench: Array = np.concatenate(faults.sensor.seen(delayed[:, :3], delayed[:, 3:]), axis=1)
    if faults.shows != SHOWS[0]:
        wrench = -wrench
    wrench = wrench + _bias(faults, largest) + _drift(len(wrench), faults, largest)
    white = _generator(faults, _WHITE)
    if faults.noise:
        wrench = wrench + white.standard_normal(wrench.shape) * _by_channel(faults.noise, largest)
    if faults.pink:
        random = _generator(faults, _PINK)
        sizes = _by_channel(faults.pink, largest)
        wrench = wrench + np.stack([size * pink_noise(len(wrench), random) for size in sizes], axis=1)
    return rounded(wrench, _by_channel(faults.quantum, largest))


def _by_channel(size: Size, largest: tuple[float, float]) -> Array:
    """(6,) the size of each channel."""
    return np.repeat(size.of(largest), 3)


def lagged(values: Array, faults: Faults) -> Array:
    """Columns (n, k) after a low-pass of the first order, and later by the clock's offset."""
    if faults.lag_ms:
        from scipy.signal import lfilter  # takes half a second, also where nothing is disturbed

        keep = np.exp(-1000 / faults.rate_hz / faults.lag_ms)
        values = lfilter([1 - keep], [1, -keep], values, axis=0)
    if faults.clock_ms:
        time = np.arange(len(values)) / faults.rate_hz
        shifted = time - faults.clock_ms / 1000
        values = np.stack([np.interp(shifted, time, column) for column in values.T], axis=1)
    return values


def _bias(faults: Faults, largest: tuple[float, float]) -> Array:
    """(6,) the offsets of the channels; those given as a fraction point in a random direction."""
    relative = np.array(faults.bias.of(largest))
    bias: Array = _directions(_generator(faults, _BIAS)) * np.repeat(relative, 3)
    for part, given in ((slice(0, 3), faults.bias_force_N), (slice(3, 6), faults.bias_moment_Nm)):
        if given is not None:
            bias[part] = given
    return bias


def _directions(random: np.random.Generator) -> Array:
    """(6,) two random unit vectors, of a force and of a moment."""
    vectors = random.standard_normal((2, 3))
    return np.asarray((vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).ravel())


def _drift(rows: int, faults: Faults, largest: tuple[float, float]) -> Array:
    """(n, 6) drift from zero.

    A linear one has the stated size at the end of the log, in a random direction; a random walk has it as the root mean square
    at the end of many logs.
    """
    if not faults.drift:
        return np.zeros((rows, 6))
    random, size = _generator(faults, _DRIFT), _by_channel(faults.drift, largest)
    if faults.drift_kind == "linear":
        return np.linspace(0, 1, rows)[:, None] * (_directions(random) * size)
    steps = random.standard_normal((rows, 6)) * (size / np.sqrt(3 * max(rows - 1, 1)))
    steps[0] = 0.0
    return np.asarray(np.cumsum(steps, axis=0))


def pink_noise(rows: int, random: np.random.Generator) -> Array:
    """(n,) noise with the power spectrum 1/f and the standard deviation 1 in the mean over many logs."""
    length = next_fast_len(max(rows, 2), real=True)
    count = length // 2 + 1
    frequency = np.arange(1, count)
    amplitude = np.concatenate([[0.0], frequency**-0.5])
    spectrum = amplitude * (random.standard_normal(count) + 1j * random.standard_normal(count))
    # the sum over both halves of the spectrum of the expected power
    power = 2 * (amplitude[1:] ** 2 * 2).sum() / length**2
    noise: Array = irfft(spectrum, length)[:rows]
    return np.asarray(noise / np.sqrt(power))


def rounded(values: Array, step: Array) -> Array:
    """Columns (n, k) in whole steps (k,); a step of 0 leaves a column as it is."""
    safe = np.where(step > 0, step, 1.0)
    return np.where(step > 0, np.round(values / safe) * safe, values)


def logged_positions(position_m: Array, faults: Faults) -> Array:
    """(n, 3) positions as they are logged: with jitter, and in steps."""
    if faults.jitter_um:
        jitter = _generator(faults, _JITTER).standard_normal(position_m.shape)
        position_m = position_m + faults.jitter_um * 1e-6 * jitter
    return rounded(position_m, np.full(3, faults.quantum_um * 1e-6))


def kept(rows: int, faults: Faults) -> Mask:
    """(n,) which rows are not lost."""
    keep = np.ones(rows, dtype=bool)
    if not faults.missing:
        return keep
    gap = max(1, round(faults.gap_ms * faults.rate_hz / 1000))
    random = _generator(faults, _MISSING)
    # where gaps may overlap, so many begin that the stated fraction is lost in the mean
    begins = random.random(rows) < 1 - (1 - faults.missing) ** (1 / gap)
    for row in np.flatnonzero(begins):
        keep[row : row + gap] = False
    keep[[0, -1]] = True
    return keep
