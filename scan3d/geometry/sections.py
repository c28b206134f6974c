"""Plane sections of closed meshes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, QhullError

from scan3d.arrays import Array, Index, ranges
from scan3d.geometry.outlines import outer_outlines

if TYPE_CHECKING:
    import trimesh

# Rounding of a rotated coordinate, relative to its size.
_ROUNDING = 8 * np.finfo(np.float64).eps


def slice_frame(axis: Array) -> Array:
    """The x, y and z axes of the slices' frame as rows (3, 3), z along `axis` (3,); the identity matrix for the z axis."""
    z = axis / np.linalg.norm(axis)
    helper = np.eye(3)[[2, 0, 1][int(np.argmax(np.abs(z)))]]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def extent_along(mesh: trimesh.Trimesh, axis: ArrayLike) -> tuple[float, float]:
    """Lowest and highest coordinate of the mesh along an axis (3,) of any length, in the units of the mesh."""
    axis = np.asarray(axis, np.float64)
    heights = mesh.vertices.view(np.ndarray) @ (axis / np.linalg.norm(axis))
    return float(heights.min()), float(heights.max())


def slice_polygons(mesh: trimesh.Trimesh, rotation: ArrayLike, heights: ArrayLike) -> list[Array]:
    """Exact plane sections of a convex mesh, in the units of the mesh.

    rotation (3, 3)
        its rows are the x, y and z axes of the slices' frame in the world; the origin of the frame is that of the world.
    heights (n,)
        heights of the slices along the frame's z axis, in any order.

    Returns n convex polygons (m, 2), counter-clockwise in the frame's x and y, without duplicate or collinear vertices; (0, 2)
    where the plane misses the body or only touches it in a point or an edge.  The section by a plane that contains a face of
    the body, within rounding, is that face.  Vertices are exact to rounding of the body's size and distance from the origin.
    """
    rotation, heights = np.asarray(rotation, np.float64), np.asarray(heights, np.float64)
    center = mesh.bounds.mean(axis=0)
    origin = rotation @ center
    points = (mesh.vertices.view(np.ndarray) - center) @ rotation.T  # about the centre, where float64 is finest
    rounding = _ROUNDING * float(np.linalg.norm(mesh.extents) + np.linalg.norm(center))
    order = np.argsort(heights)
    levels = heights[order] - origin[2]

    # A vertex within rounding of the plane lies on it; an edge crosses it if its ends lie strictly on opposite sides.
    z = points[:, 2]
    on, on_level = _pairs(np.searchsorted(levels, z - rounding), np.searchsorted(levels, z + rounding, side="right"))
    edges = mesh.edges_unique
    low, high = np.where(z[edges[:, 0]] <= z[edges[:, 1]], edges.T, edges.T[::-1])
    crossed, crossed_level = _pairs(
        np.searchsorted(levels, z[low] + rounding, side="right"), np.searchsorted(levels, z[high] - rounding)
    )
    a, b = points[low[crossed]], points[high[crossed]]
    below, above = levels[crossed_level] - a[:, 2], b[:, 2] - levels[crossed_level]
    crossings = (above[:, None] * a[:, :2] + below[:, None] * b[:, :2]) / (below + above)[:, None]

    level = np.concatenate([on_level, crossed_level])
    by_level = np.argsort(level, kind="stable")
    outline = np.concatenate([points[on, :2], crossings])[by_level]
    ends = np.searchsorted(level[by_level], np.arange(len(levels) + 1))
    polygons = [np.empty((0, 2))] * len(heights)
    for i, j in enumerate(order):
        polygons[j] = convex_polygon(outline[ends[i] : ends[i + 1]], rounding) + origin[:2]
    return polygons


def slice_outlines(mesh: trimesh.Trimesh, rotation: Array, heights: Array) -> list[list[Array]]:
    """Plane sections of any closed mesh: the contours that can be reached from outside, in the units of the mesh.

    Rotation and heights are as in `slice_polygons`.  Returns for each height simple polygons (m, 2) outside of each other,
    counter-clockwise; none where the plane misses the body.  Holes, and what lies in them, are left out.  Vertices in the plane
    count as above it, so that the section by a plane that contains faces is the one just below.
    """
    center = mesh.bounds.mean(axis=0)
    origin = rotation @ center
    points, faces = (mesh.vertices.view(np.ndarray) - center) @ rotation.T, mesh.faces.view(np.ndarray)
    order = np.argsort(heights)
    levels = heights[order] - origin[2]
    outlines: list[list[Array]] = [[] for _ in heights]
    for i, lines in zip(order, _closed_lines(points, faces, levels), strict=True):
        outlines[i] = [line + origin[:2] for line in outer_outlines(lines, float(np.linalg.norm(mesh.extents)))]
    return outlines


def _closed_lines(points: Array, faces: Index, levels: Array) -> list[list[Array]]:
    """The closed lines (m, 2) in which planes at rising levels cut the triangles of a closed mesh, body on the left."""
    z = points[faces, 2]
    first, last = (np.searchsorted(levels, end, side="right") for end in (z.min(axis=1), z.max(axis=1)))
    face, level = _pairs(first, last)
    above = z[face] >= levels[level, None]
    following = np.roll(above, -1, axis=1)
    ends = []
    for crossing in (above & ~following, ~above & following):  # where a face is entered, and where it is left
        k = crossing.argmax(axis=1)
        ends.append(np.sort(np.stack([faces[face, k], faces[face, (k + 1) % 3]], axis=1), axis=1))
    a, b = points[ends[0]].transpose(1, 0, 2)
    share = (levels[level] - a[:, 2]) / (b[:, 2] - a[:, 2])
    places = a[:, :2] + share[:, None] * (b - a)[:, :2]
    entered, left = (np.lexsort((edge[:, 1], edge[:, 0], level)) for edge in ends)
    next_face = np.empty(len(face), dtype=np.intp)
    next_face[left] = entered
    lines: list[list[Array]] = [[] for _ in levels]
    number, pending = next_face.tolist(), [True] * len(face)
    for start in range(len(face)):
        line, k = [], start
        while pending[k]:
            pending[k] = False
            line.append(k)
            k = number[k]
        if line:
            lines[level[start]].append(places[line])
    return lines


def _pairs(first: Index, last: Index) -> tuple[Index, Index]:
    """All pairs (i, j) with first[i] <= j < last[i], as two arrays."""
    i, rank = ranges(np.maximum(last - first, 0))
    return i, first[i] + rank


def convex_polygon(points: Array, rounding: float) -> Array:
    """Counter-clockwise hull (m, 2) of points (n, 2), without vertices that bulge from it by no more than rounding.

    Empty (0, 2) if the points span no polygon.
    """
    empty = np.empty((0, 2))
    if len(points) < 3 or (size := np.ptp(points, axis=0).max()) <= rounding:
        return empty
    try:
        polygon: Array = points[ConvexHull((points - points.mean(axis=0)) / size).vertices]
    except QhullError:  # the points lie on a line
        return empty
    # vertices are removed one at a time, so that of two that coincide one stays
    while len(polygon) >= 3:
        before, after = polygon - np.roll(polygon, 1, axis=0), np.roll(polygon, -1, axis=0) - polygon
        turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        bulge = turn / np.linalg.norm(before + after, axis=1)  # distance from the neighbours' chord
        if bulge.min() > rounding:
            return polygon
        polygon = np.delete(polygon, bulge.argmin(), axis=0)
    return empty
