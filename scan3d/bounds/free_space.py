"""Free space in the planes of the slices: what rods have passed is not of the body, whatever its shape and its friction.

Why, `planar.hidden` says (C14): a point about which the loop of a rod, the path of its end, the next rod and the path of the
base winds is met by a rod in between.  Steps across snaps, and rods that were felt and gave no contact, count for nothing.

Free space is kept on a grid in each plane.  A cell counts as free if a place less than its diagonal away is.

The outer contours of a slice border what is neither free nor outside the hull of its contacts, as far as it is connected with
a contact.  Contacts are points of the body: so every point of the outer contours lies within ``max dist(y, contacts)`` of the
body's contour (C16).  Stretches without contact next to them are those that no rod has reached.

Two bodies between which a body without fine features lies: by balls that roll around contacts and free space (C19).

Premise: the body and its surroundings are unions of balls of radius R, so that nothing is thinner than 2R, no gap is narrower,
and no edge or groove is sharper; every part of the body was touched; and there is no cavity, so that the balls of the
surroundings are connected with the outside.

*Outer body.*  A ball in the body holds no free place.  So the body lies in the union of the balls about the centres that are at
least R away from all free places, as far as these centres are connected with such that reach a contact.

*Inner body.*  A ball in the surroundings holds no contact.  So the surroundings lie in the union of the balls about the centres
that are at least R away from all contacts, as far as these are connected with the outside.  Where contacts are apart by more
than 2R, balls roll in between, and nothing is claimed.  The sheets of free space play no part in it.

Every closed surface between the two is as close to the body's surface as they are to each other.

*Test.*  At a contact p a ball of the body and one of the surroundings touch, so that their centres are at ``p ∓ R u`` with one
unit vector u.  The one holds no free place q and the other no contact q, which is ``∓ u·(q - p) ≤ |q - p|² / 2R``.  Where no
unit vector fulfils all of these inequalities, whatever the errors, the premise is refuted.  A contact outside the outer body or
inside the inner one, and a place outside the one and inside the other, refute it as well.  What is not refuted is a premise.

Centres and places are those of a grid.  Distances on it are never less than the true ones.  How far a centre lies from the next
one of the grid, half the diagonal of a cell at most, is allowed for where a centre is excluded, again where a place is within R
of one, and again where a place between the two bodies is far from both.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, cKDTree

import planar
from planar.hidden import SNAPPED
from scan3d.arrays import AT_ONCE, ROUNDING, Array, Index, Mask, evenly, ranges, ratio
from scan3d.bounds.constraints import allowed, exact_error
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.geometry.sections import slice_frame
from scan3d.reconstruction.contacts import with_rows
from scan3d.reconstruction.errors import felt
from scan3d.reconstruction.probings import free_lines
from scan3d.reconstruction.slices import SAME_AXIS, SAME_HEIGHT, planes
from scan3d.recording import Recording, of_rows
from scan3d.units import UNITS_M, length

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
        raise InputError(
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
    if cloud.model == "spatial" or not len(cloud.slice_height):
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
    """(n,) number of the slice."""
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
    known[cloud.row if cloud.recovered is None else cloud.row[~cloud.recovered]] = True
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
    centre = cloud.points.mean(axis=0) * unit
    number = planes(recording, axes[:, 2], centre, recording.noise.place_m).number
    return _Rods(clamp, axes[:, :2], line, number, on, np.where(np.isnan(bulge), alone, bulge))


def passed_lines(recording: Recording, cloud: Cloud) -> Array:
    """(m, 2, 3) lines, in the cloud's unit, that rods of sweeps and of probings lay along; none of rods of unknown shape."""
    lines, swept = free_lines(recording, cloud), cloud.swept()
    if not len(swept) or not recording.rod.is_simple:
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
    rows = np.flatnonzero(place[rods.slice] >= 0)
    along = rods.axes[rows, 1] @ frame[:2].T
    direction = np.round(np.arctan2(along[:, 1], along[:, 0]) / (2 * np.pi) * _DIRECTIONS).astype(int) % _DIRECTIONS
    across = np.arange(int(np.hypot(*shape)) + 2)
    x, y = ((np.arange(n) - (n - 1) / 2) * cell for n in shape)
    for number in np.unique(direction):
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


