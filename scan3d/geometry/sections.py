"""Plane sections of closed meshes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, QhullError, cKDTree

from scan3d.arrays import AT_ONCE, ROUNDING, Array, Index, Mask, ranges, ratio

if TYPE_CHECKING:
    import trimesh


def slice_frame(axis: Array) -> Array:
    """The x, y and z axes of the slices' frame as rows (3, 3), z along `axis` (3,); the identity matrix for the z axis."""
    z = axis / np.linalg.norm(axis)
    helper = np.eye(3)[[2, 0, 1][int(np.argmax(np.abs(z)))]]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def extent_along(mesh: trimesh.Trimesh, axis: ArrayLike) -> tuple[float, float]:
    """Lowest and highest coordinate of the mesh along an axis (3,) of any length, in the units of the mesh."""
    axis = np.asarray(axis, np.float64)
    heights = mesh.vertices.view(np.ndarray) @ (axis / np.linalg.norm(axis))
    return float(heights.min()), float(heights.max())


def slice_polygons(mesh: trimesh.Trimesh, rotation: ArrayLike, heights: ArrayLike) -> list[Array]:
    """Exact plane sections of a convex mesh, in the units of the mesh.

    rotation (3, 3)
        its rows are the x, y and z axes of the slices' frame in the world; the origin of the frame is that of the world.
    heights (n,)
        heights of the slices along the frame's z axis, in any order.

    Returns n convex polygons (m, 2), counter-clockwise in the frame's x and y, without duplicate or collinear vertices; (0, 2)
    where the plane misses the body or only touches it in a point or an edge.  The section by a plane that contains a face of
    the body, within rounding, is that face.  Vertices are exact to rounding of the body's size and distance from the origin.
    """
    rotation, heights = np.asarray(rotation, np.float64), np.asarray(heights, np.float64)
    center = mesh.bounds.mean(axis=0)
    origin = rotation @ center
    points = (mesh.vertices.view(np.ndarray) - center) @ rotation.T  # about the centre, where float64 is finest
    # that of the mesh's own coordinates included, so that it does not decide whether a plane contains a face
    rounding = ROUNDING * float(np.linalg.norm(mesh.extents) + np.linalg.norm(center))
    order = np.argsort(heights)
    levels = heights[order] - origin[2]

    # A vertex within rounding of the plane lies on it; an edge crosses it if its ends lie strictly on opposite sides.
    z = points[:, 2]
    on, on_level = _pairs(np.searchsorted(levels, z - rounding), np.searchsorted(levels, z + rounding, side="right"))
    edges = mesh.edges_unique
    low, high = np.where(z[edges[:, 0]] <= z[edges[:, 1]], edges.T, edges.T[::-1])
    crossed, crossed_level = _pairs(
        np.searchsorted(levels, z[low] + rounding, side="right"), np.searchsorted(levels, z[high] - rounding)
    )
    a, b = points[low[crossed]], points[high[crossed]]
    below, above = levels[crossed_level] - a[:, 2], b[:, 2] - levels[crossed_level]
    crossings = (above[:, None] * a[:, :2] + below[:, None] * b[:, :2]) / (below + above)[:, None]

    level = np.concatenate([on_level, crossed_level])
    by_level = np.argsort(level, kind="stable")
    outline = np.concatenate([points[on, :2], crossings])[by_level]
    ends = np.searchsorted(level[by_level], np.arange(len(levels) + 1))
    polygons = [np.empty((0, 2))] * len(heights)
    for i, j in enumerate(order):
        polygons[j] = convex_polygon(outline[ends[i] : ends[i + 1]], rounding) + origin[:2]
    return polygons


def slice_outlines(mesh: trimesh.Trimesh, rotation: Array, heights: Array) -> list[list[Array]]:
    """Plane sections of any closed mesh: the contours that can be reached from outside, in the units of the mesh.

    Rotation and heights are as in `slice_polygons`.  Returns for each height simple polygons (m, 2) outside of each other,
    counter-clockwise; none where the plane misses the body.  Holes, and what lies in them, are left out.  Vertices in the plane
    count as above it, so that the section by a plane that contains faces is the one just below.
    """
    origin, size = rotation @ mesh.bounds.mean(axis=0), float(np.linalg.norm(mesh.extents))
    return [
        [line + origin[:2] for line in _outer_outlines(lines, size)] for lines in _about_middle(mesh, rotation, heights)
    ]


def section_lines(mesh: trimesh.Trimesh, rotation: Array, heights: Array) -> list[list[Array]]:
    """All closed lines (m, 2) of plane sections as those of `slice_outlines`, with the body on their left."""
    middle = (rotation @ mesh.bounds.mean(axis=0))[:2]
    return [[line + middle for line in lines] for lines in _about_middle(mesh, rotation, heights)]


def _about_middle(mesh: trimesh.Trimesh, rotation: Array, heights: Array) -> list[list[Array]]:
    """The closed lines (m, 2) of plane sections, about the middle of the bounding box."""
    center = mesh.bounds.mean(axis=0)
    points, faces = (mesh.vertices.view(np.ndarray) - center) @ rotation.T, mesh.faces.view(np.ndarray)
    order = np.argsort(heights)
    lines = _closed_lines(points, faces, heights[order] - (rotation @ center)[2])
    return [lines[k] for k in np.argsort(order)]


