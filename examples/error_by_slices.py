"""How many slices does it take, and where should they lie?

An ellipsoid is scanned in more and more slices, evenly spaced or denser at the ends (at Chebyshev's nodes).  The Hausdorff
distance of the surfaces to the true body is drawn over the number of slices, and above it the bound that the contacts alone
certify for their convex hull.

Between two slices at a distance h a chord lies h²/8R inside a body of radius R, so the hull's error falls as 1/n².  With even
spacing, however, the end slices lie h/2 from the poles, and the caps beyond them determine the error, which then falls as 1/n
only.  Slices at Chebyshev's nodes are 1/n² apart at the poles.  A surface between the certified bounds, a fitted support
function and Poisson's surface each extrapolate into the caps by a different rule.  The number of samples per sweep grows with
the number of slices, so that the gaps between contacts along a slice do not limit the error.  Where a curve flattens out,
another error dominates: for the support function the facets of the surface that is drawn from it, for Poisson's surface its
octree and its smoothing.

    python examples/error_by_slices.py [--out FILE] [--quick]

Reference: R. Schneider, Convex Bodies: The Brunn–Minkowski Theory, 2nd ed., Cambridge University Press 2014 (distance of
convex bodies and of their polytopes); L. N. Trefethen, Approximation Theory and Approximation Practice, SIAM 2013
(Chebyshev's nodes); for the methods see methods_by_meshes.py.
"""

import argparse
import runpy
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from paper_figure_3 import STYLE

import scan3d
from scan3d.surfaces import enclosure

make = runpy.run_path(str(Path(__file__).parents[1] / "meshes" / "make_meshes.py"))["make"]

FRICTION = (0.0, 0.4)
SLICES = (8, 12, 16, 24, 32, 48, 64, 96)
SAMPLES = 4  # per sweep, as a multiple of the number of slices
SUBDIVISIONS = 128  # 131,072 triangles, so that facets do not limit the errors shown
QUICK_SLICES, QUICK_SUBDIVISIONS = (8, 16), 24  # a few seconds instead of minutes
SPACINGS = {"uniform": "--", "cosine": "-"}
# Okabe and Ito's colours, which colour-blind readers can distinguish; markers for print in grey, larger ones drawn first.
METHODS = {
    "hull": ("#0072B2", "o", 7),
    "bracket": ("#56B4E9", "D", 4.5),
    "support": ("#D55E00", "s", 4.5),
    "poisson": ("#009E73", "^", 4.5),
    "ball-pivoting": ("#CC79A7", "v", 4),
}
BOUND = "0.35"  # grey of the certified bound
# Where the guide lines for the slopes start, relative to the hull's first error: below all curves, so that they hide none.
GUIDES = {1: 0.35, 2: 0.13}


@dataclass(frozen=True)
class Errors:
    """Distances over the diagonal of the body's bounding box, for one spacing."""

    slices: np.ndarray  # (k,)
    hausdorff: dict[str, np.ndarray]  # (k,) for each method; NaN where it refuses
    bound: np.ndarray  # (k,) certified for the hull


def measure(slices: Sequence[int], subdivisions: int) -> dict[str, Errors]:
    """The errors for each spacing: one scan per spacing and number of slices, shared by the methods."""
    mesh = make("ellipsoid", subdivisions)
    diagonal = float(np.linalg.norm(mesh.extents))
    errors = {}
    for spacing in SPACINGS:
        plans = [
            scan3d.Plan(slices=count, spacing=spacing, samples=max(64, SAMPLES * count), friction=FRICTION)
            for count in slices
        ]
        clouds = [scan3d.reconstruct(scan3d.simulate(mesh, plan)) for plan in plans]
        hausdorff = {method: np.array([error(cloud, method, mesh) for cloud in clouds]) for method in METHODS}
        bound = np.array([enclosure(cloud).bound for cloud in clouds]) / diagonal
        errors[spacing] = Errors(np.array(slices), hausdorff, bound)
    return errors


def error(cloud: scan3d.Cloud, method: str, mesh: object) -> float:
    """Relative Hausdorff distance; NaN if the method refuses the cloud."""
    try:
        return scan3d.compare(scan3d.surface(cloud, method), mesh).relative
    except scan3d.InputError:
        return np.nan


def figure(errors: dict[str, Errors]) -> Figure:
    """A panel for each spacing, both with the same axes."""
    with rc_context(STYLE):
        drawn = Figure(figsize=(7.2, 3.9), layout="constrained")
        panels = drawn.subplots(1, len(errors), sharex=True, sharey=True)
        for axes, panel, (spacing, curves) in zip(panels, "ab", errors.items(), strict=True):
            draw_errors(axes, curves, SPACINGS[spacing])
            axes.set_title(f"({panel}) {spacing} spacing", loc="left")
            axes.set_xlabel("number of slices $n$")
        panels[0].set_ylabel("Hausdorff distance / diagonal")
        low, high = panels[0].get_ylim()
        guide(panels[0], errors["uniform"], 1)
        guide(panels[1], errors["cosine"], 2)
        panels[0].set_ylim(low, high)
        drawn.legend(*panels[-1].get_legend_handles_labels(), loc="outside upper center", ncols=(len(METHODS) + 2) // 2)
    return drawn


def draw_errors(axes: Axes, errors: Errors, style: str) -> None:
    """Log-log curves of all methods, and the hull's certified bound above them."""
    axes.set(xscale="log", yscale="log")
    axes.set_xticks(errors.slices, [str(count) for count in errors.slices])
    axes.set_xticks([], minor=True)
    axes.plot(errors.slices, errors.bound, style, color=BOUND, linewidth=2.2, label="certified bound of the hull")
    for method, (color, marker, size) in METHODS.items():
        axes.plot(errors.slices, errors.hausdorff[method], style, color=color, marker=marker, ms=size, label=method)
    axes.grid(color="0.92", linewidth=0.6)


def guide(axes: Axes, errors: Errors, power: int) -> None:
    """A thin line that falls as n to the minus `power`, well below the hull's error, over the first half of the slices."""
    ends = errors.slices[[0, len(errors.slices) // 2]].astype(float)
    line = GUIDES[power] * errors.hausdorff["hull"][0] * (ends / ends[0]) ** -power
    axes.plot(ends, line, ":", color="black", linewidth=1.0)
    label = r"$\propto 1/n$" if power == 1 else rf"$\propto 1/n^{power}$"
    axes.annotate(label, (ends[1], line[1]), (5, -4), textcoords="offset points")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Figure of the error over the number of slices.")
    parser.add_argument("--out", type=Path, default=Path(Path(__file__).with_suffix(".png").name))
    parser.add_argument("--quick", action="store_true", help="few slices, coarse mesh")
    given = parser.parse_args(arguments)
    setting = (QUICK_SLICES, QUICK_SUBDIVISIONS) if given.quick else (SLICES, SUBDIVISIONS)
    figure(measure(*setting)).savefig(given.out, dpi=150)


if __name__ == "__main__":
    main()
