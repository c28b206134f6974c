"""The picture of one sweep in one plane: its contacts and the friction at them, with error bars, by matplotlib alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import planar
from scan3d.arrays import Array, Mask
from scan3d.one_sweep import SweepContacts
from scan3d.pictures.figures import blank_figure, legend, quiet, save
from scan3d.pictures.parts import evenly_chosen
from scan3d.pictures.shading import INK, TANGENTIAL, TIP, UNKNOWN
from scan3d.pictures.sheet import FONT, WIDTH

# Error bars drawn at most: more merge into an area.
_MOST_BARS = 60
# Standard deviations of an error bar to each side: an expanded uncertainty with the coverage factor 2, about 95 %.
_COVERAGE = 2.0
# Contacts whose place is less certain than this many times the median do not determine the limits of the picture.  Larger,
# a rod that touches lightly makes the contour small; smaller, more of its error bars are cut off.
_LIGHT = 4.0
# Inches: margins to the left and right, below and above, between the panels and for the legend; height of the friction; the
# lowest and highest contour.
_LEFT, _RIGHT, _BELOW, _ABOVE, _BETWEEN = 0.95, 0.2, 0.95, 0.15, 0.2
_FRICTION_HEIGHT, _LOWEST, _HIGHEST = 1.6, 1.4, 6.0
# Room around the contacts, as a fraction of their extent, and the smallest range of the friction shown.
_ROOM, _SMALLEST_FRICTION = 0.06, 0.1
# Colours and marks of the kinds of contact.
_KINDS = (
    ("tip contact", planar.Phase.TIP, TIP, "o"),
    ("tangential contact", planar.Phase.TANGENTIAL, TANGENTIAL, "s"),
)


def sweep_picture(found: SweepContacts, path: str | Path) -> None:
    """Draw contour and friction of a sweep into a .png or a .pdf."""
    with quiet():
        save(sweep_figure(found), Path(path))


def sweep_figure(found: SweepContacts) -> Any:
    """The matplotlib figure that `sweep_picture` writes: the contour to scale, and below it the friction over the same x."""
    rod = found.sweep.rod
    scale, unit = (1e3 * rod.length_m, "mm") if rod else (1.0, "rod lengths")
    points, sd = scale * found.contacts.point, scale * found.point_sd
    low, high = _limits(points[_certain(found)])
    width = WIDTH - _LEFT - _RIGHT
    height = width * (high[1] - low[1]) / (high[0] - low[0])
    if not _LOWEST <= height <= _HIGHEST:  # keep both axes to one scale by showing more of the other one
        clipped = float(np.clip(height, _LOWEST, _HIGHEST))
        axis = 1 if height < clipped else 0
        extent = (high[1 - axis] - low[1 - axis]) * (clipped / width if axis else width / clipped)
        middle = (low[axis] + high[axis]) / 2
        low[axis], high[axis] = middle - extent / 2, middle + extent / 2
        height = clipped
    total = _BELOW + _FRICTION_HEIGHT + _BETWEEN + height + _ABOVE
    figure = blank_figure(total)
    left, wide = _LEFT / WIDTH, width / WIDTH
    below = figure.add_axes((left, _BELOW / total, wide, _FRICTION_HEIGHT / total))
    above = figure.add_axes((left, 1 - (_ABOVE + height) / total, wide, height / total), sharex=below)
    bars = _bars(found)
    for _, phase, color, mark in _KINDS:
        rows = found.contacts.phase == phase
        _draw(above, points[:, 0], points[:, 1], sd, rows, bars, color, mark)
    friction = found.contacts.friction
    spread = np.column_stack([np.full(len(friction), np.nan), found.friction_sd])
    _draw(below, points[:, 0], friction, spread, found.tangential, bars, TANGENTIAL, "s")
    above.set_xlim(low[0], high[0])
    above.set_ylim(low[1], high[1])
    _friction_axis(below, friction[_certain(found) & found.tangential])
    above.set_ylabel(f"y in {unit}", fontsize=FONT - 1)
    below.set_xlabel(f"x in {unit}", fontsize=FONT - 1)
    for axes in (above, below):
        axes.tick_params(labelsize=FONT - 2, labelbottom=axes is below)
        axes.spines[["top", "right"]].set_visible(False)
    figure.align_ylabels([above, below])
    entries = [(text, color, mark) for text, phase, color, mark in _KINDS if (found.contacts.phase == phase).any()]
    if found.noisy:
        entries.append((f"± {_COVERAGE:g} standard deviations", UNKNOWN, "-"))
    legend(figure, entries, len(entries) + 1)
    return figure


def _certain(found: SweepContacts) -> Mask:
    """(n,) the contacts that determine the limits of the picture."""
    sd = found.place_sd
    return np.asarray(found.touching & ~(sd > _LIGHT * np.median(sd[found.touching])))


def _limits(points: Array) -> tuple[Array, Array]:
    """Lower left and upper right corner of what is shown of points (n, 2)."""
    low, high = points.min(axis=0), points.max(axis=0)
    room = _ROOM * (float((high - low).max()) or 1.0)
    return low - room, high + room


def _bars(found: SweepContacts) -> Mask:
    """(n,) the contacts with error bars, evenly chosen; none for exact data."""
    chosen = np.zeros(len(found.sweep), dtype=bool)
    rows = np.flatnonzero(found.touching)
    chosen[rows[evenly_chosen(len(rows), _MOST_BARS)]] = found.noisy
    return chosen


def _draw(axes: Any, x: Array, y: Array, sd: Array, rows: Mask, bars: Mask, color: str, mark: str) -> None:
    """Points (n,) of some rows, with bars of `_COVERAGE` standard deviations (n, 2) at some of them."""
    axes.plot(x[rows], y[rows], mark, color=color, ms=2.5, mew=0)
    some = rows & bars
    if some.any():
        x_bar, y_bar = (None if np.isnan(column[some]).all() else _COVERAGE * column[some] for column in sd.T)
        axes.errorbar(x[some], y[some], y_bar, x_bar, fmt="none", ecolor=color, elinewidth=0.8, capsize=1.5, alpha=0.7)


def _friction_axis(axes: Any, friction: Array) -> None:
    """Limits of the friction, of at least a certain range, and a line at its median."""
    axes.set_ylabel("friction $\\mu$", fontsize=FONT - 1)
    if not len(friction):
        axes.set_yticks([])
        axes.text(
            0.5, 0.5, "no tangential contact", ha="center", va="center", transform=axes.transAxes, fontsize=FONT - 1
        )
        return
    median = float(np.median(friction))
    half = max(float(np.abs(friction - median).max()) * (1 + 2 * _ROOM), _SMALLEST_FRICTION / 2)
    axes.axhline(median, color=INK, lw=0.8, ls="--", zorder=0)
    axes.set_ylim(median - half, median + half)
