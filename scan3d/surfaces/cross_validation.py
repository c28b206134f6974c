"""Cross-validation: how well a surface made from some of the slices predicts the contacts of the others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.cloud import Cloud
from scan3d.geometry.distance import distances
from scan3d.geometry.support import SupportFit

# Slices with contacts that an axis needs before any of them is held out.  Larger, scans of few slices are not judged by
# cross-validation; smaller, the slices that are kept do not determine a surface.
_FEWEST_SLICES = 5


@dataclass(frozen=True)
class HeldOutError:
    """Distances of held-out contacts from a surface made from the other contacts, in the cloud's unit."""

    largest: float
    rms: float


def hold_out_slices(cloud: Cloud) -> tuple[Cloud, Array] | None:
    """The cloud without every second slice between the end slices of each axis, and the held-out contacts (n, 3).

    None if no axis has five slices with contacts.  The kept cloud has no fitted support function, since that of the whole cloud
    was fitted to the held-out contacts as well.
    """
    keep = np.ones(len(cloud.slice_height), dtype=bool)
    filled = np.unique(cloud.slice)
    for axis in np.unique(np.round(cloud.slice_axis[filled], 9), axis=0):
        along = filled[np.abs(cloud.slice_axis[filled] - axis).max(axis=1) < 1e-8]
        if len(along) >= _FEWEST_SLICES:
            keep[along[np.argsort(cloud.slice_height[along])][1:-1:2]] = False
    if keep.all():
        return None
    rows = keep[cloud.slice]
    number = np.cumsum(keep) - 1
    kept = cloud.select(rows)
    kept = replace(
        kept,
        slice=number[kept.slice].astype(np.int32),
        slice_axis=cloud.slice_axis[keep],
        slice_height=cloud.slice_height[keep],
        unresolved=None if cloud.unresolved is None else cloud.unresolved[keep],
        fit=None,
        fit_error=np.inf,
    )
    return kept, cloud.points[~rows]


def error_of_surface(surface: Any, held_out: Array) -> HeldOutError:
    """The error of a surface at held-out contacts (n, 3)."""
    return _error(distances(held_out, surface))


def error_of_fit(fit: SupportFit, held_out: Array, start: Array) -> HeldOutError:
    """The error of a fitted body, without facets, at held-out contacts (n, 3); `start` (n, 3) are their approximate normals."""
    normals = fit.normals(held_out, start)
    return _error(((held_out - fit.points(normals)) * normals).sum(axis=1))


def _error(deviation: Array) -> HeldOutError:
    return HeldOutError(float(np.abs(deviation).max()), float(np.sqrt(np.mean(deviation**2))))
