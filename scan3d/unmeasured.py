"""Rows of a log that hold no measurement, though they hold numbers: what repeats, saturates or is held while the clamp moves.

A sensor whose stream stops leaves its last value, which the logger repeats in each row that follows; one channel may do so
alone.  A sensor with noise hardly ever shows one value many times.  How often it may is known from its noise and from the step
between its values: white noise of the standard deviation s leaves the step of the width q in which it is with the probability
``1 - P(|e| < q/2)`` at least.  Second differences of three values that differ from each other are larger than two steps only if
the values lie on three steps or more, which tells s, whatever the level between two steps.  So a coarse converter, whose
values repeat for long, is never taken for a sensor that stopped, and a log without any noise, as a simulation writes it, has
nothing that could be told from one.

A channel that many rows share the extreme value of is saturated there.

Poses that a logger repeats, because it asks for them less often than for the wrench, change by several rows' way at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation, Slerp
from scipy.special import ndtr, pdtrc

from scan3d.arrays import SOME, Array, Index, Mask, evenly

CHANCE = 1e-5
"""Probability that a right log has a run that counts as none."""
SEVERAL = 4.0
"""Usual runs from which a longer one counts at least, and rows that are more than chance: a logger that is not in step with the
sensor writes a value two or three times."""
# Values in the air, at least, that tell the noise.
_FEWEST = 20
# Part of usual changes that counts as none.
_STILL = 0.01
# Rows before and after a run that tell how values repeat there.
_BESIDE = 200
# Values in the air, at least, for each run that repeats: a simulated log without noise has light touches only beside such runs.
_FRESH = 20


class Gap(NamedTuple):
    """Rows in which something was not measured."""

    channel: int
    """Number of the channel; -1: all of them."""
    saturated: bool
    """Whether the channel is at the end of its range; else it repeats one value."""
    value: float
    """Of the channel, 0 for several stretches with one value each; of all of them 0 if that is their value, else NaN."""
    rows: Index
    """Their numbers, increasing.  The first row of a stretch that repeats is not among them, unless it is an error code: it was
    measured."""
    every: float = 0.0
    """Mean number of rows for each value of a sensor that is slower than its log, which repeats it; else 0."""


def gaps(values: Array, air: Mask, pose: Array) -> list[Gap]:
    """What was not measured of the channels (n, c) of a log.

    air
        (n,) rows that are in the air as far as that is known; those that repeat may be among them.
    pose
        (n, k) of the clamp, which has to move.
    """
    varying = np.flatnonzero((values != values[0]).any(axis=0))
    if not len(varying):
        return []
    differs = np.ones((len(values), len(varying)), dtype=bool)
    differs[1:] = values[1:, varying] != values[:-1, varying]
    changes = _changes(values[:, varying], air)
    fresh: Mask = np.asarray(changes.any(axis=1))
    found: list[Gap] = []
    chances, still = (
        np.array([_chance(values[:, k], air, each[:, j]) for j, k in enumerate(varying)]) for each in (differs, changes)
    )
    stopped = _repeating(fresh, values[:, varying], np.minimum(still + _STILL, 1.0), pose)
    # a sensor may be slower than its log
    usual = len(values) / fresh.sum()
    if not _noisy(values[:, varying], air & fresh, len(stopped), int(SEVERAL * usual)):
        return []
    alone = [_repeating(differs[:, j], values[:, [k]], chances[[j]], pose) for j, k in enumerate(varying)]
    for j, k in enumerate(varying):
        alone[j] = alone[j] if _noisy(values[:, [k]], air & differs[:, j], len(alone[j])) else []
    left = np.zeros(len(values), dtype=bool)

    def add(gap: Gap) -> None:
        if len(gap.rows):
            found.append(gap)
            left[gap.rows] = True

    rows = _rows(stopped, values[:, varying])
    add(Gap(-1, False, float("nan") if values[rows].any() else 0.0, rows))
    other: Mask = np.asarray(differs.any(axis=1))
    first = np.flatnonzero(other)[np.cumsum(other) - 1]
    # a simulation shows zeros in the air
    slow = ~left & (pose != pose[first]).any(axis=1) & values.any(axis=1)
    if (count := int(slow.sum())) > SEVERAL and pdtrc(count - 1, SEVERAL * _together(differs[~left])) < CHANCE:
        add(Gap(-1, False, 0.0, np.flatnonzero(slow), len(other) / other.sum()))
    for k in varying:
        for value, rows in _saturated(values[:, k], air, ~left, other):
            add(Gap(int(k), True, value, rows))
    for k, runs in zip(varying, alone, strict=True):
        rows = _rows(runs, values[:, [k]])
        rows = rows[~left[rows]]
        if len(rows) < SEVERAL:  # what is left of runs of all channels
            continue
        add(Gap(int(k), False, float(values[rows[0], k]) if len(runs) == 1 and len(rows) else 0.0, rows))
    return found


def silent(values: Array, air: Mask) -> Index:
    """The channels that hold one value in all rows of a log (n, c) whose other channels have noise in the air (n,)."""
    varying = (values != values[:1]).any(axis=0)
    return np.flatnonzero(~varying) if _noisy(values[:, varying], air, 0) else np.empty(0, dtype=np.intp)


def of_all(found: Iterable[Gap], count: int) -> Mask:
    """(n,) the rows in which anything was not measured."""
    rows = np.zeros(count, dtype=bool)
    for gap in found:
        rows[gap.rows] = True
    return rows


def parts(sweep: NDArray[np.int64], measured: Mask) -> NDArray[np.int64]:
    """Numbers (n,) of the sweeps, and further ones for the parts of a sweep that follow rows that were not measured.

    What the rod met in such rows is not known: the clamp did not sweep from one part to the next.
    """
    order = np.argsort(sweep, kind="stable")
    known = measured[order]
    after = np.append(False, np.diff(known.astype(np.int8)) > 0) & np.append(False, np.diff(sweep[order]) == 0)
    # the first part of a sweep keeps its number
    begun = np.cumsum(known)
    first = np.flatnonzero(np.append(True, np.diff(sweep[order]) != 0))
    count = np.diff(np.append(first, len(order)))
    seen = np.asarray(begun - known > np.repeat(begun[first] - known[first], count))
    starts = after & seen & (sweep[order] >= 0)
    part = np.cumsum(starts)
    since = part - np.repeat(part[first] - starts[first], count)
    found = sweep.copy()
    found[order] = np.where(since > 0, sweep.max() + part, sweep[order])
    return found


def sentence(
    gap: Gap, count: int, shown: Callable[[int, float], str], names: tuple[str, ...], where: Callable[[int], str]
) -> str:
    """What was not measured of a log with `count` rows, in words.

    shown
        a value of a channel, by its number, with its unit.
    names
        of the channels.
    where
        the time or the number of a row.
    """
    rows = gap.rows
    name = "the wrench" if gap.channel < 0 else names[gap.channel]
    if gap.every:
        often = f"in {len(gap.rows):,} rows, and changes every {gap.every:.3g} rows only"
        return f"{name} repeats the row before {often}: the sensor is slower than the log; these rows are left out"
    if gap.saturated:
        at = f"{name} is at {shown(gap.channel, gap.value)}, the end of its range, in {len(rows):,} rows"
        return f"{at}: the sensor saturates; these rows are left out"
    stretches = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    longest = max(stretches, key=len)
    end = "the end" if longest[-1] == count - 1 else where(int(longest[-1]))
    times = f"from {where(int(longest[0]) - 1)} to {end}"
    if len(stretches) > 1:
        times = f"in {len(stretches)} stretches, the longest of them {times}"
    value = "one value" if gap.channel < 0 or len(stretches) > 1 else shown(gap.channel, gap.value)
    what = "the sensor stopped" if gap.channel < 0 else "the channel is frozen"
    if gap.channel < 0 and gap.value == 0:
        value, what = "zero", f"{what}, or the log is that of a simulation, whose air has no noise"
    size = len(rows) + len(stretches)
    return f"{name} keeps {value} {times} ({size:,} rows) while the clamp moves: {what}; these rows are left out"


def _changes(values: Array, air: Mask) -> Mask:
    """Whether channels (n, c) change from the row before, and not as they did before, by more than a part of their noise.

    What programs do to a signal that stopped leaves much less than its noise: rounding, a drift that is taken off, a line
    between two rows.
    """
    change, bend = np.abs(np.diff(values, axis=0)), np.abs(np.diff(values, n=2, axis=0))
    inside = air[:-2] & air[1:-1] & air[2:]
    noise = np.quantile(bend[inside], 0.9, axis=0) if inside.any() else np.zeros(values.shape[1])
    changes = np.ones(values.shape, dtype=bool)
    changes[1:] = change > _STILL * noise
    changes[2:] &= (bend > _STILL * noise) | (noise == 0)
    return changes


def _repeating(differs: Mask, values: Array, chances: Array, pose: Array) -> list[tuple[int, int]]:
    """Runs of equal values that are no chance: the first row of each, and the one after its last.

    differs
        (n,) whether the row of the values (n, c) differs from the one before.
    chances
        (c,) largest probability that a channel repeats a value.
    """
    chance = float(chances.prod())
    start = np.flatnonzero(differs)
    stop = np.append(start[1:], len(differs))
    length = stop - start
    if chance >= 1:
        return []
    usual = float(np.median(length))
    long = np.flatnonzero(length > usual * _longest(chance, len(differs)))
    long = long[(pose[start[long]] != pose[stop[long] - 1]).any(axis=1)]
    found = []
    for a, b in zip(start[long].tolist(), stop[long].tolist(), strict=True):
        # a tare that follows a drift hides the steps of a converter elsewhere, but not beside the run
        chance = float(np.prod([_beside(column, a, b) for column in values.T]))
        if b - a > usual * _longest(chance, len(differs)):
            found.append((a, b))
    return found


def _together(changes: Mask) -> float:
    """Rows in which channels (n, c) repeat together by chance, as each of them does where another one changes."""
    found = 0.0
    for part in np.array_split(changes, max(1, len(changes) // _BESIDE)):
        fresh, chance = part.any(axis=1), 0.0
        if fresh.any():
            alone = 1 - part[fresh].mean(axis=0)
            for _ in range(_FEWEST):
                chance = float((alone * (1 - chance) + chance).prod())
        found += chance * len(part)
    return found


def _longest(chance: float, count: int) -> float:
    """The longest run among so many rows that is chance, where a value repeats with this probability."""
    if chance >= 1:
        return np.inf
    return SEVERAL if chance <= 0 else max(SEVERAL, float(np.log(CHANCE / count) / np.log(chance)))


def _beside(column: Array, start: int, stop: int) -> float:
    """The largest `_chance` of the rows of a channel (n,) before and after a run, or how often these all but repeat, as
    steps of a converter do that are tared of a drift; 1 where few of them differ."""
    found = []
    for rows in (column[max(start - _BESIDE, 0) : start + 1], column[stop : stop + _BESIDE]):
        change = np.abs(np.diff(rows))
        differs = np.append(True, change != 0)[: len(rows)]
        if differs.sum() > _FEWEST:
            # in the air, which is part of these rows
            equal = np.array_split(change <= _STILL * np.quantile(change, 0.9), max(1, len(change) // _FEWEST))
            still = max(float(part.mean()) for part in equal)
            # what repeats more often than not is in the middle of a step, and may stay there
            found.append(1.0 if still > 0.5 else max(still, _chance(rows, np.ones(len(rows), dtype=bool), differs)))
    return max(found, default=1.0)


def _rows(runs: list[tuple[int, int]], values: Array) -> Index:
    """The rows of runs but the first of each, which was measured, unless its values (n, c) are far from all others: an error
    code."""
    others = np.ones(len(values), dtype=bool)
    for start, stop in runs:
        others[start:stop] = False
    low, high = (bound(values[others], axis=0, initial=sign * np.inf) for bound, sign in ((np.min, 1), (np.max, -1)))
    coded = ((values < 2 * low - high) | (values > 2 * high - low)).any(axis=1)
    parts = [np.arange(start + (not coded[start]), stop) for start, stop in runs]
    return np.concatenate([np.empty(0, dtype=np.intp), *parts])


def _chance(column: Array, air: Mask, differs: Mask) -> float:
    """The largest probability with which a channel (n,) repeats a value in the air; 1 where its noise is not known."""
    values, step = column[differs], _step(column)
    inside = air[differs]
    inside = inside[:-2] & inside[1:-1] & inside[2:]
    if inside.sum() < _FEWEST:  # a channel that stopped in the first touch: a touch changes little in three rows
        inside = np.ones_like(inside)
    if step == 0 or len(inside) < _FEWEST:
        return 1.0
    large = np.abs(values[:-2] - 2 * values[1:-1] + values[2:])[inside] > 2.5 * step
    # touches, which change by many steps, are in few parts of the log
    pieces = np.array_split(large, max(1, min(_FEWEST, len(large) // _FEWEST)))
    share, sizes = float(np.quantile([piece.mean() for piece in pieces], 0.25)), _sizes()
    if share < sizes[1][0]:
        return 1.0
    size = float(np.interp(share, sizes[1], sizes[0]))
    return float(2 * ndtr(0.5 / size) - 1)


def _step(column: Array) -> float:
    """The smallest difference between two values of a channel (n,); 0 of one value."""
    gap = np.diff(np.unique(evenly(column, SOME)))
    gap = gap[gap > 1e-12 * np.abs(column).max()]  # less is rounding
    return float(gap.min()) if len(gap) else 0.0


@cache
def _sizes() -> tuple[Array, Array]:
    """Standard deviations of noise in steps, increasing, and how often it makes second differences of more than two steps.

    Of three values that differ from the one before, at the level between two steps where that is most often.
    """
    sizes, codes = np.geomspace(0.15, 4.0, 24), np.arange(-20, 21)
    first, middle, last = np.meshgrid(codes, codes, codes, indexing="ij", sparse=True)
    distinct = (first != middle) & (middle != last)
    large = distinct & (np.abs(first - 2 * middle + last) > 2)
    share = np.zeros(len(sizes))
    for k, size in enumerate(sizes):
        for level in np.linspace(0, 0.5, 6):
            part = ndtr((codes + 0.5 - level) / size) - ndtr((codes - 0.5 - level) / size)
            together = part[:, None, None] * part[:, None] * part
            share[k] = max(share[k], float((together * large).sum() / (together * distinct).sum()))
    return sizes, np.maximum.accumulate(share)


def _noisy(values: Array, fresh: Mask, runs: int, apart: int = 1) -> bool:
    """Whether the air has noise: successive differences of channels (n, c) there have opposite signs more than equal ones.

    fresh
        (n,) rows in the air that do not repeat the ones before.
    apart
        rows from one of these to the next at most.
    """
    rows = np.flatnonzero(fresh)
    if len(rows) < max(_FEWEST, _FRESH * runs):
        return False
    change, near = np.diff(values[rows], axis=0), np.diff(rows) <= apart
    before, after = change[:-1][near[:-1] & near[1:]], change[1:][near[:-1] & near[1:]]
    # steps of a converter jump among noise; each channel counts alike, and a jump of the zero as one sign
    return bool((np.sign(before) * np.sign(after)).sum() < 0)


def _saturated(column: Array, air: Mask, rows: Mask, fresh: Mask) -> list[tuple[float, Index]]:
    """The extreme values of a channel (n,) that many of the rows share, and which rows; none of them is in the air.

    fresh
        (n,) rows that do not repeat the ones before, which alone are counted.
    """
    found: list[tuple[float, Index]] = []
    known, step = column[rows & fresh], _step(column)
    if not len(known):
        return found
    for extreme, sign in ((known.min(), 1.0), (known.max(), -1.0)):
        at = rows & (column == extreme)
        beside = sign * (known - extreme)
        count = int((beside == 0).sum())
        # a peak has hardly more rows within the last step than within the one before, and of those within more steps no larger
        # part than a parabola; few rows may lie there by chance
        next_one = int(((beside > 0) & (beside < 1.5 * step)).sum())
        expected = min(int((beside < (k - 0.5) * step).sum()) / np.sqrt(k) for k in (4, 16, 64))
        if count > SEVERAL * max(1, next_one) and pdtrc(count - 1, expected) < CHANCE and not (at & air).any():
            found.append((float(extreme), np.flatnonzero(at)))
    return found


class Held(NamedTuple):
    """The poses of a log whose logger repeats them."""

    position: Array
    """(n, 3), interpolated between the changes of the poses where these come regularly."""
    quaternion: Array
    """(n, 4), likewise."""
    every: float
    """Usual number of rows from one change to the next while the clamp moves."""
    interpolated: Index
    """The rows whose pose is not the one that was logged."""
    stale: Index
    """The rows whose pose is not known: it stays for longer than usual, and then jumps, or the wrench goes on as in a sweep."""


# Steps of the poses, in rod lengths, that count: smaller ones are those of their digits.
_FINE = 1e-4
# Part of a channel's range that no clamp that stands has.
_TENTH = 0.1
# Ratio up to which speeds and ways are alike.
_ALIKE = 1.5
# Runs on either side that tell how the channels go on: three where that many follow each other.
_BESIDE_IT = (3, 1)
# Standard deviations of the noise by which a row may be off a value.
_SIGMAS = 4.0


def held_poses(position: Array, quaternion: Array, values: Array, length: float) -> Held | None:
    """The poses (n, 3) and (n, 4) of a log in which these repeat while the clamp moves; None if they do not.

    values
        (n, c) of the channels, by which a clamp that stops for each reading is told from one that moves on.
    length
        of the rod.
    """
    differs = np.ones(len(position), dtype=bool)
    differs[1:] = (position[1:] != position[:-1]).any(axis=1) | (quaternion[1:] != quaternion[:-1]).any(axis=1)
    start = np.flatnonzero(differs)
    if len(start) < _FEWEST or len(start) == len(position):
        return None
    count = np.diff(np.append(start, len(position))).astype(np.float64)
    turned = 2 * np.arccos(np.minimum(np.abs((quaternion[start[1:]] * quaternion[start[:-1]]).sum(axis=1)), 1.0))
    way = np.append(np.linalg.norm(np.diff(position[start], axis=0), axis=1) + length * turned, 0.0)
    every, usual = (median_filter(column, 7, mode="mirror") for column in (count, way))
    speed = median_filter(way / count, 7, mode="mirror")
    moves = way > _FINE * length
    regular = moves & (count <= SEVERAL * every) & (way <= _ALIKE * speed * count)
    regular &= speed * count <= _ALIKE * way
    long = (count > SEVERAL * np.maximum(every, 1)) & ~regular
    stale = long & (moves & (way > _ALIKE * usual))
    # of the last pose no jump tells, but the wrench
    stale[-1] = long[-1] and bool((np.ptp(values[start[-1] :], axis=0) > _TENTH * np.ptp(values, axis=0)).any())
    if regular.any() and not _moves_on(values, start, count, regular):
        regular[:] = False
    if not (regular.any() or stale.any()):
        return None
    knots, which = [start], [np.arange(len(start))]
    # where the clamp stood, it went on one step before the next pose
    rests = np.flatnonzero(~regular & ~stale & (count > every) & (every > 1) & moves)
    knots.append((start[rests] + count[rests] - every[rests]).astype(np.intp))
    which.append(rests)
    row, order = np.unique(np.concatenate(knots), return_index=True)
    pose = np.concatenate(which)[order]
    changed = np.zeros(len(position), dtype=bool)
    for k in np.flatnonzero(regular):
        changed[start[k] + 1 : start[k] + int(count[k])] = True
    for k in rests:
        changed[int(start[k] + count[k] - every[k]) + 1 : int(start[k] + count[k])] = True
    rows, lost = np.flatnonzero(changed), np.zeros(len(position), dtype=bool)
    for k in np.flatnonzero(stale):
        lost[start[k] + 1 : start[k] + int(count[k])] = True
    place, turn = position.copy(), quaternion.copy()
    if len(rows):
        known = position[start[pose]]
        place[rows] = np.stack([np.interp(rows, row, column) for column in known.T], axis=1)
        turns = Rotation.from_quat(quaternion[start[pose]], scalar_first=True)
        turn[rows] = Slerp(row, turns)(np.minimum(rows, row[-1])).as_quat(scalar_first=True)
    usual_rows = float(count[regular].mean()) if regular.any() else 1.0
    return Held(place, turn, usual_rows, rows, np.flatnonzero(lost))


def _moves_on(values: Array, start: Index, count: Array, regular: Mask) -> bool:
    """Whether the channels (n, c) go on within runs of equal poses as from run to run; they do not where the clamp stops."""
    scale = np.ptp(values, axis=0)
    scaled = values[:, scale > 0] / scale[scale > 0]
    if not scaled.size:
        return False
    mean = np.add.reduceat(scaled, start, axis=0) / count[:, None]
    within = scaled[start + count.astype(np.intp) - 1] - scaled[start]
    sums, rows = np.cumsum(np.vstack([0 * mean[:1], mean]), axis=0), np.append(0.0, np.cumsum(count))
    for runs in _BESIDE_IT:
        alike = np.convolve(regular, np.ones(2 * runs + 1), "same") > 2 * runs + 0.5
        at = np.flatnonzero(alike & (count > 1))
        if not len(at):
            continue
        across = (sums[at + runs + 1] - sums[at + 1] - sums[at] + sums[at - runs]) / runs
        apart = (rows[at + runs + 1] + rows[at + 1] - rows[at] - rows[at - runs]) / 2
        size = np.linalg.norm(across, axis=1)
        telling = (size >= np.quantile(size, 0.9)) & (size > 0)  # noise says nothing
        # 1 of a clamp that moves evenly, 0 of one that stops; a rod that snaps off counts as one run
        part = (within[at] * across).sum(axis=1)[telling] / size[telling] ** 2 * (apart / (count[at] - 1))[telling]
        part = np.clip(part, -2.0, 2.0)
        # noise alone has either sign alike
        if part.sum() > max(0.25 * len(part), _SIGMAS * np.sqrt((part**2).sum())):
            return True
    return False


# Blocks of a log in which the zero is looked for, their rows at least, and the part of these that have it at least.
_BLOCKS, _ROWS, _LEAST = 60, 40, 0.2
# Standard deviations of the noise, or steps of a converter, by which a zero that jumps is off at least.
_JUMP = 8.0
# Rows that a jump takes at most, as where the wrench of a log is interpolated or its sensor filters.
_TAKES = 8


def _levels(wrench: Array, noise: Array) -> list[tuple[int, int, Array]]:
    """Blocks of a wrench (n, c) in which many rows have one value up to noise: first row, the one after the last, and it."""
    edges = np.linspace(0, len(wrench), min(_BLOCKS, len(wrench) // _ROWS) + 1).astype(np.intp)
    found = []
    for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        some = evenly(wrench[start:stop], 200)
        near = (np.abs(some[:, None] - some) <= _SIGMAS * noise).all(axis=2)
        count = near.sum(axis=1)
        best = int(count.argmax())
        if count[best] > _LEAST * len(some):
            found.append((start, stop, np.median(some[near[best]], axis=0)))
    return found


def _step_between(wrench: Array, start: int, stop: int, size: Array, noise: Array) -> Jump | None:
    """The jump from row `start` to row `stop` of a wrench (n, c) that is nearest to a size (c,); None if none is up to noise.

    It may take some rows, and a contact changes by some of it meanwhile.
    """
    known = wrench[start:stop]
    most = max(_JUMP / 2, float((np.abs(size) / noise).max()) / 4)
    for rows in range(1, min(_TAKES, len(known) - 1) + 1):
        off = (np.abs(known[rows:] - known[:-rows] - size) / noise).max(axis=1)
        row = int(off.argmin())
        if off[row] <= most:
            return Jump(start + row + 1, start + row + rows, size)
    return None


def noise_of(wrench: Array) -> Array:
    """Standard deviations (c,) of white noise that the differences of successive rows (n, c) have."""
    steps = np.abs(np.diff(wrench, axis=0)) if len(wrench) > 1 else np.zeros((1, wrench.shape[1]))
    # the quartile of |x| is 0.3186 standard deviations, and those of differences are √2 times as large
    return np.asarray(np.percentile(steps[:: max(1, len(steps) // SOME)], 25, axis=0) / (0.3186 * np.sqrt(2)))


def reach_of(wrench: Array) -> Array:
    """(c,) the largest range of the forces, and that of the moments, of a wrench (n, c)."""
    reach = np.ptp(wrench, axis=0)
    half = wrench.shape[1] // 2
    return np.repeat([reach[:half].max(), reach[half:].max()], half)


class Jump(NamedTuple):
    """A jump of the sensor's zero, as where it is tared again."""

    row: int
    """The first row with the new zero."""
    stop: int
    """The first one that shows all of it: the rows from `row` on before are neither."""
    size: Array
    """(c,)"""


