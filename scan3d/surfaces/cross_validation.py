"""Cross-validation: how well a surface made from some of the slices predicts the contacts of the others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.cloud import Cloud
from scan3d.geometry.distance import nearest
from scan3d.geometry.support import SupportFit, fitted_body

# Slices with contacts that an axis needs before any of them is held out.
_FEWEST_SLICES = 5
# Held-out contacts at most, evenly spread over all.
_MOST_HELD_OUT = 20_000
# Weight of the root mean square beside the largest error, as exponents, where estimates from exact contacts are compared.
_RMS = 0.15


@dataclass(frozen=True)
class HeldOutError:
    """Distances of held-out contacts from a surface made from the other contacts, in the cloud's unit."""

    largest: float
    rms: float
    """Of noisy contacts weighted by their inverse variances across the surface, without the part that noise explains."""

    def score(self, noise: float) -> float:
        """What is least for the best estimate: under noise the root mean square, else mainly the largest error."""
        return self.rms if noise else self.largest ** (1 - _RMS) * self.rms**_RMS


def hold_out_slices(cloud: Cloud) -> tuple[Cloud, Cloud] | None:
    """The cloud without every second slice between the end slices of each axis, and the cloud of the contacts there.

    Of very many contacts there a part is taken, evenly spread over all.

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
    held_out = np.flatnonzero(~rows)
    return kept, cloud.select(held_out[:: -(-len(held_out) // _MOST_HELD_OUT)])


def error_of_surface(surface: Any, held_out: Cloud) -> HeldOutError:
    """The error of a convex surface at held-out contacts."""
    distance, _, foot = nearest(held_out.points, surface)
    with np.errstate(divide="ignore", invalid="ignore"):  # contacts on the surface itself have no direction to it
        return _error(distance, (held_out.points - foot) / distance[:, None], held_out)


def error_of_fit(fit: SupportFit, held_out: Cloud, start: Array) -> HeldOutError:
    """The error of a fitted body at held-out contacts (n,); `start` (n, 3) are their approximate normals.

    Under noise a body with edges may pass for smooth, and be fitted by a function that is no support function: it has points
    far out, which the hull of the fitted body shows.  Exact contacts are compared with the function, which has no facets.
    """
    if held_out.noisy:
        return error_of_surface(fitted_body(fit), held_out)
    normals = fit.normals(held_out.points, start)
    return _error(((held_out.points - fit.points(normals)) * normals).sum(axis=1), normals, held_out)


def _error(distance: Array, directions: Array, held_out: Cloud) -> HeldOutError:
    """The error of a surface at (n,) signed distances along directions (n, 3)."""
    largest = float(np.abs(distance).max())
    sd, own = held_out.sd_along(directions), held_out.sd_along(held_out.normals)
    if sd is None or own is None:
        return HeldOutError(largest, float(np.sqrt(np.mean(distance**2))))
    # at an edge the nearest point lies across another face than the contact's own
    sd = np.fmax(sd, own)
    weight = np.where(np.isfinite(sd), 1 / sd**2, 0.0)
    mean = float((weight * distance**2).sum() / weight.sum())
    return HeldOutError(largest, float(np.sqrt(max(mean - np.count_nonzero(weight) / weight.sum(), 0.0))))
