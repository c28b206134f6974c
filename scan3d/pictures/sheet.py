"""Size, resolution and camera of a picture, as text and as numbers: ``85x60mm``, 300, ``top`` or ``300,25``.

No numerical library is imported, so that the command line can check these values at once.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from scan3d.choices import CAMERAS
from scan3d.errors import InputError

CHARTS = ("histogram", "forces")
"""Views that show no body: they have no camera, and need no renderer."""
WITH_OTHER = ("surface", "compare", "histogram")
"""Views that show the surface, and thereby another surface that it is compared with."""
# A picture is two columns of a paper wide, in inches, has letters of 12 points, and is sharp in print and on screens.
WIDTH, FONT, DPI = 7.0, 12.0, 200
# Graphics drivers stop at twice as many pixels along a side, which is what is rendered.
_MOST_PIXELS = 8192
_INCHES = {"mm": 1 / 25.4, "cm": 1 / 2.54, "in": 1.0, "pt": 1 / 72}
_NUMBER = r"(\d+\.?\d*|\.\d+)"
_SIZE = re.compile(rf"{_NUMBER}(?:\s*[x×]\s*{_NUMBER})?\s*(mm|cm|in|pt|px)")
# Azimuth and elevation of the named cameras in degrees, in the order of `CAMERAS`.
_ANGLES = (-90, 0), (90, 0), (180, 0), (0, 0), (-90, 90), (-90, -90), (-45, math.degrees(math.atan(math.sqrt(0.5))))
_NAMED = dict(zip(CAMERAS, _ANGLES, strict=True))


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
    """The sheet of a picture.

    size
        ``WIDTH`` or ``WIDTHxHEIGHT`` and a unit, mm, cm, in, pt or px: ``85mm``, ``85x60mm``, ``1200x900px``; by default
        7 inches wide, and as high as what is drawn needs.
    dpi
        pixels to the inch, from 50 to 2400; by default 200.
    camera
        one of `scan3d.choices.CAMERAS`, or ``AZIMUTH,ELEVATION`` of the camera in degrees; a comma and a factor after either of
        them zoom: ``top``, ``300,25``, ``300,25,1.5``.

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
    if max(wide, high) > _MOST_PIXELS:
        raise InputError(
            f"a picture has at most {_MOST_PIXELS} pixels along a side, and this one would have {max(wide, high)}; choose a "
            "smaller size or resolution"
        )
    return made


def _size(text: str, dpi: int) -> tuple[float, float | None]:
    """Width and height in inches."""
    match = _SIZE.fullmatch(str(text).strip().lower())
    if match is None:
        raise InputError(
            "the size of a picture is WIDTH or WIDTHxHEIGHT with a unit (mm, cm, in, pt or px), such as 85mm or 85x60mm, "
            f"got {text!r}"
        )
    inches = {**_INCHES, "px": 1 / dpi}[match[3]]
    width, height = (None if side is None else float(side) * inches for side in match.groups()[:2])
    assert width is not None
    sides_mm = [round(25.4 * side, 6) for side in (width, width if height is None else height)]
    if sides_mm[0] < 50 or sides_mm[1] < 35 or max(sides_mm) > 2540:
        at_dpi = f" at {dpi} dpi" if match[3] == "px" else ""
        raise InputError(f"a picture is at least 50 mm wide and 35 mm high, and at most 2540 mm, got {text!r}{at_dpi}")
    return width, height


def _camera(text: str) -> Camera:
    name, *rest = (part.strip() for part in str(text).split(","))
    try:
        numbers = [float(part) for part in rest]
        angles = _NAMED[name.lower()] if name.lower() in _NAMED else (float(name), numbers.pop(0))
        camera = Camera(*angles, *numbers)
    except (ValueError, TypeError, IndexError):  # not numbers, or too few or too many
        camera = Camera(math.nan, math.nan)
    if not (abs(camera.azimuth_deg) <= 360 and abs(camera.elevation_deg) <= 90 and 0.1 <= camera.zoom <= 100):
        raise InputError(
            f"a camera is {', '.join(CAMERAS)}, or AZIMUTH,ELEVATION in degrees (elevation from -90 to 90), such as 300,25, "
            f"and after either a comma and a zoom from 0.1 to 100, got {text!r}"
        )
    return camera
