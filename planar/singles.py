"""Sweeps of rods that touch polygons of any shape at one place at a time, from tables as those of convex ones.

The candidate at a base position is the next equilibrium on the path from the one before, as on a
convex contour, or the straight rod.  It holds as long as no rod is inside a body, and where the rod jumps, nothing of the body
lies between the two but what it slides along.  What does not hold, and what lies behind it, is left to `planar.any_body`.

The path of a rod at a single place of straight edges goes against the tangent of the outline below a body, as `planar.contours`
describes it for a convex one.  On any other the slopes rise again at concave vertices, in which the tip is wedged; where the
outline faces away from the rod, or is higher than the rod is long, the path is interrupted, so that it consists of runs.
Whether a rod at such a place touches nowhere else is a question of its own.  It turns to the right all along, from the clamp's
``φ = π/2`` to its end, so that it is the graph of a concave function over its clamp's and its tip's x.  The polygon is crossed
where an edge has one end on the rod's left and one on its right, or where an edge with both ends on the left is cut by the
rod's bow.  Left and right of most vertices are told by the chords between points of the rod, those next to it by polynomials.

With a coefficient of friction per sample, each candidate is looked for between the places of sweeps with neighbouring ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from planar import segments
from planar.arrays import BLOCK, Array, Index, Mask, ratio, rows_of
from planar.contours import Outlines, Path, subdivided
from planar.elastica import piece
from planar.several import Rods, free_rods

JUMP = 0.03
"""Movement of the rod, in rod lengths, beyond three times that of the base, that is looked at as a jump."""
# Distance between two places, in rod lengths, that are the same.
_SAME = 1e-7


class Start(NamedTuple):
    """From where the tables lead a sweep on."""

    sweep: int
    sample: int
    """The first one that they are asked for."""
    place: int = -1
    """The piece of the path from which on the next equilibrium is looked for; -1 for its beginning."""
    rod: Rods | None = None
    """(1,) the rod at the first sample, which the first candidate must be; None: not yet known."""
    shape: Array | None = None
    """(k, 2) a rod from which the first candidate must be within reach without anything between."""
    touched: tuple[int, ...] = ()
    """Pieces of the path that it touches."""


class _Places(NamedTuple):
    """Candidates (n,): pieces of the path, -1 where the rod is free and -2 where nothing is known, and the states there."""

    piece: Index
    t: Array
    slope: Array
    tangential: Mask
    force: Array
    m0z: Array
    s1: Array


def _nowhere(n: int) -> _Places:
    zero = np.zeros(n)
    return _Places(np.full(n, -2), zero, zero.copy(), np.zeros(n, bool), zero.copy(), zero.copy(), zero + 1)


class Singles:
    """Tables of the sweeps along the bodies of outlines, one each; not changed after they are made."""

    def __init__(self, outlines: Outlines, bases: list[Array], friction_angles: list[Array]) -> None:
        self.outlines, self.bases, self.angles = outlines, bases, friction_angles
        self.runs: Runs = runs(outlines)
        known = np.bincount(self.runs.body, minlength=len(bases)) > 0
        self.known = known & np.array([len(base) > 0 for base in bases], dtype=bool)
        # corners of each body, and the path's pieces
        edges = np.flatnonzero(~outlines.is_vertex)
        self._corner, self._next = np.full(len(outlines.is_vertex), -1), outlines.following[outlines.following]
        counts = np.bincount(outlines.body[edges], minlength=len(bases))
        begin = np.cumsum(counts) - counts
        self._edges = [edges[b : b + c] for b, c in zip(begin, counts, strict=True)]
        for part in self._edges:
            self._corner[part] = np.arange(len(part))
        body = self.runs.body[self.runs.run]
        self._pieces = np.searchsorted(body, np.arange(len(bases) + 1))
        if self.known.any():
            self._tabulate()

    def _tabulate(self) -> None:
        """Segments of all runs at the coefficients between which the samples of each sweep lie, rows by sweep and level."""
        begins = np.searchsorted(self.runs.body, np.arange(len(self.bases) + 1))
        self.levels = [
            segments.levels(angle) if known else np.zeros(1)
            for angle, known in zip(self.angles, self.known, strict=True)
        ]
        parts = [np.arange(a, b) for a, b in zip(begins[:-1], begins[1:], strict=True)]
        self.table, self.rows = segments.tables(self.runs.path, parts, self.levels)
        self._leave_out_hollows(self.table)

    def _leave_out_hollows(self, table: segments.Segments) -> None:
        """Along a concave stretch no rod lies."""
        table.x0[table.tangential & (self.runs.hollow[table.piece] == 2)] = np.nan

    def place(self, piece: int, u: float) -> int:
        """The path's piece at a place of the outline, -1 where it is none."""
        rows = slice(*self._pieces[self.outlines.body[piece] + np.arange(2)])
        on = np.flatnonzero(self.runs.piece[rows] == piece)
        if not len(on):
            return -1
        begin = self.runs.u[rows][on]
        past = np.flatnonzero(begin >= u - 1e-12)
        return int(rows.start + on[past[-1] if len(past) else 0])

    def ahead(self, starts: list[Start]) -> list[tuple[Rods, int]]:
        """The rods (n,) that the tables tell of the samples of sweeps from their starts on, and how many of them hold."""
        size = [len(self.bases[start.sweep]) - start.sample for start in starts]
        found, rods, lines = self._drawn(starts, size)
        answers, begin = [], 0
        for start, count in zip(starts, size, strict=True):
            rows = np.arange(begin, begin + count)
            begin += count
            holds = self._hold(start, rows_of(lines, rows), found.piece[rows])
            if holds and start.rod is not None and not self._same(rods.rows(rows[:1]), start.rod):
                holds = 0
            answers.append((rods.rows(rows), holds))
        return answers

    def touching(self) -> list[Mask]:
        """Whether there is a rod in contact, and clear elsewhere, at the samples (n,) of each sweep, whatever came before."""
        sweeps = np.flatnonzero(self.known)
        touches = [np.zeros(len(base), dtype=bool) for base in self.bases]
        if len(sweeps):
            size = [len(self.bases[i]) for i in sweeps]
            found, _, lines = self._drawn([Start(int(i), 0) for i in sweeps], size)
            on = np.split(found.piece >= 0, np.cumsum(size)[:-1])
            for i, rows, begin in zip(sweeps, on, np.cumsum(size) - size, strict=True):
                touches[i] = rows
                touches[i][rows] = ~crosses(*self._polygon(int(i)), rows_of(lines, begin + np.flatnonzero(rows)))
        return touches

    def _polygon(self, sweep: int) -> tuple[Array, Index]:
        """Corners (v, 2) of a body, at the beginnings of its edges, and the ones that follow them."""
        edges = self._edges[sweep]
        return self.outlines.cubics[self.outlines.first[edges], 0], self._corner[self._next[edges]]

    def _drawn(self, starts: list[Start], size: list[int]) -> tuple[_Places, Rods, Lines]:
        """Candidates of the samples from the starts on, and their rods."""
        base = np.concatenate([self.bases[start.sweep][start.sample :] for start in starts])
        angle = np.concatenate([self.angles[start.sweep][start.sample :] for start in starts])
        found = self._candidates(starts, size, base, angle)
        rods = self._rods(found, base, angle)
        lines = np.empty((5, len(base), POINTS + 1))
        for begin in range(0, len(base), BLOCK):
            part = slice(begin, begin + BLOCK)
            force, alpha = rods.force[part, 0], found.slope[part] + angle[part]
            s1 = np.where(found.piece[part] >= 0, found.s1[part], 1.0)
            lines[:, part] = lines_of(base[part], rods.kappa[part], force * np.sin(alpha), -force * np.cos(alpha), s1)
        return found, rods, Lines(*lines)

    def _same(self, one: Rods, other: Rods) -> bool:
        if one.count[0] != other.count[0]:
            return False
        if not one.count[0]:
            return True
        places = [self.outlines.at(rods.piece[:, 0], rods.u[:, 0]).point[0] for rods in (one, other)]
        return bool(np.hypot(*(places[0] - places[1])) < _SAME and abs(one.s[0, 0] - other.s[0, 0]) < _SAME)

    def _hold(self, start: Start, rods: Lines, piece: Index) -> int:
        """How many rods from the first on hold."""
        n = int(np.argmin(piece > -2)) if (piece == -2).any() else len(piece)
        if not n:
            return 0
        edges = self._edges[start.sweep]
        corners, following = self._polygon(start.sweep)
        bad, touching = np.zeros(n, dtype=bool), piece[:n] >= 0
        if touching.any():
            bad[touching] = crosses(corners, following, rows_of(rods, np.flatnonzero(touching)))
        free = np.flatnonzero(~touching)
        bad[free] = straight_crosses(corners, following, rods.x[free, 0])
        n = int(np.argmax(bad)) if bad.any() else n
        shape = np.stack([rods.x[:n], rods.y[:n]], axis=2)
        before = start.shape
        if (
            n
            and before is not None
            and self._something_between(corners, edges, before, shape[0], start.touched, piece[0])
        ):
            return 0
        moved = np.hypot(*np.diff(shape, axis=0).transpose(2, 0, 1)).max(axis=1, initial=0.0)
        for k in np.flatnonzero(moved > JUMP - 3 * np.diff(rods.x[:n, 0])):
            if self._something_between(corners, edges, shape[k], shape[k + 1], [piece[k]], piece[k + 1]):
                return int(k) + 1
        return n

    def _something_between(
        self, corners: Array, edges: Index, before: Array, after: Array, touched: Sequence[int], piece: int
    ) -> bool:
        """Whether corners lie between two rods apart from those of the path from the contacts of the one to the other's."""
        loop = np.concatenate([before, after[::-1]])
        inside = (corners > loop.min(axis=0) - _SAME).all(axis=1) & (corners < loop.max(axis=0) + _SAME).all(axis=1)
        offset = loop - corners[inside, None]
        following = np.roll(offset, -1, axis=1)
        cross = offset[..., 0] * following[..., 1] - offset[..., 1] * following[..., 0]
        turned = np.arctan2(cross, (offset * following).sum(axis=2)).sum(axis=1)
        between = edges[inside][np.abs(turned) > np.pi]  # corners at the beginning of these edges
        run, offsets = self.runs.run, self.runs.path.offsets
        slid = [np.empty(0, np.intp)]
        for first in touched:
            if first >= 0 and piece >= 0 and run[first] == run[piece]:
                slid.append(np.arange(min(first, piece), max(first, piece) + 1))
            else:
                if first >= 0:
                    slid.append(np.arange(first, offsets[run[first] + 1]))
                if piece >= 0:
                    slid.append(np.arange(offsets[run[piece]], piece + 1))
        passed = self.runs.piece[np.concatenate(slid)]
        # the vertex at the beginning of an edge, or one of the edges next to it
        along = np.isin(self.outlines.previous[between], passed) | np.isin(between, passed)
        along |= np.isin(self.outlines.previous[self.outlines.previous[between]], passed)
        return bool((~along).any())

    def _rods(self, found: _Places, base: Array, angle: Array) -> Rods:
        rods = free_rods(base)
        on = found.piece >= 0
        piece = found.piece[on]
        rods.count[on] = 1
        rods.kappa[on] = -found.m0z[on]
        rods.force[on, 0], rods.s[on, 0] = found.force[on], np.where(found.tangential[on], found.s1[on], 1.0)
        rods.piece[on, 0] = self.runs.piece[piece]
        rods.u[on, 0] = np.clip(self.runs.u[piece] + found.t[on] * self.runs.u_move[piece], 0, 1)
        rods.zeta[on, 0], rods.tip[on, 0] = angle[on], ~found.tangential[on]
        return rods

    def _candidates(self, starts: list[Start], size: list[int], base: Array, angle: Array) -> _Places:
        found = _nowhere(len(base))
        table = self.table
        begin = 0
        constant: list[tuple[Index, Index]] = []
        varying: list[tuple[int, Index, Index]] = []
        for start, count in zip(starts, size, strict=True):
            part = np.arange(begin, begin + count)
            begin += count
            levels = self.rows[start.sweep]
            found_rows = np.stack([_passed(table, level, base[part], start.place) for level in levels])
            if len(levels) == 1:
                constant.append((part, found_rows[0]))
            else:
                varying.append((start.sweep, part, found_rows))
        if constant:
            part, rows = (np.concatenate(columns) for columns in zip(*constant, strict=True))
            found.piece[part[rows < 0]] = -1
            self._solve(found, table, part[rows >= 0], rows[rows >= 0], base)
        if varying:
            self._search(found, varying, base, angle)
        return found

    def _search(self, found: _Places, varying: list[tuple[int, Index, Index]], base: Array, angle: Array) -> None:
        """Samples with their own friction, between the places at the neighbouring levels."""
        offsets, run = self.runs.path.offsets, self.runs.run
        samples, first, last = [], [], []
        for i, part, rows in varying:
            levels = self.levels[i]
            above = np.clip(np.searchsorted(levels, angle[part]), 1, len(levels) - 1)
            pieces = np.where(rows >= 0, self.table.piece[rows], -1)
            pair = np.take_along_axis(pieces, np.stack([above - 1, above]), axis=0)
            free = (pair < 0).all(axis=0)
            found.piece[part[free]] = -1
            one = (pair < 0).any(axis=0)
            low = np.where(one, pair.max(axis=0), pair.min(axis=0))
            # where a sweep with neighbouring friction has left, up to the end of the run
            high = np.where(one, offsets[run[low] + 1] - 1, pair.max(axis=0))
            samples.append(part[~free])
            first.append(low[~free])
            last.append(high[~free])
        sample, low, high = (np.concatenate(columns) for columns in (samples, first, last))
        ended = high == offsets[run[low] + 1] - 1
        begin = np.maximum(low - 1, offsets[run[low]])
        other = run[low] != run[high]
        end = np.where(other, offsets[run[low] + 1], np.minimum(high + 2, offsets[run[low] + 1]))
        missed = self._search_each(found, sample, begin, end, base, angle)
        again = missed & other
        begin, end = offsets[run[high[again]]], np.minimum(high[again] + 2, offsets[run[high[again]] + 1])
        self._search_each(found, sample[again], begin, end, base, angle)
        # past the end of its run a sample is free, if its rod is clear
        found.piece[sample[missed & ~other & ended]] = -1

    def _search_each(self, found: _Places, sample: Index, first: Index, stop: Index, base: Array, angle: Array) -> Mask:
        missed = np.ones(len(sample), dtype=bool)
        for start in range(0, len(sample), BLOCK):
            part = slice(start, start + BLOCK)
            here = sample[part]
            table, bounds = segments.cut_intervals(self.runs.path, first[part], stop[part], angle[here])
            self._leave_out_hollows(table)
            target = base[here][table.owner]
            crossing = (table.x0[:, 0] >= target) & (table.x0[:, 1] <= target)
            rows = np.minimum.reduceat(np.where(crossing, np.arange(len(target)), len(target)), bounds[:-1])
            on = rows < len(target)
            self._solve(found, table, here[on], rows[on], base)
            missed[part] = ~on
        return missed

    def _solve(self, found: _Places, table: segments.Segments, samples: Index, rows: Index, base: Array) -> None:
        for start in range(0, len(samples), BLOCK):
            part, row = samples[start : start + BLOCK], rows[start : start + BLOCK]
            piece, t, state = segments.UNIFORM.solve(self.runs.path, rows_of(table, row), base[part])
            slope, _, _ = self.runs.path.at(piece, t)
            good = np.isfinite(state.force + state.m0z + state.s1)
            # at touch-down the rod is still straight
            found.piece[part] = np.where(good, np.where(state.m0z > 0, piece, -1), -2)
            found.t[part], found.slope[part], found.tangential[part] = t, slope, table.tangential[row]
            found.force[part], found.m0z[part] = np.nan_to_num(state.force), np.nan_to_num(state.m0z)
            found.s1[part] = np.minimum(np.nan_to_num(state.s1, nan=1.0), 1.0)


