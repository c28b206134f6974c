"""What a rig touches to be calibrated: a sphere, a plane, or a known convex body, at a place that need not be known.

A reference has a frame of its own.  Its equations are those of the rod's centre line, with the contact and the tangent in that
frame: the contact is one radius of the rod away from the surface, and in tangential contact the rod is tangent to it there.
Lengths are in nominal lengths of the rod.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import numpy as np

from scan3d.arrays import Array, Mask
from scan3d.errors import InputError
from scan3d.rods import Rod

# Largest diameter of a reference sphere in rod lengths.  Larger ones are planes to a rod, and rounding of their places is no
# longer small; smaller limits would refuse spheres that can be touched.
_LARGEST = 1e3
KINDS = ("sphere", "plane", "mesh")
"""Kinds of references, by which the files of rigs name them."""


class Met(NamedTuple):
    """How rows (n,) meet a reference, with derivatives by contacts and by tangents, in the frame of the reference.

    The arrays are new ones, which may be changed.
    """

    gap: Array
    """(n,) distance of the contact from the surface less the rod's radius, negative inside."""
    gap_by_point: Array
    """(n, 3)"""
    gap_by_tangent: Array
    along: Array
    """(n,) what vanishes in tangential contact, 0 for other rows."""
    along_by_point: Array
    along_by_tangent: Array


class Located(NamedTuple):
    """Places (t, 3) and axes (t, 3, 3) at which a reference is nearest to sets of contacts, and how near (t,) that is."""

    centre: Array
    axes: Array
    misfit: Array


class Reference(ABC):
    """A surface that is touched."""

    kind: ClassVar[str]
    """One of `KINDS`."""
    noun: ClassVar[str]
    """What it is called in messages."""
    radius: float
    """Of the rod, and of the sphere if it is one."""
    title: str
    """It with its size or its name."""
    extent: ClassVar[str]
    """How well the contact must be known along the rod, about a tenth of its `size`."""
    check: ClassVar[str]
    """What is to be checked about it where touches do not fit."""
    sizes: ClassVar[str]
    """What is to be checked where touches fit badly."""
    unlike: ClassVar[str]
    """How it may differ from what it is taken for."""
    excluded: ClassVar[str]
    """What is no such cause, or nothing."""
    free: ClassVar[tuple[bool, ...]]
    """(6,) which of its displacements along its axes, and turns about them, change where it is."""
    pose_order: ClassVar[tuple[float, float]]
    """How soon a displacement or a turn of it is fixed where it is not determined; 0 for never."""
    smooth: ClassVar[bool]
    """Whether its normal changes steadily."""
    abrupt: ClassVar[bool]
    """Whether contacts pass between the tip and the rest of the rod within few rows, and the rod's tangent with them."""
    inward: ClassVar[int]
    """The equation whose value for a tangential contact is negative where the rod points into the reference: 2 or 3."""

    size: float
    """The length over which the surface curves, or ends."""

    @abstractmethod
    def met(self, point: Array, tangent: Array, tangential: Mask) -> Met:
        """How contacts (n, 3) with tangents (n, 3), in its frame, meet it; in the rows `tangential` (n,) the rod is tangent."""

    @abstractmethod
    def wander(self, point: Array, tangent: Array) -> Array:
        """How far (n,) tangential contacts go along rods that turn a little, because of flat faces; 0 for smooth references."""

    @abstractmethod
    def located(self, points: Array, outside: Array) -> Located:
        """Where it is nearest to sets (t, n, 3) of contacts; the point `outside` (3,) is."""


