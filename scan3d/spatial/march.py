"""Any rod in space, marched from its clamp: tapered, curved, twisted, heavy, in a clamp that gives.

In the rod's material frame ``d1, d2, d3 = t`` the part past ``s`` acts on the part before it by the moment ``m`` and the force
``n``; with the curvature ``u = K⁻¹ m + κ̂`` and ``K = diag(B, B, C B)``

    ``m' = -u × m - d3 × n``,  ``n' = -u × n``,

to which weight adds its part of the force.  At the clamp ``d1 = z, d2 = x, d3 = y``, turned by ``c M(0)`` where it gives.  The
contact does not carry a moment: there the excess ``e = m - m_o`` over the moment of the part that hangs free vanishes.  Six
reactions determine force and place, four unknowns: the place is where ``e·(t × F)`` falls through zero, a minimum of ``|e|``,
the first one, and the residuals ``e·t`` and ``e·F`` remain.  Friction does not enter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from planar.rods import (
    COARSE,
    GIVES,
    PLACES,
    STEPS,
    TRIED,
    Profile,
    Steps,
    along,
    crossings,
    drawn,
    enough_steps,
    grid,
    tableau,
)
from scan3d.arrays import Array, Index
from scan3d.spatial.bodies import cross, sphere_directions

_BLOCK = 512
# Rounds of an iteration at most, and the change that ends it.
_ROUNDS, _SETTLED = 40, 1e-12
# Rows of the state: moment, force and gravity in the material frame, the frame's quaternion, and the place.
_M, _N, _G, _Q, _R = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 13), slice(13, 16)


@dataclass(frozen=True)
class SpatialRod:
    """A rod in space, dimensionless; without arguments straight, uniform, weightless, in a rigid clamp."""

    profile: Profile = field(default_factory=Profile)
    curvature: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Curvature and twist ``κ̂`` of the free rod about d1, d2, d3, in ``1/L``."""
    torsion: float = 1 / 1.3
    """Torsional over bending stiffness: ``1/(1 + ν)`` of a round rod."""
    compliance: float = 0.0
    """Angle by which the clamp gives, in radians per ``EI(0)/L`` of moment, about any axis."""

    @property
    def is_straight_and_uniform(self) -> bool:
        straight = not any(self.curvature) and self.compliance == 0
        return straight and set(self.profile.diameters) == {1.0} and self.profile.weight == 0


def reshaped(rod: SpatialRod, shape: Array) -> SpatialRod:
    """The rod with another shape (3,): the logarithm of its tip's diameter grows by the first number, diameters before it by a
    part that is linear along it, and its curvatures about d1 and d2 grow by the others."""
    profile, (bend_z, bend_x, twist) = rod.profile, rod.curvature
    growth = 1 + np.expm1(shape[0]) * np.array(profile.knots)
    profile = replace(profile, diameters=tuple((growth * profile.diameters).tolist()))
    return replace(rod, profile=profile, curvature=(bend_z + float(shape[1]), bend_x + float(shape[2]), twist))


class Marched(NamedTuple):
    """Contacts (n,) of marched rods in rod lengths, in the clamp's frame; NaN where there is none."""

    s1: Array
    point: Array
    """(3, n) place relative to the clamp."""
    tangent: Array
    """(3, n)"""
    force: Array
    """(3, n) contact force on the rod."""
    torsion: Array
    """(n,) residual ``e·t`` of the moment along the rod at the contact."""
    skew: Array
    """(n,) residual ``e·F``."""


def contacts(
    rod: SpatialRod,
    force: Array,
    moment: Array,
    gravity: Array | None = None,
    steps: int | None = None,
) -> Marched:
    """Contacts of rods by support reactions ``f0`` and ``m0`` (3, n), and unit vectors (3, n) of gravity in the clamp's frame.

    Reactions of rods with weight are the whole ones.  `steps` along the rod are by default as many as places need to be
    right to 1e-10.  Raises ValueError for a weight without gravity.
    """
    start, contact_force = _clamped(rod, force, moment, gravity)

    def marched(rows: Index | slice, steps: Steps) -> Marched:
        return _contacts(rod, start[:, rows], contact_force[:, rows], steps)

    if steps is None:
        steps, found = enough_steps(marched, np.abs(start[:6]).sum(axis=0), places=slice(1, 2))
        if force.shape[1] <= TRIED:
            return Marched(*found)
    parts = [marched(slice(first, first + _BLOCK), steps) for first in range(0, max(force.shape[1], 1), _BLOCK)]
    return Marched(*(np.concatenate(columns, axis=-1) for columns in zip(*parts, strict=True)))


