"""What a rig has logged: the columns of a table as quantities in SI units, by a map, and the sweeps in them.

A continuous log is cut into sweeps by the motion of the clamp: straight strokes along the x axis of its frame.  Approaches and
retracts move along or across the rod in other directions and are left out, and so are rows in which the clamp turns.  A stroke
without contact is a sweep as well, because it shows that nothing is there.  Sweeps are along -x.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scan3d import units
from scan3d.arrays import LARGEST, MEDIAN_OF_NORMAL, NEGLIGIBLE, Array, Mask, ratio
from scan3d.errors import InputError
from scan3d.files.tables import Table
from scan3d.files.text import did_you_mean
from scan3d.laboratory import clocks
from scan3d.laboratory.signals import roughly_air
from scan3d.poses import MOVES, Move, measures
from scan3d.recording import CHANNELS
from scan3d.units import FACTORS, stated_unit, unit_of_cell
from scan3d.unmeasured import Held, gaps, held_poses, of_all, sentence, silent

if TYPE_CHECKING:
    from scan3d.laboratory.maps import Map, Orientation, Reference


@dataclass(frozen=True)
class Log:
    """What a rig has logged: n rows in SI units, in the frames of the robot and of the sensor."""

    time_s: Array | None
    """(n,) not falling; None if it was not logged."""
    position_m: Array
    """(n, 3) in the world."""
    quaternion: Array
    """(n, 4) orientation, w first."""
    wrench: Array
    """(n, 6) force in N and moment in N m; zero where the sensor has no such channel."""
    present: Mask
    """(6,) whether the sensor has the channel."""
    shown: Array
    """(n, k) force and moment as the sensor shows them, or signals, in the order of the columns."""
    by_shown: Array
    """(6, k) force and moment by what is shown."""
    sweep: NDArray[np.int64] | None
    """(n,) number of the sweep, -1 between sweeps; None if neither sweeps nor moves were logged."""
    probe: Mask | None
    """(n,) rows whose move is a probing; None if moves were not logged."""
    row: NDArray[np.int64]
    """(n,) row of the table."""
    unmeasured: Mask
    """(n,) rows whose wrench or pose was not measured."""
    repeated: int
    """Rows of the table that are not among these: they stand twice, or the sensor is slower than the table."""
    notes: tuple[str, ...]
    """Which ones these are, and which poses were interpolated."""

    def __len__(self) -> int:
        return len(self.position_m)


def read_log(table: Table, map: Map) -> Log:
    """The quantities of a table.  Raises InputError with the file, the line and the column of what can't be right."""
    columns = map.columns
    position = _vectors(table, map, columns.position, "length", "position")
    orientation = _orientation(table, map, columns.orientation)
    wrench, present, shown = _wrench(table, map)
    time = None if columns.time is None else _time(table, map, columns.time)
    pose = np.concatenate([position, orientation], axis=1)
    unmeasured, repeated, notes = _unmeasured(shown, wrench, pose, time)
    if time is not None:
        rows = np.column_stack([time, pose, wrench])
        twice = np.append(False, (rows[1:] == rows[:-1]).all(axis=1))
        repeated |= twice
        if twice.any():
            notes += (f"{int(twice.sum()):,} rows stand twice, with the same time: they are left out",)
    if map.wrench_delay_s:
        wrench = _undelayed(wrench, time, map, table, ~repeated)
        # what is interpolated from a row that was not measured was not either
        unmeasured = _undelayed(unmeasured[:, None].astype(np.float64), time, map, table, ~repeated)[:, 0] > 0
    kept = (np.abs(np.concatenate([pose, wrench], axis=1)) < LARGEST).all(axis=1)
    kept &= ~repeated if time is None else np.isfinite(time) & ~repeated
    if not kept.any():
        raise InputError(f"{table.name} has no row in which all columns of the map hold numbers")
    row = np.flatnonzero(kept)
    quaternion = _quaternions(table, map, orientation[row], row)
    if columns.orientation.of == "world":
        quaternion = quaternion * [1.0, -1.0, -1.0, -1.0]
    move = None if columns.move is None else table.words(_find(table, map, columns.move, "move")[0], MOVES)
    place, sweep, unmeasured = position[row], _sweeps(table, map, move), unmeasured[row]
    if (held := held_poses(place, quaternion, wrench[row], map.rod.length_m)) is not None:
        place, quaternion = held.position, held.quaternion
        unmeasured = unmeasured | np.isin(np.arange(len(row)), held.stale)
        notes += _of_poses(held, None if time is None else time[row])
    if columns.position_in != "world":
        place = Rotation.from_quat(quaternion, scalar_first=True).apply(place)
        place = -place if columns.position_in == "inverse" else place
    wrench = -wrench[row] if map.reversed_sign else wrench[row]
    if map.wrench_in == "world":
        wrench = _in_sensor(wrench, present, quaternion, map, table)
    log = Log(
        time_s=None if time is None else time[row],
        position_m=place,
        quaternion=quaternion,
        wrench=wrench,
        present=present,
        shown=shown.values[row],
        by_shown=shown.matrix,
        sweep=None if sweep is None else sweep[row],
        probe=None if move is None else (move == Move.PROBE)[row],
        row=row,
        unmeasured=unmeasured,
        repeated=int(repeated.sum()),
        notes=notes,
    )
    if log.time_s is not None and len(log) > 1:
        _check_order(log.time_s, log.row, table)
        if not np.diff(log.time_s).any():
            raise InputError(
                f"{table.name}: the column of the time has the same value in all {len(log)} rows; leave time out of "
                "the map"
            )
    for name, channels in (("force", slice(0, 3)), ("moment", slice(3, 6))):
        if present[channels].any() and not log.wrench[:, channels].any():
            entry = "signals" if columns.signals else name
            raise InputError(
                f"{table.name}: the {name} is zero in all {len(log)} rows: nothing was measured; check [columns] "
                f"{entry} of {map.name}, and the sensor"
            )
    return log


