"""Closed surfaces from contacts."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from scan3d.cloud import Array, Cloud
from scan3d.errors import InputError

METHODS = ("auto", "hull", "support")
# Subdivisions of the icosahedron in whose directions a fitted body is evaluated: 40,962 points.
_SUBDIVISIONS = 6


def surface(cloud: Cloud, method: str = "auto") -> Any:
    """Closed surface of a convex body from its contacts: a `trimesh.Trimesh`, outward, in the cloud's unit.

    method
        'hull': the convex hull of the contacts, never outside the body; 'support': the body of the support function fitted
        to them, for smooth bodies; 'auto': 'support' for a smooth body whose fit meets contacts left out of it, else 'hull'.

    `metadata` says which `method` it was, and for what `reason`.  Raises InputError for an unknown method, for contacts that
    span no body, and for 'support' where the body is not smooth.
    """
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    if method == "support" and cloud.fit is None:
        raise InputError(
            "the body is not smooth enough for the method support, or has too few contacts; use auto or hull"
        )
    if method == "hull" or cloud.fit is None:
        chosen = "as asked for" if method == "hull" else "the body is not smooth, or has too few contacts for a fit"
        found = hull(cloud.points)
        found.metadata.update(method="hull", reason=f"convex hull of the contacts: {chosen}")
        return found
    from trimesh.creation import icosphere

    found = hull(cloud.fit.points(icosphere(subdivisions=_SUBDIVISIONS).vertices.view(np.ndarray)))
    found.metadata.update(
        method="support",
        reason=f"support function of degree {cloud.fit.degree}: the body is smooth, 95 % of the contacts left out of the fit "
        f"lie within {cloud.fit_error:.2g} {cloud.unit} of it",
    )
    return found


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


def table(surface: Any, bound: Array) -> np.ndarray[Any, np.dtype[np.void]]:
    """Vertices with their normals and the certified local bound (v,) as a structured array, as `files.ply` writes them."""
    names = [(name, "f8") for name in "xyz"] + [(f"n{name}", "f4") for name in "xyz"] + [("bound", "f4")]
    rows = np.empty(len(surface.vertices), dtype=names)
    for columns, values in (
        ("x y z", surface.vertices),
        ("nx ny nz", surface.vertex_normals),
        ("bound", bound[:, None]),
    ):
        for column, value in zip(columns.split(), np.asarray(values).T, strict=True):
            rows[column] = value
    return rows
