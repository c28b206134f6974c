"""How far a mesh is from convex.

Convexity is judged by depth: the *dent* of a mesh is the largest depth of its surface below the surface of its convex hull.
The depth of a point inside a convex polyhedron is its distance from the nearest facet plane, so it is the minimum of linear
functions, concave on each triangle and bounded from above by each of them.  The deepest dent is found by branch and bound,
with a certain result.  The search does not use which triangles are neighbours, so triangle soups will do, and it also finds an
edge flipped the wrong way, where every vertex lies on the hull and the surface does not.

Points are in float64 at unit size about the centre of the bounding box, so that the unit of length does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from scan3d.arrays import Array, Index, Mask
from scan3d.geometry.triangles import (
    distinct_rows,
    dot,
    halve,
    largest_of_three,
    longest_first,
    mirrored_faces,
    spanned,
)

# All depths are relative to the diagonal of the bounding box.
DENT_TOLERANCE = 1e-5
"""Deepest dent of a body that counts as convex.  Larger, bodies would be replaced by hulls that touch can tell from them;
smaller, float32 files of fine meshes and CAD exports, with dents of 1e-7 to 1e-6 from rounding alone, would be refused."""
DENT_PRECISION = 1e-3
"""Relative error of the depth of a dent.  Larger, reports are less accurate; smaller, the search takes longer."""
NEGLIGIBLE_DENT = 0.01 * DENT_TOLERANCE
"""Depth below which a dent is not determined.  Larger, reports of convex bodies are less accurate; smaller, the search spends
time on the dents of rounding."""
HULL_OF_MESH = "convex hull of the mesh"
"""What a body is called that was taken in the place of a mesh that is not convex."""
# Distances of probes from planes in one step of the search.  More take more memory (8 bytes each) and improve the bounds less
# often; fewer take more calls.
_PROBES = 2_000_000
# Smallest number of triangles that are probed in one step, where bodies have many planes.  Larger, a step takes more memory;
# smaller, more steps are needed.
_FEWEST_PROBED = 4
# Triangles that are halved in one step while no dent is known, for which it takes as long as the probes.  More are halved in
# vain; fewer take more calls.
_SPLITS = 4_000
# Distance, in diagonals, and angle, in radians, within which planes near a triangle are looked up.  Larger, the look-up takes
# longer; smaller, more triangles are left to the probes.
_NEARBY = 0.02


@dataclass(frozen=True)
class Hull:
    """Convex hull of points at unit size."""

    facets: Index
    """(h, 3) triangles, outward."""
    planes: Array
    """(p, 4) the distinct planes of the facets: n·x + d <= 0 inside."""
    facet_plane: Index
    """(f,) which plane a facet lies in, for the facets that are looked up by place, which are the first f."""
    by_place: cKDTree
    """Of these facets' centres."""
    by_direction: cKDTree
    """Of the normals of the first planes, as many as are looked up by direction."""


def outward_hull(points: Array) -> Hull:
    """Convex hull of points (n, 3) with its facets turned outwards."""
    hull = ConvexHull(points)
    facets = hull.simplices.astype(np.int64)
    # Qhull orients facets at random
    mirrored = mirrored_faces(facets)
    assert mirrored is not None  # the hull of a body is one closed surface
    facets[mirrored] = facets[mirrored, ::-1]
    if np.linalg.det(points[facets]).sum() < 0:
        facets = facets[:, ::-1]
    first, facet_plane = distinct_rows(hull.equations)
    planes = hull.equations[first]
    return Hull(facets, planes, facet_plane, cKDTree(points[facets].mean(axis=1)), cKDTree(planes[:, :3]))


def hull_of_facets(points: Array, facets: Index, replaced: Mask) -> Hull:
    """The hull of points (n, 3) with known facets (m, 3), in which places are looked up among those that replaced a face (m,).

    They lie above all dents, if the other facets are faces of the mesh.
    """
    facets = np.concatenate([facets[replaced], facets[~replaced]])
    corners, count = points[facets], np.count_nonzero(replaced)
    normals = spanned(corners)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    planes = np.column_stack([normals, -largest_of_three(dot(corners, normals[:, None]))])
    middles = corners[:count].mean(axis=1)
    return Hull(facets, planes, np.arange(count), cKDTree(middles), cKDTree(normals[:count]))


def deepest_dent(corners: Array, hull: Hull) -> tuple[float, Array]:
    """Upper bound of the depth of triangles (t, 3, 3) below their hull, and the point (3,) where they are deepest.

    The depth on a triangle is at most the largest depth of its corners below any one plane.  Triangles that this bound does
    not exclude are probed at their corners and centres.  The planes nearest to the probes improve the bounds of all other
    triangles, and the probed triangles are halved until bounds and probes agree.  While no dent is known, many more triangles
    are halved and bounded by the planes nearby, because the dents of rounding are so many and so alike that probing each would
    take minutes.
    """
    upper = _bounds(corners, hull)
    deepest, excluded, where = 0.0, 0.0, corners[np.argmax(upper), 0]
    while True:
        remaining = upper > max((1 + DENT_PRECISION) * deepest, NEGLIGIBLE_DENT)
        excluded = max(excluded, float(upper[~remaining].max(initial=0.0)))
        if not remaining.any():
            return max(deepest, excluded), where
        corners, upper = corners[remaining], upper[remaining]
        order = np.argsort(-upper)
        corners, upper = corners[order], upper[order]

        count = max(_FEWEST_PROBED, _PROBES // (4 * (len(hull.planes) + 3 * len(upper))))
        probes = np.concatenate([corners[:count].reshape(-1, 3), corners[:count].mean(axis=1)])
        depths = _depths(probes, hull.planes)
        depth, nearest = depths.min(axis=1), np.unique(depths.argmin(axis=1))
        if depth.max() > deepest:
            deepest, where = float(depth.max()), probes[depth.argmax()]

        shallow = deepest <= DENT_TOLERANCE
        count = _SPLITS if shallow else count
        longest = longest_first(corners[:count])[:, :, None]
        halves = halve(np.take_along_axis(corners[:count], longest, axis=1))[0]
        bounds = np.tile(upper[:count], 2)
        if shallow:
            bounds = np.minimum(bounds, _bounds(halves, hull))
        corners, upper = np.concatenate([corners[count:], halves]), np.concatenate([upper[count:], bounds])
        upper = np.minimum(upper, _depths(corners, hull.planes[nearest]).max(axis=1).min(axis=1))


def _depths(points: Array, planes: Array) -> Array:
    """Depths (..., p) of points (..., 3) below planes (p, 4)."""
    return -(points @ planes[:, :3].T + planes[:, 3])


def _bounds(corners: Array, hull: Hull) -> Array:
    """Upper bounds (t,) of the depth of triangles, by the planes of the nearest facets and those with the nearest normals."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), np.finfo(np.float64).tiny)[:, None]
    facet = hull.by_place.query(corners.mean(axis=1), distance_upper_bound=_NEARBY)[1]
    # the triangle may be turned inwards
    along, against = (hull.by_direction.query(n, distance_upper_bound=_NEARBY)[1] for n in (normal, -normal))
    bound = np.full(len(corners), np.inf)
    for nearest in (np.append(hull.facet_plane, 0)[facet], along % len(hull.planes), against % len(hull.planes)):
        plane = hull.planes[nearest]  # where no plane is nearby the index is one too high, and any plane gives a bound
        np.minimum(bound, -(np.einsum("tcx,tx->tc", corners, plane[:, :3]) + plane[:, 3:]).min(axis=1), out=bound)
    np.maximum(bound, 0, out=bound)
    return bound
