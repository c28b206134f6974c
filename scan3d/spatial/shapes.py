"""The rod in space under one contact force: it bends in the plane of its clamp's axis and the force (S1 to S3).

A state of the rod is four numbers (4, n): the angle ω of the bending plane, ``e = cos ω x + sin ω z``, the direction α of the
force in that plane, ``F = f (sin α e - cos α t0)``, its size as ``q² = m0² / (4 f)``, and the contact's arc length s1.  The
relative shape is an even function of q, so that q² is the variable in which it is regular where the rod is straight.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planar.elastica import bend_with_slopes
from scan3d.arrays import Array


class Clamp(NamedTuple):
    """Poses of n clamps: position and axes, each (3, n); the rod is along y, the sweep along -x."""

    position: Array
    x: Array
    y: Array
    z: Array


class Bent(NamedTuple):
    """Bent rods and their derivatives by ω, α, q², s1; vectors (3, n) in the world."""

    place: Array
    """Contact ``r1``."""
    place_slopes: tuple[Array, Array, Array, Array]
    force: Array
    """Direction of the contact force on the rod."""
    force_omega: Array
    force_alpha: Array
    tangent: Array
    """``t1`` at the contact, towards the tip."""
    tangent_omega: Array
    tangent_angle: Array
    """Derivative by the angle ``φ1`` of the tangent in the bending plane."""
    angle_alpha: Array
    angle_square: Array
    length: Array
    """``√f s1``."""


def bent(state: Array, clamp: Clamp) -> Bent:
    """The rods of states (4, n) at their clamps."""
    omega, alpha, squared, s1 = state
    q = np.sqrt(squared)
    cos, sin = np.cos(omega), np.sin(omega)
    e = cos * clamp.x + sin * clamp.z
    across = cos * clamp.z - sin * clamp.x
    shape = bend_with_slopes(alpha, q)
    length = shape.shape.length
    x, y = shape.shape.x / length, shape.shape.y / length
    x_alpha, y_alpha = (
        (shape.x_alpha - x * shape.length_alpha) / length,
        (shape.y_alpha - y * shape.length_alpha) / length,
    )
    by_square = 1 / (2 * q * length)
    x_square, y_square = (shape.x_q - x * shape.length_q) * by_square, (shape.y_q - y * shape.length_q) * by_square
    reach = x * e + y * clamp.y

    s, c = np.sin(alpha / 2), np.cos(alpha / 2)
    modulus_squared, complement = s * s + squared, c * c - squared
    with np.errstate(invalid="ignore"):
        modulus, rest = np.sqrt(modulus_squared), np.sqrt(complement)
    # φ1 = α - β with β = 2 arcsin k - π/2
    angle = alpha - 2 * np.arctan2(modulus, rest) + np.pi / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = 1 / (modulus * rest)
    cos_1, sin_1 = np.cos(angle), np.sin(angle)
    sin_alpha, cos_alpha = 2 * s * c, (c - s) * (c + s)
    return Bent(
        clamp.position + s1 * reach,
        (s1 * x * across, s1 * (x_alpha * e + y_alpha * clamp.y), s1 * (x_square * e + y_square * clamp.y), reach),
        sin_alpha * e - cos_alpha * clamp.y,
        sin_alpha * across,
        cos_alpha * e + sin_alpha * clamp.y,
        cos_1 * e + sin_1 * clamp.y,
        cos_1 * across,
        cos_1 * clamp.y - sin_1 * e,
        1 - rate * s * c,
        -rate,
        length,
    )


def wrench(state: Array, length: Array) -> tuple[Array, Array]:
    """Support reactions, force and moment (3, n) in the clamps' frames, of states (4, n) with ``length = √f s1`` (S8)."""
    omega, alpha, squared, s1 = state
    root = length / s1
    force, moment = root * root, 2 * np.sqrt(squared) * root
    lateral = -force * np.sin(alpha)
    cos, sin = np.cos(omega), np.sin(omega)
    zero = np.zeros_like(force)
    # b = e × t0 = cos ω z - sin ω x
    return (
        np.stack([lateral * cos, force * np.cos(alpha), lateral * sin]),
        np.stack([-moment * sin, zero, moment * cos]),
    )
