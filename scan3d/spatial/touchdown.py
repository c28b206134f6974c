"""Where a straight rod on its path first touches a convex body, where it has passed the body, and the state at touch-down.

On a straight path of a clamp that does not turn, the body is seen along the rod as a convex figure in the plane, whose support
function is that of the body at the normals across the rod.  The clamp moves along a line in that plane, which enters the figure
and leaves it.  Where the contact would lie beyond the rod's tip, the path of the tip decides.  On other paths the distance of
the rod from the body along many directions shows where it comes near.  Newton's method makes both exact.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import NEGLIGIBLE, Array, Index, Mask
from scan3d.spatial.bodies import Body, cross, dot, sphere_directions, unit
from scan3d.spatial.equilibrium import Clamp

STRAIGHT = 1e-14
"""q² of a rod that counts as straight.  Zero would make the derivatives by q² singular."""
# Normals in all directions at which the body is evaluated for the path of a tip, and along which the distance of rod and body
# is evaluated on other than straight paths.
_SPHERE = sphere_directions(1500)
# Normals across a rod at which the figure is evaluated, and the rounds in which they close in on that of the touch-down.
_AROUND, _ROUNDS = 24, 4
# Places per step of other paths at which the distance is evaluated.
_PER_STEP = 2
# Rods that are evaluated at once, on straight paths and on others, so that the intermediate arrays stay small.
_RODS, _RODS_NEAR = 64, 2048
# Steps of Newton's method at most, the residual in rod lengths at which it ends, and distances and
# differences of axes at which a place counts as found, and a path as straight and not turning.
_STEPS, _EXACT, _FOUND = 60, 1e-13, 1e-10


class Paths:
    """Paths of m clamps with n samples: `position` (m, n, 3) and `axes` (m, 3, 3), or (m, n, 3, 3) for clamps that turn.

    Between the samples clamps move on straight lines and turn steadily.
    """

    def __init__(self, position: Array, axes: Array) -> None:
        self.samples = position.shape[1]
        self.position = position.transpose(2, 0, 1)  # (3, m, n)
        turning = axes.ndim == 4
        if turning and np.abs(axes - axes[:, :1]).max(initial=0.0) < _FOUND:
            axes, turning = axes[:, 0], False
        self._turn: Array | None = None
        self._axes = np.moveaxis(axes, (-2, -1), (0, 1))  # (3 axes, 3, m) or (3 axes, 3, m, n)
        if turning:
            relative = np.einsum("mnij,mnik->mnjk", axes[:, 1:], axes[:, :-1])
            turn = Rotation.from_matrix(relative.reshape(-1, 3, 3)).as_rotvec()
            self._turn = np.moveaxis(turn.reshape(len(axes), -1, 3), 2, 0)  # (3, m, n - 1), in the world
        steps = np.diff(self.position, axis=2)
        self.pace = np.sqrt(dot(steps, steps)).max(axis=1)
        if self._turn is not None:
            self.pace = self.pace + np.sqrt(dot(self._turn, self._turn)).max(axis=1)

    def clamp(self, lane: Index, progress: Array) -> Clamp:
        """Poses at `progress` (k,) along the paths `lane` (k,): the number of a sample, and a fraction of the step after it."""
        number, part = self._step(progress)
        begin, end = self.position[:, lane, number], self.position[:, lane, number + 1]
        position = begin + part * (end - begin)
        if self._turn is None:
            return Clamp(position, *self._axes[:, :, lane])
        turn = part * self._turn[:, lane, number]
        return Clamp(position, *(_turned(axis, turn) for axis in self._axes[:, :, lane, number]))

    def speed(self, lane: Index, progress: Array) -> tuple[Array, Array]:
        """Derivatives (3, k) of the clamp's position and of the undeformed rod's direction by the progress."""
        number, _ = self._step(progress)
        speed = self.position[:, lane, number + 1] - self.position[:, lane, number]
        if self._turn is None:
            return speed, np.zeros_like(speed)
        return speed, cross(self._turn[:, lane, number], self.clamp(lane, progress).y)

    def straight(self) -> tuple[Mask, Array]:
        """Which paths (m,) are straight lines of clamps that do not turn, and the samples' places (m, n) along them, 0 to 1."""
        start = self.position[:, :, :1]
        travel = self.position[:, :, -1:] - start
        with np.errstate(divide="ignore", invalid="ignore"):
            place = dot(self.position - start, travel) / dot(travel, travel)
            away = np.abs(start + place * travel - self.position).max(axis=(0, 2))
        straight = (away < _FOUND) & (np.diff(place, axis=1) > 0).all(axis=1)
        return np.asarray(straight & (self._turn is None)), place

    def _step(self, progress: Array) -> tuple[Index, Array]:
        # Newton's method may try places far off the path, such as of a straight rod along a face that it crosses
        number = np.clip(progress, 0, self.samples - 2).astype(np.intp)
        return number, progress - number


