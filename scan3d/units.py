"""Units: of the lengths of meshes, clouds and surfaces, and of what a laboratory measures."""

import math
import re
from collections.abc import Iterable
from typing import Any, Literal

Unit = Literal["m", "cm", "mm", "um", "in"]
UNITS_M: dict[str, float] = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
"""Length of each unit in metres, by its symbol."""


def unit_of(mesh: Any, given: str | None) -> str:
    """The unit of a `trimesh.Trimesh`: the given one, or that which the mesh states, or mm."""
    return given or (mesh.units if mesh.units in UNITS_M else "mm")


# Units that are taken for one another, the longer one first, the likeliest pairs first.
_CONFUSED = (("m", "mm"), ("in", "mm"), ("cm", "mm"), ("m", "in"), ("m", "cm"), ("in", "cm"))


def unit_remark(
    extents: Iterable[float], others: Iterable[float], names: tuple[str, str] = ("first", "second")
) -> str | None:
    """A sentence on two bodies whose sizes have within 5 % the ratio of two units; None for others."""
    first, second = math.hypot(*extents), math.hypot(*others)
    if not (0 < first < math.inf and 0 < second < math.inf):
        return None
    ratio = max(first, second) / min(first, second)
    for longer, shorter in _CONFUSED:
        factor = UNITS_M[longer] / UNITS_M[shorter]
        if abs(ratio / factor - 1) < 0.05:
            large, small = names if first > second else names[::-1]
            return (
                f"the {large} is {ratio:.4g} times as large as the {small}, as if the {large} were in {shorter} and the "
                f"{small} in {longer}; check their units"
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
    known = ((name, name.split()) for name in FACTORS[quantity])
    return next((name for name, own in known if sorted(own) == sorted(words) or "".join(own) == "".join(words)), None)


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
