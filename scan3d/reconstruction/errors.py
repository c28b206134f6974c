"""Which differences count as noise, and what the uncertainty of a calibrated rig does to contacts, to the first order.

Each of the independent errors of the rig (`scan3d.rigs`) is applied to the poses and wrenches of the rows in contact; the
contacts of the closed form move in proportion.  A recording in a plane has three channels: what an error of the rig adds to the
others is left out, as it is in the reconstruction.

Misfits say how far contacts are from those of a convex body, and six reactions from those of a single force.  They need no true
body, and vanish for a right recording.  Whether a recording agrees with the model (`agreement`), and which fault explains that
it does not (`diagnosis`), is told by them alone.  Each comes with what errors explain of it:

- in the plane, how far contacts of a slice lie beyond the tangent at one of them;
- in space, the two residuals of six reactions (S4), which vanish for a single force at the rod's centre line: the moment about
  the rod, up to friction across a rod of finite radius, and the moment along the force;
- in space, how deep contacts, and the rod's tangents at contacts, lie in the hull of all contacts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc, ndtr

import planar
from scan3d.arrays import AT_ONCE, MEDIAN_OF_NORMAL, Array, Index, Mask
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.geometry.hulls import hull_about_mean
from scan3d.recording import FORCE_SIGMAS, IN_PLANE, Recording
from scan3d.rigs import RIG_QUANTITIES, RigErrors
from scan3d.spatial import inverse
from scan3d.spatial.march import SpatialRod, free_reactions, reshaped

LARGEST_TOLERANCE = 0.5
"""Distance from the tip, in rod lengths, within which a contact may count as one of the tip, whatever its uncertainty."""
SIGMAS = 5.0
"""Standard deviations by which noise or calibration may put a contact at the tip, or into what another sweep has passed."""
# Which reactions each model reads, of the six.
_REACTIONS = {"planar": IN_PLANE, "spatial": np.arange(6)}
SUMMED = (4, 16, 64)
"""Successive rows in the air whose sums tell whether their errors are independent; those of bounds are over as many."""
DEPENDENT = 1e-4
"""Probability with which sums of one size of independent errors are taken for those of dependent ones, which widens bounds."""
RIGHT_ROWS = 0.05
"""Right rows that are left out in a recording, in the mean, if each is judged once: fewer, and wild rows are not seen that make
bounds false; more, and all bounds are widened for nothing."""


class NoContactError(InputError):
    """No row of a recording has the reactions of a bent rod."""


def contact_tolerance(error: planar.Errors) -> Array:
    """(n,) differences in s1 and in the friction angle that count as noise; those of exact data where there is no rod."""
    return np.where(
        np.isfinite(error.largest), tip_sigmas(np.maximum(error.s1, error.friction_angle)), planar.TOLERANCE
    )


def tip_sigmas(s1: Array) -> Array:
    """(n,) distances to the tip that count as zero, by the standard deviations (n,) of the arc length."""
    return np.clip(SIGMAS * s1, planar.TOLERANCE, LARGEST_TOLERANCE)


def too_light(largest: Array, touching: Mask) -> Mask:
    """(n,) which rows in contact touch too lightly, by the standard deviations (n,) of all places."""
    if not touching.any():
        return touching
    # by 4 medians and a thousandth of the rod: such a contact may lie far outside the body
    return touching & (largest > max(4.0 * float(np.median(largest[touching])), 1e-3))


def felt(force: Array, noise: tuple[float, float]) -> Mask:
    """(n,) whether dimensionless forces (n, 2 or 3) stand out from the noise of force and moment."""
    return np.asarray(np.linalg.norm(force, axis=1) > FORCE_SIGMAS * max(noise))


class Air(NamedTuple):
    """What rows without a felt force say of the noise."""

    rows: int
    """Number of those whose neighbours have none either."""
    size: float | None
    """Standard deviations for each that counts, 1 at least; None if no value is larger than expected."""
    chance: float
    """Probability, at most, with which a right recording has a value as large as its largest."""


def noise_in_air(recording: Recording) -> Air:
    """The noise by second differences of successive rows in the air, in which touches that begin or end do not show."""
    if len(recording) < 5:  # rows in a row that a second difference needs about it
        return Air(0, None, 1.0)
    noise, order = recording.noise.of_reactions(recording.rod), np.argsort(recording.sweep, kind="stable")
    force, moment = (part[order] for part in recording.reactions(recording.six_axis))
    air, sweep = ~felt(recording.pressing(recording.six_axis)[order], noise), recording.sweep[order]
    sd, channels = np.repeat(noise, 3), np.array(_REACTIONS["spatial" if recording.six_axis else "planar"])
    channels = channels[sd[channels] > 0]
    before, own, after = (np.hstack([force, moment])[k : len(order) - 4 + k, channels] for k in (1, 2, 3))
    known = np.all([air[k : len(air) - 4 + k] for k in range(5)] + [sweep[4:] == sweep[:-4]], axis=0)
    found = np.abs(before - 2 * own + after)[known] / (np.sqrt(6) * sd[channels])
    if not found.size:
        return Air(0, None, 1.0)
    chance = float(2 * found.size * ndtr(-found.max()))
    size = None if chance >= RIGHT_ROWS else max(1.0, float(np.median(found)) / MEDIAN_OF_NORMAL)
    return Air(len(found), size, chance)


def independent(recording: Recording) -> bool:
    """Whether the errors of successive rows are independent, so that means over rows are more accurate than single rows.

    Of independent noise the sum of m rows in the air has √m times the standard deviation of a row.  Drift, 1/f noise, a filter,
    and steps of a converter that taring moved off their grid leave larger sums.  A touch that is too light to be felt has a
    force along -x and a moment about z: only sums of the other sign count, whose squares have the distribution χ² whatever
    touches.
    """
    if not (recording.noise.independent and recording.noise_independent):
        return False
    noise, order = recording.noise.of_reactions(recording.rod), np.argsort(recording.sweep, kind="stable")
    force, moment = recording.reactions(recording.six_axis)
    if (down := recording.down()) is not None:
        of_weight = free_reactions(recording.rod.in_space(), down.T)
        force, moment = force - of_weight[0].T, moment - of_weight[1].T
    air, sweep = ~felt(recording.pressing(recording.six_axis)[order], noise), recording.sweep[order]
    size = noise_in_air(recording).size or 1.0
    # a single wild value is no error that successive rows have in common
    away = [
        np.clip(values[order] / (size * sd), -3.0, 3.0)
        for values, sd in ((force[:, 0], noise[0]), (-moment[:, 2], noise[1]))
        if sd > 0
    ]
    start = np.flatnonzero(np.append(True, (np.diff(sweep) != 0) | (np.diff(air.astype(np.int8)) != 0)))
    count = np.diff(np.append(start, len(air)))
    within, run = np.arange(len(air)) - np.repeat(start, count), np.repeat(count, count)
    for rows in (*SUMMED, run):
        first = np.flatnonzero(air & (within % rows == 0) & (within + rows <= run))
        last = first + np.broadcast_to(rows, len(air))[first]
        found = [np.cumsum(np.append(0.0, values)) for values in away]
        sums = np.concatenate(
            [(total[last] - total[first]) / np.sqrt(last - first) for total in found] or [np.empty(0)]
        )
        larger = sums[sums > 0]
        if len(larger) and chdtrc(len(larger), (larger**2).sum()) < DEPENDENT:
            return False
    return True


class Effects(NamedTuple):
    """What p independent errors of one standard deviation do to contacts (n,), dimensionless, in the world."""

    place: Array
    """(n, 3, p)"""
    tangent: Array
    """(n, 3, p)"""
    s1: Array
    """(n, p)"""
    along: Array
    """(n, 3) the tangents themselves."""


def effects(recording: Recording, rows: Index, model: str) -> Effects:
    """The effects on the contacts of some rows; NaN where a row has no rod.  The recording has a `rig`."""
    assert recording.rig is not None
    axes, components = recording.axes()[rows], recording.rig.components().T
    # a step between the error of central differences and rounding
    step, of_wrench, size = np.full(len(components), 1e-2), np.zeros((len(components), 6)), np.zeros(len(rows))
    if relative := recording.rig.relative:
        size, channels = _size(recording, rows), list(_REACTIONS[model])
        # about as far as all contacts stay within at once, so that what is not linear in the error of a wrench is part
        # of it
        step = np.append(step, np.full(len(channels), 4.0))
        components = np.vstack([components, np.zeros((len(channels), components.shape[1]))])
        of_wrench = np.vstack([of_wrench, relative * np.eye(6)[channels]])
    errors, added = (
        np.vstack([np.zeros(part.shape[1]), part, -part])
        for part in (step[:, None] * components, step[:, None] * of_wrench)
    )
    wrench = np.hstack(_wrench(recording, rows)) + size[:, None] * added[:, None]
    found, moved = _contacts(recording, rows, wrench, errors, model), []
    for middle, *sides in ((column[0], *np.split(column[1:], 2)) for column in found):
        with np.errstate(invalid="ignore"):
            change = _larger(sides[0] - middle, middle - sides[1]) / step[:, None, None]
        moved.append(change.transpose(1, 2, 0))
    place, tangent = (np.einsum("nip,nij->njp", column, axes) for column in moved[:2])
    return Effects(place, tangent, moved[2][:, 0], np.einsum("ni,nij->nj", found[1][0], axes))


def _larger(one: Array, other: Array) -> Array:
    """(p, n, k): the larger one of two changes in each row; NaN where either is."""
    larger = np.greater(*((part**2).sum(axis=-1, keepdims=True) for part in (one, other)))
    return np.asarray(np.where(larger, one, other) + 0 * one)


def _size(recording: Recording, rows: Index) -> Array:
    """(n,) sizes of the wrenches of some rows, no less than the median of all rows with a force."""
    force, moment = recording.reactions(recording.six_axis)
    size = np.linalg.norm(np.hstack([force, moment]), axis=1)
    pressed = felt(recording.pressing(recording.six_axis), recording.noise.of_reactions(recording.rod))
    return np.asarray(np.maximum(size[rows], np.median(size[pressed]) if pressed.any() else 0.0))


def _wrench(recording: Recording, rows: Index) -> tuple[Array, Array]:
    force, moment = recording.reactions(recording.six_axis)
    return force[rows], moment[rows]


def _contacts(
    recording: Recording, rows: Index, wrench: Array, errors: Array, model: str
) -> tuple[Array, Array, Array]:
    """Contacts and tangents (e, n, 3) in the clamp's frame, and s1 (e, n, 1), of wrenches (e, n, 6) by a rig with errors
    (e, 18 + g)."""
    assert recording.rig is not None
    count, n = wrench.shape[:2]
    found = np.empty((count, n, 3)), np.empty((count, n, 3)), np.empty((count, n, 1))
    added = np.einsum("ek,kij->eij", errors, recording.rig.on_wrench(recording.rod.length_m))
    turned = (np.eye(6) + added).swapaxes(1, 2)
    # rods of one shape are reconstructed together
    shapes, of = np.unique(errors[:, 14:18], axis=0, return_inverse=True)
    for k, shape in enumerate(shapes):
        part = np.flatnonzero(of.ravel() == k)
        own, rod = wrench[part], recording.rod
        if shape[3]:
            heavier = replace(recording, rod=replace(rod, weight_N=rod.weight_N + float(shape[3])))
            own = own + np.hstack(_wrench(heavier, rows)) - np.hstack(_wrench(recording, rows))
            rod = heavier.rod
        own = np.exp(-errors[part, :1, None]) * own @ turned[part]
        if model == "planar":
            own[..., 2:5] = 0
        bent = reshaped(rod.in_space(), shape[:3] * [1.0, rod.length_m, rod.length_m])
        every = _of_one_rod(recording, np.tile(rows, len(part)), own.reshape(-1, 6), bent, model)
        point, along, s1 = (column.reshape(len(part), n, -1) for column in every)
        longer, offset, turn = (
            1 + errors[part, 1, None, None],
            errors[part, None, 2:5] / rod.length_m,
            errors[part, None, 5:8],
        )
        if recording.in_probings.all():
            point = longer * point
        else:
            s1 = s1 / longer
        found[0][part], found[1][part] = offset + point + np.cross(turn, point), along + np.cross(turn, along)
        found[2][part] = s1
    return found


def _of_one_rod(
    recording: Recording, rows: Index, wrench: Array, rod: SpatialRod, model: str
) -> tuple[Array, Array, Array]:
    """Contacts (n, 3), tangents (n, 3) and s1 (n,) of wrenches (n, 6)."""
    (force, moment), noise = np.hsplit(wrench, 2), recording.noise.of_reactions(recording.rod)
    pulled = None if (down := recording.down()) is None else down[rows]
    if recording.in_probings.all():
        bead = recording.rod.bead_diameter_m / 2 / recording.rod.length_m
        pulled = None if pulled is None else pulled.T
        told: dict[str, Any] = {"rod": rod, "gravity": pulled, "in_plane": model == "planar", "bead": bead}
        ends = inverse.at_ends(force.T, moment.T, noise, **told)
        return ends.point.T - bead * ends.normal, np.broadcast_to([0.0, 1.0, 0.0], force.shape), np.ones(len(force))
    # the spatial model weights by the noise what it knows of the bending plane
    known = None if model == "planar" else noise
    found = inverse.reconstruct(force, moment, tolerance=inverse.PAST_TIP, noise=known, rod=rod, gravity=pulled)
    return found.point, found.tangent, found.s1


def torsion_sd(recording: Recording, rows: Index) -> Array:
    """(n,) standard deviations, dimensionless, of the moment about the rod, which a single contact force does not have."""
    assert recording.rig is not None
    about_rod = recording.rig.on_wrench(recording.rod.length_m)[:, 4]
    parts = np.hstack(_wrench(recording, rows)) @ about_rod.T @ recording.rig.components()
    return np.asarray(np.linalg.norm(parts, axis=1))


def tip_tolerance(recording: Recording, felt: Mask, tolerance: Array | float, model: str) -> Array | float:
    """The differences of s1 to the tip (n,) that count as zero, by the noise and by the calibration."""
    if recording.rig is None or not felt.any():
        return tolerance
    widened = np.zeros(len(recording))
    for rows in _blocks(np.flatnonzero(felt)):
        s1 = np.linalg.norm(effects(recording, rows, model).s1, axis=1)
        widened[rows] = np.where(np.isfinite(s1), SIGMAS * s1, 0.0)
    return np.asarray(np.clip(np.hypot(tolerance, widened), planar.TOLERANCE, LARGEST_TOLERANCE))


def _blocks(rows: Index) -> list[Index]:
    return np.array_split(rows, 1 + 64 * len(RIG_QUANTITIES) * len(rows) // AT_ONCE)


def with_rig_errors(cloud: Cloud, recording: Recording) -> Cloud:
    """The cloud with what the uncertainty of the recording's rig does to its contacts; those that it may undo are left out."""
    if recording.rig is None:
        return cloud
    points = cloud.points if cloud.centre_points is None else cloud.centre_points
    centre = points.mean(axis=0)
    square, axes = np.linalg.eigh((points - centre).T @ (points - centre))
    # the contacts lie in an ellipsoid with their own axes of inertia
    shape = axes * np.sqrt(np.maximum(square, 0.0)) @ axes.T
    radius = float(np.linalg.norm((points - centre) @ np.linalg.pinv(shape), axis=1).max())
    shape *= 1.1 * radius  # the body may be wider than its contacts
    blocks = [_of_block(cloud, recording, part, centre, shape) for part in _blocks(np.arange(len(cloud)))]
    covariance, turn, across, tilt, height = (np.concatenate(column) for column in zip(*blocks, strict=True))
    relative, count = recording.rig.relative, recording.rig.components().shape[1]
    if relative:
        count += len(_REACTIONS[cloud.model]) ** 2
    found = RigErrors(covariance, turn, across, tilt, height, count, relative)
    cloud = replace(cloud, calibration=found)
    together = np.column_stack([covariance.reshape(-1, 9), turn, across, tilt, height])
    known = np.flatnonzero(np.isfinite(together).all(axis=1))
    return cloud if len(known) == len(cloud) else cloud.select(known)


