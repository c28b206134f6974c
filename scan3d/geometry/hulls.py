"""Convex bodies, as hulls of points, as polytopes of planes, and as meshes that are nearly convex.

How far a mesh is from its hull follows from its edges, in linear time, or else from the planes of the hull.

Let every edge of a closed mesh belong to two faces that run through it in opposite directions, let a point c lie below the
planes of all faces by at least r, let the surface wind once around c, and lie within R of it.  Then every ray from c meets the
surface exactly once.  If also no edge is reflex, the body is locally convex, and therefore convex (Tietze and Nakajima).

If some edges are reflex, or may be because of rounding, the surface is nevertheless near that of its hull.  Let g be the gauge
function of the body about c: it is 1 on the surface, and on the cone over a face of unit normal n and depth d it is
``<n, x> / d``.  Across the cone over an edge its gradient changes by k m, with the unit vector m normal to the plane through c
and the edge, and k positive where the edge is convex, since g is continuous.  For an angle φ between the faces k is
``h sin(φ) / (d d')``, with the depths d and d' of the faces and the distance h of the edge's line from c.  Add to g, for every
reflex edge, ``|k| |<m, x>| / 2``, which changes its gradient by |k| m there.  The sum g' is convex, because a continuous
function that is linear on cones is convex if its gradient changes so across all their walls.  With the sum s of all
``|k| / 2``, g <= g' <= g + s |x|, so that the body of g' <= 1 is convex, lies in the body K, and contains K scaled about c
by ``1 / (1 + s R)``.  So the hull of K lies in K scaled by ``1 + s R``, and along each ray from c the two surfaces are within
``s R²``.  The plane of a face, on whose cone g' has the gradient n / d up to s, is exceeded by no point of the hull by more
than ``2 s R d``.

Points are in float64 at unit size about the centre of the bounding box, and depths relative to its diagonal, so that the unit
of length does not matter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError, cKDTree

from scan3d.arrays import AT_ONCE, NEGLIGIBLE, ROUNDING, Array, Index, highest, ranges, unit_or_zero
from scan3d.errors import InputError, NoBodyError
from scan3d.geometry.distance import bounding_box, check_mesh, nearest, poly_data, welded
from scan3d.geometry.triangles import (
    areas,
    dot,
    largest_of_three,
    linked,
    mirrored_faces,
    opposite_edges,
    representatives,
    spanned,
    without_unused,
)

if TYPE_CHECKING:
    import trimesh


# Rounding of coordinates of unit size.
_COORDINATES = 1e-15
ROUNDED = 1e-11
"""Rounding of contacts, and of what is computed from them, relative to the body: a hundred times that of the wrench.  What
sticks out of a hull by no more is none of its vertices, so that the last digits do not decide how many it has."""
CONVEX_DEPTH = NEGLIGIBLE
"""A surface less deep than this below its hull counts as convex: such depths are rounding."""
NEAR_CONVEX_DEPTH = 1e-4
"""A surface with more faces deeper than this than can be examined counts as not convex."""
DENT_TOLERANCE = 1e-5
"""Deepest dent of a body that counts as convex: touch cannot tell it from its hull, and float32 files of fine meshes and CAD
exports have dents of 1e-7 to 1e-6 from rounding alone."""
HULL_OF_MESH = "convex hull of the mesh"
"""What a body is called that was taken in the place of a mesh that is not convex."""


def outward_faces(points: Array, faces: Index) -> Index | None:
    """The triangles (m, 3) of points (n, 3) at unit size, turned outwards, if their edges prove that they are the facets of a
    strictly convex body; None otherwise."""
    corners = points[faces]
    normals = unit_or_zero(spanned(corners))
    planes, bound = planes_by_edges(faces, corners, normals)
    if bound > _COORDINATES:  # an edge is reflex, or may be
        return None
    return faces if dot(planes[0, :3], normals[0]) > 0 else faces[:, ::-1]


def planes_by_edges(faces: Index, corners: Array, normals: Array, opposite: Index | None = None) -> tuple[Array, float]:
    """Planes (m, 4) of the faces of a closed mesh, and an upper bound of the Hausdorff distance between its surface and that of
    its convex hull.

    faces (m, 3), corners (m, 3, 3)
        vertices of the faces, and where they are, at unit size.
    normals (m, 3)
        unit normals, zero where a face has no area.
    opposite (m, 3)
        `opposite_edges` of the faces, where they are known.

    A plane is n and c with ``<n, x> <= c`` for all points x of the hull, rounding included.  Where the edges do not prove the
    mesh to be nearly convex there are no planes, and the bound is infinite.
    """
    unproven = np.empty((0, 4)), np.inf
    opposite = opposite_edges(faces) if opposite is None else opposite
    if opposite is None or not (dot(normals, normals) > 0).all():
        return unproven
    area = areas(corners)
    c = np.average(corners.mean(axis=1), axis=0, weights=area)
    rays = corners - c
    lengths = np.sqrt(dot(rays, rays))
    depths = dot(rays, normals[:, None])
    outwards, big_r = 1.0 if depths.sum() > 0 else -1.0, float(lengths.max())
    edges = np.roll(corners, -1, axis=1) - corners
    # a normal is wrong by rounding times the longest edge divided by the height above it, length² / (2 area)
    # to 8 units in the last place
    error = 8 * np.finfo(np.float64).eps * largest_of_three(dot(edges, edges)) / (2 * area)
    depth = (outwards * depths).min(axis=1) - big_r * error
    if depth.min() <= _COORDINATES or abs(outwards * turns(rays) - 1) > 1e-6:  # of a turn
        return unproven
    number, sines = _reflex_edges(opposite, edges, outwards * normals, error, outwards)
    steepest = depth[number // 3] * depth[opposite.ravel()[number] // 3]
    excess = float((sines * lengths.ravel()[number] / steepest).sum()) / 2 * big_r
    # larger bounds are of no use
    if excess > 0.1:
        return unproven
    heights = largest_of_three(dot(corners, outwards * normals[:, None]))
    planes = np.column_stack([outwards * normals, heights + 2 * big_r * (error + excess) + _COORDINATES])
    return planes, excess * big_r + _COORDINATES


def _reflex_edges(opposite: Index, edges: Array, normals: Array, error: Array, outwards: float) -> tuple[Index, Array]:
    """The edges (e,) that are reflex, or that may be by the errors (m,) of the outward normals (m, 3), and upper bounds (e,) of
    the sines of their angles.

    An edge has the number ``3 f + k`` of one of its sides.  `outwards` is -1 where the edges (m, 3, 3) run around the outward
    normals clockwise.
    """
    number = np.flatnonzero(opposite.ravel() > np.arange(opposite.size))  # each edge once
    one, other = number // 3, opposite.ravel()[number] // 3
    edge = edges.reshape(-1, 3)[number]
    sine = outwards * dot(np.cross(normals[one], normals[other]), edge) / np.sqrt(dot(edge, edge))
    reflex = error[one] + error[other] - sine
    doubtful = reflex > 0
    return number[doubtful], reflex[doubtful]


def turns(rays: Array) -> float:
    """How often triangles (m, 3, 3) wind around the origin, positive if they are wound to the outside.

    The solid angle of a triangle is that of Van Oosterom and Strackee (1983).
    """
    length = np.sqrt(dot(rays, rays))
    cosines = (dot(rays, np.roll(rays, -1, axis=1)) * np.roll(length, 1, axis=1)).sum(axis=1)
    sines = dot(rays[:, 0], np.cross(rays[:, 1], rays[:, 2]))
    return float(np.arctan2(sines, length.prod(axis=1) + cosines).sum()) / (2 * np.pi)


@dataclass(frozen=True)
class Facets:
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
    opposite: Index | None = None
    """(m, 3) `opposite_edges`, where every edge has one."""


def prepare_facets(mesh: trimesh.Trimesh, centre: Array, scale: float) -> Facets:
    """A mesh moved by ``-centre`` and divided by `scale`, each vertex once."""
    vertices, faces = welded(mesh, centre, scale)
    corners = vertices[faces]
    cross = spanned(corners)
    normals = unit_or_zero(cross)
    # Closed: every directed edge meets its reverse, so that the boundary is zero as a chain.
    opposite = opposite_edges(faces)
    closed = opposite is not None or runs_both_ways(faces)
    volume = abs(float(dot(corners[:, 0], cross).sum())) / 6 if closed else np.nan
    return Facets(vertices, faces, corners, normals, closed, volume, opposite)


def distance_to_hull(mesh: trimesh.Trimesh) -> float:
    """Upper bound of the Hausdorff distance between a mesh and the surface of its convex hull, in the mesh's unit.

    It is infinite if the mesh is flat, if it does not wind once around its middle, or if more of its faces than can be examined
    lie deeper than `NEAR_CONVEX_DEPTH`.  Raises InputError as `scan3d.compare`.
    """
    box = bounding_box(mesh, "surface")
    scale = float(np.linalg.norm(box[1] - box[0]))
    facets = prepare_facets(mesh, box.mean(axis=0), scale)
    if not facets.closed:
        facets = _wound_alike(facets)
    return against_hull(facets)[1] * scale


def _wound_alike(facets: Facets) -> Facets:
    """A closed surface with all faces wound alike; the facets unchanged if it is not closed, or in several parts.

    The winding of a face without area, as Qhull makes them, is due to rounding, and would make a hull look open.
    """
    kept = (facets.faces != np.roll(facets.faces, 1, axis=1)).all(axis=1)
    faces, corners = facets.faces[kept], facets.corners[kept]
    mirrored, is_closed = mirrored_faces(faces)
    if not is_closed:
        return facets
    # in this order the longest edge stays first
    faces[mirrored], corners[mirrored] = faces[mirrored][:, [1, 0, 2]], corners[mirrored][:, [1, 0, 2]]
    return replace(facets, faces=faces, corners=corners, normals=facets.normals[kept], closed=True, opposite=None)


def _planes(points: Array) -> Array:
    """Planes (k, 4) of the convex hull of points: n and c with <n, x> = c, n outward; (0, 4) if the points are flat."""
    try:
        return np.unique(ConvexHull(points).equations, axis=0) * [1, 1, 1, -1]
    except (QhullError, ValueError):
        return np.empty((0, 4))


def against_hull(facets: Facets) -> tuple[Array, float]:
    """A supporting plane (m, 4) for every face, and a bound of the distance between the surface and the surface of its hull.

    They follow from the edges of a closed surface without its hull, where the bound is then a tenth of `CONVEX_DEPTH` at most.
    Otherwise the surface is held against the hull's planes.  The depth below the hull's surface is concave on a face and not
    negative, so it is nowhere more than three times that of the face's middle.  If the surface winds once around a point c
    inside, every ray from c meets the surface, at no more than the largest depth; along the ray the hull's surface is within
    depth * R / r, with r and R the smallest and the largest distance of c from it.  Faces that are known to be no deeper than a
    tenth of `CONVEX_DEPTH` are not examined further.
    """
    vertices, corners, normals, closed = facets.vertices, facets.corners, facets.normals, facets.closed
    if closed:
        planes, distance = planes_by_edges(facets.faces, corners, normals, facets.opposite)
        if distance <= CONVEX_DEPTH / 10:
            return planes, distance
    unbounded = np.empty((0, 4)), np.inf
    planes, size = _planes(vertices), areas(corners)
    if len(planes) == 0 or not size.any():
        return unbounded
    middles = corners.mean(axis=1)
    c = np.average(middles, axis=0, weights=size)
    r = float((planes[:, 3] - planes[:, :3] @ c).min())
    big_r = float(np.linalg.norm(vertices - c, axis=1).max())

    missing = abs(abs(turns(corners - c)) - 1)
    if r <= 0 or missing > 1e-6:  # of the full solid angle, rounding included
        return unbounded
    # The part that an open surface leaves uncovered has room for a disc of this radius; a closed surface covers everything.
    hole = 0.0 if closed else 2 * np.sqrt(missing + 1e-14) * big_r

    outward = normals * np.where(dot(middles - c, normals) < 0, -1, 1)[:, None]
    chosen = cKDTree(planes[:, :3], balanced_tree=False).query(outward, workers=-1)[1]
    depth = planes[chosen, 3] - dot(planes[chosen, :3], middles)
    # The normal of a sliver is rounding, and may choose a plane far away.  All planes are tried on the deepest faces.
    order = np.argsort(-depth)
    # so many distances of planes at most, which limits the time
    trials = max(1, 200_000_000 // len(planes))
    if depth[order[trials - 1 :]].max(initial=0.0) > NEAR_CONVEX_DEPTH:
        return unbounded
    deepest = order[:trials][depth[order[:trials]] > CONVEX_DEPTH / 10]
    for part in np.array_split(deepest, 1 + len(deepest) * len(planes) // AT_ONCE):
        depths = planes[:, 3] - middles[part] @ planes[:, :3].T
        chosen[part], depth[part] = depths.argmin(axis=1), depths.min(axis=1)
    return planes[chosen], (3 * max(float(depth.max()), 0.0) + hole) * big_r / r


def outward_facets(qhull: ConvexHull) -> Index | None:
    """The facets (h, 3) of a hull, which Qhull orients at random, counterclockwise from outside; None if they are no closed
    surface."""
    facets: Index = qhull.simplices.astype(np.int64)
    mirrored, is_closed = mirrored_faces(facets)
    if not is_closed:
        return None
    facets[mirrored] = facets[mirrored, ::-1]
    return facets[:, ::-1] if np.linalg.det(qhull.points[facets]).sum() < 0 else facets


def is_convex(mesh: Any) -> bool:
    """Whether a closed `trimesh.Trimesh` is convex within rounding, as judged when it was read, or else by its shape."""
    if not was_judged(mesh):
        deviation = distance_to_hull(mesh)
        vertices = np.asarray(mesh.vertices)[without_unused(np.asarray(mesh.faces))[0]]
        # twice, because a body that was judged may have been moved, which rounds its vertices
        convex = bool(deviation <= 2 * DENT_TOLERANCE * float(np.linalg.norm(np.ptp(vertices, axis=0))))
        judged_convex(mesh, convex)
    return bool(mesh.metadata["convex"][1])


def was_judged(mesh: Any) -> bool:
    """Whether a mesh has been judged convex or not, and its vertices have stayed."""
    return bool(mesh.metadata.get("convex", (None,))[0] == hash(mesh.vertices))


def judged_convex(mesh: Any, convex: bool) -> None:
    """Keep with a mesh, as long as its vertices stay, whether it is convex."""
    mesh.metadata["convex"] = hash(mesh.vertices), convex


def runs_both_ways(faces: Index) -> bool:
    """Whether faces (m, 3) run through every edge as often one way as the other, as those of closed surfaces do."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    size = int(faces.max(initial=-1)) + 1
    return bool(np.array_equal(np.sort(start * size + end), np.sort(end * size + start)))


