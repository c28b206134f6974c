"""Contacts in the world from a recording, by the planar or the spatial model: the closed form in each row, then its pose.

In the plane normals lie in the slices first, and their inclinations follow from the slices below and above.  In space they come
from each sweep's slip and path, from the force where there is no friction, and from the hull of all contacts.  The rod's centre
line touches the body fattened by the rod's radius a; contacts on the surface are ``r1 - a n``.  If the body proves smooth, all
normals come from the support function fitted to all contacts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri

import planar
from planar.reconstruction import contacts_with_errors
from scan3d.arrays import Array, Index, Mask
from scan3d.choices import MODELS
from scan3d.cloud import Cloud, LeftOut, NormalSource
from scan3d.errors import InputError
from scan3d.geometry.support import fit_support
from scan3d.reconstruction.errors import (
    LARGEST_TOLERANCE,
    NoContactError,
    contact_tolerance,
    felt,
    independent,
    tip_sigmas,
    tip_tolerance,
    too_light,
    with_rig_errors,
)
from scan3d.reconstruction.facets import with_facet_normals
from scan3d.reconstruction.normals import EXACT, hull_normals, with_fit, with_slice_normals, with_smooth_fit
from scan3d.reconstruction.slices import planes, unproven
from scan3d.recording import FOLLOWED, FORCE_SIGMAS, IN_PLANE, Recording, followed, of_rows
from scan3d.spatial import inverse
from scan3d.spatial.normals import UNKNOWN, Normals, Source, Track, along_sweeps, angles, frictionless
from scan3d.units import UNITS_M

# Friction angle where no contact says what it is.
_FRICTION_ANGLE = float(np.arctan(0.5))
_SOURCES = {Source.SLIP: NormalSource.SLIP, Source.PATH: NormalSource.PATH}


def model_of(recording: Recording, model: str | None = None) -> str:
    """The model by which a recording is read, 'planar' or 'spatial'; see `scan3d.reconstruct`.

    Raises InputError if the recording has not the axes that the model needs, and for sweeps in the spatial model of a body that
    is stated not to be convex.
    """
    if model not in (None, *MODELS):
        raise InputError(f"model must be one of {', '.join(MODELS)}, got {model!r}")
    hollow = recording.stated_hollow and not recording.in_probings.all()
    if model == "planar" or (model is None and (hollow or not recording.six_axis)):
        return "planar"
    if hollow:
        raise InputError(
            "in the spatial model bodies that are not convex are probed, not swept, and the recording states convex = false: "
            "choose the planar model"
        )
    return "spatial"


# --- the planar model ---


class PlaneReadings(NamedTuple):
    """What follows from each row (n,) of a recording in the plane of its sweep, dimensionless."""

    found: planar.Contacts
    error: planar.Errors
    felt: Mask
    """(n,) whether the force stands out from the noise."""
    touching: Mask
    """(n,) whether the row gives a contact."""
    tolerance: Array
    """(n,) with which contacts count as those of the tip."""


def _in_plane(recording: Recording) -> tuple[tuple[Array, Array, Array, Array], planar.Rod]:
    """What `planar.reconstruct` takes: base, reactions and rod."""
    force, about = recording.reactions(six_axis=False)
    return (np.zeros(len(about)), force[:, 0], force[:, 1], about[:, 2]), recording.in_plane()


def readings_in_plane(recording: Recording) -> PlaneReadings:
    """The contact of each row, which depends on no other rows."""
    rod, (columns, bent) = recording.rod, _in_plane(recording)
    noise = recording.noise.of_reactions(rod)
    told: dict[str, Any] = {}
    if (by_moment := _by_moment(recording)) is not None:
        told = {"covariance": by_moment[:, IN_PLANE[:, None], IN_PLANE]}
    elif recording.completed is not None:
        told = recording.completed.errors
    wide, error = contacts_with_errors(*columns, tolerance=LARGEST_TOLERANCE, noise=noise, rod=bent, **told)
    pressed = felt(recording.pressing(six_axis=False), noise)
    # of contacts farther from the tip that no friction pulls no tolerance makes others
    near = pressed & ((wide.s1 >= 1 - LARGEST_TOLERANCE) | (wide.friction_angle_bound < 0))
    tolerance = np.asarray(tip_tolerance(recording, near, contact_tolerance(error), "planar"))
    # where the force meets the centre line may be as far from the tip as from the contact on the rod's surface
    if rod.diameter_m:
        reach = rod.diameter_m / 2 / rod.length_m / np.cos(np.nan_to_num(wide.friction_angle_bound))
        tolerance = np.minimum(tolerance + reach, LARGEST_TOLERANCE)
    found = wide.within(tolerance)
    return PlaneReadings(found, error, pressed, pressed & (found.phase != planar.Phase.NONE), tolerance)


def places_in_plane(
    recording: Recording, found: planar.Contacts, error: planar.Errors, rows: Index
) -> tuple[Array, Array]:
    """The contacts (k, 3) of some rows in metres, and their covariances (k, 3, 3) in the square of the recording's unit."""
    axes, rod, scale = recording.axes()[rows, :2], recording.rod, UNITS_M[recording.unit]
    points = recording.position_m[rows] + np.einsum("ni,nij->nj", found.point[rows] * rod.length_m, axes)
    in_world = axes.swapaxes(1, 2) @ error.point[rows] @ axes
    pose, length = recording.noise.pose_m / scale, rod.length_m / scale
    return points, length**2 * in_world + pose**2 * np.eye(3)


