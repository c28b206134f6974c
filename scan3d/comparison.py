"""How far apart a surface and the true mesh are: the Hausdorff distance with certified bounds, averages, normals and volume.

With d(x, B) the distance from a point to a surface, the one-sided distance from A to B is the largest d(x, B) over *all
points* x of A, and the Hausdorff distance h(A, B) is the larger of the two one-sided ones.

For two convex closed surfaces A, B bounding K, L it is exactly r = the largest, over the vertices of both, of the
distance to the other surface.  Proof.  (1) d(., L) is convex, so over K it is largest at a vertex of A, where it is
d(v, B) unless zero; likewise the other way.  So h(K, L) <= r, and r, taken at points of A and B, is <= h(A, B).
(2) h(A, B) <= h(K, L): let x be in A.  If x isn't inside L, d(x, B) = d(x, L).  Otherwise let u be an outer normal of K
at x.  L lies in K + h(K, L) * ball, so along u it reaches at most h(K, L) beyond x: the ray from x along u leaves L,
through B, within h(K, L).  Hence r = h(A, B).  (Schneider, *Convex Bodies: The Brunn-Minkowski Theory*, lemma 1.8.1.)

The smaller of the one-sided distances, and the distances of surfaces that aren't convex, can't be computed from the vertices
alone, because the farthest point may lie inside a face.  There the distance from a triangle T of A is bounded by
min_j max_v d(v, t_j), with v the corners of T and t_j any triangles of B, because the distance from a convex set is convex.  If
B is convex, its planes bound the distance from the points of T inside it far more tightly, and points outside are never farther
than the vertices.  Splitting the triangles with the largest bounds brings the bounds together.  A mesh that is convex but for
rounding (from a single-precision file) is replaced by its hull, and the bounds are widened by ``slack``, the distance between
the two.

Bodies and sides have their lengths in diagonals of the two meshes' common bounding box.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from scan3d.arrays import NEGLIGIBLE, SOME, Array, Index, Mask, weighted_quantiles
from scan3d.geometry.distance import Search, bounding_box
from scan3d.geometry.hulls import (
    CONVEX_DEPTH,
    DENT_TOLERANCE,
    Facets,
    against_hull,
    outward_faces,
    outward_facets,
    prepare_facets,
)
from scan3d.geometry.shells import cavities, whole_body
from scan3d.geometry.triangles import areas, distance_to, distinct_rows, dot, halve, longest_first, without_unused
from scan3d.shown import Described, Rows
from scan3d.units import angle, length, number, point, share

if TYPE_CHECKING:
    import trimesh

# The bounds are not improved further where their difference is less than this fraction of the distance, or less than this
# number of diagonals.
_RELATIVE_GAP = 1e-3
# By which places of triangles become places within them; large numbers of no common measure.
_STEPS = 300 * np.sqrt([[2.0, 3.0, 5.0], [7.0, 11.0, 13.0]])


@dataclass(frozen=True, repr=False)
class Comparison(Described):
    """Distances between a surface and a mesh, in the meshes' own unit unless said otherwise."""

    hausdorff: float  #: two-sided; attained at `worst_point`, so never larger than the true distance
    surface_to_mesh: float  #: one-sided, attained
    mesh_to_surface: float
    lower: float  #: certified bounds of the two-sided distance; both are `hausdorff` if `exact`
    upper: float
    surface_to_mesh_upper: float  #: certified upper bounds of the one-sided distances
    mesh_to_surface_upper: float
    exact: bool  #: both meshes are closed and convex (to 1e-9 of the diagonal), and `hausdorff` is the distance itself
    worst_point: Array  #: (3,) where the distance is attained
    worst_on: Literal["surface", "mesh"]  #: the one of the two on which that point lies
    diagonal: float  #: of the mesh's bounding box
    relative: float  #: hausdorff / diagonal
    mean: float  #: over the area, half the weight to either direction
    rms: float  #: likewise
    p95: float  #: 95 % of the area, weighted likewise, is no farther than this
    chamfer: float  #: sum of the two directions' means
    f_score: float  #: 0..1, harmonic mean of the fractions of either area within 1 % of the diagonal of the other
    normal_median_deg: float  #: angle between the faces' normals at nearest points, over the area as above
    normal_p95_deg: float
    volume_error: float  #: (surface - mesh) / mesh; NaN unless both are closed

    def summary(self, unit: str = "") -> Rows:
        """The distances, also as parts of the mesh's diagonal; in a unit, if that of the meshes is given."""

        def size(value: float, digits: int = 4, *, up: bool = False) -> str:
            return length(value, unit, digits=digits, up=up) if unit else number(value, digits)

        def both(value: float) -> str:
            return f"{size(value)} ({share(value / self.diagonal)})"

        between = f"certified between {size(self.lower, 5)} and {size(self.upper, 5, up=True)}"
        certainty = "exact" if self.exact else between
        averages = f"{both(self.mean)}, RMS {both(self.rms)}, 95 % closer than {both(self.p95)}"
        place = point(self.worst_point, unit) if unit else "({:.4g}, {:.4g}, {:.4g})".format(*(self.worst_point + 0.0))
        error = self.volume_error
        return [
            ("Hausdorff distance", f"{both(self.hausdorff)}, {certainty}"),
            ("surface to mesh", both(self.surface_to_mesh)),
            ("mesh to surface", both(self.mesh_to_surface)),
            ("worst at", f"{place}, on the {self.worst_on}"),
            ("mean", averages),
            ("Chamfer distance", f"{size(self.chamfer)}, F-score {self.f_score:.4f} at 1 % of the diagonal"),
            ("normals differ by", f"{angle(self.normal_median_deg)} (median), {angle(self.normal_p95_deg)} (95 %)"),
            ("volume error", share(error) if np.isfinite(error) else "unknown: open"),
        ]

    def _title(self) -> str:
        return "Comparison (lengths in units of the meshes; in brackets, of the mesh's diagonal)"


