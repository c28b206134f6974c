"""Where straight lines, and balls along them, first meet a triangle mesh of any shape: what the tip of a rod meets that moves
along itself."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from scan3d.arrays import AT_ONCE, ROUNDING, Array, Index, Mask, ranges, ratio
from scan3d.geometry.triangles import face_normals, largest_of_three

# Twice the area of a face as seen along a line, in squares of the size, below which rounding moves the place along the line.
_STEEP = 1e-6


def first_crossings(mesh: Any, start: Array, along: Array) -> tuple[Array, Index]:
    """Where parallel lines first meet a mesh: the distances (n,) from their starts, infinite where there is nothing, and faces.

    mesh
        a closed `trimesh.Trimesh`.
    start (n, 3), along (3,)
        where the lines begin, outside of the body, and the unit vector along all of them.

    A line meets a face in its edges and corners as well.  On which side of an edge a line passes is computed alike for both
    faces of the edge, so that none passes between them.  Faces along the lines are met at their edges, which others share.
    """
    distance, face = np.full(len(start), np.inf), np.full(len(start), -1)
    if not len(start):
        return distance, face
    frame = _frame(start, along)
    centre = mesh.bounds.mean(axis=0)
    corners, lines = (mesh.vertices.view(np.ndarray) - centre) @ frame.T, (start - centre) @ frame.T
    faces = mesh.faces.view(np.ndarray)
    height = corners[faces, 1]
    for candidate, line in _near(lines[:, 1], -largest_of_three(-height), largest_of_three(height), AT_ONCE):
        met, depth = _met(corners, faces[candidate], lines[line])
        candidate, line, depth = candidate[met], line[met], depth[met]
        depth -= lines[line, 2]
        candidate, line, depth = candidate[depth >= 0], line[depth >= 0], depth[depth >= 0]
        by_depth = np.lexsort((candidate, depth, line))
        nearest = by_depth[np.diff(line[by_depth], prepend=-1) > 0]
        closer = nearest[depth[nearest] < distance[line[nearest]]]
        distance[line[closer]], face[line[closer]] = depth[closer], candidate[closer]
    return distance, face


def _near(level: Array, low: Array, high: Array, at_once: int) -> Iterator[tuple[Index, Index]]:
    """The pairs of faces (m,) that reach from `low` to `high`, and lines at a `level` (n,) between, about so many at once."""
    order = np.argsort(level, kind="stable")
    first = np.searchsorted(level[order], low)
    count = np.searchsorted(level[order], high, side="right") - first
    near = np.flatnonzero(count)
    blocks = np.searchsorted(np.cumsum(count[near]), np.arange(at_once, count.sum(), at_once))
    for some in np.split(near, np.unique(blocks)):
        which, after = ranges(count[some])
        yield some[which], order[first[some][which] + after]


def first_met(mesh: Any, start: Array, along: Array) -> tuple[Array, Index]:
    """`first_crossings` of lines (n,) with directions (n, 3), of which many are alike."""
    distance, face = np.full(len(start), np.inf), np.full(len(start), -1)
    direction, number = np.unique(along, axis=0, return_inverse=True)
    for k, common in enumerate(direction):
        rows = np.flatnonzero(number.reshape(-1) == k)
        distance[rows], face[rows] = first_crossings(mesh, start[rows], common)
    return distance, face


def _frame(start: Array, along: Array) -> Array:
    """(3, 3) axes as rows, the third along the lines, and the second across the plane of those that lie in one."""
    spread = start - start.mean(axis=0)
    spread = spread - (spread @ along)[:, None] * along
    widest = spread[np.argmax((spread * spread).sum(axis=1))]
    if not (widest @ widest) > 0:
        widest = np.eye(3)[np.abs(along).argmin()]
        widest = widest - (widest @ along) * along
    first = widest / np.linalg.norm(widest)
    return np.stack([first, np.cross(along, first), along])


def _met(corners: Array, faces: Index, lines: Array) -> tuple[Mask, Array]:
    """Whether lines along the third axis, one for each face (m, 3), meet it, and where (m,)."""
    x, y = lines[:, 0], lines[:, 1]
    across = corners[faces, 0]
    met = (-largest_of_three(-across) <= x) & (largest_of_three(across) >= x)
    some = np.flatnonzero(met)
    faces, x, y = faces[some], x[some], y[some]
    sides = np.empty((len(some), 3))
    for k in range(3):
        a, b = faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        low, high = corners[np.minimum(a, b)], corners[np.maximum(a, b)]
        side = (high[:, 0] - low[:, 0]) * (y - low[:, 1]) - (high[:, 1] - low[:, 1]) * (x - low[:, 0])
        sides[:, k] = np.where(a < b, side, -side)
    total = sides.sum(axis=1)
    inside = ((sides >= 0).all(axis=1) | (sides <= 0).all(axis=1)) & (total != 0)
    met[some] = inside
    depth = np.zeros(len(met))
    weights = sides[inside] / total[inside, None]
    depth[some[inside]] = (weights * corners[faces[inside], 2]).sum(axis=1)
    size = float(np.abs(corners).max())
    steep = np.flatnonzero(inside)[np.abs(total[inside]) < _STEEP * size**2]
    depth[some[steep]] = _along_faces(corners[faces[steep]], x[steep], y[steep], ROUNDING * size)
    return met, depth


def _along_faces(corners: Array, x: Array, y: Array, least: float) -> Array:
    """Where (m,) lines along the third axis meet faces (m, 3, 3) that are nearly along them.

    That is in the faces, wherever rounding moves it along the line.  A face that is seen narrower than `least` may have the
    line in it, and is met at its first edge.
    """
    ends = np.roll(corners, -1, axis=1)
    change = ends[..., 0] - corners[..., 0]
    part = np.where(change == 0, 0.0, ratio(x[:, None] - corners[..., 0], change))
    crossed = (change != 0) & (part >= 0) & (part <= 1)
    cut = corners[..., 1:] + part[..., None] * (ends[..., 1:] - corners[..., 1:])
    first = np.where(crossed, cut[..., 1], np.inf).argmin(axis=1)
    last = np.where(crossed, cut[..., 1], -np.inf).argmax(axis=1)
    rows = np.arange(len(x))
    low, high = cut[rows, first], cut[rows, last]
    width = high[:, 0] - low[:, 0]
    share = np.where(np.abs(width) > least, np.clip(ratio(y - low[:, 0], width), 0.0, 1.0), 0.0)
    return np.asarray(low[:, 1] + share * (high[:, 1] - low[:, 1]))


def first_touches(mesh: Any, start: Array, along: Array, radius: float) -> tuple[Array, Array]:
    """Where balls first touch a mesh whose centres move along lines: distances (n,) of the centres from their starts, infinite
    where there is nothing, and unit vectors (n, 3) from the places that are touched to the centres.

    mesh
        a closed `trimesh.Trimesh`, outward.
    start, along (n, 3)
        where the centres begin, farther than the radius outside of the body, and unit vectors.

    A ball touches a face inside of it, where its centre crosses the plane that is the radius before it; an edge, where it
    crosses the cylinder about it; or a corner, where it crosses the sphere.
    """
    distance, normal = np.full(len(start), np.inf), np.full((len(start), 3), np.nan)
    direction, number = np.unique(along, axis=0, return_inverse=True)
    triangles, normals = mesh.triangles.view(np.ndarray), face_normals(mesh)
    for k, common in enumerate(direction):
        rows = np.flatnonzero(number.reshape(-1) == k)
        frame = _frame(start[rows], common)
        # what is first touched of a body is a face that looks against the motion, or an edge or a corner of one
        corners = triangles[normals @ common < 0]
        flat, lines = corners @ frame[:2].T, start[rows] @ frame[:2].T
        low, high = flat.min(axis=1) - radius, flat.max(axis=1) + radius
        for face, line in _near(lines[:, 1], low[:, 1], high[:, 1], AT_ONCE // 8):
            beside = (lines[line, 0] >= low[face, 0]) & (lines[line, 0] <= high[face, 0])
            face, line = face[beside], line[beside]
            met, away = _touched(corners[face], start[rows[line]], common, radius)
            nearest = np.lexsort((met, line))
            nearest = nearest[np.diff(line[nearest], prepend=-1) > 0]
            closer = nearest[met[nearest] < distance[rows[line[nearest]]]]
            distance[rows[line[closer]]], normal[rows[line[closer]]] = met[closer], away[closer]
    return distance, normal


def _touched(corners: Array, start: Array, along: Array, radius: float) -> tuple[Array, Array]:
    """Where balls (m,) first touch triangles (m, 3, 3), one each, and unit vectors (m, 3) from there to their centres."""
    found, away = np.full(len(start), np.inf), np.zeros((len(start), 3))

    def put(rows: Index, distance: Array, touched: Array) -> None:
        closer = (distance >= 0) & (distance < found[rows])
        rows, distance = rows[closer], distance[closer]
        found[rows] = distance
        away[rows] = (start[rows] + distance[:, None] * along - touched[closer]) / radius

    edges = np.roll(corners, -1, axis=1) - corners
    across = np.cross(edges[:, 0], edges[:, 1])
    size = np.linalg.norm(across, axis=1)
    towards = across @ along
    rows: Index = np.flatnonzero(np.abs(towards) > ROUNDING * size)
    # on the side from which the ball comes
    across = -np.sign(towards[rows])[:, None] * across[rows] / size[rows, None]
    height = ((start[rows] - corners[rows, 0]) * across).sum(axis=1) - radius
    distance = height / -(across @ along)
    touched = start[rows] + distance[:, None] * along - radius * across
    sides = np.cross(edges[rows], touched[:, None] - corners[rows]) @ across[..., None]
    within = (sides[..., 0] >= 0).all(axis=1) | (sides[..., 0] <= 0).all(axis=1)
    put(rows[within], distance[within], touched[within])
    for k in range(3):
        edge, offset = edges[:, k], start - corners[:, k]
        square = (edge * edge).sum(axis=1)
        # across the edge
        beside = along - ((edge @ along) / square)[:, None] * edge
        apart = offset - ((offset * edge).sum(axis=1) / square)[:, None] * edge
        distance, rows = _root(beside, apart, radius)
        part = ((offset[rows] + distance[:, None] * along) * edge[rows]).sum(axis=1) / square[rows]
        within = (part > 0) & (part < 1)
        put(rows[within], distance[within], (corners[rows, k] + part[:, None] * edge[rows])[within])
        distance, rows = _root(np.broadcast_to(along, offset.shape), offset, radius)
        put(rows, distance, corners[rows, k])
    return found, away


def _root(rate: Array, offset: Array, radius: float) -> tuple[Array, Index]:
    """The least t (m,) with ``|offset + t rate| = radius`` of those rows (m,) of vectors (n, 3) that have one."""
    a, b = (rate * rate).sum(axis=1), (rate * offset).sum(axis=1)
    # of the part across the rate, which is exact where the offset is long
    nearest = offset - ratio(b, a)[:, None] * rate
    rest = radius**2 - (nearest * nearest).sum(axis=1)
    rows = np.flatnonzero((a > ROUNDING) & (rest >= 0))
    return -b[rows] / a[rows] - np.sqrt(rest[rows] / a[rows]), rows
