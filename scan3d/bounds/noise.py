"""What noisy contacts prove of a slice, with a stated confidence: a polygon inside the body's section and one around it.

Premises: the body is convex, and the errors of the reactions are independent from row to row, Gaussian, and have the standard
deviations that the recording states.  To first order, everything that is said about one contact is then a linear function of
three standard normal numbers.  All such functions together stay within κ of their standard deviations with the probability
that the χ² distribution of three degrees of freedom assigns to κ²; κ is chosen so that this holds for all contacts and
averages at once (Bonferroni).

Notation: a contact at p̂ with the normal n̂ and the tangent t̂ in the slice's plane was truly at p, with the normal n; its place
has the covariance C, its normal's angle the standard deviation σδ.  K is the true section.

Inside.  K contains p, so that its support function is at least ``<u, p̂> - κ √(uᵀCu)`` in every direction u.  The largest of
these numbers over all contacts, g(u), bounds the support function from below, and the polygon ``{x: <u, x> <= g(u)}`` lies in
K.  Errors along the contour, which are large where the rod hardly touches, hardly matter in this polygon.

Outside.  For all x of K, ``<n, x - p> <= 0``, and hence ``<n̂, x - p̂> <= κ √(n̂ᵀCn̂) + κ σδ |<t̂, x - p̂>|`` up to the product of
two errors.  Where a polygon around K is known, the distance along t̂ is limited to the part of that polygon that lies beyond
the line through p̂, and the line need only be moved by what remains: on a curved body that part is short, on a flat face it is
the face.  This is repeated with the polygon of the lines so moved.  The first polygon is a rectangle; if the lines moved by its
extents enclose a polygon in the rectangle's interior, then K lies in that polygon, since K is connected.

Averages.  The mean of several points of K lies in K, and the mean of several of these inequalities holds for all x of K.  Means
over successive rows of a sweep have smaller errors and lie a little inside or outside; the polygons take both.  Errors of
rounding alone are not independent, but within √3 of their standard deviations; there are no averages then.

Calibration.  Where a calibrated rig corrected the poses and reactions, its errors are the same in all contacts, and no average
reduces them.  They are p normal numbers; to the first order the errors of all contacts are linear functions of these, and with
the factor ``√χ²_p`` all hold at once (Scheffé).  Within the plane, reaches and lines allow for them as for noise.  A polygon
inside may differ in height from points of the body by the largest error of a contact's height.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.special import chdtrc, chdtri

from scan3d.arrays import Array, Index, Mask, evenly, ranges
from scan3d.bounds.constraints import AVERAGED, Allowed
from scan3d.cloud import Cloud
from scan3d.reconstruction.slices import Slice, SliceStack

# Directions, beside the contacts' normals, in which the contacts are searched that bound the inner polygon, and beside its
# sides those of the outer polygon's support function; none of these where the slice's contacts differ in height, because the
# lines that meet in a corner then hold at different heights.
_DIRECTIONS = 90
# Support lines and directions of single contacts in a slice, and about as many averages of one size, at most: the time grows
# with their number.
_SINGLE = 1000
# Groups of contacts where rows have contradicted the rest.
_GROUPS = 2


def confident(stack: SliceStack, cloud: Cloud, allow: Allowed) -> SliceStack:
    """The stack with slices whose points lie in the body's section, and whose support lines enclose it.

    Slices whose contacts prove no point of the body are left out.  Points and lines allow for noise and, within the slices'
    planes, for the calibration; a margin of the stack's `height_error` allows for the poses.
    """
    if cloud.covariance is None:  # exact reactions of a rig that is not known exactly
        cloud = replace(
            cloud, covariance=np.zeros((len(cloud), 3, 3)), normal_sd=np.zeros(len(cloud)), independent=False
        )
    slices = (_slice_of_groups(slice_, stack, cloud, allow) for slice_ in stack.slices)
    return replace(stack, slices=tuple(slice_ for slice_ in slices if slice_ is not None), confident=True)


def _slice_of_groups(slice_: Slice, stack: SliceStack, cloud: Cloud, allow: Allowed) -> Slice | None:
    """The slice by all contacts, or of groups of them where rows have contradicted the rest, one of which holds everywhere."""
    if cloud.left_out is None:
        return _confident_slice(slice_, stack, cloud, allow)
    chosen = [cloud.row[slice_.rows] % _GROUPS == k for k in range(_GROUPS)]
    if not all(rows.any() for rows in chosen):  # of so few contacts one group says nothing
        return None
    groups = [_confident_slice(_of_group(slice_, rows), stack, cloud, allow) for rows in chosen]
    found = [group for group in groups if group is not None]
    if len(found) < _GROUPS:
        return None
    inside, margin = slice_.points.mean(axis=0), stack.height_error
    corners = np.concatenate([group.outline for group in found])
    sides = np.concatenate([np.roll(group.outline, -1, axis=0) - group.outline for group in found])
    length = np.linalg.norm(sides, axis=1)
    normals = np.stack([sides[:, 1], -sides[:, 0]], axis=1)[length > 0] / length[length > 0, None]
    inner = polygon_of_lines(normals, (normals * corners[length > 0]).sum(axis=1), inside)
    if inner is None:
        return None
    angle, value = np.empty(0), np.empty(0)
    outer = [polygon_of_lines(group.normals, group.value + margin, inside) for group in found if len(group.angle)]
    known = [polygon[0] for polygon in outer if polygon is not None]
    if len(known) == _GROUPS:
        angle = np.unique(np.concatenate([group.angle for group in found]))
        # the lines of a corner may hold at different heights, which `margin` remains for
        value = (_directions(angle) @ np.concatenate(known).T).max(axis=1)
    return replace(found[0], points=inner[0], angle=angle, value=value, normals=_directions(angle))


def _of_group(slice_: Slice, chosen: Mask) -> Slice:
    """The slice with some of its contacts (n,)."""
    kept = chosen[slice_.tangential]
    number = np.cumsum(chosen) - 1
    return replace(
        slice_,
        rows=slice_.rows[chosen],
        points=slice_.points[chosen],
        tangential=number[slice_.tangential[kept]],
        normals=slice_.normals[kept],
    )


def _confident_slice(slice_: Slice, stack: SliceStack, cloud: Cloud, allow: Allowed) -> Slice | None:
    assert cloud.covariance is not None
    assert cloud.normal_sd is not None
    kappa = allow.kappa or 0.0
    order = np.lexsort((cloud.row[slice_.rows], cloud.sweep[slice_.rows]))
    rows, frame = slice_.rows[order], stack.frame
    covariance = np.einsum("ij,njk,lk->nil", frame[:2], cloud.covariance[rows], frame[:2])
    points = slice_.points[order]
    known = np.zeros(len(rows), dtype=bool)
    known[slice_.tangential] = True
    normals = np.full((len(rows), 2), np.nan)
    normals[slice_.tangential] = slice_.normals
    # errors of the second order must be small
    lines = (known & (kappa * cloud.normal_sd[slice_.rows] < 0.3))[order]
    measured = np.arctan2(normals[order][lines, 1], normals[order][lines, 0])
    sweep = cloud.sweep[rows] if cloud.independent else None
    rig = np.zeros_like(covariance)
    if cloud.calibration is not None:
        of_rig = cloud.calibration.covariance[rows]
        rig = allow.factor**2 * np.einsum("ij,njk,lk->nil", frame[:2], of_rig, frame[:2])
    inner = _inner_polygon(points, (covariance, rig), sweep, measured, kappa, cloud.rod_length)
    if inner is None:
        return None
    # poses that are off move the lines outwards as well, and the corners of their polygon by more than the lines
    off = stack.height_error * (1 + kappa * cloud.normal_sd[rows][lines])
    angle, value, normals = np.empty(0), np.empty(0), normals[order][lines]
    if len(normals) >= 3:
        places, of_normals = points[lines] + off[:, None] * normals, cloud.normal_sd[rows][lines]
        of_errors = tuple(np.broadcast_to(part, len(cloud))[rows][lines] for part in (allow.across, allow.tilt))
        of_lines = None if sweep is None else sweep[lines]
        moved = _lines(places, normals, covariance[lines], of_normals, of_errors, of_lines, kappa, cloud.rod_length)
        angle, value = _outer_lines(*moved, places, inner, 0 if stack.height_error else _DIRECTIONS)
    return replace(
        slice_,
        points=inner,
        angle=angle,
        value=value - stack.height_error,
        normals=np.stack([np.cos(angle), np.sin(angle)], axis=1),
        tangential=np.empty(0, dtype=np.intp),
        tip=np.empty(0, dtype=np.intp),
        tip_normals=np.empty((0, 2)),
        slope=np.empty((2, 0)),
        corner=np.empty((0, 2, 2)),
    )


def _bias(covariance: Array, length: float) -> Array:
    """(n,) allowance for the second order of a contact's errors, which averages do not reduce."""
    return np.trace(covariance, axis1=1, axis2=2) * 2 / length


