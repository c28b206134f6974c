"""Contacts of a recording, and what in them contradicts the model of a convex body touched by the stated rod.

Contradictions show in misfits (`reconstruction.errors`), the poses and the table, of the recording alone.  Each test has a
threshold that correct recordings do not reach, whatever the body, the friction, the noise that they state and the digits that
they keep; errors of signs, axes, units, scales, offsets and times usually do.  Single rows are left out; a small relative error
of the wrench is allowed for in the bounds; with any other contradiction, whose likeliest cause is named, nothing is certified.

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

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import chdtri, ndtri

import planar
from scan3d.arrays import AT_ONCE, Array, Index, Mask, evenly, ratio
from scan3d.cloud import Cloud, LeftOut, Tilt, Unmeasured
from scan3d.errors import InputError
from scan3d.reconstruction import probings
from scan3d.reconstruction.contacts import (
    contacts,
    model_of,
    on_surface,
    readings,
    renumbered,
    rest,
    spatial_contacts,
    with_rows,
    without_normals,
)
from scan3d.reconstruction.diagnosis import Diagnosis, diagnose
from scan3d.reconstruction.errors import (
    DISTURBED,
    RIGHT_ROWS,
    ROUNDING,
    Errors,
    Misfit,
    NoContactError,
    against_single_force,
    beyond_tangents,
    depths_in_hull,
    deviations,
    felt,
    noise_in_air,
    torsion_sd,
    with_rig_errors,
)
from scan3d.reconstruction.hollow import without_second_contacts
from scan3d.reconstruction.measured import as_measured, as_recorded, measured, unmeasured
from scan3d.reconstruction.slices import SliceStack, stacks
from scan3d.recording import FORCE_SIGMAS, LARGEST_OVER_SD, Recording, of_rows, rounding_sd
from scan3d.rigs import with_relative
from scan3d.units import UNITS_M, angle, length, number, point, share

BELOW_TABLE = "below-table"
"""Code of the contradiction between contacts and the table."""
LARGEST_SHARE = 0.1
"""Largest part of the rows with a force that may be left out; where more contradict the rest, nothing is certified."""
OFF_LINE = 0.05
"""Part of its way by which a robot's sweep may leave the line along -x of the clamp."""
FALSE_ALARM = 1e-5
"""Probability that noise makes a correct recording exceed the allowed distances."""
# Rows, at least, whose channels may have a sum that is zero, and what of their size is rounding.
_FEWEST, _ZERO = 20, 1e-12
COMPARED = math.isqrt(AT_ONCE)
"""Contacts, tangents, and contacts of the hull that are compared at most, each with each."""


class Contradiction(NamedTuple):
    """A contradiction between the recording and the model."""

    code: str
    message: str
    value: float
    """The number that the test found, as the message says."""


# What a test that looks for one fault alone has found: code and unit of the fault, and the fault in words.
_CAUSES = {
    "sweep-direction": ("poses", "deg", "the poses are wrong: {}"),
    "out-of-plane": ("planar-model", "", "the model is wrong: choose the spatial model"),
    BELOW_TABLE: ("table", "", "the table is wrong: {}"),
    "held-poses": ("held-poses", "rows", "the poses are held: {}"),
    "dead-channel": ("dead-channel", "", "the sensor is wrong: {}"),
}


class Checked(NamedTuple):
    """How a recording agrees with the model."""

    contradictions: list[Contradiction]
    """Empty if it agrees."""
    diagnosis: Diagnosis | None
    """The likeliest fault; None if it agrees, or if its sweeps differ by what the bounds allow for and no fault explains it."""


