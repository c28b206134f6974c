"""An inner and an outer body from touch alone, between which the surface of the true body lies.

The hull of the contacts lies inside the body.  The supporting planes at the contacts bound it from outside: between slices they
leave slabs (`scan3d.bounds.slabs`), and those of contacts anywhere a polytope (`scan3d.bounds.planes`).  Whatever is left is
known by its corners: the distance to a convex set is a convex function, and so it is largest over a polyhedron at one of its
corners.  The largest distance of the corners from the hull is therefore an upper bound of the Hausdorff distance between the
hull and the body, provided that the body is convex.  Where contacts are noisy, each slice's contour is first replaced by a
polygon inside it and one around it, which hold with a stated confidence (`scan3d.bounds.noise`), and planes are moved outwards
by what else is uncertain.

Contacts anywhere (S25, S27, S28).  B is the body and a the rod's radius.  The rod's centre line touches the fattened body
``K = B + ball(a)`` in the points r, and in tangential contact the whole line through r along the rod is free of the interior of
K.  H, the hull of the points r, lies in K, and ``h_K(u) <= <u, v>`` for one of the outer body's corners v.  The Hausdorff
distance of two convex bodies is the largest difference of their support functions, and ``h_K = h_B + a``.  With
``sd(x, S) = max_u (<u, x> - h_S(u))``, the distance of a point x from S, negative inside, any convex surface S satisfies

    h_B - h_S = h_K - a - h_S <= max over corners v of sd(v, S) - a,
    h_S - h_B = h_S + a - h_K <= h_S + a - h_H <= max over vertices x of S of sd(x, H) + a.

No measured normal enters, though the points of the inner body are moved by a along theirs: the second line contains what is
wrong with them.  There, B has further inner bodies: it contains the points ``r - a n``, and n lies within δ of the middle ν of
its arc (S27), so that ``h_B(u) >= <u, r - a ν> - a δ``. The smallest of these numbers counts at each vertex.  Where contacts
have errors, H may stick out of K by what its vertices' errors are in the directions in which they support it.  A table below
the body, if it is known, is one more supporting plane of K, moved outwards by the rod's radius.

A thick rod in slices.  Its centre line touches K as a thin rod would, so that slices enclose K, and the enclosure of B follows:
the outer body is smaller by a in all directions, and so is the inner one, since what lies in a part of K deeper than a lies in
B.  Friction acts on the rod's surface.  Where the force on it passes through the centre line, which is what reactions tell, is
no farther from the contact than ``a / cos β``, with β the angle of friction along the rod, and so no farther outside of K than
``a (1 / cos β - 1)``, for which a margin allows (`Cloud.lever`).  The rod's tip counts as round.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, cKDTree

from scan3d.arrays import NEGLIGIBLE, ROUNDING, Array, Index, Mask, highest, ratio, unit
from scan3d.bounds.constraints import (
    CONFIDENCE,
    EXACT,
    Allowed,
    allowed,
    arcs_of_contacts,
    exact_error,
    tangential,
)
from scan3d.bounds.noise import confident
from scan3d.bounds.planes import Planes, outer_body, planes_of_arcs, planes_of_touches, with_table
from scan3d.bounds.slabs import Gap, Slab, slabs
from scan3d.cloud import Cloud, Tilt
from scan3d.errors import NoBodyError
from scan3d.geometry.arcs import Places
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import hull, offset_inwards, shrunk
from scan3d.geometry.triangles import dot, face_normals
from scan3d.reconstruction.slices import SAME_HEIGHT, SliceStack, stacks
from scan3d.shown import Described, Rows

if TYPE_CHECKING:
    import trimesh

# Error of a tangent, in radians, of a contact whose place is off by one rod length, where the tangent's own error is not known.
# A rod that is off by d at its tip, where bending sets in at half its length, has turned by no more than 6 d per length.
_TURN = 6.0


class SlabCorners(NamedTuple):
    """The corners (w,) of an outer body that consists of the slabs between slices."""

    foot: Array
    """(w, 3) points of the inner body nearest to the corners; infinite where the outer body is unbounded."""
    kind: NDArray[np.int8]
    """(w,) of `Gap`."""
    number: Index
    """(w,) of the corner's slab: slab i lies below slice i of `stack`."""
    stack: SliceStack


