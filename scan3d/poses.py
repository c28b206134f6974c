"""Lists of poses for a robot that holds the clamp: approach, sweep and retract, one sweep after the other.

The pose is that of the clamp in the world, as in a recording: y along the undeformed rod, x along the line of the sweep,
against which the clamp moves, and z normal to both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, Index, Mask
from scan3d.errors import InputError
from scan3d.rigs import axes_of, check_columns, check_orientations
from scan3d.rods import Rod

SPEED_M_S = 0.02
"""Speed of the clamp where none is given: a rod of 80 mm passes a body of that size in some ten seconds."""
AWAY = 0.05
"""How far a clamp stays away from the hull of a body that is probed, in rod lengths."""
TABLE = 0.0
"""Height z, in metres, of the table on which bodies stand for which poses are planned."""


class Move(IntEnum):
    """What the clamp does at a pose.  It comes to the first `SWEEP` pose on a straight line from the last `APPROACH` pose."""

    APPROACH = 0
    SWEEP = 1
    RETRACT = 2
    PROBE = 3
    """In the place of a sweep: along its own y axis, until a force is felt, or to the last pose of the kind."""


MOVES = tuple(move.name.lower() for move in Move)
"""Their names in files."""


def measures(move: NDArray[Any]) -> Mask:
    """(n,) moves in which something is measured: sweeps and probings."""
    return (move == Move.SWEEP) | (move == Move.PROBE)


@dataclass(frozen=True, repr=False)
class PoseList:
    """Poses (n) of the clamp, in the order in which they are passed; straight lines and steady turns between them.

    Raises InputError for columns of different lengths, numbers that aren't finite, quaternions without unit length, and sweeps
    with fewer than two poses or with poses that are not in one piece.
    """

    sweep: NDArray[np.int64]
    """(n,) number of the sweep to which the pose belongs."""
    position_m: Array
    """(n, 3)"""
    quaternion: Array
    """(n, 4) w first, of unit length."""
    move: NDArray[np.int8]
    """(n,) of `Move`."""
    rod: Rod | None = None
    """The rod for which the poses were planned; None where it is not known."""
    speed_m_s: float = SPEED_M_S
    """Of the clamp; in turns that of the rod's tip."""
    model: str = "planar"
    """The model of contact for which the poses were planned."""
    unit: str = "mm"
    """In which the body's size was given."""
    source: Mapping[str, Any] = field(default_factory=dict)
    """How the poses were planned."""

    def __post_init__(self) -> None:
        n = len(self.sweep)
        if n == 0:
            raise InputError("the list has no poses: expected at least two for each sweep")
        shapes = {"sweep": (n,), "position_m": (n, 3), "quaternion": (n, 4), "move": (n,)}
        check_columns("poses", vars(self), shapes)
        check_orientations("poses", self.quaternion)
        if not self.speed_m_s > 0:
            raise InputError(f"poses: the speed must be above 0 m/s, got {self.speed_m_s}")
        # the rows of each sweep stand together: approach, sweep and retract in this order
        first = np.flatnonzero(np.diff(self.sweep, prepend=self.sweep[0] - 1))
        numbers, count = np.unique(self.sweep[first], return_counts=True)
        if (count > 1).any():
            raise InputError(f"poses: the rows of sweep {numbers[np.argmax(count > 1)]} do not stand together")
        within = np.diff(self.sweep) == 0
        # approach, sweep or probing, retract
        back = within & (np.diff(np.array([0, 1, 2, 1])[self.move]) < 0)
        mixed = within & measures(self.move)[:-1] & measures(self.move)[1:] & (np.diff(self.move) != 0)
        if mixed.any():
            raise InputError(f"poses: row {int(np.argmax(mixed)) + 2} is of another move than the sweep that it is in")
        if back.any():
            raise InputError(
                f"poses: row {int(np.argmax(back)) + 2} is out of order; each sweep has approach, sweep and retract "
                "in turn"
            )
        of_sweep = np.searchsorted(first, np.flatnonzero(measures(self.move)), side="right") - 1
        samples = np.bincount(of_sweep, minlength=len(first))
        if (samples < 2).any():
            raise InputError(
                f"poses: sweep {self.sweep[first[np.argmax(samples < 2)]]} has {samples.min()} rows of the move "
                "sweep or probe, where at least two are needed"
            )

    def __len__(self) -> int:
        return len(self.sweep)

    def __repr__(self) -> str:
        return f"PoseList of {len(self)} poses in {len(self.sweeps())} sweeps, {self.times()[-1]:.4g} s"

    def axes(self) -> Array:
        """(n, 3, 3) the clamp's x, y and z axes in the world, as rows."""
        return axes_of(self.quaternion)

    def sweeps(self) -> list[Index]:
        """The rows of the move sweep, or probe, of every sweep, in order."""
        rows = np.flatnonzero(measures(self.move))
        return np.split(rows, np.flatnonzero(np.diff(self.sweep[rows])) + 1)

    def times(self) -> Array:
        """(n,) seconds from the first pose, at `speed_m_s`; turns take the time that the rod's tip needs."""
        turns = Rotation.from_quat(self.quaternion, scalar_first=True)
        length = self.rod.length_m if self.rod is not None else 0.0
        angle = (turns[:-1].inv() * turns[1:]).magnitude()
        path = np.linalg.norm(np.diff(self.position_m, axis=0), axis=1)
        # poses at the same place follow each other by no less
        steps = np.maximum(np.maximum(path, length * angle) / self.speed_m_s, 1e-3)
        return np.concatenate([[0.0], np.cumsum(steps)])
