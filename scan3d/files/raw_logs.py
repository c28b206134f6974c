"""Logs of a simulated rig: an exact one is a recording with times and moves, one with faults a table with a map for import."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.files.recordings import TABLE, recording_files
from scan3d.files.text import to_toml
from scan3d.files.whole import Inputs, check_path, write_together
from scan3d.poses import MOVES
from scan3d.recording import Recording

RAW_COLUMNS = (
    "t_s",
    *("x_mm", "y_mm", "z_mm"),
    *("qw", "qx", "qy", "qz"),
    *("Fx_N", "Fy_N", "Fz_N"),
    *("Tx_Nmm", "Ty_Nmm", "Tz_Nmm"),
    "sweep",
)
_MARK = "# The map of a log of scan3d simulate"


def map_path(path: str | Path) -> Path:
    """Path of the map beside a raw log."""
    path = Path(path)
    return path.with_name(f"{path.stem}_map.toml")


def check_log(path: str | Path, inputs: Inputs, overwrite: bool) -> None:
    """Raise InputError if a log with faults must not be written at the path, with its map beside it."""
    path, beside = Path(path), map_path(path)
    for file in (path, beside):
        check_path(file, inputs, "--out")
    ours = beside.exists() and beside.read_bytes().startswith(_MARK.encode())
    for file in (beside, path):
        if file.exists() and not ours and not overwrite:
            raise InputError(
                f"{file} can't be recognised as written by scan3d; give --overwrite to replace it, or choose another place "
                "with --out"
            )


def write_exact_log(recording: Recording, time_s: Array, move: NDArray[np.int8], path: str | Path) -> None:
    """Write a recording with the columns `t_s` and `move`; readers take the rows of the move sweep only."""
    path = Path(path)
    write_together(path, recording_files(recording, path.name, {"t_s": time_s, "move": np.array(MOVES)[move]}))


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
        f"{_MARK}.  The column sweep has the numbers of the planned sweeps, and -1 between them;\n"
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
