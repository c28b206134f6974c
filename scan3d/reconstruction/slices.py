"""The slices of a recording and of its cloud: which sweeps lie in one plane, and the support functions in these planes.

A slice of a convex body at the height z has the support function ``h(θ, z) = max <n(θ), p>`` over its points p, with θ the
angle of the in-plane normal ``n = (cos θ, sin θ)``.  A tangential contact at p gives its value and its derivative,
``h = <n, p>`` and ``∂h/∂θ = <t, p>``, with the tangent ``t = (-sin θ, cos θ)``.

A clamp that is turned a little against the planned pose, as a calibration finds it, bends the rod in a plane that is tilted
against the slice.  Contacts lie in their row's own plane, and so do the tangents there: a contact says what holds at the
heights of that plane.  `Tilt` bounds by how much these differ from the height of the slice.

At a fixed normal angle h is concave in z, so that beyond two slices the body's section lies in the polygon of the secants'
extrapolations.  The rods of a slice without contact stay straight: a section that they would have touched is not there.  If
the areas that they sweep cover the polygon, the body does not reach the slice.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import planar
from scan3d.arrays import NEGLIGIBLE, Array, Index, Mask, evenly, ratio
from scan3d.cloud import Cloud, Tilt
from scan3d.errors import InputError
from scan3d.geometry.hulls import hull_about_mean
from scan3d.geometry.sections import slice_frame
from scan3d.recording import Recording
from scan3d.rigs import axes_of
from scan3d.units import UNITS_M
from scan3d.unmeasured import SEVERAL

SAME_AXIS = 1e-8
"""Parallel axes differ by less than this in each component, which is rounding."""
SAME_HEIGHT = NEGLIGIBLE
"""Sweeps lie in one slice if their heights differ by less than this many rod lengths."""
LEVEL = 0.02
"""Slices that are tilted against the table by less, in radians, count as parallel to it: those of a clamp that is a little off
would else lie along several axes, of which no one bounds the body."""


class Planes(NamedTuple):
    """The slices (s,) of a recording with n rows."""

    number: NDArray[np.int32]
    """(n,) number of each row's slice, in order of appearance."""
    axis: Array
    """(s, 3) normals of the slices."""
    height: Array
    """(s,) their heights along the normals, in metres."""
    tilt: Tilt | None
    """How far the rows' planes are tilted against their slices, in metres; None if it is by no more than the poses' digits."""

    def turned(self, contour_normals: Array, normals: Array, rows: Index) -> Array:
        """Normals (k, 3) of contours in the planes of some rows, turned about the contours' tangents into the slices' planes.

        The tangents, seen along the axis, are perpendicular to these normals.
        """
        if self.tilt is None:
            return contour_normals
        inside = np.cross(np.cross(normals[rows], contour_normals), self.axis[self.number[rows]])
        return inside / np.linalg.norm(inside, axis=1, keepdims=True)


def planes(recording: Recording, normals: Array, centre: Array) -> Planes:
    """The slices of a recording whose rows bend the rod in planes with unit normals (n, 3).

    centre
        (3,) a place amid the contacts, in metres, over which the heights of tilted planes are compared.

    Raises InputError if a row's plane lies across its slice.
    """
    number, axis, height = slices_of(recording, normals)
    across = np.abs((normals * axis[number]).sum(axis=1)) < np.sqrt(0.5)
    if across.any():
        row = int(across.argmax())
        raise InputError(
            f"a sweep lies in one plane, but the z axis of the clamp is turned by more than 45° against the rest of its sweep "
            f"in {across.sum()} of {len(across)} rows, first in row {row + 1}: check the columns sweep, qw, qx, qy and qz, or "
            "choose the spatial model if the sensor measures six axes"
        )
    slope, length = _slope(normals, axis[number]), recording.rod.length_m
    if slope * length <= recording.noise.place_m + SAME_HEIGHT * length:
        return Planes(number, axis, height, None)
    # tilted sweeps lie in one slice if their planes meet near the middle of the contacts
    number, axis, height = slices_of(recording, normals, centre, slope * 0.2 * length)
    off = _heights(recording, normals, axis[number], centre) - height[number]
    return Planes(number, axis, height, Tilt(_slope(normals, axis[number]), float(np.abs(off).max()), centre))


