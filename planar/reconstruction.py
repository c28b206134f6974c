"""Step 2: from the support reactions back to the contact.

Force and moment at the clamp fix the bent rod: ``f``, ``α`` and ``κ0`` from (9); the contact is where the curvature
vanishes.  The methods that find it are those of `planar.rods`.

Friction and normal come from (12)-(15): ``β = arcsin((m0z² - 2 f0y) / (2 f)) = arcsin(2k² - 1)`` equals the friction angle
``ζ`` in tangential contact (14); in tip contact only ``β < ζ`` follows.

How errors of the support reactions carry over to the contact: the derivatives of the closed form.

With ``q = m0z / (2 √f)`` and the shape of the rod in units of ``1/√f`` (`planar.elastica`), place and arc length of the
contact are products of a function of ``α`` and ``q`` with ``1/√f``; ``α``, ``f`` and ``q`` follow from the reactions by (9),
``β`` by (12).
Errors of the place grow as ``1/f`` near touch-down, where the place is a quotient of a small moment and a small force.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planar import plots
from planar.arrays import (
    BLOCK,
    NAMES,
    Array,
    Mask,
    Reactions,
    check_direction,
    checked_friction,
    checked_reactions,
    finite,
)
from planar.elastica import bend, bend_with_slopes, piece
from planar.plots import Explained, Shown, counted, to_frame, words
from planar.rods import METHODS, Rod, Solved, as_rod, shapes, solve
from planar.sweeping import Phase

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes


TOLERANCE = 1e-9
"""Differences to the tip, in rod lengths, and friction angles below zero, in radians, that count as rounding; the closed form
is exact to some 1e-13."""


class Status(Explained):
    """Whether a row of reactions gives a contact, and if not, why; `sentence` explains it."""

    OK = 0, "a contact"
    NO_FORCE = 1, "nothing touches: there is no force, or a value is missing or infinite"
    WRONG_SIDE = 2, "the clamping moment is that of a rod bent against the sweep; check its sign or the direction"
    NO_ROD = (
        3,
        "no rod has these reactions: the moment is more than the force can hold; of a rod that is not straight and uniform, "
        "also if the contact would lie more than half a rod past the tip",
    )
    INFLECTION = (
        4,
        "the rod would have to be pulled along the contour (a friction angle below 0), or it has an "
        "inflection before its contact",
    )
    BEYOND_TIP = 5, "the contact would lie past the rod's tip"
    UNDEFINED = 6, "equation (10) is undefined here: the force is steeper than the clamp"
    SECOND_CONTACT = 7, "the rod touches at a second place, so that its reactions give neither of the two"


class NormalSource(IntEnum):
    """Where the normal of a contact comes from."""

    NONE = 0
    TANGENTIAL = 1
    """(14): the contact is tangential."""
    FRICTION = 2
    """The coefficient of friction was given."""


# What is not known where there is no contact.
_VALUES = ("point", "s1", "force", "force_angle", "friction_angle_bound", "slope")
_COLUMNS = ("s1", "force", "force_angle", "friction_angle_bound", "friction_angle", "friction", "slope")


@dataclass(frozen=True, eq=False, repr=False)
class Contacts(Shown):
    """Contacts (n,) recovered from support reactions, dimensionless; NaN where a value is unknown.

    point
        (n, 2) contact point, in rod lengths.
    s1
        (n,) contact along the rod, in rod lengths from the clamp.
    phase
        (n,) of `planar.Phase`; NONE where the status is not OK.
    status
        (n,) of `Status`.
    force
        (n,) contact force f, in EI/L².
    force_angle
        (n,) its direction α, in radians: the force on the rod is ``f (sin α, -cos α)``.
    friction_angle_bound
        (n,) β (12), in radians: equal to ζ in tangential contact, below it in tip contact.
    slope
        (n,) slope angle ``α̃ = α - ζ`` of the contour, in radians.
    normal_source
        (n,) of `NormalSource`.
    """

    point: Array
    s1: Array
    phase: NDArray[np.int8]
    status: NDArray[np.int8]
    force: Array
    force_angle: Array
    friction_angle_bound: Array
    slope: Array
    normal_source: NDArray[np.int8]

    def refused(self, rows: Mask, status: Status) -> Contacts:
        """The contacts but those in some rows (n,), which have another status instead and are none."""
        none = dict.fromkeys(_VALUES, np.nan) | {
            "phase": Phase.NONE,
            "normal_source": NormalSource.NONE,
            "status": status,
        }
        columns = {name: getattr(self, name).copy() for name in none}
        for name, value in none.items():
            columns[name][rows] = value
        return replace(self, **columns)

    def within(self, tolerance: ArrayLike, friction: ArrayLike | None = None, *, direction: int = -1) -> Contacts:
        """These contacts with a smaller tolerance than that with which they were found, or with friction, as `reconstruct` has
        them of the same reactions by the closed form."""
        zeta = None if friction is None else np.arctan(friction)
        return _within(self, np.asarray(tolerance, dtype=float), zeta, -direction)

    def __len__(self) -> int:
        return len(self.s1)

    def __repr__(self) -> str:
        return counted("Contacts", self.phase, Phase)

    def plot(
        self,
        *columns: str,
        over: ArrayLike | None = None,
        axes: Axes | ArrayLike | None = None,
        **style: Any,
    ) -> Any:
        """The contact points in the plane, those at the tip hollow; or curves of columns over the base positions `over` (n,).

        axes
            matplotlib's axes, one for each column; by default new ones.
        style
            that of `matplotlib.axes.Axes.plot`, such as ``color`` or ``label``.

        Returns the axes, those of columns (len(columns),).  Raises ValueError for another number of axes or of base positions
        and for unknown columns.
        """
        if not columns:
            tip, tangential = self.phase == Phase.TIP, self.phase == Phase.TANGENTIAL
            return plots.plot_points(self.point, tip, tangential, axes, style)
        return plots.plot_columns(plots.named(self, columns, _COLUMNS), over, self.phase, axes, style)

    def to_pandas(self) -> pandas.DataFrame:
        """A data frame with a row for each sample.  Raises ImportError without pandas."""
        place = dict(zip(("x", "y", "nx", "ny"), [*self.point.T, *self.normal.T], strict=True))
        codes = {
            "phase": words(self.phase, Phase),
            "status": words(self.status, Status),
            "normal_source": words(self.normal_source, NormalSource),
        }
        return to_frame({**place, **plots.named(self, _COLUMNS, _COLUMNS), **codes})

    @property
    def friction_angle(self) -> Array:
        """(n,) friction angle ζ (14) in radians; NaN in tip contact, where only ``β < ζ`` is known."""
        return np.where(self.phase == Phase.TANGENTIAL, self.friction_angle_bound, np.nan)

    @property
    def friction(self) -> Array:
        """(n,) coefficient of friction ``μ = tan ζ``; NaN in tip contact."""
        return np.asarray(np.tan(self.friction_angle))

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
        return np.asarray((self.force * np.sin(self.force_angle - self.slope))[:, None] * tangent)


def reconstruct(
    x0: ArrayLike,
    f0x: ArrayLike,
    f0y: ArrayLike,
    m0z: ArrayLike,
    method: str = "closed-form",
    *,
    friction: ArrayLike | None = None,
    tolerance: ArrayLike = TOLERANCE,
    direction: int = -1,
    rod: Rod | None = None,
) -> Contacts:
    """Contacts from the base positions and support reactions (n,) of a sweep.

    method
        'closed-form', 'scholz-rahn' or 'will'.
    friction
        coefficient of friction, one number or (n,), if known: tip contacts have a slope and a normal only if it is given.
    tolerance
        differences that count as zero, one number or (n,): ``s1 < 1 - tolerance`` is tangential contact, and friction angles
        down to ``-tolerance`` (in radians) are admissible.  For noisy reactions give some standard deviations of s1 and of the
        friction angle, by `planar.jacobian`.
    direction
        -1 or 1, the sign of the base's motion along x.
    rod
        None: straight, uniform and weightless.  With a weight the reactions are the whole ones; add `planar.free_reactions`
        to those of a sensor that was tared in the air.

    `status` says why a row has no contact.  Raises ValueError for arrays of different lengths and for a method,
    friction, tolerance or direction out of range.
    """
    reactions = checked_reactions(x0, f0x, f0y, m0z)
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    check_direction(direction)
    zero = np.asarray(tolerance, dtype=float)
    if zero.shape not in ((), reactions.x0.shape) or not ((zero >= 0) & (zero < 1)).all():
        given = f"an array of the shape {zero.shape}" if zero.ndim else f"{zero}"
        raise ValueError(f"tolerance must lie between 0 and 1, got {given}")
    rod = as_rod(rod)
    if rod.down.shape not in ((2,), (len(reactions.x0), 2)):
        raise ValueError(f"gravity must have one direction, or one for each row, got {len(rod.down)}")
    if method == "will" and not rod.is_straight_and_uniform:
        raise ValueError("method 'will' is for straight, uniform, weightless rods; use 'closed-form', which takes any")
    zeta = None if friction is None else np.arctan(checked_friction(friction, len(reactions.x0)))

    parts = []
    for first in range(0, max(len(reactions.x0), 1), BLOCK):
        rows = slice(first, first + BLOCK)
        block = Reactions(*(column[rows] for column in reactions))
        angle = zeta[rows] if zeta is not None and zeta.ndim else zeta
        # a sweep in +x is the mirror image of a sweep in -x
        here = rod.rows(rows) if direction < 0 else rod.rows(rows).mirrored()
        with np.errstate(divide="ignore", invalid="ignore"):
            solved = solve(method, here, -direction * block.f0x, block.f0y, -direction * block.m0z)
        every = _of_solved(block, solved, -direction)
        # (10) errs in s1, so that nothing follows from its s1 < 1
        parts.append(_within(every, zero[rows] if zero.ndim else zero, angle, -direction, pulled=method != "will"))
    columns = ([getattr(part, column.name) for part in parts] for column in fields(Contacts))
    return parts[0] if len(parts) == 1 else Contacts(*map(np.concatenate, columns))


def _of_solved(reactions: Reactions, solved: Solved, side: int) -> Contacts:
    """What no tolerance decides of contacts; `side` is 1 for sweeps in -x, -1 in +x."""
    with np.errstate(invalid="ignore"):
        x = reactions.x0 + side * solved.x
        present = (solved.force > 0) & np.isfinite(reactions.x0 + solved.force + reactions.m0z)
        valid = np.isfinite(solved.s1 + x)
    status = np.full(len(x), Status.OK, dtype=np.int8)
    # where several reasons apply, the last one counts
    reasons = (
        (Status.UNDEFINED, solved.undefined),
        (Status.NO_ROD, solved.no_rod),
        (Status.WRONG_SIDE, solved.wrong_side),
    )
    for reason, rows in reasons:
        status[rows] = reason
        valid &= ~rows
    status[~present & ~valid] = Status.NO_FORCE
    return Contacts(
        point=np.stack([x, solved.y], axis=1),
        s1=solved.s1,
        phase=np.where(valid, Phase.TIP, Phase.NONE).astype(np.int8),
        status=status,
        force=solved.force,
        force_angle=solved.alpha * side,
        friction_angle_bound=solved.beta,
        slope=np.full(len(x), np.nan),
        normal_source=np.full(len(x), NormalSource.NONE, dtype=np.int8),
    )


def _within(found: Contacts, tolerance: Array, zeta: Array | None, side: int, *, pulled: bool = True) -> Contacts:
    """The contacts by a tolerance and by friction angles, if they are known."""
    s1, beta, valid, status = found.s1, found.friction_angle_bound, found.phase != Phase.NONE, found.status.copy()
    with np.errstate(invalid="ignore"):
        tangential, beyond = valid & (s1 < 1 - tolerance), valid & (s1 > 1 + tolerance)
        inflected = tangential & (beta < -tolerance) & pulled
    status[inflected], status[beyond] = Status.INFLECTION, Status.BEYOND_TIP
    tangential &= ~inflected
    tip = valid & ~(tangential | inflected | beyond)
    slope = found.force_angle - side * beta
    if zeta is not None:
        np.copyto(slope, found.force_angle - side * zeta, where=tip)
    else:
        slope[tip] = np.nan
    source = (NormalSource.TANGENTIAL * tangential).astype(np.int8)
    if zeta is not None:
        source[tip] = NormalSource.FRICTION
    phase = (Phase.TANGENTIAL * tangential + Phase.TIP * tip).astype(np.int8)
    values = dict(zip(_VALUES, (found.point, s1, found.force, found.force_angle, beta, slope), strict=True))
    none = phase == Phase.NONE
    if none.any():
        for name, column in values.items():
            values[name] = column.copy()
            values[name][none] = np.nan
    return Contacts(phase=phase, status=status, normal_source=source, **values)


DIFFERENCE = 3e-4
"""Relative step of differences: their errors, its square and the march's over it, are both some 1e-7."""


