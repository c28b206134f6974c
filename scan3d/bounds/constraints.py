"""What contacts say of a body that contains them: supporting planes, and how far errors move these outwards.

A contact p with the rod's tangent t is an arc of supporting planes (`scan3d.geometry.arcs`), whose normals n lie between two
ends.  Contacts in slices use one end on either side of their slice; those of contacts anywhere bound the body together
(`scan3d.bounds.planes`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.special import chdtri

import planar
from scan3d.arrays import (
    ROUNDING,
    Array,
    Index,
    Mask,
    ratio,
)
from scan3d.cloud import Cloud
from scan3d.geometry.arcs import Arcs, Places, arcs_at
from scan3d.geometry.hulls import edges_of
from scan3d.reconstruction.slices import Slice, SliceStack

CONFIDENCE = 0.95
"""Probability with which the bounds hold under noise."""
AVERAGED = (2, 4, 16, 64)
"""Successive rows of a sweep that are averaged: larger averages have smaller errors, smaller ones follow sharp curves."""
EXACT = 2e-9
"""Error of an exact contact's place, in rod lengths, and of its tangent, in radians: what solvers and their input leave."""
STRAIGHT = 0.03
"""Slopes behind a slab are equal if they differ by less than this fraction of their difference to the slab's."""


def exact_error(cloud: Cloud) -> float:
    """Largest error of the places of exact contacts, in the cloud's unit."""
    return EXACT * cloud.rod_length + cloud.pose_error + cloud.lever


def sigmas(count: int, confidence: float = CONFIDENCE) -> float:
    """The number of standard deviations κ within which all linear functions of the errors of `count` contacts stay.

    Averages are counted as well, two for every run of rows, once for the inner and once for the outer polygon.
    """
    events = max(count, 1) * (1 + 4 * sum(1 / size for size in AVERAGED))
    return float(np.sqrt(chdtri(3, (1 - confidence) / events)))


class Allowed(NamedTuple):
    """What bounds of a stated confidence allow for: the probability that they fail is shared by noise and calibration."""

    kappa: float | None
    """Standard deviations of each contact by the noise, as `sigmas`; None for exact reactions."""
    factor: float
    """Standard deviations of all contacts by the calibration (`scan3d.rigs.RigErrors.factor`); 0 without one."""
    confidence: float
    """That of the bounds: 1 where there is neither noise nor calibration."""
    place: Array | float
    """(n,) the largest errors of the places by the calibration; 0 without one."""
    turn: Array | float
    """(n,) those of the tangents, in radians."""
    across: Array | float
    """(n,) those of the places across the rod, in the planes of the slices."""
    tilt: Array | float
    """(n,) those of the tangents' angles there, in radians."""
    height: float
    """The largest error of the height of a contact or a line."""

    @property
    def largest(self) -> float:
        """The largest error of a contact's place by the calibration."""
        return float(np.max(self.place, initial=0.0))


