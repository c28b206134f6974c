"""Quasi-static sweeps of round rods in space past a convex body, with Coulomb friction, many sweeps in lockstep (4).

Every sweep is a lane of the arrays.  A round is one step of Newton's method in every lane, each at its own place of its own
path.  What it leads to is accepted as the state at the lane's target, or goes on, or has failed.  A failed step is tried on the
other branches of Coulomb's law, then with half its length; a step that cannot be halved further is a snap, and the lane follows
the overdamped flow, at a fixed clamp, to the next equilibrium or off the body.  So no lane waits for another.

Where a straight rod on its path first touches a convex body, where it has passed the body, and the state at touch-down.

On a straight path of a clamp that does not turn, the body is seen along the rod as a convex figure in the plane, whose support
function is that of the body at the normals across the rod.  The clamp moves along a line in that plane, which enters the figure
and leaves it.  Where the contact would lie beyond the rod's tip, the path of the tip decides.  Newton's method makes
both exact.  Other paths are straight from sample to sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import planar
from scan3d.arrays import NEGLIGIBLE, Array, Index, Mask, ratio
from scan3d.spatial.bodies import LARGEST_TURN, Body, Patch, cross, dot, sphere_directions, unit
from scan3d.spatial.equilibrium import Bent, Clamp, Law, Mode, System, bent, system, wrench

STRAIGHT = 1e-14
"""q² of a rod that counts as straight.  Zero would make the derivatives by q² singular."""
# Normals in all directions at which the body is evaluated for the path of a tip.
_SPHERE = sphere_directions(1500)
# Normals across a rod at which the figure is evaluated; they close in on that of the touch-down.
_AROUND = 24
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
    columns = position, along, travel
    # 64 rods at once, so that the intermediate arrays stay small
    blocks = [slice(first, first + 64) for first in range(0, max(position.shape[1], 1), 64)]
    parts = [_passages(body, *(column[:, block] for column in columns)) for block in blocks]
    return Passage(*(np.concatenate(part, axis=-1) for part in zip(*parts, strict=True)))


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


# Steps of Newton's method with the direction of the slip frozen, where the slip is not known from the step before.
_FROZEN_STEPS = 2
# Steps of Newton's method from one sample to the next before a sweep is given up, as happens at snaps.
_EFFORT = 800
# Successive steps of Newton's method that would bend the rod the other way, after which a step fails.
_LARGEST_STRAIGHTENED = 3
# Successive steps of Newton's method that do not halve the residual, after which a step fails: at folds they never do.
_STALLED = 16
# Smallest step, in samples, before the rod is taken to snap.
_SMALLEST = 2.0**-5
# Steps of the flow of a snap at most.
_FLOW_STEPS = 60


class End(IntEnum):
    """How a sweep ended."""

    PATH = 0
    """At the end of its path, in contact."""
    NO_TOUCH = 1
    """The rod passed the body without touching it."""
    OFF = 2
    """The rod lost contact, smoothly or by a snap."""
    LOST = 3
    """The computation found no equilibrium, and no way to one."""
    NEAR = 4
    """Where the contact came too near to the clamp."""
    SNAP = 5
    """Where the rod snaps, if that is not followed."""


@dataclass(frozen=True)
class Sweeps:
    """m sweeps of n samples, dimensionless; NaN where nothing touches."""

    force: Array
    """(m, n, 3) support reaction in the clamp's frame."""
    moment: Array
    """(m, n, 3) clamping moment likewise."""
    point: Array
    """(m, n, 3) contact of the rod's centre line, in the world."""
    normal: Array
    """(m, n, 3) outward normal of the body there."""
    tangent: Array
    """(m, n, 3) tangent of the rod there, towards the tip."""
    s1: Array
    """(m, n) arc length of the contact."""
    phase: NDArray[np.int8]
    """(m, n) of `planar.Phase`."""
    sticks: Mask
    """(m, n) whether the contact did not slip in the step to this sample."""
    stable: Mask
    """(m, n) whether the equilibrium is stable: no branch forks or folds between touch-down and it.  In a mirror plane of the
    body the rod can be followed on after it has become unstable; a real one leaves the plane there."""
    snapped: Mask
    """(m, n) whether the rod snapped since the sample before."""
    steps: NDArray[np.int32]
    """(m, n) steps of the solution since the sample before, or since the touch-down."""
    end: NDArray[np.int8]
    """(m,) of `End`."""


