"""Units: of the lengths of meshes, clouds and surfaces, and of what a laboratory measures.

Numbers for people: the rule by which the terminal, the words of a report, pages, pictures and notebooks write them.  A length
is written in the unit, nm, µm, mm or m, in which it is between 1 and 1000 (inches stay inches), forces and moments likewise;
what is below a nanometre, the size of a few atoms, is no length of a body, and is said to be.  A value with an uncertainty has
the digits that the uncertainty leaves (M. Tanabashi et al., Review of Particle Physics, Phys. Rev. D 98, 030001, 2018, section
5.3), and bounds are rounded away from what they bound, so that what is written holds as well.  Files hold all digits.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Decimal
from numbers import Real
from typing import Any, Literal

from scan3d.errors import InputError

Unit = Literal["m", "cm", "mm", "um", "in"]
UNITS_M: dict[str, float] = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
"""Length of each unit in metres, by its symbol."""


def unit_of(mesh: Any, given: str | None) -> str:
    """The unit of a `trimesh.Trimesh`: the given one, or that which the mesh states, or mm."""
    return given or (mesh.units if mesh.units in UNITS_M else "mm")


def check_unit(unit: str | None) -> None:
    """Raise InputError for what is no unit of length; None stands for none."""
    if unit not in (None, *UNITS_M):
        raise InputError(f"unit must be one of {', '.join(UNITS_M)}, got {unit!r}")


def unit_remark(
    extents: Iterable[float], others: Iterable[float], names: tuple[str, str] = ("first", "second")
) -> str | None:
    """A sentence on two bodies whose sizes have within 5 % the ratio of two units; None for others."""
    first, second = math.hypot(*extents), math.hypot(*others)
    if not (0 < first < math.inf and 0 < second < math.inf):
        return None
    ratio = max(first, second) / min(first, second)
    # those that are taken for one another, the longer one first, the likeliest pairs first
    for longer, shorter in (("m", "mm"), ("in", "mm"), ("cm", "mm"), ("m", "in"), ("m", "cm"), ("in", "cm")):
        factor = UNITS_M[longer] / UNITS_M[shorter]
        if abs(ratio / factor - 1) < 0.05:
            large, small = names if first > second else names[::-1]
            return (
                f"the {large} is {ratio:.4g} times as large as the {small}, as if the {large} were in {shorter} and "
                f"the {small} in {longer}; check their units"
            )
    return None


def unit_question(size: float, unit: str) -> str | None:
    """A question on a body of less than 1 mm or more than 5 m that in another unit has 5 mm to 1 m; None for others."""
    if 1e-3 <= size * UNITS_M[unit] <= 5:
        return None
    meant = next((other for other in ("m", "mm", "in", "cm", "um") if 5e-3 <= size * UNITS_M[other] <= 1), None)
    return None if meant is None else f"the body measures {size:.3g} {unit_symbol(unit)}; did you mean --unit {meant}?"


def unit_symbol(unit: str) -> str:
    """The symbol of a unit as it is printed."""
    return unit.replace("um", "µm")


_STANDARD_GRAVITY = 9.80665
_POUND = 0.45359237 * _STANDARD_GRAVITY
FACTORS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "length": {**UNITS_M, "ft": 0.3048},
    "angle": {"rad": 1.0, "deg": math.pi / 180, "mrad": 1e-3},
    "force": {
        "N": 1.0, "mN": 1e-3, "uN": 1e-6, "kN": 1e3, "gf": 1e-3 * _STANDARD_GRAVITY, "kgf": _STANDARD_GRAVITY,
        "ozf": _POUND / 16, "lbf": _POUND, "klbf": 1e3 * _POUND,
    },
    "moment": {
        "N m": 1.0, "N cm": 1e-2, "N mm": 1e-3, "N um": 1e-6, "mN m": 1e-3, "mN mm": 1e-6, "uN m": 1e-6, "uN mm": 1e-9,
        "kN m": 1e3, "gf cm": 1e-5 * _STANDARD_GRAVITY, "kgf cm": 1e-2 * _STANDARD_GRAVITY, "kgf m": _STANDARD_GRAVITY,
        "ozf in": 0.0254 * _POUND / 16, "lbf in": 0.0254 * _POUND, "lbf ft": 0.3048 * _POUND,
    },
}  # fmt: skip
"""Each measured quantity's units by their symbols, and what they are in s, m, rad, N and N m."""
_SPELLINGS = {
    "°": "deg", "degrees": "deg", "degree": "deg", "radians": "rad", "sec": "s", "inch": "in", "inches": "in",
    "lb": "lbf", "lbs": "lbf", "klb": "klbf",
}  # fmt: skip
# A unit at the end of a column's name: in brackets, after "in" or after an underscore, with a second word or alone.
_AT_END = (
    re.compile(r"[\[(]([^\])]+)[\])]\s*$"), re.compile(r"\bin ([\wµμ°·. ]+)$"),
    re.compile(r"_([A-Za-zµμ]+_[A-Za-z]+)$"), re.compile(r"_([A-Za-zµμ]+)$"),
)  # fmt: skip


