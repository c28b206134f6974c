"""Step 2 over a recording: contacts in the world."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import planar
from scan3d.arrays import Array
from scan3d.cloud import Cloud, NormalSource
from scan3d.errors import InputError
from scan3d.recording import Recording
from scan3d.units import UNITS_M

# Standard deviations of the noise within which a force is none, and a contact's distance to the tip is none.
_FORCE_SIGMAS = 8.0
_TIP_SIGMAS = 4.0
# Standard deviation of a contact's place over that of force and moment, in rod lengths and observable units: for the middle
# of the working range; contacts under small forces are worse.
_NOISE_GAIN = 0.4
# Friction angles, in radians, that agree: 95 % of them to so much, and so much more per standard deviation of the noise.
_FRICTION_AGREES, _FRICTION_GAIN = 1e-6, 3.0
# However much noise, a contact this far from the tip, in rod lengths, is none of the tip's.
_MOST_TOLERANCE = 0.5
# Slices whose normals differ by less were meant to be parallel.
_SAME_NORMAL = 1e-3
# Sweeps are in one slice if their heights, in rod lengths, differ by less, or by less than this many times the spread of the
# heights within the median sweep.
_SAME_HEIGHT, _SPREADS = 1e-9, 4.0


def contacts(recording: Recording, method: str = "closed-form") -> Cloud:
    """Contacts of a recording by `planar.reconstruct`, their normals in the planes of their slices only.

    Rows without contact, and rows whose force is lost in the noise, give none.  Raises InputError if no row gives one.
    """
    rod = recording.rod
    fx, fy = (recording.force_N / rod.force_unit_N).T
    moment = recording.moment_Nm / rod.moment_unit_Nm
    noise = max(recording.noise_force_N / rod.force_unit_N, recording.noise_moment_Nm / rod.moment_unit_Nm)
    tolerance = min(max(planar.TOLERANCE, _TIP_SIGMAS * noise), _MOST_TOLERANCE)
    columns = np.zeros(len(moment)), fx, fy, moment
    found = planar.reconstruct(*columns, method=method, tolerance=tolerance)
    common = _common_friction(found, noise)
    if common is not None:
        found = planar.reconstruct(*columns, method=method, tolerance=tolerance, friction=common)
    touching = (found.phase != planar.Phase.NONE) & (np.hypot(fx, fy) > _FORCE_SIGMAS * noise)
    rows = np.flatnonzero(touching)
    if not len(rows):
        raise InputError(
            f"the recording has no contact: none of its {len(moment)} rows has reactions of a bent rod "
            f"(fx and mz not zero, base moving in -x of the clamp's frame); check its axes, signs and units"
        )

    axes = recording.axes()
    scale = UNITS_M[recording.unit]
    points = recording.position_m[rows] + np.einsum("ni,nij->nj", found.point[rows] * rod.length_m, axes[rows, :2])
    slice_of, slice_axis, slice_height = _slices(recording, axes[:, 2])
    return Cloud(
        points=points / scale,
        normals=np.full((len(rows), 3), np.nan),
        normal_source=np.full(len(rows), NormalSource.UNKNOWN, dtype=np.int8),
        in_plane_normals=np.einsum("ni,nij->nj", found.normal[rows], axes[rows, :2]),
        phase=found.phase[rows],
        slice=slice_of[rows],
        sweep=recording.sweep[rows].astype(np.int32),
        row=rows.astype(np.int32),
        force_N=found.force[rows] * rod.force_unit_N,
        friction=found.friction[rows],
        slice_axis=slice_axis,
        slice_height=slice_height / scale,
        unit=recording.unit,
        rod_length=rod.length_m / scale,
        noise=noise * _NOISE_GAIN * rod.length_m / scale,
    )


def _common_friction(found: planar.Contacts, noise: float) -> float | None:
    """The coefficient of friction that the tangential contacts agree on, None if they do not."""
    angle = found.friction_angle[np.isfinite(found.friction_angle)]
    if not len(angle):
        return None
    middle = float(np.median(angle))
    agree = np.percentile(np.abs(angle - middle), 95) <= _FRICTION_AGREES + _FRICTION_GAIN * noise
    return max(float(np.tan(middle)), 0.0) if agree else None


def _slices(recording: Recording, normals: Array) -> tuple[NDArray[np.int32], Array, Array]:
    """(n,) number of each row's slice, in order of appearance; (s, 3) normals of the slices and (s,) heights, in metres.

    A sweep lies in one plane.  Sweeps are in one slice if their planes differ by no more than rounding, or than a typical
    sweep's own poses do.
    """
    _, first, sweep = np.unique(recording.sweep, return_index=True, return_inverse=True)
    of_sweep = normals[first]
    direction = _groups(of_sweep, _SAME_NORMAL)
    mean = np.stack([np.bincount(direction, column) for column in of_sweep.T], axis=1)
    axis = (mean / np.linalg.norm(mean, axis=1, keepdims=True))[direction]
    height = (recording.position_m * axis[sweep]).sum(axis=1)
    plane = np.bincount(sweep, height) / np.bincount(sweep)
    low, high = np.full(len(plane), np.inf), np.full(len(plane), -np.inf)
    np.minimum.at(low, sweep, height)
    np.maximum.at(high, sweep, height)
    same = max(_SAME_HEIGHT * recording.rod.length_m, _SPREADS * float(np.median(high - low)))
    _, group = np.unique(np.column_stack([direction, _groups(plane[:, None], same)]), axis=0, return_inverse=True)
    group = group.reshape(-1)
    # numbers in the order in which the slices appear
    start = np.full(group.max() + 1, len(sweep))
    np.minimum.at(start, group, first)
    order = np.argsort(start)
    rank = np.empty(len(start), dtype=np.int32)
    rank[order] = np.arange(len(start))
    shown = sweep[start[order]]
    return rank[group][sweep], axis[shown], (np.bincount(group, plane) / np.bincount(group))[order]


def _groups(rows: Array, same: float) -> NDArray[np.int64]:
    """Number (n,) of each row's group: by gaps in every sorted column, so that no two equal values are torn apart."""
    keys = np.empty(rows.shape, dtype=np.int64)
    for key, column in zip(keys.T, rows.T, strict=True):
        order = np.argsort(column, kind="stable")
        key[order] = np.cumsum(np.insert(np.diff(column[order]) > same, 0, False))
    return np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
