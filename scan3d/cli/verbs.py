"""The commands: each function takes parsed arguments and returns an exit code.

Numerical libraries are imported inside the functions, so that ``scan3d --help`` is quick and ``scan3d doctor`` runs where they
are missing.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from scan3d.cli import guide, one_sweep, rig
from scan3d.cli.batch import batch
from scan3d.cli.calibration import calibrate, rigged
from scan3d.cli.exporting import export
from scan3d.cli.laboratory import import_
from scan3d.cli.terminal import is_terminal, one_line, print_result, print_settings, printable, printable_json, table
from scan3d.errors import InputError
from scan3d.settings import Settings, settings
from scan3d.units import UNITS_M


def scan(arguments: Namespace) -> int:
    """All steps, with the results written into a folder."""
    from scan3d import scans

    chosen = _settings(arguments)
    if arguments.print_config:
        return print_settings(dataclasses.asdict(chosen))
    _, data = scans.perform(
        arguments.mesh,
        chosen,
        arguments.out,
        inputs={"file of settings": arguments.config},
        overwrite=arguments.overwrite,
        mesh_path=arguments.mesh_path,
        progress=_progress(arguments),
        notify=_say,
    )
    return _print_report(arguments, data)


def demo(arguments: Namespace) -> int:
    """Scan the body that comes with the program, and say what to open."""
    from scan3d import scans

    _, data = scans.perform(
        guide.DEMO,
        settings(guide.DEMO_SETTINGS),
        arguments.out,
        overwrite=arguments.overwrite,
        progress=_progress(arguments),
        notify=_say,
    )
    code = _print_report(arguments, data)
    if not (arguments.json or arguments.quiet):
        print(guide.what_to_open(arguments.out))
    return code


def simulate(arguments: Namespace) -> int:
    """Step 1 only: write the recording of a simulated scan."""
    import numpy as np

    from scan3d.files.atomic import folder
    from scan3d.files.ownership import check_recording
    from scan3d.files.recordings import check_path, sidecar, write_recording
    from scan3d.scans import with_origin
    from scan3d.simulation.bodies import load_mesh
    from scan3d.simulation.scan import simulate as simulate_scan

    rig.check_rig_options(arguments)
    chosen = _settings(arguments)
    if arguments.print_config:
        return print_settings(dataclasses.asdict(chosen))
    if arguments.poses:
        return _printed(arguments, *rig.simulate_rig(arguments, chosen))
    check_path(arguments.out)
    inputs = {"mesh": arguments.mesh, "file of settings": arguments.config}
    check_recording(arguments.out, sidecar(arguments.out), inputs, arguments.overwrite)
    plan = chosen.plan()
    body = load_mesh(arguments.mesh, hull=chosen.hull, clip_dent=chosen.clip_dent)
    with folder(Path(arguments.out).parent):
        recording = simulate_scan(body, plan, _progress(arguments))
        write_recording(with_origin(recording, body), arguments.out, overwrite=True)  # checked above
    data = {
        "recording": str(arguments.out),
        "samples": len(recording),
        "sweeps": len(np.unique(recording.sweep)),
    }
    text = printable(f"{data['samples']} samples in {data['sweeps']} sweeps, written to {data['recording']}")
    return print_result(arguments, data, text)


def reconstruct(arguments: Namespace) -> int:
    """Step 2 only: write the results of a recording, compared with the true body if it is given."""
    if one_sweep.is_one_sweep(arguments):
        return one_sweep.reconstruct(arguments)
    from scan3d import workflow
    from scan3d.files.recordings import read_recording, sidecar
    from scan3d.files.results import opened
    from scan3d.simulation.bodies import load_mesh

    chosen = settings({name: getattr(arguments, name) for name in ("hull", "clip_dent", "method")})
    start = time.perf_counter()
    recording = rigged(read_recording(arguments.recording), arguments.rig)
    if arguments.table is not None:
        recording = dataclasses.replace(recording, table_m=UNITS_M[recording.unit] * arguments.table)
    # the remaining settings concern the simulation
    used = {name: getattr(chosen, name) for name in ("method", "hull", "clip_dent")}
    body = None
    if arguments.truth:
        body = load_mesh(arguments.truth, hull=chosen.hull, clip_dent=chosen.clip_dent)
    seconds = {"load": time.perf_counter() - start}
    inputs = {
        "recording": arguments.recording,
        "TOML file of the recording": sidecar(arguments.recording),
        "true body": arguments.truth,
        "rig": arguments.rig,
    }
    with opened(arguments.out, with_recording=False, inputs=inputs, overwrite=arguments.overwrite) as result:
        analysis = workflow.analyse(recording, body, chosen.method, arguments.model)
        data = workflow.write(
            analysis,
            result,
            settings=used,
            with_recording=False,
            seconds=seconds,
            notify=_say,
            mesh_path=arguments.mesh_path,
        )
    return _print_report(arguments, data)


def compare(arguments: Namespace) -> int:
    """Print the Hausdorff distance and other measures of two mesh files, convex or not."""
    from scan3d.comparison import compare as compare_meshes
    from scan3d.simulation.bodies import read_mesh
    from scan3d.summaries import comparison_summary

    comparison = compare_meshes(read_mesh(arguments.first), read_mesh(arguments.second))
    text = _table(*comparison_summary(comparison, arguments.unit))
    return print_result(arguments, dataclasses.asdict(comparison), text)


def show(arguments: Namespace) -> int:
    """Show a scan's folder, a recording, a cloud or a mesh in files, or in a window if no file is named."""
    _check_show(arguments)
    from scan3d.files.atomic import atomic, write_atomic
    from scan3d.files.ownership import check_file
    from scan3d.pictures import drawing, movie, page, views, window

    screenshot, html, film = arguments.screenshot, arguments.html, arguments.movie
    if not (screenshot or html or film) and not window.can_open():
        raise InputError(window.NO_DISPLAY)
    # file names are checked before the work
    if screenshot:
        views.check_path(screenshot)
    if film:
        movie.check_path(film)
    inputs = {"file": arguments.path, "true body": arguments.truth}
    for option, file in (("--html", html), ("--movie", film), ("--screenshot", screenshot)):
        if file:
            check_file(file, inputs, arguments.overwrite, option)
    scene = _scene(Path(arguments.path), arguments.truth, arguments.hull, arguments.unit)
    files = []
    if html:
        write_atomic(html, page.page(scene), "--html")
        files.append(html)
    if film:
        if arguments.movie_of == "growth":
            write_atomic(film, drawing.draw(scene, [(Path(film).suffix.lower(), {"subject": "growth"})])[0], "--movie")
        else:  # nothing is rendered
            with atomic(film, "--movie") as path:
                movie.movie(scene, path)
        files.append(film)
    if screenshot:
        default = "cloud" if arguments.color or scene.surface is None else "surface"
        keywords = {"view": arguments.view or default, "color": arguments.color or "force"}
        write_atomic(screenshot, drawing.draw(scene, [(Path(screenshot).suffix.lower(), keywords)])[0], "--screenshot")
        files.append(screenshot)
    if not files:
        window.open_window(scene, print, arguments.color or "force")
        return 0
    text = "\n".join(printable(f"written to {file}") for file in files)
    return print_result(arguments, {"shown": scene.name, "files": files}, text)


