"""Contacts in the world from a recording: `planar.reconstruct` in each row's plane, then the rows' poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import planar
from scan3d.arrays import Array, Mask
from scan3d.cloud import Cloud, NormalSource
from scan3d.errors import InputError
from scan3d.reconstruction.resolution import noise_of
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
# Slices are parallel if the components of their normals differ by less.  Larger, axes that are slightly inclined to each
# other are merged; smaller, the errors of measured poses split one axis into several.
_SAME_NORMAL = 1e-3
# Sweeps lie in one slice if their heights differ by less than this many rod lengths, or than this many times the spread of
# the heights within the median sweep.  Larger, neighbouring slices merge; smaller, the errors of poses split a slice.
SAME_HEIGHT, _SPREADS = 1e-9, 4.0


def contacts(recording: Recording, method: str = "closed-form") -> Cloud:
    """Contacts of a recording by `planar.reconstruct`, their normals in the planes of their slices only.

    Rows without contact, and rows whose force does not stand out from the noise, give no contact.  Raises InputError if no row
    gives one.
    """
    rod = recording.rod
    fx, fy = (recording.force_N / rod.force_unit_N).T
    moment = recording.moment_Nm / rod.moment_unit_Nm
    known = noise_of(recording)
    noise = known.force_N / rod.force_unit_N, known.moment_Nm / rod.moment_unit_Nm
    error = errors_in_plane(fx, fy, moment, *noise)
    columns = np.zeros(len(moment)), fx, fy, moment
    in_plane = planar.reconstruct(*columns, method=method, tolerance=error.tolerance)
    felt = np.hypot(fx, fy) > FORCE_SIGMAS * max(noise)
    touching = felt & (in_plane.phase != planar.Phase.NONE)
    light = touching & error.light(touching)
    touching &= ~light
    common = _common_friction(in_plane.friction_angle[touching], max(noise))
    if common is not None:
        in_plane = planar.reconstruct(*columns, method=method, tolerance=error.tolerance, friction=common)
    rows = np.flatnonzero(touching)
    if not len(rows):
        raise NoContactError(
            f"the recording has no contact: none of its {len(moment)} rows has reactions of a bent rod "
            f"(fx and mz not zero, base moving in -x of the clamp's frame); check its axes, signs and units"
        )

    axes = recording.axes()
    scale = UNITS_M[recording.unit]
    points = recording.position_m[rows] + np.einsum("ni,nij->nj", in_plane.point[rows] * rod.length_m, axes[rows, :2])
    slice_of, slice_axis, slice_height = slices_of(recording, axes[:, 2])
    unresolved = np.isin(np.arange(len(slice_height)), np.setdiff1d(slice_of[felt], slice_of[rows]))
    covariance = np.einsum("nij,nik,njl->nkl", error.place[rows], axes[rows, :2], axes[rows, :2])
    tangential = in_plane.phase[rows] == planar.Phase.TANGENTIAL
    return Cloud(
        points=points / scale,
        normals=np.full((len(rows), 3), np.nan),
        normal_source=np.full(len(rows), NormalSource.UNKNOWN, dtype=np.int8),
        in_plane_normals=np.einsum("ni,nij->nj", in_plane.normal[rows], axes[rows, :2]),
        phase=in_plane.phase[rows],
        slice=slice_of[rows],
        sweep=recording.sweep[rows].astype(np.int32),
        row=rows.astype(np.int32),
        force_N=in_plane.force[rows] * rod.force_unit_N,
        friction=in_plane.friction[rows],
        slice_axis=slice_axis,
        slice_height=slice_height / scale,
        unit=recording.unit,
        rod_length=rod.length_m / scale,
        noise=float(np.median(error.largest[rows])) * rod.length_m / scale,
        covariance=covariance * (rod.length_m / scale) ** 2 if max(noise) else None,
        place_sd=error.largest[rows] * rod.length_m / scale if max(noise) else None,
        normal_sd=np.where(tangential, error.slope[rows], np.inf) if max(noise) else None,
        unresolved=unresolved if unresolved.any() else None,
        light=int(light.sum()),
        pose_error=known.place_m / scale,
        table=None if recording.table_m is None else recording.table_m / scale,
        independent=known.independent,
    )


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


def slices_of(recording: Recording, normals: Array) -> tuple[NDArray[np.int32], Array, Array]:
    """(n,) number of each row's slice, in order of appearance; (s, 3) normals of the slices and (s,) heights, in metres.

    A sweep lies in one plane.  Sweeps are in one slice if their planes differ by no more than rounding, or by no more than the
    poses within a typical sweep do.
    """
    _, first, sweep = np.unique(recording.sweep, return_index=True, return_inverse=True)
    sweep_normals = normals[first]
    direction = _groups(sweep_normals, _SAME_NORMAL)
    mean = np.stack([np.bincount(direction, column) for column in sweep_normals.T], axis=1)
    axis = (mean / np.linalg.norm(mean, axis=1, keepdims=True))[direction]
    height = (recording.position_m * axis[sweep]).sum(axis=1)
    plane = np.bincount(sweep, height) / np.bincount(sweep)
    low, high = np.full(len(plane), np.inf), np.full(len(plane), -np.inf)
    np.minimum.at(low, sweep, height)
    np.maximum.at(high, sweep, height)
    same = max(SAME_HEIGHT * recording.rod.length_m, _SPREADS * float(np.median(high - low)))
    _, group = np.unique(np.column_stack([direction, _groups(plane[:, None], same)]), axis=0, return_inverse=True)
    group = group.reshape(-1)
    # numbers in the order in which the slices appear
    start = np.full(group.max() + 1, len(sweep))
    np.minimum.at(start, group, first)
    order = np.argsort(start)
    rank = np.empty(len(start), dtype=np.int32)
    rank[order] = np.arange(len(start))
    first_sweep = sweep[start[order]]
    return rank[group][sweep], axis[first_sweep], (np.bincount(group, plane) / np.bincount(group))[order]


def _groups(values: Array, same: float) -> NDArray[np.int64]:
    """Number (n,) of each row's group: by gaps in every sorted column, so that equal values are never separated."""
    keys = np.empty(values.shape, dtype=np.int64)
    for key, column in zip(keys.T, values.T, strict=True):
        order = np.argsort(column, kind="stable")
        key[order] = np.cumsum(np.insert(np.diff(column[order]) > same, 0, False))
    return np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