class Ends(NamedTuple):
    """Ends (n,) of marched rods in rod lengths, in the clamp's frame."""

    point: Array
    """(3, n) place relative to the clamp."""
    moment: Array
    """(3, n) moment on the end, zero where the rod is touched there by a force alone."""
    steps: int
    """Steps along the rod."""


def ends(rod: SpatialRod, force: Array, moment: Array, gravity: Array | None = None, steps: int | None = None) -> Ends:
    """The ends of rods by support reactions ``f0`` and ``m0`` (3, n), and unit vectors (3, n) of gravity in the clamp's frame.

    Reactions of rods with weight are the whole ones; the contact force acts at the end.  `steps` and errors as of `contacts`.
    """
    start, _ = _clamped(rod, force, moment, gravity)

    def marched(rows: Index | slice, steps: Steps) -> tuple[Array, Array]:
        state = start[:, rows]
        with np.errstate(all="ignore"):  # reactions of no rod overflow
            for at, end in pairwise(grid(rod.profile, steps)):
                state = _step(rod, state, at, end - at)
            return state[_R], _rotated(state[_Q], state[_M])

    if steps is None:
        # rods that are touched at their ends may be bent so little that one step is enough, if they are of one piece
        least = 1 if len(rod.profile.knots) == 2 else COARSE
        steps, _ = enough_steps(marched, np.abs(start[:6]).sum(axis=0), steps=least)
    parts = [marched(slice(first, first + _BLOCK), steps) for first in range(0, max(force.shape[1], 1), _BLOCK)]
    point, moment = (np.concatenate([part[k] for part in parts], axis=1) for k in (0, 1))
    return Ends(point, moment, steps)


def shapes(
    rod: SpatialRod, force: Array, moment: Array, gravity: Array | None, points: int, *, at_end: bool = False
) -> tuple[Array, Array]:
    """`planar.rods.drawn` in the clamp's frame, by support reactions and gravity as of `contacts`; NaN without a contact.

    A rod without contact force has the shape at rest, and one without a moment is that of a probing whose end sticks.  All of
    them are known to be touched `at_end`, or the place of the contact follows from the reactions.
    """
    start, contact_force = _clamped(rod, force, moment, gravity)
    s1 = np.ones(start.shape[1])
    if not at_end:
        s1 = np.minimum(contacts(rod, force, moment, gravity).s1, 1.0)
        largest = np.sqrt(np.minimum((contact_force**2).sum(axis=0), (moment**2).sum(axis=0)))
        s1[np.isnan(s1) & ~(largest > PLACES)] = 1.0
    goes_straight = not (rod.profile.weight or any(rod.curvature))
    return drawn(rod.profile, partial(_step, rod), start, s1, points, _R, _N, goes_straight)


def free_reactions(rod: SpatialRod, gravity: Array) -> tuple[Array, Array]:
    """Support reactions ``f0`` and ``m0`` (3, n) of the rod in the air under gravity along unit vectors (3, n).

    Raises ValueError where the clamp gives so much that none are found.
    """
    down = np.asarray(gravity, dtype=float)
    moment = np.zeros_like(down)
    for share in np.repeat(
        [1.0, 0.5], _ROUNDS
    ):  # a contraction for clamps that hold, by halves for those that give much
        state = _start(rod, np.zeros_like(down), moment, down)
        change = _rotated(state[_Q], _overhang(rod)(0.0, state)) - moment
        moment = moment + share * change
        if not (np.abs(change) > _SETTLED).any():
            return -rod.profile.weight * down, -moment
    raise ValueError(GIVES)


def _clamped(rod: SpatialRod, force: Array, moment: Array, gravity: Array | None) -> tuple[Array, Array]:
    """States (16, n) at the clamp by the support reactions (3, n), and contact forces (3, n)."""
    if rod.profile.weight and gravity is None:
        raise ValueError("a rod with weight needs the direction of gravity in the clamp's frame")
    down = np.broadcast_to(gravity if rod.profile.weight and gravity is not None else np.zeros((3, 1)), force.shape)
    contact_force = -force - rod.profile.weight * down
    return _start(rod, contact_force, -moment, down), contact_force


