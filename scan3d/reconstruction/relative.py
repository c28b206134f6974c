"""What a recording's contradictions with itself show: rows that contradict the rest, and a relative error of the wrench.

Rows that contradict the rest are wild values, spikes, rows that are stuck.  In a slice of a convex body no contact lies beyond
the tangent at another.  A row is judged by groups of its neighbours along the contour: the median of a contact's distances
beyond the tangents of a group, and that of the distances of a group's contacts beyond a row's tangent, are at most zero, but
for the noise.  The median does not follow wild rows among the neighbours, and has little noise of its own, so that errors of
some five standard deviations show.  Corners, friction and facets of the body do not look like such rows, because a convex body
may have them.  A rod that touches lightly, or not at all, shows a wild row as a touch of one or two rows.

A relative error of the wrench (`scan3d.rigs`).  Where sweeps touch the same place, their contacts and supporting lines agree,
whatever the body, if the rod is the stated one and the sensor right.  Where contacts of one sweep lie beyond the lines of
another one by more than noise explains, the excess is put down to a relative error of the wrench, by two estimates, of which
the larger one counts:

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
from scipy.special import chdtri, ndtri

import planar
from scan3d.arrays import Array, Index, Mask, evenly, ratio
from scan3d.cloud import Cloud, LeftOut
from scan3d.reconstruction.agreement import COMPARED, FALSE_ALARM, LARGEST_SHARE, Compared, compared_in_slices, kappa
from scan3d.reconstruction.contacts import contacts, model_of, on_surface, renumbered, rest, spatial_contacts
from scan3d.reconstruction.errors import RIGHT_ROWS, ROUNDING, depths_in_hull, felt, noise_in_air, with_rig_errors
from scan3d.reconstruction.hollow import without_second_contacts
from scan3d.recording import Recording
from scan3d.rigs import with_relative

LARGEST = 0.01
"""Largest relative error that is allowed for.  A recording with a larger one contradicts the model."""
# A relative error so small that its effect is linear.
_UNIT = 1e-5
# Estimates with contacts that earlier ones have changed.
_PASSES = 6


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
    that explains it, of at most 1 %, and their `calibration` has what it does to them.  In space `pose_error` has twice
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
        # no estimate counts as much smaller, because an error that is too large leaves few lines; one that is hardly so ends
        following = min(max(needed, 0.25 * relative), LARGEST)
        if 0.8 * relative < following <= relative or following >= least:
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
    # means of four successive contacts
    mean = np.cumsum(within % 4 == 0) - 1
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
        # one mean counts as three standard deviations at most
        total, count = total + float(np.minimum(square, 9.0).sum()), count + len(square)
    # in one of twenty right recordings noise alone shows an error, so that bounds are wider than they need be
    if not count or total <= chdtri(count, 0.05):
        return 0.0, 0.0
    of_unit = with_rig_errors(replace(cloud, calibration=None), replace(recording, rig=with_relative(None, _UNIT)))
    unit, cloud = of_unit.calibration, cloud.select(np.isin(cloud.row, of_unit.row))
    assert unit is not None
    by_all, expected, worst, hidden = 0.0, 0.0, 0.0, 0.0
    for compared in compared_in_slices(cloud):
        error = compared.errors(1.0, unit.covariance, unit.tilt_sd)
        means, sum_of = _means(compared, cloud), sum(compared.deviations(error))
        with np.errstate(divide="ignore", invalid="ignore"):  # where an error changes nothing, it explains nothing
            worst = max(worst, float(np.nanmax((compared.misfit.found - compared.misfit.explained) / sum_of)))
            hidden = max(hidden, float(np.nanmax((compared.misfit.found - compared.systematic) / sum_of)))
        by_all += float((means.square - 1).sum())
        expected += float(means.over_noise(np.sqrt(compared.variance(error))).sum())
    # an error that changes no mean explains none
    by_means = np.sqrt(max(by_all, 0.0) / expected) if expected else np.inf
    return _UNIT * max(float(by_means), worst), _UNIT * hidden


# --- rows that contradict the rest ---


# Contacts of a group: the median follows none of the wild ones among them while these are fewer than half.
_GROUP = 8


def left_out(recording: Recording, cloud: Cloud) -> LeftOut | None:
    """The rows that contradict the rest; None if there are none, or if the noise is not known.

    `cloud` are the contacts of the recording, by the rod's centre line.  Where the rows are too many, or follow each other as
    those of a systematic error do, none is left out, but their share is said.
    """
    if not recording.noise.independent or not max(recording.noise_force_N, recording.noise_moment_Nm):
        return None
    noise = recording.noise.of_reactions(recording.rod)
    pressed = felt(recording.pressing(six_axis=False), noise)
    size = noise_in_air(recording).size
    limit, strict = (-(size or 1.0) * ndtri(chance / (2 * max(len(cloud), 1))) for chance in (RIGHT_ROWS, FALSE_ALARM))
    value, short = _numbered(recording), _short(recording.sweep, pressed)
    beyond = np.full(len(recording), -np.inf)
    for compared in compared_in_slices(cloud):
        rows = cloud.row[compared.rows]
        beyond[rows] = _beyond_neighbours(compared, cloud, value[rows], short[rows], limit)
    wild = np.isin(value, value[beyond > limit])
    if not wild.any() and size is None:
        return None
    left = np.flatnonzero(wild | short)
    share = float(pressed[left].sum() / pressed.sum())
    # small errors of gains, rods and clamps leave rows that are off by three standard deviations beside half of the
    # wild ones or more, independent errors beside 12 %
    if share <= LARGEST_SHARE and _alone(recording.sweep, value, wild, beyond > 3.0):
        # what is not seen of a wild row stays within κ of larger standard deviations
        return LeftOut(left, share, 1.5 * (size or 1.0))
    # what no right recording has must be explained, or nothing is certified
    return LeftOut(np.empty(0, dtype=np.intp), share, 1.0) if (beyond > strict).any() else None


def _numbered(recording: Recording) -> Index:
    """(n,) numbers of the rows' reactions, which rows that repeat the one before have in common."""
    reactions = np.column_stack([recording.sweep, recording.force_N, recording.moment_Nm])
    order = np.argsort(recording.sweep, kind="stable")
    number = np.empty(len(order), dtype=np.intp)
    number[order] = np.cumsum(np.append(True, (np.diff(reactions[order], axis=0) != 0).any(axis=1)))
    return number


