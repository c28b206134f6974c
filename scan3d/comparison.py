"""How far apart two surfaces are: the Hausdorff distance with a certificate, and its companions.

With d(x, B) the distance from a point to a surface, the one-sided distance from A to B is the largest d(x, B) over *all
points* x of A, and the Hausdorff distance h(A, B) is the larger of the two one-sided ones.

For two convex closed surfaces A, B bounding K, L it is exactly r = the largest, over the vertices of both, of the
distance to the other surface.  Proof.  (1) d(., L) is convex, so over K it is largest at a vertex of A, where it is
d(v, B) unless zero; likewise the other way.  So h(K, L) <= r, and r, taken at points of A and B, is <= h(A, B).
(2) h(A, B) <= h(K, L): let x be in A.  If x isn't inside L, d(x, B) = d(x, L).  Otherwise let u be an outer normal of K
at x.  L lies in K + h(K, L) * ball, so along u it reaches at most h(K, L) beyond x: the ray from x along u leaves L,
through B, within h(K, L).  Hence r = h(A, B).  (Schneider, *Convex Bodies: The Brunn-Minkowski Theory*, lemma 1.8.1.)

The smaller of the one-sided distances, and surfaces that aren't convex, have no such shortcut: the farthest point may lie
inside a face.  There a triangle T of A is bounded by min_j max_v d(v, t_j), with v its corners and t_j any triangles of B,
for the distance to a convex set is convex.  Where B is convex, its planes instead bound the points of T inside it, far
more tightly, and the points outside never exceed the vertices.  Splitting the triangles with the largest bounds closes
the gap.  A mesh convex but for rounding (a single-precision file) is held against its hull, and the bounds widened by
``slack``, the distance between the two.

Lengths inside this module are in diagonals of the common bounding box; only `compare` knows the meshes' unit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError, cKDTree

from scan3d.errors import InputError

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CONVEX_DEPTH = 1e-9  # of the diagonal: a dent less deep than this is rounding
NEAR_CONVEX_DEPTH = 1e-4  # likewise: one deeper than this is a dent
ROUNDING = 1e-15  # of the diagonal
RELATIVE_GAP = 1e-3  # of the distance: certified bounds this close are close enough
ABSOLUTE_GAP = 1e-9  # of the diagonal: likewise
MAX_SPLITS = 40_000  # per direction, a fraction of a second; beyond it the bounds stay honest, only wider
BATCH = 4096
SAMPLES = 20_000  # per direction, for the averages
AVERAGE_GAP = 0.05  # of the distance: certain for each point of an average; in fact it is about its square
F_SCORE_RADIUS = 0.01  # of the mesh's diagonal


@dataclass(frozen=True)
class Comparison:
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

    def plot(self, **how: Any) -> Any:
        """A picture (the distances as bars), a `PIL.Image.Image`; `how` are the options of `scan3d.plot`."""
        from scan3d.display import plot

        return plot(self, **how)

    def _repr_html_(self) -> str:
        from scan3d.display import comparison_html

        return comparison_html(self)


class _Side(NamedTuple):
    """Bounds of a one-sided distance, and the point (3,) where the lower one is attained."""

    lower: float
    point: Array
    upper: float


@dataclass(frozen=True)
class _Body:
    """A triangle mesh ready for distance queries."""

    vertices: Array  # (n, 3)
    faces: Index  # (m, 3), longest edge first
    corners: Array  # (m, 3, 3) vertices of the faces
    normals: Array  # (m, 3), zero where a face has no area
    volume: float  # NaN unless closed
    planes: Array  # (m, 4) per face, n and c of a plane <n, x> = c that supports the hull
    slack: float  # bound of the Hausdorff distance between this surface and its hull's; infinite if far from convex
    samples: Array  # (q, 3)
    sampled: Index  # (q,) their faces
    weights: Array  # (q,) their shares of the area
    search: _Search


def compare(surface: trimesh.Trimesh, mesh: trimesh.Trimesh) -> Comparison:
    """Compare a reconstructed surface with the true mesh.

    Either may be open, non-convex or in several parts.  Averages are taken over at most 20 000 points a side, spread by
    area and without chance: the same meshes give the same figures.  Normals point where the faces' winding says.
    Raises InputError if either has no faces, coordinates that aren't finite, or no extent.
    Method: see the module's docstring.
    """
    boxes = np.array([_box(surface, "surface"), _box(mesh, "mesh")])
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    centre, scale = (low + high) / 2, float(np.linalg.norm(high - low))
    diagonal = float(np.linalg.norm(boxes[1, 1] - boxes[1, 0]))
    bodies = _prepare(surface, centre, scale), _prepare(mesh, centre, scale)
    pairs = bodies, bodies[::-1]

    exact = max(body.slack for body in bodies) <= CONVEX_DEPTH
    sides = _one_sided_distances(pairs, exact)
    worst = max(sides, key=lambda side: side.lower)

    weights = [body.weights for body in bodies]
    distances, angles = zip(*(_deviations(*pair) for pair in pairs), strict=True)
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


def nearest(points: Array, mesh: trimesh.Trimesh) -> tuple[Array, Index, Array]:
    """Distance (p,) of points (p, 3) to a convex mesh, negative inside, the face (p,) and the point (p, 3) nearest to them.

    Raises InputError as `compare`.
    """
    box = _box(mesh, "mesh")
    centre, scale = box.mean(axis=0), float(np.linalg.norm(box[1] - box[0]))
    vertices, faces = _welded(mesh, centre, scale)
    points = (np.asarray(points, dtype=np.float64).reshape(-1, 3) - centre) / scale
    corners = vertices[faces]
    face, foot = _locator(corners)(points)
    # a point lies on the far side of its foot from the middle exactly if it is outside
    outside = _dot(points - foot, vertices.mean(axis=0) - foot) < 0
    offset = _offset(points, corners[face])
    distance = np.where(outside, 1.0, -1.0) * np.linalg.norm(offset, axis=1)
    return distance * scale, face, (points - offset) * scale + centre


def distances(points: Array, mesh: trimesh.Trimesh) -> Array:
    """Distance (p,) of points (p, 3) to a mesh's surface, never negative."""
    return np.abs(nearest(points, mesh)[0])


