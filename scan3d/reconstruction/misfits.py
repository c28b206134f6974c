"""By how much reactions miss the model of contact, row by row: residuals that vanish for a right recording.

A fault is estimated by the correction that makes these residuals small (`scan3d.reconstruction.diagnosis`).  They need no true
body: contacts of a convex body do not lie beyond each other's tangents, and six reactions of one contact force are consistent.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from scipy.spatial import ConvexHull, QhullError

import planar
from scan3d.arrays import Array, Index, Mask
from scan3d.reconstruction.contacts import FORCE_SIGMAS, errors_in_plane
from scan3d.reconstruction.planes import slices_of
from scan3d.reconstruction.resolution import noise_of
from scan3d.recording import Recording
from scan3d.spatial import inverse
from scan3d.spatial.inverse import errors

# The misfit of a row without a contact, and the largest one that counts.  Larger, single rows decide; smaller, rows that have
# lost their contacts count too little against rows that contradict each other.
LARGEST = 0.1
# Distance to the tip, in rod lengths, within which a contact counts as one of the tip, which has no tangent.  Smaller, the
# misfit jumps where an estimate deviates by less than its error; larger, contacts near the tip say less.
_TIP = 0.02
# Standard deviations that do not count as misfit.
_SIGMAS = 3.0
# Forces below this part of the largest one are rounding of a tare.
_NO_FORCE = 1e-5
# Slices that are compared, and rows of each; rows of a recording in space.
_SLICES, _IN_SLICE, _IN_SPACE = 5, 120, 250
# Parts of them for a first search.
_FEW_SLICES, _FEW_IN_SLICE, _FEW_IN_SPACE = 3, 60, 120


class Reactions(NamedTuple):
    """Reactions of rows (n,) at the clamp, dimensionless; those of a planar recording have zeros."""

    force: Array
    """(n, 3)"""
    moment: Array
    """(n, 3)"""
    length: float = 1.0
    """The rod's length over the stated one."""
    gain: tuple[float, float] = (1.0, 1.0)
    """What force and moment were multiplied by, and their noise with them."""


class Touches(Protocol):
    """The rows of a recording that are compared with the model."""

    rows: Index
    """Numbers (n,) of the rows in the recording."""

    def misfit(self, reactions: Reactions) -> Array:
        """(k,) residuals: angles in radians and distances in rod lengths, 0 where noise explains them."""


def reactions_of(recording: Recording, model: str) -> Reactions:
    """The reactions of all rows of a recording."""
    rod = recording.rod
    if model == "spatial":
        force, moment = recording.wrench()
    else:
        zero = np.zeros(len(recording))
        force, moment = (
            np.column_stack([recording.force_N, zero]),
            np.column_stack([zero, zero, recording.moment_Nm]),
        )
    return Reactions(force / rod.force_unit_N, moment / rod.moment_unit_Nm)


def touches_of(recording: Recording, model: str, kept: Index, *, few: bool = False) -> Touches:
    """Rows that stand for the recording: spread evenly, or `few` of them, with the rows `kept` among them."""
    return (_InSpace if model == "spatial" else _InPlane)(recording, kept, few)


def noise(recording: Recording) -> tuple[float, float]:
    """Standard deviations of each component of force and moment, dimensionless."""
    known, rod = noise_of(recording), recording.rod
    return known.force_N / rod.force_unit_N, known.moment_Nm / rod.moment_unit_Nm


def _with_gain(deviation: tuple[float, float], reactions: Reactions) -> tuple[float, float]:
    """The standard deviations of reactions that were multiplied."""
    return deviation[0] * reactions.gain[0], deviation[1] * reactions.gain[1]


def _rescaled(reactions: Reactions) -> bool:
    """Whether reactions were multiplied: of rows in contact, they cannot have become too small to be felt."""
    return reactions.gain != (1.0, 1.0)


def felt(force: Array, deviation: tuple[float, float]) -> Mask:
    """(n,) whether forces (n, 3) stand out from the noise and from rounding."""
    size = np.linalg.norm(force, axis=1)
    return np.asarray(size > max(FORCE_SIGMAS * max(deviation), _NO_FORCE * float(size.max(initial=0.0))))


def _spread(rows: Index, count: int, kept: Index) -> Index:
    """At most `count` of the rows, evenly spread, and those of them that are kept."""
    some = rows if len(rows) <= count else rows[np.linspace(0, len(rows) - 1, count).astype(np.intp)]
    return np.union1d(some, np.intersect1d(rows, kept[:count]))


