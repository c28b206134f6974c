"""The command export: its arguments, and what it does."""

from __future__ import annotations

import argparse
from argparse import Namespace
from collections.abc import Callable
from typing import Any

from scan3d.choices import EXPORTS, SCALAR_NAMES
from scan3d.cli.terminal import print_result, printable
from scan3d.units import UNITS_M

EXAMPLES = {
    "export": """\
  scan3d export out --to egg.glb
  scan3d export out --to egg.vtp --what cloud
  scan3d export out/cloud.ply --to egg.pcd --unit m
  scan3d export out --to egg.ply --color bound --scalar-names meshlab"""
}
_DESCRIPTION = """\
Clouds go to .ply, .pcd, .vtp, .xyz, .xyzn, .csv, .glb and .mcap (a bag of ROS 2), surfaces to .stl, .ply, .obj, .vtp
and .glb. Unit, frame, normals and scalars are kept where the format can contain them.
.glb and .mcap are in metres, and .glb has y up."""


def add_export(commands: Any, add_overwrite: Callable[[argparse.ArgumentParser], None]) -> argparse.ArgumentParser:
    """Add the command export, which is returned."""
    export: argparse.ArgumentParser = commands.add_parser(
        "export", help="write the cloud or the surface in another format", description=_DESCRIPTION
    )
    export.add_argument("source", metavar="DIR", help="folder of a scan, or one of its PLY files")
    export.add_argument(
        "--to", required=True, metavar="FILE", help="the file to write; its ending determines the format"
    )
    export.add_argument(
        "--what",
        choices=EXPORTS,
        help=f"{' or '.join(EXPORTS)}, for .ply, .vtp and .glb (default {EXPORTS[0]}, unless DIR is a file with a cloud)",
    )
    export.add_argument(
        "--unit",
        choices=tuple(UNITS_M),
        metavar="UNIT",
        help="unit of the lengths in the file, such as m for ROS (default: the recording's)",
    )
    export.add_argument(
        "--color",
        metavar="SCALAR",
        help="red, green and blue by a scalar, such as force or bound, which is written too",
    )
    export.add_argument(
        "--scalar-names",
        choices=SCALAR_NAMES,
        metavar="PROGRAM",
        help=f"names of the scalars of a .ply that {' or '.join(SCALAR_NAMES)} shows by itself",
    )
    add_overwrite(export)
    export.set_defaults(command="export")
    return export


def export(arguments: Namespace) -> int:
    """Write the cloud or the surface in another format."""
    from scan3d.files.exports import export as export_shape

    written = export_shape(
        arguments.source,
        arguments.to,
        arguments.what,
        unit=arguments.unit,
        color=arguments.color,
        scalar_names=arguments.scalar_names,
        overwrite=arguments.overwrite,
    )
    shape = f"{written['points']} contacts"
    if written["what"] == "surface":
        shape = f"a surface of {written['points']} vertices and {written['faces']} faces"
    if written["left_out"]:
        shape += f" ({written['left_out']} without a normal are left out)"
    return print_result(arguments, written, printable(f"{shape} in {written['unit']}, written to {written['file']}"))