class Directions(NamedTuple):
    """Directions in which a body may be unbounded: those in which a place that is open lies farthest of all."""

    places: Array
    """(m, 3) the corners of the outer body, and places far away."""
    open: Mask
    """(m,) whether nothing bounds the body towards the place."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Enclosure(Described):
    """Inner and outer body, between which the surface of the true body lies; lengths in the cloud's unit."""

    inner: trimesh.Trimesh
    """The inner body: the hull of exact contacts, or of the points that noisy contacts prove."""
    corners: Array
    """(w, 3) corners of the outer body."""
    gap: Array
    """(w,) their distance from the inner body, infinite where nothing bounds the true one."""
    bound: float
    """Upper bound of the Hausdorff distance between the inner body and the true one; infinite if nothing bounds it."""
    margin: float
    """Largest error of a contact that the bounds allow for, contained in `bound`."""
    volume: tuple[float, float]
    """Lower and upper bound of the true volume."""
    confidence: float = 1.0
    """Probability with which bound and volume hold: 1 for exact contacts, and for a given margin."""
    excess: float = 0.0
    """How far the inner body may stick out of the true one, contained in `bound`."""
    reach: float = 0.0
    """How far the true body may reach beyond the hull of the corners: negative where they enclose the body and the rod."""
    inner_bodies: tuple[tuple[Any, float], ...] = ()
    """Further convex bodies, and how far each may stick out of the true one."""
    fattened: Enclosure | None = None
    """Of a thick rod in slices: the enclosure of the body fattened by the rod's radius."""
    slabs: SlabCorners | None = None
    """More about the corners, if the outer body consists of slabs."""
    directions: Directions | None = None
    """Where the body is bounded, if the contacts lie anywhere."""
    tighter: Enclosure | None = None
    """Another enclosure by the same contacts, along whatever axes their slices lie, with a smaller bound."""

    def part(self, kind: Gap) -> float:
        """The largest gap of one kind in slabs, 0 if no corner is of that kind."""
        gap = self.gap[:0] if self.slabs is None else self.gap[self.slabs.kind == kind]
        return min(float(gap.max()), self.bound) if len(gap) else 0.0

    def parts(self) -> dict[str, float]:
        """The largest gap by each cause."""
        if self.slabs is None:
            return {"contacts": float(self.gap.max(initial=0.0)), "rod": self.excess}
        return {kind.name.lower(): self.part(kind) for kind in Gap}

    @property
    def closed(self) -> bool:
        """Whether the outer body is bounded in all directions."""
        everywhere = self.directions is None or not self.directions.open.any()
        return everywhere and len(self.corners) > 0 and bool(np.isfinite(self.corners).all())

    def sticking_out(self, points: Array) -> Array:
        """Upper bounds (n,) of the distances of points (n, 3) from the true body, negative inside."""
        return sticking_out(points, self.inner_bodies or ((self.inner, self.excess),))

    def support(self, directions: Array) -> tuple[Array, Array]:
        """Lower and upper bounds (d,) of the true body's support function in directions (d, 3), unit vectors.

        They hold with the enclosure's `confidence`, and are infinite where nothing bounds the body.
        """
        nothing = np.full(len(directions), np.inf)
        if not self.confidence:
            return -nothing, nothing
        bodies = ((self.inner, self.excess), *self.inner_bodies)
        lower = np.max([highest(body.vertices.view(np.ndarray), directions) - off for body, off in bodies], axis=0)
        upper = highest(self.corners, directions) + self.reach if self.closed else nothing
        return lower, upper if self.tighter is None else np.minimum(upper, self.tighter.support(directions)[1])

    def outer_planes(self) -> Array:
        """Planes (k, 4), n and c with <n, x> <= c, of a convex body that contains the true one with the enclosure's confidence.

        There are none where the body is unbounded.
        """
        if not (self.confidence and np.isfinite(self.bound) and np.isfinite(self.corners).all()):
            return np.empty((0, 4))
        # in any directions; many nearly coplanar corners make wide facets
        normals = ConvexHull(self.corners, qhull_options="Qt Q12").equations[:, :3]
        return np.column_stack([normals, self.support(normals)[1]])

    def summary(self) -> Rows:
        """The bound with its parts, and the volume."""
        parts = ", ".join(f"{name} {gap:.4g}" for name, gap in self.parts().items())
        low, high = self.volume
        return [
            ("inner body", f"{len(self.inner.vertices)} vertices, {len(self.inner.faces)} faces"),
            ("outer body", f"{len(self.corners)} corners"),
            ("bound", f"{self.bound:.4g} with {100 * self.confidence:g} % confidence; parts: {parts}"),
            ("margin", f"{self.margin:.4g}"),
            ("volume", f"{low:.6g} to {high:.6g}"),
        ]