def checked(recording: Recording, cloud: Cloud) -> Checked:
    """The contradictions between a recording, its contacts and the model, and the likeliest fault."""
    missing = cloud.unmeasured
    recording, cloud = as_measured(recording, cloud)
    alone, diagnosis = _held(missing) + _dead(recording) + below_table(cloud), None
    if recording.in_probings.any():  # though none of them may have touched
        if cloud.probed is not None and cloud.probed.all():
            return Checked(alone, None)
        number = np.flatnonzero(~recording.in_probings)
        recording, cloud = of_rows(recording, number), with_rows(cloud.of_sweeps or cloud.swept(), number)
    if (left := cloud.left_out) is not None:
        recording, kept = rest(recording, left)
        cloud = with_rows(cloud, kept)
    if cloud.model == "spatial":
        found = _in_space(recording, cloud)
    else:
        touched = cloud.fattened or cloud  # by the rod's centre line
        alone = _off_line(recording) + alone
        pressed = int(felt(recording.pressing(six_axis=False), recording.noise.of_reactions(recording.rod)).sum())
        found = _without_contact(1 - (len(cloud) + cloud.light + cloud.second) / pressed if pressed else 0.0)
        found += shape_contradictions(recording, touched) if cloud.convex else []
        if out_of_plane := _out_of_plane(recording, touched):
            # the wrong model is the cause only if the other one is right
            if _agrees_in_space(recording):
                alone += [one._replace(message=f"{one.message}; choose the spatial model") for one in out_of_plane]
            found += [] if alone else out_of_plane
    found += _off_zero(recording)
    if alone:
        first = alone[0]
        code, unit, cause = _CAUSES[first.code]
        diagnosis = Diagnosis(code, first.value, unit, f"most likely {cause.format(first.message)}", 1.0)
    if left is not None and left.too_many:
        many = f"more than {share(LARGEST_SHARE)}" if left.share > LARGEST_SHARE else "many that follow each other"
        text = (
            f"{share(left.share)} of the rows with a force contradict their neighbours by more than the stated noise: {many} "
            "are no wild rows that may be left out"
        )
        found.append(Contradiction("wild-rows", text, left.share))
    relative = 0.0 if cloud.calibration is None else cloud.calibration.relative
    if (found or relative) and (diagnosis is None or cloud.model == "spatial"):
        diagnosis = diagnose(recording, cloud.model)
        if not found:
            holds = (
                f"the bounds hold if no more of the wrench is wrong than the {share(relative)} by which sweeps differ"
            )
            said = f"{diagnosis.message}; {holds}"
            diagnosis = None if diagnosis.fault == "unknown" else diagnosis._replace(message=said)
        found = [each._replace(message=f"{each.message}; {diagnosis.message}") for each in found if diagnosis]
    return Checked(alone + found if cloud.model == "planar" else found + alone, diagnosis)


def cause_of_no_contact(recording: Recording) -> str:
    """What is likeliest to be wrong with a recording that has no contact, as the end of a sentence; "" if nothing is found."""
    if (missing := unmeasured(recording)) is not None:
        return f"; {'; '.join(missing.words)}"
    diagnosis = diagnose(recording, "spatial" if recording.six_axis else "planar")
    return "" if diagnosis.fault in ("unknown", "second-contact") else f"; {diagnosis.message}"


def kappa(count: int) -> float:
    """Standard deviations that no place of so many contacts is off by, but for `FALSE_ALARM`."""
    return float(np.sqrt(chdtri(3, FALSE_ALARM / max(count, 1))))


def _held(missing: Unmeasured | None) -> list[Contradiction]:
    """That poses are held, so that no contact is where it seems."""
    if missing is None or not missing.poses:
        return []
    return [Contradiction("held-poses", missing.words[-1], float(len(missing.rows)))]


def _dead(recording: Recording) -> list[Contradiction]:
    """Whether a channel of a sensor that stands turned is dead: a sum of several channels then is zero, noise included."""
    if not (recording.six_axis and min(recording.noise_force_N, recording.noise_moment_Nm)) or recording.completed:
        return []
    wrench = np.hstack(recording.wrench())
    wrench = wrench[:, (wrench != wrench[0]).any(axis=0)]
    size = np.linalg.svd(wrench / np.sqrt((wrench**2).mean(axis=0)), compute_uv=False)
    if len(wrench) < _FEWEST or size.min(initial=np.inf) > _ZERO * size.max(initial=0.0):
        return []
    text = (
        "a sum of several channels, each with its factor, is zero in all rows to the last digit, though all of them have "
        "noise: a channel of the sensor, which stands turned or moved, is dead or was not measured"
    )
    return [Contradiction("dead-channel", text, float(size.min() / size.max()))]