def _passed(table: segments.Segments, part: slice, base: Array, place: int) -> Index:
    """Rows (n,) of the table on which a sweep is at base positions (n,), from a piece of the path on; -1 where on none."""
    begin, end = table.x0[part].T
    count = len(begin)
    crossing = (begin[:, None] >= base) & (end[:, None] <= base)
    row = 0
    if place >= 0:
        rows = np.flatnonzero(table.piece[part] == place)
        row = int(rows[0]) if len(rows) else 0
        if len(rows) and begin[row] < base[0]:
            back = np.flatnonzero(crossing[:row, 0])
            row = int(back[-1]) if len(back) else row
    found = np.full(len(base), -1)
    for j in range(len(base)):
        if row < count:
            ahead = int(np.argmax(crossing[row:, j]))
            if crossing[row + ahead, j]:
                row += ahead
                found[j] = part.start + row
    return found


class Runs(NamedTuple):
    """Paths in runs, those of each body in the order in which a sweep comes to them."""

    path: Path
    """All runs, its `offsets` by run."""
    body: Index
    """(runs,)"""
    run: Index
    """(p,) of each piece of the path."""
    piece: Index
    """(p,) of the outline."""
    u: Array
    """(p,) place on the outline's piece where the path's begins."""
    u_move: Array
    """(p,) its change over the path's piece, negative."""
    hollow: Index
    """(p,) concave vertices at the piece's ends, 2 on a concave vertex itself: with two no rod lies along it."""


