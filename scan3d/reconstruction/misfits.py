"""How far contacts are from those of a convex body, and six reactions from those of a single force.

These misfits need no true body, and vanish for a right recording.  Whether a recording agrees with the model (`agreement`), and
which fault explains that it does not (`diagnosis`), is told by them alone.  Each comes with what errors explain of it:

- in the plane, how far contacts of a slice lie beyond the tangent at one of them;
- in space, the two residuals of six reactions (S4), which vanish for a single force at the rod's centre line: the moment about
  the rod, up to friction across a rod of finite radius, and the moment along the force;
- in space, how deep contacts, and the rod's tangents at contacts, lie in the hull of all contacts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scan3d.arrays import AT_ONCE, Array, Index
from scan3d.geometry.hulls import hull_about_mean
from scan3d.spatial import inverse

ROUNDING = 1e-7
"""Rounding of a contact's place, in rod lengths, with the steps of fine converters that too few numbers show, and of the
residuals of a wrench.  Most faults are a hundred times larger."""
DISTURBED = 0.02
"""Largest fraction of the rows with a force that may contradict the others, as disturbed rows of a measurement."""


class Misfit(NamedTuple):
    """A misfit and what noise and rounding explain of it, arrays of one shape."""

    found: Array
    explained: Array

    def worst(self) -> tuple[float, float]:
        """The misfit, and what explains it, where their ratio is largest."""
        i = np.unravel_index(np.argmax(self.found / self.explained), self.found.shape)
        return float(self.found[i]), float(self.explained[i])


class Errors(NamedTuple):
    """Errors of contacts (n,) in a slice's plane, and how many standard deviations of them count as explained."""

    sigmas: float
    covariance: Array
    """(n, 2, 2) of the places."""
    turn_sd: Array
    """(n,) of the tangents' angles, in radians."""


def beyond_tangents(
    points: Array, lines: Index, normals: Array, some: Index, error: Errors | None, length: float
) -> Misfit:
    """How far (k, m) `some` contacts of a slice lie beyond the tangents at others.

    points, lines, normals
        (n, 2) contacts in the slice's plane; (k,) the numbers of those with tangents, and (k, 2) the outward normals there.
    error
        that of the contacts; None for exact ones.
    length
        the rod's, in the unit of the points.
    """
    beyond = normals @ points[some].T - (normals * points[lines]).sum(axis=1)[:, None]
    explained = np.full(beyond.shape, ROUNDING * length)
    if error is not None:
        reach = error.sigmas * np.sqrt(np.trace(error.covariance, axis1=1, axis2=2))
        pairs = reach[lines][:, None] + reach[some]
        others, own, turned = deviations(points, lines, normals, some, error)
        # the last summands are of the second order
        explained += error.sigmas * (others + own + turned + error.turn_sd[lines][:, None] * pairs) + pairs**2 / length
    return Misfit(beyond, explained)


def deviations(points: Array, lines: Index, normals: Array, some: Index, error: Errors) -> tuple[Array, Array, Array]:
    """Standard deviations of the distances of `beyond_tangents`: by the places of the contacts (k, m), by those of the lines
    (k, 1), and by the lines' angles (k, m)."""
    tangents = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    along = tangents @ points[some].T - (tangents * points[lines]).sum(axis=1)[:, None]
    quadratic = np.stack([normals[:, 0] ** 2, 2 * normals[:, 0] * normals[:, 1], normals[:, 1] ** 2], axis=1)
    entries = np.stack([error.covariance[:, 0, 0], error.covariance[:, 0, 1], error.covariance[:, 1, 1]], axis=1)
    others = np.sqrt(np.maximum(quadratic @ entries[some].T, 0.0))
    own = np.sqrt(np.maximum((quadratic * entries[lines]).sum(axis=1), 0.0))[:, None]
    return others, own, error.turn_sd[lines][:, None] * np.abs(along)


def against_single_force(
    force: Array,
    moment: Array,
    found: inverse.SpatialContacts,
    noise: tuple[float, float],
    sigmas: float,
    radius: float,
) -> tuple[Misfit, Misfit]:
    """The moment about the rod and that along the force (n,), both over the clamping moment, of reactions (n, 3) as `found`.

    All is dimensionless; `radius` is the rod's, at which friction across it acts.
    """
    f, m = np.linalg.norm(force, axis=1), np.hypot(moment[:, 0], moment[:, 2])
    sigma_f, sigma_m = noise
    with np.errstate(divide="ignore", invalid="ignore"):
        rounding = ROUNDING * (1 + f / m)
        about_rod = Misfit(np.abs(found.torsion) / m, sigmas * sigma_m / m + radius * f / m + rounding)
        along_force = Misfit(np.abs(found.skew) / (f * m), sigmas * np.hypot(sigma_m / m, sigma_f / f) + rounding)
    return about_rod, along_force


def depths_in_hull(
    points: Array,
    of_hull: Index,
    some: Index,
    lines: Index,
    tangents: Array,
    errors: tuple[Array, Array],
    length: float,
    covariance: Array | None = None,
) -> Misfit | None:
    """Depths (m + k,) of `some` contacts, and of the tangents at others, in the hull of contacts; None if that is no body.

    points, of_hull, tangents
        (n, 3) contacts at the rod's centre line, those (h,) of which the hull is made, and the rod's tangents (n, 3).
    errors
        (n,) largest errors of the places and of the tangents, in radians.
    length
        the rod's, in the unit of the points.
    covariance
        (n, 3, 3) squares of further errors of the places, which most noise leaves along the rod, where they change no depth.
    """
    place, turn = errors
    squares = np.zeros((len(points), 3, 3)) if covariance is None else covariance
    largest = place + np.sqrt(np.trace(squares, axis1=1, axis2=2))
    hull = hull_about_mean(points[of_hull])
    if hull is None:
        return None
    centred, corners, outward = points - points[of_hull].mean(axis=0), of_hull[hull.simplices], hull.equations[:, :3]
    across = np.sqrt(np.maximum(np.einsum("fi,fkij,fj->fk", outward, squares[corners], outward), 0.0))
    reach, farthest = (place[corners] + across).max(axis=1), largest[corners].max(axis=1)
    parts = []
    for rows, is_line in ((some, False), (lines, True)):
        for part in np.array_split(rows, 1 + len(rows) * len(hull.equations) // AT_ONCE):
            below = -centred[part] @ outward.T - hull.equations[:, 3]
            arm = np.zeros(len(part))
            if is_line:
                slope = tangents[part] @ outward.T
                arm = _middle_of_lines(below, slope)
                below -= arm[:, None] * slope
            facet = below.argmin(axis=1)
            n = outward[facet]
            own = place[part] + np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", n, squares[part], n), 0.0))
            deep, curved = below[np.arange(len(part)), facet], largest[part] + farthest[facet]
            parts.append(np.stack([deep, own + reach[facet], turn[part] * np.abs(arm), curved]))
    found, both, turned, curved = np.concatenate(parts, axis=1)
    # the last summand is of the second order
    return Misfit(found, ROUNDING * length + both + turned + curved**2 / length)


def _middle_of_lines(height: Array, slope: Array) -> Array:
    """(n,) places along lines, in the middle of their part within a hull, or where they are nearest to it.

    `height` (n, f) are the depths of their points below the hull's facets, `slope` (n, f) how fast they fall along the lines.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = height / slope
        first = np.where(slope < 0, crossing, -np.inf).max(axis=1)
        last = np.where(slope > 0, crossing, np.inf).min(axis=1)
        arm = (first + last) / 2
    return np.where(np.isfinite(arm), arm, 0.0)
