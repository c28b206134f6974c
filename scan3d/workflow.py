"""From a recording to results: `analyse` computes, `write` writes them into a folder."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from scan3d.comparison import compare
from scan3d.errors import InputError
from scan3d.files.atomic import atomic, write_atomic
from scan3d.files.ply import ply
from scan3d.files.recordings import write_recording
from scan3d.files.tables import cloud_table, surface_table
from scan3d.files.text import to_json
from scan3d.geometry.distance import distances
from scan3d.pictures import page, rendering, views
from scan3d.pictures.scene import Scene, of_cloud
from scan3d.pictures.words import key_figures
from scan3d.reconstruction import cause_of_no_contact, contradictions, reconstruct
from scan3d.recording import Recording
from scan3d.report import Analysis, report
from scan3d.surfaces import certificate, enclosure, surface, withdrawn

# Files that `write` replaces in a folder.
_RESULTS = ("cloud.ply", "surface.ply", "report.json", "cloud.png", "surface.png", "view.html")
_RECORDING = ("recording.csv", "recording.toml")


def analyse(recording: Recording, truth: Any = None, method: str = "auto") -> Analysis:
    """Contacts, bounds, surface and certificate of a recording, and the comparison with the truth if that is given.

    truth
        the true body, a convex `trimesh.Trimesh`; only the results that compare with it depend on it.
    method
        the method of the surface, as in `scan3d.surface`.

    Where the recording contradicts the model, the analysis has warnings and no certificate.  Writes and prints nothing.  Raises
    InputError as `scan3d.reconstruct`, `scan3d.surface` and `scan3d.compare`.
    """
    clock = _Clock()
    with clock("reconstruct"):
        try:
            cloud = reconstruct(recording)
        except InputError as error:
            raise InputError(f"{error}{cause_of_no_contact(recording)}") from error
    with clock("check"):
        warnings = tuple(contradictions(recording, cloud))
    with clock("bounds"):
        bounds = enclosure(cloud)
    with clock("surface"):
        # a hull is only taken as proven where the recording agrees with the model
        known = replace(bounds, bound=np.inf) if warnings else bounds
        mesh = surface(cloud, method, bounds=known)
    with clock("certificate"):
        if warnings:
            bounds, certified = withdrawn(bounds, mesh)
        else:
            certified = certificate(bounds, mesh)
    analysis = Analysis(recording, cloud, bounds, mesh, certified, seconds=clock.seconds, warnings=warnings)
    if truth is None:
        return analysis
    with clock("compare"):
        return replace(
            analysis,
            truth=truth,
            contact_error=distances(cloud.points, truth),
            comparison=compare(mesh, truth),
            hull_error=compare(bounds.inner, truth).hausdorff,
        )


def write(
    analysis: Analysis,
    folder: Path,
    *,
    settings: Mapping[str, Any],
    with_recording: bool,
    seconds: Mapping[str, float] | None = None,
    notify: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Write an analysis into a folder that exists: cloud, surface, pictures, page and report, which is returned.

    settings
        those of the run, which the report repeats.
    with_recording
        whether the recording is written as well, as for a simulated one.
    seconds
        time spent on steps before the analysis, for the report.
    notify
        called with a sentence if pictures cannot be rendered.
    """
    clock = _Clock({**(seconds or {}), **analysis.seconds})
    for name in _RESULTS:
        (folder / name).unlink(missing_ok=True)
    files = ["cloud.ply", "surface.ply"]
    cloud, mesh, comments = analysis.cloud, analysis.surface, (f"unit {analysis.cloud.unit}",)
    with clock("write"):
        if with_recording:
            write_recording(analysis.recording, folder / _RECORDING[0])
            files = [*_RECORDING, *files]
        write_atomic(folder / "cloud.ply", ply(cloud_table(cloud, analysis.contact_error), comments=comments))
        vertices = surface_table(mesh, analysis.certificate.at_vertices)
        write_atomic(folder / "surface.ply", ply(vertices, mesh.faces, comments=comments))
    friction = settings.get("friction") if with_recording else None
    with clock("pictures"):
        figures = key_figures(report(analysis, settings=settings, friction_set=friction))
        files += _draw(to_scene(analysis, figures), folder, notify)
    data = report(
        analysis,
        settings=settings,
        friction_set=friction,
        timings_s=clock.seconds,
        files=[*files, "report.json"],
    )
    if analysis.truth is not None:
        # by this path `scan3d show` finds the mesh
        with suppress(ValueError):  # on another drive
            data["mesh"]["path"] = os.path.relpath(analysis.truth.metadata["path"], folder.resolve())
    write_atomic(folder / "report.json", to_json(data))
    return data


def to_scene(analysis: Analysis, figures: tuple[tuple[str, str], ...] = ()) -> Scene:
    """The scene of an analysis, to be drawn; `figures` are its key figures, as pairs of name and value."""
    local = analysis.certificate.at_vertices
    return of_cloud(
        analysis.cloud,
        analysis.contact_error,
        name=_name(analysis),
        surface=analysis.surface,
        bound=local.astype(np.float32) if np.isfinite(local).any() else None,
        truth=analysis.truth,
        recording=analysis.recording,
        key_figures=figures,
    )


def _name(analysis: Analysis) -> str:
    """The name of the body in pictures: that of its mesh file, or of the mesh file that the recording's source names."""
    named = analysis.recording.source.get("mesh") if analysis.truth is None else analysis.truth.metadata.get("file")
    return Path(str(named)).stem if named else "body"


def _draw(scene: Scene, folder: Path, notify: Callable[[str], None]) -> list[str]:
    """Write the page and, where they can be rendered, the pictures; returns the names of the files."""
    write_atomic(folder / "view.html", page.page(scene))
    if not rendering.can_render():
        notify(rendering.NO_RENDERER)
        return ["view.html"]
    for view in ("cloud", "surface"):
        with atomic(folder / f"{view}.png") as picture:
            views.picture(scene, picture, view)
    return ["view.html", "cloud.png", "surface.png"]


class _Clock:
    """Seconds spent on each step, by name."""

    def __init__(self, seconds: Mapping[str, float] | None = None) -> None:
        self.seconds: dict[str, float] = dict(seconds or {})

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start
