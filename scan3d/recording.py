"""Recordings, which separate the two steps: logs of poses and wrenches, as a robot with a force-torque sensor writes them.

A recording has one row per sample, in SI units.  The pose is that of the clamp in the world: its y axis is along the undeformed
rod, its x axis along the line of the sweep (the base moves in -x), and its z axis is the normal of the slice.  The wrench is
the support reaction (8) in the clamp's frame.  Rows without contact are part of the recording, because a sweep without contact
is evidence that nothing is there.

The resolution of recorded numbers is estimated from the numbers themselves: digits of a log, single precision, steps of a
converter.  Rounding to steps of size q has the standard deviation q/√12.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import planar
from planar.channels import Frames, follow_pushes
from scan3d import units
from scan3d.arrays import LARGEST, Array, Index, Mask, evenly
from scan3d.errors import InputError
from scan3d.rigs import RigUncertainty, axes_of, check_columns, check_orientations, check_positions, one_rig
from scan3d.rods import Gravity, Rod
from scan3d.shown import Rows, Shown
from scan3d.spatial.march import free_reactions
from scan3d.units import UNITS_M

# Numbers, at least, that show a grid or their digits.
_FEWEST = 20
# That numbers which lie on no grid are taken for such.
_CHANCE = 1e-9
# Digits of the poses count as rounding if their standard deviation is at most this many rod lengths, or radians.  Coarser poses
# are taken for those of a plan, which are round but exact.
_FINE = 1e-4
FORCE_SIGMAS = 8.0
"""A row counts as touching if its force exceeds this many standard deviations of the noise: of the many rows without contact
nearly none does."""
LARGEST_OVER_SD = 3.0
"""The largest error by rounding of three coordinates, over the standard deviation of one."""
SIX_AXES = ("force_z_N", "moment_x_Nm", "moment_y_Nm")
"""The columns of a recording that six-axis data have beside those of the plane."""


def _plain(name: str, values: Any) -> NDArray[Any]:
    if np.ma.isMaskedArray(values):
        raise InputError(
            f"recording: {name} is a masked array, whose masked values would count as measured; leave those rows out "
            "and give plain arrays"
        )
    try:
        array = np.asarray(values)
    except ValueError:  # rows of different lengths
        raise InputError(f"recording: {name} must be an array of numbers, but its rows differ in length") from None
    whole = array.dtype.kind in "iu" or (array.dtype.kind == "f" and bool((np.round(array) == array).all()))
    if array.dtype.kind not in "iuf" or (name == "sweep" and not whole):
        expected = "whole numbers" if name == "sweep" else "real numbers"
        raise InputError(
            f"recording: {name} must be an array of {expected}, got {array.dtype.name} "
            f"{' '.join(str(values).split()):.40}"
        )
    return array


class Noise(NamedTuple):
    """Errors of a recording: those that it states, and those of its digits."""

    force_N: float
    """Standard deviation of each force component, by the stated noise and by rounding."""
    moment_Nm: float
    """Standard deviation of the moment, likewise."""
    pose_m: float
    """Standard deviation of each coordinate of the clamp's position, as it is stated."""
    place_m: float
    """Largest error of a contact's place by the digits of the poses."""
    independent: bool
    """Whether the errors of successive rows are independent.  Rounding alone gives successive rows the same errors where force
    and moment change by less than a step; noise of some size makes the errors of rounding independent as well."""

    def of_reactions(self, rod: Rod) -> tuple[float, float]:
        """Standard deviations of each component of force and moment, in EI/L² and EI/L."""
        return self.force_N / rod.force_unit_N, self.moment_Nm / rod.moment_unit_Nm


