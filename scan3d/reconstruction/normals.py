"""Normals of the surface at the contacts.

The surface's normal at a contact is ``(n(θ), -∂h/∂z)``, normalised, with h the support function of the slices at fixed
normal angle θ: not the slice's own normal.  h is concave in z, so the secants to the slices below and above bound its slope
with certainty.  Of a body that proves smooth, normals come from the support function fitted to all contacts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from scan3d.arrays import Array
from scan3d.cloud import Cloud, NormalSource
from scan3d.geometry.support import SupportFit, fit_support
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.slices import SliceStack, stacks
from scan3d.recording import Recording

# Degrees of the harmonic series that are tried, until contacts left out are met no better.
DEGREES = (8, 16)
# One contact in so many, or fewer, is left out of a trial.
_HELD_OUT = 10
# Contacts left out at most.
_MOST_HELD_OUT = 1000
# A further degree must lower the error at least so much to be worth it.
_WORTH = 0.8
# The body is smooth if the fit meets 95 % of the contacts left out this closely, in mean radii: a cube, a cylinder or a lens
# stay above 3e-3, ellipsoids, eggs and pebbles of 10,000 facets below 2e-4.
SMOOTH = 5e-4


def reconstruct(recording: Recording, method: str = "closed-form") -> Cloud:
    """Contacts of a recording, simulated or measured, with the normals of the surface where they can be known.

    `method` is that of `planar.reconstruct`.  A normal in its slice's plane comes from (14); out of it, from the slices
    below and above; of a body that proves smooth, from the support function fitted to all contacts.
    Raises InputError if the recording has no contact.
    """
    cloud = with_slice_normals(contacts(recording, method))
    found = smooth_fit(cloud)
    return cloud if found is None else _with_fit(cloud, *found)


def smooth_fit(cloud: Cloud) -> tuple[SupportFit, float] | None:
    """The support function of a smooth body and its error at contacts left out, in mean radii; None for other bodies."""
    rows = np.flatnonzero(np.isfinite(cloud.normals[:, 0]))
    if len(rows) < 10 * (DEGREES[0] + 1) ** 2:
        return None
    held = rows[:: max(_HELD_OUT, len(rows) // _MOST_HELD_OUT)]
    used = np.setdiff1d(rows, held)
    best: tuple[SupportFit, float] | None = None
    for degree in DEGREES:
        if len(used) < 4 * (degree + 1) ** 2:
            break
        fitted = fit_support(cloud.points[used], cloud.normals[used], degree)
        error = _error(fitted, cloud, held)
        if best is not None and not error < _WORTH * best[1]:
            break
        best = fitted, error
    noise = 2 * cloud.noise / _mean_radius(best[0]) if best else 0.0
    return best if best is not None and best[1] <= SMOOTH + noise else None


def _error(fitted: SupportFit, cloud: Cloud, rows: NDArray[np.intp]) -> float:
    """95 % of the contacts lie closer than this to the fitted body, in mean radii."""
    points = cloud.points[rows]
    normals = fitted.normals(points, cloud.normals[rows])
    off = np.abs(((points - fitted.points(normals)) * normals).sum(axis=1))
    return float(np.percentile(off, 95)) / _mean_radius(fitted)


def _mean_radius(fitted: SupportFit) -> float:
    return float(np.linalg.det(fitted.shape)) ** (1 / 3)


def with_slice_normals(cloud: Cloud) -> Cloud:
    """The cloud with the normals that follow from each slice and its neighbours, in place of those it had."""
    normals, source = np.full_like(cloud.normals, np.nan), np.full_like(cloud.normal_source, NormalSource.UNKNOWN)
    for stack in stacks(cloud):
        for slice_, slopes in zip(stack.slices, height_slopes(stack), strict=True):
            for part, in_plane, slope, origin in (
                (slice_.tangential, slice_.normals, slopes.tangential, NormalSource.SLICES),
                (slice_.tip, slice_.tip_normals, slopes.tip, NormalSource.FRICTION),
            ):
                rows = slice_.rows[part]
                leaning = np.column_stack([in_plane, -slope]) @ stack.frame
                leaning /= np.linalg.norm(leaning, axis=1, keepdims=True)
                known = np.isfinite(leaning[:, 0])
                normals[rows[known]] = leaning[known]
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

    ``(h - <c, n>)²``, with c(z) the Steiner point, is nearly a parabola in z, poles included (it is one for ellipsoids); its
    cubic spline gives the slope, which is then held between the secants that concavity prescribes.
    """
    z = stack.heights
    usable = np.array([slice_.closed for slice_ in stack.slices])
    slopes = [
        HeightSlopes(np.full(len(slice_.tangential), np.nan), np.full(len(slice_.tip), np.nan))
        for slice_ in stack.slices
    ]
    known = np.flatnonzero(usable)
    if len(known) < 2:
        return slopes
    centers = np.array([stack.slices[i].steiner_point() for i in known])
    center_slope = _spline(z[known], centers)(z[known], 1)
    for k, i in enumerate(known):
        slice_ = stack.slices[i]
        normals = np.concatenate([slice_.normals, slice_.tip_normals])
        angle = np.arctan2(normals[:, 1], normals[:, 0])
        h = np.stack([stack.slices[j].support(angle) for j in known])
        below = (h[k] - h[k - 1]) / (z[i] - z[known[k - 1]]) if k else np.full(len(angle), np.inf)
        above = (h[k + 1] - h[k]) / (z[known[k + 1]] - z[i]) if k + 1 < len(known) else np.full(len(angle), -np.inf)
        reach = h - centers @ normals.T
        squared_slope = _spline(z[known], reach**2)(z[i], 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = normals @ center_slope[k] + squared_slope / (2 * reach[k])
        slope = np.where(np.isfinite(slope), slope, np.where(np.isfinite(above), above, below))
        slope = np.clip(slope, np.minimum(above, below), np.maximum(above, below))
        slopes[i] = HeightSlopes(slope[: len(slice_.tangential)], slope[len(slice_.tangential) :])
    return slopes


def _spline(z: Array, values: Array) -> CubicSpline:
    return CubicSpline(z, values, bc_type="not-a-knot" if len(z) > 3 else "natural")


def _with_fit(cloud: Cloud, fitted: SupportFit, error: float) -> Cloud:
    """Normals of the fitted body, at tip contacts as well: from those of the contacts nearest to them."""
    known = np.flatnonzero(np.isfinite(cloud.normals[:, 0]))
    near = known[cKDTree(cloud.points[known]).query(cloud.points)[1]]
    normals = fitted.normals(cloud.points, cloud.normals[near])
    source = np.full(len(cloud), NormalSource.FIT, dtype=np.int8)
    return replace(cloud, normals=normals, normal_source=source, fit=fitted, fit_error=error * _mean_radius(fitted))