def _without_contact(fraction: float) -> list[Contradiction]:
    """Whether too large a fraction of the rows with a force have no contact."""
    if fraction <= DISTURBED:
        return []
    text = (
        f"{share(fraction)} of the rows with a force have no contact: no bent rod has their reactions "
        f"(at most {share(DISTURBED)} are expected)"
    )
    return [Contradiction("force-without-contact", text, fraction)]


def shape_contradictions(recording: Recording, cloud: Cloud) -> list[Contradiction]:
    """Whether contacts in slices are not those of a convex body: an empty list if they are."""
    # the pair of a contact and a tangent that exceeds what is allowed by the largest factor
    pairs = [(0.0, 1.0), *(compared.misfit.worst() for compared in compared_in_slices(cloud))]
    beyond, allowed = max(pairs, key=lambda pair: pair[0] / pair[1])
    if beyond > allowed:
        text = (
            f"contacts lie up to {length(beyond, cloud.unit)} beyond the tangent at a contact of the same slice, where "
            f"noise and rounding allow {length(allowed, cloud.unit, digits=2)}: "
            + (
                "the contacts contradict each other whatever the body's shape, though it is stated not to be convex"
                if recording.stated_hollow
                else "the contacts are not those of a convex body; of one that is not convex state convex = false under "
                "[source] of the recording"
            )
        )
        return [Contradiction("beyond-tangent", text, beyond)]
    place = np.zeros(len(cloud)) if cloud.place_sd is None else kappa(len(cloud)) * cloud.place_sd
    # the force of friction on a thick rod's tip may meet the centre line as deep in the fattened body as the rod is thick
    radius = recording.rod.diameter_m / 2 / UNITS_M[cloud.unit]
    place = place + cloud.lever + np.where(cloud.phase == planar.Phase.TIP, radius, 0.0)
    return _not_convex(cloud, (place, np.zeros(len(cloud))), np.empty(0, dtype=np.intp))


class Compared(NamedTuple):
    """Contacts of a slice that are compared with each other, as in `misfits.beyond_tangents`, and what that gives."""

    misfit: Misfit
    rows: Index
    """Contacts (n,) of the cloud."""
    points: Array
    lines: Index
    normals: Array
    some: Index
    frame: Array
    """(2, 3) axes of the slice's plane."""
    systematic: Array
    """(k, m) what digits, tilt and calibration explain, beside the noise."""

    def errors(self, sigmas: float, covariance: Array, turn_sd: Array) -> Errors:
        """Those of the slice's contacts, of what those of all contacts of the cloud have."""
        inside = np.einsum("ij,njk,lk->nil", self.frame, covariance[self.rows], self.frame)
        return Errors(sigmas, inside, turn_sd[self.rows])

    def deviations(self, error: Errors) -> tuple[Array, Array]:
        return deviations(self.points, self.lines, self.normals, self.some, error)

    def variance(self, error: Errors) -> Array:
        """(k, m) of the distances, as sums of independent parts."""
        return np.asarray(sum(part**2 for part in self.deviations(error)))


def compared_in_slices(cloud: Cloud) -> Iterator[Compared]:
    """The contacts of each slice, how far they lie beyond the tangents at others, and what explains it.

    Tilted planes of contacts in one slice lie at different heights; there the body's slope up and down the axis, which lies
    between the secants to the neighbouring slices, is allowed for, and end slices are left out.
    """
    nothing = Misfit(np.empty(0), np.empty(0))
    for stack in stacks(cloud):
        for k, slice_ in enumerate(stack.slices):
            if cloud.tilt is not None and k in (0, len(stack.slices) - 1):
                continue
            lines, some = evenly(slice_.tangential, COMPARED), evenly(np.arange(len(slice_.rows)), COMPARED)
            if not len(lines):
                continue
            normals = slice_.normals[np.searchsorted(slice_.tangential, lines)]
            found = Compared(nothing, slice_.rows, slice_.points, lines, normals, some, stack.frame[:2], np.empty(0))
            compared = slice_.points, lines, normals, some
            systematic = np.full((len(lines), len(some)), 2 * (cloud.pose_error + cloud.lever))
            if (rig := cloud.calibration) is not None:
                of_rig = found.errors(rig.factor(FALSE_ALARM), rig.covariance, rig.tilt_sd)
                systematic += beyond_tangents(*compared, of_rig, cloud.rod_length).explained
            if cloud.tilt is not None:
                systematic += _by_tilt(cloud, cloud.tilt, stack, k, normals)[:, None]
            noise = None
            if cloud.covariance is not None and cloud.normal_sd is not None:
                noise = found.errors(kappa(len(cloud)), cloud.covariance, cloud.normal_sd)
            misfit = beyond_tangents(*compared, noise, cloud.rod_length)
            explained = misfit.explained + systematic
            yield found._replace(misfit=misfit._replace(explained=explained), systematic=systematic)


