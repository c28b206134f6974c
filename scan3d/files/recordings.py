"""Files of recordings: a table with the columns `COLUMNS`, and a TOML file of the same name in the same folder.

The table is CSV, or Parquet where pyarrow is installed.  Six-axis data have the columns `SIX_AXES` as well.

The TOML file contains the rod, the noise, what is not known exactly of a calibrated rig, and the source of the data.  Files of
poses likewise have the columns `POSE_COLUMNS`, and beside them the rod, the speed, and how the poses were planned.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array
from scan3d.choices import MODELS
from scan3d.errors import InputError, UsageError
from scan3d.files.columns import PARQUET, check_single, parquet_bytes
from scan3d.files.tables import read_table
from scan3d.files.text import REQUIRED, Section, read_rod, read_section, rod_section, rows_as_text, to_toml
from scan3d.files.whole import SCHEMA, Inputs, check_pair, locate, write_together
from scan3d.poses import MOVES, SPEED_M_S, Move, PoseList, measures
from scan3d.recording import FOLLOWED, FORCE, REACTIONS, Known, Recording, completed
from scan3d.rigs import RigUncertainty
from scan3d.rods import Gravity
from scan3d.units import UNITS_M

COLUMNS = ("sweep", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "fx_N", "fy_N", "mz_Nm")
SIX_AXES = {"fz_N": "force_z_N", "mx_Nm": "moment_x_Nm", "my_Nm": "moment_y_Nm"}
"""The columns of six-axis data, and the fields of the recording that hold them."""
TABLE = "table_height_m"
"""Name of the table's height in the TOML file."""
# The column that says what the clamp does in a row.
_MOVE = "move"


def sidecar(path: str | Path) -> Path:
    """Path of the TOML file that belongs to the table of a recording."""
    return Path(path).parent / f"{Path(path).stem}.toml"


def check_path(path: str | Path) -> None:
    """Raise InputError unless the path has the ending of a recording."""
    if Path(path).suffix not in (".csv", PARQUET):
        raise InputError(f"a recording is written as .csv or {PARQUET}, got {Path(path).name!r}")


def write_recording(recording: Recording, path: str | Path, *, overwrite: bool = False) -> None:
    """Write the table and its TOML file; numbers have all digits, so that reading gives the same bits.

    Raises InputError if they can't be written, and, unless `overwrite` is true, if they would replace other files than those of
    a recording from the same kind of source.
    """
    path = Path(path)
    check_path(path)
    if not len(recording):
        raise InputError("the recording has no rows, and there is nothing to write; record some")
    check_pair(path, sidecar(path), {}, overwrite, "path", str(recording.source.get("kind", "")))
    # both files or neither: a table with the rod of another one would be read without a warning
    write_together(path, recording_files(recording, path.name))


def recording_files(
    recording: Recording, name: str, further: Mapping[str, NDArray[Any]] | None = None
) -> dict[str, bytes]:
    """The two files of a recording by name, of which `name` is that of the table, with `further` columns (n,)."""
    values = [recording.sweep, *recording.position_m.T, *recording.quaternion.T, *recording.force_N.T]
    columns = dict(zip(COLUMNS, [*values, recording.moment_Nm], strict=True))
    rod = rod_section(recording.rod)
    if recording.six_axis:
        columns |= {name: getattr(recording, field) for name, field in SIX_AXES.items()}
    elif not recording.rod.diameter_m:
        del rod["diameter_m"]
    columns |= further or {}
    noise = {"force_N": recording.noise_force_N, "moment_Nm": recording.noise_moment_Nm}
    meta: dict[str, Any] = {"schema": SCHEMA, "unit": recording.unit}
    if recording.table_m is not None:
        meta[TABLE] = recording.table_m
    noise |= {"pose_m": recording.noise_pose_m} if recording.noise_pose_m else {}
    meta |= {"rod": rod, "noise": noise | ({} if recording.noise_independent else {"independent": False})}
    if recording.gravity is not None:
        meta["gravity"] = {"direction": recording.gravity.direction, "tared": recording.gravity.tared}
    if (told := recording.completed) is not None:
        friction = {"friction": told.friction, "friction_sd": told.friction_sd}
        meta["known"] = {"channel": told.channel, **({"contact": "tip"} if told.friction is None else friction)}
    if recording.rig is not None:
        known = recording.rig
        meta["rig"] = {"quantities": known.names, "covariance": known.covariance.tolist(), "exact": known.exact}
        if known.gains.any():
            meta["rig"] |= {"gains": known.gains.tolist(), "sensor": known.sensor}
    meta["source"] = dict(recording.source)
    if Path(name).suffix == PARQUET:
        table = parquet_bytes(columns)
    else:
        table = f"{','.join(columns)}\n".encode() + rows_as_text(columns.values())
    return {sidecar(name).name: to_toml(meta).encode(errors="replace"), name: table}