class _Shown(NamedTuple):
    """What the sensor shows: channels as they are logged, of which some are measured together."""

    values: Array
    """(n, k)"""
    matrix: Array
    """(6, k) force and moment by the channels."""
    names: tuple[str, ...]
    words: Callable[[int, float], str]
    """A value of a channel with its unit."""


def _wrench(table: Table, map: Map) -> tuple[Array, Mask, _Shown]:
    """Forces and moments (n, 6), which of them (6,) the sensor has, and what it shows."""
    columns = map.columns
    if not columns.signals:
        both = ((columns.force, "force"), (columns.moment, "moment"))
        parts = [_vectors(table, map, references, entry, entry) for references, entry in both]
        known = [one[axis] != "" for one, _ in both for axis in range(3)]
        wrench, channels = np.concatenate(parts, axis=1), np.flatnonzero(known)
        names = tuple(CHANNELS[k] for k in channels)

        def words(k: int, value: float) -> str:
            return units.force(value) if channels[k] < 3 else units.moment(value)

        return wrench, np.array(known), _Shown(wrench[:, channels], np.eye(6)[:, channels], names, words)
    signals = _vectors(table, map, columns.signals, "", "signals")
    names, matrix, offset = map.transducer
    if not matrix:
        raise InputError(
            f"{table.name}: the signals need the matrix that makes force and moment of them: state it under [sensor] of "
            f"{map.name}, or give a rig that scan3d calibrate --known has found, as --rig"
        )
    if len(offset) != signals.shape[1]:
        raise InputError(
            f"{table.name}: the calibrated rig is that of {len(offset)} signals, and [columns] signals of {map.name} names "
            f"{signals.shape[1]}; name the same ones, in the same order"
        )
    told, by_signals = [CHANNELS.index(name) for name in names], np.zeros((6, len(offset)))
    present: Mask = np.isin(np.arange(6), told)
    by_signals[told] = matrix
    by_signals *= np.repeat([map.factors["force"], map.factors["moment"]], 3)[:, None]
    wrench = (signals - offset) @ by_signals.T
    titles = tuple(table.title(_find(table, map, name, "signals")[0]) for name in columns.signals)
    return wrench, present, _Shown(signals, by_signals, titles, lambda _, value: f"{value:.4g}")


