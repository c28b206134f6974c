"""Convex hulls as meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from scan3d.arrays import Array
from scan3d.errors import InputError

# Points whose root mean square distance from a plane is less than this fraction of their extent span no body.  Larger, thin
# bodies would be refused; smaller, the hull of points in one plane would be made of rounding.
_FLATTEST = 1e-9


def hull(points: Array) -> Any:
    """Convex hull of points (n, 3) as a `trimesh.Trimesh` with outward faces.

    Raises InputError if the points do not span a body.
    """
    import trimesh

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
    except (QhullError, ValueError, IndexError):
        raise InputError(
            f"the {len(points)} contacts span no body: a surface needs contacts in at least two slices, not all in one plane"
        ) from None
    faces = qhull.simplices.copy()
    corners = qhull.points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normals * qhull.equations[:, :3]).sum(axis=1) < 0
    faces[inward] = faces[inward, ::-1]
    kept, faces = np.unique(faces, return_inverse=True)
    return trimesh.Trimesh(points[kept], faces.reshape(-1, 3), process=False)
