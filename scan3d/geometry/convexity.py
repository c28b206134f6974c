"""How far a mesh is from convex.

Convexity is judged by depth, not by a flag: the *dent* of a mesh is the largest depth of its surface below the surface of
its convex hull. A point inside a convex polyhedron lies as deep as its nearest facet plane is far, so depth is the least of
many linear functions: concave on each triangle, and bounded from above by any of them. That makes the deepest dent a
branch-and-bound search whose answer is certain, needs no neighbours (triangle soups are fine) and also finds an edge
flipped the wrong way, where every vertex lies on the hull and the surface doesn't.

Everything is computed in float64 at unit size about the centre of the box, so no unit is too small or too large.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, cKDTree

from scan3d.arrays import Array, Index
from scan3d.geometry.triangles import distinct_rows, halve, longest_first

# All relative to the diagonal of the bounding box.
DENT_TOLERANCE = 1e-5
"""Deepest dent of a body that counts as convex: float32 files of fine meshes and CAD exports have dents of 1e-7 to 1e-6
from rounding alone, and no rod feels a hundred-thousandth of the body."""
DENT_PRECISION = 1e-3
"""A dent is known to this share of itself; one below `NEGLIGIBLE_DENT` is only known to be below it."""
NEGLIGIBLE_DENT = 0.01 * DENT_TOLERANCE
_PROBES = 2_000_000  # distances in one step of the search: tens of milliseconds, tens of megabytes
_SPLITS = 4_000  # triangles halved in one step while no dent is known: takes as long
_NEARBY = 0.02  # of the diagonal, and radians: planes farther off are left to the probes


@dataclass(frozen=True)
class Hull:
    """Convex hull of points at unit size."""

    facets: Index
    """(h, 3) triangles, outward."""
    planes: Array
    """(p, 4) the distinct planes of the facets: n·x + d <= 0 inside."""
    facet_plane: Index
    """(h,) which plane a facet lies in."""
    by_place: cKDTree
    """Of the facets' centres."""
    by_direction: cKDTree
    """Of the planes' normals."""


def outward_hull(points: Array) -> Hull:
    """Convex hull of points (n, 3) with its facets turned outwards."""
    hull = ConvexHull(points)
    facets = hull.simplices.astype(np.int64)
    count = len(facets)
    # Qhull orients facets at random, and the normal of a sliver is no guide. But two facets run through their common edge
    # in opposite directions: that sorts facets and their mirror images into one outward and one inward surface.
    start, end = facets.T.ravel(), np.roll(facets, -1, axis=1).T.ravel()
    common = np.lexsort((np.maximum(start, end), np.minimum(start, end))).reshape(-1, 2)
    one, other = common.T % count
    other = np.where(start[common[:, 0]] != start[common[:, 1]], other, other + count)
    ends = np.concatenate([one, one + count]), np.concatenate([other, (other + count) % (2 * count)])
    links = coo_array((np.ones(len(ends[0])), ends), shape=(2 * count, 2 * count))
    surface = connected_components(links, directed=False)[1][:count]
    mirrored = surface != surface[0]
    facets[mirrored] = facets[mirrored, ::-1]
    if np.linalg.det(points[facets]).sum() < 0:
        facets = facets[:, ::-1]
    first, facet_plane = distinct_rows(hull.equations)
    planes = hull.equations[first]
    return Hull(facets, planes, facet_plane, cKDTree(points[facets].mean(axis=1)), cKDTree(planes[:, :3]))


def deepest_dent(corners: Array, hull: Hull) -> tuple[float, Array]:
    """Greatest depth of triangles (t, 3, 3) below their hull, from above, and a point that deep.

    Over a triangle the depth is at most the greatest depth of its corners below any one plane. Triangles that this can't
    exclude are probed at their corners and centre; the planes nearest to the probes sharpen the bounds of all the rest,
    and the probed triangles are halved until bound and probes agree. While no dent is known, many more are halved, and
    bounded by the planes nearby: the dents of rounding are so many and so alike that probing each would take minutes.
    """
    upper = _bounds(corners, hull)
    found, excluded, where = 0.0, 0.0, corners[np.argmax(upper), 0]
    while True:
        live = upper > max((1 + DENT_PRECISION) * found, NEGLIGIBLE_DENT)
        excluded = max(excluded, float(upper[~live].max(initial=0.0)))
        if not live.any():
            return max(found, excluded), where
        corners, upper = corners[live], upper[live]
        order = np.argsort(-upper)
        corners, upper = corners[order], upper[order]

        count = max(4, _PROBES // (4 * (len(hull.planes) + 3 * len(upper))))
        probes = np.concatenate([corners[:count].reshape(-1, 3), corners[:count].mean(axis=1)])
        depths = _depths(probes, hull.planes)
        depth, nearest = depths.min(axis=1), np.unique(depths.argmin(axis=1))
        if depth.max() > found:
            found, where = float(depth.max()), probes[depth.argmax()]

        shallow = found <= DENT_TOLERANCE
        count = _SPLITS if shallow else count
        longest = longest_first(corners[:count])[:, :, None]
        halves = halve(np.take_along_axis(corners[:count], longest, axis=1))[0]
        bounds = np.tile(upper[:count], 2)
        if shallow:
            bounds = np.minimum(bounds, _bounds(halves, hull))
        corners, upper = np.concatenate([corners[count:], halves]), np.concatenate([upper[count:], bounds])
        upper = np.minimum(upper, _depths(corners, hull.planes[nearest]).max(axis=1).min(axis=1))


def _depths(points: Array, planes: Array) -> Array:
    """Depth of points (..., 3) below planes (p, 4): (..., p)."""
    return -(points @ planes[:, :3].T + planes[:, 3])


def _bounds(corners: Array, hull: Hull) -> Array:
    """Upper bounds (t,) of the depth of triangles, from the planes nearest in place and nearest in direction."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), np.finfo(np.float64).tiny)[:, None]
    place = hull.by_place.query(corners.mean(axis=1), distance_upper_bound=_NEARBY)[1]
    one, other = (
        hull.by_direction.query(n, distance_upper_bound=_NEARBY)[1] for n in (normal, -normal)
    )  # out is either
    bound = np.full(len(corners), np.inf)
    for nearest in (np.append(hull.facet_plane, 0)[place], one % len(hull.planes), other % len(hull.planes)):
        plane = hull.planes[nearest]  # where none is nearby the index is one too high: any plane will do
        np.minimum(bound, -(np.einsum("tcx,tx->tc", corners, plane[:, :3]) + plane[:, 3:]).min(axis=1), out=bound)
    return np.maximum(bound, 0)