def sticking_out(points: Array, bodies: tuple[tuple[Any, float], ...]) -> Array:
    """Upper bounds (n,) of the distances of points (n, 3) from a body, by inner bodies and how far they may stick out."""
    return np.min([nearest(points, body)[0] + offset for body, offset in bodies], axis=0)


def enclosure(cloud: Cloud, margin: float | None = None, *, confidence: float = CONFIDENCE) -> Enclosure:
    """The enclosure of a cloud's body.

    margin
        the largest error of a contact's place, in the cloud's unit, if it is known.  By default the contacts' own uncertainty
        counts: of exact contacts the enclosure is certain, of noisy ones it holds with `confidence`, and it allows for the
        digits of the poses and for tilted slices.  With a given margin slices count as parallel.
    confidence
        probability with which the enclosure of noisy contacts holds.

    Where the cloud was sliced along several axes, the stack whose slabs give the smallest bound is used.  Exact contacts bound
    the body by the tangents of all of them as well, if that is tighter.  Contacts of the spatial model lie in no slices, and
    touches of other probes have planes.  A rod whose radius changes along it bounds nothing.  Raises NoBodyError for contacts
    that do not span a body.
    """
    if cloud.fattened is not None:
        bounds = _thinner(enclosure(cloud.fattened, margin, confidence=confidence), cloud.rod_radius)
        return bounding_nothing(bounds) if cloud.tapered else bounds
    if cloud.model == "touches":
        return _by_planes(cloud, margin, confidence)
    if cloud.model == "spatial":
        bounds = _spatial_enclosure(cloud, margin, confidence)
        return bounding_nothing(bounds) if cloud.tapered else bounds
    bounds = slice_enclosure(cloud, margin, confidence)
    exact = margin is None and cloud.covariance is None and cloud.calibration is None and cloud.tilt is None
    # slabs along one axis bound curved bodies more tightly
    tighter = len(bounds.inner.faces) <= 500 or len(stacks(cloud)) > 1
    return _with_tangents(bounds, cloud) if exact and tighter else bounds


def bounding_nothing(bounds: Enclosure) -> Enclosure:
    """The enclosure of a body where the premises do not hold: nothing is bounded, and nothing is stated with any confidence."""
    gap = np.full(len(bounds.gap), np.inf)
    return replace(bounds, tighter=None, gap=gap, bound=np.inf, volume=(0.0, np.inf), confidence=0.0)


def unbounded(cloud: Cloud) -> Enclosure:
    """The enclosure that bounds nothing: the contacts' hull, empty where they span no body."""
    import trimesh

    nothing, inner = np.empty((0, 3)), trimesh.Trimesh()
    with suppress(NoBodyError):
        inner = hull(cloud.points[np.isfinite(cloud.points).all(axis=1)])
    return Enclosure(
        inner=inner, corners=nothing, gap=np.empty(0), bound=np.inf, margin=0.0, volume=(0.0, np.inf), confidence=0.0
    )


