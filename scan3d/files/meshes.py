"""Mesh files: they are read, as other programs write them, and judged whether they are closed, and whether they are convex."""

from __future__ import annotations

import hashlib
import io
import os
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from trimesh.exchange.load import mesh_loaders

from scan3d.arrays import LARGEST, NEGLIGIBLE, Array, Index
from scan3d.comparison import deepest_dent
from scan3d.errors import InputError
from scan3d.files.shapes import read_glb
from scan3d.files.text import check_readable
from scan3d.geometry import hulls, triangles
from scan3d.geometry.distance import bounding_box
from scan3d.units import UNITS_M, check_unit, share

FORMATS = ("stl", "ply", "obj", "off", "glb")
FLAT = 1e-6
"""Smallest thickness of a body over the diagonal of its bounding box: float32 leaves flat sheets 1e-8 to 1e-7 thick."""
OPEN_TOLERANCE = 1e-3
"""Largest fraction of the hull's area that may lack a surface, far above the rounding of the areas of fine meshes."""
# What scan3d writes on the unit at the beginning of a PLY, an STL or an OBJ, and how many bytes are searched for it.
_UNIT = re.compile(rb"(?m)(?:scan3d surface\W+|^comment )unit (%s)\b" % "|".join(UNITS_M).encode())
_HEAD = 1 << 12
_STL_START, _STL_ROW = 84, 50
_TEXTS = ("obj", "off", "stl", "ply")
_VERTEX = re.compile(rb"^[ \t]*vertex[ \t]+([^\n]*)", re.MULTILINE | re.IGNORECASE)
_END = re.compile(rb"^[ \t]*end[ \t]*solid\b[^\n]*\s*\Z", re.MULTILINE | re.IGNORECASE)
_RELATIVE = re.compile(rb"^[ \t]*f\b[^#\n]*[ \t/]-\d", re.MULTILINE)


def load_mesh(path: str | os.PathLike[str], *, hull: bool = False, unit: str = "mm") -> trimesh.Trimesh:
    """The closed body in a mesh file: STL (binary or ASCII), PLY, OBJ, OFF or GLB.

    path
        of the file.
    hull
        whether the convex hull is taken of a body that is not convex, or open.
    unit
        of the body that is returned.  Lengths are converted from the unit of the file where it is known: GLB is in metres by
        its specification, and scan3d states the unit in the files that it writes.  Those of other files are in `unit`.

    Of a body that is convex within `DENT_TOLERANCE` the triangulated convex hull is returned, watertight and outward, with the
    hull's vertices only: it differs from its file by at most the dent, so that everything else may rely on exact hulls.  Of
    others the mesh itself is returned, with equal vertices merged and faces turned outwards; it may have holes and cavities,
    and several parts, which may overlap.  (`trimesh` gives zero normals to triangles below 1e-13 square units; a body of that
    size must be brought to unit size before they are computed.)

    Its `metadata` has `file` (name), `path`, `sha256`, `file_faces`, `dent` (upper bound of the deepest dent, in
    `unit`), `dent_relative` (to the diagonal of the bounding box), `hull` (whether the body is the hull of a mesh that is not
    convex, or was asked for), and `geometry_sha256` (of the vertices returned).  Where a hull differs from the mesh it also
    has the mesh itself (`mesh_vertices` and `mesh_faces`), and `filled`: `depth` and place (`at`) of the deepest dent, whether
    the mesh is `open`, and `volume_relative`, the part of the hull's volume that the mesh lacks, None if its triangles enclose
    no volume.

    Raises InputError if the file can't be read, has no triangles or coordinates that aren't finite, and if the body is flat
    or open.
    """
    path = Path(path)
    data = _read(path)
    body = _judged(path.name, *_merged(*_triangles(path, data, unit)), hull, _scale(path, data, unit))
    body.metadata.update(file=path.name, path=str(path.resolve()), sha256=hashlib.sha256(data).hexdigest())
    return body


def judge_mesh(mesh: Any, *, hull: bool = False) -> trimesh.Trimesh:
    """The closed body of a `trimesh.Trimesh`, judged and returned as by `load_mesh`.

    A body of `load_mesh` that was not changed since keeps its `metadata`, unless its hull is asked for and differs.  Of others,
    `metadata` has no `file`, and `sha256` is that of the vertices returned.  Raises InputError for another type, and as
    `load_mesh`.
    """
    bounding_box(mesh, "body")
    if mesh.metadata.get("geometry_sha256") == _geometry(mesh) and not (hull and not hulls.is_convex(mesh)):
        return mesh
    vertices, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces)
    body = _judged("the mesh", *_merged(vertices, faces), hull)
    body.metadata.update(sha256=body.metadata["geometry_sha256"])
    return body


