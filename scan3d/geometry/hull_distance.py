"""How far a triangle mesh is from its convex hull, for surfaces that are convex but for rounding."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError, cKDTree

from scan3d.arrays import Array, Index
from scan3d.geometry.distance import bounding_box, welded
from scan3d.geometry.triangles import areas, dot

if TYPE_CHECKING:
    import trimesh

CONVEX_DEPTH = 1e-9  # of the diagonal: a dent less deep than this is rounding
NEAR_CONVEX_DEPTH = 1e-4  # of the diagonal: a surface with a dent deeper than this is treated as not convex
# Depth of a face, in diagonals, below which a closer look is not worth it where the distance to the hull is all that is
# asked for: a hundredth of what counts as convex.
_PRECISION = 1e-11


class Facets(NamedTuple):
    """A triangle mesh at the common size."""

    vertices: Array
    """(n, 3)"""
    faces: Index
    """(m, 3), longest edge first."""
    corners: Array
    """(m, 3, 3) vertices of the faces."""
    normals: Array
    """(m, 3), zero where a face has no area."""
    closed: bool
    volume: float
    """NaN unless closed."""


def prepare_facets(mesh: trimesh.Trimesh, centre: Array, scale: float) -> Facets:
    """A mesh moved by ``-centre`` and divided by `scale`, each vertex once."""
    vertices, faces = welded(mesh, centre, scale)
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(cross, axis=1, keepdims=True)
    normals = np.divide(cross, size, out=np.zeros_like(cross), where=size > 0)
    # Closed: every directed edge meets its reverse, so that the boundary is zero as a chain.
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    closed = np.array_equal(np.sort(start * len(vertices) + end), np.sort(end * len(vertices) + start))
    volume = abs(float(dot(corners[:, 0], cross).sum())) / 6 if closed else np.nan
    return Facets(vertices, faces, corners, normals, closed, volume)


def distance_to_hull(mesh: trimesh.Trimesh) -> float:
    """Upper bound of the Hausdorff distance between a mesh and its convex hull, in the mesh's unit.

    Infinite if the mesh is flat, has a dent deeper than `NEAR_CONVEX_DEPTH`, or does not wind once around its middle.
    Raises InputError as `scan3d.compare`.
    """
    box = bounding_box(mesh, "surface")
    scale = float(np.linalg.norm(box[1] - box[0]))
    facets = prepare_facets(mesh, box.mean(axis=0), scale)
    if not facets.closed:
        facets = _wound_alike(facets)
    return against_hull(facets, _PRECISION)[1] * scale


def _wound_alike(facets: Facets) -> Facets:
    """A closed surface with all faces wound alike; facets unchanged if an edge is not of two faces, or in several parts.

    The winding of a face without area, as Qhull makes them, is due to rounding, and would make a hull look open.
    """
    faces = facets.faces
    kept = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    faces, corners = faces[kept], facets.corners[kept]
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    edge = np.minimum(start, end) * len(facets.vertices) + np.maximum(start, end)
    _, uses = np.unique(edge, return_counts=True)
    if not (uses == 2).all():
        return facets
    first, second = np.argsort(edge, kind="stable").reshape(-1, 2).T
    # each face stands twice in this graph, as it is and turned over; neighbours that are wound alike are joined
    count, differs = len(faces), start[first] == start[second]
    a, b = first // 3, second // 3
    joined = np.concatenate([a, a + count]), np.concatenate([b + count * differs, b + count * ~differs])
    parts, label = connected_components(coo_array((np.ones(len(joined[0])), joined), shape=(2 * count,) * 2), False)
    if parts != 2 or (label[:count] == label[count:]).any():
        return facets
    turned = label[:count] != label[0]
    faces[turned], corners[turned] = faces[turned, ::-1], corners[turned, ::-1]
    return facets._replace(faces=faces, corners=corners, normals=facets.normals[kept], closed=True)


def _planes(points: Array) -> Array:
    """n and c (k, 4) of the planes <n, x> = c of points' convex hull, outward; none if the points are flat."""
    try:
        return np.unique(ConvexHull(points).equations, axis=0) * [1, 1, 1, -1]
    except (QhullError, ValueError):
        return np.empty((0, 4))


def against_hull(facets: Facets, precision: float = CONVEX_DEPTH / 10) -> tuple[Array, float]:
    """A supporting plane (m, 4) for every face, and a bound of the distance between the surface and its hull's.

    Depth below the hull's surface is concave on a face and not negative, so nowhere more than three times that of the
    face's middle.  If the surface winds once around a point c inside, every ray from c meets it, no deeper than that:
    along the ray that is within depth * R / r of the hull's surface, r and R the least and largest distance of c to it.
    A face known to be no deeper than `precision` is not looked at further.
    """
    vertices, _, corners, normals, closed, _ = facets
    none = np.empty((0, 4)), np.inf
    planes = _planes(vertices)
    if len(planes) == 0:
        return none
    middles = corners.mean(axis=1)
    c = np.average(middles, axis=0, weights=areas(corners))
    r = float((planes[:, 3] - planes[:, :3] @ c).min())
    big_r = float(np.linalg.norm(vertices - c, axis=1).max())

    rays = corners - c
    length = np.linalg.norm(rays, axis=2)
    cosines = (dot(rays, np.roll(rays, -1, axis=1)) * np.roll(length, 1, axis=1)).sum(axis=1)
    sines = dot(rays[:, 0], np.cross(rays[:, 1], rays[:, 2]))
    winding = float(np.arctan2(sines, length.prod(axis=1) + cosines).sum()) / (2 * np.pi)  # Van Oosterom, Strackee 1983
    missing = abs(abs(winding) - 1)
    if r <= 0 or missing > 1e-6:
        return none
    # What an open surface leaves uncovered has room for a disc of this radius; a closed one leaves nothing.
    hole = 0.0 if closed else 2 * np.sqrt(missing + 1e-14) * big_r

    outward = normals * np.where(dot(middles - c, normals) < 0, -1, 1)[:, None]
    chosen = cKDTree(planes[:, :3], balanced_tree=False).query(outward, workers=-1)[1]
    depth = planes[chosen, 3] - dot(planes[chosen, :3], middles)
    # A sliver's normal is rounding: try all planes on the deepest faces, as many as time allows.
    order = np.argsort(-depth)
    trials = max(1, 200_000_000 // len(planes))
    if depth[order[trials - 1 :]].max(initial=0.0) > NEAR_CONVEX_DEPTH:
        return none
    deepest = order[:trials][depth[order[:trials]] > precision]
    for some in np.array_split(deepest, 1 + len(deepest) * len(planes) // 4_000_000):
        depths = planes[:, 3] - middles[some] @ planes[:, :3].T
        chosen[some], depth[some] = depths.argmin(axis=1), depths.min(axis=1)
    return planes[chosen], (3 * max(float(depth.max()), 0.0) + hole) * big_r / r