@dataclass(frozen=True, repr=False)
class Recording(Shown):
    """A log of poses and wrenches with n samples.

    Raises InputError for columns of different lengths, numbers that aren't finite, quaternions without unit length, an unknown
    unit or an impossible noise.
    """

    sweep: NDArray[np.int64]
    """(n,) number of the sweep; the clamp moves on one straight line in each."""
    position_m: Array
    """(n, 3) position of the clamp in the world."""
    quaternion: Array
    """(n, 4) orientation of the clamp, w first, of unit length."""
    force_N: Array
    """(n, 2) support reaction along the clamp's x and y axes."""
    moment_Nm: Array
    """(n,) clamping moment about its z axis."""
    rod: Rod
    force_z_N: Array | None = None
    """(n,) support reaction along the clamp's z axis; None where it was not measured."""
    moment_x_Nm: Array | None = None
    """(n,) clamping moment about its x axis, likewise."""
    moment_y_Nm: Array | None = None
    """(n,) clamping moment about its y axis, which is that of the undeformed rod, likewise."""
    noise_force_N: float = 0.0
    """Standard deviation of each force component; 0 if there is no noise, or if it is not known."""
    noise_moment_Nm: float = 0.0
    """Standard deviation of the moment, likewise."""
    noise_pose_m: float = 0.0
    """Standard deviation of each coordinate of the clamp's position, independent from row to row, likewise."""
    noise_independent: bool = True
    """Whether the noise of force and moment is independent from row to row.  That of values which a filter smoothed is not, nor
    is that of a converter whose steps are coarser than the noise."""
    unit: str = "mm"
    """Unit in which clouds and surfaces made from this recording are written."""
    table_m: float | None = None
    """Height z of the table on which the body stands: nothing of the body lies below.  None if no table is known."""
    gravity: Gravity | None = None
    """Needed with a rod that has a weight."""
    source: Mapping[str, Any] = field(default_factory=dict)
    """Where the data came from, for the report."""
    completed: Known | None = None
    """What is known in the place of a reaction that was not measured, and of which it is; None if all were."""
    rig: RigUncertainty | None = None
    """What is not known exactly of the calibrated rig that corrected poses, wrenches and rod; None if that is not known, or if
    there is nothing of the kind."""

    def __post_init__(self) -> None:
        columns = ["sweep", "position_m", "quaternion", "force_N", "moment_Nm"]
        further = [name for name in SIX_AXES if getattr(self, name) is not None]
        if len(further) not in (0, len(SIX_AXES)):
            missing = ", ".join(name for name in SIX_AXES if name not in further)
            raise InputError(f"recording: six-axis data need {', '.join(SIX_AXES)}; missing: {missing}")
        columns += further
        for name in columns:
            object.__setattr__(self, name, _plain(name, getattr(self, name)))
        if not isinstance(self.rod, Rod):
            raise InputError(f"recording: rod must be a scan3d.Rod, got {type(self.rod).__name__}")
        n = self.sweep.size
        shapes = dict(sweep=(n,), position_m=(n, 3), quaternion=(n, 4), force_N=(n, 2), moment_Nm=(n,))
        shapes |= dict.fromkeys(further, (n,))
        if n == 0:
            raise InputError("the recording has no samples: expected at least one row")
        check_columns("recording", vars(self), shapes)
        check_orientations("recording", self.quaternion)
        check_positions("recording", self.position_m, self.rod.length_m)
        if not isinstance(self.unit, str) or self.unit not in UNITS_M:
            raise InputError(f"recording: unit must be one of {', '.join(UNITS_M)}, got {self.unit!r}")
        noises = (self.noise_force_N, self.noise_moment_Nm, self.noise_pose_m)
        if not all(units.is_finite(noise) and noise >= 0 for noise in noises):
            raise InputError("recording: standard deviations of the noise must be numbers >= 0")
        for name in columns[3:]:
            if (largest := float(np.abs(getattr(self, name)).max())) > LARGEST:
                raise InputError(f"recording: {name} holds {largest:.3g}; check its unit, which is that of SI")
        if max(noises) > LARGEST:
            raise InputError(
                f"recording: a standard deviation of the noise is {max(noises):.3g}; check its unit, N, N m or m"
            )
        if self.table_m is not None and not units.is_finite(self.table_m):
            raise InputError(f"recording: the height of the table must be a number or None, got {self.table_m!r}")
        if self.rod.weight_N and self.gravity is None:
            raise InputError(
                "recording: a rod with weight_N needs [gravity], with direction in the world and whether the log is "
                "tared"
            )
        if self.completed is not None and (
            self.rig is not None or self.rod.weight_N or (self.six_axis and self.completed.channel not in FOLLOWED)
        ):
            raise InputError(
                "recording: a channel is completed in a plane, of a rod without weight, and not by a calibrated rig; "
                "measure all of fx, fy and mz"
            )

    def __len__(self) -> int:
        return len(self.sweep)

    @property
    def six_axis(self) -> bool:
        """Whether all three components of force and moment were measured, as the spatial model needs them."""
        return self.force_z_N is not None

    @property
    def stated_hollow(self) -> bool:
        """Whether it is stated that the body is not convex."""
        return self.source.get("convex") is False

    @cached_property
    def in_probings(self) -> Mask:
        """(n,) rows of probings: sweeps in which the clamp moves more along its own y axis than across it."""
        order = np.argsort(self.sweep, kind="stable")
        first = np.flatnonzero(np.diff(self.sweep[order], prepend=self.sweep[order[0]] - 1))
        last = np.append(first[1:], len(order)) - 1
        moved = self.position_m[order[last]] - self.position_m[order[first]]
        moved = np.einsum("nij,nj->ni", axes_of(self.quaternion[order[first]]), moved)
        # a clamp that stays where it is does neither
        along = moved[:, 1] > np.hypot(moved[:, 0], moved[:, 2])
        found = np.empty(len(order), dtype=bool)
        found[order] = np.repeat(along, last - first + 1)
        return found

    def wrench(self) -> tuple[Array, Array]:
        """(n, 3) support reaction and (n, 3) clamping moment in the clamp's frame.  Raises InputError unless all are known."""
        if self.force_z_N is None or self.moment_x_Nm is None or self.moment_y_Nm is None:
            raise InputError(f"the spatial model needs six-axis data; the recording has no {', '.join(SIX_AXES)}")
        force = np.column_stack([self.force_N, self.force_z_N])
        return force, np.column_stack([self.moment_x_Nm, self.moment_y_Nm, self.moment_Nm])

    @cached_property
    def noise(self) -> Noise:
        """The errors that the recording states, and those of its digits."""
        forces, moments = [*self.force_N.T], [self.moment_Nm]
        if self.six_axis:
            forces, moments = (list(columns.T) for columns in self.wrench())
        force, moment = (max(rounding_sd(column, measured=True) for column in columns) for columns in (forces, moments))
        length = self.rod.length_m
        position, turn = rounding_sd(self.position_m.ravel()), 2 * rounding_sd(self.quaternion.ravel())
        size = float(np.linalg.norm(np.ptp(self.position_m, axis=0))) + length
        place = position * (position <= _FINE * length) + turn * size * (turn <= _FINE)
        return Noise(
            together(self.noise_force_N, force),
            together(self.noise_moment_Nm, moment),
            self.noise_pose_m,
            place * LARGEST_OVER_SD,
            # errors of rounding are independent if the noise that is rounded is at least half a step: their mean over the
            # noise is then below 0.3 % of a step (Widrow and Kollár, Quantization Noise, 2008)
            self.noise_force_N >= 3**0.5 * force
            and self.noise_moment_Nm >= 3**0.5 * moment
            # a wrong coefficient of friction is the same in all rows, and forces by moments follow one another
            and not (self.completed is not None and (self.completed.friction_sd or self.completed.channel in FOLLOWED)),
        )

    @property
    def untested(self) -> str:
        """Why nothing is certified of it although nothing contradicts the model; "" if there is no such reason."""
        if self.completed is None or self.completed.channel not in FOLLOWED:
            return ""
        return (
            "the forces follow from the moments on a surface that turns evenly from row to row, without corners, which nothing "
            "tests; measure the force for a certificate"
        )

    def reactions(self, six_axis: bool) -> tuple[Array, Array]:
        """(n, 3) support reaction and (n, 3) clamping moment, in EI/L² and EI/L; zero in channels that are not asked for.

        What a tared sensor leaves out of the weight of the rod is added.
        Raises InputError if six axes are asked for and not known.
        """
        if six_axis:
            force, moment = self.wrench()
        else:
            zero = np.zeros(len(self))
            force = np.column_stack([self.force_N, zero])
            moment = np.column_stack([zero, zero, self.moment_Nm])
        force, moment = force / self.rod.force_unit_N, moment / self.rod.moment_unit_Nm
        down = self.down()
        if down is not None and self.gravity is not None and self.gravity.tared:
            in_air = free_reactions(self.rod.in_space(), down.T)
            force, moment = force + in_air[0].T, moment + in_air[1].T
        return force, moment

    def pressing(self, six_axis: bool) -> Array:
        """(n, 3) what the contact adds to the support reaction, ``-F`` in EI/L²; as `reactions`."""
        down, force = self.down(), self.wrench()[0] if six_axis else np.pad(self.force_N, ((0, 0), (0, 1)))
        force = force / self.rod.force_unit_N
        if down is None or self.gravity is None or self.gravity.tared:
            return force
        weight = self.rod.profile.weight
        added = force + weight * down
        return np.asarray(np.where(np.abs(added) > 1e-12 * weight, added, 0.0))

    def in_plane(self) -> planar.Rod:
        """The rod of the planar model, with gravity in each row.  Raises InputError if it leaves the planes of the sweeps."""
        return self.rod.in_plane(self.down(), self.noise.place_m / self.rod.length_m)

    def down(self) -> Array | None:
        """(n, 3) unit vectors of gravity in the clamp's frame; None for rods without weight."""
        if not self.rod.weight_N or self.gravity is None:
            return None
        return np.asarray(self.axes() @ np.array(self.gravity.direction))

    def axes(self) -> Array:
        """(n, 3, 3) the clamp's x, y and z axes in the world, as rows."""
        return axes_of(self.quaternion)

    def summary(self) -> Rows:
        """Counts, rod, noise, and where the samples were taken, with the largest reactions."""
        if not len(self):  # of `Live`, before its first row
            return [("samples", "none")]
        rod, unit = self.rod, self.unit
        force, moment = np.linalg.norm(self.force_N, axis=1), np.abs(self.moment_Nm)
        if self.six_axis:
            force, moment = (np.linalg.norm(reaction, axis=1) for reaction in self.wrench())
        return [
            ("samples", f"{len(self)}, {(force > 0).sum()} with a force"),
            ("sweeps", str(len(np.unique(self.sweep)))),
            ("z axes of the clamp" if self.six_axis else "normals of the slices", _directions(self.axes()[:, 2])),
            ("rod", _words(rod)),
            ("largest reactions", f"{units.force(force.max())}, {units.moment(moment.max())}"),
            ("noise", self._stated()),
            ("clamp from", units.point(self.position_m.min(axis=0) / UNITS_M[unit], unit)),
            ("to", units.point(self.position_m.max(axis=0) / UNITS_M[unit], unit)),
        ]

    def _stated(self) -> str:
        if not (self.noise_force_N or self.noise_moment_Nm or self.noise_pose_m):
            return "none"
        pose = f", {units.length(self.noise_pose_m, 'm', digits=2)} of the pose" if self.noise_pose_m else ""
        reactions = f"{units.force(self.noise_force_N, digits=2)}, {units.moment(self.noise_moment_Nm, digits=2)}"
        return f"{reactions}{pose} (standard deviations)"


