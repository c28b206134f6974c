"""Segments and convex bodies: which of them meet."""

from __future__ import annotations

from typing import Any

import numpy as np

from scan3d.arrays import NEGLIGIBLE, Array, Mask

# Segments that are tested at once, so that the intermediate arrays stay small.
_AT_ONCE = 128


def segments_meet(body: Any, start: Array, along: Array, length: float, distance: float = 0.0) -> Mask:
    """Which segments (n,) meet a convex `trimesh.Trimesh` whose faces are moved outwards by `distance`.

    start (n, 3), along (n, 3)
        where the segments begin, and unit vectors along them.
    length
        of all segments.

    Faces that are moved outwards enclose, at edges, more than the points that are so near.
    """
    normals, corner = np.asarray(body.face_normals), np.asarray(body.triangles)[:, 0]
    offset = (normals * corner).sum(axis=1) + distance - NEGLIGIBLE * length
    middle, reach = body.bounds.mean(axis=0), float(np.linalg.norm(body.extents)) / 2 + distance
    nearest = np.clip(((middle - start) * along).sum(axis=1), 0.0, length)
    near = np.linalg.norm(start + nearest[:, None] * along - middle, axis=1) < reach + distance
    meets = np.zeros(len(start), dtype=bool)
    rows = np.flatnonzero(near)
    for first in range(0, len(rows), _AT_ONCE):
        part = rows[first : first + _AT_ONCE]
        meets[part] = _below(start[part] @ normals.T - offset, length * (along[part] @ normals.T))
    return meets


def _below(height: Array, change: Array) -> Mask:
    """Which segments (n,) pass below all planes (f,), above which they begin at heights (n, f) that change by (n, f)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        place = -height / change
    above = (change == 0) & (height > 0)
    enter = np.where(change < 0, place, np.where(above, np.inf, -np.inf)).max(axis=1)
    leave = np.where(change > 0, place, np.inf).min(axis=1)
    return np.asarray(np.maximum(enter, 0.0) < np.minimum(leave, 1.0))
