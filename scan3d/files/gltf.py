"""Binary glTF 2.0 (GLB): in metres and with y up, as its specification says.

https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html.  Of the world's axes x stays, z becomes y, and y becomes -z.  The
libraries that the program uses write neither the normals of points nor a named material beside colours of vertices.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.files.shapes import FRAME, LENGTHS, Shape
from scan3d.units import UNITS_M

# The codes of the specification for types of numbers, by those of numpy, and for vectors by their length.
_COMPONENTS, _VECTORS = {"<f4": 5126, "<u4": 5125, "|u1": 5121}, {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_MAGIC, _JSON, _BINARY = b"glTF", b"JSON", b"BIN\0"
_AXES = "x, z and -y of the world"


def glb(shape: Shape) -> bytes:
    """The file of a surface, or of a cloud as points, with those normals and scalars that are known at all vertices."""
    scale = UNITS_M[shape.unit]
    buffers = _Buffers()
    position = y_up(shape.points * scale).astype("<f4")
    attributes = {"POSITION": buffers.add(position, bounds=True)}
    if (np.linalg.norm(shape.normals, axis=1) > 0).all():
        normals = y_up(shape.normals).astype(np.float64)
        attributes["NORMAL"] = buffers.add((normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype("<f4"))
    if shape.colors is not None:
        opaque = np.column_stack([shape.colors, np.full(len(position), 255, np.uint8)])
        attributes["COLOR_0"] = buffers.add(opaque, normalized=True)
    for name, values in shape.columns.items():
        column = values.astype("<f4")  # glTF has neither NaN nor infinity
        if np.isfinite(column).all():
            attributes[f"_{name.upper()}"] = buffers.add(column * np.float32(scale if name in LENGTHS else 1.0))
    primitive: dict[str, Any] = {"attributes": attributes, "material": 0, "mode": 0}  # points
    if shape.faces is not None:
        primitive |= {"indices": buffers.add(shape.faces.astype("<u4").ravel(), indices=True), "mode": 4}  # triangles
    # pale and matt, in the colours of its vertices where it has some
    base = [1.0] * 4 if shape.colors is not None else [0.76, 0.80, 0.84, 1.0]
    surface = {"baseColorFactor": base, "metallicFactor": 0.0, "roughnessFactor": 0.8}
    extras = {
        "unit": "m",
        "unit_of_recording": shape.unit,
        "metres_per_unit_of_recording": scale,
        "axes": _AXES,
        "frame": FRAME,
        "notes": list(shape.notes),
    }
    tree = {
        "asset": {"version": "2.0", "generator": "scan3d", "extras": extras},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": shape.what, "mesh": 0}],
        "meshes": [{"name": shape.what, "primitives": [primitive]}],
        "materials": [{"name": f"scan3d {shape.what}", "pbrMetallicRoughness": surface, "doubleSided": True}],
        "buffers": [{"byteLength": len(buffers.data)}],
        "bufferViews": buffers.views,
        "accessors": buffers.accessors,
    }
    text = json.dumps(tree, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I", len(text)) + _JSON + text + struct.pack("<I", len(buffers.data)) + _BINARY
    return _MAGIC + struct.pack("<II", 2, 12 + len(chunks) + len(buffers.data)) + chunks + bytes(buffers.data)


def y_up(vectors: NDArray[Any]) -> NDArray[Any]:
    """Vectors (n, 3) of the world in the axes of glTF."""
    return np.column_stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]])


def z_up(vectors: NDArray[Any]) -> NDArray[Any]:
    """Vectors (n, 3) in the axes of glTF in those of the world."""
    return np.column_stack([vectors[:, 0], -vectors[:, 2], vectors[:, 1]])


def is_turned(data: bytes) -> bool:
    """Whether the bytes are those of a GLB that `glb` has written; those of other programs are read with the axes they have."""
    if data[:4] != _MAGIC or len(data) < 20:
        return False
    text = data[20 : 20 + struct.unpack("<I", data[12:16])[0]]
    try:
        extras = json.loads(text)["asset"].get("extras", {})
        return isinstance(extras, dict) and extras.get("axes") == _AXES
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return False


class _Buffers:
    """The binary part of the file, and what describes it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(
        self, values: NDArray[Any], *, indices: bool = False, bounds: bool = False, normalized: bool = False
    ) -> int:
        """The number of the accessor of values (n,) or (n, k), which are appended."""
        block = np.ascontiguousarray(values).tobytes()
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(block)}
        self.views.append(view | {"target": 34963 if indices else 34962})
        accessor: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": _COMPONENTS[values.dtype.str],
            "count": len(values),
            "type": _VECTORS[values[0].size],
        }
        if bounds:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        if normalized:
            accessor["normalized"] = True
        self.accessors.append(accessor)
        self.data += block + b"\0" * (-len(block) % 4)
        return len(self.accessors) - 1
