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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtrc

import planar
from planar.plots import Explained
from planar.reconstruction import DIFFERENCE
from planar.rods import solve
from scan3d.arrays import ROUNDING, Array, Index, Mask
from scan3d.spatial import march
from scan3d.spatial.march import Marched, SpatialRod

_STRAIGHT = planar.Rod()
PAST_TIP = 0.999
"""Tolerance with which contacts that errors put past the tip by nearly the rod's length have a place as well."""


class Status(Explained):
    """Whether a row of reactions gives a contact, and if not, why; `sentence` explains it."""

    OK = 0, "a contact"
    NO_FORCE = 1, "nothing touches: there is no force, or a value is missing or infinite"
    NO_MOMENT = (
        2,
        "the force has no moment that bends the rod: the rod is straight, and its bending plane and the place of "
        "the contact along it are unknown",
    )
    NO_ROD = (
        3,
        "no rod has these reactions: the moment is more than the force can hold, or the force pulls along the rod; of a "
        "rod that is not straight and uniform, also if the contact would lie farther past the tip than the rod is long",
    )
    BEYOND_TIP = 4, "the contact would lie past the rod's tip"


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

    def within(self, tolerance: float | Array) -> SpatialContacts:
        """These contacts with a smaller tolerance than that with which they were found, as `reconstruct` has it."""
        ok = self.status == Status.OK
        with np.errstate(invalid="ignore"):
            past, tangential = ok & (self.s1 > 1 + tolerance), ok & (self.s1 < 1 - tolerance)
        status = np.where(past, Status.BEYOND_TIP, self.status).astype(np.int8)
        phase = np.where(tangential, planar.Phase.TANGENTIAL, planar.Phase.TIP)
        phase = np.where(ok & ~past, phase, planar.Phase.NONE).astype(np.int8)
        found = replace(self, status=status, phase=phase)
        if past.any():
            values = {name: getattr(self, name).copy() for name in ("point", "s1", "tangent", "bending", "q")}
            for column in values.values():
                column[past] = np.nan
            found = replace(found, **values)
        return found

    @property
    def bending_angle(self) -> Array:
        """(n,) angle ω from the plane of the sweep to the bending plane, ``e = (cos ω, 0, sin ω)``."""
        return np.arctan2(self.bending[:, 2], self.bending[:, 0])

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
    marched: Marched | None = None,
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
    marched
        such rods, if they are marched already.

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
    other = None if rod is None or rod.is_straight_and_uniform else rod
    with np.errstate(all="ignore"):
        m = np.hypot(m0[:, 0], m0[:, 2])
        ex, ez = m0[:, 2] / m, -m0[:, 0] / m
        if other is not None:
            down = None if gravity is None else np.asarray(gravity, dtype=float).T
            found = marched or march.contacts(other, f0.T, m0.T, down, steps)
            s1, point, tangent, force, torsion, skew = (np.array(column.T) for column in found)
            size = np.linalg.norm(force, axis=1)
        else:
            if noise is not None:
                x, z = bending_direction(f0.T, m0.T, noise)
                ex, ez = (np.where(np.isfinite(x), found, own) for found, own in ((x, ex), (z, ez)))
                m = m0[:, 2] * ex - m0[:, 0] * ez
            solved = solve("closed-form", _STRAIGHT, f0[:, 0] * ex + f0[:, 2] * ez, f0[:, 1], m)
            slope, s1, force, size = solved.alpha - solved.beta, solved.s1, -f0, solved.force
            point = np.stack([solved.x * ex, solved.y, solved.x * ez], axis=1)
            tangent = np.stack([np.cos(slope) * ex, np.sin(slope), np.cos(slope) * ez], axis=1)
            torsion, skew = m0[:, 1].copy(), _dot(f0, m0)
        q = m / (2 * np.sqrt(size))
        known = np.isfinite(s1) & np.isfinite(point).all(axis=1) & np.isfinite(tangent).all(axis=1)
    # where several reasons apply, the last one counts
    status = np.where(known, Status.OK, Status.NO_ROD).astype(np.int8)
    if other is None or not (any(other.curvature) or other.profile.weight):
        status[(m0[:, 0] == 0) & (m0[:, 2] == 0)] = Status.NO_MOMENT
    status[~(np.isfinite(f0) & np.isfinite(m0)).all(axis=1) | (force == 0).all(axis=1)] = Status.NO_FORCE
    bending = np.stack([ex, 0 * ex, ez], axis=1)
    for column in (point, s1, tangent, bending, q):
        column[status != Status.OK] = np.nan
    phase, in_plane = np.zeros_like(status), other is None
    return SpatialContacts(point, s1, tangent, force, bending, q, phase, status, torsion, skew, in_plane).within(zero)


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
    force: Array
    """(n,) of the direction of the force: root of the mean square angle, in radians."""


