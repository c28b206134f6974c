"""Rasters of straight sweeps in space about a body on a table: from those directions of `rasters` that lie above it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from scan3d.arrays import Array
from scan3d.geometry.hulls import hull
from scan3d.geometry.segments import segments_meet
from scan3d.planning.rasters import icosahedron

# How far the clamp may be drawn back along the rod, in rod lengths, so that the rod's tip stays above the table, for the lowest
# of the level lines.  Larger, they hardly reach the body; smaller, more of its foot is left out.
_RAISED = 0.3
# Part of the rod, from its tip, that must enter the body somewhere on a line, and the places where that is looked up.  Smaller,
# sweeps are made in which only the tip can touch; larger, steep ones are left out.
_LEAST, _PLACES_ALONG = 0.1, 65
# Directions of the rod that are tried for a place to which a sweep is aimed, and the sine of the slope by which it must at
# least point down.
_TRIED, _LEVEL = 16, 0.02
# Places about a line at which the width of the body is looked up.
_PLACES = 17


class Line(NamedTuple):
    """A straight sweep: where it begins and ends (3,), and the clamp's axes (3, 3) as rows."""

    start: Array
    end: Array
    axes: Array


class _Raster(NamedTuple):
    """What the lines from one direction have in common; lengths in the user's unit."""

    body: Any
    """A convex `trimesh.Trimesh` around the body."""
    points: Array
    """(n, 3) in which it lies."""
    along: Array
    """(3,) of the rod, which points down."""
    length: float
    clearance: float
    margin: float
    beyond: float
    """How far the clamp goes on past the body."""
    floor: float


def rasters_above(
    points: Array, count: int, length: float, distances: tuple[float, float, float], floor: float
) -> list[Line]:
    """About `count` lines from each direction above the table.

    points (n, 3)
        corners of a polyhedron in which the body lies.
    length
        of the rod, in the unit of the points.
    distances
        in rod lengths: of the clamp from the body along the rod, of the rod from the body at both ends of the line, and how far
        the clamp goes on past the body.
    floor
        height above which clamp and straight rod stay.

    The first lines of a direction move across the slope of the rod and up and down along it, the others level.  A line whose
    rod would hit the table is drawn back along the rod; one that then does not reach the body is left out.
    """
    clearance, margin, beyond = (length * part for part in distances)
    body = hull(points)
    lines = []
    for direction in icosahedron():
        if direction[2] <= 0:
            continue
        raster = _Raster(body, points, -direction, length, clearance, margin, beyond, floor)
        level = np.cross([0.0, 0.0, 1.0], raster.along)
        level /= np.linalg.norm(level)
        slope = np.cross(raster.along, level)
        widths = [float(np.ptp(points @ axis)) for axis in (level, slope)]
        number = max(1, round(count * widths[0] / sum(widths)))
        first = _lines(raster, level, slope, number)
        lines += first + _lines(raster, slope, level, max(1, count - len(first)))
    return lines


def lines_to(
    targets: Array,
    normals: Array,
    points: Array,
    length: float,
    distances: tuple[float, float, float],
    floor: float,
    random: np.random.Generator,
) -> list[Line]:
    """Lines to places (k, 3) of a body's surface with outward normals (k, 3), as in `rasters.aimed`, for a body on a table.

    The rod lies across the normal and comes down on the place along it; the other arguments are those of `rasters_above`.
    Places to which no such line leads from above the table are left out.
    """
    clearance, margin, beyond = (length * part for part in distances)
    body = hull(points)
    lines = []
    for target, normal in zip(targets, normals, strict=True):
        helper = np.eye(3)[np.argmin(np.abs(normal))]
        first = np.cross(normal, helper)
        first /= np.linalg.norm(first)
        second = np.cross(normal, first)
        for angle in random.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(_TRIED) / _TRIED:
            along = np.cos(angle) * first + np.sin(angle) * second
            if along[2] > -_LEVEL:
                continue
            raster = _Raster(body, points, along, length, clearance, margin, beyond, floor)
            spread = np.cross(normal, along)
            line = _line(raster, _base(raster), spread, normal, float(target @ spread))
            if (target - line.start) @ along <= (1 - _LEAST) * length:
                lines.append(line)
                break
    return lines


