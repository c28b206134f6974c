"""What a sensor's signals say of forces and moments, from touches of the rod at known places.

Each touch has a wrench ``w`` at the clamp, of which six numbers are known: the contact is where it is known to be, the moment
along the rod and along the force vanishes there, and the force is across the rod (no friction), or the arc length of the
contact or the force itself is known as well.  Newton's method finds it, of any rod.  The signals are ``c = c0 + G w`` of the
target channels of w, so that ``G`` and ``c0`` follow by least squares with errors in signals and wrenches (the Gauss-Helmert
model): misclosures ``e = c - c0 - G w`` have the covariance ``V = N + G C Gᵀ`` by the noise N of the signals and the covariance
C of the wrench, and derivatives are taken at wrenches that are adjusted by ``C Gᵀ V⁻¹ e``.  What all touches have in common,
the curvature of the rod and the friction of the pin, are parameters.  The matrix that makes wrenches of signals is
``A = (Gᵀ N⁻¹ G)⁻¹ Gᵀ N⁻¹``; to the first order its error adds ``-A dG w`` to a wrench w, and an error of N adds nothing.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.calibration.references import CHANCE
from scan3d.calibration.report import COVERAGE_FACTOR, Calibration
from scan3d.errors import InputError
from scan3d.recording import CHANNELS, IN_PLANE
from scan3d.rigs import Frame, euler_of, wrench_matrix
from scan3d.rods import Rod
from scan3d.spatial import march
from scan3d.spatial.march import SpatialRod

# Deviation of what is exact, dimensionless, and rounds of an iteration at most.
_EXACT, _ROUNDS, _STEPS = 1e-7, 12, 12
# Change of a wrench, relative to it, that ends the search, and of one on the way.
_FOUND, _ROUGHLY = 1e-8, 1e-3
# Steps in which the rod is bent as far as it is touched.
_PARTS = 8
# Rows beyond one for each touch, from which their scatter tells the noise.
_SCATTER = 20


class Places(NamedTuple):
    """Where the rod is touched (n,), in SI units and the clamp's frame; NaN where it is not known."""

    arc: Array
    """(n,) arc length of the contact from the clamp."""
    point: Array
    """(n, 3) the contact on the rod's centre line, or the centre of the pin."""
    force: Array
    """(n, 3) on the rod."""
    deviation: Array
    """(n,) standard deviation of the arc length and of each coordinate."""
    distance: Array
    """(n,) of the point from the centre line."""

    def of_rod(self, rod: Rod) -> Places:
        """In the units (1)."""
        units = (rod.length_m, rod.length_m, rod.force_unit_N, rod.length_m, rod.length_m)
        return Places(*(column / unit for column, unit in zip(self, units, strict=True)))


class Signals(NamedTuple):
    """The signals of touches (n,)."""

    mean: Array
    """(n, q)"""
    rows: Array
    """(n,) how many of each."""
    spread: Array
    """(n, q) rows less their mean, of all touches, or an empty array."""
    rounding: Array
    """(q,) standard deviation of the rounding."""
    names: tuple[str, ...]