def check_convex(mesh: Any, what: str) -> None:
    """Raises InputError, which names what is for convex bodies only, for a closed body that is not convex."""
    if not is_convex(mesh):
        raise InputError(
            f"{what} is for convex bodies, and this one is not convex; scan it by the planar model, or its hull with --hull"
        )


def turned_alike(faces: Index) -> Index:
    """Faces (m, 3) turned so that neighbours run through their common edge in opposite directions, if they do not yet."""
    return faces if runs_both_ways(faces) else np.where(mirrored_faces(faces)[0][:, None], faces[:, ::-1], faces)


def check_body(mesh: Any) -> None:
    """Raises InputError unless a mesh is a closed `trimesh.Trimesh`, as bodies that are scanned must be."""
    check_mesh(mesh, "body")
    if not (is_convex(mesh) or runs_both_ways(np.asarray(mesh.faces, dtype=np.int64))):
        raise InputError(
            "the body isn't a closed surface whose faces are turned alike; repair it, as scan3d.scan does where it can, or to "
            "scan the hull instead give mesh.convex_hull"
        )


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


def vertices_of(points: Array) -> Index:
    """The numbers (v,) of points (n, 3) that are vertices of their hull by more than rounding; raises InputError as `hull`."""
    return np.unique(_spanned_hull(points)[0].simplices)


