"""The likeliest fault of a recording that contradicts the model.

A fault maps the wrench that the sensor should show to the one that it shows.  What undoes it is an affine map as well: a matrix
for signs, units, gains, exchanged axes and frames, and a zero that is taken off; both may differ from row to row.  A rod of
another length scales the dimensionless force by its square and the moment by itself, and is a matrix too.  Beside the wrench
the rod may be another one than stated, tapered, curved, heavy, or in a clamp that gives, and the poses may be those of another
time.  `causes` is the table of them all.

A cause has at most six numbers, estimated by least squares of the misfits (`reconstruction.errors`) that the recording has
without it.  The fault that leaves least is named, if it leaves little; those that leave as little are named beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import planar
from planar.rods import STEPS
from scan3d.arrays import Array, Index, Mask, evenly
from scan3d.geometry.sections import slice_frame
from scan3d.reconstruction.errors import (
    DISTURBED,
    Errors,
    Misfit,
    against_single_force,
    beyond_tangents,
    contact_tolerance,
    depths_in_hull,
    felt,
    tip_sigmas,
    too_light,
)
from scan3d.reconstruction.slices import slices_of
from scan3d.recording import CHANNELS, Recording
from scan3d.rigs import euler_of, wrench_matrix
from scan3d.rods import Gravity, Rod
from scan3d.spatial import inverse
from scan3d.spatial.march import free_reactions
from scan3d.units import angle, force, length, moment, number, share

_ABOUT = ("about the clamp's x axis", "about the rod (the clamp's y axis)", "about the clamp's z axis")
# Signs, units and axes: what undoes the fault multiplies the channels by these factors.
_FACTORS: dict[str, tuple[tuple[float, ...], str]] = {
    "wrench-sign": ((-1, -1, -1, -1, -1, -1), "the wrench has the opposite sign (that of the rod on the clamp)"),
    "force-sign": ((-1, -1, -1, 1, 1, 1), "the forces have the opposite signs"),
    "fx-sign": ((-1, 1, 1, 1, 1, 1), "fx has the opposite sign"),
    "fy-sign": ((1, -1, 1, 1, 1, 1), "fy has the opposite sign"),
    "fz-sign": ((1, 1, -1, 1, 1, 1), "fz has the opposite sign"),
    "mx-sign": ((1, 1, 1, -1, 1, 1), "mx has the opposite sign"),
    "mz-sign": ((1, 1, 1, 1, 1, -1), "mz has the opposite sign"),
    "fx-mz-sign": ((-1, 1, 1, 1, 1, -1), "fx and mz have the opposite signs"),
    "left-handed": ((1, 1, -1, -1, -1, 1), "the z axis is reversed, as in a left-handed frame"),
    "force-unit": ((1e-3, 1e-3, 1e-3, 1, 1, 1), "the forces are in mN, not in N"),
    "wrench-unit": ((1e-3,) * 6, "the forces are in mN, not in N, and the {moments} in mN m, not in N m"),
    "moment-unit": ((1, 1, 1, 1e-3, 1e-3, 1e-3), "the {moments} in N mm, not in N m"),
}
# Gains: the channels that are recorded at one unknown part of their size; the moment about the rod vanishes.
_CHECK = "recorded at {0} times %s size: check the sensor's gains"
_GAINS: dict[str, tuple[tuple[int, ...], str]] = {
    "stiffness": (
        (0, 1, 2, 3, 4, 5),
        "the rod is {0} times as stiff as stated, or force and moment are recorded at {0} times their size (both have the same "
        "effect): calibrate the stiffness",
    ),
    "moment-scale": ((3, 4, 5), f"the moments are {_CHECK % 'their'}"),
    "force-scale": ((0, 1, 2), f"the forces are {_CHECK % 'their'}"),
    **{f"{CHANNELS[k]}-scale": ((k,), f"{CHANNELS[k]} is {_CHECK % 'its'}") for k in (0, 1, 2, 3, 5)},
}
# Largest logarithm of a scale: larger ones make rods so long or forces so large that noise and rounding hide any misfit.
_LARGEST_SCALE = 1.4
# First estimates of turns, in radians.
_ANGLES = np.radians(np.concatenate([sign * np.geomspace(2.0, 165.0, 12) for sign in (-1, 1)]))
# Of rods: logarithms of weight in EI/L² and of compliance in radians per EI/L, over a tenth.
_TENTH, _SMALL, _LEAST_WEIGHT = 0.1, np.log([[0.1], [1.0]]), 1e-4
_LARGEST_LOG = 9.0


class Diagnosis(NamedTuple):
    """The likeliest fault of a recording that contradicts the model."""

    fault: str
    """Its code, ``unknown`` where none of the faults that are tried explains the contradiction alone."""
    value: float | None
    """Its estimated size in `unit`; None where it has none."""
    unit: str
    message: str
    """What it is and what to do, as the end of a sentence."""
    explains: float = 0.0
    """Part of the root mean square misfit that the correction of the fault removes."""
    alike: tuple[str, ...] = ()
    """Codes of the faults that ``several`` stands for."""
    interval: tuple[float, float] | None = None
    """Smallest and largest size that explains the recording as well under its noise; None without noise or size."""


class Undone(NamedTuple):
    """What undoes a fault: the wrench is ``matrix (w - zero)``, the rod is `length` times as long as stated.

    Or the rod is another one; or the wrench is that of poses that lay by `late`, in rod lengths, along the clamp's x axis.
    """

    matrix: Array = np.eye(6)
    """(6, 6), or (n, 6, 6) for every row of the recording."""
    zero: Array = np.zeros(6)
    """(6,), or (n, 6)."""
    length: float = 1.0
    rod: Rod | None = None
    late: float = 0.0
    air: Array | None = None
    """(n, 6) the wrenches of the rod in the air, in which it touches nothing; None where they vanish."""

    def of(self, wrench: Array, rows: Index) -> Array:
        """(k, 6) the wrenches of some rows without the fault, of those (n, 6) that are recorded."""
        matrix = self.matrix[rows] if self.matrix.ndim == 3 else self.matrix
        zero = self.zero[rows] if self.zero.ndim == 2 else self.zero
        return np.einsum("...ij,...j->...i", matrix, wrench[rows] - zero)

    def gains(self) -> tuple[float, float]:
        """By how much the noise of force and moment grows at most; their coupling adds less than the noise of either."""
        parts = slice(0, 3), slice(3, 6)
        force, moment = (np.linalg.norm(self.matrix[..., part, part], 2, axis=(-2, -1)).max() for part in parts)
        return float(force), float(moment)


class Cause(NamedTuple):
    """A fault whose numbers (k,) are to be estimated."""

    starts: Array
    """(s, k) first estimates; k is 0 for a fault without numbers."""
    undone: Callable[[Array], Undone]
    named: Callable[[Array], Diagnosis]
    """The fault with its estimated size; what it explains is not known yet."""
    cost: int
    """How many numbers it takes from the data."""
    limit: float = np.inf
    """Largest magnitude of a number."""
    family: str = ""
    """Whether it is one of the sensor's frame, "sensor", which contain each other, or of the "rod"."""


