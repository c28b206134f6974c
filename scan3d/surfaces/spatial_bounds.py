"""An inner and an outer body from contacts anywhere, without slices, normals or a law of friction (S25, S27, S28).

B is the body and a the rod's radius.  The rod's centre line touches the fattened body ``K = B + ball(a)`` in the points r, and
in tangential contact the whole line through r along the rod is free of the interior of K.  H, the hull of the points r, lies in
K, and the supporting planes through the tangents bound it: ``h_K(u) <= <u, v>`` for one of their apexes v
(`scan3d.geometry.apexes`).

The Hausdorff distance of two convex bodies is the largest difference of their support functions, and ``h_K = h_B + a``.  With
``sd(x, S) = max_u (<u, x> - h_S(u))``, the distance of a point x from S, negative inside, any convex surface S satisfies

    h_B - h_S = h_K - a - h_S <= max over apexes v of sd(v, S) - a,
    h_S - h_B = h_S + a - h_K <= h_S + a - h_H <= max over vertices x of S of sd(x, H) + a.

No measured normal enters, though the points of the inner body are moved by a along theirs: the second line contains what is
wrong with them.  There, B has further inner bodies: it contains the points ``r - a n``, and n lies within δ of the middle ν of
its interval (S27), so that ``h_B(u) >= <u, r - a ν> - a δ``.  The smallest of these numbers counts at each vertex.

Where contacts have errors of at most e, the intervals of the normals are widened, the planes are moved outwards by e, and H may
stick out of K by e.  The rod's tangent then has an error as well, and its plane is moved by what that makes of it within a ball
around the contacts; if all apexes lie inside the ball, so does K, since K is connected.

A table below the body, if it is known, is one more supporting plane of K, moved outwards by the rod's radius.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from scan3d.arrays import Array, Index, Mask
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.geometry.distance import nearest, nearest_on
from scan3d.geometry.hulls import hull
from scan3d.surfaces.allowances import allowed
from scan3d.surfaces.enclosures import Enclosure
from scan3d.surfaces.tangent_planes import Apexes, best_apexes
from scan3d.surfaces.tangents import TangentPlanes, tangent_planes

# Error of an exact contact's place, in rod lengths, and of its tangent, in radians: what solvers and their input leave.
# Larger, the bounds of exact contacts widen; smaller, they would no longer be certain.
_EXACT = 2e-9
# Error of a tangent, in radians, of a contact whose place is off by one rod length, where the tangent's own error is not known.
# A rod that is off by d at its tip, where bending sets in at half its length, has turned by no more than 6 d per length.
_TURN = 6.0
# Quantiles of the contacts' errors; contacts with a larger one are left out, and the best bound is taken.
_QUANTILES = (1.0, 0.7, 0.4)
# Largest angles, in radians, of the normals from the middles of their intervals, of the contacts in each of the inner bodies by
# intervals.  More take longer; with fewer, the rod's radius weakens the bound.
_WIDEST = (1e-4, 1e-3, 1e-2)
# Directions near a vertex' normal in which its depth in the body is bounded.  More take longer; fewer give wider local bounds.
_NEAR = 8
# Entries of a matrix computed at once.  More need more memory.
_ENTRIES = 4_000_000


@dataclass(frozen=True, kw_only=True, repr=False)
class SpatialEnclosure(Enclosure):
    """The enclosure by contacts anywhere.

    The inner body is the hull of the contacts on the surface, ``r - a n``.  It may stick out of the true body by `excess`,
    which `bound` contains.  The corners are apexes over the body fattened by the rod.
    """

    inner_bodies: tuple[tuple[Any, float], ...]
    """Convex bodies and how far each may stick out of the true one; that of the centre points, H, by the radius less."""
    radius: float
    """The rod's radius a."""
    excess: float
    """How far the inner body may stick out of the true one, by errors of normals and of places."""
    apexes: Array
    """(m, 3) apexes over triangles of directions, by the middles of the normals' intervals."""
    open: Mask
    """(m,) whether nothing bounds the body in the directions of the triangle."""

    directions: Array
    """(d, 3) unit vectors in which the body's support function is bounded."""
    upper: Array
    """(d,) its upper bounds."""

    def sticking_out(self, points: Array) -> Array:
        """Upper bounds (n,) of the distances of points (n, 3) from the true body, negative inside."""
        return _sticking_out(points, self.inner_bodies)

    def _support(self, directions: Array) -> tuple[Array, Array]:
        lower = (_vertices(self.inner) @ directions.T).max(axis=0) - self.excess
        if self.open.any() or not len(self.corners):
            return lower, np.full(len(directions), np.inf)
        return lower, (self.corners @ directions.T).max(axis=0) - self.radius

    def parts(self) -> dict[str, float]:
        return {"contacts": float(self.gap.max(initial=0.0)), "rod": self.excess}


