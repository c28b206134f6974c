"""Clouds and surfaces in the formats of other programs, written and read back, by file ending.

Points keep their world coordinates in the recording's unit, or in another one that is asked for; GLB and bags of ROS are in
metres, and GLB has y up, by their specifications.  Normals and scalars are written where the format can contain them, unit and
frame where the format allows comments.  docs/files.md lists which program reads which format.
"""

from __future__ import annotations

import re
import struct
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.choices import EXPORTS, one_of
from scan3d.errors import InputError
from scan3d.files import reading
from scan3d.files.gltf import glb
from scan3d.files.shapes import (
    FRAME,
    LENGTHS,
    NORMAL,
    POINT,
    Shape,
    colored,
    in_unit,
    named_for,
    ply,
    read_shape,
    table,
)
from scan3d.files.text import rows_as_text
from scan3d.files.whole import Inputs, atomic, check_belongs, check_file, folder, locate, read_report
from scan3d.geometry.triangles import collapsed, distance_of_readers, representatives, without_unused
from scan3d.numbers import length
from scan3d.units import UNITS_M

# The formats of clouds and of surfaces, in the order in which messages list them.
CLOUD_ENDINGS = (".ply", ".pcd", ".vtp", ".xyz", ".xyzn", ".csv")
"""The formats of clouds that are read back as well."""
POINT_ENDINGS = (*CLOUD_ENDINGS, ".glb", ".mcap")
SURFACE_ENDINGS = (".stl", ".ply", ".obj", ".glb", ".vtp")
# The formats of each of `EXPORTS`, the default first.
_ENDINGS = dict(zip(EXPORTS, (SURFACE_ENDINGS, POINT_ENDINGS), strict=True))
# Formats whose coordinates are in float32, and the largest part of the diagonal to which it may round them.
_SINGLE, _COARSE = (".stl", ".glb", ".pcd", ".mcap"), 1e-4
# Formats in metres by their specification, those without a place for colours, and that whose names of scalars are chosen.
_METRES, _COLORLESS, _NAMED = (".glb", ".mcap"), (".stl", ".xyz", ".xyzn"), ".ply"

