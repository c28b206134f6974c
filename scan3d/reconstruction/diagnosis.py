"""The likeliest fault of a recording that contradicts the model.

A fault maps the wrench that the sensor should show to the one that it shows, and what undoes it is an affine map as well: a
matrix for signs, units, gains, exchanged axes and frames, a zero that is taken off, or a rod of another length.  Each fault has
at most six numbers.  They are estimated by least squares of a misfit that vanishes for a right recording, and the fault that
leaves least of it is named, if it leaves little.

The misfit needs no true body.  In the plane it is how far other contacts of a slice lie beyond the tangent at a contact; in
space it is the residuals of six reactions of a single force (S4), and the depth of contacts and tangents in the contacts' hull.
What noise explains is no misfit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

import planar
from scan3d.arrays import Array, Index, Mask
from scan3d.frames import euler_of, wrench_matrix
from scan3d.reconstruction.errors import FORCE_SIGMAS, contact_tolerance, spread, too_light
from scan3d.reconstruction.slices import slices_of
from scan3d.recording import Recording
from scan3d.rods import Rod
from scan3d.spatial import inverse

# A fault is named if its correction removes at least this part of the root mean square misfit.
_EXPLAINS = 0.8
# Faults whose mean square misfits differ by less than this factor cannot be told apart.
_ALIKE = 4.0
# What each estimated number must lower the mean square misfit by, as a factor.
_PER_NUMBER = 2.0
# Mean square misfit that counts as none, and one below which noise hides differences.
_NO_MISFIT, _HIDDEN = 1e-12, 1e-5
# The misfit of a row without a contact, and the largest one that counts, so that single rows do not decide.
_LARGEST = 0.1
# Distance to the tip, in rod lengths, within which a contact counts as one of the tip, which has no tangent, so that the misfit
# does not jump where an estimate deviates by less than its error.
_TIP = 0.02
# Standard deviations that do not count as misfit.
_SIGMAS = 3.0
# Forces below this part of the largest one are rounding of a tare.
_NO_FORCE = 1e-5
# Slices that are compared, rows of each, and rows of a recording in space; and so many of them for a first search.
_COMPARED, _FEW = (5, 120, 250), (3, 60, 120)
# Faults that are refined, starts of each, and evaluations of a refinement.
_REFINED, _STARTS, _EVALUATIONS = 4, 2, 12
# Runs of rows that repeat others of which each is tried.
_RUNS = 60
# A skew that is this part of the mean square misfit is that of a second contact, if nothing else explains it.
_BY_SKEW = 0.5
# Starts of the search: factors of scales, and of the rod's length, in which the misfit is one of steps because contacts near
# the tip count as tip contacts; angles in degrees, and distances in rod lengths.
_SCALES = (0.3, 0.5, 0.7, 0.85, 0.95, 1.05, 1.2, 1.5, 2.0, 3.0)
_LENGTHS = np.linspace(0.7, 1.4, 47)
_ANGLES = (-165, -135, -110, -90, -70, -50, -35, -25, -15, -7, -2, 2, 7, 15, 25, 35, 50, 70, 90, 110, 135, 165)
_TURNS = ((2, 2, 2), (10, 0, 10), (10, 0, -10), (20, 5, 5), (-10, 20, 5), (5, -20, -10))
_DISTANCES = (0.03, 0.1, 0.25, 0.5)
# Turns about the rod in degrees, and offsets along it in rod lengths, that are tried where both are unknown.
_ABOUT_ROD, _ALONG_ROD = tuple(range(-180, 180, 30)), (-0.5, -0.2, 0.0, 0.2, 0.5)
# Largest logarithm of a scale.  With larger ones the noise, which is not scaled, hides any misfit.
_LARGEST_SCALE = 1.4
# Parts of the largest axis of a turn below which the others are not named.
_ABOUT_ONE = 0.15
_CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")
_ABOUT = ("about the clamp's x axis", "about the rod (the clamp's y axis)", "about the clamp's z axis")


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


class _Reactions(NamedTuple):
    """Force and moment (n, 3) at the clamp, dimensionless; those of a planar recording have zeros."""

    force: Array
    moment: Array
    length: float = 1.0
    """The rod's length over the stated one."""
    gain: tuple[float, float] = (1.0, 1.0)
    """What force and moment were multiplied by, and their noise with them."""