def _by_tilt(cloud: Cloud, tilt: Tilt, stack: SliceStack, k: int, normals: Array) -> Array:
    """(k,) how far contacts of a slice can lie beyond tangents with normals (k, 2), because their heights differ."""
    slice_ = stack.slices[k]
    radius = float(np.linalg.norm((cloud.points - tilt.centre) @ stack.frame[:2].T, axis=1).max())
    apart = 2 * (tilt.spread + np.sqrt(2) * tilt.slope * radius)
    support = slice_.support_of_contacts(normals)
    slopes = np.zeros(len(normals))
    for other in (stack.slices[k - 1], stack.slices[k + 1]):
        run = abs(slice_.height - other.height) - apart
        rise = np.abs(support - other.support_of_contacts(normals))
        slopes = np.maximum(slopes, rise / run if run > 0 else np.inf)
    return apart * slopes


def _in_space(recording: Recording, cloud: Cloud) -> list[Contradiction]:
    known = readings(recording)
    pressed = int(known.felt.sum())
    without = 1 - int((known.touching | known.light).sum()) / pressed if pressed else 0.0
    rows, sigmas = cloud.row, kappa(len(cloud))
    of_rows = known.found.rows(rows)
    force, moment = (part[rows] for part in recording.reactions(six_axis=True))
    radius = cloud.rod_radius / cloud.rod_length
    about_rod, along_force = against_single_force(force, moment, of_rows, known.noise, sigmas, radius)
    by_rig: Array | float = 0.0
    if (rig := cloud.calibration) is not None:
        by_rig = rig.factor(FALSE_ALARM) * torsion_sd(recording, rows) / np.hypot(moment[:, 0], moment[:, 2])
    twisted = float((about_rod.found > about_rod.explained + by_rig).mean())
    skewed = float((along_force.found > along_force.explained).mean())
    found = _without_contact(without)
    if skewed > DISTURBED:
        off = np.degrees(np.arcsin(np.minimum(along_force.found / np.hypot(1.0, about_rod.found), 1.0)))
        largest = float(np.percentile(off, 95))
        text = (
            f"force and moment are up to {angle(largest)} off the perpendicular, in {share(skewed)} of the contacts by more "
            "than noise and rounding allow: a second contact, or a misaligned or untared sensor"
        )
        found.append(Contradiction("moment-along-force", text, largest))
    if twisted > DISTURBED:
        largest = float(np.percentile(about_rod.found, 95))
        text = (
            f"the moment about the rod's axis is up to {number(largest, 2)} of the clamping moment, in {share(twisted)} of the "
            "contacts more than noise, rounding and friction across the rod allow: a bent rod, or a misaligned sensor"
        )
        found.append(Contradiction("moment-about-rod", text, largest))
    assert cloud.tangents is not None
    air = noise_in_air(recording)
    if recording.noise.independent and air.chance < FALSE_ALARM:
        text = (
            "values of rows in the air are larger than the stated noise explains, and contacts in space do not show which of "
            "theirs are: state the noise that the sensor has, or leave wild rows out"
        )
        found.append(Contradiction("wild-rows", text, air.chance))
    place, turn = np.zeros(len(cloud)), np.zeros(len(cloud))
    if known.error is not None and cloud.place_sd is not None:
        place, turn = sigmas * cloud.place_sd, sigmas * known.error.tangent[rows]
    lines = evenly(np.flatnonzero((cloud.phase == planar.Phase.TANGENTIAL) & np.isfinite(turn)), COMPARED)
    # what depths show beyond that is allowed for in the bounds, but is no excuse
    by_poses = recording.noise.place_m * cloud.rod_length / recording.rod.length_m
    found += _not_convex(replace(cloud, pose_error=by_poses), (place, turn), lines)
    return found


