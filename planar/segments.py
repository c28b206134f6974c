"""The path of a contour cut into segments, on each of which every base position has at most one equilibrium.

Along the path the base position ``x0`` of the equilibria falls, but not everywhere: it has local minima (folds), and its
rate jumps where tip and tangential contact change into each other.  The path is cut there and at the ends of its pieces.
All computations run over flat arrays: the rows of many sweeps, distinguished by their owner.

At a given place the rod is in tangential contact (7) or in tip contact (6).  A place is a slope angle ``α̃`` and a point
``(ξ, η)``; with the friction angle ``ζ`` the contact force has the direction ``α = α̃ + ζ`` (2).  The base position ``x0``
follows from the place, not the other way round, so that no continuation in ``x0`` is needed: tangential contact is explicit,
tip contact one scalar root.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from planar.arrays import Array, Index, Mask, ranges, ratio, rows_of
from planar.contours import Path
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
    """``m0z / (2 √f)``; of any rod (n, 2) force and arc length, or slope of the tip (`planar.rod_sweeps`)."""
    force: Array
    """Size f of the contact force."""
    m0z: Array
    """Clamping moment."""
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
    x0_arc = np.cos(slope) - lean * np.sin(slope)
    return State(x - y * lean, q, root_f**2, 2 * q * root_f, s1, -y * lean_slope, x0_arc)


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
    return State(x - lean, q, root_f**2, 2 * q * root_f, s1, x0_slope, x0_arc)


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


_EPS = float(np.finfo(float).eps)


LEVELS = 3
"""Coefficients of friction at which a sweep with one per sample is tabulated; a sample is searched between two of them."""


def levels(friction: Array) -> Array:
    """Coefficients of friction, or their angles, between which those of the samples (n,) of a sweep lie."""
    return np.unique(np.linspace(friction.min(), friction.max(), LEVELS)) if friction.size else np.zeros(1)


class Segments(NamedTuple):
    """Rows (m,) sorted by owner and along the path; columns (m, 2) hold the values at both ends."""

    owner: Index
    """Sweep, or sample with a separate coefficient of friction, that the row belongs to."""
    piece: Index
    tangential: Mask
    friction_angle: Array
    t: Array
    """(m, 2) parameter of the piece."""
    x0: Array
    """(m, 2) base position; NaN where no equilibrium exists."""
    rate: Array
    """(m, 2) change of x0 with t."""
    q: Array
    """(m, 2) or (m, 2, 2), that of `State`."""


class Equilibria:
    """Those of the straight, uniform rod; `planar.rod_sweeps` has others."""

    def at_ends(self, path: Path, owner: Index, piece: Index, end: Array, zeta: Array) -> tuple[Mask, State]:
        """Kinds and states (n,) at ends, 0 or 1, of pieces, sorted by owner and along the path."""
        slope, x, y = path.at(piece, end)
        along_rod = is_tangential(slope, y, zeta)
        return along_rod, states(along_rod, slope, x, y, zeta)

    def cut_within(self, path: Path, segments: Segments, tangential_at_end: Mask) -> tuple[Segments, Mask]:
        """The segments cut where the ends of pieces don't tell of it."""
        return _cut_at_short_tangencies(path, segments, tangential_at_end)

    def transitions(self, path: Path, segments: Segments) -> tuple[Array, State, State]:
        """Parameters t (m,), and states in tangential and in tip contact, where the kind changes: ``s1 = 1``, ``φ1 = α̃``."""

        def above(t: Array, piece: Index, zeta: Array) -> Array:
            slope, _, y = path.at(piece, t)
            return overhang(slope, y, zeta)

        piece, zeta = segments.piece, segments.friction_angle
        t = _find_root(above, (segments.t[:, 0], segments.t[:, 1]), args=(piece, zeta)).x
        place = path.at(piece, t)
        along = tangential(*place, zeta)
        return t, along, tip(*place, zeta, along.q)

    def folds(self, path: Path, segments: Segments) -> tuple[Array, State]:
        """Parameters t (m,) and states up to which x0 falls."""
        piece, zeta, kind = segments.piece, segments.friction_angle, segments.tangential
        low, high = segments.t.T

        def rate(t: Array, piece: Index, zeta: Array, kind: Mask, low: Array, high: Array) -> Array:
            place = path.at(piece, t)
            # infinite at touch-down, NaN beyond the end of the equilibria: only the sign matters there
            value = np.clip(np.nan_to_num(rates(path, piece, place[0], states(kind, *place, zeta)), nan=1.0), -1.0, 1.0)
            # the signs at the ends are known, and rounding must not change them
            return np.where(t == low, -1.0, np.where(t == high, 1.0, value))

        root = _find_root(rate, (low, high), args=(piece, zeta, kind, low, high))
        # Equilibria on the side on which x0 rises are unstable: the cut lies on the other side of the minimum.
        t = np.where(root.f_x > 0, root.bracket[0], root.x)
        return t, states(kind, *path.at(piece, t), zeta)

    def pull(self, path: Path, piece: Index) -> Array:
        """The rod's weight as a force, (2, m) or (2, 1)."""
        return np.zeros((2, 1))

    def solve(self, path: Path, segments: Segments, target: Array) -> tuple[Index, Array, State]:
        """Pieces, parameters t (m,) and states at which x0 has come down to `target` (m,) on the segments."""
        return segments.piece, *_solve(path, segments, target)


