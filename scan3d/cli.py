"""The `scan3d` command.  Results go to stdout, progress and sentences to stderr; exit 0, 1 (failed), 2 (usage), 130."""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any, NoReturn

from scan3d.errors import InputError
from scan3d.settings import METHODS
from scan3d.terminal import is_terminal, table
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
# As `views.VIEWS` and `scenes.COLORS`, without what those import.
_VIEWS = ("cloud", "surface", "bound", "compare", "explain")
_COLORS = ("phase", "force", "friction", "error")
# What the shell offers for options whose values are judged later.
_VALUES = {
    "spacing": ("cosine", "uniform", "adaptive"),
    "standoff": ("follow", "fixed"),
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


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (default: the process's) and return its exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without µ is no failure
    try:
        arguments = _parser().parse_args(argv)
        code = int(arguments.run(arguments))
        if sys.stdout is not None:  # closed, as by >&-
            sys.stdout.flush()
        return code
    except InputError as error:
        print(f"scan3d: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        # on a terminal the cursor stands behind the progress, or behind ^C
        newline = "\n" if sys.stderr.isatty() else ""
        print(f"{newline}scan3d: interrupted", file=sys.stderr)
        return 130
    except OSError as error:
        if not isinstance(error, BrokenPipeError):  # the reader of a pipe has gone: nobody to tell
            where = "" if error.filename is None else f" ({error.filename})"
            print(f"scan3d: {error.strerror or error}{where}", file=sys.stderr)
        with suppress(OSError):  # what is left for stdout would make Python complain at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, and where to read on."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"scan3d: {message}; see '{self.prog} --help'\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="scan3d", description=_DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    scan = commands.add_parser("scan", help="simulate, reconstruct, surface, compare: everything")
    scan.add_argument("mesh", metavar="MESH", help="a convex body: STL, PLY, OBJ, OFF or GLB")
    scan.add_argument("--out", required=True, metavar="DIR", help="folder for the results")
    _add_settings(scan)
    scan.set_defaults(run=_scan)

    simulate = commands.add_parser("simulate", help="step 1 alone: a recording of a simulated scan")
    simulate.add_argument("mesh", metavar="MESH", help="a convex body: STL, PLY, OBJ, OFF or GLB")
    simulate.add_argument(
        "--out", required=True, metavar="FILE", help="the recording, a .csv; a .toml is written beside it"
    )
    _add_settings(simulate)
    simulate.set_defaults(run=_simulate)

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
    reconstruct.set_defaults(run=_reconstruct)

    compare = commands.add_parser("compare", help="Hausdorff distance and companions of two meshes")
    compare.add_argument("first", metavar="A", help="a mesh, such as a reconstructed surface")
    compare.add_argument("second", metavar="B", help="the mesh to compare with, such as the truth")
    compare.add_argument(
        "--unit", default="mm", choices=tuple(UNITS_M), metavar="UNIT", help="unit to print (default mm)"
    )
    _add_output(compare)
    compare.set_defaults(run=_compare)

    show = commands.add_parser("show", help="look at a scan: in a window, or in a picture, a page or a movie")
    show.add_argument(
        "path", metavar="DIR|FILE", help="a scan's folder, a recording (.csv), a cloud or surface (.ply), a mesh"
    )
    show.add_argument("--screenshot", metavar="FILE", help="a picture, .png or .pdf, instead of a window")
    show.add_argument("--html", metavar="FILE", help="a page that turns in any browser, without network")
    show.add_argument("--movie", metavar="FILE", help="a .gif, or an .mp4 (needs imageio-ffmpeg)")
    show.add_argument(
        "--view",
        choices=_VIEWS,
        metavar="VIEW",
        help=f"what the picture shows: {', '.join(_VIEWS)} (default surface, with --color cloud)",
    )
    show.add_argument(
        "--color",
        choices=_COLORS,
        metavar="WHAT",
        help=f"colour of the contacts in a picture or the window: {', '.join(_COLORS)} (default force)",
    )
    show.add_argument("--movie-of", choices=("sweep", "growth"), metavar="WHAT", help="sweep (default) or growth")
    show.add_argument(
        "--truth", metavar="MESH", help="the true body; by default the one that the report names, if found"
    )
    show.add_argument("--hull", action="store_true", help="take the convex hull of the true body")
    show.add_argument("--unit", default="mm", choices=tuple(UNITS_M), metavar="UNIT", help="of a mesh (default mm)")
    _add_output(show)
    show.set_defaults(run=_show, misuse=show.error)

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
        choices=("surface", "cloud"),
        help="for .ply and .vtp, which hold either (default surface, unless DIR is a file with a cloud)",
    )
    _add_output(export)
    export.set_defaults(run=_export)

    doctor = commands.add_parser("doctor", help="what works here, what is missing and the command that installs it")
    _add_output(doctor)
    doctor.set_defaults(run=_doctor)

    completion = commands.add_parser("completion", help="a script that makes the shell complete this command")
    completion.add_argument("shell", metavar="SHELL", choices=("bash", "zsh", "fish"), help="bash, zsh or fish")
    completion.set_defaults(run=_completion)

    for name, text in _EXAMPLES.items():
        commands.choices[name].epilog = f"examples:\n{text}"
        commands.choices[name].formatter_class = argparse.RawDescriptionHelpFormatter
    return parser


class _Version(argparse.Action):
    """Looks the version up only when asked."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print(version("scan3d"))
        parser.exit()


def _add_settings(parser: argparse.ArgumentParser) -> None:
    from scan3d.settings import Settings

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


def _settings(arguments: argparse.Namespace) -> Any:
    from scan3d.settings import Settings, settings

    names = {field.name for field in fields(Settings)}
    given = {name: value for name, value in vars(arguments).items() if name in names}
    return settings(given, arguments.config)


def _scan(arguments: argparse.Namespace) -> int:
    from scan3d import commands, reports

    chosen = _settings(arguments)
    if arguments.print_config:
        return _print_config(chosen)
    data = commands.scan(arguments.mesh, arguments.out, chosen, _say, _progress(arguments))
    return _print(arguments, data, _table(f"{reports.summary(data)}\nwritten to         {arguments.out}"))


def _simulate(arguments: argparse.Namespace) -> int:
    from scan3d import commands

    chosen = _settings(arguments)
    if arguments.print_config:
        return _print_config(chosen)
    _keep_config(arguments)
    data = commands.simulate_only(arguments.mesh, arguments.out, chosen, _progress(arguments))
    return _print(
        arguments, data, f"{data['samples']} samples in {data['sweeps']} sweeps, written to {data['recording']}"
    )


def _reconstruct(arguments: argparse.Namespace) -> int:
    from scan3d import commands, reports
    from scan3d.settings import settings

    chosen = settings({"hull": arguments.hull, "method": arguments.method})
    data = commands.reconstruct_only(arguments.recording, arguments.out, arguments.truth, chosen, _say)
    return _print(arguments, data, _table(f"{reports.summary(data)}\nwritten to         {arguments.out}"))


def _compare(arguments: argparse.Namespace) -> int:
    from dataclasses import asdict

    from scan3d import commands, reports

    found = commands.compare_files(arguments.first, arguments.second)
    return _print(arguments, asdict(found), _table(reports.comparison_summary(found, arguments.unit)))


def _show(arguments: argparse.Namespace) -> int:
    from scan3d import commands

    names = ("truth", "hull", "unit", "view", "color", "movie_of", "screenshot", "html", "movie")
    chosen = {name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}
    # what would change nothing is a mistake
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
    done = commands.show(arguments.path, print, **chosen)
    return _print(arguments, done, "\n".join(f"written to {file}" for file in done["files"])) if done["files"] else 0


def _export(arguments: argparse.Namespace) -> int:
    from scan3d.exports import export

    done = export(arguments.source, arguments.to, arguments.what)
    cloud, surface = f"{done['points']} contacts", f"a surface of {done['points']} vertices and {done['faces']} faces"
    shape = cloud if done["what"] == "cloud" else surface
    return _print(arguments, done, f"{shape} in {done['unit']}, written to {done['file']}")


def _doctor(arguments: argparse.Namespace) -> int:
    import json

    from scan3d import doctor

    found = doctor.examine()
    # without `files`, which needs numpy: that may be what is missing
    if arguments.json:
        print(json.dumps(found, indent=2))
    elif not arguments.quiet:
        print(_table(doctor.summary(found)))
    return 0 if found["ok"] else 1


def _completion(arguments: argparse.Namespace) -> int:
    from scan3d.completion import script

    print(script(_parser(), arguments.shell, _VALUES), end="")
    return 0


def _keep_config(arguments: argparse.Namespace) -> None:
    """Raises InputError if the recording's own TOML file would overwrite that of the settings."""
    from scan3d.recording import sidecar

    beside = sidecar(arguments.out)
    if arguments.config is not None and beside.resolve() == Path(arguments.config).resolve():
        raise InputError(f"{beside.name} holds the settings, and the recording's rod goes there; choose another --out")


def _print_config(chosen: Any) -> int:
    from scan3d.files import to_toml
    from scan3d.settings import as_dict

    chosen.plan()  # what it prints runs
    print(to_toml(as_dict(chosen)), end="")
    return 0


def _print(arguments: argparse.Namespace, data: Any, text: str) -> int:
    from scan3d.files import to_json

    if arguments.json:
        print(to_json(data).decode(), end="")
    elif not arguments.quiet:
        print(text)
    return 0


def _table(text: str) -> str:
    return table(text, sys.stdout)


def _say(sentence: str) -> None:
    print(f"scan3d: {sentence}", file=sys.stderr)


def _progress(arguments: argparse.Namespace) -> Any:
    """A line on stderr that counts up and vanishes; nothing where stderr is no terminal."""
    if arguments.quiet or not is_terminal(sys.stderr):
        return lambda *_: None

    def show(what: str, done: int, of: int) -> None:
        end = f"\r{'':40}\r" if done >= of else ""
        print(f"\r{what} {done}/{of} slices{end}", end="", file=sys.stderr, flush=True)

    return show


if __name__ == "__main__":
    sys.exit(main())
