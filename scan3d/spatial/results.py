"""What a simulation records at the samples, and how its sweeps ended."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.spatial.bodies import Patch
from scan3d.spatial.equations import System
from scan3d.spatial.lane_states import LaneStates
from scan3d.spatial.shapes import Bent, wrench


class End(IntEnum):
    """How a sweep ended."""

    PATH = 0
    """At the end of its path, in contact."""
    NO_TOUCH = 1
    """The rod passed the body without touching it."""
    OFF = 2
    """The rod lost contact, smoothly or by a snap."""
    LOST = 3
    """The computation found no equilibrium, and no way to one."""


class Results:
    """Arrays of m sweeps of n samples, vectors (3, m, n); NaN where nothing touches."""

    def __init__(self, sweeps: int, samples: int) -> None:
        self.force, self.moment, self.point, self.normal, self.tangent = (
            np.full((3, sweeps, samples), np.nan) for _ in range(5)
        )
        self.s1 = np.full((sweeps, samples), np.nan)
        self.sticks, self.snapped = (np.zeros((sweeps, samples), dtype=bool) for _ in range(2))
        self.stable = np.zeros((sweeps, samples), dtype=bool)
        self.steps = np.zeros((sweeps, samples), dtype=np.int32)
        self.end = np.full(sweeps, End.NO_TOUCH, dtype=np.int8)

    def record(self, lanes: LaneStates, rows: Index, sample: Index, rod: Bent, patch: Patch, equations: System) -> None:
        """Record the lanes `rows` (k,) at the samples (k,) that they have reached, and begin to count anew."""
        number = lanes.number[rows]
        force, moment = wrench(lanes.state[:, rows], rod.length[rows])
        self.force[:, number, sample], self.moment[:, number, sample] = force, moment
        self.point[:, number, sample], self.normal[:, number, sample] = patch.point[:, rows], patch.normal[:, rows]
        self.tangent[:, number, sample], self.s1[number, sample] = rod.tangent[:, rows], lanes.state[3, rows]
        self.sticks[number, sample] = equations.sticks[rows]
        # positive from touch-down, and zero where branches of equilibria fork or fold
        self.stable[number, sample] = np.linalg.det(equations.jacobian[:, :, rows].transpose(2, 0, 1)) > 0
        self.snapped[number, sample] = lanes.has_snapped[rows]
        self.steps[number, sample] = lanes.steps_taken[rows]
        lanes.has_snapped[rows] = False
        lanes.steps_taken[rows] = 0

    def contacts(self) -> Mask:
        """(m, n) whether the rod touches."""
        return np.asarray(np.isfinite(self.s1))

    def vectors(self) -> dict[str, Array]:
        """Fields with vectors (m, n, 3)."""
        names = ("force", "moment", "point", "normal", "tangent")
        return {name: getattr(self, name).transpose(1, 2, 0) for name in names}
