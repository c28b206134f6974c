"""Contours of the objects along which the rod is swept: the path of a convex one, and the closed loops of any.

A contour lies above the base line ``y = 0``.  The rod, clamped on that line and moved in -x, touches its lower side and passes
it from right to left: the slope angle ``α̃`` falls from ``π/2`` (right) through 0 (lowest point) to ``-π/2`` (left).
``t = (cos α̃, sin α̃)`` is the tangent and ``n = (sin α̃, -cos α̃)`` the outward normal.

The *path* of a convex contour is its lower side in pieces, in the order in which the rod passes them.  On a strictly convex
contour the slope turns and the point moves along every piece.  A polygon is the limit: along an edge the slope is fixed and the
point moves, at a vertex the point is fixed and the slope turns through the vertex's cone of normals, so that polygons need no
smoothing.

A contour that is not convex, or several in one plane, may be touched at several places at once.  Its *loops* run all around,
counter-clockwise, body on the left of ``(cos τ, sin τ)``, in *curves* (a line, or a smooth stretch of cubic polynomials or an
ellipse), whose point moves, and *vertices*, whose point is fixed while ``τ`` turns: to the left at a convex one, to the right
at a concave one.  A smooth loop is a single curve that closes.  `Outlines` has the loops of many bodies, each in its own plane.

Pieces of paths and of loops have a parameter in [0, 1].
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from planar.arrays import ROUNDING, Array, Index, Mask, finite, ranges, ratio
from planar.plots import Shown, plot_loops

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Points of the loops that are asked for their pieces, of those nearest to a place.
_NEAREST = 6
# Distance in the third dimension that keeps the planes of bodies apart in one tree.
_APART = 1e3


class Loop(NamedTuple):
    """A closed loop in pieces (p), the cubic polynomials of its curves (c), or an ellipse."""

    cubics: Array
    """(c, 4, 2) coefficients by rising power of the interval's fraction."""
    first: Index
    """(p,) first polynomial of each piece."""
    intervals: Index
    """(p,) its number of polynomials; 0 at a vertex."""
    tau: Array
    """(p,) tangent angle where a vertex begins."""
    turn: Array
    """(p,) its turn."""
    ellipse: Array
    """(3, 2) centre and two half-axes; NaN for polynomials."""


def polygon_loop(vertices: Array) -> Loop:
    """A polygon with counter-clockwise vertices (n, 2): piece 2k is edge k, 2k + 1 the vertex at its end."""
    edges = np.roll(vertices, -1, axis=0) - vertices
    angle = np.arctan2(edges[:, 1], edges[:, 0])
    n = len(vertices)
    cubics = np.zeros((n, 4, 2))
    cubics[:, 0], cubics[:, 1] = vertices, edges
    turn = np.zeros(2 * n)
    turn[1::2] = np.roll(_turns(vertices), -1)
    count = np.tile(np.array([1, 0], dtype=np.intp), n)
    return Loop(cubics, np.repeat(np.arange(n), 2), count, np.repeat(angle, 2), turn, np.full((3, 2), np.nan))


def spline_loop(points: Array) -> Loop:
    """The smooth loop through counter-clockwise points (n, 2): a periodic cubic spline over the chords' length."""
    closed = np.concatenate([points, points[:1]])
    chord = np.hypot(*np.diff(closed, axis=0).T)
    spline = scipy.interpolate.CubicSpline(np.concatenate([[0.0], np.cumsum(chord)]), closed, bc_type="periodic")
    cubics = spline.c[::-1].transpose(1, 0, 2) * (chord[:, None] ** np.arange(4))[:, :, None]
    one = np.zeros(1)
    return Loop(cubics, np.zeros(1, np.intp), np.array([len(points)], np.intp), one, one, np.full((3, 2), np.nan))


def ellipse_loop(semi_axes: tuple[float, float], center: ArrayLike, angle: float) -> Loop:
    c, s = np.cos(angle), np.sin(angle)
    axes = np.array([center, [c * semi_axes[0], s * semi_axes[0]], [-s * semi_axes[1], c * semi_axes[1]]], dtype=float)
    one = np.zeros(1)
    return Loop(np.zeros((1, 4, 2)), np.zeros(1, np.intp), np.ones(1, np.intp), one, one, axes)


class Place(NamedTuple):
    """The outline at a place (n,)."""

    point: Array
    """(n, 2)"""
    derivative: Array
    """(n, 2) of the point by u; 0 at a vertex."""
    tau: Array
    """(n,) tangent angle."""
    curvature: Array
    """(n,) positive where convex; ± infinite at a vertex."""


