"""The state of all lanes of a simulation: arrays with the lanes along their last axis."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array, Index, Mask
from scan3d.spatial.equations import Mode

# Steps of Newton's method with the direction of the slip frozen, where the slip is not known from the step before.
FROZEN_STEPS = 2


@dataclass
class LaneStates:
    """Lanes (k,) under way: where each of them is, what it tries, and how that goes."""

    number: Index
    """Sweep; below zero for a lane that has ended, until it is dropped."""
    progress: Array
    """Place on the path: number of a sample and fraction of the step after it."""
    target: Array
    """Place at which the equations are being solved."""
    step: Array
    """Largest step from place to place, in samples."""
    clear_after: Array
    """Place after which the straight rod has passed the body."""

    state: Array
    """(4, k) unknowns of the rod at `progress`."""
    feature: Index
    coordinates: Array
    """(3, k) place of the contact on the body."""
    point: Array
    """(3, k) contact."""
    slip_direction: Array
    """(3, k) direction of the last slip."""

    trial_state: Array
    trial_feature: Index
    trial_coordinates: Array
    """What Newton's method has reached for `target`."""

    last_change: Array
    """(4, k) change of the unknowns in the step before,"""
    last_coordinates: Array
    """(3, k) place on the body before that step,"""
    last_step: Array
    """and its length in samples; zero if it does not serve for a prediction."""

    mode: NDArray[np.int8]
    """Branch of Coulomb's law, of `Mode`, that is tried."""
    branches: Index
    """Branches that failed in this step."""
    frozen: Index
    """Steps of Newton's method that begin with the slip's direction frozen."""
    iterations: Index
    """Steps of Newton's method so far."""
    straightened: Index
    """Successive steps of Newton's method that would bend the rod the other way: it lifts off."""

    effort: Index
    """Steps of Newton's method since the last sample."""

    drag: Array
    """Drag on the slip while a snap is followed, else zero."""
    flow_steps: Index
    """Steps of the flow of this snap."""
    has_snapped: Mask
    """Whether the rod has snapped since the last sample."""
    steps_taken: Index
    """Steps since the last sample."""

    def keep(self, kept: Mask) -> None:
        """Drop the other lanes."""
        for column in fields(self):
            setattr(self, column.name, getattr(self, column.name)[..., kept])

    def restart(self, rows: Index) -> None:
        """Begin the step of these lanes again, from the state before."""
        self.iterations[rows] = self.straightened[rows] = 0
        self.frozen[rows] = FROZEN_STEPS
        self.trial_state[:, rows] = self.state[:, rows]
        self.trial_feature[rows], self.trial_coordinates[:, rows] = self.feature[rows], self.coordinates[:, rows]


def started(
    number: Index, progress: Array, clear_after: Array, state: Array, place: tuple[Index, Array, Array], slip: Array
) -> LaneStates:
    """Lanes (k,) at touch-down, with `place` (feature, coordinates, point) on the body and the direction of the slip (3, k)."""
    feature, coordinates, point = place
    count = len(number)

    def zeros() -> Index:
        return np.zeros(count, dtype=np.intp)

    return LaneStates(
        number=number,
        progress=progress,
        target=progress.copy(),
        step=np.ones(count),
        clear_after=clear_after,
        state=state,
        feature=feature,
        coordinates=coordinates,
        point=point,
        slip_direction=slip,
        trial_state=state.copy(),
        trial_feature=feature.copy(),
        trial_coordinates=coordinates.copy(),
        last_change=np.zeros((4, count)),
        last_coordinates=coordinates.copy(),
        last_step=np.zeros(count),
        mode=np.full(count, Mode.SLIDE, dtype=np.int8),
        branches=zeros(),
        frozen=np.full(count, FROZEN_STEPS),
        iterations=zeros(),
        straightened=zeros(),
        effort=zeros(),
        drag=np.zeros(count),
        flow_steps=zeros(),
        has_snapped=np.zeros(count, dtype=bool),
        steps_taken=zeros(),
    )
