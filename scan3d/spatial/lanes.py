"""The lanes of a simulation: each solves its equations by Newton's method, step by step along its path."""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.spatial.bodies import Body, Patch
from scan3d.spatial.equations import Law, System, system
from scan3d.spatial.shapes import Bent, Clamp, bent, wrench
from scan3d.spatial.touching import Passage
from scan3d.spatial.vectors import dot

# Residual, in rod lengths and unit forces, at which the equations count as solved.
_SOLVED = 1e-11
# Steps of Newton's method before a lane halves its step, on a smooth body.
_PATIENCE = 14
# Smallest step, in samples, before the rod is taken to snap.
_SMALLEST = 2.0**-9


class Lanes:
    def __init__(self, body: Body, position: Array, axes: Array, friction: Array, passage: Passage, substeps: int) -> None:
        self.body, self.substeps = body, substeps
        m, n = position.shape[:2]
        self.position = position.transpose(2, 0, 1)  # (3, m, n)
        self.axes = axes.transpose(1, 2, 0)  # (3 axes, 3, m)
        self.friction = friction
        self.passage = passage
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
        self.place = patch.point
        k = len(lanes)
        self.h = np.full(k, 1.0 / self.substeps)
        self.iterations = np.zeros(k, dtype=int)
        self.drag = np.zeros(k)
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
        k = np.minimum(progress.astype(int), self.position.shape[2] - 2)
        part = progress - k
        begin, end = self.position[:, self.lane, k], self.position[:, self.lane, k + 1]
        return Clamp(begin + part * (end - begin), *self.axes[:, :, self.lane])

    def _lift(self, rows: Mask) -> None:
        """A first guess of q for straight rods, from the distance by which the body pushes them aside."""
        flat = rows & (self.state[2] < 1e-6)
        if not flat.any():
            return
        move = self._clamp(self.target).position - self._clamp(self.progress).position
        patch = self.body.patch(self.feature, self.coordinates)
        depth = np.maximum(-dot(move, patch.normal), 1e-12)
        sin = np.maximum(np.sin(self.state[1]), 0.1)
        guess = np.minimum(np.sqrt(0.75 * sin * depth / self.state[3]), 0.3)
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
        spacing = 1.0
        law = Law(self.friction[self.lane, index], self.place, self.state[3], 10 * spacing / step, self.drag)
        equations = system(self.trial_state, rod, patch, law)
        self.counts["rounds"] += 1
        self.counts["iterations"] += len(self.lane)
        size = np.abs(equations.residual).max(axis=0)
        solved = size < _SOLVED
        good = solved & (equations.normal_force > 0) & (self.trial_state[2] > 0)
        bad = (solved & ~good) | ~np.isfinite(size) | (self.iterations >= _PATIENCE)
        going = ~(good | bad)
        if going.any():
            self._newton(going, equations, patch)
        if good.any():
            self._commit(good, rod, patch, equations)
        if bad.any():
            self._fail(bad & ~good)
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
        state = self.trial_state[:, chosen]
        part = 1 / np.maximum(1.0, np.abs(step[:2]).max(axis=0) / 0.5)
        with np.errstate(divide="ignore", invalid="ignore"):
            shrink = np.where(step[2] < 0, -0.8 * state[2] / step[2], np.inf)
            part = np.minimum(part, np.where(step[3] < 0, -0.5 * state[3] / step[3], np.inf))
        part = np.minimum(part, shrink)
        here = Patch(*(column[:, chosen] for column in patch))
        feature, coordinates, taken = self.body.moved(
            self.trial_feature[chosen], self.trial_coordinates[:, chosen], here, part * step[4:]
        )
        state = state + taken * part * step[:4]
        state[1] = np.clip(state[1], -3.1, 3.1)
        limit = np.cos(state[1] / 2)
        state[2] = np.where(state[2] < 0.999 * limit, state[2], (state[2] - taken * part * step[2] + limit) / 2)
        state[2] = np.minimum(state[2], 0.9999 * limit)
        self.trial_state[:, chosen] = state
        self.trial_feature[chosen], self.trial_coordinates[:, chosen] = feature, coordinates
        self.iterations[chosen] += 1

    def _commit(self, rows: Mask, rod: Bent, patch: Patch, equations: System) -> None:
        chosen = np.flatnonzero(rows)
        flowing = self.drag[chosen] > 0
        self.state[:, chosen] = self.trial_state[:, chosen]
        self.feature[chosen] = self.trial_feature[chosen]
        self.coordinates[:, chosen] = self.trial_coordinates[:, chosen]
        self.place[:, chosen] = patch.point[:, chosen]
        self.iterations[chosen] = 0
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
        self.has_snapped[at] = False
        self.h[chosen] = np.minimum(2 * self.h[chosen], 1.0 / self.substeps)
        done = chosen[self.progress[chosen] > self.position.shape[2] - 1 - 1e-9]
        self.target[chosen] = self._next(self.progress)[chosen]
        self._finish(done, 0)

    def _fail(self, rows: Mask) -> None:
        self.counts["halved"] += int(rows.sum())
        chosen = np.flatnonzero(rows)
        self.iterations[chosen] = 0
        self.trial_state[:, chosen] = self.state[:, chosen]
        self.trial_feature[chosen], self.trial_coordinates[:, chosen] = self.feature[chosen], self.coordinates[:, chosen]
        off = (self.target[chosen] >= self.clear_after[chosen] - 0.05) & (self.state[2, chosen] < 0.1)
        flowing = self.drag[chosen] > 0
        self.drag[chosen[flowing]] *= 4
        self.flow_steps[chosen[flowing]] += 1
        steps = chosen[~flowing & ~off]
        self.h[steps] = (self.target[steps] - self.progress[steps]) / 2
        snap = steps[self.h[steps] < _SMALLEST]
        self.drag[snap] = 1.0
        self.flow_steps[snap] = 0
        self.counts["snaps"] += len(snap)
        rest = steps[self.h[steps] >= _SMALLEST]
        self.target[rest] = self._next(self.progress)[rest]
        self._lift(np.isin(np.arange(len(self.lane)), rest))
        self._finish(chosen[off], 2)
        lost = chosen[flowing & (self.flow_steps[chosen] > 300)]
        self._finish(lost, 3)

    def _flow(self, chosen: Index, equations: System) -> None:
        """Take the next step of a snap: longer where the last one was short, and end at an equilibrium."""
        slip = equations.slip[chosen]
        self.flow_steps[chosen] += 1
        self.drag[chosen] = np.where(slip < 0.02, self.drag[chosen] / 3, self.drag[chosen] * 1.5)
        rest = (slip < 1e-7) & (self.drag[chosen] < 1e-3)
        ended = chosen[rest]
        self.drag[ended] = 0.0
        self.has_snapped[ended] = True
        self.h[ended] = _SMALLEST
        self._finish(chosen[~rest & (self.flow_steps[chosen] > 300)], 3)

    def _finish(self, chosen: Index, end: int) -> None:
        self.end[self.lane[chosen]] = end
        self.lane[chosen] = -1 - self.lane[chosen]

    def _drop(self, keep: Mask) -> None:
        for name in ("lane", "progress", "clear_after", "feature", "h", "iterations", "drag", "has_snapped", "flow_steps", "trial_feature", "target"):
            setattr(self, name, getattr(self, name)[keep])
        for name in ("state", "coordinates", "place", "trial_state", "trial_coordinates"):
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
    w = np.stack([normal[1] * along[2] - normal[2] * along[1], normal[2] * along[0] - normal[0] * along[2], normal[0] * along[1] - normal[1] * along[0]]) / size
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
    return np.stack([omega, alpha, np.full(len(s1), 1e-9), s1])
