"""Exported files: what other programs read of them, units, and what is refused."""

import functools
import json
import re
import shutil
import struct
from pathlib import Path

import numpy as np
import other_programs
import pytest
import trimesh
from other_programs import FORMATS, HERE, PROGRAMS
from scipy.io import loadmat

import scan3d
from scan3d import InputError
from scan3d.cli import main
from scan3d.files.reduced import decimated
from scan3d.files.shapes import (
    CLOUD_ENDINGS,
    FRAME,
    LENGTHS,
    SURFACE_ENDINGS,
    Shape,
    export,
    ply,
    read_ply,
    read_shape,
    surface_table,
    write_shape,
)

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
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
    rows = shape.rows.copy()
    for name, values in columns.items():
        rows[name] = values
    path.write_bytes(ply(rows, shape.faces, (f"unit {unit}",)))
    return path


@pytest.fixture
def gaps(folder, tmp_path, cloud):
    """The folder, in which four contacts have no normal and no friction."""
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    some = np.arange(len(cloud.rows)) < 4
    names = ("nx", "ny", "nz", "friction")
    with_rows(cloud, tmp_path / "cloud.ply", **{name: np.where(some, np.nan, cloud.rows[name]) for name in names})
    return tmp_path


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


def test_an_stl_names_its_unit_and_faces_outwards(folder, tmp_path, surface):
    data = written(folder, tmp_path / "a.stl")
    assert b"unit mm" in data[:80]
    assert not data.startswith(b"solid")  # which would be the start of a text file
    rows = np.frombuffer(data[84:], [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
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
    """Whatever its bound: normals are lost before places are."""
    ball = trimesh.creation.icosphere(3, radius=12)
    ball.vertex_attributes["bound"] = np.full(len(ball.vertices), 0.2)
    rows = surface_table(ball)
    rows["x"] += 801234.0
    shape = Shape(rows, None if ending in (".pcd", ".csv") else ball.faces.astype(np.int32), "mm")
    if ending in (".stl", ".glb", ".pcd"):
        with pytest.raises(InputError, match=r"in float32, whose numbers are 62 µm apart at coordinates of 801.246 m"):
            write_shape(shape, tmp_path / f"far{ending}")
        rows["x"] -= 801234.0
    write_shape(shape, tmp_path / f"far{ending}")


@pytest.mark.parametrize("ending", [".stl", ".glb"])
@pytest.mark.parametrize("far", [1e2, 3e3, 1e4, 3e4, 1e5, 1e6])
@pytest.mark.parametrize("name", ["ball", "box", "ring"])
def test_what_the_program_would_not_read_it_does_not_write(tmp_path, name, far, ending):
    """Against its own reader: what is written, at any distance from the origin, is read as the body that it was."""
    body = {
        "ball": trimesh.creation.icosphere(3, radius=12),
        "box": trimesh.creation.box((20, 24, 28)),
        "ring": trimesh.creation.torus(12, 4, major_sections=24, minor_sections=12),
    }[name]
    body.apply_translation([far, -far / 3, 0])
    shape = Shape(surface_table(body), body.faces.astype(np.int32), "mm")
    try:
        write_shape(shape, tmp_path / f"far{ending}")
    except InputError:
        assert far >= (1e5 if name == "ring" else 3e3)
        return
    back = scan3d.load_mesh(tmp_path / f"far{ending}")
    assert back.volume == pytest.approx(body.volume, rel=1e-3)
    assert far < 1e6


def test_a_glb_leaves_out_scalars_that_are_infinite(tmp_path, surface):
    # the bound of a body without empty slices; JSON has no infinity
    with_rows(surface, tmp_path / "surface.ply", bound=np.inf)
    export(tmp_path, tmp_path / "a.glb")
    assert set(tree_of(tmp_path / "a.glb")[2]) == {"POSITION", "NORMAL", "_KNOWN"}


def tree_of(path):
    data = path.read_bytes()
    length = struct.unpack("<I", data[12:16])[0]
    tree, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
    kinds, sizes = {5126: "<f4", 5125: "<u4", 5121: "u1"}, {"SCALAR": 1, "VEC3": 3, "VEC4": 4}

    def array(number):
        accessor = tree["accessors"][number]
        view, size = tree["bufferViews"][accessor["bufferView"]], sizes[accessor["type"]]
        values = np.frombuffer(binary, kinds[accessor["componentType"]], accessor["count"] * size, view["byteOffset"])
        return values.reshape(-1, size)

    (primitive,) = tree["meshes"][0]["primitives"]
    return tree, primitive, {name: array(number) for name, number in primitive["attributes"].items()}


@pytest.mark.parametrize("what", ["cloud", "surface"])
def test_matlab_has_every_column_in_full(gaps, tmp_path, what):
    """Against scipy's reader of MATLAB's format: every number is the same, to the last bit, and double."""
    shape, file = read_shape(gaps / f"{what}.ply"), tmp_path / "a.mat"
    export(gaps, file, what)
    read = loadmat(file)
    texts = {name: read.pop(name).item() for name in ("unit", "frame")}
    assert texts == {"unit": "mm", "frame": FRAME}
    own = {"points": shape.points, "normals": shape.normals}
    if what == "surface":
        own = {"vertices": shape.points, "normals": shape.normals, "faces": shape.faces + 1}  # MATLAB counts from 1
    columns = own | {name: column[:, None] for name, column in shape.columns.items()}
    assert {name for name in read if not name.startswith("__")} == set(columns)
    for name, column in columns.items():
        assert read[name].dtype == np.float64
        assert np.array_equal(read[name], column, equal_nan=True)


def test_a_mat_is_the_same_at_any_time(folder, tmp_path, monkeypatch):
    first = written(folder, tmp_path / "a.mat")
    monkeypatch.setattr("time.asctime", lambda: "Thu Jan  1 00:00:00 1970")
    assert written(folder, tmp_path / "b.mat") == first


@pytest.mark.parametrize("name", ["2nd", "größe", "a" * 64, "unit", "normals"])
def test_scalars_that_matlab_could_not_name_are_refused(tmp_path, cloud, name):
    names = [name if before == "quality" else before for before in cloud.rows.dtype.names]
    rows = cloud.rows.astype(list(zip(names, (cloud.rows.dtype[k] for k in range(len(names))), strict=True)))
    shape = Shape(rows, None, "mm")
    with pytest.raises(InputError, match=rf"the scalar '{name}' can't be in a \.mat: expected a name for MATLAB other"):
        write_shape(shape, tmp_path / "a.mat")
    assert not any(tmp_path.iterdir())


# --- PLY, by its own reader and by that of trimesh ---


def test_a_ply_is_read_as_it_was_written_by_its_own_reader_and_by_trimesh(tmp_path):
    rows = np.zeros(
        7, [(name, "f8") for name in "xyz"] + [(kind, kind) for kind in ("f4", "u1", "i4", "u4", "i1", "i2")]
    )
    for name in "xyz":
        rows[name] = np.random.default_rng(1).standard_normal(7) / 3
    rows["y"][0], rows["f4"][1] = 1e-300, np.nan
    rows["u1"], rows["i4"], rows["u4"], rows["i1"], rows["i2"] = 200, -5, 2**32 - 1, -100, -30000
    faces = np.array([[0, 1, 2], [2, 1, 3], [4, 5, 6]])
    for corners in (None, faces[:0], faces):
        (tmp_path / "a.ply").write_bytes(ply(rows, corners, ("unit mm", "end_header of a poem")))
        vertices, triangles, comments = read_ply(tmp_path / "a.ply")
        assert vertices.dtype == rows.dtype
        assert vertices.tobytes() == rows.tobytes()
        assert (triangles is None) if corners is None else np.array_equal(triangles, corners)
        assert comments == ("unit mm", "end_header of a poem")
    (tmp_path / "a.ply").write_bytes(ply(rows, faces))
    mesh = trimesh.load_mesh(tmp_path / "a.ply", process=False)
    assert np.array_equal(mesh.faces, faces)
    data = mesh.metadata["_ply_raw"]["vertex"]["data"]
    assert all(np.array_equal(data[name].reshape(-1), rows[name], equal_nan=True) for name in rows.dtype.names)


def test_a_ply_that_can_not_be_read(tmp_path):
    for path, why in ((tmp_path / "missing.ply", "No such file"), (tmp_path, "Is a directory")):
        with pytest.raises(InputError, match=rf"can't read .*: {why}.*; give a PLY written by scan3d"):
            read_ply(path)


# --- units ---


@pytest.mark.parametrize("what", ["cloud", "surface"])
@pytest.mark.parametrize(("unit", "factor"), [("m", 1e-3), ("in", 1 / 25.4)])
def test_lengths_are_converted_and_nothing_else(gaps, tmp_path, what, unit, factor):
    before = read_shape(gaps / f"{what}.ply")
    assert export(gaps, tmp_path / "a.ply", what, unit=unit)["unit"] == unit
    after = read_shape(tmp_path / "a.ply")
    assert after.unit == unit
    assert after.points == pytest.approx(factor * before.points, rel=1e-15)
    for name, column in before.columns.items():
        scale = factor ** LENGTHS.get(name, 0)
        assert np.allclose(after.columns[name], scale * column, rtol=1e-6, atol=0, equal_nan=True)
    assert np.array_equal(after.normals, before.normals, equal_nan=True)


# --- GLB ---


def test_a_cloud_in_glb_counts_the_points_that_it_leaves_out(gaps, tmp_path):
    cloud = read_shape(gaps / "cloud.ply")
    kept = np.isfinite(cloud.normals).all(axis=1)
    result = export(gaps, tmp_path / "a.glb", "cloud")
    assert (result["points"], result["left_out"], result["unit"]) == (kept.sum(), 4, "m")
    tree, primitive, arrays = tree_of(tmp_path / "a.glb")
    assert (primitive["mode"], tree["materials"][0]["name"]) == (0, "scan3d cloud")
    assert np.allclose(arrays["_QUALITY"][:, 0], 1e-3 * cloud.columns["quality"][kept], rtol=1e-6)
    assert "_FRICTION" in arrays  # known wherever there is a normal


def test_a_surface_in_glb_has_a_material_and_comes_back(gaps, tmp_path):
    export(gaps, tmp_path / "a.glb")
    tree, primitive, arrays = tree_of(tmp_path / "a.glb")
    assert (primitive["mode"], tree["materials"][primitive["material"]]["name"]) == (4, "scan3d surface")
    extremes, places = tree["accessors"][primitive["attributes"]["POSITION"]], arrays["POSITION"]
    assert [extremes["min"], extremes["max"]] == [places.min(axis=0).tolist(), places.max(axis=0).tolist()]
    # scan3d turns its own files back
    points = read_shape(gaps / "surface.ply").points
    back = scan3d.load_mesh(tmp_path / "a.glb", hull=True)
    assert back.bounds == pytest.approx(np.stack([points.min(axis=0), points.max(axis=0)]), rel=1e-6)


# --- what is exported ---


def test_the_ending_and_the_option_choose_what_is_exported(folder, tmp_path):
    for ending in {*CLOUD_ENDINGS[:-1], *SURFACE_ENDINGS}:
        expected = "surface" if ending in SURFACE_ENDINGS else "cloud"
        result = export(folder, tmp_path / "new" / f"a{ending.upper()}")
        assert (result["what"], result["unit"]) == (expected, "m" if ending == ".glb" else "mm")
        assert (result["faces"] > 0) == (expected == "surface")
    for ending in (".ply", ".vtp", ".mat"):
        assert export(folder, tmp_path / f"a{ending}", "cloud")["what"] == "cloud"
        # a single file contains either a cloud or a surface
        assert export(folder / "cloud.ply", tmp_path / f"a{ending}")["what"] == "cloud"
        assert export(folder / "surface.ply", tmp_path / f"a{ending}")["what"] == "surface"


@pytest.mark.parametrize(
    ("source", "to", "options", "sentence"),
    [
        (".", "a.step", {}, r"can't export to files ending in '\.step': a cloud can be written as \.ply, \.pcd, "),
        (".", "a.stl", {"what": "cloud"}, r"\.stl cannot contain a cloud; a cloud can be written as \.ply, \.pcd"),
        ("cloud.ply", "a.stl", {}, r"cloud\.ply contains a cloud, but a surface is needed; a cloud can be written as"),
        ("missing", "a.ply", {}, r"there is no .*missing; give the folder of a scan, or a PLY written by scan3d"),
        ("bare.ply", "a.ply", {}, r"bare\.ply is not a PLY file written by scan3d: its vertices lack nx, ny, nz"),
        ("cloud.ply", "a.xyzn", {}, r"4 of 162 points have no normal, which \.xyzn requires; leave them out"),
        (".", "a.glb", {"unit": "mm"}, r"\.glb is in metres by its specification, and can't be in mm; leave"),
    ],
)
def test_mistakes(gaps, cloud, call, source, to, options, sentence):
    (gaps / "bare.ply").write_bytes(ply(cloud.rows[["x", "y", "z"]], None, ("unit mm",)))
    before = {path: path.read_bytes() for path in gaps.rglob("*") if path.is_file()}
    given = [part for name, value in options.items() for part in (f"--{name.replace('_', '-')}", value)]
    code, stdout, stderr = call("export", gaps / source, "--to", gaps / to, *given)
    assert (code, stdout) == (2 if to == "a.step" else 1, "")
    assert re.fullmatch(rf"scan3d: .*{sentence}.*\n", stderr), stderr
    assert {path: path.read_bytes() for path in gaps.rglob("*") if path.is_file()} == before


# --- the command ---


def test_the_command_says_what_it_wrote_and_passes_its_options_on(gaps, capsys):
    for what, said in (
        ("cloud", "158 contacts (4 without a normal are left out)"),
        ("surface", "a surface of 162 vert"),
    ):
        assert main(["export", str(gaps), "--to", str(gaps / "a.glb"), "--what", what]) == 0
        stdout, stderr = capsys.readouterr()
        assert stdout.startswith(said)
        assert stdout.endswith(f" in m, written to {gaps / 'a.glb'}\n")
        assert stderr == ""
    call = ["export", str(gaps), "--to", str(gaps / "a.ply"), "--unit", "m"]
    assert main([*call, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["unit"] == "m"
    rows, _, comments = read_ply(gaps / "a.ply")
    assert "bound" in rows.dtype.names
    assert "unit m" in comments
    assert main([*call, "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


# --- less of a surface ---


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    """The folder of a torus about z = 4, of radii 12 and 4 mm, as a scan's surface."""
    place, body = tmp_path_factory.mktemp("ring"), trimesh.creation.torus(12, 4, major_sections=64, minor_sections=36)
    body.apply_translation([0, 0, 4])
    body.vertex_attributes["known"] = np.arange(len(body.vertices)) % 3
    body.vertex_attributes["bound"] = np.linspace(0.1, 0.2, len(body.vertices))
    (place / "surface.ply").write_bytes(ply(surface_table(body), body.faces, ("unit mm",)))
    return place


def test_meshlab_has_the_bound_as_the_quality_of_a_surface(ring, tmp_path):
    export(ring, tmp_path / "a.ply")
    assert np.array_equal(
        read_shape(tmp_path / "a.ply").columns["quality"], read_shape(ring / "surface.ply").columns["bound"]
    )


@pytest.mark.slow
@pytest.mark.parametrize("far", [{"faces": 1000}, {"error": 0.03, "unit": "cm"}])
def test_a_surface_is_left_fewer_faces_or_as_few_as_an_error_allows(ring, tmp_path, call, far):
    options = [word for name, value in far.items() for word in (f"--{name}", value)]
    assert call("export", ring, "--to", tmp_path / "a.ply", *options)[0] == 0
    before, after = (read_shape(path) for path in (ring / "surface.ply", tmp_path / "a.ply"))
    mesh = trimesh.Trimesh(after.points, after.faces, process=False)
    assert mesh.is_watertight
    assert mesh.euler_number == 0
    assert 100 < len(after.faces) <= far.get("faces", len(before.faces) // 2)
    # vertices of before, with what was known there
    scale = 0.1 if "unit" in far else 1.0
    place = {tuple(point): k for k, point in enumerate(np.round(scale * before.points, 9).tolist())}
    rows = [place[tuple(point)] for point in np.round(after.points, 9).tolist()]
    assert np.array_equal(after.columns["known"], before.columns["known"][rows])
    # the bounds have grown by as much as the surface has moved
    apart = scan3d.compare(mesh, trimesh.Trimesh(scale * before.points, before.faces, process=False)).hausdorff
    assert after.columns["bound"] - scale * before.columns["bound"][rows] == pytest.approx(apart, rel=1e-3)
    assert apart <= far.get("error", np.inf)


@pytest.mark.slow
def test_larger_errors_leave_no_more_faces():
    body = trimesh.creation.torus(12, 4, major_sections=32, minor_sections=16)
    surface = Shape(surface_table(body), body.faces.astype(np.int32), "mm")
    with pytest.raises(InputError, match=r"no closed form of 4 faces, and the coarsest that was found has \d+;"):
        decimated(surface, faces=4)
    counts = [len(decimated(surface, error=error).faces) for error in (0.3, 1.0, 10.0, 1e9)]
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] < counts[0] < len(surface.faces)


@pytest.mark.parametrize(("plane", "radii"), [("z=4", (8, 16)), ("z=6", (12 - 12**0.5, 12 + 12**0.5)), ("x=0", (4, 4))])
def test_a_section_has_every_curve_of_the_plane(ring, tmp_path, call, plane, radii):
    for ending in ("csv", "dxf"):
        assert call("export", ring, "--to", tmp_path / f"a.{ending}", "--section", plane)[0] == 0
    rows = np.genfromtxt(tmp_path / "a.csv", delimiter=",", names=True)
    points = np.stack([rows[name] for name in ("x_mm", "y_mm", "z_mm")], axis=1)
    axis = "xyz".index(plane[0])
    assert points[:, axis] == pytest.approx(float(plane[2:]), abs=1e-9)
    curves = [points[rows["curve"] == k] for k in np.unique(rows["curve"])]
    centres = np.array([curve.mean(axis=0) if axis == 0 else [0, 0, float(plane[2:])] for curve in curves])
    found = sorted(np.linalg.norm(curve - centre, axis=1).mean() for curve, centre in zip(curves, centres, strict=True))
    assert found == pytest.approx(sorted(radii), abs=0.03)
    # the pairs of code and value that DXF consists of: the same curves, closed
    lines = (tmp_path / "a.dxf").read_text().splitlines()
    pairs = list(zip(map(int, lines[::2]), lines[1::2], strict=True))
    assert pairs.count((0, "POLYLINE")) == pairs.count((0, "SEQEND")) == len(curves)
    vertices = [k for k, pair in enumerate(pairs) if pair == (0, "VERTEX")]
    assert [[float(value) for _, value in pairs[k + 2 : k + 5]] for k in vertices] == points.tolist()
    assert pairs[-1] == (0, "EOF")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--to", "a.dxf", "--section", "w=3"], "a section is an axis and a height in mm, such as z=12.5; got 'w=3'"),
        (["--to", "a.dxf", "--section", "z=1.2.3"], "such as z=12.5"),
        (["--to", "a.dxf", "--section", "z=99"], "the plane z=99 misses the surface, which is from 0 to 8"),
        (["--to", "a.stl", "--section", "z=4"], "a section is written as .dxf or .csv"),
        (["--to", "a.stl", "--section", "z=4", "--faces", "9"], "--section is of the whole surface"),
        (["--to", "a.stl", "--faces", "9", "--error", "1"], "leave one of them out"),
        (["--to", "a.stl", "--faces", "3"], "at least 4 faces"),
    ],
)
def test_what_is_no_part_of_a_surface_is_refused(ring, tmp_path, call, monkeypatch, options, sentence):
    monkeypatch.chdir(tmp_path)
    code, _, stderr = call("export", ring, *options)
    assert code > 0
    assert sentence in stderr
    assert not list(tmp_path.iterdir())