UNIFORM = Equilibria()


def _find_root(function: Callable[..., Array], interval: tuple[Array, Array], args: tuple[Any, ...]) -> Any:
    """Roots of many functions at once, to rounding, in intervals at whose ends the signs differ."""
    from scipy.optimize import elementwise  # imported late, so that `import planar` stays quick

    tolerances = dict(xatol=0.0, xrtol=4 * _EPS, fatol=0.0, frtol=0.0)
    return elementwise.find_root(function, interval, args=args, tolerances=tolerances)


def cut(path: Path, owner: Index, piece: Index, friction_angle: Array, rod: Equilibria = UNIFORM) -> Segments:
    """Segments of the pieces (rows sorted by owner and along the path, without gaps within an owner)."""
    last = np.append(owner[1:] != owner[:-1], True)
    # Neighbouring pieces share the state between them: nodes are the rows' starts and each owner's last end.
    row = np.repeat(np.arange(len(owner)), 1 + last)
    at_end = np.insert(row[1:] == row[:-1], 0, False)
    start = np.flatnonzero(~at_end)
    along_rod, state = rod.at_ends(path, owner[row], piece[row], at_end.astype(float), friction_angle[row])
    slope = path.at(piece[row], at_end.astype(float))[0]
    ends = [(slope[n], State._make(column[n] for column in state)) for n in (start, start + 1)]
    segments = Segments(
        owner,
        piece,
        along_rod[start],
        friction_angle,
        np.tile([0.0, 1.0], (len(owner), 1)),
        np.stack([end.x0 for _, end in ends], axis=1),
        np.stack([rates(path, piece, *end) for end in ends], axis=1),
        np.stack([end.q for _, end in ends], axis=1),
    )
    segments, tangential_at_end = rod.cut_within(path, segments, along_rod[start + 1])
    segments = _cut_at_transitions(path, segments, tangential_at_end, rod)
    return _cut_at_folds(path, segments, rod)


def cut_intervals(
    path: Path, first: Index, stop: Index, friction_angle: Array, rod: Equilibria = UNIFORM
) -> tuple[Segments, Index]:
    """Segments of owners that each have the pieces from `first` to `stop`, and where each owner's begin (owners + 1,)."""
    count = stop - first
    owner, after = ranges(count)
    table = cut(path, owner, first[owner] + after, friction_angle[owner], rod)
    return table, np.searchsorted(table.owner, np.arange(len(count) + 1))


class Tables(NamedTuple):
    """Segments of every sweep at some angles of friction: a single one where its friction is constant."""

    segments: Segments
    rows: list[list[slice]]
    """Rows of the segments for each sweep and angle."""


def tables(path: Path, runs: list[Index], angles: list[Array], rod: Equilibria = UNIFORM) -> Tables:
    """Tables of sweeps that each pass some runs of the path, at angles of friction of their own."""
    run = np.concatenate([np.tile(part, len(at)) for part, at in zip(runs, angles, strict=True)])
    angle = np.concatenate([np.repeat(at, len(part)) for part, at in zip(runs, angles, strict=True)])
    table, bounds = cut_intervals(path, path.offsets[run], path.offsets[run + 1], angle, rod)
    count = np.repeat([len(part) for part in runs], [len(at) for at in angles])
    ends = bounds[np.cumsum([0, *count])]
    slices = map(slice, ends[:-1], ends[1:])
    return Tables(table, [[next(slices) for _ in at] for at in angles])


def rates(path: Path, piece: Index, slope: Array, state: State) -> Array:
    """Change of x0 with the parameter of the piece, from its changes with slope and arc length."""
    turn, arc = path.turn[piece], path.arc_rate(piece, slope)
    with np.errstate(invalid="ignore"):
        return np.where(turn != 0, state.x0_slope * turn, 0.0) + np.where(arc != 0, state.x0_arc * arc, 0.0)


