"""The slices of a cloud: their support functions in the plane.

A slice of a convex body at the height z has the support function ``h(θ, z) = max <n(θ), p>`` over its points p, with θ the
angle of the in-plane normal ``n = (cos θ, sin θ)``.  A tangential contact at p gives its value and its derivative,
``h = <n, p>`` and ``∂h/∂θ = <t, p>``, with the tangent ``t = (-sin θ, cos θ)``.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import blake2b
from weakref import WeakValueDictionary

import numpy as np
from scipy.spatial import ConvexHull, QhullError

import planar
from scan3d.arrays import Array, Index
from scan3d.cloud import Cloud
from scan3d.geometry.sections import slice_frame

# Contacts whose normals differ by less, in radians, lie on one straight edge of the contour.  Larger, the normals of a gently
# curved contour merge; smaller, rounding makes several normals of one edge, with support lines that hardly differ.
_SAME_NORMAL = 1e-9
# Directions over which a slice's Steiner point is averaged.  More take longer; fewer make the average depend on where the
# contour's edges lie.
_STEINER_DIRECTIONS = 360
# Parallel axes differ by less than this in each component.  Larger, distinct axes merge; smaller, rounding separates equal
# axes.
SAME_AXIS = 1e-8
# The known normals enclose a slice if every gap between them is smaller than half a turn by at least this angle, in radians.
# Larger, slices that are enclosed count as open; smaller, support lines that are parallel to rounding count as closed.
_HALF_TURN_MARGIN = 1e-9


@dataclass(frozen=True)
class Slice:
    """One slice: its height, its contacts in the plane, and its support function between their normals."""

    height: float
    rows: Index
    """Contacts of the cloud (n,)."""
    points: Array
    """(n, 2) in the slices' frame."""
    tangential: Index
    """(k,) positions in `rows` of the tangential contacts, whose normals are measured."""
    normals: Array
    """(k, 2) their in-plane normals."""
    tip: Index
    """(l,) positions in `rows` of the tip contacts whose normals are inferred from a common friction."""
    tip_normals: Array
    """(l, 2) their in-plane normals."""
    outline: Array
    """(v, 2) vertices of the convex hull of the points, empty if they lie on a line."""
    angle: Array
    """(a,) distinct angles of the normals, increasing."""
    value: Array
    """(a,) support function there."""
    slope: Array
    """(2, a) its one-sided derivatives in θ, left and right: they differ on an edge."""
    corner: Array
    """(a, 2, 2) contacts with that normal at the edge's left and right end."""

    @property
    def closed(self) -> bool:
        """Whether the known normals leave no gap of half a turn: the support lines enclose the slice."""
        return len(self.angle) >= 3 and bool(
            np.diff(self.angle, append=self.angle[0] + 2 * np.pi).max() < np.pi - _HALF_TURN_MARGIN
        )

    def support_of_contacts(self, normals: Array) -> Array:
        """Lower bound (n,) of the support function for unit normals (n, 2): the support function of the contacts."""
        corners = self.outline if len(self.outline) else self.points
        value: Array = (normals @ corners.T).max(axis=1)
        return value

    def support(self, angle: Array) -> Array:
        """Support function (n,) at angles (n,), as `SupportFunctions.at`."""
        value: Array = self._support.at(angle)[0]
        return value

    @cached_property
    def _support(self) -> SupportFunctions:
        return SupportFunctions((self,))

    def steiner_point(self) -> Array:
        """(2,) the slice's Steiner point, ``(1/π) ∫ h n dθ``."""
        angle = 2 * np.pi * np.arange(_STEINER_DIRECTIONS) / _STEINER_DIRECTIONS
        h = self.support(angle)
        point: Array = 2 * np.array([np.mean(h * np.cos(angle)), np.mean(h * np.sin(angle))])
        return point


