"""The hull of a mesh that is convex but for rounding, from the mesh, in linear time.

Of a closed mesh of a convex body in single precision a few of a hundred edges are reflex.  Such an edge is one diagonal of the
two triangles beside it, and the hull has the other one.  Flips of all reflex edges, and of those that become reflex, therefore
lead to the hull in nearly all cases, as in Lawson's algorithm for Delaunay triangulations, and every flip adds volume, so that
they end.  They need not lead there, so the edges of the result have to prove it (`scan3d.geometry.edges`).

In double precision the hull that Qhull computes has slivers instead, whose edges prove nothing; flips remove those as well.
"""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.geometry.edges import opposite_edges, outward_faces
from scan3d.geometry.triangles import dot, largest_of_three, spanned

# Largest number of reflex edges, for each face, for which flips are tried.  Larger, time is lost on meshes that have dents;
# smaller, nearly convex meshes are left to Qhull, which takes several times as long.
_MOST_REFLEX = 0.2
# A triangle is a sliver if it is no higher than this fraction of the distance by which flips may move the surface.  Larger, few
# rounds of them move it farther; smaller, slivers remain.
_THIN = 0.1
# Largest number of rounds of flips.  Larger, time is lost on meshes that have dents; smaller, as above.
_ROUNDS = 100


def facets_by_flips(points: Array, faces: Index) -> tuple[Index, Mask] | None:
    """The facets (m, 3), outward, of the hull of points (n, 3) at unit size, and which of them (m,) replace one of the faces
    (m, 3) of a closed mesh in the same row.

    None unless flips lead to a strictly convex body of all points.
    """
    centre = points.mean(axis=0)
    if dot((points - centre)[faces[:, 0]], spanned(points[faces])).sum() < 0:
        faces = faces[:, ::-1]
    found = opposite_edges(faces)
    if found is None:
        return None
    mesh = _Flippable(points - centre, faces.copy(), found.ravel())
    edges: Index = np.flatnonzero(mesh.opposite > np.arange(faces.size))  # each once
    for _ in range(_ROUNDS):
        edges = edges[mesh.reflex(edges)]
        if not len(edges):
            facets = outward_faces(points, mesh.faces, mesh.opposite.reshape(-1, 3))
            return None if facets is None else (facets, (facets != faces).any(axis=1))
        possible = mesh.independent(edges[mesh.allowed(edges)])
        if len(edges) > _MOST_REFLEX * len(faces) or not len(possible):
            return None
        edges = mesh.flip(edges, possible)
    return None


