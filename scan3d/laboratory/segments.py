"""One continuous log cut into sweeps: strokes of the clamp along the x axis of its frame.

Approaches and retracts move along or across the rod in other directions and are left out, and so are rows in which the clamp
turns.  A stroke without contact is a sweep as well, because it shows that nothing is there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, Mask

# The clamp moves along an axis if the direction deviates from it by less than this, in radians.  Larger, oblique approaches
# count as sweeps; smaller, the jitter of poses interrupts sweeps.
_ALONG = 0.2
# A whole stroke deviates by less than this.
_STRAIGHT = 0.1
# Displacements over which the direction is determined are at least this many standard deviations of the positions' errors.
# Larger, slow strokes are lost; smaller, the errors turn the direction.
_OVER_JITTER = 20.0
# Motion this many times slower than the usual one is still recognised.  Larger, the clamp counts as moving before it does;
# smaller, slow sweeps beside fast transfers are lost.
_SLOWER = 16
# The usual motion is that of at least this fraction of the rows.
_USUAL = 0.25
# Rows from which medians are taken, evenly spread.
_SOME = 20_000
# Errors of positions below this fraction of the rod's length do not count.
_EXACT = 1e-9
# Positions are steps of an encoder if they stall in at least this fraction of the rows beside a step.
_STALLS = 0.2
# A stroke is a sweep if it is at least this fraction of the rod's length, and has so many rows.  Larger, short sweeps past the
# ends of a body are lost; smaller, turning points count as sweeps.
_SHORTEST, _FEWEST = 0.02, 3
# Strokes are one sweep if the clamp has moved by less than this fraction of the first one between them, or by the jitter.
_PAUSED = 1e-3
# A stroke is straight if its positions leave the line between its ends by no more than this fraction of its length, as in
# the tests of recordings.  Larger, transfers in an arc count as sweeps; smaller, the errors of a robot's path end sweeps.
_OFF_LINE = 0.05
# A stroke without contact is beside one with contact if their axes differ by less than this, and if its clamp is farther from
# the body by less than this fraction of the rod's length.  Larger, transfers out of the rod's reach count as empty slices, and
# the body's height is bounded wrongly; smaller, empty slices are lost.
_SAME_TURN, _RETRACTED = 0.02, 0.05
# Rows of a stroke with contact at least, and their fraction.
_HITS, _HIT_FRACTION = 3, 0.01
# The clamp turns if its axes change by more than this many radians over a displacement, and more than by jitter.
_TURNING = 0.02
# A stroke may turn by this many radians per rod length of its travel.  Larger, transfers to another side of the body count as
# sweeps; smaller, sweeps are lost in which the clamp turns.
_TURNS = 0.2


class Strokes(NamedTuple):
    """Which stroke each row belongs to."""

    sweep: NDArray[np.int64]
    """(n,) number of the stroke, -1 outside strokes."""
    backwards: Mask
    """(s,) whether the stroke is along +x of the clamp's frame."""