def wrenches(rod: SpatialRod, places: Places, slip: float = 0.0) -> tuple[Array, Array]:
    """The wrenches (n, 6) of touches in EI/L² and EI/L, and their covariances (n, 6, 6); NaN where there is no such rod.

    slip
        the angle between the force and the normal of the rod, where the place alone is known.
    """
    known = np.column_stack([places.arc, places.point, places.force])
    weight = np.isfinite(known) / np.hypot(_EXACT, np.where(np.arange(7) < 4, places.deviation[:, None], 0.0))
    sliding = weight[:, :4].astype(bool).sum(axis=1) + weight[:, 4:].astype(bool).sum(axis=1) < 4
    exact = np.full((len(known), 3), 1 / _EXACT)
    weight, told = np.hstack([weight, exact * [1, 1, 0] + exact * [0, 0, 1] * sliding[:, None]]), np.nan_to_num(known)

    # roughly where the rod is when it is free
    reach = np.where(np.isfinite(places.arc), places.arc, told[:, 2])
    sag = reach**2 / 2 * np.array(rod.curvature[:2])[:, None] * [[-1], [1]]
    free = np.column_stack([told[:, 0], sag[0], told[:, 2], sag[1], np.zeros((len(told), 3))])

    def misclosures(wrench: Array, rows: Index, part: float) -> Array:
        """(b, m, 10) of wrenches (b, m, 6) of some rows over their deviations, of touches that bend the rod by a part."""
        with np.errstate(all="ignore"):
            force, moment = np.split(wrench.reshape(-1, 6).T, 2)
            found = march.contacts(rod, force, moment, steps=_STEPS)
            point, tangent, force = (column.T.reshape(*wrench.shape[:2], 3) for column in found[1:4])
            s1, torsion, skew = (
                column.reshape(*wrench.shape[:2], 1) for column in (found.s1, found.torsion, found.skew)
            )
            along = (force * tangent).sum(axis=2, keepdims=True)
            across = force - along * tangent
            size = np.linalg.norm(across, axis=2, keepdims=True)
            point = point - places.distance[rows, None] * across / size
            less = free[rows] + part * (told - free)[rows]
            columns = [np.concatenate([s1, point, force], axis=2) - less, torsion, skew]
            columns.append(np.arctan2(along, size) - slip)
            return np.asarray(np.concatenate(columns, axis=2) * weight[rows])

    # a cantilever that is hardly bent, and is bent more and more
    with np.errstate(all="ignore"):
        pushed = np.where(weight[:, [4, 6]] > 0, told[:, [4, 6]], 3 * (told - free)[:, [1, 3]] / reach[:, None] ** 3)
    wrench = np.zeros((len(known), 6))
    wrench[:, 0], wrench[:, 1], wrench[:, 2] = -pushed[:, 0], -told[:, 5], -pushed[:, 1]
    wrench[:, 3], wrench[:, 5] = reach * wrench[:, 2], -reach * wrench[:, 0]
    before, even = [wrench / _PARTS / 3, np.zeros_like(wrench), np.zeros_like(wrench)], np.array([-1, 1, -1, -1, 1, -1])
    here, slope, left = np.full((len(known), 10), np.nan), np.zeros((len(known), 10, 6)), np.full(len(known), np.nan)
    for part in np.arange(1, _PARTS + 1) / _PARTS:
        # along the parabola through the three before
        wrench = 3 * before[0] - 3 * before[1] + before[2]
        rows = np.flatnonzero(~(left > _ROUGHLY))
        for _ in range(_ROUNDS):
            now = wrench[rows]
            size = np.maximum(np.linalg.norm(now, axis=1), 1e-3)
            steps = 1e-5 * np.eye(6)[:, None] * size[:, None]
            moved = misclosures(np.concatenate([now[None], now + steps, now - steps]), rows, part)
            here[rows], slope[rows] = moved[0], np.moveaxis((moved[1:7] - moved[7:]) / (2e-5 * size[:, None]), 0, 2)
            good = np.isfinite(moved).all(axis=(0, 2))
            left[rows[~good]], rows, now, size = np.inf, rows[good], now[good], size[good]
            change = -(np.linalg.pinv(slope[rows]) @ here[rows][:, :, None])[:, :, 0]
            change *= np.minimum(1.0, size / (2 * np.maximum(np.linalg.norm(change, axis=1), _EXACT)))[:, None]
            wrench[rows], left[rows] = now + change, np.linalg.norm(change, axis=1) / size
            rows = rows[left[rows] > (_FOUND if part == 1 else _ROUGHLY)]
            if not len(rows):
                break
        # of a rod that is bent to the other side the axial force and the twisting moment are the same
        before = [wrench, before[0], before[1]] if part > 1 / _PARTS else [wrench, 0 * wrench, even * wrench]
    # of what is exact, and of what is known to its deviation
    right = (left <= _FOUND) & (np.abs(here) <= 10).all(axis=1)
    s1 = march.contacts(rod, wrench[:, :3].T, wrench[:, 3:].T, steps=_STEPS).s1
    right &= s1 <= 1 + 10 * (places.deviation + _EXACT)
    normal = np.where(right[:, None, None], slope.transpose(0, 2, 1) @ slope, np.eye(6))
    wrench[~right] = np.nan
    return wrench, np.linalg.inv(normal)