def contacts(recording: Recording) -> Cloud:
    """Contacts of a recording by `planar.reconstruct`, their normals in the planes of their slices only.

    Those of a thick rod are the contacts of its centre line with the body fattened by its radius.
    Rows without contact, and rows whose force does not stand out from the noise, give no contact.  Raises InputError if no row
    gives one.
    """
    rod, known = recording.rod, recording.noise
    noise, by_moment = known.of_reactions(rod), _by_moment(recording)
    in_plane, error, pressed, touching, tolerance = readings_in_plane(recording)
    radius = rod.diameter_m / 2
    light = too_light(error.largest, touching)
    touching &= ~light
    common = _common_friction(in_plane.friction_angle[touching], max(noise))
    if common is not None:
        in_plane = in_plane.within(tolerance=tolerance, friction=common)
    rows = np.flatnonzero(touching)
    if not len(rows):
        raise NoContactError(
            f"the recording has no contact: none of its {len(recording)} rows has reactions of a bent rod "
            f"(fx and mz not zero, base moving in -x of the clamp's frame); check its axes, signs and units"
        )
    axes = recording.axes()
    scale = UNITS_M[recording.unit]
    points, covariance = places_in_plane(recording, in_plane, error, rows)
    slices = planes(recording, axes[:, 2], points.mean(axis=0))
    pose, length = known.pose_m / scale, rod.length_m / scale
    place_sd = np.hypot(length * error.largest[rows], pose)
    noisy = max(*noise, pose) > 0 or by_moment is not None
    tangential = in_plane.phase[rows] == planar.Phase.TANGENTIAL
    cloud = at_rows(
        recording,
        rows,
        points / scale,
        in_plane_normals=slices.turned(
            np.einsum("ni,nij->nj", in_plane.normal[rows], axes[rows, :2]), axes[:, 2], rows
        ),
        phase=in_plane.phase[rows],
        slice=slices.number[rows],
        force_N=in_plane.force[rows] * rod.force_unit_N,
        friction=in_plane.friction[rows],
        slice_axis=slices.axis,
        slice_height=slices.height / scale,
        noise=float(np.median(place_sd)),
        covariance=covariance if noisy else None,
        place_sd=place_sd if noisy else None,
        normal_sd=np.where(tangential, error.slope[rows], np.inf) if noisy else None,
        light=int(light.sum()),
        tilt=None if slices.tilt is None else slices.tilt.scaled(1 / scale),
        table=None if recording.table_m is None else (recording.table_m - radius) / scale,
        independent=independent(recording),
        tapered=rod.tapered,
    )
    cloud = replace(cloud, lever=radius / scale * (1 / np.cos(_steepest(cloud)) - 1))
    # of the slices without contact; a rod's tip is bent by a third of the force that is felt
    unresolved = unproven(cloud, recording, slices.number, FORCE_SIGMAS * max(noise) / 3)
    unresolved[np.setdiff1d(slices.number[pressed], cloud.slice)] = True
    return replace(cloud, unresolved=unresolved) if unresolved.any() else cloud


