"""The frames of a rig, of which one sits on the other, and what is not known exactly of a calibrated one.

What a sensor shows is moved to the clamp, and the pose of what a robot carries follows from its own.  A frame has an
origin d and the axes that are the columns of a rotation R, both in the outer frame.  Its vectors v are ``R v`` in the outer
one.  A force keeps its size under a shift; a moment refers to the origin of its frame, so that force F and moment M in the
frame of a sensor are, in that of the clamp and about the clamp's origin,

    f = R F,    m = R M + d × f.

Turns are rotation matrices, or Euler angles about fixed axes in the order x, y, z.

The errors of a calibration are the same in all rows of a recording, so that no number of touches reduces them.  They are stated
for poses and wrenches as a recording has them, in the clamp's frame and after all corrections:

- stiffness and length of the rod, and its diameter at the tip over that at the clamp, relative to the recording's rod; its
  curvature and its weight;
- the clamp's offset, and its turn about its own origin;
- the sensor's offset d, which adds ``d × F`` to the moment;
- the sensor's turn w about the clamp's origin, which adds ``w × F`` to the force and ``w × m`` to the moment;
- the gains of the sensor's channels, each of which adds a multiple of the channel to itself, in the sensor's own frame.

Beside them stands the relative error of the wrench ε: what a rod that is not quite the stated one, gains and cross-talk add to
a wrench w of n reactions in EI/L² and EI/L.  It is ``E w`` with a matrix E whose n² entries are independent and have the
standard deviation ε, the same in all rows, so that in each row each reaction has an independent error of ``ε |w|``.  Errors
that do not vanish with the wrench, as that of a curved rod, are those of a typical one: |w| counts as no less than its median.

Source of the factor that holds for all contacts at once: H. Scheffé, *The Analysis of Variance*, 1959.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from scan3d.arrays import NEGLIGIBLE, Array, Index, Mask
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
            f"{what}: position_m holds {number(largest)} m, where numbers are {length(step, 'm', digits=2)} apart, too coarse "
            f"for a rod of {length(length_m, 'm')}; check its unit, or take a frame near the body"
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


SHOWS = ("clamp-on-rod", "rod-on-clamp")
"""Which wrench a sensor shows; the first is that of a recording."""
GAINS = tuple(f"gain_{channel}" for channel in ("fx", "fy", "fz", "mx", "my", "mz"))
"""What is added to the channels of a sensor, as multiples of what they show less the zero."""
DEFAULT_ACCURACY = 0.005
"""Standard deviation of the gains of a sensor that states none: data sheets of force-torque sensors have 0.5 to 2 % of the
range as the largest error."""


def accuracy_of(stated: Any) -> Array:
    """(6,) standard deviations of the gains of a sensor, from one number for all channels or one for each.

    Raises InputError for what is neither.
    """
    try:
        values = np.asarray(stated, dtype=float)
        # a sensor that is wrong by a third measures nothing
        if values.shape in ((), (6,)) and ((values >= 0) & (values <= 0.3)).all():
            return np.array(np.broadcast_to(values, 6))
    except (ValueError, TypeError):
        pass
    raise InputError(
        "the sensor's accuracy must be a number from 0 to 0.3, such as 0.005 for gains that are known to 0.5 %, or one "
        f"each for fx, fy, fz, mx, my and mz; got {stated!r}"
    )


RIG_QUANTITIES = (
    "stiffness_relative",
    "length_relative",
    *(f"clamp_{axis}_m" for axis in "xyz"),
    *(f"clamp_turn_{axis}_rad" for axis in "xyz"),
    *(f"sensor_{axis}_m" for axis in "xyz"),
    *(f"sensor_turn_{axis}_rad" for axis in "xyz"),
    "tip_diameter_relative",
    *(f"curvature_{axis}_per_m" for axis in "zx"),
    "weight_N",
)
"""The quantities of a rig that change contacts, all in the clamp's frame; the gains of its sensor do so as well."""


