"""The steps of a scan as `scan3d` offers them: meshes and recordings may be given as the paths of their files.

The functions that do the work know nothing of files.  Recordings, clouds and surfaces are saved in the formats of the commands,
read back, and handed to other libraries, of which pandas and open3d are imported only by the functions that need them.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

import numpy as np
import trimesh

import planar
from planar.plots import to_frame, words
from scan3d import comparison
from scan3d.calibration import report
from scan3d.calibration.report import Calibration
from scan3d.choices import Method, Model, Tare, one_of
from scan3d.cloud import Cloud, NormalSource
from scan3d.comparison import Comparison
from scan3d.errors import InputError, import_open3d
from scan3d.files.meshes import FORMATS, common_unit, load_mesh, read_mesh, stated_unit
from scan3d.files.recordings import read_recording, sidecar, write_recording
from scan3d.files.shapes import Shape, cloud_table, read_shape, surface_table, table, to_polydata, write_shape
from scan3d.files.tables import PARQUET
from scan3d.files.whole import check_pair
from scan3d.geometry.distance import distances
from scan3d.planning import Plan
from scan3d.reconstruction import reconstruct as reconstruct_contacts
from scan3d.recording import Recording
from scan3d.simulation import scan
from scan3d.surfaces import choice
from scan3d.units import UNITS_M, Unit, check_unit, unit_of, unit_remark

if TYPE_CHECKING:
    import pandas

    from scan3d.surfaces import Enclosure


_Path = str | os.PathLike[str]
_Step = TypeVar("_Step", bound=Callable[..., Any])


def _recording(given: Recording | _Path) -> Recording:
    return read_recording(Path(given)) if isinstance(given, (str, os.PathLike)) else given


def _described_by(inner: Callable[..., Any], further: str) -> Callable[[_Step], _Step]:
    """Gives a step the description of the function that does its work, and a further sentence."""

    def describe(step: _Step) -> _Step:
        step.__doc__ = f"{inner.__doc__}\n    {further}\n"
        return step

    return describe


@_described_by(scan.simulate, "The mesh may be given as the path of its file, which is read by `scan3d.load_mesh`.")
def simulate(
    mesh: trimesh.Trimesh | _Path, plan: Plan | None = None, progress: scan.Progress | None = None
) -> Recording:
    if isinstance(mesh, (str, os.PathLike)):
        mesh = load_mesh(mesh, unit=(plan or Plan()).unit)
    return scan.simulate(mesh, plan, progress)


@_described_by(reconstruct_contacts, "The recording may be given as the path of its ``.csv`` or ``.parquet`` file.")
def reconstruct(recording: Recording | _Path, method: str = "closed-form", model: Model | None = None) -> Cloud:
    return reconstruct_contacts(_recording(recording), method, model)


@_described_by(choice.surface, "`Trimesh.units` is the unit of the cloud.")
def surface(cloud: Cloud, method: Method = "auto", *, bounds: Enclosure | None = None) -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = choice.surface(cloud, method, bounds=bounds)
    mesh.units = cloud.unit
    return mesh


@_described_by(
    comparison.compare,
    "Either may be given as the path of a mesh file, whose triangles are taken as they are.  A warning says so if the "
    "sizes\n    differ by a factor between units, such as 10, 25.4 or 1000.",
)
def compare(surface: trimesh.Trimesh | _Path, mesh: trimesh.Trimesh | _Path) -> Comparison:
    paths = [Path(given) for given in (surface, mesh) if isinstance(given, (str, os.PathLike))]
    stated = [getattr(given, "units", None) for given in (surface, mesh)]
    known = [unit for unit in stated if unit in UNITS_M]
    unit = known[0] if known else common_unit(*paths)
    first, second = (
        read_mesh(given, unit) if isinstance(given, (str, os.PathLike)) else given for given in (surface, mesh)
    )
    compared = comparison.compare(first, second)
    if remark := unit_remark(first.extents, second.extents):
        warnings.warn(remark, stacklevel=2)
    return compared


@_described_by(report.calibrate, "The recording may be given as the path of its file.")
def calibrate(
    recording: Recording | _Path,
    reference: float | Literal["plane"] | None = None,
    *,
    sphere: float | None = None,
    tare: Tare = "auto",
    pose_noise_m: float | None = None,
) -> Calibration:
    return report.calibrate(_recording(recording), reference, sphere=sphere, tare=tare, pose_noise_m=pose_noise_m)


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
        ``.xyzn``, ``.csv`` or ``.glb``) or a surface (``.stl``, ``.ply``, ``.obj``, ``.glb`` or
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
        of a recording, of a cloud or a surface in a ``.ply`` of `scan3d.save`, or of any mesh file.
    unit
        of a file that does not state its unit; lengths stay as they are in the file.

    A recording is read as by `scan3d.read_recording`, with the ``.toml`` beside it.  A mesh is read as it is, convex or not;
    its unit, where it is known, is `Trimesh.units`, and the columns of a surface are its `vertex_attributes`.
    Raises InputError for files that can't be read, and for another unit than the file states.
    """
    path = Path(path)
    ending = path.suffix.lower()
    check_unit(unit)
    if not path.is_file():
        raise InputError(
            f"there is no file {path}; give a recording, a cloud, a surface or a mesh, and a folder to scan3d.open"
        )
    if ending in (".csv", PARQUET):
        return read_recording(path)
    if ending[1:] not in FORMATS:
        known = (".csv", PARQUET, *(f".{name}" for name in FORMATS))
        raise InputError(f"can't load {path.name}: expected a file ending in {one_of(known)}")
    stated = stated_unit(path)
    if unit is not None and stated not in (None, unit):
        raise InputError(f"{path.name} is in {stated}, as it states itself, and not in {unit}; leave the unit out")
    if ending != ".ply" or stated is None:
        mesh = read_mesh(path, stated)
        if stated or unit:
            mesh.units = stated or unit
        return mesh
    shape = read_shape(path)
    if shape.faces is None:
        return shape
    mesh = trimesh.Trimesh(shape.points, shape.faces, vertex_normals=shape.normals, process=False)
    mesh.units = shape.unit
    mesh.vertex_attributes.update(shape.columns)
    return mesh