def _unmeasured(shown: _Shown, wrench: Array, pose: Array, time: Array | None) -> tuple[Mask, Mask, tuple[str, ...]]:
    """The rows (n,) in which a channel repeats or is saturated, those that a sensor slower than its log repeats, and sentences
    on them."""
    known = np.flatnonzero(np.isfinite(np.concatenate([shown.values, pose], axis=1)).all(axis=1))
    rows, repeated = np.zeros((2, len(pose)), dtype=bool)
    if not len(known):
        return rows, repeated, ()
    values, air = shown.values[known], roughly_air(wrench[known])
    found = gaps(values, air, pose[known])
    rows[known] = of_all((gap for gap in found if not gap.every), len(known))
    repeated[known] = of_all((gap for gap in found if gap.every), len(known))
    at = (lambda k: f"row {known[k] + 1}") if time is None else (lambda k: f"{time[known[k]]:.1f} s")
    dead = tuple(
        f"{shown.names[k]} is {shown.words(int(k), float(values[0, k]))} in all rows, where other channels have noise: if it "
        "was measured, the sensor is dead or too coarse there; if not, name no column for it in the map"
        for k in silent(values, air)
    )
    return rows, repeated, dead + tuple(sentence(gap, len(known), shown.words, shown.names, at) for gap in found)


def _of_poses(held: Held, time: Array | None) -> tuple[str, ...]:
    """Sentences on poses that a logger repeats."""
    found = []
    if len(held.interpolated):
        every = f"{held.every:.3g} rows"
        if time is not None and (step := float(np.median(np.diff(time)))) > 0:
            every += f" ({1 / (held.every * step):.3g} Hz)"
        found.append(
            f"the poses change every {every} only while the clamp moves, in which the wrench changes from row to row: they are "
            f"interpolated between their changes, in {len(held.interpolated):,} rows"
        )
    if len(held.stale):
        found.append(
            f"the pose is held for longer than usual while the clamp moves, in {len(held.stale):,} rows, which are left out"
        )
    return tuple(found)


def _undelayed(wrench: Array, time: Array | None, map: Map, table: Table, fresh: Mask) -> Array:
    """The wrenches (n, 6) of the times (n,) of the poses, between fresh ones; NaN where the log ends before."""
    if time is None:
        raise InputError(
            f"{table.name}: wrench_delay_s of {map.name} needs the time of the rows; name its column as time under "
            "[columns]"
        )
    _check_order(time, np.arange(len(time)), table)
    columns = [
        np.interp(time + map.wrench_delay_s, time[fresh], one, left=np.nan, right=np.nan) for one in wrench[fresh].T
    ]
    return np.stack(columns, axis=1)


def _in_sensor(wrench: Array, present: Mask, quaternion: Array, map: Map, table: Table) -> Array:
    """Wrenches (n, 6) with components along the world's axes, in the sensor's frame by the poses' orientations (n, 4)."""
    if not present.all():
        absent = ", ".join(name for name, known in zip(CHANNELS, present, strict=True) if not known)
        raise InputError(
            f'{table.name}: wrench_in = "world" of {map.name} needs all six channels, because the clamp\'s turn mixes them; '
            f"{absent} is missing"
        )
    turn = Rotation.from_quat(quaternion, scalar_first=True) * Rotation.from_matrix(map.clamp.turn @ map.sensor.turn)
    return np.concatenate([turn.apply(part, inverse=True) for part in np.hsplit(wrench, 2)], axis=1)


def _find(table: Table, map: Map, reference: Reference, entry: str) -> tuple[int, float]:
    where, names = f"[columns] {entry} of {map.name}", table.names
    if isinstance(reference, int):
        if reference > len(table.columns):
            raise InputError(
                f"{table.name} has {len(table.columns)} columns, and {where} names column {reference}; correct the map"
            )
        return reference - 1, 1.0
    if not names:
        raise InputError(
            f"{table.name} has no line with names, and {where} names {reference!r}; give the number of the column, "
            "from 1, or the line of the names as header under [table]"
        )
    bare, sign = (reference[1:], -1.0) if reference.startswith("-") and reference not in names else (reference, 1.0)
    found = [k for k, name in enumerate(names) if name == bare.strip()]
    if len(found) == 1:
        return found[0], sign
    table.refuse_other(bare, f", which {where} names,")
    line = f"{table.name}: line {table.layout.header}" if table.layout and table.layout.header else table.name
    if found:
        numbers = ", ".join(str(k + 1) for k in found)
        raise InputError(
            f"{line} has {len(found)} columns {reference!r} (numbers {numbers}), where {where} means one; give its "
            "number"
        )
    listed = ", ".join([*names[:30], *["..."] * (len(names) > 30)])
    inside = [name for name in names if reference and reference.lower() in name.lower()]
    near = f"; did you mean {inside[0]}?" if inside else did_you_mean([reference], names)
    raise InputError(f"{line} has no column {reference!r}, which {where} names; it has {listed}{near}")


