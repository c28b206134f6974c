"""Mesh files: they are read, as other programs write them, and judged whether they are closed, and whether they are convex."""

from __future__ import annotations

import codecs
import hashlib
import os
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from scan3d.arrays import LARGEST, NEGLIGIBLE, Array, Index, ranges
from scan3d.comparison import against_own_hull
from scan3d.errors import InputError
from scan3d.files.shapes import Shape, float32_step, lost_in_float32, parse_ply, read_glb, triangulated
from scan3d.files.text import check_readable, decoded
from scan3d.geometry import hulls, triangles
from scan3d.geometry.distance import bounding_box
from scan3d.geometry.shells import united
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
# Of STL in text a facet's corners, and what ends a facet and a solid; of OBJ the lines of vertices and faces.
_CORNERS = re.compile(rb"\bouter\s+loop" + 3 * rb"\s+vertex\s+(\S+\s+\S+\s+\S+)" + rb"\s+end\s*loop\b", re.IGNORECASE)
_END_FACET = re.compile(rb"\bend\s*facet\b", re.IGNORECASE)
_END = re.compile(rb"\bend\s*solid\b", re.IGNORECASE)
_GLUED = re.compile(rb"\A(\s*[A-Z0-9]*OFF)(?=\d)", re.IGNORECASE)
_POINT, _FACE = (re.compile(rb"^[ \t]*%c[ \t]+([^\n]*)" % letter, re.MULTILINE) for letter in b"vf")


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
    and several parts, and is the union of shells that overlap, touch or lie in each other.  (`trimesh` gives zero normals to
    triangles below 1e-13 square units; a body of that size must be brought to unit size before they are computed.)

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


def _judged(
    name: str, vertices: Array, faces: Index, hull: bool, scale: float = 1.0, in_file: int | None = None
) -> trimesh.Trimesh:
    """The body of distinct vertices (v, 3) and faces (t, 3), as `load_mesh` describes it.

    `name` is that of the mesh in messages, `scale` what its coordinates were multiplied by, and `in_file` how many faces the
    mesh has where these are those of the union of its shells.
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

    outer, dent, deepest, covered = against_own_hull(points, faces)
    place = center + diagonal * deepest
    is_dented = bool(dent > hulls.DENT_TOLERANCE)
    hollow = is_dented and not hull
    if hollow:
        _check_digits(name, vertices, scale, dent * diagonal)
        body = _closed(name, vertices, faces)
    if is_dented and in_file is None:  # a body without dents has no walls within it
        points, own = (np.asarray(body.vertices), np.asarray(body.faces)) if hollow else (vertices, faces)
        union = united(points, own)
        if union is not None or len(own) < len(faces):  # walls of two faces on one another are gone already
            return _judged(name, *_merged(*(union or (points, own))), hull, scale, len(faces))
    if not hollow:
        if not hull and (bare := 1 - covered) > OPEN_TOLERANCE:
            raise InputError(
                f"{name} is open: {share(bare)} of its convex hull has no surface, where a closed body is expected; "
                "close it, or to scan its convex hull give --hull (hull=True)"
            )
        used, facets = triangles.without_unused(outer)
        body = trimesh.Trimesh(vertices=vertices[used], faces=facets, process=False)
    hulls.judged_convex(body, not hollow)
    body.metadata.update(
        file_faces=len(faces) if in_file is None else in_file,
        dent=dent * diagonal,
        dent_relative=dent,
        hull=hull,
        geometry_sha256=_geometry(body),
    )
    is_open = bool(1 - covered > OPEN_TOLERANCE)
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


def _check_digits(name: str, vertices: Array, scale: float, size: float) -> None:
    """Raises InputError if a thickness or a dent is within the rounding of a file far from the origin to float32."""
    in_file = vertices / scale
    largest = float(np.abs(in_file).max())
    with np.errstate(all="ignore"):  # beyond the range of float32
        single = in_file.astype(np.float32)
    if lost_in_float32(in_file, size / scale) and np.abs(single - in_file).max() <= 1e-12 * largest:
        raise InputError(
            f"{name} has lost its shape in float32, whose numbers are {float32_step(in_file):.2g} apart at its coordinates of "
            f"up to {largest:.6g}; move the body to the origin and export it again, or export it in double precision"
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
            volume = _volume(body)
            # parts that are turned both ways
            if not volume and (found := united(vertices[used], kept)):
                body = trimesh.Trimesh(*found, process=False)
                volume = _volume(body)
            if volume:
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


def _volume(body: trimesh.Trimesh) -> float:
    """The volume within faces that are turned outwards; 0 of a body that has none beside its box."""
    # trimesh divides by a volume of 0 for the centre of mass
    with np.errstate(divide="ignore", invalid="ignore"):
        volume = float(body.volume)
    return volume if abs(volume) > NEGLIGIBLE * float(np.prod(body.extents)) else 0.0


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
            warnings.filterwarnings("ignore", category=RuntimeWarning)  # of numbers that are not finite, judged below
            if kind == "glb":
                vertices, faces = read_glb(data, scale)
            else:
                vertices, faces = {"stl": _stl, "ply": _ply, "obj": _obj, "off": _off}[kind](data)
                vertices = scale * vertices
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None
    except Exception as error:  # of various types for foreign bytes
        raise InputError(
            f"{path.name} can't be read as {kind.upper()}: it is cut off, damaged or another kind of file; export or download "
            "it again"
        ) from error
    if not (np.abs(vertices) < LARGEST).all():
        raise InputError(
            f"{path.name} has vertices that are NaN, infinite or beyond {LARGEST:g}; repair or export it again"
        )
    if not len(faces):
        raise InputError(
            f"{path.name} has no triangles, where a surface is expected: it has points only, is cut off, damaged, or no "
            f"{kind.upper()} file; export the body as a triangle mesh"
        )
    return vertices, faces


def _text(data: bytes) -> bytes:
    """The text of a file without a byte order mark, line ends of old computers and decimal commas."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        data = decoded(data).encode()
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return re.sub(rb"(?<=\d),(?=\d)", b".", data) if b"," in data else data


