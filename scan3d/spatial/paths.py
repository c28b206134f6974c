"""Paths of clamps: poses at samples, and between them on straight lines and with steady turns."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, Index, Mask
from scan3d.spatial.shapes import Clamp
from scan3d.spatial.vectors import cross, dot

# Distance in rod lengths from a straight line, and difference of axes, within which a path counts as straight and not turning.
_STRAIGHT = 1e-10


class Paths:
    """Paths of m clamps with n samples: `position` (m, n, 3) and `axes` (m, 3, 3), or (m, n, 3, 3) for clamps that turn."""

    def __init__(self, position: Array, axes: Array) -> None:
        self.samples = position.shape[1]
        self.position = position.transpose(2, 0, 1)  # (3, m, n)
        turning = axes.ndim == 4
        if turning and np.abs(axes - axes[:, :1]).max(initial=0.0) < _STRAIGHT:
            axes, turning = axes[:, 0], False
        self._turn: Array | None = None
        self._axes = np.moveaxis(axes, (-2, -1), (0, 1))  # (3 axes, 3, m) or (3 axes, 3, m, n)
        if turning:
            relative = np.einsum("mnij,mnik->mnjk", axes[:, 1:], axes[:, :-1])
            turn = Rotation.from_matrix(relative.reshape(-1, 3, 3)).as_rotvec()
            self._turn = np.moveaxis(turn.reshape(len(axes), -1, 3), 2, 0)  # (3, m, n - 1), in the world
        steps = np.diff(self.position, axis=2)
        self.pace = np.sqrt(dot(steps, steps)).max(axis=1)
        if self._turn is not None:
            self.pace = self.pace + np.sqrt(dot(self._turn, self._turn)).max(axis=1)

    def clamp(self, lane: Index, progress: Array) -> Clamp:
        """Poses at `progress` (k,) along the paths `lane` (k,): the number of a sample, and a fraction of the step after it."""
        number, part = self._step(progress)
        begin, end = self.position[:, lane, number], self.position[:, lane, number + 1]
        position = begin + part * (end - begin)
        if self._turn is None:
            return Clamp(position, *self._axes[:, :, lane])
        turn = part * self._turn[:, lane, number]
        return Clamp(position, *(_turned(axis, turn) for axis in self._axes[:, :, lane, number]))

    def speed(self, lane: Index, progress: Array) -> tuple[Array, Array]:
        """Derivatives (3, k) of the clamp's position and of the undeformed rod's direction by the progress."""
        number, _ = self._step(progress)
        speed = self.position[:, lane, number + 1] - self.position[:, lane, number]
        if self._turn is None:
            return speed, np.zeros_like(speed)
        return speed, cross(self._turn[:, lane, number], self.clamp(lane, progress).y)

    def straight(self) -> tuple[Mask, Array]:
        """Which paths (m,) are straight lines of clamps that do not turn, and the samples' places (m, n) along them, 0 to 1."""
        start = self.position[:, :, :1]
        travel = self.position[:, :, -1:] - start
        with np.errstate(divide="ignore", invalid="ignore"):
            place = dot(self.position - start, travel) / dot(travel, travel)
            away = np.abs(start + place * travel - self.position).max(axis=(0, 2))
        straight = (away < _STRAIGHT) & (np.diff(place, axis=1) > 0).all(axis=1)
        return np.asarray(straight & (self._turn is None)), place

    def _step(self, progress: Array) -> tuple[Index, Array]:
        # Newton's method may try places far off the path, such as of a straight rod along a face that it crosses
        number = np.clip(progress, 0, self.samples - 2).astype(np.intp)
        return number, progress - number


def _turned(vector: Array, turn: Array) -> Array:
    """Vectors (3, k) turned by rotation vectors (3, k): Rodrigues' formula."""
    angle = np.sqrt(dot(turn, turn))
    axis = turn / np.where(angle > 0, angle, 1.0)
    cos, sin = np.cos(angle), np.sin(angle)
    return np.asarray(vector * cos + cross(axis, vector) * sin + axis * (dot(axis, vector) * (1 - cos)))