def spatial_enclosure(cloud: Cloud, margin: float | None, confidence: float) -> SpatialEnclosure:
    """The enclosure of a cloud of the spatial model; the arguments are those of `scan3d.surfaces.enclosure`.

    Raises InputError for contacts that do not span a body.
    """
    if not len(cloud):
        raise InputError("0 contacts span no body: a surface needs contacts all around it")
    errors = np.full(len(cloud), _EXACT * cloud.rod_length + cloud.pose_error if margin is None else margin)
    if margin is not None or (cloud.place_sd is None and cloud.calibration is None):
        turns = np.zeros(len(cloud)) if cloud.place_sd is None else _TURN * errors / cloud.rod_length
        return _by_contacts(cloud, errors, turns, 1.0)
    allow = allowed(cloud, confidence)
    turns = np.zeros(len(cloud))
    if cloud.place_sd is not None:
        assert allow.kappa is not None
        errors += allow.kappa * (cloud.place_sd if cloud.centre_sd is None else cloud.centre_sd)
        turns = _TURN * errors / cloud.rod_length
        if cloud.tangent_sd is not None:
            turns = _EXACT + allow.kappa * cloud.tangent_sd
    errors, turns = errors + allow.place, turns + allow.turn
    candidates = []
    for quantile in _QUANTILES:
        kept = (errors <= np.quantile(errors, quantile)) & (turns <= np.quantile(turns, quantile))
        if kept.any():
            candidates.append(_by_contacts(cloud.select(kept), errors[kept], turns[kept], allow.confidence))
    return min(candidates, key=lambda candidate: candidate.bound)


def _by_contacts(cloud: Cloud, errors: Array, turns: Array, confidence: float) -> SpatialEnclosure:
    """The enclosure by all contacts of a cloud.

    errors, turns
        (n,) the largest errors of their places, and of their tangents in radians.
    """
    assert cloud.centre_points is not None
    centre_hull = hull(cloud.centre_points)
    margin, radius = float(errors.max()), cloud.rod_radius
    inner = _inner_body(cloud, centre_hull)
    tangent = tangent_planes(cloud, errors, turns)
    apexes = _best_apexes(tangent, centre_hull)
    directions, support = np.empty((0, 3)), np.empty(0)
    if apexes is None:
        corners, middles, is_open = np.empty((0, 3)), np.zeros((1, 3)), np.ones(1, dtype=bool)
    else:
        directions, support = tangent.support_bounds(apexes)
        is_open = apexes.open
        corners = np.unique(tangent.to_world(apexes.cover.apexes[~is_open].reshape(-1, 3)), axis=0)
        middles = tangent.to_world(apexes.cover.nominal)
    bodies = ((centre_hull, radius + margin), *_bodies_by_intervals(cloud, tangent, errors, turns))
    gap = np.maximum(nearest(corners, inner)[0] - radius, 0.0) if len(corners) else np.empty(0)
    excess = max(float(_sticking_out(_vertices(inner), bodies).max()), margin)
    unbounded = bool(is_open.any())
    return SpatialEnclosure(
        inner=inner,
        corners=corners,
        gap=np.append(gap, np.inf) if unbounded else gap,
        bound=np.inf if unbounded else max(float(gap.max()), excess),
        margin=margin,
        volume=_volumes(inner, excess, corners, radius, unbounded=unbounded),
        confidence=confidence,
        inner_bodies=bodies,
        radius=radius,
        excess=excess,
        apexes=middles,
        open=is_open,
        directions=directions,
        upper=support - radius,
    )


def _sticking_out(points: Array, bodies: tuple[tuple[Any, float], ...]) -> Array:
    """Upper bounds (n,) of the distances of points (n, 3) from the body, by inner bodies and how far they may stick out."""
    distances: Array = np.min([nearest(points, body)[0] + offset for body, offset in bodies], axis=0)
    return distances


def _vertices(mesh: Any) -> Array:
    vertices: Array = mesh.vertices.view(np.ndarray)
    return vertices


def _inner_body(cloud: Cloud, centre_hull: Any) -> Any:
    """The hull of the contacts on the surface; without normals, that of the centre points, made smaller by the radius."""
    known = np.isfinite(cloud.points).all(axis=1)
    if known.any():
        return hull(cloud.points[known])
    vertices = _vertices(centre_hull)
    centre = vertices.mean(axis=0)
    depth = -float(nearest(centre[None], centre_hull)[0][0])
    return hull(centre + max(1 - cloud.rod_radius / depth, 1e-3) * (vertices - centre))


