"""Many sweeps in lockstep: each lane solves its equations by Newton's method, step by step along its path.

A round is one step of Newton's method in every lane.  What it leads to is accepted as the state at the lane's target, or goes
on, or has failed.  A failed step is tried on the other branches of Coulomb's law, then with half its length; a step that cannot
be halved further is a snap, and the lane follows the overdamped flow, at a fixed clamp, to the next equilibrium or off the
body.
"""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.spatial.bodies import Body, Patch
from scan3d.spatial.equations import Law, Mode, System, system
from scan3d.spatial.lane_states import FROZEN_STEPS, LaneStates, started
from scan3d.spatial.newton import newton_step
from scan3d.spatial.paths import Paths
from scan3d.spatial.results import End, Results
from scan3d.spatial.shapes import Bent, bent
from scan3d.spatial.touchdown import STRAIGHT, first_bend, first_state
from scan3d.spatial.touches import Touch
from scan3d.spatial.vectors import dot, unit

# Residual, in rod lengths and unit forces, at which the equations count as solved.
_SOLVED = 1e-11
# Steps of Newton's method before a step fails, on a smooth body, and on a polyhedron, where each ends at the border of a face,
# an edge or a vertex.
_PATIENCE, _PATIENCE_ON_FEATURES = 9, 25
# Successive steps of Newton's method that would bend the rod the other way, after which a step fails.
_LARGEST_STRAIGHTENED = 3
# Smallest step, in samples, before the rod is taken to snap.
_SMALLEST = 2.0**-5
# Largest path of the contact in a step: in rod lengths, and in paths of the clamp.  Farther solutions are on other branches.
_REACH, _REACH_IN_STEPS = 0.08, 3.0
# Tolerance of the cone of friction for a contact that sticks.
_CONE = 1e-9
# Weight of the slip in the residual of a contact that sticks, in steps.
_SLIP_WEIGHT = 10.0
# Friction, as a part of the force, below which it does not give the slip's direction.
_SLIGHT = 1e-9
# A step that fails is the lift-off if the straight rod is clear of the body, the rod is nearly straight, and the step is short;
# or if Newton's method straightens a rod that is even less bent, and the straight rod is nearly clear.  The numbers are
# places in samples, q², samples, places in samples, and q².
_CLEAR, _NEARLY_STRAIGHT, _SHORT = 0.02, 0.1, 0.25
_ALMOST_CLEAR, _STRAIGHTENED = 1.0, 0.02
# Steps of Newton's method from one sample to the next before a sweep is given up, if nothing else is asked for.
EFFORT = 800
# Drag at the beginning of a snap, in unit forces per rod length; its factor where a step of the flow fails, and its limit.
_DRAG, _MORE_DRAG, _LARGEST_DRAG = 0.3, 4.0, 1e4
# Path of the clamp, in samples, by which the flow of a snap is beyond the fold, so that it is not slow there.
_BEYOND_FOLD = 0.5
# Slip, in rod lengths, above which a step of the flow is long, and the factors of the drag after long and short ones.
_LONG_FLOW, _AFTER_LONG, _AFTER_SHORT = 0.02, 1.5, 1 / 3
# Slip and drag below which the flow has come to rest.
_AT_REST, _LITTLE_DRAG = 1e-7, 1e-3
# Steps of the flow of a snap at most.
_FLOW_STEPS = 60
# Part of the force along the normal below which a rod that snaps leaves the body.
_LEAVES = 0.05
# Difference of places on a path, in samples, that is rounding.
_ROUNDING = 1e-9


