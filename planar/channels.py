"""Contacts from fewer than three reactions, where friction, the slope of the contour or contact at the tip is known instead.

Three reactions determine three unknowns, force, direction and place.  Each channel that is missing asks for one equation:
``β = ζ`` in tangential contact with known friction, ``s1 = 1`` at the tip, ``α - β = α̃`` where the contour's slope is known.
Its root is sought over all values of the missing channel.  With known friction every row is either tangential, with
``s1 <= 1``, or at the tip, with ``β <= ζ``; where both or several roots exist, the channels do not determine the contact.

By the moment alone contacts are located along sweeps: tangential contacts with known friction move along the surface.  Such a
contact has ``β = ζ``, and between two samples it moves across the mean of their normals: two equations for the two
forces of each sample.  The second has an error of a sixth of the step's square times the change of the curvature, of the third
order on a smooth body, and of no more than the step times its turn at a corner.  Both hold in a plane, and in space for a
straight rod, which bends in the plane across its moment: there ``β`` and the normal follow from the direction in which the
contact slips, for friction acts against it.  The forces are those in the plane in which the rod bends, and `Frames` is where
that lies.

The first contact must be known.  A small push tells it: shortly after touch-down the moment rises by ``dm0z/dx0 = 3/s1²`` on a
uniform rod.  An error of it dies out as one over the moment.  At the tip the same equations do not determine the forces: the
direction of a small force does not change the shape of the rod to the first order.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from planar.arrays import BLOCK, NAMES, Array, Index, Reactions, check_direction, checked_reactions, rows_of
from planar.reconstruction import jacobian
from planar.rods import Rod, as_rod, free_reactions, solve

# Residual of a root, in rod lengths or radians; a change of sign without it is a jump.
_ROOT = 1e-8
# How often the step to the border past which there is no rod is halved, in search of a root before it.
_HALVINGS = 8

Residual = Callable[..., Array]


class Completed(NamedTuple):
    """Reactions (n,) of a sweep, with the channel that was not measured."""

    reactions: Reactions
    """NaN in the missing channel where no value would do, or several and it is not known which."""
    roots: Index
    """(n,) how many values of the missing channel would do."""

    def __repr__(self) -> str:
        known = int(np.isfinite(self.reactions[1:]).all(axis=0).sum())
        return f"Completed reactions of {len(self.roots)} rows, {known} of them with a value of the missing channel"


def complete(
    x0: ArrayLike,
    f0x: ArrayLike | None,
    f0y: ArrayLike | None,
    m0z: ArrayLike | None,
    *,
    friction: ArrayLike | None = None,
    slope: ArrayLike | None = None,
    tip: bool = False,
    near: ArrayLike | None = None,
    direction: int = -1,
    rod: Rod | None = None,
) -> Completed:
    """The reactions of a sweep of which one was not measured, given as None; `planar.reconstruct` takes the result.

    friction
        the coefficient of friction, one number or (n,), if it is known: contacts are tangential or at the tip.
    slope
        the slope angle of the contour, one number or (n,), in radians, if it is known: contacts are tangential.
    tip
        whether all contacts are known to be at the tip.
    near
        one number or (n,): of several values of the missing channel the one nearest to this is taken.  On uniform rods f0x of
        either sign agrees with the same f0y and m0z, so that its sign at least must be known.
    direction, rod
        as in `planar.reconstruct`.

    Exactly one of `friction`, `slope` and `tip` is given.  Raises ValueError otherwise, and for channels that can't tell: axial
    force and moment of a uniform rod in frictionless contact are one number measured twice, ``f0y = m0z²/2 - κ̂ m0z``.
    """
    given = dict(zip(NAMES, (f0x, f0y, m0z), strict=True))
    absent = [name for name, column in given.items() if column is None]
    if len(absent) != 1:
        raise ValueError(f"exactly one of f0x, f0y and m0z must be None, got {len(absent)} that are; two are needed")
    if (friction is not None) + (slope is not None) + tip != 1:
        raise ValueError("one of friction, slope and tip must be given in the place of the missing channel")
    check_direction(direction)
    columns = [np.zeros_like(np.asarray(x0, dtype=float)) if column is None else column for column in given.values()]
    reactions = checked_reactions(x0, *columns)
    missing, side = NAMES.index(absent[0]), -direction
    rod = as_rod(rod).steady()
    if side < 0:
        rod = rod.mirrored()
    # a sweep in +x is the mirror image of a sweep in -x
    signs = [side, 1, side]
    a, b = (signs[k] * reactions[1 + k] for k in range(3) if k != missing)
    count = len(reactions.x0)
    angle = _known_angle(friction, slope, side, count)
    if missing == 0 and rod.is_uniform and friction is not None and (angle == 0).any():
        raise ValueError(
            "axial force and moment do not locate a contact without friction on a uniform rod, for which f0y = m0z²/2 - κ̂ m0z "
            "whatever the contact; measure f0x, use a tapered rod, or touch with the tip alone (tip=True)"
        )

    def found(value: Array, a: Array, b: Array) -> Array:
        """s1, β and α - β of the rods with a value of the missing channel."""
        columns = [a, b]
        columns.insert(missing, value)
        shape = np.broadcast_shapes(*(column.shape for column in columns))
        with np.errstate(all="ignore"):
            solved = solve("closed-form", rod, *(np.broadcast_to(column, shape).ravel() for column in columns))
            wrong = solved.wrong_side | solved.no_rod | solved.undefined
            values = np.stack([solved.s1, solved.beta, solved.alpha - solved.beta])
        return np.where(wrong, np.nan, values).reshape(3, *shape)

    def missed(which: int) -> Residual:
        """What s1, β or α - β is more than the known value."""
        return lambda value, a, b, known: np.asarray(found(value, a, b)[which] - known)

    # a moment that is not positive is that of a rod bent against the sweep, but for its weight
    # denser near zero, in EI/L² or EI/L; the largest bends a rod by more than a right angle, however it is held
    tried = np.sinh(np.linspace(0.001, 7.8, 79)) / 10
    if missing != 2 or rod.weight:
        tried = np.concatenate([-tried[::-1], tried])
    at_tip = np.ones(count)
    if slope is not None or tip:
        candidates = _roots(missed(0 if tip else 2), tried, a, b, at_tip if tip else angle)
    else:
        tangential = _roots(missed(1), tried, a, b, angle)
        tips = _roots(missed(0), tried, a, b, at_tip)
        tangential[found(tangential, a[:, None], b[:, None])[0] > 1 + _ROOT] = np.nan
        tips[found(tips, a[:, None], b[:, None])[1] > angle[:, None] - _ROOT] = np.nan
        candidates = np.concatenate([tangential, tips], axis=1)
    known = np.isfinite(candidates)
    roots = known.sum(axis=1)
    if near is None:
        value = np.where(roots == 1, np.where(known, candidates, 0.0).sum(axis=1), np.nan)
    else:
        distance = np.abs(candidates - signs[missing] * np.broadcast_to(np.asarray(near, dtype=float), count)[:, None])
        nearest = np.argmin(np.where(known, distance, np.inf), axis=1)
        value = np.take_along_axis(candidates, nearest[:, None], axis=1)[:, 0]
    completed = list(reactions)
    completed[1 + missing] = signs[missing] * value
    return Completed(Reactions(*completed), roots)


def _known_angle(friction: ArrayLike | None, slope: ArrayLike | None, side: int, count: int) -> Array:
    """The friction angle or the slope (n,) in a sweep in -x, 0 where neither is known.  Raises ValueError for wrong values."""
    name, values = ("friction", friction) if slope is None else ("slope", slope)
    angle = np.asarray(0.0 if values is None else values, dtype=float)
    if angle.shape not in ((), (count,)) or not np.isfinite(angle).all() or (name == "friction" and (angle < 0).any()):
        kind = "number >= 0" if name == "friction" else "number"
        raise ValueError(f"{name} must be one {kind} or one for each of the {count} samples, got {angle}")
    return np.broadcast_to(np.arctan(angle) if name == "friction" else side * angle, count)


def _roots(residual: Residual, tried: Array, a: Array, b: Array, known: Array) -> Array:
    """All roots (n, most) of a residual, NaN where a row has fewer.

    They lie between values tried at which its sign differs, on both sides of an extremum beyond zero, or next to the border
    past which there is no rod.
    """
    from scipy.optimize import elementwise  # imported late, so that `import planar` stays quick

    # neighbours together, for rods under small forces are marched in few steps
    parts = np.array_split(tried, max(np.ceil(len(tried) * len(a) / BLOCK), 1))
    columns = [residual(part, a[:, None], b[:, None], known[:, None]) for part in parts]
    values = np.concatenate(columns, axis=1)
    row, k = np.nonzero(values[:, :-1] * values[:, 1:] < 0)
    low, high = tried[k], tried[k + 1]

    # between the last value that a rod has and the border past which there is none, where the residual falls towards it
    there = np.isfinite(values)
    edge, k = np.nonzero(there[:, :-1] != there[:, 1:])
    up = np.where(there[edge, k], 1, -1)
    inner = k + (up < 0)
    before = np.pad(values, ((0, 0), (1, 1)), constant_values=np.nan)[edge, inner + 1 - up]
    within, border = np.stack([tried[inner], values[edge, inner]]), tried[inner + up]
    for _ in range(_HALVINGS):
        falls = ~(before * within[1] < within[1] ** 2)
        edge, before, within, border = edge[falls], before[falls], within[:, falls], border[falls]
        middle = (within[0] + border) / 2
        found = residual(middle, a[edge], b[edge], known[edge])
        exists = np.isfinite(found)
        crossed = within[1] * found < 0
        row = np.concatenate([row, edge[crossed]])
        low, high = np.concatenate([low, within[0, crossed]]), np.concatenate([high, middle[crossed]])
        before, border = np.where(exists, within[1], before), np.where(exists, border, middle)
        within = np.where(exists, [middle, found], within)

    sign = np.sign(values[:, 1:-1])
    before, here, after = (sign * values[:, part] for part in (slice(-2), slice(1, -1), slice(2, None)))
    near, k = np.nonzero((before >= here) & (after >= here) & (here > 0))
    if len(near):
        args = a[near], b[near], known[near], sign[near, k]
        least = elementwise.find_minimum(
            lambda value, *given: given[3] * residual(value, *given[:3]),
            (tried[k], tried[k + 1], tried[k + 2]),
            args=args,
        )
        beyond = least.f_x < 0
        near, k, place = near[beyond], k[beyond], least.x[beyond]
        row = np.concatenate([row, near, near])
        low, high = np.concatenate([low, tried[k], place]), np.concatenate([high, place, tried[k + 2]])
    order = np.argsort(row, kind="stable")
    row, low, high = row[order], low[order], high[order]
    roots = np.full((len(a), max(int(np.bincount(row, minlength=1).max()), 1)), np.nan)
    if len(row):
        result = elementwise.find_root(residual, (low, high), args=(a[row], b[row], known[row]))
        roots[row, np.arange(len(row)) - np.searchsorted(row, row)] = np.where(
            np.abs(result.f_x) < _ROOT, result.x, np.nan
        )
    return roots


# Residual of a root, in rod lengths or radians, and Newton steps within which it is found.
_FOLLOWED, _STEPS = 1e-11, 20
# Rounds at most in which the direction of friction is found, and the change of its angle in radians that ends them.
_TURNS, _SETTLED = 40, 1e-5
# Rows on each side by which slip is told, of which the best are taken.
_WINDOWS = (1, 2, 4, 8, 16)


class Frames(NamedTuple):
    """Where rods bend, in a plane or in space, k dimensions: rows (n,) of sweeps one after the other, in rod lengths."""

    sweep: Index
    """(n,) numbers of the sweeps."""
    place: Array
    """(n, k) the clamp."""
    axes: Array
    """(n, 2, k) the unit vectors against which the body pushes the rod, and along which the rod leaves the clamp."""
    normal: Array
    """(n, k) that across both; zero in a plane."""


class Followed(NamedTuple):
    """Contacts (n,) by their moments."""

    force: Array
    """(n, 2) support reactions along the two axes, f0x and f0y in EI/L²; NaN where there is no such contact."""
    moment: Array
    """(n,) the moments, which an axial force that was measured corrects as well."""
    turn: Array
    """(n,) angle about the rod by which it corrects the plane in which the rod bends."""
    covariance: Array
    """(n, 4, 4) of f0x, f0y, the moment, and the angle about the rod of the plane in which it bends."""


def follow(
    frames: Frames,
    moment: Array,
    start: Array,
    *,
    friction: float = 0.0,
    rod: Rod | None = None,
    noise: float = 0.0,
    start_sd: ArrayLike = 0.0,
    friction_angle_sd: float = 0.0,
    axial: Array | None = None,
    axial_sd: float = 0.0,
    in_space: bool = False,
) -> Followed:
    """The forces of tangential contacts (n,) that follow one another, by the moments (n,) that bend the rods, in ``EI/L``.

    start, start_sd
        arc length s1 of the first contact of each sweep (m,) and its standard deviation; NaN: the sweep is not followed.
    noise
        standard deviation of each component of the moment.
    friction_angle_sd
        that of the friction angle, one error of all rows.
    axial, axial_sd
        the support reaction (n,) along the undeformed rod in ``EI/L²``, if it was measured, and its standard deviation.

    in_space
        whether contacts may slip sideways.  Friction acts against the slip, whose direction the contacts tell: both are found
        in turns.
    """
    rod, zeta = as_rod(rod), float(np.arctan(friction))
    slip = _Slip(np.full(len(moment), zeta), np.zeros(len(moment)), np.zeros(len(moment)))
    if not (friction and in_space):
        found = _followed(frames, moment, start, slip, rod, noise, start_sd, friction_angle_sd)
        return _with_axial(found, axial, axial_sd)
    for _ in range(_TURNS):
        found = _followed(frames, moment, start, slip, rod, noise, start_sd, friction_angle_sd)
        found = _with_axial(found, axial, axial_sd)
        last, slip = slip, _slipping(frames, found, rod, zeta, slip)
        if np.abs(slip.beta - last.beta).max() < _SETTLED:
            break
    return found


def _with_axial(found: Followed, axial: Array | None, sd: float) -> Followed:
    """Forces, moments and planes, conditioned on axial forces (n,) that were measured."""
    if axial is None:
        return found
    covariance = found.covariance
    with np.errstate(all="ignore"):
        gain = covariance[:, :, 1] / (covariance[:, 1, 1] + sd**2)[:, None]
    gain = np.nan_to_num(gain)
    moved = np.nan_to_num(gain * (axial - found.force[:, 1])[:, None])
    left = covariance - gain[:, :, None] * covariance[:, None, 1]
    return Followed(found.force + moved[:, :2], found.moment + moved[:, 2], found.turn + moved[:, 3], left)


class _Slip(NamedTuple):
    """Where friction points, of contacts (n,)."""

    beta: Array
    """(n,) angle by which the force deviates from the normal of the rod in the plane in which it bends."""
    tilt: Array
    """(n,) angle about the rod from that plane to the normal of the surface."""
    doubt: Array
    """(n,) standard deviation of the direction of the slip."""


def _slipping(frames: Frames, found: Followed, rod: Rod, zeta: float, last: _Slip) -> _Slip:
    """Where friction points by the motion of the contacts, half way from what was taken before."""
    known = np.flatnonzero(np.isfinite(found.force[:, 0]))
    if not len(known):
        return last
    at = _contact(frames, known, found.force[known], found.moment[known], rod, np.zeros(len(known)))[0]
    (across, along), out = frames.axes[known].swapaxes(0, 1), frames.normal[known]
    # the normal of the rod in its plane, turned back by a right angle
    tangent = (
        np.einsum("nk,nk->n", at.normal, across)[:, None] * along
        - np.einsum("nk,nk->n", at.normal, along)[:, None] * across
    )
    sweep = frames.sweep[known]
    first, stop = (np.searchsorted(sweep, sweep, side=side) for side in ("left", "right"))
    place = np.arange(len(known))

    def directions(rows: int) -> Array:
        """(n, 2) unit vectors of the slip by so many rows on each side: against the tangent, and across it."""
        low, high = np.maximum(place - rows, first), np.minimum(place + rows, stop - 1)
        way = at.point[high] - at.point[low]
        along_it = (way * tangent).sum(axis=1)
        across_it = np.linalg.norm(way - along_it[:, None] * tangent, axis=1)
        slip = np.stack([at.s1[high] - at.s1[low] - along_it, np.copysign(across_it, (way * out).sum(axis=1))], axis=1)
        return np.asarray(slip / np.maximum(np.linalg.norm(slip, axis=1), np.finfo(float).tiny)[:, None])

    windows = [directions(rows) for rows in _WINDOWS]
    apart = [np.arccos(np.clip((one * other).sum(axis=1), -1, 1)) for one, other in pairwise(windows)]
    best = int(np.argmin([np.sqrt((angle**2).mean()) for angle in apart]))
    # rows share what their windows share
    around = np.array([np.sqrt((apart[best][max(k - 3, 0) : k + 4] ** 2).mean()) for k in place])
    cosine, sine = windows[best].T
    beta = np.arcsin(np.sin(zeta) * cosine)
    tilt = np.copysign(np.arccos(np.clip(np.cos(zeta) / np.cos(beta), -1, 1)), sine)
    # rows that are not followed yet go on as the last one
    every = np.searchsorted(known, np.arange(len(found.moment)), side="right") - 1
    ahead = np.clip(every, 0, None)
    beta, tilt = (last.beta + beta[ahead]) / 2, (last.tilt + tilt[ahead]) / 2
    return _Slip(beta, tilt, around[ahead])


def _followed(
    frames: Frames,
    moment: Array,
    start: Array,
    slip: _Slip,
    rod: Rod,
    noise: float,
    start_sd: ArrayLike,
    friction_angle_sd: float,
) -> Followed:
    """`follow` where it is known where friction points."""
    count, of_friction = len(moment), np.cos(slip.tilt)
    _, first, number = np.unique(frames.sweep, return_index=True, return_inverse=True)
    rank = np.arange(count) - first[number]
    begin, begin_sd = start[number], np.broadcast_to(start_sd, start.shape)[number]
    force, covariance = np.full((count, 2), np.nan), np.full((count, 4, 4), np.nan)
    # what errors of the friction angle, the start and the steps change, in each sweep alike
    common = np.zeros((3, count, 4))
    curvature = np.zeros(count)  # of the surface up to a row
    *hanging, free = free_reactions(rod)
    bent = moment - free  # what the contact does, not the weight
    for k in range(int(rank.max(initial=-1)) + 1):
        rows = np.flatnonzero((rank == k) & (bent > 0) & np.isfinite(begin))
        push = bent[rows] / begin[rows]  # of a rod that is hardly bent
        guess = hanging + np.stack([-push, bent[rows] ** 2 / 2 - push * np.sin(slip.beta[rows])], axis=1)
        if k:
            rows = rows[np.isfinite(force[rows - 1, 0])]
            guess = hanging + (force[rows - 1] - hanging) * (bent[rows] / bent[rows - 1])[:, None]
            if k > 1:
                guess = 2 * force[rows - 1] - force[rows - 2]
        if not len(rows):
            break
        last = _contact(frames, rows - 1, force[rows - 1], moment[rows - 1], rod, slip.tilt[rows - 1]) if k else None

        def equations(tried: Array, rows: Index = rows, last: Pair | None = last) -> tuple[Array, Array, Array]:
            """Residuals (n, 2), their derivatives by the numbers of a row (n, 2, 4), and by those of the row before."""
            here, slopes = _contact(frames, rows, tried, moment[rows], rod, slip.tilt[rows])
            rates = np.zeros((2, len(rows), 2, 4))
            rates[0, :, 0] = slopes.beta
            if last is None:
                rates[0, :, 1] = slopes.s1
                return np.stack([here.beta - slip.beta[rows], here.s1 - begin[rows]], axis=1), rates[0], rates[1]
            way, normal = here.point - last[0].point, here.normal + last[0].normal
            for rate, sign, by in ((rates[0], 1, slopes), (rates[1], -1, last[1])):
                rate[:, 1] = np.einsum("nk,nkj->nj", way, by.normal) + sign * np.einsum("nk,nkj->nj", normal, by.point)
            return np.stack([here.beta - slip.beta[rows], (way * normal).sum(axis=1)], axis=1), rates[0], rates[1]

        here = _newton(equations, guess)
        residual, by_here, by_before = equations(here)
        at = _contact(frames, rows, here, moment[rows], rod, slip.tilt[rows])[0]
        second_sd = begin_sd[rows]
        if last is not None:
            way, turn = (np.linalg.norm(new - old, axis=1) for new, old in zip(at[2:], last[0][2:], strict=True))
            curvature[rows] = turn / np.maximum(way, np.finfo(float).tiny)
            second_sd = np.minimum(way**2 * np.abs(curvature[rows] - curvature[rows - 1]) / 6, way * turn)
            aside = ((at.point - last[0].point) * frames.normal[rows]).sum(axis=1)
            second_sd = np.hypot(second_sd, aside * slip.beta[rows] * slip.doubt[rows])
        inverse = -_inverse(by_here[:, :, :2])
        right = (np.abs(residual).max(axis=1) < 1e3 * _FOLLOWED) & (at.s1 <= 1 + 1e-9)
        right &= np.isfinite(inverse).all(axis=(1, 2))
        rows, by_here, by_before = rows[right], by_here[right], by_before[right]
        inverse, second_sd = inverse[right], second_sd[right]
        force[rows] = here[right]
        own, told = np.zeros((len(rows), 4, 2)), np.zeros((len(rows), 4, 4))
        own[:, :2], own[:, 2:] = inverse @ by_here[:, :, 2:], np.eye(2)
        told[:, :2] = inverse @ by_before
        spread = own * np.stack([np.full(len(rows), noise), noise / moment[rows]], axis=1)[:, None]
        own_covariance = spread @ spread.transpose(0, 2, 1)
        doubt = np.pad((slip.tilt * slip.doubt)[rows, None] * inverse[:, :, 0], ((0, 0), (0, 2)))
        own_covariance += doubt[:, :, None] * doubt[:, None]
        common[0, rows, :2] = -friction_angle_sd * of_friction[rows, None] * inverse[:, :, 0]
        common[2 if k else 1, rows, :2] = second_sd[:, None] * inverse[:, :, 1]
        if k:
            common[:, rows] += np.einsum("nij,enj->eni", told, common[:, rows - 1])
            own_covariance += told @ covariance[rows - 1] @ told.transpose(0, 2, 1)
        covariance[rows] = own_covariance
    return Followed(force, moment, np.zeros(count), covariance + np.einsum("eni,enj->nij", common, common))


class _Contact(NamedTuple):
    """Contacts (n,), or their derivatives by f0x, f0y, the moment and the angle of the plane, in a last axis."""

    s1: Array
    beta: Array
    point: Array
    normal: Array


def _contact(
    frames: Frames, rows: Index, force: Array, moment: Array, rod: Rod, tilt: Array
) -> tuple[_Contact, _Contact]:
    """Contacts of rows (n,) with normals out of their planes by angles (n,), and their derivatives."""
    fx, fy = force.T
    with np.errstate(all="ignore"):
        found = solve("closed-form", rod, fx, fy, moment)
        by_angle = np.pad(jacobian(fx, fy, moment, rod=rod), ((0, 0), (0, 0), (0, 1)))  # nothing but the place changes
    by_x, by_y, by_s1, by_alpha, by_beta = by_angle.swapaxes(0, 1)
    slope, by_slope = (found.alpha - found.beta)[:, None], (by_alpha - by_beta)[:, None, :]
    (across, along), out = frames.axes[rows].swapaxes(0, 1), frames.normal[rows]
    point = frames.place[rows] + found.x[:, None] * across + found.y[:, None] * along
    by_point = across[:, :, None] * by_x[:, None] + along[:, :, None] * by_y[:, None]
    normal = np.sin(slope) * across - np.cos(slope) * along
    tangent = np.cos(slope) * across + np.sin(slope) * along
    turned, by_normal = np.cos(tilt)[:, None], (np.cos(tilt)[:, None] * tangent)[:, :, None] * by_slope
    # the plane turns about the rod
    by_point[:, :, 3] += found.x[:, None] * out
    by_normal[:, :, 3] += turned * np.sin(slope) * out
    normal = turned * normal + np.sin(tilt)[:, None] * out
    return _Contact(found.s1, found.beta, point, normal), _Contact(by_s1, by_beta, by_point, by_normal)


Pair = tuple[_Contact, _Contact]


def _inverse(matrix: Array) -> Array:
    """Inverses of matrices (n, 2, 2), not finite where there is none."""
    (a, b), (c, d) = matrix.transpose(1, 2, 0)
    with np.errstate(all="ignore"):
        return np.asarray((np.array([[d, -b], [-c, a]]) / (a * d - b * c)).transpose(2, 0, 1))


def _newton(equations: Callable[[Array], tuple[Array, Array, Array]], guess: Array) -> Array:
    """Roots (n, 2) by Newton's method, whose steps are halved where they leave the rods or do not help."""
    residual, rate, _ = equations(guess)
    size = np.abs(residual).max(axis=1)
    for _ in range(_STEPS):
        if not (size > _FOLLOWED).any():
            break
        with np.errstate(all="ignore"):
            step = -(_inverse(rate[:, :, :2]) @ residual[:, :, None])[:, :, 0]
        part = np.ones(len(guess))
        for _ in range(_STEPS):
            tried = guess + part[:, None] * step
            moved, by_moved, _ = equations(tried)
            after = np.abs(moved).max(axis=1)
            worse = ~(after < size) & (size > _FOLLOWED)
            if not worse.any():
                break
            part[worse] /= 2
        better = after < size
        if not better.any():
            break
        guess, residual = np.where(better[:, None], tried, guess), np.where(better[:, None], moved, residual)
        rate, size = np.where(better[:, None, None], by_moved, rate), np.where(better, after, size)
    return guess


