"""Binary PLY files: the format of the clouds and surfaces that scan3d writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.errors import InputError
from scan3d.files.reading import check_file

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
    """Parse the bytes of a PLY file.  Raises ValueError with a description of the error."""
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
    if len(lines[0][2]) > 18:  # no file has as many bytes
        raise ValueError(f"it declares a number of {len(lines[0][2])} digits of {name} elements")
    return int(lines[0][2])