def _tightened(bounds: Enclosure, corners: Array, gap: Array, error: float) -> Enclosure:
    """The enclosure with that by another outer body, if its bound is smaller.

    corners, gap (w,)
        of the other body, and their distances from the same inner one, of exact contacts with errors of at most `error`.
    """
    bound = max(float(gap.max()) if len(gap) else np.inf, error)
    if bound >= bounds.bound:
        return bounds
    within = float(bounds.inner.volume + shell(bounds.inner, bound)) * (1 + ROUNDING)
    volume = bounds.volume[0], max(min(bounds.volume[1], within), bounds.volume[0])
    other = Enclosure(inner=bounds.inner, corners=corners, gap=gap, bound=bound, margin=0.0, volume=volume)
    return replace(bounds, tighter=other, bound=bound, volume=volume)


def shell(body: Any, distance: float) -> float:
    """Volume of all that is nearer to a convex body than `distance` and outside of it, by Steiner's formula."""
    edges = np.linalg.norm(np.diff(body.vertices.view(np.ndarray)[body.face_adjacency_edges], axis=1)[:, 0], axis=1)
    first, second = face_normals(body)[body.face_adjacency].swapaxes(0, 1)
    angles = np.arctan2(np.linalg.norm(np.cross(first, second), axis=1), dot(first, second))
    curvature = float((edges * angles).sum()) / 2
    return float(distance * (body.area + distance * (curvature + 4 / 3 * np.pi * distance)))


def _thinner(bounds: Enclosure, radius: float) -> Enclosure:
    """The enclosure of a body by that of the body fattened by a ball of some radius."""
    inner, excess = offset_inwards(bounds.inner, radius), bounds.excess
    # which tells more than the inner body, smaller in all directions
    bodies = ((bounds.inner, bounds.excess + radius),)
    if inner is None:  # the body may be thinner than what the contacts leave open
        inner = shrunk(bounds.inner, radius, least=1e-3)
        excess = max(float(sticking_out(inner.vertices.view(np.ndarray), bodies).max()), excess)
    tighter = None if bounds.tighter is None else _thinner(bounds.tighter, radius)
    reach, gap = bounds.reach - radius, np.full(len(bounds.gap), np.inf)
    known = np.flatnonzero(np.isfinite(bounds.corners).all(axis=1))
    gap[known] = np.maximum(nearest(bounds.corners[known], inner)[0] + reach, 0.0)
    bound = max(float(gap.max(initial=0.0)), excess, bounds.margin)
    low, around = _least(inner, excess, radius)
    high = bounds.volume[1] - around
    if tighter is not None:
        bound, low, high = min(bound, tighter.bound), max(low, tighter.volume[0]), min(high, tighter.volume[1])
    return replace(
        bounds,
        inner=inner,
        gap=gap,
        bound=bound,
        volume=(low, max(low, high)),
        excess=excess,
        reach=reach,
        inner_bodies=bodies,
        tighter=tighter,
        fattened=bounds,
    )


def _with_tangents(bounds: Enclosure, cloud: Cloud) -> Enclosure:
    """The enclosure with that by the planes of the tangents whose normals are known best, if it is tighter."""
    if not bounds.closed:
        return bounds
    along = np.cross(cloud.in_plane_normals, cloud.slice_axis[cloud.slice])
    anywhere = replace(cloud, centre_points=cloud.points, tangents=along, rod_radius=0.0)
    places = Places(cloud.points, np.full(len(cloud), exact_error(cloud)))
    corners, far = outer_body(_planes(anywhere, places, np.full(len(cloud), _turn_of_digits(cloud))), bounds.inner)
    if len(far):
        return bounds
    gap = np.maximum(nearest(corners, bounds.inner)[0], 0.0)
    return _tightened(bounds, corners, gap, exact_error(cloud))


def _turn_of_digits(cloud: Cloud) -> float:
    """Largest error of exact tangents, in radians: that of a place by the digits of a pose is theirs over more than a rod."""
    return EXACT + cloud.pose_error / cloud.rod_length


def _planes(cloud: Cloud, places: Places, turns: Array) -> Planes:
    """The planes of the tangential contacts of a cloud with places (n,), and errors (n,) of their tangents in radians."""
    assert cloud.tangents is not None
    rows = tangential(cloud)
    arcs = arcs_of_contacts(places, cloud.tangents, rows, turns[rows])
    return planes_of_arcs(arcs, places.select(rows), cloud.tangents[rows], turns[rows])


