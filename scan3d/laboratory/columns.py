"""The columns of a table as quantities in SI units, by a map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, Mask
from scan3d.errors import InputError
from scan3d.files.reading import did_you_mean
from scan3d.laboratory.maps import Map, Orientation, Reference
from scan3d.laboratory.quantities import FACTORS, stated_unit, unit_of_cell
from scan3d.laboratory.tables import RawTable

MOVES = ("approach", "sweep", "retract")
"""What a robot does in a row: only its sweeps become part of the recording."""
CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")
# Largest error of a quaternion's length, as in a recording.
_QUATERNION_TOLERANCE = 1e-3
# Names of columns that a message lists at most.
_LISTED = 30


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
    """(n,) number of the sweep, -1 between sweeps; None if it was not logged."""
    sweeping: Mask | None
    """(n,) whether the robot sweeps, rather than approaches or retracts; None if it was not logged."""
    row: NDArray[np.int64]
    """(n,) row of the table."""

    def __len__(self) -> int:
        return len(self.position_m)


def read_log(table: RawTable, map: Map) -> Log:
    """The quantities of a table.  Raises InputError with the file, the line and the column of what can't be right."""
    finder = _Finder(table, map)
    columns = map.columns
    gaps = map.layout.missing == "drop"
    position = finder.vectors(columns.position, 3, "length", "position", gaps)
    orientation = finder.orientation(columns.orientation, gaps)
    parts = [
        finder.vectors(columns.force, 3, "force", "force", gaps),
        finder.vectors(columns.moment, 3, "moment", "moment", gaps),
    ]
    present = np.array([finder.is_there(refs, axis) for refs in (columns.force, columns.moment) for axis in range(3)])
    time = None if columns.time is None else finder.time(columns.time, gaps)
    wrench = np.concatenate(parts, axis=1)
    kept = np.isfinite(np.concatenate([position, orientation, wrench], axis=1)).all(axis=1)
    kept &= True if time is None else np.isfinite(time)
    if not kept.any():
        raise InputError(f"{table.name} has no row in which all columns of the map hold numbers")
    row = np.flatnonzero(kept)
    quaternion = finder.quaternions(columns.orientation, orientation[row], row)
    place = position[row]
    if columns.position_in == "clamp":
        place = Rotation.from_quat(quaternion, scalar_first=True).apply(place)
    log = Log(
        time_s=None if time is None else time[row],
        position_m=place,
        quaternion=quaternion,
        wrench=wrench[row],
        present=present,
        sweep=None if columns.sweep is None else finder.sweeps(columns.sweep)[row],
        sweeping=None if columns.move is None else finder.moves(columns.move)[row],
        row=row,
    )
    _check_time(log, table)
    _check_wrench(log, table, finder)
    return replace(log, wrench=-log.wrench) if map.reversed_sign else log


