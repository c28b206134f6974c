"""The Hausdorff distance of two surfaces, with certified bounds.

With d(x, B) the distance from a point to a surface, the one-sided distance from A to B is the largest d(x, B) over *all
points* x of A, and the Hausdorff distance h(A, B) is the larger of the two one-sided ones.

For two convex closed surfaces A, B bounding K, L it is exactly r = the largest, over the vertices of both, of the
distance to the other surface.  Proof.  (1) d(., L) is convex, so over K it is largest at a vertex of A, where it is
d(v, B) unless zero; likewise the other way.  So h(K, L) <= r, and r, taken at points of A and B, is <= h(A, B).
(2) h(A, B) <= h(K, L): let x be in A.  If x isn't inside L, d(x, B) = d(x, L).  Otherwise let u be an outer normal of K
at x.  L lies in K + h(K, L) * ball, so along u it reaches at most h(K, L) beyond x: the ray from x along u leaves L,
through B, within h(K, L).  Hence r = h(A, B).  (Schneider, *Convex Bodies: The Brunn-Minkowski Theory*, lemma 1.8.1.)

The smaller of the one-sided distances, and surfaces that aren't convex, have no such shortcut: the farthest point may lie
inside a face.  There a triangle T of A is bounded by min_j max_v d(v, t_j), with v its corners and t_j any triangles of B,
for the distance to a convex set is convex.  Where B is convex, its planes instead bound the points of T inside it, far
more tightly, and the points outside never exceed the vertices.  Splitting the triangles with the largest bounds closes
the gap.  A mesh convex but for rounding (a single-precision file) is held against its hull, and the bounds widened by
``slack``, the distance between the two.

Lengths in this module are in diagonals of the two meshes' common bounding box.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from scan3d.arrays import Array, Index
from scan3d.geometry.distance import Search
from scan3d.geometry.hull_distance import against_hull, prepare_facets
from scan3d.geometry.triangles import distance_to, halve, least

if TYPE_CHECKING:
    import trimesh

ROUNDING = 1e-15  # of the diagonal
RELATIVE_GAP = 1e-3  # of the distance: certified bounds this close are close enough
ABSOLUTE_GAP = 1e-9  # of the diagonal: likewise
MAX_SPLITS = 40_000  # per direction, a fraction of a second; beyond it the bounds stay honest, only wider
BATCH = 4096


class Side(NamedTuple):
    """Bounds of a one-sided distance, and the point (3,) where the lower one is attained."""

    lower: float
    point: Array
    upper: float


@dataclass(frozen=True)
class Body:
    """A triangle mesh ready for distance queries."""

    vertices: Array  # (n, 3)
    faces: Index  # (m, 3), longest edge first
    corners: Array  # (m, 3, 3) vertices of the faces
    normals: Array  # (m, 3), zero where a face has no area
    volume: float  # NaN unless closed
    planes: Array  # (m, 4) per face, n and c of a plane <n, x> = c that supports the hull
    slack: float  # bound of the Hausdorff distance between this surface and its hull's; infinite if far from convex
    search: Search


def prepare(mesh: trimesh.Trimesh, centre: Array, scale: float) -> Body:
    """Bring a mesh to the common size, judge its convexity and set up its distance queries."""
    facets = prepare_facets(mesh, centre, scale)
    planes, slack = against_hull(facets)
    return Body(
        facets.vertices,
        facets.faces,
        facets.corners,
        facets.normals,
        facets.volume,
        planes,
        slack,
        Search(facets.corners),
    )


def one_sided_distances(pairs: tuple[tuple[Body, Body], ...], exact: bool) -> list[Side]:
    """From each source to its target; the larger one without a gap if both are convex."""
    quick = [target.search.near(source.vertices)[:2] for source, target in pairs]
    known = [np.zeros(len(distance), dtype=bool) for distance, _ in quick]

    def settle(floor: float, gap: float) -> float:
        """Replace quick distances by exact ones until none can exceed `floor` or, by `gap`, its side's largest."""
        largest = []
        for (source, target), (distance, face), sure in zip(pairs, quick, known, strict=True):
            some = 16
            while True:
                enough = max(floor, (1 + gap) * distance[sure].max(initial=0.0)) + ROUNDING
                rest = np.flatnonzero(~sure & (distance > enough))
                if len(rest) == 0:
                    break
                part = rest[np.argsort(-distance[rest])[:some]]
                better, face[part] = target.search.nearest(source.vertices[part])
                distance[part] = np.minimum(better, distance[part])
                sure[part] = True
                some *= 2
            largest.append(distance[sure].max(initial=0.0))
        return float(max(largest))

    largest = settle(floor=settle(floor=0.0, gap=RELATIVE_GAP / 2), gap=0.0)
    slacks = [source.slack for source, _ in pairs]
    cap = largest if exact else largest + sum(slacks) + max(slacks)
    sides = []
    for (source, target), (distance, face), sure in zip(pairs, quick, known, strict=True):
        at = int(np.where(sure, distance, -1.0).argmax())
        start = Side(float(distance[at]), source.vertices[at], float(distance.max()))
        sides.append(_split(source, target, face, start, cap))
    return sides


def _split(source: Body, target: Body, near: Index, vertices: Side, cap: float) -> Side:
    """The largest distance from any point of the source to the target, by splitting faces.

    near (n,): a target face near each vertex of the source.  vertices: bounds of the largest distance at a vertex.
    cap: an upper bound known otherwise.
    """
    lower, point, settled = vertices
    convex = target.slack <= RELATIVE_GAP / 10 * lower
    slack = target.slack if convex else 0.0

    def bound(corners: Array, faces: Index) -> tuple[Array, Index]:
        """Bound of the distance over triangles (m, 3, 3), from target faces (m, 4), and the face that gives it."""
        if convex:
            plane = target.planes[faces]
            values = plane[..., 3, None] - np.einsum("mjx,mix->mji", plane[..., :3], corners)
        else:
            values = distance_to(corners[:, None], target.corners[faces][:, :, None])
        return least(values.max(axis=2), faces)

    def gap() -> float:
        return max(RELATIVE_GAP * lower, ABSOLUTE_GAP)

    if cap - lower <= gap():
        return Side(lower, point, cap)
    corners, faces = source.corners, near[source.faces[:, [0, 1, 2, 0]]]
    above, faces[:, 3] = bound(corners, faces)
    loose = np.flatnonzero(above + slack > lower + gap())
    faces[loose, 3] = target.search.near(corners[loose].mean(axis=1))[1]
    above[loose], faces[loose, 3] = bound(corners[loose], faces[loose])
    splits = 0
    while True:
        # Let go of the triangles that can't matter; of the others, split those first that allow for most.
        matters = above + slack > lower + gap()
        settled = max(settled, float(above[~matters].max(initial=0.0)))
        corners, faces, above = corners[matters], faces[matters], above[matters]
        if len(above) == 0 or splits >= MAX_SPLITS or cap - lower <= gap():
            highest = max(lower, settled, float(above.max(initial=0.0)))
            return Side(lower, point, max(lower, min(cap, highest + slack)))
        order = np.argsort(-above)
        first, rest = order[:BATCH], order[BATCH:]
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
