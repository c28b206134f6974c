"""The command line's arguments.  Nothing here needs a numerical library, so that ``scan3d --help`` is quick."""

from __future__ import annotations

import argparse
from dataclasses import fields
from typing import Any, NoReturn

from scan3d.choices import COLORS, EXPORTS, METHODS, MOVIES, SHELLS, SPACINGS, STANDOFFS, VIEWS
from scan3d.cli.settings import Settings
from scan3d.units import UNITS_M

_DESCRIPTION = """\
Seeing by touch: sweep a flexible rod along a body, and rebuild the body from the reactions at its clamp.

  scan3d scan meshes/egg.stl --out out                     the whole way, with pictures and a report
  scan3d scan part.stl --out out --friction 0.0:0.4        every sample with a friction of its own
  scan3d simulate part.stl --out log.csv                   only a recording, as a rig would log it
  scan3d reconstruct log.csv --out out --truth part.stl    only the way back
  scan3d compare out/surface.ply part.stl                  Hausdorff distance of two meshes
  scan3d show out                                          a window to turn it in; --html and --screenshot for files
  scan3d export out --to part.glb                          the surface for other programs
  scan3d doctor                                            what works here, and how to mend the rest

'scan3d COMMAND --help' says more about each.
"""
# What stands under a command's help.
_EXAMPLES = {
    "scan": """\
  scan3d scan meshes/egg.stl --out out
  scan3d scan part.stl --out out --unit in --slices 128 --axis xyz
  scan3d scan part.stl --out out --friction 0.0:0.4 --noise 1e-4 --seed 7
  scan3d scan part.stl --out out --config settings.toml --json""",
    "simulate": """\
  scan3d simulate part.stl --out log.csv
  scan3d simulate part.stl --out log.csv --rod steel:0.3x50 --sweeps 24""",
    "reconstruct": """\
  scan3d reconstruct log.csv --out out
  scan3d reconstruct log.csv --out out --truth part.stl --method hull""",
    "compare": """\
  scan3d compare out/surface.ply part.stl
  scan3d compare a.stl b.stl --unit in --json""",
    "show": """\
  scan3d show out
  scan3d show out --screenshot egg.png --view compare
  scan3d show out/cloud.ply --screenshot friction.pdf --color friction
  scan3d show log.csv --html log.html --truth part.stl
  scan3d show out --movie sweep.gif""",
    "export": """\
  scan3d export out --to egg.glb
  scan3d export out --to egg.vtp --what cloud
  scan3d export out/cloud.ply --to egg.pcd""",
    "doctor": """\
  scan3d doctor
  scan3d doctor --json""",
    "completion": """\
  eval "$(scan3d completion bash)"
  eval "$(scan3d completion zsh)"
  scan3d completion fish > ~/.config/fish/completions/scan3d.fish""",
}
# What the shell offers for options whose values are judged later.
VALUES = {
    "spacing": SPACINGS,
    "standoff": STANDOFFS,
    "unit": tuple(UNITS_M),
    "method": METHODS,
    "axis": ("x", "y", "z", "xyz"),
}
# name, placeholder, what it is; types and defaults are those of `Settings`
_OPTIONS = (
    ("slices", "N", "number of slices"),
    ("spacing", "HOW", "heights of the slices: cosine (dense at the ends), uniform, or adaptive"),
    ("axis", "AXIS", "normal of the slices: x, y, z, several such as xyz, or a vector such as 1,1,0"),
    ("sweeps", "N", "sweeps per slice, or auto: as many as its contour needs"),
    ("samples", "N", "samples per sweep"),
    ("friction", "MU", "coefficient of friction, or a range such as 0.0:0.4 to draw from for every sample"),
    ("rod", "ROD", "MATERIAL:DIAMETERxLENGTH in mm, such as steel:0.3x50, or auto: a length that suits the body"),
    ("clearance", "X", "distance of the base line from the slice, in rod lengths"),
    ("standoff", "HOW", "follow: the base line follows every slice; fixed: it keeps clear of the widest"),
    ("tolerance", "X", "adaptive spacing stops at this certified bound, relative to the diagonal"),
    ("noise", "SIGMA", "standard deviation of force and moment, in EI/L² and EI/L"),
    ("seed", "N", "seed of all that is random; the same seed gives the same files"),
    ("unit", "UNIT", "what the mesh's numbers mean: mm, cm, m, um, in"),
    ("method", "METHOD", "surface from the contacts: auto, hull, bracket, support, poisson or ball-pivoting"),
)


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, and where to read on."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"scan3d: {message}; see '{self.prog} --help'\n")


