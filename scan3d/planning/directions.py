"""Approach directions of the sweeps in a slice, and where their samples are taken."""

from __future__ import annotations

import math

import numpy as np

from scan3d.arrays import Array
from scan3d.planning.plan import Plan

# By which fraction a sweep's samples are denser than evenly spaced at its start, and sparser at its end.  Larger, the normals
# met near the end of the sweep have few samples; smaller, those met near its start.
CROWDING = 0.45
# Approach directions with which a slice is begun; one sweep sees some 100° of its normals, less of straight sides.  More
# sweep every slice longer, also where fewer would do; with fewer, the directions of the first round of further sweeps rest on
# few contacts.
FIRST_SWEEPS = 6
# Upper bound of the number of approach directions of a slice.  A larger one spends sweeps on parts of the contour that no
# direction can reach; with a smaller one, corners of a contour with many edges stay open.
MAX_SWEEPS = 16
# A slice is covered where contacts and their tangents leave less than this fraction of its width open between them.  Larger,
# corners stay unseen; smaller, every slice is swept `MAX_SWEEPS` times.
OPEN_FRACTION = 5e-4
# The slope at which a sweep aimed at a normal meets it, in the middle of the slopes that it sees tangentially.  Larger or
# smaller, the contacts lie on one side of the normal, and less of the gap around it is closed.
AIMED_SLOPE = math.radians(40)
# Decimals to which angles in radians are rounded: those of normals, so that contacts on one edge have the same, and those of
# approach directions, so that the poses are short numbers.  More decimals would tell the normals of one edge apart by their
# rounding; with fewer, neighbouring edges would become one, and directions would miss what they are aimed at.
_NORMAL_DECIMALS, _DIRECTION_DECIMALS = 9, 3


def base_fractions(samples: int) -> Array:
    """Where the samples (n,) of a sweep are taken, as fractions of the travel from touch-down to the sweep's end.

    They are denser at the start, where the contour turns fastest under the rod, so that the normals are met about evenly.
    """
    u = np.linspace(0.0, 1.0, samples)
    return u - CROWDING / np.pi * np.sin(np.pi * u)


def first_directions(plan: Plan) -> Array:
    """The approach directions with which a slice is begun: angles (k,) of the undeformed rod in it, in radians."""
    count = plan.sweeps or FIRST_SWEEPS
    return 2 * np.pi * np.arange(count) / count


def further_directions(points: Array, normals: Array, width: float, limit: float | None = None) -> Array:
    """Approach directions (k,), in radians, towards those parts of a slice's contour that tangential contacts leave open.

    points, normals (n, 2)
        contacts and their outward unit normals.  Two neighbouring contacts leave open the triangle between their chord and
        their tangents.
    width
        of the contour, in the unit of the points.
    limit
        height of an open triangle, in the same unit, above which a sweep is aimed at it; by default a part of the width.

    Returns no directions where there are no tangential contacts.
    """
    if not len(points):
        return np.empty(0)
    # contacts on one edge have the same normal, up to rounding; their order is that along the edge
    angle = np.round(np.arctan2(normals[:, 1], normals[:, 0]), _NORMAL_DECIMALS)
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
    limit = OPEN_FRACTION * width if limit is None else limit
    middle = (angle + gap / 2)[open_height > limit]
    # n = (sin α̃, -cos α̃) in the clamp's frame, whose y axis, the undeformed rod, has the direction sought
    return np.unique(np.round(middle + np.pi - AIMED_SLOPE, _DIRECTION_DECIMALS))
