"""The command doctor: what works on this machine, what does not, and the command that installs what is missing."""

from __future__ import annotations

import re
import shlex
import sys
from typing import Any

from scan3d.cli.terminal import Output, printable_json, table
from scan3d.workers import python

# Packages that every scan needs, and what the others are used for.
NEEDED = ("numpy", "scipy", "trimesh", "manifold3d", "pyvista", "matplotlib", "pillow", "cyclopts", "rich")
OPTIONAL = {
    "open3d": "the surfaces poisson and ball-pivoting, and to_open3d",
    "pyarrow": "recordings and tables as Parquet",
    "rosbags": "the import of ROS bags",
    "openpyxl": "tables of Excel",
    "h5py": "tables of HDF5 and MATLAB 7.3",
    "distributed": "batches on a Dask cluster",
}
# A small scan with all steps.  It runs in a child process, because a broken library may end its process.
_SCAN = "import scan3d, trimesh; scan3d.scan(trimesh.creation.box((30, 20, 10)), slices=3, sweeps=4, samples=8)"


def doctor(*, output: Output = Output()) -> int:
    """What works on this machine, what is missing, and how to install it.

    For example:
      scan3d doctor
      scan3d doctor --json
    """
    import json

    output.progress.tell("trying what the commands need")
    state = examine()
    output.progress.end()
    # `files.text` is not used here, because it needs numpy, which may be missing
    if output.json:
        print(printable_json(json.dumps(state, indent=2)))
    elif not output.quiet:
        print(table("", summary(state)))
    return 0 if state["ok"] else 1


def examine() -> dict[str, Any]:
    """Try what the commands need.

    Returns plain values: `ok` states whether a scan works, `missing` lists what is missing and the command that installs it.
    """
    import platform

    packages = {name: _version(name) for name in (*NEEDED, "vtk", *OPTIONAL)}
    scan_error, open3d_error = _error_of(_SCAN), _error_of("import open3d")
    missing: list[dict[str, str | None]] = []

    def lacks(what: str, use: str, why: str, command: str) -> None:
        known = command if sys.platform == "linux" or not command.startswith("apt-get") else None
        missing.append({"what": what, "for": use, "why": why, "command": known})

    for name in (*NEEDED, *OPTIONAL):
        if packages[name] is None:
            lacks(name, OPTIONAL.get(name, "every scan"), "not installed", _pip(name))
    if packages["open3d"] is not None and open3d_error:
        lacks("open3d", OPTIONAL["open3d"], open3d_error, "apt-get install libgl1 libgomp1 libusb-1.0-0")
    if not (pictures := _can_render()):
        lacks("renderer", "pictures", "nothing can render off screen", "apt-get install libegl1 libgl1")
    return {
        "scan3d": _version("scan3d"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": packages,
        "scan": {"works": scan_error is None, "why_not": scan_error},
        "rendering": pictures,
        "open3d": {"works": open3d_error is None, "why_not": open3d_error},
        "missing": missing,
        "ok": scan_error is None,
    }


def summary(state: dict[str, Any]) -> list[tuple[str, str]]:
    """The result of `examine` as rows (label, value) for the terminal."""
    packages, scan, open3d = state["packages"], state["scan"], state["open3d"]
    open3d_words = "works" if open3d["works"] else f"doesn't work ({open3d['why_not']})"
    rows = [
        ("scan3d", f"{state['scan3d']}, Python {state['python']}, {state['platform']}"),
        ("scans", "work" if scan["works"] else f"don't work ({scan['why_not']})"),
        ("pictures", "work" if state["rendering"] else "don't work (nothing can render off screen)"),
        ("open3d", open3d_words if packages["open3d"] else "not installed (no scan needs it by default)"),
        ("packages", ", ".join(f"{name} {number}" for name, number in packages.items() if number)),
    ]
    for item in state["missing"]:
        command = f": {item['command']}" if item["command"] else ""
        # what a scan does not need and nobody asked for is not missing
        label = "optional" if item["what"] in OPTIONAL and packages[item["what"]] is None else "missing"
        rows.append((label, f"{item['what']} ({item['why']}), for {item['for']}{command}"))
    return rows if any(label == "missing" for label, _ in rows) else [*rows, ("missing", "nothing")]


def _version(name: str) -> str | None:
    from importlib.metadata import PackageNotFoundError, version

    # open3d is distributed under two names
    for distribution in (name, f"{name}-cpu"):
        try:
            return version(distribution)
        except PackageNotFoundError:
            continue
    return None


def _pip(name: str) -> str:
    from importlib.metadata import requires

    if name == "open3d":
        requirement = "scan3d[open3d]"  # which of its two distributions suits the machine
    else:
        matches = [re.match(rf"{name}\b[^;\s]*", line) for line in requires("scan3d") or ()]
        requirement = next((match[0] for match in matches if match), name)
    return shlex.join([sys.executable, "-m", "pip", "install", requirement])


def _error_of(code: str) -> str | None:
    """The last line of the error message of a child process that runs the code; None if it succeeds."""
    import subprocess  # it is not imported for the help of other commands

    try:
        completed = subprocess.run(python(code), capture_output=True, text=True, timeout=300, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    if completed.returncode == 0:
        return None
    if completed.returncode < 0:
        return f"killed by signal {-completed.returncode}"
    lines = completed.stderr.strip().splitlines()
    return lines[-1].strip() if lines else f"exit code {completed.returncode}"


def _can_render() -> bool:
    try:
        from scan3d.pictures import canvas, views  # noqa: F401 - a picture needs what these import
    except ImportError:
        return False
    return canvas.can_render()
