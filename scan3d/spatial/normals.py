"""Normals of the body along sweeps, and what one sample alone says about them.

With the derivative ``'`` by the clamp's travel, the rod's material point at the contact slips with ``v = r1' - s1' t1``.

from the path
    ``n ∝ t1 × r1'``: both lie in the body's tangent plane in tangential contact.  Needs no friction law; fails where the
    contact runs along the rod.
from the slip
    ``n ∝ F - (F·v̂) v̂``: isotropic Coulomb friction acts against the slip.  Needs no coefficient of friction, and serves tip and
    tangential contacts.
from the force
    ``n = F/f`` without friction.

The slopes are those of local polynomials.  A window of samples around each sample, shifted inwards at the ends of its run,
determines a polynomial, whose slope at the sample is a weighted sum of the window's values.  Through as many coefficients as
samples it is Lagrange's interpolation in barycentric form; through fewer it is the weighted least-squares fit (Savitzky and
Golay, for samples at any distances).
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from scan3d.arrays import NEGLIGIBLE, ROUNDING, Array, Index, Mask, unit

# Truncation over the change by leaving out a sample at a window's end: on smooth paths it is much smaller, on rough ones up to
# three times as large.
_ROUGH = 3.0
UNKNOWN = 0.1
"""Normals that are less certain, in radians, are unknown: as starts for the fit of a smooth body they would disturb it."""


class Source(IntEnum):
    """Where a normal comes from."""

    UNKNOWN = 0
    SLIP = 1
    PATH = 2
    FORCE = 3


class Track(NamedTuple):
    """Successive contacts (n,) of sweeps, dimensionless, in one frame at rest."""

    sweep: NDArray[np.integer]
    """(n,) number of the sweep; the contacts of a sweep follow each other."""
    row: NDArray[np.integer]
    """(n,) number of the sample: samples without a contact interrupt the path."""
    travel: Array
    """(n,) travel of the clamp."""
    point: Array
    """(n, 3)"""
    s1: Array
    """(n,)"""
    tangent: Array
    """(n, 3)"""
    force: Array
    """(n, 3) contact force on the rod."""
    tangential: Mask
    """(n,)"""
    covariance: Array | None = None
    """(n, 3, 3) of the points; None for exact data."""
    direction_sd: Array | None = None
    """(n,) standard deviation of the directions of force and tangent, in radians; None for exact data."""


class Normals(NamedTuple):
    """Outward normals (n,) along sweeps."""

    normal: Array
    """(n, 3) unit vectors, NaN where unknown."""
    source: NDArray[np.int8]
    """(n,) of `Source`."""
    sd: Array
    """(n,) standard deviation of the normal's angle, in radians, by truncation and noise; infinite where it is unknown."""
    disagreement: Array
    """(n,) angle between the normals from the slip and from the path, NaN where one of them is unknown."""
    disagreement_sd: Array
    """(n,) its standard deviation.  Larger angles are evidence against isotropic Coulomb friction."""
    sticks: Mask
    """(n,) whether the rod's material point rests on the body in a step to or from this sample."""


def along_sweeps(track: Track) -> Normals:
    """Normals from slip and path: at each contact those of the path, unless those of the slip are more certain."""
    n = len(track.row)
    starts, sticks = _runs(track)
    normals = {source: np.full((n, 3), np.nan) for source in (Source.SLIP, Source.PATH)}
    deviation = {source: np.full(n, np.inf) for source in normals}
    for slopes in _slopes(track, starts):
        for source, normal_by in ((Source.SLIP, _from_slip), (Source.PATH, _from_path)):
            normal, second = (normal_by(track, slopes.rows, estimate) for estimate in (slopes.used, slopes.other))
            with np.errstate(divide="ignore", invalid="ignore"):
                sd = _deviation(track, slopes, normal, second, source)
            better = sd < deviation[source][slopes.rows]
            rows = slopes.rows[better]
            normals[source][rows], deviation[source][rows] = normal[better], sd[better]
    slip_sd, path_sd = deviation[Source.SLIP], deviation[Source.PATH]
    # the normal from the slip needs a friction law, that from the path does not
    by_slip = slip_sd < 0.5 * path_sd
    normal = np.where(by_slip[:, None], normals[Source.SLIP], normals[Source.PATH])
    sd = np.where(by_slip, slip_sd, path_sd)
    unknown = ~(sd < UNKNOWN)
    normal[unknown], sd[unknown] = np.nan, np.inf
    chosen = np.where(by_slip, Source.SLIP, Source.PATH).astype(np.int8)
    chosen[unknown] = Source.UNKNOWN
    both = (slip_sd < UNKNOWN) & (path_sd < UNKNOWN)
    return Normals(
        normal,
        chosen,
        sd,
        np.where(both, angles(normals[Source.SLIP], normals[Source.PATH]), np.nan),
        np.where(both, np.hypot(slip_sd, path_sd), np.nan),
        sticks,
    )


