"""Supporting planes of a convex body at points of its surface where a line touches it (S27).

The line ``p + s t`` through a point p of the surface is free of the body's interior.  Some supporting plane at p contains it:
seen along t, every point q of the body leaves its normal a half turn of directions, and all of them together leave an arc::

    n = cos θ ν + sin θ τ,   |θ| <= δ,   ν, τ perpendicular to t.

Any points of the body may be chosen for q, since fewer points make
wider arcs only.  Where places have errors of at most e and t one of at most ε, the normal that is turned until it is
perpendicular to the measured t satisfies ``<n, q - p> <= e_p + e_q + ε |q - p|``.  Errors that differ between directions, of
at most ``√(nᵀSn)``, are a norm: for a normal that is turned by ψ from u towards v they are at most the sum of ``√(uᵀSu) cos ψ``
and ``√(vᵀSv) sin ψ``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import AT_ONCE, Array, Index, Mask, ratio
from scan3d.geometry.triangles import dot

# Neighbours of a point that are tried on every level of the search, by how many times the points of one level exceed those of
# the next, and neighbours of a vertex of the hull that the search moves to.
_NEIGHBOURS, _THINNED, _DEGREE = 12, 6, 12


class Places(NamedTuple):
    """Points (n,) and how far the true ones may be from them, in a direction u by ``errors + √(uᵀ spread u)``."""

    points: Array
    """(n, 3)"""
    errors: Array
    """(n,)"""
    spread: Array | None = None
    """(n, 3, 3) covariances, times the square of the number of standard deviations; None: errors are alike everywhere."""

    def select(self, rows: Mask | Index) -> Places:
        return Places(self.points[rows], self.errors[rows], None if self.spread is None else self.spread[rows])

    def largest(self) -> Array:
        """(n,) the largest errors in any direction."""
        return self.errors if self.spread is None else self.errors + np.sqrt(np.linalg.eigvalsh(self.spread)[:, -1])

    def along(self, directions: Array) -> Array:
        """(n, k) the largest errors along unit vectors (n, k, 3)."""
        found = np.repeat(self.errors[:, None], directions.shape[1], axis=1)
        if self.spread is not None:
            found += np.sqrt(np.maximum(np.einsum("nki,nij,nkj->nk", directions, self.spread, directions), 0.0))
        return found


class Arcs(NamedTuple):
    """Planes (n,) through points, with normals ``cos θ middle + sin θ across``, |θ| <= half_width."""

    middle: Array
    """(n, 3) unit vectors ν, the arcs' middles."""
    across: Array
    """(n, 3) unit vectors τ along the arcs, at their middles."""
    half_width: Array
    """(n,) δ in radians; NaN where the points contradict the premises, and where they lie on the line with the centre."""

    def ends(self) -> Array:
        """Normals (n, 2, 3) at the ends of the arcs."""
        cos, sin = np.cos(self.half_width)[:, None], np.sin(self.half_width)[:, None]
        return np.stack([cos * self.middle - sin * self.across, cos * self.middle + sin * self.across], axis=1)


