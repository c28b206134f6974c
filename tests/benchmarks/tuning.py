"""Error of the surface over each number with which it is estimated between the inner and the outer body.

    python tests/benchmarks/tuning.py [--quick] [--only NAME ...] [--slices N]

For each field of `Tuning` a table gives the Hausdorff distance of the surface to the true body, relative to the diagonal of
its bounding box: median and largest over the meshes in meshes/ and over random bodies, for the present value (marked) and for
values around it, with all other fields as they are.  The largest error often lies where a field does not act; the table
therefore also gives the ratio of the errors to those with the present value, as a geometric mean over the bodies.  Fields
that act on the interpolation are tried with the method `bracket`, fields that act on the choice among the methods with
`auto`.  Every body is scanned once, with exact reactions: the meshes with cosine spacing, the random bodies with cosine and
with adaptive spacing in turn.

Whoever changes one of these numbers runs this script before the change, and states in the commit what the table says.
"""

from __future__ import annotations

import argparse
import platform
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from trimesh.creation import icosphere

import scan3d
from scan3d.geometry.hulls import hull
from scan3d.surfaces import Tuning

Array = NDArray[np.float64]

MESHES = Path(__file__).resolve().parents[2] / "meshes"
QUICK_MESHES = ("cube", "cylinder", "egg", "gem", "lens", "rounded_box")
SLICES, RANDOM_BODIES = 32, 24
QUICK_SLICES, QUICK_RANDOM_BODIES = 20, 8
SAMPLES = 32
FRICTION = (0.0, 0.4)
# Errors below this fraction of the diagonal are rounding.
ROUNDING = 1e-9

# Numbers between 0 and 1 are tried near the present value, tolerances over two decades.
NEAR = (0.5, 0.75, 4 / 3, 2.0)
DECADES = (0.1, 1 / 3, 3.0, 10.0)


class Field(NamedTuple):
    """One number of `Tuning`, and how it is tried."""

    name: str
    method: str
    """The method of `scan3d.surface` in which the number acts."""
    factors: tuple[float, ...]
    """The values tried, in those of the present value."""
    upper: float
    """No larger value is tried."""


FIELDS = (
    Field("unknown", "bracket", NEAR, 1.0),
    Field("damping", "bracket", NEAR, 1.0),
    Field("unseen_corners", "bracket", NEAR, 1.0),
    Field("straight", "bracket", DECADES, 1.0),
    Field("parabola", "bracket", NEAR, 1.0),
    Field("crease", "bracket", NEAR, 0.99),
    Field("sharp_advantage", "bracket", NEAR, 1.0),
    Field("round_advantage", "bracket", NEAR, 1.0),
    Field("flat_advantage", "bracket", NEAR, 1.0),
    Field("fit_gain", "auto", NEAR, 1.0),
    Field("fit_close", "auto", NEAR, 1.0),
    Field("proven", "auto", DECADES, np.inf),
)


def present() -> dict[str, float]:
    """The numbers as they are."""
    return asdict(Tuning())


def surface_with(cloud: scan3d.Cloud, method: str, **numbers: float) -> Any:
    """The surface of a cloud with some of the numbers changed."""
    return scan3d.surface(cloud, method, tuning=replace(Tuning(), **numbers))


# The bodies


class Body(NamedTuple):
    name: str
    mesh: Any
    cloud: scan3d.Cloud


def random_body(seed: int) -> tuple[str, Any]:
    """In turn a polytope, an ellipsoid, a Minkowski sum of such two, and a turned part: some 40 long, all but the last askew.

    The ellipsoids are so fine that slices and not facets limit the surface; the turned part, a ball on a shaft with two
    shoulders, is straight on both sides of its creases and curved elsewhere.
    """
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(12, 3))
    ball, coarse_ball = (icosphere(subdivisions=n).vertices.view(np.ndarray) for n in (5, 3))
    axes = rng.uniform(0.3, 1.0, size=3)
    kind = ("polytope", "ellipsoid", "sum", "turned")[seed % 4]
    if kind == "polytope":
        points = corners
    elif kind == "ellipsoid":
        points = ball * axes
    elif kind == "sum":
        points = (corners[:, None] + 0.4 * axes * coarse_ball).reshape(-1, 3)
    else:
        angle = 2 * np.pi * np.arange(256) / 256
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        discs = [
            np.column_stack([radius * circle, np.full(len(angle), height)])
            for radius, height in zip(rng.uniform((0.3, 0.8, 0.6), (0.6, 1.0, 0.8)), (-1.2, -0.3, 0.4), strict=True)
        ]
        points = np.concatenate([*discs, 0.6 * ball + [0.0, 0.0, 0.6]])
    if kind != "turned":
        points = Rotation.random(random_state=rng).apply(points)
    points = 20 * points
    return f"{kind} {seed}", hull(points[ConvexHull(points).vertices])


