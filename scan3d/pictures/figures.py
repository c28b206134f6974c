"""The sheet of a picture, its size, resolution and camera, and the parts of matplotlib figures on it.

Parts are rendered images with scale and axes, colour bars and legends.  Lengths are in inches; parts are measured by the size
of letters, `Sheet.em`, so that they keep their proportion to them.
"""

from __future__ import annotations

import logging
import math
import re
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.choices import CAMERAS
from scan3d.errors import InputError
from scan3d.pictures.canvas import Canvas
from scan3d.pictures.parts import INK, UNKNOWN, Shade
from scan3d.units import unit_symbol

# A picture is two columns of a paper wide, in inches, has letters of 12 points, and is sharp in print and on screens.
WIDTH, FONT, DPI = 7.0, 12.0, 200
_NUMBER = r"(\d+\.?\d*|\.\d+)"
_SIZE = re.compile(rf"{_NUMBER}(?:\s*[x×]\s*{_NUMBER})?\s*(mm|cm|in|pt|px)")


@dataclass(frozen=True)
class Camera:
    """From where a body is seen, in parallel projection."""

    azimuth_deg: float
    """of the direction toward the camera, from the x axis to the y axis"""
    elevation_deg: float
    """of this direction above the x-y plane, from -90 to 90"""
    zoom: float = 1.0
    """magnification about the middle: with 1 the picture contains all of the body"""

    @property
    def toward(self) -> tuple[float, float, float]:
        """Unit vector toward the camera."""
        return _direction(self.azimuth_deg, self.elevation_deg)

    @property
    def up(self) -> tuple[float, float, float]:
        """Unit vector up in the picture; from the top, with the azimuth of the front, y is up."""
        return _direction(self.azimuth_deg, self.elevation_deg + 90)


def _direction(azimuth_deg: float, elevation_deg: float) -> tuple[float, float, float]:
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    across = math.cos(elevation)
    return across * math.cos(azimuth), across * math.sin(azimuth), math.sin(elevation)


@dataclass(frozen=True)
class Sheet:
    """What a picture is drawn on.  Lengths in inches."""

    width: float = WIDTH
    height: float | None = None
    """None: as high as what is drawn needs"""
    dpi: int = DPI
    camera: Camera | None = None
    """None: that of the view"""

    @property
    def font(self) -> float:
        """Size of letters in points, in proportion to the width, and to the height of a low picture."""
        part = self.width / WIDTH if self.height is None else min(self.width / WIDTH, self.height / 3.2)
        # journals ask for no less
        return min(FONT, max(8.0, FONT * part))

    @property
    def em(self) -> float:
        """Size of letters in inches, by which the parts of a picture are measured."""
        return self.font / 72

    @property
    def scale(self) -> float:
        """Pixels for a pixel of the default sheet: of points and lines, which keep their proportion to letters."""
        return self.font / FONT * self.dpi / DPI

    @property
    def sampling(self) -> int:
        """How many times larger images are rendered before they are averaged; single pixels of 600 dpi are not seen."""
        return 1 if self.dpi >= 600 else 2


def sheet(size: str | None = None, dpi: int | str | None = None, camera: str | None = None) -> Sheet:
    """The sheet of a picture; its size, resolution and camera are stated as in `scan3d.plot`.

    Raises InputError for other values, and for a picture that is too large to be rendered.
    """
    dots = DPI if dpi is None else int(dpi) if str(dpi).isdecimal() else 0
    if not 50 <= dots <= 2400:
        raise InputError(
            f"the resolution of a picture is a whole number of dots per inch from 50 to 2400, such as 300, got {dpi!r}"
        )
    width, height = (WIDTH, None) if size is None else _size(size, dots)
    made = Sheet(width, height, dots, None if camera is None else _camera(camera))
    wide, high = (round(side * dots) for side in (width, height or 0.75 * width))
    if max(wide, high) > 8192:  # graphics drivers stop at twice as many, which is what is rendered
        raise InputError(
            f"a picture has at most 8192 pixels along a side, and this one would have {max(wide, high)}; choose a smaller size "
            "or resolution"
        )
    return made


