"""The command ``scan3d calibrate``, and the option ``--rig`` of others.

Numerical libraries are imported inside the functions, so that ``scan3d --help`` is quick.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any

from scan3d.choices import TARES
from scan3d.cli.terminal import one_line, printable, printable_json
from scan3d.units import UNITS_M

EXAMPLES = """\
  scan3d calibrate touches.csv --sphere 30 --out rig.toml
  scan3d calibrate touches.csv --plane --out rig.toml --pose-noise 0.02 --json
  scan3d calibrate touches.csv --mesh gauge_block.stl --out rig.toml"""


def add(commands: Any, add_overwrite: Callable[[Any], None], add_output: Callable[[Any], None]) -> None:
    """Add the command to the others."""
    calibrate = commands.add_parser(
        "calibrate",
        help="rod, clamp and sensor of a rig, from touches of a sphere, a plane or a known body",
        description="The rod's stiffness and length, the clamp's offset and turn, the sensor's place and turn and its tare,\n"
        "with uncertainties, from sweeps over a reference: a sphere of known diameter, a plane, or a convex body whose mesh\n"
        "is known. Where the reference is need not be known.",
    )
    calibrate.add_argument("recording", metavar="REC", help="the .csv of a recording; its .toml is in the same folder")
    reference = calibrate.add_mutually_exclusive_group(required=True)
    reference.add_argument(
        "--sphere", type=float, metavar="D", help="the reference is a sphere of this diameter, in mm or in --unit"
    )
    reference.add_argument("--plane", action="store_true", help="the reference is flat, such as a surface plate")
    reference.add_argument(
        "--mesh", metavar="MESH", help="the reference is the convex body of this mesh file, with coordinates in --unit"
    )
    calibrate.add_argument("--out", required=True, metavar="FILE", help="the rig, a .toml")
    calibrate.add_argument(
        "--unit",
        default="mm",
        choices=tuple(UNITS_M),
        metavar="UNIT",
        help="unit of --sphere, --mesh and --pose-noise (default mm)",
    )
    calibrate.add_argument(
        "--tare",
        default=TARES[0],
        choices=TARES,
        metavar="MODEL",
        help=f"what the sensor shows in the air: {', '.join(TARES[:-1])} or {TARES[-1]} (default {TARES[0]})",
    )
    calibrate.add_argument(
        "--pose-noise",
        type=float,
        metavar="S",
        help="standard deviation of the clamp's coordinates (default: estimated)",
    )
    add_overwrite(calibrate)
    add_output(calibrate)
    calibrate.set_defaults(command="calibrate")


def add_rig(parser: Any) -> None:
    """Add the option with which a command corrects a recording."""
    parser.add_argument(
        "--rig", metavar="RIG", help="the .toml of a calibrated rig, with which the recording is corrected"
    )


def calibrate(arguments: argparse.Namespace) -> int:
    """Calibrate a rig, and write it."""
    from scan3d.files.recordings import read_recording, sidecar
    from scan3d.files.text import to_json
    from scan3d.laboratory.calibration import calibrate as calibrate_rig
    from scan3d.laboratory.calibration_file import check_path, sections, write_rig
    from scan3d.laboratory.rigged import not_rigged

    inputs = {"recording": arguments.recording, "TOML file of the recording": sidecar(arguments.recording)}
    if arguments.mesh is not None:
        inputs["mesh"] = arguments.mesh
    check_path(arguments.out, inputs, arguments.overwrite)
    scale = UNITS_M[arguments.unit]
    noise = None if arguments.pose_noise is None else scale * arguments.pose_noise
    recording = read_recording(arguments.recording)
    not_rigged(recording.source, "the recording")
    found = calibrate_rig(
        recording, _reference(arguments), unit=arguments.unit, tare=arguments.tare, pose_noise_m=noise
    )
    write_rig(found, arguments.out, overwrite=True)  # checked above
    arguments.progress.end()
    if arguments.json:
        print(printable_json(to_json(sections(found)).decode()), end="")
    elif not arguments.quiet:
        print("\n".join([*_table(found), printable(f"written to {arguments.out}")]))
    if not arguments.quiet:
        for sentence in found.sentences:
            print(f"scan3d: {one_line(sentence)}", file=sys.stderr)
    return 0


def _reference(arguments: argparse.Namespace) -> Any:
    """What was touched, as `scan3d.calibrate` takes it."""
    if arguments.plane:
        return "plane"
    if arguments.mesh is None:
        return UNITS_M[arguments.unit] * arguments.sphere
    from scan3d.files.meshes import load_mesh

    return load_mesh(arguments.mesh)


def rigged(recording: Any, rig: str | None) -> Any:
    """The recording, corrected by a rig if one is named."""
    if rig is None:
        return recording
    from scan3d.laboratory.calibration_file import read_rig
    from scan3d.laboratory.rigged import not_rigged

    not_rigged(recording.source, "the recording")
    return read_rig(rig).applied(recording)


def _table(found: Any) -> list[str]:
    """The quantities, their uncertainties, and what the fit says of its premises, as lines."""
    lines = [f"{'quantity':24} {'value':>12} {'standard u':>11} {'expanded U':>11}  determined"]
    for name, value, deviation, well in zip(
        found.names, found.values, found.standard_deviations, found.well, strict=True
    ):
        if deviation == float("inf"):
            lines.append(f"{name:24} {value:12.6g} {'-':>11} {'-':>11}  no, nominal")
        else:
            lines.append(
                f"{name:24} {value:12.6g} {deviation:11.2g} {2 * deviation:11.2g}  {'well' if well else 'poorly'}"
            )
    details = found.details
    lines.append(
        f"chi2 per degree of freedom {found.chi2:.3f}, of the wrench alone {found.consistency:.3f}; pose noise "
        f"{1e6 * found.pose_noise_m:.2g} um ({details['pose_noise']}); {details['contacts']} contacts, "
        f"{details['tip_contacts']} of the tip, {details['air']} rows in the air, tare {details['tare']}"
    )
    return lines
