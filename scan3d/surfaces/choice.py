"""Closed surfaces from contacts, by a given method or by the one that predicts held-out slices or sweeps best."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import SOME, Array, evenly, ratio
from scan3d.bounds.enclosures import Enclosure, enclosure
from scan3d.choices import METHODS, NOT_CONVEX
from scan3d.cloud import Cloud
from scan3d.errors import InputError, NoBodyError
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import clipped, hull, offset_inwards
from scan3d.geometry.support import SupportFit, fit_support, fitted_body
from scan3d.geometry.triangles import collapsed, distance_of_readers, representatives, without_unused
from scan3d.reconstruction.normals import with_slice_normals
from scan3d.reconstruction.slices import SAME_AXIS
from scan3d.surfaces.any_shape import shape_of_touches, with_estimated_normals
from scan3d.surfaces.estimates import UNKNOWN, Room, between, curved, regression, room, with_edges
from scan3d.units import length

Estimates = dict[str, Callable[[], Any]]
"""Estimates of a surface by what they are, in words."""


def surface(cloud: Cloud, method: str = "auto", *, bounds: Enclosure | None = None) -> Any:
    """Closed surface of a body from its contacts: a `trimesh.Trimesh`, outward, in the cloud's unit.

    method
        'hull': the convex hull of the contacts, never outside the body.
        'bracket': the hull, extended by an estimate of where the true surface lies between the inner and the outer body.
        'support': the support function fitted to the contacts, for smooth bodies.
        'regression': the convex polytope that fits noisy contacts best, weighted by their covariances.
        'poisson', 'ball-pivoting': methods of open3d that do not assume a convex body; ball pivoting may leave holes.
        'auto': whichever of the methods above but the last two predicts held-out slices best; regression only under noise. Of
        touches of a body that is not convex a minimum cut.
    bounds
        the cloud's `enclosure`, if it has been computed already.

    `metadata` has the `method` that was used and the `reason` for it.  Raises InputError for an unknown method, for contacts
    that do not span a body, for 'support' if the body is not smooth, for 'regression' of a recording without noise, for a body
    that is not convex by a method that assumes it, and if open3d is needed but cannot be imported.
    """
    if not isinstance(cloud, Cloud):
        raise InputError(
            f"a surface is made from a scan3d.Cloud, got {type(cloud).__name__}; reconstruct a recording first"
        )
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    if not cloud.convex and method == "auto" and cloud.model == "touches":
        return shape_of_touches(with_estimated_normals(cloud)).surface
    if not cloud.convex and method not in ("hull", *NOT_CONVEX):
        raise InputError(
            f"the method {method} is for convex bodies, and this one is not: choose hull, {' or '.join(NOT_CONVEX)}, or make "
            "the surface through contacts and free space by scan3d.scan or scan3d reconstruct"
        )
    bounds = bounds or (enclosure(cloud) if method in ("auto", "bracket", "regression") else None)
    if cloud.fattened is not None and method not in NOT_CONVEX:
        return _without_rod(cloud, method, bounds)
    cloud = cloud.accurate()
    if method == "support" and cloud.fit is None:
        raise InputError(
            "the body is not smooth enough for the method support, or has too few contacts; use auto, bracket or hull"
        )
    if method == "hull":
        known = cloud.points[np.isfinite(cloud.points).all(axis=1)]
        return _labelled(hull(known), method, "convex hull of the contacts, as requested")
    if method in NOT_CONVEX:
        from scan3d.surfaces import open3d_methods

        build = open3d_methods.poisson if method == "poisson" else open3d_methods.ball_pivoting
        mesh = build(cloud.points, cloud.normals)
        return _labelled(mesh, method, f"{mesh.metadata['reason']}, as requested")
    if method == "support":
        assert cloud.fit is not None
        return _labelled(fitted_body(cloud.fit), method, f"{_degree(cloud.fit)}, as requested")
    assert bounds is not None
    if method == "regression":
        return _regression(cloud, bounds, "as requested")
    return _best(cloud, bounds, with_fit=method == "auto")


def _without_rod(cloud: Cloud, method: str, bounds: Enclosure | None) -> Any:
    """The surface of a body that a thick rod touched: as deep as the rod's radius inside that of the fattened body.

    A smooth body has a fit of its own.
    """
    assert cloud.fattened is not None
    if bounds is not None and bounds.fattened is not None:
        bounds = replace(bounds.fattened, bound=bounds.fattened.bound if np.isfinite(bounds.bound) else np.inf)
    fattened = surface(cloud.fattened, method, bounds=bounds)
    method = fattened.metadata["method"]
    if method == "support" and cloud.fit is not None:
        return _labelled(fitted_body(cloud.fit), method, fattened.metadata["reason"])
    mesh = offset_inwards(fattened, cloud.rod_radius)
    if mesh is None:
        raise NoBodyError(
            f"the contacts of the rod's centre line span a body that is no thicker than the rod, "
            f"{length(2 * cloud.rod_radius, cloud.unit)}; check its diameter"
        )
    return _labelled(mesh, method, f"{fattened.metadata['reason']}; moved inwards by the rod's radius")


def _best(cloud: Cloud, bounds: Enclosure, *, with_fit: bool) -> Any:
    """The estimate between the bounds that predicts held-out contacts best.

    With `with_fit`, the hull is taken if its bound proves it close enough, and the fitted body or the regression if it
    predicts them better.
    """
    diagonal = float(np.linalg.norm(np.ptp(bounds.inner.vertices, axis=0)))
    # a hull with so small a bound is taken as it is
    if with_fit and bounds.bound <= 1e-4 * diagonal:
        confidence = f" with {100 * bounds.confidence:g} % confidence" if bounds.confidence < 1 else ""
        proven = length(bounds.bound, cloud.unit, digits=2, up=True)
        reason = f"convex hull of the contacts: proven to lie within {proven} of the body{confidence}"
        return _labelled(bounds.inner.copy(), "hull", reason)
    if not cloud.in_slices:
        known = np.isfinite(cloud.points + cloud.normals).all(axis=1)
        if not known.any():
            return _labelled(
                hull(cloud.points), "hull", f"convex hull of the {cloud.model}, whose normals are not known"
            )
        cloud = cloud.select(np.flatnonzero(known))
    parts = hold_out(cloud)
    if parts is None:
        return _without_cross_validation(cloud, bounds)
    kept, held_out = parts
    sweeps = {"planar": "slices", "spatial": "sweeps"}.get(cloud.model, cloud.model)

    def lie_within(error: HeldOutError) -> str:
        return f"held-out {sweeps} lie within {length(error.largest, cloud.unit, digits=2)}"

    fit = error_of_fit(cloud.fit, kept, held_out) if with_fit and cloud.fit is not None else None
    has_edges = cloud.fit is None
    of_whole = cache(partial(_estimates, cloud, bounds, has_edges))
    if has_edges and (whole := of_whole()[1]) is not None and whole.facets:
        # held-out slices would say less of them: facets that one of the others has met alone are unknown then
        return _labelled(
            between(whole, UNKNOWN), "bracket", f"a polyhedron of {whole.facets} facets, on which the contacts lie"
        )
    of_kept, _ = _estimates(kept, None, has_edges)
    bent = next(iter(of_kept))
    errors = {bent: error_of_surface(of_kept.pop(bent)(), held_out)}
    # where no normals are seen, a function may have points far out, which the hull of the fitted body shows
    if fit is not None and not cloud.noisy:
        assert cloud.fit is not None
        shown = error_of_surface(fitted_body(cloud.fit), held_out)
        fit = fit if shown.largest <= errors[bent].largest else None
    if fit is not None and not cloud.noisy and fit.judged <= errors[bent].judged:
        # the first estimate is that of bent bodies, and no other is better there
        return _fitted(cloud, lie_within(fit))
    errors |= {name: error_of_surface(make(), held_out) for name, make in of_kept.items()}
    best = min(errors, key=lambda name: errors[name].judged)
    regressed = None
    if with_fit and cloud.noisy:
        with suppress(InputError):  # of so few contacts no planes that span a body can be fitted
            regressed = error_of_surface(regression(kept)[0], held_out)
    # a fit to all contacts is closer as well than that to the kept ones
    least = min(error.judged for error in (errors[best], regressed, fit) if error is not None)
    if fit is not None and fit.judged == least:
        return _fitted(cloud, lie_within(fit))
    if regressed is not None and regressed.judged == least:
        return _regression(cloud, bounds, lie_within(regressed))
    mesh = of_whole()[0][best]()
    if not cloud.in_slices:
        mesh = _inside(bounds, mesh)
    return _labelled(mesh, "bracket", f"{best}: {lie_within(errors[best])}")


def _estimates(cloud: Cloud, bounds: Enclosure | None, has_edges: bool) -> tuple[Estimates, Room | None]:
    """The estimates from a cloud, each of which is computed when it is called, and the room between slices."""
    if not cloud.in_slices:
        return {
            "curved between the contacts": partial(curved, cloud),
            "convex hull of the contacts": partial(hull, cloud.points),
            "a polyhedron's, with sharp edges": partial(with_edges, cloud),
        }, None
    found = room(cloud, bounds, has_edges=has_edges)
    by_slopes = "as far from the contacts' hull as the slopes of neighbouring slices tell"
    return {
        by_slopes: partial(between, found, found.local),
        f"{by_slopes}, and half way from there to the middle": partial(between, found, (found.local + UNKNOWN) / 2),
    }, found


def _without_cross_validation(cloud: Cloud, bounds: Enclosure) -> Any:
    """The estimate where too little is known to hold anything out."""
    if not cloud.in_slices:
        return _labelled(
            hull(cloud.points), "bracket", "convex hull of the contacts; too few sweeps for cross-validation"
        )
    part = f"{100 * UNKNOWN:g} % of the way from the contacts' hull to the corners of the outer body"
    reason = f"{part}; too few slices for cross-validation"
    return _labelled(between(room(cloud, bounds), UNKNOWN), "bracket", reason)


def _fitted(cloud: Cloud, why: str) -> Any:
    """The fitted body, and why it is taken."""
    assert cloud.fit is not None
    return _labelled(fitted_body(cloud.fit), "support", f"{_degree(cloud.fit)}: the body is smooth, {why}")


def _inside(bounds: Enclosure, mesh: Any) -> Any:
    """The part of a convex mesh that lies in the outer body; planes fitted, or tangent at wrong contacts, may meet outside."""
    outer = bounds.outer_planes()
    return hull(clipped(mesh.vertices.view(np.ndarray), outer)) if len(outer) else mesh


def _regression(cloud: Cloud, bounds: Enclosure, why: str) -> Any:
    mesh, planes = regression(cloud)
    mesh = _inside(bounds, mesh)
    return _labelled(mesh, "regression", f"{planes} planes, fitted to the contacts with their uncertainties: {why}")


def _degree(fit: SupportFit) -> str:
    return f"support function of degree {fit.degree}"


def _labelled(mesh: Any, method: str, reason: str) -> Any:
    """The surface as it is given out: no two of its vertices are merged by programs that read its file."""
    import trimesh

    vertices: Array = mesh.vertices.view(np.ndarray)
    # twice the distance: what an export rounds to float32 may come closer by as much
    chosen = representatives(vertices, 2 * distance_of_readers(vertices))
    apart = np.unique(chosen)
    if len(apart) < len(vertices):
        if method in NOT_CONVEX:
            used, faces = without_unused(collapsed(mesh.faces.view(np.ndarray), chosen))
            mesh = trimesh.Trimesh(vertices[used], faces, process=False, metadata=mesh.metadata)
        else:
            mesh = hull(vertices[apart])
    mesh.metadata.update(method=method, reason=reason)
    return mesh


# Slices of an axis, or sweeps in space, that are needed before any is held out.
_FEWEST = 5


class HeldOutError(NamedTuple):
    """Distances of held-out contacts from a surface made from the other contacts, in the cloud's unit."""

    largest: float
    judged: float
    """What counts: the largest, and under noise, where one contact decides that, the rms weighted by the inverse variances
    across the surface, without the part that noise explains."""


