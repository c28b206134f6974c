"""Sweeps of a round rod in space: from many directions, in rasters of parallel lines, and aimed at what is still open.

A rod that comes from one side bends aside and slides over the body (S24): it sees the part of the surface whose normals lie
some 13° to 70° from its own direction.  Twelve directions, those of the vertices of an icosahedron, see every normal from two
or more sides.  From each of them the lines run in two directions across each other, and every other line runs backwards,
because a sweep sees most of the side that it comes to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array

# Where along the rod, in its lengths, a place is touched that a sweep is aimed at.  Nearer to the tip, contacts are lighter;
# nearer to the clamp, the clamp comes closer to the body.
_TOUCHED = 0.6
# Places that are aimed at in one round are farther apart than this many sizes of a facet, or their normals than the facet's
# from those at its corners.  Larger, some open places are left for the next round; smaller, several sweeps go to one place.
_APART = 1.0
# Angles by which the directions are turned, in radians: any that belong to no symmetry.
_ASKEW = (0.2, 0.37, 0.61)
_GOLDEN = (1 + np.sqrt(5)) / 2


class Lines(NamedTuple):
    """Straight paths (k) of a clamp, before it is known where on them the rod touches."""

    origin: Array
    """(k, 3) a point of each path."""
    axes: Array
    """(k, 3, 3) axes of the clamp as rows: x, against which it moves, y along the rod, and z."""


def icosahedron() -> Array:
    """(12, 3) unit vectors to the vertices of an icosahedron that is turned askew.

    A rod that lies flat on a face, or sweeps in a body's plane of symmetry, sees little.
    """
    ends = np.array([(0, a, b * _GOLDEN) for a in (-1, 1) for b in (-1, 1)])
    vertices = np.concatenate([np.roll(ends, k, axis=1) for k in range(3)])
    turned: Array = Rotation.from_euler("xyz", _ASKEW).apply(vertices / np.linalg.norm(vertices[0]))
    return turned


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
        # dense at the ends, where pointed bodies are small
        offsets = place.min() + np.ptp(place) * (1 - np.cos(np.pi * (np.arange(number) + 0.5) / number)) / 2
        middle = points.mean(axis=0)
        base = middle + ((points @ along).min() - clearance - middle @ along) * along
        origin.append(base + (offsets - base @ spread)[:, None] * spread)
        sign = np.where(np.arange(number) % 2, -1.0, 1.0)
        x = sign[:, None] * moved
        y = np.broadcast_to(along, x.shape)
        axes.append(np.stack([x, y, np.cross(x, y)], axis=1))
    return Lines(np.concatenate(origin), np.concatenate(axes))


def aimed(contacts: Array, normals: Array, count: int, generator: np.random.Generator) -> Lines:
    """At most `count` lines aimed at the places where contacts leave most room for the body outside of their hull.

    The rod comes down on such a place along its normal, lying across it: it touches there first, wherever it slides afterwards.

    contacts, normals
        (n, 3) in rod lengths, and outward unit vectors (n, 3), NaN where they are unknown.
    """
    target, normal = open_places(contacts, normals, count)
    y = _around(normal, generator.uniform(0, 2 * np.pi, len(target)))
    return Lines(target - _TOUCHED * y, np.stack([normal, y, np.cross(normal, y)], axis=1))


def open_places(contacts: Array, normals: Array, count: int) -> tuple[Array, Array]:
    """Points and normals (k, 3), k <= count, of facets of the contacts' hull that leave most room, apart from each other.

    The room is the height above the middle of a facet at which the tangent planes at its three corners end it.
    """
    qhull = ConvexHull(contacts)
    faces, outward = qhull.simplices, qhull.equations[:, :3]
    corners = contacts[faces]
    target, size = corners.mean(axis=1), np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    height = ((corners - target[:, None]) * normals[faces]).sum(axis=2)
    slope = (outward[:, None] * normals[faces]).sum(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(slope > 0, height / slope, np.inf).min(axis=1)
    room = np.clip(room, 0.0, size)
    turn = np.where(slope > 0, slope, 0.0).min(axis=1)  # cosine of the largest angle to a corner's normal
    tree, taken = cKDTree(target), np.zeros(len(target), dtype=bool)
    chosen: list[int] = []
    for facet in np.argsort(-room, kind="stable"):
        if len(chosen) == count:
            break
        if not taken[facet]:
            chosen.append(int(facet))
            near = np.array(tree.query_ball_point(target[facet], _APART * size[facet]))
            taken[near[outward[near] @ outward[facet] >= turn[facet]]] = True
    return target[chosen], outward[chosen]


def _around(direction: Array, angle: Array) -> Array:
    """Unit vectors (n, 3) across unit vectors (n, 3), turned about them by angles (n,)."""
    first, second = (np.array(axes) for axes in zip(*map(_across, direction), strict=True))
    turned: Array = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    return turned


def _across(direction: Array) -> tuple[Array, Array]:
    """Two unit vectors across a direction (3,) and across each other."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first)
    return first, np.cross(direction, first)
