"""The paths of a rod that touches outlines of straight edges at a single place, and where on them it does.

Below a body the contact goes against the tangent of its outline, as `planar.paths` describes it for a convex one.  On any other
the slopes rise again at concave vertices, in which the tip is wedged; where the outline faces away from the rod, or is higher
than the rod is long, the path is interrupted, so that it consists of runs.  Whether a rod at such a place touches nowhere else
is a question that `planar.clearance` answers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planar.arrays import Array, Index
from planar.loops import Outlines
from planar.paths import Path, subdivided


class Runs(NamedTuple):
    """Paths in runs, those of each body in the order in which a sweep comes to them."""

    path: Path
    """All runs, its `offsets` by run."""
    body: Index
    """(runs,)"""
    run: Index
    """(p,) of each piece of the path."""
    piece: Index
    """(p,) of the outline."""
    u: Array
    """(p,) place on the outline's piece where the path's begins."""
    u_move: Array
    """(p,) its change over the path's piece, negative."""
    hollow: Index
    """(p,) concave vertices at the piece's ends, 2 on a concave vertex itself: with two no rod lies along it."""


def runs(outlines: Outlines) -> Runs:
    """The runs of all bodies that have straight edges only."""
    vertex = outlines.is_vertex
    straight = ~np.bincount(outlines.body, outlines.is_curved).astype(bool)[outlines.body]
    everything = np.arange(len(vertex))
    zero = np.zeros(len(vertex))
    edge = outlines.cubics[outlines.first[outlines.anchor]]
    # against the outline's direction: from the end of the outline's piece to its beginning
    point = edge[:, 0] + edge[:, 1]
    move = np.where(vertex[:, None], 0.0, -edge[:, 1])
    angle = np.arctan2(edge[:, 1, 1], edge[:, 1, 0])
    turn = np.where(vertex, -outlines.turn, 0.0)
    slope = angle - turn
    slope -= 2 * np.pi * np.round((slope + turn / 2) / (2 * np.pi))
    # what faces down, and is low enough
    low, high = zero.copy(), zero + 1
    with np.errstate(divide="ignore", invalid="ignore"):
        for bound, values, change in ((np.pi / 2, slope, turn), (1.0, point[:, 1], move[:, 1])):
            cut = (bound - values) / change
            low = np.where((values > bound) & (change < 0), np.maximum(low, cut), low)
            high = np.where((values + change > bound) & (change > 0), np.minimum(high, cut), high)
            out = (values > bound) & ~(change < 0)
            high = np.where(out, -1.0, high)
        cut = (-np.pi / 2 - slope) / turn
        low = np.where((slope < -np.pi / 2) & (turn > 0), np.maximum(low, cut), low)
        high = np.where((slope + turn < -np.pi / 2) & (turn < 0), np.minimum(high, cut), high)
        high = np.where((slope < -np.pi / 2) & ~(turn > 0), -1.0, high)
    faces = np.where(vertex, np.abs(slope + turn / 2) < np.pi, edge[:, 1, 0] > 0)
    kept = straight & faces & (low < high)
    joins = kept & (high == 1) & kept[outlines.previous] & (low[outlines.previous] == 0)
    begins = kept & ~joins[outlines.following]
    # each loop from the rightmost beginning on, the rightmost loop first
    loop = np.cumsum(outlines.previous >= everything) - 1  # the first piece of a loop follows on its last one
    at = point + low[:, None] * move
    first = np.lexsort((-at[:, 0], ~begins, loop))
    first = first[np.flatnonzero(np.diff(loop[first], prepend=-1))]
    size = np.bincount(loop, minlength=len(first))
    rank = np.remainder(first[loop] - everything, size[loop])
    rows = np.lexsort((rank, loop, -at[first, 0][loop], outlines.body))
    rows = rows[kept[rows]]
    run = np.cumsum(begins[rows]) - 1
    low, high = low[rows], high[rows]
    points = at[rows]
    cut = (low > 0) & (points[:, 1] > 1 - 1e-9)
    points[cut, 1] = 1.0  # where the tip of the upright rod touches first
    parts, of = subdivided(
        slope[rows] + low * turn[rows],
        (high - low) * turn[rows],
        points,
        (high - low)[:, None] * move[rows],
    )
    begin = np.flatnonzero(np.diff(of, prepend=-1))
    step = (np.arange(len(of)) - begin[of]) / np.bincount(of, minlength=len(rows))[of]
    share = (high - low) / np.bincount(of, minlength=len(rows))
    concave = vertex & (outlines.turn < 0)
    hollow = np.where(concave, 2, concave[outlines.previous].astype(int) + concave[outlines.following])
    offsets = np.append(np.flatnonzero(np.diff(run[of], prepend=-1)), len(of))
    return Runs(
        Path(*parts, offsets),
        outlines.body[rows][begins[rows]],
        run[of],
        rows[of],
        1 - low[of] - step * (high - low)[of],
        -share[of],
        hollow[rows[of]],
    )
