"""Quasi-static sweeps of round rods in space past a convex body, with Coulomb friction, many sweeps in lockstep (MODEL3D, 4).

Every sweep is a lane of the arrays.  In each round all lanes take one step of Newton's method, each at its own place of its own
path: a lane whose equations are solved goes on to its next sample, one whose equations cannot be solved halves its step, and one
that has no equilibrium near the last one follows the overdamped flow of its snap.  So no lane waits for another.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

import planar
from scan3d.arrays import Array
from scan3d.spatial.bodies import Body
from scan3d.spatial.lanes import Lanes
from scan3d.spatial.touching import passages


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


@dataclass(frozen=True)
class Sweeps:
    """m sweeps of n samples, dimensionless; NaN where nothing touches."""

    force: Array
    """(m, n, 3) support reaction in the clamp's frame."""
    moment: Array
    """(m, n, 3) clamping moment likewise."""
    point: Array
    """(m, n, 3) contact of the rod's centre line, in the world."""
    normal: Array
    """(m, n, 3) outward normal of the body there."""
    tangent: Array
    """(m, n, 3) tangent of the rod there, towards the tip."""
    s1: Array
    """(m, n) arc length of the contact."""
    phase: NDArray[np.int8]
    """(m, n) of `planar.Phase`."""
    sticks: NDArray[np.bool_]
    """(m, n) whether the contact did not slip in the step to this sample."""
    snapped: NDArray[np.bool_]
    """(m, n) whether the rod snapped since the sample before."""
    end: NDArray[np.int8]
    """(m,) of `End`."""


def sweep(body: Body, position: ArrayLike, axes: ArrayLike, friction: ArrayLike = 0.0, *, substeps: int = 1) -> Sweeps:
    """Sweeps of a round rod of length 1 past a convex body.

    position
        (m, n, 3) clamp at the samples; it moves on a straight line from each to the next.
    axes
        (m, 3, 3) axes of the clamps in the world, as rows: x, y along the undeformed rod, and z.
    friction
        coefficient of friction: one number, (m,) or (m, n).
    substeps
        steps from one sample to the next.  Without friction the result does not depend on them; with friction its error falls
        in proportion to the steps.

    Raises ValueError for arrays of other shapes and for coefficients below zero.
    """
    position, axes = np.asarray(position, dtype=float), np.asarray(axes, dtype=float)
    if position.ndim != 3 or position.shape[1] < 2 or position.shape[2] != 3:
        raise ValueError(f"position must have the shape (m, n, 3) with n >= 2, got {position.shape}")
    if axes.shape != (len(position), 3, 3):
        raise ValueError(f"axes must have the shape ({len(position)}, 3, 3), got {axes.shape}")
    mu = np.asarray(friction, dtype=float)
    mu = np.broadcast_to(mu[:, None] if mu.ndim == 1 else mu, position.shape[:2])
    if not (np.isfinite(mu).all() and (mu >= 0).all()):
        raise ValueError("friction must be numbers >= 0")
    travel = position[:, -1] - position[:, 0]
    passage = passages(body, position[:, 0].T, axes[:, 1].T, travel.T)
    lanes = Lanes(body, position, axes, mu, passage, substeps)
    lanes.run()
    touching = np.isfinite(lanes.s1)
    phase = np.where(
        touching,
        np.where(lanes.s1 < 1 - planar.TOLERANCE, planar.Phase.TANGENTIAL, planar.Phase.TIP),
        planar.Phase.NONE,
    )
    vectors = (lanes.force, lanes.moment, lanes.point, lanes.normal, lanes.tangent)
    return Sweeps(
        *(v.transpose(1, 2, 0) for v in vectors),
        lanes.s1,
        phase.astype(np.int8),
        lanes.sticks,
        lanes.snapped,
        lanes.end,
    )