def complete_by_moment(
    x0: ArrayLike, m0z: ArrayLike, start: float, *, friction: float = 0.0, direction: int = -1, rod: Rod | None = None
) -> Reactions:
    """The reactions of tangential contacts (n,) that follow one another in a sweep of which only the moment was measured.

    `start` is the arc length s1 of the first contact; its error dies out along the sweep.  A wrong coefficient of friction
    does not: 0.2 that is taken for 0 costs up to 0.03 rod lengths along the contour.  `direction` and `rod` are as in
    `planar.reconstruct`.  From the first sample on that has no such contact the forces are NaN.
    Raises ValueError for a start outside of the rod, and for a coefficient that is negative.
    """
    if not (0 < start <= 1 and 0 <= friction < np.inf and direction in (-1, 1)):
        raise ValueError(
            "start must be an arc length in (0, 1], friction a number >= 0 and direction -1 or 1, got "
            f"{start!r}, {friction!r}, {direction!r}"
        )
    nothing = np.zeros_like(np.asarray(m0z, dtype=float))
    base, _, _, moments = checked_reactions(x0, nothing, nothing, m0z)
    count, side, rod = len(base), -direction, as_rod(rod)
    frames = Frames(
        np.zeros(count, dtype=np.intp),
        np.column_stack([base, np.zeros(count)]),
        np.broadcast_to(np.array([[side, 0.0], [0.0, 1.0]]), (count, 2, 2)),
        np.zeros((count, 2)),
    )
    rod = rod if side > 0 else rod.mirrored()
    force = follow(frames, side * moments, np.array([start]), friction=friction, rod=rod).force
    return Reactions(base, side * force[:, 0], force[:, 1], moments)


