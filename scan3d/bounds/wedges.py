"""What contacts anywhere leave of a convex body where their errors are not negligible.

A contact's supporting plane has one of the normals of its arc (S27).  The body K does not reach into the wedge of all points
that lie beyond the plane whichever normal that is: of the points with ``<n, x - p> > e(n) + ε (|<t, x - p>| + e(t))`` for the
normals n at both ends of the arc, with the error e of the place and ε of the tangent t.  For the normals between the ends this
follows, since e is a norm, and so does it for the true normal when it is turned until it is perpendicular to the measured t.

A wedge is a convex set, and if it contains x and not the centre o, it contains all points beyond x, as seen from o.  Where it
contains the corners of a triangle, K therefore does not reach beyond the triangle in the directions of its points from o: there
it is contained in the tetrahedron of o and the triangle.  Triangles over all directions give the outer body; in each of them
that contact is taken which leaves least.  The farthest of them are divided until the bound is nearly that of the union of all
wedges, which is all that the contacts one by one say of K.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import trimesh

from scan3d.arrays import AT_ONCE, NEGLIGIBLE, Array, Index, evenly, ratio
from scan3d.bounds.constraints import arcs_of_contacts, frame_of, tangential
from scan3d.cloud import Cloud
from scan3d.geometry.arcs import Places
from scan3d.geometry.distance import nearest_on
from scan3d.geometry.triangles import dot, face_normals

# Wedges that are used at most: of more contacts neighbours say nearly the same.
_MOST = 4000
# Subdivisions of the icosahedron with whose faces the triangles begin, and rounds in which they are divided into four.
_BEGIN, _ROUNDS = 3, 6
# Part by which the bound may exceed what the wedges leave at the triangles' corners.
_CLOSE = 0.03


class Outer(NamedTuple):
    """Triangles (m,) over all directions from the centre, behind which a body lies."""

    corners: Array
    """(m, 3, 3); infinite where nothing bounds the body."""
    gap: Array
    """(m,) the largest distance of a corner from the inner body."""
    directions: Array
    """(m, 3) of the triangles from the centre, not of unit length."""
    centre: Array
    """(3,)"""


def outer_body(cloud: Cloud, places: Places, turns: Array, inner: Any) -> Outer:
    """The outer body by contacts with uncertain centre points, and errors (n,) of their tangents in radians.

    inner
        a convex `trimesh.Trimesh`, from which distances are measured.
    """
    centre, shape = frame_of(places.points)
    normals, values = _wedges(cloud, places, turns, centre)
    sphere = trimesh.creation.icosphere(subdivisions=_BEGIN)
    directions, triangles = sphere.vertices.view(np.ndarray) @ shape, sphere.faces.view(np.ndarray)
    distance = nearest_on(inner)
    normals_of_inner = face_normals(inner)
    planes = np.column_stack([normals_of_inner, dot(normals_of_inner, inner.triangles[:, 0] - centre)])

    def gaps(points: Array) -> Array:
        found = np.full(len(points), np.inf)
        finite = np.isfinite(points).all(axis=1)
        found[finite] = np.maximum(distance(points[finite])[0], 0.0)
        return found

    reach, beyond, known = np.empty((0, len(values))), np.empty((0, len(values))), 0.0
    parts: list[tuple[Array, Array, Index]] = []
    for left in reversed(range(_ROUNDS)):
        new = directions[len(reach) :]
        entered = _entered(normals, values, new)
        outside = (entered - _leaves(planes, new)[:, None]) * np.linalg.norm(new, axis=1)[:, None]
        reach, beyond = np.concatenate([reach, entered]), np.concatenate([beyond, outside])
        with np.errstate(invalid="ignore"):
            known = max(known, float(gaps(centre + entered.min(axis=1)[:, None] * new).max(initial=0.0)))
        entered = reach[triangles, _best(beyond, triangles)[:, None]]
        bounded = np.isfinite(entered).all(axis=1)
        corners = np.full((len(triangles), 3, 3), np.inf)
        corners[bounded] = centre + entered[bounded, :, None] * directions[triangles[bounded]]
        gap = gaps(corners.reshape(-1, 3)).reshape(-1, 3).max(axis=1)
        coarse = ~(gap <= (1 + _CLOSE) * known) & (left > 0)
        parts.append((corners[~coarse], gap[~coarse], triangles[~coarse]))
        if not coarse.any():
            break
        directions, triangles = _divided(directions, triangles[coarse])
    corners, gap, triangles = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Outer(corners, gap, directions[triangles].mean(axis=1), centre)


def _wedges(cloud: Cloud, places: Places, turns: Array, centre: Array) -> tuple[Array, Array]:
    """Planes that bound the wedges (k,): normals (k, 4, 3), and their values (k, 4) from the centre, all above 0.

    The first stands for none: no direction enters it.
    """
    assert cloud.tangents is not None
    rows = evenly(tangential(cloud), _MOST)
    arcs = arcs_of_contacts(places, cloud.tangents, rows, turns[rows])
    known = np.isfinite(arcs.half_width)
    own, ends = places.select(rows[known]), arcs.ends()[known]
    tangents, turn = cloud.tangents[rows[known], None], turns[rows[known], None]
    normals = np.concatenate([ends - turn[..., None] * tangents, ends + turn[..., None] * tangents], axis=1)
    error = own.along(ends) + turn * own.along(tangents)
    values = (normals * (own.points - centre)[:, None]).sum(axis=2) + np.tile(error, 2)
    if cloud.table is not None:
        normals = np.concatenate([normals, np.tile([0.0, 0.0, -1.0], (1, 4, 1))])
        values = np.concatenate([values, np.full((1, 4), centre[2] - (cloud.table - cloud.rod_radius))])
    outside = (values > NEGLIGIBLE * np.abs(values).max(initial=0.0)).all(axis=1)
    return np.concatenate([np.zeros((1, 4, 3)), normals[outside]]), np.concatenate([np.ones((1, 4)), values[outside]])


def _entered(normals: Array, values: Array, directions: Array) -> Array:
    """(v, k) where rays from the centre enter wedges, in lengths of the directions (v, 3); infinite where they do not."""
    parts = [np.empty((0, len(values)))]
    for block in np.array_split(directions, 1 + directions.shape[0] * values.size // AT_ONCE):
        along = np.einsum("vx,kex->vke", block, normals)
        parts.append(np.where(along > 0, ratio(values, np.maximum(along, 0.0)), np.inf).max(axis=2))
    return np.concatenate(parts)


def _leaves(planes: Array, directions: Array) -> Array:
    """(v,) where rays from the centre leave the convex body with the planes (f, 4), a normal and its value from the centre."""
    parts = []
    for block in np.array_split(directions, 1 + len(directions) * len(planes) // AT_ONCE):
        along = block @ planes[:, :3].T
        parts.append(np.where(along > 0, ratio(planes[:, 3], along), np.inf).min(axis=1))
    return np.concatenate(parts)


def _best(beyond: Array, triangles: Index) -> Index:
    """(m,) numbers of the wedges that leave least in the triangles, by how far (v, k) they begin beyond the inner body."""
    blocks = np.array_split(triangles, 1 + triangles.size * beyond.shape[1] // AT_ONCE)
    return np.concatenate([beyond[block].max(axis=1).argmin(axis=1) for block in blocks])


def _divided(vertices: Array, triangles: Index) -> tuple[Array, Index]:
    """The vertices with the middles of the sides of triangles (m, 3), and the triangles' quarters (4 m, 3)."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    sides, number = np.unique(sides, axis=0, return_inverse=True)
    a, b, c = triangles.T
    ab, bc, ca = (number.reshape(-1, 3) + len(vertices)).T
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return (
        np.concatenate([vertices, vertices[sides].mean(axis=1)]),
        np.concatenate([np.stack(quarter, axis=1) for quarter in quarters]),
    )
