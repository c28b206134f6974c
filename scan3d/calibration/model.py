"""The equations between a touched reference and the rod, the clamp and the sensor that touch it, with their derivatives.

A row measures nine values: force and moment in the sensor's frame, and the place of the pose.  Four equations hold for
the true values of a row in contact:

1. ``m0·t0 = 0`` and
2. ``m0·f0 = 0`` (S4), the internal consistency of the six reactions; of any other rod 1. is the moment about it at the contact,
3. the rod's centre line touches the reference fattened by the rod's radius a: ``|r1 - c| = D/2 + a`` for a sphere,
4. the rod is tangent to it in tangential contact, ``t1·n = 0`` with the reference's normal n there; and ``s1 = L`` where
   the tip touches.

None of the equations refers to friction.  Derivatives by a turn are those by a small rotation vector after it.  Lengths are
in nominal lengths L, forces in ``EI/L²`` and moments in ``EI/L`` of the nominal rod.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import planar
from planar.rods import STEPS
from scan3d.arrays import Array
from scan3d.calibration.references import Reference
from scan3d.rigs import to_outer, wrench_matrix
from scan3d.spatial.inverse import PAST_TIP, reconstruct
from scan3d.spatial.march import SpatialRod, reshaped

# Where the parameters stand in their vector, by their numbers; the tare follows them.
STIFFNESS, CLAMP, TILT, TURN, SENSOR, PLACE, LENGTH, SHAPE, GAINS, MIXING, TARE = accumulate(
    (0, 1, 3, 2, 3, 3, 3, 1, 3, 6, 36)
)


class Kind(IntEnum):
    """What is known about a row in contact, and so which equations it has."""

    TANGENTIAL = 0
    TIP = 1
    EITHER = 2
    """Without equation 4, for a first estimate."""
    UNSURE = 3
    """Near the transition: without equations 3 and 4."""


@dataclass(frozen=True)
class Rig:
    """A rod, its clamp and its sensor, dimensionless, with the reference that they touch."""

    stiffness: float
    """Logarithm of the bending stiffness over the nominal one."""
    clamp: Array
    """(3,) place of the clamp in the frame of the pose."""
    tilt: Array
    """(2,) turn of the clamp about the x and then the z axis of the pose, in radians; one about the rod is the sensor's."""
    turn: Array
    """(3, 3) from the sensor's frame to the clamp's: its columns are the sensor's axes."""
    sensor: Array
    """(3,) place of the sensor's frame in the clamp's."""
    reference: Reference
    """Where it is in the world."""
    length: float
    """Free length of the rod."""
    tare: Array
    """(6, k) force and moment that the sensor shows in the air, as coefficients of the basis of the tare."""
    gains: Array
    """(6,) what is added to the tared channels of the sensor, as multiples of them."""
    mixing: Array
    """(6, 6) what is added to the tared channels, as multiples of them, against further gains and cross-talk of the sensor."""
    stated: SpatialRod
    """The rod as it is stated, of the nominal length."""
    shape: Array
    """(3,) logarithm of what the tip's diameter over the clamp's is more than stated, and curvature about z and x more than
    stated, over the nominal length."""
    marched: bool
    """Whether the rod has a shape that is not that of a straight, uniform one, or may turn out to have."""

    @property
    def rod(self) -> SpatialRod:
        """The rod of the nominal length, beyond whose tip it goes on."""
        return reshaped(self.stated, self.shape)

    def moved(self, step: Array) -> Rig:
        """The rig after a step (p,) of its parameters; that of the sensor's turn is a rotation vector in the clamp's frame."""
        return replace(
            self,
            stiffness=float(self.stiffness + step[STIFFNESS]),
            clamp=self.clamp + step[CLAMP:TILT],
            tilt=self.tilt + step[TILT:TURN],
            turn=Rotation.from_rotvec(step[TURN:SENSOR]).as_matrix() @ self.turn,
            sensor=self.sensor + step[SENSOR:PLACE],
            reference=self.reference.moved(step[PLACE:LENGTH]),
            length=float(self.length + step[LENGTH]),
            tare=self.tare + step[TARE:].reshape(self.tare.shape),
            gains=self.gains + step[GAINS:MIXING],
            mixing=self.mixing + step[MIXING:TARE].reshape(6, 6),
            shape=self.shape + step[SHAPE:GAINS],
        )

    @property
    def added(self) -> Array:
        """(6, 6) what is added to the tared channels, as multiples of them."""
        return np.asarray(self.mixing + np.diag(self.gains))

    def clamp_axes(self) -> tuple[Array, Array, Array]:
        """(3, 3) from the clamp's frame to the pose's, and its derivatives by the two angles of the tilt."""
        about_x, about_z = (Rotation.from_euler(*turn).as_matrix() for turn in zip("xz", self.tilt, strict=True))
        turn = about_z @ about_x
        return turn, about_z @ np.cross([1.0, 0.0, 0.0], about_x.T).T, np.cross([0.0, 0.0, 1.0], turn.T).T


