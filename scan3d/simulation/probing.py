"""Probings, simulated: the clamp moves along its own y axis until the force of the rod's end on the body has a given size.

The end first meets the body where the line along the rod crosses its surface, or where a bead about the end first touches it,
across the line from there to the bead's centre.  Where the surface's normal is within the friction angle of the rod's axis,
the end stays there, and the force is along the rod.  Else the end slides aside: the force is on the edge of the friction cone,
in the plane of axis and normal, and bends the rod.  The end is then where the line crosses the surface that is as far beside as
the rod is bent, which is found by iteration.  It ends at once on a plane face; where the end comes to a groove, or slips off an
edge, it does not, and the probing is left out.  So is one whose end slips over a bump, on which the rod itself lies then.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from scan3d.arrays import Array, Mask, unit_or_zero
from scan3d.geometry.crossings import first_met, first_touches
from scan3d.geometry.triangles import face_normals
from scan3d.planning.plan import Plan
from scan3d.planning.probing import PER_ROUND, PLANES, Probings, Unknown
from scan3d.reconstruction import NoContactError
from scan3d.reconstruction.probings import contacts, free_lines
from scan3d.recording import Recording, joined
from scan3d.rods import Rod
from scan3d.simulation.felt import drawn_friction, recorded
from scan3d.spatial.bodies import cross
from scan3d.spatial.march import ends, free_reactions, shapes
from scan3d.units import UNITS_M
from scan3d.workers import tell

# Rounds of the iteration, and by how much a place changes at its end, in rod lengths.
_ROUNDS, _SETTLED = 10, 1e-12
# Rods that may be deeper in the body than this, in rod lengths, are held against it: so many lines, for so many places of the
# rod, and what part of the way that its end slid may remain.
_DEEP, _BESIDE, _PLACES, _SLID = 1e-6, 4, 33, 0.01


def probe(mesh: Any, plan: Plan, rod: Rod, swept: Sequence[Recording] = ()) -> Recording:
    """Recording of probings of a closed `trimesh.Trimesh` of any shape, after sweeps that were recorded, if there are any.

    Round after round they go where most is unknown, as contacts and free places tell.
    """
    length, most = rod.length_m / UNITS_M[plan.unit], PLANES * plan.slices
    unknown, recordings, planes = Unknown(mesh.bounds[0], mesh.bounds[1], length, [plan.seed]), list(swept), 0
    planned = unknown.first_round()
    while planned.planes:
        part = recorded_probings(mesh, planned.moves, plan, rod, length, len(recordings))
        recordings.append(part)
        planes += planned.planes
        with suppress(NoContactError):
            cloud = contacts(part, plan.model)
            unknown.add(cloud.points, part.axes()[cloud.row, 1], free_lines(part, cloud))
        tell("planes of probings", min(planes, most), most)
        if plan.known and unknown.known() >= plan.known:
            break
        planned = unknown.next_round(min(PER_ROUND, most - planes))
    found = joined(recordings)
    unresolved = sum(recording.source.get("unresolved", 0) for recording in recordings)
    return replace(found, source={**found.source, "unresolved": unresolved})


def recorded_probings(mesh: Any, moves: Probings, plan: Plan, rod: Rod, length: float, part: int) -> Recording:
    """What a rig logs of probings: two samples of each, at its begin and at its end."""
    n = len(moves.start)
    friction = drawn_friction(plan.friction_range, n, [plan.seed, 5, part])
    found = felt_along(
        mesh, moves, rod, length, friction, plan.stop_force_of(rod), plan.down(moves.axes), plan.model == "planar"
    )
    known = found.resolved
    end = moves.start + found.travel[:, None] * moves.axes[:, 1]
    position = np.stack([moves.start, end], axis=1)[known].reshape(-1, 3)
    reactions = np.concatenate([found.force, found.moment], axis=1)
    wrench = np.stack([found.free, reactions], axis=1)[known].reshape(-1, 6)
    if plan.gravity is not None and plan.gravity.tared:
        wrench -= np.repeat(found.free[known], 2, axis=0)
    wrench = wrench if plan.model == "spatial" else wrench[:, [0, 1, 5]]
    number = np.repeat(np.arange(int(known.sum())), 2)
    source = {
        "convex": False,
        "unresolved": int((~known).sum()),
        **({"model": "spatial"} if plan.model == "spatial" else {}),
    }
    return recorded(plan, rod, moves.axes[known], number, position, wrench, source, part)


class Felt(NamedTuple):
    """What is felt in probings (n,), in units of the rod."""

    travel: Array
    """(n,) how far the clamp went, in the mesh's unit."""
    force: Array
    """(n, 3) support reaction in the clamp's frame at the end."""
    moment: Array
    """(n, 3)"""
    touches: Mask
    """(n,)"""
    resolved: Mask
    """(n,) whether it is known what is felt."""
    free: Array
    """(n, 6) support reaction and moment without contact."""


