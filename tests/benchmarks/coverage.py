"""How often the bound under noise holds, and how wide it is: scans of four bodies with random noise.

    python tests/benchmarks/coverage.py [--seeds 100] [--slices 24] [--noise 1e-5 1e-4 1e-3] [--method hull] [--adaptive]

For each body and noise it prints in how many scans the certified bound of the surface is at least its true Hausdorff distance,
in how many the inner body lies in the true one and the true one within the bound of the inner one, and the medians of the
bounds: that of the inner body relative to its truth, and that of the surface relative to its truth, to the diagonal, and to
the least bound that holds.

An estimate may lie far closer to the body than any measurement of contacts can prove.  The convex hull of the true contacts
is a body whose scan has the same contacts, so that no bound that holds is smaller than the distance of the surface to that
hull, nor smaller than the distance to the true body; the least bound is the larger of the two.

It fails if the bound holds in fewer than 95 % of the scans of a line, or if one of the medians relative to the inner body's
truth and to the least bound is more than 5.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

import numpy as np

import scan3d
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import hull
from scan3d.pipeline import analyse
from scan3d.reconstruction.contacts import contacts

MESHES = Path(__file__).parents[2] / "meshes"
BODIES = ("cube.stl", "egg.stl", "pebble.obj", "needle.ply")
# Rounding of distances, relative to the diagonal.
ROUNDING = 1e-9
CONFIDENCE = 0.95
WIDEST = 5.0
"""Bounds are at most so many times the truth, or the least bound, in the median."""


def measure(name: str, noise: float, arguments: argparse.Namespace) -> bool:
    """Print the line of one body and noise; whether the bound holds often enough, and is narrow enough."""
    mesh = scan3d.load_mesh(MESHES / name)
    diagonal = float(np.linalg.norm(mesh.extents))
    held, enclosed, warned = 0, 0, 0
    by_inner, by_truth, by_least, bounds = [], [], [], []
    plan = scan3d.Plan(slices=arguments.slices, friction=0.3, spacing="adaptive" if arguments.adaptive else "cosine")
    touched = hull(contacts(scan3d.simulate(mesh, plan)).points)
    for seed in range(arguments.seeds):
        noisy = dataclasses.replace(plan, noise=noise, seed=seed)
        analysis = analyse(scan3d.simulate(mesh, noisy), mesh, arguments.method)
        truth, bound = analysis.comparison.hausdorff, analysis.certificate.bound
        warned += bool(analysis.warnings)
        held += truth <= bound + ROUNDING * diagonal
        inner = analysis.bounds.inner
        inside = nearest(np.asarray(inner.vertices), mesh)[0].max() <= ROUNDING * diagonal
        inner_truth = float(nearest(np.asarray(mesh.vertices), inner)[0].max())
        enclosed += inside and inner_truth <= analysis.bounds.bound + ROUNDING * diagonal
        by_inner.append(analysis.bounds.bound / inner_truth)
        by_truth.append(bound / truth)
        by_least.append(bound / max(truth, float(nearest(np.asarray(analysis.surface.vertices), touched)[0].max())))
        bounds.append(bound / diagonal)
    medians = [float(np.median(ratios)) for ratios in (by_inner, by_least)]
    print(
        f"{name:12} noise {noise:.0e}: holds {held}/{arguments.seeds}, encloses {enclosed}/{arguments.seeds}, medians: "
        f"inner bound / truth {medians[0]:.2f}, bound / least {medians[1]:.2f}, bound / truth {np.median(by_truth):.2f}, bound "
        f"{np.median(bounds):.2e} of the diagonal, warnings {warned}",
        flush=True,
    )
    return held >= CONFIDENCE * arguments.seeds and not warned and max(medians) <= WIDEST


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