def jacobian(f0x: ArrayLike, f0y: ArrayLike, m0z: ArrayLike, *, direction: int = -1, rod: Rod | None = None) -> Array:
    """Derivatives (n, 5, 3) of a contact's place x and y, arc length s1, α and β (rows) by f0x, f0y and m0z (columns).

    Reactions (n,) in ``EI/L²`` and ``EI/L``; lengths in rod lengths, angles in radians; `direction` is the sign of the base's
    motion along x.  The covariance of these five is ``J C Jᵀ``, with C that of the reactions; the slope (14) of a tangential
    contact is ``α - β``, and ``α + β`` in a sweep in +x.  `rod`: as in `planar.reconstruct`.  NaN where no rod has these
    reactions, and where there is no force.  The errors are those of the first order: they hold where the errors of the force
    are small compared with the force.
    Raises ValueError for arrays of different lengths and for another direction than -1 or 1.
    """
    check_direction(direction)
    columns = checked_reactions(np.zeros_like(np.asarray(f0x, dtype=float)), f0x, f0y, m0z)
    return _solved_with_slopes(columns, direction, as_rod(rod))[1]


def _solved_with_slopes(reactions: Reactions, direction: int, rod: Rod) -> tuple[Solved | None, Array]:
    """`jacobian`, and the contacts in sweeps in -x if they came with it."""
    _, across, along, moment = reactions
    side = -direction
    # a sweep in +x is the mirror image of a sweep in -x
    across, moment = side * across, side * moment
    solved = None
    if rod.is_straight_and_uniform:
        slopes = _of_closed_form(across, along, moment)
    else:
        solved, slopes = _by_differences(rod if side > 0 else rod.mirrored(), across, along, moment)
    if side < 0:
        # x and α are odd under the reflection; so are f0x and m0z
        slopes[:, [0, 3], :] *= -1
        slopes[:, :, [0, 2]] *= -1
    slopes[~np.isfinite(slopes).all(axis=(1, 2))] = np.nan
    return solved, slopes


