"""What the rods of a sweep have passed is free: not of the body, whatever its shape, its friction and the number of contacts.

Rods move continuously from one sample to the next and never enter the body.  A point on the left of one rod and on the right of
the next one has been met by a rod in between, for else the loop of the two could be drawn together without passing it (C14).
Of the path of the tip only its ends are recorded: the area next to its chord, as far as the path may bulge, is not counted.
Across a snap nothing is known of it: such steps count for nothing, and neither do rods with a second contact, of which only the
part up to the first is known.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from planar.arrays import ROUNDING, Array, Index, Mask, checked_reactions
from planar.pieces import piece

# Places of each rod about which it is expanded, up to its contact and past it.
_BENT, _STRAIGHT = 40, 16
# Parts of the distance of two places up to which either expansion holds: those of neighbours overlap.
_REACH = 0.75
# Error of the expansions, in rod lengths; `tests/test_second_contacts.py` has the largest of many.
EXPANDED = 1e-8
SNAPPED = 5.0
"""Travel of a contact, or of the tip, in steps of the base, beyond which it has snapped."""
# Travel of a rod, in the same, that is looked at.
_TRAVEL = 1.5


class Drawn(NamedTuple):
    """Rods (n,) expanded about places (p,) along them, those of each rod in their order, and their tips."""

    row: Index
    s: Array
    reach: Array
    """(p,) up to which the expansion is used."""
    point: Array
    """(p, 2)"""
    tangent: Array
    """(p, 2)"""
    kappa: Array
    change: Array
    """(p, 2) of the curvature, before the place and after it."""
    second: Array
    """(p,) second derivative of the curvature."""
    tip: Array
    """(n, 2)"""


class Near(NamedTuple):
    """Pairs (p,) of a rod and a point next to it, sorted by rod and point."""

    row: Index
    point: Index
    s: Array
    """Arc length of the point's foot on the rod; beyond 1 past the tip."""
    off: Array
    """Distance of the point from the rod, positive on its right."""


def drawn(x0: ArrayLike, f0x: ArrayLike, f0y: ArrayLike, m0z: ArrayLike, s1: ArrayLike) -> Drawn:
    """Rods (n,) that look as if they touched at s1 (n,); NaN reactions of free ones."""
    base, across, along, moment = (column[:, None] for column in checked_reactions(x0, f0x, f0y, m0z))
    end = np.minimum(np.nan_to_num(np.asarray(s1, dtype=float), nan=1.0), 1.0)[:, None]
    fx, fy, kappa = (np.where(np.isnan(moment), 0.0, -column) for column in (across, along, moment))
    bent, straight = np.linspace(0, 1, _BENT), np.arange(1, _STRAIGHT + 1) / _STRAIGHT
    s = np.concatenate([end * bent, end + (1 - end) * straight], axis=1)
    shape = piece(fx, fy, np.full(kappa.shape, np.pi / 2), kappa, np.minimum(s, end))
    tangent, past = np.stack([np.cos(shape.phi), np.sin(shape.phi)], axis=2), s - np.minimum(s, end)
    point = np.stack([base + shape.x, shape.y], axis=2) + past[..., None] * tangent
    number = np.arange(_BENT + _STRAIGHT)
    bends = number < _BENT - 1
    kappa = np.where(bends, shape.kappa, 0.0)
    change, second = fx * tangent[..., 1] - fy * tangent[..., 0], kappa * (fx * tangent[..., 0] + fy * tangent[..., 1])
    change = np.stack([np.where(number < _BENT, change, 0.0), np.where(bends, change, 0.0)], axis=2)
    reach = _REACH * np.where(bends, end / (_BENT - 1), np.maximum(end / (_BENT - 1), (1 - end) / _STRAIGHT))
    # of short straight parts only every so many places, as far apart as those before
    every = np.maximum(end * _STRAIGHT / ((_BENT - 1) * np.maximum(1 - end, ROUNDING)), 1).astype(int)
    used = np.flatnonzero((number < _BENT) | ((past > 0) & (number[::-1] % every == 0)))

    def flat(column: Array) -> Array:
        return np.asarray(column.reshape(-1, *column.shape[2:])[used])

    row = np.broadcast_to(np.arange(len(base))[:, None], s.shape).ravel()[used]
    bend = flat(kappa), flat(change), flat(second)
    return Drawn(row, flat(s), flat(reach), flat(point), flat(tangent), *bend, point[:, -1])


