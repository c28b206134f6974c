"""The commands of a scan: each function's parameters are its arguments and options, and it returns an exit code.

Numerical libraries are imported inside the functions, so that ``scan3d --help`` is quick and ``scan3d doctor`` runs where they
are missing.
"""

from __future__ import annotations

import dataclasses
import time
from functools import partial
from itertools import chain, count
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Group, Parameter

from scan3d.choices import Export, Method, Model
from scan3d.cli.rig import OF_SURFACES, RIG_OPTIONS, refuse_settings_of_scans, rigged, simulate_rig
from scan3d.cli.terminal import (
    File,
    Flag,
    Folder,
    Mesh,
    Number,
    Options,
    Output,
    Overwrite,
    Rig,
    Strict,
    duration,
    print_result,
    print_settings,
    printable,
    say,
    table,
)
from scan3d.errors import InputError, UsageError
from scan3d.files.text import parse_rod
from scan3d.settings import Settings, settings
from scan3d.units import UNITS_M, Unit, length, number, share, unit_question, unit_remark

_OF_ONE_SWEEP = Parameter(
    group=Group(
        "One sweep in one plane",
        help="The table may be a .csv of one sweep, or of touches at one place of the base, with the columns x0, f0x, f0y, "
        "m0z (dimensionless) or x0_m, f0x_N, f0y_N, m0z_Nm.  One reaction may be missing, f0x only of a tapered rod, if "
        "[known] in its TOML file has the friction, or contact = 'tip'.",
    )
)
# Settings of the demonstration: few slices, so that it takes some seconds, and what they leave unknown can be seen.
DEMO_SETTINGS = {"slices": 24, "friction": "0.1:0.4"}


def scan(
    mesh: Mesh,
    /,
    *,
    out: Folder | None = None,
    options: Options = Options(),
    overwrite: Overwrite = False,
    strict: Strict = False,
    output: Output = Output(),
) -> int:
    """All steps: simulate, reconstruct, build the surface, compare.

    For example:
      scan3d scan meshes/egg.stl
      scan3d scan part.stl --out out --unit in --slices 128 --axis xyz
      scan3d scan part.stl --out out --friction 0.0:0.4 --noise 1e-4 --seed 7
      scan3d scan part.stl --out out --config settings.toml --json

    Parameters
    ----------
    mesh
        a closed mesh: STL, PLY, OBJ, OFF or GLB
    out
        folder for the results (default: beside the mesh, such as part-scan; part-scan-2 if that exists)
    """
    chosen = options.chosen()
    if options.print_config:
        return print_settings(dataclasses.asdict(chosen))
    inputs = {"file of settings": options.config}
    out = out or _beside(mesh)
    return _report(_scanned(mesh, chosen, out, overwrite, output, inputs), out, strict, output)


def _beside(mesh: Path) -> Path:
    """A folder beside a mesh that does not exist."""
    names = (f"{mesh.stem}-scan{number}" for number in chain([""], map("-{}".format, count(2))))
    return next(place for place in map(mesh.with_name, names) if not place.exists())


def demo(*, out: Folder = Path("scan3d-demo"), overwrite: Overwrite = False, output: Output = Output()) -> int:
    """Scan a body that comes with the program, and say what to open.

    Parameters
    ----------
    out
        folder for the results
    """
    from scan3d.results import DEMO

    code = _report(_scanned(DEMO, settings(DEMO_SETTINGS), out, overwrite, output), out, False, output)
    if not (output.json or output.quiet):
        page, place = printable(str(out / "view.html")), printable(str(out))
        drawn = {
            f"scan3d show {place}": "the scan in a window",
            f"scan3d show {place} --view compare": "a picture beside the true body",
        }
        further = drawn if (out / "surface.png").exists() else {"scan3d doctor": "what windows and pictures need here"}
        further |= {"scan3d scan part.stl --out out": "a scan of your own mesh"}
        print(f"\nOpen {page} in a browser. To go on with:")
        width = max(map(len, further))
        print("\n".join(f"  {command:{width}}  {what}" for command, what in further.items()))
    return code


