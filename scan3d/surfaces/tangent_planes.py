"""The choice of the supporting planes whose apexes bound a body (S28).

Every choice gives a valid bound.  A coarse one is refined where the apexes lie farthest outside: the plane is added that cuts
off most of the apex, whichever normals of their arcs the planes have, and a plane with a wide arc is removed where no other
plane cuts the apex off.  The best choice met is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import Array, Index, Mask
from scan3d.geometry.apexes import Cover, SupportingPlanes, cover, cut_depths, thinned

# Spacing of the normals of the first choice, in radians, and in half-widths of their arcs.  Larger, the first choice leaves a
# body open; smaller, it holds planes with wide arcs that must be removed again.
_FIRST_SPACING, _FIRST_WIDTHS = 0.2, 3.0
# Half-width, in radians, of the widest arc that is used.  Larger, its triangles turn over; smaller, sparse contacts leave the
# body open.
_WIDEST = 0.4
# Rounds of the refinement.  More take longer; fewer stop at a larger bound.
_ROUNDS = 80
# Apexes that are cut off in one round, those farther out than this fraction of the farthest one.  More add planes that later
# ones make needless; fewer take more rounds.
_AT_ONCE, _FRACTION = 60, 0.5
# Apexes at least this fraction of the farthest one, which no plane cuts off, lose their plane with the widest arc.
_STUCK = 0.9
# Gap relative to the body's size at which the refinement ends.  Smaller takes longer and changes no digit of the bound.
_CLOSE = 2e-5
# Depth relative to the body's size of a cut that counts.
_SHALLOWEST = 1e-7


class Apexes(NamedTuple):
    """The apexes over the triangles (m,) of a cover."""

    cover: Cover
    gap: Array
    """(m,) largest distance of an apex from the inner body over all normals of the arcs; infinite where nothing bounds it."""

    @property
    def open(self) -> Mask:
        """(m,) whether nothing bounds the body in the triangle's directions."""
        unbounded: Mask = np.isinf(self.gap)
        return unbounded


def best_apexes(planes: SupportingPlanes, distance: Callable[[Array], Array]) -> Apexes | None:
    """The apexes of the best choice among planes (n,), found by refinement; None if no choice has any.

    distance
        of points (p, 3) from the inner body, convex and never negative, in the frame of the planes.
    """
    chosen = thinned(planes, _FIRST_WIDTHS, _FIRST_SPACING)
    usable = planes.half_width < _WIDEST
    known: dict[int, float] = {}
    stuck: set[int] = set()
    best: Apexes | None = None
    for _ in range(_ROUNDS):
        covering = cover(planes, chosen)
        if covering is None:
            return best
        usable[covering.removed] = False
        chosen = np.setdiff1d(chosen, covering.removed)
        codes = _codes(covering.planes, len(planes.points))
        apexes = Apexes(covering, _gaps(covering, codes, distance, known))
        if best is None or _score(apexes) <= _score(best):
            best = apexes
        added, needless = _improvements(planes, apexes, codes, chosen, usable, stuck)
        usable[needless] = False
        if not len(added) and not len(needless):
            return best
        chosen = np.union1d(np.setdiff1d(chosen, needless), added)
    return best


def _score(apexes: Apexes) -> tuple[bool, float]:
    """Smaller for better apexes: those that close the body, and of these those with the smaller gap."""
    is_open = bool(apexes.open.any())
    return is_open, 0.0 if is_open else float(apexes.gap.max())


def _codes(triangles: Index, count: int) -> list[int]:
    """Numbers of triangles (m, 3) of planes, of which there are `count` beside those far away."""
    ordered = np.sort(triangles, axis=1) + 100
    base = count + 100
    codes: list[int] = ((ordered[:, 0] * base + ordered[:, 1]) * base + ordered[:, 2]).tolist()
    return codes


def _gaps(covering: Cover, codes: list[int], distance: Callable[[Array], Array], known: dict[int, float]) -> Array:
    """The gaps (m,) of a cover's triangles; those in `known` are not computed again."""
    new = np.array([i for i, code in enumerate(codes) if code not in known], dtype=np.intp)
    gap = np.full(len(new), np.inf)
    closed = np.isfinite(covering.apexes[new, 0, 0])
    if closed.any():
        gap[closed] = distance(covering.apexes[new][closed].reshape(-1, 3)).reshape(-1, 8).max(axis=1)
    known.update(zip((codes[i] for i in new.tolist()), gap.tolist(), strict=True))
    return np.array([known[code] for code in codes])


def _improvements(
    planes: SupportingPlanes, apexes: Apexes, codes: list[int], chosen: Index, usable: Mask, stuck: set[int]
) -> tuple[Index, Index]:
    """Numbers of the planes to be added, and of those to be removed; triangles that no plane cuts off are added to `stuck`."""
    gap, nominal = apexes.gap, apexes.cover.nominal
    added = removed = np.empty(0, dtype=np.intp)
    candidates = np.flatnonzero(usable)
    # a plane nearer to a chosen one than its arc is wide would turn over their triangles
    if len(chosen) and len(candidates):
        apart = cKDTree(planes.middle[chosen]).query(planes.middle[candidates])[0]
        candidates = candidates[apart > planes.half_width[candidates]]
    free = np.flatnonzero((gap >= _CLOSE) & [code not in stuck for code in codes])
    while len(free) and not len(added):
        # from the farthest apexes on, until some can be cut off
        rows = free[np.argsort(-gap[free], kind="stable")][:_AT_ONCE]
        rows = rows[gap[rows] >= _FRACTION * gap[rows[0]]]
        free = np.setdiff1d(free, rows)
        cut = np.zeros(len(rows), dtype=bool)
        if len(candidates):
            depth = cut_depths(planes, candidates, nominal[rows])
            deepest = depth.argmax(axis=1)
            cut = depth[np.arange(len(rows)), deepest] > _SHALLOWEST
            added = np.unique(candidates[deepest[cut]])
        stuck.update(codes[row] for row in rows[~cut].tolist())
    if not apexes.open.any() and gap.max() >= _CLOSE:
        held = [code in stuck for code in codes] & (gap >= _STUCK * gap.max())
        triangles = apexes.cover.planes[held]
        removed = np.unique(triangles[np.arange(len(triangles)), planes.half_width[triangles].argmax(axis=1)])
    return added, removed
