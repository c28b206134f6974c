"""Normals of the surface at the contacts: from slices, from the hull of all contacts, and from a smooth body fitted to them.

In slices the surface's normal at a contact is ``(n(θ), -∂h/∂z)``, normalised, where h(θ, z) is the support function of the
slices and the derivative is taken at the fixed normal angle θ; it is not the normal n(θ) of the slice's contour.  Since h is
concave in z, the secants to the slices below and above are certain bounds of its slope.

From the hull (S27): a plane that supports the body at a contact has all contacts on one side, so that its normal lies between
those of the hull's facets that meet in the contact.  At a tangential contact the plane contains the rod's tangent as well.
Seen along the tangent the hull fills an angle at the contact: the normal lies between the perpendiculars to both its sides.

If the body proves smooth, all normals are those of the support function fitted to all contacts.  In space the fit needs no
normals that are known: it starts from those of the hull, lets them follow the fitted body, and repeats that until its error at
held-out contacts falls no further.  It does not use that the normals of tangential contacts are perpendicular to the rod, so
that deviations from it show the error of its normals.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import ConvexHull, cKDTree

import planar
from scan3d.arrays import AT_ONCE, NEGLIGIBLE, ROUNDING, Array, Index, Mask, ratio, unit
from scan3d.cloud import Cloud, NormalSource
from scan3d.geometry.arcs import Places, arcs_at
from scan3d.geometry.hulls import edges_of, hull_about_mean
from scan3d.geometry.support import MAX_CONTACTS, SupportFit, fit_support
from scan3d.reconstruction.slices import SliceStack, SupportFunctions, stacks
from scan3d.spatial.normals import angles

EXACT = NEGLIGIBLE
"""Standard deviation, in radians, of the normals of exact data: rounding."""
# Slices on either side of a slice from which the slope at its height follows.  The normals differ from those by all slices, a
# spline through which forgets its ends by a factor of 2 + √3 from slice to slice, over the meshes that come along, with 64 and
# 256 slices, by 0.4° with 4, 0.04° with 6, 0.004° with 8 and 4e-5° with 12.
NEIGHBOURS = 12
# Degrees of the harmonic series, tried in this order until the error at the held-out contacts falls no further.
_DEGREES = (8, 16)
# The degree that noise may leave besides.
_LOW_DEGREE = 4
# A higher degree is kept if its error is below this many times that of the degree before.
_DEGREE_GAIN = 0.8
# Contacts per coefficient of the series that a fit needs at least, and before a fit is tried at all.
_PER_COEFFICIENT, _TO_TRY = 4, 10
# Error of a fit, in mean radii, above which a body has edges whatever the degree.
_HOPELESS = 2e-2
# Distances of the hull's corners, relative to its size, below which directions between them are rounding.
_ROUNDING = 1e-7


def with_smooth_fit(cloud: Cloud) -> Cloud:
    """The cloud of slices with the normals of the smooth body fitted to its contacts, if the body proves smooth."""
    rows = np.flatnonzero(np.isfinite(cloud.normals[:, 0]))
    if len(rows) < _TO_TRY * (_DEGREES[0] + 1) ** 2:
        return cloud
    held_out = _held_out_rows(rows)
    used = np.setdiff1d(rows, held_out)
    sd = cloud.select(used).sd_along(cloud.normals[used])
    best: tuple[SupportFit, float] | None = None
    for degree in _degrees(cloud, rows):
        if len(used) < _PER_COEFFICIENT * (degree + 1) ** 2:
            break
        fitted = fit_support(cloud.points[used], cloud.normals[used], degree, sd, cloud.table)
        error = _held_out_error(fitted, cloud.points[held_out], cloud.normals[held_out])
        if best is not None and not error < _DEGREE_GAIN * best[1]:
            break
        best = fitted, error
    if best is None or not _is_smooth(*best, cloud.noise):
        return cloud
    fitted, _ = best
    # the search for the normal at a tip contact starts from the known normal of the nearest contact
    near = rows[cKDTree(cloud.points[rows]).query(cloud.points)[1]]
    normals = fitted.normals(cloud.points, cloud.normals[near])
    source = np.full(len(cloud), NormalSource.FIT, dtype=np.int8)
    return replace(cloud, normals=normals, normal_source=source, fit=fitted)


def _degrees(cloud: Cloud, rows: Index) -> list[int]:
    """The degrees to try for some contacts of slices: those below the number of slices, since between fewer nothing holds the
    series; under noise, if half of them are too few, the one with which others predict every second slice best."""
    slices = np.unique(cloud.slice[rows])
    uncertain = cloud.noisy and len(slices) <= 2 * _DEGREES[-1]
    first, *higher = (_LOW_DEGREE, *_DEGREES) if uncertain else _DEGREES
    degrees = [first, *(degree for degree in higher if degree < len(slices))]
    if not uncertain or len(degrees) == 1:
        return degrees
    between = slices[np.argsort(cloud.slice_height[slices])][1:-1:2]
    away = np.isin(cloud.slice[rows], between)
    kept, held_out = rows[~away], rows[away]
    sd = cloud.select(kept).sd_along(cloud.normals[kept])

    def error(degree: int) -> float:
        if len(kept) < _PER_COEFFICIENT * (degree + 1) ** 2:
            return np.inf
        fitted = fit_support(cloud.points[kept], cloud.normals[kept], degree, sd, cloud.table)
        return _held_out_error(fitted, cloud.points[held_out], cloud.normals[held_out])

    return [min(degrees, key=error)]


def _held_out_rows(rows: Index) -> Index:
    """Those of the contacts that judge a fit and do not determine it."""
    # one in ten, and about 1000 at most
    return rows[:: max(10, len(rows) // 1000)]


def _is_smooth(fitted: SupportFit, error: float, noise: float) -> bool:
    """Whether the error of a fit at held-out contacts, in mean radii, is that of a smooth body; `noise` is a length."""
    # a cube, a cylinder or a lens stay above 3e-3; ellipsoids, eggs and pebbles of 10,000 facets stay below 2e-4; noise
    # may raise that by two standard deviations
    return error <= 5e-4 + 2 * noise / _mean_radius(fitted)


def _held_out_error(fitted: SupportFit, points: Array, start: Array) -> float:
    """95 % of the contacts (n, 3) with rough normals (n, 3) lie closer than this to the fitted body, in mean radii."""
    normals = fitted.normals(points, start)
    deviation = np.abs(((points - fitted.points(normals)) * normals).sum(axis=1))
    return float(np.percentile(deviation, 95)) / _mean_radius(fitted)


def _mean_radius(fitted: SupportFit) -> float:
    """Mean radius of a fitted body, in the unit of its contacts."""
    return float(float(np.linalg.det(fitted.shape)) ** (1 / 3))


def with_slice_normals(cloud: Cloud) -> Cloud:
    """The cloud with its normals replaced by those that follow from each slice and its neighbours."""
    normals, source = np.full_like(cloud.normals, np.nan), np.full_like(cloud.normal_source, NormalSource.UNKNOWN)
    for stack in stacks(cloud):
        for slice_, (along_rod, at_tip) in zip(stack.slices, height_slopes(stack), strict=True):
            for part, in_plane, slope, origin in (
                (slice_.tangential, slice_.normals, along_rod, NormalSource.SLICES),
                (slice_.tip, slice_.tip_normals, at_tip, NormalSource.FRICTION),
            ):
                rows = slice_.rows[part]
                inclined = np.column_stack([in_plane, -slope]) @ stack.frame
                inclined /= np.linalg.norm(inclined, axis=1, keepdims=True)
                known = np.isfinite(inclined[:, 0])
                normals[rows[known]] = inclined[known]
                source[rows[known]] = origin
    return replace(cloud, normals=normals, normal_source=source)


def height_slopes(stack: SliceStack) -> list[tuple[Array, Array]]:
    """∂h/∂z at the tangential (k,) and at the tip contacts (l,) of every slice; NaN where there is only one slice.

    ``(h - <c, n>)²``, with c(z) the Steiner point ``(1/π) ∫ h n dθ``, is nearly a parabola in z, even at the poles (for
    ellipsoids it is exactly a parabola).  Its cubic spline through the slice and its `NEIGHBOURS` on either side, or as many
    more on one side as lack on the other, gives the slope, which is then clipped to the secants: concavity makes them its
    bounds.
    """
    slopes = [(np.full(len(slice_.tangential), np.nan), np.full(len(slice_.tip), np.nan)) for slice_ in stack.slices]
    known = np.flatnonzero([slice_.closed for slice_ in stack.slices])
    if len(known) < 2:
        return slopes
    z, closed = stack.heights[known], [stack.slices[i] for i in known]
    functions, angle = SupportFunctions(closed), 2 * np.pi * np.arange(360) / 360
    h = functions.at(angle)
    centers = 2 * np.stack([(h * np.cos(angle)).mean(axis=1), (h * np.sin(angle)).mean(axis=1)], axis=1)
    for i, slice_ in enumerate(closed):
        first = max(0, min(i - NEIGHBOURS, len(closed) - 2 * NEIGHBOURS - 1))
        near, k = slice(first, first + 2 * NEIGHBOURS + 1), i - first
        normals = np.concatenate([slice_.normals, slice_.tip_normals])
        h = functions.at(np.arctan2(normals[:, 1], normals[:, 0]), near.start, near.stop)
        slope = _slope_at(z[near], h, centers[near], k, normals)
        slopes[known[i]] = slope[: len(slice_.tangential)], slope[len(slice_.tangential) :]
    return slopes


def _slope_at(z: Array, h: Array, centers: Array, k: int, normals: Array) -> Array:
    """∂h/∂z (n,) for the in-plane normals (n, 2) at the k-th of the heights z (s,).

    h (s, n)
        support functions of the slices at these heights.
    centers (s, 2)
        their Steiner points.
    """
    below = (h[k] - h[k - 1]) / (z[k] - z[k - 1]) if k else np.full(h.shape[1], np.inf)
    above = (h[k + 1] - h[k]) / (z[k + 1] - z[k]) if k + 1 < len(z) else np.full(h.shape[1], -np.inf)
    relative = h - centers @ normals.T
    ends = "not-a-knot" if len(z) > 3 else "natural"
    slopes = CubicSpline(z, np.hstack([centers, relative**2]), bc_type=ends)(z[k], 1)
    slope = normals @ slopes[:2] + ratio(slopes[2:], 2 * relative[k])
    slope = np.where(np.isfinite(slope), slope, np.where(np.isfinite(above), above, below))
    slope = np.clip(slope, np.minimum(above, below), np.maximum(above, below))
    return slope


class HullNormals(NamedTuple):
    """Normals of contacts (n,), NaN where they are unknown."""

    normal: Array
    """(n, 3) the middle of the interval."""
    half_width: Array
    """(n,) the largest angle to it, in radians; infinite where the normal is unknown."""


def hull_normals(points: Array, tangents: Array, tangential: Mask) -> HullNormals:
    """The normals of exact contacts (n, 3), with exact tangents (n, 3) where they are tangential (n,)."""
    normal, half_width = np.full_like(points, np.nan), np.full(len(points), np.inf)
    middle, hull = points.mean(axis=0), hull_about_mean(points)
    if hull is None:
        return HullNormals(normal, half_width)
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    vertices, edges = edges_of(hull)
    places, rows = Places(points, np.full(len(points), ROUNDING * size)), np.flatnonzero(tangential)
    arcs = arcs_at(places.select(rows), tangents[rows], np.zeros(len(rows)), places.select(vertices), edges)
    known = np.isfinite(arcs.half_width)
    normal[rows[known]], half_width[rows[known]] = arcs.middle[known], arcs.half_width[known]
    # tip contacts, contacts inside faces and edges of the hull, and those whose neighbours are too close to count
    rows = np.flatnonzero(half_width > 0.1)
    axis, width, edge = _cones(hull, points[rows] - middle, NEGLIGIBLE * size)
    sharp = tangential[rows] & np.isfinite(edge[:, 0])
    # the supporting plane contains the edge and the tangent
    exact = unit(np.cross(tangents[rows], edge))
    cosine = (exact * axis).sum(axis=1)
    exact *= np.sign(cosine)[:, None]
    sharp &= np.abs(cosine) >= np.cos(np.minimum(width, np.pi)) - _ROUNDING  # it lies between the facets' normals
    by_facets = np.where(sharp, 0.0, width)
    better = by_facets < half_width[rows]
    normal[rows[better]] = np.where(sharp[:, None], exact, axis)[better]
    half_width[rows[better]] = by_facets[better]
    return HullNormals(normal, half_width)


def _cones(hull: ConvexHull, points: Array, near: float) -> tuple[Array, Array, Array]:
    """The middle (n, 3) of the normals of the hull's facets that points (n, 3) lie on, and the largest angle (n,) to it.

    The third is the direction (n, 3) of the edge for points inside an edge of the hull, where two planes meet, else NaN.
    """
    normals, offsets = hull.equations[:, :3], hull.equations[:, 3]
    middle, width, edges = np.empty_like(points), np.empty(len(points)), np.empty_like(points)
    for rows in np.array_split(np.arange(len(points)), 1 + len(points) * len(normals) // AT_ONCE):
        part = points[rows]
        depth = -(part @ normals.T + offsets)
        nearest = depth.min(axis=1)
        # pairs of points and facets that they lie on, of which every point has one at least
        point, facet = np.nonzero(depth <= np.maximum(near, nearest)[:, None])
        starts = np.searchsorted(point, np.arange(len(part)))
        normal = normals[facet]
        total = np.add.reduceat(normal, starts)
        axis = unit(total)  # NaN on a flat hull, whose facets are opposite
        cosine = (axis[point] * normal).sum(axis=1)
        smallest = np.minimum.reduceat(cosine, starts)
        # the facet of each point whose normal is farthest from the axis
        at_most = np.flatnonzero(~(cosine > smallest[point]))
        farthest = at_most[np.searchsorted(point[at_most], np.arange(len(part)))]
        edge = np.cross(axis, normal[farthest])
        size = np.linalg.norm(edge, axis=1)
        edge = ratio(edge, size[:, None])
        across = np.maximum.reduceat(np.abs((edge[point] * normal).sum(axis=1)), starts)
        edge[~(size > _ROUNDING) | ~(across < _ROUNDING)] = np.nan
        middle[rows], edges[rows] = axis, edge
        angle = np.arccos(np.clip(smallest, -1.0, 1.0))
        # a contact inside the hull, far below what counts as on a facet, contradicts the model
        width[rows] = np.where(np.isfinite(angle) & (nearest <= 1e3 * near), angle, np.inf)
    return middle, width, edges


def with_fit(cloud: Cloud, force: Array, slides: Mask) -> Cloud:
    """The cloud, whose points are the centre points, with the normals of the body fitted to them if that is smooth.

    Contact forces (n, 3) are in the world; only contacts that slide (n,) have a friction that is known.
    """
    start = _start(cloud)
    fit = None if start is None else _smooth_body(cloud, start)
    if fit is None:
        return cloud
    fitted, error, normals = fit
    direction = force / np.linalg.norm(force, axis=1, keepdims=True)
    # else the fit is not that of the body from outside, on which the contact forces act
    if np.mean((normals * direction).sum(axis=1) > 0) < 0.99:
        return cloud
    sd = _fitted_sd(cloud, normals, fitted.degree * error)
    source = np.full(len(cloud), NormalSource.FIT, dtype=np.int8)
    if cloud.rod_radius > 0:  # the fit of the surface itself; that of the centre points is the fattened body's
        sd_along = cloud.sd_along(normals)
        fitted = fit_support(cloud.points - cloud.rod_radius * normals, normals, fitted.degree, sd_along, cloud.table)
    friction = np.where(slides, np.tan(angles(normals, direction)), np.nan)
    return replace(
        cloud,
        normals=normals,
        normal_source=source,
        normal_sd=sd,
        friction=friction,
        fit=fitted,
    )


def _smooth_body(cloud: Cloud, normals: Array) -> tuple[SupportFit, float, Array] | None:
    """The support function of a smooth body, its error at held-out contacts in mean radii, and the normals (n, 3)."""
    rows = np.arange(len(cloud))
    if len(rows) < _TO_TRY * (_DEGREES[0] + 1) ** 2:
        return None
    held_out = _held_out_rows(rows)
    used = np.setdiff1d(rows, held_out)
    # of exact data fewer are enough
    used = used[:: max(1, -(-len(used) // (MAX_CONTACTS if cloud.noise else 2000)))]
    used_part, held_out_part = (
        _Part(cloud.points[part], normals[part], cloud.select(part).sd_along(normals[part]))
        for part in (used, held_out)
    )
    parts = used_part, held_out_part
    best: tuple[SupportFit, float, tuple[_Part, _Part]] | None = None
    for degree in _DEGREES:
        if len(used) < _PER_COEFFICIENT * (degree + 1) ** 2:
            break
        fit = _converged(*(parts if best is None else best[2]), degree)
        if best is not None and not fit[1] < _DEGREE_GAIN * best[1]:
            break
        best = fit
        # a higher degree would follow the noise, or rounding
        small = max(1e-6, cloud.noise / _mean_radius(best[0]))
        if not small < best[1] < _HOPELESS:
            break
    if best is None or not _is_smooth(best[0], best[1], cloud.noise):
        return None
    fitted, error, (known, _) = best
    # elsewhere the normals start from those of the nearest contact of the fit
    start = known.normals[cKDTree(known.points).query(cloud.points)[1]]
    return fitted, error, fitted.normals(cloud.points, fitted.normals(cloud.points, start))


class _Part(NamedTuple):
    """Some contacts: their points (n, 3), normals (n, 3), and the standard deviations (n,) of noisy points along them."""

    points: Array
    normals: Array
    sd: Array | None

    def followed(self, fitted: SupportFit) -> _Part:
        return self._replace(normals=fitted.normals(self.points, self.normals))


def _converged(used: _Part, held_out: _Part, degree: int) -> tuple[SupportFit, float, tuple[_Part, _Part]]:
    """The fit of some degree to contacts, repeated from its own normals, its error at others, and the normals of both."""
    best: tuple[SupportFit, float, tuple[_Part, _Part]] | None = None
    for _ in range(7):
        fitted = fit_support(used.points, used.normals, degree, used.sd)
        used, held_out = used.followed(fitted), held_out.followed(fitted)
        error = _held_out_error(fitted, held_out.points, held_out.normals)
        falling = best is None or error < 0.7 * best[1]
        if best is None or error < best[1]:
            best = fitted, error, (used, held_out)
        if not falling or not 1e-11 < error < _HOPELESS:
            break
    assert best is not None
    return best


def _fitted_sd(cloud: Cloud, normals: Array, turn: float) -> Array:
    """Standard deviation (n,) of the angle of fitted normals (n, 3).

    In tangential contact the normal is perpendicular to the rod: deviations from that, at the twelve nearest ones, show one of
    the two components of the error.  `turn` is the smallest that is believed: a function of some degree turns by its
    degree times its error.
    """
    sd = np.full(len(cloud), np.hypot(turn, EXACT))
    tangential = np.flatnonzero(cloud.phase == planar.Phase.TANGENTIAL)
    if len(tangential) < 12 or cloud.tangents is None:
        return sd
    square = (normals[tangential] * cloud.tangents[tangential]).sum(axis=1) ** 2
    near = cKDTree(cloud.points[tangential]).query(cloud.points, 12)[1]
    return np.asarray(np.sqrt(sd**2 + 2 * square[near].mean(axis=1)))


def _start(cloud: Cloud) -> Array | None:
    """Rough normals (n, 3) of all contacts: those that are known well, else those of the hull; None if there is no hull."""
    assert cloud.normal_sd is not None
    hull = hull_about_mean(cloud.points)
    if hull is None:
        return None
    corners = hull.points[hull.simplices]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    normals = np.zeros_like(cloud.points)
    for k in range(3):
        np.add.at(normals, hull.simplices[:, k], area[:, None] * hull.equations[:, :3])
    known = np.isfinite(cloud.normals[:, 0]) & (cloud.normal_sd < 0.03)
    normals[known] = cloud.normals[known]
    length = np.linalg.norm(normals, axis=1)
    placed = np.flatnonzero(length > 0)
    normals[placed] /= length[placed, None]
    return np.asarray(normals[placed[cKDTree(cloud.points[placed]).query(cloud.points)[1]]])
