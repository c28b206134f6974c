"""Recordings, clouds and surfaces saved to files, read back, and handed to other libraries.

The formats are those of the commands.  pandas and open3d are imported only by the functions that need them.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import trimesh

import planar
from planar.tables import to_frame, words
from scan3d.choices import one_of
from scan3d.cloud import Cloud
from scan3d.errors import InputError, import_open3d
from scan3d.files.binary_tables import ENDING as PARQUET
from scan3d.files.formats import (
    CLOUD_ENDINGS,
    SURFACE_ENDINGS,
    read_cloud,
    to_polydata,
    write_shape,
)
from scan3d.files.meshes import FORMATS, read_mesh, stated_unit
from scan3d.files.recordings import read_recording, sidecar, write_recording
from scan3d.files.shapes import Shape, cloud_table, surface_table, table
from scan3d.files.whole import check_pair
from scan3d.geometry.distance import distances
from scan3d.recording import Recording
from scan3d.units import UNITS_M, Unit, unit_of

if TYPE_CHECKING:
    import pandas

_Path = str | os.PathLike[str]


_Thing: TypeAlias = "Cloud | Shape | trimesh.Trimesh"


def save(
    what: Recording | _Thing,
    path: _Path,
    *,
    truth: trimesh.Trimesh | _Path | None = None,
    unit: Unit | None = None,
    overwrite: bool = False,
) -> None:
    """Write a recording, a cloud or a surface to a file, whose ending determines the format.

    what
        a recording (``.csv`` or ``.parquet``, with a ``.toml`` beside it), a cloud (``.ply``, ``.pcd``, ``.vtp``, ``.xyz``,
        ``.xyzn``, ``.csv``, ``.glb`` or ``.mcap``, a bag of ROS 2) or a surface (``.stl``, ``.ply``, ``.obj``, ``.glb`` or
        ``.vtp``).
    truth
        the true body, or the path of its mesh: the column ``quality`` is then the distance of each point from it.
    unit
        of a surface; by default that which it states (`Trimesh.units`), or mm.
    overwrite
        whether a file may be replaced that can't be recognised as written by scan3d.

    Raises InputError for other things and endings, for normals that a format needs and are not known, and if the file can't be
    written or must not be replaced.
    """
    if isinstance(what, Recording):
        check_pair(Path(path), sidecar(Path(path)), {}, overwrite, "path", str(what.source.get("kind", "")))
        write_recording(what, Path(path), overwrite=True)  # checked above
    else:
        write_shape(to_shape(what, truth, unit), Path(path), overwrite=overwrite, option="path")


def load(path: _Path, *, unit: Unit | None = None) -> Recording | Shape | trimesh.Trimesh:
    """What a file holds: a recording, a cloud, or a surface or another mesh.

    path
        of a file in a format of `scan3d.save`, or of any mesh file.
    unit
        of a file that does not state its unit; lengths stay as they are in the file.

    A recording is read as by `scan3d.read_recording`, with the ``.toml`` beside it.  A mesh is read as it is, convex or not;
    its unit, where it is known, is `Trimesh.units`, and the columns of a surface are its `vertex_attributes`.
    Raises InputError for files that can't be read, and for another unit than the file states.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if unit not in (None, *UNITS_M):
        raise InputError(f"unit must be one of {', '.join(UNITS_M)}, got {unit!r}")
    if not path.is_file():
        raise InputError(
            f"there is no file {path}; give a recording, a cloud, a surface or a mesh, and a folder to scan3d.open"
        )
    if ending == PARQUET or (ending == ".csv" and not _is_cloud_table(path)):
        return read_recording(path)
    if ending == ".ply" and not _is_scan3d_ply(path):
        return _mesh(path, unit)
    if ending in CLOUD_ENDINGS:
        shape = read_cloud(path, unit)
        return shape if shape.faces is None else _surface(shape)
    if ending[1:] in FORMATS:
        return _mesh(path, unit)
    known = sorted({*CLOUD_ENDINGS, *SURFACE_ENDINGS, *(f".{name}" for name in FORMATS), PARQUET})
    raise InputError(f"can't load {path.name}: expected a file ending in {one_of(known)}")


def _is_cloud_table(path: Path) -> bool:
    with open(path, "rb") as file:
        return file.readline(1 << 12).startswith(b"x_")