def _words(rod: Rod) -> str:
    kinds = {
        "at the clamp, and other along the rod": rod.varies,
        "curved": any(rod.curvatures),
        "heavy": rod.weight_N,
        "in a clamp that gives": rod.clamp_compliance_rad_per_Nm,
    }
    size = f"{units.length(rod.length_m, 'm', digits=4)} long, EI = {rod.bending_stiffness_Nm2:.4g} N m²"
    return ", ".join([size, *(words for words, has in kinds.items() if has)])


def _directions(normals: Array) -> str:
    distinct = np.unique(np.round(normals, 3) + 0.0, axis=0)
    most = 4  # scans along the three axes have three
    rest = f" and {len(distinct) - most} more" if len(distinct) > most else ""
    return ", ".join("({:g}, {:g}, {:g})".format(*normal) for normal in distinct[:most]) + rest


def rounding_sd(values: Array, measured: bool = False) -> float:
    """Standard deviation of the rounding of numbers (n,), by the step at the largest of them; 0 for full precision.

    measured
        that they are a sensor's, of which few show its steps.  Few numbers that somebody chose may all be multiples of 5.
    """
    nonzero = values[values != 0]
    if len(nonzero) < 2:
        return 0.0
    largest = float(np.abs(nonzero).max())
    with np.errstate(over="ignore", under="ignore"):
        single = bool((values.astype(np.float32) == values).all())
    binary = float(np.spacing(np.float32(largest))) if single else 0.0
    step = max(_decimal_step(nonzero, largest, single), binary, _grid_step(values, 2 if measured else _FEWEST))
    # numbers of full precision are multiples of their last place
    return step / float(np.sqrt(12)) if step > largest * 10.0**-15 else 0.0


