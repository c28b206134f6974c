"""Where a straight rod on its path first touches a convex body, where it has passed the body, and the state at touch-down.

On a straight path of a clamp that does not turn, the body is seen along the rod as a convex figure in the plane, whose support
function is that of the body at the normals across the rod.  The clamp moves along a line in that plane, which enters the figure
and leaves it.  Where the contact would lie beyond the rod's tip, the path of the tip decides.  Newton's method makes
both exact.  Other paths are straight from sample to sample.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from scan3d.arrays import NEGLIGIBLE, Array, Index, Mask, ratio
from scan3d.spatial.bodies import Body, cross, dot, sphere_directions, unit
from scan3d.spatial.equilibrium import Clamp

STRAIGHT = 1e-14
"""q² of a rod that counts as straight.  Zero would make the derivatives by q² singular."""
# Normals in all directions at which the body is evaluated for the path of a tip.
_SPHERE = sphere_directions(1500)
# Normals across a rod at which the figure is evaluated; they close in on that of the touch-down.
_AROUND = 24
# Rods that are evaluated at once, so that the intermediate arrays stay small.
_RODS = 64
# Distance in rod lengths at which a place counts as found.
_FOUND = 1e-10


class Paths:
    """Paths of m clamps that do not turn, straight from each of n samples to the next: (m, n, 3), with axes (m, 3, 3)."""

    def __init__(self, position: Array, axes: Array) -> None:
        self.samples = position.shape[1]
        self.position = position.transpose(2, 0, 1)  # (3, m, n)
        self._axes = np.moveaxis(axes, (-2, -1), (0, 1))  # (3 axes, 3, m)
        steps = np.diff(self.position, axis=2)
        self.pace = np.sqrt(dot(steps, steps)).max(axis=1)

    def clamp(self, lane: Index, progress: Array) -> Clamp:
        """Poses at `progress` (k,) along the paths `lane` (k,): the number of a sample, and a fraction of the step after it."""
        # Newton's method may try places far off the path, such as of a straight rod along a face that it crosses
        number = np.clip(progress, 0, self.samples - 2).astype(np.intp)
        begin, end = self.position[:, lane, number], self.position[:, lane, number + 1]
        return Clamp(begin + (progress - number) * (end - begin), *self._axes[:, :, lane])

    def speed(self, lane: Index, progress: Array) -> Array:
        """Derivatives (3, k) of the clamp's position by the progress."""
        number = np.clip(progress, 0, self.samples - 2).astype(np.intp)
        return np.asarray(self.position[:, lane, number + 1] - self.position[:, lane, number])

    def straight(self) -> tuple[Mask, Array]:
        """Which paths (m,) are straight lines, and the samples' places (m, n) along them, from 0 to 1."""
        start = self.position[:, :, :1]
        travel = self.position[:, :, -1:] - start
        with np.errstate(divide="ignore", invalid="ignore"):
            place = dot(self.position - start, travel) / dot(travel, travel)
            away = np.abs(start + place * travel - self.position).max(axis=(0, 2))
        return np.asarray((away < _FOUND) & (np.diff(place, axis=1) > 0).all(axis=1)), place


class _Motion(NamedTuple):
    """Straight rods (3, k) on their paths, and their derivatives by the place on the path."""

    position: Array
    along: Array
    speed: Array


_Moving = Callable[[Index, Array], _Motion]
"""The motion of straight rods by their rows (k,) and their places (k,) on their paths."""


class _Place(NamedTuple):
    """Where straight rods (k,) touch the body: place on the path, arc length, feature and coordinates (3, k)."""

    progress: Array
    s1: Array
    feature: Index
    coordinates: Array


class Passage(NamedTuple):
    """The part of each path (n,) in which the straight rod would lie in the body, and the touch-down at its beginning."""

    touches: Mask
    begin: Array
    """Distance along the path, in units of the travel, at which the rod touches the body; NaN if it does not."""
    end: Array
    """Distance at which the straight rod has passed the body, to some thousandths; NaN if the path does not cross the body."""
    s1: Array
    """Arc length of the touch-down: 1 for the tip."""
    feature: Index
    coordinates: Array
    """Place of the touch-down on the body."""


