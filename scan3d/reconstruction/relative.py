"""The relative error of the wrench (`scan3d.rigs`) that a recording's contradictions with itself show.

Where sweeps touch the same place, their contacts and supporting lines agree, whatever the body, if the rod is the stated
one and the sensor right.  Where contacts of one sweep lie beyond the lines of another one by more than noise explains, the
excess is put down to a relative error of the wrench, by two estimates, of which the larger one counts:

- by all pairs of a contact and the nearest line of another sweep, with the method of moments: a contact of a convex body lies
  on the inner side of the line, so that the squares of the positive distances, over their variances by the noise, are 1 in the
  mean at most.  What they are more, over the same of a relative error of 1, is the square of the error (as R. DerSimonian and
  N. Laird, *Meta-analysis in clinical trials*, 1986, estimate a variance that is common to several studies);
- by the one pair of which most is left that noise does not explain.

An error of the wrench shows in many pairs: a few that contradict each other, as disturbed rows and dents do, are none.  Both
estimates see differences only.  What is the same in all sweeps shows nowhere, and the bounds allow for it with the factor of
all errors of the given size at once (`scan3d.rigs.RigErrors.factor`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import chdtri

from scan3d.arrays import Array, Index
from scan3d.cloud import Cloud
from scan3d.reconstruction.agreement import FALSE_ALARM, Compared, compared_in_slices
from scan3d.reconstruction.contacts import by_model, contacts
from scan3d.reconstruction.errors import with_rig_errors
from scan3d.reconstruction.hollow import without_second_contacts
from scan3d.reconstruction.misfits import ROUNDING
from scan3d.recording import Recording
from scan3d.rigs import with_relative

LARGEST = 0.005
"""Largest relative error that is allowed for; errors of the second order, of the size of its square times the square of the
factor, are not.  A recording with a larger one contradicts the model."""
# The most that one pair counts as evidence: that of three standard deviations.
_ONE_PAIR = 9.0
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
    that explains it, of at most 0.5 %, and their `calibration` has what it does to them.
    Raises InputError if the recording has no contact, numbers so large that their squares are none, or not the axes that the
    model needs, and ValueError for an unknown method.
    """
    cloud = by_model(recording, method, model)
    if cloud.model == "spatial":
        return cloud
    hollow = without_second_contacts(cloud, recording)
    if not hollow.convex:
        return hollow
    known = _with_relative_error(recording, cloud, method)
    return cloud if known is recording else by_model(known, method, model)


def _with_relative_error(recording: Recording, cloud: Cloud, method: str) -> Recording:
    """The recording with the relative error of the wrench that its contacts, which are those of `cloud`, show.

    It is the recording itself if that agrees with itself, or if an error of `LARGEST` does not explain that it does not.  The
    error changes the contacts in turn, because it decides what is told from a contact of the tip.
    """
    needed, hidden = _relative_error(recording, cloud.fattened or cloud)
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


class _Pairs(NamedTuple):
    """Contacts that lie beyond the nearest line of another sweep, and by how much."""

    line: Index
    """(p,) rows of the matrices of `Compared`."""
    contact: Index
    """(p,) columns of them."""
    square: Array
    """(p,) squares of the distances beyond the lines, over their variances by the noise."""
    variance: Array
    """(p,)"""


def _pairs(compared: Compared, cloud: Cloud) -> _Pairs:
    """The pairs of a slice."""
    sweep, each = cloud.sweep[compared.rows], np.arange(len(compared.some))
    apart = cdist(compared.points[compared.lines], compared.points[compared.some])
    apart[sweep[compared.lines][:, None] == sweep[compared.some]] = np.inf
    nearest = apart.argmin(axis=0)
    # errors by digits alone are not independent
    explained = compared.systematic if cloud.independent else compared.misfit.explained
    beyond = (compared.misfit.found - explained)[nearest, each]
    # of the contacts that have a line in common the nearest one counts: the others have the same error of that line
    order = np.lexsort((apart[nearest, each], nearest))
    first = order[np.append(True, np.diff(nearest[order]) > 0)]
    kept = np.zeros(len(each), dtype=bool)
    kept[first] = ((beyond > 0) & np.isfinite(apart[nearest, each]))[first]
    variance = np.full(len(each), (ROUNDING * cloud.rod_length) ** 2)
    if cloud.covariance is not None and cloud.normal_sd is not None:
        by_noise = compared.variance(compared.errors(1.0, cloud.covariance, cloud.normal_sd))
        variance += by_noise[nearest, each]
    square = beyond**2 / variance
    return _Pairs(nearest[kept], each[kept], square[kept], variance[kept])


def _relative_error(recording: Recording, cloud: Cloud) -> tuple[float, float]:
    """The relative error that the contacts of a recording show, and that of the one pair that differs most, whatever the noise.

    Both are 0 if the contacts agree.
    """
    total, count = 0.0, 0
    for compared in compared_in_slices(cloud):
        square = _pairs(compared, cloud).square
        total, count = total + float(np.minimum(square, _ONE_PAIR).sum()), count + len(square)
    if not count or total <= chdtri(count, FALSE_ALARM):
        return 0.0, 0.0
    of_unit = with_rig_errors(replace(cloud, calibration=None), replace(recording, rig=with_relative(None, LARGEST)))
    unit, cloud = of_unit.calibration, cloud.select(np.isin(cloud.row, of_unit.row))
    assert unit is not None
    by_all, expected, worst, hidden = 0.0, 0.0, 0.0, 0.0
    for compared in compared_in_slices(cloud):
        error = compared.errors(1.0, unit.covariance, unit.tilt_sd)
        pairs, sum_of = _pairs(compared, cloud), sum(compared.deviations(error))
        worst = max(worst, float(((compared.misfit.found - compared.misfit.explained) / sum_of).max()))
        hidden = max(hidden, float(((compared.misfit.found - compared.systematic) / sum_of).max()))
        by_all += float((pairs.square - 1).sum())
        expected += float((compared.variance(error)[pairs.line, pairs.contact] / pairs.variance).sum())
    return LARGEST * max(float(np.sqrt(by_all / expected)), worst), LARGEST * hidden