def _numbers(table: Table, map: Map, reference: Reference, quantity: str, entry: str) -> Array:
    if reference == "":
        return np.zeros(len(table))
    column, sign = _find(table, map, reference, entry)
    if quantity:
        _check_unit(table, map, column, quantity)
    factor = sign * map.factors[quantity] if quantity else sign
    values = table.numbers(column, gaps=map.layout.missing == "drop")
    return values if factor == 1.0 else values * factor


def _vectors(table: Table, map: Map, references: tuple[Reference, ...], quantity: str, entry: str) -> Array:
    return np.stack([_numbers(table, map, name, quantity, entry) for name in references], axis=1)


def _orientation(table: Table, map: Map, orientation: Orientation) -> Array:
    """The columns (n, k) of the orientation: of a quaternion, or of angles in radians."""
    quantity = "" if orientation.kind in ("quaternion", "matrix") else "angle"
    values = _vectors(table, map, orientation.columns, quantity, f"orientation.{orientation.kind}")
    # angles count on beyond a turn on some rigs, but not so many
    if quantity and (largest := float(np.nanmax(np.abs(values), initial=0.0))) > 1e6:
        raise InputError(
            f"{table.name} has an angle of {largest:.3g} rad, {largest / (2 * np.pi):.3g} turns; check [columns] orientation "
            f"of {map.name}, and [units] angle"
        )
    return values


def _quaternions(table: Table, map: Map, values: Array, row: NDArray[np.int64]) -> Array:
    """Unit quaternions (n, 4), w first, of the orientation's columns (n, k) in rows (n,) of the table, as they are logged."""
    orientation = map.columns.orientation
    if orientation.kind == "euler":
        return np.asarray(Rotation.from_euler(orientation.convention, values).as_quat(scalar_first=True))
    if orientation.kind == "rotvec":
        return np.asarray(Rotation.from_rotvec(values).as_quat(scalar_first=True))
    if orientation.kind == "matrix":
        matrices = values.reshape(-1, 3, 3)
        off = np.abs(np.cross(matrices[:, 0], matrices[:, 1]) - matrices[:, 2]).max(axis=1)
        off = np.maximum(off, np.abs(matrices @ matrices.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)))
        if off.max() > 1e-3:
            raise InputError(
                f"{table.place(int(row[np.argmax(off)]))} has an orientation that is no rotation matrix, by "
                f"{off.max():.3g}; check the nine columns of [columns] orientation.matrix of {map.name}, row by row"
            )
        return np.asarray(Rotation.from_matrix(matrices).as_quat(scalar_first=True))
    length = np.linalg.norm(values, axis=1)
    worst = int(np.argmax(np.abs(length - 1)))
    if abs(length[worst] - 1) > 1e-3:  # as in a recording
        raise InputError(
            f"{table.place(int(row[worst]))} has a quaternion of length {length[worst]:.4g}, where 1 is expected; "
            f"check the four columns of [columns] orientation of {map.name}"
        )
    return np.roll(values, 1, axis=1) if orientation.order == "xyzw" else values


def _time(table: Table, map: Map, reference: Reference) -> Array:
    """Times (n,) in seconds; those of a clock count from the first row."""
    column, _ = _find(table, map, reference, "time")
    values = table.columns[column]
    if values.dtype.kind == "f":
        return _numbers(table, map, reference, "time", "time")
    cells = table.text(column)
    clock = clocks.seconds(cells)
    wrong = next((row for row, cell in enumerate(cells) if cell), 0) if clock is None else clock[1]
    if wrong is not None and (clock is not None or re.search(r"[:/]|\d[-.]\d+[-.]\d", cells[wrong])):
        raise InputError(
            f"{table.place(wrong)} has {cells[wrong]!r} in {table.title(column)}, where a number is expected, or a time as "
            f"{clocks.FORMS}; correct it, or leave time out of {map.name}"
        )
    if clock is None:
        return _numbers(table, map, reference, "time", "time")
    timed = replace(table, columns=(*table.columns[:column], clock[0], *table.columns[column + 1 :]))
    return timed.numbers(column, gaps=map.layout.missing == "drop")


