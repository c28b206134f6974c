"""Units of measured quantities, and the units that the names of a table's columns state."""

from __future__ import annotations

import math
import re

from scan3d.errors import InputError
from scan3d.files.reading import did_you_mean
from scan3d.units import UNITS_M

_STANDARD_GRAVITY = 9.80665
FACTORS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "length": UNITS_M,
    "angle": {"rad": 1.0, "deg": math.pi / 180, "mrad": 1e-3},
    "force": {"N": 1.0, "mN": 1e-3, "uN": 1e-6, "kN": 1e3, "gf": 1e-3 * _STANDARD_GRAVITY},
    "moment": {
        "N m": 1.0, "N cm": 1e-2, "N mm": 1e-3, "N um": 1e-6, "mN m": 1e-3, "mN mm": 1e-6, "uN m": 1e-6, "uN mm": 1e-9,
        "kN m": 1e3,
    },
}  # fmt: skip
"""Each quantity's units by their symbols, and what they are in s, m, rad, N and N m."""
_SPELLINGS = {"µ": "u", "μ": "u", "°": "deg", "degrees": "deg", "degree": "deg", "radians": "rad", "sec": "s"}
# A unit at the end of a column's name: in brackets, after "in" or after an underscore.
_BRACKETS = re.compile(r"[\[(]([^\])]+)[\])]\s*$")
_AFTER_IN = re.compile(r"\bin ([\wµμ°·. ]+)$")
_SUFFIX = re.compile(r"_([A-Za-zµμ]+)$")


def spelled(unit: str, quantity: str) -> str | None:
    """A unit in the spelling of `FACTORS`; None if it is not one of the quantity's units."""
    text = unit.strip()
    for other, usual in _SPELLINGS.items():
        text = text.replace(other, usual) if len(other) == 1 else (usual if text.lower() == other else text)
    if text in FACTORS[quantity]:
        return text
    compact = re.sub(r"[\s·*.⋅]", "", text)
    return next((name for name in FACTORS[quantity] if name.replace(" ", "") == compact), None)


def factor(unit: str, quantity: str, where: str) -> float:
    """What a unit is in SI units.  Raises InputError with the known units if it is not one of the quantity's."""
    name = spelled(unit, quantity)
    if name is None:
        known = FACTORS[quantity]
        raise InputError(
            f"{where} must be a unit of {quantity}: {', '.join(known)}; got {unit!r}{did_you_mean([unit], known)}"
        )
    return FACTORS[quantity][name]


def stated_unit(name: str) -> tuple[str, str] | None:
    """The quantity and the unit that a column's name states at its end, such as ``x_mm``, ``Fx [N]`` or ``Tz in N mm``."""
    for pattern in (_BRACKETS, _AFTER_IN, _SUFFIX):
        match = pattern.search(name)
        for quantity in FACTORS if match else ():
            assert match is not None
            unit = spelled(match[1], quantity)
            if unit is not None:
                return quantity, unit
    return None


def unit_of_cell(text: str) -> tuple[str, str] | None:
    """The quantity and the unit of a cell in a row of units, such as ``mm`` or ``[N]``; None if it is not a unit."""
    bare = text.strip().strip("[]()").strip()
    found = ((quantity, spelled(bare, quantity)) for quantity in FACTORS) if bare else ()
    return next(((quantity, unit) for quantity, unit in found if unit is not None), None)
