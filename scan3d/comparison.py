"""How far apart a surface and the true mesh are: the Hausdorff distance, averages, normals and volume."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import SOME, Array, Index, weighted_quantiles
from scan3d.geometry.distance import bounding_box
from scan3d.geometry.hausdorff import Body, one_sided_distances, prepare
from scan3d.geometry.hulls import CONVEX_DEPTH
from scan3d.geometry.triangles import areas, dot, halve
from scan3d.shown import Described, Rows, described
from scan3d.units import angle, length, number, point, share

if TYPE_CHECKING:
    import trimesh


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

    def __repr__(self) -> str:
        title = "Comparison (lengths in units of the meshes; in brackets, of the mesh's diagonal)"
        return described(title, self.summary())


def compare(surface: trimesh.Trimesh, mesh: trimesh.Trimesh) -> Comparison:
    """Compare a reconstructed surface with the true mesh.

    Either may be open, non-convex or in several parts.  Averages are taken over at most 20 000 points of each surface, spread
    by area and not at random, so that the same meshes give the same numbers.  The winding of the faces gives the direction of
    their normals.  Raises InputError if either has no faces, coordinates that aren't finite, or no extent.  The methods are
    described in `scan3d.geometry.hausdorff`.
    """
    return _compared(*_prepared(surface, mesh))


def compare_with_points(
    surface: trimesh.Trimesh, points: Array, mesh: trimesh.Trimesh, within: float = 0.0
) -> tuple[Comparison, Array, Mapping[str, float]]:
    """`compare` of a surface with a mesh, the distances (n,) of points (n, 3) from the mesh, and what was reached of it.

    That is the share of the mesh's area no farther than `within` from a point and not facing away from it, as the other side of
    a thin wall does, and how far the surface is from it there: at most, by 20 000 places, and in the mean.
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
        long = length > length.max() / 2
        # none is long if the surface is but a point beside the other one
        if not long.any() or len(pieces) + np.count_nonzero(long) > SOME:
            break
        pieces = np.concatenate([pieces[~long], halve(pieces[long])[0]])
        owner = np.concatenate([owner[~long], owner[long], owner[long]])
    area = areas(pieces)
    covered = np.cumsum(area if area.any() else np.ones(len(pieces)))
    covered /= covered[-1]
    if len(pieces) <= SOME:
        return _Samples(pieces.mean(axis=1), owner, np.diff(covered, prepend=0.0))
    # One piece for each of equal parts of the area.  Its place in the part follows the golden ratio, because a regular choice
    # could coincide with a regularity of the mesh.
    number = np.arange(SOME)
    chosen = np.searchsorted(covered, (number + number * 0.5 * (np.sqrt(5) - 1) % 1) / SOME)
    return _Samples(pieces[chosen].mean(axis=1), owner[chosen], np.full(SOME, 1 / SOME))


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