def _size(text: str, dpi: int) -> tuple[float, float | None]:
    match = _SIZE.fullmatch(str(text).strip().lower())
    if match is None:
        raise InputError(
            "the size of a picture is WIDTH or WIDTHxHEIGHT with a unit (mm, cm, in, pt or px), such as 85mm or 85x60mm, "
            f"got {text!r}"
        )
    inches = {"mm": 1 / 25.4, "cm": 1 / 2.54, "in": 1.0, "pt": 1 / 72, "px": 1 / dpi}[match[3]]
    width, height = (None if side is None else float(side) * inches for side in match.groups()[:2])
    assert width is not None
    sides_mm = [round(25.4 * side, 6) for side in (width, width if height is None else height)]
    if sides_mm[0] < 50 or sides_mm[1] < 35 or max(sides_mm) > 2540:
        at_dpi = f" at {dpi} dpi" if match[3] == "px" else ""
        raise InputError(f"a picture is at least 50 mm wide and 35 mm high, and at most 2540 mm, got {text!r}{at_dpi}")
    return width, height


def _camera(text: str) -> Camera:
    name, *rest = (part.strip() for part in str(text).split(","))
    diagonal = (-45, math.degrees(math.atan(math.sqrt(0.5))))  # with x, y and z equally short
    known = dict(zip(CAMERAS, ((-90, 0), (90, 0), (180, 0), (0, 0), (-90, 90), (-90, -90), diagonal), strict=True))
    try:
        numbers = [float(part) for part in rest]
        angles = known[name.lower()] if name.lower() in known else (float(name), numbers.pop(0))
        camera = Camera(*angles, *numbers)
    except (ValueError, TypeError, IndexError):  # not numbers, or too few or too many
        camera = Camera(math.nan, math.nan)
    if not (abs(camera.azimuth_deg) <= 360 and abs(camera.elevation_deg) <= 90 and 0.1 <= camera.zoom <= 100):
        raise InputError(
            f"a camera is {', '.join(CAMERAS)}, or AZIMUTH,ELEVATION in degrees (elevation from -90 to 90), such as 300,25, "
            f"and after either a comma and a zoom from 0.1 to 100, got {text!r}"
        )
    return camera


# Margin at the figure's edge, in sizes of letters.
_MARGIN = 0.5


def blank_figure(height: float, dpi: int = DPI, width: float = WIDTH) -> Any:
    """A white figure; width and height are rounded to pixels."""
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
    return exact if int(exact * dpi) == pixels else (pixels + 1e-3) / dpi


def chart(width_over_height: float, sheet: Sheet) -> Any:
    """A figure for charts, whose parts are arranged so that no labels overlap; proportions apply to sheets without a height."""
    figure = blank_figure(sheet.height or sheet.width / width_over_height, sheet.dpi, sheet.width)
    figure.set_layout_engine("constrained", w_pad=0.4 * sheet.em, h_pad=0.4 * sheet.em)
    return figure


def open_axes(axes: Any, font: float) -> None:
    """Axes without a frame at the top and to the right, with numbers of a size in points."""
    axes.tick_params(labelsize=font)
    axes.spines[["top", "right"]].set_visible(False)


def show_canvas(
    figure: Any,
    canvas: Canvas,
    place: tuple[float, float, float, float],
    sheet: Sheet,
    unit: str,
    *,
    scaled: bool = True,
) -> None:
    """Draw a canvas into a place (left, bottom, width, height) of the figure.

    Below it is a strip for the scale and the world's axes, which are drawn if the canvas is `scaled`.  Raises InputError where
    the place is too small for that.
    """
    strip = strip_height(canvas, sheet)
    # whole pixels: the image is shown as it was rendered
    sides = (place[0], place[1] + strip, place[2], place[3] - strip)
    left, bottom, width, height = (round(side * sheet.dpi) for side in sides)
    if min(place[2], place[3] - strip) < 4 * sheet.em:
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
        low, high = np.array([place[1], strip]) * sheet.dpi / pixels[1]
        below = figure.add_axes((left / pixels[0], low, width / pixels[0], high))
        below.set_axis_off()
        below.set_xlim(0, place[2])
        below.set_ylim(0, strip)
        end = _draw_world_axes(below, canvas, sheet)
        _draw_scale(below, length_across, place[2], end, sheet, unit)


