"""Equilibria of the sliding rod: its bent shape, and six equations in six unknowns with their exact Jacobian (S19, S20).

Under one contact force the rod bends in the plane of its clamp's axis and the force (S1 to S3).  A state of the rod is four
numbers (4, n): the angle ω of the bending plane, ``e = cos ω x + sin ω z``, the direction α of the force in that plane,
``F = f (sin α e - cos α t0)``, its size as ``q² = m0² / (4 f)``, and the contact's arc length s1.  The relative shape is an
even function of q, so that q² is the variable in which it is regular where the rod is straight.

Two local coordinates of the place on the body complete the unknowns.  The equations state that the rod's contact is that place
(three), that Coulomb's law holds between the force and the slip since the state before (two), and that the contact is the tip
or tangential (one).  Coulomb's law is taken one branch at a time: (S20) contains both, but near touch-down Newton's method
flips between them.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planar.elastica import bend_with_slopes
from scan3d.arrays import NEGLIGIBLE, Array, Mask, ratio
from scan3d.spatial.bodies import Patch, basis, dot


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
    x_alpha = (shape.x_alpha - x * shape.length_alpha) / length
    y_alpha = (shape.y_alpha - y * shape.length_alpha) / length
    by_square = 1 / (2 * q * length)
    x_square, y_square = (shape.x_q - x * shape.length_q) * by_square, (shape.y_q - y * shape.length_q) * by_square
    reach = x * e + y * clamp.y

    s, c = np.sin(alpha / 2), np.cos(alpha / 2)
    modulus_squared, complement = s * s + squared, c * c - squared
    with np.errstate(invalid="ignore"):
        modulus, rest = np.sqrt(modulus_squared), np.sqrt(complement)
    # φ1 = α - β with β = 2 arcsin k - π/2
    angle = alpha - 2 * np.arctan2(modulus, rest) + np.pi / 2
    rate = ratio(1, modulus * rest)
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


class Mode(IntEnum):
    """Which branch of Coulomb's law a contact is on."""

    FROZEN = 0
    """It slides in a given direction: the first steps of Newton's method, while the slip is not known."""
    SLIDE = 1
    """Friction has its full size, against the slip."""
    STICK = 2
    """There is no slip."""
    EITHER = 3
    """It slides or sticks, as (S20) decides in every step of Newton's method."""


class Law(NamedTuple):
    """What the friction of n contacts depends on."""

    friction: Array
    """(n,) coefficient."""
    place: Array
    """(3, n) contact of the state before."""
    s1: Array
    """(n,) its arc length."""
    mode: NDArray[np.int8]
    """(n,) of `Mode`."""
    direction: Array
    """(3, n) direction of the slip where it is frozen."""
    rate: Array
    """(n,) weight of the slip in the residual of a contact that sticks."""
    drag: Array
    """(n,) drag on the slip, zero but while a snap is followed."""


class System(NamedTuple):
    """Residuals (6, n) and Jacobians (6, 6, n), and what decides whether a solution is valid."""

    residual: Array
    jacobian: Array
    normal_force: Array
    """(n,) part of the unit force along the normal that friction refers to."""
    tangential_force: Array
    """(3, n) the rest of the unit force."""
    slip: Array
    """(n,) path of the rod's material point along the surface, since the state before."""
    friction_force: Array
    """(n,) part of the unit force along the surface."""
    dissipated: Array
    """(n,) friction times slip: positive where friction acts against the slip."""
    sticks: Mask


def system(state: Array, rod: Bent, patch: Patch, law: Law) -> System:
    """The equations at states (4, n) with their bent rods and places on the body."""
    n, count = patch.normal, state.shape[1]
    residual, jacobian = np.empty((6, count)), np.zeros((6, 6, count))
    residual[:3] = rod.place - patch.point
    for k, slope in enumerate(rod.place_slopes):
        jacobian[:3, k] = slope
    np.negative(patch.point_1, out=jacobian[:3, 4])
    np.negative(patch.point_2, out=jacobian[:3, 5])

    zero = np.zeros(count)
    tangents = np.stack([rod.tangent_omega, rod.angle_alpha * rod.tangent_angle, rod.angle_square * rod.tangent_angle])
    law_normal = _law_normal(rod, patch, tangents)
    parts = _across(state, rod, patch, law, tangents, law_normal)
    sticks = _friction(residual, jacobian, law, parts)

    lean = -dot(rod.tangent, n)
    tip = 1 - state[3] <= lean
    residual[5] = np.where(tip, 1 - state[3], lean)
    slopes = [*(-dot(tangent, n) for tangent in tangents), zero]
    slopes += [-dot(rod.tangent, patch.normal_1), -dot(rod.tangent, patch.normal_2)]
    jacobian[5] = np.where(tip, 0.0, np.stack(slopes))
    jacobian[5, 3] = np.where(tip, -1.0, 0.0)
    v, g = parts.slip, parts.force
    slip, friction_force = np.hypot(v[0], v[1]), np.hypot(g[0], g[1])
    tangential_force = rod.force - parts.normal_force * law_normal[0]
    dissipated = -(v * g).sum(axis=0)
    return System(residual, jacobian, parts.normal_force, tangential_force, slip, friction_force, dissipated, sticks)