def _alone(sweep: Index, value: Index, wild: Mask, off: Mask) -> bool:
    """Whether beside two thirds of the wild values none is `off`, as errors are that are independent from row to row."""
    order = np.argsort(sweep, kind="stable")
    first = order[np.append(True, np.diff(value[order]) != 0)]
    off, same = off[first], np.diff(sweep[first]) == 0
    beside = np.append(off[1:] & same, False) | np.append(False, off[:-1] & same)
    return bool(3 * beside[wild[first]].sum() <= wild[first].sum())


def _short(sweep: Index, pressed: Mask) -> Mask:
    """(n,) the rows with a force whose touch has too few rows."""
    order = np.argsort(sweep, kind="stable")
    force, number = pressed[order], sweep[order]
    begins = np.flatnonzero(np.append(True, (np.diff(number) != 0) | (np.diff(force.astype(np.int8)) != 0)))
    length = np.diff(np.append(begins, len(order)))
    short = np.zeros(len(order), dtype=bool)
    short[order] = force & np.repeat(length < 3, length)
    return short


def _beyond_neighbours(compared: Compared, cloud: Cloud, value: Index, short: Mask, limit: float) -> Array:
    """(n,) how far contacts of a slice and groups of their neighbours contradict each other, in standard deviations.

    The groups are of rows that do not contradict the others by more than the limit, nor have the same `value` (n,) as such
    ones, nor, where there are such, are those of `short` touches (n,).
    """
    assert cloud.covariance is not None
    assert cloud.normal_sd is not None
    lines, some = compared.lines, compared.some
    beyond, pairs = compared.misfit.found - compared.systematic, compared.misfit.found > compared.misfit.explained
    others, own, turned = (
        part**2 for part in compared.deviations(compared.errors(1.0, cloud.covariance, cloud.normal_sd))
    )
    of_line, trusted, refuted = own + turned, np.ones(len(value), dtype=bool), np.zeros(len(value), dtype=bool)
    # each pass is without the rows that the ones before it have left out
    for _ in range(10):
        known = trusted[lines], trusted[some]
        of_lines, of_points = _groups(compared.points[lines], known[0]), _groups(compared.points[some], known[1])
        # where nothing is left to judge by, what is not trusted stays so
        found = np.where(trusted | bool(len(of_lines) or len(of_points)), -np.inf, np.inf)
        by_lines, wrong_lines = _over_groups(beyond, others, of_line, of_lines, limit)
        by_points, wrong_points = _over_groups(beyond.T, of_line.T, others.T, of_points, limit)
        found[some] = np.maximum(found[some], by_lines)
        found[lines] = np.maximum(found[lines], by_points)
        rows, columns = _contradicted(pairs & known[0][:, None] & known[1])
        refuted[lines[rows]] = refuted[some[columns]] = True
        found[lines[wrong_lines]] = found[some[wrong_points]] = np.inf
        found[lines[~known[0] & (pairs & known[1]).any(axis=1)]] = np.inf
        found[some[~known[1] & (pairs & known[0][:, None]).any(axis=0)]] = np.inf
        found[refuted] = np.inf
        wild = np.isin(value, value[found > limit])
        if not (wild & trusted).any():
            break
        trusted &= ~(wild | short)
    return found