def cut_rows(segments: Segments, rows: Index, t: Array, x0: Array, rate: Array, q: Array) -> Segments:
    """Cut the `rows` at t, where the state has x0, q and the rate (r, 2) before and after the cut."""
    repeat = np.ones(len(segments.owner), dtype=np.intp)
    repeat[rows] = 2
    first = (np.cumsum(repeat) - repeat)[rows]
    parts = Segments._make(np.repeat(column, repeat, axis=0) for column in segments)
    for column, before, after in ((parts.t, t, t), (parts.x0, x0, x0), (parts.rate, *rate.T), (parts.q, q, q)):
        column[first, 1] = before
        column[first + 1, 0] = after
    return parts


def _cut_at_short_tangencies(path: Path, segments: Segments, tangential_at_end: Mask) -> tuple[Segments, Mask]:
    """Cut tip contacts with a tangential contact shorter than the piece between them, as on small contours near y = 1."""
    if path.smooth is None:  # along an edge or at a vertex the kind of contact changes at most once
        return segments, tangential_at_end
    rows = np.flatnonzero(~segments.tangential & ~tangential_at_end)
    piece, zeta = segments.piece[rows], segments.friction_angle[rows]

    def above(t: Array) -> Array:
        slope, _, y = path.at(piece, t)
        return overhang(slope, y, zeta)

    # the minimum of the overhang, from parabolas through three points about the previous estimate, each narrower than the one
    # before: an inexact minimum would overlook short tangential contacts
    t, width = np.full(len(rows), 0.5), 0.5
    for _ in range(4):
        before, here, after = above(t - width), above(t), above(t + width)
        step = ratio(before - after, before + after - 2 * here) / 2
        t, width = t + width * np.nan_to_num(np.clip(step, -1.0, 1.0)), width / 8
        t = np.clip(t, width, 1 - width)
    touches = above(t) < 0
    rows, t, piece, zeta = rows[touches], t[touches], piece[touches], zeta[touches]
    slope, x, y = path.at(piece, t)
    state = tangential(slope, x, y, zeta)
    rate = rates(path, piece, slope, state)
    parts = cut_rows(segments, rows, t, state.x0, np.stack([rate, rate], axis=1), state.q)
    parts.tangential[rows + np.arange(len(rows)) + 1] = True
    return parts, np.insert(tangential_at_end, rows, True)


def _cut_at_transitions(path: Path, segments: Segments, tangential_at_end: Mask, rod: Equilibria) -> Segments:
    """Cut where tip and tangential contact change into each other."""
    rows = np.flatnonzero(segments.tangential != tangential_at_end)
    if not len(rows):
        return segments
    part = rows_of(segments, rows)
    t, along, by_tip = rod.transitions(path, part)
    slope = path.at(part.piece, t)[0]
    rate = np.stack([rates(path, part.piece, slope, state) for state in (along, by_tip)], axis=1)
    rate[~part.tangential] = rate[~part.tangential, ::-1]
    parts = cut_rows(segments, rows, t, along.x0, rate, along.q)
    parts.tangential[rows + np.arange(len(rows)) + 1] = ~part.tangential
    return parts


def _cut_at_folds(path: Path, segments: Segments, rod: Equilibria) -> Segments:
    """Cut where x0 stops falling: at its minimum, which precedes any place where the equilibria end."""
    ends_rising = (segments.rate[:, 1] > 0) | np.isnan(segments.x0[:, 1])
    rows = np.flatnonzero((segments.rate[:, 0] < 0) & ends_rising)
    if not len(rows):
        return segments
    t, state = rod.folds(path, rows_of(segments, rows))
    return cut_rows(segments, rows, t, state.x0, np.zeros((len(rows), 2)), state.q)


def _solve(path: Path, segments: Segments, target: Array) -> tuple[Array, State]:
    """Parameters and states of `Equilibria.solve`.

    Newton's method in the place t, for tip contact together with the bend q, starting from an interpolation; samples
    for which it does not converge are solved by bracketing.
    """
    piece, zeta, kind = segments.piece, segments.friction_angle, segments.tangential
    low, high = segments.t.T
    t, q = _interpolate(segments, target)
    # rounding of x0, by the lengths that it is computed from
    tolerance = 8 * _EPS * (1.0 + np.abs(target) + np.abs(path.point[piece, 0]))

    active = np.arange(len(target))
    for _ in range(8):  # a sample that needs more goes on to bracketing
        slope, x, y = path.at(piece[active], t[active])
        t_step, q_step, residual = _newton_step(
            path, piece[active], kind[active], slope, x, y, zeta[active], q[active], target[active]
        )
        unfinished = ~(residual <= tolerance[active])
        active, t_step, q_step = active[unfinished], t_step[unfinished], q_step[unfinished]
        if not len(active):
            break
        t[active] = np.clip(t[active] + t_step, low[active], high[active])
        # the step is one in q², in which height and lean are nearly linear; next to q = 0 Newton's method is slow
        q[active] = np.sqrt(np.maximum(q[active] * (q[active] + 2 * q_step), (q[active] / 4) ** 2))
    if len(active):
        t[active] = _bracketed(
            path, piece[active], kind[active], zeta[active], low[active], high[active], target[active]
        )
        q[active] = np.nan

    for end in (0, 1):
        at_end = target == segments.x0[:, end]
        t = np.where(at_end, segments.t[:, end], t)
        q = np.where(at_end, segments.q[:, end], q)
    return t, states(kind, *path.at(piece, t), zeta, q)


