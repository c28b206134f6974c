"""Facets of a polyhedron from exact contacts in slices, and the normals of the contacts that lie on them.

A slice of a polyhedron is a polygon.  Two contacts on one of its sides with a third between them, or with the rod's tangent at
one of them along it, show that side: no other convex contour has these contacts.  Other neighbours may be corners of one side,
and are if that side agrees exactly with what else is known.  Parallel slices cut a facet in
parallel sides, so that two sides with one normal in different slices span a plane.  It is that of a facet if all contacts lie
behind it.  Two facets may be parallel in these slices only, as those of a double pyramid, and a plane through a side of each
may cut off the edge between them.  So planes of two sides count only if neither side lies in another plane as well, and if no
sides are parallel for another reason, such as a body's symmetry.  Two sides in slices that cross each other lie in one plane
only on one facet, unless they meet.

The planes are an estimate, never a proof: no bound rests on them.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import AT_ONCE, NEGLIGIBLE, ROUNDING, Array, Index, Mask, highest, ratio, unit, unit_or_zero
from scan3d.cloud import Cloud, NormalSource
from scan3d.geometry.hulls import clipped, hull, hull_about_mean
from scan3d.geometry.triangles import dot
from scan3d.reconstruction.slices import Slice, SliceStack, stacks

# Planes of unit normals whose entries differ by less, with the body's size as unit, are one: both may be wrong by half of it.
_SAME = 4 * NEGLIGIBLE
POLYHEDRON = 0.95
"""Part of the contacts on facets from which on a body counts as a polyhedron: polyhedra of up to 400 vertices have 0.99 in 64
slices, bodies with rounded edges 0.7."""


def facets(cloud: Cloud) -> Array:
    """Planes (k, 4) of facets that contacts show, n and c with ``<n, x> <= c``; none of noisy contacts, or tilted slices."""
    if cloud.covariance is not None or cloud.tilt is not None or not len(cloud):
        return np.empty((0, 4))
    size = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    by_axis = stacks(cloud)
    parts = [_of_stack(stack, cloud.points, size, shown) for stack in by_axis for shown in (True, False)]
    parts += [_of_sides(by_axis, cloud.points, size)] if len(by_axis) > 1 else []
    planes, error = (np.concatenate(column) for column in zip(*parts, strict=True))
    return _distinct(planes[np.argsort(error, kind="stable")], size)


class Polyhedron(NamedTuple):
    """What is known of a body by the facets on which its contacts lie."""

    planes: Array
    """(k, 4) of the facets, n and c with ``<n, x> <= c``."""
    corners: Array
    """(c, 3) of the polyhedron that these planes leave of the outer body."""
    vertex: Mask
    """(c,) which of them are vertices of the body: any other one may be cut off by a facet that is not known."""
    share: float
    """Part of the contacts that lie on the facets."""


def polyhedron(cloud: Cloud, inner: Array, outer: Array) -> Polyhedron:
    """What facets leave of a body that contains points `inner` (v, 3), and lies in the hull of points `outer` (w, 3)."""
    planes, size, known = facets(cloud), float(np.linalg.norm(np.ptp(cloud.points, axis=0))), 0
    contacts = on_planes(cloud.points, planes, size)
    share, left, vertex = len(np.unique(contacts[0])) / len(cloud.points), outer, np.zeros(len(outer), dtype=bool)
    if share <= 1 / 2:
        return Polyhedron(planes, left, vertex, share)
    outer = hull(outer).vertices.view(np.ndarray)
    while len(planes) > known:
        left = clipped(outer, planes)
        vertex, open_ = vertices_among(left, planes, contacts, size, simple=share >= POLYHEDRON)
        if known and share < POLYHEDRON:
            break  # the facets of a fine mesh would be found one after another
        known, planes = len(planes), completed(planes, cloud, np.concatenate([inner, left[vertex]]), left[open_])
        contacts = on_planes(cloud.points, planes, size)
        share = len(np.unique(contacts[0])) / len(cloud.points)
    return Polyhedron(planes, left, vertex, share)


def _distinct(planes: Array, size: float) -> Array:
    """Planes (k, 4) without repetition: every pair of sides of a facet gives its plane, and the first stays."""
    again = cKDTree(planes / [1, 1, 1, size]).query_pairs(_SAME, output_type="ndarray")[:, 1]
    return np.delete(planes, again, axis=0)


def on_planes(points: Array, planes: Array, size: float) -> tuple[Index, Index]:
    """Numbers of the points (n, 3) that lie on planes (k, 4), in their order, and of the planes; of a body of a size."""
    blocks = np.array_split(points, 1 + len(points) * len(planes) // AT_ONCE)
    near = [np.abs(block @ planes[:, :3].T - planes[:, 3]) <= NEGLIGIBLE * size for block in blocks]
    point, plane = np.nonzero(np.concatenate(near))
    return point, plane


def vertices_among(
    corners: Array, planes: Array, contacts: tuple[Index, Index], size: float, *, simple: bool
) -> tuple[Mask, Mask]:
    """Which corners (c, 3) of the body of planes (k, 4) are vertices of the true one, and in which others three of them meet.

    More planes than three meet in a vertex, since others do not meet in one point.  So do three if contacts, given with their
    planes as `on_planes`, lie on two of the edges: a facet that cut the corner off would have ends on these edges, where they
    go on to other facets' corners.  A `simple` polyhedron may be one in whose vertices three facets meet, most of which show
    that: one of the edges is enough then.
    """
    corner, plane = on_planes(corners, planes, size)
    meeting = np.bincount(corner, minlength=len(corners))
    contact, side = contacts
    on_edge = np.bincount(contact) == 2
    edges = np.unique(side[on_edge[contact]].reshape(-1, 2) @ [len(planes), 1])
    three = np.flatnonzero(meeting == 3)
    of_three = plane[np.isin(corner, three)].reshape(-1, 3)
    touched = np.isin(of_three[:, [0, 0, 1]] * len(planes) + of_three[:, [1, 2, 2]], edges).sum(axis=1)
    is_vertex = meeting > 3
    is_vertex[three] = touched > (0 if simple and (touched > 1).sum() > is_vertex.sum() else 1)
    return is_vertex, (meeting == 3) & ~is_vertex


def completed(planes: Array, cloud: Cloud, inner: Array, corners: Array) -> Array:
    """Planes (k, 4) of facets, and those through further sides to which points (v, 3) of the body leave one slope.

    The body has a plane through each side, and lies behind it: points above the side's slice bound its slope from one side,
    and points below from the other.  Where the bounds agree, a facet is met by one slice and ends in vertices on both sides.
    Corners (c, 3) in which three known facets meet may be vertices: those are whose slopes agree across the slice, and that
    lie in the known neighbour of the facet in which the side ends.
    """
    size = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    near, found = NEGLIGIBLE * size, [planes]
    in_planes = np.abs(corners @ planes[:, :3].T - planes[:, 3]) <= near
    for stack in stacks(cloud):
        normals, points, places = planes[:, :3] @ stack.frame.T, inner @ stack.frame.T, corners @ stack.frame.T
        for slice_ in stack.slices:
            angle, value, length, start, _ = _sides(slice_, size)
            across = np.stack([np.cos(angle), np.sin(angle)])
            ends = value * across + np.stack([start, start + length])[:, None] * np.stack([-across[1], across[0]])
            beyond = normals[:, :2] @ ends + normals[:, 2:] * slice_.height - planes[:, 3:]
            at_ends = np.abs(beyond) <= near  # (2, k, s)
            unknown = ~at_ends.all(axis=0).any(axis=0)
            sides = across[:, unknown], value[unknown], slice_.height
            above, below = points[:, 2] > slice_.height + near, points[:, 2] < slice_.height - near
            low = _slopes(points[above], *sides).max(axis=0, initial=-np.inf)
            high = _slopes(points[below], *sides).min(axis=0, initial=np.inf)
            possible = (in_planes @ at_ends.any(axis=0))[:, unknown]
            possible[np.abs(places[:, 2] - slice_.height) <= near] = False
            slope = _slopes(places, *sides)
            slope = np.where(possible & (slope >= low - _SAME) & (slope <= high + _SAME), slope, np.nan)
            slope, upper = np.vstack([low, high, slope]), np.append([True, False], places[:, 2] > slice_.height)
            order = np.argsort(slope, axis=0)
            slope = np.take_along_axis(slope, order, axis=0)
            agree = (np.diff(slope, axis=0) <= _SAME) & (np.diff(upper[order].astype(int), axis=0) != 0)
            fits = np.flatnonzero(agree.any(axis=0))
            slope = slope[agree.argmax(axis=0)[fits], fits]
            through = np.column_stack([sides[0][:, fits].T, -slope, sides[1][fits] - slope * slice_.height])
            through /= np.linalg.norm(through[:, :3], axis=1)[:, None]
            found.append(np.column_stack([through[:, :3] @ stack.frame, through[:, 3]]))
    return _distinct(np.concatenate(found), size)


def _slopes(points: Array, across: Array, value: Array, height: float) -> Array:
    """Slopes (n, s) of the planes through points (n, 3) and through sides at a height, with normals (2, s) and values (s,)."""
    return ratio(points[:, :2] @ across - value, points[:, 2:] - height)


def _of_stack(stack: SliceStack, points: Array, size: float, only_shown: bool) -> tuple[Array, Array]:
    """Planes (p, 4) through sides with one normal in slices that follow each other, and their errors (p,).

    Further sides between contacts count as well as those that contacts show, but may stand between two of these.
    """
    sides = [(side := _sides(slice_, size))[:, side[4] >= only_shown] for slice_ in stack.slices]
    angle, value, length, _, _ = np.concatenate(sides, axis=1)
    height = np.repeat(stack.heights, [side.shape[1] for side in sides])
    if len(angle) < 2:
        return np.empty((0, 4)), np.empty(0)
    # angles are counted from the widest gap, so that none of them stands at both ends
    order = np.argsort(angle)
    start = angle[order[(np.diff(angle[order], append=angle[order[0]] + 2 * np.pi).argmax() + 1) % len(order)]]
    angle = np.mod(angle - start + NEGLIGIBLE, 2 * np.pi) - NEGLIGIBLE
    order = np.argsort(angle)
    group = np.empty(len(order), dtype=np.intp)
    group[order] = np.cumsum(np.diff(angle[order], prepend=0.0) > NEGLIGIBLE)
    order = np.lexsort((height, group))
    low, high = order[:-1], order[1:]
    same = (group[low] == group[high]) & (height[low] < height[high])
    low, high = low[same], high[same]
    apart, turned = height[high] - height[low], angle[low] + start
    slope = (value[high] - value[low]) / apart
    planes = np.column_stack([np.cos(turned), np.sin(turned), -slope, value[low] - slope * height[low]])
    planes /= np.linalg.norm(planes[:, :3], axis=1)[:, None]
    planes[:, :3] = planes[:, :3] @ stack.frame
    error = ROUNDING * size * (1 + size * (1 / apart + 1 / length[low] + 1 / length[high]))
    beyond = np.where(error <= NEGLIGIBLE * size, highest(points, planes[:, :3]) - planes[:, 3], np.nan)
    found = np.flatnonzero(beyond <= error)
    if not len(found):
        return np.empty((0, 4)), np.empty(0)
    shared = high[found[:-1]] == low[found[1:]]
    same = shared & (np.abs(np.diff(planes[found] / [1, 1, 1, size], axis=0)).max(axis=1) <= _SAME)
    run = np.append(0, np.cumsum(~same))
    sides = np.bincount(run)[run] + 1
    clash = np.flatnonzero(shared & ~same)
    is_symmetric = bool((beyond > NEGLIGIBLE * size).any())
    doubted = np.isin(run, run[np.append(clash, clash + 1)]) | is_symmetric | (sides.max() == 2)
    found = found[(sides > 2) | ~doubted]
    return planes[found], error[found]


def _of_sides(by_axis: list[SliceStack], points: Array, size: float) -> tuple[Array, Array]:
    """Planes (p, 4) through two of the sides that contacts show in slices of any planes, and their errors (p,).

    The hull of the sides' ends has a face with ends of both.
    """
    ends = np.concatenate([_ends(stack, slice_, size) for stack in by_axis for slice_ in stack.slices])
    if (faces := hull_about_mean(ends.reshape(-1, 3))) is None:
        return np.empty((0, 4)), np.empty(0)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    pairs = np.unique((faces.simplices // 2)[:, list(permutations(range(3), 2))].reshape(-1, 2), axis=0)
    pairs = pairs[length[pairs[:, 0]] > length[pairs[:, 1]]]
    origin, along = ends[pairs[:, 0], 0], unit(ends[pairs[:, 0], 1] - ends[pairs[:, 0], 0])
    offset = ends[pairs[:, 1]] - origin[:, None]
    off = offset - (offset * along[:, None]).sum(axis=2, keepdims=True) * along[:, None]
    apart = np.linalg.norm(off, axis=2)
    rows, far = np.arange(len(pairs)), apart.argmax(axis=1)
    normals = unit(np.cross(along, off[rows, far]))
    normals *= np.sign(dot(normals, origin - points.mean(axis=0)))[:, None]
    error = ROUNDING * size * (1 + size * (1 / length[pairs[:, 0]] + ratio(1.0, apart.max(axis=1))))
    # lines of sides in one plane do not meet in their ends
    fits = (error <= NEGLIGIBLE * size) & (apart.min(axis=1) > 1e-5 * size)
    fits &= np.abs(dot(normals, offset[rows, 1 - far])) <= error
    planes, error = np.column_stack([normals, dot(normals, origin)])[fits], error[fits]
    behind = highest(points, planes[:, :3]) - planes[:, 3] <= error
    return planes[behind], error[behind]


def _ends(stack: SliceStack, slice_: Slice, size: float) -> Array:
    """Ends (s, 2, 3) in the world of those sides of a slice that contacts show."""
    sides = _sides(slice_, size)
    angle, value, length, start, _ = sides[:, sides[4] > 0]
    x, y = np.cos(angle), np.sin(angle)
    ends = [
        np.stack([value * x - place * y, value * y + place * x, np.full(len(x), slice_.height)], axis=1)
        for place in (start, start + length)
    ]
    return np.stack(ends, axis=1) @ stack.frame


def _sides(slice_: Slice, size: float) -> Array:
    """Sides of a slice's hull (5, s): angles of normals, support values, lengths, starts, and whether contacts show them."""
    corners, points, near = slice_.outline, slice_.points, NEGLIGIBLE * size
    if not len(corners):
        return np.empty((5, 0))

    def seen_at(places: Array) -> Array:
        x, y = (places - slice_.outline.mean(axis=0)).T
        return np.asarray(np.arctan2(y, x))

    corners = corners[np.argsort(seen_at(corners))]
    along = np.roll(corners, -1, axis=0) - corners
    length = np.maximum(np.linalg.norm(along, axis=1), near)
    along /= length[:, None]
    normals = np.stack([along[:, 1], -along[:, 0]], axis=1)
    angle, shown = np.arctan2(normals[:, 1], normals[:, 0]), np.zeros(len(corners), dtype=bool)
    # the side in whose sector each contact is seen from the middle; of a corner the one that begins there
    side = np.searchsorted(seen_at(corners), seen_at(points), side="right") - 1
    offset = points - corners[side]
    place = (offset * along[side]).sum(axis=1)
    on = np.abs((offset * normals[side]).sum(axis=1)) <= near
    shown[side[on & (place > near) & (place < length[side] - near)]] = True
    for k in (side[slice_.tangential], side[slice_.tangential] - 1):
        off = np.abs(((points[slice_.tangential] - corners[k]) * normals[k]).sum(axis=1))
        turn = np.abs((slice_.normals * along[k]).sum(axis=1))
        measured = (off <= near) & (turn * length[k] <= near)
        angle[k[measured]] = np.arctan2(*slice_.normals[measured].T[::-1])
        shown[k[measured]] = True
    direction, (x, y) = np.stack([np.cos(angle), np.sin(angle)]), corners.T
    start = direction[0] * y - direction[1] * x
    return np.stack([angle, (direction * corners.T).sum(axis=0), length, start, shown])[:, length > near]