def simulate(
    mesh: Mesh,
    /,
    *,
    out: File,
    options: Options = Options(),
    poses: Annotated[File | None, RIG_OPTIONS] = None,
    faults: Annotated[File | None, RIG_OPTIONS] = None,
    placed: Annotated[File | None, RIG_OPTIONS] = None,
    overwrite: Overwrite = False,
    output: Output = Output(),
) -> int:
    """Step 1 only: a recording of a simulated scan.

    For example:
      scan3d simulate part.stl --out log.csv
      scan3d simulate part.stl --out log.csv --rod steel:0.3x50 --sweeps 24
      scan3d simulate part.stl --poses poses.csv --out raw.csv --faults faults.toml

    Parameters
    ----------
    mesh
        a closed mesh: STL, PLY, OBJ, OFF or GLB
    out
        the recording, a .csv; a .toml of the same name is written as well
    poses
        the poses, a .csv as scan3d plan writes it
    faults
        what the rig does to the log: a .toml; a map for import is written
    placed
        write the mesh where it stands in the world, a .ply
    """
    import numpy as np

    from scan3d.files.meshes import load_mesh
    from scan3d.files.recordings import check_path, sidecar, write_recording
    from scan3d.files.whole import check_pair, folder
    from scan3d.pipeline import with_origin
    from scan3d.simulation.scan import simulate as simulate_scan

    if poses is None:
        for name, given in (("faults", faults), ("placed", placed)):
            if given:
                raise UsageError(f"--{name} is for a rig: give --poses FILE as well")
        for name in OF_SURFACES:
            if name in options.given():
                raise UsageError(
                    f"--{name} is of a surface, and simulate makes a recording; give it to scan3d reconstruct"
                )
    else:
        refuse_settings_of_scans(options.given())
    chosen = options.chosen()
    if options.print_config:
        return print_settings(dataclasses.asdict(chosen))
    if poses is not None:
        return simulate_rig(mesh, out, options, poses, faults, placed, overwrite, output)
    check_path(out)
    check_pair(out, sidecar(out), {"mesh": mesh, "file of settings": options.config}, overwrite)
    plan = chosen.plan()
    body = load_mesh(mesh, hull=chosen.hull, unit=plan.unit)
    if question := unit_question(float(body.extents.max()), plan.unit):
        output.progress.say(question)
    with folder(out.parent):
        recording = simulate_scan(body, plan)
        write_recording(with_origin(recording, body), out, overwrite=True)  # checked above
    data = {"recording": str(out), "samples": len(recording), "sweeps": len(np.unique(recording.sweep))}
    text = printable(f"{data['samples']} samples in {data['sweeps']} sweeps, written to {data['recording']}")
    return print_result(output, data, text)


