"""What a rig touches to be calibrated, a sphere or a plane at a place that need not be known, and the rows that are contacts.

A reference is fattened by the rod's radius at the clamp, so that it is touched by the centre line of a rod that does not taper.
Lengths are in nominal lengths of the rod.

A sweep begins in the air, and most sweeps end there.  From each end a run of rows belongs to the air until the reactions
leave the level of that end by more than the noise; rows beyond, which may be light touches, are left out with a margin.

A row in contact must not be chosen by its own noise.  If rows were taken whose measured force exceeds a limit, those near
the limit would have noise that points outwards on average, and the estimate would be biased by a fraction of its standard
deviation.  Rows are chosen by their neighbours in the same sweep, whose noise is another.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import chdtri, ndtr

from scan3d.arrays import NEGLIGIBLE, ROUNDING, Array, Mask
from scan3d.errors import InputError
from scan3d.recording import Recording
from scan3d.rigs import Frame, to_inner, to_outer
from scan3d.rods import Rod
from scan3d.spatial.march import free_reactions
from scan3d.units import length

# Standard deviations that count as chance.
CHANCE = 4.5


class Met(NamedTuple):
    """How contacts (n, 3) with tangents (n, 3) meet a reference, with derivatives by them and by the reference's place."""

    gap: Array
    """(n,) distance of the contact from the surface less the rod's radius, negative inside."""
    normal: Array
    """(n, 3) outward: the derivatives of `gap` by the contact, and of `along` by the tangent."""
    along: Array
    """(n,) cosine between tangent and normal."""
    along_by_point: Array
    """(n, 3)"""
    gap_by_place: Array
    """(n, 3)"""
    along_by_place: Array
    """(n, 3)"""


@dataclass(frozen=True)
class Sphere:
    """A sphere; its place are the coordinates of its centre along its axes."""

    diameter_m: float
    radius: float
    origin: Array
    """(3,) its centre."""
    axes: Array
    """(3, 3) as columns."""
    thickness: float = 0.0
    """The rod's radius at its clamp, which is part of `radius`."""

    kind = "sphere"
    extent, check = "a tenth of the sphere's radius", "the diameter and its unit"
    unlike = "the diameter, a reference that is no sphere, such as one of facets"

    @classmethod
    def of(cls, diameter_m: object, rod: Rod) -> Sphere:
        """The sphere of a diameter that a rod touches, with its centre in the origin.  Raises InputError for another one."""
        if not (isinstance(diameter_m, (int, float)) and math.isfinite(diameter_m) and diameter_m > 0):
            raise InputError(
                f"the reference sphere needs a diameter above 0, got {diameter_m!r}; the other reference is 'plane'"
            )
        if diameter_m > 1000 * rod.length_m:  # to a rod it is a plane
            raise InputError(
                f"the reference sphere has a diameter of {length(diameter_m, 'm')}, and the rod a length of "
                f"{length(rod.length_m, 'm')}; check the unit of the diameter, or touch a plane"
            )
        thickness = rod.diameter_m / 2 / rod.length_m
        return cls(diameter_m, diameter_m / 2 / rod.length_m + thickness, np.zeros(3), np.eye(3), thickness)

    @property
    def title(self) -> str:
        return f"a sphere of {1000 * self.diameter_m:g} mm"

    @property
    def size(self) -> float:
        """The length over which the surface curves, in rod lengths."""
        return self.radius

    def moved(self, step: Array) -> Sphere:
        return replace(self, origin=self.origin + self.axes @ step)

    def met(self, point: Array, tangent: Array) -> Met:
        away = point - self.origin
        distance = np.linalg.norm(away, axis=1)
        normal = away / distance[:, None]
        cosine = (tangent * normal).sum(axis=1)
        across = (tangent - cosine[:, None] * normal) / distance[:, None]
        return Met(distance - self.radius, normal, cosine, across, -normal @ self.axes, -across @ self.axes)

    def nearest(self, points: Array, outside: Array) -> tuple[int, Sphere, float]:
        """The set of points, of sets (t, n, 3), that is nearest to the sphere, which then is there, and the median distance.

        The centres are those of spheres of any radius, with the least squares of a linear equation.
        """
        middle = points.mean(axis=1, keepdims=True)
        relative = points - middle
        square = (relative**2).sum(axis=2, keepdims=True)
        matrix = np.concatenate([2 * relative, np.ones_like(square)], axis=2)
        # where the points lie in a plane, the centre lies in it
        normal = np.linalg.pinv(matrix.swapaxes(1, 2) @ matrix, ROUNDING, hermitian=True)
        centre = middle + (normal @ matrix.swapaxes(1, 2) @ square)[:, None, :3, 0]
        misfit = np.median(np.abs(np.linalg.norm(points - centre, axis=2) - self.radius), axis=1)
        best = int(np.argmin(misfit))
        return best, replace(self, origin=centre[best, 0]), float(misfit[best])


