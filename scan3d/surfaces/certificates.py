"""The certificate of a surface: how far it can be from the body that an enclosure bounds (`scan3d.surfaces.bounds`).

The distance to a convex surface is a convex function, and so it is largest over the outer body at one of its corners.  By the
triangle inequality a corner is no farther from the surface than from the inner body, and from there to the surface.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.comparison import compare
from scan3d.geometry.distance import nearest, nearest_on
from scan3d.geometry.hull_distance import distance_to_hull
from scan3d.surfaces.enclosures import Certificate, Enclosure, SliceEnclosure
from scan3d.surfaces.local_bounds import depths, depths_in
from scan3d.surfaces.spatial_bounds import SpatialEnclosure, spatial_certificate

# A surface this close to its convex hull, relative to the diagonal, is certified in the same manner as its hull, and the
# distance between the two is added to the bound.  Larger, that addition weakens the bound; smaller, hulls that are convex
# only to rounding are certified by the weaker rule for surfaces that are not convex.
_CONVEX = 1e-9
# Corners of the outer body that are measured at once.  More, and some are measured that can't be the farthest; fewer take more
# calls.
_CORNERS_AT_ONCE = 2048


def certificate(bounds: Enclosure, surface: Any) -> Certificate:
    """The certificate of a surface, a `trimesh.Trimesh` in the cloud's unit, by an enclosure of the body.

    Whether the surface is convex is judged by its shape.  A convex surface is certified by the distances of the outer
    body's corners from it, and of its vertices from the inner body.  A surface that is open or not convex is compared
    with the inner body, and the bound of the inner body is added to the distance.
    """
    vertices = np.asarray(surface.vertices)
    deviation = distance_to_hull(surface)
    if deviation > _CONVEX * np.linalg.norm(np.ptp(vertices, axis=0)):
        local = np.abs(nearest(vertices, bounds.inner)[0])
        return Certificate(compare(surface, bounds.inner).upper + bounds.bound, local + bounds.bound)
    if isinstance(bounds, SpatialEnclosure):
        bound, local = spatial_certificate(bounds, surface)
        return Certificate(bound + deviation, local + deviation)
    assert isinstance(bounds, SliceEnclosure)
    outwards = outside(vertices, bounds.inner) + bounds.excess
    bounded = np.isfinite(bounds.corners).all(axis=1)
    bound = np.inf
    if bounded.all() and np.isfinite(bounds.gap).all():
        bound = _largest_distance(bounds, surface, outwards.max())
    local = np.minimum(np.maximum(outwards, depths(bounds, surface)), bound)
    if isinstance(bounds.tangents, SpatialEnclosure):
        by_tangents, local_by_tangents = spatial_certificate(bounds.tangents, surface)
        bound, local = min(bound, by_tangents), np.minimum(local, local_by_tangents)
    elif bounds.tangents is not None:
        bound = min(bound, _largest_distance(bounds.tangents, surface, outwards.max()))
        by_cells = np.maximum(outwards, depths_in(bounds.tangents.corners, surface))
        local = np.minimum(local, np.minimum(by_cells, bound))
    return Certificate(bound + bounds.margin + deviation, local + bounds.margin + deviation)


def _largest_distance(bounds: Enclosure, surface: Any, known: float) -> float:
    """Largest distance of the outer body's corners from a convex surface, or `known` where that is larger.

    Corners are measured in the order of the distances that they may have at most, until none of the others can be farther.
    """
    distance = nearest_on(surface)
    between = max(float(distance(bounds.inner.vertices)[0].max()), 0.0)
    order, largest = np.argsort(-bounds.gap), float(known)
    for start in range(0, len(order), _CORNERS_AT_ONCE):
        rows = order[start : start + _CORNERS_AT_ONCE]
        if bounds.gap[rows[0]] + between <= largest:
            break
        largest = max(largest, float(distance(bounds.corners[rows])[0].max()))
    return largest


def outside(points: Array, body: Any) -> Array:
    """Distance (n,) of points (n, 3) to a convex body, 0 inside."""
    return np.maximum(nearest(points, body)[0], 0.0)


def withdrawn(bounds: Enclosure, surface: Any) -> tuple[Enclosure, Certificate]:
    """The enclosure and the certificate of a surface where the recording contradicts the premises: nothing is bounded."""
    if isinstance(bounds, SliceEnclosure):
        bounds = replace(bounds, tangents=None)
    nothing = replace(
        bounds,
        gap=np.full(len(bounds.gap), np.inf),
        bound=np.inf,
        volume=(0.0, np.inf),
        confidence=0.0,
    )
    return nothing, Certificate(np.inf, np.full(len(surface.vertices), np.inf))
