"""Supporting planes of a body through the rod's tangents at contacts anywhere, with the errors of places and tangents (S27).

They are those of `scan3d.geometry.normal_intervals`, in a frame in which the contacts are spread like those of a ball.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

import planar
from scan3d.arrays import Array, Index
from scan3d.cloud import Cloud
from scan3d.geometry.apexes import SupportingPlanes, support_bounds
from scan3d.geometry.normal_intervals import edges_of, normal_intervals
from scan3d.geometry.support import inertia
from scan3d.geometry.vectors import across, unit
from scan3d.surfaces.tangent_planes import Apexes

# Radius of the ball within which tangents' errors are allowed for, in sizes of the contacts.  Larger, the planes are moved
# farther out; smaller, apexes of sparse contacts lie outside.
_BALL = 1.0


class TangentPlanes(NamedTuple):
    """Supporting planes in a frame in which the contacts are spread like those of a ball."""

    planes: SupportingPlanes
    """(k,) through the tangents, and then that of the table, if there is one."""
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

    def support_bounds(self, apexes: Apexes) -> tuple[Array, Array]:
        """Directions (d, 3) in the world, and upper bounds (d,) of the support function there."""
        directions, values = support_bounds(self.planes, apexes.cover)
        directions = directions @ np.linalg.inv(self.shape)
        length = np.linalg.norm(directions, axis=1)
        return directions / length[:, None], (directions @ self.centre + values) / length

    def normals(self) -> tuple[Array, Array]:
        """Middle normals (k, 3) of the contacts in the world, and the largest angle (k,) of the true ones from them."""
        inverse = np.linalg.inv(self.shape)
        planes = self.planes.select(np.arange(len(self.rows)))
        middle = unit(planes.middle @ inverse)
        cosines = (unit(planes.ends() @ inverse) * middle[:, None]).sum(axis=2)
        return middle, np.arccos(np.clip(cosines, -1.0, 1.0)).max(axis=1)


def tangent_planes(cloud: Cloud, errors: Array, turns: Array) -> TangentPlanes:
    """The supporting planes of a cloud with errors (n,) of its places, and of its tangents in radians."""
    assert cloud.centre_points is not None
    assert cloud.tangents is not None
    centre, shape = inertia(cloud.centre_points)
    to_frame = np.linalg.inv(shape)
    points, tangents = (cloud.centre_points - centre) @ to_frame, unit(cloud.tangents @ to_frame)
    rows = np.flatnonzero(np.isfinite(tangents).all(axis=1) & (cloud.phase == planar.Phase.TANGENTIAL))
    # the map stretches errors by no more than its largest factor, and angles by no more than its condition
    stretched = errors * float(np.linalg.norm(to_frame, 2))
    turns = turns[rows] * float(np.linalg.cond(shape))
    vertices, edges = edges_of(_hull(points))
    intervals = normal_intervals(
        points[rows], tangents[rows], stretched[rows], turns, points[vertices], stretched[vertices], edges
    )
    moved, ball = stretched[rows], np.inf
    if turns.any():
        size = float(np.linalg.norm(points, axis=1).max())
        ball = (1 + _BALL) * size
        moved = moved + turns * (ball + size)
    # planes through these points bound the body whichever normal of its interval each of them has
    with np.errstate(invalid="ignore"):
        outwards = (moved / np.cos(intervals.half_width))[:, None] * intervals.middle
    planes = SupportingPlanes(points[rows] + outwards, *intervals)
    if cloud.table is not None:
        table = _table_plane(cloud.table - cloud.rod_radius, centre, shape)
        planes = SupportingPlanes(*(np.concatenate(pair) for pair in zip(planes, table, strict=True)))
    return TangentPlanes(planes, rows, centre, shape, ball)


def _hull(points: Array) -> ConvexHull:
    """The hull of points (n, 3), moved by rounding (Qhull's option QJ) where very many of them in one plane make Qhull fail."""
    try:
        return ConvexHull(points)
    except QhullError:
        return ConvexHull(points, qhull_options="QJ")


def _table_plane(height: float, centre: Array, shape: Array) -> SupportingPlanes:
    """The plane at a height, below which nothing of the fattened body lies, in the frame of `TangentPlanes`."""
    point = np.linalg.solve(shape, [0.0, 0.0, height - centre[2]])
    normal = unit(shape @ [0.0, 0.0, -1.0])
    return SupportingPlanes(point[None], normal[None], across(normal[None])[0], np.zeros(1))
