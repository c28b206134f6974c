"""The lanes of a simulation: each solves its equations by Newton's method, step by step along its path."""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.spatial.bodies import Body, Patch
from scan3d.spatial.equations import Law, Mode, System, system
from scan3d.spatial.shapes import Bent, Clamp, bent, wrench
from scan3d.spatial.touching import Passage
from scan3d.spatial.vectors import dot, unit

# Residual, in rod lengths and unit forces, at which the equations count as solved.
_SOLVED = 1e-11
# Steps of Newton's method before a lane halves its step, on a smooth body.
_PATIENCE = 9
# The same on a polyhedron, where a step ends at the border of a face, an edge or a vertex.
_PATIENCE_FEATURES = 40
# Steps of Newton's method with the direction of the slip frozen.
_FROZEN = 2
# Smallest step, in samples, before the rod is taken to snap.
_SMALLEST = 2.0**-5
# Steps of Newton's method from one sample to the next before a sweep is given up.
_EFFORT = 1500
# q² of a rod that counts as straight.
_STRAIGHT = 1e-14
# Largest path of the contact in a step, in rod lengths.
_REACH = 0.08
# Steps of the flow of a snap at most, and its largest drag.
_FLOW_STEPS, _LARGEST_DRAG = 120, 1e4
# Part of the force along the normal below which a rod that snaps leaves the body.
_LEAVES = 0.05


