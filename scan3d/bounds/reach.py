"""Two bodies between which a body without fine features lies: by balls that roll around contacts and free space (C19).

Premise: the body and its surroundings are unions of balls of radius R, so that nothing is thinner than 2R, no gap is narrower,
and no edge or groove is sharper; every part of the body was touched; and there is no cavity, so that the balls of the
surroundings are connected with the outside.

*Outer body.*  A ball in the body holds no free place.  So the body lies in the union of the balls about the centres that are at
least R away from all free places, as far as these centres are connected with such that reach a contact.

*Inner body.*  A ball in the surroundings holds no contact.  So the surroundings lie in the union of the balls about the centres
that are at least R away from all contacts, as far as these are connected with the outside.  Where contacts are apart by more
than 2R, balls roll in between, and nothing is claimed.  The sheets of free space play no part in it.

Every closed surface between the two is as close to the body's surface as they are to each other.

*Test.*  At a contact p a ball of the body and one of the surroundings touch, so that their centres are at ``p ∓ R u`` with one
unit vector u.  The one holds no free place q and the other no contact q, which is ``∓ u·(q - p) ≤ |q - p|² / 2R``.  Where no
unit vector fulfils all of these inequalities, whatever the errors, the premise is refuted.  A contact outside the outer body or
inside the inner one, and a place outside the one and inside the other, refute it as well.  What is not refuted is a premise.

Centres and places are those of a grid.  Distances on it are never less than the true ones.  How far a centre lies from the next
one of the grid, half the diagonal of a cell at most, is allowed for where a centre is excluded, again where a place is within R
of one, and again where a place between the two bodies is far from both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, cKDTree

from planar.arrays import rows_of
from scan3d.arrays import ROUNDING, Array, Mask, evenly
from scan3d.bounds.constraints import allowed, exact_error
from scan3d.bounds.free_space import Sheets, contradicted, joined, place_errors, sheets_of
from scan3d.bounds.grids import EVERY_NEIGHBOUR, Grid, below
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.reconstruction.contacts import with_rows
from scan3d.reconstruction.probings import passed_in_probings
from scan3d.recording import FORCE_SIGMAS, Recording, of_rows
from scan3d.rods import Rod
from scan3d.units import UNITS_M, length

# Cells in R at least.
_COARSEST = 4.0
# Part of R by which a body may differ from a union of balls: edges of up to 7 degrees, as meshes of smooth bodies have.
_SMOOTH = 0.002
# Contacts at which two balls are sought, evenly over the recording: a hundredth of a second each.
_TESTED = 400
# What is taken for granted.
_NOTHING_FINER = (
    "a body, and surroundings, without features finer than the reach, without cavities and touched in each part"
)
_ANY_SHAPE = "a body of any shape that is in one piece, or touched in each of its pieces"


@dataclass(frozen=True)
class Reach:
    """What contacts and free space prove of a body of any shape, in the cloud's unit."""

    outer: Any
    """A `trimesh.Trimesh` that contains the body; empty where nothing bounds it."""
    inner: Any
    """A `trimesh.Trimesh` in the body; empty where there is none."""
    bound: float
    """Upper bound of the Hausdorff distance between the surface and that of the body; infinite where nothing bounds it."""
    refuted: str | None
    """What contradicts the premise, in a sentence; None if nothing does."""
    unbounded: str | None
    """Why there is no bound although nothing refutes the premise, in a sentence; None if there is one."""
    premise: str
    """What is taken for granted, in words."""
    widest: list[dict[str, Any]]
    """Where the two bodies are farthest apart, or, without an inner one, what of the outer body lies outside of the surface and
    deep behind what beads have passed: patches ``{center, volume, extent}``, largest first, the latter with a ``reason``."""

    @property
    def outer_volume(self) -> float | None:
        """That of the outer body; None where none is proven."""
        return float(self.outer.volume) if self.refuted is None and len(self.outer.faces) else None

    @property
    def volume_between(self) -> float | None:
        """That of the outer body less that of the inner one; None where not both are proven."""
        outer, both = self.outer_volume, self.unbounded is None and len(self.inner.faces)
        return outer - float(self.inner.volume) if both and outer is not None else None