def hold_out(cloud: Cloud) -> tuple[Cloud, Cloud] | None:
    """The cloud without some of its slices or sweeps, and the cloud of the contacts there; None if there are too few.

    Every second slice between the end slices of each axis is held out; in space every fourth sweep is.  The kept cloud has no
    fitted support function, since that of the whole cloud was fitted to the held-out contacts as well.
    """
    parts = _slices(cloud) if cloud.in_slices else _sweeps(cloud)
    if parts is None:
        return None
    kept, held_out = parts
    return replace(kept, fit=None), held_out.select(evenly(np.arange(len(held_out)), SOME))


def _sweeps(cloud: Cloud) -> tuple[Cloud, Cloud] | None:
    sweeps, number = np.unique(cloud.sweep, return_inverse=True)
    if len(sweeps) < _FEWEST:
        return None
    held_out = number % 4 == 2
    return cloud.select(evenly(np.flatnonzero(~held_out), SOME)), cloud.select(held_out)


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


def error_of_surface(surface: Any, held_out: Cloud) -> HeldOutError:
    """The error of a convex surface at held-out contacts (n,)."""
    distance, _, foot = nearest(held_out.points, surface)
    # contacts on the surface itself have no direction to it
    return _error(distance, ratio(held_out.points - foot, distance[:, None]), held_out)


