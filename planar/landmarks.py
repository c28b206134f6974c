"""What happens in a sweep with constant friction: touch-down, transitions, snaps, snap-off."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from planar import segments
from planar.contours import Array, Contour, Polygon, check_contour, polygon_paths
from planar.sweeping import mirrored


class EventKind(IntEnum):
    """What happens; `reason` says it to people."""

    TOUCH_DOWN = 0
    TO_TANGENTIAL = 1
    TO_TIP = 2
    SNAP = 3
    SNAP_OFF = 4

    @property
    def reason(self) -> str:
        return _REASONS[self]


_REASONS = {
    EventKind.TOUCH_DOWN: "the straight rod touches the contour",
    EventKind.TO_TANGENTIAL: "the contact leaves the tip: the rod lies along the contour",
    EventKind.TO_TIP: "the contact reaches the tip",
    EventKind.SNAP: "the equilibrium ends in a fold: the contact jumps along the contour to the next one",
    EventKind.SNAP_OFF: "the equilibrium ends in a fold, and there is none further along: the rod leaves the contour",
}


@dataclass(frozen=True)
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

    def of(self, kind: EventKind) -> Array:
        """Base positions of the events of one kind."""
        return self.x0[self.kind == kind]


def events(contour: Contour, friction: float = 0.0, *, direction: int = -1) -> Events:
    """Events of the sweep of a rod along a contour with constant friction.

    In tip contact on a polygon the rod snaps around every corner; these snaps are small where the polygon is fine.
    Raises ValueError as `planar.sweep` does.
    """
    if np.ndim(friction) or not (np.isfinite(friction) and friction >= 0):
        raise ValueError(f"friction must be one number >= 0, got {friction}")
    if direction not in (-1, 1):
        raise ValueError(f"direction must be -1 or 1, the sign of the base's motion, got {direction!r}")
    check_contour(contour)
    side = -direction
    contour = contour if side == 1 else mirrored(contour)
    path = polygon_paths([contour]) if isinstance(contour, Polygon) else contour.path()
    pieces = np.arange(path.offsets[-1])
    table = segments.cut(path, np.zeros_like(pieces), pieces, np.full(len(pieces), np.arctan(friction)))

    # rows that bring the base further than all before them; the others are jumped over
    end = np.nan_to_num(table.x0[:, 1], nan=np.inf)
    before = np.minimum.accumulate(np.concatenate([table.x0[:1, 0], end[:-1]]))
    rows = np.flatnonzero(end < before)
    left, entered = rows[:-1], rows[1:]
    snapped = entered != left + 1
    # a fold and the rise behind it are one row further; a jump over rows without progress is a snap
    changed = ~snapped & (table.tangential[left] != table.tangential[entered])
    kind = np.where(
        snapped, EventKind.SNAP, np.where(table.tangential[entered], EventKind.TO_TANGENTIAL, EventKind.TO_TIP)
    )
    happens = snapped | changed
    left, entered, kind = left[happens], entered[happens], kind[happens]

    x0 = np.concatenate([table.x0[:1, 0], table.x0[left, 1], table.x0[rows[-1:], 1]])
    row_before, row_after = np.append(left, rows[-1]), np.insert(entered, 0, rows[0])
    states = []
    for row, at in ((row_before, x0[1:]), (row_after, x0[:-1])):
        t, state = segments.solve(path, table, row, at)
        slope, x, y = path.at(table.piece[row], t)
        states.append(np.stack([slope, x, y, state.root_f**2, 2 * state.q * state.root_f]))
    nothing = np.array([[np.nan], [np.nan], [np.nan], [0.0], [0.0]])
    both = np.stack([np.hstack([nothing, states[0]]), np.hstack([states[1], nothing])], axis=2)
    return Events(
        kind=np.concatenate([[EventKind.TOUCH_DOWN], kind, [EventKind.SNAP_OFF]]).astype(np.int8),
        x0=side * x0,
        slope=side * both[0],
        point=np.stack([side * both[1], both[2]], axis=-1),
        force=both[3],
        m0z=side * both[4],
    )
