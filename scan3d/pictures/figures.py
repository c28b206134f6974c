"""Parts of matplotlib figures: rendered images with scale and axes, colour bars, legends."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from scan3d.pictures.canvas import FILLED, Canvas
from scan3d.pictures.shading import INK, UNKNOWN, Shade
from scan3d.pictures.words import unit_symbol

# Figures have the width of two columns of a paper, in inches; letters of this size, in points, stay legible in one column.
WIDTH, FONT = 7.0, 12
# Size of a font in points at which a line of one character fills an inch: characters are about 0.55 of their size wide.
_LINE = 72 / 0.55
# Axis labels of the support reactions (8).
REACTION_LABELS = ("$f_{0x}$ in mN", "$f_{0y}$ in mN", "$m_{0z}$ in mN mm")
# Axis labels of six support reactions.
SIX_REACTION_LABELS = (
    "$f_{0x}$ in mN",
    "$f_{0y}$ in mN",
    "$f_{0z}$ in mN",
    "$m_{0x}$ in mN mm",
    "$m_{0y}$ in mN mm",
    "$m_{0z}$ in mN mm",
)
# Labels of two axes for three components each, with the names of the components.
SPATIAL_LABELS = [
    ["force in mN", "$f_{0x}$", "$f_{0y}$", "$f_{0z}$"],
    ["moment in mN mm", "$m_{0x}$", "$m_{0y}$", "$m_{0z}$"],
]
# Pixels to the inch: 1400 pixels of width are sharp in print and on screens; more make larger files.
DPI = 200
# A figure is at least this high, in inches, so that a colour bar has room for its title, and at most this fraction of its
# width, so that two fit on a page.
_LOWEST, _HIGHEST = 3.2, 0.75
# Fraction of a figure's height that the body may fill above the scale and the world's axes.
_ABOVE_SCALE = 0.80
# Length of the world's axes in pixels, and how much longer per pixel of width: their letters keep their size, so the axes of
# small images are longer in proportion.
_AXIS, _AXIS_PER_PIXEL = 30, 0.036
# Places around the axes in lengths of an axis: rows of pixels kept free for them, their origin, the distance of a letter,
# the distance under which letters overlap, begin of the scale, its height and that of its label.
_AXES_FLOOR, _AXES_ORIGIN, _LETTER, _OVERLAP = 1.9, (1.6, 1.3), 1.35, 0.4
_SCALE_BEGIN, _SCALE_HEIGHT, _SCALE_LABEL = 3.4, 0.55, 0.75
# Rounding: a length that should be exactly a step counts as one.
_SLACK = 1e-9
# Longest scale as a fraction of the image's width: it stays clear of the right edge.
_LONGEST_SCALE = 0.22


def blank_figure(height: float, dpi: int = DPI) -> Any:
    """A white figure, `WIDTH` wide; its height is in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, height), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def show_canvas(
    figure: Any, canvas: Canvas, place: tuple[float, float, float, float], unit: str, *, scaled: bool = True
) -> None:
    """Draw a canvas into a place (left, bottom, width, height) of the figure, with a scale and the world's axes."""
    width, height = (round(float(v)) for v in figure.get_size_inches() * figure.dpi * place[2:])
    arm = _AXIS + _AXIS_PER_PIXEL * width
    image, length_across = canvas.image(width, height, _AXES_FLOOR * arm)
    canvas.plotter.close()
    axes = figure.add_axes(place)
    axes.imshow(image, extent=(0, width, 0, height), interpolation="nearest", aspect="auto")
    axes.set_axis_off()
    if scaled:
        _world_axes(axes, canvas, arm)
        _scale(axes, length_across, width, arm, unit)
        axes.set_xlim(0, width)
        axes.set_ylim(0, height)