def _sweeps(table: Table, map: Map, move: NDArray[Any] | None) -> NDArray[np.int64] | None:
    """Number of the sweep (n,), -1 between sweeps, by the moves (n,), if they were logged; None if neither was logged.

    Sweeps with names are numbered as they appear; without numbers, each run of rows of one move in which the robot measures is
    one.  Raises InputError for a sweep with rows of two moves.
    """
    columns = map.columns
    measuring = None if move is None else measures(move)
    if columns.sweep is None:
        if move is None or measuring is None:
            return None
        starts = measuring & (np.diff(move, prepend=Move.APPROACH) != 0)
        return np.where(measuring, np.cumsum(starts) - 1, -1)
    column, _ = _find(table, map, columns.sweep, "sweep")
    values = table.columns[column]
    if values.dtype.kind != "f":
        names = table.text(column)
        numbers = {"": -1} | {name: k for k, name in enumerate(dict.fromkeys(filter(None, names)))}
        sweep = np.array([numbers[name] for name in names], dtype=np.int64)
    else:
        sweep = np.maximum(table.whole_numbers(column, gaps=True), -1)
    if move is None or measuring is None:
        return _by_runs(sweep)
    both = np.intersect1d(*(sweep[(move == kind) & (sweep >= 0)] for kind in (Move.SWEEP, Move.PROBE)))
    if len(both):
        k = int(np.argmax((sweep == both[0]) & (move == Move.PROBE)))
        raise InputError(
            f"{table.place(k)} has the move probe in {table.title(column)} {values[k]}, which has rows of the move sweep as "
            "well: number sweeps and probings apart, or correct the column of the move"
        )
    return np.where(measuring, sweep, -1)


def _by_runs(sweep: NDArray[np.int64]) -> NDArray[np.int64]:
    """The sweeps (n,) where numbers come again: one between all others is none, and each run of another is a sweep."""
    start = np.flatnonzero(np.diff(sweep, prepend=-2))
    number = sweep[start]
    names, runs = np.unique(number[number >= 0], return_counts=True)
    again = names[runs > 1]
    if not len(again) or np.median(np.diff(start, append=len(sweep))) < _SHORTEST_RUN:  # rows of several sweeps in turn
        return sweep
    between = runs.max() > 2 and any((number[k::2] == names[runs.argmax()]).all() for k in (0, 1))
    if len(again) == 1 and len(names) > 1 and between:
        return np.where(sweep == again[0], -1, sweep)
    return np.where(sweep >= 0, np.cumsum(np.isin(np.arange(len(sweep)), start)) - 1, -1)


def stated_units(table: Table, column: int) -> Mapping[str, tuple[str, int | None]]:
    """The units that the row of units and the name of a column state, by quantity, with the line."""
    header = table.layout.header if table.layout else None
    cell = table.units[column] if column < len(table.units) else ""
    name = stated_unit(table.names[column]) if table.names else None
    found = ((name, header), (unit_of_cell(cell), (header or 0) + 1))
    return {stated[0]: (stated[1], line) for stated, line in found if stated}


def _check_unit(table: Table, map: Map, column: int, quantity: str) -> None:
    stated, line = stated_units(table, column).get(quantity, ("", None))
    factor = map.factors[quantity]
    if stated and abs(FACTORS[quantity][stated] - factor) > 1e-9 * factor:
        unit = next(unit for unit, value in FACTORS[quantity].items() if value == factor)
        where = f": line {line}" if line else ""
        raise InputError(
            f"{table.name}{where} says that {table.title(column)} is in {stated}, and [units] {quantity} of "
            f"{map.name} says {unit}; correct the one that is wrong"
        )


