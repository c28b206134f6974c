"""Fingerprints of what scans of all meshes give, to show that a change of the code does not change the results.

    python tests/benchmarks/fingerprints.py before.json             # in a checkout before the change
    python tests/benchmarks/fingerprints.py after.json              # in one after it
    python tests/benchmarks/fingerprints.py --compare before.json after.json

Recordings are hashed as they are written, clouds and surfaces column by column, so that a further column of ``cloud.ply``
does not count.  Both runs must be made on the same machine with the same versions of the libraries.  A run takes some minutes.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import scan3d

MESHES = Path(__file__).resolve().parents[2] / "meshes"
PLANS: dict[str, dict[str, Any]] = {
    "default": {},
    "adaptive": dict(friction=(0.0, 0.4), spacing="adaptive", seed=3),
    "noise": dict(slices=24, noise=1e-4, seed=5),
    "three axes": dict(slices=16, axis="xyz", spacing="adaptive", friction=(0.0, 0.3)),
}
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


def fingerprint(mesh: Path, plan: dict[str, Any]) -> dict[str, str]:
    """Hashes of a scan's recording (its two files), cloud and surface."""
    recording = scan3d.simulate(scan3d.load_mesh(mesh), scan3d.Plan(**plan))
    with tempfile.TemporaryDirectory() as folder:
        scan3d.write_recording(recording, Path(folder) / "log.csv")
        files = [path.read_bytes() for path in sorted(Path(folder).iterdir())]
    cloud = scan3d.reconstruct(recording)
    surface = scan3d.surface(cloud)
    return {
        "recording": hashlib.sha256(b"".join(files)).hexdigest()[:16],
        "cloud": digest(*(getattr(cloud, name) for name in CLOUD)),
        "surface": digest(surface.vertices, surface.faces),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "files", nargs="+", metavar="FILE", help="the JSON file to write; with --compare two to compare"
    )
    parser.add_argument("--compare", action="store_true", help="list what differs between two files, and exit with 1")
    arguments = parser.parse_args()
    if len(arguments.files) != 1 + arguments.compare:
        parser.error("give one file to write, or --compare and two files")
    if arguments.compare:
        before, after = (json.loads(Path(name).read_text(encoding="utf-8")) for name in arguments.files)
        different = [
            f"{key}: {part}" for key in before for part in before[key] if after[key][part] != before[key][part]
        ]
        print("\n".join(different) or f"all {len(before)} scans are the same")
        return bool(different)
    fingerprints = {}
    for mesh in sorted(path for path in MESHES.iterdir() if path.suffix != ".py" and path.is_file()):
        for name, plan in PLANS.items():
            fingerprints[f"{mesh.name}, {name}"] = fingerprint(mesh, plan)
            print(f"{mesh.name}, {name}: {fingerprints[f'{mesh.name}, {name}']}", flush=True)
    Path(arguments.files[0]).write_text(json.dumps(fingerprints, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
