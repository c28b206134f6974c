"""Surfaces by two well-known algorithms of open3d, which do not assume that the body is convex.

Screened Poisson reconstruction (Kazhdan & Hoppe, ACM Transactions on Graphics 32(3), 2013) finds the function whose gradient
is the field of normals.  Its surface is closed and smooth: it rounds edges, and bulges where there are no contacts.  Ball
pivoting (Bernardini et al., IEEE Transactions on Visualization and Computer Graphics 5(4), 1999) rolls a ball over the
contacts and spans a triangle wherever it rests on three of them: every vertex is a contact, and where the ball falls through,
a hole stays.

Both algorithms need evenly distributed points.  Contacts are dense along a slice, sparser between slices, and often several
lie at one place.  Contacts at one place are therefore replaced by one with their mean normal, and the cloud is thinned until it
is as dense along the slices as between them; its gaps are those of a Delaunay triangulation of the directions in which the
contacts lie.  Before that, the cloud is stretched, by the second moments of its convex hull, to one that is as wide in all
directions, and the normals by the inverse map.  A needle thus becomes a ball, and the resulting surface is mapped back.
Points are rounded and sorted first, so that the result depends neither on their order nor on their unit.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, cKDTree

from scan3d.arrays import Array, Index
from scan3d.choices import NOT_CONVEX
from scan3d.errors import InputError
from scan3d.extras import import_open3d
from scan3d.geometry.hulls import hull

# Lengths here are in radii of the stretched cloud, whose hull has the second moments of the unit ball.

# Coordinates are rounded to multiples of this, and contacts with the same coordinates are merged.  Larger, distinct contacts
# merge; smaller, rounding errors make the result depend on order and unit.
_GRID = 2.0**-30
# The entries of the stretching map are rounded to multiples of this.  Larger, the stretched cloud is less round; smaller,
# rounding errors make the map depend on the unit.
_STRETCH_GRID = 2.0**-12
# Ratio of the smallest to the largest width below which contacts count as lying in one plane.  Larger, thin discs are refused;
# smaller, the stretching magnifies the errors of contacts in one plane to the size of a body.
_FLATTEST = 1e-4
# Points closer together than this fraction of the local spacing are thinned.  Larger, detail is lost; smaller, the points stay
# denser along the slices than between them.
_THINNING = 0.5
# ... and so are points closer than this fraction of the dense spacing.  Larger, detail is lost where contacts are dense;
# smaller, noisy duplicates of a contact stay and roughen the surface.
_THINNING_FLOOR = 0.25
# Thickness of the shells in which points are kept, the outermost first, since corners, edges and rims lie farthest out.
# Larger, the shells no longer prefer them; smaller, rounding decides within a shell.
_SHELL = 0.05
# Poisson's cells are as fine as the spacing on this fraction of the surface, where contacts are densest.  Larger, the surface
# is coarser; smaller, computing it takes longer and it follows the slices.
_DENSE_FRACTION = 0.1
# The first ball is as large as the spacing on this fraction of the surface.  Larger, the ball takes longer and cuts corners;
# smaller, it falls through more gaps.
_SPARSE_FRACTION = 0.99
# ... but no larger than this many dense spacings.  Larger, it takes much longer; smaller, more radii are needed.
_FIRST_BALL = 4.0
# Radius of the largest ball: it can rest on a face as wide as the body.  Larger, it bridges gaps that are not flat; smaller,
# wide faces stay open.
_LARGEST_BALL = 2.0
# Points of a slice often lie on one circle, and those of a face in one plane, where ball pivoting makes overlapping triangles.
# They are therefore moved by this fraction of the squared distance between them.  Larger, the movement is no longer small
# against the sagitta of a curved surface; smaller, triangles overlap.
_JITTER = 1e-3
# Side of Poisson's cube, in widths of the cloud.  The second is tried if the surface reaches the cube's walls: a larger cube
# has coarser cells at the same depth, a smaller one cuts off more surfaces.
_CUBES = (1.5, 3.0)
# Depth of Poisson's octree.  A greater depth takes four times as long for every level; a smaller one rounds edges.
_SHALLOWEST, _DEEPEST = 3, 10
# The reason mentions a bulge of the surface, beyond the box of the contacts, of this fraction of their diagonal.  Larger,
# visible bulges go unmentioned; smaller, the normal roundness of Poisson's surface is reported.
_BULGE = 0.01


class _Stretched(NamedTuple):
    """Contacts at distinct places, evenly distributed, of a cloud stretched to the same width in all directions."""

    points: Array
    """(n, 3) about the origin."""
    normals: Array
    """(n, 3)"""
    original: Array
    """(n, 3) the points as given."""
    apart: Array
    """(n,) distance to which the points were thinned."""
    dense: float
    """Spacing that the densest tenth of the surface stays below."""
    sparse: float
    """Spacing that all but a hundredth of the surface stays below."""
    back: Array
    """(3, 3) the inverse map: ``points @ back + origin`` are the points as given, but for rounding."""
    origin: Array
    """(3,)"""


def poisson(points: Array, normals: Array) -> Any:
    """Screened Poisson reconstruction from points (n, 3) with outward normals (n, 3): a closed `trimesh.Trimesh`, outward.

    Rows that are not finite are left out.  The depth of the octree follows from the points' spacing.  `metadata["reason"]` says
    how the surface was made.  Raises InputError for points that span no body, for a surface that does not close, and if open3d
    cannot be imported.
    """
    cloud = _stretched(points, normals)
    o3d = _open3d()
    width = float(np.ptp(cloud.points, axis=0).max())
    for cube in _CUBES:
        depth = max(_SHALLOWEST, min(math.floor(math.log2(cube * width / cloud.dense)) + 1, _DEEPEST))
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            # several threads would add in an order that varies
            reconstructed, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
                _point_cloud(o3d, cloud.points, cloud.normals), depth=depth, scale=cube, n_threads=1
            )
        # merge vertices at one place
        places, vertex = np.unique(np.asarray(reconstructed.vertices), axis=0, return_inverse=True)
        faces = _largest(vertex.reshape(-1)[np.asarray(reconstructed.triangles)])
        surface = _mesh(places @ cloud.back + cloud.origin, faces)
        if len(surface.faces) and surface.is_watertight:
            reason = (
                f"screened Poisson reconstruction of depth {depth} from {len(cloud.points)} of {len(points)} contacts"
            )
            low, high = surface.bounds - [cloud.original.min(axis=0), cloud.original.max(axis=0)]
            beyond = float(max(-low.min(), high.max()) / np.linalg.norm(np.ptp(cloud.original, axis=0)))
            if beyond > _BULGE:
                reason += f": it bulges {beyond:.0%} of their diagonal beyond them, where there are no contacts"
            surface.metadata.update(method="poisson", reason=reason)
            return surface
    raise InputError(
        f"the Poisson surface of {len(cloud.points)} contacts does not close, since they leave too much of the body uncovered: "
        "scan along further axes, or use the method auto or hull"
    )


def ball_pivoting(points: Array, normals: Array) -> Any:
    """Ball pivoting over points (n, 3) with outward normals (n, 3): a `trimesh.Trimesh`, outward, perhaps with holes.

    Its vertices are among the points; holes of three edges are filled, larger ones are not.  Rows that are not finite are
    left out.  The balls' radii grow from the points' spacing to the body's size.  `metadata["reason"]` says how the surface was
    made, and how many edges are open.  Raises InputError for points that span no body, if no ball rests on any three of them,
    and if open3d cannot be imported.
    """
    cloud = _stretched(points, normals)
    o3d = _open3d()
    first = min(cloud.sparse, _FIRST_BALL * cloud.dense)
    radii = first * 2.0 ** np.arange(math.ceil(math.log2(_LARGEST_BALL / first)) + 1)
    moved = cloud.points + _JITTER * cloud.apart[:, None] ** 2 * np.random.default_rng(0).normal(
        size=cloud.points.shape
    )
    # the normals of a slice just below a flat end lie in the end's plane: inclined outwards, they show which side is outside
    inclined = _normalised(cloud.normals + _normalised(cloud.points))
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        pivoted = o3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(
            _point_cloud(o3d, moved, inclined), o3d.utility.DoubleVector(radii)
        )
    faces: Index = np.asarray(pivoted.triangles, dtype=np.int64).reshape(-1, 3)
    inwards = np.linalg.det(cloud.points[faces]) < 0
    faces[inwards] = faces[inwards, ::-1]
    faces = _without_overlaps(faces)
    fillings = _triangular_holes(faces)
    surface = _mesh(cloud.original, np.concatenate([faces, fillings]))
    if not len(surface.faces):
        raise InputError(
            f"no ball rests on three of the {len(cloud.points)} contacts: scan more slices, or use the method auto or hull"
        )
    edges, uses = np.unique(surface.edges_sorted, axis=0, return_counts=True)
    holes = int((uses != 2).sum())
    surface.metadata.update(
        method="ball-pivoting",
        reason=f"ball pivoting with {len(radii)} radii over {len(cloud.points)} of {len(points)} contacts"
        + (f", {len(fillings)} holes of three edges filled" if len(fillings) else "")
        + (f": not closed, {holes} of {len(edges)} edges are open" if holes else ": closed"),
    )
    return surface


def _stretched(points: Array, normals: Array) -> _Stretched:
    """The contacts stretched, merged and thinned as the module's docstring describes."""
    points, normals = np.asarray(points, dtype=float), np.asarray(normals, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or points.shape != normals.shape:
        raise InputError(f"points and normals must both be of shape (n, 3), got {points.shape} and {normals.shape}")
    rows = np.concatenate([points, normals], axis=1)
    rows = rows[np.isfinite(rows).all(axis=1)]
    if len(rows) < 4:
        raise InputError(
            f"{len(rows)} of {len(points)} contacts have a normal, and a surface needs at least 4: "
            "scan more slices, or use the method hull"
        )
    rows = rows[np.lexsort(rows.T[::-1])]
    points, normals = rows[:, :3], rows[:, 3:]

    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    size = float(np.ptp(points, axis=0).max())
    unit = (points - centre) / (size or 1.0)
    body = hull(unit)
    inertia = body.moment_inertia
    moments, axes = np.linalg.eigh((np.trace(inertia) / 2 * np.eye(3) - inertia) / body.volume)
    if moments[0] < _FLATTEST**2 * moments[2]:
        raise InputError(
            f"the {len(rows)} contacts with a normal lie in one plane, or nearly so: scan more slices, or use the method hull"
        )
    # the unit ball has the second moments 1/5
    stretch = np.round((axes / np.sqrt(5 * moments) @ axes.T) / _STRETCH_GRID) * _STRETCH_GRID
    middle = np.round(body.center_mass / _STRETCH_GRID) * _STRETCH_GRID
    back = np.linalg.inv(stretch)

    places = np.round((unit - middle) @ stretch / _GRID) * _GRID
    places, first, place = np.unique(places, axis=0, return_index=True, return_inverse=True)
    total = np.zeros_like(places)
    np.add.at(total, place.reshape(-1), normals)
    total = total @ back.T
    if (total * places).sum() <= 0:
        raise InputError("the normals point inwards, and should point out of the body: reverse them")
    # where the normals of one place cancel, the outward direction is taken
    total = _normalised(np.where(np.linalg.norm(total, axis=1, keepdims=True) > _GRID, total, places))
    apart, dense, sparse = _spacing(places)
    apart = _THINNING * np.maximum(apart, _THINNING_FLOOR * dense)
    kept = _thin(places, apart)
    return _Stretched(
        places[kept], total[kept], points[first[kept]], apart[kept], dense, sparse, back * size, middle * size + centre
    )


def _normalised(vectors: Array) -> Array:
    """Vectors (n, 3) of length 1; zero stays zero."""
    normalised: Array = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), _GRID)
    return normalised