class _Fit(NamedTuple):
    """Signals (n, q) as a linear function of m target channels, whose units are those of the targets."""

    slope: Array
    """(q, m)"""
    offset: Array
    """(q,)"""
    common: Array
    """(e,) what all touches have in common."""
    covariance: Array
    """Of slope, row by row, offset and common parameters."""
    noise: Array
    """(q, q) of a row."""
    noise_freedom: int
    """Degrees of freedom by which the noise was found."""
    chi2: float
    freedom: int


def _fitted(target: Array, spread: Array, common: Array, prior: Array, signals: Signals) -> _Fit:
    """The fit of signals to targets (n, m) with covariances (n, m, m).

    common
        (e, n, m) what a unit of each common parameter adds to the targets, with the standard deviations (e,) that are known
        beforehand; infinite where nothing is.
    """
    mean = signals.mean
    (n, q), m, e = mean.shape, target.shape[1], len(common)
    scale = np.sqrt((target**2).mean(axis=0))
    unit = np.ptp(mean, axis=0)
    y, t = mean / unit, target / scale
    by, spread = common / scale, spread / scale / scale[:, None]
    rows = np.column_stack([t, np.ones(n)])
    # small ones are combinations of channels that the touches do not tell apart
    if np.linalg.svd(rows / np.linalg.norm(rows, axis=0), compute_uv=False)[-1] < 1e-4:
        raise InputError(_TOO_ALIKE)
    first = np.linalg.lstsq(rows, y, rcond=None)[0].T
    theta = np.concatenate([first[:, :m].ravel(), first[:, m], np.zeros(e)])
    scattered = len(signals.spread) - n >= _SCATTER
    floor = 1e-24 * np.eye(q) + np.diag((signals.rounding / unit) ** 2)
    if scattered:
        row_noise = (signals.spread / unit).T @ (signals.spread / unit) / (len(signals.spread) - n)
        noise = row_noise / signals.rows[:, None, None] + floor
    freedom = n * q - q * (m + 1) - int(np.isinf(prior).sum())
    for _ in range(_ROUNDS):
        slope, offset, extra = theta[: q * m].reshape(q, m), theta[q * m : q * (m + 1)], theta[q * (m + 1) :]
        at = t + np.einsum("e,enm->nm", extra, by)
        misclosure = y - offset - at @ slope.T
        if not scattered:
            row_noise = misclosure.T @ misclosure / max(n - m - 1, 1) + floor
            noise = np.broadcast_to(row_noise, (n, q, q))
        carried = spread @ slope.T  # (n, m, q)
        weight = np.linalg.inv(noise + slope @ carried)
        adjusted = at + np.einsum("nmq,nqr,nr->nm", carried, weight, misclosure)
        design = np.concatenate(
            [
                np.einsum("qr,nm->nqrm", np.eye(q), adjusted).reshape(n, q, q * m),
                np.broadcast_to(np.eye(q), (n, q, q)),
                np.einsum("qm,enm->nqe", slope, by),
            ],
            axis=2,
        )
        weighted = np.einsum("nqp,nqr->npr", design, weight)
        normal = np.einsum("npr,nrk->pk", weighted, design)
        right = np.einsum("npr,nr->p", weighted, misclosure)
        held = np.zeros(len(theta))
        held[q * (m + 1) :] = 1 / prior**2
        normal, right = normal + np.diag(held), right - held * theta
        size = np.sqrt(np.diag(normal))
        change = np.linalg.solve(normal / size / size[:, None], right / size) / size
        theta = theta + change
        if (np.abs(change) * size).max() < 1e-6:
            break
    covariance = np.linalg.inv(normal / size / size[:, None]) / size / size[:, None]
    chi2 = float(np.einsum("nq,nqr,nr->", misclosure, weight, misclosure)) / max(freedom, 1)
    back = np.concatenate([(unit[:, None] / scale).ravel(), unit, np.ones(e)])
    theta, covariance = theta * back, covariance * back * back[:, None] * max(chi2, 1.0)
    return _Fit(
        theta[: q * m].reshape(q, m),
        theta[q * m : q * (m + 1)],
        theta[q * (m + 1) :],
        covariance,
        row_noise * unit * unit[:, None],
        len(signals.spread) - n if scattered else max(n - m - 1, 1),
        chi2,
        freedom,
    )