def runs(outlines: Outlines) -> Runs:
    """The runs of all bodies that have straight edges only."""
    vertex = outlines.is_vertex
    straight = ~np.bincount(outlines.body, outlines.is_curved).astype(bool)[outlines.body]
    everything = np.arange(len(vertex))
    zero = np.zeros(len(vertex))
    edge = outlines.cubics[outlines.first[outlines.anchor]]
    # against the outline's direction: from the end of the outline's piece to its beginning
    point = edge[:, 0] + edge[:, 1]
    move = np.where(vertex[:, None], 0.0, -edge[:, 1])
    angle = np.arctan2(edge[:, 1, 1], edge[:, 1, 0])
    turn = np.where(vertex, -outlines.turn, 0.0)
    slope = angle - turn
    slope -= 2 * np.pi * np.round((slope + turn / 2) / (2 * np.pi))
    # what faces down, and is low enough
    low, high = zero.copy(), zero + 1
    with np.errstate(divide="ignore", invalid="ignore"):
        for bound, values, change in ((np.pi / 2, slope, turn), (1.0, point[:, 1], move[:, 1])):
            cut = (bound - values) / change
            low = np.where((values > bound) & (change < 0), np.maximum(low, cut), low)
            high = np.where((values + change > bound) & (change > 0), np.minimum(high, cut), high)
            out = (values > bound) & ~(change < 0)
            high = np.where(out, -1.0, high)
        cut = (-np.pi / 2 - slope) / turn
        low = np.where((slope < -np.pi / 2) & (turn > 0), np.maximum(low, cut), low)
        high = np.where((slope + turn < -np.pi / 2) & (turn < 0), np.minimum(high, cut), high)
        high = np.where((slope < -np.pi / 2) & ~(turn > 0), -1.0, high)
    faces = np.where(vertex, np.abs(slope + turn / 2) < np.pi, edge[:, 1, 0] > 0)
    kept = straight & faces & (low < high)
    joins = kept & (high == 1) & kept[outlines.previous] & (low[outlines.previous] == 0)
    begins = kept & ~joins[outlines.following]
    # each loop from the rightmost beginning on, the rightmost loop first
    loop = np.cumsum(outlines.previous >= everything) - 1  # the first piece of a loop follows on its last one
    at = point + low[:, None] * move
    first = np.lexsort((-at[:, 0], ~begins, loop))
    first = first[np.flatnonzero(np.diff(loop[first], prepend=-1))]
    size = np.bincount(loop, minlength=len(first))
    rank = np.remainder(first[loop] - everything, size[loop])
    rows = np.lexsort((rank, loop, -at[first, 0][loop], outlines.body))
    rows = rows[kept[rows]]
    run = np.cumsum(begins[rows]) - 1
    low, high = low[rows], high[rows]
    points = at[rows]
    cut = (low > 0) & (points[:, 1] > 1 - 1e-9)
    points[cut, 1] = 1.0  # where the tip of the upright rod touches first
    parts, of = subdivided(
        slope[rows] + low * turn[rows],
        (high - low) * turn[rows],
        points,
        (high - low)[:, None] * move[rows],
    )
    begin = np.flatnonzero(np.diff(of, prepend=-1))
    step = (np.arange(len(of)) - begin[of]) / np.bincount(of, minlength=len(rows))[of]
    share = (high - low) / np.bincount(of, minlength=len(rows))
    concave = vertex & (outlines.turn < 0)
    hollow = np.where(concave, 2, concave[outlines.previous].astype(int) + concave[outlines.following])
    offsets = np.append(np.flatnonzero(np.diff(run[of], prepend=-1)), len(of))
    return Runs(
        Path(*parts, offsets),
        outlines.body[rows][begins[rows]],
        run[of],
        rows[of],
        1 - low[of] - step * (high - low)[of],
        -share[of],
        hollow[rows[of]],
    )


