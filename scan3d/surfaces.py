"""Closed surfaces from contacts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from scan3d.between import contours_between, shares
from scan3d.bracket import Bracket, bracket
from scan3d.cloud import Cloud
from scan3d.comparison import nearest
from scan3d.errors import InputError
from scan3d.evidence import Evidence, of_fit, of_surface, thinned
from scan3d.hulls import hull
from scan3d.reconstruction import with_slice_normals
from scan3d.support import SupportFit, fit_support

Array = NDArray[np.float64]

METHODS = ("auto", "hull", "bracket", "support", "poisson", "ball-pivoting")
# Subdivisions of the icosahedron in whose directions a fitted body is evaluated: 40,962 points.
_SUBDIVISIONS = 6
# A hull whose certified distance is this small, relative to the diagonal, is the body itself: no guess can better it.
_PROVEN = 5e-5
# Ways to guess where between its bounds the body is, by what is assumed of kinks: None stays with the hull between slices.
_KINKS = (None, 0.7, 1.0)
_GUESSES = {None: "flat between its slices", 0.7: "bent, with some edges", 1.0: "a polyhedron's, with sharp edges"}
# By how much sharp edges have to foretell the slices better than bent ones.
_SHARPER = 0.9
# With all slices the error between them is at most half of that with every second one; a fit's stays.
_GAIN = 0.5


def surface(cloud: Cloud, method: str = "auto", *, found: Bracket | None = None) -> Any:
    """Closed surface of a convex body from its contacts: a `trimesh.Trimesh`, outward, in the cloud's unit.

    method
        'hull': the convex hull of the contacts, never outside the body.
        'bracket': the hull, extended to where between the inner and the outer body the true one most likely lies.
        'support': the support function fitted to the contacts, for smooth bodies.
        'poisson', 'ball-pivoting': open3d's, which do not know that the body is convex; the latter may leave holes.
        'auto': the one of the first three that best foretells slices left out.
    found
        the cloud's `bracket`, if it is known already.

    `metadata` says which `method` it was, and for what `reason`.  Raises InputError for an unknown method, for contacts that
    span no body, for 'support' where the body is not smooth, and where open3d is needed and missing.
    """
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    if method == "support" and cloud.fit is None:
        raise InputError(
            "the body is not smooth enough for the method support, or has too few contacts; use auto, bracket or hull"
        )
    if method == "hull":
        return _named(hull(cloud.points), method, "convex hull of the contacts, as asked for")
    if method in ("poisson", "ball-pivoting"):
        from scan3d import meshing

        build = meshing.poisson if method == "poisson" else meshing.ball_pivoting
        found_by = build(cloud.points, cloud.normals)
        return _named(found_by, method, f"{found_by.metadata['reason']}, as asked for")
    if method == "support":
        assert cloud.fit is not None
        return _named(_of_fit(cloud.fit), method, f"{_degree(cloud.fit)}, as asked for")

    found = found or bracket(cloud)
    diagonal = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    if method == "auto" and found.bound <= _PROVEN * diagonal:
        reason = f"convex hull of the contacts: proven to lie within {found.bound:.2g} {cloud.unit} of the body"
        return _named(found.inner, "hull", reason)
    trial = _trial(cloud, with_fit=method == "auto")
    if trial is None:
        return _named(
            _between(cloud, found, _KINKS[1]), "bracket", "between hull and outer body; too few slices for a trial"
        )
    guesses = {kink: evidence for kink, evidence in trial.items() if kink != "support"}
    # where the trial hardly tells them apart, edges are not sharp: that errs less if it is wrong
    best = min(guesses, key=lambda kink: guesses[kink].rms / (_SHARPER if kink == 1 else 1))
    assert best is None or isinstance(best, float)
    off = f"slices left out on trial lie within {guesses[best].largest:.2g} {cloud.unit}"
    # the largest error is a noisy contact's
    of = "rms" if cloud.noise else "largest"
    if "support" in trial and getattr(trial["support"], of) < _GAIN * getattr(guesses[best], of):
        assert cloud.fit is not None
        smooth = trial["support"].largest
        reason = (
            f"{_degree(cloud.fit)}: the body is smooth, {off.split(' lie')[0]} lie within {smooth:.2g} {cloud.unit}"
        )
        return _named(_of_fit(cloud.fit), "support", reason)
    reason = f"between hull and outer body, as {_GUESSES[best]}: {off}"
    return _named(_between(cloud, found, best), "bracket", reason)


def _trial(cloud: Cloud, *, with_fit: bool) -> dict[float | str | None, Evidence] | None:
    """The evidence of slices left out for each way to guess, and for the fit; None with too few slices."""
    parted = thinned(cloud)
    if parted is None:
        return None
    rest, left_out = parted
    found = bracket(rest)
    trial: dict[float | str | None, Evidence] = {
        kink: of_surface(_between(rest, found, kink), left_out) for kink in _KINKS
    }
    if with_fit and cloud.fit is not None:
        by_slices = with_slice_normals(rest)
        known = np.isfinite(by_slices.normals[:, 0])
        points, normals = rest.points[known], by_slices.normals[known]
        near = cKDTree(points).query(left_out)[1]
        trial["support"] = of_fit(fit_support(points, normals, cloud.fit.degree), left_out, normals[near])
    return trial


def _between(cloud: Cloud, found: Bracket, kink: float | None) -> Any:
    """The hull of the contacts, of points on the way from it to the outer body's corners, and of contours between slices."""
    bounded = np.isfinite(found.corners).all(axis=1) & (found.gap > 0)
    if not bounded.any():
        return found.inner
    _, _, feet = nearest(found.corners[bounded], found.inner)
    away = found.corners[bounded] - feet
    share = shares(found.stack, away, found.slab[bounded], found.flat[bounded], kink)
    points = [cloud.points, feet + share[:, None] * away]
    if kink is not None:
        points.append(contours_between(found.stack))
    return hull(np.concatenate(points))


def _of_fit(fitted: SupportFit) -> Any:
    from trimesh.creation import icosphere

    # spread evenly over the ball-like body behind the fit, so that needles and discs get even facets too
    directions = icosphere(subdivisions=_SUBDIVISIONS).vertices.view(np.ndarray)
    return hull(fitted.points(directions @ np.linalg.inv(fitted.shape)))


def _degree(fitted: SupportFit) -> str:
    return f"support function of degree {fitted.degree}"


def _named(found: Any, method: str, reason: str) -> Any:
    found.metadata.update(method=method, reason=reason)
    return found


def table(surface: Any, bound: Array) -> np.ndarray[Any, np.dtype[np.void]]:
    """Vertices with their normals and the certified local bound (v,) as a structured array, as `files.ply` writes them."""
    names = [(name, "f8") for name in "xyz"] + [(f"n{name}", "f4") for name in "xyz"] + [("bound", "f4")]
    rows = np.empty(len(surface.vertices), dtype=names)
    for columns, values in (
        ("x y z", surface.vertices),
        ("nx ny nz", surface.vertex_normals),
        ("bound", bound[:, None]),
    ):
        for column, value in zip(columns.split(), np.asarray(values).T, strict=True):
            rows[column] = value
    return rows