class Touches(NamedTuple):
    """Rows in contact (n,), as measured or adjusted, dimensionless."""

    wrench: Array
    """(n, 6) force and moment in the sensor's frame."""
    position: Array
    """(n, 3) place of the pose in the world."""
    frame: Array
    """(n, 3, 3) from the frame of the pose to the world."""
    basis: Array
    """(n, k) basis of the tare."""
    sweep: NDArray[np.int64]
    number: NDArray[np.intp]
    """(n,) of the row in the recording."""
    around: Array
    """(n, 6) wrench of the row's neighbours, which decides whether it is used."""
    kind: NDArray[np.int8]
    """(n,) of `Kind`."""

    def moved(self, correction: Array) -> Touches:
        """The rows with corrections (n, 9) of what was measured."""
        return self._replace(wrench=self.wrench + correction[:, :6], position=self.position + correction[:, 6:])


class Bent(NamedTuple):
    """The contact of each row (n,) in the clamp's frame, with derivatives by the wrench at the clamp over the stiffness."""

    point: Array
    tangent: Array
    s1: Array
    by_point: Array
    """(n, 3, 6)"""
    by_tangent: Array
    by_s1: Array
    """(n, 6)"""
    torsion: Array
    """(n,) moment about the rod at the contact."""
    by_torsion: Array
    """(n, 6)"""
    by_shape: Array | None
    """(n, 8, 3) derivatives of point, tangent, s1 and torsion by the rod's shape, if it may have one."""


def clamp_wrench(rig: Rig, touches: Touches) -> tuple[Array, Array]:
    """(n, 3) support reaction and clamping moment in the clamp's frame."""
    tared = touches.wrench - touches.basis @ rig.tare.T
    tared += tared @ rig.added.T
    return to_outer(tared[:, :3], tared[:, 3:], rig.turn, rig.sensor)


def contacts(rig: Rig, touches: Touches) -> tuple[Array, Array]:
    """Contacts (n, 3) in the clamp's frame, NaN where there is no rod, and their places s1 (n,) along it."""
    force, moment = clamp_wrench(rig, touches)
    scale = np.exp(-rig.stiffness)
    found = reconstruct(scale * force, scale * moment, tolerance=PAST_TIP, rod=rig.rod, steps=STEPS)
    return found.point, found.s1


def bent(rig: Rig, force: Array, moment: Array) -> Bent:
    """The rods that reactions (n, 3) bend, over a stiffness of 1; NaN where there is no rod."""
    if rig.marched:
        return _of_shape(rig, force, moment)
    found = reconstruct(force, moment, tolerance=PAST_TIP)
    e = found.bending
    zero = np.zeros(len(e))
    normal = np.column_stack([-e[:, 2], zero, e[:, 0]])
    m, across = moment[:, 2] * e[:, 0] - moment[:, 0] * e[:, 2], (force * e).sum(axis=1)
    with np.errstate(all="ignore"):
        slopes = planar.jacobian(across, force[:, 1], m)
        # the derivatives of the bending plane's angle, and of the three reactions in that plane
        omega = np.column_stack([zero, zero, zero, -e[:, 0] / m, zero, -e[:, 2] / m])
        reduced = np.zeros((len(e), 3, 6))
        reduced[:, 0, :3] = e
        reduced[:, 0] += (force * normal).sum(axis=1)[:, None] * omega
        reduced[:, 1, 1] = 1
        reduced[:, 2, 3], reduced[:, 2, 5] = -e[:, 2], e[:, 0]
        x, y, s1, alpha, beta = (slopes @ reduced).swapaxes(0, 1)
        out, rise = (found.point * e).sum(axis=1), found.tangent[:, 1]
        slope = (found.tangent * e).sum(axis=1)
        phi = (alpha - beta)[:, None]
        by_point = e[:, :, None] * x[:, None] + normal[:, :, None] * (out[:, None] * omega)[:, None]
        by_point[:, 1] += y
        by_tangent = normal[:, :, None] * (slope[:, None] * omega)[:, None] - (rise[:, None] * e)[:, :, None] * phi
        by_tangent[:, 1] += slope[:, None] * phi[:, 0]
    about_rod = np.zeros((len(e), 6))
    about_rod[:, 4] = 1
    return Bent(found.point, found.tangent, found.s1, by_point, by_tangent, s1, moment[:, 1], about_rod, None)