def spelled(unit: str, quantity: str) -> str | None:
    """A unit in the spelling of `FACTORS`, whose words may change places; None if it is not one of the quantity's units."""
    words = [word for word in re.split(r"[\s·*.⋅_-]", re.sub("[µμ]", "u", unit)) if word]
    words = [_SPELLINGS.get(word.lower(), word) if word not in FACTORS[quantity] else word for word in words]
    for name in FACTORS[quantity]:
        own = name.split()
        # "m N" is no millinewton: what is written apart is not joined, but "mNmm" is two words
        joined = "".join(own) == "".join(words) and (len(words) == 1 or len(own) > 1)
        if joined or sorted(own) == sorted(words):
            return name
    return None


def unit_of_cell(text: str) -> tuple[str, str] | None:
    """The quantity and the unit of a cell in a row of units, such as ``mm`` or ``[N]``; None if it is not a unit."""
    bare = text.strip().strip("[]()").strip()
    found = ((quantity, spelled(bare, quantity)) for quantity in FACTORS) if bare else ()
    return next(((quantity, unit) for quantity, unit in found if unit is not None), None)


def stated_unit(name: str) -> tuple[str, str] | None:
    """The quantity and the unit that a column's name states at its end, such as ``x_mm``, ``Fx [N]`` or ``Tz in N mm``."""
    matches = (pattern.search(name) for pattern in _AT_END)
    return next((unit for match in matches if match and (unit := unit_of_cell(match[1])) is not None), None)


def without_unit(name: str) -> str:
    """A column's name without brackets and without the unit at its end."""
    text = re.sub(r"[\[(].*?[\])]", "", name)
    for pattern in _AT_END[1:]:
        text = pattern.sub(lambda match: "" if unit_of_cell(match[1]) else match[0], text)
    return text


_SIZES = tuple(map(Decimal, ("1", "1e-3", "1e-6", "1e-9")))
UNITS = dict(zip(("m", "mm", "µm", "nm"), _SIZES, strict=True))
"""The units in which lengths are written, in metres, from the largest to the smallest."""
FORCES = dict(zip(("N", "mN", "µN", "nN"), _SIZES, strict=True))
"""The units in which forces are written, in N."""
MOMENTS = dict(zip(("N m", "N mm", "mN mm", "µN mm"), _SIZES, strict=True))
"""The units in which moments are written, in N m."""
# Digits of a value without an uncertainty, and the most of one with an uncertainty that is rounding.
_DIGITS, _MOST_DIGITS = 3, 7


