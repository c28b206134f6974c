"""Convex hulls as meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from scan3d.arrays import Array, Index
from scan3d.errors import InputError
from scan3d.geometry.flips import facets_by_flips
from scan3d.geometry.merging import representatives, without_unused
from scan3d.geometry.triangles import mirrored_faces

# Points whose root mean square distance from a plane is less than this fraction of their extent span no body.  Larger, thin
# bodies would be refused; smaller, the hull of points in one plane would be made of rounding.
_FLATTEST = 1e-9
# A hull whose volume is less than this fraction of its area times the points' extent is one of points in a plane or on a line,
# up to rounding, which is larger far from the origin.  Larger, thin bodies would be refused; smaller, rounding makes bodies.
_THINNEST = 1e-12
# Points closer than this fraction of their extent are merged if their hull is not a closed surface.  Larger, the hull loses
# accuracy; smaller, it may stay open.
_COINCIDENT = 1e-11


def hull(points: Array) -> Any:
    """Convex hull of points (n, 3) as a `trimesh.Trimesh` with outward faces.

    Raises InputError if the points do not span a body.
    """
    if not len(points):
        raise _no_body(points)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    size = float(np.ptp(points, axis=0).max()) or 1.0
    scaled = (points - centre) / size
    try:
        try:
            qhull = ConvexHull(scaled)
        except QhullError:
            if np.linalg.svd(scaled - scaled.mean(axis=0), compute_uv=False)[-1] < _FLATTEST * np.sqrt(len(scaled)):
                raise
            qhull = ConvexHull(scaled, qhull_options="Qt Q12")  # many nearly coplanar points make wide facets
        rounding = 4 * np.finfo(float).eps * float(np.abs(points).max()) / size
        if not qhull.volume > max(_THINNEST, rounding) * qhull.area:
            raise QhullError
    except (QhullError, ValueError, IndexError):
        raise _no_body(points) from None
    faces = _outward(qhull)
    if faces is None:
        # between points that nearly coincide Qhull leaves edges with one face, or with three
        apart = np.unique(representatives(scaled, _COINCIDENT))
        return hull(points[apart]) if len(apart) < len(points) else _mesh(points, _by_planes(qhull))
    return _mesh(points, faces)


def hull_near(points: Array, faces: Index) -> Any:
    """`hull` of points (n, 3) from the faces (m, 3) of a closed mesh that nearly is their hull, in a fraction of the time."""
    middle, size = points.mean(axis=0), float(np.ptp(points, axis=0).max())
    found = facets_by_flips((points - middle) / size, faces) if size > 0 else None
    return hull(points) if found is None else _mesh(points, found[0])


def _no_body(points: Array) -> InputError:
    return InputError(
        f"the {len(points)} contacts span no body: a surface needs contacts in at least two slices, not all in one plane"
    )


def _outward(qhull: ConvexHull) -> Index | None:
    """The facets (m, 3), counterclockwise from outside; None if they are no closed surface."""
    faces: Index = qhull.simplices.astype(np.int64)
    mirrored = mirrored_faces(faces)
    if mirrored is None:
        return None
    faces[mirrored] = faces[mirrored, ::-1]
    return faces[:, ::-1] if np.linalg.det(qhull.points[faces]).sum() < 0 else faces


def _by_planes(qhull: ConvexHull) -> Index:
    """The facets (m, 3), each turned by its own plane, which leaves the sides of slivers to rounding."""
    faces: Index = qhull.simplices.astype(np.int64)
    corners = qhull.points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normals * qhull.equations[:, :3]).sum(axis=1) < 0
    faces[inward] = faces[inward, ::-1]
    return faces


def _mesh(points: Array, faces: Index) -> Any:
    import trimesh

    used, renumbered = without_unused(faces)
    return trimesh.Trimesh(points[used], renumbered, process=False)