def _of_closed_form(across: Array, along: Array, moment: Array) -> Array:
    """`jacobian` of straight uniform rods."""
    n = len(across)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        force = np.hypot(across, along)
        alpha, root = np.arctan2(-across, along), np.sqrt(force)
        q = moment / (2 * root)
        q = np.where(q >= 0, q, np.nan)  # beyond cos(α/2) the rod's shape is NaN as well
        shape, s1_alpha, s1_q, x_alpha, x_q, y_alpha, y_q = bend_with_slopes(alpha, q)
        by_alpha = np.stack([-along / force**2, across / force**2, np.zeros(n)], axis=1)
        by_force = np.stack([across / force, along / force, np.zeros(n)], axis=1)
        by_q = -(q / (2 * force))[:, None] * by_force
        by_q[:, 2] = 1 / (2 * root)

        def scaled(value: Array, alpha_slope: Array, q_slope: Array) -> Array:
            """Derivatives (n, 3) of value / √f."""
            changed: Array = alpha_slope[:, None] * by_alpha + q_slope[:, None] * by_q
            return (changed - (value / (2 * force))[:, None] * by_force) / root[:, None]

        # β = 2 arcsin(k) - π/2 with k² = sin²(α/2) + q²
        square = np.sin(alpha / 2) ** 2 + q * q
        k_complement = np.sqrt(square * (1 - square))
        beta = (np.sin(alpha)[:, None] * by_alpha / 2 + (2 * q)[:, None] * by_q) / k_complement[:, None]
        rows = [
            scaled(shape.x, x_alpha, x_q),
            scaled(shape.y, y_alpha, y_q),
            scaled(shape.length, s1_alpha, s1_q),
            by_alpha,
            beta,
        ]
    return np.stack(rows, axis=1)