def slice_enclosure(cloud: Cloud, margin: float | None = None, confidence: float = CONFIDENCE) -> Enclosure:
    """The enclosure by the slabs between slices, as `enclosure`.

    Let a row's plane be tilted against its slice by the angle τ, and let the body lie within a distance R of an axis
    through the contacts, which lie within r of it.  A body's supporting plane through a contact p contains the rod's
    tangent there.  With the tangent's direction t and the normal n across it, both seen along the axis,
    ``<n, x - p> <= g (z - z')`` holds for all x of the body and some slope g, with the height z' of the row's plane at
    the point of the tangent that is nearest to x as seen along the axis.  That point lies within √(R² + r²) of the axis, and z'
    differs from the height of the slice by at most ``spread + √(R² + r²) tan τ`` (`scan3d.cloud.Tilt`).  So the
    half-spaces are those of heights that are uncertain by this.  They hold within the cylinder; if the outer body
    between two slices lies in its interior, then so does the body there, since it is connected.
    """
    if cloud.tilt is None or margin is not None:
        return _by_slices(cloud, margin, confidence)
    # by this fraction of the radius the cylinder is larger than the contacts; the second is tried where the outer body
    # leaves the first
    for widened in (0.25, 2.0):
        bounds = _by_slices(cloud, None, confidence, 1 + widened)
        assert bounds.slabs is not None
        stack = bounds.slabs.stack
        corners = bounds.corners[np.isfinite(bounds.corners).all(axis=1)]
        reach = _distances(corners, stack, cloud.tilt).max(initial=0.0)
        if reach < (1 + widened) * _distances(cloud.points, stack, cloud.tilt).max():
            return bounds
    return _unbounded(hull(cloud.points), stack, bounds.confidence)


def _distances(points: Array, stack: SliceStack, tilt: Tilt) -> Array:
    """Distances (n,) of points (n, 3) from the stack's axis through the centre of the tilted planes."""
    return np.linalg.norm((points - tilt.centre) @ stack.frame[:2].T, axis=1)


def _by_slices(cloud: Cloud, margin: float | None, confidence: float, widened: float = 1.0) -> Enclosure:
    """The enclosure by contacts in slices, of a body that lies in a cylinder `widened` times as wide as the contacts."""
    by_axis = stacks(cloud)
    inner = hull(cloud.points)
    excess = 0.0
    if margin is None:
        off = [_height_error(stack, cloud) for stack in by_axis]
        allow = allowed(cloud, confidence)
        confidence = allow.confidence
        by_axis = [
            replace(stack, height_error=max(error, _tilt_error(stack, cloud, widened)) + allow.height)
            for stack, error in zip(by_axis, off, strict=True)
        ]
        if cloud.covariance is not None or allow.factor:
            confident_stacks = [confident(stack, cloud, allow) for stack in by_axis]
            proven = _proven_hull(confident_stacks)
            if proven is None:
                return _unbounded(inner, by_axis[0], confidence)
            by_axis, inner = [stack for stack in confident_stacks if stack.slices], proven
            excess = _excess(cloud, allow, by_axis)
        margin = max(off) + cloud.lever
    else:
        confidence = 1.0
    smaller = shrunk(inner, margin) if margin else inner
    if smaller is None:
        return _unbounded(inner, by_axis[0], confidence)
    inner = smaller
    outer = [slabs(stack, margin) for stack in by_axis]
    if len(by_axis) > 1 and cloud.tilt is None:
        # another stack may bound the height of a stack more tightly than its empty slices do
        by_axis = [_bounded_by_others(k, by_axis, outer) for k in range(len(by_axis))]
        outer = [slabs(stack, margin) for stack in by_axis]
    candidates = [
        _of_stack(inner, stack, parts, (margin, excess), confidence)
        for stack, parts in zip(by_axis, outer, strict=True)
    ]
    return min(candidates, key=lambda candidate: candidate.bound)


def _excess(cloud: Cloud, allow: Allowed, by_axis: list[SliceStack]) -> float:
    """How far the proven points may stick out of the body, because the heights of contacts depend on the calibration."""
    if cloud.calibration is None:
        return 0.0
    along = [np.einsum("i,nij,j->n", stack.frame[2], cloud.calibration.covariance, stack.frame[2]) for stack in by_axis]
    return allow.factor * float(np.sqrt(max(np.max(variance, initial=0.0) for variance in along)))


