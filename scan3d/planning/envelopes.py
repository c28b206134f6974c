"""What is known of a body before it is touched: the cylinder, sphere or box around it, standing on z = 0 about the z axis."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from scan3d.arrays import Array, Mask
from scan3d.errors import InputError
from scan3d.geometry.hulls import hull
from scan3d.spatial.bodies import sphere_directions

# Corners of the polygon and of the polyhedron that stand for a circle and a sphere, around which they lie.  More take longer;
# with fewer, sweeps keep farther away than needed: by 0.1 % of the radius and 1 %.
_AROUND, _ON_SPHERE = 72, 600
_COUNTS = {"cylinder": 2, "sphere": 1, "box": 3}


@dataclass(frozen=True)
class Envelope:
    """A bounding body; lengths in the user's unit.  Raises InputError for sizes that are not positive numbers."""

    shape: str
    """'cylinder', 'sphere' or 'box'."""
    sizes: tuple[float, ...]
    """Diameter and height of the cylinder, diameter of the sphere, or extents of the box along x, y and z."""

    def __post_init__(self) -> None:
        if self.shape not in _COUNTS or len(self.sizes) != _COUNTS[self.shape]:
            raise InputError(_expected(str(self)))
        if not all(0 < size < math.inf for size in self.sizes):
            raise InputError(f"the sizes of {self} must be above 0")

    def __str__(self) -> str:
        return f"{self.shape}:{'x'.join(f'{size:g}' for size in self.sizes)}"

    @property
    def height(self) -> float:
        """Of its top above z = 0."""
        return self.sizes[-1]

    @property
    def width(self) -> float:
        """Largest horizontal diameter."""
        return math.hypot(*self.sizes[:2]) if self.shape == "box" else self.sizes[0]

    def points(self) -> Array:
        """(n, 3) corners of a polyhedron in which the bounding body lies."""
        if self.shape == "sphere":
            radius = self.sizes[0] / 2
            directions = sphere_directions(_ON_SPHERE).T
            # the polyhedron of points on a sphere has faces nearer to the middle, by which it is enlarged
            nearest = float(np.min(_face_distances(directions)))
            points = np.asarray(directions * radius / nearest + [0, 0, radius])
            return np.column_stack([points[:, :2], np.maximum(points[:, 2], 0.0)])
        outline = self.outline()
        return np.concatenate([np.column_stack([outline, np.full(len(outline), z)]) for z in (0.0, self.height)])

    def outline(self) -> Array:
        """(n, 2) corners of a polygon in which the bounding body lies, seen from above."""
        if self.shape == "box":
            corners = np.array([(x, y) for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
            return np.asarray(corners * self.sizes[:2])
        angle = 2 * np.pi * (np.arange(_AROUND) + 0.5) / _AROUND
        radius = self.sizes[0] / 2 / np.cos(np.pi / _AROUND)
        return np.asarray(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))

    def contains(self, points: Array) -> Mask:
        """(n,) whether points (n, 3) lie in it."""
        x, y, z = points.T
        if self.shape == "box":
            inside = (np.abs(x) <= self.sizes[0] / 2) & (np.abs(y) <= self.sizes[1] / 2)
        elif self.shape == "cylinder":
            inside = np.hypot(x, y) <= self.sizes[0] / 2
        else:
            return np.asarray(x**2 + y**2 + (z - self.sizes[0] / 2) ** 2 <= self.sizes[0] ** 2 / 4)
        return np.asarray(inside & (z >= 0) & (z <= self.height))


def _face_distances(directions: Array) -> Array:
    """Distances (f,) of the faces of the hull of unit vectors (n, 3) from the origin."""
    body = hull(directions)
    return np.asarray((body.triangles_center * body.face_normals).sum(axis=1))


def parse_envelope(text: str) -> Envelope:
    """The bounding body named by ``cylinder:DxH``, ``sphere:D`` or ``box:AxBxC``.  Raises InputError for any other text."""
    match = re.fullmatch(r"(\w+):([0-9.eE+-]+(?:x[0-9.eE+-]+)*)", text)
    try:
        sizes = tuple(float(part) for part in match[2].split("x")) if match else ()
    except ValueError:
        match = None
    if match is None or match[1] not in _COUNTS or len(sizes) != _COUNTS[match[1]]:
        raise InputError(_expected(text))
    return Envelope(match[1], sizes)


def _expected(text: str) -> str:
    return (
        "a bounding body is cylinder:DIAMETERxHEIGHT, sphere:DIAMETER or box:AxBxC, such as cylinder:80x120; "
        f"got {text!r}"
    )