class _Balls(NamedTuple):
    """Balls in which nothing of the body is."""

    centres: Array
    """(n, 3)"""
    radius: float
    """In the cloud's unit; below zero where the centres themselves may be off."""


class _Free(NamedTuple):
    """What is free of the body."""

    balls: list[_Balls]
    places: Array
    """(n, 3) those of their centres that are compared with single contacts."""
    lost: float
    """By how much radii are smaller than they would be if all were known exactly, the errors of contacts included."""


def _finest(contacts: Array, R: float, bead: float) -> float:
    """The least reach, or the least radius of a bead alone, that the cells allow, which grow with it; from above."""
    least = R or bead
    for _ in range(20):  # each time two thirds of what is missing are left, or less
        least = _COARSEST * Grid.around(contacts, least + bead if R else least).step
    return 1.001 * least


def too_fine(points: Array, R: float, bead: float, unit: str) -> str | None:
    """That a reach, or the radius of a bead alone, bounds nothing of a body with these places (n, 3); None if it may."""
    if Grid.around(points, R + bead).step * _COARSEST <= (R or bead):
        return None
    what = f"a reach of {length(R, unit)}" if R else f"the radius of a bead, {length(bead, unit)},"
    least = length(_finest(points, R, bead), unit, up=True)
    return f"{what} is too fine for a body of this size; it must be at least {least}"


