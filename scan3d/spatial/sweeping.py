"""Quasi-static sweeps of round rods in space past a convex body, with Coulomb friction, many sweeps in lockstep (MODEL3D, 4).

Every sweep is a lane of the arrays.  In each round all lanes take one step of Newton's method, each at its own place of its own
path.  A lane whose equations are solved goes on to its next sample, one whose equations cannot be solved halves its step, and
one that has no equilibrium near the last one follows the overdamped flow of its snap.  So no lane waits for another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

import planar
from scan3d.arrays import Array
from scan3d.spatial.bodies import Body
from scan3d.spatial.lanes import Lanes
from scan3d.spatial.paths import Paths
from scan3d.spatial.results import End, Results
from scan3d.spatial.touches import first_touches, later_touches

__all__ = ["End", "Sweeps", "sweep"]


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
    steps: NDArray[np.int32]
    """(m, n) steps of the solution since the sample before, or since the touch-down."""
    end: NDArray[np.int8]
    """(m,) of `End`."""


def sweep(body: Body, position: ArrayLike, axes: ArrayLike, friction: ArrayLike = 0.0, *, substeps: int = 1) -> Sweeps:
    """Sweeps of a round rod of length 1 past a convex body.

    position
        (m, n, 3) clamp at the samples; it moves on a straight line from each to the next.
    axes
        (m, 3, 3) axes of the clamps in the world, as rows: x, y along the undeformed rod, and z; or (m, n, 3, 3) for clamps
        that turn, steadily from each sample to the next.
    friction
        coefficient of friction: one number, (m,) or (m, n).
    substeps
        steps from one sample to the next.  Without friction the result does not depend on them; with friction its error falls
        in proportion to the steps.

    A rod that has lost contact touches again where its path leads it back.  Raises ValueError for arrays of other shapes, for
    coefficients below zero, and for paths that begin in the body.
    """
    paths, mu = _checked(position, axes, friction)
    if substeps < 1:
        raise ValueError(f"substeps must be at least 1, got {substeps}")
    lanes = Lanes(body, paths, mu, substeps)
    touch = first_touches(body, paths)
    while len(touch.number):
        touch = later_touches(body, paths, *lanes.run(touch))
    return _sweeps(lanes.results)


def _checked(position: ArrayLike, axes: ArrayLike, friction: ArrayLike) -> tuple[Paths, Array]:
    """Paths, and coefficients of friction (m, n)."""
    place, turn = np.asarray(position, dtype=float), np.asarray(axes, dtype=float)
    if place.ndim != 3 or place.shape[1] < 2 or place.shape[2] != 3:
        raise ValueError(f"position must have the shape (m, n, 3) with n >= 2, got {place.shape}")
    m, n = place.shape[:2]
    if turn.shape not in ((m, 3, 3), (m, n, 3, 3)):
        raise ValueError(f"axes must have the shape ({m}, 3, 3) or ({m}, {n}, 3, 3), got {turn.shape}")
    mu = np.asarray(friction, dtype=float)
    mu = np.broadcast_to(mu[:, None] if mu.ndim == 1 else mu, (m, n))
    if not (np.isfinite(mu).all() and (mu >= 0).all()):
        raise ValueError("friction must be numbers >= 0")
    return Paths(place, turn), mu


def _sweeps(results: Results) -> Sweeps:
    tangential = results.s1 < 1 - planar.TOLERANCE
    touching = np.where(tangential, planar.Phase.TANGENTIAL, planar.Phase.TIP)
    phase = np.where(np.isfinite(results.s1), touching, planar.Phase.NONE)
    return Sweeps(
        **results.vectors(),
        s1=results.s1,
        phase=phase.astype(np.int8),
        sticks=results.sticks,
        snapped=results.snapped,
        steps=results.steps,
        end=results.end,
    )
