"""Clouds and surfaces in the formats of other programs, written and read back, by file ending.

Points keep their world coordinates in the recording's unit, or in another one that is asked for; GLB is in
metres, with y up, by its specification.  Normals and scalars are written where the format can contain them, unit and
frame where the format allows comments.  docs/files.md lists which program reads which format.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.choices import EXPORTS, one_of
from scan3d.errors import InputError
from scan3d.files import shapes
from scan3d.files.gltf import glb
from scan3d.files.text import rows_as_text
from scan3d.files.whole import Inputs, atomic, check_belongs, check_file, folder, locate, read_report
from scan3d.geometry.triangles import collapsed, distance_of_readers, representatives, without_unused
from scan3d.numbers import length
from scan3d.units import UNITS_M

# The formats of clouds and of surfaces, in the order in which messages list them.
CLOUD_ENDINGS = (".ply", ".pcd", ".vtp", ".xyz", ".xyzn", ".csv", ".glb")
SURFACE_ENDINGS = (".stl", ".ply", ".obj", ".glb", ".vtp")
# The formats of each of `EXPORTS`, the default first.
_ENDINGS = dict(zip(EXPORTS, (SURFACE_ENDINGS, CLOUD_ENDINGS), strict=True))
# Formats whose coordinates are in float32, and the largest part of the diagonal to which it may round them.
_SINGLE, _COARSE = (".stl", ".glb", ".pcd"), 1e-4
# That in metres by its specification.
_METRES = ".glb"

# Formats in which each point has a normal, of .glb those of surfaces, and what to do otherwise.
_WITH_NORMALS = {
    ".xyzn": "leave them out with .xyz, or choose .ply, .pcd, .vtp or .csv, which allow missing normals",
    **dict.fromkeys((".obj", ".glb"), "choose .stl or .ply"),
}
_STL_ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def export(
    source: str | Path,
    to: str | Path,
    what: str | None = None,
    *,
    unit: str | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Write the cloud or the surface of a scan's folder, or of one of its PLY files, to a file of another format.

    what
        'cloud' or 'surface' where the ending of `to`, which determines the format, allows either (.ply, .vtp, .glb); the
        default is the surface, unless `source` is a cloud.
    unit
        of the lengths in the file, such as 'm' for ROS (REP 103); the recording's by default.  GLB is in metres.

    Returns what was written, as plain values.  Raises InputError for unknown endings and sources, for sources that cannot be
    written in the format, for units that it does not have, for missing normals that it needs, and if `to` is part of a scan's
    folder, the source itself, or, unless `overwrite` is true, a file that can't be recognised as an earlier export.
    """
    source, to = Path(source), Path(to)
    ending = to.suffix.lower()
    contents = _contents(ending, what)
    if ending == _METRES and unit not in (None, "m"):
        raise InputError(f"{ending} is in metres by its specification, and can't be in {unit}; leave the unit out")
    shape = _read(source, contents[0])
    if shape.what not in contents:
        raise InputError(
            f"{source.name} contains a {shape.what}, but a {contents[0]} is needed; a {shape.what} can be written as "
            f"{one_of(_ENDINGS[shape.what])}, and the folder of a scan has both"
        )
    return write_shape(shapes.in_unit(shape, unit), to, {"source": source}, contents, overwrite=overwrite)


def write_shape(
    shape: shapes.Shape,
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
    return written | {"left_out": left_out}


def _check_digits(shape: shapes.Shape, ending: str) -> None:
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


def _readable(shape: shapes.Shape, ending: str) -> shapes.Shape:
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
            f"{one_of(CLOUD_ENDINGS)}, a surface as {one_of(SURFACE_ENDINGS)}"
        )
    if what is None:
        return contents
    if what not in contents:
        raise InputError(f"{ending} cannot contain a {what}; a {what} can be written as {one_of(_ENDINGS[what])}")
    return [what]


def _read(source: Path, what: str) -> shapes.Shape:
    if not source.exists():
        raise InputError(f"there is no {source}; give the folder of a scan, or a PLY written by scan3d")
    if source.is_dir():
        name = f"{what}.ply"
        if not locate(source / name).is_file():
            raise InputError(
                f"there is no {name} in {source}; give a folder written by 'scan3d scan' or 'scan3d reconstruct'"
            )
        check_belongs(source, read_report(source), [name])
        return shapes.read_shape(locate(source / name))
    return shapes.read_shape(locate(source))


def _pcd(shape: shapes.Shape) -> bytes:
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


def _csv(shape: shapes.Shape) -> bytes:
    names = shape.rows.dtype.names or ()
    units = dict.fromkeys(shapes.POINT + shapes.LENGTHS, f"_{shape.unit}") | {"force": "_N"}
    header = ",".join(name + units.get(name, "") for name in names)
    return f"{header}\n".encode() + rows_as_text(_columns(shape, names), ",")


def _stl(shape: shapes.Shape) -> bytes:
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


def _obj(shape: shapes.Shape) -> bytes:
    assert shape.faces is not None
    remarks = "".join(f"# {line}\n" for line in shape.remarks).encode()
    corners = (map(str, column) for column in (shape.faces + 1).T)
    faces = (f"f {a}//{a} {b}//{b} {c}//{c}\n" for a, b, c in zip(*corners, strict=True))
    return b"".join(
        [
            remarks,
            rows_as_text(_columns(shape, shapes.POINT), " ", "v "),
            rows_as_text(_columns(shape, shapes.NORMAL), " ", "vn "),
            "".join(faces).encode(),
        ]
    )


def to_polydata(shape: shapes.Shape) -> Any:
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
    data.field_data["frame"] = [shapes.FRAME]
    return data


_WRITERS: dict[str, Callable[[shapes.Shape], bytes]] = {
    ".ply": lambda shape: shapes.ply(shape.rows, shape.faces, shape.remarks),
    ".pcd": _pcd,
    ".xyz": lambda shape: rows_as_text(_columns(shape, shapes.POINT), " "),
    ".xyzn": lambda shape: rows_as_text(_columns(shape, shapes.POINT + shapes.NORMAL), " "),
    ".csv": _csv,
    ".stl": _stl,
    ".obj": _obj,
    ".glb": glb,
}


def _columns(shape: shapes.Shape, names: Sequence[str]) -> list[NDArray[Any]]:
    return [shape.rows[name] for name in names]


def packed_points(shape: shapes.Shape) -> NDArray[np.void]:
    """The points (n,) as the Point Cloud Library packs them: float32, normals as normal_x …."""
    columns: dict[str, NDArray[Any]] = {name: shape.rows[name].astype("<f4") for name in shapes.POINT}
    columns |= {f"normal_{name[1:]}": shape.rows[name].astype("<f4") for name in shapes.NORMAL}
    columns |= shape.columns
    rows = np.empty(len(shape.rows), dtype=[(name, column.dtype.newbyteorder("<")) for name, column in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    return rows
