"""The one way from a mesh or a recording to a result: data go forward, and each file is entered once.

`scan` simulates the recording of a mesh, `reconstruct` takes one that was read; both are analysed by `analyse`, and written
into a folder together with their report.
"""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from scan3d.bounds import bounding_nothing, certificate, enclosure, unbounded
from scan3d.bounds.reach import reach as within_reach
from scan3d.bounds.reach import too_fine
from scan3d.choices import NOT_CONVEX
from scan3d.cloud import Cloud
from scan3d.comparison import compare, compare_with_points
from scan3d.errors import InputError, NoBodyError
from scan3d.files.meshes import judge_mesh, load_mesh, mesh_itself
from scan3d.files.recordings import recording_files
from scan3d.files.shapes import cloud_table, ply, surface_table
from scan3d.files.whole import RECORDING, Inputs, Replacement, replacing, sha256
from scan3d.geometry.distance import distances
from scan3d.geometry.hulls import HULL_OF_MESH, is_convex
from scan3d.pictures import canvas, page
from scan3d.pictures.drawing import Drawing, DrawingError
from scan3d.pictures.parts import Scene, of_cloud, shown_surface
from scan3d.reconstruction import Contradiction, NoContactError, as_measured, cause_of_no_contact, checked
from scan3d.reconstruction import reconstruct as reconstruct_contacts
from scan3d.reconstruction.touches import contradictions
from scan3d.recording import Recording
from scan3d.report import Analysis, key_figures, report, rounded
from scan3d.settings import Settings
from scan3d.simulation.scan import simulate_judged
from scan3d.surfaces import surface
from scan3d.surfaces.any_shape import any_shape, shape_of_touches, with_estimated_normals, with_surface_normals
from scan3d.surfaces.open3d_methods import check_method
from scan3d.units import unit_question, unit_remark
from scan3d.workers import in_one_thread, said_if_ended, tell

Notify = Callable[[str], None]
"""Is called with a sentence on what a user should know, such as that pictures cannot be rendered."""


class Clock:
    """Seconds spent on each step, by name; that one begins is told (`workers.tell`)."""

    def __init__(self, seconds: Mapping[str, float] | None = None) -> None:
        self.seconds: dict[str, float] = dict(seconds or {})

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        tell(name)
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


@in_one_thread
def scan(
    mesh: Any,
    chosen: Settings,
    out: str | Path | None = None,
    *,
    inputs: Inputs | None = None,
    overwrite: bool = False,
    notify: Notify = lambda _: None,
) -> tuple[Analysis, dict[str, Any]]:
    """Simulate a scan of a mesh, analyse it, and write the results into the folder `out`: the analysis and its report.

    mesh
        path of a mesh file, or a `trimesh.Trimesh`.
    out
        the folder; None: nothing is written.
    inputs, overwrite
        as in `files.whole.replacing`: what the run reads besides the mesh, and whether files that the program did not write may
        be replaced.

    Raises InputError as `load_mesh`, `simulate`, `analyse` and `files.whole.replacing`.
    """
    check_method(chosen.method)
    plan, is_path = chosen.plan(), isinstance(mesh, (str, os.PathLike))

    def record(clock: Clock) -> tuple[Recording, Any]:
        with clock("load"):
            body = load_mesh(mesh, hull=chosen.hull, unit=plan.unit) if is_path else judge_mesh(mesh, hull=chosen.hull)
        if is_path and (question := unit_question(float(body.extents.max()), plan.unit)):
            notify(question)
        hollow = chosen.reach and not is_convex(body)
        if hollow and (why := too_fine(body.vertices, chosen.reach, 0.0, plan.unit)):
            notify(f"the reach will bound nothing: {why}")
        with clock("simulate"):
            return with_origin(simulate_judged(body, plan), body), body

    read = {**({"mesh": mesh} if is_path else {}), **(inputs or {})}
    settings = dataclasses.asdict(chosen)
    if out is None:
        clock = Clock()
        analysis = analyse(*record(clock), chosen.method, reach=chosen.reach, clock=clock)
        return analysis, report(analysis, settings=settings)
    with replacing(out, inputs=read, overwrite=overwrite) as result:
        return _performed(record, result, settings, chosen.method, None, notify)


