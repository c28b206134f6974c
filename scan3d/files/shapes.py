"""Clouds and surfaces as tables with named columns, and the binary PLY that holds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from scan3d.arrays import Array
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.files.reading import check_file
from scan3d.shown import Exported, Rows
from scan3d.units import UNITS_M, check_unit, lengths

# Types of PLY by the codes of numpy; only those that the tables of scan3d need.
_PLY_TYPES = {"f8": "double", "f4": "float", "i4": "int", "u4": "uint", "u1": "uchar", "i1": "char", "i2": "short"}
_PLY_CODES = {name: code for code, name in _PLY_TYPES.items()}
_PLY_TRIANGLE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def ply(vertices: NDArray[Any], faces: NDArray[np.integer] | None = None, comments: tuple[str, ...] = ()) -> bytes:
    """Binary PLY of a structured array (n,), each field in its own precision, and of triangles (m, 3) if given."""
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments)]
    header.append(f"element vertex {len(vertices)}")
    assert vertices.dtype.fields is not None
    little = np.dtype([(name, vertices.dtype[name].newbyteorder("<")) for name in vertices.dtype.names or ()])
    header += [f"property {_PLY_TYPES[little[name].str[1:]]} {name}" for name in little.names or ()]
    body = vertices.astype(little).tobytes()
    if faces is not None:
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        rows = np.empty(len(faces), dtype=_PLY_TRIANGLE)
        rows["count"], rows["corners"] = 3, faces
        body += rows.tobytes()
    return "\n".join([*header, "end_header", ""]).encode() + body


def read_ply(path: str | Path) -> tuple[NDArray[Any], NDArray[np.int32] | None, tuple[str, ...]]:
    """Read a binary PLY as `ply` writes it: vertices as a structured array (n,), triangles (m, 3) or None, and comments.

    Raises InputError for a file that cannot be read, that is not such a PLY, that is incomplete, or whose triangles refer to
    vertices that do not exist.
    """
    path = Path(path)
    try:
        check_file(path)
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"can't read {path}: {error.strerror or error}; give a PLY written by scan3d") from None
    try:
        return _parse_ply(data)
    except ValueError as error:
        raise InputError(f"{path.name} is not a PLY file as scan3d writes it: {error}") from None


def _parse_ply(data: bytes) -> tuple[NDArray[Any], NDArray[np.int32] | None, tuple[str, ...]]:
    end = data.find(b"\nend_header\n", 0, 1 << 16)  # a large file that is no PLY is not searched further
    if not data.startswith(b"ply\n") or end < 0:
        raise ValueError("it lacks the header from 'ply' to 'end_header'")
    first, *lines = data[4:end].decode(errors="replace").split("\n")
    if first != "format binary_little_endian 1.0":
        raise ValueError(f"expected the format binary_little_endian 1.0, got {first!r}")
    comments = tuple(line.removeprefix("comment ") for line in lines if line.startswith("comment "))
    # the header must have vertices of scalar columns, then optionally triangles, and nothing else
    words = [line.split() for line in lines if not line.startswith("comment")]
    rest = next((k for k, word in enumerate(words) if k > 0 and word[:1] != ["property"]), len(words))
    for word in words[1:rest]:
        if len(word) != 3 or word[1] not in _PLY_CODES:
            raise ValueError(f"expected vertices of numbers only, got {' '.join(word)!r}")
    row = np.dtype([(name, "<" + _PLY_CODES[kind]) for _, kind, name in words[1:rest]])
    sizes = [_ply_count(words[:1], "vertex") * row.itemsize]
    if rest < len(words):
        sizes.append(_ply_count(words[rest : rest + 1], "face") * _PLY_TRIANGLE.itemsize)
        if words[rest + 1 :] != [["property", "list", "uchar", "int", "vertex_indices"]]:
            raise ValueError("expected faces as lists of vertex_indices, uchar and int, and nothing after them")
    body = data[end + len(b"\nend_header\n") :]
    if len(body) != sum(sizes):
        raise ValueError(f"its header announces {sum(sizes)} bytes of numbers, but it has {len(body)}")
    points = np.frombuffer(body[: sizes[0]], row)
    if len(sizes) == 1:
        return points, None, comments
    faces = np.frombuffer(body[sizes[0] :], _PLY_TRIANGLE)
    if (faces["count"] != 3).any():
        raise ValueError("it has faces that are not triangles")
    if len(faces) and not 0 <= faces["corners"].min() <= faces["corners"].max() < len(points):
        raise ValueError(f"its faces refer to vertices beyond its {len(points)}")
    return points, faces["corners"].astype(np.int32), comments


def _ply_count(lines: list[list[str]], name: str) -> int:
    """The number of an element; `lines` has its line of the header, or is empty."""
    if [line[:2] for line in lines] != [["element", name]] or len(lines[0]) != 3 or not lines[0][2].isdecimal():
        raise ValueError(f"expected 'element {name} COUNT', got {' '.join(lines[0]) if lines else 'nothing'!r}")
    return int(lines[0][2])


FRAME = "world coordinates of the recording's poses, right-handed; for a simulated scan those of the mesh"
POINT, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
LENGTHS = ("quality", "bound", "place_sd")
"""Scalars that are lengths, in the unit of the file."""


@dataclass(frozen=True, repr=False, eq=False)
class Shape(Exported):
    """A cloud or a surface as in a file: points, normals and further columns.

    It is the part of a `Cloud` that the file's format holds; surfaces and certificates are made from the `Cloud` of a
    recording.
    """

    rows: NDArray[Any]
    """(n,) structured: x, y, z, nx, ny, nz, then the other columns."""
    faces: NDArray[np.int32] | None
    """(m, 3) corners of a surface's triangles, counterclockwise from outside; None for a cloud."""
    unit: str
    """Unit of all lengths."""

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def what(self) -> str:
        return "cloud" if self.faces is None else "surface"

    @property
    def points(self) -> Array:
        """(n, 3)"""
        return np.stack([self.rows[name] for name in POINT], axis=1).astype(np.float64)

    @property
    def normals(self) -> NDArray[np.floating[Any]]:
        """(n, 3) outward unit normals, NaN where unknown."""
        return np.stack([self.rows[name] for name in NORMAL], axis=1)

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """(n,) each: the other columns by name, such as ``force`` and ``friction``."""
        names = self.rows.dtype.names or ()
        return {name: np.ascontiguousarray(self.rows[name]) for name in names if name not in POINT + NORMAL}

    @property
    def remarks(self) -> tuple[str, ...]:
        """Comments for the file: what it contains, its unit and its frame."""
        return f"scan3d {self.what}", f"unit {self.unit}", f"frame {FRAME}"

    def summary(self) -> Rows:
        """Counts, size and columns."""
        size, unit = lengths(np.ptp(self.points, axis=0) if len(self) else np.zeros(3), self.unit)
        return [
            ("contacts" if self.faces is None else "vertices", str(len(self))),
            ("size", f"{' × '.join(size)} {unit}"),
            ("normals", f"{np.isfinite(self.normals).all(axis=1).sum()} known"),
            ("columns", ", ".join(self.columns) or "none"),
        ]