def signed_distances(points: Array, mesh: trimesh.Trimesh) -> Array:
    """Distance (p,) of points (p, 3) to a convex mesh, negative inside."""
    return nearest(points, mesh)[0]


def _box(mesh: trimesh.Trimesh, name: str) -> Array:
    """Bounding box (2, 3) of a mesh's faces.  Raises InputError if they can't be compared."""
    if len(mesh.faces) == 0:
        raise InputError(
            f"the {name} should have at least one triangle, but it has {len(mesh.vertices)} vertices and no faces; "
            "check that its file holds triangles, or build a surface from its points first"
        )
    used = np.asarray(mesh.vertices, dtype=np.float64)[np.unique(mesh.faces)]
    bad = int((~np.isfinite(used).all(axis=1)).sum())
    if bad:
        raise InputError(
            f"the {name} should have finite coordinates, but {bad} of its {len(used)} vertices are NaN or infinite; "
            "repair or export it again"
        )
    box = np.array([used.min(axis=0), used.max(axis=0)])
    if not (box[1] > box[0]).any():
        raise InputError(
            f"the {name} should have an extent, but all its {len(used)} vertices are at {box[0].tolist()}; "
            "check its file and its scale"
        )
    return box


def _welded(mesh: trimesh.Trimesh, centre: Array, scale: float) -> tuple[Array, Index]:
    """A mesh's vertices (n, 3), brought to the common size and each there once, and faces (m, 3), longest edge first."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    scaled = (np.asarray(mesh.vertices, dtype=np.float64)[used] - centre) / scale
    vertices, welded = np.unique(scaled, axis=0, return_inverse=True)
    faces = welded.ravel()[faces.reshape(-1, 3)]
    faces = np.take_along_axis(faces, _longest_first(vertices[faces]), axis=1)
    return vertices, faces


def _prepare(mesh: trimesh.Trimesh, centre: Array, scale: float) -> _Body:
    """Bring a mesh to the common size, judge its convexity and set up its distance queries."""
    vertices, faces = _welded(mesh, centre, scale)
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(cross, axis=1, keepdims=True)
    normals = np.divide(cross, size, out=np.zeros_like(cross), where=size > 0)

    # Closed: every directed edge meets its reverse, so that the boundary is zero as a chain.
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    closed = np.array_equal(np.sort(start * len(vertices) + end), np.sort(end * len(vertices) + start))
    volume = abs(float(_dot(corners[:, 0], cross).sum())) / 6 if closed else np.nan
    planes, slack = _against_hull(vertices, corners, normals, closed)

    return _Body(vertices, faces, corners, normals, volume, planes, slack, *_spread(corners), _Search(corners))


def _spread(corners: Array) -> tuple[Array, Index, Array]:
    """Points (q, 3) all over triangles (m, 3, 3), which triangle each is on, and its share of the area."""
    pieces, owner = corners, np.arange(len(corners))
    while True:  # cut the long ones
        length = np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1)
        long = length > length.max() / 2
        if len(pieces) + np.count_nonzero(long) > SAMPLES:
            break
        pieces = np.concatenate([pieces[~long], _halve(pieces[long])[0]])
        owner = np.concatenate([owner[~long], owner[long], owner[long]])
    area = _areas(pieces)
    share = np.cumsum(area if area.any() else np.ones(len(pieces)))
    share /= share[-1]
    if len(pieces) <= SAMPLES:
        return pieces.mean(axis=1), owner, np.diff(share, prepend=0.0)
    # One out of every so much area; which one follows the golden ratio, so as not to fall in step with the mesh.
    at = np.searchsorted(share, (np.arange(SAMPLES) + np.arange(SAMPLES) * 0.5 * (np.sqrt(5) - 1) % 1) / SAMPLES)
    return pieces[at].mean(axis=1), owner[at], np.full(SAMPLES, 1 / SAMPLES)


def _planes(points: Array) -> Array:
    """n and c (k, 4) of the planes <n, x> = c of points' convex hull, outward; none if the points are flat."""
    try:
        return np.unique(ConvexHull(points).equations, axis=0) * [1, 1, 1, -1]
    except (QhullError, ValueError):
        return np.empty((0, 4))


