"""The methods of step 2: from the force and the clamping moment of a rod to the place of its contact.

``closed-form``
    The elastica in closed form (`planar.elastica`) with ``q = m0z / (2 √f)``.  Friction changes the direction of the force,
    which is measured: the contact does not depend on friction otherwise.
``scholz-rahn``
    Numerical integration of (3) with the event ``κ = 0`` (G. R. Scholz, C. D. Rahn, "Profile sensing with an actuated
    whisker", 2004).  Friction invariant as well; the reference, and slow.
``will``
    Equation (10) (C. Will, "Continuum models for biologically inspired tactile sensors", 2018), clipped to 1.  It assumes a
    rod tangential to the force at its contact, which holds for ``μ = 0`` only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy

from planar.arrays import Array, Mask
from planar.elastica import bend, bend_by_half_angle, partial_shape, tangential_q

# Relative and absolute tolerance of the numerical integration.  Larger ones move the contact, smaller ones take more
# steps.
_RTOL, _ATOL = 1e-10, 1e-12
# Arc length, in rod lengths, at which the search for the event ends.  A smaller one reports contacts beyond the tip as
# undefined; a larger one spends time on rods that have no contact.
_LONGEST = 2.0


class Rods(NamedTuple):
    """Rods (n,) as their reactions bend them."""

    alpha: Array
    half_sine: Array
    """sin(α/2)"""
    half_cosine: Array
    """cos(α/2)"""
    q: Array
    """``m0z / (2 √f)``; NaN where the reactions do not belong to a rod."""
    root_f: Array
    """``√f``"""


class RodContacts(NamedTuple):
    """Contacts (n,) on rods, in rod lengths."""

    s1: Array
    x: Array
    """relative to the clamp"""
    y: Array
    undefined: Mask | None
    """where the method does not have a solution; None if it always has one"""


def _closed_form(rods: Rods) -> RodContacts:
    shape, _, _ = bend_by_half_angle(rods.half_sine, rods.half_cosine, rods.q)
    return RodContacts(shape.length / rods.root_f, shape.x / rods.root_f, shape.y / rods.root_f, None)


def _scholz_rahn(rods: Rods) -> RodContacts:
    alpha, q, root_f = rods.alpha, rods.q, rods.root_f
    s1, x, y = np.full((3, len(q)), np.nan)
    for i in np.flatnonzero(np.isfinite(q) & (root_f > 0)):
        s1[i], x[i], y[i] = _integrate(alpha[i], root_f[i] ** 2, 2 * q[i] * root_f[i])
    return RodContacts(s1, x, y, np.isfinite(q) & np.isnan(s1))


def _integrate(alpha: float, f: float, moment: float) -> tuple[float, float, float]:
    """s, x and y of the rod, integrated from its clamp, at the zero of its curvature; NaN if it does not have one."""

    def rod(_: float, state: Array) -> list[float]:  # (3)
        return [np.cos(state[2]), np.sin(state[2]), state[3], f * np.cos(state[2] - alpha)]

    def curvature(_: float, state: Array) -> float:
        return float(state[3])

    curvature.terminal = True  # type: ignore[attr-defined]
    start = [0.0, 0.0, np.pi / 2, -moment]  # (5)
    run = scipy.integrate.solve_ivp(
        rod, (0.0, _LONGEST), start, method="DOP853", events=curvature, rtol=_RTOL, atol=_ATOL
    )
    if not len(run.t_events[0]):
        return np.nan, np.nan, np.nan
    return run.t_events[0][0], run.y_events[0][0][0], run.y_events[0][0][1]


def _will(rods: Rods) -> RodContacts:
    alpha, q, root_f = rods.alpha, rods.q, rods.root_f
    # ERRATUM: (10) as printed has α̃ in its integrand; it stands for α.  The integral is that of a frictionless rod.
    undefined = np.abs(alpha) > np.pi / 2
    frictionless = bend(alpha, np.where(undefined, np.nan, tangential_q(alpha, np.zeros(len(alpha)))))
    s1 = np.minimum(frictionless.length / root_f, 1.0)
    # the point at s1 of the rod that the reactions bend
    shape = bend(alpha, q)
    x, y = partial_shape(alpha, q, shape.length - s1 * root_f)
    return RodContacts(s1, (shape.x - x) / root_f, (shape.y - y) / root_f, undefined)


METHODS: dict[str, Callable[[Rods], RodContacts]] = {
    "closed-form": _closed_form,
    "scholz-rahn": _scholz_rahn,
    "will": _will,
}
