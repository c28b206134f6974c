"""Files of poses: a CSV file with the columns `COLUMNS`, and a TOML file beside it.

The TOML file has the rod, the speed, and how the poses were planned.  Of a simulated rig that goes through the poses, an
exact log is a recording with times and moves, one with faults a table with a map for import.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.choices import MODELS
from scan3d.errors import InputError
from scan3d.files.reading import read_rod, read_section, rod_section
from scan3d.files.recordings import TABLE, sidecar
from scan3d.files.text import rows_as_text, to_toml
from scan3d.files.text_tables import read_table
from scan3d.files.whole import SCHEMA, Inputs, check_pair, write_together
from scan3d.poses import MOVES, SPEED_M_S, PoseList
from scan3d.units import UNITS_M

COLUMNS = ("sweep", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "move")
KIND = "plan of poses"
"""What the TOML file beside a list of poses says of its source."""


def check_poses(path: str | Path, overwrite: bool, inputs: Inputs | None = None) -> None:
    """Raise InputError unless poses may be written at the path: its ending, and files that are something else."""
    path = Path(path)
    if path.suffix != ".csv":
        raise InputError(f"poses are written as .csv, got {path.name!r}")
    check_pair(path, sidecar(path), inputs or {}, overwrite, kind=KIND)


def write_poses(poses: PoseList, path: str | Path, *, empty: bool = False) -> None:
    """Write a list of poses with its TOML file; numbers have all digits.

    `empty` writes the header only, where nothing is left to be swept.  Raises InputError if they can't be written.
    """
    path = Path(path)
    columns = [poses.sweep, *poses.position_m.T, *poses.quaternion.T, np.array(MOVES)[poses.move]]
    rows = b"" if empty else rows_as_text(columns)
    meta: dict[str, Any] = {"schema": SCHEMA, "unit": poses.unit, "model": poses.model, "speed_m_s": poses.speed_m_s}
    if poses.rod is not None:
        meta["rod"] = rod_section(poses.rod)
    meta["source"] = {**poses.source, "kind": KIND}
    beside = to_toml(meta).encode(errors="replace")
    write_together(path, {sidecar(path).name: beside, path.name: f"{','.join(COLUMNS)}\n".encode() + rows})


def read_poses(path: str | Path) -> PoseList:
    """Read the .csv of a list of poses, and its TOML file if there is one.

    Raises InputError with the name of the file and the error in it.
    """
    path = Path(path)
    if path.suffix != ".csv":
        raise InputError(f"poses are read from a .csv, got {path.name!r}; scan3d plan --out poses.csv writes one")
    table = read_table(path, what="poses")
    missing = [name for name in COLUMNS if name not in table.names]
    if missing:
        raise InputError(
            f"{path.name} is not a list of poses: its header lacks {', '.join(missing)}; expected {','.join(COLUMNS)} "
            "(scan3d plan writes such a table)"
        )
    if not len(table):
        raise InputError(f"{path.name} has no poses: the bound is met, or the file is cut off")
    sweep, *numbers, move = (table.names.index(name) for name in COLUMNS)
    columns: dict[str, Any] = {
        "sweep": table.whole_numbers(sweep),
        "position_m": np.stack([table.numbers(column) for column in numbers[:3]], axis=1),
        "quaternion": np.stack([table.numbers(column) for column in numbers[3:]], axis=1),
        "move": table.words(move, MOVES),
    }
    known = _read_sidecar(sidecar(path))
    try:
        return PoseList(**columns, **known)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def _read_sidecar(path: Path) -> dict[str, Any]:
    """What the TOML file of a list of poses says; empty if there is none, or if it belongs to something else."""
    if not path.exists():
        return {}
    meta = read_section(path, "TOML file of the poses")
    source = meta.any("source")
    if not isinstance(source, dict) or source.get("kind") != KIND:
        return {}
    meta.any("schema")
    known = {
        "rod": read_rod(meta.section("rod")) if "rod" in meta else None,
        "speed_m_s": meta.number("speed_m_s", SPEED_M_S, above=0),
        "model": meta.word("model", MODELS),
        "unit": meta.word("unit", tuple(UNITS_M), "mm"),
        "source": source,
    }
    meta.finish()
    return known


RAW_COLUMNS = (
    "t_s",
    *("x_mm", "y_mm", "z_mm"),
    *("qw", "qx", "qy", "qz"),
    *("Fx_N", "Fy_N", "Fz_N"),
    *("Tx_Nmm", "Ty_Nmm", "Tz_Nmm"),
    "sweep",
)


def map_path(path: str | Path) -> Path:
    """Path of the map beside a raw log."""
    path = Path(path)
    return path.with_name(f"{path.stem}_map.toml")


def write_log(
    columns: dict[str, Array],
    rod: dict[str, Any],
    sensor: dict[str, Any],
    path: str | Path,
    table_m: float | None = None,
) -> None:
    """Write a log with faults, of the columns `RAW_COLUMNS`, and its map, which says what the experimenter knows.

    rod
        the nominal one.
    sensor
        its nominal frame, and the wrench that it shows.
    table_m
        the height of the table, if it is known.
    """
    path = Path(path)
    text = io.StringIO(newline="\n")
    text.write(",".join(RAW_COLUMNS) + "\n")
    # a sensor shows fewer digits, and a clock and a robot need about as many
    forms = ["%.10g"] * (len(RAW_COLUMNS) - 1) + ["%d"]
    np.savetxt(text, np.stack([columns[name] for name in RAW_COLUMNS], axis=1), forms, ",")
    note = (
        "# The map of a log of scan3d simulate.  The column sweep has the numbers of the planned sweeps, and -1 between them;\n"
        "# it is not named here, because the log of a rig seldom has it.\n"
    )
    meta: dict[str, Any] = {
        **({} if table_m is None else {TABLE: table_m}),
        "columns": {
            "time": "t_s",
            "position": ["x_mm", "y_mm", "z_mm"],
            "orientation": {"quaternion": ["qw", "qx", "qy", "qz"]},
            "force": ["Fx_N", "Fy_N", "Fz_N"],
            "moment": ["Tx_Nmm", "Ty_Nmm", "Tz_Nmm"],
        },
        "units": {"time": "s", "length": "mm", "angle": "deg", "force": "N", "moment": "N mm"},
        "sensor": sensor,
        "tare": {"air": "auto"},
        "rod": rod,
    }
    write_together(path, {map_path(path).name: (note + to_toml(meta)).encode(), path.name: text.getvalue().encode()})
