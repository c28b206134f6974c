"""What contacts say of a body that contains them: arcs of supporting planes, and how far errors move these outwards.

A contact p with the rod's tangent t is an arc of supporting planes (`scan3d.geometry.arcs`).  All bounds are made of such arcs:
contacts in slices use one end of them on either side of their slice, contacts anywhere the places where three of them meet.
What noise, digits and the rig's calibration leave uncertain moves the planes outwards.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.special import chdtri

import planar
from scan3d.arrays import Array, Index, Mask
from scan3d.cloud import Cloud
from scan3d.geometry import hulls
from scan3d.geometry.arcs import Arcs, arcs_at
from scan3d.geometry.hulls import edges_of
from scan3d.geometry.support import inertia
from scan3d.geometry.vectors import across, unit

CONFIDENCE = 0.95
"""Probability with which the bounds hold under noise."""
AVERAGED = (2, 4, 16, 64)
"""Successive rows of a sweep that are averaged: larger averages have smaller errors, smaller ones follow sharp curves."""
# Part of the probability of failure that the calibration has where there is noise as well; its factor hardly depends on it.
_SHARE = 0.2
EXACT = 2e-9
"""Error of an exact contact's place, in rod lengths, and of its tangent, in radians: what solvers and their input leave."""
# Radius of the ball within which tangents' errors are allowed for, in sizes of the contacts beyond the contacts themselves.
_BALL = 1.0


def exact_error(cloud: Cloud) -> float:
    """Largest error of the places of exact contacts, in the cloud's unit."""
    return EXACT * cloud.rod_length + cloud.pose_error


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
    factor = rig.factor(_SHARE * alpha if noisy else alpha)
    kappa = sigmas(len(cloud), 1 - (1 - _SHARE) * alpha) if noisy else None
    columns = rig.place_sd, rig.turn_sd, rig.across_sd, rig.tilt_sd
    place, turn, across, tilt = (factor * column for column in columns)
    height = factor * float(rig.height_sd.max(initial=0.0))
    return Allowed(kappa, factor, confidence, place, turn, across, tilt, height)


class Tangents(NamedTuple):
    """Supporting planes through the rod's tangents, in a frame in which the contacts are spread like those of a ball."""

    arcs: Arcs
    """(k,) of the contacts, and then that of the table, if there is one."""
    rows: Index
    """(k,) the contacts."""
    centre: Array
    """(3,) origin of the frame."""
    shape: Array
    """(3, 3) symmetric map from the frame to the world."""
    ball: float
    """Radius in the frame of the ball within which the planes hold, infinite for exact tangents."""

    def to_world(self, points: Array) -> Array:
        """Points (n, 3) of the frame in the world."""
        return points @ self.shape + self.centre

    def exclude(self, points: Array) -> Mask:
        """Whether points (n, 3) of the world lie beyond one of the planes, whichever normal of its arc that has."""
        depths = self.arcs.depths((points - self.centre) @ np.linalg.inv(self.shape))
        excluded: Mask = np.asarray((depths > 0).any(axis=1))
        return excluded

    def normals(self) -> tuple[Array, Array]:
        """Middle normals (k, 3) of the contacts in the world, and the largest angle (k,) of the true ones from them."""
        inverse = np.linalg.inv(self.shape)
        arcs = self.arcs.select(np.arange(len(self.rows)))
        middle = unit(arcs.middle @ inverse)
        cosines = (unit(arcs.ends() @ inverse) * middle[:, None]).sum(axis=2)
        return middle, np.arccos(np.clip(cosines, -1.0, 1.0)).max(axis=1)


def tangent_planes(cloud: Cloud, errors: Array, turns: Array) -> Tangents:
    """The supporting planes of a cloud with errors (n,) of its places, and of its tangents in radians.

    Raises InputError for contacts that span no body.
    """
    assert cloud.centre_points is not None
    assert cloud.tangents is not None
    try:
        centre, shape = inertia(cloud.centre_points)
    except QhullError:
        hulls.hull(cloud.centre_points)  # raises InputError, which says why
        raise
    to_frame = np.linalg.inv(shape)
    points, tangents = (cloud.centre_points - centre) @ to_frame, unit(cloud.tangents @ to_frame)
    rows = np.flatnonzero(np.isfinite(tangents).all(axis=1) & (cloud.phase == planar.Phase.TANGENTIAL))
    # the map stretches errors by no more than its largest factor, and angles by no more than its condition
    stretched = errors * float(np.linalg.norm(to_frame, 2))
    turns = turns[rows] * float(np.linalg.cond(shape))
    try:
        hull = ConvexHull(points)
    except QhullError:
        hull = ConvexHull(points, qhull_options="QJ")  # moved by rounding where very many lie in one plane
    vertices, edges = edges_of(hull)
    arcs = arcs_at(points[rows], tangents[rows], stretched[rows], turns, points[vertices], stretched[vertices], edges)
    move, ball = stretched[rows], np.inf
    if turns.any():
        size = float(np.linalg.norm(points, axis=1).max())
        ball = (1 + _BALL) * size
        move = move + turns * (ball + size)
    arcs = arcs.moved(move)
    if cloud.table is not None:
        arcs = arcs.joined(_table_plane(cloud.table - cloud.rod_radius, centre, shape))
    return Tangents(arcs, rows, centre, shape, ball)


def _table_plane(height: float, centre: Array, shape: Array) -> Arcs:
    """The plane at a height, below which nothing of the body lies, in the frame of `Tangents`."""
    point = np.linalg.solve(shape, [0.0, 0.0, height - centre[2]])
    normal = unit(shape @ [0.0, 0.0, -1.0])
    return Arcs(point[None], normal[None], across(normal[None])[0], np.zeros(1))