# Points of a rod up to its contact; its polynomials of fifth order between them are exact to some 1e-11.
POINTS = 33
# Depth in the body, in rod lengths, that is more than the rounding of mesh files in single precision.
INSIDE = 1e-7


class Lines(NamedTuple):
    """Points of rods (n, k), from the clamp to the contact, and the tip."""

    s: Array
    x: Array
    y: Array
    phi: Array
    kappa: Array


def lines_of(x0: Array, kappa: Array, force_x: Array, force_y: Array, s1: Array) -> Lines:
    """Rods (n,) by their curvature at the clamp, internal force and contact; without force they are straight."""
    at = s1[:, None] * np.linspace(0, 1, POINTS)
    end = piece(force_x[:, None], force_y[:, None], np.full_like(at, np.pi / 2), kappa[:, None], at)
    # past the contact without a moment, not even a rounding one
    end.kappa[:, -1] = 0.0
    rest = 1 - s1
    tip = [
        np.ones_like(s1),
        end.x[:, -1] + rest * np.cos(end.phi[:, -1]),
        end.y[:, -1] + rest * np.sin(end.phi[:, -1]),
        end.phi[:, -1],
        np.zeros_like(s1),
    ]
    columns = [np.column_stack([a, b]) for a, b in zip((at, end.x, end.y, end.phi, end.kappa), tip, strict=True)]
    columns[1] += x0[:, None]
    return Lines(*columns)


