"""How far apart a surface and the true mesh are: the Hausdorff distance, averages, normals and volume."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from scan3d.arrays import Array, Index
from scan3d.geometry.distance import bounding_box
from scan3d.geometry.hausdorff import Body, one_sided_distances, prepare
from scan3d.geometry.hull_distance import CONVEX_DEPTH
from scan3d.geometry.triangles import areas, dot, halve
from scan3d.shown import Shown

if TYPE_CHECKING:
    import trimesh

SAMPLES = 20_000  # per direction, for the averages
AVERAGE_GAP = 0.05  # of the distance: certain for each point of an average; in fact it is about its square
F_SCORE_RADIUS = 0.01  # of the mesh's diagonal


@dataclass(frozen=True)
class Comparison(Shown):
    """Distances between a surface and a mesh, in the meshes' own unit unless said otherwise."""

    hausdorff: float  #: two-sided; attained at `worst_point`, so never above the truth
    surface_to_mesh: float  #: one-sided, attained
    mesh_to_surface: float
    lower: float  #: certified bounds of the two-sided distance; both are `hausdorff` if `exact`
    upper: float
    surface_to_mesh_upper: float  #: certified upper bounds of the one-sided distances
    mesh_to_surface_upper: float
    exact: bool  #: both closed and convex (to 1e-9 of the diagonal): `hausdorff` is the distance itself
    worst_point: Array  #: (3,) where the distance is attained
    worst_on: Literal["surface", "mesh"]  #: on which of the two that point lies
    diagonal: float  #: of the mesh's bounding box
    relative: float  #: hausdorff / diagonal
    mean: float  #: over the area, half the weight to either direction
    rms: float  #: likewise
    p95: float  #: 95 % of the area, weighted likewise, is no farther than this
    chamfer: float  #: sum of the two directions' means
    f_score: float  #: 0..1: harmonic mean of the shares of area within 1 % of the diagonal of the other
    normal_median_deg: float  #: angle between the faces' normals at nearest points, over the area as above
    normal_p95_deg: float
    volume_error: float  #: (surface - mesh) / mesh; NaN unless both are closed


def compare(surface: trimesh.Trimesh, mesh: trimesh.Trimesh) -> Comparison:
    """Compare a reconstructed surface with the true mesh.

    Either may be open, non-convex or in several parts.  Averages are taken over at most 20 000 points a side, spread by
    area and without chance: the same meshes give the same figures.  Normals point where the faces' winding says.
    Raises InputError if either has no faces, coordinates that aren't finite, or no extent.
    Method: see the module's docstring.
    """
    boxes = np.array([bounding_box(surface, "surface"), bounding_box(mesh, "mesh")])
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    centre, scale = (low + high) / 2, float(np.linalg.norm(high - low))
    diagonal = float(np.linalg.norm(boxes[1, 1] - boxes[1, 0]))
    bodies = prepare(surface, centre, scale), prepare(mesh, centre, scale)
    pairs = bodies, bodies[::-1]

    exact = max(body.slack for body in bodies) <= CONVEX_DEPTH
    sides = one_sided_distances(pairs, exact)
    worst = max(sides, key=lambda side: side.lower)

    samples = [_spread(body.corners) for body in bodies]
    weights = [sample.weights for sample in samples]
    deviations = [_deviations(*pair, sample) for pair, sample in zip(pairs, samples, strict=True)]
    distances, angles = zip(*deviations, strict=True)
    means = [float(w @ d) for w, d in zip(weights, distances, strict=True)]
    squares = [float(w @ d**2) for w, d in zip(weights, distances, strict=True)]
    within = [float(w @ (d * scale <= F_SCORE_RADIUS * diagonal)) for w, d in zip(weights, distances, strict=True)]
    weight = np.concatenate(weights)
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
        p95=_quantile(np.concatenate(distances), weight, 0.95) * scale,
        chamfer=sum(means) * scale,
        f_score=2 * within[0] * within[1] / sum(within) if sum(within) else 0.0,
        normal_median_deg=_quantile(np.concatenate(angles), weight, 0.5),
        normal_p95_deg=_quantile(np.concatenate(angles), weight, 0.95),
        volume_error=bodies[0].volume / bodies[1].volume - 1 if bodies[1].volume else np.nan,
    )


class _Samples(NamedTuple):
    """Points spread over a surface by area."""

    points: Array
    """(q, 3)"""
    faces: Index
    """(q,) the face that each point lies on."""
    weights: Array
    """(q,) fraction of the area that each point stands for."""


def _spread(corners: Array) -> _Samples:
    """Points spread evenly over triangles (m, 3, 3), without chance."""
    pieces, owner = corners, np.arange(len(corners))
    while True:  # cut the long ones
        length = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1)
        long = length > length.max() / 2
        if len(pieces) + np.count_nonzero(long) > SAMPLES:
            break
        pieces = np.concatenate([pieces[~long], halve(pieces[long])[0]])
        owner = np.concatenate([owner[~long], owner[long], owner[long]])
    area = areas(pieces)
    share = np.cumsum(area if area.any() else np.ones(len(pieces)))
    share /= share[-1]
    if len(pieces) <= SAMPLES:
        return _Samples(pieces.mean(axis=1), owner, np.diff(share, prepend=0.0))
    # One out of every so much area; which one follows the golden ratio, so as not to fall in step with the mesh.
    at = np.searchsorted(share, (np.arange(SAMPLES) + np.arange(SAMPLES) * 0.5 * (np.sqrt(5) - 1) % 1) / SAMPLES)
    return _Samples(pieces[at].mean(axis=1), owner[at], np.full(SAMPLES, 1 / SAMPLES))


def _deviations(source: Body, target: Body, samples: _Samples) -> tuple[Array, Array]:
    """At the source's samples, distance to the target and angle between the normals in degrees, NaN where there is none."""
    distance, face, least = target.search.near(samples.points)
    # Far away a near face will do: thousands are almost as near as the nearest, and the averages wouldn't change.
    doubtful = distance - least > AVERAGE_GAP * distance
    distance[doubtful], face[doubtful] = target.search.nearest(samples.points[doubtful])
    a, b = source.normals[samples.faces], target.normals[face]
    angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), dot(a, b)))
    return distance, np.where(a.any(axis=1) & b.any(axis=1), angle, np.nan)


def _quantile(values: Array, weights: Array, share: float) -> float:
    """The value that `share` of the weight doesn't exceed; NaN values don't count."""
    order = np.argsort(values)[: np.count_nonzero(~np.isnan(values))]
    if len(order) == 0:
        return np.nan
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, share * total[-1])]])