def _words(lines: Sequence[bytes]) -> tuple[NDArray[np.bytes_], Index]:
    """The words of lines (n,), and the number (n,) of the first one of each line; that of all words comes last."""
    numbers = np.cumsum([0, *(len(line.split()) for line in lines)])
    return np.array(b" ".join(lines).split(), dtype=bytes), numbers


def _points(lines: Sequence[bytes]) -> Array:
    """The first three numbers (n, 3) of lines (n,), which may have more: a weight, or a colour."""
    words, start = _words(lines)
    if (np.diff(start) < 3).any():
        raise InputError("it has vertices without three coordinates; export the mesh again")
    return words[start[:-1, None] + np.arange(3)].astype(float)


def _stl(data: bytes) -> tuple[Array, Index]:
    """Corners (n, 3) of the triangles of an STL, and their numbers; in text the solids may have any name."""
    count, room = int.from_bytes(data[80:84], "little"), (len(data) - _STL_START) // _STL_ROW
    if 0 < count <= room:  # letters would count 100 million
        rest = data[_STL_START + _STL_ROW * count :]
        if len(rest) >= _STL_ROW and rest.strip(b"\0\t\n\r "):
            raise InputError(
                f"its header counts {count} triangles, and {room - count} more may follow; export it again"
            )
        row = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        points = np.frombuffer(data, row, count, _STL_START)["corners"].reshape(-1, 3).astype(float)
    else:
        data = _text(data)
        facets = [*_CORNERS.finditer(data)]
        if not facets and b"\0" in data:
            raise InputError(
                f"its header counts {count} triangles, and {max(room, 0)} fit into it: it is cut off, damaged or no STL; "
                "export or download it again"
            )
        if len(facets) != len(_END_FACET.findall(data)) or (facets and not _END.search(data, facets[-1].end())):
            raise ValueError("cut off")
        points = _points([corner for facet in facets for corner in facet.groups()])
    return points, np.arange(len(points)).reshape(-1, 3)


def _ply(data: bytes) -> tuple[Array, Index]:
    rows, faces, _ = parse_ply(data)
    return Shape(rows, faces, "mm").points, np.empty((0, 3), dtype=int) if faces is None else faces


def _obj(data: bytes) -> tuple[Array, Index]:
    """Vertices (v, 3) and triangles (f, 3) of an OBJ, whose faces may count back from the last vertex that precedes them."""
    data = re.sub(rb"\\[ \t]*\n", b" ", re.sub(rb"#[^\n]*", b"", _text(data)))
    points = _points(_POINT.findall(data))
    words, start = _words(re.sub(rb"/\S*", b"", b"\n".join(_FACE.findall(data))).split(b"\n"))
    corners, lengths = words.astype(int), np.diff(start)
    before = np.full(len(corners), len(points))
    if (corners < 0).any():
        above = [found.start() for found in _POINT.finditer(data)]
        before = np.repeat(np.searchsorted(above, [found.start() for found in _FACE.finditer(data)]), lengths)
    wrong = (corners == 0) | (corners > len(points)) | (corners < -before)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise InputError(
            f"a face has the index {corners[k]}, and {before[k]} vertices can be counted, from 1 or, back, from -1; export the "
            "mesh again"
        )
    corners = np.where(corners > 0, corners - 1, before + corners)
    return points, triangulated(points, corners, lengths)


def _off(data: bytes) -> tuple[Array, Index]:
    """Vertices (v, 3) and triangles (f, 3) of an OFF in text; colours and normals are left out.

    In many files of ModelNet the first number follows the word OFF without a space.
    """
    data = _GLUED.sub(rb"\1 ", re.sub(rb"#[^\n]*", b"", _text(data)), count=1)
    lines = [line for line in data.split(b"\n") if line.strip()]
    head = b" ".join(lines[:2]).split()
    named = head[0].upper().endswith(b"OFF")  # a word that may be missing
    first = 2 if named and len(lines[0].split()) == 1 else 1
    count, declared = map(int, head[named : named + 2])
    words, start = _words(lines[first + count : first + count + declared])
    if len(start) <= declared:
        raise InputError(f"it is cut off: it declares {declared} faces and holds {len(start) - 1}; export it again")
    lengths = words[start[:-1]].astype(int)
    if (np.diff(start) <= lengths).any():
        raise ValueError("cut off")
    face, after = ranges(lengths)
    places = start[face] + 1 + after
    points = _points(lines[first : first + count])
    return points, triangulated(points, words[places].astype(int), lengths)