@dataclass(frozen=True)
class Plane:
    """A plane; its place is its height, and its tilt about its first two axes."""

    radius: float
    origin: Array
    """(3,) a point of it."""
    axes: Array
    """(3, 3) as columns; the last is the outward normal."""
    thickness: float = 0.0
    """The rod's radius at its clamp, which is all of `radius`."""

    kind = "plane"
    title = "a plane"
    extent, check = "a fiftieth of the rod's length", "that only the plane was touched"
    unlike = "a reference that is not flat, or whose border was touched"
    # contacts anywhere along the rod are as far from a plane as the rod is straight
    size = 0.15

    @classmethod
    def of(cls, rod: Rod) -> Plane:
        """The plane z = 0 that a rod touches."""
        thickness = rod.diameter_m / 2 / rod.length_m
        return cls(thickness, np.zeros(3), np.eye(3), thickness)

    def moved(self, step: Array) -> Plane:
        axes = self.axes @ Rotation.from_rotvec([step[1], step[2], 0.0]).as_matrix()
        return replace(self, axes=axes, origin=self.origin + step[0] * axes[:, 2])

    def met(self, point: Array, tangent: Array) -> Met:
        normal = np.broadcast_to(self.axes[:, 2], point.shape)
        relative, direction = (point - self.origin) @ self.axes, tangent @ self.axes
        one, zero = np.ones(len(point)), np.zeros(len(point))
        gap_by_place = np.column_stack([-one, -relative[:, 1], relative[:, 0]])
        along_by_place = np.column_stack([zero, -direction[:, 1], direction[:, 0]])
        gap = relative[:, 2] - self.radius
        return Met(gap, normal, direction[:, 2], np.zeros_like(point), gap_by_place, along_by_place)

    def nearest(self, points: Array, outside: Array) -> tuple[int, Plane, float]:
        """The set of points, of sets (t, n, 3), that is nearest to a plane, that plane, and the median distance.

        The point `outside` (3,) is on its outward side.
        """
        middle = points.mean(axis=1, keepdims=True)
        relative = points - middle
        normal = np.linalg.eigh(relative.swapaxes(1, 2) @ relative)[1][:, :, 0]
        misfit = np.median(np.abs(np.einsum("tni,ti->tn", relative, normal)), axis=1)
        best = int(np.argmin(misfit))
        normal, middle = normal[best], middle[best, 0]
        normal = normal if (outside - middle) @ normal >= 0 else -normal
        axes = Rotation.align_vectors([normal], [[0.0, 0.0, 1.0]])[0].as_matrix()
        return best, replace(self, origin=middle - self.radius * normal, axes=axes), float(misfit[best])


Reference = Sphere | Plane


# Rows at an end of a sweep that give its level.
_LEVEL = 5
# Deviations from the level, in standard deviations of the largest channel, up to which a row counts as air, and beyond
# which it counts as contact for certain; and the range of the rows of an end in the air.  The force of a touch grows
# steadily, so that rows between the first two are as many as those before them in which the noise hides the touch.
_AIR, _CONTACT, _CALM = 4.0, 12.0, 6.0
_PARTS = (slice(0, 3), slice(3, 6))

Runs = list[NDArray[np.intp]]
"""Numbers of rows that follow one another."""


class Unloaded(NamedTuple):
    """What the rows in the air show; wrenches have the unit of those given."""

    air: Mask
    """(n,)"""
    contact: Mask
    """(n,) rows in which the rod is loaded for certain."""
    force_noise: float
    """The stated noise, or that of the rows in the air if it is not stated or they contradict it."""
    moment_noise: float
    basis: Array
    """(n, k) of the tare over the rows."""
    tare: Array
    """(6, k)"""
    model: str
    """One of `scan3d.choices.TARES`, but not ``auto``."""
    misfit: float
    """Mean square deviation of the rows in the air from the tare, over the variance of the noise."""