def at_rows(recording: Recording, rows: Index, points: Array, **known: Any) -> Cloud:
    """The contacts (n, 3) of some rows of a recording, in its unit; what is known besides is given."""
    scale = UNITS_M[recording.unit]
    stated: dict[str, Any] = {
        "sweep": recording.sweep[rows].astype(np.int32),
        "row": rows.astype(np.int32),
        "unit": recording.unit,
        "rod_length": recording.rod.length_m / scale,
        "pose_error": recording.noise.place_m / scale,
        "table": None if recording.table_m is None else recording.table_m / scale,
    }
    return Cloud.of_places(points, **(stated | known))


def _by_moment(recording: Recording) -> Array | None:
    """Covariances (n, 6, 6) of reactions whose forces follow from the moments; None where the forces were measured."""
    by_moment = recording.completed is not None and recording.completed.channel in FOLLOWED
    return followed(recording)[2] if by_moment else None


def rest(recording: Recording, left: LeftOut) -> tuple[Recording, Index]:
    """The recording of the rows that are not left out, with their noise, and their numbers (k,)."""
    kept = np.setdiff1d(np.arange(len(recording)), left.rows)
    part = of_rows(recording, kept)
    force, moment = left.factor * part.noise_force_N, left.factor * part.noise_moment_Nm
    return replace(part, noise_force_N=force, noise_moment_Nm=moment), kept


def renumbered(cloud: Cloud, number: Index) -> Cloud:
    """The cloud with other numbers (n,) for the rows of the recording."""
    return cloud.changed(row=lambda one: number[one.row].astype(np.int32))


def with_rows(cloud: Cloud, rows: Index) -> Cloud:
    """The cloud with the numbers that rows have among those (k,), rising, that are kept of the recording."""
    number = np.full(rows[-1] + 1, -1)
    number[rows] = np.arange(len(rows))
    return renumbered(cloud, number)


def into_body(recording: Recording, cloud: Cloud) -> Array:
    """(n, 3) unit vectors from the contacts into the body: against the normals, or along the rods whose ends touch.

    Normals are those in the planes of slices, as far as they are known, and those of beads.
    """
    along = recording.axes()[cloud.row, 1]
    if cloud.bead_centres is not None:
        along = (cloud.points - cloud.bead_centres) / cloud.bead_radius
    return np.where(np.isfinite(cloud.in_plane_normals), -cloud.in_plane_normals, along)


def _steepest(cloud: Cloud) -> float:
    """The largest friction angle of the contacts in slices, in radians; of noisy ones, of the better known half."""
    known = np.isfinite(cloud.friction)
    if cloud.normal_sd is not None and known.any():
        known &= cloud.normal_sd <= np.median(cloud.normal_sd[known])
    return float(np.arctan(cloud.friction[known].max())) if known.any() else _FRICTION_ANGLE


def on_surface(cloud: Cloud, recording: Recording, convex: bool = True) -> Cloud:
    """The `contacts` of a recording with the normals of the surface, and what the rig's uncertainty and the rod's radius do.

    Those of a rod's centre line with the body fattened by its radius lie on the body's surface then.
    """
    cloud = with_slice_normals(cloud)
    if convex:
        cloud = with_smooth_fit(cloud)
        cloud = with_facet_normals(cloud) if cloud.fit is None else cloud
    cloud = with_rig_errors(cloud, recording)
    rod, scale = recording.rod, UNITS_M[recording.unit]
    if not rod.diameter_m:
        return cloud
    reaction, about = (part[cloud.row] for part in recording.reactions(six_axis=False))
    columns = np.zeros(len(about)), reaction[:, 0], reaction[:, 1], about[:, 2]
    bent = recording.in_plane().rows(cloud.row.astype(np.intp))
    radii = rod.radius_m(planar.reconstruct(*columns, tolerance=LARGEST_TOLERANCE, rod=bent).s1) / scale
    pressing = recording.pressing(six_axis=False)[cloud.row]
    force = -np.einsum("ni,nij->nj", pressing, recording.axes()[cloud.row])
    table = None if recording.table_m is None else recording.table_m / scale
    fattened = replace(cloud, tapered=False)
    moved = _moved_by_radius(
        replace(cloud, rod_radius=float(radii.max()), fattened=fattened, table=table), force, radii
    )
    if cloud.fit is None:
        return moved
    sd = cloud.sd_along(cloud.normals)
    return replace(moved, fit=fit_support(moved.points, cloud.normals, cloud.fit.degree, sd, table))


