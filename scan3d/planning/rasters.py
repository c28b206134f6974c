"""Sweeps of a round rod in space: from many directions, in rasters of parallel lines, and aimed at what is still open.

A rod that comes from one side bends aside and slides over the body (MODEL3D, S24): it sees the part of the surface whose normals
lie some 13° to 70° from its own direction.  Twelve directions, those of the vertices of an icosahedron, see every normal from two
or more sides.  From each of them the lines run in two directions across each other, and every other line runs backwards, because
a sweep sees most of the side that it comes to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scan3d.arrays import Array
from scan3d.geometry.hulls import hull

# Angle between the normal of an open facet and the direction from which a sweep is aimed at it, in radians: in the middle of
# what a sweep sees.
_AIM = 0.7
# Facets whose directions differ by less than this many radians, and whose distance is less than their size, are one target.
_GOLDEN = (1 + np.sqrt(5)) / 2


class Lines(NamedTuple):
    """Straight paths (k) of a clamp, before it is known where on them the rod touches."""

    origin: Array
    """(k, 3) a point of each path, level with the body's middle."""
    axes: Array
    """(k, 3, 3) axes of the clamp as rows: x, against which it moves, y along the rod, and z."""


def icosahedron() -> Array:
    """(12, 3) unit vectors to the vertices of an icosahedron."""
    ends = np.array([(0, a, b * _GOLDEN) for a in (-1, 1) for b in (-1, 1)])
    vertices = np.concatenate([np.roll(ends, k, axis=1) for k in range(3)])
    return vertices / np.linalg.norm(vertices[0])


def rasters(points: Array, count: int, clearance: float) -> Lines:
    """`count` lines from each of twelve directions.

    points
        (n, 3) that span the body, such as its vertices.
    clearance
        distance of the clamp from the body along the rod.
    """
    parts = [_raster(points, -direction, count, clearance) for direction in icosahedron()]
    return Lines(*map(np.concatenate, zip(*parts, strict=True)))


def _raster(points: Array, along: Array, count: int, clearance: float) -> Lines:
    """Lines across the direction `along` of the rod, as many each way as the body is wide there."""
    first, second = _across(along)
    widths = [float(np.ptp(points @ axis)) for axis in (first, second)]
    numbers = [max(1, round(count * width / sum(widths))) for width in widths]
    origin, axes = [], []
    for spread, moved, number in ((first, second, numbers[0]), (second, first, numbers[1])):
        place = points @ spread
        offsets = place.min() + np.ptp(place) * (np.arange(number) + 0.5) / number
        middle = points.mean(axis=0)
        base = middle + ((points @ along).min() - clearance - middle @ along) * along
        origin.append(base + (offsets - base @ spread)[:, None] * spread)
        sign = np.where(np.arange(number) % 2, -1.0, 1.0)
        x = sign[:, None] * moved
        y = np.broadcast_to(along, x.shape)
        axes.append(np.stack([x, y, np.cross(x, y)], axis=1))
    return Lines(np.concatenate(origin), np.concatenate(axes))


def aimed(points: Array, contacts: Array, count: int, clearance: float, generator: np.random.Generator) -> Lines:
    """`count` lines aimed at the largest facets of the hull of contacts (n, 3): there the surface is least known.

    `points` span the body as in `rasters`; the contacts will do.
    """
    body = hull(contacts)
    corners = body.vertices.view(np.ndarray)[body.faces]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    target, normal = corners.mean(axis=1), body.face_normals.view(np.ndarray)
    chosen = np.argsort(-sides.max(axis=1), kind="stable")[:count]
    target, normal = target[chosen], normal[chosen]
    angle = generator.uniform(0, 2 * np.pi, (2, len(chosen)))
    first, second = (np.array(axes) for axes in zip(*map(_across, normal), strict=True))
    side = np.cos(angle[0])[:, None] * first + np.sin(angle[0])[:, None] * second
    y = -(np.cos(_AIM) * normal + np.sin(_AIM) * side)
    first, second = (np.array(axes) for axes in zip(*map(_across, y), strict=True))
    x = np.cos(angle[1])[:, None] * first + np.sin(angle[1])[:, None] * second
    level = (points @ y.T).min(axis=0) - clearance
    origin = target + (level - (target * y).sum(axis=1))[:, None] * y
    return Lines(origin, np.stack([x, y, np.cross(x, y)], axis=1))


def _across(direction: Array) -> tuple[Array, Array]:
    """Two unit vectors across a direction (3,) and across each other."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first)
    return first, np.cross(direction, first)