def _start(rod: SpatialRod, contact_force: Array, moment: Array, down: Array) -> Array:
    """States (16, n) at the clamp."""
    turn = rod.compliance * moment
    angle = np.sqrt((turn * turn).sum(axis=0))
    half = np.sinc(angle / (2 * np.pi)) / 2 * turn
    # the product with the quaternion of d1 = z, d2 = x, d3 = y, a turn by -120 degrees about (1, 1, 1)
    clamped = np.array([[1.0, 1, 1, 1], [-1, 1, -1, 1], [-1, 1, 1, -1], [-1, -1, 1, 1]]) / 2
    quaternion = clamped @ np.concatenate([np.cos(angle / 2)[None], half])
    inverse = np.concatenate([quaternion[:1], -quaternion[1:]])
    carried = (_rotated(inverse, vector) for vector in (moment, contact_force, down))
    return np.concatenate([*carried, quaternion, np.zeros_like(moment)])


def _rotated(quaternion: Array, vector: Array) -> Array:
    """Vectors (3, n) turned by quaternions (4, n) of any length close to 1."""
    w, axis = quaternion[:1], quaternion[1:]
    twice = 2 * cross(axis, vector)
    return np.asarray(vector + (w * twice + cross(axis, twice)) / (quaternion * quaternion).sum(axis=0))


def _contacts(rod: SpatialRod, start: Array, force: Array, steps: Steps) -> Marched:
    unknown, hangs = np.full((9, start.shape[1]), np.nan), _overhang(rod)
    found = Marched(unknown[0], unknown[1:4], unknown[4:7], force, unknown[7], unknown[8])
    # past the tip the rod goes on with the stiffness there and without weight
    # contacts past the tip are sought up to twice the rod's length
    ends = grid(rod.profile, steps, 2.0)
    with np.errstate(all="ignore"):
        falling = crossings(
            ends,
            start,
            partial(_step, rod),
            lambda s, state: _turning(state, hangs(s, state)),
        )
        _refine(rod, found, *falling)
    return found


def _turning(state: Array, hanging: Array) -> Array:
    """``e·(t × F)``, the rate at which ``|e|²/2`` falls."""
    return np.asarray((state[1] - hanging[1]) * state[3] - (state[0] - hanging[0]) * state[4])


def _curvature(rod: SpatialRod, s: Array, state: Array) -> Array:
    """(3, n) curvature and twist in the material frame."""
    stiffness = rod.profile.bending_stiffness(s) * np.array([[1.0], [1.0], [rod.torsion]])
    return np.asarray(state[_M] / stiffness + np.array(rod.curvature)[:, None])


def _turning_rates(rod: SpatialRod, s: Array, state: Array, hanging: Array) -> tuple[Array, Array]:
    """``(t × F)²`` and ``e·(t' × F)``: `_turning` falls by the first less the second, for ``e' = -t × F``."""
    bend, force, excess = _curvature(rod, s, state), state[_N], state[_M] - hanging
    by_force, by_excess = cross(bend, force), cross(bend, excess)
    bending = (by_excess[0] * force[1] - by_excess[1] * force[0]) + (excess[0] * by_force[1] - excess[1] * by_force[0])
    return force[0] ** 2 + force[1] ** 2, np.asarray(bending)


def _refine(rod: SpatialRod, found: Marched, rows: Index, before: Array, span: Array) -> None:
    """Fill in rows (m,) whose `_turning` falls through zero in steps from the states `before` (16, m), as of `crossings`."""
    start, length, low, high = span
    part = np.clip(length * low / (low - high), 0.0, length)
    hangs = _overhang(rod)
    for _ in range(_ROUNDS if rod.profile.weight else 3):
        state = _step(rod, before, start, part)
        hanging = hangs(start + part, state)
        across, bending = _turning_rates(rod, start + part, state, hanging)
        change = _turning(state, hanging) / (across - bending)
        part = part + change
        if not (np.abs(change) > _SETTLED).any():
            break
    # where the moment that is left turns the rod by more than the force does, no rod comes near these reactions
    part = np.where(np.abs(bending) < across, part, np.nan)
    excess = state[_M] - hanging
    tangent = _rotated(state[_Q], np.stack([0 * part, 0 * part, np.ones_like(part)]))
    bend = _curvature(rod, start + part, state)
    turned = _rotated(state[_Q], np.stack([bend[1], -bend[0], 0 * part]))
    found.s1[rows] = start + part
    found.point[:, rows] = state[_R] + tangent * change
    moved = tangent + turned * change
    found.tangent[:, rows] = moved / np.sqrt((moved * moved).sum(axis=0))
    found.torsion[rows], found.skew[rows] = excess[2], (excess * state[_N]).sum(axis=0)


Overhang = Callable[[ArrayLike, Array], Array]
"""Moments (3, n) at the roots of parts of a rod that hang free past arc lengths s, one or (n,), in frames of states there."""


