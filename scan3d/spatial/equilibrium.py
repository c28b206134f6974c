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
from scan3d.arrays import Array, Mask
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
    """(n,) part of the unit force along the normal."""
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
    parts = _across(state, rod, patch, law, tangents)
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
    return System(residual, jacobian, parts.normal_force, slip, friction_force, -(v * g).sum(axis=0), sticks)


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


def _across(state: Array, rod: Bent, patch: Patch, law: Law, tangents: Array) -> _Across:
    """What the law of friction needs, with the derivatives (3, 3, n) of the rod's tangent by ω, α, q²."""
    m, count = patch.law_normal, state.shape[1]
    # slip v = P y with y = r1 - r1⁻ - (s1 - s1⁻) t1
    along = state[3] - law.s1
    y = patch.point - law.place - along * rod.tangent
    y_slopes = np.concatenate([-along * tangents, -rod.tangent[None], patch.point_1[None], patch.point_2[None]])
    y_n, normal_force, zero = dot(y, m), dot(rod.force, m), np.zeros(count)
    by_place = dot(rod.force, patch.law_normal_1), dot(rod.force, patch.law_normal_2)
    normal_slopes = np.stack([dot(rod.force_omega, m), dot(rod.force_alpha, m), zero, zero, *by_place])
    slip, force, frozen = (np.empty((2, count)) for _ in range(3))
    slip_slopes, force_slopes = [], []
    for k, u in enumerate(basis(m)):
        turned = dot(patch.law_normal_1, u), dot(patch.law_normal_2, u)
        slip[k], force[k], frozen[k] = dot(y, u), dot(rod.force, u), dot(law.direction, u)
        slope = dot(y_slopes.swapaxes(0, 1), u[:, None])
        slope[4] -= y_n * turned[0]
        slope[5] -= y_n * turned[1]
        slip_slopes.append(slope)
        by_place = -normal_force * turned[0], -normal_force * turned[1]
        force_slopes.append(np.stack([dot(rod.force_omega, u), dot(rod.force_alpha, u), zero, zero, *by_place]))
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
