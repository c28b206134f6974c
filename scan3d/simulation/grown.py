"""Plane sections of a body, fattened by a rod's radius if it is convex: the contours that the rod's centre line touches.

The surface of a convex polyhedron fattened by a ball of radius a consists of its faces moved outwards by a, of parts of
cylinders about its edges, and of parts of spheres about its vertices.  A plane cuts the cylinders in arcs of ellipses and the
spheres in arcs of circles.  With the angle φ of the normal n(φ) about an edge, the arc is

    e + τ(φ) d + a n(φ),        τ(φ) = (z - <e, k> - a <n(φ), k>) / <d, k>,        0 <= τ <= length of the edge,

with the edge's end e and direction d, and the plane's height z along k; it ends where τ does, and there begins an arc about a
vertex.  The contours returned are polygons with all their vertices on such arcs, and on the lines between them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from scan3d.arrays import NEGLIGIBLE, ROUNDING, Array, Index, ranges
from scan3d.geometry.convexity import is_convex
from scan3d.geometry.sections import convex_polygon, extent_along, slice_outlines, slice_polygons
from scan3d.spatial.bodies import RoundedPolyhedron

if TYPE_CHECKING:
    import trimesh

# Distance of the polygons from the arcs, in rod lengths: an eighth of the error that exact contacts may have.
_SAGITTA = 2.5e-10


def grown_extent(mesh: trimesh.Trimesh, axis: Array, radius: float) -> tuple[float, float]:
    """Lowest and highest coordinate along an axis (3,) of a mesh fattened by a radius."""
    low, high = extent_along(mesh, axis)
    return low - radius, high + radius


def sections(
    mesh: trimesh.Trimesh, frame: Array, heights: Array, radius: float = 0.0, length: float = 1.0
) -> list[list[Array]]:
    """The contours of plane sections that can be reached from outside, as `slice_outlines`, for a rod of a radius and a length.

    A convex mesh may be fattened by the radius: then the contours' vertices are exact to rounding, and their sides within
    `_SAGITTA` of the surface.
    """
    if not is_convex(mesh):
        return slice_outlines(mesh, frame, heights)
    polygons = _grown_polygons(mesh, frame, heights, radius, length) if radius else slice_polygons(mesh, frame, heights)
    return [[polygon] if len(polygon) else [] for polygon in polygons]


def _grown_polygons(mesh: trimesh.Trimesh, frame: Array, heights: Array, radius: float, length: float) -> list[Array]:
    center = mesh.bounds.mean(axis=0)
    origin = frame @ center
    body = RoundedPolyhedron((mesh.vertices.view(np.ndarray) - center) @ frame.T, mesh.faces)
    step = float(np.sqrt(8 * _SAGITTA * length / radius))
    rounding = ROUNDING * float(np.abs(body.vertices).max())
    return [convex_polygon(_outline(body, z, radius, step), rounding) + origin[:2] for z in heights - origin[2]]


def _outline(body: RoundedPolyhedron, height: float, radius: float, step: float) -> Array:
    """Points (n, 2) of the section of a fattened polyhedron, no farther apart on its arcs than turns by `step`."""
    ends = body.vertices[2, np.stack([body.tail, body.head])]
    near = (ends.min(axis=0) <= height + radius) & (ends.max(axis=0) >= height - radius) & (body.angle > 0)
    edge = np.flatnonzero(near)
    angle, rise, across = body.angle[edge], body.left_normal[2, edge], body.turned[2, edge]
    largest, top = np.hypot(rise, across), np.arctan2(across, rise)
    # where the arc about an edge ends at one of its vertices: (2 ends, 2 solutions, e)
    vertex = np.stack([body.tail[edge], body.head[edge]])
    level = (height - body.vertices[2, vertex]) / radius
    with np.errstate(divide="ignore", invalid="ignore"):
        half = np.arccos(level / largest)
    turn = np.mod(np.stack([top - half, top + half], axis=1), 2 * np.pi)
    ended = turn <= angle  # not where it is NaN
    at_end, _, row = np.nonzero(ended)
    joints = vertex[at_end, row], _normals(body, edge[row], turn[ended])
    parts = [body.vertices[:, joints[0]] + radius * joints[1]]
    # the arcs between these places
    places = np.sort(
        np.concatenate([np.zeros((1, len(edge))), np.where(ended, turn, 0.0).reshape(4, -1), angle[None]]), axis=0
    )
    first, last = places[:-1], places[1:]
    slope = body.direction[2, edge] * body.length[edge]
    middle = (height - ends[0, edge] - radius * _rise(rise, across, (first + last) / 2)) / np.where(slope, slope, 1.0)
    size = float(np.abs(body.vertices).max())
    arc = (last > first) & (middle >= 0) & (middle <= 1) & (np.abs(slope) > NEGLIGIBLE * size)
    number, row = np.nonzero(arc)
    part, turn = _spread(row, first[number, row], last[number, row], step)
    along = (height - ends[0, edge[part]] - radius * _rise(rise[part], across[part], turn)) / slope[part]
    chosen = edge[part]
    span = body.length[chosen] * body.direction[:, chosen]
    parts.append(
        body.vertices[:, body.tail[chosen]] + np.clip(along, 0, 1) * span + radius * _normals(body, chosen, turn)
    )
    parts.append(_about_vertices(body, height, radius, step, *joints))
    return np.concatenate(parts, axis=1)[:2].T


def _rise(rise: Array, across: Array, turn: Array) -> Array:
    return rise * np.cos(turn) + across * np.sin(turn)


def _normals(body: RoundedPolyhedron, edge: Index, turn: Array) -> Array:
    """Normals (3, n) about edges (n,), turned from those of their left faces."""
    return np.cos(turn) * body.left_normal[:, edge] + np.sin(turn) * body.turned[:, edge]


def _spread(row: Index, first: Array, last: Array, step: float) -> tuple[Index, Array]:
    """Values from first to last (n,), no farther apart than a step, and the row of each."""
    count = np.ceil((last - first) / step).astype(np.intp) + 1
    number, rank = ranges(count)
    part = rank / np.maximum(count - 1, 1)[number]
    return row[number], first[number] + part * (last - first)[number]


def _about_vertices(
    body: RoundedPolyhedron, height: float, radius: float, step: float, vertex: Index, normals: Array
) -> Array:
    """Points (3, n) of the arcs about vertices, which begin and end at normals (3, k) about vertices (k,)."""
    level = (height - body.vertices[2]) / radius
    alone = np.setdiff1d(np.flatnonzero(np.abs(level) <= 1), vertex)  # whole circles, or nothing
    turn = np.concatenate([np.arctan2(normals[1], normals[0]), np.zeros(len(alone))])
    vertex = np.concatenate([vertex, alone])
    if not len(vertex):
        return np.empty((3, 0))
    order = np.lexsort((turn, vertex))
    vertex, turn = vertex[order], turn[order]
    begins = np.flatnonzero(np.diff(vertex, prepend=-1))
    following = np.append(turn[1:], 0.0)
    following[np.append(begins[1:], len(turn)) - 1] = turn[begins] + 2 * np.pi

    def normal(vertex: Index, turn: Array) -> Array:
        flat = np.sqrt(np.maximum(1 - level[vertex] ** 2, 0.0))
        return np.stack([flat * np.cos(turn), flat * np.sin(turn), level[vertex]])

    middle = normal(vertex, (turn + following) / 2)
    inside = ((body.away[:, :, vertex] * middle[:, None]).sum(axis=0) <= NEGLIGIBLE).all(axis=0)
    vertex, turn = _spread(vertex[inside], turn[inside], following[inside], step)
    return body.vertices[:, vertex] + radius * normal(vertex, turn)