class _InPlane:
    """Rows of slices; a misfit is how far other contacts of the slice lie beyond the tangent at a contact."""

    def __init__(self, recording: Recording, kept: Index, few: bool) -> None:
        self._noise = noise(recording)
        axes = recording.axes()
        number, normals, _ = slices_of(recording, axes[:, 2])
        pressed = felt(reactions_of(recording, "planar").force, self._noise)
        of_slice = [np.flatnonzero(pressed & (number == k)) for k in range(len(normals))]
        numbers = np.array([k for k, rows in enumerate(of_slice) if len(rows)], dtype=np.intp)
        chosen = _spread(
            numbers, _FEW_SLICES if few else _SLICES, np.unique(number[kept[pressed[kept]]]).astype(np.intp)
        )
        parts = [_spread(of_slice[k], _FEW_IN_SLICE if few else _IN_SLICE, kept) for k in chosen]
        self.rows: Index = np.concatenate([np.empty(0, dtype=np.intp), *parts])
        self._parts = np.split(np.arange(len(self.rows)), np.cumsum([len(part) for part in parts])[:-1])
        self._position = recording.position_m[self.rows] / recording.rod.length_m
        self._axes = axes[self.rows]

    def misfit(self, reactions: Reactions) -> Array:
        length, noise = reactions.length, _with_gain(self._noise, reactions)
        force, moment = reactions.force * length**2, reactions.moment * length
        fx, fy, mz = force[:, 0], force[:, 1], moment[:, 2]
        with np.errstate(all="ignore"):  # a wrong correction may lead to any numbers
            error = errors_in_plane(fx, fy, mz, *noise)
            found = planar.reconstruct(np.zeros(len(fx)), fx, fy, mz, tolerance=np.maximum(error.tolerance, _TIP))
            turn = np.nan_to_num(_SIGMAS * error.slope, posinf=1.0)
        sure = error.largest < max(4 * float(np.median(error.largest)), 1e-3)
        pressed, known = felt(force, noise), found.phase != planar.Phase.NONE
        point = self._position + length * np.einsum("ni,nij->nj", found.point, self._axes[:, :2])
        normal = np.einsum("ni,nij->nj", found.normal, self._axes[:, :2])
        own = _SIGMAS * error.largest
        result = np.where((pressed | _rescaled(reactions)) & ~(pressed & known), LARGEST, 0.0)
        for part in self._parts:
            usable = part[known[part] & pressed[part] & sure[part]]
            lines = usable[found.phase[usable] == planar.Phase.TANGENTIAL]
            if not len(lines):
                continue
            apart = point[usable] - point[lines][:, None]
            beyond = np.einsum("ijk,ik->ij", apart, normal[lines]) - own[lines][:, None] - own[usable]
            if turn[lines].any():
                beyond -= turn[lines][:, None] * np.linalg.norm(apart, axis=2)
            result[lines] = np.clip(beyond.max(axis=1), 0.0, LARGEST)
        return result


class _InSpace:
    """Rows of six reactions; misfits are their residuals (S4), and depths of contacts and tangents in the contacts' hull."""

    def __init__(self, recording: Recording, kept: Index, few: bool) -> None:
        self._noise = noise(recording)
        pressed = np.flatnonzero(felt(reactions_of(recording, "spatial").force, self._noise))
        self.rows: Index = _spread(pressed, _FEW_IN_SPACE if few else _IN_SPACE, kept)
        self._position = recording.position_m[self.rows] / recording.rod.length_m
        self._axes = recording.axes()[self.rows]
        self._radius = recording.rod.diameter_m / 2 / recording.rod.length_m

    def misfit(self, reactions: Reactions) -> Array:
        length, n = reactions.length, len(self.rows)
        force, moment = reactions.force * length**2, reactions.moment * length
        sigma_f, sigma_m = noise = _with_gain(self._noise, reactions)
        with np.errstate(all="ignore"):  # a wrong correction may lead to any numbers
            error = errors(force, moment, noise) if max(noise) else None
            s1 = np.zeros(n) if error is None else np.nan_to_num(error.s1, posinf=0.0)
            tolerance = np.clip(5 * s1, _TIP, 0.5)
            found = inverse.reconstruct(force, moment, tolerance=tolerance, noise=noise if error else None)
            f, m = np.linalg.norm(force, axis=1), np.hypot(moment[:, 0], moment[:, 2])
            about_rod = np.abs(found.torsion) / m - _SIGMAS * sigma_m / m - self._radius * f / m
            along_force = np.abs(found.skew) / (f * m) - _SIGMAS * np.hypot(sigma_m / m, sigma_f / f)
        pressed, known = felt(force, noise), found.status == inverse.Status.OK
        result = np.zeros((3, n))
        for k, values in enumerate((about_rod, along_force)):
            result[k, pressed] = np.clip(np.nan_to_num(values[pressed], nan=LARGEST), 0.0, LARGEST)
        result[2, (pressed | _rescaled(reactions)) & ~(pressed & known)] = LARGEST
        usable = pressed & known
        place, turn = np.zeros(n), np.zeros(n)
        if error is not None:
            place, turn = _SIGMAS * error.largest, _SIGMAS * error.tangent
            usable &= error.largest < max(4 * float(np.median(error.largest[usable])), 1e-3) if usable.any() else False
        rows = np.flatnonzero(usable)
        point = self._position[rows] + length * np.einsum("ni,nij->nj", found.point[rows], self._axes[rows])
        tangent = np.einsum("ni,nij->nj", found.tangent[rows], self._axes[rows])
        lines = found.phase[rows] == planar.Phase.TANGENTIAL
        result[2, rows] = np.clip(_depth(point, tangent, lines, place[rows], turn[rows]), 0.0, LARGEST)
        return result.ravel()


def _depth(point: Array, tangent: Array, lines: Mask, place: Array, turn: Array) -> Array:
    """(n,) depth of contacts (n, 3), and of the tangents of those that are `lines`, in the contacts' hull, less their error."""
    if len(point) < 5:
        return np.zeros(len(point))
    try:
        hull = ConvexHull(point)
    except (QhullError, ValueError):
        return np.full(len(point), LARGEST)
    outward, offset = hull.equations[:, :3], hull.equations[:, 3]
    height = -(point @ outward.T + offset)
    of_facet = place[hull.simplices].max(axis=1)
    depth: Array = (height - of_facet).min(axis=1) - place
    height = height[lines]
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = tangent[lines] @ outward.T
        crossing = height / slope
        first = np.where(slope < 0, crossing, -np.inf).max(axis=1)
        last = np.where(slope > 0, crossing, np.inf).min(axis=1)
    arm = (first + last) / 2
    arm = np.where(np.isfinite(arm), arm, 0.0)
    middle = (height - arm[:, None] * slope - of_facet).min(axis=1) - place[lines] - turn[lines] * np.abs(arm)
    depth[lines] = np.maximum(depth[lines], middle)
    return depth
