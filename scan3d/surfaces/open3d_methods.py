"""Surfaces by two well-known algorithms of open3d, which do not assume that the body is convex.

Screened Poisson reconstruction (Kazhdan & Hoppe, ACM Transactions on Graphics 32(3), 2013) finds the function whose gradient
is the field of normals.  Its surface is closed and smooth: it rounds edges, and bulges where there are no contacts.  Ball
pivoting (Bernardini et al., IEEE Transactions on Visualization and Computer Graphics 5(4), 1999) rolls a ball over the
contacts and spans a triangle wherever it rests on three of them: every vertex is a contact, and where the ball falls through,
a hole stays.

Both need evenly distributed points, and contacts are dense along a slice and sparser between slices.  The cloud is stretched to
one that is as wide in all directions, by the second moments of its hull, so that a needle becomes a ball, and thinned until it
is as dense along the slices as between them: its gaps are those of a Delaunay triangulation of the directions in which the
contacts lie.  Points are rounded and sorted first, so that the result depends neither on their order nor on their unit.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from scan3d.arrays import Array, Index
from scan3d.choices import NOT_CONVEX
from scan3d.errors import InputError
from scan3d.extras import import_open3d
from scan3d.geometry.hulls import hull
from scan3d.geometry.merging import without_unused
from scan3d.geometry.triangles import areas

# Lengths here are in radii of the stretched cloud, whose hull has the second moments of the unit ball.

# Multiples to which coordinates of contacts are rounded, and the entries of the stretching map.
_GRID, _STRETCH_GRID = 2.0**-30, 2.0**-12
# Ratio of the smallest to the largest width below which contacts count as lying in one plane.
_FLATTEST = 1e-4
# Points closer than this fraction of the local spacing, or of a part of that where contacts are dense, are thinned; the
# outermost shells, of this thickness, are kept first, since corners, edges and rims lie farthest out.
_THINNING, _FLOOR, _SHELL = 0.5, 0.25, 0.05
# Spacings count as dense and as sparse that the surface has on these fractions of its area.  Poisson's cells are as fine as the
# dense one; the first ball is as large as the sparse one, but no larger than some dense ones, and the largest rests on a face
# as wide as the body.
_DENSE, _SPARSE, _FIRST_BALL, _LARGEST_BALL = 0.1, 0.99, 4.0, 2.0
# Points of a slice often lie on one circle, where ball pivoting makes overlapping triangles: they are moved by this fraction of
# the squared distance between them.
_JITTER = 1e-3
# Side of Poisson's cube, in widths of the cloud, the second tried if the surface reaches the walls, and depths of its octree.
_CUBES, _SHALLOWEST, _DEEPEST = (1.5, 3.0), 3, 10
# The reason mentions a bulge of the surface, beyond the box of the contacts, of this fraction of their diagonal.
_BULGE = 0.01


def check_method(method: str) -> None:
    """Raise InputError if a method of surfaces needs open3d, and that can't be imported: before a scan, not after it."""
    if method in NOT_CONVEX:
        _open3d()


def _open3d() -> Any:
    return import_open3d(
        "the methods poisson and ball-pivoting need", ", or use the method auto, bracket, hull or support"
    )