def _check_show(arguments: Namespace) -> None:
    """Exit with a usage error for options that would have no effect."""
    if arguments.view and not arguments.screenshot:
        arguments.misuse("--view says what a picture shows: give --screenshot FILE as well")
    if arguments.color and not arguments.screenshot and (arguments.html or arguments.movie):
        arguments.misuse("--color is for a picture or the window: give --screenshot FILE as well")
    if arguments.color and arguments.view not in (None, "cloud"):
        arguments.misuse(
            f"--color is that of the contacts in the view cloud: leave it out with --view {arguments.view}"
        )
    if arguments.movie_of and not arguments.movie:
        arguments.misuse("--movie-of says what a movie shows: give --movie FILE as well")


def _scene(path: Path, truth: str | None, hull: bool, unit: str) -> Any:
    """The scene of a path, with the true body if it is named or found."""
    from scan3d.pictures import stored
    from scan3d.pictures.scene import Scene
    from scan3d.simulation.bodies import load_mesh, read_mesh

    if not path.exists():
        raise InputError(
            f"there is no {path}; show a scan's folder, a recording (.csv), a cloud or a surface (.ply), or a mesh"
        )
    if path.is_dir():
        scene, report = stored.read_folder(path, unit)
        truth = truth or stored.find_truth(path, report)
        hull = hull or bool((report.get("mesh") or {}).get("hull"))
    elif path.suffix.lower() in (".csv", ".parquet"):
        scene = _recording_scene(path)
    else:
        stored_scene = stored.read_ply_scene(path, unit) if path.suffix.lower() == ".ply" else None
        scene = stored_scene or Scene(path.stem, unit, surface=read_mesh(path))
    return dataclasses.replace(scene, truth=load_mesh(truth, hull=hull)) if truth else scene


