"""Free space in the planes of the slices: what rods have passed is not of the body, whatever its shape and its friction.

Why, `planar.hidden` says (C14): a point about which the loop of a rod, the path of its end, the next rod and the path of the
base winds is met by a rod in between.  Steps across snaps, and rods that were felt and gave no contact, count for nothing.

Free space is kept on a grid in each plane.  A cell counts as free if a place less than its diagonal away is.

The outer contours of a slice border what is neither free nor outside the hull of its contacts, as far as it is connected with
a contact.  Contacts are points of the body: so every point of the outer contours lies within ``max dist(y, contacts)`` of the
body's contour (C16).  Stretches without contact next to them are those that no rod has reached.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, cKDTree

import planar
from planar.hidden import SNAPPED
from scan3d.arrays import Array, Index, Mask, ranges, ratio
from scan3d.bounds.constraints import allowed, exact_error
from scan3d.cloud import Cloud
from scan3d.errors import InputError, NoBodyError
from scan3d.geometry.sections import slice_frame
from scan3d.reconstruction.contacts import with_rows
from scan3d.reconstruction.errors import felt
from scan3d.reconstruction.probings import free_lines
from scan3d.reconstruction.slices import SAME_AXIS, SAME_HEIGHT, planes
from scan3d.recording import Recording, of_rows
from scan3d.units import UNITS_M
from scan3d.workers import told

# Directions, evenly spaced, along which the rods of a slice are scanned; rods in between are scanned along the next one.
_DIRECTIONS = 48
# Cells between successive contacts of a sweep.
_ACROSS = 3
# Neighbours in the plane of a slice.
_IN_PLANE = np.zeros((3, 3, 3), dtype=bool)
_IN_PLANE[1] = ndimage.generate_binary_structure(2, 1)


@dataclass(frozen=True)
class Sheets:
    """The planes (s,) of the slices along one axis, with the free space in each of them on one grid, in the cloud's unit."""

    frame: Array
    """(3, 3) x, y and z axes of the planes as rows."""
    height: Array
    """(s,) along the z axis, rising."""
    number: Index
    """(c,) for each slice of the cloud the number of its plane, -1 for those along other axes."""
    origin: Array
    """(2,) x and y of the first cell's centre."""
    cell: float
    free: Mask
    """(s, ny, nx) whether the cell is free."""
    solid: Mask
    """(s, ny, nx) whether it may be of the body: not free, and in the hull of the slice's contacts."""

    @property
    def apart(self) -> float:
        """Median distance of neighbouring planes; infinite for a single one."""
        return float(np.median(np.diff(self.height))) if len(self.height) > 1 else np.inf

    @cached_property
    def depth(self) -> NDArray[np.float32]:
        """(s, ny, nx) distance from the border of what may be of the body, positive outside, in the plane."""
        return _depth(~self.solid, self.cell)

    def at(self, points: Array) -> tuple[Array, Array]:
        """Depths (n,) at points (n, 3), linear between cells and between planes, and how far (n,) the border is in the planes.

        Depths are at most as the planes are apart: from there on one plane says nothing of what lies before the next one.
        """
        place = points @ self.frame.T
        index = np.stack(
            [
                np.interp(place[:, 2], self.height, np.arange(len(self.height))),
                (place[:, 1] - self.origin[1]) / self.cell,
                (place[:, 0] - self.origin[0]) / self.cell,
            ]
        )
        found, distance = (
            ndimage.map_coordinates(depth, index, order=1, mode="nearest")
            for depth in (np.clip(self.depth, -self.apart, self.apart), np.abs(self.depth))
        )
        return found, distance

    def centres(self, cells: Mask) -> Array:
        """(n, 3) the centres of some cells."""
        number, y, x = np.nonzero(cells)
        flat = self.origin + self.cell * np.stack([x, y], axis=1)
        return np.asarray(flat @ self.frame[:2] + self.height[number, None] * self.frame[2])

    def thinned(self, apart: float) -> Array:
        """(n, 3) centres of free cells: all at the border of what is free, and others so far apart."""
        every = max(int(apart / self.cell), 1)
        chosen = self.free & ~ndimage.binary_erosion(self.free, _IN_PLANE)
        chosen[:, ::every, ::every] = self.free[:, ::every, ::every]
        return self.centres(chosen)

    def away(self, points: Array) -> Array:
        """(n,) distance of points (n, 3) from the nearest of the planes."""
        height = points @ self.frame[2]
        above = np.minimum(np.searchsorted(self.height, height), len(self.height) - 1)
        return np.minimum(np.abs(self.height[above] - height), np.abs(height - self.height[np.maximum(above - 1, 0)]))