class _Undone(NamedTuple):
    """What undoes a fault: the wrench is ``matrix (w - zero)``, the rod is `length` times as long as stated."""

    matrix: Array = np.eye(6)
    zero: Array = np.zeros(6)
    """(6,), or (n, 6) for every row of the recording."""
    length: float = 1.0
    gain: tuple[float, float] = (1.0, 1.0)

    def of(self, wrench: Array, rows: Index) -> _Reactions:
        """The reactions of some rows without the fault, from the wrenches (n, 6) that are recorded."""
        zero = self.zero[rows] if self.zero.ndim == 2 else self.zero
        force, moment = np.hsplit((wrench[rows] - zero) @ self.matrix.T, 2)
        return _Reactions(force, moment, self.length, self.gain)


class _Named(NamedTuple):
    """A fault with its estimated size."""

    code: str
    value: float | None
    unit: str
    message: str


class _Fault(NamedTuple):
    """A fault whose numbers (k,) are to be estimated."""

    starts: Array
    """(s, k) first estimates; k is 0 for a fault without numbers."""
    undone: Callable[[Array], _Undone]
    named: Callable[[Array], _Named]
    cost: int
    """How many numbers it takes from the data."""
    limit: float = np.inf
    """Largest magnitude of a number."""


def diagnose(recording: Recording, model: str) -> Diagnosis:
    """The likeliest fault of a recording that contradicts the model 'planar' or 'spatial'."""
    wrench, rod = np.hstack(recording.reactions(six_axis=model == "spatial")), recording.rod
    noise = recording.noise.of_reactions(rod)
    stuck = _stuck_rows(recording, wrench, noise)
    rows = _Rows(recording, model, wrench, noise, stuck, _COMPARED)
    if not len(rows.rows):
        return _unknown(0.0)
    before = _mean_square(rows.misfit(_Undone().of(wrench, rows.rows)))
    if before <= _NO_MISFIT:
        return _unknown(0.0)
    stuck = _contradicting(stuck, wrench, rows)
    faults = [*_plain(model), *_zeros(recording, model, wrench), *_scales(model)]
    faults += [_stuck(stuck, wrench)] if len(stuck) else []
    faults += _frames(rod, model, wrench[_felt(wrench[:, :3], noise)])
    trials = _searched(faults, wrench, _Rows(recording, model, wrench, noise, stuck, _FEW))
    trials = sorted((_refined(trial, wrench, rows) for trial in trials), key=lambda trial: trial.score)
    likely = [trial for trial in trials if _explains(trial, before) >= _EXPLAINS]
    if not likely:
        best = _explains(trials[0], before) if trials else 0.0
        return _second_contact(rows, wrench, model, best) or _unknown(best)
    first, found = likely[0], likely[0].named
    # a fault of several numbers that contains the best one is no alternative to it
    others: dict[str, _Named] = {}
    hidden = _HIDDEN if max(noise) else _NO_MISFIT
    for trial in likely[1:]:
        other = trial.named
        alike = trial.misfit + hidden < _ALIKE * (first.misfit + hidden)
        simple = trial.fault.cost <= first.fault.cost
        # a frame that nobody stated is as likely as any simpler fault, unless that is one of the frame
        unstated = other.code == "turned-and-moved" and not found.code.startswith(("turned", "moment-not-moved"))
        if alike and other.code != found.code and (simple or unstated):
            others.setdefault(other.code, other)
    message = f"most likely {found.message}"
    if others:
        message = "most likely either " + ", or ".join([found.message, *(other.message for other in others.values())])
    return Diagnosis(found.code, found.value, found.unit, _explains(first, before), message)