def without_slivers(points: Array, faces: Index, opposite: Index, limit: float) -> tuple[Index, Index, float]:
    """The faces (m, 3) of a closed mesh of points (n, 3), and their `opposite_edges` (m, 3), after flips of the longest edges
    of triangles whose corners lie on a line but for rounding, and how far the flips have moved the surface at most.

    The normal of such a triangle is made of rounding.  A flip makes two triangles with proper normals of it and its neighbour.
    None are flipped once the surface may have been moved farther than a limit.
    """
    centre = points.mean(axis=0)
    if dot((points - centre)[faces[:, 0]], spanned(points[faces])).sum() < 0:
        faces = faces[:, ::-1]
        # the side from the corner k to the next is now that from the corner 1 - k
        opposite = (opposite - opposite % 3 + (1 - opposite % 3) % 3)[:, [1, 0, 2]]
    mesh = _Flippable(points - centre, faces.copy(), opposite.ravel().copy())
    moved, tried = 0.0, np.arange(len(faces))
    for _ in range(_ROUNDS):
        thin = mesh.longest_of_thin(tried, limit * _THIN)
        possible = mesh.independent(thin[mesh.allowed(thin)])
        if not len(possible) or moved > limit:
            break
        # no two of them have a face in common, so that the largest of their distances counts
        moved += float(mesh.between_diagonals(possible).max())
        tried = np.unique(np.concatenate([thin, possible, mesh.opposite[possible]]) // 3)
        mesh.flip(possible, possible)
    return mesh.faces, mesh.opposite.reshape(-1, 3), moved


class _Flippable:
    """A closed mesh about a point inside, whose edges are flipped.

    An edge is given by the number ``3 f + k`` of one of its two sides, that of the face f from its corner k on.
    """

    def __init__(self, points: Array, faces: Index, opposite: Index) -> None:
        self.points, self.faces, self.opposite = points, faces, opposite
        self._renamed = np.arange(faces.size)
        self._first = np.full(len(faces), faces.size)

    def _around(self, edges: Index) -> tuple[Array, Array, Array, Array]:
        """Both ends (e, 3) of edges, and the third corners (e, 3) of the faces on their left and on their right."""
        other, corners = self.opposite[edges], self.faces.ravel()
        at = (edges, other, _before(edges), _before(other))
        start, end, left, right = (self.points[corners[number]] for number in at)
        return start, end, left, right

    def reflex(self, edges: Index) -> Mask:
        """Whether the face on the right of edges (e,) rises above the plane of the one on the left."""
        start, end, left, right = self._around(edges)
        rises: Mask = dot(np.cross(end - start, left - start), right - start) > 0
        return rises

    def allowed(self, edges: Index) -> Mask:
        """Whether the two faces on the other diagonal would be seen from the point inside as they are from outside."""
        start, end, left, right = self._around(edges)
        across = np.cross(right, left)
        proper: Mask = (dot(across, start) > 0) & (dot(across, end) < 0)
        return proper

    def longest_of_thin(self, faces: Index, height: float) -> Index:
        """The longest edges (e,) of those of the faces (m,) that are no higher than a height above them."""
        corners = self.points[self.faces[faces]]
        edges = np.roll(corners, -1, axis=1) - corners
        square, doubled = dot(edges, edges), np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
        thin = np.flatnonzero(doubled <= height * np.sqrt(largest_of_three(square)))
        longest: Index = 3 * faces[thin] + square[thin].argmax(axis=1)
        return longest

    def between_diagonals(self, edges: Index) -> Array:
        """Upper bounds (e,) of the distances between edges (e,) and the edges to which they would be flipped.

        The two faces beside an edge consist of four triangles about any of its points, and so do those beside the flipped edge.
        So a flip moves the surface by no more than the distance between a point of the one edge and a point of the other.
        """
        start, end, left, right = self._around(edges)
        along, across, way = end - start, right - left, left - start
        normal = np.cross(along, across)
        square = dot(normal, normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            one, other = (np.nan_to_num(dot(np.cross(way, e), normal) / square) for e in (across, along))
        one, other = (np.clip(part, 0.0, 1.0)[:, None] for part in (one, other))
        distance: Array = np.linalg.norm(way + other * across - one * along, axis=1)
        return distance

    def independent(self, edges: Index) -> Index:
        """Some of the edges (e,), of which no two have a face in common."""
        one, other = edges // 3, self.opposite[edges] // 3
        for face in (one, other):
            np.minimum.at(self._first, face, edges)
        chosen: Index = edges[(self._first[one] == edges) & (self._first[other] == edges)]
        self._first[one] = self._first[other] = self.faces.size
        return chosen

    def flip(self, reflex: Index, edges: Index) -> Index:
        """Flip independent edges, of those that are reflex; returns the edges that may be reflex thereafter, each once."""
        other, corners = self.opposite[edges], self.faces.ravel()
        start, end, left, right = (corners[n] for n in (edges, other, _before(edges), _before(other)))
        one, two = edges // 3, other // 3
        outer = np.concatenate([_before(edges), _after(other), _before(other), _after(edges)])
        places = np.concatenate([3 * one, 3 * one + 1, 3 * two, 3 * two + 1])
        beyond = self.opposite[outer]
        self._renamed[outer] = places
        beyond, rest = self._renamed[beyond], self._renamed[np.setdiff1d(reflex, edges)]
        self._renamed[outer] = outer
        self.faces[one], self.faces[two] = np.stack([left, start, right], axis=1), np.stack([right, end, left], axis=1)
        self.opposite[places], self.opposite[beyond] = beyond, places
        self.opposite[3 * one + 2], self.opposite[3 * two + 2] = 3 * two + 2, 3 * one + 2
        near = np.concatenate([rest, places])
        once: Index = np.unique(np.minimum(near, self.opposite[near]))
        return once


def _after(edges: Index) -> Index:
    """The next edges of the same faces."""
    return edges + np.where(edges % 3 == 2, -2, 1)


def _before(edges: Index) -> Index:
    """The edges before in the same faces, which begin at the corners that the edges do not have."""
    return edges + np.where(edges % 3 == 0, 2, -1)