def mesh_itself(body: trimesh.Trimesh) -> trimesh.Trimesh | None:
    """The mesh in whose place `load_mesh` or `judge_mesh` took its convex hull; None if the body is the mesh, or was moved."""
    if "filled" not in body.metadata or body.metadata["geometry_sha256"] != _geometry(body):
        return None
    return trimesh.Trimesh(body.metadata["mesh_vertices"], body.metadata["mesh_faces"], process=False)


def _geometry(mesh: trimesh.Trimesh) -> str:
    """The SHA-256 of the vertices of a mesh."""
    return hashlib.sha256(np.ascontiguousarray(mesh.vertices, dtype=float).tobytes()).hexdigest()


def _merged(vertices: Array, faces: Index) -> tuple[Array, Index]:
    """The distinct vertices (v, 3) of faces (t, 3), in a fixed order, and the faces by their numbers."""
    used, faces = triangles.without_unused(faces)
    first, number = triangles.distinct_rows(vertices[used])
    return vertices[used[first]], number[faces]


def _judged(name: str, vertices: Array, faces: Index, hull: bool, scale: float = 1.0) -> trimesh.Trimesh:
    """The body of distinct vertices (v, 3) and faces (t, 3), as `load_mesh` describes it.

    `name` is that of the mesh in messages, and `scale` what its coordinates were multiplied by.
    """
    if len(vertices) < 4:
        _check_digits(name, vertices, scale, 0.0)
        raise InputError(f"{name} has only {len(vertices)} distinct vertices, where a body needs at least 4")

    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent = (high - low).max()
    diagonal = float(extent * np.linalg.norm((high - low) / extent))  # squares of very small numbers would vanish
    center = low + (high - low) / 2
    points = (vertices - center) / diagonal
    centered = points - points.mean(axis=0)
    across = np.linalg.eigh(centered.T @ centered)[1][:, 0]
    thickness = float(np.ptp(centered @ across))  # across the plane that fits best
    if thickness < FLAT:
        _check_digits(name, vertices, scale, thickness * diagonal)
        raise InputError(
            f"{name} is flat: it is {thickness * diagonal:.3g} thick, in the unit of the mesh ({thickness:.2g} of its "
            f"diagonal, where at least {FLAT:g} is needed); check that the file holds a solid body"
        )

    outer, dent, deepest, covered = _against_hull(points, faces)
    place = center + diagonal * deepest
    hollow = not hull and dent > hulls.DENT_TOLERANCE
    if hollow:
        _check_digits(name, vertices, scale, dent * diagonal)
        body = _closed(name, vertices, faces)
    else:
        if not hull and (bare := 1 - covered) > OPEN_TOLERANCE:
            raise InputError(
                f"{name} is open: {share(bare)} of its convex hull has no surface, where a closed body is expected; "
                "close it, or to scan its convex hull give --hull (hull=True)"
            )
        used, facets = triangles.without_unused(outer)
        body = trimesh.Trimesh(vertices=vertices[used], faces=facets, process=False)
    hulls.judged_convex(body, not hollow)
    body.metadata.update(
        file_faces=len(faces),
        dent=dent * diagonal,
        dent_relative=dent,
        hull=hull,
        geometry_sha256=_geometry(body),
    )
    is_dented, is_open = bool(dent > hulls.DENT_TOLERANCE), bool(1 - covered > OPEN_TOLERANCE)
    if not hollow and (is_dented or is_open):
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        filled = {
            "depth": float(dent * diagonal) if is_dented else 0.0,
            "at": place.tolist() if is_dented else None,
            "open": is_open and not mesh.is_watertight,
            "volume_relative": 1 - float(mesh.volume) / float(body.volume) if mesh.is_volume else None,
        }
        # as arrays, which are the only large metadata that pyvista takes over
        body.metadata.update(filled=filled, mesh_vertices=vertices, mesh_faces=faces)
    return body