def _world_axes(axes: Any, canvas: Canvas, arm: float) -> None:
    """Arrows along the world's axes as the camera sees them; `arm` is the length of an axis across the view, in pixels."""
    start, letters = np.array([_AXES_ORIGIN[0] * arm, _AXES_ORIGIN[1] * arm]), [np.zeros(2)]
    ends = np.stack([np.stack([canvas.right, canvas.up]) @ axis for axis in np.eye(3)]) * arm
    for k in np.argsort(-np.linalg.norm(ends, axis=1), kind="stable"):
        letter = _LETTER * ends[k]
        # an axis that points at the viewer, or has the direction of another
        if min(np.linalg.norm(letter - other) for other in letters) < _OVERLAP * arm:
            continue
        letters.append(letter)
        axes.annotate(
            "", start + ends[k], start, arrowprops=dict(arrowstyle="-|>", color=INK, lw=1.2, shrinkA=0, shrinkB=0)
        )
        axes.text(*(start + letter), "xyz"[k], ha="center", va="center", fontsize=FONT - 2, color=INK)


def _scale(axes: Any, length_across: float, width: int, arm: float, unit: str) -> None:
    """A line as long as a round length; the image is `length_across` units, or `width` pixels, wide."""
    length = nice(_LONGEST_SCALE * length_across)
    pixels = length / length_across * width
    begin = _SCALE_BEGIN * arm
    axes.plot([begin, begin + pixels], [_SCALE_HEIGHT * arm] * 2, color=INK, lw=2.5, solid_capstyle="butt")
    text = f"{length:g} {unit_symbol(unit)}"
    axes.text(begin + pixels / 2, _SCALE_LABEL * arm, text, ha="center", va="bottom", fontsize=FONT - 1, color=INK)


def nice(length: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is no longer."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step * power for step in (1, 2, 5) if step * power <= length * (1 + _SLACK)))


def color_bar(figure: Any, shaded: Shade, unknown: str = "") -> None:
    """The scale of some colours at the right edge, with its title; `unknown` is the label of grey, if it occurs."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    place = figure.add_axes((0.832, 0.15, 0.025, 0.70))
    bar = figure.colorbar(ScalarMappable(shaded.norm, shaded.map), cax=place)
    bar.ax.tick_params(labelsize=FONT - 1)
    bar.outline.set_linewidth(0.6)
    if type(shaded.norm).__name__ == "Normalize":
        bar.locator = MaxNLocator(6, steps=[1, 2, 5, 10])
        bar.formatter.set_powerlimits((-4, 5))
        bar.formatter.set_useMathText(True)
        bar.ax.yaxis.get_offset_text().set_fontsize(FONT - 1)
    title = shaded.title.replace(" um", " µm")
    size = min(FONT, _LINE * figure.get_figheight() / len(title))  # long titles are set smaller
    figure.text(0.992, 0.5, title, rotation="vertical", ha="right", va="center", fontsize=size)
    if unknown:
        figure.legend(
            [Patch(color=UNKNOWN)], [unknown], loc="lower right", frameon=False, fontsize=FONT - 2, handlelength=1,
            bbox_to_anchor=(0.995, 0.05),
        )  # fmt: skip


def legend(figure: Any, entries: list[tuple[str, str, str]], columns: int) -> None:
    """A legend of entries (text, colour, mark): in one column right of the picture, in several columns below it."""
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


def figure_height(canvas: Canvas, fraction: float) -> float:
    """Height of a figure, in inches, in which the canvas fills a fraction of the width."""
    wide, high = np.ptp(canvas.corners @ np.stack([canvas.right, canvas.up], axis=1), axis=0)
    return float(
        np.clip(WIDTH * fraction * high / (wide or high or 1.0) * FILLED / _ABOVE_SCALE, _LOWEST, _HIGHEST * WIDTH)
    )


def save(figure: Any, path: Path) -> None:
    """Write a figure, without the time, so that the same figure gives the same file."""
    pdf = path.suffix.lower() == ".pdf"
    figure.savefig(
        path, dpi=DPI, metadata={"CreationDate": None, "Creator": "scan3d"} if pdf else {"Software": "scan3d"}
    )


@contextmanager
def quiet() -> Iterator[None]:
    """Within it matplotlib does not log warnings, such as those on its font cache, to stderr."""
    log = logging.getLogger("matplotlib")
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(before)