class _Finder:
    """Finds the columns that a map refers to."""

    def __init__(self, table: RawTable, map: Map) -> None:
        self.table, self.map = table, map

    def find(self, reference: Reference, entry: str) -> tuple[int, float] | None:
        """The column of a reference and its sign; None for an empty reference."""
        if reference == "":
            return None
        names = self.table.names
        count = len(self.table.columns)
        if isinstance(reference, int):
            if reference > count:
                raise InputError(
                    f"{self.table.name} has {count} columns, and {self._entry(entry)} names column {reference}; correct "
                    "the map"
                )
            return reference - 1, 1.0
        if not names:
            raise InputError(
                f"{self.table.name} has no line with names, and {self._entry(entry)} names {reference!r}; give the number of "
                "the column, from 1, or the line of the names as header under [table]"
            )
        found = [k for k, name in enumerate(names) if name == reference]
        if not found and any(sign in reference for sign in "*?"):
            found = [k for k, name in enumerate(names) if fnmatchcase(name, reference.removeprefix("-"))]
        elif not found and reference.startswith("-"):
            found = [k for k, name in enumerate(names) if name == reference[1:]]
        sign = -1.0 if reference.startswith("-") and reference not in names else 1.0
        if len(found) == 1:
            return found[0], sign
        raise InputError(self._not_one(reference, entry, found))

    def _entry(self, entry: str) -> str:
        return f"[columns] {entry} of {self.map.name}"

    def _not_one(self, reference: str, entry: str, found: Sequence[int]) -> str:
        header = self.table.layout.header if self.table.layout else None
        where = f"{self.table.name}: line {header}" if header else self.table.name
        if found:
            numbers = ", ".join(str(k + 1) for k in found)
            return (
                f"{where} has {len(found)} columns {reference!r} (numbers {numbers}), where {self._entry(entry)} means one; "
                "give its number"
            )
        names = self.table.names
        listed = ", ".join(names[:_LISTED]) + (", ..." if len(names) > _LISTED else "")
        inside = [name for name in names if reference.lower() in name.lower()]
        near = f"; did you mean {inside[0]}?" if inside else did_you_mean([reference], names)
        return f"{where} has no column {reference!r}, which {self._entry(entry)} names; it has {listed}{near}"

    def expanded(self, references: tuple[Reference, ...], count: int, entry: str) -> tuple[Reference, ...]:
        """The references, with a single pattern replaced by the columns that it finds, in the table's order."""
        first = references[0]
        if len(references) == count or not isinstance(first, str):
            return references
        sign = "-" if first.startswith("-") else ""
        names = [name for name in self.table.names if fnmatchcase(name, first.removeprefix("-"))]
        if len(names) != count:
            found = f"finds {', '.join(names)}" if names else "finds no column"
            raise InputError(
                f"{self.table.name}: the pattern {first!r} in {self._entry(entry)} {found}, where {count} are expected"
            )
        return tuple(sign + name for name in names)

    def is_there(self, references: tuple[Reference, ...], axis: int) -> bool:
        return len(references) == 1 or references[axis] != ""

    def numbers(self, reference: Reference, quantity: str, entry: str, gaps: bool) -> Array:
        """A column in SI units; zeros for an empty reference."""
        found = self.find(reference, entry)
        if found is None:
            return np.zeros(len(self.table))
        column, sign = found
        self._check_unit(column, quantity, entry)
        factor = sign * self.map.factors[quantity] if quantity else sign
        values = self.table.numbers(column, gaps=gaps)
        return values if factor == 1.0 else values * factor

    def vectors(self, references: tuple[Reference, ...], count: int, quantity: str, entry: str, gaps: bool) -> Array:
        names = self.expanded(references, count, entry)
        return np.stack([self.numbers(name, quantity, entry, gaps) for name in names], axis=1)

    def orientation(self, orientation: Orientation, gaps: bool) -> Array:
        """The columns (n, k) of the orientation: of a quaternion, or of angles in radians."""
        count = {"quaternion": 4, "rotvec": 3}.get(orientation.kind, len(orientation.convention))
        quantity = "" if orientation.kind == "quaternion" else "angle"
        return self.vectors(orientation.columns, count, quantity, f"orientation.{orientation.kind}", gaps)

    def quaternions(self, orientation: Orientation, values: Array, row: NDArray[np.int64]) -> Array:
        """Unit quaternions (n, 4), w first, of the orientation's columns (n, k) in rows (n,) of the table."""
        if orientation.kind == "euler":
            turned: Array = Rotation.from_euler(orientation.convention, values).as_quat(scalar_first=True)
            return turned
        if orientation.kind == "rotvec":
            by_vector: Array = Rotation.from_rotvec(values).as_quat(scalar_first=True)
            return by_vector
        length = np.linalg.norm(values, axis=1)
        worst = int(np.argmax(np.abs(length - 1)))
        if abs(length[worst] - 1) > _QUATERNION_TOLERANCE:
            found = self.find(self.expanded(orientation.columns, 4, "orientation")[0], "orientation")
            title = self.table.title(found[0]) if found else "the quaternion's columns"
            raise InputError(
                f"{self.table.place(int(row[worst]))} has a quaternion of length {length[worst]:.4g}, from {title} on, where 1 "
                f"is expected; check the four columns of {self._entry('orientation')}"
            )
        return np.roll(values, 1, axis=1) if orientation.order == "xyzw" else values

    def time(self, reference: Reference, gaps: bool) -> Array:
        """Times (n,) in seconds; text in the form 2026-05-01T10:00:00.5 counts from its first row."""
        found = self.find(reference, "time")
        if found is None:
            raise InputError(f"{self._entry('time')} must name a column, or be left out")
        values = self.table.columns[found[0]]
        if values.dtype.kind != "f" and len(values) and "-" in str(values[0])[1:]:
            try:
                stamps = values.astype(str).astype("datetime64[ns]")
                seconds: Array = (stamps - stamps[0]).astype(np.int64) * 1e-9
                return seconds
            except ValueError:
                pass
        return self.numbers(reference, "time", "time", gaps)

    def sweeps(self, reference: Reference) -> NDArray[np.int64]:
        """Number of the sweep (n,), -1 where the cell is empty or negative; names are numbered as they appear."""
        found = self.find(reference, "sweep")
        if found is None:
            raise InputError(f"{self._entry('sweep')} must name a column, or be left out")
        values = self.table.columns[found[0]]
        if values.dtype.kind != "f":
            numbers: dict[str, int] = {"": -1}
            for name in self.table.text(found[0]):
                numbers.setdefault(name.strip(), len(numbers) - 1)
            return np.array([numbers[name.strip()] for name in self.table.text(found[0])], dtype=np.int64)
        whole = np.where(np.isnan(values), -1.0, values)
        bad = ~np.isfinite(whole) | (whole != np.round(whole)) | (np.abs(whole) >= 2**31)
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(
                f"{self.table.place(row)} has {values[row]:g} in {self.table.title(found[0])}, where the whole number of a "
                "sweep is expected"
            )
        return np.maximum(whole, -1.0).astype(np.int64)

    def moves(self, reference: Reference) -> Mask:
        """Whether the robot sweeps (n,)."""
        found = self.find(reference, "move")
        if found is None:
            raise InputError(f"{self._entry('move')} must name a column, or be left out")
        values = np.char.lower(np.char.strip(np.array(self.table.text(found[0]), dtype=str)))
        bad = ~np.isin(values, MOVES)
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(
                f"{self.table.place(row)} has {str(values[row])!r} in {self.table.title(found[0])}, where one of "
                f"{', '.join(MOVES)} is expected"
            )
        is_sweep: Mask = values == "sweep"
        return is_sweep

    def _check_unit(self, column: int, quantity: str, entry: str) -> None:
        """Raise InputError if the table states another unit for a column than the map."""
        header = self.table.layout.header if self.table.layout else None
        name = self.table.names[column] if self.table.names else ""
        cell = self.table.units[column] if column < len(self.table.units) else ""
        for stated, line in ((unit_of_cell(cell), (header or 0) + 1), (stated_unit(name), header)):
            if not quantity or stated is None or stated[0] != quantity:
                continue
            factor = self.map.factors[quantity]
            if abs(FACTORS[quantity][stated[1]] - factor) > 1e-9 * factor:
                unit = next(unit for unit, value in FACTORS[quantity].items() if value == factor)
                where = f": line {line}" if line else ""
                raise InputError(
                    f"{self.table.name}{where} says that {self.table.title(column)} is in {stated[1]}, and [units] {quantity} "
                    f"of {self.map.name} says {unit}; correct the one that is wrong"
                )


