"""Equilibria of any rod along the path of a contour, and the states of its sweeps.

At a place of the contour with slope ``α̃`` the rod touches tangentially, ``φ1 = α̃`` with the unknown arc length ``s1``, or
with its tip, ``s1 = 1`` with the unknown slope ``φ1``; the second unknown is the size of the force, whose direction is
``α̃ + ζ``.  Marched back from the contact (`planar.march`), the rod must arrive at its clamp: ``y = 0``,
``φ = π/2 + c M``.  The state at a base position is the first place of the path whose base position has come down to it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from planar import equilibria, march
from planar.arrays import Array, Index, Mask
from planar.paths import Path
from planar.rods import Rod

# Steps along the rod for tables, and for samples.
_COARSE, _FINE, _MOST_STEPS = 4, 8, 128
# Change of a state by twice the steps, in rod lengths and radians, at which they suffice.
_AGREED = 1e-10
# Angles of friction at which the sweeps of a contour are tabulated, and tables that are made at once.
_LEVELS, _TABLES = 3, 100
# Residual, in rod lengths and radians, at which an equilibrium is found.
_SOLVED = 1e-11
# Iterations; one in three computes the derivatives anew.
_ITERATIONS, _ANEW = 24, 3
# Places between touch-down and the next place of a table, each half as far as the one before.
_GRADED = 24
# Halvings of the interval in which a branch ends.
_HALVINGS = 8


class Course(NamedTuple):
    """Where contacts (n,) may lie: a path and, for each row, its friction angle, first and last piece of its contour."""

    path: Path
    friction_angle: Array
    first: Index
    last: Index

    @classmethod
    def of(cls, path: Path, contour: Index, friction_angle: Array) -> Course:
        """Rows (n,) on contours of the path."""
        return cls(path, friction_angle, path.offsets[contour], path.offsets[contour + 1] - 1)

    def rows(self, rows: Index | Mask) -> Course:
        return Course(self.path, self.friction_angle[rows], self.first[rows], self.last[rows])

    def at(self, place: Array) -> tuple[Array, Array, Array]:
        """Slope, x and y of the contour at places (n,): piece of the path plus its parameter."""
        piece = np.clip(np.nan_to_num(place).astype(np.intp), self.first, self.last)
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
    hangs = march.overhang(rod)
    carried = force * np.stack([np.sin(alpha), -np.cos(alpha)])
    state = march.started(phi, hangs(at, np.exp(1j * phi)), np.stack([x, y]), carried)
    inflected = np.zeros(len(at), dtype=bool)
    for lower in march.grid(rod.profile, steps)[::-1]:
        below = np.minimum(at, lower)
        if (below < at).any():
            state = march.step(rod, state, at, below - at)
            inflected |= (below < at) & (force > 0) & (march.excess(hangs, below, state) >= 0)
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
    for iteration in range(_ITERATIONS):
        solved = np.abs(value).max(axis=0) < _SOLVED
        found[rows[solved]] = True
        going = ~solved & np.isfinite(value).all(axis=0)
        rows, value, slopes = rows[going], value[:, going], slopes[going]
        if not len(rows):
            break
        here = z[:, rows]
        if iteration % _ANEW == 0:
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


def _solve(rod: Rod, course: Course, start: Equilibria, steps: int) -> Equilibria:
    """Equilibria at the places of `start`, of its kinds, near its other values."""

    def misfit(z: Array, rows: Index) -> Array:
        return _back(rod, course.rows(rows), start.place[rows], start.tangential[rows], z[0], z[1], steps).misfit

    z, found = _newton(misfit, np.stack([start.force, start.other]), _scales(start.force))
    return _known(rod, course, start._replace(force=z[0], other=z[1]), found & (z[0] >= 0), steps)


def _known(rod: Rod, course: Course, states: Equilibria, found: Mask, steps: int) -> Equilibria:
    """The states with their base positions and moments, NaN where they were not found."""
    end = _back(rod, course, *states[:4], steps)
    found = found & ~end.inflected
    columns = (np.where(found, column, np.nan) for column in (states.force, states.other, end.x0, end.moment))
    return Equilibria(states.place, states.tangential, *columns)


def _taken(states: Equilibria, rows: Index | Mask) -> Equilibria:
    return Equilibria(
        states.place[rows],
        states.tangential[rows],
        states.force[rows],
        states.other[rows],
        states.x0[rows],
        states.moment[rows],
    )


def _scales(force: Array) -> Array:
    """The largest steps (2, n) of force and of the other unknown."""
    return np.stack([np.maximum(np.abs(force), 0.05) / 2, np.full(len(force), 0.2)])


class Table(NamedTuple):
    """Equilibria of many sweeps along their paths, sorted by owner and place."""

    owner: Index
    course: Course
    states: Equilibria

    def merged(self, owner: Index, course: Course, states: Equilibria) -> Table:
        """With further rows, each behind the rows of its owner at the same place."""
        owners = np.concatenate([self.owner, owner])
        columns = [np.concatenate(pair) for pair in zip(self.states, states, strict=True)]
        order = np.lexsort((np.arange(len(owners)), columns[0], owners))
        joined = Course(
            self.course.path,
            np.concatenate([self.course.friction_angle, course.friction_angle])[order],
            np.concatenate([self.course.first, course.first])[order],
            np.concatenate([self.course.last, course.last])[order],
        )
        return Table(owners[order], joined, Equilibria(*(column[order] for column in columns)))

    def following(self) -> Index:
        """The rows whose next row is of the same owner."""
        return np.flatnonzero(self.owner[1:] == self.owner[:-1])


def table(rod: Rod, path: Path, contour: Index, friction_angle: Array) -> Table:
    """The equilibria of sweeps (k,) along contours of the path, each with one angle of friction."""
    first, stop = path.offsets[contour], path.offsets[contour + 1]
    count = stop - first + 1
    owner = np.repeat(np.arange(len(contour)), count)
    place = (np.arange(len(owner)) - np.repeat(np.cumsum(count) - count - first, count)).astype(float)
    course = Course.of(path, contour[owner], friction_angle[owner])
    slope, x, y = course.at(place)
    tangential = equilibria.is_tangential(slope, y, course.friction_angle)
    uniform = equilibria.states(tangential, slope, x, y, course.friction_angle)
    alpha = slope + course.friction_angle
    k = np.sqrt(np.sin(alpha / 2) ** 2 + uniform.q**2)
    tip_slope = alpha + np.pi / 2 - 2 * np.arcsin(np.minimum(k, 1.0))  # (12)
    unknown = np.full(len(place), np.nan)
    other = np.where(tangential, uniform.s1, tip_slope)
    force = uniform.root_f**2 * _softness(rod, np.where(tangential, np.minimum(uniform.s1, 1.0), 1.0))
    start = Equilibria(place, tangential, force, other, unknown, unknown)
    found = _of_either_kind(rod, course, start)
    result = Table(owner, course, found)
    result = _from_touch_down(rod, _led_on(rod, result))
    result = _with_transitions(rod, _with_ends(rod, result))
    return _with_folds(rod, result)


def _softness(rod: Rod, s1: Array) -> Array:
    """Small forces at s1 (n,) relative to those that bend the uniform rod as far there."""
    s = np.linspace(0.0, 1.0, 65)
    part = s[:, None] * s1
    bent = np.trapezoid((s1 - part) ** 2 / rod.profile.bending_stiffness(part), s, axis=0)
    return np.asarray(s1**2 / 3 / bent)


def _of_either_kind(rod: Rod, course: Course, start: Equilibria) -> Equilibria:
    """Equilibria near the start, tangential where the rod is long enough, with the tip otherwise."""
    found = _solve(rod, course, start, _COARSE)
    for _ in range(2):
        slope = course.at(found.place)[0]
        too_short = found.tangential & (found.other > 1)
        inside = ~found.tangential & (found.other < slope)
        rows = np.flatnonzero(too_short | inside)
        if not len(rows):
            break
        turned = _taken(found, rows)
        kind = ~turned.tangential
        turned = turned._replace(tangential=kind, other=_as_kind(course.rows(rows), turned, kind))
        for column, values in zip(found, _solve(rod, course.rows(rows), turned, _COARSE), strict=True):
            column[rows] = values
    else:
        slope = course.at(found.place)[0]
        neither = np.where(found.tangential, found.other > 1 + _SOLVED, found.other < slope - _SOLVED)
        for column in found[2:]:
            column[neither] = np.nan
    return found


def _led_on(rod: Rod, table: Table) -> Table:
    """Rows without an equilibrium, tried from their neighbours' ones, as long as that finds any."""
    states = table.states
    while True:
        known = np.isfinite(states.force)
        rows = table.following()
        after, before = rows[known[rows] & ~known[rows + 1]], rows[~known[rows] & known[rows + 1]]
        tried, source = np.concatenate([after + 1, before]), np.concatenate([after, before + 1])
        tried, where = np.unique(tried, return_index=True)
        source = source[where]
        if not len(tried):
            break
        slope, other = table.course.at(states.place)[0], states.other[source]
        other = np.where(states.tangential[source], other, other + slope[tried] - slope[source])
        start = Equilibria(
            states.place[tried],
            states.tangential[source],
            states.force[source],
            other,
            *np.full((2, len(tried)), np.nan),
        )
        found = _of_either_kind(rod, table.course.rows(tried), start)
        if not np.isfinite(found.force).any():
            break
        for column, values in zip(states, found, strict=True):
            column[tried] = values
    return table