def frictionless(beta: Array, beta_sd: Array | float = 0.0) -> bool:
    """Whether the angles β (n,) of tangential contacts say that there is no friction, so that ``n = F/f`` at all contacts."""
    vanishing = np.abs(beta) <= 1e-7 + 5 * np.asarray(beta_sd)
    return len(beta) >= 20 and float(np.mean(vanishing)) >= 0.99


def angles(a: Array, b: Array) -> Array:
    """Angles (n,) between unit vectors (n, 3), with full precision for small ones."""
    return np.asarray(2 * np.arctan2(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1)))


class Windows(NamedTuple):
    """Windows of w samples around some of the samples."""

    rows: Index
    """(k,) the samples whose runs are long enough."""
    members: Index
    """(k, w) the samples of their windows."""
    own: Index
    """(k,) place of the sample in its window."""


def windows(starts: Mask, width: int) -> Windows:
    """Windows of `width` samples within runs; `starts` (n,) marks each run's first sample."""
    n = len(starts)
    first = np.flatnonzero(starts)
    run = np.cumsum(starts) - 1
    begin, end = first[run], np.append(first[1:], n)[run]
    rows = np.flatnonzero(end - begin >= width)
    left = np.clip(rows - width // 2, begin[rows], end[rows] - width)
    return Windows(rows, left[:, None] + np.arange(width), rows - left)


def interpolating(position: Array, own: Index, left_out: Index) -> tuple[Array, Array]:
    """Weights (k, w) of the slope, at the sample `own` (k,), of the polynomial through values at `position` (k, w).

    And those of the polynomial through all values but the one `left_out` (k,), which may be the sample's: it is the polynomial
    through all of them where that value is the one for which their divided difference vanishes.
    """
    k, w = position.shape
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.ptp(position, axis=1)[:, None]
        x = (position - position[:, :1]) / scale
        difference = x[:, :, None] - x[:, None, :]
        difference[:, np.arange(w), np.arange(w)] = 1
        barycentric = 1 / difference.prod(axis=2)  # and the weights of the divided difference
        picked = np.arange(k)
        weights = barycentric / barycentric[picked, own][:, None] / difference[picked, own]
        weights[picked, own] = 0
        weights[picked, own] = -weights.sum(axis=1)
        share = weights[picked, left_out] / barycentric[picked, left_out]
        fewer = weights - share[:, None] * barycentric
        fewer[picked, left_out] = 0
        return weights / scale, fewer / scale


def fitting(position: Array, own: Index, degree: int, weight: Array, values: Array) -> tuple[Array, Array]:
    """Weights (k, w) of the slope of a fitted polynomial, and the fit's misfit (k,).

    The polynomial has a degree below w and is fitted with `weight` (k, w), 1 / variance.  The misfit of the `values` (k, w, c)
    is the sum of their squared deviations, each over its variance, per degree of freedom: about 1 if they are smooth but for
    noise whose variance is that of all c components together.
    """
    k, width = position.shape
    relative = position - position[np.arange(k), own][:, None]
    scale = np.abs(relative).max(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        powers = (relative / scale[:, None])[:, None] ** np.arange(degree + 1)[:, None]
        weighted = powers * (weight / weight.max(axis=1, keepdims=True))[:, None]
        normal = weighted @ powers.transpose(0, 2, 1)
        good = np.isfinite(normal).all(axis=(1, 2))
        normal[~good] = np.eye(degree + 1)
        # a little regularisation: all entries are at most the number of samples
        normal += 1e-14 * np.eye(degree + 1)
        slope = np.zeros((k, degree + 1, 1))
        slope[:, 1] = 1
        solved = np.linalg.solve(normal, np.concatenate([slope, weighted @ values], axis=2))
        result = (solved[:, :, 0][:, None] @ weighted)[:, 0] / scale[:, None]
        residual = ((values - powers.transpose(0, 2, 1) @ solved[:, :, 1:]) ** 2).sum(axis=2)
    result[~good] = np.nan
    return result, np.asarray((weight * residual).sum(axis=1) / max(width - degree - 1, 1))


def _runs(track: Track) -> tuple[Mask, Mask]:
    """(n,) whether a sample starts a run of smooth motion, and whether it sticks."""
    n = len(track.row)
    same = (np.diff(track.sweep) == 0) & (np.diff(track.row) == 1)
    change = np.diff(track.point, axis=0)
    mean = track.tangent[1:] + track.tangent[:-1]
    along = np.where(track.tangential[1:] & track.tangential[:-1], np.diff(track.s1), 0.0)
    step = np.linalg.norm(change, axis=1) + np.abs(along)
    slip = np.linalg.norm(change - along[:, None] * mean / 2, axis=1)
    # a step of a run that is continued: the longer one of its neighbours
    neighbour = np.zeros(max(n - 1, 0))
    if n > 2:
        continued = same[1:] & same[:-1]
        neighbour[1:] = np.where(continued, step[:-1], 0.0)
        neighbour[:-1] = np.maximum(neighbour[:-1], np.where(continued, step[1:], 0.0))
    noise = 0.0
    if track.covariance is not None:
        spread = np.sqrt(np.einsum("nii->n", track.covariance))
        noise = 8 * (spread[1:] + spread[:-1])
    # shorter steps include the quick first slip after touch-down
    snap = step > 4 * neighbour + noise
    snap &= neighbour > 0
    # such a slip is rounding
    stick = same & ~(slip > 1e-7 * np.abs(np.diff(track.travel)))
    smooth = same & ~snap & ~stick & (track.tangential[1:] == track.tangential[:-1])
    starts, sticks = np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
    starts[1:] = ~smooth
    sticks[1:] |= stick
    sticks[:-1] |= stick
    return starts, sticks


class _Slopes(NamedTuple):
    """Two estimates of the slopes at some contacts, which differ by truncation, and the errors of the first."""

    width: int
    """Of the windows."""
    rows: Index
    used: Array
    """(k, 4) derivatives of point and s1."""
    other: Array
    """(k, 4)"""
    rounding: Array
    """(k,) of the derivatives."""
    variance: Array | None = None
    """(k, 3, 3) covariance of the point's derivatives by noise."""
    difference: Array | None = None
    """(k, 3, 3) covariance, by noise, of the difference of both estimates."""


def _slopes(track: Track, starts: Mask) -> Iterator[_Slopes]:
    """Slopes by windows of all widths, in blocks."""
    values = np.column_stack([track.point, track.s1])
    covariance = track.covariance
    # windows for polynomials of a degree; those of a degree higher by two, which alters the slope in a window's middle,
    # show their truncation
    noisy = [(width, degree) for degree in (2, 4) for width in (5, 7, 11, 17, 27, 41) if width > degree + 1]
    for width, degree in [(width, 0) for width in (3, 5, 7, 9)] if covariance is None else noisy:
        every = windows(starts, width)
        for part in np.array_split(np.arange(len(every.rows)), max(1, len(every.rows) // 20_000)):
            rows, members, own = (column[part] for column in every)
            position, nearby = track.travel[members], values[members]
            if covariance is None:
                # without one of the ends; after a transition a sample at an end may be the only one on its piece of the surface
                first = (own == 0) | ((own >= width // 2) & (own < width - 1))
                weights, fewer = interpolating(position, own, np.where(first, 0, width - 1))
                variance = difference = None
            else:
                near = covariance[members]
                weight = 1 / np.maximum(np.einsum("kwii->kw", near), np.finfo(float).tiny)
                weights, misfit = fitting(position, own, degree, weight, nearby[:, :, :3])
                fewer, _ = fitting(position, own, degree + 2, weight, nearby[:, :, :3])
                variance, difference = (np.einsum("kw,kwij->kij", c**2, near) for c in (weights, weights - fewer))
                variance *= np.maximum(misfit, 1.0)[:, None, None]
            used, other = (np.einsum("kw,kwc->kc", c, nearby) for c in (weights, fewer))
            yield _Slopes(width, rows, used, other, ROUNDING * np.abs(weights).sum(axis=1), variance, difference)


def _slip(track: Track, rows: Index, slopes: Array) -> Array:
    """Slip (k, 3) of the rod's material point at the contact; in tip contact it is the tip."""
    along = np.where(track.tangential[rows], slopes[:, 3], 0.0)
    return np.asarray(slopes[:, :3] - along[:, None] * track.tangent[rows])


def _from_slip(track: Track, rows: Index, slopes: Array) -> Array:
    force = track.force[rows]
    normal = force - _along(force, unit(_slip(track, rows, slopes)))
    # in tangential contact the normal is perpendicular to the rod, exactly
    across = normal - _along(normal, track.tangent[rows])
    return unit(np.where(track.tangential[rows, None], across, normal))


def _from_path(track: Track, rows: Index, slopes: Array) -> Array:
    normal = unit(np.cross(track.tangent[rows], slopes[:, :3]))
    outward = np.where((normal * track.force[rows]).sum(axis=1) < 0, -1.0, 1.0)
    outward[~track.tangential[rows]] = np.nan
    return np.asarray(outward[:, None] * normal)


def _deviation(track: Track, slopes: _Slopes, normal: Array, second: Array, source: Source) -> Array:
    """Standard deviation (k,) of the normal's angle: truncation by the second estimate, noise and rounding."""
    rows = slopes.rows
    slip, tangential, force = _slip(track, rows, slopes.used), track.tangential[rows], unit(track.force[rows])
    speed = np.linalg.norm(slip, axis=1)
    direction = slip / speed[:, None]
    sideways = np.cross(normal, direction)
    # in tangential contact errors only turn the normal about the rod
    turn = np.cross(track.tangent[rows], normal)
    cosine = (force * normal).sum(axis=1)
    if source == Source.PATH:
        gain = 1 / np.abs((slopes.used[:, :3] * turn).sum(axis=1))
        gain_sideways = np.zeros(len(rows))
    else:
        gain = np.where(tangential, np.abs((direction * turn).sum(axis=1)), 1.0) / speed
        gain_sideways = np.where(tangential, np.abs((sideways * turn).sum(axis=1)), 1.0) / speed
        gain_sideways *= np.sqrt(np.maximum(1 - cosine**2, 0)) / cosine

    def turned(covariance: Array) -> Array:
        """Variance (k,) of the normal's angle by that of the slopes."""
        inward = np.einsum("ki,kij,kj->k", normal, covariance, normal)
        return np.asarray(
            gain**2 * inward + gain_sideways**2 * np.einsum("ki,kij,kj->k", sideways, covariance, sideways)
        )

    squares = np.nan_to_num(angles(normal, second) ** 2, nan=np.inf)
    # and of the second order, which tells directions from those of rounding alone
    change = slopes.used - slopes.other
    if source == Source.PATH:
        tangent = track.tangent[rows]
        size = np.linalg.norm(np.cross(slopes.used[:, :3], tangent), axis=1)
        relative = np.linalg.norm(np.cross(change[:, :3], tangent), axis=1) / size
    else:
        relative = np.linalg.norm(_slip(track, rows, change), axis=1) / speed
    squares += (_ROUGH * relative**2) ** 2
    if slopes.difference is None:
        squares *= _ROUGH**2
    else:
        squares -= turned(slopes.difference)
    # truncation as it is on average over the window: single contacts may hide it by chance
    own = squares if slopes.difference is None else np.zeros_like(squares)
    large = 1e3  # as which infinite values count
    squares = np.maximum(uniform_filter1d(np.minimum(squares, large), slopes.width, mode="nearest"), own)
    if slopes.variance is not None:
        squares += turned(slopes.variance)
    squares += (slopes.rounding * (gain + gain_sideways)) ** 2 + NEGLIGIBLE**2
    if track.direction_sd is not None:
        squares += (track.direction_sd[rows] / cosine) ** 2
    return np.where((cosine > 0) & np.isfinite(squares), np.sqrt(squares), np.inf)


def _along(vectors: Array, direction: Array) -> Array:
    """The parts (n, 3) of vectors along unit vectors."""
    return np.asarray((vectors * direction).sum(axis=1, keepdims=True) * direction)