def reconstruct(
    recording: Path,
    /,
    *,
    out: Folder | None = None,
    truth: Mesh | None = None,
    hull: Flag = False,
    method: Method = "auto",
    reach: float = 0.0,
    model: Model | None = None,
    rig: Rig = None,
    table: float | None = None,
    rod: Annotated[str | None, _OF_ONE_SWEEP] = None,
    noise_force: Annotated[float | None, _OF_ONE_SWEEP] = None,
    noise_moment: Annotated[float | None, _OF_ONE_SWEEP] = None,
    overwrite: Overwrite = False,
    strict: Strict = False,
    output: Output = Output(),
) -> int:
    """Step 2 only, from a simulated or measured recording.

    For example:
      scan3d reconstruct log.csv --out out
      scan3d reconstruct log.csv --out out --truth part.stl --method hull
      scan3d reconstruct sweep.csv
      scan3d reconstruct sweep.csv --rod steel:0.3x50 --noise-force 1e-4 --noise-moment 2e-6 --out sweep

    Parameters
    ----------
    recording
        the .csv or .parquet of a recording; its .toml is in the same folder
    out
        folder for the results; of one sweep also its picture (default: beside the table)
    truth
        mesh of the true body, to compare the surface with
    hull
        take the convex hull of the true body
    method
        surface from the contacts; bracket estimates it between the certified bounds, auto chooses
    reach
        radius, in the recording's unit, of the finest feature of a body that is not convex, which bounds it; 0: not known
    model
        model of contact (default: spatial for a recording with six axes, else planar)
    rig
        the .toml of a calibrated rig, with which the recording is corrected
    table
        height of the table on which the body stands, in the recording's unit (default: that of its .toml, or none)
    rod
        MATERIAL:DIAMETERxLENGTH in mm, such as steel:0.3x50, for columns in SI units
    noise_force
        standard deviation of each force component, in the unit of its column (default: that of the .toml, or unknown)
    noise_moment
        standard deviation of the moment, in the unit of its column (default: that of the .toml, or unknown)
    """
    from scan3d import pipeline
    from scan3d.files.meshes import load_mesh
    from scan3d.files.recordings import read_recording, sidecar
    from scan3d.files.whole import RECORDING
    from scan3d.laboratory.one_sweep import is_sweep

    of_recording = {
        "truth": truth is not None,
        "hull": hull,
        "method": method != "auto",
        "reach": reach != 0,
        "model": model is not None,
        "rig": rig is not None,
        "table": table is not None,
        "strict": strict,
    }
    of_sweep = {
        "rod": rod is not None,
        "noise-force": noise_force is not None,
        "noise-moment": noise_moment is not None,
    }
    given, needed = of_sweep, f"one sweep in one plane, which {recording.name} is not"
    if is_one := is_sweep(recording):
        given, needed = of_recording, f"a recording with poses, and {recording.name} is one sweep in one plane"
    elif out is None:
        raise UsageError("--out is missing: it names the folder for the results")
    if wrong := [f"--{name}" for name, is_given in given.items() if is_given]:
        raise UsageError(f"{', '.join(wrong)} can be used only with {needed}")
    if is_one:
        return _reconstruct_sweep(recording, rod, noise_force, noise_moment, out, overwrite, output)
    assert out is not None
    # the remaining settings concern the simulation
    used = {"method": method, "hull": hull, **({"reach": reach} if reach else {})}
    settings(used)

    def read() -> tuple[Any, Any]:
        measured = rigged(read_recording(recording), rig)
        if table is not None:
            measured = dataclasses.replace(measured, table_m=UNITS_M[measured.unit] * table)
        return measured, None if truth is None else load_mesh(truth, hull=hull, unit=measured.unit)

    kept = out / RECORDING[0]
    if (rig or table is not None) and kept.exists() and recording.exists() and kept.samefile(recording):
        raise InputError(
            f"{out} keeps the recording that its results are made from, which --{'rig' if rig else 'table'} changes; choose "
            "another folder with --out"
        )
    inputs = {"recording": recording, "TOML file of the recording": sidecar(recording), "true body": truth, "rig": rig}
    _, data = pipeline.reconstruct(
        read,
        out,
        settings=used,
        model=model,
        inputs=inputs,
        overwrite=overwrite,
        notify=output.progress.say,
    )
    return _report(data, out, strict, output)


