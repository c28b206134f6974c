"""How long the steps of a scan take, and how their times grow with the number of slices and with the size of meshes.

    python tests/benchmarks/scans.py [--slices 64 256 1024] [--facets 20480 81920 327680]

The egg of `meshes/` is scanned with cosine spacing; ellipsoids with more and more facets are loaded and compared.  Times are
the processor's, of one process; an exponent is that of the growth between the last two columns.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numpy as np
import trimesh

import scan3d

MESH = Path(__file__).parents[2] / "meshes" / "egg.stl"
SEMI_AXES = np.array([40.0, 30.0, 25.0])
TURN = trimesh.transformations.rotation_matrix(0.3, (1.0, 2.0, 3.0))


def seconds(task: Callable[[], object]) -> float:
    """Time of the processor for a task."""
    start = time.process_time()
    task()
    return time.process_time() - start


def steps_of_a_scan(slices: int) -> dict[str, float]:
    """Seconds for each step of a scan of the egg without pictures."""
    with patch("time.perf_counter", time.process_time):  # the clock of the steps
        result = scan3d.scan(MESH, slices=slices, spacing="cosine")
    return dict(result.report["timings_s"])


def ellipsoid(facets: int) -> trimesh.Trimesh:
    """An ellipsoid of about so many facets."""
    sphere = trimesh.creation.icosphere(subdivisions=round(np.log(facets / 20) / np.log(4)))
    return trimesh.Trimesh(sphere.vertices * SEMI_AXES, sphere.faces, process=False)


def large_meshes(facets: int) -> dict[str, float]:
    """Seconds for loading an ellipsoid, and for comparing it with one that is turned, and with one that hardly differs."""
    body = ellipsoid(facets)
    turned, larger = body.copy(), body.copy()
    turned.apply_transform(TURN)
    larger.apply_scale(1 + 1e-4)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "body.ply"
        body.export(path)
        load = seconds(lambda: scan3d.load_mesh(path))
    return {
        "load": load,
        "compare, turned": seconds(lambda: scan3d.compare(turned, body)),
        "compare, larger": seconds(lambda: scan3d.compare(larger, body)),
    }


def print_table(title: str, sizes: list[int], measured: list[dict[str, float]]) -> None:
    """One row for each step, one column for each size, and the exponent."""
    print(f"\n{title:<20}" + "".join(f"{size:>12,}" for size in sizes) + f"{'exponent':>12}")
    for name in measured[0]:
        times = [steps[name] for steps in measured]
        growth = np.log(max(times[-1], 1e-3) / max(times[-2], 1e-3)) / np.log(sizes[-1] / sizes[-2])
        print(f"{name:<20}" + "".join(f"{value:>12.2f}" for value in times) + f"{growth:>12.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--slices", type=int, nargs="+", default=[64, 256, 1024])
    parser.add_argument("--facets", type=int, nargs="+", default=[20_480, 81_920, 327_680, 1_310_720])
    options = parser.parse_args()
    steps_of_a_scan(8)  # imports
    print_table("scan of slices, s", options.slices, [steps_of_a_scan(number) for number in options.slices])
    print_table("meshes of facets, s", options.facets, [large_meshes(number) for number in options.facets])


if __name__ == "__main__":
    main()
