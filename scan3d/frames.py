"""Frames that sit on other frames: what a sensor shows, moved to the clamp, and the pose of what a robot carries.

A frame has an origin d and the axes that are the columns of a rotation R, both in the outer frame.  Its vectors v are
``R v`` in the outer one.  A force keeps its size under a shift; a moment refers to the origin of its frame, so that
force F and moment M in the frame of a sensor are, in that of the clamp and about the clamp's origin,

    f = R F,    m = R M + d × f.

Turns are rotation matrices, or Euler angles about fixed axes in the order x, y, z.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.units import length, number

_EULER = "xyz"


def turn_of(euler_deg: ArrayLike) -> Array:
    """The rotation matrix (3, 3) of Euler angles (3,) in degrees."""
    return Rotation.from_euler(_EULER, np.asarray(euler_deg, dtype=float), degrees=True).as_matrix()


def euler_of(turn: Array) -> Array:
    """The Euler angles (3,), in degrees, of a rotation matrix (3, 3)."""
    return np.asarray(Rotation.from_matrix(turn).as_euler(_EULER, degrees=True))


def axes_of(quaternion: Array) -> Array:
    """(n, 3, 3) the axes x, y and z, as rows, of frames with orientations (n, 4), w first."""
    matrices: Array = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    return matrices.swapaxes(1, 2)


def check_positions(what: str, position_m: Array, length_m: float) -> None:
    """Raise InputError where positions (n, 3) are so far from the origin that their rounding blurs a rod of that length."""
    largest = float(np.abs(position_m).max())
    step = float(np.spacing(largest))
    # a thousandth of the thinnest rods' diameters
    if step > 1e-6 * length_m:
        raise InputError(
            f"{what}: position_m holds {number(largest)} m, where numbers are {length(step, 'm', digits=2)} apart, too "
            "coarse for a rod of "
            f"{length(length_m, 'm')}; check its unit, or take a frame near the body"
        )


def check_columns(what: str, columns: Mapping[str, Array], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Raise InputError, about `what`, unless columns have these shapes, the first of which is their length, and are finite."""
    for name, shape in shapes.items():
        column = np.asarray(columns[name])
        if column.shape != shape:
            raise InputError(f"{what}: {name} must have the shape {shape}, got {column.shape}")
        bad = ~np.isfinite(column.astype(float)).reshape(shape[0], -1).all(axis=1)
        if bad.any():
            raise InputError(
                f"{what}: {name} is not a number in {bad.sum()} of {len(bad)} rows, first in row {np.argmax(bad) + 1}"
            )


def check_orientations(what: str, quaternion: Array) -> None:
    """Raise InputError, about `what`, unless orientations (n, 4) are unit quaternions."""
    with np.errstate(over="ignore"):  # the length of huge quaternions is infinite, and is refused
        length = np.linalg.norm(quaternion, axis=1)
    worst = int(np.argmax(np.abs(length - 1)))
    # three digits are enough
    if abs(length[worst] - 1) > 1e-3:
        raise InputError(
            f"{what}: orientations must be unit quaternions (qw, qx, qy, qz); that of row {worst + 1} has the length "
            f"{length[worst]:.4g}"
        )


@dataclass(frozen=True)
class Frame:
    """A frame in another one."""

    position_m: Array
    """(3,) its origin."""
    turn: Array
    """(3, 3) its axes, as columns."""

    @classmethod
    def of(cls, position_m: ArrayLike, euler_deg: ArrayLike) -> Frame:
        """The frame with the origin (3,), turned by Euler angles (3,) in degrees."""
        return cls(np.asarray(position_m, dtype=float), turn_of(euler_deg))

    @property
    def trivial(self) -> bool:
        """Whether it is the outer frame itself."""
        return not self.position_m.any() and bool((self.turn == np.eye(3)).all())

    def within(self, outer: Frame) -> Frame:
        """This frame, which is given in `outer`, in the frame in which `outer` is given."""
        return Frame(outer.position_m + outer.turn @ self.position_m, outer.turn @ self.turn)

    def carried(self, position: Array, quaternion: Array) -> tuple[Array, Array]:
        """Its places (n, 3) and orientations (n, 4), w first, where those of the outer frame are given."""
        if self.trivial:
            return position, quaternion
        outer = Rotation.from_quat(quaternion, scalar_first=True)
        turned = outer * Rotation.from_matrix(self.turn)
        return position + outer.apply(self.position_m), turned.as_quat(scalar_first=True)


def to_outer(force: Array, moment: Array, turn: Array, place: Array) -> tuple[Array, Array]:
    """Force and moment (n, 3) in a frame with a turn (3, 3) at a place (3,), as those in the outer frame."""
    force = force @ turn.T
    return force, moment @ turn.T + np.cross(place, force)


def to_inner(force: Array, moment: Array, turn: Array, place: Array) -> tuple[Array, Array]:
    """Force and moment (n, 3) in the outer frame, as those in a frame with a turn (3, 3) at a place (3,)."""
    return force @ turn, (moment - np.cross(place, force)) @ turn


def wrench_matrix(turn: Array, place: Array) -> Array:
    """(6, 6) what takes wrenches in a frame to those in the outer one, as `to_outer`."""
    x, y, z = place
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.block([[turn, np.zeros((3, 3))], [cross @ turn, turn]])


def displaced(force: Array, moment: Array, turn: Array, shift: Array) -> tuple[Array, Array]:
    """Force and moment (..., 3) after a small turn (..., 3) and a shift (..., 3) of their frame.

    The turn is a rotation vector, which counts to the first order.
    """
    return force + np.cross(turn, force), moment + np.cross(turn, moment) + np.cross(shift, force)