def _inner_polygon(
    points: Array,
    covariances: tuple[Array, Array],
    sweep: NDArray[np.int32] | None,
    measured: Array,
    kappa: float,
    length: float,
) -> Array | None:
    """Corners (v, 2), in order, of a polygon inside the section; None if the contacts prove no point of it.

    covariances (n, 2, 2)
        by the noise, and by the calibration times the square of its factor.
    sweep (n,)
        number of each contact's sweep; None if the errors of successive rows are not independent.
    measured (k,)
        angles of the contacts' normals, in whose directions those contacts are likely to reach farthest.
    """
    covariance, rig = covariances
    smallest = np.linalg.eigvalsh(covariance)[:, 0]
    averages = averages_of(points, sweep, np.maximum(smallest, 1e-6 * np.trace(covariance, axis1=1, axis2=2)), kappa)
    bias = _bias(covariance, length)
    means, _ = _with_single(averages, len(points), kappa)
    place, spread, biased, sigma = means.mean(points), means.variance(covariance), means.mean(bias), means.kappa
    entries = np.stack([spread[:, 0, 0], spread[:, 0, 1], spread[:, 1, 1]], axis=1)
    # the largest error of a mean by the calibration is at most the root of the mean square
    shifts = means.mean(rig)
    of_rig = np.stack([shifts[:, 0, 0], shifts[:, 0, 1], shifts[:, 1, 1]], axis=1) if rig.any() else None

    def reach(u: Array) -> Array:
        """(d, n) how far in the directions (d, 2) each contact and average proves the body to reach."""
        quadratic = np.stack([u[:, 0] ** 2, 2 * u[:, 0] * u[:, 1], u[:, 1] ** 2], axis=1)
        proven: Array = u @ place.T
        off = np.maximum(quadratic @ entries.T, 0.0)
        proven -= np.multiply(sigma, np.sqrt(off, out=off), out=off)
        proven -= biased
        return proven if of_rig is None else proven - np.sqrt(np.maximum(quadratic @ of_rig.T, 0.0))

    inside = points.mean(axis=0)
    # First directions that are evenly spread, and the normals; then those of the sides that join the points which these prove:
    # a polygon with other sides would have its corners outside the body.
    uniform = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS - np.pi
    first = _directions(np.unique(np.concatenate([uniform, evenly(measured, _SINGLE)])))
    proven = reach(first)
    best = proven.argmax(axis=1)
    deflated = place[best] - (sigma[best] * np.sqrt(_quadratic(first, spread[best])))[:, None] * first
    try:
        sides = ConvexHull(deflated).equations[:, :2]
    except QhullError:
        return None
    angle = np.unique(np.concatenate([np.arctan2(sides[:, 1], sides[:, 0]), np.arctan2(first[:, 1], first[:, 0])]))
    u = _directions(angle)
    proven = reach(u)
    support = proven.max(axis=1)
    excess = _excess(u, reach, proven)
    corners = polygon_of_lines(u, support - np.maximum(excess, np.roll(excess, 1)), inside)
    return None if corners is None else corners[0]