def _decimal_step(values: Array, largest: float, single: bool) -> float:
    """The place value of the last significant digit at the largest numbers; 0 for full precision, or if few numbers show it.

    `single` says that the numbers were kept in single precision, which has 7 to 9 digits.  Digits are counted for each power of
    ten that has so many numbers that not all of them end with zeros by chance.  Numbers with fixed decimals have the fewer
    digits the smaller they are.
    """
    some = np.abs(evenly(values, 2000))
    kept, full = (np.float32, 8) if single else (float, 15)
    power = np.floor(np.log10(some))
    exponents, counts = np.unique(power, return_counts=True)
    found: dict[float, int] = {}
    for exponent in exponents[counts >= _FEWEST].tolist():
        digits = 1
        for value in np.unique(some[power == exponent]).tolist():
            while digits < full and kept(f"{value:.{digits - 1}e}") != value:
                digits += 1
            if digits == full:
                return 0.0
        found[exponent] = digits
    if not found:
        return 0.0
    # as many digits everywhere are significant ones, also of the few largest numbers; one power alone does not tell
    significant = len(found) > 1 and len(set(found.values())) == 1
    steps = [exponent + 1 - digits for exponent, digits in found.items()]
    if significant:
        steps.append(np.floor(np.log10(largest)) + 1 - max(found.values()))
    return float(10.0 ** max(steps))


