"""What does it cost to read sweeps of a round rod by the planar model, which supposes that the rod stays in its slice?

A round rod bends where the contact force pushes it.  Where the surface leans out of the slice's plane, the force pushes the
rod out of it.  Here the sweeps are those of the true rod in space, in horizontal slices at several heights of a sphere and of
an ellipsoid, without friction and with it.  `planar.reconstruct` reads the three reactions in the plane, the spatial inverse
reads all six.

(a) the fraction of the samples in contact that the planar model refuses, because a rod in the plane with these reactions would
be pulled along the contour, or would be bent against the sweep; without friction nearly all of them.  (b) the distance of the
other contacts from the true ones, in % of the diagonal of the bounding box: the median as a line, and up to the largest as an
area; below them the largest error of the spatial inverse.  Both over the height of the slice above the middle, in semi-axes.

Lengths are in rod lengths L, forces in EI/L², moments in EI/L.

    python examples/what_planarity_costs.py [--out FILE]

Reference: the planar model is that of L. Merker, J. Steigenberger, C. Behn, Friction Invariant Object Reconstruction Using a
Vibrissa-inspired Tactile Sensor Concept; the spatial one is derived in the manual's page "The model".
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from paper_figure_3 import STYLE

import planar
from scan3d.spatial import inverse
from scan3d.spatial.bodies import Ellipsoid
from scan3d.spatial.sweeping import sweep

# Semi-axes and centre: the sphere of the paper's circle, and an ellipsoid with three different semi-axes.
BODIES = {
    "sphere": ((0.9, 0.9, 0.9), (0.0, 1.3, 0.0)),
    "ellipsoid": ((0.9, 0.675, 0.45), (0.0, 1.075, 0.0)),
}
FRICTIONS = (0.0, 0.3)
# Heights of the slices above the middle, over the vertical semi-axis.
HEIGHTS = np.array([0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75])
SAMPLES = 120
COLORS = {"sphere": "#0072B2", "ellipsoid": "#D55E00"}


class Costs(NamedTuple):
    """What readings of one height after the other give, for h heights."""

    refused: np.ndarray
    """(h,) fraction of the samples in contact that the planar model refuses."""
    median: np.ndarray
    """(h,) median distance of the other planar contacts from the true ones, over the diagonal; NaN without any."""
    largest: np.ndarray
    """(h,) their largest distance, likewise."""
    spatial: np.ndarray
    """(h,) largest distance of the contacts by the spatial inverse, likewise."""
    out_of_plane: np.ndarray
    """(h,) largest distance of a true contact from its slice, in rod lengths."""


def costs(name: str, friction: float) -> Costs:
    """Sweeps past a body at all heights in lockstep, each read by both models."""
    semi_axes, center = (np.array(values) for values in BODIES[name])
    z = HEIGHTS * semi_axes[2]
    x0 = np.linspace(1.2, -1.4, SAMPLES)
    position = np.stack(np.broadcast_arrays(x0, 0.0, z[:, None]), axis=-1)
    swept = sweep(Ellipsoid(semi_axes, center), position, np.tile(np.eye(3), (len(z), 1, 1)), friction)
    diagonal = 2 * np.linalg.norm(semi_axes)
    rows = []
    for height, force, moment, point in zip(z, swept.force, swept.moment, swept.point, strict=True):
        touching = np.isfinite(force[:, 0])
        force, moment, point, base = force[touching], moment[touching], point[touching], x0[touching]
        read = planar.reconstruct(base, force[:, 0], force[:, 1], moment[:, 2])
        valid = read.status == planar.Status.OK
        in_slice = np.column_stack([read.point[valid], np.full(valid.sum(), height)])
        error = np.linalg.norm(in_slice - point[valid], axis=1) / diagonal if valid.any() else np.array([np.nan])
        in_space = inverse.reconstruct(force, moment).point + np.stack(np.broadcast_arrays(base, 0.0, height), axis=-1)
        spatial = np.nanmax(np.linalg.norm(in_space - point, axis=1)) / diagonal
        rows.append([1 - valid.mean(), np.median(error), error.max(), spatial, np.abs(point[:, 2] - height).max()])
    return Costs(*np.array(rows).T)


COSTS = {(name, friction): costs(name, friction) for name in BODIES for friction in FRICTIONS}


def draw() -> Figure:
    """The figure, two columns of a page wide."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.4), layout="constrained")
        refused, error = figure.subplots(1, 2)
        for (name, friction), cost in COSTS.items():
            style = dict(color=COLORS[name], linestyle="-" if friction else "--", marker="o" if friction else "s", ms=3)
            refused.plot(HEIGHTS, 100 * cost.refused, label=rf"{name}, $\mu = {friction:g}$", **style)
            if friction:  # without it hardly a sample is left
                error.plot(HEIGHTS, 100 * cost.median, **style)
                error.fill_between(HEIGHTS, 100 * cost.median, 100 * cost.largest, color=COLORS[name], alpha=0.15, lw=0)
            error.plot(HEIGHTS, 100 * cost.spatial, **{**style, "marker": "", "linewidth": 0.8})
        refused.set(xlabel="$z\\;/\\;R$", ylabel="samples refused in %", ylim=(-4, 104))
        refused.legend(loc="lower right")
        error.set(xlabel="$z\\;/\\;R$", ylabel="error in % of the diagonal", yscale="log", ylim=(1e-14, 30))
        error.yaxis.set_major_locator(LogLocator(numticks=9))
        error.yaxis.set_minor_formatter(NullFormatter())
        error.text(0.5, 5e-2, "read by the planar model", ha="center", va="center")
        error.text(0.5, 1e-12, "read by the spatial inverse", ha="center", va="center")
        for axes, title in ((refused, "(a)"), (error, "(b)")):
            axes.set_title(title, loc="left")
    return figure


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Figure of what the planar model costs.")
    parser.add_argument("--out", type=Path, default=Path(Path(__file__).with_suffix(".png").name))
    given = parser.parse_args(arguments)
    print("| body | friction | z/R | refused in % | median in % | largest in % | out of the slice in L |")
    print("|---" * 7 + "|")
    for (name, friction), cost in COSTS.items():
        for k, height in enumerate(HEIGHTS):
            numbers = f"{100 * cost.refused[k]:.0f} | {100 * cost.median[k]:.1f} | {100 * cost.largest[k]:.1f}"
            print(f"| {name} | {friction:g} | {height:g} | {numbers} | {cost.out_of_plane[k]:.2f} |")
    draw().savefig(given.out, dpi=150)


if __name__ == "__main__":
    main()
