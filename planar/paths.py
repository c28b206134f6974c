"""The path of a contour: the lower side in pieces, in the order in which the rod passes them.

On a strictly convex contour the slope turns and the point moves along every piece.  A convex polygon is the limit: along an
edge the slope is fixed and the point moves, at a vertex the point is fixed and the slope turns through the vertex's cone of
normals.  Each piece has a parameter in [0, 1], so that polygons need no smoothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike

from planar.arrays import ROUNDING, Array, Index

# Upper bounds of a piece's length, in rod lengths, and of its turn: on larger pieces the base position may have two extrema, of
# which the second would be missed.
_LONGEST_PIECE = 0.05
_WIDEST_PIECE = np.radians(4.0)


class SmoothCurve(Protocol):
    """A strictly convex curve given by its slope angle."""

    def points(self, slope: ArrayLike) -> Array:
        """Points (n, 2) with the slope angles (n,) in radians."""

    def radius_of_curvature(self, slope: ArrayLike) -> Array:
        """Radius of curvature (n,) at the slope angles (n,), in rod lengths."""


@dataclass(frozen=True)
class Path:
    """Contours as the rod passes them: rows of pieces, those of contour i from `offsets[i]` to `offsets[i + 1]`.

    On a polygon's piece slope and point are linear in the parameter t in [0, 1]; a smooth contour evaluates them itself.
    """

    slope: Array
    """(p,) slope angle at the start of each piece, falling along the path."""
    turn: Array
    """(p,) change of slope over the piece, at most 0."""
    point: Array
    """(p, 2) contour point at the start."""
    move: Array
    """(p, 2) change of the point over the piece."""
    offsets: Index
    """(contours + 1,) first piece of each contour."""
    smooth: SmoothCurve | None = None

    def at(self, piece: Index, t: Array) -> tuple[Array, Array, Array]:
        """Slope, x and y of the contour at parameter t (n,) of the pieces (n,)."""
        slope = self.slope[piece] + t * self.turn[piece]
        if self.smooth is not None:
            points = self.smooth.points(slope)
            return slope, points[:, 0], np.where(slope == self.slope[0], self.point[0, 1], points[:, 1])
        point, move = self.point[piece], self.move[piece]
        return slope, point[:, 0] + t * move[:, 0], point[:, 1] + t * move[:, 1]

    def arc_rate(self, piece: Index, slope: Array) -> Array:
        """Signed arc length along the tangent per unit of t: at most 0, because the path runs against the tangent."""
        if self.smooth is not None:
            return self.smooth.radius_of_curvature(slope) * self.turn[piece]
        return np.asarray(-np.hypot(self.move[piece, 0], self.move[piece, 1]))


def smooth_path(curve: SmoothCurve) -> Path:
    """The path along the lower side of a smooth curve, as far as the tip of the upright rod reaches.

    Raises ValueError if the curve lies outside the rod's reach.
    """
    check_height(curve.points(np.zeros(1))[0, 1])

    def above_tip(slope: float) -> float:
        return float(curve.points(np.array([slope]))[0, 1] - 1.0)

    first, last = np.pi / 2, -np.pi / 2
    if above_tip(first) > 0:
        first = scipy.optimize.brentq(above_tip, 0.0, first, xtol=1e-16, rtol=1e-15)
    if above_tip(last) > 0:
        last = scipy.optimize.brentq(above_tip, last, 0.0, xtol=1e-16, rtol=1e-15)
    slope = np.linspace(first, last, 2 + int((first - last) / _WIDEST_PIECE))
    while True:
        chord = np.linalg.norm(np.diff(curve.points(slope), axis=0), axis=1)
        long = chord > _LONGEST_PIECE
        # contours of more than some thousand rod lengths have so many pieces
        if not long.any() or len(slope) > 100_000:
            break
        middle = (slope[:-1] + slope[1:]) / 2
        slope = np.sort(np.concatenate([slope, middle[long]]))[::-1]
    points = curve.points(slope)
    if above_tip(np.pi / 2) > 0:
        # Next to touch-down x0 varies with the square root of the height, which would amplify the rounding of y = 1.
        points[0, 1] = 1.0
    offsets = np.array([0, len(slope) - 1])
    return Path(slope[:-1], np.diff(slope), points[:-1], np.diff(points, axis=0), offsets, curve)


def polygon_paths(polygons: Sequence[Array]) -> Path:
    """One path over many polygons, which are swept together.

    Each polygon is given by its vertices (n, 2): convex, counter-clockwise, without collinear triples.  Raises ValueError if
    one of them lies outside the rod's reach.
    """
    pieces = []
    for vertices in polygons:
        check_height(vertices[:, 1].min())
        # those on the lower side, within reach and short enough
        pieces.append(_Pieces(*subdivided(*_within_reach(_lower_side(vertices)))[0]))
    offsets = np.cumsum([0] + [len(polygon.slope) for polygon in pieces])
    joined = _Pieces(*(np.concatenate(columns) for columns in zip(*pieces, strict=True)))
    return Path(joined.slope, joined.turn, joined.point, joined.move, offsets)


class _Pieces(NamedTuple):
    """Pieces (p,) of one polygon: the columns of a `Path`."""

    slope: Array
    turn: Array
    point: Array
    move: Array


def _lower_side(vertices: Array) -> _Pieces:
    """Vertex, edge, vertex, ..., vertex: the slope turns at the vertices, the point moves along the edges."""
    edges = np.roll(vertices, -1, axis=0) - vertices
    # Edges of the lower side run to the right.  Vertical edges stay out: the rod stands parallel to them without force.
    lower = np.flatnonzero(edges[:, 0] > 0)
    interruption = np.flatnonzero(np.diff(lower) != 1)
    if len(interruption):
        lower = np.roll(lower, -(interruption[0] + 1))
    corners = vertices[np.append(lower, (lower[-1] + 1) % len(vertices))][::-1]
    angles = np.arctan2(edges[lower, 1], edges[lower, 0])[::-1]

    count = 2 * len(angles) + 1
    slope, turn = np.empty(count), np.zeros(count)
    point, move = np.repeat(corners, 2, axis=0)[:-1], np.zeros((count, 2))
    bounds = np.concatenate([[np.pi / 2], angles, [-np.pi / 2]])
    slope[0::2], slope[1::2] = bounds[:-1], angles
    turn[0::2] = np.diff(bounds)
    move[1::2] = np.diff(corners, axis=0)
    return _Pieces(slope, turn, point, move)


def _within_reach(pieces: _Pieces) -> _Pieces:
    """The pieces below the tip of the upright rod, y <= 1: one interval of the path, because y is convex along it."""
    slope, turn, point, move = pieces
    ends = point + move
    inside = np.minimum(point[:, 1], ends[:, 1]) <= 1.0
    inside &= (turn != 0) | (np.abs(move).sum(axis=1) > 0)
    slope, turn, point, move, ends = slope[inside], turn[inside], point[inside], move[inside], ends[inside]
    if point[0, 1] > 1.0:
        cut = (point[0, 1] - 1.0) / (point[0, 1] - ends[0, 1])
        point[0] = point[0, 0] + cut * move[0, 0], 1.0
        move[0] = ends[0] - point[0]
    if ends[-1, 1] > 1.0:
        move[-1] *= (1.0 - point[-1, 1]) / (ends[-1, 1] - point[-1, 1])
    return _Pieces(slope, turn, point, move)


def subdivided(slope: Array, turn: Array, point: Array, move: Array) -> tuple[tuple[Array, Array, Array, Array], Index]:
    """The pieces divided evenly until none is longer or wider than the bounds, and the piece that each part is of."""
    parts = np.maximum(np.hypot(*move.T) / _LONGEST_PIECE, np.abs(turn) / _WIDEST_PIECE)
    parts = np.maximum(np.ceil(parts), 1).astype(np.intp)
    row = np.repeat(np.arange(len(parts)), parts)
    step = (np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts))[:, None]
    turn, move = turn[row] / parts[row], move[row] / parts[row, None]
    return (slope[row] + step[:, 0] * turn, turn, point[row] + step * move, move), row


def check_height(lowest: float) -> None:
    """Raise ValueError for an object whose lowest point is not between the base line and the tip of the rod."""
    if lowest <= 0:
        raise ValueError(f"the object must lie above the base line y = 0, its lowest point is at y = {lowest:.6g}")
    if lowest > 1 - ROUNDING:  # nearer to the tip, the contact force is lost in rounding
        raise ValueError(
            f"the object is out of the rod's reach: its lowest point is at y = {lowest:.6g} rod lengths, the tip at 1"
        )