def _proven_hull(by_axis: list[SliceStack]) -> Any:
    """The hull of all points that lie in the body with the stacks' confidence; None if they span no body."""
    with suppress(NoBodyError):
        return hull(np.concatenate([np.empty((0, 3)), *(s.contour(i) for s in by_axis for i in range(len(s.slices)))]))
    return None


def _height_error(stack: SliceStack, cloud: Cloud) -> float:
    """Largest error of the height that a contact has by its slice: the poses' digits and their spread in the slice."""
    spread = max(
        float(np.abs(cloud.points[slice_.rows] @ stack.frame[2] - slice_.height).max()) for slice_ in stack.slices
    )
    return cloud.pose_error + (spread if spread > SAME_HEIGHT * cloud.rod_length else 0.0)


def _tilt_error(stack: SliceStack, cloud: Cloud, widened: float) -> float:
    """Largest difference between the height of a slice and that at which a contact's half-space begins."""
    if cloud.tilt is None:
        return 0.0
    radius = float(_distances(cloud.points, stack, cloud.tilt).max())
    return cloud.pose_error + cloud.tilt.spread + cloud.tilt.slope * radius * float(np.hypot(widened, 1.0))


def _unbounded(inner: Any, stack: SliceStack, confidence: float) -> Enclosure:
    """The enclosure by contacts that prove nothing, because their errors are too large."""
    nothing, nowhere = np.full(1, np.inf), np.full((1, 3), np.inf)
    return Enclosure(
        inner=inner,
        corners=nowhere,
        gap=nothing,
        bound=np.inf,
        margin=np.inf,
        volume=(0.0, np.inf),
        confidence=confidence,
        excess=np.inf,
        reach=np.inf,
        slabs=SlabCorners(nowhere, np.full(1, Gap.SLICES, dtype=np.int8), np.zeros(1, dtype=np.intp), stack),
    )


def _of_stack(
    inner: Any, stack: SliceStack, parts: list[Slab], errors: tuple[float, float], confidence: float
) -> Enclosure:
    """The enclosure by the slabs of one stack; `errors` are the margin, and how far the inner body may stick out besides."""
    corners = np.concatenate([part.corners for part in parts])
    gap, foot = np.full(len(corners), np.inf), np.full((len(corners), 3), np.inf)
    bounded = np.isfinite(corners).all(axis=1)
    distance, _, foot[bounded] = nearest(corners[bounded], inner)
    gap[bounded] = np.maximum(distance, 0.0)
    margin, excess = errors
    within = shrunk(inner, excess) if excess else inner
    least = 0.0 if within is None else within.volume * (1 - ROUNDING)
    number = np.repeat(np.arange(len(parts)), [len(part.corners) for part in parts])
    kind = np.concatenate([part.kind for part in parts])
    return Enclosure(
        inner=inner,
        corners=corners,
        gap=gap,
        bound=max(float(gap.max()), excess) + margin,
        margin=margin,
        volume=(least, max(sum(part.volume for part in parts), least) * (1 + NEGLIGIBLE)),
        confidence=confidence,
        excess=excess + margin,
        reach=margin,
        slabs=SlabCorners(foot, kind, number, stack),
    )


def _bounded_by_others(k: int, by_axis: list[SliceStack], outer: list[list[Slab]]) -> SliceStack:
    """Stack k with its floor and ceiling also bounded by the other stacks' outer bodies."""
    stack = by_axis[k]
    low, high = stack.floor, stack.ceiling
    for j, parts in enumerate(outer):
        corners = np.concatenate([slab.corners for slab in parts])
        if j != k and np.isfinite(corners).all():
            heights = corners @ stack.frame[2]
            low, high = max(low, float(heights.min())), min(high, float(heights.max()))
    low, high = min(low, stack.slices[0].height), max(high, stack.slices[-1].height)
    return replace(stack, floor=low, ceiling=high)


