"""Running a command line.

Results are printed to stdout, progress and messages to stderr.  The exit code is 0 for success, 1 for a failure, 2 for wrong
usage; `interruptions` adds 130 for an interrupted run and 143 for a terminated one.
"""

from __future__ import annotations

import io
import logging
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

from scan3d.cli.guide import print_guide
from scan3d.cli.parser import parser
from scan3d.cli.progress import Progress
from scan3d.cli.terminal import one_line
from scan3d.errors import InputError
from scan3d.settings import UsageError
from scan3d.workers import compute_algebra_in_one_thread


def run(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (default: the process's) and return its exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that cannot print µ prints ? instead
    # no window of matplotlib is opened; the name of a backend that does not exist would end its import
    os.environ.pop("MPLBACKEND", None)
    compute_algebra_in_one_thread()
    try:
        if not (sys.argv[1:] if argv is None else argv):
            return print_guide()
        arguments = parser().parse_args(argv)
        with _quiet(), Progress(arguments) as arguments.progress:
            from scan3d.cli.verbs import VERBS

            code = VERBS[arguments.command](arguments)
        if sys.stdout is not None:  # it is None if closed by the shell, with >&-
            sys.stdout.flush()
        return code
    except UsageError as error:
        print(f"scan3d: {one_line(str(error))}; see 'scan3d {arguments.command} --help'", file=sys.stderr)
        return 2
    except InputError as error:
        print(f"scan3d: {one_line(str(error))}", file=sys.stderr)
        return 1
    except MemoryError:
        print(f"scan3d: there is not enough memory for this {arguments.command}; take a smaller one", file=sys.stderr)
        return 1
    except OSError as error:
        if not isinstance(error, BrokenPipeError):  # the reader of a pipe has ended, and needs no message
            where = "" if error.filename is None else f" ({error.filename})"
            print(one_line(f"scan3d: {error.strerror or error}{where}"), file=sys.stderr)
        with suppress(OSError):  # Python would report an error at exit for output that is left
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


@contextmanager
def _quiet() -> Iterator[None]:
    """Within it warnings of libraries go to the logger py.warnings, which is silent unless a program sets it up."""
    logging.captureWarnings(True)
    try:
        yield
    finally:
        logging.captureWarnings(False)
