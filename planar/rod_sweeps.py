"""Equilibria of any rod along the path of a contour.

At a place of the contour with slope ``α̃`` the rod touches tangentially, ``φ1 = α̃`` with the unknown arc length ``s1``, or
with its tip, ``s1 = 1`` with the unknown slope ``φ1``.  One unknown is enough for both, which meet where it vanishes:

    ``u = s1 - 1 < 0`` in tangential contact,  ``u = φ1 - α̃ > 0`` in tip contact.

The second unknown is the size of the force, whose direction is ``α̃ + ζ``.  Marched back from the contact (`planar.rods`), the
rod must arrive at its clamp: ``y = 0``, ``φ = π/2 + c M``.  With the place on the path as a third unknown, and one more thing
given, Newton's method finds whatever a sweep asks for: the rod at a place, at touch-down, where the force vanishes, where the
kind of contact changes, and at a base position.  All rods are marched together, with those that differ from them by a little.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from planar import segments
from planar.arrays import Array, Index, Mask, rows_of
from planar.contours import Path
from planar.rods import COARSE, Overhang, Rod, excess, grid, overhang, started, step
from planar.segments import Equilibria, Segments, State, cut_rows, fractions, rates

# Rods that are sought at once, which are marched with three more each: their stages stay in the processor's cache.
_BLOCK = 1024
# Error of a state that more steps along the rod may leave, in rod lengths and radians.
_AGREED = 1e-10
# Residual, in rod lengths and radians, at which an equilibrium is found.
_SOLVED = 1e-11
# Iterations, of which rods near others need five, and thin ones more.
_ITERATIONS = 12
# Fractions of a piece: of the place of a fold, around which x0 varies with its square, and of a place where equilibria begin.
_NEAR, _NARROW = 1e-6, 1e-8
# Fraction of a piece by which tables may have mistaken where their segments end.
_ASTRAY = 0.01
# Change of u from one end of a piece to the other that shows that they are of two branches, and the pieces over which one rod
# leads to others at a time.
_APART, _LED = 0.1, 8
# Rows of what Newton's method varies, of which it may hold one.
_PLACE, _FORCE, _KIND = range(3)


class _Found(NamedTuple):
    """Rods (n,) that Newton's method led to."""

    w: Array
    """(3, n) parameter of the piece, force and u."""
    state: State
    """NaN where there is none."""
    slopes: Array
    """(n, 4, 3) derivatives of height and angle at the clamp, x0 and moment by w."""
    first: Array
    """(n,) largest residual at the start, in rod lengths and radians."""