def _spatial_enclosure(cloud: Cloud, margin: float | None, confidence: float) -> Enclosure:
    """The enclosure by contacts anywhere; the arguments are those of `enclosure`."""
    assert cloud.centre_points is not None
    assert cloud.tangents is not None
    if not len(cloud):
        raise NoBodyError("0 contacts span no body: a surface needs contacts all around it")
    allow = allowed(cloud, confidence) if margin is None else None
    errors = np.full(len(cloud), exact_error(cloud) if margin is None else margin)
    places, turns = Places(cloud.centre_points, errors), np.full(len(cloud), _turn_of_digits(cloud))
    if margin is not None:
        turns += _TURN * (errors / cloud.rod_length) * (cloud.place_sd is not None)
    elif allow is not None and (cloud.place_sd is not None or cloud.calibration is not None):
        places = places._replace(errors=errors + allow.place)
        if cloud.place_sd is not None:
            assert allow.kappa is not None
            if cloud.centre_covariance is None:
                places = places._replace(errors=places.errors + allow.kappa * cloud.place_sd)
            else:
                places = places._replace(spread=allow.kappa**2 * cloud.centre_covariance)
            by_sd = cloud.tangent_sd
            turns += _TURN * places.largest() / cloud.rod_length if by_sd is None else allow.kappa * by_sd
        turns = turns + allow.turn
    within = _inner_bodies(cloud, places)  # raises NoBodyError for contacts that span no body
    planes = _planes(cloud, places, turns)
    if cloud.place_sd is None and (cloud.calibration is None or margin is not None):
        # more of the body follows where normals are known, and all places have the same error
        within = [
            (inner, (*bodies, *_bodies_by_arcs(cloud, planes, margin)), margin) for inner, bodies, margin in within
        ]
    planes = with_table(planes, None if cloud.table is None else cloud.table - cloud.rod_radius)
    return _best_within(cloud, within, planes, 1.0 if allow is None else allow.confidence)


def _by_planes(cloud: Cloud, margin: float | None, confidence: float) -> Enclosure:
    """The enclosure by touches of another probe, whose normals were measured; the arguments are those of `enclosure`."""
    errors = np.full(len(cloud), exact_error(cloud) if margin is None else margin)
    places, turns = Places(cloud.points, errors), np.full(len(cloud), cloud.normal_error)
    allow = allowed(cloud, confidence)
    if allow.kappa is not None:  # a margin is that of the places alone
        assert cloud.covariance is not None
        assert cloud.normal_sd is not None
        turns += allow.kappa * cloud.normal_sd
        if margin is None:
            places = places._replace(spread=allow.kappa**2 * cloud.covariance)
    planes = with_table(planes_of_touches(places.points, cloud.normals, places.largest(), turns), cloud.table)
    return _best_within(cloud, _inner_bodies(cloud, places), planes, allow.confidence)


_Within = tuple[Any, tuple[tuple[Any, float], ...], float]
"""An inner body, the bodies that it may stick out of by so much, and the largest error of theirs."""


def _inner_bodies(cloud: Cloud, places: Places) -> list[_Within]:
    """Hulls of contacts with uncertain places: of all, and of those with smaller errors.  Raises NoBodyError as `hull`."""
    candidates: list[_Within] = []
    largest = places.largest()
    for least in np.unique(np.quantile(largest, (1.0, 0.85, 0.7, 0.5)))[::-1]:
        kept = largest <= least
        with suppress(NoBodyError):
            centre_hull = hull(places.points[kept])
            margin, inner = _error_of_hull(centre_hull, places), _inner_body(cloud.select(kept), centre_hull)
            candidates.append((inner, ((centre_hull, cloud.rod_radius + margin),), margin))
    if not candidates:
        hull(places.points)  # raises NoBodyError, which says why
    return candidates


def _best_within(cloud: Cloud, candidates: list[_Within], planes: Planes, confidence: float) -> Enclosure:
    """The enclosure with the smallest bound by planes and one of several inner bodies."""
    corners, far = outer_body(planes, candidates[0][1][0][0])
    is_far = np.arange(len(corners) + len(far)) >= len(corners)
    directions = Directions(np.concatenate([corners, far]), is_far)
    bounds = [_anywhere(cloud, within, corners, directions, confidence) for within in candidates]
    return min(bounds, key=lambda candidate: (candidate.bound, candidate.excess))


