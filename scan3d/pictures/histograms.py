"""Histograms of a surface's deviation and of its certified bound, by area."""

from __future__ import annotations

from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.pictures.figures import chart, ticks, wrapped
from scan3d.pictures.parts import shown_surface
from scan3d.pictures.scene import Scene
from scan3d.pictures.shading import INK, ROD
from scan3d.pictures.sheet import Sheet

# Bins over the range of the values: fewer hide how the values are distributed, more show the triangles.
_BINS = 40
# Quantiles that are named above a histogram, in %, from the lowest to the highest.
_QUANTILES = (5, 50, 95)
# Width over height of the figure, with one histogram and with two.
_PROPORTIONS = (1.8, 2.3)
# Powers of ten of values that are written without a power.
_PLAIN = (-3, 4)
# Share of a panel's width, and of the figure's height, that the axes have.
_PANEL, _PANEL_HEIGHT = 0.8, 0.6
# Room of a tick's label along the two axes, in sizes of letters.
_ROOM = (3.3, 2.0)
# Colours of deviation and bound, which differ in lightness as well.
_COLORS = {"deviation": ROD, "bound": "#3f9e8f"}


def histograms(scene: Scene, sheet: Sheet) -> Any:
    """A figure with the histograms of the deviation and of the bound, of those that are known.

    Values at the vertices count by the area around them, and vertices without a finite bound are left out, with their share of
    the area stated.  Raises InputError without a surface, and without either of the two.
    """
    if scene.surface is None:
        raise InputError(
            f"{scene.name} has no surface, whose deviation and bound the view histogram shows: give a scan's folder"
        )
    mesh, deviation, bound = shown_surface(scene)
    if bound is not None and not np.isfinite(bound).any():
        bound = None
    if deviation is None and bound is None:
        raise InputError(
            f"neither the deviation nor the bound of {scene.name} is known, which the view histogram shows: give --truth MESH "
            "(in Python truth=), or show a scan's folder"
        )
    area = _areas(mesh)
    shown: list[tuple[str, str, Array]] = []
    if deviation is not None:
        shown.append((scene.deviation_title, "deviation", deviation))
    if bound is not None:
        shown.append((f"certified bound in {scene.unit}", "bound", bound))
    figure = chart(_PROPORTIONS[len(shown) - 1], sheet)
    panels = figure.subplots(1, len(shown), squeeze=False)[0]
    for axes, (title, kind, values) in zip(panels, shown, strict=True):
        _draw(axes, values, area, sheet, _PANEL * sheet.width / len(shown), title, scene.unit, _COLORS[kind])
    panels[0].set_ylabel(
        wrapped("share of the surface in %", _PANEL_HEIGHT * figure.get_figheight(), sheet), fontsize=sheet.font
    )
    return figure


def _areas(mesh: Any) -> Array:
    """(v,) the area around each vertex: a third of its facets."""
    faces = np.asarray(mesh.faces)
    return np.bincount(faces.ravel(), np.repeat(mesh.area_faces / 3, 3), len(mesh.vertices)).astype(np.float64)


def _draw(axes: Any, values: Array, area: Array, sheet: Sheet, width: float, title: str, unit: str, color: str) -> None:
    """A histogram of values (v,), by area (v,), with its quantiles, about so many inches wide; the title ends with the unit."""
    known = np.isfinite(values)
    low, high = min(float(values[known].min()), 0.0), max(float(values[known].max()), 0.0)
    if low == high:
        high = 1.0
    power = int(np.floor(np.log10(max(high, -low))))
    if _PLAIN[0] <= power <= _PLAIN[1]:
        power = 0
    else:  # in the title, because matplotlib's would be written over it
        title = f"{title.removesuffix(unit)}$10^{{{power}}}$ {unit}"
    low, high, values = low / 10.0**power, high / 10.0**power, values / 10.0**power
    shares, edges = np.histogram(values[known], _BINS, (low, high), weights=100 * area[known] / area.sum())
    axes.stairs(shares, edges, fill=True, color=color)
    if low < 0 < high:
        axes.axvline(0.0, color=INK, lw=0.06 * sheet.font)
    axes.set_xlim(low, high)
    axes.set_ylim(0.0)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=sheet.font - 1)
    axes.xaxis.set_major_locator(ticks(width, sheet, _ROOM[0], 5))
    axes.yaxis.set_major_locator(ticks(_PANEL_HEIGHT * axes.figure.get_figheight(), sheet, _ROOM[1], 5))
    axes.ticklabel_format(axis="x", useOffset=False, style="plain")
    axes.set_xlabel(wrapped(title, width, sheet), fontsize=sheet.font)
    digits = 2 - int(np.floor(np.log10(high - low)))
    lower, median, upper = (f"{round(value, digits) + 0.0:.3g}" for value in _quantiles(values[known], area[known]))
    text = f"median {median}, {_QUANTILES[2] - _QUANTILES[0]} % from {lower} to {upper}".replace("-", "−")
    if not known.all():
        text += f", unknown on {100 * area[~known].sum() / area.sum():.2g} %"
    axes.set_title(wrapped(text, width, sheet), fontsize=sheet.font - 1)


def _quantiles(values: Array, area: Array) -> Array:
    """The values that 5 %, 50 % and 95 % of the area do not exceed."""
    order = np.argsort(values)
    below = np.cumsum(area[order]) / area.sum()
    found: Array = values[order][np.searchsorted(below, np.array(_QUANTILES) / 100).clip(max=len(order) - 1)]
    return found