class Contours(NamedTuple):
    """Border cells (n,) of the outer contours of all slices, and how far from a contact they are, in the cloud's unit."""

    points: Array
    """(n, 3)"""
    distance: Array
    """(n,) within which the true contour lies."""


def spacing_of(cloud: Cloud, recording: Recording | None = None) -> float:
    """Median distance between successive contacts of a sweep, in the cloud's unit: what one sweep resolves.

    Where no sweep has such contacts, that between successive places of the clamp, if the recording is given.
    """
    next_one = (np.diff(cloud.sweep) == 0) & (np.diff(cloud.row) == 1)
    step = np.linalg.norm(np.diff(cloud.points, axis=0), axis=1)[next_one]
    step = step[step > 1e-6 * cloud.rod_length]
    if cloud.place_sd is not None:  # what noise moves a contact by at a corner is no step
        noise = 3 * float(np.median(cloud.place_sd))
        step = step[step > noise] if (step > noise).any() else step
    if not len(step) and recording is not None:
        step = np.linalg.norm(np.diff(recording.position_m, axis=0), axis=1)[np.diff(recording.sweep) == 0]
        step = step[step > 0] / UNITS_M[cloud.unit]
    if not len(step):
        raise NoBodyError(
            "the recording has no sweep with two contacts one after the other; take more samples in a sweep"
        )
    return float(np.median(step))


def place_errors(cloud: Cloud) -> Array:
    """(n,) largest errors of the contacts' places, with the confidence of bounds where there is noise, in the cloud's unit."""
    allow = allowed(cloud)
    errors = np.full(len(cloud), exact_error(cloud)) + allow.place
    if allow.kappa is not None and cloud.place_sd is not None:
        errors += allow.kappa * cloud.place_sd
    return np.asarray(errors)


def sheets_of(recording: Recording, cloud: Cloud, beyond: float = 0.0) -> list[Sheets]:
    """The free space that a recording shows in the planes of its slices, axis by axis.

    cloud
        contacts of the recording in its slices, of a rod without thickness; rows that were felt and are not in it count as
        unknown.
    beyond
        distance around the contacts that is looked at, in the cloud's unit.

    Raises InputError for clouds without slices and for rods whose shape is not that of a uniform, straight one.
    """
    if not cloud.in_slices or not len(cloud.slice_height):
        raise InputError("free space in slices needs the planar model; a cloud of the spatial model has no slices")
    if not recording.rod.is_simple:
        raise InputError("free space is known of rods that are straight, uniform and weightless only")
    rods = rods_of(recording, cloud)
    left = np.ones(len(cloud.slice_height), dtype=bool)
    found = []
    cell = spacing_of(cloud, recording) / _ACROSS
    while left.any():
        axis = cloud.slice_axis[np.argmax(left)]
        # sweeps to the one side and to the other have opposite axes
        side = np.sign(cloud.slice_axis @ axis)
        same = np.abs(cloud.slice_axis - side[:, None] * axis).max(axis=1) < SAME_AXIS
        left &= ~same
        found.append(_sheets(axis, np.where(same, side * cloud.slice_height, np.nan), rods, cloud, cell, beyond))
    return found


class _Rods(NamedTuple):
    """Rods (n,) of a recording, one a row, in the cloud's unit."""

    clamp: Array
    """(n, 3)"""
    axes: Array
    """(n, 2, 3) the clamp's x and y axes."""
    line: Array
    """(n, k, 2) the rod in these axes, from the clamp."""
    slice: Index
    """(n,) number of the slice; -1 in none."""
    on: Mask
    """(n,) whether the step to the next row is one of known rods of one sweep without snap."""
    bulge: Array
    """(n,) by how much the path of the end may leave its chord in that step."""


