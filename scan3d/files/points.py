"""Touches of other probes in files: places, and normals and deviations where the file has them.

Text in columns, PLY and the Point Cloud Library's PCD are read, with the columns' names that this program and others write.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array
from scan3d.choices import one_of
from scan3d.cloud import NormalSource
from scan3d.errors import InputError
from scan3d.files.columns import ENDINGS as ARRAYS
from scan3d.files.columns import SHEETS, check_single, stated_text
from scan3d.files.shapes import COVARIANCE, NORMAL, POINT, read_ply
from scan3d.files.tables import guessed_layout, read_table
from scan3d.files.text import check_readable
from scan3d.units import FACTORS, UNITS_M, stated_unit, without_unit

ENDINGS = (".csv", ".ply", ".pcd", ".xyz", ".xyzn", ".txt", *ARRAYS, *SHEETS)
"""Of files of touches; those but PLY and PCD are tables."""
# Other names of the columns, in small letters and without their units.
_NAMES = {
    **{f"normal_{axis}": f"n{axis}" for axis in "xyz"},
    **{f"normal{axis}": f"n{axis}" for axis in "xyz"},
    **dict.fromkeys(("sd", "sigma", "std", "stddev"), "place_sd"),
    **{f"points_{k}": axis for k, axis in enumerate("xyz")},
    **{f"normals_{k}": f"n{axis}" for k, axis in enumerate("xyz")},
}
_WANTED = (*POINT, *NORMAL, "place_sd", "normal_sd", *COVARIANCE)
_SOURCE = "normal_source"
_PCD_TYPES = {"F": "f", "I": "i", "U": "u"}


class Points(NamedTuple):
    """Touches (n,) in a file."""

    name: str
    columns: dict[str, Array]
    """Places ``x, y, z`` (n,), and of ``nx, ny, nz, place_sd, normal_sd`` and ``cov_xx`` to ``cov_zz`` those in the file."""
    unit: str | None
    """Of places and their deviations; None where the file does not state it."""
    left_out: int
    """Rows without a place, as in clouds of cameras."""

    def stacked(self, names: tuple[str, ...]) -> Array | None:
        """(n, k) columns; None if one is missing."""
        if not all(name in self.columns for name in names):
            return None
        return np.stack([self.columns[name] for name in names], axis=1)


def read_points(path: str | Path) -> Points:
    """Read touches from a table, a PLY or a PCD, whose ending says which.

    Without names, three columns of a text or a matrix are places, and six places and normals; matrices may be called points and
    normals.  The deviation of a normal, ``normal_sd``, is
    in radians, unless its unit is stated as deg.  Raises InputError for files that can't be read, and for missing coordinates.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise InputError(f"can't read touches from {path.name}: expected a file ending in {one_of(ENDINGS)}")
    if not path.is_file():
        what = f"{path} is a folder" if path.is_dir() else f"there is no file {path}"
        raise InputError(f"{what}; give touches as a {one_of(ENDINGS)}")
    comments: tuple[str, ...] = ()
    if ending == ".ply":
        rows, _, comments = read_ply(path)
        columns: Mapping[str, NDArray[Any]] = {name: rows[name] for name in rows.dtype.names or ()}
    elif ending == ".pcd":
        columns, comments = _pcd(path)
    else:
        columns = _text(path)
        comments = (f"unit {unit}",) if (unit := stated_text(path, "unit")) else ()
    return _named(path.name, columns, comments)


def read_all_points(paths: Sequence[str | Path]) -> Points:
    """The touches of one body in several files, such as the clouds of the rods of an array, one after the other.

    Lengths become those of the first file; normals may be missing in some.  Raises InputError as `read_points`, for deviations
    that only some of the files have, and for a unit that only some of them state.
    """
    parts = [read_points(path) for path in paths]
    first = parts[0]
    stated, unstated = ([part.name for part in parts if (part.unit is None) == unknown] for unknown in (False, True))
    if stated and unstated:
        raise InputError(
            f"{stated[0]} states its unit and {unstated[0]} does not: name columns x_mm, y_mm and z_mm, or so"
        )
    columns: dict[str, Array] = {}
    for name in (name for name in _WANTED if any(name in part.columns for part in parts)):
        if (missing := [part.name for part in parts if name not in part.columns]) and name not in NORMAL:
            raise InputError(f"{missing[0]} has no column {name}, as others have: state it in all files, or in none")
        power = 2 if name in COVARIANCE else 1 if name in (*POINT, "place_sd") else 0
        values = []
        for part in parts:
            scale = UNITS_M[part.unit or "m"] / UNITS_M[first.unit or "m"]
            unknown = np.full(len(part.columns["x"]), np.nan)
            values.append(part.columns.get(name, unknown) * scale**power)
        columns[name] = np.concatenate(values)
    return Points(", ".join(part.name for part in parts), columns, first.unit, sum(part.left_out for part in parts))


