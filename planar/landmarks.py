"""What is drawn of a sweep: the elastic lines of its rods by their reactions, and its events with constant friction.

Events are touch-down, transitions, snaps, snap-off.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planar import plots, segments
from planar.arrays import BLOCK, Array, Index, check_direction, checked_reactions
from planar.contours import Contour, Path, check_contour, mirrored
from planar.elastica import bend, piece
from planar.plots import Explained, to_frame, words

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes


class ElasticLines(NamedTuple):
    """Shapes of n rods in rod lengths; NaN where a rod with such reactions does not exist."""

    curved: Array
    """(n, points, 2) from the clamp to the contact, evenly in arc length."""
    straight: Array
    """(n, 2, 2) ends of the straight part beyond the contact; they coincide in tip contact."""

    def plot(self, *, axes: Axes | None = None, **style: Any) -> Any:
        """The rods, those in tip contact in blue, the others in red up to the contact and in black beyond it.

        `axes` are matplotlib's, by default new ones; `style` is that of `matplotlib.axes.Axes.plot`.  Returns the axes.
        """
        return plots.plot_lines(self.curved, self.straight, axes, style)


def elastic_lines(x0: ArrayLike, f0x: ArrayLike, f0y: ArrayLike, m0z: ArrayLike, points: int = 100) -> ElasticLines:
    """Elastic lines of rods with the given base positions and support reactions (n,).

    A rod without force is straight.  Reactions of sweeps in +x have ``m0z < 0``.  Raises ValueError for arrays of
    different lengths or fewer than 2 points.
    """
    reactions = checked_reactions(x0, f0x, f0y, m0z)
    if points < 2:
        raise ValueError(f"an elastic line needs at least 2 points, got {points}")
    parts = [slice(first, first + BLOCK) for first in range(0, max(len(reactions[0]), 1), BLOCK)]
    drawn = (_drawn(points, *(column[part, None] for column in reactions)) for part in parts)
    return ElasticLines(*(np.concatenate(columns) for columns in zip(*drawn, strict=True)))


def _drawn(points: int, base: Array, fx: Array, fy: Array, moment: Array) -> tuple[Array, Array]:
    side = np.where(moment < 0, -1.0, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.hypot(fx, fy)
        root_f = np.sqrt(f)
        alpha = np.arctan2(-side * fx, fy)
        q = side * moment / (2 * root_f)
        s1 = np.where(f > 0, np.minimum(bend(alpha, q).length / root_f, 1.0), 1.0)
    shape = piece(-fx, -fy, np.full_like(f, np.pi / 2), -moment, np.linspace(0.0, 1.0, points) * s1)
    curved = np.stack([base + shape.x, shape.y], axis=-1)
    end = shape.phi[:, -1:]
    tip = curved[:, -1] + (1 - s1) * np.concatenate([np.cos(end), np.sin(end)], axis=1)
    return curved, np.stack([curved[:, -1], tip], axis=1)


class EventKind(Explained):
    """Kind of event; `reason` explains it."""

    TOUCH_DOWN = 0, "the straight rod touches the contour"
    TO_TANGENTIAL = 1, "the contact leaves the tip and becomes tangential"
    TO_TIP = 2, "the contact reaches the tip"
    SNAP = 3, "the equilibrium ends in a fold: the contact jumps along the contour to the next one"
    SNAP_OFF = 4, "the equilibrium ends in a fold, and no other exists further along: the rod leaves the contour"

    @property
    def reason(self) -> str:
        return self.sentence


@dataclass(frozen=True, repr=False)
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


def events(contour: Contour, friction: float = 0.0, *, direction: int = -1) -> Events:
    """Events of the sweep of a rod along a convex contour with constant friction.

    In tip contact on a polygon the rod snaps around every corner; these snaps are small where the polygon is fine.
    Raises ValueError as `planar.sweep` does.
    """
    if np.ndim(friction) or not (np.isfinite(friction) and friction >= 0):
        raise ValueError(f"friction must be one number >= 0, got {friction}")
    check_direction(direction)
    check_contour(contour)
    side = -direction
    contour = contour if side == 1 else mirrored(contour)
    path = contour.path()
    pieces = np.arange(path.offsets[-1])
    table = segments.cut(path, np.zeros_like(pieces), pieces, np.full(len(pieces), np.arctan(friction)))

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
    before = _states(path, table, np.append(left, rows[-1]), x0[1:])
    after = _states(path, table, np.insert(entered, 0, rows[0]), x0[:-1])
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


def _states(path: Path, table: segments.Segments, row: Index, x0: Array) -> list[Array]:
    """Slope, x, y, force and moment (n,) of contacts in a sweep in -x."""
    t, state = segments.solve(path, table, row, x0)
    return [*path.at(table.piece[row], t), state.root_f**2, 2 * state.q * state.root_f]


def _paired(before: Array, after: Array, without_contact: float) -> Array:
    """(e, 2) values before and after each event, from those (e - 1,) in contact."""
    return np.stack([np.insert(before, 0, without_contact), np.append(after, without_contact)], axis=1)
