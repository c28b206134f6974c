"""What contacts say of a body that contains them: supporting planes, and how far errors move these outwards.

A contact p with the rod's tangent t is an arc of supporting planes (`scan3d.geometry.arcs`), whose normals n lie between two
ends.  With the errors e of the place and ε of the tangent by noise, digits and the rig's calibration, the body leaves out the
wedge of all x with ``<n, x - p> > e(n) + ε (|<t, x - p>| + e(t))`` at both ends.  Contacts in slices use one end on either side
of their slice.  Of contacts anywhere planes bound the body together, in triangles of directions:

- exact ones by the apex of three planes (S28; `docs/model.md` has the proof).  Let the middles ν_i of the arcs be
  triangulated on the sphere, such that ``det(n_i, n_j, n_k)`` is positive in every triangle for all 8 choices of ends of its
  arcs.  Then ``h_K(u) <= <u, a>`` with an apex a of the triangle of u, and every convex function of the apex is largest at one
  of the 8 choices.  The triangles are those of the polar dual of the polytope of the planes with the normals ν_i; planes far
  away close it where no normals are known.  Where apexes lie farthest outside, the plane is added that cuts off most, whichever
  normals it has, and one with a wide arc is removed where none does.  The best choice met is taken;
- uncertain ones by one wedge each, behind which the body lies where it contains the triangle's corners as seen from a centre:
  the one that leaves least.  The farthest triangles are divided until the bound is nearly that of all wedges together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError, cKDTree
from scipy.special import chdtri

import planar
from scan3d.arrays import (
    AT_ONCE,
    NEGLIGIBLE,
    OCTANTS,
    ROUNDING,
    Array,
    Index,
    Mask,
    across,
    evenly,
    highest,
    ratio,
    unit,
)
from scan3d.cloud import Cloud
from scan3d.geometry import hulls
from scan3d.geometry.arcs import Arcs, Places, arcs_at
from scan3d.geometry.distance import nearest_on
from scan3d.geometry.hulls import cut_polytope, edges_of
from scan3d.geometry.support import inertia
from scan3d.geometry.triangles import dot, face_normals
from scan3d.reconstruction.slices import Slice, SliceStack

CONFIDENCE = 0.95
"""Probability with which the bounds hold under noise."""
AVERAGED = (2, 4, 16, 64)
"""Successive rows of a sweep that are averaged: larger averages have smaller errors, smaller ones follow sharp curves."""
EXACT = 2e-9
"""Error of an exact contact's place, in rod lengths, and of its tangent, in radians: what solvers and their input leave."""
STRAIGHT = 0.03
"""Slopes behind a slab are equal if they differ by less than this fraction of their difference to the slab's."""


def exact_error(cloud: Cloud) -> float:
    """Largest error of the places of exact contacts, in the cloud's unit."""
    return EXACT * cloud.rod_length + cloud.pose_error + cloud.lever


def sigmas(count: int, confidence: float = CONFIDENCE) -> float:
    """The number of standard deviations κ within which all linear functions of the errors of `count` contacts stay.

    Averages are counted as well, two for every run of rows, once for the inner and once for the outer polygon.
    """
    events = max(count, 1) * (1 + 4 * sum(1 / size for size in AVERAGED))
    return float(np.sqrt(chdtri(3, (1 - confidence) / events)))


class Allowed(NamedTuple):
    """What bounds of a stated confidence allow for: the probability that they fail is shared by noise and calibration."""

    kappa: float | None
    """Standard deviations of each contact by the noise, as `sigmas`; None for exact reactions."""
    factor: float
    """Standard deviations of all contacts by the calibration (`scan3d.rigs.RigErrors.factor`); 0 without one."""
    confidence: float
    """That of the bounds: 1 where there is neither noise nor calibration."""
    place: Array | float
    """(n,) the largest errors of the places by the calibration; 0 without one."""
    turn: Array | float
    """(n,) those of the tangents, in radians."""
    across: Array | float
    """(n,) those of the places across the rod, in the planes of the slices."""
    tilt: Array | float
    """(n,) those of the tangents' angles there, in radians."""
    height: float
    """The largest error of the height of a contact or a line."""

    @property
    def largest(self) -> float:
        """The largest error of a contact's place by the calibration."""
        return float(np.max(self.place, initial=0.0))