def reach(recording: Recording, cloud: Cloud, R: float = 0.0, surface: Any = None) -> Reach:
    """The outer and the inner body of a body without features finer than R, in the cloud's unit, by all slices and probings.

    R
        0 for a body of any shape, of which a bead on the rod's tip proves the outer body alone; neither may be too small.
    surface
        a closed `trimesh.Trimesh` that the bound is for; None: any between the two bodies.

    Raises InputError for an R that is no positive number without a bead, and as `surfaces.any_shape`.
    """
    bead = cloud.bead_radius
    if not (np.isfinite(R) and R >= 0 and R + bead > 0):
        raise InputError(f"the reach must be a positive number, got {R}")
    touched, sheets = cloud.fattened or cloud, list[Sheets]()
    number = np.flatnonzero(~recording.in_probings)
    if len(swept := touched.swept()):
        swept = with_rows(swept, number)
        sheets = sheets_of(of_rows(recording, number), swept, R)
        wrong = np.zeros(len(touched), dtype=bool)
        wrong[np.flatnonzero(~touched.probed) if touched.probed is not None else ...] = contradicted(sheets, swept)
        touched = touched.select(~wrong)
    contacts, errors = touched.points, place_errors(touched) + _SMOOTH * R
    error = float(errors.max())
    grid = Grid.around(contacts, R + bead)
    if why := too_fine(contacts, R, bead, cloud.unit):
        nothing, why = below(np.full(grid.shape, np.inf), 0.0, grid), f"nothing bounds the body: {why}"
        return Reach(nothing, nothing, np.inf, None, why, _NOTHING_FINER if R else _ANY_SHAPE, [])
    finest = _finest(contacts, R, bead)
    least = length(finest, cloud.unit, up=True)
    free = _passed_by_beads(recording, cloud, R) if bead else _passed(recording, cloud, sheets, R, error)
    half = grid.step * np.sqrt(3) / 2
    to_contact = grid.distance(contacts)
    to_free = np.minimum.reduce([grid.distance(part.centres) - part.radius for part in free.balls])
    in_body = to_free >= R - half
    touching = np.nonzero(in_body & (to_contact <= R + 3 * half + error))
    nearest = cKDTree(contacts).query(grid.origin + grid.step * np.stack(touching, axis=1))[0]
    seeds = np.zeros(grid.shape, dtype=bool)
    seeds[touching] = nearest <= R + half + error
    in_body = joined(in_body, seeds, EVERY_NEIGHBOUR)

    def leak(without: float) -> bool:
        return bool(
            (joined(to_free >= R - half + without, to_contact <= R + half, EVERY_NEIGHBOUR) & grid.border()).any()
        )

    cells = f"the cells of {length(grid.step, cloud.unit)} on which bodies and free space are kept"
    bent = (
        f"beads that rods bent aside, or errors of poses, take to other places by up to {length(free.lost, cloud.unit)}"
    )
    causes = (
        (half, cells),
        (half + error, f"contacts and free space that noise moves by up to {length(error, cloud.unit)}"),
        (free.lost, bent if bead else cells),
    )
    finer = "a smaller reach" if R else "a larger bead"

    def open_towards(leaks: Mask) -> str:
        why = next((text for without, text in causes if not leak(without)), "")
        if why:
            why += f" leave gaps which are closed without; take more slices, or {finer}"
        return _open(grid, leaks, sheets, touched, R, why)

    if not R:
        return _by_beads(grid, in_body, to_free, touched, errors, surface, open_towards)
    level = R + half + grid.curvature(R)
    in_air = joined(to_contact >= R - half - error, grid.border(), EVERY_NEIGHBOUR)
    to_body, to_air = grid.from_cells(in_body), grid.from_cells(in_air)
    leaks = (to_body <= level) & grid.border()
    # an open surface contains nothing
    outer = below(np.full(grid.shape, np.inf) if leaks.any() else to_body, level, grid)
    inner = below(-to_air, -level, grid)
    # those of a body that is grown by the rod's radius leave so much less room to the surroundings
    thick = recording.rod.diameter_m / 2 / UNITS_M[cloud.unit] if cloud.fattened is not None else 0.0
    lost = _without_balls(contacts, errors, free.places, free.lost, R, R - thick)
    against = {
        "contacts lie where no two balls of this radius touch": lost,
        "contacts lie outside the outer body": ~grid.within(in_body, contacts, R + half + errors),
        "contacts lie inside the inner body": ~grid.within(in_air, contacts, R + half + errors),
        "cells are outside the one and inside the other": (to_body > R + half) & (to_air > R + half),
    }
    contradictions = [f"{np.count_nonzero(where)} {what}" for what, where in against.items() if where.any()]
    refuted = unbounded = None
    bound, widest = np.inf, list[dict[str, Any]]()
    if contradictions:
        refuted = (
            f"the body has features finer than {length(R, cloud.unit)}, or rods touched at a second place unnoticed: "
            f"{' and '.join(contradictions)}; "
            + (f"take a smaller reach, of {least} at least" if finest < 0.99 * R else f"one below {least} is too fine")
        )
    elif leaks.any():
        unbounded = open_towards(leaks)
    elif cloud.fattened is not None:
        unbounded = (
            "the two bodies are those of the body grown by the rod's radius; no bound of the body itself follows"
        )
    elif not (to_air > level).any():
        unbounded = "contacts are too far apart to enclose anything for this reach; take more slices and samples"
    else:
        outside, inside = to_body > level, to_air > level
        # a place that is in both bodies, or in neither, is in a cube of the grid with corners of such a kind: its nearest
        # centre has neighbours, or itself, that are not outside, and such that are not inside
        between = ~(
            ndimage.binary_erosion(outside, EVERY_NEIGHBOUR, border_value=1)
            | ndimage.binary_erosion(inside, EVERY_NEIGHBOUR)
        )
        wide = np.maximum(grid.from_cells(outside), grid.from_cells(inside))
        largest = float(wide[between].max(initial=0.0))
        widest = grid.patches(between & (wide >= largest / 2))
        bound = largest + half
        if surface is not None:
            # from each face to the body's surface, which lies between the two, and back from all between the two
            corners = np.asarray(surface.triangles)
            middle = corners.mean(axis=1)
            there = grid.at(wide, middle) + np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
            back = cKDTree(np.concatenate([middle, surface.vertices])).query(grid.centres(between))[0]
            bound = float(max(there.max(), back.max(initial=0.0)) + half)
    return Reach(outer, inner, bound, refuted, unbounded, _NOTHING_FINER, widest)