class Lanes:
    def __init__(
        self, body: Body, position: Array, axes: Array, friction: Array, passage: Passage, substeps: int
    ) -> None:
        self.body, self.substeps = body, substeps
        self.patience = _PATIENCE if body.smooth else _PATIENCE_FEATURES
        m, n = position.shape[:2]
        self.position = position.transpose(2, 0, 1)  # (3, m, n)
        self.axes = axes.transpose(1, 2, 0)  # (3 axes, 3, m)
        self.friction = friction
        self.passage = passage
        self.pace = np.sqrt(((position[:, -1] - position[:, 0]) ** 2).sum(axis=1)) / (n - 1)
        shape3 = (3, m, n)
        self.force, self.moment, self.point, self.normal, self.tangent = (np.full(shape3, np.nan) for _ in range(5))
        self.s1 = np.full((m, n), np.nan)
        self.sticks, self.snapped = np.zeros((m, n), dtype=bool), np.zeros((m, n), dtype=bool)
        self.end = np.where(passage.touches, 0, 1).astype(np.int8)
        self._begin(n)
        self.counts = dict(rounds=0, iterations=0, halved=0, snaps=0)

    def _begin(self, n: int) -> None:
        p = self.passage
        lanes = np.flatnonzero(p.touches & (p.begin < 1) & (p.begin >= 0))
        self.lane = lanes
        self.progress = p.begin[lanes] * (n - 1)
        self.clear_after = p.end[lanes] * (n - 1)
        feature, coordinates = p.feature[lanes], p.coordinates[:, lanes]
        patch = self.body.patch(feature, coordinates)
        state = first_state(patch.normal, p.s1[lanes], self._axes(lanes), self._travel(lanes), self.friction[lanes, 0])
        self.state, self.feature, self.coordinates = state, feature, coordinates
        force = bent(state, self._clamp_of(lanes, self.progress)).force
        self.direction = dot(force, patch.law_normal) * patch.law_normal - force
        self.place = patch.point
        k = len(lanes)
        self.h = np.full(k, 1.0 / self.substeps)
        self.iterations, self.lifts = np.zeros(k, dtype=int), np.zeros(k, dtype=int)
        self.drag, self.effort = np.zeros(k), np.zeros(k, dtype=int)
        self.frozen = np.full(k, _FROZEN)
        self.rate, self.coordinates_before, self.span = np.zeros((4, k)), coordinates.copy(), np.zeros(k)
        self.mode, self.attempts = np.full(k, Mode.SLIDE, dtype=np.int8), np.zeros(k, dtype=int)
        self.has_snapped = np.zeros(k, dtype=bool)
        self.flow_steps = np.zeros(k, dtype=int)
        self.trial_state, self.trial_feature, self.trial_coordinates = state.copy(), feature.copy(), coordinates.copy()
        self.target = self._next(self.progress)
        self._lift(np.ones(k, dtype=bool))

    def _axes(self, lanes: Index) -> Array:
        return self.axes[:, :, lanes]

    def _travel(self, lanes: Index) -> Array:
        return self.position[:, lanes, -1] - self.position[:, lanes, 0]

    def _next(self, progress: Array) -> Array:
        """The end of the next step: on the lane's grid of steps, no farther than h."""
        return np.minimum(np.floor(progress + 1e-9) + 1, progress + self.h)

    def _clamp(self, progress: Array) -> Clamp:
        return self._clamp_of(self.lane, progress)

    def _clamp_of(self, lane: Index, progress: Array) -> Clamp:
        k = np.minimum(progress.astype(int), self.position.shape[2] - 2)
        part = progress - k
        begin, end = self.position[:, lane, k], self.position[:, lane, k + 1]
        return Clamp(begin + part * (end - begin), *self.axes[:, :, lane])

    def _lift(self, rows: Mask) -> None:
        """A first guess of q for straight rods, from the distance by which the body pushes them aside."""
        flat = rows & (self.state[2] < 1e-12)
        if not flat.any():
            return
        move = self._clamp(self.target).position - self._clamp(self.progress).position
        patch = self.body.patch(self.feature, self.coordinates)
        depth = np.maximum(-dot(move, patch.normal), 1e-12)
        sin = np.maximum(np.sin(self.state[1]), 0.1)
        guess = np.minimum(0.75 * sin * depth / self.state[3], 0.1)
        self.trial_state[2] = np.where(flat, guess, self.trial_state[2])

    def run(self) -> None:
        while len(self.lane):
            self._round()

    def _round(self) -> None:
        clamp = self._clamp(self.target)
        rod = bent(self.trial_state, clamp)
        patch = self.body.patch(self.trial_feature, self.trial_coordinates)
        index = np.minimum(np.ceil(self.target - 1e-9).astype(int), self.position.shape[2] - 1)
        step = np.maximum(self.target - self.progress, 1e-12)
        friction = self.friction[self.lane, index]
        mode = np.where((self.mode == Mode.SLIDE) & (self.iterations < self.frozen), Mode.FROZEN, self.mode)
        law = Law(friction, self.place, self.state[3], mode, self.direction, 10 / step, self.drag)
        equations = system(self.trial_state, rod, patch, law)
        self.counts["rounds"] += 1
        self.counts["iterations"] += len(self.lane)
        size = np.abs(equations.residual).max(axis=0)
        solved = size < _SOLVED
        solved &= (mode != Mode.FROZEN) | (friction == 0)
        good = solved & (equations.normal_force > 0) & (self.trial_state[2] > 2 * _STRAIGHT)
        jump = patch.point - self.place
        held = equations.friction_force <= friction * equations.normal_force * (1 + 1e-9)
        good &= np.where(equations.sticks, held, (equations.dissipated >= 0) | (friction == 0) | (self.drag > 0))
        # a rod that first lies along a face or an edge may touch it anywhere
        free = (self.drag > 0) | (self.state[2] <= 2 * _STRAIGHT)
        good &= (np.sqrt(dot(jump, jump)) < np.maximum(_REACH, 3 * step * self.pace[self.lane])) | free
        bad = (solved & ~good) | ~np.isfinite(size) | (self.iterations >= self.patience) | (self.lifts >= 3)
        going = ~(good | bad)
        if going.any():
            self._newton(going, equations, patch)
        other = bad & ~good & (friction > 0) & (self.drag == 0) & (self.attempts < 2)
        if other.any():
            self._reset(np.flatnonzero(other))
            self.attempts[other] += 1
            start = self.state[2] <= 2 * _STRAIGHT
            third = np.where(self.mode == Mode.SLIDE, Mode.STICK, Mode.SLIDE)
            self.mode[other] = np.where((self.attempts == 2) & start, Mode.EITHER, third)[other]
            self.attempts[other & ~start] = 2
            bad &= ~other
        if good.any():
            self._commit(good, rod, patch, equations)
        if bad.any():
            self._fail(bad & ~good)
        self.effort += 1
        self._finish(np.flatnonzero((self.effort > _EFFORT) & (self.lane >= 0)), 3)
        keep = self.lane >= 0
        if not keep.all():
            self._drop(keep)

    def _newton(self, rows: Mask, equations: System, patch: Patch) -> None:
        chosen = np.flatnonzero(rows)
        jacobian = equations.jacobian[:, :, chosen].transpose(2, 0, 1)
        residual = equations.residual[:, chosen].T[:, :, None]
        try:
            step = -np.linalg.solve(jacobian, residual)[:, :, 0].T
        except np.linalg.LinAlgError:
            step = -np.linalg.solve(jacobian + 1e-12 * np.eye(6), residual)[:, :, 0].T
        if not self.body.smooth:
            # on a small piece where equilibria are unstable, such as the sphere about a vertex, the path of equilibria runs back
            step *= np.where(np.linalg.det(jacobian) < 0, -1.0, 1.0)
        state = self.trial_state[:, chosen]
        part = 1 / np.maximum(1.0, np.abs(step[:2]).max(axis=0) / 0.5)
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.minimum(part, np.where(step[3] < 0, -0.5 * state[3] / step[3], np.inf))
        here = Patch(*(column[:, chosen] for column in patch))
        feature, coordinates, taken = self.body.moved(
            self.trial_feature[chosen], self.trial_coordinates[:, chosen], here, part * step[4:]
        )
        state = state + taken * part * step[:4]
        state[1] = np.clip(state[1], -3.1, 3.1)
        limit = np.cos(state[1] / 2) ** 2
        self.lifts[chosen] = np.where(state[2] <= _STRAIGHT, self.lifts[chosen] + 1, 0)
        beyond = state[2] >= 0.999 * limit
        state[2] = np.where(beyond, (self.trial_state[2, chosen] + limit) / 2, np.maximum(state[2], _STRAIGHT))
        state[2] = np.minimum(state[2], 0.9999 * limit)
        self.trial_state[:, chosen] = state
        self.trial_feature[chosen], self.trial_coordinates[:, chosen] = feature, coordinates
        self.iterations[chosen] += 1

    def _commit(self, rows: Mask, rod: Bent, patch: Patch, equations: System) -> None:
        chosen = np.flatnonzero(rows)
        flowing = self.drag[chosen] > 0
        tangential = rod.force[:, chosen] - equations.normal_force[chosen] * patch.law_normal[:, chosen]
        size = np.sqrt(dot(tangential, tangential))
        self.direction[:, chosen] = np.where(
            size > 1e-9, -tangential / np.maximum(size, 1e-9), self.direction[:, chosen]
        )
        self.rate[:, chosen] = self.trial_state[:, chosen] - self.state[:, chosen]
        self.coordinates_before[:, chosen] = self.coordinates[:, chosen]
        self.span[chosen] = np.where(flowing, 0.0, self.target[chosen] - self.progress[chosen])
        self.state[:, chosen] = self.trial_state[:, chosen]
        self.feature[chosen] = self.trial_feature[chosen]
        self.coordinates[:, chosen] = self.trial_coordinates[:, chosen]
        self.place[:, chosen] = patch.point[:, chosen]
        self.iterations[chosen] = self.lifts[chosen] = 0
        if flowing.any():
            self._flow(chosen[flowing], equations)
            chosen = chosen[~flowing]
        self.progress[chosen] = self.target[chosen]
        index = np.round(self.progress[chosen]).astype(int)
        sample = np.abs(self.progress[chosen] - index) < 1e-9
        at, k = chosen[sample], index[sample]
        lane = self.lane[at]
        force, moment = wrench(self.state[:, at], rod.length[at])
        self.force[:, lane, k], self.moment[:, lane, k] = force, moment
        self.point[:, lane, k], self.normal[:, lane, k] = patch.point[:, at], patch.normal[:, at]
        self.tangent[:, lane, k], self.s1[lane, k] = rod.tangent[:, at], self.state[3, at]
        self.sticks[lane, k] = equations.sticks[at]
        self.snapped[lane, k] = self.has_snapped[at]
        snapped = self.has_snapped[chosen] | equations.sticks[chosen]
        self.has_snapped[at] = False
        self.effort[at] = 0
        self.h[chosen] = np.minimum(2 * self.h[chosen], 1.0 / self.substeps)
        done = chosen[self.progress[chosen] > self.position.shape[2] - 1 - 1e-9]
        self.target[chosen] = self._next(self.progress)[chosen]
        self.mode[chosen] = Mode.SLIDE
        self.attempts[chosen] = 0
        self.frozen[chosen] = _FROZEN
        self._predict(chosen[(self.span[chosen] > 0) & ~snapped])
        self._finish(done, 0)

    def _predict(self, chosen: Index) -> None:
        """Begin a step where the last one leads to, in proportion to their lengths."""
        if not self.body.smooth:
            return
        factor = (self.target[chosen] - self.progress[chosen]) / self.span[chosen]
        state = self.state[:, chosen] + factor * self.rate[:, chosen]
        fits = (state[2] > 0) & (state[2] < 0.99 * np.cos(state[1] / 2) ** 2) & (state[3] > 0)
        chosen, factor = chosen[fits], factor[fits]
        self.trial_state[:, chosen] = state[:, fits]
        here = self.coordinates[:, chosen]
        self.trial_coordinates[:, chosen] = unit(here + factor * (here - self.coordinates_before[:, chosen]))
        self.frozen[chosen] = 0

    def _reset(self, chosen: Index) -> None:
        """Begin the step again."""
        self.iterations[chosen] = self.lifts[chosen] = 0
        self.frozen[chosen] = _FROZEN
        self.trial_state[:, chosen] = self.state[:, chosen]
        self.trial_feature[chosen], self.trial_coordinates[:, chosen] = (
            self.feature[chosen],
            self.coordinates[:, chosen],
        )
        rows = np.zeros(len(self.lane), dtype=bool)
        rows[chosen] = True
        self._lift(rows)

    def _fail(self, rows: Mask) -> None:
        self.counts["halved"] += int(rows.sum())
        chosen = np.flatnonzero(rows)
        self.mode[chosen] = Mode.SLIDE
        self.attempts[chosen] = 0
        short, lifts = self.target[chosen] - self.progress[chosen] <= 0.25, self.lifts[chosen] >= 3
        off = (self.target[chosen] >= self.clear_after[chosen] - 0.02) & (self.state[2, chosen] < 0.1) & short
        off |= (self.target[chosen] >= self.clear_after[chosen] - 1) & (self.state[2, chosen] < 0.02) & lifts
        flowing = self.drag[chosen] > 0
        self.drag[chosen[flowing]] *= 4
        self.mode[chosen[flowing]] = Mode.EITHER
        self.flow_steps[chosen[flowing]] += 1
        steps = chosen[~flowing & ~off]
        self.h[steps] = (self.target[steps] - self.progress[steps]) / 2
        snap = steps[self.h[steps] < _SMALLEST]
        self.drag[snap] = 0.3
        self.mode[snap] = Mode.EITHER
        # beyond the fold by some more, so that the flow is not slow
        self.target[snap] = np.minimum(np.floor(self.progress[snap] + 1e-9) + 1, self.progress[snap] + 0.5)
        self.flow_steps[snap] = 0
        self.counts["snaps"] += len(snap)
        rest = steps[self.h[steps] >= _SMALLEST]
        self.target[rest] = self._next(self.progress)[rest]
        self._reset(chosen)
        self._finish(chosen[off], 2)
        lost = chosen[flowing & ((self.flow_steps[chosen] > _FLOW_STEPS) | (self.drag[chosen] > _LARGEST_DRAG))]
        self._finish(lost, 3)

    def _flow(self, chosen: Index, equations: System) -> None:
        """Take the next step of a snap: longer where the last one was short, and end at an equilibrium."""
        slip = equations.slip[chosen]
        self.flow_steps[chosen] += 1
        self.drag[chosen] = np.where(slip < 0.02, self.drag[chosen] / 3, self.drag[chosen] * 1.5)
        rest = ((slip < 1e-7) & (self.drag[chosen] < 1e-3)) | equations.sticks[chosen]
        ended = chosen[rest]
        self.drag[ended] = 0.0
        self.has_snapped[ended] = True
        self.h[ended] = _SMALLEST
        self.mode[ended] = np.where(equations.sticks[ended], Mode.STICK, Mode.SLIDE)
        leaves = ~rest & (equations.normal_force[chosen] < _LEAVES)
        clear = self.target[chosen] >= self.clear_after[chosen]
        self._finish(chosen[leaves & clear], 2)
        self._finish(chosen[(leaves & ~clear) | (~rest & (self.flow_steps[chosen] > _FLOW_STEPS))], 3)

    def _finish(self, chosen: Index, end: int) -> None:
        self.end[self.lane[chosen]] = end
        self.lane[chosen] = -1 - self.lane[chosen]

    def _drop(self, keep: Mask) -> None:
        for name in (
            "lane",
            "progress",
            "clear_after",
            "feature",
            "h",
            "frozen",
            "span",
            "attempts",
            "effort",
            "mode",
            "iterations",
            "lifts",
            "drag",
            "has_snapped",
            "flow_steps",
            "trial_feature",
            "target",
        ):
            setattr(self, name, getattr(self, name)[keep])
        for name in (
            "state",
            "coordinates",
            "coordinates_before",
            "rate",
            "direction",
            "place",
            "trial_state",
            "trial_coordinates",
        ):
            setattr(self, name, getattr(self, name)[:, keep])


