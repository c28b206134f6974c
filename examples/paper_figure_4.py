"""Does friction spoil the contacts that are found from the reactions?

Figure 4 of the paper, from the reactions of Figure 3, by two methods.  Left: Scholz & Rahn's integration up to ``κ = 0``,
and the closed form, which gives the same result without integration.  Right: Will's equation (10).  Top to bottom: the place
of the contact along the rod, the contact points, and their distance to the contour.  Friction shifts the points along the
contour; only by Will's equation does it also move them off the contour.

    python examples/paper_figure_4.py [FILE]

Reference: L. Merker, J. Steigenberger, C. Behn, Friction Invariant Object Reconstruction Using a Vibrissa-inspired Tactile
Sensor Concept, Figure 4, Section III-B.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from paper_figure_3 import COLORS, CONTOUR, LABELS, STYLE, SWEEPS

import planar

# Step 2: from the reactions back to the contacts.
CONTACTS = {
    method: [planar.reconstruct(*swept.reactions, method) for swept in SWEEPS]
    for method in ("scholz-rahn", "will", "closed-form")
}
# The smallest distance of every contact to the original contour.
ERRORS = {method: [CONTOUR.distance(contacts.point) for contacts in sweeps] for method, sweeps in CONTACTS.items()}
# Errors of exactly zero are drawn here, below the last digit of a point's coordinates.
SMALLEST_ERROR = 5e-17


def draw() -> Figure:
    """The figure, two columns of a page wide."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 8.0), layout="constrained")
        panels = figure.subplots(3, 2, sharey="row")
        for column, method in enumerate(("scholz-rahn", "will")):
            place, points, errors = panels[:, column]
            draw_places(place, method)
            draw_points(points, method)
            draw_errors(errors, method, ".")
            place.set_ylim(0.0, 1.05)
            errors.set(xlabel="$x_0\\;/\\;L$", ylabel="error$\\;/\\;L$", ylim=(2e-17, 5.0))
        draw_errors(panels[2, 0], "closed-form", "x")
        dot, cross = (panels[2, 0].plot([], [], mark, color="black", markersize=3)[0] for mark in ".x")
        panels[2, 0].legend([dot, cross], ["Scholz & Rahn [15]", "closed form"], loc="upper right")

        place = enlarge(panels[0, 0], (0.33, 0.08, 0.4, 0.45), (-0.5, -0.36), (0.74, 0.79))
        draw_places(place, "scholz-rahn")
        points = enlarge(panels[1, 0], (0.3, 0.48, 0.4, 0.45), (-0.3, -0.2), (0.415, 0.46))
        draw_points(points, "scholz-rahn")
        for inset in (place, points):
            inset.set(xlabel="", ylabel="")

        for axes, panel in zip(panels.flat, "abcdef", strict=True):
            axes.set_title(f"({panel})", loc="left")
            axes.tick_params(labelleft=True)
        panels[0, 0].set_title("Scholz & Rahn [15]")
        panels[0, 1].set_title("Will [16], equation (10)")
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=len(LABELS))
    return figure


def draw_places(axes: Axes, method: str) -> None:
    """Where along the rod the contacts are, the random sweep behind the others."""
    for swept, contacts, color, label in zip(SWEEPS, CONTACTS[method], COLORS, LABELS, strict=True):
        zorder = 1.9 if swept is SWEEPS[-1] else 2
        contacts.plot("s1", over=swept.x0, axes=axes, color=color, label=label, zorder=zorder)


def draw_points(axes: Axes, method: str) -> None:
    """The contact points over the contour."""
    axes.plot(*CONTOUR.points(np.linspace(-np.pi / 2, np.pi / 2, 1000)).T, color="0.8", linewidth=3)
    for contacts, color in zip(CONTACTS[method][::-1], COLORS[::-1], strict=True):
        contacts.plot(axes=axes, color=color, markersize=1.5)
    axes.set_aspect("auto")


def draw_errors(axes: Axes, method: str, marker: str) -> None:
    """The distances of the points to the contour over the base position."""
    for swept, errors, color in zip(SWEEPS[::-1], ERRORS[method][::-1], COLORS[::-1], strict=True):
        axes.semilogy(swept.x0, np.maximum(errors, SMALLEST_ERROR), marker, color=color, markersize=3)


def enlarge(
    axes: Axes, place: tuple[float, float, float, float], x: tuple[float, float], y: tuple[float, float]
) -> Axes:
    """An inset at `place` for a section of the panel."""
    inset = axes.inset_axes(place, xlim=x, ylim=y, xticks=[], yticks=[])
    axes.indicate_inset_zoom(inset, edgecolor="black")
    return inset


if __name__ == "__main__":
    draw().savefig(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).with_suffix(".png").name, dpi=150)
