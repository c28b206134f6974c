"""Outlines of any bodies in a plane: simple closed loops of lines, smooth curves and vertices, convex or not.

Counter-clockwise, body on the left of the tangent ``t = (cos τ, sin τ)``, outward normal ``n = (sin τ, -cos τ)``.  A loop is a
cycle of pieces with one parameter ``u`` in [0, 1] each: a *curve* (a line, or a smooth stretch of cubic polynomials or an
ellipse), whose point moves, or a *vertex*, whose point is fixed while ``τ`` turns: to the left at a convex one, to the right at
a concave one.  A smooth loop is a single curve that closes.  `Outlines` has the loops of many bodies, each in its own plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from planar.arrays import ROUNDING, Array, Index, Mask, ratio

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
    following = np.roll(edges, -1, axis=0)
    turn = np.zeros(2 * n)
    cross = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    turn[1::2] = np.arctan2(cross, (edges * following).sum(axis=1))
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
        self._piece = np.repeat(curves, number)
        step = np.arange(len(self._piece)) - np.repeat(np.cumsum(number) - number, number)
        self._u = (step + 0.5) / np.repeat(number, number)
        points = self.at(self._piece, self._u).point
        self.samples = points
        self._tree = scipy.spatial.cKDTree(np.column_stack([points, _APART * self.body[self._piece]]))
        begins = np.flatnonzero(np.diff(self.body[self._piece], prepend=-1))
        both = np.stack(
            [self.at(self._piece, np.floor(self._u)).point, points]
        )  # vertices are among the extreme points
        self.low, self.high = (
            np.minimum.reduceat(both.min(axis=0), begins),
            np.maximum.reduceat(both.max(axis=0), begins),
        )

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
        piece, u = self._piece[sample], self._u[sample]
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
        number = np.maximum(last[rows] - rows - 1, 0)
        a = np.repeat(rows, number)
        b = a + 1 + np.arange(len(a)) - np.repeat(np.cumsum(number) - number, number)
        a, b = order[a], order[b]
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