# Cells in R at least, and cells around the balls.
_COARSEST, _AROUND = 4.0, 3
_EVERY_NEIGHBOUR = np.ones((3, 3, 3), dtype=bool)
# Part of R by which a body may differ from a union of balls: edges of up to 7 degrees, as meshes of smooth bodies have.
_SMOOTH = 0.002
# Contacts at which two balls are sought, evenly over the recording: a hundredth of a second each.
_TESTED = 400


@dataclass(frozen=True)
class Reach:
    """What contacts and free space prove of a body without features finer than R, in the cloud's unit."""

    outer: Any
    """A `trimesh.Trimesh` that contains the body; empty where nothing bounds it."""
    inner: Any
    """A `trimesh.Trimesh` in the body; empty where there is none."""
    bound: float
    """Upper bound of the Hausdorff distance between the surface and that of the body; infinite where nothing bounds it."""
    refuted: str | None
    """What contradicts the premise, in a sentence; None if nothing does."""
    unbounded: str | None
    """Why there is no bound although nothing refutes the premise, in a sentence; None if there is one."""


def reach(recording: Recording, cloud: Cloud, R: float, surface: Any = None) -> Reach:
    """The outer and the inner body of a body without features finer than R, in the cloud's unit, by all slices and probings.

    surface
        a closed `trimesh.Trimesh` that the bound is for; None: any between the two bodies.

    Raises InputError for an R that is no positive number or too fine for the grid, and as `surfaces.any_shape`.
    """
    if not (np.isfinite(R) and R > 0):
        raise InputError(f"the reach must be a positive number, got {R}")
    touched, sheets = cloud.fattened or cloud, list[Sheets]()
    number = np.flatnonzero(~recording.in_probings)
    if len(swept := touched.swept()):
        swept = with_rows(swept, number)
        sheets = sheets_of(of_rows(recording, number), swept, R)
        wrong = np.zeros(len(touched), dtype=bool)
        wrong[np.flatnonzero(~touched.probed) if touched.probed is not None else ...] = contradicted(sheets, swept)
        touched = touched.select(~wrong)
    contacts, errors = touched.points, place_errors(touched) + _SMOOTH * R
    along, aside = _along_lines(recording, cloud, R)
    free = np.concatenate([*(_free_places(sheet) for sheet in sheets), along])
    grid = _Grid.around(contacts, R)
    if grid.step * _COARSEST > R:
        raise InputError(
            f"a reach of {length(R, cloud.unit)} is too fine for a body of this size; it must be at least "
            f"{length(_COARSEST * grid.step, cloud.unit)}"
        )
    error = float(errors.max())
    of_free = max([aside, *(sheet.cell / np.sqrt(2) for sheet in sheets)]) + error
    half = grid.step * np.sqrt(3) / 2
    level = R + half + grid.curvature(R)
    to_contact = grid.distance(contacts)
    to_free = grid.distance(free)
    in_body = to_free >= R - half - of_free
    touching = np.nonzero(in_body & (to_contact <= R + 3 * half + error))
    nearest = cKDTree(contacts).query(grid.origin + grid.step * np.stack(touching, axis=1))[0]
    seeds = np.zeros(grid.shape, dtype=bool)
    seeds[touching] = nearest <= R + half + error
    in_body = joined(in_body, seeds, _EVERY_NEIGHBOUR)
    in_air = joined(to_contact >= R - half - error, grid.border(), _EVERY_NEIGHBOUR)
    to_body, to_air = grid.from_cells(in_body), grid.from_cells(in_air)
    leaks = (to_body <= level) & grid.border()
    # an open surface contains nothing
    outer = _below(np.full(grid.shape, np.inf) if leaks.any() else to_body, level, grid)
    inner = _below(-to_air, -level, grid)
    # those of a body that is grown by the rod's radius leave so much less room to the surroundings
    thick = recording.rod.diameter_m / 2 / UNITS_M[cloud.unit] if cloud.fattened is not None else 0.0
    thinned = np.concatenate([*(_thinned(sheet, R) for sheet in sheets), along])
    lost = _without_balls(contacts, errors, thinned, of_free, R, R - thick)
    against = {
        "contacts lie where no two balls of this radius touch": lost,
        "contacts lie outside the outer body": ~grid.within(in_body, contacts, R + half + errors),
        "contacts lie inside the inner body": ~grid.within(in_air, contacts, R + half + errors),
        "cells are outside the one and inside the other": (to_body > R + half) & (to_air > R + half),
    }
    contradictions = [f"{np.count_nonzero(where)} {what}" for what, where in against.items() if where.any()]
    refuted = unbounded = None
    bound = np.inf
    if contradictions:
        refuted = (
            f"the body has features finer than {length(R, cloud.unit)}, or rods touched at a second place unnoticed: "
            f"{' and '.join(contradictions)}; take a smaller reach"
        )
    elif leaks.any():
        why = ""
        for margin, text in (
            (half + of_free - error, f"contacts and free space that noise moves by up to {length(error, cloud.unit)}"),
            (0.0, f"the cells of {length(grid.step, cloud.unit)} on which bodies and free space are kept"),
        ):
            without = joined(to_free >= R - margin, to_contact <= R + min(margin, half), _EVERY_NEIGHBOUR)
            if not (without & grid.border()).any():
                why = f"{text} leave gaps which are closed without; take more slices, or a smaller reach"
                break
        unbounded = _open(grid, leaks, sheets, touched, R, why)
    elif cloud.fattened is not None:
        unbounded = (
            "the two bodies are those of the body grown by the rod's radius; no bound of the body itself follows"
        )
    elif not (to_air > level).any():
        unbounded = "contacts are too far apart to enclose anything for this reach; take more slices and samples"
    else:
        outside, inside = to_body > level, to_air > level
        # a place that is in both bodies, or in neither, is in a cube of the grid with corners of such a kind: its nearest
        # centre has neighbours, or itself, that are not outside, and such that are not inside
        between = ~(
            ndimage.binary_erosion(outside, _EVERY_NEIGHBOUR, border_value=1)
            | ndimage.binary_erosion(inside, _EVERY_NEIGHBOUR)
        )
        wide = np.maximum(grid.from_cells(outside), grid.from_cells(inside))
        bound = float(wide[between].max(initial=0.0) + half)
        if surface is not None:
            # from each face to the body's surface, which lies between the two, and back from all between the two
            corners = np.asarray(surface.triangles)
            middle = corners.mean(axis=1)
            there = grid.at(wide, middle) + np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
            back = cKDTree(np.concatenate([middle, surface.vertices])).query(grid.centres(between))[0]
            bound = float(max(there.max(), back.max(initial=0.0)) + half)
    return Reach(outer, inner, bound, refuted, unbounded)


