"""Where supporting planes of a convex body meet whose normals lie in known intervals (S28).

Let K be a convex body, and let n_i be normals with ``h_K(n_i) <= <n_i, p_i>``, each of them unknown in an arc about ν_i.  Let
the ν_i be triangulated as points of the sphere, and let ``det(n_i, n_j, n_k)`` be positive in every triangle for all 8 choices
of ends of its arcs.  A determinant is ``A cos θ + B sin θ`` in each angle, and so it is positive within the arcs too: the true
normals cover the sphere with the same triangles.  In the triangle of a direction u, ``h_K(u) <= <u, a>`` with the apex a, where
the three planes meet.  As one normal turns within its arc, the apex moves along the line in which the other two planes meet, so
that every convex function of the apex is largest at one of the 8 choices of ends.

The triangles are those of the polar dual of the polytope that the planes with the normals ν_i enclose.  Planes far away close
it where no normals are known; apexes on them are infinite.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from scan3d.arrays import Array, Index, Mask

# Smallest determinant of three unit normals that meet in an apex.  Larger, narrow triangles of normals are lost; smaller, the
# rounding of the apex is no longer small.
_FLATTEST = 1e-7
# Distance of the planes that close the polytope where no normals are known, in sizes of the body.  Larger, the rounding of
# the dual grows; smaller, steep but closed apexes count as open.
_FAR = 300.0
# Rounds in which planes are removed whose triangles turn over.  Each removes some; with fewer, bodies with wide intervals
# remain unbounded.
_REPAIRS = 60
# Half-widths below this, in radians, count as equal.  Larger, wide arcs would be kept; smaller, rounding chooses between arcs.
_NARROW = 1e-5
# Directions in a triangle in which the support function is bounded, by weights of its corners.  More give tighter local bounds
# and take longer.
_WEIGHTS = np.array([[1, 1, 1], [3, 1, 1], [1, 3, 1], [1, 1, 3], [2, 2, 1], [1, 2, 2], [2, 1, 2]]) / 5
_CORNERS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, 8).T


class SupportingPlanes(NamedTuple):
    """Planes (n,) through points, with normals ``cos θ middle + sin θ across``, |θ| <= half_width."""

    points: Array
    """(n, 3) in a frame in which the body has the size of about 1 and its middle lies in the origin."""
    middle: Array
    """(n, 3)"""
    across: Array
    """(n, 3)"""
    half_width: Array
    """(n,)"""

    def select(self, rows: Index) -> SupportingPlanes:
        return SupportingPlanes(*(column[rows] for column in self))

    def ends(self) -> Array:
        """Normals (n, 2, 3) at the ends of the arcs."""
        cos, sin = np.cos(self.half_width)[:, None], np.sin(self.half_width)[:, None]
        return np.stack([cos * self.middle - sin * self.across, cos * self.middle + sin * self.across], axis=1)


class Cover(NamedTuple):
    """Triangles (m,) of normals that cover the sphere of directions."""

    planes: Index
    """(m, 3) numbers of the planes; negative for those far away."""
    apexes: Array
    """(m, 8, 3) for all choices of ends; infinite where one of the planes is far away."""
    nominal: Array
    """(m, 3) apexes of the planes with the middle normals, planes far away included."""
    removed: Index
    """Numbers of the planes that were left out because their triangles turned over."""


def cover(planes: SupportingPlanes, chosen: Index) -> Cover | None:
    """The triangles of some of the planes; None if the rounding is too large."""
    far = _far_planes()
    removed: list[Index] = []
    for _ in range(_REPAIRS):
        some = SupportingPlanes(*(np.concatenate(pair) for pair in zip(far, planes.select(chosen), strict=True)))
        offset = (some.middle * some.points).sum(axis=1)
        positive = offset > 1 / _FAR
        if not positive.all():
            removed.append(chosen[~positive[len(far.points) :]])
            chosen = chosen[positive[len(far.points) :]]
            continue
        triangles = _triangles(some.middle / offset[:, None])
        if triangles is None:
            return None
        determinant, apexes = _apexes(some, triangles)
        bad = ~(determinant > _FLATTEST)
        if not bad.any():
            numbers = np.concatenate([-1 - np.arange(len(far.points)), chosen])[triangles]
            apexes[(numbers < 0).any(axis=1)] = np.inf
            nominal = np.linalg.solve(some.middle[triangles], offset[triangles][..., None])[..., 0]
            return Cover(numbers, apexes, nominal, np.concatenate([np.empty(0, dtype=np.intp), *removed]))
        widest = np.unique(_needless(some, triangles[bad], len(far.points))) - len(far.points)
        widest = widest[widest >= 0]
        if not len(widest):
            return None
        removed.append(chosen[widest])
        chosen = np.delete(chosen, widest)
    return None


def _needless(planes: SupportingPlanes, triangles: Index, far: int) -> Index:
    """The plane (m,) of each triangle that turns over which is removed: that with the widest arc; the first `far` planes stay.

    Of planes with equally narrow arcs it is the one between the other two: planes through one edge of a polyhedron have their
    normals on an arc, and the outer ones matter.
    """
    normals = planes.middle[triangles]
    opposite = np.linalg.norm(np.roll(normals, -1, axis=1) - np.roll(normals, 1, axis=1), axis=2)
    width = np.maximum(planes.half_width, _NARROW)[triangles] * (1 + 1e-3 * opposite)
    width[triangles < far] = -1.0
    return np.asarray(np.take_along_axis(triangles, width.argmax(axis=1)[:, None], axis=1)[:, 0])


def _far_planes() -> SupportingPlanes:
    normals = np.concatenate([np.eye(3), -np.eye(3), _CORNERS / np.sqrt(3)])
    # turned, so that no body's own normals are parallel to them
    first, _ = np.linalg.qr(np.array([[1.0, 0.37, 0.19], [-0.23, 1.0, 0.41], [0.13, -0.29, 1.0]]))
    normals = normals @ first.T
    across = np.cross(normals, np.roll(normals, 1, axis=1))
    return SupportingPlanes(_FAR * normals, normals, across, np.zeros(len(normals)))


def _triangles(dual: Array) -> Index | None:
    """The facets (m, 3) of the hull of points (n, 3) around the origin, counterclockwise from outside."""
    try:
        faces = ConvexHull(dual).simplices.astype(np.intp)
    except (QhullError, ValueError):
        return None
    mirrored = np.linalg.det(dual[faces]) < 0
    faces[mirrored] = faces[mirrored, ::-1]
    triangles: Index = faces
    return triangles


def _apexes(planes: SupportingPlanes, triangles: Index) -> tuple[Array, Array]:
    """The smallest determinant (m,) over all choices of ends, and the apexes (m, 8, 3) of the choices."""
    ends = ((_CORNERS + 1) // 2).astype(np.intp)
    normals = planes.ends()[triangles]
    a, b, c = (normals[:, k, ends[:, k]] for k in range(3))
    points = planes.points[triangles]
    origin = points.mean(axis=1)
    offset = points - origin[:, None]
    bc, ca, ab = np.cross(b, c), np.cross(c, a), np.cross(a, b)
    determinant = (a * bc).sum(axis=2)
    heights = [(n * offset[:, None, k]).sum(axis=2)[..., None] for k, n in enumerate((a, b, c))]
    with np.errstate(divide="ignore", invalid="ignore"):
        apexes = (heights[0] * bc + heights[1] * ca + heights[2] * ab) / determinant[..., None]
    return determinant.min(axis=1), apexes + origin[:, None]


def support_bounds(planes: SupportingPlanes, covering: Cover) -> tuple[Array, Array]:
    """Directions (d, 3) and upper bounds (d,) of the body's support function there, from the triangles that are closed.

    A direction lies in a triangle whichever normals its arcs contain if it does so at the ends of the arcs.
    """
    closed = np.isfinite(covering.apexes[:, 0, 0])
    triangles, apexes = covering.planes[closed], covering.apexes[closed]
    directions = np.einsum("wk,mkx->mwx", _WEIGHTS, planes.middle[triangles])
    directions /= np.linalg.norm(directions, axis=2)[:, :, None]
    ends = planes.ends()[triangles]
    inside = np.ones(directions.shape[:2], dtype=bool)
    for k in range(3):
        a, b = ends[:, (k + 1) % 3], ends[:, (k + 2) % 3]
        for i in range(2):
            for j in range(2):
                inside &= (directions * np.cross(a[:, i], b[:, j])[:, None]).sum(axis=2) >= 0
    values = np.einsum("mwx,mcx->mwc", directions, apexes).max(axis=2)
    return directions[inside], values[inside]


def cut_depths(planes: SupportingPlanes, rows: Index, points: Array) -> Array:
    """How far (m, k) points (m, 3) lie beyond some planes (k,), by the end of the arc at which it is least."""
    ends = planes.ends()[rows]
    offset = (ends * planes.points[rows, None]).sum(axis=2)
    depths: Array = np.minimum(*(points @ ends[:, k].T - offset[:, k] for k in range(2)))
    return depths


def thinned(planes: SupportingPlanes, multiple: float, least: float) -> Index:
    """Numbers of planes, those with narrow arcs first, none nearer to an earlier one than `least` and `multiple` widths."""
    width = np.maximum(least, multiple * planes.half_width)
    known = np.flatnonzero(np.isfinite(width) & (width < 1))
    order = known[np.argsort(width[known], kind="stable")]
    accepted = np.empty((0, 3))
    chosen: list[Index] = []
    for rows in np.array_split(order, max(1, len(order) // 500)):
        limit = np.cos(width[rows])
        free = rows if not len(accepted) else rows[((planes.middle[rows] @ accepted.T).max(axis=1) < limit)]
        cosines = planes.middle[free] @ planes.middle[free].T
        kept: Mask = np.zeros(len(free), dtype=bool)
        for i, bound in enumerate(np.cos(width[free])):
            kept[i] = not (cosines[i, :i][kept[:i]] >= bound).any()
        chosen.append(free[kept])
        accepted = np.concatenate([accepted, planes.middle[free[kept]]])
    return np.concatenate(chosen) if chosen else np.empty(0, dtype=np.intp)