def _not_convex(cloud: Cloud, errors: tuple[Array, Array], lines: Index) -> list[Contradiction]:
    """Whether contacts, or tangents at some of them, lie deeper in the hull of the contacts than errors and rounding explain.

    errors
        (n,) largest errors of the places and of the tangents by the noise, in radians.
    """
    points = cloud.points if cloud.centre_points is None else cloud.centre_points
    tangents = np.zeros_like(points) if cloud.tangents is None else cloud.tangents
    place, turn = errors
    if (rig := cloud.calibration) is not None:
        factor = rig.factor(FALSE_ALARM)
        place, turn = place + factor * rig.place_sd, turn + factor * rig.turn_sd
    every = np.arange(len(points))
    misfit = depths_in_hull(points, evenly(every, COMPARED), every, lines, tangents, (place, turn), cloud.rod_length)
    if misfit is None:
        return []
    depth, explained, rows = misfit.found, misfit.explained + 2 * cloud.pose_error, np.concatenate([every, lines])
    worst = int(np.argmax(depth / explained))
    inside, allowed, at = float(depth[worst]), float(explained[worst]), rows[worst]
    if inside <= allowed:
        return []
    what = "contacts lie" if not len(lines) else "contacts, or the rod's tangents at contacts, lie"
    text = (
        f"{what} up to {length(inside, cloud.unit)} inside the hull of the contacts, at "
        f"{point(points[at], cloud.unit)}, where noise and rounding allow "
        f"{length(allowed, cloud.unit, digits=2)}: the body is not convex there, or the contacts are not where they seem"
    )
    return [Contradiction("inside-hull", text, inside)]


def below_table(cloud: Cloud) -> list[Contradiction]:
    """Whether contacts lie below the table, farther than noise and rounding allow; an empty list if they do not."""
    if cloud.table is None:
        return []
    allowed = np.full(len(cloud), ROUNDING * cloud.rod_length + 2 * cloud.pose_error)
    if (rig := cloud.calibration) is not None:
        allowed += rig.factor(FALSE_ALARM) * rig.place_sd
    if cloud.centre_points is not None:  # of a rod that touches the body from below the table
        heights, covariance = cloud.centre_points[:, 2] + cloud.rod_radius, cloud.centre_covariance
    else:
        heights = cloud.points[:, 2] if cloud.fattened is None else cloud.fattened.points[:, 2] + cloud.rod_radius
        covariance = cloud.covariance
    sd = None if covariance is None else np.sqrt(np.maximum(covariance[:, 2, 2], 0.0))
    depth = cloud.table - heights - allowed - (0.0 if sd is None else kappa(len(cloud)) * sd)
    worst = int(depth.argmax())
    if depth[worst] <= 0:
        return []
    of_what = "touches" if cloud.model == "touches" else "poses"
    text = (
        f"contacts lie down to z = {length(heights[worst], cloud.unit)}, where the table is at "
        f"{length(cloud.table, cloud.unit)}; move the frame of the {of_what} so that the body stands on the table, or "
        "correct the table's height"
    )
    return [Contradiction(BELOW_TABLE, text, float(cloud.table - heights[worst]))]


def _off_line(recording: Recording) -> list[Contradiction]:
    """Whether every sweep moves along -x of the clamp's frame, which the poses alone decide."""
    # the number of a sweep is a name: sweeps may come in any order
    _, first = np.unique(recording.sweep, return_index=True)
    last = len(recording) - 1 - np.unique(recording.sweep[::-1], return_index=True)[1]
    travel = recording.position_m[last] - recording.position_m[first]
    way = np.linalg.norm(travel, axis=1)
    # digits turn a short way by more than a fault would
    moved = way > 2 * LARGEST_OVER_SD * rounding_sd(recording.position_m.ravel()) / OFF_LINE
    if not moved.any():
        return []
    along = -(travel[moved] * recording.axes()[first[moved], 0]).sum(axis=1) / way[moved]
    wrong = along < np.sqrt(1 - OFF_LINE**2)
    if not wrong.any():
        return []
    turn = float(np.degrees(np.arccos(np.clip(along.min(), -1, 1))))
    text = (
        f"the clamp moves at up to {angle(turn)} to the -x axis of its own frame in {wrong.sum()} of {moved.sum()} sweeps: "
        "check the order of the quaternion (qw first), the axes and the direction of the sweeps"
    )
    return [Contradiction("sweep-direction", text, turn)]