def _excess(u: Array, reach: Callable[[Array], Array], proven: Array) -> Array:
    """(d,) by how much the polygon of the reaches (d, n) in directions u may exceed them between each one and the next.

    Between two neighbouring directions the polygon's support function is at most the interpolation of g, and g is at least
    that of one contact's reach: of the contact that reaches farthest halfway, or at one of the two.
    """
    support, each = proven.max(axis=1), np.arange(len(u))
    after = np.roll(each, -1)
    halfway = u + u[after]
    halfway /= np.linalg.norm(halfway, axis=1)[:, None]
    farthest = proven.argmax(axis=1)
    candidates = np.stack([farthest, farthest[after], reach(halfway).argmax(axis=1)])
    ends = support - proven[each, candidates], support[after] - proven[after, candidates]
    return np.asarray(np.maximum(*ends).min(axis=0))


def _directions(angle: Array) -> Array:
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _quadratic(directions: Array, covariance: Array) -> Array:
    """(n,) variances in directions (n, 2) of places with covariances (n, 2, 2)."""
    value: Array = np.einsum("ni,nij,nj->n", directions, covariance, directions)
    return np.maximum(value, 0.0)


def _lines(
    points: Array,
    normals: Array,
    covariance: Array,
    normal_sd: Array,
    of_rig: tuple[Array, ...],
    sweep: NDArray[np.int32] | None,
    kappa: float,
    length: float,
) -> tuple[Array, Callable[[Array], Array]]:
    """Normals (k, 2) of the support lines of contacts (n,), and of means of several, and a function of the corners (v, 2) of a
    polygon around the section, which gives their values (k,), moved outwards by their errors.

    of_rig
        (n,) largest errors of places across the lines, and of the lines' angles, by the calibration.
    """
    tangents = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    across, along = (np.sqrt(_quadratic(u, covariance)) for u in (normals, tangents))
    means, alone = _with_single(averages_of(points, sweep, across**2, kappa), len(points), kappa)
    row, group, kappas = means.row, means.group, means.kappa
    middle, normal = means.mean(points), means.mean(normals)
    size = np.linalg.norm(normal, axis=1)
    normal /= size[:, None]
    apart = (tangents[row] * (middle[group] - points[row])).sum(axis=1)
    aslant = (tangents[row] * normal[group]).sum(axis=1)
    arm, turn = (
        np.sqrt(np.bincount(group, (means.weight * normal_sd[row] * part) ** 2, len(kappas)))
        for part in (apart, aslant)
    )
    # errors of the calibration have the same sign in all lines
    rig_across, rig_tilt = (means.mean(column) for column in of_rig)
    rig_across += np.bincount(group, means.weight * of_rig[1][row] * np.abs(apart), len(kappas))
    tilt = kappas * np.sqrt(means.variance(normal_sd**2)) + rig_tilt
    # the product of two errors has a mean, which averaging keeps, and that of a single contact is the product of the largest
    products = tilt * kappas * means.mean(along) + means.mean(_bias(covariance, length))
    products = np.where(alone, products, 2 * means.mean(normal_sd * along))
    offset, across_normal = means.mean((normals * points).sum(axis=1)) / size, normal[:, ::-1] * [-1.0, 1.0]
    move = kappas * (np.sqrt(means.variance(across**2)) + arm) + rig_across + products
    turn, scale = np.where(alone, 0.0, kappas * turn + rig_tilt), np.where(alone, 1 - tilt**2, size)

    def values(corners: Array) -> Array:
        extent, height = beyond(corners, middle, normal, across_normal, offset)
        return offset + (move + tilt * extent + turn * height) / scale

    return normal, values


