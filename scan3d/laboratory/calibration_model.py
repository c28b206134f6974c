"""The equations between a touched reference and the rod, the clamp and the sensor that touch it, with their derivatives.

A row measures nine values: force and moment in the sensor's frame, and the place of the pose.  Four equations hold for the true
values of a row in contact:

1. ``m0·t0 = 0`` and
2. ``m0·f0 = 0`` (S4), the internal consistency of the six reactions,
3. the rod's centre line touches the reference fattened by the rod's radius a: ``|r1 - c| = D/2 + a`` for a sphere,
4. the rod is tangent to it in tangential contact: ``t1·(r1 - c) = 0`` for a sphere; and ``s1 = L`` where the tip touches.

For other references than spheres see `calibration_reference`.  None of the equations refers to friction.  Lengths are in
nominal lengths L, forces in ``EI/L²`` and moments in ``EI/L`` of the nominal rod.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import planar
from scan3d.arrays import Array
from scan3d.frames import to_outer, wrench_matrix
from scan3d.laboratory.calibration_reference import Met, Reference
from scan3d.spatial.inverse import reconstruct

# Contacts that the noise puts past the tip by nearly any part of the rod are still used: their places do not depend on the tip.
PAST_TIP = 0.999
# How far a tangential contact goes, in rod lengths, when the rod turns a little: less far it is at an edge, which tells its
# place; farther, the rod may touch the other side of a face as well.
_AT_EDGE, _ON_FACE = 2e-3, 0.03
# Where the parameters stand in their vector; the tare follows them.
STIFFNESS, CLAMP, TILT, TURN, SENSOR, CENTRE, SPIN, LENGTH, TARE = 0, 1, 4, 6, 9, 12, 15, 18, 19


class Kind(IntEnum):
    """What is known about a row in contact, and so which equations it has."""

    TANGENTIAL = 0
    TIP = 1
    EITHER = 2
    """Without equation 4, for a first estimate: errors along the rod move tangential contacts off the sphere, never into it."""
    UNSURE = 3
    """Near the transition: without equations 3 and 4."""
    ACROSS = 4
    """Tangential, but where along the rod is not told by the reference: without equation 4."""


@dataclass(frozen=True)
class Rig:
    """A rod, its clamp and its sensor, dimensionless, with the place of the reference that they touch."""

    stiffness: float
    """Logarithm of the bending stiffness over the nominal one."""
    clamp: Array
    """(3,) place of the clamp in the frame of the pose."""
    tilt: Array
    """(2,) turn of the clamp about the x and then the z axis of the pose, in radians; a turn about the rod is the sensor's."""
    turn: Array
    """(3, 3) from the sensor's frame to the clamp's: its columns are the sensor's axes."""
    sensor: Array
    """(3,) place of the sensor's frame in the clamp's."""
    centre: Array
    """(3,) place of the reference in the world: a sphere's centre."""
    axes: Array
    """(3, 3) its axes in the world, as columns."""
    length: float
    """Free length of the rod."""
    tare: Array
    """(6, k) force and moment that the sensor shows in the air, as coefficients of the basis of the tare."""

    def moved(self, step: Array) -> Rig:
        """The rig after a step (p,) of its parameters.

        The step of the sensor's turn is a rotation vector in the clamp's frame, those of the reference are in its own frame.
        """
        return replace(
            self,
            stiffness=float(self.stiffness + step[STIFFNESS]),
            clamp=self.clamp + step[CLAMP:TILT],
            tilt=self.tilt + step[TILT:TURN],
            turn=Rotation.from_rotvec(step[TURN:SENSOR]).as_matrix() @ self.turn,
            sensor=self.sensor + step[SENSOR:CENTRE],
            centre=self.centre + self.axes @ step[CENTRE:SPIN],
            axes=self.axes @ Rotation.from_rotvec(step[SPIN:LENGTH]).as_matrix()
            if step[SPIN:LENGTH].any()
            else self.axes,
            length=float(self.length + step[LENGTH]),
            tare=self.tare + step[TARE:].reshape(self.tare.shape),
        )

    def clamp_axes(self) -> tuple[Array, Array, Array]:
        """(3, 3) from the clamp's frame to the pose's, and its derivatives by the two angles of the tilt."""
        (cx, cz), (sx, sz) = np.cos(self.tilt), np.sin(self.tilt)
        about_x, about_z = (
            np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]]),
            np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1.0]]),
        )
        by_x, by_z = (
            np.array([[0, 0, 0], [0, -sx, -cx], [0, cx, -sx]]),
            np.array([[-sz, -cz, 0], [cz, -sz, 0], [0, 0, 0.0]]),
        )
        return about_z @ about_x, about_z @ by_x, by_z @ about_x


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
    kind: NDArray[np.int8]
    """(n,) of `Kind`."""

    def rows(self, selected: NDArray[np.bool_] | NDArray[np.intp]) -> Touches:
        wrench, position, frame, basis, kind = self
        return Touches(wrench[selected], position[selected], frame[selected], basis[selected], kind[selected])