def unloaded(
    sweep: NDArray[np.int64], wrench: Array, channels: Mask, noise: tuple[float, float], model: str
) -> Unloaded:
    """The air of sweeps: `sweep` (n,) numbers them, `wrench` (n, 6) is what the sensor shows, `noise` 0 where unknown.

    Raises InputError for too few rows in the air.
    """
    _, of_row = np.unique(sweep, return_inverse=True)
    of_row = of_row.reshape(-1)
    runs = np.split(np.argsort(of_row, kind="stable"), np.cumsum(np.bincount(of_row))[:-1])
    largest = np.maximum(np.repeat([np.abs(wrench[:, part]).max() for part in _PARTS], 3), np.finfo(float).tiny ** 0.25)
    known, least = np.repeat(noise, 3), 1e-6 * largest  # so that exact data have weights
    ends = [rows[part] for rows in runs for part in (slice(0, _LEVEL), slice(-_LEVEL, None)) if len(rows) > _LEVEL]
    # stated noise may be understated, and a sensor may drift by more than its noise within a sweep
    rough = np.maximum(np.maximum(_noise_of_runs(wrench, ends, channels, _typical), known), 5e-4 * largest)
    air, contact = _separated(np.where(channels, wrench / rough, 0.0), runs)
    if air.sum() < 12:
        raise InputError(
            f"the recording has {air.sum()} rows in the air, and a calibration needs 12: let each sweep begin and end "
            "some rows before and after the rod touches the reference"
        )
    free = [rows[air[rows]] for rows in runs]
    quiet = [run for rows in free for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)]
    quick = np.maximum(np.maximum(known, _noise_of_runs(wrench, quiet, channels, np.mean)), least)
    for name in _models(model, sweep, air):
        basis = _basis(name, sweep)
        if name == "sweep":  # by least squares the mean of the rows of each
            count = np.bincount(of_row[air])
            tare: Array = np.stack([np.bincount(of_row[air], one) / count for one in wrench[air].T])
        else:
            tare = np.asarray(np.linalg.lstsq(basis[air], wrench[air], rcond=None)[0].T, dtype=float)
        freedom = max(int(air.sum()) - basis.shape[1], 1)
        square: Array = ((wrench - basis @ tare.T)[air] ** 2).sum(axis=0) / freedom
        # chance makes four standard deviations; noise that is not stated is that of the same rows, which is less certain
        allowed = 1 + 4 * float(np.sqrt(2 / freedom / channels.sum())) + 0.1 * (not all(noise))
        if (square / quick**2)[channels].mean() < allowed:
            break
    misfit = float((square / np.where(known > 0, known, quick) ** 2)[channels].mean())
    own = np.repeat([np.sqrt(square[part][channels[part]].mean()) for part in _PARTS], 3)
    deviation = np.maximum(np.where((known > 0) & (misfit <= allowed), known, np.maximum(own, known)), least)
    return Unloaded(air, contact, float(deviation[0]), float(deviation[3]), basis, tare, name, misfit)


def six_channels(recording: Recording) -> tuple[Mask, Array]:
    """Which components of force and moment (6,) a recording has, and all of them (n, 6) in N and N·m, zero where it has not."""
    if recording.six_axis:
        return np.ones(6, dtype=bool), np.hstack(recording.wrench())
    wrench = np.zeros((len(recording), 6))
    wrench[:, :2], wrench[:, 5] = recording.force_N, recording.moment_Nm
    return np.array([True, True, False, False, False, True]), wrench


class Weighed(NamedTuple):
    """What a sensor carries in the air."""

    weight_N: float
    sd_N: float
    """Infinite where gravity lies alike in all sweeps."""
    tare_and_drift: tuple[Array, Array] | None = None
    """(6,) what the sensor shows beside it in the middle of the recording, and its change; N and N·m.  None unless the weight
    is certain, and its centre may be that of the rod."""


