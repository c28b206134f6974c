"""Any rod in a plane, marched from its clamp along its arc length: tapered, curved, heavy, in a clamp that gives.

Units (1) with the bending stiffness at the clamp: lengths in rod lengths ``L``, forces in ``EI(0)/L²``.
The part past ``s`` acts on the part before it by the force ``N`` and the moment ``M``:

    ``N = F + (weight past s) g``  before the contact,  ``φ' = M/B + κ̂``,  ``M' = N_x sin φ - N_y cos φ``

with ``φ(0) = π/2 + c M(0)``, ``M(0) = -m0z`` and ``N(0) = -f0``, so that the contact force ``F = -f0 - W g`` is known at
once.  A contact does not carry a moment: it is the first place at which ``e = M - M_o`` vanishes, where ``M_o(s, φ)`` is the
moment at the root of the part past ``s`` that hangs free with the slope ``φ`` there.  There ``e' = f cos β``, whatever the rod.
The moment keeps its sign up to the contact: rods with an
inflection before it are not looked for.  Friction does not enter: reconstruction is friction invariant for any rod.

All rods take the same fixed steps of the explicit Runge-Kutta method of order 8 of Dormand and Prince (E. Hairer, S. P.
Nørsett, G. Wanner, *Solving Ordinary Differential Equations I*, 1993), shorter where the rod is thinner; no step crosses a
knot of the rod's table.  The tangent ``cos φ, sin φ`` is marched in the place of its angle.

The methods of step 2 lead from the reactions of a rod to the place of its contact.

``closed-form``
    The elastica in closed form (`planar.elastica`) with ``q = m0z / (2 √f)``.  Friction changes the direction of the force,
    which is measured: the contact does not depend on friction otherwise.  Rods that are arcs of circles have a closed form as
    well; all others are marched.
``scholz-rahn``
    Numerical integration of (3) up to the contact (G. R. Scholz, C. D. Rahn, "Profile sensing with an actuated whisker",
    2004), in the steps of the march.  Friction invariant as well; the reference of the closed forms.
``will``
    Equation (10) (C. Will, "Continuum models for biologically inspired tactile sensors", 2018), clipped to 1.  It assumes a
    rod tangential to the force at its contact, which holds for ``μ = 0`` only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev, polynomial
from numpy.typing import ArrayLike

from planar.arrays import Array, Index, Mask, finite
from planar.elastica import bend, bend_by_half_angle, integrals, partial_shape, tangential_q

# Rows that are marched at once: their stages stay in the processor's cache.
_BLOCK = 1024
# Steps along the rod to start with, on how many rows they are tried, and the change of places between two numbers of steps, in
# rod lengths, at which there are enough.
STEPS, TRIED, PLACES = 8, 32, 1e-10
COARSE = 4
"""Steps along a rod of the coarsest march: pieces between two knots have at least one of them each."""
# Slopes of the tip, and arc lengths, at which the moment of the overhang is tabulated.
_TIP_SLOPES, _LENGTHS = 96, 33


@dataclass(frozen=True)
class Profile:
    """Diameter and weight along a rod, dimensionless."""

    knots: tuple[float, ...] = (0.0, 1.0)
    """Arc lengths (k,) between which the diameter is linear."""
    diameters: tuple[float, ...] = (1.0, 1.0)
    """Diameters (k,) there, over that at the clamp."""
    weight: float = 0.0
    """Weight of the whole rod, spread as the square of the diameter."""

    def diameter(self, s: Array) -> Array:
        """Diameters at arc lengths of any shape, over that at the clamp; past the tip that of the tip."""
        return np.interp(s, self.knots, self.diameters)

    def slope(self, s: Array) -> Array:
        """Derivative of the diameter; zero past the tip."""
        slopes = np.append(np.diff(self.diameters) / np.diff(self.knots), 0.0)
        return np.asarray(slopes[np.searchsorted(self.knots[1:], s, side="right")])

    def bending_stiffness(self, s: Array) -> Array:
        """Bending stiffness at arc lengths of any shape, over that at the clamp."""
        return np.asarray(np.square(np.square(self.diameter(s))))

    def weight_past(self, s: Array) -> Array:
        """Weight of the part of the rod past arc lengths of any shape, in ``EI(0)/L²``."""
        if self.weight == 0:
            return np.zeros(np.shape(s))
        knots, d, volumes = np.array(self.knots), np.array(self.diameters), self._volumes
        following = np.clip(np.searchsorted(knots, s, side="right"), 1, len(knots) - 1)
        rest = np.clip(knots[following] - s, 0.0, None) * _frustum(self.diameter(s), d[following])
        return np.asarray(self.weight * (rest + volumes[following]) / volumes[0])

    def along(self, s: Array | float, length: Array | float, nodes: Array) -> tuple[Array, Array]:
        """`bending_stiffness` and `weight_past` at the `nodes` (k,) between 0 and 1 of steps past arc lengths `s`, numbers or
        (n,): (k,) or (k, n).  No step crosses a knot."""
        end = np.asarray(s + length)
        here, last = self.diameter(np.asarray(s)), self.diameter(end)
        diameter = here + np.multiply.outer(nodes, last - here)
        past = np.zeros(len(nodes))
        if self.weight:
            rest = np.multiply.outer(1 - nodes, np.where(np.minimum(s, end) < 1, length, 0.0)) * _frustum(
                diameter, last
            )
            past = self.weight_past(end) + self.weight * rest / self._volumes[0]
        return np.asarray(np.square(np.square(diameter))), past

    @property
    def _volumes(self) -> Array:
        """(k,) volumes past the knots, over that of a frustum of height and diameter 1."""
        d = np.array(self.diameters)
        parts = np.diff(self.knots) * _frustum(d[:-1], d[1:])
        return np.append(np.cumsum(parts[::-1])[::-1], 0.0)


def _frustum(first: Array, last: Array) -> Array:
    """Volumes of frustums of height 1, over a twelfth of π."""
    return np.asarray(first * first + first * last + last * last)


@dataclass(frozen=True)
class Rod:
    """A rod in a plane, dimensionless; without arguments the straight, uniform, weightless rod in a rigid clamp.

    tip_diameter
        Diameter at the tip of a cone, relative to that at the clamp.
    stiffness
        Rows (n, 2) of arc length ``s``, rising from 0 to 1, and bending stiffness over that at the clamp; None: that of the
        cone.  Between the rows the fourth root, a round rod's diameter, is linear.
    curvature
        Curvature ``κ̂`` of the free rod, in ``1/L``; positive where it turns against the sweep in -x, counter-clockwise.
    weight
        Weight of the whole rod in ``EI(0)/L²``, spread as the square of the diameter.
    gravity
        Direction of gravity in the clamp's frame, along whose y axis the rod leaves; any length.  Needed with a weight: one
        (2,), or one for each row that is reconstructed, or for each of many sweeps, (n, 2).
    compliance
        Angle by which the clamp gives, in radians per ``EI(0)/L`` of moment.

    Raises ValueError for numbers that belong to no rod.
    """

    tip_diameter: float = 1.0
    stiffness: ArrayLike | None = None
    curvature: float = 0.0
    weight: float = 0.0
    gravity: ArrayLike | None = None
    compliance: float = 0.0
    profile: Profile = field(init=False, repr=False, compare=False)
    down: Array = field(init=False, repr=False, compare=False)
    """Unit vectors of gravity, (2,) or (n, 2); 0 without weight."""

    def __post_init__(self) -> None:
        knots, diameters = np.array([0.0, 1.0]), np.array([1.0, float(self.tip_diameter)])
        if self.stiffness is not None:
            table = np.asarray(self.stiffness, dtype=float)
            if table.ndim != 2 or table.shape[1] != 2 or len(table) < 2:
                raise ValueError(
                    f"stiffness must have rows of s and stiffness, such as [[0, 1], [1, 0.2]], got shape {table.shape}"
                )
            if self.tip_diameter != 1.0:
                raise ValueError("a rod has either a tip_diameter or a table of its stiffness, got both")
            knots, relative = table.T
            if not (knots[0] == 0 and knots[-1] == 1 and (np.diff(knots) > 0).all()):
                raise ValueError(f"the first column of stiffness must rise from 0 to 1, got {knots}")
            if not (np.isfinite(relative).all() and (relative > 0).all() and abs(relative[0] - 1) < 1e-12):
                raise ValueError(
                    f"stiffness must be positive, and 1 at the clamp, whose it is relative to, got {relative}"
                )
            diameters = relative**0.25
            object.__setattr__(self, "stiffness", tuple(map(tuple, table.tolist())))
        if not (np.isfinite(diameters).all() and (diameters > 0).all()):
            raise ValueError(f"tip_diameter must be a positive number, got {self.tip_diameter}")
        if np.ndim(self.curvature) or not finite(self.curvature):
            raise ValueError(f"curvature must be a number, got {self.curvature}")
        for name in ("weight", "compliance"):
            value = getattr(self, name)
            if np.ndim(value) or not (finite(value) and value >= 0):
                raise ValueError(f"{name} must be a number of at least 0, got {value}")
        down = np.zeros(2)
        if self.weight > 0:
            down = np.asarray(np.nan if self.gravity is None else self.gravity, dtype=float)
            right = down.ndim in (1, 2) and down.shape[-1] == 2
            if not (right and np.isfinite(down).all() and down.any(axis=-1).all()):
                raise ValueError(
                    f"a rod with weight needs the direction (2,) of gravity, or one for each row, got {self.gravity}"
                )
            if down.ndim == 1:
                object.__setattr__(self, "gravity", tuple(down.tolist()))
            down = down / np.linalg.norm(down, axis=-1, keepdims=True)
        profile = Profile(tuple(knots.tolist()), tuple(diameters.tolist()), float(self.weight))
        object.__setattr__(self, "profile", profile)
        object.__setattr__(self, "down", down)

    @property
    def is_uniform(self) -> bool:
        """Whether the rod is of one stiffness, weightless and rigidly clamped: straight, or an arc of a circle."""
        return set(self.profile.diameters) == {1.0} and self.weight == 0 and self.compliance == 0

    @property
    def is_straight_and_uniform(self) -> bool:
        """Whether it is the rod of the paper."""
        return self.is_uniform and self.curvature == 0

    @property
    def pull(self) -> Array:
        """(2, 1) the rod's weight as a force, or (2, n) for rows with a gravity each."""
        return self.weight * np.atleast_2d(self.down).T

    def rows(self, rows: slice | Index) -> Rod:
        """The rod of some of the rows of which each has its gravity."""
        return replace(self, gravity=self.down[rows]) if self.down.ndim == 2 else self

    def steady(self) -> Rod:
        """The rod itself.  Raises ValueError if each row has its gravity."""
        if self.down.ndim == 2:
            raise ValueError("gravity must have one direction (2,) here")
        return self

    def mirrored(self) -> Rod:
        """The mirror image, x → -x."""
        gravity = None if self.gravity is None else np.asarray(self.gravity, dtype=float) * [-1.0, 1.0]
        return replace(self, curvature=-self.curvature, gravity=gravity)


