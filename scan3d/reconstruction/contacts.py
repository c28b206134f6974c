"""Contacts in the world from a recording: `planar.reconstruct` in each row's plane, then the rows' poses."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import planar
from scan3d.arrays import Array, Index, Mask
from scan3d.cloud import Cloud, NormalSource
from scan3d.errors import InputError
from scan3d.reconstruction.empty_slices import unproven
from scan3d.reconstruction.planes import planes
from scan3d.reconstruction.resolution import Noise, noise_of
from scan3d.reconstruction.rig_effects import tip_tolerance
from scan3d.recording import Recording
from scan3d.units import UNITS_M

# A row counts as touching if its force exceeds this many standard deviations of the noise.  Larger, weak contacts are lost;
# smaller, rows without contact give contacts that do not exist.
FORCE_SIGMAS = 8.0
# A contact counts as a tip contact if it lies within this many standard deviations of the tip.  Larger, tangential contacts
# near the tip lose their normals; smaller, noisy tip contacts get normals that belong to tangential contact.
_TIP_SIGMAS = 5.0
# A contact is left out if the standard deviation of its place is larger than this many times the median, and than this fraction
# of the rod's length: the rod touched too lightly.  Larger, such contacts lie far outside the body; smaller, more of the body
# is left without contacts.
_LIGHT, _TOLERABLE = 4.0, 1e-3
# The friction angles of the tangential contacts agree if 95 % of them are within this many radians of the median, plus this
# many per standard deviation of the noise.  Larger, a coefficient that varies passes for common and tip contacts get wrong
# normals; smaller, rounding or noise hides a common coefficient and tip contacts get no normals.
_FRICTION_AGREES, _FRICTION_GAIN = 1e-6, 3.0
# The largest distance from the tip, in rod lengths, at which noise can make a tip contact.  Larger, strong noise turns all
# contacts into tip contacts; smaller, some tip contacts under strong noise pass for tangential.
_LARGEST_TOLERANCE = 0.5


def contacts(recording: Recording, method: str = "closed-form") -> Cloud:
    """Contacts of a recording by `planar.reconstruct`, their normals in the planes of their slices only.

    Rows without contact, and rows whose force does not stand out from the noise, give no contact.  Raises InputError if no row
    gives one.
    """
    found = in_slices(recording, noise_of(recording), method)
    if not len(found.cloud):
        raise NoContactError(
            f"the recording has no contact: none of its {len(recording)} rows has reactions of a bent rod "
            f"(fx and mz not zero, base moving in -x of the clamp's frame); check its axes, signs and units"
        )
    return with_unresolved_slices(found.cloud, recording, found.number, found.left_out, found.felt)


class InSlices(NamedTuple):
    """Contacts of a recording and its slices, before it is known which of those without contact prove an end."""

    cloud: Cloud
    """May have no contact."""
    number: NDArray[np.int32]
    """(n,) number of the slice of each row."""
    left_out: Index
    """Slices without contact in which forces stand out from the noise."""
    felt: float
    """Deflection of a rod's tip, in rod lengths, from which it is felt."""


def in_slices(recording: Recording, known: Noise, method: str = "closed-form", *, tips: bool = True) -> InSlices:
    """Contacts and slices of a recording with known errors; without `tips`, tip contacts get no normals.

    The contacts of a slice depend on those of the others only where there is noise, a rig's calibration or a common friction.
    """
    rod = recording.rod
    fx, fy = (recording.force_N / rod.force_unit_N).T
    moment = recording.moment_Nm / rod.moment_unit_Nm
    noise = known.force_N / rod.force_unit_N, known.moment_Nm / rod.moment_unit_Nm
    error = errors_in_plane(fx, fy, moment, *noise)
    columns = np.zeros(len(moment)), fx, fy, moment
    felt = np.hypot(fx, fy) > FORCE_SIGMAS * max(noise)
    tolerance = tip_tolerance(recording, felt, error.tolerance, "planar")
    in_plane = planar.reconstruct(*columns, method=method, tolerance=tolerance)
    touching = felt & (in_plane.phase != planar.Phase.NONE)
    light = touching & error.light(touching)
    touching &= ~light
    common = _common_friction(in_plane.friction_angle[touching], max(noise)) if tips else None
    if common is not None:
        in_plane = planar.reconstruct(*columns, method=method, tolerance=tolerance, friction=common)
    rows = np.flatnonzero(touching)
    axes = recording.axes()
    scale = UNITS_M[recording.unit]
    points = recording.position_m[rows] + np.einsum("ni,nij->nj", in_plane.point[rows] * rod.length_m, axes[rows, :2])
    slices = planes(recording, axes[:, 2], points.mean(axis=0) if len(rows) else np.zeros(3), known.place_m)
    pose, length = known.pose_m / scale, rod.length_m / scale
    in_world = np.einsum("nij,nik,njl->nkl", error.place[rows], axes[rows, :2], axes[rows, :2])
    place_sd = np.hypot(length * error.largest[rows], pose)
    noisy = max(*noise, pose) > 0
    tangential = in_plane.phase[rows] == planar.Phase.TANGENTIAL
    cloud = Cloud(
        points=points / scale,
        normals=np.full((len(rows), 3), np.nan),
        normal_source=np.full(len(rows), NormalSource.UNKNOWN, dtype=np.int8),
        in_plane_normals=slices.turned(
            np.einsum("ni,nij->nj", in_plane.normal[rows], axes[rows, :2]), axes[:, 2], rows
        ),
        phase=in_plane.phase[rows],
        slice=slices.number[rows],
        sweep=recording.sweep[rows].astype(np.int32),
        row=rows.astype(np.int32),
        force_N=in_plane.force[rows] * rod.force_unit_N,
        friction=in_plane.friction[rows],
        slice_axis=slices.axis,
        slice_height=slices.height / scale,
        unit=recording.unit,
        rod_length=length,
        noise=float(np.median(place_sd)) if len(rows) else 0.0,
        covariance=length**2 * in_world + pose**2 * np.eye(3) if noisy else None,
        place_sd=place_sd if noisy else None,
        normal_sd=np.where(tangential, error.slope[rows], np.inf) if noisy else None,
        light=int(light.sum()),
        pose_error=known.place_m / scale,
        tilt=slices.tilt_in(scale),
        table=None if recording.table_m is None else recording.table_m / scale,
        independent=known.independent,
    )
    # a rod's tip is bent by a third of the force that is felt
    left_out = np.setdiff1d(slices.number[felt], cloud.slice)
    return InSlices(cloud, slices.number, left_out, FORCE_SIGMAS * max(noise) / 3)