def error_of_fit(fit: SupportFit, kept: Cloud, held_out: Cloud) -> HeldOutError:
    """The error at held-out contacts of a support function fitted to those that were kept, of the degree of `fit`.

    Under noise a body with edges may pass for smooth, and be fitted by a function that is no support function: it has points
    far out, which the hull of the fitted body shows.  Exact contacts are compared with the function, which has no facets.
    """
    in_slices = kept.in_slices
    kept = with_slice_normals(kept) if in_slices else kept
    kept = kept.select(np.isfinite(kept.normals[:, 0]))
    sd = kept.sd_along(kept.normals)
    fitted = fit_support(kept.points, kept.normals, fit.degree, sd, kept.table if in_slices else None)
    if held_out.noisy:
        return error_of_surface(fitted_body(fitted), held_out)
    near = cKDTree(kept.points).query(held_out.points)[1]
    normals = fitted.normals(held_out.points, kept.normals[near])
    return _error(((held_out.points - fitted.points(normals)) * normals).sum(axis=1), normals, held_out)


def _error(distance: Array, directions: Array, held_out: Cloud) -> HeldOutError:
    """The error of a surface at (n,) signed distances along directions (n, 3)."""
    largest = float(np.abs(distance).max())
    sd, own = held_out.sd_along(directions), held_out.sd_along(held_out.normals)
    if sd is None or own is None:
        return HeldOutError(largest, largest)
    # at an edge the nearest point lies across another face than the contact's own
    sd = np.fmax(sd, own)
    weight = np.where(np.isfinite(sd), 1 / sd**2, 0.0)
    mean = float((weight * distance**2).sum() / weight.sum())
    rms = float(np.sqrt(max(mean - np.count_nonzero(weight) / weight.sum(), 0.0)))
    return HeldOutError(largest, rms)
