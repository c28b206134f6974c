"""Smooth convex bodies that a rod can touch, given by their support functions.

The support function ``h(n) = max <n, x>`` of a strictly convex body has the point with the outward normal n as its gradient,
and its Hessian is the derivative of that point by n (S21).  A rod of radius a touches with its centre line the body fattened
by a, whose support function is ``h + a``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from scan3d.arrays import Array, Index
from scan3d.spatial.vectors import basis, dot, unit

# Largest turn of a normal in one step of Newton's method, in radians.  Larger, steps leave the region where the linearisation
# holds; smaller, more steps are needed.
_LARGEST_TURN = 0.5


class Patch(NamedTuple):
    """The surface at n places: point, outward normal, and their derivatives by two local coordinates, each (3, n)."""

    point: Array
    normal: Array
    point_1: Array
    point_2: Array
    normal_1: Array
    normal_2: Array
    law_normal: Array
    """The normal that friction refers to: on a mesh of a smooth body, that of the smooth body."""
    law_normal_1: Array
    law_normal_2: Array


class Body(Protocol):
    """A convex body with a smooth surface, dimensionless.

    A place on its surface is a `feature` (n,), the number of a piece of the surface, and `coordinates` (3, n) on that piece,
    which only the body understands.
    """

    smooth: bool
    """Whether the coordinates are the normal, so that they can be extrapolated from place to place."""

    def patch(self, feature: Index, coordinates: Array) -> Patch:
        """The surface at places."""

    def moved(self, feature: Index, coordinates: Array, patch: Patch, step: Array) -> tuple[Index, Array, Array]:
        """Places moved by steps (2, n) in their local coordinates: features, coordinates, and parts (n,) of the steps taken.

        A step ends where it leaves its piece of the surface, and the place is then on the next piece.
        """

    def extreme(self, normal: Array) -> tuple[Index, Array, Array]:
        """Feature, coordinates and point (3, n) of the body's place with the outward normals (3, n)."""


class SmoothBody:
    """A body given by the gradient and the Hessian of its support function; the base of those below."""

    smooth = True

    def __init__(self, radius: float = 0.0) -> None:
        if not 0 <= radius < np.inf:
            raise ValueError(f"the rod's radius must be a number >= 0, got {radius}")
        self.radius = float(radius)

    def support(self, n: Array) -> tuple[Array, Array]:
        """Gradient (3, n) and Hessian (3, 3, n) of the support function, without the rod's radius, at unit normals (3, n)."""
        raise NotImplementedError

    def patch(self, feature: Index, coordinates: Array) -> Patch:
        n = coordinates
        point, hessian = self.support(n)
        u, v = basis(n)
        point_1, point_2 = ((hessian * w).sum(axis=1) + self.radius * w for w in (u, v))
        return Patch(point + self.radius * n, n, point_1, point_2, u, v, n, u, v)

    def moved(self, feature: Index, coordinates: Array, patch: Patch, step: Array) -> tuple[Index, Array, Array]:
        length = np.sqrt(step[0] ** 2 + step[1] ** 2)
        part = np.minimum(1.0, _LARGEST_TURN / np.maximum(length, 1e-300))
        turned = coordinates + (part * step[0]) * patch.normal_1 + (part * step[1]) * patch.normal_2
        return feature, unit(turned), part

    def extreme(self, normal: Array) -> tuple[Index, Array, Array]:
        return np.zeros(normal.shape[1], dtype=np.intp), normal, self.support(normal)[0] + self.radius * normal


class Ellipsoid(SmoothBody):
    """An ellipsoid with three semi-axes along the rows of `axes`, fattened by the rod's radius."""

    def __init__(
        self,
        semi_axes: ArrayLike,
        center: ArrayLike = (0.0, 0.0, 0.0),
        axes: ArrayLike | None = None,
        radius: float = 0.0,
    ) -> None:
        super().__init__(radius)
        lengths, turn = np.asarray(semi_axes, dtype=float), np.eye(3) if axes is None else np.asarray(axes, dtype=float)
        if lengths.shape != (3,) or not ((lengths > 0) & np.isfinite(lengths)).all():
            raise ValueError(f"an ellipsoid has three semi-axes > 0, got {semi_axes!r}")
        self.center = np.asarray(center, dtype=float).reshape(3, 1)
        self.matrix = turn.T * lengths**2 @ turn

    def support(self, n: Array) -> tuple[Array, Array]:
        image = self.matrix @ n
        height = np.sqrt(dot(image, n))
        gradient = image / height
        hessian = (self.matrix[:, :, None] - gradient[:, None] * gradient[None]) / height
        return self.center + gradient, hessian


class SupportBody(SmoothBody):
    """A body given by the points that have given normals, such as those of a fitted support function, (n, 3) from (n, 3)."""

    # Step of the difference quotients, in radians.  Larger, they are those of a longer secant; smaller, rounding shows.
    _STEP = 1e-5

    def __init__(self, points: Callable[[Array], Array], radius: float = 0.0) -> None:
        super().__init__(radius)
        self._points = points

    def support(self, n: Array) -> tuple[Array, Array]:
        u, v = basis(n)
        count = n.shape[1]
        h = self._STEP
        probes = np.concatenate([n, *(unit(n + sign * h * w) for w in (u, v) for sign in (1, -1))], axis=1)
        values = self._points(probes.T).T.reshape(3, 5, count)
        slope = ((values[:, 1] - values[:, 2]) / (2 * h), (values[:, 3] - values[:, 4]) / (2 * h))
        return values[:, 0], slope[0][:, None] * u[None] + slope[1][:, None] * v[None]


def sphere_directions(count: int = 2000) -> Array:
    """Unit vectors (3, count) spread evenly over the sphere: a Fibonacci lattice."""
    number = np.arange(count) + 0.5
    z, angle = 1 - 2 * number / count, np.pi * (1 + np.sqrt(5)) * number
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z])
