"""Scenes from files: a scan's folder, a cloud, a surface, or another program's PLY."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.errors import InputError
from scan3d.files.ply import read_ply
from scan3d.files.recordings import read_recording
from scan3d.pictures.scene import Scene, columns
from scan3d.pictures.words import key_figures
from scan3d.units import UNITS_M

_UNIT_COMMENT = "unit "


def of_folder(folder: Path, report: Mapping[str, Any], unit: str) -> Scene:
    """The scene in a scan's folder, without the truth.  Raises InputError if it holds neither cloud nor surface."""
    cloud, surface, log = (folder / name for name in ("cloud.ply", "surface.ply", "recording.csv"))
    if not (cloud.exists() or surface.exists()):
        raise InputError(f"{folder} holds no scan: expected cloud.ply or surface.ply in it; make it with 'scan3d scan'")
    parts: dict[str, Any] = {"key_figures": key_figures(report)}
    for path in (surface, cloud):
        if path.exists():
            found = read_ply_scene(path, unit)
            if found is None or (found.contacts is None) != (path == surface):
                raise InputError(f"{path} holds something else than its name says; run the scan again")
            kept = {name: getattr(found, name) for name in ("unit", "contacts", "surface", "bound")}
            parts |= {name: value for name, value in kept.items() if value is not None}
    if log.exists():
        parts["recording"] = read_recording(log)
    named, source = report.get("mesh") or {}, report.get("source") or {}
    origin = named.get("file") or source.get("mesh") or folder.resolve().name
    return Scene(**{"name": Path(str(origin)).stem, **parts})


def find_truth(folder: Path, report: Mapping[str, Any]) -> str | None:
    """The mesh file that a report names, if it is where it was, beside the folder, here, or in a folder here, unchanged."""
    named = report.get("mesh") or {}
    name, digest = Path(str(named.get("file"))).name, named.get("sha256")
    places = (folder, folder.resolve().parent, Path(), *sorted(one for one in Path().iterdir() if one.is_dir()))
    was = [folder / str(named["path"])] if named.get("path") else []
    for path in (*was, *(place / name for place in places)):
        if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == digest:
            return str(path)
    return None


def read_ply_scene(path: Path, unit: str) -> Scene | None:
    """The scene in a PLY: a cloud, or a surface as `scan` writes it with its bound; None for other PLYs with faces.

    Raises InputError for points that are none.
    """
    try:
        rows, faces, comments = read_ply(path)
    except InputError:
        return _read_foreign(path, unit)
    _check(path, rows)
    unit = said_unit(comments, unit)
    if faces is None:
        return Scene(path.stem, unit, contacts=rows)
    import trimesh

    bound = rows["bound"] if "bound" in (rows.dtype.names or ()) else None
    known = bound is not None and np.isfinite(bound).any()
    mesh = trimesh.Trimesh(columns(rows, "x", "y", "z"), faces, process=False)
    return Scene(path.stem, unit, surface=mesh, bound=bound if known else None)


def _read_foreign(path: Path, unit: str) -> Scene | None:
    """The points of another program's PLY."""
    import trimesh

    try:
        found = trimesh.load(path)
    except (OSError, ValueError, KeyError, IndexError, AttributeError, NotImplementedError) as error:
        raise InputError(f"can't read {path}: {error}; expected a PLY of points or triangles") from None
    if not isinstance(found, trimesh.PointCloud):
        return None
    rows = np.empty(len(found.vertices), dtype=[(name, "f8") for name in "xyz"])
    for name, values in zip("xyz", np.asarray(found.vertices).T, strict=True):
        rows[name] = values
    _check(path, rows)
    return Scene(path.stem, unit, contacts=rows)


def _check(path: Path, rows: NDArray[Any]) -> None:
    if not {"x", "y", "z"} <= set(rows.dtype.names or ()):
        raise InputError(f"{path.name} has no points: expected the columns x, y and z")
    if not len(rows) or not np.isfinite(columns(rows, "x", "y", "z")).all():
        raise InputError(f"{path.name} has no points, or some that are not numbers; expected a cloud of contacts")


def said_unit(comments: tuple[str, ...], unit: str) -> str:
    """The unit that a PLY's comments say, or the one given."""
    said = [line.removeprefix(_UNIT_COMMENT) for line in comments if line.startswith(_UNIT_COMMENT)]
    return said[0] if said and said[0] in UNITS_M else unit


def read_report(folder: Path) -> Mapping[str, Any]:
    """A scan's report.json; empty if there is none.  Raises InputError if it can't be read."""
    path = folder / "report.json"
    if not path.exists():
        return {}
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"can't read {path}: {error}; run the scan again") from None
    if not isinstance(data, Mapping):
        raise InputError(f"{path} is no report: expected a JSON object; run the scan again")
    return data