def sweep(
    body: Body,
    position: ArrayLike,
    axes: ArrayLike,
    friction: ArrayLike = 0.0,
    *,
    substeps: int = 1,
    nearest: float = 0.0,
    snaps: bool = True,
) -> Sweeps:
    """Sweeps of a round rod of length 1 past a convex body.

    position
        (m, n, 3) clamp at the samples; it moves on a straight line from each to the next.
    axes
        (m, 3, 3) axes of the clamps in the world, as rows: x, y along the undeformed rod, and z.
    friction
        coefficient of friction: one number, (m,) or (m, n).
    substeps
        steps from one sample to the next.  Without friction the result does not depend on them; with friction its error falls
        in proportion to the steps.
    nearest
        arc length of the contact below which a sweep ends (`End.NEAR`), since the clamp would soon hit the body.
    snaps
        whether sweeps are followed past snaps; else they end there (`End.SNAP`).  To which of several equilibria a rod snaps
        may hang on rounding, as where it lies in a plane of symmetry.

    A rod that has lost contact touches again where its path leads it back.  Raises ValueError for paths that begin in the body.
    """
    place, mu = np.asarray(position, dtype=float), np.asarray(friction, dtype=float)
    mu = np.broadcast_to(mu[:, None] if mu.ndim == 1 else mu, place.shape[:2])
    lanes = _Lanes(body, Paths(place, np.asarray(axes, dtype=float)), mu, substeps, nearest, snaps)
    touch = first_touches(body, lanes.paths)
    while len(touch.number):
        touch = later_touches(body, lanes.paths, *lanes.run(touch))
    s1 = lanes.results.s1
    touching = np.where(s1 < 1 - planar.TOLERANCE, planar.Phase.TANGENTIAL, planar.Phase.TIP)
    lanes.results.phase[:] = np.where(np.isfinite(s1), touching, planar.Phase.NONE)
    return lanes.results


def _untouched(sweeps: int, samples: int) -> Sweeps:
    """m sweeps of n samples without a contact."""

    def vectors() -> Array:
        return np.full((3, sweeps, samples), np.nan).transpose(1, 2, 0)  # each component in one piece

    def flags() -> Mask:
        return np.zeros((sweeps, samples), dtype=bool)

    return Sweeps(
        force=vectors(),
        moment=vectors(),
        point=vectors(),
        normal=vectors(),
        tangent=vectors(),
        s1=np.full((sweeps, samples), np.nan),
        phase=np.zeros((sweeps, samples), dtype=np.int8),
        sticks=flags(),
        stable=flags(),
        snapped=flags(),
        steps=np.zeros((sweeps, samples), dtype=np.int32),
        end=np.full(sweeps, End.NO_TOUCH, dtype=np.int8),
    )