def felt_along(
    mesh: Any,
    moves: Probings,
    rod: Rod,
    length: float,
    friction: Array,
    stop: float,
    gravity: Array | None,
    planar: bool,
) -> Felt:
    """What a rod feels that moves along itself.

    mesh
        a closed `trimesh.Trimesh` of any shape.
    length
        of the rod, in the mesh's unit.
    friction (n,), stop
        coefficients of friction, and the size of the contact force, in EI/L², at which the clamp stops.
    gravity (n, 3)
        unit vectors in the clamp's frame; None for rods without weight.
    planar
        whether the rod stays in the clamp's plane of x and y, as in the planar model.
    """
    n, bent = len(moves.start), rod.in_space()
    down = None if gravity is None else gravity.T
    weight = np.zeros((3, n)) if down is None else -bent.profile.weight * down
    in_air = free_reactions(bent, down)[1] if down is not None else np.zeros((3, n))
    hanging = ends(bent, weight, in_air, down).point
    bead = rod.bead_diameter_m / 2 * length / rod.length_m
    normals = face_normals(mesh)

    def met_by(start: Array, along: Array) -> tuple[Array, Array]:
        if bead:
            return first_touches(mesh, start, along, bead)
        far, face = first_met(mesh, start, along)
        return far, normals[face]

    point, force, moment, onto = hanging.copy(), weight.copy(), in_air.copy(), np.zeros((3, n))
    earlier, distance, active = np.full((6, n), np.nan), np.full(n, np.inf), np.arange(n)
    resolved, steps = np.ones(n, dtype=bool), None
    for number in range(_ROUNDS):
        beside = point[:, active].copy()
        beside[1] = 0.0
        start = moves.start[active] + length * np.einsum("in,nij->nj", beside, moves.axes[active])
        far, normal = met_by(start, moves.axes[active, 1])
        distance[active] = far
        if not number:
            first = distance.copy()
        met = np.isfinite(far)
        if number:  # a rod that is bent touches something
            resolved[active] &= met
        active = active[met]
        local = np.einsum("nij,nj->ni", moves.axes[active], normal[met])
        if planar:
            local[:, 2] = 0.0
        pushed = stop * _direction(local, np.arctan(friction[active])).T
        before, last = point[:, active], np.concatenate([force[:, active], onto[:, active]])
        # of the force on the surface of the bead about its centre
        at_end = cross(-bead / length * local.T, pushed)
        load = np.concatenate([weight[:, active] - pushed, at_end])
        moment[:, active] += cross(before, load[:3] - last[:3]) - (load[3:] - last[3:])
        force[:, active], onto[:, active] = load[:3], load[3:]
        # pushed off each of two faces onto the other, it would rest on the edge between, where there is no normal
        changed, edge = (load != last).any(axis=0), (load == earlier[:, active]).all(axis=0)
        resolved[active[changed & edge]] = False
        earlier[:, active] = last
        # a rod that meets places with the same normal again is bent alike
        rows = active[(changed & ~edge) | (number == 0)]
        for _ in range(_ROUNDS):
            # the forces of later rounds hardly differ, so that as many steps are enough
            found = ends(bent, force[:, rows], moment[:, rows], None if down is None else down[:, rows], steps)
            steps = found.steps
            change = found.moment - onto[:, rows]
            moment[:, rows] += change
            moved = np.abs(np.concatenate([(found.point - point[:, rows])[[0, 2]], change])).max(axis=0, initial=0.0)
            point[:, rows] = found.point
            rows = rows[moved > _SETTLED]
            if not len(rows):
                break
        resolved[rows] = False
        active = active[np.abs((point[:, active] - before)[[0, 2]]).max(axis=0, initial=0.0) > _SETTLED]
        if not len(active):
            break
    resolved[active] = False
    travel = distance - length * point[1]
    touches = resolved & (travel <= moves.travel) & np.isfinite(distance)
    # a body that is met at once has been touched before
    resolved &= ~(touches & (travel < 0))
    # the end's slope is 3/2 of its way aside over the rod's length, so that no rod is deeper in the body than this
    aside = np.sqrt(((point - hanging)[[0, 2]] ** 2).sum(axis=0))
    slid = np.flatnonzero(resolved & touches)
    slid = slid[1.5 * aside[slid] * np.abs(distance[slid] - first[slid]) > _DEEP * length]
    below = None if down is None else down[:, slid]
    bent_to = shapes(bent, force[:, slid], moment[:, slid], below, _PLACES, at_end=True)[0]
    resolved[slid] = _passes(
        mesh, moves.start[slid], moves.axes[slid], length * bent_to, travel[slid], first[slid], length
    )
    free = np.where(touches, 0.0, 1.0)
    return Felt(
        np.where(touches, travel, moves.travel),
        (free * weight + (1 - free) * force).T,
        (free * in_air + (1 - free) * moment).T,
        touches & resolved,
        resolved,
        np.concatenate([weight, in_air]).T,
    )


