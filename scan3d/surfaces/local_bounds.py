"""How far the surface of the body can be from places inside it, by the slabs between the slices.

Let x be a point of the body K.  For every direction u it lies no farther from the surface of K than ``h_K(u) - <u, x>``, and
``h_K`` is at most the support function of the outer body.  Within a slab the same holds with the slab's own corners, and with
directions u in the slices' planes: the way from x along u leaves the body inside the slab.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from scan3d.arrays import Array, Index
from scan3d.geometry.extremes import support_values
from scan3d.geometry.vectors import highest
from scan3d.surfaces.enclosures import SliceEnclosure

# Rounding of heights, relative to them: a few thousand units in the last place.
_ROUNDING = 1e-12


def depths(bounds: SliceEnclosure, surface: Any) -> Array:
    """Upper bounds (v,) of the distances of a convex surface's vertices in the body from the body's surface.

    Of the directions of the faces' normals at a vertex that with the largest bound counts, so that the bound is wide where the
    body may reach far beyond one of the faces.  Where a slab is unbounded, they are the vertices' normals, projected into the
    slices' planes, and the bound of the slab's vertices is infinite.
    """
    if np.isfinite(bounds.corners).all():
        return depths_in(bounds.corners, surface)
    vertices, faces, _, normals = _faces(surface)
    of_vertices = np.zeros_like(vertices)
    np.add.at(of_vertices, faces.ravel(), np.repeat(normals, 3, axis=0))
    return _within_slabs(bounds, vertices, of_vertices)


def depths_in(corners: Array, surface: Any) -> Array:
    """`depths` in an outer body with the corners (w, 3)."""
    vertices, faces, corner, normals = _faces(surface)
    size = np.linalg.norm(normals, axis=1)
    known = np.flatnonzero(size > 0)
    normals = normals[known] / size[known, None]
    depth = support_values(corners, normals) - (normals * corner[known, 0]).sum(axis=1)
    found = np.full(len(vertices), -np.inf)
    np.maximum.at(found, faces[known].ravel(), np.repeat(np.maximum(depth, 0.0), 3))
    return np.where(np.isfinite(found), found, np.inf)


def _faces(surface: Any) -> tuple[Array, Index, Array, Array]:
    """Vertices (v, 3), faces (f, 3), their corners (f, 3, 3) and normals (f, 3) with twice the faces' areas as lengths."""
    vertices: Array = surface.vertices.view(np.ndarray)
    faces: Index = surface.faces
    corner = vertices[faces]
    return vertices, faces, corner, np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])


def _within_slabs(bounds: SliceEnclosure, vertices: Array, normals: Array) -> Array:
    """The bounds (v,) by each vertex' own slab and the direction of its normal (v, 3) in the slices' planes."""
    frame, levels = bounds.stack.frame, np.array([-np.inf, *bounds.stack.heights, np.inf])
    heights = vertices @ frame[2]
    rounding = _ROUNDING * float(np.abs(heights).max())
    level = normals - (normals @ frame[2])[:, None] * frame[2]
    size = np.linalg.norm(level, axis=1)
    level = np.where(size[:, None] > 0, level / np.where(size > 0, size, 1.0)[:, None], frame[0])
    found, is_open = np.full(len(vertices), np.inf), np.zeros(len(vertices), dtype=bool)
    for number in np.unique(bounds.slab):
        corners = bounds.corners[bounds.slab == number]
        rows = (heights >= levels[number] - rounding) & (heights <= levels[number + 1] + rounding)
        if np.isfinite(corners).all():
            depth = highest(corners, level[rows]) - (level[rows] * vertices[rows]).sum(axis=1)
            found[rows] = np.minimum(found[rows], np.maximum(depth, 0.0))
        else:
            is_open |= rows
    return np.where(is_open, np.inf, found)