def jumps_of(wrench: Array, calm: Mask) -> list[Jump]:
    """Where the zero of a wrench (n, c) jumps.

    The zero is what many rows of a block share, up to noise; it has jumped if it differs from that of the blocks before by as
    much as some row from the ones before.  A rod that snaps off jumps as well, but to the zero.  Only rows that are `calm`
    (n,) count.
    """
    rows = np.flatnonzero(calm)
    known = wrench[rows]
    if len(known) < 4 * _ROWS:
        return []
    steps = np.array([_step(column) for column in known.T])
    noise = np.maximum(np.maximum(noise_of(known), 1e-4 * reach_of(known)), steps)
    levels = _levels(known, noise)
    found: list[Jump] = []
    before, last, alike = 0, 0, 1  # the block that has the zero now, the row where it began, and the blocks that had it
    for after in range(1, len(levels)):
        (start, _, here), (_, stop, there) = levels[before], levels[after]
        if (np.abs(there - here) <= _JUMP * noise).all():
            before, alike = after, alike + 1
            continue
        # a log may begin in contact
        step = _step_between(known, max(start, last), stop, there - here, noise) if found or alike > 1 else None
        if step is not None:
            # from the jump on the log has the new zero, and not the one before: a rod that snaps off returns to that
            following = known[step.stop : step.stop + 5 * (stop - start)]
            old, new = ((np.abs(following - zero) <= _SIGMAS * noise).all(axis=1).sum() for zero in (here, there))
            if new > old:
                found.append(Jump(int(rows[step.row]), int(rows[step.stop]), step.size))
                before, last, alike = after, step.stop, 1
    return found


def amid(found: list[Jump], count: int) -> Mask:
    """(n,) rows amid a jump."""
    rows = np.zeros(count, dtype=bool)
    for jump in found:
        rows[jump.row : jump.stop] = True
    return rows


def steps_of(found: list[Jump], count: int) -> Array:
    """(n, c) what jumps add to the zero of each row."""
    zero = np.zeros((count, len(found[0].size) if found else 6))
    for jump in found:
        zero[jump.stop :] += jump.size
    return zero
