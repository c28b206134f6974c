"""The settings of a scan."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.choices import MODELS, SPACINGS, Model, Spacing
from scan3d.errors import InputError
from scan3d.rods import Rod
from scan3d.units import UNITS_M, Unit

LARGEST_FRICTION = 100.0
"""Largest coefficient of friction.  No materials come near it, and beyond it steep forces lose their digits."""
SMALLEST_CLEARANCE = 1e-6
"""Smallest distance of the base line from a slice, in rod lengths.  Smaller, rounding would put the base line into the body."""
LARGEST_NOISE = 1.0
"""Largest standard deviation of force and moment, in EI/L² and EI/L.  Contact forces are of that size, so that beyond it
nothing would be measured."""
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True)
class Plan:
    """Settings of a simulated scan.

    model
        model of contact: ``planar``, the rod stays in its slice, or ``spatial``, a round rod bends where the contact pushes it.
    slices
        number of slices along each axis, besides one beyond either end of the body.  With adaptive spacing it is the largest:
        there are fewer where further slices would not lower the bound, other empty slices count, and along several axes, up to
        50 slices along each of two or 28 of three, their sum is shared out where the contacts so far leave most room.  In the
        spatial model there are no slices, and 0.6 times as many sweeps from each of twelve directions.
    spacing
        heights of the slices: ``cosine`` (dense at the ends), ``uniform``, or ``adaptive`` (where the contacts so far leave
        most room for the body).
    tolerance
        adaptive spacing stops when the certified bound, relative to the diagonal of the contacts' bounding box, is this small;
        slices whose contours need more contacts for it are swept again with up to 16 times the samples.
    axis
        normal of the slices: ``"x"``, ``"y"``, ``"z"``, several such as ``"xyz"``, or a vector of three numbers.
    sweeps
        sweeps per slice, evenly spaced around it, or in the spatial model per direction; None: as many as the body needs.
    samples
        samples per sweep, from touch-down to the sweep's end.
    friction
        coefficient of friction, or the range ``(low, high)`` from which every sample draws its own; dimensionless.
    clearance
        distance of the base line from the slice, in rod lengths.
    rod
        a `scan3d.Rod`, in SI units; None: a steel wire as long as the widest slice's diameter, or in the spatial model as the
        body.
    noise
        standard deviation of force and moment, in EI/L² and EI/L.
    seed
        seed of the random friction and noise.
    unit
        unit of the mesh's coordinates: ``m``, ``cm``, ``mm``, ``um`` or ``in``.

    Raises InputError for values out of their range.
    """

    model: Model = "planar"
    slices: int = 64
    spacing: Spacing = "adaptive"
    tolerance: float = 0.0
    axis: str | Sequence[float] = "z"
    sweeps: int | None = None
    samples: int = 64
    friction: float | tuple[float, float] = 0.3
    clearance: float = 0.3
    rod: Rod | None = None
    noise: float = 0.0
    seed: int = 0
    unit: Unit = "mm"

    def __post_init__(self) -> None:
        for name, minimum in (("slices", 1), ("samples", 2), ("seed", 0)):
            check_whole(name, getattr(self, name), minimum)
        if self.sweeps is not None:
            check_whole("sweeps", self.sweeps, 1)
        for name, known in (("model", MODELS), ("spacing", SPACINGS), ("unit", UNITS_M)):
            check_choice(name, getattr(self, name), known)
        low, high = self.friction_range
        if not 0 <= low <= high <= LARGEST_FRICTION:
            raise InputError(
                f"friction must be a number >= 0 or a rising range LOW:HIGH of such, at most {LARGEST_FRICTION:g}, "
                f"got {self.friction}"
            )
        if not (_is_finite(self.tolerance) and self.tolerance >= 0):
            raise InputError(f"tolerance must be a number >= 0, got {self.tolerance}")
        if not (_is_finite(self.clearance) and SMALLEST_CLEARANCE <= self.clearance < 1):
            raise InputError(
                f"clearance must lie between {SMALLEST_CLEARANCE:g} and 1 rod lengths, got {self.clearance}"
            )
        if not (_is_finite(self.noise) and 0 <= self.noise <= LARGEST_NOISE):
            raise InputError(f"noise must be a number >= 0 and at most {LARGEST_NOISE:g}, got {self.noise}")
        if self.rod is not None and not isinstance(self.rod, Rod):
            raise InputError(f"rod must be a scan3d.Rod or None, got {self.rod!r}")
        self.axes()
        if self.model == "spatial":
            self._check_spatial()

    def _check_spatial(self) -> None:
        """Raise InputError for settings of slices, which the spatial model does not have."""
        for name in ("spacing", "axis", "tolerance"):
            value, default = getattr(self, name), getattr(type(self), name)
            if not np.array_equal(value, default):
                raise InputError(
                    f"{name} is a setting of slices, and the spatial model has none; leave out {name} {value!r}"
                )

    @property
    def friction_range(self) -> tuple[float, float]:
        """Lowest and highest coefficient of friction."""
        ends: list[Any] = [self.friction] * 2 if np.ndim(self.friction) == 0 else list(self.friction)  # type: ignore[arg-type]
        if len(ends) != 2:
            raise InputError(f"a range of friction has two ends, got {self.friction}")
        if not all(map(_is_finite, ends)):
            raise InputError(f"friction must be a number >= 0, or a range of two such numbers, got {self.friction!r}")
        return float(ends[0]), float(ends[1])

    def axes(self) -> Array:
        """Unit normals (k, 3) of the slices."""
        letters = self.axis if isinstance(self.axis, str) else ""
        try:
            given: list[Any] = [_AXES[letter] for letter in letters]
            vectors = np.array(given or [self.axis], dtype=float)
        except (KeyError, TypeError, ValueError, OverflowError):
            vectors = np.empty(0)
        valid = vectors.ndim == 2 and vectors.shape[1] == 3 and np.isfinite(vectors).all() and vectors.any(axis=1).all()
        if not valid or len(set(letters)) < len(letters):
            raise InputError(
                f"axis must be x, y, z, several of them such as xyz, or a vector of three numbers that is not zero, "
                f"got {self.axis!r}"
            )
        vectors /= np.abs(vectors).max(axis=1, keepdims=True)  # so that squares are numbers of a computer
        return np.array([vector / np.linalg.norm(vector) for vector in vectors])


def _is_finite(value: object) -> bool:
    """Whether it is one real number; a whole number may be too large for a float."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def check_choice(name: str, value: object, known: Iterable[str]) -> None:
    """Raises InputError for a setting whose value is none of the known ones."""
    if not isinstance(value, str) or value not in known:
        raise InputError(f"{name} must be one of {', '.join(known)}, got {value!r}")


def check_whole(name: str, value: object, minimum: int) -> None:
    """Raises InputError for a setting whose value is no whole number, or too small."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < minimum:
        raise InputError(f"{name} must be a whole number of at least {minimum}, got {value!r}")