def _unknown(explains: float) -> Diagnosis:
    check = "check signs, axes and units, the tare of force and moment, the rod, and that the body is convex"
    return Diagnosis("unknown", None, "", explains, f"no single fault explains the contradiction: {check}")


def _second_contact(rows: _Rows, wrench: Array, model: str, explains: float) -> Diagnosis | None:
    """A second contact, if the moment along the force is most of the misfit and no fault of the rig explains it."""
    if model != "spatial":
        return None
    about_rod, along_force, _ = rows.misfit(_Undone().of(wrench, rows.rows))
    if _mean_square(along_force) <= _BY_SKEW * _mean_square(np.hypot(about_rod, along_force)):
        return None
    fraction = float((along_force > 0).sum() / max(len(along_force), 1))
    return Diagnosis(
        "second-contact",
        100 * fraction,
        "%",
        explains,
        f"most likely either a second contact, or channels that were exchanged or logged at different times: force and moment "
        f"of {100 * fraction:.2g} % of the rows are not those of a single force; look for what else the rod touches",
    )


def _felt(force: Array, noise: tuple[float, float]) -> Mask:
    """(n,) whether forces (n, 3) stand out from the noise and from rounding."""
    size = np.linalg.norm(force, axis=1)
    return np.asarray(size > max(FORCE_SIGMAS * max(noise), _NO_FORCE * float(size.max(initial=0.0))))


def _stuck_rows(recording: Recording, wrench: Array, noise: tuple[float, float]) -> Index:
    """Rows whose reactions under a force repeat those of the row before while the clamp moves, two or more in succession."""
    same = np.zeros(len(recording), dtype=bool)
    same[1:] = (
        (wrench[1:] == wrench[:-1]).all(axis=1)
        & (recording.position_m[1:] != recording.position_m[:-1]).any(axis=1)
        & _felt(wrench[:, :3], noise)[1:]
    )
    run = same.copy()
    run[1:-1] = same[1:-1] & (same[:-2] | same[2:])
    return np.flatnonzero(run)


def _contradicting(stuck: Index, wrench: Array, rows: _Rows) -> Index:
    """Those of the rows that repeat others whose runs contradict the rest: along a flat face right reactions repeat as well."""
    runs = np.split(stuck, np.flatnonzero(np.diff(stuck) > 1) + 1)
    if not len(stuck) or len(runs) > _RUNS:
        return stuck

    def without(some: Index) -> float:
        return _mean_square(rows.misfit(_stuck(some, wrench).undone(np.empty(0)).of(wrench, rows.rows)))

    least = _ALIKE * without(stuck) + _NO_MISFIT
    wrong = [run for run in runs if without(np.setdiff1d(stuck, run)) > least]
    return np.concatenate(wrong) if wrong else stuck


class _Trial(NamedTuple):
    fault: _Fault
    numbers: Array
    misfit: float

    @property
    def score(self) -> float:
        """Mean square misfit with what its numbers cost, as a logarithm."""
        return float(np.log(self.misfit + _NO_MISFIT) + self.fault.cost * np.log(_PER_NUMBER))

    @property
    def named(self) -> _Named:
        return self.fault.named(self.numbers)


def _mean_square(residuals: Array) -> float:
    return float(np.mean(residuals**2))


def _explains(trial: _Trial, before: float) -> float:
    return float(1 - np.sqrt(trial.misfit / before))


def _tried(fault: _Fault, numbers: Array, wrench: Array, rows: _Rows) -> _Trial:
    return _Trial(fault, numbers, _mean_square(rows.misfit(fault.undone(numbers).of(wrench, rows.rows))))


