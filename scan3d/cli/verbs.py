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
from scan3d.cli.showing import show
from scan3d.cli.terminal import print_result, print_settings, printable, printable_json, table
from scan3d.settings import Settings, settings
from scan3d.units import UNITS_M


def scan(arguments: Namespace) -> int:
    """All steps, with the results written into a folder."""
    from scan3d import scans

    chosen = _settings(arguments)
    if arguments.print_config:
        return print_settings(arguments, dataclasses.asdict(chosen))
    _, data = scans.perform(
        arguments.mesh,
        chosen,
        arguments.out,
        inputs={"file of settings": arguments.config},
        overwrite=arguments.overwrite,
        **_shown(arguments, chosen),
    )
    return _print_report(arguments, data)


def demo(arguments: Namespace) -> int:
    """Scan the body that comes with the program, and say what to open."""
    from scan3d import scans

    chosen = settings(guide.DEMO_SETTINGS)
    _, data = scans.perform(
        guide.DEMO,
        chosen,
        arguments.out,
        overwrite=arguments.overwrite,
        **_shown(arguments, chosen),
    )
    code = _print_report(arguments, data)
    if not (arguments.json or arguments.quiet):
        print(guide.what_to_open(arguments.out))
    return code


def simulate(arguments: Namespace) -> int:
    """Step 1 only: write the recording of a simulated scan."""
    import numpy as np

    from scan3d.files.meshes import load_mesh
    from scan3d.files.recordings import check_path, sidecar, write_recording
    from scan3d.files.whole import check_pair, folder
    from scan3d.scans import with_origin
    from scan3d.simulation.scan import simulate as simulate_scan

    rig.check_rig_options(arguments)
    chosen = _settings(arguments)
    if arguments.print_config:
        return print_settings(arguments, dataclasses.asdict(chosen))
    if arguments.poses:
        return _printed(arguments, *rig.simulate_rig(arguments, chosen))
    check_path(arguments.out)
    inputs = {"mesh": arguments.mesh, "file of settings": arguments.config}
    check_pair(arguments.out, sidecar(arguments.out), inputs, arguments.overwrite)
    plan = chosen.plan()
    arguments.progress.tell("reading")
    body = load_mesh(arguments.mesh, hull=chosen.hull, clip_dent=chosen.clip_dent)
    with folder(Path(arguments.out).parent):
        recording = simulate_scan(body, plan, arguments.progress.counter(_parts(chosen)))
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
    from scan3d.files.meshes import load_mesh
    from scan3d.files.recordings import read_recording, sidecar
    from scan3d.files.whole import replacing

    chosen = settings({name: getattr(arguments, name) for name in ("hull", "clip_dent", "method")})
    start, progress = time.perf_counter(), arguments.progress
    progress.expect("planar", without=("simulate", *(() if arguments.truth else ("compare",))))
    progress.step("load")
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
    with replacing(arguments.out, with_recording=False, inputs=inputs, overwrite=arguments.overwrite) as result:
        analysis = workflow.analyse(recording, body, chosen.method, arguments.model, progress.step)
        data = workflow.write(
            analysis,
            result,
            settings=used,
            with_recording=False,
            seconds=seconds,
            notify=progress.say,
            step=progress.step,
        )
    return _print_report(arguments, data)


def compare(arguments: Namespace) -> int:
    """Print the Hausdorff distance and other measures of two mesh files, convex or not."""
    from scan3d.comparison import compare as compare_meshes
    from scan3d.files.meshes import read_mesh
    from scan3d.summaries import comparison_summary

    comparison = compare_meshes(read_mesh(arguments.first), read_mesh(arguments.second))
    text = _table(*comparison_summary(comparison, arguments.unit))
    return print_result(arguments, dataclasses.asdict(comparison), text)


def doctor(arguments: Namespace) -> int:
    """Print what works on this machine, and what is missing."""
    import json

    from scan3d.cli.doctor import examine, summary

    arguments.progress.tell("trying what the commands need")
    state = examine()
    arguments.progress.end()
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
        arguments.progress.say(f"warning: {warning['message']}")
    return 1 if arguments.strict and data["warnings"] else 0


def _printed(arguments: Namespace, data: Any, text: str, warnings: Iterable[str]) -> int:
    """Print the result of a command of another module, and its warnings."""
    for warning in warnings:
        arguments.progress.say(f"warning: {warning}")
    return print_result(arguments, data, text)


def _table(heading: str, rows: Iterable[tuple[str, str]]) -> str:
    return table(heading, list(rows), sys.stdout)


def _parts(chosen: Settings) -> str:
    """What a simulation counts."""
    return "rounds" if chosen.model == "spatial" else "slices"


def _shown(arguments: Namespace, chosen: Settings) -> dict[str, Any]:
    """Keywords of `scans.perform` by which the progress is shown."""
    progress = arguments.progress
    progress.expect(chosen.model)
    # with a tolerance the scan may end before all slices are swept
    count = progress.counter(_parts(chosen), estimated=not chosen.tolerance)
    return {"progress": count, "step": progress.step, "notify": progress.say}
