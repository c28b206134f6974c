"""Binary glTF 2.0 (GLB): in metres and with y up, as its specification says.

https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html.  Of the world's axes x stays, z becomes y, and y becomes -z.  The
libraries that the program uses do not write the normals of points, and read sparse accessors, fans, normalized positions and
required extensions wrongly without a message.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, Index
from scan3d.errors import InputError
from scan3d.files.shapes import FRAME, LENGTHS, Shape
from scan3d.units import UNITS_M

# The codes of the specification for types of numbers, by those of numpy, and for vectors by their length.
_COMPONENTS = {"|i1": 5120, "|u1": 5121, "<i2": 5122, "<u2": 5123, "<u4": 5125, "<f4": 5126}
_VECTORS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_TYPES = {code: np.dtype(name) for name, code in _COMPONENTS.items()}
_WIDTHS = {name: width for width, name in _VECTORS.items()}
_MAGIC, _JSON, _BINARY = b"glTF", b"JSON", b"BIN\0"
_TRIANGLES = 4
# Beginnings of the names of extensions that a file may require: those that concern its looks only, and one that is read.
_READ = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_mesh_quantization")
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
    for name, values in shape.columns.items():
        column = values.astype("<f4")  # glTF has neither NaN nor infinity
        if np.isfinite(column).all():
            attributes[f"_{name.upper()}"] = buffers.add(column * np.float32(scale if name in LENGTHS else 1.0))
    primitive: dict[str, Any] = {"attributes": attributes, "material": 0, "mode": 0}  # points
    if shape.faces is not None:
        primitive |= {"indices": buffers.add(shape.faces.astype("<u4").ravel(), indices=True), "mode": _TRIANGLES}
    pale_and_matt = {"baseColorFactor": [0.76, 0.80, 0.84, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8}
    extras = {
        "unit": "m",
        "unit_of_recording": shape.unit,
        "metres_per_unit_of_recording": scale,
        "axes": _AXES,
        "frame": FRAME,
    }
    tree = {
        "asset": {"version": "2.0", "generator": "scan3d", "extras": extras},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": shape.what, "mesh": 0}],
        "meshes": [{"name": shape.what, "primitives": [primitive]}],
        "materials": [{"name": f"scan3d {shape.what}", "pbrMetallicRoughness": pale_and_matt, "doubleSided": True}],
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


class _Buffers:
    """The binary part of the file, and what describes it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: NDArray[Any], *, indices: bool = False, bounds: bool = False) -> int:
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
        self.accessors.append(accessor)
        self.data += block + b"\0" * (-len(block) % 4)
        return len(self.accessors) - 1


# --- reading ---


def read_glb(data: bytes, scale: float = 1.0) -> list[tuple[Array, Index]]:
    """Vertices (v, 3) and triangles (f, 3) of each part of the scene in a GLB, where its nodes put them.

    The vertices are in metres, multiplied by a scale.  A file of `glb` is turned back to the axes of the world; those of other
    programs are read with the axes they have.  Raises InputError for what is not read, such as compressed data, and errors of
    various types for damaged files.
    """
    tree, binary = _chunks(data)
    required = [name for name in tree.get("extensionsRequired", ()) if not name.startswith(_READ)]
    if required:
        raise InputError(f"its triangles need the extension {', '.join(required)}; export it without compression")
    content = _Content(tree, binary)
    nodes, scenes = tree.get("nodes", []), tree.get("scenes", [])
    below = {child for node in nodes for child in node.get("children", ())}
    roots = scenes[tree.get("scene", 0)].get("nodes", []) if scenes else sorted({*range(len(nodes))} - below)
    parts = []
    waiting, seen = [(root, np.diag([scale, scale, scale, 1.0])) for root in roots], set()
    while waiting:
        number, outer = waiting.pop()
        if number in seen:
            raise ValueError("a node has two parents")
        seen.add(number)
        node = nodes[number]
        matrix = outer @ _matrix(node)
        waiting += [(child, matrix) for child in node.get("children", ())]
        if "mesh" not in node:
            continue
        mesh = tree["meshes"][node["mesh"]]
        if "skin" in node or any(node.get("weights", mesh.get("weights", ()))):
            raise InputError("its shape is bent by a skeleton or by morph targets; export the body as a plain mesh")
        for primitive in mesh["primitives"]:
            if (mode := primitive.get("mode", _TRIANGLES)) > _TRIANGLES:
                raise InputError("its triangles are stored as strips or fans; export it as plain triangles")
            if mode == _TRIANGLES:
                points, faces = content.triangles(primitive)
                faces = faces if np.linalg.det(matrix[:3, :3]) >= 0 else faces[:, ::-1]  # a mirror image
                parts.append((points @ matrix[:3, :3].T + matrix[:3, 3], faces))
    extras = tree["asset"].get("extras")
    is_turned = isinstance(extras, Mapping) and extras.get("axes") == _AXES
    return [(points[:, [0, 2, 1]] * [1, -1, 1], faces) for points, faces in parts] if is_turned else parts