def scanned(name: str, mesh: Any, slices: int, spacing: str) -> Body:
    plan = scan3d.Plan(slices=slices, spacing=spacing, samples=SAMPLES, friction=FRICTION)
    return Body(name, mesh, scan3d.reconstruct(scan3d.simulate(mesh, plan)))


def all_bodies(quick: bool, slices: int) -> dict[str, list[Body]]:
    """The bodies with their clouds: the meshes, and the random ones."""
    paths = sorted(path for path in MESHES.iterdir() if path.suffix in (".stl", ".ply", ".obj", ".off", ".glb"))
    meshes = [(path.stem, scan3d.load_mesh(path)) for path in paths if not quick or path.stem in QUICK_MESHES]
    randoms = [random_body(seed) for seed in range(QUICK_RANDOM_BODIES if quick else RANDOM_BODIES)]
    # a number that acts on polyhedra in sparse slices may do nothing where slices lie on the vertices, and the other way
    return {
        "meshes": [scanned(name, mesh, slices, "cosine") for name, mesh in meshes],
        "random bodies": [
            scanned(name, mesh, slices, ("cosine", "adaptive")[seed // 4 % 2])
            for seed, (name, mesh) in enumerate(randoms)
        ],
    }


# The tables


class Errors(NamedTuple):
    """Distances (n,) of the surfaces of n bodies to the bodies, relative to the diagonals."""

    hausdorff: Array
    mean: Array


def errors(bodies: list[Body], method: str, **numbers: float) -> Errors:
    found = [scan3d.compare(surface_with(body.cloud, method, **numbers), body.mesh) for body in bodies]
    hausdorff, mean = np.array([(one.relative, one.mean / one.diagonal) for one in found]).T
    return Errors(hausdorff, mean)


def ratio(changed: Array, as_is: Array) -> float:
    """Geometric mean of changed errors (n,) over those with the present values, without bodies met to rounding."""
    visible = (changed > ROUNDING) | (as_is > ROUNDING)
    logarithms = np.log(np.maximum(changed[visible], ROUNDING) / np.maximum(as_is[visible], ROUNDING))
    return float(np.exp(logarithms.mean())) if visible.any() else 1.0


def print_row(
    value: float, groups: dict[str, list[Body]], changed: dict[str, Errors], as_is: dict[str, Errors]
) -> None:
    cells = ""
    for group, bodies in groups.items():
        hausdorff, worst = changed[group].hausdorff, int(np.argmax(changed[group].hausdorff))
        ratios = (ratio(after, before) for after, before in zip(changed[group], as_is[group], strict=True))
        cells += f"{np.median(hausdorff):>11.2e}{hausdorff[worst]:>10.2e}" + "".join(f"{x:>8.3f}" for x in ratios)
        cells += f"  {bodies[worst].name:<15}"
    print(f"{value:>9.4g}{cells}{'<- present' if changed is as_is else ''}".rstrip(), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Error of the surface over each number of its tuning.")
    parser.add_argument("--quick", action="store_true", help="fewer bodies, fewer slices: minutes instead of an hour")
    parser.add_argument("--only", nargs="+", choices=[field.name for field in FIELDS], help="only these numbers")
    parser.add_argument(
        "--slices", type=int, help=f"slices of every body: {SLICES} unless given, {QUICK_SLICES} if quick"
    )
    options = parser.parse_args()
    slices = options.slices or (QUICK_SLICES if options.quick else SLICES)
    start = time.perf_counter()
    groups = all_bodies(options.quick, slices)
    numbers = present()
    fields = [field for field in FIELDS if not options.only or field.name in options.only]
    # the present values are the same in all tables
    as_is = {
        method: {group: errors(bodies, method) for group, bodies in groups.items()}
        for method in sorted({field.method for field in fields})
    }
    print(f"Python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}")
    print(", ".join(f"{len(bodies)} {group}" for group, bodies in groups.items()) + f", {slices} slices each")
    print(
        "median, largest: Hausdorff distance relative to the diagonal; H, mean: Hausdorff and mean distance, in those with"
    )
    print("the present value (geometric mean over the bodies); worst: the body with the largest")
    for field in fields:
        value, before = numbers[field.name], as_is[field.method]
        tried = {min(factor * value, field.upper) for factor in field.factors} | {value}
        print(f"\n{field.name}, method {field.method}")
        print(
            f"{'value':>9}"
            + "".join(f"{'median':>11}{'largest':>10}{'H':>8}{'mean':>8}  {'worst':<15}" for _ in groups)
        )
        for number in sorted(tried):
            if number == value:
                print_row(number, groups, before, before)
                continue
            changed = {group: errors(bodies, field.method, **{field.name: number}) for group, bodies in groups.items()}
            print_row(number, groups, changed, before)
    print(f"\n{time.perf_counter() - start:.0f} s", file=sys.stderr)


if __name__ == "__main__":
    main()
