"""Charts by matplotlib alone, which need no renderer: the reactions of a recording, and the distances of a comparison."""

from __future__ import annotations

from typing import Any

import numpy as np

from scan3d.comparison import UNKNOWN_UNIT, Comparison
from scan3d.pictures.figures import FONT, REACTION_LABELS, SIX_REACTION_LABELS, blank_figure
from scan3d.pictures.parts import evenly_chosen
from scan3d.pictures.shading import INK, ROD, UNKNOWN
from scan3d.pictures.words import unit_symbol
from scan3d.recording import Recording
from scan3d.units import UNITS_M

# Sweeps drawn at most: more curves merge into a grey area.
_MOST_SWEEPS = 60
# A certified upper bound more than this many times the value is drawn: a line that ends within the bar's edge is not seen.
_VISIBLY_LARGER = 1.01
# Heights in inches: of three panels, and of six bars with their axis.
_PANELS_HEIGHT, _BARS_HEIGHT = 5.0, 3.2
# Length of the axis of distances over the longest bar: the numbers stand to the right of the bars.
_ROOM = 1.4


def reactions(recording: Recording) -> Any:
    """A figure of the support reactions over the clamp travel, with a curve for every sweep: three panels, or six."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator

    numbers = np.unique(recording.sweep)
    colors = ScalarMappable(Normalize(float(numbers[0]), float(max(numbers[-1], numbers[0] + 1))), "viridis")
    force, moment = recording.wrench() if recording.six_axis else (recording.force_N, recording.moment_Nm)
    values = np.column_stack([1e3 * force, 1e6 * moment])
    labels = SIX_REACTION_LABELS if recording.six_axis else REACTION_LABELS
    figure = blank_figure(_PANELS_HEIGHT)
    places = dict(left=0.13, right=0.80, top=0.96, bottom=0.12, hspace=0.18, wspace=0.55)
    columns = figure.subplots(3, len(labels) // 3, sharex=True, squeeze=False, gridspec_kw=places).T
    panels = columns.ravel()
    scale = 1 / UNITS_M[recording.unit]
    for number in numbers[evenly_chosen(len(numbers), _MOST_SWEEPS)]:
        rows = recording.sweep == number
        position = recording.position_m[rows]
        travel = scale * np.linalg.norm(position - position[0], axis=1)
        for axes, column in zip(panels, values[rows].T, strict=True):
            axes.plot(travel, column, color=colors.to_rgba(number), lw=0.8)
    for axes, label in zip(panels, labels, strict=True):
        axes.set_ylabel(label, fontsize=FONT - 1)
        axes.tick_params(labelsize=FONT - 2)
        axes.spines[["top", "right"]].set_visible(False)
        axes.margins(x=0.01)
    for column in columns:
        figure.align_ylabels(column)
        column[-1].set_xlabel(f"clamp travel in {unit_symbol(recording.unit)}", fontsize=FONT)
    if len(numbers) > 1:
        bar = figure.colorbar(colors, cax=figure.add_axes((0.842, 0.15, 0.025, 0.70)))
        bar.locator = MaxNLocator(6, integer=True)
        bar.ax.tick_params(labelsize=FONT - 1)
        bar.outline.set_linewidth(0.6)
        figure.text(0.985, 0.5, "number of the sweep", rotation="vertical", ha="right", va="center", fontsize=FONT)
    return figure


def distances(comparison: Comparison) -> Any:
    """A figure of the distances as bars, continued by lines to certified upper bounds where they are not exact."""
    bars = [
        ("Hausdorff", comparison.hausdorff, comparison.upper),
        ("surface to mesh", comparison.surface_to_mesh, comparison.surface_to_mesh_upper),
        ("mesh to surface", comparison.mesh_to_surface, comparison.mesh_to_surface_upper),
        ("95 %", comparison.p95, None),
        ("RMS", comparison.rms, None),
        ("mean", comparison.mean, None),
    ]
    figure = blank_figure(_BARS_HEIGHT)
    axes = figure.add_axes((0.23, 0.19, 0.73, 0.78))
    largest = max(max(value, upper or 0.0) for _, value, upper in bars)
    for k, (_, value, upper) in enumerate(bars):
        end = value
        axes.barh(-k, value, color=UNKNOWN if upper is None else ROD, height=0.62)
        if upper is not None and upper > _VISIBLY_LARGER * value:
            axes.plot([value, upper, upper], [-k, -k, -k], color=INK, lw=1.2, marker="|", ms=7)
            end = upper
        axes.annotate(
            f"{value:.3g} ({comparison.percent_of_diagonal(value)})", (end, -k), (6, 0), textcoords="offset points",
            va="center", fontsize=FONT - 2,
        )  # fmt: skip
    axes.set_xlim(0, _ROOM * largest or 1.0)
    axes.set_yticks([-k for k in range(len(bars))], [name for name, _, _ in bars], fontsize=FONT - 1)
    axes.tick_params(axis="y", length=0)
    axes.tick_params(axis="x", labelsize=FONT - 1)
    axes.ticklabel_format(axis="x", scilimits=(-3, 5), useMathText=True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel(f"distance in {UNKNOWN_UNIT} (of the mesh's diagonal)", fontsize=FONT - 1)
    return figure
