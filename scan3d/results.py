"""A scan and its results as `scan3d` offers them: all steps at once, or one by one, of meshes and recordings or their files.

`Result` is what was just computed, or what a folder holds.  Recordings, clouds and surfaces are saved in the formats of the
commands, read back as they are or as scenes, to be shown and compared, and handed to other libraries, of which pandas and
open3d are imported only by the functions that need them.
"""

from __future__ import annotations

import dataclasses
import os
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar, Unpack

import numpy as np
import trimesh

import planar
from planar.plots import to_frame, words
from scan3d import comparison, pipeline
from scan3d.bounds import Certificate
from scan3d.choices import Color, Method, Model, View, one_of
from scan3d.cloud import Cloud, NormalSource
from scan3d.comparison import Comparison
from scan3d.errors import InputError, NoBodyError, import_open3d
from scan3d.files import whole
from scan3d.files.columns import PARQUET
from scan3d.files.meshes import FORMATS, common_unit, judge_mesh, load_mesh, read_mesh, stated_unit
from scan3d.files.points import Points, read_all_points
from scan3d.files.recordings import as_recording, read_recording, write_recording
from scan3d.files.shapes import (
    COVARIANCE,
    NORMAL,
    POINT,
    Shape,
    cloud_table,
    read_ply,
    read_shape,
    surface_table,
    table,
    to_polydata,
    write_shape,
)
from scan3d.files.whole import RECORDING, REPORT, RESULTS, SCHEMA, check_belongs, locate, replacing, sha256
from scan3d.geometry.distance import distances
from scan3d.pictures import notebook
from scan3d.pictures.figures import sheet
from scan3d.pictures.parts import Scene, columns
from scan3d.planning import Plan
from scan3d.reconstruction import reconstruct as reconstruct_contacts
from scan3d.reconstruction.touches import touches as cloud_of_touches
from scan3d.recording import Recording
from scan3d.report import Analysis, key_figures, summary
from scan3d.settings import Given, shows_settings
from scan3d.settings import settings as chosen_settings
from scan3d.shown import Rows, Shown
from scan3d.simulation.scan import Progress
from scan3d.simulation.scan import simulate as simulate_scan
from scan3d.surfaces import choice
from scan3d.units import UNITS_M, Unit, check_unit, unit_of, unit_remark
from scan3d.workers import counted, in_one_thread

if TYPE_CHECKING:
    import pandas
    from PIL.Image import Image

    from scan3d.surfaces import Enclosure

_Path = str | os.PathLike[str]
_Step = TypeVar("_Step", bound=Callable[..., Any])


def _described_by(inner: Callable[..., Any], further: str) -> Callable[[_Step], _Step]:
    """Gives a step the description of the function that does its work, and a further sentence."""

    def describe(step: _Step) -> _Step:
        step.__doc__ = f"{inner.__doc__}\n    {further}\n"
        return step

    return describe


@_described_by(simulate_scan, "The mesh may be given as the path of its file, which is read by `scan3d.load_mesh`.")
@in_one_thread
def simulate(mesh: trimesh.Trimesh | _Path, plan: Plan | None = None, progress: Progress | None = None) -> Recording:
    if isinstance(mesh, (str, os.PathLike)):
        mesh = load_mesh(mesh, unit=(plan or Plan()).unit)
    return simulate_scan(mesh, plan, progress)


@_described_by(reconstruct_contacts, "The recording may be given as the path of its ``.csv`` or ``.parquet`` file.")
@in_one_thread
def reconstruct(recording: Recording | _Path, model: Model | None = None) -> Cloud:
    return reconstruct_contacts(as_recording(recording), model)


@_described_by(choice.surface, "`Trimesh.units` is the unit of the cloud.")
@in_one_thread
def surface(cloud: Cloud, method: Method = "auto", *, bounds: Enclosure | None = None) -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = choice.surface(cloud, method, bounds=bounds)
    mesh.units = cloud.unit
    return mesh


