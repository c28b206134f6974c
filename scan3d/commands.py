"""What the commands do.  Each takes plain values, writes its files whole, and returns what goes to stdout."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from scan3d.errors import InputError
from scan3d.files import folder, ply, to_json, whole, write_whole
from scan3d.settings import Settings, as_dict

Say = Callable[[str], None]
Progress = Callable[[str, int, int], None]

# Standard deviations by which noisy contacts may be off in the certificate.
_NOISE_SIGMAS = 4.0
# What `scan` and `reconstruct` may write into a folder besides their recording.
_RESULTS = ("cloud.ply", "surface.ply", "report.json", "cloud.png", "surface.png", "view.html")
_RECORDING = ("recording.csv", "recording.toml")


class _Clock:
    """Seconds spent, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start


def scan(mesh: str, out: str, settings: Settings, say: Say, progress: Progress) -> dict[str, Any]:
    """Simulate, reconstruct, surface, compare: everything, into a folder.  Returns the report."""
    from scan3d.bodies import load_mesh
    from scan3d.simulation import simulate

    plan = settings.plan()
    clock = _Clock()
    with clock("load"):
        body = load_mesh(mesh, hull=settings.hull)
    with folder(out) as place:
        with clock("simulate"):
            recording = simulate(body, plan, lambda done, of: progress("simulate", done, of))
        recording = dataclasses.replace(recording, source={**recording.source, **_origin(body)})
        return _results(recording, place, as_dict(settings), clock, say, body, simulated=True)


def simulate_only(mesh: str, out: str, settings: Settings, progress: Progress) -> dict[str, Any]:
    """Step 1 alone: a recording.  Returns its counts."""
    from scan3d.bodies import load_mesh
    from scan3d.recording import check_path, write_recording
    from scan3d.simulation import simulate

    check_path(out)
    plan = settings.plan()
    body = load_mesh(mesh, hull=settings.hull)
    with folder(Path(out).parent):
        recording = simulate(body, plan, lambda done, of: progress("simulate", done, of))
        write_recording(dataclasses.replace(recording, source={**recording.source, **_origin(body)}), out)
    return {"recording": str(out), "samples": len(recording), "sweeps": len(np.unique(recording.sweep))}


def reconstruct_only(recording: str, out: str, truth: str | None, settings: Settings, say: Say) -> dict[str, Any]:
    """Step 2 from a recording, with a comparison if the truth is given.  Returns the report."""
    from scan3d.bodies import load_mesh
    from scan3d.recording import read_recording

    clock = _Clock()
    with clock("load"):
        log = read_recording(recording)
        body = load_mesh(truth, hull=settings.hull) if truth else None
    # the other settings are those of a simulation
    used = {"method": settings.method, "hull": settings.hull}
    with folder(out) as place:
        return _results(log, place, used, clock, say, body, simulated=False)


def compare_files(first: str, second: str) -> Any:
    """Comparison of two mesh files, convex or not."""
    from scan3d.bodies import read_mesh
    from scan3d.comparison import compare

    return compare(read_mesh(first), read_mesh(second))


def show(
    path: str,
    tell: Say,
    *,
    truth: str | None = None,
    hull: bool = False,
    unit: str = "mm",
    view: str | None = None,
    color: str | None = None,
    movie_of: str = "sweep",
    screenshot: str | None = None,
    html: str | None = None,
    movie: str | None = None,
) -> dict[str, Any]:
    """Show a scan's folder, a recording, a cloud or a mesh: in the files that are named, or else in a window.

    `tell` gets what was felt at a contact that is clicked in the window.  Returns the files.
    """
    from scan3d import movies, pages, views, windows

    if not (screenshot or html or movie) and not windows.can_open():
        raise InputError(windows.NO_DISPLAY)
    # before the work
    if screenshot:
        views.check_path(screenshot)
    if movie:
        movies.check_path(movie)
    scene = _scene(Path(path), truth, hull, unit)
    files = []
    if html:
        write_whole(html, pages.page(scene))
        files.append(html)
    if movie:
        with whole(movie) as file:
            movies.movie(scene, file, movie_of)
        files.append(movie)
    if screenshot:
        with whole(screenshot) as file:
            views.picture(
                scene, file, view or ("cloud" if color or scene.surface is None else "surface"), color or "force"
            )
        files.append(screenshot)
    if not files:
        windows.open_window(scene, tell, color or "force")
    return {"shown": scene.name, "files": files}


def _scene(path: Path, truth: str | None, hull: bool, unit: str) -> Any:
    """What a path shows, with the true body if it is named or found."""
    from scan3d import scenes
    from scan3d.bodies import load_mesh, read_mesh

    if not path.exists():
        raise InputError(
            f"there is no {path}; show a scan's folder, a recording (.csv), a cloud or a surface (.ply), or a mesh"
        )
    if path.is_dir():
        report = scenes.read_report(path)
        scene = scenes.of_folder(path, report, unit)
        truth = truth or scenes.find_truth(path, report)
        hull = hull or bool((report.get("settings") or {}).get("hull"))
    elif path.suffix.lower() == ".csv":
        scene = _shown_recording(path)
    else:
        found = scenes.read_ply_scene(path, unit) if path.suffix.lower() == ".ply" else None
        scene = found or scenes.Scene(path.stem, unit, surface=read_mesh(path))
    return dataclasses.replace(scene, truth=load_mesh(truth, hull=hull)) if truth else scene


