"""The relative error of the wrench (`scan3d.rigs`) that a recording's contradictions with itself show.

Where sweeps touch the same place, their contacts and supporting lines agree, whatever the body, if the rod is the stated
one and the sensor right.  Where contacts of one sweep lie beyond the lines of another one by more than noise explains, the
excess is put down to a relative error of the wrench, by two estimates, of which the larger one counts:

- by means over a few successive contacts of a sweep, each with the nearest line of another sweep, by the method of moments:
  contacts of a convex body lie on the inner sides of the lines, so that the squares of the positive means, over their variances
  by the noise, are 1 in the mean at most.  What they are more, over the same of a relative error of 1, is the square of the
  error (as R. DerSimonian and N. Laird, *Meta-analysis in clinical trials*, 1986, estimate a variance that is common to several
  studies).  An error of the wrench is nearly the same in successive contacts, and noise is not, which means tell apart;
- by the one pair of a contact and a line of which most is left that noise does not explain.

An error of the wrench shows in many means: a few that contradict the rest, as disturbed rows and dents do, are none.  Both
estimates see differences only.  What is the same in all sweeps shows nowhere, and the bounds allow for it with the factor of
all errors of the given size at once (`scan3d.rigs.RigErrors.factor`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import chdtri

import planar
from scan3d.arrays import Array, Index, evenly
from scan3d.cloud import Cloud, LeftOut
from scan3d.reconstruction.agreement import COMPARED, Compared, compared_in_slices, kappa
from scan3d.reconstruction.contacts import contacts, model_of, on_surface, renumbered, rest, spatial_contacts
from scan3d.reconstruction.errors import with_rig_errors
from scan3d.reconstruction.hollow import without_second_contacts
from scan3d.reconstruction.misfits import ROUNDING, depths_in_hull
from scan3d.reconstruction.wild import left_out
from scan3d.recording import Recording
from scan3d.rigs import with_relative

LARGEST = 0.005
"""Largest relative error that is allowed for; errors of the second order, of the size of its square times the square of the
factor, are not.  A recording with a larger one contradicts the model."""
# Probability that noise alone shows an error, so that bounds are wider than they need be.
_DOUBT = 0.05
# Successive contacts over which a mean is taken, and the most that one mean counts: that of three standard deviations.
_RUN, _ONE_MEAN = 4, 9.0
# Estimates with contacts that earlier ones have changed; an estimate that is not smaller than this part of the one before it is
# the last one, and none counts as smaller than the other part of it, because an error that is too large leaves few lines.
_PASSES, _SETTLED, _SMALLER = 6, 0.8, 0.25


def reconstruct(recording: Recording, method: str = "closed-form", model: str | None = None) -> Cloud:
    """Contacts of a recording, simulated or measured, with the normals of the surface where they can be known.

    method
        that of `planar.reconstruct`, for the planar model; the spatial one has the closed form only.
    model
        'planar' or 'spatial'; None is spatial if the recording has six axes, else planar.

    Planar: the direction of a normal within its slice's plane comes from (14), its inclination to the plane from the slices
    below and above.  Spatial: normals come from the slip and the path of the contact along each sweep, or from the force where
    there is no friction.  If the body proves smooth, all normals come from the support function fitted to all contacts.
    Points lie inside the rod's centre line by its radius, along the normals, in the plane as in space.
    Where opposed sweeps over the same place contradict each other, the contacts are those with the relative error of the wrench
    that explains it, of at most 0.5 %, and their `calibration` has what it does to them.  In space `pose_error` has twice
    how much deeper noisy contacts lie in the hull of all than their noise explains, which widens the bounds.
    Raises InputError if the recording has no contact, or not the axes that the model needs, and ValueError for an unknown
    method.
    """
    if model_of(recording, method, model) == "spatial":
        found = with_rig_errors(spatial_contacts(recording), recording)
        return replace(found, pose_error=found.pose_error + 2 * _deeper(found))
    touched = contacts(recording, method)
    hollow = recording.source.get("convex") is False
    if hollow:  # its slices may contradict each other without any error
        found = without_second_contacts(on_surface(touched, recording, convex=False), recording)
        if not found.convex:
            return found
    by_rig = with_rig_errors(touched, recording)
    left = None if hollow else left_out(recording, by_rig)
    if left is not None and not left.too_many:
        left, touched = _without_wild(recording, left, method)
        part, kept = rest(recording, left)
        known = _with_relative_error(part, with_rig_errors(touched, part), method)
        return renumbered(_with_left_out(_whole(touched, part, known, method), left), kept)
    known = _with_relative_error(recording, by_rig, method)
    found = _whole(touched, recording, known, method)
    if left is None:
        return found
    explained = known is not recording and left_out(recording, found.fattened or found) is None
    return found if explained else _with_left_out(found, left)


def _deeper(cloud: Cloud) -> float:
    """How much deeper contacts in space, or the rods there, lie in the hull of all than noise across the hull explains.

    Small errors that differ from sweep to sweep show there first, because most noise lies along the rod.  Errors that
    neighbours have in common do not show, and count as much again: a taper of 2 % made inner bodies false by a twentieth of a
    per cent of the diagonal without that.  At the edges of a body noise along the rod changes depths as well, so that too much
    is allowed for there.
    """
    if cloud.centre_covariance is None or cloud.tangents is None or cloud.tangent_sd is None:
        return 0.0
    points = cloud.points if cloud.centre_points is None else cloud.centre_points
    sigmas, every = kappa(len(cloud)), evenly(np.arange(len(cloud)), COMPARED)
    lines = every[(cloud.phase[every] == planar.Phase.TANGENTIAL) & np.isfinite(cloud.tangent_sd[every])]
    of_rig = np.zeros(len(cloud)) if cloud.calibration is None else sigmas * cloud.calibration.place_sd
    errors, covariance = (of_rig, sigmas * cloud.tangent_sd), sigmas**2 * cloud.centre_covariance
    misfit = depths_in_hull(points, every, every, lines, cloud.tangents, errors, cloud.rod_length, covariance)
    return 0.0 if misfit is None else max(float((misfit.found - misfit.explained).max()) - 2 * cloud.pose_error, 0.0)


def _without_wild(recording: Recording, left: LeftOut, method: str) -> tuple[LeftOut, Cloud]:
    """All rows to be left out, and the contacts of the others: a larger noise makes contacts of rows that were none."""
    for _ in range(_PASSES):
        part, kept = rest(recording, left)
        touched = contacts(part, method)
        further = left_out(part, with_rig_errors(touched, part))
        if further is None or not len(further.rows):
            break
        rows = np.append(left.rows, kept[further.rows])
        left = LeftOut(np.sort(rows), left.share + further.share, left.factor)
    return left, touched


def _whole(touched: Cloud, recording: Recording, known: Recording, method: str) -> Cloud:
    """The contacts, with normals, of the recording `known` with a relative error of the wrench; `touched` are those without."""
    return on_surface(touched if known is recording else contacts(known, method), known)


def _with_left_out(cloud: Cloud, left: LeftOut) -> Cloud:
    fattened = None if cloud.fattened is None else replace(cloud.fattened, left_out=left)
    return replace(cloud, left_out=left, fattened=fattened)


def _with_relative_error(recording: Recording, cloud: Cloud, method: str) -> Recording:
    """The recording with the relative error of the wrench that its contacts, which are those of `cloud`, show.

    It is the recording itself if that agrees with itself, or if an error of `LARGEST` does not explain that it does not.  The
    error changes the contacts in turn, because it decides what is told from a contact of the tip.
    """
    if recording.completed is not None:  # a completed channel has no error of its own
        return recording
    needed, hidden = _relative_error(recording, cloud)
    found, least, relative = recording, np.inf, min(needed, LARGEST)
    for _ in range(_PASSES if needed else 0):
        tried = replace(recording, rig=with_relative(recording.rig, relative))
        needed, hidden = _relative_error(recording, with_rig_errors(contacts(tried, method), recording))
        if needed <= relative < least:
            # what the noise may hide is allowed for as well
            largest = min(max(relative, hidden), LARGEST)
            found, least = replace(recording, rig=with_relative(recording.rig, largest)), relative
        following = min(max(needed, _SMALLER * relative), LARGEST)
        if _SETTLED * relative < following <= relative or following >= least:
            break
        relative = following
    return found


class _Means(NamedTuple):
    """Weighted means of how far successive contacts of a sweep lie beyond the nearest lines of another one, of t pairs."""

    line: Index
    """(t,) rows of the matrices of `Compared`."""
    contact: Index
    """(t,) columns of them."""
    mean: Index
    """(t,) number of the mean that the pair is in."""
    weight: Array
    """(t,) of sum 1 in each mean."""
    value: Array
    """(p,) the means, as far as noise has to explain them."""
    variance: Array
    """(p,) by the noise."""

    @property
    def square(self) -> Array:
        """(q,) squares of the positive means over their variances."""
        return (self.value**2 / self.variance)[self.value > 0]

    def over_noise(self, deviation: Array) -> Array:
        """(q,) squares of the positive means over their variances, of distances (k, m) that are errors of one sign."""
        found = np.bincount(self.mean, self.weight * deviation[self.line, self.contact], len(self.value))
        return (found**2 / self.variance)[self.value > 0]


def _means(compared: Compared, cloud: Cloud) -> _Means:
    """Those of a slice."""
    sweep, each = cloud.sweep[compared.rows], np.arange(len(compared.some))
    apart = cdist(compared.points[compared.lines], compared.points[compared.some])
    apart[sweep[compared.lines][:, None] == sweep[compared.some]] = np.inf
    nearest = apart.argmin(axis=0)
    contact = np.flatnonzero(np.isfinite(apart[nearest, each]))
    line = nearest[contact]
    # errors by digits alone are not independent
    explained = compared.systematic if cloud.independent else compared.misfit.explained
    beyond = (compared.misfit.found - explained)[line, contact]
    own = of_line = turned = np.zeros(len(line))
    if cloud.covariance is not None and cloud.normal_sd is not None:
        error = compared.errors(1.0, cloud.covariance, cloud.normal_sd)
        own, of_line, turned = (
            np.broadcast_to(part, compared.misfit.found.shape)[line, contact] for part in compared.deviations(error)
        )
    rounding = (ROUNDING * cloud.rod_length) ** 2
    sweeps = np.stack([sweep[compared.some[contact]], sweep[compared.lines[line]]])
    begins = (np.diff(sweeps, axis=1, prepend=-1) != 0).any(axis=0)
    stretch = np.cumsum(begins) - 1
    within = np.arange(len(line)) - np.flatnonzero(begins)[stretch]
    mean = np.cumsum(within % _RUN == 0) - 1
    weight = 1 / (own**2 + of_line**2 + turned**2 + rounding)
    weight /= np.bincount(mean, weight)[mean]
    # contacts that have a line in common have the same error of that line
    both, pair = np.unique(np.stack([mean, line]), axis=1, return_inverse=True)
    shared = sum(np.bincount(pair.reshape(-1), weight * part) ** 2 for part in (of_line, turned))
    variance = np.bincount(mean, weight**2 * own**2) + np.bincount(both[0], shared) + rounding
    value = np.bincount(mean, weight * beyond)
    return _Means(line, contact, mean, weight, np.asarray(value, dtype=float), np.asarray(variance, dtype=float))


def _relative_error(recording: Recording, cloud: Cloud) -> tuple[float, float]:
    """The relative error that the contacts of a recording show, and that of the one pair that differs most, whatever the noise.

    Both are 0 if the contacts agree.
    """
    total, count = 0.0, 0
    for compared in compared_in_slices(cloud):
        square = _means(compared, cloud).square
        total, count = total + float(np.minimum(square, _ONE_MEAN).sum()), count + len(square)
    if not count or total <= chdtri(count, _DOUBT):
        return 0.0, 0.0
    of_unit = with_rig_errors(replace(cloud, calibration=None), replace(recording, rig=with_relative(None, LARGEST)))
    unit, cloud = of_unit.calibration, cloud.select(np.isin(cloud.row, of_unit.row))
    assert unit is not None
    by_all, expected, worst, hidden = 0.0, 0.0, 0.0, 0.0
    for compared in compared_in_slices(cloud):
        error = compared.errors(1.0, unit.covariance, unit.tilt_sd)
        means, sum_of = _means(compared, cloud), sum(compared.deviations(error))
        worst = max(worst, float(((compared.misfit.found - compared.misfit.explained) / sum_of).max()))
        hidden = max(hidden, float(((compared.misfit.found - compared.systematic) / sum_of).max()))
        by_all += float((means.square - 1).sum())
        expected += float(means.over_noise(np.sqrt(compared.variance(error))).sum())
    # an error that changes no mean explains none
    by_means = np.sqrt(max(by_all, 0.0) / expected) if expected else np.inf
    return LARGEST * max(float(by_means), worst), LARGEST * hidden