def slices_of(
    recording: Recording, normals: Array, centre: Array | None = None, apart: float = 0.0
) -> tuple[NDArray[np.int32], Array, Array]:
    """(n,) number of each row's slice, in order of appearance; (s, 3) normals of the slices and (s,) heights, in metres.

    A sweep lies in one plane.  Sweeps are in one slice if their planes differ by no more than rounding, or by no more
    than the poses within a typical sweep do.  Planes that are almost parallel to a known table count as parallel to
    it.

    centre
        the place over which the heights of tilted planes are taken; by default they are those of the clamp.
    apart
        difference of heights, in metres, up to which sweeps lie in one slice in any case.
    """
    _, first, sweep = np.unique(recording.sweep, return_index=True, return_inverse=True)
    sweep_normals = normals[first]
    if recording.table_m is not None:
        level = np.linalg.norm(sweep_normals[:, :2], axis=1) < LEVEL
        sweep_normals = np.where(level[:, None], np.sign(sweep_normals[:, 2:]) * [0.0, 0.0, 1.0], sweep_normals)
    # normals of measured poses
    direction = _groups(sweep_normals, 1e-3)
    mean = np.stack([np.bincount(direction, column) for column in sweep_normals.T], axis=1)
    axis = (mean / np.linalg.norm(mean, axis=1, keepdims=True))[direction]
    height = _heights(recording, normals, axis[sweep], centre)
    plane = np.bincount(sweep, height) / np.bincount(sweep)
    low, high = np.full(len(plane), np.inf), np.full(len(plane), -np.inf)
    np.minimum.at(low, sweep, height)
    np.maximum.at(high, sweep, height)
    same = max(SAME_HEIGHT * recording.rod.length_m, apart, 2.0 * float(np.median(high - low)))
    _, group = np.unique(np.column_stack([direction, _groups(plane[:, None], same)]), axis=0, return_inverse=True)
    group = group.reshape(-1)
    # numbers in the order in which the slices appear
    start = np.full(group.max() + 1, len(sweep))
    np.minimum.at(start, group, first)
    order = np.argsort(start)
    rank = np.empty(len(start), dtype=np.int32)
    rank[order] = np.arange(len(start))
    first_sweep = sweep[start[order]]
    return rank[group][sweep], axis[first_sweep], (np.bincount(group, plane) / np.bincount(group))[order]


def _slope(normals: Array, axis: Array) -> float:
    """Largest tangent of the angle between a normal and its axis, (n, 3) each."""
    return float((np.linalg.norm(np.cross(normals, axis), axis=1) / np.abs((normals * axis).sum(axis=1))).max())


def _heights(recording: Recording, normals: Array, axis: Array, centre: Array | None) -> Array:
    """(n,) heights along the axes of the rows' clamps, or of their planes over a centre."""
    if centre is None:
        clamps: Array = (recording.position_m * axis).sum(axis=1)
        return clamps
    over = ((recording.position_m - centre) * normals).sum(axis=1) / (normals * axis).sum(axis=1)
    return axis @ centre + over