def strokes(position: Array, quaternion: Array, length: float) -> Strokes:
    """The strokes of the clamp along the x axis of its frame, in both directions.

    position, quaternion
        (n, 3) and (n, 4) poses of the clamp in the world.
    length
        of the rod.
    """
    n = len(position)
    jitter = _jitter(position, length)
    axes = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()[:, :, 0]
    lag, moved = _displacements(position, jitter)
    size = np.linalg.norm(moved, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        along = (moved * axes).sum(axis=1) / size
    later = np.minimum(np.arange(n) + lag, n - 1)
    turned = np.linalg.norm(axes[later] - axes, axis=1)
    turn_sd = _second_difference_sd(axes)
    straight = (lag > 0) & (turned < _TURNING + 4 * turn_sd)
    direction = np.zeros(n, dtype=np.int8)
    direction[straight & (along < -np.cos(_ALONG))] = -1
    direction[straight & (along > np.cos(_ALONG))] = 1
    runs = _joined(_runs(direction, lag), position, jitter)
    travel = np.array([_travel(position[a:b], axes[a], jitter) for a, b, _ in runs])
    shortest = max(_SHORTEST * length, _OVER_JITTER * jitter)
    # what is curved has no travel
    kept = [
        run
        for run, way in zip(runs, travel, strict=True)
        if way >= shortest
        and run[1] - run[0] >= _FEWEST
        and np.linalg.norm(axes[run[1] - 1] - axes[run[0]]) <= _TURNS * way / length + 4 * turn_sd
    ]
    sweep = np.full(n, -1, dtype=np.int64)
    for number, (start, stop, _) in enumerate(kept):
        sweep[start:stop] = number
    return Strokes(sweep, np.array([sign > 0 for *_, sign in kept], dtype=bool))


def _travel(position: Array, axis: Array, jitter: float) -> float:
    """Length of the line from the first to the last position (n, 3).

    It is 0 if the line is not along the axis (3,), or if the other positions leave it by more than a fraction of it.
    """
    line = position[-1] - position[0]
    length = float(np.linalg.norm(line))
    if length == 0 or abs(line @ axis) < np.cos(_STRAIGHT) * length:
        return 0.0
    off = np.linalg.norm(np.cross(position - position[0], line / length), axis=1).max()
    return length if off <= _OFF_LINE * length + _OVER_JITTER / 4 * jitter else 0.0


def _second_difference_sd(values: Array) -> float:
    """Standard deviation of the errors of successive values (n, k), from their second differences."""
    if len(values) < 3:
        return 0.0
    second = np.abs(np.diff(values, n=2, axis=0)[:: max(1, len(values) // _SOME)])
    # of three independent errors with the weights 1, -2, 1
    return float(np.median(second, axis=0).max()) * 1.4826 / float(np.sqrt(6))


def _step(values: Array) -> float:
    """The step of a coordinate (n,) that stalls and jumps because it moves by less from row to row; 0 for others."""
    steps = np.abs(np.diff(values))
    moves = steps > 0
    if not moves.any():
        return 0.0
    beside = np.zeros(len(moves), dtype=bool)
    beside[1:] |= moves[:-1]
    beside[:-1] |= moves[1:]
    stalls = beside & ~moves
    return float(np.median(steps[moves])) if stalls.sum() > _STALLS * (beside | moves).sum() else 0.0


def _jitter(position: Array, length: float) -> float:
    """Standard deviation of the errors of positions (n, 3), by noise and by rounding; 0 if they count as exact."""
    rounding = max(_step(column) for column in position.T)
    error = float(np.hypot(_second_difference_sd(position), rounding))
    return error if error > _EXACT * length else 0.0


def _displacements(position: Array, jitter: float) -> tuple[NDArray[np.intp], Array]:
    """Rows (n,) after which the clamp has moved by many times the jitter, 0 where it stands, and the displacements (n, 3)."""
    n = len(position)
    lag, moved = np.zeros(n, dtype=np.intp), np.zeros((n, 3))
    window, largest = 1, 1 if jitter == 0 else n // 8
    while window <= largest and window < n:
        step = position[window:] - position[:-window]
        far = np.linalg.norm(step, axis=1) > _OVER_JITTER * jitter
        new = np.flatnonzero(far & (lag[:-window] == 0))
        lag[new], moved[new] = window, step[new]
        if far.mean() >= _USUAL:
            largest = min(largest, _SLOWER * window)
        window *= 2
    return lag, moved


def _runs(direction: NDArray[np.int8], lag: NDArray[np.intp]) -> list[tuple[int, int, int]]:
    """Runs of rows that begin or end a displacement in one direction: first row, the one after the last, and the sign."""
    edges = np.flatnonzero(np.diff(direction)) + 1
    bounds = [0, *edges.tolist(), len(direction)]
    found: list[tuple[int, int, int]] = []
    for start, stop in zip(bounds[:-1], bounds[1:], strict=True):
        if direction[start]:
            found.append((start, stop + int(lag[stop - 1]), int(direction[start])))
    # a row at a turning point ends one stroke and begins another one, which gets it
    for k in range(len(found) - 1):
        start, stop, sign = found[k]
        if found[k + 1][2] != sign:
            found[k] = start, min(stop, found[k + 1][0]), sign
    return found


def _joined(runs: list[tuple[int, int, int]], position: Array, jitter: float) -> list[tuple[int, int, int]]:
    """The runs, those of one direction joined between which the clamp only paused."""
    joined: list[tuple[int, int, int]] = []
    for start, stop, sign in runs:
        if joined and joined[-1][2] == sign:
            first, last, _ = joined[-1]
            travel = float(np.linalg.norm(position[last - 1] - position[first]))
            between = position[min(last, start) - 1 : max(last, start) + 1]
            away = float(np.ptp(between, axis=0).max()) if len(between) else 0.0
            step = float(np.linalg.norm(position[min(start + 1, len(position) - 1)] - position[start]))
            if start <= last or away <= max(_PAUSED * travel, 6 * jitter, 2 * step):
                joined[-1] = first, max(stop, last), sign
                continue
        joined.append((start, stop, sign))
    return joined


def with_rows(sweep: NDArray[np.int64], rows: Mask) -> NDArray[np.int64]:
    """Numbers of the strokes in which some of the rows (n,) are, and more than a few of their own."""
    numbers, place = np.unique(sweep, return_inverse=True)
    count, hits = np.bincount(place), np.bincount(place, weights=rows)
    return numbers[(numbers >= 0) & (hits >= _HITS) & (hits >= _HIT_FRACTION * count)]


def transfers(
    sweep: NDArray[np.int64], touching: NDArray[np.int64], position: Array, quaternion: Array, length: float
) -> NDArray[np.int64]:
    """Numbers of the strokes without contact that are no evidence of empty space: the rod may have been out of reach.

    Those in `touching` have contact.  A stroke without contact counts as a sweep beside one with contact that has the same
    orientation, if the clamp is no farther from the body along the rod, and if both pass each other.
    """
    numbers, first = np.unique(sweep, return_index=True)
    numbers, first = numbers[numbers >= 0], first[numbers >= 0]
    last = len(sweep) - 1 - np.unique(sweep[::-1], return_index=True)[1]
    last = last[-len(numbers) :] if len(numbers) else last[:0]
    with_contact = np.isin(numbers, touching)
    axes = Rotation.from_quat(quaternion[first], scalar_first=True).as_matrix() if len(first) else np.empty((0, 3, 3))
    left = []
    for k in np.flatnonzero(~with_contact):
        same = with_contact & (np.abs(axes - axes[k]).max(axis=(1, 2)) < _SAME_TURN)
        x, y = axes[k, :, 0], axes[k, :, 1]
        reaches = position[first[k]] @ y >= position[first] @ y - _RETRACTED * length
        start, end = np.sort([position[first] @ x, position[last] @ x], axis=0)
        if not (same & reaches & (start <= end[k]) & (start[k] <= end)).any():
            left.append(int(numbers[k]))
    return np.array(left, dtype=np.int64)


def numbered(sweep: NDArray[np.int64], sweeping: Mask) -> NDArray[np.int64]:
    """Numbers (n,) of the sweeps of a log with given moves: -1 outside of them."""
    return np.where(sweeping, sweep, -1)


def runs_of(sweeping: Mask) -> NDArray[np.int64]:
    """Number (n,) of each run of rows in which the robot sweeps, -1 between runs."""
    starts = np.diff(np.concatenate([[False], sweeping]).astype(np.int8)) == 1
    return np.where(sweeping, np.cumsum(starts) - 1, -1)


def travel_angles(sweep: NDArray[np.int64], position: Array, quaternion: Array) -> Array:
    """Angle (s,) in radians of each sweep's travel to the -x axis of the clamp; NaN for one without travel."""
    if not (sweep >= 0).any():
        return np.empty(0)
    rows = np.flatnonzero(sweep >= 0)
    _, first = np.unique(sweep[rows], return_index=True)
    _, last = np.unique(sweep[rows][::-1], return_index=True)
    first, last = rows[first], rows[::-1][last]
    travel = position[last] - position[first]
    axes = Rotation.from_quat(quaternion[first], scalar_first=True).as_matrix()[:, :, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = -(travel * axes).sum(axis=1) / np.linalg.norm(travel, axis=1)
    angle: Array = np.arccos(np.clip(cosine, -1, 1))
    return angle
