"""Step 1: quasi-static sweeps of the rod along a contour.

The contact moves forward along the contour's path while the base moves.  Where the base position ``x0`` of the equilibria
has a local minimum along the path (a fold), the equilibrium ends, and the rod snaps to the next one further along at the
same ``x0``, or leaves the object.  So the state at a base position is the first one on the path whose ``x0`` has come down
to it.  Continuation in ``x0`` by Newton's method or shooting would fail at the folds.

On contours that are not convex, and on several in one plane, the rod may touch at several places: ``planar.any_body``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planar import plots, segments
from planar.any_body import SweepStatus, follow, last_contacts
from planar.arrays import (
    BLOCK,
    Array,
    Index,
    Mask,
    Reactions,
    check_direction,
    checked_friction,
    finite,
    rows_of,
    shortened,
)
from planar.contours import Contour, Outlines, Path, Polygon, check_contour, check_height, mirrored, polygon_paths
from planar.plots import Explained, Shown, counted, to_frame, words
from planar.rod_sweeps import AnyRod
from planar.rods import Rod, as_rod, free_reactions, shapes
from planar.segments import UNIFORM, Equilibria, Segments, Tables, cut_intervals
from planar.several import Rods, reactions
from planar.singles import INSIDE

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

# How far past touch-down the first sample of a sweep along any body lies, in rod lengths.
_TOUCHED = 1e-6
# Places of a rod that is not straight that are held against the contour, before its contact and past it.
_ALONG = 33


class Phase(IntEnum):
    """Kind of contact."""

    NONE = 0
    TIP = 1
    TANGENTIAL = 2


_COLUMNS = ("x0", "f0x", "f0y", "m0z", "s1", "slope", "friction")
"""Columns of numbers of a `Sweep`."""


CONTACT = np.dtype(
    [("s1", float), ("force", float), ("force_angle", float), ("point", float, (2,)), ("slope", float)], align=True
)
"""A contact: arc length, force f and its direction α (the force on the rod is ``f (sin α, -cos α)``), place, and slope of the
contour, whose outward normal is ``(sin α̃, -cos α̃)``."""


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(Shown):
    """States of the rod at its base positions: arrays of n samples, dimensionless; NaN where the rod does not touch.

    Where it touches at several places (`status`), point, slope, s1 and phase are those of the first along the rod, and
    `contacts` has all of them.
    """

    _panels = 3
    x0: Array
    """(n,) base positions."""
    f0x: Array
    """(n,) support reaction (8) across the undeformed rod, in EI/L²."""
    f0y: Array
    """(n,) support reaction along the undeformed rod, in EI/L²."""
    m0z: Array
    """(n,) clamping moment, in EI/L."""
    s1: Array
    """(n,) contact along the rod, in (0, 1]."""
    point: Array
    """(n, 2) contact point."""
    slope: Array
    """(n,) slope angle of the contour at the contact, in radians."""
    phase: NDArray[np.int8]
    """(n,) of `Phase`."""
    friction: Array
    """(n,) coefficient of friction that was set."""

    def __len__(self) -> int:
        return len(self.x0)

    def __repr__(self) -> str:
        return counted("Sweep", self.phase, Phase)

    @property
    def reactions(self) -> Reactions:
        """The observables x0, f0x, f0y and m0z, as `planar.reconstruct` and `planar.elastic_lines` take them."""
        return Reactions(self.x0, self.f0x, self.f0y, self.m0z)

    def plot(self, *columns: str, axes: Axes | ArrayLike | None = None, **style: Any) -> Any:
        """Curves of columns, by default the support reactions, over the base position, with circles where the phase changes.

        axes
            matplotlib's axes, one for each column; by default new ones.
        style
            that of `matplotlib.axes.Axes.plot`, such as ``color`` or ``label``.

        Returns the axes (len(columns),).  Raises ValueError for another number of axes and for unknown columns.
        """
        names = columns or ("f0x", "f0y", "m0z")
        return plots.plot_columns(plots.named(self, names, _COLUMNS), self.x0, self.phase, axes, style)

    def to_pandas(self) -> pandas.DataFrame:
        """A data frame with a row for each sample.  Raises ImportError without pandas."""
        place = {"x": self.point[:, 0], "y": self.point[:, 1]}
        return to_frame({**plots.named(self, _COLUMNS, _COLUMNS), **place, "phase": words(self.phase, Phase)})

    @property
    def status(self) -> NDArray[np.int8]:
        """(n,) of `SweepStatus`."""
        codes = np.where(self.phase == Phase.NONE, SweepStatus.FREE, SweepStatus.ONE_CONTACT)
        return codes.astype(np.int8)

    @property
    def contacts(self) -> np.recarray[Any, Any]:
        """(n, k) the contacts in their order along the rod: records (``sweeping.CONTACT``), NaN where there are fewer."""
        records = np.recarray((len(self), 1), dtype=CONTACT)
        records.s1, records.point, records.slope = self.s1[:, None], self.point[:, None], self.slope[:, None]
        records.force = np.hypot(self.f0x, self.f0y)[:, None]
        records.force_angle = np.arctan2(-self.f0x, self.f0y)[:, None]
        return records


@dataclass(frozen=True, eq=False, repr=False)
class SweepOfAnyBody(Sweep):
    """A sweep in which the rod may touch at several places."""

    states: NDArray[np.int8]
    """(n,) of `SweepStatus`."""
    records: np.recarray[Any, Any]
    """(n, k) of `CONTACT`."""

    @property
    def status(self) -> NDArray[np.int8]:
        return self.states

    @property
    def contacts(self) -> np.recarray[Any, Any]:
        return self.records


def sweep(
    contour: Contour,
    friction: ArrayLike = 0.0,
    *,
    base: ArrayLike | None = None,
    samples: int | None = None,
    direction: int = -1,
    rod: Rod | None = None,
) -> Sweep:
    """Sweep the rod along a contour, its base moving in -x, or in +x (the mirror image) with `direction` 1.

    contour
        above the base line ``y = 0``, with its lowest point within the rod's reach ``y <= 1``; convex or not.
    friction
        coefficient ``μ >= 0``, one number or one per sample.  With one per sample, each sample is in the state
        that a sweep with its coefficient has at its base position, as in the paper.
    base, samples
        the base positions (n,), falling (rising for +x), or their number, evenly spaced from touch-down to the end of the
        sweep (with several coefficients: the end for the lowest of them); by default 200 of them, or one for each friction.
    rod
        None: straight, uniform and weightless.  The reactions of a rod with weight are the whole ones, its own weight included.
        States whose moment changes its sign between clamp and contact are left out, and samples in which it would lie in the
        contour beside its contact, or a curved one without any, are unresolved.  Convex contours only.

    On a contour that is not convex the rod is followed from sample to sample with all of its contacts; the sweep begins where
    the straight rod first touches, whatever the first base position is.  `status` says of each sample what it
    is, also of rods whose equilibrium was not found; `SweepStatus` has the sentences.

    Raises ValueError for friction, base or samples out of their range and for a contour outside the rod's reach.
    Source: the equilibria (3) with (5)-(7) of the paper, in closed form.
    """
    check_direction(direction)
    if base is None and samples is None:
        samples = np.size(friction) if np.ndim(friction) == 1 else 200  # over which curves look smooth
    if direction == 1:
        base = None if base is None else -np.asarray(base, dtype=float)
        rod = None if rod is None else as_rod(rod).mirrored()
        return _mirrored(sweep(mirrored(contour), friction, base=base, samples=samples, rod=rod))
    return sweep_all([contour], [friction], base=None if base is None else [base], samples=samples, rod=rod)[0]


def _mirrored(swept: Sweep) -> Sweep:
    if isinstance(swept, SweepOfAnyBody):
        records = swept.records.copy()
        records.point[..., 0] *= -1
        records.slope *= -1
        records.force_angle *= -1
        swept = replace(swept, records=records)
    return replace(
        swept,
        x0=-swept.x0,
        f0x=-swept.f0x,
        m0z=-swept.m0z,
        point=swept.point * np.array([-1.0, 1.0]),
        slope=-swept.slope,
    )


def sweep_all(
    contours: Sequence[Contour],
    friction: Sequence[ArrayLike] | float,
    *,
    base: Sequence[ArrayLike] | None = None,
    samples: int | None = None,
    shares: ArrayLike | None = None,
    rod: Rod | None = None,
    single: bool = False,
) -> list[Sweep]:
    """Many sweeps at once: `sweep` for every contour with its friction, or one number for all, and, unless `samples` is given,
    its base.

    `shares` (n,), fractions rising from 0 to 1, are used instead of `samples` for base positions that are not evenly spaced
    over the travel from touch-down to the end of the sweep.  With `single` each sweep ends where the rod comes to touch at
    several places, and has fewer samples.  Raises ValueError as `sweep` does.
    """
    if (base is None) + (samples is None) + (shares is None) != 2:
        raise ValueError("a sweep needs either its base positions (base=) or their number (samples=), and not both")
    spread = _checked_spread(samples, shares)
    each = [friction] * len(contours) if isinstance(friction, float | int) else friction
    if len(each) != len(contours) or (base is not None and len(base) != len(contours)):
        raise ValueError(f"{len(contours)} contours need as many frictions and base positions")
    for contour in contours:
        check_contour(contour)
    rod = as_rod(rod)
    if rod.down.shape not in ((2,), (len(contours), 2)):
        raise ValueError(f"gravity must have one direction, or one for each sweep, got {len(rod.down)}")
    frictions = [checked_friction(mu) for mu in each]
    bases = [None] * len(contours) if base is None else [_checked_base(x0) for x0 in base]

    sweeps: dict[int, Sweep] = {}
    convex = [i for i, contour in enumerate(contours) if contour.is_convex]
    others = [i for i in range(len(contours)) if not contours[i].is_convex]
    if others:
        if not rod.is_straight_and_uniform:
            raise ValueError("a rod that is not straight, uniform and weightless is swept along convex contours only")
        columns = [frictions[i] for i in others], [bases[i] for i in others]
        sweeps.update(zip(others, _sweep_any([contours[i] for i in others], *columns, spread, single), strict=True))
    polygons = {i: polygon.vertices for i in convex if isinstance(polygon := contours[i], Polygon)}
    groups = [(list(polygons), polygon_paths(list(polygons.values())))] if polygons else []
    groups += [([i], contours[i].path()) for i in convex if i not in polygons]
    for members, path in groups:
        columns = [frictions[i] for i in members], [bases[i] for i in members]
        of = UNIFORM if rod.is_straight_and_uniform else AnyRod(rod.rows(np.array(members)))
        sweeps.update(zip(members, _sweep_path(path, *columns, spread, of), strict=True))
    found = [sweeps[i] for i in range(len(contours))]
    return _outside(found, contours, rod) if rod.curvature or rod.weight else found


def _outside(sweeps: list[Sweep], contours: Sequence[Contour], rod: Rod) -> list[Sweep]:
    """The sweeps without the samples in which a rod that is curved or hangs would lie in the contour, beside its contact or
    without any: it touches in a state that is left out."""
    outlines = Outlines([contour.loops() for contour in contours])
    for i, swept in enumerate(sweeps):
        free = swept.phase == Phase.NONE
        columns = zip(free_reactions(rod.rows(np.array(i))), swept.reactions[1:], strict=True)
        f0x, f0y, m0z = (np.where(free, in_air, column) for in_air, column in columns)
        like = rod.rows(np.full(len(swept), i))
        with np.errstate(all="ignore"):
            lines = shapes(like, -np.stack([f0x, f0y]) - like.pull, -m0z, np.fmin(swept.s1, 1.0), _ALONG)
        places = np.concatenate(lines, axis=1) + np.stack([swept.x0, np.zeros(len(swept))])[:, None]
        body = np.full(places[0].size, i)
        gap = outlines.nearest(body, places.reshape(2, -1).T, 0.0).gap.reshape(places[0].shape)
        through = np.flatnonzero((gap < -INSIDE).any(axis=0))
        _clear(swept, through)
        states, records = swept.status, swept.contacts
        states[through] = SweepStatus.UNRESOLVED
        # what the clamp holds besides the contact is the rod's weight
        fx, fy = np.where(
            swept.phase == Phase.NONE, np.nan, np.stack([swept.f0x, swept.f0y]) + rod.rows(np.array([i])).pull
        )
        records.force, records.force_angle = np.hypot(fx, fy)[:, None], np.arctan2(-fx, fy)[:, None]
        sweeps[i] = SweepOfAnyBody(**vars(swept), states=states, records=records)
    return sweeps


def _checked_spread(samples: int | None, shares: ArrayLike | None) -> Array:
    """Fractions of the travel from touch-down to the sweep's end."""
    is_integer = isinstance(samples, int | np.integer) and not isinstance(samples, bool)
    if samples is not None and not (is_integer and samples >= 1):
        raise ValueError(f"samples must be a whole number of at least 1, got {samples!r}")
    spread = np.linspace(0.0, 1.0, samples or 1) if shares is None else np.asarray(shares, dtype=float)
    if spread.ndim != 1 or not len(spread) or not (spread[0] >= 0 and spread[-1] <= 1 and (np.diff(spread) >= 0).all()):
        raise ValueError("shares must be numbers of shape (n,) that rise from 0 to 1")
    return spread


