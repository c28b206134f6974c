"""Charts by matplotlib alone, which need no renderer: one sweep, reactions, imports, histograms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scan3d.arrays import Array, evenly, weighted_quantiles
from scan3d.errors import InputError
from scan3d.numbers import FORCES, MOMENTS, number, reaction_unit, share
from scan3d.pictures import figures, parts
from scan3d.pictures.scene import Scene
from scan3d.pictures.sheet import FONT, Sheet
from scan3d.units import UNITS_M, unit_symbol

if TYPE_CHECKING:
    from scan3d.laboratory.importing import Imported
    from scan3d.laboratory.one_sweep import SweepContacts


# Share of a histogram's height that its axes have.
_HISTOGRAM_HEIGHT = 0.6


def reactions(scene: Scene, sheet: Sheet) -> Any:
    """A figure of the support reactions over the clamp travel, with a curve for every sweep: three panels, or six.

    Of more than 60 sweeps, which merge into a grey area, as many are drawn.  Raises InputError without a recording.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator

    if (recording := scene.recording) is None:
        raise InputError(
            f"{scene.name} has no recording, whose reactions the view forces shows: show a scan's folder, or a recording"
        )
    numbers = np.unique(recording.sweep)
    colors = ScalarMappable(Normalize(float(numbers[0]), float(max(numbers[-1], numbers[0] + 1))), "viridis")
    force, moment = recording.wrench() if recording.six_axis else (recording.force_N, recording.moment_Nm)
    wrench = np.column_stack([force, moment])
    names, units, sizes = _reactions(wrench)
    values = wrench / sizes
    figure = figures.chart(7 / 5, sheet)
    columns = figure.subplots(3, len(names) // 3, sharex=True, squeeze=False).T
    panels = columns.ravel()
    scale = 1 / UNITS_M[recording.unit]
    for sweep in evenly(numbers, 60):
        rows = recording.sweep == sweep
        position = recording.position_m[rows]
        travel = scale * np.linalg.norm(position - position[0], axis=1)
        for axes, column in zip(panels, values[rows].T, strict=True):
            axes.plot(travel, column, color=colors.to_rgba(sweep), lw=0.8 / 12 * sheet.font)
    for axes, name, unit in zip(panels, names, units, strict=True):
        # above the panel, because panels may be lower than their label is long
        axes.set_title(f"{name} in {unit}", fontsize=sheet.font - 1, loc="left", pad=0.25 * sheet.font)
        figures.open_axes(axes, sheet.font - 2)
        axes.margins(x=0.01)
        axes.yaxis.set_major_locator(figures.ticks(0.7 * figure.get_figheight() / 3, sheet, 1.8, 4))
        axes.xaxis.set_major_locator(figures.ticks(0.7 * sheet.width / len(columns), sheet, 4.0, 8))
    for column in columns:
        column[-1].set_xlabel(f"clamp travel in {unit_symbol(recording.unit)}", fontsize=sheet.font)
    if len(numbers) > 1:
        bar = figure.colorbar(colors, ax=panels, shrink=0.85, aspect=30, pad=0.02)
        bar.locator = MaxNLocator(6, integer=True)
        bar.ax.tick_params(labelsize=sheet.font - 1)
        bar.outline.set_linewidth(0.05 * sheet.font)
        bar.set_label("number of the sweep", fontsize=sheet.font)
    return figure


def _reactions(wrench: Array) -> tuple[list[str], list[str], Array]:
    """Names of support reactions (n, 6) in space or (n, 3) in a plane, the units of their size, and these in SI units (c,)."""
    names = [f"${quantity}_{{0{axis}}}$" for quantity in "fm" for axis in "xyz"]
    names = names if wrench.shape[1] == 6 else [names[0], names[1], names[5]]
    shown = {}
    for kind, units in (("f", FORCES), ("m", MOMENTS)):
        columns = wrench[:, [kind in name for name in names]]
        shown[kind] = reaction_unit(float(np.nanmax(np.abs(columns), initial=0.0)), units)
    return names, [shown[name[1]][0] for name in names], np.array([float(shown[name[1]][1]) for name in names])


def histograms(scene: Scene, sheet: Sheet) -> Any:
    """A figure with the histograms of the deviation and of the bound, of those that are known.

    Values at the vertices count by the area around them, and vertices without a finite bound are left out, with their share of
    the area stated.  Raises InputError without a surface, and without either of the two.
    """
    if scene.surface is None:
        raise InputError(
            f"{scene.name} has no surface, whose deviation and bound the view histogram shows: give a scan's folder"
        )
    mesh, deviation, bound, _ = parts.shown_surface(scene)
    shown: list[tuple[str, Array, str]] = []
    if deviation is not None:
        shown.append((scene.deviation_title, deviation, parts.ROD))
    if bound is not None and np.isfinite(bound).any():
        shown.append((scene.bound_title, bound, parts.BOUND))
    if not shown:
        raise InputError(
            f"neither the deviation nor the bound of {scene.name} is known, which the view histogram shows: give --truth MESH "
            "(in Python truth=), or show a scan's folder"
        )
    area = parts.area_of_vertices(mesh)
    figure = figures.chart((1.8, 2.3)[len(shown) - 1], sheet)
    panels = figure.subplots(1, len(shown), squeeze=False)[0]
    for axes, (title, lengths, color) in zip(panels, shown, strict=True):
        values, unit = parts.shown_lengths(lengths, scene.unit)
        _histogram(axes, values, area, sheet, 0.8 * sheet.width / len(shown), f"{title} in {unit}", color)
    height = _HISTOGRAM_HEIGHT * figure.get_figheight()
    panels[0].set_ylabel(figures.wrapped("share of the surface in %", height, sheet), fontsize=sheet.font)
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
        axes.axvline(0.0, color=parts.INK, lw=0.06 * sheet.font)
    axes.set_xlim(low, high)
    axes.set_ylim(0.0)
    figures.open_axes(axes, sheet.font - 1)
    axes.xaxis.set_major_locator(figures.ticks(width, sheet, 3.3, 5))
    axes.yaxis.set_major_locator(figures.ticks(_HISTOGRAM_HEIGHT * axes.figure.get_figheight(), sheet, 2.0, 5))
    axes.ticklabel_format(axis="x", useOffset=False, style="plain")
    axes.set_xlabel(figures.wrapped(title, width, sheet), fontsize=sheet.font)
    quantiles = weighted_quantiles(values[known], area[known], (0.05, 0.5, 0.95))
    digits = 2 - int(np.floor(np.log10(high - low)))
    lower, median, upper = (number(round(value, digits)) for value in quantiles)
    text = f"median {median}, 90 % from {lower} to {upper}".replace("-", "−")
    if not known.all():
        text += f", unknown on {share(area[~known].sum() / area.sum())}"
    axes.set_title(figures.wrapped(text, width, sheet), fontsize=sheet.font - 1)


def draw(figure: Callable[[Any], Any], found: SweepContacts | Imported, path: str | Path) -> None:
    """Draw the `sweep_figure` of a sweep, or the `import_figure` of a table, into a file."""
    with figures.own_style():
        figures.save(figure(found), Path(path))


def sweep_figure(found: SweepContacts) -> Any:
    """A matplotlib figure of a sweep: the contour to scale, and below it the friction over x.

    Where errors are known, some contacts have bars of two standard deviations.
    """
    scale, unit = (1e3 * found.sweep.rod.length_m, "mm") if found.sweep.rod else (1.0, "rod lengths")
    points, friction, tangential = scale * found.contacts.point, found.contacts.friction, found.tangential
    figure = figures.blank_figure(6.0)
    figure.set_layout_engine("constrained")
    above, below = figure.subplots(2, 1, height_ratios=(3, 2))
    replace(found.contacts, point=points).plot(axes=above)
    below.plot(points[tangential, 0], friction[tangential], "o", color=parts.TANGENTIAL, markersize=3.5)
    # contacts at which the rod touched lightly do not determine the limits
    certain = found.touching & ~(found.errors.largest > 4 * np.median(found.errors.largest[found.touching]))
    low, high = points[certain].min(axis=0), points[certain].max(axis=0)
    room = 0.06 * (float((high - low).max()) or 1.0)
    above.set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room), ylabel=f"y in {unit}")
    below.set(xlim=above.get_xlim(), xlabel=f"x in {unit}", ylabel="friction $\\mu$")
    above.set_xlabel("")
    if (certain & tangential).any():
        median = float(np.median(friction[certain & tangential]))
        half = max(1.1 * float(np.abs(friction[certain & tangential] - median).max()), 0.05)
        below.set_ylim(median - half, median + half)
    if found.noisy:
        chosen = np.flatnonzero(found.touching)
        some = evenly(chosen, 60)  # more would merge into an area
        # an expanded uncertainty, about 95 %
        sd, x = 2 * scale * found.point_sd[some], points[some, 0]
        bars: dict[str, Any] = {"fmt": "none", "ecolor": parts.UNKNOWN, "elinewidth": 0.8, "zorder": 0}
        above.errorbar(x, points[some, 1], sd[:, 1], sd[:, 0], **bars)
        below.errorbar(x, friction[some], 2 * found.friction_sd[some], **bars)
    return figure


