"""Estimates of the surface in the cells between slices along several axes.

The surface lies between the hull of the contacts and the corners of what is left of the cells.  Of a polyhedron it reaches
the corners; of a body that is bent evenly between its slices it passes at a quarter of the way, as a parabola does between the
chord and the place where the secants from both sides meet.  Which fraction predicts held-out slices best is tried.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from scan3d.bounds.cells import applicable, cells_of_cloud
from scan3d.cloud import Cloud
from scan3d.geometry.hulls import hull
from scan3d.reconstruction.slices import stacks

FRACTIONS = (0.25, 0.4, 0.7, 1.0)
"""Fractions of the way from the hull of the contacts to the corners.  More take longer; fewer fit fewer bodies."""
# Gaps, over the size of the body, that are left out.  Larger, corners that matter are; smaller, the hull has needless vertices.
_LEAST = 1e-7


def has_cells(cloud: Cloud) -> bool:
    """Whether a cloud has `between_cells`; a part of its slices may have them where all are too many."""
    return applicable(cloud, stacks(cloud))


def between_cells(cloud: Cloud, tried: Iterable[float] = FRACTIONS) -> Iterator[tuple[float, Any]]:
    """Fractions and their estimates; none unless the contacts are exact and in slices along several axes."""
    by_axis = stacks(cloud)
    if not applicable(cloud, by_axis):
        return
    inner = hull(cloud.points)
    found = cells_of_cloud(cloud, by_axis, inner)
    size = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    rows = np.isfinite(found.gap) & (found.gap > _LEAST * size)
    away = found.corners[rows] - found.foot[rows]
    for fraction in tried:
        yield fraction, hull(np.concatenate([cloud.points, found.foot[rows] + fraction * away]))
