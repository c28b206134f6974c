"""Unit vectors of many rows."""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) scaled to unit length."""
    scaled: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return scaled


def across(normals: Array) -> tuple[Array, Array]:
    """Two unit vectors (n, 3) across each of the unit normals (n, 3) and across each other."""
    first = unit(np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)]))
    return first, np.cross(normals, first)
