"""Files of one sweep in one plane: a CSV table of base positions and support reactions, and the table of its contacts.

The table is dimensionless or in SI units, by the names of its columns.  A TOML file of the same name in the same folder may
contain the rod and the noise.
"""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import planar
from scan3d.errors import InputError
from scan3d.files.columns import numbers_of
from scan3d.files.reading import check_file
from scan3d.files.recordings import sidecar
from scan3d.files.section import read_rod, read_section
from scan3d.files.whole import locate
from scan3d.one_sweep import OneSweep, SweepContacts
from scan3d.rods import Rod

COLUMNS = ("x0", "f0x", "f0y", "m0z")
"""Base position and support reactions in rod lengths, EI/L² and EI/L."""
SI_COLUMNS = ("x0_m", "f0x_N", "f0y_N", "m0z_Nm")
# What a recording has and one sweep in one plane has not.
_POSE = {"qw", "qx", "qy", "qz"}
# Names of the noise in the TOML file.
_NOISE, _SI_NOISE = ("force", "moment"), ("force_N", "moment_Nm")
# Memory per byte of a table while it is read.
_MEMORY_PER_BYTE = 16


def is_sweep(path: str | Path) -> bool:
    """Whether a file is a table of one sweep, by the names in its first line; also if some of its columns are missing."""
    path = Path(path)
    if path.suffix.lower() != ".csv":
        return False
    try:
        with open(locate(path), "rb") as file:
            line = file.readline(1 << 16).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError, InputError):
        return False  # the reader of recordings says what is wrong
    names = {name.strip().strip('"') for name in re.split("[,;\t]", line)}
    return bool(names & {*COLUMNS, *SI_COLUMNS}) and not names & _POSE


def read_sweep(
    path: str | Path, rod: Rod | None = None, noise_force: float | None = None, noise_moment: float | None = None
) -> OneSweep:
    """Read the table of one sweep, and its TOML file if there is one.

    rod
        of a table in SI units; by default that of the TOML file.
    noise_force, noise_moment
        standard deviations in the units of the table; by default those of the TOML file, and 0 without them.

    Raises InputError with the name of the file and the error in it.
    """
    path = Path(path)
    (x0, f0x, f0y, m0z), si = _read_table(path)
    named, force, moment = _read_sidecar(path, si)
    force = force if noise_force is None else noise_force
    moment = moment if noise_moment is None else noise_moment
    try:
        if rod is not None and not si:
            raise InputError(
                f"its columns are dimensionless and need no rod; with a rod they are {', '.join(SI_COLUMNS)}"
            )
        if si and (rod or named) is None:
            raise InputError(
                f"its columns are in SI units and need the rod: give --rod MATERIAL:DIAMETERxLENGTH, or a section [rod] in "
                f"{sidecar(path).name}"
            )
        return OneSweep(x0, f0x, f0y, m0z, rod or named, force, moment)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def _read_table(path: Path) -> tuple[list[NDArray[np.float64]], bool]:
    """The four columns (n,) of a table, and whether they are in SI units."""
    try:
        stored = locate(path)
        check_file(stored, memory_per_byte=_MEMORY_PER_BYTE)
        text = io.StringIO(stored.read_bytes().decode("utf-8-sig"), newline="")
        lines = [(number, line) for number, line in enumerate(csv.reader(text), start=1) if line]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"can't read the table {path}: {getattr(error, 'strerror', None) or error}") from None
    header = [name.strip() for name in lines[0][1]] if lines else []
    columns = _known_columns(path, header)
    for number, line in lines[1:]:
        if len(line) != len(header):
            raise InputError(
                f"{path.name}: line {number} has {len(line)} values, expected {len(header)}; is it cut off, or has it decimal "
                "commas?"
            )
    return [numbers_of(path, name, header.index(name), lines[1:]) for name in columns], columns == SI_COLUMNS


def _known_columns(path: Path, header: list[str]) -> tuple[str, ...]:
    """The four columns of a header.  Raises InputError unless it has all of one system of units, once."""
    plain, si = ([name for name in names if name in header] for names in (COLUMNS, SI_COLUMNS))
    if plain and si:
        raise InputError(
            f"{path.name}: its header mixes dimensionless columns ({', '.join(plain)}) with columns in SI units "
            f"({', '.join(si)}); give all four in one system"
        )
    columns = SI_COLUMNS if si else COLUMNS
    if missing := [name for name in columns if name not in header]:
        separated = (
            "; its columns must be separated by commas" if any(set(";\t") & set(name) for name in header) else ""
        )
        raise InputError(
            f"{path.name}: the header of one sweep lacks {', '.join(missing)}; expected {','.join(COLUMNS)} or "
            f"{','.join(SI_COLUMNS)}{separated}"
        )
    if repeated := [name for name in columns if header.count(name) > 1]:
        raise InputError(
            f"{path.name}: its header has {', '.join(repeated)} more than once; keep one column of each name"
        )
    return columns


def _read_sidecar(path: Path, si: bool) -> tuple[Rod | None, float, float]:
    """Rod and noise in the TOML file beside a table; None and zeros where it does not state them."""
    beside = sidecar(path)
    stored = locate(beside)
    if not stored.exists():
        return None, 0.0, 0.0
    meta = read_section(stored, "TOML file of the table", name=beside.name)
    meta.any("schema")
    meta.notes("source")
    noise, names = meta.section("noise"), _SI_NOISE if si else _NOISE
    force, moment = (noise.number(name, 0.0, at_least=0) for name in names)
    rod = read_rod(meta.section("rod")) if si and "rod" in meta else None
    meta.finish(f" for a table that is {'in SI units' if si else 'dimensionless'}")
    return rod, force, moment


def contacts_csv(found: SweepContacts) -> bytes:
    """The contacts as CSV, a line for every row of the sweep; cells of unknown values are empty.

    Lengths are in metres (``x_m``) if the sweep has a rod, else in rod lengths; angles are in radians.  Columns of standard
    deviations are there if errors are known.
    """
    contacts, rod = found.contacts, found.sweep.rod
    length, unit = (rod.length_m, "_m") if rod else (1.0, "")
    columns: dict[str, NDArray[Any]] = {
        f"x0{unit}": found.sweep.x0,
        f"x{unit}": length * contacts.point[:, 0],
        f"y{unit}": length * contacts.point[:, 1],
        f"s1{unit}": length * contacts.s1,
        "phase": np.array([planar.Phase(code).name.lower() for code in contacts.phase]),
        "status": np.array([planar.Status(code).name.lower() for code in contacts.status]),
        "friction_angle": contacts.friction_angle,
        "friction": contacts.friction,
        "slope": contacts.slope,
        "normal_x": contacts.normal[:, 0],
        "normal_y": contacts.normal[:, 1],
    }
    if found.noisy:
        columns |= {
            f"sd_x{unit}": length * found.point_sd[:, 0],
            f"sd_y{unit}": length * found.point_sd[:, 1],
            f"sd_s1{unit}": length * found.s1_sd,
            "sd_friction_angle": found.friction_angle_sd,
            "sd_friction": found.friction_sd,
            "sd_slope": found.slope_sd,
        }
    cells = [[_cell(value) for value in column.tolist()] for column in columns.values()]
    return "".join(f"{','.join(row)}\n" for row in [list(columns), *zip(*cells, strict=True)]).encode()


def _cell(value: float | str) -> str:
    """A number with all digits; an empty text for one that is not known."""
    if isinstance(value, str):
        return value
    return repr(value) if np.isfinite(value) else ""