def _groups(values: Array, same: float) -> NDArray[np.int64]:
    """Number (n,) of each row's group: by gaps in every sorted column, so that equal values are never separated."""
    keys = np.empty(values.shape, dtype=np.int64)
    for key, column in zip(keys.T, values.T, strict=True):
        order = np.argsort(column, kind="stable")
        key[order] = np.cumsum(np.insert(np.diff(column[order]) > same, 0, False))
    return np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)


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
            np.diff(self.angle, append=self.angle[0] + 2 * np.pi).max() < np.pi - NEGLIGIBLE
        )

    def support_of_contacts(self, normals: Array) -> Array:
        """Lower bound (n,) of the support function for unit normals (n, 2): the support function of the contacts."""
        if self._turns is None:
            return (normals @ self.corners.T).max(axis=1)
        begin, corners = self._turns
        # before the first angle the last corner is the extreme one
        extreme = corners[np.searchsorted(begin, np.arctan2(normals[:, 1], normals[:, 0])) - 1]
        return np.asarray(normals[:, 0] * extreme[:, 0] + normals[:, 1] * extreme[:, 1])

    @cached_property
    def outline(self) -> Array:
        """(v, 2) vertices of the convex hull of the points, empty if they lie on a line."""
        hull = hull_about_mean(self.points)
        return np.empty((0, 2)) if hull is None else np.asarray(self.points[hull.vertices])

    @cached_property
    def _turns(self) -> tuple[Array, Array] | None:
        """(v,) rising angles of the normals from which each of (v, 2) corners of the outline is the extreme one.

        None where the outline turns by rounding only.
        """
        along = np.diff(self.outline, axis=0, append=self.outline[:1])
        # after the side before a corner, which runs around the body counterclockwise
        begin = np.roll(np.arctan2(-along[:, 0], along[:, 1]), 1)
        first = int(begin.argmin()) if len(begin) else 0
        begin = np.roll(begin, -first)
        return (begin, np.roll(self.outline, -first, axis=0)) if (np.diff(begin) > 0).all() and len(begin) else None

    @property
    def corners(self) -> Array:
        """(v, 2) the vertices of the points' hull, or all points if they lie on a line."""
        return self.outline if len(self.outline) else self.points


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
        value = np.concatenate([slice_.value for slice_ in slices])
        slope = np.hstack([slice_.slope for slice_ in slices])
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
        upper = ratio(a * np.sin(width * (1 - t)) + b * np.sin(width * t), sine)
        upper = np.where((width < np.pi) & np.isfinite(upper), np.maximum(upper, lower), np.inf)
        return np.clip(cubic, lower, upper)


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
    height_error: float = 0.0
    """Largest error of a contact's height over the slice it counts to."""
    confident: bool = False
    """Whether the slices' points and support lines allow for noise (`scan3d.bounds.noise`)."""
    table: Array | None = None
    """(4,) the half-space ``a·x + b <= 0`` above a table that does not lie across the axis, in the slices' frame."""

    @cached_property
    def heights(self) -> Array:
        return np.array([slice_.height for slice_ in self.slices])

    def contour(self, i: int) -> Array:
        """The corners (v, 3) of slice i in the world."""
        corners = self.slices[i].corners
        return np.column_stack([corners, np.full(len(corners), self.slices[i].height)]) @ self.frame

    def supports(self, angle: Array, first: int, last: int) -> Array:
        """Support functions (last - first, n) at angles (n,) of the slices from `first` to before `last`, as
        `SupportFunctions.at`; NaN of slices that the known normals do not enclose, and where there are none."""
        closed, functions = self._closed
        low, high = np.searchsorted(closed, (first, last))
        found = np.full((last - first, len(angle)), np.nan)
        if functions is not None and low < high:
            found[closed[low:high] - first] = functions.at(angle, int(low), int(high))
        return found

    @cached_property
    def _closed(self) -> tuple[Index, SupportFunctions | None]:
        """The numbers of the slices that the known normals enclose, and their support functions if there are any."""
        closed = np.flatnonzero([slice_.closed for slice_ in self.slices])
        return closed, SupportFunctions([self.slices[i] for i in closed]) if len(closed) else None


