"""Closed surfaces through contacts that were made from anywhere: a minimum cut through tetrahedra between them.

The contacts, thinned, and a box around them are the corners of Delaunay's tetrahedra.  Each tetrahedron is of the body or free.
What is known of a tetrahedron costs where it is denied: rods that have passed through it, and contacts on the far side of which
it lies.  Faces between the body and free space cost their area, and how far they are from those that Delaunay's tetrahedra of
dense points have on a surface: the circumspheres on both of their sides then are large and flat there.  The labels of least
cost are a minimum cut (Labatut, Pons, Keriven 2009).

A tetrahedron that two rods pass deeper than contacts are apart is free whatever it costs.  One alone may be that of a wrong
contact, and chords between contacts lie in free space less deep than that.

Where no contact is near, tetrahedra reach from one part of the body far into free space, or to another part.  So places that
rods have passed there are corners as well, and tetrahedra at them are free.  Only where the near side of a wall was not touched
a tetrahedron may reach from its far side through it: it has its costs, and places around one that becomes one of the surface by
it are left out in a second cut, and more of them in a third.  Of both the one is taken that keeps the contacts and has fewer
holes, or the first cut if neither keeps them.

Nothing depends on planes, axes or a grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow
from scipy.spatial import Delaunay, cKDTree

from scan3d.arrays import Array, Index, Mask, ranges, ratio, unit_or_zero
from scan3d.cloud import TOUCHED
from scan3d.errors import NoBodyError
from scan3d.geometry.distance import Search
from scan3d.geometry.triangles import dot, kept_apart, longest_first, spanned
from scan3d.surfaces.creases import creased, least_bent
from scan3d.surfaces.tetrahedra import border, manifold, mend, parts, refined, shared

KNOWN, ESTIMATED, UNKNOWN = 2, 1, 0
"""Classes of the surface: touched near by; between touches; the rest, of which nothing is known."""
BETWEEN = 0.03
"""Largest distance from a contact at which a place is estimated, as `TOUCHED` is that at which it is known, in diagonals of the
contacts' box.  Contacts are places of the body: so neither is farther from it."""

# Contacts are moved by this part of their spacing, so that no two of them are as far apart as a limit and no five on a sphere,
# and open places likewise.
_JOGGLE, _SEED = 1e-4, 0
# Bodies are moved by multiples of so many diagonals, so that none is far from the origin.
_FAR = 100.0
# The box leaves this part of the diagonal around the contacts.
_MARGIN = 0.1
# Contacts closer than this part of their spacing, or of the thinnest walls, are one corner.  Spacing is that of a lattice as
# dense, of which random points are seldom so near; half the walls' thickness keeps the corners of both of their sides.
_MERGED, _OF_WALLS = 0.35, 0.5
# Contacts that are closer than this part of the diagonal count once for their spacing.
_CLUSTERED = 1 / 300
# Neighbours that the spacing and the thickness of walls are taken from, and the share of contacts that may lie at thinner ones:
# opposite sides of edges are no walls.
_NEIGHBOURS, _THINNER = 16, 0.005
# Contacts are on opposite sides of a wall if either lies within this angle's cosine of the other's direction into the body.
_ACROSS = np.cos(np.radians(30.0))
# Contacts touch a place from behind if their direction into the body is within this angle's cosine of the normal there.  It is
# less than a right angle, because at edges, and where rods graze, neither is certain.
_FROM_BEHIND = np.cos(np.radians(60.0))
# Depths behind a contact, in distances of merged contacts, at which the body lies.
_BEHIND = (0.4, 0.9)
# Rods count in full where they pass deeper than this part of the merged contacts' distance.
_DEEP = 0.25
# Costs of a tetrahedron for each rod, and for each place behind a contact, and how many of them count.
_PASSED, _TOUCHED_BEHIND, _COUNTED = 3.0, 6.0, 8
# Costs of a face: of an area of a square of the spacing, and of the angles of its circumspheres.
_AREA, _ANGLE = 0.5, 6.0
# Costs are whole numbers, these parts of one; the cost of what is certain exceeds all that can be saved by it.
_PARTS, _CERTAIN = 100, 10_000_000
# Smaller parts of the volume are splinters between rods.
_SPLINTER = 1e-3
# Rounds in which edges of more than two faces are mended by what is cheaper, before tetrahedra are only added.
_MENDED = 8
# Open places are as far apart, and from contacts, as places between contacts are estimated, and at least so many spacings of
# contacts, as tetrahedra between contacts are smaller.
_SPARSE = 3.0
# Around a wrong one they are left out within so many of their distances, whichever leaves fewer holes.
_LEFT_OUT = 1.0, 3.0
# The part of the contacts that may be lost beyond those that are lost anyway.
_LOST = 0.01
# Several fans of faces at a contact are moved apart by this part of the merged contacts' distance.
_APART = 0.02


