"""Step 2 in space: from the six support reactions back to the contact, whatever the friction and its direction.

Without a contact moment the moment along the rod obeys ``M'' = (F·t) M`` with a scalar coefficient, so that it keeps the
direction of the clamping moment: the rod bends in the plane normal to ``m0``, which contains ``t0`` and the contact force.
In that plane the rod is the one of `planar.elastica`.  Six reactions determine four unknowns, and leave two residuals:
``m0·t0`` and ``m0·f0`` vanish for a single force at the centre line of a rod that bends alike in all directions.

In contrast to the plane the angle ``β`` may be negative: friction may pull the rod out along itself.

Errors of the reactions carry over to the first order.  In the bending plane the derivatives are those of `planar.jacobian`.
Across it the plane's angle ω follows from the moment with the standard deviation ``σ_m/|m0|`` and from the force across the rod
with ``σ_f/|f0⊥|``, together with the weights of `bending_direction`.  Equal errors in all directions make both parts
independent of each other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import planar
from planar.arrays import BLOCK
from planar.elastica import bend_by_half_angle
from scan3d.arrays import Array, Index, Mask
from scan3d.spatial import march
from scan3d.spatial.march import SpatialRod

# Reactions between this and its inverse have squares and products that are numbers; rows beyond are scaled first.
_SAFE = 1e-75
PAST_TIP = 0.999
"""Tolerance with which contacts that errors put past the tip by nearly the rod's length have a place as well."""
# Relative step of the differences by which errors of any rod carry over.
_DIFFERENCE = 3e-4


class Status(IntEnum):
    """Whether a row of reactions gives a contact, and if not, why; `sentence` explains it."""

    OK = 0
    NO_FORCE = 1
    NO_MOMENT = 2
    NO_ROD = 3
    BEYOND_TIP = 4

    @property
    def sentence(self) -> str:
        return _SENTENCES[self]


_SENTENCES = {
    Status.OK: "a contact",
    Status.NO_FORCE: "nothing touches: there is no force, or a value is missing or infinite",
    Status.NO_MOMENT: "the force has no moment that bends the rod: the rod is straight, and its bending plane and the place of "
    "the contact along it are unknown",
    Status.NO_ROD: "no rod has these reactions: the moment is more than the force can hold, or the force pulls along the rod",
    Status.BEYOND_TIP: "the contact would lie past the rod's tip",
}


@dataclass(frozen=True)
class SpatialContacts:
    """Contacts (n,) from six support reactions, dimensionless, in the clamp's frame; NaN where the status is not OK."""

    point: Array
    """(n, 3) point of the rod's centre line at the contact, relative to the clamp."""
    s1: Array
    """(n,) contact along the rod."""
    tangent: Array
    """(n, 3) unit tangent of the rod there, towards its tip."""
    force: Array
    """(n, 3) contact force F on the rod, the support reaction's opposite; known in all rows with a force."""
    bending: Array
    """(n, 3) unit vector ``e`` across the undeformed rod, to the side to which the rod bends."""
    q: Array
    """(n,) ``|m0| / (2 √f)``."""
    phase: NDArray[np.int8]
    """(n,) of `planar.Phase`; NONE where the status is not OK."""
    status: NDArray[np.int8]
    """(n,) of `Status`."""
    torsion: Array
    """(n,) residual ``m0·t0``: the moment about the rod's axis, zero for a thin rod; known in all rows.  Of rods that do not
    bend in a plane it is the moment about the rod at the contact."""
    skew: Array
    """(n,) residual ``m0·f0``: zero for any single contact force; known in all rows.  Of rods that do not bend in a plane it is
    ``e·F`` with the moment e at the contact."""
    in_plane: bool = True
    """Whether the rods are straight, uniform and weightless, so that each bends in a plane."""

    def __len__(self) -> int:
        return len(self.s1)

    def rows(self, rows: Index) -> SpatialContacts:
        """The contacts of some rows."""
        columns: dict[str, Any] = {
            name: column[rows] for name, column in vars(self).items() if isinstance(column, np.ndarray)
        }
        return replace(self, **columns)

    @property
    def bending_angle(self) -> Array:
        """(n,) angle ω from the plane of the sweep to the bending plane, ``e = (cos ω, 0, sin ω)``."""
        return np.arctan2(self.bending[:, 2], self.bending[:, 0])

    @property
    def force_angle(self) -> Array:
        """(n,) direction α of the contact force in the bending plane: ``f (sin α e - cos α t0)``."""
        return np.arctan2(_dot(self.force, self.bending), -self.force[:, 1])

    @property
    def friction_angle_bound(self) -> Array:
        """(n,) angle β with ``F·t1 = f sin β``: friction angles are at least ``|β|``, and β may be negative."""
        if not self.in_plane:
            along = _dot(self.force, self.tangent)
            return np.asarray(np.arctan2(along, np.linalg.norm(np.cross(self.force, self.tangent), axis=1)))
        across = _dot(self.force, self.bending)
        slope = _dot(self.tangent, self.bending)
        along_rod = across * slope + self.force[:, 1] * self.tangent[:, 1]
        return np.arctan2(along_rod, across * self.tangent[:, 1] - self.force[:, 1] * slope)