def _against_hull(vertices: Array, corners: Array, normals: Array, closed: bool) -> tuple[Array, float]:
    """A supporting plane (m, 4) for every face, and a bound of the distance between the surface and its hull's.

    Depth below the hull's surface is concave on a face and not negative, so nowhere more than three times that of the
    face's middle.  If the surface winds once around a point c inside, every ray from c meets it, no deeper than that:
    along the ray that is within depth * R / r of the hull's surface, r and R the least and largest distance of c to it.
    """
    none = np.empty((0, 4)), np.inf
    planes = _planes(vertices)
    if len(planes) == 0:
        return none
    middles = corners.mean(axis=1)
    c = np.average(middles, axis=0, weights=_areas(corners))
    r = float((planes[:, 3] - planes[:, :3] @ c).min())
    big_r = float(np.linalg.norm(vertices - c, axis=1).max())

    rays = corners - c
    length = np.linalg.norm(rays, axis=2)
    cosines = (_dot(rays, np.roll(rays, -1, axis=1)) * np.roll(length, 1, axis=1)).sum(axis=1)
    sines = _dot(rays[:, 0], np.cross(rays[:, 1], rays[:, 2]))
    winding = float(np.arctan2(sines, length.prod(axis=1) + cosines).sum()) / (2 * np.pi)  # Van Oosterom, Strackee 1983
    missing = abs(abs(winding) - 1)
    if r <= 0 or missing > 1e-6:
        return none
    # What an open surface leaves uncovered has room for a disc of this radius; a closed one leaves nothing.
    hole = 0.0 if closed else 2 * np.sqrt(missing + 1e-14) * big_r

    outward = normals * np.where(_dot(middles - c, normals) < 0, -1, 1)[:, None]
    chosen = cKDTree(planes[:, :3], balanced_tree=False).query(outward, workers=-1)[1]
    depth = planes[chosen, 3] - _dot(planes[chosen, :3], middles)
    # A sliver's normal is rounding: try all planes on the deepest faces, as many as time allows.
    order = np.argsort(-depth)
    trials = max(1, 200_000_000 // len(planes))
    if depth[order[trials - 1 :]].max(initial=0.0) > NEAR_CONVEX_DEPTH:
        return none
    deepest = order[:trials][depth[order[:trials]] > CONVEX_DEPTH / 10]
    for some in np.array_split(deepest, 1 + len(deepest) * len(planes) // 4_000_000):
        depths = planes[:, 3] - middles[some] @ planes[:, :3].T
        chosen[some], depth[some] = depths.argmin(axis=1), depths.min(axis=1)
    return planes[chosen], (3 * max(float(depth.max()), 0.0) + hole) * big_r / r


def _one_sided_distances(pairs: tuple[tuple[_Body, _Body], ...], exact: bool) -> list[_Side]:
    """From each source to its target; the larger one without a gap if both are convex."""
    quick = [target.search.near(source.vertices)[:2] for source, target in pairs]
    known = [np.zeros(len(distance), dtype=bool) for distance, _ in quick]

    def settle(floor: float, gap: float) -> float:
        """Replace quick distances by exact ones until none can exceed `floor` or, by `gap`, its side's largest."""
        largest = []
        for (source, target), (distance, face), sure in zip(pairs, quick, known, strict=True):
            some = 16
            while True:
                enough = max(floor, (1 + gap) * distance[sure].max(initial=0.0)) + ROUNDING
                rest = np.flatnonzero(~sure & (distance > enough))
                if len(rest) == 0:
                    break
                part = rest[np.argsort(-distance[rest])[:some]]
                better, face[part] = target.search.nearest(source.vertices[part])
                distance[part] = np.minimum(better, distance[part])
                sure[part] = True
                some *= 2
            largest.append(distance[sure].max(initial=0.0))
        return float(max(largest))

    largest = settle(floor=settle(floor=0.0, gap=RELATIVE_GAP / 2), gap=0.0)
    slacks = [source.slack for source, _ in pairs]
    cap = largest if exact else largest + sum(slacks) + max(slacks)
    sides = []
    for (source, target), (distance, face), sure in zip(pairs, quick, known, strict=True):
        at = int(np.where(sure, distance, -1.0).argmax())
        start = _Side(float(distance[at]), source.vertices[at], float(distance.max()))
        sides.append(_split(source, target, face, start, cap))
    return sides


def _split(source: _Body, target: _Body, near: Index, vertices: _Side, cap: float) -> _Side:
    """The largest distance from any point of the source to the target, by splitting faces.

    near (n,): a target face near each vertex of the source.  vertices: bounds of the largest distance at a vertex.
    cap: an upper bound known otherwise.
    """
    lower, point, settled = vertices
    convex = target.slack <= RELATIVE_GAP / 10 * lower
    slack = target.slack if convex else 0.0

    def bound(corners: Array, faces: Index) -> tuple[Array, Index]:
        """Bound of the distance over triangles (m, 3, 3), from target faces (m, 4), and the face that gives it."""
        if convex:
            plane = target.planes[faces]
            values = plane[..., 3, None] - np.einsum("mjx,mix->mji", plane[..., :3], corners)
        else:
            values = _distance(corners[:, None], target.corners[faces][:, :, None])
        return _least(values.max(axis=2), faces)

    def gap() -> float:
        return max(RELATIVE_GAP * lower, ABSOLUTE_GAP)

    if cap - lower <= gap():
        return _Side(lower, point, cap)
    corners, faces = source.corners, near[source.faces[:, [0, 1, 2, 0]]]
    above, faces[:, 3] = bound(corners, faces)
    loose = np.flatnonzero(above + slack > lower + gap())
    faces[loose, 3] = target.search.near(corners[loose].mean(axis=1))[1]
    above[loose], faces[loose, 3] = bound(corners[loose], faces[loose])
    splits = 0
    while True:
        # Let go of the triangles that can't matter; of the others, split those first that allow for most.
        matters = above + slack > lower + gap()
        settled = max(settled, float(above[~matters].max(initial=0.0)))
        corners, faces, above = corners[matters], faces[matters], above[matters]
        if len(above) == 0 or splits >= MAX_SPLITS or cap - lower <= gap():
            highest = max(lower, settled, float(above.max(initial=0.0)))
            return _Side(lower, point, max(lower, min(cap, highest + slack)))
        order = np.argsort(-above)
        first, rest = order[:BATCH], order[BATCH:]
        middle = corners[first, :2].mean(axis=1)
        distance, face = target.search.nearest(middle)
        splits += len(first)
        if distance.max() > lower:
            lower, point = float(distance.max()), middle[distance.argmax()]
        halves, turn = _halve(corners[first])
        close = np.concatenate([faces[first], faces[first]])
        close[: len(first), 1] = close[len(first) :, 0] = face
        close[:, :3] = np.take_along_axis(close[:, :3], turn, axis=1)
        tighter, close[:, 3] = bound(halves, close)
        corners, faces = np.concatenate([corners[rest], halves]), np.concatenate([faces[rest], close])
        above = np.concatenate([above[rest], np.minimum(tighter, np.tile(above[first], 2))])


def _deviations(source: _Body, target: _Body) -> tuple[Array, Array]:
    """At the source's samples, distance to the target and angle between the normals in degrees, NaN where there is none."""
    distance, face, least = target.search.near(source.samples)
    # Far away a near face will do: thousands are almost as near as the nearest, and the averages wouldn't change.
    doubtful = distance - least > AVERAGE_GAP * distance
    distance[doubtful], face[doubtful] = target.search.nearest(source.samples[doubtful])
    a, b = source.normals[source.sampled], target.normals[face]
    angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), _dot(a, b)))
    return distance, np.where(a.any(axis=1) & b.any(axis=1), angle, np.nan)


