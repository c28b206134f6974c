"""Raw signals of a sensor while its rod is touched at known places: the log, the table of the places, and the calibration.

The table has a row for each touch.  Which rows of the log are of a touch say equal values of the column ``touch`` of both, or
times ``from_s`` and ``to_s``; a table as long as the log has a touch in each row.  Where the rod is touched say ``s``, the arc
length from the clamp, and ``x``, ``y``, ``z`` in the clamp's frame, of the rod's centre line, or with ``pin_diameter`` of the
centre of a pin; and ``fx_N``, ``fy_N``, ``fz_N``, a force on the rod, as of a weight.  In a row without any the rod hangs free.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from scan3d.arrays import Array, Index
from scan3d.calibration.known import Places, Signals, of_signals
from scan3d.calibration.report import Calibration
from scan3d.errors import InputError
from scan3d.files.tables import Table, read_table
from scan3d.files.text import Section, did_you_mean, read_frame, read_rod, read_section, read_transducer
from scan3d.recording import rounding_sd
from scan3d.rigs import SHOWS
from scan3d.rods import Rod
from scan3d.units import FACTORS, stated_unit, without_unit

_LENGTHS = ("s", "x", "y", "z", "sd", "pin_diameter")
_FORCES = ("fx", "fy", "fz")
# Columns of a log that are no signals, where the map names none.
_OTHERS = ("touch", "sweep", "move", "row", "t", "t_s", "time", "time_s", "timestamp")


def calibrate_signals(log: str | Path, places: str | Path, map: str | Path | None = None) -> Calibration:
    """The matrix and the offset of a sensor by its signals in a log while the rod was touched at known places.

    map
        TOML file with `[rod]`, and optionally the columns of the signals as `signals` and of the time as `time` under
        `[columns]`, and under `[sensor]` its frame, what it `shows`, and the `channels` that its signals depend on; by default
        the file beside the log whose name ends with .map.toml or .toml.

    Raises InputError with the file, the line and the column of what can't be used, and what to do.
    """
    top = _map(Path(log), None if map is None else Path(map))
    columns, sensor = top.section("columns"), top.section("sensor")
    table, where = read_table(log), read_table(places, what="table of places")
    names, time = columns.texts("signals"), columns.text("time", "")
    names = names or _named(table)
    values = np.column_stack([table.numbers(_column(table, name)) for name in names])
    rows, rod = _rows(table, where, time), read_rod(top.section("rod"))
    mean = np.array([values[row].mean(axis=0) for row in rows])
    spread = np.concatenate([values[row] - middle for row, middle in zip(rows, mean, strict=True)])
    rounding = np.array([rounding_sd(column, measured=True) for column in values.T])
    if still := [name for name, column in zip(names, mean.T, strict=True) if len(mean) > 1 and not np.ptp(column)]:
        raise InputError(
            f"{table.name}: {', '.join(still)} is the same in all touches; check the signal, or leave it out"
        )
    if rod.weight_N or rod.clamp_compliance_rad_per_Nm:
        raise top.error(
            "rod", "has a weight or a clamp that gives, with which signals are not calibrated; leave them out"
        )
    told = _quantities(where)
    friction = told.get("friction", np.zeros(1))
    return of_signals(
        rod,
        read_frame(sensor),
        read_transducer(sensor, len(names)).channels,
        _places(where, told, rod),
        Signals(mean, np.array([len(row) for row in rows]), spread, rounding, names),
        reversed_sign=sensor.word("shows", SHOWS) == SHOWS[1],
        friction=float(np.nan_to_num(friction).max()),
    )


def _map(log: Path, map: Path | None) -> Section:
    """The map of a log, or the one beside it."""
    beside = [path for ending in (".map.toml", ".toml") if (path := log.with_suffix(ending)).exists()]
    if map is None and not beside:
        raise InputError(
            f"there is no {log.with_suffix('.toml').name} beside {log.name}: write one with the section [rod], length_m and "
            "bending_stiffness_Nm2, and if need be [columns] signals = [...] and [sensor] channels = [...], or name it as --map"
        )
    return read_section(map or beside[0], "map")


def _column(table: Table, name: str) -> int:
    if table.names.count(name) != 1:
        near = did_you_mean([name], table.names)
        raise InputError(f"{table.name} has {table.names.count(name)} columns {name!r}, where one is expected{near}")
    return table.names.index(name)


def _named(table: Table) -> tuple[str, ...]:
    """The columns of a log that are its signals where the map names none."""
    found = tuple(name for name in table.names if name.lower() not in _OTHERS)
    if not found:
        raise InputError(f"{table.name} has no column of a signal; name the signals as [columns] signals in the map")
    return found


def _rows(log: Table, places: Table, time: str) -> Sequence[Index]:
    """The rows of the log of each touch.  Raises InputError where the table does not tell."""
    if shared := next((name for name in ("touch", "sweep") if name in log.names and name in places.names), None):
        of_row, touches = np.array(log.text(log.names.index(shared))), places.text(places.names.index(shared))
        if twice := [k for k, name in enumerate(touches) if name in touches[:k]]:
            raise InputError(
                f"{places.place(twice[0])} has the {shared} {touches[twice[0]]} again; leave one of the two out"
            )
        found = [np.flatnonzero(of_row == name) for name in touches]
        told = f"the same {shared} in the log"
    elif {"from_s", "to_s"} <= {*places.names}:
        time = time or next((name for name in _OTHERS[_OTHERS.index("t") :] if name in log.names), "t_s")
        clock = log.numbers(_column(log, time))
        ends = (places.numbers(places.names.index(name)) for name in ("from_s", "to_s"))
        found = [np.flatnonzero((clock >= start) & (clock <= stop)) for start, stop in zip(*ends, strict=True)]
        told = f"a time from from_s to to_s in the column {time!r} of the log"
    elif len(log) == len(places):
        return list(np.arange(len(log))[:, None])
    else:
        raise InputError(
            f"{places.name} does not tell which of the {len(log)} rows of {log.name} are of which of its {len(places)} "
            "touches: give both a column touch with equal values, or times from_s and to_s, or one row for each row of the log"
        )
    if empty := [k for k, rows in enumerate(found) if not len(rows)]:
        raise InputError(
            f"{places.place(empty[0])} has no row with {told}, and so have {len(empty)} of {len(found)} touches"
        )
    return found


def _quantities(table: Table) -> dict[str, Array]:
    """What the table says of the touches, in SI units by name; NaN in empty cells."""
    found: dict[str, Array] = {}
    for k, name in enumerate(table.names):
        bare, unit = without_unit(name).lower(), stated_unit(name)
        if name in ("touch", "sweep", "from_s", "to_s"):
            continue
        if bare == "friction":
            found[bare] = table.numbers(k, gaps=True)
            continue
        quantity = "length" if bare in _LENGTHS else "force"
        if bare not in (*_LENGTHS, *_FORCES):
            known = (
                *(f"{one}_mm" for one in _LENGTHS),
                *(f"{one}_N" for one in _FORCES),
                "friction",
                "touch",
                "from_s",
                "to_s",
            )
            raise InputError(
                f"{table.name} has the column {name!r}; known are {', '.join(known)}{did_you_mean([name], known)}"
            )
        if unit is None or unit[0] != quantity:
            raise InputError(
                f"{table.name}: {table.title(k)} needs its unit at its end, such as {bare}_{'N' if bare in _FORCES else 'mm'}"
            )
        if bare in found:
            raise InputError(f"{table.name} has two columns of {bare}; leave one out")
        found[bare] = FACTORS[quantity][unit[1]] * table.numbers(k, gaps=True)
    for name in ("sd", "pin_diameter", "friction"):
        if (found.get(name, np.zeros(1)) < 0).any():
            raise InputError(f"{table.name}: {name} is negative; give a size")
    return found


def _places(table: Table, told: dict[str, Array], rod: Rod) -> Places:
    """The places.  Raises InputError where a touch is not told well enough."""
    nothing, none = np.full(len(table), np.nan), np.zeros(len(table))
    arc, point, force = (
        told.get("s", nothing),
        [told.get(axis, nothing) for axis in "xyz"],
        [told.get(f, nothing) for f in _FORCES],
    )
    touched = np.isfinite([arc, *point, *force]).any(axis=0)
    # where no column tells of the third axis, all is in a plane
    for axes, is_there in ((point, "z" in told), (force, "fz" in told)):
        if not is_there:
            axes[2] = np.where(np.isfinite(axes[:2]).any(axis=0), 0.0, np.nan)
    known = np.isfinite([arc, *point, *force])
    across, forced = known[1] & known[3], known[4:].all(axis=0)
    enough = np.where(forced, known[0], across & (known[0] | known[2]))
    if (touched & ~enough).any():
        raise InputError(
            f"{table.place(int(np.argmax(touched & ~enough)))} does not tell how the rod is bent: a touch needs x and z (none "
            "in a plane), how far the rod is pushed aside, and y, along the rod, or s, the arc length; or the force fx, fy and "
            "fz with s; in the air all are empty"
        )
    length = np.nan_to_num(np.fmax(arc, point[1]), nan=np.inf)
    if (wrong := touched & ~((length > 0) | forced)).any():
        raise InputError(
            f"{table.place(int(np.argmax(wrong)))} has a place that is not in front of the clamp: y and s are above 0"
        )
    pin = told.get("pin_diameter", nothing)
    # where the arc length is not told, the place along the rod is nearly it
    radius = rod.radius_m(np.where(np.isfinite(arc), arc, np.nan_to_num(point[1])) / rod.length_m)
    distance = np.where(np.isfinite(pin), np.nan_to_num(pin) / 2 + radius, 0.0)
    sd = np.nan_to_num(told.get("sd", none))
    return Places(arc, np.column_stack(point), np.column_stack(force), sd, distance)