def reconstruct(
    force: ArrayLike,
    moment: ArrayLike,
    *,
    tolerance: ArrayLike = planar.TOLERANCE,
    noise: tuple[float, float] | None = None,
    rod: SpatialRod | None = None,
    gravity: ArrayLike | None = None,
    steps: int | None = None,
) -> SpatialContacts:
    """Contacts from support reactions ``f0`` and clamping moments ``m0`` (n, 3) in the clamp's frame.

    tolerance
        differences of s1 to the tip that count as zero, one number or (n,): ``s1 < 1 - tolerance`` is tangential contact.
    noise
        standard deviations of each component of force and moment.  The bending plane is then that of the weighted total least
        squares of both lines in it, the force and the normal of the moment; without noise it is that of the moment.
    rod, gravity
        another rod than the straight, uniform, weightless one, and for a rod with weight unit vectors (n, 3) of gravity in the
        clamp's frame; its reactions are the whole ones.  Then `bending` is the direction across the clamp's moment, and
        `noise` is not used.
    steps
        along such a rod; as many as make places right to 1e-10 by default.

    `status` says why a row has no contact.  Raises ValueError for arrays of other shapes and for a tolerance or noise out of
    range.
    """
    f0, m0 = _checked("force", force), _checked("moment", moment)
    if f0.shape != m0.shape:
        raise ValueError(f"force and moment must have one shape (n, 3), got {f0.shape} and {m0.shape}")
    zero = np.asarray(tolerance, dtype=float)
    if zero.shape not in ((), (len(f0),)) or not ((zero >= 0) & (zero < 1)).all():
        raise ValueError("tolerance must be one number between 0 and 1, or one for each row")
    if noise is not None:
        noise = float(noise[0]), float(noise[1])
        if not all(0 <= deviation < np.inf for deviation in noise):
            raise ValueError(f"noise must be two standard deviations >= 0, got {noise}")
        noise = noise if max(noise) > 0 else None
    if rod is not None and not rod.is_straight_and_uniform:
        return _marched(rod, f0, m0, zero, None if gravity is None else np.asarray(gravity, dtype=float), steps)
    contacts = _empty(len(f0))
    np.negative(f0, out=contacts.force)
    with np.errstate(all="ignore"):
        for first in range(0, len(f0), BLOCK):
            rows = slice(first, first + BLOCK)
            _fill(contacts, rows, f0[rows].T, m0[rows].T, zero[rows] if zero.ndim else zero, noise)
    return contacts


def _marched(
    rod: SpatialRod, f0: Array, m0: Array, zero: Array, gravity: Array | None, steps: int | None
) -> SpatialContacts:
    """`reconstruct` for rods that do not bend in a plane."""
    found = march.contacts(rod, f0.T, m0.T, None if gravity is None else gravity.T, steps)
    with np.errstate(all="ignore"):
        ex, ez, m = _normalised(m0[:, 2], -m0[:, 0])
        f = np.linalg.norm(found.force, axis=0)
        q = m / (2 * np.sqrt(f))
    known = np.isfinite(found.s1)
    valid = known & (found.s1 <= 1 + zero)
    tangential = valid & (found.s1 < 1 - zero)
    status = np.full(len(f0), Status.OK, dtype=np.int8)
    status[known & ~valid] = Status.BEYOND_TIP
    status[~known] = Status.NO_ROD
    status[~(f > 0) | ~np.isfinite(m0).all(axis=1)] = Status.NO_FORCE
    columns = [found.point.T, found.s1, found.tangent.T, np.stack([ex, 0 * ex, ez], axis=1), q]
    for column in columns:
        column[~valid] = np.nan
    phase = planar.Phase.TANGENTIAL * tangential.astype(np.int8) + planar.Phase.TIP * (valid & ~tangential).astype(
        np.int8
    )
    point, s1, tangent, bending, q = columns
    return SpatialContacts(
        point, s1, tangent, found.force.T, bending, q, phase, status, found.torsion, found.skew, in_plane=False
    )