def _from_touch_down(rod: Rod, table: Table) -> Table:
    """With the place of touch-down of each owner, where the force vanishes, and places that approach it."""
    states = table.states
    forced = np.flatnonzero(states.force > 0)
    rows = forced[np.unique(table.owner[forced], return_index=True)[1]]
    owner, course, first = table.owner[rows], table.course.rows(rows), _taken(states, rows)
    zero, found, touched = np.zeros(len(rows)), np.zeros(len(rows), dtype=bool), _taken(states, rows)
    for tangential in (first.tangential, ~first.tangential):
        other = _as_kind(course, first, tangential)

        def misfit(z: Array, some: Index, kind: Mask = tangential) -> Array:
            return _back(rod, course.rows(some), z[0], kind[some], zero[some], z[1], _COARSE).misfit

        z, solved = _newton(misfit, np.stack([first.place, other]), np.full((2, len(rows)), 0.5))
        slope = course.at(z[0])[0]
        solved &= np.where(tangential, z[1] <= 1 + _SOLVED, z[1] >= slope - _SOLVED)
        solved &= (z[0] <= first.place) & (z[0] >= course.first - _SOLVED) & ~found
        at = _known(rod, course, Equilibria(z[0], tangential, zero, z[1], zero, zero), solved, _COARSE)
        for column, values in zip(touched, at, strict=True):
            column[solved] = values[solved]
        found |= solved
    owner, course, first, touched = owner[found], course.rows(found), _taken(first, found), _taken(touched, found)
    table = table.merged(owner, course, touched)
    # force and slope approach theirs as the distance, or as its root where a force across a straight rod lowers its tip
    kind, end = touched.tangential, _as_kind(course, first, touched.tangential)
    gap, change = first.force, end - touched.other
    ratio = np.full(len(owner), np.sqrt(0.5))
    for j in range(1, _GRADED):
        place = touched.place + 0.5**j * (first.place - touched.place)
        for guess in (ratio, np.full(len(owner), 0.5)):
            start = Equilibria(place, kind, gap * guess, touched.other + change * guess, zero[found], zero[found])
            states = _of_either_kind(rod, course, start)
            if np.isfinite(states.force).all():
                break
        known = np.isfinite(states.force)
        ratio = np.where(known, np.clip(states.force / gap, 0.4, 0.8), ratio)
        gap = np.where(known, states.force, gap * ratio)
        change = np.where(known & (states.tangential == kind), states.other - touched.other, change * ratio)
        table = table.merged(owner[known], course.rows(known), _taken(states, known))
    return table


