"""What a rig has logged: the columns of a table as quantities in SI units, by a map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scan3d.arrays import LARGEST, Array, Mask
from scan3d.errors import InputError
from scan3d.files.reading import did_you_mean
from scan3d.files.text_tables import Table
from scan3d.laboratory.maps import Map, Orientation, Reference
from scan3d.poses import MOVES, Move
from scan3d.units import FACTORS, stated_unit, unit_of_cell

CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")


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
    sweep: NDArray[np.int64] | None
    """(n,) number of the sweep, -1 between sweeps; None if neither sweeps nor moves were logged."""
    row: NDArray[np.int64]
    """(n,) row of the table."""

    def __len__(self) -> int:
        return len(self.position_m)


def read_log(table: Table, map: Map) -> Log:
    """The quantities of a table.  Raises InputError with the file, the line and the column of what can't be right."""
    columns = map.columns
    position = _vectors(table, map, columns.position, "length", "position")
    orientation = _orientation(table, map, columns.orientation)
    wrench, present = _wrench(table, map)
    time = None if columns.time is None else _time(table, map, columns.time)
    if map.wrench_delay_s:
        wrench = _undelayed(wrench, time, map, table)
    kept = (np.abs(np.concatenate([position, orientation, wrench], axis=1)) < LARGEST).all(axis=1)
    kept &= True if time is None else np.isfinite(time)
    if not kept.any():
        raise InputError(f"{table.name} has no row in which all columns of the map hold numbers")
    row = np.flatnonzero(kept)
    quaternion = _quaternions(table, map, orientation[row], row)
    place, sweep = position[row], _sweeps(table, map)
    if columns.position_in == "clamp":
        place = Rotation.from_quat(quaternion, scalar_first=True).apply(place)
    wrench = -wrench[row] if map.reversed_sign else wrench[row]
    if map.wrench_in == "world":
        wrench = _in_sensor(wrench, present, quaternion, map, table)
    log = Log(
        time_s=None if time is None else time[row],
        position_m=place,
        quaternion=quaternion,
        wrench=wrench,
        present=present,
        sweep=None if sweep is None else sweep[row],
        row=row,
    )
    if log.time_s is not None and len(log) > 1:
        _check_order(log.time_s, log.row, table)
        if not np.diff(log.time_s).any():
            raise InputError(
                f"{table.name}: the column of the time has the same value in all {len(log)} rows; leave time out of the map"
            )
    for name, channels in (("force", slice(0, 3)), ("moment", slice(3, 6))):
        if present[channels].any() and not log.wrench[:, channels].any():
            entry = "signals" if columns.signals else name
            raise InputError(
                f"{table.name}: the {name} is zero in all {len(log)} rows: nothing was measured; check [columns] {entry} of "
                f"{map.name}, and the sensor"
            )
    return log


def _wrench(table: Table, map: Map) -> tuple[Array, Mask]:
    """Forces and moments (n, 6), and which of them (6,) the sensor has."""
    columns = map.columns
    if not columns.signals:
        both = ((columns.force, "force"), (columns.moment, "moment"))
        parts = [_vectors(table, map, references, entry, entry) for references, entry in both]
        known = [one[axis] != "" for one, _ in both for axis in range(3)]
        return np.concatenate(parts, axis=1), np.array(known)
    signals = _vectors(table, map, columns.signals, "", "signals")
    present: Mask = np.isin(np.arange(6), (0, 1, 5)) | (len(map.matrix) == 6)
    wrench = np.zeros((len(table), 6))
    wrench[:, present] = (signals - map.offset) @ np.array(map.matrix).T
    wrench *= np.repeat([map.factors["force"], map.factors["moment"]], 3)
    return wrench, present


def _undelayed(wrench: Array, time: Array | None, map: Map, table: Table) -> Array:
    """The wrenches (n, 6) of the times (n,) of the poses; NaN where the log ends before."""
    if time is None:
        raise InputError(
            f"{table.name}: wrench_delay_s of {map.name} needs the time of the rows; name its column as time under [columns]"
        )
    _check_order(time, np.arange(len(time)), table)
    columns = [np.interp(time + map.wrench_delay_s, time, one, left=np.nan, right=np.nan) for one in wrench.T]
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


def _entry(map: Map, entry: str) -> str:
    return f"[columns] {entry} of {map.name}"


