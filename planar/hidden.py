"""Contacts that the reactions give although the rod touches at a second place: what reveals them.

Of a rod with two contacts the closed form continues the first piece past its contact to where the moment would vanish (C10): a
place that is neither, up to a fifth of the rod's length away.  What reveals it:

- A single contact satisfies ``s1 = 1`` or ``β = ζ``.  With two that slip alike ``sin β = sin ζ Σλ / |ΣF| >= sin ζ`` (C11), with
  equality only for parallel forces.
- Tangential contacts move along the rod, whatever the friction: the chord from one sample to the next has a direction between
  their slopes, or no length, at a corner.
- No contact lies inside what other sweeps have passed (`passed`).
- A rod that rests on both sides of a hollow passes the two places, which other rods have touched alone (`bridging`).

What the rods of a sweep have passed is free: not of the body, whatever its shape, its friction and the number of contacts.
Rods move continuously from one sample to the next and never enter the body.  A point on the left of one rod and on the right of
the next one has been met by a rod in between, for else the loop of the two could be drawn together without passing it (C14).
Of the path of the tip only its ends are recorded: the area next to its chord, as far as the path may bulge, is not counted.
Across a snap nothing is known of it: such steps count for nothing, and neither do rods with a second contact, of which only the
part up to the first is known.

**Premise.** Without friction two tangential contacts look exactly like one, ``β = 0`` and ``s1 < 1``, in every single sample:
what neither the path nor other sweeps contradict stays hidden.  With friction the first test needs the coefficient, known, or
constant and then told by the bulk of the tangential contacts.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from planar.arrays import BLOCK, ROUNDING, Array, Index, Mask, checked_reactions, ratio
from planar.elastica import piece
from planar.reconstruction import Contacts, Errors, reconstruct
from planar.reconstruction import errors as errors_of
from planar.rods import PLACES, Rod
from planar.sweeping import Phase

# Friction angle, in radians, up to which contacts agree on theirs, and standard deviations of a test on noisy contacts.
_AGREES, _DEVIATIONS = 1e-6, 5.0
# Chord, in rod lengths, below which a contact has not moved.
_SAME_PLACE = 1e-6


def constant_friction_angle(contacts: Contacts, errors: Errors | None = None) -> float:
    """The friction angle ζ that the bulk of the tangential contacts has, in radians; NaN where no half of them agree.

    `errors` are those of the contacts under noise.
    """
    tangential = contacts.phase == Phase.TANGENTIAL
    beta = contacts.friction_angle_bound[tangential]
    spread = np.full(len(beta), _AGREES) if errors is None else np.maximum(errors.friction_angle[tangential], _AGREES)
    known = np.isfinite(beta + spread)
    beta, spread = beta[known], spread[known]
    if not len(beta):
        return np.nan
    # second contacts lie above, so that the bulk's middle is the median of the lower three quarters of the most certain
    order = np.argsort(spread)[: max(len(spread) // 2, 1)]
    lower = np.sort(beta[order])[: max(int(0.75 * len(order)), 1)]
    angle = float(np.median(lower))
    agrees = np.abs(beta - angle) <= 3 * spread
    return angle if agrees.mean() > 0.5 else np.nan


def second_contacts(
    x0: ArrayLike,
    f0x: ArrayLike,
    f0y: ArrayLike,
    m0z: ArrayLike,
    *,
    contacts: Contacts | None = None,
    friction: ArrayLike | None = None,
    errors: Errors | None = None,
    direction: int = -1,
    rod: Rod | None = None,
) -> Mask:
    """Contacts (n,) of one sweep that can't be those of rods which touch at one place only.

    x0, f0x, f0y, m0z
        base positions and support reactions (n,) in the order of the sweep, as `planar.reconstruct` takes them.
    contacts
        what `planar.reconstruct` makes of them, where that is known already.
    friction
        the coefficient, one number or (n,); None: `constant_friction_angle`, and no test by it where that is unknown.
    errors
        standard deviations of the contacts under noise; None: exact, up to the steps in which `rod` is integrated.
    direction, rod
        as in `planar.reconstruct`.
    """
    if contacts is None:
        contacts = reconstruct(x0, f0x, f0y, m0z, direction=direction, rod=rod)
    if errors is None and rod is not None and not rod.is_straight_and_uniform:
        errors = errors_of(f0x, f0y, m0z, noise=(PLACES, PLACES), direction=direction, rod=rod)
    beta_error = np.zeros(len(contacts)) if errors is None else errors.friction_angle
    tangential = contacts.phase == Phase.TANGENTIAL
    zeta = (
        constant_friction_angle(contacts, errors) if friction is None else np.arctan(np.asarray(friction, dtype=float))
    )
    with np.errstate(invalid="ignore"):
        off = contacts.friction_angle_bound - zeta
        # rounding changed none of 6,000 exact friction angles by 1e-13
        allowed = np.maximum(_DEVIATIONS * beta_error, 1e-11)
        # a tip contact has less
        found = (tangential & (np.abs(off) > allowed)) | ((contacts.phase == Phase.TIP) & (off > allowed))
        # a step that leaves the rod's line is explained by an end that is known to be wrong
        found |= _off_path(np.asarray(x0, dtype=float), contacts, tangential & ~found, errors)
    return np.asarray(found)


def _steps(point: Array, slope: Array, rows: int = 1) -> tuple[Array, Array, Array]:
    """Of the steps (n - rows,) between places (n, 2) with slopes (n,): length, turn, and angle from the mean slope."""
    chord = point[rows:] - point[:-rows]
    angle = np.arctan2(chord[:, 1], chord[:, 0]) - (slope[rows:] + slope[:-rows]) / 2
    off = np.abs(np.remainder(angle + np.pi / 2, np.pi) - np.pi / 2)
    return np.hypot(*chord.T), slope[rows:] - slope[:-rows], off


def _off_path(x0: Array, contacts: Contacts, tangential: Mask, errors: Errors | None) -> Mask:
    """Both ends of steps in which a tangential contact left the line of the rod, and contacts beside their neighbours' line.

    A snap leaves the line as well, but the row after it doesn't lead back to it.
    """

    def steps(rows: int, share: float) -> tuple[Mask, Array, Array, Array]:
        length, turn, angle = _steps(contacts.point, contacts.slope, rows)
        # with exact contacts of four bodies no single contact of 15,489 was beyond 0.6 of the turn and 2 mrad, for
        # pieces of other curvature
        allowed = share * np.abs(turn) + 2e-3
        if errors is not None:  # of the two ends, each by its place across the line and its slope, at worst together
            slope = (contacts.slope[rows:] + contacts.slope[:-rows]) / 2
            normal = np.stack([-np.sin(slope), np.cos(slope)], axis=1)
            across = [
                np.einsum("ni,nij,nj->n", normal, end, normal) for end in (errors.point[rows:], errors.point[:-rows])
            ]
            ends = ratio(np.sqrt(across), length) + np.stack([errors.slope[rows:], errors.slope[:-rows]]) / 2
            allowed = allowed + _DEVIATIONS * np.hypot(*ends)
        return tangential[rows:] & tangential[:-rows], length, angle, allowed

    both, length, angle, allowed = steps(1, 0.6)
    off = np.where(both & (length > _SAME_PLACE) & (angle > allowed), angle, 0.0)
    wrong = (off > 0) & (length < SNAPPED * np.abs(np.diff(x0)))
    found = np.zeros(len(contacts), dtype=bool)
    found[1:] |= wrong
    found[:-1] |= wrong
    around, _, angle, allowed = steps(2, 0.0)
    found[1:-1] |= around & (angle <= allowed) & (allowed < np.maximum(off[1:], off[:-1]))
    return found


# Places of each rod about which it is expanded, up to its contact and past it.
_BENT, _STRAIGHT = 40, 16
# Error of the expansions, in rod lengths; `tests/test_second_contacts.py` has the largest of many.
EXPANDED = 1e-8
# Distance from a rod, in rod lengths, of places that it may touch within its errors.
_ACROSS = 0.01
SNAPPED = 5.0
"""Travel of a contact, or of the tip, in steps of the base, beyond which it has snapped."""


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
    # of the distance of two places more than half, so that the expansions of neighbours overlap
    reach = 0.75 * np.where(bends, end / (_BENT - 1), np.maximum(end / (_BENT - 1), (1 - end) / _STRAIGHT))
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
    # what a rod turns by within its reach moves the foot's normal along, and the rod aside
    turned = rods.reach * np.abs(rods.kappa) + rods.reach**2 * (np.abs(rods.change).max(axis=1) + np.abs(rods.second))
    most = np.stack([rods.reach + within * turned, within + rods.reach * turned])
    far = np.hypot(*most)
    # those that reach as far together, so that few points are looked at in vain, and not all in the memory at once
    blocks, tree = np.array_split(np.argsort(far), len(far) // BLOCK + 1), scipy.spatial.cKDTree(points)
    found = [
        _near_places(rods, points, tree, nodes, most, float(far[nodes].max(initial=0.0)), within) for nodes in blocks
    ]
    point, node, u, off = (np.concatenate(column) for column in zip(*found, strict=True))
    # of each pair the nearest expansion
    pair = rods.row[node] * len(points) + point
    order = np.lexsort((node, np.abs(u), pair))
    order = order[np.diff(pair[order], prepend=-1) != 0]
    row, point = np.divmod(pair[order], len(points))
    return Near(row, point, rods.s[node[order]] + u[order], off[order])


def _near_places(
    rods: Drawn, points: Array, tree: Any, nodes: Index, most: Array, far: float, within: float
) -> tuple[Index, Index, Array, Array]:
    """Pairs (p,) of a point, which are in a tree, and one of some places of rods whose expansion comes within a distance of it,
    with the way along the rod from the place, and the distance.

    Along and across the rod (2, n) at `most` so far from a place, and at most `far`.
    """
    pairs = tree.sparse_distance_matrix(scipy.spatial.cKDTree(rods.point[nodes]), far, output_type="ndarray")
    point, node = pairs["i"], nodes[pairs["j"]]
    offset = np.take(points, point, axis=0) - np.take(rods.point, node, axis=0)
    cos, sin = np.take(rods.tangent, node, axis=0).T
    ahead, left = offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin
    likely = (np.abs(ahead) <= np.take(most[0], node)) & (np.abs(left) <= np.take(most[1], node))
    point, node, ahead, left = (column[likely] for column in (point, node, ahead, left))
    kappa, second, reach, u = rods.kappa[node], rods.second[node], rods.reach[node], ahead
    square, off = kappa * kappa, left
    for _ in range(2):  # towards the foot, on the series of place and slope in u
        change = rods.change[node, (u > 0).astype(np.intp)]
        turn = u * (kappa + u * (change / 2 + u * second / 6))
        beyond = ahead - u + u * u * u * (square / 6 + kappa * change * u / 8)
        aside = left - u * u * (kappa / 2 + u * (change / 6 + u * (second - square * kappa) / 24))
        cos, sin = np.cos(turn), np.sin(turn)
        u, off = u + beyond * cos + aside * sin, beyond * sin - aside * cos
    close = np.flatnonzero((np.abs(u) <= reach) & (np.abs(off) <= within))
    return point[close], node[close], u[close], off[close]


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
    found = near(rods, points, 1.5 * float(np.median(-np.diff(base))))
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


def bridging(
    x0: ArrayLike,
    f0x: ArrayLike,
    f0y: ArrayLike,
    m0z: ArrayLike,
    contacts: Contacts,
    points: ArrayLike,
    *,
    errors: Errors,
    covariance: ArrayLike,
) -> Mask:
    """Whether rods (n,) may touch at two of the points (k, 2), on either side of the place where they seem to touch at one.

    A rod that rests on both sides of a hollow seems to touch over it, with the friction of a single contact up to 1e-7.  It
    passes both places within the errors across it, and no contact confirms the one between them.  A rod that touches a convex
    contour leaves it on both sides.

    contacts, errors
        (n,) of the rods, and their standard deviations.
    covariance
        (k, 2, 2) of the points.
    """
    base, points, covariance = (np.asarray(column, dtype=float) for column in (x0, points, covariance))
    found = np.zeros(len(base), dtype=bool)
    own = np.sqrt(np.trace(errors.point, axis1=1, axis2=2))
    known = np.isfinite(own) & np.isfinite(contacts.s1) & np.isfinite(errors.slope)
    rods, places = np.flatnonzero(known), np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)))
    if not len(rods) or not len(places):
        return found
    shape = drawn(*(np.asarray(column, dtype=float)[rods] for column in (x0, f0x, f0y, m0z, contacts.s1)))
    pairs = near(shape, points[places], _ACROSS)
    row, point = rods[pairs.row], places[pairs.point]
    ahead = pairs.s - contacts.s1[row]
    slope = contacts.slope[row]

    def sd(along: Array) -> Array:
        """Of the pairs' places and contacts in a direction (p, 2)."""
        both = covariance[point] + errors.point[row]
        return np.sqrt(np.maximum(np.einsum("pi,pij,pj->p", along, both, along), 0.0))

    normal, tangent = (
        np.stack([-np.sin(slope), np.cos(slope)], axis=1),
        np.stack([np.cos(slope), np.sin(slope)], axis=1),
    )
    allowed = _DEVIATIONS * np.hypot(sd(normal), errors.slope[row] * ahead) + EXPANDED
    on = (np.abs(pairs.off) <= allowed) & (pairs.s <= 1)
    same = np.abs(ahead) <= _DEVIATIONS * sd(tangent) + EXPANDED
    sides = np.zeros((2, len(base)), dtype=bool)
    for side, chosen in enumerate((on & ~same & (ahead < 0), on & ~same & (ahead > 0))):
        sides[side, row[chosen]] = True
    # each rod has its own contact among the places
    confirmed = np.bincount(row[on & same], minlength=len(base)) > 1
    return np.asarray(sides[0] & sides[1] & ~confirmed)