def _along_lines(recording: Recording, cloud: Cloud, R: float) -> tuple[Array, float]:
    """(n, 3) places on the lines that rods of probings have passed, a quarter of R apart, and how far rods were from them.

    A rod whose end slides aside is bent by as much as the line to its contact leaves the clamp's axis.
    """
    lines = free_lines(recording, cloud)
    if not len(lines):
        return np.empty((0, 3)), 0.0
    low, high = cloud.points.min(axis=0) - 2 * R, cloud.points.max(axis=0) + 2 * R
    step = lines[:, 1] - lines[:, 0]
    reach = np.linalg.norm(step, axis=1)
    count = np.ceil(4 * reach / R).astype(np.intp) + 1
    line, rank = ranges(count)
    # backwards from the end, which a contact may have
    places = lines[line, 1] - (rank / np.maximum(count - 1, 1)[line])[:, None] * step[line]
    aside = 0.0
    if cloud.probed is not None and cloud.probed.any():
        axes, scale = recording.axes()[cloud.row[cloud.probed]], UNITS_M[cloud.unit]
        offset = cloud.points[cloud.probed] - recording.position_m[cloud.row[cloud.probed]] / scale
        aside = float(np.linalg.norm(np.einsum("nij,nj->ni", axes[:, [0, 2]], offset), axis=1).max())
    return places[((places > low) & (places < high)).all(axis=1)], aside