def _check_time(log: Log, table: RawTable) -> None:
    """Raise InputError if time runs backwards or stands still."""
    if log.time_s is None or len(log) < 2:
        return
    steps = np.diff(log.time_s)
    if (steps < 0).any():
        k = int(np.argmax(steps < 0))
        raise InputError(
            f"{table.place(int(log.row[k + 1]))} has a time {-steps[k]:.6g} s before that of the row above, and time runs "
            f"backwards in {int((steps < 0).sum())} of {len(log)} rows; check the column of the time, and sort or separate "
            "the rows"
        )
    if not steps.any():
        raise InputError(
            f"{table.name}: the column of the time has the same value in all {len(log)} rows; leave time out of the map"
        )


def _check_wrench(log: Log, table: RawTable, finder: _Finder) -> None:
    """Raise InputError if all forces, or all moments, are zero."""
    columns = finder.map.columns
    for name, references, part in (
        ("force", columns.force, log.wrench[:, :3]),
        ("moment", columns.moment, log.wrench[:, 3:]),
    ):
        if part.any():
            continue
        found = [finder.find(one, name) for one in finder.expanded(references, 3, name)]
        titles = ", ".join(table.title(one[0]) for one in found if one)
        raise InputError(
            f"{table.place(int(log.row[0]))} and all {len(log) - 1} rows below have zero in {titles}: nothing was measured; "
            f"check [columns] {name} of {finder.map.name}, and the sensor"
        )
