"""A known convex body as the reference of a calibration: how rods touch it.

In tangential contact the line of the rod touches the body.  Seen along the line the body is a polygon, its silhouette, and the
line a point: the distance between them does not depend on where along the line the contact is, and neither its value nor its
derivatives change quickly where the body has a sharp edge, whose radius is that of the rod.  The contact lies where the line
is nearest to the edge.  At the tip the distance is that of a point.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array, Index, Mask
from scan3d.geometry.distance import nearest_on
from scan3d.geometry.meshes import check_body
from scan3d.laboratory.calibration_reference import Located, Met, Reference, nearest_sphere
from scan3d.rods import Rod
from scan3d.units import UNITS_M

# Squared sine of the angle between rod and edge below which the edge does not tell the contact's place along the rod.
_PARALLEL = 0.02
# Angle in radians by which the rod may turn about the contact without being in contact elsewhere.  Smaller, the noise of the
# rod's direction would put contacts on other edges; larger, more contacts are left out.
_TURNED = 0.05
# Distances in rod lengths below which a normal is that of the face.
_TOUCHING = 1e-9


class _Line(NamedTuple):
    """How lines (n,) pass the body."""

    distance: Array
    """(n,) from the body, negative through it."""
    normal: Array
    """(n, 3) of the body, normal to the line."""
    place: Array
    """(n,) where on the line it is nearest, from the line's point."""
    place_by_point: Array
    """(n, 3)"""
    place_by_tangent: Array
    across: Mask
    """(n,) whether the line is not along the edge that it passes."""


