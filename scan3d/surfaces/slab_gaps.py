"""Distances of the outer body's corners from the hull of the contacts, slab by slab.

Nearly every corner lies straight above a face of the hull that crosses its slab or ends at one of its slices, or on the hull.
So these faces are tried first, and the nearest of all faces is searched for the few other corners only.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from scan3d.arrays import Array, Index, Mask
from scan3d.geometry.distance import locator
from scan3d.geometry.triangles import distance_to, dot, longest_first
from scan3d.reconstruction.slices import Slice, SliceStack

# A point counts as nearest to a face if its distance from the face is that from the face's plane, up to this fraction of it,
# or of the size.  Larger, distances may be too large by as much; smaller, rounding calls for the slower search.
_SAME, _ROUNDING = 1e-9, 1e-14
# A hull whose volume is less than this fraction of its area times its size is left to the search that knows how to handle it.
_THINNEST = 1e-9
# Corners times faces up to which the corners are held against the planes of all faces.  Larger, slices of many contacts take a
# time that grows with their square; smaller, those of few take longer than they need.
_FEW = 1_000_000


class SlabGaps:
    """The hull of a stack's contacts, and the distances of points in its slabs from it.

    Raises QhullError if the contacts span no body, or hardly one.
    """

    def __init__(self, stack: SliceStack) -> None:
        levels = [_level(slice_) for slice_ in stack.slices]
        points = np.concatenate(levels)
        self._frame, self._middle = stack.frame, points.mean(axis=0)
        self._size = float(np.ptp(points, axis=0).max())
        points = (points - self._middle) / self._size
        qhull = ConvexHull(points)
        if not qhull.volume > _THINNEST * qhull.area:
            raise QhullError
        number = np.repeat(np.arange(len(levels)), [len(level) for level in levels])[qhull.simplices]
        lowest, highest = number.min(axis=1), number.max(axis=1)
        triangles = points[qhull.simplices]
        self._triangles = np.take_along_axis(triangles, longest_first(triangles)[:, :, None], axis=1)
        self._planes = qhull.equations
        # a face that crosses several slabs, as on flat parts of the body, counts to each
        slabs = highest - lowest
        face = np.repeat(np.arange(len(slabs)), slabs)
        above = lowest[face] + np.arange(len(face)) - np.repeat(np.cumsum(slabs) - slabs, slabs)
        order = np.argsort(above, kind="stable")
        self._crossing = face[order]
        """Faces that cross each slab, from below."""
        self._first = np.searchsorted(above[order], np.arange(len(levels) + 1))
        """The first of them above each slice."""
        self._locate: Callable[[Array], tuple[Index, Array]] | None = None

    def at(self, i: int, corners: Array) -> Array:
        """Distances (w,) of corners (w, 3) of the slab below slice i from the hull; 0 inside."""
        corners = (corners @ self._frame.T - self._middle) / self._size
        distance, left = np.zeros(len(corners)), np.arange(len(corners))
        halfway = (corners[:, 2].min(initial=np.inf) + corners[:, 2].max(initial=-np.inf)) / 2
        for low, side in ((i - 1, 0), (i - 2, -1), (i, 1)):
            tried = left[side * (corners[left, 2] - halfway) >= 0]
            above, found = self._above(corners[tried], self._faces(low), within=side == 0)
            distance[tried[found]] = above[found]
            left = np.setdiff1d(left, tried[found], assume_unique=True)
        if len(left):
            self._locate = self._locate or locator(self._triangles)
            face, foot = self._locate(corners[left])
            outside = dot(corners[left] - foot, foot) > 0  # the hull's middle is at 0
            distance[left] = np.where(outside, distance_to(corners[left], self._triangles[face]), 0.0)
        return distance * self._size

    def _faces(self, low: int) -> Index:
        """The faces that cross the slab above slice `low`; none below the first slice and above the last."""
        return (
            self._crossing[self._first[low] : self._first[low + 1]]
            if 0 <= low < len(self._first) - 1
            else self._crossing[:0]
        )

    def _above(self, points: Array, faces: Index, *, within: bool) -> tuple[Array, Mask]:
        """Distances (w,) of points (w, 3) from those of some faces (m,) whose planes they are farthest from.

        The second result says where no other face of the hull is nearer: the point lies straight above the face, or, if it is
        `within` the slab that the faces cross, on the hull or inside, where the distance is 0.
        """
        if not 0 < len(faces) * len(points) <= _FEW:
            return np.zeros(len(points)), np.zeros(len(points), dtype=bool)
        heights = points @ self._planes[faces, :3].T + self._planes[faces, 3]
        best = heights.argmax(axis=1)
        height = np.take_along_axis(heights, best[:, None], axis=1)[:, 0]
        distance = distance_to(points, self._triangles[faces[best]])
        on_hull = height <= (_ROUNDING if within else -np.inf)
        above = (height > 0) & (distance <= (1 + _SAME) * height + _ROUNDING)
        return np.where(on_hull, 0.0, distance), above | on_hull


def _level(slice_: Slice) -> Array:
    """The corners (v, 3) of a slice's hull, in the slices' frame."""
    points = slice_.outline if len(slice_.outline) else slice_.points
    return np.column_stack([points, np.full(len(points), slice_.height)])
