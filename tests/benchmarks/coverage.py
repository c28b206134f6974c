"""How often the bound under noise holds, and how wide it is: scans of four bodies with random noise.

    python tests/benchmarks/coverage.py [--seeds 100] [--slices 24] [--noise 1e-5 1e-4 1e-3] [--method hull] [--adaptive]

For each body and noise it prints in how many scans the certified bound of the surface is at least its true Hausdorff distance,
in how many the inner body lies in the true one and the true one within the bound of the inner one, and the bound's median,
relative to the truth and to the diagonal.  It fails if the bound holds in fewer than 95 % of the scans of a line.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

import scan3d
from scan3d.geometry.distance import nearest
from scan3d.workflow import analyse

MESHES = Path(__file__).parents[2] / "meshes"
BODIES = ("cube.stl", "egg.stl", "pebble.obj", "needle.ply")
# Rounding of distances, relative to the diagonal.
ROUNDING = 1e-9
CONFIDENCE = 0.95


def measure(name: str, noise: float, arguments: argparse.Namespace) -> bool:
    """Print the line of one body and noise; whether the bound holds often enough."""
    mesh = scan3d.load_mesh(MESHES / name)
    diagonal = float(np.linalg.norm(mesh.extents))
    held, enclosed, ratios, bounds, warned = 0, 0, [], [], 0
    for seed in range(arguments.seeds):
        plan = scan3d.Plan(
            slices=arguments.slices,
            friction=0.3,
            noise=noise,
            seed=seed,
            spacing="adaptive" if arguments.adaptive else "cosine",
        )
        analysis = analyse(scan3d.simulate(mesh, plan), mesh, arguments.method)
        truth, bound = analysis.comparison.hausdorff, analysis.certificate.bound
        warned += bool(analysis.warnings)
        held += truth <= bound + ROUNDING * diagonal
        inner = analysis.bounds.inner
        inside = nearest(np.asarray(inner.vertices), mesh)[0].max() <= ROUNDING * diagonal
        around = nearest(np.asarray(mesh.vertices), inner)[0].max() <= analysis.bounds.bound + ROUNDING * diagonal
        enclosed += inside and around
        ratios.append(bound / truth)
        bounds.append(bound / diagonal)
    print(
        f"{name:12} noise {noise:.0e}: holds {held}/{arguments.seeds}, encloses {enclosed}/{arguments.seeds}, "
        f"bound / truth {np.median(ratios):.2f} (median), bound {np.median(bounds):.2e} of the diagonal, warnings {warned}",
        flush=True,
    )
    return held >= CONFIDENCE * arguments.seeds and not warned


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--slices", type=int, default=24)
    parser.add_argument("--noise", type=float, nargs="+", default=[1e-5, 1e-4, 1e-3])
    parser.add_argument("--method", default="hull")
    parser.add_argument("--adaptive", action="store_true", help="slices spaced adaptively")
    arguments = parser.parse_args()
    results = [measure(name, noise, arguments) for name in BODIES for noise in arguments.noise]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
