"""Parts of matplotlib figures: rendered images with scale and axes, colour bars, legends."""

from __future__ import annotations

import logging
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.pictures.canvas import Canvas
from scan3d.pictures.shading import INK, UNKNOWN, Shade
from scan3d.pictures.sheet import DPI, FONT, WIDTH, Sheet
from scan3d.pictures.words import unit_symbol

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
# Lengths are in sizes of letters, so that parts keep their proportion to them, unless they are said to be in inches.
# A figure is at least this high, so that a colour bar has room for its title, and at most this fraction of its width, so that
# two fit on a page.
_LOWEST, _HIGHEST = 19.2, 0.75
# Width of a character, of which titles are wrapped into lines.
_CHARACTER = 0.58
# Length of the world's axes across the view; those that are shorter than this fraction of it are not drawn; distance of a
# letter from an axis; the distance under which letters overlap; half a letter's height; their size relative to other letters.
_ARM, _SHORTEST_ARM, _TO_LETTER, _OVERLAP, _HALF_LETTER, _AXES_FONT = 2.1, 0.3, 0.75, 0.9, 0.6, 0.85
# Lowest strip for the scale; distance of the scale from the axes, its height above the lower edge and that of its label.
_LOWEST_STRIP, _SCALE_GAP, _SCALE_HEIGHT, _SCALE_LABEL = 2.2, 1.2, 0.5, 0.75
# Longest scale as a fraction of the picture's width.
_LONGEST_SCALE = 0.22
# Lower edge and height of a colour bar as fractions of the figure's height, its width and the distance of its title; margin at
# the figure's edge.
_BAR, _BAR_WIDTH, _TITLE_PAD, _MARGIN = (0.15, 0.70), 1.05, 0.6, 0.5
# Smallest width and height of the image of a body.
_SMALLEST_BODY = 4.0
# Distance of the parts of a chart.
_CHART_PAD = 0.4
# What matplotlib asks browsers for, which by default average pixels.
_PIXELATED = b"image-rendering:crisp-edges;image-rendering:pixelated"
# Rounding: a length that should be exactly a step counts as one; a part of a pixel.
_ROUNDING, _SLACK = 1e-9, 1e-3


def blank_figure(height: float, dpi: int = DPI, width: float = WIDTH) -> Any:
    """A white figure; width and height are in inches, and rounded to pixels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_whole(width, dpi), _whole(height, dpi)), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def _whole(length: float, dpi: int) -> float:
    """A length in inches, rounded to pixels."""
    pixels = round(length * dpi)
    exact = pixels / dpi
    # where rounding made it smaller a part of a pixel more, because matplotlib rounds down
    return exact if int(exact * dpi) == pixels else (pixels + _SLACK) / dpi


def chart(width_over_height: float, sheet: Sheet) -> Any:
    """A figure for charts, whose parts are arranged so that no labels overlap; proportions apply to sheets without a height."""
    figure = blank_figure(sheet.height or sheet.width / width_over_height, sheet.dpi, sheet.width)
    figure.set_layout_engine("constrained", w_pad=_CHART_PAD * sheet.em, h_pad=_CHART_PAD * sheet.em)
    return figure


def show_canvas(
    figure: Any,
    canvas: Canvas,
    place: tuple[float, float, float, float],
    sheet: Sheet,
    unit: str,
    *,
    scaled: bool = True,
) -> None:
    """Draw a canvas into a place (left, bottom, width, height; in inches) of the figure.

    Below it is a strip for the scale and the world's axes, which are drawn if the canvas is `scaled`.  Raises InputError where
    the place is too small for that.
    """
    strip = strip_height(canvas, sheet)
    # whole pixels: the image is shown as it was rendered
    left, bottom, width, height = (
        round(side * sheet.dpi) for side in (place[0], place[1] + strip, place[2], place[3] - strip)
    )
    if min(place[2], place[3] - strip) < _SMALLEST_BODY * sheet.em:
        wide, high = (f"{side * 25.4:.0f}" for side in figure.get_size_inches())
        raise InputError(
            f"a picture of {wide} x {high} mm has no room for the body beside its labels; choose a larger size"
        )
    pixels = np.round(figure.get_size_inches() * sheet.dpi)
    image, length_across = canvas.image(width, height, sheet.camera.zoom if sheet.camera else 1.0)
    canvas.plotter.close()
    axes = figure.add_axes((*(np.array([left, bottom]) / pixels), *(np.array([width, height]) / pixels)))
    axes.imshow(image, extent=(0, width, 0, height), interpolation="none", aspect="auto")
    axes.set_axis_off()
    if scaled:
        below = figure.add_axes(
            (left / pixels[0], place[1] * sheet.dpi / pixels[1], width / pixels[0], strip * sheet.dpi / pixels[1])
        )
        below.set_axis_off()
        below.set_xlim(0, place[2])
        below.set_ylim(0, strip)
        end = _world_axes(below, canvas, sheet)
        _scale(below, length_across, place[2], end, sheet, unit)


def _axes_in_view(canvas: Canvas, sheet: Sheet) -> list[tuple[str, Array, Array]]:
    """Letter, end (2,) and the letter's place (2,) in inches of the world's axes that the camera sees, about their origin.

    Left out are axes that point at the viewer, or in the direction of another.
    """
    seen: list[tuple[str, Array, Array]] = []
    ends = np.stack([canvas.right, canvas.up], axis=1)
    lengths = np.linalg.norm(ends, axis=1)
    for k in np.argsort(-lengths, kind="stable"):
        if lengths[k] < _SHORTEST_ARM:
            continue
        end = _ARM * sheet.em * ends[k]
        letter = end + _TO_LETTER * sheet.em * ends[k] / lengths[k]
        if all(np.linalg.norm(letter - other) > _OVERLAP * sheet.em for _, _, other in seen):
            seen.append(("xyz"[k], end, letter))
    return seen


def _extent(canvas: Canvas, sheet: Sheet) -> tuple[Array, Array]:
    """Lower left and upper right corner of the axes with their letters, about their origin, in inches."""
    letters = np.array([(0.0, 0.0), *(letter for _, _, letter in _axes_in_view(canvas, sheet))])
    half = _HALF_LETTER * sheet.em
    return letters.min(axis=0) - half, letters.max(axis=0) + half


def strip_height(canvas: Canvas, sheet: Sheet) -> float:
    """Height in inches of the strip for the scale and the world's axes below a picture."""
    low, high = _extent(canvas, sheet)
    return float(max(high[1] - low[1], _LOWEST_STRIP * sheet.em))