def errors(
    f0: Array,
    m0: Array,
    noise: tuple[float, float],
    *,
    rod: SpatialRod | None = None,
    gravity: Array | None = None,
    covariance: Array | None = None,
    found: SpatialContacts | None = None,
) -> SpatialErrors:
    """Errors of the contacts that `reconstruct` finds for reactions (n, 3), by the noise of force and moment.

    `covariance` (n, 6, 6) of force and moment stands in the place of white noise of reactions that agree with a single force.
    `found` are the contacts, by this noise and with the tolerance `PAST_TIP`, if they are known already.
    """
    if covariance is not None or (rod is not None and not rod.is_straight_and_uniform):
        return _by_differences(rod or SpatialRod(), f0, m0, noise, gravity, covariance)[1]
    sigma_f, sigma_m = noise
    with np.errstate(all="ignore"):  # rows without a force have no errors that are numbers
        # exact reactions, of rods whose poses alone are noisy, give the same direction with any weights
        ex, ez = bending_direction(f0.T, m0.T, noise if max(noise) else (1.0, 1.0))
        m, f0e = m0[:, 2] * ex - m0[:, 0] * ez, f0[:, 0] * ex + f0[:, 2] * ez
        slopes = planar.jacobian(f0e, f0[:, 1], m) * [sigma_f, sigma_f, sigma_m]
        angle = 1 / np.sqrt((m / sigma_m) ** 2 + (f0e / sigma_f) ** 2)
        x, y, s1, alpha, beta = (slopes[:, k] for k in range(5))
        found = found or reconstruct(f0, m0, noise=noise, tolerance=PAST_TIP)
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
    return _where(known, point, s1_sd, beta_sd, tangent, force)


def _where(known: Mask, point: Array, *others: Array) -> SpatialErrors:
    """Errors where they are known, and infinite elsewhere."""
    point[~known] = np.inf
    largest = np.full(len(known), np.inf)
    largest[known] = np.sqrt(np.maximum(np.linalg.eigvalsh(point[known])[:, 2], 0.0))
    return SpatialErrors(point, largest, *(np.where(known & np.isfinite(v), v, np.inf) for v in others))


def contacts_with_errors(
    f0: Array,
    m0: Array,
    noise: tuple[float, float],
    *,
    rod: SpatialRod,
    gravity: Array | None = None,
    covariance: Array | None = None,
) -> tuple[SpatialContacts, SpatialErrors]:
    """`reconstruct` with the tolerance `PAST_TIP`, and `errors`: rods that need a march are marched once."""
    told: dict[str, Any] = {"rod": rod, "gravity": gravity}
    if rod.is_straight_and_uniform:
        found = reconstruct(f0, m0, tolerance=PAST_TIP, noise=noise, **told)
        return found, errors(f0, m0, noise, covariance=covariance, found=found, **told)
    marched, error = _by_differences(rod, f0, m0, noise, gravity, covariance)
    return reconstruct(f0, m0, tolerance=PAST_TIP, marched=marched, **told), error


