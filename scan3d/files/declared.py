"""Counts that mesh files declare in their headers, compared with the bytes they have, before memory is taken for them.

A file that was cut off, or whose header was changed, declares more than it holds; its parser would take memory for what is
declared, or return a part of the body.
"""

from __future__ import annotations

import json
import struct
from typing import Any

# The layout of binary STL: a header of 80 bytes, a count, and 50 bytes per triangle.
_STL_START, _STL_TRIANGLE = 84, 50
# Bytes of the numbers in a PLY.
_PLY_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64", "int64", "uint64"), 8),
}
# A number in text takes a digit and a separator.
_TEXT_NUMBER = 2
# glTF: bytes of the numbers by their codes, and numbers of an element by its type.
_GLB_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_GLB_NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
# The longest header of a PLY, in bytes, that is examined.
_LONGEST_HEADER = 1 << 16


def shortfall(kind: str, data: bytes) -> str:
    """What a mesh file (STL, PLY, OFF or GLB) declares but does not hold, as the end of a sentence; empty if nothing lacks.

    Files of other kinds, and headers that can't be read, give an empty string, because their parsers say what is wrong.
    """
    check = {"stl": _stl, "ply": _ply, "off": _off, "glb": _glb}.get(kind)
    try:
        return check(data) if check else ""
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, struct.error, RecursionError):
        return ""


def _stl(data: bytes) -> str:
    if _is_text_stl(data):
        # the last words of a text are those that end its solid
        ended = data.rstrip()[-200:].lower().rpartition(b"endsolid")[1]
        return "" if ended else "its text does not end with 'endsolid'"
    (count,) = struct.unpack_from("<I", data, _STL_START - 4)
    held = (len(data) - _STL_START) // _STL_TRIANGLE
    return f"it declares {count} triangles and holds {held}" if count > held else ""


def _is_text_stl(data: bytes) -> bool:
    start = data[:_LONGEST_HEADER].lstrip().lower()
    return start.startswith(b"solid") and b"facet" in start and b"\0" not in start


def _ply(data: bytes) -> str:
    end = data.find(b"end_header", 0, _LONGEST_HEADER)
    lines = [line.split() for line in data[:end].decode(errors="replace").splitlines()] if end >= 0 else []
    text = ["format", "ascii", "1.0"] in lines
    elements: list[tuple[str, int]] = []
    sizes: list[int] = []
    for words in lines:
        if words[:1] == ["element"]:
            elements.append((words[1], int(words[2])))
            sizes.append(0)
        elif words[:1] == ["property"] and elements:
            # of a list at least its length is there, and of a face three corners
            kinds = [words[2], *[words[3]] * 3 * (elements[-1][0] == "face")] if words[1] == "list" else [words[1]]
            sizes[-1] += sum(_TEXT_NUMBER if text else _PLY_BYTES[kind] for kind in kinds)
    needed, held = 0, len(data) - end - len("end_header")
    for (name, count), size in zip(elements, sizes, strict=True):
        needed += count * size
        # the last number of a text needs no separator
        if needed > held + 1:
            plural = {"vertex": "vertices", "face": "faces"}.get(name, name)
            return f"it declares {count} {plural}, more than its {len(data)} bytes hold"
    return ""


def _off(data: bytes) -> str:
    words = [line.partition(b"#")[0].split() for line in data.splitlines()]
    flat = [word for line in words for word in line]
    start = 1 if flat[0].upper().endswith(b"OFF") else 0
    vertices, faces = int(flat[start]), int(flat[start + 1])
    rest = flat[start + 3 :]
    if 3 * vertices > len(rest):
        return f"it declares {vertices} vertices and holds {len(rest) // 3}"
    lines = [line for line in words if line]
    at = (1 if len(lines[0]) > 1 else 2) + vertices
    held = len(lines) - at
    return f"it declares {faces} faces and holds {max(held, 0)}" if faces > held and _one_per_line(lines, at) else ""


def _one_per_line(lines: list[list[bytes]], at: int) -> bool:
    """Whether an OFF has one vertex or face on each line, as all programs write it; the faces begin at line `at`."""
    return all(len(line) in (3, 6, 7) for line in lines[at - 1 : at]) and all(
        len(line) > int(line[0]) for line in lines[at : at + 1]
    )


def _glb(data: bytes) -> str:
    magic, _, length, size = struct.unpack_from("<4sIII", data)
    if magic != b"glTF":
        return ""
    if length > len(data):
        return f"it declares {length} bytes and has {len(data)}"
    tree = json.loads(data[20 : 20 + size])
    views: list[dict[str, Any]] = tree.get("bufferViews", [])
    for accessor in tree.get("accessors", []):
        needed = accessor["count"] * _GLB_NUMBERS[accessor["type"]] * _GLB_BYTES[accessor["componentType"]]
        held = views[accessor["bufferView"]]["byteLength"] if "bufferView" in accessor else 0
        if needed > min(held, len(data)) and "sparse" not in accessor:
            return f"it declares {accessor['count']} elements in an array of {min(held, len(data))} bytes"
    return ""