def _searched(faults: list[_Fault], wrench: Array, few: _Rows) -> list[_Trial]:
    """The best faults with numbers, as estimated by few rows, and all faults without numbers."""
    plain = [_Trial(fault, fault.starts[0], np.inf) for fault in faults if not fault.starts.shape[1]]
    rough = []
    for fault in (fault for fault in faults if fault.starts.shape[1]):
        tried = sorted((_tried(fault, start, wrench, few) for start in fault.starts), key=lambda trial: trial.misfit)
        # the misfits of starts between which the right one lies differ little, those of estimates a lot
        rough.append(min((_refined(trial, wrench, few) for trial in tried[:_STARTS]), key=lambda trial: trial.misfit))
    return plain + sorted(rough, key=lambda trial: trial.score)[:_REFINED]


def _refined(trial: _Trial, wrench: Array, rows: _Rows) -> _Trial:
    """The trial with the numbers that these rows are misfits least by."""
    fault = trial.fault
    if not len(trial.numbers):
        return _tried(fault, trial.numbers, wrench, rows)

    def residuals(numbers: Array) -> Array:
        return rows.misfit(fault.undone(numbers).of(wrench, rows.rows)).ravel() / _LARGEST

    bounds = -fault.limit, fault.limit
    found = least_squares(residuals, trial.numbers, bounds=bounds, diff_step=1e-5, max_nfev=_EVALUATIONS)
    return _Trial(fault, np.asarray(found.x), _mean_square(found.fun) * _LARGEST**2)


class _Rows:
    """Rows that stand for a recording, spread evenly, and what their reactions miss the model by."""

    def __init__(
        self,
        recording: Recording,
        model: str,
        wrench: Array,
        noise: tuple[float, float],
        kept: Index,
        count: tuple[int, int, int],
    ) -> None:
        """`count` of slices, rows of a slice, and rows in space, with the rows `kept` among them."""
        slices, in_slice, in_space = count
        self._noise, self._spatial = noise, model == "spatial"
        axes, pressed = recording.axes(), _felt(wrench[:, :3], noise)
        if self._spatial:
            parts = [_with_kept(np.flatnonzero(pressed), in_space, kept)]
        else:
            number, normals, _ = slices_of(recording, axes[:, 2])
            of_slice = [np.flatnonzero(pressed & (number == k)) for k in range(len(normals))]
            numbers = np.array([k for k, rows in enumerate(of_slice) if len(rows)], dtype=np.intp)
            chosen = _with_kept(numbers, slices, np.unique(number[kept[pressed[kept]]]).astype(np.intp))
            parts = [_with_kept(of_slice[k], in_slice, kept) for k in chosen]
        self.rows: Index = np.concatenate([np.empty(0, dtype=np.intp), *parts])
        """(n,) their numbers in the recording."""
        self._parts = np.split(np.arange(len(self.rows)), np.cumsum([len(part) for part in parts])[:-1])
        self._position = recording.position_m[self.rows] / recording.rod.length_m
        self._axes = axes[self.rows]
        self._radius = recording.rod.diameter_m / 2 / recording.rod.length_m

    def misfit(self, reactions: _Reactions) -> Array:
        """Residuals (k, n): angles in radians and distances in rod lengths, 0 where noise explains them.

        One per row in the plane.  In space the moment about the rod and that along the force, both over the clamping moment,
        and the depth in the hull.
        """
        length = reactions.length
        noise = self._noise[0] * reactions.gain[0], self._noise[1] * reactions.gain[1]
        force, moment = reactions.force * length**2, reactions.moment * length
        with np.errstate(all="ignore"):  # a wrong correction may lead to any numbers
            found = (self._in_space if self._spatial else self._in_plane)(force, moment, noise)
        pressed = _felt(force, noise)
        # of rows in contact, reactions that were multiplied cannot have become too small to be felt
        expected = pressed | (reactions.gain != (1.0, 1.0))
        result = np.zeros((len(found.residuals) + 1, len(force)))
        for row, values in zip(result, found.residuals, strict=False):
            row[pressed] = np.clip(np.nan_to_num(values[pressed], nan=_LARGEST), 0.0, _LARGEST)
        result[-1, expected & ~(pressed & found.known)] = _LARGEST
        usable = pressed & found.known
        usable &= ~too_light(found.place, usable)
        point = self._position + length * np.einsum("ni,nij->nj", found.point, self._axes[:, : found.point.shape[1]])
        direction = np.einsum("ni,nij->nj", found.direction, self._axes[:, : found.point.shape[1]])
        place, turn = _SIGMAS * found.place, found.turn
        for part in self._parts:
            rows = part[usable[part]]
            lines = found.lines[rows]
            if self._spatial:
                depth = _depth(point[rows], direction[rows], lines, place[rows], turn[rows])
                result[-1, rows] = np.clip(depth, 0.0, _LARGEST)
            elif lines.any():
                depth = _beyond(point[rows], direction[rows], lines, place[rows], turn[rows])
                result[-1, rows[lines]] = np.clip(depth, 0.0, _LARGEST)
        return result

    def _in_plane(self, force: Array, moment: Array, noise: tuple[float, float]) -> _Contacts:
        reactions = force[:, 0], force[:, 1], moment[:, 2]
        error = planar.errors(*reactions, noise=noise)
        tolerance = np.maximum(contact_tolerance(error), _TIP)
        found = planar.reconstruct(np.zeros(len(force)), *reactions, tolerance=tolerance)
        return _Contacts(
            found.phase != planar.Phase.NONE,
            found.point,
            found.normal,
            found.phase == planar.Phase.TANGENTIAL,
            error.largest,
            np.nan_to_num(_SIGMAS * error.slope, posinf=1.0),
        )

    def _in_space(self, force: Array, moment: Array, noise: tuple[float, float]) -> _Contacts:
        n, noisy = len(force), max(noise) > 0
        error = inverse.errors(force, moment, noise) if noisy else None
        s1, place, turn = (np.zeros(n),) * 3 if error is None else (error.s1, error.largest, _SIGMAS * error.tangent)
        tolerance = np.clip(5 * np.nan_to_num(s1, posinf=0.0), _TIP, 0.5)
        found = inverse.reconstruct(force, moment, tolerance=tolerance, noise=noise if noisy else None)
        f, m, (sigma_f, sigma_m) = np.linalg.norm(force, axis=1), np.hypot(moment[:, 0], moment[:, 2]), noise
        about_rod = np.abs(found.torsion) / m - _SIGMAS * sigma_m / m - self._radius * f / m
        along_force = np.abs(found.skew) / (f * m) - _SIGMAS * np.hypot(sigma_m / m, sigma_f / f)
        lines, known = found.phase == planar.Phase.TANGENTIAL, found.status == inverse.Status.OK
        return _Contacts(known, found.point, found.tangent, lines, place, turn, (about_rod, along_force))