def _grid_step(values: Array, fewest: int) -> float:
    """The step of the grid on which all numbers lie; 0 if they do not lie on one, or are fewer than `fewest` different ones."""
    distinct = np.unique(values)
    if len(distinct) < fewest:
        return 0.0
    gaps, largest = np.diff(distinct), float(np.abs(distinct).max())
    # what is symmetric repeats its numbers with the other sign
    independent = 1 + int((np.diff(np.unique(np.abs(distinct))) > 1e-12 * largest).sum())
    distances = np.sort(np.abs(distinct - distinct[gaps.argmin()]))[1:]
    smallest = np.sort(gaps)[:3].tolist()
    # the smallest gap, or the common divisor of two, may be a few steps; of numbers with few digits, or all
    divisors = [smallest[0]]
    divisors += [
        _divisor(*pair, rounding * largest) for rounding in (1e-9, 1e-11, 1e-13) for pair in combinations(smallest, 2)
    ]
    candidates = [divisor / part for divisor in divisors for part in range(1, 13)]
    for candidate in candidates:
        if candidate <= 1e-13 * largest:
            continue
        step, fitted = _refined(distances, candidate)
        multiples = distances / step
        off = float(np.abs(multiples - np.round(multiples)).max())
        # which allows for few digits; numbers on no grid come as near to one by chance
        chance = len(candidates) * (2 * off) ** max(independent - 1 - fitted, 0)
        if off <= 0.02 and chance < _CHANCE:
            return step
    return 0.0


def _divisor(one: float, other: float, rounding: float) -> float:
    """The largest number of which both are multiples, by Euclid's algorithm; 0 if it is not far above their rounding."""
    while other > rounding:
        one, other = other, abs(one - other * round(one / other))
    return one if one > 20 * rounding else 0.0


def _refined(distances: Array, step: float) -> tuple[float, int]:
    """The step of which all distances (n,), increasing, are multiples if there is one, from its first estimate; and by how many
    of them it was found."""
    k, fitted = 0, 1
    # no distance is many times the one before: digits that are missing do not make the number of steps in it uncertain
    while k < len(distances) - 1:
        k = max(k + 1, int(np.searchsorted(distances, 8 * distances[k], side="right")) - 1)
        step, fitted = float(distances[k] / max(np.round(distances[k] / step), 1.0)), fitted + 1
    return step, fitted


def together(stated: float, rounding: float) -> float:
    """Standard deviation of the sum of noise and rounding."""
    return stated if rounding <= 0.03 * stated else float(np.hypot(stated, rounding))


def as_stated(recording: Recording, noise: Noise) -> Recording:
    """The recording with these errors, in the place of those that its digits show."""
    found = replace(recording)
    found.__dict__["noise"] = noise  # of a property that is computed once
    return found


def of_checked(like: Recording, **columns: Any) -> Recording:
    """A recording with other rows, which are right, and all else of another one, without looking at them again."""
    found = object.__new__(Recording)
    found.__dict__.update(like.__dict__ | columns)
    found.__dict__.pop("in_probings", None)
    return found