class Nearest(NamedTuple):
    """The outline next to points (n,)."""

    gap: Array
    """(n,) signed distance, negative inside a body."""
    piece: Index
    u: Array
    normal: Array
    """(n, 2) direction in which the signed distance rises."""


class Outlines:
    """The loops of many bodies, `loops[b]` those of body b, evaluated by arrays of pieces; not changed after it is made."""

    def __init__(self, loops: Sequence[Sequence[Loop]]) -> None:
        flat = [loop for body in loops for loop in body]
        pieces = np.array([len(loop.intervals) for loop in flat])
        cubics = np.array([len(loop.cubics) for loop in flat])
        start = np.cumsum(pieces) - pieces
        loop_of = np.repeat(np.arange(len(flat)), pieces)
        self.cubics = np.concatenate([loop.cubics for loop in flat])
        self.first = np.concatenate([loop.first for loop in flat]) + np.repeat(np.cumsum(cubics) - cubics, pieces)
        self.intervals = np.concatenate([loop.intervals for loop in flat])
        self.tau0 = np.concatenate([loop.tau for loop in flat])
        self.turn = np.concatenate([loop.turn for loop in flat])
        self.axes = np.stack([loop.ellipse for loop in flat])[loop_of]
        self.is_arc = np.isfinite(self.axes[:, 0, 0])
        self.is_vertex = self.intervals == 0
        self.is_closed = (pieces == 1)[loop_of]
        self.is_curved = ~self.is_vertex & (self.is_arc | self.is_closed | self.cubics[self.first, 2:].any(axis=(1, 2)))
        self._bends = bool(self.is_curved.any())
        within = np.arange(len(loop_of)) - start[loop_of]
        self.following = start[loop_of] + (within + 1) % pieces[loop_of]
        self.previous = start[loop_of] + (within - 1) % pieces[loop_of]
        # vertices take their place from the edge before them
        self.anchor = np.where(self.is_vertex, self.previous, np.arange(len(loop_of)))
        self.body = np.repeat(np.repeat(np.arange(len(loops)), [len(body) for body in loops]), pieces)
        self._sample(loop_of)

    def _sample(self, loop_of: Index) -> None:
        """Points on the curves, and the tree that finds them."""
        curves = np.flatnonzero(~self.is_vertex)
        parts = np.repeat(curves, 17)
        ends = self.at(parts, np.tile(np.linspace(0, 1, 17), len(curves))).point.reshape(-1, 17, 2)
        length = np.hypot(*np.diff(ends, axis=1).transpose(2, 0, 1)).sum(axis=1)
        whole = np.bincount(loop_of[curves], weights=length)
        number = np.maximum(np.ceil(1200 * length / whole[loop_of[curves]]), 3).astype(np.intp)
        number = np.maximum(number, 2 * self.intervals[curves])
        curve, step = ranges(number)
        self._piece, self._u = curves[curve], (step + 0.5) / number[curve]
        points = self.at(self._piece, self._u).point
        self.samples = points
        # both ends of edges too: six samples of others may be nearer than the first one beside a vertex
        ends = np.repeat(curves[~self.is_closed[curves]], 2)
        self._near = np.concatenate([self._piece, ends])
        self._near_u = np.concatenate([self._u, np.arange(len(ends)) % 2])
        near = self.at(self._near, self._near_u).point
        self._tree = scipy.spatial.cKDTree(np.column_stack([near, _APART * self.body[self._near]]))
        begins = np.flatnonzero(np.diff(self.body[self._piece], prepend=-1))
        # vertices are among the extreme points
        both = np.stack([self.at(self._piece, np.floor(self._u)).point, points])
        self.low = np.minimum.reduceat(both.min(axis=0), begins)
        self.high = np.maximum.reduceat(both.max(axis=0), begins)

    def at(self, piece: Index, u: Array) -> Place:
        """The outline at parameters u (n,) of pieces (n,); lines go on straight past their ends, closed curves around."""
        carrier, vertex = self.anchor[piece], self.is_vertex[piece]
        w = np.where(vertex, 1.0, u)
        w = np.where(self.is_closed[piece], w - np.floor(w), w)
        count = np.maximum(self.intervals[carrier], 1)
        interval = np.clip(np.nan_to_num(np.floor(w * count)), 0, count - 1).astype(np.intp)
        f = (w * count - interval)[:, None]
        rows = self.first[carrier] + interval
        c = self.cubics[rows] if self._bends else self.cubics[rows, :2]
        point, d1, d2 = c[:, 1] * f + c[:, 0], c[:, 1] * count[:, None], np.zeros((1, 2))
        if self._bends:
            point = ((c[:, 3] * f + c[:, 2]) * f + c[:, 1]) * f + c[:, 0]
            d1 = ((3 * c[:, 3] * f + 2 * c[:, 2]) * f + c[:, 1]) * count[:, None]
            d2 = (6 * c[:, 3] * f + 2 * c[:, 2]) * count[:, None] ** 2
        arc = self.is_arc[carrier]
        if arc.any():
            axes, around = self.axes[carrier[arc]], 2 * np.pi * w[arc, None]
            cos, sin = np.cos(around), np.sin(around)
            radial = cos * axes[:, 1] + sin * axes[:, 2]
            point[arc] = axes[:, 0] + radial
            d1[arc] = 2 * np.pi * (cos * axes[:, 2] - sin * axes[:, 1])
            d2[arc] = -((2 * np.pi) ** 2) * radial
        tau = np.arctan2(d1[:, 1], d1[:, 0])
        curvature = ratio(d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0], (d1**2).sum(axis=1) ** 1.5)
        tau = np.where(vertex, self.tau0[carrier] + u * self.turn[piece], tau)
        curvature = np.where(vertex, np.copysign(np.inf, self.turn[piece]), curvature)
        return Place(point, np.where(vertex[:, None], 0.0, d1), tau, curvature)

    def nearest(self, body: Index, points: Array, within: float = np.inf) -> Nearest:
        """The nearest place on the outline of each point's body, and the signed distance from it.

        Points that are farther away than `within`, and outside, may be given an infinite gap instead.
        """
        outside = np.maximum(self.low[body] - points, points - self.high[body]).max(axis=1) > within
        if outside.any():
            n = len(points)
            far = Nearest(np.full(n, np.inf), np.zeros(n, np.intp), np.zeros(n), np.full((n, 2), np.nan))
            if not outside.all():
                for column, values in zip(far, self.nearest(body[~outside], points[~outside], within), strict=True):
                    column[~outside] = values
            return far
        asked = np.column_stack([points, _APART * body])
        _, sample = self._tree.query(asked, k=_NEAREST)
        # of samples on one piece only the nearest
        piece, u = self._near[sample], self._near_u[sample]
        repeated = np.zeros(piece.shape, dtype=bool)
        for k in range(1, _NEAREST):
            repeated[:, k] = (piece[:, :k] == piece[:, k : k + 1]).any(axis=1)
        row, column = np.nonzero(~repeated)
        piece, u = piece[row, column], u[row, column]
        target = points[row]
        for _ in range(8):  # steps of Newton's iteration
            place = self.at(piece, u)
            offset = target - place.point
            along = (offset * place.derivative).sum(axis=1)
            speed = (place.derivative**2).sum(axis=1)
            # curvature of the distance, kept positive far inside concave arcs and beyond centres of curvature
            across = offset[:, 0] * place.derivative[:, 1] - offset[:, 1] * place.derivative[:, 0]
            bend = np.maximum(1 + place.curvature * across / np.sqrt(speed), 0.25)
            step = along / (speed * bend)
            moved = u + step
            moved = np.where(self.is_closed[piece], moved, np.clip(moved, 0.0, 1.0))
            change, u = np.abs(moved - u), moved
            if not (change > 1e-14).any():
                break
        u = np.where(self.is_closed[piece], u - np.floor(u), u)
        place = self.at(piece, u)
        offset = target - place.point
        far = np.hypot(*offset.T)
        # the nearest of each point's candidates
        order = np.lexsort((far, row))
        first = order[np.flatnonzero(np.diff(row[order], prepend=-1))]
        piece, u, far, offset, tau = piece[first], u[first], far[first], offset[first], place.tau[first]
        normal = np.stack([np.sin(tau), -np.cos(tau)], axis=1)
        # at the end of an edge the two normals together tell inside from outside
        end = np.where(u >= 1, self.following[piece], np.where(u <= 0, self.previous[piece], piece))
        corner = self.is_vertex[end] & ~self.is_closed[piece]
        middle = self.tau0[self.anchor[end]] + self.turn[end] / 2
        normal[corner] = np.stack([np.sin(middle), -np.cos(middle)], axis=1)[corner]
        sign = np.where((offset * normal).sum(axis=1) >= 0, 1.0, -1.0)
        clear = far > 1e-7
        normal[clear] = (sign[:, None] * offset / np.maximum(far, 1e-300)[:, None])[clear]
        # the place on a vertex by the direction of the normal
        around = np.arctan2(normal[:, 0], -normal[:, 1]) - self.tau0[self.anchor[end]]
        around = np.remainder(around + np.pi, 2 * np.pi) - np.pi
        share = np.clip(ratio(around, self.turn[end]), 0.0, 1.0)
        convex = corner & (self.turn[end] > 0)
        return Nearest(sign * far, np.where(convex, end, piece), np.where(convex, share, u), normal)

    def shifted(self, piece: Index, u: Array, tip: Mask) -> tuple[Index, Array]:
        """Places whose u left [0, 1], at the beginning or the end of the piece that comes there.

        Only the tip of a rod comes into a concave vertex; other contacts pass it.
        """
        closed = self.is_closed[piece]
        forward, backward = (u > 1) & ~closed, (u < 0) & ~closed
        moved = piece
        for _ in range(2):
            enters = (moved == piece) | (~tip & self.is_vertex[moved] & (self.turn[moved] < 0))
            moved = np.where(
                enters & forward, self.following[moved], np.where(enters & backward, self.previous[moved], moved)
            )
        start = np.where(forward, 0.0, np.where(backward, 1.0, u))
        return moved, start

    def touch_down(self, body: int) -> float:
        """Base position at which the straight rod coming from the right touches a body: the largest x at heights up to 1."""
        edges = np.flatnonzero((self.body == body) & ~self.is_vertex)
        if not self.is_curved[edges].any():
            (x, y), (dx, dy) = self.cubics[self.first[edges], 0].T, self.cubics[self.first[edges], 1].T
            cuts = (y - 1) * (y + dy - 1) < 0
            across = x[cuts] + (1 - y[cuts]) / dy[cuts] * dx[cuts]
            return float(max(x[y <= 1].max(initial=-np.inf), across.max(initial=-np.inf)))
        rows = np.flatnonzero(self.body[self._piece] == body)
        piece, u = np.repeat(self._piece[rows], 33), np.repeat(self._u[rows], 33).reshape(-1, 33)
        reach = np.full((len(rows), 1), 0.5) / np.bincount(self._piece)[self._piece[rows], None]
        best = -np.inf
        for _ in range(14):
            u = np.clip(u + reach * np.linspace(-1, 1, 33), 0, 1)
            points = self.at(piece, u.ravel()).point.reshape(*u.shape, 2)
            x = np.where(points[..., 1] <= 1, points[..., 0], -np.inf)
            column = np.argmax(x, axis=1)
            best = max(best, float(x.max(initial=-np.inf)))
            going = x.max(axis=1) > best - 2 * np.ptp(points[..., 0], axis=1) - 1e-12
            going[np.argmax(x.max(axis=1))] = True
            u = np.repeat(np.take_along_axis(u, column[:, None], axis=1), 33, axis=1)[going]
            reach = reach[going] / 12
            piece = np.repeat(piece.reshape(-1, 33)[going, 0], 33)
        return best


