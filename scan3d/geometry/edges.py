"""Convexity of a closed mesh by its edges, in linear time.

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
"""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array, Index
from scan3d.geometry.triangles import areas, dot, largest_of_three, spanned
from scan3d.geometry.vectors import unit_or_zero

# Rounding of the sine of an edge's angle, divided by the slenderness of its faces, in units of the last place.  Larger, edges
# between nearly coplanar faces count as reflex that are not; smaller, rounding could hide a reflex edge.
_ROUNDING = 8
# Largest error of the number of turns, and of coordinates of unit size.  Larger, surfaces with holes would pass; smaller, the
# rounding of the solid angles of fine meshes would count as one.
_MISSING_TURN, _COORDINATES = 1e-6, 1e-15
# Largest product s R of the proof above, by which the hull is larger.  Larger, bounds are returned that are of no use.
_LARGEST_EXCESS = 0.1


def opposite_edges(faces: Index) -> Index | None:
    """For each directed edge (m, 3) of faces (m, 3), from a corner to the next, the number of the same edge in the opposite
    direction, with ``3 f + k`` for the edge of the face f that begins at its corner k.

    None unless every edge belongs to exactly two faces, which run through it in opposite directions.
    """
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    up, down, count = np.flatnonzero(start < end), np.flatnonzero(start > end), int(faces.max(initial=-1)) + 1
    if len(up) != len(down) or len(up) + len(down) < faces.size:
        return None
    edge, reverse = start[up] * count + end[up], end[down] * count + start[down]
    order, reverse_order = np.argsort(edge), np.argsort(reverse)
    edge, up, down = edge[order], up[order], down[reverse_order]
    if (edge[1:] == edge[:-1]).any() or not np.array_equal(edge, reverse[reverse_order]):
        return None
    opposite = np.empty(faces.size, dtype=np.int64)
    opposite[up], opposite[down] = down, up
    return opposite.reshape(-1, 3)


def outward_faces(points: Array, faces: Index, opposite: Index | None = None) -> Index | None:
    """The triangles (m, 3) of points (n, 3) at unit size, turned outwards, if their edges prove that they are the facets of a
    strictly convex body; None otherwise.  Their `opposite_edges` (m, 3) may be given."""
    corners = points[faces]
    normals = unit_or_zero(spanned(corners))
    planes, bound = planes_by_edges(faces, corners, normals, opposite)
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
    error = _ROUNDING * np.finfo(np.float64).eps * largest_of_three(dot(edges, edges)) / (2 * area)
    depth = (outwards * depths).min(axis=1) - big_r * error
    if depth.min() <= _COORDINATES or abs(outwards * turns(rays) - 1) > _MISSING_TURN:
        return unproven
    number, sines = _reflex_edges(opposite, edges, outwards * normals, error, outwards)
    steepest = depth[number // 3] * depth[opposite.ravel()[number] // 3]
    excess = float((sines * lengths.ravel()[number] / steepest).sum()) / 2 * big_r
    if excess > _LARGEST_EXCESS:
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