def poisson(points: Array, normals: Array) -> Any:
    """Screened Poisson reconstruction from points (n, 3) with outward normals (n, 3): a closed `trimesh.Trimesh`, outward.

    Rows that are not finite are left out.  The depth of the octree follows from the points' spacing.  `metadata["reason"]` says
    how the surface was made.  Raises InputError for points that span no body, for a surface that does not close, and if open3d
    cannot be imported.
    """
    cloud, o3d = _even(points, normals), _open3d()
    width = float(np.ptp(cloud.points, axis=0).max())
    for cube in _CUBES:
        depth = max(_SHALLOWEST, min(math.floor(math.log2(cube * width / cloud.dense)) + 1, _DEEPEST))
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            # several threads would add in an order that varies
            made, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
                _point_cloud(o3d, cloud.points, cloud.normals), depth=depth, scale=cube, n_threads=1
            )
        places, vertex = np.unique(np.asarray(made.vertices), axis=0, return_inverse=True)
        surface = _mesh(places @ cloud.back + cloud.origin, vertex.reshape(-1)[np.asarray(made.triangles)])
        bodies = surface.split(only_watertight=False, repair=False)
        surface = max(bodies, key=lambda body: len(body.faces), default=surface)
        if len(surface.faces) and surface.is_watertight:
            used = len(cloud.points)
            reason = f"screened Poisson reconstruction of depth {depth} from {used} of {len(points)} contacts"
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

    Its vertices are among the points.  Rows that are not finite are left out.  The balls' radii grow from the points' spacing
    to the body's size.  `metadata["reason"]` says how the surface was made, and how many edges are open.  Raises InputError for
    points that span no body, if no ball rests on any three of them, and if open3d cannot be imported.
    """
    cloud, o3d = _even(points, normals), _open3d()
    first = min(cloud.sparse, _FIRST_BALL * cloud.dense)
    radii = first * 2.0 ** np.arange(math.ceil(math.log2(_LARGEST_BALL / first)) + 1)
    jitter = np.random.default_rng(0).normal(size=cloud.points.shape)
    moved = cloud.points + _JITTER * cloud.apart[:, None] ** 2 * jitter
    # the normals of a slice just below a flat end lie in the end's plane: inclined outwards, they show which side is outside
    inclined = _unit(cloud.normals + _unit(cloud.points))
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        pivoted = o3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(
            _point_cloud(o3d, moved, inclined), o3d.utility.DoubleVector(radii)
        )
    faces: Index = np.asarray(pivoted.triangles, dtype=np.int64).reshape(-1, 3)
    inwards = np.linalg.det(cloud.points[faces]) < 0
    faces[inwards] = faces[inwards, ::-1]
    surface = _mesh(cloud.original, _without_overlaps(faces))
    if not len(surface.faces):
        raise InputError(
            f"no ball rests on three of the {len(cloud.points)} contacts: scan more slices, or use the method auto or hull"
        )
    edges, uses = np.unique(surface.edges_sorted, axis=0, return_counts=True)
    holes = int((uses != 2).sum())
    reason = f"ball pivoting with {len(radii)} radii over {len(cloud.points)} of {len(points)} contacts"
    reason += f": not closed, {holes} of {len(edges)} edges are open" if holes else ": closed"
    surface.metadata.update(method="ball-pivoting", reason=reason)
    return surface


class _Even(NamedTuple):
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
    sparse: float
    back: Array
    """(3, 3) the inverse map: ``points @ back + origin`` are the points as given, but for rounding."""
    origin: Array
    """(3,)"""


def _even(points: Array, normals: Array) -> _Even:
    """The contacts stretched, those at one place merged, and thinned, as the module's docstring describes."""
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
    points, normals = np.split(rows[np.lexsort(rows.T[::-1])], 2, axis=1)
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
    total = _unit(np.where(np.linalg.norm(total, axis=1, keepdims=True) > _GRID, total, places))
    local, dense, sparse = _spacing(places)
    apart = _THINNING * np.maximum(local, _FLOOR * dense)
    kept = _thinned(places, apart)
    origin = middle * size + centre
    return _Even(places[kept], total[kept], points[first[kept]], apart[kept], dense, sparse, back * size, origin)


def _spacing(points: Array) -> tuple[Array, float, float]:
    """Spacing of points (n, 3) about the origin: of each point (n,), and where they are dense and sparse on the surface.

    The directions of the points have a Delaunay triangulation on the sphere.  The diameter of a triangle's circumcircle is
    the gap that it spans, from slice to slice however dense these are; a point's spacing is the smallest gap it lies at.
    """
    triangles = ConvexHull(_unit(points)).simplices
    corners = points[triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    area = areas(corners)
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = np.minimum(np.nan_to_num(sides.prod(axis=1) / (2 * area), nan=np.inf), _LARGEST_BALL)
    local = np.full(len(points), _LARGEST_BALL)
    np.minimum.at(local, triangles, gap[:, None])
    order = np.argsort(gap)
    covered = np.cumsum(area[order]) / area.sum()
    dense, sparse = gap[order][np.searchsorted(covered, (_DENSE, _SPARSE))]
    return local, float(dense), float(sparse)


def _thinned(points: Array, apart: Array) -> Index:
    """Rows (k,), increasing, of the points (n, 3) that remain if each, outer ones first, removes all within `apart` (n,)."""
    tree, free, kept = cKDTree(points), np.ones(len(points), dtype=bool), []
    shell = np.round(np.linalg.norm(points, axis=1) / _SHELL)
    for row in np.argsort(-shell, kind="stable"):
        if free[row]:
            kept.append(row)
            free[tree.query_ball_point(points[row], apart[row])] = False
    return np.sort(np.array(kept, dtype=np.int64))


def _without_overlaps(faces: Index) -> Index:
    """The faces (m, 3) without those that overlap an earlier one: they lie on the same side of one of its edges."""
    sides = np.stack([faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)], axis=1)
    repeated = np.ones(len(sides), dtype=bool)
    repeated[np.unique(sides, axis=0, return_index=True)[1]] = False
    return faces[~repeated.reshape(-1, 3).any(axis=1)]


def _mesh(vertices: Array, faces: Index) -> Any:
    """A `trimesh.Trimesh` without duplicate faces, faces without area and unused vertices."""
    import trimesh

    once = np.zeros(len(faces), dtype=bool)
    once[np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]] = True
    used, faces = without_unused(faces[once & (areas(vertices[faces]) > 0)])
    return trimesh.Trimesh(vertices[used], faces, process=False)


def _unit(vectors: Array) -> Array:
    """Vectors (n, 3) of length 1; zero stays zero."""
    unit: Array = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), _GRID)
    return unit


def _point_cloud(o3d: Any, points: Array, normals: Array) -> Any:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    return cloud
