"""Cross-validation: how well a surface made from some of the slices or sweeps predicts the contacts of the others."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import Array, evenly
from scan3d.cloud import Cloud
from scan3d.geometry.distance import nearest
from scan3d.geometry.support import SupportFit, fit_support, fitted_body
from scan3d.reconstruction.normals import with_slice_normals
from scan3d.reconstruction.slices import SAME_AXIS

# Slices of an axis, or sweeps in space, that are needed before any is held out.
_FEWEST = 5
# Every how-many-th sweep in space is held out.
_EVERY = 4
# Held-out contacts, and in space kept ones, at most, evenly spread over all.
_MOST = 20_000


class HeldOutError(NamedTuple):
    """Distances of held-out contacts from a surface made from the other contacts, in the cloud's unit."""

    largest: float
    rms: float
    """Of noisy contacts weighted by their inverse variances across the surface, without the part that noise explains."""
    as_held_out: float
    """What counts: the largest, and under noise, where one contact decides that, the rms."""
    expected: float
    """What is to be expected if no contacts are held out: of exact ones the rms over the largest error of each slice or sweep,
    since the one largest of all depends on chance."""


def hold_out(cloud: Cloud) -> tuple[Cloud, Cloud] | None:
    """The cloud without some of its slices or sweeps, and the cloud of the contacts there; None if there are too few.

    Every second slice between the end slices of each axis is held out; in space every fourth sweep is.  The kept cloud has no
    fitted support function, since that of the whole cloud was fitted to the held-out contacts as well.
    """
    parts = _sweeps(cloud) if cloud.model == "spatial" else _slices(cloud)
    if parts is None:
        return None
    kept, held_out = parts
    return replace(kept, fit=None, fit_error=np.inf), held_out.select(evenly(np.arange(len(held_out)), _MOST))


def _sweeps(cloud: Cloud) -> tuple[Cloud, Cloud] | None:
    sweeps, number = np.unique(cloud.sweep, return_inverse=True)
    if len(sweeps) < _FEWEST:
        return None
    held_out = number % _EVERY == _EVERY // 2
    return cloud.select(evenly(np.flatnonzero(~held_out), _MOST)), cloud.select(held_out)


def _slices(cloud: Cloud) -> tuple[Cloud, Cloud] | None:
    keep = np.ones(len(cloud.slice_height), dtype=bool)
    filled = np.unique(cloud.slice)
    for axis in np.unique(np.round(cloud.slice_axis[filled], 9), axis=0):
        along = filled[np.abs(cloud.slice_axis[filled] - axis).max(axis=1) < SAME_AXIS]
        if len(along) >= _FEWEST:
            keep[along[np.argsort(cloud.slice_height[along])][1:-1:2]] = False
    if keep.all():
        return None
    rows, number = keep[cloud.slice], np.cumsum(keep) - 1
    kept = cloud.select(rows)
    kept = replace(
        kept,
        slice=number[kept.slice].astype(np.int32),
        slice_axis=cloud.slice_axis[keep],
        slice_height=cloud.slice_height[keep],
        unresolved=None if cloud.unresolved is None else cloud.unresolved[keep],
    )
    return kept, cloud.select(~rows)


def error_of_surface(surface: Any, held_out: Cloud, falls: Array | float = 1.0) -> HeldOutError:
    """The error of a convex surface at held-out contacts (n,).

    falls
        by which factor the error is expected to fall around each of them when it is held out no more.
    """
    distance, _, foot = nearest(held_out.points, surface)
    with np.errstate(divide="ignore", invalid="ignore"):  # contacts on the surface itself have no direction to it
        return _error(distance, (held_out.points - foot) / distance[:, None], held_out, falls)


def error_of_fit(fit: SupportFit, kept: Cloud, held_out: Cloud) -> HeldOutError:
    """The error at held-out contacts of a support function fitted to those that were kept, of the degree of `fit`.

    Under noise a body with edges may pass for smooth, and be fitted by a function that is no support function: it has points
    far out, which the hull of the fitted body shows.  Exact contacts are compared with the function, which has no facets.
    """
    in_slices = kept.model != "spatial"
    kept = with_slice_normals(kept) if in_slices else kept
    kept = kept.select(np.isfinite(kept.normals[:, 0]))
    sd = kept.sd_along(kept.normals)
    fitted = fit_support(kept.points, kept.normals, fit.degree, sd, kept.table if in_slices else None)
    if held_out.noisy:
        return error_of_surface(fitted_body(fitted), held_out)
    near = cKDTree(kept.points).query(held_out.points)[1]
    normals = fitted.normals(held_out.points, kept.normals[near])
    return _error(((held_out.points - fitted.points(normals)) * normals).sum(axis=1), normals, held_out)


def _error(distance: Array, directions: Array, held_out: Cloud, falls: Array | float = 1.0) -> HeldOutError:
    """The error of a surface at (n,) signed distances along directions (n, 3)."""
    largest = float(np.abs(distance).max())
    sd, own = held_out.sd_along(directions), held_out.sd_along(held_out.normals)
    if sd is None or own is None:
        part = held_out.sweep if held_out.model == "spatial" else held_out.slice
        number = np.unique(part, return_inverse=True)[1]
        of_part = np.zeros(number.max() + 1)
        np.maximum.at(of_part, number, np.abs(falls * distance))
        rms, expected = (float(np.sqrt(np.mean(values**2))) for values in (distance, of_part))
        return HeldOutError(largest, rms, largest, expected)
    # at an edge the nearest point lies across another face than the contact's own
    sd = np.fmax(sd, own)
    weight = np.where(np.isfinite(sd), 1 / sd**2, 0.0)
    mean = float((weight * distance**2).sum() / weight.sum())
    rms = float(np.sqrt(max(mean - np.count_nonzero(weight) / weight.sum(), 0.0)))
    return HeldOutError(largest, rms, rms, rms)  # noise does not fall