def _checked_base(base: ArrayLike) -> Array:
    x0 = np.asarray(base, dtype=float)
    if x0.ndim != 1 or not np.isfinite(x0).all():
        raise ValueError(f"base positions must be finite numbers of shape (n,), got {shortened(x0)}")
    if (np.diff(x0) > 0).any():
        raise ValueError("base positions must follow the sweep: fall from sample to sample in -x, rise in +x")
    return x0


def _sweep_path(
    path: Path, frictions: list[Array], bases: list[Array | None], spread: Array, rod: Equilibria
) -> list[Sweep]:
    # at the coefficients between which the samples of each sweep lie
    levels = [segments.levels(mu) for mu in frictions]
    runs = [np.array([i]) for i in range(len(levels))]
    tables = segments.tables(path, runs, [np.arctan(level) for level in levels], rod)
    table = tables.segments
    x0 = [
        _spread(table, rows[0], spread) if base is None else base for rows, base in zip(tables.rows, bases, strict=True)
    ]
    _check_sizes(frictions, x0)
    sweep_of = np.repeat(np.arange(len(x0)), [len(base) for base in x0])
    friction = np.concatenate([np.broadcast_to(mu, base.shape) for mu, base in zip(frictions, x0, strict=True)])
    swept = _empty(np.concatenate(x0), friction)

    # first rows (coefficients, n) on which the samples of each sweep come to rest
    first_rows = [
        np.stack([_first_row(table, part, base) for part in rows]) for rows, base in zip(tables.rows, x0, strict=True)
    ]
    touched = np.concatenate([rows[0] >= 0 for rows in first_rows])
    constant = np.array([len(level) == 1 for level in levels], dtype=bool)[sweep_of]
    row = np.concatenate([rows[0] for rows in first_rows])
    stop = np.array([rows[0].stop for rows in tables.rows])[sweep_of]
    for block in _blocks(np.flatnonzero(touched & constant & (row < stop))):
        _solve(path, table, row[block], block, swept, rod)

    if not constant.all():
        # Friction per sample: each sample searches the interval of the path between its places at the neighbouring
        # coefficients, and where it is not there, the whole path.
        intervals = _search_intervals(path, tables, levels, first_rows, sweep_of, friction)
        whole_paths = np.stack([path.offsets[sweep_of], path.offsets[sweep_of + 1]])
        pending = np.flatnonzero(touched & ~constant)
        for interval in (intervals, whole_paths):
            missed = [_search_each(path, block, interval[:, block], swept, rod) for block in _blocks(pending)]
            pending = np.concatenate([*missed, np.empty(0, dtype=np.intp)])

    return _parted(swept, x0)


