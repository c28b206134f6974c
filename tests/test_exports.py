"""Exported files: their contents, bit by bit where that is possible, what other programs read, and error messages."""

import functools
import json
import re
import struct
from pathlib import Path

import numpy as np
import other_programs
import pytest
import trimesh
from other_programs import FORMATS, HERE, PROGRAMS

from scan3d import InputError
from scan3d.cli import main
from scan3d.files.formats import CLOUD_ENDINGS, SURFACE_ENDINGS, export, write_shape
from scan3d.files.shapes import Shape, ply, read_ply, read_shape, surface_table

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A cloud and a surface in mm."""
    place = tmp_path_factory.mktemp("scan")
    other_programs.example(place)
    return place


@pytest.fixture(scope="module")
def cloud(folder):
    return read_shape(folder / "cloud.ply")


@pytest.fixture(scope="module")
def surface(folder):
    return read_shape(folder / "surface.ply")


def written(folder, to, what=None):
    export(folder, to, what)
    return to.read_bytes()


def with_rows(shape, path, unit="mm", **columns):
    """The shape's PLY with some columns replaced."""
    rows = shape.rows.copy()
    for name, values in columns.items():
        rows[name] = values
    path.write_bytes(ply(rows, shape.faces, (f"unit {unit}",)))
    return path


# --- other programs ---


@functools.cache
def documented():
    """{(program, what, ending): cell} of docs/files.md."""
    text = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
    lines = text.partition("## Which program reads what")[2].splitlines()
    head, _, *rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith("|")]
    cells_by_format = {}
    for name, *cells in rows:
        what, _, ending = name.split()
        cells_by_format |= {(program, what, ending): cell for program, cell in zip(head[1:], cells, strict=True)}
    return cells_by_format


@functools.cache
def understood(program, folder):
    return other_programs.understood(program, folder)


# pymeshlab is one of the development tools, the others come with the package itself
MARKED = [pytest.param(program, marks=pytest.mark.open3d if program == "Open3D" else ()) for program in HERE]


@pytest.mark.parametrize("program", MARKED)
@pytest.mark.slow
def test_the_table_says_what_a_program_reads(folder, program):
    table = {key: documented()[program, *key] for key in FORMATS}
    assert {key: other_programs.cell(key[0], right) for key, right in understood(program, folder).items()} == table


def test_the_table_is_complete():
    assert set(documented()) == {(program, *key) for program in PROGRAMS for key in FORMATS}
    assert {"Open3D", "trimesh", "pyvista", "numpy"} <= set(HERE)
    # the full contents of every format are read by at least one program
    for what, ending in FORMATS:
        longest = max((documented()[program, what, ending] for program in PROGRAMS), key=len)
        assert ("normals" in longest) == (ending not in (".xyz", ".stl"))
        assert ("faces" in longest) == (what == "surface")


# --- contents of the files ---


def test_a_ply_keeps_every_bit(folder, tmp_path, cloud, surface):
    for shape in (cloud, surface):
        export(folder, tmp_path / "a.ply", shape.what)
        rows, faces, comments = read_ply(tmp_path / "a.ply")
        assert rows.dtype.names == shape.rows.dtype.names
        assert rows.tobytes() == shape.rows.tobytes()
        assert (faces is None) if shape.faces is None else np.array_equal(faces, shape.faces)
        assert comments[:2] == (f"scan3d {shape.what}", "unit mm")
        assert comments[2].startswith("frame world coordinates")
        # the exported file can itself be exported
        export(tmp_path / "a.ply", tmp_path / "b.ply")
        assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()


def test_a_pcd_names_its_fields_and_contains_them(folder, tmp_path, cloud):
    head, _, body = written(folder, tmp_path / "a.pcd").partition(b"DATA binary\n")
    lines = head.decode().splitlines()
    header = dict(line.split(" ", 1) for line in lines if not line.startswith("#"))
    assert (
        header["FIELDS"]
        == "x y z normal_x normal_y normal_z quality phase slice sweep row force friction normal_source"
    )
    names = header["FIELDS"].split()
    for name, value in (("SIZE", "4"), ("TYPE", "F"), ("COUNT", "1")):
        assert header[name].split() == [value] * len(names)
    assert header["WIDTH"] == header["POINTS"] == str(len(cloud.rows))
    assert (header["VERSION"], header["HEIGHT"], header["VIEWPOINT"]) == ("0.7", "1", "0 0 0 1 0 0 0")
    assert "# unit mm" in lines
    assert any(line.startswith("# frame world") for line in lines)
    table = np.frombuffer(body, "<f4").reshape(-1, len(names))
    for k, name in enumerate(cloud.rows.dtype.names):
        assert np.array_equal(table[:, k], cloud.rows[name].astype("f4"))