def weighed(recording: Recording, rod: Rod, sensor: Frame, clamp: Array, air: Unloaded, place: Array) -> Weighed:
    """The weight by the rows in the air of sweeps in which gravity g lies otherwise in the clamp's frame.

    A weight W with the first moment a adds ``-W g`` to the reaction and ``-a × g`` to its moment: linear least squares with the
    zero of each channel and its drift.  `clamp` (3, 3) is the clamp's turn in the pose, `place` (3, 3) the covariance of the
    sensor's place in m².
    """
    channels, wrench = six_channels(recording)
    noise = air.force_noise * recording.rod.force_unit_N, air.moment_noise * recording.rod.moment_unit_Nm
    rows, gravity = np.flatnonzero(air.air), recording.gravity
    assert gravity is not None
    _, sweep, count = np.unique(recording.sweep[rows], return_inverse=True, return_counts=True)
    of_sweep = (sweep == np.arange(len(count))[:, None]) / np.sqrt(count)[:, None]  # their sums have the noise of a row
    basis, down = _basis("linear", recording.sweep)[rows], recording.axes()[rows] @ np.array(gravity.direction) @ clamp
    zero = np.linalg.qr(of_sweep @ basis)[0]

    def beside_zero(values: Array) -> Array:
        values = of_sweep @ values
        return np.asarray(values - zero @ (zero.T @ values))

    def solved(design: Array, values: Array, noise: float) -> tuple[Array, Array]:
        inverse = np.linalg.pinv(design.T @ design, rcond=NEGLIGIBLE, hermitian=True)
        found, freedom = inverse @ design.T @ values, len(values) - design.shape[1] - values.size // len(count) * 2
        left = float(((values - design @ found) ** 2).sum()) / max(freedom, 1)
        return found, inverse * max(noise**2, left)

    force, moment = to_outer(wrench[rows, :3], wrench[rows, 3:], sensor.turn, sensor.position_m)
    tilted, (in_force, in_moment) = beside_zero(down), channels.reshape(2, 3)
    if not (tilted[:, in_force] ** 2).sum() > NEGLIGIBLE * len(rows):
        return Weighed(0.0, np.inf)
    by_force, variance = solved(-tilted[:, in_force].reshape(-1, 1), beside_zero(force)[:, in_force].ravel(), noise[0])
    weight, deviation = float(by_force[0]), float(np.sqrt(variance[0, 0]))
    if weight <= CHANCE * deviation:
        return Weighed(weight, deviation)
    in_air = free_reactions(replace(rod, weight_N=weight).in_space(), down.T)
    carried = np.column_stack([in_air[0].T * rod.force_unit_N, in_air[1].T * rod.moment_unit_Nm])
    turned = np.cross(tilted[:, None], np.eye(3)).swapaxes(1, 2)[:, in_moment].reshape(-1, 3)
    off, covariance = solved(turned, beside_zero(moment - carried[:, 3:])[:, in_moment].ravel(), noise[1])
    covariance = covariance + weight**2 * place
    sizes, axes = np.linalg.eigh(covariance)
    known = sizes > NEGLIGIBLE * sizes[-1]
    alike = ((axes.T @ off)[known] ** 2 / sizes[known]).sum() < chdtri(known.sum(), 2 * ndtr(-CHANCE))
    shown = wrench[rows] - np.hstack(to_inner(carried[:, :3], carried[:, 3:], sensor.turn, sensor.position_m))
    tare, drift = np.linalg.lstsq(basis, shown * channels, rcond=None)[0]
    return Weighed(weight, deviation, (tare, drift) if alike else None)


def _models(model: str, sweep: NDArray[np.int64], air: Mask) -> tuple[str, ...]:
    """The models of the tare that are tried one after the other; a tare for each sweep needs rows in the air of each."""
    without = np.setdiff1d(sweep, sweep[air])
    if model == "sweep" and len(without):
        raise InputError(
            f"sweep {without[0]} has no rows in the air, which a tare for each sweep needs; let it begin earlier"
        )
    return (model,) if model != "auto" else ("linear",) if len(without) else ("linear", "sweep")


def _basis(model: str, sweep: NDArray[np.int64]) -> Array:
    """(n, k) functions of the row whose sum is the tare of a channel."""
    if model == "sweep":
        return np.asarray(sweep[:, None] == np.unique(sweep), dtype=float)
    constant_and_linear = np.column_stack([np.ones(len(sweep)), np.linspace(-0.5, 0.5, len(sweep))])
    return constant_and_linear if model == "linear" else constant_and_linear[:, :1]