def is_finite(value: object) -> bool:
    """Whether it is one real number, of Python or numpy, and finite; a whole number may be too large for a float."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:
        return False


def number(value: float, digits: int = _DIGITS) -> str:
    """A number with so many significant digits, the thousands of large ones apart: ``0.305``, ``51,400``, ``8.5e-05``."""
    return _written(_decimal(value), digits)


def length(value: float, unit: str, *, digits: int = _DIGITS, up: bool = False) -> str:
    """A length, given in `unit`, with its unit: ``3.33 µm``; rounded up if it is a bound."""
    metres = _decimal(value) * Decimal(str(UNITS_M[unit]))
    if not metres.is_finite():
        return "unknown"
    if abs(metres) < UNITS["nm"]:
        return "under 1 nm" if metres else f"0 {unit_for(0.0, unit)[0]}"
    symbol, size = unit_for(abs(float(metres)) / UNITS_M[unit], unit)
    return f"{_written(metres / size, digits, up)} {symbol}"


def lengths(values: Iterable[float], unit: str, *, digits: int = 4) -> tuple[list[str], str]:
    """Lengths that belong together, as numbers with the decimals of the largest in one unit, and that unit."""
    metres = [_decimal(value) * Decimal(str(UNITS_M[unit])) for value in values]
    largest = max((abs(value) for value in metres), default=Decimal(0))
    symbol, size = unit_for(float(largest) / UNITS_M[unit], unit)
    return _alike(metres, max(largest, UNITS["nm"]), size, digits), symbol


def point(values: Iterable[float], unit: str) -> str:
    """A place whose coordinates are given in `unit`: ``(12.5, 0, -3.1) mm``."""
    shown, symbol = lengths(values, unit)
    return f"({', '.join(shown)}) {symbol}"


def force(*newtons: float, digits: int = _DIGITS, up: bool = False) -> str:
    """A force with its unit, ``19.2 mN``, or its components, ``(19.2, 0, -3.1) mN``; rounded up if it is a limit."""
    return _reaction(newtons, FORCES, digits, up)


def moment(*newton_metres: float, digits: int = _DIGITS, up: bool = False) -> str:
    """A moment with its unit, ``1.32 N mm``, as `force`."""
    return _reaction(newton_metres, MOMENTS, digits, up)


def reaction_unit(largest: float, units: dict[str, Decimal]) -> tuple[str, Decimal]:
    """The one of the units of forces or moments in which those up to one in N or N m are written, and its size."""
    sizes = list(units.items())
    return next((pair for pair in sizes if largest >= pair[1]), sizes[-1 if largest else 0])


def _reaction(values: tuple[float, ...], units: dict[str, Decimal], digits: int, up: bool) -> str:
    given = [_decimal(value) for value in values]
    largest = max(map(abs, given))
    if not all(value.is_finite() for value in given):
        return "unknown"
    least, smallest = next(reversed(units.items()))
    if largest < smallest and largest:
        return f"under 1 {least}"
    symbol, size = reaction_unit(float(largest), units)
    if len(given) == 1:
        return f"{_written(given[0] / size, digits, up)} {symbol}"
    return f"({', '.join(_alike(given, largest, size, digits))}) {symbol}"


def unit_for(largest: float, unit: str) -> tuple[str, Decimal]:
    """The unit in which lengths up to one given in `unit` are written, and what it is in metres."""
    if unit == "in":
        return unit, Decimal(str(UNITS_M[unit]))
    metres = Decimal(str(UNITS_M[unit])) * _decimal(largest)
    if not metres.is_finite() or metres < UNITS["nm"]:
        return "mm", UNITS["mm"]
    return next((symbol, size) for symbol, size in UNITS.items() if metres >= size)


def volume(value: float, low: float, high: float, unit: str) -> str:
    """An interval that contains the volume of the body, given in `unit` cubed: ``13,190 ± 4 mm³``; or ``94 to 990 mm³``."""
    symbol, size = unit_for(2 * abs(value) ** (1 / 3), unit)  # not 0.5 mm³ in µm³
    factor = (Decimal(str(UNITS_M[unit])) / size) ** 3
    given, below, above = (factor * _decimal(part) for part in (value, low, high))
    if above.is_finite() and above > 2 * given:  # ± would reach below nothing
        place = _exponent(above) - 1
        return f"{_rounded(below, place, ROUND_FLOOR):,f} to {_rounded(above, place, ROUND_CEILING):,f} {symbol}³"
    return f"{plus_minus(float(given), float(below), float(above))} {symbol}³"


def plus_minus(value: float, low: float, high: float) -> str:
    """A value with what it may be off: ``0.012 ± 0.034``.  The interval that is written contains that from `low` to `high`."""
    given, below, above = _decimal(value), _decimal(low), _decimal(high)
    off = max(above - given, given - below)
    if not off.is_finite():
        return f"{number(value)} ± unknown"
    if off <= 0:
        return number(value, _MOST_DIGITS)
    exponent = _exponent(off)
    place = exponent - 1 if off.scaleb(-exponent) < Decimal("3.55") else exponent
    place = max(place, _exponent(max(abs(given), off)) - _MOST_DIGITS + 1)
    middle = _rounded(given, place)
    return f"{middle:,f} ± {_rounded(max(above - middle, middle - below), place, ROUND_CEILING):,f}"


def angle(degrees: float) -> str:
    """An angle in degrees: ``0.302°``; what is below 0.0001°, a third of an arc second, is rounding of the vertices."""
    return f"{number(degrees)}°" if not 0 < abs(degrees) < 1e-4 else "under 0.0001°"


def share(value: float, *, up: bool = False) -> str:
    """A part of a whole in per cent, or below 0.01 % in parts per million: ``0.26 %``, ``54 ppm``."""
    if abs(value) < 1e-9:
        return "under 0.001 ppm" if value else "0 %"
    factor, symbol = (100, "%") if abs(value) >= 1e-4 else (1_000_000, "ppm")
    return f"{_written(factor * _decimal(value), 2, up)} {symbol}"


def _decimal(value: float) -> Decimal:
    return Decimal(float(value))


def _exponent(value: Decimal) -> int:
    """Of the leading digit; 0 for zero."""
    return value.adjusted() if value else 0


def _alike(values: list[Decimal], largest: Decimal, size: Decimal, digits: int) -> list[str]:
    """Values over `size`, with the decimals that the largest of them has with so many digits."""
    place = _exponent(largest / size) - digits + 1
    return [_plain(_rounded(value / size, place)).removesuffix(".") for value in values]


def _rounded(value: Decimal, place: int, rounding: str = ROUND_HALF_EVEN) -> Decimal:
    return value.quantize(Decimal(1).scaleb(place), rounding)


def _written(value: Decimal, digits: int, up: bool = False) -> str:
    """A number with so many significant digits, rounded to the nearest or up, without zeros at the end of its decimals."""
    if not value.is_finite():
        return f"{value}".lower().replace("infinity", "infinite")
    exponent = _exponent(value)
    rounded = _rounded(value, exponent - digits + 1, ROUND_CEILING if up else ROUND_HALF_EVEN)
    if -4 <= exponent < 9:
        return _plain(rounded)
    mantissa = _plain(rounded.scaleb(-exponent))
    return f"{mantissa}e{exponent:+03d}"


def _plain(value: Decimal) -> str:
    text = f"{value:,f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text == "-0" else text