class _Contacts(NamedTuple):
    """Contacts (n,) in the clamps' frames, dimensionless."""

    known: Mask
    point: Array
    direction: Array
    """(n, 2) normals in the plane, (n, 3) tangents in space."""
    lines: Mask
    """Whether they are tangential."""
    place: Array
    """Standard deviations of the places."""
    turn: Array
    """Angles by which noise turns the directions."""
    residuals: tuple[Array, ...] = ()


def _with_kept(rows: Index, count: int, kept: Index) -> Index:
    """At most `count` of the rows, evenly spread, and those of them that are kept."""
    return np.union1d(spread(rows, count), np.intersect1d(rows, kept[:count]))


def _beyond(point: Array, normal: Array, lines: Mask, place: Array, turn: Array) -> Array:
    """How far contacts (n, 3) lie beyond the tangents at those that are `lines`, less their error, for each of these."""
    apart = point - point[lines][:, None]
    beyond = np.einsum("ijk,ik->ij", apart, normal[lines]) - place[lines][:, None] - place
    if turn[lines].any():
        beyond -= turn[lines][:, None] * np.linalg.norm(apart, axis=2)
    return np.asarray(beyond.max(axis=1))


def _depth(point: Array, tangent: Array, lines: Mask, place: Array, turn: Array) -> Array:
    """(n,) depth of contacts (n, 3), and of the tangents of those that are `lines`, in the contacts' hull, less their error."""
    if len(point) < 5:
        return np.zeros(len(point))
    try:
        hull = ConvexHull(point)
    except (QhullError, ValueError):
        return np.full(len(point), _LARGEST)
    outward = hull.equations[:, :3]
    height = -(point @ outward.T + hull.equations[:, 3])
    of_facet = place[hull.simplices].max(axis=1)
    depth: Array = (height - of_facet).min(axis=1) - place
    slope = tangent[lines] @ outward.T
    arm = middle_of_lines(height[lines], slope)
    middle = (height[lines] - arm[:, None] * slope - of_facet).min(axis=1)
    depth[lines] = np.maximum(depth[lines], middle - place[lines] - turn[lines] * np.abs(arm))
    return depth