def _of_block(cloud: Cloud, recording: Recording, part: Index, centre: Array, shape: Array) -> tuple[Array, ...]:
    """The columns of `RigErrors` of some contacts."""
    rows, length = cloud.row[part].astype(np.intp), cloud.rod_length
    points = (cloud.points if cloud.centre_points is None else cloud.centre_points)[part]
    moved = effects(recording, rows, cloud.model)
    place, turned, tangent, axes = length * moved.place, moved.tangent, moved.along, recording.axes()[rows]
    tangential = cloud.phase[part] == planar.Phase.TANGENTIAL
    turned = np.where(tangential[:, None, None], turned, 0.0)
    normal = axes[:, 2]
    sideways = np.where(tangential[:, None], np.cross(normal, tangent), 0.0)
    middle, half = ((centre - points) * tangent).sum(axis=1), np.linalg.norm(tangent @ shape, axis=1)
    height = _along(normal, place)
    for along in (middle - half, middle + half):  # of a tip contact, whose tangent says nothing, `turned` is 0
        height = np.maximum(height, _along(normal, place + along[:, None, None] * turned))
    known = np.asarray(np.isfinite(turned).all(axis=(1, 2)))
    turn = np.full(len(part), np.nan)
    turn[known] = np.linalg.norm(turned[known], ord=2, axis=(1, 2))
    covariance = place @ place.transpose(0, 2, 1)
    return covariance, turn, _along(sideways, place), _along(sideways, turned), height


