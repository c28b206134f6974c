"""Fingerprints of what scans of all meshes give, to show that a change of the code does not change the results.

    python tests/benchmarks/fingerprints.py before.json             # in a checkout before the change
    python tests/benchmarks/fingerprints.py few.json --only egg     # scans with a word in their name, to compare with them
    python tests/benchmarks/fingerprints.py after.json              # in one after it
    python tests/benchmarks/fingerprints.py --compare before.json after.json

Recordings are hashed as they are written, clouds and surfaces column by column, so that a further column of ``cloud.ply``
does not count.  Both runs must be made on the same machine with the same versions of the libraries.  A run takes some minutes.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import scan3d

ROOT = Path(__file__).resolve().parents[2]
MESHES = ROOT / "meshes"
SETTINGS: dict[str, dict[str, Any]] = {
    "default": {},
    "adaptive": dict(friction="0.0:0.4", spacing="adaptive", seed=3),
    "noise": dict(slices=24, noise=1e-4, seed=5),
    "three axes": dict(slices=16, axis="xyz", spacing="adaptive", friction="0.0:0.3"),
}
SPATIAL = {
    "spatial": dict(model="spatial", friction="0.1:0.3", slices=12, sweeps=8, samples=60),
    "spatial noise": dict(model="spatial", slices=12, sweeps=8, samples=60, noise=1e-4, seed=2),
}
SPATIAL_MESHES = ("cube.stl", "egg.stl", "needle.ply")
RIG_MESHES = {"cube.stl": "box:45x45x45", "egg.stl": "cylinder:80x90", "lens.off": "cylinder:90x60"}
CLOUD = [
    "points",
    "normals",
    "normal_source",
    "phase",
    "slice",
    "sweep",
    "force_N",
    "friction",
    "slice_axis",
    "slice_height",
]


def digest(*arrays: Any) -> str:
    """Hash of arrays with their types and shapes."""
    hashed = hashlib.sha256()
    for array in map(np.ascontiguousarray, arrays):
        hashed.update(f"{array.dtype} {array.shape}".encode() + array.tobytes())
    return hashed.hexdigest()[:16]


def of_result(result: Any) -> dict[str, str]:
    """Hashes of contacts, surface and certificate."""
    cloud, surface = result.cloud, result.surface
    return {
        "cloud": digest(*(getattr(cloud, name) for name in CLOUD)),
        "surface": digest(surface.vertices, surface.faces),
        "certificate": digest(result.certificate.bound, surface.vertex_attributes["bound"]),
    }


def of_scan(mesh: Path, settings: dict[str, Any]) -> dict[str, str]:
    """Hashes of a scan: its recording (the two files), contacts, surface and certificate."""
    result = scan3d.scan(mesh, **settings)
    with tempfile.TemporaryDirectory() as folder:
        scan3d.write_recording(result.recording, Path(folder) / "log.csv")
        files = [path.read_bytes() for path in sorted(Path(folder).iterdir())]
    return {"recording": hashlib.sha256(b"".join(files)).hexdigest()[:16], **of_result(result)}


def of_rig(mesh: Path, around: str) -> dict[str, str]:
    """Hashes of what a computed rig logs of poses that are planned around a mesh, and of what follows from it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for arguments in (
            ["plan", "--around", around, "--out", "poses.csv"],
            ["simulate", mesh, "--poses", "poses.csv", "--out", "raw.csv"],
            ["reconstruct", "raw.csv", "--out", "out"],
        ):
            command = [sys.executable, "-m", "scan3d", *map(str, arguments)]
            environment = {**os.environ, "PYTHONPATH": str(ROOT)}
            subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True)
        files = [(folder / file).read_bytes() for file in ("poses.csv", "raw.csv")]
        cloud, surface = (scan3d.load(folder / "out" / file) for file in ("cloud.ply", "surface.ply"))
        return {
            "recording": hashlib.sha256(b"".join(files)).hexdigest()[:16],
            "cloud": digest(cloud.points, cloud.normals, *(cloud.columns[name] for name in sorted(cloud.columns))),
            "surface": digest(surface.vertices, surface.faces, surface.vertex_attributes["bound"]),
        }


def cases() -> dict[str, Callable[[], dict[str, str]]]:
    """All scans by their names."""
    meshes = sorted(path for path in MESHES.iterdir() if path.suffix != ".py" and path.is_file())
    found: dict[str, Callable[[], dict[str, str]]] = {}
    for mesh in meshes:
        for name, settings in {**SETTINGS, **(SPATIAL if mesh.name in SPATIAL_MESHES else {})}.items():
            found[f"{mesh.name}, {name}"] = partial(of_scan, mesh, settings)
        if mesh.name in RIG_MESHES:
            found[f"{mesh.name}, rig"] = partial(of_rig, mesh, RIG_MESHES[mesh.name])
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "files", nargs="+", metavar="FILE", help="the JSON file to write; with --compare two to compare"
    )
    parser.add_argument("--compare", action="store_true", help="list what differs between two files, and exit with 1")
    parser.add_argument("--only", default="", metavar="WORD", help="only the scans with this word in their name")
    arguments = parser.parse_args()
    if len(arguments.files) != 1 + arguments.compare:
        parser.error("give one file to write, or --compare and two files")
    if arguments.compare:
        before, after = (json.loads(Path(name).read_text(encoding="utf-8")) for name in arguments.files)
        both = [key for key in before if key in after and arguments.only in key]
        different = [f"{key}: {part}" for key in both for part in before[key] if after[key][part] != before[key][part]]
        print("\n".join(different) or f"{len(both)} of {len(before)} scans compared, all the same")
        return bool(different)
    fingerprints = {}
    for name, case in cases().items():
        if arguments.only in name:
            fingerprints[name] = case()
            print(f"{name}: {fingerprints[name]}", flush=True)
    Path(arguments.files[0]).write_text(json.dumps(fingerprints, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
