"""From a recording to results: `analyse` computes, `write` writes them into a folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from scan3d.bounds import certificate, enclosure, withdrawn
from scan3d.cloud import Cloud
from scan3d.comparison import compare, compare_all
from scan3d.errors import InputError
from scan3d.files.meshes import mesh_itself
from scan3d.files.ply import ply
from scan3d.files.recordings import recording_files
from scan3d.files.tables import cloud_table, surface_table
from scan3d.files.whole import RECORDING, Replacement, replacing
from scan3d.pictures import page, rendering
from scan3d.pictures.drawing import Drawing, DrawingError, Job
from scan3d.pictures.scene import Scene, of_cloud
from scan3d.pictures.words import key_figures
from scan3d.reconstruction import NoContactError, cause_of_no_contact, checked, reconstruct
from scan3d.recording import Recording
from scan3d.report import Analysis, report
from scan3d.surfaces import surface

PICTURES = ("cloud", "surface")
"""The views of the pictures that `write` puts into a folder."""
Step = Callable[[str], None]
"""Is called with the name of each step when it begins; the names are those of `timings_s` in the report."""


def analyse(
    recording: Recording,
    truth: Any = None,
    method: str = "auto",
    model: str | None = None,
    step: Step = lambda _: None,
    made: Callable[[Cloud, Any], None] = lambda _, __: None,
) -> Analysis:
    """Contacts, bounds, surface and certificate of a recording, and the comparison with the truth if that is given.

    truth
        the true body, a convex `trimesh.Trimesh`; only the results that compare with it depend on it.
    method
        the method of the surface, as in `scan3d.surface`.
    model
        the model of contact, as in `scan3d.reconstruct`: spatial for six-axis recordings unless it is given.
    step
        is called with the name of each step when it begins.
    made
        is called with the contacts and the surface, as soon as both are known.

    Where the recording contradicts the model, the analysis has warnings and no certificate.  Writes and prints nothing.  Raises
    InputError as `scan3d.reconstruct`, `scan3d.surface` and `scan3d.compare`.
    """
    clock = _Clock(step=step)
    with clock("reconstruct"):
        try:
            cloud = reconstruct(recording, model=model)
        except NoContactError as error:
            raise InputError(f"{error}{cause_of_no_contact(recording)}") from error
    with clock("check"):
        warnings, diagnosis = checked(recording, cloud)
    with clock("bounds"):
        bounds = enclosure(cloud)
    with clock("surface"):
        # a hull is only taken as proven where the recording agrees with the model
        known = replace(bounds, bound=np.inf) if warnings else bounds
        mesh = surface(cloud, method, bounds=known)
        mesh.units = cloud.unit
    made(cloud, mesh)
    with clock("certificate"):
        if warnings:
            bounds, certified = withdrawn(bounds, mesh)
        else:
            certified = certificate(bounds, mesh)
    mesh.vertex_attributes["bound"] = certified.at_vertices
    analysis = Analysis(
        recording, cloud, bounds, mesh, certified, seconds=clock.seconds, warnings=tuple(warnings), diagnosis=diagnosis
    )
    if truth is None:
        return analysis
    with clock("compare"):
        return _compared(analysis, truth)


def _compared(analysis: Analysis, truth: Any) -> Analysis:
    """An analysis with all that is compared with the true body."""
    comparison, hull_error, contact_error = compare_all(
        analysis.surface, analysis.bounds.inner, analysis.cloud.points, truth
    )
    itself = mesh_itself(truth)
    return replace(
        analysis,
        truth=truth,
        mesh_comparison=None if itself is None else compare(analysis.surface, itself),
        contact_error=contact_error,
        comparison=comparison,
        hull_error=hull_error,
    )


def write(
    analysis: Analysis,
    folder: str | Path | Replacement,
    *,
    settings: Mapping[str, Any],
    with_recording: bool,
    seconds: Mapping[str, float] | None = None,
    notify: Callable[[str], None] = lambda _: None,
    overwrite: bool = False,
    drawing: Drawing | None = None,
    step: Step = lambda _: None,
) -> dict[str, Any]:
    """Write an analysis into a folder: cloud, surface, pictures, page and report, which is returned.

    All files appear together: an earlier result in the folder stays as it is until the new one is complete.

    folder
        its path, or the result that `files.whole.replacing` has opened there.
    settings
        those of the run, which the report repeats.
    with_recording
        whether the recording is written as well, as for a simulated one.
    seconds
        time spent on steps before the analysis, for the report.
    notify
        called with a sentence if pictures cannot be rendered.
    overwrite
        whether files that the program did not write may be replaced.
    drawing
        the child process that draws; by default one that is started here.  It is ended.
    step
        is called with the name of each step when it begins.

    Raises InputError if the folder can't be written into, or if a file would be replaced that must not be.
    """
    if not isinstance(folder, Replacement):
        with replacing(folder, with_recording=with_recording, overwrite=overwrite) as result:
            rest: dict[str, Any] = {"seconds": seconds, "notify": notify, "drawing": drawing}
            return write(analysis, result, settings=settings, with_recording=with_recording, step=step, **rest)
    clock = _Clock({**(seconds or {}), **analysis.seconds}, step)
    friction = settings.get("friction") if with_recording else None
    with drawing or Drawing() as child:
        with clock("write"):
            _put_tables(analysis, folder, with_recording)
        with clock("pictures"):
            figures = key_figures(report(analysis, settings=settings, friction_set=friction))
            _draw(to_scene(analysis, figures), folder, child, notify)
    data = report(analysis, settings=settings, friction_set=friction, timings_s=clock.seconds)
    return folder.commit(data)


def _put_tables(analysis: Analysis, result: Replacement, with_recording: bool) -> None:
    """Add the recording, if it is wanted, the cloud and the surface to a result."""
    cloud, mesh, comments = analysis.cloud, analysis.surface, (f"unit {analysis.cloud.unit}",)
    if with_recording:
        for name, data in recording_files(analysis.recording, RECORDING[0]).items():
            result.put(name, data)
    result.put("cloud.ply", ply(cloud_table(cloud, analysis.contact_error), comments=comments))
    vertices = surface_table(mesh, analysis.certificate.at_vertices)
    result.put("surface.ply", ply(vertices, mesh.faces, comments=comments))


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


def jobs() -> list[Job]:
    """What is drawn for a folder."""
    return [(".png", {"view": name}) for name in PICTURES]


def _draw(scene: Scene, result: Replacement, drawing: Drawing, notify: Callable[[str], None]) -> None:
    """Add the page and, where they can be rendered, the pictures to a result."""
    if not drawing.has_begun:  # while the page is made
        drawing.begin(scene, jobs())
    result.put("view.html", page.page(scene))
    try:
        pictures = drawing.finish()
    except rendering.NoRendererError as error:
        notify(str(error))
        return
    except DrawingError as error:
        notify(f"no pictures: {error}; all other files are written")
        return
    for name, data in zip(PICTURES, pictures, strict=True):
        result.put(f"{name}.png", data)


class _Clock:
    """Seconds spent on each step, by name; `step` is told when one begins."""

    def __init__(self, seconds: Mapping[str, float] | None = None, step: Step = lambda _: None) -> None:
        self.seconds: dict[str, float] = dict(seconds or {})
        self._step = step

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        self._step(name)
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
