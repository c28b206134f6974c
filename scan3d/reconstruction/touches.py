"""Contacts of other probes: places, normals and deviations that were measured somehow, without a rod's reactions.

Whether the body is convex is judged by the touches themselves, each of which lies on its surface: in a convex body none lies
inside the hull of the others, by more than errors explain, nor beyond the plane of another one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import AT_ONCE, LARGEST, Array
from scan3d.cloud import Cloud, NormalSource
from scan3d.errors import InputError, UsageError
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import DENT_TOLERANCE, hull, vertices_of
from scan3d.geometry.triangles import dot
from scan3d.reconstruction.agreement import Contradiction, below_table
from scan3d.reconstruction.normals import with_smooth_fit
from scan3d.recording import LARGEST_OVER_SD, rounding_sd
from scan3d.units import check_unit, is_finite, length, share

# Standard deviations that the errors of no touch exceed.
_CERTAIN = 5.0
# Normals at corners of the hull tell which side is outside where the cosine of their angle to the hull's exceeds this.
_ACROSS = 0.5
# Digits of normals count as rounding if their standard deviation is at most this; coarser ones are those of a body's own faces.
_COARSEST = 1e-3
# The share of normals at corners of the hull that may point the other way where all others agree.
_TURNED = 0.1


def touches(
    points: Array,
    normals: Array | None = None,
    *,
    place_sd: Array | float | None = None,
    normal_sd: Array | float | None = None,
    covariance: Array | None = None,
    unit: str = "mm",
    table: float | None = None,
) -> Cloud:
    """The cloud of touches of any probe, such as a coordinate measuring machine or another tactile sensor.

    points (n, 3)
        places on the body's surface, in the unit.
    normals (n, 3)
        outwards, of any length; NaN where unknown.  Where all point inwards, they are turned.
    place_sd, normal_sd
        standard deviations (n,), or one of all: of each coordinate of a place, and of a normal's direction in each of the two
        directions across it, in radians; a normal without one, NaN, is not used.  None: the touches are exact up to their
        digits.
    covariance (n, 3, 3)
        of each place, where it is known, in the place of `place_sd`.
    table
        height z of the table, below which nothing of the body lies.

    `Cloud.convex` says whether the touches accord with a convex body.  Raises InputError for arrays of other shapes, numbers
    that are not finite, points that span no body, and normals of which some point inwards and some outwards.
    """
    check_unit(unit)
    if table is not None and not is_finite(table):
        raise InputError(f"the height of the table must be a number, got {table!r}; leave it out if it is unknown")
    points = _columns(points, 3, "points")
    if not np.isfinite(points).all():
        raise InputError(f"{int((~np.isfinite(points)).any(axis=1).sum())} points are not finite; leave them out")
    if len(points) and (largest := float(np.abs(points).max())) > LARGEST:
        raise InputError(f"the points hold {largest:.3g}, which is no length of a body; leave such points out")
    count, size = len(points), float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
    if covariance is not None:
        covariance = _numbers(covariance, "covariance")
        if covariance.shape != (count, 3, 3) or not np.isfinite(covariance).all():
            raise InputError(f"covariance must be finite, of the shape ({count}, 3, 3), got {covariance.shape}")
        variances = np.linalg.eigvalsh(covariance)
        rounding = 1e-5 * np.abs(variances).max(axis=1)  # more than float32 rounds
        if (wrong := variances[:, 0] < -rounding).any():
            raise InputError(f"covariance must not be negative in any direction, as {int(wrong.sum())} of {count} are")
        if (wrong := np.abs(covariance - covariance.swapaxes(1, 2)).max(axis=(1, 2)) > rounding).any():
            raise InputError(f"covariance must be symmetric, which {int(wrong.sum())} of {count} are not")
        place_sd = np.sqrt(np.maximum(variances[:, -1], 0.0))
    normal_sd = None if normal_sd is None else _numbers(normal_sd, "normal_sd")
    known_sd = None if normal_sd is None else np.where(np.isnan(normal_sd), 0.0, normal_sd)
    place, turn = _deviation(place_sd, count, "place_sd"), _deviation(known_sd, count, "normal_sd")
    if covariance is None and place is not None:
        covariance = place[:, None, None] ** 2 * np.eye(3)
    hull(points)  # raises InputError, which says why
    outward, coarse = np.full((count, 3), np.nan), 0.0
    if normals is not None:
        outward = _columns(normals, 3, "normals", count)
        coarse = rounding_sd(outward[np.isfinite(outward)])
        long = np.linalg.norm(outward, axis=1, keepdims=True)
        outward = oriented(points, np.where(long > 0, outward / np.where(long > 0, long, 1.0), np.nan))
        if normal_sd is not None:
            outward[np.broadcast_to(np.isnan(normal_sd), count)] = np.nan
    known = np.isfinite(outward).all(axis=1)
    noise, has_noise = np.zeros(count) if place is None else place, place is not None or turn is not None
    cloud = Cloud.of_places(
        points,
        normals=outward,
        normal_source=np.where(known, NormalSource.MEASURED, NormalSource.UNKNOWN).astype(np.int8),
        unit=unit,
        rod_length=size,
        noise=float(np.median(noise)),
        covariance=np.zeros((count, 3, 3)) if covariance is None and has_noise else covariance,
        place_sd=noise if has_noise else None,
        normal_sd=None if not has_noise else np.zeros(count) if turn is None else turn,
        pose_error=LARGEST_OVER_SD * rounding_sd(points.ravel()),
        normal_error=LARGEST_OVER_SD * coarse * (coarse <= _COARSEST),
        table=table,
        model="touches",
    )
    if (inside_hull(cloud) > 0).any():
        return replace(cloud, convex=False)
    # what the touches of a body that counts as convex contradict that by, its bounds allow for
    off = max(float(test(cloud, 0.0).max()) for test in (inside_hull, beyond_planes))
    cloud = replace(cloud, pose_error=cloud.pose_error + min(off, DENT_TOLERANCE * size))
    return replace(cloud, fit=with_smooth_fit(cloud).fit)  # of which the measured normals are not replaced


def inside_hull(cloud: Cloud, tolerance: float = DENT_TOLERANCE) -> Array:
    """(n,) how much deeper than errors and a tolerance, in diagonals, explain touches lie inside the hull of all; 0 for those
    of a convex body."""
    place = _errors(cloud)[0]
    depth = -nearest(cloud.points, hull(cloud.points))[0]
    return np.maximum(depth - place - place.max() - tolerance * cloud.rod_length, 0.0)


def beyond_planes(cloud: Cloud, tolerance: float = DENT_TOLERANCE) -> Array:
    """(n,) how far beyond the plane of each touch another one lies, by more than errors and a tolerance explain; 0 for those of
    a convex body, and where no normal is known."""
    known = np.flatnonzero(np.isfinite(cloud.normals).all(axis=1))
    place, turn = _errors(cloud)
    found, normals, points = np.zeros(len(cloud)), cloud.normals, cloud.points - cloud.points.mean(axis=0)
    corners = vertices_of(points)
    for rows in np.array_split(known, 1 + len(known) * len(corners) // AT_ONCE):
        above = normals[rows] @ points[corners].T - dot(normals[rows], points[rows])[:, None]
        explained = place[rows, None] + place[corners]
        if turn.any():
            square = dot(points, points)
            apart = square[rows, None] + square[corners] - 2 * points[rows] @ points[corners].T - above**2
            explained = explained + np.tan(np.minimum(turn[rows], 1.0))[:, None] * np.sqrt(np.maximum(apart, 0.0))
        found[rows] = (above - explained).max(axis=1)
    return np.maximum(found - tolerance * cloud.rod_length, 0.0)


def contradictions(cloud: Cloud) -> tuple[Contradiction, ...]:
    """Touches below the table, and what normals contradict of touches that themselves lie as those of a convex body."""
    found = tuple(below_table(cloud))
    beyond = beyond_planes(cloud)
    count = int((beyond > 0).sum())
    if not count or not cloud.convex:
        return found
    how = length(float(beyond.max()), cloud.unit, digits=2)
    has_deviation = cloud.normal_sd is not None and cloud.normal_sd.any()
    advice = (
        "the normals are less certain than stated" if has_deviation else "state the normals' deviation as normal_sd"
    )
    message = (
        f"{count} of {len(cloud)} touches have others beyond the planes of their normals, by up to {how}, though all lie as on "
        f"a convex body: {advice}, or leave the normals out"
    )
    return (*found, Contradiction("normals", message, float(beyond.max())))


def _errors(cloud: Cloud) -> tuple[Array, Array]:
    """Errors (n,) of places and of normals, in radians, that no touch exceeds."""
    place = np.full(len(cloud), cloud.pose_error)
    turn = np.full(len(cloud), cloud.normal_error)
    if cloud.place_sd is not None:
        place += _CERTAIN * cloud.place_sd
    if cloud.normal_sd is not None:
        turn += _CERTAIN * cloud.normal_sd
    return place, turn


def oriented(points: Array, normals: Array) -> Array:
    """Normals (n, 3) of touches (n, 3) that point outwards, turned round if all point inwards.

    At a corner of the touches' hull a normal has the direction of one of the hull's facets there, or one between them.
    Raises InputError where some point inwards and some outwards.
    """
    body = hull(points)
    row = cKDTree(points).query(body.vertices.view(np.ndarray))[1]
    outward = dot(normals[row], np.asarray(body.vertex_normals))
    outward = outward[np.abs(outward) > _ACROSS]  # of no NaN either
    turned = float((outward < 0).mean()) if len(outward) else 0.0
    if _TURNED < turned < 1 - _TURNED:
        raise InputError(
            f"{share(turned)} of the normals at the corners of the touches' hull point into it, and the others out of it; "
            "turn all of them outwards, or leave the normals out"
        )
    return -normals if turned > 0.5 else normals


def _numbers(given: Any, name: str) -> Array:
    """An array of floats.  Raises InputError for masked values, which would count as measured, and for what is no number."""
    if np.ma.isMaskedArray(given):
        raise InputError(
            f"{name} is a masked array, whose masked values would count as measured; leave those touches out"
        )
    try:
        return np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be an array of numbers, got {' '.join(str(given).split()):.40}") from None


def _columns(given: Any, width: int, name: str, count: int | None = None) -> Array:
    """An array (n, width).  Raises InputError for other shapes."""
    values = _numbers(given, name)
    if values.ndim != 2 or values.shape[1] != width or (count is not None and len(values) != count):
        expected = f"({'n' if count is None else count}, {width})"
        raise InputError(f"{name} must have the shape {expected}, got {values.shape}")
    return values


def _deviation(given: Array | float | None, count: int, name: str) -> Array | None:
    """Standard deviations (n,) of one number or of as many; None stays None.  Raises InputError."""
    if given is None:
        return None
    values = _numbers(given, name)
    if values.shape not in ((), (count,)):
        raise InputError(f"{name} must be one number or have the shape ({count},), got {values.shape}")
    if not (np.isfinite(values) & (values >= 0)).all():
        raise UsageError(
            f"{name} must be finite and not negative, got {float(np.min(values)):g}; leave it out if it is unknown"
        )
    return np.broadcast_to(values, count).copy()