def compare(surface: trimesh.Trimesh, mesh: trimesh.Trimesh) -> Comparison:
    """Compare a reconstructed surface with the true mesh.

    Either may be open, non-convex or in several parts; closed shells that overlap, touch or lie in each other are taken for the
    body that they enclose together.  Averages are taken over at most 20 000 points of each surface, spread
    by area and not at random, so that the same meshes give the same numbers.  The winding of the faces gives the direction of
    their normals.  Raises InputError if either has no faces, coordinates that aren't finite, or no extent.  The methods are
    described in ``scan3d/comparison.py``.
    """
    return _compared(*_prepared(surface, mesh))


def compare_with_points(
    surface: trimesh.Trimesh, points: Array, mesh: trimesh.Trimesh, within: float = 0.0
) -> tuple[Comparison, Array, Mapping[str, float]]:
    """`compare` of a surface with a mesh, the distances (n,) of points (n, 3) from the mesh, and what was reached of it.

    That is the share of the mesh's area no farther than `within` from a point and not facing away from it, as the other side of
    a thin wall does, how far the surface is from it there, at most and in the mean of 20 000 places; and the share that
    bounds closed cavities.
    """
    prepared = bodies, centre, scale, _ = _prepared(surface, mesh)
    points, reached = (points - centre) / scale, {}
    error, face = bodies[1].search.nearest(points)
    if within:
        places, normals = _spread(bodies[1].corners), bodies[1].normals
        distance, nearest = cKDTree(points).query(places.points)
        near = (distance <= within / scale) & (dot(normals[face[nearest]], normals[places.faces]) > -1e-6)
        off, weight = bodies[0].search.nearest(places.points[near])[0] * scale, places.weights[near]
        total = float(weight.sum())
        reached = {"share": total, "max": off.max(initial=0.0), "mean": float((weight * off).sum()) / (total or 1.0)}
        enclosed = cavities(bodies[1].vertices, bodies[1].faces)
        reached["in_cavities"] = float(places.weights[enclosed[places.faces]].sum())
    return _compared(*prepared), error * scale, reached


