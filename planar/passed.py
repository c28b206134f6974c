"""What the rods of a sweep have passed is free: not of the body, whatever its shape, its friction and the number of contacts.

Rods move continuously from one sample to the next and never enter the body.  A point about which the loop of the one rod, the
path of the tip, the other rod and the path of the base winds is met by a rod in between (C14), for else the loop, which is the
border of a square's image, could be drawn together without passing it.  Of the path of the tip only its ends are recorded:
the area next to its chord, as far as the path may bulge, is not counted.  Across a snap nothing is known of it: such steps
count for nothing, and neither do rods with a second contact, of which only the part up to the first is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
import scipy
from numpy.typing import ArrayLike

from planar.arrays import Array, Index, Mask
from planar.lines import elastic_lines

# Points of each rod.
_POINTS = 60
# Travel of the tip, in steps of the base, beyond which the rod has snapped.
_SNAPPED = 5.0
# Groups of parts of areas by their size.
_SIZES = 16
# Pairs of points and edges at once, which limits the memory.
_PAIRS = 2_000_000


@dataclass(frozen=True)
class FreeSpace:
    """Areas (a) between neighbouring rods, as closed polygons."""

    loops: Array
    """(a, v, 2) corners: one rod from its clamp to its end, and the next one back."""
    margin: Array
    """(a,) distance from the border up to which nothing is claimed, in rod lengths."""

    def depth(self, points: ArrayLike) -> Array:
        """How deep points (n, 2) lie in the free areas less their margins, in rod lengths: 0 where they do not."""
        points = np.asarray(points, dtype=float)
        deepest = np.zeros(len(points))
        if not len(self.loops):
            return deepest
        row, area = self._near(points)
        chunk = max(1, _PAIRS // self.loops.shape[1])
        for k in range(0, len(row), chunk):
            r, a = row[k : k + chunk], area[k : k + chunk]
            np.maximum.at(deepest, r, _depths(points[r], self.loops[a]) - self.margin[a])
        return deepest

    def _near(self, points: Array) -> tuple[Index, Index]:
        """Pairs of a point and an area of which a part, between neighbouring points of the two rods, contains it.

        An area winds about a point as often as all of its parts together.
        """
        count = self.loops.shape[1] // 2
        first, second = self.loops[:, :count], self.loops[:, : count - 1 : -1]
        corners = np.stack([first[:, :-1], first[:, 1:], second[:, 1:], second[:, :-1]]).reshape(4, -1, 2)
        low, high = corners.min(axis=0), corners.max(axis=0)
        middle, half = (low + high) / 2, (high - low) / 2
        pairs: list[Index] = []
        tree = scipy.spatial.cKDTree(points)
        # parts of a size together, so that few pairs are looked at
        for part in np.array_split(np.argsort(half.max(axis=1)), _SIZES):
            reach = float(half[part].max(initial=0.0))
            total = np.cumsum(tree.query_ball_point(middle[part], reach, p=np.inf, return_length=True))
            for some in np.split(part, np.searchsorted(total, np.arange(_PAIRS, total[-1:].sum(), _PAIRS))):
                if not len(some):
                    continue
                around = tree.query_ball_point(middle[some], reach, p=np.inf)
                owner = np.repeat(some, [len(rows) for rows in around])
                row = np.fromiter(chain.from_iterable(around), np.intp, len(owner))
                inside = (np.abs(points[row] - middle[owner]) <= half[owner]).all(axis=1)
                row, owner = row[inside], owner[inside]
                quads = corners[:, owner] - points[row]
                inside = _winds(quads)
                row, owner, quads = row[inside], owner[inside] // (count - 1), quads[:, inside]
                # next to either of the rods nothing is claimed
                inside = _from_edges(quads[[0, 3]], quads[[1, 2]]) > self.margin[owner]
                pairs.append(row[inside] * len(self.loops) + owner[inside])
        both: Index = np.unique(np.concatenate(pairs))
        return both // len(self.loops), both % len(self.loops)


def _winds(corners: Array) -> Mask:
    """Whether closed polygons (k, n, 2) wind about the origin."""
    (x, y), (u, v) = corners.transpose(2, 0, 1), np.roll(corners, -1, axis=0).transpose(2, 0, 1)
    left = x * v - y * u
    up, down = (y <= 0) & (v > 0) & (left > 0), (y > 0) & (v <= 0) & (left < 0)
    return np.asarray(up.sum(axis=0) != down.sum(axis=0))


def _depths(points: Array, loops: Array) -> Array:
    """Distance (n,) of points from the border of their loop (n, v, 2) where it winds about them, -1 elsewhere."""
    offset = loops - points[:, None]
    following = np.roll(offset, -1, axis=1)
    cross = offset[..., 0] * following[..., 1] - offset[..., 1] * following[..., 0]
    turned = np.arctan2(cross, (offset * following).sum(axis=2)).sum(axis=1)
    border = _from_edges(offset.swapaxes(0, 1), following.swapaxes(0, 1))
    return np.where(np.abs(turned) > np.pi, border, -1.0)


def _from_edges(start: Array, end: Array) -> Array:
    """Distance (n,) of the origin from the nearest of the edges (k, n, 2)."""
    edge = end - start
    share = np.clip(-(start * edge).sum(axis=2) / np.maximum((edge**2).sum(axis=2), 1e-300), 0, 1)
    x, y = (start + share[..., None] * edge).transpose(2, 0, 1)
    return np.asarray(np.sqrt((x**2 + y**2).min(axis=0)))


def free_space(
    x0: ArrayLike, f0x: ArrayLike, f0y: ArrayLike, m0z: ArrayLike, *, single: Mask, bulge: ArrayLike | None = None
) -> FreeSpace:
    """The area that the rods (n,) of one sweep have passed; reactions as for `planar.elastic_lines`, in the order of the sweep.

    single
        (n,) whether a rod is known to touch at one place only, or nowhere (NaN reactions count as none).
    bulge
        by how much, in rod lengths, the path of the tip may leave its chord in each step (n - 1,).  None: half of the second
        differences of the tip's places, by which a path that turns once in a step leaves it; smooth travel by an eighth.
    """
    base, fx, fy, moment = (np.nan_to_num(np.asarray(column, dtype=float)) for column in (x0, f0x, f0y, m0z))
    lines = elastic_lines(base, fx, fy, moment, _POINTS)
    rods = np.concatenate([lines.curved, lines.straight[:, 1:]], axis=1)
    tip = rods[:, -1]
    travel = np.diff(tip, axis=0)
    if bulge is None:
        second = np.zeros(len(tip))
        second[1:-1] = np.hypot(*np.diff(tip, 2, axis=0).T)
        sagitta = np.maximum(second[1:], second[:-1]) / 2
    else:
        sagitta = np.asarray(bulge, dtype=float)
    # the rods are drawn by chords, whose sagitta is κ h²/8; the largest curvature is that at the clamp
    drawn = np.maximum(np.abs(moment[1:]), np.abs(moment[:-1])) / (8 * (_POINTS - 1) ** 2)
    known = np.asarray(single)[1:] & np.asarray(single)[:-1]
    known &= np.isfinite(rods[1:]).all(axis=(1, 2)) & np.isfinite(rods[:-1]).all(axis=(1, 2))
    # beside a rod that is not known the sagitta is not either
    known &= (np.hypot(*travel.T) <= _SNAPPED * np.abs(np.diff(base))) & np.isfinite(sagitta)
    loops = np.concatenate([rods[:-1], rods[1:, ::-1]], axis=1)
    return FreeSpace(loops[known], (sagitta + drawn)[known])


def joined(spaces: list[FreeSpace]) -> FreeSpace:
    """The free space of several sweeps in one plane, each in the frame of the same plane."""
    return FreeSpace(
        np.concatenate([space.loops for space in spaces]), np.concatenate([space.margin for space in spaces])
    )