class Spherical(Reference):
    """A sphere, with its radius and that of the rod."""

    kind = noun = "sphere"
    extent, check = "a tenth of the sphere's radius", "the diameter and its unit"
    sizes, unlike = "the diameters of sphere and rod", "a reference that is no sphere, such as one of facets"
    excluded = "; a diameter that is wrong would not look like this"
    free = (True, True, True, False, False, False)
    pose_order = (0.0, 0.0)
    smooth, abrupt = True, False
    inward = 3

    def __init__(self, diameter_m: float, rod: Rod) -> None:
        """A sphere of some diameter, touched with a rod."""
        if not (isinstance(diameter_m, (int, float)) and math.isfinite(diameter_m) and diameter_m > 0):
            raise InputError(f"the reference sphere needs a diameter above 0, got {diameter_m!r}")
        if diameter_m > _LARGEST * rod.length_m:
            raise InputError(
                f"the reference sphere has a diameter of {diameter_m:.3g} m, and the rod a length of {rod.length_m:.3g} m; "
                "check the unit of the diameter, or touch a plane"
            )
        self.diameter_m = diameter_m
        self.size = self.radius = (diameter_m + rod.diameter_m) / 2 / rod.length_m
        self.title = f"a sphere of {1000 * diameter_m:g} mm"

    def met(self, point: Array, tangent: Array, tangential: Mask) -> Met:
        distance = np.linalg.norm(point, axis=1)
        normal = point / distance[:, None]
        cosine = (tangent * normal).sum(axis=1)
        across = (tangent - cosine[:, None] * normal) / distance[:, None]
        return Met(distance - self.radius, normal, np.zeros_like(normal), cosine, across, normal.copy())

    def wander(self, point: Array, tangent: Array) -> Array:
        return np.zeros(len(point))

    def located(self, points: Array, outside: Array) -> Located:
        """The spheres of any radius nearest to the points, by linear least squares."""
        centre = nearest_sphere(points)
        misfit = np.median(np.abs(np.linalg.norm(points - centre[:, None], axis=2) - self.radius), axis=1)
        return Located(centre, np.broadcast_to(np.eye(3), (len(points), 3, 3)), misfit)


class Flat(Reference):
    """A plane, normal to the third of its axes, and the rod's radius."""

    kind = noun = "plane"
    extent, check = "a fiftieth of the rod's length", "that only the plane was touched"
    sizes, unlike = "the flatness of the plane", "a reference that is not flat, or whose border was touched"
    excluded = ""
    title = "a plane"
    free = (False, False, True, True, True, False)
    pose_order = (0.0, 0.0)
    smooth, abrupt = True, True
    inward = 3
    # contacts anywhere along the rod are as far from a plane as the rod is straight
    size = 0.15

    def __init__(self, rod: Rod) -> None:
        """A plane that is touched with a rod."""
        self.radius = rod.diameter_m / 2 / rod.length_m

    def met(self, point: Array, tangent: Array, tangential: Mask) -> Met:
        normal = np.zeros_like(point)
        normal[:, 2] = 1
        none = np.zeros_like(point)
        return Met(point[:, 2] - self.radius, normal, none, tangent[:, 2].copy(), none.copy(), normal.copy())

    def wander(self, point: Array, tangent: Array) -> Array:
        return np.zeros(len(point))

    def located(self, points: Array, outside: Array) -> Located:
        """The planes nearest to the points, through their middles."""
        middle = points.mean(axis=1)
        relative = points - middle[:, None]
        axes = np.linalg.eigh(relative.swapaxes(1, 2) @ relative)[1][:, :, ::-1].copy()
        axes[:, :, 2] *= np.where(((outside - middle) * axes[:, :, 2]).sum(axis=1) < 0, -1.0, 1.0)[:, None]
        axes[:, :, 0] = np.cross(axes[:, :, 1], axes[:, :, 2])
        misfit = np.median(np.abs((relative * axes[:, None, :, 2]).sum(axis=2)), axis=1)
        return Located(middle - self.radius * axes[:, :, 2], axes, misfit)


def nearest_sphere(points: Array) -> Array:
    """Centres (t, 3) of the spheres of any radius nearest to sets of points (t, n, 3), by linear least squares."""
    middle = points.mean(axis=1, keepdims=True)
    relative = points - middle
    square = (relative**2).sum(axis=2, keepdims=True)
    matrix = np.concatenate([2 * relative, np.ones_like(square)], axis=2)
    transposed = matrix.swapaxes(1, 2)
    ridge = 1e-9 * np.eye(4)
    solved = np.linalg.solve(transposed @ matrix + ridge, transposed @ square)[:, :3, 0]
    return np.asarray(middle[:, 0] + solved)
