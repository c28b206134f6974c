"""Tests of a calibration's premises, and the uncertainties that follow from what they find."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array
from scan3d.laboratory import calibration_words as words
from scan3d.laboratory.calibration_air import Unloaded
from scan3d.laboratory.calibration_colour import Colour
from scan3d.laboratory.calibration_fit import Adjusted, Noise, Problem
from scan3d.laboratory.calibration_model import TARE
from scan3d.laboratory.calibration_reference import Spherical
from scan3d.laboratory.calibration_residuals import Systematic, noise_covariance, systematic
from scan3d.recording import Recording

# Estimated noise of the poses, in rod lengths, that is larger than that of robots.
_ROUGH = 1e-3
# How many standard deviations of a mean square the tests of the premises allow.
_SIGMAS = 4.0
# Variance beyond 1 of the misclosures of an equation with which the model does not fit.
_SPOILED = 0.3
# Part of the systematic deviations that one cause must explain to be named alone.
_EXPLAINS = 0.3
# Scatter of the reactions across their plane, in standard deviations of the noise, up to which they lie in a plane.
_FLAT = 1.5


class Fitted(NamedTuple):
    """What a calibration is made from."""

    fit: Adjusted
    problem: Problem
    noise: Noise
    air: Unloaded
    world: Array
    """(3, 3) from the world to the frame of the equations."""
    rows: NDArray[np.intp]
    """(n,) numbers of the rows in contact in the recording."""
    sweep: NDArray[np.int64]
    """(n,) of these rows."""
    colours: tuple[Colour, Colour]
    """Of the noise of force and moment."""
    estimated: bool
    """Whether the noise of the poses is an estimate."""


class Checked(NamedTuple):
    """The uncertainties of quantities, and what the tests of the premises say."""

    covariance: Array
    """(q, q)"""
    systematic: Systematic
    chi2: float
    consistency: float
    freedom: int
    sentences: tuple[str, ...]
    spoiled: bool
    """Whether the model fits so badly that no quantity of the rig counts as well determined."""

    @property
    def largest_shifts(self) -> Array:
        """By how much (q,) systematic deviations shift the quantities at most, to the first order."""
        groups = zip(self.systematic.square, self.systematic.normal, strict=True)
        return np.asarray(sum(np.sqrt(square * np.diag(normal)) for square, normal in groups))


def check(fitted: Fitted, recording: Recording, jacobian: Array) -> Checked:
    """Test the premises of a fit; `jacobian` (q, p) are the derivatives of quantities by the parameters."""
    fit, problem, noise = fitted.fit, fitted.problem, fitted.noise
    free = np.flatnonzero(problem.free)
    scale = 1 / np.sqrt(np.diag(fit.normal)[free])
    inverse = np.zeros_like(fit.normal)
    inner = np.linalg.inv(fit.normal[np.ix_(free, free)] * scale[:, None] * scale)
    inverse[np.ix_(free, free)] = inner * scale[:, None] * scale
    by_gradient = inverse @ jacobian.T
    found = systematic(fit, problem, noise, fitted.colours, fitted.rows, fitted.sweep, by_gradient)
    covariance = noise_covariance(fit, problem, noise, fitted.colours, fitted.rows, by_gradient) + found.covariance
    chi2, consistency, freedom = _squares(fitted)
    largest = _largest(int(fit.used.sum())), _largest(int(fit.used[:, :2].sum()))
    # scatter beyond the noise that is white is noise that was understated: the Birge ratio
    birge = max([1.0] + [square for square, most in zip((chi2, consistency), largest, strict=True) if square > most])
    place_mm = 1000 * noise.place * recording.rod.length_m
    rough = fitted.estimated and noise.place > _ROUGH
    stated = recording.noise_force_N > 0 and recording.noise_moment_Nm > 0
    sentences: tuple[str, ...] = (words.rough_poses(place_mm, problem.reference),) if rough else ()
    sentences += words.premises(
        (chi2, np.inf if fitted.estimated else largest[0]),
        # the noise is not stated where it is that of the same rows
        (fitted.air.misfit, _largest(fit.air_residual.size) if stated else np.inf),
        (consistency, largest[1]),
        problem.reference,
    )
    spoiled = bool(found) and (noise.place > _ROUGH or max(found.excess) > _SPOILED)
    if found:
        sentences += _deviations(fitted, found, inverse, recording, spoiled)
    if spoiled:  # then the deviations may be alike in all rows
        covariance += sum(square * normal for square, normal in zip(found.square, found.normal, strict=True))
    return Checked(birge * covariance, found, chi2, consistency, freedom, sentences, spoiled)


def _squares(fitted: Fitted) -> tuple[float, float, int]:
    """Mean squares of the misclosures in contact, and of those of the wrench alone, in variances, and the degrees of freedom.

    The parameters that the rows in contact determine are counted with these, the tare with the rows in the air.
    """
    fit, problem = fitted.fit, fitted.problem
    freedom = max(int(fit.used.sum()) - int(problem.free[:TARE].sum()), 1)
    total = float((fit.white**2).sum()) / freedom
    used = fit.used[:, :2].all(axis=1)
    return total, float((fit.white[used, :2] ** 2).mean()) if used.any() else 1.0, freedom


def _largest(count: int) -> float:
    """The largest mean square of `count` normal numbers that is no contradiction."""
    return 1 + _SIGMAS * float(np.sqrt(2 / max(count, 1)))


def _deviations(
    fitted: Fitted, found: Systematic, inverse: Array, recording: Recording, spoiled: bool
) -> tuple[str, ...]:
    """The sentence on systematic deviations and their likeliest cause."""
    if not found.square[1]:
        return (words.alike_in_wrench(found.rows, spoiled),)
    fit, problem = fitted.fit, fitted.problem
    variances = fitted.noise.variances(problem.channels)
    spread = (fit.by_row[:, 2] ** 2 @ variances)[fit.used[:, 2]]
    length_mm = 1000 * recording.rod.length_m
    size = length_mm * float(np.sqrt(found.variance[1] * np.median(spread)))
    radius, explained = _radius(fit, problem, inverse) if isinstance(problem.reference, Spherical) else (0.0, 0.0)
    cause = "shape"
    if explained > _EXPLAINS * sum(found.square):
        cause = "diameter"
    elif problem.channels.all() and _in_plane(fitted):
        cause = "planar"
    wanted = 1000 * (2 * recording.rod.length_m * (problem.reference.radius + radius) - recording.rod.diameter_m)
    return (words.alike_in_contact(size, found.rows, cause, wanted, spoiled, problem.reference),)


def _radius(fit: Adjusted, problem: Problem, inverse: Array) -> tuple[float, float]:
    """By how much a larger radius of the sphere fits better, to the first order, and the fall of the sum of squares."""
    by_radius = np.where(fit.used, -fit.factor[:, :, 2], 0.0)
    together = np.einsum("nep,ne->p", fit.white_by_rig, by_radius)
    together[~problem.free] = 0
    left = by_radius - fit.white_by_rig @ (inverse @ together)
    information = float((left * by_radius).sum())
    slope = float((left * fit.white).sum())
    if information <= 0:
        return 0.0, 0.0
    return -slope / information, slope**2 / information


def _in_plane(fitted: Fitted) -> bool:
    """Whether all forces lie in one plane of the sensor and all moments are normal to it, as in a planar model."""
    touches, noise = fitted.problem.touches, fitted.noise
    tared = touches.wrench - touches.basis @ fitted.fit.rig.tare.T
    _, _, axes = np.linalg.svd(tared[:, :3], full_matrices=False)
    across = float(np.sqrt(((tared[:, :3] @ axes[2]) ** 2).mean()))
    return across < _FLAT * noise.force