def passages(body: Body, position: Array, along: Array, travel: Array) -> Passage:
    """Passages of n straight rods of length 1 at `position` (3, n), in directions `along` (3, n), moving by `travel` (3, n)."""
    parts = [
        _passages(body, *(column[:, first : first + _RODS] for column in (position, along, travel)))
        for first in range(0, max(position.shape[1], 1), _RODS)
    ]
    return Passage(*(np.concatenate(columns, axis=-1) for columns in zip(*parts, strict=True)))


def _passages(body: Body, position: Array, along: Array, travel: Array) -> Passage:
    def motion(rows: Index, part: Array) -> _Motion:
        way = travel[:, rows]
        return _Motion(position[:, rows] + part * way, along[:, rows], way)

    entry, leave = (_of_line(body, position, along, travel, sign) for sign in (-1.0, 1.0))
    touches = entry.progress < leave.progress
    leave, entry = (_refined(body, motion, place, touches) for place in (leave, entry))
    begin, s1, feature, coordinates = entry
    end = leave.progress
    enters_by_tip, leaves_by_tip = touches & (s1 > 1), touches & (leave.s1 > 1)
    rows = np.flatnonzero(enters_by_tip | leaves_by_tip)
    if len(rows):
        tip_begin, tip_end, entered, left = _ray(body, (position + along)[:, rows], travel[:, rows])
        touches[rows] &= (tip_begin < tip_end) | ~enters_by_tip[rows]
        tip = enters_by_tip[rows]
        begin[rows[tip]], s1[rows[tip]] = tip_begin[tip], 1.0
        feature[rows[tip]], coordinates[:, rows[tip]] = body.extreme(_SPHERE[:, entered[tip]])[:2]
        begin, s1, feature, coordinates = _refined(body, motion, entry, enters_by_tip & touches, tip=True)
        tip = leaves_by_tip[rows]
        end[rows[tip]] = _tip_end(body, motion, rows[tip], tip_end[tip], left[tip])
        # a touch-down by a graze that the polyhedron of directions misses is over at once
        end[rows] = np.fmax(end[rows], begin[rows])
    end = np.where(touches, end, np.nan)
    touches &= s1 > 0
    return Passage(touches, np.where(touches, begin, np.nan), end, s1, feature, coordinates)


def _of_line(body: Body, position: Array, along: Array, travel: Array, sign: float) -> _Place:
    """Where the infinite line of each rod enters the body (sign -1) or leaves it (1)."""
    across = unit(cross(along, travel))
    ahead = sign * cross(across, along)
    rows = np.arange(position.shape[1])
    middle, width = np.zeros(len(rows)), np.pi / 2
    for _ in range(4):
        angle = np.clip(middle + np.linspace(-width, width, _AROUND)[:, None], -np.pi / 2 + 1e-6, np.pi / 2 - 1e-6)
        n = np.cos(angle) * ahead[:, None] + np.sin(angle) * across[:, None]
        point = body.extreme(n.reshape(3, -1))[2].reshape(n.shape)
        distance = dot(n, point - position[:, None]) / dot(n, travel[:, None])
        best = np.argmax(distance, axis=0) if sign < 0 else np.argmin(distance, axis=0)
        middle, width = angle[best, rows], 3 * width / _AROUND
    place = distance[best, rows]
    feature, coordinates, point = body.extreme(n[:, best, rows])
    return _Place(place, dot(along, point - position - place * travel), feature, coordinates)


def _ray(body: Body, start: Array, travel: Array) -> tuple[Array, Array, Index, Index]:
    """Where points enter and leave the polyhedron of `_SPHERE` about the body, and the numbers of the planes there."""
    height = dot(body.extreme(_SPHERE)[2], _SPHERE)
    rate, gap = _SPHERE.T @ travel, height[:, None] - _SPHERE.T @ start
    distance = ratio(gap, rate)
    inward, outward = np.where(rate < 0, distance, -np.inf), np.where(rate > 0, distance, np.inf)
    return inward.max(axis=0), outward.min(axis=0), np.argmax(inward, axis=0), np.argmin(outward, axis=0)