def _base(raster: _Raster) -> Array:
    """The place of a clamp whose rod points at the middle of the body, with the clearance from it."""
    middle = raster.points.mean(axis=0)
    depth = (raster.points @ raster.along).min() - raster.clearance
    return np.asarray(middle + (depth - middle @ raster.along) * raster.along)


def _lines(raster: _Raster, spread: Array, moved: Array, number: int) -> list[Line]:
    """`number` lines in the direction `moved`, every other one backwards, next to each other in the direction `spread`."""
    place, base = raster.points @ spread, _base(raster)
    lowest = place.min()
    if spread[2] > 0 and moved[2] == 0:
        # lower lines would have to be drawn back too far
        tip = base[2] + raster.length * raster.along[2] - (base @ spread) * spread[2]
        lowest = max(lowest, (raster.floor + _RAISED * raster.length * raster.along[2] - tip) / spread[2])
    lines = []
    for k, part in enumerate((1 - np.cos(np.pi * (np.arange(number) + 0.5) / number)) / 2):
        line = _line(raster, base, spread, -moved if k % 2 else moved, lowest + part * (place.max() - lowest))
        if _reaches(raster, line):
            lines.append(line)
    return lines


def _line(raster: _Raster, base: Array, spread: Array, x: Array, offset: float) -> Line:
    """The line against the direction `x` of the clamp, at an offset along `spread`, as far back as the table demands."""
    high, low = _extent(raster, spread, x, offset)
    origin = base + (offset - base @ spread) * spread
    ends = (high + raster.margin, low - raster.margin - raster.beyond)
    start, end = (origin + (value - origin @ x) * x for value in ends)
    lowest_point = min(start[2], end[2]) + raster.length * raster.along[2]
    raised = max(raster.floor - lowest_point, 0.0) / -raster.along[2]
    axes = np.stack([x, raster.along, np.cross(x, raster.along)])
    return Line(start - raised * raster.along, end - raised * raster.along, axes)


def _reaches(raster: _Raster, line: Line) -> bool:
    """Whether the straight rod enters the body by a part of its length somewhere on the line."""
    places = line.start + np.linspace(0, 1, _PLACES_ALONG)[:, None] * (line.end - line.start)
    along = np.broadcast_to(raster.along, places.shape)
    return bool(segments_meet(raster.body, places, along, (1 - _LEAST) * raster.length).any())


def _extent(raster: _Raster, spread: Array, moved: Array, offset: float) -> tuple[float, float]:
    """Largest and smallest coordinate along `moved` of the body near a line at an offset along `spread`."""
    figure = np.stack([raster.points @ spread, raster.points @ moved], axis=1)
    corners = figure[ConvexHull(figure).vertices]
    at = np.clip(offset + raster.margin * np.linspace(-1, 1, _PLACES), corners[:, 0].min(), corners[:, 0].max())
    ends = []
    for sign in (1.0, -1.0):
        # the chain of corners that lies above, or below, the line through both ends of the figure
        order = np.lexsort((-sign * corners[:, 1], corners[:, 0]))
        chain = _chain(corners[order], sign)
        ends.append(sign * (sign * np.interp(at, chain[:, 0], chain[:, 1])).max())
    return ends[0], ends[1]


def _chain(corners: Array, sign: float) -> Array:
    """The upper (sign 1) or lower (-1) border of a convex figure as a polyline, from its corners in order of their places."""
    kept: list[Array] = []
    for corner in corners:
        if kept and kept[-1][0] == corner[0]:
            continue
        while len(kept) >= 2 and _turn(kept[-2], kept[-1], corner) * sign >= 0:
            kept.pop()
        kept.append(corner)
    return np.array(kept)


def _turn(first: Array, second: Array, third: Array) -> float:
    a, b = second - first, third - second
    return float(a[0] * b[1] - a[1] * b[0])