class Equations(NamedTuple):
    """Values of the four equations at rows (n,), with derivatives."""

    value: Array
    """(n, 4)"""
    by_rig: Array
    """(n, 4, p) by the parameters."""
    by_row: Array
    """(n, 4, 9) by the measured values: force, moment and place."""


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


def clamp_wrench(rig: Rig, touches: Touches) -> tuple[Array, Array]:
    """(n, 3) support reaction and clamping moment in the clamp's frame."""
    tared = touches.wrench - touches.basis @ rig.tare.T
    return to_outer(tared[:, :3], tared[:, 3:], rig.turn, rig.sensor)


def bent(force: Array, moment: Array) -> Bent:
    """The rods that reactions (n, 3) bend, over a stiffness of 1; NaN where there is no rod."""
    found = reconstruct(force, moment, tolerance=PAST_TIP)
    e = found.bending
    zero = np.zeros(len(e))
    normal = np.column_stack([-e[:, 2], zero, e[:, 0]])
    m, across = moment[:, 2] * e[:, 0] - moment[:, 0] * e[:, 2], (force * e).sum(axis=1)
    with np.errstate(all="ignore"):
        slopes = planar.jacobian(across, force[:, 1], m)
        omega = np.column_stack([zero, zero, zero, -e[:, 0] / m, zero, -e[:, 2] / m])
        reduced = np.zeros((len(e), 3, 6))
        reduced[:, 0, :3] = e
        reduced[:, 0] += (force * normal).sum(axis=1)[:, None] * omega
        reduced[:, 1, 1] = 1
        reduced[:, 2, 3], reduced[:, 2, 5] = -e[:, 2], e[:, 0]
        x, y, s1, alpha, beta = (slopes @ reduced).swapaxes(0, 1)
        x1, slope, rise = (found.point * e).sum(axis=1), (found.tangent * e).sum(axis=1), found.tangent[:, 1]
        point = e[:, :, None] * x[:, None] + normal[:, :, None] * (x1[:, None] * omega)[:, None]
        point[:, 1] += y
        phi = alpha - beta
        tangent = (
            -(rise[:, None] * e)[:, :, None] * phi[:, None] + normal[:, :, None] * (slope[:, None] * omega)[:, None]
        )
        tangent[:, 1] += slope[:, None] * phi
    return Bent(found.point, found.tangent, found.s1, point, tangent, s1)


def equations(rig: Rig, touches: Touches, reference: Reference) -> Equations:
    """The four equations at each row for a reference.

    Rows without a rod have NaN; equations that do not apply to the kind of a row are 0 with derivatives 0.
    """
    force, moment = clamp_wrench(rig, touches)
    scale = np.exp(-rig.stiffness)
    rod = bent(scale * force, scale * moment)
    n = len(force)
    tip = touches.kind == Kind.TIP
    clamp, by_x, by_z = rig.clamp_axes()
    frame = touches.frame @ clamp
    point, tangent, met = _met(rig, touches, rod, reference)

    value = np.zeros((n, 4))
    value[:, 0], value[:, 1] = moment[:, 1], (moment * force).sum(axis=1)
    value[:, 2], value[:, 3] = met.gap, met.along
    value[tip, 3] = rod.s1[tip] - rig.length

    # by force and moment at the clamp, (n, 4, 6)
    by_wrench = np.zeros((n, 4, 6))
    by_wrench[:, 0, 4] = 1
    by_wrench[:, 1, :3], by_wrench[:, 1, 3:] = moment, force
    by_rig = np.zeros((n, 4, TARE + rig.tare.size))
    by_row = np.zeros((n, 4, 9))
    parts = (
        (2, met.gap_by_point, met.gap_by_tangent),
        (3, met.along_by_point, met.along_by_tangent),
    )
    for row, inner_point, inner_tangent in parts:
        by_point, by_tangent = inner_point @ rig.axes.T, inner_tangent @ rig.axes.T
        local = [np.einsum("nij,ni->nj", frame, vector) for vector in (by_point, by_tangent)]
        moved, turned = (
            np.einsum("ni,nij->nj", vector, part)
            for vector, part in zip(local, (rod.by_point, rod.by_tangent), strict=True)
        )
        by_wrench[:, row] = scale * (moved + turned)
        in_pose = [np.einsum("nij,ni->nj", touches.frame, vector) for vector in (by_point, by_tangent)]
        by_rig[:, row, CLAMP:TILT] = in_pose[0]
        for column, turn in enumerate((by_x, by_z)):
            by_rig[:, row, TILT + column] = (in_pose[0] * (rod.point @ turn.T)).sum(axis=1)
            by_rig[:, row, TILT + column] += (in_pose[1] * (rod.tangent @ turn.T)).sum(axis=1)
        by_rig[:, row, CENTRE:SPIN] = -inner_point
        by_rig[:, row, SPIN:LENGTH] = -np.cross(point, inner_point) - np.cross(tangent, inner_tangent)
        by_row[:, row, 6:] = by_point
    by_wrench[tip, 3] = scale * rod.by_s1[tip]
    both = np.column_stack([force, moment])
    by_rig[:, 2:, STIFFNESS] = -np.einsum("nkj,nj->nk", by_wrench[:, 2:], both)
    by_rig[tip, 3, LENGTH] = -1
    _add_sensor(by_rig, by_wrench, rig, touches, force, moment)
    by_row[:, :, :6] = by_wrench @ wrench_matrix(rig.turn, rig.sensor)
    return Equations(value, by_rig, by_row)


