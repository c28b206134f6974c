"""Contacts from fewer than three reactions, where friction, the slope of the contour or contact at the tip is known instead.

Three reactions determine three unknowns, force, direction and place.  Each channel that is missing asks for one equation:
``β = ζ`` in tangential contact with known friction, ``s1 = 1`` at the tip, ``α - β = α̃`` where the contour's slope is known.
Its root is sought over all values of the missing channel.  With known friction every row is either tangential, with
``s1 <= 1``, or at the tip, with ``β <= ζ``; where both or several roots exist, the channels do not determine the contact.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from planar.arrays import BLOCK, Array, Index
from planar.inverses import solve
from planar.reactions import Reactions, checked_reactions
from planar.rods import Rod

NAMES = ("f0x", "f0y", "m0z")
# Values of the missing channel between which a root is sought, denser near zero, in EI/L² or EI/L; the largest of them bends a
# rod by more than a right angle, however it is held.
_TRIED = np.sinh(np.linspace(0.05, 7.0, 71)) / 10
# Residual of a root, in rod lengths or radians; a change of sign without it is a jump.
_ROOT = 1e-8

Residual = Callable[..., Array]


class Completed(NamedTuple):
    """Reactions (n,) of a sweep, with the channel that was not measured."""

    reactions: Reactions
    """NaN in the missing channel where no value would do, or several and it is not known which."""
    roots: Index
    """(n,) how many values of the missing channel would do."""


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
    if direction not in (-1, 1):
        raise ValueError(f"direction must be -1 or 1, the sign of the base's motion, got {direction!r}")
    columns = [np.zeros_like(np.asarray(x0, dtype=float)) if column is None else column for column in given.values()]
    reactions = checked_reactions(x0, *columns)
    missing, side = NAMES.index(absent[0]), -direction
    rod = Rod() if rod is None else rod.steady()
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

    # a moment that is not positive is that of a rod bent against the sweep
    tried = _TRIED if missing == 2 else np.concatenate([-_TRIED[::-1], _TRIED])
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

    They lie between values tried at which its sign differs, or on both sides of an extremum beyond zero.
    """
    from scipy.optimize import elementwise  # imported late, so that `import planar` stays quick

    # neighbours together, for rods under small forces are marched in few steps
    parts = np.array_split(tried, np.ceil(len(tried) * len(a) / BLOCK))
    columns = [residual(part, a[:, None], b[:, None], known[:, None]) for part in parts]
    values = np.concatenate(columns, axis=1)
    row, k = np.nonzero(values[:, :-1] * values[:, 1:] < 0)
    low, high = tried[k], tried[k + 1]

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
