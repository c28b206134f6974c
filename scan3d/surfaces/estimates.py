"""An estimate of where the true surface lies between the hull of the contacts and the outer body.

Notation.  At a fixed angle θ of the in-plane normal, the support function h(θ, z) is concave in the height z.  A slab of
thickness d lies between two slices, and its *chord* is the straight line between the values of h at the two.  Let σ be the
slope of the chord, and let the slope ∂h/∂z be σ + ρ at the lower and σ - φ at the upper end.  By concavity, ρ and φ are not
negative.  The sum τ = ρ + φ is the *turn* of the slope in the slab.

Between the slices, h runs above the chord and below the tangents at its ends, which meet at the *tangents' apex*, φ/τ of the
thickness above the lower slice and d ρφ/τ above the chord.  The slopes are not measured.  What is certain is only that h stays
below the neighbouring secants, which join each slice to the one behind it: extrapolated into the slab, they meet at the
*secants' apex*, a corner of the outer body.  How close to that corner the true surface comes depends on how the turn is
distributed over the slab:

- If they are constant behind both ends, the body is taken for a polyhedron, whose turn is concentrated in a crease.  The
  surface reaches the corner.
- If they change steadily, the turn is taken to be distributed evenly.  Then h is a parabola, which passes d τ/8 above the chord
  at mid-height, half as high as the tangents' apex.
- If the slope is constant behind one end only, the body is taken to go over from a straight part into an arc about the
  tangents' apex, with the curvature found behind the other end.  The arc is a parabola from tangent to tangent, and passes
  d τl/4 below the apex, where 2l is the length of the arc relative to d.  If the slope of the straight part falls slightly
  towards the slab, the arc has begun before the slice.

Three slices on either side may mislead, so that the middle between this fraction and one half, at which the error is at most
half the gap, is tried as well: which predicts held-out slices better is found by cross-validation.  Past the end slices nothing
tells where the body ends: one half.

Of contacts anywhere, with normals: between neighbouring contacts i and j of a curved surface the middle of the chord lies
``<n_j - n_i, p_j - p_i> / 8`` below the surface, to the third order of the chord's length.  A surface with edges is estimated
by the planes in which several contacts lie, which meet in its edges and vertices, and by the tangent planes elsewhere.

The estimates rest on assumptions about the body.  The certificate does not: it holds whether or not an estimate is good.

Convex regression: the polytope that fits noisy contacts best, weighted by their covariances.

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

from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from scan3d.arrays import AT_ONCE, NEGLIGIBLE, ROUNDING, SOME, Array, Index, Mask, across, highest, ratio, unit
from scan3d.bounds.constraints import STRAIGHT
from scan3d.bounds.enclosures import Enclosure, slice_enclosure
from scan3d.cloud import Cloud
from scan3d.errors import InputError, NoBodyError
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import ROUNDED, cut_polytope, hull, plane_faces, polytope, vertices_of
from scan3d.geometry.triangles import distance_of_readers, kept_apart
from scan3d.reconstruction.facets import POLYHEDRON, on_planes, polyhedron
from scan3d.reconstruction.slices import SliceStack, stacks

EVEN = 0.25
"""The fraction at which an evenly bent body passes the corners between evenly spaced slices, as a parabola does."""
UNKNOWN = 0.5
"""The fraction where nothing tells how far the body reaches: the error is at most half the gap."""


class Room(NamedTuple):
    """Where a body may reach beyond the hull of its contacts."""

    points: Array
    """(n, 3) the contacts."""
    foot: Array
    """(w, 3) points of the hull of the contacts, nearest to the corners of the outer body."""
    away: Array
    """(w, 3) from there to the corners."""
    local: Array
    """(w,) fraction of the way by the turn in each slab."""
    fixed: Array
    """(w,) the fraction where it does not depend on how the body is bent: past the end slices and on facets; else NaN."""
    contours: Array
    """(m, 3) points on estimated contours between the slices."""
    facets: int = 0
    """Number of known facets if the body is a polyhedron by the contacts, nearly all of which lie on them; else 0."""


def room(cloud: Cloud, bounds: Enclosure | None = None, *, has_edges: bool = True) -> Room:
    """The room that contacts in slices leave, taken as they are: noise may let the body reach farther.

    bounds
        the enclosure of the cloud, if it has been computed already.
    has_edges
        whether the body may have facets: a smooth one has those of its mesh alone.
    """
    if bounds is None or bounds.margin or bounds.confidence < 1:
        bounds = slice_enclosure(cloud, margin=0.0)
    slabs = bounds.slabs
    assert slabs is not None
    size = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    open_ = np.isfinite(bounds.gap) & (bounds.gap > NEGLIGIBLE * size) & _is_corner(bounds.corners, slabs.number)
    foot, number, stack = slabs.foot[open_], slabs.number[open_], slabs.stack
    away, fixed = bounds.corners[open_] - foot, np.where(np.isin(number, (0, len(stack.slices))), UNKNOWN, np.nan)
    found = Room(cloud.points, foot, away, _local(stack, number, away), fixed, contours_between(stack))
    outer = found.foot + away if bounds.tighter is None else bounds.tighter.corners
    return _below_facets(found, cloud, stack, outer) if has_edges else found


def _is_corner(corners: Array, number: Index) -> Mask:
    """Whether corners (w, 3) of slabs (w,) are their vertices, and no crossings of planes that are one up to rounding."""
    found = np.zeros(len(corners), dtype=bool)
    bounded = np.flatnonzero(np.isfinite(corners).all(axis=1))
    for rows in np.split(bounded, np.flatnonzero(np.diff(number[bounded])) + 1):
        with suppress(InputError):  # of a slab that has no thickness
            found[rows[vertices_of(corners[rows])]] = True
    return found


def _below_facets(found: Room, cloud: Cloud, stack: SliceStack, outer: Array) -> Room:
    """The room that facets leave, if most contacts lie on them.

    Any corner of them that is not known to be a vertex may be cut off by a facet that is not known.
    """
    corners, contours = found.foot + found.away, found.contours
    size = float(np.linalg.norm(np.ptp(found.points, axis=0)))
    inner = hull(found.points).vertices.view(np.ndarray)
    planes, left, vertex, share = polyhedron(cloud, inner, np.concatenate([inner, outer]))
    if share <= 1 / 2:
        return found
    inside, remain = (
        highest(planes, np.column_stack([points, -np.ones(len(points))])) < -NEGLIGIBLE * size
        for points in (corners, contours)
    )
    is_open = np.isin(np.arange(len(left)), on_planes(left, planes, size)[0]) & ~vertex
    points, corners = np.concatenate([found.points, left[vertex]]), np.concatenate([corners[inside], left[is_open]])
    foot, count = nearest(corners, hull(points))[2], len(planes) if share >= POLYHEDRON else 0
    away, number = corners - foot, np.searchsorted(stack.heights, corners @ stack.frame[2])
    fixed = np.append(found.fixed[inside], np.full(is_open.sum(), UNKNOWN if share >= POLYHEDRON else np.nan))
    return Room(points, foot, away, _local(stack, number, away), fixed, contours[remain], count)


def _local(stack: SliceStack, number: Index, away: Array) -> Array:
    """(w,) fractions of the way to corners in slabs (w,), by the turns in the directions (w, 3) to them."""
    x, y = stack.frame[:2] @ away.T
    angle, found = np.arctan2(y, x), np.empty(len(away))
    for i in np.unique(number):
        found[number == i] = _turn(stack, int(i), angle[number == i]).fraction()
    return found


def between(found: Room, fraction: Array | float) -> Any:
    """The estimate at a fraction of the way from the hull to the outer body, a `trimesh.Trimesh`."""
    is_free = np.isnan(found.fixed)
    way = np.where(is_free, fraction, found.fixed)
    points = np.concatenate([found.points, found.foot + way[:, None] * found.away])
    if np.any(way[is_free]):
        points = np.concatenate([points, found.contours])
    # the hull of what its readers would merge would have to be computed again
    return hull(points[kept_apart(points, 2 * distance_of_readers(points))])


def contours_between(stack: SliceStack) -> Array:
    """Points (n, 3) in the world on estimated contours of the body, at one and two thirds of the height between its slices.

    Where a flat face ends inside a slab, the outer body has few corners; the contours go all around the body.
    """
    contours = [np.empty((0, 3))]
    for i in range(1, len(stack.slices)):
        below, above = stack.slices[i - 1], stack.slices[i]
        if not all(slice_.closed and len(slice_.outline) for slice_ in (below, above)):
            continue
        # a plane face has one normal in both slices, whose lines would cross anywhere on it
        angle = np.sort(np.concatenate([below.angle, above.angle]))
        angle = angle[np.diff(angle, prepend=-np.inf) > NEGLIGIBLE]
        turn = _turn(stack, i, angle)
        support = stack.supports(angle, i - 1, i + 1)
        middle = np.stack([slice_.outline.mean(axis=0) for slice_ in (below, above)])
        for up, nearer in ((1 / 3, below), (2 / 3, above)):
            mix = np.array([1 - up, up])
            level = below.height + up * (above.height - below.height)
            # the contour has the normals of both slices, and its points are those of the nearer one's
            after = np.searchsorted(nearer.angle, angle - NEGLIGIBLE)
            chosen = np.append(nearer.angle, np.inf)[after] <= angle + NEGLIGIBLE
            contour = _contour(angle, mix @ support + turn.above_chord(up), mix @ middle, chosen)
            contours.append(np.column_stack([contour, np.full(len(contour), level)]) @ stack.frame)
    return np.concatenate(contours)


def _contour(angle: Array, support: Array, inside: Array, chosen: Mask) -> Array:
    """Middles (n, 2) of the chosen sides of the polygon about `inside` (2,) that support lines bound; no points if they do not.

    The lines have their normals at the angles (k,) and the values (k,) of the support function, and some are chosen (k,).
    """
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    distance = support - normals @ inside
    if not (distance > 0).all():
        return np.empty((0, 2))
    try:
        # the polygon's sides are the corners of the dual polygon, and its corners are the edges there
        dual = ConvexHull(normals / distance[:, None])
    except QhullError:  # too thin for Qhull; the slices alone then determine the surface closely enough
        return np.empty((0, 2))
    corners = inside - dual.equations[:, :2] / dual.equations[:, 2:]
    side, corner = dual.simplices.ravel(), np.repeat(np.arange(len(corners)), 2)
    order = np.argsort(side, kind="stable")
    ends = corners[corner[order]].reshape(-1, 2, 2)
    # the middles of the sides, since a corner of two support lines need not belong to the body
    long = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) > NEGLIGIBLE * np.ptp(corners)
    middles: Array = ends.mean(axis=1)[long & chosen[side[order][::2]]]
    return middles


@dataclass(frozen=True)
class _Turn:
    """How the slope ∂h/∂z turns in a slab, at angles (n,) of the normal; NaN where there are too few slices.

    The symbols are those of the module's docstring.  Distances in z are in units of the thickness d.
    """

    thickness: float
    """d"""
    rise: Array
    """ρ, the slope at the lower end less that of the chord."""
    fall: Array
    """φ, the slope of the chord less that at the upper end."""
    secant_apex: Array
    """Height of the secants' apex above the chord, divided by d."""
    half_arc: Array
    """l, half the length of the arc about the tangents' apex, divided by d."""

    def fraction(self) -> Array:
        """Height of h above the chord at the tangents' apex, divided by that of the secants' apex; `EVEN` if not known.

        That is ``(ρφ/τ - τl/4) / secant_apex``, clipped to the interval from 0 to 1.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = self.rise + self.fall
            fraction = (self.rise * self.fall / turn - turn * self.half_arc / 4) / self.secant_apex
        return np.where(np.isfinite(fraction), np.clip(fraction, 0.0, 1.0), EVEN)

    def above_chord(self, up: float) -> Array:
        """Height (n,) of h above the chord at the fraction `up` of the thickness, u.

        It follows the lower of the two tangents, ``d min(uρ, (1 - u)φ)``, and the arc within l of the apex at ``u = φ/τ``:
        there it lies ``d τ (l - |u - φ/τ|)² / (4l)`` below the tangents.  Where the slope is known at one end only, it is
        taken to be the same at the other, and the arc to fill the slab.
        """
        rise, fall = np.fmax(self.rise, 0.0), np.fmax(self.fall, 0.0)
        rise, fall = np.where(np.isnan(self.rise), fall, rise), np.where(np.isnan(self.fall), rise, fall)
        turn, arc = rise + fall, np.where(np.isnan(self.half_arc), 0.5, self.half_arc)
        with np.errstate(divide="ignore", invalid="ignore"):
            inside = np.maximum(arc - np.abs(up - fall / turn), 0.0)
            height = np.minimum(up * rise, (1 - up) * fall) - np.where(inside > 0, turn * inside**2 / (4 * arc), 0.0)
        return self.thickness * np.fmax(height, 0.0)


def _turn(stack: SliceStack, i: int, angle: Array) -> _Turn:
    """The turn in the slab below slice i, at angles (n,)."""
    # three slices on either side; of the five slabs between them, with their thicknesses and secants, number 2 is this one
    h = stack.supports(angle, i - 3, i + 3)
    z = [
        stack.heights[j] if 0 <= j < len(stack.slices) and stack.slices[j].closed else np.nan
        for j in range(i - 3, i + 3)
    ]
    thickness = np.diff(np.array(z))
    secant = np.diff(h, axis=0) / thickness[:, None]
    # where the body is straight rounding decides nothing
    rounding = ROUNDED * np.nanmax(np.abs(h), initial=0.0) / np.nanmin(thickness, initial=np.inf)

    def bend(one: int, other: int) -> Array:
        turned = secant[one] - secant[other]
        return np.where(np.abs(turned) <= rounding, 0.0, turned)

    below = _End(bend(0, 2), bend(1, 2), thickness[1], thickness[2])
    above = _End(bend(2, 4), bend(2, 3), thickness[3], thickness[2])
    curvature = np.fmax(below.curvature(), above.curvature())
    rise, fall = below.slope(curvature), above.slope(curvature)
    with np.errstate(divide="ignore", invalid="ignore"):
        # The arc reaches at most to the nearer end.  If over that length the curvature turned the slope by less than τ, the
        # arc is shortened in proportion: the body turns more sharply.
        to_end = np.minimum(rise, fall) / (rise + fall)
        half_arc = to_end * np.minimum(1.0, 2 * curvature * to_end * thickness[2] / (rise + fall))
        secant_apex = below.near * above.near / (below.near + above.near)
    return _Turn(float(thickness[2]), rise, fall, secant_apex, half_arc)


@dataclass(frozen=True)
class _End:
    """One end of a slab, and the two slabs behind it, at angles (n,).

    Let ν be the difference between the slopes of the chord and of the secant in the first slab behind the end, and η that in
    the second, with signs such that both are positive for a concave function.  Let d' be the thickness of the first.
    """

    far: Array
    """η"""
    near: Array
    """ν"""
    near_thickness: float
    """d'"""
    thickness: float
    """d, the thickness of the slab itself."""

    @property
    def straight(self) -> Mask:
        """(n,) whether the body goes on straight behind the end."""
        return np.abs(self.far - self.near) <= STRAIGHT * np.abs(self.near)

    def curvature(self) -> Array:
        """The change κ of the slope with height around the end, ``κ = 2ν / (d + d')``; 0 if the body is straight there."""
        return np.where(self.straight, 0.0, 2 * self.near / (self.near_thickness + self.thickness))

    def slope(self, curvature: Array) -> Array:
        """Slope at the end itself, as its difference from that of the chord: ρ at the lower end and φ at the upper one.

        If the body is not straight behind the end, it is that of the parabola through the three slices: ``ν d / (d + d')``.

        If it is, the slope remains that of the far secant up to where the arc begins and then changes by κ, the curvature
        found behind the other end.  An arc that begins a height b before the end lowers the near secant's slope by
        ``η - ν = κb² / (2d')``, which gives b, at most d', and the slope ``η - κb``.  It is neither above ν nor below κd/2, the
        value for an arc that fills the slab.  If κ is 0, the slope is ν.
        """
        parabola = self.near * self.thickness / (self.near_thickness + self.thickness)
        with np.errstate(divide="ignore", invalid="ignore"):
            before = np.sqrt(2 * np.abs(self.far - self.near) * self.near_thickness / curvature)
            before = np.minimum(before, self.near_thickness)
        arc = np.minimum(self.near, np.maximum(self.far - curvature * before, curvature * self.thickness / 2))
        return np.where(self.straight, np.where(curvature > 0, arc, self.near), parabola)