def _common_friction(angle: Array, noise: float) -> float | None:
    """The coefficient that the friction angles (n,), NaN in tip contact, agree on; None if they do not."""
    angle = angle[np.isfinite(angle)]
    if not len(angle):
        return None
    median = float(np.median(angle))
    # in radians: rounding, and what noise does
    agree = np.percentile(np.abs(angle - median), 95) <= 1e-6 + 3.0 * noise
    return max(float(np.tan(median)), 0.0) if agree else None


# --- the spatial model ---


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
    known = readings_alone(recording)
    light = np.zeros_like(known.touching) if known.error is None else too_light(known.error.largest, known.touching)
    return known._replace(touching=known.touching & ~light, light=light)


def readings_alone(recording: Recording) -> Readings:
    """`readings` of rows each of which is judged by itself, so that none of them counts as too light."""
    force, moment = recording.reactions(six_axis=True)
    noise = recording.noise.of_reactions(recording.rod)
    bent, down = recording.rod.in_space(), recording.down()
    error, by_moment = None, _by_moment(recording)
    if max(*noise, recording.noise.pose_m) or by_moment is not None:
        told: dict[str, Any] = {"rod": bent, "gravity": down, "covariance": by_moment}
        wide, error = inverse.contacts_with_errors(force, moment, noise, **told)
    else:
        wide = inverse.reconstruct(force, moment, tolerance=inverse.PAST_TIP, noise=noise, rod=bent, gravity=down)
    tolerance: float | Array = planar.TOLERANCE
    if error is not None:
        tolerance = tip_sigmas(np.where(np.isfinite(error.s1), error.s1, 0.0))
    pressed = felt(recording.pressing(six_axis=True), noise)
    # of contacts farther from the tip no tolerance makes others
    tolerance = tip_tolerance(recording, pressed & (wide.s1 >= 1 - LARGEST_TOLERANCE), tolerance, "spatial")
    found = wide.within(tolerance)
    touching = pressed & (found.status == inverse.Status.OK)
    return Readings(found, error, pressed, touching, np.zeros_like(touching), noise)


def spatial_contacts(recording: Recording) -> Cloud:
    """Contacts of a six-axis recording with the normals of the surface where they can be known.

    Raises InputError if the recording has other axes than six, and NoContactError if no row gives a contact.
    """
    known = readings(recording)
    cloud = without_normals(recording, known)
    force = np.einsum("ni,nij->nj", known.found.force[cloud.row], recording.axes()[cloud.row])
    cloud, slides = _with_sweep_normals(cloud, track(recording, known, cloud, force), known)
    cloud = with_fit(_with_hull_normals(cloud, force, slides), force, slides)
    return _moved_by_radius(cloud, force, recording.rod.radius_m(known.found.s1[cloud.row]) / UNITS_M[recording.unit])


