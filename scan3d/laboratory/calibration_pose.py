"""Where a known body lies, from contacts on its surface: from many starting rotations to the nearest poses.

Each pose is improved by steps of least squares on the distances of the contacts from the body's nearest planes (iterated
closest points with point-to-plane distances: Chen and Medioni, 1992), with less weight for contacts that are far off.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, evenly
from scan3d.laboratory.calibration_body import Body
from scan3d.laboratory.calibration_reference import Located, nearest_sphere

# Contacts, planes of the body, and starting rotations that the search uses.  Fewer contacts or rotations may miss its pose.
_CONTACTS, _PLANES, _ROTATIONS = 200, 150, 72
# Steps of each pose; most poses are at rest by then.
_STEPS = 15
# Damping of a step, relative to the sizes of the body.
_DAMPING = 1e-6
# Golden ratio and the root of a cubic that spread rotations evenly (Alexa, 2022, super-Fibonacci spirals).
_FIRST, _SECOND = 2**0.5, 1.533751168755204288118041


def poses(body: Body, points: Array, count: int) -> Located:
    """The `count` poses of a body, or fewer, for which contacts (n, 3) lie nearest to its surface, best first."""
    chosen = evenly(points, _CONTACTS)
    normals, offsets = _planes(body)
    axes = spread_rotations(_ROTATIONS)
    centre = np.tile(nearest_sphere(chosen[None])[0], (len(axes), 1))
    # spheres far from all contacts come of contacts in a plane
    middle = chosen.mean(axis=0)
    if np.linalg.norm(centre[0] - middle) > np.linalg.norm(body.vertices, axis=1).max():
        centre[:] = middle
    for _ in range(_STEPS):
        centre, axes = _step(normals, offsets + body.radius, chosen, centre, axes)
    misfit = np.median(np.abs(_heights(normals, offsets + body.radius, chosen, centre, axes)[1]), axis=1)
    best = np.argsort(misfit, kind="stable")[:count]
    return Located(centre[best], axes[best], misfit[best])


def spread_rotations(count: int) -> Array:
    """Rotations (count, 3, 3) that are spread evenly."""
    number = np.arange(count) + 0.5
    inner, outer = np.sqrt(number / count), np.sqrt(1 - number / count)
    one, other = 2 * np.pi * number / _FIRST, 2 * np.pi * number / _SECOND
    quaternion = np.column_stack(
        [inner * np.sin(one), inner * np.cos(one), outer * np.sin(other), outer * np.cos(other)]
    )
    return np.asarray(Rotation.from_quat(quaternion).as_matrix())


def _planes(body: Body) -> tuple[Array, Array]:
    """Normals (f, 3) and offsets (f,) of some of the body's faces: the largest of them."""
    corners = body.vertices[body.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if len(area) <= _PLANES:
        return body.normals, body.offsets
    large = np.argsort(-area, kind="stable")[:_PLANES]
    spread = np.unique(np.linspace(0, len(area) - 1, _PLANES).astype(np.intp))
    kept = np.union1d(large[: _PLANES // 2], spread)
    return body.normals[kept], body.offsets[kept]


def _heights(normals: Array, offsets: Array, points: Array, centre: Array, axes: Array) -> tuple[Array, Array, Array]:
    """Contacts (t, n, 3) in the frames of poses, their heights (t, n) above the highest plane, and its number (t, n)."""
    inner = (points - centre[:, None]) @ axes
    height = inner @ normals.T - offsets
    face = height.argmax(axis=2)
    return inner, np.take_along_axis(height, face[:, :, None], axis=2)[:, :, 0], face


def _step(normals: Array, offsets: Array, points: Array, centre: Array, axes: Array) -> tuple[Array, Array]:
    """The poses after a step of least squares."""
    inner, height, face = _heights(normals, offsets, points, centre, axes)
    normal = normals[face]
    scale = np.maximum(1.5 * np.median(np.abs(height), axis=1, keepdims=True), 1e-12)
    weight = 1 / np.maximum(np.abs(height) / scale, 1.0)
    slopes = np.concatenate([-normal, -np.cross(inner, normal)], axis=2)
    weighted = slopes * weight[:, :, None]
    matrix = weighted.swapaxes(1, 2) @ slopes
    matrix[:, range(6), range(6)] += _DAMPING * len(points)
    step = -np.linalg.solve(matrix, (weighted * height[:, :, None]).sum(axis=1)[:, :, None])[:, :, 0]
    turn = step[:, 3:] / np.maximum(np.linalg.norm(step[:, 3:], axis=1, keepdims=True) / 0.5, 1.0)
    return centre + np.einsum("tij,tj->ti", axes, step[:, :3]), axes @ Rotation.from_rotvec(turn).as_matrix()
