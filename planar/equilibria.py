"""Equilibria of the rod at given places of a contour: tangential contact (7) and tip contact (6).

A place is a slope angle ``α̃`` and a point ``(ξ, η)``; with the friction angle ``ζ`` the contact force has the direction
``α = α̃ + ζ`` (2).  The base position ``x0`` follows from the place, not the other way round, so that no continuation
in ``x0`` is needed: tangential contact is explicit, tip contact one scalar root.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planar.arrays import Array, Mask, ratio
from planar.elastica import ShapeSlopes, bend, bend_with_slopes, tangential_q, unbowed_height

# Angle to the vertical, in radians, below which the limit of the straight rod is used, where the closed form is 0/0.
_UPRIGHT = 1e-7
# Residual of y1 = η, in rod lengths, at which the iteration for a tip contact ends: rounding.
_HEIGHT_ROUNDING = 4 * np.finfo(float).eps


class State(NamedTuple):
    """Equilibria (n,), dimensionless; NaN where no equilibrium exists."""

    x0: Array
    """Base position."""
    q: Array
    """``m0z / (2 √f)``."""
    root_f: Array
    """``√f``."""
    s1: Array
    """Contact along the rod."""
    x0_slope: Array
    """Change of x0 with the slope at a fixed point, as at a vertex."""
    x0_arc: Array
    """Change of x0 with the arc length along the tangent at a fixed slope, as on an edge."""


def is_tangential(slope: Array, y: Array, friction_angle: Array) -> Mask:
    """Whether the rod is long enough to touch the place tangentially (``s1 <= 1``); otherwise only its tip can touch it."""
    return overhang(slope, y, friction_angle) <= 0


def overhang(slope: Array, y: Array, friction_angle: Array) -> Array:
    """Height of the place above that of a rod whose tip touches tangentially, in rod lengths: positive in tip contact."""
    shape = bend(slope + friction_angle, tangential_q(slope, friction_angle))
    height = np.where(slope > np.pi / 2 - _UPRIGHT, 1.0, ratio(shape.y, shape.length))
    # only the straight rod reaches y = 1, and only with its tip
    return np.where(y >= 1.0, np.maximum(y - height, np.finfo(float).eps), y - height)


def tangential(slope: Array, x: Array, y: Array, friction_angle: Array) -> State:
    """Tangential contact: ``φ1 = α̃`` fixes the rod's shape, the height of the contact its scale."""
    alpha = slope + friction_angle
    q = tangential_q(slope, friction_angle)
    with np.errstate(divide="ignore", invalid="ignore"):
        bent = bend_with_slopes(alpha, q)
        shape = bent.shape
        lean = shape.x / shape.y
        q_alpha = -np.sin(alpha) / (4 * q)
        shape_x = bent.x_alpha + bent.x_q * q_alpha
        shape_y = bent.y_alpha + bent.y_q * q_alpha
        lean_slope = (shape_x - lean * shape_y) / shape.y
        root_f = shape.y / y
        s1 = shape.length / root_f
    # upright: a cantilever under a small end load, turned by 3/2 of its deflection over its length
    steepness = np.pi / 2 - slope
    upright = steepness < _UPRIGHT
    lean = np.where(upright, 2 / 3 * steepness, lean)
    lean_slope = np.where(upright, -2 / 3, lean_slope)
    s1 = np.where(upright, y, s1)
    root_f = np.where(q == 0, 0.0, root_f)
    return State(x - y * lean, q, root_f, s1, -y * lean_slope, np.cos(slope) - lean * np.sin(slope))