def places(recording: Recording, known: Readings, rows: Index) -> tuple[Array, Array | None]:
    """The contacts (k, 3) of some rows in the recording's unit, and their covariances (k, 3, 3); None for exact data."""
    axes, scale = recording.axes()[rows], UNITS_M[recording.unit]
    length, pose = recording.rod.length_m / scale, recording.noise.pose_m / scale
    points = recording.position_m[rows] / scale + length * np.einsum("ni,nij->nj", known.found.point[rows], axes)
    if known.error is None:
        return points, None
    turned = np.einsum("nik,nij,njl->nkl", axes, known.error.point[rows], axes)
    return points, length**2 * turned + pose**2 * np.eye(3)


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
    points, covariance = places(recording, known, rows)
    place_sd = tangent_sd = None
    if error is not None:
        pose = recording.noise.pose_m / scale
        place_sd, tangent_sd = np.hypot(length * error.largest[rows], pose), error.tangent[rows]
    return at_rows(
        recording,
        rows,
        points,
        phase=found.phase[rows],
        force_N=np.linalg.norm(found.force[rows], axis=1) * rod.force_unit_N,
        noise=0.0 if place_sd is None else float(np.median(place_sd)),
        covariance=covariance,
        place_sd=place_sd,
        normal_sd=np.full(n, np.inf),
        light=int(known.light.sum()),
        model="spatial",
        rod_radius=rod.diameter_m / 2 / scale,
        tapered=rod.tapered,
        centre_points=points,
        centre_covariance=covariance,
        tangent_sd=tangent_sd,
        tangents=np.einsum("ni,nij->nj", found.tangent[rows], axes),
        bending_angle=found.bending_angle[rows],
        independent=independent(recording),
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
    # where the difference is known to a degree
    both = found.disagreement_sd < np.pi / 180
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


def _moved_by_radius(cloud: Cloud, force: Array, radius: Array) -> Cloud:
    """The cloud with its points on the surface: the rod's radius (n,) inside the centre points along the normals.

    Where the normal is unknown the direction of the force takes its place, which differs from it by the friction angle.  In
    tangential contact that is the force's part across the rod, without the friction along the rod (S11).
    """
    if not radius.any():
        return cloud
    unknown = np.isnan(cloud.normals[:, 0])
    if cloud.tangents is not None:
        along = (force * cloud.tangents).sum(axis=1, keepdims=True) * cloud.tangents
        force = np.where((cloud.phase == planar.Phase.TANGENTIAL)[:, None], force - along, force)
    direction = np.where(unknown[:, None], force / np.linalg.norm(force, axis=1, keepdims=True), cloud.normals)
    points = cloud.points - radius[:, None] * direction
    if cloud.covariance is None or cloud.place_sd is None or cloud.normal_sd is None:
        return replace(cloud, points=points)
    tilt = np.where(unknown, friction_angle(cloud), np.minimum(cloud.normal_sd, 1.0))
    across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    covariance = cloud.covariance + ((radius * tilt) ** 2)[:, None, None] * across
    place_sd = np.hypot(cloud.place_sd, radius * tilt)
    return replace(cloud, points=points, covariance=covariance, place_sd=place_sd, noise=float(np.median(place_sd)))


def radius_errors(cloud: Cloud) -> dict[str, float | None]:
    """By how much contacts were moved from the rod's centre line onto the surface, and the errors that leaves, in their unit.

    `left` is that of 95 % of the contacts with known normals at most, by the uncertainty of the normals; None if there are
    none, and in the planar model, where the inclination of the normals to the slices has no known uncertainty.
    `unknown_normals` are the contacts without, which were moved along the force, and `left_unknown` is their error, by the
    angle between force and normal; None if there are none.
    """
    unknown = np.isnan(cloud.normals[:, 0])
    sd = np.empty(0) if cloud.normal_sd is None or cloud.model == "planar" else cloud.normal_sd[~unknown]
    sd = sd[np.isfinite(sd)]  # that of normals from a surface that was cut is not known
    # 95 % of the errors of a direction, both components of which are normally distributed, lie within
    return {
        "moved": cloud.rod_radius,
        "left": cloud.rod_radius * float(np.sqrt(chdtri(2, 0.05))) * float(np.percentile(sd, 95)) if len(sd) else None,
        "unknown_normals": int(unknown.sum()),
        "left_unknown": cloud.rod_radius * friction_angle(cloud) if unknown.any() else None,
    }


def friction_angle(cloud: Cloud) -> float:
    """An angle in radians that nearly all friction angles of the cloud are below, as far as it knows them."""
    known = cloud.friction[np.isfinite(cloud.friction)]
    return float(np.arctan(np.percentile(known, 95))) if len(known) else _FRICTION_ANGLE
