"""Clouds and surfaces in files: as tables with named columns, in the binary PLY that holds them, and in other formats.

Points keep their world coordinates in the recording's unit, or in another one that is asked for; GLB is in
metres, with y up, by its specification.  Normals and scalars are written where the format can contain them, unit and
frame where the format allows comments.  docs/files.md lists which program reads which format.

Of binary glTF 2.0 (https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html) x of the world's axes stays, z becomes y, and y
becomes -z.  The libraries that the program uses do not write the normals of points, and read sparse accessors, fans, normalized
positions and required extensions wrongly without a message.
"""

from __future__ import annotations

import io
import json
import re
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from scan3d.arrays import NEGLIGIBLE, Array, Index, ranges, unit_or_zero
from scan3d.choices import EXPORTS, one_of
from scan3d.cloud import Cloud
from scan3d.comparison import against_own_hull
from scan3d.errors import InputError, UsageError
from scan3d.files.text import check_readable, rows_as_text
from scan3d.files.whole import Inputs, atomic, check_belongs, check_file, check_finished, folder, locate, read_report
from scan3d.geometry.hulls import DENT_TOLERANCE
from scan3d.geometry.triangles import collapsed, distance_of_readers, dot, representatives, spanned, without_unused
from scan3d.shown import Exported, Rows
from scan3d.units import UNITS_M, check_unit, length, lengths
from scan3d.workers import check_memory

# Types of PLY by the codes of numpy, which some programs call as numpy does, such as float32.
_PLY_TYPES = {
    "f8": "double", "f4": "float", "i4": "int", "u4": "uint", "i2": "short", "u2": "ushort", "i1": "char", "u1": "uchar"
}  # fmt: skip
_PLY_KINDS = {name: np.dtype(code) for code, own in _PLY_TYPES.items() for name in (own, np.dtype(code).name)}
_PLY_ORDERS: dict[str, Literal["=", "<", ">"]] = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_PLY_HEAD = re.compile(rb"(?:\xef\xbb\xbf)?ply\s+(format .*?[\r\n])end_header[ \t]*(?:\r\n|\r|\n)", re.DOTALL)
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
    """Read a PLY: vertices as a structured array (n,), triangles (m, 3) or None, and comments.

    Raises InputError for a file that cannot be read, that is no PLY or is incomplete, or whose faces refer to vertices that do
    not exist.
    """
    path = Path(path)
    try:
        check_readable(path)
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"can't read {path}: {error.strerror or error}; give a PLY written by scan3d") from None
    try:
        return parse_ply(data)
    except (ValueError, LookupError, TypeError) as error:
        raise InputError(f"{path.name} is not a PLY file: {error}; export or download it again") from None


def parse_ply(data: bytes) -> tuple[NDArray[Any], NDArray[np.int32] | None, tuple[str, ...]]:
    """As `read_ply`, of the bytes of a file.  Raises ValueError, LookupError and TypeError."""
    head = _PLY_HEAD.match(data[: 1 << 16])  # a large file that is no PLY is not searched further
    if head is None:
        raise ValueError("it lacks the header from 'ply' to 'end_header'")
    lines = head[1].decode(errors="replace").splitlines()
    words = [line.split() for line in lines if line.strip() and not line.startswith(("comment", "obj_info"))]
    order, body = _PLY_ORDERS[words[0][1]], memoryview(data)[head.end() :]
    if order == "=":  # text is cut at white space, and its numbers become double whatever the header calls them
        body = memoryview(np.array(bytes(body).replace(b",", b".").split()).astype(np.float64).tobytes())
    kinds = {name: np.dtype("f8") if order == "=" else kind.newbyteorder(order) for name, kind in _PLY_KINDS.items()}
    elements: dict[str, dict[str, list[NDArray[Any]]]] = {}
    starts = [*(k for k, word in enumerate(words) if word[0] == "element"), len(words)]
    for start, stop in pairwise(starts):
        rows = words[start + 1 : stop]
        properties = [(word[-1], [kinds[kind] for kind in word[1:-1] if kind != "list"]) for word in rows]
        elements[words[start][1]], body = _ply_element(body, int(words[start][2]), properties)
    if bytes(body).strip():
        raise ValueError(f"it has {len(body)} bytes of numbers more than its header counts")
    vertex = elements["vertex"]
    polygons = [lists for name, lists in elements.get("face", {}).items() if name.startswith("vertex_ind")]
    for corners, counts in elements.get("tristrips", {}).values():
        strips = of_strips(np.insert(corners, np.cumsum(counts.astype(int)), -1))
        polygons.append([strips.ravel(), np.full(len(strips), 3)])
    faces = None
    if polygons:
        points, sides = (
            np.stack([vertex[name][0] for name in POINT], axis=1),
            map(np.concatenate, zip(*polygons, strict=True)),
        )
        faces = triangulated(points, *(part.astype(np.int64) for part in sides)).astype(np.int32)
    scalars = table({name: column[0] for name, column in vertex.items() if len(column) == 1})
    return scalars, faces, tuple(line.removeprefix("comment ") for line in lines if line.startswith("comment "))


