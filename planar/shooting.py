"""The paper's boundary value problems, solved the paper's way: shooting.  Only for tests and benchmarks.

For a given base position the rod (3) with the clamp (5) and the conditions of tip (6) or tangential contact (7) is a
two-point boundary value problem.  It is integrated numerically from the clamp, and its unknowns are corrected until the
conditions hold: ``f``, ``κ0`` and the place on the contour, and for tangential contact ``s1``.  L. Merker, J. Steigenberger,
C. Behn, "Friction invariant object reconstruction using a vibrissa-inspired tactile sensor concept", Section II-A.

Nothing here knows the closed form of `planar.elastica`, so that agreement with it means something.  What shooting finds
depends on where it starts: it has no notion of folds, branches or inflections.  `planar.sweep` has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from planar.contours import SmoothContour
from planar.sweeping import Phase

Array = NDArray[np.float64]
Place = Callable[[float], tuple[float, Array]]
"""Slope angle and point (2,) of a contour as functions of one path parameter."""

# As exact as double precision lets the integration be, and the root with it.
_RTOL, _ATOL = 1e-13, 1e-15
_XTOL = 1e-13
# Meshes are refined, never coarsened: warm starts hand their nodes on.
_MAX_NODES = 20_000
# What counts as solved, in rod lengths, radians and EI/L.
_SOLVED = 1e-9


@dataclass(frozen=True)
class ShootingState:
    """One equilibrium of the rod, dimensionless; its unknowns are the start for the next one."""

    x0: float
    phase: Phase
    f: float
    """Contact force, in EI/L²."""
    alpha: float
    """Its direction (2), in radians."""
    kappa0: float
    """Curvature at the clamp, in 1/L."""
    s1: float
    """Contact along the rod."""
    parameter: float
    """Place on the contour: its slope on smooth contours, else what the `Place` takes."""
    slope: float
    point: Array
    """(2,) contact point."""
    f0x: float
    f0y: float
    m0z: float
    residual: float
    """Largest miss of a boundary condition."""
    success: bool


@dataclass(frozen=True)
class Collocation:
    """An equilibrium together with the mesh (n,), s/s1 in [0, 1], and ``x, y, φ, κ`` (4, n) on it: a start for the next."""

    state: ShootingState
    mesh: Array
    values: Array


def integrate(
    x0: ArrayLike, f: ArrayLike, alpha: ArrayLike, kappa0: ArrayLike, s1: ArrayLike, shares: ArrayLike = (1.0,)
) -> Array:
    """``x, y, φ, κ`` (4, n, k) of rods (n,), integrated (3) from their clamps (5), at rising shares (k,) of their s1.

    All rods run in one system, each over its own s1, with DOP853 at a relative tolerance of 1e-13.  All NaN if some
    numbers are, or run away.
    """
    x0, f, alpha, kappa0, s1 = np.broadcast_arrays(
        *(np.atleast_1d(v).astype(float) for v in (x0, f, alpha, kappa0, s1))
    )
    start = np.stack([x0, np.zeros_like(x0), np.full_like(x0, np.pi / 2), kappa0])

    def rods(_: float, values: Array) -> Array:
        return np.asarray(s1 * _derivative(values.reshape(start.shape), f, alpha)).ravel()

    shares = np.asarray(shares, dtype=float)
    if not all(np.isfinite(v).all() for v in (f, alpha, s1, start)):
        return np.full((*start.shape, len(shares)), np.nan)  # solve_ivp would never return
    run = scipy.integrate.solve_ivp(
        rods, (0.0, 1.0), start.ravel(), method="DOP853", t_eval=shares, rtol=_RTOL, atol=_ATOL
    )
    if not run.success:
        return np.full((*start.shape, len(shares)), np.nan)
    return np.asarray(run.y).reshape(*start.shape, len(shares))


def along(contour: SmoothContour) -> Place:
    """Place on a strictly convex contour: the parameter is the slope angle."""
    return lambda slope: (slope, contour.points(np.array([slope]))[0])


def on_edge(start: ArrayLike, end: ArrayLike) -> Place:
    """Place on a polygon's edge between two points (2,), the left one first: the parameter is the share of it in [0, 1]."""
    start, move = np.asarray(start, dtype=float), np.subtract(end, start, dtype=float)
    slope = float(np.arctan2(move[1], move[0]))
    return lambda share: (slope, start + share * move)


def at_vertex(point: ArrayLike) -> Place:
    """Place at a polygon's vertex (2,): the parameter is the slope angle, which turns there."""
    fixed = np.asarray(point, dtype=float)
    return lambda slope: (slope, fixed)


