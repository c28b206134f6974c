"""Which slices without contact prove that the body does not reach them.

At a fixed normal angle a convex body's support function is concave in the height, so that beyond two slices the body's
section lies in the polygon of the secants' extrapolations.  The rods of a slice without contact stay straight: a section that
they would have touched is not there.  If the areas that they sweep cover the polygon, the body does not reach the slice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array, Mask
from scan3d.cloud import Cloud
from scan3d.reconstruction.slices import SAME_AXIS, Slice, SliceStack, stacks
from scan3d.recording import Recording
from scan3d.units import UNITS_M

# Part of the polygon's area that counts as rounding where it is left uncovered.
_ROUNDING = 1e-9
# Side of a square that contains every section that slices bound, in widths of the contacts.
_FAR = 1e3
# Slices next to an end that are built first.  More take longer; if they do not bound the body, all are built.
_NEXT = 3


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
    everything: list[SliceStack] = []
    for i, stack in enumerate(stacks(_ends_of(cloud))):
        empty = np.flatnonzero(~filled & (np.abs(cloud.slice_axis - stack.frame[2]).max(axis=1) < SAME_AXIS))
        for k in empty:
            height = float(cloud.slice_height[k])
            polygon = _section(_from(stack, height), height)
            if polygon is None:
                everything = everything or stacks(cloud)
                polygon = _section(_from(everything[i], height), height)
            areas = _swept(recording, number == k, stack.frame, felt)
            found[k] = polygon is None or not _covered(polygon, areas)
    return found


def _ends_of(cloud: Cloud) -> Cloud:
    """The cloud with contacts in the slices next to the ends of each axis only, which nearly always bound the body there."""
    filled = np.unique(cloud.slice)
    kept = np.zeros(len(cloud.slice_height), dtype=bool)
    for axis in np.unique(np.round(cloud.slice_axis[filled], 9), axis=0):
        along = filled[np.abs(cloud.slice_axis[filled] - axis).max(axis=1) < SAME_AXIS]
        along = along[np.argsort(cloud.slice_height[along])]
        kept[along[:_NEXT]] = kept[along[-_NEXT:]] = True
    return cloud.select(kept[cloud.slice])


def _from(stack: SliceStack, height: float) -> tuple[Slice, ...]:
    """The slices of a stack from the nearest to a height beyond them."""
    return stack.slices if height < stack.heights[0] else stack.slices[::-1]


def _section(slices: tuple[Slice, ...], height: float) -> Array | None:
    """Corners (v, 2) of a polygon that contains the section of the body at a height beyond slices, the nearest one first.

    None if the slices do not bound it, and no corners if the slices prove that there is none.
    """
    for here, behind in zip(slices[:-1], slices[1:], strict=True):
        if not here.closed:
            continue
        normals = np.stack([np.cos(here.angle), np.sin(here.angle)], axis=1)
        secant = (here.value - behind.support_of_contacts(normals)) / (here.height - behind.height)
        middle, size = here.points.mean(axis=0), _FAR * float(np.ptp(here.points, axis=0).max())
        polygon: Array = middle + size * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        for normal, value in zip(normals, here.value + secant * (height - here.height), strict=True):
            polygon = _clipped(polygon, normal, float(value))
        return polygon
    return None


def _swept(recording: Recording, rows: Mask, frame: Array, felt: float) -> list[tuple[Array, Array]]:
    """Rectangles that the straight rods of some rows sweep, as four normals (4, 2) and values (4,) in a slice's frame.

    Their lengths are in the unit of the recording; the sides at which a rod would be bent too little to be felt are left out.
    """
    scale = UNITS_M[recording.unit]
    place, axes = recording.position_m[rows] @ frame[:2].T / scale, recording.axes()[rows]
    length = recording.rod.length_m / scale
    areas = []
    for sweep in np.unique(recording.sweep[rows]):
        of_sweep = recording.sweep[rows] == sweep
        along = axes[of_sweep, 1].mean(axis=0) @ frame[:2].T
        along /= np.linalg.norm(along)
        across = np.array([-along[1], along[0]])
        base, side = place[of_sweep] @ along, place[of_sweep] @ across
        values = base.min() + length, -base.max(), side.max() - felt * length, -(side.min() + felt * length)
        areas.append((np.stack([along, -along, across, -across]), np.array(values)))
    return areas


def _covered(polygon: Array, areas: list[tuple[Array, Array]]) -> bool:
    """Whether areas cover a convex polygon (v, 2), up to rounding."""
    least = _ROUNDING * _area(polygon)
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
    if not len(polygon) or (depth >= 0).all():
        return polygon
    following, its_depth = np.roll(polygon, -1, axis=0), np.roll(depth, -1)
    crosses = (depth >= 0) != (its_depth >= 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = polygon + (depth / (depth - its_depth))[:, None] * (following - polygon)
    # each corner is followed by the crossing of the side that begins there
    candidates = np.stack([polygon, crossing], axis=1).reshape(-1, 2)
    part: Array = candidates[np.stack([depth >= 0, crosses], axis=1).ravel()]
    return part


def _area(polygon: Array) -> float:
    if len(polygon) < 3:
        return 0.0
    (x, y), (u, v) = polygon.T, np.roll(polygon, -1, axis=0).T
    return abs(float((x * v - u * y).sum())) / 2
