"""Whether rods that touch a polygon at one place are clear of it everywhere else.

Such a rod turns to the right all along, from the clamp's ``φ = π/2`` to its end, so that it is the graph of a concave function
over its clamp's and its tip's x.  The polygon is crossed where an edge has one end on the rod's left and one on its right, or
where an edge with both ends on the left is cut by the rod's bow.  Left and right of most vertices are told by the chords
between points of the rod, those next to it by its polynomials.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planar.arrays import Array, Index, Mask, ratio
from planar.pieces import piece

# Points of a rod up to its contact; its polynomials of fifth order between them are exact to some 1e-11.
POINTS = 33
# Depth in the body, in rod lengths, that is more than the rounding of mesh files in single precision.
INSIDE = 1e-7
_SHARES = np.linspace(0, 1, POINTS)


class Lines(NamedTuple):
    """Points of rods (n, k), from the clamp to the contact, and the tip."""

    s: Array
    x: Array
    y: Array
    phi: Array
    kappa: Array

    def rows(self, rows: Index | slice) -> Lines:
        return Lines(*(column[rows] for column in self))


def lines(x0: Array, kappa: Array, force_x: Array, force_y: Array, s1: Array) -> Lines:
    """Rods (n,) by their curvature at the clamp, internal force and contact; without force they are straight."""
    at = s1[:, None] * _SHARES
    end = piece(force_x[:, None], force_y[:, None], np.full_like(at, np.pi / 2), kappa[:, None], at)
    # past the contact without a moment, not even a rounding one
    end.kappa[:, -1] = 0.0
    rest = 1 - s1
    tip = [
        np.ones_like(s1),
        end.x[:, -1] + rest * np.cos(end.phi[:, -1]),
        end.y[:, -1] + rest * np.sin(end.phi[:, -1]),
        end.phi[:, -1],
        np.zeros_like(s1),
    ]
    columns = [np.column_stack([a, b]) for a, b in zip((at, end.x, end.y, end.phi, end.kappa), tip, strict=True)]
    columns[1] += x0[:, None]
    return Lines(*columns)


def _on_rod(rods: Lines, row: Index, k: Index, w: Array) -> tuple[Array, Array, Array]:
    """Places x, y (m,) and slope of rods at shares w of their intervals k, by polynomials of fifth order."""
    h = rods.s[row, k + 1] - rods.s[row, k]
    left, right = (Lines(*(column[row, j] for column in rods)) for j in (k, k + 1))
    values = []
    cos, sin = (trig(np.stack([left.phi, right.phi])) for trig in (np.cos, np.sin))
    bend = h * h * np.stack([left.kappa, right.kappa])
    for a, b, first, second in ((left.x, right.x, cos, -sin), (left.y, right.y, sin, cos)):
        (c1, d1), (c2, d2) = h * first, bend * second / 2
        rest = b - a - c1 - c2
        first, second = d1 - c1 - 2 * c2, d2 - c2
        c3, c4, c5 = 10 * rest - 4 * first + second, -15 * rest + 7 * first - 2 * second, 6 * rest - 3 * first + second
        values.append(a + w * (c1 + w * (c2 + w * (c3 + w * (c4 + w * c5)))))
    phi = left.phi + w * (right.phi - left.phi)
    return values[0], values[1], phi


def _offsets(rods: Lines, row: Index, x: Array, y: Array) -> Array:
    """Distance (m,) of points to the left of their rods, above which or below which they lie; of distant ones an estimate."""
    n, count = rods.x.shape
    wide = 4.0
    grid = (rods.x - rods.x[:, :1]) + wide * np.arange(n)[:, None]
    k = np.searchsorted(grid.ravel(), x - rods.x[row, 0] + wide * row, side="right") - 1 - count * row
    k = np.clip(k, 0, count - 2)
    ax, ay, bx, by = rods.x[row, k], rods.y[row, k], rods.x[row, k + 1], rods.y[row, k + 1]
    length = np.hypot(bx - ax, by - ay)
    offset: Array = ratio((bx - ax) * (y - ay) - (by - ay) * (x - ax), length)
    bow = np.maximum(np.abs(rods.kappa[row, k]), np.abs(rods.kappa[row, k + 1])) * length**2 / 8
    near = np.flatnonzero(~((offset > 1.1 * bow + 1e-7) | (offset < -1e-7)))
    r, k, target, height = row[near], k[near], x[near], y[near]
    w = np.clip((target - ax[near]) / np.maximum(bx[near] - ax[near], 1e-300), 0, 1)
    h = rods.s[r, k + 1] - rods.s[r, k]
    for _ in range(3):
        px, py, phi = _on_rod(rods, r, k, w)
        # to the foot point: the offset is taken along the rod's normal
        along = (target - px) * np.cos(phi) + (height - py) * np.sin(phi)
        w = np.clip(w + along / np.maximum(h, 1e-300), 0, 1)
    px, py, phi = _on_rod(rods, r, k, w)
    offset[near] = (height - py) * np.cos(phi) - (target - px) * np.sin(phi)
    return offset


def crosses(vertices: Array, following: Index, rods: Lines) -> Mask:
    """Whether rods (n,) are inside of a polygon, whose `vertices` (v, 2) are each followed by another: (n,)."""
    n, start, end = len(rods.x), rods.x[:, :1], rods.x[:, -1:]
    vx, vy = vertices.T
    within = (vx > start) & (vx < end)
    row, vertex = np.nonzero(within)
    side = np.zeros(within.shape, dtype=np.int8)
    side[row, vertex] = np.where(_offsets(rods, row, vx[vertex], vy[vertex]) < -INSIDE, -1, 1)
    after = side[:, following]
    bad: Mask = np.asarray(((side * after) < 0).any(axis=1))

    # edges that pass the line of the tip, or of the clamp, above which the body is
    ex, ey = vx[following], vy[following]
    ends = []
    for line, tip in ((end, True), (start, False)):
        row, edge = np.nonzero(((vx < line) & (ex >= line)) | ((ex < line) & (vx >= line)))
        at = line[row, 0]
        height = vy[edge] + (ey[edge] - vy[edge]) * (at - vx[edge]) / (ex[edge] - vx[edge])
        limit, cosine = (rods.y[row, -1], np.cos(rods.phi[row, -1])) if tip else (0.0, 1.0)
        above = np.where((height - limit) * cosine < -INSIDE, -1, 1)
        inner = np.where(within[row, edge], edge, following[edge])
        known = within[row, inner]
        bad[row[known & (side[row, inner] * above < 0)]] = True
        ends.append((row, edge, above, known))
    # an edge over the whole rod
    over = {(r, e): a for r, e, a, k in zip(*ends[1], strict=True) if not k}
    for r, e, a, k in zip(*ends[0], strict=True):
        if not k and over.get((r, e), a) != a:
            bad[r] = True

    # edges with nothing on the right, below which the rod may bow out
    left = (side > 0) | (after > 0)
    left &= (side >= 0) & (after >= 0)
    row, edge = np.nonzero(left)
    dx, dy = ex[edge] - vx[edge], ey[edge] - vy[edge]
    slope = np.arctan2(np.where(dx < 0, -dy, dy), np.abs(dx))
    # the place at which the rod is parallel: its slope falls
    parallel = (slope < np.pi / 2) & (slope > rods.phi[row, -1])
    row, edge, slope = row[parallel], edge[parallel], slope[parallel]
    count = rods.phi.shape[1]
    falls = -(rods.phi - np.pi / 2) + 8.0 * np.arange(n)[:, None]
    k = np.searchsorted(falls.ravel(), np.pi / 2 - slope + 8.0 * row, side="right") - 1 - count * row
    k = np.clip(k, 0, count - 2)
    fall = rods.phi[row, k] - rods.phi[row, k + 1]
    w = np.clip((rods.phi[row, k] - slope) / np.maximum(fall, 1e-300), 0, 1)
    x, y, _ = _on_rod(rods, row, k, w)
    inside = (x > np.minimum(vx[edge], ex[edge])) & (x < np.maximum(vx[edge], ex[edge]))
    c, s = np.cos(slope), np.sin(slope)
    depth = c * (y - vy[edge]) - s * (x - vx[edge])
    bad[row[inside & (depth > INSIDE)]] = True
    return bad


def straight_crosses(vertices: Array, following: Index, x0: Array) -> Mask:
    """The same of straight rods at base positions (n,)."""
    a, b = vertices, vertices[following]
    low, high = np.minimum(a[:, 0], b[:, 0]), np.maximum(a[:, 0], b[:, 0])
    row, edge = np.nonzero((x0[:, None] > low + INSIDE) & (x0[:, None] < high - INSIDE))
    share = (x0[row] - a[edge, 0]) / (b[edge, 0] - a[edge, 0])
    height = a[edge, 1] + share * (b[edge, 1] - a[edge, 1])
    bad = np.zeros(len(x0), dtype=bool)
    bad[row[height < 1 - INSIDE]] = True
    return bad
