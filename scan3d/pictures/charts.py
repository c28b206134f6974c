"""Charts by matplotlib alone, which need no renderer: the reactions of a recording, and the distances of a comparison."""

from __future__ import annotations

from typing import Any

import numpy as np

from scan3d.comparison import UNKNOWN_UNIT, Comparison
from scan3d.pictures.figures import REACTION_LABELS, SIX_REACTION_LABELS, chart, ticks
from scan3d.pictures.parts import evenly_chosen
from scan3d.pictures.shading import INK, ROD, UNKNOWN
from scan3d.pictures.sheet import Sheet
from scan3d.pictures.words import unit_symbol
from scan3d.recording import Recording
from scan3d.units import UNITS_M

# Sweeps drawn at most: more curves merge into a grey area.
_MOST_SWEEPS = 60
# A certified upper bound more than this many times the value is drawn: a line that ends within the bar's edge is not seen.
_VISIBLY_LARGER = 1.01
# Width over height of three panels, and of six bars with their axis.
_PANELS, _BARS = 7 / 5, 7 / 3.2
# Share of the figure that panels have, and room of a tick's label along the two axes, in sizes of letters.
_PANEL, _LABEL_ROOM = 0.7, (4.0, 1.8)
# Width of a curve, and distance of a panel's title, over the size of letters.
_LINE, _TITLE_PAD = 0.8 / 12, 0.25
# Length of the axis of distances over the longest bar: the numbers stand to the right of the bars.
_ROOM = 1.4


def reactions(recording: Recording, sheet: Sheet | None = None) -> Any:
    """A figure of the support reactions over the clamp travel, with a curve for every sweep: three panels, or six."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator

    sheet = sheet or Sheet()
    numbers = np.unique(recording.sweep)
    colors = ScalarMappable(Normalize(float(numbers[0]), float(max(numbers[-1], numbers[0] + 1))), "viridis")
    force, moment = recording.wrench() if recording.six_axis else (recording.force_N, recording.moment_Nm)
    values = np.column_stack([1e3 * force, 1e6 * moment])
    labels = SIX_REACTION_LABELS if recording.six_axis else REACTION_LABELS
    figure = chart(_PANELS, sheet)
    columns = figure.subplots(3, len(labels) // 3, sharex=True, squeeze=False).T
    panels = columns.ravel()
    scale = 1 / UNITS_M[recording.unit]
    for number in numbers[evenly_chosen(len(numbers), _MOST_SWEEPS)]:
        rows = recording.sweep == number
        position = recording.position_m[rows]
        travel = scale * np.linalg.norm(position - position[0], axis=1)
        for axes, column in zip(panels, values[rows].T, strict=True):
            axes.plot(travel, column, color=colors.to_rgba(number), lw=_LINE * sheet.font)
    for axes, label in zip(panels, labels, strict=True):
        # above the panel, because panels may be lower than their label is long
        axes.set_title(label, fontsize=sheet.font - 1, loc="left", pad=_TITLE_PAD * sheet.font)
        axes.tick_params(labelsize=sheet.font - 2)
        axes.spines[["top", "right"]].set_visible(False)
        axes.margins(x=0.01)
        axes.yaxis.set_major_locator(ticks(_PANEL * figure.get_figheight() / 3, sheet, _LABEL_ROOM[1], 4))
        axes.xaxis.set_major_locator(ticks(_PANEL * sheet.width / len(columns), sheet, _LABEL_ROOM[0], 8))
    for column in columns:
        column[-1].set_xlabel(f"clamp travel in {unit_symbol(recording.unit)}", fontsize=sheet.font)
    if len(numbers) > 1:
        bar = figure.colorbar(colors, ax=panels, shrink=0.85, aspect=30, pad=0.02)
        bar.locator = MaxNLocator(6, integer=True)
        bar.ax.tick_params(labelsize=sheet.font - 1)
        bar.outline.set_linewidth(0.05 * sheet.font)
        bar.set_label("number of the sweep", fontsize=sheet.font)
    return figure


def distances(comparison: Comparison, sheet: Sheet | None = None) -> Any:
    """A figure of the distances as bars, continued by lines to certified upper bounds where they are not exact."""
    sheet = sheet or Sheet()
    bars = [
        ("Hausdorff", comparison.hausdorff, comparison.upper),
        ("surface to mesh", comparison.surface_to_mesh, comparison.surface_to_mesh_upper),
        ("mesh to surface", comparison.mesh_to_surface, comparison.mesh_to_surface_upper),
        ("95 %", comparison.p95, None),
        ("RMS", comparison.rms, None),
        ("mean", comparison.mean, None),
    ]
    figure = chart(_BARS, sheet)
    axes = figure.subplots()
    largest = max(max(value, upper or 0.0) for _, value, upper in bars)
    for k, (_, value, upper) in enumerate(bars):
        end = value
        axes.barh(-k, value, color=UNKNOWN if upper is None else ROD, height=0.62)
        if upper is not None and upper > _VISIBLY_LARGER * value:
            axes.plot(
                [value, upper, upper], [-k, -k, -k], color=INK, lw=0.1 * sheet.font, marker="|", ms=0.6 * sheet.font
            )
            end = upper
        axes.annotate(
            f"{value:.3g} ({comparison.percent_of_diagonal(value)})", (end, -k), (6, 0), textcoords="offset points",
            va="center", fontsize=sheet.font - 2,
        )  # fmt: skip
    axes.set_xlim(0, _ROOM * largest or 1.0)
    axes.set_yticks([-k for k in range(len(bars))], [name for name, _, _ in bars], fontsize=sheet.font - 1)
    axes.tick_params(axis="y", length=0)
    axes.tick_params(axis="x", labelsize=sheet.font - 1)
    axes.ticklabel_format(axis="x", scilimits=(-3, 5), useMathText=True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel(f"distance in {UNKNOWN_UNIT} (of the mesh's diagonal)", fontsize=sheet.font - 1)
    return figure