def _spacing(points: Array) -> tuple[Array, float, float]:
    """Spacing of points (n, 3) about the origin: of each point (n,), and where they are dense and sparse on the surface.

    The directions of the points have a Delaunay triangulation on the sphere.  The diameter of a triangle's circumcircle is
    the gap that it spans, from slice to slice however dense these are; a point's spacing is the smallest gap it lies at.
    """
    triangles = ConvexHull(_normalised(points)).simplices
    corners = points[triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = np.minimum(np.nan_to_num(sides.prod(axis=1) / (2 * area), nan=np.inf), _LARGEST_BALL)
    local = np.full(len(points), _LARGEST_BALL)
    np.minimum.at(local, triangles, gap[:, None])
    order = np.argsort(gap)
    covered = np.cumsum(area[order]) / area.sum()
    dense, sparse = gap[order][np.searchsorted(covered, (_DENSE_FRACTION, _SPARSE_FRACTION))]
    return local, float(dense), float(sparse)


def _thin(points: Array, apart: Array) -> Index:
    """Rows (k,), increasing, of the points (n, 3) that remain if each, outer ones first, removes all within `apart` (n,)."""
    tree = cKDTree(points)
    free = np.ones(len(points), dtype=bool)
    kept = []
    shell = np.round(np.linalg.norm(points, axis=1) / _SHELL)
    for row in np.argsort(-shell, kind="stable"):
        if free[row]:
            kept.append(row)
            free[tree.query_ball_point(points[row], apart[row])] = False
    return np.sort(np.array(kept, dtype=np.int64))


def _largest(faces: Index) -> Index:
    """The faces (m, 3) of the connected component with the largest number of them."""
    count = int(faces.max(initial=-1)) + 1
    if not count:
        return faces
    edges = faces[:, [0, 1, 1, 2]].reshape(-1, 2).T
    _, label = connected_components(coo_array((np.ones(edges.shape[1]), edges), shape=(count, count)), directed=False)
    component = label[faces[:, 0]]
    return np.asarray(faces[component == np.bincount(component).argmax()])


def _without_overlaps(faces: Index) -> Index:
    """The faces (m, 3) without those that overlap an earlier one: they lie on the same side of one of its edges."""
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    _, first = np.unique(np.stack([start, end], axis=1), axis=0, return_index=True)
    repeated = np.ones(len(start), dtype=bool)
    repeated[first] = False
    return faces[~repeated.reshape(-1, 3).any(axis=1)]


def _triangular_holes(faces: Index) -> Index:
    """The faces (k, 3) that fill holes of three edges."""
    edges = set(zip(faces.reshape(-1).tolist(), np.roll(faces, -1, axis=1).reshape(-1).tolist(), strict=True))
    # directed as seen from the holes; where several holes meet in one vertex, the last edge counts
    following = {end: start for start, end in sorted(edges) if (end, start) not in edges}
    holes = []
    for a, b in following.items():
        c = following.get(b, -1)
        if a < b and a < c and following.get(c) == a:
            holes.append((a, b, c))
    return np.array(holes, dtype=np.int64).reshape(-1, 3)


def _mesh(vertices: Array, faces: Index) -> Any:
    """A `trimesh.Trimesh` without duplicate faces, faces without area and unused vertices."""
    import trimesh

    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    _, once = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    good = np.zeros(len(faces), dtype=bool)
    good[once] = True
    faces = faces[good & (area > 0)]
    used, faces = np.unique(faces, return_inverse=True)
    return trimesh.Trimesh(vertices[used], faces.reshape(-1, 3), process=False)


def _point_cloud(o3d: Any, points: Array, normals: Array) -> Any:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    return cloud


def check_method(method: str) -> None:
    """Raise InputError if a method of surfaces needs open3d, and that can't be imported: before a scan, not after it."""
    if method in NOT_CONVEX:
        _open3d()


def _open3d() -> Any:
    return import_open3d(
        "the methods poisson and ball-pivoting need", ", or use the method auto, bracket, hull or support"
    )