def _by_differences(rod: Rod, across: Array, along: Array, moment: Array) -> tuple[Solved, Array]:
    """The contacts of any rod, and `jacobian` by central differences of them: all in one march."""
    reactions, n = np.stack([across, along, moment]), len(moment)
    force = np.hypot(*(reactions[:2] + rod.pull))
    change = DIFFERENCE * np.stack([force, force, np.abs(moment)])
    moved = np.tile(reactions[:, None], (1, 7, 1))  # as they are, and each of them down and up
    for k in range(3):
        moved[k, [1 + k, 4 + k]] += [-change[k], change[k]]
    everywhere = rod.rows(np.tile(np.arange(n), 7))
    with np.errstate(divide="ignore", invalid="ignore"):
        found = solve("closed-form", everywhere, *moved.reshape(3, -1))
        values = np.stack([found.x, found.y, found.s1, found.alpha, found.beta])[:, n:].reshape(5, 2, 3, n)
        slopes = np.asarray((values[:, 1] - values[:, 0]) / (2 * change)).transpose(2, 0, 1)
    return Solved._make(column[:n] for column in found), slopes


class Errors(NamedTuple):
    """Standard deviations (n,) and covariances of contacts, dimensionless; infinite where no rod has the reactions.

    `point` (n, 2, 2) is the covariance of the place, `largest` its deviation in its least certain direction; `s1`,
    `friction_angle` and `slope` (in tangential contact) are deviations of what `planar.Contacts` calls so.
    """

    point: Array
    """(n, 2, 2) covariance of the place."""
    largest: Array
    """(n,) standard deviation of the place in its least certain direction."""
    s1: Array
    """(n,)"""
    friction_angle: Array
    """(n,) of the angle β."""
    slope: Array
    """(n,) of the slope in tangential contact."""

    def __repr__(self) -> str:
        finite = self.largest[np.isfinite(self.largest)]
        at_median = f", places within {np.median(finite):.2g} rod lengths in the median" if len(finite) else ""
        return f"Errors of {len(self.largest)} rows, {len(finite)} of them finite{at_median}"