def allowed(cloud: Cloud, confidence: float = CONFIDENCE) -> Allowed:
    """What bounds of a cloud's body have to allow for in order to hold with a confidence."""
    noisy, rig = cloud.covariance is not None or cloud.place_sd is not None, cloud.calibration
    if rig is None or not rig.count:
        kappa = sigmas(len(cloud), confidence) if noisy else None
        return Allowed(kappa, 0.0, confidence if noisy else 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    alpha = 1 - confidence
    # of the probability of failure noise has the larger part, because the calibration's factor hardly depends on its own
    factor = rig.factor(0.2 * alpha if noisy else alpha)
    kappa = sigmas(len(cloud), 1 - 0.8 * alpha) if noisy else None
    columns = rig.place_sd, rig.turn_sd, rig.across_sd, rig.tilt_sd
    place, turn, across, tilt = (factor * column for column in columns)
    height = factor * float(rig.height_sd.max(initial=0.0))
    return Allowed(kappa, factor, confidence, place, turn, across, tilt, height)


class Tangents(NamedTuple):
    """Supporting planes through the rod's tangents, in a frame in which the contacts are spread like those of a ball."""

    arcs: Arcs
    """(k,) of the contacts, and then that of the table, if there is one."""
    rows: Index
    """(k,) the contacts."""
    centre: Array
    """(3,) origin of the frame."""
    shape: Array
    """(3, 3) symmetric map from the frame to the world."""

    def to_world(self, points: Array) -> Array:
        """Points (n, 3) of the frame in the world."""
        return points @ self.shape + self.centre

    def enclosing(self, corners: Array) -> Array:
        """Corners (v, 3) of what the planes leave of a body in the hull of points (w, 3), in the world.

        A normal that is turned by θ within its arc has ``<middle, x - p> <= tan θ <across, x - p>`` for all x of the body, so
        that the plane with the middle one holds where it is moved outwards by the most that this can be.
        """
        # planes of wider arcs are moved too far to bound anything
        arcs = self.arcs.select(np.flatnonzero(self.arcs.half_width < 0.1))
        corners = (corners - self.centre) @ np.linalg.inv(self.shape)
        place = dot(arcs.points, arcs.across)
        far = np.maximum(highest(corners, arcs.across) - place, highest(corners, -arcs.across) + place)
        planes = np.column_stack([arcs.middle, dot(arcs.points, arcs.middle) + np.tan(arcs.half_width) * far])
        planes = planes[planes[:, 3] > NEGLIGIBLE]
        size = float(np.abs(corners).max())
        found = cut_polytope(np.empty((0, 4)), planes, np.zeros(3), size, 1e-9)
        return np.asarray(found @ self.shape + self.centre)

    def normals(self) -> tuple[Array, Array]:
        """Middle normals (k, 3) of the contacts in the world, and the largest angle (k,) of the true ones from them."""
        inverse = np.linalg.inv(self.shape)
        arcs = self.arcs.select(np.arange(len(self.rows)))
        middle = unit(arcs.middle @ inverse)
        cosines = (unit(arcs.ends() @ inverse) * middle[:, None]).sum(axis=2)
        return middle, np.arccos(np.clip(cosines, -1.0, 1.0)).max(axis=1)


def tangent_planes(cloud: Cloud, errors: Array) -> Tangents:
    """The supporting planes of a cloud with exact tangents and errors (n,) of its places.

    Raises InputError for contacts that span no body.
    """
    assert cloud.centre_points is not None
    assert cloud.tangents is not None
    centre, shape = frame_of(cloud.centre_points)
    to_frame = np.linalg.inv(shape)
    points, tangents = (cloud.centre_points - centre) @ to_frame, unit(cloud.tangents @ to_frame)
    rows = tangential(cloud)
    # the map stretches errors by no more than its largest factor
    places = Places(points, errors * float(np.linalg.norm(to_frame, 2)))
    arcs = arcs_of_contacts(places, tangents, rows, np.zeros(len(rows))).moved(places.errors[rows])
    if cloud.table is not None:
        # nothing of the body lies below it
        point = np.linalg.solve(shape, [0.0, 0.0, cloud.table - cloud.rod_radius - centre[2]])
        down = unit(shape @ [0.0, 0.0, -1.0])[None]
        arcs = arcs.joined(Arcs(point[None], down, across(down)[0], np.zeros(1)))
    return Tangents(arcs, rows, centre, shape)


def tangential(cloud: Cloud) -> Index:
    """The contacts of a cloud whose tangents lie in supporting planes."""
    known = np.isfinite(cloud.tangents).all(axis=1)  # type: ignore[arg-type]
    return np.flatnonzero(known & (cloud.phase == planar.Phase.TANGENTIAL))


def frame_of(points: Array) -> tuple[Array, Array]:
    """`inertia` of contacts (n, 3).  Raises InputError for those that span no body."""
    try:
        return inertia(points)
    except QhullError:
        hulls.hull(points)  # raises InputError, which says why
        raise


def arcs_of_contacts(places: Places, tangents: Array, rows: Index, turns: Array) -> Arcs:
    """The arcs (k,) of some of the contacts, with errors (k,) of their tangents (n, 3), by all of them."""
    try:
        hull = ConvexHull(places.points)
    except QhullError:
        hull = ConvexHull(places.points, qhull_options="QJ")  # moved by rounding where very many lie in one plane
    vertices, edges = edges_of(hull)
    return arcs_at(places.select(rows), tangents[rows], turns, places.select(vertices), edges)


class HalfSpaces(NamedTuple):
    """Half-spaces (k,) of the world behind which the body lies on one side of a slice, by the slice's contacts."""

    planes: Array
    """(k, 4) a, unit vectors, and b of ``a·x + b <= 0``."""
    straight: Mask
    """(k,) whether the body goes on straight on the slice's other side, as far as slices along one axis tell."""
    points: Array
    """(k, 3) the contacts, where slices along several axes cut them into cells; else (0, 3)."""

    def select(self, rows: Mask) -> HalfSpaces:
        return HalfSpaces(
            self.planes[rows], self.straight[rows], self.points[rows] if len(self.points) else self.points
        )


def by_secants(stack: SliceStack, i: int, side: int, margin: float) -> HalfSpaces:
    """The half-spaces of slice i that hold below it (`side` 0) or above it (1), by secants from the slices on its other side.

    There are none where the errors of heights and places, which are at most `margin`, leave the slopes unknown.
    """
    slice_, below, above = stack.slices[i], stack.slices[:i][::-1], stack.slices[i + 1 :]
    behind, ahead = (below, above) if side else (above, below)
    anchors = _anchors(stack, behind, slice_)
    if not anchors or not len(slice_.angle):
        return HalfSpaces(np.empty((0, 4)), np.empty(0, dtype=bool), np.empty((0, 3)))
    normals = np.stack([np.cos(slice_.angle), np.sin(slice_.angle)], axis=1)
    slope = secants(slice_.value, slice_.height, anchors, normals, margin, stack.height_error)
    move = np.full(len(slope), margin)
    if stack.height_error:
        steepest = np.abs(slope)
        if beyond := _anchors(stack, ahead, slice_):
            from_ahead = secants(slice_.value, slice_.height, beyond, normals, margin, stack.height_error)
            steepest = np.maximum(steepest, np.abs(from_ahead))
        move += stack.height_error * steepest
    planes = _inclined(normals @ stack.frame[:2], stack.frame[2], slope, slice_.value, slice_.height, move)
    straight = _goes_on_straight(slice_, behind, ahead, normals)
    finite: Mask = np.asarray(np.isfinite(planes).all(axis=1))
    return HalfSpaces(planes, straight, np.empty((0, 3))).select(finite)


def _anchors(stack: SliceStack, others: tuple[Slice, ...], slice_: Slice) -> tuple[Slice, ...]:
    """Those of the slices on one side of a slice, from the nearest, that secants are taken from.

    If everything is exact, by concavity the nearest has the tightest.
    """
    if not (stack.confident or stack.height_error):
        return others[:1]
    # at twice the error the slope of the secant between two slices is infinite
    return tuple(b for b in others if abs(b.height - slice_.height) > 4.0 * stack.height_error)


def secants(
    value: Array, height: float, others: tuple[Slice, ...], normals: Array, margin: float, height_error: float
) -> Array:
    """The tightest slopes (k,) of secants from support lines at a height to other slices on one side of it.

    The lines have the unit normals (k, 2) and the values (k,).  Those to slices below bound the slope from above, those to
    slices above from below; they are infinite where the errors of heights and places leave the slope unknown.
    """
    rise = np.array([value + margin - (b.support_of_contacts(normals) - margin) for b in others])
    outwards = 1.0 if height > others[0].height else -1.0
    run = np.array([[height - b.height] for b in others]) - 2 * outwards * height_error * np.sign(rise)
    slopes = np.where(outwards * run > 0, ratio(rise, run), outwards * np.inf)
    return outwards * (outwards * slopes).min(axis=0)


def _inclined(outward: Array, along: Array, slope: Array, value: Array, height: Array | float, move: Array) -> Array:
    """The half-spaces (k, 4) ``<w, x> <= value + move + slope (<a, x> - height)`` with the normals w and the axis a."""
    with np.errstate(invalid="ignore"):
        normals = outward - slope[:, None] * along
        planes = np.column_stack([normals, slope * height - (value + move)])
        return np.asarray(planes / np.linalg.norm(normals, axis=1)[:, None])


def _goes_on_straight(slice_: Slice, behind: tuple[Slice, ...], ahead: tuple[Slice, ...], normals: Array) -> Mask:
    """Whether the body goes on straight behind a slice, at the slice's normals (k, 2).

    The slices behind it and ahead of it begin with the nearest.  Where none is ahead, as in a cap, slopes may differ by
    rounding only.
    """
    if len(behind) < 2:
        return np.zeros(len(normals), dtype=bool)
    nearest, next_ = behind[:2]
    beyond = ahead[0] if ahead else nearest
    h, h1, h2, h3 = (one.support_of_contacts(normals) for one in (slice_, nearest, next_, beyond))
    near, far = (h1 - h) / (nearest.height - slice_.height), (h2 - h1) / (next_.height - nearest.height)
    across = (h3 - h) / (beyond.height - slice_.height)
    closest = min(abs(slice_.height - nearest.height), abs(nearest.height - next_.height))
    rounding = ROUNDING * np.abs(slice_.value).max() / closest
    return np.abs(near - far) <= STRAIGHT * np.abs(near - across) + rounding


def by_arcs(cloud: Cloud, by_axis: Sequence[SliceStack]) -> tuple[list[list[list[HalfSpaces]]], float]:
    """The half-spaces of a cloud of exact contacts in slices along several axes, by arcs (S27): of each axis, side and slice.

    The second result is the largest distance of a contact from the plane of its slice.
    """
    error = exact_error(cloud)
    tangents = np.cross(cloud.in_plane_normals, cloud.slice_axis[cloud.slice])
    anywhere = replace(cloud, centre_points=cloud.points, tangents=tangents, rod_radius=0.0, table=None)
    tangent = tangent_planes(anywhere, np.full(len(cloud), error))
    ends = np.full((len(cloud), 2, 3), np.nan)
    ends[tangent.rows] = unit(tangent.arcs.ends() @ np.linalg.inv(tangent.shape))
    off = error + max(
        float(np.abs(slice_.height - cloud.points[slice_.rows] @ stack.frame[2]).max())
        for stack in by_axis
        for slice_ in stack.slices
    )
    sides: list[list[list[HalfSpaces]]] = []
    for stack in by_axis:
        along, found = stack.frame[2], list[list[HalfSpaces]]()
        for i, slice_ in enumerate(stack.slices):
            rows = np.intersect1d(slice_.rows, tangent.rows)
            outward, points = cloud.in_plane_normals[rows], cloud.points[rows]
            value = dot(outward, points)
            slopes = _slopes(ends[rows], outward, along)
            slopes = _narrowed(slopes, stack, i, outward @ stack.frame[:2].T, value, off)
            finite: Mask = np.asarray(np.isfinite(slopes))
            # past an end slice one slope is enough, since the cells on its other side reach beyond its plane
            last = len(stack.slices) - 1
            at_end = (finite[:, 0] & (i == 0) & (last > 0)) | (finite[:, 1] & (i == last) & (last > 0))
            usable = finite.all(axis=1) | at_end
            # a contact that lies off the plane of its slice has the other slope between the two
            move = error + 2 * off * np.where(finite, np.abs(slopes), 0.0).sum(axis=1)
            found.append(
                [
                    HalfSpaces(
                        _inclined(outward, along, slopes[:, side], value, slice_.height, move),
                        np.zeros(len(rows), dtype=bool),
                        points,
                    ).select(usable & finite[:, side])
                    for side in (0, 1)
                ]
            )
        sides.append([list(column) for column in zip(*found, strict=True)])
    return sides, off


def _slopes(ends: Array, outward: Array, along: Array) -> Array:
    """Least and largest slopes (n, 2) of planes whose normals are those at the ends (n, 2, 3) of their arcs.

    Contacts whose arcs are not known are confined by the slices next to theirs only.
    """
    level, rise = np.einsum("nej,nj->ne", ends, outward), ends @ along
    slopes = np.sort(np.where(level > NEGLIGIBLE, ratio(-rise, level), -np.copysign(np.inf, rise)), axis=1)
    unknown: Mask = np.asarray(np.isnan(ends).any(axis=(1, 2)))
    return np.where(unknown[:, None], [-np.inf, np.inf], slopes)


def _narrowed(slopes: Array, stack: SliceStack, i: int, normals: Array, value: Array, off: float) -> Array:
    """Least and largest slopes (n, 2) of the contacts of slice i, confined by the slices next to it as well.

    The arcs come from a search among the contacts, which may miss the one that confines a slope most.  The errors of places and
    heights are at most `off`; normals (n, 2) and values (n,) are those of the contacts' support lines.
    """
    found = slopes.copy()
    if i > 0:
        below = secants(value, stack.heights[i], stack.slices[i - 1 : i], normals, off, off)
        found[:, 1] = np.minimum(found[:, 1], below)
    if i + 1 < len(stack.slices):
        above = secants(value, stack.heights[i], stack.slices[i + 1 : i + 2], normals, off, off)
        found[:, 0] = np.maximum(found[:, 0], above)
    return np.where((found[:, 0] <= found[:, 1])[:, None], found, slopes)


# Distance of the planes that close the polytope where no normals are known, in sizes of the body.
_FAR = 300.0
# Gap relative to the body's size at which the refinement ends.
_CLOSE = 2e-5


class Cover(NamedTuple):
    """Triangles (m,) of normals that cover the sphere of directions."""

    planes: Index
    """(m, 3) numbers of the planes; negative for those far away."""
    apexes: Array
    """(m, 8, 3) for all choices of ends; infinite where one of the planes is far away."""
    nominal: Array
    """(m, 3) apexes of the planes with the middle normals, planes far away included."""
    removed: Index
    """Numbers of the planes that were left out because their triangles turned over."""


class Apexes(NamedTuple):
    """The apexes over the triangles (m,) of a cover."""

    cover: Cover
    gap: Array
    """(m,) largest distance of an apex from the inner body over all normals of the arcs; infinite where nothing bounds it."""

    @property
    def open(self) -> Mask:
        """(m,) whether nothing bounds the body in the triangle's directions."""
        return np.isinf(self.gap)

    @property
    def score(self) -> tuple[bool, float]:
        """Smaller for better apexes: those that close the body, and of these those with the smaller gap."""
        is_open = bool(self.open.any())
        return is_open, 0.0 if is_open else float(self.gap.max())


def best_apexes(planes: Arcs, distance: Callable[[Array], Array]) -> Apexes | None:
    """The apexes of the best choice among planes (n,), found by refinement; None if no choice has any.

    planes
        in a frame in which the body has the size of about 1 and its middle lies in the origin.
    distance
        of points (p, 3) from the inner body, convex and never negative, in that frame.
    """
    chosen = thinned(planes, 3.0, 0.2)
    usable = planes.half_width < 0.4  # with wider arcs triangles turn over
    known: dict[int, float] = {}
    stuck: set[int] = set()
    best: Apexes | None = None
    for _ in range(80):
        covering = cover(planes, chosen)
        if covering is None:
            return best
        usable[covering.removed] = False
        chosen = np.setdiff1d(chosen, covering.removed)
        codes = _codes(covering.planes, len(planes.points))
        apexes = Apexes(covering, _gaps(covering, codes, distance, known))
        if best is None or apexes.score <= best.score:
            best = apexes
        added, needless = _improvements(planes, apexes, codes, chosen, usable, stuck)
        usable[needless] = False
        if not len(added) and not len(needless):
            return best
        chosen = np.union1d(np.setdiff1d(chosen, needless), added)
    return best


def _codes(triangles: Index, count: int) -> list[int]:
    """Numbers of triangles (m, 3) of planes, of which there are `count` beside those far away."""
    far = len(_far_planes().points)
    ordered = np.sort(triangles, axis=1) + far
    base = count + far
    return ((ordered[:, 0] * base + ordered[:, 1]) * base + ordered[:, 2]).tolist()


def _gaps(covering: Cover, codes: list[int], distance: Callable[[Array], Array], known: dict[int, float]) -> Array:
    """The gaps (m,) of a cover's triangles; those in `known` are not computed again."""
    new = np.array([i for i, code in enumerate(codes) if code not in known], dtype=np.intp)
    gap = np.full(len(new), np.inf)
    closed = np.isfinite(covering.apexes[new, 0, 0])
    if closed.any():
        gap[closed] = distance(covering.apexes[new][closed].reshape(-1, 3)).reshape(-1, 8).max(axis=1)
    known.update(zip((codes[i] for i in new.tolist()), gap.tolist(), strict=True))
    return np.array([known[code] for code in codes])


def _improvements(
    planes: Arcs, apexes: Apexes, codes: list[int], chosen: Index, usable: Mask, stuck: set[int]
) -> tuple[Index, Index]:
    """Numbers of the planes to be added, and of those to be removed; triangles that no plane cuts off are added to `stuck`."""
    gap, nominal = apexes.gap, apexes.cover.nominal
    added = removed = np.empty(0, dtype=np.intp)
    candidates = np.flatnonzero(usable)
    # a plane nearer to a chosen one than its arc is wide would turn over their triangles
    if len(chosen) and len(candidates):
        apart = cKDTree(planes.middle[chosen]).query(planes.middle[candidates])[0]
        candidates = candidates[apart > planes.half_width[candidates]]
    free = np.flatnonzero((gap >= _CLOSE) & [code not in stuck for code in codes])
    while len(free) and not len(added):
        # from the farthest apexes on, until some can be cut off
        # those farther out than half the farthest one are cut off in one round, and no more than 60
        rows = free[np.argsort(-gap[free], kind="stable")][:60]
        rows = rows[gap[rows] >= 0.5 * gap[rows[0]]]
        free = np.setdiff1d(free, rows)
        cut = np.zeros(len(rows), dtype=bool)
        if len(candidates):
            depth = planes.select(candidates).depths(nominal[rows])
            deepest = depth.argmax(axis=1)
            cut = depth[np.arange(len(rows)), deepest] > 1e-7
            added = np.unique(candidates[deepest[cut]])
        stuck.update(codes[row] for row in rows[~cut].tolist())
    if not apexes.open.any() and gap.max() >= _CLOSE:
        # what no plane cuts off loses its plane with the widest arc, if it is nearly as far out as the farthest one
        held = [code in stuck for code in codes] & (gap >= 0.9 * gap.max())
        triangles = apexes.cover.planes[held]
        removed = np.unique(triangles[np.arange(len(triangles)), planes.half_width[triangles].argmax(axis=1)])
    return added, removed


def thinned(planes: Arcs, multiple: float, least: float) -> Index:
    """Numbers of planes, those with narrow arcs first, none nearer to an earlier one than `least` and `multiple` widths."""
    width = np.maximum(least, multiple * planes.half_width)
    known = np.flatnonzero(np.isfinite(width) & (width < 1))
    order = known[np.argsort(width[known], kind="stable")]
    accepted = np.empty((0, 3))
    chosen: list[Index] = []
    for rows in np.array_split(order, max(1, len(order) // 500)):
        limit = np.cos(width[rows])
        free = rows if not len(accepted) else rows[((planes.middle[rows] @ accepted.T).max(axis=1) < limit)]
        cosines = planes.middle[free] @ planes.middle[free].T
        kept: Mask = np.zeros(len(free), dtype=bool)
        for i, bound in enumerate(np.cos(width[free])):
            kept[i] = not (cosines[i, :i][kept[:i]] >= bound).any()
        chosen.append(free[kept])
        accepted = np.concatenate([accepted, planes.middle[free[kept]]])
    return np.concatenate(chosen) if chosen else np.empty(0, dtype=np.intp)


def cover(planes: Arcs, chosen: Index) -> Cover | None:
    """The triangles of some of the planes; None if the rounding is too large."""
    far = _far_planes()
    removed: list[Index] = [np.empty(0, dtype=np.intp)]
    while True:  # each time there are fewer planes
        some = far.joined(planes.select(chosen))
        offset = (some.middle * some.points).sum(axis=1)
        positive = offset > 1 / _FAR
        if not positive.all():
            removed.append(chosen[~positive[len(far.points) :]])
            chosen = chosen[positive[len(far.points) :]]
            continue
        triangles = _triangles(some.middle / offset[:, None])
        if triangles is None:
            return None
        determinant, apexes = _apexes(some, triangles)
        # the rounding of the apex of three nearly parallel planes is no longer small
        bad = ~(determinant > 1e-7)
        if not bad.any():
            numbers = np.concatenate([-1 - np.arange(len(far.points)), chosen])[triangles]
            apexes[(numbers < 0).any(axis=1)] = np.inf
            nominal = np.linalg.solve(some.middle[triangles], offset[triangles][..., None])[..., 0]
            return Cover(numbers, apexes, nominal, np.concatenate(removed))
        widest = np.unique(_needless(some, triangles[bad], len(far.points))) - len(far.points)
        widest = widest[widest >= 0]
        if not len(widest):
            return None
        removed.append(chosen[widest])
        chosen = np.delete(chosen, widest)


def _needless(planes: Arcs, triangles: Index, far: int) -> Index:
    """The plane (m,) of each triangle that turns over which is removed: that with the widest arc; the first `far` planes stay.

    Of planes with equally narrow arcs it is the one between the other two: planes through one edge of a polyhedron have their
    normals on an arc, and the outer ones matter.
    """
    normals = planes.middle[triangles]
    opposite = np.linalg.norm(np.roll(normals, -1, axis=1) - np.roll(normals, 1, axis=1), axis=2)
    # rounding does not choose between arcs that are narrower
    width = np.maximum(planes.half_width, 1e-5)[triangles] * (1 + 1e-3 * opposite)
    width[triangles < far] = -1.0
    return np.asarray(np.take_along_axis(triangles, width.argmax(axis=1)[:, None], axis=1)[:, 0])


def _far_planes() -> Arcs:
    normals = np.concatenate([np.eye(3), -np.eye(3), OCTANTS / np.sqrt(3)])
    # turned, so that no body's own normals are parallel to them
    first, _ = np.linalg.qr(np.array([[1.0, 0.37, 0.19], [-0.23, 1.0, 0.41], [0.13, -0.29, 1.0]]))
    normals = normals @ first.T
    across = np.cross(normals, np.roll(normals, 1, axis=1))
    return Arcs(_FAR * normals, normals, across, np.zeros(len(normals)))


def _triangles(dual: Array) -> Index | None:
    """The facets (m, 3) of the hull of points (n, 3) around the origin, counterclockwise from outside."""
    try:
        faces: Index = ConvexHull(dual).simplices.astype(np.intp)
    except (QhullError, ValueError):
        return None
    mirrored = np.linalg.det(dual[faces]) < 0
    faces[mirrored] = faces[mirrored, ::-1]
    return faces


def _apexes(planes: Arcs, triangles: Index) -> tuple[Array, Array]:
    """The smallest determinant (m,) over all choices of ends, and the apexes (m, 8, 3) of the choices."""
    ends = ((OCTANTS + 1) // 2).astype(np.intp)
    normals = planes.ends()[triangles]
    a, b, c = (normals[:, k, ends[:, k]] for k in range(3))
    points = planes.points[triangles]
    origin = points.mean(axis=1)
    offset = points - origin[:, None]
    bc, ca, ab = np.cross(b, c), np.cross(c, a), np.cross(a, b)
    determinant = (a * bc).sum(axis=2)
    heights = [(n * offset[:, None, k]).sum(axis=2)[..., None] for k, n in enumerate((a, b, c))]
    apexes = ratio(heights[0] * bc + heights[1] * ca + heights[2] * ab, determinant[..., None])
    return determinant.min(axis=1), apexes + origin[:, None]


# --- where errors are not negligible ---


class Outer(NamedTuple):
    """Triangles (m,) over all directions from the centre, behind which a body lies."""

    corners: Array
    """(m, 3, 3); infinite where nothing bounds the body."""
    gap: Array
    """(m,) the largest distance of a corner from the inner body."""
    directions: Array
    """(m, 3) of the triangles from the centre, not of unit length."""
    centre: Array
    """(3,)"""


def outer_body(cloud: Cloud, places: Places, turns: Array, inner: Any) -> Outer:
    """The outer body by contacts with uncertain centre points, and errors (n,) of their tangents in radians.

    inner
        a convex `trimesh.Trimesh`, from which distances are measured.
    """
    centre, shape = frame_of(places.points)
    normals, values = _wedges(cloud, places, turns, centre)
    sphere = trimesh.creation.icosphere(subdivisions=3)
    directions, triangles = sphere.vertices.view(np.ndarray) @ shape, sphere.faces.view(np.ndarray)
    distance = nearest_on(inner)
    normals_of_inner = face_normals(inner)
    planes = np.column_stack([normals_of_inner, dot(normals_of_inner, inner.triangles[:, 0] - centre)])

    def gaps(points: Array) -> Array:
        found = np.full(len(points), np.inf)
        finite = np.isfinite(points).all(axis=1)
        found[finite] = np.maximum(distance(points[finite])[0], 0.0)
        return found

    reach, beyond, known = np.empty((0, len(values))), np.empty((0, len(values))), 0.0
    parts: list[tuple[Array, Array, Index]] = []
    for left in reversed(range(6)):  # rounds in which triangles are divided into four
        new = directions[len(reach) :]
        entered = _entered(normals, values, new)
        outside = (entered - _leaves(planes, new)[:, None]) * np.linalg.norm(new, axis=1)[:, None]
        reach, beyond = np.concatenate([reach, entered]), np.concatenate([beyond, outside])
        with np.errstate(invalid="ignore"):
            known = max(known, float(gaps(centre + entered.min(axis=1)[:, None] * new).max(initial=0.0)))
        entered = reach[triangles, _best(beyond, triangles)[:, None]]
        bounded = np.isfinite(entered).all(axis=1)
        corners = np.full((len(triangles), 3, 3), np.inf)
        corners[bounded] = centre + entered[bounded, :, None] * directions[triangles[bounded]]
        gap = gaps(corners.reshape(-1, 3)).reshape(-1, 3).max(axis=1)
        coarse = ~(gap <= 1.03 * known) & (left > 0)  # more precisely the wedges need not be followed
        parts.append((corners[~coarse], gap[~coarse], triangles[~coarse]))
        if not coarse.any():
            break
        directions, triangles = _divided(directions, triangles[coarse])
    corners, gap, triangles = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Outer(corners, gap, directions[triangles].mean(axis=1), centre)


def _wedges(cloud: Cloud, places: Places, turns: Array, centre: Array) -> tuple[Array, Array]:
    """Planes that bound the wedges (k,): normals (k, 4, 3), and their values (k, 4) from the centre, all above 0.

    The first stands for none: no direction enters it.
    """
    assert cloud.tangents is not None
    # of more contacts neighbours say nearly the same
    rows = evenly(tangential(cloud), 4000)
    arcs = arcs_of_contacts(places, cloud.tangents, rows, turns[rows])
    known = np.isfinite(arcs.half_width)
    own, ends = places.select(rows[known]), arcs.ends()[known]
    tangents, turn = cloud.tangents[rows[known], None], turns[rows[known], None]
    normals = np.concatenate([ends - turn[..., None] * tangents, ends + turn[..., None] * tangents], axis=1)
    error = own.along(ends) + turn * own.along(tangents)
    values = (normals * (own.points - centre)[:, None]).sum(axis=2) + np.tile(error, 2)
    if cloud.table is not None:
        normals = np.concatenate([normals, np.tile([0.0, 0.0, -1.0], (1, 4, 1))])
        values = np.concatenate([values, np.full((1, 4), centre[2] - (cloud.table - cloud.rod_radius))])
    outside = (values > NEGLIGIBLE * np.abs(values).max(initial=0.0)).all(axis=1)
    return np.concatenate([np.zeros((1, 4, 3)), normals[outside]]), np.concatenate([np.ones((1, 4)), values[outside]])


def _entered(normals: Array, values: Array, directions: Array) -> Array:
    """(v, k) where rays from the centre enter wedges, in lengths of the directions (v, 3); infinite where they do not."""
    parts = [np.empty((0, len(values)))]
    for block in np.array_split(directions, 1 + directions.shape[0] * values.size // AT_ONCE):
        along = np.einsum("vx,kex->vke", block, normals)
        parts.append(np.where(along > 0, ratio(values, np.maximum(along, 0.0)), np.inf).max(axis=2))
    return np.concatenate(parts)


def _leaves(planes: Array, directions: Array) -> Array:
    """(v,) where rays from the centre leave the convex body with the planes (f, 4), a normal and its value from the centre."""
    parts = []
    for block in np.array_split(directions, 1 + len(directions) * len(planes) // AT_ONCE):
        along = block @ planes[:, :3].T
        parts.append(np.where(along > 0, ratio(planes[:, 3], along), np.inf).min(axis=1))
    return np.concatenate(parts)


def _best(beyond: Array, triangles: Index) -> Index:
    """(m,) numbers of the wedges that leave least in the triangles, by how far (v, k) they begin beyond the inner body."""
    blocks = np.array_split(triangles, 1 + triangles.size * beyond.shape[1] // AT_ONCE)
    return np.concatenate([beyond[block].max(axis=1).argmin(axis=1) for block in blocks])


def _divided(vertices: Array, triangles: Index) -> tuple[Array, Index]:
    """The vertices with the middles of the sides of triangles (m, 3), and the triangles' quarters (4 m, 3)."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    sides, number = np.unique(sides, axis=0, return_inverse=True)
    a, b, c = triangles.T
    ab, bc, ca = (number.reshape(-1, 3) + len(vertices)).T
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return (
        np.concatenate([vertices, vertices[sides].mean(axis=1)]),
        np.concatenate([np.stack(quarter, axis=1) for quarter in quarters]),
    )
