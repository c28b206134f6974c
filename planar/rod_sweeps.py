"""Equilibria of any rod along the path of a contour, and the states of its sweeps.

At a place of the contour with slope ``α̃`` the rod touches tangentially, ``φ1 = α̃`` with the unknown arc length ``s1``, or
with its tip, ``s1 = 1`` with the unknown slope ``φ1``; the second unknown is the size of the force, whose direction is
``α̃ + ζ``.  Marched back from the contact (`planar.rods`), the rod must arrive at its clamp: ``y = 0``,
``φ = π/2 + c M``.  The state at a base position is the first place of the path whose base position has come down to it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from planar import segments
from planar.arrays import Array, Index, Mask
from planar.contours import Path
from planar.rods import Rod, excess, grid, overhang, started, step
from planar.segments import LEVELS

# Steps along the rod for tables.
_COARSE = 4
# Change of a state by twice the steps, in rod lengths and radians, at which they suffice.
_AGREED = 1e-10
# Residual, in rod lengths and radians, at which an equilibrium is found.
_SOLVED = 1e-11


class Course(NamedTuple):
    """Where contacts (n,) may lie: a path, and for each row its contour and its friction angle."""

    path: Path
    contour: Index
    friction_angle: Array

    def rows(self, rows: Index | Mask) -> Course:
        return Course(self.path, self.contour[rows], self.friction_angle[rows])

    def at(self, place: Array) -> tuple[Array, Array, Array]:
        """Slope, x and y of the contour at places (n,): piece of the path plus its parameter."""
        first, stop = self.path.offsets[self.contour], self.path.offsets[self.contour + 1]
        piece = np.clip(np.nan_to_num(place).astype(np.intp), first, stop - 1)
        return self.path.at(piece, place - piece)


class Equilibria(NamedTuple):
    """Rods (n,) in contact; NaN where there is none."""

    place: Array
    tangential: Mask
    force: Array
    other: Array
    """Arc length s1 of tangential contacts, slope φ1 of the tip otherwise."""
    x0: Array
    moment: Array
    """Internal moment at the clamp."""

    @classmethod
    def near(cls, place: Array, tangential: Mask, force: Array, other: Array) -> Equilibria:
        """Where equilibria are looked for."""
        unknown = np.full((2, len(place)), np.nan)
        return cls(place, tangential, force, other, unknown[0], unknown[1])

    def rows(self, rows: Index | Mask) -> Equilibria:
        return Equilibria(*(column[rows] for column in self))  # type: ignore[arg-type]

    def put(self, rows: Index | Mask, states: Equilibria) -> None:
        for column, values in zip(self, states, strict=True):
            column[rows] = values


class _Clamped(NamedTuple):
    """Rods (n,) marched back to their clamps."""

    misfit: Array
    """(2, n) height of the base and angle to the clamp, which must vanish."""
    x0: Array
    moment: Array
    inflected: Mask
    """Where the moment changes its sign between clamp and contact: solutions behind the end of a sweep's branch."""


def _back(rod: Rod, course: Course, place: Array, tangential: Mask, force: Array, other: Array, steps: int) -> _Clamped:
    slope, x, y = course.at(place)
    alpha = slope + course.friction_angle
    at, phi = np.where(tangential, other, 1.0), np.where(tangential, slope, other)
    rod = rod.rows(course.contour)
    hangs = overhang(rod)
    carried = force * np.stack([np.sin(alpha), -np.cos(alpha)])
    state = started(rod, phi, np.zeros(len(phi)), np.stack([x, y]), carried)
    state[2] = -excess(hangs, at, state)
    inflected = np.zeros(len(at), dtype=bool)
    for lower in grid(rod.profile, steps)[::-1]:
        below = np.minimum(at, lower)
        if (below < at).any():
            state = step(rod, state, at, below - at)
            inflected |= (below < at) & (force > 0) & (excess(hangs, below, state) >= 0)
        at = below
    cosine, sine, moment, x, y = state[:5]
    tilt = np.arctan2(-cosine, sine)  # of the rod at its clamp from the y axis
    return _Clamped(np.stack([y, tilt - rod.compliance * moment]), x, moment, inflected)