def import_figure(imported: Imported) -> Any:
    """A matplotlib figure of what became of a laboratory's table.

    Left what the sensor showed, with its stretches in the air and its zero; right the support reactions in the clamp's frame,
    with the sweeps.
    """
    clock = imported.clock - imported.clock[0]
    figure = figures.chart(2.0, Sheet(width=10.0))
    panels = figure.subplots(2, 2, sharex=True)
    sweeps = [imported.sweep >= 0, imported.sweep % 2 == 1]  # neighbours in two shades
    sides = (
        ("the sensor; blue: in the air, dashed: zero", imported.log.wrench, imported.zero, [imported.air], parts.ROD),
        ("at the clamp; grey: sweeps", imported.wrench, None, sweeps, parts.UNKNOWN),
    )
    for side, (title, wrench, zero, marked, shade) in enumerate(sides):
        names, units, sizes = _reactions(wrench)
        for part, axes in enumerate(panels[:, side]):
            across = axes.get_xaxis_transform()
            for rows in marked:
                axes.fill_between(clock, 0, 1, where=rows, color=shade, alpha=0.25, lw=0, transform=across)
            for column, color in zip(range(3 * part, 3 * part + 3), parts.REACTION_COLORS, strict=True):
                axes.plot(clock, wrench[:, column] / sizes[column], color=color, lw=0.8, label=names[column])
                if zero is not None and len(zero) == len(clock):
                    axes.plot(clock, zero[:, column] / sizes[column], color=parts.INK, lw=0.9, ls="--")
            axes.set_ylabel(f"{('force', 'moment')[part]} in {units[3 * part]}", fontsize=FONT - 2)
            figures.open_axes(axes, FONT - 3)
            axes.legend(fontsize=FONT - 3, frameon=False, ncols=3)
        panels[0, side].set_title(title, loc="left", fontsize=FONT - 1)
        panels[1, side].set_xlabel("row" if imported.log.time_s is None else "time in s", fontsize=FONT - 2)
    return figure
