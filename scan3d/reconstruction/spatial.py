"""Contacts in the world from six-axis recordings: `scan3d.spatial.inverse` in each clamp's frame, then the rows' poses.

Normals come from each sweep's slip and path, from the force where there is no friction, and from the smooth body fitted to all
contacts if the body proves smooth.  The rod's centre line touches the body fattened by the rod's radius a; contacts on the
surface are ``r1 - a n``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

import planar
from scan3d.arrays import Array, Mask
from scan3d.cloud import Cloud, NormalSource
from scan3d.reconstruction.errors import FORCE_SIGMAS, NoContactError, tip_sigmas, tip_tolerance, too_light
from scan3d.reconstruction.normals import EXACT, hull_normals, with_fit
from scan3d.recording import Recording
from scan3d.spatial import inverse
from scan3d.spatial.normals import UNKNOWN, Normals, Source, Track, along_sweeps, angles, frictionless
from scan3d.units import UNITS_M

# Normals from slip and path are compared where their difference is known to this, in radians.
_COMPARABLE = np.pi / 180
# Standard deviations within which 95 % of the errors of a direction lie, both components of which are normally distributed.
_SIGMAS_95 = 2.45
# Friction angle, in radians, where no contact says what it is: that of a coefficient of 0.5.
_FRICTION_ANGLE = 0.46
_SOURCES = {Source.SLIP: NormalSource.SLIP, Source.PATH: NormalSource.PATH}


class Readings(NamedTuple):
    """What follows from each row (n,) of a six-axis recording, dimensionless."""

    found: inverse.SpatialContacts
    error: inverse.SpatialErrors | None
    """None for exact data."""
    felt: Mask
    """(n,) whether the force stands out from the noise."""
    touching: Mask
    """(n,) whether the row gives a contact."""
    light: Mask
    """(n,) whether it gives none because the rod touched too lightly."""
    noise: tuple[float, float]
    """Standard deviations of each component of force and moment."""


def readings(recording: Recording) -> Readings:
    """The closed form of each row.  Raises InputError if the recording has other axes than six."""
    force, moment = recording.reactions(six_axis=True)
    noise = recording.noise.of_reactions(recording.rod)
    error = inverse.errors(force, moment, noise) if max(*noise, recording.noise.pose_m) else None
    tolerance: float | Array = planar.TOLERANCE
    if error is not None:
        tolerance = tip_sigmas(np.where(np.isfinite(error.s1), error.s1, 0.0))
    felt: Mask = np.linalg.norm(force, axis=1) > FORCE_SIGMAS * max(noise)
    tolerance = tip_tolerance(recording, felt, tolerance, "spatial")
    found = inverse.reconstruct(force, moment, tolerance=tolerance, noise=noise)
    touching = felt & (found.status == inverse.Status.OK)
    light = np.zeros_like(touching) if error is None else too_light(error.largest, touching)
    return Readings(found, error, felt, touching & ~light, light, noise)


def spatial_contacts(recording: Recording) -> Cloud:
    """Contacts of a six-axis recording with the normals of the surface where they can be known.

    Raises InputError if the recording has other axes than six, and NoContactError if no row gives a contact.
    """
    known = readings(recording)
    cloud = without_normals(recording, known)
    force = np.einsum("ni,nij->nj", known.found.force[cloud.row], recording.axes()[cloud.row])
    cloud, slides = _with_sweep_normals(cloud, track(recording, known, cloud, force), known)
    cloud = with_fit(_with_hull_normals(cloud, force, slides), force, slides)
    return _moved_by_radius(cloud, force)


def without_normals(recording: Recording, known: Readings) -> Cloud:
    """The contacts without normals, at the rod's centre line.  Raises NoContactError if no row gives a contact."""
    rows = np.flatnonzero(known.touching)
    if not len(rows):
        raise NoContactError(
            f"the recording has no contact: none of its {len(recording)} rows has the six reactions of a bent rod; check "
            "its axes, signs and units"
        )
    axes = recording.axes()[rows]
    rod, scale, found, error = recording.rod, UNITS_M[recording.unit], known.found, known.error
    n, length = len(rows), rod.length_m / scale
    points = recording.position_m[rows] / scale + length * np.einsum("ni,nij->nj", found.point[rows], axes)
    covariance = place_sd = tangent_sd = None
    if error is not None:
        pose = recording.noise.pose_m / scale
        covariance = length**2 * np.einsum("nik,nij,njl->nkl", axes, error.point[rows], axes) + pose**2 * np.eye(3)
        place_sd, tangent_sd = np.hypot(length * error.largest[rows], pose), error.tangent[rows]
    return Cloud(
        points=points,
        normals=np.full((n, 3), np.nan),
        normal_source=np.full(n, NormalSource.UNKNOWN, dtype=np.int8),
        in_plane_normals=np.full((n, 3), np.nan),
        phase=found.phase[rows],
        slice=np.full(n, -1, dtype=np.int32),
        sweep=recording.sweep[rows].astype(np.int32),
        row=rows.astype(np.int32),
        force_N=np.linalg.norm(found.force[rows], axis=1) * rod.force_unit_N,
        friction=np.full(n, np.nan),
        slice_axis=np.empty((0, 3)),
        slice_height=np.empty(0),
        unit=recording.unit,
        rod_length=length,
        noise=0.0 if place_sd is None else float(np.median(place_sd)),
        covariance=covariance,
        place_sd=place_sd,
        normal_sd=np.full(n, np.inf),
        light=int(known.light.sum()),
        pose_error=recording.noise.place_m / scale,
        table=None if recording.table_m is None else recording.table_m / scale,
        model="spatial",
        rod_radius=rod.diameter_m / 2 / scale,
        centre_points=points,
        centre_sd=place_sd,
        tangent_sd=tangent_sd,
        tangents=np.einsum("ni,nij->nj", found.tangent[rows], axes),
        bending_angle=found.bending_angle[rows],
        independent=recording.noise.independent,
    )


