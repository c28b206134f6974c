"""Closed surfaces from contacts."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from scan3d.cloud import Array, Cloud
from scan3d.errors import InputError


def surface(cloud: Cloud) -> Any:
    """Closed surface of a convex body from its contacts: a `trimesh.Trimesh`, outward, in the cloud's unit."""
    return hull(cloud.points)


def hull(points: Array) -> Any:
    """Convex hull of points (n, 3) as a `trimesh.Trimesh` with outward faces.  Raises InputError if they span no body."""
    import trimesh

    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    size = float(np.ptp(points, axis=0).max()) or 1.0
    try:
        found = ConvexHull((points - centre) / size)
    except (QhullError, ValueError):
        raise InputError(
            f"the {len(points)} contacts span no body: a surface needs contacts in at least two slices, not all in one plane"
        ) from None
    faces = found.simplices.copy()
    corners = found.points[faces]
    inward = (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * found.equations[:, :3]).sum(
        axis=1
    ) < 0
    faces[inward] = faces[inward, ::-1]
    kept, faces = np.unique(faces, return_inverse=True)
    return trimesh.Trimesh(points[kept], faces.reshape(-1, 3), process=False)


def table(surface: Any) -> np.ndarray[Any, np.dtype[np.void]]:
    """Vertices with their normals as a structured array, as `files.ply` writes them."""
    rows = np.empty(
        len(surface.vertices), dtype=[(name, "f8") for name in "xyz"] + [(f"n{name}", "f4") for name in "xyz"]
    )
    for columns, values in (("x y z", surface.vertices), ("nx ny nz", surface.vertex_normals)):
        for column, value in zip(columns.split(), np.asarray(values).T, strict=True):
            rows[column] = value
    return rows