def allowed(cloud: Cloud, confidence: float = CONFIDENCE) -> Allowed:
    """What bounds of a cloud's body have to allow for in order to hold with a confidence."""
    noisy, rig = cloud.covariance is not None or cloud.place_sd is not None, cloud.calibration
    if rig is None or not rig.count:
        kappa = sigmas(len(cloud), confidence) if noisy else None
        return Allowed(kappa, 0.0, confidence if noisy else 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    alpha = 1 - confidence
    # of the probability of failure noise has the larger part, because the calibration's factor hardly depends on its own
    factor = rig.factor(0.2 * alpha if noisy else alpha)
    kappa = sigmas(len(cloud), 1 - 0.8 * alpha) if noisy else None
    columns = rig.place_sd, rig.turn_sd, rig.across_sd, rig.tilt_sd
    place, turn, across, tilt = (factor * column for column in columns)
    height = factor * float(rig.height_sd.max(initial=0.0))
    return Allowed(kappa, factor, confidence, place, turn, across, tilt, height)


def tangential(cloud: Cloud) -> Index:
    """The contacts of a cloud whose tangents lie in supporting planes."""
    known = np.isfinite(cloud.tangents).all(axis=1)  # type: ignore[arg-type]
    return np.flatnonzero(known & (cloud.phase == planar.Phase.TANGENTIAL))


def arcs_of_contacts(places: Places, tangents: Array, rows: Index, turns: Array) -> Arcs:
    """The arcs (k,) of some of the contacts, with errors (k,) of their tangents (n, 3), by all of them."""
    try:
        hull = ConvexHull(places.points)
    except QhullError:
        hull = ConvexHull(places.points, qhull_options="QJ")  # moved by rounding where very many lie in one plane
    vertices, edges = edges_of(hull)
    return arcs_at(places.select(rows), tangents[rows], turns, places.select(vertices), edges)


class HalfSpaces(NamedTuple):
    """Half-spaces (k,) of the world behind which the body lies on one side of a slice, by the slice's contacts."""

    planes: Array
    """(k, 4) a, unit vectors, and b of ``a·x + b <= 0``."""
    straight: Mask
    """(k,) whether the body goes on straight on the slice's other side."""


def by_secants(stack: SliceStack, i: int, side: int, margin: float) -> HalfSpaces:
    """The half-spaces of slice i that hold below it (`side` 0) or above it (1), by secants from the slices on its other side.

    There are none where the errors of heights and places, which are at most `margin`, leave the slopes unknown.
    """
    slice_, below, above = stack.slices[i], stack.slices[:i][::-1], stack.slices[i + 1 :]
    behind, ahead = (below, above) if side else (above, below)
    anchors = _anchors(stack, behind, slice_)
    if not anchors or not len(slice_.angle):
        return HalfSpaces(np.empty((0, 4)), np.empty(0, dtype=bool))
    normals = np.stack([np.cos(slice_.angle), np.sin(slice_.angle)], axis=1)
    slope = secants(slice_.value, slice_.height, anchors, normals, margin, stack.height_error)
    move = np.full(len(slope), margin)
    if stack.height_error:
        steepest = np.abs(slope)
        if beyond := _anchors(stack, ahead, slice_):
            from_ahead = secants(slice_.value, slice_.height, beyond, normals, margin, stack.height_error)
            steepest = np.maximum(steepest, np.abs(from_ahead))
        move += stack.height_error * steepest
    planes = _inclined(normals @ stack.frame[:2], stack.frame[2], slope, slice_.value, slice_.height, move)
    straight = _goes_on_straight(slice_, behind, ahead, normals)
    finite: Mask = np.asarray(np.isfinite(planes).all(axis=1))
    return HalfSpaces(planes[finite], straight[finite])


def _anchors(stack: SliceStack, others: tuple[Slice, ...], slice_: Slice) -> tuple[Slice, ...]:
    """Those of the slices on one side of a slice, from the nearest, that secants are taken from.

    If everything is exact, by concavity the nearest has the tightest.
    """
    if not (stack.confident or stack.height_error):
        return others[:1]
    # at twice the error the slope of the secant between two slices is infinite
    return tuple(b for b in others if abs(b.height - slice_.height) > 4.0 * stack.height_error)


def secants(
    value: Array, height: float, others: tuple[Slice, ...], normals: Array, margin: float, height_error: float
) -> Array:
    """The tightest slopes (k,) of secants from support lines at a height to other slices on one side of it.

    The lines have the unit normals (k, 2) and the values (k,).  Those to slices below bound the slope from above, those to
    slices above from below; they are infinite where the errors of heights and places leave the slope unknown.
    """
    rise = np.array([value + margin - (b.support_of_contacts(normals) - margin) for b in others])
    outwards = 1.0 if height > others[0].height else -1.0
    run = np.array([[height - b.height] for b in others]) - 2 * outwards * height_error * np.sign(rise)
    slopes = np.where(outwards * run > 0, ratio(rise, run), outwards * np.inf)
    return outwards * (outwards * slopes).min(axis=0)


def _inclined(outward: Array, along: Array, slope: Array, value: Array, height: Array | float, move: Array) -> Array:
    """The half-spaces (k, 4) ``<w, x> <= value + move + slope (<a, x> - height)`` with the normals w and the axis a."""
    with np.errstate(invalid="ignore"):
        normals = outward - slope[:, None] * along
        planes = np.column_stack([normals, slope * height - (value + move)])
        return np.asarray(planes / np.linalg.norm(normals, axis=1)[:, None])


def _goes_on_straight(slice_: Slice, behind: tuple[Slice, ...], ahead: tuple[Slice, ...], normals: Array) -> Mask:
    """Whether the body goes on straight behind a slice, at the slice's normals (k, 2).

    The slices behind it and ahead of it begin with the nearest.  Where none is ahead, as in a cap, slopes may differ by
    rounding only.
    """
    if len(behind) < 2:
        return np.zeros(len(normals), dtype=bool)
    nearest, next_ = behind[:2]
    beyond = ahead[0] if ahead else nearest
    h, h1, h2, h3 = (one.support_of_contacts(normals) for one in (slice_, nearest, next_, beyond))
    near, far = (h1 - h) / (nearest.height - slice_.height), (h2 - h1) / (next_.height - nearest.height)
    across = (h3 - h) / (beyond.height - slice_.height)
    closest = min(abs(slice_.height - nearest.height), abs(nearest.height - next_.height))
    rounding = ROUNDING * np.abs(slice_.value).max() / closest
    return np.abs(near - far) <= STRAIGHT * np.abs(near - across) + rounding
