"""The state of the rod at touch-down: straight, and the direction of the contact force in the limit of no bending (S22)."""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array
from scan3d.spatial.shapes import Clamp
from scan3d.spatial.vectors import cross, dot

# q² of a rod that counts as straight.  Zero would make the derivatives by q² singular.
STRAIGHT = 1e-14


def first_state(normal: Array, s1: Array, clamp: Clamp, motion: Array, friction: Array) -> Array:
    """States (4, n) of straight rods that begin to touch a body with outward normals (3, n) at arc lengths (n,).

    `motion` (3, n) is that of the straight rod's point at the contact.  The rod yields only across itself: it slips along the
    direction across rod and normal, or, where friction withstands that, bends against the motion.
    """
    along = clamp.y
    motion = motion / np.sqrt(dot(motion, motion))
    n_along = dot(normal, along)
    lateral = normal - n_along * along
    size = np.sqrt(dot(lateral, lateral))
    ahead = -dot(motion, lateral) / size
    w = cross(normal, along) / size
    side = dot(motion, w)
    slides = np.abs(side) > ahead * friction / size
    # sliding across the rod: friction against it; else the force across the rod is against the motion, and friction along it
    sliding = normal - friction * np.sign(side) * w
    across = -(motion - dot(motion, along) * along)
    force_w = dot(across, w) / np.maximum(dot(across, lateral / size), 1e-12) * size
    # the tangent of the surface in the plane of normal and rod
    t = (along - n_along * normal) / size
    force_t = np.sqrt(np.maximum(friction**2 - force_w**2, 0.0))
    sticking = normal + force_w * w + force_t * t
    force = np.where(slides, sliding, sticking)
    force /= np.sqrt(dot(force, force))
    along_part = dot(force, along)
    across_part = force - along_part * along
    omega = np.arctan2(dot(across_part, clamp.z), dot(across_part, clamp.x))
    alpha = np.arctan2(np.sqrt(dot(across_part, across_part)), -along_part)
    return np.stack([omega, alpha, np.full(len(s1), STRAIGHT), s1])


def first_bend(depth: Array, alpha: Array, s1: Array) -> Array:
    """``q²`` (n,) of straight rods pushed aside by `depth` (n,): that of a slightly bent cantilever, within reason.

    A lateral force g bends it by ``g s1³/3`` with the moment ``g s1``, so that ``q² = m0²/(4 f)`` is 3/4 sin α depth/s1.
    """
    return np.asarray(np.minimum(0.75 * np.maximum(np.sin(alpha), 0.1) * np.maximum(depth, 1e-12) / s1, 0.1))