def _contradicted(pairs: Mask) -> tuple[Index, Index]:
    """Numbers of the rows and columns with most of the pairs (k, m), without which there are none."""
    left, rows, columns = pairs.copy(), [], []
    while left.any():
        of_row, of_column = left.sum(axis=1), left.sum(axis=0)
        row, column = int(of_row.argmax()), int(of_column.argmax())
        if of_row[row] >= of_column[column]:
            rows.append(row)
            left[row] = False
        if of_column[column] >= of_row[row]:
            columns.append(column)
            left[:, column] = False
    return np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp)


def _over_groups(beyond: Array, common: Array, own: Array, groups: Index, limit: float) -> tuple[Array, Index]:
    """(m,) the largest median of distances (k, m) over groups (g, s) of the rows, in standard deviations, and wrong rows.

    Of the variances (k, m) one part is common to a group, and each row has one of its own.  A group that contradicts more
    columns than it has rows is wrong itself.
    """
    # the variance of the median of many normal numbers is π/2 of that of their mean
    variance = common[groups].mean(axis=1) + np.pi / 2 / groups.shape[1] * own[groups].mean(axis=1)
    found = ratio(np.median(beyond[groups], axis=1), np.sqrt(variance))
    wrong = (found > limit).sum(axis=1) > groups.shape[1]
    return np.asarray(found[~wrong].max(axis=0, initial=-np.inf)), groups[wrong].ravel()


def _groups(points: Array, chosen: Mask) -> Index:
    """(g, s) neighbours along the contour of some of the contacts; none where these are too few."""
    away, count = points - points.mean(axis=0), int(chosen.sum())
    order = np.argsort(np.arctan2(away[:, 1], away[:, 0]), kind="stable")
    order, size = order[chosen[order]], min(_GROUP, max(count, 1))
    first = np.linspace(0, count - size, max(1, count // _GROUP) if 2 * size >= _GROUP else 0)
    return np.asarray(order[first.astype(np.intp)[:, None] + np.arange(size)])
