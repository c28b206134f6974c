"""Whether a recording agrees with the model: a convex body, touched by a rod whose reactions are those that are recorded.

The tests use the recording alone.  Each has a threshold that correct recordings do not reach, whatever the body, the friction,
the noise that they state and the digits that they keep; errors of signs, axes, units, scales, offsets and times usually do.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from scan3d.arrays import Array, Index
from scan3d.cloud import Cloud, Tilt
from scan3d.reconstruction.contacts import FORCE_SIGMAS, NoContactError
from scan3d.reconstruction.contradiction import Contradiction
from scan3d.reconstruction.diagnosis import Diagnosis, diagnose
from scan3d.reconstruction.resolution import LARGEST_OVER_SD, noise_of, rounding_sd
from scan3d.reconstruction.rig_effects import with_rig_errors
from scan3d.reconstruction.slices import SliceStack, stacks
from scan3d.reconstruction.spatial import readings, without_normals
from scan3d.reconstruction.spatial_consistency import spatial_contradictions
from scan3d.recording import Recording

# Largest fraction of the rows with a force that may lack a contact.  Larger, faulty recordings pass; smaller, single
# disturbed rows of a measurement count as a contradiction.
_WITHOUT_CONTACT = 0.02
# A sweep is a line along the clamp's x axis if the clamp leaves that line by no more than this fraction of its travel.  Larger,
# wrong orientations pass; smaller, the errors of a robot's path count as wrong orientations.
_OFF_LINE = 0.05
# Rounding of a contact's place, in rod lengths, with the steps of fine converters that too few numbers show.  Larger, small
# faults pass, though most are a hundred times larger; smaller, rounding counts as a fault.
_ROUNDING = 1e-7
# Probability that noise makes a correct recording exceed the allowed distances.  Larger, false alarms; smaller, faults pass.
_FALSE_ALARM = 1e-5
# Lines and points of a slice that are compared at most.  More take longer; fewer may miss the worst pair.
_COMPARED = 1500
BELOW_TABLE = "below-table"
"""Code of the contradiction between contacts and the table."""
# Standard deviations by which the contacts of both models may differ by noise.  Larger, small forces out of the plane pass;
# smaller, noise counts as such a force.
_OUT_OF_PLANE_SIGMAS = 6.0


class _Found(NamedTuple):
    """What the tests measure, before thresholds are applied."""

    without_contact: float
    """Fraction of the rows with a force that have no contact."""
    beyond: float
    """Largest distance of a contact beyond a tangent, in the cloud's unit, over what is allowed is `excess`."""
    allowed: float
    """Distance that noise and rounding allow for that pair."""

    @property
    def excess(self) -> float:
        return self.beyond / self.allowed

    @property
    def contradicts(self) -> bool:
        return self.without_contact > _WITHOUT_CONTACT or self.excess > 1


class Checked(NamedTuple):
    """How a recording agrees with the model."""

    contradictions: list[Contradiction]
    """Empty if it agrees."""
    diagnosis: Diagnosis | None
    """The likeliest fault; None if it agrees."""


def contradictions(recording: Recording, cloud: Cloud) -> list[Contradiction]:
    """The contradictions between a recording, its contacts and the model; an empty list if there is none."""
    return checked(recording, cloud).contradictions


def checked(recording: Recording, cloud: Cloud) -> Checked:
    """The contradictions between a recording, its contacts and the model, and the likeliest fault."""
    if cloud.model == "spatial":
        warnings, found = _below_table(cloud), spatial_contradictions(recording, cloud)
        if not found:
            return Checked(warnings, _of_single_test(warnings))
        likeliest = diagnose(recording, "spatial")
        found = [warning._replace(message=f"{warning.message}; {likeliest.message}") for warning in found]
        return Checked(found + warnings, likeliest)
    warnings = _off_line(recording) + _out_of_plane(recording, cloud) + _below_table(cloud)
    tested = _tests(recording, cloud)
    if not tested.contradicts:
        return Checked(warnings, _of_single_test(warnings))
    diagnosis = _of_single_test(warnings) or diagnose(recording, "planar")
    cause = "" if warnings else f"; {diagnosis.message}"
    if tested.without_contact > _WITHOUT_CONTACT:
        warnings.append(
            Contradiction(
                "force-without-contact",
                f"{100 * tested.without_contact:.2g} % of the rows with a force have no contact: no bent rod has their "
                f"reactions (at most {100 * _WITHOUT_CONTACT:.0f} % are expected){cause}",
                tested.without_contact,
            )
        )
    if tested.excess > 1:
        warnings.append(
            Contradiction(
                "beyond-tangent",
                f"contacts lie up to {tested.beyond:.3g} {cloud.unit} beyond the tangent at a contact of the same slice, where "
                f"noise and rounding allow {tested.allowed:.2g} {cloud.unit}: the contacts are not those of a convex "
                f"body{cause}",
                tested.beyond,
            )
        )
    return Checked(warnings, diagnosis)