def stacks(cloud: Cloud) -> list[SliceStack]:
    """The cloud's slices, one stack for each axis it was sliced along; they are kept with the cloud."""
    of = (cloud.points, cloud.in_plane_normals, cloud.phase, cloud.slice, cloud.slice_axis, cloud.slice_height)
    inputs = *of, cloud.unresolved, cloud.table
    known, before = cloud.kept.get("stacks", ((), ()))
    if len(before) != len(inputs) or any(one is not other for one, other in zip(inputs, before, strict=True)):
        known = _computed(cloud)
        cloud.kept["stacks"] = known, inputs
    return list(known)


def _computed(cloud: Cloud) -> list[SliceStack]:
    by_axis = []
    order = np.argsort(cloud.slice, kind="stable")
    first = np.searchsorted(cloud.slice[order], np.arange(len(cloud.slice_height) + 1))
    rows = [order[start:end] for start, end in itertools.pairwise(first)]
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


def _slice(cloud: Cloud, frame: Array, number: int, rows: Index) -> Slice:
    points = cloud.points[rows] @ frame[:2].T
    measured = np.isfinite(cloud.in_plane_normals[rows, 0])
    along_rod = cloud.phase[rows] == planar.Phase.TANGENTIAL
    tangential, tip = np.flatnonzero(measured & along_rod), np.flatnonzero(measured & ~along_rod)
    normals, tip_normals = (cloud.in_plane_normals[rows[part]] @ frame[:2].T for part in (tangential, tip))
    raw = np.arctan2(normals[:, 1], normals[:, 0])
    raw[raw > np.pi - NEGLIGIBLE] -= 2 * np.pi  # so that rounding does not make two of the one half a turn away
    order = np.argsort(raw, kind="stable")
    # contacts with one normal lie on a straight edge of the contour
    group = np.cumsum(np.diff(raw[order], prepend=raw[order][:1]) > NEGLIGIBLE)
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
        angle=angle,
        value=value,
        slope=slope,
        corner=corner,
    )


def unproven(cloud: Cloud, recording: Recording, number: NDArray[np.int32], felt: float) -> Mask:
    """Whether slices (s,) of a cloud have no contact and yet the body may reach them.

    number
        (n,) number of the slice of each row of the recording.
    felt
        deflection of a rod's tip, in rod lengths, from which it is felt: the body may be as far inside the swept areas.
    """
    found = np.zeros(len(cloud.slice_height), dtype=bool)
    filled = np.zeros(len(found), dtype=bool)
    filled[cloud.slice] = True
    rows = np.argsort(number, kind="stable")
    ends = np.searchsorted(number[rows], np.arange(len(found) + 1))
    bent = recording.in_plane() if any(recording.rod.curvatures) or recording.rod.weight_N else None
    for stack in stacks(cloud):
        for k in np.flatnonzero(~filled & (np.abs(cloud.slice_axis - stack.frame[2]).max(axis=1) < SAME_AXIS)):
            polygon = _section(stack, float(cloud.slice_height[k]))
            of_slice = rows[ends[k] : ends[k + 1]]
            found[k] = polygon is None or not _covered(polygon, _swept(recording, of_slice, stack.frame, felt, bent))
    return found


def _section(stack: SliceStack, height: float) -> Array | None:
    """Corners (v, 2) of a polygon that contains the section of the body at a height beyond the slices of a stack.

    None if the slices do not bound it, and no corners if the slices prove that there is none.
    """
    slices = stack.slices if height < stack.heights[0] else stack.slices[::-1]
    for here, behind in itertools.pairwise(slices):
        if not here.closed:
            continue
        sides = evenly(np.arange(len(here.angle)), 60)
        normals = np.stack([np.cos(here.angle[sides]), np.sin(here.angle[sides])], axis=1)
        secant = (here.value[sides] - behind.support_of_contacts(normals)) / (here.height - behind.height)
        # a square that contains every section that slices bound
        middle, size = here.points.mean(axis=0), 1e3 * float(np.ptp(here.points, axis=0).max())
        polygon: Array = middle + size * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        for normal, value in zip(normals, here.value[sides] + secant * (height - here.height), strict=True):
            polygon = _clipped(polygon, normal, float(value))
        return polygon
    return None


