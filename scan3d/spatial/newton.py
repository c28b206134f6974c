"""One step of Newton's method in many lanes, kept within the states that a bent rod can have."""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array, Index
from scan3d.spatial.bodies import Body, Patch
from scan3d.spatial.equations import System
from scan3d.spatial.lane_states import LaneStates
from scan3d.spatial.touchdown import STRAIGHT

# Largest change in a step of the angles of bending plane and force, in radians, and of the arc length, as a part of itself.
_LARGEST_TURN, _LARGEST_SHORTENING = 0.5, 0.5
# Largest angle of the force: beyond it, the force pulls the rod straight.
_LARGEST_ANGLE = 3.1
# q², as a part of its limit cos²(α/2), above which a step goes half the way to the limit instead, and its largest value at all.
_NEAR_LIMIT, _LIMIT = 0.999, 0.9999
# Shift of the unknowns' own derivatives where a Jacobian is singular to the last bit.
_SHIFT = 1e-12


def newton_step(body: Body, lanes: LaneStates, rows: Index, equations: System, patch: Patch) -> None:
    """Improve the trial states of the lanes `rows`, from the equations and the body's surface at all of them."""
    jacobian = equations.jacobian[:, :, rows].transpose(2, 0, 1)
    step = _solved(jacobian, equations.residual[:, rows])
    if not body.smooth:
        # on a small piece where equilibria are unstable, such as the sphere about a vertex, the path of equilibria runs back
        step *= np.where(np.linalg.det(jacobian) < 0, -1.0, 1.0)
    state = lanes.trial_state[:, rows]
    part = 1 / np.maximum(1.0, np.abs(step[:2]).max(axis=0) / _LARGEST_TURN)
    with np.errstate(divide="ignore", invalid="ignore"):
        part = np.minimum(part, np.where(step[3] < 0, -_LARGEST_SHORTENING * state[3] / step[3], np.inf))
    here = Patch(*(column[:, rows] for column in patch))
    feature, coordinates, taken = body.moved(
        lanes.trial_feature[rows], lanes.trial_coordinates[:, rows], here, part * step[4:]
    )
    before = state[2]
    state = state + taken * part * step[:4]
    state[1] = np.clip(state[1], -_LARGEST_ANGLE, _LARGEST_ANGLE)
    limit = np.cos(state[1] / 2) ** 2
    lanes.straightened[rows] = np.where(state[2] <= STRAIGHT, lanes.straightened[rows] + 1, 0)
    state[2] = np.where(state[2] >= _NEAR_LIMIT * limit, (before + limit) / 2, np.maximum(state[2], STRAIGHT))
    state[2] = np.minimum(state[2], _LIMIT * limit)
    lanes.trial_state[:, rows] = state
    lanes.trial_feature[rows], lanes.trial_coordinates[:, rows] = feature, coordinates
    lanes.iterations[rows] += 1


def _solved(jacobian: Array, residual: Array) -> Array:
    """Steps (6, k) from Jacobians (k, 6, 6) and residuals (6, k)."""
    right = residual.T[:, :, None]
    try:
        step = np.linalg.solve(jacobian, right)
    except np.linalg.LinAlgError:
        step = np.linalg.solve(jacobian + _SHIFT * np.eye(6), right)
    return np.asarray(-step[:, :, 0].T)
