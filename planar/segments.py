"""The path of a contour cut into segments, on each of which every base position has at most one equilibrium.

Along the path the base position ``x0`` of the equilibria falls, but not everywhere: it has local minima (folds), and its
rate jumps where tip and tangential contact change into each other.  The path is cut there and at the ends of its pieces.
Everything runs over flat arrays: the rows of many sweeps, told apart by their owner.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from planar import equilibria
from planar.contours import Array, Index, Path
from planar.elastica import bend_with_slopes

_EPS = float(np.finfo(float).eps)
_TO_ROUNDING = dict(xatol=0.0, xrtol=4 * _EPS, fatol=0.0, frtol=0.0)
_NEWTON_STEPS = 8
# Each parabola is eight times narrower than the last, and the overhang nearly one to begin with.
_PARABOLAS = 4

Mask = NDArray[np.bool_]


class Segments(NamedTuple):
    """Rows (m,) sorted by owner and along the path; columns (m, 2) hold the values at both ends."""

    owner: Index
    """Sweep, or single sample with friction of its own, that the row belongs to."""
    piece: Index
    tangential: Mask
    friction_angle: Array
    t: Array
    """(m, 2) parameter of the piece."""
    x0: Array
    """(m, 2) base position; NaN where there is no equilibrium."""
    rate: Array
    """(m, 2) change of x0 with t."""
    q: Array
    """(m, 2) ``m0z / (2 √f)``."""


def _find_root(function: Callable[..., Array], bracket: tuple[Array, Array], args: tuple[Any, ...]) -> Any:
    """Roots of many functions at once, to rounding."""
    from scipy.optimize import elementwise  # here, for `import planar` to be quick

    return elementwise.find_root(function, bracket, args=args, tolerances=_TO_ROUNDING)


def cut(path: Path, owner: Index, piece: Index, friction_angle: Array) -> Segments:
    """Segments of the pieces (rows sorted by owner and along the path, without gaps within an owner)."""
    last = np.append(owner[1:] != owner[:-1], True)
    # Neighbouring pieces share the state between them: nodes are the rows' starts and each owner's last end.
    row = np.repeat(np.arange(len(owner)), 1 + last)
    at_end = np.insert(row[1:] == row[:-1], 0, False)
    start = np.flatnonzero(~at_end)
    slope, x, y = path.at(piece[row], at_end.astype(float))
    tangential = equilibria.lies_tangentially(slope, y, friction_angle[row])
    state = equilibria.of_kind(tangential, slope, x, y, friction_angle[row])
    segments = Segments(
        owner,
        piece,
        tangential[start],
        friction_angle,
        np.tile([0.0, 1.0], (len(owner), 1)),
        np.stack([state.x0[start], state.x0[start + 1]], axis=1),
        np.stack(
            [_rate(path, piece, slope[n], state.x0_slope[n], state.x0_arc[n]) for n in (start, start + 1)], axis=1
        ),
        np.stack([state.q[start], state.q[start + 1]], axis=1),
    )
    segments, tangential_at_end = _cut_at_grazes(path, segments, tangential[start + 1])
    segments = _cut_at_transitions(path, segments, tangential_at_end)
    return _cut_at_folds(path, segments)


def _rate(path: Path, piece: Index, slope: Array, x0_slope: Array, x0_arc: Array) -> Array:
    """Change of x0 with the parameter of the piece, from its changes with slope and arc length."""
    turn, arc = path.turn[piece], path.arc_rate(piece, slope)
    with np.errstate(invalid="ignore"):
        return np.where(turn != 0, x0_slope * turn, 0.0) + np.where(arc != 0, x0_arc * arc, 0.0)


def _cut_rows(segments: Segments, rows: Index, t: Array, x0: Array, rate: Array, q: Array) -> Segments:
    """Cut the `rows` at t, where the state has x0, q and the rate (r, 2) before and after the cut."""
    repeat = np.ones(len(segments.owner), dtype=np.intp)
    repeat[rows] = 2
    first = (np.cumsum(repeat) - repeat)[rows]
    parts = Segments._make(np.repeat(column, repeat, axis=0) for column in segments)
    for column, before, after in ((parts.t, t, t), (parts.x0, x0, x0), (parts.rate, *rate.T), (parts.q, q, q)):
        column[first, 1] = before
        column[first + 1, 0] = after
    return parts


def _cut_at_grazes(path: Path, segments: Segments, tangential_at_end: Mask) -> tuple[Segments, Mask]:
    """Cut tip contacts where the rod lies tangentially for less than a piece, as on small contours near the tip's height."""
    if path.smooth is None:  # along edges and at vertices the contact changes its kind but once
        return segments, tangential_at_end
    rows = np.flatnonzero(~segments.tangential & ~tangential_at_end)
    piece, zeta = segments.piece[rows], segments.friction_angle[rows]

    def overhang(t: Array) -> Array:
        slope, _, y = path.at(piece, t)
        return equilibria.overhang(slope, y, zeta)

    # the lowest point of the parabola through three points, then of narrower ones about it
    t, width = np.full(len(rows), 0.5), 0.5
    for _ in range(_PARABOLAS):
        before, here, after = overhang(t - width), overhang(t), overhang(t + width)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = (before - after) / (before + after - 2 * here) / 2
        t, width = t + width * np.nan_to_num(np.clip(step, -1.0, 1.0)), width / 8
        t = np.clip(t, width, 1 - width)
    lies = overhang(t) < 0
    rows, t, piece, zeta = rows[lies], t[lies], piece[lies], zeta[lies]
    slope, x, y = path.at(piece, t)
    state = equilibria.tangential(slope, x, y, zeta)
    rate = _rate(path, piece, slope, state.x0_slope, state.x0_arc)
    parts = _cut_rows(segments, rows, t, state.x0, np.stack([rate, rate], axis=1), state.q)
    parts.tangential[rows + np.arange(len(rows)) + 1] = True
    return parts, np.insert(tangential_at_end, rows, True)


