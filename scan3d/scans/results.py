"""The results of a scan: of one that was just made, and of one in a folder."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scan3d import workflow
from scan3d.choices import Color, View
from scan3d.cloud import Cloud
from scan3d.comparison import Comparison
from scan3d.errors import InputError
from scan3d.files.meshes import judge_mesh, load_mesh
from scan3d.files.recordings import read_recording
from scan3d.files.whole import RECORDING, REPORT, RESULTS, check_belongs, locate, replacing
from scan3d.pictures import notebook, stored
from scan3d.pictures.scene import Scene, columns
from scan3d.pictures.sheet import sheet
from scan3d.reconstruction import reconstruct
from scan3d.recording import Recording
from scan3d.report import Analysis
from scan3d.scans.others import other_surface
from scan3d.shown import Rows, Shown, described
from scan3d.summaries import summary
from scan3d.surfaces import Certificate

if TYPE_CHECKING:
    import trimesh
    from PIL.Image import Image

# Largest distance between the contacts of a stored cloud and those that its recording gives now, relative to the cloud's
# diagonal.  Larger, a recording of another scan could pass; smaller, rounding in another version of a library would not.
_SAME = 1e-6


class _Result(Shown):
    """What a scan that was just made and one read from a folder have in common: how they show themselves."""

    report: Mapping[str, Any]

    def _scene(self) -> Scene:
        raise NotImplementedError

    def _name(self) -> str:
        file = (self.report.get("mesh") or {}).get("file")
        return f"Scan of {file}" if file else "Scan"

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
        view
            one of `scan3d.choices.VIEWS`.
        color
            what contacts are coloured by in the view 'cloud', one of `scan3d.choices.COLORS`.
        size, dpi, camera, path, overwrite
            as in `scan3d.plot`: ``plot(size="85x60mm", dpi=600, camera="300,25", path="egg.pdf")`` also writes a file.

        Raises InputError for other values, and where nothing can be rendered.
        """
        drawn = sheet(size, dpi, camera)
        scene = self._scene()
        if truth is not None:
            is_path = isinstance(truth, (str, os.PathLike))
            body = load_mesh(truth, hull=True) if is_path else judge_mesh(truth, hull=True)
            scene = dataclasses.replace(scene, truth=body)
        other = None if against is None else other_surface(against, scene.unit)
        return notebook.scene_image(scene, view, color, drawn, against=other, path=path, overwrite=overwrite)

    def _repr_html_(self) -> str:
        heading, rows = summary(self.report)
        return notebook.scene_html(self._name(), [("", heading), *rows], self._scene())

    def summary(self) -> Rows:
        """The most important numbers of the report."""
        return summary(self.report).rows

    def __repr__(self) -> str:
        heading, rows = summary(self.report)
        return described(f"{self._name()}: {heading}", rows)


