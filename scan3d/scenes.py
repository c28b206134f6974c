"""Scenes read from files, to be shown and compared: a scan's folder, a cloud, a surface, or points of another program."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.exchange.load import mesh_loaders

from scan3d.errors import InputError
from scan3d.files import whole
from scan3d.files.meshes import FORMATS, read_mesh
from scan3d.files.reading import check_file
from scan3d.files.recordings import read_recording
from scan3d.files.shapes import NORMAL, POINT, read_ply, table
from scan3d.files.whole import REPORT, SCHEMA, check_belongs, locate, sha256
from scan3d.pictures.scene import Scene, columns
from scan3d.report import key_figures
from scan3d.units import UNITS_M

DEMO = Path(__file__).with_name("egg.glb")
"""The body of the demonstration, that of ``meshes/egg.stl`` with fewer facets."""
_WANTED = f"expected a scan's folder, or a surface or mesh file (.{', .'.join(FORMATS)})"


def read_report(folder: Path) -> Mapping[str, Any]:
    """A scan's report.json; empty if the file does not exist, or is of another program.

    Raises InputError if it can't be read, or was edited so that it can't be shown.
    """
    data, path = whole.read_report(folder), folder / REPORT
    if data.get("schema", SCHEMA) != SCHEMA:
        raise InputError(
            f"{path}: schema {data['schema']!r} is not known, expected {SCHEMA}; was it written by a newer version?"
        )
    if "versions" not in data:
        return {}
    try:
        key_figures(data)
        (data["mesh"] or {}).get("sha256")
        data["source"].get("mesh")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        reason = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(f"{path} is not as scan3d has written it: {reason}; run the scan again") from None
    return data


def read_folder(folder: Path, unit: str) -> tuple[Scene, Mapping[str, Any]]:
    """The scene in a scan's folder, without the truth, and the report.

    Raises InputError if the folder holds neither cloud nor surface, or files that do not belong to its report.
    """
    report = read_report(folder)
    return scene_of_folder(folder, report, unit), report


def scene_of_folder(folder: Path, report: Mapping[str, Any], unit: str) -> Scene:
    """The scene in a scan's folder, without the truth.  Raises InputError as `read_folder`."""
    names = ("cloud.ply", "surface.ply", "recording.csv", "recording.toml")
    check_belongs(folder, report, names)
    cloud, surface, log = (locate(folder / name) for name in names[:3])
    if not (cloud.exists() or surface.exists()):
        raise InputError(f"{folder} holds no scan: expected cloud.ply or surface.ply in it; make it with 'scan3d scan'")
    parts: dict[str, Any] = {"key_figures": key_figures(report) if report else ()}
    for path in (surface, cloud):
        if path.exists():
            part = read_ply_scene(path, unit)
            if part is None or (part.contacts is None) != (path == surface):
                raise InputError(f"{path} does not hold what its name says; run the scan again")
            fields = {name: getattr(part, name) for name in ("unit", "contacts", "surface", "bound")}
            parts |= {name: value for name, value in fields.items() if value is not None}
    # beside a result there may be a recording that it was not made from
    if log.exists() and log.name in (report.get("sha256") or names):
        parts["recording"] = read_recording(folder / log.name)
    mesh, source = report.get("mesh") or {}, report.get("source") or {}
    origin = mesh.get("file") or source.get("mesh") or folder.resolve().name
    return Scene(**{"name": Path(str(origin)).stem, **parts})


def find_truth(folder: Path, report: Mapping[str, Any]) -> str | None:
    """The mesh file that a report names, None if it is not found unchanged.

    It is looked for in the folder, beside it, in the current directory, in the folders there, and where the demonstration's is.
    """
    mesh = report.get("mesh") or {}
    name, digest = Path(str(mesh.get("file"))).name, mesh.get("sha256")
    if not digest:
        return None
    below = sorted(path for path in Path().iterdir() if path.is_dir())
    places = (folder, folder.resolve().parent, Path(), *below, DEMO.parent)
    for path in (place / name for place in places):
        with suppress(OSError, ValueError):  # a name that can't be one of a file, or a file that can't be read
            if path.is_file() and sha256(path) == digest:
                return str(path)
    return None