def track(recording: Recording, known: Readings, cloud: Cloud, force: Array) -> Track:
    """The contacts of a cloud, with their forces (n, 3) in the world, as `scan3d.spatial.normals` needs them.

    They are in the order of the recording, whose sweeps may be mixed: `Track.row` numbers the samples sweep by sweep.
    """
    order = np.argsort(recording.sweep, kind="stable")
    position, axes = recording.position_m[order] / recording.rod.length_m, recording.axes()[order]
    moved = np.linalg.norm(np.diff(position, axis=0), axis=1)
    turned = np.linalg.norm(np.diff(axes, axis=0), axis=(1, 2)) / np.sqrt(2)
    travel, rank = np.empty(len(order)), np.empty(len(order), dtype=np.intp)
    rank[order] = np.arange(len(order))
    travel[order] = np.concatenate([[0.0], np.cumsum(moved + turned)])
    rows, error, middle = cloud.row, known.error, cloud.points.mean(axis=0)
    assert cloud.tangents is not None
    return Track(
        sweep=cloud.sweep,
        row=rank[rows],
        travel=travel[rows],
        point=(cloud.points - middle) / cloud.rod_length,
        s1=known.found.s1[rows],
        tangent=cloud.tangents,
        force=force,
        tangential=cloud.phase == planar.Phase.TANGENTIAL,
        covariance=None if cloud.covariance is None else cloud.covariance / cloud.rod_length**2,
        direction_sd=None if error is None else np.hypot(error.force[rows], error.tangent[rows]),
    )


def sweep_normals(path: Track) -> Normals:
    """Normals along the sweeps of contacts in any order."""
    order = np.argsort(path.row)
    columns: dict[str, Any] = {name: column for name, column in path._asdict().items() if column is not None}
    found = along_sweeps(Track(**{name: column[order] for name, column in columns.items()}))
    back: dict[str, Any] = {name: column[np.argsort(order)] for name, column in found._asdict().items()}
    return Normals(**back)


def _with_sweep_normals(cloud: Cloud, path: Track, known: Readings) -> tuple[Cloud, Mask]:
    """The cloud with the normals from slip, path and force, and whether contacts (n,) slide and have a known friction."""
    beta, error = known.found.friction_angle_bound[cloud.row], known.error
    direction = path.force / np.linalg.norm(path.force, axis=1, keepdims=True)
    tangential = path.tangential
    beta_sd = 0.0 if error is None else error.beta[cloud.row][tangential]
    if frictionless(beta[tangential], beta_sd):
        sd = np.full(len(cloud), EXACT) if error is None else error.force[cloud.row]
        source = np.full(len(cloud), NormalSource.FORCE, dtype=np.int8)
        cloud = replace(cloud, normals=direction, normal_source=source, normal_sd=sd, friction=np.zeros(len(cloud)))
        return cloud, np.ones(len(cloud), dtype=bool)
    found = sweep_normals(path)
    source = np.full(len(cloud), NormalSource.UNKNOWN, dtype=np.int8)
    for origin, meaning in _SOURCES.items():
        source[found.source == origin] = meaning
    friction = np.where(found.sticks, np.nan, np.tan(angles(found.normal, direction)))
    both = found.disagreement_sd < _COMPARABLE
    cloud = replace(
        cloud,
        normals=found.normal,
        normal_source=source,
        normal_sd=found.sd,
        friction=friction,
        slip_to_path=np.where(both, found.disagreement, np.nan),
    )
    return cloud, ~found.sticks