def reaction_columns(force: Array, moment: Array, six_axis: bool) -> dict[str, Any]:
    """The columns of a recording that hold reactions (n, 3) in N and N m; without six axes those in the plane, mz last."""
    columns = {"force_N": force[:, :2], "moment_Nm": moment[:, -1]}
    return columns | (dict(zip(SIX_AXES, [force[:, 2], *moment[:, :2].T], strict=True)) if six_axis else {})


def of_rows(recording: Recording, rows: Mask | Index) -> Recording:
    """The recording of some of the rows, by (n,) booleans or by numbers."""
    names = ("sweep", "position_m", "quaternion", "force_N", "moment_Nm", *(SIX_AXES if recording.six_axis else ()))
    columns: dict[str, Any] = {name: getattr(recording, name)[rows] for name in names}
    return replace(recording, **columns)


def completed(recording: Recording) -> tuple[Recording, Mask]:
    """The recording with the channel that was not measured, from what is known in its place, and which rows (n,) it has.

    Rows in which the other channels leave several contacts open are left out: they are not evidence of air.  Raises InputError
    for channels that do not tell, and if no row is left.
    """
    known, rod = recording.completed, recording.rod
    assert known is not None
    if known.channel in FOLLOWED:
        return _with_forces(recording, known.channel == ACROSS)
    force, moment = recording.reactions(six_axis=False)
    reactions = {"f0x": force[:, 0], "f0y": force[:, 1], "m0z": moment[:, 2]}
    least = FORCE_SIGMAS * max(recording.noise.of_reactions(rod))
    pressed = (np.linalg.norm(force, axis=1) > least) | (np.abs(moment[:, 2]) > least)
    found = known.complete(reactions, np.flatnonzero(pressed), -1, rod.in_plane())
    kept = np.isfinite(found)
    if pressed.any() and not (kept & pressed).any():
        raise InputError(
            f"in all of the {int(pressed.sum())} rows with a force the two reactions that were measured leave no "
            f"contact, or several, with {known.words}; measure a third one"
        )
    forces, found = recording.force_N.copy(), np.nan_to_num(found)
    if known.channel == "m0z":
        recording = replace(recording, moment_Nm=found * rod.moment_unit_Nm)
    else:
        forces[:, list(reactions).index(known.channel)] = found * rod.force_unit_N
        recording = replace(recording, force_N=forces)
    return of_rows(recording, kept), kept


def followed(recording: Recording) -> tuple[Array, Array, Array]:
    """The forces and moments (n, 3) of a recording of moments in EI/L² and EI/L, and their covariances, as `Known.follow`."""
    known, rod = recording.completed, recording.rod
    assert known is not None
    nothing = np.zeros(len(recording))
    columns = [recording.moment_x_Nm, nothing, recording.moment_Nm]
    moment = np.column_stack([nothing if column is None else column for column in columns]) / rod.moment_unit_Nm
    noise = recording.noise.moment_Nm / rod.moment_unit_Nm
    pressed = np.linalg.norm(moment, axis=1) > FORCE_SIGMAS * noise
    place, axes = recording.position_m / rod.length_m, recording.axes()
    axial = recording.force_N[:, 1] / rod.force_unit_N if known.channel == ACROSS else None
    along = (axial, recording.noise.force_N / rod.force_unit_N)
    return known.follow(
        pressed, recording.sweep, place, axes, moment, noise, rod.in_plane(), along, in_space=recording.six_axis
    )


def _with_forces(recording: Recording, are_corrected: bool) -> tuple[Recording, Mask]:
    """`completed` of a recording of moments, alone or with the force along the rod, by which they are corrected."""
    (force, moment, _), rod, noise = followed(recording), recording.rod, recording.noise
    kept = np.isfinite(force[:, 0])
    if not force[kept].any() and not kept.all():
        raise InputError(
            "no sweep can be followed by its moments: each has to begin with a small push of the side of the rod, not "
            "of its tip, against the body; measure the force as well"
        )
    columns = reaction_columns(rod.force_unit_N * np.nan_to_num(force), rod.moment_unit_Nm * moment, recording.six_axis)
    kinds = ("force", "moment_N", "moment_x") if are_corrected else ("force",)
    columns = {name: column for name, column in columns.items() if name.startswith(kinds)}
    if are_corrected:  # and do not show the digits that they had
        columns |= {"noise_force_N": noise.force_N, "noise_moment_Nm": noise.moment_Nm}
    return of_rows(replace(recording, **columns), kept), kept