def _compared(bodies: tuple[Body, Body], centre: Array, scale: float, diagonal: float) -> Comparison:
    """`compare` of two bodies at the size of their common bounding box; arguments as returned by `_prepared`."""
    pairs, exact = (bodies, bodies[::-1]), max(body.slack for body in bodies) <= CONVEX_DEPTH
    sides = one_sided_distances(pairs, exact)
    worst = max(sides, key=lambda side: side.lower)

    samples = [_spread(body.corners) for body in bodies]
    weights = [sample.weights for sample in samples]
    deviations = [_deviations(*pair, sample) for pair, sample in zip(pairs, samples, strict=True)]
    distances, angles = zip(*deviations, strict=True)
    # sums of numpy, as products of BLAS depend on its number of threads
    means = [float((w * d).sum()) for w, d in zip(weights, distances, strict=True)]
    squares = [float((w * d**2).sum()) for w, d in zip(weights, distances, strict=True)]
    within = [min(1.0, float(w[d * scale <= 0.01 * diagonal].sum())) for w, d in zip(weights, distances, strict=True)]
    weight = np.concatenate(weights)
    normal_median, normal_p95 = weighted_quantiles(np.concatenate(angles), weight, (0.5, 0.95)).tolist()
    return Comparison(
        hausdorff=worst.lower * scale,
        surface_to_mesh=sides[0].lower * scale,
        mesh_to_surface=sides[1].lower * scale,
        lower=worst.lower * scale,
        upper=max(side.upper for side in sides) * scale,
        surface_to_mesh_upper=sides[0].upper * scale,
        mesh_to_surface_upper=sides[1].upper * scale,
        exact=exact,
        worst_point=worst.point * scale + centre,
        worst_on="surface" if worst is sides[0] else "mesh",
        diagonal=diagonal,
        relative=worst.lower * scale / diagonal,
        mean=sum(means) / 2 * scale,
        rms=float(np.sqrt(sum(squares) / 2)) * scale,
        p95=float(weighted_quantiles(np.concatenate(distances), weight, [0.95])[0]) * scale,
        chamfer=sum(means) * scale,
        f_score=2 * within[0] * within[1] / sum(within) if sum(within) else 0.0,
        normal_median_deg=normal_median,
        normal_p95_deg=normal_p95,
        volume_error=bodies[0].volume / bodies[1].volume - 1 if bodies[1].volume else np.nan,
    )


def _prepared(surface: trimesh.Trimesh, mesh: trimesh.Trimesh) -> tuple[tuple[Body, Body], Array, float, float]:
    """Both meshes at the size of their common bounding box, its middle (3,), its diagonal, and that of the mesh alone."""
    boxes = np.array([bounding_box(surface, "surface"), bounding_box(mesh, "mesh")])
    surface, mesh = whole_body(surface), whole_body(mesh)
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    centre, scale = (low + high) / 2, float(np.linalg.norm(high - low))
    diagonal = float(np.linalg.norm(boxes[1, 1] - boxes[1, 0]))
    return (prepare(surface, centre, scale), prepare(mesh, centre, scale)), centre, scale, diagonal


class _Samples(NamedTuple):
    """Points spread over a surface by area."""

    points: Array
    """(q, 3)"""
    faces: Index
    """(q,) the face that each point lies on."""
    weights: Array
    """(q,) fraction of the area that each point stands for."""


def _spread(corners: Array) -> _Samples:
    """Points spread evenly over triangles (m, 3, 3), not at random."""
    pieces, owner = corners, np.arange(len(corners))
    while True:  # halve the pieces with long edges
        length = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1)
        long = length > (0.5 + NEGLIGIBLE) * length.max()
        # none is long if the surface is but a point beside the other one
        if not long.any() or len(pieces) + np.count_nonzero(long) > SOME:
            break
        pieces = np.concatenate([pieces[~long], halve(pieces[long])[0]])
        owner = np.concatenate([owner[~long], owner[long], owner[long]])
    area = areas(pieces)
    covered = np.cumsum(area if area.any() else np.ones(len(pieces)))
    covered /= covered[-1]
    if len(pieces) <= SOME:
        return _Samples(_within(pieces), owner, np.diff(covered, prepend=0.0))
    # One piece for each of equal parts of the area.  Its place in the part follows the golden ratio, because a regular choice
    # could coincide with a regularity of the mesh.
    number = np.arange(SOME)
    chosen = np.searchsorted(covered, (number + number * 0.5 * (np.sqrt(5) - 1) % 1) / SOME)
    return _Samples(_within(pieces[chosen]), owner[chosen], np.full(SOME, 1 / SOME))


def _within(triangles: Array) -> Array:
    """A point (m, 3) of each triangle (m, 3, 3), all over them: their middles are away from edges, where surfaces are off most.

    Where it is in a triangle follows from the triangle's place, and not from the order of the triangles.
    """
    first, second, third = triangles.swapaxes(0, 1)
    u, v = ((triangles.sum(axis=1) * steps).sum(axis=1, keepdims=True) % 1 for steps in _STEPS)
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return np.asarray(first + u * (second - first) + v * (third - first))


