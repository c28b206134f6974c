"""A first rig, from which least squares converges.

The condition ``m0·t0 = 0`` in the sensor's frame is linear in the rod's direction u and in ``u × a``, with a the place of the
sensor: it gives both without a body.  The turn about the rod, the distance along it and the stiffness are then searched on a
grid: with the right ones the contacts lie on the reference.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, Mask, evenly
from scan3d.calibration.fit import Noise, Problem, fitted
from scan3d.calibration.model import LENGTH, PLACE, Kind, Rig, Touches, contacts

# Rows by which the rig is sought on the grid and then improved.
_SEARCHED, _IMPROVED = 150, 400
# The grid: turns about the rod, distances along it in rod lengths, and logarithms of the stiffness; and the turns of a
# planar sensor about the normal of its plane.  From its best points a fit is begun, and that from the best one ended.
_TURNS, _DISTANCES = np.radians(np.arange(0, 360, 15)), np.linspace(-1.0, 1.0, 21)
_STIFFNESS, _PLANAR_TURNS = np.log([0.5, 0.7, 1.0, 1.4, 2.0]), np.radians(np.arange(-60, 61, 15))
_POINTS, _BEGUN = 4, 12
# The second smallest singular value must exceed the smallest by this factor for the rod's direction to follow from the wrench.
_DISTINCT = 1.3
# Contacts are far from the tip within this part of the quantile of s1 that serves as the largest.
_FAR, _FARTHEST = 0.85, 0.98
_ALONG_ROD = np.array([0.0, 1.0, 0.0])


def first_rig(problem: Problem, nominal: Rig, noise: Noise) -> Rig:
    """A rig whose contacts lie near the reference and, where they are far from the tip, are tangential."""
    free = problem.free.copy()
    free[LENGTH:] = False  # the tare is that of the rows in the air
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
    begun = [fitted(_far_from_tip(coarse, rig), rig, noise, _BEGUN) for rig in rigs]
    best = min(begun, key=lambda fit: fit.cost).rig
    return fitted(_far_from_tip(coarse, best), best, noise).rig


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
