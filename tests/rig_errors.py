"""Recordings of a rig that is not what its calibration says: an error is applied in full to poses, wrenches and rod."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import scan3d
from scan3d.rigs import RIG_QUANTITIES, RigUncertainty
from tests import rigs
from tests.rigs import in_sensor, with_wrench

SIX = ("force_z_N", "moment_x_Nm", "moment_y_Nm")


def six_axis(recording):
    """A recording with all channels; those that a planar one lacks are zero."""
    if recording.six_axis:
        return recording
    zero = np.zeros(len(recording))
    return replace(recording, **dict.fromkeys(SIX, zero))


def displaced(recording, error, sensor=(0.0,) * 6):
    """The recording as a rig with an error (24,) gives it, of `RIG_QUANTITIES` but the weight, and of gains; by rotations.

    The gains belong to a sensor with a place in m and Euler angles in degrees.
    """
    full, gains = six_axis(recording), error[18:]
    axes = Rotation.from_euler("xyz", sensor[3:], degrees=True)
    force, moment = full.wrench()
    arm = np.cross(sensor[:3], force)
    force, moment = (
        axes.apply((1 + np.array(own)) * axes.inv().apply(part))
        for part, own in ((force, gains[:3]), (moment - arm, gains[3:]))
    )
    moment = moment + np.cross(sensor[:3], force)
    turn = Rotation.from_rotvec(error[11:14])
    force, moment = turn.apply(force), turn.apply(moment) + np.cross(error[8:11], turn.apply(force))
    if not recording.six_axis:
        force[:, 2] = moment[:, 0] = moment[:, 1] = 0
    pose = Rotation.from_quat(recording.quaternion, scalar_first=True)
    rod = recording.rod
    moved = with_wrench(recording, force, moment)
    length, stiffness = rod.length_m * float(1 + error[1]), rod.bending_stiffness_Nm2 * float(np.exp(error[0]))
    shape = {"curvature_per_m": (*np.array(error[15:17]).tolist(), 0.0)} if np.any(error[15:17]) else {}
    if error[14]:
        stiffness = ((0.0, stiffness), (length, stiffness * float(np.exp(4 * error[14]))))
    return replace(
        moved,
        position_m=recording.position_m + pose.apply(error[2:5]),
        quaternion=(pose * Rotation.from_rotvec(error[5:8])).as_quat(scalar_first=True),
        rod=scan3d.Rod(length, stiffness, rod.diameter_m, **shape),
    )


def logged(recording, truth):
    """What a rig of `tests.rigs.Truth` logs, with poses and reactions of its own frames, where the clamp does as recorded."""
    full, ratio = six_axis(recording), truth.stiffness / recording.rod.bending_stiffness_Nm2
    force, moment = full.wrench()
    shown = in_sensor(truth, ratio * force, ratio * moment)
    clamp = Rotation.from_euler("xyz", truth.clamp_turn, degrees=True)
    pose = Rotation.from_quat(recording.quaternion, scalar_first=True) * clamp.inv()
    return replace(
        with_wrench(full, *(np.hstack(shown) / (1 + np.array(truth.gains)))[:, [[0, 1, 2], [3, 4, 5]]].swapaxes(0, 1)),
        position_m=recording.position_m - pose.apply(truth.clamp),
        quaternion=pose.as_quat(scalar_first=True),
    )


SENSOR = (0.004, -0.019, 0.005, 12.0, 25.0, -10.0)
"""Place in m and Euler angles in degrees of a sensor whose gains are uncertain."""


def typical(scale=1.0, six=True):
    """The uncertainty of a rig that was calibrated by few touches."""
    deviations = scale * np.repeat([2e-3, 1e-3, 3e-5, 1e-3, 4e-5, 1e-3], [1, 1, 3, 3, 3, 3])
    mixing = np.eye(14) + 0.3 * np.random.default_rng(3).normal(size=(14, 14))
    covariance = deviations[:, None] * (mixing @ mixing.T) * deviations
    kept = np.arange(14) if six else np.array([0, 1, 2, 3, 4, 7, 8, 9, 13])
    covariance = covariance[np.ix_(kept, kept)]
    return RigUncertainty(tuple(RIG_QUANTITIES[k] for k in kept), (covariance + covariance.T) / 2)


def calibrated(seed, sweeps, samples=60):
    """A calibration by few touches of a sphere, and the true rig."""
    truth = rigs.Truth()
    return scan3d.calibrate(rigs.recorded(truth, seed, sweeps=sweeps, samples=samples), rigs.DIAMETER), truth