def _find(table: Table, map: Map, reference: Reference, entry: str) -> tuple[int, float]:
    where, names = _entry(map, entry), table.names
    if isinstance(reference, int):
        if reference > len(table.columns):
            raise InputError(
                f"{table.name} has {len(table.columns)} columns, and {where} names column {reference}; correct the map"
            )
        return reference - 1, 1.0
    if not names:
        raise InputError(
            f"{table.name} has no line with names, and {where} names {reference!r}; give the number of the column, from 1, or "
            "the line of the names as header under [table]"
        )
    bare, sign = (reference[1:], -1.0) if reference.startswith("-") and reference not in names else (reference, 1.0)
    found = [k for k, name in enumerate(names) if name == bare]
    if len(found) == 1:
        return found[0], sign
    line = f"{table.name}: line {table.layout.header}" if table.layout and table.layout.header else table.name
    if found:
        numbers = ", ".join(str(k + 1) for k in found)
        raise InputError(
            f"{line} has {len(found)} columns {reference!r} (numbers {numbers}), where {where} means one; give its number"
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
            f"{table.name} has an angle of {largest:.3g} rad, {largest / (2 * np.pi):.3g} turns; check "
            f"{_entry(map, 'orientation')}, and [units] angle"
        )
    return values


def _quaternions(table: Table, map: Map, values: Array, row: NDArray[np.int64]) -> Array:
    """Unit quaternions (n, 4), w first, of the orientation's columns (n, k) in rows (n,) of the table."""
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
                f"{table.place(int(row[np.argmax(off)]))} has an orientation that is no rotation matrix, by {off.max():.3g}; "
                f"check the nine columns of {_entry(map, 'orientation.matrix')}, row by row"
            )
        return np.asarray(Rotation.from_matrix(matrices).as_quat(scalar_first=True))
    length = np.linalg.norm(values, axis=1)
    worst = int(np.argmax(np.abs(length - 1)))
    if abs(length[worst] - 1) > 1e-3:  # as in a recording
        raise InputError(
            f"{table.place(int(row[worst]))} has a quaternion of length {length[worst]:.4g}, where 1 is expected; check the "
            f"four columns of {_entry(map, 'orientation')}"
        )
    return np.roll(values, 1, axis=1) if orientation.order == "xyzw" else values


def _time(table: Table, map: Map, reference: Reference) -> Array:
    """Times (n,) in seconds; text in the form 2026-05-01T10:00:00.5 counts from its first row."""
    column, _ = _find(table, map, reference, "time")
    values = table.columns[column]
    if values.dtype.kind != "f" and "-" in str(values[0])[1:]:
        try:
            stamps = values.astype(str).astype("datetime64[ns]")
            return np.asarray((stamps - stamps[0]).astype(np.int64) * 1e-9)
        except ValueError:
            pass
    return _numbers(table, map, reference, "time", "time")


def _sweeps(table: Table, map: Map) -> NDArray[np.int64] | None:
    """Number of the sweep (n,), -1 between sweeps; None if neither sweeps nor moves were logged.

    Sweeps with names are numbered as they appear; without numbers, each run of rows in which the robot sweeps is one.
    """
    columns = map.columns
    sweeping = None
    if columns.move is not None:
        sweeping = table.words(_find(table, map, columns.move, "move")[0], MOVES) == Move.SWEEP
    if columns.sweep is None:
        if sweeping is None:
            return None
        starts = np.diff(np.concatenate([[False], sweeping]).astype(np.int8)) == 1
        return np.where(sweeping, np.cumsum(starts) - 1, -1)
    column, _ = _find(table, map, columns.sweep, "sweep")
    values = table.columns[column]
    if values.dtype.kind != "f":
        names = table.text(column)
        numbers = {"": -1} | {name: k for k, name in enumerate(dict.fromkeys(filter(None, names)))}
        sweep = np.array([numbers[name] for name in names], dtype=np.int64)
    else:
        sweep = np.maximum(table.whole_numbers(column, gaps=True), -1)
    return sweep if sweeping is None else np.where(sweeping, sweep, -1)


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
            f"{table.name}{where} says that {table.title(column)} is in {stated}, and [units] {quantity} of {map.name} says "
            f"{unit}; correct the one that is wrong"
        )


def _check_order(time: Array, row: NDArray[np.int64], table: Table) -> None:
    back = np.flatnonzero(np.diff(time) < 0)
    if len(back):
        k = int(back[0])
        raise InputError(
            f"{table.place(int(row[k + 1]))} has a time {time[k] - time[k + 1]:.6g} s before that of the row above, and time "
            f"runs backwards in {len(back)} of {len(time)} rows; check the column of the time, and sort or separate the rows"
        )
