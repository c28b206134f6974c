"""Which differences count as noise, and what the uncertainty of a calibrated rig does to contacts, to the first order.

Each of the independent errors of the rig (`scan3d.rigs`) is applied to the poses and wrenches of the rows in contact; the
contacts of the closed form move in proportion.  A recording in a plane has three channels: what an error of the rig adds to the
others is left out, as it is in the reconstruction.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

import planar
from scan3d.arrays import AT_ONCE, Array, Index, Mask
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.frames import displaced
from scan3d.recording import FORCE_SIGMAS, Recording
from scan3d.rigs import RIG_QUANTITIES, RigErrors
from scan3d.spatial import inverse
from scan3d.spatial.march import reshaped

LARGEST_TOLERANCE = 0.5
"""Distance from the tip, in rod lengths, within which a contact may count as one of the tip, whatever its uncertainty."""
# A contact counts as one of the tip if it lies within this many standard deviations of it, by the noise or by the calibration.
_TIP_SIGMAS = 5.0
# A contact is left out if the standard deviation of its place is larger than this many times the median, and than this fraction
# of the rod's length: the rod touched too lightly, and it may lie far outside the body.
_LIGHT, _TOLERABLE = 4.0, 1e-3
# Part of a standard deviation by which the rig is changed in central differences: between their error and rounding.
_STEP = 1e-2
# Standard deviations by which a reaction is changed: about as many as all contacts stay within at once, so that what is not
# linear in the error of a wrench is part of its effect.
_FAR = 4.0
# Which reactions each model reads, of the six.
_REACTIONS = {"planar": (0, 1, 5), "spatial": tuple(range(6))}
RIGHT_ROWS = 0.05
"""Right rows that are left out in a recording, in the mean, if each is judged once: fewer, and wild rows are not seen that make
bounds false; more, and all bounds are widened for nothing."""
# Median of the sizes of normal numbers.
_MEDIAN_OF_NORMAL = float(ndtri(0.75))
# By how much the body may be wider than its contacts.
_WIDENED = 1.1


class NoContactError(InputError):
    """No row of a recording has the reactions of a bent rod."""


def contact_tolerance(error: planar.Errors) -> Array:
    """(n,) differences in s1 and in the friction angle that count as noise; those of exact data where there is no rod."""
    return np.where(
        np.isfinite(error.largest), tip_sigmas(np.maximum(error.s1, error.friction_angle)), planar.TOLERANCE
    )


def tip_sigmas(s1: Array) -> Array:
    """(n,) distances to the tip that count as zero, by the standard deviations (n,) of the arc length."""
    return np.clip(_TIP_SIGMAS * s1, planar.TOLERANCE, LARGEST_TOLERANCE)


def too_light(largest: Array, touching: Mask) -> Mask:
    """(n,) which rows in contact touch too lightly, by the standard deviations (n,) of all places."""
    if not touching.any():
        return touching
    return touching & (largest > max(_LIGHT * float(np.median(largest[touching])), _TOLERABLE))


def felt(force: Array, noise: tuple[float, float]) -> Mask:
    """(n,) whether dimensionless forces (n, 2 or 3) stand out from the noise of force and moment."""
    return np.asarray(np.linalg.norm(force, axis=1) > FORCE_SIGMAS * max(noise))


class Air(NamedTuple):
    """What rows without a felt force say of the noise."""

    rows: int
    """Number of those whose neighbours have none either."""
    size: float | None
    """Standard deviations for each that counts, 1 at least; None if no value is larger than expected."""
    chance: float
    """Probability, at most, with which a right recording has a value as large as its largest."""


def noise_in_air(recording: Recording) -> Air:
    """The noise by second differences of successive rows in the air, in which touches that begin or end do not show."""
    noise, order = recording.noise.of_reactions(recording.rod), np.argsort(recording.sweep, kind="stable")
    force, moment = (part[order] for part in recording.reactions(recording.six_axis))
    air, sweep = ~felt(recording.pressing(recording.six_axis)[order], noise), recording.sweep[order]
    sd, channels = np.repeat(noise, 3), np.array(_REACTIONS["spatial" if recording.six_axis else "planar"])
    channels = channels[sd[channels] > 0]
    before, own, after = (np.hstack([force, moment])[k : len(order) - 4 + k, channels] for k in (1, 2, 3))
    known = np.all([air[k : len(air) - 4 + k] for k in range(5)] + [sweep[4:] == sweep[:-4]], axis=0)
    found = np.abs(before - 2 * own + after)[known] / (np.sqrt(6) * sd[channels])
    if not found.size:
        return Air(0, None, 1.0)
    chance = float(2 * found.size * ndtr(-found.max()))
    size = None if chance >= RIGHT_ROWS else max(1.0, float(np.median(found)) / _MEDIAN_OF_NORMAL)
    return Air(len(found), size, chance)


class Effects(NamedTuple):
    """What p independent errors of one standard deviation do to contacts (n,), dimensionless, in the world."""

    place: Array
    """(n, 3, p)"""
    tangent: Array
    """(n, 3, p)"""
    s1: Array
    """(n, p)"""


def effects(recording: Recording, rows: Index, model: str) -> Effects:
    """The effects on the contacts of some rows; NaN where a row has no rod.  The recording has a `rig`."""
    assert recording.rig is not None
    axes = recording.axes()[rows]
    moved: list[list[Array]] = [[], [], []]
    (force, moment), noise = _wrench(recording, rows), _weights(recording, model)
    exact, right = np.zeros(len(RIG_QUANTITIES)), np.zeros(6)
    errors = [(_STEP, component, right) for component in recording.rig.components().T]
    size = np.zeros((len(rows), 1))
    if relative := recording.rig.relative:
        size = _size(recording, rows)[:, None]
        errors += [(_FAR, exact, relative * np.eye(6)[k]) for k in _REACTIONS[model]]

    def changed(step: float, component: Array, of_wrench: Array) -> tuple[Array, Array, Array]:
        wrench = force + step * size * of_wrench[:3], moment + step * size * of_wrench[3:]
        return _contacts(recording, rows, wrench, noise, step * component)

    middle = changed(0.0, exact, right)
    for step, component, of_wrench in errors:
        sides = changed(step, component, of_wrench), changed(-step, component, of_wrench)
        with np.errstate(invalid="ignore"):
            for column, one, between, other in zip(moved, sides[0], middle, sides[1], strict=True):
                column.append(_larger(one - between, between - other) / step)
    place, tangent, s1 = (
        np.stack(column, axis=-1) if column else np.zeros((len(rows), *shape, 0))
        for column, shape in zip(moved, ((3,), (3,), ()), strict=True)
    )
    place, tangent = (np.einsum("nip,nij->njp", column, axes) for column in (place, tangent))
    return Effects(place, tangent, s1)


def _larger(one: Array, other: Array) -> Array:
    """(n,) or (n, 3): the larger one of two changes in each row; NaN where either is."""
    squares = ((part**2).reshape(len(part), -1).sum(axis=1) for part in (one, other))
    larger = np.greater(*squares).reshape(-1, *[1] * (one.ndim - 1))
    return np.asarray(np.where(larger, one, other) + 0 * one)


def _size(recording: Recording, rows: Index) -> Array:
    """(n,) sizes of the wrenches of some rows, no less than the median of all rows with a force."""
    force, moment = recording.reactions(recording.six_axis)
    size = np.linalg.norm(np.hstack([force, moment]), axis=1)
    pressed = felt(recording.pressing(recording.six_axis), recording.noise.of_reactions(recording.rod))
    return np.asarray(np.maximum(size[rows], np.median(size[pressed]) if pressed.any() else 0.0))


def _wrench(recording: Recording, rows: Index) -> tuple[Array, Array]:
    force, moment = recording.reactions(recording.six_axis)
    return force[rows], moment[rows]


def _weights(recording: Recording, model: str) -> tuple[float, float] | None:
    """Noise of force and moment, by which the spatial model weights what it knows of the bending plane; None in a plane."""
    return None if model == "planar" else recording.noise.of_reactions(recording.rod)


def _contacts(
    recording: Recording,
    rows: Index,
    wrench: tuple[Array, Array],
    noise: tuple[float, float] | None,
    error: Array,
) -> tuple[Array, Array, Array]:
    """Contacts (n, 3), tangents (n, 3) and s1 (n,) in the clamp's frame, by a rig that differs by an error (17,)."""
    rod, (force, moment) = recording.rod, wrench
    offset, turn, lever, sensor_turn = error[2:5] / rod.length_m, error[5:8], error[8:11] / rod.length_m, error[11:14]
    softer = np.exp(-error[0])
    force, moment = (softer * part for part in displaced(force, moment, sensor_turn, lever))
    if noise is None:
        force[:, 2] = 0
        moment[:, :2] = 0
    down = recording.down()
    found = inverse.reconstruct(
        force,
        moment,
        tolerance=inverse.PAST_TIP,
        noise=noise,
        rod=reshaped(rod.in_space(), error[14:] * [1.0, rod.length_m, rod.length_m]),
        gravity=None if down is None else down[rows],
    )
    place = offset + found.point + np.cross(turn, found.point)
    return place, found.tangent + np.cross(turn, found.tangent), found.s1 / (1 + error[1])