def _newton(residuals: Callable[[Array, Index], Array], start: Array, scale: Array) -> tuple[Array, Mask]:
    """Roots (k, n) of k functions (k, n) of k unknowns, near `start`; and where they were found.

    `residuals` takes unknowns and the indices of their rows.  Derivatives by differences, corrected by Broyden's rule
    in between; a step is at most `scale` (k, n).
    """
    z, found = start.copy(), np.zeros(start.shape[1], dtype=bool)
    rows = np.arange(start.shape[1])
    slopes = np.zeros((len(rows), len(z), len(z)))
    value = residuals(z, rows)
    for iteration in range(24):
        solved = np.abs(value).max(axis=0) < _SOLVED
        found[rows[solved]] = True
        going = ~solved & np.isfinite(value).all(axis=0)
        rows, value, slopes = rows[going], value[:, going], slopes[going]
        if not len(rows):
            break
        here = z[:, rows]
        if iteration % 3 == 0:
            for k in range(len(z)):
                moved = here.copy()
                moved[k] += 1e-7
                slopes[:, :, k] = ((residuals(moved, rows) - value) / 1e-7).T
        with np.errstate(all="ignore"):
            determinant = np.linalg.det(slopes)
            slopes[~(np.abs(determinant) > 0)] = np.nan
            step = np.full_like(here, np.nan)
            regular = np.isfinite(slopes).all(axis=(1, 2))
            step[:, regular] = np.linalg.solve(slopes[regular], -value[:, regular].T[..., None])[..., 0].T
            step *= np.minimum(1.0, (scale[:, rows] / np.abs(step)).min(axis=0))
            z[:, rows] = here + step
            value = residuals(z[:, rows], rows)
            slopes += value.T[:, :, None] * step.T[:, None, :] / (step * step).sum(axis=0)[:, None, None]
    return z, found


def _solve(rod: Rod, course: Course, start: Equilibria) -> Equilibria:
    """Equilibria at the places of `start`, of its kinds, near its other values."""

    def misfit(z: Array, rows: Index) -> Array:
        return _back(rod, course.rows(rows), start.place[rows], start.tangential[rows], z[0], z[1], _COARSE).misfit

    z, found = _newton(misfit, np.stack([start.force, start.other]), _scales(start.force))
    return _known(rod, course, start._replace(force=z[0], other=z[1]), found & (z[0] >= 0), _COARSE)


def _known(rod: Rod, course: Course, states: Equilibria, found: Mask, steps: int) -> Equilibria:
    """The states with their base positions and moments, NaN where they were not found."""
    end = _back(rod, course, *states[:4], steps)
    found = found & ~end.inflected
    columns = (np.where(found, column, np.nan) for column in (states.force, states.other, end.x0, end.moment))
    return Equilibria(states.place, states.tangential, *columns)


def _scales(force: Array) -> Array:
    """The largest steps (2, n) of force and of the other unknown."""
    return np.stack([np.maximum(np.abs(force), 0.05) / 2, np.full(len(force), 0.2)])


class Table(NamedTuple):
    """Equilibria of many sweeps along their paths, sorted by owner and place."""

    sweeps: Course
    """(k,) of the owners."""
    owner: Index
    states: Equilibria

    @property
    def course(self) -> Course:
        return self.sweeps.rows(self.owner)

    def merged(self, owner: Index, states: Equilibria) -> Table:
        """With further rows, each behind the rows of its owner at the same place."""
        owners = np.concatenate([self.owner, owner])
        joined = Equilibria(*(np.concatenate(pair) for pair in zip(self.states, states, strict=True)))
        order = np.lexsort((joined.place, owners))
        return Table(self.sweeps, owners[order], joined.rows(order))

    def following(self) -> Index:
        """The rows whose next row is of the same owner."""
        return np.flatnonzero(self.owner[1:] == self.owner[:-1])


