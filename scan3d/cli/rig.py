"""The commands for a rig: poses for an unknown body, and the log of a rig that is computed."""

from __future__ import annotations

import dataclasses
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scan3d.cli.terminal import printable
from scan3d.errors import InputError
from scan3d.rods import parse_rod
from scan3d.settings import Settings, UsageError

if TYPE_CHECKING:
    from scan3d.simulation.rig import RawLog

Outcome = tuple[dict[str, Any], str, tuple[str, ...]]
"""What a command did: the data for --json, the text that is printed otherwise, and warnings."""

# Settings of a simulated scan that do not concern a rig with given poses, with what to do instead.
_SCAN_ONLY = ("slices", "spacing", "axis", "sweeps", "samples", "clearance", "tolerance", "noise", "method")


def plan(arguments: Namespace) -> Outcome:
    """Write poses for an unknown body."""
    from scan3d.files.poses import check_poses, write_poses
    from scan3d.files.whole import folder
    from scan3d.planning.rig import FORCE_FACTOR, RigPlan, parse_envelope, plan_poses

    check_poses(arguments.out, arguments.overwrite)
    try:
        chosen = RigPlan(
            around=parse_envelope(arguments.around),
            model=arguments.model,
            slices=arguments.slices,
            sweeps=arguments.sweeps,
            rod=parse_rod(arguments.rod),
            unit=arguments.unit,
            **_limits(arguments),
        )
    except InputError as error:
        raise UsageError(str(error)) from None
    poses = plan_poses(chosen)
    with folder(Path(arguments.out).parent):
        write_poses(poses, arguments.out)
    rod, clearance = chosen.resolved_rod(), chosen.resolved_clearance()
    seconds, largest = float(poses.times()[-1]), FORCE_FACTOR * rod.force_unit_N / clearance**2
    data = {
        "poses": str(arguments.out),
        "sweeps": len(poses.sweeps()),
        "rows": len(poses),
        "seconds": seconds,
        "clearance": clearance,
        "largest_force_N": largest,
        "rod": {
            "length_m": rod.length_m,
            "bending_stiffness_Nm2": rod.bending_stiffness_Nm2,
            "diameter_m": rod.diameter_m,
        },
    }
    text = (
        f"{data['sweeps']} sweeps with {data['rows']} poses, {seconds / 60:.0f} minutes, for a rod of "
        f"{1000 * rod.length_m:.4g} mm with {1000 * rod.diameter_m:.3g} mm diameter; forces stay below "
        f"{largest:.3g} N; written to {data['poses']}"
    )
    return data, printable(text), ()


def _limits(arguments: Namespace) -> dict[str, Any]:
    """The settings of `RigPlan` that `plan` and `next` have in common."""
    from scan3d.planning.rig import parse_envelope

    return {
        "samples": arguments.samples,
        "clearance": arguments.clearance,
        "max_force_N": arguments.max_force,
        "floor": arguments.floor,
        "workspace": parse_envelope(arguments.workspace) if arguments.workspace else None,
        "speed": arguments.speed,
    }


def further(arguments: Namespace) -> Outcome:
    """Write poses where a folder's contacts leave most room."""
    from scan3d.files.poses import check_poses, write_header, write_poses
    from scan3d.files.recordings import read_recording, sidecar
    from scan3d.files.whole import RECORDING, folder, read_report
    from scan3d.planning.rig import parse_envelope
    from scan3d.session import Session, around_contacts

    path = Path(arguments.recording or Path(arguments.folder) / RECORDING[0])
    if arguments.recording is None and not path.exists():
        raise InputError(
            f"there is no {RECORDING[0]} in {arguments.folder}; give the recording that was reconstructed with --recording"
        )
    check_poses(arguments.out, arguments.overwrite, {"recording": path, "TOML file of the recording": sidecar(path)})
    if arguments.sweeps < 1:
        raise UsageError(f"sweeps must be a whole number of at least 1, got {arguments.sweeps}")
    report = read_report(Path(arguments.folder))
    recording = read_recording(path)
    model: Any = report.get("model") or ("spatial" if recording.six_axis else "planar")
    stated = arguments.around or recording.source.get("around") or around_contacts(recording, model)
    try:
        body, limits = parse_envelope(str(stated)), _limits(arguments)
    except InputError as error:
        raise UsageError(str(error)) from None
    session = Session(
        body,
        recording.rod,
        model,
        tolerance=arguments.tolerance,
        seed=arguments.seed,
        unit=recording.unit,
        **limits,
    )
    session.tell(recording)
    poses = session.ask(arguments.sweeps)
    with folder(Path(arguments.out).parent):
        if poses is None:
            write_header(session.planned(), arguments.out)
        else:
            write_poses(poses, arguments.out)
    bound = session.certificate.bound
    data = {
        "poses": str(arguments.out),
        "sweeps": 0 if poses is None else len(poses.sweeps()),
        "bound": bound,
        "relative_bound": session.relative_bound,
        "tolerance": arguments.tolerance,
        "around": str(body),
    }
    known = "nothing bounds the body yet"
    if bound < float("inf"):
        known = f"the body is known within {bound:.4g} {recording.unit} ({session.relative_bound:.2g} of the diagonal)"
    text = f"{known}; {data['sweeps']} further sweeps, written to {data['poses']}"
    return data, printable(text), tuple(warning.message for warning in session.warnings)


