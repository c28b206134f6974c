"""Half-spaces that contacts in slices leave of a body, above and below their slices.

A body K lies behind some plane that contains the rod's tangent at a contact p.  With the outward normal w of the tangent in
the slice, and the axis a, that plane is ``<w, x - p> = g <a, x - p>``.  The hull of all contacts, whatever slices they lie in,
lies behind it as well, which confines the slope g to an interval (S27).  Above its slice a contact therefore leaves of K what
lies behind the plane with the largest g, and below it what lies behind that with the smallest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from scan3d.arrays import Array, Index, Mask
from scan3d.cloud import Cloud
from scan3d.reconstruction.slices import SliceStack
from scan3d.surfaces.tangents import tangent_planes

# Cosine of the angle between a slice's normal in its plane and a supporting plane's below which the plane counts as parallel
# to the slice.  Larger, half-spaces of steep sides are left out; smaller, their slopes are rounding.
_PARALLEL = 1e-9


# Error of an exact contact's place, in rod lengths: what solvers and their input leave.  Larger, the bounds of exact contacts
# widen; smaller, they would no longer be certain.
_EXACT = 2e-9


def exact_error(cloud: Cloud) -> float:
    """Largest error of the places of exact contacts, in the cloud's unit."""
    return _EXACT * cloud.rod_length + cloud.pose_error


class HalfSpaces(NamedTuple):
    """Half-spaces ``a·x + b <= 0`` by contacts (n,), below and above their slices."""

    planes: Array
    """(2, n, 4) a, unit vectors, and b; not finite where the slope is not bounded."""
    axis: Index
    """(n,) numbers of the slices' axes."""
    slice: Index
    """(n,) numbers of the slices along their axes, from below."""
    points: Array
    """(n, 3) the contacts."""
    off: float
    """Largest distance of a contact from the plane of its slice."""


def half_spaces(cloud: Cloud, by_axis: Sequence[SliceStack]) -> HalfSpaces:
    """The half-spaces of a cloud of exact contacts in slices along several axes."""
    error = exact_error(cloud)
    across = np.cross(cloud.in_plane_normals, cloud.slice_axis[cloud.slice])
    anywhere = replace(cloud, centre_points=cloud.points, tangents=across, rod_radius=0.0, table=None)
    tangent = tangent_planes(anywhere, np.full(len(cloud), error), np.zeros(len(cloud)))
    of_slice = np.full((len(cloud.slice_height), 2), -1)
    for k, stack in enumerate(by_axis):
        for i, slice_ in enumerate(stack.slices):
            of_slice[cloud.slice[slice_.rows[0]]] = k, i
    rows = tangent.rows
    ends = tangent.planes.ends() @ np.linalg.inv(tangent.shape)
    axis, number = of_slice[cloud.slice[rows]].T
    along = np.array([stack.frame[2] for stack in by_axis])[axis]
    outward, points = cloud.in_plane_normals[rows], cloud.points[rows]
    first = np.cumsum([0, *(len(stack.slices) for stack in by_axis)])
    height = np.concatenate([stack.heights for stack in by_axis])[first[axis] + number]
    off = error + float(np.abs(height - (along * points).sum(axis=1)).max(initial=0.0))
    slopes = _slopes(ends, outward, along)
    for k, stack in enumerate(by_axis):
        for i in range(len(stack.slices)):
            member = np.flatnonzero((axis == k) & (number == i))
            slopes[member] = _narrowed(slopes[member], stack, i, outward[member], points[member], off)
    finite: Mask = np.asarray(np.isfinite(slopes))
    # past an end slice one slope is enough, since the cells on its other side reach beyond its plane
    last = first[axis + 1] - first[axis] - 1
    at_bottom, at_top = (number == 0) & (last > 0), (number == last) & (last > 0)
    usable = finite.all(axis=1) | (finite[:, 0] & at_bottom) | (finite[:, 1] & at_top)
    with np.errstate(invalid="ignore"):
        # a contact that lies off the plane of its slice has the other slope between the two
        out = error + 2 * off * np.where(finite, np.abs(slopes), 0.0).sum(axis=1)
        normals = outward - slopes.T[:, :, None] * along
        at = (outward * points).sum(axis=1) + out - slopes.T * height
        planes = np.concatenate([normals, -at[:, :, None]], axis=2) / np.linalg.norm(normals, axis=2)[:, :, None]
    planes[:, ~usable] = np.nan
    return HalfSpaces(planes, axis, number, points, off)


def _slopes(ends: Array, outward: Array, along: Array) -> Array:
    """Least and largest slopes (n, 2) of planes whose normals are those at the ends (n, 2, 3) of their arcs."""
    ends = ends / np.linalg.norm(ends, axis=2)[:, :, None]
    level, rise = np.einsum("nej,nj->ne", ends, outward), np.einsum("nej,nj->ne", ends, along)
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.sort(np.where(level > _PARALLEL, -rise / level, -np.copysign(np.inf, rise)), axis=1)
    # contacts whose arcs are not known are confined by the slices next to theirs only
    unknown: Mask = np.asarray(np.isnan(ends).any(axis=(1, 2)))
    return np.where(unknown[:, None], [-np.inf, np.inf], slopes)


def _narrowed(slopes: Array, stack: SliceStack, i: int, outward: Array, points: Array, off: float) -> Array:
    """Least and largest slopes (n, 2) of the contacts of slice i, confined by the slices next to it as well.

    The intervals come from a search among the contacts, which may miss the one that confines a slope most.  The errors of
    places and heights are at most `off`.
    """
    found = slopes.copy()
    normals = outward @ stack.frame[:2].T
    value = (outward * points).sum(axis=1) + off
    for j, end, sign in ((i - 1, 1, 1.0), (i + 1, 0, -1.0)):
        if 0 <= j < len(stack.slices):
            rise = value - stack.slices[j].support_of_contacts(normals) + off
            run = abs(stack.slices[j].height - stack.slices[i].height) - 2 * off * np.sign(rise)
            with np.errstate(divide="ignore"):
                secant = sign * np.where(run > 0, rise / run, np.inf)
            found[:, end] = np.minimum(found[:, 1], secant) if end else np.maximum(found[:, 0], secant)
    return np.where((found[:, 0] <= found[:, 1])[:, None], found, slopes)