def _spanned_hull(points: Array) -> tuple[ConvexHull, Array, float]:
    """The hull of points (n, 3) less their centre (3,) and over their size, with both; raises InputError as `hull`."""
    if not len(points):
        raise _no_body(points)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    size = float(np.ptp(points, axis=0).max()) or 1.0
    scaled = (points - centre) / size
    try:
        try:
            qhull = ConvexHull(scaled, qhull_options=f"Qt E{ROUNDED:g}")
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

    To rounding, which slivers of the hull enlarge, in a third of the time of `nearest_on`.
    """
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkDoubleArray
    from vtkmodules.vtkFiltersCore import vtkImplicitPolyDataDistance

    qhull, centre, size = _spanned_hull(points)
    corners, faces = without_unused(_by_planes(qhull))
    distance = vtkImplicitPolyDataDistance()
    distance.SetInput(poly_data(qhull.points[corners], faces))

    def distances(sought: Array) -> Array:
        found = vtkDoubleArray()
        distance.FunctionValue(numpy_to_vtk((sought - centre) / size, deep=True), found)
        return np.maximum(vtk_to_numpy(found), 0.0) * size

    return distances


def hull_about_mean(points: Array) -> ConvexHull | None:
    """Qhull's hull of points (n, d) less their mean, where rounding is least; None if they do not span a body."""
    if len(points) <= points.shape[1]:
        return None
    try:
        return ConvexHull(points - points.mean(axis=0))
    except (QhullError, ValueError):
        return None