def test_text_gives_the_same_bits_back(folder, tmp_path, cloud, surface):
    table = np.loadtxt(written(folder, tmp_path / "a.xyzn").decode().splitlines())
    assert np.array_equal(table[:, :3], cloud.points)
    assert np.array_equal(table[:, 3:].astype("f4"), cloud.normals)
    assert np.array_equal(np.loadtxt(written(folder, tmp_path / "a.xyz").decode().splitlines()), cloud.points)
    header, *lines = written(folder, tmp_path / "a.csv").decode().splitlines()
    assert header == "x_mm,y_mm,z_mm,nx,ny,nz,quality_mm,phase,slice,sweep,row,force_N,friction,normal_source"
    table = np.loadtxt(lines, delimiter=",")
    for k, name in enumerate(cloud.rows.dtype.names):
        assert np.array_equal(table[:, k].astype(cloud.rows.dtype[name]), cloud.rows[name])
    lines = written(folder, tmp_path / "a.obj").decode().splitlines()
    assert "# unit mm" in lines
    for start, values in (("v", surface.points), ("vn", surface.normals)):
        table = np.loadtxt([line[len(start) :] for line in lines if line.startswith(f"{start} ")])
        assert np.array_equal(table.astype(values.dtype), values)
    assert f"f {' '.join(f'{c}//{c}' for c in surface.faces[0] + 1)}" in lines


def test_an_stl_names_its_unit_and_faces_outwards(folder, tmp_path, surface):
    data = written(folder, tmp_path / "a.stl")
    assert len(data) == 84 + 50 * len(surface.faces)
    assert b"unit mm" in data[:80]
    assert not data.startswith(b"solid")  # which would be the start of a text file
    assert struct.unpack("<I", data[80:84]) == (len(surface.faces),)
    rows = np.frombuffer(data[84:], [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    assert np.array_equal(rows["corners"], surface.points[surface.faces].astype("f4"))
    assert np.allclose(np.linalg.norm(rows["normal"], axis=1), 1, atol=1e-6)
    centre = surface.points.mean(axis=0)
    assert ((rows["corners"].mean(axis=1) - centre) * rows["normal"]).sum(axis=1).min() > 0


def test_a_triangle_without_area_has_no_normal_in_an_stl(tmp_path, surface):
    faces = surface.faces.copy()
    faces[0] = faces[0, 0]
    (tmp_path / "surface.ply").write_bytes(ply(surface.rows, faces, ("unit mm",)))
    data = written(tmp_path, tmp_path / "a.stl")
    assert struct.unpack("<3f", data[84:96]) == (0, 0, 0)
    assert np.isfinite(np.frombuffer(data[84:], [("f", "<f4", 12), ("attribute", "<u2")])["f"]).all()


@pytest.mark.parametrize("ending", [".stl", ".glb", ".pcd", ".ply", ".obj", ".csv"])
def test_a_shape_is_not_written_where_float32_would_lose_it(tmp_path, ending):
    ball = trimesh.creation.icosphere(3, radius=12)
    rows = surface_table(ball, np.full(len(ball.vertices), 0.02))
    rows["x"] += 801234.0
    shape = Shape(rows, None if ending in (".pcd", ".csv") else ball.faces.astype(np.int32), "mm")
    if ending in (".stl", ".glb", ".pcd"):
        with pytest.raises(InputError, match=r"in float32, whose numbers are 62 µm apart at coordinates of 801246 mm"):
            write_shape(shape, tmp_path / f"far{ending}")
        rows["bound"] = 0.2  # more than the steps of float32
    write_shape(shape, tmp_path / f"far{ending}")


def glb(data):
    """The JSON of a GLB."""
    assert data[:4] == b"glTF"
    return json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("in", 0.0254), ("m", 1.0)])