def tip(slope: Array, x: Array, y: Array, friction_angle: Array, q: Array | None = None) -> State:
    """Tip contact, ``s1 = 1``: the root ``q`` of ``y1(q) = η`` where not given, on the branch without inflections."""
    alpha = slope + friction_angle
    q = np.full(alpha.shape, np.nan) if q is None else q.copy()
    unknown = np.isnan(q)
    q[unknown] = _tip_root(alpha[unknown], y[unknown], tangential_q(slope, friction_angle)[unknown])
    with np.errstate(divide="ignore", invalid="ignore"):
        bent = bend_with_slopes(alpha, q)
        ratios = tip_ratios(bent)
        x0_height = -ratios.lean_q / ratios.height_q
    straight = (q == 0) & (alpha > 0)
    lean = np.where(straight, 0.0, ratios.lean)
    lean_alpha = np.where(straight, 0.0, ratios.lean_alpha)
    root_f = np.where(straight, 0.0, bent.shape.length)
    # at touch-down x0 varies with the square root of the height: an infinite rate
    x0_height = np.where(straight, np.inf, x0_height)
    height_alpha = np.where(straight, 0.0, ratios.height_alpha)
    with np.errstate(invalid="ignore"):
        x0_slope = np.where(straight, 0.0, -lean_alpha - height_alpha * x0_height)
        x0_arc = np.cos(slope) + np.where(np.sin(slope) == 0, 0.0, np.sin(slope) * x0_height)
    s1 = np.where(np.isnan(lean), np.nan, 1.0)
    return State(x - lean, q, root_f, s1, x0_slope, x0_arc)


def states(
    tangential_contact: Mask,
    slope: Array,
    x: Array,
    y: Array,
    friction_angle: Array,
    q: Array | None = None,
) -> State:
    """`tangential` where the mask is set, else `tip` (with q as known where it is given and not NaN)."""
    combined = State._make(np.full(len(slope), np.nan) for _ in State._fields)
    for mask in (tangential_contact, ~tangential_contact):
        if not mask.any():
            continue
        place = (slope[mask], x[mask], y[mask], friction_angle[mask])
        part = tangential(*place) if mask is tangential_contact else tip(*place, None if q is None else q[mask])
        for column, values in zip(combined, part, strict=True):
            column[mask] = values
    return combined


class TipRatios(NamedTuple):
    """Place of a rod's contact relative to its clamp, over ``s1``, and the partial derivatives in ``α`` and ``q``."""

    lean: Array
    """``(x1 - x0)/s1``"""
    lean_alpha: Array
    lean_q: Array
    height: Array
    """``y1/s1``"""
    height_alpha: Array
    height_q: Array


def tip_ratios(bent: ShapeSlopes) -> TipRatios:
    """The ratios of bent rods: with ``s1 = 1`` in tip contact they are the place of the tip itself."""
    shape = bent.shape
    lean, height = shape.x / shape.length, shape.y / shape.length
    return TipRatios(
        lean=lean,
        lean_alpha=(bent.x_alpha - lean * bent.length_alpha) / shape.length,
        lean_q=(bent.x_q - lean * bent.length_q) / shape.length,
        height=height,
        height_alpha=(bent.y_alpha - height * bent.length_alpha) / shape.length,
        height_q=(bent.y_q - height * bent.length_q) / shape.length,
    )


def _tip_root(alpha: Array, height: Array, q_upper: Array) -> Array:
    """Root q of ``y1/s1 = height`` in [0, q_upper]: Newton in q², in which the height is nearly linear, else bisection."""
    top = unbowed_height(alpha)
    shape = bend(alpha, q_upper)
    with np.errstate(divide="ignore", invalid="ignore"):
        bottom = shape.y / shape.length
        estimate = q_upper**2 * (top - height) / (top - bottom)
    root = np.full(alpha.shape, np.nan)
    straight = (alpha > 0) & (np.abs(height - 1.0) <= _HEIGHT_ROUNDING)
    root[straight] = 0.0
    at_transition = ~straight & (np.abs(height - bottom) <= _HEIGHT_ROUNDING)
    root[at_transition] = q_upper[at_transition]
    rows = np.flatnonzero(~straight & ~at_transition & (height < top) & (height > bottom))
    alpha, height, value = alpha[rows], height[rows], estimate[rows]
    low, high = np.zeros(len(rows)), q_upper[rows] ** 2
    for _ in range(100):  # in 300,000 random contacts at most 32 steps were needed
        if not len(rows):
            break
        q = np.sqrt(value)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = tip_ratios(bend_with_slopes(alpha, q))
            excess = ratios.height - height
            low, high = np.where(excess > 0, value, low), np.where(excess > 0, high, value)
            following = value - excess * 2 * q / ratios.height_q
        following = np.where((following > low) & (following < high), following, (low + high) / 2)
        root[rows] = q
        active = (np.abs(excess) > _HEIGHT_ROUNDING) & (high - low > _HEIGHT_ROUNDING * high)
        rows, alpha, height = rows[active], alpha[active], height[active]
        low, high, value = low[active], high[active], following[active]
    return root