def surface(
    points: Annotated[list[Path], Parameter(metavar="POINTS...")],
    /,
    *,
    out: Folder | None = None,
    truth: Mesh | None = None,
    hull: Flag = False,
    method: Method = "auto",
    unit: Unit | None = None,
    place_sd: float | None = None,
    normal_sd: float | None = None,
    table: float | None = None,
    overwrite: Overwrite = False,
    strict: Strict = False,
    output: Output = Output(),
) -> int:
    """The surface of a body from touches of another probe, with a certificate if the body is convex.

    The columns are x, y, z, and where they are known the outward normals nx, ny, nz and the standard deviations
    place_sd and normal_sd (in radians), or cov_xx to cov_zz. Touches with normals bound a convex body; with deviations
    with 95 % confidence.

    For example:
      scan3d surface touches.csv --out out
      scan3d surface cmm.xyz --unit in --place-sd 0.0002 --out out
      scan3d surface rod1-scan/cloud.ply rod2-scan/cloud.ply --out both
      scan3d surface robot.pcd --unit m --place-sd 0.0005 --normal-sd 0.05 --truth part.stl --out out

    Parameters
    ----------
    points
        a table (.csv, .xyz, .xlsx ...), .ply, .pcd or matrix (.mat, .npy ...) with a touch in each row, or several of one
        body, as of the rods of an array
    out
        folder for the results (default: beside the file, such as touches-scan; touches-scan-2 if that exists)
    truth
        mesh of the true body, in the unit of the touches, to compare with
    hull
        take the convex hull of a true body that is not convex
    method
        of the surface, as in scan3d reconstruct
    unit
        unit of the touches, where the file does not state it (default mm)
    place_sd
        standard deviation of each coordinate, in that unit, where the file has none
    normal_sd
        standard deviation of a normal's direction across it, in radians, where the file has none
    table
        height of the table that the body stands on, in that unit
    """
    from scan3d import pipeline
    from scan3d.files.meshes import load_mesh
    from scan3d.files.points import read_all_points
    from scan3d.files.shapes import NORMAL
    from scan3d.results import touches
    from scan3d.surfaces.open3d_methods import check_method

    check_method(method)
    out = out or _beside(points[0])

    def read() -> tuple[Any, Any]:
        file = read_all_points(points)
        if file.left_out:
            output.progress.say(f"rows without a place in {file.name}: {file.left_out}, left out")
        cloud = touches(file, place_sd=place_sd, normal_sd=normal_sd, unit=unit, table=table)
        if (normals := file.stacked(NORMAL)) is not None and ((normals * cloud.normals).sum(axis=1) < 0).any():
            output.progress.say(f"normals of {file.name} point inwards: all are turned round")
        return cloud, None if truth is None else load_mesh(truth, hull=hull, unit=cloud.unit)

    _, data = pipeline.reconstruct(
        read,
        out,
        settings={"method": method, "place_sd": place_sd, "normal_sd": normal_sd, "table": table},
        inputs={**{f"touches {k}": path for k, path in enumerate(points, 1)}, "true body": truth},
        overwrite=overwrite,
        notify=output.progress.say,
    )
    return _report(data, out, strict, output)


def compare(first: Mesh, second: Mesh, /, *, unit: Unit | None = None, output: Output = Output()) -> int:
    """Hausdorff distance and other measures of two meshes, convex or not.

    For example:
      scan3d compare out/surface.ply part.stl
      scan3d compare a.stl b.stl --unit in --json

    Parameters
    ----------
    first
        a mesh, such as a reconstructed surface
    second
        the mesh to compare with, such as the truth
    unit
        unit to print, and of files that state none (default: what one of them states, or mm)
    """

    from scan3d.comparison import compare as compare_meshes
    from scan3d.files.meshes import common_unit, read_mesh

    in_unit = unit or common_unit(first, second)
    bodies = [read_mesh(path, in_unit) for path in (first, second)]
    comparison = compare_meshes(*bodies)
    if remark := unit_remark(*(body.extents for body in bodies)):
        say(remark)
    return print_result(output, dataclasses.asdict(comparison), table("", comparison.summary(in_unit)))