def _newton_step(
    path: Path, piece: Index, kind: Mask, slope: Array, x: Array, y: Array, zeta: Array, q: Array, target: Array
) -> tuple[Array, Array, Array]:
    """Steps in t and q, and the residual: of x0, in tip contact the larger one of x0 and y1."""
    turn, arc = path.turn[piece], path.arc_rate(piece, slope)
    t_step, q_step, residual = np.empty(len(piece)), np.zeros(len(piece)), np.empty(len(piece))
    with np.errstate(divide="ignore", invalid="ignore"):
        if kind.any():
            state = tangential(slope[kind], x[kind], y[kind], zeta[kind])
            excess = state.x0 - target[kind]
            t_step[kind] = -excess / (state.x0_slope * turn[kind] + state.x0_arc * arc[kind])
            residual[kind] = np.abs(excess)
        by_tip = ~kind
        if by_tip.any():
            slope, turn, arc = slope[by_tip], turn[by_tip], arc[by_tip]
            bent = bend_with_slopes(slope + zeta[by_tip], q[by_tip])
            ratios = tip_ratios(bent)
            # two equations, x0 = target and y1 = η, in t and q
            excess, height_excess = x[by_tip] - ratios.lean - target[by_tip], ratios.height - y[by_tip]
            excess_t = np.cos(slope) * arc - ratios.lean_alpha * turn
            height_excess_t = ratios.height_alpha * turn - np.sin(slope) * arc
            determinant = excess_t * ratios.height_q + ratios.lean_q * height_excess_t
            t_step[by_tip] = -(excess * ratios.height_q + ratios.lean_q * height_excess) / determinant
            q_step[by_tip] = (excess * height_excess_t - excess_t * height_excess) / determinant
            residual[by_tip] = np.maximum(np.abs(excess), np.abs(height_excess))
    return t_step, q_step, residual


def fractions(segments: Segments, target: Array) -> tuple[Array, Array]:
    """Fractions (m,) of the segments' x0, and by a monotone inverse cubic of their t, at which x0 comes down to `target`;
    next to folds and touch-down by the leading terms."""
    (t0, t1), (x0, x1) = segments.t.T, segments.x0.T
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.clip((target - x0) / (x1 - x0), 0.0, 1.0)
        slopes = np.clip((x1 - x0) / (t1 - t0) / segments.rate.T, 0.0, 3.0)  # up to 3 the cubic is monotone
    u, slopes = np.nan_to_num(u), np.nan_to_num(slopes, nan=1.0)
    fraction = u * u * (3 - 2 * u) + u * (1 - u) * (slopes[0] * (1 - u) - slopes[1] * u)
    # next to touch-down x0 varies with the square root of t, next to a fold with the square of t
    touch_down, fold = np.isinf(segments.rate[:, 0]), segments.rate[:, 1] == 0
    return u, np.where(touch_down, u * u, np.where(fold, 1 - np.sqrt(1 - u), fraction))


def _interpolate(segments: Segments, target: Array) -> tuple[Array, Array]:
    """Start values: t, and q² linear in it, or next to touch-down in x0."""
    (t0, t1), (q0, q1) = segments.t.T, segments.q.T
    u, fraction = fractions(segments, target)
    q = np.sqrt(np.maximum(q0**2 + np.where(np.isinf(segments.rate[:, 0]), u, fraction) * (q1**2 - q0**2), 0.0))
    return t0 + fraction * (t1 - t0), np.where(np.isfinite(q), q, q0)


def _bracketed(path: Path, piece: Index, kind: Mask, zeta: Array, low: Array, high: Array, target: Array) -> Array:
    """The parameter t between `low` and `high` at which x0 equals `target`."""

    def excess(t: Array, piece: Index, kind: Mask, zeta: Array, target: Array) -> Array:
        return states(kind, *path.at(piece, t), zeta).x0 - target

    root = _find_root(excess, (low, high), args=(piece, kind, zeta, target))
    # next to a fold rounding may change the sign at the end, so that no interval is left: then that end is the root
    return np.asarray(np.where(root.status == -1, high, root.x))