@_described_by(
    comparison.compare,
    "Either may be given as the path of a mesh file, whose triangles are taken as they are.  A warning says so if the "
    "sizes\n    differ by a factor between units, such as 10, 25.4 or 1000.",
)
@in_one_thread
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


@_described_by(
    cloud_of_touches,
    "The points may be given as the path of a ``.csv``, ``.ply``, ``.pcd`` or ``.xyz``, or as several paths, with the columns\n"
    "    x, y, z, and where they are known nx, ny, nz, place_sd, normal_sd and cov_xx to cov_zz.  What a file states comes\n"
    "    first, and its unit.",
)
@in_one_thread
def touches(
    points: Any,
    normals: Any = None,
    *,
    place_sd: Any = None,
    normal_sd: Any = None,
    covariance: Any = None,
    unit: Unit | None = None,
    table: float | None = None,
) -> Cloud:
    check_unit(unit)
    stated: str | None = unit
    paths = points if isinstance(points, (list, tuple)) else [points]
    read = read_all_points(paths) if paths and all(isinstance(path, (str, os.PathLike)) for path in paths) else points
    if isinstance(read, Points):
        if unit and read.unit not in (None, unit):
            raise InputError(
                f"{read.name} is in {read.unit}, as it states itself, and not in {unit}; leave the unit out"
            )
        stated, points, found = read.unit or unit, read.stacked(POINT), read.stacked(NORMAL)
        normals = normals if found is None else found
        place_sd, normal_sd = read.columns.get("place_sd", place_sd), read.columns.get("normal_sd", normal_sd)
        if (rows := read.stacked(COVARIANCE)) is not None:
            covariance = rows[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    return cloud_of_touches(
        points,
        normals,
        place_sd=place_sd,
        normal_sd=normal_sd,
        covariance=covariance,
        unit=stated or "mm",
        table=table,
    )


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
        ``.xyzn``, ``.csv``, ``.mat`` or ``.glb``) or a surface (``.stl``, ``.ply``, ``.obj``, ``.glb``, ``.vtp`` or ``.mat``).
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
        write_recording(what, Path(path), overwrite=overwrite)
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
    return Shape(surface_table(mesh), np.asarray(mesh.faces, np.int32), unit_of(mesh, unit))


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


