"""Approach directions of the sweeps in a slice, and where their samples are taken."""

from __future__ import annotations

import math

import numpy as np

from scan3d.arrays import Array
from scan3d.planning.plan import Plan

# How much denser than evenly a sweep's samples are at its start, and sparser at its end.
CROWDING = 0.45
# Approach directions of a slice to start with; one sweep sees some 100° of its normals, of flat sides less.
FIRST_SWEEPS = 6
# Most approach directions of a slice.
MOST_SWEEPS = 16
# A slice is covered where contacts and their tangents leave less than this share of its width open between them.
OPEN_SHARE = 5e-4
# The slope at which a sweep aimed at a normal meets it: in the middle of what it sees tangentially.
AIMED_SLOPE = math.radians(40)


def base_shares(samples: int) -> Array:
    """Where on the way from touch-down to the sweep's end the samples (n,) are taken.

    Denser at the start, where the contour turns fastest under the rod: so the normals are met about evenly.
    """
    u = np.linspace(0.0, 1.0, samples)
    return u - CROWDING / np.pi * np.sin(np.pi * u)


def first_directions(plan: Plan) -> Array:
    """Approach directions: angles (k,) of the undeformed rod in the slice, in radians."""
    count = plan.sweeps or FIRST_SWEEPS
    return 2 * np.pi * np.arange(count) / count


def further_directions(points: Array, normals: Array, width: float) -> Array:
    """Approach directions (k,) towards what tangential contacts leave open of a slice's contour.

    points (n, 2) with outward normals (n, 2); two neighbours leave open the triangle between their chord and their
    tangents.  None where there is no tangential contact to go by.
    """
    if not len(points):
        return np.empty(0)
    # contacts on one edge have one normal, up to rounding; there their order is that along the edge
    angle = np.round(np.arctan2(normals[:, 1], normals[:, 0]), 9)
    order = np.lexsort((points[:, 1] * np.cos(angle) - points[:, 0] * np.sin(angle), angle))
    points, angle = points[order], angle[order]
    chord = np.roll(points, -1, axis=0) - points
    gap = np.diff(angle, append=angle[0] + 2 * np.pi)
    ahead = angle + gap
    before = np.maximum(-chord[:, 0] * np.cos(angle) - chord[:, 1] * np.sin(angle), 0.0)
    after = np.maximum(chord[:, 0] * np.cos(ahead) + chord[:, 1] * np.sin(ahead), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = np.nan_to_num(before * after / (np.hypot(*chord.T) * np.sin(gap)))
    open_height = np.where(gap >= np.pi, width, height)
    middle = (angle + gap / 2)[open_height > OPEN_SHARE * width]
    # n = (sin α̃, -cos α̃) in the clamp's frame, whose y axis, the rod, stands at the direction sought
    return np.unique(np.round(middle + np.pi - AIMED_SLOPE, 3))