@dataclass(frozen=True, eq=False)
class RigUncertainty:
    """The covariance of the quantities of a rig by which a recording was corrected.

    Raises InputError for unknown or repeated names, and for a matrix that is no covariance of them.
    """

    names: tuple[str, ...]
    """(k,) some of `RIG_QUANTITIES`; what is not named counts as exact."""
    covariance: Array
    """(k, k) in the squares and products of their units: m, rad, and 1 for the relative ones."""
    exact: tuple[str, ...] = ()
    """Quantities of the calibration that its touches did not determine; their nominal values are taken as exact."""
    gains: Array = field(default_factory=lambda: np.zeros((6, 6)))
    """(6, 6 + k) covariance of the gains of the sensor's channels with each other and the quantities; 0 for exact ones.  Or
    (36, 36 + k), of a matrix (6, 6) by rows that is added to the channels in N and N m, as multiples of all of them."""
    sensor: tuple[float, ...] = (0.0,) * 6
    """Place in m and Euler angles in degrees of the sensor's frame in the clamp's, to which the gains belong."""
    relative: float = 0.0
    """Relative error ε of the wrench.  It is estimated from a recording itself, and not part of its files."""

    def __post_init__(self) -> None:
        for name in ("names", "exact"):
            given = getattr(self, name)
            if isinstance(given, str) or not all(isinstance(word, str) for word in given):
                raise InputError(f"rig: {name} must be names of quantities, got {given!r}")
            object.__setattr__(self, name, tuple(given))
        wrong = [name for name in self.names if name not in RIG_QUANTITIES]
        if wrong or len(set(self.names)) < len(self.names):
            what = f"unknown quantities {', '.join(wrong)}" if wrong else "a quantity more than once"
            raise InputError(f"rig: {what}; known are {', '.join(RIG_QUANTITIES)}")
        sensor = _matrix("the sensor's frame", [self.sensor], (1, 6))
        object.__setattr__(self, "sensor", tuple(map(float, sensor[0])))
        own = _matrix("the covariance", self.covariance, (len(self.names),) * 2)
        gains = self.gains if np.any(self.gains) else np.zeros((6, 6 + len(own)))
        rows = 36 if len(gains) == 36 else 6
        gains = _matrix("the covariance of the gains", gains, (rows, rows + len(own)))
        matrix = _joint(own, gains)
        deviations = np.sqrt(np.maximum(np.diag(matrix), 0.0))
        scale = np.where(deviations > 0, deviations, 1.0)
        correlations = matrix / scale / scale[:, None]
        asymmetry = float(np.abs(correlations - correlations.T).max(initial=0.0))
        if asymmetry > NEGLIGIBLE or (len(matrix) and np.linalg.eigvalsh(correlations)[0] < -NEGLIGIBLE):
            raise InputError("rig: the covariance must be symmetric and without negative eigenvalues")
        object.__setattr__(self, "covariance", own)
        object.__setattr__(self, "gains", gains)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RigUncertainty) and self._plain() == other._plain()

    def __hash__(self) -> int:
        return hash(self._plain())

    def _plain(self) -> tuple[Any, ...]:
        return self.names, self.exact, self.covariance.tobytes(), self.gains.tobytes(), self.sensor, self.relative

    def on_wrench(self, length_m: float) -> Array:
        """(18 + g, 6, 6) what is added to wrenches in the clamp's frame, over a length, by an error of one unit of each of
        `RIG_QUANTITIES` and of the gain of each channel, or of each channel by each; to the first order."""
        found = np.zeros((len(RIG_QUANTITIES) + len(self.gains), 6, 6))
        crossed = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)
        found[8:11, 3:, :3] = crossed / length_m
        found[11:14, :3, :3] = found[11:14, 3:, 3:] = crossed
        own, units = (
            wrench_matrix(turn_of(self.sensor[3:]), np.array(self.sensor[:3]) / length_m),
            np.repeat([1.0, length_m], 3),
        )
        mixed = np.einsum("ik,lj->klij", own / units, np.linalg.inv(own) * units[:, None]).reshape(36, 6, 6)
        found[len(RIG_QUANTITIES) :] = mixed if len(self.gains) == 36 else mixed[::7]  # of each channel by itself
        return found

    def components(self) -> Array:
        """(18 + g, p) independent errors of one standard deviation each, of `RIG_QUANTITIES` and gains."""
        # exact gains are left out, so that they change no digit
        covariance = _joint(self.covariance, self.gains) if self.gains.any() else self.covariance
        scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        scale[scale == 0] = 1.0
        square, axes = np.linalg.eigh(covariance / scale / scale[:, None])
        count = len(RIG_QUANTITIES)
        found = np.zeros((count + len(self.gains), len(square)))
        rows = [*map(RIG_QUANTITIES.index, self.names), *range(count, len(found))][: len(square)]
        found[rows] = scale[:, None] * axes * np.sqrt(np.maximum(square, 0))
        return found[:, square > NEGLIGIBLE]


