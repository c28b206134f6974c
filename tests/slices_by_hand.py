"""Slices of known polygons, and stacks of them, for the tests of bounds."""

import numpy as np

from scan3d.reconstruction.slices import Slice, SliceStack


def slice_of(polygon, height, edges=None):
    """The slice of a counter-clockwise polygon (v, 2) whose vertices are touched and whose edges' normals are known.

    Of a selection of `edges`, only their ends are contacts.
    """
    polygon = np.asarray(polygon, dtype=float)
    following = np.roll(polygon, -1, axis=0)
    along = following - polygon
    selected = np.arange(len(polygon)) if edges is None else np.asarray(edges)
    angle = np.arctan2(-along[selected, 0], along[selected, 1])
    order = np.argsort(angle)
    selected, angle = selected[order], angle[order]
    normals, tangents = (np.stack([np.cos(angle + turn), np.sin(angle + turn)], axis=1) for turn in (0.0, np.pi / 2))
    # counter-clockwise, an edge begins at its right end and ends at its left one, seen along the tangent
    corner = np.stack([polygon[selected], following[selected]], axis=1)
    points = corner.reshape(-1, 2)
    return Slice(
        height=float(height),
        rows=np.arange(len(points)),
        points=points,
        tangential=np.arange(len(points)),
        normals=np.repeat(normals, 2, axis=0),
        tip=np.empty(0, dtype=np.intp),
        tip_normals=np.empty((0, 2)),
        angle=angle,
        value=(corner[:, 0] * normals).sum(axis=1),
        slope=np.stack([(corner[:, end] * tangents).sum(axis=1) for end in (0, 1)]),
        corner=corner,
    )


def square(half):
    """Vertices (4, 2) of a square about the origin."""
    return half * np.array([(-1.0, -1), (1, -1), (1, 1), (-1, 1)])


def stack_of_squares(heights, halves, floor, ceiling):
    slices = tuple(slice_of(square(half), z) for z, half in zip(heights, halves, strict=True))
    return SliceStack(np.eye(3), slices, floor, ceiling)