@dataclass(frozen=True)
class AnyRod(Equilibria):
    """Equilibria of a rod with a gravity for each contour of the path, or one for all."""

    rod: Rod

    def at_ends(self, path: Path, owner: Index, piece: Index, end: Array, zeta: Array) -> tuple[Mask, State]:
        slope, x, y = path.at(piece, end)
        kind = segments.is_tangential(slope, y, zeta)
        uniform = segments.states(kind, slope, x, y, zeta)
        alpha = slope + zeta
        k = np.sqrt(np.sin(alpha / 2) ** 2 + uniform.q**2)
        tip_slope = alpha + np.pi / 2 - 2 * np.arcsin(np.minimum(k, 1.0))  # (12)
        force = uniform.force * _softness(self.rod, np.where(kind, np.minimum(uniform.s1, 1.0), 1.0))
        w = np.stack([end, force, np.where(kind, uniform.s1 - 1, tip_slope - slope)])
        state = self._newton(path, piece, zeta, w).state
        # contours at which none is known, as where a rod curves far away: led on from rods that curve, weigh and give less,
        # with less friction
        count = np.bincount(owner[np.isfinite(state.x0)], minlength=int(owner.max(initial=-1)) + 1)
        rows = np.flatnonzero(count[owner] == 0)
        for share in (0.25, 0.5, 0.75, 1.0) if len(rows) else ():
            less = replace(
                self.rod,
                curvature=share * self.rod.curvature,
                weight=share * self.rod.weight,
                compliance=share * self.rod.compliance,
            )
            led_on = AnyRod(less)._newton(path, piece[rows], share * zeta[rows], w[:, rows]).state
            w[1:, rows] = np.where(np.isfinite(led_on.x0), led_on.q.T, w[1:, rows])
            if share == 1:
                _put(state, rows, led_on)
        every, tried = np.arange(len(owner)), np.zeros(len(owner), dtype=bool)
        same = np.append(owner[1:] == owner[:-1], False)
        while True:
            # from rods before those that are not known, or not of their branch, and from the ones behind
            known, u = np.isfinite(state.x0), state.q[:, 1]
            ahead = np.roll(known, -1)
            stops = known & same & (~ahead | (np.abs(np.roll(u, -1) - u) > _APART)) & ~tried
            source = np.maximum.accumulate(np.where(np.roll(stops, 1), every - 1, -1))
            led = (source >= 0) & (every - source <= _LED) & (owner[source] == owner)
            begins = ~known & same & ahead & ~np.roll(tried, -1) & ~led
            source = np.where(begins, every + 1, source)
            rows = np.flatnonzero(led | begins)
            start = np.stack([end[rows], *state.q[source[rows]].T])
            led_on = self._newton(path, piece[rows], zeta[rows], start).state
            with np.errstate(invalid="ignore"):
                nearer = np.abs(led_on.q[:, 1] - start[2]) < np.abs(u[rows] - start[2]) - _SOLVED
            better = np.isfinite(led_on.x0) & (~known[rows] | nearer)
            _put(state, rows[better], rows_of(led_on, better))
            tried[source[rows]] = True
            tried[source[rows[better]]] = False
            if not better.any():
                found = self._newton(path, piece, zeta, np.stack([end, *state.q.T]))
                return np.signbit(state.q[:, 1]), self._refined(path, piece, zeta, found)[1]

    def cut_within(self, path: Path, parts: Segments, tangential_at_end: Mask) -> tuple[Segments, Mask]:
        """Cut where the equilibria of a piece begin: at touch-down, where the force vanishes, or in a fold of their place."""
        unknown = np.isnan(parts.x0)
        # the kinds of rods that are not known
        parts = parts._replace(tangential=np.where(unknown[:, 0], tangential_at_end, parts.tangential))
        tangential_at_end = np.where(unknown[:, 1], parts.tangential, tangential_at_end)
        rows = np.flatnonzero(unknown[:, 0] & ~unknown[:, 1])
        part = rows_of(parts, rows)
        columns = path, part.piece, part.friction_angle
        w = np.stack([part.t[:, 1], np.zeros(len(rows)), part.q[:, 1, 1]])
        w, state = self._refined(*columns, self._newton(*columns, w, held=_FORCE), held=_FORCE)
        rate = rates(path, part.piece, path.at(part.piece, w[0])[0], state)
        # a rod that curves towards the body climbs it from touch-down on, and comes back with more force
        fold = np.isnan(state.x0) | (w[0] < 0) | (w[0] > 1) | (rate > 0)
        ends = np.tile([np.nan, 1.0], (int(fold.sum()), 1))
        w[:, fold] = self._root(path, rows_of(part, fold), ends, lambda found, _: np.ones(len(found.first)))
        _put(state, fold, self._newton(path, part.piece[fold], part.friction_angle[fold], w[:, fold]).state)
        rate[fold] = -np.inf
        parts = cut_rows(parts, rows, w[0], state.x0, np.stack([rate, rate], axis=1), state.q)
        second = rows + np.arange(len(rows)) + 1
        parts.x0[second - 1, 1] = np.nan
        parts.tangential[second - 1] = parts.tangential[second] = np.signbit(w[2])
        return parts, np.insert(tangential_at_end, rows, parts.tangential[second])

    def transitions(self, path: Path, parts: Segments) -> tuple[Array, State, State]:
        columns, zero = (path, parts.piece, parts.friction_angle), np.zeros(len(parts.piece))
        w = np.stack([parts.t.mean(axis=1), parts.q[:, :, 0].mean(axis=1), zero - np.finfo(float).tiny])
        along = self._newton(*columns, w, held=_KIND)  # on either side
        by_tip = self._newton(*columns, np.stack([*along.w[:_KIND], zero]), held=_KIND).state
        w, state = self._refined(*columns, along, held=_KIND)
        return w[_PLACE], state, by_tip

    def folds(self, path: Path, parts: Segments) -> tuple[Array, State]:
        def rate(found: _Found, piece: Index) -> Array:
            return rates(path, piece, path.at(piece, found.w[_PLACE])[0], found.state)

        w = self._root(path, parts, parts.rate, rate)
        columns = path, parts.piece, parts.friction_angle
        return w[0], self._refined(*columns, self._newton(*columns, w))[1]

    def _root(self, path: Path, parts: Segments, ends: Array, value: Callable[[_Found, Index], Array]) -> Array:
        """Rods (3, m) at which a value vanishes that differs in sign at the `ends` (m, 2) of segments, or where it begins to be
        known: false position, where a value that stays at its end counts half."""
        (low, high), (below, above) = parts.t.T.copy(), np.clip(ends.T, -1.0, 1.0)  # infinite at touch-down
        (first, last), sign, rows = parts.q.transpose(1, 2, 0), np.sign(below), np.arange(len(low))
        best = np.where(np.isnan(below), [high, *last], [low, *first])
        w, tangent = best.copy(), np.stack([high - low, *np.nan_to_num(last - first)]) / (high - low)
        side = np.zeros(len(low))
        for _ in range(48):
            if not len(rows):
                break
            with np.errstate(invalid="ignore"):
                share = np.clip(np.nan_to_num((below / (below - above))[rows], nan=0.5), 0.01, 0.99)
                slope = np.nan_to_num(np.abs(above - below)[rows] / (high - low)[rows])
            t, piece = low[rows] + share * (high - low)[rows], parts.piece[rows]
            start = w[:, rows] + tangent[:, rows] * (t - w[0, rows])
            found = self._newton(path, piece, parts.friction_angle[rows], start)
            known = np.isfinite(found.state.x0)
            here = np.where(known, value(found, piece), np.nan)
            with np.errstate(invalid="ignore"):
                near = known & (np.abs(here) <= _NEAR * slope)
                stays = np.where(known, here * sign[rows] > 0, np.isnan(below[rows]))
            good, some, rest = rows[known], rows[stays], rows[~stays]
            w[:, good] = found.w[:, known]
            matrix = found.slopes[known, :3]
            matrix[:, 2] = np.eye(3)[_PLACE]
            tangent[:, good] = np.linalg.solve(matrix, np.eye(3)[2][:, None])[..., 0].T
            better = known & (near | stays | np.isnan(below[rows]))
            best[:, rows[better]] = found.w[:, better]
            low[some], below[some], high[rest], above[rest] = t[stays], here[stays], t[~stays], here[~stays]
            above[some] /= np.where(side[some] < 0, 2, 1)
            below[rest] /= np.where(side[rest] > 0, 2, 1)
            side[some], side[rest] = -1, 1
            rows = rows[~near & ((high - low)[rows] > _NARROW)]
        return best

    def pull(self, path: Path, piece: Index) -> Array:
        return self.rod.rows(_contour(path, piece)).pull

    def solve(self, path: Path, parts: Segments, target: Array) -> tuple[Index, Array, State]:
        (t0, t1), (z0, z1) = parts.t.T, parts.q.transpose(1, 2, 0)
        u, fraction = fractions(parts, target)
        z = z0 + np.where(np.isinf(parts.rate[:, 0]), u, fraction) * (z1 - z0)
        w = np.stack([t0 + fraction * (t1 - t0), *np.where(np.isfinite(z), z, z1)])
        for end in (0, 1):
            there = np.flatnonzero(target == parts.x0[:, end])
            w[:, there], target = np.stack([parts.t[there, end], *parts.q[there, end].T]), target.copy()
            target[there] = np.nan
        columns = path, parts.piece, parts.friction_angle
        (t, *_), state = self._refined(*columns, self._newton(*columns, w, target), target)
        astray = np.flatnonzero((t < t0 - _ASTRAY) | (t > t1 + _ASTRAY))
        _put(state, astray, _nowhere(len(astray)))
        return *_on_path(path, parts.piece, t), state

    def _refined(
        self, path: Path, piece: Index, zeta: Array, found: _Found, target: Array | None = None, *, held: int = _PLACE
    ) -> tuple[Array, State]:
        """What was found by few steps along the rod, with as many as it takes."""
        w, state, slopes, _ = found
        target = np.full(len(piece), np.nan) if target is None else target
        going, steps, finer = np.flatnonzero(np.isfinite(state.x0)), COARSE, 2 * COARSE
        while len(going) and finer < 256:
            columns = path, piece[going], zeta[going], w[:, going], target[going]
            found = self._newton(*columns, held=held, steps=finer, slopes=slopes[going])
            w[:, going] = found.w
            # derivatives by few steps are good enough
            _put(state, going, found.state._replace(x0_slope=state.x0_slope[going], x0_arc=state.x0_arc[going]))
            left = found.first * (steps / finer) ** 8  # the order of the march
            going = going[(left > _AGREED) & np.isfinite(found.state.x0)]
            more = 1.25 * finer * (left[np.isfinite(left)].max(initial=0.0) / _AGREED) ** (1 / 8)
            steps, finer = finer, max(int(more), finer + 1)
        return w, state

    def _newton(
        self,
        path: Path,
        piece: Index,
        zeta: Array,
        w: Array,
        target: Array | None = None,
        *,
        held: int = _PLACE,
        steps: int = COARSE,
        slopes: Array | None = None,
    ) -> _Found:
        """Equilibria near w (3, n), at base positions `target` or, where they are NaN or None, with one row of w held.

        With the `slopes` of rods found by fewer steps, others are computed only where these don't lead to the solution.
        """
        if len(piece) > _BLOCK:
            every = []
            for begin in range(0, len(piece), _BLOCK):
                part = slice(begin, begin + _BLOCK)
                own, known = (None if column is None else column[part] for column in (target, slopes))
                given = path, piece[part], zeta[part], w[:, part], own
                every.append(self._newton(*given, held=held, steps=steps, slopes=known))
            states = zip(*(found.state for found in every), strict=True)
            return _Found(
                np.concatenate([found.w for found in every], axis=1),
                State._make(map(np.concatenate, states)),
                np.concatenate([found.slopes for found in every]),
                np.concatenate([found.first for found in every]),
            )
        w, n = w.copy(), len(piece)
        state = _nowhere(n)
        fresh, first = slopes is None, np.full(n, np.nan)
        slopes = np.zeros((n, 4, 3)) if slopes is None else slopes
        target = np.full(n, np.nan) if target is None else target
        holds, rows = np.isnan(target), np.arange(n)
        for iteration in range(_ITERATIONS):
            if not len(rows):
                break
            place, z, held_here = _places(path, piece[rows], w[0, rows], zeta[rows]), w[1:, rows], holds[rows]
            with np.errstate(all="ignore"):
                fully = fresh or iteration > 2
                marched = self._marched(place, z, steps, fully)
                if fully:
                    slopes[rows] = _by_w(place, marched.slopes)
                matrix, left = slopes[rows, :3], marched.values[:3].copy()
                matrix[held_here, 2] = np.arange(3) == held
                left[2] = np.where(held_here, 0.0, left[2] - target[rows])
                size = np.abs(left).max(axis=0)
                first = size if not iteration else first
                change = np.full_like(left, np.nan)
                regular = (np.abs(np.linalg.det(matrix)) > 0) & np.isfinite(size)
                change[:, regular] = np.linalg.solve(matrix[regular], -left.T[regular, :, None])[..., 0].T
                # the last step leaves its square
                solved = (np.abs(change).max(axis=0) < np.sqrt(_SOLVED)) | (size < _SOLVED)
                change[:, size < _SOLVED] = change[held, held_here] = 0.0
                largest = np.stack([0 * rows + 0.5, np.maximum(np.abs(z[0]), 0.05) / 2, 0 * rows + 0.2])
                change *= np.minimum(1.0, (largest / np.abs(change)).min(axis=0))
                w[:, rows] += change
                marched.values[:] += (slopes[rows] @ change.T[..., None])[..., 0].T
                _put(state, rows[solved], rows_of(_states(place, w[1:, rows], marched), solved))
                rows = rows[~solved & np.isfinite(size + change.sum(axis=0))]
        return _Found(w, state, slopes, first)

    @cached_property
    def _hangs(self) -> Overhang:
        return overhang(self.rod)

    def _marched(self, at: _Places, z: Array, steps: int, with_derivatives: bool) -> _Marched:
        """Rods by force and u (2, n), and, in the same march, rods that differ a little."""
        n, h = z.shape[1], np.full((3, z.shape[1]), 1e-7)
        if with_derivatives:
            h[1] = np.copysign(h[1], z[1])  # of the same kind
            at, z = rows_of(at, np.tile(np.arange(n), 4)), np.tile(z, 4)
            for k, column in enumerate((*z, at.slope)):
                column[(k + 1) * n : (k + 2) * n] += h[k]
        rod, alpha, (force, u) = self.rod.rows(at.contour), at.slope + at.zeta, z
        s, phi = 1 + np.minimum(u, 0.0), at.slope + np.maximum(u, 0.0)
        carried = force * np.stack([np.sin(alpha), -np.cos(alpha)])
        state = started(rod, phi, np.zeros(len(s)), np.stack([at.x, at.y]), carried)
        state[2] = -excess(self._hangs, s, state)
        passed: list[tuple[Array, Array]] = [(s[:n], state[:, :n])]
        for lower in grid(rod.profile, steps)[::-1]:
            below = np.minimum(s, lower)
            if (below < s).any():
                state = step(rod, state, s, below - s)
                passed.append((below[:n], state[:, :n]))
            s = below
        cosine, sine, moment, x, y = state[:5]
        tilt = np.arctan2(-cosine, sine)  # of the rod at its clamp from the y axis
        values = np.stack([y, tilt - rod.compliance * moment, x, moment])
        values, varied = values[:, :n], values[:, n:].reshape(4, -1, n).transpose(1, 0, 2)
        slopes = (varied - values) / h[: len(varied), None] if with_derivatives else np.full((3, 4, n), np.nan)
        along, states = (np.concatenate(columns, axis=-1) for columns in zip(*passed, strict=True))
        bent = (excess(self._hangs, along, states) >= 0).reshape(-1, n)[1:] & (
            np.diff(along.reshape(-1, n), axis=0) < 0
        )
        return _Marched(values, slopes, bent.any(axis=0) & (force[:n] > 0))