def _against_hull(points: Array, faces: Index) -> tuple[Index, float, Array, float]:
    """The facets (h, 3) of the hull of points (n, 3) at unit size, an upper bound of the depth of the faces (m, 3) below it and
    where they are deepest (3,), and the fraction of its area that they cover."""
    facets = hulls.outward_faces(points, faces)
    if facets is not None:
        return facets, 0.0, points[0], 1.0
    qhull = ConvexHull(points)
    facets = hulls.outward_facets(qhull)
    assert facets is not None  # the hull of a body is one closed surface
    planes = qhull.equations * [1, 1, 1, -1]
    dent, deepest = deepest_dent(points, faces, facets, planes, 0.01 * hulls.DENT_TOLERANCE)
    distinct = triangles.distinct_rows(np.sort(faces, axis=1))[0]  # those with the same vertices count once
    covered = float(triangles.areas(points[faces[distinct]]).sum() / triangles.areas(points[facets]).sum())
    return facets, dent, deepest, covered


def _check_digits(name: str, vertices: Array, scale: float, size: float) -> None:
    """Raises InputError if a thickness or a dent is within the rounding of a file far from the origin to float32."""
    in_file = vertices / scale
    largest = float(np.abs(in_file).max())
    with np.errstate(all="ignore"):  # beyond the range of float32
        single, step = in_file.astype(np.float32), float(np.spacing(np.float32(largest)))
    is_coarse = step > hulls.DENT_TOLERANCE * np.linalg.norm(np.ptp(in_file, axis=0))
    if is_coarse and size <= np.sqrt(3) * step * scale and np.abs(single - in_file).max() <= 1e-12 * largest:
        raise InputError(
            f"{name} has lost its shape in float32, whose numbers are {step:.2g} apart at its coordinates of up to "
            f"{largest:.6g}; move the body to the origin and export it again, or export it in double precision"
        )


def _closed(name: str, vertices: Array, faces: Index) -> trimesh.Trimesh:
    """The closed surface of faces (t, 3) of distinct vertices (v, 3), turned outwards.

    Where edges are not those of a closed surface, vertices are merged that agree in float32, as exports leave them at seams,
    and faces are turned as their neighbours.  Raises InputError if the surface stays open.
    """
    merged = triangles.representatives(vertices, 2 * triangles.distance_of_readers(vertices))
    for chosen in (np.arange(len(vertices)), merged):
        used, kept = triangles.without_unused(triangles.collapsed(faces, chosen))
        kept = hulls.turned_alike(kept)
        body = trimesh.Trimesh(vertices[used], kept, process=False)
        if len(kept) and hulls.runs_both_ways(kept):
            # trimesh divides by a volume of 0 for the centre of mass
            with np.errstate(divide="ignore", invalid="ignore"):
                volume = float(body.volume)
            if abs(volume) > NEGLIGIBLE * float(np.prod(body.extents)):
                if volume < 0:
                    body.invert()
                return body
    edges, count = np.unique(np.sort(body.edges, axis=1), axis=0, return_counts=True)
    alone = edges[count % 2 == 1]
    if not len(alone):
        raise InputError(
            f"{name} has faces that can't be turned outwards together, as those of a closed body can; repair it, or to scan "
            "its convex hull give --hull (hull=True)"
        )
    place = ", ".join(f"{x:.6g}" for x in body.vertices[alone[0]].mean(axis=0))
    raise InputError(
        f"{name} is open: {len(alone)} of its {len(edges)} edges belong to one face only, such as that at ({place}), where a "
        "closed body is expected; close it, or to scan its convex hull give --hull (hull=True)"
    )


def read_mesh(path: str | os.PathLike[str], unit: str | None = None) -> trimesh.Trimesh:
    """The triangles of a mesh file as they are, convex or not, with equal vertices merged.

    unit
        as in `load_mesh`; by default that which the file states, and mm for GLB.

    Raises InputError if the file can't be read, has no triangles or isn't finite.
    """
    path = Path(path)
    return trimesh.Trimesh(*_merged(*_triangles(path, _read(path), unit or common_unit(path))), process=False)


def stated_unit(path: Path) -> str | None:
    """The unit of a mesh file where it is known: GLB is in metres by its specification, and scan3d states what it writes."""
    with open(path, "rb") as file:
        return _stated_unit(path.suffix[1:].lower(), file.read(_HEAD))