def torsion_sd(recording: Recording, rows: Index) -> Array:
    """(n,) standard deviations, dimensionless, of the moment about the rod, which a single contact force does not have."""
    assert recording.rig is not None
    force, moment = _wrench(recording, rows)
    components = recording.rig.components()
    lever, turn = components[8:11] / recording.rod.length_m, components[11:14]
    moment[:, 1] = 0  # the other components give what is added to it
    parts = displaced(force[:, None], moment[:, None], turn.T, lever.T)[1][..., 1]
    return np.asarray(np.linalg.norm(parts, axis=1))


def tip_tolerance(recording: Recording, felt: Mask, tolerance: Array | float, model: str) -> Array | float:
    """The differences of s1 to the tip (n,) that count as zero, by the noise and by the calibration."""
    if recording.rig is None:
        return tolerance
    widened = np.zeros(len(recording))
    for rows in _blocks(np.flatnonzero(felt)):
        s1 = np.linalg.norm(effects(recording, rows, model).s1, axis=1)
        widened[rows] = np.where(np.isfinite(s1), _TIP_SIGMAS * s1, 0.0)
    return np.asarray(np.clip(np.hypot(tolerance, widened), planar.TOLERANCE, LARGEST_TOLERANCE))


def _blocks(rows: Index) -> list[Index]:
    return np.array_split(rows, 1 + 3 * len(RIG_QUANTITIES) * len(rows) // AT_ONCE)


def with_rig_errors(cloud: Cloud, recording: Recording) -> Cloud:
    """The cloud with what the uncertainty of the recording's rig does to its contacts; those that it may undo are left out."""
    if recording.rig is None:
        return cloud
    points = cloud.points if cloud.centre_points is None else cloud.centre_points
    centre = points.mean(axis=0)
    square, axes = np.linalg.eigh((points - centre).T @ (points - centre))
    # the contacts lie in an ellipsoid with their own axes of inertia
    shape = axes * np.sqrt(np.maximum(square, 0.0)) @ axes.T
    radius = float(np.linalg.norm((points - centre) @ np.linalg.pinv(shape), axis=1).max())
    blocks = [
        _of_block(cloud, recording, part, centre, _WIDENED * radius * shape) for part in _blocks(np.arange(len(cloud)))
    ]
    covariance, turn, across, tilt, height = (np.concatenate(column) for column in zip(*blocks, strict=True))
    relative, count = recording.rig.relative, recording.rig.components().shape[1]
    if relative:
        count += len(_REACTIONS[cloud.model]) ** 2
    found = RigErrors(covariance, turn, across, tilt, height, count, relative)
    cloud = replace(cloud, calibration=found)
    together = np.column_stack([covariance.reshape(-1, 9), turn, across, tilt, height])
    known = np.flatnonzero(np.isfinite(together).all(axis=1))
    return cloud if len(known) == len(cloud) else cloud.select(known)


def _of_block(cloud: Cloud, recording: Recording, part: Index, centre: Array, shape: Array) -> tuple[Array, ...]:
    """The columns of `RigErrors` of some contacts."""
    rows, length = cloud.row[part].astype(np.intp), cloud.rod_length
    points = (cloud.points if cloud.centre_points is None else cloud.centre_points)[part]
    moved = effects(recording, rows, cloud.model)
    place, turned = length * moved.place, moved.tangent
    axes = recording.axes()[rows]
    noise = _weights(recording, cloud.model)
    bent = _contacts(recording, rows, _wrench(recording, rows), noise, np.zeros(len(RIG_QUANTITIES)))
    tangent = np.einsum("ni,nij->nj", bent[1], axes)
    tangential = cloud.phase[part] == planar.Phase.TANGENTIAL
    turned = np.where(tangential[:, None, None], turned, 0.0)
    normal = axes[:, 2]
    sideways = np.where(tangential[:, None], np.cross(normal, tangent), 0.0)
    middle, half = ((centre - points) * tangent).sum(axis=1), np.linalg.norm(tangent @ shape, axis=1)
    height = _along(normal, place)
    for along in (middle - half, middle + half):  # of a tip contact, whose tangent says nothing, `turned` is 0
        height = np.maximum(height, _along(normal, place + along[:, None, None] * turned))
    known = np.asarray(np.isfinite(turned).all(axis=(1, 2)))
    turn = np.full(len(part), np.nan)
    turn[known] = np.linalg.norm(turned[known], ord=2, axis=(1, 2))
    covariance = place @ place.transpose(0, 2, 1)
    return covariance, turn, _along(sideways, place), _along(sideways, turned), height


def _along(directions: Array, moved: Array) -> Array:
    """(n,) standard deviations along directions (n, 3) of what moves by (n, 3, p)."""
    return np.linalg.norm(np.einsum("ni,nip->np", directions, moved), axis=1)
