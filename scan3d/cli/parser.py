"""The arguments of the command line.

This module does not import a numerical library, so that ``scan3d --help`` takes a fraction of a second.
"""

from __future__ import annotations

import argparse
from dataclasses import fields

from scan3d.choices import CAMERAS, METHODS, MODELS, SHELLS, SPACINGS, one_of
from scan3d.cli import batch, calibration, exporting, guide, laboratory_parser, one_sweep, rig_parser, showing
from scan3d.cli.usage import Parser, Version
from scan3d.settings import Settings
from scan3d.units import UNITS_M

_DESCRIPTION = """\
Seeing by touch: sweep a flexible rod along a body, and reconstruct the body from the reactions at the rod's clamp.

  scan3d demo                                              a scan of a body that comes with the program
  scan3d scan meshes/egg.stl --out out                     all steps, with pictures and a report
  scan3d scan part.stl --out out --friction 0.0:0.4        the friction is drawn separately for every sample
  scan3d simulate part.stl --out log.csv                   only a recording, as a rig would log it
  scan3d reconstruct log.csv --out out --truth part.stl    only the reconstruction, compared with the true body
  scan3d calibrate touches.csv --sphere 30 --out rig.toml  rod, clamp and sensor, from touches of a reference
  scan3d import raw.csv --map rig.toml --out log.csv       a laboratory's table becomes a recording
  scan3d compare out/surface.ply part.stl                  Hausdorff distance of two meshes
  scan3d show out                                          an interactive window; --html and --screenshot write files
  scan3d export out --to part.glb                          the surface for other programs
  scan3d plan --around cylinder:80x120 --out poses.csv     poses of a robot for an unknown body
  scan3d next out --out further.csv                        poses of further sweeps, where most room is left
  scan3d batch meshes --out study --jobs 2                 many bodies, or many settings, with one summary
  scan3d doctor                                            what works on this machine, and how to install the rest

'scan3d COMMAND --help' describes each command.
"""
# Examples that are printed below the help of a command.
_EXAMPLES = {
    "scan": """\
  scan3d scan meshes/egg.stl --out out
  scan3d scan part.stl --out out --unit in --slices 128 --axis xyz
  scan3d scan part.stl --out out --friction 0.0:0.4 --noise 1e-4 --seed 7
  scan3d scan part.stl --out out --config settings.toml --json""",
    "simulate": """\
  scan3d simulate part.stl --out log.csv
  scan3d simulate part.stl --out log.csv --rod steel:0.3x50 --sweeps 24
  scan3d simulate part.stl --poses poses.csv --out raw.csv --faults faults.toml""",
    "reconstruct": """\
  scan3d reconstruct log.csv --out out
  scan3d reconstruct log.csv --out out --truth part.stl --method hull"""
    + one_sweep.EXAMPLES,
    "calibrate": calibration.EXAMPLES,
    "compare": """\
  scan3d compare out/surface.ply part.stl
  scan3d compare a.stl b.stl --unit in --json""",
    "doctor": """\
  scan3d doctor
  scan3d doctor --json""",
    "completion": """\
  eval "$(scan3d completion bash)"
  eval "$(scan3d completion zsh)"
  scan3d completion fish > ~/.config/fish/completions/scan3d.fish""",
}
# Values that the shell completes for options that the parser itself does not restrict, because settings from a file are
# checked by the same rules.
VALUES = {
    "model": MODELS,
    "spacing": SPACINGS,
    "unit": tuple(UNITS_M),
    "method": METHODS,
    "axis": ("x", "y", "z", "xyz"),
    "camera": CAMERAS,
}

_METHOD = f"surface from the contacts: {one_of(METHODS)}; bracket estimates it between the certified bounds"
# Name, placeholder and description of each setting; types and defaults are those of `Settings`.
_OPTIONS = (
    ("model", "MODEL", f"model of contact: {one_of(MODELS)}; a round rod in space leaves the plane of its sweep"),
    ("slices", "N", "number of slices; in the spatial model 0.6 times as many sweeps from each of 12 directions"),
    (
        "spacing",
        "RULE",
        f"heights of the slices: {one_of(SPACINGS)}; adaptive where the bound is widest, cosine dense at the ends",
    ),
    ("axis", "AXIS", "normal of the slices: x, y, z, several such as xyz, or a vector such as 1,1,0"),
    ("sweeps", "N", "sweeps per slice, or in the spatial model per direction, or auto: as many as the body needs"),
    ("samples", "N", "samples per sweep"),
    ("friction", "MU", "coefficient of friction, or a range such as 0.0:0.4 from which every sample draws its own"),
    ("rod", "ROD", "MATERIAL:DIAMETERxLENGTH in mm, such as steel:0.3x50, or auto: a length that fits the body"),
    ("clearance", "X", "distance of the base line from the slice, in rod lengths"),
    (
        "tolerance",
        "X",
        "certified bound at which adaptive spacing stops, relative to the diagonal; as many slices and samples as it takes",
    ),
    ("noise", "SIGMA", "standard deviation of force and moment, in EI/L² and EI/L"),
    ("seed", "N", "seed of the random numbers; the same seed gives the same files"),
    ("unit", "UNIT", f"unit of the mesh's coordinates: {one_of(tuple(UNITS_M))}"),
    ("method", "METHOD", _METHOD),
)