def _along(directions: Array, moved: Array) -> Array:
    """(n,) standard deviations along directions (n, 3) of what moves by (n, 3, p)."""
    return np.linalg.norm(np.einsum("ni,nip->np", directions, moved), axis=1)


ROUNDING = 1e-7
"""Rounding of a contact's place, in rod lengths, with the steps of fine converters that too few numbers show, and of the
residuals of a wrench.  Most faults are a hundred times larger."""
DISTURBED = 0.02
"""Largest fraction of the rows with a force that may contradict the others, as disturbed rows of a measurement."""


class Misfit(NamedTuple):
    """A misfit and what noise and rounding explain of it, arrays of one shape."""

    found: Array
    explained: Array

    def worst(self) -> tuple[float, float]:
        """The misfit, and what explains it, where their ratio is largest."""
        i = np.unravel_index(np.argmax(self.found / self.explained), self.found.shape)
        return float(self.found[i]), float(self.explained[i])


class Errors(NamedTuple):
    """Errors of contacts (n,) in a slice's plane, and how many standard deviations of them count as explained."""

    sigmas: float
    covariance: Array
    """(n, 2, 2) of the places."""
    turn_sd: Array
    """(n,) of the tangents' angles, in radians."""


def beyond_tangents(
    points: Array, lines: Index, normals: Array, some: Index, error: Errors | None, length: float
) -> Misfit:
    """How far (k, m) `some` contacts of a slice lie beyond the tangents at others.

    points, lines, normals
        (n, 2) contacts in the slice's plane; (k,) the numbers of those with tangents, and (k, 2) the outward normals there.
    error
        that of the contacts; None for exact ones.
    length
        the rod's, in the unit of the points.
    """
    beyond = normals @ points[some].T - (normals * points[lines]).sum(axis=1)[:, None]
    explained = np.full(beyond.shape, ROUNDING * length)
    if error is not None:
        reach = error.sigmas * np.sqrt(np.trace(error.covariance, axis1=1, axis2=2))
        pairs = reach[lines][:, None] + reach[some]
        of_points, of_lines = deviations(points, lines, normals, some, error)
        # the last summands are of the second order
        explained += error.sigmas * (of_points + of_lines + error.turn_sd[lines][:, None] * pairs) + pairs**2 / length
    return Misfit(beyond, explained)


