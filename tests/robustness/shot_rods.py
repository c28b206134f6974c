"""Sweeps with rods that are not straight, uniform and weightless in a rigid clamp, by shooting.

Nothing of `planar` bends these rods.  With the angle φ of the rod, the moment M, the force N beyond a place s, the stiffness
B, the free curvature κ₀, the weight w beyond s and the direction g of gravity a rod obeys, in units of its length and of its
stiffness at the clamp,

    φ' = M / B + κ₀,   M' = N_x sin φ - N_y cos φ,   x' = cos φ,   y' = sin φ,   N = F + w g,

where F is the contact's force, 0 beyond the contact.  The clamp gives by its compliance c: ``φ(0) = π/2 + c M(0)``.  At a place
of the contour Coulomb's friction says the direction of F.  Its size, and the angle of the tip or the arc length of the contact,
and under weight the angle of the free end, are corrected until the rod ends at the clamp.  It is integrated by the method of
order 8 of Dormand and Prince in fixed steps, for all places at once.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.integrate import DOP853

from scan3d.geometry.sections import slice_frame, slice_polygons

STEPS = 6
"""Steps of the integration; the last correction of all."""
# Places of the path along a contour, and the slopes between which it is followed.
_PLACES, _FIRST, _LAST = 96, np.radians(88.0), np.radians(-65.0)
# Nodes and weights on [0, 1] for the integrals of the uniform rod, which the corrections start from.
_NODES, _WEIGHTS = (np.polynomial.legendre.leggauss(16) + np.array([[1.0], [0.0]])) / 2
# Residuals of a rod that is solved, and the shortest arc length to a contact.
_SOLVED, _SHORTEST = 1e-9, 0.05


class Bent(NamedTuple):
    """A rod in units of its length and of its stiffness at the clamp."""

    tip: float = 1.0
    """Diameter of the cone's tip over that at the clamp."""
    curvature: float = 0.0
    compliance: float = 0.0
    weight: float = 0.0
    """Of a uniform rod."""

    def part(self, share):
        """The rod on the way from the straight, uniform, weightless one."""
        return Bent(1 + share * (self.tip - 1), *(share * value for value in self[1:]))


class States(NamedTuple):
    """Equilibria (n,) at places of a contour; those that are none have the force NaN."""

    x0: np.ndarray
    reactions: np.ndarray
    """(n, 3) f0x, f0y, m0z."""
    s1: np.ndarray
    angle: np.ndarray
    """Of the rod at the contact."""


def marched(rod, state, start, end, force, down, steps):
    """The states (4, n) φ, M, x, y at `end` (n,) of those at `start` (n,), with the force (2, n) of the contact."""
    h, s = (end - start) / steps, np.array(start, dtype=float)

    def slopes(s, state):
        phi, moment = state[:2]
        north = force + rod.weight * (1 - s) * down if rod.weight else force
        cos, sin = np.cos(phi), np.sin(phi)
        return np.stack(
            [moment / (1 + (rod.tip - 1) * s) ** 4 + rod.curvature, north[0] * sin - north[1] * cos, cos, sin]
        )

    for _ in range(steps):
        stages = np.empty((DOP853.n_stages, *state.shape))
        for i, (a, c) in enumerate(zip(DOP853.A, DOP853.C, strict=True)):
            stages[i] = slopes(s + c * h, state + h * np.tensordot(a[:i], stages[:i], 1) if i else state)
        state, s = state + h * np.tensordot(DOP853.B, stages, 1), s + h
    return state


def free(rod, down):
    """(3, n) reactions of the rod in the air, with gravity (2, n)."""
    n = down.shape[1]
    if not rod.weight:
        return np.zeros((3, n))

    def ended(u):
        start = np.stack([u[0], *np.zeros((3, n))])
        end = marched(rod, start, np.ones(n), np.zeros(n), np.zeros((2, n)), down, STEPS)
        return (end[0] - np.pi / 2 - rod.compliance * end[1])[None], end

    _, _, end = _corrected(ended, np.full((1, n), np.pi / 2), 8)
    return np.stack([*(-rod.weight * down), -end[1]])


def _corrected(ended, u, times):
    """Newton's method for unknowns (k, n) of n independent problems; them, their residuals and the rods' ends."""
    k, step = len(u), 1e-6
    for _ in range(times):
        value = ended(u)[0]
        jacobian = np.stack([(ended(u + step * np.eye(k)[:, [j]])[0] - value) / step for j in range(k)], axis=-1)
        jacobian = np.nan_to_num(np.moveaxis(jacobian, 1, 0), nan=1.0) + 1e-300 * np.eye(k)
        u = u + np.clip(np.linalg.solve(jacobian, -value.T[:, :, None])[:, :, 0].T, -0.3, 0.3)
    return u, *ended(u)


