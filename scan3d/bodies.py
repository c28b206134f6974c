"""Bodies to scan: load a mesh file, judge whether it is convex, slice it.

Convexity is judged by depth, not by a flag: the *dent* of a mesh is the largest depth of its surface below the surface of
its convex hull. A point inside a convex polyhedron lies as deep as its nearest facet plane is far, so depth is the least of
many linear functions: concave on each triangle, and bounded from above by any of them. That makes the deepest dent a
branch-and-bound search whose answer is certain, needs no neighbours (triangle soups are fine) and also finds an edge
flipped the wrong way, where every vertex lies on the hull and the surface doesn't.

Everything is computed in float64 at unit size about the centre of the box, so no unit is too small or too large.
"""

import hashlib
import io
import os
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError, cKDTree
from trimesh.exchange.load import mesh_loaders

from scan3d.errors import InputError

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

FORMATS = ("stl", "ply", "obj", "off", "glb")

# All relative to the diagonal of the bounding box.
DENT_TOLERANCE = 1e-5
"""Deepest dent of a body that counts as convex: float32 files of fine meshes and CAD exports have dents of 1e-7 to 1e-6
from rounding alone, and no rod feels a hundred-thousandth of the body."""
DENT_PRECISION = 1e-3
"""A dent is known to this share of itself; one below `NEGLIGIBLE_DENT` is only known to be below it."""
NEGLIGIBLE_DENT = 0.01 * DENT_TOLERANCE
FLAT = 1e-6
"""Least thickness of a body: rounding to float32 leaves an oblique flat sheet 1e-8 to 1e-7 thick."""
OPEN_TOLERANCE = 1e-3
"""Share of the hull's area that may lack a surface: more than rounding, less than any face that matters."""

_PROBES = 2_000_000  # distances in one step of the search: tens of milliseconds, tens of megabytes
_SPLITS = 4_000  # triangles halved in one step while no dent is known: takes as long
_NEARBY = 0.02  # of the diagonal, and radians: planes farther off are left to the probes
_ROUNDING = 8 * np.finfo(np.float64).eps  # of a rotated coordinate, relative to its size


def load_mesh(path: str | os.PathLike[str], *, hull: bool = False) -> trimesh.Trimesh:
    """The convex body in a mesh file: STL (binary or ASCII), PLY, OBJ, OFF or GLB.

    Returns the triangulated convex hull of the file's surface, watertight and outward, with the hull's vertices only, in
    the file's units. A body convex within `DENT_TOLERANCE` differs from its file by at most the dent, so that all that
    follows may rely on exact convexity. (`trimesh` gives zero normals to triangles below 1e-13 square units: bring a
    body of that size to unit size before asking for them.)

    `metadata` gets `file` (name), `path`, `sha256`, `file_faces`, `dent` (deepest dent in the file's units, from above),
    `dent_relative` (to the diagonal of the bounding box) and `hull`.

    hull: take the convex hull even of a body that is dented or open.

    Raises InputError if the file can't be read, has no triangles, isn't finite, is flat, dented or open.
    """
    path = Path(path)
    data = _read(path)
    triangles = _triangles(path, data)
    first, inverse = _distinct_rows(triangles.reshape(-1, 3))
    vertices = triangles.reshape(-1, 3)[first]
    if len(vertices) < 4:
        raise InputError(f"{path.name} has only {len(vertices)} distinct vertices, where a body needs at least 4")

    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent = (high - low).max()
    diagonal = float(extent * np.linalg.norm((high - low) / extent))  # squares of very small numbers would vanish
    center = low + (high - low) / 2
    points = (vertices - center) / diagonal
    thickness = _thickness(points)
    if thickness < FLAT:
        raise InputError(
            f"{path.name} is flat: it is {thickness * diagonal:.3g} thick ({thickness:.2g} of its diagonal, where at least "
            f"{FLAT:g} is needed); check that the file holds a solid body"
        )

    outer, faces = _hull(points), inverse.reshape(-1, 3)
    dent, deepest = _deepest_dent(points[faces], outer)
    if not hull and dent > DENT_TOLERANCE:
        place = ", ".join(f"{x:.6g}" for x in center + diagonal * deepest)
        raise InputError(
            f"{path.name} isn't convex: its deepest dent is {dent * diagonal:.3g} deep ({dent:.3g} of its diagonal, where "
            f"{DENT_TOLERANCE:g} is allowed), at ({place}); to scan its convex hull instead, give --hull (hull=True)"
        )
    bare = 1 - _area(points, _distinct_faces(faces)) / _area(points, outer.facets)
    if not hull and bare > OPEN_TOLERANCE:
        raise InputError(
            f"{path.name} is open: {100 * bare:.2g} % of its convex hull has no surface, where a closed body is expected; "
            "close it, or to scan its convex hull give --hull (hull=True)"
        )

    used, facets = np.unique(outer.facets, return_inverse=True)
    body = trimesh.Trimesh(vertices=vertices[used], faces=facets.reshape(-1, 3), process=False)
    body.metadata.update(
        file=path.name,
        path=str(path.resolve()),
        sha256=hashlib.sha256(data).hexdigest(),
        file_faces=len(faces),
        dent=dent * diagonal,
        dent_relative=dent,
        hull=hull,
    )
    return body