def deviations(points: Array, lines: Index, normals: Array, some: Index, error: Errors) -> tuple[Array, Array]:
    """Standard deviations (k, m) of the distances of `beyond_tangents`: by the contacts, and by the lines at most.

    A line's place and angle follow from the same bending: their errors are nearly the same one.
    """
    tangents = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    along = tangents @ points[some].T - (tangents * points[lines]).sum(axis=1)[:, None]
    quadratic = np.stack([normals[:, 0] ** 2, 2 * normals[:, 0] * normals[:, 1], normals[:, 1] ** 2], axis=1)
    entries = np.stack([error.covariance[:, 0, 0], error.covariance[:, 0, 1], error.covariance[:, 1, 1]], axis=1)
    of_points = np.sqrt(np.maximum(quadratic @ entries[some].T, 0.0))
    place = np.sqrt(np.maximum((quadratic * entries[lines]).sum(axis=1), 0.0))
    return of_points, place[:, None] + error.turn_sd[lines][:, None] * np.abs(along)


def against_single_force(
    force: Array,
    moment: Array,
    found: inverse.SpatialContacts,
    noise: tuple[float, float],
    sigmas: float,
    radius: float,
) -> tuple[Misfit, Misfit]:
    """The moment about the rod and that along the force (n,), both over the clamping moment, of reactions (n, 3) as `found`.

    All is dimensionless; `radius` is the rod's, at which friction across it acts.
    """
    f, m = np.linalg.norm(force, axis=1), np.hypot(moment[:, 0], moment[:, 2])
    sigma_f, sigma_m = noise
    with np.errstate(divide="ignore", invalid="ignore"):
        rounding = ROUNDING * (1 + f / m)
        about_rod = Misfit(np.abs(found.torsion) / m, sigmas * sigma_m / m + radius * f / m + rounding)
        along_force = Misfit(np.abs(found.skew) / (f * m), sigmas * np.hypot(sigma_m / m, sigma_f / f) + rounding)
    return about_rod, along_force


