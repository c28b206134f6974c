"""Any rod in a plane, marched from its clamp along its arc length: tapered, curved, heavy, in a clamp that gives.

The part past ``s`` acts on the part before it by the force ``N`` and the moment ``M``:

    ``N = F + (weight past s) g``  before the contact,  ``φ' = M/B + κ̂``,  ``M' = N_x sin φ - N_y cos φ``

with ``φ(0) = π/2 + c M(0)``, ``M(0) = -m0z`` and ``N(0) = -f0``, so that the contact force ``F = -f0 - W g`` is known at
once.  A contact does not carry a moment: it is the first place at which ``e = M - M_o`` vanishes, where ``M_o(s, φ)`` is the
moment at the root of the part past ``s`` that hangs free with the slope ``φ`` there.  There ``e' = f cos β``, whatever the rod.
The moment keeps its sign up to the contact: rods with an
inflection before it are not looked for.  Friction does not enter: reconstruction is friction invariant for any rod.

All rods take the same fixed steps of the explicit Runge-Kutta method of order 8 of Dormand and Prince (E. Hairer, S. P.
Nørsett, G. Wanner, *Solving Ordinary Differential Equations I*, 1993); no step crosses a knot of the rod's table.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev, polynomial
from numpy.typing import ArrayLike

from planar.arrays import Array, Index
from planar.rods import Profile, Rod

# Rows that are marched at once: their stages stay in the processor's cache.
_BLOCK = 1024
# Steps along the rod to start with, the most, and the difference of two runs, in rod lengths, at which they suffice.
STEPS, _MOST_STEPS, _AGREED = 8, 256, 1e-10
# Rows by which the number of steps is chosen.
_TRIED = 32
# Arc length up to which a contact past the tip is sought.
_LONGEST = 1.5
# Slopes of the tip, and arc lengths, at which the moment of the overhang is tabulated.
_TIP_SLOPES, _LENGTHS = 96, 33


class Marched(NamedTuple):
    """Contacts (n,) of marched rods in rod lengths, relative to the clamp; NaN where there is none."""

    s1: Array
    x: Array
    y: Array
    slope: Array
    """(n,) slope angle φ1 of the rod at the contact, in radians."""
    start: Array
    """(n,) excess of the moment at the clamp over that of the free rod: negative for rods bent by a sweep in -x."""


def contacts(rod: Rod, force: Array, moment: Array) -> Marched:
    """Contacts of rods under contact forces (2, n) and internal moments (n,) at the clamp, ``M(0) = -m0z``."""

    def places(rows: Index, steps: int) -> Array:
        found = _contacts(rod, force[:, rows], moment[rows], steps)
        return np.stack([found.x, found.y])

    steps = enough_steps(places, np.hypot(*force) + np.abs(moment))
    blocks = [slice(first, first + _BLOCK) for first in range(0, max(len(moment), 1), _BLOCK)]
    parts = [_contacts(rod, force[:, rows], moment[rows], steps) for rows in blocks]
    return Marched(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def free_reactions(rod: Rod) -> tuple[float, float, float]:
    """Support reactions f0x, f0y and m0z of the rod in the air: those of its weight, which taring takes away."""
    moment = 0.0
    for _ in range(100):  # a clamp that gives: a contraction for clamps that hold
        before, moment = moment, float(overhang(rod)(np.zeros(1), np.array([np.pi / 2 + rod.compliance * moment]))[0])
        if abs(moment - before) <= 1e-15:
            break
    return -rod.weight * rod.down[0], -rod.weight * rod.down[1], -moment


def enough_steps(march: Callable[[Index, int], Array], size: Array) -> int:
    """The number of steps: doubled until two runs agree on some rows, those of the largest `size` (n,) among them.

    `march` gives places of rows by a number of steps.
    """
    order = np.argsort(np.where(np.isfinite(size), size, -1.0))[::-1]
    rows = order[np.unique(np.linspace(0, max(len(order) - 1, 0), _TRIED).astype(np.intp))] if len(order) else order
    steps, last = STEPS, march(rows, STEPS)
    while steps < _MOST_STEPS:
        finer = march(rows, 2 * steps)
        if not (np.abs(finer - last) > _AGREED).any():
            break
        steps, last = 2 * steps, finer
    return steps


@lru_cache(maxsize=64)
def grid(profile: Profile, steps: int) -> Array:
    """Ends of the steps along a rod, its knots among them."""
    pieces = [
        np.linspace(start, end, max(round(np.ceil(steps * (end - start))), 1), endpoint=False)
        for start, end in pairwise(profile.knots)
    ]
    return np.append(np.concatenate(pieces), 1.0)


def _contacts(rod: Rod, force: Array, moment: Array, steps: int) -> Marched:
    """`contacts` by a given number of steps; force (2, n)."""
    s, hangs = grid(rod.profile, steps), overhang(rod)
    with np.errstate(all="ignore"):
        states = np.zeros((len(s), 4, len(moment)))
        states[0, 0], states[0, 1] = np.pi / 2 + rod.compliance * moment, moment
        for k, length in enumerate(np.diff(s)):
            states[k + 1] = step(rod, states[k], s[k], length, force)
        excess = np.stack([state[1] - hangs(at, state[0]) for at, state in zip(s, states, strict=True)])
        rises = (excess[:-1] < 0) & (excess[1:] >= 0)
        crosses = rises.any(axis=0)
        nowhere = np.full((4, len(moment)), np.nan)
        found = Marched(nowhere[0], nowhere[1], nowhere[2], nowhere[3], excess[0])
        rows = np.flatnonzero(crosses)
        k = np.argmax(rises, axis=0)[rows]
        ends = excess[[k, k + 1], rows]
        _refine(rod, found, rows, states[k, :, rows].T, s[k], s[k + 1] - s[k], ends, force[:, rows])
        # the others go on past the tip, with its stiffness and without weight
        rows, state = np.flatnonzero((excess[0] < 0) & ~crosses), states[-1]
        state = state[:, rows]
        s = np.linspace(1.0, _LONGEST, steps + 1)
        for start, length in zip(s, np.diff(s), strict=False):
            after = step(rod, state, start, length, force[:, rows])
            here = after[1] >= 0
            n = int(here.sum())
            ends = np.stack([state[1, here], after[1, here]])
            steady = np.full(n, start), np.full(n, length)
            _refine(rod, found, rows[here], state[:, here], *steady, ends, force[:, rows[here]])
            rows, state = rows[~here], after[:, ~here]
    return found


def _refine(
    rod: Rod, found: Marched, rows: Index, before: Array, start: Array, length: Array, ends: Array, force: Array
) -> None:
    """Fill in the rows (m,) whose excess vanishes in steps (m,) from the states `before`, with `ends` (2, m) there."""
    hangs, low = overhang(rod), ends[0]
    # e' = -(t × F), but for the overhang's part, which vanishes with e; the parabola with this rate through both ends
    rate = _across(force, before[0])
    bend = (ends[1] - low - rate * length) / length**2
    part = -2 * low / (rate + np.sqrt(np.maximum(rate * rate - 4 * bend * low, 0.0)))
    part = np.clip(part, 0.0, length)
    for _ in range(2):
        state = step(rod, before, start, part, force)
        change = (hangs(start + part, state[0]) - state[1]) / _across(force, state[0])
        part = part + change
    phi, moment, x, y = state
    curvature = moment / rod.profile.bending_stiffness(start + part) + rod.curvature
    found.s1[rows], found.slope[rows] = start + part, phi + curvature * change
    middle = phi + curvature * change / 2
    found.x[rows], found.y[rows] = x + np.cos(middle) * change, y + np.sin(middle) * change


def _across(force: Array, phi: Array) -> Array:
    """``F_x sin φ - F_y cos φ``: the force across the rod."""
    return np.asarray(force[0] * np.sin(phi) - force[1] * np.cos(phi))


@lru_cache
def tableau() -> tuple[Array, Array, Array]:
    """Coefficients (12, 12), weights (12,) and nodes (12,) of the stages of a step."""
    from scipy.integrate import DOP853  # imported late, so that `import planar` stays quick

    return DOP853.A[:12, :12], DOP853.B, DOP853.C[:12]


def step(rod: Rod, state: Array, s: Array | float, length: Array | float, force: Array) -> Array:
    """States ``φ, M, x, y`` (4, n) of rods one step past arc length `s`; `s` and `length` are numbers or (n,), force (2, n)."""
    stages, weights, nodes = tableau()
    at = np.multiply.outer(nodes, length) + s
    stiffness, past = rod.profile.bending_stiffness(at), rod.profile.weight_past(at)
    rates = np.empty((4, len(nodes), state.shape[1]))
    fx, fy = force
    for i in range(len(nodes)):
        phi, moment = state[:2] + length * (stages[i, :i] @ rates[:2, :i])
        sine, cosine = np.sin(phi), np.cos(phi)
        if rod.weight > 0:
            fx, fy = force[0] + past[i] * rod.down[0], force[1] + past[i] * rod.down[1]
        rates[:, i] = moment / stiffness[i] + rod.curvature, fx * sine - fy * cosine, cosine, sine
    return np.asarray(state + length * (weights @ rates))


Overhang = Callable[[ArrayLike, Array], Array]
"""Moments (n,) at the roots of parts of a rod that hang free past arc lengths s, one or (n,), with slopes (n,) there."""


@lru_cache(maxsize=8)
def overhang(rod: Rod) -> Overhang:
    """The moment ``M_o(s, φ)``: a polynomial in s between two knots, whose coefficients are Fourier series in φ.

    The rod is marched back from its tip, free of force and moment, for slopes of the tip all around.  Raises ValueError where
    the rod is so heavy that it hangs, or stands, in more than one shape.
    """
    if rod.weight == 0:
        return lambda s, phi: np.zeros(np.broadcast_shapes(np.shape(s), phi.shape))
    turns = np.arange(_TIP_SLOPES) * (2 * np.pi / _TIP_SLOPES)
    state, no_force = np.stack([turns, *np.zeros((3, _TIP_SLOPES))]), np.zeros((2, _TIP_SLOPES))
    orders = np.arange(-_TIP_SLOPES // 4, _TIP_SLOPES // 4 + 1)
    nodes = chebyshev.chebpts1(_LENGTHS)[::-1]
    tables = []
    knots = np.array(rod.profile.knots)
    for start, end in zip(knots[-2::-1], knots[:0:-1], strict=True):
        at, rows = end, []
        for place in np.append((start + end) / 2 + (end - start) / 2 * nodes, start):
            state = step(rod, state, at, place - at, no_force)
            at = place
            if not (np.diff(state[0], append=state[0, 0] + 2 * np.pi) > 0).all():
                raise ValueError(
                    f"a rod of weight {rod.weight:g} EI/L² takes more than one shape under its weight; is it so heavy?"
                )
            rows.append(np.linalg.lstsq(np.exp(1j * np.outer(state[0], orders)), state[1] + 0j, rcond=None)[0])
        tables.append(np.linalg.solve(chebyshev.chebvander(nodes, _LENGTHS - 1), np.array(rows[:-1])))
    tables = tables[::-1]
    # orders that are rounding are left out
    size = np.abs(np.array(tables)).max(axis=0)
    kept = size > np.finfo(float).eps * size.max()
    lengths, harmonics = int(np.flatnonzero(kept.any(axis=1))[-1]) + 1, int(np.abs(orders[kept.any(axis=0)]).max())
    middle = len(orders) // 2
    # the moment is real: the series of positive orders is enough
    series = np.array(tables)[:, :lengths, middle : middle + harmonics + 1]
    series[:, :, 1:] *= 2

    def moment(s: ArrayLike, phi: Array) -> Array:
        piece = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, len(series) - 1)
        start, end = knots[piece], knots[piece + 1]
        powers = chebyshev.chebvander(
            np.clip((2 * np.asarray(s) - start - end) / (end - start), -1.0, 1.0), lengths - 1
        )
        turn = np.exp(1j * phi)
        if np.ndim(s) == 0:
            return np.asarray(polynomial.polyval(turn, powers[0] @ series[piece]).real)
        weights = np.empty((len(phi), harmonics + 1), dtype=complex)
        for k in np.unique(piece):
            weights[piece == k] = powers[piece == k] @ series[k]
        return np.asarray(polynomial.polyval(turn, weights.T, tensor=False).real)

    return moment
