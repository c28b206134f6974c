"""Charts by matplotlib alone, which need no renderer: one sweep, reactions, distances of a comparison, histograms."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import planar
from scan3d.arrays import Array, Mask
from scan3d.comparison import UNKNOWN_UNIT, Comparison
from scan3d.errors import InputError
from scan3d.numbers import number, share
from scan3d.pictures.figures import (
    REACTION_LABELS,
    SIX_REACTION_LABELS,
    blank_figure,
    chart,
    open_axes,
    own_style,
    save,
    ticks,
    wrapped,
)
from scan3d.pictures.parts import (
    BOUND,
    INK,
    ROD,
    TANGENTIAL,
    TIP,
    UNKNOWN,
    area_of_vertices,
    evenly_chosen,
    shown_lengths,
    shown_surface,
    weighted_quantiles,
)
from scan3d.pictures.scene import Scene
from scan3d.pictures.sheet import FONT, WIDTH, Sheet
from scan3d.recording import Recording
from scan3d.units import UNITS_M, unit_symbol

if TYPE_CHECKING:
    from scan3d.laboratory.one_sweep import SweepContacts


# Share of a histogram's height that its axes have.
_HISTOGRAM_HEIGHT = 0.6


def reactions(recording: Recording, sheet: Sheet | None = None) -> Any:
    """A figure of the support reactions over the clamp travel, with a curve for every sweep: three panels, or six.

    Of more than 60 sweeps, which merge into a grey area, as many are drawn.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator

    sheet = sheet or Sheet()
    numbers = np.unique(recording.sweep)
    colors = ScalarMappable(Normalize(float(numbers[0]), float(max(numbers[-1], numbers[0] + 1))), "viridis")
    force, moment = recording.wrench() if recording.six_axis else (recording.force_N, recording.moment_Nm)
    values = np.column_stack([1e3 * force, 1e6 * moment])
    labels = SIX_REACTION_LABELS if recording.six_axis else REACTION_LABELS
    figure = chart(7 / 5, sheet)
    columns = figure.subplots(3, len(labels) // 3, sharex=True, squeeze=False).T
    panels = columns.ravel()
    scale = 1 / UNITS_M[recording.unit]
    for sweep in numbers[evenly_chosen(len(numbers), 60)]:
        rows = recording.sweep == sweep
        position = recording.position_m[rows]
        travel = scale * np.linalg.norm(position - position[0], axis=1)
        for axes, column in zip(panels, values[rows].T, strict=True):
            axes.plot(travel, column, color=colors.to_rgba(sweep), lw=0.8 / 12 * sheet.font)
    for axes, label in zip(panels, labels, strict=True):
        # above the panel, because panels may be lower than their label is long
        axes.set_title(label, fontsize=sheet.font - 1, loc="left", pad=0.25 * sheet.font)
        open_axes(axes, sheet.font - 2)
        axes.margins(x=0.01)
        axes.yaxis.set_major_locator(ticks(0.7 * figure.get_figheight() / 3, sheet, 1.8, 4))
        axes.xaxis.set_major_locator(ticks(0.7 * sheet.width / len(columns), sheet, 4.0, 8))
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
    figure = chart(7 / 3.2, sheet)
    axes = figure.subplots()
    largest = max(max(value, upper or 0.0) for _, value, upper in bars)
    for k, (_, value, upper) in enumerate(bars):
        end = value
        axes.barh(-k, value, color=UNKNOWN if upper is None else ROD, height=0.62)
        if upper is not None and upper > 1.01 * value:  # else the line is not seen
            axes.plot(
                [value, upper, upper], [-k, -k, -k], color=INK, lw=0.1 * sheet.font, marker="|", ms=0.6 * sheet.font
            )
            end = upper
        axes.annotate(
            f"{number(value)} ({comparison.part_of_diagonal(value)})", (end, -k), (6, 0), textcoords="offset points",
            va="center", fontsize=sheet.font - 2,
        )  # fmt: skip
    axes.set_xlim(0, 1.4 * largest or 1.0)  # with room for the numbers
    axes.set_yticks([-k for k in range(len(bars))], [name for name, _, _ in bars], fontsize=sheet.font - 1)
    open_axes(axes, sheet.font - 1)
    axes.tick_params(axis="y", length=0)
    axes.ticklabel_format(axis="x", scilimits=(-3, 5), useMathText=True)
    axes.set_xlabel(f"distance in {UNKNOWN_UNIT} (of the mesh's diagonal)", fontsize=sheet.font - 1)
    return figure


def histograms(scene: Scene, sheet: Sheet) -> Any:
    """A figure with the histograms of the deviation and of the bound, of those that are known.

    Values at the vertices count by the area around them, and vertices without a finite bound are left out, with their share of
    the area stated.  Raises InputError without a surface, and without either of the two.
    """
    if scene.surface is None:
        raise InputError(
            f"{scene.name} has no surface, whose deviation and bound the view histogram shows: give a scan's folder"
        )
    mesh, deviation, bound, _ = shown_surface(scene)
    shown: list[tuple[str, Array, str]] = []
    if deviation is not None:
        shown.append((scene.deviation_title, deviation, ROD))
    if bound is not None and np.isfinite(bound).any():
        shown.append((scene.bound_title, bound, BOUND))
    if not shown:
        raise InputError(
            f"neither the deviation nor the bound of {scene.name} is known, which the view histogram shows: give --truth MESH "
            "(in Python truth=), or show a scan's folder"
        )
    area = area_of_vertices(mesh)
    figure = chart((1.8, 2.3)[len(shown) - 1], sheet)
    panels = figure.subplots(1, len(shown), squeeze=False)[0]
    for axes, (title, lengths, color) in zip(panels, shown, strict=True):
        values, unit = shown_lengths(lengths, scene.unit)
        _histogram(axes, values, area, sheet, 0.8 * sheet.width / len(shown), f"{title} in {unit}", color)
    height = _HISTOGRAM_HEIGHT * figure.get_figheight()
    panels[0].set_ylabel(wrapped("share of the surface in %", height, sheet), fontsize=sheet.font)
    return figure


def _histogram(axes: Any, values: Array, area: Array, sheet: Sheet, width: float, title: str, color: str) -> None:
    """A histogram of values (v,), by area (v,), with its quantiles, about so many inches wide."""
    known = np.isfinite(values)
    low, high = min(float(values[known].min()), 0.0), max(float(values[known].max()), 0.0)
    if low == high:
        high = 1.0
    shares, edges = np.histogram(values[known], 40, (low, high), weights=100 * area[known] / area.sum())
    axes.stairs(shares, edges, fill=True, color=color)
    if low < 0 < high:
        axes.axvline(0.0, color=INK, lw=0.06 * sheet.font)
    axes.set_xlim(low, high)
    axes.set_ylim(0.0)
    open_axes(axes, sheet.font - 1)
    axes.xaxis.set_major_locator(ticks(width, sheet, 3.3, 5))
    axes.yaxis.set_major_locator(ticks(_HISTOGRAM_HEIGHT * axes.figure.get_figheight(), sheet, 2.0, 5))
    axes.ticklabel_format(axis="x", useOffset=False, style="plain")
    axes.set_xlabel(wrapped(title, width, sheet), fontsize=sheet.font)
    quantiles = weighted_quantiles(values[known], area[known], (0.05, 0.5, 0.95))
    digits = 2 - int(np.floor(np.log10(high - low)))
    lower, median, upper = (number(round(value, digits)) for value in quantiles)
    text = f"median {median}, 90 % from {lower} to {upper}".replace("-", "−")
    if not known.all():
        text += f", unknown on {share(area[~known].sum() / area.sum())}"
    axes.set_title(wrapped(text, width, sheet), fontsize=sheet.font - 1)


# Standard deviations of an error bar to each side: an expanded uncertainty with the coverage factor 2, about 95 %.
_COVERAGE = 2.0
# Height of the friction with its labels, in inches.
_FRICTION_HEIGHT = 2.4
# Room around the contacts, as a fraction of their extent.
_ROOM = 0.06


def sweep_picture(found: SweepContacts, path: str | Path) -> None:
    """Draw contour and friction of a sweep into a .png or a .pdf."""
    with own_style():
        save(sweep_figure(found), Path(path))


def sweep_figure(found: SweepContacts) -> Any:
    """The matplotlib figure that `sweep_picture` writes: the contour to scale, and below it the friction over the same x."""
    rod = found.sweep.rod
    scale, unit = (1e3 * rod.length_m, "mm") if rod else (1.0, "rod lengths")
    points, sd = scale * found.contacts.point, scale * found.point_sd
    # contacts at which the rod touched lightly do not determine the limits
    certain = found.touching & ~(found.errors.largest > 4 * np.median(found.errors.largest[found.touching]))
    low, high = points[certain].min(axis=0), points[certain].max(axis=0)
    room = _ROOM * (float((high - low).max()) or 1.0)
    height = float(np.clip(WIDTH * (high[1] - low[1] + 2 * room) / (high[0] - low[0] + 2 * room), 1.4, 6.0))
    figure = blank_figure(height + _FRICTION_HEIGHT)
    figure.set_layout_engine("constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(height, _FRICTION_HEIGHT))
    chosen = np.flatnonzero(found.touching)
    bars = np.zeros(len(found.sweep), dtype=bool)
    bars[chosen[evenly_chosen(len(chosen), 60)]] = found.noisy  # more would merge into an area
    for text, phase, color, mark in (
        ("tip contact", planar.Phase.TIP, TIP, "o"),
        ("tangential contact", planar.Phase.TANGENTIAL, TANGENTIAL, "s"),
    ):
        rows = found.contacts.phase == phase
        if rows.any():
            _draw(above, points[:, 0], points[:, 1], sd, rows, bars, color, mark, text)
    friction = found.contacts.friction
    spread = np.column_stack([np.full(len(friction), np.nan), found.friction_sd])
    _draw(below, points[:, 0], friction, spread, found.tangential, bars, TANGENTIAL, "s")
    above.set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))
    _friction_axis(below, friction[certain & found.tangential])
    above.set_ylabel(f"y in {unit}", fontsize=FONT - 1)
    below.set_xlabel(f"x in {unit}", fontsize=FONT - 1)
    for axes in (above, below):
        axes.tick_params(labelsize=FONT - 2)
        axes.spines[["top", "right"]].set_visible(False)
    if found.noisy:
        above.plot([], [], color=UNKNOWN, label=f"± {_COVERAGE:g} standard deviations")
    above.legend(fontsize=FONT - 2, frameon=False)
    # where the places of the axes are final, one scale along both: the axis with room to spare shows more
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    size = above.get_position().size * figure.get_size_inches()
    half = size / 2 * float(((high - low + 2 * room) / size).max())
    middle = (low + high) / 2
    above.set(xlim=middle[0] + half[0] * np.array([-1, 1]), ylim=middle[1] + half[1] * np.array([-1, 1]))
    return figure


