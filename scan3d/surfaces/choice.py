"""Closed surfaces from contacts, by a given method or by the one that predicts held-out slices best."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import Array
from scan3d.bounds.certificates import certificate
from scan3d.bounds.enclosures import Enclosure, enclosure, slice_enclosure
from scan3d.choices import METHODS, NOT_CONVEX
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.geometry.hulls import hull
from scan3d.geometry.merging import (
    collapsed,
    distance_of_readers,
    kept_apart,
    representatives,
    without_unused,
)
from scan3d.geometry.polytopes import clipped
from scan3d.geometry.support import SupportFit, fit_support, fitted_body
from scan3d.reconstruction.normals import with_slice_normals
from scan3d.surfaces.between import Edges, Tuning, between_cells, contours_between, fractions, has_cells
from scan3d.surfaces.cross_validation import HeldOutError, error_of_fit, error_of_surface, hold_out_slices
from scan3d.surfaces.regression import regression
from scan3d.surfaces.spatial_estimates import REGRESSION, best_estimate

# An estimate from contacts anywhere is given up if it is bounded so many times less well than the hull: it lies outside the
# outer body somewhere.
_FAR = 2.0
# In the order in which they are tried: where a function could be fitted, the body most likely is bent everywhere.
_ASSUMED = (Edges.ROUND, Edges.NONE, Edges.SOME, Edges.SHARP)
_DESCRIPTIONS = {
    Edges.NONE: "flat between its slices",
    Edges.SOME: "bent, with some edges",
    Edges.ROUND: "bent everywhere, without edges",
    Edges.SHARP: "a polyhedron's, with sharp edges",
}


def surface(
    cloud: Cloud, method: str = "auto", *, bounds: Enclosure | None = None, tuning: Tuning | None = None
) -> Any:
    """Closed surface of a convex body from its contacts: a `trimesh.Trimesh`, outward, in the cloud's unit.

    method
        'hull': the convex hull of the contacts, never outside the body.
        'bracket': the hull, extended by an estimate of where the true surface lies between the inner and the outer body.
        'support': the support function fitted to the contacts, for smooth bodies.
        'regression': the convex polytope that fits noisy contacts best, weighted by their covariances.
        'poisson', 'ball-pivoting': methods of open3d that do not assume a convex body; ball pivoting may leave holes.
        'auto': whichever of the methods above but the last two predicts held-out slices best; regression only under noise.
    bounds
        the cloud's `enclosure`, if it has been computed already.
    tuning
        numbers of the estimate between the bounds.

    `metadata` has the `method` that was used and the `reason` for it.  Raises InputError for an unknown method, for contacts
    that do not span a body, for 'support' if the body is not smooth,
    for 'regression' of a recording without noise, and if open3d is needed but cannot be imported.
    """
    if not isinstance(cloud, Cloud):
        raise InputError(
            f"a surface is made from a scan3d.Cloud, got {type(cloud).__name__}; reconstruct a recording first"
        )
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    bounds = bounds or (enclosure(cloud) if method in ("auto", "bracket") else None)
    cloud = cloud.accurate()
    if method == "support" and cloud.fit is None:
        raise InputError(
            "the body is not smooth enough for the method support, or has too few contacts; use auto, bracket or hull"
        )
    if method == "hull":
        return _labelled(
            hull(cloud.points[np.isfinite(cloud.points).all(axis=1)]),
            method,
            "convex hull of the contacts, as requested",
        )
    if method in NOT_CONVEX:
        from scan3d.surfaces import open3d_methods

        build = open3d_methods.poisson if method == "poisson" else open3d_methods.ball_pivoting
        mesh = build(cloud.points, cloud.normals)
        return _labelled(mesh, method, f"{mesh.metadata['reason']}, as requested")
    if method == "regression":
        return _regression(cloud, bounds or enclosure(cloud), "as requested")
    if method == "support":
        assert cloud.fit is not None
        return _labelled(fitted_body(cloud.fit), method, f"{_degree(cloud.fit)}, as requested")
    assert bounds is not None
    if bounds.slabs is None:
        return _best_in_space(cloud, bounds, tuning or Tuning(), with_fit=method == "auto")
    return _best(cloud, bounds, tuning or Tuning(), with_fit=method == "auto")


@dataclass(frozen=True)
class _CrossValidation:
    """Errors at held-out slices of the estimates between the bounds, and of fits; None of a fit that was not made."""

    estimates: dict[Edges | float, HeldOutError]
    """Of slices along one axis by what is assumed of the edges, and of those along several by `cell_estimates.FRACTIONS`; none
    if the fit is close, and that of a smooth body only if the fit is better."""
    fit: HeldOutError | None
    regression: HeldOutError | None = None


def _best(cloud: Cloud, bounds: Enclosure, tuning: Tuning, *, with_fit: bool) -> Any:
    """The estimate between the bounds that predicts held-out slices best.

    With `with_fit`, the hull is taken if its bound proves it close enough, and the fitted body if it predicts them better.
    """
    diagonal = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    if with_fit and bounds.bound <= tuning.proven * diagonal:
        return _proven(cloud, bounds)
    proven = bounds
    if bounds.confidence < 1:
        # the estimate is made between the contacts' hull and their half-spaces as they are, not as noise allows them to be
        bounds = slice_enclosure(cloud, margin=0.0)
    by_cells = proven.tighter is not None
    close = tuning.fit_close * proven.bound if np.isfinite(proven.bound) else 0.0
    errors = _cross_validate(cloud, tuning, close, with_fit=with_fit, by_cells=by_cells)
    if errors is None:
        reason = "between hull and outer body; too few slices for cross-validation"
        return _labelled(_between(cloud, bounds, Edges.SOME, tuning), "bracket", reason)
    if not errors.estimates and errors.fit is not None:
        return _fitted(cloud, errors.fit)
    best = _best_of(errors.estimates, cloud.noise, tuning)
    estimate = errors.estimates[best]
    regressed = errors.regression is not None and errors.regression.rms <= estimate.rms
    other = errors.regression if regressed else estimate
    assert other is not None
    gain = _fit_gain(cloud, estimate, tuning, regressed=regressed)
    # under noise the largest error is that of the noisiest contact
    name = "rms" if cloud.noise else "largest"
    if errors.fit is not None and getattr(errors.fit, name) <= gain * getattr(other, name):
        return _fitted(cloud, errors.fit)
    if errors.regression is not None and regressed:
        return _regression(cloud, proven, f"held-out slices lie within {errors.regression.largest:.2g} {cloud.unit}")
    if isinstance(best, Edges):
        mesh, described = _between(cloud, bounds, best, tuning), f"as {_DESCRIPTIONS[best]}"
    else:
        mesh, described = dict(between_cells(cloud, (best,)))[best], f"{100 * best:g} % of the way to its corners"
    reason = f"between hull and outer body, {described}: held-out slices lie within {estimate.largest:.2g} {cloud.unit}"
    return _labelled(mesh, "bracket", reason)


def _fitted(cloud: Cloud, error: HeldOutError, held_out: str = "slices") -> Any:
    """The fitted body, whose error at what was held out is given."""
    assert cloud.fit is not None
    reason = (
        f"{_degree(cloud.fit)}: the body is smooth, held-out {held_out} lie within {error.largest:.2g} {cloud.unit}"
    )
    return _labelled(fitted_body(cloud.fit), "support", reason)


def _best_of(estimates: dict[Edges | float, HeldOutError], noise: float, tuning: Tuning) -> Edges | float:
    """The estimate with the smallest error at held-out slices.

    Where cross-validation hardly distinguishes them, some edges are assumed: if wrong, their error is smaller.
    """
    advantage: dict[Edges | float, float] = {
        Edges.NONE: tuning.flat_advantage,
        Edges.ROUND: tuning.round_advantage,
        Edges.SHARP: tuning.sharp_advantage,
    }
    return min(estimates, key=lambda key: estimates[key].score(noise) / advantage.get(key, 1.0))


def _fit_gain(cloud: Cloud, estimate: HeldOutError, tuning: Tuning, *, regressed: bool) -> float:
    """The fraction of the other's error below which the fitted body is chosen.

    The estimate between the bounds improves with all slices, but not where its error is that of noise, nor does the regression.
    """
    return 1.0 if regressed or cloud.noise > estimate.rms else tuning.fit_gain


def _regression(cloud: Cloud, bounds: Enclosure, reason: str) -> Any:
    mesh, planes = regression(cloud)
    reason = f"{planes} planes, fitted to the contacts with their uncertainties: {reason}"
    return _labelled(_inside(bounds, mesh), "regression", reason)


def _inside(bounds: Enclosure, mesh: Any) -> Any:
    """The part of a convex mesh that lies in the outer body."""
    outer = bounds.outer_planes()
    return hull(clipped(mesh.vertices.view(np.ndarray), outer)) if len(outer) else mesh


def _proven(cloud: Cloud, bounds: Enclosure) -> Any:
    """The inner body, if it is proven close enough to the true one."""
    confidence = f" with {100 * bounds.confidence:g} % confidence" if bounds.confidence < 1 else ""
    reason = (
        f"convex hull of the contacts: proven to lie within {bounds.bound:.2g} {cloud.unit} of the body{confidence}"
    )
    return _labelled(bounds.inner.copy(), "hull", reason)


def _best_in_space(cloud: Cloud, bounds: Enclosure, tuning: Tuning, *, with_fit: bool) -> Any:
    """The estimate from contacts anywhere that predicts those of held-out sweeps best; the arguments are those of `_best`."""
    diagonal = float(np.linalg.norm(np.ptp(bounds.inner.vertices, axis=0)))
    if with_fit and bounds.bound <= tuning.proven * diagonal:
        return _proven(cloud, bounds)
    mesh, description, errors = best_estimate(cloud, with_fit=with_fit)
    regressed = description == REGRESSION
    fit_is_better = (
        errors is not None
        and errors.fit is not None
        and errors.fit.rms <= _fit_gain(cloud, errors.estimate, tuning, regressed=regressed) * errors.estimate.rms
    )
    if errors is not None and errors.fit is not None and fit_is_better:
        return _fitted(cloud, errors.fit, "sweeps")
    if regressed:
        mesh = _inside(bounds, mesh)
    convex = hull(cloud.points)
    if certificate(bounds, mesh, convex=True).bound > _FAR * max(
        certificate(bounds, convex, convex=True).bound, bounds.bound
    ):
        reason = f"convex hull of the contacts, because the estimate, {description}, is bounded much less well"
        return _labelled(convex, "bracket", reason)
    if errors is None:
        reason = f"{description}; too few sweeps for cross-validation"
    else:
        reason = f"{description}: held-out sweeps lie within {errors.estimate.largest:.2g} {cloud.unit}"
    return _labelled(mesh, "regression" if regressed else "bracket", reason)


def _cross_validate(
    cloud: Cloud, tuning: Tuning, close: float, *, with_fit: bool, by_cells: bool
) -> _CrossValidation | None:
    """The errors at held-out slices of surfaces made from the others; None with too few slices.

    close
        error of a fit of exact contacts below which nothing else is tried.
    by_cells
        whether the cells between the slices of several axes bound the body more tightly than the slabs along one.
    """
    parts = hold_out_slices(cloud)
    if parts is None:
        return None
    kept, held_out = parts
    fit = _error_without_slices(cloud, kept, held_out) if with_fit and cloud.fit is not None else None
    if fit is not None and not cloud.noisy and fit.largest <= close:
        return _CrossValidation({}, fit)
    points = _points_between(kept, slice_enclosure(kept, margin=0.0), _ASSUMED, tuning)
    estimates: dict[Edges | float, HeldOutError] = {}
    if fit is not None and not cloud.noisy and not by_cells:
        first = estimates[_ASSUMED[0]] = error_of_surface(hull(next(points)), held_out)
        if fit.largest <= tuning.fit_gain * first.largest:
            return _CrossValidation(estimates, fit)
    for edges, estimate in zip(_ASSUMED[len(estimates) :], map(hull, points), strict=True):
        estimates[edges] = error_of_surface(estimate, held_out)
    # of a bent body, cells that do not bound it more tightly do not show where its surface lies either
    useful = by_cells or _best_of(estimates, cloud.noise, tuning) in (Edges.NONE, Edges.SHARP)
    for fraction, estimate in between_cells(kept) if useful and has_cells(cloud) else ():
        estimates[fraction] = error_of_surface(estimate, held_out)
    regressed = None
    if with_fit and cloud.noisy:
        with suppress(InputError):  # of so few contacts no planes that span a body can be fitted
            regressed = error_of_surface(regression(kept)[0], held_out)
    return _CrossValidation(estimates, fit, regressed)


def _error_without_slices(cloud: Cloud, kept: Cloud, held_out: Cloud) -> HeldOutError:
    """The error at held-out contacts of a function fitted to the contacts that were kept, of the degree of the cloud's."""
    assert cloud.fit is not None
    by_slices = with_slice_normals(kept)
    known = np.isfinite(by_slices.normals[:, 0])
    points, normals = kept.points[known], by_slices.normals[known]
    sd = kept.select(known).sd_along(normals)
    near = cKDTree(points).query(held_out.points)[1]
    return error_of_fit(fit_support(points, normals, cloud.fit.degree, sd, cloud.table), held_out, normals[near])