def with_unresolved_slices(
    cloud: Cloud, recording: Recording, number: NDArray[np.int32], left_out: Index, felt: float
) -> Cloud:
    """The cloud with the slices without contact that may not be empty.

    The arguments are as in `InSlices`; of the recording the rows of slices without contact suffice, and their numbers (n,).
    """
    unresolved = unproven(cloud, recording, number, felt)
    unresolved[left_out] = True
    return replace(cloud, unresolved=unresolved) if unresolved.any() else cloud


class NoContactError(InputError):
    """No row of a recording has the reactions of a bent rod."""


class PlaneErrors(NamedTuple):
    """Standard deviations and covariances (n,) of what the reactions give, dimensionless; infinite without a rod."""

    place: Array
    """(n, 2, 2) covariance of the contact's place in the clamp's frame."""
    largest: Array
    """(n,) standard deviation of the place in its least certain direction."""
    slope: Array
    """(n,) standard deviation of the slope in tangential contact."""
    tolerance: Array
    """(n,) differences in s1 and in the friction angle that the noise can make."""

    def light(self, touching: Mask) -> Mask:
        """(n,) whether the rod touched too lightly, by comparison with all touching rows."""
        if not touching.any():
            return np.zeros(len(touching), dtype=bool)
        light: Mask = self.largest > max(_LIGHT * float(np.median(self.largest[touching])), _TOLERABLE)
        return light


def errors_in_plane(fx: Array, fy: Array, moment: Array, noise_force: float, noise_moment: float) -> PlaneErrors:
    """Errors of the first order from the Jacobian of the closed form."""
    n = len(fx)
    if not max(noise_force, noise_moment):
        return PlaneErrors(np.zeros((n, 2, 2)), np.zeros(n), np.zeros(n), np.full(n, planar.TOLERANCE))
    spread = planar.jacobian(fx, fy, moment) * [noise_force, noise_force, noise_moment]
    with np.errstate(over="ignore", invalid="ignore"):  # forces far below the noise have errors beyond all numbers
        place = np.einsum("nik,njk->nij", spread[:, :2], spread[:, :2])
        mean, half = (place[:, 0, 0] + place[:, 1, 1]) / 2, (place[:, 0, 0] - place[:, 1, 1]) / 2
        largest = np.sqrt(mean + np.hypot(half, place[:, 0, 1]))
        s1, beta = (np.linalg.norm(spread[:, k], axis=1) for k in (2, 4))
        slope = np.linalg.norm(spread[:, 3] - spread[:, 4], axis=1)
    tolerance = contact_tolerance(s1, beta)
    known = np.isfinite(largest)
    return PlaneErrors(
        place,
        np.where(known, largest, np.inf),
        np.where(known, slope, np.inf),
        np.where(known, tolerance, planar.TOLERANCE),
    )


def contact_tolerance(s1: Array, beta: Array) -> Array:
    """(n,) differences in s1 and in the friction angle that count as noise, from their standard deviations (n,).

    Where these are not known, it is that of exact data.
    """
    sd = np.maximum(s1, beta)
    return np.clip(np.where(np.isnan(sd), 0.0, _TIP_SIGMAS * sd), planar.TOLERANCE, _LARGEST_TOLERANCE)


def _common_friction(angle: Array, noise: float) -> float | None:
    """The coefficient that the friction angles (n,), NaN in tip contact, agree on; None if they do not."""
    angle = angle[np.isfinite(angle)]
    if not len(angle):
        return None
    median = float(np.median(angle))
    agree = np.percentile(np.abs(angle - median), 95) <= _FRICTION_AGREES + _FRICTION_GAIN * noise
    return max(float(np.tan(median)), 0.0) if agree else None