def shoot(place: Place, friction: float, x0: float, phase: Phase, start: ShootingState | ArrayLike) -> ShootingState:
    """Solve (3) with (5) and (6) (tip) or (7) (tangential) by shooting, from a state or from ``f, κ0, s1, parameter``.

    The residual and `success` say whether that found an equilibrium; nothing raises if it did not.
    """
    guess, tip = _guess(start), _is_tip(phase)

    def miss(unknowns: Array) -> Array:
        f, kappa0, s1, parameter = _spread(unknowns, tip)
        slope, point = place(parameter)
        end = integrate(x0, f, slope + np.arctan(friction), kappa0, s1)[:, 0, 0]
        return _conditions(end, slope, point, tip)

    found = scipy.optimize.root(miss, guess[[0, 1, 3]] if tip else guess, method="hybr", options=dict(xtol=_XTOL))
    return _state(place, friction, x0, phase, _spread(found.x, tip), float(np.abs(found.fun).max()))


def solve_by_collocation(
    place: Place,
    friction: float,
    x0: float,
    phase: Phase,
    start: Collocation | ShootingState,
    *,
    tol: float = 1e-8,
    nodes: int = 11,
) -> Collocation:
    """Solve the same problem by collocation, `scipy.integrate.solve_bvp`, starting from a neighbour's mesh and values.

    From a `ShootingState` the rod is integrated for a start on `nodes` even nodes.
    """
    tip = _is_tip(phase)
    if isinstance(start, Collocation):
        guess, mesh, values = _guess(start.state), start.mesh, start.values
    else:
        guess, mesh = _guess(start), np.linspace(0.0, 1.0, nodes)
        values = integrate(start.x0, start.f, start.alpha, start.kappa0, start.s1, mesh)[:, 0]

    def rod(_: Array, values: Array, unknowns: Array) -> Array:
        f, s1, parameter = _spread_bvp(unknowns, tip)
        alpha = place(parameter)[0] + np.arctan(friction)
        return s1 * _derivative(values, f, alpha)

    def conditions(clamp: Array, end: Array, unknowns: Array) -> Array:
        slope, point = place(_spread_bvp(unknowns, tip)[2])
        return np.concatenate([clamp[:3] - [x0, 0.0, np.pi / 2], _conditions(end, slope, point, tip)])

    unknowns = guess[[0, 3]] if tip else guess[[0, 2, 3]]
    found = scipy.integrate.solve_bvp(rod, conditions, mesh, values, unknowns, tol=tol, max_nodes=_MAX_NODES)
    f, s1, parameter = _spread_bvp(found.p, tip)
    missed = float(
        max(np.abs(conditions(found.y[:, 0], found.y[:, -1], found.p)).max(), 0.0 if found.success else np.inf)
    )
    state = _state(place, friction, x0, phase, np.array([f, found.y[3, 0], s1, parameter]), missed)
    return Collocation(state, found.x, found.y)


def _is_tip(phase: Phase) -> bool:
    if phase not in (Phase.TIP, Phase.TANGENTIAL):
        raise ValueError(f"phase must be Phase.TIP or Phase.TANGENTIAL, got {phase!r}")
    return phase == Phase.TIP


def _guess(start: ShootingState | ArrayLike) -> Array:
    if isinstance(start, ShootingState):
        return np.array([start.f, start.kappa0, start.s1, start.parameter])
    return np.array(start, dtype=float)


def _spread(unknowns: Array, tip: bool) -> Array:
    """``f, κ0, s1, parameter``: at the tip s1 is known."""
    return np.insert(unknowns, 2, 1.0) if tip else unknowns


def _spread_bvp(unknowns: Array, tip: bool) -> tuple[float, float, float]:
    return (unknowns[0], 1.0, unknowns[1]) if tip else (unknowns[0], unknowns[1], unknowns[2])


def _derivative(values: Array, f: Array | float, alpha: Array | float) -> Array:
    """(3) for ``x, y, φ, κ`` (4, ...)."""
    _, _, phi, kappa = values
    return np.array([np.cos(phi), np.sin(phi), kappa, f * np.cos(phi - alpha)])


def _conditions(end: Array, slope: float, point: Array, tip: bool) -> Array:
    """Misses of (6) or (7): the place is touched without a moment, and tangentially if not with the tip."""
    x, y, phi, kappa = end
    misses = [x - point[0], y - point[1], kappa]
    return np.array(misses if tip else [*misses, phi - slope])


def _state(place: Place, friction: float, x0: float, phase: Phase, solution: Array, residual: float) -> ShootingState:
    f, kappa0, s1, parameter = (float(value) for value in solution)
    slope, point = place(parameter)
    alpha = slope + float(np.arctan(friction))
    return ShootingState(
        x0=float(x0),
        phase=phase,
        f=f,
        alpha=alpha,
        kappa0=kappa0,
        s1=s1,
        parameter=parameter,
        slope=slope,
        point=point,
        f0x=-f * np.sin(alpha),  # (8)
        f0y=f * np.cos(alpha),
        m0z=-kappa0,
        residual=residual,
        success=residual <= _SOLVED,
    )