@in_one_thread
def reconstruct(
    read: Callable[[], tuple[Recording | Cloud, Any]],
    out: str | Path,
    *,
    settings: Mapping[str, Any],
    model: str | None = None,
    inputs: Inputs | None = None,
    overwrite: bool = False,
    notify: Notify = lambda _: None,
) -> tuple[Analysis, dict[str, Any]]:
    """Analyse a recording or touches of another probe, and write the results into the folder `out`: analysis and report.

    read
        gives the recording, or the cloud of touches, whose files are the inputs ``touches ...``, and the true body, or None.
    settings
        those of the run, with the ``method`` of the surface, which the report repeats.

    Raises InputError as `read`, `analyse` and `files.whole.replacing`.
    """

    def record(clock: Clock) -> tuple[Recording | Cloud, Any]:
        with clock("load"):
            return read()

    with replacing(out, inputs=inputs, overwrite=overwrite) as result:
        return _performed(record, result, settings, settings["method"], model, notify)


def _performed(
    record: Callable[[Clock], tuple[Recording | Cloud, Any]],
    result: Replacement,
    settings: Mapping[str, Any],
    method: str,
    model: str | None,
    notify: Notify,
) -> tuple[Analysis, dict[str, Any]]:
    """Record, analyse and write; contacts and surface are drawn while the surface is compared."""
    clock = Clock()
    with Drawing() as drawing:
        measured, truth = record(clock)
        files = {}
        if isinstance(measured, Recording) and not result.reads_recording:
            with clock("write"):
                files = recording_files(measured, RECORDING[0])
        touches = [Path(path) for name, path in result.inputs.items() if path and name.startswith("touches")]
        sources = [{"file": path.name, "sha256": sha256(path)} for path in touches]
        source = sources[0] | ({"further": sources[1:]} if len(sources) > 1 else {}) if sources else {}

        scenes: list[Scene] = []
        draw = partial(_begin, drawing, truth, scenes)
        reach, mesh = settings.get("reach", 0.0), result.inputs.get("mesh")
        options = [*(["--truth", str(mesh)] if mesh else []), *(["--hull"] if settings.get("hull") else [])]
        options += ["--method", method] * (method != "auto") + ["--reach", str(reach)] * (reach > 0)
        with result.kept(files, options) as how_to_go_on, said_if_ended(how_to_go_on):
            analysis = analyse(measured, truth, method, model, reach=reach, source=source, clock=clock, made=draw)
            bodies = ("surface", "true body")
            size = analysis.surface.extents  # None without a surface
            if truth is not None and size is not None and (remark := unit_remark(size, truth.extents, bodies)):
                notify(remark)
            return analysis, _put(analysis, result, files, settings, clock, drawing, scenes[0], notify)


def with_origin(recording: Recording, body: Any) -> Recording:
    """The recording, with the hash of its mesh, and the name of its file if there is one, added to the source."""
    origin = {"mesh_sha256": body.metadata["sha256"]}
    if "file" in body.metadata:
        origin = {"mesh": body.metadata["file"], **origin}
    return replace(recording, source={**recording.source, **origin})