def _check_sizes(frictions: list[Array], x0: list[Array]) -> None:
    for mu, base in zip(frictions, x0, strict=True):
        if mu.ndim and mu.shape != base.shape:
            raise ValueError(
                f"friction must be one number or one for each of the {len(base)} base positions, got {mu.size}"
            )


def _parted(swept: Sweep, x0: list[Array]) -> list[Sweep]:
    """The sweeps one by one, each ended where the rod leaves the object."""
    ends = np.cumsum([len(base) for base in x0])
    parts = [slice(end - len(base), end) for end, base in zip(ends, x0, strict=True)]
    sweeps = [Sweep(**{name: column[part] for name, column in vars(swept).items()}) for part in parts]
    for finished in sweeps:
        # once the rod has left the object, it does not touch it again, whatever the friction of later samples
        touching = finished.phase != Phase.NONE
        has_touched = np.maximum.accumulate(touching)
        _clear(finished, has_touched & ~np.logical_and.accumulate(touching | ~has_touched))
    return sweeps


def _sweep_any(
    contours: list[Contour], frictions: list[Array], bases: list[Array | None], spread: Array, single: bool
) -> list[Sweep]:
    """Sweeps along contours that are not convex."""
    outlines = Outlines([contour.loops() for contour in contours])
    for lowest in outlines.low[:, 1]:
        check_height(float(lowest))
    base_positions = [base for base in bases if base is not None]
    if not base_positions:
        starts = [outlines.touch_down(k) - _TOUCHED for k in range(len(contours))]
        # the rod can't reach farther than its length
        tries = [np.arange(start, outlines.low[k, 0] - 1.0, -0.02) for k, start in enumerate(starts)]
        least = [np.arctan(mu.min(initial=np.inf if mu.size else 0.0)) for mu in frictions]
        ends = last_contacts(outlines, tries, [np.full(len(a), zeta) for a, zeta in zip(tries, least, strict=True)])
        base_positions = [start + spread * (end - start) for start, end in zip(starts, ends, strict=True)]
    _check_sizes(frictions, base_positions)
    friction = [np.broadcast_to(mu, base.shape) for mu, base in zip(frictions, base_positions, strict=True)]
    followed = follow(outlines, base_positions, [np.arctan(mu) for mu in friction], single=single)
    return [_of_rods(outlines, *found, mu[: len(found.status)]) for found, mu in zip(followed, friction, strict=True)]