def bending_direction(f0: Array, m0: Array, noise: tuple[float, float]) -> tuple[Array, Array]:
    """x and z of ``e`` by the weighted total least squares of force and moment (3, n) across the rod.

    Both ``f0⊥`` and ``m0 × t0`` lie along ``±e``.  The direction with the least sum of squared deviations, each over its
    standard deviation, is the first principal axis of the two weighted vectors; the moment decides its sign.
    """
    # weights 1/σ, times both σ, so that either may vanish
    vectors = [(f0[0] * noise[1], f0[2] * noise[1]), (m0[2] * noise[0], -m0[0] * noise[0])]
    double_x = sum(x * x - z * z for x, z in vectors)
    double_z = sum(2 * x * z for x, z in vectors)
    size = np.hypot(double_x, double_z)
    larger = np.sqrt((size + np.abs(double_x)) / (2 * size))
    smaller = np.abs(double_z) / (2 * size * larger)
    x, z = np.where(double_x >= 0, [larger, smaller], [smaller, larger])
    z = np.copysign(z, double_z)
    sign = np.where(x * m0[2] - z * m0[0] < 0, -1.0, 1.0)
    return sign * x, sign * z


class SpatialErrors(NamedTuple):
    """Standard deviations (n,) and covariances of what six reactions give, dimensionless; infinite where there is no rod."""

    point: Array
    """(n, 3, 3) covariance of the contact's place in the clamp's frame."""
    largest: Array
    """(n,) standard deviation of the place in its least certain direction."""
    s1: Array
    """(n,)"""
    beta: Array
    """(n,) of the angle β."""
    tangent: Array
    """(n,) of the tangent: root of the mean square angle, in radians."""
    plane: Array
    """(n,) of the bending plane's angle ω, in radians."""
    force: Array
    """(n,) of the direction of the force: root of the mean square angle, in radians."""


def errors(
    f0: Array,
    m0: Array,
    noise: tuple[float, float],
    *,
    rod: SpatialRod | None = None,
    gravity: Array | None = None,
) -> SpatialErrors:
    """Errors of the contacts that `reconstruct` finds for reactions (n, 3), by the noise of force and moment."""
    if rod is not None and not rod.is_straight_and_uniform:
        return _errors_by_differences(rod, f0, m0, noise, gravity)
    sigma_f, sigma_m = noise
    with np.errstate(all="ignore"):  # rows without a force have no errors that are numbers
        # exact reactions, of rods whose poses alone are noisy, give the same direction with any weights
        ex, ez = bending_direction(f0.T, m0.T, noise if max(noise) else (1.0, 1.0))
        m, f0e = m0[:, 2] * ex - m0[:, 0] * ez, f0[:, 0] * ex + f0[:, 2] * ez
        slopes = planar.jacobian(f0e, f0[:, 1], m) * [sigma_f, sigma_f, sigma_m]
        angle = 1 / np.sqrt((m / sigma_m) ** 2 + (f0e / sigma_f) ** 2)
        x, y, s1, alpha, beta = (slopes[:, k] for k in range(5))
        found = reconstruct(f0, m0, noise=noise, tolerance=PAST_TIP)
        zero = np.zeros_like(ex)
        across, normal = np.stack([ex, zero, ez], axis=1), np.stack([-ez, zero, ex], axis=1)
        place = across[:, :, None] * x[:, None, :]
        place[:, 1] += y
        sideways = ((found.point * across).sum(axis=1) * angle)[:, None] * normal
        point = place @ place.transpose(0, 2, 1) + sideways[:, :, None] * sideways[:, None, :]
        sideways_turn = (found.tangent * across).sum(axis=1) * angle
        tangent = np.sqrt(((alpha - beta) ** 2).sum(axis=1) + sideways_turn**2)
        s1_sd, beta_sd = (np.linalg.norm(row, axis=1) for row in (s1, beta))
        force = sigma_f * np.sqrt(2) / np.linalg.norm(f0, axis=1)
        known = np.isfinite(point).all(axis=(1, 2)) & np.isfinite(tangent)
        largest = np.full(len(m), np.inf)
        largest[known] = np.sqrt(np.maximum(np.linalg.eigvalsh(point[known])[:, 2], 0.0))

    def certain(values: Array) -> Array:
        return np.where(known & np.isfinite(values), values, np.inf)

    point[~known] = np.inf
    return SpatialErrors(point, largest, *(certain(value) for value in (s1_sd, beta_sd, tangent, angle, force)))