def test_a_glb_is_in_metres_and_names_its_unit(tmp_path, surface, unit, metres):
    with_rows(surface, tmp_path / "surface.ply", unit)
    tree = glb(written(tmp_path, tmp_path / "a.glb"))
    extras = tree["asset"]["extras"]
    assert (extras["unit"], extras["unit_of_recording"]) == ("m", unit)
    assert extras["metres_per_unit_of_recording"] == metres
    assert "world" in extras["frame"]
    (primitive,) = tree["meshes"][0]["primitives"]
    assert set(primitive["attributes"]) == {"POSITION", "NORMAL", "_BOUND"}
    read = trimesh.load_mesh(tmp_path / "a.glb", process=False)
    assert np.allclose(read.vertices, surface.points[:, [0, 2, 1]] * metres * [1, 1, -1], rtol=1e-6)
    bound = read.vertex_attributes["_BOUND"].ravel()
    assert np.allclose(bound, surface.columns["bound"] * metres, rtol=1e-6)


def test_a_glb_leaves_out_scalars_that_are_infinite(tmp_path, surface):
    # the bound of a body without empty slices; JSON has no infinity
    with_rows(surface, tmp_path / "surface.ply", bound=np.inf)
    tree = glb(written(tmp_path, tmp_path / "a.glb"))
    assert set(tree["meshes"][0]["primitives"][0]["attributes"]) == {"POSITION", "NORMAL"}


def test_a_vtp_keeps_every_bit(folder, tmp_path, cloud, surface):
    import pyvista

    for shape in (cloud, surface):
        export(folder, tmp_path / "a.vtp", shape.what)
        read = pyvista.read(tmp_path / "a.vtp")
        assert read.points.dtype == np.float64
        assert np.array_equal(read.points, shape.points)
        assert np.array_equal(read.point_data.active_normals, shape.normals)
        for name, column in shape.columns.items():
            assert read.point_data[name].dtype == column.dtype
            assert np.array_equal(read.point_data[name], column)
        assert list(read.field_data["unit"]) == ["mm"]
        assert read.field_data["frame"][0].startswith("world coordinates")
        assert (read.n_verts, read.n_cells) == (
            (len(cloud.rows), len(cloud.rows)) if shape is cloud else (0, len(surface.faces))
        )


def test_unknown_values_stay_nan(tmp_path, cloud):
    import pyvista

    hole = np.arange(len(cloud.rows)) == 3
    gaps = {name: np.where(hole, np.nan, cloud.rows[name]) for name in ("nx", "ny", "nz", "friction", "quality")}
    with_rows(cloud, tmp_path / "cloud.ply", **gaps)
    read = pyvista.read(export(tmp_path, tmp_path / "a.vtp", "cloud")["file"])
    assert np.array_equal(np.isnan(read["Normals"]).all(axis=1), hole)
    assert np.array_equal(np.isnan(read["friction"]), hole)
    table = np.genfromtxt(written(tmp_path, tmp_path / "a.csv").decode().splitlines(), delimiter=",", names=True)
    assert np.array_equal(np.isnan(table["quality_mm"]), hole)
    body = written(tmp_path, tmp_path / "a.pcd").partition(b"DATA binary\n")[2]
    table = np.frombuffer(body, "<f4").reshape(-1, 14)
    assert np.array_equal(np.isnan(table), np.outer(hole, np.isin(np.arange(14), [3, 4, 5, 6, 12])))
    assert np.isfinite(np.loadtxt(written(tmp_path, tmp_path / "a.xyz").decode().splitlines())).all()


def test_the_same_shape_gives_the_same_file(folder, tmp_path):
    for what, ending in FORMATS:
        assert written(folder, tmp_path / f"a{ending}", what) == written(folder, tmp_path / f"b{ending}", what)


# --- what is exported ---


def test_the_ending_and_the_option_choose_what_is_exported(folder, tmp_path):
    for ending in {*CLOUD_ENDINGS, *SURFACE_ENDINGS}:
        expected = "surface" if ending in SURFACE_ENDINGS else "cloud"
        result = export(folder, tmp_path / "new" / f"a{ending.upper()}")
        assert (result["what"], result["unit"]) == (expected, "m" if ending == ".glb" else "mm")
        assert (result["faces"] > 0) == (expected == "surface")
    for ending in (".ply", ".vtp"):
        assert export(folder, tmp_path / f"a{ending}", "cloud")["what"] == "cloud"
        # a single file contains either a cloud or a surface
        assert export(folder / "cloud.ply", tmp_path / f"a{ending}")["what"] == "cloud"
        assert export(folder / "surface.ply", tmp_path / f"a{ending}")["what"] == "surface"


