"""What a rig touches to be calibrated: a sphere or a plane, at a place that need not be known.

A reference is fattened by the rod's radius, so that it is touched by the rod's centre line.  Lengths are in nominal lengths
of the rod.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.rods import Rod

# Largest diameter of a reference sphere in rod lengths; larger ones are planes to a rod.
_LARGEST = 1e3
# Eigenvalue of a normal matrix over the largest one that is rounding: the points lie in a plane, and the centre with them.
_FLAT = 1e-12


class Met(NamedTuple):
    """How contacts (n, 3) with tangents (n, 3) meet a reference, with derivatives by them and by the reference's place."""

    gap: Array
    """(n,) distance of the contact from the surface less the rod's radius, negative inside."""
    normal: Array
    """(n, 3) outward: the derivatives of `gap` by the contact, and of `along` by the tangent."""
    along: Array
    """(n,) cosine between tangent and normal."""
    along_by_point: Array
    """(n, 3)"""
    gap_by_place: Array
    """(n, 3)"""
    along_by_place: Array
    """(n, 3)"""


@dataclass(frozen=True)
class Sphere:
    """A sphere; its place are the coordinates of its centre along its axes."""

    diameter_m: float
    radius: float
    origin: Array
    """(3,) its centre."""
    axes: Array
    """(3, 3) as columns."""

    kind = "sphere"
    extent, check = "a tenth of the sphere's radius", "the diameter and its unit"
    unlike = "the diameter, a reference that is no sphere, such as one of facets"

    @classmethod
    def of(cls, diameter_m: float, rod: Rod) -> Sphere:
        """The sphere of a diameter that a rod touches, with its centre in the origin."""
        if not (isinstance(diameter_m, (int, float)) and math.isfinite(diameter_m) and diameter_m > 0):
            raise InputError(f"the reference sphere needs a diameter above 0, got {diameter_m!r}")
        if diameter_m > _LARGEST * rod.length_m:
            raise InputError(
                f"the reference sphere has a diameter of {diameter_m:.3g} m, and the rod a length of {rod.length_m:.3g} m; "
                "check the unit of the diameter, or touch a plane"
            )
        return cls(diameter_m, (diameter_m + rod.diameter_m) / 2 / rod.length_m, np.zeros(3), np.eye(3))

    @property
    def title(self) -> str:
        return f"a sphere of {1000 * self.diameter_m:g} mm"

    @property
    def size(self) -> float:
        """The length over which the surface curves, in rod lengths."""
        return self.radius

    def moved(self, step: Array) -> Sphere:
        return replace(self, origin=self.origin + self.axes @ step)

    def met(self, point: Array, tangent: Array) -> Met:
        away = point - self.origin
        distance = np.linalg.norm(away, axis=1)
        normal = away / distance[:, None]
        cosine = (tangent * normal).sum(axis=1)
        across = (tangent - cosine[:, None] * normal) / distance[:, None]
        return Met(distance - self.radius, normal, cosine, across, -normal @ self.axes, -across @ self.axes)

    def nearest(self, points: Array, outside: Array) -> tuple[int, Sphere, float]:
        """The set of points, of sets (t, n, 3), that is nearest to the sphere, which then is there, and the median distance.

        The centres are those of spheres of any radius, with the least squares of a linear equation.
        """
        middle = points.mean(axis=1, keepdims=True)
        relative = points - middle
        square = (relative**2).sum(axis=2, keepdims=True)
        matrix = np.concatenate([2 * relative, np.ones_like(square)], axis=2)
        normal = np.linalg.pinv(matrix.swapaxes(1, 2) @ matrix, _FLAT, hermitian=True)
        centre = middle + (normal @ matrix.swapaxes(1, 2) @ square)[:, None, :3, 0]
        misfit = np.median(np.abs(np.linalg.norm(points - centre, axis=2) - self.radius), axis=1)
        best = int(np.argmin(misfit))
        return best, replace(self, origin=centre[best, 0]), float(misfit[best])


@dataclass(frozen=True)
class Plane:
    """A plane; its place is its height, and its tilt about its first two axes."""

    radius: float
    origin: Array
    """(3,) a point of it."""
    axes: Array
    """(3, 3) as columns; the last is the outward normal."""

    kind = "plane"
    title = "a plane"
    extent, check = "a fiftieth of the rod's length", "that only the plane was touched"
    unlike = "a reference that is not flat, or whose border was touched"
    # contacts anywhere along the rod are as far from a plane as the rod is straight
    size = 0.15

    @classmethod
    def of(cls, rod: Rod) -> Plane:
        """The plane z = 0 that a rod touches."""
        return cls(rod.diameter_m / 2 / rod.length_m, np.zeros(3), np.eye(3))

    def moved(self, step: Array) -> Plane:
        axes = self.axes @ Rotation.from_rotvec([step[1], step[2], 0.0]).as_matrix()
        return replace(self, axes=axes, origin=self.origin + step[0] * axes[:, 2])

    def met(self, point: Array, tangent: Array) -> Met:
        normal = np.broadcast_to(self.axes[:, 2], point.shape)
        relative, direction = (point - self.origin) @ self.axes, tangent @ self.axes
        one, zero = np.ones(len(point)), np.zeros(len(point))
        gap_by_place = np.column_stack([-one, -relative[:, 1], relative[:, 0]])
        along_by_place = np.column_stack([zero, -direction[:, 1], direction[:, 0]])
        gap = relative[:, 2] - self.radius
        return Met(gap, normal, direction[:, 2], np.zeros_like(point), gap_by_place, along_by_place)

    def nearest(self, points: Array, outside: Array) -> tuple[int, Plane, float]:
        """The set of points, of sets (t, n, 3), that is nearest to a plane, that plane, and the median distance.

        The point `outside` (3,) is on its outward side.
        """
        middle = points.mean(axis=1, keepdims=True)
        relative = points - middle
        normal = np.linalg.eigh(relative.swapaxes(1, 2) @ relative)[1][:, :, 0]
        misfit = np.median(np.abs(np.einsum("tni,ti->tn", relative, normal)), axis=1)
        best = int(np.argmin(misfit))
        normal, middle = normal[best], middle[best, 0]
        normal = normal if (outside - middle) @ normal >= 0 else -normal
        axes = Rotation.align_vectors([normal], [[0.0, 0.0, 1.0]])[0].as_matrix()
        return best, replace(self, origin=middle - self.radius * normal, axes=axes), float(misfit[best])


Reference = Sphere | Plane