@lru_cache(maxsize=8)
def _overhang(rod: SpatialRod) -> Overhang:
    """The moment that the direction of gravity in the material frame determines, as a polynomial in it.

    The rod is marched back from its tip, free of force and moment, for directions all around.
    """
    if rod.profile.weight == 0:
        return lambda s, state: np.zeros((3, state.shape[1]))
    for degree in (8, 12, 16, 24):  # the first that fits is taken
        tips = np.zeros((16, 2 * (degree + 1) ** 2))
        tips[_G], tips[_Q.start] = sphere_directions(tips.shape[1]), 1.0
        clamp = tips
        for end, at in pairwise(grid(rod.profile, STEPS)[::-1].tolist()):
            clamp = _step(rod, clamp, end, at - end)
        misfit = float(np.abs(_harmonics(clamp[_G], degree).T @ _fitted(clamp, degree) - clamp[_M].T).max())
        if misfit < _SETTLED:
            break
    if not misfit < 1e-9:
        raise ValueError(f"a rod of weight {rod.profile.weight:g} EI/L² bends too much under it; is it so heavy?")
    series = along(rod.profile, partial(_step, rod), tips, partial(_fitted, degree=degree))

    def moment(s: ArrayLike, state: Array) -> Array:
        coefficients = series(s)
        basis = _harmonics(state[_G], degree)[: coefficients.shape[-2]]
        return np.asarray(coefficients.T @ basis if np.ndim(s) == 0 else np.einsum("nck,cn->kn", coefficients, basis))

    return moment


def _fitted(state: Array, degree: int) -> Array:
    """(c, 3) coefficients of the polynomials that have the moments of states."""
    q, r = np.linalg.qr(_harmonics(state[_G], degree).T)
    return np.asarray(np.linalg.solve(r, q.T @ state[_M].T))


def _harmonics(direction: Array, degree: int) -> Array:
    """(c, n) the polynomials up to a degree that differ on unit vectors (3, n)."""
    polynomials, across = chebyshev.chebvander(direction[2], degree).T, direction[0] + 1j * direction[1]
    parts, power = [polynomials], np.ones_like(across)
    for order in range(1, degree + 1):
        power = power * across
        part = polynomials[: degree + 1 - order] * power
        parts += [part.real, part.imag]
    return np.concatenate(parts)


@lru_cache
def _products() -> tuple[Array, Array]:
    """(13, 39) rates of the state's first rows by their products with the curvatures, and (3, 16) of the place by those of
    the quaternion."""
    turned, moved = np.zeros((13, 13, 3)), np.zeros((3, 4, 4))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        for first in (0, 3, 6):  # v × u
            turned[first + i, first + j, k], turned[first + i, first + k, j] = 1.0, -1.0
        turned[10 + i, 10 + j, k], turned[10 + i, 10 + k, j] = 0.5, -0.5
        turned[9, 10 + i, i], turned[10 + i, 9, i] = -0.5, 0.5
    moved[0, 1, 3], moved[0, 0, 2], moved[1, 2, 3], moved[1, 0, 1] = 2.0, 2.0, 2.0, -2.0
    moved[2] = np.diag([1.0, -1.0, -1.0, 1.0])
    return turned.reshape(13, 39), moved.reshape(3, 16)


def _step(rod: SpatialRod, state: Array, s: Array | float, length: Array | float) -> Array:
    """States (16, n) one step past arc length `s`; `s` and `length` are numbers or (n,)."""
    stages, weights, nodes = tableau()
    stiffness, past = rod.profile.along(s, length, nodes)
    heavy, (turned, moved), count = rod.profile.weight > 0, _products(), state.shape[1]
    each, curvature = np.array([[1.0], [1.0], [rod.torsion]]), np.array(rod.curvature)[:, None]
    rates = np.empty((len(nodes), 16, count))
    now = state
    for i in range(len(nodes)):
        if i:
            now = state + length * (stages[i, :i] @ rates[:i].reshape(i, -1)).reshape(16, count)
        bend = now[_M] / (each * stiffness[i]) + curvature
        rate, across = rates[i], now[3:5]
        np.matmul(turned, (now[:13, None] * bend).reshape(39, count), out=rate[:13])
        np.matmul(moved, (now[_Q, None] * now[_Q]).reshape(16, count), out=rate[_R])
        if heavy:
            across = across + past[i] * now[6:8]
        rate[0] += across[1]
        rate[1] -= across[0]
    return np.asarray(state + length * (weights @ rates.reshape(len(nodes), -1)).reshape(16, count))
