"""Planes of further slices of a polyhedron, in any direction, chosen by what contacts know of its facets.

The planes of known facets meet in corners.  One that is not known to be a vertex may be cut off by further facets: a slice
between the corner and the body would cross them.  Once all corners are vertices, slices through these make the contacts' hull
the body itself.  A plane goes through three such places, those with the largest gaps first.
"""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array, evenly, unit
from scan3d.bounds import enclosure
from scan3d.bounds.enclosures import slice_enclosure
from scan3d.cloud import Cloud
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import hull
from scan3d.geometry.triangles import representatives
from scan3d.planning.plan import Plan
from scan3d.planning.several_axes import Further
from scan3d.reconstruction.facets import POLYHEDRON, polyhedron

FIRST_PART, FEW = 3 / 8, 64
"""Part of the slices, of so many at most, that go along one axis first, by which a body proves a polyhedron."""
# Places among which the other two of a plane are sought.
_AMONG = 10
# Part of the body's size below which a gap is none, and two corners are one.
_NEAR = 1e-7


class Aims:
    """The corners at which slices of a body were aimed: at none of them again before all others."""

    def __init__(self) -> None:
        self._outer: Array | None = None
        self._corners, self._rounds = np.empty((0, 3)), 0

    def next_slices(self, cloud: Cloud, plan: Plan, left: int) -> Further:
        """The slices to be swept next, as `several_axes.next_slices`: alone along one axis if contacts show no polyhedron."""
        inner, size = hull(cloud.points), float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
        if plan.tolerance and enclosure(cloud).bound <= plan.tolerance * size:
            return Further([])
        if self._outer is None:
            self._outer = slice_enclosure(cloud).corners
        within = inner.vertices.view(np.ndarray)
        known = polyhedron(cloud, within, np.concatenate([within, self._outer]))
        # the share of the contacts on known facets rises from round to round: of polyhedra of 200 vertices it is 0.87,
        # 0.92 and 1, of a scanned aeroplane of slivers 0.87 to 0.9 in all rounds
        if known.share < min(0.8 + 0.075 * self._rounds, POLYHEDRON):
            return Further([], cloud.slice_axis[0])
        self._rounds += 1
        vertices, corners = known.corners[known.vertex], known.corners[~known.vertex]
        gap, _, foot = nearest(corners, hull(np.concatenate([cloud.points, vertices])))
        aimed = (np.linalg.norm(corners[:, None] - self._corners, axis=2) <= _NEAR * size).sum(axis=1)
        # the gap of a corner counts less each time that it was aimed at
        gap = np.append(gap * 0.25**aimed, nearest(vertices, inner)[0])
        is_new = np.pad(aimed == 0, (0, len(vertices)))
        corners, places = np.concatenate([corners, vertices]), np.concatenate([(corners + foot) / 2, vertices])
        order = np.lexsort((-gap, ~is_new))
        order = order[gap[order] > _NEAR * size]
        order = order[np.unique(representatives(corners[order], _NEAR * size))]
        corners, places = corners[order], places[order]
        planes: list[Array] = []
        while len(places) and len(planes) < min(3, left):
            normals = np.concatenate([cloud.slice_axis, np.reshape(planes, (-1, 4))[:, :3]])
            plane, through = _plane_of(places, cloud.points, normals, size)
            planes += [] if plane is None else [plane]
            self._corners = np.concatenate([self._corners, corners[through]])
            corners, places = np.delete(corners, through, axis=0), np.delete(places, through, axis=0)
        return Further([(plane[:3], plane[3:]) for plane in planes])


def _plane_of(places: Array, points: Array, normals: Array, size: float) -> tuple[Array | None, list[int]]:
    """The plane (4,) through the first of some places and two others that parts points (n, 3) most evenly, and the places.

    No plane where all would be nearly parallel to slices with `normals` (s, 3), or pass by most of the body.
    """
    others = places[1 : 1 + _AMONG] if len(places) > 2 else np.concatenate([places[1:], evenly(points, _AMONG)])
    i, j = np.triu_indices(len(others), 1)
    across = np.cross(others[i] - places[0], others[j] - places[0])
    normal = unit(across)
    turn = np.minimum(*(np.abs(normal[:, None] + s * normals).max(axis=2).min(axis=1) for s in (-1, 1)))
    height = (points - places[0]) @ normal.T
    side = np.minimum(height.max(axis=0), -height.min(axis=0)) / np.ptp(height, axis=0)
    side[~((np.linalg.norm(across, axis=1) > 0.01 * size**2) & (turn > 0.01))] = 0.0
    best = int(side.argmax())
    if not side[best] > 0.1:
        return None, [0]
    through = [k for k in (0, 1 + int(i[best]), 1 + int(j[best])) if k < len(places)]
    return np.append(normal[best], normal[best] @ places[0]), through
