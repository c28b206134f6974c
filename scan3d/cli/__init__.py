"""The `scan3d` command."""

from __future__ import annotations

import os
from collections.abc import Sequence

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (default: the process's) and return its exit code."""
    try:
        from scan3d.cli.interruptions import Interruptions

        with Interruptions(ends_process=argv is None) as interruptions:
            # imported here, so that Ctrl-C during the import is handled as well
            from scan3d.cli.commands import run

            interruptions.code = run(argv)
        return interruptions.code
    except KeyboardInterrupt:  # before the context handled the signals; afterwards it lets none out
        os.write(2, b"scan3d: interrupted\n")
        return 130