def _world_axes(canvas: Canvas, sheet: Sheet) -> tuple[list[tuple[str, Array, Array]], Array, Array]:
    """Letter, end (2,) and the letter's place (2,) of the world's axes that the camera sees, their origin (2,) and size (2,).

    Left out are axes that point at the viewer, or in the direction of another.
    """
    seen: list[tuple[str, Array, Array]] = []
    ends = np.stack([canvas.right, canvas.up], axis=1)
    lengths = np.linalg.norm(ends, axis=1)
    for k in np.argsort(-lengths, kind="stable"):
        if lengths[k] < 0.3:
            continue
        end = 2.1 * sheet.em * ends[k]
        letter = end + 0.75 * sheet.em * ends[k] / lengths[k]
        if all(np.linalg.norm(letter - other) > 0.9 * sheet.em for _, _, other in seen):
            seen.append(("xyz"[k], end, letter))
    letters = np.array([(0.0, 0.0), *(letter for _, _, letter in seen)])
    half = 0.6 * sheet.em  # of a letter
    low, high = letters.min(axis=0) - half, letters.max(axis=0) + half
    return [(name, end - low, letter - low) for name, end, letter in seen], -low, high - low


def strip_height(canvas: Canvas, sheet: Sheet) -> float:
    """Height of the strip for the scale and the world's axes below a picture."""
    return float(max(_world_axes(canvas, sheet)[2][1], 2.2 * sheet.em))


def _draw_world_axes(axes: Any, canvas: Canvas, sheet: Sheet) -> float:
    """Arrows along the world's axes as the camera sees them.  Returns their right end."""
    seen, origin, size = _world_axes(canvas, sheet)
    arrow = dict(
        arrowstyle="-|>", color=INK, lw=0.1 * sheet.font, mutation_scale=0.8 * sheet.font, shrinkA=0, shrinkB=0
    )
    for name, end, letter in seen:
        axes.annotate("", end, origin, arrowprops=arrow)
        axes.text(*letter, name, ha="center", va="center", fontsize=0.85 * sheet.font, color=INK)
    return float(size[0])


def _draw_scale(axes: Any, length_across: float, width: float, begin: float, sheet: Sheet, unit: str) -> None:
    """A line as long as a round length, right of `begin`; the picture is `length_across` units, or `width` inches, wide."""
    longest = 0.22 * length_across
    power = 10.0 ** np.floor(np.log10(longest))
    length = float(max(step * power for step in (1, 2, 5) if step * power <= longest * (1 + 1e-9)))  # but for rounding
    along, begin, em = length / length_across * width, begin + 1.2 * sheet.em, sheet.em
    axes.plot([begin, begin + along], [0.5 * em] * 2, color=INK, lw=0.2 * sheet.font, solid_capstyle="butt")
    text = f"{length:g} {unit_symbol(unit)}"
    axes.text(begin + along / 2, 0.75 * em, text, ha="center", va="bottom", fontsize=sheet.font - 1, color=INK)


