"""The outer body of touches with measured normals: their supporting planes, and how far errors move these outwards.

A convex body K with the outward normal n at its point p has ``<n, x - p> <= 0`` for all of its points x.  Measured are p̂ within
e of p, and n̂ within the angle ε of n.  With ``n = cos ε' n̂ + sin ε' t``, ``ε' <= ε`` and t across n̂,

    <n̂, x - p̂> <= e (1 + tan ε) + tan ε |x - p̂|_n̂,

where the last is the distance across n̂.  In a box around the touches it is at most that of a corner.  If the planes so moved
enclose a polytope in the interior of the box, then K lies in it, since K is connected and has points in the box.  Of this
polytope the part beyond ``e (1 + tan ε)`` is a cap, in which alone the last term counts, and the distance across n̂ is largest
at one of the cap's corners: so the planes are moved back, and again from the polytope that they enclose then.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from scan3d.arrays import AT_ONCE, OCTANTS, Array, evenly, ratio
from scan3d.geometry.hulls import cut_polytope, edges_of
from scan3d.geometry.triangles import dot

# Planes of more touches say nearly the same as those between them.
_MOST = 4000
# Part of the diagonal to which planes cut: what cuts less deep is left.
_LEAST = 1e-6
# Sizes of the box, over that of the touches, up to which it is tried, and their ratio.
_LARGEST, _RATIO = 20.0, 1.6
# The planes are moved back until the farthest corner comes nearer by less than this part, or so often.
_NEARER, _ROUNDS = 0.02, 8


def outer_corners(points: Array, normals: Array, errors: Array, turns: Array) -> Array | None:
    """Corners (w, 3) of a polytope that contains every convex body with these touches; None if they leave it open.

    points, normals (n, 3)
        the places, and unit vectors outwards.
    errors, turns (n,)
        the largest errors of the places, in their unit, and of the normals, in radians.
    """
    usable = np.flatnonzero(np.isfinite(normals).all(axis=1) & (turns < np.pi / 4))
    rows = evenly(usable, _MOST)
    if len(rows) < 4:
        return None
    inside, size = points.mean(axis=0), float(np.linalg.norm(np.ptp(points, axis=0)))
    points, normals, slope = points[rows], normals[rows], np.tan(turns[rows])
    value = dot(normals, points) + errors[rows] * (1 + slope)
    half = 1.1 * float(np.abs(points - inside).max()) + float(errors.max())
    while half < _LARGEST * size:
        apart = np.max([_across(inside + half * corner - points, normals) for corner in OCTANTS], axis=0)
        corners = _polytope(normals, value + slope * apart, inside, half, size)
        if float(np.abs(corners - inside).max()) < half - _LEAST * size:
            break
        half *= _RATIO
    else:
        return None
    farthest = np.inf
    for _ in range(_ROUNDS if slope.any() else 0):
        closer = float(np.linalg.norm(corners - inside, axis=1).max())
        if closer > (1 - _NEARER) * farthest:
            break
        farthest = closer
        corners = _polytope(normals, value + slope * _caps(corners, points, normals, value), inside, half, size)
    return corners


def _across(steps: Array, normals: Array) -> Array:
    """(..., n) lengths of steps (..., n, 3) across unit vectors (n, 3)."""
    along = dot(steps, normals)
    return np.sqrt(np.maximum(dot(steps, steps) - along**2, 0.0))


def _polytope(normals: Array, values: Array, inside: Array, half: float, size: float) -> Array:
    """Corners (w, 3) of what planes leave of a cube about a point inside."""
    return cut_polytope(np.empty((0, 4)), np.column_stack([normals, values]), inside, half / 2, _LEAST * size)


def _caps(corners: Array, points: Array, normals: Array, value: Array) -> Array:
    """(n,) the largest distances across normals from touches at which the hull of corners (w, 3) lies beyond their planes."""
    qhull = ConvexHull(corners, qhull_options="Qt Q12")
    numbers, edges = edges_of(qhull)
    corners = corners[numbers]
    found = []
    for rows in np.array_split(np.arange(len(points)), 1 + len(points) * len(edges) // AT_ONCE):
        above = corners @ normals[rows].T - value[rows]
        beyond = above > 0
        corner, of_corner = np.nonzero(beyond)
        edge, of_edge = np.nonzero(beyond[edges[:, 0]] != beyond[edges[:, 1]])
        first, second = above[edges[edge, 0], of_edge], above[edges[edge, 1], of_edge]
        part = ratio(first, first - second)[:, None]
        crossing = (1 - part) * corners[edges[edge, 0]] + part * corners[edges[edge, 1]]
        places, row = np.concatenate([corners[corner], crossing]), np.concatenate([of_corner, of_edge])
        apart = np.zeros(len(rows))
        np.maximum.at(apart, row, _across(places - points[rows][row], normals[rows][row]))
        found.append(apart)
    return np.concatenate(found)