def _by_differences(
    rod: SpatialRod,
    f0: Array,
    m0: Array,
    noise: tuple[float, float],
    gravity: Array | None,
    covariance: Array | None,
) -> tuple[Marched, SpatialErrors]:
    """Contacts of rods that do not bend in a plane, and `errors` by central differences of them: all in one march."""
    down = None if gravity is None else gravity.T
    if covariance is None:
        covariance = np.broadcast_to(np.diag(np.repeat(np.square(noise), 3)), (len(f0), 6, 6))
    size = np.repeat([np.linalg.norm(f0, axis=1), np.linalg.norm(m0, axis=1)], 3, axis=0)
    reactions = np.concatenate([f0.T, m0.T])
    with np.errstate(all="ignore"):
        step, n = DIFFERENCE * np.eye(6)[:, :, None] * size, len(f0)
        moved = np.stack([reactions - step, reactions + step]).transpose(2, 0, 1, 3).reshape(6, -1)
        every = np.hstack([reactions, moved])
        down = None if down is None else np.tile(down, 13)
        found = march.contacts(rod, every[:3], every[3:], down)
        along = (found.force * found.tangent).sum(axis=0) / np.linalg.norm(found.force, axis=0)
        values = np.concatenate([found.point, found.tangent, found.s1[None], np.arcsin(along)[None]])
        ends = values[:, n:].reshape(8, 2, 6, n)
        rate = (ends[:, 1] - ends[:, 0]) / (2 * DIFFERENCE * size)
        slope = rate.transpose(2, 0, 1)  # of place, tangent, s1 and β (n, 8, 6)
        spread = slope @ covariance @ slope.transpose(0, 2, 1)
        point, variances = spread[:, :3, :3], np.einsum("nii->in", spread)
        tangent, s1, beta = (np.sqrt(part) for part in (variances[3:6].sum(axis=0), variances[6], variances[7]))
        # the direction of the contact's force, which may be small beside the weight
        strength, by_force = np.linalg.norm(found.force[:, :n], axis=0), covariance[:, :3, :3]
        direction = (found.force[:, :n] / strength).T
        along_force = np.einsum("ni,nij,nj->n", direction, by_force, direction)
        force = np.sqrt(np.maximum(np.trace(by_force, axis1=1, axis2=2) - along_force, 0.0)) / strength
    error = _where(np.isfinite(spread).all(axis=(1, 2)), point, s1, beta, tangent, force)
    return Marched._make(column[..., :n] for column in found), error


def _checked(name: str, values: ArrayLike) -> Array:
    """(n, 3) real numbers.  Masked values, which would count as measured, are a ValueError."""
    if np.ma.isMaskedArray(values):
        raise ValueError(f"{name} must be a plain array, got a masked one; leave the masked rows out")
    array = np.asarray(values)
    if array.dtype.kind not in "iufb" or array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must be an array of real numbers of the shape (n, 3), got {array.shape}")
    return array.astype(float)


def _dot(a: Array, b: Array) -> Array:
    return (a * b).sum(axis=1)


class AtEnds(NamedTuple):
    """The ends (n,) of rods that are touched there alone, in rod lengths and in the clamp's frame."""

    point: Array
    """(3, n) where the centre lines end, which is where a bead has its centre."""
    covariance: Array
    """(n, 3, 3) by the noise."""
    chance: Array
    """(n,) probability that noise makes the moment at the end as large as it is; 0 where exact reactions have one."""
    normal: Array
    """(n, 3) of a bead: unit vectors from where it is touched to its centre."""
    normal_covariance: Array
    """(n, 3, 3) by the noise."""


# Standard deviation of the angle between force and normal in radians, before their moment tells it: that of friction.
_FRICTION_ANGLE = 0.3