# Distance from a plane, in diagonals, of the contacts that lie in it.
_PLANE = 5e-6


def curved(cloud: Cloud) -> Any:
    """The hull with the middles of its edges moved out onto the curved surface, but for edges in plane faces."""
    points, normals = cloud.points, cloud.normals
    try:
        qhull = ConvexHull(points)
    except QhullError:
        raise NoBodyError("the contacts span no body") from None
    faces = qhull.simplices
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    order = np.lexsort(sides.T)  # each edge is a side of two facets
    ends, opposite = sides[order[::2]], faces[:, [2, 0, 1]].T.ravel()[order].reshape(-1, 2)
    chord = points[ends[:, 1]] - points[ends[:, 0]]
    turn = normals[ends[:, 1]] - normals[ends[:, 0]]
    mean = normals[ends].sum(axis=1)
    length = np.linalg.norm(mean, axis=1)
    rise = (turn * chord).sum(axis=1) / 8
    if cloud.normal_sd is not None:  # no more than the errors of the normals leave
        rise -= cloud.normal_sd[ends].sum(axis=1) * np.linalg.norm(chord, axis=1) / 8
    for face in plane_faces(points, _PLANE * _diagonal(cloud)):
        rise[(face[3] - points[ends] @ face[:3] <= _PLANE * _diagonal(cloud)).all(axis=1)] = 0.0
    curved = (rise > 0) & (length > 0)
    ends, opposite, outward = ends[curved], opposite[curved], mean[curved] / length[curved, None]
    middle = points[ends].mean(axis=1)
    rise = np.minimum(rise[curved], _room(cloud, np.hstack([opposite, ends]), middle, outward))
    return hull(np.concatenate([points, middle + rise[:, None] * outward]))