@pytest.mark.parametrize(
    ("source", "to", "what", "sentence"),
    [
        (
            ".",
            "a.step",
            None,
            r"can't export to files ending in '\.step': a cloud can be written as \.ply, \.pcd, .* or \.mcap, a surf",
        ),
        (".", "a.stl", "cloud", r"\.stl cannot contain a cloud; a cloud can be written as \.ply, \.pcd"),
        (".", "a.ply", "rods", "what to export must be one of surface, cloud, got 'rods'"),
        (
            "cloud.ply",
            "a.stl",
            None,
            r"cloud\.ply contains a cloud, but a surface is needed; a cloud can be written as \.ply",
        ),
        ("missing", "a.ply", None, r"there is no .*missing; give the folder of a scan, or a PLY written by scan3d"),
        ("text.ply", "a.ply", None, r"text\.ply is not a PLY file as scan3d writes it: it lacks the header"),
        ("bare.ply", "a.ply", None, r"bare\.ply is not a PLY file written by scan3d: its vertices lack nx, ny, nz"),
        (
            "furlong.ply",
            "a.ply",
            None,
            r"furlong\.ply is not a PLY file written by scan3d: .* with one of m, cm, mm, um, in",
        ),
        (
            "gap.ply",
            "a.xyzn",
            None,
            r"1 of 162 points have no normal, which \.xyzn requires; leave them out with \.xyz",
        ),
        (".", "text.ply/a.ply", None, r"can't write into the folder .*text\.ply: .*; choose another one with --to"),
        (".", "empty.ply", None, r"can't write .*empty\.ply: Is a directory; choose another place with --to"),
    ],
)
def test_mistakes(tmp_path, cloud, surface, capsys, source, to, what, sentence):
    with_rows(cloud, tmp_path / "cloud.ply")
    with_rows(surface, tmp_path / "surface.ply")
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty.ply").mkdir()
    (tmp_path / "text.ply").write_text("ply, as in plywood\n")
    (tmp_path / "bare.ply").write_bytes(ply(cloud.rows[["x", "y", "z"]], None, ("unit mm",)))
    (tmp_path / "unitless.ply").write_bytes(ply(cloud.rows))
    (tmp_path / "furlong.ply").write_bytes(ply(cloud.rows, None, ("unit furlong",)))
    some = np.arange(len(cloud.rows)) == 7
    with_rows(cloud, tmp_path / "gap.ply", nx=np.where(some, np.nan, cloud.rows["nx"]))
    zero = np.arange(len(surface.rows)) < 2
    with_rows(surface, tmp_path / "flat.ply", **{n: np.where(zero, 0, surface.rows[n]) for n in ("nx", "ny", "nz")})
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match=sentence):
        export(tmp_path / source, tmp_path / to, what)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    # the command has the same message, unless its parser rejects the arguments before
    if what != "rods":
        asked = ["export", str(tmp_path / source), "--to", str(tmp_path / to), *(["--what", what] if what else [])]
        assert main(asked) == 1
        stdout, stderr = capsys.readouterr()
        assert stdout == ""
        assert stderr.startswith("scan3d: ")
        assert stderr.count("\n") == 1


# --- the command ---


def test_the_command_exports_to_all_formats(folder, tmp_path, capsys):
    for what, ending in FORMATS:
        assert main(["export", str(folder), "--to", str(tmp_path / f"a{ending}"), "--what", what]) == 0
        stdout, stderr = capsys.readouterr()
        assert stderr == ""
        unit = "m" if ending == ".glb" else "mm"
        kind = r"\d+ contacts" if what == "cloud" else r"a surface of \d+ vertices and \d+ faces"
        assert re.fullmatch(rf"{kind} in {unit}, written to .*a{ending}\n", stdout)
    assert trimesh.load_mesh(tmp_path / "a.stl").is_watertight
    assert trimesh.load_mesh(tmp_path / "a.glb").extents.max() < 0.1
    assert main(["export", str(folder), "--to", str(tmp_path / "a.glb"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["unit"] == "m"
    assert main(["export", str(folder), "--to", str(tmp_path / "a.glb"), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
