"""Clouds and surfaces read back from the files that `scan3d.files.exports` writes, by file ending.

A file holds a part of what belongs to a cloud: its points and the columns of its table.  Where a format has no place for a
unit, the caller states it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.errors import InputError
from scan3d.files.exports import CLOUD_ENDINGS, listed
from scan3d.files.reading import check_file
from scan3d.files.shapes import NORMAL, POINT, Shape, read_shape
from scan3d.units import UNITS_M

_UNIT = "|".join(UNITS_M)
# Bytes at the beginning of a file in which its unit is looked for, and memory per byte of a table of text.
_LOOKED_AT, _MEMORY_PER_BYTE = 1 << 12, 8


def read_cloud(path: str | Path, unit: str | None = None) -> Shape:
    """The cloud, or of ``.vtp`` and ``.ply`` the surface, in a file of `CLOUD_ENDINGS`.

    unit
        of points that state none (``.xyz``, ``.xyzn``); for others None, or the unit that they state.

    Raises InputError for other files, and for another unit than the file states.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path.name} is no cloud by its ending, which should be {listed(CLOUD_ENDINGS)}")
    try:
        check_file(path, memory_per_byte=_MEMORY_PER_BYTE)
        rows, faces, stated = reader(path)
    except OSError as error:
        raise InputError(f"can't read {path}: {error.strerror or error}; check the path") from None
    except (ValueError, KeyError, IndexError) as error:
        raise InputError(
            f"{path.name} is not a {path.suffix} file as scan3d writes it: {' '.join(str(error).split())}"
        ) from None
    if unit is not None and stated not in (None, unit):
        raise InputError(f"{path.name} is in {stated}, as it states itself, and not in {unit}; leave the unit out")
    return Shape(rows, faces, stated or unit or "mm")


def stated_unit(path: Path) -> str | None:
    """The unit that a mesh file states if scan3d has written it, or None."""
    with open(path, "rb") as file:
        head = file.read(_LOOKED_AT).decode(errors="replace")
    if path.suffix.lower() == ".glb":
        return "m"  # by its specification
    match = re.search(rf"scan3d surface(?s:.*?)unit ({_UNIT})\b", head)
    return match[1] if match else None


_Read = tuple[NDArray[Any], NDArray[np.int32] | None, str | None]


def _ply(path: Path) -> _Read:
    shape = read_shape(path)
    return shape.rows, shape.faces, shape.unit


def _pcd(path: Path) -> _Read:
    head, separator, body = path.read_bytes().partition(b"\nDATA binary\n")
    lines = [line.split() for line in head.decode(errors="replace").splitlines()]
    fields = next((line[1:] for line in lines if line[:1] == ["FIELDS"]), [])
    unit = next((line[2] for line in lines if line[:2] == ["#", "unit"] and len(line) == 3), None)
    if not separator or unit not in UNITS_M:
        raise ValueError("its header has no unit, or no binary data follow")
    values = np.frombuffer(body, "<f4").reshape(-1, len(fields))
    return _table([re.sub("^normal_([xyz])$", r"n\1", name) for name in fields], values), None, unit


def _csv(path: Path) -> _Read:
    header = path.read_text(encoding="utf-8").partition("\n")[0].split(",")
    match = re.fullmatch(rf"x_({_UNIT})", header[0])
    if match is None:
        raise ValueError(f"its header begins with {header[0][:20]!r}, where x and a unit is expected, such as x_mm")
    unit = match[1]
    names = [re.sub(rf"_({unit}|N)$", "", name) for name in header]
    return _table(names, np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)), None, unit


def _xyz(path: Path) -> _Read:
    values = np.loadtxt(path, ndmin=2)
    if values.shape[1] not in (3, 6):
        raise ValueError(f"it has {values.shape[1]} numbers in a line, where 3 or 6 are expected")
    return _table([*POINT, *NORMAL][: values.shape[1]], values), None, None


def _vtp(path: Path) -> _Read:
    import pyvista

    data = pyvista.read(path)
    if "unit" not in data.field_data or "Normals" not in data.point_data:
        raise ValueError("it states no unit, or has no normals")
    columns = {name: np.asarray(column) for name, column in data.point_data.items() if name != "Normals"}
    points = dict(zip(POINT, np.asarray(data.points, dtype=float).T, strict=True))
    normals = dict(zip(NORMAL, np.asarray(data.point_data["Normals"]).T, strict=True))
    faces = data.faces.reshape(-1, 4)[:, 1:].astype(np.int32) if data.faces.size else None
    return _structured(points | normals | columns), faces, str(data.field_data["unit"][0])


def _table(names: list[str], values: NDArray[Any]) -> NDArray[Any]:
    """Rows of named columns; normals that the file does not hold are NaN."""
    columns = dict(zip(names, values.T, strict=True))
    unknown = dict.fromkeys(NORMAL, np.full(len(values), np.nan))
    points = {name: columns.pop(name).astype(float) for name in POINT}
    return _structured(points | unknown | columns)


def _structured(columns: dict[str, NDArray[Any]]) -> NDArray[Any]:
    rows = np.empty(len(columns["x"]), dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    return rows


_READERS: dict[str, Callable[[Path], _Read]] = {
    ".ply": _ply,
    ".pcd": _pcd,
    ".csv": _csv,
    ".xyz": _xyz,
    ".xyzn": _xyz,
    ".vtp": _vtp,
}