def _swept(
    recording: Recording, rows: Index, frame: Array, felt: float, bent: planar.Rod | None
) -> list[tuple[Array, Array]]:
    """Rectangles that the free rods of some rows sweep, as four normals (4, 2) and values (4,) in a slice's frame.

    Their lengths are in the unit of the recording; the sides at which a rod would be bent too little to be felt are left out,
    and so is what lies between two rows that are much farther apart than others, where rows were lost.  A rod that is `bent`
    where it is free lies aside of its clamp's axis, so that so much is left out as well.
    """
    scale = UNITS_M[recording.unit]
    place, axes = recording.position_m[rows] @ frame[:2].T / scale, axes_of(recording.quaternion[rows])
    length = recording.rod.length_m / scale
    areas = []
    for sweep in np.unique(recording.sweep[rows]):
        of_sweep = recording.sweep[rows] == sweep
        aside, ahead = felt, 1.0
        if bent is not None:
            rod = bent.rows(rows[of_sweep][:1])
            rod = replace(rod, gravity=rod.down[0]) if rod.down.ndim == 2 else rod
            x, y = planar.elastic_lines(0.0, *planar.free_reactions(rod), rod=rod).curved[0].T
            aside, ahead = felt + float(np.abs(x).max()), float(y[-1])
            if not (np.diff(y) > 0).all():  # bent back
                continue
        along = axes[of_sweep, 1].mean(axis=0) @ frame[:2].T
        along /= np.linalg.norm(along)
        across = np.array([-along[1], along[0]])
        base, side = place[of_sweep] @ along, np.sort(place[of_sweep] @ across)
        step = np.diff(side)
        lost = (
            np.flatnonzero(step > SEVERAL * np.median(step[step > 0])) + 1 if step.any() else np.empty(0, dtype=np.intp)
        )
        for part in np.split(side, lost):
            values = base.min() + ahead * length, -base.max(), part[-1] - aside * length, -(part[0] + aside * length)
            areas.append((np.stack([along, -along, across, -across]), np.array(values)))
    return areas


def _covered(polygon: Array, areas: list[tuple[Array, Array]]) -> bool:
    """Whether areas cover a convex polygon (v, 2), up to rounding."""
    least = NEGLIGIBLE * _area(polygon)
    pieces = [polygon] if len(polygon) else []
    for normals, values in areas:
        left = []
        for piece in pieces:
            inside = piece
            for normal, value in zip(normals, values, strict=True):
                left.append(_clipped(inside, -normal, -float(value)))
                inside = _clipped(inside, normal, float(value))
        pieces = [piece for piece in left if len(piece) > 2 and _area(piece) > least]
    return not pieces


def _clipped(polygon: Array, normal: Array, value: float) -> Array:
    """The part (w, 2) of a convex polygon (v, 2) with ``<normal, p> <= value``."""
    depth = value - polygon @ normal
    inside = depth >= 0
    if inside.all():
        return polygon
    following = np.arange(1, len(polygon) + 1) % len(polygon)
    begin = np.flatnonzero(inside != inside[following])
    end = following[begin]
    part = depth[begin] / (depth[begin] - depth[end])
    crossing = polygon[begin] + part[:, None] * (polygon[end] - polygon[begin])
    # each corner is followed by the crossing of the side that begins there
    order = np.argsort(np.concatenate([np.flatnonzero(inside), begin + 0.5]))
    corners: Array = np.concatenate([polygon[inside], crossing])[order]
    return corners


def _area(polygon: Array) -> float:
    if len(polygon) < 3:
        return 0.0
    (x, y), (u, v) = polygon.T, np.roll(polygon, -1, axis=0).T
    return abs(float((x * v - u * y).sum())) / 2