def _world_axes(axes: Any, canvas: Canvas, sheet: Sheet) -> float:
    """Arrows along the world's axes as the camera sees them.  Returns their right end in inches."""
    low, high = _extent(canvas, sheet)
    size = sheet.font * _AXES_FONT
    arrow = dict(
        arrowstyle="-|>", color=INK, lw=0.1 * sheet.font, mutation_scale=0.8 * sheet.font, shrinkA=0, shrinkB=0
    )
    for name, end, letter in _axes_in_view(canvas, sheet):
        axes.annotate("", end - low, -low, arrowprops=arrow)
        axes.text(*(letter - low), name, ha="center", va="center", fontsize=size, color=INK)
    return float(high[0] - low[0])


def _scale(axes: Any, length_across: float, width: float, begin: float, sheet: Sheet, unit: str) -> None:
    """A line as long as a round length, right of `begin`; the picture is `length_across` units, or `width` inches, wide."""
    length = nice(_LONGEST_SCALE * length_across)
    along, begin, em = length / length_across * width, begin + _SCALE_GAP * sheet.em, sheet.em
    axes.plot([begin, begin + along], [_SCALE_HEIGHT * em] * 2, color=INK, lw=0.2 * sheet.font, solid_capstyle="butt")
    text = f"{length:g} {unit_symbol(unit)}"
    middle = begin + along / 2
    axes.text(middle, _SCALE_LABEL * em, text, ha="center", va="bottom", fontsize=sheet.font - 1, color=INK)