def _without_balls(points: Array, errors: Array, free: Array, of_free: float, R: float, outside: float) -> Mask:
    """Contacts (n,) at which no ball of radius R without free places (m, 3) touches one of radius `outside` without contacts.

    With the errors e of two places and ``d = q - p`` the unit vector u between the centres has ``±u·d ≤ b`` with
    ``b = |d|²/2R + e_q + (1 + |d|/R) e_p + e_p²/2R``.  The set of all u with these is a polytope that contains 0, so that it
    has a unit vector unless it lies inside the unit ball, which it does if the hull of all ``±d/b`` contains that ball.
    """
    lost = np.zeros(len(points), dtype=bool)
    trees = cKDTree(points), cKDTree(free)
    for k in evenly(np.arange(len(points)), _TESTED):
        rays = [np.vstack([np.eye(3), -np.eye(3)]) / 2]  # so that the hull has an inside
        for tree, size, sign, error in ((trees[0], outside, 1.0, errors), (trees[1], R, -1.0, of_free)):
            if size <= 0:
                continue
            near = np.array(tree.query_ball_point(points[k], 2 * size), dtype=int)
            d = tree.data[near] - points[k]
            long = np.linalg.norm(d, axis=1)
            own, other = errors[k], error[near] if isinstance(error, np.ndarray) else error
            b = long**2 / (2 * size) + other + (1 + long / size) * own + own**2 / (2 * size)
            some = long > b  # shorter rays are in the ball
            rays.append(sign * d[some] / b[some, None])
        hull = ConvexHull(np.concatenate(rays))
        lost[k] = bool((hull.equations[:, 3] < -1 - ROUNDING).all())
    return lost


def _thinned(sheet: Sheets, R: float) -> Array:
    """(n, 3) centres of free cells: all at the border of what is free, and others a tenth of R apart."""
    every = max(int(0.1 * R / sheet.cell), 1)
    chosen = sheet.free & ~ndimage.binary_erosion(sheet.free, _IN_PLANE)
    chosen[:, ::every, ::every] = sheet.free[:, ::every, ::every]
    return _centres(sheet, chosen)


def _open(grid: _Grid, leaks: Mask, sheets: list[Sheets], touched: Cloud, R: float, why: str) -> str:
    """Towards which sides nothing bounds a body, and why, if that is not known already."""
    places = grid.centres(leaks)
    sides = [
        f"{sign}{name}"
        for axis, name in enumerate("xyz")
        for sign, end in (("-", 0), ("+", grid.shape[axis] - 1))
        if np.take(leaks, end, axis=axis).any()
    ]
    # the slices of no axis go past both ends of the body
    filled = touched.slice[touched.slice >= 0]
    ends = [{0, len(sheet.height) - 1} & {*sheet.number[filled].tolist()} for sheet in sheets]
    gap = np.zeros(len(places))
    for sheet in sheets:
        if len(sheet.height) > 1:
            above = np.clip(np.searchsorted(sheet.height, places @ sheet.frame[2]), 1, len(sheet.height) - 1)
            gap = np.maximum(gap, np.diff(sheet.height)[above - 1])
    apart = float(gap.max(initial=0.0))
    if why:
        pass
    elif not sheets:
        why = "probings leave places out; probe in more planes, or take a larger reach"
    elif all(ends):
        why = (
            "no slice without contact lies beyond the body's end; add slices past its ends, or scan along further axes"
        )
    elif apart > 2 * R:
        why = f"slices are {length(apart, touched.unit)} apart, more than twice the reach; take more slices"
    else:
        why = "sweeps leave places out; sweep from more sides, or scan along further axes"
    return f"nothing bounds the body towards {', '.join(sides)}: {why}"


def _free_places(sheet: Sheets) -> Array:
    """(n, 3) the centres of the free cells."""
    return _centres(sheet, sheet.free)


def _centres(sheet: Sheets, cells: Mask) -> Array:
    """(n, 3) the centres of some cells."""
    number, y, x = np.nonzero(cells)
    flat = sheet.origin + sheet.cell * np.stack([x, y], axis=1)
    return flat @ sheet.frame[:2] + sheet.height[number, None] * sheet.frame[2]