class SupportFunctions:
    """The support functions of slices with known normals, evaluated together, which takes a fraction of the time.

    Each angle of a slice begins an interval that ends at the slice's next angle.
    """

    def __init__(self, slices: Sequence[Slice]) -> None:
        counts = [len(slice_.angle) for slice_ in slices]
        self._first = np.cumsum([0, *counts])
        """(s + 1,) the first interval of each slice, and the number of all intervals."""
        following = np.arange(self._first[-1]) + 1
        following[self._first[1:] - 1] = self._first[:-1]
        self._angles = [slice_.angle for slice_ in slices]
        self._angle = np.concatenate(self._angles)
        width = np.mod(self._angle[following] - self._angle, 2 * np.pi)
        self._width = np.where(width == 0, 2 * np.pi, width)
        self._sine = np.sin(self._width)
        value, slope = (
            np.concatenate([slice_.value for slice_ in slices]),
            np.hstack([slice_.slope for slice_ in slices]),
        )
        corner = np.concatenate([slice_.corner for slice_ in slices])
        self._ends = np.stack([value, value[following], slope[1], slope[0, following]])
        """(4, a) values at both ends of each interval, and slopes there."""
        self._corners = np.stack([*corner[:, 1].T, *corner[following, 0].T])
        """(4, a) x and y of the contacts at both ends."""

    def at(self, angle: Array, first: int = 0, last: int | None = None) -> Array:
        """Support functions (s, n) of the slices from `first` to before `last` at angles (n,).

        Hermite's cubic between the known normals, clipped to its certain bounds: the contacts at both ends, and the
        intersection of the two support lines.
        """
        chosen = slice(first, last)
        start = self._angle[self._first[:-1][chosen], None]
        shifted = start + np.mod(angle - start, 2 * np.pi)
        pairs = zip(self._angles[chosen], shifted, strict=True)
        i = np.stack([np.searchsorted(known, sought, side="right") for known, sought in pairs]) - 1
        i += self._first[:-1][chosen, None]
        width, sine = self._width[i], self._sine[i]
        a, b, da, db = self._ends[:, i]
        t = (shifted - self._angle[i]) / width
        cubic = (1 - t) ** 2 * (a * (1 + 2 * t) + width * da * t) + t * t * (b * (3 - 2 * t) - width * db * (1 - t))
        x, y = np.cos(angle), np.sin(angle)
        left_x, left_y, right_x, right_y = self._corners[:, i]
        lower = np.maximum(x * left_x + y * left_y, x * right_x + y * right_y)
        with np.errstate(divide="ignore", invalid="ignore"):
            upper = (a * np.sin(width * (1 - t)) + b * np.sin(width * t)) / sine
        upper = np.where((width < np.pi) & np.isfinite(upper), np.maximum(upper, lower), np.inf)
        value: Array = np.clip(cubic, lower, upper)
        return value


@dataclass(frozen=True)
class SliceStack:
    """Parallel slices of a cloud, in the order of their heights, and the heights of the nearest empty slices."""

    frame: Array
    """(3, 3) rows: x, y and z axes of the slices' frame in the world."""
    slices: tuple[Slice, ...]
    floor: float
    """Height of the nearest empty slice below, or of the table that lies across the axis; -inf if there is neither."""
    ceiling: float
    """Height of the nearest empty slice above, or of the table; inf if there is neither."""
    bounded_by_others: tuple[bool, bool] = (False, False)
    """Whether floor and ceiling come from contacts in slices along other axes, rather than from empty slices."""
    height_error: float = 0.0
    """Largest error of a contact's height over the slice it counts to."""
    confident: bool = False
    """Whether the slices' points and support lines allow for noise (`scan3d.surfaces.confidence`)."""
    table: Array | None = None
    """(4,) the half-space ``a·x + b <= 0`` above a table that does not lie across the axis, in the slices' frame."""

    @cached_property
    def heights(self) -> Array:
        return np.array([slice_.height for slice_ in self.slices])

    def supports(self, angle: Array, first: int, last: int) -> Array:
        """Support functions (last - first, n) at angles (n,) of the slices from `first` to before `last`, as
        `SupportFunctions.at`; NaN of slices that the known normals do not enclose, and where there are none."""
        closed, functions = self._closed
        low, high = np.searchsorted(closed, (first, last))
        found = np.full((last - first, len(angle)), np.nan)
        if low < high:
            found[closed[low:high] - first] = functions.at(angle, int(low), int(high))
        return found

    @cached_property
    def _closed(self) -> tuple[Index, SupportFunctions]:
        """The numbers of the slices that the known normals enclose, and their support functions."""
        closed = np.flatnonzero([slice_.closed for slice_ in self.slices])
        return closed, SupportFunctions([self.slices[i] for i in closed])


SliceKey = tuple[bytes, ...]
"""What a slice is computed from: its frame and height, and its contacts with their normals and phases."""

# The slices in use, which are not computed again: the steps of one scan ask for those of the same contacts several times.
_in_use: WeakValueDictionary[SliceKey, Slice] = WeakValueDictionary()