def _noise_of_runs(wrench: Array, runs: Runs, channels: Mask, mean: Callable[[Array], Any]) -> Array:
    """(6,) the noise of force and of moment by the second differences of runs of rows, which do not drift.

    `mean` is that of their squares: `numpy.mean`, or `_typical` where not all runs are in the air.
    """
    pieces = [np.diff(wrench[rows], n=2, axis=0) ** 2 for rows in runs if len(rows) > 2]
    square = np.concatenate([*pieces, np.zeros((int(not pieces), 6))])
    return np.repeat([np.sqrt(mean(square[:, part][:, channels[part]]) / 6) for part in _PARTS], 3)


def _typical(square: Array) -> float:
    """The mean of squares of normal numbers, by their median."""
    return float(np.median(square) / chdtri(1, 0.5))


def _separated(scaled: Array, runs: Runs) -> tuple[Mask, Mask]:
    """Rows (n,) in the air, and rows in contact for certain; others are neither.

    In the air the rows of an end of a sweep are alike, and its level is that of the other end or near that of other sweeps.
    """
    parts = [(scaled[rows[:_LEVEL]], scaled[rows[-_LEVEL:]]) for rows in runs]
    levels = np.array([[np.median(part, axis=0) for part in pair] for pair in parts])
    calm = np.array([[np.ptp(part, axis=0).max() <= _CALM for part in pair] for pair in parts])
    middle = np.median(levels[:, 0], axis=0)
    near = np.abs(levels - middle).max(axis=2) <= max(0.1 * float(np.abs(scaled - middle).max()), _AIR)
    alike = np.abs(levels[:, 0] - levels[:, 1]).max(axis=1) <= _CALM
    free = calm & (near | alike[:, None])
    air, contact = np.zeros(len(scaled), dtype=bool), np.zeros(len(scaled), dtype=bool)
    for rows, pair, is_free in zip(runs, levels, free, strict=True):
        away = np.array([np.abs(scaled[rows] - level).max(axis=1) for level in pair])
        for k, from_end in enumerate((slice(None), slice(None, None, -1))):
            if is_free[k]:
                air[rows[from_end][: _quiet(away[k][from_end])]] = True
        contact[rows] = is_free.any() & (np.where(is_free[:, None], away, np.inf).min(axis=0) > _CONTACT)
    return air, contact & ~air


def _quiet(away: Array) -> int:
    """How many of the first rows are in the air, by their deviations (k,) from its level, with a margin before the touch."""
    if not (away > _CONTACT).any():
        return len(away)
    pressed = int(np.argmax(away > _CONTACT))
    # single rows beyond the limit by chance lie before the touch
    touched = int(np.flatnonzero(away[:pressed] <= _AIR).max(initial=-1)) + 1
    return max(touched - (pressed - touched) - 1, 0)


def neighbours(wrench: Array, sweep: NDArray[np.int64], contact: Mask) -> Array:
    """The wrench (n, 6) of each row in contact as the nearest rows of its sweep predict it, without its own.

    It is that of the straight line through up to three rows before and three after it.
    """
    result: Array = wrench.copy()
    offsets = np.array([-3, -2, -1, 1, 2, 3])
    for number in np.unique(sweep[contact]):
        rows = np.flatnonzero((sweep == number) & contact)
        index = np.arange(len(rows))[:, None] + offsets
        inside = np.asarray((index >= 0) & (index < len(rows)))
        index = np.clip(index, 0, len(rows) - 1)
        away = rows[index] - rows[:, None]
        inside &= np.abs(away) <= 3
        count = np.maximum(inside.sum(axis=1, keepdims=True), 1)
        middle = (away * inside).sum(axis=1, keepdims=True) / count
        spread = inside * (away - middle)
        square = (spread**2).sum(axis=1, keepdims=True)
        weight = inside / count - middle / np.where(square > 0, square, 1) * spread
        predicted = np.einsum("nk,nkc->nc", weight, wrench[rows[index]])
        result[rows] = np.where(inside.any(axis=1, keepdims=True), predicted, wrench[rows])
    return result
