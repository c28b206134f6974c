"""The outer body of contacts anywhere: supporting planes whose normals are not certain, and how far that moves them outwards.

A convex body K with the outward normal n at its point p has ``<n, x - p> <= 0`` for all of its points x.  Known are a place
near p, and a middle normal ν near n.

A contact of a rod has the rod's tangent t in its plane, and n lies on an arc ``cos θ ν + sin θ τ``, ``|θ| <= δ``, with τ across
t (`scan3d.geometry.arcs`).  With the error e of the place, a norm, and the error ε of the tangent, divided by cos θ,

    <ν, x - p̂> <= (max e at the arc's ends / cos δ + ε e(t)) / cos δ + tan δ |<τ, x - p̂>| + ε / cos δ |<t, x - p̂>|,

since n is a combination of the arc's ends whose factors add up to at most 1 / cos δ.  A touch of another probe has a measured
normal that is off by an angle of at most ε in any direction, and

    <ν, x - p̂> <= e (1 + tan ε) + tan ε |x - p̂ across ν|.

So each plane is moved outwards by an error, and by slopes times distances within the plane.  In a box around the contacts these
are at most those of its corners.  If the planes so moved enclose a polytope in the interior of the box, then K lies in it,
since K is connected and has points in the box.  Of this polytope the part beyond the plane that is moved by the error alone is
a cap, in which alone the slopes count, and the distances are largest at the cap's corners: so the planes are moved back, and
again from the polytope that they enclose then.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from planar.arrays import rows_of
from scan3d.arrays import OCTANTS, Array, Mask, ratio
from scan3d.geometry.arcs import Arcs, Places
from scan3d.geometry.hulls import Corners, polytope
from scan3d.geometry.triangles import dot

# Part of the diagonal within which a corner lies on the box.
_LEAST = 1e-6
# Sizes of the box, over that of the contacts, beyond which a body counts as open, their ratio, and how much farther away open
# places are.
_LARGEST, _RATIO, _FAR = 20.0, 1.6, 1e6
# The planes are moved back until they are moved by less than this part less, or so often.
_LESS, _ROUNDS = 0.02, 8
# Normals that are less certain say nothing.
_WIDEST = np.pi / 4


class Planes(NamedTuple):
    """Planes (n,) outside of which a body may lie by an error, and by slopes times distances within the plane."""

    points: Array
    """(n, 3)"""
    normals: Array
    """(n, 3) unit vectors outwards."""
    errors: Array
    """(n,)"""
    slopes: Array
    """(n, 2)"""
    along: Array
    """(n, 2, 3) unit vectors across the normals, along which the distances are measured."""
    alike: Mask
    """(n,) whether the first slope counts in all directions across the normal."""

    def moved(self, places: Array) -> Array:
        """(...) by how much planes (...) are moved outwards so that the body may lie at places (..., 3), but for the errors."""
        steps = places - self.points
        distances = np.abs(np.einsum("...x,...kx->...k", steps, self.along))
        height = dot(steps, self.normals)
        across = np.sqrt(np.maximum(dot(steps, steps) - height**2, 0.0))
        return np.where(self.alike, self.slopes[..., 0] * across, (self.slopes * distances).sum(axis=-1))


def planes_of_arcs(arcs: Arcs, places: Places, tangents: Array, turns: Array) -> Planes:
    """The planes (k,) of contacts of a rod: of arcs whose normals are known well enough.

    places, tangents (n,), turns (n,)
        of the contacts, the tangents' errors in radians.
    """
    known = np.flatnonzero(arcs.half_width + turns < _WIDEST)
    arcs, places, tangents, turns = rows_of(arcs, known), places.select(known), tangents[known], turns[known]
    cosine = np.cos(arcs.half_width)
    off = places.along(arcs.ends()).max(axis=1) / cosine + turns * places.along(tangents[:, None])[:, 0]
    slopes = np.stack([np.tan(arcs.half_width), turns / cosine], axis=1)
    along = np.stack([arcs.across, tangents], axis=1)
    return Planes(places.points, arcs.middle, off / cosine, slopes, along, np.zeros(len(known), dtype=bool))


def planes_of_touches(points: Array, normals: Array, errors: Array, turns: Array) -> Planes:
    """The planes (k,) of those touches (n,) of another probe whose normals are known, with errors of both, in radians."""
    known = np.flatnonzero(np.isfinite(normals).all(axis=1) & (turns < _WIDEST))
    slope = np.tan(turns[known])
    nothing = np.zeros((len(known), 2, 3))
    off = errors[known] * (1 + slope)
    slopes = np.stack([slope, np.zeros(len(known))], axis=1)
    return Planes(points[known], normals[known], off, slopes, nothing, np.ones(len(known), dtype=bool))


def with_table(planes: Planes, height: float | None) -> Planes:
    """The planes and that of a table, nothing of the body below which lies."""
    if height is None:
        return planes
    point = np.append(planes.points.mean(axis=0)[:2] if len(planes.points) else np.zeros(2), height)
    added = (point, [0.0, 0.0, -1.0], 0.0, [0.0, 0.0], np.zeros((2, 3)), True)
    return Planes._make(
        np.concatenate([column, np.array(row)[None]]) for column, row in zip(planes, added, strict=True)
    )


def outer_body(planes: Planes, body: Any) -> tuple[Array, Array]:
    """The polytope that contains every convex body within the planes, and the convex mesh `body`: its corners (w, 3), and
    places (f, 3), much farther, towards which it is open.

    It is open where it reaches the box in which it is sought, and nothing bounds the body towards far places.  In a direction
    in which none of them lies farther than the mesh the corners bound it nevertheless: the way from a point of the mesh to one
    of the body beyond the box leaves the box in the polytope, where it has not gone farther in this direction.
    """
    points = body.vertices.view(np.ndarray)
    inside, size = points.mean(axis=0), float(np.linalg.norm(np.ptp(points, axis=0)))
    value = dot(planes.normals, planes.points) + planes.errors
    half = 1.1 * float(np.abs(points - inside).max()) + float(planes.errors.max(initial=0.0))
    while True:
        move = np.max([planes.moved(inside + half * corner) for corner in OCTANTS], axis=0)
        corners = polytope(np.column_stack([planes.normals, value + move]), inside, half)
        if float(np.abs(corners - inside).max()) < half - _LEAST * size or half > _LARGEST * size:
            break
        half *= _RATIO
    left = np.inf
    for _ in range(_ROUNDS if planes.slopes.any() else 0):
        move = _caps(corners, planes, value)
        if float(move.sum()) > (1 - _LESS) * left:
            break
        left = float(move.sum())
        corners = polytope(np.column_stack([planes.normals, value + move]), inside, half)
    is_far = np.abs(corners - inside).max(axis=1) >= half - _LEAST * size
    return corners[~is_far], inside + _FAR * (corners[is_far] - inside)


def _caps(corners: Array, planes: Planes, value: Array) -> Array:
    """(n,) by how much planes are moved outwards for the part of the hull of corners (w, 3) that lies beyond them.

    The corners of a cap are linked by edges, which are followed from the farthest one.
    """
    hull = Corners(ConvexHull(corners, qhull_options="Qt Q12"))
    moved, plane, corner = np.zeros(len(value)), np.arange(len(value)), hull.highest(planes.normals)
    before = plane * len(hull.points) + corner
    above = dot(planes.normals, hull.points[corner]) - value
    while len(plane := plane[above > 0]):
        corner, above = corner[above > 0], above[above > 0]
        which, _, other = hull.beside(corner)
        there = dot(planes.normals[plane[which]], hull.points[other]) - value[plane[which]]
        crosses = there <= 0
        here = above[which[crosses]]
        part = ratio(here, here - there[crosses])[:, None]
        crossing = (1 - part) * hull.points[corner[which[crosses]]] + part * hull.points[other[crosses]]
        row = np.concatenate([plane, plane[which[crosses]]])
        np.maximum.at(moved, row, rows_of(planes, row).moved(np.concatenate([hull.points[corner], crossing])))
        # of the corners beyond those of this round and of the one before are known
        this = plane * len(hull.points) + corner
        code = np.sort(plane[which[~crosses]] * len(hull.points) + other[~crosses])
        code = code[np.diff(code, prepend=-1) > 0]
        for known in (before, this):
            code = code[known[np.searchsorted(known, code) % len(known)] != code]
        before, (plane, corner) = this, np.divmod(code, len(hull.points))
        above = dot(planes.normals[plane], hull.points[corner]) - value[plane]
    return moved
