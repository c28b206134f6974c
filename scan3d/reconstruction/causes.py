"""What may be wrong with a recording: each fault as the affine map of the wrench that undoes it.

A fault maps the wrench that the sensor should show to the one that it shows.  What undoes it is an affine map as well: a matrix
for signs, units, gains, exchanged axes and frames, and a zero that is taken off; both may differ from row to row.  A rod of
another length scales the dimensionless force by its square and the moment by itself, and is a matrix too.  A cause has at most
six numbers, which `scan3d.reconstruction.diagnosis` estimates.  `causes` is the table of them all.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, Index, Mask
from scan3d.frames import euler_of, wrench_matrix
from scan3d.recording import Recording
from scan3d.rods import Rod

_CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")
_ABOUT = ("about the clamp's x axis", "about the rod (the clamp's y axis)", "about the clamp's z axis")
# Parts of the largest axis of a turn below which the others are not named.
_ABOUT_ONE = 0.15
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
    **{f"{_CHANNELS[k]}-scale": ((k,), _CHANNELS[k] + _CHECK.replace("are", "is")) for k in (0, 1, 2, 3, 5)},
}
# Largest logarithm of a scale: larger ones make rods so long or forces so large that noise and rounding hide any misfit.
_LARGEST_SCALE = 1.4
# First estimates of what is searched: factors; the rod's length, in which the misfit is one of steps because contacts near the
# tip count as tip contacts; angles in radians, and distances in rod lengths.
_SCALES = np.geomspace(0.3, 3.0, 12)
_LENGTHS = np.linspace(0.7, 1.4, 47)
_ANGLES = np.radians(np.concatenate([sign * np.geomspace(2.0, 165.0, 12) for sign in (-1, 1)]))
_TURNS = np.concatenate([np.radians(angle) * (2 * np.array(list(np.ndindex(2, 2, 2))) - 1) for angle in (2.0, 15.0)])
_DISTANCES = np.geomspace(0.03, 0.5, 4)
_ABOUT_ROD, _ALONG_ROD = np.radians(np.arange(-180, 180, 30)), np.linspace(-0.5, 0.5, 5)


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


class Undone(NamedTuple):
    """What undoes a fault: the wrench is ``matrix (w - zero)``, the rod is `length` times as long as stated."""

    matrix: Array = np.eye(6)
    """(6, 6), or (n, 6, 6) for every row of the recording."""
    zero: Array = np.zeros(6)
    """(6,), or (n, 6)."""
    length: float = 1.0

    def of(self, wrench: Array, rows: Index) -> Array:
        """(k, 6) the wrenches of some rows without the fault, of those (n, 6) that are recorded."""
        matrix = self.matrix[rows] if self.matrix.ndim == 3 else self.matrix
        zero = self.zero[rows] if self.zero.ndim == 2 else self.zero
        right: Array = np.einsum("...ij,...j->...i", matrix, wrench[rows] - zero)
        return right

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
    found += _zeros(recording, spatial, wrench)
    for code, (scaled, text) in _GAINS.items():
        if spatial or len(scaled) > 1 or scaled[0] in (0, 1):  # in a plane mz is the only moment
            found.append(_gain(code, np.isin(np.arange(6), scaled), text))
    found.append(_length())
    if len(stuck):
        found.append(stuck_rows(stuck, wrench))
    places = np.concatenate([sign * distance * axes for distance in _DISTANCES for sign in (-1, 1)])
    if not spatial:
        in_plane = places[places[:, 2] == 0][:, :2]
        return [*found, _sensor(axes[2:], none, _ANGLES[:, None], rod), _sensor(none, axes[:2], in_plane, rod)]
    found += [_sensor(axes[[k]], none, _ANGLES[:, None], rod) for k in range(3)]
    found += [_sensor(axes, none, _TURNS, rod), _sensor(none, axes, places, rod)]
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


def _zeros(recording: Recording, spatial: bool, wrench: Array) -> list[Cause]:
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
        f"the zero of force and moment drifts from sweep to sweep, in all by {text}: let each sweep begin in the air, and let "
        "the import take off the drift ([tare])",
    )
    each = start[sweep.reshape(-1)]
    return [known(Undone(zero=zero), untared), *(known(Undone(zero=zero), drifts, 2) for zero in (steady, each))]


def _of_zero(wrench: Array, rod: Rod, spatial: bool) -> tuple[float, str, str]:
    """The size of a zero (6,) that is off, its unit, and its components in words."""
    newton, newton_metres = wrench[:3] * rod.force_unit_N, wrench[3:] * rod.moment_unit_Nm
    shown = (newton, newton_metres) if spatial else (newton[:2], newton_metres[2:])
    forces, moments = (", ".join(f"{value + 0.0:.2g}" for value in values) for values in shown)
    text = f"({forces}) N and ({moments}) N m"
    if np.linalg.norm(wrench[3:]) > np.linalg.norm(wrench[:3]):
        return float(np.linalg.norm(newton_metres)), "N m", text
    return float(np.linalg.norm(newton)), "N", text


def _gain(code: str, scaled: Mask, text: str) -> Cause:
    """A wrong gain of the channels (6,) that are marked; its number is the logarithm of the factor that undoes it."""

    def named(numbers: Array) -> Diagnosis:
        factor = float(np.exp(-numbers[0]))
        return _named(code, factor, "times", text.format(factor))

    return Cause(np.log(_SCALES)[:, None], lambda n: Undone(np.diag(np.exp(n[0] * scaled))), named, 1, _LARGEST_SCALE)


def _length() -> Cause:
    """A rod of another length; the number is the logarithm of the true one over the stated one."""

    def undone(numbers: Array) -> Undone:
        length = float(np.exp(numbers[0]))
        return Undone(np.diag(length ** np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])), length=length)

    def named(numbers: Array) -> Diagnosis:
        factor = float(np.exp(numbers[0]))
        text = f"the rod is {factor:.3g} times as long as stated: measure its free length"
        return _named("length", factor, "times", text)

    return Cause(np.log(_LENGTHS)[:, None], undone, named, 1, _LARGEST_SCALE)


def _sensor(turns: Array, places: Array, starts: Array, rod: Rod) -> Cause:
    """A sensor in another frame than the clamp's: turned about axes (k, 3), and beside the clamp along axes (l, 3).

    The numbers are those of a rotation vector, and of a place in rod lengths.
    """

    def split(numbers: Array) -> tuple[Array, Array]:
        return numbers[: len(turns)] @ turns, numbers[len(turns) :] @ places

    def undone(numbers: Array) -> Undone:
        turn, place = split(numbers)
        return Undone(wrench_matrix(Rotation.from_rotvec(turn).as_matrix(), place))

    return Cause(starts, undone, lambda numbers: _frame(*split(numbers), rod), starts.shape[1])


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
        for angle in _ABOUT_ROD:
            turn = Rotation.from_rotvec(angle * along_rod) * to_rod
            across = np.cross(turn.apply(sign * arm / size), along_rod)
            starts += [[*turn.as_rotvec(), *(across + along * along_rod)] for along in _ALONG_ROD]
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
            f"the moment was not moved to the clamp: it refers to a point {distance:.3g} mm from it; state {position} under "
            "[sensor], or calibrate",
        )
    axis = int(np.argmax(np.abs(vector)))
    single = bool(np.delete(np.abs(vector), axis).max() <= _ABOUT_ONE * np.abs(vector[axis])) and not place.any()
    angle = float(np.degrees(vector[axis] if single else np.linalg.norm(vector)))
    euler = np.degrees(vector) if single else euler_of(Rotation.from_rotvec(vector).as_matrix())
    turned = f"the sensor is turned by {angle:.3g}°"
    state = f"state euler_deg = {_list(euler)}"
    if place.any():
        text = f"{turned}, and its moments refer to a point {distance:.3g} mm from the clamp: {state} and {position}"
        return _named("turned-and-moved", angle, "deg", f"{text} under [sensor], or calibrate")
    where = _ABOUT[axis] if single else "about an axis across several of the clamp's"
    text = f"{turned} {where}: {state} under [sensor], or calibrate"
    return _named(f"turned-{'xyz'[axis]}" if single else "turned", angle, "deg", text)


def _list(values: Array) -> str:
    return "[" + ", ".join(f"{value + 0.0:.3g}" for value in values) + "]"