def _anywhere(
    cloud: Cloud,
    within: _Within,
    corners: Array,
    directions: Directions,
    confidence: float,
) -> Enclosure:
    """The enclosure by an inner body, and by the corners of an outer one, and the directions in which there are none."""
    inner, bodies, margin = within
    radius, unbounded = cloud.rod_radius, bool(directions.open.any())
    gap = np.maximum(nearest(corners, inner)[0] - radius, 0.0) if len(corners) else np.empty(0)
    excess = max(float(sticking_out(inner.vertices.view(np.ndarray), bodies).max()), margin)
    return Enclosure(
        inner=inner,
        corners=corners,
        gap=np.append(gap, np.inf) if unbounded else gap,
        bound=np.inf if unbounded else max(float(gap.max()), excess),
        margin=margin,
        volume=_volumes(inner, excess, corners, radius, unbounded=unbounded),
        confidence=confidence,
        excess=excess,
        reach=-radius,
        inner_bodies=bodies,
        directions=directions,
    )


def _error_of_hull(body: Any, places: Places) -> float:
    """How far a hull of some places may stick out of a convex body that contains the true ones.

    The hull's support function is that of a vertex in the directions between the normals of the vertex' facets, in which the
    errors of its place, which are a norm, are at most the largest along these normals, over the cosine of their spread.
    """
    faces, normals = body.faces.ravel(), np.repeat(face_normals(body), 3, axis=0)
    apart, rows = cKDTree(places.points).query(body.vertices)
    own = places.select(rows)
    middle = np.zeros((len(rows), 3))
    np.add.at(middle, faces, normals)
    cosine, along = np.ones(len(rows)), np.zeros(len(rows))
    np.minimum.at(cosine, faces, dot(normals, unit(middle)[faces]))
    np.maximum.at(along, faces, own.select(faces).along(normals[:, None])[:, 0])
    by_normals = np.where(cosine > 0, ratio(along, cosine), np.inf)
    return float((np.minimum(by_normals, own.largest()) + apart).max())


def _inner_body(cloud: Cloud, centre_hull: Any) -> Any:
    """The hull of the contacts on the surface; without normals, that of the centre points, made smaller by the radius."""
    known = np.isfinite(cloud.points).all(axis=1)
    return hull(cloud.points[known]) if known.any() else shrunk(centre_hull, cloud.rod_radius, least=1e-3)


def _volumes(inner: Any, excess: float, corners: Array, radius: float, *, unbounded: bool) -> tuple[float, float]:
    """Bounds of the volume: that of the inner body, made smaller until it does not stick out, and that of the outer one, which
    is the body fattened by the radius."""
    lower, around = _least(inner, excess, radius)
    if unbounded:
        return lower, np.inf
    return lower, max(float(ConvexHull(corners, qhull_options="Qt Q12").volume) - around, lower)


def _least(inner: Any, excess: float, radius: float) -> tuple[float, float]:
    """The least volumes of a body, out of which an inner one sticks by no more than an excess, and of what lies within a radius
    of it: both are larger of larger convex bodies."""
    least = shrunk(inner, excess) if excess else inner
    if least is None:
        return 0.0, 4 / 3 * np.pi * radius**3
    return float(least.volume) * (1 - ROUNDING), shell(least, radius) * (1 - ROUNDING)


def _bodies_by_arcs(cloud: Cloud, planes: Planes, margin: float) -> Iterator[tuple[Any, float]]:
    """Hulls of the points of the surface that follow from planes of exact tangents, and how far they may stick out."""
    radius, angle = cloud.rod_radius, np.arctan(planes.slopes).sum(axis=1)
    if not radius:
        return
    points = planes.points - radius * planes.normals
    # radians from the middles of the arcs
    for widest in (1e-4, 1e-3, 1e-2):
        narrow = angle <= widest
        with suppress(NoBodyError):
            if narrow.sum() > 3:
                yield hull(points[narrow]), radius * widest + margin
