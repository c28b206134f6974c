"""Convex hulls: as meshes, made smaller, their edges, plane faces and support functions; and the polytopes of planes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError, cKDTree

from scan3d.arrays import AT_ONCE, NEGLIGIBLE, ROUNDING, Array, Index, highest, ranges, unit_or_zero
from scan3d.errors import InputError
from scan3d.geometry.convexity import outward_faces, outward_facets
from scan3d.geometry.distance import locator, nearest
from scan3d.geometry.triangles import areas, distance_to, dot, longest_first, representatives, spanned, without_unused


def hull(points: Array) -> Any:
    """Convex hull of points (n, 3) as a `trimesh.Trimesh` with outward faces.

    Raises InputError if the points do not span a body.
    """
    qhull = _spanned_hull(points)[0]
    faces = outward_facets(qhull)
    if faces is None:
        # between points that coincide to 1e-11 of their extent Qhull leaves edges with one face, or with three
        apart = np.unique(representatives(qhull.points, 1e-11))
        return hull(points[apart]) if len(apart) < len(points) else _mesh(points, _by_planes(qhull))
    return _mesh(points, faces)


def _spanned_hull(points: Array) -> tuple[ConvexHull, Array, float]:
    """The hull of points (n, 3) less their centre (3,) and over their size, with both; raises InputError as `hull`."""
    if not len(points):
        raise _no_body(points)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    size = float(np.ptp(points, axis=0).max()) or 1.0
    scaled = (points - centre) / size
    try:
        try:
            qhull = ConvexHull(scaled)
        except QhullError:
            if np.linalg.svd(scaled - scaled.mean(axis=0), compute_uv=False)[-1] < NEGLIGIBLE * np.sqrt(len(scaled)):
                raise
            qhull = ConvexHull(scaled, qhull_options="Qt Q12")  # many nearly coplanar points make wide facets
        rounding = 4 * np.finfo(float).eps * float(np.abs(points).max()) / size
        if not qhull.volume > max(ROUNDING, rounding) * qhull.area:
            raise QhullError
    except (QhullError, ValueError, IndexError):
        raise _no_body(points) from None
    return qhull, centre, size


def distance_from_hull(points: Array) -> Callable[[Array], Array]:
    """The distances (p,) of points (p, 3) from the hull of points (n, 3), 0 inside; raises InputError as `hull`.

    As `nearest_on` of `hull`, in half the time for few of them.
    """
    qhull, centre, size = _spanned_hull(points)
    triangles = qhull.points[qhull.simplices]
    triangles = np.take_along_axis(triangles, longest_first(triangles)[:, :, None], axis=1)
    locate, middle = locator(triangles), qhull.points[qhull.vertices].mean(axis=0)

    def distances(sought: Array) -> Array:
        sought = (sought - centre) / size
        face, foot = locate(sought)
        outside = dot(sought - foot, foot - middle) > 0
        return np.where(outside, distance_to(sought, triangles[face]), 0.0) * size

    return distances


def hull_about_mean(points: Array) -> ConvexHull | None:
    """Qhull's hull of points (n, d) less their mean, where rounding is least; None if they do not span a body."""
    if len(points) <= points.shape[1]:
        return None
    try:
        return ConvexHull(points - points.mean(axis=0))
    except (QhullError, ValueError):
        return None


def support_of(qhull: ConvexHull) -> Callable[[Array], Array]:
    """The support function (d,) of Qhull's hull in directions (d, 3), to rounding, in a small part of the time of `highest`.

    From a vertex of the facet with the nearest normal, edges lead up to the highest vertex.
    """
    points, facets = qhull.points[qhull.vertices], np.searchsorted(qhull.vertices, np.sort(qhull.simplices, axis=1))
    sides = facets[:, [[0, 1], [0, 2], [1, 2]]].reshape(-1, 2)
    links = np.unique(np.concatenate([sides, sides[:, ::-1]]), axis=0)
    degree = np.bincount(links[:, 0], minlength=len(points))
    first = np.cumsum(degree) - degree
    facing = cKDTree(qhull.equations[:, :3])

    def support(directions: Array) -> Array:
        at = facets[facing.query(unit_or_zero(directions))[1], 0]
        height = dot(directions, points[at])
        rows = np.arange(len(at))
        while len(rows):
            which, place = ranges(degree[at[rows]])
            beside = links[first[at[rows]][which] + place, 1]
            heights = dot(directions[rows][which], points[beside])
            best = np.maximum.reduceat(heights, np.flatnonzero(place == 0))
            higher = best > height[rows]
            up = np.flatnonzero((heights == best[which]) & higher[which])
            at[rows[which[up]]], height[rows] = beside[up], np.maximum(best, height[rows])
            rows = rows[higher]
        return height

    return support


