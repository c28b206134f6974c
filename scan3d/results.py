"""The results of a scan: `Result` is what was just computed, or what a folder holds.

Folders, clouds, surfaces and files of other programs are read back as scenes, to be shown and compared.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
import trimesh

from scan3d import pipeline
from scan3d.bounds import Certificate
from scan3d.choices import Color, View
from scan3d.cloud import Cloud
from scan3d.comparison import Comparison
from scan3d.errors import InputError
from scan3d.files.meshes import judge_mesh, load_mesh
from scan3d.files.recordings import read_recording
from scan3d.files.whole import RECORDING, REPORT, RESULTS, check_belongs, locate, replacing
from scan3d.pictures import notebook
from scan3d.pictures.scene import Scene, columns
from scan3d.pictures.sheet import sheet
from scan3d.reconstruction import reconstruct
from scan3d.recording import Recording
from scan3d.report import Analysis, summary
from scan3d.scenes import find_truth, other_surface, read_report, scene_of_folder
from scan3d.settings import Given, shows_settings
from scan3d.settings import settings as chosen_settings
from scan3d.shown import Rows, Shown, described
from scan3d.simulation.scan import Progress

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
                f"{self.folder} has no {RECORDING[0]}, which results have; make them again with scan3d scan or reconstruct"
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
                    f"the recording in {self.folder} gives other contacts than cloud.ply has, which was written by scan3d "
                    f"{(self.report.get('versions') or {}).get('scan3d', 'of another version')}; run the scan again"
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
                f"{self._place / REPORT} does not hold the comparison with the mesh: an earlier version has written it; "
                "run the scan again, or use scan3d.compare"
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