def _tip_end(body: Body, motion: _Moving, rows: Index, end: Array, plane: Index) -> Array:
    """Where the tips of the rods `rows` (k,) leave the body, from where they leave the polyhedron of `_SPHERE`."""
    feature, coordinates, _ = body.extreme(_SPHERE[:, plane])
    start = _Place(end, np.ones(len(end)), feature, coordinates)
    place = _refined(body, lambda some, part: motion(rows[some], part), start, np.isfinite(end), tip=True)
    patch, at = body.patch(place.feature, place.coordinates), motion(rows, place.progress)
    found = np.abs(at.position + at.along - patch.point).max(axis=0) < _FOUND
    return np.where(found & (dot(at.speed, patch.normal) > 0), place.progress, end)


def _refined(body: Body, motion: _Moving, start: _Place, wanted: Mask, *, tip: bool = False) -> _Place:
    """The `wanted` places improved by Newton's method: the rod's point is the body's, and it is tangential or ends there."""
    begin, s1 = start.progress.copy(), start.s1.copy()
    feature, coordinates = start.feature.copy(), start.coordinates.copy()
    rows = np.flatnonzero(wanted)
    for _ in range(60):
        if not len(rows):
            break
        s, here = s1[rows], (feature[rows], coordinates[:, rows])
        patch, at = body.patch(*here), motion(rows, begin[rows])
        jacobian, residual = np.zeros((len(rows), 4, 4)), np.zeros((len(rows), 4))
        residual[:, :3] = (at.position + s * at.along - patch.point).T
        for k, column in enumerate((at.speed, at.along, -patch.point_1, -patch.point_2)):
            jacobian[:, :3, k] = column.T
        if tip:
            residual[:, 3], jacobian[:, 3, 1] = s - 1, 1.0
        else:
            residual[:, 3] = dot(patch.normal, at.along)
            jacobian[:, 3, 2], jacobian[:, 3, 3] = dot(patch.normal_1, at.along), dot(patch.normal_2, at.along)
        open_rows = np.abs(residual).max(axis=1) > 1e-13
        # a place on an edge or a face that the rod is parallel to has no unique solution: the point is kept
        jacobian[:, range(4), range(4)] += 1e-14
        step = np.asarray(-np.linalg.solve(jacobian, residual[:, :, None])[:, :, 0], dtype=float)
        step[~(np.isfinite(step).all(axis=1) & open_rows)] = 0.0
        moved = body.moved(*here, patch, step[:, 2:].T)
        begin[rows], s1[rows] = begin[rows] + moved[2] * step[:, 0], s + moved[2] * step[:, 1]
        feature[rows], coordinates[:, rows] = moved[0], moved[1]
        rows = rows[open_rows]
    return _Place(begin, s1, feature, coordinates)


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
    """The first touch-down of every path that has one.  Raises ValueError if a rod is in the body from the beginning."""
    straight, place = paths.straight()
    rows = np.flatnonzero(straight)
    clamp = paths.clamp(rows, np.zeros(len(rows)))
    passage = passages(body, clamp.position, clamp.y, paths.position[:, rows, -1] - clamp.position)
    _check_begin(rows[passage.touches & (passage.begin < -NEGLIGIBLE) & (passage.end > 0)])
    found = np.flatnonzero(passage.touches & (passage.begin >= -NEGLIGIBLE) & (passage.begin < 1))
    place = place[rows[found]]
    begin, end = _progress(place, np.maximum(passage.begin[found], 0.0)), _progress(place, passage.end[found])
    on_lines = Touch(rows[found], begin, end, passage.s1[found], passage.feature[found], passage.coordinates[:, found])
    others = np.flatnonzero(~straight)
    parts = on_lines, later_touches(body, paths, others, np.full(len(others), -1.0))
    return Touch(*(np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)))


