"""Figures on paper: an image with its scale and axes, colour bars, legends."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from scan3d.pictures.canvas import Canvas
from scan3d.pictures.shading import INK, UNKNOWN, Shade

# Pixels to the inch of a picture 7 inches wide, which two columns of a paper are: letters of 12 points stay legible in one.
DPI = 200
WIDE = 7.0
FONT = 12
# Inches: for a bar and its title.
_LEAST_TALL = 3.2


def blank_figure(height: float, dpi: int = DPI) -> Any:
    """A white figure 7 inches wide."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDE, height), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def show_canvas(
    figure: Any, canvas: Canvas, place: tuple[float, float, float, float], unit: str, *, scaled: bool = True
) -> None:
    """Put what a canvas's camera sees into a place of the figure, with a scale and the world's axes."""
    left, bottom, wide, tall = place
    width, height = (round(float(v)) for v in figure.get_size_inches() * figure.dpi * (wide, tall))
    arm = 30 + 0.036 * width  # of the world's axes
    image, across = canvas.image(width, height, 1.9 * arm)
    canvas.plotter.close()
    axes = figure.add_axes(place)
    axes.imshow(image, extent=(0, width, 0, height), interpolation="nearest", aspect="auto")
    axes.set_axis_off()
    if not scaled:
        return
    start, labels = np.array([1.6 * arm, 1.3 * arm]), [np.zeros(2)]
    ends = np.stack([np.stack([canvas.right, canvas.up]) @ axis for axis in np.eye(3)]) * arm
    for k in np.argsort(-np.linalg.norm(ends, axis=1), kind="stable"):
        at = 1.35 * ends[k]
        # one that points at the viewer, or lies below another
        if min(np.linalg.norm(at - other) for other in labels) < 0.4 * arm:
            continue
        labels.append(at)
        axes.annotate(
            "", start + ends[k], start, arrowprops=dict(arrowstyle="-|>", color=INK, lw=1.2, shrinkA=0, shrinkB=0)
        )
        axes.text(*(start + at), "xyz"[k], ha="center", va="center", fontsize=FONT - 2, color=INK)
    length = nice(0.22 * across)
    pixels = length / across * width
    begin = 3.4 * arm
    axes.plot([begin, begin + pixels], [0.55 * arm] * 2, color=INK, lw=2.5, solid_capstyle="butt")
    text = f"{length:g} {unit.replace('um', 'µm')}"
    axes.text(begin + pixels / 2, 0.75 * arm, text, ha="center", va="bottom", fontsize=FONT - 1, color=INK)
    axes.set_xlim(0, width)
    axes.set_ylim(0, height)


def nice(length: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is no longer."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step * power for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)))


def color_bar(figure: Any, shaded: Shade, unknown: str = "") -> None:
    """The colours' scale at the right edge, with its title; `unknown` says what is grey."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    place = figure.add_axes((0.832, 0.15, 0.025, 0.70))
    drawn = figure.colorbar(ScalarMappable(shaded.norm, shaded.map), cax=place)
    drawn.ax.tick_params(labelsize=FONT - 1)
    drawn.outline.set_linewidth(0.6)
    if type(shaded.norm).__name__ == "Normalize":
        drawn.locator = MaxNLocator(6, steps=[1, 2, 5, 10])
        drawn.formatter.set_powerlimits((-4, 5))
        drawn.formatter.set_useMathText(True)
        drawn.ax.yaxis.get_offset_text().set_fontsize(FONT - 1)
    title = shaded.title.replace(" um", " µm")
    figure.text(0.992, 0.5, title, rotation="vertical", ha="right", va="center", fontsize=FONT)
    if unknown:
        figure.legend(
            [Patch(color=UNKNOWN)], [unknown], loc="lower right", frameon=False, fontsize=FONT - 2, handlelength=1,
            bbox_to_anchor=(0.995, 0.05),
        )  # fmt: skip


def legend(figure: Any, entries: list[tuple[str, str, str]], columns: int) -> None:
    """What is what: (text, colour, mark) each; in one column right of the picture, in several below it."""
    from matplotlib.lines import Line2D

    marks = {"-": "", "->": ">"}
    handles = [
        Line2D([], [], color=color, lw=2 * (mark in marks), marker=marks.get(mark, mark), markersize=8)
        for _, color, mark in entries
    ]
    place = dict(loc="center right", bbox_to_anchor=(0.985, 0.5)) if columns == 1 else dict(loc="lower center")
    figure.legend(
        handles, [text for text, _, _ in entries], ncols=columns, frameon=False, fontsize=FONT - 1, handlelength=1.5,
        columnspacing=1.2, **place,
    )  # fmt: skip


def figure_height(canvas: Canvas, share: float) -> float:
    """Height of a figure, in inches, that suits what the camera sees in a share of its width."""
    wide, high = np.ptp(canvas.corners @ np.stack([canvas.right, canvas.up], axis=1), axis=0)
    return float(np.clip(WIDE * share * high / (wide or high or 1.0) * 0.94 / 0.80, _LEAST_TALL, 0.75 * WIDE))


def save(figure: Any, path: Path) -> None:
    """Write a figure without the time of day."""
    pdf = path.suffix.lower() == ".pdf"
    figure.savefig(path, dpi=DPI, metadata={"CreationDate": None} if pdf else {"Software": "scan3d"})


@contextmanager
def quiet() -> Iterator[None]:
    """matplotlib's remarks on its caches belong to nobody's stderr."""
    log = logging.getLogger("matplotlib")
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(before)