def _quantile(values: Array, weights: Array, share: float) -> float:
    """The value that `share` of the weight doesn't exceed; NaN values don't count."""
    order = np.argsort(values)[: np.count_nonzero(~np.isnan(values))]
    if len(order) == 0:
        return np.nan
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, share * total[-1])]])


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...x,...x->...", a, b)


def _least(values: Array, labels: Index) -> tuple[Array, Index]:
    """The least value of each row (m, k) and its label."""
    best = values.argmin(axis=1)[:, None]
    return np.take_along_axis(values, best, 1)[:, 0], np.take_along_axis(labels, best, 1)[:, 0]


def _areas(corners: Array) -> Array:
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2


def _longest_first(corners: Array) -> Index:
    """Order (m, 3) of the corners of triangles (m, 3, 3) that puts the longest edge first and keeps the winding."""
    edges = np.roll(corners, -1, axis=1) - corners
    return (_dot(edges, edges).argmax(axis=1)[:, None] + np.arange(3)) % 3


def _halve(corners: Array) -> tuple[Array, Index]:
    """Triangles (m, 3, 3) cut across their longest edge: first halves, then second, (2m, 3, 3), and their new order."""
    halves = np.concatenate([corners, corners])
    halves[: len(corners), 1] = halves[len(corners) :, 0] = corners[:, :2].mean(axis=1)
    turn = _longest_first(halves)
    return np.take_along_axis(halves, turn[:, :, None], axis=1), turn


