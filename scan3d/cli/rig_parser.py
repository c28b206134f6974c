"""The arguments of the commands for a rig: `plan`, and `simulate` with a list of poses.

Like `parser`, this module does not import a numerical library.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from scan3d.choices import MODELS
from scan3d.units import UNITS_M

AddOptions = Callable[[argparse.ArgumentParser], None]

_AROUND = "bounding body, standing on z = 0 about the z axis: cylinder:DxH, sphere:D or box:AxBxC"
EXAMPLES = {
    "plan": """\
  scan3d plan --around cylinder:80x120 --out poses.csv
  scan3d plan --around box:60x40x30 --out poses.yaml --model spatial --rod steel:0.3x70 --max-force 0.5
  scan3d plan --around sphere:50 --out poses.csv --workspace box:400x400x300 --speed 10""",
    "next": """\
  scan3d next out --out further.csv --around cylinder:80x120
  scan3d next out --recording log.csv --out further.csv --tolerance 0.01""",
}


def add_rig_commands(commands: Any, add_overwrite: AddOptions, add_output: AddOptions) -> None:
    """Add the commands for a rig to the commands of the parser."""
    for command in (_add_plan(commands), _add_next(commands)):
        add_overwrite(command)
        add_output(command)


def _add_plan(commands: Any) -> argparse.ArgumentParser:
    models = f"{', '.join(MODELS[:-1])} or {MODELS[-1]}"
    plan: argparse.ArgumentParser = commands.add_parser("plan", help="poses for an unknown body, from a body around it")
    plan.add_argument("--around", required=True, metavar="BODY", help=_AROUND)
    plan.add_argument(
        "--out", required=True, metavar="FILE", help="the poses, .csv, or .yaml for ROS; a .toml is written as well"
    )
    plan.add_argument(
        "--model",
        choices=MODELS,
        default=MODELS[0],
        metavar="MODEL",
        help=f"model of contact: {models} (default {MODELS[0]})",
    )
    plan.add_argument("--slices", type=int, default=32, metavar="N", help="number of slices (default 32)")
    plan.add_argument(
        "--sweeps",
        type=int,
        metavar="N",
        help="sweeps per slice (default 4), or in the spatial model per direction (default 0.6 times the slices)",
    )
    plan.add_argument(
        "--rod",
        default="auto",
        metavar="ROD",
        help="MATERIAL:DIAMETERxLENGTH in mm, such as steel:0.3x50, or auto: a length that fits (default auto)",
    )
    _add_limits(plan)
    plan.add_argument(
        "--unit",
        default="mm",
        choices=tuple(UNITS_M),
        metavar="UNIT",
        help="unit of the bounding body, of floor, workspace and speed (default mm)",
    )
    plan.set_defaults(command="plan")
    return plan


def _add_next(commands: Any) -> argparse.ArgumentParser:
    further: argparse.ArgumentParser = commands.add_parser(
        "next", help="poses of further sweeps, where what was measured leaves most room"
    )
    further.add_argument("folder", metavar="DIR", help="folder of a scan or a reconstruction")
    further.add_argument(
        "--out",
        required=True,
        metavar="FILE",
        help="the poses, as of plan; a header only where the tolerance is met",
    )
    further.add_argument(
        "--tolerance",
        type=float,
        default=0.0,
        metavar="T",
        help="certified bound, relative to the diagonal, at which no more sweeps are needed (default 0)",
    )
    further.add_argument(
        "--recording", metavar="REC", help="the recording of a reconstruction (default recording.csv in DIR)"
    )
    further.add_argument("--around", metavar="BODY", help=f"{_AROUND} (default that of the plan, or of the contacts)")
    further.add_argument("--sweeps", type=int, default=24, metavar="N", help="about how many sweeps (default 24)")
    further.add_argument("--seed", type=int, default=0, metavar="N", help="of the directions of sweeps in space")
    _add_limits(further)
    further.set_defaults(command="next")
    return further


def _add_limits(parser: argparse.ArgumentParser) -> None:
    """Add the options that say where the clamp may go, and how."""
    parser.add_argument("--samples", type=int, default=128, metavar="N", help="poses per sweep (default 128)")
    parser.add_argument(
        "--clearance",
        type=float,
        default=0.3,
        metavar="X",
        help="distance of the clamp from the bounding body, in rod lengths (default 0.3)",
    )
    parser.add_argument(
        "--max-force", type=float, metavar="N", help="largest contact force in N, by which the clamp keeps farther away"
    )
    parser.add_argument(
        "--floor",
        type=float,
        metavar="Z",
        help="height above which clamp and straight rod stay (default 2 %% of the bounding body's height)",
    )
    parser.add_argument("--workspace", metavar="BODY", help="where the clamp may go, written as the bounding body")
    parser.add_argument("--speed", type=float, default=20.0, metavar="V", help="of the clamp, per second (default 20)")


def add_rig_options(simulate: argparse.ArgumentParser) -> None:
    """Add the options with which `simulate` goes through a list of poses."""
    rig = simulate.add_argument_group("rig", "A rig that goes through a list of poses, in the place of a scan.")
    rig.add_argument("--poses", metavar="FILE", help="the poses, a .csv as scan3d plan writes it")
    rig.add_argument(
        "--faults", metavar="FILE", help="what the rig does to the log: a .toml; a map for import is written"
    )
    rig.add_argument(
        "--as-is", action="store_true", help="leave the body where its mesh has it (default: it stands on z = 0)"
    )
    rig.add_argument("--placed", metavar="FILE", help="write the mesh where it stands in the world, a .ply")
