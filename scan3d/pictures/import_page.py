"""A page that shows what became of a laboratory's table: raw and converted curves, the clamp's path, and the first rows."""

from __future__ import annotations

import html
import io
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from scan3d.arrays import Array, Mask
from scan3d.pictures.figures import SPATIAL_LABELS, open_axes, own_style
from scan3d.pictures.parts import INK, REACTION_COLORS, UNKNOWN, evenly_chosen
from scan3d.pictures.sheet import FONT

if TYPE_CHECKING:
    from scan3d.laboratory.importing import Imported

# Points of a curve, about as many as the page has pixels, and stretches and sweeps that are drawn at most.
_POINTS, _MOST = 1500, 400
_STYLE = """body{font:15px/1.45 system-ui,sans-serif;color:#222;max-width:62rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.4rem}h2{font-size:1.1rem;margin-top:2rem}svg{width:100%;height:auto}
table{border-collapse:collapse}th,td{padding:.15rem .6rem;text-align:right;font-variant-numeric:tabular-nums}
th{border-bottom:1px solid #999}.facts td,.facts th{text-align:left;border:0}.wide{overflow-x:auto}li{margin:.3rem 0}"""


def import_page(imported: Imported, facts: Sequence[tuple[str, str]], rows: Sequence[Sequence[str]]) -> bytes:
    """The page (HTML, UTF-8), which needs neither the network nor scripts.  The same import gives the same bytes.

    facts
        what was done, as names and values.
    rows
        the first rows of the recording as text, below the names of their columns.
    """
    with own_style():
        raw = _svg(_curves(imported, imported.log.wrench, imported.zero, "the sensor shows"))
        converted = _svg(_curves(imported, imported.wrench, None, "reaction at the clamp"))
        path = _svg(_path(imported))
    name = html.escape(imported.summary.table)
    facts_rows = "".join(f"<tr><th>{html.escape(a)}</th><td>{html.escape(b)}</td></tr>" for a, b in facts)
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in imported.summary.notes)
    head, *cells = (_cells(row, "td" if k else "th") for k, row in enumerate(rows))
    text = f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{name}, imported by scan3d</title>
<style>{_STYLE}</style></head><body>
<h1>{name}</h1>
<table class="facts">{facts_rows}</table>
{f"<h2>Notes</h2><ul>{notes}</ul>" if notes else ""}
<h2>What the sensor shows</h2>
<p>Blue bars: stretches in the air. Dashed: the zero that is taken off.</p>
{raw}
<h2>What the recording holds</h2>
<p>Support reactions in the clamp's frame; grey bars: sweeps.</p>
{converted}
<h2>The path of the clamp</h2>
<p>Coloured by the number of the sweep; grey: rows between sweeps.</p>
{path}
<h2>The first rows</h2>
<div class="wide"><table><tr>{head}</tr>{"".join(f"<tr>{row}</tr>" for row in cells)}</table></div>
</body></html>
"""
    return text.encode(errors="replace")


def _cells(row: Sequence[str], tag: str) -> str:
    return "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row)


def _svg(figure: Any) -> str:
    """A figure as an element of a page."""
    from matplotlib import rc_context

    stream = io.StringIO()
    with rc_context({"svg.hashsalt": "scan3d", "svg.fonttype": "none"}):
        figure.savefig(stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    return re.sub("<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)


def _figure() -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(9.6, 4.6), layout="constrained")


def _curves(imported: Imported, values: Array, zero: Array | None, what: str) -> Any:
    """Forces above moments, over time."""
    figure, clock = _figure(), imported.clock - imported.clock[0]
    panels = figure.subplots(2, 1, sharex=True)
    marked, mark = (imported.sweep >= 0, UNKNOWN) if zero is None else (imported.air, "#56B4E9")
    for part, axes in enumerate(panels):
        (label, *names), scale = SPATIAL_LABELS[part], (1e3, 1e6)[part]
        for start, stop in _spans(marked):
            axes.axvspan(clock[start], clock[stop - 1], color=mark, alpha=0.25, lw=0)
        for axis in range(3):
            column = values[:, 3 * part + axis]
            if not column.any():
                continue
            name = names[axis] if zero is None else "xyz"[axis]
            axes.plot(*_thin(clock, scale * column), color=REACTION_COLORS[axis], lw=0.8, label=name)
            if zero is not None and len(zero) == len(column):
                axes.plot(*_thin(clock, scale * zero[:, 3 * part + axis]), color=INK, lw=0.9, ls="--")
        axes.set_ylabel(label, fontsize=FONT - 2)
        open_axes(axes, FONT - 3)
        axes.margins(x=0.01)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="lower right", bbox_to_anchor=(1, 0.97), fontsize=FONT - 3, frameon=False, ncols=3)
    panels[0].set_title(what, loc="left", fontsize=FONT - 1)
    panels[-1].set_xlabel("row" if imported.log.time_s is None else "time in s", fontsize=FONT - 2)
    return figure


def _thin(x: Array, y: Array) -> tuple[Array, Array]:
    """A curve with the extremes of its parts, if it has more points than are seen."""
    if len(x) <= 2 * _POINTS:
        return x, y
    edges = np.linspace(0, len(x), _POINTS + 1).astype(np.intp)[:-1]
    low, high = np.minimum.reduceat(y, edges), np.maximum.reduceat(y, edges)
    return np.repeat(x[edges], 2), np.stack([low, high], axis=1).ravel()


def _spans(marked: Mask) -> list[tuple[int, int]]:
    """Runs of marked rows, the longest ones if there are many."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8))).reshape(-1, 2)
    longest = np.argsort(edges[:, 0] - edges[:, 1], kind="stable")[:_MOST]
    return [(int(a), int(b)) for a, b in edges[np.sort(longest)]]


def _path(imported: Imported) -> Any:
    """The clamp's path from above and from the side."""
    from matplotlib import colormaps

    figure, position_mm = _figure(), imported.position_m * 1e3
    numbers = np.unique(imported.sweep[imported.sweep >= 0])
    colors = colormaps["viridis"](np.linspace(0, 0.95, max(len(numbers), 1)))
    sweeps = [(np.flatnonzero(imported.sweep == numbers[k]), colors[k]) for k in evenly_chosen(len(numbers), _MOST)]
    step = max(1, len(position_mm) // (4 * _POINTS))
    for axes, (a, b) in zip(figure.subplots(1, 2), ((0, 1), (0, 2)), strict=True):
        axes.plot(position_mm[::step, a], position_mm[::step, b], color="0.8", lw=0.6, zorder=1)
        for rows, color in sweeps:
            drawn = position_mm[rows[evenly_chosen(len(rows), 30)]]
            axes.plot(drawn[:, a], drawn[:, b], color=color, lw=1.0, zorder=2)
        axes.set_xlabel(f"{'xyz'[a]} in mm", fontsize=FONT - 2)
        axes.set_ylabel(f"{'xyz'[b]} in mm", fontsize=FONT - 2)
        open_axes(axes, FONT - 3)
        axes.set_aspect("equal", adjustable="datalim")
    return figure
