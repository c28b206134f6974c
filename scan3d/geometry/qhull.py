"""Intersections of half-spaces by Qhull, kept from going on for ever.

Qhull intersects half-spaces by the convex hull of their dual points.  It adds a point that lies outside of the hull so far, and
merges facets that are coplanar up to rounding, by which a vertex may get lost.  If that vertex counts as outside again, it is
added again: where half-spaces through one corner are nearly equal, two of them may replace each other without end.  With its
option Qx Qhull merges facets while it adds points only where the hull would not be convex, and coplanar facets at the end.
"""

from __future__ import annotations

from scipy.spatial import HalfspaceIntersection, QhullError

from scan3d.arrays import Array


def half_space_intersection(planes: Array, inside: Array) -> HalfspaceIntersection:
    """The intersection of half-spaces (k, 4), a and b of ``a·x + b <= 0``, about a point (3,) inside.

    Where Qhull fails because half-spaces are nearly equal, they are moved by rounding (its option QJ).  Raises QhullError if it
    still fails, or if the point does not lie inside.
    """
    try:
        return HalfspaceIntersection(planes, inside, qhull_options="Qx")
    except QhullError:
        return HalfspaceIntersection(planes, inside, qhull_options="QJ")
