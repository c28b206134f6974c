"""Outlines of what closed lines in a plane enclose, as they are met from outside."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import AT_ONCE, ROUNDING, Array, Index, Mask, ranges


def outer_outlines(lines: list[Array], size: float) -> list[Array]:
    """Simple polygons (m, 2), counter-clockwise and outside of each other, around all that closed lines enclose.

    lines
        (m, 2) each, in either direction: the sections of shells of a body.  They may cross and touch themselves and each other;
        then they are cut there, and the outline is that of the union.
    size
        of the body, to which rounding is relative.

    Holes, and what lies in them, are left out.
    """
    lines = [line[np.hypot(*(line - np.roll(line, 1, axis=0)).T) > ROUNDING * size] for line in lines]
    lines = [line for line in lines if len(line) > 2 and abs(_area(line)) > ROUNDING * size**2]
    if not lines:
        return []
    start = np.concatenate(lines)
    ends = np.cumsum([len(line) for line in lines])
    following = np.arange(1, len(start) + 1)
    following[ends - 1] = ends - [len(line) for line in lines]
    pieces = _cut(start, start[following], following, ROUNDING * size)
    if pieces is not None:
        lines = [line for line in _traced(*pieces, 2 * ROUNDING * size) if abs(_area(line)) > ROUNDING * size**2]
    lines = [line if _area(line) > 0 else line[::-1] for line in lines]
    middles = np.array([(line[0] + line[1]) / 2 for line in lines]).reshape(-1, 2)
    within = np.array([_inside(middles, line) for line in lines]).reshape(len(lines), len(lines))
    np.fill_diagonal(within, False)
    return [lines[k] for k in np.flatnonzero(~within.any(axis=0))]


def _cut(start: Array, stop: Array, following: Index, close: float) -> tuple[Array, Array] | None:
    """The segments (n, 2) cut where they meet others, than the following one at its end; None if none does."""
    a, b = _near_pairs(start, stop, close)
    apart = (following[a] != b) & (following[b] != a)
    a, b = a[apart], b[apart]
    d, e, between = stop[a] - start[a], stop[b] - start[b], start[b] - start[a]
    turn = _cross(d, e)
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = _cross(between, e) / turn, _cross(between, d) / turn
    proper = (s > 0) & (s < 1) & (t > 0) & (t < 1)
    owners, shares, meets = [a[proper], b[proper]], [s[proper], t[proper]], bool(proper.any())
    for point, owner in ((start[b], a), (stop[b], a), (start[a], b), (stop[a], b)):
        along, offset = stop[owner] - start[owner], point - start[owner]
        share = np.clip((offset * along).sum(axis=1) / (along**2).sum(axis=1), 0, 1)
        near = np.hypot(*(offset - share[:, None] * along).T) <= close
        meets |= bool(near.any())
        owners.append(owner[near])
        shares.append(share[near])
    if not meets:
        return None
    owner = np.concatenate([np.arange(len(start)), *owners])
    share = np.concatenate([np.zeros(len(start)), *shares])
    order = np.lexsort((share, owner))
    owner, share = owner[order], share[order]
    begin = start[owner] + share[:, None] * (stop - start)[owner]
    last = np.append(owner[1:] != owner[:-1], True)
    return begin, np.where(last[:, None], stop[owner], np.roll(begin, -1, axis=0))


def _near_pairs(start: Array, stop: Array, close: float) -> tuple[Index, Index]:
    """Pairs of segments (n, 2) whose boxes meet, each once."""
    low, high = np.minimum(start, stop) - close, np.maximum(start, stop) + close
    order = np.argsort(low[:, 0])
    last = np.searchsorted(low[order, 0], high[order, 0], side="right")
    pairs: list[tuple[Index, Index]] = []
    rows = max(1, AT_ONCE // len(start))
    for first in range(0, len(start), rows):
        of = np.arange(first, min(first + rows, len(start)))
        row, rank = ranges(np.maximum(last[of] - of - 1, 0))
        a, b = order[of[row]], order[of[row] + 1 + rank]
        meet = (low[a, 1] <= high[b, 1]) & (low[b, 1] <= high[a, 1])
        pairs.append((a[meet], b[meet]))
    a, b = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return a, b


def _traced(start: Array, stop: Array, close: float) -> list[Array]:
    """The outlines of connected segments (n, 2): walked with the outside on the right, turning right at every crossing."""
    ends = np.concatenate([start, stop])
    vertex = np.arange(len(ends))
    for i, j in cKDTree(ends).query_pairs(close, output_type="ndarray"):
        vertex[vertex == vertex[max(i, j)]] = vertex[min(i, j)]
    a, b = vertex[: len(start)], vertex[len(start) :]
    edges = np.unique(np.sort(np.stack([a, b], axis=1), axis=1), axis=0)
    edges = edges[edges[:, 0] != edges[:, 1]]
    neighbours: dict[int, list[int]] = {}
    for p, q in edges.tolist():
        neighbours.setdefault(p, []).append(q)
        neighbours.setdefault(q, []).append(p)
    left, lines = set(neighbours), []
    while left:
        first = min(left, key=lambda p: (ends[p, 1], ends[p, 0]))
        walk, before, here = [first], -np.pi / 2, first
        while True:
            directions = [ends[q] - ends[here] for q in neighbours[here]]
            turns = [(np.arctan2(d[1], d[0]) - before) % (2 * np.pi) or 2 * np.pi for d in directions]
            there = neighbours[here][int(np.argmin(turns))]
            if len(walk) > 1 and here == walk[0] and there == walk[1]:
                break
            walk.append(there)
            d = ends[here] - ends[there]
            before, here = float(np.arctan2(d[1], d[0])), there
        lines += [ends[np.array(line)] for line in _simple(walk[:-1])]
        reached, found = {first}, [first]
        while found:
            found = [q for p in found for q in neighbours[p] if q not in reached and not reached.add(q)]  # type: ignore[func-returns-value]
        left -= reached
    return lines


def _simple(walk: list[int]) -> list[list[int]]:
    """A closed walk over vertices, parted where it comes to a vertex again."""
    parts: list[list[int]] = []
    open_: list[int] = []
    place: dict[int, int] = {}
    for vertex in walk:
        if vertex in place:
            begin = place[vertex]
            parts.append(open_[begin:])
            for gone in open_[begin:]:
                del place[gone]
            open_ = open_[:begin]
        place[vertex] = len(open_)
        open_.append(vertex)
    return [part for part in [*parts, open_] if len(part) > 2]


def _inside(points: Array, polygon: Array) -> Mask:
    """Whether points (n, 2) lie inside a simple polygon (m, 2)."""
    following = np.roll(polygon, -1, axis=0)
    (x, y), (x0, y0), (x1, y1) = points.T[:, :, None], polygon.T, following.T
    crosses = (y0 > y) != (y1 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        right = x < x0 + (y - y0) * (x1 - x0) / (y1 - y0)
    return np.asarray((crosses & right).sum(axis=1) % 2 == 1)


def _area(polygon: Array) -> float:
    about = polygon - polygon[0]
    return float(_cross(about, np.roll(about, -1, axis=0)).sum()) / 2


def _cross(p: Array, q: Array) -> Array:
    return np.asarray(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
