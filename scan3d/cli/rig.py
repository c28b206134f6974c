"""The commands of a rig: poses for an unknown body, the log of a rig that is computed, import and calibration."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from scan3d.choices import Model, Tare
from scan3d.cli.terminal import (
    Body,
    File,
    Flag,
    Number,
    Options,
    Output,
    Overwrite,
    Rig,
    print_result,
    printable,
    say,
    table,
)
from scan3d.errors import InputError, UsageError
from scan3d.files.text import parse_rod
from scan3d.units import UNITS_M, Unit, force, length, moment, number, plus_minus, share, unit_question

if TYPE_CHECKING:
    from scan3d.calibration.report import Calibration
    from scan3d.laboratory.importing import Imported
    from scan3d.simulation.rig import RawLog

RIG_OPTIONS = Parameter(
    group=Group("Rig", help="A rig that goes through a list of poses, in the place of a scan."), show_default=False
)


# Settings of the surface and its bounds, which a recording does not have.
OF_SURFACES = ("method", "reach")


@Parameter(name="*")
@dataclass(frozen=True)
class Limits:
    """Where the clamp may go, and how.

    Parameters
    ----------
    samples
        poses per sweep
    clearance
        distance of the clamp from the bounding body, in rod lengths
    max_force
        largest contact force in N, by which the clamp keeps farther away
    floor
        height above which clamp and straight rod stay (default: 2 % of the bounding body's height, and two rod diameters)
    speed
        of the clamp, per second, in the unit of the body (default: 20 mm/s)
    """

    samples: Number = 128
    clearance: float = 0.3
    max_force: float | None = None
    floor: float | None = None
    speed: float | None = None

    def of_plan(self) -> dict[str, Any]:
        """As `RigPlan` takes them."""
        values = dataclasses.asdict(self)
        return values | {"max_force_N": values.pop("max_force")}


def plan(
    *,
    around: Body,
    out: File,
    model: Model = "planar",
    probing: Flag = False,
    slices: Number = 32,
    sweeps: Number | None = None,
    rod: str = "auto",
    limits: Limits = Limits(),
    unit: Unit = "mm",
    overwrite: Overwrite = False,
    output: Output = Output(),
) -> int:
    """Poses for an unknown body, from a body around it.

    For example:
      scan3d plan --around cylinder:80x120 --out poses.csv
      scan3d plan --around box:60x40x30 --out poses.csv --model spatial --rod steel:0.3x70 --max-force 0.5
      scan3d plan --around cylinder:100x100 --out poses.csv --probing --speed 10

    Parameters
    ----------
    around
        bounding body, standing on z = 0 about the z axis: cylinder:DxH, sphere:D or box:AxBxC
    out
        the poses, a .csv; a .toml is written as well
    model
        model of contact
    probing
        moves along the rod until it touches, in the place of sweeps: for a body that is not convex
    slices
        number of slices
    sweeps
        sweeps per slice (default 4), or in the spatial model per direction (default 0.6 times the slices)
    rod
        MATERIAL:DIAMETERxLENGTH in mm, such as steel:0.3x50, or auto: a length that fits
    unit
        unit of the bounding body, of floor and speed
    """
    from scan3d.files.recordings import check_poses, write_poses
    from scan3d.files.text import rod_section
    from scan3d.files.whole import folder
    from scan3d.planning.rig import RigPlan, largest_force, parse_envelope, plan_poses

    check_poses(out, overwrite)
    if probing and (slices != 32 or sweeps is not None or limits.samples != Limits().samples):
        raise UsageError(
            "a plan of probings chooses planes and lines itself; leave --slices, --sweeps and --samples out"
        )
    try:
        chosen = RigPlan(
            around=parse_envelope(around),
            model=model,
            probing=probing,
            slices=slices,
            sweeps=sweeps,
            rod=parse_rod(rod),
            unit=unit,
            **limits.of_plan(),
        )
    except InputError as error:
        raise UsageError(str(error)) from None
    poses = plan_poses(chosen)
    with folder(out.parent):
        write_poses(poses, out)
    used, clearance = chosen.wire(), chosen.resolved_clearance()
    seconds, largest = float(poses.times()[-1]), largest_force(used, clearance)
    data = {
        "poses": str(out),
        "sweeps": len(poses.sweeps()),
        "rows": len(poses),
        "seconds": seconds,
        "clearance": clearance,
        "largest_force_N": largest,
        "rod": rod_section(used),
    }
    text = (
        f"{data['sweeps']} sweeps with {data['rows']} poses, {seconds / 60:.0f} minutes, for a rod of "
        f"{length(used.length_m, 'm', digits=4)} with {length(used.diameter_m, 'm')} diameter; forces stay below "
        f"{force(largest, up=True)}; written to {data['poses']}"
    )
    return print_result(output, data, printable(text))


def further(
    folder: Path,
    /,
    *,
    out: File,
    tolerance: float = 0.0,
    around: Body | None = None,
    sweeps: Number = 24,
    seed: Number = 0,
    limits: Limits = Limits(),
    overwrite: Overwrite = False,
    output: Output = Output(),
) -> int:
    """Poses of further sweeps, where what was measured leaves most room, or places for another probe.

    For example:
      scan3d next out --out further.csv --around cylinder:80x120
      scan3d next out --out further.csv --tolerance 0.01

    Parameters
    ----------
    folder
        folder of a scan, a reconstruction, or a surface from touches of another probe
    out
        the poses, as of plan; after touches of another probe places to aim at, with outward normals against which to approach
        them; a header only where the tolerance is met
    tolerance
        certified bound, relative to the diagonal, at which no more sweeps are needed
    around
        bounding body, as of plan (default: that of the plan, or of the contacts)
    sweeps
        about how many sweeps, or places; of a body that is not convex a plane of probings for every four
    seed
        of the directions of sweeps in space
    """
    from scan3d.files import whole
    from scan3d.files.recordings import check_poses, read_recording, sidecar, write_poses
    from scan3d.files.whole import RECORDING, check_belongs, locate, read_report
    from scan3d.planning.rig import parse_envelope
    from scan3d.session import Session, around_contacts

    path, report = folder / RECORDING[0], read_report(folder)
    if sweeps < 1:
        raise UsageError(f"sweeps must be a whole number of at least 1, got {sweeps}")
    if report.get("model") == "touches":
        if around is not None or limits != Limits():
            raise UsageError("touches of another probe have no clamp to plan for; leave --around and its limits out")
        return _further_places(folder, report, out, tolerance, sweeps, overwrite, output)
    if not locate(path).exists():
        raise InputError(f"there is no {RECORDING[0]} in {folder}; give a folder that scan or reconstruct has written")
    check_poses(out, overwrite, {"recording": path, "TOML file of the recording": sidecar(path)})
    check_belongs(folder, report, RECORDING)
    measured = read_recording(path)
    model: Any = report.get("model") or ("spatial" if measured.six_axis else "planar")
    stated = around or measured.source.get("around") or around_contacts(measured, model)
    try:
        body, limit = parse_envelope(str(stated)), limits.of_plan()
    except InputError as error:
        raise UsageError(str(error)) from None
    session = Session(body, measured.rod, model, tolerance=tolerance, seed=seed, unit=measured.unit, **limit)
    session.tell(measured)
    poses = session.ask(sweeps)
    with whole.folder(out.parent):
        write_poses(poses or session.planned(), out, empty=poses is None)
    bound = session.certificate.bound
    data = {
        "poses": str(out),
        "sweeps": 0 if poses is None else len(poses.sweeps()),
        "bound": bound,
        "relative_bound": session.relative_bound,
        "tolerance": tolerance,
        "around": str(body),
    }
    for warning in session.warnings:
        output.progress.say(f"warning: {warning.message}")
    text = f"{session.known}; {data['sweeps']} further sweeps, written to {data['poses']}"
    return print_result(output, data, printable(text))


def _further_places(
    folder: Path, report: Mapping[str, Any], out: Path, tolerance: float, count: int, overwrite: bool, output: Output
) -> int:
    """Places to touch next with another probe: where touches of a convex body leave most room, or, of another one, the middles
    of what is unknown, the largest first."""
    import numpy as np

    from scan3d.files.text import rows_as_text
    from scan3d.files.whole import check_file, sha256, write_together
    from scan3d.planning.plan import open_places
    from scan3d.results import open

    shown = open(folder)
    cloud, certificate = shown.cloud, shown.certificate
    relative = certificate.relative(cloud.points) if certificate.bound < math.inf else math.inf
    known = np.isfinite(cloud.normals).all(axis=1)
    if not cloud.convex:
        unknown = (report.get("coverage") or {}).get("unknown", [])[:count]
        places = np.array([patch["center"] for patch in unknown]).reshape(-1, 3)
        normals = np.full_like(places, np.nan)
    elif relative <= tolerance:
        places = normals = np.empty((0, 3))
    elif known.sum() < 4:
        raise InputError(
            f"{folder} has {int(known.sum())} touches with normals, which tell where a convex body may go on; record the "
            "normals, or plan the touches by the picture"
        )
    else:
        places, normals = open_places(cloud.points[known], cloud.normals[known], count)
    names = ",".join([f"{axis}_{cloud.unit}" for axis in "xyz"] + ["nx", "ny", "nz"])
    data = f"{names}\n".encode() + rows_as_text([*places.T, *normals.T]).replace(b"nan", b"")
    # the touches of the result, whose paths the report does not have, are known by their hashes
    source = report.get("source") or {}
    touched = {one.get("sha256") for one in (source, *source.get("further", ()))}
    inputs = {
        "cloud": folder / "cloud.ply",
        "file of touches": out if out.is_file() and sha256(out) in touched else None,
    }
    check_file(out, inputs, overwrite, "--out", data)
    write_together(out, {out.name: data})
    found = {"places": str(out), "count": len(places), "relative_bound": relative, "tolerance": tolerance}
    return print_result(output, found, f"{len(places)} places to touch next, written to {printable(str(out))}")


def refuse_settings_of_scans(given: dict[str, Any]) -> None:
    """Raises UsageError for settings that have no effect where a list of poses says where the clamp goes."""
    of_scans = (
        "slices", "spacing", "axis", "sweeps", "samples", "clearance", "tolerance", "probing", "known", "noise",
        *OF_SURFACES
    )  # fmt: skip
    if wrong := [name for name in of_scans if name in given]:
        instead = "noise belongs into --faults" if wrong == ["noise"] else "give it to scan3d plan, or leave it out"
        raise UsageError(f"--{wrong[0]} is a setting of a scan, and --poses says where the clamp goes; {instead}")


def simulate_rig(
    mesh: Path,
    out: Path,
    options: Options,
    poses_file: Path,
    faults_file: Path | None,
    placed: Path | None,
    overwrite: bool,
    output: Output,
) -> int:
    """Write the log of a rig that goes through a list of poses."""
    from scan3d.files.meshes import load_mesh
    from scan3d.files.recordings import check_path, map_path, read_poses, sidecar
    from scan3d.files.text import read_section
    from scan3d.files.whole import check_file, check_pair, folder
    from scan3d.simulation import rig
    from scan3d.simulation.rig import read_faults

    chosen = options.chosen()
    plan = chosen.plan()
    given = {*options.given(), *(read_section(options.config, "settings").data if options.config else ())}
    check_path(out)
    inputs = {"mesh": mesh, "list of poses": poses_file, "file of faults": faults_file}
    inputs |= {"TOML file of the poses": sidecar(poses_file), "file of settings": options.config}
    mapped = map_path(out).exists() and not overwrite  # a map is there to be completed by hand
    if faults_file:
        check_file(out, inputs, overwrite, "--out")
    else:
        check_pair(out, sidecar(out), inputs, overwrite)
    if placed:
        if placed.suffix != ".ply":
            raise InputError(f"the placed mesh is written as .ply, got {placed.name!r}")
        check_file(placed, inputs, overwrite, "--placed")
    poses = read_poses(poses_file)
    faults = read_faults(faults_file) if faults_file else None
    if faults is not None and "seed" in options.given():
        faults = dataclasses.replace(faults, seed=plan.seed)
    body = rig.standing(load_mesh(mesh, hull=chosen.hull, unit=plan.unit))
    if question := unit_question(float(body.extents.max()), plan.unit):
        output.progress.say(question)
    output.progress.tell("simulate")
    log = rig.simulate_rig(
        body,
        poses,
        faults=faults,
        rod=plan.rod,
        model=chosen.model if "model" in given else None,
        friction=plan.friction_range,
        seed=plan.seed,
        unit=plan.unit,
        stop_force=plan.stop_force,
    )
    origin = {"mesh": body.metadata["file"], "mesh_sha256": body.metadata["sha256"]}
    log = dataclasses.replace(log, source=log.source | origin)
    output.progress.tell("write")
    with folder(out.parent):
        _write_log(log, out, mapped)
        if placed:
            _write_placed(body, plan.unit, placed)
    data: dict[str, Any] = {
        "log": str(out),
        "rows": len(log),
        "sweeps": len({*log.sweep[log.sweep >= 0].tolist()}),
        "seconds": float(log.time_s[-1]),
        "moved": log.source.get("moved"),
        "warnings": list(log.warnings),
    }
    beside = ""
    if faults is not None:
        data["map"] = str(map_path(out))
        beside = f", with the map {data['map']}{', which was there and is kept' if mapped else ''}"
    for warning in log.warnings:
        output.progress.say(f"warning: {warning}")
    text = f"{data['rows']} rows of {data['sweeps']} sweeps, written to {data['log']}{beside}"
    return print_result(output, data, printable(text))


def _write_log(log: RawLog, path: Path, mapped: bool) -> None:
    import numpy as np

    from scan3d.files.recordings import RAW_COLUMNS, recording_files, write_log
    from scan3d.files.text import rod_section
    from scan3d.files.whole import write_together
    from scan3d.poses import MOVES

    if log.faults is None:  # readers take the rows of the move sweep only
        further = {"t_s": log.time_s, "move": np.array(MOVES)[log.move]}
        write_together(path, recording_files(log.recording(slice(None)), path.name, further))
        return
    values = [log.time_s, *(1000 * log.position_m.T), *log.quaternion.T, *log.wrench.T[:3], *(1000 * log.wrench.T[3:])]
    columns = dict(zip(RAW_COLUMNS, [*map(np.asarray, values), log.sweep], strict=True))
    sensor = {**log.faults.nominal._asdict(), "shows": log.faults.shows}
    write_log(columns, rod_section(log.rod), sensor, path, log.table_m, mapped)


def _write_placed(body: Any, unit: str, path: Path) -> None:
    from scan3d.files import shapes
    from scan3d.files.whole import write_atomic

    rows = shapes.table(dict(zip("xyz", body.vertices.T, strict=True)))
    data = shapes.ply(rows, body.faces, comments=("scan3d surface", f"unit {unit}"))
    write_atomic(path, data, "--placed")


def calibrate(
    recording: Path,
    /,
    *,
    out: File,
    sphere: Annotated[float | None, Parameter(metavar="D")] = None,
    plane: Flag = False,
    known: Annotated[File | None, Parameter(metavar="PLACES")] = None,
    map: File | None = None,
    unit: Unit = "mm",
    tare: Tare = "auto",
    pose_noise: float | None = None,
    accuracy: float | None = None,
    overwrite: Overwrite = False,
    output: Output = Output(),
) -> int:
    """Rod, clamp and sensor of a rig, from touches of a sphere or a plane, or of raw signals at known places.

    The rod's stiffness and length, the clamp's offset and turn, the sensor's place and turn and its tare,
    with uncertainties, from sweeps over a reference: a sphere of known diameter, or a plane. Where it is need not
    be known.

    With --known the log has raw signals, in counts or volts, while the rod is touched at known places: the matrix and
    the offset of the sensor, and the curvature of the rod.

    For example:
      scan3d calibrate touches.csv --sphere 30 --out rig.toml
      scan3d calibrate counts.csv --known places.csv --map counts.toml --out rig.toml
      scan3d calibrate touches.csv --plane --out rig.toml --pose-noise 0.02 --json

    Parameters
    ----------
    recording
        the .csv of a recording; its .toml is in the same folder
    out
        the rig, a .toml
    sphere
        the reference is a sphere of this diameter, in mm or in --unit
    plane
        the reference is flat, such as a surface plate
    known
        a .csv of the places: touch (also in the log), or from_s and to_s; s_mm along the rod, x_mm, y_mm, z_mm in the
        clamp's frame (of a pin's centre with pin_diameter_mm), sd_mm; or s_mm and fx_N, fy_N, fz_N; empty in the air
    map
        of a log with --known, the .toml with [rod], [columns] signals and [sensor] (default: the .toml beside the log)
    unit
        unit of --sphere and --pose-noise
    tare
        what the sensor shows in the air
    pose_noise
        standard deviation of the clamp's coordinates (default: estimated)
    accuracy
        standard deviation of the gains of the sensor's channels (default: that of the map, or 0.005)
    """
    from scan3d.calibration.report import calibrate as calibrate_rig
    from scan3d.calibration.report import check_path
    from scan3d.files.recordings import read_recording, sidecar
    from scan3d.laboratory.importing import not_rigged
    from scan3d.laboratory.places import calibrate_signals

    if (sphere is not None) + plane + (known is not None) != 1:
        raise UsageError("the reference is one of --sphere D, --plane and --known PLACES")
    if known is None and map is not None:
        raise UsageError("--map is of a log with --known; touches of a reference are imported first")
    inputs = {"recording": recording, "TOML file of the recording": sidecar(recording), "places": known, "map": map}
    check_path(out, inputs, overwrite)
    if known is not None:
        return _calibrated(calibrate_signals(recording, known, map), out, output)
    scale = UNITS_M[unit]
    touches = read_recording(recording)
    not_rigged(touches.source)
    noise = None if pose_noise is None else scale * pose_noise
    found = calibrate_rig(
        touches, "plane" if plane else scale * (sphere or 0.0), tare=tare, pose_noise_m=noise, accuracy=accuracy
    )
    return _calibrated(found, out, output)


def _calibrated(found: Calibration, out: Path, output: Output) -> int:
    """Write and print a calibration."""
    from scan3d.calibration.report import sections, write_rig

    write_rig(found, out, overwrite=True)  # checked before
    print_result(output, sections(found), "\n".join([*_quantities(found), printable(f"written to {out}")]))
    if not output.quiet:
        for sentence in found.sentences:
            say(sentence)
    return 0


def rigged(recording: Any, rig: Path | None) -> Any:
    """The recording, corrected by a rig if one is named."""
    if rig is None:
        return recording
    from scan3d.calibration.report import read_rig
    from scan3d.laboratory.importing import not_rigged

    not_rigged(recording.source)
    return read_rig(rig).applied(recording)


def _quantities(found: Any) -> list[str]:
    from scan3d.rigs import GAINS

    lines = [f"{'quantity':24} {'value ± expanded U':>24}  determined"]
    columns = found.names, found.values, found.standard_deviations, found.well
    for name, value, deviation, well in zip(*columns, strict=True):
        if deviation == float("inf"):
            lines.append(f"{name:24} {number(value, 6):>24}  no, nominal")
        else:
            known = plus_minus(value, value - 2 * deviation, value + 2 * deviation)
            lines.append(f"{name:24} {known:>24}  {'well' if well else 'poorly'}")
    if found.channels:
        lines.append(
            f"chi2 per degree of freedom {found.chi2:.3f}; {found.details['touches']} touches, {found.details['rows']} rows"
        )
        return lines
    for name, value, variance in zip(GAINS, found.gains, found.gains_covariance.diagonal(), strict=True):
        if variance:
            deviation = math.sqrt(variance)
            lines.append(f"{name:24} {plus_minus(value, value - 2 * deviation, value + 2 * deviation):>24}")
    lines.append(f"the gains of the sensor's channels are {found.told_gains}")
    details = found.details
    lines.append(
        f"chi2 per degree of freedom {found.chi2:.3f}, of the wrench alone {found.consistency:.3f}; pose noise "
        f"{length(found.pose_noise_m, 'm', digits=2)} ({details['pose_noise']}); {details['contacts']} contacts, "
        f"{details['tip_contacts']} of the tip, {details['air']} rows in the air, tare {details['tare']}"
    )
    return lines


def import_(
    raw: Path,
    /,
    *,
    map: File | None = None,
    rig: Rig = None,
    after: File | None = None,
    out: File | None = None,
    guess: Flag = False,
    dry_run: Flag = False,
    picture: File | None = None,
    overwrite: Overwrite = False,
    output: Output = Output(),
) -> int:
    """A recording from a laboratory's table, which a map describes.

    For example:
      scan3d import log.csv --map rig.toml --guess
      scan3d import log.csv --map rig.toml --dry-run
      scan3d import log.csv --map rig.toml --out specimen.csv
      scan3d import log.csv --map rig.toml --rig calibrated.toml --out specimen.csv
      scan3d import further.csv --map rig.toml --after specimen.csv --out both.csv
      scan3d import run.bag --map rig.toml --out specimen.parquet

    Parameters
    ----------
    raw
        text with any delimiter; a table of Excel, Parquet, MATLAB, numpy or HDF5; or a ROS bag (.bag, or its folder)
    map
        TOML file that says what the columns mean
    rig
        the .toml of a calibrated rig, whose frames and rod replace those of the map
    after
        an earlier recording, whose sweeps come before those of the table in the new one
    out
        the recording, .csv or .parquet; a .toml of the same name is written as well
    guess
        write a first map by the names of the columns, to --map or beside RAW, and stop
    dry_run
        print the first rows of the recording, and write a picture of the curves only
    picture
        raw and converted curves, a .png, .pdf or .svg (default with --dry-run: RAW with the ending .png)
    """
    if guess:
        return _guess(raw, map, overwrite, output)
    if map is None:
        raise UsageError("--map says what the columns mean; --guess writes a first one")
    if not (out or dry_run):
        raise UsageError("--out names the recording; --dry-run only shows what would become of the table")
    from scan3d.files.recordings import check_path, read_recording, recording_files, sidecar, write_recording
    from scan3d.files.whole import atomic, check_file, check_pair, folder
    from scan3d.laboratory.importing import KIND, convert, load, with_rig
    from scan3d.laboratory.maps import read_map
    from scan3d.pictures import views
    from scan3d.recording import joined

    inputs = {"table": raw, "map": map, "rig": rig}
    if after:
        inputs |= {"recording before": after, "TOML file of the recording before": sidecar(after)}
    if out:
        check_path(out)
    written = None if dry_run else out
    if written:
        check_pair(written, sidecar(written), inputs, overwrite, kind=KIND)
    drawn = picture or (raw.with_suffix(".png") if dry_run else None)
    if drawn:
        check_file(views.check_path(drawn), inputs, overwrite, "--picture")
    chosen = read_map(map)
    if rig:
        chosen = with_rig(chosen, str(rig))
    output.progress.tell("load")
    imported = convert(load(raw, chosen), chosen)
    facts = _facts(imported)
    if written:
        output.progress.tell("write")
        with folder(written.parent):
            before = [read_recording(after)] if after else []
            write_recording(joined([*before, imported.recording]), written, overwrite=True)  # checked above
        for one in before:
            counts = f"{len(one)} samples in {len(set(one.sweep.tolist()))} sweeps"
            facts.append(("after", f"{counts} of {after}, which are written as well"))
    if drawn:
        with folder(drawn.parent, "--picture"), atomic(drawn, "--picture") as file:
            views.draw(views.import_figure, imported, file)
    paths = {"recording": str(written) if written else None, "picture": str(drawn) if drawn else None}
    places = [("written to", path) for path in paths.values() if path]
    text = table(f"{imported.summary.table}, imported", [*facts, *places])
    if dry_run:
        first = recording_files(imported.recording, "first.csv")["first.csv"].decode().splitlines()[:7]
        text += "\n\n" + "\n".join(printable(line) for line in first)
    print_result(output, dataclasses.asdict(imported.summary) | paths, text)
    for note in imported.summary.notes:
        say(f"note: {note}")
    return 0


def _guess(raw: Path, map_file: Path | None, overwrite: bool, output: Output) -> int:
    from scan3d.files.whole import folder, write_atomic
    from scan3d.laboratory.maps import guess_map

    path = map_file or raw.with_suffix(".map.toml")
    if path.exists() and not overwrite:
        raise InputError(f"{path} exists already; give --overwrite to replace it, or choose another place with --map")
    guess = guess_map(raw)
    with folder(path.parent, "--map"):
        write_atomic(path, guess.text.encode(), "--map")
    text = printable(f"a first map, written to {path}; check every line, and complete: {', '.join(guess.open)}")
    return print_result(output, {"map": str(path), "open": list(guess.open)}, text)


def _facts(imported: Imported) -> list[tuple[str, str]]:
    done = imported.summary
    rate = "" if done.rate_hz is None else f" in {done.seconds:.4g} s, {done.rate_hz:.4g} Hz"
    left_out = ", ".join(f"{count} {reason}" for reason, count in done.left_out.items() if count) or "none"
    touching = f"{done.sweeps_with_contact} of them with contact"
    probings = f", {done.probings} of them probings" if done.probings else ""
    axes = "six, for the model in space" if done.six_axis else "three, for the planar model"
    known = imported.recording.completed
    rows = [
        ("table", f"{done.rows} rows{rate}"),
        ("recording", f"{done.samples} samples in {done.sweeps} sweeps{probings}, {touching}"),
        ("left out", left_out),
        *([("ringing", f"{done.ringing} rows, which count as rows without contact")] if done.ringing else []),
        ("axes", axes if known is None else f"{axes}, by {known.words}"),
    ]
    if done.air:
        unit = "s" if done.rate_hz is not None else "rows"
        some = ", ".join([*(f"{a:.4g} to {b:.4g}" for a, b in done.air[:3]), *["..."] * (len(done.air) > 3)])
        rows.append(("in the air", f"{len(done.air)} stretches, {share(done.air_fraction)} of the rows: {some} {unit}"))
        for what, sizes in (("zero taken off", done.zero), ("drift", done.drift)):
            largest, turning = (max(map(abs, part)) for part in (sizes[:3], sizes[3:]))
            rows.append((what, f"up to {force(largest)} and {moment(turning)}"))
    else:
        rows.append(("in the air", "not tared"))
    noise = f"{force(done.noise_force_N)} and {moment(done.noise_moment_Nm)}, standard deviations"
    filtered = "" if done.noise_factor == 1 else f"; the filter leaves {done.noise_factor:.2g} of white noise"
    return [*rows, ("noise", noise + filtered)]
