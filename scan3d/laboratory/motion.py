"""One continuous log cut into sweeps, by the motion of the clamp: straight strokes along the x axis of its frame.

Approaches and retracts move along or across the rod in other directions and are left out, and so are rows in which the clamp
turns.  A stroke without contact is a sweep as well, because it shows that nothing is there.  Sweeps are along -x.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scan3d.arrays import NEGLIGIBLE, Array, Mask, ratio
from scan3d.errors import InputError
from scan3d.laboratory.air import SD_OVER_MAD
from scan3d.laboratory.maps import Map

# Displacements over which the direction is determined are at least this many standard deviations of the positions' errors.
_OVER_JITTER = 20.0
# The clamp turns if its axes change by more than this many radians over a displacement.
_TURNING = 0.02
_AXES = ("+x", "-x", "+y", "-y", "+z", "-z")


def strokes(position: Array, quaternion: Array, length: float) -> tuple[NDArray[np.int64], Mask]:
    """The strokes along the x axis of the clamp, of poses (n, 3) and (n, 4); `length` is the rod's.

    (n,) the number of the stroke of each row, -1 outside strokes, and whether each stroke (s,) is along +x.
    """
    n = len(position)
    # standard deviation of the errors of positions, by noise and by rounding
    jitter = float(np.hypot(_error(position), max(_encoder_step(column) for column in position.T)))
    jitter = jitter if jitter > NEGLIGIBLE * length else 0.0
    axes = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()[:, :, 0]
    lag, moved = _displacements(position, jitter)
    along = ratio((moved * axes).sum(axis=1), np.linalg.norm(moved, axis=1))
    turned = np.linalg.norm(axes[np.minimum(np.arange(n) + lag, n - 1)] - axes, axis=1)
    turn_error = 4 * _error(axes)
    straight = (lag > 0) & (turned < _TURNING + turn_error)
    direction = np.where(straight & (np.abs(along) > np.cos(0.2)), np.sign(along), 0).astype(np.int8)
    sweep = np.full(n, -1, dtype=np.int64)
    signs: list[bool] = []
    for start, stop, sign in _joined(_runs(direction, lag), position, jitter):
        travel = _travel(position[start:stop], axes[start], jitter)
        turn = np.linalg.norm(axes[stop - 1] - axes[start])
        # shorter ones are turning points, and those that turn more lead to another side of the body
        long = travel >= max(0.02 * length, _OVER_JITTER * jitter) and stop - start >= 3
        if long and turn <= 0.2 * travel / length + turn_error:
            sweep[start:stop] = len(signs)
            signs.append(sign > 0)
    return sweep, np.array(signs, dtype=bool)


def _travel(position: Array, axis: Array, jitter: float) -> float:
    """Length of the line from the first to the last position (n, 3).

    It is 0 if the line is not along the axis (3,), or if the other positions leave it by more than a fraction of it.
    """
    line = position[-1] - position[0]
    length = float(np.linalg.norm(line))
    if length == 0 or abs(line @ axis) < np.cos(0.1) * length:
        return 0.0
    off = np.linalg.norm(np.cross(position - position[0], line / length), axis=1).max()
    return length if off <= 0.05 * length + _OVER_JITTER / 4 * jitter else 0.0


def _error(values: Array) -> float:
    """Standard deviation of the errors of successive values (n, k), from their second differences."""
    if len(values) < 3:
        return 0.0
    second = np.abs(np.diff(values, n=2, axis=0)[:: max(1, len(values) // 20_000)])
    # of three independent errors with the weights 1, -2, 1
    return float(np.median(second, axis=0).max()) * SD_OVER_MAD / float(np.sqrt(6))


def _encoder_step(values: Array) -> float:
    """The step of a coordinate (n,) that stalls and jumps because it moves by less from row to row; 0 for others."""
    steps = np.abs(np.diff(values))
    moves = steps > 0
    if not moves.any():
        return 0.0
    beside = np.append(False, moves[:-1]) | np.append(moves[1:], False)
    stalls = int((beside & ~moves).sum())
    return float(np.median(steps[moves])) if 5 * stalls > (beside | moves).sum() else 0.0


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
        if far.mean() >= 0.25:  # the usual motion; 16 times slower motion is still recognised
            largest = min(largest, 16 * window)
        window *= 2
    return lag, moved


def _runs(direction: NDArray[np.int8], lag: NDArray[np.intp]) -> list[tuple[int, int, int]]:
    """Runs of rows that begin or end a displacement in one direction: first row, the one after the last, and the sign."""
    edges = [0, *(np.flatnonzero(np.diff(direction)) + 1).tolist(), len(direction)]
    found = [
        (start, stop + int(lag[stop - 1]), int(direction[start]))
        for start, stop in zip(edges[:-1], edges[1:], strict=True)
        if direction[start]
    ]
    # a row at a turning point ends one stroke and begins another one, which gets it
    for k, (following, _, other) in enumerate(found[1:]):
        start, stop, sign = found[k]
        if other != sign:
            found[k] = start, min(stop, following), sign
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
            if start <= last or away <= max(1e-3 * travel, 6 * jitter, 2 * step):
                joined[-1] = first, max(stop, last), sign
                continue
        joined.append((start, stop, sign))
    return joined


def without_transfers(
    sweep: NDArray[np.int64], touched: Mask, position: Array, quaternion: Array, length: float
) -> tuple[NDArray[np.int64], int]:
    """The numbers (n,) without strokes that are no evidence of empty space, and how many these are.

    A stroke in which hardly any of the rows (n,) touch counts as a sweep beside one with contact that has the same
    orientation, if the clamp is no farther from the body along the rod, and if both pass each other.  Elsewhere the rod may
    have been out of reach.
    """
    numbers, first, last = _ends(sweep)
    place = np.searchsorted(numbers, sweep[sweep >= 0])
    hits, count = np.bincount(place, weights=touched[sweep >= 0]), np.bincount(place)
    with_contact = (hits >= 3) & (hits >= 0.01 * count)
    if not with_contact.any():
        return sweep, 0
    axes = Rotation.from_quat(quaternion[first], scalar_first=True).as_matrix()
    kept = with_contact.copy()
    for k in np.flatnonzero(~with_contact):
        same = with_contact & (np.abs(axes - axes[k]).max(axis=(1, 2)) < _TURNING)
        x, y = axes[k, :, 0], axes[k, :, 1]
        reaches = position[first[k]] @ y >= position[first] @ y - 0.05 * length
        start, end = np.sort([position[first] @ x, position[last] @ x], axis=0)
        kept[k] = (same & reaches & (start <= end[k]) & (start[k] <= end)).any()
    renumbered = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
    return renumbered[np.where(sweep >= 0, np.searchsorted(numbers, sweep), -1)], int((~kept).sum())


def _ends(sweep: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.intp], NDArray[np.intp]]:
    """The numbers (s,) of the sweeps of rows (n,), and the first and last row of each."""
    rows = np.flatnonzero(sweep >= 0)
    numbers, first = np.unique(sweep[rows], return_index=True)
    _, last = np.unique(sweep[rows][::-1], return_index=True)
    return numbers, rows[first], rows[::-1][last]


def travel_angles(sweep: NDArray[np.int64], position: Array, quaternion: Array) -> Array:
    """Angle (s,) in radians of each sweep's travel to the -x axis of the clamp; NaN for one without travel."""
    numbers, first, last = _ends(sweep)
    if not len(numbers):
        return np.empty(0)
    travel = position[last] - position[first]
    axes = Rotation.from_quat(quaternion[first], scalar_first=True).as_matrix()[:, :, 0]
    cosine = ratio(-(travel * axes).sum(axis=1), np.linalg.norm(travel, axis=1))
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)))