def _stated_unit(kind: str, head: bytes) -> str | None:
    found = _UNIT.search(head)
    return "m" if kind == "glb" else found[1].decode() if found else None


def _scale(path: Path, data: bytes, unit: str) -> float:
    """What the lengths of a file are multiplied by to be in a unit."""
    check_unit(unit)
    return UNITS_M[_stated_unit(path.suffix[1:].lower(), data[:_HEAD]) or unit] / UNITS_M[unit]


def common_unit(*paths: Path) -> str:
    """The unit in which mesh files are read together: the first that one of them states, and mm; GLB has no other."""
    others = [path for path in paths if path.suffix.lower() != ".glb" and path.is_file()]
    return next((unit for path in others if (unit := stated_unit(path)) is not None), "mm")


def _read(path: Path) -> bytes:
    """The bytes of a mesh file.  Raises InputError if they can't be read, or if its ending is not one of `FORMATS`."""
    if path.is_dir():
        raise InputError(f"{path.name or path} is a folder, where a mesh file is expected; name a file in it")
    if not path.exists():
        raise InputError(f"there is no mesh file {path.name} in {path.absolute().parent}; check the path")
    if path.suffix[1:].lower() not in FORMATS:
        raise InputError(f"{path.name} isn't a mesh file by its ending, which should be one of .{', .'.join(FORMATS)}")
    try:
        check_readable(path, memory_per_byte=10)
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path.name} can't be read: {error.strerror or error}; check its permissions") from error
    if not data:
        raise InputError(f"{path.name} is empty, where a mesh is expected; export or download it again")
    return data


def _triangles(path: Path, data: bytes, unit: str) -> tuple[Array, Index]:
    """Vertices (v, 3) in a unit and faces (t, 3) of all triangles in a file, without merging or dropping any."""
    kind, scale = path.suffix[1:].lower(), _scale(path, data, unit)
    try:
        with warnings.catch_warnings():
            # On a broken number older versions of numpy only warn, and return the numbers before it, which are part of a
            # body.
            warnings.filterwarnings("error", message="string or file could not be read")
            warnings.filterwarnings("ignore", category=RuntimeWarning)  # of numbers that are not finite, judged below
            meshes = _parse(kind, data, scale)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None
    # trimesh's parsers raise various errors for foreign bytes: KeyError, IndexError, struct.error, MemoryError and others.
    except Exception as error:
        raise InputError(
            f"{path.name} can't be read as {kind.upper()}: it is cut off, damaged or another kind of file; export or download "
            "it again"
        ) from error
    if any(len(vertices) and vertices.shape[1] != 3 for vertices, _ in meshes):
        raise InputError(f"{path.name} has vertices without three coordinates; export the mesh again")
    if not all((np.abs(vertices) < LARGEST).all() for vertices, _ in meshes):
        raise InputError(
            f"{path.name} has vertices that are NaN, infinite or beyond {LARGEST:g}; repair or export it again"
        )
    held, declared = sum(len(faces) for _, faces in meshes), _declared_faces(kind, data)
    if held < declared:
        raise InputError(
            f"{path.name} is cut off: it declares {declared} faces and holds {held}; export or download it again"
        )
    if held == 0:
        raise InputError(
            f"{path.name} has no triangles, where a surface is expected: it has points or strips only, is cut off, damaged, or "
            f"not a {kind.upper()} file; export the body as a triangle mesh"
        )
    first = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = np.concatenate([faces + before for before, (_, faces) in zip(first, meshes, strict=False)])
    return np.concatenate([vertices for vertices, _ in meshes]), faces


def _declared_faces(kind: str, data: bytes) -> int:
    """Faces in the header of a PLY or OFF: of one in text that is cut off, trimesh would return a part of the body."""
    patterns = {"ply": rb"(?m)^element face (\d{1,18})\b", "off": rb"\s*\w*OFF\s+(?:#[^\n]*\s+)*\d+\s+(\d{1,18})\b"}
    found = re.search(patterns[kind], data[: 1 << 16]) if kind in patterns else None
    return int(found[1]) if found else 0


