"""Real rods: bending stiffness, and the units (1) that make measured reactions dimensionless."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from numbers import Real
from typing import TYPE_CHECKING, Any

from scan3d.errors import InputError

if TYPE_CHECKING:  # settings have rods, and help must not wait for numpy
    import planar
    from planar.rods import Profile
    from scan3d.arrays import Array
    from scan3d.spatial.march import SpatialRod

# Young's moduli in Pa of the materials that whisker sensors are made of.
MODULI_PA = {"steel": 210e9, "nitinol": 75e9, "carbon": 120e9, "nylon": 3e9}
# Diameter of the rod that is taken by default, relative to its length: that of a 0.3 mm wire of 50 mm.  A thicker rod has
# larger forces for the same shape, a thinner one forces closer to a sensor's noise; contacts do not depend on it.
SLENDERNESS = 0.006


Table = tuple[tuple[float, float], ...]


@dataclass(frozen=True, repr=False)
class Rod:
    """A rod: by length and bending stiffness alone a straight, uniform, weightless one in a rigid clamp.

    Stiffness and diameter are numbers or tables ``((s_m, value), ...)`` from the clamp, ``s_m = 0``, to the tip.  Tables are
    kept in `stiffness_table` and `diameter_table`, and the field itself is the value at the clamp.  Between the rows the
    diameter of a round rod is linear.  Raises InputError for numbers that belong to no rod or contradict each other.
    """

    length_m: float
    bending_stiffness_Nm2: float
    """EI at the clamp."""
    diameter_m: float = 0.0
    """At the clamp; 0 where it is neglected."""
    tip_diameter_m: float | None = None
    """Of a cone."""
    curvature_per_m: float | tuple[float, float, float] = 0.0
    """Of the free rod, about the clamp's z axis; or three numbers, about z, about x and the twist about y, carried along it."""
    weight_N: float = 0.0
    """Of the whole rod, spread as the square of the diameter."""
    clamp_compliance_rad_per_Nm: float = 0.0
    """Angle by which the clamp gives per moment."""
    bead_diameter_m: float = 0.0
    """Of a ball about the tip's centre, with which a rod that moves along itself touches; 0 for none."""
    stiffness_table: Table = ()
    diameter_table: Table = ()

    def __post_init__(self) -> None:
        if not (_is_number(self.length_m) and math.isfinite(self.length_m) and self.length_m > 0):
            raise InputError(f"a rod needs a positive length in metres, got {self.length_m}")
        for name, kept in (("bending_stiffness_Nm2", "stiffness_table"), ("diameter_m", "diameter_table")):
            given = getattr(self, name)
            if not _is_number(given):
                object.__setattr__(self, kept, self._checked_table(name, given))
                object.__setattr__(self, name, getattr(self, kept)[0][1])
        if not (math.isfinite(self.bending_stiffness_Nm2) and self.bending_stiffness_Nm2 > 0):
            raise InputError(f"a rod needs a positive bending stiffness in N·m², got {self.bending_stiffness_Nm2}")
        if not (math.isfinite(self.diameter_m) and 0 <= self.diameter_m < self.length_m):
            raise InputError(
                f"a rod's diameter is from 0 to less than its length, got {self.diameter_m:g} m and {self.length_m:g} m"
            )
        # squares of others would not be numbers of a computer
        if not all(1e-100 < unit < 1e100 for unit in (*self._units(), self.length_m)):
            raise InputError(
                f"a rod of {self.length_m:g} m with a bending stiffness of {self.bending_stiffness_Nm2:g} N·m² has "
                "reactions that are no numbers of a computer; check the units of its length and its stiffness"
            )
        tip = self.tip_diameter_m
        if tip is not None and not (_is_number(tip) and 0 < tip < self.length_m):
            raise InputError(f"a rod needs a tip_diameter_m in metres above 0 and below its length, got {tip}")
        if tip is not None and not self.diameter_m > 0:
            raise InputError("a rod with a tip_diameter_m needs the diameter_m at its clamp")
        if (tip is not None) + bool(self.stiffness_table) + bool(self.diameter_table) > 1:
            raise InputError(
                "a rod has one of tip_diameter_m, a table of bending_stiffness_Nm2 and a table of diameter_m, got "
                "several"
            )
        curvature = self.curvature_per_m
        if not _is_number(curvature):
            given = _plain(curvature)
            given = tuple(given) if isinstance(given, Sequence) else ()
            if len(given) != 3:
                raise InputError(f"a rod's curvature_per_m is a number or three, got {curvature!r}")
            object.__setattr__(self, "curvature_per_m", given)
        if not all(_is_number(part) and math.isfinite(part) for part in self.curvatures):
            raise InputError(f"a rod's curvature_per_m must be finite, got {curvature!r}")
        for name in ("weight_N", "clamp_compliance_rad_per_Nm", "bead_diameter_m"):
            value = getattr(self, name)
            if not (_is_number(value) and 0 <= value < math.inf):
                raise InputError(f"a rod needs a {name} of at least 0, got {value!r}")
        if self.bead_diameter_m and (self.weight_N or any(self.curvatures)):
            raise InputError(
                "a rod with a bead_diameter_m is straight and without weight: where the bead of another has been is not known; "
                "leave one of them out"
            )
        thickest = self.diameter_m * max(self.profile.diameters)
        if self.bead_diameter_m and not thickest <= self.bead_diameter_m < self.length_m:
            raise InputError(
                f"a rod's bead_diameter_m is at least its diameter, {thickest:g} m, so that the rod passes where the bead "
                f"has passed, and less than its length, {self.length_m:g} m; got {self.bead_diameter_m:g}"
            )

    def _checked_table(self, name: str, given: object) -> Table:
        """Rows of places in m from clamp to tip and positive values."""
        given = _plain(given)
        rows = tuple(given) if isinstance(given, Sequence) and not isinstance(given, str) else ()
        if len(rows) < 2 or not all(isinstance(row, Sequence) and len(row) == 2 for row in rows):
            raise InputError(f"a rod's {name} is a number or a table of at least two rows [s_m, value], got {given!r}")
        if not all(_is_number(value) and math.isfinite(value) for row in rows for value in row):
            raise InputError(f"a rod's table {name} must hold numbers, got {given!r}")
        places = [row[0] for row in rows]
        ends = places[0] == 0 and math.isclose(places[-1], self.length_m, rel_tol=1e-9)
        if not (ends and all(a < b for a, b in pairwise(places))):
            raise InputError(
                f"places in the table {name} must rise from 0 to the rod's length {self.length_m:g} m, got {places}"
            )
        if not all(row[1] > 0 for row in rows):
            raise InputError(f"values in the table {name} must be positive, got {[row[1] for row in rows]}")
        return tuple((float(s), float(value)) for s, value in rows)

    @property
    def curvatures(self) -> tuple[float, float, float]:
        """Curvature of the free rod about z and x and its twist about y, in 1/m."""
        given = self.curvature_per_m
        return given if isinstance(given, tuple) else (given, 0.0, 0.0)

    @property
    def is_simple(self) -> bool:
        """Whether it is straight, uniform, weightless and rigidly clamped."""
        return not (any(self.curvatures) or self.weight_N or self.clamp_compliance_rad_per_Nm or self.varies)

    @property
    def varies(self) -> bool:
        """Whether the stiffness changes along the rod."""
        return len(set(self.profile.diameters)) > 1

    @property
    def tapered(self) -> bool:
        """Whether its surface is at different distances from its centre line."""
        return self.diameter_m > 0 and self.varies

    def radius_m(self, s: Array) -> Array:
        """(n,) radii at arc lengths (n,) in rod lengths; outside of the rod those of its ends."""
        return self.diameter_m / 2 * self.profile.diameter(s)

    @property
    def profile(self) -> Profile:
        """Diameter and weight along the rod in the units (1)."""
        from planar.rods import Profile

        weight = self.weight_N / self.force_unit_N
        if self.stiffness_table:
            rows, power = self.stiffness_table, 0.25
        elif self.diameter_table:
            rows, power = self.diameter_table, 1.0
        else:
            tip = self.diameter_m if self.tip_diameter_m is None else self.tip_diameter_m
            rows, power = ((0.0, self.diameter_m or 1.0), (self.length_m, tip or 1.0)), 1.0
        knots = (*(s / self.length_m for s, _ in rows[:-1]), 1.0)
        return Profile(knots, tuple((value / rows[0][1]) ** power for _, value in rows), weight)

    def without_thickness(self) -> Rod:
        """The rod that bends as this one, and touches with its centre line."""
        if not self.diameter_m:
            return self
        rows = zip(self.profile.knots, self.profile.diameters, strict=True)
        table = tuple((self.length_m * s, self.bending_stiffness_Nm2 * d**4) for s, d in rows) if self.varies else ()
        return replace(self, diameter_m=0.0, diameter_table=(), tip_diameter_m=None, stiffness_table=table)

    def in_plane(self, down: Array | None = None, sag: float = 0.0) -> planar.Rod:
        """The rod of `planar`, in the units (1).

        down
            (3,) or (n, 3) unit vectors of gravity in the clamp's frame; needed with a weight.
        sag
            deflection of the free tip out of the plane, in rod lengths, that counts as rounding.

        Raises InputError if the rod does not stay in the plane of a sweep.
        """
        import planar

        weight = self.profile.weight
        if weight and down is None:
            raise InputError("a rod with weight needs gravity in the frame of its clamp, which only a recording knows")
        if weight and self._sag() * float(abs(down[..., 2]).max()) > sag + planar.TOLERANCE:  # type: ignore[index]
            raise InputError(
                "the rod's weight bends it out of the plane of its sweep, because gravity does not lie in that plane: "
                "sweep in planes that contain gravity, or measure six axes for the spatial model"
            )
        about, *out_of_plane = self.curvatures
        if any(out_of_plane):
            raise InputError(
                "a rod curved out of its clamp's xy plane needs the spatial model: a recording of six axes"
            )
        profile = self.profile
        stiffness = [(s, d**4) for s, d in zip(profile.knots, profile.diameters, strict=True)]
        return planar.Rod(
            stiffness=stiffness if self.varies else None,
            curvature=about * self.length_m,
            weight=weight,
            gravity=down[..., :2] if weight and down is not None else None,
            compliance=self.clamp_compliance_rad_per_Nm * self.moment_unit_Nm,
        )

    def _sag(self) -> float:
        """Deflection of the tip of the rod as a cantilever under its weight, in rod lengths: W/8 of a uniform one."""
        import numpy as np
        from scipy.integrate import cumulative_trapezoid

        s = np.linspace(0.0, 1.0, 1001)
        lever = cumulative_trapezoid((1 - s) / self.profile.bending_stiffness(s), s, initial=0)
        return float(np.trapezoid(self.profile.weight_past(s) * lever, s))

    def in_space(self) -> SpatialRod:
        """The rod of the spatial model, in the units (1)."""
        from scan3d.spatial.march import SpatialRod

        bend_z, bend_x, twist = (self.length_m * part for part in self.curvatures)
        compliance = self.clamp_compliance_rad_per_Nm * self.moment_unit_Nm
        return SpatialRod(self.profile, (bend_z, bend_x, twist), compliance=compliance)

    def stated(self) -> dict[str, Any]:
        """Its fields that are not as for a straight, uniform, weightless rod without thickness."""
        given = ((entry.name, getattr(self, entry.name), entry.default) for entry in fields(self))
        return {name: value for name, value, default in given if value != default}

    def __repr__(self) -> str:
        return f"Rod({', '.join(f'{name}={value!r}' for name, value in self.stated().items())})"

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


@dataclass(frozen=True)
class Gravity:
    """Where gravity points, and whether the sensor's zero was taken with the rod in the air in the same pose.

    Raises InputError for a direction that is none.
    """

    direction: tuple[float, float, float]
    """In the world, of any length; kept as a unit vector."""
    tared: bool

    def __post_init__(self) -> None:
        given = _plain(self.direction)
        numbers = isinstance(given, Sequence) and len(given) == 3 and all(_is_number(part) for part in given)
        if not (numbers and all(map(math.isfinite, given)) and any(given)):
            raise InputError(f"gravity needs a direction of three numbers that are not all 0, got {self.direction!r}")
        if not isinstance(self.tared, bool):
            raise InputError(f"gravity needs tared, true or false, got {self.tared!r}")
        size = math.hypot(*given)
        object.__setattr__(self, "direction", tuple(float(part / size) for part in given))


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else value


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)