@dataclass
class _States:
    """Lanes (k,) under way: where each of them is, what it tries, and how that goes."""

    number: Index
    """Sweep; below zero for a lane that has ended, until it is dropped."""
    progress: Array
    """Place on the path: number of a sample and fraction of the step after it."""
    target: Array
    """Place at which the equations are being solved."""
    step: Array
    """Largest step from place to place, in samples."""
    halved: Mask
    """Whether it was halved since the last place."""
    clear_after: Array
    """Place after which the straight rod has passed the body."""

    state: Array
    """(4, k) unknowns of the rod at `progress`."""
    feature: Index
    coordinates: Array
    """(3, k) place of the contact on the body."""
    point: Array
    """(3, k) contact."""
    slip_direction: Array
    """(3, k) direction of the last slip."""

    trial_state: Array
    trial_feature: Index
    trial_coordinates: Array
    """What Newton's method has reached for `target`."""

    last_change: Array
    """(4, k) change of the unknowns in the step before,"""
    last_coordinates: Array
    """(3, k) place on the body before that step,"""
    last_step: Array
    """and its length in samples; zero if it does not serve for a prediction."""

    mode: NDArray[np.int8]
    """Branch of Coulomb's law, of `Mode`, that is tried."""
    branches: Index
    """Branches that failed in this step."""
    frozen: Index
    """Steps of Newton's method that begin with the slip's direction frozen."""
    iterations: Index
    """Steps of Newton's method so far."""
    least: Array
    """Size of the residual that no later one was half of,"""
    stalled: Index
    """and steps of Newton's method since."""
    straightened: Index
    """Successive steps of Newton's method that would bend the rod the other way: it lifts off."""

    effort: Index
    """Steps of Newton's method since the last sample."""

    drag: Array
    """Drag on the slip while a snap is followed, else zero."""
    flow_steps: Index
    """Steps of the flow of this snap."""
    has_snapped: Mask
    """Whether the rod has snapped since the last sample."""
    steps_taken: Index
    """Steps since the last sample."""

    def keep(self, kept: Mask) -> None:
        """Drop the other lanes."""
        for column in fields(self):
            setattr(self, column.name, getattr(self, column.name)[..., kept])

    def begin(self, rows: Index) -> None:
        """Begin to count the steps of Newton's method of these lanes."""
        self.iterations[rows] = self.straightened[rows] = self.stalled[rows] = 0
        self.least[rows] = np.inf

    def restart(self, rows: Index) -> None:
        """Begin the step of these lanes again, from the state before."""
        self.begin(rows)
        self.frozen[rows] = _FROZEN_STEPS
        self.trial_state[:, rows] = self.state[:, rows]
        self.trial_feature[rows], self.trial_coordinates[:, rows] = self.feature[rows], self.coordinates[:, rows]