def table(rod: Rod, sweeps: Course) -> Table:
    """The equilibria of sweeps (k,)."""
    path = sweeps.path
    first, stop = path.offsets[sweeps.contour], path.offsets[sweeps.contour + 1]
    count = stop - first + 1
    owner = np.repeat(np.arange(len(count)), count)
    place = (np.arange(len(owner)) - np.repeat(np.cumsum(count) - count - first, count)).astype(float)
    course = sweeps.rows(owner)
    slope, x, y = course.at(place)
    tangential = segments.is_tangential(slope, y, course.friction_angle)
    uniform = segments.states(tangential, slope, x, y, course.friction_angle)
    alpha = slope + course.friction_angle
    k = np.sqrt(np.sin(alpha / 2) ** 2 + uniform.q**2)
    tip_slope = alpha + np.pi / 2 - 2 * np.arcsin(np.minimum(k, 1.0))  # (12)
    force = uniform.root_f**2 * _softness(rod, np.where(tangential, np.minimum(uniform.s1, 1.0), 1.0))
    start = Equilibria.near(place, tangential, force, np.where(tangential, uniform.s1, tip_slope))
    result = _from_touch_down(rod, _led_on(rod, Table(sweeps, owner, _of_either_kind(rod, course, start))))
    for _ in range(24):  # a piece of the path, halved so often, is as short as the accuracy of its ends
        result = _halved(rod, result)
    return result


def _softness(rod: Rod, s1: Array) -> Array:
    """Small forces at s1 (n,) relative to those that bend the uniform rod as far there."""
    s = np.linspace(0.0, 1.0, 65)
    part = s[:, None] * s1
    bent = np.trapezoid((s1 - part) ** 2 / rod.profile.bending_stiffness(part), s, axis=0)
    return np.asarray(s1**2 / 3 / bent)


def _of_either_kind(rod: Rod, course: Course, start: Equilibria) -> Equilibria:
    """Equilibria near the start, tangential where the rod is long enough, with the tip otherwise."""
    found = _solve(rod, course, start)
    for _ in range(2):
        slope = course.at(found.place)[0]
        rows = np.flatnonzero(np.where(found.tangential, found.other > 1, found.other < slope))
        if not len(rows):
            break
        turned, part = found.rows(rows), course.rows(rows)
        kind = ~turned.tangential
        turned = turned._replace(tangential=kind, other=_as_kind(part, turned, kind))
        found.put(rows, _solve(rod, part, turned))
    else:
        slope = course.at(found.place)[0]
        neither = np.where(found.tangential, found.other > 1 + _SOLVED, found.other < slope - _SOLVED)
        for column in found[2:]:
            column[neither] = np.nan
    return found


def _led_on(rod: Rod, table: Table) -> Table:
    """Rows without an equilibrium, tried from their neighbours' ones, as long as that finds any."""
    states, course = table.states, table.course
    while True:
        known = np.isfinite(states.force)
        rows = table.following()
        after, before = rows[known[rows] & ~known[rows + 1]], rows[~known[rows] & known[rows + 1]]
        tried, where = np.unique(np.concatenate([after + 1, before]), return_index=True)
        source = np.concatenate([after, before + 1])[where]
        if not len(tried):
            break
        slope, other, kind = course.at(states.place)[0], states.other[source], states.tangential[source]
        other = np.where(kind, other, other + slope[tried] - slope[source])
        start = Equilibria.near(states.place[tried], kind, states.force[source], other)
        found = _of_either_kind(rod, course.rows(tried), start)
        if not np.isfinite(found.force).any():
            break
        states.put(tried, found)
    return table


def _from_touch_down(rod: Rod, table: Table) -> Table:
    """With the place of touch-down of each owner, where the force vanishes."""
    states = table.states
    forced = np.flatnonzero(states.force > 0)
    rows = forced[np.unique(table.owner[forced], return_index=True)[1]]
    owner, first = table.owner[rows], states.rows(rows)
    course, zero, found = table.sweeps.rows(owner), np.zeros(len(rows)), np.zeros(len(rows), dtype=bool)
    for tangential in (first.tangential, ~first.tangential):

        def misfit(z: Array, some: Index, kind: Mask = tangential) -> Array:
            return _back(rod, course.rows(some), z[0], kind[some], zero[some], z[1], _COARSE).misfit

        other = _as_kind(course, first, tangential)
        z, solved = _newton(misfit, np.stack([first.place, other]), np.full((2, len(rows)), 0.5))
        solved &= np.where(tangential, z[1] <= 1 + _SOLVED, z[1] >= course.at(z[0])[0] - _SOLVED)
        solved &= (z[0] <= first.place) & (z[0] >= course.path.offsets[course.contour] - _SOLVED) & ~found
        at = _known(rod, course, Equilibria.near(z[0], tangential, zero, z[1]), solved, _COARSE)
        table = table.merged(owner[solved], at.rows(solved))
        found |= solved
    return table