def _check_order(time: Array, row: NDArray[np.int64], table: Table) -> None:
    back = np.flatnonzero(np.diff(time) < 0)
    if len(back):
        k = int(back[0])
        raise InputError(
            f"{table.place(int(row[k + 1]))} has a time {time[k] - time[k + 1]:.6g} s before that of the row above, "
            f"and time runs backwards in {len(back)} of {len(time)} rows; check the column of the time, and sort or "
            "separate the rows; to times of a clock that wraps, add its range from there on"
        )


# Displacements over which the direction is determined are at least this many standard deviations of the positions' errors.
OVER_JITTER = 20.0
# The clamp turns if its axes change by more than this many radians over a displacement.
_TURNING = 0.02
# Rows in the usual run of one number that are a sweep, and not one of several in turn.
_SHORTEST_RUN = 4


def strokes(position: Array, quaternion: Array, length: float, axis: int = 0) -> tuple[NDArray[np.int64], Mask]:
    """The strokes along an axis of the clamp, by default x, of poses (n, 3) and (n, 4); `length` is the rod's.

    (n,) the number of the stroke of each row, -1 outside strokes, and whether each stroke (s,) is along + of the axis.
    """
    n, jitter = len(position), jitter_of(position, length)
    axes = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()[:, :, axis]
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
        long = travel >= max(0.02 * length, OVER_JITTER * jitter) and stop - start >= 3
        if long and turn <= 0.2 * travel / length + turn_error:
            sweep[start:stop] = len(signs)
            signs.append(sign > 0)
    return sweep, np.array(signs, dtype=bool)


def jitter_of(position: Array, length: float) -> float:
    """Standard deviation of the errors of positions (n, 3), by noise and by rounding; 0 if it is negligible."""
    jitter = float(np.hypot(_error(position), max(_encoder_step(column) for column in position.T)))
    return jitter if jitter > NEGLIGIBLE * length else 0.0


def _travel(position: Array, axis: Array, jitter: float) -> float:
    """Length of the line from the first to the last position (n, 3).

    It is 0 if the line is not along the axis (3,), or if the other positions leave it by more than a fraction of it.
    """
    line = position[-1] - position[0]
    length = float(np.linalg.norm(line))
    if length == 0 or abs(line @ axis) < np.cos(0.1) * length:
        return 0.0
    off = np.linalg.norm(np.cross(position - position[0], line / length), axis=1).max()
    return length if off <= 0.05 * length + OVER_JITTER / 4 * jitter else 0.0


def _error(values: Array) -> float:
    """Standard deviation of the errors of successive values (n, k), from their second differences."""
    if len(values) < 3:
        return 0.0
    second = np.abs(np.diff(values, n=2, axis=0)[:: max(1, len(values) // 20_000)])
    # of three independent errors with the weights 1, -2, 1
    return float(np.median(second, axis=0).max()) / MEDIAN_OF_NORMAL / float(np.sqrt(6))


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
        far = np.linalg.norm(step, axis=1) > OVER_JITTER * jitter
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
    numbers, first, last = ends(sweep)
    place = np.searchsorted(numbers, sweep[sweep >= 0])
    hits, count = np.bincount(place, weights=touched[sweep >= 0]), np.bincount(place)
    with_contact = (hits >= 3) & (hits >= 0.01 * count)
    if not with_contact.any():
        return sweep, 0
    axes = Rotation.from_quat(quaternion[first], scalar_first=True).as_matrix()
    kept = with_contact.copy()
    others, beside = np.flatnonzero(~with_contact), np.flatnonzero(with_contact)
    _, one, group = np.unique(axes[others].reshape(-1, 9), axis=0, return_index=True, return_inverse=True)
    for number, k in enumerate(others[one]):  # of strokes in the same orientation, of which a log has few
        strokes = others[group.reshape(-1) == number]
        same = beside[np.abs(axes[beside] - axes[k]).max(axis=(1, 2)) < _TURNING]
        x, y = axes[k, :, 0], axes[k, :, 1]
        rows = np.concatenate([same, strokes])
        height = position[first[rows]] @ y
        start, end = np.sort([position[first[rows]] @ x, position[last[rows]] @ x], axis=0)
        m = len(same)
        kept[strokes] = [
            ((above >= height[:m] - 0.05 * length) & (start[:m] <= stop) & (begin <= end[:m])).any()
            for above, begin, stop in zip(height[m:], start[m:], end[m:], strict=True)
        ]
    renumbered = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
    return renumbered[np.where(sweep >= 0, np.searchsorted(numbers, sweep), -1)], int((~kept).sum())


def ends(sweep: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.intp], NDArray[np.intp]]:
    """The numbers (s,) of the sweeps of rows (n,), and the first and last row of each."""
    rows = np.flatnonzero(sweep >= 0)
    numbers, first = np.unique(sweep[rows], return_index=True)
    _, last = np.unique(sweep[rows][::-1], return_index=True)
    return numbers, rows[first], rows[::-1][last]


def travel_angles(sweep: NDArray[np.int64], position: Array, quaternion: Array) -> Array:
    """Angle (s,) in radians of each sweep's travel to the -x axis of the clamp; NaN for one without travel."""
    numbers, first, last = ends(sweep)
    if not len(numbers):
        return np.empty(0)
    travel = position[last] - position[first]
    axes = Rotation.from_quat(quaternion[first], scalar_first=True).as_matrix()[:, :, 0]
    cosine = ratio(-(travel * axes).sum(axis=1), np.linalg.norm(travel, axis=1))
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)))