def hull_near(points: Array, faces: Index) -> Any:
    """`hull` of points (n, 3) from the faces (m, 3) of a closed mesh, in a fraction of the time if it is convex."""
    middle, size = points.mean(axis=0), float(np.ptp(points, axis=0).max())
    found = outward_faces((points - middle) / size, faces) if size > 0 else None
    return hull(points) if found is None else _mesh(points, found)


def _no_body(points: Array) -> InputError:
    return InputError(
        f"the {len(points)} contacts span no body: a surface needs contacts in at least two slices, not all in one plane"
    )


def _by_planes(qhull: ConvexHull) -> Index:
    """The facets (m, 3), each turned by its own plane, which leaves the sides of slivers to rounding."""
    faces: Index = qhull.simplices.astype(np.int64)
    inward = dot(spanned(qhull.points[faces]), qhull.equations[:, :3]) < 0
    faces[inward] = faces[inward, ::-1]
    return faces


def _mesh(points: Array, faces: Index) -> Any:
    import trimesh

    used, renumbered = without_unused(faces)
    return trimesh.Trimesh(points[used], renumbered, process=False)


def shrunk(body: Any, distance: float) -> Any:
    """A convex body scaled about a point of it, so that it lies in the body deeper than `distance`; None if it is too thin."""
    centre, factor = shrunk_by(body, distance)
    return hull(centre + factor * (body.vertices.view(np.ndarray) - centre)) if factor > 0 else None


def shrunk_by(body: Any, distance: float) -> tuple[Array, float]:
    """The mean (3,) of a convex body's vertices, and the factor of `shrunk` by which the body is scaled about it.

    The support function about that point is at least its depth, and falls by the depth's part of itself.
    """
    centre = body.vertices.view(np.ndarray).mean(axis=0)
    depth = -float(nearest(centre[None], body)[0][0])
    return centre, 1 - distance / depth if depth > 0 else -np.inf


def offset_inwards(body: Any, distance: float) -> Any:
    """What lies in a convex body deeper than `distance`, up to rounding; None if that is nothing.

    If the body is another one fattened by a ball of that radius, that is the other one; of a part of it, a part.
    """
    middle = body.bounds.mean(axis=0)
    vertices, faces = body.vertices.view(np.ndarray) - middle, body.faces.view(np.ndarray)
    size = float(np.abs(vertices).max())
    spread = spanned(vertices[faces])
    area = np.linalg.norm(spread, axis=1)
    normals = spread[area > 0] / area[area > 0, None]
    values = dot(normals, vertices[faces[area > 0, 0]]) - distance - ROUNDING * size
    inside = vertices.mean(axis=0)
    if not (values - normals @ inside > NEGLIGIBLE * size).all():
        columns = np.column_stack([normals, np.ones(len(normals))])
        deepest = linprog([0, 0, 0, -1], A_ub=columns, b_ub=values, bounds=[(None, None)] * 3 + [(None, size)])
        if deepest.status != 0 or deepest.x[3] <= NEGLIGIBLE * size:
            return None
        inside = deepest.x[:3]
    try:
        corners = half_space_intersection(np.column_stack([normals, -values]), inside).intersections
        return hull(corners[np.isfinite(corners).all(axis=1)] + middle)
    except (QhullError, InputError):
        return None


def edges_of(hull: ConvexHull) -> tuple[Index, Index]:
    """The numbers (h,) of a hull's vertices among its points, and its edges (m, 2) by numbers of the vertices."""
    vertices = np.unique(hull.simplices)
    number = np.zeros(len(hull.points), dtype=np.intp)
    number[vertices] = np.arange(len(vertices))
    faces = number[hull.simplices]
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    codes = np.unique(sides[:, 0] * len(vertices) + sides[:, 1])
    return vertices, np.stack([codes // len(vertices), codes % len(vertices)], axis=1)


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
    try:
        equations = ConvexHull(vertices).equations
    except QhullError:  # between points that coincide up to rounding
        apart = np.unique(representatives(vertices, NEGLIGIBLE * size))
        equations = ConvexHull(vertices[apart], qhull_options="Qt Q12").equations
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
