"""Less of a surface: one with fewer triangles, and cross-sections as curves, for programs that draw and mill.

manifold3d does both: it leaves a surface closed, and what remains of its vertices are vertices of before; their bounds
grow by how far the coarser surface is from the whole one.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import Array
from scan3d.choices import one_of
from scan3d.comparison import compare, one_sided_distances, prepare
from scan3d.errors import InputError, UsageError
from scan3d.files.shapes import Shape, in_unit, read_part
from scan3d.files.text import rows_as_text
from scan3d.files.whole import atomic, check_file, folder
from scan3d.geometry.sections import slice_frame
from scan3d.units import lengths

CURVES = (".dxf", ".csv")
"""The formats of cross-sections."""
# Numbers of units of length in DXF, `$INSUNITS`.
_IN_DXF = {"in": 1, "mm": 4, "cm": 5, "m": 6, "um": 13}


def decimated(shape: Shape, faces: int | None = None, error: float | None = None) -> Shape:
    """The surface with at most so many faces, or with as few as a distance of `error`, in its unit, from it allows.

    Raises InputError for clouds, for surfaces that are not closed, and for numbers of faces that are not reached.
    """
    if shape.faces is None:
        raise InputError("only a surface has faces to be left out, and this is a cloud; leave --faces and --error out")
    if (faces is not None and faces < 4) or (error is not None and not 0 < error < np.inf):
        raise UsageError("a surface is left at least 4 faces, and the error is a length above 0; give others")
    solid = _solid(shape.points, shape.faces)
    size, enough, left = float(np.linalg.norm(np.ptp(shape.points, axis=0))), None, [solid]
    low, high = 0.0, 0.0
    # a tolerance moves the surface by little less
    least = error / 8 if error else size / 2**20

    def goes_on(tolerance: float) -> bool:
        """Whether a larger tolerance may leave fewer faces, and is wanted; what this one leaves is kept."""
        nonlocal enough
        coarser = solid.simplify(tolerance)
        if coarser.num_tri() <= 0 or (error is not None and _apart(shape, coarser.to_mesh64()) > error):
            return False
        if faces is not None and coarser.num_tri() <= faces:
            enough = coarser
            return False
        left.append(coarser)
        return True

    # larger tolerances do not always leave fewer faces
    for high in least * 2.0 ** np.arange(21):
        if not goes_on(high):
            break
        low = high
    for _ in range(8 if low else 0):
        middle = np.sqrt(low * high)
        if goes_on(middle):
            low = middle
        else:
            high = middle
    fewest = sorted(left, key=lambda one: one.num_tri())
    found = enough or next(
        one for one in fewest if error is None or one is solid or _apart(shape, one.to_mesh64(), error) <= error
    )
    mesh = found.to_mesh64()
    if not len(mesh.tri_verts) or len(mesh.tri_verts) > (faces or len(shape.faces)):
        raise InputError(
            f"the surface has no closed form of {faces} faces, and the coarsest that was found has {found.num_tri()}; ask for "
            "as many or more"
        )
    rows = shape.rows[cKDTree(shape.points).query(mesh.vert_properties[:, :3])[1]]
    import trimesh

    meshes = ((shape.points, shape.faces), (mesh.vert_properties[:, :3], mesh.tri_verts.astype(np.int64)))
    off = compare(*(trimesh.Trimesh(*one, process=False) for one in meshes)).hausdorff
    if "bound" in (shape.rows.dtype.names or ()):
        rows["bound"] += off  # between its vertices the surface is elsewhere than the whole one
    return replace(shape, rows=rows, faces=mesh.tri_verts.astype(np.int32), off=off)


def cross_section(shape: Shape, plane: str) -> list[Array]:
    """The closed curves (m, 3) in which a plane such as ``z=12.5``, in the surface's unit, cuts it, those of holes included.

    Raises InputError for other texts, for clouds, and for planes that miss the surface.
    """
    found = re.fullmatch(r"([xyz]) *= *(-?[0-9.]+(?:e-?[0-9]+)?)", plane)
    try:
        name, height = ("", 0.0) if found is None else (found[1], float(found[2]))
    except ValueError:
        name = ""
    if not name:
        raise UsageError(f"a section is an axis and a height in {shape.unit}, such as z=12.5; got {plane!r}")
    if shape.faces is None:
        raise InputError("only a surface has cross-sections, and this is a cloud; give the folder of a scan")
    frame = slice_frame(np.eye(3)["xyz".index(name)])
    loops = _solid(shape.points @ frame.T, shape.faces).slice(height).to_polygons()
    if not loops:
        (low, high), unit = lengths([end(shape.rows[name]) for end in (np.min, np.max)], shape.unit)
        raise InputError(f"the plane {plane} misses the surface, which is from {low} to {high} {unit}")
    return [np.column_stack([loop, np.full(len(loop), height)]) @ frame for loop in loops]


def export_section(
    source: Path, to: Path, plane: str, *, unit: str | None = None, overwrite: bool = False
) -> dict[str, Any]:
    """Write a cross-section of a scan's surface to a .dxf or .csv: what was written, as plain values.

    Raises InputError as `cross_section` and `files.shapes.export`.
    """
    ending = to.suffix.lower()
    if ending not in CURVES:
        raise InputError(f"a section is written as {one_of(CURVES)}, got {to.name!r}; choose one of them")
    shape = in_unit(read_part(source, "surface"), unit)
    loops = cross_section(shape, plane)
    data = curves_file(loops, shape.unit, ending)
    check_file(to, {"source": source}, overwrite, "--to", data)
    with folder(to.parent, option="--to"), atomic(to, option="--to") as file:
        file.write_bytes(data)
    points = sum(map(len, loops))
    return {"file": str(to), "what": "section", "curves": len(loops), "points": points, "unit": shape.unit}


def curves_file(loops: list[Array], unit: str, ending: str) -> bytes:
    """Closed curves (m, 3) as CSV, or as three-dimensional polylines of DXF."""
    if ending == ".csv":
        rows = [np.repeat(np.arange(len(loops)), [len(loop) for loop in loops]), *np.concatenate(loops).T]
        return f"curve,x_{unit},y_{unit},z_{unit}\n".encode() + rows_as_text(rows, ",")
    pairs: list[tuple[int, Any]] = [(999, f"scan3d section, unit {unit}"), (0, "SECTION"), (2, "HEADER")]
    pairs += [(9, "$INSUNITS"), (70, _IN_DXF[unit]), (0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES")]
    for loop in loops:
        pairs += [(0, "POLYLINE"), (8, 0), (66, 1), (10, 0.0), (20, 0.0), (30, 0.0), (70, 9)]  # closed, in space
        for x, y, z in loop.tolist():
            pairs += [(0, "VERTEX"), (8, 0), (10, x), (20, y), (30, z), (70, 32)]
        pairs.append((0, "SEQEND"))
    pairs += [(0, "ENDSEC"), (0, "EOF")]
    return "".join(f"{code}\n{value}\n" for code, value in pairs).encode()


def _apart(shape: Shape, mesh: Any, beyond: float = np.inf) -> float:
    """How far vertices and middles of the faces of a surface and of a coarser one are from each other, at most; and also other
    places on them, if any is farther away than `beyond`."""
    import trimesh

    assert shape.faces is not None
    if not len(mesh.tri_verts):
        return np.inf
    middle, size = shape.points.mean(axis=0), float(np.linalg.norm(np.ptp(shape.points, axis=0)))
    meshes = (shape.points, shape.faces), (mesh.vert_properties[:, :3], mesh.tri_verts.astype(np.int64))
    fine, coarse = (prepare(trimesh.Trimesh(*one, process=False), middle, size) for one in meshes)
    sides = (fine, coarse), (coarse, fine)
    places = (np.concatenate([one.vertices, one.corners.mean(axis=1)]) for one, _ in sides)
    seen = max(float(other.search.nearest(some)[0].max()) for some, (_, other) in zip(places, sides, strict=True))
    left = beyond / size - seen
    if 0 < left < np.inf:
        seen = max(seen, *(side.lower for side in one_sided_distances(sides, False, left)))
    return seen * size


def _solid(points: Array, faces: Any) -> Any:
    from manifold3d import Error, Manifold, Mesh64

    solid = Manifold(Mesh64(vert_properties=points, tri_verts=faces.astype(np.uint64)))
    if solid.status() != Error.NoError:
        raise InputError(
            "the surface is not closed, so that it can be neither thinned out nor cut; scan the body again"
        )
    return solid