def parser() -> argparse.ArgumentParser:
    """The parser; the arguments that it returns have the name of the command in `command`."""
    top = Parser(prog="scan3d", description=_DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    top.add_argument("--version", action=Version, nargs=0, help="print the version and exit")
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True)

    scan = commands.add_parser("scan", help="all steps: simulate, reconstruct, build the surface, compare")
    scan.add_argument("mesh", metavar="MESH", help="a convex body: STL, PLY, OBJ, OFF or GLB")
    scan.add_argument("--out", required=True, metavar="DIR", help="folder for the results")
    _add_settings(scan)
    _add_overwrite(scan)
    _add_strict(scan)
    scan.set_defaults(command="scan")

    simulate = commands.add_parser("simulate", help="step 1 only: a recording of a simulated scan")
    simulate.add_argument("mesh", metavar="MESH", help="a convex body: STL, PLY, OBJ, OFF or GLB")
    simulate.add_argument(
        "--out",
        required=True,
        metavar="FILE",
        help="the recording, a .csv; a .toml of the same name is written as well",
    )
    _add_settings(simulate)
    rig_parser.add_rig_options(simulate)
    _add_overwrite(simulate)
    simulate.set_defaults(command="simulate")

    reconstruct = commands.add_parser("reconstruct", help="step 2 only, from a simulated or measured recording")
    reconstruct.add_argument(
        "recording", metavar="REC", help="the .csv or .parquet of a recording; its .toml is in the same folder"
    )
    reconstruct.add_argument(
        "--out", metavar="DIR", help="folder for the results; of one sweep also its picture (default: beside the table)"
    )
    reconstruct.add_argument("--truth", metavar="MESH", help="mesh of the true body, to compare the surface with")
    reconstruct.add_argument("--hull", action="store_true", help="take the convex hull of the true body")
    _add_clip_dent(reconstruct, "0")
    reconstruct.add_argument(
        "--method",
        metavar="METHOD",
        default=METHODS[0],
        help=f"{_METHOD} (default {METHODS[0]})",
    )
    reconstruct.add_argument(
        "--model",
        choices=MODELS,
        metavar="MODEL",
        help=f"model of contact: {one_of(MODELS)} (default spatial for a recording with six axes, else planar)",
    )
    calibration.add_rig(reconstruct)
    reconstruct.add_argument(
        "--table",
        type=float,
        metavar="Z",
        help="height of the table on which the body stands, in the recording's unit (default: that of its .toml, or none)",
    )
    one_sweep.add_options(reconstruct)
    _add_overwrite(reconstruct)
    _add_output(reconstruct)
    _add_strict(reconstruct)
    reconstruct.set_defaults(command="reconstruct")

    calibration.add(commands, _add_overwrite, _add_output)
    imported = laboratory_parser.add_import(commands)
    _add_overwrite(imported)
    _add_output(imported)

    compare = commands.add_parser("compare", help="Hausdorff distance and other measures of two meshes")
    compare.add_argument("first", metavar="A", help="a mesh, such as a reconstructed surface")
    compare.add_argument("second", metavar="B", help="the mesh to compare with, such as the truth")
    compare.add_argument(
        "--unit", default="mm", choices=tuple(UNITS_M), metavar="UNIT", help="unit to print (default mm)"
    )
    _add_output(compare)
    compare.set_defaults(command="compare")

    _add_output(showing.add_show(commands, _add_overwrite))
    _add_output(exporting.add_export(commands, _add_overwrite))
    _add_output(guide.add_demo(commands, _add_overwrite))

    doctor = commands.add_parser("doctor", help="what works on this machine, what is missing, and how to install it")
    _add_output(doctor)
    doctor.set_defaults(command="doctor")

    completion = commands.add_parser("completion", help="print a completion script for a shell")
    completion.add_argument("shell", metavar="SHELL", choices=SHELLS, help=one_of(SHELLS))
    completion.set_defaults(command="completion")

    many = batch.add_batch(commands)
    _add_settings(many)
    _add_overwrite(many)

    rig_parser.add_rig_commands(commands, _add_overwrite, _add_output)

    for name, text in (
        _EXAMPLES
        | batch.EXAMPLES
        | exporting.EXAMPLES
        | showing.EXAMPLES
        | guide.EXAMPLES
        | rig_parser.EXAMPLES
        | laboratory_parser.EXAMPLES
    ).items():
        commands.choices[name].epilog = f"examples:\n{text}"
        commands.choices[name].formatter_class = argparse.RawDescriptionHelpFormatter
    for command in commands.choices.values():
        command.set_defaults(parser=command)
    return top


def _add_settings(parser: argparse.ArgumentParser) -> None:
    defaults = {field.name: field.default for field in fields(Settings)}
    precedence = "The command line takes precedence over --config, and --config over the defaults."
    group = parser.add_argument_group("settings", precedence)
    for name, placeholder, text in _OPTIONS:
        group.add_argument(
            f"--{name}",
            type=type(defaults[name]),
            default=argparse.SUPPRESS,
            metavar=placeholder,
            help=f"{text} (default {defaults[name]})",
        )
    group.add_argument(
        "--hull",
        action="store_true",
        default=argparse.SUPPRESS,
        help="scan the convex hull of a body that is not convex",
    )
    _add_clip_dent(group, argparse.SUPPRESS)
    group.add_argument("--config", metavar="FILE", help="settings from a TOML file")
    group.add_argument(
        "--print-config", action="store_true", help="print the resulting settings as such a file, and exit"
    )
    _add_output(parser)


def _add_clip_dent(parser: argparse._ActionsContainer, default: str) -> None:
    parser.add_argument(
        "--clip-dent",
        default=default,
        metavar="SIZE",
        help="fill dents up to this depth, in the mesh's unit or relative to its diagonal like 0.05%% (default 0)",
    )


def _add_strict(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--strict", action="store_true", help="exit with 1 if the recording contradicts the model (results are written)"
    )


def _add_overwrite(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="replace also files that scan3d did not write, or that were changed since",
    )


def _add_output(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--quiet", action="store_true", help="print no progress and no summary")