def _as_kind(course: Course, states: Equilibria, tangential: Mask) -> Array:
    """The other unknown (n,) of the states, or, where they are of the other kind, where the two kinds meet."""
    meeting = np.where(tangential, 1.0, course.at(states.place)[0])
    return np.where(tangential == states.tangential, states.other, meeting)


def _with_ends(rod: Rod, table: Table) -> Table:
    """With places closer to those at which a row of equilibria begins or ends."""
    for _ in range(_HALVINGS):
        known, rows = np.isfinite(table.states.force), table.following()
        rows = rows[known[rows] != known[rows + 1]]
        source = np.where(known[rows], rows, rows + 1)
        start = _taken(table.states, source)
        start = start._replace(place=(table.states.place[rows] + table.states.place[rows + 1]) / 2)
        course = table.course.rows(rows)
        table = table.merged(table.owner[rows], course, _of_either_kind(rod, course, start))
    return table


def _with_transitions(rod: Rod, table: Table) -> Table:
    """With the places at which tip and tangential contact change into each other, once as the one and once as the other."""
    states, rows = table.states, table.following()
    rows = rows[np.isfinite(states.force[rows]) & np.isfinite(states.force[rows + 1])]
    rows = rows[states.tangential[rows] != states.tangential[rows + 1]]
    course, low = table.course.rows(rows), states.place[rows]
    tip = np.zeros(len(rows), dtype=bool)

    def misfit(z: Array, some: Index) -> Array:
        part = course.rows(some)
        return _back(rod, part, z[0], tip[some], z[1], part.at(z[0])[0], _COARSE).misfit

    start = np.stack([(low + states.place[rows + 1]) / 2, (states.force[rows] + states.force[rows + 1]) / 2])
    z, found = _newton(misfit, start, np.stack([states.place[rows + 1] - low, _scales(start[1])[0]]))
    found &= (z[0] >= low) & (z[0] <= states.place[rows + 1])
    course, owner, z, rows = course.rows(found), table.owner[rows[found]], z[:, found], rows[found]
    for side in (rows, rows + 1):
        kind = states.tangential[side]
        other = np.where(kind, 1.0, course.at(z[0])[0])
        unknown = np.full(len(rows), np.nan)
        at = _known(
            rod, course, Equilibria(z[0], kind, z[1], other, unknown, unknown), np.ones(len(rows), bool), _COARSE
        )
        table = table.merged(owner, course, at)
    return table


