"""Where a straight rod that moves along a line first touches a convex body, and where it has passed the body.

Seen along the rod, the body is a convex figure in the plane, whose support function is that of the body at the normals across
the rod.  The clamp moves along a line in that plane, which enters the figure and leaves it.  Where the contact would lie beyond
the rod's tip, the path of the tip decides.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.spatial.bodies import Body, sphere_directions
from scan3d.spatial.vectors import cross, dot, unit

# Normals across a rod at which the figure is evaluated, and the rounds in which they close in on that of the touch-down.  More
# take longer; fewer leave Newton's method a worse start.
_AROUND, _ROUNDS = 24, 4
# Normals in all directions at which the body is evaluated for the path of a tip, likewise.
_SPHERE = sphere_directions(1500)
# Rods that are evaluated at once, so that the intermediate arrays stay small.
_BLOCK = 64
# Steps of Newton's method at most, and the residual in rod lengths at which it ends.
_STEPS, _EXACT = 60, 1e-13
# Residual at which a place counts as found.
_FOUND = 1e-10


class Passage(NamedTuple):
    """The part of each path (n,) in which the straight rod would lie in the body, and the touch-down at its beginning."""

    touches: Mask
    begin: Array
    """Distance along the path, in units of the travel, at which the rod touches the body; NaN if it does not."""
    end: Array
    """Distance at which the straight rod has passed the body, to some thousandths."""
    s1: Array
    """Arc length of the touch-down: 1 for the tip."""
    feature: Index
    coordinates: Array
    """Place of the touch-down on the body."""


class Motion(NamedTuple):
    """Straight rods (3, k) on their paths, and their derivatives by the place on the path."""

    position: Array
    along: Array
    speed: Array
    turning: Array


def passages(body: Body, position: Array, along: Array, travel: Array) -> Passage:
    """Passages of n straight rods of length 1 at `position` (3, n), in directions `along` (3, n), moving by `travel` (3, n)."""
    parts = [
        _passages(body, *(column[:, first : first + _BLOCK] for column in (position, along, travel)))
        for first in range(0, position.shape[1], _BLOCK)
    ]
    return Passage(*(np.concatenate(columns, axis=-1) for columns in zip(*parts, strict=True)))


def _passages(body: Body, position: Array, along: Array, travel: Array) -> Passage:
    begin, normal = _crossing(body, position, along, travel, -1.0)
    end, end_normal = _crossing(body, position, along, travel, 1.0)
    feature, coordinates, point = body.extreme(normal)
    s1 = dot(along, point - position - begin * travel)
    end_feature, end_coordinates, end_point = body.extreme(end_normal)
    end_s1 = dot(along, end_point - position - end * travel)
    touches = begin < end
    motion = _straight(position, along, travel)
    end, end_s1, _, _ = refined(body, motion, (end, end_s1, end_feature, end_coordinates), touches)
    begin, s1, feature, coordinates = refined(body, motion, (begin, s1, feature, coordinates), touches)
    enters_by_tip, leaves_by_tip = touches & (s1 > 1), touches & (end_s1 > 1)
    rows = np.flatnonzero(enters_by_tip | leaves_by_tip)
    if len(rows):
        tip_begin, tip_end, entry, leave = _ray(body, (position + along)[:, rows], travel[:, rows])
        touches[rows] &= (tip_begin < tip_end) | ~enters_by_tip[rows]
        tip = enters_by_tip[rows]
        begin[rows[tip]], s1[rows[tip]] = tip_begin[tip], 1.0
        feature[rows[tip]], coordinates[:, rows[tip]] = body.extreme(_SPHERE[:, entry[tip]])[:2]
        wanted = enters_by_tip & touches
        begin, s1, feature, coordinates = refined(body, motion, (begin, s1, feature, coordinates), wanted, tip=True)
        tip = leaves_by_tip[rows]
        end[rows[tip]] = _tip_end(body, motion, rows[tip], tip_end[tip], leave[tip])
        # a touch-down by a graze that the polyhedron of directions misses is over at once
        end[rows] = np.fmax(end[rows], begin[rows])
    touches &= s1 > 0
    begin, end = np.where(touches, begin, np.nan), np.where(touches, end, np.nan)
    return Passage(touches, begin, end, s1, feature, coordinates)


def _straight(position: Array, along: Array, travel: Array) -> Callable[[Index, Array], Motion]:
    """The motion (3, n) along straight lines, by the rows and the fractions of the travel."""

    def motion(rows: Index, part: Array) -> Motion:
        way = travel[:, rows]
        return Motion(position[:, rows] + part * way, along[:, rows], way, np.zeros_like(way))

    return motion


def _crossing(body: Body, position: Array, along: Array, travel: Array, sign: float) -> tuple[Array, Array]:
    """Where the infinite line of each rod enters the body (sign -1) or leaves it (1), and the normal (3, n) there."""
    across = unit(cross(along, travel))
    ahead = sign * cross(across, along)
    rows = np.arange(position.shape[1])
    middle, width = np.zeros(len(rows)), np.pi / 2
    for _ in range(_ROUNDS):
        angle = np.clip(middle + np.linspace(-width, width, _AROUND)[:, None], -np.pi / 2 + 1e-6, np.pi / 2 - 1e-6)
        n = np.cos(angle) * ahead[:, None] + np.sin(angle) * across[:, None]
        point = body.extreme(n.reshape(3, -1))[2].reshape(n.shape)
        distance = dot(n, point - position[:, None]) / dot(n, travel[:, None])
        best = np.argmax(distance, axis=0) if sign < 0 else np.argmin(distance, axis=0)
        middle, width = angle[best, rows], 3 * width / _AROUND
    return distance[best, rows], n[:, best, rows]


def _ray(body: Body, start: Array, travel: Array) -> tuple[Array, Array, Index, Index]:
    """Where points enter and leave the polyhedron of `_SPHERE` about the body, and the numbers of the planes there."""
    height = dot(body.extreme(_SPHERE)[2], _SPHERE)
    rate, gap = _SPHERE.T @ travel, height[:, None] - _SPHERE.T @ start
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = gap / rate
    inward, outward = np.where(rate < 0, distance, -np.inf), np.where(rate > 0, distance, np.inf)
    return inward.max(axis=0), outward.min(axis=0), np.argmax(inward, axis=0), np.argmin(outward, axis=0)


def _tip_end(body: Body, motion: Callable[[Index, Array], Motion], rows: Index, end: Array, plane: Index) -> Array:
    """Where the tips of the rods `rows` (k,) leave the body, from where they leave the polyhedron of `_SPHERE`."""
    feature, coordinates, _ = body.extreme(_SPHERE[:, plane])
    start = end, np.ones(len(end)), feature, coordinates
    result, _, feature, coordinates = refined(
        body, lambda some, part: motion(rows[some], part), start, np.isfinite(end), tip=True
    )
    patch, at = body.patch(feature, coordinates), motion(rows, result)
    found = np.abs(at.position + at.along - patch.point).max(axis=0) < _FOUND
    return np.where(found & (dot(at.speed, patch.normal) > 0), result, end)


def refined(
    body: Body,
    motion: Callable[[Index, Array], Motion],
    start: tuple[Array, Array, Index, Array],
    wanted: Mask,
    *,
    tip: bool = False,
) -> tuple[Array, Array, Index, Array]:
    """Touch-downs improved by Newton's method: the rod's point is the body's, and the rod is tangential or ends there.

    `motion` gives straight rods by their rows and their places on their paths; `start` are places, arc lengths, features and
    coordinates (k,), of which the `wanted` are improved.
    """
    begin, s1, feature, coordinates = start[0].copy(), start[1].copy(), start[2].copy(), start[3].copy()
    rows = np.flatnonzero(wanted)
    for _ in range(_STEPS):
        if not len(rows):
            break
        s, here = s1[rows], (feature[rows], coordinates[:, rows])
        patch, at = body.patch(*here), motion(rows, begin[rows])
        jacobian, residual = np.zeros((len(rows), 4, 4)), np.zeros((len(rows), 4))
        residual[:, :3] = (at.position + s * at.along - patch.point).T
        for k, column in enumerate((at.speed + s * at.turning, at.along, -patch.point_1, -patch.point_2)):
            jacobian[:, :3, k] = column.T
        if tip:
            residual[:, 3], jacobian[:, 3, 1] = s - 1, 1.0
        else:
            residual[:, 3], jacobian[:, 3, 0] = dot(patch.normal, at.along), dot(patch.normal, at.turning)
            jacobian[:, 3, 2], jacobian[:, 3, 3] = dot(patch.normal_1, at.along), dot(patch.normal_2, at.along)
        open_rows = np.abs(residual).max(axis=1) > _EXACT
        # a place on an edge or a face that the rod is parallel to has no unique solution: the point is kept
        jacobian[:, range(4), range(4)] += 1e-14
        step = np.asarray(-np.linalg.solve(jacobian, residual[:, :, None])[:, :, 0], dtype=float)
        step[~(np.isfinite(step).all(axis=1) & open_rows)] = 0.0
        moved = body.moved(*here, patch, step[:, 2:].T)
        begin[rows], s1[rows] = begin[rows] + moved[2] * step[:, 0], s + moved[2] * step[:, 1]
        feature[rows], coordinates[:, rows] = moved[0], moved[1]
        rows = rows[open_rows]
    return begin, s1, feature, coordinates