def joined(recordings: Sequence[Recording]) -> Recording:
    """Several recordings as one, their sweeps numbered one after the other; six-axis if all of them are.

    Raises InputError for recordings with different rods, units, tables or calibrations.
    """
    last = recordings[-1]
    if len(recordings) == 1:
        return last
    alike = {"rod": "rod", "gravity": "gravity", "unit": "unit", "table_m": "table", "completed": "channel completed"}
    for name, what in alike.items():
        if any(getattr(recording, name) != getattr(last, name) for recording in recordings):
            raise InputError(
                f"the recording has another {what} than those before; recordings are joined with one {what}"
            )
    numbers: list[NDArray[np.int64]] = []
    first = 0
    for recording in recordings:
        distinct, rank = np.unique(recording.sweep, return_inverse=True)
        # a recording that goes on from the ones before keeps its numbers
        numbers.append(recording.sweep if distinct[0] >= first else first + rank.reshape(-1))
        first = int(numbers[-1].max()) + 1
    columns, noises = (
        ["position_m", "quaternion", "force_N", "moment_Nm"],
        ("noise_force_N", "noise_moment_Nm", "noise_pose_m"),
    )
    values: dict[str, Any] = {name: max(getattr(recording, name) for recording in recordings) for name in noises}
    if all(recording.six_axis for recording in recordings):
        columns += SIX_AXES
    else:
        values |= dict.fromkeys(SIX_AXES)
    values["noise_independent"] = all(recording.noise_independent for recording in recordings)
    values |= {name: np.concatenate([getattr(recording, name) for recording in recordings]) for name in columns}
    if any(recording.stated_hollow for recording in recordings):
        values["source"] = {**last.source, "convex": False}
    rig = one_rig([recording.rig for recording in recordings])
    found = replace(last, sweep=np.concatenate(numbers), **values, rig=rig)
    parts = [recording.noise for recording in recordings]
    # among more digits those of one part are not seen, and its rows would count as exact
    largest = {
        "noise_force_N": max(part.force_N for part in parts),
        "noise_moment_Nm": max(part.moment_Nm for part in parts),
    }
    counted = found.noise.force_N, found.noise.moment_Nm
    hidden: dict[str, Any] = {
        name: sd for (name, sd), seen in zip(largest.items(), counted, strict=True) if seen < 0.99 * sd
    }
    if not hidden:
        return found
    return replace(
        found, **hidden, noise_independent=all(part.independent for part in parts) and found.noise_independent
    )


# --- what is known in the place of a reaction that was not measured ---

REACTIONS = {"f0x": "fx_N", "f0y": "fy_N", "m0z": "mz_Nm"}
"""The reactions, and their columns in the table of a recording."""
CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")
"""The six reactions."""
IN_PLANE = np.array([0, 1, 5])
"""Those in the plane, of the six."""
FORCE, ACROSS = "force", "across"
"""What is completed along sweeps where moments alone were measured, and where the force along the rod was as well."""
FOLLOWED = (FORCE, ACROSS)


