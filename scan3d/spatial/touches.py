"""Touch-downs of straight rods on paths of any form, and where they have passed the body.

Straight paths of clamps that do not turn cross the body once, which `touching` finds.  On other paths the distance of the rod
from the body along many directions shows where it comes near, and Newton's method gives the touch-down within the step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.spatial.bodies import Body, sphere_directions
from scan3d.spatial.paths import Paths
from scan3d.spatial.touching import Motion, passages, refined
from scan3d.spatial.vectors import dot

# Directions along which the distance of rod and body is evaluated.  Fewer miss more of the slightest touches.
_DIRECTIONS = sphere_directions(1500)
# Rods that are evaluated at once, so that the intermediate arrays stay small.
_BLOCK = 2048
# Places per step of the path at which the rod is looked at.
_PER_STEP = 2
# Residual in rod lengths at which a touch-down counts as found, and the part of a step that is rounding.
_FOUND, _ROUNDING = 1e-10, 1e-9
# Samples before the path's beginning down to which a touch-down is recognised, to say that the rod begins in the body.
_INSIDE = 1e6


class Touch(NamedTuple):
    """Touch-downs (k,): the rod is straight and enters the body from there on."""

    number: Index
    """Sweep."""
    progress: Array
    """Place on the path: number of a sample and fraction of the step after it."""
    clear_after: Array
    """Place at which the straight rod has passed the body."""
    s1: Array
    feature: Index
    coordinates: Array
    """Place of the touch-down on the body."""


def first_touches(body: Body, paths: Paths) -> Touch:
    """The first touch-down of every path that has one.

    Raises ValueError if a rod is in the body from the beginning.
    """
    straight, place = paths.straight()
    number = np.flatnonzero(straight)
    parts = [_next_touches(body, paths, np.flatnonzero(~straight), None)]
    if len(number):
        clamp = paths.clamp(number, np.zeros(len(number)))
        travel = paths.position[:, number, -1] - clamp.position
        passage = passages(body, clamp.position, clamp.y, travel)
        _check_begin(number[passage.touches & (passage.begin < -_ROUNDING) & (passage.end > 0)])
        rows = np.flatnonzero(passage.touches & (passage.begin >= -_ROUNDING) & (passage.begin < 1))
        number = number[rows]
        begin = _progress(place[number], np.maximum(passage.begin[rows], 0.0))
        end = _progress(place[number], passage.end[rows])
        parts.append(Touch(number, begin, end, passage.s1[rows], passage.feature[rows], passage.coordinates[:, rows]))
    return Touch(*(np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)))


def later_touches(body: Body, paths: Paths, number: Index, progress: Array) -> Touch:
    """The next touch-downs of the paths `number` (k,) whose rods have come free of the body at `progress` (k,)."""
    curved = ~paths.straight()[0][number]
    return _next_touches(body, paths, number[curved], progress[curved])


def _check_begin(number: Index) -> None:
    if len(number):
        raise ValueError(f"the rod must not be in the body at the beginning of a sweep, as it is in sweep {number[0]}")


def _progress(place: Array, wanted: Array) -> Array:
    """Places (k,) in samples of fractions of straight paths whose samples are at the fractions (k, n); beyond them likewise."""
    step = np.minimum((place[:, 1:] <= wanted[:, None]).sum(axis=1), place.shape[1] - 2)
    rows = np.arange(len(place))
    return np.asarray(step + (wanted - place[rows, step]) / (place[rows, step + 1] - place[rows, step]))


def _next_touches(body: Body, paths: Paths, number: Index, after: Array | None) -> Touch:
    """Touch-downs after some places on the paths; without them, from the beginning."""
    start = np.zeros(len(number)) if after is None else after
    grid = np.linspace(0, paths.samples - 1, _PER_STEP * (paths.samples - 1) + 1)
    distance, direction = _distances(body, paths, number, grid)
    found = []
    near = (distance <= 0) & (grid >= start[:, None])
    # a rod that is near from the beginning may come to touch or go away
    enters = near.copy()
    enters[:, 1:] &= ~near[:, :-1]
    rows, column = np.arange(len(number)), np.zeros(len(number), dtype=np.intp)
    while len(rows):
        column = np.where(enters[rows].any(axis=1), np.argmax(enters[rows], axis=1), len(grid))
        rows, column = rows[column < len(grid)], column[column < len(grid)]
        if not len(rows):
            break
        enters[rows, column] = False
        at = _crossing(body, paths, number[rows], grid[column], direction[rows, column])
        entering = at.touches & (at.speed < 0)
        before = entering & (at.progress < start[rows] - _ROUNDING)
        if after is None:
            _check_begin(number[rows[before & (column == 0)]])
        good = entering & ~before
        chosen = rows[good]
        progress = np.maximum(at.progress[good], 0.0)
        end = _end(
            body,
            paths,
            number[chosen],
            (distance[chosen], direction[chosen], grid),
            np.maximum(progress, grid[column[good]]),
        )
        found.append(Touch(number[chosen], progress, end, at.s1[good], at.feature[good], at.coordinates[:, good]))
        rows = rows[~good]
    if not found:
        none = np.zeros(0, dtype=np.intp)
        return Touch(none, np.zeros(0), np.zeros(0), np.zeros(0), none, np.zeros((3, 0)))
    return Touch(*(np.concatenate(part, axis=-1) for part in zip(*found, strict=True)))


def _end(body: Body, paths: Paths, number: Index, distances: tuple[Array, Index, Array], begin: Array) -> Array:
    """Where straight rods that touch the body at `begin` (k,) have passed it; infinite if they do not before the path ends."""
    distance, direction, grid = distances
    clear = (distance > 0) & (grid > begin[:, None])
    end = np.where(clear.any(axis=1), grid[np.argmax(clear, axis=1)], np.inf)
    rows = np.flatnonzero(np.isfinite(end))
    column = np.argmax(clear, axis=1)[rows] - 1
    at = _crossing(body, paths, number[rows], grid[column], direction[rows, column])
    leaves = at.touches & (at.speed > 0) & (at.progress > begin[rows])
    end[rows[leaves]] = at.progress[leaves]
    return end


def _distances(body: Body, paths: Paths, number: Index, grid: Array) -> tuple[Array, Index]:
    """Largest distances (k, g) of straight rods beyond the body over all directions, and the numbers of those directions.

    They are lower bounds of the true distances.
    """
    lane, progress = np.repeat(number, len(grid)), np.tile(grid, len(number))
    height = dot(body.extreme(_DIRECTIONS)[2], _DIRECTIONS)
    distance, direction = np.empty(len(lane)), np.empty(len(lane), dtype=np.intp)
    for first in range(0, len(lane), _BLOCK):
        part = slice(first, first + _BLOCK)
        clamp = paths.clamp(lane[part], progress[part])
        beyond = clamp.position.T @ _DIRECTIONS
        beyond += np.minimum(clamp.y.T @ _DIRECTIONS, 0.0)
        beyond -= height
        direction[part] = np.argmax(beyond, axis=1)
        distance[part] = np.take_along_axis(beyond, direction[part, None], axis=1)[:, 0]
    return distance.reshape(-1, len(grid)), direction.reshape(-1, len(grid))


class _Crossing(NamedTuple):
    touches: Mask
    progress: Array
    speed: Array
    """Speed of the rod along the outward normal, per sample: below zero where it enters the body."""
    s1: Array
    feature: Index
    coordinates: Array


def _crossing(body: Body, paths: Paths, number: Index, progress: Array, direction: Index) -> _Crossing:
    """Where rods near the body touch it, along themselves or with their tips; of both, what is nearest to `progress` (k,)."""
    feature, coordinates, point = body.extreme(_DIRECTIONS[:, direction])
    clamp = paths.clamp(number, progress)
    start = progress, np.clip(dot(clamp.y, point - clamp.position), 0.0, 1.0), feature, coordinates

    def motion(rows: Index, progress: Array) -> Motion:
        clamp = paths.clamp(number[rows], progress)
        return Motion(clamp.position, clamp.y, *paths.speed(number[rows], progress))

    along, tip = (_solved(body, paths, motion, start, tip) for tip in (False, True))
    use_tip = tip.touches & (~along.touches | (np.abs(tip.progress - progress) < np.abs(along.progress - progress)))
    return _Crossing(*(np.where(use_tip, b, a) for a, b in zip(along, tip, strict=True)))


def _solved(
    body: Body,
    paths: Paths,
    motion: Callable[[Index, Array], Motion],
    start: tuple[Array, Array, Index, Array],
    tip: bool,
) -> _Crossing:
    every = np.arange(len(start[0]))
    progress, s1, feature, coordinates = refined(body, motion, start, every >= 0, tip=tip)
    patch, at = body.patch(feature, coordinates), motion(every, progress)
    gap = np.abs(at.position + s1 * at.along - patch.point).max(axis=0)
    lean = dot(at.along, patch.normal)
    touches = (gap < _FOUND) & (progress >= -_INSIDE) & (progress <= paths.samples - 1)
    touches &= (np.abs(s1 - 1) < _FOUND) & (lean <= 0) if tip else (s1 > 0) & (s1 <= 1) & (np.abs(lean) < _FOUND)
    return _Crossing(touches, progress, dot(at.speed + s1 * at.turning, patch.normal), s1, feature, coordinates)