def _shown_recording(path: Path) -> Any:
    from scan3d import scenes, surfaces
    from scan3d.bracket import bracket, certificate
    from scan3d.reconstruction import reconstruct
    from scan3d.recording import read_recording

    recording = read_recording(path)
    cloud = reconstruct(recording)
    scene = scenes.of_cloud(cloud, name=path.stem, recording=recording)
    try:
        surface = surfaces.surface(cloud)
        bound = certificate(bracket(cloud, _NOISE_SIGMAS * cloud.noise), surface)[1]
    except InputError:  # contacts in one plane span no body, and are still worth a look
        return scene
    return dataclasses.replace(
        scene, surface=surface, bound=bound.astype(np.float32) if np.isfinite(bound).any() else None
    )


def _origin(body: Any) -> dict[str, Any]:
    return {"mesh": body.metadata["file"], "mesh_sha256": body.metadata["sha256"]}


def _results(
    recording: Any,
    place: Path,
    settings: Mapping[str, Any],
    clock: _Clock,
    say: Say,
    body: Any,
    *,
    simulated: bool,
) -> dict[str, Any]:
    """Cloud, surface, comparison, pictures and report of a recording, written into a folder, and the recording if simulated.

    Nothing is written before all is computed.
    """
    from scan3d import cloud as clouds
    from scan3d import reports, scenes, surfaces
    from scan3d.bracket import bracket, certificate
    from scan3d.comparison import compare, distances
    from scan3d.reconstruction import reconstruct
    from scan3d.recording import write_recording

    with clock("reconstruct"):
        cloud = reconstruct(recording)
    with clock("bracket"):
        inside = bracket(cloud, _NOISE_SIGMAS * cloud.noise)
    with clock("surface"):
        surface = surfaces.surface(cloud, settings["method"], found=None if cloud.noise else inside)
    with clock("certificate"):
        certified = certificate(inside, surface)
    error, found, hull_error = None, None, None
    if body is not None:
        with clock("compare"):
            error, found = distances(cloud.points, body), compare(surface, body)
            hull_error = compare(inside.inner, body).hausdorff

    for stale in _RESULTS:
        (place / stale).unlink(missing_ok=True)
    files = ["cloud.ply", "surface.ply"]
    comment = (f"unit {cloud.unit}",)
    with clock("write"):
        if simulated:
            write_recording(recording, place / _RECORDING[0])
            files = [*_RECORDING, *files]
        write_whole(place / "cloud.ply", ply(clouds.table(cloud, error), comments=comment))
        write_whole(place / "surface.ply", ply(surfaces.table(surface, certified[1]), surface.faces, comments=comment))
    report = partial(
        reports.report,
        settings=settings,
        recording=recording,
        cloud=cloud,
        surface=surface,
        certificate=certified,
        bracket=inside,
        mesh=body,
        contact_error=error,
        comparison=found,
        hull_error=hull_error,
        friction_set=settings["friction"] if simulated else None,
    )
    scene = scenes.of_cloud(
        cloud,
        error,
        name=_name(body, recording),
        surface=surface,
        bound=certified[1].astype(np.float32) if np.isfinite(certified[1]).any() else None,
        truth=body,
        recording=recording,
        figures=scenes.figures(report(timings_s={}, files=[])),
    )
    with clock("pictures"):
        files += _pictures(place, scene, say)
    data = report(timings_s=clock.seconds, files=[*files, "report.json"])
    if body is not None:
        # so that `show` finds it again
        with suppress(ValueError):  # on another drive
            data["mesh"]["path"] = os.path.relpath(body.metadata["path"], place.resolve())
    write_whole(place / "report.json", to_json(data))
    return data


def _name(body: Any, recording: Any) -> str:
    """What a picture calls the body: by its file, or that of the recording's source."""
    file = recording.source.get("mesh") if body is None else body.metadata.get("file")
    return Path(str(file)).stem if file else "body"


def _pictures(place: Path, scene: Any, say: Say) -> list[str]:
    """Draw what can be drawn; returns the files."""
    from scan3d import pages, views

    write_whole(place / "view.html", pages.page(scene))
    if not views.can_render():
        say(views.NO_RENDERER)
        return ["view.html"]
    with whole(place / "cloud.png") as picture:
        views.picture(scene, picture, "cloud")
    with whole(place / "surface.png") as picture:
        views.picture(scene, picture, "surface")
    return ["view.html", "cloud.png", "surface.png"]
