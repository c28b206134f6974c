"""Where a rod comes to rest after a snap: a chain of rigid links that moves down to the next equilibrium.

The chain's energy is ``½ (φ - π/2)ᵀ H (φ - π/2)`` in the angles of its links, so that it is inextensible and clamped by
construction.  Each damped step goes towards the equilibrium of the linearised problem, whose contact forces are those of the
linear complementarity problem ``0 <= λ ⟂ g/η + J d >= 0``.  Without friction the steps end only in equilibria that are stable
on the cone of motions that the contacts leave; with friction that is an assumption, and so is that the rod slips during a
snap as it does in the sweep: the motion of a snap is dynamic, outside of the model.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planar.arrays import Array, Index, Mask
from planar.loops import Nearest, Outlines, Place

LINKS = 80
# Points on each link that must stay outside, so that corners do not pass between them.
_PER_LINK = 3
# Damping of a step and its largest turn of a link, in radians.
_DAMPING, _TURN = 0.35, 0.03
_STEPS, _PATIENCE = 600, 150
# Share of a corner's turn from either side's normal at which the other side holds the tip as well.
_APART = 1e-6
# Gap, in rod lengths, from which on a point does not take part in a step.
_CLEAR = 0.05


class Settled(NamedTuple):
    """A chain and the points at which it is pressed."""

    angles: Array
    """(LINKS,)"""
    at_rest: bool
    s: Array
    """(c,) arc lengths of its contacts."""
    piece: Index
    u: Array
    force: Array
    tip: Mask


def _stiffness() -> Array:
    length = 1 / LINKS
    matrix = np.zeros((LINKS, LINKS))
    matrix[0, 0] = 2 / length  # half a link from the clamp to the first one's middle
    k = np.arange(1, LINKS)
    matrix[k, k] += 1 / length
    matrix[k - 1, k - 1] += 1 / length
    matrix[k, k - 1] = matrix[k - 1, k] = -1 / length
    return matrix


_COMPLIANCE = np.linalg.inv(_stiffness())
_S = (np.arange(LINKS * _PER_LINK) + 1) / (LINKS * _PER_LINK)
# share of each link's length before each point
_WEIGHT = np.clip(_S[:, None] * LINKS - np.arange(LINKS), 0, 1) / LINKS


def points(x0: float, angles: Array) -> Array:
    """Points (LINKS * 3, 2) of a chain."""
    return np.stack([x0 + _WEIGHT @ np.cos(angles), _WEIGHT @ np.sin(angles)], axis=1)


def settle(outlines: Outlines, body: int, x0: float, angles: Array, friction_angle: float) -> Settled:
    """The chain at a base position, let go from the angles (LINKS,) of its links."""
    mu, angles = np.tan(friction_angle), angles.copy()
    d = np.zeros(LINKS)
    active = np.zeros(0, dtype=np.intp)
    for step in range(_STEPS):
        # chains that go to and fro between two contacts come to rest with smaller steps
        damping = _DAMPING / (1 + step // _PATIENCE)
        place = points(x0, angles)
        near = outlines.nearest(np.full(len(place), body, dtype=np.intp), place, _CLEAR)
        close = np.flatnonzero(near.gap < _CLEAR)
        gap, normal, row = near.gap[close], near.normal[close], close
        # the tip in a corner: both sides hold it
        corner, place_of = _concave_corners(outlines, near, place[-1])
        normals = np.stack([np.sin(place_of.tau), -np.cos(place_of.tau)], axis=1)
        gap = np.append(gap, ((place[-1] - place_of.point) * normals).sum(axis=1))
        normal, row = np.concatenate([normal, normals]), np.append(row, np.full(len(corner), len(_S) - 1))
        along = np.stack([-np.sin(angles), np.cos(angles)])  # of each link, by its angle
        jacobian = (normal[:, :1] * along[0] + normal[:, 1:] * along[1]) * _WEIGHT[row]
        tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
        slip = (tangent[:, :1] * along[0] + tangent[:, 1:] * along[1]) * _WEIGHT[row]
        carried = _COMPLIANCE @ (jacobian + mu * slip).T
        straighten = np.pi / 2 - angles
        force, active = _complementary(jacobian @ carried, gap / damping + jacobian @ straighten, row, active)
        d = straighten + carried @ force
        largest = float(np.abs(d).max())
        if largest < 3e-7:  # at rest, closely enough for Newton's method
            break
        angles += min(damping, _TURN / largest) * d
    pressed = force > 1e-9 * max(1.0, float(force.max(initial=0.0)))
    row, force, piece, u = row[pressed], force[pressed], near.piece, near.u
    pushed = force[row == len(_S) - 1] @ normal[pressed][row == len(_S) - 1]
    for k, tau in zip(corner[::2], place_of.tau[::2], strict=True):
        turned = np.arctan2(pushed[0], -pushed[1]) - tau
        share = (np.remainder(turned + np.pi, 2 * np.pi) - np.pi) / outlines.turn[k]
        if pushed.any() and _APART < share < 1 - _APART:  # held by both sides, it is wedged
            piece[-1], u[-1] = k, share
    return _clusters(piece, u, row, force, angles, rest=largest < 1e-4)


def _concave_corners(outlines: Outlines, near: Nearest, tip: Array) -> tuple[Index, Place]:
    """The concave vertices at the ends of the edge next to the tip, each twice, and the outline on either side of it."""
    ends = np.array([outlines.previous[near.piece[-1]], outlines.following[near.piece[-1]]])
    ends = ends[outlines.is_vertex[ends] & (outlines.turn[ends] < 0) & (near.gap[-1] < _CLEAR)]
    ends = ends[np.hypot(*(outlines.at(ends, np.zeros(len(ends))).point - tip).T) < _CLEAR]
    twice = np.repeat(ends, 2)
    return twice, outlines.at(twice, np.tile([0.0, 1.0], len(ends)))


def _complementary(matrix: Array, constant: Array, row: Index, start: Index) -> tuple[Array, Index]:
    """``0 <= λ ⟂ M λ + b >= 0`` by principal pivoting, from the rows of the chain that were active before; the active rows."""
    n = len(constant)
    force = np.zeros(n)
    if not n:
        return force, row
    # with rigid contacts neighbouring points that are pressed alike would have no single answer
    matrix = matrix + np.diag(np.full(n, 1e-8 * np.abs(matrix.diagonal()).max() + 1e-15))
    active = np.isin(row, start)
    # with friction there need not be an answer
    for trial in range(2 * n):
        force = np.zeros(n)
        rows = np.flatnonzero(active)
        force[rows] = np.linalg.solve(matrix[np.ix_(rows, rows)], -constant[rows])
        wrong = np.where(active, np.maximum(-force, 0) * matrix.diagonal(), np.maximum(-(matrix @ force + constant), 0))
        if not (wrong > 1e-12).any():
            break
        # the worst first; should that go round in circles, the first
        worst = int(np.argmax(wrong)) if trial < n else int(np.argmax(wrong > 1e-12))
        active[worst] = ~active[worst]
    return np.maximum(force, 0.0), row[active]


def _clusters(piece: Index, u: Array, row: Index, force: Array, angles: Array, rest: bool) -> Settled:
    """Neighbouring points that are pressed make one contact."""
    order = np.argsort(row, kind="stable")
    row, force = row[order], force[order]
    label = np.cumsum(np.diff(row, prepend=row[:1]) > 3 * _PER_LINK) if len(row) else row
    count = int(label[-1]) + 1 if len(row) else 0
    whole = np.bincount(label, weights=force, minlength=count).astype(float)
    s = np.bincount(label, weights=force * _S[row], minlength=count) / np.maximum(whole, np.finfo(float).tiny)
    at_tip = np.bincount(label, weights=force * (row == len(_S) - 1), minlength=count)
    tip = at_tip > 0.5 * whole
    s = np.where(tip, 1.0, s)
    nearest = np.clip(np.round(s * len(_S)).astype(np.intp) - 1, 0, len(_S) - 1)
    return Settled(angles, rest, s, piece[nearest], u[nearest], whole, tip)
