"""Rods with several contacts: their equations, solved by Newton's method, and their shapes.

A contact has its place ``u`` on the outline, its arc length ``s`` along the rod, its size ``λ >= 0`` and the angle ``ζ`` of its
force to the normal, ``F = λ (sin(τ + ζ), -cos(τ + ζ))`` (C1): the friction angle where the rod slips along ``-t``, its negative
along ``t``, and an unknown between them where it sticks.  Between contacts the rod is a piece of elastica (`planar.elastica`)
under ``N(s)``, the sum of the forces past ``s`` (C2).  With ``κ0`` the unknowns of a rod are as many as its equations:

    interior contact: ``r(s) = c(u)``, ``φ(s) = τ(u)`` (C6), or ``τ(u) + π`` where the body is on the rod's right,
    tip: ``r(1) = c(u)``, ``s = 1`` (C7),    ``κ = 0`` at the last contact, past which the rod is straight.

A corner under the rod, the tip on a corner and the tip wedged in a concave one are all contacts on a vertex, whose point
is fixed and whose ``τ`` turns.

After a snap a rod comes to rest as a chain of rigid links that moves down to the next equilibrium.  The chain's energy is
``½ (φ - π/2)ᵀ H (φ - π/2)`` in the angles of its links, so that it is inextensible and clamped by construction.  Each damped
step goes towards the equilibrium of the linearised problem, whose contact forces are those of the linear complementarity
problem ``0 <= λ ⟂ g/η + J d >= 0``.  Without friction the steps end only in equilibria that are stable on the cone of motions
that the contacts leave; with friction that is an assumption, and so is that the rod slips during a snap as it does in the
sweep: the motion of a snap is dynamic, outside of the model.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from planar.arrays import Array, Index, Mask
from planar.contours import Nearest, Outlines, Place
from planar.elastica import End, piece

# Contacts of one rod, at most: with more it is reported as not resolved.
MOST = 3
# Largest changes in one iteration: of a place, in rod lengths, and of a slope.
_FARTHEST, _STEEPEST = 0.2, 0.5


@dataclass
class Rods:
    """Rods (m,) with contacts (m, MOST) in the order of their arc length; unused columns have no force and ``s = 2``."""

    x0: Array
    kappa: Array
    count: Index
    force: Array
    s: Array
    piece: Index
    u: Array
    zeta: Array
    """Signed angle of the force to the normal."""
    side: Array
    """1 where the body is on the rod's left, -1 on its right."""
    tip: Mask
    sticks: Mask

    def rows(self, rows: Index | Mask) -> Rods:
        return Rods(*(getattr(self, column.name)[rows] for column in fields(self)))

    def put(self, rows: Index | Mask, others: Rods) -> None:
        for column in fields(self):
            getattr(self, column.name)[rows] = getattr(others, column.name)

    def drop(self, row: int, slot: int) -> None:
        """Take a contact away."""
        for column in fields(self)[3:]:
            values = getattr(self, column.name)[row]
            values[slot:-1] = values[slot + 1 :].copy()
        self.count[row] -= 1
        self.force[row, self.count[row]], self.s[row, self.count[row]] = 0.0, 2.0
        self.tip[row, self.count[row]] = self.sticks[row, self.count[row]] = False

    def add(self, row: int, force: float, s: float, piece: int, u: float, zeta: float, side: float, tip: bool) -> None:
        """A further contact, in its place along the rod; there must be room for it."""
        slot = int(np.searchsorted(self.s[row, : self.count[row]], s))
        for column, value in zip(fields(self)[3:], (force, s, piece, u, zeta, side, tip, False), strict=True):
            values = getattr(self, column.name)[row]
            values[slot + 1 :] = values[slot:-1].copy()
            values[slot] = value
        self.count[row] += 1


def free_rods(x0: Array) -> Rods:
    """Straight rods at base positions (m,)."""
    m = len(x0)
    (force, u, zeta), (tip, sticks) = np.zeros((3, m, MOST)), np.zeros((2, m, MOST), dtype=bool)
    piece = np.zeros((m, MOST), dtype=np.intp)
    return Rods(
        x0.astype(float), np.zeros(m), np.zeros(m, np.intp), force, force + 2, piece, u, zeta, force + 1, tip, sticks
    )