def errors(
    f0x: ArrayLike,
    f0y: ArrayLike,
    m0z: ArrayLike,
    *,
    noise: tuple[float, float],
    direction: int = -1,
    rod: Rod | None = None,
    missing: str | None = None,
    known: str = "friction",
    known_sd: float = 0.0,
    tip: ArrayLike = False,
    covariance: Array | None = None,
    slopes: Array | None = None,
) -> Errors:
    """Errors of the contacts that `planar.reconstruct` finds for reactions (n,), by the noise of force and moment.

    noise
        standard deviations of each component of the force and of the moment.
    missing
        'f0x', 'f0y' or 'm0z' if it was not measured but completed by `planar.complete`, from what was `known`, 'friction' or
        'slope', with the standard deviation `known_sd` of that angle in radians; `tip` (n,) are the contacts at the tip.
    covariance
        (n, 3, 3) that of the reactions in each row, in the place of `noise`.
    slopes
        (n, 5, 3) the `jacobian`, if it is known already.
    direction, rod
        as in `jacobian`.

    Raises ValueError for deviations that are no two numbers of at least 0, and for covariances of another shape.
    """
    if np.shape(noise) != (2,) or not (finite(noise, known_sd) and min(*noise, known_sd) >= 0):
        raise ValueError(
            f"noise must be two numbers >= 0, of force and of moment, and known_sd one, got {noise!r} and {known_sd!r}"
        )
    if covariance is not None and np.shape(covariance) != (np.size(f0x), 3, 3):
        raise ValueError(f"covariance must have the shape (n, 3, 3) of n reactions, got {np.shape(covariance)}")
    spread = jacobian(f0x, f0y, m0z, direction=direction, rod=rod) if slopes is None else slopes
    own = np.array(NAMES) == missing
    if missing is not None:
        spread = _completed(spread, missing, known, known_sd, np.broadcast_to(tip, len(spread)), direction)
    if covariance is None:
        force, moment = noise
        spread = spread * np.where(own, 1.0, [force, force, moment])
    else:  # what was completed has its own deviation already, and none in common with the others
        measured = np.where(own | own[:, None], np.diag(own), covariance)
        known_rows: Mask = np.asarray(np.isfinite(measured).all(axis=(1, 2)))
        sizes, vectors = np.linalg.eigh(np.where(known_rows[:, None, None], measured, 0.0))
        spread = spread @ (vectors * np.sqrt(np.maximum(sizes, 0.0))[:, None])
        spread[~known_rows] = np.nan
    with np.errstate(over="ignore", invalid="ignore"):  # forces far below the noise have errors beyond all numbers
        point = np.einsum("nik,njk->nij", spread[:, :2], spread[:, :2])
        mean, half = (point[:, 0, 0] + point[:, 1, 1]) / 2, (point[:, 0, 0] - point[:, 1, 1]) / 2
        largest = np.sqrt(mean + np.hypot(half, point[:, 0, 1]))
        # the slope is α - β, in the mirror image, where β keeps its sign, α + β
        slope = spread[:, 3] + direction * spread[:, 4]
        deviations = [np.linalg.norm(part, axis=1) for part in (spread[:, 2], spread[:, 4], slope)]
    known = np.isfinite(largest)
    return Errors(point, *(np.where(known, values, np.inf) for values in (largest, *deviations)))