def nice(length: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is no longer."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step * power for step in (1, 2, 5) if step * power <= length * (1 + _ROUNDING)))


def color_bar(figure: Any, shaded: Shade, sheet: Sheet, unknown: str = "") -> float:
    """The scale of some colours at the right edge, with its title.

    `unknown` is the label of grey, if it occurs.  Returns how much of the width, in inches, is left of it.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    width, height = figure.get_size_inches()
    place = [0.0, _BAR[0], _BAR_WIDTH * sheet.em / width, _BAR[1]]
    bar = figure.colorbar(ScalarMappable(shaded.norm, shaded.map), cax=figure.add_axes(place))
    bar.ax.tick_params(labelsize=sheet.font - 1)
    bar.outline.set_linewidth(0.05 * sheet.font)
    if type(shaded.norm).__name__ == "Normalize":
        bar.locator = MaxNLocator(6, steps=[1, 2, 5, 10])
        bar.formatter.set_powerlimits((-4, 5))
        bar.formatter.set_useMathText(True)
        bar.ax.yaxis.get_offset_text().set_fontsize(sheet.font - 1)
    bar.set_label(wrapped(shaded.title, height, sheet), fontsize=sheet.font, labelpad=_TITLE_PAD * sheet.font)
    box = box_of(figure, bar.ax)
    margin = _MARGIN * sheet.em
    bar.ax.set_position([(width - margin - box.x1) / width, *place[1:]])
    left = width - margin - box.width
    if unknown:
        entry = figure.legend(
            [Patch(color=UNKNOWN)], [unknown], loc="lower right", frameon=False, fontsize=sheet.font - 2, handlelength=1,
            borderaxespad=_MARGIN,
        )  # fmt: skip
        left = min(left, box_of(figure, entry).x0)
    return float(left - margin)


def wrapped(title: str, length: float, sheet: Sheet) -> str:
    """A title in as few lines as fit into a length in inches, about equally long; units are as they are printed."""
    most = max(int(length / (_CHARACTER * sheet.em)), 1)
    name, between, unit = title.replace(" um", " µm").rpartition(" in ")
    joined = name + between.replace(" in ", " in\u00a0") + unit  # a unit does not stand alone
    fewest = textwrap.wrap(joined, most, break_long_words=False)
    fitting = (
        textwrap.wrap(joined, width, break_long_words=False) for width in range(len(joined) // len(fewest), most)
    )
    lines = next((lines for lines in fitting if len(lines) <= len(fewest)), fewest)
    return "\n".join(lines).replace("\u00a0", " ")


def ticks(length: float, sheet: Sheet, room: float, most: int) -> Any:
    """A locator of at most so many ticks on an axis of a length in inches, whose labels have some sizes of letters of room."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(int(np.clip(length / (room * sheet.em), 1, most)), steps=[1, 2, 2.5, 5, 10])


def legend(figure: Any, entries: list[tuple[str, str, str]], columns: int, font: float = FONT) -> Any:
    """A legend of entries (text, colour, mark): in one column at the right edge, in at most so many columns at the lower edge.

    There are as many columns as fit into the width.
    """
    from matplotlib.lines import Line2D

    marks = {"-": "", "->": ">"}
    size = font / FONT
    handles = [
        Line2D([], [], color=color, lw=2 * size * (mark in marks), marker=marks.get(mark, mark), markersize=8 * size)
        for _, color, mark in entries
    ]
    place = dict(loc="center right") if columns == 1 else dict(loc="lower center")
    for number in range(columns, 0, -1):
        drawn = figure.legend(
            handles, [text for text, _, _ in entries], ncols=number, frameon=False, fontsize=font - 1, handlelength=1.5,
            columnspacing=1.2, borderaxespad=_MARGIN, **place,
        )  # fmt: skip
        if number == 1 or box_of(figure, drawn).width <= figure.get_size_inches()[0]:
            break
        drawn.remove()
    return drawn


def box_of(figure: Any, artist: Any) -> Any:
    """The place in inches of a part of a figure with its labels, with `x0`, `x1`, `y0`, `y1`, `width` and `height`."""
    from matplotlib.transforms import Bbox

    box = artist.get_tightbbox(figure.canvas.get_renderer())
    return Bbox(box.get_points() / figure.dpi)


def picture_height(canvas: Canvas, sheet: Sheet, width: float, above: float) -> float:
    """Height in inches of a figure in which the canvas has a width: as the sheet says, or as high as the body needs.

    `above` are inches for other parts.
    """
    if sheet.height is not None:
        return sheet.height
    wide, high = np.ptp(canvas.corners @ np.stack([canvas.right, canvas.up], axis=1), axis=0)
    needed = width * high / (wide or high or 1.0) + strip_height(canvas, sheet)
    highest = _HIGHEST * sheet.width
    return float(np.clip(needed, min(_LOWEST * sheet.em, highest), highest)) + above


def save(figure: Any, path: Path) -> None:
    """Write a figure, without the time, so that the same figure gives the same file.

    Letters of a .pdf are TrueType, which can be searched and edited; those of an .svg are shapes, which look alike everywhere.
    """
    from matplotlib import rc_context

    metadata = {
        ".pdf": {"CreationDate": None, "Creator": "scan3d"},
        ".svg": {"Date": None, "Creator": "scan3d"},
    }.get(path.suffix.lower(), {"Software": "scan3d"})
    with rc_context({"pdf.fonttype": 42, "svg.fonttype": "path", "svg.hashsalt": "scan3d"}):
        figure.savefig(path, dpi=figure.dpi, metadata=metadata)
    if path.suffix.lower() == ".svg":  # browsers would drop pixels of images that they show smaller, and lines in them
        path.write_bytes(path.read_bytes().replace(_PIXELATED, b""))


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
