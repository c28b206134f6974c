"""Whether a recording agrees with the model: a convex body, touched by a rod whose reactions are those that are recorded.

The tests use the recording alone.  Each has a threshold that correct recordings do not reach, whatever the body, the friction,
the noise that they state and the digits that they keep; errors of signs, axes, units, scales, offsets and times usually do.

What is compared are the misfits of `misfits`; further tests look at the poses, the table and the model alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

import planar
from scan3d.arrays import Array, Index, evenly
from scan3d.cloud import Cloud, Tilt
from scan3d.reconstruction.causes import Diagnosis
from scan3d.reconstruction.contacts import readings, renumbered, rest, without_normals
from scan3d.reconstruction.diagnosis import diagnose
from scan3d.reconstruction.errors import (
    DISTURBED,
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
from scan3d.reconstruction.slices import SliceStack, stacks
from scan3d.recording import FORCE, LARGEST_OVER_SD, Recording, rounding_sd
from scan3d.units import UNITS_M, angle, length, number, point, share

BELOW_TABLE = "below-table"
"""Code of the contradiction between contacts and the table."""
LARGEST_SHARE = 0.1
"""Largest part of the rows with a force that may be left out; where more contradict the rest, nothing is certified."""
# A sweep is a line along the clamp's x axis if the clamp leaves that line by no more than this fraction of its travel, which a
# robot's path may.
_OFF_LINE = 0.05
FALSE_ALARM = 1e-5
"""Probability that noise makes a correct recording exceed the allowed distances."""
# Contacts, tangents, and contacts of the hull that are compared at most.
COMPARED = 1500


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
    "followed": ("unknown", "", "a channel that is missing: {}"),
}


class Checked(NamedTuple):
    """How a recording agrees with the model."""

    contradictions: list[Contradiction]
    """Empty if it agrees."""
    diagnosis: Diagnosis | None
    """The likeliest fault; None if it agrees, or if its sweeps differ by what the bounds allow for and no fault explains it."""


def checked(recording: Recording, cloud: Cloud) -> Checked:
    """The contradictions between a recording, its contacts and the model, and the likeliest fault."""
    if (left := cloud.left_out) is not None:
        recording, kept = rest(recording, left)
        number = np.full(kept[-1] + 1, -1)
        number[kept] = np.arange(len(kept))
        cloud = renumbered(cloud, number)
    alone, diagnosis = _below_table(cloud) + _followed(recording), None
    if cloud.model == "spatial":
        found = _in_space(recording, cloud)
    else:
        touched = cloud.fattened or cloud  # by the rod's centre line
        alone = _off_line(recording) + _out_of_plane(recording, touched) + alone
        pressed = int(felt(recording.pressing(six_axis=False), recording.noise.of_reactions(recording.rod)).sum())
        found = _without_contact(1 - (len(cloud) + cloud.light + cloud.second) / pressed if pressed else 0.0)
        found += shape_contradictions(recording, touched) if cloud.convex else []
    if alone:
        first = alone[0]
        code, unit, cause = _CAUSES[first.code]
        diagnosis = Diagnosis(code, first.value, unit, 1.0, f"most likely {cause.format(first.message)}")
    if left is not None and left.too_many:
        text = (
            f"{share(left.share)} of the rows with a force contradict their neighbours by more than the stated noise: more "
            f"than {share(LARGEST_SHARE)}, or many that follow each other, are no wild rows that may be left out"
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
    diagnosis = diagnose(recording, "spatial" if recording.six_axis else "planar")
    return "" if diagnosis.fault in ("unknown", "second-contact") else f"; {diagnosis.message}"


def kappa(count: int) -> float:
    """Standard deviations that no place of so many contacts is off by, but for `FALSE_ALARM`."""
    return float(np.sqrt(chdtri(3, FALSE_ALARM / max(count, 1))))


def _without_contact(fraction: float) -> list[Contradiction]:
    """Whether too large a fraction of the rows with a force have no contact."""
    if fraction <= DISTURBED:
        return []
    text = (
        f"{share(fraction)} of the rows with a force have no contact: no bent rod has their reactions "
        f"(at most {share(DISTURBED)} are expected)"
    )
    return [Contradiction("force-without-contact", text, fraction)]


def _followed(recording: Recording) -> list[Contradiction]:
    """That nothing tests forces that follow from moments."""
    if recording.completed is None or recording.completed.channel != FORCE:
        return []
    text = (
        "the forces follow from the moments on a surface that turns evenly from row to row, without corners, which nothing "
        "tests: measure the force for a certificate"
    )
    return [Contradiction("followed", text, np.nan)]


def shape_contradictions(recording: Recording, cloud: Cloud) -> list[Contradiction]:
    """Whether contacts in slices are not those of a convex body: an empty list if they are."""
    # the pair of a contact and a tangent that exceeds what is allowed by the largest factor
    pairs = [(0.0, 1.0), *(compared.misfit.worst() for compared in compared_in_slices(cloud))]
    beyond, allowed = max(pairs, key=lambda pair: pair[0] / pair[1])
    if beyond > allowed:
        text = (
            f"contacts lie up to {length(beyond, cloud.unit)} beyond the tangent at a contact of the same slice, where "
            f"noise and rounding allow {length(allowed, cloud.unit, digits=2)}: the contacts are not those of a convex body; "
            "of one that is not convex state convex = false under [source] of the recording"
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

    def deviations(self, error: Errors) -> tuple[Array, Array, Array]:
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
    lines = evenly(np.flatnonzero(cloud.phase == planar.Phase.TANGENTIAL), COMPARED)
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


def _below_table(cloud: Cloud) -> list[Contradiction]:
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
    text = (
        f"contacts lie down to z = {length(heights[worst], cloud.unit)}, where the table is at "
        f"{length(cloud.table, cloud.unit)}; move the frame "
        "of the poses so that the body stands on the table, or correct the table's height"
    )
    return [Contradiction(BELOW_TABLE, text, float(cloud.table - heights[worst]))]


def _off_line(recording: Recording) -> list[Contradiction]:
    """Whether every sweep moves along -x of the clamp's frame, which the poses alone decide."""
    _, first = np.unique(recording.sweep, return_index=True)
    last = np.append(first[1:], len(recording)) - 1
    travel = recording.position_m[last] - recording.position_m[first]
    way = np.linalg.norm(travel, axis=1)
    # the digits of two positions turn a short line by more than a fault would
    moved = way > 2 * LARGEST_OVER_SD * rounding_sd(recording.position_m.ravel()) / _OFF_LINE
    if not moved.any():
        return []
    along = -(travel[moved] * recording.axes()[first[moved], 0]).sum(axis=1) / way[moved]
    wrong = along < np.sqrt(1 - _OFF_LINE**2)
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
    size = f"contacts are off by up to {length(error, cloud.unit)}" if len(here) else "all of its contacts are lost"
    text = (
        f"a recording with six axes is read by the planar model, though {share(fraction)} of the force lies out of the "
        f"slices' planes: {size} compared with the spatial model, and {share(lost)} of them are missing; choose the "
        "spatial model"
    )
    return [Contradiction("out-of-plane", text, fraction)]