def _recording_scene(path: Path) -> Any:
    """The scene of a recording: its contacts, and their surface where they span a body."""
    from scan3d import workflow
    from scan3d.files.recordings import read_recording
    from scan3d.pictures.scene import of_cloud
    from scan3d.reconstruction import reconstruct as reconstruct_recording

    recording = read_recording(path)
    try:
        scene = workflow.to_scene(workflow.analyse(recording))
    except InputError:  # contacts in one plane do not span a body, but can be shown
        return of_cloud(reconstruct_recording(recording), name=path.stem, recording=recording)
    return dataclasses.replace(scene, name=path.stem)


def doctor(arguments: Namespace) -> int:
    """Print what works on this machine, and what is missing."""
    import json

    from scan3d.cli.doctor import examine, summary

    state = examine()
    # `files.text` is not used here, because it needs numpy, which may be missing
    if arguments.json:
        print(printable_json(json.dumps(state, indent=2)))
    elif not arguments.quiet:
        print(_table("", summary(state)))
    return 0 if state["ok"] else 1


def completion(arguments: Namespace) -> int:
    """Print a completion script for a shell."""
    from scan3d.cli.completion import script
    from scan3d.cli.parser import VALUES, parser

    print(script(parser(), arguments.shell, VALUES), end="")
    return 0


VERBS: dict[str, Callable[[Namespace], int]] = {
    "scan": scan,
    "batch": batch,
    "simulate": simulate,
    "plan": lambda arguments: _printed(arguments, *rig.plan(arguments)),
    "next": lambda arguments: _printed(arguments, *rig.further(arguments)),
    "reconstruct": reconstruct,
    "calibrate": calibrate,
    "import": import_,
    "compare": compare,
    "show": show,
    "export": export,
    "demo": demo,
    "explain": guide.explain_command,
    "doctor": doctor,
    "completion": completion,
}


def _settings(arguments: Namespace) -> Settings:
    names = {field.name for field in dataclasses.fields(Settings)}
    given = {name: value for name, value in vars(arguments).items() if name in names}
    return settings(given, arguments.config)


def _print_report(arguments: Namespace, data: dict[str, Any]) -> int:
    from scan3d.summaries import summary

    heading, rows = summary(data)
    print_result(arguments, data, _table(heading, [*rows, ("written to", str(arguments.out))]))
    for warning in data["warnings"]:
        _say(f"warning: {warning['message']}")
    return 1 if arguments.strict and data["warnings"] else 0


def _printed(arguments: Namespace, data: Any, text: str, warnings: Iterable[str]) -> int:
    """Print the result of a command of another module, and its warnings."""
    for warning in warnings:
        _say(f"warning: {warning}")
    return print_result(arguments, data, text)


def _table(heading: str, rows: Iterable[tuple[str, str]]) -> str:
    return table(heading, list(rows), sys.stdout)


def _say(sentence: str) -> None:
    print(f"scan3d: {one_line(sentence)}", file=sys.stderr)


def _progress(arguments: Namespace) -> Callable[[int, int], None]:
    """Shows a line on stderr that counts the slices and is erased at the end; nothing if stderr is not a terminal."""
    if arguments.quiet or not is_terminal(sys.stderr):
        return lambda *_: None

    parts = "rounds" if getattr(arguments, "model", None) == "spatial" else "slices"

    def show_progress(done: int, total: int) -> None:
        end = f"\r{'':40}\r" if done >= total else ""
        print(f"\rsimulate {done}/{total} {parts}{end}", end="", file=sys.stderr, flush=True)

    return show_progress