def _of_shape(rig: Rig, force: Array, moment: Array) -> Bent:
    """`bent` of any rod, by differences in steps relative to the wrench, and of the shape, between their error and rounding."""
    difference = 1e-5

    def at(wrench: Array, change: Array) -> Array:
        rod = reshaped(rig.stated, rig.shape + change)
        found = reconstruct(wrench[:, :3], wrench[:, 3:], tolerance=PAST_TIP, rod=rod, steps=STEPS)
        return np.column_stack([found.point, found.tangent, found.s1, found.torsion])

    wrench, n = np.hstack([force, moment]), len(force)
    sizes = difference * np.repeat([np.linalg.norm(part, axis=1) for part in (force, moment)], 3, axis=0).T
    moved = at(np.concatenate([wrench, *(wrench + step * sizes for step in np.eye(6))]), np.zeros(3))
    values = np.concatenate([moved, *(at(wrench, step) for step in difference * np.eye(3))]).reshape(10, n, 8)
    steps = np.hstack([sizes, np.full((n, 3), difference)])
    with np.errstate(all="ignore"):
        slopes = np.moveaxis((values[1:] - values[0]) / steps.T[:, :, None], 0, -1)
    point, tangent, s1, torsion = np.split(values[0], [3, 6, 7], axis=1)
    by = slopes[..., :6]
    return Bent(point, tangent, s1[:, 0], by[:, :3], by[:, 3:6], by[:, 6], torsion[:, 0], by[:, 7], slopes[..., 6:])


class Equations(NamedTuple):
    """Values of the four equations at rows (n,), with derivatives."""

    value: Array
    """(n, 4)"""
    by_rig: Array
    """(n, 4, p) by the parameters."""
    by_row: Array
    """(n, 4, 9) by the measured values: force, moment and place."""