def at_ends(
    force: Array,
    moment: Array,
    noise: tuple[float, float],
    *,
    rod: SpatialRod,
    gravity: Array | None = None,
    in_plane: bool = False,
    bead: float = 0.0,
) -> AtEnds:
    """Where rods end that are touched there alone, by support reactions (3, n) and the noise of force and moment.

    The moment at the end vanishes, which conditions the reactions.  In a plane nothing is known of fz, mx and my, which are 0.
    On a bead of a radius, in rod lengths, the force F acts beside its centre, on its surface, and the moment there,
    ``b F × n``, tells the normal n; what noise hides of it is taken from friction: n is near F.
    """
    channels = np.array([0, 1, 5]) if in_plane else np.arange(6)
    # in a plane about z alone
    vanishing = np.array([2]) if in_plane else np.arange(3)

    def marched(reactions: Array) -> tuple[Array, Array]:
        down = None if gravity is None else np.tile(gravity, reactions.shape[1] // max(n, 1))
        found = march.ends(rod, reactions[:3], reactions[3:], down)
        return found.point, found.moment[vanishing]

    reactions = np.concatenate([force, moment])
    n, sd = reactions.shape[1], np.repeat(noise, 3)[channels]
    point, at_end = marched(reactions)
    left = at_end.T
    pressing = (-force - (0.0 if gravity is None else rod.profile.weight * gravity)).T
    size = np.linalg.norm(pressing, axis=1)
    along = pressing / np.where(size > 0, size, 1.0)[:, None]
    lever = bead * size
    if sd.max() <= ROUNDING:
        chance = np.abs(left).max(axis=1) <= planar.TOLERANCE
        if bead:
            chance = (np.abs(_dot(left, along)) <= planar.TOLERANCE) & (
                np.linalg.norm(left, axis=1) <= lever + planar.TOLERANCE
            )
        nothing = np.zeros((n, 3, 3))
        return AtEnds(point, nothing, np.where(chance, 1.0, 0.0), _normals(along, left, lever), nothing)
    step = DIFFERENCE * np.eye(6)[:, channels]
    moved = reactions[:, None, None] + np.stack([step, -step], axis=1)[..., None]
    ends = (part.reshape(len(part), 2, len(channels), n) for part in marched(moved.reshape(6, -1)))
    places, moments = ((part[:, 0] - part[:, 1]).transpose(2, 0, 1) / (2 * DIFFERENCE) for part in ends)
    spread = np.diag(np.maximum(sd, ROUNDING) ** 2)  # one of the two noises may not be stated
    of_moment = moments @ spread @ moments.transpose(0, 2, 1)
    by_bead = np.zeros_like(of_moment)
    if bead:
        across = np.eye(3) - along[:, :, None] * along[:, None]
        by_bead = (_FRICTION_ANGLE * lever)[:, None, None] ** 2 * across
        of_moment = of_moment + by_bead
    gain = np.linalg.solve(of_moment, moments @ spread).transpose(0, 2, 1)
    weighted = np.linalg.solve(of_moment, left[..., None])
    better = reactions.copy()
    better[channels] -= (gain @ left[..., None])[..., 0].T
    covariance = places @ (spread - gain @ moments @ spread) @ places.transpose(0, 2, 1)
    chance = chdtrc(len(vanishing), (left[..., None] * weighted)[..., 0].sum(axis=1))
    normal, of_normal = along, np.zeros((n, 3, 3))
    if bead:
        normal = _normals(along, (by_bead @ weighted)[..., 0], lever)
        rest = (by_bead - by_bead @ np.linalg.solve(of_moment, by_bead)) / lever[:, None, None] ** 2
        turn = np.cross(np.eye(3), along[:, None])
        of_normal = turn.transpose(0, 2, 1) @ rest @ turn
    return AtEnds(marched(better)[0], covariance, chance, normal, of_normal)


def _normals(along: Array, moment: Array, lever: Array) -> Array:
    """(n, 3) unit vectors n by those of forces F (n, 3) and the moments ``b F × n`` (n, 3) of levers ``b |F|`` (n,)."""
    if not lever.any():
        return along
    beside = np.cross(moment / np.where(lever > 0, lever, np.inf)[:, None], along)
    return np.asarray(beside + np.sqrt(np.maximum(1 - _dot(beside, beside), 0.0))[:, None] * along)
