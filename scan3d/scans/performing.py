"""A whole scan in one function: what the command ``scan3d scan``, `scan3d.scan` and the runs of a batch have in common."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from scan3d import workflow
from scan3d.cloud import Cloud
from scan3d.files.meshes import judge_mesh, load_mesh
from scan3d.files.whole import Inputs, replacing
from scan3d.pictures.drawing import Drawing
from scan3d.pictures.scene import of_cloud
from scan3d.recording import Recording
from scan3d.report import Analysis, report
from scan3d.settings import Settings
from scan3d.simulation.scan import Progress, simulate_judged
from scan3d.surfaces.open3d_methods import check_method


def perform(
    mesh: Any,
    chosen: Settings,
    out: str | Path | None = None,
    *,
    inputs: Inputs | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    notify: Callable[[str], None] = lambda _: None,
    step: workflow.Step = lambda _: None,
) -> tuple[Analysis, dict[str, Any]]:
    """Simulate a scan of a mesh, analyse it, and write the results into the folder `out`: the analysis and its report.

    mesh
        path of a mesh file, or a `trimesh.Trimesh`.
    out
        the folder; None: nothing is written.
    inputs, overwrite, notify
        as in `workflow.write` and `files.whole.replacing`: what the run reads besides the mesh, whether files that the program
        did not write may be replaced, and what is called with a sentence if
        pictures cannot be rendered.
    progress, step
        called with the numbers of slices that are done and of all slices; and with the name of each step when it begins.

    Raises InputError as `load_mesh`, `simulate`, `workflow.analyse` and `workflow.write`.
    """
    check_method(chosen.method)
    plan, start = chosen.plan(), time.perf_counter()
    step("load")
    body = _loaded(mesh, chosen)
    seconds = {"load": time.perf_counter() - start}

    def analysed(made: Callable[[Cloud, Any], None] = lambda _, __: None) -> Analysis:
        step("simulate")
        begin = time.perf_counter()
        recording = with_origin(simulate_judged(body, plan, progress), body)
        seconds["simulate"] = time.perf_counter() - begin
        return workflow.analyse(recording, body, chosen.method, step=step, made=made)

    values = dataclasses.asdict(chosen)
    if out is None:
        found = analysed()
        times = {**seconds, **found.seconds}
        return found, report(found, settings=values, friction_set=chosen.friction, timings_s=times)
    read = {**({"mesh": mesh} if _is_path(mesh) else {}), **(inputs or {})}
    with replacing(out, with_recording=True, inputs=read, overwrite=overwrite) as result, Drawing() as drawing:

        def draw(cloud: Cloud, surface: Any) -> None:
            """Contacts and surface are drawn while the surface is certified and compared; pictures show neither."""
            drawing.begin(of_cloud(cloud, surface=surface, truth=body), workflow.jobs())

        analysis = analysed(draw)
        return analysis, workflow.write(
            analysis,
            result,
            settings=values,
            with_recording=True,
            seconds=seconds,
            notify=notify,
            drawing=drawing,
            step=step,
        )


def _is_path(mesh: Any) -> bool:
    return isinstance(mesh, (str, os.PathLike))


def _loaded(mesh: Any, chosen: Settings) -> Any:
    """The body of a file or of a `trimesh.Trimesh`, judged by the settings."""
    load = load_mesh if _is_path(mesh) else judge_mesh
    return load(mesh, hull=chosen.hull, clip_dent=chosen.clip_dent)


def with_origin(recording: Recording, body: Any) -> Recording:
    """The recording, with the hash of its mesh, and the name of its file if there is one, added to the source."""
    origin = {"mesh_sha256": body.metadata["sha256"]}
    if "file" in body.metadata:
        origin = {"mesh": body.metadata["file"], **origin}
    return dataclasses.replace(recording, source={**recording.source, **origin})