def _of_rods(outlines: Outlines, rods: Rods, status: NDArray[np.int8], friction: Array) -> Sweep:
    touches, place = rods.count > 0, outlines.at(rods.piece.ravel(), rods.u.ravel())
    used = np.arange(rods.s.shape[1]) < rods.count[:, None]
    records = np.recarray(rods.s.shape, dtype=CONTACT)
    records.point, records.slope = place.point.reshape(*rods.s.shape, 2), place.tau.reshape(rods.s.shape)
    records.s1, records.force, records.force_angle = rods.s, rods.force, records.slope + rods.zeta
    for name in CONTACT.names or ():
        records[name][~used] = np.nan
    f0x, f0y, m0z = (np.where(touches, values, np.nan) for values in reactions(outlines, rods))
    first = records[:, 0]
    phase = np.where(rods.tip[:, 0], Phase.TIP, Phase.TANGENTIAL)
    return SweepOfAnyBody(
        x0=rods.x0,
        f0x=f0x,
        f0y=f0y,
        m0z=m0z,
        s1=first["s1"].copy(),
        point=first["point"].copy(),
        slope=first["slope"].copy(),
        phase=np.where(touches, phase, Phase.NONE).astype(np.int8),
        friction=np.array(friction),
        states=status,
        records=records,
    )