def arcs_at(places: Places, tangents: Array, turns: Array, body: Places, edges: Index) -> Arcs:
    """The arcs of the normals at places (n,) of a body's surface, with unit vectors (n, 3) of lines that touch it there.

    turns
        (n,) largest errors of the tangents, in radians.
    body
        (h,) points of the body, the vertices of a convex polyhedron.
    edges
        (m, 2) the polyhedron's edges, by numbers of its vertices.
    """
    adjacent, levels = _adjacency(edges, len(body.points)), _levels(body.points)
    centre = body.points.mean(axis=0)
    parts = [Arcs(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))]
    every = np.arange(len(places.points))
    for rows in np.array_split(every, 1 + 3 * _NEIGHBOURS * len(levels) * len(every) // AT_ONCE):
        block = places.select(rows)
        sight = _Sight(block, tangents[rows], turns[rows], centre, body)
        near = [
            numbers[tree.query(block.points, k=np.arange(1, min(_NEIGHBOURS, tree.n) + 1))[1]]
            for tree, numbers in levels
        ]
        starts = np.concatenate(near, axis=1)
        low = _climb(sight.lowest, starts, adjacent) - np.pi / 2
        high = np.pi / 2 - _climb(sight.highest, starts, adjacent)
        parts.append(sight.arcs(low, high))
    return Arcs(*(np.concatenate(column) for column in zip(*parts, strict=True)))


class _Sight:
    """What is seen of a body along lines (b,) through points of its surface."""

    def __init__(self, places: Places, tangents: Array, turns: Array, centre: Array, body: Places) -> None:
        self._places, self._turns, self._body = places, turns, body
        self._farthest = places.largest()[:, None], body.largest()
        outward = places.points - centre
        error = self._farthest[0][:, 0] + self._farthest[1].mean() + turns * np.linalg.norm(outward, axis=1)
        self._outward = outward - dot(outward, tangents)[:, None] * tangents
        distance = np.linalg.norm(self._outward, axis=1)
        self._outward = ratio(self._outward, distance[:, None])
        self._across = np.cross(tangents, self._outward)
        # how far beyond a right angle the normal may be turned from the outward direction: the centre is a mean of points
        self._doubt = np.where(error < distance, np.arcsin(np.minimum(ratio(error, distance), 1.0)), np.inf)[:, None]

    def _angles(self, numbers: Index) -> tuple[Array, Array]:
        """Angles (b, k) at which points of the body are seen, from the direction to the centre, and what errors make of them.

        The normal's angle from the outward direction differs by no more than a right angle and that error from each of them.
        """
        offset = self._body.points[numbers] - self._places.points[:, None]
        x, y = -dot(offset, self._outward[:, None]), -dot(offset, self._across[:, None])
        distance = np.hypot(x, y)
        error = self._places.errors[:, None] + self._body.errors[numbers]
        if self._turns.any():
            error += self._turns[:, None] * (
                np.linalg.norm(offset, axis=2) + self._farthest[0] + self._farthest[1][numbers]
            )
        turned: Array | float = 0.0
        if self._body.spread is not None:
            across, along = self._spread(numbers, x, y, distance)
            turned, distance = np.arctan2(across, distance - along), np.hypot(across, np.maximum(distance - along, 0.0))
            turned = np.where(turned < np.pi / 2, turned, np.inf)
        sine = np.where(error < distance, ratio(error, distance), 1.0)
        # a point that is no farther away than the errors says nothing
        return np.arctan2(y, x), np.where(sine < 1, np.arcsin(sine), np.inf) + turned

    def _spread(self, numbers: Index, x: Array, y: Array, distance: Array) -> tuple[Array, Array]:
        """Errors (b, k) by the ellipsoids of both points, across the way between them, as it is seen, and along it."""
        assert self._places.spread is not None
        assert self._body.spread is not None
        spread, frame = self._body.spread[numbers], (self._outward, self._across)
        cos, sin = ratio(x, distance), ratio(y, distance)
        found = []
        for a, b in ((-sin, cos), (cos, sin)):
            u = a[..., None] * frame[0][:, None] + b[..., None] * frame[1][:, None]
            squares = (
                np.einsum("bki,bij,bkj->bk", u, self._places.spread, u),
                np.einsum("bki,bkij,bkj->bk", u, spread, u),
            )
            found.append(sum(np.sqrt(np.maximum(square, 0.0)) for square in squares))
        return found[0], found[1]

    def lowest(self, numbers: Index) -> Array:
        angle, error = self._angles(numbers)
        # of a point that may be seen on the other side the normal may be there as well
        return np.where(angle + error + self._doubt < np.pi, angle - error, -np.inf)

    def highest(self, numbers: Index) -> Array:
        angle, error = self._angles(numbers)
        return np.where(error + self._doubt - angle < np.pi, -angle - error, -np.inf)

    def arcs(self, low: Array, high: Array) -> Arcs:
        """The arcs between angles (b,)."""
        low, high = np.maximum(low, -np.pi), np.minimum(high, np.pi)
        middle, half = (low + high) / 2, (high - low) / 2
        half[~((half >= 0) & (half < np.pi / 2))] = np.nan
        cos, sin = np.cos(middle)[:, None], np.sin(middle)[:, None]
        normal, across = cos * self._outward + sin * self._across, cos * self._across - sin * self._outward
        return Arcs(normal, across, half)


def _climb(value: Callable[[Index], Array], starts: Index, adjacent: Index) -> Array:
    """The largest values (b,) that a search from vertices (b, k) finds by moving to better neighbours."""

    def best_of(numbers: Index) -> tuple[Array, Index]:
        trial = value(numbers)
        column = trial.argmax(axis=1)[:, None]
        return np.take_along_axis(trial, column, 1)[:, 0], np.take_along_axis(numbers, column, 1)[:, 0]

    best, here = best_of(starts)
    # it starts near its end, which few moves reach
    for _ in range(40):
        reached, there = best_of(adjacent[here])
        better: Mask = reached > best
        if not better.any():
            break
        here, best = np.where(better, there, here), np.where(better, reached, best)
    return np.asarray(best)


def _adjacency(edges: Index, count: int) -> Index:
    """Neighbours (count, d) of the vertices, d at most `_DEGREE`; a vertex with fewer neighbours stands for the others."""
    start, end = np.concatenate([edges, edges[:, ::-1]]).T
    order = np.argsort(start, kind="stable")
    start, end = start[order], end[order]
    rank = np.arange(len(start)) - np.searchsorted(start, start)
    adjacent = np.repeat(np.arange(count)[:, None], _DEGREE, axis=1)
    kept = rank < _DEGREE
    adjacent[start[kept], rank[kept]] = end[kept]
    return adjacent


def _levels(body: Array) -> list[tuple[cKDTree, Index]]:
    """Trees of all vertices and of fewer and fewer of them, with the vertices' numbers."""
    # a low-discrepancy order, so that every level is spread over the body, and the same points give the same levels
    order = np.argsort((np.arange(len(body)) * (np.sqrt(5) - 1) / 2) % 1, kind="stable")
    levels: list[tuple[cKDTree, Index]] = []
    count = len(body)
    while True:
        numbers = np.sort(order[:count])
        levels.append((cKDTree(body[numbers], balanced_tree=False), numbers))
        if count <= _NEIGHBOURS * _THINNED:
            return levels
        count //= _THINNED