def slice_polygons(mesh: trimesh.Trimesh, rotation: ArrayLike, heights: ArrayLike) -> list[Floats]:
    """Exact cross sections of a convex mesh, in the units of the mesh.

    rotation: (3, 3), its rows are the slice frame's x, y and z axes in the world; the frame's origin is the world's.
    heights: (n,) of the slices, along the frame's z axis, in any order.

    Returns n convex polygons (m, 2), counter-clockwise in the frame's x and y, without duplicate or collinear vertices;
    (0, 2) where the plane misses the body or touches it in a point or an edge only. A plane that holds a face of the
    body, within rounding, gives that face. Vertices are exact to rounding of the body's size and place.

    Raises ValueError unless the rotation's rows are orthonormal and the heights are (n,).
    """
    rotation, heights = np.asarray(rotation, np.float64), np.asarray(heights, np.float64)
    if rotation.shape != (3, 3) or not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9):
        raise ValueError(f"rotation must be (3, 3) with orthonormal rows, but it is {rotation.tolist()}")
    if heights.ndim != 1:
        raise ValueError(f"heights must be (n,), but their shape is {heights.shape}")

    center = mesh.bounds.mean(axis=0)
    origin = rotation @ center
    points = (mesh.vertices.view(np.ndarray) - center) @ rotation.T  # about the centre, where float64 is finest
    rounding = _ROUNDING * float(np.linalg.norm(mesh.extents) + np.linalg.norm(center))
    order = np.argsort(heights)
    levels = heights[order] - origin[2]

    # A vertex within rounding of the plane lies on it; an edge crosses it where its ends lie strictly on either side.
    z = points[:, 2]
    on, on_level = _pairs(np.searchsorted(levels, z - rounding), np.searchsorted(levels, z + rounding, side="right"))
    edges = mesh.edges_unique
    low, high = np.where(z[edges[:, 0]] <= z[edges[:, 1]], edges.T, edges.T[::-1])
    crossed, crossed_level = _pairs(
        np.searchsorted(levels, z[low] + rounding, side="right"), np.searchsorted(levels, z[high] - rounding)
    )
    a, b = points[low[crossed]], points[high[crossed]]
    below, above = levels[crossed_level] - a[:, 2], b[:, 2] - levels[crossed_level]
    crossings = (above[:, None] * a[:, :2] + below[:, None] * b[:, :2]) / (below + above)[:, None]

    level = np.concatenate([on_level, crossed_level])
    by_level = np.argsort(level, kind="stable")
    outline = np.concatenate([points[on, :2], crossings])[by_level]
    ends = np.searchsorted(level[by_level], np.arange(len(levels) + 1))
    polygons = [np.empty((0, 2))] * len(heights)
    for i, j in enumerate(order):
        polygons[j] = _convex_polygon(outline[ends[i] : ends[i + 1]], rounding) + origin[:2]
    return polygons


