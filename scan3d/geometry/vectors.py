"""Vectors of many rows."""

from __future__ import annotations

import numpy as np

from scan3d.arrays import AT_ONCE, Array


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) scaled to unit length."""
    scaled: Array = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return scaled


def unit_or_zero(vectors: Array) -> Array:
    """Vectors (n, 3) scaled to unit length, zero where they have none."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    scaled: Array = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
    return scaled


def across(normals: Array) -> tuple[Array, Array]:
    """Two unit vectors (n, 3) across each of the unit normals (n, 3) and across each other."""
    first = unit(np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)]))
    return first, np.cross(normals, first)


def highest(points: Array, directions: Array) -> Array:
    """(d,) the largest products of points (n, 3) with each of the directions (d, 3): the support function of their hull."""
    blocks = np.array_split(directions, 1 + len(points) * len(directions) // AT_ONCE)
    return np.concatenate([(block @ points.T).max(axis=1) for block in blocks])