class Lanes:
    """Sweeps past `body` on `paths` with coefficients of friction (m, n), in steps of one sample over `substeps`."""

    def __init__(self, body: Body, paths: Paths, friction: Array, substeps: int, effort: int) -> None:
        self.body, self.paths, self.friction = body, paths, friction
        self.results = Results(*friction.shape)
        self._longest, self._effort = 1.0 / substeps, effort
        self._last = paths.samples - 1
        self._patience = _PATIENCE if body.smooth else _PATIENCE_ON_FEATURES
        self._lanes: LaneStates

    def run(self, touch: Touch) -> tuple[Index, Array]:
        """Follow sweeps from their touch-downs to the end of their contacts.

        Returns the numbers of the sweeps that lost contact before the end of the path, and the places where they did.
        """
        self._lanes = self._started(touch)
        self._left: list[tuple[Index, Array]] = []
        while len(self._lanes.number):
            self._round()
        if not self._left:
            return touch.number[:0], touch.progress[:0]
        number, progress = (np.concatenate(column) for column in zip(*self._left, strict=True))
        return number, progress

    def _started(self, touch: Touch) -> LaneStates:
        patch = self.body.patch(touch.feature, touch.coordinates)
        clamp = self.paths.clamp(touch.number, touch.progress)
        speed, turning = self.paths.speed(touch.number, touch.progress)
        friction = self.friction[touch.number, self._sample_after(touch.progress)]
        state = first_state(patch.normal, touch.s1, clamp, speed + touch.s1 * turning, friction)
        force = bent(state, clamp).force
        slip = dot(force, patch.law_normal) * patch.law_normal - force
        place = touch.feature, touch.coordinates, patch.point
        lanes = started(touch.number, touch.progress, touch.clear_after, state, place, slip)
        lanes.step[:] = self._longest
        lanes.target = self._next(lanes)
        self._bend(lanes, np.arange(len(lanes.number)))
        return lanes

    def _next(self, lanes: LaneStates) -> Array:
        """The end of the next step: no farther than the next sample."""
        return np.asarray(np.minimum(np.floor(lanes.progress + _ROUNDING) + 1, lanes.progress + lanes.step))

    def _sample_after(self, progress: Array) -> Index:
        return np.asarray(np.minimum(np.ceil(progress - _ROUNDING).astype(np.intp), self._last))

    def _bend(self, lanes: LaneStates, rows: Index) -> None:
        """Bend the straight rods among `rows` at first by what the body pushes them aside, to begin Newton's method with."""
        rows = rows[lanes.state[2, rows] < 100 * STRAIGHT]
        if not len(rows):
            return
        s1 = lanes.state[3, rows]
        before, after = (self.paths.clamp(lanes.number[rows], at[rows]) for at in (lanes.progress, lanes.target))
        move = after.position - before.position + s1 * (after.y - before.y)
        normal = self.body.patch(lanes.feature[rows], lanes.coordinates[:, rows]).normal
        lanes.trial_state[2, rows] = first_bend(-dot(move, normal), lanes.state[1, rows], s1)

    def _round(self) -> None:
        lanes = self._lanes
        rod = bent(lanes.trial_state, self.paths.clamp(lanes.number, lanes.target))
        patch = self.body.patch(lanes.trial_feature, lanes.trial_coordinates)
        step = np.maximum(lanes.target - lanes.progress, 1e-12)
        friction = self.friction[lanes.number, self._sample_after(lanes.target)]
        frozen = (lanes.mode == Mode.SLIDE) & (lanes.iterations < lanes.frozen)
        mode = np.where(frozen, np.int8(Mode.FROZEN), lanes.mode)
        law = Law(friction, lanes.point, lanes.state[3], mode, lanes.slip_direction, _SLIP_WEIGHT / step, lanes.drag)
        equations = system(lanes.trial_state, rod, patch, law)
        size = np.abs(equations.residual).max(axis=0)
        solved = (size < _SOLVED) & (~frozen | (friction == 0))
        accepted = solved & self._valid(equations, friction, patch.point, step)
        failed = solved | ~np.isfinite(size) | (lanes.iterations >= self._patience)
        failed = (failed | (lanes.straightened >= _LARGEST_STRAIGHTENED)) & ~accepted
        going = np.flatnonzero(~(accepted | failed))
        if len(going):
            newton_step(self.body, lanes, going, equations, patch)
        retried = failed & (friction > 0) & (lanes.drag == 0) & (lanes.branches < 2)
        if retried.any():
            self._try_other_branch(np.flatnonzero(retried))
            failed &= ~retried
        if accepted.any():
            self._accept(np.flatnonzero(accepted), rod, patch, equations)
        if failed.any():
            self._fail(np.flatnonzero(failed))
        lanes.effort += 1
        self._finish(np.flatnonzero(lanes.effort > self._effort), End.LOST)
        kept = lanes.number >= 0
        if not kept.all():
            lanes.keep(kept)

    def _valid(self, equations: System, friction: Array, point: Array, step: Array) -> Mask:
        """Which solutions are equilibria on the branch that they were sought on, next to the last ones."""
        lanes = self._lanes
        flowing = lanes.drag > 0
        valid = (equations.normal_force > 0) & (lanes.trial_state[2] > 2 * STRAIGHT)
        held = equations.friction_force <= friction * equations.normal_force * (1 + _CONE)
        against_slip = (equations.dissipated >= 0) | (friction == 0) | flowing
        valid &= np.where(equations.sticks, held, against_slip)
        path = point - lanes.point
        reach = np.maximum(_REACH, _REACH_IN_STEPS * step * self.paths.pace[lanes.number])
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
        tangential = rod.force[:, rows] - equations.normal_force[rows] * patch.law_normal[:, rows]
        size = np.sqrt(dot(tangential, tangential))
        lanes.slip_direction[:, rows] = np.where(
            size > _SLIGHT, -tangential / np.maximum(size, _SLIGHT), lanes.slip_direction[:, rows]
        )
        lanes.last_change[:, rows] = lanes.trial_state[:, rows] - lanes.state[:, rows]
        lanes.last_coordinates[:, rows] = lanes.coordinates[:, rows]
        lanes.last_step[rows] = np.where(flowing, 0.0, lanes.target[rows] - lanes.progress[rows])
        lanes.state[:, rows], lanes.feature[rows] = lanes.trial_state[:, rows], lanes.trial_feature[rows]
        lanes.coordinates[:, rows], lanes.point[:, rows] = lanes.trial_coordinates[:, rows], patch.point[:, rows]
        lanes.iterations[rows] = lanes.straightened[rows] = 0
        if flowing.any():
            self._flow(rows[flowing], equations)
            rows = rows[~flowing]

        lanes.progress[rows] = lanes.target[rows]
        lanes.steps_taken[rows] += 1
        irregular = lanes.has_snapped[rows] | equations.sticks[rows]
        sample = np.round(lanes.progress[rows]).astype(np.intp)
        reached = np.abs(lanes.progress[rows] - sample) < _ROUNDING
        lanes.effort[rows[reached]] = 0
        self.results.record(lanes, rows[reached], sample[reached], rod, patch, equations)
        lanes.step[rows] = np.minimum(2 * lanes.step[rows], self._longest)
        lanes.target[rows] = self._next(lanes)[rows]
        lanes.mode[rows], lanes.branches[rows], lanes.frozen[rows] = Mode.SLIDE, 0, FROZEN_STEPS
        self._predict(rows[(lanes.last_step[rows] > 0) & ~irregular])
        self._finish(rows[lanes.progress[rows] > self._last - _ROUNDING], End.PATH)

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
        short = target - lanes.progress[rows] <= _SHORT
        off = (target >= clear - _CLEAR) & (bend < _NEARLY_STRAIGHT) & short
        straightened = lanes.straightened[rows] >= _LARGEST_STRAIGHTENED
        off |= (target >= clear - _ALMOST_CLEAR) & (bend > 2 * STRAIGHT) & (bend < _STRAIGHTENED) & straightened
        flowing = lanes.drag[rows] > 0
        flow = rows[flowing]
        lanes.drag[flow] *= _MORE_DRAG
        lanes.mode[flow] = Mode.EITHER
        lanes.flow_steps[flow] += 1
        halved = rows[~flowing & ~off]
        lanes.step[halved] = (lanes.target[halved] - lanes.progress[halved]) / 2
        snaps = lanes.step[halved] < _SMALLEST
        self._snap(halved[snaps])
        lanes.target[halved[~snaps]] = self._next(lanes)[halved[~snaps]]
        self._restart(rows)
        self._leave(rows[off])
        self._finish(flow[(lanes.flow_steps[flow] > _FLOW_STEPS) | (lanes.drag[flow] > _LARGEST_DRAG)], End.LOST)

    def _snap(self, rows: Index) -> None:
        """Begin to follow the overdamped flow from states that no equilibrium follows."""
        lanes = self._lanes
        lanes.drag[rows], lanes.mode[rows], lanes.flow_steps[rows] = _DRAG, Mode.EITHER, 0
        progress = lanes.progress[rows]
        lanes.target[rows] = np.minimum(np.floor(progress + _ROUNDING) + 1, progress + _BEYOND_FOLD)

    def _flow(self, rows: Index, equations: System) -> None:
        """Take the next step of a snap: longer where the last one was short, and end at an equilibrium."""
        lanes = self._lanes
        slip, sticks = equations.slip[rows], equations.sticks[rows]
        lanes.flow_steps[rows] += 1
        lanes.drag[rows] *= np.where(slip < _LONG_FLOW, _AFTER_SHORT, _AFTER_LONG)
        rests = ((slip < _AT_REST) & (lanes.drag[rows] < _LITTLE_DRAG)) | sticks
        ended = rows[rests]
        lanes.drag[ended], lanes.has_snapped[ended], lanes.step[ended] = 0.0, True, _SMALLEST
        lanes.mode[ended] = np.where(sticks[rests], Mode.STICK, Mode.SLIDE)
        leaves = ~rests & (equations.normal_force[rows] < _LEAVES)
        clear = lanes.target[rows] >= lanes.clear_after[rows]
        self._leave(rows[leaves & clear])
        self._finish(rows[(leaves & ~clear) | (~rests & (lanes.flow_steps[rows] > _FLOW_STEPS))], End.LOST)

    def _leave(self, rows: Index) -> None:
        """End the contact of lanes whose rod has come free of the body."""
        lanes = self._lanes
        self._left.append((lanes.number[rows], lanes.target[rows]))
        self._finish(rows, End.OFF)

    def _finish(self, rows: Index, end: End) -> None:
        rows = rows[self._lanes.number[rows] >= 0]
        self.results.end[self._lanes.number[rows]] = end
        self._lanes.number[rows] = -1
