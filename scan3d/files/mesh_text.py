"""Meshes as text: OBJ and STL as other programs write them, in the form that trimesh reads."""

from __future__ import annotations

import re

from scan3d.errors import InputError

_STL_START, _STL_ROW = 84, 50
_RELATIVE = re.compile(rb"^[ \t]*f\b[^#\n]*[ \t/]-\d", re.MULTILINE)
_SOLID = re.compile(rb"^[ \t]*(end[ \t]*)?solid\b[^\n]*$", re.MULTILINE | re.IGNORECASE)


def plain(kind: str, data: bytes) -> bytes:
    """The bytes of a mesh file, those of text without relative indices of OBJ and without names of solids of STL.

    Raises InputError for a relative index before the first vertex.
    """
    if kind == "obj" and _RELATIVE.search(data):
        return _counted_from_the_start(data)
    if kind == "stl" and not _is_binary_stl(data):
        # a name may contain the words of the format
        return _SOLID.sub(lambda line: b"endsolid" if line[1] else b"solid", data.removeprefix(b"\xef\xbb\xbf"))
    return data


def _is_binary_stl(data: bytes) -> bool:
    """Whether the size is that of the triangles that the header of a binary STL counts."""
    count = int.from_bytes(data[_STL_START - 4 : _STL_START], "little")
    return len(data) >= _STL_START and len(data) == _STL_START + _STL_ROW * count


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
    for line in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        words = line.partition(b"#")[0].split()
        if words and words[0] in seen:
            seen[words[0]] += 1
        elif words and words[0] == b"f":
            line = b" ".join([b"f", *map(absolute, words[1:])])
        lines.append(line)
    return b"\n".join(lines)
