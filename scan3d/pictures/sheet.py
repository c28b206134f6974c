"""Size, resolution and camera of a picture, as text and as numbers: ``85x60mm``, 300, ``top`` or ``300,25``.

No numerical library is imported, so that the command line can check these values at once.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from scan3d.choices import CAMERAS
from scan3d.errors import InputError
from scan3d.memory import check_memory

CHARTS = ("histogram", "forces")
"""Views that show no body: they have no camera, and need no renderer."""
WITH_OTHER = ("surface", "compare", "histogram")
"""Views that show the surface, and thereby another surface that it is compared with."""
# Figures have the width of two columns of a paper, in inches; letters of this size, in points, stay legible in one column.
WIDTH, FONT = 7.0, 12.0
# Height in inches from which they have room.
_HEIGHT = 3.2
# Letters of smaller pictures are in proportion, but not smaller than this, which journals ask for.
_SMALLEST_FONT = 8.0
# Pixels to the inch: 1400 pixels of width are sharp in print and on screens; more make larger files.
DPI = 200
# Lowest and highest resolution: below, letters can't be read; above, no printer resolves it.
_LOWEST_DPI, _HIGHEST_DPI = 50, 2400
# Smallest width and height in inches, 50 by 35 mm, below which letters take the place of the picture, and the largest side.
_SMALLEST, _LARGEST = (50 / 25.4, 35 / 25.4), 100.0
# Most pixels along a side: images are rendered up to twice as large, and graphics drivers stop at 16,384.
_MOST_PIXELS = 8192
# Images are rendered this many times larger and averaged, so that edges are smooth on any renderer.  Time and memory grow with
# its square.  From this resolution on single pixels are no longer seen, and they are rendered as they are.
_SUPERSAMPLING, _FINE_DPI = 2, 600
# Bytes of memory for each rendered pixel, with depth and copies, and for each pixel of the picture.
_BYTES = (24, 24)
_INCHES = {"mm": 1 / 25.4, "cm": 1 / 2.54, "in": 1.0, "pt": 1 / 72}
_NUMBER = r"(\d+\.?\d*|\.\d+)"
_SIZE = re.compile(rf"{_NUMBER}(?:\s*[x×]\s*{_NUMBER})?\s*(mm|cm|in|pt|px)")
# Azimuth and elevation of named cameras in degrees.
_NAMED = dict(
    zip(
        CAMERAS,
        ((-90, 0), (90, 0), (180, 0), (0, 0), (-90, 90), (-90, -90), (-45, math.degrees(math.atan(math.sqrt(0.5))))),
        strict=True,
    )
)
_LARGEST_AZIMUTH, _SMALLEST_ZOOM, _LARGEST_ZOOM = 360.0, 0.1, 100.0


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
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        return (
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        )

    @property
    def up(self) -> tuple[float, float, float]:
        """Unit vector up in the picture; from the top, with the azimuth of the front, y is up."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        return (
            -math.sin(elevation) * math.cos(azimuth),
            -math.sin(elevation) * math.sin(azimuth),
            math.cos(elevation),
        )


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
        """Size of letters in points."""
        part = self.width / WIDTH if self.height is None else min(self.width / WIDTH, self.height / _HEIGHT)
        return min(FONT, max(_SMALLEST_FONT, FONT * part))

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
        """How many times larger images are rendered before they are averaged."""
        return 1 if self.dpi >= _FINE_DPI else _SUPERSAMPLING