def _named(file: str, columns: Mapping[str, NDArray[Any]], comments: tuple[str, ...]) -> Points:
    """The columns that are known, by their own names, and the unit by names and comments."""
    found: dict[str, Array] = {}
    stated = {words[1] for words in map(str.split, comments) if words[:1] == ["unit"] and len(words) == 2}
    for title, values in columns.items():
        if (known := _known(title)) is None:
            continue
        name, unit = known
        if name in found:
            raise InputError(f"{file} has two columns of {name}; leave one of them out")
        found[name] = np.asarray(values, dtype=np.float64)
        if unit is not None and unit[0] == "angle":
            found[name] = FACTORS["angle"][unit[1]] * found[name]
        elif unit is not None:
            stated.add(unit[1])
    if missing := [name for name in POINT if name not in found]:
        raise InputError(
            f"{file} has no column {one_of(missing)}: expected x, y, z, and, where they are known, nx, ny, nz, place_sd and "
            f"normal_sd; it has {', '.join(columns) or 'none'}"
        )
    for group in (NORMAL, COVARIANCE):  # what is there in part would count as not there, and places as exact
        if (part := [name for name in group if name in found]) and len(part) < len(group):
            raise InputError(
                f"{file} has {', '.join(part)} of {', '.join(group)}: add the others, or rename the columns if they are "
                "something else"
            )
    if unknown := stated - set(UNITS_M):
        raise InputError(f"{file} states the unit {min(unknown)}; expected one of {', '.join(UNITS_M)}")
    if len(stated) > 1:
        raise InputError(f"{file} states lengths in {' and '.join(sorted(stated))}; give all of them in one unit")
    # what a rod's contacts leave open of a normal, as its inclination to their slice, has no deviation
    source = found.pop(_SOURCE, np.array(NormalSource.MEASURED))
    unknown = source == NormalSource.UNKNOWN
    found |= {name: np.where(unknown, np.nan, found[name]) for name in NORMAL if name in found}
    if (estimated := (source != NormalSource.MEASURED) & ~unknown).any():
        found["normal_sd"] = found.get("normal_sd", 0.0) + np.where(estimated, np.pi, 0.0)
    there = np.isfinite(np.stack([found[name] for name in POINT])).all(axis=0)
    return Points(
        file, {name: values[there] for name, values in found.items()}, min(stated, default=None), int((~there).sum())
    )


def _known(title: str) -> tuple[str, tuple[str, str] | None] | None:
    """The name of a column, and its quantity and unit if these are stated; None for one that says nothing of touches."""
    title = re.sub(r"(cov_.*?)\^?[2²]", r"\1", title, flags=re.IGNORECASE)  # the square of a unit
    name = without_unit(title).strip().lower()
    name = _NAMES.get(name, name)
    return (name, stated_unit(title)) if name in (*_WANTED, _SOURCE) else None


def _text(path: Path) -> dict[str, NDArray[Any]]:
    """The columns of a text table by name."""
    table = read_table(path, guessed_layout(path), "table of touches")
    count = len(table.columns)
    check_single(path.name, table.names, dict.fromkeys(filter(_known, table.names)))
    # a matrix names its columns by its own name, if it has one, and their numbers
    matrix = path.suffix.lower() in ARRAYS and len({re.sub(r"_?\d+$", "", name) for name in table.names}) == 1
    if table.names and (any(map(_known, table.names)) or not matrix):
        return {
            name: table.numbers(k, gaps=True) if _known(name) else table.columns[k]
            for k, name in enumerate(table.names)
        }
    if count not in (3, 6):
        raise InputError(
            f"{path.name} has {count} columns without names; name them in the first line: x, y, z, and, where they are known, "
            "nx, ny, nz, place_sd and normal_sd"
        )
    return {name: table.numbers(k) for k, name in enumerate((POINT + NORMAL)[:count])}


def _pcd(path: Path) -> tuple[dict[str, NDArray[Any]], tuple[str, ...]]:
    """The columns of a PCD with one number each, and the comments of its header.

    Source: pointclouds.org, *The PCD (Point Cloud Data) file format*, version 0.7.
    """
    check_readable(path)
    data = path.read_bytes()
    found = re.search(rb"^DATA[ \t]+(\w+)[ \t]*\r?\n", data[: 1 << 16], re.MULTILINE)
    if found is None:
        raise InputError(f"{path.name} is not a PCD file: it has no line that begins with DATA; export it again")
    lines = data[: found.end()].decode(errors="replace").splitlines()
    head = {words[0]: words[1:] for words in map(str.split, lines) if words}
    comments = tuple(line.lstrip("# ") for line in lines if line.startswith("#"))
    kind, body = found[1].decode(), data[found.end() :]
    try:
        names, count = head["FIELDS"], int(head["POINTS"][0])
        counts = [int(one) for one in head.get("COUNT", ["1"] * len(names))]
        types = [_PCD_TYPES[letter] + size for letter, size in zip(head["TYPE"], head["SIZE"], strict=True)]
        fields = [(str(k), f"<{code}", (width,)) for k, (code, width) in enumerate(zip(types, counts, strict=True))]
        if kind == "ascii":
            values = np.array(body.split()[: count * sum(counts)], dtype=np.float64).reshape(count, sum(counts))
            first = np.cumsum([0, *counts])
            columns = {name: values[:, first[k]] for k, name in enumerate(names) if counts[k] == 1}
        elif kind == "binary":
            rows = np.frombuffer(body, np.dtype(fields), count)
            columns = {name: rows[str(k)][:, 0] for k, name in enumerate(names) if counts[k] == 1}
        else:
            raise InputError(f"{path.name} is a PCD with DATA {kind}, which can't be read; save it as binary or ascii")
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise InputError(f"{path.name} is not a PCD file as it says ({error}); export it again") from None
    return columns, comments