def crosses_itself(vertices: Array) -> tuple[int, int] | None:
    """Two edges of a closed polygon (n, 2) that meet without being neighbours, or None."""
    n = len(vertices)
    ends = np.roll(vertices, -1, axis=0)
    left, right = np.minimum(vertices, ends)[:, 0], np.maximum(vertices, ends)[:, 0]
    order = np.argsort(left)
    last = np.searchsorted(left[order], right[order], side="right")
    size = np.ptp(vertices, axis=0).max()
    for begin in range(0, n, 256):
        rows = np.arange(begin, min(begin + 256, n))
        row, rank = ranges(np.maximum(last[rows] - rows - 1, 0))
        a, b = order[rows[row]], order[rows[row] + 1 + rank]
        apart = np.abs(a - b)
        pairs = (apart > 1) & (apart < n - 1)
        a, b = a[pairs], b[pairs]
        hit = _meet(vertices[a], ends[a], vertices[b], ends[b], ROUNDING * size)
        if hit.any():
            k = int(np.argmax(hit))
            return int(a[k]), int(b[k])
    return None


def _meet(a: Array, b: Array, c: Array, d: Array, close: float) -> Mask:
    """Whether segments a-b and c-d (n, 2) have a point in common."""

    def cross(p: Array, q: Array) -> Array:
        return np.asarray(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])

    def touches(p: Array, start: Array, end: Array) -> Mask:
        along = end - start
        share = np.clip(((p - start) * along).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
        return np.asarray(np.hypot(*(p - start - share[:, None] * along).T) <= close)

    proper = (cross(b - a, c - a) * cross(b - a, d - a) < 0) & (cross(d - c, a - c) * cross(d - c, b - c) < 0)
    return np.asarray(proper | touches(a, c, d) | touches(b, c, d) | touches(c, a, b) | touches(d, a, b))


# Upper bounds of a piece's length, in rod lengths, and of its turn: on larger pieces the base position may have two extrema, of
# which the second would be missed.
_LONGEST_PIECE = 0.05
_WIDEST_PIECE = np.radians(4.0)


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
    smooth: SmoothContour | None = None

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


def smooth_path(curve: SmoothContour) -> Path:
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
        pieces.append(subdivided(*_within_reach(*_lower_side(vertices)))[0])
    offsets = np.cumsum([0] + [len(slope) for slope, *_ in pieces])
    slope, turn, point, move = (np.concatenate(columns) for columns in zip(*pieces, strict=True))
    return Path(slope, turn, point, move, offsets)


_Pieces = tuple[Array, Array, Array, Array]
"""Slope, turn, point and move of the pieces (p,) of one polygon, as in `Path`."""


def _lower_side(vertices: Array) -> _Pieces:
    """Vertex, edge, vertex, ..., vertex: the slope turns at the vertices, the point moves along the edges."""
    edges = np.roll(vertices, -1, axis=0) - vertices
    # Edges of the lower side run to the right.  Vertical edges stay out: the rod stands parallel to them without force, and
    # rounding would decide at which end it touches first.
    lower = np.flatnonzero(edges[:, 0] > 10 * ROUNDING * np.abs(edges[:, 1]))
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
    return slope, turn, point, move


def _within_reach(slope: Array, turn: Array, point: Array, move: Array) -> _Pieces:
    """The pieces below the tip of the upright rod, y <= 1: one interval of the path, because y is convex along it."""
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
    return slope, turn, point, move


def subdivided(slope: Array, turn: Array, point: Array, move: Array) -> tuple[_Pieces, Index]:
    """The pieces divided evenly until none is longer or wider than the bounds, and the piece that each part is of."""
    parts = np.maximum(np.hypot(*move.T) / _LONGEST_PIECE, np.abs(turn) / _WIDEST_PIECE)
    parts = np.maximum(np.ceil(parts), 1).astype(np.intp)
    row, step = ranges(parts)
    turn, move = turn[row] / parts[row], move[row] / parts[row, None]
    return (slope[row] + step * turn, turn, point[row] + step[:, None] * move, move), row


def check_height(lowest: float) -> None:
    """Raise ValueError for an object whose lowest point is not between the base line and the tip of the rod."""
    if lowest <= 0:
        raise ValueError(f"the object must lie above the base line y = 0, its lowest point is at y = {lowest:.6g}")
    if lowest > 1 - ROUNDING:  # nearer to the tip, the contact force is lost in rounding
        raise ValueError(
            f"the object is out of the rod's reach: its lowest point is at y = {lowest:.6g} rod lengths, the tip at 1"
        )


class Contour(Shown, ABC):
    """A contour in the plane, in rod lengths."""

    def plot(self, *, axes: Axes | ArrayLike | None = None, **style: Any) -> Any:
        """The contour in the plane.

        `axes` are matplotlib's, by default new ones; `style` is that of `matplotlib.axes.Axes.plot`.  Returns the axes.
        """
        return plot_loops([Outlines([[loop]]).samples for loop in self.loops()], axes, style)

    @property
    def is_convex(self) -> bool:
        """Whether the rod touches it at one place at a time, which then follows a path."""
        return True

    @abstractmethod
    def path(self) -> Path:
        """The part of a convex contour that the rod can reach, from its first touch onwards."""

    @abstractmethod
    def loops(self) -> list[Loop]:
        """The whole contour as closed loops, body on the left."""

    @abstractmethod
    def distance(self, points: ArrayLike) -> Array:
        """Distance (n,) of points (n, 2) to the contour, in rod lengths, never negative."""


class SmoothContour(Contour):
    """A strictly convex contour given by the place and the curvature of its points as functions of the slope angle."""

    @abstractmethod
    def points(self, slope: ArrayLike) -> Array:
        """Contour points (n, 2) with the slope angles (n,) in radians."""

    @abstractmethod
    def radius_of_curvature(self, slope: ArrayLike) -> Array:
        """Radius of curvature (n,) at the slope angles (n,), in rod lengths."""

    def path(self) -> Path:
        return smooth_path(self)


@dataclass(frozen=True)
class Ellipse(SmoothContour):
    """Ellipse with `semi_axes` (a, b), the first turned by `angle` from the x axis, in rod lengths and radians."""

    semi_axes: tuple[float, float]
    center: tuple[float, float]
    angle: float = 0.0

    def __post_init__(self) -> None:
        pairs = np.shape(self.semi_axes) == np.shape(self.center) == (2,) and np.ndim(self.angle) == 0
        if not (pairs and finite(*self.semi_axes, *self.center, self.angle) and min(self.semi_axes) > 0):
            raise ValueError(
                f"an ellipse needs two positive semi-axes, a center and an angle, all finite, got semi_axes={self.semi_axes}, "
                f"center={self.center}, angle={self.angle}"
            )

    def _normal_in_axes(self, slope: ArrayLike) -> tuple[Array, Array, Array]:
        slope = np.asarray(slope, dtype=float)
        # n = (sin α̃, -cos α̃) turned into the ellipse's axes
        u, v = np.sin(slope - self.angle), -np.cos(slope - self.angle)
        a, b = self.semi_axes
        return u, v, np.hypot(a * u, b * v)

    def loops(self) -> list[Loop]:
        return [ellipse_loop(self.semi_axes, self.center, self.angle)]

    def points(self, slope: ArrayLike) -> Array:
        u, v, support = self._normal_in_axes(slope)
        a, b = self.semi_axes
        p, q = a * a * u / support, b * b * v / support
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.stack([self.center[0] + c * p - s * q, self.center[1] + s * p + c * q], axis=-1)

    def radius_of_curvature(self, slope: ArrayLike) -> Array:
        a, b = self.semi_axes
        return np.asarray((a * b) ** 2 / self._normal_in_axes(slope)[2] ** 3)

    def distance(self, points: ArrayLike) -> Array:
        offset = np.asarray(points, dtype=float) - self.center
        c, s = np.cos(self.angle), np.sin(self.angle)
        x, y = np.abs(offset @ np.array([c, s])), np.abs(offset @ np.array([-s, c]))
        a, b = self.semi_axes
        # Foot point (a cos θ, b sin θ): alternating between the foot and the centre of curvature there converges fast.
        u, v = np.full_like(x, np.sqrt(0.5)), np.full_like(x, np.sqrt(0.5))
        for _ in range(60):  # until the error is rounding
            ex, ey = (a * a - b * b) * u**3 / a, (b * b - a * a) * v**3 / b
            scale = np.hypot(a * u - ex, b * v - ey) / np.maximum(np.hypot(x - ex, y - ey), np.finfo(float).tiny)
            u = np.clip(((x - ex) * scale + ex) / a, 0.0, 1.0)
            v = np.clip(((y - ey) * scale + ey) / b, 0.0, 1.0)
            norm = np.hypot(u, v)
            u, v = u / norm, v / norm
        return np.asarray(np.hypot(x - a * u, y - b * v))


@dataclass(frozen=True)
class Circle(SmoothContour):
    """Circle with `radius` and `center`, in rod lengths: the contour (4) of the paper."""

    radius: float
    center: tuple[float, float]

    def __post_init__(self) -> None:
        numbers = np.ndim(self.radius) == 0 and np.shape(self.center) == (2,)
        if not (numbers and finite(self.radius, *self.center) and self.radius > 0):
            raise ValueError(f"a circle needs a positive radius and a finite center, got {self}")

    def loops(self) -> list[Loop]:
        return [ellipse_loop((self.radius, self.radius), self.center, 0.0)]

    def points(self, slope: ArrayLike) -> Array:
        slope = np.asarray(slope, dtype=float)
        return np.asarray(self.center) + self.radius * np.stack([np.sin(slope), -np.cos(slope)], axis=-1)

    def radius_of_curvature(self, slope: ArrayLike) -> Array:
        return np.full(np.shape(slope), float(self.radius))

    def distance(self, points: ArrayLike) -> Array:
        offset = np.asarray(points, dtype=float) - self.center
        return np.abs(np.hypot(offset[..., 0], offset[..., 1]) - self.radius)


@dataclass(frozen=True, eq=False, repr=False)
class Polygon(Contour):
    """Polygon with `vertices` (n, 2) in rod lengths, in either order: any simple loop.

    Duplicate and collinear vertices are dropped; afterwards `vertices` runs counter-clockwise.  Raises ValueError if the
    polygon crosses or touches itself, or has no area.
    """

    vertices: Array

    def __repr__(self) -> str:
        return f"Polygon of {len(self.vertices)} vertices"

    def __init__(self, vertices: ArrayLike) -> None:
        vertices = _tidy(_checked_points(vertices, "a polygon", "vertices"))
        vertices.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)

    @cached_property
    def is_convex(self) -> bool:
        return not (_turns(self.vertices) < 0).any()

    def path(self) -> Path:
        _check_convex(self)
        return polygon_paths([self.vertices])

    def loops(self) -> list[Loop]:
        return [polygon_loop(self.vertices)]

    def distance(self, points: ArrayLike) -> Array:
        points = np.asarray(points, dtype=float)
        edges = np.roll(self.vertices, -1, axis=0) - self.vertices
        squared = (edges**2).sum(axis=1)
        nearest = np.empty(len(points))
        rows = max(1, 2_000_000 // len(edges))  # more pairs at once would take too much memory
        for start in range(0, len(points), rows):
            offset = points[start : start + rows, None] - self.vertices
            along = np.clip((offset * edges).sum(axis=-1) / squared, 0.0, 1.0)
            gap = np.linalg.norm(offset - along[..., None] * edges, axis=-1)
            nearest[start : start + rows] = gap.min(axis=1)
        return nearest


class _Looped(Contour):
    """Contours that are swept as loops: those that need not be convex."""

    @cached_property
    def _outline(self) -> Outlines:
        return Outlines([self.loops()])

    @property
    def is_convex(self) -> bool:
        return False

    def path(self) -> Path:
        raise ValueError(
            "only a contour that is known to be convex has a path by its slope: a circle, an ellipse or a polygon"
        )

    def distance(self, points: ArrayLike) -> Array:
        points = np.asarray(points, dtype=float)
        return np.abs(self._outline.nearest(np.zeros(len(points), dtype=np.intp), points).gap)


@dataclass(frozen=True, eq=False, repr=False)
class Curve(_Looped):
    """The smooth closed curve through `points` (n, 2) in rod lengths, convex or not: a periodic cubic spline.

    The points are those of one turn, in either order; the last is joined to the first.  Raises ValueError for curves that cross
    themselves.
    """

    points: Array

    def __repr__(self) -> str:
        return f"Curve through {len(self.points)} points"

    def __init__(self, points: ArrayLike) -> None:
        points = _checked_points(points, "a curve", "points")
        if len(points) > 1 and (points[0] == points[-1]).all():
            points = points[:-1]
        if not np.hypot(*(points - np.roll(points, 1, axis=0)).T).all():
            raise ValueError("a curve needs points that differ from their neighbours")
        # between few points the curve swings far from their polygon, which may even run the other way around
        powers = np.linspace(0, 1, max(4, 2048 // len(points)), endpoint=False)[:, None] ** np.arange(4)
        between = np.einsum("fk,pkx->pfx", powers, spline_loop(points).cubics).reshape(-1, 2)
        _, area = _extent(between)
        _check_crossing(between, "curve")
        points = np.array(points if area > 0 else points[::-1])  # a copy, which the caller may not change
        points.setflags(write=False)
        object.__setattr__(self, "points", points)

    @classmethod
    def from_points(cls, x: ArrayLike, y: ArrayLike) -> Curve:
        """From the coordinates (n,) of the points."""
        points = [np.asarray(column, dtype=float) for column in (x, y)]
        if points[0].ndim != 1 or points[0].shape != points[1].shape:
            raise ValueError(f"a curve needs x and y of one shape (n,), got {points[0].shape} and {points[1].shape}")
        return cls(np.stack(points, axis=1))

    def loops(self) -> list[Loop]:
        return [spline_loop(self.points)]


@dataclass(frozen=True)
class Contours(_Looped):
    """Several closed contours in one plane, swept together: bodies beside each other.

    Contours inside others are holes, or bodies in holes: no rod reaches them from outside, and they are left out.  Raises
    ValueError for contours that overlap.
    """

    parts: Sequence[Contour]

    def __post_init__(self) -> None:
        parts = tuple(self.parts)
        if not parts:
            raise ValueError("several contours need at least one")
        for part in parts:
            check_contour(part)
        outlines = [Outlines([part.loops()]) for part in parts]
        outer = []
        for i in range(len(parts)):
            hidden = False
            for k in range(len(parts)):
                apart = (outlines[i].low > outlines[k].high) | (outlines[k].low > outlines[i].high)
                if k != i and not apart.any():
                    points = outlines[i].samples
                    gap = outlines[k].nearest(np.zeros(len(points), dtype=np.intp), points, ROUNDING).gap
                    inside = gap < -ROUNDING
                    if inside.any() != inside.all() or (np.abs(gap) <= ROUNDING).all():
                        raise ValueError("contours in one plane must not overlap; give the outline of their union")
                    hidden |= bool(inside.all())
            if not hidden:
                outer.append(parts[i])
        object.__setattr__(self, "parts", tuple(outer))

    def loops(self) -> list[Loop]:
        return [loop for part in self.parts for loop in part.loops()]


def mirrored(contour: Contour) -> Contour:
    """The mirror image of a contour, x → -x."""
    across = np.array([-1.0, 1.0])
    if isinstance(contour, Polygon):
        return Polygon(contour.vertices * across)
    if isinstance(contour, Curve):
        return Curve(contour.points * across)
    if isinstance(contour, Contours):
        return Contours([mirrored(part) for part in contour.parts])
    if isinstance(contour, Circle):
        return Circle(contour.radius, (-contour.center[0], contour.center[1]))
    if isinstance(contour, Ellipse):
        return Ellipse(contour.semi_axes, (-contour.center[0], contour.center[1]), -contour.angle)
    raise TypeError(f"the mirror image of a {type(contour).__name__} is not known")


def check_contour(contour: object) -> None:
    """Raise TypeError for anything that is not a contour, such as an array of vertices."""
    if not isinstance(contour, Contour):
        raise TypeError(f"a contour must be a planar.Circle, Ellipse, Curve or Polygon, got {type(contour).__name__}")


def _checked_points(given: ArrayLike, what: str, name: str) -> Array:
    points = np.asarray(given, dtype=float)
    if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 3:
        raise ValueError(f"{what} needs {name} of shape (n >= 3, 2), got {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError(
            f"{what} needs finite {name}, got {int((~np.isfinite(points)).any(axis=1).sum())} that are not"
        )
    return points


def _check_convex(contour: Polygon) -> None:
    turn = _turns(contour.vertices)
    if (turn < 0).any():
        worst, at = int(np.argmin(turn)), contour.vertices
        raise ValueError(
            f"this needs a convex polygon: at ({at[worst, 0]:.6g}, {at[worst, 1]:.6g}) it turns inwards by "
            f"{np.degrees(-turn[worst]):.3g}°; pass its convex hull (scipy.spatial.ConvexHull) if that is what you mean"
        )


def _check_crossing(vertices: Array, what: str) -> None:
    pair = crosses_itself(vertices)
    if pair is not None:
        x, y = vertices[pair[0]]
        raise ValueError(f"the {what} must not cross or touch itself: it does next to ({x:.6g}, {y:.6g})")


def _extent(vertices: Array) -> tuple[float, float]:
    """Size and signed area of a closed polygon, which must have one."""
    size = float(np.ptp(vertices, axis=0).max())
    following = np.roll(vertices, -1, axis=0)
    centre = vertices.mean(axis=0)
    (x, y), (u, v) = (vertices - centre).T, (following - centre).T
    area = np.sum(x * v - y * u) / 2
    if abs(area) <= ROUNDING * size**2:
        raise ValueError("a polygon needs an area: its vertices lie on one line, or the polygon crosses itself")
    return size, float(area)


def _turns(vertices: Array) -> Array:
    """Angles (n,) by which a closed polygon turns at its vertices."""
    before, after = vertices - np.roll(vertices, 1, axis=0), np.roll(vertices, -1, axis=0) - vertices
    return np.asarray(np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1)))


def _tidy(vertices: Array) -> Array:
    """Counter-clockwise vertices without duplicates and without corners that turn by less than rounding."""
    size = np.ptp(vertices, axis=0).max()
    steps = np.roll(vertices, -1, axis=0) - vertices
    kept = vertices[np.hypot(*steps.T) > ROUNDING * size]
    if len(kept) < 3:
        raise ValueError(f"a polygon needs at least three distinct vertices, got {len(kept)}")
    if _extent(kept)[1] < 0:
        kept = kept[::-1]
    while True:
        before, after = kept - np.roll(kept, 1, axis=0), np.roll(kept, -1, axis=0) - kept
        cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        chord = np.maximum(np.hypot(*(before + after).T), np.finfo(float).tiny)
        straight = (np.abs(cross) <= ROUNDING * size * chord) & ((before * after).sum(axis=1) > 0)
        # never two neighbours at once: the chord must stay within rounding of the edges that it replaces
        even = np.arange(len(kept)) % 2 == 0
        even[-1] &= len(kept) % 2 == 0
        straight &= even | ~(np.roll(straight, 1) | np.roll(straight, -1))
        if not straight.any() or len(kept) <= 3:
            break
        kept = kept[~straight]
    turn = np.arctan2(cross, (before * after).sum(axis=1))
    if round(turn.sum() / (2 * np.pi)) != 1:
        raise ValueError(
            f"the polygon must not cross itself: it turns {turn.sum() / (2 * np.pi):.0f} times instead of once"
        )
    if (turn < 0).any():
        _check_crossing(kept, "polygon")
    return np.ascontiguousarray(kept)