# Formats in which each point has a normal, of .glb those of surfaces, and what to do otherwise.
_WITH_NORMALS = {
    ".xyzn": "leave them out with .xyz, or choose .ply, .pcd, .vtp or .csv, which allow missing normals",
    **dict.fromkeys((".obj", ".glb"), "choose .stl or .ply"),
}
_UNIT = "|".join(UNITS_M)
_STL_ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def export(
    source: str | Path,
    to: str | Path,
    what: str | None = None,
    *,
    unit: str | None = None,
    color: str | None = None,
    scalar_names: str | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Write the cloud or the surface of a scan's folder, or of one of its PLY files, to a file of another format.

    what
        'cloud' or 'surface' where the ending of `to`, which determines the format, allows either (.ply, .vtp, .glb); the
        default is the surface, unless `source` is a cloud.
    unit
        of the lengths in the file, such as 'm' for ROS (REP 103); the recording's by default.  GLB and bags are in metres.
    color
        the scalar by which points have red, green and blue; it is written as well.
    scalar_names
        the program, one of `choices.SCALAR_NAMES`, whose names the scalars of a .ply have.

    Returns what was written, as plain values.  Raises InputError for unknown endings and sources, for sources that cannot be
    written in the format, for units, colours and names that it does not have, for missing normals that it needs, and if `to`
    is part of a scan's folder, the source itself, or, unless `overwrite` is true, a file that can't be recognised as an
    earlier export.
    """
    source, to = Path(source), Path(to)
    ending = to.suffix.lower()
    contents = _contents(ending, what)
    _check_options(ending, unit, color, scalar_names)
    shape = _read(source, contents[0])
    if shape.what not in contents:
        raise InputError(
            f"{source.name} contains a {shape.what}, but a {contents[0]} is needed; a {shape.what} can be written as "
            f"{one_of(_ENDINGS[shape.what])}, and the folder of a scan has both"
        )
    shape = named_for(colored(in_unit(shape, unit), color), scalar_names, color)
    return write_shape(shape, to, {"source": source}, contents, overwrite=overwrite)


def _check_options(ending: str, unit: str | None, color: str | None, scalar_names: str | None) -> None:
    """Raises InputError for what a format does not have."""
    if ending in _METRES and unit not in (None, "m"):
        raise InputError(f"{ending} is in metres by its specification, and can't be in {unit}; leave the unit out")
    if ending in _COLORLESS and color is not None:
        raise InputError(f"{ending} has no place for colours; choose .ply, .pcd, .vtp, .csv, .obj, .glb or .mcap")
    if ending != _NAMED and scalar_names is not None:
        raise InputError(f"names of scalars are chosen for {_NAMED}, which {scalar_names} reads, and not for {ending}")


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
    unit = "m" if ending in _METRES else shape.unit
    written = {"file": str(to), "what": shape.what, "points": len(shape.rows), "faces": faces, "unit": unit}
    return written | {"left_out": left_out}


def _check_digits(shape: Shape, ending: str) -> None:
    """Raises InputError if float32 rounds the points by more than the bound to which they are known."""
    points = shape.points[np.isfinite(shape.points).all(axis=1)]
    if len(points) < 2:
        return
    bound = shape.columns.get("bound", np.zeros(0))
    bound = bound[np.isfinite(bound)]
    allowed = max(_COARSE * np.linalg.norm(np.ptp(points, axis=0)), np.median(bound) if len(bound) else 0.0)
    largest = np.abs(points).max()
    with np.errstate(all="ignore"):  # beyond the range of float32
        step = np.spacing(np.float32(largest))
    if step > allowed > 0:
        double = {"cloud": (".ply", ".csv", ".vtp"), "surface": (".ply", ".obj", ".vtp")}[shape.what]
        raise InputError(
            f"{ending} is in float32, whose numbers are {length(step, shape.unit, digits=2)} apart at coordinates of "
            f"{largest:.6g} "
            f"{shape.unit}, so that the shape of this {shape.what} would be lost; choose {one_of(double)}, which keep all "
            "digits, or scan the body nearer to the origin"
        )


def _readable(shape: Shape, ending: str) -> Shape:
    """The surface with the vertices merged that readers of the format would merge, and without triangles between these."""
    assert shape.faces is not None
    points = shape.points * (UNITS_M[shape.unit] if ending == ".glb" else 1.0)
    if ending in _SINGLE:
        points = points.astype(np.float32).astype(np.float64)
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
        raise InputError(
            f"can't export to files {f'ending in {ending!r}' if ending else 'without an ending'}: a cloud can be written as "
            f"{one_of(POINT_ENDINGS)}, a surface as {one_of(SURFACE_ENDINGS)}"
        )
    if what is None:
        return contents
    if what not in contents:
        raise InputError(f"{ending} cannot contain a {what}; a {what} can be written as {one_of(_ENDINGS[what])}")
    return [what]


def _read(source: Path, what: str) -> Shape:
    """The wanted part of a scan's folder, or the contents of a single file."""
    if not source.exists():
        raise InputError(f"there is no {source}; give the folder of a scan, or a PLY written by scan3d")
    if source.is_dir():
        name = f"{what}.ply"
        if not locate(source / name).is_file():
            raise InputError(
                f"there is no {name} in {source}; give a folder written by 'scan3d scan' or 'scan3d reconstruct'"
            )
        check_belongs(source, read_report(source), [name])
        return read_shape(locate(source / name))
    return read_shape(locate(source))


def _pcd(shape: Shape) -> bytes:
    """The format of the Point Cloud Library, with the fields of its PointNormal, all in float32 as its readers expect."""
    points = packed_points(shape)
    fields = list(points.dtype.names or ())
    count = len(fields)
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        *(f"# {line}" for line in shape.remarks),
        "VERSION 0.7",
        f"FIELDS {' '.join(fields)}",
        f"SIZE {' '.join(['4'] * count)}",
        f"TYPE {' '.join(['F'] * count)}",
        f"COUNT {' '.join(['1'] * count)}",
        f"WIDTH {len(shape.rows)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(shape.rows)}",
        "DATA binary",
        "",
    ]
    body = np.stack([points[name].astype("<f4") for name in fields], axis=1)
    return "\n".join(header).encode() + body.tobytes()


def _csv(shape: Shape) -> bytes:
    names = shape.rows.dtype.names or ()
    units = dict.fromkeys(POINT + LENGTHS, f"_{shape.unit}") | {"force": "_N"}
    header = ",".join(name + units.get(name, "") for name in names)
    return f"{header}\n".encode() + rows_as_text(_columns(shape, names), ",")


