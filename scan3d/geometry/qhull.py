"""Intersections of half-spaces by Qhull, kept from going on for ever.

Qhull intersects half-spaces by the convex hull of their dual points.  It adds a point that lies outside of the hull so far, and
merges facets that are coplanar up to rounding, by which a vertex may get lost.  If that vertex counts as outside again, it is
added again: where half-spaces through one corner are nearly equal, two of them may replace each other without end.  So a point
only counts as outside if it lies there by more than merged facets move (Qhull's option W).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import HalfspaceIntersection, QhullError

from scan3d.arrays import Array

# How far outside of the hull a dual point lies at least that is added to it, relative to the largest coordinate: points that
# have replaced each other lay outside by 6e-15, and rounding is a tenth of that.  Larger, half-spaces are left out that count,
# and the intersection is larger than need be; smaller, Qhull may not end.
_LEAST_OUTSIDE = 1e-13


def half_space_intersection(planes: Array, inside: Array) -> HalfspaceIntersection:
    """The intersection of half-spaces (k, 4), a and b of ``a·x + b <= 0``, about a point (3,) inside.

    Half-spaces that cut it by rounding only are left out.  Where Qhull fails because half-spaces are nearly equal, they are
    moved by rounding (its option QJ).  Raises QhullError if it still fails, or if the point does not lie inside.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        dual = planes[:, :3] / (planes[:, 3] + planes[:, :3] @ inside)[:, None]
    least = _LEAST_OUTSIDE * float(np.abs(dual).max(initial=0.0))
    # Qhull tells in its own words if a plane passes through the point
    options = f"W{least:.3g}" if 0 < least < np.inf else ""
    try:
        return HalfspaceIntersection(planes, inside, qhull_options=options)
    except QhullError:
        return HalfspaceIntersection(planes, inside, qhull_options="QJ")