def middle_of_lines(height: Array, slope: Array) -> Array:
    """(n,) places along lines, in the middle of their part within a hull, or where they are nearest to it.

    `height` (n, f) are the depths of their points below the hull's facets, `slope` (n, f) how fast they fall along the lines.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = height / slope
        first = np.where(slope < 0, crossing, -np.inf).max(axis=1)
        last = np.where(slope > 0, crossing, np.inf).min(axis=1)
        arm = (first + last) / 2
    return np.where(np.isfinite(arm), arm, 0.0)


_NONE = np.empty((1, 0))


def _plain(model: str) -> list[_Fault]:
    """Signs, units and exchanged axes."""
    moments = "moments are" if model == "spatial" else "moment is"
    changes: list[tuple[str, str, tuple[int, ...], float, tuple[float, float]]] = [
        (
            "wrench-sign",
            "the wrench has the opposite sign (that of the rod on the clamp)",
            (0, 1, 2, 3, 4, 5),
            -1,
            (1, 1),
        ),
        ("force-sign", "the forces have the opposite signs", (0, 1, 2), -1, (1, 1)),
        ("fx-sign", "fx has the opposite sign", (0,), -1, (1, 1)),
        ("fy-sign", "fy has the opposite sign", (1,), -1, (1, 1)),
        ("mz-sign", "mz has the opposite sign", (5,), -1, (1, 1)),
        ("force-unit", "the forces are in mN, not in N", (0, 1, 2), 1e-3, (1e-3, 1)),
        ("moment-unit", f"the {moments} in N mm, not in N m", (3, 4, 5), 1e-3, (1, 1e-3)),
    ]
    if model == "spatial":
        changes += [
            ("fz-sign", "fz has the opposite sign", (2,), -1, (1, 1)),
            ("mx-sign", "mx has the opposite sign", (3,), -1, (1, 1)),
            ("left-handed", "the z axis is reversed, as in a left-handed frame", (2, 3, 4), -1, (1, 1)),
        ]
    else:
        changes.append(("fx-mz-sign", "fx and mz have the opposite signs", (0, 5), -1, (1, 1)))
    found = []
    for code, text, channels, factor, gain in changes:
        matrix = np.eye(6)
        matrix[channels, channels] = factor
        found.append(_without_numbers(_Undone(matrix, gain=gain), _Named(code, None, "", text)))
    exchanged = _Undone(np.eye(6)[[1, 0, 2, 3, 4, 5]])
    return [*found, _without_numbers(exchanged, _Named("fx-fy-exchanged", None, "", "fx and fy are exchanged"))]


def _without_numbers(undone: _Undone, named: _Named, cost: int = 0) -> _Fault:
    return _Fault(_NONE, lambda numbers: undone, lambda numbers: named, cost)


def _stuck(stuck: Index, wrench: Array) -> _Fault:
    """Rows that repeat others."""
    zero = np.zeros_like(wrench)
    zero[stuck] = wrench[stuck]
    text = (
        f"sensor or log was stuck: in {len(stuck)} rows force and moment repeat those of the row before though the clamp "
        "moves; leave these rows out"
    )
    return _without_numbers(_Undone(zero=zero), _Named("stick", float(len(stuck)), "rows", text))


def _zeros(recording: Recording, model: str, wrench: Array) -> list[_Fault]:
    """What the sensor shows at the starts of the sweeps, before the rod touches, and that it is not zero."""
    _, first, sweep = np.unique(recording.sweep, return_index=True, return_inverse=True)
    start = wrench[first]
    zero, spread_of = np.median(start, axis=0), np.ptp(np.percentile(start, [2.5, 97.5], axis=0), axis=0)
    linear = np.polynomial.polynomial.polyfit(first, start, min(len(first) - 1, 1))
    steady = np.vander(np.arange(len(wrench)), len(linear), increasing=True) @ linear
    value, unit, text = _of_zero(zero, recording.rod, model)
    untared = _Named(
        "not-tared",
        value,
        unit,
        f"force and moment were not tared: at the starts of the sweeps the sensor shows {text}; let the import take off what "
        "it shows in the air ([tare])",
    )
    value, unit, text = _of_zero(spread_of, recording.rod, model)
    drifts = _Named(
        "drift",
        value,
        unit,
        f"the zero of force and moment drifts from sweep to sweep, in all by {text}: let each sweep begin in the air, and let "
        "the import take off the drift ([tare])",
    )
    return [
        _without_numbers(_Undone(zero=zero), untared),
        _without_numbers(_Undone(zero=steady), drifts, 2),
        _without_numbers(_Undone(zero=start[sweep.reshape(-1)]), drifts, 2),
    ]


def _of_zero(wrench: Array, rod: Rod, model: str) -> tuple[float, str, str]:
    """The size of a zero (6,) that is off, its unit, and its components in words."""
    newton, newton_metres = wrench[:3] * rod.force_unit_N, wrench[3:] * rod.moment_unit_Nm
    shown = (newton, newton_metres) if model == "spatial" else (newton[:2], newton_metres[2:])
    forces, moments = (", ".join(f"{value + 0.0:.2g}" for value in values) for values in shown)
    text = f"({forces}) N and ({moments}) N m"
    if np.linalg.norm(wrench[3:]) > np.linalg.norm(wrench[:3]):
        return float(np.linalg.norm(newton_metres)), "N m", text
    return float(np.linalg.norm(newton)), "N", text


def _scales(model: str) -> list[_Fault]:
    """Wrong stiffness, length and gains, as logarithms of factors by which the reactions or the length are multiplied."""
    check = "check the sensor's gains"
    whole = "the rod is {0:.3g} times as stiff as stated, or force and moment are recorded {0:.3g} times too large (both have "
    gains = [
        ("stiffness", (0, 1, 2, 3, 4, 5), whole + "the same effect): calibrate the stiffness"),
        ("moment-scale", (3, 4, 5), "the moments are recorded {0:.3g} times too large: " + check),
        ("force-scale", (0, 1, 2), "the forces are recorded {0:.3g} times too large: " + check),
    ]
    single = (0, 1, 2, 3, 5) if model == "spatial" else (0, 1)
    gains += [
        (f"{_CHANNELS[k]}-scale", (k,), _CHANNELS[k] + " is recorded {0:.3g} times too large: " + check) for k in single
    ]

    def gain(code: str, channels: tuple[int, ...], text: str) -> _Fault:
        scaled = np.isin(np.arange(6), channels)

        def named(numbers: Array) -> _Named:
            factor = float(np.exp(-numbers[0]))
            return _Named(code, factor, "times", text.format(factor))

        starts = np.log(_SCALES)[:, None]
        return _Fault(starts, lambda n: _Undone(np.diag(np.exp(n[0] * scaled))), named, 1, _LARGEST_SCALE)

    def length(numbers: Array) -> _Named:
        factor = float(np.exp(numbers[0]))
        text = f"the rod is {factor:.3g} times as long as stated: measure its free length"
        return _Named("length", factor, "times", text)

    lengths = np.log(_LENGTHS)[:, None]
    longer = _Fault(lengths, lambda n: _Undone(length=float(np.exp(n[0]))), length, 1, _LARGEST_SCALE)
    return [*(gain(*each) for each in gains), longer]


def _frames(rod: Rod, model: str, felt: Array) -> list[_Fault]:
    """Faults of the sensor's frame: it is turned, its moments refer to a point beside the clamp, or both.

    `felt` (n, 6) are wrenches of rows with a force.
    """

    def of(vector: Array, place: Array) -> _Undone:
        return _Undone(wrench_matrix(Rotation.from_rotvec(vector).as_matrix(), place))

    def turns(axes: Array, starts: Array) -> _Fault:
        """Turns about axes, the rows (k, 3)."""
        return _Fault(starts, lambda n: of(n @ axes, np.zeros(3)), lambda n: _turned(n @ axes), len(axes))

    def beside(count: int) -> _Fault:
        """Places in the clamp's frame, in rod lengths, along its first axes."""
        axes = np.eye(3)[:count]
        starts = np.concatenate([sign * distance * np.eye(count) for distance in _DISTANCES for sign in (-1, 1)])
        return _Fault(starts, lambda n: of(np.zeros(3), n @ axes), lambda n: _beside(n @ axes, rod), count)

    angles = np.radians(_ANGLES)[:, None]
    if model != "spatial":
        return [turns(np.eye(3)[2:], angles), beside(2)]
    about = [turns(np.eye(3)[k : k + 1], angles) for k in range(3)]
    both = _Fault(_frame_starts(felt), lambda n: of(n[:3], n[3:]), lambda n: _turned_and_moved(n[:3], n[3:], rod), 6)
    return [*about, turns(np.eye(3), np.radians(_TURNS)), beside(3), both]


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
        for angle in np.radians(_ABOUT_ROD):
            turn = Rotation.from_rotvec(angle * along_rod) * to_rod
            across = np.cross(turn.apply(sign * arm / size), along_rod)
            starts += [[*turn.as_rotvec(), *(across + along * along_rod)] for along in _ALONG_ROD]
    return np.array(starts)