def _forces(tau: Array, force: Array, zeta: Array) -> tuple[Array, Array]:
    """Internal forces (m, k) of the pieces that end at the contacts."""
    across, along = force * np.sin(tau + zeta), -force * np.cos(tau + zeta)
    return np.cumsum(across[:, ::-1], axis=1)[:, ::-1], np.cumsum(along[:, ::-1], axis=1)[:, ::-1]


def _march(x0: Array, kappa: Array, s: Array, across: Array, along: Array) -> End:
    """Rods (m,) at their contacts: (m, k)."""
    m, k = s.shape
    here, start = End(x0, np.zeros(m), np.full(m, np.pi / 2), kappa), np.zeros(m)
    ends: list[End] = []
    for j in range(k):
        end = piece(across[:, j], along[:, j], here.phi, here.kappa, s[:, j] - start)
        here, start = End(here.x + end.x, here.y + end.y, end.phi, end.kappa), s[:, j]
        ends.append(here)
    return End(*(np.stack(column, axis=1) for column in zip(*ends, strict=True)))


def _places(outlines: Outlines, rods: Rods, s: Array, last: Array) -> Array:
    """The unknown u (m, k) of contacts that slip; of a rod that rolls the arc on the outline is that on the rod."""
    if not rods.sticks.any():
        return last
    speed = np.hypot(*outlines.at(rods.piece.ravel(), rods.u.ravel()).derivative.T).reshape(s.shape)
    rolls = rods.sticks & ~rods.tip & (speed > 0)
    rolled = rods.u + np.where(rolls, rods.side * (s - rods.s) / np.where(speed > 0, speed, 1.0), 0.0)
    return np.asarray(np.where(rods.sticks, rolled, last))


def residuals(outlines: Outlines, rods: Rods, z: Array) -> Array:
    """What is left of the equations (m, 1 + 3k) of rods with k contacts each, with the unknowns z: κ0, λ, s, and u or ζ."""
    m, k = rods.s.shape
    kappa, force, s, last = z[:, 0], z[:, 1 : 1 + k], z[:, 1 + k : 1 + 2 * k], z[:, 1 + 2 * k :]
    u, zeta = _places(outlines, rods, s, last), np.where(rods.sticks, last, rods.zeta)
    place = outlines.at(rods.piece.ravel(), u.ravel())
    tau = place.tau.reshape(m, k)
    marched = _march(rods.x0, kappa, s, *_forces(tau, force, zeta))
    left = np.empty_like(z)
    left[:, 0] = marched.kappa[:, -1]
    left[:, 1 : 1 + k] = marched.x - place.point[:, 0].reshape(m, k)
    left[:, 1 + k : 1 + 2 * k] = marched.y - place.point[:, 1].reshape(m, k)
    turned = marched.phi - tau - np.where(rods.side < 0, np.pi, 0.0)
    left[:, 1 + 2 * k :] = np.where(rods.tip, s - 1, np.remainder(turned + np.pi, 2 * np.pi) - np.pi)
    return left


def solve(outlines: Outlines, rods: Rods) -> Mask:
    """Correct rods by Newton's method until they are in equilibrium with the contacts that they have; where that succeeded."""
    found = np.asarray(rods.count == 0)
    rods.kappa[found] = 0.0
    for k in range(1, MOST + 1):
        rows = np.flatnonzero(rods.count == k)
        if len(rows):
            part = rods.rows(rows)
            for column in fields(part)[3:]:
                setattr(part, column.name, getattr(part, column.name)[:, :k])
            found[rows] = _newton(outlines, part)
            for column in fields(part)[3:]:
                getattr(rods, column.name)[rows, :k] = getattr(part, column.name)
            rods.kappa[rows] = part.kappa
    return found


