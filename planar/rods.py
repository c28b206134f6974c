"""Rods other than the straight, uniform, weightless one of the paper.

Units (1) with the bending stiffness at the clamp: lengths in rod lengths ``L``, forces in ``EI(0)/L²``.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from planar.arrays import Array, Index


@dataclass(frozen=True)
class Profile:
    """Diameter and weight along a rod, dimensionless."""

    knots: tuple[float, ...] = (0.0, 1.0)
    """Arc lengths (k,) between which the diameter is linear."""
    diameters: tuple[float, ...] = (1.0, 1.0)
    """Diameters (k,) there, over that at the clamp."""
    weight: float = 0.0
    """Weight of the whole rod, spread as the square of the diameter."""

    def diameter(self, s: Array) -> Array:
        """Diameters at arc lengths of any shape, over that at the clamp; past the tip that of the tip."""
        return np.interp(s, self.knots, self.diameters)

    def bending_stiffness(self, s: Array) -> Array:
        """Bending stiffness at arc lengths of any shape, over that at the clamp."""
        return np.asarray(np.square(np.square(self.diameter(s))))

    def weight_past(self, s: Array) -> Array:
        """Weight of the part of the rod past arc lengths of any shape, in ``EI(0)/L²``."""
        if self.weight == 0:
            return np.zeros(np.shape(s))
        knots, d, volumes = np.array(self.knots), np.array(self.diameters), self._volumes
        following = np.clip(np.searchsorted(knots, s, side="right"), 1, len(knots) - 1)
        rest = np.clip(knots[following] - s, 0.0, None) * _frustum(self.diameter(s), d[following])
        return np.asarray(self.weight * (rest + volumes[following]) / volumes[0])

    def along(self, s: Array | float, length: Array | float, nodes: Array) -> tuple[Array, Array]:
        """`bending_stiffness` and `weight_past` at the `nodes` (k,) between 0 and 1 of steps past arc lengths `s`, numbers or
        (n,): (k,) or (k, n).  No step crosses a knot."""
        end = np.asarray(s + length)
        here, last = self.diameter(np.asarray(s)), self.diameter(end)
        diameter = here + np.multiply.outer(nodes, last - here)
        past = np.zeros(len(nodes))
        if self.weight:
            rest = np.multiply.outer(1 - nodes, np.where(np.minimum(s, end) < 1, length, 0.0)) * _frustum(
                diameter, last
            )
            past = self.weight_past(end) + self.weight * rest / self._volumes[0]
        return np.asarray(np.square(np.square(diameter))), past

    @property
    def _volumes(self) -> Array:
        """(k,) volumes past the knots, over that of a frustum of height and diameter 1."""
        d = np.array(self.diameters)
        parts = np.diff(self.knots) * _frustum(d[:-1], d[1:])
        return np.append(np.cumsum(parts[::-1])[::-1], 0.0)


def _frustum(first: Array, last: Array) -> Array:
    """Volumes of frustums of height 1, over a twelfth of π."""
    return np.asarray(first * first + first * last + last * last)


@dataclass(frozen=True)
class Rod:
    """A rod in a plane, dimensionless; without arguments the straight, uniform, weightless rod in a rigid clamp.

    Raises ValueError for numbers that belong to no rod.
    """

    tip_diameter: float = 1.0
    """Diameter at the tip of a cone, relative to that at the clamp."""
    stiffness: ArrayLike | None = None
    """Rows (n, 2) of arc length ``s``, rising from 0 to 1, and bending stiffness over that at the clamp; None: that of the
    cone.  Between the rows the fourth root, a round rod's diameter, is linear."""
    curvature: float = 0.0
    """Curvature ``κ̂`` of the free rod, in ``1/L``; positive where it turns against the sweep in -x, counter-clockwise."""
    weight: float = 0.0
    """Weight of the whole rod in ``EI(0)/L²``, spread as the square of the diameter."""
    gravity: ArrayLike | None = None
    """Direction of gravity in the clamp's frame, along whose y axis the rod leaves; any length.  Needed with a weight:
    one (2,), or one for each row that is reconstructed, or for each of many sweeps, (n, 2)."""
    compliance: float = 0.0
    """Angle by which the clamp gives, in radians per ``EI(0)/L`` of moment."""
    profile: Profile = field(init=False, repr=False, compare=False)
    down: Array = field(init=False, repr=False, compare=False)
    """Unit vectors of gravity, (2,) or (n, 2); 0 without weight."""

    def __post_init__(self) -> None:
        knots, diameters = np.array([0.0, 1.0]), np.array([1.0, float(self.tip_diameter)])
        if self.stiffness is not None:
            table = np.asarray(self.stiffness, dtype=float)
            if table.ndim != 2 or table.shape[1] != 2 or len(table) < 2:
                raise ValueError(f"stiffness must have rows of s and stiffness, shape (n >= 2, 2), got {table.shape}")
            if self.tip_diameter != 1.0:
                raise ValueError("a rod has either a tip_diameter or a table of its stiffness, got both")
            knots, relative = table.T
            if not (knots[0] == 0 and knots[-1] == 1 and (np.diff(knots) > 0).all()):
                raise ValueError(f"the first column of stiffness must rise from 0 to 1, got {knots}")
            if not (np.isfinite(relative).all() and (relative > 0).all() and abs(relative[0] - 1) < 1e-12):
                raise ValueError(
                    f"stiffness must be positive, and 1 at the clamp, whose it is relative to, got {relative}"
                )
            diameters = relative**0.25
            object.__setattr__(self, "stiffness", tuple(map(tuple, table.tolist())))
        if not (np.isfinite(diameters).all() and (diameters > 0).all()):
            raise ValueError(f"tip_diameter must be a positive number, got {self.tip_diameter}")
        if not np.isfinite(self.curvature):
            raise ValueError(f"curvature must be a number, got {self.curvature}")
        for name in ("weight", "compliance"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be a number of at least 0, got {getattr(self, name)}")
        down = np.zeros(2)
        if self.weight > 0:
            down = np.asarray(np.nan if self.gravity is None else self.gravity, dtype=float)
            right = down.ndim in (1, 2) and down.shape[-1] == 2
            if not (right and np.isfinite(down).all() and down.any(axis=-1).all()):
                raise ValueError(
                    f"a rod with weight needs the direction (2,) of gravity, or one for each row, got {self.gravity}"
                )
            if down.ndim == 1:
                object.__setattr__(self, "gravity", tuple(down.tolist()))
            down = down / np.linalg.norm(down, axis=-1, keepdims=True)
        profile = Profile(tuple(knots.tolist()), tuple(diameters.tolist()), float(self.weight))
        object.__setattr__(self, "profile", profile)
        object.__setattr__(self, "down", down)

    @property
    def is_uniform(self) -> bool:
        """Whether the rod is of one stiffness, weightless and rigidly clamped: straight, or an arc of a circle."""
        return set(self.profile.diameters) == {1.0} and self.weight == 0 and self.compliance == 0

    @property
    def is_straight_and_uniform(self) -> bool:
        """Whether it is the rod of the paper."""
        return self.is_uniform and self.curvature == 0

    @property
    def pull(self) -> Array:
        """(2, 1) the rod's weight as a force, or (2, n) for rows with a gravity each."""
        return self.weight * np.atleast_2d(self.down).T

    def rows(self, rows: slice | Index) -> Rod:
        """The rod of some of the rows of which each has its gravity."""
        return replace(self, gravity=self.down[rows]) if self.down.ndim == 2 else self

    def steady(self) -> Rod:
        """The rod itself.  Raises ValueError if each row has its gravity."""
        if self.down.ndim == 2:
            raise ValueError("gravity must have one direction (2,) here")
        return self

    def mirrored(self) -> Rod:
        """The mirror image, x → -x."""
        gravity = None if self.gravity is None else np.asarray(self.gravity, dtype=float) * [-1.0, 1.0]
        return replace(self, curvature=-self.curvature, gravity=gravity)