def export(
    source: Path,
    /,
    *,
    to: File,
    what: Export | None = None,
    unit: Unit | None = None,
    faces: Number | None = None,
    error: float | None = None,
    section: Annotated[str | None, Parameter(metavar="AXIS=HEIGHT")] = None,
    overwrite: Overwrite = False,
    output: Output = Output(),
) -> int:
    """Write the cloud or the surface in another format.

    Clouds go to .ply, .pcd, .vtp, .xyz, .xyzn, .csv, .mat and .glb, surfaces to .stl, .ply, .obj, .vtp, .mat and .glb.
    Unit, frame, normals and scalars are kept where the format can contain them. .glb is in metres, with y up. ParaView
    and PyVista read bound and known from .vtp and .glb, not from .ply. A --section goes to .dxf and .csv.

    For example:
      scan3d export out --to egg.glb
      scan3d export out --to egg.vtp --what cloud
      scan3d export out/cloud.ply --to egg.pcd --unit m
      scan3d export out --to egg.stl --faces 5000
      scan3d export out --to rim.dxf --section z=12.5

    Parameters
    ----------
    source
        folder of a scan, or one of its PLY files
    to
        the file to write; its ending determines the format
    what
        which, for .ply, .vtp, .mat and .glb (default: the surface, if there is one)
    unit
        unit of the lengths in the file, such as m for ROS (default: the recording's)
    faces
        leave the surface at most so many triangles
    error
        leave the surface as few triangles as are within this distance of it
    section
        the curves in which a plane such as z=12.5 cuts the surface, as a .dxf or .csv
    """
    from scan3d.files.reduced import decimated, export_section
    from scan3d.files.shapes import export as export_shape

    if section is not None:
        if what == "cloud" or faces is not None or error is not None:
            raise UsageError("--section is of the whole surface; leave --what, --faces and --error out")
        written = export_section(source, to, section, unit=unit, overwrite=overwrite)
        curves = "1 curve" if written["curves"] == 1 else f"{written['curves']} curves"
        text = f"{curves} with {written['points']} points in {written['unit']}, written to {written['file']}"
        return print_result(output, written, printable(text))
    if faces is not None and error is not None:
        raise UsageError("--faces and --error are two ways to say how far; leave one of them out")
    reduced = {} if faces is None and error is None else {"changed": partial(decimated, faces=faces, error=error)}
    written = export_shape(source, to, what, unit=unit, overwrite=overwrite, **reduced)
    shape = f"{written['points']} contacts"
    if written["what"] == "surface":
        shape = f"a surface of {written['points']} vertices and {written['faces']} faces"
        if reduced:
            shape += f", within {length(written['off'], written['unit'], up=True)} of the whole one,"
    if written["left_out"]:
        shape += f" ({written['left_out']} without a normal are left out)"
    return print_result(output, written, printable(f"{shape} in {written['unit']}, written to {written['file']}"))


def batch(
    mesh: Annotated[list[str], Parameter(metavar="MESH...")],
    /,
    *,
    out: Folder,
    jobs: Number | None = None,
    scheduler: Annotated[str | None, Parameter(metavar="ADDRESS")] = None,
    grid: File | None = None,
    options: Options = Options(),
    overwrite: Overwrite = False,
    output: Output = Output(),
) -> int:
    """Many scans: meshes, and combinations of settings, with one summary.

    Scans every mesh, with every combination of the settings in --grid. What an earlier call has finished
    with the same mesh, settings and version is not repeated, and failures do not stop the other runs.

    For example:
      scan3d batch meshes --out study --jobs 2
      scan3d batch 'parts/**/*.stl' --out study --friction 0.0:0.4 --slices 32
      scan3d batch egg.stl cube.stl --out study --grid grid.toml
      scan3d batch meshes --out study --scheduler tcp://node1:8786

    Parameters
    ----------
    mesh
        mesh files, folders of them, or patterns such as 'parts/*.stl'
    out
        folder for the summary and for the results of each run
    jobs
        runs side by side on this machine (default 1)
    scheduler
        address of the scheduler of a Dask cluster, such as tcp://node1:8786 (needs scan3d[cluster]); it asks for no
        password, and runs what anyone sends who reaches its port
    grid
        TOML file with lists of values by setting; every combination is a run
    """
    if jobs is not None and jobs < 1:
        raise UsageError(f"--jobs must be a whole number of at least 1, got {jobs}")
    if jobs is not None and scheduler is not None:
        raise UsageError("--jobs and --scheduler are two places for the runs; leave one of them out")
    if options.print_config:
        if grid:
            raise UsageError("--print-config prints one setting; leave out --grid")
        return print_settings(dataclasses.asdict(options.chosen()))
    from scan3d.batches import batch as scan_batch
    from scan3d.batches import scheduled
    from scan3d.workers import Workers, said_if_ended

    def show(now: Any) -> None:
        failed = f", {now.failed} failed" if now.failed else ""
        output.progress.tell(f"runs{failed}", now.done, now.total)

    start = time.monotonic()
    kept = f"finished runs are kept in {out}: the same command goes on with the others"
    with said_if_ended(kept), scheduled(scheduler) if scheduler else Workers(jobs or 1) as executor:
        done = scan_batch(
            mesh,
            out,
            executor,
            grid=grid,
            config=options.config,
            overwrite=overwrite,
            progress=show,
            notify=output.progress.say,
            **options.given(),
        )
    return _batch_report(done, out, time.monotonic() - start, output)