def gravity_of(section: Section, tared: bool = REQUIRED) -> Gravity:
    """The section ``[gravity]``; `tared` counts where it is not stated."""
    x, y, z = section.numbers("direction", 3)
    with section.errors_named():
        return Gravity((x, y, z), section.boolean("tared", tared))


def read_known(section: Section) -> Known:
    """The section ``[known]``: what is known in the place of a reaction that was not measured."""
    friction = section.number("friction", None, at_least=0)
    tip = section.word("contact", ("any", "tip")) == "tip"
    sd, channel = section.number("friction_sd", 0.0, at_least=0), section.text("channel", "")
    if tip == (friction is not None):
        raise section.error("", "needs friction, or contact = 'tip', which says that all contacts are at the tip")
    with section.errors_named():
        return Known(friction, sd, channel)


def read_recording(path: str | Path) -> Recording:
    """Read the table of a recording and its TOML file.  Raises InputError with the name of the file and the error in it."""
    path = Path(path)
    table = read_table(locate(path), what="recording", name=path.name)
    if not {*COLUMNS} - {*REACTIONS.values()} <= {*table.names}:
        _known_columns(path, table.names, None)  # refuses what is no recording before a TOML file is asked for
    meta = _read_sidecar(path)
    told = read_known(meta.section("known")) if "known" in meta else None
    columns = _known_columns(path, table.names, told)
    if _MOVE in table.names:
        # a column without any sweep is not that of a rig: all rows are read
        column = table.names.index(_MOVE)
        if {MOVES[Move.SWEEP], MOVES[Move.PROBE]} & {*table.text(column)}:
            table = table.rows(np.flatnonzero(measures(table.words(column, MOVES))))
    at = {name: table.names.index(name) for name in columns}
    sweep = table.whole_numbers(at.pop("sweep"))
    values = {name: table.numbers(column) for name, column in at.items()}
    zero = np.zeros(len(sweep))
    missing = [channel for channel, name in REACTIONS.items() if name not in values]
    known = _settings(meta)
    meta.finish(", and notes belong into [source]")
    known |= {field: values[name] for name, field in SIX_AXES.items() if name in values}
    if told is not None:
        known["completed"] = replace(told, channel=missing[0] if len(missing) == 1 else FORCE) if missing else told
    try:
        recording = Recording(
            sweep=sweep,
            position_m=np.stack([values[name] for name in ("x_m", "y_m", "z_m")], axis=1),
            quaternion=np.stack([values[name] for name in ("qw", "qx", "qy", "qz")], axis=1),
            force_N=np.stack([values.get("fx_N", zero), values.get("fy_N", zero)], axis=1),
            moment_Nm=values.get("mz_Nm", zero),
            **known,
        )
        return completed(recording)[0] if missing else recording
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def as_recording(given: Recording | str | os.PathLike[str]) -> Recording:
    """A recording, or that of a path."""
    return read_recording(Path(given)) if isinstance(given, (str, os.PathLike)) else given


def read_settings(path: str | Path) -> dict[str, Any]:
    """What the TOML file of a recording says of rod, noise, rig and table, as the fields of a `Recording`.

    Raises InputError with the name of the file and the error in it.
    """
    meta = read_section(Path(path), "TOML file of a recording")
    meta.any("schema")
    if "known" in meta:
        raise meta.error("known", "stands for a channel that was not measured, which needs the whole recording")
    found = _settings(meta)
    meta.finish(", and notes belong into [source]")
    return found


def _settings(meta: Section) -> dict[str, Any]:
    noise = meta.section("noise")
    force, moment, pose = (noise.number(name, 0.0, at_least=0) for name in ("force_N", "moment_Nm", "pose_m"))
    rig, of_rig = None, meta.section("rig")
    independent = noise.boolean("independent", True)
    if "rig" in meta:
        quantities, exact = of_rig.texts("quantities"), of_rig.texts("exact")
        with of_rig.errors_named():
            covariance, gains = of_rig.any("covariance", []), of_rig.any("gains", [])
            rig = RigUncertainty(quantities, covariance, exact, gains, of_rig.any("sensor", (0.0,) * 6))
    return {
        "rod": read_rod(meta.section("rod")),
        "noise_force_N": force,
        "noise_moment_Nm": moment,
        "noise_pose_m": pose,
        "noise_independent": independent,
        "rig": rig,
        "gravity": gravity_of(meta.section("gravity")) if "gravity" in meta else None,
        "unit": meta.word("unit", tuple(UNITS_M), "mm"),
        "table_m": meta.number(TABLE, None),
        "source": meta.notes("source"),
    }


