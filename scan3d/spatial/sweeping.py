"""Quasi-static sweeps of round rods in space past a convex body, with Coulomb friction, many sweeps in lockstep (4).

Every sweep is a lane of the arrays.  In each round all lanes take one step of Newton's method, each at its own place of its own
path.  A lane whose equations are solved goes on to its next sample, one whose equations cannot be solved halves its step, and
one that has no equilibrium near the last one follows the overdamped flow of its snap.  So no lane waits for another.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

import planar
from scan3d.arrays import Array, Index
from scan3d.spatial.bodies import Body
from scan3d.spatial.lanes import EFFORT, Lanes
from scan3d.spatial.paths import Paths
from scan3d.spatial.results import End, Results
from scan3d.spatial.touches import first_touches, later_touches

# Halvings of the steps at most, for the accuracy that is asked for.
_HALVINGS = 6

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
    stable: NDArray[np.bool_]
    """(m, n) whether the equilibrium is stable: no branch forks or folds between touch-down and it.  In a mirror plane of the
    body the rod can be followed on after it has become unstable; a real one leaves the plane there."""
    snapped: NDArray[np.bool_]
    """(m, n) whether the rod snapped since the sample before."""
    steps: NDArray[np.int32]
    """(m, n) steps of the solution since the sample before, or since the touch-down."""
    end: NDArray[np.int8]
    """(m,) of `End`."""
    step_error: Array
    """(m,) estimated error that the steps of friction leave in a sweep: the largest change, over its samples, of contact, arc
    length and reactions (relative where these exceed 1) when the steps are halved.  Zero without friction, NaN if it was not
    asked for, infinite if the rod touches at other samples."""


def sweep(
    body: Body,
    position: ArrayLike,
    axes: ArrayLike,
    friction: ArrayLike = 0.0,
    *,
    substeps: int = 1,
    accuracy: float | None = None,
    effort: int = EFFORT,
) -> Sweeps:
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
    accuracy
        largest `Sweeps.step_error` that is wanted: sweeps with friction are repeated with half the steps until halving them
        changes no more than that, or the steps are 64 times smaller than at first.
    effort
        steps of Newton's method from one sample to the next before a sweep is given up (`End.LOST`), as happens at snaps.

    A rod that has lost contact touches again where its path leads it back.  Raises ValueError for arrays of other shapes, for
    coefficients below zero, and for paths that begin in the body.
    """
    place, turn, mu = _checked(position, axes, friction)
    if substeps < 1:
        raise ValueError(f"substeps must be at least 1, got {substeps}")
    swept = _swept(body, place, turn, mu, substeps, effort)
    if accuracy is None:
        return swept
    if not accuracy > 0:
        raise ValueError(f"accuracy must be above 0, got {accuracy}")
    swept = replace(swept, step_error=np.where((mu > 0).any(axis=1), np.inf, 0.0))
    for halving in range(1, _HALVINGS + 1):
        rows = np.flatnonzero(swept.step_error > accuracy)
        if not len(rows):
            break
        finer = _swept(body, place[rows], turn[rows], mu[rows], substeps * 2**halving, effort)
        error = _difference(finer, swept, rows)
        for column in fields(Sweeps):
            getattr(swept, column.name)[rows] = error if column.name == "step_error" else getattr(finer, column.name)
    return swept


def _swept(body: Body, position: Array, axes: Array, friction: Array, substeps: int, effort: int) -> Sweeps:
    paths = Paths(position, axes)
    lanes = Lanes(body, paths, friction, substeps, effort)
    touch = first_touches(body, paths)
    while len(touch.number):
        touch = later_touches(body, paths, *lanes.run(touch))
    return _sweeps(lanes.results)


def _difference(finer: Sweeps, coarser: Sweeps, rows: Index) -> Array:
    """Largest difference (k,) of sweeps from the sweeps `rows` (k,) of others."""
    largest = np.zeros(len(rows))
    for name in ("point", "s1", "force", "moment"):
        value, other = (v.reshape(*v.shape[:2], -1) for v in (getattr(finer, name), getattr(coarser, name)[rows]))
        touching, did = np.isfinite(value).all(axis=2), np.isfinite(other).all(axis=2)
        size = np.maximum(1.0, np.sqrt((value**2).sum(axis=2)))
        difference = np.where(touching & did, np.sqrt(((value - other) ** 2).sum(axis=2)) / size, 0.0)
        largest = np.maximum(largest, np.where(touching == did, difference, np.inf).max(axis=1))
    return largest


def _checked(position: ArrayLike, axes: ArrayLike, friction: ArrayLike) -> tuple[Array, Array, Array]:
    """Positions (m, n, 3), axes, and coefficients of friction (m, n)."""
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
    return place, turn, mu


def _sweeps(results: Results) -> Sweeps:
    tangential = results.s1 < 1 - planar.TOLERANCE
    touching = np.where(tangential, planar.Phase.TANGENTIAL, planar.Phase.TIP)
    phase = np.where(np.isfinite(results.s1), touching, planar.Phase.NONE)
    return Sweeps(
        **results.vectors(),
        s1=results.s1,
        phase=phase.astype(np.int8),
        sticks=results.sticks,
        stable=results.stable,
        snapped=results.snapped,
        steps=results.steps,
        end=results.end,
        step_error=np.full(len(results.end), np.nan),
    )