class _Search:
    """Nearest of triangles (m, 3, 3), longest edge first."""

    def __init__(self, corners: Array) -> None:
        middles = corners.mean(axis=1)
        self._corners = corners
        self._radius = float(np.linalg.norm(corners - middles[:, None], axis=2).max())
        self._tree = cKDTree(middles, balanced_tree=False)  # balancing is slow where many share a coordinate
        self._locate = _locator(corners)

    def near(self, points: Array) -> tuple[Array, Index, Array]:
        """Distance (p,) of points (p, 3) to a triangle near by, which, and a lower bound of that to the nearest."""
        to_middle, face = self._tree.query(points, k=[1, 2, 3, 4][: self._tree.n], workers=-1)
        return *_least(_distance(points[:, None], self._corners[face]), face), to_middle[:, 0] - self._radius

    def nearest(self, points: Array) -> tuple[Array, Index]:
        """Distance (p,) of points (p, 3) to the nearest triangle, to rounding, and which; slower."""
        face, _ = self._locate(points)
        return _distance(points, self._corners[face]), face


def _distance(points: Array, corners: Array) -> Array:
    """Distance of points (..., 3) to triangles (..., 3, 3), longest edge first, down to slivers and single points."""
    return np.linalg.norm(_offset(points, corners), axis=-1)