def parser() -> argparse.ArgumentParser:
    """The parser; the arguments that it returns have the name of the verb in `command`."""
    top = _Parser(prog="scan3d", description=_DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    top.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True)

    scan = commands.add_parser("scan", help="simulate, reconstruct, surface, compare: everything")
    scan.add_argument("mesh", metavar="MESH", help="a convex body: STL, PLY, OBJ, OFF or GLB")
    scan.add_argument("--out", required=True, metavar="DIR", help="folder for the results")
    _add_settings(scan)
    scan.set_defaults(command="scan")

    simulate = commands.add_parser("simulate", help="step 1 alone: a recording of a simulated scan")
    simulate.add_argument("mesh", metavar="MESH", help="a convex body: STL, PLY, OBJ, OFF or GLB")
    simulate.add_argument(
        "--out", required=True, metavar="FILE", help="the recording, a .csv; a .toml is written beside it"
    )
    _add_settings(simulate)
    simulate.set_defaults(command="simulate")

    reconstruct = commands.add_parser("reconstruct", help="step 2 from a recording, simulated or measured")
    reconstruct.add_argument("recording", metavar="REC", help="a recording's .csv, its .toml beside it")
    reconstruct.add_argument("--out", required=True, metavar="DIR", help="folder for the results")
    reconstruct.add_argument("--truth", metavar="MESH", help="the true body, to compare with")
    reconstruct.add_argument("--hull", action="store_true", help="take the convex hull of the true body")
    reconstruct.add_argument(
        "--method",
        metavar="METHOD",
        default="auto",
        help="surface from the contacts: auto, hull, bracket, support, poisson...",
    )
    _add_output(reconstruct)
    reconstruct.set_defaults(command="reconstruct")

    compare = commands.add_parser("compare", help="Hausdorff distance and companions of two meshes")
    compare.add_argument("first", metavar="A", help="a mesh, such as a reconstructed surface")
    compare.add_argument("second", metavar="B", help="the mesh to compare with, such as the truth")
    compare.add_argument(
        "--unit", default="mm", choices=tuple(UNITS_M), metavar="UNIT", help="unit to print (default mm)"
    )
    _add_output(compare)
    compare.set_defaults(command="compare")

    show = commands.add_parser("show", help="look at a scan: in a window, or in a picture, a page or a movie")
    show.add_argument(
        "path", metavar="DIR|FILE", help="a scan's folder, a recording (.csv), a cloud or surface (.ply), a mesh"
    )
    show.add_argument("--screenshot", metavar="FILE", help="a picture, .png or .pdf, instead of a window")
    show.add_argument("--html", metavar="FILE", help="a page that turns in any browser, without network")
    show.add_argument("--movie", metavar="FILE", help="a .gif, or an .mp4 (needs imageio-ffmpeg)")
    show.add_argument(
        "--view",
        choices=VIEWS,
        metavar="VIEW",
        help=f"what the picture shows: {', '.join(VIEWS)} (default surface, with --color cloud)",
    )
    show.add_argument(
        "--color",
        choices=COLORS,
        metavar="WHAT",
        help=f"colour of the contacts in a picture or the window: {', '.join(COLORS)} (default force)",
    )
    show.add_argument("--movie-of", choices=MOVIES, metavar="WHAT", help="sweep (default) or growth")
    show.add_argument(
        "--truth", metavar="MESH", help="the true body; by default the one that the report names, if found"
    )
    show.add_argument("--hull", action="store_true", help="take the convex hull of the true body")
    show.add_argument("--unit", default="mm", choices=tuple(UNITS_M), metavar="UNIT", help="of a mesh (default mm)")
    _add_output(show)
    show.set_defaults(command="show", misuse=show.error)

    export = commands.add_parser(
        "export",
        help="cloud or surface in another format, by file ending",
        description="Clouds go to .ply, .pcd, .vtp, .xyz, .xyzn and .csv, surfaces to .stl, .ply, .obj, .vtp\n"
        "and .glb (in metres). Unit, frame, normals and scalars stay wherever a format can hold them.",
    )
    export.add_argument("source", metavar="DIR", help="folder of a scan, or one of its PLY files")
    export.add_argument("--to", required=True, metavar="FILE", help="the file to write; its ending says the format")
    export.add_argument(
        "--what",
        choices=EXPORTS,
        help="for .ply and .vtp, which hold either (default surface, unless DIR is a file with a cloud)",
    )
    _add_output(export)
    export.set_defaults(command="export")

    doctor = commands.add_parser("doctor", help="what works here, what is missing and the command that installs it")
    _add_output(doctor)
    doctor.set_defaults(command="doctor")

    completion = commands.add_parser("completion", help="a script that makes the shell complete this command")
    completion.add_argument("shell", metavar="SHELL", choices=SHELLS, help="bash, zsh or fish")
    completion.set_defaults(command="completion")

    for name, text in _EXAMPLES.items():
        commands.choices[name].epilog = f"examples:\n{text}"
        commands.choices[name].formatter_class = argparse.RawDescriptionHelpFormatter
    return top


class _Version(argparse.Action):
    """Looks the version up only when asked."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print(version("scan3d"))
        parser.exit()


def _add_settings(parser: argparse.ArgumentParser) -> None:
    defaults = {field.name: field.default for field in fields(Settings)}
    group = parser.add_argument_group("settings", "Command line over --config over defaults.")
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
        help="scan the convex hull of a body that isn't convex",
    )
    group.add_argument("--config", metavar="FILE", help="settings from a TOML file")
    group.add_argument(
        "--print-config", action="store_true", help="print the settings in force as such a file, and exit"
    )
    _add_output(parser)


def _add_output(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--quiet", action="store_true", help="print no progress and no summary")