@dataclass(frozen=True)
class Cut:
    """The surface of a body of any shape through its contacts, and what is known of it, in the contacts' unit."""

    surface: Any
    """A closed `trimesh.Trimesh`, outward; ``vertex_attributes["known"]``: 2 known, 1 estimated, 0 unknown."""
    off: Mask
    """(n,) contacts farther from the surface than contacts are apart: wrong ones, which free space forbids or which lie inside
    the body, and those on features that are too fine for it."""
    spacing: float
    """Distance of neighbouring contacts."""


def cut_surface(
    points: Array,
    inward: Array,
    lines: Array,
    free: Array | None = None,
    *,
    between: Array | None = None,
    moved: Array | None = None,
) -> Cut:
    """The closed surface that contacts and free space leave a body of any shape.

    points (n, 3), inward (n, 3)
        contacts, and unit vectors from them into the body.
    lines (m, 2, 3)
        segments that rods have passed.
    free (k, 3)
        further places that are taken for free.
    between (j, 2, 3)
        further places at which the surface may have corners where nothing was touched, and unit vectors from them into the
        body, NaN where there is no telling.
    moved (n, 3)
        places of the surface that the contacts are those of, if rods are thick and lines are those of their axes.

    Raises NoBodyError for contacts that span no body.
    """
    import trimesh

    size, origin = 0.0, np.zeros(3)
    if len(points) and (size := float(np.linalg.norm(np.ptp(points, axis=0)))):
        # in tetrahedra far from the origin coordinates would lose their digits
        origin = _FAR * size * np.round(points.mean(axis=0) / (_FAR * size))
    points, lines = points - origin, lines - origin
    free, moved = (None if places is None else places - origin for places in (free, moved))
    between = np.empty((0, 2, 3)) if between is None else between - [origin, np.zeros(3)]
    thin = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] if len(points) > 3 else 0.0
    if thin < _JOGGLE * size * np.sqrt(len(points)):
        raise NoBodyError("the contacts lie in a plane, and span no body; touch it from more sides")
    random = np.random.default_rng(_SEED)
    joggled = points + random.uniform(-1, 1, points.shape) * _JOGGLE * _CLUSTERED * size
    spacing, wall = _spacing(joggled, inward, size)
    merged = min(_MERGED * spacing, _OF_WALLS * wall)
    corners = kept_apart(joggled, merged)
    loose = between[:, 0] + random.uniform(-1, 1, (len(between), 3)) * _JOGGLE * _CLUSTERED * size
    touching, into = np.concatenate([joggled, loose]), np.concatenate([inward, between[:, 1]])
    behind = touching + merged * np.multiply.outer(_BEHIND, into)
    behind = behind[:, np.isfinite(into).all(axis=1)].reshape(-1, 3)
    directions = np.concatenate([inward[corners], between[:, 1]])
    apart = max(BETWEEN * size, _SPARSE * spacing)
    opened = _opened(joggled, lines, apart)
    opened += random.uniform(-1, 1, opened.shape) * _JOGGLE * apart

    def body_with(opened: Array, *, through_walls: bool) -> Index:
        """Faces (f, 3) of the body, if tetrahedra at open places are free: through walls as well, or on their side."""
        cells = _Cells.around(np.concatenate([joggled[corners], loose, opened]), _MARGIN * size)
        cell, depth = cells.crossed(lines)
        empty = np.bincount(cell[depth > spacing], minlength=len(cells.corners)) > 1
        empty |= cells.at_openings(directions, len(opened), through_walls=through_walls)
        if free is not None:
            within = cells.at(free)
            inside = within[within >= 0]
            cell, depth = np.append(cell, inside), np.append(depth, cells.depth(inside, free[within >= 0]))
        passed = np.zeros(len(cells.corners))
        np.add.at(passed, cell, np.minimum(depth / (_DEEP * merged), 1.0))
        inside = cells.at(behind)
        touched = np.bincount(inside[inside >= 0], minlength=len(cells.corners))
        return _bounded(cells, passed, touched, empty, spacing)

    faces = body_with(opened, through_walls=False)
    wrong = np.isin(np.arange(len(opened)) + len(directions), faces)
    if wrong.any():
        away = cKDTree(opened[wrong]).query(opened)[0]
        fewer = [opened[away > left_out * apart] for left_out in _LEFT_OUT]
        found = [body_with(places, through_walls=True) for places in fewer]
        # open places tear holes into a wall whose near side was not touched, or all of it, also where they were not wrong
        used = [np.unique(some) for some in (*found, faces)]
        lost = np.array([len(corners) - np.count_nonzero(some < len(corners)) for some in used])
        whole = [len(some) - len(part) / 2 for some, part in zip(used[:-1], found, strict=True)]
        keeps = lost <= lost.min() + _LOST * len(corners)
        if keeps[:-1].any():
            best = int(np.argmax(np.where(keeps[:-1], whole, -np.inf)))
            opened, faces = fewer[best], found[best]
    moved = points if moved is None else moved
    vertices = np.concatenate([moved[corners], between[:, 0], opened])
    vertices, faces = manifold(vertices, faces, _APART * merged)
    vertices, faces = creased(vertices, least_bent(vertices, faces))
    faces = least_bent(vertices, faces)
    vertices, faces = refined(vertices, faces, min(2 * spacing, TOUCHED * size))
    surface = trimesh.Trimesh(vertices + origin, faces, process=False)
    surface.metadata.update(method="cut", reason="a minimum cut through tetrahedra between contacts and free space")
    surface.vertex_attributes["known"] = _classes(vertices, faces, moved, inward, size)
    triangles = vertices[faces]
    triangles = np.take_along_axis(triangles, longest_first(triangles)[:, :, None], axis=1)
    return Cut(surface, Search(triangles).nearest(moved)[0] > spacing, spacing)