def _room(cloud: Cloud, beside: Index, places: Array, outward: Array) -> Array:
    """How far middles (n, 3) of edges can be moved along directions (n, 3) below the tangent planes of contacts.

    An edge may be long, and its ends turned by curvature that is near them only: the contacts nearest to its middle, and those
    of the facets on both sides, `beside` (n, 4), know better.
    """
    known = np.arange(len(cloud.points)) if cloud.normal_sd is None else _well_known(cloud)
    near = known[cKDTree(cloud.points[known]).query(places, k=np.arange(1, min(32, len(known)) + 1))[1]]
    room = np.full(len(places), np.inf)
    for rows in np.column_stack([near, beside]).T:
        step = cloud.points[rows] - places
        height, slope = (step * cloud.normals[rows]).sum(axis=1), (outward * cloud.normals[rows]).sum(axis=1)
        if cloud.normal_sd is not None:
            height += cloud.normal_sd[rows] * np.linalg.norm(step, axis=1)
        room = np.minimum(room, np.where(slope > 0, ratio(np.maximum(height, 0.0), slope), np.inf))
    return room


def _well_known(cloud: Cloud) -> Index:
    """The contacts whose normals are known better than in the median, or as well."""
    assert cloud.normal_sd is not None
    return np.flatnonzero(cloud.normal_sd <= np.median(cloud.normal_sd))