def stacks(cloud: Cloud) -> list[SliceStack]:
    """The cloud's slices, one stack for each axis it was sliced along."""
    by_axis = []
    rows = _rows_of_slices(cloud)
    for axis in np.unique(np.round(cloud.slice_axis, 9), axis=0):
        members = np.flatnonzero(np.abs(cloud.slice_axis - axis).max(axis=1) < SAME_AXIS)
        frame = slice_frame(cloud.slice_axis[members[0]])
        order = members[np.argsort(cloud.slice_height[members])]
        slices = [_slice(cloud, frame, number, rows[number]) for number in order]
        filled = [slice_ for slice_ in slices if len(slice_.rows)]
        if not filled:
            continue
        unresolved = np.zeros(len(order), dtype=bool) if cloud.unresolved is None else cloud.unresolved[order]
        empty = [
            slice_.height for slice_, felt in zip(slices, unresolved, strict=True) if not (len(slice_.rows) or felt)
        ]
        low, high = filled[0].height, filled[-1].height
        floor = max((z for z in empty if z < low), default=-np.inf)
        ceiling = min((z for z in empty if z > high), default=np.inf)
        stack = SliceStack(frame, tuple(filled), floor, ceiling)
        by_axis.append(stack if cloud.table is None else _on_table(stack, cloud.table))
    return by_axis


def _on_table(stack: SliceStack, height: float) -> SliceStack:
    """A stack of a body of which nothing lies below a height z of the world.

    A table that lies across the axis, and above an end slice by errors only, is in that slice.
    """
    down = -stack.frame[:, 2]
    if np.abs(down[:2]).max() > SAME_AXIS:
        return replace(stack, table=np.append(down, height))
    if down[2] < 0:
        return replace(stack, floor=max(stack.floor, min(height, float(stack.heights[0]))))
    return replace(stack, ceiling=min(stack.ceiling, max(-height, float(stack.heights[-1]))))


def _rows_of_slices(cloud: Cloud) -> list[Index]:
    """The contacts of each slice of a cloud, in the order of the cloud."""
    order = np.argsort(cloud.slice, kind="stable")
    first = np.searchsorted(cloud.slice[order], np.arange(len(cloud.slice_height) + 1))
    return [order[start:end] for start, end in itertools.pairwise(first)]


def _key(cloud: Cloud, frame: Array, number: int, rows: Index) -> SliceKey:
    contacts = cloud.points[rows], cloud.in_plane_normals[rows], cloud.phase[rows]
    of_contacts = blake2b(b"".join(part.tobytes() for part in contacts)).digest()
    return frame.tobytes(), cloud.slice_height[number].tobytes(), of_contacts


def _slice(cloud: Cloud, frame: Array, number: int, rows: Index) -> Slice:
    """A slice of the cloud, computed if none of the same contacts is in use."""
    key = _key(cloud, frame, number, rows)
    found = _in_use.get(key)
    if found is None:
        found = _in_use[key] = _computed(cloud, frame, number, rows)
    return found if np.array_equal(found.rows, rows) else replace(found, rows=rows)


def _computed(cloud: Cloud, frame: Array, number: int, rows: Index) -> Slice:
    points = cloud.points[rows] @ frame[:2].T
    known = np.isfinite(cloud.in_plane_normals[rows, 0])
    along_rod = cloud.phase[rows] == planar.Phase.TANGENTIAL
    tangential, tip = np.flatnonzero(known & along_rod), np.flatnonzero(known & ~along_rod)
    normals, tip_normals = (cloud.in_plane_normals[rows[part]] @ frame[:2].T for part in (tangential, tip))
    raw = np.arctan2(normals[:, 1], normals[:, 0])
    order = np.argsort(raw, kind="stable")
    group = np.cumsum(np.diff(raw[order], prepend=raw[order][:1]) > _SAME_NORMAL)
    member = np.empty(len(raw), dtype=np.intp)
    member[order] = group
    count = int(group[-1]) + 1 if len(group) else 0
    angle = raw[order][np.searchsorted(group, np.arange(count))]
    n, t = np.stack([np.cos(angle), np.sin(angle)], axis=1), np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    contact = points[tangential]
    value = np.full(count, -np.inf)
    np.maximum.at(value, member, (contact * n[member]).sum(axis=1))
    along = (contact * t[member]).sum(axis=1)
    ends = np.lexsort((along, member))
    left = ends[np.searchsorted(member[ends], np.arange(count))]
    right = ends[np.searchsorted(member[ends], np.arange(count), side="right") - 1]
    slope = np.stack([along[left], along[right]])
    corner = np.stack([contact[left], contact[right]], axis=1)
    return Slice(
        height=float(cloud.slice_height[number]),
        rows=rows,
        points=points,
        tangential=tangential,
        normals=normals,
        tip=tip,
        tip_normals=tip_normals,
        outline=_outline(points),
        angle=angle,
        value=value,
        slope=slope,
        corner=corner,
    )


def _outline(points: Array) -> Array:
    if len(points) < 3:
        return np.empty((0, 2))
    try:
        vertices = ConvexHull(points - points.mean(axis=0)).vertices
    except QhullError:
        return np.empty((0, 2))
    return np.asarray(points[vertices])