@in_one_thread
def analyse(
    measured: Recording | Cloud,
    truth: Any = None,
    method: str = "auto",
    model: str | None = None,
    *,
    reach: float = 0.0,
    source: Mapping[str, Any] | None = None,
    clock: Clock | None = None,
    made: Callable[[Analysis], None] = lambda _: None,
) -> Analysis:
    """Contacts, bounds, surface and certificate, and the comparison with the truth if that is given.

    measured
        a recording, or the cloud of touches of another probe.
    truth
        the true body, a convex `trimesh.Trimesh`; only the results that compare with it depend on it.
    method, model, reach
        as in `scan3d.surface`, `scan3d.reconstruct` and `bounds.reach`; with the reach 0, not known, a bead alone bounds a body
        that is not convex.
    source
        where touches of another probe come from.
    made
        is called with the analysis as soon as surface and certificate are known.

    Where the recording contradicts the model, the analysis has warnings and no certificate; where the contacts span no body, it
    has neither surface nor certificate, and says why.  Writes and prints nothing.  Raises
    InputError as `scan3d.reconstruct`, `scan3d.surface` and `scan3d.compare`.
    """
    clock = clock or Clock()
    warnings: Sequence[Contradiction]
    recording, diagnosis = None, None
    if isinstance(measured, Cloud):
        with clock("check"):
            warnings = contradictions(measured)
            cloud = measured if measured.convex else with_estimated_normals(measured)
    else:
        recording = measured
        with clock("reconstruct"):
            try:
                cloud = reconstruct_contacts(recording, model=model)
            except NoContactError as error:
                raise InputError(f"{error}{cause_of_no_contact(recording)}") from error
        with clock("check"):
            warnings, diagnosis = checked(recording, cloud)
    try:
        bounded = _bounded(cloud, recording, warnings, method, reach, clock)
    except NoBodyError as error:
        bounded = _without_body(cloud, recording, warnings, str(error))
    of_touches = {"kind": "touches", **(source or {})}
    bounded = replace(bounded, diagnosis=diagnosis, source=recording.source if recording else of_touches)
    made(bounded)
    if truth is not None:
        with clock("compare"):
            bounded = _compared(bounded, truth)
    return replace(bounded, seconds=dict(clock.seconds))


def _bounded(
    cloud: Cloud,
    recording: Recording | None,
    warnings: Sequence[Contradiction],
    method: str,
    reach: float,
    clock: Clock,
) -> Analysis:
    """Bounds, surface and certificate of contacts; `recording` is what they were reconstructed from, if anything."""
    nothing = bool(warnings) or (recording is not None and bool(recording.untested))
    with clock("bounds"):
        bounds = enclosure(cloud) if cloud.convex else unbounded(cloud)
    found = reached = None
    with clock("surface"):
        if not cloud.convex:
            found = any_shape(*as_measured(recording, cloud)) if recording else shape_of_touches(cloud)
            mesh = found.surface if method == "auto" else surface(cloud, method)
        else:
            # a hull is only taken as proven where the recording agrees with the model
            known = replace(bounds, bound=np.inf) if nothing else bounds
            mesh = surface(cloud, method, bounds=known)
        mesh.units = cloud.unit
    if found is not None and cloud.probed is not None:
        cloud = with_surface_normals(cloud, found.surface)
    with clock("certificate"):
        if nothing or found is not None:
            bounds = bounding_nothing(bounds)
            certified = certificate(bounds, mesh)
            if recording and found is not None and not nothing and (reach or cloud.bead_radius):
                reached = within_reach(*as_measured(recording, cloud), reach, mesh)
                certified = certified._replace(bound=reached.bound)
        else:
            certified = certificate(bounds, mesh, convex=mesh.metadata["method"] not in NOT_CONVEX)
    if cloud.convex:
        mesh.vertex_attributes["bound"] = certified.at_vertices
    return Analysis(recording, cloud, bounds, mesh, certified, any_shape=found, reach=reached, warnings=tuple(warnings))


def _without_body(
    cloud: Cloud, recording: Recording | None, warnings: Sequence[Contradiction], reason: str
) -> Analysis:
    """The analysis of contacts that span no body, with the reason in the place of a surface."""
    nothing, bounds = trimesh.Trimesh(metadata={"method": None, "reason": reason}), unbounded(cloud)
    return Analysis(recording, cloud, bounds, nothing, certificate(bounds, nothing), warnings=tuple(warnings))


def _compared(analysis: Analysis, truth: Any) -> Analysis:
    if not analysis.has_surface:
        return replace(analysis, truth=truth, contact_error=distances(analysis.cloud.points, truth))
    within = 0.0 if analysis.any_shape is None else analysis.any_shape.apart
    comparison, contact_error, reached = compare_with_points(analysis.surface, analysis.cloud.points, truth, within)
    itself = mesh_itself(truth)
    return replace(
        analysis,
        truth=truth,
        certificate=analysis.certificate._replace(of=HULL_OF_MESH if "filled" in truth.metadata else "body"),
        mesh_comparison=None if itself is None else compare(analysis.surface, itself),
        contact_error=contact_error,
        comparison=comparison,
        reached=reached,
    )