def _cut_at_transitions(path: Path, segments: Segments, tangential_at_end: Mask) -> Segments:
    """Cut where tip and tangential contact change into each other: ``s1 = 1`` with ``φ1 = α̃``."""
    rows = np.flatnonzero(segments.tangential != tangential_at_end)
    if not len(rows):
        return segments
    piece, zeta = segments.piece[rows], segments.friction_angle[rows]

    def overhang(t: Array, piece: Index, zeta: Array) -> Array:
        slope, _, y = path.at(piece, t)
        return equilibria.overhang(slope, y, zeta)

    low, high = segments.t[rows].T
    t = _find_root(overhang, (low, high), args=(piece, zeta)).x
    slope, x, y = path.at(piece, t)
    lying = equilibria.tangential(slope, x, y, zeta)
    standing = equilibria.tip(slope, x, y, zeta, lying.q)
    rate = np.stack([_rate(path, piece, slope, s.x0_slope, s.x0_arc) for s in (lying, standing)], axis=1)
    lies_first = segments.tangential[rows]
    rate[~lies_first] = rate[~lies_first, ::-1]
    parts = _cut_rows(segments, rows, t, lying.x0, rate, lying.q)
    parts.tangential[rows + np.arange(len(rows)) + 1] = ~lies_first
    return parts


def _cut_at_folds(path: Path, segments: Segments) -> Segments:
    """Cut where x0 stops falling: at its minimum, which comes before any place where the equilibria end."""
    ends_rising = (segments.rate[:, 1] > 0) | np.isnan(segments.x0[:, 1])
    rows = np.flatnonzero((segments.rate[:, 0] < 0) & ends_rising)
    if not len(rows):
        return segments
    piece, zeta, kind = segments.piece[rows], segments.friction_angle[rows], segments.tangential[rows]
    low, high = segments.t[rows].T

    def rate(t: Array, piece: Index, zeta: Array, kind: Mask, low: Array, high: Array) -> Array:
        slope, x, y = path.at(piece, t)
        state = equilibria.of_kind(kind, slope, x, y, zeta)
        # infinite at touch-down, and no number past the end of the equilibria: only the sign matters there
        value = np.clip(np.nan_to_num(_rate(path, piece, slope, state.x0_slope, state.x0_arc), nan=1.0), -1.0, 1.0)
        # the signs at the ends are known, and must not get lost to rounding
        return np.where(t == low, -1.0, np.where(t == high, 1.0, value))

    found = _find_root(rate, (low, high), args=(piece, zeta, kind, low, high))
    t = np.where(found.f_x > 0, found.bracket[0], found.x)  # never on the side on which x0 rises
    state = equilibria.of_kind(kind, *path.at(piece, t), zeta)
    return _cut_rows(segments, rows, t, state.x0, np.zeros((len(rows), 2)), state.q)


