"""`python -m scan3d` is the `scan3d` command."""

import sys

from scan3d.cli import main

if __name__ == "__main__":
    sys.exit(main())