def _deviations(source: Body, target: Body, samples: _Samples) -> tuple[Array, Array]:
    """Distances (q,) of the source's samples from the target, and angles (q,) between the normals there, in degrees.

    An angle is NaN where either face has no area.
    """
    distance, face, lower = target.search.near(samples.points, 10)
    # For samples far away any face nearby will do, because thousands are almost as near as the nearest one.
    # the error of an average is about the square of this
    uncertain = distance - lower > 0.05 * distance
    if np.isfinite(target.slack):
        # the target lies below the planes of its faces: a point straight above a face is no nearer to another one
        above = dot(target.planes[face, :3], samples.points) - target.planes[face, 3]
        uncertain &= distance - above > 1e-6 * distance
    distance[uncertain], face[uncertain] = target.search.nearest(samples.points[uncertain])
    a, b = source.normals[samples.faces], target.normals[face]
    angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), dot(a, b)))
    return distance, np.where(a.any(axis=1) & b.any(axis=1), angle, np.nan)


class Side(NamedTuple):
    """Bounds of a one-sided distance, and the point (3,) where the lower one is attained."""

    lower: float
    point: Array
    upper: float


@dataclass(frozen=True, kw_only=True)
class Body(Facets):
    """A triangle mesh ready for distance queries."""

    planes: Array
    """(m, 4) for each face, n and c of a plane <n, x> = c that supports the hull."""
    slack: float
    """Upper bound of the Hausdorff distance between this surface and that of its hull; may be infinite."""
    search: Search
    """Of the faces."""


def prepare(mesh: trimesh.Trimesh, centre: Array, scale: float) -> Body:
    """A mesh moved by ``-centre`` and divided by `scale`, its distance from its hull, and the search for its nearest faces."""
    facets = prepare_facets(mesh, centre, scale)
    planes, slack = against_hull(facets)
    return Body(**vars(facets), planes=planes, slack=slack, search=Search(facets.corners))


def _deepest_dent(points: Array, faces: Index, facets: Index, planes: Array, negligible: float) -> tuple[float, Array]:
    """Upper bound of the depth of triangles below the surface of their convex hull, and the point (3,) where they are deepest.

    points (n, 3), faces (m, 3), facets (h, 3), planes (h, 4)
        at unit size; the hull's triangles, and their planes, n and c of ``<n, x> <= c``.
    negligible
        depth that is not determined further, because it is rounding.
    """
    bodies = []
    for sides, supporting, slack in ((faces, np.empty((0, 4)), np.inf), (facets, planes, 0.0)):
        used, renumbered = without_unused(sides)
        turned = np.take_along_axis(renumbered, longest_first(points[sides]), axis=1)
        corners = points[used][turned]
        known = Facets(points[used], turned, corners, corners[:, 0], False, np.nan)
        bodies.append(Body(**vars(known), planes=supporting, slack=slack, search=Search(corners)))
    (found,) = one_sided_distances(((bodies[0], bodies[1]),), False, negligible)
    return found.upper, found.point


def against_own_hull(points: Array, faces: Index) -> tuple[Index, float, Array, float]:
    """The facets (h, 3) of the hull of points (n, 3) at unit size, an upper bound of the depth of the faces (m, 3) below it and
    where they are deepest (3,), and the fraction of its area that they cover."""
    facets = outward_faces(points, faces)
    if facets is not None:
        return facets, 0.0, points[0], 1.0
    qhull = ConvexHull(points)
    facets = outward_facets(qhull)
    assert facets is not None  # the hull of a body is one closed surface
    planes = qhull.equations * [1, 1, 1, -1]
    dent, deepest = _deepest_dent(points, faces, facets, planes, 0.01 * DENT_TOLERANCE)
    distinct = distinct_rows(np.sort(faces, axis=1))[0]  # those with the same vertices count once
    covered = float(areas(points[faces[distinct]]).sum() / areas(points[facets]).sum())
    return facets, dent, deepest, covered


def one_sided_distances(
    pairs: tuple[tuple[Body, Body], ...], exact: bool, negligible: float = NEGLIGIBLE
) -> list[Side]:
    """The one-sided distances from each pair's source to its target; if all bodies are convex (`exact`), the larger one of the
    distances has equal bounds.  Bounds closer than `negligible` are not improved."""
    found, largest = _at_vertices(pairs)
    slacks = [source.slack for source, _ in pairs]
    upper = largest if exact else largest + sum(slacks) + max(slacks)
    sides = []
    for (source, target), (distance, face, exactly) in zip(pairs, found, strict=True):
        farthest = int(np.where(exactly, distance, -1.0).argmax())
        start = Side(float(distance[farthest]), source.vertices[farthest], float(distance.max()))
        sides.append(_split(source, target, face, start, upper, negligible))
    return sides