def later_touches(body: Body, paths: Paths, number: Index, after: Array) -> Touch:
    """The next touch-downs, after some places (k,), of the paths `number` (k,): each of their steps is a straight path.

    Of a path that is straight there is none, as it crosses the body once.
    """
    chosen = ~paths.straight()[0][number]
    number, after = number[chosen], after[chosen, None]
    count = paths.samples - 1
    lane, step = np.repeat(number, count), np.tile(np.arange(float(count)), len(number))
    clamp = paths.clamp(lane, step)
    passage = passages(body, clamp.position, clamp.y, paths.speed(lane, step))
    _check_begin(lane[passage.touches & (step == 0) & (passage.begin < -NEGLIGIBLE) & (passage.end > 0)])
    enters, leaves = (
        np.where((part >= -NEGLIGIBLE) & (part < 1), step + part, np.inf).reshape(-1, count)
        for part in (passage.begin, passage.end)
    )
    enters[enters < after] = np.inf
    begin, rows = enters.min(axis=1), np.flatnonzero(np.isfinite(enters).any(axis=1))
    begin = np.maximum(begin[rows], 0.0)
    end = np.where(leaves[rows] > begin[:, None], leaves[rows], np.inf).min(axis=1)
    at = rows * count + enters[rows].argmin(axis=1)
    return Touch(number[rows], begin, end, passage.s1[at], passage.feature[at], passage.coordinates[:, at])


def _check_begin(number: Index) -> None:
    if len(number):
        raise ValueError(f"the rod must not be in the body at the beginning of a sweep, as it is in sweep {number[0]}")


def _progress(place: Array, wanted: Array) -> Array:
    """Places (k,) in samples of fractions of straight paths whose samples are at the fractions (k, n); beyond them likewise."""
    step = np.minimum((place[:, 1:] <= wanted[:, None]).sum(axis=1), place.shape[1] - 2)
    rows = np.arange(len(place))
    return np.asarray(step + (wanted - place[rows, step]) / (place[rows, step + 1] - place[rows, step]))


def first_state(normal: Array, s1: Array, clamp: Clamp, motion: Array, friction: Array) -> Array:
    """States (4, n) of straight rods that begin to touch a body with outward normals (3, n) at arc lengths (n,).

    The direction of the contact force is that in the limit of no bending (S22).  `motion` (3, n) is that of the straight rod's
    point at the contact.  The rod yields only across itself: it slips along the direction across rod and normal, or, where
    friction withstands that, bends against the motion.
    """
    along = clamp.y
    motion = motion / np.sqrt(dot(motion, motion))
    n_along = dot(normal, along)
    lateral = normal - n_along * along
    size = np.sqrt(dot(lateral, lateral))
    ahead = -dot(motion, lateral) / size
    w = cross(normal, along) / size
    side = dot(motion, w)
    slides = np.abs(side) > ahead * friction / size
    # sliding across the rod: friction against it; else the force across the rod is against the motion, and friction along it
    sliding = normal - friction * np.sign(side) * w
    across = -(motion - dot(motion, along) * along)
    force_w = dot(across, w) / np.maximum(dot(across, lateral / size), 1e-12) * size
    # the tangent of the surface in the plane of normal and rod
    t = (along - n_along * normal) / size
    force_t = np.sqrt(np.maximum(friction**2 - force_w**2, 0.0))
    sticking = normal + force_w * w + force_t * t
    force = np.where(slides, sliding, sticking)
    force /= np.sqrt(dot(force, force))
    along_part = dot(force, along)
    across_part = force - along_part * along
    omega = np.arctan2(dot(across_part, clamp.z), dot(across_part, clamp.x))
    alpha = np.arctan2(np.sqrt(dot(across_part, across_part)), -along_part)
    return np.stack([omega, alpha, np.full(len(s1), STRAIGHT), s1])


def first_bend(depth: Array, alpha: Array, s1: Array) -> Array:
    """``q²`` (n,) of straight rods pushed aside by `depth` (n,): that of a slightly bent cantilever, within reason.

    A lateral force g bends it by ``g s1³/3`` with the moment ``g s1``, so that ``q² = m0²/(4 f)`` is 3/4 sin α depth/s1.
    """
    return np.asarray(np.minimum(0.75 * np.maximum(np.sin(alpha), 0.1) * np.maximum(depth, 1e-12) / s1, 0.1))