def _volumes(inner: Any, excess: float, corners: Array, radius: float, *, unbounded: bool) -> tuple[float, float]:
    """Bounds of the volume: that of the inner body, made smaller until it does not stick out, and that of the outer one.

    By Steiner's formula the fattened body is larger than the body by more than the radius times the area of the inner body.
    """
    depth = -float(nearest(_vertices(inner).mean(axis=0)[None], inner)[0][0])
    factor = max(1 - excess / depth, 0.0) if depth > 0 else 0.0
    lower = float(inner.volume) * factor**3
    if unbounded:
        return lower, np.inf
    shell = radius * float(inner.area) * factor**2 + 4 / 3 * np.pi * radius**3
    return lower, max(float(ConvexHull(corners).volume) - shell, lower)


def _best_apexes(tangent: TangentPlanes, centre_hull: Any) -> Apexes | None:
    """The best apexes of the planes; None if nothing is bounded."""
    signed, size = nearest_on(centre_hull), float(np.linalg.norm(tangent.shape, 2))
    apexes = best_apexes(tangent.planes, lambda points: np.maximum(signed(tangent.to_world(points))[0], 0.0) / size)
    if apexes is not None and np.isfinite(tangent.ball):
        reach = np.linalg.norm(apexes.cover.apexes, axis=2).max()
        return apexes if reach < tangent.ball else None
    return apexes


def _bodies_by_intervals(
    cloud: Cloud, tangent: TangentPlanes, errors: Array, turns: Array
) -> Iterator[tuple[Any, float]]:
    """Hulls of the points of the surface that follow from the intervals of the normals, and how far they may stick out."""
    radius = cloud.rod_radius
    if not radius:
        return
    assert cloud.centre_points is not None
    normals, angle = tangent.normals()
    turn, margin = float(turns.max()), float(errors.max())
    points = cloud.centre_points[tangent.rows] - radius * normals
    for widest in _WIDEST:
        narrow = angle <= widest
        with suppress(InputError):
            if narrow.sum() > 3:
                yield hull(points[narrow]), radius * (widest + turn) + margin


def spatial_certificate(bounds: SpatialEnclosure, surface: Any) -> tuple[float, Array]:
    """The bound of a convex surface, and the local bound at its vertices."""
    vertices = _vertices(surface)
    outwards = np.maximum(bounds.sticking_out(vertices), 0.0)
    local = np.maximum(outwards, _depths(bounds, surface))
    if bounds.open.any():
        local[_open_vertices(bounds, surface)] = np.inf
        return np.inf, local
    distance = nearest(bounds.corners, surface)[0] - bounds.radius
    bound = float(max(outwards.max(), distance.max()))
    return bound, np.minimum(local, bound)


def _depths(bounds: SpatialEnclosure, surface: Any) -> Array:
    """Upper bounds (v,) of the distances of a surface's vertices in the body from the body's surface.

    A point x of a body lies no farther from its surface than ``h(u) - <u, x>``, for every direction u.
    """
    vertices = _vertices(surface)
    if not len(bounds.directions):
        return np.full(len(vertices), np.inf)
    faces: Index = surface.faces
    corners = vertices[faces]
    normals = np.zeros_like(vertices)
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.add.at(normals, faces.ravel(), np.repeat(face_normals, 3, axis=0))
    normals /= np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)[:, None]
    near = cKDTree(bounds.directions).query(normals, k=np.arange(1, min(_NEAR, len(bounds.directions)) + 1))[1]
    depths: Array = (bounds.upper[near] - (bounds.directions[near] * vertices[:, None]).sum(axis=2)).min(axis=1)
    return np.maximum(depths, 0.0)


def _open_vertices(bounds: SpatialEnclosure, surface: Any) -> Index:
    """Numbers of a surface's vertices at faces in whose directions nothing bounds the body."""
    if bounds.open.all():
        return np.arange(len(surface.vertices))
    faces: Index = surface.faces
    corners = _vertices(surface)[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    blocks = np.array_split(np.arange(len(normals)), 1 + len(normals) * len(bounds.apexes) // _ENTRIES)
    # the triangle of a direction is that of the apex that lies farthest in it
    hit = np.concatenate([(normals[rows] @ bounds.apexes.T).argmax(axis=1) for rows in blocks])
    return np.unique(faces[bounds.open[hit]])
