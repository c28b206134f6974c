"""What may be wrong with a recording: each fault as the affine map of the wrench that undoes it.

A fault maps the wrench that the sensor should show to the one that it shows.  What undoes it is an affine map as well: a matrix
for signs, units, gains, exchanged axes and frames, and a zero that is taken off; both may differ from row to row.  A rod of
another length scales the dimensionless force by its square and the moment by itself, and is a matrix too.  Beside the wrench
the rod may be another one than stated, tapered, curved, heavy, or in a clamp that gives, and the poses may be those of another
time.  A cause has at most six numbers, which `scan3d.reconstruction.diagnosis` estimates.  `causes` is the table of them all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, Index, Mask
from scan3d.frames import euler_of, wrench_matrix
from scan3d.recording import CHANNELS, Recording
from scan3d.rods import Rod
from scan3d.spatial.march import free_reactions
from scan3d.units import angle, force, length, moment

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
    "moment-unit": ((1, 1, 1, 1e-3, 1e-3, 1e-3), "the {moments} in N mm, not in N m"),
}
# Gains: the channels that are recorded too large by one unknown factor; the moment about the rod vanishes.
_CHECK = " are recorded {0:.3g} times too large: check the sensor's gains"
_GAINS: dict[str, tuple[tuple[int, ...], str]] = {
    "stiffness": (
        (0, 1, 2, 3, 4, 5),
        "the rod is {0:.3g} times as stiff as stated, or force and moment are recorded {0:.3g} times too large (both have the "
        "same effect): calibrate the stiffness",
    ),
    "moment-scale": ((3, 4, 5), f"the moments{_CHECK}"),
    "force-scale": ((0, 1, 2), f"the forces{_CHECK}"),
    **{f"{CHANNELS[k]}-scale": ((k,), CHANNELS[k] + _CHECK.replace("are", "is")) for k in (0, 1, 2, 3, 5)},
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
    """Its code, ``unknown`` where no single fault explains the contradiction."""
    value: float | None
    """Its estimated size in `unit`; None where it has none."""
    unit: str
    explains: float
    """Part of the root mean square misfit that the correction of the fault removes."""
    message: str
    """What it is and what to do, as the end of a sentence."""
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
    channels = [0, 1, 2, 3, 4, 5] if spatial else [0, 1, 5]
    found = []
    for code, (factors, text) in _FACTORS.items():
        if any(factors[k] != 1 for k in channels):
            named = _named(code, None, "", text.format(moments="moments are" if spatial else "moment is"))
            found.append(known(Undone(np.diag(np.array(factors, dtype=float))), named))
    exchanged = Undone(np.eye(6)[[1, 0, 2, 3, 4, 5]])
    found.append(known(exchanged, _named("fx-fy-exchanged", None, "", "fx and fy are exchanged")))
    turned = np.zeros((len(wrench), 6, 6))
    turned[:, :3, :3] = turned[:, 3:, 3:] = recording.axes()
    text = 'force and moment have their components in the frame of the poses: state wrench_in = "world" in the map'
    found.append(known(Undone(turned), _named("wrench-in-world", None, "", text)))
    hanging = hanging_weight(recording, wrench)
    found += _zeros(recording, spatial, wrench, hanging)
    found.append(_late(recording))
    found += _rods(recording, spatial, wrench, hanging) if rod.is_simple else []
    for code, (scaled, text) in _GAINS.items():
        if spatial or len(scaled) > 1 or scaled[0] in (0, 1):  # in a plane mz is the only moment
            found.append(_gain(code, np.isin(np.arange(6), scaled), text))
    found.append(_length())
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


def _named(code: str, value: float | None, unit: str, message: str) -> Diagnosis:
    return Diagnosis(code, value, unit, 0.0, message)


def known(undone: Undone, named: Diagnosis, cost: int = 0) -> Cause:
    """A fault that has no numbers to be estimated."""
    return Cause(np.empty((1, 0)), lambda _: undone, lambda _: named, cost)


def stuck_rows(stuck: Index, wrench: Array) -> Cause:
    """Rows that repeat others; the fault is undone by leaving them out."""
    zero = np.zeros_like(wrench)
    zero[stuck] = wrench[stuck]
    text = (
        f"sensor or log was stuck: in {len(stuck)} rows force and moment repeat those of the row before though the clamp "
        "moves; leave these rows out"
    )
    return known(Undone(zero=zero), _named("stick", float(len(stuck)), "rows", text))


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
    _, first, sweep = np.unique(recording.sweep, return_index=True, return_inverse=True)
    start = wrench[first]
    zero, ends = np.median(start, axis=0), np.percentile(start, [2.5, 97.5], axis=0)
    linear = np.polynomial.polynomial.polyfit(first, start, min(len(first) - 1, 1))
    steady = np.vander(np.arange(len(wrench)), len(linear), increasing=True) @ linear
    value, unit, text = _of_zero(zero, recording.rod, spatial)
    untared = _named(
        "not-tared",
        value,
        unit,
        f"force and moment were not tared: at the starts of the sweeps the sensor shows {text}; let the import take off what "
        "it shows in the air ([tare])",
    )
    value, unit, text = _of_zero(ends[1] - ends[0], recording.rod, spatial)
    drifts = _named(
        "drift",
        value,
        unit,
        f"the zero of force and moment drifts from sweep to sweep, in all by {text}, or a weight turns with the clamp: let "
        "each sweep begin in the air, and let the import take off the drift ([tare])",
    )
    if hanging is not None:
        size = float(np.linalg.norm(hanging)) * recording.rod.force_unit_N
        text = f"a weight of {force(size)} hangs at the sensor and turns with the clamp: let each sweep begin in the air, and "
        drifts = _named("weight", size, "N", text + "let the import take it off ([tare])")
    each = start[sweep.reshape(-1)]
    return [known(Undone(zero=zero), untared), *(known(Undone(zero=zero), drifts, 2) for zero in (steady, each))]


def _of_zero(wrench: Array, rod: Rod, spatial: bool) -> tuple[float, str, str]:
    """The size of a zero (6,) that is off, its unit, and its components in words."""
    newton, newton_metres = wrench[:3] * rod.force_unit_N, wrench[3:] * rod.moment_unit_Nm
    shown = (newton, newton_metres) if spatial else (newton[:2], newton_metres[2:])
    text = f"{force(*shown[0], digits=2)} and {moment(*shown[1], digits=2)}"
    if np.linalg.norm(wrench[3:]) > np.linalg.norm(wrench[:3]):
        return float(np.linalg.norm(newton_metres)), "N m", text
    return float(np.linalg.norm(newton)), "N", text


def _gain(code: str, scaled: Mask, text: str) -> Cause:
    """A wrong gain of the channels (6,) that are marked; its number is the logarithm of the factor that undoes it."""

    def named(numbers: Array) -> Diagnosis:
        factor = float(np.exp(-numbers[0]))
        return _named(code, factor, "times", text.format(factor))

    starts = np.log(np.geomspace(0.3, 1 / 0.3, 13))[:, None]  # 1 among the factors, near which small ones are found
    return Cause(starts, lambda n: Undone(np.diag(np.exp(n[0] * scaled))), named, 1, _LARGEST_SCALE)


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
        return _named("delay", value, unit, text)

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

    def curvature(n: Array) -> tuple[float, float, float]:
        about_z, about_x = (float(part) / rod.length_m for part in np.pad(n, (0, 2 - count)))
        return about_z, about_x, 0.0

    def tip(n: Array) -> float:
        return float(np.exp(n[0]))

    def weight(n: Array) -> float:
        return _TENTH * float(np.exp(min(n[0], 2.0))) * rod.force_unit_N

    def compliance(n: Array) -> float:
        return _TENTH * float(np.exp(min(n[0], 2.0))) / rod.moment_unit_Nm

    def curved(n: Array) -> Rod:
        return replace(rod, curvature_per_m=curvature(n) if spatial else curvature(n)[0])

    def heavy(n: Array, tared: bool) -> Undone:
        found = replace(rod, weight_N=weight(n))
        free = np.concatenate(free_reactions(found.in_space(), directions.T)).T[which.reshape(-1)]
        return Undone(zero=-free * tared, rod=found, air=free)

    def of_curvature(n: Array) -> Diagnosis:
        value = np.array(curvature(n)[:count])
        text = f"curvature_per_m = {_list(np.array(curvature(n))) if spatial else f'{value[0]:.3g}'}"
        text = f"the free rod is curved: hold it against a straight edge, and state {text}"
        return _named("curvature", float(np.linalg.norm(value)) if spatial else float(value[0]), "1/m", text)

    def of_weight(n: Array, tared: bool) -> Diagnosis:
        text = (
            f"its weight of {force(weight(n))} bends the rod: weigh it, and state weight_N, and [gravity] with direction = "
            f"{_list(gravity.round(3))} and tared = {str(tared).lower()}"
        )
        return _named("weight", weight(n), "N", text)

    def of_taper(n: Array) -> Diagnosis:
        text = f"the rod tapers to {tip(n):.3g} of its diameter: measure it at the tip, and state tip_diameter_m"
        return _named("taper", tip(n), "times", text)

    def of_clamp(n: Array) -> Diagnosis:
        text = (
            f"the clamp gives by {compliance(n):.3g} rad per N m: load it by a known moment, and state "
            "clamp_compliance_rad_per_Nm"
        )
        return _named("clamp-compliance", compliance(n), "rad/(N m)", text)

    def tapered(n: Array) -> Undone:
        return Undone(rod=replace(thick, tip_diameter_m=tip(n) * thick.diameter_m))

    def yielding(n: Array) -> Undone:
        return Undone(rod=replace(rod, clamp_compliance_rad_per_Nm=compliance(n)))

    arcs = np.kron(np.eye(count), np.array([[-0.02], [-0.3], [0.02], [0.3]]))  # curvatures in 1/L
    found = [
        Cause(np.log([[0.5], [0.7], [0.95]]), tapered, of_taper, 1, _LARGEST_SCALE, "rod"),
        Cause(arcs, lambda n: Undone(rod=curved(n)), of_curvature, count, _LARGEST_SCALE, "rod"),
        Cause(_SMALL[:1], yielding, of_clamp, 1, _LARGEST_LOG, "rod"),
    ]
    # what a sensor shows in the air that was not tared is the weight
    in_air = float(np.median(np.linalg.norm(wrench[np.unique(recording.sweep, return_index=True)[1], :3], axis=1)))
    shown = in_air > max(2 * recording.noise.of_reactions(rod)[0], _LEAST_WEIGHT)
    if hanging is not None:
        number = np.log([np.linalg.norm(hanging) / _TENTH])
        found.append(known(heavy(number, tared=False), of_weight(number, tared=False), 1))
    elif spatial or np.abs(down[:, :2]).max() > np.abs(down[:, 2]).max():  # else it hardly bends the rod in its slices
        for tared in (True, False) if shown else (True,):
            undone, named = partial(heavy, tared=tared), partial(of_weight, tared=tared)
            starts = _SMALL if tared else np.vstack([_SMALL, np.log(in_air / _TENTH)])
            found.append(Cause(starts, undone, named, 1, _LARGEST_LOG, "rod"))
    return found


def _length() -> Cause:
    """A rod of another length; the number is the logarithm of the true one over the stated one."""

    def undone(numbers: Array) -> Undone:
        length = float(np.exp(numbers[0]))
        return Undone(np.diag(length ** np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])), length=length)

    def named(numbers: Array) -> Diagnosis:
        factor = float(np.exp(numbers[0]))
        text = f"the rod is {factor:.3g} times as long as stated: measure its free length"
        return _named("length", factor, "times", text)

    # contacts near the tip count as tip contacts, so that the misfit over the length is one of steps
    return Cause(np.log(np.linspace(0.7, 1.4, 47))[:, None], undone, named, 1, _LARGEST_SCALE)


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
        return _named(
            "moment-not-moved",
            distance,
            "mm",
            f"the moment was not moved to the clamp: it refers to a point {length(distance, 'mm')} from it; state "
            f"{position} under "
            "[sensor], or calibrate",
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
        return _named("turned-and-moved", degrees, "deg", text)
    where = _ABOUT[axis] if single else "about an axis across several of the clamp's"
    text = f"{turned} {where}: {state} under [sensor], or calibrate"
    return _named(f"turned-{'xyz'[axis]}" if single else "turned", degrees, "deg", text)


def _list(values: Array) -> str:
    return "[" + ", ".join(f"{value + 0.0:.3g}" for value in values) + "]"