def extent_along(mesh: trimesh.Trimesh, axis: ArrayLike) -> tuple[float, float]:
    """Lowest and highest coordinate of the mesh along an axis (3,) of any length, in the units of the mesh.

    Raises ValueError if the axis has no direction.
    """
    axis = np.asarray(axis, np.float64)
    length = np.linalg.norm(axis)
    if axis.shape != (3,) or not (0 < length < np.inf):
        raise ValueError(f"axis must be three finite numbers, not all 0, but it is {axis.tolist()}")
    heights = mesh.vertices.view(np.ndarray) @ (axis / length)
    return float(heights.min()), float(heights.max())


def read_mesh(path: str | os.PathLike[str]) -> trimesh.Trimesh:
    """The triangles of a mesh file as they are, convex or not, with equal vertices merged.

    Raises InputError if the file can't be read, has no triangles or isn't finite.
    """
    path = Path(path)
    triangles = _triangles(path, _read(path))
    first, inverse = _distinct_rows(triangles.reshape(-1, 3))
    return trimesh.Trimesh(triangles.reshape(-1, 3)[first], inverse.reshape(-1, 3), process=False)


def _read(path: Path) -> bytes:
    if path.is_dir():
        raise InputError(f"{path.name or path} is a folder, where a mesh file is expected; name a file in it")
    if not path.exists():
        raise InputError(f"there is no mesh file {path.name} in {path.absolute().parent}; check the path")
    if path.suffix[1:].lower() not in FORMATS:
        raise InputError(f"{path.name} isn't a mesh file by its ending, which should be one of .{', .'.join(FORMATS)}")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path.name} can't be read: {error.strerror or error}; check its permissions") from error
    if not data:
        raise InputError(f"{path.name} is empty, where a mesh is expected; export or download it again")
    return data


def _triangles(path: Path, data: bytes) -> Floats:
    """Corners (t, 3, 3) of all triangles in a file, as they are: nothing merged, nothing dropped."""
    kind = path.suffix[1:].lower()
    try:
        with warnings.catch_warnings():
            # On a broken number older numpy only warns, and returns the numbers before it: half a body.
            warnings.filterwarnings("error", message="string or file could not be read")
            meshes = _parse(kind, data)
    # trimesh's parsers raise whatever breaks first on foreign bytes: KeyError, IndexError, struct.error, MemoryError, …
    except Exception as error:
        raise InputError(
            f"{path.name} can't be read as {kind.upper()}: it is damaged or another kind of file; export it again"
        ) from error
    if not all(np.isfinite(vertices).all() for vertices, _ in meshes):
        raise InputError(f"{path.name} has vertices that are NaN or infinite; repair or export it again")
    if sum(len(faces) for _, faces in meshes) == 0:
        raise InputError(
            f"{path.name} has no triangles, where a surface is expected: it is a cloud of points, damaged, or no "
            f"{kind.upper()} file; export the body as a triangle mesh"
        )
    return np.concatenate([vertices[faces] for vertices, faces in meshes])


def _parse(kind: str, data: bytes) -> list[tuple[Floats, Indices]]:
    """Vertices (v, 3) in the world and faces (f, 3) of each mesh in a file.

    The loaders are called below trimesh.load, which would drop vertices that aren't finite before they can be seen.
    """
    raw = mesh_loaders[kind](io.BytesIO(data), file_type=kind, resolver=None, skip_materials=True)
    geometries = {
        name: {"vertices": part["vertices"], "faces": part["faces"], "process": False}
        for name, part in raw.get("geometry", {"mesh": raw}).items()
        if part.get("faces") is not None
    }
    layout = {key: raw[key] for key in ("graph", "base_frame") if key in raw}
    scene = trimesh.load_scene({"geometry": geometries, **layout})
    meshes = []
    for node in scene.graph.nodes_geometry:
        transform, name = scene.graph[node]
        if name in scene.geometry:
            mesh = scene.geometry[name]
            if len(mesh.faces) and (mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices)):
                raise IndexError("a face names a vertex that isn't there")
            meshes.append((trimesh.transform_points(mesh.vertices, transform), np.asarray(mesh.faces)))
    return meshes


