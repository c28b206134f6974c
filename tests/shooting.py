"""The paper's boundary value problems, solved by shooting as in the paper.

For a given base position the rod (3) with the clamp (5) and the conditions of tip (6) or tangential contact (7) is a
two-point boundary value problem.  It is integrated numerically from the clamp, and its unknowns are corrected until the
conditions hold: ``f``, ``κ0`` and the place on the contour, and for tangential contact ``s1``.  L. Merker, J. Steigenberger,
C. Behn, "Friction invariant object reconstruction using a vibrissa-inspired tactile sensor concept", Section II-A.

This module does not use the closed form of `planar.elastica`, so that the two are independent.  The solution that shooting
finds depends on its start: unlike `planar.sweep`, shooting does not distinguish folds, branches or inflections.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from planar.arrays import Array
from planar.contours import SmoothContour
from planar.sweeping import Phase

Place = Callable[[float], tuple[float, Array]]
"""Slope angle and point (2,) of a contour as functions of one path parameter."""

# Relative and absolute tolerance of the integration, and the tolerance of the unknowns.  Larger ones give digits away;
# smaller ones are below rounding, so that the solvers would not end.
_RTOL, _ATOL = 1e-13, 1e-15
_XTOL = 1e-13
# Upper bound of the nodes of a collocation mesh.  Each solution starts from its neighbour's mesh, which is refined but
# never coarsened: a smaller bound ends a sequence of solutions sooner, a larger one lets its time and memory grow.
_MAX_NODES = 20_000
# Residual, in rod lengths, radians and EI/L, up to which the conditions are solved.  A larger one accepts inaccurate
# solutions; a smaller one rejects solutions of stiff rods, whose residual is amplified rounding.
_SOLVED = 1e-9


class Unknowns(NamedTuple):
    """The unknowns of one boundary value problem."""

    f: float
    kappa0: float
    s1: float
    parameter: float


@dataclass(frozen=True)
class ShootingState:
    """One equilibrium of the rod, dimensionless; a start for the next one."""

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
    """Place on the contour: the parameter of the `Place`, the slope angle on smooth contours."""
    slope: float
    point: Array
    """(2,) contact point."""
    f0x: float
    f0y: float
    m0z: float
    residual: float
    """Largest residual of a boundary condition."""
    success: bool


@dataclass(frozen=True)
class Collocation:
    """An equilibrium together with the mesh (n,), s/s1 in [0, 1], and ``x, y, φ, κ`` (4, n) on it: a start for the next."""

    state: ShootingState
    mesh: Array
    values: Array


def integrate(
    x0: ArrayLike, f: ArrayLike, alpha: ArrayLike, kappa0: ArrayLike, s1: ArrayLike, fractions: ArrayLike = (1.0,)
) -> Array:
    """``x, y, φ, κ`` (4, n, k) of rods (n,), integrated (3) from their clamps (5), at rising fractions (k,) of their s1.

    All rods run in one system, each over its own s1, with DOP853 at a relative tolerance of 1e-13.  If a number
    is not finite, or the integration fails, all results are NaN.
    """
    x0, f, alpha, kappa0, s1 = np.broadcast_arrays(
        *(np.atleast_1d(column).astype(float) for column in (x0, f, alpha, kappa0, s1))
    )
    start = np.stack([x0, np.zeros_like(x0), np.full_like(x0, np.pi / 2), kappa0])

    def rods(_: float, values: Array) -> Array:
        return np.asarray(s1 * _derivative(values.reshape(start.shape), f, alpha)).ravel()

    fractions = np.asarray(fractions, dtype=float)
    if not all(np.isfinite(column).all() for column in (f, alpha, s1, start)):
        return np.full((*start.shape, len(fractions)), np.nan)  # solve_ivp would never return
    run = scipy.integrate.solve_ivp(
        rods, (0.0, 1.0), start.ravel(), method="DOP853", t_eval=fractions, rtol=_RTOL, atol=_ATOL
    )
    if not run.success:
        return np.full((*start.shape, len(fractions)), np.nan)
    return np.asarray(run.y).reshape(*start.shape, len(fractions))


def along(contour: SmoothContour) -> Place:
    """Place on a strictly convex contour: the parameter is the slope angle."""
    return lambda slope: (slope, contour.points(np.array([slope]))[0])


def on_edge(start: ArrayLike, end: ArrayLike) -> Place:
    """Place on a polygon's edge between two points (2,), the left one first: the parameter is the fraction of its length."""
    start, move = np.asarray(start, dtype=float), np.subtract(end, start, dtype=float)
    slope = float(np.arctan2(move[1], move[0]))
    return lambda fraction: (slope, start + fraction * move)


