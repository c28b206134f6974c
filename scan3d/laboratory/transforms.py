"""From the robot's and the sensor's frames into the clamp's.

A frame with the origin p and the axes that are the columns of R turns its vectors v into ``R v``.  Forces keep their components
under a shift; moments are moved to the clamp: with the sensor's origin p in the clamp's frame the moment about the clamp is
``m_clamp = R m + p × F``, which is ``m − r × F`` with the vector r = −p from the sensor to the clamp.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, Mask
from scan3d.errors import InputError
from scan3d.laboratory.columns import CHANNELS
from scan3d.laboratory.maps import Frame

# Parts of a channel that count as rounding of a turn, relative to the whole.
_ROUNDING = 1e-12
# Half a turn about the clamp's y axis, which is that of the rod: the frame in which a stroke along +x is one along -x.
HALF_TURN = np.diag([-1.0, 1.0, -1.0])


def wrench_matrix(sensor: Frame) -> Array:
    """(6, 6) matrix that takes force and moment in the sensor's frame to those in the clamp's, about the clamp's origin."""
    turn, (x, y, z) = sensor.turn, sensor.position_m
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.block([[turn, np.zeros((3, 3))], [cross @ turn, turn]])


def clamp_wrench(wrench: Array, present: Mask, sensor: Frame, where: str) -> tuple[Array, Mask]:
    """The wrench (n, 6) in the clamp's frame, and which of its channels (6,) the sensor's channels determine.

    Raises InputError if fx, fy and mz of the clamp are not among them, with the channel that is missing.
    """
    matrix = wrench_matrix(sensor)
    scale = np.abs(matrix).max(axis=1, keepdims=True)
    needed = np.abs(matrix) > _ROUNDING * scale
    known: Mask = ~(needed & ~present).any(axis=1)
    for channel in (0, 1, 5):
        if not known[channel]:
            absent = ", ".join(CHANNELS[k] for k in np.flatnonzero(needed[channel] & ~present))
            raise InputError(
                f"{where}: {CHANNELS[channel]} of the clamp needs {absent} of the sensor as well, because [sensor] turns or "
                "moves it; add the column, or give the wrench in the clamp's frame"
            )
    if sensor.trivial:
        return wrench, known
    return np.where(known, wrench @ matrix.T, 0.0), known


def clamp_pose(position: Array, quaternion: Array, clamp: Frame) -> tuple[Array, Array]:
    """Positions (n, 3) and orientations (n, 4), w first, of the clamp from those of the frame that was logged."""
    if clamp.trivial:
        return position, quaternion
    logged = Rotation.from_quat(quaternion, scalar_first=True)
    turned = logged * Rotation.from_matrix(clamp.turn)
    return position + logged.apply(clamp.position_m), turned.as_quat(scalar_first=True)


def turned_back(quaternion: Array, wrench: Array) -> tuple[Array, Array]:
    """Orientations (n, 4) and wrenches (n, 6) in the clamp's frame after half a turn about the rod."""
    turn = Rotation.from_matrix(HALF_TURN)
    signs = np.tile(np.diag(HALF_TURN), 2)
    back = Rotation.from_quat(quaternion, scalar_first=True) * turn
    return back.as_quat(scalar_first=True), wrench * signs
