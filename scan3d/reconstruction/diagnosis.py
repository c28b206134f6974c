"""The likeliest fault of a recording that contradicts the model.

Each hypothesis is a single fault with at most three numbers.  They are estimated by least squares of residuals that vanish for
a right recording (`scan3d.reconstruction.misfits`), and the hypothesis that leaves least of them is named, if it leaves little.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from scan3d.arrays import Array, Index
from scan3d.reconstruction.faults import Fault, Hypothesis, hypotheses
from scan3d.reconstruction.misfits import LARGEST, Reactions, Touches, felt, noise, reactions_of, touches_of
from scan3d.reconstruction.sensor_frames import FRAME_CODES, TURNED_AND_MOVED, frame_faults
from scan3d.recording import Recording

# A fault is named if its correction removes at least this part of the root mean square misfit.  Smaller, wrong faults are named
# more often; larger, fewer faults are.
_EXPLAINS = 0.8
# Hypotheses whose mean square misfits differ by less than this factor cannot be told apart.
_ALIKE = 4.0
# What each estimated number must lower the mean square misfit by, as a factor.
_PER_NUMBER = 2.0
# Mean square misfit that counts as none, and one below which noise hides differences.
_NONE, _HIDDEN = 1e-12, 1e-5
# Hypotheses that are refined, starts of each, and evaluations of a refinement.
_REFINED, _STARTS, _EVALUATIONS = 4, 2, 12
# Runs of rows that repeat others of which each is tried.
_RUNS = 60
# A skew that is this part of the mean square misfit is that of a second contact, if nothing else explains it.
_BY_SKEW = 0.5
_UNKNOWN = "check signs, axes and units, the tare of force and moment, the rod, and that the body is convex"


class Diagnosis(NamedTuple):
    """The likeliest fault of a recording that contradicts the model."""

    fault: str
    """Its code, ``unknown`` where no single fault explains the contradiction."""
    value: float | None
    """Its estimated size in `unit`; None where it has none."""
    unit: str
    explains: float
    """Part of the root mean square misfit that the correction of the fault removes."""
    message: str
    """What it is and what to do, as the end of a sentence."""


class _Trial(NamedTuple):
    hypothesis: Hypothesis
    numbers: Array
    misfit: float

    @property
    def score(self) -> float:
        """Mean square misfit with what its numbers cost, as a logarithm."""
        return float(np.log(self.misfit + _NONE) + self.hypothesis.cost * np.log(_PER_NUMBER))


def diagnose(recording: Recording, model: str) -> Diagnosis:
    """The likeliest fault of a recording that contradicts the model 'planar' or 'spatial'."""
    measured = reactions_of(recording, model)
    stuck = stuck_rows(recording, measured)
    touches = touches_of(recording, model, stuck)
    if not len(touches.rows):
        return _unknown(0.0)
    few = touches_of(recording, model, stuck, few=True)
    before = _mean_square(touches.misfit(_of_rows(measured, touches.rows)))
    candidates = hypotheses(recording, model, measured, _contradicting(stuck, measured, touches))
    candidates += frame_faults(recording, model, measured)
    if before <= _NONE:
        return _unknown(0.0)
    trials = _searched(candidates, measured, few)
    trials = sorted((_refined(trial, measured, touches) for trial in trials), key=lambda trial: trial.score)
    named = [trial for trial in trials if _explains(trial, before) >= _EXPLAINS]
    if not named:
        best = _explains(trials[0], before) if trials else 0.0
        return _second_contact(touches, measured, model, best) or _unknown(best)
    best_trial = named[0]
    fault = best_trial.hypothesis.fault(best_trial.numbers)
    # a fault of several numbers that contains the best one is no alternative to it
    others: dict[str, Fault] = {}
    hidden = _HIDDEN if max(noise(recording)) else _NONE
    for trial in named[1:]:
        other = trial.hypothesis.fault(trial.numbers)
        alike = trial.misfit + hidden < _ALIKE * (best_trial.misfit + hidden)
        simple = trial.hypothesis.cost <= best_trial.hypothesis.cost
        # a frame that nobody stated is as likely as any simpler fault, unless that is one of the frame
        unstated = other.code == TURNED_AND_MOVED and not fault.code.startswith(FRAME_CODES)
        if alike and other.code != fault.code and (simple or unstated):
            others.setdefault(other.code, other)
    message = f"most likely {fault.message}"
    if others:
        message = "most likely either " + ", or ".join([fault.message, *(other.message for other in others.values())])
    return Diagnosis(fault.code, fault.value, fault.unit, _explains(best_trial, before), message)


def stuck_rows(recording: Recording, measured: Reactions) -> Index:
    """Rows whose reactions under a force repeat those of the row before while the clamp moves, two or more in succession."""
    same = np.zeros(len(recording), dtype=bool)
    force, moment = measured.force, measured.moment
    same[1:] = (
        (force[1:] == force[:-1]).all(axis=1)
        & (moment[1:] == moment[:-1]).all(axis=1)
        & (recording.position_m[1:] != recording.position_m[:-1]).any(axis=1)
        & felt(force, noise(recording))[1:]
    )
    run = same.copy()
    run[1:-1] = same[1:-1] & (same[:-2] | same[2:])
    return np.flatnonzero(run)


def _contradicting(stuck: Index, measured: Reactions, touches: Touches) -> Index:
    """Those of the rows that repeat others whose runs contradict the rest: along a flat face right reactions repeat as well."""
    runs = np.split(stuck, np.flatnonzero(np.diff(stuck) > 1) + 1)
    if not len(stuck) or len(runs) > _RUNS:
        return stuck

    def without(rows: Index) -> float:
        free = ~np.isin(touches.rows, rows)[:, None]
        some = _of_rows(measured, touches.rows)
        return _mean_square(touches.misfit(Reactions(some.force * free, some.moment * free)))

    least = _ALIKE * without(stuck) + _NONE
    wrong = [run for run in runs if without(np.setdiff1d(stuck, run)) > least]
    return np.concatenate(wrong) if wrong else stuck


def _of_rows(reactions: Reactions, rows: Index) -> Reactions:
    return Reactions(reactions.force[rows], reactions.moment[rows], reactions.length)


def _corrected(hypothesis: Hypothesis, measured: Reactions, rows: Index, numbers: Array) -> Reactions:
    return hypothesis.correct(_of_rows(measured, rows), rows, numbers)


def _mean_square(residuals: Array) -> float:
    return float(np.mean(residuals**2))


def _explains(trial: _Trial, before: float) -> float:
    return float(1 - np.sqrt(trial.misfit / before))


def _searched(candidates: list[Hypothesis], measured: Reactions, few: Touches) -> list[_Trial]:
    """The best hypotheses with numbers, as estimated by few rows, and all hypotheses without numbers."""
    plain: list[_Trial] = []
    found: list[list[_Trial]] = []
    for hypothesis in candidates:
        if not len(hypothesis.starts[0]):
            plain.append(_Trial(hypothesis, hypothesis.starts[0], np.inf))
            continue
        tried = [
            _Trial(
                hypothesis,
                numbers,
                _mean_square(few.misfit(_corrected(hypothesis, measured, few.rows, numbers))),
            )
            for numbers in hypothesis.starts
        ]
        found.append(sorted(tried, key=lambda trial: trial.misfit)[:_STARTS])
    # the misfits of starts between which the right one lies differ little, those of estimates a lot
    rough = [
        min((_fitted(trial, measured, few) for trial in starts), key=lambda trial: trial.misfit) for starts in found
    ]
    return plain + sorted(rough, key=lambda trial: trial.score)[:_REFINED]


def _fitted(trial: _Trial, measured: Reactions, touches: Touches) -> _Trial:
    hypothesis, limit = trial.hypothesis, trial.hypothesis.limit

    def residuals(numbers: Array) -> Array:
        return touches.misfit(_corrected(hypothesis, measured, touches.rows, numbers)) / LARGEST

    found = least_squares(residuals, trial.numbers, bounds=(-limit, limit), diff_step=1e-5, max_nfev=_EVALUATIONS)
    return _Trial(hypothesis, np.asarray(found.x), _mean_square(found.fun) * LARGEST**2)


def _refined(trial: _Trial, measured: Reactions, touches: Touches) -> _Trial:
    """The trial by all rows that are compared."""
    if len(trial.numbers):
        return _fitted(trial, measured, touches)
    corrected = _corrected(trial.hypothesis, measured, touches.rows, trial.numbers)
    return trial._replace(misfit=_mean_square(touches.misfit(corrected)))


def _second_contact(touches: Touches, measured: Reactions, model: str, explains: float) -> Diagnosis | None:
    """A second contact, if the moment along the force is most of the misfit and no fault of the rig explains it."""
    if model != "spatial":
        return None
    about_rod, along_force, _ = touches.misfit(_of_rows(measured, touches.rows)).reshape(3, -1)
    if _mean_square(along_force) <= _BY_SKEW * _mean_square(np.hypot(about_rod, along_force)):
        return None
    fraction = float((along_force > 0).sum() / max(len(along_force), 1))
    return Diagnosis(
        "second-contact",
        100 * fraction,
        "%",
        explains,
        f"most likely either a second contact, or channels that were exchanged or logged at different times: force and moment "
        f"of {100 * fraction:.2g} % of the rows are not those of a single force; look for what else the rod touches",
    )


def _unknown(explains: float) -> Diagnosis:
    return Diagnosis("unknown", None, "", explains, f"no single fault explains the contradiction: {_UNKNOWN}")