def _by_beads(
    grid: Grid,
    in_body: Mask,
    to_free: Array,
    cloud: Cloud,
    errors: Array,
    surface: Any,
    open_towards: Callable[[Mask], str],
) -> Reach:
    """What beads prove of a body of any shape: it lies where none has passed (C23), as far as that is connected with contacts.

    in_body, to_free
        the cells there, and all cells' distances from what beads have passed, below zero inside.
    """
    half, b = grid.step * np.sqrt(3) / 2, cloud.bead_radius
    leaks = in_body & grid.border()
    # a place of the surface is a mean of centres, from which it is half a diagonal away in the mean at most: where the mean of
    # their distances is that, inside, its own is not outside
    kept = np.where(ndimage.binary_dilation(in_body, EVERY_NEIGHBOUR), -to_free, np.inf)
    outer = below(np.full(grid.shape, np.inf) if leaks.any() else kept, half, grid)
    outside = ~grid.within(in_body, cloud.points, half + errors)
    refuted = unbounded = None
    widest = list[dict[str, Any]]()
    if outside.any():
        refuted = (
            f"{np.count_nonzero(outside)} contacts lie where the bead has passed: check the poses, the rod's length and "
            "bead_diameter_m"
        )
    elif leaks.any():
        unbounded = open_towards(leaks)
    else:
        unbounded = (
            "a bead alone bounds the body from outside: how far it fills what no bead has passed stays open; "
            "state a reach for the other side"
        )
        if surface is not None:
            deep = in_body & (grid.from_cells(~in_body) >= b / 2)
            reason = f"narrower than the bead of {length(2 * b, cloud.unit)}, or not on its way"
            widest = [{**patch, "reason": reason} for patch in grid.patches(deep & ~grid.inside(surface))]
    nothing = below(np.full(grid.shape, np.inf), 0.0, grid)
    return Reach(outer, nothing, np.inf, refuted, unbounded, _ANY_SHAPE, widest)


def _passed(recording: Recording, cloud: Cloud, sheets: list[Sheets], R: float, error: float) -> _Free:
    """What rods of sweeps and of probings have passed, where contacts have errors up to so much."""
    passed = passed_in_probings(recording, cloud)
    # in the middle between two places a ball comes nearer to the line by a five hundredth of its radius
    along = _near(passed.places(R / 8, cloud.rod_length), cloud, 2 * R)
    aside = float(np.linalg.norm(passed.reach()[1], axis=1).max(initial=0.0))
    # of the second order where the rod's shape is that of `Passed.places`, and else between the axis and the end
    bent = aside**2 / cloud.rod_length if recording.rod.is_simple else aside
    lost = max([bent, *(sheet.cell / np.sqrt(2) for sheet in sheets)]) + error
    centres = np.concatenate([*(sheet.centres(sheet.free) for sheet in sheets), along])
    thinned = np.concatenate([*(sheet.thinned(0.1 * R) for sheet in sheets), along])
    return _Free([_Balls(centres, -lost)], thinned, lost)


def _near(places: Array, cloud: Cloud, around: float) -> Array:
    """Those of some places (n, 3) that are in the box of the contacts, or so far around it."""
    low, high = cloud.points.min(axis=0) - around, cloud.points.max(axis=0) + around
    return np.asarray(places[((places > low) & (places < high)).all(axis=1)])


def _passed_by_beads(recording: Recording, cloud: Cloud, R: float) -> _Free:
    """What the bead of a rod has passed: balls along its axis, and in contact.

    Before the clamp stopped, the force was no larger than at the end, and bent the rod aside by no more than where it acts
    across.  By so much the balls along the axis are smaller than the bead: that near it came to every place of the axis, for
    along the axis it went from the begin to the end.
    """
    rod, scale, b = recording.rod, UNITS_M[cloud.unit], cloud.bead_radius
    noise = recording.noise
    allow = allowed(cloud)
    pose = exact_error(cloud) + float(np.max(allow.place)) + (allow.kappa or 0.0) * noise.pose_m / scale
    passed = passed_in_probings(recording, cloud)
    felt = np.linalg.norm(recording.pressing(six_axis=True), axis=1)
    touches = passed.touching >= 0
    aside = FORCE_SIGMAS * noise.of_reactions(rod)[0] + np.zeros(len(touches))
    aside[touches] += felt[cloud.row[passed.touching[touches]]]
    aside *= _give(rod) * cloud.rod_length
    # a ball rolls between two of these places by a hundredth of its radius at most
    apart = min(part for part in (R / 8, b / 4) if part)
    balls = []
    for rows in (~touches, touches):
        if rows.any():
            along = _near(rows_of(passed, rows).places(apart), cloud, 2 * (R + b))
            balls.append(_Balls(along, b - pose - float(aside[rows].max())))
    assert cloud.bead_centres is not None
    at_end = pose + (0.0 if cloud.bead_sd is None else (allow.kappa or 0.0) * float(cloud.bead_sd.max()))
    balls.append(_Balls(cloud.bead_centres, b - at_end))
    places = np.concatenate([part.centres for part in balls])
    return _Free(balls, places, b - min(part.radius for part in balls))