def _known_columns(path: Path, header: Sequence[str], known: Known | None) -> tuple[str, ...]:
    """The columns of a header that are read.

    Raises InputError unless it has every column of a recording once, but for one reaction for which something `known` stands.
    """
    missing = [name for name in COLUMNS if name not in header]
    expected = [name for name in COLUMNS if name in header]
    if known is not None and not (
        (not missing and known.channel)
        or (len(missing) == 1 and missing[0] in REACTIONS.values())
        or missing == list(REACTIONS.values())[:2]
    ):
        raise InputError(
            f"{path.name}: [known] of its TOML file stands for one of {', '.join(REACTIONS.values())}, or for the first two, "
            f"and the header lacks {', '.join(missing) or 'none'}"
        )
    if missing and known is None:
        raise InputError(
            f"{path.name} is not a recording: its header lacks {', '.join(missing)}; expected {','.join(COLUMNS)} "
            f"(scan3d simulate writes such a table, and scan3d import makes one of the log of a laboratory); one sweep in one "
            "plane has the columns x0, f0x, f0y, m0z"
        )
    further = [name for name in SIX_AXES if name in header] if known is None or known.channel in FOLLOWED else []
    if further and len(further) < len(SIX_AXES):
        absent = ", ".join(name for name in SIX_AXES if name not in further)
        raise InputError(
            f"{path.name}: six-axis data need {', '.join(SIX_AXES)}, but the header lacks {absent}; add what was measured, or "
            f"rename {', '.join(further)} to read the recording by the planar model"
        )
    columns = (*expected, *further)
    check_single(path.name, header, columns)
    return columns


def _read_sidecar(path: Path) -> Section:
    beside = sidecar(path)
    stored = locate(beside)
    if not stored.exists():
        raise InputError(
            f"{path.name} needs {beside.name} beside it, with the rod's length_m and bending_stiffness_Nm2"
        )
    meta = read_section(stored, "TOML file of a recording", name=beside.name)
    schema = meta.any("schema", SCHEMA)
    if schema != SCHEMA:
        raise meta.error("schema", f"{schema!r} is not known, expected {SCHEMA}; was it written by a newer version?")
    return meta


# --- poses ---


POSE_COLUMNS = ("sweep", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "move")
PLAN = "plan of poses"
"""What the TOML file beside a list of poses says of its source."""


def check_poses(path: str | Path, overwrite: bool, inputs: Inputs | None = None) -> None:
    """Raise InputError unless poses may be written at the path: its ending, and files that are something else."""
    path = Path(path)
    if path.suffix != ".csv":
        raise UsageError(f"poses are written as .csv, got {path.name!r}")
    check_pair(path, sidecar(path), inputs or {}, overwrite, kind=PLAN)


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
    meta["source"] = {**poses.source, "kind": PLAN}
    beside = to_toml(meta).encode(errors="replace")
    write_together(path, {sidecar(path).name: beside, path.name: f"{','.join(POSE_COLUMNS)}\n".encode() + rows})


def read_poses(path: str | Path) -> PoseList:
    """Read the .csv of a list of poses, and its TOML file if there is one.

    Raises InputError with the name of the file and the error in it.
    """
    path = Path(path)
    if path.suffix != ".csv":
        raise InputError(f"poses are read from a .csv, got {path.name!r}; scan3d plan --out poses.csv writes one")
    table = read_table(path, what="poses")
    missing = [name for name in POSE_COLUMNS if name not in table.names]
    if missing:
        raise InputError(
            f"{path.name} is not a list of poses: its header lacks {', '.join(missing)}; expected {','.join(POSE_COLUMNS)} "
            "(scan3d plan writes such a table)"
        )
    if not len(table):
        raise InputError(f"{path.name} has no poses: the bound is met, or the file is cut off")
    sweep, *numbers, move = (table.names.index(name) for name in POSE_COLUMNS)
    columns: dict[str, Any] = {
        "sweep": table.whole_numbers(sweep),
        "position_m": np.stack([table.numbers(column) for column in numbers[:3]], axis=1),
        "quaternion": np.stack([table.numbers(column) for column in numbers[3:]], axis=1),
        "move": table.words(move, MOVES),
    }
    known = _read_plan(sidecar(path))
    try:
        return PoseList(**columns, **known)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def _read_plan(path: Path) -> dict[str, Any]:
    """What the TOML file of a list of poses says; empty if there is none, or if it belongs to something else."""
    if not path.exists():
        return {}
    meta = read_section(path, "TOML file of the poses")
    source = meta.any("source")
    if not isinstance(source, dict) or source.get("kind") != PLAN:
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


def map_path(path: Path) -> Path:
    """Path of the map beside a raw log."""
    return path.with_name(f"{path.stem}_map.toml")


def write_log(
    columns: dict[str, Array],
    rod: dict[str, Any],
    sensor: dict[str, Any],
    path: Path,
    table_m: float | None,
    mapped: bool = False,
) -> None:
    """Write a log with faults, of the columns `RAW_COLUMNS`, and unless it is mapped already its map, which says what the
    experimenter knows: the nominal rod, the sensor's nominal frame and the wrench that it shows, and the height of the table,
    unless that is None."""
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
    beside = {} if mapped else {map_path(path).name: (note + to_toml(meta)).encode()}
    write_together(path, {**beside, path.name: text.getvalue().encode()})