def contacts_with_errors(
    x0: ArrayLike,
    f0x: ArrayLike,
    f0y: ArrayLike,
    m0z: ArrayLike,
    *,
    tolerance: float,
    rod: Rod,
    noise: tuple[float, float],
    direction: int = -1,
    covariance: Array | None = None,
    **completed: Any,
) -> tuple[Contacts, Errors]:
    """What `reconstruct` and `errors` give, in one march where the rod needs one.

    `completed` are `missing`, `known` and `known_sd` of `errors`; the contacts at the tip are those of exact reactions.
    """
    columns, told = checked_reactions(x0, f0x, f0y, m0z), completed.copy()
    if covariance is None and not max(*noise, completed.get("known_sd", 0.0)):
        found = reconstruct(*columns, tolerance=tolerance, direction=direction, rod=rod)
        zero = np.where(found.status == Status.NO_ROD, np.inf, 0.0)
        return found, Errors(np.zeros((len(zero), 2, 2)), zero, zero, zero, zero)
    solved, told["slopes"] = _solved_with_slopes(columns, direction, rod)
    if solved is None:
        found = reconstruct(*columns, tolerance=tolerance, direction=direction, rod=rod)
    else:
        found = _within(_of_solved(columns, solved, -direction), np.asarray(tolerance), None, -direction)
    if "missing" in completed:
        told["tip"] = found.within(TOLERANCE, direction=direction).phase == Phase.TIP
    return found, errors(*columns[1:], noise=noise, direction=direction, rod=rod, covariance=covariance, **told)


def _completed(spread: Array, missing: str, known: str, known_sd: float, tip: Mask, direction: int) -> Array:
    """Spreads (n, 5, 3) of a contact by the two channels measured and by what is known, from those by all three."""
    if missing not in NAMES or known not in ("friction", "slope"):
        raise ValueError(
            f"missing must be one of {', '.join(NAMES)}, and known 'friction' or 'slope', got {missing}, {known}"
        )
    column = NAMES.index(missing)
    # x, y, s1, α and β: what is known keeps β, the slope α - β, or s1 = 1
    held = np.array([0.0, 0.0, 0.0, 0.0, 1.0] if known == "friction" else [0.0, 0.0, 0.0, 1.0, direction])
    weights = np.where(tip[:, None], [0.0, 0.0, 1.0, 0.0, 0.0], held)
    rate = np.einsum("nr,nrc->nc", weights, spread)
    with np.errstate(all="ignore"):
        change = spread[:, :, column] / rate[:, column, None]
        completed: Array = spread - change[:, :, None] * rate[:, None, :]
        completed[:, :, column] = change * np.where(tip, 0.0, known_sd)[:, None]
    return completed