def _list(values: Array) -> str:
    return "[" + ", ".join(f"{value + 0.0:.3g}" for value in values) + "]"


def _turned(vector: Array) -> _Named:
    axis = int(np.argmax(np.abs(vector)))
    single = bool(np.delete(np.abs(vector), axis).max() <= _ABOUT_ONE * np.abs(vector[axis]))
    euler = np.degrees(vector) if single else euler_of(Rotation.from_rotvec(vector).as_matrix())
    angle = float(np.degrees(vector[axis] if single else np.linalg.norm(vector)))
    where = _ABOUT[axis] if single else "about an axis across several of the clamp's"
    return _Named(
        f"turned-{'xyz'[axis]}" if single else "turned",
        angle,
        "deg",
        f"the sensor is turned by {angle:.3g}° {where}: state euler_deg = {_list(euler)} under [sensor], or calibrate",
    )


def _beside(place: Array, rod: Rod) -> _Named:
    millimetres = 1000 * rod.length_m * place
    distance = float(np.linalg.norm(millimetres))
    return _Named(
        "moment-not-moved",
        distance,
        "mm",
        f"the moment was not moved to the clamp: it refers to a point {distance:.3g} mm from it; state position_mm = "
        f"{_list(millimetres)} under [sensor], or calibrate",
    )


def _turned_and_moved(vector: Array, place: Array, rod: Rod) -> _Named:
    angle = float(np.degrees(np.linalg.norm(vector)))
    millimetres = 1000 * rod.length_m * place
    euler = _list(euler_of(Rotation.from_rotvec(vector).as_matrix()))
    return _Named(
        "turned-and-moved",
        angle,
        "deg",
        f"the sensor is turned by {angle:.3g}°, and its moments refer to a point {np.linalg.norm(millimetres):.3g} mm from the "
        f"clamp: state euler_deg = {euler} and position_mm = {_list(millimetres)} under [sensor], or calibrate",
    )