def _errors_by_differences(
    rod: SpatialRod, f0: Array, m0: Array, noise: tuple[float, float], gravity: Array | None
) -> SpatialErrors:
    """`errors` of rods that do not bend in a plane, by central differences of their contacts."""
    down = None if gravity is None else gravity.T
    size = np.repeat([np.linalg.norm(f0, axis=1), np.linalg.norm(m0, axis=1)], 3, axis=0)
    reactions = np.concatenate([f0.T, m0.T])
    with np.errstate(all="ignore"):
        step, n = _DIFFERENCE * np.eye(6)[:, :, None] * size, len(f0)
        moved = np.stack([reactions - step, reactions + step]).transpose(2, 0, 1, 3).reshape(6, -1)
        found = march.contacts(rod, moved[:3], moved[3:], None if down is None else np.tile(down, 12))
        along = (found.force * found.tangent).sum(axis=0) / np.linalg.norm(found.force, axis=0)
        ends = np.concatenate([found.point, found.tangent, found.s1[None], np.arcsin(along)[None]]).reshape(8, 2, 6, n)
        rate = (ends[:, 1] - ends[:, 0]) / (2 * _DIFFERENCE * size) * np.repeat(noise, 3)[:, None]
        slope = np.moveaxis(rate, 1, 2)  # of place, tangent, s1 and β (8, n, 6)
        point = np.einsum("ink,jnk->nij", slope[:3], slope[:3])
        tangent, s1, beta = (np.sqrt((part**2).sum(axis=(0, 2))) for part in (slope[3:6], slope[6:7], slope[7:]))
        across_f, across_m = (np.hypot(v[:, 0], v[:, 2]) for v in (f0, m0))
        plane = 1 / np.sqrt((across_m / noise[1]) ** 2 + (across_f / noise[0]) ** 2)
        force = noise[0] * np.sqrt(2) / size[0]
    known = np.isfinite(slope).all(axis=(0, 2))
    point[~known] = np.inf
    largest = np.full(len(f0), np.inf)
    largest[known] = np.sqrt(np.maximum(np.linalg.eigvalsh(point[known])[:, 2], 0.0))
    return SpatialErrors(point, largest, *(np.where(known, v, np.inf) for v in (s1, beta, tangent, plane, force)))


