"""Contacts in the world from a recording: `planar.reconstruct` in each row's plane, then the rows' poses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import planar
from scan3d.arrays import Array, Index
from scan3d.cloud import Cloud, NormalSource
from scan3d.reconstruction.errors import (
    FORCE_SIGMAS,
    NoContactError,
    contact_tolerance,
    tip_tolerance,
    too_light,
)
from scan3d.reconstruction.slices import planes, unproven
from scan3d.recording import Noise, Recording, joined
from scan3d.units import UNITS_M

# The friction angles of the tangential contacts agree if 95 % of them are within this many radians of the median, which is
# rounding, plus this many per standard deviation of the noise.
_FRICTION_AGREES, _FRICTION_GAIN = 1e-6, 3.0


def contacts(recording: Recording, method: str = "closed-form") -> Cloud:
    """Contacts of a recording by `planar.reconstruct`, their normals in the planes of their slices only.

    Rows without contact, and rows whose force does not stand out from the noise, give no contact.  Raises InputError if no row
    gives one.
    """
    found = in_slices(recording, recording.noise, method)
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
    noise = known.of_reactions(rod)
    error = planar.errors(fx, fy, moment, noise=noise)
    columns = np.zeros(len(moment)), fx, fy, moment
    felt = np.hypot(fx, fy) > FORCE_SIGMAS * max(noise)
    tolerance = tip_tolerance(recording, felt, contact_tolerance(error), "planar")
    in_plane = planar.reconstruct(*columns, method=method, tolerance=tolerance)
    touching = felt & (in_plane.phase != planar.Phase.NONE)
    light = too_light(error.largest, touching)
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
    in_world = np.einsum("nij,nik,njl->nkl", error.point[rows], axes[rows, :2], axes[rows, :2])
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


def _common_friction(angle: Array, noise: float) -> float | None:
    """The coefficient that the friction angles (n,), NaN in tip contact, agree on; None if they do not."""
    angle = angle[np.isfinite(angle)]
    if not len(angle):
        return None
    median = float(np.median(angle))
    agree = np.percentile(np.abs(angle - median), 95) <= _FRICTION_AGREES + _FRICTION_GAIN * noise
    return max(float(np.tan(median)), 0.0) if agree else None


# What a cloud has for every contact, as far as exact contacts in slices have it.
_COLUMNS = (
    "points",
    "normals",
    "normal_source",
    "in_plane_normals",
    "phase",
    "slice",
    "sweep",
    "row",
    "force_N",
    "friction",
    "slice_axis",
    "slice_height",
)


class GrowingContacts:
    """The contacts of exact recordings by one rod, each of whole slices that no earlier one has.

    They are those of `contacts`, but for tip contacts, which have no normals: a common friction depends on all contacts.
    """

    def __init__(self) -> None:
        self._cloud: Cloud | None = None
        self._rows = 0
        self._left_out: Index = np.empty(0, dtype=np.intp)
        self._empty: list[Recording] = []
        self._number: list[NDArray[np.int32]] = []
        self._proven = True
        """Whether all slices without contact prove an end: further contacts do not change that."""

    def add(self, recording: Recording) -> None:
        """Add a recording; its sweeps are numbered after those of the earlier ones."""
        found = in_slices(recording, Noise(0.0, 0.0, 0.0, 0.0, True), tips=False)
        before = 0 if self._cloud is None else len(self._cloud.slice_height)
        number = (before + found.number).astype(np.int32)
        new = replace(
            found.cloud,
            slice=(before + found.cloud.slice).astype(np.int32),
            row=(self._rows + found.cloud.row).astype(np.int32),
        )
        both = [new] if self._cloud is None else [self._cloud, new]
        columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in both]) for name in _COLUMNS}
        self._cloud = replace(new, **columns, kept={} if self._cloud is None else self._cloud.kept)
        self._rows += len(recording)
        self._left_out = np.concatenate([self._left_out, before + found.left_out])
        empty = ~np.isin(number, new.slice)
        if empty.any():
            self._empty.append(_of_rows(recording, np.flatnonzero(empty)))
            self._number.append(number[empty])
            self._proven = False

    def cloud(self) -> Cloud:
        """All contacts so far.  Raises InputError if there are none."""
        if self._cloud is None or not len(self._cloud):
            raise NoContactError("there is no contact yet")
        if self._proven:
            return self._cloud
        number = np.concatenate(self._number)
        found = with_unresolved_slices(self._cloud, joined(self._empty), number, self._left_out, 0.0)
        self._proven = found.unresolved is None
        return found


def _of_rows(recording: Recording, rows: Index) -> Recording:
    """Some rows of a recording of planar reactions."""
    names = "sweep", "position_m", "quaternion", "force_N", "moment_Nm"
    columns: dict[str, Any] = {name: getattr(recording, name)[rows] for name in names}
    return replace(recording, **columns)
