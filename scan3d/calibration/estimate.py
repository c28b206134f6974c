"""The rig that has touched a reference: which rows are used, of what kind they are, and which parameters they determine.

Kinds of contacts, rows, and the noise of the poses depend on the rig, and the rig on them: rounds of least squares end when
all of them are at rest.  Neither a row's use nor its kind is decided by its own noise, but by its neighbours in the sweep.

Least squares begin at a first rig.  The condition ``m0·t0 = 0`` in the sensor's frame is linear in the rod's direction u and in
``u × a``, with a the place of the sensor: it gives both without a body.  The turn about the rod, the distance along it and the
stiffness are then searched on a grid: with the right ones the contacts lie on the reference.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scan3d.arrays import NEGLIGIBLE, ROUNDING, Array, Mask, evenly
from scan3d.calibration.fit import (
    ROBOTS,
    Fit,
    Noise,
    Problem,
    adjusted,
    checked,
    estimates,
    fitted,
    in_air,
    is_shaped,
)
from scan3d.calibration.model import (
    CLAMP,
    LENGTH,
    MIXING,
    PLACE,
    SENSOR,
    SHAPE,
    STIFFNESS,
    TARE,
    TILT,
    TURN,
    Kind,
    Rig,
    Touches,
    bent,
    clamp_wrench,
    contacts,
)
from scan3d.calibration.references import CHANCE, Plane, Reference, Sphere, neighbours, six_channels, unloaded
from scan3d.choices import TARES
from scan3d.errors import InputError
from scan3d.recording import Recording
from scan3d.units import length, share

FEWEST = 30
"""Rows in contact that a calibration needs."""
MORE_SWEEPS = (
    "sweep it in more directions of the rod, with the clamp turned about the rod's axis, and bend the rod more"
)
# Forces in standard deviations of their noise from which a row is used, and the standard deviation of a contact's place
# along the rod, over the reference's size, up to which it is: farther off, the reference curves within the errors of a row.
_FELT, _ALONG = 20.0, 0.12
# Standard deviation of the sensor's turn about the rod, in radians, from which it is not determined.  Without friction the
# contacts' distance from the reference depends on it to the second order only, and linear uncertainties do not hold.
_ABOUT_ROD = 0.01
# Least part of a parameter in a direction that the normal matrix does not determine.
_PART = 1e-3
# Spread of the planes of planar sweeps, over the sphere's radius, up to which they count as one plane through the centre.
_PLANE = 0.1
# Rounds in which the rows, their kinds and the noise of the poses come to rest, and the change of the logarithm of the last.
_ROUNDS, _SAME_NOISE = 8, 0.01
# Difference of the sums of squares of both kinds from which the rows around a row make its kind certain.
_LIKELIER = 12.0
# What the cosine of a tangential contact, and s1 of a tip contact in rod lengths, may be off for a first rig.
_ROUGH = 0.01
# Lengths of the rod that are tried, as quantiles of s1, and the tip contacts that one needs.
_LENGTHS, _FEWEST_TIPS = np.linspace(0.3, 1.0, 71), 8
# What places, and wrenches relative to their sizes, may be off for a rod whose shape is not known yet.
_SHAPELESS = 0.03
# Rows in contact by which the fit is begun; and those of a rod that is marched, of which so many tell as much as is needed.
_MANY, _MARCHED = 10_000, 400


def calibrated(
    recording: Recording,
    reference: float | Literal["plane"] | None,
    tare: str = "auto",
    pose_noise_m: float | None = None,
) -> Fit:
    """The fit of a rig, as `scan3d.calibrate`."""
    if tare not in TARES:
        raise InputError(f"tare must be one of {', '.join(TARES)}, got {tare!r}")
    if pose_noise_m is not None and not 0 <= pose_noise_m < math.inf:
        raise InputError(f"the noise of the poses must be a number of metres >= 0, got {pose_noise_m!r}")
    rod = recording.rod
    touched = Plane.of(rod) if reference == Plane.kind else Sphere.of(reference, rod)
    place = pose_noise_m if pose_noise_m is not None else recording.noise_pose_m or None
    problem, nominal = measured(recording, touched, tare)
    first = 0.3 * ROBOTS if place is None else max(place / rod.length_m, NEGLIGIBLE)
    # relative errors of the wrench are usually some thousandths
    noise = Noise(problem.air.force_noise, problem.air.moment_noise, first, 2e-3 * problem.channels.all())
    fit = _of_rig(problem, nominal, noise, place)
    refusal = other = None
    try:
        _check(fit, recording)
    except InputError as error:
        refusal = error
    # where poses of a robot scatter as much as the contacts of a refused fit, no shape of the rod would mend it
    if is_shaped(fit) and (refusal is None or fit.noise.place > ROBOTS):
        other = _shaped(problem, nominal, noise, recording, place)
    if other is None and refusal is not None:
        raise refusal
    return other or fit


def _of_rig(problem: Problem, nominal: Rig, noise: Noise, place: float | None) -> Fit:
    """The fit from a nominal rig; of the rows if it has a shape, which takes long, so many as are needed."""
    many = _MARCHED if nominal.marched else _MANY
    step = max(1, len(problem.touches.kind) // many)
    few = problem.rows(np.arange(0, len(problem.touches.kind), step))
    rig = first_rig(few, nominal, noise)
    strong, rig = _with_kinds(_strong(few, rig, noise), rig, noise, None, _ROUGH)
    begun = fitted(strong, rig, noise, 1)
    if nominal.marched and not _away(begun) < 3 * ROBOTS:  # a fit would take long, and be none
        raise _no_fit(rig.reference, "")
    free = _determined(strong, rig, step * begun.normal)
    if (free != strong.free).any():
        rig = fitted(replace(strong, free=free), _at_nominal(rig, nominal, free), noise).rig
    length = rig.length if strong.free[LENGTH] else None
    free[LENGTH] |= length is None  # tip contacts may turn up later
    fit = _settled(replace(few, free=free), rig, noise, length, place is None)
    if step > 1 and not nominal.marched:  # the fit of some rows is near that of all
        length = fit.rig.length if fit.problem.free[LENGTH] else None
        fit = _settled(replace(problem, free=free), fit.rig, fit.noise, length, place is None)
    return fit if fit.problem.free[LENGTH] else replace(fit, rig=replace(fit.rig, length=nominal.length))


def _shaped(problem: Problem, nominal: Rig, noise: Noise, recording: Recording, place: float | None) -> Fit | None:
    """The fit of a rod whose shape is sought as well, if that explains all that the touches deviate by and is certain.

    A shape may make up in part for a wrong diameter of a sphere, or for what no rod does.
    """
    free = problem.free.copy()
    free[SHAPE:MIXING] = [True, True, problem.channels.all()]
    try:
        fit = _of_rig(replace(problem, free=free), replace(nominal, marched=True), noise, place)
        _check(fit, recording)
    except InputError:
        return None
    found = checked(fit, recording, place is None)
    variances = np.diag(found.covariance)[SHAPE:MIXING]
    certain = (variances > 0) & (fit.rig.shape**2 > CHANCE**2 * variances)
    return fit if certain.any() and found.fits else None


def measured(recording: Recording, reference: Reference, tare: str) -> tuple[Problem, Rig]:
    """The rows in contact and in the air, dimensionless, and the nominal rig."""
    rod, known, six = recording.rod, recording.noise, recording.six_axis
    if not six and not isinstance(reference, Sphere):
        raise InputError(
            f"a calibration by touches of {reference.title} needs forces and moments with all six components; with three, "
            "touch a sphere"
        )
    channels, wrench = six_channels(recording)
    unit = np.repeat([rod.force_unit_N, rod.moment_unit_Nm], 3)
    wrench = wrench / unit
    air = unloaded(recording.sweep, wrench, channels, (known.force_N / unit[0], known.moment_Nm / unit[3]), tare)
    around = neighbours(wrench, recording.sweep, air.contact)
    force = np.linalg.norm((around - air.basis @ air.tare.T)[:, :3], axis=1)
    rows = np.flatnonzero(air.contact & (force > _FELT * air.force_noise))
    if len(rows) < FEWEST:
        raise InputError(
            f"the recording has {len(rows)} rows in contact that stand out from the noise, and a calibration needs {FEWEST}: "
            f"touch the {reference.kind} in more sweeps, and bend the rod more"
        )
    position = recording.position_m[rows] / rod.length_m
    frame = recording.axes()[rows].swapaxes(1, 2)
    kind = np.full(len(rows), Kind.EITHER, dtype=np.int8)
    touches = Touches(wrench[rows], position, frame, air.basis[rows], recording.sweep[rows], rows, around[rows], kind)
    free = np.ones(TARE + air.tare.size, dtype=bool)
    free[SHAPE:TARE] = False
    reference = replace(reference, origin=position.mean(axis=0))
    if not six:
        free[[TILT, TURN, TURN + 1, SENSOR + 2]] = False
        free[TARE:] = np.repeat(channels, air.basis.shape[1])
        # sweeps in a plane tell how far it is from the sphere's centre by the square only: its normal is one of the axes
        reference = replace(reference, axes=frame[0])
        free[[CLAMP + 2, PLACE + 2]] = np.ptp(position @ frame[0, :, 2]) > _PLANE * reference.size
    light = replace(rod, weight_N=0.0)
    nominal = Rig(
        stiffness=0.0,
        clamp=np.zeros(3),
        tilt=np.zeros(2),
        turn=np.eye(3),
        sensor=np.zeros(3),
        reference=reference,
        length=1.0,
        tare=air.tare,
        mixing=np.zeros((6, 6)),
        stated=light.in_space(),
        shape=np.zeros(3),
        marched=not light.is_simple,
    )
    return Problem(touches, air, channels, free), nominal


def _settled(problem: Problem, rig: Rig, noise: Noise, length: float | None, estimate: bool) -> Fit:
    """The fit of rows that their neighbours choose, with the kinds of contacts and the noise of the poses at rest."""
    seen: set[tuple[bytes, bytes]] = set()
    for _ in range(_ROUNDS):
        problem.free[MIXING:TARE] = noise.mixing > 0
        chosen, rig = _with_kinds(_strong(problem, rig, noise), rig, noise, length)
        # a rod whose shape is sought takes long, and a shape that is one is soon found from the first rig
        fit = fitted(chosen, rig, noise, *[_BEGUN] * bool(problem.free[SHAPE] and not seen))
        if problem.free[SHAPE] and not fit.at_rest:
            break
        rig, length = fit.rig, fit.rig.length if chosen.free[LENGTH] else None
        noise = estimates(fit, estimate)
        # few rows may alternate between two states
        state = chosen.touches.number.tobytes(), chosen.touches.kind.tobytes()
        if state in seen and np.allclose(noise, fit.noise, rtol=_SAME_NOISE, atol=NEGLIGIBLE):
            break
        seen.add(state)
    return fit


def _strong(problem: Problem, rig: Rig, noise: Noise) -> Problem:
    """The rows whose contacts are known well enough along the rod, by their neighbours."""
    scale = np.exp(-rig.stiffness)
    force, moment = clamp_wrench(rig, problem.touches._replace(wrench=problem.touches.around))
    by_s1 = scale * bent(rig, scale * force, scale * moment).by_s1
    deviation = np.repeat([noise.force, np.hypot(noise.moment, np.linalg.norm(rig.sensor) * noise.force)], 3)
    with np.errstate(invalid="ignore"):
        strong = np.linalg.norm(by_s1 * deviation, axis=1) < _ALONG * rig.reference.size
    if (count := int(strong.sum())) < FEWEST:
        raise _no_fit(
            rig.reference,
            f", or touch it too lightly: {count} rows place the contact to {rig.reference.extent}, and a calibration needs "
            f"{FEWEST}",
        )
    return problem.rows(strong)


def _with_kinds(
    problem: Problem, rig: Rig, noise: Noise, length: float | None, slack: float = 0.0
) -> tuple[Problem, Rig]:
    """The problem with the kinds of contacts that their neighbours make likelier, and the rig with its free length.

    `length` is that length if it is known; otherwise the contacts tell with which one they are likeliest.  Without tip
    contacts it is not sought.  A tangential contact does not lie past the tip, and at the tip the rod does not point away
    from the reference: what contradicts this counts as a misfit as well.
    """
    tangential, tip = (
        adjusted(problem.with_kinds(np.full_like(problem.touches.kind, kind)), rig, noise, slack=slack)
        for kind in (Kind.TANGENTIAL, Kind.TIP)
    )
    known = tangential.used[:, 3] & tip.used[:, 3]
    variances = noise.variances(problem)
    cosine_sd, s1_sd = (
        np.sqrt((rows.by_row[:, 3] ** 2 * variances).sum(axis=1) + slack**2 + ~known) for rows in (tangential, tip)
    )
    tried = [rig.length if length is None else length]
    if length is None and known.any():
        tried = list(rig.length + np.quantile(tip.misclosure[known, 3], _LENGTHS))
    costs = []
    for shift in rig.length - np.array(tried):
        # a shorter rod moves the fourth equation of the tip only
        as_tip = tip.white + shift * tip.factor[:, :, 3]
        costs.append(
            (
                (tangential.white**2).sum(axis=1) + np.maximum((tip.misclosure[:, 3] + shift) / s1_sd, 0) ** 2,
                (as_tip**2).sum(axis=1) + np.maximum(tangential.misclosure[:, 3] / cosine_sd, 0) ** 2,
            )
        )
    best = int(np.argmin([np.minimum(*cost)[known].sum() for cost in costs]))
    likelier = np.where(known, costs[best][0] - costs[best][1], 0.0)
    kind = _by_neighbours(likelier, problem.touches.sweep)
    # a few rows that contradict their neighbours, such as those after a jump, would spoil the fit of all
    kind[np.where(kind == Kind.TIP, -likelier, likelier) > CHANCE**2] = Kind.UNSURE
    tips = kind == Kind.TIP
    if tips.sum() < _FEWEST_TIPS:
        kind[tips] = Kind.UNSURE
    free = problem.free.copy()
    free[LENGTH] &= bool((kind == Kind.TIP).any())
    return replace(problem.with_kinds(kind), free=free), replace(rig, length=float(tried[best]))


def _by_neighbours(likelier: Array, sweep: NDArray[np.int64]) -> NDArray[np.int8]:
    """The kinds (n,) of contacts, by how much likelier the tip is for the rows before and after them in their sweep.

    Contacts change their kind now and then.  A change costs as much as the evidence that makes a kind certain, so that no
    more than this is handed on from row to row (the Viterbi algorithm for two states).
    """
    kind = np.full(len(likelier), Kind.UNSURE, dtype=np.int8)
    for number in np.unique(sweep):
        rows = np.flatnonzero(sweep == number)
        around = np.zeros(len(rows))
        for order in (slice(None), slice(None, None, -1)):
            total = 0.0
            for place in np.arange(len(rows))[order]:
                around[place] += total
                total = min(max(total + float(likelier[rows[place]]), -_LIKELIER), _LIKELIER)
        kind[rows[around <= -_LIKELIER]] = Kind.TANGENTIAL
        kind[rows[around >= _LIKELIER]] = Kind.TIP
    return kind


def _determined(problem: Problem, rig: Rig, normal: Array) -> Mask:
    """The parameters (p,) that a normal matrix determines; of those it determines only together, some are left out."""
    free = problem.free.copy()
    widths, order = problem.widths, problem.ranks
    while True:
        rows = np.flatnonzero(free)
        size, vectors = np.linalg.eigh((normal * widths[:, None] * widths)[np.ix_(rows, rows)])
        if size[0] > max(1.0, ROUNDING * size[-1]):
            break
        part = np.abs(vectors[:, 0]) * order[rows]
        if part.max() < _PART:
            raise InputError(f"the touches do not determine the {rig.reference.kind}'s place: {MORE_SWEEPS}")
        free[rows[np.argmax(part)]] = False
    about_rod = rows == TURN + 1
    if about_rod.any():
        variance = float(((vectors[about_rod] * widths[TURN + 1]) ** 2 / size).sum())
        free[TURN + 1] = variance < _ABOUT_ROD**2
    return free


def _at_nominal(rig: Rig, nominal: Rig, free: Mask) -> Rig:
    """The rig with the parameters that are not determined at their nominal values."""
    return replace(
        rig,
        stiffness=rig.stiffness if free[STIFFNESS] else nominal.stiffness,
        clamp=np.where(free[CLAMP:TILT], rig.clamp, nominal.clamp),
        tilt=np.where(free[TILT:TURN], rig.tilt, nominal.tilt),
        turn=rig.turn if free[TURN:SENSOR].any() else nominal.turn,
        sensor=np.where(free[SENSOR:PLACE], rig.sensor, nominal.sensor),
        length=rig.length if free[LENGTH] else nominal.length,
        shape=np.where(free[SHAPE:MIXING], rig.shape, nominal.shape),
    )


def _check(fit: Fit, recording: Recording) -> None:
    """Raise InputError for a fit that is none, with what was seen."""
    used, noise = fit.rows.used[:, 2], fit.noise
    usable = used.sum() >= max(FEWEST, 0.3 * len(used))
    normal = np.diag(fit.normal)[fit.problem.free]
    known = np.isfinite(normal).all() and (normal > 0).all()
    # what deviates by more is not a rod, or not a sensor, that is read rightly, or not this reference
    fits = noise.relative <= 0.1 and noise.place <= 10 * ROBOTS
    if fits and fit.at_rest and usable and known and abs(fit.rig.stiffness) < 2.5:
        return
    seen = (
        [f"force and moment contradict a single force by {share(noise.relative)}"] if fit.problem.channels.all() else []
    )
    seen.append(f"the noise in the air is {share(in_air(fit))}")
    if used.any():
        away = recording.rod.length_m * _away(fit)
        seen.append(f"{used.sum()} of {len(used)} contacts lie {length(away, 'm', digits=2)} from it in the median")
    raise _no_fit(fit.rig.reference, f" ({', '.join(seen)})")


def _away(fit: Fit) -> float:
    """The median distance of the contacts from the reference, in rod lengths; NaN without any."""
    away = np.abs(fit.rows.misclosure[fit.rows.used[:, 2], 2])
    return float(np.median(away)) if len(away) else math.nan


def _no_fit(reference: Reference, detail: str) -> InputError:
    return InputError(
        f"the touches do not fit {reference.title}{detail}: check {reference.check}, the rod, the units and signs of forces "
        f"and moments, that each sweep begins and ends in the air, and that the {reference.kind} did not move"
    )


# Rows by which the rig is sought on the grid and then improved.
_SEARCHED, _IMPROVED = 150, 400
# The grid: turns about the rod, distances along it in rod lengths, and logarithms of the stiffness; and the turns of a
# planar sensor about the normal of its plane.  From its best points a fit is begun, and that from the best one ended.
_TURNS, _DISTANCES = np.radians(np.arange(0, 360, 15)), np.linspace(-1.0, 1.0, 21)
_STIFFNESS, _PLANAR_TURNS = np.log([0.5, 0.7, 1.0, 1.4, 2.0]), np.radians(np.arange(-60, 61, 15))
_POINTS, _BEGUN = 4, 12
# Best points from which the shape of a rod is sought.
_SHAPES = 3
# The second smallest singular value must exceed the smallest by this factor for the rod's direction to follow from the wrench.
_DISTINCT = 1.3
# Contacts are far from the tip within this part of the quantile of s1 that serves as the largest.
_FAR, _FARTHEST = 0.85, 0.98
_ALONG_ROD = np.array([0.0, 1.0, 0.0])


def first_rig(problem: Problem, nominal: Rig, noise: Noise) -> Rig:
    """A rig whose contacts lie near the reference and, where they are far from the tip, are tangential."""
    free = problem.free.copy()
    free[LENGTH:] = False  # the tare is that of the rows in the air
    # a straight and uniform rod, of which the fit in closed form is fast, is a start for one whose shape is sought
    nominal = replace(nominal, marched=not nominal.stated.is_straight_and_uniform)
    # contacts of light touches are far from linear in the noise
    force = np.linalg.norm((problem.touches.wrench - problem.touches.basis @ nominal.tare.T)[:, :3], axis=1)
    heavy = np.flatnonzero(force >= np.median(force))
    coarse = replace(problem.rows(evenly(heavy, _IMPROVED)), free=free)
    searched = coarse.touches.rows(evenly(np.arange(len(coarse.touches.kind)), _SEARCHED))
    if problem.channels.all():
        turns, frames, offsets = _TURNS, *_by_consistency(nominal, coarse.touches, noise)
    else:
        frames = [Rotation.from_euler("z", angle).as_matrix() for angle in _PLANAR_TURNS]
        turns, offsets = np.zeros(1), [nominal.sensor] * len(frames)
    grid = [
        scored
        for frame, offset in zip(frames, offsets, strict=True)
        for scored in _on_grid(replace(nominal, turn=frame, sensor=offset), searched, turns, free)
    ]
    rigs = [rig for _, rig in sorted(grid, key=lambda scored: scored[0])[:_POINTS]]
    rigs += [replace(nominal, reference=rig.reference) for rig in rigs[:1]]
    if not rigs:
        return nominal
    # a rod that is not straight leads exact fits astray, unless contacts and wrenches may be off by its shape
    rough = noise._replace(place=_SHAPELESS, relative=_SHAPELESS)
    begun = [fitted(_far_from_tip(coarse, rig), rig, rough, _BEGUN) for rig in rigs]
    begun.sort(key=lambda fit: fit.cost)
    best = begun[0].rig
    if problem.free[SHAPE]:
        if not _away(begun[0]) < 10 * ROBOTS:  # as far as contacts of no fit
            raise _no_fit(best.reference, "")
        free[SHAPE:MIXING] = problem.free[SHAPE:MIXING]
        coarse = replace(problem.rows(evenly(heavy, _SEARCHED)), free=free)
        return _with_shape(coarse, [fit.rig for fit in begun], noise, rough)
    return fitted(_far_from_tip(coarse, best), best, noise).rig


def _with_shape(problem: Problem, rigs: list[Rig], noise: Noise, rough: Noise) -> Rig:
    """The first of rigs with straight rods, the best ones first, from which a fit leads to a shape that noise explains, or
    the one with the best fit."""
    found: list[Fit] = []
    for rig in rigs[:_SHAPES]:
        rig = replace(rig, marched=True)
        begun = fitted(_far_from_tip(problem, rig), rig, rough, _BEGUN).rig
        found.append(fitted(_far_from_tip(problem, begun), begun, noise, _BEGUN))
        if found[-1].at_rest and found[-1].cost < found[-1].freedom + CHANCE * math.sqrt(2 * found[-1].freedom):
            break
    return min(found, key=lambda fit: fit.cost).rig


def _far_from_tip(problem: Problem, rig: Rig) -> Problem:
    """The problem in which contacts that are certainly not at the tip are tangential; for a rough rig."""
    s1 = contacts(rig, problem.touches)[1]
    known = s1[np.isfinite(s1)]
    far = s1 < _FAR * np.quantile(known, _FARTHEST) if len(known) else np.zeros(len(s1), dtype=bool)
    return problem.with_kinds(np.where(far, Kind.TANGENTIAL, Kind.EITHER).astype(np.int8))


def _by_consistency(nominal: Rig, touches: Touches, noise: Noise) -> tuple[list[Array], list[Array]]:
    """Turns of the sensor, up to one about the rod, and its places, up to one along the rod."""
    tared = touches.wrench - touches.basis @ nominal.tare.T
    deviation = np.repeat([noise.moment, noise.force], 3)
    _, size, rows = np.linalg.svd(np.roll(tared, 3, axis=1) / deviation, full_matrices=False)
    along, offset = _ALONG_ROD, np.zeros(3)
    if size[-2] > _DISTINCT * size[-1]:
        solution = rows[-1] / deviation
        along, cross = solution[:3] / np.linalg.norm(solution[:3]), solution[3:] / np.linalg.norm(solution[:3])
        offset = np.cross(cross, along)
    frames = [Rotation.align_vectors([_ALONG_ROD], [axis])[0].as_matrix() for axis in (along, -along)]
    return frames, [frame @ offset for frame in frames]


def _on_grid(rig: Rig, touches: Touches, turns: Array, free: Mask) -> list[tuple[float, Rig]]:
    """Rigs of the grid about a rig, with the median distance of their contacts from the reference."""
    scored = []
    outside = touches.position.mean(axis=0)
    turned = Rotation.from_rotvec(np.outer(turns, _ALONG_ROD)).as_matrix()
    for along in _DISTANCES:
        for stiffness in _STIFFNESS:
            moved = replace(rig, sensor=rig.sensor + along * _ALONG_ROD, stiffness=float(stiffness))
            point = contacts(moved, touches)[0]
            known: Mask = np.asarray(np.isfinite(point).all(axis=1))
            if known.sum() < max(len(known) / 2, 8):
                continue
            world = np.einsum("nij,tjk,nk->tni", touches.frame[known], turned, point[known]) + touches.position[known]
            best, reference, misfit = rig.reference.nearest(world, outside)
            # what is not sought of its place is that of the nominal rig
            back = reference.axes.T @ (rig.reference.origin - reference.origin)
            reference = reference.moved(np.where(free[PLACE:LENGTH], 0.0, back))
            better = replace(
                moved,
                turn=turned[best] @ rig.turn,
                sensor=turned[best] @ moved.sensor,
                reference=reference,
            )
            scored.append((misfit + float((~known).mean()), better))
    return scored