def _distinct_rows(rows: NDArray) -> tuple[Indices, Indices]:
    """Index of one of each distinct row (n,), and for every row (m,) which one it is. Several times np.unique's speed."""
    order = np.lexsort(rows.T)
    new = np.ones(len(rows), bool)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    inverse = np.empty(len(rows), np.int64)
    inverse[order] = np.cumsum(new) - 1
    return order[new], inverse


def _distinct_faces(faces: Indices) -> Indices:
    return faces[_distinct_rows(np.sort(faces, axis=1))[0]]


def _area(points: Floats, faces: Indices) -> float:
    a, b, c = points[faces].transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _thickness(points: Floats) -> float:
    """Extent (at unit size) across the plane that fits the points best."""
    centered = points - points.mean(axis=0)
    across = np.linalg.eigh(centered.T @ centered)[1][:, 0]
    return float(np.ptp(centered @ across))


@dataclass(frozen=True)
class _Hull:
    """Convex hull of points at unit size."""

    facets: Indices
    """(h, 3) triangles, outward."""
    planes: Floats
    """(p, 4) the distinct planes of the facets: n·x + d <= 0 inside."""
    facet_plane: Indices
    """(h,) which plane a facet lies in."""
    by_place: cKDTree
    """Of the facets' centres."""
    by_direction: cKDTree
    """Of the planes' normals."""


def _hull(points: Floats) -> _Hull:
    hull = ConvexHull(points)
    facets = hull.simplices.astype(np.int64)
    count = len(facets)
    # Qhull orients facets at random, and the normal of a sliver is no guide. But two facets run through their common edge
    # in opposite directions: that sorts facets and their mirror images into one outward and one inward surface.
    start, end = facets.T.ravel(), np.roll(facets, -1, axis=1).T.ravel()
    common = np.lexsort((np.maximum(start, end), np.minimum(start, end))).reshape(-1, 2)
    one, other = common.T % count
    other = np.where(start[common[:, 0]] != start[common[:, 1]], other, other + count)
    ends = np.concatenate([one, one + count]), np.concatenate([other, (other + count) % (2 * count)])
    links = coo_array((np.ones(len(ends[0])), ends), shape=(2 * count, 2 * count))
    surface = connected_components(links, directed=False)[1][:count]
    mirrored = surface != surface[0]
    facets[mirrored] = facets[mirrored, ::-1]
    if np.linalg.det(points[facets]).sum() < 0:
        facets = facets[:, ::-1]
    first, facet_plane = _distinct_rows(hull.equations)
    planes = hull.equations[first]
    return _Hull(facets, planes, facet_plane, cKDTree(points[facets].mean(axis=1)), cKDTree(planes[:, :3]))