def _out_of_plane(recording: Recording, cloud: Cloud) -> list[Contradiction]:
    """How wrong the planar model is for six-axis data, by comparison with the spatial one; an empty list if it is right."""
    if not recording.six_axis:
        return []
    known = readings(recording)
    force = recording.wrench()[0][known.felt]
    fraction = float(np.median(np.abs(force[:, 2]) / np.linalg.norm(force, axis=1))) if len(force) else 0.0
    try:
        spatial = without_normals(recording, known)
    except NoContactError:
        return []
    _, here, there = np.intersect1d(cloud.row, spatial.row, return_indices=True)
    lost = 1 - len(here) / len(spatial)
    distance = np.linalg.norm(cloud.points[here] - spatial.points[there], axis=1)
    error = float(np.percentile(distance, 95)) if len(here) else np.inf
    allowed = ROUNDING * cloud.rod_length + kappa(len(cloud)) * spatial.noise
    if (rig := with_rig_errors(spatial, recording).calibration) is not None and len(rig.place_sd):
        allowed += rig.factor(FALSE_ALARM) * float(rig.place_sd.max())
    if lost <= DISTURBED and error <= allowed:
        return []
    size = (
        f"contacts lie up to {length(error, cloud.unit)} from those"
        if len(here)
        else "none of its contacts is one of those"
    )
    text = (
        f"a recording with six axes is read by the planar model, and {size} of the spatial model, of which {share(lost)} are "
        f"missing; {share(fraction)} of the force lies out of the slices' planes"
    )
    return [Contradiction("out-of-plane", text, fraction)]


def _agrees_in_space(recording: Recording) -> bool:
    """Whether nothing contradicts the spatial model in a recording of six axes."""
    try:
        return not _in_space(recording, with_rig_errors(spatial_contacts(recording), recording))
    except NoContactError:
        return False


