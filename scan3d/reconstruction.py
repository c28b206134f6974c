"""Step 2 over a recording: contacts with the normals of the surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from scan3d.cloud import Cloud, NormalSource, contacts
from scan3d.layers import height_slopes, stacks
from scan3d.recording import Recording
from scan3d.support import SupportFit, fit_support

Array = NDArray[np.float64]

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
        for layer, slopes in zip(stack.layers, height_slopes(stack), strict=True):
            for part, in_plane, slope, told in (
                (layer.lying, layer.normals, slopes[0], NormalSource.SLICES),
                (layer.tips, layer.tip_normals, slopes[1], NormalSource.FRICTION),
            ):
                rows = layer.rows[part]
                leaning = np.column_stack([in_plane, -slope]) @ stack.frame
                leaning /= np.linalg.norm(leaning, axis=1, keepdims=True)
                known = np.isfinite(leaning[:, 0])
                normals[rows[known]] = leaning[known]
                source[rows[known]] = told
    return replace(cloud, normals=normals, normal_source=source)


def _with_fit(cloud: Cloud, fitted: SupportFit, error: float) -> Cloud:
    """Normals of the fitted body, at tip contacts as well: from those of the contacts nearest to them."""
    known = np.flatnonzero(np.isfinite(cloud.normals[:, 0]))
    near = known[cKDTree(cloud.points[known]).query(cloud.points)[1]]
    normals = fitted.normals(cloud.points, cloud.normals[near])
    source = np.full(len(cloud), NormalSource.FIT, dtype=np.int8)
    return replace(cloud, normals=normals, normal_source=source, fit=fitted, fit_error=error * _mean_radius(fitted))