def _search_intervals(
    path: Path, tables: Tables, levels: list[Array], first_rows: list[Index], sweep_of: Index, friction: Array
) -> Index:
    """First piece and stop (2, n) of the path between a sample's places at the neighbouring coefficients of its table."""
    interval = np.zeros((2, len(friction)), dtype=np.intp)
    for i, level in enumerate(levels):
        if len(level) == 1:
            continue
        pieces = np.stack(
            [
                np.where(
                    row < part.stop,
                    tables.segments.piece[np.clip(row, part.start, part.stop - 1)],
                    path.offsets[i + 1] - 1,
                )
                for row, part in zip(first_rows[i], tables.rows[i], strict=True)
            ]
        )
        samples = sweep_of == i
        above = np.clip(np.searchsorted(level, friction[samples]), 1, len(level) - 1)
        neighbours = np.take_along_axis(pieces, np.stack([above - 1, above]), axis=0)
        interval[0, samples] = np.maximum(neighbours.min(axis=0) - 1, path.offsets[i])
        interval[1, samples] = np.minimum(neighbours.max(axis=0) + 2, path.offsets[i + 1])
    return interval


def _blocks(samples: Index) -> list[Index]:
    return np.array_split(samples, -(-len(samples) // BLOCK)) if len(samples) else []


def _empty(x0: Array, friction: Array) -> Sweep:
    """Samples without contact, to be filled in."""
    nothing = {name: np.full(len(x0), np.nan) for name in ("f0x", "f0y", "m0z", "s1", "slope")}
    phase = np.full(len(x0), Phase.NONE, dtype=np.int8)
    return Sweep(x0=x0, point=np.full((len(x0), 2), np.nan), phase=phase, friction=friction, **nothing)


def _solve(path: Path, table: Segments, row: Index, samples: Index, swept: Sweep, rod: Equilibria) -> None:
    """Fill in the states of the samples, which lie on the given rows."""
    piece, t, state = rod.solve(path, rows_of(table, row), swept.x0[samples])
    slope, x, y = path.at(piece, t)
    alpha, f, (across, along) = slope + table.friction_angle[row], state.force, rod.pull(path, piece)
    swept.f0x[samples], swept.f0y[samples] = -f * np.sin(alpha) - across, f * np.cos(alpha) - along  # (8)
    swept.m0z[samples] = state.m0z
    swept.s1[samples], swept.slope[samples] = np.minimum(state.s1, 1.0), slope  # at transitions up to rounding
    swept.point[samples] = np.stack([x, y], axis=1)
    swept.phase[samples] = np.where(table.tangential[row], Phase.TANGENTIAL, Phase.TIP)
    _clear(swept, samples[np.isnan(state.x0)])


def _clear(swept: Sweep, samples: Index | Mask) -> None:
    for column in (swept.f0x, swept.f0y, swept.m0z, swept.s1, swept.slope, swept.point):
        column[samples] = np.nan
    swept.phase[samples] = Phase.NONE


def _spread(table: Segments, part: slice, fractions: Array) -> Array:
    """Base positions from touch-down (0) to the end of the sweep (1)."""
    x0 = table.x0[part][np.isfinite(table.x0[part])]
    if not len(x0):
        raise ValueError("the object is out of the rod's reach: nowhere on it is the rod in equilibrium")
    start, end = x0[0], x0.min()
    return np.asarray(np.where(fractions == 1, end, start + fractions * (end - start)))


def _first_row(table: Segments, part: slice, x0: Array) -> Index:
    """First row of the part on which the base position falls to x0 (n,): -1 before touch-down, `part.stop` after the end."""
    reached = np.minimum.accumulate(np.nan_to_num(table.x0[part, 1], nan=np.inf))
    row = part.start + np.searchsorted(-reached, -x0)
    begins = table.x0[part, 0]
    return np.asarray(np.where(x0 > begins[np.argmax(np.isfinite(begins))], -1, row))


def _search_each(path: Path, samples: Index, interval: Index, swept: Sweep, rod: Equilibria) -> Index:
    """Solve samples on separate intervals (2, n) of the path, each with its friction; returns those that are not in theirs."""
    x0 = swept.x0[samples]
    table, bounds = cut_intervals(path, interval[0], interval[1], np.arctan(swept.friction[samples]), rod)
    rows = np.where(table.x0[:, 1] <= x0[table.owner], np.arange(len(table.owner)), len(table.owner))
    row = np.minimum.reduceat(rows, bounds[:-1])
    known = np.where(np.isfinite(table.x0[:, 0]), np.arange(len(table.owner)), len(table.owner) - 1)
    inside = (row < len(table.owner)) & (table.x0[np.minimum.reduceat(known, bounds[:-1]), 0] >= x0)
    _solve(path, table, row[inside], samples[inside], swept, rod)
    return np.asarray(samples[swept.phase[samples] == Phase.NONE])


class EventKind(Explained):
    """Kind of event; `sentence` explains it."""

    TOUCH_DOWN = 0, "the straight rod touches the contour"
    TO_TANGENTIAL = 1, "the contact leaves the tip and becomes tangential"
    TO_TIP = 2, "the contact reaches the tip"
    SNAP = 3, "the equilibrium ends in a fold: the contact jumps along the contour to the next one"
    SNAP_OFF = 4, "the equilibrium ends in a fold, and no other exists further along: the rod leaves the contour"


@dataclass(frozen=True, eq=False, repr=False)
class Events:
    """Events (e,) of a sweep in their order, dimensionless."""

    kind: NDArray[np.int8]
    """(e,) of `EventKind`."""
    x0: Array
    """(e,) base position."""
    slope: Array
    """(e, 2) slope angle of the contour at the contact before and after; NaN where there is no contact."""
    point: Array
    """(e, 2, 2) contact point before and after; NaN where there is no contact."""
    force: Array
    """(e, 2) contact force before and after, 0 where there is no contact."""
    m0z: Array
    """(e, 2) clamping moment before and after, 0 where there is no contact."""

    def __len__(self) -> int:
        return len(self.kind)

    def __repr__(self) -> str:
        listed = ", ".join(f"{word} {x0:.6g}" for word, x0 in zip(words(self.kind, EventKind), self.x0, strict=True))
        return f"Events at x0: {listed}"

    def plot(self, *, axes: Axes | None = None, **style: Any) -> Any:
        """The clamping moment before (hollow) and after (filled) each event, over the base position.

        `axes` are matplotlib's, such as the last ones of `Sweep.plot`, by default new ones; `style` is that of
        `matplotlib.axes.Axes.plot`.  Returns the axes.
        """
        kinds = {kind.name.lower().replace("_", " "): np.flatnonzero(self.kind == kind) for kind in EventKind}
        return plots.plot_events(self.x0, self.m0z, kinds, axes, style)

    def to_pandas(self) -> pandas.DataFrame:
        """A data frame with a row for each event and its values before and after.  Raises ImportError without pandas."""
        columns = {"x": self.point[:, :, 0], "y": self.point[:, :, 1]}
        columns |= {name: getattr(self, name) for name in ("slope", "force", "m0z")}
        pairs = {f"{name}_{side}": c[:, k] for name, c in columns.items() for k, side in enumerate(("before", "after"))}
        return to_frame({"kind": words(self.kind, EventKind), "x0": self.x0, **pairs})

    def of(self, kind: EventKind) -> Array:
        """Base positions of the events of one kind."""
        return np.asarray(self.x0[self.kind == kind])


def events(contour: Contour, friction: float = 0.0, *, direction: int = -1, rod: Rod | None = None) -> Events:
    """Events of the sweep of a rod along a convex contour with constant friction.

    In tip contact on a polygon the rod snaps around every corner; these snaps are small where the polygon is fine.  The `rod`
    is by default the uniform one.  Raises ValueError for a curved or heavy one, which may touch at a second place that no event
    tells, and as `planar.sweep` does.
    """
    rod = as_rod(rod)
    if rod.curvature or rod.weight:
        raise ValueError("events are those of rods that are straight at rest and weightless, tapered or not")
    if np.ndim(friction) or not (finite(friction) and friction >= 0):
        raise ValueError(f"friction must be one number >= 0, got {friction}")
    check_direction(direction)
    check_contour(contour)
    side = -direction
    contour = contour if side == 1 else mirrored(contour)
    path = contour.path()
    pieces = np.arange(path.offsets[-1])
    of = UNIFORM if rod.is_straight_and_uniform else AnyRod(rod)
    table = segments.cut(path, np.zeros_like(pieces), pieces, np.full(len(pieces), np.arctan(friction)), of)

    # rows on which x0 falls below all of its values before; a snap skips the others
    end = np.nan_to_num(table.x0[:, 1], nan=np.inf)
    lowest_before = np.minimum.accumulate(np.concatenate([table.x0[:1, 0], end[:-1]]))
    rows = np.flatnonzero(end < lowest_before)
    left, entered = rows[:-1], rows[1:]
    snapped = entered != left + 1
    # a snap skips at least the row that rises behind the fold
    changed = ~snapped & (table.tangential[left] != table.tangential[entered])
    kind = np.where(
        snapped, EventKind.SNAP, np.where(table.tangential[entered], EventKind.TO_TANGENTIAL, EventKind.TO_TIP)
    )
    happens = snapped | changed
    left, entered, kind = left[happens], entered[happens], kind[happens]

    x0 = np.concatenate([table.x0[:1, 0], table.x0[left, 1], table.x0[rows[-1:], 1]])
    before = _states(path, table, np.append(left, rows[-1]), x0[1:], of)
    after = _states(path, table, np.insert(entered, 0, rows[0]), x0[:-1], of)
    # without contact there is no place, no force and no moment: before touch-down and after the rod has left
    slope, x, y = map(_paired, before[:3], after[:3], [np.nan] * 3)
    force, m0z = map(_paired, before[3:], after[3:], [0.0] * 2)
    return Events(
        kind=np.concatenate([[EventKind.TOUCH_DOWN], kind, [EventKind.SNAP_OFF]]).astype(np.int8),
        x0=side * x0,
        slope=side * slope,
        point=np.stack([side * x, y], axis=-1),
        force=force,
        m0z=side * m0z,
    )


def _states(path: Path, table: Segments, row: Index, x0: Array, rod: Equilibria) -> list[Array]:
    """Slope, x, y, force and moment (n,) of contacts in a sweep in -x."""
    piece, t, state = rod.solve(path, rows_of(table, row), x0)
    return [*path.at(piece, t), state.force, state.m0z]


def _paired(before: Array, after: Array, without_contact: float) -> Array:
    """(e, 2) values before and after each event, from those (e - 1,) in contact."""
    return np.stack([np.insert(before, 0, without_contact), np.append(after, without_contact)], axis=1)