def _spacing(points: Array, inward: Array, size: float) -> tuple[float, float]:
    """The median distance of neighbouring contacts, and the thickness of the thinnest walls; infinite if none is seen."""
    chosen = kept_apart(points, _CLUSTERED * size)
    points, inward = points[chosen], inward[chosen]
    if len(points) < 4 or not size:
        raise NoBodyError("the contacts are all in a few places, and span no body; touch it in more places")
    count = min(_NEIGHBOURS, len(points) - 1)
    distance, other = cKDTree(points).query(points, count + 1)
    distance, other = distance[:, 1:], other[:, 1:]
    # of points as dense on a plane so many lie in a circle of this radius
    spacing = float(np.median(distance[:, -1])) * np.sqrt(np.pi / count)
    along = ratio(points[other] - points[:, None], distance[..., None])
    opposite = (dot(along, inward[:, None]) > _ACROSS) & (-dot(along, inward[other]) > _ACROSS)
    thickness = np.where(opposite, distance, np.inf).min(axis=1)
    return spacing, float(np.partition(thickness, k := int(_THINNER * len(points)))[k])


class _Cells(NamedTuple):
    """Delaunay's tetrahedra (t,) between points (n, 3), the last eight of which are the corners of a box around the others."""

    tree: Any
    points: Array
    corners: Index
    """(t, 4)"""
    neighbours: Index
    """(t, 4) opposite each corner."""
    gradients: Array
    """(t, 4, 3) of the barycentric coordinates."""
    offsets: Array
    """(t, 4) the barycentric coordinates of the origin."""
    heights: Array
    """(t, 4) of the corners above the faces opposite."""

    @classmethod
    def around(cls, points: Array, margin: float) -> _Cells:
        low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
        box = low + (high - low) * np.array(list(np.ndindex(2, 2, 2)))
        # no more than four corners of the box on a sphere
        box += (
            np.random.default_rng(_SEED).uniform(0, 1, box.shape) * _JOGGLE * margin * np.sign(box - (low + high) / 2)
        )
        points = np.concatenate([points, box])
        tree = Delaunay(points)
        corners = tree.simplices
        first = points[corners[:, 0]]
        a, b, c = (points[corners[:, k]] - first for k in (1, 2, 3))
        normals = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
        gradients = normals / dot(normals[:, 0], a)[:, None, None]
        gradients = np.concatenate([-gradients.sum(axis=1, keepdims=True), gradients], axis=1)
        offsets = -dot(gradients, first[:, None])
        offsets[:, 0] += 1
        heights = 1 / np.linalg.norm(gradients, axis=2)
        return cls(tree, points, corners, tree.neighbors, gradients, offsets, heights)

    def at(self, places: Array) -> Index:
        """The tetrahedra (p,) that places (p, 3) lie in; -1 outside the box."""
        return np.asarray(self.tree.find_simplex(places), dtype=np.int64)

    def depth(self, cell: Index, places: Array) -> Array:
        """Distances (p,) of places (p, 3) from the nearest face of the tetrahedra (p,) that they lie in."""
        barycentric = dot(self.gradients[cell], places[:, None]) + self.offsets[cell]
        return np.asarray((barycentric * self.heights[cell]).min(axis=1))

    def crossed(self, lines: Array) -> tuple[Index, Array]:
        """The tetrahedra (s,) that segments (m, 2, 3) cross, one after the other, and how deep (s,) the middle of each crossing
        lies in its tetrahedron."""
        low, high = self.points[-8:].min(axis=0), self.points[-8:].max(axis=0)
        inner = _JOGGLE * (high - low)
        start, along = _in_box(lines, low + inner, high - inner)
        cell = self.at(start)
        row = np.flatnonzero(cell >= 0)
        cell, before, place = cell[row], np.full(len(row), -1), np.zeros(len(row))
        found: list[Index] = [np.empty(0, dtype=np.int64)]
        depths = [np.empty(0)]
        while len(row):
            gradients = self.gradients[cell]
            change = np.einsum("nkx,nx->nk", gradients, along[row])
            value = np.einsum("nkx,nx->nk", gradients, start[row]) + self.offsets[cell]
            beyond = self.neighbours[cell]
            leave = np.where((change < 0) & (beyond != before[:, None]), ratio(-value, change), np.inf)
            face = leave.argmin(axis=1)[:, None]
            leave = np.maximum(np.take_along_axis(leave, face, axis=1)[:, 0], place)
            middle = (place + np.minimum(leave, 1.0)) / 2
            found.append(cell)
            depths.append(((value + middle[:, None] * change) * self.heights[cell]).min(axis=1))
            after = np.take_along_axis(beyond, face, axis=1)[:, 0]
            on = (leave < 1) & (after >= 0)
            row, before, cell, place = row[on], cell[on], after[on], leave[on]
        return np.concatenate(found), np.concatenate(depths)

    def at_openings(self, directions: Array, count: int, *, through_walls: bool) -> Mask:
        """(t,) which tetrahedra have a corner of the box, or one of the `count` open places before them.

        directions (n, 3)
            into the body, at the other corners.  Tetrahedra with such an open place behind one of them are not meant unless
            `through_walls`.
        """
        first = len(directions)
        is_open, is_box = self.corners >= first, self.corners >= first + count
        meant: Mask = np.asarray(is_open.any(axis=1))
        if through_walls:
            return meant
        rows = np.flatnonzero(meant & ~is_box.any(axis=1))
        corners = self.points[self.corners[rows]]
        along = unit_or_zero(corners[:, None] - corners[:, :, None])
        into = directions[np.where(is_open[rows], 0, self.corners[rows])]
        is_behind = (dot(along, into[:, :, None]) > _FROM_BEHIND) & is_open[rows][:, None] & ~is_open[rows][:, :, None]
        meant[rows[is_behind.any(axis=(1, 2))]] = False
        return meant