class _Model(NamedTuple):
    """Touches (n,) of a rod, and what their sensor shows."""

    rod: Rod
    places: Places
    touched: Mask
    """(n,) whether the rod is touched, and not free."""
    to_sensor: Array
    """(6, 6) what makes dimensionless wrenches at the clamp those of the sensor, in SI units."""
    used: list[int]
    """The m channels on which the signals depend."""
    signals: Signals
    friction: float

    def wrenches(self, rod: SpatialRod, slip: float = 0.0) -> tuple[Array, Array]:
        """The wrenches (n, 6) of the sensor, and their covariances (n, 6, 6)."""
        n = len(self.touched)
        wrench, covariance, some = np.zeros((n, 6)), np.zeros((n, 6, 6)), np.flatnonzero(self.touched)
        wrench[some], covariance[some] = wrenches(rod, Places(*(column[some] for column in self.places)), slip)
        if (lost := np.flatnonzero(np.isnan(wrench).any(axis=1)) + 1).size:
            which = ", ".join(map(str, lost[:5])) + ", ..." * (len(lost) > 5)
            raise InputError(
                f"no rod of {self.rod.length_m:g} m touches at place {which} of {n}; check the coordinates, which are those "
                "of the clamp's frame with y along the rod, and their units"
            )
        return wrench @ self.to_sensor.T, self.to_sensor @ covariance @ self.to_sensor.T

    def fitted(self, rod: SpatialRod, axes: str = "") -> _Fit:
        """The fit, with the growth of the curvatures about some axes in 1/L."""
        wrench, covariance = self.wrenches(rod)
        steps = [(np.array([axis == "z", axis == "x", False]), 0.0) for axis in axes]
        steps += [(np.zeros(3), 1.0)] * bool(self.friction)
        common, size = np.zeros((len(steps), len(wrench), len(self.used))), 1e-3
        for k, (bend, slip) in enumerate(steps):
            one, other = (
                self.wrenches(_bent(rod, sign * size * bend), sign * size * slip)[0][:, self.used] for sign in (1, -1)
            )
            common[k] = (one - other) / (2 * size)
        prior = np.array([np.inf] * len(axes) + [np.arctan(self.friction)] * bool(self.friction))
        return _fitted(wrench[:, self.used], covariance[:, self.used][:, :, self.used], common, prior, self.signals)


def _bent(rod: SpatialRod, growth: Array) -> SpatialRod:
    """The rod with larger curvatures (3,)."""
    bend_z, bend_x, twist = (rod.curvature + growth).tolist()
    return replace(rod, curvature=(bend_z, bend_x, twist))