def first_state(normal: Array, s1: Array, axes: Array, travel: Array, friction: Array) -> Array:
    """States (4, n) of straight rods at touch-down: the direction of the force by (S22)."""
    x, along, z = axes
    speed = np.sqrt(dot(travel, travel))
    motion = travel / speed
    n_along = dot(normal, along)
    lateral = normal - n_along * along
    size = np.sqrt(dot(lateral, lateral))
    ahead = -dot(motion, lateral) / size
    w = (
        np.stack(
            [
                normal[1] * along[2] - normal[2] * along[1],
                normal[2] * along[0] - normal[0] * along[2],
                normal[0] * along[1] - normal[1] * along[0],
            ]
        )
        / size
    )
    side = dot(motion, w)
    slides = np.abs(side) > ahead * friction / size
    # sliding across the rod: friction against it; else the force across the rod is against the motion, and friction along it
    sliding = normal - friction * np.sign(side) * w
    across = -(motion - dot(motion, along) * along)
    part = dot(across, w) / np.maximum(dot(across, lateral / size), 1e-12)
    g_w = part * size
    # the tangent of the surface in the plane of normal and rod
    t = (along - n_along * normal) / size
    g_t = np.sqrt(np.maximum(friction**2 - g_w**2, 0.0))
    sticking = normal + g_w * w + g_t * t
    force = np.where(slides, sliding, sticking)
    force /= np.sqrt(dot(force, force))
    along_part = dot(force, along)
    across_part = force - along_part * along
    omega = np.arctan2(dot(across_part, z), dot(across_part, x))
    alpha = np.arctan2(np.sqrt(dot(across_part, across_part)), -along_part)
    return np.stack([omega, alpha, np.full(len(s1), _STRAIGHT), s1])
