"""Sweeps along any bodies: the rod is followed from one base position to the next, with all of its contacts.

From the last state Newton's method finds the next one with the same contacts; what it violates changes the contacts, and the
state is solved again at the same base position: a contact that pulls is dropped, a place where the rod is inside the body
becomes one, the tip leaves or takes a contact over, a contact passes to the next piece of the outline, a contact that slips
with its friction changes the direction of its slip, or sticks.  Where the steps become too small the equilibrium ends in a
fold, and the rod snaps (`planar.several`).  All sweeps are stepped together.

Along polygons most rods touch at one place: tables tell where (`planar.singles`), and only rods that would be inside a body are
followed, up to where the tables hold again.

What the theory leaves open: after a snap contacts are taken to slip as the sweep does; with a coefficient of friction per
sample a rod that is followed goes on from the sample before with the new one, which is the state of a sweep with a single
coefficient except where that snapped earlier or later.  A rod that finds no equilibrium is reported as such, never as free.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planar.arrays import Array, Index, Mask, ratio
from planar.contours import Nearest, Outlines
from planar.plots import Explained
from planar.several import LINKS, MOST, Rods, Settled, chain_points, free_rods, settle, shapes, solve
from planar.singles import INSIDE, JUMP, Singles, Start

# Step of the base, in rod lengths: the largest, the one below which a rod that does not follow has come to a fold, and the one
# across a fold, which the chain in its coarseness must see.
_STEP, _FOLD, _ACROSS = 0.02, 2e-5, 5e-4
# Arc lengths at which a rod is tested, and intervals into which the least gap is divided at a time.
_TESTED, _ZOOM = 129, 8
# Lengths and sines at which contacts change.
_ROUNDING = 1e-10


class SweepStatus(Explained):
    """What is known of the rod at a base position; `sentence` explains it."""

    FREE = 0, "the rod touches nothing"
    ONE_CONTACT = 1, "the rod touches at one place"
    SEVERAL_CONTACTS = 2, "the rod touches at several places; point, slope and s1 are those of the first along the rod"
    UNRESOLVED = (
        3,
        "no equilibrium of the rod was found here, so that nothing is known of its contacts: it is caught, "
        "stands like a strut, or has more contacts than are followed: three, or one of a rod that is not straight",
    )


class Followed(NamedTuple):
    """The samples (n,) of one sweep."""

    rods: Rods
    status: NDArray[np.int8]


def follow(
    outlines: Outlines, bases: list[Array], friction_angles: list[Array], *, single: bool = False
) -> list[Followed]:
    """The sweep of each body in -x, over base positions (n,) that do not rise, with the friction angles (n,).

    With `single` a sweep ends with the first sample in which the rod touches at several places.
    """
    # also at places between touch-down and the first base position, and between those that are far apart
    dense = [_dense(outlines.touch_down(body) + 1e-3, base) for body, base in enumerate(bases)]
    angles = [
        angle[np.searchsorted(rows, np.arange(len(base)))]
        for (base, rows), angle in zip(dense, friction_angles, strict=True)
    ]
    sweeps = _Sweeps(outlines, [base for base, _ in dense], angles, single)
    while sweeps.left():
        sweeps.leap()
        # steps of few sweeps take as long as those of many: four are stepped for each that waits for the tables
        while len(sweeps.going) > 4 * sweeps.left():
            sweeps.step()
    return [
        Followed(rods.rows(rows[rows < end]), status[rows[rows < end]])
        for rods, status, (_, rows), end in zip(sweeps.sampled, sweeps.status, dense, sweeps.end, strict=True)
    ]


def last_contacts(outlines: Outlines, bases: list[Array], friction_angles: list[Array]) -> list[float]:
    """The last of the base positions of each sweep at which the rod touches; where the tables have one, theirs."""
    touches = Singles(outlines, bases, friction_angles).touching()
    if not all(rows.any() for rows in touches):
        followed = follow(outlines, bases, friction_angles)
        touches = [
            rows if rows.any() else found.status != SweepStatus.FREE
            for rows, found in zip(touches, followed, strict=True)
        ]
    return [float(base[np.flatnonzero(rows)[-1]]) for base, rows in zip(bases, touches, strict=True)]


def _dense(start: float, base: Array) -> tuple[Array, Index]:
    """Base positions from the start on with steps of at most _STEP, and the rows of the given ones (n,)."""
    if not len(base):
        return base, np.zeros(0, dtype=np.intp)
    before = np.concatenate([[max(start, base[0])], base[:-1]])
    parts = np.maximum(np.ceil((before - base) / _STEP - 1e-9), 1).astype(np.intp)
    parts[0] += before[0] > base[0]
    rows = np.cumsum(parts) - 1
    of = np.repeat(np.arange(len(base)), parts)
    left = rows[of] - np.arange(len(of))
    size = np.where((of == 0) & (before[0] > base[0]), np.maximum(parts[of] - 1, 1), parts[of])
    return np.where(left == 0, base[of], base[of] + left * ((before - base)[of] / size)), rows


class _Sweeps:
    """Sweeps (m,) under way: their present rods and what they have passed."""

    def __init__(
        self, outlines: Outlines, bases: list[Array], friction_angles: list[Array], single: bool = False
    ) -> None:
        self.outlines, self.bases, self.friction, self.single = outlines, bases, friction_angles, single
        m = len(bases)
        self.end = np.array([len(base) for base in bases], dtype=np.intp)
        self.rods = free_rods(np.array([base[0] if len(base) else np.inf for base in bases]))
        self.earlier = free_rods(self.rods.x0)  # one step before
        self.sample, self.stride = np.zeros(m, dtype=np.intp), np.full(m, _STEP)
        self.chain: list[Array | None] = [None] * m  # the last known shape of rods that are not resolved
        self.sampled = [free_rods(base) for base in bases]
        self.status = [np.full(len(base), SweepStatus.UNRESOLVED, dtype=np.int8) for base in bases]
        self.going = np.zeros(0, dtype=np.intp)
        self.shape = np.full((m, _TESTED, 2), np.nan)
        self.singles = Singles(outlines, bases, friction_angles)
        # sweeps whose rods the tables may lead on, and those at folds; the samples to wait for until the tables are asked, and
        # the next time after that; the last place on the path
        self.waits, self.folded = [i for i in range(m) if len(bases[i])], list[int]()
        self.pause, self.patience, self.place = np.zeros(m, np.intp), np.ones(m, np.intp), np.full(m, -1, np.intp)

    def leap(self) -> None:
        """Let the tables lead the waiting sweeps on as far as they hold, and those at folds go that they do not lead on."""
        waiting, folded = self.waits, self.folded
        self.waits, self.folded = [], []
        starts = [
            Start(i, max(int(self.sample[i]) - 1, 0), int(self.place[i]), self._rod(i) if self.sample[i] else None)
            for i in waiting
            if self.singles.known[i]
        ]
        for i in folded:
            touched = self._places(i)
            starts += [Start(i, int(self.sample[i]), k, None, self.shape[i], touched) for k in touched]
        for start, (ahead, holds) in zip(starts, self.singles.ahead(starts) if starts else [], strict=True):
            i, first = start.sweep, int(start.rod is not None)
            if holds > first and start.sample + first == self.sample[i]:
                rods = ahead.rows(np.arange(first, holds))
                samples = self.sample[i] + np.arange(len(rods.x0))
                self.sampled[i].put(samples, rods)
                self.status[i][samples] = np.where(rods.count > 0, SweepStatus.ONE_CONTACT, SweepStatus.FREE)
                self.rods.put(np.array([i]), rods.rows(np.array([len(samples) - 1])))
                self.sample[i] += len(samples)
                self.stride[i], self.pause[i], self.patience[i] = _STEP, 1, 1
                self._keep_place(i, rods.rows(np.flatnonzero(rods.count)[-1:]))
                folded = [k for k in folded if k != i]
                waiting = [*waiting, i] if start.shape is not None else waiting
            elif start.shape is None:
                self.pause[i], self.patience[i] = self.patience[i], 2 * self.patience[i]
        left = np.array([i for i in waiting if self.sample[i] < self.end[i]], dtype=np.intp)
        if len(left):
            self.shape[left] = self._points(self.rods.rows(left))
        for i in folded:
            self._let_go(i, _ACROSS)
        gone = [i for i in folded if self.sample[i] < self.end[i] and i not in self.waits]
        self.going = np.union1d(self.going, np.append(left, gone)).astype(np.intp)

    def left(self) -> int:
        """How many sweeps the tables are to lead on."""
        return len(self.waits) + len(self.folded)

    def _rod(self, i: int) -> Rods:
        return self.rods.rows(np.array([i]))

    def _places(self, i: int) -> tuple[int, ...]:
        """The places of a rod's contacts on the path."""
        count = self.rods.count[i]
        found = {
            self.singles.place(int(k), float(u))
            for k, u in zip(self.rods.piece[i, :count], self.rods.u[i, :count], strict=True)
        }
        return tuple(sorted(found - {-1}))

    def _let_go(self, i: int, travel: float) -> None:
        """Let a rod go that has come to a fold, or is lost, and the base go on."""
        aim = self.bases[i][self.sample[i]]
        x0 = max(self.rods.x0[i] - travel, aim)
        rod, points, chain = self._snap(i, float(x0), float(self.friction[i][self.sample[i]]), self.shape[i])
        self.rods.put(np.array([i]), rod)
        self.shape[i], self.chain[i], self.stride[i] = points, chain, _STEP / 4
        if x0 <= aim:
            self._record(i, rod)

    def _keep_place(self, i: int, rod: Rods) -> None:
        if len(rod.x0) and rod.count[0] == 1:
            place = self.singles.place(int(rod.piece[0, 0]), float(rod.u[0, 0]))
            self.place[i] = place if place >= 0 else self.place[i]

    def step(self) -> None:
        """One step of each sweep that is under way."""
        rows = self.going
        before = self.rods.rows(rows)
        aim = np.array([self.bases[i][self.sample[i]] for i in rows])
        trial = before.rows(np.arange(len(rows)))
        trial.x0 = np.maximum(before.x0 - self.stride[rows], aim)
        zeta = np.array([self.friction[i][self.sample[i]] for i in rows])
        self._extrapolate(trial, rows)
        slips = ~trial.sticks
        trial.zeta = np.where(slips, np.copysign(zeta[:, None], trial.zeta), trial.zeta)
        lost = np.array([self.chain[i] is not None for i in rows])
        settled = np.flatnonzero(~lost)
        good = np.zeros(len(rows), dtype=bool)
        reached = np.empty((len(rows), _TESTED, 2))
        part = trial.rows(settled)
        good[settled], points = self._admissible(rows[settled], part, zeta[settled], before.rows(settled))
        reached[settled] = points
        trial.put(settled, part)
        moved = np.hypot(*(reached - self.shape[rows]).transpose(2, 0, 1)).max(axis=1)
        good &= ~(moved > JUMP + 3 * (before.x0 - trial.x0))
        self.stride[rows] = np.where(good, np.minimum(2 * self.stride[rows], _STEP), self.stride[rows] / 16)
        folds = np.flatnonzero(~good & ~lost & (self.stride[rows] < _FOLD))
        if len(folds):
            good[folds], part, reached[folds] = self._around_corners(rows[folds], aim[folds], zeta[folds])
            trial.put(folds, part)
            self.stride[rows[folds]] = np.where(good[folds], _STEP / 4, self.stride[rows[folds]])
        self.earlier.put(rows[good], self.rods.rows(rows[good]))
        self.rods.put(rows[good], trial.rows(good))
        self.shape[rows[good]] = reached[good]
        for k in np.flatnonzero(good & (trial.x0 <= aim)):
            self._record(int(rows[k]), trial.rows(np.array([k])))
        for i in rows[lost]:
            self._let_go(i, _STEP)
        for i in rows[~good & ~lost & (self.stride[rows] < _FOLD)]:
            if self.singles.known[i]:
                self.folded.append(int(i))
            else:
                self._let_go(i, _ACROSS)
        elsewhere = {*self.waits, *self.folded}
        left = np.array([self.sample[i] < self.end[i] and i not in elsewhere for i in rows], dtype=bool)
        self.going = rows[left]

    def _around_corners(self, rows: Index, aim: Array, zeta: Array) -> tuple[Mask, Rods, Array]:
        """Rods at folds whose tip comes round a convex corner, on to the next edge: where that is so, and their points."""
        rods, outlines = self.rods.rows(rows), self.outlines
        rods.x0 = np.maximum(rods.x0 - _ACROSS, aim)
        rods.zeta = np.where(rods.sticks, rods.zeta, np.copysign(zeta[:, None], rods.zeta))
        last, every = np.maximum(rods.count - 1, 0), np.arange(len(rows))
        piece = rods.piece[every, last]
        # against the outline's direction, as the sweep goes
        corner = np.where(outlines.is_vertex[piece], piece, outlines.previous[piece])
        beyond = outlines.previous[corner]
        at_end = (rods.count > 0) & (rods.s[every, last] > 1 - _ACROSS) & ~outlines.is_closed[piece]
        tried = np.flatnonzero(at_end & (outlines.turn[corner] > 0))
        good, points = np.zeros(len(rows), dtype=bool), np.full((len(rows), _TESTED, 2), np.nan)
        column = last[tried]
        rods.piece[tried, column], rods.u[tried, column] = beyond[tried], 1.0
        rods.tip[tried, column], rods.s[tried, column] = True, 1.0
        part = rods.rows(tried)
        good[tried], points[tried] = self._admissible(rows[tried], part, zeta[tried], None)
        rods.put(tried, part)
        moved = np.hypot(*(points - self.shape[rows]).transpose(2, 0, 1)).max(axis=1)
        return good & (moved < JUMP), rods, points

    def _extrapolate(self, trial: Rods, rows: Index) -> None:
        """Start values on the line through the last two states, where the contacts are the same."""
        before, now = self.earlier.rows(rows), self.rods.rows(rows)
        travel = before.x0 - now.x0
        same = (travel > 0) & (before.count == now.count) & (now.count > 0)
        same &= ((before.piece == now.piece) & (before.tip == now.tip) & ~before.sticks & ~now.sticks).all(axis=1)
        share = np.where(same, np.minimum(ratio(now.x0 - trial.x0, travel), 2.0), 0.0)
        trial.kappa = now.kappa + share * (now.kappa - before.kappa)
        for name in ("force", "s", "u"):
            old, new = getattr(before, name), getattr(now, name)
            setattr(trial, name, new + share[:, None] * (new - old))

    def _record(self, sweep: int, rod: Rods) -> None:
        sample = self.sample[sweep]
        self.sampled[sweep].put(np.array([sample]), rod)
        kinds = SweepStatus.FREE, SweepStatus.ONE_CONTACT, SweepStatus.SEVERAL_CONTACTS
        known = self.chain[sweep] is None
        self.status[sweep][sample] = kinds[min(int(rod.count[0]), 2)] if known else SweepStatus.UNRESOLVED
        self.sample[sweep] += 1
        if self.single and self.status[sweep][sample] == SweepStatus.SEVERAL_CONTACTS:
            self.end[sweep] = self.sample[sweep]
        self._keep_place(sweep, rod)
        if known and rod.count[0] <= 1 and self.sample[sweep] < self.end[sweep] and self.singles.known[sweep]:
            self.pause[sweep] -= 1
            if self.pause[sweep] <= 0:
                self.waits.append(sweep)

    def _points(self, rods: Rods) -> Array:
        shape = shapes(self.outlines, rods, np.broadcast_to(np.linspace(0, 1, _TESTED), (len(rods.x0), _TESTED)))
        return np.stack([shape.x, shape.y], axis=2)

    def _admissible(self, bodies: Index, rods: Rods, zeta: Array, before: Rods | None) -> tuple[Mask, Array]:
        """Change the contacts of rods until they violate nothing; where that succeeded, and the points of the rods."""
        m = len(bodies)
        good, points = np.zeros(m, dtype=bool), np.full((m, _TESTED, 2), np.nan)
        flipped = np.zeros((m, MOST), dtype=bool)
        pending = np.arange(m)
        for _ in range(8):  # more changes of the contacts at one base position lead round in circles
            part = rods.rows(pending)
            found = solve(self.outlines, part)
            rods.put(pending, part)
            pending, part = pending[found], part.rows(found)
            if not len(pending):
                break
            end = shapes(self.outlines, part, np.ones((len(pending), 1))).phi[:, 0]
            changes = (self._contacts_change(rods, int(k), float(phi)) for k, phi in zip(pending, end, strict=True))
            changed: Mask = np.fromiter(changes, bool, len(pending))
            rest, kept = pending[~changed], pending[changed]
            if len(rest):
                part = rods.rows(rest)
                points[rest] = self._points(part)
                depth, s, near = self._deepest(bodies[rest], part, points[rest])
                inside = depth < -INSIDE
                added = [
                    self._touches(rods, int(k), s[j], near, j, zeta[k], before) for j, k in enumerate(rest) if inside[j]
                ]
                kept = np.concatenate([kept, rest[inside][np.array(added, dtype=bool)]])
                rest = rest[~inside]
            if len(rest) and before is not None:
                slipping = self._slip(rods.rows(rest), before.rows(rest), zeta[rest], flipped[rest])
                for j, slot in zip(*np.nonzero(slipping), strict=True):
                    self._turn_slip(rods, int(rest[j]), int(slot), flipped, float(zeta[rest[j]]), before)
                wrong = slipping.any(axis=1)
                kept, rest = np.concatenate([kept, rest[wrong]]), rest[~wrong]
            good[rest] = True
            pending = np.sort(kept)
            if not len(pending):
                break
        return good, points

    def _contacts_change(self, rods: Rods, k: int, phi: float) -> bool:
        """Apply the first thing that the contacts of rod k, whose tip has the slope phi, violate by themselves."""
        count = int(rods.count[k])
        if not count:
            return False
        force, s, u, piece = rods.force[k, :count], rods.s[k, :count], rods.u[k, :count], rods.piece[k, :count]
        if (force < 0).any():
            rods.drop(k, int(np.argmin(force)))
            return True
        moved, start = self.outlines.shifted(piece, u, rods.tip[k, :count])
        if (moved != piece).any():
            rods.piece[k, :count], rods.u[k, :count] = moved, start
            return True
        if (np.diff(s) < 0).any():
            order = np.append(np.argsort(s, kind="stable"), np.arange(count, MOST))
            for column in (rods.force, rods.s, rods.piece, rods.u, rods.zeta, rods.side, rods.tip, rods.sticks):
                column[k] = column[k, order]
            return True
        last = count - 1
        if not rods.tip[k, last] and s[last] > 1:
            rods.tip[k, last], rods.s[k, last] = True, 1.0
            return True
        if rods.tip[k, last]:
            tau = float(self.outlines.at(piece[last:], u[last:]).tau[0])
            if np.sin(tau - phi) > _ROUNDING:  # t(1)·n > 0: the rod would come out of the body
                rods.tip[k, last] = False
                rods.side[k, last] = np.copysign(1.0, np.cos(phi - tau))
                return True
        return False

    def _deepest(self, bodies: Index, rods: Rods, points: Array) -> tuple[Array, Array, Nearest]:
        """The least gap of each rod between the places at which it is tested, with its arc length and place."""
        m, spacing = len(bodies), 1 / (_TESTED - 1)
        near = self.outlines.nearest(np.repeat(bodies, _TESTED), points.reshape(-1, 2), 2 * spacing)
        gap = near.gap.reshape(m, _TESTED)
        padded = np.pad(gap, ((0, 0), (1, 1)), constant_values=np.inf)
        lowest = (gap <= padded[:, :-2]) & (gap <= padded[:, 2:]) & (gap < spacing)
        # where the rod lies along an edge there is nothing to look for, nor next to a contact between places that are outside
        flat = np.abs(gap) < _ROUNDING
        lowest &= ~(flat & (np.pad(flat, ((0, 0), (1, 0)))[:, :-1] | np.pad(flat, ((0, 0), (0, 1)))[:, 1:]))
        grid = np.arange(_TESTED) * spacing
        known = (np.abs(grid[:, None] - rods.s[:, None, :]) <= spacing).any(axis=2)
        lowest &= ~(known & (gap > -INSIDE) & (np.minimum(padded[:, :-2], padded[:, 2:]) > 0))
        row, column = np.nonzero(lowest)
        best = np.array([np.argmin(values) for values in gap])
        flat = np.arange(m) * _TESTED + best
        depth, s, found = gap[np.arange(m), best].copy(), best * spacing, Nearest(*(v[flat].copy() for v in near))
        middle, reach = grid[column], spacing
        part = rods.rows(row)
        for _ in range(6 if len(row) else 0):
            at = np.clip(middle[:, None] + reach * np.linspace(-1, 1, _ZOOM + 1), 0, 1)
            shape = shapes(self.outlines, part, at)
            near = self.outlines.nearest(
                np.repeat(bodies[row], _ZOOM + 1), np.stack([shape.x.ravel(), shape.y.ravel()], axis=1)
            )
            gaps = near.gap.reshape(at.shape)
            k = np.argmin(gaps, axis=1)
            middle, reach = at[np.arange(len(row)), k], reach * 2 / _ZOOM
            least = gaps[np.arange(len(row)), k]
            for j in np.flatnonzero(least < depth[row]):  # few
                if least[j] < depth[row[j]]:
                    depth[row[j]], s[row[j]] = least[j], middle[j]
                    for values, new in zip(found, near, strict=True):
                        values[row[j]] = new[j * (_ZOOM + 1) + k[j]]
        return depth, s, found

    def _touches(self, rods: Rods, k: int, s: float, near: Nearest, j: int, zeta: float, before: Rods | None) -> bool:
        """Add the contact at arc length s of rod k, next to place j of the outline; whether there is room."""
        if rods.count[k] == MOST:
            return False
        piece, u, tip = near.piece[j : j + 1], near.u[j : j + 1], s > 1 - 1e-6
        shape = shapes(self.outlines, rods.rows(np.array([k])), np.array([[s]]))
        phi, tau = float(shape.phi[0, 0]), float(self.outlines.at(piece, u).tau[0])
        tip = bool(tip and np.sin(tau - phi) <= 0 and not rods.tip[k].any())
        piece, u, side = self._laid(piece, u, phi, tip)
        tau, sign = float(self.outlines.at(piece, u).tau[0]), 1.0
        if before is not None and rods.count[k]:
            old = shapes(self.outlines, before.rows(np.array([k])), np.array([[s]]))
            slip = (shape.x - old.x)[0, 0] * np.cos(tau) + (shape.y - old.y)[0, 0] * np.sin(tau)
            sign = -1.0 if slip > _ROUNDING else 1.0
        force = 0.0
        if not rods.count[k]:
            force = 3 * -near.gap[j] / max(s, 0.05) ** 3
            rods.kappa[k] = -side * force * s
        rods.add(k, force, s if tip else min(s, 1 - 1e-6), int(piece[0]), float(u[0]), sign * zeta, side, tip)
        return True

    def _laid(self, piece: Index, u: Array, phi: float, tip: bool) -> tuple[Index, Array, float]:
        """The place (1,) next to a given one where a rod of slope phi touches, and the side of the rod that the body is on."""
        tau = float(self.outlines.at(piece, u).tau[0])
        side = float(np.copysign(1.0, np.cos(phi - tau)))
        return (piece, u, side) if tip else (*self._tangential(piece, u, tau, phi if side > 0 else phi - np.pi), side)

    def _tangential(self, piece: Index, u: Array, tau: float, phi: float) -> tuple[Index, Array]:
        """The place (1,) next to a given one where a rod of slope phi lies along the outline: an edge's end is its vertex."""
        outlines = self.outlines
        if not outlines.is_vertex[piece[0]]:
            ahead = np.remainder(phi - tau + np.pi, 2 * np.pi) - np.pi
            end = (outlines.following if ahead > 0 else outlines.previous)[piece]
            if abs(ahead) < 1e-6 or outlines.is_closed[piece[0]] or outlines.turn[end[0]] <= 0:
                return piece, u
            piece = end
        turn = float(outlines.turn[piece[0]])
        start = float(outlines.at(piece, np.zeros(1)).tau[0])
        ahead = np.remainder(phi - start + np.pi, 2 * np.pi) - np.pi
        return piece, np.clip(np.array([ahead / turn]), 0, 1)

    def _slip(self, rods: Rods, before: Rods, zeta: Array, flipped: Mask) -> Mask:
        """Contacts that slip with their friction, or stick with more than it can hold."""
        used = np.arange(MOST) < rods.count[:, None]
        at = np.clip(rods.s, 0, 1)
        new, old = shapes(self.outlines, rods, at), shapes(self.outlines, before, at)
        tau = self.outlines.at(rods.piece.ravel(), rods.u.ravel()).tau.reshape(rods.s.shape)
        slip = (new.x - old.x) * np.cos(tau) + (new.y - old.y) * np.sin(tau)
        wrong = ~rods.sticks & (slip * np.sign(rods.zeta) > 1e-9)
        torn = rods.sticks & (np.abs(rods.zeta) > zeta[:, None] + _ROUNDING)
        return used & (zeta[:, None] > 0) & (before.count[:, None] > 0) & (wrong | torn)

    def _turn_slip(self, rods: Rods, k: int, slot: int, flipped: Mask, zeta: float, before: Rods) -> None:
        if rods.sticks[k, slot]:
            rods.sticks[k, slot], rods.zeta[k, slot] = False, np.copysign(zeta, rods.zeta[k, slot])
        elif flipped[k, slot]:
            rods.sticks[k, slot], rods.zeta[k, slot] = True, 0.0
            # where it was: the contact before that is as near to this one as to no other, if there is one
            now, then = (
                self.outlines.at(one.piece[k, : one.count[k]], one.u[k, : one.count[k]]).point for one in (rods, before)
            )
            apart = np.linalg.norm(now[:, None] - then, axis=2)
            held = int(apart[slot].argmin())
            if apart[:, held].argmin() == slot:
                for column, old in ((rods.piece, before.piece), (rods.u, before.u), (rods.s, before.s)):
                    column[k, slot] = old[k, held]
        else:
            rods.zeta[k, slot], flipped[k, slot] = -rods.zeta[k, slot], True

    def _snap(self, sweep: int, x0: float, zeta: float, shape: Array) -> tuple[Rods, Array, Array | None]:
        """Let the rod go from a shape: its rod and points, and the chain if they are not those of an equilibrium."""
        angles = self.chain[sweep]
        if angles is None:
            at = np.linspace(0, 1, LINKS + 1)
            nodes = [np.interp(at, np.linspace(0, 1, _TESTED), column) for column in shape.T]
            angles = np.unwrap(np.arctan2(np.diff(nodes[1]), np.diff(nodes[0])))
        settled = settle(self.outlines, sweep, x0, angles, zeta)
        chain = chain_points(x0, settled.angles)
        s = np.concatenate([[0.0], np.arange(len(chain)) + 1.0]) / len(chain)
        whole = np.concatenate([[[x0, 0.0]], chain])
        along = np.stack([np.interp(np.linspace(0, 1, _TESTED), s, column) for column in whole.T], axis=1)
        body = np.array([sweep])
        if settled.at_rest:
            for attempt in range(3):
                rods = self._guess(x0, settled, zeta, attempt)
                if rods is None:
                    continue
                good, points = self._admissible(body, rods, np.array([zeta]), None)
                # the chain that came to rest is coarse
                if good[0] and np.hypot(*(points[0] - along).T).max() < 0.05:
                    return rods, points[0], None
        return free_rods(np.array([x0])), along, settled.angles

    def _guess(self, x0: float, settled: Settled, zeta: float, attempt: int) -> Rods | None:
        """The contacts of a chain at rest: as they are, with the last one's tip exchanged, without the weakest."""
        keep = np.arange(len(settled.s))
        if len(keep) > MOST or (attempt and not len(keep)):
            return None
        rods = free_rods(np.array([x0]))
        if attempt == 2:
            keep = np.delete(keep, np.argmin(settled.force))
        rods.kappa[0] = 2 * LINKS * (settled.angles[0] - np.pi / 2)
        for c in keep:
            tip = bool(settled.tip[c]) ^ bool(attempt == 1 and c == keep[-1])
            phi = float(np.interp(settled.s[c] * LINKS - 0.5, np.arange(LINKS), settled.angles))
            piece, u, side = self._laid(settled.piece[c : c + 1], settled.u[c : c + 1], phi, tip)
            s = 1.0 if tip else min(float(settled.s[c]), 1 - 1e-3)
            rods.add(0, settled.force[c] / np.cos(zeta), s, int(piece[0]), float(u[0]), zeta, side, tip)
        return rods