def _met(rig: Rig, touches: Touches, rod: Bent, reference: Reference) -> tuple[Array, Array, Met]:
    """Contacts (n, 3) and tangents (n, 3) in the frame of the reference, and how they meet it, 0 where that has no equation."""
    point, tangent = _inner(rig, touches, rod)
    tangential, unsure = touches.kind == Kind.TANGENTIAL, touches.kind == Kind.UNSURE
    met = reference.met(point, tangent, tangential | (touches.kind == Kind.ACROSS))
    for column in met[:3]:
        column[unsure] = 0
    for column in met[3:]:
        column[~tangential] = 0
    return point, tangent, met


def _inner(rig: Rig, touches: Touches, rod: Bent) -> tuple[Array, Array]:
    """Contacts (n, 3) and tangents (n, 3) in the frame of the reference."""
    clamp = rig.clamp_axes()[0]
    outward = touches.position + np.einsum("nij,nj->ni", touches.frame, rig.clamp + rod.point @ clamp.T) - rig.centre
    return outward @ rig.axes, np.einsum("nij,nj->ni", touches.frame @ clamp, rod.tangent) @ rig.axes


def placed(rig: Rig, touches: Touches, reference: Reference, kind: NDArray[np.int8]) -> NDArray[np.int8]:
    """The kinds (n,) of contacts, those of tangential ones by whether the reference tells where along the rod they are."""
    force, moment = clamp_wrench(rig, touches)
    scale = np.exp(-rig.stiffness)
    tangential = np.isin(kind, (Kind.TANGENTIAL, Kind.ACROSS))
    wander = reference.wander(*_inner(rig, touches, bent(scale * force, scale * moment)))
    told = np.where(wander < _AT_EDGE, Kind.TANGENTIAL, np.where(wander < _ON_FACE, Kind.ACROSS, Kind.UNSURE))
    return np.where(tangential, told, kind).astype(np.int8)


def _add_sensor(by_rig: Array, by_wrench: Array, rig: Rig, touches: Touches, force: Array, moment: Array) -> None:
    """Fill in the derivatives by the sensor's turn, its place and the tare."""
    by_force, by_moment = by_wrench[:, :, :3], by_wrench[:, :, 3:]
    own = moment - np.cross(rig.sensor, force)
    # f -> f + δ × f, m -> m + δ × own + sensor × (δ × f)
    turning = by_force + np.cross(by_moment, rig.sensor)
    by_rig[:, :, TURN:SENSOR] = np.cross(force[:, None], turning) + np.cross(own[:, None], by_moment)
    by_rig[:, :, SENSOR:CENTRE] = np.cross(force[:, None], by_moment)
    by_channel = -(by_wrench @ wrench_matrix(rig.turn, rig.sensor))
    by_rig[:, :, TARE:] = (by_channel[:, :, :, None] * touches.basis[:, None, None]).reshape(
        *by_rig.shape[:2], rig.tare.size
    )
