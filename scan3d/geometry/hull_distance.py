"""Bounds of the distance between a triangle mesh and its convex hull, tight for meshes that are convex but for rounding."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from scan3d.arrays import Array, Index
from scan3d.geometry.distance import bounding_box, welded
from scan3d.geometry.edges import opposite_edges, planes_by_edges, turns
from scan3d.geometry.flips import without_slivers
from scan3d.geometry.triangles import areas, dot, mirrored_faces, spanned
from scan3d.geometry.vectors import unit_or_zero

if TYPE_CHECKING:
    import trimesh

# All depths are relative to the diagonal of the bounding box.
# A surface less deep than this below its hull counts as convex.  Larger, real dents would be taken for rounding; smaller,
# rounding for dents, which costs time and tight bounds.
CONVEX_DEPTH = 1e-9
# A surface with more faces deeper than this than can be examined counts as not convex.  Larger, its bound may be so wide that
# the search that uses it gains nothing; smaller, single-precision files of fine meshes would lose their tight bounds.
NEAR_CONVEX_DEPTH = 1e-4
# Depth of a face below which it is not examined further where only the distance to the hull is wanted.  Larger, the bound of
# a convex surface grows; smaller, faces are examined whose depth is rounding only.
_PRECISION = 1e-10
# Upper bound of the distances between faces and planes that are computed for one surface.  Larger, fine meshes that are not
# convex take longer; smaller, the bounds of fine meshes that nearly are convex become wide or infinite.
_MAX_DISTANCES = 200_000_000
# Number of these distances that are computed at once.  More need more memory (8 bytes each); fewer take more calls.
_DISTANCES_AT_ONCE = 4_000_000
# Largest fraction of the full solid angle that may lack a surface.  Larger, holes would count that are seen as such; smaller,
# the rounding of the solid angles of fine meshes would count as a hole.
_MAX_HOLE = 1e-6
# Rounding of that fraction, which is added to it in an open surface.  Larger, the bounds of open surfaces are wider; smaller,
# they might not be certain.
_HOLE_ROUNDING = 1e-14


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
    closed = opposite is not None
    if not closed:
        start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
        closed = np.array_equal(np.sort(start * len(vertices) + end), np.sort(end * len(vertices) + start))
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
    return against_hull(facets, _PRECISION)[1] * scale


def _wound_alike(facets: Facets) -> Facets:
    """A closed surface with all faces wound alike; the facets unchanged if it is not closed, or in several parts.

    The winding of a face without area, as Qhull makes them, is due to rounding, and would make a hull look open.
    """
    kept = (facets.faces != np.roll(facets.faces, 1, axis=1)).all(axis=1)
    faces, corners = facets.faces[kept], facets.corners[kept]
    mirrored = mirrored_faces(faces)
    if mirrored is None:
        return facets
    # in this order the longest edge stays first
    faces[mirrored], corners[mirrored] = faces[mirrored][:, [1, 0, 2]], corners[mirrored][:, [1, 0, 2]]
    return facets._replace(faces=faces, corners=corners, normals=facets.normals[kept], closed=True, opposite=None)


def _planes(points: Array) -> Array:
    """Planes (k, 4) of the convex hull of points: n and c with <n, x> = c, n outward; (0, 4) if the points are flat."""
    try:
        return np.unique(ConvexHull(points).equations, axis=0) * [1, 1, 1, -1]
    except (QhullError, ValueError):
        return np.empty((0, 4))


def _after_flips(vertices: Array, faces: Index, opposite: Index, precision: float) -> tuple[Array, float]:
    """`planes_by_edges` of a closed mesh without its slivers, with the distance added by which that moves the surface."""
    faces, opposite, moved = without_slivers(vertices, faces, opposite, precision)
    corners = vertices[faces]
    planes, distance = planes_by_edges(faces, corners, unit_or_zero(spanned(corners)), opposite)
    return planes, distance + moved


def against_hull(facets: Facets, precision: float = CONVEX_DEPTH / 10) -> tuple[Array, float]:
    """A supporting plane (m, 4) for every face, and a bound of the distance between the surface and the surface of its hull.

    They follow from the edges of a closed surface without its hull, if need be after flips that remove slivers, where the bound
    is then no larger than `precision`; after flips some planes are those of other faces nearby.  Otherwise the surface is held
    against the hull's planes.  The depth below the hull's surface is concave on a face and not negative, so
    it is nowhere more than three times that of the face's middle.  If the surface winds once around a point c inside, every ray
    from c meets the surface, at no more than the largest depth; along the ray the hull's surface is within depth * R / r, with
    r and R the smallest and the largest distance of c from it.  Faces that are known to be no deeper than `precision` are not
    examined further.
    """
    vertices, faces, corners, normals, closed, _, opposite = facets
    if closed:
        opposite = opposite_edges(faces) if opposite is None else opposite
        planes, distance = planes_by_edges(faces, corners, normals, opposite)
        if distance <= precision:
            return planes, distance
        if opposite is not None:
            planes, distance = _after_flips(vertices, faces, opposite, precision)
            if distance <= precision:
                return planes, distance
    unbounded = np.empty((0, 4)), np.inf
    planes = _planes(vertices)
    if len(planes) == 0:
        return unbounded
    middles = corners.mean(axis=1)
    c = np.average(middles, axis=0, weights=areas(corners))
    r = float((planes[:, 3] - planes[:, :3] @ c).min())
    big_r = float(np.linalg.norm(vertices - c, axis=1).max())

    missing = abs(abs(turns(corners - c)) - 1)
    if r <= 0 or missing > _MAX_HOLE:
        return unbounded
    # The part that an open surface leaves uncovered has room for a disc of this radius; a closed surface covers everything.
    hole = 0.0 if closed else 2 * np.sqrt(missing + _HOLE_ROUNDING) * big_r

    outward = normals * np.where(dot(middles - c, normals) < 0, -1, 1)[:, None]
    chosen = cKDTree(planes[:, :3], balanced_tree=False).query(outward, workers=-1)[1]
    depth = planes[chosen, 3] - dot(planes[chosen, :3], middles)
    # The normal of a sliver is rounding, and may choose a plane far away.  All planes are tried on the deepest faces.
    order = np.argsort(-depth)
    trials = max(1, _MAX_DISTANCES // len(planes))
    if depth[order[trials - 1 :]].max(initial=0.0) > NEAR_CONVEX_DEPTH:
        return unbounded
    deepest = order[:trials][depth[order[:trials]] > precision]
    for part in np.array_split(deepest, 1 + len(deepest) * len(planes) // _DISTANCES_AT_ONCE):
        depths = planes[:, 3] - middles[part] @ planes[:, :3].T
        chosen[part], depth[part] = depths.argmin(axis=1), depths.min(axis=1)
    return planes[chosen], (3 * max(float(depth.max()), 0.0) + hole) * big_r / r