def _turned(vector: Array, turn: Array) -> Array:
    """Vectors (3, k) turned by rotation vectors (3, k): Rodrigues' formula."""
    angle = np.sqrt(dot(turn, turn))
    axis = turn / np.where(angle > 0, angle, 1.0)
    cos, sin = np.cos(angle), np.sin(angle)
    return np.asarray(vector * cos + cross(axis, vector) * sin + axis * (dot(axis, vector) * (1 - cos)))


class _Motion(NamedTuple):
    """Straight rods (3, k) on their paths, and their derivatives by the place on the path."""

    position: Array
    along: Array
    speed: Array
    turning: Array


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
    """Distance at which the straight rod has passed the body, to some thousandths."""
    s1: Array
    """Arc length of the touch-down: 1 for the tip."""
    feature: Index
    coordinates: Array
    """Place of the touch-down on the body."""


def passages(body: Body, position: Array, along: Array, travel: Array) -> Passage:
    """Passages of n straight rods of length 1 at `position` (3, n), in directions `along` (3, n), moving by `travel` (3, n)."""
    parts = [
        _passages(body, *(column[:, first : first + _RODS] for column in (position, along, travel)))
        for first in range(0, position.shape[1], _RODS)
    ]
    return Passage(*(np.concatenate(columns, axis=-1) for columns in zip(*parts, strict=True)))


def _passages(body: Body, position: Array, along: Array, travel: Array) -> Passage:
    def motion(rows: Index, part: Array) -> _Motion:
        way = travel[:, rows]
        return _Motion(position[:, rows] + part * way, along[:, rows], way, np.zeros_like(way))

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
    touches &= s1 > 0
    begin, end = np.where(touches, begin, np.nan), np.where(touches, end, np.nan)
    return Passage(touches, begin, end, s1, feature, coordinates)


def _of_line(body: Body, position: Array, along: Array, travel: Array, sign: float) -> _Place:
    """Where the infinite line of each rod enters the body (sign -1) or leaves it (1)."""
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
    place = distance[best, rows]
    feature, coordinates, point = body.extreme(n[:, best, rows])
    return _Place(place, dot(along, point - position - place * travel), feature, coordinates)


def _ray(body: Body, start: Array, travel: Array) -> tuple[Array, Array, Index, Index]:
    """Where points enter and leave the polyhedron of `_SPHERE` about the body, and the numbers of the planes there."""
    height = dot(body.extreme(_SPHERE)[2], _SPHERE)
    rate, gap = _SPHERE.T @ travel, height[:, None] - _SPHERE.T @ start
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = gap / rate
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
        _check_begin(number[passage.touches & (passage.begin < -NEGLIGIBLE) & (passage.end > 0)])
        rows = np.flatnonzero(passage.touches & (passage.begin >= -NEGLIGIBLE) & (passage.begin < 1))
        number = number[rows]
        begin = _progress(place[number], np.maximum(passage.begin[rows], 0.0))
        end = _progress(place[number], passage.end[rows])
        parts.append(Touch(number, begin, end, passage.s1[rows], passage.feature[rows], passage.coordinates[:, rows]))
    return Touch(*(np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)))


def later_touches(body: Body, paths: Paths, number: Index, progress: Array) -> Touch:
    """The next touch-downs of the paths `number` (k,) whose rods have come free of the body at `progress` (k,).

    A straight path crosses the body once.
    """
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
    none = np.zeros(0, dtype=np.intp)
    found = [Touch(none, np.zeros(0), np.zeros(0), np.zeros(0), none, np.zeros((3, 0)))]
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
        at, touches, speed = _crossing(body, paths, number[rows], grid[column], direction[rows, column])
        entering = touches & (speed < 0)
        before = entering & (at.progress < start[rows] - NEGLIGIBLE)
        if after is None:
            _check_begin(number[rows[before & (column == 0)]])
        good = entering & ~before
        chosen = rows[good]
        progress = np.maximum(at.progress[good], 0.0)
        begin = np.maximum(progress, grid[column[good]])
        end = _end(body, paths, number[chosen], grid, distance[chosen], direction[chosen], begin)
        found.append(Touch(number[chosen], progress, end, at.s1[good], at.feature[good], at.coordinates[:, good]))
        rows = rows[~good]
    return Touch(*(np.concatenate(part, axis=-1) for part in zip(*found, strict=True)))