class Corners:
    """The vertices of Qhull's hull, which its edges link, so that what is highest is found without looking at all of them."""

    def __init__(self, qhull: ConvexHull) -> None:
        vertices, edges = edges_of(qhull)
        self.points: Array = qhull.points[vertices]
        """(v, 3)"""
        self._facets, self._facing = np.searchsorted(vertices, qhull.simplices), cKDTree(qhull.equations[:, :3])
        links = np.concatenate([edges, edges[:, ::-1]])
        links = links[np.lexsort(links.T[::-1])]
        self._beside, self._degree = links[:, 1], np.bincount(links[:, 0], minlength=len(vertices))
        self._first = np.cumsum(self._degree) - self._degree

    def beside(self, at: Index) -> tuple[Index, Index, Index]:
        """The vertices (k,) that edges link to those with numbers (n,): which of the n it is, how often that came before, and
        their own numbers."""
        which, place = ranges(self._degree[at])
        return which, place, self._beside[self._first[at][which] + place]

    def highest(self, directions: Array) -> Index:
        """The numbers (d,) of the vertices that lie highest in directions (d, 3).

        From a vertex of the facet with the nearest normal, edges lead up.
        """
        at = self._facets[self._facing.query(unit_or_zero(directions))[1], 0]
        height, rows = dot(directions, self.points[at]), np.arange(len(at))
        while len(rows):
            which, place, beside = self.beside(at[rows])
            heights = dot(directions[rows][which], self.points[beside])
            best = np.maximum.reduceat(heights, np.flatnonzero(place == 0))
            higher = best > height[rows]
            up = np.flatnonzero((heights == best[which]) & higher[which])
            at[rows[which[up]]], height[rows] = beside[up], np.maximum(best, height[rows])
            rows = rows[higher]
        return at