def _ply_element(
    body: memoryview, count: int, properties: Sequence[tuple[str, Sequence[np.dtype[Any]]]]
) -> tuple[dict[str, list[NDArray[Any]]], memoryview]:
    """The columns of an element, of a list all its values and how many each row has, and the bytes that follow."""
    parts, rows = [], count
    while count and properties:
        fields: list[Any] = []
        for k, (_, (*counted, kind)) in enumerate(properties):
            shape = [int(np.frombuffer(body, one, 1, np.dtype(fields).itemsize)[0]) for one in counted]
            fields += [*((f"{k} count", one) for one in counted), (str(k), kind, tuple(shape))]
        row = np.dtype(fields)
        rows = min(count, 8 * rows, len(body) // row.itemsize)
        found = np.frombuffer(body, row, rows) if rows else np.empty(0, row)
        for key in row.names or ():
            if "count" in key and (other := found[key] != found[key][:1]).any():
                rows = min(rows, int(np.argmax(other)))  # the next rows have lists of another length
        if not rows:
            raise ValueError("it is cut off")
        parts.append(found[:rows])
        count, body = count - rows, body[rows * row.itemsize :]
    return {
        name: [
            np.concatenate([np.empty(0, kind), *(part[key].ravel() for part in parts)])
            for key, kind in zip((str(k), f"{k} count"), kinds[::-1], strict=False)
        ]
        for k, (name, kinds) in enumerate(properties)
    }, body


def triangulated(points: Array, corners: Index, lengths: Index) -> Index:
    """Triangles (t, 3) of polygons, whose corners follow one another, and of which each has so many.

    They are fans about the first corners, and of polygons that are not convex what VTK cuts.  Raises ValueError for corners
    that do not exist.
    """
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
        raise ValueError(f"its faces refer to vertices beyond its {len(points)}")
    number = np.maximum(lengths - 2, 0)
    polygon, k = ranges(number)
    first, start = np.cumsum(number) - number, (np.cumsum(lengths) - lengths)[polygon]
    faces: Index = corners[np.stack([start, start + k + 1, start + k + 2], axis=1)]
    if lengths.max(initial=3) == 3:
        return faces
    spans = spanned(points[faces])
    sums: list[NDArray[Any]] = [np.bincount(polygon, part, len(lengths)) for part in spans.T]
    whole = np.stack(sums, axis=1)[polygon]
    for folded in np.unique(polygon[dot(spans, whole) < -NEGLIGIBLE * dot(whole, whole)]):
        ring = faces[first[folded] : first[folded] + number[folded]]
        around = np.append(ring[0], ring[1:, 2])
        cut = _cut(points[around])
        ring[:] = around[cut] if len(cut) == len(ring) else ring
    return faces


def _cut(points: Array) -> Index:
    """Triangles (t, 3) into which VTK cuts a polygon (n, 3), which may lack some where it crosses itself."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkIdList, vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkPolygon

    place, found, polygon = vtkPoints(), vtkIdList(), vtkPolygon()
    place.SetData(numpy_to_vtk(points))
    polygon.Initialize(len(points), place)
    polygon.Triangulate(0, found, vtkPoints())
    return np.array([found.GetId(k) for k in range(found.GetNumberOfIds())], dtype=np.int64).reshape(-1, 3)


def of_strips(corners: Index) -> Index:
    """Triangles (t, 3) of strips, which negative corners separate."""
    k = np.arange(len(corners))
    start = np.maximum.accumulate(np.where(corners < 0, k + 1, 0))
    faces: Index = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    turned = (k - start)[:-2] % 2 == 1
    faces[turned] = faces[turned, ::-1]
    return faces[(faces >= 0).all(axis=1)]


FRAME = "world coordinates of the recording's poses, right-handed; for a simulated scan those of the mesh"
POINT, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
COVARIANCE = tuple(f"cov_{pair}" for pair in ("xx", "xy", "xz", "yy", "yz", "zz"))
"""The upper triangle of the covariance of a contact's place."""
LENGTHS = dict.fromkeys(("quality", "bound", "place_sd"), 1) | dict.fromkeys(COVARIANCE, 2)
"""The power of the file's unit of length in the scalars that have one."""


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
    off: float = 0.0
    """How far it is at most from the surface that it is a coarser form of, and that from it."""

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

    Contacts of noisy data have the standard
    deviations of their places and of their normals' angles as well, and the covariances of their places in the world.  Contacts
    of the spatial model lie in no slices; instead of the slice they have the rod's tangent and its bending angle, NaN for rods
    that probe.  Touches of other probes have neither sweep, force nor friction.
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
    if cloud.covariance is not None:
        columns |= dict(zip(COVARIANCE, cloud.covariance[:, *np.triu_indices(3)].astype(np.float32).T, strict=True))
    if cloud.model == "touches":
        for name in ("phase", "slice", "sweep", "force", "friction"):
            del columns[name]
    if cloud.model == "spatial":
        nothing = np.full((len(cloud), 3), np.nan)
        tangents = nothing if cloud.tangents is None else cloud.tangents
        bending = nothing[:, 0] if cloud.bending_angle is None else cloud.bending_angle
        del columns["slice"]
        columns |= dict(zip(("tx", "ty", "tz"), tangents.astype(np.float32).T, strict=True))
        columns["bending"] = bending.astype(np.float32)
    return table(columns)


def surface_table(surface: Any) -> NDArray[np.void]:
    """Vertices, their normals, and of the certified local bound and of how well they are known what the surface has, as a
    structured array for `ply`."""
    columns: dict[str, NDArray[Any]] = dict(zip(POINT, np.asarray(surface.vertices, dtype=np.float64).T, strict=True))
    columns |= dict(zip(NORMAL, _vertex_normals(surface).astype(np.float32).T, strict=True))
    known, kinds = surface.vertex_attributes, {"bound": np.float32, "known": np.uint8}
    return table(
        columns | {name: np.asarray(known[name]).astype(kind) for name, kind in kinds.items() if name in known}
    )


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


def scale_lengths(rows: NDArray[Any], factor: float) -> None:
    """Multiply the lengths of structured rows (n,), and what is in powers of their unit, in place."""
    for name, power in (dict.fromkeys(POINT, 1) | LENGTHS).items():
        if name in (rows.dtype.names or ()):
            rows[name] = factor**power * rows[name]


def in_unit(shape: Shape, unit: str | None) -> Shape:
    """The shape with all lengths in another unit; None keeps them.  Raises InputError for an unknown unit."""
    if unit is None or unit == shape.unit:
        return shape
    check_unit(unit)
    rows = shape.rows.copy()
    scale_lengths(rows, UNITS_M[shape.unit] / UNITS_M[unit])
    return replace(shape, rows=rows, unit=unit)


# The formats of clouds and of surfaces, in the order in which messages list them.
CLOUD_ENDINGS = (".ply", ".pcd", ".vtp", ".xyz", ".xyzn", ".csv", ".mat", ".glb")
SURFACE_ENDINGS = (".stl", ".ply", ".obj", ".glb", ".vtp", ".mat")
# The formats of each of `EXPORTS`, the default first.
_ENDINGS = dict(zip(EXPORTS, (SURFACE_ENDINGS, CLOUD_ENDINGS), strict=True))
# Formats whose coordinates are in float32.
_SINGLE = (".stl", ".glb", ".pcd")
# That in metres by its specification.
_METRES = ".glb"

# Formats in which each point has a normal, of .glb those of surfaces, and what to do otherwise.
_WITH_NORMALS = {
    ".xyzn": "leave them out with .xyz, or choose .ply, .pcd, .vtp or .csv, which allow missing normals",
    **dict.fromkeys((".obj", ".glb"), "choose .stl or .ply"),
}


def export(
    source: str | Path,
    to: str | Path,
    what: str | None = None,
    *,
    unit: str | None = None,
    overwrite: bool = False,
    changed: Callable[[Shape], Shape] = lambda shape: shape,
) -> dict[str, Any]:
    """Write the cloud or the surface of a scan's folder, or of one of its PLY files, to a file of another format.

    what
        'cloud' or 'surface' where the ending of `to`, which determines the format, allows either (.ply, .vtp, .mat, .glb);
        the default is the surface, if there is one.
    unit
        of the lengths in the file, such as 'm' for ROS (REP 103); the recording's by default.  GLB is in metres.
    changed
        makes what is written of what was read, in that unit, such as `files.reduced.decimated`.

    Returns what was written, as plain values.  Raises InputError for unknown endings and sources, for sources that cannot be
    written in the format, for units that it does not have, for missing normals that it needs, and if `to` is part of a scan's
    folder, the source itself, or, unless `overwrite` is true, a file that can't be recognised as an earlier export.
    """
    source, to = Path(source), Path(to)
    ending = to.suffix.lower()
    contents = _contents(ending, what)
    if ending == _METRES and unit not in (None, "m"):
        raise InputError(f"{ending} is in metres by its specification, and can't be in {unit}; leave the unit out")
    shape = read_part(source, *contents)
    if shape.what not in contents:
        raise InputError(
            f"{source.name} contains a {shape.what}, but a {contents[0]} is needed; a {shape.what} can be written as "
            f"{one_of(_ENDINGS[shape.what])}, and the folder of a scan has both"
        )
    return write_shape(changed(in_unit(shape, unit)), to, {"source": source}, contents, overwrite=overwrite)


def write_shape(
    shape: Shape,
    to: str | Path,
    inputs: Inputs | None = None,
    contents: Sequence[str] | None = None,
    *,
    overwrite: bool = False,
    option: str = "--to",
) -> dict[str, Any]:
    """Write a cloud or a surface to a file, whose ending determines the format.

    inputs, option
        as in `files.whole.check_file`.
    contents
        what may be written, of `EXPORTS`; by default what a file with this ending can contain.

    Returns and raises as `export`.  Of a cloud in GLB points without a normal are left out and counted, unless none has one.
    """
    to = Path(to)
    ending = to.suffix.lower()
    contents = _contents(ending, None) if contents is None else contents
    if shape.what not in contents:
        raise InputError(
            f"a {shape.what} can't be written as {ending}, which holds a {contents[0]}; a {shape.what} can be written as "
            f"{one_of(_ENDINGS[shape.what])}"
        )
    before = len(shape.rows)
    if shape.faces is not None:
        shape = _readable(shape, ending)
    if ending in _SINGLE:
        _check_digits(shape, ending)
    known = np.linalg.norm(shape.normals, axis=1) > 0
    if ending in _WITH_NORMALS and not known.all() and not (ending == ".glb" and shape.faces is None):
        raise InputError(
            f"{(~known).sum()} of {len(known)} points have no normal, which {ending} requires; {_WITH_NORMALS[ending]}"
        )
    if ending == ".glb" and known.any():
        shape = replace(shape, rows=shape.rows[known])
    left_out = 0 if shape.faces is not None else before - len(shape.rows)
    data = None if ending == ".vtp" else _WRITERS[ending](shape)
    check_file(to, inputs or {}, overwrite, option, data)
    with folder(to.parent, option=option), atomic(to, option=option) as file:
        if data is None:
            to_polydata(shape).save(file)
        else:
            file.write_bytes(data)
    faces = 0 if shape.faces is None else len(shape.faces)
    unit = "m" if ending == _METRES else shape.unit
    written = {"file": str(to), "what": shape.what, "points": len(shape.rows), "faces": faces, "unit": unit}
    return written | {"off": shape.off * UNITS_M[shape.unit] / UNITS_M[unit], "left_out": left_out}


def float32_step(points: Array) -> float:
    """How far apart the numbers of float32 are at the largest coordinate of points (n, 3); infinite or NaN beyond its range."""
    with np.errstate(all="ignore"):
        return float(np.spacing(np.float32(np.abs(points).max())))


def lost_in_float32(points: Array, size: float) -> bool:
    """Whether a thickness, or the depth of a dent, of a body of points (n, 3) may be nothing but their rounding to float32.

    What is read and what is written is judged alike.
    """
    step = float32_step(points)
    return bool(step > DENT_TOLERANCE * np.linalg.norm(np.ptp(points, axis=0)) and size <= np.sqrt(3) * step)


def _check_digits(shape: Shape, ending: str) -> None:
    """Raises InputError if float32 rounds the points by more than 1e-4 of their extent, or so that no body would be read."""
    points = shape.points[np.isfinite(shape.points).all(axis=1)]
    if len(points) < 2:
        return
    with np.errstate(all="ignore"):  # beyond the range of float32
        diagonal, step = float(np.linalg.norm(np.ptp(points, axis=0))), float32_step(points)
    is_lost = step > 1e-4 * diagonal > 0
    if not is_lost and shape.faces is not None and len(points) == len(shape.rows) and step > DENT_TOLERANCE * diagonal:
        single = _stored(shape, ending)
        extent = float(np.linalg.norm(np.ptp(single, axis=0)))
        _, dent, _, _ = against_own_hull((single - single.mean(axis=0)) / extent, shape.faces.astype(np.int64))
        is_lost = dent > DENT_TOLERANCE and lost_in_float32(single, dent * extent)
    if is_lost:
        double = {"cloud": (".ply", ".csv", ".vtp"), "surface": (".ply", ".obj", ".vtp")}[shape.what]
        raise InputError(
            f"{ending} is in float32, whose numbers are {length(step, shape.unit, digits=2)} apart at coordinates of "
            f"{length(np.abs(points).max(), shape.unit, digits=6)}, so that the shape of this {shape.what} would be lost; "
            f"choose {one_of(double)}, which keep all digits, or scan the body nearer to the origin"
        )


def _stored(shape: Shape, ending: str) -> Array:
    """The points (n, 3) as a file of a format has them."""
    points = shape.points * (UNITS_M[shape.unit] if ending == _METRES else 1.0)
    with np.errstate(over="ignore"):
        return points.astype(np.float32).astype(np.float64) if ending in _SINGLE else points


def _readable(shape: Shape, ending: str) -> Shape:
    """The surface with the vertices merged that readers of the format would merge, and without triangles between these."""
    assert shape.faces is not None
    points = _stored(shape, ending)
    if not np.isfinite(points).all() or len(points) == 0:
        return shape
    chosen = representatives(points, distance_of_readers(points))
    if (chosen == np.arange(len(points))).all():
        return shape
    used, faces = without_unused(collapsed(shape.faces, chosen))
    return replace(shape, rows=shape.rows[used], faces=faces.astype(np.int32))


def _contents(ending: str, what: str | None) -> list[str]:
    """What a file with this ending can contain, the default first; only `what` if it is given."""
    if what not in (None, *EXPORTS):
        raise InputError(f"what to export must be one of {', '.join(EXPORTS)}, got {what!r}")
    contents = [kind for kind, endings in _ENDINGS.items() if ending in endings]
    if not contents:
        raise UsageError(
            f"can't export to files {f'ending in {ending!r}' if ending else 'without an ending'}: a cloud can be written as "
            f"{one_of(CLOUD_ENDINGS)}, a surface as {one_of(SURFACE_ENDINGS)}"
        )
    if what is None:
        return contents
    if what not in contents:
        raise InputError(f"{ending} cannot contain a {what}; a {what} can be written as {one_of(_ENDINGS[what])}")
    return [what]


def read_part(source: Path, *contents: str) -> Shape:
    """The cloud or the surface of a scan's folder, the first of `contents` that it has, or what a PLY file holds."""
    if not source.exists():
        raise InputError(f"there is no {source}; give the folder of a scan, or a PLY written by scan3d")
    if not source.is_dir():
        return read_shape(locate(source))
    check_finished(source)
    report, names = read_report(source), [f"{what}.ply" for what in contents]
    name = next((name for name in names if locate(source / name).is_file()), None)
    if name is None:
        surface = report.get("surface") or {}
        why = surface["reason"] if not surface.get("method", True) else ""
        instead = why or "give a folder written by 'scan3d scan' or 'scan3d reconstruct'"
        raise InputError(f"there is no {names[0]} in {source}: {instead}")
    check_belongs(source, report, [name])
    return read_shape(locate(source / name))


def _pcd(shape: Shape) -> bytes:
    """The format of the Point Cloud Library, with the fields of its PointNormal, all in float32 as its readers expect."""
    fields = {name: shape.rows[name] for name in POINT}
    fields |= {f"normal_{name[1:]}": shape.rows[name] for name in NORMAL} | shape.columns
    count, points = len(fields), len(shape.rows)
    remarks = "".join(f"# {line}\n" for line in shape.remarks)
    header = (
        f"# .PCD v0.7 - Point Cloud Data file format\n{remarks}VERSION 0.7\nFIELDS {' '.join(fields)}\nSIZE{' 4' * count}\n"
        f"TYPE{' F' * count}\nCOUNT{' 1' * count}\nWIDTH {points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\n"
        "DATA binary\n"
    )
    body = np.stack([column.astype("<f4") for column in fields.values()], axis=1)
    return header.encode() + body.tobytes()


def _csv(shape: Shape) -> bytes:
    names = shape.rows.dtype.names or ()
    units = dict.fromkeys(POINT, f"_{shape.unit}") | {"force": "_N"}
    units |= {name: f"_{shape.unit}{power if power > 1 else ''}" for name, power in LENGTHS.items()}
    header = ",".join(name + units.get(name, "") for name in names)
    return f"{header}\n".encode() + rows_as_text(_columns(shape, names), ",")


def _stl(shape: Shape) -> bytes:
    """Binary STL, float32; the unit and the frame are in its header of 80 bytes."""
    assert shape.faces is not None
    corners = shape.points[shape.faces]
    rows = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    # a triangle without area has no normal; STL then has zeros
    rows["normal"] = unit_or_zero(spanned(corners))
    rows["corners"] = corners
    header = f"scan3d surface, unit {shape.unit}, frame world, outward".encode().ljust(80)
    return header + struct.pack("<I", len(rows)) + rows.tobytes()


def _obj(shape: Shape) -> bytes:
    assert shape.faces is not None
    remarks = "".join(f"# {line}\n" for line in shape.remarks).encode()
    corners = (map(str, column) for column in (shape.faces + 1).T)
    faces = (f"f {a}//{a} {b}//{b} {c}//{c}\n" for a, b, c in zip(*corners, strict=True))
    points, normals = (
        rows_as_text(_columns(shape, names), " ", start) for names, start in ((POINT, "v "), (NORMAL, "vn "))
    )
    return remarks + points + normals + "".join(faces).encode()


def _mat(shape: Shape) -> bytes:
    """MATLAB's format of level 5, with all numbers as double, which MATLAB combines with any others.

    Source: The MathWorks, MAT-File Format, R2024a: a file begins with 116 bytes of any text.
    """
    from scipy.io import savemat

    own: dict[str, NDArray[Any]] = {"points": shape.points, "normals": shape.normals}
    if shape.faces is not None:
        own = {"vertices": shape.points, "normals": shape.normals, "faces": shape.faces + 1}
    texts = {"unit": shape.unit, "frame": FRAME}
    for name in shape.columns:
        if name in own | texts or not re.fullmatch(r"[a-zA-Z]\w{0,62}", name, re.ASCII):
            raise InputError(
                f"the scalar {name!r} can't be in a .mat: expected a name for MATLAB other than {one_of([*own, *texts])}; "
                "rename it, or choose .ply or .vtp"
            )
    numbers = {name: values.astype(np.float64) for name, values in (own | shape.columns).items()}
    data = io.BytesIO()
    savemat(data, numbers | texts, oned_as="column")
    # without the time, so that the same shape gives the same file
    return f"MATLAB 5.0 MAT-file, scan3d {shape.what}".encode().ljust(116) + data.getvalue()[116:]


def to_polydata(shape: Shape) -> Any:
    """A `pyvista.PolyData` with every column in its own precision, unit and frame as field data."""
    import pyvista

    if shape.faces is None:
        data = pyvista.PolyData(shape.points)
    else:
        data = pyvista.PolyData.from_regular_faces(shape.points, shape.faces)
    data.point_data["Normals"] = shape.normals
    data.point_data.active_normals_name = "Normals"
    for name, column in shape.columns.items():
        data.point_data[name] = column
    data.set_active_scalars(None)
    data.field_data["scan3d"] = [shape.what]  # by which the file is recognised
    data.field_data["unit"] = [shape.unit]
    data.field_data["frame"] = [FRAME]
    return data


_WRITERS: dict[str, Callable[[Shape], bytes]] = {
    ".ply": lambda shape: ply(_with_quality(shape), shape.faces, shape.remarks),
    ".pcd": _pcd,
    ".xyz": lambda shape: rows_as_text(_columns(shape, POINT), " "),
    ".xyzn": lambda shape: rows_as_text(_columns(shape, POINT + NORMAL), " "),
    ".csv": _csv,
    ".mat": _mat,
    ".stl": _stl,
    ".obj": _obj,
    ".glb": lambda shape: glb(shape),
}


def _with_quality(shape: Shape) -> NDArray[Any]:
    """The rows of a shape, those of a surface with its bound, or how well it is known, as the quality that MeshLab shows."""
    columns = {name: shape.rows[name] for name in shape.rows.dtype.names or ()}
    scalar = columns.get("bound", columns.get("known"))
    if shape.faces is None or scalar is None or "quality" in columns:
        return shape.rows
    return table(columns | {"quality": scalar.astype(np.float32)})


def _columns(shape: Shape, names: Sequence[str]) -> list[NDArray[Any]]:
    return [shape.rows[name] for name in names]


# The codes of the specification for types of numbers, by those of numpy, and for vectors by their length.
_COMPONENTS = {"|i1": 5120, "|u1": 5121, "<i2": 5122, "<u2": 5123, "<u4": 5125, "<f4": 5126}
_VECTORS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_TYPES = {code: np.dtype(name) for name, code in _COMPONENTS.items()}
_WIDTHS = {name: width for width, name in _VECTORS.items()}
# Bytes for a vertex of a GLB, as it is stored, where its node puts it, and among all.
_MEMORY_PER_VALUE = 100
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
            attributes[f"_{name.upper()}"] = buffers.add(column * np.float32(scale ** LENGTHS.get(name, 0)))
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


def read_glb(data: bytes, scale: float = 1.0) -> tuple[Array, Index]:
    """Vertices (v, 3) and triangles (f, 3) of the scene in a GLB, where its nodes put them.

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
    parts, size = [], 0
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
                size += content.size(primitive)  # a mesh may stand at many places
                check_memory(_MEMORY_PER_VALUE * size, "reading all parts of it", "take a smaller file")
                points, faces = content.triangles(primitive)
                faces = faces if np.linalg.det(matrix[:3, :3]) >= 0 else faces[:, ::-1]  # a mirror image
                parts.append((points @ matrix[:3, :3].T + matrix[:3, 3], faces))
    first = np.cumsum([0, *(len(points) for points, _ in parts)])
    points = np.concatenate([np.empty((0, 3)), *(points for points, _ in parts)])
    faces = np.concatenate(
        [np.empty((0, 3), int), *(own + before for (_, own), before in zip(parts, first, strict=False))]
    )
    extras = tree["asset"].get("extras")
    is_turned = isinstance(extras, Mapping) and extras.get("axes") == _AXES
    return points[:, [0, 2, 1]] * [1, -1, 1] if is_turned else points, faces


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

    def size(self, primitive: Mapping[str, Any]) -> int:
        """How many vertices and corners of triangles a part has."""
        used = [primitive["attributes"]["POSITION"], *([primitive["indices"]] if "indices" in primitive else [])]
        return sum(len(self._values(self._tree["accessors"][number])) for number in used)  # as views of the file

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
        if corners.max(initial=-1) >= len(points):
            raise IndexError("a face has a vertex that does not exist")
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