def _at_vertices(pairs: tuple[tuple[Body, Body], ...]) -> tuple[list[tuple[Array, Index, Mask]], float]:
    """Distances (n,) of each source's vertices from its target, the target's faces (n,) there, and whether they are exact (n,),
    and the largest distance.

    Distances that are not exact are upper bounds, and no larger than the largest distance.
    """
    quick = [target.search.near(source.vertices)[:2] for source, target in pairs]
    known = [np.zeros(len(distance), dtype=bool) for distance, _ in quick]

    def settle(floor: float, gap: float) -> float:
        """The largest distance of a vertex.

        Quick estimates are replaced by exact distances until none exceeds `floor` nor the largest exact distance of its side by
        more than the fraction `gap`.
        """
        largest = []
        for (source, target), (distance, face), exactly in zip(pairs, quick, known, strict=True):
            batch = 16  # doubled from batch to batch
            while True:
                threshold = max(floor, (1 + gap) * distance[exactly].max(initial=0.0)) + 1e-15  # rounding
                rest = np.flatnonzero(~exactly & (distance > threshold))
                if len(rest) == 0:
                    break
                part = rest[np.argsort(-distance[rest])[:batch]]
                improved, face[part] = target.search.nearest(source.vertices[part])
                distance[part] = np.minimum(improved, distance[part])
                exactly[part] = True
                batch *= 2
            largest.append(distance[exactly].max(initial=0.0))
        return float(max(largest))

    largest = settle(floor=settle(floor=0.0, gap=_RELATIVE_GAP / 2), gap=0.0)
    return [(*estimate, exactly) for estimate, exactly in zip(quick, known, strict=True)], largest


def _split(source: Body, target: Body, near: Index, vertices: Side, upper: float, negligible: float) -> Side:
    """The largest distance from any point of the source to the target, by splitting faces.

    near (n,)
        a target face near each vertex of the source.
    vertices
        bounds of the largest distance at a vertex.
    upper
        an upper bound of the result that is already known.
    """
    lower, point, settled = vertices
    convex = target.slack <= _RELATIVE_GAP / 10 * lower  # nearly
    slack = target.slack if convex else 0.0

    def bound(corners: Array, faces: Index) -> tuple[Array, Index]:
        """Upper bounds (m,) of the distance over triangles (m, 3, 3), and which of the target faces (m, k) give them."""
        if convex:
            plane = target.planes[faces]
            values = plane[..., 3, None] - np.einsum("mjx,mix->mji", plane[..., :3], corners)
        else:
            values = distance_to(corners[:, None], target.corners[faces][:, :, None])
        values = values.max(axis=2)
        least = (np.arange(len(values)), values.argmin(axis=1))
        return values[least], faces[least]

    def gap() -> float:
        return max(_RELATIVE_GAP * lower, negligible)

    if upper - lower <= gap():
        return Side(lower, point, upper)
    corners, faces = source.corners, near[source.faces[:, [0, 1, 2, 0]]]
    above, faces[:, 3] = bound(corners, faces)
    loose = np.flatnonzero(above + slack > lower + gap())
    faces[loose, 3] = target.search.near(corners[loose].mean(axis=1))[1]
    above[loose], faces[loose, 3] = bound(corners[loose], faces[loose])
    splits = 0
    while True:
        # Triangles whose bounds are too small to matter are dropped; of the others, those with the largest bounds are split
        # first.
        matters = above + slack > lower + gap()
        settled = max(settled, float(above[~matters].max(initial=0.0)))
        corners, faces, above = corners[matters], faces[matters], above[matters]
        if len(above) == 0 or splits >= 40_000 or upper - lower <= gap():
            highest = max(lower, settled, float(above.max(initial=0.0)))
            return Side(lower, point, max(lower, min(upper, highest + slack)))
        order = np.argsort(-above)
        first, rest = order[:4096], order[4096:]  # so many at once
        middle = corners[first, :2].mean(axis=1)
        distance, face = target.search.nearest(middle)
        splits += len(first)
        if distance.max() > lower:
            lower, point = float(distance.max()), middle[distance.argmax()]
        halves, turn = halve(corners[first])
        close = np.concatenate([faces[first], faces[first]])
        close[: len(first), 1] = close[len(first) :, 0] = face
        close[:, :3] = np.take_along_axis(close[:, :3], turn, axis=1)
        tighter, close[:, 3] = bound(halves, close)
        corners, faces = np.concatenate([corners[rest], halves]), np.concatenate([faces[rest], close])
        above = np.concatenate([above[rest], np.minimum(tighter, np.tile(above[first], 2))])