def read_ply_scene(path: Path, unit: str) -> Scene | None:
    """The scene in a PLY: a cloud, or a surface as `scan` writes it with its bound; None for other PLYs with faces.

    Raises InputError for files that can't be read, and for points that are missing or not finite.
    """
    try:
        rows, faces, comments = read_ply(path)
    except InputError:
        rows, faces, comments = _of_other_program(path)
        if faces is not None:
            return None
    if not {*POINT} <= {*(rows.dtype.names or ())}:
        raise InputError(f"{path.name} has no points: expected the columns x, y and z")
    if not len(rows) or not np.isfinite(columns(rows, *POINT)).all():
        raise InputError(f"{path.name} has no points, or points that are not numbers; expected a cloud of contacts")
    unit = unit_of(comments, unit)
    if faces is None:
        return Scene(path.stem, unit, contacts=rows)
    if not len(faces):
        raise InputError(f"{path.name} has no triangles, where a surface is expected; run the scan again")
    bound = rows["bound"] if "bound" in (rows.dtype.names or ()) else None
    is_known = bound is not None and np.isfinite(bound).any()
    mesh = trimesh.Trimesh(columns(rows, "x", "y", "z"), faces, process=False)
    if "known" in (rows.dtype.names or ()):
        mesh.vertex_attributes["known"] = rows["known"]
    return Scene(path.stem, unit, surface=mesh, bound=bound if is_known else None)


def _of_other_program(path: Path) -> tuple[NDArray[Any], Any, tuple[str, ...]]:
    """As `read_ply`, of any PLY: its points, with normals if they are there, and its faces, None if there are none."""
    try:
        check_file(path)
        raw = mesh_loaders["ply"](io.BytesIO(path.read_bytes()), skip_materials=True)
        data = raw["metadata"]["_ply_raw"]["vertex"]["data"]
        known = [name for name in POINT + NORMAL if name in (data if isinstance(data, dict) else data.dtype.names)]
        rows = table({name: np.asarray(data[name], dtype=float).ravel() for name in known})
    # trimesh's parser raises various errors for foreign bytes; the reader of meshes says what is wrong with those
    except Exception:
        return np.empty(0), (), ()
    return rows, raw["faces"] if len(raw.get("faces", ())) else None, ()


def unit_of(comments: tuple[str, ...], default: str) -> str:
    """The unit that a PLY's comments state, or the default."""
    stated = [line.removeprefix("unit ") for line in comments if line.startswith("unit ")]
    return stated[0] if stated and stated[0] in UNITS_M else default


def other_surface(given: Any, unit: str, file_unit: str = "mm") -> trimesh.Trimesh:
    """The surface of a result of `scan3d.scan` or `scan3d.open`, of a folder or of a file, in `unit`; or a `trimesh.Trimesh`.

    `file_unit` is the unit of a file that does not state its own, and of a mesh without `Trimesh.units`.

    Raises InputError for what has no surface, and for files that can't be read.
    """
    if isinstance(given, (str, os.PathLike)):
        mesh, own = _read(Path(given), file_unit)
    else:
        mesh = getattr(given, "surface", given)
        if not isinstance(mesh, trimesh.Trimesh):
            raise InputError(
                f"there is no surface in a {type(given).__name__}: {_WANTED}, a result, or a trimesh.Trimesh"
            )
        own = mesh.units if mesh.units in UNITS_M else file_unit
    if not len(mesh.faces) or not np.isfinite(mesh.vertices).all():
        raise InputError(f"the other surface has no triangles, or vertices that are not numbers: {_WANTED}")
    return trimesh.Trimesh(np.asarray(mesh.vertices) * (UNITS_M[own] / UNITS_M[unit]), mesh.faces, process=False)


def _read(path: Path, unit: str) -> tuple[Any, str]:
    if not path.exists():
        raise InputError(f"there is no {path} to compare the surface with: {_WANTED}")
    if path.is_dir():
        scene: Any = read_folder(path, unit)[0]
    elif path.suffix.lower() == ".ply":
        scene = read_ply_scene(path, unit)
    elif path.suffix[1:].lower() in FORMATS:
        scene = None
    else:
        raise InputError(f"{path} has no surface to compare with: {_WANTED}")
    if scene is None:
        return read_mesh(path, unit), unit
    if scene.surface is None:
        raise InputError(f"{path} has no surface to compare with, but contacts only: {_WANTED}")
    return scene.surface, scene.unit