def _of_single_test(warnings: list[Contradiction]) -> Diagnosis | None:
    """The fault that a test has found which looks for this fault alone."""
    for warning in warnings:
        if warning.code == "sweep-direction":
            return Diagnosis("poses", warning.value, "deg", 1.0, f"most likely the poses are wrong: {warning.message}")
        if warning.code == "out-of-plane":
            return Diagnosis(
                "planar-model", warning.value, "", 1.0, "most likely the model is wrong: choose the spatial model"
            )
        if warning.code == BELOW_TABLE:
            return Diagnosis("table", warning.value, "", 1.0, f"most likely the table is wrong: {warning.message}")
    return None


def _tests(recording: Recording, cloud: Cloud) -> _Found:
    noise, rod = noise_of(recording), recording.rod
    threshold = FORCE_SIGMAS * max(noise.force_N, noise.moment_Nm / rod.moment_unit_Nm * rod.force_unit_N)
    felt = int((np.hypot(*recording.force_N.T) > threshold).sum())
    without = 1 - (len(cloud) + cloud.light) / felt if felt else 0.0
    return _Found(without, *_beyond_tangents(cloud))


def _beyond_tangents(cloud: Cloud) -> tuple[float, float]:
    """The distance of a contact beyond a tangent, and the allowed distance, of the pair with the largest ratio of the two.

    Tilted planes of contacts in one slice lie at different heights; there the body's slope up and down the axis, which lies
    between the secants to the neighbouring slices, is allowed for, and end slices are left out.
    """
    kappa = float(np.sqrt(chdtri(3, _FALSE_ALARM / max(len(cloud), 1))))
    off, turned = _by_calibration(cloud)
    rounding = _ROUNDING * cloud.rod_length + 2 * (cloud.pose_error + off)
    worst = 0.0, rounding
    for stack in stacks(cloud):
        for number, slice_ in enumerate(stack.slices):
            if cloud.tilt is not None and number in (0, len(stack.slices) - 1):
                continue
            lines, points = _some(slice_.tangential), _some(np.arange(len(slice_.rows)))
            if not len(lines):
                continue
            place, normals = slice_.points[lines], slice_.normals[np.searchsorted(slice_.tangential, lines)]
            beyond = normals @ slice_.points[points].T - (normals * place).sum(axis=1)[:, None]
            allowed = np.full(beyond.shape, rounding)
            if turned:
                allowed += turned * float(np.linalg.norm(np.ptp(slice_.points, axis=0)))
            if cloud.tilt is not None:
                allowed += _by_tilt(cloud, cloud.tilt, stack, number, normals)[:, None]
            if cloud.covariance is not None and cloud.normal_sd is not None:
                rows = slice_.rows
                covariance = np.einsum("ij,njk,lk->nil", stack.frame[:2], cloud.covariance[rows], stack.frame[:2])
                tangents = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
                along = tangents @ slice_.points[points].T - (tangents * place).sum(axis=1)[:, None]
                tilt = kappa * cloud.normal_sd[rows[lines]][:, None]
                quadratic = np.stack(
                    [normals[:, 0] ** 2, 2 * normals[:, 0] * normals[:, 1], normals[:, 1] ** 2], axis=1
                )
                entries = np.stack([covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]], axis=1)
                spread = kappa * np.sqrt(np.maximum(quadratic @ entries[points].T, 0.0))
                own = kappa * np.sqrt(np.maximum((quadratic * entries[lines]).sum(axis=1), 0.0))[:, None]
                reach = kappa * np.sqrt(entries[:, 0] + entries[:, 2])
                # and errors of the second order
                pairs = reach[lines][:, None] + reach[points]
                allowed += spread + own + tilt * (np.abs(along) + pairs) + pairs**2 / cloud.rod_length
            ratio = beyond / allowed
            i = np.unravel_index(np.argmax(ratio), ratio.shape)
            if ratio[i] > worst[0] / worst[1]:
                worst = float(beyond[i]), float(allowed[i])
    return worst


def _by_calibration(cloud: Cloud) -> tuple[float, float]:
    """By how much contacts, and angles of tangents, can be off by the uncertainty of the rig's calibration."""
    rig = cloud.calibration
    if rig is None or not len(cloud):
        return 0.0, 0.0
    factor = rig.factor(_FALSE_ALARM)
    return factor * float(rig.place_sd.max()), factor * float(rig.tilt_sd.max())


def _by_tilt(cloud: Cloud, tilt: Tilt, stack: SliceStack, number: int, normals: Array) -> Array:
    """(k,) how far contacts of a slice can lie beyond tangents with normals (k, 2), because their heights differ."""
    slice_ = stack.slices[number]
    radius = float(np.linalg.norm((cloud.points - tilt.centre) @ stack.frame[:2].T, axis=1).max())
    apart = 2 * (tilt.spread + np.sqrt(2) * tilt.slope * radius)
    support = slice_.support_of_contacts(normals)
    slopes = np.zeros(len(normals))
    for other in (stack.slices[number - 1], stack.slices[number + 1]):
        run = abs(slice_.height - other.height) - apart
        rise = np.abs(support - other.support_of_contacts(normals))
        slopes = np.maximum(slopes, rise / run if run > 0 else np.inf)
    allowed: Array = apart * slopes
    return allowed