def as_rod(rod: Rod | None) -> Rod:
    """The rod, for None that of the paper.  Raises TypeError for what is none."""
    if rod is None:
        return Rod()
    if not isinstance(rod, Rod):
        raise TypeError(f"rod must be a planar.Rod, or None for the straight and uniform one, got {rod!r}")
    return rod


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

    def marched(rows: Index | slice, steps: Steps) -> Marched:
        return _contacts(rod.rows(rows), force[:, rows], moment[rows], steps)

    steps, found = enough_steps(marched, np.hypot(*force) + np.abs(moment), places=slice(3))
    if len(moment) <= TRIED:
        return Marched(*found)
    parts = [marched(slice(first, first + _BLOCK), steps) for first in range(0, len(moment), _BLOCK)]
    return Marched(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def free_reactions(rod: Rod) -> tuple[float, float, float]:
    """Support reactions f0x, f0y and m0z of the rod in the air: those of its weight, which taring takes away.

    Raises ValueError where the clamp gives so much that none are found.
    """
    moment, nothing, rod = 0.0, np.zeros((2, 1)), as_rod(rod).steady()
    for share in np.repeat([1.0, 0.5], 100):  # a contraction for clamps that hold, by halves for those that give much
        state = started(rod, np.array([np.pi / 2 + rod.compliance * moment]), np.zeros(1), nothing, nothing)
        change = -float(excess(overhang(rod), 0.0, state)[0]) - moment
        moment += float(share) * change
        if abs(change) <= 1e-14:
            return -rod.weight * rod.down[0], -rod.weight * rod.down[1], -moment
    raise ValueError(GIVES)


GIVES = "the clamp gives so much under the rod's weight that no rest is found: state a smaller compliance or weight"
Steps = int | Index
"""Steps along rods: one number, or those of rows (n,)."""


def enough_steps(
    march: Callable[[Index, Steps], tuple[Array, ...]],
    size: Array,
    places: slice = slice(None),
    steps: int = STEPS,
) -> tuple[int, tuple[Array, ...]]:
    """The number of steps, at least so many, by which places are right to `PLACES`, and what is marched by it.

    `march` gives columns for some rows by a number of steps, of which `places` are compared.  The rows are all up to `TRIED` of
    them, or so many of all sizes (n,).  From `STEPS` on the errors of the finer of two runs are smaller by the eighth power.
    """
    order = np.argsort(np.where(np.isfinite(size), size, -1.0))[::-1]
    if not len(order):
        return steps, march(order, steps)
    # some rows of all sizes tell how many steps are enough
    rows = np.sort(order[np.unique(np.linspace(0, len(order) - 1, TRIED).astype(np.intp))])
    more = round(1.5 * steps)
    # both at once take little longer than one of them
    both = march(np.append(rows, rows), np.repeat([steps, more], len(rows)))
    last, finer = zip(*(np.split(column, 2, axis=-1) for column in both), strict=True)
    while True:
        before, after = (np.concatenate([np.atleast_2d(column) for column in found[places]]) for found in (last, finer))
        change = np.where(np.isnan(before) & np.isnan(after), 0.0, np.abs(after - before))
        if (change <= PLACES).all():
            break
        close = steps >= STEPS and (change <= PLACES * ((more / steps) ** 8 - 1)).all()
        steps, last = more, finer
        if close or steps >= 256:
            break
        more = round(1.5 * steps)
        finer = march(rows, more)
    return steps, last


def grid(profile: Profile, steps: Steps, end: float = 1.0) -> Array:
    """Ends (p,) of the steps along a rod, its knots among them: between two knots steps are as long as the rod is thick.

    A short piece has as many times more as there are `steps` in place of `COARSE`: what two runs differ by is the error of all.
    Past the tip, up to an `end`, there are as many again.  Of different numbers for rows (n,) they are (p, n), and those of
    the rows with fewer steps end with some of no length.
    """
    if isinstance(steps, int):
        return _grid(profile, steps, end)
    numbers, which = np.unique(steps, return_inverse=True)
    every = [_grid(profile, int(number), end) for number in numbers]
    longest = max(map(len, every))
    return np.stack([np.pad(one, (0, longest - len(one)), "edge") for one in every], axis=1)[:, which]


@lru_cache(maxsize=64)
def _grid(profile: Profile, steps: int, rod_end: float) -> Array:
    pieces = []
    for (start, first), (end, last) in pairwise(zip(profile.knots, profile.diameters, strict=True)):
        count = round(np.ceil(steps / COARSE * np.ceil(COARSE * (end - start))))
        part = np.arange(count) / count
        taper = last / first - 1
        pieces.append(start + (end - start) * (np.expm1(np.log1p(taper) * part) / taper if taper else part))
    past = np.linspace(1.0, rod_end, steps + 1)[1:] if rod_end > 1 else np.empty(0)
    return np.concatenate([*pieces, [1.0], past])


def crossings(
    ends: Array, state: Array, step: Callable[[Array, float, float], Array], value: Callable[[float, Array], Array]
) -> tuple[Index, Array, Array]:
    """Where a value (n,) of marched states (k, n) first falls through zero: the rows (m,), their states (k, m) before the
    step in which it does, and its begin, its length, and the values at both ends of it (4, m).

    The steps have `ends` (p,), or (p, n).  Rows whose value ends to be a number are given up.
    """
    rows, low, falling = np.arange(state.shape[1]), value(ends[0], state), []
    for at, end in pairwise(ends):
        if ends.ndim > 1:
            at, end = at[rows], end[rows]
        after = step(state, at, end - at)
        high = value(end, after)
        here = (low > 0) & (high <= 0)
        if here.any():
            span = np.stack(np.broadcast_arrays(at, end - at, low, high))
            falling.append((rows[here], state[:, here], span[:, here]))
        rest = ~here & np.isfinite(high)
        if not rest.all():
            rows, after, high = rows[rest], after[:, rest], high[rest]
        state, low = after, high
        if not len(rows):
            break
    if not falling:
        return rows[:0], state[:, :0], np.empty((4, 0))
    return tuple(np.concatenate(columns, axis=-1) for columns in zip(*falling, strict=True))  # type: ignore[return-value]


def _contacts(rod: Rod, force: Array, moment: Array, steps: Steps) -> Marched:
    """`contacts` by a given number of steps; force (2, n)."""
    hangs = overhang(rod)
    # past the tip the rod goes on for half its length, with the stiffness there and without weight
    ends = grid(rod.profile, steps, 1.5)
    with np.errstate(all="ignore"):
        state = started(rod, np.pi / 2 + rod.compliance * moment, moment, np.zeros((2, len(moment))), force)
        unknown = np.full((4, len(moment)), np.nan)
        found = Marched(unknown[0], unknown[1], unknown[2], unknown[3], excess(hangs, 0.0, state))
        rows, before, span = crossings(
            ends,
            state,
            partial(step, rod),
            lambda s, state: -excess(hangs, s, state),
        )
        _refine(rod, found, rows, before, *span)
    return found


def shapes(rod: Rod, force: Array, moment: Array, s1: Array, points: int) -> tuple[Array, Array]:
    """`drawn` of rods that touch at arc lengths s1 (n,), under forces (2, n) and moments (n,) as of `contacts`."""
    state = started(rod, np.pi / 2 + rod.compliance * moment, moment, np.zeros((2, len(moment))), force)
    goes_straight = not (rod.curvature or rod.weight)
    return drawn(rod.profile, partial(step, rod), state, s1, points, slice(3, 5), slice(5, 7), goes_straight)


def drawn(
    profile: Profile,
    step: Callable[[Array, Array, Array], Array],
    state: Array,
    s1: Array,
    points: int,
    place: slice,
    force: slice,
    goes_straight: bool,
) -> tuple[Array, Array]:
    """Places (d, points, n) along rods, evenly from the clamp to contacts at arc lengths s1 (n,), and (d, q, n) on to the tip.

    They are marched from states (k, n) at the clamp, of which `place` and contact `force` are rows.  The part past the contact
    is given by its two ends if it `goes_straight`, else by as many points.
    """

    def touched(rows: Index, steps: Steps) -> tuple[Array]:
        ends = grid(profile, steps)
        return (sampled(step, ends, state[:, rows], np.zeros(len(rows)), s1[None, rows])[place, 0],)

    ends = grid(profile, enough_steps(touched, np.sqrt((state[force] ** 2).sum(axis=0)))[0])
    bent = sampled(step, ends, state, np.zeros(len(s1)), np.linspace(0.0, 1.0, points)[:, None] * s1)
    free = bent[:, -1].copy()
    free[force] = 0.0
    part = np.linspace(0.0, 1.0, 2 if goes_straight else points)[:, None]
    rest = sampled(step, ends, free, s1, np.minimum(s1 + part * (1 - s1), 1.0))
    return bent[place], rest[place]


def sampled(
    step: Callable[[Array, Array, Array], Array], ends: Array, state: Array, begin: Array, places: Array
) -> Array:
    """States (k, p, n) at arc lengths `places` (p, n) of rods that are marched from states (k, n) at arc lengths `begin`
    (n,), in steps between `ends` (e,) or (e, n); NaN outside of these."""
    found = np.full((len(state), *places.shape), np.nan)
    for start, end in pairwise(ends):
        at = np.clip(begin, start, end)
        which, row = np.nonzero((places >= at) & (places <= end))
        found[:, which, row] = step(state[:, row], at[row], places[which, row] - at[row])
        state = step(state, at, end - at)
    return found


def started(rod: Rod, slope: Array, moment: Array, place: Array, force: Array) -> Array:
    """States of rods by slopes (n,), moments (n,), places (2, n) and contact forces (2, n): these seven rows, and two of the
    rod's weight as a force if it has one."""
    state = np.stack([np.cos(slope), np.sin(slope), moment, *place, *force])
    return np.concatenate([state, np.broadcast_to(rod.pull, force.shape)]) if rod.weight else state


def excess(hangs: Overhang, s: ArrayLike, state: Array) -> Array:
    """(n,) moments ``e`` of states over those of the parts of the rod that hang free."""
    turn = state[0] + 1j * state[1]
    if len(state) > 7:  # seen from where gravity points down
        turn = turn * (-state[8] - 1j * state[7]) / np.hypot(state[7], state[8])
    return np.asarray(state[2] - hangs(s, turn))


def _refine(
    rod: Rod, found: Marched, rows: Index, before: Array, start: Array, length: Array, low: Array, high: Array
) -> None:
    """Fill in the rows (m,) whose excess rises through zero, from -`low` to -`high`, in steps from the states `before`."""
    hangs = overhang(rod)
    # e' = -(t × F), but for the overhang's part, which vanishes with e; the parabola with this rate through both ends
    rate = _across(before)
    bend = (low - high - rate * length) / length**2
    part = 2 * low / (rate + np.sqrt(np.maximum(rate * rate + 4 * bend * low, 0.0)))
    part = np.clip(part, 0.0, length)
    for _ in range(2):
        state = step(rod, before, start, part)
        change = -excess(hangs, start + part, state) / _across(state)
        part = part + change
    cosine, sine, moment, x, y = state[:5]
    # steps that turn the rod by more than they can follow spoil the length of its tangent
    lost = np.abs(cosine * cosine + sine * sine - 1) > 1e-3
    part[lost] = change[lost] = np.nan
    curvature = moment / rod.profile.bending_stiffness(start + part) + rod.curvature
    phi, turn = np.arctan2(sine, cosine), curvature * change
    found.s1[rows], found.slope[rows] = start + part, phi + turn
    found.x[rows], found.y[rows] = x + np.cos(phi + turn / 2) * change, y + np.sin(phi + turn / 2) * change


def _across(state: Array) -> Array:
    """``F_x sin φ - F_y cos φ``: the force across the rod."""
    return np.asarray(state[5] * state[1] - state[6] * state[0])


@lru_cache
def tableau() -> tuple[Array, Array, Array]:
    """Coefficients (12, 12), weights (12,) and nodes (12,) of the stages of a step."""
    from scipy.integrate import DOP853  # imported late, so that `import planar` stays quick

    return DOP853.A[:12, :12], DOP853.B, DOP853.C[:12]


def step(rod: Rod, state: Array, s: Array | float, length: Array | float) -> Array:
    """States (`started`), ``cos φ, sin φ, M, x, y``, contact force and weight, of rods one step past arc length `s`.

    `s` and `length` are numbers or (n,).
    """
    stages, weights, nodes = tableau()
    stiffness, past = rod.profile.along(s, length, nodes)
    rates = np.empty((5, len(nodes), state.shape[1]))
    now, (fx, fy) = state[:3], state[5:7]
    for i in range(len(nodes)):
        if i:
            now = state[:3] + length * (stages[i, :i] @ rates[:3, :i])
        cosine, sine, moment = now
        if rod.weight > 0:
            part = past[i] / rod.weight
            fx, fy = state[5] + part * state[7], state[6] + part * state[8]
        bend = moment / stiffness[i] + rod.curvature
        np.multiply(-bend, sine, out=rates[0, i])
        np.multiply(bend, cosine, out=rates[1, i])
        np.subtract(fx * sine, fy * cosine, out=rates[2, i])
        rates[3, i], rates[4, i] = cosine, sine
    return np.concatenate([state[:5] + length * (weights @ rates), state[5:]])


Overhang = Callable[[ArrayLike, Array], Array]
"""Moments (n,) at the roots of parts of a rod that hang free past arc lengths s, one or (n,), with tangents ``exp(iφ)`` (n,)
there, φ from an axis across gravity, which points along ``-i``."""


def overhang(rod: Rod) -> Overhang:
    """The moment ``M_o(s, φ)`` of a rod.  Raises ValueError where it is so heavy that it hangs, or stands, in more than one
    shape."""
    if rod.weight == 0:
        return lambda s, turn: np.zeros(np.broadcast_shapes(np.shape(s), turn.shape))
    return _overhang(replace(rod, gravity=(0.0, -1.0), compliance=0.0))


@lru_cache(maxsize=8)
def _overhang(rod: Rod) -> Overhang:
    """The moment ``M_o(s, φ)``, a Fourier series in φ along the rod."""
    turns = np.arange(_TIP_SLOPES) * (2 * np.pi / _TIP_SLOPES)
    orders = np.arange(-_TIP_SLOPES // 4, _TIP_SLOPES // 4 + 1)

    def fourier(state: Array) -> Array:
        phi = np.unwrap(np.arctan2(state[1], state[0]))
        if not (np.diff(phi, append=phi[0] + 2 * np.pi) > 0).all():
            raise ValueError(
                f"a rod of weight {rod.weight:g} EI/L² takes more than one shape under its weight; is it so heavy?"
            )
        found = np.linalg.lstsq(np.exp(1j * np.outer(phi, orders)), state[2] + 0j, rcond=None)[0][orders >= 0, None]
        found[1:] *= 2  # the moment is real: the series of positive orders is enough
        return np.asarray(found)

    state = started(rod, np.asarray(turns, dtype=float), np.zeros(_TIP_SLOPES), *np.zeros((2, 2, _TIP_SLOPES)))
    series = along(rod.profile, partial(step, rod), state, fourier)

    def moment(s: ArrayLike, turn: Array) -> Array:
        return np.asarray(polynomial.polyval(turn, series(s).T[0], tensor=False).real)

    return moment


def along(
    profile: Profile, step: Callable[[Array, float, float], Array], tips: Array, fitted: Callable[[Array], Array]
) -> Callable[[ArrayLike], Array]:
    """Numbers (c, k) of the parts of a rod that hang free past arc lengths s, one or (n,): (c, k) or (n, c, k).

    They are polynomials in s between two knots, through what is `fitted` to states that are marched back from those of tips.
    """
    knots, tables = np.array(profile.knots), []
    for start, end in zip(knots[-2::-1], knots[:0:-1], strict=True):
        # a short piece may taper as much as a long one
        nodes = chebyshev.chebpts1(int(np.ceil(_LENGTHS * max(np.sqrt(end - start), 0.5))))[::-1]
        at, rows = end, []
        for place in np.append((start + end) / 2 + (end - start) / 2 * nodes, start):
            tips = step(tips, at, place - at)
            at = place
            rows.append(fitted(tips))
        values = np.array(rows[:-1])
        found = np.linalg.solve(chebyshev.chebvander(nodes, len(nodes) - 1), values.reshape(len(nodes), -1))
        tables.append(np.concatenate([found, np.zeros((_LENGTHS - len(nodes), found.shape[1]))]))
    series = np.array(tables[::-1]).reshape(len(tables), _LENGTHS, *values.shape[1:])
    # what is rounding, which many tips sum up, is left out
    size = np.abs(series).max(axis=(0, 3))
    kept = size > tips.shape[1] * np.finfo(float).eps * size.max()
    lengths, count = (int(np.flatnonzero(kept.any(axis=axis))[-1]) + 1 for axis in (1, 0))
    series = series[:, :lengths, :count]

    def numbers(s: ArrayLike) -> Array:
        piece = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, len(series) - 1)
        start, end = knots[piece], knots[piece + 1]
        part = np.clip((2 * np.asarray(s) - start - end) / (end - start), -1.0, 1.0)
        powers = chebyshev.chebvander(part, lengths - 1)
        if np.ndim(s) == 0:
            return np.asarray(np.tensordot(powers[0], series[piece], 1))
        found = np.empty((len(powers), *series.shape[2:]), dtype=series.dtype)
        for k in np.unique(piece):
            found[piece == k] = np.tensordot(powers[piece == k], series[k], 1)
        return found

    return numbers


METHODS = ("closed-form", "scholz-rahn", "will")


class Solved(NamedTuple):
    """Contacts (n,) on rods that a sweep in -x bends; lengths in rod lengths, angles in radians."""

    force: Array
    """Size f of the contact force on the rod."""
    alpha: Array
    """Its direction (9)."""
    s1: Array
    x: Array
    """Relative to the clamp."""
    y: Array
    beta: Array
    """β (12), the angle between the rod's normal at the contact and the force."""
    wrong_side: Mask
    """Where the moment is that of a rod bent against the sweep."""
    no_rod: Mask
    """Where no rod has these reactions."""
    undefined: Mask
    """Where the method does not have a solution."""


def solve(method: str, rod: Rod, f0x: Array, f0y: Array, m0z: Array) -> Solved:
    """The contacts of reactions (n,) by one of `METHODS`; 'will' takes the straight uniform rod whatever the rod is."""
    if method == "scholz-rahn" or not rod.is_uniform:
        return _marched(rod, f0x, f0y, m0z)
    if rod.curvature:
        return _arc(rod, f0x, f0y, m0z)
    force, s, c = _polar(f0x, f0y)
    root_f = np.sqrt(force)
    q = m0z / (2 * root_f)
    square = q * q
    m, complement = s * s + square, c * c - square
    beta = 2 * np.arctan2(np.sqrt(m), np.sqrt(complement)) - np.pi / 2  # (12): sin β = 2m - 1
    exists = (complement >= 0) & (q > 0)
    alpha = 2 * np.arctan2(s, c)
    q = q if exists.all() else np.where(exists, q, np.nan)
    undefined = np.zeros(len(q), dtype=bool)
    if method == "will":
        s1, x, y, undefined = _will(alpha, q, root_f)
    else:
        shape, _, _ = bend_by_half_angle(s, c, q)
        s1, x, y = shape.length / root_f, shape.x / root_f, shape.y / root_f
    return Solved(force, alpha, s1, x, y, beta, m0z <= 0, complement < 0, undefined)


def _will(alpha: Array, q: Array, root_f: Array) -> tuple[Array, Array, Array, Mask]:
    # ERRATUM: (10) as printed has α̃ in its integrand; it stands for α.  The integral is that of a frictionless rod.
    undefined = np.abs(alpha) > np.pi / 2
    frictionless = bend(alpha, np.where(undefined, np.nan, tangential_q(alpha, np.zeros(len(alpha)))))
    s1 = np.minimum(frictionless.length / root_f, 1.0)
    # the point at s1 of the rod that the reactions bend
    shape = bend(alpha, q)
    x, y = partial_shape(alpha, q, shape.length - s1 * root_f)
    return s1, (shape.x - x) / root_f, (shape.y - y) / root_f, undefined


def _arc(rod: Rod, f0x: Array, f0y: Array, m0z: Array) -> Solved:
    """Arcs of circles: (3) holds for the whole curvature, which is ``κ̂ - m0z`` at the clamp and ``κ̂`` at the contact.

    With the amplitude u of Legendre's form, ``κ = -2k √f cos u``.  Rods with ``k >= 1``, strongly curved ones under small
    forces, have none and are marched.
    """
    force, s, c = _polar(f0x, f0y)
    root_f, alpha = np.sqrt(force), 2 * np.arctan2(s, c)
    q = (m0z - rod.curvature) / (2 * root_f)
    m = s * s + q * q
    k = np.sqrt(m)
    cosine = -rod.curvature / (2 * k * root_f)
    start, end = np.arctan2(s, q), np.arccos(cosine)
    (first, second), (begun, passed) = integrals(end, m), integrals(start, m)
    length = first - begun
    along = 2 * (second - passed) - length
    across = 2 * k * (np.cos(start) - cosine)
    x, y = across * np.cos(alpha) - along * np.sin(alpha), across * np.sin(alpha) + along * np.cos(alpha)
    beta = 2 * np.arcsin(k * np.sin(end)) - np.pi / 2
    nowhere = np.zeros(len(q), dtype=bool)
    wrong_side = m0z <= 0
    no_rod = (np.abs(cosine) > 1) & (m < 1)
    solved = Solved(force, alpha, length / root_f, x / root_f, y / root_f, beta, wrong_side, no_rod, nowhere)
    rows = np.flatnonzero(m >= 1)
    if len(rows):
        for column, values in zip(solved, _marched(rod, f0x[rows], f0y[rows], m0z[rows]), strict=True):
            column[rows] = values
    return solved


def _marched(rod: Rod, f0x: Array, f0y: Array, m0z: Array) -> Solved:
    carried = np.stack([f0x, f0y]) + rod.pull
    force, s, c = _polar(*carried)
    found = contacts(rod, -carried, -m0z)
    alpha = 2 * np.arctan2(s, c)
    beta = np.remainder(alpha - found.slope + np.pi, 2 * np.pi) - np.pi
    undefined = np.zeros(len(alpha), dtype=bool)
    return Solved(force, alpha, found.s1, found.x, found.y, beta, found.start >= 0, np.isnan(found.s1), undefined)


def _polar(fx: Array, fy: Array) -> tuple[Array, Array, Array]:
    """Size f of the contact force, sine and cosine of ``α/2``, from ``sin α = -f0x/f`` and ``cos α = f0y/f`` (9).

    By algebra, in a tenth of the time of hypot, sin and cos; ``cos α/2 >= 0``.
    """
    across, along = np.abs(fx), np.abs(fy)
    largest = np.maximum(across, along)
    across, along = across / largest, along / largest  # no overflow, no underflow
    size = np.sqrt(across * across + along * along)
    larger = np.sqrt((size + along) / (2 * size))
    smaller = across / (2 * size * larger)
    forward = fy >= 0
    s, c = smaller, larger
    if not forward.all():
        s, c = np.where(forward, smaller, larger), np.where(forward, larger, smaller)
    return largest * size, np.copysign(s, -fx), c