def _on_rod(rods: Lines, row: Index, k: Index, w: Array) -> tuple[Array, Array, Array]:
    """Places x, y (m,) and slope of rods at shares w of their intervals k, by polynomials of fifth order."""
    h = rods.s[row, k + 1] - rods.s[row, k]
    left, right = (Lines(*(column[row, j] for column in rods)) for j in (k, k + 1))
    values = []
    cos, sin = (trig(np.stack([left.phi, right.phi])) for trig in (np.cos, np.sin))
    bend = h * h * np.stack([left.kappa, right.kappa])
    for a, b, first, second in ((left.x, right.x, cos, -sin), (left.y, right.y, sin, cos)):
        (c1, d1), (c2, d2) = h * first, bend * second / 2
        rest = b - a - c1 - c2
        first, second = d1 - c1 - 2 * c2, d2 - c2
        c3, c4, c5 = 10 * rest - 4 * first + second, -15 * rest + 7 * first - 2 * second, 6 * rest - 3 * first + second
        values.append(a + w * (c1 + w * (c2 + w * (c3 + w * (c4 + w * c5)))))
    phi = left.phi + w * (right.phi - left.phi)
    return values[0], values[1], phi


def _offsets(rods: Lines, row: Index, x: Array, y: Array) -> Array:
    """Distance (m,) of points to the left of their rods, above which or below which they lie; of distant ones an estimate."""
    n, count = rods.x.shape
    wide = 4.0
    grid = (rods.x - rods.x[:, :1]) + wide * np.arange(n)[:, None]
    k = np.searchsorted(grid.ravel(), x - rods.x[row, 0] + wide * row, side="right") - 1 - count * row
    k = np.clip(k, 0, count - 2)
    ax, ay, bx, by = rods.x[row, k], rods.y[row, k], rods.x[row, k + 1], rods.y[row, k + 1]
    length = np.hypot(bx - ax, by - ay)
    offset: Array = ratio((bx - ax) * (y - ay) - (by - ay) * (x - ax), length)
    bow = np.maximum(np.abs(rods.kappa[row, k]), np.abs(rods.kappa[row, k + 1])) * length**2 / 8
    near = np.flatnonzero(~((offset > 1.1 * bow + 1e-7) | (offset < -1e-7)))
    r, k, target, height = row[near], k[near], x[near], y[near]
    w = np.clip((target - ax[near]) / np.maximum(bx[near] - ax[near], 1e-300), 0, 1)
    h = rods.s[r, k + 1] - rods.s[r, k]
    for _ in range(3):
        px, py, phi = _on_rod(rods, r, k, w)
        # to the foot point: the offset is taken along the rod's normal
        along = (target - px) * np.cos(phi) + (height - py) * np.sin(phi)
        w = np.clip(w + along / np.maximum(h, 1e-300), 0, 1)
    px, py, phi = _on_rod(rods, r, k, w)
    offset[near] = (height - py) * np.cos(phi) - (target - px) * np.sin(phi)
    return offset