def _uniform(angle, alpha):
    """Length and height, times the root of the force, of a uniform rod that ends with an angle."""
    span = (np.pi / 2 - angle)[..., None]
    phi = angle[..., None] + span * _NODES**2
    least = np.sin(angle - alpha)[..., None]
    by_length = 2 * span * _NODES * _WEIGHTS / np.sqrt(2 * (np.sin(phi - alpha[..., None]) - least))
    return by_length.sum(axis=-1), (by_length * np.sin(phi)).sum(axis=-1)


def _started(height, slope, alpha):
    """What the corrections start from: root of the force, and the angle of the tip or the arc length of the contact (2, n)."""
    length, up = _uniform(slope, alpha)
    angles = slope + (np.pi / 2 - slope) * np.linspace(0, 0.999, 40)[:, None]
    lengths, heights = _uniform(angles, np.broadcast_to(alpha, angles.shape))
    over, each = heights / lengths - height, np.arange(len(height))
    k = np.argmax((over[1:] >= 0) & (over[:-1] < 0), axis=0)
    share = over[k, each] / (over[k, each] - over[k + 1, each])
    at_tip = [part[k, each] + share * (part[k + 1, each] - part[k, each]) for part in (lengths, angles)]
    return np.stack(at_tip), np.stack([up / height, length / up * height])


def _ended(u, rod, is_tip, height, slope, direction, down, steps):
    """What rods with the unknowns u (k, n) miss their conditions by (k, n), and their states (4, n) at the clamp."""
    n = len(height)
    none, one, nothing = np.zeros(n), np.ones(n), np.zeros((2, n))
    s1, angle, moment, more = (one, u[1], none, []) if is_tip else (u[1], slope, none, [])
    if not is_tip and rod.weight:
        angle, moment, _, _ = marched(rod, np.stack([u[2], none, none, none]), one, s1, nothing, down, steps)
        more = [angle - slope]
    start = np.stack([angle, moment, none, height])
    end = marched(rod, start, s1, none, u[0] ** 2 * direction, down, steps)
    return np.stack([end[0] - np.pi / 2 - rod.compliance * end[1], end[3], *more]), end


def equilibria(rod, height, slope, zeta, down, homotopy=1, steps=STEPS):
    """States of a rod that touches places of a contour, at heights (n,) above the clamp and with slopes (n,).

    down
        (2, n) gravity.
    homotopy
        steps from the uniform rod to this one.
    """
    alpha, found = slope + zeta, []
    direction = np.stack([np.sin(alpha), -np.cos(alpha)])
    with np.errstate(all="ignore"):  # most places cannot be touched in both ways
        for is_tip, u in zip((True, False), _started(height, slope, alpha), strict=True):
            if not is_tip and rod.weight:
                u = np.vstack([u, slope])
            given = dict(is_tip=is_tip, height=height, slope=slope, direction=direction, down=down)
            for part in range(homotopy):
                u, *_ = _corrected(partial(_ended, rod=rod.part((part + 1) / homotopy), steps=3, **given), u, 3)
            u, missed, end = _corrected(partial(_ended, rod=rod, steps=steps, **given), u, 2)
            good = (np.abs(missed).max(axis=0) < _SOLVED) & (u[0] > 0)
            good &= (u[1] >= slope) if is_tip else (u[1] <= 1) & (u[1] > _SHORTEST)
            reaction = -(u[0] ** 2 * direction + rod.weight * down)
            s1, angle = (np.ones(len(slope)), u[1]) if is_tip else (u[1], slope)
            found.append(np.where(good, np.stack([end[2], *reaction, -end[1], s1, angle]), np.nan))
    x0, fx, fy, mz, s1, angle = np.where(np.isfinite(found[0]), *found)
    return States(x0, np.stack([fx, fy, mz], axis=1), s1, angle)


def path(outline, count=_PLACES):
    """Places (count, 2) and slopes (count,) along a convex polygon (m, 2), clockwise from its right side over its lower one.

    A vertex is passed by turning the slope, a side by moving the place; both are one path.
    """
    clockwise = outline[::-1]
    edge = np.roll(clockwise, -1, axis=0) - clockwise
    slope = np.arctan2(-edge[:, 1], -edge[:, 0])  # of the side, with the body above it
    first = int(np.argmax(np.where(slope <= _FIRST, slope, -np.inf)))
    order = np.roll(np.arange(len(edge)), -first)
    slope, edge, clockwise = slope[order], edge[order], clockwise[order]
    kept = (slope <= _FIRST) & (slope >= _LAST)
    last = int(np.argmin(kept)) if not kept.all() else len(kept)
    slope, edge, clockwise = slope[:last], edge[:last], clockwise[:last]
    before = np.append(_FIRST, slope)
    turns = np.append(before[:-1] - slope, before[-1] - _LAST)
    lengths = np.append(np.linalg.norm(edge, axis=1), 0.0)
    size = lengths.sum()
    amounts = np.stack([turns, lengths * np.pi / max(size, 1e-12) / 2], axis=1).ravel()
    ends = np.concatenate([[0.0], np.cumsum(amounts)])
    at = (np.arange(count) + 0.5) / count * ends[-1]
    piece = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, len(amounts) - 1)
    share = np.divide(at - ends[piece], amounts[piece], out=np.zeros(count), where=amounts[piece] > 0)
    number, on_side = piece // 2, piece % 2 == 1
    corners = np.vstack([clockwise, clockwise[-1] + edge[-1]]) if len(edge) else outline[[np.argmin(outline[:, 1])]]
    sides = np.vstack([edge, [0.0, 0.0]])
    places = corners[number] + np.where(on_side, share, 0.0)[:, None] * sides[number]
    slopes = np.where(
        on_side, np.append(slope, _LAST)[number], before[number] - np.where(on_side, 0.0, share) * turns[number]
    )
    return places, slopes