def solve(path: Path, segments: Segments, row: Index, target: Array) -> tuple[Array, equilibria.State]:
    """Parameter t (n,) and state (n,) at which x0 has come down to `target` (n,) on the segments `row` (n,).

    Newton's method in the place t, for tip contact together with the bend q, from interpolation; what does not
    converge is solved by bracketing.
    """
    piece, zeta, kind = segments.piece[row], segments.friction_angle[row], segments.tangential[row]
    low, high = segments.t[row].T
    t, q = _interpolate(segments, row, target)
    tolerance = 8 * _EPS * (1.0 + np.abs(target) + np.abs(path.point[piece, 0]))

    going = np.arange(len(row))
    for _ in range(_NEWTON_STEPS):
        slope, x, y = path.at(piece[going], t[going])
        t_step, q_step, miss = _newton_step(
            path, piece[going], kind[going], slope, x, y, zeta[going], q[going], target[going]
        )
        unfinished = ~(miss <= tolerance[going])
        going, t_step, q_step = going[unfinished], t_step[unfinished], q_step[unfinished]
        if not len(going):
            break
        t[going] = np.clip(t[going] + t_step, low[going], high[going])
        # the step is one in q², in which height and lean are nearly linear
        q[going] = np.sqrt(np.maximum(q[going] * (q[going] + 2 * q_step), q[going] ** 2 / 16))
    if len(going):
        t[going] = _bracketed(path, piece[going], kind[going], zeta[going], low[going], high[going], target[going])
        q[going] = np.nan

    for end in (0, 1):
        there = target == segments.x0[row, end]
        t = np.where(there, segments.t[row, end], t)
        q = np.where(there, segments.q[row, end], q)
    return t, equilibria.of_kind(kind, *path.at(piece, t), zeta, q)


def _newton_step(
    path: Path, piece: Index, kind: Mask, slope: Array, x: Array, y: Array, zeta: Array, q: Array, target: Array
) -> tuple[Array, Array, Array]:
    """Steps in t and q, and how far x0 and (at the tip) y1 miss their targets."""
    turn, arc = path.turn[piece], path.arc_rate(piece, slope)
    t_step, q_step, miss = np.empty(len(piece)), np.zeros(len(piece)), np.empty(len(piece))
    with np.errstate(divide="ignore", invalid="ignore"):
        if kind.any():
            state = equilibria.tangential(slope[kind], x[kind], y[kind], zeta[kind])
            excess = state.x0 - target[kind]
            t_step[kind] = -excess / (state.x0_slope * turn[kind] + state.x0_arc * arc[kind])
            miss[kind] = np.abs(excess)
        tip = ~kind
        if tip.any():
            slope, turn, arc = slope[tip], turn[tip], arc[tip]
            bent = bend_with_slopes(slope + zeta[tip], q[tip])
            lean, lean_alpha, lean_q, height, height_alpha, height_q = equilibria.tip_ratios(bent)
            excess, short = x[tip] - lean - target[tip], height - y[tip]
            # two equations, x0 = target and y1 = η, in t and q
            excess_t = np.cos(slope) * arc - lean_alpha * turn
            short_t = height_alpha * turn - np.sin(slope) * arc
            determinant = excess_t * height_q + lean_q * short_t
            t_step[tip] = -(excess * height_q + lean_q * short) / determinant
            q_step[tip] = (excess * short_t - excess_t * short) / determinant
            miss[tip] = np.maximum(np.abs(excess), np.abs(short))
    return t_step, q_step, miss


def _interpolate(segments: Segments, row: Index, target: Array) -> tuple[Array, Array]:
    """Start values: t by a monotone inverse cubic in x0 and q² linear in t; at folds and touch-down their leading terms."""
    (t0, t1), (x0, x1) = segments.t[row].T, segments.x0[row].T
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.clip((target - x0) / (x1 - x0), 0.0, 1.0)
        slopes = np.clip((x1 - x0) / (t1 - t0) / segments.rate[row].T, 0.0, 3.0)
    u, slopes = np.nan_to_num(u), np.nan_to_num(slopes, nan=1.0)
    share = u * u * (3 - 2 * u) + u * (1 - u) * (slopes[0] * (1 - u) - slopes[1] * u)
    q0, q1 = segments.q[row].T
    # x0 leaves touch-down with the root of t and with q², and comes to a fold with the square of t
    touch_down, fold = np.isinf(segments.rate[row, 0]), segments.rate[row, 1] == 0
    share = np.where(touch_down, u * u, np.where(fold, 1 - np.sqrt(1 - u), share))
    q = np.sqrt(np.maximum(q0**2 + np.where(touch_down, u, share) * (q1**2 - q0**2), 0.0))
    return t0 + share * (t1 - t0), np.where(np.isfinite(q), q, q0)


def _bracketed(path: Path, piece: Index, kind: Mask, zeta: Array, low: Array, high: Array, target: Array) -> Array:
    """The parameter t between `low` and `high` at which x0 equals `target`."""

    def excess(t: Array, piece: Index, kind: Mask, zeta: Array, target: Array) -> Array:
        return equilibria.of_kind(kind, *path.at(piece, t), zeta).x0 - target

    found = _find_root(excess, (low, high), args=(piece, kind, zeta, target))
    # at an end that is a fold both signs may be lost to rounding: that end is the root
    return np.where(found.status == -1, high, found.x)