def _some(rows: Index) -> Index:
    """At most `_COMPARED` of the rows, evenly spread."""
    return rows if len(rows) <= _COMPARED else rows[np.linspace(0, len(rows) - 1, _COMPARED).astype(np.intp)]


def _below_table(cloud: Cloud) -> list[Contradiction]:
    """Whether contacts lie below the table, farther than noise and rounding allow; an empty list if they do not."""
    if cloud.table is None:
        return []
    kappa = float(np.sqrt(chdtri(3, _FALSE_ALARM / max(len(cloud), 1))))
    allowed = np.full(len(cloud), _ROUNDING * cloud.rod_length + 2 * cloud.pose_error)
    if (rig := cloud.calibration) is not None:
        allowed += rig.factor(_FALSE_ALARM) * rig.place_sd
    if cloud.centre_points is not None:  # of a rod that touches the body from below the table
        heights, sd = cloud.centre_points[:, 2] + cloud.rod_radius, cloud.centre_sd
    else:
        heights = cloud.points[:, 2]
        sd = None if cloud.covariance is None else np.sqrt(np.maximum(cloud.covariance[:, 2, 2], 0.0))
    depth = cloud.table - heights - allowed - (0.0 if sd is None else kappa * sd)
    worst = int(depth.argmax())
    if depth[worst] <= 0:
        return []
    value = float(cloud.table - heights[worst])
    return [
        Contradiction(
            BELOW_TABLE,
            f"contacts lie down to z = {heights[worst]:.4g} {cloud.unit}, where the table is at {cloud.table:.4g}; move the "
            "frame of the poses so that the body stands on the table, or correct the table's height",
            value,
        )
    ]


def _off_line(recording: Recording) -> list[Contradiction]:
    """Whether every sweep moves along -x of the clamp's frame, which the poses alone decide."""
    _, first = np.unique(recording.sweep, return_index=True)
    last = np.append(first[1:], len(recording)) - 1
    travel = recording.position_m[last] - recording.position_m[first]
    length = np.linalg.norm(travel, axis=1)
    # the digits of two positions turn a short line by more than a fault would
    moved = length > 2 * LARGEST_OVER_SD * rounding_sd(recording.position_m.ravel()) / _OFF_LINE
    if not moved.any():
        return []
    along = -(travel[moved] * recording.axes()[first[moved], 0]).sum(axis=1) / length[moved]
    wrong = along < np.sqrt(1 - _OFF_LINE**2)
    if not wrong.any():
        return []
    angle = float(np.degrees(np.arccos(np.clip(along.min(), -1, 1))))
    return [
        Contradiction(
            "sweep-direction",
            f"the clamp moves at up to {angle:.0f}° to the -x axis of its own frame in {wrong.sum()} of {moved.sum()} sweeps: "
            "check the order of the quaternion (qw first), the axes and the direction of the sweeps",
            angle,
        )
    ]


def _out_of_plane(recording: Recording, cloud: Cloud) -> list[Contradiction]:
    """How wrong the planar model is for six-axis data, by comparison with the spatial one; an empty list if it is right."""
    if not recording.six_axis:
        return []
    known = readings(recording)
    force, _ = recording.wrench()
    felt = known.felt
    part = np.abs(force[felt, 2]) / np.linalg.norm(force[felt], axis=1)
    fraction = float(np.median(part)) if len(part) else 0.0
    try:
        spatial = without_normals(recording, known)
    except NoContactError:
        return []
    _, here, there = np.intersect1d(cloud.row, spatial.row, return_indices=True)
    lost = 1 - len(here) / len(spatial)
    distance = np.linalg.norm(cloud.points[here] - spatial.points[there], axis=1)
    error = float(np.percentile(distance, 95)) if len(here) else np.inf
    allowed = _ROUNDING * cloud.rod_length + _OUT_OF_PLANE_SIGMAS * spatial.noise
    allowed += _by_calibration(with_rig_errors(spatial, recording))[0]
    if lost <= _WITHOUT_CONTACT and error <= allowed:
        return []
    size = f"contacts are off by up to {error:.3g} {cloud.unit}" if len(here) else "all of its contacts are lost"
    return [
        Contradiction(
            "out-of-plane",
            f"a recording with six axes is read by the planar model, though {100 * fraction:.2g} % of the force lies out of "
            f"the slices' planes: {size} compared with the spatial model, and {100 * lost:.2g} % of them are missing; choose "
            "the spatial model",
            fraction,
        )
    ]


def cause_of_no_contact(recording: Recording) -> str:
    """What is likeliest to be wrong with a recording that has no contact, as the end of a sentence; "" if nothing is found."""
    diagnosis = diagnose(recording, "spatial" if recording.six_axis else "planar")
    return "" if diagnosis.fault in ("unknown", "second-contact") else f"; {diagnosis.message}"
