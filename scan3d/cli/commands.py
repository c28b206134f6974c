"""The command line: all commands, and how a call becomes an exit code.

Results are printed to stdout, progress and messages to stderr.  The exit code is 0 for success, 1 for a failure, 2 for wrong
usage; `scan3d.workers` adds 130 for an interrupted run and 143 for a terminated one.
"""

from __future__ import annotations

import dataclasses
import inspect
import io
import logging
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.metadata import version
from typing import Annotated, Literal

from cyclopts import App, CycloptsError, MissingArgumentError, Parameter, UnusedCliTokensError

from scan3d.cli import doctor, rig, show, verbs
from scan3d.cli.terminal import SPELLED, Output, Progress, say
from scan3d.errors import InputError, UsageError
from scan3d.workers import compute_algebra_in_one_thread

GUIDE = """\
scan3d: seeing by touch.  A flexible rod is swept along a body, and the body is reconstructed from the reactions at its clamp.

  scan3d demo                        scan a body that comes with the program
  scan3d scan part.stl --out out     scan your own mesh (mm, unless you say --unit in)
  scan3d show out                    look at the result; out/view.html opens in any browser
  scan3d reconstruct log.csv --out out
                                     reconstruct a body from measurements
  scan3d doctor                      what works on this machine
  scan3d --help                      all commands; docs/glossary.md has every word of a report
"""
_DESCRIPTION = """\
Seeing by touch: sweep a flexible rod along a body, and reconstruct the body from the reactions at the rod's clamp.

'scan3d' alone prints a few examples, and 'scan3d COMMAND --help' describes each command."""


def completion(shell: Annotated[Literal["bash", "zsh", "fish"], Parameter(metavar="SHELL")], /) -> int:
    """Print a completion script for a shell.

    For example:
      eval "$(scan3d completion bash)"
      eval "$(scan3d completion zsh)"
      scan3d completion fish > ~/.config/fish/completions/scan3d.fish

    Parameters
    ----------
    shell
        for which
    """
    script = app().generate_completion(prog_name="scan3d", shell=shell)
    if shell == "zsh":  # as a file of its own, which is loaded when it is needed, and by `eval`
        script += 'if [[ $funcstack[1] == _scan3d ]]; then _cyclopts_scan3d "$@"; '
        script += "else compdef _cyclopts_scan3d scan3d; fi"
    print(script)
    return 0


COMMANDS: dict[str, Callable[..., int]] = {
    "scan": verbs.scan,
    "batch": verbs.batch,
    "simulate": verbs.simulate,
    "plan": rig.plan,
    "next": rig.further,
    "reconstruct": verbs.reconstruct,
    "calibrate": rig.calibrate,
    "import": rig.import_,
    "surface": verbs.surface,
    "compare": verbs.compare,
    "show": show.show,
    "export": verbs.export,
    "demo": verbs.demo,
    "doctor": doctor.doctor,
    "completion": completion,
}


def app() -> App:
    """All commands with their options."""
    made = App(
        name="scan3d",
        help=_DESCRIPTION,
        version=lambda: version("scan3d"),
        help_format="plaintext",
        default_parameter=Parameter(negative=(), allow_repeating=True),
    )
    for place, (name, function) in enumerate(COMMANDS.items()):
        made.command(function, name=name, sort_key=place)
    return made


def run(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (default: the process's) and return its exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=SPELLED)
    # no window of matplotlib is opened; the name of a backend that does not exist would end its import
    os.environ.pop("MPLBACKEND", None)
    compute_algebra_in_one_thread()
    words = list(sys.argv[1:] if argv is None else argv)
    if not words:
        print(GUIDE, end="")
        return 0
    if words[0] in ("help", "version"):
        words = [*words[1:], f"--{words[0]}"]
    name = words[0] if words[0] in COMMANDS else ""
    try:
        command, bound, _ = app().parse_args(words, exit_on_error=False, print_error=False)
        # warnings of libraries go to the logger py.warnings, which is silent unless a program sets it up
        logging.captureWarnings(True)
        try:
            code = _called(name, command, bound)
        finally:
            logging.captureWarnings(False)
        if sys.stdout is not None:  # it is None if closed by the shell, with >&-
            sys.stdout.flush()
        return code
    except (CycloptsError, UsageError) as error:
        say(f"{_in_words(error)}; see '{' '.join(['scan3d', *filter(None, [name])])} --help'")
        return 2
    except InputError as error:
        say(str(error))
        return 1
    except MemoryError:
        say(f"there is not enough memory for this {name}; take a smaller one")
        return 1
    except OSError as error:
        if not isinstance(error, BrokenPipeError):  # the reader of a pipe has ended, and needs no message
            say(f"{error.strerror or error}{'' if error.filename is None else f' ({error.filename})'}")
        with suppress(OSError):  # Python would report an error at exit for output that is left
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _called(name: str, command: Callable[..., int | None], bound: inspect.BoundArguments) -> int:
    if "output" not in inspect.signature(command).parameters:
        return command(*bound.args, **bound.kwargs) or 0
    output = bound.arguments.get("output", Output())
    with Progress(name, output.quiet) as progress:
        bound.arguments["output"] = dataclasses.replace(output, progress=progress)
        return command(*bound.args, **bound.kwargs) or 0


def _in_words(error: Exception) -> str:
    if isinstance(error, UnusedCliTokensError):
        return f"unexpected arguments: {' '.join(error.unused_tokens or ())}"
    if type(error) is MissingArgumentError and error.argument is not None:
        or_empty = " or has no value" if error.argument.name.startswith("--") else ""
        return f"{error.argument.name} is missing{or_empty}"
    message = str(error)
    return message if message.endswith("...") else message.removesuffix(".")
