"""The resolution of recorded numbers, estimated from the numbers themselves: digits of a log, single precision, steps of a
converter.

Rounding to steps of size q has the standard deviation q/√12.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np

from scan3d.arrays import Array
from scan3d.recording import Recording

# Numbers whose digits are counted at most, evenly spread over the column.  More take longer; fewer may be rounder than the rest
# by chance.
_COUNTED = 2000
# Significant digits from which a column counts as not rounded: double precision has 15 to 17.  Larger, rounding in the last
# place counts as coarse; smaller, a log of that many digits counts as exact.
_FULL = 15
# The same of numbers in single precision, which counts by its spacing.
_FULL_SINGLE = 8
# A column has steps if its numbers lie on a common grid to within this fraction of a step.  Larger, numbers lie on a grid by
# chance; smaller, steps that were written with few digits are missed.
_ON_GRID = 0.02
# The grid's step is determined by ever larger distances, each at most this many times the one before if there is such a one.
# Larger, digits that are missing make the number of steps in the next distance uncertain; smaller, it takes longer.
_GROWTH = 8.0
# Steps in the smallest gap between two numbers of a column, at most.  Larger, few numbers lie on a common grid by chance;
# smaller, coarse steps are missed in columns with few different numbers.
_PARTS = 12
# Rounding of remainders in Euclid's algorithm, relative to the largest number.  Larger, the steps of fine converters are
# missed; smaller, rounding makes remainders that do not exist.
_EUCLID = 1e-9
# Different numbers from which a common grid is no chance.
_FEWEST = 20
# Digits of the poses count as rounding if their standard deviation is at most this many rod lengths, or radians.  Coarser poses
# are taken for those of a plan, which are round but exact.  Larger, planned poses count as uncertain; smaller, the rounding
# of logged poses is overlooked.
_FINE = 1e-4
# Errors of rounding are independent if the noise that is rounded has at least this many times their standard deviation, which
# is half a step: their mean over the noise is then below 0.3 % of a step (Widrow and Kollár, Quantization Noise, 2008).
# Larger, means of rows are not used though their errors are smaller; smaller, errors count as independent that are not.
_DITHER = 3**0.5
# Rounding below this fraction of the noise does not count.  Larger, the noise is understated; smaller, nothing changes.
_NEGLIGIBLE = 0.03
LARGEST_OVER_SD = 3.0
"""The largest error by rounding of three coordinates, over the standard deviation of one."""


def rounding_sd(values: Array) -> float:
    """Standard deviation of the rounding of numbers (n,), by the step at the largest of them; 0 for full precision."""
    nonzero = values[values != 0]
    if len(nonzero) < 2:
        return 0.0
    largest = float(np.abs(nonzero).max())
    with np.errstate(over="ignore", under="ignore"):
        single = bool((values.astype(np.float32) == values).all())
    binary = float(np.spacing(np.float32(largest))) if single else 0.0
    step = max(_decimal_step(nonzero, largest, single), binary, _grid_step(values))
    # numbers of full precision are multiples of their last place
    return step / float(np.sqrt(12)) if step > largest * 10.0**-_FULL else 0.0


def _decimal_step(values: Array, largest: float, single: bool) -> float:
    """The place value of the last significant digit at the largest number; 0 for the digits of full precision.

    `single` says that the numbers were kept in single precision, which has 7 to 9 digits.
    """
    some = values[np.linspace(0, len(values) - 1, min(len(values), _COUNTED)).astype(np.intp)].tolist()
    kept, full = (np.float32, _FULL_SINGLE) if single else (float, _FULL)
    digits = 1
    for value in some:
        while digits < full and kept(f"{value:.{digits - 1}e}") != value:
            digits += 1
        if digits == full:
            return 0.0
    return float(10.0 ** (np.floor(np.log10(largest)) + 1 - digits))


def _grid_step(values: Array) -> float:
    """The step of the grid on which all numbers lie; 0 if they do not lie on one."""
    distinct = np.unique(values)
    if len(distinct) < _FEWEST:
        return 0.0
    first = int(np.diff(distinct).argmin())
    distances = np.sort(np.abs(distinct - distinct[first]))[1:]
    # the smallest gap, or the common divisor of two distances, may be a few steps
    rounding = _EUCLID * float(np.abs(distinct).max())
    first_ones = distances[:3].tolist()
    divisors = [first_ones[0], *(_divisor(*pair, rounding) for pair in combinations(first_ones, 2))]
    for candidate in (divisor / part for divisor in divisors for part in range(1, _PARTS + 1)):
        if candidate <= rounding:
            continue
        step = _refined(distances, candidate)
        multiples = distances / step
        if (np.abs(multiples - np.round(multiples)) <= _ON_GRID).all():
            return step
    return 0.0


def _divisor(one: float, other: float, rounding: float) -> float:
    """The largest number of which both are multiples, by Euclid's algorithm; 0 if it is not far above their rounding."""
    while other > rounding:
        one, other = other, abs(one - other * round(one / other))
    return one if one > 20 * rounding else 0.0


def _refined(distances: Array, step: float) -> float:
    """The step of which all distances (n,), increasing, are multiples if there is one, from its first estimate."""
    k = 0
    while k < len(distances) - 1:
        k = max(k + 1, int(np.searchsorted(distances, _GROWTH * distances[k], side="right")) - 1)
        step = float(distances[k] / max(np.round(distances[k] / step), 1.0))
    return step


class Noise(NamedTuple):
    """Errors of a recording."""

    force_N: float
    """Standard deviation of each force component, by the stated noise and by rounding."""
    moment_Nm: float
    """Standard deviation of the moment, likewise."""
    pose_m: float
    """Standard deviation of each coordinate of the clamp's position, as it is stated."""
    place_m: float
    """Largest error of a contact's place by the digits of the poses."""
    independent: bool
    """Whether the errors of successive rows are independent.  Rounding alone gives successive rows the same errors where force
    and moment change by less than a step; noise of some size makes the errors of rounding independent as well."""


def noise_of(recording: Recording) -> Noise:
    """The errors that a recording states, and those of its digits."""
    forces, moments = [*recording.force_N.T], [recording.moment_Nm]
    if recording.six_axis:
        forces, moments = (list(columns.T) for columns in recording.wrench())
    force, moment = (max(rounding_sd(column) for column in columns) for columns in (forces, moments))
    stated_force, stated_moment = recording.noise_force_N, recording.noise_moment_Nm
    length = recording.rod.length_m
    position = rounding_sd(recording.position_m.ravel())
    turn = 2 * rounding_sd(recording.quaternion.ravel())
    size = float(np.linalg.norm(np.ptp(recording.position_m, axis=0))) + length
    place = position * (position <= _FINE * length) + turn * size * (turn <= _FINE)
    return Noise(
        together(stated_force, force),
        together(stated_moment, moment),
        recording.noise_pose_m,
        place * LARGEST_OVER_SD,
        stated_force >= _DITHER * force and stated_moment >= _DITHER * moment,
    )


def together(stated: float, rounding: float) -> float:
    """Standard deviation of the sum of noise and rounding."""
    return stated if rounding <= _NEGLIGIBLE * stated else float(np.hypot(stated, rounding))