def of_signals(
    rod: Rod,
    sensor: Frame,
    channels: tuple[str, ...],
    places: Places,
    signals: Signals,
    *,
    reversed_sign: bool = False,
    friction: float = 0.0,
) -> Calibration:
    """The matrix and the offset of a sensor, and the curvature of its rod, from touches at known places.

    sensor
        its frame in the clamp's.
    channels
        forces and moments in that frame; empty: all that the touches have.
    reversed_sign
        whether the sensor shows the action of the rod on the clamp.
    friction
        standard deviation of the coefficient of friction where the place alone is known; it is alike in all touches.

    Raises InputError for touches where no rod is, or which do not determine the channels.
    """
    units, spatial, n = np.repeat([rod.force_unit_N, rod.moment_unit_Nm], 3), rod.in_space(), len(places.arc)
    to_sensor = np.linalg.inv(wrench_matrix(sensor.turn, sensor.position_m)) * units * (-1 if reversed_sign else 1)
    touched = np.asarray(np.isfinite(np.column_stack([places.arc, places.point, places.force])).any(axis=1))
    model = _Model(rod, places.of_rod(rod), touched, to_sensor, [], signals, friction)
    wrench = model.wrenches(spatial)[0]
    planar = not np.nan_to_num(np.stack([places.point[:, 2], places.force[:, 2]])).any()
    told = [CHANNELS.index(name) for name in channels] or ([*IN_PLANE] if planar else list(range(6)))
    size = np.abs(wrench).max(axis=0)
    # a straight rod has no moment about itself, whatever touches it
    still = [k for k in told if size[k] <= 1e-6 * size[k // 3 * 3 :][:3].max()]
    if [k for k in still if k != MY] or (MY in still and not sensor.trivial):
        raise InputError(
            f"the touches have no {', '.join(CHANNELS[k] for k in still)}; touch the rod from other sides as well, or leave "
            f"{'it' if len(still) == 1 else 'them'} out of channels under [sensor]"
        )
    used = [k for k in told if k not in still]
    needed = ", ".join(CHANNELS[k] for k in used)
    if len(signals.names) < len(used):
        raise InputError(
            f"{len(signals.names)} signals do not determine {len(used)} channels, {needed}; state those that the sensor "
            "measures as channels under [sensor]"
        )
    if n < len(used) + 2:
        raise InputError(
            f"{n} touches do not determine {needed} with deviations; touch at {len(used) + 2} places at least, of which one "
            "may be in the air"
        )
    model = model._replace(used=used)
    fit, axes, found = model.fitted(spatial), "z" if planar else "zx", ""
    bent, q, m = model.fitted(spatial, axes), len(signals.names), len(used)
    first, count = q * (m + 1), len(axes)
    of_bend = np.sqrt(bent.covariance.diagonal()[first : first + count])
    if (np.abs(bent.common[:count]) > CHANCE * of_bend).any():
        for _ in range(_TIMES):
            spatial = _bent(spatial, np.pad(bent.common[:count], (0, 3 - count)))
            if still and len(signals.names) >= len(told):  # a curved rod has a moment about itself
                used, still = told, []
                model = model._replace(used=used)
            bent = model.fitted(spatial, axes)
        fit, found = bent, axes
        bend_z, bend_x, twist = (part / rod.length_m for part in spatial.curvature)
        rod = replace(rod, curvature_per_m=(bend_z, bend_x, twist) if bend_x or twist else bend_z)
    return _calibration(rod, sensor, told, used, found, signals, fit)


def _calibration(
    rod: Rod, sensor: Frame, told: list[int], used: list[int], bends: str, signals: Signals, fit: _Fit
) -> Calibration:
    """What a fit says of the m used channels of those that are told."""
    (q, m), names = fit.slope.shape, [CHANNELS[k] for k in used]
    weight = np.linalg.pinv(fit.noise, hermitian=True)
    own = np.linalg.inv(fit.slope.T @ weight @ fit.slope)
    matrix = own @ fit.slope.T @ weight
    rest = weight @ (np.eye(q) - fit.slope @ matrix)
    by_slope = -np.einsum("iq,jr->irqj", matrix, matrix) + np.einsum("ij,qr->irqj", own, rest)
    mixing = np.zeros((36, fit.slope.size))
    mixing[[6 * i + j for i in used for j in used]] = -np.einsum("iq,jk->ijqk", matrix, np.eye(m)).reshape(m * m, -1)
    first, curved = q * (m + 1), len(bends)
    by = np.zeros((curved + q + m * q, len(fit.covariance)))
    by[:curved, first : first + curved] = np.eye(curved) / rod.length_m
    by[curved : curved + q, q * m : first] = np.eye(q)
    by[curved + q :, : q * m] = by_slope.reshape(m * q, -1)
    covariance = by @ fit.covariance @ by.T
    with_all = np.pad(mixing, ((0, 0), (0, len(fit.covariance) - q * m))) @ fit.covariance
    gains = np.hstack([with_all[:, : q * m] @ mixing.T, with_all @ by.T])
    # Of more signals than channels the weights have the error of the noise, of Wishart's distribution.  It moves the matrix
    # between those that make the same wrenches.
    covariance[curved + q :, curved + q :] += np.kron(own, rest) / fit.noise_freedom
    deviations = np.sqrt(covariance.diagonal())
    row = np.sqrt(np.abs(fit.noise.diagonal()))
    span, reach = np.ptp(signals.mean, axis=0), np.abs(matrix @ (signals.mean - fit.offset).T).max(axis=1)
    limits = np.concatenate([[0.02 / rod.length_m] * curved, row, (0.01 * reach[:, None] / span).ravel()])
    noise = np.sqrt((matrix @ fit.noise @ matrix.T).diagonal())
    forces, moments = (
        [sd for k, sd in zip(used, noise, strict=True) if (k < 3) == is_force] for is_force in (True, False)
    )
    whole = np.zeros((len(told), q))
    whole[[told.index(k) for k in used]] = matrix
    sentences = []
    if fit.chi2 > 1 + CHANCE * np.sqrt(2 / max(fit.freedom, 1)):
        sentences.append(
            f"The signals deviate from a linear function of {', '.join(names)} by {np.sqrt(fit.chi2):.3g} times what noise and "
            "the places explain, and all deviations are enlarged by as much: check the places and the rod, and whether the "
            "sensor shows other channels as well."
        )
    if MY in told and MY not in used:
        sentences.append("The row of my is zero: a straight rod has no moment about itself, which no touch can change.")
    curvatures = [rod.curvatures["zx".index(axis)] for axis in bends]
    return Calibration(
        rod=rod,
        sensor_position_m=sensor.position_m,
        sensor_euler_deg=euler_of(sensor.turn),
        clamp_position_m=np.zeros(3),
        clamp_euler_deg=np.zeros(3),
        tare=np.zeros(6),
        drift=np.zeros(6),
        names=(
            *(f"curvature_{axis}_per_m" for axis in bends),
            *(f"offset_{name}" for name in signals.names),
            *(f"matrix_{channel}_{name}" for channel in names for name in signals.names),
        ),
        values=np.concatenate([curvatures, fit.offset, matrix.ravel()]),
        standard_deviations=deviations,
        covariance=covariance,
        well=tuple(map(bool, COVERAGE_FACTOR * deviations <= limits)),
        sentences=tuple(sentences),
        chi2=fit.chi2,
        consistency=fit.chi2,
        freedom=fit.freedom,
        pose_noise_m=0.0,
        noise_force_N=max(forces, default=0.0),
        noise_moment_Nm=max(moments, default=0.0),
        details={"touches": len(signals.mean), "rows": int(signals.rows.sum())},
        gains_covariance=gains,
        matrix=whole,
        offset=fit.offset,
        channels=tuple(CHANNELS[k] for k in told),
    )


MY = CHANNELS.index("my")
# Rounds in which a curvature is found, each from the one before.
_TIMES = 3
_TOO_ALIKE = (
    "the touches do not tell the channels apart: touch at several distances from the clamp, from several sides, and with small "
    "and large bends, or state fewer channels under [sensor]"
)
