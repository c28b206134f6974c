"""First estimates of a rig, from which least squares converges.

The condition ``m0·t0 = 0`` in the sensor's frame is linear in the rod's direction u and in ``u × a``, with a the place of the
sensor: it gives both without a body.  The turn about the rod, the distance along it and the stiffness are then searched on a
grid: with the right ones the contacts lie on the reference.  For a known body, whose pose is sought as well, the grid tells
rigs whose contacts are at about one distance from a point, and for the best of them the pose is sought.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, Mask
from scan3d.laboratory.calibration_body import Body
from scan3d.laboratory.calibration_fit import Air, Noise, Problem, started
from scan3d.laboratory.calibration_model import LENGTH, PAST_TIP, Kind, Rig, Touches, clamp_wrench
from scan3d.laboratory.calibration_pose import poses
from scan3d.laboratory.calibration_reference import Reference
from scan3d.spatial.inverse import reconstruct

# Rows that the search uses.  More take longer; fewer may miss a part of the sphere.
_SEARCHED, _STARTED = 150, 400
# The grid: turns about the rod, distances along it in rod lengths, and logarithms of the stiffness.  The first is fine enough
# for damped least squares to converge from its nearest point, with the others up to twice as coarse.
_TURNS = np.radians(np.arange(0, 360, 15))
_ALONG = np.linspace(-1.0, 1.0, 21)
_STIFFNESS = np.log([0.5, 0.7, 1.0, 1.4, 2.0])
# Starts from the grid that are tried, and those that are fitted to the end.
_TRIED, _SHORT = 4, 12
# Rigs of the grid for which the pose of a body is sought, poses of each, and starts that are tried of them all.
_POSED, _POSES, _TRIED_POSES = 24, 2, 12
# The second smallest singular value must exceed the smallest by this factor for the rod's direction to follow from the wrench.
_DISTINCT = 3.0
# Turns of a planar sensor about the normal of its plane, in radians.
_PLANAR_TURNS = np.radians(np.arange(-60, 61, 15))
# Contacts are far from the tip within this part of the quantile of s1 that serves as the largest, for a first estimate.
_FAR, _FARTHEST = 0.85, 0.98


def first_rig(problem: Problem, nominal: Rig, noise: Noise) -> Rig:
    """A rig whose contacts lie near the reference and, where they are far from the tip, are tangential."""
    free = problem.free.copy()
    free[LENGTH:] = False  # the tare is that of the rows in the air
    air = problem.air
    no_air = Air(air.wrench[:0], air.basis[:0], air.rows[:0])
    # contacts of light touches are far from linear in the noise
    force = np.linalg.norm((problem.touches.wrench - problem.touches.basis @ nominal.tare.T)[:, :3], axis=1)
    heavy = problem.touches.rows(force >= np.median(force))
    coarse = replace(problem, touches=_thinned(heavy, _STARTED), air=no_air, free=free)
    turns = _TURNS
    if problem.channels.all():
        frames, offsets = _by_consistency(nominal, coarse.touches, noise)
    else:
        frames = [Rotation.from_euler("z", angle).as_matrix() for angle in _PLANAR_TURNS]
        offsets, turns = [nominal.sensor] * len(frames), np.zeros(1)
    searched = _thinned(coarse.touches, _SEARCHED)
    grid = [
        scored
        for frame, offset in zip(frames, offsets, strict=True)
        for scored in _on_grid(replace(nominal, turn=frame, sensor=offset), searched, turns, problem.reference)
    ]
    grid.sort(key=lambda scored: scored[0])
    count = _TRIED
    if isinstance(problem.reference, Body):
        count = _TRIED_POSES
        grid = _posed([rig for _, rig in grid[:_POSED]] + [nominal], searched, problem.reference)
    rigs = [rig for _, rig in grid[:count]]
    rigs += [replace(nominal, centre=rig.centre, axes=rig.axes) for rig in rigs[:1]]
    if not rigs:
        return nominal
    far = Kind.TANGENTIAL if problem.reference.smooth else Kind.ACROSS
    tried = [started(_far_from_tip(coarse, rig, far), rig, noise, _SHORT) for rig in rigs]
    best = min(tried, key=lambda pair: pair[1])[0]
    return started(_far_from_tip(coarse, best, far), best, noise)[0]


def _far_from_tip(problem: Problem, rig: Rig, far_kind: Kind) -> Problem:
    """The problem in which contacts that are certainly not at the tip are tangential, of a kind.

    At edges a rough rig may put them on the wrong edge, and equation 4 would not let them leave it.
    """
    scale = np.exp(-rig.stiffness)
    force, moment = clamp_wrench(rig, problem.touches)
    s1 = reconstruct(scale * force, scale * moment, tolerance=PAST_TIP).s1
    far = s1 < _FAR * np.nanquantile(s1, _FARTHEST) if np.isfinite(s1).any() else np.zeros(len(s1), dtype=bool)
    kind = np.where(far, far_kind, Kind.EITHER).astype(np.int8)
    return replace(problem, touches=problem.touches._replace(kind=kind))


def _by_consistency(nominal: Rig, touches: Touches, noise: Noise) -> tuple[list[Array], list[Array]]:
    """Turns of the sensor, up to one about the rod, and its places, up to one along the rod."""
    tared = touches.wrench - touches.basis @ nominal.tare.T
    deviation = np.repeat([noise.moment, noise.force], 3)
    _, size, rows = np.linalg.svd(np.roll(tared, 3, axis=1) / deviation)
    along, offset = nominal.turn.T[:, 1], np.zeros(3)
    if size[-2] > _DISTINCT * size[-1]:
        solution = rows[-1] / deviation
        along, cross = solution[:3] / np.linalg.norm(solution[:3]), solution[3:] / np.linalg.norm(solution[:3])
        offset = np.cross(cross, along)
    frames, offsets = [], []
    for axis in (along, -along):
        frame = _turning(axis, np.array([0.0, 1.0, 0.0]))
        frames.append(frame)
        offsets.append(frame @ offset)
    return frames, offsets


def _turning(one: Array, other: Array) -> Array:
    """The smallest rotation (3, 3) from one unit vector to another."""
    return np.asarray(Rotation.align_vectors(other[None], one[None])[0].as_matrix())


def _on_grid(rig: Rig, touches: Touches, turns: Array, reference: Reference) -> list[tuple[float, Rig]]:
    """Rigs of the grid about a rig, with the median distance of their contacts from the reference."""
    scored = []
    outside = touches.position.mean(axis=0)
    for along in _ALONG:
        moved = replace(rig, sensor=rig.sensor + np.array([0.0, along, 0.0]))
        force, moment = clamp_wrench(moved, touches)
        for stiffness in _STIFFNESS:
            point = reconstruct(force * np.exp(-stiffness), moment * np.exp(-stiffness), tolerance=PAST_TIP).point
            known: Mask = np.asarray(np.isfinite(point).all(axis=1))
            if known.sum() < max(len(known) / 2, 8):
                continue
            turned = Rotation.from_rotvec(np.column_stack([0 * turns, turns, 0 * turns])).as_matrix()
            world = np.einsum("nij,tjk,nk->tni", touches.frame[known], turned, point[known]) + touches.position[known]
            found = reference.located(world, outside)
            misfit = found.misfit + (~known).mean()
            best = int(np.argmin(misfit))
            better = replace(
                moved,
                stiffness=float(stiffness),
                turn=turned[best] @ rig.turn,
                sensor=turned[best] @ moved.sensor,
                centre=found.centre[best],
                axes=found.axes[best],
            )
            scored.append((float(misfit[best]), better))
    return scored


def _posed(rigs: list[Rig], touches: Touches, body: Body) -> list[tuple[float, Rig]]:
    """The rigs with the poses of a body that are nearest to their contacts, and the median distances, best first."""
    scored = []
    for rig in rigs:
        force, moment = clamp_wrench(rig, touches)
        scale = np.exp(-rig.stiffness)
        point = reconstruct(scale * force, scale * moment, tolerance=PAST_TIP).point
        world = touches.position + np.einsum("nij,nj->ni", touches.frame, point)
        known = np.isfinite(world).all(axis=1)
        if known.any():
            found = poses(body, world[known], _POSES)
            for centre, axes, misfit in zip(*found, strict=True):
                scored.append((float(misfit) + float((~known).mean()), replace(rig, centre=centre, axes=axes)))
    return sorted(scored, key=lambda pair: pair[0])


def _thinned(touches: Touches, count: int) -> Touches:
    n = len(touches.kind)
    return touches.rows(np.unique(np.linspace(0, n - 1, min(n, count)).astype(np.intp)))