def equations(rig: Rig, touches: Touches) -> Equations:
    """The four equations at each row.

    Rows without a rod have NaN; equations that do not apply to the kind of a row are 0 with derivatives 0.
    """
    force, moment = clamp_wrench(rig, touches)
    scale = np.exp(-rig.stiffness)
    rod = bent(rig, scale * force, scale * moment)
    n, kind, frame = len(force), touches.kind, touches.frame
    tip, sure = kind == Kind.TIP, kind != Kind.UNSURE
    turn, by_x, by_z = rig.clamp_axes()
    point = touches.position + np.einsum("nij,nj->ni", frame, rig.clamp + rod.point @ turn.T)
    met = rig.reference.met(point, np.einsum("nij,nj->ni", frame @ turn, rod.tangent))

    value = np.zeros((n, 4))
    value[:, 0] = moment[:, 1] if rod.by_shape is None else rod.torsion / scale
    value[:, 1] = (moment * force).sum(axis=1)
    value[:, 2], value[:, 3] = met.gap, met.along
    by_wrench, by_row, by_rig = np.zeros((n, 4, 6)), np.zeros((n, 4, 9)), np.zeros((n, 4, TARE + rig.tare.size))
    by_wrench[:, 0] = rod.by_torsion
    by_wrench[:, 1, :3], by_wrench[:, 1, 3:] = moment, force
    for row, by_point, by_tangent, by_place in (
        (2, met.normal, np.zeros_like(point), met.gap_by_place),
        (3, met.along_by_point, met.normal, met.along_by_place),
    ):
        point_in_pose, tangent_in_pose = (np.einsum("nij,ni->nj", frame, part) for part in (by_point, by_tangent))
        by_wrench[:, row] = np.einsum("ni,nij->nj", point_in_pose @ turn, rod.by_point)
        by_wrench[:, row] += np.einsum("ni,nij->nj", tangent_in_pose @ turn, rod.by_tangent)
        by_rig[:, row, CLAMP:TILT] = point_in_pose
        for column, by_angle in enumerate((by_x, by_z)):
            by_rig[:, row, TILT + column] = (point_in_pose * (rod.point @ by_angle.T)).sum(axis=1)
            by_rig[:, row, TILT + column] += (tangent_in_pose * (rod.tangent @ by_angle.T)).sum(axis=1)
        if rod.by_shape is not None:
            by_rig[:, row, SHAPE:GAINS] = np.einsum("ni,nij->nj", point_in_pose @ turn, rod.by_shape[:, :3])
            by_rig[:, row, SHAPE:GAINS] += np.einsum("ni,nij->nj", tangent_in_pose @ turn, rod.by_shape[:, 3:6])
        by_rig[:, row, PLACE:LENGTH] = by_place
        by_row[:, row, 6:] = by_point
    # the reference is fattened by the radius at the clamp, and a tapered rod has another one at the contact
    thickness, profile = rig.reference.thickness, rig.rod.profile
    value[:, 2] -= thickness * (profile.diameter(rod.s1) - 1)
    taper = thickness * profile.slope(rod.s1)
    by_wrench[:, 2] -= taper[:, None] * rod.by_s1
    if rod.by_shape is not None:
        by_rig[:, 2, SHAPE:GAINS] -= taper[:, None] * rod.by_shape[:, 6]
        growth = np.exp(rig.shape[0]) * np.multiply(profile.knots, rig.stated.profile.diameters)
        by_rig[:, 2, SHAPE] -= thickness * np.interp(rod.s1, profile.knots, growth)
    value[tip, 3] = rod.s1[tip] - rig.length
    by_wrench[tip, 3], by_rig[tip, 3], by_row[tip, 3] = rod.by_s1[tip], 0, 0
    by_rig[tip, 3, LENGTH] = -1
    if rod.by_shape is not None:
        by_rig[tip, 3, SHAPE:GAINS] = rod.by_shape[tip, 6]
        by_rig[:, 0, SHAPE:GAINS] = rod.by_shape[:, 7] / scale
    by_wrench[:, 2:] *= scale
    wrench = np.column_stack([force, moment])
    by_rig[:, 2:, STIFFNESS] = -np.einsum("nkj,nj->nk", by_wrench[:, 2:], wrench)
    by_rig[:, 0, STIFFNESS] = value[:, 0] - (by_wrench[:, 0] * wrench).sum(axis=1)
    # a turn δ of the sensor: f -> f + δ × f, m -> m + δ × (m - d × f) + d × (δ × f)
    by_force, by_moment = by_wrench[:, :, :3], by_wrench[:, :, 3:]
    own = (moment - np.cross(rig.sensor, force))[:, None]
    by_rig[:, :, TURN:SENSOR] = np.cross(force[:, None], by_force + np.cross(by_moment, rig.sensor))
    by_rig[:, :, TURN:SENSOR] += np.cross(own, by_moment)
    by_rig[:, :, SENSOR:PLACE] = np.cross(force[:, None], by_moment)
    by_channel = by_wrench @ wrench_matrix(rig.turn, rig.sensor)
    by_row[:, :, :6] = by_channel + by_channel @ rig.added
    tared = touches.wrench - touches.basis @ rig.tare.T
    by_rig[:, :, GAINS:MIXING] = by_channel * tared[:, None]
    by_rig[:, :, MIXING:TARE] = (by_channel[..., None] * tared[:, None, None]).reshape(n, 4, -1)
    by_rig[:, :, TARE:] = -(by_row[:, :, :6, None] * touches.basis[:, None, None]).reshape(n, 4, -1)
    for row, applies in ((2, sure), (3, tip | (kind == Kind.TANGENTIAL))):
        for part in (value, by_rig, by_row):
            part[~applies, row] = 0
    return Equations(value, by_rig, by_row)