def _off_zero(recording: Recording) -> list[Contradiction]:
    """Whether the sensor shows zero at the beginnings and ends of the sweeps, where the rod is in the air.

    A drift that a tare leaves is no fault as long as it is well below what counts as a touch.
    """
    noise, order = recording.noise.of_reactions(recording.rod), np.argsort(recording.sweep, kind="stable")
    if not min(recording.noise_force_N, recording.noise_moment_Nm):
        return []
    force, about = (part[order] for part in recording.reactions(recording.six_axis))
    scaled = np.hstack([force / noise[0], about / noise[1]])
    if recording.down() is not None:
        return []  # a rod with a weight shows it in the air
    pressed = felt(recording.pressing(recording.six_axis)[order], noise)
    edges = np.flatnonzero(np.diff(recording.sweep[order], prepend=-1, append=-1))
    largest, off, count = 0.0, 0, 0
    for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        touched = np.flatnonzero(pressed[start:stop])
        before, after = (int(touched[0]), stop - start - 1 - int(touched[-1])) if len(touched) else (stop - start, 0)
        for part in (scaled[start : start + before // 2], scaled[stop - after // 2 : stop][::-1]):
            if len(part) < 10:
                continue
            count += 1
            # a light touch, whose moment grows before its force is felt, grows from zero: the line through the medians of
            # both halves tells where the stretch begins
            outer, inner = (np.median(half, axis=0) for half in np.array_split(part, 2))
            size = float(np.abs(1.5 * outer - 0.5 * inner).max())
            if size > FORCE_SIGMAS / 2 + 5 / np.sqrt(len(part)):
                largest, off = max(largest, size), off + 1
    if not off:
        return []
    text = (
        f"in the air, where a sweep begins or ends, force and moment are off zero by up to {number(largest, 2)} standard "
        f"deviations of their noise in the median of many rows, in {off} of {count} such stretches"
    )
    return [Contradiction("off-zero", text, largest)]


LARGEST = 0.01
"""Largest relative error that is allowed for.  A recording with a larger one contradicts the model."""
# A relative error so small that its effect is linear.
_UNIT = 1e-5
# Estimates with contacts that earlier ones have changed.
_PASSES = 6


def reconstruct(recording: Recording, model: str | None = None) -> Cloud:
    """Contacts of a recording, simulated or measured, with the normals of the surface where they can be known.

    model
        'planar' or 'spatial'; None is spatial if the recording has six axes, else planar.

    Planar: the direction of a normal within its slice's plane comes from (14), its inclination to the plane from the slices
    below and above.  Spatial: normals come from the slip and the path of the contact along each sweep, or from the force where
    there is no friction.  If the body proves smooth, all normals come from the support function fitted to all contacts.
    Points lie inside the rod's centre line by its radius, along the normals, in the plane as in space.
    Where opposed sweeps over the same place contradict each other, the contacts are those with the relative error of the wrench
    that explains it, of at most 1 %, and their `calibration` has what it does to them.  In space `pose_error` has twice
    how much deeper noisy contacts lie in the hull of all than their noise explains, which widens the bounds.
    Raises InputError if the recording has no contact, or not the axes that the model needs, for the spatial model of a body
    that is stated not to be convex.
    """
    model = model_of(recording, model)
    if not len(recording):
        raise NoContactError("the recording has no rows, as that of a stream before its first touch; record some")
    if (missing := unmeasured(recording)) is None:
        return _reconstructed(recording, model)
    part, rows = measured(recording, missing)
    return as_recorded(recording, missing, rows, _reconstructed(part, model))


def _reconstructed(recording: Recording, model: str) -> Cloud:
    """`reconstruct` of a recording all of whose rows were measured."""
    along = recording.in_probings
    if (
        recording.rod.bead_diameter_m
        and felt(recording.pressing(model == "spatial"), recording.noise.of_reactions(recording.rod))[~along].any()
    ):
        raise InputError(
            "in sweeps a bead would touch where the rod is taken to: a rod with bead_diameter_m gives contacts of probings "
            "only, sweeps along the clamp's y axis; leave the others out of the recording, or sweep with a rod without bead"
        )
    if along.any():
        return _with_probings(recording, along, model)
    if model == "spatial":
        found = with_rig_errors(spatial_contacts(recording), recording)
        return replace(found, pose_error=found.pose_error + 2 * _deeper(found))
    touched = contacts(recording)
    hollow = recording.stated_hollow
    if hollow and not recording.rod.without_thickness().is_simple:
        raise InputError(
            "sweeps of a body that is not convex are read by a straight, uniform, weightless rod in a rigid clamp only; probe "
            "it with this one, or state convex = true under [source] if it is convex"
        )
    if hollow:  # its slices may contradict each other without any error
        found = without_second_contacts(on_surface(touched, recording, convex=False), recording)
        if not found.convex:
            return found
    by_rig = with_rig_errors(touched, recording)
    left = None if hollow else left_out(recording, by_rig)
    if left is not None and not left.too_many:
        left, touched = _without_wild(recording, left)
        part, kept = rest(recording, left)
        known = _with_relative_error(part, with_rig_errors(touched, part))
        return renumbered(_whole(touched, part, known).changed(left_out=lambda _: left), kept)
    known = _with_relative_error(recording, by_rig)
    found = _whole(touched, recording, known)
    if left is None:
        return found
    explained = known is not recording and left_out(recording, found.fattened or found) is None
    return found if explained else found.changed(left_out=lambda _: left)


def _with_probings(recording: Recording, along: Mask, model: str) -> Cloud:
    """`_reconstructed` of a recording of which some rows (n,) are those of probings, and the others those of sweeps.

    A rod that probes is not bent in the plane of a sweep, so that all channels that were measured are read.
    """
    number, swept = np.flatnonzero(~along), None
    if len(number):
        part = of_rows(recording, number)
        with suppress(NoContactError):
            if part.rod.without_thickness().is_simple:
                part = replace(part, source={**part.source, "convex": False})
            swept = renumbered(_reconstructed(part, model), number)
    number = np.flatnonzero(along)
    try:
        part = of_rows(recording, number)
        read = "spatial" if recording.six_axis else model
        found = with_rig_errors(probings.contacts(part, read), part)
        probed = renumbered(replace(found, model=model), number)
    except NoContactError:
        if swept is None:
            raise
        return replace(swept, convex=False)
    return probings.with_probings(swept, probed)


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


def _without_wild(recording: Recording, left: LeftOut) -> tuple[LeftOut, Cloud]:
    """All rows to be left out, and the contacts of the others: a larger noise makes contacts of rows that were none."""
    for _ in range(_PASSES):
        part, kept = rest(recording, left)
        touched = contacts(part)
        further = left_out(part, with_rig_errors(touched, part))
        if further is None or not len(further.rows):
            break
        rows = np.append(left.rows, kept[further.rows])
        left = LeftOut(np.sort(rows), left.share + further.share, left.factor)
    return left, touched


def _whole(touched: Cloud, recording: Recording, known: Recording) -> Cloud:
    """The contacts, with normals, of the recording `known` with a relative error of the wrench; `touched` are those without."""
    return on_surface(touched if known is recording else contacts(known), known)


def _with_relative_error(recording: Recording, cloud: Cloud) -> Recording:
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
        needed, hidden = _relative_error(recording, with_rig_errors(contacts(tried), recording))
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
    sweep, each = cloud.sweep[compared.rows], np.arange(len(compared.some))
    apart = cdist(compared.points[compared.lines], compared.points[compared.some])
    apart[sweep[compared.lines][:, None] == sweep[compared.some]] = np.inf
    nearest = apart.argmin(axis=0)
    contact = np.flatnonzero(np.isfinite(apart[nearest, each]))
    line = nearest[contact]
    # errors by digits alone are not independent
    explained = compared.systematic if cloud.independent else compared.misfit.explained
    beyond = (compared.misfit.found - explained)[line, contact]
    own = of_line = np.zeros(len(line))
    if cloud.covariance is not None and cloud.normal_sd is not None:
        error = compared.errors(1.0, cloud.covariance, cloud.normal_sd)
        own, of_line = (part[line, contact] for part in compared.deviations(error))
    rounding = (ROUNDING * cloud.rod_length) ** 2
    sweeps = np.stack([sweep[compared.some[contact]], sweep[compared.lines[line]]])
    begins = (np.diff(sweeps, axis=1, prepend=-1) != 0).any(axis=0)
    stretch = np.cumsum(begins) - 1
    within = np.arange(len(line)) - np.flatnonzero(begins)[stretch]
    # means of four successive contacts
    mean = np.cumsum(within % 4 == 0) - 1
    weight = 1 / (own**2 + of_line**2 + rounding)
    weight /= np.bincount(mean, weight)[mean]
    # contacts that have a line in common have the same error of that line
    both, pair = np.unique(np.stack([mean, line]), axis=1, return_inverse=True)
    shared = np.bincount(pair.reshape(-1), weight * of_line) ** 2
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
    errors = compared.errors(1.0, cloud.covariance, cloud.normal_sd)
    of_points, of_lines = (part**2 for part in compared.deviations(errors))
    trusted, refuted = np.ones(len(value), dtype=bool), np.zeros(len(value), dtype=bool)
    # each pass is without the rows that the ones before it have left out
    for _ in range(10):
        known = trusted[lines], trusted[some]
        groups, others = _groups(compared.points[lines], known[0]), _groups(compared.points[some], known[1])
        # where nothing is left to judge by, what is not trusted stays so
        found = np.where(trusted | bool(len(groups) or len(others)), -np.inf, np.inf)
        by_lines, wrong_lines = _over_groups(beyond, of_points, of_lines, groups, limit)
        by_points, wrong_points = _over_groups(beyond.T, of_lines.T, of_points.T, others, limit)
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
    of_row, of_column = left.sum(axis=1), left.sum(axis=0)
    while of_row.any():
        row, column = int(of_row.argmax()), int(of_column.argmax())
        in_row, in_column = of_row[row], of_column[column]
        if in_row >= in_column:
            rows.append(row)
            of_column -= left[row]
            left[row], of_row[row] = False, 0
        if in_column >= in_row:
            columns.append(column)
            of_row -= left[:, column]
            left[:, column], of_column[column] = False, 0
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
    # of eight, whose median follows none of the wild ones among them while these are fewer than half
    order, size = order[chosen[order]], min(8, max(count, 1))
    first = np.linspace(0, count - size, max(1, count // 8) if size >= 4 else 0)
    return np.asarray(order[first.astype(np.intp)[:, None] + np.arange(size)])