def causes(recording: Recording, model: str, wrench: Array, felt: Array, stuck: Index) -> list[Cause]:
    """All faults that are tried.

    wrench, felt, stuck
        (n, 6) of the recording, dimensionless; (k, 6) those with a force; and rows in which the log was stuck.
    """
    spatial, rod, axes, none = model == "spatial", recording.rod, np.eye(3), np.empty((0, 3))
    channels, moments = ([*range(6)], "moments are") if spatial else ([0, 1, 5], "moment is")
    found = [
        known(Undone(np.diag(np.array(factors, dtype=float))), code, text.format(moments=moments))
        for code, (factors, text) in _FACTORS.items()
        if any(factors[k] != 1 for k in channels)
    ]
    found.append(known(Undone(np.eye(6)[[1, 0, 2, 3, 4, 5]]), "fx-fy-exchanged", "fx and fy are exchanged"))
    turned = np.zeros((len(wrench), 6, 6))
    turned[:, :3, :3] = turned[:, 3:, 3:] = recording.axes()
    text = 'force and moment have their components in the frame of the poses: state wrench_in = "world" in the map'
    found.append(known(Undone(turned), "wrench-in-world", text))
    hanging = hanging_weight(recording, wrench)
    found += _zeros(recording, spatial, wrench, hanging)
    found.append(_late(recording))
    found += _rods(recording, spatial, wrench, hanging) if rod.is_simple else []
    factors = np.log(np.geomspace(0.3, 1 / 0.3, 13))[::-1, None]  # of 1 as well, near which small ones are found
    for code, (scaled, text) in _GAINS.items():
        if spatial or len(scaled) > 1 or scaled[0] in (0, 1):  # in a plane mz is the only moment
            undone = partial(_of_gain, np.isin(np.arange(6), scaled))
            found.append(_sized(code, "times", text, factors, undone))
    text = "the rod is {0} times as long as stated: measure its free length"
    powers = np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    # contacts near the tip count as tip contacts, so that the misfit over the length is one of steps
    lengths = np.log(np.linspace(0.7, 1.4, 47))[:, None]
    found.append(_sized("length", "times", text, lengths, lambda long: Undone(np.diag(long**powers), length=long)))
    if len(stuck):
        found.append(stuck_rows(stuck, wrench))
    # in rod lengths
    places = np.concatenate([sign * distance * axes for distance in np.geomspace(0.03, 0.5, 4) for sign in (-1, 1)])
    if not spatial:
        in_plane = places[places[:, 2] == 0][:, :2]
        return [*found, _sensor(axes[2:], none, _ANGLES[:, None], rod), _sensor(none, axes[:2], in_plane, rod)]
    found += [_sensor(axes[[k]], none, _ANGLES[:, None], rod) for k in range(3)]
    turns = np.kron(np.radians([[2.0], [15.0]]), 2 * np.array(list(np.ndindex(2, 2, 2))) - 1)
    found += [_sensor(axes, none, turns, rod), _sensor(none, axes, places, rod)]
    return [*found, _sensor(axes, axes, _frame_starts(felt), rod)]


def _of_gain(scaled: Mask, size: float) -> Undone:
    """Channels (6,) that are marked are recorded too large by a factor."""
    return Undone(np.diag(np.where(scaled, 1 / size, 1.0)))


def known(undone: Undone, code: str, text: str, value: float | None = None, unit: str = "", cost: int = 0) -> Cause:
    """A fault that has no numbers to be estimated."""
    return Cause(np.empty((1, 0)), lambda _: undone, lambda _: Diagnosis(code, value, unit, text), cost)


def _sized(
    code: str,
    unit: str,
    text: str,
    starts: Array,
    undone: Callable[[float], Undone],
    scale: float = 1.0,
    told: Callable[[float], str] = "{:.4g}".format,
    limit: float = _LARGEST_SCALE,
    family: str = "",
) -> Cause:
    """A fault of one positive size, of which the number is the logarithm over a scale."""

    def size(numbers: Array) -> float:
        return scale * float(np.exp(min(numbers[0], 2.0)))

    def named(numbers: Array) -> Diagnosis:
        return Diagnosis(code, size(numbers), unit, text.format(told(size(numbers))))

    return Cause(starts, lambda numbers: undone(size(numbers)), named, 1, limit, family)


def stuck_rows(stuck: Index, wrench: Array) -> Cause:
    """Rows that repeat others; the fault is undone by leaving them out."""
    zero = np.zeros_like(wrench)
    zero[stuck] = wrench[stuck]
    text = (
        f"sensor or log was stuck: in {len(stuck)} rows force and moment repeat those of the row before though the clamp "
        "moves; leave these rows out"
    )
    return known(Undone(zero=zero), "stick", text, float(len(stuck)), "rows")


def hanging_weight(recording: Recording, wrench: Array) -> Array | None:
    """(3,) the weight that the sensor shows at the starts of the sweeps, a vector in the world that turns in the clamp's frame;
    None if it shows none."""
    first = np.unique(recording.sweep, return_index=True)[1]
    shown = wrench[first, :3]
    world = -np.einsum("ni,nij->nj", shown, recording.axes()[first])
    middles = np.median([shown, world], axis=1)  # some sweeps begin at the body
    in_clamp, in_world = np.median(np.linalg.norm([shown, world] - middles[:, None], axis=2), axis=1)
    felt = np.linalg.norm(middles[1]) > max(2 * recording.noise.of_reactions(recording.rod)[0], _LEAST_WEIGHT)
    return middles[1] if felt and in_world < in_clamp / 4 else None


