"""How errors of the support reactions carry over to the contact: the derivatives of the closed form.

With ``q = m0z / (2 √f)`` and the shape of the rod in units of ``1/√f`` (`planar.elastica`), place and arc length of the
contact are products of a function of ``α`` and ``q`` with ``1/√f``; ``α``, ``f`` and ``q`` follow from the reactions by (9),
``β`` by (12).
Errors of the place grow as ``1/f`` near touch-down, where the place is a quotient of a small moment and a small force.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from planar.arrays import NAMES, Array, Mask, check_direction, checked_reactions
from planar.elastica import bend_with_slopes
from planar.march import solve
from planar.rods import Rod

DIFFERENCE = 3e-4
"""Relative step of differences: their errors, its square and the march's over it, are both some 1e-7."""


def jacobian(f0x: ArrayLike, f0y: ArrayLike, m0z: ArrayLike, *, direction: int = -1, rod: Rod | None = None) -> Array:
    """Derivatives (n, 5, 3) of a contact's place x and y, arc length s1, α and β (rows) by f0x, f0y and m0z (columns).

    Reactions (n,) in ``EI/L²`` and ``EI/L``; lengths in rod lengths, angles in radians; `direction` is the sign of the base's
    motion along x.  The covariance of these five is ``J C Jᵀ``, with C that of the reactions; the slope (14) of a tangential
    contact is ``α - β``, and ``α + β`` in a sweep in +x.  `rod`: as in `planar.reconstruct`.  NaN where no rod has these
    reactions, and where there is no force.  The errors are those of the first order: they hold where the errors of the force
    are small compared with the force.
    Raises ValueError for arrays of different lengths and for another direction than -1 or 1.
    """
    check_direction(direction)
    _, across, along, moment = checked_reactions(np.zeros_like(np.asarray(f0x, dtype=float)), f0x, f0y, m0z)
    side = -direction
    # a sweep in +x is the mirror image of a sweep in -x
    across, moment = side * across, side * moment
    rod = Rod() if rod is None else rod
    if rod.is_straight_and_uniform:
        result = _of_closed_form(across, along, moment)
    else:
        result = _by_differences(rod if side > 0 else rod.mirrored(), across, along, moment)
    if side < 0:
        # x and α are odd under the reflection; so are f0x and m0z
        result[:, [0, 3], :] *= -1
        result[:, :, [0, 2]] *= -1
    result[~np.isfinite(result).all(axis=(1, 2))] = np.nan
    return result


def _of_closed_form(across: Array, along: Array, moment: Array) -> Array:
    """`jacobian` of straight uniform rods."""
    n = len(across)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        force = np.hypot(across, along)
        alpha, root = np.arctan2(-across, along), np.sqrt(force)
        q = moment / (2 * root)
        q = np.where(q >= 0, q, np.nan)  # beyond cos(α/2) the rod's shape is NaN as well
        shape, s1_alpha, s1_q, x_alpha, x_q, y_alpha, y_q = bend_with_slopes(alpha, q)
        by_alpha = np.stack([-along / force**2, across / force**2, np.zeros(n)], axis=1)
        by_force = np.stack([across / force, along / force, np.zeros(n)], axis=1)
        by_q = -(q / (2 * force))[:, None] * by_force
        by_q[:, 2] = 1 / (2 * root)

        def scaled(value: Array, alpha_slope: Array, q_slope: Array) -> Array:
            """Derivatives (n, 3) of value / √f."""
            changed: Array = alpha_slope[:, None] * by_alpha + q_slope[:, None] * by_q
            return (changed - (value / (2 * force))[:, None] * by_force) / root[:, None]

        # β = 2 arcsin(k) - π/2 with k² = sin²(α/2) + q²
        square = np.sin(alpha / 2) ** 2 + q * q
        k_complement = np.sqrt(square * (1 - square))
        beta = (np.sin(alpha)[:, None] * by_alpha / 2 + (2 * q)[:, None] * by_q) / k_complement[:, None]
        rows = [
            scaled(shape.x, x_alpha, x_q),
            scaled(shape.y, y_alpha, y_q),
            scaled(shape.length, s1_alpha, s1_q),
            by_alpha,
            beta,
        ]
    return np.stack(rows, axis=1)


