"""Quasi-static sweeps of round rods in space past a convex body, with Coulomb friction, many sweeps in lockstep (4).

Every sweep is a lane of the arrays.  A round is one step of Newton's method in every lane, each at its own place of its own
path.  What it leads to is accepted as the state at the lane's target, or goes on, or has failed.  A failed step is tried on the
other branches of Coulomb's law, then with half its length; a step that cannot be halved further is a snap, and the lane follows
the overdamped flow, at a fixed clamp, to the next equilibrium or off the body.  So no lane waits for another.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

import planar
from scan3d.arrays import NEGLIGIBLE, Array, Index, Mask, ratio
from scan3d.spatial.bodies import LARGEST_TURN, Body, Patch, dot, unit
from scan3d.spatial.equilibrium import Bent, Law, Mode, System, bent, system, wrench
from scan3d.spatial.touchdown import STRAIGHT, Paths, Touch, first_bend, first_state, first_touches, later_touches

# Steps of Newton's method with the direction of the slip frozen, where the slip is not known from the step before.
_FROZEN_STEPS = 2
# Successive steps of Newton's method that would bend the rod the other way, after which a step fails.
_LARGEST_STRAIGHTENED = 3
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
    effort: int = 800,
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
    effort
        steps of Newton's method from one sample to the next before a sweep is given up (`End.LOST`), as happens at snaps.

    A rod that has lost contact touches again where its path leads it back.  Raises ValueError for paths that begin in the body.
    """
    place, mu = np.asarray(position, dtype=float), np.asarray(friction, dtype=float)
    mu = np.broadcast_to(mu[:, None] if mu.ndim == 1 else mu, place.shape[:2])
    lanes = _Lanes(body, Paths(place, np.asarray(axes, dtype=float)), mu, substeps, effort)
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

    def restart(self, rows: Index) -> None:
        """Begin the step of these lanes again, from the state before."""
        self.iterations[rows] = self.straightened[rows] = 0
        self.frozen[rows] = _FROZEN_STEPS
        self.trial_state[:, rows] = self.state[:, rows]
        self.trial_feature[rows], self.trial_coordinates[:, rows] = self.feature[rows], self.coordinates[:, rows]


class _Lanes:
    """Sweeps past `body` on `paths` with coefficients of friction (m, n), in steps of one sample over `substeps`."""

    def __init__(self, body: Body, paths: Paths, friction: Array, substeps: int, effort: int) -> None:
        self.body, self.paths, self.friction = body, paths, friction
        self.results = _untouched(*friction.shape)
        self._longest, self._effort = 1.0 / substeps, effort
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
        failed = solved | ~np.isfinite(size) | (lanes.iterations >= self._patience)
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
        self._finish(np.flatnonzero(lanes.effort > self._effort), End.LOST)
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
        lanes.iterations[rows] = lanes.straightened[rows] = 0
        if flowing.any():
            self._flow(rows[flowing], equations)
            rows = rows[~flowing]

        lanes.progress[rows] = lanes.target[rows]
        lanes.steps_taken[rows] += 1
        irregular = lanes.has_snapped[rows] | equations.sticks[rows]
        sample = np.round(lanes.progress[rows]).astype(np.intp)
        reached = np.abs(lanes.progress[rows] - sample) < NEGLIGIBLE
        self._record(rows[reached], sample[reached], rod, patch, equations)
        lanes.step[rows] = np.minimum(2 * lanes.step[rows], self._longest)
        lanes.target[rows] = self._next(lanes)[rows]
        lanes.mode[rows], lanes.branches[rows], lanes.frozen[rows] = Mode.SLIDE, 0, _FROZEN_STEPS
        self._predict(rows[(lanes.last_step[rows] > 0) & ~irregular])
        self._finish(rows[lanes.progress[rows] > self._last - NEGLIGIBLE], End.PATH)

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
        lanes.step[halved] = (lanes.target[halved] - lanes.progress[halved]) / 2
        snaps = lanes.step[halved] < _SMALLEST
        self._snap(halved[snaps])
        lanes.target[halved[~snaps]] = self._next(lanes)[halved[~snaps]]
        self._restart(rows)
        self._leave(rows[off])
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