def with_facet_normals(cloud: Cloud) -> Cloud:
    """The cloud with the normals of contacts on facets that the contacts show, tip contacts included.

    On an edge between two facets the normal lies between theirs, at the in-plane angle that a tangential contact measures, and
    in the middle at a tip contact.
    """
    planes = facets(cloud)
    if not len(planes):
        return cloud
    near = NEGLIGIBLE * float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    axis, measured = cloud.slice_axis[cloud.slice], np.nan_to_num(cloud.in_plane_normals)
    # of the facets on either side of the measured normal: the sum of their normals, and that of their turns from it
    total, turns = np.zeros((2, len(cloud), 3)), np.zeros((2, len(cloud)))
    for rows in np.array_split(np.arange(len(cloud)), 1 + len(cloud) * len(planes) // AT_ONCE):
        contact, plane = np.nonzero(np.abs(cloud.points[rows] @ planes[:, :3].T - planes[:, 3]) <= near)
        contact, normal = rows[contact], planes[plane, :3]
        turn = dot(np.cross(measured[contact], normal), axis[contact])
        side = (turn < 0).astype(np.intp)
        np.add.at(total, (side, contact), normal)
        np.add.at(turns, (side, contact), np.abs(turn))
    share = np.where(turns.min(axis=0) > 0, turns[::-1], 1.0)[:, :, None]
    known = np.asarray(total.any(axis=(0, 2)))
    normals = np.where(known[:, None], unit_or_zero((share * total).sum(axis=0)), cloud.normals)
    source = np.where(known, NormalSource.FACET, cloud.normal_source).astype(np.int8)
    return replace(cloud, normals=normals, normal_source=source)