def table(columns: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """Columns (n,) as a structured array."""
    rows = np.empty(len(next(iter(columns.values()))), dtype=[(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        rows[name] = values
    return rows


def cloud_table(cloud: Cloud, quality: Array | None = None) -> NDArray[np.void]:
    """Contacts as a structured array for `ply`; `quality` (n,) is their distance to the true mesh, NaN if not given.

    Where second contacts of rods were recovered, a column tells them from the others.  Contacts of noisy data have two further
    columns, the standard deviations of their places and of their normals' angles.  Contacts of the spatial model lie in no
    slices; instead of the slice they have the rod's tangent and its bending angle.
    """
    columns: dict[str, NDArray[np.generic]] = {
        **dict(zip("xyz", cloud.points.T, strict=True)),
        **dict(zip(("nx", "ny", "nz"), cloud.normals.astype(np.float32).T, strict=True)),
        "quality": np.full(len(cloud), np.nan) if quality is None else quality,
        "phase": cloud.phase.astype(np.uint8),
        "slice": cloud.slice,
        "sweep": cloud.sweep,
        "row": cloud.row,
        "force": cloud.force_N,
        "friction": cloud.friction.astype(np.float32),
        "normal_source": cloud.normal_source.astype(np.uint8),
    }
    if cloud.place_sd is not None and cloud.normal_sd is not None:
        columns["place_sd"] = cloud.place_sd.astype(np.float32)
        columns["normal_sd"] = np.where(np.isfinite(cloud.normal_sd), cloud.normal_sd, np.nan).astype(np.float32)
    if cloud.recovered is not None:
        columns["recovered"] = cloud.recovered.astype(np.uint8)
    if cloud.tangents is not None and cloud.bending_angle is not None:
        del columns["slice"]
        columns |= dict(zip(("tx", "ty", "tz"), cloud.tangents.astype(np.float32).T, strict=True))
        columns["bending"] = cloud.bending_angle.astype(np.float32)
    return table(columns)


def surface_table(surface: Any, bound: Array | None) -> NDArray[np.void]:
    """Vertices, their normals, the certified local bound (v,), unless it is None, and how well they are known, if the surface
    says so, as a structured array for `ply`."""
    columns: dict[str, NDArray[Any]] = dict(zip(POINT, np.asarray(surface.vertices, dtype=np.float64).T, strict=True))
    columns |= dict(zip(NORMAL, _vertex_normals(surface).astype(np.float32).T, strict=True))
    if bound is not None:
        columns["bound"] = np.asarray(bound).astype(np.float32)
    if "known" in surface.vertex_attributes:
        columns["known"] = np.asarray(surface.vertex_attributes["known"]).astype(np.uint8)
    return table(columns)


def _vertex_normals(surface: Any) -> Array:
    """(v, 3) normals at the vertices of a surface; where all faces of a vertex are slivers without one, that of the nearest."""
    normals = np.array(surface.vertex_normals)
    known = np.linalg.norm(normals, axis=1) > 0.5  # not of NaN either
    if known.any() and not known.all():
        vertices = np.asarray(surface.vertices)
        normals[~known] = normals[known][cKDTree(vertices[known]).query(vertices[~known])[1]]
    return normals


def read_shape(path: str | Path) -> Shape:
    """Read a cloud or a surface from a PLY file written by scan3d.  Raises InputError for other files."""
    rows, faces, comments = read_ply(path)
    missing = [name for name in POINT + NORMAL if name not in (rows.dtype.names or ())]
    if missing:
        raise InputError(
            f"{Path(path).name} is not a PLY file written by scan3d: its vertices lack {', '.join(missing)}"
        )
    units = [words[1] for words in (line.split() for line in comments) if words[:1] == ["unit"] and len(words) == 2]
    if len(units) != 1 or units[0] not in UNITS_M:
        raise InputError(
            f"{Path(path).name} is not a PLY file written by scan3d: expected a comment such as 'unit mm', "
            f"with one of {', '.join(UNITS_M)}"
        )
    return Shape(rows, faces, units[0])


# --- as other programs want them ---


def in_unit(shape: Shape, unit: str | None) -> Shape:
    """The shape with all lengths in another unit; None keeps them.  Raises InputError for an unknown unit."""
    if unit is None or unit == shape.unit:
        return shape
    check_unit(unit)
    rows = shape.rows.copy()
    for name in POINT + LENGTHS:
        if name in (rows.dtype.names or ()):
            rows[name] = rows[name] * (UNITS_M[shape.unit] / UNITS_M[unit])
    return replace(shape, rows=rows, unit=unit)
