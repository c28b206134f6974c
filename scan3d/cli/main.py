"""The `scan3d` command.

Results are printed to stdout, progress and messages to stderr.  The exit code is 0 for success, 1 for a failure, 2 for wrong
usage and 130 for an interrupted run.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Sequence
from contextlib import suppress

from scan3d.cli.parser import parser
from scan3d.errors import InputError


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (default: the process's) and return its exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that cannot print µ prints ? instead
    try:
        arguments = parser().parse_args(argv)
        from scan3d.cli.verbs import VERBS

        code = VERBS[arguments.command](arguments)
        if sys.stdout is not None:  # it is None if closed by the shell, with >&-
            sys.stdout.flush()
        return code
    except InputError as error:
        print(f"scan3d: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        # on a terminal the cursor is behind the progress or behind ^C
        newline = "\n" if sys.stderr.isatty() else ""
        print(f"{newline}scan3d: interrupted", file=sys.stderr)
        return 130
    except OSError as error:
        if not isinstance(error, BrokenPipeError):  # the reader of a pipe has ended, and needs no message
            where = "" if error.filename is None else f" ({error.filename})"
            print(f"scan3d: {error.strerror or error}{where}", file=sys.stderr)
        with suppress(OSError):  # Python would report an error at exit for output that is left
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


if __name__ == "__main__":
    sys.exit(main())
