"""What works on this machine, what doesn't, and the command that mends it."""

from __future__ import annotations

import platform
import re
import shlex
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

# Packages a scan needs, and what others are good for.
NEEDED = ("numpy", "scipy", "trimesh", "pyvista", "matplotlib", "pillow")
OPTIONAL = {"open3d": "Poisson and ball pivoting surfaces", "imageio-ffmpeg": "movies as .mp4"}
# Endings that a recording may have, in this version or another.
_RECORDINGS = (".csv", ".parquet")
_TIMEOUT_S = 300
# A scan of a moment, of all steps; in a child, for a broken library may take its process down.
_SCAN = """
import trimesh, scan3d
body = trimesh.creation.box((30, 20, 10))
recording = scan3d.simulate(body, scan3d.Plan(slices=3, sweeps=4, samples=8))
scan3d.compare(scan3d.surface(scan3d.reconstruct(recording)), body)
"""


def examine() -> dict[str, Any]:
    """Try out what the commands need.  Plain values; `ok` says whether a scan works, `missing` what to do about the rest."""
    packages = {name: _version(name) for name in (*NEEDED, "vtk", *OPTIONAL)}
    trouble = _trouble(_SCAN)
    open3d = _trouble("import open3d")
    recordings = _recordings()
    pictures = _can_render()
    missing = [
        _missing(name, "every scan" if name in NEEDED else OPTIONAL[name], "not installed", _pip(name))
        for name in (*NEEDED, *OPTIONAL)
        if packages[name] is None
    ]
    if packages["open3d"] is not None and open3d:
        missing.append(_missing("open3d", OPTIONAL["open3d"], open3d, _apt("libgl1 libgomp1")))
    if not pictures:
        missing.append(_missing("renderer", "pictures", "nothing can render off screen", _apt("libegl1 libgl1")))
    missing += [_missing(f"{e} recordings", "recordings", why, None) for e, why in recordings.items() if why]
    return {
        "scan3d": _version("scan3d"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": packages,
        "scan": {"works": trouble is None, "why_not": trouble},
        "rendering": pictures,
        "open3d": {"works": open3d is None, "why_not": open3d},
        "recordings": {ending: why is None for ending, why in recordings.items()},
        "missing": missing,
        "ok": trouble is None,
    }


def summary(found: dict[str, Any]) -> list[tuple[str, str]]:
    """The findings as rows for the terminal: what, and how it is."""
    packages = found["packages"]
    rows = [
        ("scan3d", f"{found['scan3d']}, Python {found['python']}, {found['platform']}"),
        ("scans", _works(found["scan"]["works"], found["scan"]["why_not"])),
        ("pictures", _works(found["rendering"], "nothing can render off screen")),
        ("open3d", _works(found["open3d"]["works"], found["open3d"]["why_not"], "works", "doesn't work")),
        ("recordings", ", ".join(ending for ending, works in found["recordings"].items() if works) or "none"),
        ("packages", ", ".join(f"{name} {number}" for name, number in packages.items() if number)),
    ]
    for one in found["missing"]:
        cure = f": {one['command']}" if one["command"] else ""
        rows.append(("missing", f"{one['what']} ({one['why']}), for {one['for']}{cure}"))
    if not found["missing"]:
        rows.append(("missing", "nothing"))
    return rows


def _works(works: bool, why_not: str | None, yes: str = "work", no: str = "don't work") -> str:
    return yes if works else f"{no} ({why_not})"


def _missing(what: str, use: str, why: str, command: str | None) -> dict[str, str | None]:
    return {"what": what, "for": use, "why": why, "command": command}


def _version(name: str) -> str | None:
    # open3d comes under two names
    for one in (name, f"{name}-cpu"):
        try:
            return version(one)
        except PackageNotFoundError:
            continue
    return None


def _pip(name: str) -> str:
    """The command that installs a package, in the version asked for by this one."""
    wanted = name
    if name == "open3d" and sys.platform == "linux" and platform.machine() == "x86_64":
        wanted = "open3d-cpu"
    elif name != "open3d":
        found = [re.match(rf"{name}\b[^;\s]*", line) for line in requires("scan3d") or ()]
        wanted = next((match[0] for match in found if match), name)
    return shlex.join([sys.executable, "-m", "pip", "install", wanted])


def _apt(packages: str) -> str | None:
    return f"apt-get install {packages}" if sys.platform == "linux" else None


def _trouble(code: str) -> str | None:
    """What goes wrong when a child process runs the code, in its last words; None if nothing does."""
    try:
        tried = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, timeout=_TIMEOUT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    if tried.returncode == 0:
        return None
    lines = [line.strip() for line in tried.stderr.splitlines() if line.strip()]
    if tried.returncode < 0:
        return f"killed by signal {-tried.returncode}"
    return lines[-1] if lines else f"exit code {tried.returncode}"


def _can_render() -> bool:
    try:
        from scan3d.pictures import rendering, views  # noqa: F401 - a picture needs what these import
    except ImportError:
        return False
    return rendering.can_render()


def _recordings() -> dict[str, str | None]:
    """What goes wrong with recordings of each ending that this version knows, None if nothing does."""
    try:
        import numpy as np

        from scan3d.errors import InputError
        from scan3d.files.recordings import check_path, read_recording, write_recording
        from scan3d.recording import Recording
        from scan3d.rods import Rod
    except ImportError as error:
        return {".csv": str(error)}
    one = Recording(
        sweep=np.zeros(1, np.int64),
        position_m=np.zeros((1, 3)),
        quaternion=np.array([[1.0, 0, 0, 0]]),
        force_N=np.zeros((1, 2)),
        moment_Nm=np.zeros(1),
        rod=Rod(1.0, 1.0),
    )
    found: dict[str, str | None] = {}
    with TemporaryDirectory() as place:
        for ending in _RECORDINGS:
            path = Path(place) / f"log{ending}"
            try:
                check_path(path)
            except InputError:
                continue
            try:
                write_recording(one, path)
                found[ending] = None if len(read_recording(path)) == 1 else "what is written isn't read back"
            except (InputError, ImportError) as error:
                found[ending] = str(error)
    return found