def _parse(kind: str, data: bytes, scale: float) -> list[tuple[Array, Index]]:
    """Vertices (v, 3) in the world, multiplied by a scale, and faces (f, 3) of each mesh in a file.

    trimesh's loaders are called directly, because trimesh.load drops vertices that aren't finite without a warning.
    """
    if kind == "glb":
        meshes = read_glb(data, scale)
    elif kind == "stl" and not _is_binary_stl(data):
        corners = _text_stl(_plain(kind, data))
        meshes = [(scale * corners, np.arange(len(corners)).reshape(-1, 3))]
    else:
        raw = mesh_loaders[kind](io.BytesIO(_plain(kind, data)), file_type=kind, resolver=None, skip_materials=True)
        parts = [part for part in raw.get("geometry", {"mesh": raw}).values() if part.get("faces") is not None]
        bodies = [trimesh.Trimesh(part["vertices"], part["faces"], process=False) for part in parts]  # of triangles
        meshes = [(scale * np.asarray(body.vertices), np.asarray(body.faces)) for body in bodies]
    for vertices, faces in meshes:
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise IndexError("a face has a vertex that does not exist")
    return meshes


# --- meshes as other programs write them, and trimesh does not expect them ---


def _plain(kind: str, data: bytes) -> bytes:
    """The bytes of a mesh file without what trimesh does not expect.

    Of text these are a byte order mark, line ends of old computers, decimal commas and, in OBJ, tabs, comments after the
    numbers and relative indices; of binary STL what comes after the triangles.  Raises InputError for a relative index before
    the first vertex, and for a binary STL with more triangles than its header counts.
    """
    if kind == "stl" and _is_binary_stl(data):
        return _counted_triangles(data)
    if kind not in _TEXTS or (kind == "ply" and b"\nformat ascii" not in data[:1000].replace(b"\r", b"\n")):
        return data
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        data = data.decode("utf-16", errors="replace").encode()
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"," in data:
        data = re.sub(rb"(?<=\d),(?=\d)", b".", data)
    if kind != "obj":
        return data
    data = re.sub(rb"[ \t]*#[^\n]*", b"", data) if b"#" in data else data
    data = data.replace(b"\t", b" ").replace(b"\\\n", b" ")
    return _counted_from_the_start(data) if _RELATIVE.search(data) else data


def _is_binary_stl(data: bytes) -> bool:
    """Whether a file has room for the triangles that the header of a binary STL counts; letters would count 100 million."""
    return len(data) >= _STL_START and 0 < _STL_ROW * _stl_count(data) <= len(data) - _STL_START


def _stl_count(data: bytes) -> int:
    return int.from_bytes(data[_STL_START - 4 : _STL_START], "little")


def _counted_triangles(data: bytes) -> bytes:
    """A binary STL without what comes after its triangles."""
    end = _STL_START + _STL_ROW * _stl_count(data)
    if len(rest := data[end:]) >= _STL_ROW and rest.strip(b"\0\t\n\r "):
        raise InputError(
            f"its header counts {_stl_count(data)} triangles, and {len(rest) // _STL_ROW} more may follow; export it again"
        )
    return data[:end]


def _text_stl(data: bytes) -> Array:
    """Corners (n, 3) of the triangles of an STL in text, whatever its solids are called.  Raises ValueError for other text."""
    lines = _VERTEX.findall(data)
    corners = np.fromstring(b" ".join(lines).decode("latin-1"), sep=" ")
    if len(corners) != 3 * len(lines) or len(lines) % 3 or (lines and not _END.search(data)):
        raise ValueError("cut off")
    return corners.reshape(-1, 3)


def _counted_from_the_start(data: bytes) -> bytes:
    """An OBJ whose faces count vertices, texture coordinates and normals from the first one of the file.

    A negative index counts back from the last one that precedes the face.
    """
    seen = {b"v": 0, b"vt": 0, b"vn": 0}

    def absolute(reference: bytes) -> bytes:
        numbers = []
        for what, number in zip(seen, reference.split(b"/"), strict=False):
            if number.startswith(b"-"):
                index = seen[what] + 1 + int(number)
                if index < 1:
                    raise InputError(
                        f"a face has the relative index {int(number)}, and only {seen[what]} entries of that kind come "
                        "before it; export the mesh again"
                    )
                number = b"%d" % index
            numbers.append(number)
        return b"/".join(numbers)

    lines = []
    for line in data.splitlines():
        words = line.split()
        if words and words[0] in seen:
            seen[words[0]] += 1
        elif words and words[0] == b"f":
            line = b" ".join([b"f", *map(absolute, words[1:])])
        lines.append(line)
    return b"\n".join(lines)