def depths_in_hull(
    points: Array,
    of_hull: Index,
    some: Index,
    lines: Index,
    tangents: Array,
    errors: tuple[Array, Array],
    length: float,
    covariance: Array | None = None,
) -> Misfit | None:
    """Depths (m + k,) of `some` contacts, and of the tangents at others, in the hull of contacts; None if that is no body.

    points, of_hull, tangents
        (n, 3) contacts at the rod's centre line, those (h,) of which the hull is made, and the rod's tangents (n, 3).
    errors
        (n,) largest errors of the places and of the tangents, in radians.
    length
        the rod's, in the unit of the points.
    covariance
        (n, 3, 3) squares of further errors of the places, which most noise leaves along the rod, where they change no depth.
    """
    place, turn = errors
    squares = np.zeros((len(points), 3, 3)) if covariance is None else covariance
    largest = place + np.sqrt(np.trace(squares, axis1=1, axis2=2))
    hull = hull_about_mean(points[of_hull])
    if hull is None:
        return None
    centred, corners, outward = points - points[of_hull].mean(axis=0), of_hull[hull.simplices], hull.equations[:, :3]
    across = np.sqrt(np.maximum(np.einsum("fi,fkij,fj->fk", outward, squares[corners], outward), 0.0))
    reach, farthest = (place[corners] + across).max(axis=1), largest[corners].max(axis=1)
    parts = []
    for rows, is_line in ((some, False), (lines, True)):
        for part in np.array_split(rows, 1 + len(rows) * len(hull.equations) // AT_ONCE):
            below = -centred[part] @ outward.T - hull.equations[:, 3]
            turned = np.zeros(len(part))
            if is_line:
                slope = tangents[part] @ outward.T
                arm = _middle_of_lines(below, slope)
                below -= arm[:, None] * slope
                turned = turn[part] * np.abs(arm)
            facet = below.argmin(axis=1)
            n = outward[facet]
            own = place[part] + np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", n, squares[part], n), 0.0))
            deep, curved = below[np.arange(len(part)), facet], largest[part] + farthest[facet]
            parts.append(np.stack([deep, own + reach[facet], turned, curved]))
    found, both, turned, curved = np.concatenate(parts, axis=1)
    # the last summand is of the second order
    return Misfit(found, ROUNDING * length + both + turned + curved**2 / length)


def _middle_of_lines(height: Array, slope: Array) -> Array:
    """(n,) places along lines, in the middle of their part within a hull, or where they are nearest to it.

    `height` (n, f) are the depths of their points below the hull's facets, `slope` (n, f) how fast they fall along the lines.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = height / slope
        first = np.where(slope < 0, crossing, -np.inf).max(axis=1)
        last = np.where(slope > 0, crossing, np.inf).min(axis=1)
        arm = (first + last) / 2
    return np.where(np.isfinite(arm), arm, 0.0)