def _offset(points: Array, corners: Array) -> Array:
    """Vectors to points (..., 3) from the nearest ones of triangles (..., 3, 3), longest edge first.

    Coordinates along the longest edge and across it: a sliver's normal would lose all digits.
    """
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    r, e, f = points - a, b - a, c - a

    def ratio(x: Array, y: Array) -> Array:
        """Component of x along y, 0 where y is."""
        return _dot(x, y) / np.maximum(_dot(y, y), np.finfo(np.float64).tiny)

    def to_edge(x: Array, y: Array) -> Array:
        return x - np.clip(ratio(x, y), 0, 1)[..., None] * y

    along, shear = ratio(r, e), ratio(f, e)
    v = ratio(r - along[..., None] * e, f - shear[..., None] * e)
    u = along - v * shear
    nearest = r - u[..., None] * e - v[..., None] * f
    distance = np.linalg.norm(nearest, axis=-1)
    distance[(u < 0) | (v < 0) | (u + v > 1)] = np.inf
    for offset in (to_edge(r, e), to_edge(r, f), to_edge(points - b, c - b)):
        nearer = np.linalg.norm(offset, axis=-1) < distance
        nearest[nearer] = offset[nearer]
        distance[nearer] = np.linalg.norm(offset[nearer], axis=-1)
    return nearest


def _locator(triangles: Array) -> Callable[[Array], tuple[Index, Array]]:
    """A function from points (p, 3) to the nearest of some triangles, longest edge first, and the nearest points (p, 3)."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import reference, vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkGenericCell, vtkPolyData, vtkStaticCellLocator

    def cells(corners: Index) -> Any:
        array, starts = vtkCellArray(), np.arange(len(corners) + 1) * corners.shape[1]
        array.SetData(numpy_to_vtkIdTypeArray(starts, deep=True), numpy_to_vtkIdTypeArray(corners.ravel(), deep=True))
        return array

    # VTK passes over triangles without area: they go in as their longest edge.  It counts lines before triangles.
    length = np.linalg.norm(triangles[:, 1] - triangles[:, 0], axis=1)
    flat = 2 * _areas(triangles) <= 1e-14 * length**2
    order = np.argsort(~flat, kind="stable")
    index = np.arange(3 * len(triangles)).reshape(-1, 3)
    points, data, locator = vtkPoints(), vtkPolyData(), vtkStaticCellLocator()
    points.SetDataTypeToDouble()
    points.SetData(numpy_to_vtk(triangles.reshape(-1, 3), deep=True))
    data.SetPoints(points)
    data.SetLines(cells(index[flat, :2]))
    data.SetPolys(cells(index[~flat]))
    locator.SetDataSet(data)
    locator.BuildLocator()

    def nearest(queries: Array) -> tuple[Index, Array]:
        found, feet = np.empty(len(queries), dtype=np.int64), np.empty((len(queries), 3))
        closest, cell = [0.0] * 3, vtkGenericCell()
        at: Any = reference(0)
        part: Any = reference(0)
        squared: Any = reference(0.0)
        for i, query in enumerate(queries.tolist()):
            locator.FindClosestPoint(query, closest, cell, at, part, squared)
            found[i], feet[i] = at, closest
        return order[found], feet

    return nearest