class ElasticLines(NamedTuple):
    """Shapes of n rods in rod lengths; NaN where a rod with such reactions does not exist."""

    curved: Array
    """(n, points, 2) from the clamp to the contact, evenly in arc length."""
    straight: Array
    """(n, 2, 2) ends of the straight part beyond the contact; they coincide in tip contact.  Of rods with curvature or weight
    (n, points, 2) the part beyond the contact, which is not straight."""

    def __repr__(self) -> str:
        return f"ElasticLines of {len(self.curved)} rods, with {self.curved.shape[1]} points up to the contact of each"

    def plot(self, *, axes: Axes | None = None, **style: Any) -> Any:
        """The rods, those in tip contact in ochre, the others in red up to the contact and in black beyond it.

        `axes` are matplotlib's, by default new ones; `style` is that of `matplotlib.axes.Axes.plot`.  Returns the axes.
        """
        return plots.plot_lines(self.curved, self.straight, axes, style)


def elastic_lines(
    x0: ArrayLike, f0x: ArrayLike, f0y: ArrayLike, m0z: ArrayLike, points: int = 100, *, rod: Rod | None = None
) -> ElasticLines:
    """Elastic lines of rods with the given base positions and support reactions (n,).

    A rod without force has the shape at rest.  Reactions of sweeps in +x have ``m0z < 0``.  `rod` is any rod, by default the
    straight uniform one.  Raises ValueError for arrays of different lengths or fewer than 2 points.
    """
    reactions = checked_reactions(x0, f0x, f0y, m0z)
    if not (isinstance(points, int | np.integer) and points >= 2):
        raise ValueError(f"an elastic line needs a whole number of at least 2 points, got {points!r}")
    parts = [slice(first, first + BLOCK) for first in range(0, max(len(reactions[0]), 1), BLOCK)]
    if rod is None or rod.is_straight_and_uniform:
        drawn = (_drawn(points, *(column[part, None] for column in reactions)) for part in parts)
    else:
        drawn = (_drawn_of(rod.rows(part), points, *(column[part] for column in reactions)) for part in parts)
    return ElasticLines(*(np.concatenate(columns) for columns in zip(*drawn, strict=True)))


def _drawn_of(rod: Rod, points: int, base: Array, fx: Array, fy: Array, moment: Array) -> tuple[Array, Array]:
    """`_drawn` for any rod, of arrays (n,)."""
    with np.errstate(all="ignore"):
        s1, other = (
            np.where(solved.wrong_side, np.nan, solved.s1)
            for solved in (
                solve("closed-form", rod, fx, fy, moment),
                solve("closed-form", rod.mirrored(), -fx, fy, -moment),
            )
        )
        force = -np.stack([fx, fy]) - rod.pull
        s1 = np.minimum(np.where(np.isnan(s1), other, s1), 1.0)
        s1[np.isnan(s1) & ~(np.hypot(*force) > TOLERANCE)] = 1.0
        lines = shapes(rod, force, -moment, s1, points)
    curved, rest = (np.stack([base + x, np.broadcast_to(y, x.shape)], axis=-1).swapaxes(0, 1) for x, y in lines)
    return curved, rest


def _drawn(points: int, base: Array, fx: Array, fy: Array, moment: Array) -> tuple[Array, Array]:
    side = np.where(moment < 0, -1.0, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.hypot(fx, fy)
        root_f = np.sqrt(f)
        alpha = np.arctan2(-side * fx, fy)
        q = side * moment / (2 * root_f)
        s1 = np.where(f > 0, np.minimum(bend(alpha, q).length / root_f, 1.0), 1.0)
    shape = piece(-fx, -fy, np.full_like(f, np.pi / 2), -moment, np.linspace(0.0, 1.0, points) * s1)
    curved = np.stack([base + shape.x, shape.y], axis=-1)
    end = shape.phi[:, -1:]
    tip = curved[:, -1] + (1 - s1) * np.concatenate([np.cos(end), np.sin(end)], axis=1)
    return curved, np.stack([curved[:, -1], tip], axis=1)