class _Places(NamedTuple):
    """Places (n,) of contacts."""

    contour: Index
    slope: Array
    x: Array
    y: Array
    zeta: Array
    """Angle of the force to the normal."""
    turn: Array
    """Changes of the slope and of the arc length over the piece of the path."""
    arc: Array


def _places(path: Path, piece: Index, t: Array, zeta: Array) -> _Places:
    """Places at parameters t (n,) of pieces."""
    piece, t = _on_path(path, piece, t)
    slope, x, y = path.at(piece, t)
    return _Places(_contour(path, piece), slope, x, y, zeta, path.turn[piece], path.arc_rate(piece, slope))


def _on_path(path: Path, piece: Index, t: Array) -> tuple[Index, Array]:
    """The pieces, and parameters in [0, 1] on them, of places behind the ends of others."""
    contour = _contour(path, piece)
    beyond = np.where((t < 0) | (t > 1), np.floor(np.nan_to_num(t)), 0).astype(np.intp)
    moved = np.clip(piece + beyond, path.offsets[contour], path.offsets[contour + 1] - 1)
    return moved, t - (moved - piece)


def _contour(path: Path, piece: Index) -> Index:
    return np.searchsorted(path.offsets, piece, side="right") - 1


class _Marched(NamedTuple):
    """Rods (n,) marched back from their contacts to their clamps."""

    values: Array
    """(4, n) height of the base and angle to the clamp, which must vanish, x0 and moment."""
    slopes: Array
    """(3, 4, n) their derivatives by force, u and slope; NaN where they are not known."""
    inflected: Mask
    """Where the moment changes its sign between clamp and contact: solutions behind the end of a sweep's branch."""