def swept(template, mesh, rod, friction=0.3, samples=24, tared=True, gravity=(0.0, 0.0, -1.0), homotopy=1, metres=1e-3):
    """A recording with the sweeps of another one, whose rod is that of its file, by a rod that bends as `rod` does.

    The slices lie across one axis.  Each sweep has two rows in the air, and as many rows in contact with the slice of the mesh
    as `samples`.  Sweeps that never touch stay as they are.
    """
    length = template.rod.length_m
    zeta = np.arctan(friction)
    numbers, first = np.unique(template.sweep, return_index=True)
    axes, start = template.axes()[first], template.position_m[first]
    frame = slice_frame(axes[0, 2])
    heights = start @ frame[2] / metres
    polygons = slice_polygons(mesh, frame, heights)
    touched = [k for k, polygon in enumerate(polygons) if len(polygon)]
    where, slopes = [], []
    for k in touched:
        corners = polygons[k] @ frame[:2] + heights[k] * frame[2]
        places, slope = path((corners * metres - start[k]) @ axes[k, :2].T / length)
        where.append(places)
        slopes.append(slope)
    places, slope = np.concatenate(where), np.concatenate(slopes)
    down = np.repeat(axes[touched, :2] @ np.array(gravity), _PLACES, axis=0).T
    found = equilibria(rod, places[:, 1], slope, zeta, down, homotopy)
    air = free(rod, down[:, ::_PLACES])
    columns = []
    for number, k in enumerate(touched):
        rows = slice(number * _PLACES, (number + 1) * _PLACES)
        x0 = found.x0[rows] + places[rows, 0]
        reactions = found.reactions[rows] - (air[:, number] if tared else 0.0)
        # the rod stays where its base is, or snaps to the next place that is in equilibrium there
        before = np.fmin.accumulate(np.append(np.inf, x0[:-1]))
        stays = np.flatnonzero(x0 < before)
        if not len(stays):
            columns.append(_as_it_was(template, numbers[k]))
            continue
        wanted = np.linspace(x0[stays[0]], x0[stays[-1]], samples)
        rows = np.unique(stays[np.abs(x0[stays] - wanted[:, None]).argmin(axis=1)])
        base = np.concatenate([x0[rows[0]] + [0.1, 0.05], x0[rows]])
        in_air = np.zeros(3) if tared else air[:, number]
        columns.append(
            (
                np.full(len(base), numbers[k]),
                start[k] + base[:, None] * length * axes[k, 0],
                np.tile(template.quaternion[first[k]], (len(base), 1)),
                np.vstack([in_air, in_air, reactions[rows]])
                * [*[template.rod.force_unit_N] * 2, template.rod.moment_unit_Nm],
            )
        )
    columns += [_as_it_was(template, numbers[k]) for k in range(len(numbers)) if k not in touched]
    columns.sort(key=lambda of_sweep: of_sweep[0][0])
    sweep, position, quaternion, wrench = (np.concatenate(part) for part in zip(*columns, strict=True))
    return replace(
        template, sweep=sweep, position_m=position, quaternion=quaternion, force_N=wrench[:, :2], moment_Nm=wrench[:, 2]
    )


def _as_it_was(template, number):
    rows = template.sweep == number
    return (
        template.sweep[rows],
        template.position_m[rows],
        template.quaternion[rows],
        np.column_stack([template.force_N[rows], template.moment_Nm[rows]]),
    )


def noisy(recording, noise, draw):
    """The recording with white noise in EI/L² and EI/L, as it states."""
    return with_noise(recording, noise * recording.rod.force_unit_N, noise * recording.rod.moment_unit_Nm, draw)


def with_noise(recording, force, moment, draw):
    """The recording with white noise in N and N m, as it states."""
    return replace(
        recording,
        force_N=recording.force_N + force * draw.standard_normal(recording.force_N.shape),
        moment_Nm=recording.moment_Nm + moment * draw.standard_normal(len(recording)),
        noise_force_N=force,
        noise_moment_Nm=moment,
    )
