"""Sweeps at what no contact supports of a body that is not convex: the widest stretches of the outer contours of its slices.

Between its contacts an outer contour is the border of what the rods have passed.  How far it is from the nearest contact says
how wide a bay may be that no rod has entered (C16).  A rod is sent against such a stretch from either side of its normal, from
so far away that its end, which probes like a finger, passes halfway between the stretch and what may lie behind it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from scan3d.arrays import Array
from scan3d.bounds.free_space import contradicted, outer_contours, sheets_of
from scan3d.cloud import Cloud
from scan3d.planning.plan import BaseLine, base_line
from scan3d.recording import Recording

# Stretches of a slice that are aimed at in one round.
_AT_ONCE = 3
# Angles between the rod and the stretch's normal: a rod that comes along the normal meets the bay's mouth first.
_ASIDE = (-math.radians(30), math.radians(30))


class Aim(NamedTuple):
    """A sweep at a stretch of a slice's outer contour; lengths in the cloud's unit."""

    width: float
    """Distance of the stretch from the nearest contact."""
    axis: Array
    """(3,) of the slice."""
    height: float
    """Of the slice along its axis."""
    angle: float
    """Direction of the undeformed rod in the frame of the slice, in radians."""
    tip: float
    """How far along that direction, from the origin, the end of the undeformed rod goes."""


def aims(recording: Recording, cloud: Cloud) -> list[Aim]:
    """Sweeps at the widest stretches of each slice that are wider than the slices are apart, the widest first.

    cloud
        contacts of the recording.  Raises InputError as `bounds.free_space.sheets_of`.
    """
    touched = cloud.fattened or cloud
    sheets = sheets_of(recording, touched)
    touched = touched.select(~contradicted(sheets, touched))
    found = []
    for sheet in sheets:
        contours = outer_contours([sheet], touched)
        places = contours.points @ sheet.frame.T
        flat, height = places[:, :2], places[:, 2]
        x, y = np.round((flat - sheet.origin) / sheet.cell).astype(int).T
        number = np.abs(height[:, None] - sheet.height).argmin(axis=1)
        depth = sheet.depth
        outward = np.stack(
            [depth[number, y, x + 1] - depth[number, y, x - 1], depth[number, y + 1, x] - depth[number, y - 1, x]],
            axis=1,
        )
        for k, level in enumerate(sheet.height):
            rows = np.flatnonzero((number == k) & (contours.distance > sheet.apart))
            for _ in range(_AT_ONCE):
                if not len(rows):
                    break
                widest = rows[contours.distance[rows].argmax()]
                width = float(contours.distance[widest])
                of_stretch = np.linalg.norm(flat[rows] - flat[widest], axis=1) <= width
                normal = outward[rows[of_stretch]].sum(axis=0)
                for aside in _ASIDE:
                    angle = math.atan2(-normal[1], -normal[0]) + aside
                    along = float(flat[widest] @ (math.cos(angle), math.sin(angle)))
                    found.append(Aim(width, sheet.frame[2], float(level), angle, along + width / 2))
                rows = rows[~of_stretch]
    return sorted(found, key=lambda aim: -aim.width)


def aimed_line(aim: Aim, outline: Array, length: float, nearest: float) -> BaseLine:
    """The base line of a sweep with a rod of a length past an outline (n, 2), from which the line keeps `nearest` at least."""
    along = outline @ (math.cos(aim.angle), math.sin(aim.angle))
    return base_line(outline, aim.angle, max(nearest, float(along.min()) - aim.tip + length))