def _zeros(recording: Recording, spatial: bool, wrench: Array, hanging: Array | None) -> list[Cause]:
    """What the sensor shows at the starts of the sweeps, before the rod touches, and that it is not zero."""
    rod, (_, first, sweep) = recording.rod, np.unique(recording.sweep, return_index=True, return_inverse=True)
    start = wrench[first]
    zero, ends = np.median(start, axis=0), np.percentile(start, [2.5, 97.5], axis=0)
    linear = np.polynomial.polynomial.polyfit(first, start, min(len(first) - 1, 1))
    steady = np.vander(np.arange(len(wrench)), len(linear), increasing=True) @ linear
    untared = (
        "force and moment were not tared: at the starts of the sweeps the sensor shows {}; let the import take off what it "
        "shows in the air ([tare])"
    )
    drifts = (
        "the zero of force and moment drifts from sweep to sweep, in all by {}, or a weight turns with the clamp: let each "
        "sweep begin in the air, and let the import take off the drift ([tare])"
    )
    found = [_zero("not-tared", zero, zero, rod, spatial, untared), *_jumping(recording, wrench, first, spatial)]
    for values in (steady, start[sweep.reshape(-1)]):
        cause = _zero("drift", values, ends[1] - ends[0], rod, spatial, drifts, 2)
        if hanging is not None:
            size = float(np.linalg.norm(hanging)) * rod.force_unit_N
            text = (
                f"a weight of {force(size)} hangs at the sensor and turns with the clamp: let each sweep begin in the air, "
                "and let the import take it off ([tare])"
            )
            cause = known(Undone(zero=values), "weight", text, size, "N", 2)
        found.append(cause)
    return found