def touched_at(rate: ArrayLike, *, rod: Rod | None = None) -> Array:
    """Arc lengths s1 (n,) of single touches by the change of the moment m0z over a small push of the base along x.

    `rate` (n,) is that quotient in ``EI/L²``, ``s1 / (∫ (s1 - s)²/B ds + c s1²)``, the integral from the clamp to s1, of a rod
    that is hardly bent: ``3/s1²`` if it is uniform.  NaN where the contact would lie past the tip.  Noise σ of both moments is
    one of ``√2 σ s1³ / (6 dx0)`` in the place on a uniform rod.  Raises ValueError for a rod that is curved or has weight.
    """
    rod = as_rod(rod)
    if rod.curvature or rod.weight:
        raise ValueError("a single touch is located along a straight rod without weight; sweep a rod with either")
    # between so many places that of a touch is interpolated to 1e-9 rod lengths
    ends = np.union1d(np.linspace(0.0, 1.0, 8193), rod.profile.knots)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    half, s = np.diff(ends) / 2, ends[1:]
    at = ends[:-1, None] + half[:, None] * (1 + nodes)
    powers = at ** np.arange(3)[:, None, None] / rod.profile.bending_stiffness(at)
    zeroth, first, second = np.cumsum(powers @ weights * half, axis=1)
    bent = s * s * zeroth - 2 * s * first + second + rod.compliance * s * s
    # the root is linear along a uniform rod
    rates = np.abs(np.atleast_1d(np.asarray(rate, dtype=float)))
    with np.errstate(divide="ignore"):
        return np.asarray(np.interp(1 / np.sqrt(rates), np.append(0.0, np.sqrt(bent / s)), ends, right=np.nan))