def _by_w(at: _Places, slopes: Array) -> Array:
    """Derivatives (n, 4, 3) of height, angle, x0 and moment by w."""
    by_place = slopes[2] * at.turn
    by_place[0] += at.arc * np.sin(at.slope)
    by_place[2] += at.arc * np.cos(at.slope)
    return np.stack([by_place, slopes[0], slopes[1]]).transpose(2, 1, 0)


def _states(at: _Places, z: Array, marched: _Marched) -> State:
    """The states of rods in equilibrium by force and u (2, n)."""
    force, u = z
    (y_f, tilt_f, x_f, _), (y_u, tilt_u, x_u, _), (y_s, tilt_s, x_s, _) = marched.slopes
    determinant = y_f * tilt_u - y_u * tilt_f
    f_s, u_s = (y_u * tilt_s - tilt_u * y_s) / determinant, (tilt_f * y_s - y_f * tilt_s) / determinant
    x_y = (x_u * tilt_f - x_f * tilt_u) / determinant
    # at touch-down of the tip x0 varies with the square root of the height: an infinite rate
    straight = (force == 0) & (np.abs(determinant) < 1e-5)
    x0_slope = np.where(straight, 0.0, x_s + x_f * f_s + x_u * u_s)
    x0_arc = np.where(straight, np.inf, np.cos(at.slope) + np.sin(at.slope) * x_y)
    _, _, x0, moment = marched.values
    state = State(x0.copy(), z.T.copy(), force.copy(), -moment, 1 + np.minimum(u, 0.0), x0_slope, x0_arc)
    lost = np.flatnonzero((force < 0) | marched.inflected)
    _put(state, lost, _nowhere(len(lost)))
    return state


def _nowhere(n: int) -> State:
    """Room for states of which none is known."""
    x0, force, m0z, s1, x0_slope, x0_arc = np.full((6, n), np.nan)
    return State(x0, np.full((n, 2), np.nan), force, m0z, s1, x0_slope, x0_arc)


def _put(states: State, rows: Index | Mask, others: State) -> None:
    for column, values in zip(states, others, strict=True):
        column[rows] = values


def _softness(rod: Rod, s1: Array) -> Array:
    """Small forces at s1 (n,) relative to those that bend the uniform rod as far there."""
    s = np.linspace(0.0, 1.0, 65)
    part = s[:, None] * s1
    bent = np.trapezoid((s1 - part) ** 2 / rod.profile.bending_stiffness(part), s, axis=0)
    return np.asarray(s1**2 / 3 / bent)
