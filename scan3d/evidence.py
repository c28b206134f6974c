"""What slices that were left out say about the methods that make a surface of the others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.cloud import Cloud
from scan3d.comparison import distances
from scan3d.support import SupportFit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Evidence:
    """How far the contacts of slices left out lie from a surface of the others, in the cloud's unit."""

    largest: float
    rms: float


def thinned(cloud: Cloud) -> tuple[Cloud, Array] | None:
    """The cloud without every second slice between the end slices of each axis, and the contacts (n, 3) left out.

    None if fewer than five slices have contacts.  A fit to all contacts is no longer part of it, nor are its normals.
    """
    keep = np.ones(len(cloud.slice_height), dtype=bool)
    filled = np.unique(cloud.slice)
    for axis in np.unique(np.round(cloud.slice_axis[filled], 9), axis=0):
        mine = filled[np.abs(cloud.slice_axis[filled] - axis).max(axis=1) < 1e-8]
        if len(mine) >= 5:
            keep[mine[np.argsort(cloud.slice_height[mine])][1:-1:2]] = False
    if keep.all():
        return None
    rows = keep[cloud.slice]
    per_contact = (
        "points",
        "normals",
        "normal_source",
        "in_plane_normals",
        "phase",
        "sweep",
        "force_N",
        "friction",
    )
    number = np.cumsum(keep) - 1
    rest = replace(
        cloud,
        **{name: getattr(cloud, name)[rows] for name in per_contact},
        slice=number[cloud.slice[rows]].astype(np.int32),
        slice_axis=cloud.slice_axis[keep],
        slice_height=cloud.slice_height[keep],
        fit=None,
        fit_error=np.inf,
    )
    return rest, cloud.points[~rows]


def of_surface(surface: Any, left_out: Array) -> Evidence:
    """The evidence for a surface by contacts (n, 3) it has not seen."""
    return _evidence(distances(left_out, surface))


def of_fit(fitted: SupportFit, left_out: Array, start: Array) -> Evidence:
    """The evidence for a fitted body, without facets, by contacts (n, 3) it has not seen and rough normals (n, 3) of theirs."""
    normals = fitted.normals(left_out, start)
    return _evidence(((left_out - fitted.points(normals)) * normals).sum(axis=1))


def _evidence(off: Array) -> Evidence:
    return Evidence(float(np.abs(off).max()), float(np.sqrt(np.mean(off**2))))