def _stl(shape: Shape) -> bytes:
    """Binary STL, float32; the unit and the frame are in its header of 80 bytes."""
    assert shape.faces is not None
    corners = shape.points[shape.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    rows = np.zeros(len(corners), _STL_ROW)
    # a triangle without area has no normal; STL then has zeros
    rows["normal"] = np.divide(across, length, out=np.zeros_like(across), where=length > 0)
    rows["corners"] = corners
    header = f"scan3d surface, unit {shape.unit}, frame world, outward".encode().ljust(80)
    return header + struct.pack("<I", len(rows)) + rows.tobytes()


def _obj(shape: Shape) -> bytes:
    assert shape.faces is not None
    remarks = "".join(f"# {line}\n" for line in shape.remarks).encode()
    # after the point, as most programs read it, from 0 to 1
    colors = [] if shape.colors is None else list(np.round(shape.colors.T / 255, 4))
    corners = (map(str, column) for column in (shape.faces + 1).T)
    faces = (f"f {a}//{a} {b}//{b} {c}//{c}\n" for a, b, c in zip(*corners, strict=True))
    return b"".join(
        [
            remarks,
            rows_as_text([*_columns(shape, POINT), *colors], " ", "v "),
            rows_as_text(_columns(shape, NORMAL), " ", "vn "),
            "".join(faces).encode(),
        ]
    )


def to_polydata(shape: Shape) -> Any:
    """A `pyvista.PolyData` with every column in its own precision, unit and frame as field data."""
    import pyvista

    if shape.faces is None:
        data = pyvista.PolyData(shape.points)
    else:
        data = pyvista.PolyData.from_regular_faces(shape.points, shape.faces)
    data.point_data["Normals"] = shape.normals
    data.point_data.active_normals_name = "Normals"
    if shape.colors is not None:
        data.point_data["RGB"] = shape.colors
    for name, column in shape.columns.items():
        data.point_data[name] = column
    data.set_active_scalars(None)
    data.field_data["scan3d"] = [shape.what]  # by which the file is recognised
    data.field_data["unit"] = [shape.unit]
    data.field_data["frame"] = [FRAME]
    return data


_WRITERS: dict[str, Callable[[Shape], bytes]] = {
    ".ply": lambda shape: ply(shape.rows, shape.faces, shape.remarks),
    ".pcd": _pcd,
    ".xyz": lambda shape: rows_as_text(_columns(shape, POINT), " "),
    ".xyzn": lambda shape: rows_as_text(_columns(shape, POINT + NORMAL), " "),
    ".csv": _csv,
    ".stl": _stl,
    ".obj": _obj,
    ".glb": glb,
    ".mcap": lambda shape: point_cloud_bag(in_unit(shape, "m")),
}


def _columns(shape: Shape, names: Sequence[str]) -> list[NDArray[Any]]:
    return [shape.rows[name] for name in names]


# --- reading ---


def read_cloud(path: str | Path, unit: str | None = None) -> Shape:
    """The cloud, or of ``.vtp`` and ``.ply`` the surface, in a file of `CLOUD_ENDINGS`.

    unit
        of points that state none (``.xyz``, ``.xyzn``); for others None, or the unit that they state.

    Raises InputError for other files, and for another unit than the file states.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path.name} is no cloud by its ending, which should be {one_of(CLOUD_ENDINGS)}")
    try:
        reading.check_file(path, memory_per_byte=8)
        rows, faces, stated = reader(path)
    except OSError as error:
        raise InputError(f"can't read {path}: {error.strerror or error}; check the path") from None
    except (ValueError, KeyError, IndexError) as error:
        raise InputError(
            f"{path.name} is not a {path.suffix} file as scan3d writes it: {' '.join(str(error).split())}"
        ) from None
    if unit is not None and stated not in (None, unit):
        raise InputError(f"{path.name} is in {stated}, as it states itself, and not in {unit}; leave the unit out")
    return Shape(rows, faces, stated or unit or "mm")


_Read = tuple[NDArray[Any], NDArray[np.int32] | None, str | None]


def _read_ply(path: Path) -> _Read:
    shape = read_shape(path)
    return shape.rows, shape.faces, shape.unit


def _read_pcd(path: Path) -> _Read:
    head, separator, body = path.read_bytes().partition(b"\nDATA binary\n")
    lines = [line.split() for line in head.decode(errors="replace").splitlines()]
    fields = next((line[1:] for line in lines if line[:1] == ["FIELDS"]), [])
    unit = next((line[2] for line in lines if line[:2] == ["#", "unit"] and len(line) == 3), None)
    if not separator or unit not in UNITS_M:
        raise ValueError("its header has no unit, or no binary data follow")
    values = np.frombuffer(body, "<f4").reshape(-1, len(fields))
    return _table([re.sub("^normal_([xyz])$", r"n\1", name) for name in fields], values), None, unit


def _read_csv(path: Path) -> _Read:
    header = path.read_text(encoding="utf-8").partition("\n")[0].split(",")
    match = re.fullmatch(rf"x_({_UNIT})", header[0])
    if match is None:
        raise ValueError(f"its header begins with {header[0][:20]!r}, where x and a unit is expected, such as x_mm")
    unit = match[1]
    names = [re.sub(rf"_({unit}|N)$", "", name) for name in header]
    return _table(names, np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)), None, unit


def _read_xyz(path: Path) -> _Read:
    values = np.loadtxt(path, ndmin=2)
    if values.shape[1] not in (3, 6):
        raise ValueError(f"it has {values.shape[1]} numbers in a line, where 3 or 6 are expected")
    return _table([*POINT, *NORMAL][: values.shape[1]], values), None, None


def _read_vtp(path: Path) -> _Read:
    import pyvista

    data = pyvista.read(path)
    if "unit" not in data.field_data or "Normals" not in data.point_data:
        raise ValueError("it states no unit, or has no normals")
    columns = {name: np.asarray(column) for name, column in data.point_data.items() if name != "Normals"}
    points = dict(zip(POINT, np.asarray(data.points, dtype=float).T, strict=True))
    normals = dict(zip(NORMAL, np.asarray(data.point_data["Normals"]).T, strict=True))
    faces = data.faces.reshape(-1, 4)[:, 1:].astype(np.int32) if data.faces.size else None
    return table(points | normals | columns), faces, str(data.field_data["unit"][0])


def _table(names: list[str], values: NDArray[Any]) -> NDArray[Any]:
    """Rows of named columns; normals that the file does not hold are NaN."""
    columns = dict(zip(names, values.T, strict=True))
    unknown = np.full(len(values), np.nan)
    points = {name: columns.pop(name).astype(float) for name in POINT}
    normals = {name: columns.pop(name, unknown).astype(np.float32) for name in NORMAL}
    return table(points | normals | columns)


_READERS: dict[str, Callable[[Path], _Read]] = {
    ".ply": _read_ply,
    ".pcd": _read_pcd,
    ".csv": _read_csv,
    ".xyz": _read_xyz,
    ".xyzn": _read_xyz,
    ".vtp": _read_vtp,
}


TOPIC, FRAME_ID = "/scan3d/contacts", "world"
_CLOUD, _FIELD, _HEADER, _TIME = (
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/PointField",
    "std_msgs/msg/Header",
    "builtin_interfaces/msg/Time",
)
# Codes of sensor_msgs/PointField by those of numpy.
_DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def point_cloud_bag(shape: Shape) -> bytes:
    """The bag of a cloud in metres, on the topic `TOPIC` in the frame `FRAME_ID` at time 0.

    The fields are x, y, z, normal_x, normal_y, normal_z, rgb where there are colours, and the scalars; points and normals in
    float32, as programs of ROS expect them, scalars in their own type.  The same cloud gives the same bytes.

    Raises InputError if rosbags is missing.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError(
            "a bag of ROS 2 needs rosbags: pip install 'scan3d[ros]'; or export the cloud as .pcd"
        ) from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    points = packed_points(shape)
    types = store.types
    fields = [
        types[_FIELD](name=name, offset=int(offset), datatype=_DATATYPES[kind.str[1:]], count=1)
        for name, (kind, offset, *_) in (points.dtype.fields or {}).items()
    ]
    message = types[_CLOUD](
        header=types[_HEADER](stamp=types[_TIME](sec=0, nanosec=0), frame_id=FRAME_ID),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=points.itemsize,
        row_step=points.nbytes,
        data=np.frombuffer(points.tobytes(), np.uint8),
        is_dense=bool(np.isfinite(shape.points).all()),
    )
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "cloud"
        with Writer(place, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection(TOPIC, _CLOUD, typestore=store)
            writer.write(connection, 0, store.serialize_cdr(message, _CLOUD))
        (file,) = place.glob("*.mcap")
        return file.read_bytes()


def packed_points(shape: Shape) -> NDArray[np.void]:
    """The points (n,) as the Point Cloud Library packs them: float32, normals as normal_x …, colours as the bits of one rgb."""
    columns: dict[str, NDArray[Any]] = {name: shape.rows[name].astype("<f4") for name in POINT}
    columns |= {f"normal_{name[1:]}": shape.rows[name].astype("<f4") for name in NORMAL}
    if shape.colors is not None:
        red, green, blue = shape.colors.astype("<u4").T
        columns["rgb"] = (red << 16 | green << 8 | blue).view("<f4")
    columns |= shape.columns
    rows = np.empty(len(shape.rows), dtype=[(name, column.dtype.newbyteorder("<")) for name, column in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    return rows