def check_directions(
    map: Map, where: str, sweep: NDArray[np.int64], position: Array, quaternion: Array, touched: Mask
) -> None:
    """Raise InputError if there is no sweep, or if most are not along -x of the clamp's frame, or do not hold the contacts.

    `where` is the name of the table, and `touched` (n,) are the rows in contact.
    """
    angle = travel_angles(sweep, position, quaternion)
    known = angle[np.isfinite(angle)]
    if len(angle) and not len(known):
        raise InputError(
            f"{where}: the clamp does not move in any of the {len(angle)} sweeps; check [columns] position and sweep of "
            f"{map.name}"
        )
    if map.directions == "both":
        known = np.minimum(known, np.pi - known)
    held = float((sweep >= 0)[touched].mean()) if touched.any() else 1.0
    # retracts and strokes back hold contacts as well, but not most of them; a sweep is along the axis within 0.3 rad
    if len(known) and (known < 0.3).mean() >= 0.5 and held >= 0.2:
        return
    axis = _usual_axis(np.where(touched, 0, -1) if held < 0.2 else sweep, position, quaternion)
    advice = (
        "check orientation (its order of columns or its convention) and position under [columns], [units] angle, and the "
        "clamp's frame under [clamp], with y along the rod and x against the sweep"
    )
    if axis == "+x":
        advice += '; strokes in both directions are taken by directions = "both" under [sweeps]'
    raise InputError(
        f"{where}: the clamp moves {'in contact ' if held < 0.2 else ''}mostly along {axis} of its own frame, and not "
        f"along -x as in a sweep; in {map.name} {advice}"
    )


def _usual_axis(sweep: NDArray[np.int64], position: Array, quaternion: Array) -> str:
    step = np.diff(position, axis=0)
    rows = (sweep[1:] >= 0) & (sweep[1:] == sweep[:-1])
    rows = rows if step[rows].any() else np.ones(len(step), dtype=bool)
    if not rows.any():
        return "no axis"
    local = Rotation.from_quat(quaternion[:-1][rows], scalar_first=True).apply(step[rows], inverse=True)
    lengths = np.stack([np.maximum(local, 0).sum(axis=0), np.maximum(-local, 0).sum(axis=0)], axis=1).ravel()
    return _AXES[int(np.argmax(lengths))]
