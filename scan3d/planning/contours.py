"""Slices whose contours the contacts so far do not show closely enough."""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array
from scan3d.cloud import Cloud
from scan3d.surfaces.bounds import slice_enclosure
from scan3d.surfaces.slabs import Gap


def open_contours(cloud: Cloud, tolerance: float) -> tuple[Array, float]:
    """Heights (k,) of the slices whose contours need more contacts, and the largest gap between two contacts of one contour.

    cloud
        contacts of slices along one axis.
    tolerance
        relative to the diagonal: how far the body may reach, in the plane of a slice, beyond the hull of the contacts.

    The gap is in the cloud's unit.  Raises InputError if the contacts span no body.
    """
    bounds = slice_enclosure(cloud)
    diagonal = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    in_plane = (bounds.kind == Gap.CONTACTS) & np.isfinite(bounds.gap)
    wide = in_plane & (bounds.gap > tolerance * diagonal)
    heights, at = bounds.stack.heights, bounds.corners[wide] @ bounds.stack.frame[2]
    nearest = np.abs(at[:, None] - heights).argmin(axis=1)
    return heights[np.unique(nearest)], float(bounds.gap[in_plane].max(initial=0.0))