def with_edges(cloud: Cloud) -> Any:
    """The polytope of the plane faces, cut by the contacts' tangent planes."""
    if cloud.normal_sd is not None:
        cloud = cloud.select(_well_known(cloud))
    points, normals, diagonal = cloud.points, cloud.normals, _diagonal(cloud)
    faces = plane_faces(points, _PLANE * diagonal)
    if not len(faces):
        return hull(points)
    tangent = np.column_stack([normals, (normals * points).sum(axis=1)])
    tangent = tangent[:: -(-len(tangent) // 6000)]
    # smaller cuts are rounding
    corners = cut_polytope(faces, tangent, points.mean(axis=0), diagonal, 1e-4 * diagonal)
    return hull(np.concatenate([points, corners]))


def _diagonal(cloud: Cloud) -> float:
    return float(np.linalg.norm(np.ptp(cloud.points, axis=0)))


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

    def highest(self, points: Array, ranks: int = 1) -> Index:
        """(n, ranks) planes that the points (n, 3) lie highest over, the highest first."""
        found = np.empty((len(points), ranks), dtype=np.intp)
        for block in np.array_split(np.arange(len(points)), 1 + len(points) * len(self) // AT_ONCE):
            heights = points[block] @ self.normals.T - self.offsets
            for rank in range(ranks):
                found[block, rank] = heights.argmax(axis=1)
                heights[np.arange(len(heights)), found[block, rank]] = -np.inf
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
    local = _in_planes(contacts.points - centre[group], normals, group)
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
        highest = planes.highest(contacts.points, 2)
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
    local = _in_planes(contacts.points - centre[group], planes.normals, group)
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
    vertices = polytope(faces, inside, 2 * size)
    # others are those of planes that leave the body open
    vertices = vertices[np.abs(vertices - inside).max(axis=1) <= size]
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
    if not cloud.in_slices:
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


def _in_planes(vectors: Array, normals: Array, group: Index) -> Array:
    """(n, 3) components of vectors (n, 3) along two tangents and the normal of one plane each."""
    first, second = across(normals)
    return np.stack([(vectors * axis[group]).sum(axis=1) for axis in (first, second, normals)], axis=1)