def _batch_report(done: Any, out: Path, seconds: float, output: Output) -> int:
    failed, figures = done.failures, done.figures()
    counts = figures["counts"]
    before = f", {counts['runs'] - done.computed} of them by an earlier call" if done.computed < counts["runs"] else ""
    in_all = f"{counts['done']} done, {counts['failed']} failed, in {duration(seconds)}"
    rows = [(name, _figures(row)) for name, row in done.ranks._asdict().items() if row is not None]
    rows += [("failed", f"{row['run']}: {row['error']}") for row in failed[:20]]
    if len(failed) > 20:
        rows.append(("failed", f"and {len(failed) - 20} more, which summary.csv names"))
    data = {"out": str(out), "counts": counts, "computed": done.computed, "seconds": round(seconds, 3)} | figures
    heading = f"{counts['runs']} runs{before}: {in_all}"
    print_result(output, data, table(heading, [*rows, ("written to", str(out))]))
    if failed:
        say(f"{len(failed)} of {counts['runs']} runs failed; summary.csv in {out} says why")
    return 1 if failed else 0


def _figures(row: dict[str, Any]) -> str:
    certified = row["certificate_relative"]
    bound = "" if certified is None else f", certified within {share(certified, up=True)}"
    of = "" if row["scanned"] in (None, "mesh") else f" of the {row['scanned']}"
    return f"{share(row['hausdorff_relative'])} of the diagonal{bound}{of} ({row['run']})"


def _scanned(
    mesh: Path, chosen: Settings, out: Path, overwrite: bool, output: Output, inputs: Any = None
) -> dict[str, Any]:
    from scan3d import pipeline

    return pipeline.scan(mesh, chosen, out, inputs=inputs, overwrite=overwrite, notify=output.progress.say)[1]


def _report(data: dict[str, Any], out: Path, strict: bool, output: Output) -> int:
    from scan3d.report import summary

    heading, rows = summary(data)
    print_result(output, data, table(heading, [*rows, ("written to", str(out))]))
    for warning in data["warnings"]:
        say(f"warning: {warning['message']}")
    return 1 if strict and data["warnings"] else 0


def _reconstruct_sweep(
    recording: Path,
    rod_name: str | None,
    noise_force: float | None,
    noise_moment: float | None,
    out: Path | None,
    overwrite: bool,
    output: Output,
) -> int:
    """Contour and friction of one sweep: a summary, the contacts as CSV, and a picture."""
    from scan3d.files.recordings import sidecar
    from scan3d.files.whole import atomic, check_file, folder, write_atomic
    from scan3d.laboratory.one_sweep import contacts_csv, read_sweep, reconstruct_sweep
    from scan3d.pictures import views

    rod = parse_rod(rod_name) if rod_name else None
    if rod_name and rod is None:
        raise UsageError("--rod auto is for simulated scans; name the rod as MATERIAL:DIAMETERxLENGTH")
    # in the folder of the table, or where --out says
    place = recording.parent if out is None else out
    picture = place if place.suffix.lower() in (".png", ".pdf") else place / "sweep.png"
    contacts = picture.with_name("contacts.csv")
    found = reconstruct_sweep(read_sweep(recording, rod, noise_force, noise_moment))
    inputs = {"table": recording, "TOML file of the table": sidecar(recording)}
    with folder(picture.parent):
        text = contacts_csv(found)
        check_file(picture, inputs, overwrite, "--out")
        check_file(contacts, inputs, True, "--out")
        if contacts.exists() and not overwrite and _first_column(contacts.read_bytes()) != _first_column(text):
            raise InputError(
                f"{contacts} holds other contacts than those of this table; name another folder by --out, or give --overwrite"
            )
        with atomic(picture) as path:
            views.draw(views.sweep_figure, found, path)
        write_atomic(contacts, text)
    data = _figures_of_sweep(found) | {"files": [str(contacts), str(picture)]}
    return print_result(output, data, table("", _rows_of_sweep(data)))