def _between(cloud: Cloud, bounds: Enclosure, edges: Edges, tuning: Tuning) -> Any:
    """Hull of the contacts, of points between it and the outer body's corners, and of contours between the slices."""
    points = next(_points_between(cloud, bounds, (edges,), tuning))
    # the hull of what its readers would merge would have to be computed again
    return hull(points[kept_apart(points, 2 * distance_of_readers(points))])


def _points_between(cloud: Cloud, bounds: Enclosure, assumed: Sequence[Edges], tuning: Tuning) -> Iterator[Array]:
    """The points (n, 3) of which `_between` is the hull, with several assumptions on the edges, one after another."""
    bounded = np.isfinite(bounds.corners).all(axis=1) & (bounds.gap > 0)
    inner: Array = bounds.inner.vertices.view(np.ndarray)
    if not bounded.any():
        yield from (inner for _ in assumed)
        return
    # the inner body is the hull of the contacts unless it is smaller to allow for errors
    corners = bounds.slabs
    assert corners is not None
    touched = inner if bounds.margin == 0 and bounds.confidence == 1 else cloud.points
    foot = corners.foot[bounded]
    away = bounds.corners[bounded] - foot
    contours: Array | None = None
    by_edges = fractions(corners.stack, away, corners.number[bounded], corners.straight[bounded], assumed, tuning)
    for edges, fraction in zip(assumed, by_edges, strict=True):
        points = [touched, foot + fraction[:, None] * away]
        if edges is not Edges.NONE:
            contours = contours_between(corners.stack, tuning) if contours is None else contours
            points.append(contours)
        yield np.concatenate(points)


def _degree(fit: SupportFit) -> str:
    return f"support function of degree {fit.degree}"


def _labelled(mesh: Any, method: str, reason: str) -> Any:
    """The surface as it is given out: no two of its vertices are merged by programs that read its file."""
    mesh = _readable(mesh, convex=method not in NOT_CONVEX)
    mesh.metadata.update(method=method, reason=reason)
    return mesh


def _readable(mesh: Any, *, convex: bool) -> Any:
    import trimesh

    vertices = mesh.vertices.view(np.ndarray)
    # twice the distance: what an export rounds to float32 may come closer by as much
    chosen = representatives(vertices, 2 * distance_of_readers(vertices))
    apart = np.unique(chosen)
    if len(apart) == len(vertices):
        return mesh
    if convex:
        return hull(vertices[apart])
    used, faces = without_unused(collapsed(mesh.faces.view(np.ndarray), chosen))
    return trimesh.Trimesh(vertices[used], faces, process=False, metadata=mesh.metadata)