def _is_scan3d_ply(path: Path) -> bool:
    """Whether a PLY states its unit in a comment, as scan3d writes it."""
    with open(path, "rb") as file:
        head = file.read(1 << 12).partition(b"end_header")[0]
    return any(f"comment unit {unit}\n".encode() in head for unit in UNITS_M)


def _mesh(path: Path, unit: str | None) -> trimesh.Trimesh:
    stated = stated_unit(path)
    mesh = read_mesh(path, stated)
    if unit is not None and stated not in (None, unit):
        raise InputError(f"{path.name} is in {stated}, as it states itself, and not in {unit}; leave the unit out")
    if stated or unit:
        mesh.units = stated or unit
    return mesh


def _surface(shape: Shape) -> trimesh.Trimesh:
    mesh = trimesh.Trimesh(shape.points, shape.faces, vertex_normals=shape.normals, process=False)
    mesh.units = shape.unit
    mesh.vertex_attributes.update(shape.columns)
    return mesh


def to_shape(what: _Thing, truth: trimesh.Trimesh | _Path | None = None, unit: str | None = None) -> Shape:
    """The table of a cloud or a surface, as `save` writes it."""
    if isinstance(what, Shape):
        shape = what
    elif isinstance(what, Cloud):
        shape = Shape(cloud_table(what), None, what.unit)
    elif isinstance(what, trimesh.Trimesh):
        shape = _of_mesh(what, unit)
    else:
        raise InputError(
            f"only a recording, a cloud or a surface (trimesh.Trimesh) can be saved, got a {type(what).__name__}"
        )
    return shape if truth is None else _with_quality(shape, truth)


def _of_mesh(mesh: trimesh.Trimesh, unit: str | None) -> Shape:
    stated = mesh.units
    if unit is None and stated is not None and stated not in UNITS_M:
        raise InputError(f"the surface is in {stated!r}; give its unit as one of {', '.join(UNITS_M)}")
    if unit not in (None, *UNITS_M):
        raise InputError(f"unit must be one of {', '.join(UNITS_M)}, got {unit!r}")
    rows = surface_table(mesh, mesh.vertex_attributes.get("bound"))
    return Shape(rows, np.asarray(mesh.faces, np.int32), unit_of(mesh, unit))


def _with_quality(shape: Shape, truth: trimesh.Trimesh | _Path) -> Shape:
    """The table with the distances of its points from the true body as the column ``quality``."""
    body = read_mesh(truth, shape.unit) if isinstance(truth, (str, os.PathLike)) else truth
    columns = {name: shape.rows[name] for name in shape.rows.dtype.names or ()}
    return replace(shape, rows=table(columns | {"quality": distances(shape.points, body)}))


def to_pandas(what: _Thing, truth: trimesh.Trimesh | _Path | None = None) -> pandas.DataFrame:
    """A table with a row for each contact, or each vertex of a surface, and those columns of `save` that are not empty.

    Phases are words.  Raises InputError without pandas.
    """
    shape = to_shape(what, truth)
    columns: dict[str, Any] = {name: shape.rows[name] for name in shape.rows.dtype.names or ()}
    if "phase" in columns:
        columns["phase"] = words(columns["phase"], planar.Phase)
    try:
        return to_frame(columns)
    except ImportError as error:
        raise InputError(str(error)) from None


def to_pyvista(what: _Thing, truth: trimesh.Trimesh | _Path | None = None) -> Any:
    """A `pyvista.PolyData` with the normals (``Normals``) and every other column of `save` as point data."""
    return to_polydata(to_shape(what, truth))


def to_open3d(what: _Thing, truth: trimesh.Trimesh | _Path | None = None) -> Any:
    """An `open3d.t.geometry.PointCloud`, or `TriangleMesh` of a surface, with ``normals`` and every other column of `save`."""
    open3d = import_open3d("to_open3d needs")
    shape = to_shape(what, truth)
    geometry, tensor = open3d.t.geometry, open3d.core.Tensor
    target = geometry.PointCloud() if shape.faces is None else geometry.TriangleMesh()
    points = target.point if shape.faces is None else target.vertex
    points["positions"], points["normals"] = tensor(shape.points), tensor(shape.normals.astype(np.float64))
    for name, column in shape.columns.items():
        points[name] = tensor(column[:, None])
    if shape.faces is not None:
        target.triangle["indices"] = tensor(shape.faces)
    return target