def _as_kind(course: Course, states: Equilibria, tangential: Mask) -> Array:
    """The other unknown (n,) of the states, or, where they are of the other kind, where the two kinds meet."""
    meeting = np.where(tangential, 1.0, course.at(states.place)[0])
    return np.where(tangential == states.tangential, states.other, meeting)


def _halved(rod: Rod, table: Table) -> Table:
    """With places in the middle of intervals in which a branch begins or ends, changes its kind, leaves touch-down, or on
    either side of a place at which the base position is least."""
    states, rows = table.states, table.following()
    known, x0 = np.isfinite(states.force), np.where(np.isfinite(states.x0), states.x0, np.inf)
    before, after = known[rows], known[rows + 1]
    least = np.zeros(len(known) + 1, dtype=bool)
    least[1:-2] = (x0[1:-1] < x0[:-2]) & (x0[1:-1] < x0[2:])
    turns = (least[rows] | least[rows + 1]) & before & after
    touched = (states.force[rows] == 0) | (states.force[rows + 1] == 0)
    changes = touched | (states.tangential[rows] != states.tangential[rows + 1])
    chosen = (before != after) | turns | (before & after & changes)
    chosen &= states.place[rows + 1] - states.place[rows] > _SOLVED
    rows, between = rows[chosen], (before & after)[chosen]
    owner, course = table.owner[rows], table.course.rows(rows)
    first, second = states.rows(rows), states.rows(rows + 1)
    middle = (first.place + second.place) / 2
    second = second._replace(other=_as_kind(table.course.rows(rows + 1), second, first.tangential))
    start = states.rows(np.where(known[rows], rows, rows + 1))
    start.put(between, _mixed(first, second, np.full(len(rows), 0.5)).rows(between))
    found = _of_either_kind(rod, course, start._replace(place=middle))
    # force and slope approach touch-down as the distance, or as its root where a force across a straight rod lowers its tip
    again = np.flatnonzero(~np.isfinite(found.force) & between)
    root = _mixed(first.rows(again), second.rows(again), np.full(len(again), np.sqrt(0.5)))
    found.put(again, _of_either_kind(rod, course.rows(again), root._replace(place=middle[again])))
    kept = np.isfinite(found.force) | ~between
    return table.merged(owner[kept], found.rows(kept))


def _mixed(first: Equilibria, second: Equilibria, part: Array) -> Equilibria:
    """Between two equilibria of the kind of the first, at fractions (n,) of the way."""
    place, force, other, x0, moment = (
        a + part * (b - a) for a, b in zip((first[0], *first[2:]), (second[0], *second[2:]), strict=True)
    )
    return Equilibria(place, first.tangential, force, other, x0, moment)


def _located(table: Table, owner: Index, x0: Array) -> tuple[Equilibria, Mask]:
    """Starts for the states of owners (n,) at base positions (n,), and whether their sweeps touch there.

    The state is between the first row whose base position is not above x0 and the row before it.
    """
    reached = np.where(np.isfinite(table.states.x0), table.states.x0, np.inf)
    bounds = np.searchsorted(table.owner, np.arange(owner.max(initial=-1) + 2))
    row, touches = np.zeros(len(x0), dtype=np.intp), np.zeros(len(x0), dtype=bool)
    for k in np.unique(owner):
        x0_of = reached[bounds[k] : bounds[k + 1]]
        samples = owner == k
        at = np.searchsorted(-np.minimum.accumulate(x0_of), -x0[samples])
        touches[samples] = (at < len(x0_of)) & (x0[samples] <= x0_of[np.isfinite(x0_of)].max(initial=-np.inf))
        row[samples] = bounds[k] + np.clip(at, 1, len(x0_of) - 1) - 1
    touches &= np.isfinite(reached[row]) & np.isfinite(reached[row + 1])
    with np.errstate(all="ignore"):
        part = (reached[row] - x0) / (reached[row] - reached[row + 1])
        return _mixed(table.states.rows(row), table.states.rows(row + 1), part), touches


