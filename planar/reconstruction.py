"""Step 2: from the support reactions back to the contact.

Force and moment at the clamp fix the bent rod: ``f``, ``α`` and ``κ0`` from (9); the contact is where the curvature
vanishes.  Three methods find it:

``closed-form``
    The elastica in closed form (`planar.elastica`) with ``q = m0z / (2 √f)``.  Friction turns the force, and the force is
    measured: the contact does not depend on it.
``scholz-rahn``
    Numerical integration of (3) with the event ``κ = 0`` (G. R. Scholz, C. D. Rahn, "Profile sensing with an actuated
    whisker", 2004).  Friction invariant as well; the reference, and slow.
``will``
    Equation (10) (C. Will, "Continuum models for biologically inspired tactile sensors", 2018), clipped to 1.  It takes the
    rod for tangential to the force, which holds for ``μ = 0`` only.

Friction and normal come from (12)-(15): ``β = arcsin((m0z² - 2 f0y) / (2 f)) = arcsin(2k² - 1)`` equals the friction angle
``ζ`` in tangential contact (14); in tip contact only ``β < ζ`` follows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from planar.display import some_rows, table_html
from planar.elastica import Array, bend, bend_by_half_angle, partial_shape, tangential_q
from planar.sweeping import Phase

# Differences to the tip, and friction angles below zero, that are rounding: the closed form holds them to some 1e-13.
TOLERANCE = 1e-9
# Rows worked off at once: they and what is computed of them stay in the processor's cache.
_BLOCK = 16384
# Relative and absolute tolerance of the integration, and how far past the tip it looks for the event.
_RTOL, _ATOL, _LONGEST = 1e-10, 1e-12, 2.0


class Status(IntEnum):
    """Why a row of reactions gives a contact or none; `sentence` says it to people."""

    OK = 0
    NO_FORCE = 1
    WRONG_SIDE = 2
    NO_ROD = 3
    INFLECTION = 4
    BEYOND_TIP = 5
    UNDEFINED = 6

    @property
    def sentence(self) -> str:
        return _SENTENCES[self]


_SENTENCES = {
    Status.OK: "a contact",
    Status.NO_FORCE: "nothing touches: there is no force, or a value is missing or infinite",
    Status.WRONG_SIDE: "the clamping moment is that of a rod bent against the sweep; check its sign or the direction",
    Status.NO_ROD: "no rod has these reactions: the moment is more than the force can hold",
    Status.INFLECTION: "the rod would have to be pulled along the contour (a friction angle below 0), or it has an "
    "inflection before its contact",
    Status.BEYOND_TIP: "the contact would lie past the rod's tip",
    Status.UNDEFINED: "equation (10) is undefined here: the force is steeper than the clamp",
}


class NormalSource(IntEnum):
    """Where the normal of a contact comes from."""

    NONE = 0
    TANGENTIAL = 1
    """(14): the rod lies along the contour."""
    FRICTION = 2
    """A friction angle that was given."""


@dataclass(frozen=True)
class Contacts:
    """Contacts (n,) recovered from support reactions, dimensionless; NaN where nothing is known."""

    point: Array
    """(n, 2) contact point."""
    s1: Array
    """(n,) contact along the rod."""
    phase: NDArray[np.int8]
    """(n,) of `planar.Phase`; NONE where the status is not OK."""
    status: NDArray[np.int8]
    """(n,) of `Status`."""
    force: Array
    """(n,) contact force f, in EI/L²."""
    force_angle: Array
    """(n,) its direction α, in radians: the force on the rod is ``f (sin α, -cos α)``."""
    friction_angle_bound: Array
    """(n,) β (12), in radians: equal to ζ in tangential contact, below it in tip contact."""
    slope: Array
    """(n,) slope angle ``α̃ = α - ζ`` of the contour, in radians."""
    normal_source: NDArray[np.int8]
    """(n,) of `NormalSource`."""

    def __len__(self) -> int:
        return len(self.s1)

    def _repr_html_(self) -> str:
        names, rows = ("s1", "force", "slope", "friction"), some_rows(len(self))
        point = dict(zip(("point x", "point y"), self.point[rows].T, strict=True))
        status = {"status": [Status(one).sentence for one in self.status[rows]]}
        columns = {**point, **{name: getattr(self, name)[rows] for name in names}, **status}
        return table_html("Contacts", self.phase, Phase, columns)

    @property
    def friction_angle(self) -> Array:
        """(n,) friction angle ζ (14) in radians; NaN in tip contact, where only ``β < ζ`` is known."""
        return np.where(self.phase == Phase.TANGENTIAL, self.friction_angle_bound, np.nan)

    @property
    def friction(self) -> Array:
        """(n,) coefficient of friction ``μ = tan ζ``; NaN in tip contact."""
        return np.tan(self.friction_angle)

    @property
    def normal(self) -> Array:
        """(n, 2) outward normal of the object, ``(sin α̃, -cos α̃)``."""
        return np.stack([np.sin(self.slope), -np.cos(self.slope)], axis=1)

    @property
    def normal_force(self) -> Array:
        """(n, 2) normal component of the contact force on the rod (15)."""
        return (self.force * np.cos(self.force_angle - self.slope))[:, None] * self.normal

    @property
    def tangential_force(self) -> Array:
        """(n, 2) tangential component of the contact force on the rod (15)."""
        tangent = np.stack([np.cos(self.slope), np.sin(self.slope)], axis=1)
        return (self.force * np.sin(self.force_angle - self.slope))[:, None] * tangent


def reconstruct(
    x0: ArrayLike,
    f0x: ArrayLike,
    f0y: ArrayLike,
    m0z: ArrayLike,
    method: str = "closed-form",
    *,
    friction: ArrayLike | None = None,
    tolerance: float = TOLERANCE,
    direction: int = -1,
) -> Contacts:
    """Contacts from the base positions and support reactions (n,) of a sweep.

    method
        'closed-form', 'scholz-rahn' or 'will'.
    friction
        coefficient of friction, one number or (n,), if known: gives tip contacts their slope and normal too.
    tolerance
        what counts as equal: ``s1 < 1 - tolerance`` is tangential contact, and friction angles down to minus it (in
        radians) are zero.  Under noise give some standard deviations of s1.
    direction
        -1 or 1, the sign of the base's motion along x.

    A row without a contact says why in `status`.  Raises ValueError for arrays of different lengths and for a method,
    friction, tolerance or direction out of range.
    """
    columns = [np.atleast_1d(np.asarray(column, dtype=float)) for column in (x0, f0x, f0y, m0z)]
    if any(column.shape != columns[0].shape or column.ndim != 1 for column in columns):
        raise ValueError(
            f"x0, f0x, f0y and m0z must have one shape (n,), got {', '.join(str(c.shape) for c in columns)}"
        )
    if method not in _METHODS:
        raise ValueError(f"method must be one of {', '.join(_METHODS)}, got {method!r}")
    if direction not in (-1, 1):
        raise ValueError(f"direction must be -1 or 1, the sign of the base's motion, got {direction!r}")
    if not 0 <= tolerance < 1:
        raise ValueError(f"tolerance must lie between 0 and 1, got {tolerance}")
    zeta = None
    if friction is not None:
        zeta = np.arctan(np.asarray(friction, dtype=float))
        if zeta.shape not in ((), columns[0].shape) or not (np.isfinite(zeta).all() and (zeta >= 0).all()):
            raise ValueError("friction must be one number >= 0 or one for each sample")

    count = len(columns[0])
    whole = Contacts(
        point=np.empty((count, 2)),
        s1=np.empty(count),
        phase=np.empty(count, dtype=np.int8),
        status=np.empty(count, dtype=np.int8),
        force=np.empty(count),
        force_angle=np.empty(count),
        friction_angle_bound=np.empty(count),
        slope=np.empty(count),
        normal_source=np.empty(count, dtype=np.int8),
    )
    for first in range(0, count, _BLOCK):
        part = slice(first, first + _BLOCK)
        given = zeta[part] if zeta is not None and zeta.ndim else zeta
        _fill(whole, part, [column[part] for column in columns], method, given, tolerance, -direction)
    return whole


def _fill(
    whole: Contacts,
    part: slice,
    columns: list[Array],
    method: str,
    zeta: Array | None,
    tolerance: float,
    side: int,
) -> None:
    """Reconstruct some rows into the arrays of `whole`."""
    x0, fx, fy, moment = columns
    # a sweep in +x is the mirror image of one in -x
    if side < 0:
        fx, moment = -fx, -moment
    with np.errstate(divide="ignore", invalid="ignore"):
        f, s, c = _polar(fx, fy)
        root_f = np.sqrt(f)
        q = moment / (2 * root_f)
        square = q * q
        m, complement = s * s + square, c * c - square
        beta = 2 * np.arctan2(np.sqrt(m), np.sqrt(complement)) - np.pi / 2  # (12): sin β = 2m - 1
        known = (complement >= 0) & (q > 0)
        rods = _Rods(2 * np.arctan2(s, c), s, c, q if known.all() else np.where(known, q, np.nan), root_f)  # α of (9)
        s1, x, y, undefined = _METHODS[method](rods)
        x = x0 + x if side > 0 else x0 - x

        lying = s1 < 1 - tolerance
        pulled = beta < -tolerance
        pulled &= lying
        if method == "will":
            pulled[:] = False  # (10) errs in s1, so that nothing follows from its s1 < 1
        good = (s1 <= 1 + tolerance) & np.isfinite(x)
        good &= known
        good &= ~pulled
        if undefined is not None:
            good &= ~undefined
    lying &= good
    tip = good & ~lying
    slope = rods.alpha - beta
    if zeta is not None:
        np.copyto(slope, rods.alpha - zeta, where=tip)
    else:
        slope[tip] = np.nan

    whole.point[part, 0], whole.point[part, 1] = x, y
    whole.s1[part], whole.force[part], whole.friction_angle_bound[part] = s1, f, beta
    np.multiply(rods.alpha, side, out=whole.force_angle[part])
    np.multiply(slope, side, out=whole.slope[part])
    whole.phase[part] = Phase.TANGENTIAL * lying.view(np.int8) + Phase.TIP * tip.view(np.int8)
    whole.normal_source[part] = NormalSource.TANGENTIAL * lying.view(np.int8)
    if zeta is not None:
        whole.normal_source[part][tip] = NormalSource.FRICTION
    status = whole.status[part]
    status[:] = Status.OK
    if good.all():
        return
    for mask, code in (
        (good if undefined is None else undefined, Status.UNDEFINED),
        (pulled, Status.INFLECTION),
        (s1 > 1 + tolerance, Status.BEYOND_TIP),
        (complement < 0, Status.NO_ROD),
        (q <= 0, Status.WRONG_SIDE),
        (~(f > 0) | ~np.isfinite(x0 + f + moment), Status.NO_FORCE),
    ):
        status[mask & ~good] = code
    for column in (
        whole.point,
        whole.s1,
        whole.force,
        whole.force_angle,
        whole.friction_angle_bound,
        whole.slope,
    ):
        column[part][~good] = np.nan


def _polar(fx: Array, fy: Array) -> tuple[Array, Array, Array]:
    """Size f of the contact force, sine and cosine of ``α/2``, from ``sin α = -f0x/f`` and ``cos α = f0y/f`` (9).

    By algebra, a tenth of the time of hypot, sin and cos; ``cos α/2 >= 0``.
    """
    across, along = np.abs(fx), np.abs(fy)
    largest = np.maximum(across, along)
    across, along = across / largest, along / largest  # no overflow, no underflow
    size = np.sqrt(across * across + along * along)
    larger = np.sqrt((size + along) / (2 * size))
    smaller = across / (2 * size * larger)
    forward = fy >= 0
    s, c = smaller, larger
    if not forward.all():
        s, c = np.where(forward, smaller, larger), np.where(forward, larger, smaller)
    return largest * size, np.copysign(s, -fx), c


class _Rods(NamedTuple):
    """Rods (n,) as their reactions bend them."""

    alpha: Array
    half_sine: Array
    """sin(α/2)"""
    half_cosine: Array
    q: Array
    """NaN where no rod has the reactions."""
    root_f: Array


# A method returns s1, the contact relative to the clamp, and where it has no answer (None: it always has one).
_Method = Callable[[_Rods], tuple[Array, Array, Array, NDArray[np.bool_] | None]]


def _closed_form(rods: _Rods) -> tuple[Array, Array, Array, None]:
    shape, _, _ = bend_by_half_angle(rods.half_sine, rods.half_cosine, rods.q)
    return shape.length / rods.root_f, shape.x / rods.root_f, shape.y / rods.root_f, None


def _scholz_rahn(rods: _Rods) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    alpha, q, root_f = rods.alpha, rods.q, rods.root_f
    found = np.full((3, len(q)), np.nan)
    for i in np.flatnonzero(np.isfinite(q) & (root_f > 0)):
        found[:, i] = _integrate(alpha[i], root_f[i] ** 2, 2 * q[i] * root_f[i])
    return found[0], found[1], found[2], np.isfinite(q) & np.isnan(found[0])


def _integrate(alpha: float, f: float, moment: float) -> tuple[float, float, float]:
    """s, x and y at which the rod, integrated from its clamp, loses its curvature; NaN if it does not."""

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


def _will(rods: _Rods) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    alpha, q, root_f = rods.alpha, rods.q, rods.root_f
    # ERRATUM: (10) as printed has α̃ in its integrand; it stands for α.  The integral is that of a frictionless rod.
    undefined = np.abs(alpha) > np.pi / 2
    frictionless = bend(alpha, np.where(undefined, np.nan, tangential_q(alpha, np.zeros(len(alpha)))))
    s1 = np.minimum(frictionless.length / root_f, 1.0)
    # the point at s1 of the rod that the reactions bend
    shape = bend(alpha, q)
    x, y = partial_shape(alpha, q, shape.length - s1 * root_f)
    return s1, (shape.x - x) / root_f, (shape.y - y) / root_f, undefined


_METHODS: dict[str, _Method] = {
    "closed-form": _closed_form,
    "scholz-rahn": _scholz_rahn,
    "will": _will,
}