def _with_folds(rod: Rod, table: Table) -> Table:
    """With the places at which the base position is least, by parabolas through three neighbours."""
    for _ in range(3):
        states = table.states
        inner = np.intersect1d(table.following(), table.following() + 1)
        x0, place = states.x0, states.place
        lowest = inner[(x0[inner] < x0[inner - 1]) & (x0[inner] < x0[inner + 1])]
        lowest = lowest[
            (states.tangential[lowest - 1] == states.tangential[lowest])
            & (states.tangential[lowest + 1] == states.tangential[lowest])
        ]
        a, b = place[lowest] - place[lowest - 1], place[lowest + 1] - place[lowest]
        down, up = (x0[lowest] - x0[lowest - 1]) / a, (x0[lowest + 1] - x0[lowest]) / b
        with np.errstate(all="ignore"):
            at = place[lowest] - (down * b + up * a) / (2 * (up - down))
        apart = (np.abs(at - place[lowest]) > 1e-9) & (at > place[lowest - 1]) & (at < place[lowest + 1])
        rows, at = lowest[apart], at[apart]
        if not len(rows):
            break
        start = _taken(states, rows)._replace(place=at)
        course = table.course.rows(rows)
        found = _solve(rod, course, start, _COARSE)
        keep = np.isfinite(found.force)
        table = table.merged(table.owner[rows[keep]], course.rows(keep), _taken(found, keep))
    return table


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
        return _mixed(_taken(table.states, row), _taken(table.states, row + 1), part), touches


def spans(rod: Rod, path: Path, friction_angle: Array) -> Array:
    """Base positions (contours, 2) at which sweeps of the contours (with friction angles) touch and at which they end."""
    contours = np.arange(len(friction_angle))
    states = table(rod, path, contours, friction_angle)
    span = np.full((len(contours), 2), np.nan)
    rows = np.flatnonzero(np.isfinite(states.states.x0))[::-1]
    span[states.owner[rows], 0] = states.states.x0[rows]
    np.fmin.at(span[:, 1], states.owner, states.states.x0)
    return span