@dataclass(frozen=True)
class Known:
    """What is known of the contacts in the place of a reaction.  Raises InputError for what stands for none."""

    friction: float | None = None
    """The coefficient of friction, of contacts that are tangential or at the tip; None: all contacts are at the tip."""
    friction_sd: float = 0.0
    channel: str = ""
    """The reaction that was completed, one of `REACTIONS` or `FOLLOWED`; "" as long as it is open which one."""

    def __post_init__(self) -> None:
        channels = (*REACTIONS, *FOLLOWED)
        if self.channel not in ("", *channels):
            raise InputError(f"the completed channel must be one of {', '.join(channels)}, got {self.channel!r}")
        if self.channel in FOLLOWED and self.friction is None:
            raise InputError("moments alone locate tangential contacts with a known friction only; state it in [known]")

    @property
    def errors(self) -> dict[str, Any]:
        """What `planar.errors` must know of the completed reaction."""
        return {"missing": self.channel, "known_sd": self._angle_sd}

    @property
    def _angle_sd(self) -> float:
        return self.friction_sd / (1 + (self.friction or 0.0) ** 2)

    @property
    def words(self) -> str:
        """What is assumed, for messages."""
        if self.friction is None:
            return f"that all contacts are at the tip, which stands for {self.channel}"
        return f"a coefficient of friction of {self.friction:g} ± {self.friction_sd:g}, which stands for {self.channel}"

    def complete(self, reactions: dict[str, Array], rows: Index, direction: int, rod: planar.Rod) -> Array:
        """The reaction (n,) of the completed channel: zero but in some rows, NaN where the others leave several contacts open.

        Raises InputError for channels that do not tell.
        """
        f0x, f0y, m0z = (None if name == self.channel else reactions[name][rows] for name in REACTIONS)
        told: dict[str, Any] = {"tip": True} if self.friction is None else {"friction": self.friction}
        try:
            done = planar.complete(np.zeros(len(rows)), f0x, f0y, m0z, **told, direction=direction, rod=rod)
        except ValueError as error:
            raise InputError(str(error)) from None
        found = np.zeros(len(reactions[self.channel]))
        found[rows] = getattr(done.reactions, self.channel)
        return found

    def follow(
        self,
        touching: Mask,
        sweep: Index,
        place: Array,
        axes: Array,
        moment: Array,
        noise: float,
        rod: planar.Rod,
        along: tuple[Array | None, float] = (None, 0.0),
        *,
        in_space: bool = False,
    ) -> tuple[Array, Array, Array]:
        """The forces (n, 3) by the moments (n, 3), dimensionless in clamps with places (n, 3) and axes (n, 3, 3), the moments,
        and the covariances (n, 6, 6) of force and moment: zero in rows that do not touch, forces NaN in those that are left
        open, among them those whose error is as large as the force.

        `along` are the axial forces (n,) and their noise, if they were measured; they correct the moments as well.

        The moment about the rod is not read.  Each stretch of a sweep that touches begins with a small push against the rod.
        """
        force, covariance = np.zeros((len(sweep), 3)), np.zeros((len(sweep), 6, 6))
        if not touching.any():
            return force, moment, covariance
        order = np.argsort(sweep, kind="stable")
        on, same = touching[order], np.append(False, np.diff(sweep[order]) == 0)
        stretch, rows = np.cumsum(on & ~(np.append(False, on[:-1]) & same))[on], order[on]
        size = np.hypot(moment[rows, 0], moment[rows, 2])
        x, z, nought = moment[rows, 0] / size, moment[rows, 2] / size, np.zeros(len(rows))
        # the plane in which the rod bends is that across its moment
        across, about = np.stack([z, nought, -x], axis=1), np.stack([x, nought, z], axis=1)
        rod_axis = np.broadcast_to([0.0, 1.0, 0.0], across.shape)
        to_world = axes[rows]
        plane, normal = np.stack([across, rod_axis], axis=1) @ to_world, np.einsum("ni,nij->nj", -about, to_world)
        frames = Frames(stretch, place[rows], plane, normal)
        try:
            told: dict[str, Any] = {
                "friction": self.friction or 0.0,
                "friction_angle_sd": self._angle_sd,
                "in_space": in_space,
            }
            told |= {} if along[0] is None else {"axial": along[0][rows], "axial_sd": along[1]}
            found = follow_pushes(frames, size, rod=rod, noise=noise, **told)
        except ValueError as error:
            raise InputError(str(error)) from None
        if along[0] is not None:
            cosine, sine = np.cos(found.turn)[:, None], np.sin(found.turn)[:, None]
            across, about, size = across * cosine - about * sine, about * cosine + across * sine, found.moment
            moment = moment.copy()
            moment[rows[:, None], [0, 2]] = (size[:, None] * about)[:, [0, 2]]
        fx, fy = found.force.T[:, :, None]
        force[rows] = fx * across + fy * rod_axis
        turned = np.concatenate([-np.nan_to_num(fx) * about, size[:, None] * across], axis=1)
        columns = [
            np.pad(across, ((0, 0), (0, 3))),
            np.pad(rod_axis, ((0, 0), (0, 3))),
            np.pad(about, ((0, 0), (3, 0))),
        ]
        rates = np.stack([*columns, turned], axis=2)
        covariance[rows] = rates @ found.covariance @ rates.transpose(0, 2, 1)
        force[np.trace(covariance[:, :3, :3], axis1=1, axis2=2) > (force**2).sum(axis=1)] = np.nan
        return force, moment, covariance