def _deepest_dent(corners: Floats, hull: _Hull) -> tuple[float, Floats]:
    """Greatest depth of triangles (t, 3, 3) below their hull, from above, and a point that deep.

    Over a triangle the depth is at most the greatest depth of its corners below any one plane. Triangles that this can't
    exclude are probed at their corners and centre; the planes nearest to the probes sharpen the bounds of all the rest,
    and the probed triangles are halved until bound and probes agree. While no dent is known, many more are halved, and
    bounded by the planes nearby: the dents of rounding are so many and so alike that probing each would take minutes.
    """
    upper = _bounds(corners, hull)
    found, excluded, where = 0.0, 0.0, corners[np.argmax(upper), 0]
    while True:
        live = upper > max((1 + DENT_PRECISION) * found, NEGLIGIBLE_DENT)
        excluded = max(excluded, float(upper[~live].max(initial=0.0)))
        if not live.any():
            return max(found, excluded), where
        corners, upper = corners[live], upper[live]
        order = np.argsort(-upper)
        corners, upper = corners[order], upper[order]

        count = max(4, _PROBES // (4 * (len(hull.planes) + 3 * len(upper))))
        probes = np.concatenate([corners[:count].reshape(-1, 3), corners[:count].mean(axis=1)])
        depths = _depths(probes, hull.planes)
        depth, nearest = depths.min(axis=1), np.unique(depths.argmin(axis=1))
        if depth.max() > found:
            found, where = float(depth.max()), probes[depth.argmax()]

        shallow = found <= DENT_TOLERANCE
        count = _SPLITS if shallow else count
        halves = _halves(corners[:count])
        bounds = np.tile(upper[:count], 2)
        if shallow:
            bounds = np.minimum(bounds, _bounds(halves, hull))
        corners, upper = np.concatenate([corners[count:], halves]), np.concatenate([upper[count:], bounds])
        upper = np.minimum(upper, _depths(corners, hull.planes[nearest]).max(axis=1).min(axis=1))


def _depths(points: Floats, planes: Floats) -> Floats:
    """Depth of points (..., 3) below planes (p, 4): (..., p)."""
    return -(points @ planes[:, :3].T + planes[:, 3])


def _bounds(corners: Floats, hull: _Hull) -> Floats:
    """Upper bounds (t,) of the depth of triangles, from the planes nearest in place and nearest in direction."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), np.finfo(np.float64).tiny)[:, None]
    place = hull.by_place.query(corners.mean(axis=1), distance_upper_bound=_NEARBY)[1]
    one, other = (
        hull.by_direction.query(n, distance_upper_bound=_NEARBY)[1] for n in (normal, -normal)
    )  # out is either
    bound = np.full(len(corners), np.inf)
    for nearest in (np.append(hull.facet_plane, 0)[place], one % len(hull.planes), other % len(hull.planes)):
        plane = hull.planes[nearest]  # where none is nearby the index is one too high: any plane will do
        np.minimum(bound, -(np.einsum("tcx,tx->tc", corners, plane[:, :3]) + plane[:, 3:]).min(axis=1), out=bound)
    return np.maximum(bound, 0)


def _halves(corners: Floats) -> Floats:
    """Triangles (t, 3, 3) cut in two (2t, 3, 3) across their longest edge."""
    edges = np.roll(corners, -1, axis=1) - corners
    longest = np.einsum("tcx,tcx->tc", edges, edges).argmax(axis=1)
    a, b, c = (corners[np.arange(len(corners)), (longest + i) % 3] for i in range(3))
    middle = (a + b) / 2
    return np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])


def _pairs(first: Indices, last: Indices) -> tuple[Indices, Indices]:
    """All (i, j) with first[i] <= j < last[i], as two arrays."""
    count = np.maximum(last - first, 0)
    i = np.repeat(np.arange(len(count)), count)
    return i, np.arange(len(i)) - np.repeat(np.cumsum(count) - count - first, count)


def _convex_polygon(points: Floats, rounding: float) -> Floats:
    """Counter-clockwise hull (m, 2) of points (n, 2) without vertices that rounding can't tell from their neighbours."""
    nothing = np.empty((0, 2))
    if len(points) < 3 or (size := np.ptp(points, axis=0).max()) <= rounding:
        return nothing
    try:
        polygon = points[ConvexHull((points - points.mean(axis=0)) / size).vertices]
    except QhullError:  # all on one line
        return nothing
    while len(polygon) >= 3:
        before, after = polygon - np.roll(polygon, 1, axis=0), np.roll(polygon, -1, axis=0) - polygon
        turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        bulge = turn / np.linalg.norm(before + after, axis=1)  # distance from the neighbours' chord
        if bulge.min() > rounding:
            return polygon
        polygon = np.delete(polygon, bulge.argmin(), axis=0)  # one by one: of two that coincide one stays
    return nothing