def by_push(frames: Frames, moment: Array, *, noise: float = 0.0, rod: Rod | None = None) -> tuple[float, float]:
    """Arc length s1 of the first contact of a sweep in which the moment rises from the first row (n,) on, and its standard
    deviation: by the rows up to that of three times the first moment, by what a part of them would change, and by the bending.

    NaN where the contact may be at the tip, where the rod is bent from the first row on, of less than three rows, and of a
    clamp that stays.
    Raises ValueError as `touched_at`.
    """
    if len(moment) < 3:
        return np.nan, np.nan
    # the push at the begin of a sweep ends where the moment has grown so far
    last = int(np.argmax(np.append(moment >= 3.0 * moment[0], True)))
    last = min(max(last, 2), len(moment) - 1)
    rows = np.array([last, (last + 1) // 2])
    way = np.abs((frames.place[rows] - frames.place[0]) @ frames.axes[last, 0])
    if not way.all():
        return np.nan, np.nan
    rate, error = (moment[rows] - moment[0]) / way, np.sqrt(2) * noise / way[0]
    s1, part, near, far = touched_at(np.maximum([*rate, rate[0] + error, rate[0] - error], 0.0), rod=rod)
    bent = moment[[0, last]] * s1 / 2  # slope of the rod at the contact
    sd = float(np.linalg.norm([(far - near) / 2, s1 - part, s1 * bent[1] ** 2 / 4]))
    # the contact moves on during the push: a part of it tells where it began
    start = float(2 * part - s1)
    # from a slope of 0.2 rad at the contact on pushes tell wrong places, and by large steps they place a contact of the
    # tip up to 0.05 before it
    return (start, sd) if 0 < start < 0.95 - 3 * sd and bent[0] < 0.2 else (np.nan, np.nan)


def follow_pushes(
    frames: Frames, moment: Array, *, noise: float = 0.0, rod: Rod | None = None, **told: Any
) -> Followed:
    """`follow` from what `by_push` tells of the first contact of each sweep."""
    sweeps = [np.flatnonzero(frames.sweep == number) for number in np.unique(frames.sweep)]
    pushes = [by_push(rows_of(frames, rows), moment[rows], noise=noise, rod=rod) for rows in sweeps]
    start, start_sd = np.array(pushes).reshape(-1, 2).T
    return follow(frames, moment, start, rod=rod, noise=noise, start_sd=start_sd, **told)