def _end(
    body: Body, paths: Paths, number: Index, grid: Array, distance: Array, direction: Index, begin: Array
) -> Array:
    """Where straight rods that touch the body at `begin` (k,) have passed it; infinite if they do not before the path ends."""
    clear = (distance > 0) & (grid > begin[:, None])
    end = np.where(clear.any(axis=1), grid[np.argmax(clear, axis=1)], np.inf)
    rows = np.flatnonzero(np.isfinite(end))
    column = np.argmax(clear, axis=1)[rows] - 1
    at, touches, speed = _crossing(body, paths, number[rows], grid[column], direction[rows, column])
    leaves = touches & (speed > 0) & (at.progress > begin[rows])
    end[rows[leaves]] = at.progress[leaves]
    return end


def _distances(body: Body, paths: Paths, number: Index, grid: Array) -> tuple[Array, Index]:
    """Largest distances (k, g) of straight rods beyond the body over all directions, and the numbers of those directions.

    They are lower bounds of the true distances.
    """
    lane, progress = np.repeat(number, len(grid)), np.tile(grid, len(number))
    height = dot(body.extreme(_SPHERE)[2], _SPHERE)
    distance, direction = np.empty(len(lane)), np.empty(len(lane), dtype=np.intp)
    for first in range(0, len(lane), _RODS_NEAR):
        part = slice(first, first + _RODS_NEAR)
        clamp = paths.clamp(lane[part], progress[part])
        beyond = clamp.position.T @ _SPHERE
        beyond += np.minimum(clamp.y.T @ _SPHERE, 0.0)
        beyond -= height
        direction[part] = np.argmax(beyond, axis=1)
        distance[part] = np.take_along_axis(beyond, direction[part, None], axis=1)[:, 0]
    return distance.reshape(-1, len(grid)), direction.reshape(-1, len(grid))


def _crossing(body: Body, paths: Paths, number: Index, near: Array, direction: Index) -> tuple[_Place, Mask, Array]:
    """Where rods near the body touch it, along themselves or with their tips; of both, what is nearest to `near` (k,).

    With it whether they touch (k,), and their speed (k,) along the outward normal, per sample: below zero where they enter.
    """
    feature, coordinates, point = body.extreme(_SPHERE[:, direction])
    clamp = paths.clamp(number, near)
    start = _Place(near, np.clip(dot(clamp.y, point - clamp.position), 0.0, 1.0), feature, coordinates)
    every = np.arange(len(near))

    def motion(rows: Index, progress: Array) -> _Motion:
        clamp = paths.clamp(number[rows], progress)
        return _Motion(clamp.position, clamp.y, *paths.speed(number[rows], progress))

    def solved(tip: bool) -> tuple[_Place, Mask, Array]:
        place = _refined(body, motion, start, every >= 0, tip=tip)
        patch, at = body.patch(place.feature, place.coordinates), motion(every, place.progress)
        gap = np.abs(at.position + place.s1 * at.along - patch.point).max(axis=0)
        lean = dot(at.along, patch.normal)
        touches = (gap < _FOUND) & (place.progress <= paths.samples - 1)
        if tip:
            touches &= (np.abs(place.s1 - 1) < _FOUND) & (lean <= 0)
        else:
            touches &= (place.s1 > 0) & (place.s1 <= 1) & (np.abs(lean) < _FOUND)
        return place, touches, dot(at.speed + place.s1 * at.turning, patch.normal)

    along, touches, speed = solved(False)
    tip, tip_touches, tip_speed = solved(True)
    use_tip = tip_touches & (~touches | (np.abs(tip.progress - near) < np.abs(along.progress - near)))
    place = _Place(*(np.where(use_tip, b, a) for a, b in zip(along, tip, strict=True)))
    return place, touches | tip_touches, np.where(use_tip, tip_speed, speed)


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
