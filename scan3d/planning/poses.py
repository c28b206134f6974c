"""Poses of the clamp: the base line of a sweep, and the clamp's positions and axes along it in the world."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scan3d.arrays import Array


class BaseLine(NamedTuple):
    """The line on which the clamp moves in a sweep, in the frame of the slices and in the outline's unit."""

    axes: Array
    """(2, 2) the clamp's x and y axes, as rows: along the sweep, and along the undeformed rod."""
    origin: Array
    """(2,) a point of the line."""


def base_line(outline: Array, angle: float, clearance: float) -> BaseLine:
    """The base line at a given distance from an outline.

    outline (n, 2)
        points of a slice's contour, of the projection of the whole body, or of a box around it.
    angle
        direction of the undeformed rod in the slice, in radians.
    clearance
        distance of the line from the outline, in the outline's unit.
    """
    y = np.array([np.cos(angle), np.sin(angle)])
    x = np.array([y[1], -y[0]])
    # the origin lies below the middle of the outline's box, which keeps the coordinates small
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
    depth = ((outline - middle) @ y).min() - clearance
    return BaseLine(np.stack([x, y]), middle + depth * y)


def positions(line: BaseLine, x0: Array, height: float, frame: Array) -> Array:
    """Positions (n, 3) of the clamp in the world, at the base positions x0 (n,) in the slice at a height.

    The rows of `frame` (3, 3) are the axes of the slices' frame in the world.
    """
    in_slice = line.origin + x0[:, None] * line.axes[0]
    return np.column_stack([in_slice, np.full(len(x0), height)]) @ frame


def clamp_axes(line: BaseLine, frame: Array) -> Array:
    """(3, 3) the clamp's x, y and z axes in the world, as rows."""
    return np.vstack([line.axes @ frame[:2], frame[2]])