def _law_normal(rod: Bent, patch: Patch, tangents: Array) -> tuple[Array, Array]:
    """The normals (3, n) that friction refers to, and their derivatives (6, 3, n).

    Where facets stand for a smooth body, the smooth normal of a place is not exactly that of the smooth body's contact with
    this rod.  It is turned so that it has the same angle to the rod as the facets' normal, which is 90° in tangential contact:
    the force then stays in a cone about a normal of the rod, |β| <= ζ (S11).
    """
    m, t = patch.law_normal, rod.tangent
    slopes = np.zeros((6, *m.shape))
    slopes[4], slopes[5] = patch.law_normal_1, patch.law_normal_2
    turned = np.abs(patch.normal - m).max(axis=0) > NEGLIGIBLE
    if not turned.any():
        return m, slopes
    by_rod, gap = np.zeros_like(slopes), patch.normal - m
    by_rod[:3] = tangents
    gap_slopes = -slopes
    gap_slopes[4] += patch.normal_1
    gap_slopes[5] += patch.normal_2
    missing = dot(gap, t)
    missing_slopes = (gap_slopes * t + by_rod * gap).sum(axis=1)
    vector = m + missing * t
    vector_slopes = slopes + missing_slopes[:, None] * t + missing * by_rod
    size = np.sqrt(dot(vector, vector))
    normal = vector / size
    normal_slopes = (vector_slopes - (vector_slopes * normal).sum(axis=1)[:, None] * normal) / size
    return np.where(turned, normal, m), np.where(turned, normal_slopes, slopes)


class _Across(NamedTuple):
    """Slip and force in the tangent plane (2, n), and their derivatives (2, 6, n) by the unknowns."""

    slip: Array
    slip_slopes: Array
    force: Array
    force_slopes: Array
    normal_force: Array
    """(n,)"""
    normal_slopes: Array
    """(6, n)"""
    frozen: Array
    """(2, n) direction of the slip where it is frozen."""


def _across(
    state: Array, rod: Bent, patch: Patch, law: Law, tangents: Array, law_normal: tuple[Array, Array]
) -> _Across:
    """What the law of friction needs, with the derivatives (3, 3, n) of the rod's tangent by ω, α, q²."""
    (m, m_slopes), count = law_normal, state.shape[1]
    # slip v = P y with y = r1 - r1⁻ - (s1 - s1⁻) t1
    along = state[3] - law.s1
    y = patch.point - law.place - along * rod.tangent
    y_slopes = np.concatenate([-along * tangents, -rod.tangent[None], patch.point_1[None], patch.point_2[None]])
    y_n, normal_force = dot(y, m), dot(rod.force, m)
    by_rod = np.zeros_like(y_slopes)
    by_rod[0], by_rod[1] = rod.force_omega, rod.force_alpha
    by_rod, y_slopes, m_slopes = (slopes.swapaxes(0, 1) for slopes in (by_rod, y_slopes, m_slopes))
    normal_slopes = dot(by_rod, m[:, None]) + dot(rod.force[:, None], m_slopes)
    slip, force, frozen = (np.empty((2, count)) for _ in range(3))
    slip_slopes, force_slopes = [], []
    for k, u in enumerate(basis(m)):
        turned = dot(m_slopes, u[:, None])
        slip[k], force[k], frozen[k] = dot(y, u), dot(rod.force, u), dot(law.direction, u)
        slip_slopes.append(dot(y_slopes, u[:, None]) - y_n * turned)
        force_slopes.append(dot(by_rod, u[:, None]) - normal_force * turned)
    return _Across(slip, np.stack(slip_slopes), force, np.stack(force_slopes), normal_force, normal_slopes, frozen)


def _friction(residual: Array, jacobian: Array, law: Law, parts: _Across) -> Mask:
    """Fill in the two equations of friction; returns where the contact sticks."""
    v, v_slopes, g, g_slopes, normal_force, normal_slopes, frame = parts
    g = g + law.drag * v
    g_slopes = g_slopes + law.drag * v_slopes
    cone = law.friction * normal_force
    frozen, sticks = law.mode == Mode.FROZEN, law.mode == Mode.STICK
    w = np.where(frozen, frame, law.rate * v - g)
    w_slopes = law.rate * v_slopes - g_slopes
    size = np.hypot(w[0], w[1]) + 1e-300
    sticks |= (law.mode == Mode.EITHER) & (size < cone)
    direction = w / size
    turn = np.where(frozen, 0.0, cone / size)
    # a change of w turns its direction by its part across it
    across = np.stack([-direction[1], direction[0]])
    turned = turn * (across[0] * w_slopes[0] + across[1] * w_slopes[1])
    for k in range(2):
        residual[3 + k] = np.where(sticks, law.rate * v[k], g[k] + cone * direction[k])
        slides = g_slopes[k] + law.friction * direction[k] * normal_slopes + across[k] * turned
        jacobian[3 + k] = np.where(sticks, law.rate * v_slopes[k], slides)
    return np.asarray(sticks)
