"""Polytopes that planes enclose, and the plane faces of the hull of points."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from scan3d.arrays import AT_ONCE, NEGLIGIBLE, Array, Index, highest
from scan3d.geometry.triangles import areas

# Points that a plane face has at least.
_FACE_POINTS = 6


def plane_faces(points: Array, tolerance: float) -> Array:
    """The planes (k, 4), n and c with <n, x> <= c, of the hull of points (n, 3) in which many of them lie, to a tolerance."""
    qhull = ConvexHull(points)
    corners = points[qhull.simplices]
    area = areas(corners)
    planes = np.column_stack([qhull.equations[:, :3], -qhull.equations[:, 3]])
    # facets in a plane face are linked with each other, to their neighbours in it
    depths = planes[:, 3, None, None] - np.einsum("fkcx,fx->fkc", corners[qhull.neighbors], planes[:, :3])
    facet, side = np.nonzero(depths.max(axis=2) <= tolerance)
    links = coo_array((np.ones(len(facet)), (facet, qhull.neighbors[facet, side])), shape=(len(planes),) * 2)
    _, group = connected_components(links, directed=False)
    order = np.lexsort((-area, group))
    first = order[np.r_[True, np.diff(group[order]) > 0]]
    linked = first[np.bincount(group)[group[first]] > _FACE_POINTS // 2]
    faces: list[Array] = []
    # those with the largest facets first
    for plane in planes[linked[np.argsort(-area[linked], kind="stable")]][:400]:
        depth = plane[3] - points[qhull.vertices] @ plane[:3]
        near = points[qhull.vertices[depth <= tolerance]]
        known = any((np.abs(face[3] - near @ face[:3]) <= tolerance).all() for face in faces)
        if len(near) >= _FACE_POINTS and not known:
            faces.append(plane)
    return np.array(faces) if faces else np.empty((0, 4))


def cut_polytope(first: Array, others: Array, inside: Array, size: float, tolerance: float) -> Array:
    """Vertices (v, 3) of the polytope that planes enclose: all of `first` (k, 4), and those of `others` (l, 4) that cut it.

    inside
        (3,) a point inside of all planes.
    size
        that of the body, to which the polytope is limited where the planes leave it open.
    tolerance
        depth of the smallest cut that is made.
    """
    box = np.concatenate([np.eye(3), -np.eye(3)])
    planes = np.concatenate([first, np.column_stack([box, box @ inside + 2 * size])])
    used = np.zeros(len(others), dtype=bool)
    vertices = _vertices(planes, inside)
    for _ in range(20):
        if not len(others):
            break
        # one vertex after another has the same planes through it, so each plane is added once
        deepest, depth = _deepest_cuts(vertices, others)
        order = np.argsort(-depth, kind="stable")
        added = np.unique(deepest[order[depth[order] > tolerance]][:500])
        added = added[~used[added]]
        if not len(added):
            break
        used[added] = True
        planes = np.concatenate([planes, others[added]])
        vertices = _vertices(planes, inside)
    return vertices


def clipped(vertices: Array, planes: Array) -> Array:
    """Vertices (w, 3) of what planes (k, 4) leave of the hull of points (v, 3); the points themselves if none cuts it."""
    heights = highest(vertices, planes[:, :3]) - planes[:, 3]
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    cutting = planes[heights > NEGLIGIBLE * size]
    middle = vertices.mean(axis=0)
    # planes that pass the middle by show a hull that lies outside of them for the most part
    if not len(cutting) or (cutting[:, :3] @ middle > cutting[:, 3] - NEGLIGIBLE * size).any():
        return vertices
    equations = ConvexHull(vertices).equations
    return _vertices(np.concatenate([equations * [1, 1, 1, -1], cutting]), middle)


def _deepest_cuts(vertices: Array, planes: Array) -> tuple[Index, Array]:
    """For each vertex (v,) the plane beyond which it lies farthest, and how far."""
    blocks = np.array_split(vertices, 1 + len(vertices) * len(planes) // AT_ONCE)
    found = [(block @ planes[:, :3].T - planes[:, 3]) for block in blocks]
    plane = np.concatenate([depth.argmax(axis=1) for depth in found])
    return plane, np.concatenate([depth.max(axis=1) for depth in found])


def _vertices(planes: Array, inside: Array) -> Array:
    """Vertices (v, 3) of the polytope of planes, none of which passes through or beyond the point inside."""
    offset = planes[:, 3] - planes[:, :3] @ inside
    dual = planes[offset > 0, :3] / offset[offset > 0, None]
    try:
        equations = ConvexHull(dual).equations
        vertices: Array = inside - equations[:, :3] / equations[:, 3:]
    except QhullError:
        vertices = half_space_intersection(planes[offset > 0] * [1, 1, 1, -1], inside).intersections
    return np.unique(vertices, axis=0)


def half_space_intersection(planes: Array, inside: Array) -> HalfspaceIntersection:
    """The intersection of half-spaces (k, 4), a and b of ``a·x + b <= 0``, about a point (3,) inside.

    Qhull intersects half-spaces by the convex hull of their dual points.  It merges facets that are coplanar up to rounding, by
    which a vertex may get lost, and be added again without end where half-spaces through one corner are nearly equal.  With its
    option Qx it merges facets while it adds points only where the hull would not be convex, and coplanar facets at the end.
    Where it fails nevertheless, the half-spaces are moved by rounding (its option QJ).  Raises QhullError if that fails as
    well, or if the point does not lie inside.
    """
    try:
        return HalfspaceIntersection(planes, inside, qhull_options="Qx")
    except QhullError:
        return HalfspaceIntersection(planes, inside, qhull_options="QJ")
