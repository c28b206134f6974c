"""Real rods: bending stiffness, and the units (1) that make measured reactions dimensionless."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from scan3d.errors import InputError

# Young's moduli in Pa of the materials that whisker sensors are made of.
MODULI_PA = {"steel": 210e9, "nitinol": 75e9, "carbon": 120e9, "nylon": 3e9}
# Diameter of the rod that is taken by default, relative to its length: that of a 0.3 mm wire of 50 mm.  A thicker rod has
# larger forces for the same shape, a thinner one forces closer to a sensor's noise; contacts do not depend on it.
SLENDERNESS = 0.006
# Lengths, forces and moments below this, or above its inverse, in SI units, belong to no rod, and squares of them would not be
# numbers of a computer.
_SMALLEST_UNIT = 1e-100


@dataclass(frozen=True)
class Rod:
    """A straight cylindrical rod: its length in m and its bending stiffness EI in N·m²."""

    length_m: float
    bending_stiffness_Nm2: float
    diameter_m: float = 0.0
    """Of the rod; 0 where it is neglected.  The planar model does not need it."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.length_m) and self.length_m > 0):
            raise InputError(f"a rod needs a positive length in metres, got {self.length_m}")
        if not (math.isfinite(self.bending_stiffness_Nm2) and self.bending_stiffness_Nm2 > 0):
            raise InputError(f"a rod needs a positive bending stiffness in N·m², got {self.bending_stiffness_Nm2}")
        if not (math.isfinite(self.diameter_m) and 0 <= self.diameter_m < self.length_m):
            raise InputError(f"a rod needs a diameter in metres from 0 to less than its length, got {self.diameter_m}")
        if not all(_SMALLEST_UNIT < unit < 1 / _SMALLEST_UNIT for unit in (*self._units(), self.length_m)):
            raise InputError(
                f"a rod of {self.length_m:g} m with a bending stiffness of {self.bending_stiffness_Nm2:g} N·m² has reactions "
                "that are no numbers of a computer; check the units of its length and its stiffness"
            )

    def _units(self) -> tuple[float, float]:
        """The units (1) of force and moment; infinite where they are too large for a number."""
        try:
            return self.force_unit_N, self.moment_unit_Nm
        except (OverflowError, ZeroDivisionError):
            return math.inf, math.inf

    @property
    def force_unit_N(self) -> float:
        """EI/L² (1)."""
        return self.bending_stiffness_Nm2 / self.length_m**2

    @property
    def moment_unit_Nm(self) -> float:
        """EI/L (1)."""
        return self.bending_stiffness_Nm2 / self.length_m

    @classmethod
    def wire(cls, length_m: float, diameter_m: float, modulus_Pa: float) -> Rod:
        """A round wire, ``I = π d⁴ / 64``."""
        if not (0 < diameter_m < math.inf and 0 < modulus_Pa < math.inf):
            raise InputError(f"a wire needs a positive diameter and modulus, got {diameter_m} m and {modulus_Pa} Pa")
        try:
            return cls(length_m, modulus_Pa * math.pi * diameter_m**4 / 64, diameter_m)
        except OverflowError:
            raise InputError(f"a wire of {diameter_m:g} m is too thick for a number of a computer") from None

    @classmethod
    def of_length(cls, length_m: float) -> Rod:
        """The steel wire that is taken by default where only the length of the rod is known."""
        return cls.wire(length_m, SLENDERNESS * length_m, MODULI_PA["steel"])


def parse_rod(text: str) -> Rod | None:
    """The rod named by ``MATERIAL:DIAMETERxLENGTH`` in mm (``steel:0.3x50``), or None for ``auto``.

    Raises InputError for any other text.
    """
    if text == "auto":
        return None
    match = re.fullmatch(r"(\w+):([0-9.eE+-]+)x([0-9.eE+-]+)", text)
    try:
        if match and match[1] in MODULI_PA:
            return Rod.wire(float(match[3]) / 1000, float(match[2]) / 1000, MODULI_PA[match[1]])
    except ValueError as error:
        raise InputError(f"rod {text!r}: {error}") from None
    raise InputError(
        f"a rod is 'auto' or MATERIAL:DIAMETERxLENGTH in mm, such as steel:0.3x50, with a material of "
        f"{', '.join(MODULI_PA)}; got {text!r}"
    )