def _passes(mesh: Any, start: Array, axes: Array, rod: Array, travel: Array, met: Array, length: float) -> Mask:
    """Whether bent rods pass the body up to their ends (n,), which met it at distances `met` (n,) when they were straight.

    A rod is farther aside the nearer to its end.  So nothing is beside it before the place where a line along the axis first
    meets the body that goes through its place beside where a line farther inside met it.  These places come to where the rod
    lies on the body, which is its end, or not.

    rod (3, p, n)
        places along it in the clamp's frame.
    """
    reached, end = met.copy(), travel + rod[1, -1]
    rows = np.arange(len(end))
    for _ in range(_BESIDE):
        s = np.clip((reached[rows] - travel[rows]) / length, 0.0, 1.0) * (len(rod[0]) - 1)
        before = np.minimum(s.astype(np.intp), len(rod[0]) - 2)
        beside = rod[:, before, rows] + (s - before) * (rod[:, before + 1, rows] - rod[:, before, rows])
        beside[1] = 0.0
        reached[rows] = first_met(mesh, start[rows] + np.einsum("in,nij->nj", beside, axes[rows]), axes[rows, 1])[0]
        stopped = end - reached > _SLID * np.abs(end - met)
        rows = np.flatnonzero(stopped)
    return ~stopped


def _direction(normal: Array, friction_angle: Array) -> Array:
    """(n, 3) unit vectors of the force on a rod along y, as near to its axis as friction lets it be, by normals (n, 3)."""
    aside = unit_or_zero(normal * [1.0, 0.0, 1.0])
    tilt = np.arctan2(np.hypot(normal[:, 0], normal[:, 2]), -normal[:, 1])
    angle = np.maximum(tilt - friction_angle, 0.0)[:, None]
    return np.asarray(np.sin(angle) * aside - np.cos(angle) * [0.0, 1.0, 0.0])
