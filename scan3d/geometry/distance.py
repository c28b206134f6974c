"""Nearest points of triangle meshes, and the distances from them."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import AT_ONCE, NEGLIGIBLE, ROUNDING, Array, Index, Mask, ratio
from scan3d.errors import InputError
from scan3d.geometry.triangles import (
    areas,
    distance_to,
    distinct_rows,
    dot,
    face_normals,
    largest_of_three,
    longest_first,
    offset_from,
    without_unused,
)

if TYPE_CHECKING:
    import trimesh


# Points whose nearest ones are sought at once.
_QUERIES = 100_000


def nearest(points: Array, mesh: trimesh.Trimesh) -> tuple[Array, Index, Array]:
    """Nearest points of a convex mesh.

    Returns the distances (p,) of points (p, 3) from its surface, negative inside, and the nearest face (p,) and point (p, 3) of
    the mesh.  Raises InputError as `scan3d.compare`.
    """
    return nearest_on(mesh)(points)


def nearest_on(mesh: trimesh.Trimesh) -> Callable[[Array], tuple[Array, Index, Array]]:
    """`nearest` as a function of the points alone, for many calls with the same convex mesh."""
    box = bounding_box(mesh, "mesh")
    centre, scale = box.mean(axis=0), float(np.linalg.norm(box[1] - box[0]))
    vertices, faces = welded(mesh, centre, scale)
    corners, middle = vertices[faces], vertices.mean(axis=0)
    locate = locator(corners)

    def nearest(points: Array) -> tuple[Array, Index, Array]:
        points = (np.asarray(points, dtype=np.float64).reshape(-1, 3) - centre) / scale
        face, foot = locate(points)
        # a point is outside exactly if it and the middle of the mesh lie on opposite sides of its nearest point
        outside = dot(points - foot, middle - foot) < 0
        offset = offset_from(points, corners[face])
        distance = np.where(outside, 1.0, -1.0) * np.linalg.norm(offset, axis=1)
        return distance * scale, face, (points - offset) * scale + centre

    return nearest


def distances(points: Array, mesh: trimesh.Trimesh) -> Array:
    """Distances (p,) of points (p, 3) from a mesh's surface, never negative."""
    return np.abs(nearest(points, mesh)[0])


def signed_distances(points: Array, mesh: trimesh.Trimesh) -> Array:
    """Distances (p,) of points (p, 3) from a convex mesh, negative inside."""
    return nearest(points, mesh)[0]


def check_mesh(mesh: Any, name: str) -> None:
    """Raises InputError, in which the mesh is called `name`, for what is no `trimesh.Trimesh` with faces of its vertices."""
    import trimesh

    if not isinstance(mesh, trimesh.Trimesh):
        advice = ""
        if isinstance(mesh, trimesh.Scene):
            advice = "; a scene becomes a mesh by its method to_mesh()"
        elif isinstance(mesh, (str, os.PathLike)):
            advice = "; read a file with scan3d.load_mesh"
        raise InputError(f"the {name} must be a trimesh.Trimesh, got {type(mesh).__name__}{advice}")
    faces = np.asarray(mesh.faces)
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(mesh.vertices):
        raise InputError(f"the {name} has a face with a vertex that does not exist; repair or export it again")


def bounding_box(mesh: trimesh.Trimesh, name: str) -> Array:
    """Bounding box (2, 3) of a mesh's faces.

    Raises InputError, in which the mesh is called `name`, if it is no mesh, has no faces, coordinates that
    aren't finite, or no extent.
    """
    check_mesh(mesh, name)
    if len(mesh.faces) == 0:
        raise InputError(
            f"the {name} should have at least one triangle, but it has {len(mesh.vertices)} vertices and no faces; "
            "check that its file holds triangles, or build a surface from its points first"
        )
    used = np.asarray(mesh.vertices, dtype=np.float64)[without_unused(np.asarray(mesh.faces))[0]]
    if not np.isfinite(used).all():
        bad = int((~np.isfinite(used).all(axis=1)).sum())
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
    largest, extent = float(np.abs(box).max()), float((box[1] - box[0]).max())
    if largest > 1e100 or extent < 1 / 1e100:
        raise InputError(
            f"the {name} has an extent of {extent:.3g} and coordinates up to {largest:.3g}, whose powers are no numbers of a "
            "computer; check its file and its scale"
        )
    return box


def welded(mesh: trimesh.Trimesh, centre: Array, scale: float) -> tuple[Array, Index]:
    """Distinct vertices (n, 3) of a mesh and its faces (m, 3), longest edge first.

    The vertices are moved by ``-centre`` and divided by `scale`.
    """
    used, faces = without_unused(np.asarray(mesh.faces))
    scaled = (np.asarray(mesh.vertices, dtype=np.float64)[used] - centre) / scale
    first, number = distinct_rows(scaled[:, ::-1])
    vertices, renumbered = scaled[first], number[faces]
    return vertices, np.take_along_axis(renumbered, longest_first(vertices[renumbered]), axis=1)


