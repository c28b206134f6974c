"""Surfaces by two well-known algorithms of open3d, which do not assume that the body is convex.

Screened Poisson reconstruction (Kazhdan & Hoppe, ACM Transactions on Graphics 32(3), 2013) finds the function whose gradient
is the field of normals.  Its surface is closed and smooth: it rounds edges, and bulges where there are no contacts.  Ball
pivoting (Bernardini et al., IEEE Transactions on Visualization and Computer Graphics 5(4), 1999) rolls a ball over the
contacts and spans a triangle wherever it rests on three of them: every vertex is a contact, and where the ball falls through,
a hole stays.

Both need evenly distributed points, and contacts are dense along a slice and sparser between slices.  The cloud is mapped to
one whose hull has the moments of inertia of the unit ball, so that a needle becomes a ball, and thinned until it is as dense
along the slices as between them.  Points are rounded and sorted first, so that the result depends neither on their order nor on
their unit.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from scan3d.arrays import NEGLIGIBLE, Array, Index, unit_or_zero
from scan3d.choices import NOT_CONVEX
from scan3d.errors import InputError, import_open3d
from scan3d.geometry.hulls import hull
from scan3d.geometry.support import inertia
from scan3d.geometry.triangles import areas, kept_apart, without_unused

# Side of Poisson's cube, in widths of the cloud.
_CUBE = 3.0


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
    cells = _CUBE * float(np.ptp(cloud.points, axis=0).max()) / cloud.spacing
    # a deeper octree takes gigabytes
    depth = min(math.floor(math.log2(cells)) + 1, 10)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        # several threads would add in an order that varies
        made, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
            _point_cloud(o3d, cloud.points, cloud.normals), depth=depth, scale=_CUBE, n_threads=1
        )
    places, vertex = np.unique(np.asarray(made.vertices), axis=0, return_inverse=True)
    whole = _mesh(places @ cloud.back + cloud.origin, vertex.reshape(-1)[np.asarray(made.triangles)])
    bodies = whole.split(only_watertight=False, repair=False)
    surface = max(bodies, key=lambda body: len(body.faces), default=whole)
    if not len(surface.faces) or not surface.is_watertight:
        raise InputError(
            f"the Poisson surface of {len(cloud.points)} contacts does not close, since they leave too much of the body "
            "uncovered: scan along further axes, or use the method auto or hull"
        )
    reason = f"screened Poisson reconstruction of depth {depth} from {len(cloud.points)} of {len(points)} contacts"
    low, high = surface.bounds - [cloud.original.min(axis=0), cloud.original.max(axis=0)]
    beyond = float(max(-low.min(), high.max()) / np.linalg.norm(np.ptp(cloud.original, axis=0)))
    # a bulge beyond the box of the contacts is worth a word
    if beyond > 0.01:
        reason += f": it bulges {beyond:.0%} of their diagonal beyond them, where there are no contacts"
    surface.metadata.update(method="poisson", reason=reason)
    return surface


def ball_pivoting(points: Array, normals: Array) -> Any:
    """Ball pivoting over points (n, 3) with outward normals (n, 3): a `trimesh.Trimesh`, outward, perhaps with holes.

    Its vertices are among the points.  Rows that are not finite are left out.  The balls' radii grow from the points' spacing
    to the body's width.  `metadata["reason"]` says how the surface was made, and how many edges are open.  Raises InputError
    for points that span no body, if no ball rests on any three of them, and if open3d cannot be imported.
    """
    cloud, o3d = _even(points, normals), _open3d()
    radii = cloud.spacing * 2.0 ** np.arange(math.ceil(math.log2(2 / cloud.spacing)) + 1)
    # Points of a slice often lie on one circle, where ball pivoting makes overlapping triangles: they are moved by this
    # fraction of the squared distance between them, which is small beside the depth of a chord.
    jitter = 1e-3 * cloud.spacing**2 * np.random.default_rng(0).normal(size=cloud.points.shape)
    # the normals of a slice just below a flat end lie in the end's plane: inclined outwards, they show which side is outside
    inclined = unit_or_zero(cloud.normals + unit_or_zero(cloud.points))
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        pivoted = o3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(
            _point_cloud(o3d, cloud.points + jitter, inclined), o3d.utility.DoubleVector(radii)
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
    """Contacts, evenly distributed, of a cloud that is mapped to one as wide in all directions."""

    points: Array
    """(n, 3) about the origin, with the moments of inertia of about the unit ball."""
    normals: Array
    """(n, 3)"""
    original: Array
    """(n, 3) the points as given."""
    spacing: float
    """Median over the surface of the gaps that the points leave."""
    back: Array
    """(3, 3) the inverse map: ``points @ back + origin`` are the points as given, but for rounding."""
    origin: Array
    """(3,)"""


def _even(points: Array, normals: Array) -> _Even:
    """The contacts mapped and thinned, as the module's docstring describes."""
    points, normals = np.asarray(points, dtype=float), np.asarray(normals, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or points.shape != normals.shape:
        raise InputError(f"points and normals must both be of shape (n, 3), got {points.shape} and {normals.shape}")
    rows = np.concatenate([points, normals], axis=1)
    rows = np.unique(rows[np.isfinite(rows).all(axis=1)], axis=0)
    if len(rows) < 4:
        raise InputError(
            f"{len(rows)} of {len(points)} contacts have a normal, and a surface needs at least 4: "
            "scan more slices, or use the method hull"
        )
    original, normals = np.split(rows, 2, axis=1)
    middle, size = (original.min(axis=0) + original.max(axis=0)) / 2, float(np.ptp(original, axis=0).max()) or 1.0
    scaled = np.ldexp(np.round(np.ldexp((original - middle) / size, 30)), -30)
    centre, shape = inertia(hull(scaled).vertices.view(np.ndarray))
    widths = np.linalg.eigvalsh(shape)
    if widths[0] < 1e-4 * widths[-1]:
        raise InputError(
            f"the {len(rows)} contacts with a normal lie in one plane, or nearly so: scan more slices, or use the method hull"
        )
    places, across = (scaled - centre) @ np.linalg.inv(shape), unit_or_zero(normals @ shape)
    if (across * places).sum() <= 0:
        raise InputError("the normals point inwards, and should point out of the body: reverse them")
    spacing = _spacing(places)
    kept = kept_apart(places, spacing / 2)
    return _Even(places[kept], across[kept], original[kept], spacing, shape * size, centre * size + middle)


def _spacing(points: Array) -> float:
    """The gap that points (n, 3) about the origin leave in the middle of all gaps, by the area that these cover.

    The directions of the points have a Delaunay triangulation on the sphere.  The diameter of a triangle's circumcircle is
    the gap that it spans, from slice to slice however dense these are.
    """
    corners = points[ConvexHull(unit_or_zero(points)).simplices]
    sides, area = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), areas(corners)
    wide = area > NEGLIGIBLE
    gap = sides[wide].prod(axis=1) / (2 * area[wide])
    order = np.argsort(gap)
    covered = np.cumsum(area[wide][order])
    return float(gap[order][np.searchsorted(covered, covered[-1] / 2)])


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


def _point_cloud(o3d: Any, points: Array, normals: Array) -> Any:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    return cloud