class Body(Reference):
    """A convex body in its own frame, whose origin is in the middle of it, and the rod's radius."""

    kind = "mesh"
    noun = "body"
    extent, check = "a tenth of the body's inner radius", "the mesh and its unit"
    sizes, unlike = (
        "the size of the body and the rod's diameter",
        "a body that differs from its mesh, in shape or in size",
    )
    excluded = ""
    free = (True, True, True, True, True, True)
    pose_order = (0.01, 0.02)
    smooth, abrupt = False, True
    inward = 2

    def __init__(self, mesh: Any, unit: str, rod: Rod) -> None:
        """The body of a `trimesh.Trimesh`, whose coordinates are in `unit`, touched with a rod.

        Raises InputError if it is not closed and convex.
        """
        check_body(mesh)
        # the facets as they are, where they are a closed surface: a hull divides nearly flat faces otherwise
        whole = mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
        hull, scale = mesh if whole else mesh.convex_hull, UNITS_M[unit] / rod.length_m
        self.file = {key: str(mesh.metadata[key]) for key in ("file", "sha256") if key in mesh.metadata}
        self.title = f"the body of {self.file['file']}" if "file" in self.file else "the body of the mesh"
        self.radius = rod.diameter_m / 2 / rod.length_m
        self.middle = np.asarray(hull.bounds, dtype=float).mean(axis=0) * scale
        self.vertices = np.asarray(hull.vertices, dtype=float) * scale - self.middle
        self.faces = np.asarray(hull.faces)
        self.mesh = hull.copy()
        self.mesh.vertices = self.vertices
        corners = self.vertices[self.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self.normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        self.offsets = (self.normals * corners[:, 0]).sum(axis=1)
        # the radius of the largest sphere about the middle
        self.size = float(self.offsets.min())
        self._edges()

    def _edges(self) -> None:
        """The edges, each with the faces on its sides."""
        count = len(self.faces)
        tail, head = self.faces.T.ravel(), np.roll(self.faces, -1, axis=1).T.ravel()
        face = np.tile(np.arange(count), 3)
        order = np.lexsort((np.maximum(tail, head), np.minimum(tail, head)))
        self.sides = np.column_stack([face[order[::2]], face[order[1::2]]])
        self.tail = self.vertices[tail[order[::2]]]
        span = self.vertices[head[order[::2]]] - self.tail
        self.length = np.linalg.norm(span, axis=1)
        self.direction = span / self.length[:, None]

    @cached_property
    def _nearest(self) -> Any:
        return nearest_on(self.mesh)

    def met(self, point: Array, tangent: Array, tangential: Mask) -> Met:
        nan = np.full(point.shape, np.nan)
        met = Met(nan[:, 0].copy(), nan.copy(), nan.copy(), nan[:, 0].copy(), nan.copy(), nan.copy())
        known = np.isfinite(point).all(axis=1) & np.isfinite(tangent).all(axis=1)
        rows = np.flatnonzero(known & tangential)
        if len(rows):
            line = self.lines(point[rows], tangent[rows])
            met.gap[rows], met.gap_by_point[rows] = line.distance - self.radius, line.normal
            met.gap_by_tangent[rows] = line.place[:, None] * line.normal
            met.along[rows] = line.place
            met.along_by_point[rows], met.along_by_tangent[rows] = line.place_by_point, line.place_by_tangent
        rows = np.flatnonzero(known & ~tangential)
        if len(rows):
            distance, normal = self.points(point[rows])
            met.gap[rows], met.gap_by_point[rows], met.gap_by_tangent[rows] = distance - self.radius, normal, 0
        return met

    def points(self, point: Array) -> tuple[Array, Array]:
        """Distances (n,) of points (n, 3) from the surface, negative inside, and normals (n, 3)."""
        distance, face, foot = self._nearest(point)
        with np.errstate(invalid="ignore", divide="ignore"):
            normal = (point - foot) / distance[:, None]
        plane = self.normals[face]
        near: Mask = np.abs(distance) < _TOUCHING
        return distance, np.where(near[:, None], plane, normal)

    def lines(self, point: Array, tangent: Array) -> _Line:
        """How the lines through points (n, 3) with unit directions (n, 3) pass the body."""
        ahead = tangent @ self.normals.T
        row, edge = np.nonzero((ahead[:, self.sides[:, 0]] > 0) != (ahead[:, self.sides[:, 1]] > 0))
        t, e, w = tangent[row], self.direction[edge], point[row] - self.tail[edge]
        cosine, on_edge, on_line = (t * e).sum(axis=1), (e * w).sum(axis=1), (t * w).sum(axis=1)
        square = np.maximum(1 - cosine**2, _TOUCHING)
        along = (on_edge - cosine * on_line) / square
        foot = np.clip(along, 0, self.length[edge])
        place = cosine * foot - on_line
        apart = w + place[:, None] * t - foot[:, None] * e
        distance = np.linalg.norm(apart, axis=1)
        # the silhouette's outward normal is between those of the two faces, and normal to the line
        first, second = (np.abs(ahead[row, self.sides[edge, 1 - k]]) for k in (0, 1))
        outward = (
            first[:, None] * self.normals[self.sides[edge, 0]] + second[:, None] * self.normals[self.sides[edge, 1]]
        )
        size = np.linalg.norm(outward, axis=1, keepdims=True)
        outward = outward / np.maximum(size, 1e-300)
        height = np.where(size[:, 0] > 0, (outward * w).sum(axis=1), -np.inf)
        starts = np.flatnonzero(np.diff(row, prepend=-1))
        highest = np.maximum.reduceat(height, starts)
        # inside of a convex polygon the nearest side is the one with the largest height
        score = np.where(np.repeat(highest > 0, np.diff(starts, append=len(row))), distance, -height)
        best = starts + _first_least(score, starts)
        inside = highest <= 0
        clipped = (foot[best] != along[best]) & ~inside
        foot, place, square = foot[best], place[best], square[best]
        t, e, w, cosine = t[best], e[best], w[best], cosine[best]
        place = np.where(inside, cosine * along[best] - on_line[best], place)
        normal = np.where(clipped[:, None], apart[best] / np.maximum(distance[best], 1e-300)[:, None], outward[best])
        by_point = np.where(clipped[:, None], -t, (cosine[:, None] * e - t) / square[:, None])
        turned = ((on_edge[best] + 2 * cosine * place)[:, None] * e - w) / square[:, None]
        by_tangent = np.where(clipped[:, None], foot[:, None] * e - w, turned)
        apart_by = np.where(inside, highest, np.where(clipped, distance[best], height[best]))
        return _Line(apart_by, normal, place, by_point, by_tangent, clipped | (square > _PARALLEL))

    def wander(self, point: Array, tangent: Array) -> Array:
        result = np.full(len(point), np.inf)
        rows = np.flatnonzero(np.isfinite(point).all(axis=1) & np.isfinite(tangent).all(axis=1))
        if len(rows):
            at, along = point[rows], tangent[rows]
            line = self.lines(at, along)
            # nearest to the contact is where the line turns about
            at = at + line.place[:, None] * along
            turned = [np.cos(_TURNED) * along + sign * np.sin(_TURNED) * line.normal for sign in (1, -1)]
            one, other = (self.lines(at, direction) for direction in turned)
            result[rows] = np.where(line.across, np.maximum(np.abs(one.place), np.abs(other.place)), np.inf)
        return result

    def located(self, points: Array, outside: Array) -> Located:
        """The spheres nearest to the contacts: how nearly contacts are those of a compact body, whatever its shape."""
        centre = nearest_sphere(points)
        distance = np.linalg.norm(points - centre[:, None], axis=2)
        misfit = np.median(np.abs(distance - np.median(distance, axis=1, keepdims=True)), axis=1)
        largest = float(np.linalg.norm(self.vertices, axis=1).max())
        beyond = np.median(np.maximum(distance - largest, 0) + np.maximum(self.size - distance, 0), axis=1)
        return Located(centre, np.broadcast_to(np.eye(3), (len(points), 3, 3)), misfit + beyond)


def _first_least(values: Array, starts: NDArray[np.intp]) -> Index:
    """Where (g,) the least value of each group of values is, from the group's start; groups begin at `starts`."""
    least = np.repeat(np.minimum.reduceat(values, starts), np.diff(starts, append=len(values)))
    hits = np.flatnonzero(values == least)
    group = np.searchsorted(starts, hits, side="right") - 1
    first = np.unique(group, return_index=True)[1]
    return np.asarray(hits[first] - starts)
