"""The `scan3d` command."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (default: the process's) and return its exit code."""
    try:
        if argv is None:
            from scan3d.workers import end_on_signals

            end_on_signals()
            os.environ.setdefault("PYTHONSAFEPATH", "1")  # child processes execute no file of the current folder
        # imported here, so that Ctrl-C during the import is handled as well
        from scan3d.cli.commands import run

        return run(argv)
    except KeyboardInterrupt:  # before the signals are handled, or in a process whose handlers are its own
        print("scan3d: interrupted", file=sys.stderr)
        return 130
