"""The results of a scan: `Result` is what was just computed, or what a folder holds.

Folders, clouds, surfaces and files of other programs are read back as scenes, to be shown and compared.
"""

from __future__ import annotations

import dataclasses
import io
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.exchange.load import mesh_loaders

from scan3d import pipeline
from scan3d.bounds import Certificate
from scan3d.choices import Color, View
from scan3d.cloud import Cloud
from scan3d.comparison import Comparison
from scan3d.errors import InputError
from scan3d.files import whole
from scan3d.files.meshes import FORMATS, judge_mesh, load_mesh, read_mesh
from scan3d.files.recordings import read_recording
from scan3d.files.shapes import NORMAL, POINT, read_ply, table
from scan3d.files.text import check_readable
from scan3d.files.whole import RECORDING, REPORT, RESULTS, SCHEMA, check_belongs, locate, replacing, sha256
from scan3d.pictures import notebook
from scan3d.pictures.figures import sheet
from scan3d.pictures.parts import Scene, columns
from scan3d.reconstruction import reconstruct
from scan3d.recording import Recording
from scan3d.report import Analysis, key_figures, summary
from scan3d.settings import Given, shows_settings
from scan3d.settings import settings as chosen_settings
from scan3d.shown import Rows, Shown, described
from scan3d.simulation.scan import Progress
from scan3d.units import UNITS_M

if TYPE_CHECKING:
    from PIL.Image import Image


@dataclass(frozen=True, repr=False, eq=False)
class Result(Shown):
    """The results of `scan3d.scan`, or those in a folder, of which `scan3d.open` reads each when it is first asked for."""

    report: Mapping[str, Any]
    """The numbers of ``report.json``."""
    analysis: Analysis | None = None
    """All that was computed, with the enclosure, the true body and the time of each step; None for what was read."""
    folder: Path | None = None
    """Where the results were read; None for what was computed."""

    @cached_property
    def recording(self) -> Recording:
        """The log of poses and wrenches.

        Raises InputError if the folder has none, or one of another run.
        """
        if self.analysis is not None:
            return self.analysis.recording
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
        """The contacts; those of a folder are reconstructed from its recording: ``cloud.ply`` holds a part of them.

        Raises InputError as `recording`, and if they are not those of ``cloud.ply``, which another version has written.
        """
        if self.analysis is not None:
            return self.analysis.cloud
        cloud, rows = reconstruct(self.recording, model=self.report.get("model")), self._files.contacts
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
        return cloud

    @cached_property
    def surface(self) -> trimesh.Trimesh:
        """The closed surface, with its method in `metadata`.  Raises InputError if the folder has none."""
        if self.analysis is not None:
            return self.analysis.surface
        mesh = self._files.surface
        if mesh is None:
            raise InputError(f"{self.folder} has no surface.ply; run the scan again")
        known = self.report.get("surface") or {}
        mesh.units = self._files.unit
        if self._files.bound is not None:
            mesh.vertex_attributes["bound"] = np.asarray(self._files.bound, dtype=float)
        mesh.metadata.update({name: known.get(name) for name in ("method", "reason")})
        return mesh

    @cached_property
    def certificate(self) -> Certificate:
        """How far the surface can be from the body, from touch alone; local bounds of a folder are rounded to 24 bits."""
        if self.analysis is not None:
            return self.analysis.certificate
        bound, local = (self.report.get("certificate") or {}).get("bound"), self._files.bound
        unknown = np.full(len(self.surface.vertices), np.inf)
        scanned = (self.report.get("mesh") or {}).get("scanned", "mesh")
        return Certificate(
            np.inf if bound is None else float(bound),
            unknown if local is None else np.asarray(local, float),
            "body" if scanned == "mesh" else scanned,
        )

    @cached_property
    def comparison(self) -> Comparison | None:
        """The distances between the surface and the mesh; None if the scan was made without one.

        Raises InputError if an earlier version has written the report, which does not hold them.
        """
        if self.analysis is not None:
            return self.analysis.comparison
        if self.report.get("mesh") is None:
            return None
        known = self.report.get("comparison")
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
            settings = self.report["settings"]
            pipeline.write(self.analysis, Path(folder), settings=settings, overwrite=overwrite)
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
            body = load_mesh(truth, hull=True, unit=scene.unit) if is_path else judge_mesh(truth, hull=True)
            scene = dataclasses.replace(scene, truth=body)
        other = None if against is None else other_surface(against, scene.unit)
        return notebook.scene_image(scene, view, color, drawn, against=other, path=path, overwrite=overwrite)

    def summary(self) -> Rows:
        """The most important numbers of the report."""
        return summary(self.report)[1]

    def __repr__(self) -> str:
        heading, rows = summary(self.report)
        return described(f"{self._name()}: {heading}", rows)

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
        mesh = find_truth(self._place, self.report)
        hull = bool((self.report.get("mesh") or {}).get("hull"))
        return dataclasses.replace(
            self._files, truth=None if mesh is None else load_mesh(mesh, hull=hull, unit=self._files.unit)
        )


@shows_settings
def scan(
    mesh: str | os.PathLike[str] | trimesh.Trimesh,
    out: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    **settings: Unpack[Given],
) -> Result:
    """Scan a body: simulate its recording, reconstruct contacts and surface, certify and compare them.

    mesh
        path of a mesh file (STL, PLY, OBJ, OFF or GLB), or a `trimesh.Trimesh`, in the unit of the setting ``unit``.
    out
        folder for the results, as ``scan3d scan`` writes them; None: nothing is written, and `Result.save` does so later.
    overwrite
        whether files in the folder that the program did not write may be replaced.
    progress
        called with the numbers of slices that are done and of all slices.

    The same mesh and settings give the same results as the command, byte for byte apart from times.

    Raises InputError for unknown settings and values out of range, for a mesh that can't be read or is not closed,
    and if the folder can't be written into.
    """
    chosen = chosen_settings(settings, source="scan3d.scan")
    place = None if out is None else Path(out)
    analysis, data = pipeline.scan(mesh, chosen, place, overwrite=overwrite, progress=progress)
    return Result(data, analysis)


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
        check_readable(path)
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