def _jumping(recording: Recording, wrench: Array, first: Index, spatial: bool) -> list[Cause]:
    """A zero that jumps in some row, as where the sensor is tared again; none if it does not, by the starts of the sweeps."""
    begins = np.sort(first)
    if len(begins) < 4:
        return []
    noise = np.repeat(recording.noise.of_reactions(recording.rod), 3)
    noise = np.maximum(noise, 1e-4 * np.repeat([np.abs(part).max() for part in np.hsplit(wrench, 2)], 3))
    start = np.array([np.median(wrench[k : k + 5], axis=0) for k in begins])
    # single sweeps that begin in contact do not count
    level = median_filter(start, (3, 1), mode="nearest")
    apart = (np.abs(np.diff(level, axis=0)) / np.where(noise > 0, noise, 1.0)).max(axis=1)
    after = np.flatnonzero(apart > _SURELY)
    if not 0 < len(after) <= max(1, len(begins) // 4):
        return []
    rows = []
    for k in after:
        inside = wrench[begins[k] : begins[k + 1] + 3]  # as many rows of the next sweep turn its median
        step = np.abs(np.diff(inside, axis=0) - (level[k + 1] - level[k])).max(axis=1)
        rows.append(int(begins[k] + 1 + step.argmin()))
    edges = [0, *(after + 1).tolist(), len(begins)]
    levels = np.array([np.median(start[a:b], axis=0) for a, b in pairwise(edges)])
    zero = levels[np.searchsorted(rows, np.arange(len(wrench)), side="right")]
    steps, sweeps = np.diff(levels, axis=0), [str(recording.sweep[begins[k]]) for k in after]
    text = (
        f"the zero of force and moment jumps in or right after sweep {', '.join(sweeps)}, by up to {{}}: the sensor was "
        "tared again; import the table, which takes off the zero of each part, or cut the log there"
    )
    largest = steps[np.abs(steps).max(axis=1).argmax()]
    return [_zero("zero-jumps", zero, largest, recording.rod, spatial, text)]


def _zero(code: str, zero: Array, size: Array, rod: Rod, spatial: bool, text: str, cost: int = 0) -> Cause:
    """A zero (6,) or (n, 6) that is off, with the size (6,) that the text tells."""
    newton, newton_metres = size[:3] * rod.force_unit_N, size[3:] * rod.moment_unit_Nm
    shown = (newton, newton_metres) if spatial else (newton[:2], newton_metres[2:])
    by_moment = np.linalg.norm(size[3:]) > np.linalg.norm(size[:3])
    value, unit = (newton_metres, "N m") if by_moment else (newton, "N")
    text = text.format(f"{force(*shown[0], digits=2)} and {moment(*shown[1], digits=2)}")
    return known(Undone(zero=zero), code, text, float(np.linalg.norm(value)), unit, cost)


def _late(recording: Recording) -> Cause:
    """A wrench that is logged later than its pose, by a way (1,) in rod lengths along the sweep."""

    def named(numbers: Array) -> Diagnosis:
        way = float(numbers[0]) * recording.rod.length_m
        speed = recording.source.get("speed_m_per_s")
        by = f"{length(abs(way), 'm')} of the sweeps' way" + (f", {abs(way) / speed:.3g} s" if speed else "")
        text = (
            f"wrench {'later' if way > 0 else 'earlier'} than pose by {by}: state wrench_delay_s; or the clamp is off "
            f"by position_mm = [{1000 * way:.3g}, 0, 0] under [clamp], which only sweeps at another speed tell from it"
        )
        value, unit = (way / speed, "s") if speed else (1000 * way, "mm")
        return Diagnosis("delay", value, unit, text)

    starts = np.array([[-0.003], [-0.03], [0.003], [0.03]])
    return Cause(starts, lambda n: Undone(late=float(n[0])), named, 1)


def _rods(recording: Recording, spatial: bool, wrench: Array, hanging: Array | None) -> list[Cause]:
    """Rods that are not straight, uniform and weightless in a rigid clamp, as the stated one is."""
    rod, count = recording.rod, 2 if spatial else 1
    thick = rod if rod.diameter_m else replace(rod, diameter_m=rod.length_m / 100)  # any diameter at the clamp will do
    assert recording.gravity is not None
    gravity = np.array(recording.gravity.direction)
    down = recording.axes() @ gravity
    directions, which = np.unique(down.round(9), axis=0, return_inverse=True)

    def curvature(n: Array) -> Array:
        return np.pad(n, (0, 3 - count)) / rod.length_m

    def of_curvature(n: Array) -> Diagnosis:
        value = curvature(n)
        text = f"curvature_per_m = {_list(value) if spatial else f'{value[0]:.3g}'}"
        text = f"the free rod is curved: hold it against a straight edge, and state {text}"
        return Diagnosis("curvature", float(np.linalg.norm(value) if spatial else value[0]), "1/m", text)

    def curved(n: Array) -> Undone:
        about_z, about_x, twist = curvature(n).tolist()
        return Undone(rod=replace(rod, curvature_per_m=(about_z, about_x, twist) if spatial else about_z))

    def heavy(weight: float, tared: bool) -> Undone:
        found = replace(rod, weight_N=weight)
        free = np.concatenate(free_reactions(found.in_space(), directions.T)).T[which.reshape(-1)]
        return Undone(zero=-free * tared, rod=found, air=free)

    def weight(tared: bool) -> str:
        return (
            "its weight of {} bends the rod: weigh it, and state weight_N, and [gravity] with direction = "
            f"{_list(gravity.round(3))} and tared = {str(tared).lower()}"
        )

    def tapered(part: float) -> Undone:
        return Undone(rod=replace(thick, tip_diameter_m=part * thick.diameter_m))

    def yielding(compliance: float) -> Undone:
        return Undone(rod=replace(rod, clamp_compliance_rad_per_Nm=compliance))

    taper = "the rod tapers to {} of its diameter: measure it at the tip, and state tip_diameter_m"
    gives = "the clamp gives by {} rad per N m: load it by a known moment, and state clamp_compliance_rad_per_Nm"
    arcs = np.kron(np.eye(count), np.array([[-0.02], [-0.3], [0.02], [0.3]]))  # curvatures in 1/L
    sized = partial(_sized, family="rod")
    in_air = float(np.median(np.linalg.norm(wrench[np.unique(recording.sweep, return_index=True)[1], :3], axis=1)))
    found = [
        sized("taper", "times", taper, np.log([[0.5], [0.7], [0.95]]), tapered),
        Cause(arcs, curved, of_curvature, count, _LARGEST_SCALE, "rod"),
        sized(
            "clamp-compliance",
            "rad/(N m)",
            gives,
            _SMALL[:1],
            yielding,
            _TENTH / rod.moment_unit_Nm,
            limit=_LARGEST_LOG,
        ),
    ]
    if hanging is not None:
        size = float(np.linalg.norm(hanging)) * rod.force_unit_N
        return [*found, known(heavy(size, False), "weight", weight(False).format(force(size)), size, "N", 1)]
    if not spatial and np.abs(down[:, :2]).max() <= np.abs(down[:, 2]).max():  # it hardly bends the rod in its slices
        return found
    # what a sensor shows in the air that was not tared is the weight
    shown = in_air > max(2 * recording.noise.of_reactions(rod)[0], _LEAST_WEIGHT)
    for tared in (True, False) if shown else (True,):
        starts, undone = _SMALL if tared else np.vstack([_SMALL, np.log(in_air / _TENTH)]), partial(heavy, tared=tared)
        unit = _TENTH * rod.force_unit_N
        found.append(sized("weight", "N", weight(tared), starts, undone, unit, force, _LARGEST_LOG))
    return found


def _sensor(turns: Array, places: Array, starts: Array, rod: Rod) -> Cause:
    """A sensor in another frame than the clamp's: turned about axes (k, 3), and beside the clamp along axes (l, 3).

    The numbers are those of a rotation vector, and of a place in rod lengths.
    """

    def split(numbers: Array) -> tuple[Array, Array]:
        return numbers[: len(turns)] @ turns, numbers[len(turns) :] @ places

    def undone(numbers: Array) -> Undone:
        turn, place = split(numbers)
        return Undone(wrench_matrix(Rotation.from_rotvec(turn).as_matrix(), place))

    return Cause(starts, undone, lambda numbers: _frame(*split(numbers), rod), starts.shape[1], family="sensor")


def _frame_starts(felt: Array) -> Array:
    """First estimates (s, 6) of turns and places of a sensor in which no moment is about the rod.

    With the turn R and the place p in the clamp's frame, the sensor shows F' and m' of the reactions ``F = R F'`` and
    ``m = R m' + p × F``.  The moment about the undeformed rod vanishes, ``<e, m> = 0`` with e = (0, 1, 0), and hence
    ``<a, m'> + <c, F'> = 0`` for all rows, with ``a = Rᵀ e`` and ``c = Rᵀ (e × p)``: the right singular vector of the rows
    (m', F') with the smallest singular value.  The turn about the rod and the offset along it remain open, and are tried.
    """
    _, _, right = np.linalg.svd(felt[:, [3, 4, 5, 0, 1, 2]], full_matrices=False)
    if not len(felt):
        return np.zeros((1, 6))
    axis, arm = right[-1, :3], right[-1, 3:]
    size = float(np.linalg.norm(axis))
    if size == 0:
        return np.zeros((1, 6))
    starts = []
    along_rod = np.array([0.0, 1.0, 0.0])
    for sign in (1.0, -1.0):
        to_rod = Rotation.align_vectors(along_rod[None], sign * axis[None] / size)[0]
        for turned in np.radians(np.arange(-180, 180, 30)):
            turn = Rotation.from_rotvec(turned * along_rod) * to_rod
            across = np.cross(turn.apply(sign * arm / size), along_rod)
            starts += [[*turn.as_rotvec(), *(across + along * along_rod)] for along in np.linspace(-0.5, 0.5, 5)]
    return np.array(starts)


def _frame(vector: Array, place: Array, rod: Rod) -> Diagnosis:
    """A sensor that is turned by a rotation vector (3,), at a place (3,) in rod lengths."""
    millimetres = 1000 * rod.length_m * place
    distance = float(np.linalg.norm(millimetres))
    position = f"position_mm = {_list(millimetres)}"
    if not vector.any():
        return Diagnosis(
            "moment-not-moved",
            distance,
            "mm",
            f"the moment was not moved to the clamp: it refers to a point {length(distance, 'mm')} from it; state "
            f"{position} under [sensor], or calibrate",
        )
    axis = int(np.argmax(np.abs(vector)))
    # smaller parts of a turn are not named
    single = bool(np.delete(np.abs(vector), axis).max() <= 0.15 * np.abs(vector[axis])) and not place.any()
    degrees = float(np.degrees(vector[axis] if single else np.linalg.norm(vector)))
    euler = np.degrees(vector) if single else euler_of(Rotation.from_rotvec(vector).as_matrix())
    turned = f"the sensor is turned by {angle(degrees)}"
    state = f"state euler_deg = {_list(euler)}"
    if place.any():
        text = f"{turned}, and its moments refer to a point {length(distance, 'mm')} from the clamp: {state} and {position}"
        text = (
            f"{text} under [sensor] for a first look, and calibrate: noise hides some degrees of a turn about the rod"
        )
        return Diagnosis("turned-and-moved", degrees, "deg", text)
    where = _ABOUT[axis] if single else "about an axis across several of the clamp's"
    text = f"{turned} {where}: {state} under [sensor], or calibrate"
    return Diagnosis(f"turned-{'xyz'[axis]}" if single else "turned", degrees, "deg", text)


def _list(values: Array) -> str:
    return "[" + ", ".join(f"{value + 0.0:.3g}" for value in values) + "]"


# And if after its correction hardly any rows contradict by more than so many standard deviations, of many pairs of rows, and
# this part of the misfit, for its estimated numbers.
_SURELY, _OF_NUMBERS = 6.0, 0.01
# Faults whose mean square misfits differ by less than this factor cannot be told apart; each number must lower it by the root.
_ALIKE = 4.0
# Mean square misfit that counts as none.
_NO_MISFIT = 1e-12
# The misfit of a row without a contact, and the largest one that counts, so that single rows do not decide.
_LARGEST = 0.1
# Distance to the tip, in rod lengths, within which a contact counts as one of the tip, which has no tangent, so that the misfit
# does not jump where an estimate deviates by less than its error.
_TIP = 0.02
# Standard deviations that do not count as misfit.
_SIGMAS = 3.0
# Forces below this part of the largest one are rounding of a tare.
_NO_FORCE = 1e-5
# Evaluations of a refinement, fewer in a first search and of rods, which are slow and nearly linear.
_EVALUATIONS, _FEW = 12, 4
# Step of the derivatives by numbers.
_STEP = 1e-3
_UNKNOWN = Diagnosis(
    "unknown",
    None,
    "",
    "none of the faults that are tried explains the contradiction alone: check signs, axes and units, the tare of force and "
    "moment, that the rod is straight, uniform and light and its clamp rigid, and that the body is convex",
)


def diagnose(recording: Recording, model: str) -> Diagnosis:
    """The likeliest fault of a recording that contradicts the model 'planar' or 'spatial'."""
    if recording.completed is not None:
        text = f"it rests on {recording.completed.words}: check that, the rod, and signs, units and tare of what was measured"
        return _UNKNOWN._replace(message=text)
    wrench = np.hstack(recording.reactions(six_axis=model == "spatial"))
    if recording.gravity is None:
        hanging = hanging_weight(recording, wrench)
        down = (0.0, 0.0, -1.0) if hanging is None else tuple(hanging)
        recording = replace(recording, gravity=Gravity(down, tared=False))
    noise = recording.noise.of_reactions(recording.rod)
    stuck = _stuck_rows(recording, wrench, noise)
    sample, few = (_sample(recording, model, wrench, noise, stuck, parts) for parts in (1, 2))
    few = replace(few, rough=True)
    if not len(sample.rows):
        return _UNKNOWN
    recorded = sample.left(Undone())
    before = _mean_square(recorded.excess)
    if before <= _NO_MISFIT or (
        recorded.level <= before and _Trial(known(Undone(), "unknown", ""), np.empty(0), recorded).fits(before)
    ):
        return _UNKNOWN
    stuck = _contradicting(stuck, wrench, sample)
    tried = causes(recording, model, wrench, wrench[_felt(wrench[:, :3], noise)], stuck)
    if not np.ptp(recording.sweep):  # one sweep hardly contradicts itself, and many numbers would do
        tried = [cause for cause in tried if not cause.starts.shape[1]]
    fitting: list[_Trial] = []
    for of_rod in (False, True):  # no rod is tried where a fault leaves nothing
        if all(trial.misfit + trial.left.level > _OF_NUMBERS**2 * before for trial in fitting):
            group = [cause for cause in tried if (cause.family == "rod") == of_rod]
            evaluations = _FEW if of_rod else _EVALUATIONS
            trials = [_refined(*start, sample, evaluations) for start in _searched(group, few)]
            hopeful = [trial for trial in trials if trial.explains(before) >= 0.8]
            # along a flat valley the evaluations may end before the least misfit
            again = [t if t.fits(before) else _refined(t.cause, t.numbers, sample, evaluations) for t in hopeful]
            fitting += [trial for trial in again if trial.fits(before)]
    if all(trial.left.level > before for trial in fitting):  # errors that hide any misfit explain none
        about_rod, along_force, *_ = recorded.excess if model == "spatial" else np.zeros((2, 1))
        # makers of sensors state a cross-talk of 1 %: so small a moment along the force proves no second contact
        second = _mean_square(along_force) > _mean_square(about_rod) and np.median(along_force) > 0.01
        return _second_contact(along_force) if second else _UNKNOWN
    # misfits that begin at a bound fall to zero slowly, the fewer rows have one, and few evaluations end before they do
    fitting = [_settled(trial, sample) if max(noise) else _refined(*trial[:2], sample) for trial in fitting]
    first = min(fitting, key=lambda trial: trial.score)
    alike = {first.named.fault: first.named.message}
    for trial in fitting:
        other, best = trial.cause, first.cause
        contains = other.cost > best.cost and (best.cost == 0 or (other.family == best.family == "sensor"))
        if trial.misfit + first.left.level < _ALIKE * (first.misfit + first.left.level) and not contains:
            alike.setdefault(trial.named.fault, trial.named.message)
    explains = first.explains(before)
    if len(alike) == 1:
        found = first.named._replace(explains=explains, message=f"most likely {first.named.message}")
        if not max(noise) or not len(first.numbers) or found.value is None:
            return found
        low, high = _interval(first, sample)
        text = f"{found.message}; sizes from {number(low)} to {number(high)} {found.unit} explain it alike"
        return found._replace(message=text, interval=(low, high))
    text = (
        f"{len(alike)} faults explain it alike, and what each asks for tells them apart: {'; or '.join(alike.values())}"
    )
    return Diagnosis("several", None, "", text, explains, tuple(alike))


def _second_contact(along_force: Array) -> Diagnosis:
    """A second contact, where the moment along the force is most of the misfit and no fault of the rig explains it."""
    percent = 100 * float((along_force > 0).mean())
    return Diagnosis(
        "second-contact",
        percent,
        "%",
        f"most likely either a second contact, or channels that mix, were exchanged or were logged at different times: force "
        f"and moment of {share(percent / 100)} of the rows are not those of a single force; look for what else the rod touches",
    )


def _felt(force: Array, noise: tuple[float, float]) -> Mask:
    """(n,) whether forces (n, 3) stand out from the noise and from rounding."""
    size = np.linalg.norm(force, axis=1)
    return np.asarray(felt(force, noise) & (size > _NO_FORCE * size.max(initial=0.0)))


def _stuck_rows(recording: Recording, wrench: Array, noise: tuple[float, float]) -> Index:
    """Rows whose reactions under a force repeat those of the row before while the clamp moves, two or more in succession."""
    same = np.zeros(len(recording), dtype=bool)
    moves = (recording.position_m[1:] != recording.position_m[:-1]).any(axis=1)
    same[1:] = (wrench[1:] == wrench[:-1]).all(axis=1) & moves & _felt(wrench[:, :3], noise)[1:]
    run = same.copy()
    run[1:-1] = same[1:-1] & (same[:-2] | same[2:])
    return np.flatnonzero(run)


def _contradicting(stuck: Index, wrench: Array, sample: _Sample) -> Index:
    """Those of the rows that repeat others whose runs contradict the rest: along a flat face right reactions repeat as well."""
    runs = np.split(stuck, np.flatnonzero(np.diff(stuck) > 1) + 1)
    if not len(stuck) or len(runs) > 60:
        return stuck

    def without(some: Index) -> float:
        return _mean_square(sample.left(stuck_rows(some, wrench).undone(np.empty(0))).excess)

    least = _ALIKE * without(stuck) + _NO_MISFIT
    wrong = [run for run in runs if without(np.setdiff1d(stuck, run)) > least]
    return np.concatenate(wrong) if wrong else stuck


class _Left(NamedTuple):
    """What rows (k,) miss the model by, in r kinds (r, k)."""

    found: Array
    explained: Array
    """By `_SIGMAS` standard deviations."""
    excess: Array
    """Beyond what errors explain."""

    @property
    def level(self) -> float:
        """Mean square of one standard deviation."""
        return _mean_square(self.explained / _SIGMAS)


class _Trial(NamedTuple):
    cause: Cause
    numbers: Array
    left: _Left
    """After its correction."""

    @property
    def misfit(self) -> float:
        return _mean_square(self.left.excess)

    def explains(self, before: float) -> float:
        """Part of a root mean square misfit that the correction removes."""
        return float(1 - np.sqrt(self.misfit / before))

    def fits(self, before: float) -> bool:
        """Whether nearly no row contradicts by more than its errors, and those of the numbers, explain."""
        if self.left.level > _ALIKE * before:
            return False
        allowed = (_SURELY / _SIGMAS - 1) * self.left.explained + _OF_NUMBERS * np.sqrt(before)
        worst = self.left.excess.max(axis=0)
        least = worst[worst <= np.quantile(worst, 1 - DISTURBED)]
        if _mean_square(least) > self.left.level + (_OF_NUMBERS**2) * before:
            return False
        return float((self.left.excess > allowed).any(axis=0).mean()) <= DISTURBED

    @property
    def score(self) -> float:
        """Mean square misfit with what its numbers cost, as a logarithm."""
        return float(np.log(self.misfit + _NO_MISFIT) + self.cause.cost * np.log(_ALIKE) / 2)

    @property
    def named(self) -> Diagnosis:
        return self.cause.named(self.numbers)


def _mean_square(residuals: Array) -> float:
    return float(np.mean(residuals**2))


def _searched(tried: list[Cause], few: _Sample) -> list[tuple[Cause, Array]]:
    """The faults with numbers that few rows make hopeful, as these estimate them, and all faults without numbers."""
    plain = [(cause, cause.starts[0]) for cause in tried if not cause.starts.shape[1]]
    # what halves the root mean square misfit is refined
    rough, least = [], 0.25 * _mean_square(few.left(Undone()).excess)
    for cause in (cause for cause in tried if cause.starts.shape[1]):
        trials = [_Trial(cause, start, few.left(cause.undone(start))) for start in cause.starts]
        # the misfits of starts between which the right one lies differ little, those of estimates a lot
        best = sorted(trials, key=lambda trial: trial.misfit)[: 1 if cause.family == "rod" else 2]
        rough.append(min((_refined(cause, t.numbers, few, _FEW) for t in best), key=lambda trial: trial.misfit))
    return plain + [(trial.cause, trial.numbers) for trial in rough if trial.misfit <= least]


def _refined(cause: Cause, numbers: Array, sample: _Sample, evaluations: int = _EVALUATIONS) -> _Trial:
    """The trial with the numbers, near those given, by which the rows of a sample have the least misfit."""
    if len(numbers):
        near = sample.near(cause.undone(numbers))

        def residuals(numbers: Array) -> Array:
            return near.left(cause.undone(numbers)).excess.ravel() / _LARGEST

        bounds = (-cause.limit, cause.limit)
        numbers = least_squares(residuals, numbers, bounds=bounds, diff_step=1e-5, max_nfev=evaluations).x
    return _Trial(cause, numbers, sample.left(cause.undone(numbers)))


def _settled(trial: _Trial, sample: _Sample) -> _Trial:
    """The trial with numbers in the middle of those that noise allows: by all misfits, over their standard deviations."""
    cause = trial.cause
    if not len(trial.numbers):
        return trial
    numbers = _least(_deviations(trial, sample), trial.numbers, cause.limit, _EVALUATIONS)
    settled = trial._replace(numbers=numbers, left=sample.left(cause.undone(numbers)))
    return settled if settled.misfit <= trial.misfit + trial.left.level else trial


def _least(deviations: Callable[[Array], Array], numbers: Array, limit: float, evaluations: int) -> Array:
    """The numbers (k,) near some by which the sum of squares of deviations is least."""
    one = np.ones(len(numbers))  # relative steps about 1 are absolute ones, which no kink of the hull hides
    found = least_squares(
        lambda x: deviations(numbers + x - one),
        one,
        bounds=(one - limit - numbers, one + limit - numbers),
        diff_step=_STEP,
        max_nfev=evaluations,
    )
    return np.asarray(numbers + found.x - one)


def _deviations(trial: _Trial, sample: _Sample) -> Callable[[Array], Array]:
    """What is left with other numbers, over the standard deviations that it has with those of the trial."""
    sd = np.maximum(trial.left.explained / _SIGMAS, _NO_FORCE * _LARGEST)
    near = sample.near(trial.cause.undone(trial.numbers))
    return lambda n: np.asarray(np.minimum(near.left(trial.cause.undone(n)).found / sd, _SURELY).ravel())


def _interval(trial: _Trial, sample: _Sample) -> tuple[float, float]:
    """The smallest and the largest size of a fault that explains it alike, with its other numbers fitted to each."""
    cause, numbers, named = trial.cause, trial.numbers, trial.named
    assert named.value is not None
    deviations, sizes = _deviations(trial, sample), [named.value]
    limit = _ALIKE * max(_mean_square(deviations(numbers)), 1.0)
    each = _STEP * np.eye(len(numbers))
    rise = np.array([(cause.named(numbers + e).value or 0.0) - (cause.named(numbers - e).value or 0.0) for e in each])
    axis, *others = np.linalg.svd(rise[None])[2]
    across = np.array(others).reshape(-1, len(numbers))
    for sign in (1.0, -1.0):
        way, step, best = 0.0, _STEP, np.zeros(len(across))
        for _ in range(10):  # ever farther, and back by halves

            def along(rest: Array, at: float = sign * (way + step)) -> Array:
                return deviations(numbers + at * axis + rest @ across)

            rest = _least(along, best, cause.limit, _FEW) if len(across) else best
            tried = numbers + sign * (way + step) * axis + rest @ across
            alike = np.abs(tried).max() <= cause.limit and _mean_square(along(rest)) <= limit
            way, step, best = (way + step, 4 * step, rest) if alike else (way, step / 4, best)
            size = cause.named(numbers + sign * way * axis + best @ across)
            if alike and size.value is not None and size.unit == named.unit:
                sizes.append(size.value)
    return min(sizes), max(sizes)


def _sample(
    recording: Recording, model: str, wrench: Array, noise: tuple[float, float], kept: Index, parts: int
) -> _Sample:
    """Evenly chosen rows in contact, and those that are `kept`; a fraction 1 / parts of the usual number."""
    assert recording.gravity is not None
    axes, pressed = recording.axes(), _felt(recording.pressing(model == "spatial"), noise)

    def chosen(rows: Index, count: int, kept: Index) -> Index:
        count = -(-count // parts)
        return np.union1d(evenly(rows, count), np.intersect1d(rows, kept[:count]))

    frames: list[Array] = []
    if model == "spatial":
        # a first search takes half of them
        of_slice = [chosen(np.flatnonzero(pressed), 250, kept)]
    else:
        number, normals, _ = slices_of(recording, axes[:, 2])
        numbers = chosen(np.unique(number[pressed]), 5, np.unique(number[kept]))
        of_slice = [chosen(np.flatnonzero(pressed & (number == k)), 120, kept) for k in numbers]
        frames = [slice_frame(normals[k])[:2] for k in numbers]
    rows = np.concatenate([np.empty(0, dtype=np.intp), *of_slice])
    return _Sample(
        wrench=wrench,
        rows=rows,
        slices=np.split(np.arange(len(rows)), np.cumsum([len(part) for part in of_slice])[:-1]),
        frames=frames,
        position=recording.position_m[rows] / recording.rod.length_m,
        axes=axes[rows],
        noise=noise,
        rod=recording.rod,
        pull=(recording.pressing(model == "spatial") - wrench[:, :3])[rows],
        down=axes[rows] @ recording.gravity.direction,
    )


@dataclass(frozen=True)
class _Sample:
    """Rows (k,) that stand for a recording, and what they miss the model by."""

    wrench: Array
    """(n, 6) of all rows of the recording, dimensionless."""
    rows: Index
    slices: list[Index]
    """Places in `rows` of the rows of each slice; in space of all."""
    frames: list[Array]
    """(2, 3) axes of each slice; empty in space."""
    position: Array
    """(k, 3)"""
    axes: Array
    """(k, 3, 3)"""
    noise: tuple[float, float]
    rod: Rod
    pull: Array
    """(k, 3) the weight of the stated rod as a force; 0 without."""
    down: Array
    """(k, 3) gravity in the clamp's frame."""
    rough: bool = False
    """Whether the errors are those of a straight, uniform, weightless rod, whatever the stated one."""
    held: planar.Errors | inverse.SpatialErrors | None = None
    """Errors of the contacts of all corrections; None: each has its own."""

    def near(self, undone: Undone) -> _Sample:
        """The sample with the errors of one correction, for others of the same fault, whose errors differ little."""
        return replace(self, held=None if self.rough else self._errors(*self._corrected(undone)))

    def _corrected(self, undone: Undone) -> tuple[Array, Array, tuple[float, float]]:
        """Force and moment (k, 3) without a fault, and their noise."""
        force, moment = np.hsplit(undone.of(self.wrench, self.rows), 2)
        gains = undone.gains()
        return force, moment, (self.noise[0] * gains[0], self.noise[1] * gains[1])

    def _errors(
        self, force: Array, moment: Array, noise: tuple[float, float]
    ) -> planar.Errors | inverse.SpatialErrors | None:
        """Those of contacts of the stated rod; other rods have much the same.  None for exact reactions in space."""
        if self.held is not None:
            return self.held
        rod = Rod(self.rod.length_m, self.rod.bending_stiffness_Nm2) if self.rough else self.rod
        if self.frames:
            bent = rod.in_plane(self.down, sag=np.inf)  # that of the recording stays in the plane
            return planar.errors(force[:, 0], force[:, 1], moment[:, 2], noise=noise, rod=bent)
        return inverse.errors(force, moment, noise, rod=rod.in_space(), gravity=self.down) if max(noise) else None

    def left(self, undone: Undone) -> _Left:
        """What is left (r, k) without a fault, as parts and in rod lengths, 0 where noise explains it.

        In space the moment about the rod and that along the force; and in space and in the plane, how far contacts and
        tangents lie where they must not, or the largest misfit of rows that have no contact.
        """
        force, moment, noise = self._corrected(undone)
        pressed = _felt(force + self.pull if undone.air is None else force - undone.air[self.rows, :3], noise)
        # without a zero that is taken off, reactions of rows in contact cannot have become too small to be felt
        expected = pressed | (not undone.zero.any() and undone.air is None)
        with np.errstate(all="ignore"):  # a wrong correction may lead to any numbers
            evaluated = self._in_plane if self.frames else self._in_space
            known, misfits = evaluated(force, moment, noise, pressed, undone)
        found, explained = (np.nan_to_num(np.stack(parts), nan=_LARGEST) for parts in zip(*misfits, strict=True))
        left = np.clip(np.stack([found, explained, found - explained]) * pressed, 0.0, _LARGEST)
        left[:, -1, expected & ~(pressed & known)] = np.array([_LARGEST, 0.0, _LARGEST])[:, None]
        return _Left(*left)

    def _places(self, points: Array, rows: Index, undone: Undone) -> Array:
        """(n, 3) contacts in the world, of those (n, 3) in the clamps' frames."""
        clamps = self.position[rows] + undone.late * self.axes[rows, 0]
        return np.asarray(clamps + undone.length * np.einsum("ni,nij->nj", points, self.axes[rows]))

    def _in_plane(
        self, force: Array, moment: Array, noise: tuple[float, float], pressed: Mask, undone: Undone
    ) -> tuple[Mask, list[Misfit]]:
        """Which rows (k,) have a contact, and how far others lie beyond the tangent there."""
        reactions, length = (force[:, 0], force[:, 1], moment[:, 2]), undone.length
        error = self._errors(force, moment, noise)
        assert isinstance(error, planar.Errors)
        tolerance, bent = np.maximum(contact_tolerance(error), _TIP), undone.rod or self.rod
        if bent.weight_N:
            down = self.down * [1, 1, 0]
            heavy = inverse.reconstruct(
                force, moment, tolerance=tolerance, rod=bent.in_space(), gravity=down, steps=STEPS
            )
            phase, places, normals = heavy.phase, heavy.point, heavy.tangent[:, [1, 0]] * [1, -1]
        else:
            found = planar.reconstruct(np.zeros(len(force)), *reactions, tolerance=tolerance, rod=bent.in_plane())
            phase, places, normals = found.phase, np.pad(found.point, ((0, 0), (0, 1))), found.normal
        known, beyond, explained = phase != planar.Phase.NONE, np.zeros(len(force)), np.zeros(len(force))
        usable = pressed & known
        usable &= ~too_light(error.largest, usable)
        for part, frame in zip(self.slices, self.frames, strict=True):
            rows = part[usable[part]]
            lines = np.flatnonzero(phase[rows] == planar.Phase.TANGENTIAL)
            if not len(lines):
                continue
            inside = self.axes[rows, :2] @ frame.T  # (k, 2, 2) the clamps' axes in the slice's frame
            points = self._places(places[rows], rows, undone) @ frame.T
            turned = np.einsum("ni,nij->nj", normals[rows[lines]], inside[lines])
            errors = None
            if max(noise):
                covariance = length**2 * np.einsum("nia,nij,njb->nab", inside, error.point[rows], inside)
                errors = Errors(_SIGMAS, covariance, np.minimum(error.slope[rows], 1 / _SIGMAS))
            misfit = beyond_tangents(points, lines, turned, np.arange(len(rows)), errors, length)
            worst = (np.arange(len(lines)), (misfit.found - misfit.explained).argmax(axis=1))
            beyond[rows[lines]], explained[rows[lines]] = misfit.found[worst], misfit.explained[worst]
        return known, [Misfit(beyond, explained)]

    def _in_space(
        self, force: Array, moment: Array, noise: tuple[float, float], pressed: Mask, undone: Undone
    ) -> tuple[Mask, list[Misfit]]:
        """Which rows (k,) have a contact, what contradicts a single force, and how deep the contacts lie in their hull."""
        n, length, bent = len(force), undone.length, undone.rod or self.rod
        error = self._errors(force, moment, noise)
        assert not isinstance(error, planar.Errors)
        s1, place, turn = (np.zeros(n),) * 3 if error is None else (error.s1, error.largest, _SIGMAS * error.tangent)
        tolerance = np.maximum(tip_sigmas(np.nan_to_num(s1, posinf=0.0)), _TIP)
        weights = noise if max(noise) else None
        found = inverse.reconstruct(
            force, moment, tolerance=tolerance, noise=weights, rod=bent.in_space(), gravity=self.down, steps=STEPS
        )
        known, depth, explained = found.status == inverse.Status.OK, np.zeros(n), np.zeros(n)
        usable = pressed & known
        rows = np.flatnonzero(usable & ~too_light(place, usable))
        points = self._places(found.point[rows], rows, undone)
        tangents = np.einsum("ni,nij->nj", found.tangent[rows], self.axes[rows])
        every, lines = np.arange(len(rows)), np.flatnonzero(found.phase[rows] == planar.Phase.TANGENTIAL)
        errors = _SIGMAS * length * place[rows], turn[rows]
        if len(rows) > 4:  # fewer lie on their hull
            misfit = depths_in_hull(points, every, every, lines, tangents, errors, length)
            if misfit is None:
                depth[rows] = _LARGEST
            else:
                both = np.concatenate([every, lines])
                order = np.argsort(misfit.found - misfit.explained)  # the last one, and the worst, of each row stays
                depth[rows[both[order]]], explained[rows[both[order]]] = misfit.found[order], misfit.explained[order]
        radius = self.rod.diameter_m / 2 / self.rod.length_m / length
        single = against_single_force(force, moment, found, noise, _SIGMAS, radius)
        return known, [*single, Misfit(depth, explained)]