class Search:
    """Search for the nearest of triangles (m, 3, 3), longest edge first."""

    def __init__(self, corners: Array) -> None:
        middles = corners.mean(axis=1)
        self._corners = corners
        self._radii = largest_of_three(np.linalg.norm(corners - middles[:, None], axis=2))
        self._radius = float(self._radii.max())
        self._tree = cKDTree(middles, balanced_tree=False)  # balancing is slow where many share a coordinate
        self._locate = locator(corners)

    def near(self, points: Array, tried: int = 4) -> tuple[Array, Index, Array]:
        """Quick estimates: distances (p,) of points (p, 3) from a triangle nearby, the number (p,) of that triangle, and lower
        bounds (p,) of the distances from the nearest one.

        The triangle is the nearest of those that are `tried`, the ones with the nearest middles; fewer make wider bounds.
        """
        ranks = list(range(1, min(tried, self._tree.n) + 1))
        to_middle, faces = self._tree.query(points, k=ranks, workers=-1)
        face = faces[:, 0].copy()
        distance = distance_to(points, self._corners[face])
        for rank in range(1, len(ranks)):
            least = to_middle[:, rank] - self._radii[faces[:, rank]]
            nearer = np.flatnonzero(least <= distance + ROUNDING)  # the others are farther than the one that is known
            trial = distance_to(points[nearer], self._corners[faces[nearer, rank]])
            best = trial < distance[nearer]
            distance[nearer[best]], face[nearer[best]] = trial[best], faces[nearer[best], rank]
        # no triangle that was not tried is nearer than this
        others = to_middle[:, -1] - self._radius if len(ranks) < self._tree.n else np.inf
        return distance, face, np.minimum(distance, others)

    def nearest(self, points: Array) -> tuple[Array, Index]:
        """Distances (p,) of points (p, 3) from the nearest triangle, and its number (p,); exact to rounding, and slower."""
        face, _ = self._locate(points)
        return distance_to(points, self._corners[face]), face


def locator(triangles: Array) -> Callable[[Array], tuple[Index, Array]]:
    """A function from points (p, 3) to the numbers (p,) of the nearest triangles and their nearest points (p, 3).

    The triangles (m, 3, 3) have their longest edge first.
    """
    from vtkmodules.vtkCommonCore import reference
    from vtkmodules.vtkCommonDataModel import vtkGenericCell, vtkStaticCellLocator

    # VTK passes over triangles without area, so they are represented by their longest edge.  It counts lines before
    # triangles.
    length = np.linalg.norm(triangles[:, 1] - triangles[:, 0], axis=1)
    degenerate = 2 * areas(triangles) <= 1e-14 * length**2
    order = np.argsort(~degenerate, kind="stable")
    index = np.arange(3 * len(triangles)).reshape(-1, 3)
    locator = vtkStaticCellLocator()
    locator.SetDataSet(poly_data(triangles.reshape(-1, 3), index[~degenerate], index[degenerate, :2]))
    locator.SetNumberOfCellsPerNode(1)  # a search takes a fifth less than with the ten of the default
    locator.BuildLocator()

    def nearest(queries: Array) -> tuple[Index, Array]:
        found, feet = np.empty(len(queries), dtype=np.intp), np.empty((len(queries), 3))
        foot, work = [0.0] * 3, vtkGenericCell()
        cell: Any = reference(0)
        part: Any = reference(0)
        squared: Any = reference(0.0)
        for first in range(0, len(queries), _QUERIES):
            cells: list[int] = []
            points: list[float] = []
            # no list for each point, which the garbage collector would look through
            for query in zip(*queries[first : first + _QUERIES].T.tolist(), strict=True):
                locator.FindClosestPoint(query, foot, work, cell, part, squared)
                cells.append(cell.get())
                points += foot
            found[first : first + _QUERIES] = cells
            feet[first : first + _QUERIES] = np.reshape(points, (-1, 3))
        return order[found], feet

    return nearest


def poly_data(points: Array, faces: Index | None = None, lines: Index | None = None) -> Any:
    """The `vtkPolyData` of points (n, 3) with lines (l, 2) and triangles (m, 3), its cells in this order."""
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData

    def cell_array(corners: Index) -> Any:
        array, starts = vtkCellArray(), np.arange(len(corners) + 1) * corners.shape[1]
        ids = (np.ascontiguousarray(part, dtype=np.int64).ravel() for part in (starts, corners))
        array.SetData(*(numpy_to_vtkIdTypeArray(part, deep=True) for part in ids))
        return array

    places, data = vtkPoints(), vtkPolyData()
    places.SetDataTypeToDouble()
    places.SetData(numpy_to_vtk(points, deep=True))
    data.SetPoints(places)
    if lines is not None:
        data.SetLines(cell_array(lines))
    if faces is not None:
        data.SetPolys(cell_array(faces))
    return data


def segments_meet(body: Any, start: Array, along: Array, length: float, distance: float = 0.0) -> Mask:
    """Which segments (n,) meet a convex `trimesh.Trimesh` whose faces are moved outwards by `distance`.

    start (n, 3), along (n, 3)
        where the segments begin, and unit vectors along them.
    length
        of all segments.

    Faces that are moved outwards enclose, at edges, more than the points that are so near.
    """
    normals, corner = face_normals(body), np.asarray(body.triangles)[:, 0]
    offset = (normals * corner).sum(axis=1) + distance - NEGLIGIBLE * length
    middle, reach = body.bounds.mean(axis=0), float(np.linalg.norm(body.extents)) / 2 + distance
    nearest = np.clip(((middle - start) * along).sum(axis=1), 0.0, length)
    near = np.linalg.norm(start + nearest[:, None] * along - middle, axis=1) < reach + distance
    meets = np.zeros(len(start), dtype=bool)
    rows = np.flatnonzero(near)
    for part in np.array_split(rows, 1 + len(rows) * len(normals) // AT_ONCE):
        meets[part] = _below(start[part] @ normals.T - offset, length * (along[part] @ normals.T))
    return meets


def _below(height: Array, change: Array) -> Mask:
    """Which segments (n,) pass below all planes (f,), above which they begin at heights (n, f) that change by (n, f)."""
    place = ratio(-height, change)
    above = (change == 0) & (height > 0)
    enter = np.where(change < 0, place, np.where(above, np.inf, -np.inf)).max(axis=1)
    leave = np.where(change > 0, place, np.inf).min(axis=1)
    return np.asarray(np.maximum(enter, 0.0) < np.minimum(leave, 1.0))