def _joint(covariance: Array, gains: Array) -> Array:
    """(k + g, k + g) of quantities and gains."""
    own, others = np.split(gains, [len(gains)], axis=1)
    return np.block([[covariance, others.T], [others, own]])


def _matrix(what: str, values: Any, shape: tuple[int, int]) -> Array:
    try:
        matrix = np.array(values, dtype=float)
    except (ValueError, TypeError):
        raise InputError(f"rig: {what} must be a matrix of numbers, got {values!r}") from None
    if not matrix.size and not shape[0]:
        return np.zeros(shape)
    if matrix.shape != shape or not np.isfinite(matrix).all():
        raise InputError(
            f"rig: {what} must be {shape[0]} by {shape[1]} finite numbers, of a covariance a row and a column for each "
            f"quantity, got the shape {matrix.shape}"
        )
    return matrix


@dataclass(frozen=True)
class RigErrors:
    """Covariances and standard deviations of contacts (n,) by the errors of a calibration, which are the same in all."""

    covariance: Array
    """(n, 3, 3) of the place, in the cloud's unit squared."""
    turn_sd: Array
    """(n,) of the rod's tangent, in radians; 0 in tip contact."""
    across_sd: Array
    """(n,) of the place across the rod, in the plane of its sweep; 0 in tip contact."""
    tilt_sd: Array
    """(n,) of the tangent's angle in that plane, in radians; 0 in tip contact."""
    height_sd: Array
    """(n,) of the height, over the plane of its sweep, of a tip contact, or of the line along a tangential one's tangent, where
    that is farthest off within the extents of all contacts."""
    count: int
    """Number p of independent errors."""
    relative: float = 0.0
    """Relative error of the wrench that is among them."""

    @cached_property
    def place_sd(self) -> Array:
        """(n,) of the place, in its least certain direction, in the cloud's unit."""
        return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(self.covariance)[:, -1], 0.0)))

    def select(self, rows: Mask | Index) -> RigErrors:
        """Those of some contacts."""
        names = [field.name for field in fields(self) if field.name not in ("count", "relative")]
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    @staticmethod
    def joined(parts: Sequence[RigErrors | None], counts: Sequence[int]) -> RigErrors:
        """Those of several groups of contacts, of so many each, by the same calibration; None where it does nothing to them."""
        known = next(part for part in parts if part is not None)
        columns: dict[str, Any] = {
            field.name: np.concatenate(
                [
                    np.zeros((count, *getattr(known, field.name).shape[1:]))
                    if part is None
                    else getattr(part, field.name)
                    for part, count in zip(parts, counts, strict=True)
                ]
            )
            for field in fields(known)
            if field.name not in ("count", "relative")
        }
        return replace(known, **columns)

    def factor(self, alpha: float) -> float:
        """The number of standard deviations that all contacts stay within at once, but for the probability `alpha`.

        To the first order each error of a contact is a linear function of the same p standard normal numbers, and all such
        functions together stay within the root of their sum of squares (Scheffé).
        """
        return float(np.sqrt(chdtri(self.count, alpha))) if self.count else 0.0


def with_relative(rig: RigUncertainty | None, relative: float) -> RigUncertainty:
    """What is known of a rig, if it is calibrated, with a relative error of the wrench."""
    return replace(rig or RigUncertainty((), np.zeros((0, 0))), relative=relative)


def one_rig(rigs: Sequence[RigUncertainty | None]) -> RigUncertainty | None:
    """What recordings that are joined have in common.

    Raises InputError for different ones: their errors would not be the same in all rows.
    """
    if any(rig != rigs[-1] for rig in rigs):
        raise InputError(
            "the recording was corrected by another calibration than those before, or only one of them was; "
            "recordings are joined with one calibration: import all tables with the same RIG.toml"
        )
    return rigs[-1]