def crosses(vertices: Array, following: Index, rods: Lines) -> Mask:
    """Whether rods (n,) are inside of a polygon, whose `vertices` (v, 2) are each followed by another: (n,)."""
    n, start, end = len(rods.x), rods.x[:, :1], rods.x[:, -1:]
    vx, vy = vertices.T
    within = (vx > start) & (vx < end)
    row, vertex = np.nonzero(within)
    side = np.zeros(within.shape, dtype=np.int8)
    side[row, vertex] = np.where(_offsets(rods, row, vx[vertex], vy[vertex]) < -INSIDE, -1, 1)
    after = side[:, following]
    bad: Mask = np.asarray(((side * after) < 0).any(axis=1))

    # edges that pass the line of the tip, or of the clamp, above which the body is
    ex, ey = vx[following], vy[following]
    ends = []
    for line, tip in ((end, True), (start, False)):
        row, edge = np.nonzero(((vx < line) & (ex >= line)) | ((ex < line) & (vx >= line)))
        at = line[row, 0]
        height = vy[edge] + (ey[edge] - vy[edge]) * (at - vx[edge]) / (ex[edge] - vx[edge])
        limit, cosine = (rods.y[row, -1], np.cos(rods.phi[row, -1])) if tip else (0.0, 1.0)
        above = np.where((height - limit) * cosine < -INSIDE, -1, 1)
        inner = np.where(within[row, edge], edge, following[edge])
        known = within[row, inner]
        bad[row[known & (side[row, inner] * above < 0)]] = True
        ends.append((row, edge, above, known))
    # an edge over the whole rod
    over = {(r, e): a for r, e, a, k in zip(*ends[1], strict=True) if not k}
    for r, e, a, k in zip(*ends[0], strict=True):
        if not k and over.get((r, e), a) != a:
            bad[r] = True

    # edges with nothing on the right, below which the rod may bow out
    left = (side > 0) | (after > 0)
    left &= (side >= 0) & (after >= 0)
    row, edge = np.nonzero(left)
    dx, dy = ex[edge] - vx[edge], ey[edge] - vy[edge]
    slope = np.arctan2(np.where(dx < 0, -dy, dy), np.abs(dx))
    # the place at which the rod is parallel: its slope falls
    parallel = (slope < np.pi / 2) & (slope > rods.phi[row, -1])
    row, edge, slope = row[parallel], edge[parallel], slope[parallel]
    count = rods.phi.shape[1]
    falls = -(rods.phi - np.pi / 2) + 8.0 * np.arange(n)[:, None]
    k = np.searchsorted(falls.ravel(), np.pi / 2 - slope + 8.0 * row, side="right") - 1 - count * row
    k = np.clip(k, 0, count - 2)
    fall = rods.phi[row, k] - rods.phi[row, k + 1]
    w = np.clip((rods.phi[row, k] - slope) / np.maximum(fall, 1e-300), 0, 1)
    x, y, _ = _on_rod(rods, row, k, w)
    inside = (x > np.minimum(vx[edge], ex[edge])) & (x < np.maximum(vx[edge], ex[edge]))
    c, s = np.cos(slope), np.sin(slope)
    depth = c * (y - vy[edge]) - s * (x - vx[edge])
    bad[row[inside & (depth > INSIDE)]] = True
    return bad


def straight_crosses(vertices: Array, following: Index, x0: Array) -> Mask:
    """The same of straight rods at base positions (n,)."""
    a, b = vertices, vertices[following]
    low, high = np.minimum(a[:, 0], b[:, 0]), np.maximum(a[:, 0], b[:, 0])
    row, edge = np.nonzero((x0[:, None] > low + INSIDE) & (x0[:, None] < high - INSIDE))
    share = (x0[row] - a[edge, 0]) / (b[edge, 0] - a[edge, 0])
    height = a[edge, 1] + share * (b[edge, 1] - a[edge, 1])
    bad = np.zeros(len(x0), dtype=bool)
    bad[row[height < 1 - INSIDE]] = True
    return bad
