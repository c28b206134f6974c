"""Meshes as other programs write them: STL as text, and text and bytes that trimesh reads wrongly in the form that it reads."""

from __future__ import annotations

import re

import numpy as np

from scan3d.arrays import Array
from scan3d.errors import InputError

_STL_START, _STL_ROW = 84, 50
_TEXTS = ("obj", "off", "stl", "ply")
_VERTEX = re.compile(rb"^[ \t]*vertex[ \t]+([^\n]*)", re.MULTILINE | re.IGNORECASE)
_END = re.compile(rb"^[ \t]*end[ \t]*solid\b[^\n]*\s*\Z", re.MULTILINE | re.IGNORECASE)
_RELATIVE = re.compile(rb"^[ \t]*f\b[^#\n]*[ \t/]-\d", re.MULTILINE)


def plain(kind: str, data: bytes) -> bytes:
    """The bytes of a mesh file without what trimesh does not expect.

    Of text these are a byte order mark, line ends of old computers, decimal commas and, in OBJ, tabs, comments after the
    numbers and relative indices; of binary STL what comes after the triangles.  Raises InputError for a relative index before
    the first vertex, and for a binary STL with more triangles than its header counts.
    """
    if kind == "stl" and is_binary_stl(data):
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


def is_binary_stl(data: bytes) -> bool:
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


def text_stl(data: bytes) -> Array:
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