class Tables(NamedTuple):
    """Tables of each contour (c,) at one angle of friction, or at some evenly spaced ones."""

    table: Table
    lowest: Array
    spacing: Array
    levels: Index
    first: Index
    """The owner of each contour's lowest angle."""

    @property
    def spans(self) -> Array:
        """Base positions (c, 2) at which sweeps with the lowest angles touch and at which they end."""
        span, x0 = np.full((len(self.table.sweeps.contour), 2), np.nan), self.table.states.x0
        rows = np.flatnonzero(np.isfinite(x0))[::-1]
        span[self.table.owner[rows], 0] = x0[rows]
        np.fmin.at(span[:, 1], self.table.owner, x0)
        return span[self.first]


def tables(rod: Rod, path: Path, lowest: Array, highest: Array) -> Tables:
    """The tables of contours (c,) of a path between angles of friction."""
    count = np.where(highest > lowest, LEVELS, 1)
    owner = np.repeat(np.arange(len(count)), count)
    first = np.cumsum(count) - count
    spacing = np.where(highest > lowest, highest - lowest, 1.0) / (LEVELS - 1)
    angle = lowest[owner] + (np.arange(len(owner)) - first[owner]) * spacing[owner]
    return Tables(table(rod, Course(path, owner, angle)), lowest, spacing, count, first)


def states(rod: Rod, tables: Tables, course: Course, x0: Array) -> Equilibria:
    """The states (n,) of sweeps along a course at base positions; NaN where the rod does not touch."""
    contour = course.contour
    position = (course.friction_angle - tables.lowest[contour]) / tables.spacing[contour]
    first, count = tables.first[contour], tables.levels[contour]
    level = np.minimum(position.astype(np.intp), np.maximum(count - 2, 0))
    low, high = (_located(tables.table, first + k, x0) for k in (level, np.minimum(level + 1, count - 1)))
    alike = low[1] & high[1] & (low[0].tangential == high[0].tangential)
    with np.errstate(invalid="ignore"):
        alike &= np.abs(low[0].place - high[0].place) < 1
        start = _mixed(low[0], high[0], position - level)
    result = Equilibria(np.full(len(x0), np.nan), np.zeros(len(x0), dtype=bool), *np.full((4, len(x0)), np.nan))
    rows = np.flatnonzero(alike)
    result.put(rows, _solved(rod, course.rows(rows), start.rows(rows), x0[rows]))
    # samples in different states at the two angles are sought in tables of their own
    rows = np.flatnonzero((low[1] | high[1]) & ~np.isfinite(result.x0) & (count > 1))
    # a hundred tables at once, for memory
    for some in np.array_split(rows, -(-len(rows) // 100)) if len(rows) else []:
        start, touches = _located(table(rod, course.rows(some)), np.arange(len(some)), x0[some])
        inside = some[touches]
        result.put(inside, _solved(rod, course.rows(inside), start.rows(touches), x0[inside]))
    return result


def _solved(rod: Rod, course: Course, start: Equilibria, x0: Array) -> Equilibria:
    """Equilibria (n,) at base positions, near the start; NaN where none was found."""
    steps, states = 8, start
    while True:

        def misfit(z: Array, rows: Index, n: int = steps) -> Array:
            end = _back(rod, course.rows(rows), z[0], start.tangential[rows], z[1], z[2], n)
            return np.concatenate([end.misfit, (end.x0 - x0[rows])[None]])

        z = np.stack([states.place, states.force, states.other])
        z, found = _newton(misfit, z, np.concatenate([np.full((1, len(x0)), 0.5), _scales(states.force)]))
        states = states._replace(place=z[0], force=z[1], other=z[2])
        with np.errstate(invalid="ignore"):
            finer = np.abs(misfit(z[:, found], np.flatnonzero(found), 2 * steps)).max(initial=0.0)
        if finer < _AGREED or steps >= 128:
            break
        steps *= 2
    slope = course.at(states.place)[0]
    kept = np.where(states.tangential, states.other <= 1 + _AGREED, states.other >= slope - _AGREED)
    return _known(rod, course, states, found & (states.force >= 0) & kept, steps)
