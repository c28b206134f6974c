"""The Hausdorff distance of two surfaces, with certified bounds.

With d(x, B) the distance from a point to a surface, the one-sided distance from A to B is the largest d(x, B) over *all
points* x of A, and the Hausdorff distance h(A, B) is the larger of the two one-sided ones.

For two convex closed surfaces A, B bounding K, L it is exactly r = the largest, over the vertices of both, of the
distance to the other surface.  Proof.  (1) d(., L) is convex, so over K it is largest at a vertex of A, where it is
d(v, B) unless zero; likewise the other way.  So h(K, L) <= r, and r, taken at points of A and B, is <= h(A, B).
(2) h(A, B) <= h(K, L): let x be in A.  If x isn't inside L, d(x, B) = d(x, L).  Otherwise let u be an outer normal of K
at x.  L lies in K + h(K, L) * ball, so along u it reaches at most h(K, L) beyond x: the ray from x along u leaves L,
through B, within h(K, L).  Hence r = h(A, B).  (Schneider, *Convex Bodies: The Brunn-Minkowski Theory*, lemma 1.8.1.)

The smaller of the one-sided distances, and the distances of surfaces that aren't convex, can't be computed from the vertices
alone, because the farthest point may lie inside a face.  There the distance from a triangle T of A is bounded by
min_j max_v d(v, t_j), with v the corners of T and t_j any triangles of B, because the distance from a convex set is convex.  If
B is convex, its planes bound the distance from the points of T inside it far more tightly, and points outside are never farther
than the vertices.  Splitting the triangles with the largest bounds brings the bounds together.  A mesh that is convex but for
rounding (from a single-precision file) is replaced by its hull, and the bounds are widened by ``slack``, the distance between
the two.

Lengths in this module are in diagonals of the two meshes' common bounding box.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scan3d.arrays import NEGLIGIBLE, Array, Index, Mask
from scan3d.geometry.distance import Search
from scan3d.geometry.hulls import Facets, against_hull, prepare_facets
from scan3d.geometry.triangles import distance_to, halve, longest_first, without_unused

if TYPE_CHECKING:
    import trimesh

# The bounds are not improved further where their difference is less than this fraction of the distance, or less than this
# number of diagonals.
RELATIVE_GAP = 1e-3


class Side(NamedTuple):
    """Bounds of a one-sided distance, and the point (3,) where the lower one is attained."""

    lower: float
    point: Array
    upper: float


@dataclass(frozen=True, kw_only=True)
class Body(Facets):
    """A triangle mesh ready for distance queries."""

    planes: Array
    """(m, 4) for each face, n and c of a plane <n, x> = c that supports the hull."""
    slack: float
    """Upper bound of the Hausdorff distance between this surface and that of its hull; may be infinite."""
    search: Search
    """Of the faces."""


def prepare(mesh: trimesh.Trimesh, centre: Array, scale: float) -> Body:
    """A mesh moved by ``-centre`` and divided by `scale`, its distance from its hull, and the search for its nearest faces."""
    facets = prepare_facets(mesh, centre, scale)
    planes, slack = against_hull(facets)
    return Body(**vars(facets), planes=planes, slack=slack, search=Search(facets.corners))


def deepest_dent(points: Array, faces: Index, facets: Index, planes: Array, negligible: float) -> tuple[float, Array]:
    """Upper bound of the depth of triangles below the surface of their convex hull, and the point (3,) where they are deepest.

    points (n, 3), faces (m, 3), facets (h, 3), planes (h, 4)
        at unit size; the hull's triangles, and their planes, n and c of ``<n, x> <= c``.
    negligible
        depth that is not determined further, because it is rounding.
    """
    bodies = []
    for triangles, supporting, slack in ((faces, np.empty((0, 4)), np.inf), (facets, planes, 0.0)):
        used, renumbered = without_unused(triangles)
        turned = np.take_along_axis(renumbered, longest_first(points[triangles]), axis=1)
        corners = points[used][turned]
        known = Facets(points[used], turned, corners, corners[:, 0], False, np.nan)
        bodies.append(Body(**vars(known), planes=supporting, slack=slack, search=Search(corners)))
    (found,) = one_sided_distances(((bodies[0], bodies[1]),), False, negligible)
    return found.upper, found.point


def one_sided_distances(
    pairs: tuple[tuple[Body, Body], ...], exact: bool, negligible: float = NEGLIGIBLE
) -> list[Side]:
    """The one-sided distances from each pair's source to its target; if all bodies are convex (`exact`), the larger one of the
    distances has equal bounds.  Bounds closer than `negligible` are not improved."""
    found, largest = _at_vertices(pairs)
    slacks = [source.slack for source, _ in pairs]
    upper = largest if exact else largest + sum(slacks) + max(slacks)
    sides = []
    for (source, target), (distance, face, exactly) in zip(pairs, found, strict=True):
        farthest = int(np.where(exactly, distance, -1.0).argmax())
        start = Side(float(distance[farthest]), source.vertices[farthest], float(distance.max()))
        sides.append(_split(source, target, face, start, upper, negligible))
    return sides


def _at_vertices(pairs: tuple[tuple[Body, Body], ...]) -> tuple[list[tuple[Array, Index, Mask]], float]:
    """Distances (n,) of each source's vertices from its target, the target's faces (n,) there, and whether they are exact (n,),
    and the largest distance.

    Distances that are not exact are upper bounds, and no larger than the largest distance.
    """
    quick = [target.search.near(source.vertices)[:2] for source, target in pairs]
    known = [np.zeros(len(distance), dtype=bool) for distance, _ in quick]

    def settle(floor: float, gap: float) -> float:
        """The largest distance of a vertex.

        Quick estimates are replaced by exact distances until none exceeds `floor` nor the largest exact distance of its side by
        more than the fraction `gap`.
        """
        largest = []
        for (source, target), (distance, face), exactly in zip(pairs, quick, known, strict=True):
            batch = 16  # doubled from batch to batch
            while True:
                threshold = max(floor, (1 + gap) * distance[exactly].max(initial=0.0)) + 1e-15  # rounding
                rest = np.flatnonzero(~exactly & (distance > threshold))
                if len(rest) == 0:
                    break
                part = rest[np.argsort(-distance[rest])[:batch]]
                improved, face[part] = target.search.nearest(source.vertices[part])
                distance[part] = np.minimum(improved, distance[part])
                exactly[part] = True
                batch *= 2
            largest.append(distance[exactly].max(initial=0.0))
        return float(max(largest))

    largest = settle(floor=settle(floor=0.0, gap=RELATIVE_GAP / 2), gap=0.0)
    return [(*estimate, exactly) for estimate, exactly in zip(quick, known, strict=True)], largest


def _split(source: Body, target: Body, near: Index, vertices: Side, upper: float, negligible: float) -> Side:
    """The largest distance from any point of the source to the target, by splitting faces.

    near (n,)
        a target face near each vertex of the source.
    vertices
        bounds of the largest distance at a vertex.
    upper
        an upper bound of the result that is already known.
    """
    lower, point, settled = vertices
    convex = target.slack <= RELATIVE_GAP / 10 * lower  # nearly
    slack = target.slack if convex else 0.0

    def bound(corners: Array, faces: Index) -> tuple[Array, Index]:
        """Upper bounds (m,) of the distance over triangles (m, 3, 3), and which of the target faces (m, k) give them."""
        if convex:
            plane = target.planes[faces]
            values = plane[..., 3, None] - np.einsum("mjx,mix->mji", plane[..., :3], corners)
        else:
            values = distance_to(corners[:, None], target.corners[faces][:, :, None])
        values = values.max(axis=2)
        least = (np.arange(len(values)), values.argmin(axis=1))
        return values[least], faces[least]

    def gap() -> float:
        return max(RELATIVE_GAP * lower, negligible)

    if upper - lower <= gap():
        return Side(lower, point, upper)
    corners, faces = source.corners, near[source.faces[:, [0, 1, 2, 0]]]
    above, faces[:, 3] = bound(corners, faces)
    loose = np.flatnonzero(above + slack > lower + gap())
    faces[loose, 3] = target.search.near(corners[loose].mean(axis=1))[1]
    above[loose], faces[loose, 3] = bound(corners[loose], faces[loose])
    splits = 0
    while True:
        # Triangles whose bounds are too small to matter are dropped; of the others, those with the largest bounds are split
        # first.
        matters = above + slack > lower + gap()
        settled = max(settled, float(above[~matters].max(initial=0.0)))
        corners, faces, above = corners[matters], faces[matters], above[matters]
        if len(above) == 0 or splits >= 40_000 or upper - lower <= gap():
            highest = max(lower, settled, float(above.max(initial=0.0)))
            return Side(lower, point, max(lower, min(upper, highest + slack)))
        order = np.argsort(-above)
        first, rest = order[:4096], order[4096:]  # so many at once
        middle = corners[first, :2].mean(axis=1)
        distance, face = target.search.nearest(middle)
        splits += len(first)
        if distance.max() > lower:
            lower, point = float(distance.max()), middle[distance.argmax()]
        halves, turn = halve(corners[first])
        close = np.concatenate([faces[first], faces[first]])
        close[: len(first), 1] = close[len(first) :, 0] = face
        close[:, :3] = np.take_along_axis(close[:, :3], turn, axis=1)
        tighter, close[:, 3] = bound(halves, close)
        corners, faces = np.concatenate([corners[rest], halves]), np.concatenate([faces[rest], close])
        above = np.concatenate([above[rest], np.minimum(tighter, np.tile(above[first], 2))])