class _Lanes:
    """Sweeps past `body` on `paths` with coefficients of friction (m, n), in steps of one sample over `substeps`."""

    def __init__(self, body: Body, paths: Paths, friction: Array, substeps: int, nearest: float, snaps: bool) -> None:
        self.body, self.paths, self.friction = body, paths, friction
        self.results = _untouched(*friction.shape)
        self._longest, self._nearest, self._snaps = 1.0 / substeps, nearest, snaps
        self._last = paths.samples - 1
        # steps of Newton's method before a step fails: on a polyhedron each ends at the border of a face, an edge or a vertex
        self._patience = 9 if body.smooth else 25

    def run(self, touch: Touch) -> tuple[Index, Array]:
        """Follow sweeps from their touch-downs to the end of their contacts.

        Returns the numbers of the sweeps that lost contact before the end of the path, and the places where they did.
        """
        self._lanes = self._started(touch)
        self._left = [(touch.number[:0], touch.progress[:0])]
        while len(self._lanes.number):
            self._round()
        number, progress = (np.concatenate(column) for column in zip(*self._left, strict=True))
        return number, progress

    def _started(self, touch: Touch) -> _States:
        """Lanes (k,) at touch-down."""
        count = len(touch.number)
        patch = self.body.patch(touch.feature, touch.coordinates)
        clamp = self.paths.clamp(touch.number, touch.progress)
        speed = self.paths.speed(touch.number, touch.progress)
        friction = self.friction[touch.number, self._sample_after(touch.progress)]
        state = first_state(patch.normal, touch.s1, clamp, speed, friction)
        force = bent(state, clamp).force

        def zeros() -> Index:
            return np.zeros(count, dtype=np.intp)

        lanes = _States(
            number=touch.number,
            progress=touch.progress,
            target=touch.progress,
            step=np.full(count, self._longest),
            halved=np.zeros(count, dtype=bool),
            clear_after=touch.clear_after,
            state=state,
            feature=touch.feature,
            coordinates=touch.coordinates,
            point=patch.point,
            slip_direction=dot(force, patch.law_normal) * patch.law_normal - force,
            trial_state=state.copy(),
            trial_feature=touch.feature.copy(),
            trial_coordinates=touch.coordinates.copy(),
            last_change=np.zeros((4, count)),
            last_coordinates=touch.coordinates.copy(),
            last_step=np.zeros(count),
            mode=np.full(count, Mode.SLIDE, dtype=np.int8),
            branches=zeros(),
            frozen=np.full(count, _FROZEN_STEPS),
            iterations=zeros(),
            least=np.full(count, np.inf),
            stalled=zeros(),
            straightened=zeros(),
            effort=zeros(),
            drag=np.zeros(count),
            flow_steps=zeros(),
            has_snapped=np.zeros(count, dtype=bool),
            steps_taken=zeros(),
        )
        lanes.target = self._next(lanes)
        self._bend(lanes, np.arange(count))
        return lanes

    def _next(self, lanes: _States) -> Array:
        """The end of the next step: no farther than the next sample."""
        return np.asarray(np.minimum(np.floor(lanes.progress + NEGLIGIBLE) + 1, lanes.progress + lanes.step))

    def _sample_after(self, progress: Array) -> Index:
        return np.asarray(np.minimum(np.ceil(progress - NEGLIGIBLE).astype(np.intp), self._last))

    def _bend(self, lanes: _States, rows: Index) -> None:
        """Bend the straight rods among `rows` at first by what the body pushes them aside, to begin Newton's method with."""
        rows = rows[lanes.state[2, rows] < 100 * STRAIGHT]
        if not len(rows):
            return
        s1 = lanes.state[3, rows]
        before, after = (self.paths.clamp(lanes.number[rows], at[rows]) for at in (lanes.progress, lanes.target))
        normal = self.body.patch(lanes.feature[rows], lanes.coordinates[:, rows]).normal
        lanes.trial_state[2, rows] = first_bend(
            -dot(after.position - before.position, normal), lanes.state[1, rows], s1
        )

    def _round(self) -> None:
        lanes = self._lanes
        rod = bent(lanes.trial_state, self.paths.clamp(lanes.number, lanes.target))
        patch = self.body.patch(lanes.trial_feature, lanes.trial_coordinates)
        step = np.maximum(lanes.target - lanes.progress, 1e-12)
        friction = self.friction[lanes.number, self._sample_after(lanes.target)]
        frozen = (lanes.mode == Mode.SLIDE) & (lanes.iterations < lanes.frozen)
        mode = np.where(frozen, np.int8(Mode.FROZEN), lanes.mode)
        # the slip of a contact that sticks weighs ten times its part of the step
        law = Law(friction, lanes.point, lanes.state[3], mode, lanes.slip_direction, 10 / step, lanes.drag)
        equations = system(lanes.trial_state, rod, patch, law)
        size = np.abs(equations.residual).max(axis=0)
        # in rod lengths and unit forces: rounding, which Newton's method reaches in one step from its root
        solved = (size < 1e-11) & (~frozen | (friction == 0))
        accepted = solved & self._valid(equations, friction, patch.point, step)
        halves = size < lanes.least / 2
        lanes.least, lanes.stalled = np.where(halves, size, lanes.least), np.where(halves, 0, lanes.stalled + 1)
        failed = solved | ~np.isfinite(size) | (lanes.iterations >= self._patience) | (lanes.stalled >= _STALLED)
        failed = (failed | (lanes.straightened >= _LARGEST_STRAIGHTENED)) & ~accepted
        going = np.flatnonzero(~(accepted | failed))
        if len(going):
            self._newton_step(going, equations, patch)
        retried = failed & (friction > 0) & (lanes.drag == 0) & (lanes.branches < 2)
        if retried.any():
            self._try_other_branch(np.flatnonzero(retried))
            failed &= ~retried
        if accepted.any():
            self._accept(np.flatnonzero(accepted), rod, patch, equations)
        if failed.any():
            self._fail(np.flatnonzero(failed))
        lanes.effort += 1
        self._finish(np.flatnonzero(lanes.effort > _EFFORT), End.LOST)
        kept = lanes.number >= 0
        if not kept.all():
            lanes.keep(kept)

    def _newton_step(self, rows: Index, equations: System, patch: Patch) -> None:
        """Improve the trial states of the lanes `rows`, within the states that a bent rod can have."""
        lanes = self._lanes
        jacobian, right = equations.jacobian[:, :, rows].transpose(2, 0, 1), equations.residual[:, rows].T[:, :, None]
        try:
            solved = np.linalg.solve(jacobian, right)
        except np.linalg.LinAlgError:
            # singular to the last bit, which a shift by rounding ends
            solved = np.linalg.solve(jacobian + 1e-12 * np.eye(6), right)
        step = -solved[:, :, 0].T
        if not self.body.smooth:
            # on a small piece where equilibria are unstable, as the sphere about a vertex, the path of equilibria runs back
            step *= np.where(np.linalg.det(jacobian) < 0, -1.0, 1.0)
        state = lanes.trial_state[:, rows]
        part = 1 / np.maximum(1.0, np.abs(step[:2]).max(axis=0) / LARGEST_TURN)
        part = np.minimum(part, np.where(step[3] < 0, ratio(-state[3], step[3]) / 2, np.inf))
        here = Patch(*(column[:, rows] for column in patch))
        feature, coordinates, taken = self.body.moved(
            lanes.trial_feature[rows], lanes.trial_coordinates[:, rows], here, part * step[4:]
        )
        before = state[2]
        state = state + taken * part * step[:4]
        # a force at a larger angle pulls the rod straight
        state[1] = np.clip(state[1], -3.1, 3.1)
        limit = np.cos(state[1] / 2) ** 2
        lanes.straightened[rows] = np.where(state[2] <= STRAIGHT, lanes.straightened[rows] + 1, 0)
        # at the limit of q², cos²(α/2), the rod is infinitely long: half the way there instead of nearly all of it
        state[2] = np.where(state[2] >= 0.999 * limit, (before + limit) / 2, np.maximum(state[2], STRAIGHT))
        state[2] = np.minimum(state[2], 0.9999 * limit)
        lanes.trial_state[:, rows] = state
        lanes.trial_feature[rows], lanes.trial_coordinates[:, rows] = feature, coordinates
        lanes.iterations[rows] += 1

    def _valid(self, equations: System, friction: Array, point: Array, step: Array) -> Mask:
        """Which solutions are equilibria on the branch that they were sought on, next to the last ones."""
        lanes = self._lanes
        flowing = lanes.drag > 0
        valid = (equations.normal_force > 0) & (lanes.trial_state[2] > 2 * STRAIGHT)
        held = equations.friction_force <= friction * equations.normal_force * (1 + NEGLIGIBLE)
        against_slip = (equations.dissipated >= 0) | (friction == 0) | flowing
        valid &= np.where(equations.sticks, held, against_slip)
        path = point - lanes.point
        # in rod lengths, and in paths of the clamp: farther solutions are on other branches
        reach = np.maximum(0.08, 3 * step * self.paths.pace[lanes.number])
        # a rod that first lies along a face or an edge may touch it anywhere
        anywhere = flowing | (lanes.state[2] <= 2 * STRAIGHT)
        return np.asarray(valid & ((np.sqrt(dot(path, path)) < reach) | anywhere))

    def _try_other_branch(self, rows: Index) -> None:
        """Begin these lanes' step again on another branch of Coulomb's law: two of them at touch-down, else one."""
        lanes = self._lanes
        self._restart(rows)
        lanes.branches[rows] += 1
        start = lanes.state[2, rows] <= 2 * STRAIGHT
        other = np.where(lanes.mode[rows] == Mode.SLIDE, Mode.STICK, Mode.SLIDE)
        lanes.mode[rows] = np.where((lanes.branches[rows] == 2) & start, Mode.EITHER, other)
        lanes.branches[rows[~start]] = 2

    def _restart(self, rows: Index) -> None:
        self._lanes.restart(rows)
        self._bend(self._lanes, rows)

    def _accept(self, rows: Index, rod: Bent, patch: Patch, equations: System) -> None:
        """Make the trial states of these lanes their states, and go on from there."""
        lanes = self._lanes
        flowing = lanes.drag[rows] > 0
        tangential = equations.tangential_force[:, rows]
        size = np.sqrt(dot(tangential, tangential))
        lanes.slip_direction[:, rows] = np.where(
            size > NEGLIGIBLE, -tangential / np.maximum(size, NEGLIGIBLE), lanes.slip_direction[:, rows]
        )
        lanes.last_change[:, rows] = lanes.trial_state[:, rows] - lanes.state[:, rows]
        lanes.last_coordinates[:, rows] = lanes.coordinates[:, rows]
        lanes.last_step[rows] = np.where(flowing, 0.0, lanes.target[rows] - lanes.progress[rows])
        lanes.state[:, rows], lanes.feature[rows] = lanes.trial_state[:, rows], lanes.trial_feature[rows]
        lanes.coordinates[:, rows], lanes.point[:, rows] = lanes.trial_coordinates[:, rows], patch.point[:, rows]
        lanes.begin(rows)
        if flowing.any():
            self._flow(rows[flowing], equations)
            rows = rows[~flowing]

        lanes.progress[rows] = lanes.target[rows]
        lanes.steps_taken[rows] += 1
        irregular = lanes.has_snapped[rows] | equations.sticks[rows]
        sample = np.round(lanes.progress[rows]).astype(np.intp)
        reached = np.abs(lanes.progress[rows] - sample) < NEGLIGIBLE
        self._record(rows[reached], sample[reached], rod, patch, equations)
        # a step that is as long as the one that failed would fail where branches of equilibria fold
        longer = np.minimum(2 * lanes.step[rows], self._longest)
        lanes.step[rows], lanes.halved[rows] = np.where(lanes.halved[rows], lanes.step[rows], longer), False
        lanes.target[rows] = self._next(lanes)[rows]
        lanes.mode[rows], lanes.branches[rows], lanes.frozen[rows] = Mode.SLIDE, 0, _FROZEN_STEPS
        self._predict(rows[(lanes.last_step[rows] > 0) & ~irregular])
        self._finish(rows[lanes.progress[rows] > self._last - NEGLIGIBLE], End.PATH)
        self._finish(rows[reached & (lanes.state[3, rows] < self._nearest)], End.NEAR)

    def _record(self, rows: Index, sample: Index, rod: Bent, patch: Patch, equations: System) -> None:
        """Record the lanes `rows` (k,) at the samples (k,) that they have reached, and begin to count anew."""
        lanes, results = self._lanes, self.results
        at = lanes.number[rows], sample
        force, moment = wrench(lanes.state[:, rows], rod.length[rows])
        results.force[at], results.moment[at] = force.T, moment.T
        results.point[at], results.normal[at] = patch.point[:, rows].T, patch.normal[:, rows].T
        results.tangent[at], results.s1[at] = rod.tangent[:, rows].T, lanes.state[3, rows]
        results.sticks[at] = equations.sticks[rows]
        # positive from touch-down, and zero where branches of equilibria fork or fold
        results.stable[at] = np.linalg.det(equations.jacobian[:, :, rows].transpose(2, 0, 1)) > 0
        results.snapped[at], results.steps[at] = lanes.has_snapped[rows], lanes.steps_taken[rows]
        lanes.has_snapped[rows], lanes.steps_taken[rows], lanes.effort[rows] = False, 0, 0

    def _predict(self, rows: Index) -> None:
        """Begin a step where the last one leads to, in proportion to their lengths."""
        if not self.body.smooth:
            return
        lanes = self._lanes
        factor = (lanes.target[rows] - lanes.progress[rows]) / lanes.last_step[rows]
        state = lanes.state[:, rows] + factor * lanes.last_change[:, rows]
        fits = (state[2] > 0) & (state[2] < 0.99 * np.cos(state[1] / 2) ** 2) & (state[3] > 0)
        rows, factor = rows[fits], factor[fits]
        lanes.trial_state[:, rows] = state[:, fits]
        here = lanes.coordinates[:, rows]
        lanes.trial_coordinates[:, rows] = unit(here + factor * (here - lanes.last_coordinates[:, rows]))
        lanes.frozen[rows] = 0

    def _fail(self, rows: Index) -> None:
        """Halve the steps of these lanes; those that are too short then end at a lift-off or begin to snap."""
        lanes = self._lanes
        lanes.mode[rows], lanes.branches[rows] = Mode.SLIDE, 0
        target, clear, bend = lanes.target[rows], lanes.clear_after[rows], lanes.state[2, rows]
        short = target - lanes.progress[rows] <= 0.25
        # the lift-off, if the straight rod is clear of the body (places and steps in samples), the rod nearly straight (by q²),
        # and the step short
        off = (target >= clear - 0.02) & (bend < 0.1) & short
        straightened = lanes.straightened[rows] >= _LARGEST_STRAIGHTENED
        # or if Newton's method straightens a rod that is even less bent, and the straight rod is nearly clear
        off |= (target >= clear - 1.0) & (bend > 2 * STRAIGHT) & (bend < 0.02) & straightened
        flowing = lanes.drag[rows] > 0
        flow = rows[flowing]
        lanes.drag[flow] *= 4.0  # what failed is tried with a quarter of the slip
        lanes.mode[flow] = Mode.EITHER
        lanes.flow_steps[flow] += 1
        halved = rows[~flowing & ~off]
        lanes.step[halved], lanes.halved[halved] = (lanes.target[halved] - lanes.progress[halved]) / 2, True
        snaps = lanes.step[halved] < _SMALLEST
        self._snap(halved[snaps])
        lanes.target[halved[~snaps]] = self._next(lanes)[halved[~snaps]]
        self._restart(rows)
        self._leave(rows[off])
        if not self._snaps:
            self._finish(halved[snaps], End.SNAP)
        # eight failures in succession lead beyond this drag
        self._finish(flow[(lanes.flow_steps[flow] > _FLOW_STEPS) | (lanes.drag[flow] > 1e4)], End.LOST)

    def _snap(self, rows: Index) -> None:
        """Begin to follow the overdamped flow from states that no equilibrium follows."""
        lanes = self._lanes
        # in unit forces per rod length: the slip of the first step, which later ones adapt, is a part of the rod
        lanes.drag[rows], lanes.mode[rows], lanes.flow_steps[rows] = 0.3, Mode.EITHER, 0
        progress = lanes.progress[rows]
        # half a sample beyond the fold, so that the flow is not slow there
        lanes.target[rows] = np.minimum(np.floor(progress + NEGLIGIBLE) + 1, progress + 0.5)

    def _flow(self, rows: Index, equations: System) -> None:
        """Take the next step of a snap: longer where the last one was short, and end at an equilibrium."""
        lanes = self._lanes
        slip, sticks = equations.slip[rows], equations.sticks[rows]
        lanes.flow_steps[rows] += 1
        # longer steps where the last one was shorter than 2 % of the rod, faster than shorter ones where it was not
        lanes.drag[rows] *= np.where(slip < 0.02, 1 / 3, 1.5)
        # at rest nothing slips, though hardly any drag holds it back
        rests = ((slip < 1e-7) & (lanes.drag[rows] < 1e-3)) | sticks
        ended = rows[rests]
        lanes.drag[ended], lanes.has_snapped[ended], lanes.step[ended] = 0.0, True, _SMALLEST
        lanes.mode[ended] = np.where(sticks[rests], Mode.STICK, Mode.SLIDE)
        # less than a twentieth of the force is along the normal
        leaves = ~rests & (equations.normal_force[rows] < 0.05)
        clear = lanes.target[rows] >= lanes.clear_after[rows]
        self._leave(rows[leaves & clear])
        self._finish(rows[(leaves & ~clear) | (~rests & (lanes.flow_steps[rows] > _FLOW_STEPS))], End.LOST)

    def _leave(self, rows: Index) -> None:
        """End the contact of lanes whose rod has come free of the body."""
        self._left.append((self._lanes.number[rows], self._lanes.target[rows]))
        self._finish(rows, End.OFF)

    def _finish(self, rows: Index, end: End) -> None:
        rows = rows[self._lanes.number[rows] >= 0]
        self.results.end[self._lanes.number[rows]] = end
        self._lanes.number[rows] = -1