def check_rig_options(arguments: Namespace) -> None:
    """Raise UsageError for options that would have no effect."""
    if arguments.poses is None:
        for name in ("faults", "placed", "as_is"):
            if getattr(arguments, name):
                raise UsageError(f"--{name.replace('_', '-')} is for a rig: give --poses FILE as well")
        return
    given = [name for name in _SCAN_ONLY if name in vars(arguments)]
    if given:
        instead = "noise belongs into --faults" if given == ["noise"] else "give it to scan3d plan, or leave it out"
        raise UsageError(f"--{given[0]} is a setting of a scan, and --poses says where the clamp goes; {instead}")


def simulate_rig(arguments: Namespace, chosen: Settings) -> Outcome:
    """Write the log of a rig that goes through a list of poses."""
    from scan3d.files.meshes import load_mesh
    from scan3d.files.poses import read_poses
    from scan3d.files.raw_logs import map_path
    from scan3d.files.reading import read_toml
    from scan3d.files.whole import folder
    from scan3d.simulation import rig
    from scan3d.simulation.faults import read_faults

    plan = chosen.plan()
    given = {*vars(arguments), *(read_toml(arguments.config) if arguments.config else ())}
    _check_files(arguments)
    poses = read_poses(arguments.poses)
    faults = read_faults(arguments.faults) if arguments.faults else None
    if faults is not None and "seed" in vars(arguments):
        faults = dataclasses.replace(faults, seed=plan.seed)
    body = load_mesh(arguments.mesh, hull=chosen.hull, clip_dent=chosen.clip_dent)
    body = body if arguments.as_is else rig.standing(body)
    log = rig.simulate_rig(
        body,
        poses,
        faults=faults,
        rod=plan.rod,
        model=chosen.model if "model" in given else None,
        friction=plan.friction_range,
        seed=plan.seed,
        unit=plan.unit,
    )
    origin = {"mesh": body.metadata["file"], "mesh_sha256": body.metadata["sha256"]}
    log = dataclasses.replace(log, source=log.source | origin)
    with folder(Path(arguments.out).parent):
        _write(log, arguments.out)
        if arguments.placed:
            _write_placed(body, plan.unit, arguments.placed)
    data: dict[str, Any] = {
        "log": str(arguments.out),
        "rows": len(log),
        "sweeps": len(poses.sweeps()),
        "seconds": float(log.time_s[-1]),
        "moved": log.source.get("moved"),
        "warnings": list(log.warnings),
    }
    beside = ""
    if faults is not None:
        data["map"] = str(map_path(arguments.out))
        beside = f", with the map {data['map']}"
    text = f"{data['rows']} rows of {data['sweeps']} sweeps, written to {data['log']}{beside}"
    return data, printable(text), log.warnings


def _check_files(arguments: Namespace) -> None:
    """Raise InputError for files that must not be written."""
    from scan3d.files.raw_logs import check_log
    from scan3d.files.recordings import check_path, sidecar
    from scan3d.files.whole import check_file, check_pair

    check_path(arguments.out)
    inputs = {"mesh": arguments.mesh, "list of poses": arguments.poses, "file of faults": arguments.faults}
    inputs |= {"TOML file of the poses": sidecar(arguments.poses), "file of settings": arguments.config}
    if arguments.faults:
        check_log(arguments.out, inputs, arguments.overwrite)
    else:
        check_pair(arguments.out, sidecar(arguments.out), inputs, arguments.overwrite)
    if arguments.placed:
        if Path(arguments.placed).suffix != ".ply":
            raise InputError(f"the placed mesh is written as .ply, got {Path(arguments.placed).name!r}")
        check_file(arguments.placed, inputs, arguments.overwrite, "--placed")


def _write(log: RawLog, path: str) -> None:
    import numpy as np

    from scan3d.files.raw_logs import RAW_COLUMNS, write_exact_log, write_log

    if log.faults is None:
        write_exact_log(log.recording(slice(None)), log.time_s, log.move, path)
        return
    values = [log.time_s, *(1000 * log.position_m.T), *log.quaternion.T, *log.wrench.T[:3], *(1000 * log.wrench.T[3:])]
    columns = dict(zip(RAW_COLUMNS, [*map(np.asarray, values), log.sweep], strict=True))
    nominal = log.faults.nominal
    sensor = {
        "position_mm": list(nominal.position_mm),
        "euler_deg": list(nominal.euler_deg),
        "shows": log.faults.shows,
    }
    write_log(columns, dataclasses.asdict(log.rod), sensor, path, log.table_m)


def _write_placed(body: Any, unit: str, path: str) -> None:
    """Write a mesh with coordinates of double precision."""
    import numpy as np

    from scan3d.files.ply import ply
    from scan3d.files.whole import write_atomic

    vertices = np.asarray(body.vertices, dtype=float)
    table = np.array(list(map(tuple, vertices)), dtype=[(name, "f8") for name in "xyz"])
    write_atomic(path, ply(table, np.asarray(body.faces), comments=("scan3d surface", f"unit {unit}")), "--placed")