class DirectionError(InputError):
    """The sweeps of a log are not along -x of the clamp's frame."""


def check_directions(
    map: Map,
    where: str,
    sweep: NDArray[np.int64],
    position: Array,
    quaternion: Array,
    touched: Mask,
    probing: Mask,
) -> None:
    """Raise DirectionError if most sweeps are not along -x of the clamp's frame, or do not hold the contacts, and InputError if
    the clamp does not move in any.

    `where` is the name of the table; `touched` (n,) are the rows in contact, and `probing` (n,) those of probings.
    """
    angle = travel_angles(np.where(probing, -1, sweep), position, quaternion)
    known = angle[np.isfinite(angle)]
    if len(angle) and not len(known):
        raise InputError(
            f"{where}: the clamp does not move in any of the {len(angle)} sweeps; check [columns] position and sweep "
            f"of {map.name}"
        )
    if map.directions == "both":
        known = np.minimum(known, np.pi - known)
    elsewhere = held(sweep, touched) < 0.2  # retracts and strokes back hold contacts as well, but not most of them
    # a sweep is along the axis within 0.3 rad
    along_x = (known < 0.3).mean() >= 0.5 if len(known) else probing.any()
    if along_x and not elsewhere:
        return
    axis = _usual_axis(np.where(touched, 0, -1) if elsewhere else sweep, position, quaternion)
    advice = (
        "check orientation (its order of columns or its convention) and position under [columns], [units] angle, and "
        "the clamp's frame under [clamp], with y along the rod and x against the sweep"
    )
    if axis == "+x":
        advice += '; strokes in both directions are taken by directions = "both" under [sweeps]'
    if axis == "+y" and not touched.any():
        advice = f"name the column of the moves if these are probings, of which none touches anything; else {advice}"
    way = "in no straight stroke" if axis == "-x" else f"mostly along {axis} of its own frame, and not"
    raise DirectionError(
        f"{where}: the clamp moves {'in contact ' if elsewhere else ''}{way} along -x as in a sweep; in {map.name} {advice}"
    )


def held(sweep: NDArray[np.int64], touched: Mask) -> float:
    """The part of the rows (n,) in contact that lie in sweeps; 1 without any."""
    return float((sweep >= 0)[touched].mean()) if touched.any() else 1.0


def _usual_axis(sweep: NDArray[np.int64], position: Array, quaternion: Array) -> str:
    step = np.diff(position, axis=0)
    rows = (sweep[1:] >= 0) & (sweep[1:] == sweep[:-1])
    rows = rows if step[rows].any() else np.ones(len(step), dtype=bool)
    if not rows.any():
        return "no axis"
    local = Rotation.from_quat(quaternion[:-1][rows], scalar_first=True).apply(step[rows], inverse=True)
    lengths = np.stack([np.maximum(local, 0).sum(axis=0), np.maximum(-local, 0).sum(axis=0)], axis=1).ravel()
    return ("+x", "-x", "+y", "-y", "+z", "-z")[int(np.argmax(lengths))]