def _chunks(data: bytes) -> tuple[Any, bytes]:
    """The description in a GLB, and its binary part.  Raises ValueError and struct.error for other files."""
    magic, version, length, size, kind = struct.unpack("<4sII I4s", data[:20])
    if (magic, version, kind) != (_MAGIC, 2, _JSON) or len(data) < length:
        raise ValueError("no GLB of version 2, or cut off")
    rest = data[20 + size : length]
    if len(rest) < 8 or rest[4:8] != _BINARY:
        return json.loads(data[20 : 20 + size]), b""
    return json.loads(data[20 : 20 + size]), rest[8 : 8 + int.from_bytes(rest[:4], "little")]


def _matrix(node: Mapping[str, Any]) -> Array:
    """The matrix (4, 4) of a node in its parent: given, or of translation, rotation (x, y, z, w) and scale."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=float).reshape(4, 4).T
    matrix = np.eye(4)
    turn = Rotation.from_quat(node.get("rotation", (0.0, 0.0, 0.0, 1.0))).as_matrix()
    matrix[:3, :3] = turn * np.array(node.get("scale", (1.0, 1.0, 1.0)), dtype=float)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


class _Content:
    """What the accessors of a file describe."""

    def __init__(self, tree: Mapping[str, Any], binary: bytes) -> None:
        self._tree = tree
        self._binary = binary
        if uri := next((buffer["uri"] for buffer in tree["buffers"] if "uri" in buffer), ""):
            raise InputError(f"its data lie in another place, {uri[:80]}; export it as one GLB")

    def triangles(self, primitive: Mapping[str, Any]) -> tuple[Array, Index]:
        """Vertices (v, 3) and faces (f, 3) of a part that consists of triangles."""
        position = self._tree["accessors"][primitive["attributes"]["POSITION"]]
        stored = self._values(position)
        if "min" in position and "max" in position and len(stored):
            low, high = np.array(position["min"], dtype=float), np.array(position["max"], dtype=float)
            off = np.abs([stored.min(axis=0) - low, stored.max(axis=0) - high]).max()
            # some programs round the size
            if off > 0.01 * np.linalg.norm(high - low):
                raise InputError(
                    f"its positions leave the box that it states for them by {off:.3g}: it is damaged, or its byteStride is "
                    "wrong; export it again"
                )
        points = stored.astype(float)
        if position.get("normalized"):
            points = np.maximum(points / np.iinfo(stored.dtype).max, -1.0)
        corners = np.arange(len(points))
        if "indices" in primitive:
            corners = self._values(self._tree["accessors"][primitive["indices"]]).ravel().astype(np.int64)
        return points, corners.reshape(-1, 3)

    def _values(self, accessor: Mapping[str, Any]) -> NDArray[Any]:
        """The values (n, k) of an accessor, as they are stored.  Raises ValueError if they leave its view of the buffer."""
        if "sparse" in accessor:
            raise InputError("its coordinates are stored as changes of others; export it without sparse accessors")
        kind, width = _TYPES[accessor["componentType"]], _WIDTHS[accessor["type"]]
        size, view = width * kind.itemsize, self._tree["bufferViews"][accessor["bufferView"]]
        stride, start = view.get("byteStride", size), view.get("byteOffset", 0)
        part = self._binary[start : start + view["byteLength"]]
        place = accessor.get("byteOffset", 0)
        return np.ndarray((accessor["count"], width), kind, part, place, (stride, kind.itemsize))