def write(
    analysis: Analysis, folder: str | Path, *, settings: Mapping[str, Any], overwrite: bool = False
) -> dict[str, Any]:
    """Write an analysis into a folder: recording, cloud, surface, pictures, page, and the report, which is returned.

    The report repeats the settings; `overwrite` and what is raised are those of `files.whole.replacing`.
    """
    scenes: list[Scene] = []
    with replacing(folder, overwrite=overwrite) as result, Drawing() as drawing:
        _begin(drawing, analysis.truth, scenes, analysis)
        files = recording_files(analysis.recording, RECORDING[0]) if analysis.recording else {}
        return _put(analysis, result, files, settings, Clock(analysis.seconds), drawing, scenes[0], lambda _: None)


def _put(
    analysis: Analysis,
    result: Replacement,
    files: Mapping[str, bytes],
    settings: Mapping[str, Any],
    clock: Clock,
    drawing: Drawing,
    drawn: Scene,
    notify: Notify,
) -> dict[str, Any]:
    with clock("write"):
        for name, contents in files.items():
            result.put(name, contents)
        comments = (f"unit {analysis.cloud.unit}",)
        result.put("cloud.ply", ply(cloud_table(analysis.cloud, analysis.contact_error), comments=comments))
        proven = analysis.reach if analysis.reach and analysis.reach.refuted is None else None
        bodies = {"outer": proven.outer, "inner": proven.inner} if proven else {}
        for name, body in ({"surface": analysis.surface} | bodies).items():
            if len(body.faces):
                result.put(f"{name}.ply", ply(surface_table(body), body.faces, comments=comments))
    with clock("pictures"):
        data = report(analysis, settings=settings)
        scene = replace(to_scene(analysis, key_figures(data)), shown=drawn.shown)
        _put_pictures(scene, result, drawing, notify)
    return result.commit(data | {"timings_s": rounded(clock.seconds)})


def _put_pictures(scene: Scene, result: Replacement, drawing: Drawing, notify: Notify) -> None:
    result.put("view.html", page.page(scene))
    try:
        pictures = drawing.finish()
    except canvas.NoRendererError as error:
        notify(str(error))
        return
    except DrawingError as error:
        notify(f"no pictures: {error}; all other files are written")
        return
    for name, data in zip(_views(scene), pictures, strict=True):
        result.put(f"{name}.png", data)


def _views(scene: Scene) -> tuple[str, ...]:
    """The views of the pictures in a result's folder."""
    return ("cloud",) if scene.surface is None else ("cloud", "surface")


def _begin(drawing: Drawing, truth: Any, scenes: list[Scene], analysis: Analysis) -> None:
    """Begin the pictures of contacts and surface, whose scene is added to `scenes`.

    The distances of the surface from the truth are in it, which the page and the child that draws need both.
    """
    scene = to_scene(replace(analysis, truth=truth, recording=None))
    scenes.append(scene if scene.surface is None else replace(scene, shown=shown_surface(scene)))
    drawing.begin(scenes[0], [(".png", {"view": name}) for name in _views(scene)])


def to_scene(analysis: Analysis, figures: tuple[tuple[str, str], ...] = ()) -> Scene:
    """The scene of an analysis, to be drawn; `figures` are its key figures, as pairs of name and value."""
    named, truth = analysis.source.get("mesh") or analysis.source.get("file"), analysis.truth
    named = named if truth is None else truth.metadata.get("file")
    local = analysis.certificate.at_vertices
    return of_cloud(
        analysis.cloud,
        analysis.contact_error,
        name=Path(str(named)).stem if named else "body",
        surface=analysis.surface if analysis.has_surface else None,
        bound=local.astype(np.float32) if np.isfinite(local).any() else None,
        truth=truth,
        recording=analysis.recording,
        key_figures=figures,
    )