def states(rod: Rod, path: Path, contour: Index, friction_angle: Array, x0: Array) -> Equilibria:
    """The states (n,) of sweeps along contours with friction angles at base positions; NaN where the rod does not touch."""
    # each contour is tabulated at one angle or at some evenly spaced ones, between two of which a sample is sought
    contours = len(path.offsets) - 1
    lowest, highest = np.full(contours, np.inf), np.full(contours, -np.inf)
    np.minimum.at(lowest, contour, friction_angle)
    np.maximum.at(highest, contour, friction_angle)
    count = np.where(highest > lowest, _LEVELS, 1) * (highest >= lowest)
    owner = np.repeat(np.arange(contours), count)
    first = np.cumsum(count) - count
    spacing = np.where(highest > lowest, highest - lowest, 1.0) / (_LEVELS - 1)
    tables = table(rod, path, owner, lowest[owner] + (np.arange(len(owner)) - first[owner]) * spacing[owner])
    position = (friction_angle - lowest[contour]) / spacing[contour]
    level = np.minimum(position.astype(np.intp), np.maximum(count[contour] - 2, 0))
    low, high = (_located(tables, first[contour] + k, x0) for k in (level, np.minimum(level + 1, count[contour] - 1)))
    alike = low[1] & high[1] & (low[0].tangential == high[0].tangential)
    part, course = position - level, Course.of(path, contour, friction_angle)
    with np.errstate(invalid="ignore"):
        alike &= np.abs(low[0].place - high[0].place) < 1
        start = _mixed(low[0], high[0], part)
    result = _empty(len(x0))
    rows = np.flatnonzero(alike)
    _put(result, rows, _solved(rod, course.rows(rows), _taken(start, rows), x0[rows]))
    # samples in different states at the two angles are sought in tables of their own
    rows = np.flatnonzero((low[1] | high[1]) & ~np.isfinite(result.x0) & (count[contour] > 1))
    for some in np.array_split(rows, -(-len(rows) // _TABLES)) if len(rows) else []:
        own = table(rod, path, contour[some], friction_angle[some])
        start, touches = _located(own, np.arange(len(some)), x0[some])
        inside = some[touches]
        _put(result, inside, _solved(rod, course.rows(inside), _taken(start, touches), x0[inside]))
    return result


def _mixed(first: Equilibria, second: Equilibria, part: Array) -> Equilibria:
    """Between two equilibria of the kind of the first, at fractions (n,) of the way."""
    place, force, other, x0, moment = (
        a + part * (b - a) for a, b in zip((first[0], *first[2:]), (second[0], *second[2:]), strict=True)
    )
    return Equilibria(place, first.tangential, force, other, x0, moment)


def _empty(n: int) -> Equilibria:
    unknown = np.full((5, n), np.nan)
    return Equilibria(unknown[0], np.zeros(n, dtype=bool), unknown[1], unknown[2], unknown[3], unknown[4])


def _put(result: Equilibria, rows: Index, states: Equilibria) -> None:
    for column, values in zip(result, states, strict=True):
        column[rows] = values


def _solved(rod: Rod, course: Course, start: Equilibria, x0: Array) -> Equilibria:
    """Equilibria (n,) at base positions, near the start; NaN where none was found."""
    steps, states = _FINE, start
    while True:

        def misfit(z: Array, rows: Index, n: int = steps) -> Array:
            end = _back(rod, course.rows(rows), z[0], start.tangential[rows], z[1], z[2], n)
            return np.concatenate([end.misfit, (end.x0 - x0[rows])[None]])

        z = np.stack([states.place, states.force, states.other])
        z, found = _newton(misfit, z, np.concatenate([np.full((1, len(x0)), 0.5), _scales(states.force)]))
        states = states._replace(place=z[0], force=z[1], other=z[2])
        with np.errstate(invalid="ignore"):
            finer = np.abs(misfit(z[:, found], np.flatnonzero(found), 2 * steps)).max(initial=0.0)
        if finer < _AGREED or steps >= _MOST_STEPS:
            break
        steps *= 2
    slope = course.at(states.place)[0]
    with np.errstate(invalid="ignore"):
        kept = np.where(states.tangential, states.other <= 1 + _AGREED, states.other >= slope - _AGREED)
    return _known(rod, course, states, found & (states.force >= 0) & kept, steps)