def color_bar(figure: Any, shaded: Shade, sheet: Sheet, unknown: str = "") -> float:
    """The scale of some colours at the right edge, with its title, or their kinds.

    `unknown` is the label of grey, if it occurs.  Returns how much of the width is left of it.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.patches import Patch
    from matplotlib.ticker import MaxNLocator

    if shaded.norm is None:
        kinds = [(name, color, "s") for name, color in shaded.kinds]
        return float(box_of(figure, legend(figure, kinds, 1, sheet.font)).x0)
    width, height = figure.get_size_inches()
    place = [0.0, 0.15, 1.05 * sheet.em / width, 0.70]
    extend = ("neither", "min", "max", "both")[shaded.beyond[0] + 2 * shaded.beyond[1]]
    bar = figure.colorbar(ScalarMappable(shaded.norm, shaded.map), cax=figure.add_axes(place), extend=extend)
    bar.ax.tick_params(labelsize=sheet.font - 1)
    bar.outline.set_linewidth(0.05 * sheet.font)
    if type(shaded.norm).__name__ == "Normalize":
        bar.locator = MaxNLocator(6, steps=[1, 2, 5, 10])
        in_powers(bar.ax.yaxis, sheet)
    bar.set_label(wrapped(shaded.title, height, sheet), fontsize=sheet.font, labelpad=0.6 * sheet.font)
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
    """A title in as few lines as fit into a length, about equally long; units are as they are printed."""
    most = max(int(length / (0.58 * sheet.em)), 1)  # by the width of a character
    name, between, unit = title.replace(" um", " µm").rpartition(" in ")
    joined = name + between.replace(" in ", " in\u00a0") + unit  # a unit does not stand alone
    fewest = textwrap.wrap(joined, most, break_long_words=False)
    widths = range(len(joined) // len(fewest), most)
    fitting = (textwrap.wrap(joined, width, break_long_words=False) for width in widths)
    lines = next((lines for lines in fitting if len(lines) <= len(fewest)), fewest)
    return "\n".join(lines).replace("\u00a0", " ")


def ticks(length: float, sheet: Sheet, room: float, most: int) -> Any:
    """A locator of at most so many ticks on an axis of a length, whose labels have some sizes of letters of room."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(int(np.clip(length / (room * sheet.em), 1, most)), steps=[1, 2, 2.5, 5, 10])


def in_powers(axis: Any, sheet: Sheet) -> None:
    """Label an axis by its values, or, where these are long, by theirs over a power of ten that stands at its end."""
    formatter = axis.get_major_formatter()
    formatter.set_useOffset(False)
    formatter.set_powerlimits((-3, 5))
    formatter.set_useMathText(True)
    axis.get_offset_text().set_fontsize(sheet.font - 1)


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
    """The place of a part of a figure with its labels, with `x0`, `x1`, `y0`, `y1`, `width` and `height`."""
    from matplotlib.transforms import Bbox

    box = artist.get_tightbbox(figure.canvas.get_renderer())
    return Bbox(box.get_points() / figure.dpi)


def picture_height(canvas: Canvas, sheet: Sheet, width: float, above: float) -> float:
    """Height of a figure in which the canvas has a width: as the sheet says, or as high as the body needs.

    `above` is the height of other parts.  It has room for the title of a colour bar, and two figures fit on a page.
    """
    if sheet.height is not None:
        return sheet.height
    wide, high = np.ptp(canvas.corners @ np.stack([canvas.right, canvas.up], axis=1), axis=0)
    needed = width * high / (wide or high or 1.0) + strip_height(canvas, sheet)
    highest = 0.75 * sheet.width
    return float(np.clip(needed, min(19.2 * sheet.em, highest), highest)) + above


def save(figure: Any, path: Path) -> None:
    """Write a figure, without the time, so that the same figure gives the same file.

    Letters of a .pdf are TrueType, which can be searched and edited; those of an .svg are shapes, which look alike everywhere.
    """
    from matplotlib import rc_context

    metadata = {
        ".pdf": {"CreationDate": None, "Creator": "scan3d"},
        ".svg": {"Date": None, "Creator": "scan3d"},
    }.get(path.suffix.lower(), {"Software": "scan3d"})
    # a .png is compressed in half the time of the default, to 5 % more bytes
    options = {"pil_kwargs": {"compress_level": 4}} if path.suffix.lower() == ".png" else {}
    with rc_context({"pdf.fonttype": 42, "svg.fonttype": "path", "svg.hashsalt": "scan3d"}):
        figure.savefig(path, dpi=figure.dpi, metadata=metadata, **options)
    if path.suffix.lower() == ".svg":  # browsers would drop pixels of images that they show smaller, and lines in them
        path.write_bytes(path.read_bytes().replace(b"image-rendering:crisp-edges;image-rendering:pixelated", b""))


@contextmanager
def own_style() -> Iterator[None]:
    """All that is drawn and saved within it has matplotlib's defaults, whatever the user's matplotlibrc says.

    Matplotlib does not log warnings, such as those on its font cache, to stderr.
    """
    log = logging.getLogger("matplotlib")
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        from matplotlib import rc_context, rcdefaults

        with rc_context():
            rcdefaults()
            yield
    finally:
        log.setLevel(before)
