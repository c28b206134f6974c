"""Times of every stage of a scan over slices, facets and contacts.

    python tests/benchmarks/performance.py [--only slices facets contacts] [--page docs/performance.md]

Prints tables in Markdown; with `--page` they replace those of the same name in the manual's page, between its marks.  Each
measurement runs in a process of its own, with one thread.  Times are the processor's, so that other programs disturb them
little; memory is the largest of the process.  An exponent is that of a power of the size, fitted to all times of at least
`WORTH` seconds.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

import planar
import scan3d

EGG = Path(__file__).resolve().parents[2] / "meshes" / "egg.stl"
SEMI_AXES = np.array([40.0, 30.0, 25.0])
TURN = trimesh.transformations.rotation_matrix(0.3, (1.0, 2.0, 3.0))
LARGER = 1 + 1e-4
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "IGL_NUM_THREADS", "LP_NUM_THREADS")
# Sweeps of 64 slices of the egg, of which each gives about as many contacts as it has samples.
SWEEPS = 390
# Seconds below which a time does not count for an exponent, and after which a measurement is given up.
WORTH, LONGEST = 0.05, 1500
SIZES = {
    "slices": [64, 128, 256, 512, 1024],
    "facets": [10_000, 100_000, 1_000_000, 2_000_000],
    "contacts": [10_000, 100_000, 1_000_000, 10_000_000],
    "reconstruct": [10_000, 100_000, 1_000_000, 10_000_000],
}
TITLES = {
    "slices": "slices of a scan of the egg",
    "facets": "facets of an ellipsoid",
    "contacts": "contacts in 64 slices of the egg",
    "reconstruct": "contacts",
}
Steps = dict[str, float]


def seconds(task: Callable[[], Any]) -> float:
    """Time of the processor for a task."""
    start = time.process_time()
    task()
    return time.process_time() - start


def ellipsoid(facets: int) -> trimesh.Trimesh:
    """An ellipsoid of about so many facets of similar size: the hull of a spiral of points."""
    number = np.arange(facets // 2 + 2) + 0.5
    z, angle = 1 - 2 * number / len(number), np.pi * (1 + 5**0.5) * number
    radius = np.sqrt(1 - z**2)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    inward = (
        np.einsum("fx,fx->f", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners[:, 0]) < 0
    )
    faces = hull.simplices.astype(np.int64)
    faces[inward] = faces[inward, ::-1]
    return trimesh.Trimesh(points * SEMI_AXES, faces, process=False)


def changed(body: trimesh.Trimesh, how: str) -> trimesh.Trimesh:
    """The ellipsoid turned, or hardly larger."""
    other = body.copy()
    other.apply_transform(TURN) if how == "turned" else other.apply_scale(LARGER)
    return other


def timings(mesh: Any, **settings: Any) -> tuple[scan3d.Result, Steps]:
    """A scan without pictures, and seconds for each of its steps."""
    scan3d.scan(EGG, slices=8)  # imports
    with patch("time.perf_counter", time.process_time):  # the clock of the steps
        result = scan3d.scan(mesh, **settings)
    steps = dict(result.report["timings_s"])
    return result, {**steps, "sum": sum(steps.values())}


# What is measured, by name: a function from the size to the seconds of its steps


def slices(size: int) -> Steps:
    return timings(EGG, slices=size)[1]


def facets(size: int) -> Steps:
    body = ellipsoid(size)
    turned, larger = changed(body, "turned"), changed(body, "larger")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "body.ply"
        body.export(path)
        steps = timings(path, slices=64)[1]
    shown = {name: steps[name] for name in ("load", "simulate", "compare", "sum")}
    return {
        **{f"scan of 64 slices: {name}": value for name, value in shown.items()},
        "`compare` with it turned": seconds(lambda: scan3d.compare(turned, body)),
        "`compare` with it hardly larger": seconds(lambda: scan3d.compare(larger, body)),
    }


def contacts(size: int) -> Steps:
    result, steps = timings(EGG, slices=64, samples=size // SWEEPS)
    return {"contacts": len(result.cloud), **steps}


def reconstruct(size: int) -> Steps:
    circle = planar.Circle(radius=0.9, center=(0.0, 1.3))
    swept = planar.sweep(circle, 0.2, samples=1000)
    columns = [np.resize(column, size) for column in (swept.x0, swept.f0x, swept.f0y, swept.m0z)]
    planar.reconstruct(*(column[:1000] for column in columns))
    return {
        "`planar.sweep`": seconds(lambda: planar.sweep(circle, 0.2, samples=size)),
        "`planar.reconstruct`": seconds(lambda: planar.reconstruct(*columns)),
    }


CASES: dict[str, Callable[[int], Steps]] = {
    "slices": slices,
    "facets": facets,
    "contacts": contacts,
    "reconstruct": reconstruct,
}


# Measurements in processes of their own, and their tables


def measured(name: str, size: int) -> Steps:
    """The steps of one measurement, and its largest memory in GB; nothing if it took too long or failed."""
    command = [sys.executable, __file__, "--case", name, str(size)]
    single = dict.fromkeys(THREADS, "1")
    try:
        run = subprocess.run(command, env={**os.environ, **single}, capture_output=True, text=True, timeout=LONGEST)
    except subprocess.TimeoutExpired:
        return {}
    if run.returncode:
        print(run.stderr[-2000:], file=sys.stderr)
        return {}
    steps: Steps = json.loads(run.stdout.splitlines()[-1])
    return steps


def exponent(sizes: list[int], times: list[float | None]) -> str:
    """The fitted power of the size; a dash with fewer than two times that are long enough."""
    known = [(size, value) for size, value in zip(sizes, times, strict=True) if value is not None and value >= WORTH]
    if len(known) < 2:
        return "–"
    size, value = np.log(known).T
    return f"{np.polyfit(size, value, 1)[0]:.2f}"


def table(name: str, sizes: list[int], results: list[Steps]) -> str:
    """A table in Markdown: a row for each step, a column for each size."""
    # contacts are as many as the sweeps gave
    sizes = [int(steps.pop("contacts", size)) for size, steps in zip(sizes, results, strict=True)]
    rows = list(dict.fromkeys(key for steps in results for key in steps))
    lines = [
        f"| seconds, by {TITLES[name]} | " + " | ".join(f"{size:,}" for size in sizes) + " | exponent |",
        "|---" * (len(sizes) + 2) + "|",
    ]
    for row in rows:
        values = [steps.get(row) for steps in results]
        is_time = not row.startswith("memory")
        shown = [cell(value) for value in values]
        lines.append(f"| {row} | " + " | ".join(shown) + f" | {exponent(sizes, values) if is_time else ''} |")
    return "\n".join(lines)


def cell(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.2f}" if value < 100 else f"{value:.0f}"


def machine() -> str:
    """What the times depend on."""
    model = platform.processor() or platform.machine()
    with Path("/proc/cpuinfo").open(encoding="utf-8") as file:
        model = next((line.split(":")[1].strip() for line in file if line.startswith("model name")), model)
    return f"{model}, {os.cpu_count()} cores; Python {platform.python_version()}, numpy {np.__version__}"


def replace(page: Path | None, name: str, text: str) -> None:
    """Replace what stands between the marks of a name in a page."""
    if page:
        before = page.read_text(encoding="utf-8")
        marks = rf"(<!-- {name} -->\n).*?(<!-- end -->)"
        after, count = re.subn(marks, lambda found: f"{found[1]}{text}\n{found[2]}", before, count=1, flags=re.DOTALL)
        if not count:
            raise SystemExit(f"{page} has no marks <!-- {name} --> and <!-- end -->")
        page.write_text(after, encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--largest", type=int, default=10**9, help="leave out larger sizes")
    parser.add_argument("--page", type=Path, help="the page whose tables are replaced")
    parser.add_argument("--case", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.case:
        steps = CASES[options.case[0]](int(options.case[1]))
        unit = 1 if sys.platform == "darwin" else 1024
        print(json.dumps({**steps, "memory, GB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9}))
        return
    print(machine())
    replace(options.page, "machine", machine())
    for name in options.only:
        sizes = [size for size in SIZES[name] if size <= options.largest]
        text = table(name, sizes, [measured(name, size) for size in sizes])
        print(f"\n{text}", flush=True)
        replace(options.page, name, text)


if __name__ == "__main__":
    main()