def _give(rod: Rod) -> float:
    """By how much a force of EI/L² across the end of a straight rod moves it, in rod lengths: a third for a uniform one."""
    s, weights = np.polynomial.legendre.leggauss(64)
    s = (s + 1) / 2
    bend = float((weights / 2 * (1 - s) ** 2 / rod.profile.bending_stiffness(s)).sum())
    return bend + rod.clamp_compliance_rad_per_Nm * rod.moment_unit_Nm


def _without_balls(points: Array, errors: Array, free: Array, of_free: float, R: float, outside: float) -> Mask:
    """Contacts (n,) at which no ball of radius R without free places (m, 3) touches one of radius `outside` without contacts.

    With the errors e of two places and ``d = q - p`` the unit vector u between the centres has ``±u·d ≤ b`` with
    ``b = |d|²/2R + e_q + (1 + |d|/R) e_p + e_p²/2R``.  The set of all u with these is a polytope that contains 0, so that it
    has a unit vector unless it lies inside the unit ball, which it does if the hull of all ``±d/b`` contains that ball.
    """
    lost = np.zeros(len(points), dtype=bool)
    trees = cKDTree(points), cKDTree(free)
    for k in evenly(np.arange(len(points)), _TESTED):
        rays = [np.vstack([np.eye(3), -np.eye(3)]) / 2]  # so that the hull has an inside
        for tree, size, sign, error in ((trees[0], outside, 1.0, errors), (trees[1], R, -1.0, of_free)):
            if size <= 0:
                continue
            near = np.array(tree.query_ball_point(points[k], 2 * size), dtype=int)
            d = tree.data[near] - points[k]
            long = np.linalg.norm(d, axis=1)
            own, other = errors[k], error[near] if isinstance(error, np.ndarray) else error
            b = long**2 / (2 * size) + other + (1 + long / size) * own + own**2 / (2 * size)
            some = long > b  # shorter rays are in the ball
            rays.append(sign * d[some] / b[some, None])
        hull = ConvexHull(np.concatenate(rays))
        lost[k] = bool((hull.equations[:, 3] < -1 - ROUNDING).all())
    return lost


def _open(grid: Grid, leaks: Mask, sheets: list[Sheets], touched: Cloud, R: float, why: str) -> str:
    """Towards which sides nothing bounds a body, and why, if that is not known already."""
    places = grid.centres(leaks)
    sides = [
        f"{sign}{name}"
        for axis, name in enumerate("xyz")
        for sign, end in (("-", 0), ("+", grid.shape[axis] - 1))
        if np.take(leaks, end, axis=axis).any()
    ]
    # the slices of no axis go past both ends of the body
    filled = touched.slice[touched.slice >= 0]
    ends = [{0, len(sheet.height) - 1} & {*sheet.number[filled].tolist()} for sheet in sheets]
    gap = np.zeros(len(places))
    for sheet in sheets:
        if len(sheet.height) > 1:
            above = np.clip(np.searchsorted(sheet.height, places @ sheet.frame[2]), 1, len(sheet.height) - 1)
            gap = np.maximum(gap, np.diff(sheet.height)[above - 1])
    apart = float(gap.max(initial=0.0))
    if why:
        pass
    elif not sheets:
        why = f"probings leave places out; probe in more planes, or take a larger {'reach' if R else 'bead'}"
    elif all(ends):
        why = (
            "no slice without contact lies beyond the body's end; add slices past its ends, or scan along further axes"
        )
    elif apart > 2 * R:
        why = f"slices are {length(apart, touched.unit)} apart, more than twice the reach; take more slices"
    else:
        why = "sweeps leave places out; sweep from more sides, or scan along further axes"
    return f"nothing bounds the body towards {', '.join(sides)}: {why}"
