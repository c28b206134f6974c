"""Which rows of a calibration are used, and what kind of contact each of them is.

A row must not be chosen by its own noise.  If rows were taken whose measured force exceeds a limit, those near the limit would
have noise that points outwards on average, and the estimate would be biased by a fraction of its standard deviation.  Rows are
chosen by their neighbours in the same sweep, whose noise is another.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array, Mask
from scan3d.laboratory.calibration_fit import Noise, Problem, misfits
from scan3d.laboratory.calibration_model import Kind, Rig, Touches, equations, placed

# Neighbours on either side of a row that decide whether it is used.
_NEIGHBOURS = 3
# Standard deviations beyond which a row is taken for a tip contact or a tangential one, and the cosine between tangent and
# normal from which it is a tip contact, whatever the noise.
_SIGMAS, _COSINE = 4.0, 0.01
# Difference of the sums of squares of both kinds over the rows before and after a row from which its kind is certain.
_LIKELIER = 12.0
# The same difference of a single row with which it contradicts its neighbours.  Smaller, rows would be chosen by their noise.
_CONTRADICTS = 30.0
# Standard deviation of s1, in rod lengths, from which a contact shows how long the rod is, and the windows of the averages in
# half a sweep.
_SURE, _WINDOWS = 0.02, 10
# Contacts are far from the tip within this part of the quantile of s1 that serves as the largest, for a first estimate.
_FAR, _FARTHEST = 0.85, 0.98
# Quantile of s1 of the contacts that are not tangential which is that of the tip: lower, contacts that stick or touch edges
# hide the tip; higher, single contacts that the noise puts past it do.
_TIP_S1 = 0.8
# Tip contacts that are needed for the free length.
_FEWEST_TIPS = 8


def neighbours(wrench: Array, sweep: NDArray[np.int64], contact: Mask) -> Array:
    """The wrench (n, 6) of each row in contact as the nearest rows of its sweep predict it, without its own.

    It is that of the straight line through up to three rows before and three after it.
    """
    result: Array = wrench.copy()
    for number in np.unique(sweep[contact]):
        rows = np.flatnonzero((sweep == number) & contact)
        result[rows] = _predicted(wrench[rows], rows.astype(float))
    return result


def _predicted(values: Array, place: Array) -> Array:
    """The values (n, c) at places (n,) on the lines through the others nearby; the values where there are no others."""
    offsets = [k for k in range(-_NEIGHBOURS, _NEIGHBOURS + 1) if k != 0]
    index = np.arange(len(values))[:, None] + offsets
    within = (index >= 0) & (index < len(values))
    index = np.clip(index, 0, len(values) - 1)
    away = place[index] - place[:, None]
    inside = np.where(np.abs(away) <= _NEIGHBOURS, within, False)
    count = np.maximum(inside.sum(axis=1), 1)
    middle = (away * inside).sum(axis=1) / count
    spread = inside * (away - middle[:, None])
    square = (spread**2).sum(axis=1)
    weight = inside / count[:, None] - (middle / np.where(square > 0, square, 1))[:, None] * spread
    predicted = np.einsum("nk,nkc->nc", weight, values[index])
    return np.where(np.asarray(inside.any(axis=1))[:, None], predicted, values)


def _around(values: Array, half: int) -> Array:
    """Sums (n, c) of the rows within `half` before and after each row, without its own."""
    running = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    middle = np.arange(len(values))
    ends = np.minimum(middle + half + 1, len(values)), np.maximum(middle - half, 0)
    return np.asarray(running[ends[0]] - running[ends[1]] - values)


def kinds(problem: Problem, sweep: NDArray[np.int64], rig: Rig, noise: Noise) -> tuple[NDArray[np.int8], float | None]:
    """The kind of each contact (n,) of sweeps (n,), and the free length, None without tip contacts.

    No contact lies past the tip, so that tip contacts are those with the largest s1 whose rod is not tangential.  Tangent and
    s1 are averaged along each sweep, so that the noise of a row does not decide its kind.
    """
    touches, variances = problem.touches, noise.variances(problem.channels)
    n = len(touches.kind)
    as_tangential = equations(rig, touches._replace(kind=np.full(n, Kind.TANGENTIAL, dtype=np.int8)), problem.reference)
    as_tip = equations(rig, touches._replace(kind=np.full(n, Kind.TIP, dtype=np.int8)), problem.reference)
    result = np.full(n, Kind.TANGENTIAL, dtype=np.int8)
    with np.errstate(invalid="ignore", divide="ignore"):
        inward = problem.reference.inward
        cosine, cosine_sd = _averaged(
            as_tangential.value[:, inward], (as_tangential.by_row[:, inward] ** 2) @ variances, sweep
        )
        s1, s1_sd = _averaged(as_tip.value[:, 3] + rig.length, (as_tip.by_row[:, 3] ** 2) @ variances, sweep)
        sure = s1_sd < _SURE
        if not sure.any():
            return result, None
        not_tangential: Mask = cosine < -_SIGMAS * cosine_sd - _COSINE
        # a single largest s1 is that of the noise
        surely = sure & not_tangential
        tip_s1 = np.quantile(s1[surely], _TIP_S1) if surely.sum() >= _FEWEST_TIPS else s1[sure].max()
        farthest: Mask = s1 - tip_s1 > -_SIGMAS * s1_sd - _SURE
        tip: Mask = farthest & not_tangential
        if tip.sum() < _FEWEST_TIPS:  # then the farthest may be at the tip all the same
            result[farthest] = Kind.UNSURE
            return result, None
        length = float(np.average(s1[tip], weights=1 / s1_sd[tip] ** 2))
        near: Mask = s1 > length - _SIGMAS * s1_sd - _COSINE
    if problem.reference.abrupt:  # averages over the transition are those of neither kind
        near |= _summed(near.astype(float), sweep) > 0
    result[near] = Kind.UNSURE
    result[near & tip] = Kind.TIP
    return result, length


def _all(touches: Touches, kind: Kind) -> Touches:
    """The rows, all of one kind."""
    return touches._replace(kind=np.full(len(touches.kind), kind, dtype=np.int8))


def far_kinds(problem: Problem, sweep: NDArray[np.int64], rig: Rig, noise: Noise) -> NDArray[np.int8]:
    """Contacts (n,) that are certainly not at the tip are tangential; for a rig that is too rough for more."""
    as_tip = equations(rig, _all(problem.touches, Kind.TIP), problem.reference)
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = (as_tip.by_row[:, 3] ** 2) @ noise.variances(problem.channels)
        s1, _ = _averaged(as_tip.value[:, 3] + rig.length, variance, sweep)
    far = s1 < _FAR * np.nanquantile(s1, _FARTHEST) if np.isfinite(s1).any() else np.zeros(len(s1), dtype=bool)
    return np.where(far, Kind.TANGENTIAL, Kind.UNSURE).astype(np.int8)


def likelier_kinds(problem: Problem, sweep: NDArray[np.int64], rig: Rig, noise: Noise) -> NDArray[np.int8]:
    """The kind of each contact (n,) of sweeps (n,) by that of its neighbours, for a rig whose length is known."""
    result = np.full(len(sweep), Kind.UNSURE, dtype=np.int8)
    tangential, tip = (_all(problem.touches, kind).kind for kind in (Kind.TANGENTIAL, Kind.TIP))
    tangential = placed(rig, problem.touches, problem.reference, tangential)
    difference = misfits(problem, rig, noise, tangential) - misfits(problem, rig, noise, tip)
    if problem.reference.abrupt:
        together = np.zeros(len(sweep))
        for number in np.unique(sweep):
            rows = np.flatnonzero(sweep == number)
            together[rows] = _evidence(difference[rows]) + _evidence(difference[rows][::-1])[::-1]
    else:
        together = _summed(difference, sweep, own=False)
    result[together < -_LIKELIER] = Kind.TANGENTIAL
    result[together > _LIKELIER] = Kind.TIP
    if not problem.reference.smooth:  # at an edge a single contact may be of another kind than those around it
        contradicts = np.where(result == Kind.TIP, -difference, difference)
        result[contradicts > _CONTRADICTS] = Kind.UNSURE
    return result


def _evidence(difference: Array) -> Array:
    """What the rows before each row (n,) say of its kind: by how much one kind costs more than the other.

    Contacts change their kind now and then.  A change costs as much as the evidence that makes a kind certain, so that no more
    than this is handed on from row to row (the Viterbi algorithm for two states).
    """
    result, total = np.zeros(len(difference)), 0.0
    for row, value in enumerate(difference):
        result[row] = total
        total = min(max(total + float(value), -_LIKELIER), _LIKELIER)
    return result


def _summed(values: Array, sweep: NDArray[np.int64], own: bool = True) -> Array:
    """Sums (n,) over neighbours in the same sweep, with the row's own value or without it."""
    result = values.copy() if own else np.zeros(len(values))
    for number in np.unique(sweep):
        rows = np.flatnonzero(sweep == number)
        result[rows] += _around(values[rows, None], max(len(rows) // _WINDOWS, 1))[:, 0]
    return result


def _averaged(values: Array, variance: Array, sweep: NDArray[np.int64]) -> tuple[Array, Array]:
    """Weighted means (n,) over neighbours in the same sweep, and their standard deviations."""
    weight = np.where(np.isfinite(values) & np.isfinite(variance) & (variance > 0), 1 / variance, 0.0)
    total, product = _summed(weight, sweep), _summed(weight * np.nan_to_num(values), sweep)
    return product / total, 1 / np.sqrt(total)
