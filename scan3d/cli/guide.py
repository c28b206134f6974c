"""What a newcomer needs: a short guide, and a demonstration."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from scan3d.cli.terminal import printable

GUIDE = """\
scan3d: seeing by touch.  A flexible rod is swept along a body, and the body is reconstructed from the reactions at its clamp.

  scan3d demo                        scan a body that comes with the program
  scan3d scan part.stl --out out     scan your own convex mesh (mm, unless you say --unit in)
  scan3d show out                    look at the result; out/view.html opens in any browser
  scan3d reconstruct log.csv --out out
                                     reconstruct a body from measurements
  scan3d doctor                      what works on this machine
  scan3d --help                      all commands
"""
EXAMPLES = {
    "demo": """\
  scan3d demo
  scan3d demo --out here""",
}
DEMO = Path(__file__).with_name("demo.glb")
"""The body of the demonstration, that of ``meshes/gem.glb``."""
# Settings of the demonstration: half the slices of the default take half the time.
DEMO_SETTINGS = {"slices": 32, "friction": "0.1:0.4"}


def add_demo(commands: Any, add_overwrite: Callable[[argparse.ArgumentParser], None]) -> argparse.ArgumentParser:
    """Add the command `demo` to the commands of the parser."""
    text = "scan a body that comes with the program, and say what to open"
    demo: argparse.ArgumentParser = commands.add_parser("demo", help=text)
    demo.add_argument(
        "--out", default="scan3d-demo", metavar="DIR", help="folder for the results (default scan3d-demo)"
    )
    add_overwrite(demo)
    demo.set_defaults(command="demo", strict=False)
    return demo


def what_to_open(folder: str) -> str:
    """What to do after the demonstration."""
    page, place = printable(str(Path(folder) / "view.html")), printable(folder)
    return (
        f"\nOpen {page} in a browser; surface.png and cloud.png beside it are pictures.\n"
        f"{f'scan3d show {place}':35} an interactive window\n"
        "scan3d scan part.stl --out out      a scan of your own mesh"
    )


def print_guide() -> int:
    """Print the guide; the exit code."""
    print(GUIDE, end="")
    return 0
