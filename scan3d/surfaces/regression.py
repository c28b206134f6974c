"""Convex regression: the polytope that fits noisy contacts best, weighted by their covariances.

The outermost of many noisy contacts lie outside the body by several standard deviations, and so does the hull of all.  Here
the body is the intersection of half-spaces ``<u_k, x> <= h_k``, whose planes are fitted to the contacts by least squares.  A
contact belongs to the plane over which it lies highest, ``max_k (<u_k, x> - h_k)``, which for a contact inside the polytope is
the nearest, and its misfit is that height over its standard deviation across the plane.  Assignment and least squares
alternate.  Planes are split in two where their contacts bend inwards by more than noise explains, and left out where the misfit
hardly rises without them, so that a flat face becomes one plane and a curved part many.

Source: A. Magnani and S. Boyd, *Convex piecewise-linear fitting*, Optimization and Engineering 10 (2009) 1-17 (alternation);
L. Hannah and D. Dunson, *Multivariate convex regression with adaptive partitioning*, Journal of Machine Learning Research 14
(2013) 3261-3294 (splits).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import AT_ONCE, NEGLIGIBLE, ROUNDING, SOME, Array, Index, Mask, across, unit
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import cut_polytope, hull
from scan3d.reconstruction.slices import stacks

# Decrease of the sum of squared misfits for which a plane is added, and below which it is left out. Its three parameters alone
# explain 3 on average; Akaike's criterion asks for 6.
_GAIN = 10.0
# Contacts of a plane at least, which has three parameters; a half of a split plane has twice as many.
_FEWEST = 4
# Standard deviation of a plane's turn in one step, in radians, and its largest tangent. It keeps planes whose contacts lie on a
# line from turning about it.
_TURN = 0.3


class Contacts(NamedTuple):
    """Places (n, 3) of contacts, and their uncertainty."""

    points: Array
    covariance: Array
    """(n, 6) entries xx, yy, zz, xy, xz, yz of the covariance."""
    floor: Array
    """(n,) variance added in every direction."""

    def variance(self, normals: Array) -> Array:
        """(n,) variances across planes with normals (n, 3)."""
        x, y, z = normals.T
        products = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z], axis=1)
        return np.maximum((self.covariance * products).sum(axis=1), 0.0) + self.floor


@dataclass(frozen=True)
class Planes:
    """Planes ``<normal, x> = offset`` with outward normals (k, 3) and offsets (k,)."""

    normals: Array
    offsets: Array

    def __len__(self) -> int:
        return len(self.offsets)

    def heights(self, points: Array, plane: Index) -> Array:
        """(n,) heights of points (n, 3) over one plane each."""
        return (points * self.normals[plane]).sum(axis=1) - self.offsets[plane]

    def highest(self, points: Array) -> Index:
        """(n, 2) planes that the points (n, 3) lie highest over, and second highest."""
        found = np.empty((len(points), 2), dtype=np.intp)
        for block in np.array_split(np.arange(len(points)), 1 + len(points) * len(self) // AT_ONCE):
            heights = points[block] @ self.normals.T - self.offsets
            rows = np.arange(len(heights))
            found[block, 0] = heights.argmax(axis=1)
            heights[rows, found[block, 0]] = -np.inf
            found[block, 1] = heights.argmax(axis=1)
        return found

    def select(self, kept: Array) -> Planes:
        return Planes(self.normals[kept], self.offsets[kept])


def regression(cloud: Cloud) -> tuple[Any, int]:
    """Convex surface fitted to a cloud with covariances, a `trimesh.Trimesh`, and its number of planes.

    Raises InputError for a cloud without covariances, and for contacts that do not span a body.
    """
    if cloud.covariance is None:
        raise InputError(
            "the method regression weights the contacts by the noise of force and moment, and this recording states none; "
            "state the noise, or use auto, bracket or hull"
        )
    cloud = cloud.select(np.flatnonzero(np.isfinite(cloud.points).all(axis=1)))
    contacts, rows = _contacts(cloud)
    planes = fit_planes(contacts, _groups(contacts.points, cloud.normals[rows]))
    return _body(cloud, contacts.points, planes), len(planes)


def _contacts(cloud: Cloud) -> tuple[Contacts, Index]:
    """The contacts that are fitted, and their rows of the cloud."""
    assert cloud.covariance is not None
    rows = np.arange(len(cloud))[:: max(1, -(-len(cloud) // SOME))]
    entries = cloud.covariance[rows][:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return Contacts(cloud.points[rows], entries, cloud.least_variance()[rows]), rows


def _groups(points: Array, normals: Array) -> Index:
    """(n,) numbers of the groups in which contacts are fitted first: those of like normals, or of like places where unknown."""
    from trimesh.creation import icosphere

    known = np.isfinite(normals[:, 0])
    direction = np.where(known[:, None], normals, points - points.mean(axis=0))
    if known.any():
        direction[~known] = normals[known][cKDTree(points[known]).query(points[~known])[1]]
    return (direction @ icosphere(subdivisions=1).vertices.view(np.ndarray).T).argmax(axis=1)


def fit_planes(contacts: Contacts, group: Index) -> Planes:
    """The planes fitted to contacts (n,) that are first grouped by numbers (n,)."""
    points = contacts.points
    group = np.unique(group, return_inverse=True)[1]
    outward = unit(points - points.mean(axis=0))
    middle = unit(_sums(group, np.ones(len(group)), outward, int(group.max()) + 1))
    planes, group = _fitted(contacts, middle, group)
    best, best_round, least = planes, 0, np.inf
    # each round may double the planes; without noise they would go on for as long as there are contacts
    for number in range(16):
        for _ in range(20):
            before, (planes, group) = group, _refitted(contacts, planes)
            if np.array_equal(before, group):
                break
        planes = _without_needless(contacts, planes)
        group = planes.highest(points)[:, 0]
        misfit = _misfit(contacts, planes, group)
        total = np.minimum(misfit, _limit(misfit)).sum() + _GAIN * len(planes)
        if total < least:
            best, best_round, least = planes, number, total
        planes, group = _fitted(contacts, planes.normals, group)
        split = _split(contacts, planes, group)
        if len(split) == len(planes) or number - best_round >= 3:
            break
        planes = split
    return best


def _misfit(contacts: Contacts, planes: Planes, plane: Index) -> Array:
    """(n,) squared misfits of contacts to one plane each."""
    return planes.heights(contacts.points, plane) ** 2 / contacts.variance(planes.normals[plane])


def _limit(misfit: Array) -> float:
    """The squared misfit from which on contacts count as outliers; larger while the planes are few for a curved body."""
    # beyond five standard deviations; 0.455 is the median of squares of Gaussian errors
    return 25.0 * max(1.0, float(np.median(misfit)) / 0.455)


def _refitted(contacts: Contacts, planes: Planes) -> tuple[Planes, Index]:
    return _fitted(contacts, planes.normals, planes.highest(contacts.points)[:, 0])


def _fitted(contacts: Contacts, normals: Array, group: Index) -> tuple[Planes, Index]:
    """Planes with normals near the given ones (k, 3), fitted to groups of contacts, and the groups without empty ones."""
    present, group = np.unique(group, return_inverse=True)
    normals = normals[present] if len(normals) > len(present) else normals
    count = len(normals)
    weight = 1 / contacts.variance(normals[group])
    centre = _sums(group, weight, contacts.points, count) / np.bincount(group, weight, count)[:, None]
    local = _local(contacts.points - centre[group], normals, group)
    flat, height = local[:, :2], local[:, 2]
    matrix = _sums(group, weight, flat[:, :, None] * flat[:, None], count)
    ridge = 1 / _TURN**2 + ROUNDING * np.trace(matrix, axis1=1, axis2=2)
    matrix += ridge[:, None, None] * np.eye(2)
    slope = np.linalg.solve(matrix, _sums(group, weight, flat * height[:, None], count)[..., None])[..., 0]
    slope *= (np.minimum(size := np.linalg.norm(slope, axis=1), _TURN) / np.maximum(size, 1e-300))[:, None]
    first, second = across(normals)
    turned = unit(normals - slope[:, :1] * first - slope[:, 1:] * second)
    return Planes(turned, (turned * centre).sum(axis=1)), group


def _without_needless(contacts: Contacts, planes: Planes) -> Planes:
    """The planes without those that have too few contacts, or without which the misfit hardly rises."""
    while len(planes) > _FEWEST:
        highest = planes.highest(contacts.points)
        first, second = (_misfit(contacts, planes, plane) for plane in highest.T)
        limit = _limit(first)
        rise = np.bincount(highest[:, 0], np.minimum(second, limit) - np.minimum(first, limit), len(planes))
        needless = (rise < _GAIN) | (np.bincount(highest[:, 0], minlength=len(planes)) < _FEWEST)
        order = np.argsort(rise, kind="stable")
        worst = order[needless[order]]
        if not len(worst):
            break
        # a plane that stands in for one that is left out may be needed then
        kept = np.ones(len(planes), dtype=bool)
        kept[worst[: -(-len(worst) // 4)]] = False
        planes, _ = _refitted(contacts, planes.select(kept))
    return planes


def _split(contacts: Contacts, planes: Planes, group: Index) -> Planes:
    """The planes, of which those with contacts that bend inwards are split across the direction of the largest gain.

    In each direction s the height over the plane is fitted by ``a + b s + c t + d |s|``; d < 0 bends inwards.
    """
    count = len(planes)
    weight = 1 / contacts.variance(planes.normals[group])
    centre = _sums(group, weight, contacts.points, count) / np.bincount(group, weight, count)[:, None]
    local = _local(contacts.points - centre[group], planes.normals, group)
    size = np.sqrt(np.bincount(group, (local[:, :2] ** 2).sum(axis=1), count) / np.bincount(group, minlength=count))
    scaled = local / np.maximum(size, 1e-300)[group, None]
    flat = np.column_stack([np.ones(len(scaled)), scaled[:, :2]])
    matrix = np.linalg.pinv(_sums(group, weight, flat[:, :, None] * flat[:, None], count), hermitian=True)
    heights = _sums(group, weight, flat * scaled[:, 2:], count)
    gain, bend, angle = np.zeros(count), np.zeros(count), np.zeros(count)
    for direction in np.arange(6) * np.pi / 6:
        hinge = np.abs(scaled[:, :2] @ [np.cos(direction), np.sin(direction)])
        hinges = _sums(group, weight, flat * hinge[:, None], count)
        projected = np.einsum("kij,kj->ki", matrix, hinges)
        square = np.bincount(group, weight * hinge**2, count) - (projected * hinges).sum(axis=1)
        product = np.bincount(group, weight * hinge * scaled[:, 2], count) - (projected * heights).sum(axis=1)
        inwards = (product < 0) & (square > 1e-9 * np.bincount(group, weight, count))
        decrease = np.where(inwards, product**2 / np.maximum(square, 1e-300), 0.0) * size**2
        better = decrease > gain
        gain[better], angle[better], bend[better] = decrease[better], direction, product[better] / square[better]
    divided = (gain > _GAIN) & (np.bincount(group, minlength=count) >= 4 * _FEWEST)
    first, second = across(planes.normals)
    direction = (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)[divided]
    step = np.minimum(-bend[divided], _TURN)[:, None] * direction
    halves = unit(np.concatenate([planes.normals[divided] - step, planes.normals[divided] + step]))
    offsets = (halves * np.tile(centre[divided], (2, 1))).sum(axis=1)
    return Planes(
        np.concatenate([planes.normals[~divided], halves]),
        np.concatenate([planes.offsets[~divided], offsets]),
    )


def _body(cloud: Cloud, points: Array, planes: Planes) -> Any:
    """The polytope of the planes, as far as contacts (n, 3) show it: elsewhere half way from them to its vertices."""
    group = planes.highest(points)[:, 0]
    feet = points - planes.heights(points, group)[:, None] * planes.normals[group]
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    feet = feet[planes.heights(feet, planes.highest(feet)[:, 0]) <= NEGLIGIBLE * size]
    touched = hull(feet)
    inside = touched.vertices.view(np.ndarray).mean(axis=0)
    faces = np.concatenate([np.column_stack([planes.normals, planes.offsets]), _limits(cloud)])
    vertices = cut_polytope(faces, np.empty((0, 4)), inside, size, 0.0)
    vertices = vertices[
        np.abs(vertices - inside).max(axis=1) <= size
    ]  # others are those of planes that leave the body open
    if len(vertices):
        _, _, inner = nearest(vertices, touched)
        # A vertex counts where each of its planes has contacts within this many median distances between neighbouring
        # contacts; other vertices are drawn half way to the contacts.
        near = 8.0 * float(np.sqrt(touched.area / len(points)))
        fraction = np.where(_shown(vertices, planes, points, group, near), 1.0, 0.5)[:, None]
        feet = np.concatenate([feet, inner + fraction * (vertices - inner)])
    return hull(feet)


def _limits(cloud: Cloud) -> Array:
    """Planes (k, 4) half way between the slices at the ends of each axis and the empty ones beyond them."""
    if cloud.model == "spatial":
        return np.empty((0, 4))
    limits = [
        [*(sign * stack.frame[2]), sign * (end + beyond) / 2]
        for stack in stacks(cloud)
        for sign, end, beyond in ((1.0, stack.heights[-1], stack.ceiling), (-1.0, stack.heights[0], stack.floor))
        if np.isfinite(beyond)
    ]
    return np.array(limits) if limits else np.empty((0, 4))


def _shown(vertices: Array, planes: Planes, points: Array, group: Index, near: float) -> Mask:
    """Whether each of the planes through vertices (v, 3) has contacts within a distance of the vertex."""
    heights = vertices @ planes.normals.T - planes.offsets
    vertex, plane = np.nonzero(np.abs(heights) <= NEGLIGIBLE * np.linalg.norm(np.ptp(points, axis=0)))
    shown = np.ones(len(vertices), dtype=bool)
    for number in np.unique(plane):
        of_plane = vertex[plane == number]
        members = points[group == number]
        if len(members):
            shown[of_plane] &= cKDTree(members).query(vertices[of_plane])[0] <= near
    return shown


def _sums(group: Index, weight: Array, values: Array, count: int) -> Array:
    """(k, ...) weighted sums of values (n, ...) over groups (n,)."""
    columns = values.reshape(len(values), -1)
    sums: Array = np.stack([np.bincount(group, weight * column, count) for column in columns.T], axis=1).astype(float)
    return sums.reshape(count, *values.shape[1:])


def _local(vectors: Array, normals: Array, group: Index) -> Array:
    """(n, 3) components of vectors (n, 3) along two tangents and the normal of one plane each."""
    first, second = across(normals)
    return np.stack([(vectors * axis[group]).sum(axis=1) for axis in (first, second, normals)], axis=1)