def _closed_lines(points: Array, faces: Index, levels: Array) -> list[list[Array]]:
    """The closed lines (m, 2) in which planes at rising levels cut the triangles of a closed mesh, body on the left."""
    z = points[faces, 2]
    first, last = (np.searchsorted(levels, end, side="right") for end in (z.min(axis=1), z.max(axis=1)))
    face, level = _pairs(first, last)
    above = z[face] >= levels[level, None]
    following = np.roll(above, -1, axis=1)
    ends = []
    for crossing in (above & ~following, ~above & following):  # where a face is entered, and where it is left
        k = crossing.argmax(axis=1)
        ends.append(np.sort(np.stack([faces[face, k], faces[face, (k + 1) % 3]], axis=1), axis=1))
    a, b = points[ends[0]].transpose(1, 0, 2)
    share = (levels[level] - a[:, 2]) / (b[:, 2] - a[:, 2])
    places = a[:, :2] + share[:, None] * (b - a)[:, :2]
    entered, left = (np.lexsort((edge[:, 1], edge[:, 0], level)) for edge in ends)
    next_face = np.empty(len(face), dtype=np.intp)
    next_face[left] = entered
    lines: list[list[Array]] = [[] for _ in levels]
    number, pending = next_face.tolist(), [True] * len(face)
    for start in range(len(face)):
        line, k = [], start
        while pending[k]:
            pending[k] = False
            line.append(k)
            k = number[k]
        if line:
            lines[level[start]].append(places[line])
    return lines


def _pairs(first: Index, last: Index) -> tuple[Index, Index]:
    """All pairs (i, j) with first[i] <= j < last[i], as two arrays."""
    i, rank = ranges(np.maximum(last - first, 0))
    return i, first[i] + rank


def convex_polygon(points: Array, rounding: float) -> Array:
    """Counter-clockwise hull (m, 2) of points (n, 2), without vertices that bulge from it by no more than rounding.

    Empty (0, 2) if the points span no polygon.
    """
    empty = np.empty((0, 2))
    if len(points) < 3 or (size := np.ptp(points, axis=0).max()) <= rounding:
        return empty
    try:
        polygon: Array = points[ConvexHull((points - points.mean(axis=0)) / size).vertices]
    except QhullError:  # the points lie on a line
        return empty
    # vertices are removed one at a time, so that of two that coincide one stays
    while len(polygon) >= 3:
        before, after = polygon - np.roll(polygon, 1, axis=0), np.roll(polygon, -1, axis=0) - polygon
        turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        bulge = turn / np.linalg.norm(before + after, axis=1)  # distance from the neighbours' chord
        if bulge.min() > rounding:
            return polygon
        polygon = np.delete(polygon, bulge.argmin(), axis=0)
    return empty


# --- outlines of what closed lines enclose, as they are met from outside ---


def _outer_outlines(lines: list[Array], size: float) -> list[Array]:
    """Simple polygons (m, 2), counter-clockwise and outside of each other, around all that closed lines enclose.

    lines
        (m, 2) each, in either direction: the sections of shells of a body.  They may cross and touch themselves and each other;
        then they are cut there, and the outline is that of the union.
    size
        of the body, to which rounding is relative.

    Holes, and what lies in them, are left out.
    """
    lines = [line[np.hypot(*(line - np.roll(line, 1, axis=0)).T) > ROUNDING * size] for line in lines]
    # a line that crosses itself may have no area, but not one that encloses nothing
    lines = [line for line in lines if np.abs(_turned(line)).sum() > ROUNDING * size**2]
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
    turn = _turn(d, e)
    s, t = ratio(_turn(between, e), turn), ratio(_turn(between, d), turn)
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
    both = np.concatenate([edges, edges[:, ::-1]])
    along = ends[both[:, 1]] - ends[both[:, 0]]
    # in the order of their directions, so that each step of a walk has one step before it, also where directions are equal
    neighbours: dict[int, list[int]] = {}
    for p, q in both[np.argsort(np.arctan2(along[:, 1], along[:, 0]), kind="stable")].tolist():
        neighbours.setdefault(p, []).append(q)
    left, lines = set(neighbours), []
    while left:
        first = min(left, key=lambda p: (ends[p, 1], ends[p, 0]))
        walk = [first, neighbours[first][0]]
        while True:
            before, here = walk[-2:]
            beside = neighbours[here]
            there = beside[(beside.index(before) + 1) % len(beside)]
            if [here, there] == walk[:2]:
                break
            walk.append(there)
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
    right = x < x0 + ratio((y - y0) * (x1 - x0), y1 - y0)
    return np.asarray((crosses & right).sum(axis=1) % 2 == 1)


def _area(polygon: Array) -> float:
    return float(_turned(polygon).sum()) / 2


def _turned(polygon: Array) -> Array:
    about = polygon - polygon[:1]
    return _turn(about, np.roll(about, -1, axis=0))


def _turn(p: Array, q: Array) -> Array:
    return np.asarray(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