def _by_differences(rod: Rod, across: Array, along: Array, moment: Array) -> Array:
    """`jacobian` of any rod, by central differences of its contacts."""
    reactions = np.stack([across, along, moment])
    force = np.hypot(*(reactions[:2] + rod.pull))
    change = DIFFERENCE * np.stack([force, force, np.abs(moment)])
    moved = np.tile(reactions[:, None, None], (1, 2, 3, 1))  # of each reaction down and up
    for k in range(3):
        moved[k, :, k] += [-change[k], change[k]]
    everywhere = rod.rows(np.tile(np.arange(len(moment)), 6))
    with np.errstate(divide="ignore", invalid="ignore"):
        found = solve("closed-form", everywhere, *moved.reshape(3, -1))
        values = np.stack([found.x, found.y, found.s1, found.alpha, found.beta]).reshape(5, 2, 3, -1)
        return np.asarray((values[:, 1] - values[:, 0]) / (2 * change)).transpose(2, 0, 1)


class Errors(NamedTuple):
    """Standard deviations (n,) and covariances of contacts, dimensionless; infinite where no rod has the reactions."""

    point: Array
    """(n, 2, 2) covariance of the place."""
    largest: Array
    """(n,) standard deviation of the place in its least certain direction."""
    s1: Array
    """(n,)"""
    friction_angle: Array
    """(n,) of the angle β."""
    slope: Array
    """(n,) of the slope in tangential contact."""


def errors(
    f0x: ArrayLike,
    f0y: ArrayLike,
    m0z: ArrayLike,
    *,
    noise: tuple[float, float],
    direction: int = -1,
    rod: Rod | None = None,
    missing: str | None = None,
    known: str = "friction",
    known_sd: float = 0.0,
    tip: ArrayLike = False,
    covariance: Array | None = None,
) -> Errors:
    """Errors of the contacts that `planar.reconstruct` finds for reactions (n,), by the noise of force and moment.

    noise
        standard deviations of each component of the force and of the moment.
    missing
        'f0x', 'f0y' or 'm0z' if it was not measured but completed by `planar.complete`, from what was `known`, 'friction' or
        'slope', with the standard deviation `known_sd` of that angle in radians; `tip` (n,) are the contacts at the tip.
    covariance
        (n, 3, 3) that of the reactions in each row, in the place of `noise`.
    direction, rod
        as in `jacobian`.
    """
    if covariance is None and not max(*noise, known_sd):
        zero = np.zeros(len(np.asarray(f0x)))
        return Errors(np.zeros((len(zero), 2, 2)), zero, zero, zero, zero)
    spread = jacobian(f0x, f0y, m0z, direction=direction, rod=rod)
    if covariance is None:
        spread *= [noise[0], noise[0], noise[1]]
    else:
        sizes, vectors = np.linalg.eigh(np.nan_to_num(covariance))
        spread = spread @ (vectors * np.sqrt(np.maximum(sizes, 0.0))[:, None])
    if missing is not None:
        spread = _completed(spread, missing, known, known_sd, np.broadcast_to(tip, len(spread)), direction)
    with np.errstate(over="ignore", invalid="ignore"):  # forces far below the noise have errors beyond all numbers
        point = np.einsum("nik,njk->nij", spread[:, :2], spread[:, :2])
        mean, half = (point[:, 0, 0] + point[:, 1, 1]) / 2, (point[:, 0, 0] - point[:, 1, 1]) / 2
        largest = np.sqrt(mean + np.hypot(half, point[:, 0, 1]))
        # the slope is α - β, in the mirror image, where β keeps its sign, α + β
        slope = spread[:, 3] + direction * spread[:, 4]
        deviations = [np.linalg.norm(part, axis=1) for part in (spread[:, 2], spread[:, 4], slope)]
    known = np.isfinite(largest)
    return Errors(point, *(np.where(known, values, np.inf) for values in (largest, *deviations)))


def _completed(spread: Array, missing: str, known: str, known_sd: float, tip: Mask, direction: int) -> Array:
    """Spreads (n, 5, 3) of a contact by the two channels measured and by what is known, from those by all three."""
    if missing not in NAMES or known not in ("friction", "slope"):
        raise ValueError(
            f"missing must be one of {', '.join(NAMES)}, and known 'friction' or 'slope', got {missing}, {known}"
        )
    column = NAMES.index(missing)
    # x, y, s1, α and β: what is known keeps β, the slope α - β, or s1 = 1
    held = np.array([0.0, 0.0, 0.0, 0.0, 1.0] if known == "friction" else [0.0, 0.0, 0.0, 1.0, direction])
    weights = np.where(tip[:, None], [0.0, 0.0, 1.0, 0.0, 0.0], held)
    rate = np.einsum("nr,nrc->nc", weights, spread)
    with np.errstate(all="ignore"):
        change = spread[:, :, column] / rate[:, column, None]
        completed: Array = spread - change[:, :, None] * rate[:, None, :]
        completed[:, :, column] = change * np.where(tip, 0.0, known_sd)[:, None]
    return completed
