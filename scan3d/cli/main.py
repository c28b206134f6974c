"""The `scan3d` command.  Results go to stdout, progress and messages to stderr; exit 0, 1 (failed), 2 (usage), 130."""

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
            stream.reconfigure(errors="replace")  # a terminal without µ is not a failure
    try:
        arguments = parser().parse_args(argv)
        from scan3d.cli.verbs import VERBS

        code = VERBS[arguments.command](arguments)
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
        if not isinstance(error, BrokenPipeError):  # the reader of a pipe has gone, and no longer needs a message
            where = "" if error.filename is None else f" ({error.filename})"
            print(f"scan3d: {error.strerror or error}{where}", file=sys.stderr)
        with suppress(OSError):  # what is left for stdout would make Python complain at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


if __name__ == "__main__":
    sys.exit(main())