def _draw(
    axes: Any, x: Array, y: Array, sd: Array, rows: Mask, bars: Mask, color: str, mark: str, label: str | None = None
) -> None:
    """Points (n,) of some rows, with bars of `_COVERAGE` standard deviations (n, 2) at some of them."""
    axes.plot(x[rows], y[rows], mark, color=color, ms=2.5, mew=0, label=label)
    some = rows & bars
    if some.any():
        x_bar, y_bar = (None if np.isnan(column[some]).all() else _COVERAGE * column[some] for column in sd.T)
        axes.errorbar(x[some], y[some], y_bar, x_bar, fmt="none", ecolor=color, elinewidth=0.8, capsize=1.5, alpha=0.7)


def _friction_axis(axes: Any, friction: Array) -> None:
    """Limits of the friction, of at least a certain range, and a line at its median."""
    axes.set_ylabel("friction $\\mu$", fontsize=FONT - 1)
    if not len(friction):
        axes.set_yticks([])
        axes.text(0.5, 0.5, "no tangential contact", ha="center", transform=axes.transAxes, fontsize=FONT - 1)
        return
    median = float(np.median(friction))
    half = max(float(np.abs(friction - median).max()) * (1 + 2 * _ROOM), 0.05)
    axes.axhline(median, color=INK, lw=0.8, ls="--", zorder=0)
    axes.set_ylim(median - half, median + half)
