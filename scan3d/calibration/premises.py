"""Whether the misclosures of a calibration are those of noise, and by how much its uncertainties are enlarged if they are not.

Where the model holds, the four white misclosures of a row have the variance 1 each, and those of successive rows are as
independent as the noise.  Scatter beyond that enlarges all uncertainties: by its mean square (the Birge ratio), and by the
number of rows over which it is alike (the integrated autocorrelation).  Where it is more than noise could be, the model does
not fit: deviations with the sum of squares S may then be alike in all rows, and shift a parameter by no more than √S of its
standard deviations (the Cauchy-Schwarz inequality).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scan3d.arrays import Array, Mask
from scan3d.calibration.fit import CHANCE, Fit
from scan3d.calibration.references import Sphere
from scan3d.numbers import length, share
from scan3d.recording import Recording

# Estimated noise of the poses, in rod lengths, that is larger than that of robots, and the variance beyond 1 of the
# misclosures of an equation with which the model does not fit.
_ROUGH, _SPOILED = 1e-3, 0.3
# Lags in rows whose mean product tells deviations that are alike, and those up to which these are followed.
_NEAR, _FARTHEST = 3, 200
# Part of the deviations that one cause must explain to be named alone, and the scatter of the reactions across their plane,
# in standard deviations of the noise, up to which they lie in a plane.
_EXPLAINS, _FLAT = 0.1, 1.5


class Checked(NamedTuple):
    """The covariance of the parameters, and what the tests of the premises say."""

    covariance: Array
    """(p, p) zero for parameters that are not sought."""
    chi2: float
    """Sum of squares of the misclosures over their variances per degree of freedom."""
    consistency: float
    """The same of the two equations that only the wrench is in."""
    sentences: tuple[str, ...]
    spoiled: bool
    """Whether the model fits so badly that no quantity of the rig counts as well determined."""


def checked(fit: Fit, recording: Recording, estimated: bool) -> Checked:
    """Test the premises of a fit, whose noise of the poses may be `estimated`."""
    rows, kind, air = fit.rows, fit.rig.reference.kind, fit.problem.air
    white = np.where(rows.used, rows.white, 0.0)
    total = float((white**2).sum())
    sentences = []
    # the noise is not stated where it is that of the same rows
    stated = recording.noise_force_N > 0 and recording.noise_moment_Nm > 0
    if stated and air.misfit > 1 + CHANCE * np.sqrt(2 / (6 * air.air.sum())):
        sentences.append(_IN_THE_AIR.format(factor=air.misfit**0.5))
    rough = estimated and fit.noise.place > _ROUGH
    if rough:
        off = length(fit.noise.place * recording.rod.length_m, "m", digits=2)
        sentences.append(_ROUGH_POSES.format(off=off, kind=kind, check=_CHECK[kind]))
    if fit.noise.contradiction > 0:
        sentences.append(_CONTRADICTS.format(wrench=share(fit.noise.contradiction), air=share(in_air(fit))))
    excess = [_excess(white[rows.used[:, equation], equation] ** 2) for equation in range(4)]
    runs = [_alike(fit, white[:, equation], rows.used[:, equation]) for equation in range(4)]
    # of the equations that only the wrench is in, and of those of the contact
    groups = slice(0, 2), slice(2, 4)
    squares, alike = (
        [1 + max(excess[group]) for group in groups],
        [max(run for run, _ in runs[group]) for group in groups],
    )
    deviates = [max(excess[group]) > 0 or any(certain for _, certain in runs[group]) for group in groups]
    spoiled = any(deviates) and (rough or max(excess) > _SPOILED or _in_plane(fit))
    inverse = np.linalg.pinv(fit.jacobian)
    covariance = inverse @ inverse.T
    for deviating, square, run, sentence in zip(deviates, squares, alike, (_WRENCHES, _CONTACTS), strict=True):
        if deviating:
            cause = _cause(fit, white, covariance, recording)
            by = f"{square**0.5:.2f} times what noise explains" + f", alike over {run:.0f} rows" * (run >= 1.5)
            effect = _SPOILS if spoiled else _ENLARGES
            sentences.append(sentence.format(kind=kind, off=by, effect=effect, cause=cause))
    scatter = [float((white[used, k] ** 2).mean()) * runs[k][0] for k, used in enumerate(rows.used.T) if used.any()]
    enlarged = max(1.0, total if spoiled else max(scatter))
    both = rows.used[:, :2].all(axis=1)
    consistency = float((white[both, :2] ** 2).mean()) if both.any() else 1.0
    return Checked(enlarged * covariance, total / fit.freedom, consistency, tuple(sentences), spoiled)


def _excess(square: Array) -> float:
    """By how much the mean of squares of normal numbers (n,) is above 1, and 0 where that may be chance."""
    if len(square) < 2:
        return 0.0
    above = float(square.mean()) - 1
    return above if above > CHANCE * float(square.std()) / np.sqrt(len(square)) else 0.0


def _alike(fit: Fit, white: Array, used: Mask) -> tuple[float, bool]:
    """Over how many rows white misclosures (n,) are alike, 1 for those of white noise, and whether more is no chance.

    The sum of autocorrelations ends where two that follow one another are not positive (Geyer, 1992).
    """
    touches = fit.problem.touches
    last, square = len(touches.number) - 1, float((white[used] ** 2).mean()) if used.any() else 1.0
    rows, pair, near, pairs_near = 1.0, 0.0, 0.0, 0
    for lag in range(1, _FARTHEST):
        there = np.minimum(np.searchsorted(touches.number, touches.number + lag), last)
        both = (touches.number[there] == touches.number + lag) & (touches.sweep[there] == touches.sweep)
        both &= used & used[there]
        pairs, products = int(both.sum()), float((white * white[there])[both].sum())
        if not pairs:
            break
        pair += products / pairs / square
        if lag <= _NEAR:
            near, pairs_near = near + products, pairs_near + pairs
        if lag % 2 == 0:
            if pair <= 0:
                break
            rows, pair = rows + 2 * pair, 0.0
    return rows, near > CHANCE * np.sqrt(max(pairs_near, 1))


def _cause(fit: Fit, white: Array, inverse: Array, recording: Recording) -> str:
    """The likeliest cause of contacts that deviate from the reference."""
    reference, rod = fit.rig.reference, recording.rod
    if isinstance(reference, Sphere):
        by_radius = np.where(fit.rows.used, -fit.rows.factor[:, :, 2], 0.0).ravel()
        by_rig = fit.jacobian[: len(by_radius)]
        left = by_radius - by_rig @ (inverse @ (by_rig.T @ by_radius))
        information, slope = float(left @ by_radius), float(left @ white.ravel())
        if information > 0 and slope**2 / information > _EXPLAINS * float((white**2).sum()):
            diameter = 2 * rod.length_m * (reference.radius - slope / information) - rod.diameter_m
            return f"The likeliest cause is the diameter: one of {length(diameter, 'm', digits=4)} would fit better."
    return _PLANAR.format(kind=reference.kind) if _in_plane(fit) else _SHAPE.format(unlike=reference.unlike)


def in_air(fit: Fit) -> float:
    """The larger of the noises of force and moment, over the root mean square of those in contact."""
    noise = np.array([fit.noise.force, fit.noise.moment])
    return float((noise / np.sqrt(fit.problem.squares.mean(axis=0) / 3)).max())


def _in_plane(fit: Fit) -> bool:
    """Whether all of the six-axis forces lie in one plane of the sensor, as in a planar model."""
    touches = fit.problem.touches
    force = (touches.wrench - touches.basis @ fit.rig.tare.T)[:, :3]
    scatter = float(np.linalg.svd(force, compute_uv=False)[-1]) / np.sqrt(len(force))
    return bool(fit.problem.channels.all()) and scatter < _FLAT * fit.noise.force


_CHECK = {"sphere": "the diameters of sphere and rod", "plane": "the flatness of the plane"}
_ROUGH_POSES = (
    "The contacts deviate from the {kind} as if the poses scattered by {off}, which is more than those of a robot do: "
    "check {check}, and that the {kind} did not move."
)
_IN_THE_AIR = (
    "In the air the reactions scatter by {factor:.2f} times the stated noise: the sensor drifts otherwise than the tare "
    "assumes, or the noise is larger than stated; what is found in the air was used instead."
)
_CONTRADICTS = (
    "In contact force and moment contradict a single force by {wrench}, and the noise in the air is {air}: gains and "
    "cross-talk of the sensor's channels are estimated with the rig, what the touches do not tell of them is part of all "
    "uncertainties, and scans with this sensor have them too."
)
_WRENCHES = (
    "In contact the moments about the rod and along the force deviate from zero by {off}: {effect}. The likeliest causes are "
    "noise of the sensor that is larger than stated or alike in neighbouring rows, friction across a thick rod, a second "
    "contact, a sensor whose channels mix, and a tare that changes within a sweep."
)
_CONTACTS = "The contacts deviate from the {kind}, or the rod from its tangent, by {off}: {effect}. {cause}"
_ENLARGES = "the uncertainties are enlarged by them"
_SPOILS = (
    "the model does not fit these touches, no quantity of the rig is called well determined, and the uncertainties are those "
    "of deviations that are alike in all rows"
)
_PLANAR = (
    "The likeliest cause is a log whose forces lie in one plane, of a planar model or of a sensor with three channels; a rod "
    "that slides sideways over a {kind} has none such."
)
_SHAPE = (
    "The likeliest causes are {unlike}, a second contact, a rod that sticks, poses that deviate from the clamp's path or by "
    "more than stated, and noise of the sensor that is alike in neighbouring rows."
)
