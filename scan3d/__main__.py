"""`python -m scan3d` is the `scan3d` command."""

import os
import sys

# `python -m` looks for modules in the current folder first, where a file such as numpy.py would be executed
_HOME = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
if not sys.flags.safe_path and sys.path and sys.path[0] == os.getcwd() != _HOME:
    del sys.path[0]

from scan3d.cli import main  # noqa: E402

if __name__ == "__main__":
    sys.exit(main())