def rods_of(recording: Recording, cloud: Cloud) -> _Rods:
    """The rods of the rows whose contact is their only one, and of those without force."""
    rod, unit = recording.rod, UNITS_M[recording.unit]
    force, noise = recording.force_N / rod.force_unit_N, recording.noise.of_reactions(rod)
    is_felt = felt(force, noise)
    known = ~is_felt
    known[cloud.row] = True
    zero = np.zeros(len(force))
    fx, fy = np.where(is_felt[:, None], force, 0.0).T
    # of chords between 40 points the sagitta is a fraction of a cell
    lines = planar.elastic_lines(zero, fx, fy, np.where(is_felt, recording.moment_Nm / rod.moment_unit_Nm, 0.0), 40)
    line = np.concatenate([lines.curved, lines.straight[:, 1:]], axis=1) * cloud.rod_length
    known &= np.isfinite(line).all(axis=(1, 2))
    line[~known] = np.nan
    axes, clamp = recording.axes(), recording.position_m / unit
    end = clamp + np.einsum("ni,nij->nj", np.nan_to_num(line[:, -1]), axes[:, :2])
    on = np.zeros(len(known), dtype=bool)
    step, travel = (np.linalg.norm(np.diff(place, axis=0), axis=1) for place in (clamp, end))
    on[:-1] = known[1:] & known[:-1] & (np.diff(recording.sweep) == 0) & (travel <= SNAPPED * step)
    # a path that turns halfway between two rows leaves its chord by half of what the second differences are
    second = np.full(len(known), np.nan)
    both = on[1:-1] & on[:-2]
    second[1:-1][both] = np.linalg.norm(np.diff(end, 2, axis=0), axis=1)[both]
    bulge = np.fmax(second, np.append(second[1:], np.nan)) / 2
    alone = np.append(travel, 0.0) / 2
    found = planes(recording, axes[:, 2], cloud.points.mean(axis=0) * unit)
    # rows that gave no contact may have further planes, and those of contacts another order
    along = found.axis @ cloud.slice_axis.T
    apart = np.abs(np.sign(along) * found.height[:, None] / unit - cloud.slice_height)
    apart[np.abs(along) < 1 - 1e-6] = np.inf  # as the directions of measured poses may differ in one slice
    of_plane = np.where(apart.min(axis=1) <= 1e-3 * cloud.rod_length, apart.argmin(axis=1), -1)
    return _Rods(clamp, axes[:, :2], line, of_plane[found.number], on, np.where(np.isnan(bulge), alone, bulge))


def passed_lines(recording: Recording, cloud: Cloud) -> Array:
    """(m, 2, 3) lines, in the cloud's unit, that rods of sweeps and of probings lay along; none of rods of unknown shape."""
    lines, swept = free_lines(recording, cloud), cloud.swept()
    if not len(swept) or not swept.in_slices or not recording.rod.is_simple:
        return lines
    number = np.flatnonzero(~recording.in_probings)
    rods = rods_of(of_rows(recording, number), with_rows(swept, number))
    places = rods.clamp[:, None] + np.einsum("nki,nij->nkj", rods.line, rods.axes)
    parts = np.stack([places[:, :-1], places[:, 1:]], axis=2).reshape(-1, 2, 3)
    return np.concatenate([lines, parts[np.isfinite(parts).all(axis=(1, 2))]])


def _sheets(axis: Array, heights: Array, rods: _Rods, cloud: Cloud, cell: float, beyond: float) -> Sheets:
    """The sheets along an axis; heights (c,) of the cloud's slices, NaN for those along others."""
    frame = slice_frame(axis)
    order = np.argsort(heights)[: np.isfinite(heights).sum()]
    new = np.diff(heights[order], prepend=-np.inf) > SAME_HEIGHT * cloud.rod_length
    place = np.full(len(heights), -1)
    place[order] = np.cumsum(new) - 1
    height = heights[order][new]
    flat = cloud.points @ frame[:2].T
    low, high = flat.min(axis=0) - beyond, flat.max(axis=0) + beyond
    cell = max(cell, float((high - low).max()) / 400)
    shape = np.ceil((high - low) / cell).astype(int) + 5
    middle = (low + high) / 2
    origin = middle - (shape - 1) / 2 * cell
    free = np.zeros((len(height), shape[1], shape[0]), dtype=bool)
    rows = np.flatnonzero((rods.slice >= 0) & (place[rods.slice] >= 0))
    along = rods.axes[rows, 1] @ frame[:2].T
    direction = np.round(np.arctan2(along[:, 1], along[:, 0]) / (2 * np.pi) * _DIRECTIONS).astype(int) % _DIRECTIONS
    across = np.arange(int(np.hypot(*shape)) + 2)
    x, y = ((np.arange(n) - (n - 1) / 2) * cell for n in shape)
    for number in told(np.unique(direction), "directions"):
        angle = 2 * np.pi * number / _DIRECTIONS
        turn = np.array([[np.sin(angle), -np.cos(angle)], [np.cos(angle), np.sin(angle)]])
        some = rows[direction == number]
        clamp = (rods.clamp[some] @ frame[:2].T - middle) @ turn.T
        axes = rods.axes[some] @ frame[:2].T @ turn.T
        lines = (clamp[:, None] + rods.line[some] @ axes) / cell + (len(across) - 1) / 2
        # rows that follow one another in the recording, of which the last of a step may be missing here
        on = rods.on[some] & (np.append(np.diff(some), 0) == 1)
        present, sheet = np.unique(place[rods.slice[some]], return_inverse=True)
        passed = _passed(lines, on, rods.bulge[some] / cell, sheet, len(present), len(across))
        column, row = (
            np.round((turn[k, 0] * x + turn[k, 1] * y[:, None]) / cell + (len(across) - 1) / 2).astype(int)
            for k in (0, 1)
        )
        free[present] |= passed[:, row, column]
    solid = ~free
    for k in range(len(height)):
        solid[k] &= _in_hull((flat[place[cloud.slice] == k] - origin) / cell, shape)
    return Sheets(frame, height, place, origin, cell, free, solid)


