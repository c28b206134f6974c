"""Vectors of many lanes at once, with the components along the first axis for speed: arrays (3, n)."""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array


def dot(a: Array, b: Array) -> Array:
    """Scalar products (n,) of vectors (3, n)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: Array, b: Array) -> Array:
    """Vector products (3, n) of vectors (3, n)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def unit(a: Array) -> Array:
    """Vectors (3, n) scaled to unit length."""
    return np.asarray(a / np.sqrt(dot(a, a)))


def basis(n: Array) -> tuple[Array, Array]:
    """Two unit vectors (3, n) across the unit vectors n (3, n), so that the three are right-handed.

    They are smooth functions of n but for the pole (0, 0, -1) (T. Duff and others, "Building an orthonormal basis, revisited",
    Journal of Computer Graphics Techniques 6 (2017) 1).
    """
    sign = np.copysign(1.0, n[2])
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return (
        np.stack([1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]]),
        np.stack([b, sign + n[1] * n[1] * a, -n[1]]),
    )
