"""Facets of a polyhedron from exact contacts in parallel slices, and the normals of the contacts that lie on them.

A slice of a polyhedron is a polygon.  Two contacts on one of its sides with a third between them, or with the rod's tangent at
one of them along it, give that side exactly: no other convex contour has these contacts.  Parallel slices cut a facet in
parallel sides, so that two sides with one normal in different slices span a plane.  It is that of a facet if all contacts lie
behind it.  Two facets may be parallel in these slices only, as those of a double pyramid, and a plane through a side of each
may cut off the edge between them.  So planes of two sides count only if neither side lies in another plane as well, and if no
sides are parallel for another reason, such as a body's symmetry.

The planes are an estimate, never a proof: no bound rests on them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import AT_ONCE, NEGLIGIBLE, ROUNDING, Array, highest, unit_or_zero
from scan3d.cloud import Cloud, NormalSource
from scan3d.geometry.triangles import dot
from scan3d.reconstruction.slices import Slice, SliceStack, stacks

# Planes of unit normals whose entries differ by less, with the body's size as unit, are one: both may be wrong by half of it.
_SAME = 4 * NEGLIGIBLE


def facets(cloud: Cloud) -> Array:
    """Planes (k, 4) of facets that contacts show, n and c with ``<n, x> <= c``; none of noisy contacts, or tilted slices."""
    if cloud.covariance is not None or cloud.tilt is not None or not len(cloud):
        return np.empty((0, 4))
    size = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    parts = [_of_stack(stack, cloud.points, size) for stack in stacks(cloud)]
    planes, error = (np.concatenate(column) for column in zip(*parts, strict=True))
    return _distinct(planes[np.argsort(error, kind="stable")], size)


def _distinct(planes: Array, size: float) -> Array:
    """Planes (k, 4) without repetition: every pair of sides of a facet gives its plane, and the first stays."""
    again = cKDTree(planes / [1, 1, 1, size]).query_pairs(_SAME, output_type="ndarray")[:, 1]
    return np.delete(planes, again, axis=0)


def completed(planes: Array, cloud: Cloud, vertices: Array) -> Array:
    """Planes (k, 4) of facets, and those through further sides that contacts and vertices (v, 3) of the body leave one slope.

    The body has a plane through each side, and lies behind it: points above the side's slice bound its slope from one side,
    and points below from the other.  Where the bounds agree, a facet is met by one slice and ends in vertices on both sides.
    """
    size = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    found = [planes]
    for stack in stacks(cloud):
        points = np.concatenate([cloud.points, vertices]) @ stack.frame.T
        normals, offsets = planes[:, :3] @ stack.frame.T, planes[:, 3]
        for slice_ in stack.slices:
            angle, value, length, start = _sides(slice_, size)
            across = np.stack([np.cos(angle), np.sin(angle)])
            along = np.stack([-across[1], across[0]])
            known = np.ones((len(planes), len(angle)), dtype=bool)
            for place in (start, start + length):
                heights = normals[:, :2] @ (value * across + place * along) + normals[:, 2:] * slice_.height
                known &= np.abs(heights - offsets[:, None]) <= NEGLIGIBLE * size
            across, value = across[:, ~known.any(axis=0)], value[~known.any(axis=0)]
            above = points[:, 2] - slice_.height
            apart = np.abs(above) > NEGLIGIBLE * size
            slope = (points[apart, :2] @ across - value) / above[apart, None]
            upper = above[apart] > 0
            low, high = slope[upper].max(axis=0, initial=-np.inf), slope[~upper].min(axis=0, initial=np.inf)
            fits = high - low <= _SAME
            slope, value = (low + high)[fits] / 2, value[fits]
            through = np.column_stack([across[:, fits].T, -slope, value - slope * slice_.height])
            through /= np.linalg.norm(through[:, :3], axis=1)[:, None]
            found.append(np.column_stack([through[:, :3] @ stack.frame, through[:, 3]]))
    return _distinct(np.concatenate(found), size)


def _of_stack(stack: SliceStack, points: Array, size: float) -> tuple[Array, Array]:
    """Planes (p, 4) through sides with one normal in slices that follow each other, and their errors (p,)."""
    sides = [_sides(slice_, size) for slice_ in stack.slices]
    angle, value, length, _ = np.concatenate(sides, axis=1)
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


def _sides(slice_: Slice, size: float) -> Array:
    """Sides of a slice's contour that its contacts show: angles of the normals, support values, lengths and starts (4, s)."""
    corners, points, near = slice_.outline, slice_.points, NEGLIGIBLE * size
    if not len(corners):
        return np.empty((4, 0))

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
    shown &= length > near
    direction, (x, y) = np.stack([np.cos(angle), np.sin(angle)]), corners.T
    start = direction[0] * y - direction[1] * x
    return np.stack([angle, (direction * corners.T).sum(axis=0), length, start])[:, shown]


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