@dataclass(frozen=True, repr=False, eq=False)
class Result(Shown):
    """The results of `scan3d.scan`, or those in a folder, of which `scan3d.open` reads each when it is first asked for."""

    report: Mapping[str, Any]
    """The numbers of ``report.json``."""
    analysis: Analysis | None = None
    """All that was computed, with the enclosure, the true body and the time of each step; None for what was read."""
    folder: Path | None = None
    """Where the results were read; None for what was computed."""

    def __post_init__(self) -> None:
        if self.analysis is not None:  # what was computed is not read
            self.__dict__.update({name: getattr(self.analysis, name) for name in ("recording", "cloud", "certificate")})

    @cached_property
    def recording(self) -> Recording:
        """The log of poses and wrenches.

        Raises InputError if the folder has none, or one of another run.
        """
        if self.report.get("model") == "touches":
            raise InputError(f"{self.folder} has no recording: its contacts are touches of another probe")
        path = self._place / RECORDING[0]
        if not locate(path).exists():
            raise InputError(
                f"{self.folder} has no {RECORDING[0]}, which results have; make them again with scan3d scan or "
                "reconstruct"
            )
        check_belongs(self._place, self.report, RECORDING)
        return read_recording(path)

    @cached_property
    def cloud(self) -> Cloud:
        """The contacts; those of a folder are reconstructed from its recording: ``cloud.ply`` holds a part of them.  Of touches
        of another probe it holds all, with normals in single precision.

        Raises InputError as `recording`, and if they are not those of ``cloud.ply``, which another version has written.
        """
        if self.report.get("model") == "touches":
            return touches(self._place / "cloud.ply", table=(self.report.get("certificate") or {}).get("table"))
        cloud, rows = reconstruct_contacts(self.recording, model=self.report.get("model")), self._files.contacts
        known = None if rows is None else columns(rows, "x", "y", "z")
        if known is not None:
            # rounding in another version of a library leaves less
            allowed = 1e-6 * float(np.linalg.norm(np.ptp(known, axis=0)))
            if known.shape != cloud.points.shape or np.abs(known - cloud.points).max() > allowed:
                raise InputError(
                    f"the recording in {self.folder} gives other contacts than cloud.ply has, which was written by "
                    f"scan3d {(self.report.get('versions') or {}).get('scan3d', 'of another version')}; run the scan "
                    "again"
                )
        if rows is not None and cloud.probed is not None:  # whose normals are those of the surface
            normals = np.where(cloud.probed[:, None], columns(rows, "nx", "ny", "nz"), cloud.normals)
            source = np.where(cloud.probed, rows["normal_source"], cloud.normal_source).astype(np.int8)
            return replace(cloud, normals=normals, normal_source=source)
        return cloud

    @cached_property
    def surface(self) -> trimesh.Trimesh:
        """The closed surface, with its method in `metadata`.

        Raises NoBodyError if the contacts span no body, and InputError if the folder lacks the surface.
        """
        if self.analysis is not None:
            return self.analysis.checked_surface()
        mesh, known = self._files.surface, self.report.get("surface") or {}
        if not known.get("method", True):
            raise NoBodyError(known["reason"])
        if mesh is None:
            raise InputError(f"{self.folder} has no surface.ply; run the scan again")
        mesh.units = self._files.unit
        if self._files.bound is not None:
            mesh.vertex_attributes["bound"] = np.asarray(self._files.bound, dtype=float)
        mesh.metadata.update({name: known.get(name) for name in ("method", "reason")})
        return mesh

    @cached_property
    def certificate(self) -> Certificate:
        """How far the surface can be from the body, from touch alone; local bounds of a folder are rounded to 24 bits."""
        bound, local = (self.report.get("certificate") or {}).get("bound"), self._files.bound
        surface = self._files.surface
        unknown = np.full(0 if surface is None else len(surface.vertices), np.inf)
        scanned = (self.report.get("mesh") or {}).get("scanned", "mesh")
        return Certificate(
            np.inf if bound is None else float(bound),
            unknown if local is None else np.asarray(local, float),
            "body" if scanned == "mesh" else scanned,
        )

    @cached_property
    def comparison(self) -> Comparison | None:
        """The distances between the surface and the mesh; None if the scan was made without one, and without a surface.

        Raises InputError if an earlier version has written the report, which does not hold them.
        """
        if self.analysis is not None:
            return self.analysis.comparison
        known = self.report.get("comparison")
        if self.report.get("mesh") is None or (known is None and not self.report["surface"]["method"]):
            return None
        if not isinstance(known, Mapping) or set(known) != {field.name for field in dataclasses.fields(Comparison)}:
            raise InputError(
                f"{self._place / REPORT} does not hold the comparison with the mesh: an earlier version has written "
                "it; run the scan again, or use scan3d.compare"
            )
        values: dict[str, Any] = {name: np.nan if value is None else value for name, value in known.items()}
        values["worst_point"] = np.array(known["worst_point"], dtype=float)
        return Comparison(**values)

    def save(self, folder: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the results into a folder, as ``scan3d scan`` does, or copy those of a folder, byte for byte.

        Files of others are replaced only with `overwrite`.  Raises InputError if the folder can't be written into, and if a
        file that is to be copied is missing or was changed.
        """
        if self.analysis is not None:
            pipeline.write(self.analysis, Path(folder), settings=self.report["settings"], overwrite=overwrite)
            return
        stated = dict.fromkeys([*self.report.get("files", ()), *(self.report.get("sha256") or ())])  # also what it read
        names = [name for name in stated if name in RESULTS and name != REPORT]
        check_belongs(self._place, self.report, names)
        missing = [name for name in names if not locate(self._place / name).is_file()]
        if missing:
            raise InputError(f"{self.folder} lacks {', '.join(missing)}, which its {REPORT} names; run the scan again")
        files = {name: locate(self._place / name).read_bytes() for name in names}
        with replacing(Path(folder), overwrite=overwrite) as result:
            for name, data in files.items():
                result.put(name, data)
            result.commit(self.report)

    def plot(  # type: ignore[override]
        self,
        truth: trimesh.Trimesh | str | os.PathLike[str] | None = None,
        *,
        against: Any = None,
        view: View = "surface",
        color: Color = "force",
        size: str | None = None,
        dpi: int | None = None,
        camera: str | None = None,
        path: str | os.PathLike[str] | None = None,
        overwrite: bool = False,
    ) -> Image:
        """A picture, drawn off screen.

        truth
            the true body, a `trimesh.Trimesh` or the path of its mesh, where it is not known: that of a folder is known if the
            mesh file lies in it, beside it, or in the current folder.
        against
            another result, its folder, or a surface or mesh file: the surface is coloured by its signed distance from that one.

        The other arguments, and what it raises, are those of `scan3d.plot`.
        """
        drawn, scene = sheet(size, dpi, camera), self._scene()
        if truth is not None:
            is_path = isinstance(truth, (str, os.PathLike))
            hull = of_hull(self.report)
            body = load_mesh(truth, hull=hull, unit=scene.unit) if is_path else judge_mesh(truth, hull=hull)
            scene = dataclasses.replace(scene, truth=body)
        other = None if against is None else other_surface(against, scene.unit)
        return notebook.scene_image(scene, view, color, drawn, against=other, path=path, overwrite=overwrite)

    def summary(self) -> Rows:
        """The most important numbers of the report."""
        return summary(self.report)[1]

    def _title(self) -> str:
        return f"{self._name()}: {summary(self.report)[0]}"

    def _repr_html_(self) -> str:
        heading, rows = summary(self.report)
        return notebook.scene_html(self._name(), [("", heading), *rows], self._scene())

    def _name(self) -> str:
        file = (self.report.get("mesh") or {}).get("file")
        return f"Scan of {file}" if file else "Scan"

    @property
    def _place(self) -> Path:
        assert self.folder is not None
        return self.folder

    @cached_property
    def _files(self) -> Scene:
        return scene_of_folder(self._place, self.report, "mm")

    def _scene(self) -> Scene:
        if self.analysis is not None:
            return pipeline.to_scene(self.analysis)
        scene, mesh = self._files, find_truth(self._place, self.report)
        if mesh is None:
            return scene
        return dataclasses.replace(scene, truth=load_mesh(mesh, hull=of_hull(self.report), unit=scene.unit))


class Scanned(Result):
    """The results of a scan of a mesh, with which the surface was compared."""

    @cached_property
    def comparison(self) -> Comparison:
        """The distances between the surface and the mesh.  Raises NoBodyError as `surface`."""
        if (found := super().comparison) is None:
            raise NoBodyError(self.report["surface"]["reason"])
        return found


@shows_settings
def scan(
    mesh: str | os.PathLike[str] | trimesh.Trimesh,
    out: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    **settings: Unpack[Given],
) -> Scanned:
    """Scan a body: simulate its recording, reconstruct contacts and surface, certify and compare them.

    mesh
        path of a mesh file (STL, PLY, OBJ, OFF or GLB), or a `trimesh.Trimesh`, in the unit of the setting ``unit``.
    out
        folder for the results, as ``scan3d scan`` writes them; None: nothing is written, and `Result.save` does so later.
    overwrite
        whether files in the folder that the program did not write may be replaced.
    progress
        called with how many slices, sweeps or planes of probings are done, and of how many.

    The same mesh and settings give the same results as the command, byte for byte apart from times.

    Raises InputError for unknown settings and values out of range, for a mesh that can't be read or is not closed,
    and if the folder can't be written into.
    """
    chosen = chosen_settings(settings, source="scan3d.scan")
    place = None if out is None else Path(out)
    with counted(progress):
        analysis, data = pipeline.scan(mesh, chosen, place, overwrite=overwrite)
    return Scanned(data, analysis)


def open(folder: str | os.PathLike[str]) -> Result:
    """The results in a folder of ``scan3d scan``, ``scan3d reconstruct``, a batch, or `Result.save`.

    The report is read at once, everything else when it is asked for.  Raises InputError if the folder holds no results, or a
    report that can't be read.
    """
    path = Path(folder)
    if not path.is_dir():
        raise InputError(f"there is no folder {path}; name one that scan3d scan has written")
    data = read_report(path)
    if not data:
        raise InputError(f"{path} holds no {REPORT}, so it is no scan; name a folder that scan3d scan has written")
    return Result(data, folder=path)


DEMO = Path(__file__).with_name("egg.glb")
"""The body of the demonstration, that of ``meshes/egg.stl`` with fewer facets."""
_WANTED = f"expected a scan's folder, or a surface or mesh file (.{', .'.join(FORMATS)})"


def read_report(folder: Path) -> Mapping[str, Any]:
    """A scan's report.json; empty if the file does not exist, or is of another program.

    Raises InputError if it can't be read, or was edited so that it can't be shown.
    """
    data, path = whole.read_report(folder), folder / REPORT
    whole.check_finished(folder)
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


def scene_of_folder(folder: Path, report: Mapping[str, Any], unit: str) -> Scene:
    """The scene in a scan's folder, without the truth.

    Raises InputError if the folder holds neither cloud nor surface, or files that do not belong to its report.
    """
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


def read_scene(path: Path, unit: str) -> tuple[Scene, Mapping[str, Any]]:
    """The scene in a scan's folder, with the report there, of a cloud or a surface in a PLY, or of a mesh."""
    if path.is_dir():
        report = read_report(path)
        return scene_of_folder(path, report, unit), report
    scene = read_ply_scene(path, unit) if path.suffix.lower() == ".ply" else None
    return scene or Scene(path.stem, unit, surface=read_mesh(path, unit)), {}


def of_hull(report: Mapping[str, Any]) -> bool:
    """Whether a report's true body is the convex hull of the mesh that it names."""
    return bool((report.get("mesh") or {}).get("hull"))


def find_truth(folder: Path, report: Mapping[str, Any]) -> Path | None:
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
                return path
    return None


def read_ply_scene(path: Path, unit: str) -> Scene | None:
    """The scene in a PLY: a cloud, or a surface as `scan` writes it with its bound; None for other PLYs with faces.

    Raises InputError for files that can't be read, and for points that are missing or not finite.
    """
    try:
        rows, faces, comments = read_ply(path)
    except InputError:
        return None  # the reader of meshes says what is wrong
    stated = [line.removeprefix("unit ") for line in comments if line.startswith("unit ")]
    if not stated:  # of another program, whose clouds may declare no faces
        if faces is not None and len(faces):
            return None
        rows, faces = rows[[name for name in POINT + NORMAL if name in (rows.dtype.names or ())]], None
    if not {*POINT} <= {*(rows.dtype.names or ())}:
        raise InputError(f"{path.name} has no points: expected the columns x, y and z")
    if not len(rows) or not np.isfinite(columns(rows, *POINT)).all():
        raise InputError(f"{path.name} has no points, or points that are not numbers; expected a cloud of contacts")
    unit = stated[0] if stated and stated[0] in UNITS_M else unit
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
    if not path.is_dir() and path.suffix[1:].lower() not in FORMATS:
        raise InputError(f"{path} has no surface to compare with: {_WANTED}")
    scene, _ = read_scene(path, unit)
    if scene.surface is None:
        raise InputError(f"{path} has no surface to compare with, but contacts only: {_WANTED}")
    return scene.surface, scene.unit