def _opened(points: Array, lines: Array, apart: float) -> Array:
    """(n, 3) places on segments (m, 2, 3), so far apart and from all contacts, near which at least two of them pass."""
    low, high = points.min(axis=0) - apart, points.max(axis=0) + apart
    start, along = _in_box(lines, low, high)
    count = np.ceil(np.linalg.norm(along, axis=1) / apart).astype(np.int64)
    line, rank = ranges(count)
    places = start[line] + ((rank + 0.5) / count[line])[:, None] * along[line]
    index = np.maximum((places - low) / apart, 0.0).astype(np.int64)
    cell = np.ravel_multi_index(index.T, np.ceil((high - low) / apart).astype(np.int64) + 1)
    # of each line once
    once = np.unique(cell * max(len(start), 1) + line, return_index=True)[1]
    _, first, passing = np.unique(cell[once], return_index=True, return_counts=True)
    places = places[once[first[passing > 1]]]
    places = places[cKDTree(points).query(places, distance_upper_bound=apart)[0] > apart]
    return places[kept_apart(places, apart)] if len(places) else places


def _in_box(lines: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Starts and differences (k, 3) of the parts of segments (m, 2, 3) in a box."""
    start, along = lines[:, 0], lines[:, 1] - lines[:, 0]
    ends = np.sort([ratio(low - start, along), ratio(high - start, along)], axis=0)
    between = (start > low) & (start < high)
    ends = np.where(along == 0, np.where(between, [[[-np.inf]], [[np.inf]]], np.nan), ends)
    enter, leave = ends[0].max(axis=1).clip(min=0), ends[1].min(axis=1).clip(max=1)
    some = enter < leave
    start, along, enter, leave = start[some], along[some], enter[some, None], leave[some, None]
    return start + enter * along, (leave - enter) * along


def _bounded(cells: _Cells, passed: Array, touched: Index, empty: Mask, spacing: float) -> Index:
    """Faces (f, 3), outward, of the body of least cost; every edge belongs to two of them.

    passed, touched (t,)
        how often rods passed the tetrahedra, and how many places behind contacts lie in them.
    empty (t,)
        those that are free for certain.
    """
    neighbours = cells.neighbours
    row, column = np.nonzero(neighbours >= 0)
    other = neighbours[row, column]
    heights = cells.heights
    edges = cells.points[cells.corners[:, 1:]] - cells.points[cells.corners[:, :1]]
    volume = np.abs(np.linalg.det(edges)) / 6
    # circumcentres, from the first corner
    centre = np.einsum("tk,tkx->tx", dot(edges, edges) / 2, cells.gradients[:, 1:])
    above = dot(cells.gradients, centre[:, None])
    above[:, 0] += 1
    flat = above * heights / np.linalg.norm(centre, axis=1)[:, None]
    back = (neighbours[other] == row[:, None]).argmax(axis=1)
    area = 3 * volume[row] / heights[row, column]
    face = _AREA * area / spacing**2 + _ANGLE * (1 - np.minimum(flat[row, column], flat[other, back]))
    # of both sides of a face, which rounding may tell apart
    first = row < other
    cost = np.empty(neighbours.shape)
    cost[row[first], column[first]] = cost[other[first], back[first]] = face[first]
    free = np.where(empty, _CERTAIN, _PASSED * np.minimum(passed, _COUNTED))
    body = _least(row, other, cost[row, column], free, _TOUCHED_BEHIND * np.minimum(touched, _COUNTED))
    # free space comes from outside, and the body has no splinters in it
    part = parts(~body, neighbours)
    outside = np.zeros(len(body) + 1, dtype=bool)
    outside[part[~body & (neighbours < 0).any(axis=1)]] = True
    body |= ~outside[part]
    part = parts(body, neighbours)
    sizes = np.bincount(part[body], volume[body], minlength=len(body) + 1)
    body &= sizes[part] >= _SPLINTER * sizes.sum()
    if not body.any():
        raise NoBodyError("the contacts span no body that the rods have left free; touch it more densely")
    # mending never adds what is free for certain
    price = volume + empty * volume.sum()
    for rounds in range(len(body)):
        faces, _ = border(body, cells.points, cells.corners, neighbours)
        wrong = shared(faces)
        if not len(wrong):
            break
        # the smaller side of edges with more than two faces changes first; later tetrahedra are only added
        mend(body, wrong, cells.corners, neighbours, price, only_add=rounds >= _MENDED)
    return faces


def _least(row: Index, other: Index, face: Array, free: Array, body: Array) -> Mask:
    """(t,) which tetrahedra are of the body at the least cost: a minimum cut.

    row, other, face (f,)
        pairs of tetrahedra, either way, and the costs of the faces between them.
    free, body (t,)
        costs of those that are free and are called body, and the reverse.
    """
    count = len(free)
    every = np.arange(count)
    start = np.concatenate([row, np.full(count, count), every])
    end = np.concatenate([other, every, np.full(count, count + 1)])
    capacity = np.minimum(np.rint(_PARTS * np.concatenate([face, body, free])), _CERTAIN).astype(np.int32)
    graph = csr_array((capacity, (start, end)), shape=(count + 2,) * 2)
    left = graph - maximum_flow(graph, count, count + 1).flow
    left.data[left.data < 0] = 0
    left.eliminate_zeros()
    chosen = np.zeros(count + 2, dtype=bool)
    # the smallest of all cuts, which is the same whatever the flow
    chosen[breadth_first_order(left, count, return_predecessors=False)] = True
    return chosen[:count]


def _classes(vertices: Array, faces: Index, points: Array, inward: Array, size: float) -> NDArray[np.int8]:
    """(n,) class of vertices (n, 3) of the surface: by the nearest contact that does not touch it from behind."""
    triangles = vertices[faces]
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], spanned(triangles))
    count = min(_NEIGHBOURS, len(points))
    distance, other = cKDTree(points).query(vertices, count, distance_upper_bound=BETWEEN * size)
    found = np.isfinite(distance)
    behind = dot(inward[np.where(found, other, 0)], unit_or_zero(normals)[:, None]) > _FROM_BEHIND
    behind[distance == 0] = False
    nearest = np.where(found & ~behind, distance, np.inf).min(axis=1)
    known = np.where(nearest <= TOUCHED * size, KNOWN, np.where(nearest <= BETWEEN * size, ESTIMATED, UNKNOWN))
    return known.astype(np.int8)