def support_of(qhull: ConvexHull) -> Callable[[Array], Array]:
    """The support function (d,) of Qhull's hull in directions (d, 3), to rounding, in a small part of the time of `highest`."""
    corners = Corners(qhull)
    return lambda directions: dot(directions, corners.points[corners.highest(directions)])


def hull_near(points: Array, faces: Index) -> Any:
    """`hull` of points (n, 3) from the faces (m, 3) of a closed mesh, in a fraction of the time if it is convex."""
    middle, size = points.mean(axis=0), float(np.ptp(points, axis=0).max())
    found = outward_faces((points - middle) / size, faces) if size > 0 else None
    return hull(points) if found is None else _mesh(points, found)


def _no_body(points: Array) -> NoBodyError:
    few = "one contact spans" if len(points) == 1 else f"the {len(points)} contacts span"
    return NoBodyError(
        f"{few} no body: a surface needs contacts that do not all lie in one plane, as those of one slice do"
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


def shrunk(body: Any, distance: float, least: float = 0.0) -> Any:
    """A convex body scaled about the mean of its vertices, so that it lies in the body deeper than `distance`, or by a `least`
    factor where it is too thin for that; None without one.

    The support function about that point is at least its depth, and falls by the depth's part of itself.
    """
    vertices = body.vertices.view(np.ndarray)
    centre = vertices.mean(axis=0)
    depth = -float(nearest(centre[None], body)[0][0])
    factor = max(1 - distance / depth if depth > 0 else -np.inf, least)
    return hull(centre + factor * (vertices - centre)) if factor > 0 else None


def offset_inwards(body: Any, distance: float) -> Any:
    """What lies in a convex body deeper than `distance`, up to rounding; None if that is nothing.

    If the body is another one fattened by a ball of that radius, that is the other one; of a part of it, a part.
    """
    middle = body.bounds.mean(axis=0)
    vertices = body.vertices.view(np.ndarray) - middle
    size = float(np.abs(vertices).max())
    # slivers, and faces that are turned over where many are nearly in one plane, have other normals
    planes = _planes(vertices)
    normals, values = planes[:, :3], planes[:, 3] - distance - ROUNDING * size
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


def plane_faces(points: Array, tolerance: float) -> Array:
    """The planes (k, 4), n and c with <n, x> <= c, of the hull of points (n, 3) in which six or more of them lie."""
    qhull = ConvexHull(points)
    corners = points[qhull.simplices]
    area = areas(corners)
    planes = np.column_stack([qhull.equations[:, :3], -qhull.equations[:, 3]])
    # facets in a plane face are linked with each other, to their neighbours in it
    depths = planes[:, 3, None, None] - np.einsum("fkcx,fx->fkc", corners[qhull.neighbors], planes[:, :3])
    facet, side = np.nonzero(depths.max(axis=2) <= tolerance)
    _, group = linked(facet, qhull.neighbors[facet, side], len(planes))
    order = np.lexsort((-area, group))
    first = order[np.r_[True, np.diff(group[order]) > 0]]
    in_planes = first[np.bincount(group)[group[first]] > 3]
    faces: list[Array] = []
    # those with the largest facets first
    for plane in planes[in_planes[np.argsort(-area[in_planes], kind="stable")]][:400]:
        depth = plane[3] - points[qhull.vertices] @ plane[:3]
        near = points[qhull.vertices[depth <= tolerance]]
        known = any((np.abs(face[3] - near @ face[:3]) <= tolerance).all() for face in faces)
        if len(near) >= 6 and not known:
            faces.append(plane)
    return np.array(faces) if faces else np.empty((0, 4))


def polytope(planes: Array, inside: Array, half: float) -> Array:
    """Vertices (v, 3) of what planes (k, 4) leave of a cube about a point (3,) inside, with its faces `half` away from it."""
    cube = np.concatenate([np.eye(3), -np.eye(3)])
    return corners_of_planes(np.concatenate([np.column_stack([cube, cube @ inside + half]), planes]), inside)


def cut_polytope(first: Array, others: Array, inside: Array, size: float, tolerance: float) -> Array:
    """Vertices (v, 3) of the polytope that planes enclose: all of `first` (k, 4), and those of `others` (l, 4) that cut it.

    inside
        (3,) a point inside of all planes.
    size
        that of the body, to which the polytope is limited where the planes leave it open.
    tolerance
        depth of the smallest cut that is made.
    """
    used = np.zeros(len(others), dtype=bool)
    vertices = polytope(first, inside, 2 * size)
    for _ in range(20):
        # one vertex after another has the same planes through it, so each plane is added once
        deepest, depth = _deepest_cuts(vertices, others)
        order = np.argsort(-depth, kind="stable")
        added = np.unique(deepest[order[depth[order] > tolerance]][:500])
        added = added[~used[added]]
        if not len(added):
            break
        used[added] = True
        vertices = polytope(np.concatenate([first, others[used]]), inside, 2 * size)
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
    return corners_of_planes(np.concatenate([equations * [1, 1, 1, -1], cutting]), middle)


def _deepest_cuts(vertices: Array, planes: Array) -> tuple[Index, Array]:
    """For each vertex (v,) the plane beyond which it lies farthest, and how far."""
    blocks = np.array_split(vertices, 1 + len(vertices) * len(planes) // AT_ONCE)
    found = [(block @ planes[:, :3].T - planes[:, 3]) for block in blocks]
    plane = np.concatenate([depth.argmax(axis=1) for depth in found])
    return plane, np.concatenate([depth.max(axis=1) for depth in found])


def corners_of_planes(planes: Array, inside: Array) -> Array:
    """Vertices (v, 3) of the polytope of planes, none of which passes through or beyond the point inside."""
    offset = planes[:, 3] - planes[:, :3] @ inside
    dual = planes[offset > 0, :3] / offset[offset > 0, None]
    size = float(np.abs(dual).max())
    try:
        # planes that agree up to rounding would cross anywhere
        equations = ConvexHull(dual / size, qhull_options=f"Qt E{ROUNDED:g}").equations
        vertices: Array = inside - equations[:, :3] / equations[:, 3:] / size
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