def at_vertex(point: ArrayLike) -> Place:
    """Place at a polygon's vertex (2,): the parameter is the slope angle, which turns there."""
    fixed = np.asarray(point, dtype=float)
    return lambda slope: (slope, fixed)


def shoot(place: Place, friction: float, x0: float, phase: Phase, start: ShootingState | ArrayLike) -> ShootingState:
    """Solve (3) with (5) and (6) (tip) or (7) (tangential) by shooting, from a state or from ``f, κ0, s1, parameter``.

    `residual` and `success` tell whether the result is an equilibrium; failure raises no error.
    """
    first, tip = _unknowns(start), _is_tip(phase)

    def residuals(values: Array) -> Array:
        f, kappa0, s1, parameter = _from_solver(values, tip)
        slope, point = place(parameter)
        end = integrate(x0, f, slope + np.arctan(friction), kappa0, s1)[:, 0, 0]
        return _conditions(end, slope, point, tip)

    start_values = [first.f, first.kappa0, first.parameter] if tip else list(first)
    solution = scipy.optimize.root(residuals, start_values, method="hybr", options=dict(xtol=_XTOL))
    return _state(place, friction, x0, phase, _from_solver(solution.x, tip), float(np.abs(solution.fun).max()))


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

    From a `ShootingState` the rod is integrated to start with `nodes` evenly spaced nodes.
    """
    tip = _is_tip(phase)
    if isinstance(start, Collocation):
        first, mesh, values = _unknowns(start.state), start.mesh, start.values
    else:
        first, mesh = _unknowns(start), np.linspace(0.0, 1.0, nodes)
        values = integrate(start.x0, start.f, start.alpha, start.kappa0, start.s1, mesh)[:, 0]

    def rod(_: Array, values: Array, unknowns: Array) -> Array:
        f, s1, parameter = _from_collocation(unknowns, tip)
        alpha = place(parameter)[0] + np.arctan(friction)
        return s1 * _derivative(values, f, alpha)

    def conditions(clamp: Array, end: Array, unknowns: Array) -> Array:
        slope, point = place(_from_collocation(unknowns, tip)[2])
        return np.concatenate([clamp[:3] - [x0, 0.0, np.pi / 2], _conditions(end, slope, point, tip)])

    start_values = [first.f, first.parameter] if tip else [first.f, first.s1, first.parameter]
    solution = scipy.integrate.solve_bvp(rod, conditions, mesh, values, start_values, tol=tol, max_nodes=_MAX_NODES)
    f, s1, parameter = _from_collocation(solution.p, tip)
    residual = np.abs(conditions(solution.y[:, 0], solution.y[:, -1], solution.p)).max() if solution.success else np.inf
    unknowns = Unknowns(f, solution.y[3, 0], s1, parameter)
    state = _state(place, friction, x0, phase, unknowns, float(residual))
    return Collocation(state, solution.x, solution.y)


def _is_tip(phase: Phase) -> bool:
    if phase not in (Phase.TIP, Phase.TANGENTIAL):
        raise ValueError(f"phase must be Phase.TIP or Phase.TANGENTIAL, got {phase!r}")
    return phase == Phase.TIP


def _unknowns(start: ShootingState | ArrayLike) -> Unknowns:
    if isinstance(start, ShootingState):
        return Unknowns(start.f, start.kappa0, start.s1, start.parameter)
    return Unknowns(*np.array(start, dtype=float))


def _from_solver(values: Array, tip: bool) -> Unknowns:
    """The unknowns from the vector of the root finder, which leaves out s1 = 1 in tip contact."""
    return Unknowns(*(np.insert(values, 2, 1.0) if tip else values))


def _from_collocation(unknowns: Array, tip: bool) -> tuple[float, float, float]:
    """f, s1 and parameter from the vector of `solve_bvp`, which leaves out κ0 and, in tip contact, s1 = 1."""
    return (unknowns[0], 1.0, unknowns[1]) if tip else (unknowns[0], unknowns[1], unknowns[2])


def _derivative(values: Array, f: Array | float, alpha: Array | float) -> Array:
    """(3) for ``x, y, φ, κ`` (4, ...)."""
    _, _, phi, kappa = values
    return np.array([np.cos(phi), np.sin(phi), kappa, f * np.cos(phi - alpha)])


def _conditions(end: Array, slope: float, point: Array, tip: bool) -> Array:
    """Residuals of (6) or (7): the place is touched without a moment, and tangentially unless with the tip."""
    x, y, phi, kappa = end
    residuals = [x - point[0], y - point[1], kappa]
    return np.array(residuals if tip else [*residuals, phi - slope])


def _state(
    place: Place, friction: float, x0: float, phase: Phase, solution: Unknowns, residual: float
) -> ShootingState:
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