def _with_hull_normals(cloud: Cloud, force: Array, slides: Mask) -> Cloud:
    """The cloud with normals by the hull of the contacts where these are more certain, which they are without noise only."""
    if cloud.covariance is not None or cloud.tangents is None or cloud.normal_sd is None:
        return cloud
    by_hull = hull_normals(cloud.points, cloud.tangents, cloud.phase == planar.Phase.TANGENTIAL)
    better = (by_hull.half_width + EXACT < cloud.normal_sd) & (by_hull.half_width < UNKNOWN)
    normals = np.where(better[:, None], by_hull.normal, cloud.normals)
    direction = force / np.linalg.norm(force, axis=1, keepdims=True)
    return replace(
        cloud,
        normals=normals,
        normal_source=np.where(better, NormalSource.HULL, cloud.normal_source).astype(np.int8),
        normal_sd=np.where(better, by_hull.half_width + EXACT, cloud.normal_sd),
        friction=np.where(better & slides, np.tan(angles(normals, direction)), cloud.friction),
    )


def _moved_by_radius(cloud: Cloud, force: Array) -> Cloud:
    """The cloud with its points on the surface: `rod_radius` inside the centre points along the normals.

    Where the normal is unknown the direction of the force takes its place, which differs from it by the friction angle.  In
    tangential contact that is the force's part across the rod, without the friction along the rod (S11).
    """
    if cloud.rod_radius == 0:
        return cloud
    unknown = np.isnan(cloud.normals[:, 0])
    if cloud.tangents is not None:
        along = (force * cloud.tangents).sum(axis=1, keepdims=True) * cloud.tangents
        force = np.where((cloud.phase == planar.Phase.TANGENTIAL)[:, None], force - along, force)
    direction = np.where(unknown[:, None], force / np.linalg.norm(force, axis=1, keepdims=True), cloud.normals)
    points = cloud.points - cloud.rod_radius * direction
    if cloud.covariance is None or cloud.place_sd is None or cloud.normal_sd is None:
        return replace(cloud, points=points)
    tilt = np.where(unknown, friction_angle(cloud), np.minimum(cloud.normal_sd, 1.0))
    across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    covariance = cloud.covariance + ((cloud.rod_radius * tilt) ** 2)[:, None, None] * across
    place_sd = np.hypot(cloud.place_sd, cloud.rod_radius * tilt)
    return replace(cloud, points=points, covariance=covariance, place_sd=place_sd, noise=float(np.median(place_sd)))


class RadiusErrors(NamedTuple):
    """By how much contacts were moved from the rod's centre line onto the surface, and the errors that leaves."""

    moved: float
    left: float | None
    """Error of 95 % of the contacts with known normals at most, by the uncertainty of the normals; None if there are none."""
    unknown_normals: int
    """Contacts with unknown normals, which were moved along the force."""
    left_unknown: float | None
    """Their error, by the angle between force and normal; None if there are none."""


def radius_errors(cloud: Cloud) -> RadiusErrors:
    """What the rod's radius does to the contacts of a cloud, in its unit."""
    unknown = np.isnan(cloud.normals[:, 0])
    sd = np.empty(0) if cloud.normal_sd is None else cloud.normal_sd[~unknown]
    return RadiusErrors(
        cloud.rod_radius,
        cloud.rod_radius * _SIGMAS_95 * float(np.percentile(sd, 95)) if len(sd) else None,
        int(unknown.sum()),
        cloud.rod_radius * friction_angle(cloud) if unknown.any() else None,
    )


def friction_angle(cloud: Cloud) -> float:
    """An angle in radians that nearly all friction angles of the cloud are below, as far as it knows them."""
    known = cloud.friction[np.isfinite(cloud.friction)]
    return float(np.arctan(np.percentile(known, 95))) if len(known) else _FRICTION_ANGLE
