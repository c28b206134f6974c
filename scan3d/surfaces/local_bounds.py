"""How far the surface of the body can be from places inside it, by the slabs between the slices.

Let x be a point of the body K.  For every direction u it lies no farther from the surface of K than ``h_K(u) - <u, x>``, and
``h_K`` is at most the support function of the outer body.  Within a slab the same holds with the slab's own corners, and with
directions u in the slices' planes: the way from x along u leaves the body inside the slab.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from scan3d.arrays import Array, Index
from scan3d.geometry.vectors import highest
from scan3d.surfaces.enclosures import SliceEnclosure

# Rounding of heights, relative to them: a few thousand units in the last place.
_ROUNDING = 1e-12


def depths(bounds: SliceEnclosure, surface: Any) -> Array:
    """Upper bounds (v,) of the distances of a convex surface's vertices in the body from the body's surface.

    The directions are the normals of the faces at each vertex; where a slab is unbounded, they are those of the vertices,
    projected into the slices' planes.
    """
    vertices: Array = surface.vertices.view(np.ndarray)
    faces: Index = surface.faces
    corner = vertices[faces]
    normals = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    if not np.isfinite(bounds.corners).all():
        of_vertices = np.zeros_like(vertices)
        np.add.at(of_vertices, faces.ravel(), np.repeat(normals, 3, axis=0))
        return _within_slabs(bounds, vertices, of_vertices)
    size = np.linalg.norm(normals, axis=1)
    known = np.flatnonzero(size > 0)
    normals = normals[known] / size[known, None]
    depth = highest(_extreme(bounds.corners), normals) - (normals * corner[known, 0]).sum(axis=1)
    found = np.full(len(vertices), np.inf)
    np.minimum.at(found, faces[known].ravel(), np.repeat(np.maximum(depth, 0.0), 3))
    return found


def _within_slabs(bounds: SliceEnclosure, vertices: Array, normals: Array) -> Array:
    """The bounds by each vertex' own slab and its normal's direction in the slices' planes; infinite in unbounded slabs."""
    frame, levels = bounds.stack.frame, np.array([-np.inf, *bounds.stack.heights, np.inf])
    heights = vertices @ frame[2]
    rounding = _ROUNDING * float(np.abs(heights).max())
    level = normals - (normals @ frame[2])[:, None] * frame[2]
    size = np.linalg.norm(level, axis=1)
    level = np.where(size[:, None] > 0, level / np.where(size > 0, size, 1.0)[:, None], frame[0])
    found = np.full(len(vertices), np.inf)
    for number in np.unique(bounds.slab):
        corners = bounds.corners[bounds.slab == number]
        if np.isfinite(corners).all():
            rows = (heights >= levels[number] - rounding) & (heights <= levels[number + 1] + rounding)
            depth = highest(corners, level[rows]) - (level[rows] * vertices[rows]).sum(axis=1)
            found[rows] = np.minimum(found[rows], np.maximum(depth, 0.0))
    return found


def _extreme(points: Array) -> Array:
    """The points (n, 3) that are vertices of their hull; all points if they span no body."""
    with suppress(QhullError):
        points = points[ConvexHull(points).vertices]
    return points