def _newton(outlines: Outlines, rods: Rods) -> Mask:
    m, k = rods.s.shape
    d = 1 + 3 * k
    z = np.concatenate([rods.kappa[:, None], rods.force, rods.s, np.where(rods.sticks, rods.zeta, rods.u)], axis=1)
    found, best = np.zeros(m, dtype=bool), np.full(m, np.inf)
    rows = np.arange(m)
    for iteration in range(16):
        part, here = rods.rows(rows), z[rows]
        step = 1e-7 * np.maximum(1.0, np.abs(here))
        varied = np.repeat(here[:, None], d + 1, axis=1)
        varied[:, np.arange(1, d + 1), np.arange(d)] += step
        values = residuals(outlines, part.rows(np.repeat(np.arange(len(rows)), d + 1)), varied.reshape(-1, d))
        values = values.reshape(len(rows), d + 1, d)
        value, slopes = values[:, 0], (values[:, 1:] - values[:, :1]).transpose(0, 2, 1) / step[:, None]
        size = np.abs(value).max(axis=1)
        # places beyond the ends of their pieces, which at the solution are on the next ones
        off = np.abs(here[:, 1 + 2 * k :] - 0.5) * (~part.sticks & ~outlines.is_closed[part.piece])
        # off by more than a piece from its middle, or beyond its end when nearly solved
        passes = (off > 1.5) | ((off > 0.5) & ((size < 1e-4) & (here[:, 1 : 1 + k] >= 0).all(axis=1))[:, None])
        leaves = passes.any(axis=1)
        if leaves.any():
            moved, start = outlines.shifted(part.piece.ravel(), here[:, 1 + 2 * k :].ravel(), part.tip.ravel())
            rods.piece[rows] = np.where(passes, moved.reshape(-1, k), part.piece)
            z[rows, 1 + 2 * k :] = np.where(passes, start.reshape(-1, k), here[:, 1 + 2 * k :])
        stalls = size > 0.5 * best[rows]
        # residuals in rod lengths and radians; rounding may leave the larger one
        done = ~leaves & ((size < 1e-13) | ((size < 1e-11) & stalls))
        found[rows[done]] = True
        best[rows] = np.where(leaves, np.inf, np.fmin(size, best[rows]))
        # after some iterations one that does not halve the residual is the last
        ends = done | (~leaves & stalls & (iteration > 5)) | ~np.isfinite(values).all(axis=(1, 2))
        remaining, going = rows[~ends], ~ends & ~leaves
        rows, value, slopes, part = rows[going], value[going], slopes[going], part.rows(going)
        if not len(remaining):
            break
        with np.errstate(all="ignore"):
            try:
                change = np.linalg.solve(slopes, value[..., None])[..., 0]
            except np.linalg.LinAlgError:
                change = np.einsum("mij,mj->mi", np.linalg.pinv(slopes), value)
        u = np.where(part.sticks, part.u, z[rows, 1 + 2 * k :])
        place = outlines.at(part.piece.ravel(), u.ravel())
        speed = np.hypot(*place.derivative.T) / _FARTHEST + np.abs(outlines.turn[part.piece.ravel()]) / _STEEPEST
        scale = np.zeros((len(rows), d))
        scale[:, 0], scale[:, 1 + k : 1 + 2 * k] = 0.5, 1 / _FARTHEST
        scale[:, 1 + 2 * k :] = np.where(part.sticks, 1 / _STEEPEST, speed.reshape(-1, k))
        z[rows] -= change / np.maximum(1.0, np.abs(change * scale).max(axis=1))[:, None]
        rows = remaining
    rods.kappa[:], rods.force[:], s, last = z[:, 0], z[:, 1 : 1 + k], z[:, 1 + k : 1 + 2 * k], z[:, 1 + 2 * k :]
    rods.u[:], rods.zeta[:] = _places(outlines, rods, s, last), np.where(rods.sticks, last, rods.zeta)
    rods.s[:] = s
    return found