def _fill(
    contacts: SpatialContacts, rows: slice, f0: Array, m0: Array, zero: Array, noise: tuple[float, float] | None
) -> None:
    """Write the contacts of one block, given by its reactions (3, n)."""
    contacts.torsion[rows] = m0[1]
    contacts.skew[rows] = f0[0] * m0[0] + f0[1] * m0[1] + f0[2] * m0[2]
    ex, ez, m = _normalised(m0[2], -m0[0])
    if noise is not None:
        x, z = bending_direction(f0, m0, noise)
        known = np.isfinite(x)
        ex, ez = np.where(known, x, ex), np.where(known, z, ez)
        m = m0[2] * ex - m0[0] * ez
    f0e = f0[0] * ex + f0[2] * ez
    cos_alpha, sin_alpha, f = _normalised(f0[1], -f0e)
    root = np.sqrt(f)
    q = m / (2 * root)
    # sine and cosine of α/2, the larger one first
    larger = np.sqrt((1 + np.abs(cos_alpha)) / 2)
    smaller = sin_alpha / (2 * larger)
    s, c = smaller, larger
    backward = cos_alpha < 0
    if backward.any():
        s = np.where(backward, np.copysign(larger, sin_alpha), smaller)
        c = np.where(backward, np.abs(smaller), larger)
    shape = bend_by_half_angle(s, c, q)[0]
    s1 = shape.length / root
    tip_distance = 1 - s1
    valid = (tip_distance >= -zero) & (q > 0)
    valid &= np.isfinite(shape.x)
    tangential = tip_distance > zero
    tangential &= valid

    # k and k' are sine and cosine of β/2 + π/4
    m_k, complement = s * s + q * q, c * c - q * q
    sin_beta, cos_beta = m_k - complement, 2 * np.sqrt(m_k * complement)
    slope = cos_alpha * cos_beta + sin_alpha * sin_beta
    across = shape.x / root
    contacts.point[rows, 0], contacts.point[rows, 2] = across * ex, across * ez
    np.divide(shape.y, root, out=contacts.point[rows, 1])
    contacts.tangent[rows, 0], contacts.tangent[rows, 2] = slope * ex, slope * ez
    np.subtract(sin_alpha * cos_beta, cos_alpha * sin_beta, out=contacts.tangent[rows, 1])
    contacts.bending[rows, 0], contacts.bending[rows, 2] = ex, ez
    contacts.s1[rows], contacts.q[rows] = s1, q
    contacts.phase[rows] = planar.Phase.TANGENTIAL * tangential.view(np.int8) + planar.Phase.TIP * (
        valid & ~tangential
    ).view(np.int8)
    if not valid.all():
        _reject(contacts, rows, ~valid, f0, m0, (q, complement))


def _reject(
    contacts: SpatialContacts, rows: slice, invalid: Mask, f0: Array, m0: Array, rod: tuple[Array, Array]
) -> None:
    """Give invalid rows the reason as their status and NaN as their values; the last reason that applies counts."""
    q, complement = rod
    status = np.full(len(invalid), Status.BEYOND_TIP, dtype=np.int8)
    # a force beyond α = π/2 has a rod whose length may be infinite
    status[(complement <= 0) | ~np.isfinite(q)] = Status.NO_ROD
    status[(m0[0] == 0) & (m0[2] == 0)] = Status.NO_MOMENT
    present = np.isfinite(f0).all(axis=0) & np.isfinite(m0).all(axis=0)
    status[~present | (f0 == 0).all(axis=0)] = Status.NO_FORCE
    contacts.status[rows][invalid] = status[invalid]
    for column in (contacts.point, contacts.s1, contacts.tangent, contacts.bending, contacts.q):
        column[rows][invalid] = np.nan


def _normalised(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Vectors (n,) scaled to unit length, and their lengths; NaN without a direction."""
    size = np.sqrt(x * x + y * y)
    odd = ~((size > _SAFE) & (size < 1 / _SAFE))
    if odd.any():
        largest = np.maximum(np.abs(x[odd]), np.abs(y[odd]))
        cosine, sine = x.copy(), y.copy()
        cosine[odd] /= largest
        sine[odd] /= largest
        length = np.sqrt(cosine[odd] ** 2 + sine[odd] ** 2)
        size[odd] = length
        cosine, sine = cosine / size, sine / size
        size[odd] = length * largest
        size[odd & (x == 0) & (y == 0)] = 0.0
        return cosine, sine, size
    inverse = 1 / size
    return x * inverse, y * inverse, size


def _empty(n: int) -> SpatialContacts:
    def vectors() -> Array:
        return np.zeros((3, n)).T  # each component in one piece

    return SpatialContacts(
        point=vectors(),
        s1=np.empty(n),
        tangent=vectors(),
        force=vectors(),
        bending=vectors(),
        q=np.empty(n),
        phase=np.empty(n, dtype=np.int8),
        status=np.zeros(n, dtype=np.int8),
        torsion=np.empty(n),
        skew=np.empty(n),
    )


def _checked(name: str, values: ArrayLike) -> Array:
    """(n, 3) real numbers.  Masked values, which would count as measured, are a ValueError."""
    if np.ma.isMaskedArray(values):
        raise ValueError(f"{name} must be a plain array, got a masked one; leave the masked rows out")
    array = np.asarray(values)
    if array.dtype.kind not in "iufb" or array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must be an array of real numbers of the shape (n, 3), got {array.shape}")
    return array.astype(float)


def _dot(a: Array, b: Array) -> Array:
    product: Array = (a * b).sum(axis=1)
    return product