def to_shape(what: _Thing, truth: trimesh.Trimesh | _Path | None = None, unit: str | None = None) -> Shape:
    """The table of a cloud or a surface, as `save` writes it, with the distances from the true body as ``quality``."""
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
    if truth is None:
        return shape
    body = read_mesh(truth, shape.unit) if isinstance(truth, (str, os.PathLike)) else truth
    columns = {name: shape.rows[name] for name in shape.rows.dtype.names or ()}
    return replace(shape, rows=table(columns | {"quality": distances(shape.points, body)}))


def _of_mesh(mesh: trimesh.Trimesh, unit: str | None) -> Shape:
    stated = mesh.units
    if unit is None and stated is not None and stated not in UNITS_M:
        raise InputError(f"the surface is in {stated!r}; give its unit as one of {', '.join(UNITS_M)}")
    check_unit(unit)
    rows = surface_table(mesh, mesh.vertex_attributes.get("bound"))
    return Shape(rows, np.asarray(mesh.faces, np.int32), unit_of(mesh, unit))


def to_pandas(what: _Thing, truth: trimesh.Trimesh | _Path | None = None) -> pandas.DataFrame:
    """A table with a row for each contact, or each vertex of a surface, and those columns of `save` that are not empty.

    Phases and the sources of normals are words.  Raises InputError without pandas.
    """
    shape = to_shape(what, truth)
    columns: dict[str, Any] = {name: shape.rows[name] for name in shape.rows.dtype.names or ()}
    for name, kind in (("phase", planar.Phase), ("normal_source", NormalSource)):
        if name in columns:
            columns[name] = words(columns[name], kind)
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
