"""Normals of contacts in space from the smooth body fitted to all of them, if the body proves smooth.

The fit needs no normals that are known: it starts from those of the hull of the contacts, lets them follow the fitted body, and
repeats that until its error at held-out contacts falls no further.  The fit does not use that the normals of tangential
contacts are perpendicular to the rod, so that deviations from it show the error of its normals.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

import planar
from scan3d.arrays import Array, Mask
from scan3d.cloud import Cloud, NormalSource
from scan3d.geometry.support import MAX_CONTACTS, SupportFit, fit_support
from scan3d.reconstruction.normals import (
    CONTACTS_PER_COEFFICIENT,
    CONTACTS_TO_TRY,
    DEGREE_GAIN,
    DEGREES,
    held_out_error,
    held_out_rows,
    is_smooth,
    mean_radius,
)
from scan3d.spatial.normals import angles

# Normals that start the fit of a smooth body are known to at least this, in radians.  Larger, wrong ones lead the fit astray;
# smaller, more of them come from the hull of the contacts.
_START = 0.03
# The fit is repeated from its own normals at most this many times, while its error falls to this fraction.  Larger numbers take
# longer; with fewer repetitions the rough normals of the start show in the fit.
_REFITS, _GAIN = 6, 0.7
# Errors of a fit, in mean radii: that of rounding, that which no higher degree need improve, and that above which a body has
# edges whatever the degree.
_ROUNDING, _SMALL, _HOPELESS = 1e-11, 1e-6, 2e-2
# Largest number of contacts of exact data used for a fit.  More take longer; fewer come close to the number of coefficients.
_EXACT_CONTACTS = 2000
# Tangential contacts around a contact that show the error of fitted normals.
_NEIGHBOURS = 12
# A fit is that of the body from outside if the contact forces act outwards in at least this fraction of the contacts.
_OUTWARD = 0.99
EXACT = 1e-9
"""Standard deviation, in radians, of the normals of exact data: rounding."""


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
    if np.mean((normals * direction).sum(axis=1) > 0) < _OUTWARD:
        return cloud
    sd = _fitted_sd(cloud, normals, fitted.degree * error)
    source = np.full(len(cloud), NormalSource.FIT, dtype=np.int8)
    fit_error = error * mean_radius(fitted)
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
        fit_error=fit_error,
    )


def _smooth_body(cloud: Cloud, normals: Array) -> tuple[SupportFit, float, Array] | None:
    """The support function of a smooth body, its error at held-out contacts in mean radii, and the normals (n, 3)."""
    rows = np.arange(len(cloud))
    if len(rows) < CONTACTS_TO_TRY * (DEGREES[0] + 1) ** 2:
        return None
    held_out = held_out_rows(rows)
    used = np.setdiff1d(rows, held_out)
    used = used[:: max(1, -(-len(used) // (MAX_CONTACTS if cloud.noise else _EXACT_CONTACTS)))]
    used_part, held_out_part = (
        _Part(cloud.points[part], normals[part], cloud.select(part).sd_along(normals[part]))
        for part in (used, held_out)
    )
    parts = used_part, held_out_part
    best: tuple[SupportFit, float, tuple[_Part, _Part]] | None = None
    for degree in DEGREES:
        if len(used) < CONTACTS_PER_COEFFICIENT * (degree + 1) ** 2:
            break
        fit = _converged(*(parts if best is None else best[2]), degree)
        if best is not None and not fit[1] < DEGREE_GAIN * best[1]:
            break
        best = fit
        # a higher degree would follow the noise
        small = max(_SMALL, cloud.noise / mean_radius(best[0]))
        if not small < best[1] < _HOPELESS:
            break
    if best is None or not is_smooth(best[0], best[1], cloud.noise):
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
    for _ in range(1 + _REFITS):
        fitted = fit_support(used.points, used.normals, degree, used.sd)
        used, held_out = used.followed(fitted), held_out.followed(fitted)
        error = held_out_error(fitted, held_out.points, held_out.normals)
        falling = best is None or error < _GAIN * best[1]
        if best is None or error < best[1]:
            best = fitted, error, (used, held_out)
        if not falling or not _ROUNDING < error < _HOPELESS:
            break
    assert best is not None
    return best


def _fitted_sd(cloud: Cloud, normals: Array, turn: float) -> Array:
    """Standard deviation (n,) of the angle of fitted normals (n, 3).

    In tangential contact the normal is perpendicular to the rod: deviations from that, at the nearest such contacts, show one
    of the two components of the error.  `turn` is the smallest that is believed: a function of some degree turns by its degree
    times its error.
    """
    sd = np.full(len(cloud), np.hypot(turn, EXACT))
    tangential = np.flatnonzero(cloud.phase == planar.Phase.TANGENTIAL)
    if len(tangential) < _NEIGHBOURS or cloud.tangents is None:
        return sd
    square = (normals[tangential] * cloud.tangents[tangential]).sum(axis=1) ** 2
    near = cKDTree(cloud.points[tangential]).query(cloud.points, _NEIGHBOURS)[1]
    return np.asarray(np.sqrt(sd**2 + 2 * square[near].mean(axis=1)))


def _start(cloud: Cloud) -> Array | None:
    """Rough normals (n, 3) of all contacts: those that are known well, else those of the hull; None if there is no hull."""
    assert cloud.normal_sd is not None
    try:
        hull = ConvexHull(cloud.points - cloud.points.mean(axis=0))
    except (QhullError, ValueError):
        return None
    corners = hull.points[hull.simplices]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    normals = np.zeros_like(cloud.points)
    for k in range(3):
        np.add.at(normals, hull.simplices[:, k], area[:, None] * hull.equations[:, :3])
    known = np.isfinite(cloud.normals[:, 0]) & (cloud.normal_sd < _START)
    normals[known] = cloud.normals[known]
    length = np.linalg.norm(normals, axis=1)
    placed = np.flatnonzero(length > 0)
    normals[placed] /= length[placed, None]
    return np.asarray(normals[placed[cKDTree(cloud.points[placed]).query(cloud.points)[1]]])
