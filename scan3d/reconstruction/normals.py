"""Normals of the surface at the contacts.

The surface's normal at a contact is ``(n(θ), -∂h/∂z)``, normalised, where h(θ, z) is the support function of the slices and
the derivative is taken at the fixed normal angle θ; it is not the normal n(θ) of the slice's contour.  Since h is concave in
z, the secants to the slices below and above are certain bounds of its slope.  If the body proves smooth, the normals are those
of the support function fitted to all contacts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from scan3d.arrays import Array, Index
from scan3d.cloud import Cloud, NormalSource
from scan3d.geometry.support import SupportFit, fit_support
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.slices import SliceStack, SupportFunctions, stacks
from scan3d.recording import Recording

# Degrees of the harmonic series, tried in this order until the error at the held-out contacts falls no further.  A higher
# degree follows more detail, but takes time with the fourth power of the degree and follows noise as well.
DEGREES = (8, 16)
# One contact in this many is held out of the fit.  Larger, fewer contacts judge the fit; smaller, fewer determine it.
_HELD_OUT_STEP = 10
# Approximate number of contacts held out at most.  Larger, judging the fit takes longer; smaller, its error is less certain.
_HELD_OUT_LIMIT = 1000
# A higher degree is kept if its error is below this many times that of the degree before.  Larger, a degree is kept that
# hardly helps; smaller, detail is lost that the higher degree would show.
DEGREE_GAIN = 0.8
# Contacts per coefficient of the series that a fit needs at least, and before a fit is tried at all.  Larger, smooth bodies
# need more slices to be fitted; smaller, the coefficients are determined by too few contacts.
CONTACTS_PER_COEFFICIENT, CONTACTS_TO_TRY = 4, 10
# The body is smooth if 95 % of the held-out contacts are this close to the fit, in mean radii.  Larger, bodies with edges pass
# for smooth: a cube, a cylinder or a lens stay above 3e-3.  Smaller, coarse meshes of smooth bodies fail: ellipsoids, eggs
# and pebbles of 10,000 facets stay below 2e-4.
SMOOTH = 5e-4
# Slices on either side of a slice from which the slope at its height follows.  More take longer; with fewer, the normals
# differ more from those by all slices, a spline through which forgets its ends by a factor of 2 + √3 from slice to slice:
# over the meshes that come along, with 64 and 256 slices, by 0.4° at 4, 0.04° at 6, 0.004° at 8 and 4e-5° at 12.
NEIGHBOURS = 12
# Standard deviations of a contact's place by which noise may raise that limit.  Larger, noise hides edges; smaller, noisy
# scans of smooth bodies are not fitted.
_NOISE_SIGMAS = 2


def planar_contacts(recording: Recording, method: str) -> Cloud:
    """Contacts of a recording by the planar model, with the normals of the surface where they can be known."""
    cloud = with_slice_normals(contacts(recording, method))
    fit = smooth_fit(cloud)
    return cloud if fit is None else _with_fit(cloud, *fit)


def smooth_fit(cloud: Cloud) -> tuple[SupportFit, float] | None:
    """The support function of a smooth body and its error at held-out contacts, in mean radii; None for other bodies."""
    rows = np.flatnonzero(np.isfinite(cloud.normals[:, 0]))
    if len(rows) < CONTACTS_TO_TRY * (DEGREES[0] + 1) ** 2:
        return None
    held_out = held_out_rows(rows)
    used = np.setdiff1d(rows, held_out)
    sd = cloud.select(used).sd_along(cloud.normals[used])
    best: tuple[SupportFit, float] | None = None
    for degree in DEGREES:
        if len(used) < CONTACTS_PER_COEFFICIENT * (degree + 1) ** 2:
            break
        fitted = fit_support(cloud.points[used], cloud.normals[used], degree, sd, cloud.table)
        error = held_out_error(fitted, cloud.points[held_out], cloud.normals[held_out])
        if best is not None and not error < DEGREE_GAIN * best[1]:
            break
        best = fitted, error
    return best if best is not None and is_smooth(*best, cloud.noise) else None


def held_out_rows(rows: Index) -> Index:
    """Those of the contacts that judge a fit and do not determine it."""
    return rows[:: max(_HELD_OUT_STEP, len(rows) // _HELD_OUT_LIMIT)]


def is_smooth(fitted: SupportFit, error: float, noise: float) -> bool:
    """Whether the error of a fit at held-out contacts, in mean radii, is that of a smooth body; `noise` is a length."""
    return error <= SMOOTH + _NOISE_SIGMAS * noise / mean_radius(fitted)


def held_out_error(fitted: SupportFit, points: Array, start: Array) -> float:
    """95 % of the contacts (n, 3) with rough normals (n, 3) lie closer than this to the fitted body, in mean radii."""
    normals = fitted.normals(points, start)
    deviation = np.abs(((points - fitted.points(normals)) * normals).sum(axis=1))
    return float(np.percentile(deviation, 95)) / mean_radius(fitted)


def mean_radius(fitted: SupportFit) -> float:
    """Mean radius of a fitted body, in the unit of its contacts."""
    return float(float(np.linalg.det(fitted.shape)) ** (1 / 3))


def with_slice_normals(cloud: Cloud) -> Cloud:
    """The cloud with its normals replaced by those that follow from each slice and its neighbours."""
    normals, source = np.full_like(cloud.normals, np.nan), np.full_like(cloud.normal_source, NormalSource.UNKNOWN)
    for stack in stacks(cloud):
        for slice_, slopes in zip(stack.slices, height_slopes(stack), strict=True):
            for part, in_plane, slope, origin in (
                (slice_.tangential, slice_.normals, slopes.tangential, NormalSource.SLICES),
                (slice_.tip, slice_.tip_normals, slopes.tip, NormalSource.FRICTION),
            ):
                rows = slice_.rows[part]
                inclined = np.column_stack([in_plane, -slope]) @ stack.frame
                inclined /= np.linalg.norm(inclined, axis=1, keepdims=True)
                known = np.isfinite(inclined[:, 0])
                normals[rows[known]] = inclined[known]
                source[rows[known]] = origin
    return replace(cloud, normals=normals, normal_source=source)


class HeightSlopes(NamedTuple):
    """∂h/∂z at the contacts of one slice whose in-plane normals are known."""

    tangential: Array
    """(k,)"""
    tip: Array
    """(l,)"""


def height_slopes(stack: SliceStack) -> list[HeightSlopes]:
    """∂h/∂z at the contacts of every slice; NaN where there is only one slice.

    ``(h - <c, n>)²``, with c(z) the Steiner point, is nearly a parabola in z, even at the poles (for ellipsoids it is exactly
    a parabola).  Its cubic spline through the slice and its `NEIGHBOURS` on either side, or as many more on one side as lack on
    the other, gives the slope, which is then clipped to the secants: concavity makes them its bounds.
    """
    slopes = [
        HeightSlopes(np.full(len(slice_.tangential), np.nan), np.full(len(slice_.tip), np.nan))
        for slice_ in stack.slices
    ]
    known = np.flatnonzero([slice_.closed for slice_ in stack.slices])
    if len(known) < 2:
        return slopes
    z, closed = stack.heights[known], [stack.slices[i] for i in known]
    centers = np.array([slice_.steiner_point() for slice_ in closed])
    functions = SupportFunctions(closed)
    for i, slice_ in enumerate(closed):
        first = max(0, min(i - NEIGHBOURS, len(closed) - 2 * NEIGHBOURS - 1))
        near, k = slice(first, first + 2 * NEIGHBOURS + 1), i - first
        normals = np.concatenate([slice_.normals, slice_.tip_normals])
        h = functions.at(np.arctan2(normals[:, 1], normals[:, 0]), near.start, near.stop)
        slope = _slope_at(z[near], h, centers[near], k, normals)
        slopes[known[i]] = HeightSlopes(slope[: len(slice_.tangential)], slope[len(slice_.tangential) :])
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
    slopes = _spline(z, np.hstack([centers, relative**2]))(z[k], 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = normals @ slopes[:2] + slopes[2:] / (2 * relative[k])
    slope = np.where(np.isfinite(slope), slope, np.where(np.isfinite(above), above, below))
    slope = np.clip(slope, np.minimum(above, below), np.maximum(above, below))
    return slope


def _spline(z: Array, values: Array) -> CubicSpline:
    return CubicSpline(z, values, bc_type="not-a-knot" if len(z) > 3 else "natural")


def _with_fit(cloud: Cloud, fitted: SupportFit, error: float) -> Cloud:
    """The cloud with the normals of the fitted body at all contacts.

    The search for the normal at a tip contact starts from the known normal of the nearest contact.
    """
    known = np.flatnonzero(np.isfinite(cloud.normals[:, 0]))
    near = known[cKDTree(cloud.points[known]).query(cloud.points)[1]]
    normals = fitted.normals(cloud.points, cloud.normals[near])
    source = np.full(len(cloud), NormalSource.FIT, dtype=np.int8)
    return replace(cloud, normals=normals, normal_source=source, fit=fitted, fit_error=error * mean_radius(fitted))