def shapes(outlines: Outlines, rods: Rods, at: Array) -> End:
    """The rods at arc lengths (m, q)."""
    m, used = len(rods.x0), slice(max(int(rods.count.max(initial=0)), 1))
    s = rods.s[:, used]
    tau = outlines.at(rods.piece[:, used].ravel(), rods.u[:, used].ravel()).tau.reshape(s.shape)
    across, along = _forces(tau, rods.force[:, used], rods.zeta[:, used])
    marched = _march(rods.x0, rods.kappa, s, across, along)
    none = np.zeros((m, 1))

    def begins(first: Array, columns: Array) -> Array:
        return np.concatenate([first[:, None], columns], axis=1)

    segment = (at[:, :, None] > s[:, None, :]).sum(axis=2)
    last = segment >= rods.count[:, None]

    def here(columns: Array) -> Array:
        return np.take_along_axis(columns, segment, axis=1)

    phi, kappa = here(begins(np.full(m, np.pi / 2), marched.phi)), here(begins(rods.kappa, marched.kappa))
    fx, fy = here(np.concatenate([across, none], axis=1)), here(np.concatenate([along, none], axis=1))
    straight = np.where(last, 0.0, 1.0)  # no moment past the last contact, not even a rounding one
    end = piece(fx * straight, fy * straight, phi, kappa * straight, at - here(begins(np.zeros(m), s)))
    x, y = here(begins(rods.x0, marched.x)) + end.x, here(begins(np.zeros(m), marched.y)) + end.y
    return End(x, y, end.phi, end.kappa)


def reactions(outlines: Outlines, rods: Rods) -> tuple[Array, Array, Array]:
    """Support reactions f0x, f0y and m0z (m,): ``-N(0)`` and ``-κ(0)``."""
    tau = outlines.at(rods.piece.ravel(), rods.u.ravel()).tau.reshape(rods.s.shape)
    across, along = _forces(tau, rods.force, rods.zeta)
    return -across[:, 0], -along[:, 0], -rods.kappa


LINKS = 80
# Points on each link that must stay outside, so that corners do not pass between them.
_PER_LINK = 3
# Gap, in rod lengths, from which on a point does not take part in a step.
_CLEAR = 0.05


class Settled(NamedTuple):
    """A chain and the chain_points at which it is pressed."""

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
    # from the clamp to the first link's middle it is half a link, and from there on one each
    diagonal = np.diag([3.0, *np.full(LINKS - 2, 2.0), 1.0])
    return LINKS * (diagonal - np.eye(LINKS, k=1) - np.eye(LINKS, k=-1))


_COMPLIANCE = np.linalg.inv(_stiffness())
_S = (np.arange(LINKS * _PER_LINK) + 1) / (LINKS * _PER_LINK)
# share of each link's length before each point
_WEIGHT = np.clip(_S[:, None] * LINKS - np.arange(LINKS), 0, 1) / LINKS


def chain_points(x0: float, angles: Array) -> Array:
    """Points (LINKS * 3, 2) of a chain."""
    return np.stack([x0 + _WEIGHT @ np.cos(angles), _WEIGHT @ np.sin(angles)], axis=1)


def settle(outlines: Outlines, body: int, x0: float, angles: Array, friction_angle: float) -> Settled:
    """The chain at a base position, let go from the angles (LINKS,) of its links."""
    mu, angles = np.tan(friction_angle), angles.copy()
    d = np.zeros(LINKS)
    active = np.zeros(0, dtype=np.intp)
    for step in range(600):
        # chains that go to and fro between two contacts come to rest with smaller steps
        damping = 0.35 / (1 + step // 150)
        place = chain_points(x0, angles)
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
        angles += min(damping, 0.03 / largest) * d
    pressed = force > 1e-9 * max(1.0, float(force.max(initial=0.0)))
    row, force, piece, u = row[pressed], force[pressed], near.piece, near.u
    pushed = force[row == len(_S) - 1] @ normal[pressed][row == len(_S) - 1]
    for k, tau in zip(corner[::2], place_of.tau[::2], strict=True):
        turned = np.arctan2(pushed[0], -pushed[1]) - tau
        share = (np.remainder(turned + np.pi, 2 * np.pi) - np.pi) / outlines.turn[k]
        if pushed.any() and 1e-6 < share < 1 - 1e-6:  # held by both sides, whose normals differ, it is wedged
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
    # with rigid contacts neighbouring chain_points that are pressed alike would have no single answer
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
    """Neighbouring chain_points that are pressed make one contact."""
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
