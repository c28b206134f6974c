"""Bodies to scan: load a mesh file, and judge whether it is convex."""

from __future__ import annotations

import hashlib
import io
import os
import warnings
from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.load import mesh_loaders

from scan3d.arrays import Array, Index
from scan3d.errors import InputError
from scan3d.geometry.convexity import DENT_TOLERANCE, deepest_dent, outward_hull
from scan3d.geometry.triangles import areas, distinct_rows

FORMATS = ("stl", "ply", "obj", "off", "glb")
FLAT = 1e-6
"""Least thickness of a body: rounding to float32 leaves an oblique flat sheet 1e-8 to 1e-7 thick."""
OPEN_TOLERANCE = 1e-3
"""Share of the hull's area that may lack a surface: more than rounding, less than any face that matters."""


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
    first, inverse = distinct_rows(triangles.reshape(-1, 3))
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

    outer, faces = outward_hull(points), inverse.reshape(-1, 3)
    dent, deepest = deepest_dent(points[faces], outer)
    if not hull and dent > DENT_TOLERANCE:
        place = ", ".join(f"{x:.6g}" for x in center + diagonal * deepest)
        raise InputError(
            f"{path.name} isn't convex: its deepest dent is {dent * diagonal:.3g} deep ({dent:.3g} of its diagonal, where "
            f"{DENT_TOLERANCE:g} is allowed), at ({place}); to scan its convex hull instead, give --hull (hull=True)"
        )
    bare = 1 - areas(points[_distinct_faces(faces)]).sum() / areas(points[outer.facets]).sum()
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


def read_mesh(path: str | os.PathLike[str]) -> trimesh.Trimesh:
    """The triangles of a mesh file as they are, convex or not, with equal vertices merged.

    Raises InputError if the file can't be read, has no triangles or isn't finite.
    """
    path = Path(path)
    triangles = _triangles(path, _read(path))
    first, inverse = distinct_rows(triangles.reshape(-1, 3))
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


def _triangles(path: Path, data: bytes) -> Array:
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


def _parse(kind: str, data: bytes) -> list[tuple[Array, Index]]:
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


def _distinct_faces(faces: Index) -> Index:
    return faces[distinct_rows(np.sort(faces, axis=1))[0]]


def _thickness(points: Array) -> float:
    """Extent (at unit size) across the plane that fits the points best."""
    centered = points - points.mean(axis=0)
    across = np.linalg.eigh(centered.T @ centered)[1][:, 0]
    return float(np.ptp(centered @ across))