@dataclass(frozen=True, repr=False, eq=False)
class Scan(_Result):
    """The results of `scan3d.scan`."""

    analysis: Analysis
    """All that was computed, with the enclosure, the true body and the time of each step."""
    report: Mapping[str, Any]
    """The numbers of ``report.json``."""

    @property
    def recording(self) -> Recording:
        """The simulated log of poses and wrenches."""
        return self.analysis.recording

    @property
    def cloud(self) -> Cloud:
        """The contacts."""
        return self.analysis.cloud

    @property
    def surface(self) -> trimesh.Trimesh:
        """The closed surface, a `trimesh.Trimesh`."""
        return self.analysis.surface

    @property
    def certificate(self) -> Certificate:
        """How far the surface can be from the body, from touch alone."""
        return self.analysis.certificate

    @property
    def comparison(self) -> Comparison | None:
        """The distances between the surface and the mesh."""
        return self.analysis.comparison

    def save(self, folder: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the results into a folder, as ``scan3d scan`` does; files of others are replaced only with `overwrite`.

        Raises InputError as `scan3d.workflow.write`.
        """
        times = self.report["timings_s"]
        workflow.write(
            self.analysis,
            Path(folder),
            settings=self.report["settings"],
            with_recording=True,
            seconds={name: times[name] for name in ("load", "simulate")},
            overwrite=overwrite,
        )

    def _scene(self) -> Scene:
        return workflow.to_scene(self.analysis)


@dataclass(frozen=True, repr=False, eq=False)
class StoredScan(_Result):
    """The results in a folder, which `scan3d.open` returns; each is read when it is first asked for."""

    folder: Path
    report: Mapping[str, Any]
    """The numbers of ``report.json``."""

    @cached_property
    def recording(self) -> Recording:
        """The log of poses and wrenches.

        Raises InputError if the folder has none, as one of ``scan3d reconstruct``, or one of another run.
        """
        path = self.folder / RECORDING[0]
        if not locate(path).exists():
            raise InputError(
                f"{self.folder} has no {RECORDING[0]}: the scan was made from a recording elsewhere; read that with "
                "scan3d.read_recording"
            )
        check_belongs(self.folder, self.report, RECORDING)
        return read_recording(path)

    @cached_property
    def cloud(self) -> Cloud:
        """The contacts, reconstructed from the recording: ``cloud.ply`` holds a part of what belongs to them.

        Raises InputError as `recording`, and if they are not those of ``cloud.ply``, which another version has written.
        """
        cloud, stored_rows = reconstruct(self.recording, model=self.report.get("model")), self._files.contacts
        known = None if stored_rows is None else columns(stored_rows, "x", "y", "z")
        if known is not None:
            size = float(np.linalg.norm(np.ptp(known, axis=0)))
            if known.shape != cloud.points.shape or np.abs(known - cloud.points).max() > _SAME * size:
                raise InputError(
                    f"the recording in {self.folder} gives other contacts than cloud.ply has, which was written by scan3d "
                    f"{(self.report.get('versions') or {}).get('scan3d', 'of another version')}; run the scan again"
                )
        return cloud

    @cached_property
    def surface(self) -> trimesh.Trimesh:
        """The closed surface, a `trimesh.Trimesh`, with its method in `metadata`.  Raises InputError if the folder has none."""
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
        """How far the surface can be from the body, from touch alone; the local bounds are rounded to 24 bits."""
        bound, local = (self.report.get("certificate") or {}).get("bound"), self._files.bound
        unknown = np.full(len(self.surface.vertices), np.inf)
        return Certificate(
            np.inf if bound is None else float(bound), unknown if local is None else np.asarray(local, float)
        )

    @cached_property
    def comparison(self) -> Comparison | None:
        """The distances between the surface and the mesh; None if the scan was made without one.

        Raises InputError if an earlier version has written the report, which does not hold them.
        """
        if self.report.get("mesh") is None:
            return None
        known = self.report.get("comparison")
        names = {field.name for field in dataclasses.fields(Comparison)}
        if not isinstance(known, Mapping) or set(known) != names:
            raise InputError(
                f"{self.folder / REPORT} does not hold the comparison with the mesh: an earlier version has written it; "
                "run the scan again, or use scan3d.compare"
            )
        values: dict[str, Any] = {name: np.nan if value is None else value for name, value in known.items()}
        values["worst_point"] = np.array(known["worst_point"], dtype=float)
        return Comparison(**values)

    @cached_property
    def _files(self) -> Scene:
        """What cloud.ply and surface.ply hold."""
        return stored.of_folder(self.folder, self.report, "mm")

    def save(self, folder: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Copy the results into another folder, byte for byte; files of others are replaced only with `overwrite`.

        Raises InputError if a file is missing or was changed, and if the folder can't be written into.
        """
        names = [name for name in self.report.get("files", ()) if name in RECORDING + RESULTS and name != REPORT]
        check_belongs(self.folder, self.report, names)
        missing = [name for name in names if not locate(self.folder / name).is_file()]
        if missing:
            raise InputError(f"{self.folder} lacks {', '.join(missing)}, which its {REPORT} names; run the scan again")
        files = {name: locate(self.folder / name).read_bytes() for name in names}
        with replacing(Path(folder), with_recording=RECORDING[0] in files, overwrite=overwrite) as result:
            for name, data in files.items():
                result.put(name, data)
            result.commit(self.report)

    def _scene(self) -> Scene:
        mesh = stored.find_truth(self.folder, self.report)
        hull = bool((self.report.get("mesh") or {}).get("hull"))
        return dataclasses.replace(self._files, truth=None if mesh is None else load_mesh(mesh, hull=hull))
