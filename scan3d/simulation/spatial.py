"""Simulation of a scan in space (step 1): a round rod is swept past a body from many directions, free to leave its plane."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.planning.plan import Lines, Plan, aimed, rasters
from scan3d.recording import Recording
from scan3d.rods import Rod
from scan3d.simulation.felt import check_simple, drawn_friction, recorded, rounded_body
from scan3d.spatial.bodies import RoundedPolyhedron
from scan3d.spatial.sweeping import Sweeps, sweep
from scan3d.spatial.touchdown import passages
from scan3d.units import UNITS_M

Progress = Callable[[int, int], None]

# Rounds in which the aimed sweeps are made.
_ROUNDS = 5
# Path before the touch-down, in rod lengths, at which a sweep begins.
_BEFORE = 1e-6


class _Swept(NamedTuple):
    """Sweeps and their clamps, in rod lengths."""

    position: Array
    """(m, n, 3)"""
    axes: Array
    """(m, 3, 3)"""
    result: Sweeps


def simulate_spatial(mesh: Any, plan: Plan, progress: Progress | None = None) -> Recording:
    """Recording of a scan in space of a convex `trimesh.Trimesh`, with six axes.

    The rod's centre line touches the mesh fattened by the rod's radius.  Raises InputError if the rod touches nothing.
    """
    metres = UNITS_M[plan.unit]
    vertices = np.asarray(mesh.vertices, dtype=float)
    rod = plan.rod or Rod.of_length(metres * float(np.ptp(vertices, axis=0).max()))
    check_simple(rod)
    length = rod.length_m / metres
    body, middle = rounded_body(mesh, length, rod.diameter_m / metres / 2)
    points = (vertices - middle) / length
    per_direction = plan.sweeps or max(2, round(0.4 * plan.slices))
    swept = _sweep(body, rasters(points, per_direction, plan.clearance), plan, 0)
    if not swept:
        raise InputError(
            "the rod touches nothing: its sweeps do not reach the body; choose a longer rod or less clearance"
        )
    generator = np.random.default_rng([plan.seed, 2])
    # with these, a scan in space has at most one and a half times as many samples as a planar one
    further = 0 if plan.sweeps else round(3.5 * 12 * per_direction / _ROUNDS)
    for number in range(_ROUNDS if further else 0):
        contacts, normals = (
            np.concatenate([vectors[np.isfinite(part.result.s1)] for part, vectors in zip(swept, columns, strict=True)])
            for columns in ([part.result.point for part in swept], [part.result.normal for part in swept])
        )
        if len(contacts) < 4:
            break
        if progress is not None:
            progress(1 + number, 1 + _ROUNDS)
        lines = aimed(contacts, normals, further, generator)
        swept += _sweep(body, lines, plan, 1 + number)
    if progress is not None:
        progress(1 + _ROUNDS, 1 + _ROUNDS)
    return _recording(swept, plan, rod, middle, length)


def _sweep(body: RoundedPolyhedron, lines: Lines, plan: Plan, number: int) -> list[_Swept]:
    """Sweep along those lines on which the rod touches the body; an empty list if there are none."""
    x, y = lines.axes[:, 0].T, lines.axes[:, 1].T
    reach = 2 * np.abs(body.vertices).max() + 1
    start = lines.origin.T + reach * x
    passage = passages(body, start, y, -x)
    rows = np.flatnonzero(passage.touches & (passage.end > passage.begin + _BEFORE))
    if not len(rows):
        return []
    begin, end = passage.begin[rows], passage.end[rows]
    # a sweep that is aimed at a place touches it at the beginning, where its samples are dense
    samples = max(2, round(0.35 * plan.samples)) if number else plan.samples
    spacing = np.linspace(0, 1, samples) ** (2 if number else 1)
    # the bent rod may follow the body
    distance = begin[:, None] - _BEFORE + (1.1 * (end - begin))[:, None] * spacing
    position = (start[:, rows, None] - distance * x[:, rows, None]).transpose(1, 2, 0)
    # where rod and face are nearly parallel, the touch-down is found to some thousandths only, and may lie before the beginning
    again = passages(body, position[:, 0].T, y[:, rows], (position[:, -1] - position[:, 0]).T)
    clear = again.touches & (again.begin >= 0)
    rows, position = rows[clear], position[clear]
    if not len(rows):
        return []
    keys = [[plan.seed, 3, number, int(row)] for row in rows]
    friction = np.array([drawn_friction(plan.friction_range, samples, key) for key in keys])
    axes = lines.axes[rows]
    result = sweep(body, position, axes, friction, effort=400)
    return [_Swept(position, axes, result)]


def _recording(swept: list[_Swept], plan: Plan, rod: Rod, middle: Array, length: float) -> Recording:
    """The recording of all sweeps, as a rig would log it, each up to the first sample after its last contact.

    A sweep ends before its contact comes so near to the clamp that the clamp would soon hit the body.
    """
    number, position, wrench, sweeps = [], [], [], 0
    for part in swept:
        # in rod lengths: the force grows without limit
        too_near = np.maximum.accumulate(part.result.s1 < 0.2, axis=1)
        touching = np.isfinite(part.result.s1) & ~too_near
        n = touching.shape[1]
        last = np.where(touching.any(axis=1), n - np.argmax(touching[:, ::-1], axis=1), 0)
        kept = (np.arange(n) <= last[:, None]) & ~too_near
        number.append(sweeps + np.nonzero(kept)[0])
        sweeps += len(touching)
        position.append(part.position[kept] * length + middle)
        wrench.append(np.hstack([part.result.force[kept], part.result.moment[kept]]))
    axes = np.concatenate([part.axes for part in swept])
    rows = np.concatenate(number), np.concatenate(position), np.concatenate(wrench)
    return recorded(plan, rod, axes, *rows, {"model": "spatial"})