def _first_column(table: bytes) -> list[bytes]:
    return [line.partition(b",")[0] for line in table.splitlines()]


def _figures_of_sweep(found: Any) -> dict[str, Any]:
    """The key figures of a sweep; lengths in mm if the rod is known, else in rod lengths."""
    import numpy as np

    import planar

    sweep, contacts, touching, tangential = found.sweep, found.contacts, found.touching, found.tangential
    scale, unit = (1e3 * sweep.rod.length_m, "mm") if sweep.rod else (1.0, "rod lengths")
    codes, counts = np.unique(contacts.status[~touching & ~found.undetermined], return_counts=True)
    # a contact of the tip is at the rod's end, which its error may put farther along
    friction, s1 = contacts.friction[tangential], scale * np.minimum(contacts.s1[touching], 1.0)
    data = {
        "unit": unit,
        "samples": len(sweep),
        "direction": sweep.direction,
        "contacts": int(touching.sum()),
        "tip": int(touching.sum() - tangential.sum()),
        "tangential": int(tangential.sum()),
        "undetermined": int(found.undetermined.sum()),
        "not_measured": list(found.unmeasured),
        "without_contact": {planar.Status(c).sentence: int(n) for c, n in zip(codes, counts, strict=True)},
        "s1": [float(s1.min()), float(s1.max())],
        "friction_assumed": sweep.known.friction if sweep.known else None,
        "friction_median": float(np.median(friction)) if len(friction) else None,
        "friction_range": [float(friction.min()), float(friction.max())] if len(friction) else None,
    }
    if found.noisy:
        sd = scale * found.errors.largest[touching]
        data["place_sd_median"], data["place_sd_largest"] = float(np.nanmedian(sd)), float(np.nanmax(sd))
        data["friction_sd_median"] = float(np.nanmedian(found.friction_sd[tangential])) if len(friction) else None
        data["only_rounding"] = found.only_rounding
    return data


def _rows_of_sweep(data: dict[str, Any]) -> list[tuple[str, str]]:
    unit, friction = data["unit"], "not known, as no contact is tangential"
    ask = "give the noise by --noise-force and --noise-moment"

    def size(value: float, digits: int = 3) -> str:
        return length(value, unit, digits=digits) if unit == "mm" else f"{number(value, digits)} {unit}"

    if data["friction_assumed"] is not None:
        friction = f"{number(data['friction_assumed'])}, assumed: it stands in [known]"
    elif data["friction_median"] is not None:
        low, high = map(number, data["friction_range"])
        friction = f"{number(data['friction_median'])}, median of {low} to {high}"
        if "friction_sd_median" in data:
            friction += f", standard deviation of one contact {number(data['friction_sd_median'], 2)}"
    place = f"not known: {ask}"
    if "place_sd_median" in data:
        median, largest = (size(data[f"place_sd_{name}"], 2) for name in ("median", "largest"))
        by_rounding = f"; by rounding alone: {ask}" if data["only_rounding"] else ""
        place = f"{median}, median of the standard deviations; largest {largest}{by_rounding}"
    without = [("not measured", words) for words in data["not_measured"]]
    without += [("without contact", f"{count}: {reason}") for reason, count in data["without_contact"].items()]
    if data["undetermined"]:
        without.append(("undetermined", f"{data['undetermined']}: the reactions measured leave the contact open"))
    return [
        ("samples", f"{data['samples']}, base {('at rest', 'moving in +x', 'moving in -x')[data['direction']]}"),
        ("contacts", f"{data['contacts']} ({data['tip']} of the tip, {data['tangential']} tangential)"),
        *without,
        ("s1", " to ".join(size(value, 4) for value in data["s1"])),
        ("friction", friction),
        ("error of the place", place),
        ("written to", ", ".join(data["files"])),
    ]
