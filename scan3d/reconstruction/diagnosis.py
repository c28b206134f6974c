"""The likeliest fault of a recording that contradicts the model.

The numbers of each fault (`causes`) are estimated by least squares of the misfits (`misfits`) that the recording has without
it.  The fault that leaves least is named, if it leaves little; those that leave as little are named beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

import planar
from planar.march import STEPS
from scan3d.arrays import Array, Index, Mask, evenly
from scan3d.geometry.sections import slice_frame
from scan3d.reconstruction.causes import Cause, Diagnosis, Undone, causes, hanging_weight, known, stuck_rows
from scan3d.reconstruction.errors import (
    DISTURBED,
    Errors,
    Misfit,
    against_single_force,
    beyond_tangents,
    contact_tolerance,
    depths_in_hull,
    felt,
    tip_sigmas,
    too_light,
)
from scan3d.reconstruction.slices import slices_of
from scan3d.recording import Recording
from scan3d.rods import Gravity, Rod
from scan3d.spatial import inverse
from scan3d.units import number, share

# And if after its correction hardly any rows contradict by more than so many standard deviations, of many pairs of rows, and
# this part of the misfit, for its estimated numbers.
_SURELY, _OF_NUMBERS = 6.0, 0.01
# Faults whose mean square misfits differ by less than this factor cannot be told apart; each number must lower it by the root.
_ALIKE = 4.0
# Mean square misfit that counts as none.
_NO_MISFIT = 1e-12
# The misfit of a row without a contact, and the largest one that counts, so that single rows do not decide.
_LARGEST = 0.1
# Distance to the tip, in rod lengths, within which a contact counts as one of the tip, which has no tangent, so that the misfit
# does not jump where an estimate deviates by less than its error.
_TIP = 0.02
# Standard deviations that do not count as misfit.
_SIGMAS = 3.0
# Forces below this part of the largest one are rounding of a tare.
_NO_FORCE = 1e-5
# Evaluations of a refinement, fewer in a first search and of rods, which are slow and nearly linear.
_EVALUATIONS, _FEW = 12, 4
# Step of the derivatives by numbers.
_STEP = 1e-3
_UNKNOWN = Diagnosis(
    "unknown",
    None,
    "",
    0.0,
    "no single fault explains the contradiction: check signs, axes and units, the tare of force and moment, that the rod is "
    "straight, uniform and light and its clamp rigid, and that the body is convex",
)


def diagnose(recording: Recording, model: str) -> Diagnosis:
    """The likeliest fault of a recording that contradicts the model 'planar' or 'spatial'."""
    if recording.completed is not None:
        text = f"it rests on {recording.completed.words}: check that, the rod, and signs, units and tare of what was measured"
        return _UNKNOWN._replace(message=text)
    wrench = np.hstack(recording.reactions(six_axis=model == "spatial"))
    if recording.gravity is None:
        hanging = hanging_weight(recording, wrench)
        down = (0.0, 0.0, -1.0) if hanging is None else tuple(hanging)
        recording = replace(recording, gravity=Gravity(down, tared=False))
    noise = recording.noise.of_reactions(recording.rod)
    stuck = _stuck_rows(recording, wrench, noise)
    sample, few = (_sample(recording, model, wrench, noise, stuck, parts) for parts in (1, 2))
    few = replace(few, rough=True)
    if not len(sample.rows):
        return _UNKNOWN
    recorded = sample.left(Undone())
    before = _mean_square(recorded.excess)
    if before <= _NO_MISFIT or (
        recorded.level <= before and _Trial(known(Undone(), _UNKNOWN), np.empty(0), recorded).fits(before)
    ):
        return _UNKNOWN
    stuck = _contradicting(stuck, wrench, sample)
    tried = causes(recording, model, wrench, wrench[_felt(wrench[:, :3], noise)], stuck)
    if not np.ptp(recording.sweep):  # one sweep hardly contradicts itself, and many numbers would do
        tried = [cause for cause in tried if not cause.starts.shape[1]]
    fitting: list[_Trial] = []
    for of_rod in (False, True):  # no rod is tried where a fault leaves nothing
        if all(trial.misfit + trial.level > _OF_NUMBERS**2 * before for trial in fitting):
            group = [cause for cause in tried if (cause.family == "rod") == of_rod]
            evaluations = _FEW if of_rod else _EVALUATIONS
            trials = [_refined(trial, sample, evaluations) for trial in _searched(group, few)]
            fitting += [trial for trial in trials if trial.explains(before) >= 0.8 and trial.fits(before)]
    if all(trial.level > before for trial in fitting):  # errors that hide any misfit explain none
        about_rod, along_force, *_ = recorded.excess if model == "spatial" else np.zeros((2, 1))
        # makers of sensors state a cross-talk of 1 %: so small a moment along the force proves no second contact
        second = _mean_square(along_force) > _mean_square(about_rod) and np.median(along_force) > 0.01
        return _second_contact(along_force) if second else _UNKNOWN
    # misfits that begin at a bound fall to zero slowly, the fewer rows have one, and few evaluations end before they do
    fitting = [_settled(trial, sample) if max(noise) else _refined(trial, sample) for trial in fitting]
    first = min(fitting, key=lambda trial: trial.score)
    alike = {first.named.fault: first.named.message}
    for trial in fitting:
        other, best = trial.cause, first.cause
        contains = other.cost > best.cost and (best.cost == 0 or (other.family == best.family == "sensor"))
        if trial.misfit + first.level < _ALIKE * (first.misfit + first.level) and not contains:
            alike.setdefault(trial.named.fault, trial.named.message)
    explains = first.explains(before)
    if len(alike) == 1:
        found = first.named._replace(explains=explains, message=f"most likely {first.named.message}")
        if not max(noise) or not len(first.numbers) or found.value is None:
            return found
        low, high = _interval(first, sample)
        text = f"{found.message}; sizes from {number(low)} to {number(high)} {found.unit} explain it alike"
        return found._replace(message=text, interval=(low, high))
    text = (
        f"{len(alike)} faults explain it alike, and what each asks for tells them apart: {'; or '.join(alike.values())}"
    )
    return Diagnosis("several", None, "", explains, text, tuple(alike))


def _second_contact(along_force: Array) -> Diagnosis:
    """A second contact, where the moment along the force is most of the misfit and no fault of the rig explains it."""
    percent = 100 * float((along_force > 0).mean())
    return Diagnosis(
        "second-contact",
        percent,
        "%",
        0.0,
        f"most likely either a second contact, or channels that were exchanged or logged at different times: force and moment "
        f"of {share(percent / 100)} of the rows are not those of a single force; look for what else the rod touches",
    )


def _felt(force: Array, noise: tuple[float, float]) -> Mask:
    """(n,) whether forces (n, 3) stand out from the noise and from rounding."""
    size = np.linalg.norm(force, axis=1)
    return np.asarray(felt(force, noise) & (size > _NO_FORCE * size.max(initial=0.0)))


def _stuck_rows(recording: Recording, wrench: Array, noise: tuple[float, float]) -> Index:
    """Rows whose reactions under a force repeat those of the row before while the clamp moves, two or more in succession."""
    same = np.zeros(len(recording), dtype=bool)
    moves = (recording.position_m[1:] != recording.position_m[:-1]).any(axis=1)
    same[1:] = (wrench[1:] == wrench[:-1]).all(axis=1) & moves & _felt(wrench[:, :3], noise)[1:]
    run = same.copy()
    run[1:-1] = same[1:-1] & (same[:-2] | same[2:])
    return np.flatnonzero(run)


def _contradicting(stuck: Index, wrench: Array, sample: _Sample) -> Index:
    """Those of the rows that repeat others whose runs contradict the rest: along a flat face right reactions repeat as well."""
    runs = np.split(stuck, np.flatnonzero(np.diff(stuck) > 1) + 1)
    if not len(stuck) or len(runs) > 60:
        return stuck

    def without(some: Index) -> float:
        return _mean_square(sample.left(stuck_rows(some, wrench).undone(np.empty(0))).excess)

    least = _ALIKE * without(stuck) + _NO_MISFIT
    wrong = [run for run in runs if without(np.setdiff1d(stuck, run)) > least]
    return np.concatenate(wrong) if wrong else stuck


class _Left(NamedTuple):
    """What rows (k,) miss the model by, in r kinds (r, k)."""

    found: Array
    explained: Array
    """By `_SIGMAS` standard deviations."""
    excess: Array
    """Beyond what errors explain."""

    @property
    def level(self) -> float:
        """Mean square of one standard deviation."""
        return _mean_square(self.explained / _SIGMAS)


class _Trial(NamedTuple):
    cause: Cause
    numbers: Array
    left: _Left | None = None
    """After its correction; None before it is tried."""

    @property
    def misfit(self) -> float:
        return np.inf if self.left is None else _mean_square(self.left.excess)

    @property
    def level(self) -> float:
        return 0.0 if self.left is None else self.left.level

    def explains(self, before: float) -> float:
        """Part of a root mean square misfit that the correction removes."""
        return float(1 - np.sqrt(self.misfit / before))

    def fits(self, before: float) -> bool:
        """Whether nearly no row contradicts by more than its errors, and those of the numbers, explain."""
        if self.left is None or self.level > _ALIKE * before:
            return False
        allowed = (_SURELY / _SIGMAS - 1) * self.left.explained + _OF_NUMBERS * np.sqrt(before)
        worst = self.left.excess.max(axis=0)
        least = worst[worst <= np.quantile(worst, 1 - DISTURBED)]
        if _mean_square(least) > self.left.level + (_OF_NUMBERS**2) * before:
            return False
        return float((self.left.excess > allowed).any(axis=0).mean()) <= DISTURBED

    @property
    def score(self) -> float:
        """Mean square misfit with what its numbers cost, as a logarithm."""
        return float(np.log(self.misfit + _NO_MISFIT) + self.cause.cost * np.log(_ALIKE) / 2)

    @property
    def named(self) -> Diagnosis:
        return self.cause.named(self.numbers)


def _mean_square(residuals: Array) -> float:
    return float(np.mean(residuals**2))


def _searched(tried: list[Cause], few: _Sample) -> list[_Trial]:
    """The faults with numbers that few rows make hopeful, as these estimate them, and all faults without numbers."""
    plain = [_Trial(cause, cause.starts[0]) for cause in tried if not cause.starts.shape[1]]
    # what halves the root mean square misfit is refined
    rough, least = [], 0.25 * _mean_square(few.left(Undone()).excess)
    for cause in (cause for cause in tried if cause.starts.shape[1]):
        trials = [_Trial(cause, start, few.left(cause.undone(start))) for start in cause.starts]
        # the misfits of starts between which the right one lies differ little, those of estimates a lot
        best = sorted(trials, key=lambda trial: trial.misfit)[: 1 if cause.family == "rod" else 2]
        rough.append(min((_refined(trial, few, _FEW) for trial in best), key=lambda trial: trial.misfit))
    return plain + [trial for trial in rough if trial.misfit <= least]


def _refined(trial: _Trial, sample: _Sample, evaluations: int = _EVALUATIONS) -> _Trial:
    """The trial with the numbers by which the rows of a sample have the least misfit."""
    cause, numbers = trial.cause, trial.numbers
    if len(numbers):
        near = sample.near(cause.undone(numbers))

        def residuals(numbers: Array) -> Array:
            return near.left(cause.undone(numbers)).excess.ravel() / _LARGEST

        bounds = (-cause.limit, cause.limit)
        numbers = least_squares(residuals, numbers, bounds=bounds, diff_step=1e-5, max_nfev=evaluations).x
    return _Trial(cause, numbers, sample.left(cause.undone(numbers)))


def _settled(trial: _Trial, sample: _Sample) -> _Trial:
    """The trial with numbers in the middle of those that noise allows: by all misfits, over their standard deviations."""
    cause, left = trial.cause, trial.left
    if not len(trial.numbers) or left is None:
        return trial
    numbers = _least(_deviations(trial, left, sample), trial.numbers, cause.limit, _EVALUATIONS)
    settled = trial._replace(numbers=numbers, left=sample.left(cause.undone(numbers)))
    return settled if settled.misfit <= trial.misfit + trial.level else trial


def _least(deviations: Callable[[Array], Array], numbers: Array, limit: float, evaluations: int) -> Array:
    """The numbers (k,) near some by which the sum of squares of deviations is least."""
    one = np.ones(len(numbers))  # relative steps about 1 are absolute ones, which no kink of the hull hides
    found = least_squares(
        lambda x: deviations(numbers + x - one),
        one,
        bounds=(one - limit - numbers, one + limit - numbers),
        diff_step=_STEP,
        max_nfev=evaluations,
    )
    return np.asarray(numbers + found.x - one)


def _deviations(trial: _Trial, left: _Left, sample: _Sample) -> Callable[[Array], Array]:
    """What is left with other numbers, over the standard deviations that it has with those of the trial."""
    sd, near = (
        np.maximum(left.explained / _SIGMAS, _NO_FORCE * _LARGEST),
        sample.near(trial.cause.undone(trial.numbers)),
    )
    return lambda n: np.asarray(np.minimum(near.left(trial.cause.undone(n)).found / sd, _SURELY).ravel())


def _interval(trial: _Trial, sample: _Sample) -> tuple[float, float]:
    """The smallest and the largest size of a fault that explains it alike, with its other numbers fitted to each."""
    cause, numbers, named = trial.cause, trial.numbers, trial.named
    assert trial.left is not None
    assert named.value is not None
    deviations, sizes = _deviations(trial, trial.left, sample), [named.value]
    limit = _ALIKE * max(_mean_square(deviations(numbers)), 1.0)
    each = _STEP * np.eye(len(numbers))
    rise = np.array([(cause.named(numbers + e).value or 0.0) - (cause.named(numbers - e).value or 0.0) for e in each])
    axis, *others = np.linalg.svd(rise[None])[2]
    across = np.array(others).reshape(-1, len(numbers))
    for sign in (1.0, -1.0):
        way, step, best = 0.0, _STEP, np.zeros(len(across))
        for _ in range(10):  # ever farther, and back by halves

            def along(rest: Array, at: float = sign * (way + step)) -> Array:
                return deviations(numbers + at * axis + rest @ across)

            rest = _least(along, best, cause.limit, _FEW) if len(across) else best
            tried = numbers + sign * (way + step) * axis + rest @ across
            alike = np.abs(tried).max() <= cause.limit and _mean_square(along(rest)) <= limit
            way, step, best = (way + step, 4 * step, rest) if alike else (way, step / 4, best)
            size = cause.named(numbers + sign * way * axis + best @ across)
            if alike and size.value is not None and size.unit == named.unit:
                sizes.append(size.value)
    return min(sizes), max(sizes)


def _sample(
    recording: Recording, model: str, wrench: Array, noise: tuple[float, float], kept: Index, parts: int
) -> _Sample:
    """Evenly chosen rows in contact, and those that are `kept`; a fraction 1 / parts of the usual number."""
    assert recording.gravity is not None
    axes, pressed = recording.axes(), _felt(recording.pressing(model == "spatial"), noise)

    def chosen(rows: Index, count: int, kept: Index) -> Index:
        count = -(-count // parts)
        return np.union1d(evenly(rows, count), np.intersect1d(rows, kept[:count]))

    frames: list[Array] = []
    if model == "spatial":
        # a first search takes half of them
        of_slice = [chosen(np.flatnonzero(pressed), 250, kept)]
    else:
        number, normals, _ = slices_of(recording, axes[:, 2])
        numbers = chosen(np.unique(number[pressed]), 5, np.unique(number[kept]))
        of_slice = [chosen(np.flatnonzero(pressed & (number == k)), 120, kept) for k in numbers]
        frames = [slice_frame(normals[k])[:2] for k in numbers]
    rows = np.concatenate([np.empty(0, dtype=np.intp), *of_slice])
    return _Sample(
        wrench=wrench,
        rows=rows,
        slices=np.split(np.arange(len(rows)), np.cumsum([len(part) for part in of_slice])[:-1]),
        frames=frames,
        position=recording.position_m[rows] / recording.rod.length_m,
        axes=axes[rows],
        noise=noise,
        rod=recording.rod,
        pull=(recording.pressing(model == "spatial") - wrench[:, :3])[rows],
        down=axes[rows] @ recording.gravity.direction,
    )


@dataclass(frozen=True)
class _Sample:
    """Rows (k,) that stand for a recording, and what they miss the model by."""

    wrench: Array
    """(n, 6) of all rows of the recording, dimensionless."""
    rows: Index
    slices: list[Index]
    """Places in `rows` of the rows of each slice; in space of all."""
    frames: list[Array]
    """(2, 3) axes of each slice; empty in space."""
    position: Array
    """(k, 3)"""
    axes: Array
    """(k, 3, 3)"""
    noise: tuple[float, float]
    rod: Rod
    pull: Array
    """(k, 3) the weight of the stated rod as a force; 0 without."""
    down: Array
    """(k, 3) gravity in the clamp's frame."""
    rough: bool = False
    """Whether the errors are those of a straight, uniform, weightless rod, whatever the stated one."""
    held: planar.Errors | inverse.SpatialErrors | None = None
    """Errors of the contacts of all corrections; None: each has its own."""

    def near(self, undone: Undone) -> _Sample:
        """The sample with the errors of one correction, for others of the same fault, whose errors differ little."""
        return replace(self, held=None if self.rough else self._errors(*self._corrected(undone)))

    def _corrected(self, undone: Undone) -> tuple[Array, Array, tuple[float, float]]:
        """Force and moment (k, 3) without a fault, and their noise."""
        force, moment = np.hsplit(undone.of(self.wrench, self.rows), 2)
        gains = undone.gains()
        return force, moment, (self.noise[0] * gains[0], self.noise[1] * gains[1])

    def _errors(
        self, force: Array, moment: Array, noise: tuple[float, float]
    ) -> planar.Errors | inverse.SpatialErrors | None:
        """Those of contacts of the stated rod; other rods have much the same.  None for exact reactions in space."""
        if self.held is not None:
            return self.held
        rod = Rod(self.rod.length_m, self.rod.bending_stiffness_Nm2) if self.rough else self.rod
        if self.frames:
            bent = rod.in_plane(self.down, sag=np.inf)  # that of the recording stays in the plane
            return planar.errors(force[:, 0], force[:, 1], moment[:, 2], noise=noise, rod=bent)
        return inverse.errors(force, moment, noise, rod=rod.in_space(), gravity=self.down) if max(noise) else None

    def left(self, undone: Undone) -> _Left:
        """What is left (r, k) without a fault, as parts and in rod lengths, 0 where noise explains it.

        In space the moment about the rod and that along the force; and in space and in the plane, how far contacts and
        tangents lie where they must not, or the largest misfit of rows that have no contact.
        """
        force, moment, noise = self._corrected(undone)
        pressed = _felt(force + self.pull if undone.air is None else force - undone.air[self.rows, :3], noise)
        # without a zero that is taken off, reactions of rows in contact cannot have become too small to be felt
        expected = pressed | (not undone.zero.any() and undone.air is None)
        with np.errstate(all="ignore"):  # a wrong correction may lead to any numbers
            evaluated = self._in_plane if self.frames else self._in_space
            known, misfits = evaluated(force, moment, noise, pressed, undone)
        found, explained = (np.nan_to_num(np.stack(parts), nan=_LARGEST) for parts in zip(*misfits, strict=True))
        left = np.clip(np.stack([found, explained, found - explained]) * pressed, 0.0, _LARGEST)
        left[:, -1, expected & ~(pressed & known)] = np.array([_LARGEST, 0.0, _LARGEST])[:, None]
        return _Left(*left)

    def _places(self, points: Array, rows: Index, undone: Undone) -> Array:
        """(n, 3) contacts in the world, of those (n, 3) in the clamps' frames."""
        clamps = self.position[rows] + undone.late * self.axes[rows, 0]
        return np.asarray(clamps + undone.length * np.einsum("ni,nij->nj", points, self.axes[rows]))

    def _in_plane(
        self, force: Array, moment: Array, noise: tuple[float, float], pressed: Mask, undone: Undone
    ) -> tuple[Mask, list[Misfit]]:
        """Which rows (k,) have a contact, and how far others lie beyond the tangent there."""
        reactions, length = (force[:, 0], force[:, 1], moment[:, 2]), undone.length
        error = self._errors(force, moment, noise)
        assert isinstance(error, planar.Errors)
        tolerance, bent = np.maximum(contact_tolerance(error), _TIP), undone.rod or self.rod
        if bent.weight_N:
            down = self.down * [1, 1, 0]
            heavy = inverse.reconstruct(
                force, moment, tolerance=tolerance, rod=bent.in_space(), gravity=down, steps=STEPS
            )
            phase, places, normals = heavy.phase, heavy.point, heavy.tangent[:, [1, 0]] * [1, -1]
        else:
            found = planar.reconstruct(np.zeros(len(force)), *reactions, tolerance=tolerance, rod=bent.in_plane())
            phase, places, normals = found.phase, np.pad(found.point, ((0, 0), (0, 1))), found.normal
        known, beyond, explained = phase != planar.Phase.NONE, np.zeros(len(force)), np.zeros(len(force))
        usable = pressed & known
        usable &= ~too_light(error.largest, usable)
        for part, frame in zip(self.slices, self.frames, strict=True):
            rows = part[usable[part]]
            lines = np.flatnonzero(phase[rows] == planar.Phase.TANGENTIAL)
            if not len(lines):
                continue
            inside = self.axes[rows, :2] @ frame.T  # (k, 2, 2) the clamps' axes in the slice's frame
            points = self._places(places[rows], rows, undone) @ frame.T
            turned = np.einsum("ni,nij->nj", normals[rows[lines]], inside[lines])
            errors = None
            if max(noise):
                covariance = length**2 * np.einsum("nia,nij,njb->nab", inside, error.point[rows], inside)
                errors = Errors(_SIGMAS, covariance, np.minimum(error.slope[rows], 1 / _SIGMAS))
            misfit = beyond_tangents(points, lines, turned, np.arange(len(rows)), errors, length)
            worst = (np.arange(len(lines)), (misfit.found - misfit.explained).argmax(axis=1))
            beyond[rows[lines]], explained[rows[lines]] = misfit.found[worst], misfit.explained[worst]
        return known, [Misfit(beyond, explained)]

    def _in_space(
        self, force: Array, moment: Array, noise: tuple[float, float], pressed: Mask, undone: Undone
    ) -> tuple[Mask, list[Misfit]]:
        """Which rows (k,) have a contact, what contradicts a single force, and how deep the contacts lie in their hull."""
        n, length, bent = len(force), undone.length, undone.rod or self.rod
        error = self._errors(force, moment, noise)
        assert not isinstance(error, planar.Errors)
        s1, place, turn = (np.zeros(n),) * 3 if error is None else (error.s1, error.largest, _SIGMAS * error.tangent)
        tolerance = np.maximum(tip_sigmas(np.nan_to_num(s1, posinf=0.0)), _TIP)
        weights = noise if max(noise) else None
        found = inverse.reconstruct(
            force, moment, tolerance=tolerance, noise=weights, rod=bent.in_space(), gravity=self.down, steps=STEPS
        )
        known, depth, explained = found.status == inverse.Status.OK, np.zeros(n), np.zeros(n)
        usable = pressed & known
        rows = np.flatnonzero(usable & ~too_light(place, usable))
        points = self._places(found.point[rows], rows, undone)
        tangents = np.einsum("ni,nij->nj", found.tangent[rows], self.axes[rows])
        every, lines = np.arange(len(rows)), np.flatnonzero(found.phase[rows] == planar.Phase.TANGENTIAL)
        errors = _SIGMAS * length * place[rows], turn[rows]
        if len(rows) > 4:  # fewer lie on their hull
            misfit = depths_in_hull(points, every, every, lines, tangents, errors, length)
            if misfit is None:
                depth[rows] = _LARGEST
            else:
                both = np.concatenate([every, lines])
                order = np.argsort(misfit.found - misfit.explained)  # the last one, and the worst, of each row stays
                depth[rows[both[order]]], explained[rows[both[order]]] = misfit.found[order], misfit.explained[order]
        radius = self.rod.diameter_m / 2 / self.rod.length_m / length
        single = against_single_force(force, moment, found, noise, _SIGMAS, radius)
        return known, [*single, Misfit(depth, explained)]