def near(rods: Drawn, points: Array, within: float) -> Near:
    """The points (k, 2) within a distance of the rods."""
    trees = [scipy.spatial.cKDTree(places) for places in (points, rods.point)]
    # what a rod turns by within its reach moves the foot's normal along, and the rod aside
    turned = rods.reach * np.abs(rods.kappa) + rods.reach**2 * (np.abs(rods.change).max(axis=1) + np.abs(rods.second))
    most = np.stack([rods.reach + within * turned, within + rods.reach * turned])
    far = float(np.hypot(*most).max(initial=0.0))
    pairs = trees[0].sparse_distance_matrix(trees[1], far, output_type="ndarray")
    point, node = pairs["i"], pairs["j"]
    offset = np.take(points, point, axis=0) - np.take(rods.point, node, axis=0)
    cos, sin = np.take(rods.tangent, node, axis=0).T
    ahead, left = offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin
    likely = (np.abs(ahead) <= np.take(most[0], node)) & (np.abs(left) <= np.take(most[1], node))
    point, node, ahead, left = (column[likely] for column in (point, node, ahead, left))
    kappa, second, reach, u = rods.kappa[node], rods.second[node], rods.reach[node], ahead
    square = kappa * kappa
    for _ in range(2):  # towards the foot, on the series of place and slope in u
        change = rods.change[node, (u > 0).astype(np.intp)]
        turn = u * (kappa + u * (change / 2 + u * second / 6))
        beyond = ahead - u + u * u * u * (square / 6 + kappa * change * u / 8)
        aside = left - u * u * (kappa / 2 + u * (change / 6 + u * (second - square * kappa) / 24))
        cos, sin = np.cos(turn), np.sin(turn)
        u, off = u + beyond * cos + aside * sin, beyond * sin - aside * cos
    close = np.flatnonzero((np.abs(u) <= reach) & (np.abs(off) <= within))
    # of each pair the nearest expansion
    pair = rods.row[node[close]] * len(points) + point[close]
    order = np.lexsort((np.abs(u[close]), pair))
    order = order[np.diff(pair[order], prepend=-1) != 0]
    row, point = np.divmod(pair[order], len(points))
    return Near(row, point, rods.s[node[close[order]]] + u[close[order]], off[close[order]])


def passed(
    x0: ArrayLike,
    f0x: ArrayLike,
    f0y: ArrayLike,
    m0z: ArrayLike,
    s1: ArrayLike,
    points: ArrayLike,
    *,
    single: Mask,
    error: ArrayLike = 0.0,
    point_error: ArrayLike = 0.0,
) -> tuple[Index, Index]:
    """Pairs (p,) of a rod of one sweep in -x and a point that was passed on the way to it from the rod before.

    x0, f0x, f0y, m0z
        (n,) in the order of the sweep; NaN reactions of free rods.
    s1
        (n,) where the rods look as if they touched, as `planar.reconstruct` has it.
    points
        (k, 2) in the frame of the sweep.
    single
        (n,) whether a rod is known to touch at one place only, or nowhere.
    error, point_error
        (n,) and (k,), in rod lengths, within which rods and points are known.
    """
    base, points = np.asarray(x0, dtype=float), np.asarray(points, dtype=float)
    if len(base) < 2 or not len(points):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    rods = drawn(x0, f0x, f0y, m0z, s1)
    found = near(rods, points, _TRAVEL * float(np.median(-np.diff(base))))
    known = np.broadcast_to(error, base.shape)[found.row] + np.broadcast_to(point_error, points.shape[:1])[found.point]
    known = np.maximum(known, EXPANDED)
    counts = np.asarray(single)[found.row] & (found.s <= 1)
    # of each point the last rod before that had it on the left
    order = np.lexsort((found.row, found.point))
    left = np.where((counts & (found.off <= known))[order], np.arange(len(order)), -1)
    before = order[np.maximum.accumulate(left)]
    met = np.empty(len(order), dtype=np.intp)
    met[order] = before
    passes = counts & (found.off > known) & (found.point[met] == found.point) & (found.row[met] < found.row)
    row, point, known, before = (column[passes] for column in (found.row, found.point, known, found.row[met]))
    chord = rods.tip[row] - rods.tip[before]
    travel = np.hypot(*chord.T)
    # a path that turns once in a step leaves its chord by half of the second differences; smooth travel by an eighth
    second = np.zeros(len(base) + 1)
    second[1:-2] = np.hypot(*np.diff(rods.tip, 2, axis=0).T)
    bulge = np.where(before == row - 1, np.maximum(second[row], second[before]) / 2, travel)
    offset = points[point] - rods.tip[before]
    share = np.clip((offset * chord).sum(axis=1) / np.maximum(travel, np.finfo(float).tiny) ** 2, 0, 1)
    away = np.hypot(*(offset - share[:, None] * chord).T)
    kept = (travel <= SNAPPED * (base[before] - base[row])) & (away > bulge + known)
    return row[kept], point[kept]