@dataclass(frozen=True)
class _Grid:
    """Cubes around contacts."""

    origin: Array
    """(3,) centre of the first cube."""
    step: float
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, points: Array, R: float) -> _Grid:
        low, high = points.min(axis=0) - R, points.max(axis=0) + R
        step = float(np.prod(high - low) / AT_ONCE) ** (1 / 3)
        count = np.ceil((high - low) / step).astype(int) + 2 * _AROUND + 1
        return cls(low - _AROUND * step, step, (int(count[0]), int(count[1]), int(count[2])))

    def border(self) -> Mask:
        border = np.ones(self.shape, dtype=bool)
        border[1:-1, 1:-1, 1:-1] = False
        return border

    def centres(self, cells: Mask) -> Array:
        """(n, 3) the centres of some cells."""
        return np.asarray(self.origin + self.step * np.stack(np.nonzero(cells), axis=1))

    def cells_of(self, points: Array) -> tuple[Index, Mask]:
        """The cells (n, 3) of those points that are in the grid, and which (m,) these are."""
        cells = np.round((points - self.origin) / self.step).astype(int)
        known: Mask = np.all((cells >= 0) & (cells < self.shape), axis=1)
        return cells[known], known

    def distance(self, points: Array) -> Array:
        """Distance of every cell's centre from a point (n, 3) nearby: never less than from the nearest."""
        cells, known = self.cells_of(points)
        flat = np.ravel_multi_index(tuple(cells.T), self.shape)
        chosen = np.full(int(np.prod(self.shape)), -1)
        chosen[flat] = np.flatnonzero(known)
        chosen = chosen.reshape(self.shape)
        nearest = ndimage.distance_transform_edt(chosen < 0, return_distances=False, return_indices=True)
        point = chosen[tuple(nearest)]
        squares = np.zeros(self.shape)
        for axis, n in enumerate(self.shape):
            place = self.origin[axis] + self.step * np.arange(n)
            squares += (place.reshape([-1 if k == axis else 1 for k in range(3)]) - points[:, axis][point]) ** 2
        return np.asarray(np.sqrt(squares))

    def from_cells(self, cells: Mask) -> Array:
        """Distance of every cell's centre from that of the nearest of some cells; infinite if there are none."""
        if not cells.any():
            return np.full(self.shape, np.inf)
        return self.step * ndimage.distance_transform_edt(~cells)

    def curvature(self, R: float) -> float:
        """By how much a surface of distance R, linear along the edges of the cubes, may lie inside that of the true distance.

        A distance d from some centres is concave but for ``|x|²/2d``: along an edge its interpolation exceeds it by step²/8d at
        most, and at a mean of places in one cube, whose mean square from their mean is 3 step²/4 at most, by 3 step²/8d.
        The least d in a cube through which the surface passes is R less half its diagonal.
        """
        return self.step**2 / (2 * (R - self.step * np.sqrt(3) / 2))

    def within(self, cells: Mask, points: Array, most: Array) -> Mask:
        """(n,) whether points (n, 3) are within distances (n,) of the centre of one of some cells, or in one of them."""
        edge = cells & ~ndimage.binary_erosion(cells, _EVERY_NEIGHBOUR)
        if not edge.any():
            return np.zeros(len(points), dtype=bool)
        near = cKDTree(self.centres(edge)).query(points)[0] <= most
        return np.asarray(near | (self.at(cells.astype(float), points) > 0))

    def at(self, values: Array, points: Array) -> Array:
        """The values (n,) of the cells of points (n, 3); -inf for those outside the grid."""
        cells, known = self.cells_of(points)
        found = np.full(len(points), -np.inf)
        found[known] = values[tuple(cells.T)]
        return found


def _below(field: Array, level: float, grid: _Grid) -> Any:
    """The surface of the region below a level, as a `trimesh.Trimesh`, outward; empty where there is none.

    The field has values at the centres of the cells, above the level at the border, and is linear in between.
    """
    import trimesh
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

    image = vtkImageData()
    image.SetDimensions(*field.shape)
    image.SetOrigin(*grid.origin)
    image.SetSpacing(*np.full(3, grid.step))
    image.GetPointData().SetScalars(numpy_to_vtk(np.asarray(field, dtype=float).ravel(order="F"), deep=True))
    contour = vtkFlyingEdges3D()
    contour.SetInputData(image)
    contour.SetValue(0, level)
    contour.ComputeNormalsOff()
    contour.ComputeScalarsOff()
    contour.Update()
    found = contour.GetOutput()
    if not found.GetNumberOfPolys():
        return trimesh.Trimesh()
    vertices = vtk_to_numpy(found.GetPoints().GetData()).astype(float)
    faces = vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return mesh if mesh.volume > 0 else trimesh.Trimesh(vertices, faces[:, ::-1], process=False)
