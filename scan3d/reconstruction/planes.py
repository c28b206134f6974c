"""The slices of a recording: which sweeps lie in one plane, and how far their planes are tilted against it.

A clamp that is turned a little against the planned pose, as a calibration finds it, bends the rod in a plane that is
tilted against the slice.  Contacts lie in their row's own plane, and so do the tangents there: a contact says what
holds at the heights of that plane.  `Tilt` bounds by how much these differ from the height of the slice.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array, Index
from scan3d.cloud import Tilt
from scan3d.recording import Recording

# Slices are parallel if the components of their normals differ by less.  Larger, axes that are slightly inclined to each
# other are merged; smaller, the errors of measured poses split one axis into several.
_SAME_NORMAL = 1e-3
# Slices that are tilted against the table by less, in radians, count as parallel to it.  Larger, heights are more uncertain;
# smaller, the slices of a clamp that is a little off lie along several axes, of which no one bounds the body.
LEVEL = 0.02
# Sweeps lie in one slice if their heights differ by less than this many rod lengths, or than this many times the spread of
# the heights within the median sweep.  Larger, neighbouring slices merge; smaller, the errors of poses split a slice.
SAME_HEIGHT, _SPREADS = 1e-9, 2.0
# Tilted sweeps lie in one slice if their planes meet within this many rod lengths of the middle of the contacts.  Larger,
# neighbouring slices merge; smaller, the sweeps around a body that stands beside the plan's axis split.
_TILTED = 0.2


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

    def tilt_in(self, unit_m: float) -> Tilt | None:
        """The tilt in another unit of length."""
        return None if self.tilt is None else self.tilt.scaled(1 / unit_m)

    def turned(self, contour_normals: Array, normals: Array, rows: Index) -> Array:
        """Normals (k, 3) of contours in the planes of some rows, turned about the contours' tangents into the slices' planes.

        The tangents, seen along the axis, are perpendicular to these normals.
        """
        if self.tilt is None:
            return contour_normals
        inside = np.cross(np.cross(normals[rows], contour_normals), self.axis[self.number[rows]])
        turned: Array = inside / np.linalg.norm(inside, axis=1, keepdims=True)
        return turned


def planes(recording: Recording, normals: Array, centre: Array, digits: float) -> Planes:
    """The slices of a recording whose rows bend the rod in planes with unit normals (n, 3).

    centre
        (3,) a place amid the contacts, in metres, over which the heights of tilted planes are compared.
    digits
        largest error of a contact's place by the digits of the poses, in metres.
    """
    number, axis, height = slices_of(recording, normals)
    slope, length = _slope(normals, axis[number]), recording.rod.length_m
    if slope * length <= digits + SAME_HEIGHT * length:
        return Planes(number, axis, height, None)
    number, axis, height = slices_of(recording, normals, centre, slope * _TILTED * length)
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
    direction = _groups(sweep_normals, _SAME_NORMAL)
    mean = np.stack([np.bincount(direction, column) for column in sweep_normals.T], axis=1)
    axis = (mean / np.linalg.norm(mean, axis=1, keepdims=True))[direction]
    height = _heights(recording, normals, axis[sweep], centre)
    plane = np.bincount(sweep, height) / np.bincount(sweep)
    low, high = np.full(len(plane), np.inf), np.full(len(plane), -np.inf)
    np.minimum.at(low, sweep, height)
    np.maximum.at(high, sweep, height)
    same = max(SAME_HEIGHT * recording.rod.length_m, apart, _SPREADS * float(np.median(high - low)))
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
    heights: Array = axis @ centre + over
    return heights


def _groups(values: Array, same: float) -> NDArray[np.int64]:
    """Number (n,) of each row's group: by gaps in every sorted column, so that equal values are never separated."""
    keys = np.empty(values.shape, dtype=np.int64)
    for key, column in zip(keys.T, values.T, strict=True):
        order = np.argsort(column, kind="stable")
        key[order] = np.cumsum(np.insert(np.diff(column[order]) > same, 0, False))
    return np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
