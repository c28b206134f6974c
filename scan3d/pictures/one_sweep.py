"""The picture of one sweep in one plane: its contacts and the friction at them, with error bars, by matplotlib alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import planar
from scan3d.arrays import Array, Mask
from scan3d.pictures.figures import blank_figure, own_style, save
from scan3d.pictures.parts import evenly_chosen
from scan3d.pictures.shading import INK, TANGENTIAL, TIP, UNKNOWN
from scan3d.pictures.sheet import FONT, WIDTH

if TYPE_CHECKING:
    from scan3d.laboratory.one_sweep import SweepContacts

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
