"""The likeliest fault of a recording that contradicts the model.

The numbers of each fault (`causes`) are estimated by least squares of the misfits (`misfits`) that the recording has without
it.  The fault that leaves least is named, if it leaves little; those that leave as little are named beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

import planar
from scan3d.arrays import Array, Index, Mask, evenly
from scan3d.geometry.sections import slice_frame
from scan3d.reconstruction.causes import Cause, Diagnosis, Undone, causes, stuck_rows
from scan3d.reconstruction.errors import contact_tolerance, felt, tip_sigmas, too_light
from scan3d.reconstruction.misfits import Errors, Misfit, against_single_force, beyond_tangents, depths_in_hull
from scan3d.reconstruction.slices import slices_of
from scan3d.recording import Recording
from scan3d.rods import Rod
from scan3d.spatial import inverse

# A fault is named if its correction removes at least this part of the root mean square misfit.
_EXPLAINS = 0.8
# Faults whose mean square misfits differ by less than this factor cannot be told apart; each number must lower it by the root.
_ALIKE = 4.0
# Mean square misfit that counts as none, and one below which noise hides differences.
_NO_MISFIT, _HIDDEN = 1e-12, 1e-5
# The misfit of a row without a contact, and the largest one that counts, so that single rows do not decide.
_LARGEST = 0.1
# Distance to the tip, in rod lengths, within which a contact counts as one of the tip, which has no tangent, so that the misfit
# does not jump where an estimate deviates by less than its error.
_TIP = 0.02
# Standard deviations that do not count as misfit.
_SIGMAS = 3.0
# Forces below this part of the largest one are rounding of a tare.
_NO_FORCE = 1e-5
# Slices that are compared, rows of each, and rows of a recording in space; a first search takes half of them.
_SLICES, _IN_SLICE, _IN_SPACE = 5, 120, 250
# Faults that are refined, starts of each, and evaluations of a refinement.
_REFINED, _STARTS, _EVALUATIONS = 4, 2, 12
# Runs of rows that repeat others of which each is tried.
_RUNS = 60
_UNKNOWN = Diagnosis(
    "unknown",
    None,
    "",
    0.0,
    "no single fault explains the contradiction: check signs, axes and units, the tare of force and moment, the rod, and that "
    "the body is convex",
)


def diagnose(recording: Recording, model: str) -> Diagnosis:
    """The likeliest fault of a recording that contradicts the model 'planar' or 'spatial'."""
    wrench = np.hstack(recording.reactions(six_axis=model == "spatial"))
    noise = recording.noise.of_reactions(recording.rod)
    stuck = _stuck_rows(recording, wrench, noise)
    sample, few = (_sample(recording, model, wrench, noise, stuck, parts) for parts in (1, 2))
    if not len(sample.rows):
        return _UNKNOWN
    recorded = sample.misfit(Undone())
    before = _mean_square(recorded)
    if before <= _NO_MISFIT:
        return _UNKNOWN
    stuck = _contradicting(stuck, wrench, sample)
    tried = causes(recording, model, wrench, wrench[_felt(wrench[:, :3], noise)], stuck)
    trials = sorted((_refined(trial, sample) for trial in _searched(tried, few)), key=lambda trial: trial.score)

    def explains(trial: _Trial) -> float:
        return float(1 - np.sqrt(trial.misfit / before))

    likely = [trial for trial in trials if explains(trial) >= _EXPLAINS]
    if not likely:
        second = model == "spatial" and 2 * _mean_square(recorded[1]) > _mean_square(np.hypot(*recorded[:2]))
        return (
            _second_contact(recorded[1], explains(trials[0]))
            if second
            else _UNKNOWN._replace(explains=explains(trials[0]))
        )
    first, found = likely[0], likely[0].named
    messages = {found.fault: found.message}
    hidden = _HIDDEN if max(noise) else _NO_MISFIT
    for trial in likely[1:]:
        other = trial.named
        alike = trial.misfit + hidden < _ALIKE * (first.misfit + hidden)
        # a fault of several numbers that contains the best one is no alternative to it, but a frame that nobody stated is as
        # likely as any simpler fault, unless that is one of the frame
        simple = trial.cause.cost <= first.cause.cost
        unstated = other.fault == "turned-and-moved" and not found.fault.startswith(("turned", "moment-not-moved"))
        if alike and (simple or unstated):
            messages.setdefault(other.fault, other.message)
    either = "either " if len(messages) > 1 else ""
    return found._replace(explains=explains(first), message=f"most likely {either}{', or '.join(messages.values())}")


def _second_contact(along_force: Array, explains: float) -> Diagnosis:
    """A second contact, where the moment along the force is most of the misfit and no fault of the rig explains it."""
    percent = 100 * float((along_force > 0).mean())
    return Diagnosis(
        "second-contact",
        percent,
        "%",
        explains,
        f"most likely either a second contact, or channels that were exchanged or logged at different times: force and moment "
        f"of {percent:.2g} % of the rows are not those of a single force; look for what else the rod touches",
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
    if not len(stuck) or len(runs) > _RUNS:
        return stuck

    def without(some: Index) -> float:
        return _mean_square(sample.misfit(stuck_rows(some, wrench).undone(np.empty(0))))

    least = _ALIKE * without(stuck) + _NO_MISFIT
    wrong = [run for run in runs if without(np.setdiff1d(stuck, run)) > least]
    return np.concatenate(wrong) if wrong else stuck


class _Trial(NamedTuple):
    cause: Cause
    numbers: Array
    misfit: float

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
    """The best faults with numbers, as estimated by few rows, and all faults without numbers."""
    plain = [_Trial(cause, cause.starts[0], np.inf) for cause in tried if not cause.starts.shape[1]]
    rough = []
    for cause in (cause for cause in tried if cause.starts.shape[1]):
        trials = [_Trial(cause, start, _mean_square(few.misfit(cause.undone(start)))) for start in cause.starts]
        # the misfits of starts between which the right one lies differ little, those of estimates a lot
        best = sorted(trials, key=lambda trial: trial.misfit)[:_STARTS]
        rough.append(min((_refined(trial, few) for trial in best), key=lambda trial: trial.misfit))
    return plain + sorted(rough, key=lambda trial: trial.score)[:_REFINED]


def _refined(trial: _Trial, sample: _Sample) -> _Trial:
    """The trial with the numbers that the rows of a sample are misfits least by."""
    cause = trial.cause
    if not len(trial.numbers):
        return trial._replace(misfit=_mean_square(sample.misfit(cause.undone(trial.numbers))))

    def residuals(numbers: Array) -> Array:
        return sample.misfit(cause.undone(numbers)).ravel() / _LARGEST

    bounds = -cause.limit, cause.limit
    found = least_squares(residuals, trial.numbers, bounds=bounds, diff_step=1e-5, max_nfev=_EVALUATIONS)
    return _Trial(cause, np.asarray(found.x), _mean_square(found.fun) * _LARGEST**2)


def _sample(
    recording: Recording, model: str, wrench: Array, noise: tuple[float, float], kept: Index, parts: int
) -> _Sample:
    """Evenly chosen rows in contact, and those that are `kept`; a fraction 1 / parts of the usual number."""
    axes, pressed = recording.axes(), _felt(wrench[:, :3], noise)

    def chosen(rows: Index, count: int, kept: Index) -> Index:
        count = -(-count // parts)
        return np.union1d(evenly(rows, count), np.intersect1d(rows, kept[:count]))

    frames: list[Array] = []
    if model == "spatial":
        of_slice = [chosen(np.flatnonzero(pressed), _IN_SPACE, kept)]
    else:
        number, normals, _ = slices_of(recording, axes[:, 2])
        numbers = chosen(np.unique(number[pressed]), _SLICES, np.unique(number[kept]))
        of_slice = [chosen(np.flatnonzero(pressed & (number == k)), _IN_SLICE, kept) for k in numbers]
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
        down=None if (down := recording.down()) is None else down[rows],
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
    down: Array | None
    """(k, 3) gravity in the clamp's frame, for rods with weight."""

    def misfit(self, undone: Undone) -> Array:
        """Residuals (r, k) without a fault, as parts and in rod lengths, 0 where noise explains them.

        In space the moment about the rod and that along the force; and in space and in the plane, how far contacts and
        tangents lie where they must not, or the largest misfit of rows that have no contact.
        """
        force, moment = np.hsplit(undone.of(self.wrench, self.rows), 2)
        gains = undone.gains()
        noise = self.noise[0] * gains[0], self.noise[1] * gains[1]
        pressed = _felt(force, noise)
        # without a zero that is taken off, reactions of rows in contact cannot have become too small to be felt
        expected = pressed | (not undone.zero.any())
        with np.errstate(all="ignore"):  # a wrong correction may lead to any numbers
            evaluated = self._in_plane if self.frames else self._in_space
            known, residuals = evaluated(force, moment, noise, pressed, undone.length)
        result = np.zeros((len(residuals), len(force)))
        for row, values in zip(result, residuals, strict=True):
            row[pressed] = np.clip(np.nan_to_num(values[pressed], nan=_LARGEST), 0.0, _LARGEST)
        result[-1, expected & ~(pressed & known)] = _LARGEST
        return result

    def _in_plane(
        self, force: Array, moment: Array, noise: tuple[float, float], pressed: Mask, length: float
    ) -> tuple[Mask, list[Array]]:
        """Which rows (k,) have a contact, and how far others lie beyond the tangent there."""
        reactions = force[:, 0], force[:, 1], moment[:, 2]
        rod = self.rod.in_plane()
        error = planar.errors(*reactions, noise=noise, rod=rod)
        tolerance = np.maximum(contact_tolerance(error), _TIP)
        found = planar.reconstruct(np.zeros(len(force)), *reactions, tolerance=tolerance, rod=rod)
        known, beyond = found.phase != planar.Phase.NONE, np.zeros(len(force))
        usable = pressed & known
        usable &= ~too_light(error.largest, usable)
        for part, frame in zip(self.slices, self.frames, strict=True):
            rows = part[usable[part]]
            lines = np.flatnonzero(found.phase[rows] == planar.Phase.TANGENTIAL)
            if not len(lines):
                continue
            inside = self.axes[rows, :2] @ frame.T  # (k, 2, 2) the clamps' axes in the slice's frame
            points = self.position[rows] @ frame.T + length * np.einsum("ni,nij->nj", found.point[rows], inside)
            normals = np.einsum("ni,nij->nj", found.normal[rows[lines]], inside[lines])
            errors = None
            if max(noise):
                covariance = length**2 * np.einsum("nia,nij,njb->nab", inside, error.point[rows], inside)
                errors = Errors(_SIGMAS, covariance, np.minimum(error.slope[rows], 1 / _SIGMAS))
            misfit = beyond_tangents(points, lines, normals, np.arange(len(rows)), errors, length)
            beyond[rows[lines]] = (misfit.found - misfit.explained).max(axis=1)
        return known, [beyond]

    def _in_space(
        self, force: Array, moment: Array, noise: tuple[float, float], pressed: Mask, length: float
    ) -> tuple[Mask, list[Array]]:
        """Which rows (k,) have a contact, what contradicts a single force, and how deep the contacts lie in their hull."""
        n, noisy = len(force), max(noise) > 0
        rod, down = self.rod.in_space(), self.down
        error = inverse.errors(force, moment, noise, rod=rod, gravity=down) if noisy else None
        s1, place, turn = (np.zeros(n),) * 3 if error is None else (error.s1, error.largest, _SIGMAS * error.tangent)
        tolerance = np.maximum(tip_sigmas(np.nan_to_num(s1, posinf=0.0)), _TIP)
        weights = noise if noisy else None
        found = inverse.reconstruct(force, moment, tolerance=tolerance, noise=weights, rod=rod, gravity=down)
        known, depth = found.status == inverse.Status.OK, np.zeros(n)
        usable = pressed & known
        rows = np.flatnonzero(usable & ~too_light(place, usable))
        turned = self.axes[rows]
        points = self.position[rows] + length * np.einsum("ni,nij->nj", found.point[rows], turned)
        tangents = np.einsum("ni,nij->nj", found.tangent[rows], turned)
        every, lines = np.arange(len(rows)), np.flatnonzero(found.phase[rows] == planar.Phase.TANGENTIAL)
        errors = _SIGMAS * length * place[rows], turn[rows]
        if len(rows) > 4:  # fewer lie on their hull
            misfit = depths_in_hull(points, every, every, lines, tangents, errors, length)
            np.maximum.at(depth, rows[np.concatenate([every, lines])], _LARGEST if misfit is None else _beyond(misfit))
        radius = self.rod.diameter_m / 2 / self.rod.length_m / length
        single = against_single_force(force, moment, found, noise, _SIGMAS, radius)
        return known, [*map(_beyond, single), depth]


def _beyond(misfit: Misfit) -> Array:
    """The part of a misfit that nothing explains."""
    return misfit.found - misfit.explained