def _outer_lines(
    normals: Array, moved: Callable[[Array], Array], points: Array, inner: Array, between: int
) -> tuple[Array, Array]:
    """Angles (a,), increasing, and values (a,) of support lines that enclose the section; none if they do not close.

    normals, moved
        of the lines, as from `_lines`, of contacts at points (n, 2).
    between
        number of directions beside those of the polygon's sides.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    box_normals = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]])
    normals = np.concatenate([normals, box_normals])
    # by this fraction of the contacts' size, on each side; the second is tried where the first is too small
    for widened in float(np.linalg.norm(high - low)) * np.array([0.1, 2.0]):
        box = np.concatenate([high + widened, -(low - widened)])
        found = polygon_of_lines(box_normals, box, inner.mean(axis=0))
        for _ in range(4):
            if found is not None:
                found = polygon_of_lines(normals, np.append(moved(found[0]), box), inner.mean(axis=0))
        # the rectangle proves nothing where it bounds the polygon itself
        if found is not None and found[1].max() < len(normals) - len(box):
            corners, sides = found
            uniform = 2 * np.pi * np.arange(between) / max(between, 1) - np.pi
            angle = np.unique(np.concatenate([np.arctan2(normals[sides, 1], normals[sides, 0]), uniform]))
            return angle, (_directions(angle) @ corners.T).max(axis=1)
    return np.empty(0), np.empty(0)


class Averages(NamedTuple):
    """Weighted means over several rows, as a list of terms: mean k has the terms with ``group == k``."""

    row: Index
    """(t,)"""
    group: Index
    """(t,) increasing"""
    weight: Array
    """(t,) of sum 1 in each group"""
    kappa: Array
    """(g,) standard deviations within which all these means stay"""

    def mean(self, values: Array) -> Array:
        """(g, ...) means of values (n, ...)."""
        return self._sums(values[self.row] * self._shaped(self.weight, values))

    def variance(self, values: Array) -> Array:
        """(g, ...) variances of the means of independent quantities with variances (n, ...)."""
        return self._sums(values[self.row] * self._shaped(self.weight**2, values))

    def _sums(self, terms: Array) -> Array:
        if not len(self.kappa):
            return terms
        return np.add.reduceat(terms, np.searchsorted(self.group, np.arange(len(self.kappa))))

    @staticmethod
    def _shaped(weight: Array, values: Array) -> Array:
        return weight.reshape(-1, *[1] * (values.ndim - 1))


def _with_single(means: Averages, count: int, kappa: float) -> tuple[Averages, Mask]:
    """The means of so many rows with means of single rows before them, and which (g,) these are."""
    single = evenly(np.arange(count), _SINGLE)
    joined = Averages(
        np.append(single, means.row),
        np.append(np.arange(len(single)), len(single) + means.group),
        np.append(np.ones(len(single)), means.weight),
        np.append(np.full(len(single), kappa), means.kappa),
    )
    return joined, np.arange(len(joined.kappa)) < len(single)


def averages_of(points: Array, sweep: NDArray[np.int32] | None, variance: Array, kappa: float) -> Averages:
    """Means over successive rows of each sweep, and over such runs of several sweeps that lie beside each other.

    Runs are fixed by the order of the rows, so that the errors do not choose what is averaged.  Which runs of other sweeps lie
    beside one is judged by the noisy points; each has at most three for that, which κ allows for.  The weights are
    inverse to the variances (n,).  There are no means where `sweep` is None, because the errors are not independent.
    """
    if sweep is None:
        return Averages(np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp), np.empty(0), np.empty(0))
    largest = float(variance.max(initial=0.0))
    # noise far below rounding may underflow to variances of 0
    scaled = np.maximum(variance / largest, np.finfo(float).tiny) if largest > 0 else np.ones(len(variance))
    rows, groups, weights, kappas, count = [], [], [], [], 0
    start = np.flatnonzero(np.diff(sweep, prepend=sweep[:1] - 1))
    within = np.arange(len(sweep)) - np.repeat(start, np.diff(start, append=len(sweep)))
    for size in AVERAGED:
        if len(points) > size * _SINGLE and size != AVERAGED[-1]:
            continue
        run = np.cumsum(within % size == 0) - 1
        number = np.bincount(run)
        middle = np.stack([np.bincount(run, column) for column in points.T], axis=1) / number[:, None]
        half = np.sqrt(np.bincount(run, ((points - middle[run]) ** 2).sum(axis=1)) / number)
        first = np.searchsorted(run, np.arange(len(number)))
        beside = _beside(middle, 2 * half, sweep[first])
        members = [np.arange(len(number))[:, None], np.column_stack([np.arange(len(number)), beside])]
        for runs in members:
            own, other = np.nonzero(runs >= 0)
            other = runs[own, other]
            member, offset = ranges(number[other])
            row, group = first[other][member] + offset, own[member]
            weight = 1 / scaled[row]
            rows.append(row)
            groups.append(group + count)
            weights.append(weight / np.bincount(group, weight)[group])
            choices = 3.0 ** np.maximum((runs >= 0).sum(axis=1) - 1.0, 0)
            kappas.append(np.sqrt(chdtri(3, chdtrc(3, kappa**2) / choices)))  # of an event among so many
            count += len(number)
    return Averages(np.concatenate(rows), np.concatenate(groups), np.concatenate(weights), np.concatenate(kappas))


def _beside(middle: Array, reach: Array, sweep: NDArray[np.int32]) -> Index:
    """(r, s) the nearest run of each other sweep, -1 where it is farther than `reach` (r,) or of the same sweep."""
    beside = []
    for number in np.unique(sweep):
        runs = np.flatnonzero(sweep == number)
        distance = np.linalg.norm(middle[:, None] - middle[runs], axis=2)
        nearest = distance.argmin(axis=1)
        close = (distance[np.arange(len(middle)), nearest] <= reach) & (sweep != number)
        beside.append(np.where(close, runs[nearest], -1))
    return np.stack(beside, axis=1)


def beyond(corners: Array, points: Array, normals: Array, tangents: Array, offset: Array) -> tuple[Array, Array]:
    """Extents of the part of a convex polygon that lies beyond lines (k,): along each line from its point, and across.

    Both (k,); 0 where the polygon does not reach beyond the line.
    """
    across = normals @ corners.T - offset[:, None]
    along = tangents @ corners.T - (tangents * points).sum(axis=1)[:, None]
    height, is_beyond = np.maximum(across.max(axis=1), 0.0), across >= 0
    extent = np.where(is_beyond, np.abs(along), 0.0).max(axis=1)
    # where a side of the polygon crosses the line
    line, side = np.nonzero(is_beyond != np.roll(is_beyond, -1, axis=1))
    following = (side + 1) % len(corners)
    a, b = across[line, side], across[line, following]
    crossing = along[line, side] + (along[line, following] - along[line, side]) * a / (a - b)
    np.maximum.at(extent, line, np.abs(crossing))
    return extent, height


def polygon_of_lines(normals: Array, value: Array, inside: Array) -> tuple[Array, Index] | None:
    """Corners (v, 2), in order, of the polygon ``<normals, x> <= value``, and the lines (s,) that bound it.

    None if `inside` (2,) does not lie in its interior, or if it is not bounded.
    """
    distance = value - normals @ inside
    if not (distance > 0).all():
        return None
    dual = normals / distance[:, None]
    try:
        dual_hull = ConvexHull(dual / np.abs(dual).max())
    except QhullError:
        return None
    equations = dual_hull.equations
    if not (equations[:, 2] < 0).all():
        return None
    corners = -equations[:, :2] / equations[:, 2:] / np.abs(dual).max()
    corners = corners[np.argsort(np.arctan2(corners[:, 1], corners[:, 0]))]
    return inside + corners, np.asarray(dual_hull.vertices, dtype=np.intp)