def _passed(lines: Array, on: Mask, bulge: Array, sheet: Index, sheets: int, size: int) -> Mask:
    """Cells (sheets, size, size) between successive rods (n, k, 2) that rise along the second coordinate, all in cells."""
    n, points = lines.shape[:2]
    rising = np.cumprod(np.nan_to_num(np.diff(lines[..., 1], axis=1), nan=-1.0) > 0, axis=1).astype(bool)
    top = lines[np.arange(n), rising.sum(axis=1)]
    # where each rod crosses the rows of the grid, one row after the other
    row = np.clip(np.floor(np.nan_to_num(lines[..., 1])).astype(int) + 1, 0, size)
    count = np.where(rising, np.maximum(np.diff(row, axis=1), 0), 0)
    segment, after = ranges(count.ravel())
    rod, k = np.divmod(segment, points - 1)
    a, b = lines[rod, k], lines[rod, k + 1]
    crossing = a[:, 0] + (row[rod, k] + after - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    first, number = row[:, 0], count.sum(axis=1)
    last, offset = first + number, np.cumsum(number) - number - first

    # up to where the path of the ends may come, the rods are the border of what they have passed
    pair = np.flatnonzero(on)
    lower, upper = np.maximum(first[pair], first[pair + 1]), np.minimum(last[pair], last[pair + 1])
    near = np.ceil(np.minimum(top[pair, 1], top[pair + 1, 1]) - bulge[pair]).clip(0, size).astype(int)
    p, r = ranges(np.maximum(np.minimum(upper, near) - lower, 0))
    r += lower[p]
    one, other = crossing[offset[pair[p]] + r], crossing[offset[pair[p] + 1] + r]
    bands = [(p, r, np.minimum(one, other), np.maximum(one, other))]

    # the shorter rod of each step ends at the chord of the ends' path, next to which nothing is claimed
    chord = top[pair + 1] - top[pair]
    rises = chord[:, 1] > 0
    long, short = np.where(rises, pair + 1, pair), np.where(rises, pair, pair + 1)
    begin = np.maximum(first[long], near)
    p, r = ranges(np.maximum(last[long] - begin, 0))
    r += begin[p]
    on_short = (r >= first[short[p]]) & (r < last[short[p]])
    one = crossing[offset[long[p]] + r]
    other = np.where(on_short, crossing[np.where(on_short, offset[short[p]] + r, 0)], np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        path = top[pair[p], 0] + (r - top[pair[p], 1]) * (chord[p, 0] / chord[p, 1])
        side = np.where(one > path, 1.0, -1.0)
        limit = path + side * (bulge[pair] * np.hypot(*chord.T) / np.abs(chord[:, 1]))[p]
        other = side * np.fmax(side * other, side * limit)
        known = side * (one - other) > 0
    bands.append((p[known], r[known], np.minimum(one, other)[known], np.maximum(one, other)[known]))

    p, r, left, right = (np.concatenate(columns) for columns in zip(*bands, strict=True))
    start = np.clip(np.ceil(left), 0, size).astype(int)
    stop = np.clip(np.floor(right) + 1, 0, size).astype(int)
    some = stop > start
    line_of = (sheet[pair[p]] * size + r)[some] * (size + 1)
    total = sheets * size * (size + 1)
    change = np.bincount(line_of + start[some], minlength=total) - np.bincount(line_of + stop[some], minlength=total)
    return np.cumsum(change.reshape(sheets, size, size + 1), axis=2)[..., :-1] > 0


def _in_hull(points: Array, shape: Index) -> Mask:
    """Cells (shape[1], shape[0]) whose centres lie in the hull of points (n, 2), in cells, or within about a cell of it."""
    if not len(points):
        return np.zeros((shape[1], shape[0]), dtype=bool)
    around = points[:, None] + np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    a, b, c = ConvexHull(around.reshape(-1, 2)).equations.T  # a x + b y + c <= 0 inside
    rest = b * np.arange(shape[1])[:, None] + c
    x = ratio(-rest, a)
    left, right = np.where(a < 0, x, -np.inf).max(axis=1), np.where(a > 0, x, np.inf).min(axis=1)
    left[((a == 0) & (rest > 0)).any(axis=1)] = np.inf
    columns = np.arange(shape[0])
    return np.asarray((columns >= left[:, None]) & (columns <= right[:, None]))


def _depth(outside: Mask, cell: float) -> NDArray[np.float32]:
    """Distance (s, ny, nx) from the border in each plane, positive outside."""
    far = float(sum(outside.shape))  # so that no other plane is nearer
    outer = ndimage.distance_transform_edt(outside, sampling=(far, 1, 1))
    inner = ndimage.distance_transform_edt(~outside, sampling=(far, 1, 1))
    outer, inner = np.minimum(outer, far), np.minimum(inner, far)
    return (cell * np.where(outside, outer - 0.5, 0.5 - inner)).astype(np.float32)


def contradicted(sheets: list[Sheets], cloud: Cloud) -> Mask:
    """Contacts (n,) that lie in the free space of their own slice, which no contact does."""
    wrong = np.zeros(len(cloud), dtype=bool)
    # a contact may lie inside free space by two cells, by their size and the rods' chords; deeper ones contradict it
    disc = np.hypot(*(np.indices((5, 5)) - 2)) <= 2.5
    for sheet in sheets:
        rows, cells = _cells(sheet, cloud)
        wrong[rows] = ndimage.binary_erosion(sheet.free, disc[None], border_value=1)[tuple(cells)]
    return wrong


def joined(cells: Mask, seeds: Mask, neighbours: Mask) -> Mask:
    """The connected parts of some cells that have a seed."""
    label, count = ndimage.label(cells, structure=neighbours)
    chosen = np.zeros(count + 1, dtype=bool)
    chosen[label[seeds & cells]] = True
    return chosen[label]


def _cells(sheet: Sheets, cloud: Cloud) -> tuple[Index, Index]:
    """Contacts (n,) in the slices of a sheet, and their cells (3, n)."""
    place = sheet.number[cloud.slice]
    rows = np.flatnonzero(place >= 0)
    x, y = np.round((cloud.points[rows] @ sheet.frame[:2].T - sheet.origin) / sheet.cell).astype(int).T
    return rows, np.stack([place[rows], y, x])


def outer_contours(sheets: list[Sheets], cloud: Cloud) -> Contours:
    """The outer contours of all slices with contacts; contacts that contradict free space are to be left out before."""
    parts = [_contours(sheet, cloud) for sheet in sheets]
    return Contours(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _contours(sheet: Sheets, cloud: Cloud) -> Contours:
    rows, index = _cells(sheet, cloud)
    touched = np.zeros(sheet.solid.shape, dtype=bool)
    touched[tuple(index)] = True
    kept = joined(sheet.solid, ndimage.binary_dilation(touched, np.ones((1, 3, 3))), _IN_PLANE)
    inner = ndimage.binary_erosion(kept, _IN_PLANE)
    number, y, x = np.nonzero(kept & ~inner)
    flat = sheet.origin + sheet.cell * np.stack([x, y], axis=1)
    apart = float(np.ptp(cloud.points, axis=0).sum() + cloud.rod_length)
    contacts = np.column_stack([cloud.points[rows] @ sheet.frame[:2].T, apart * index[0]])
    distance = np.empty(0)
    if len(flat):
        distance, nearest = cKDTree(contacts).query(np.column_stack([flat, apart * number]))
        distance += place_errors(cloud)[rows[nearest]]
    points = flat @ sheet.frame[:2] + sheet.height[number, None] * sheet.frame[2]
    # a corner of the cell is as far from its centre
    return Contours(points, distance + sheet.cell / np.sqrt(2))