def sheet(size: str | None = None, dpi: int | str | None = None, camera: str | None = None) -> Sheet:
    """The sheet of a picture.

    size
        ``WIDTH`` or ``WIDTHxHEIGHT`` and a unit, mm, cm, in, pt or px: ``85mm``, ``85x60mm``, ``1200x900px``; by default
        7 inches wide, and as high as what is drawn needs.
    dpi
        pixels to the inch, from 50 to 2400; by default 200.
    camera
        one of `scan3d.choices.CAMERAS`, or ``AZIMUTH,ELEVATION`` of the camera in degrees; a comma and a factor after either of
        them zoom: ``top``, ``300,25``, ``300,25,1.5``.

    Raises InputError for other values.
    """
    dots = DPI if dpi is None else _dpi(dpi)
    width, height = (WIDTH, None) if size is None else _size(size, dots)
    made = Sheet(width, height, dots, None if camera is None else _camera(camera))
    _check_pixels(made)
    return made


def _dpi(dpi: int | str) -> int:
    try:
        dots = int(dpi) if float(dpi).is_integer() else 0
    except (ValueError, TypeError, OverflowError):
        dots = 0
    if not _LOWEST_DPI <= dots <= _HIGHEST_DPI:
        raise InputError(
            f"the resolution of a picture is a whole number of dots per inch from {_LOWEST_DPI} to {_HIGHEST_DPI}, "
            f"such as 300, got {dpi!r}"
        )
    return dots


def _size(text: str, dpi: int) -> tuple[float, float | None]:
    """Width and height in inches."""
    match = _SIZE.fullmatch(str(text).strip().lower())
    if match is None:
        raise InputError(
            "the size of a picture is WIDTH or WIDTHxHEIGHT with a unit (mm, cm, in, pt or px), such as 85mm or 85x60mm, "
            f"got {text!r}"
        )
    inches = {**_INCHES, "px": 1 / dpi}[match[3]]
    sides = [float(side) * inches for side in match.groups()[:2] if side is not None]
    if any(side < smallest for side, smallest in zip(sides, _SMALLEST, strict=False)) or max(sides) > _LARGEST:
        at_dpi = f" at {dpi} dpi" if match[3] == "px" else ""
        raise InputError(
            f"a picture is at least {_SMALLEST[0] * 25.4:.0f} mm wide and {_SMALLEST[1] * 25.4:.0f} mm high, and at most "
            f"{_LARGEST * 25.4:.0f} mm, got {text!r}{at_dpi}"
        )
    return sides[0], sides[1] if len(sides) > 1 else None


def _camera(text: str) -> Camera:
    name, *rest = (part.strip() for part in str(text).split(","))
    try:
        numbers = [float(part) for part in rest]
        if name.lower() in _NAMED:
            camera = Camera(*_NAMED[name.lower()], *numbers)
        else:
            azimuth, elevation, *zoom = [float(name), *numbers]
            camera = Camera(azimuth, elevation, *zoom)
    except (ValueError, TypeError):  # not numbers, or too few or too many
        camera = Camera(math.nan, math.nan)
    if not (
        abs(camera.azimuth_deg) <= _LARGEST_AZIMUTH
        and abs(camera.elevation_deg) <= 90
        and _SMALLEST_ZOOM <= camera.zoom <= _LARGEST_ZOOM
    ):
        raise InputError(
            f"a camera is {', '.join(CAMERAS)}, or AZIMUTH,ELEVATION in degrees (elevation from -90 to 90), such as 300,25, "
            f"and after either a comma and a zoom from {_SMALLEST_ZOOM:g} to {_LARGEST_ZOOM:g}, got {text!r}"
        )
    return camera


def _check_pixels(made: Sheet) -> None:
    """Raises InputError for a picture that can't be rendered."""
    width, height = (round(side * made.dpi) for side in (made.width, made.height or 0.75 * made.width))
    if max(width, height) > _MOST_PIXELS:
        raise InputError(
            f"a picture has at most {_MOST_PIXELS} pixels along a side, and this one would have {max(width, height)}; choose a "
            "smaller size or resolution"
        )
    rendered, drawn = _BYTES
    check_memory(
        width * height * (rendered * made.sampling**2 + drawn),
        f"a picture of {width} x {height} pixels",
        "choose a smaller size or resolution",
    )
