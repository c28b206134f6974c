"""Exports as other programs want them: units, colours, names of scalars, GLB of clouds, bags of ROS, and closed surfaces."""

import json
import struct
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import matplotlib
import numpy as np
import other_programs
import pytest
import trimesh

import scan3d
from scan3d import InputError
from scan3d.cli import main
from scan3d.files.formats import POINT_ENDINGS, SURFACE_ENDINGS, export
from scan3d.files.shapes import ply, read_ply, read_shape, surface_table

ROOT = Path(__file__).parents[1]
MESHES = sorted(path for path in (ROOT / "meshes").iterdir() if path.suffix in {".stl", ".ply", ".obj", ".off", ".glb"})


@pytest.fixture
def folder(tmp_path):
    """A cloud and a surface in mm; four contacts have no normal and no friction."""
    other_programs.example(tmp_path)
    cloud = read_shape(tmp_path / "cloud.ply")
    rows = cloud.rows.copy()
    rows["friction"][:4] = np.nan
    for name in ("nx", "ny", "nz"):
        rows[name][:4] = np.nan
    (tmp_path / "cloud.ply").write_bytes(ply(rows, None, ("unit mm",)))
    return tmp_path


def tree_of(path):
    """The JSON of a GLB, and its accessors as arrays."""
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


# --- units ---


@pytest.mark.parametrize("what", ["cloud", "surface"])
@pytest.mark.parametrize(("unit", "factor"), [("m", 1e-3), ("in", 1 / 25.4)])
def test_lengths_are_converted_and_nothing_else(folder, tmp_path, what, unit, factor):
    before = read_shape(folder / f"{what}.ply")
    assert export(folder, tmp_path / "a.ply", what, unit=unit)["unit"] == unit
    after = read_shape(tmp_path / "a.ply")
    assert after.unit == unit
    assert after.points == pytest.approx(factor * before.points, rel=1e-15)
    for name, column in before.columns.items():
        scale = factor if name in ("quality", "bound") else 1.0
        assert np.allclose(after.columns[name], scale * column, rtol=1e-6, atol=0, equal_nan=True)
    assert np.array_equal(after.normals, before.normals, equal_nan=True)
    # the unit asked for is the recording's: nothing changes
    export(folder, tmp_path / "b.ply", what, unit="mm")
    export(folder, tmp_path / "c.ply", what)
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "c.ply").read_bytes()


# --- colours ---


def colors_in(path):
    """(n, 3) the colours in an exported file, by readers of the tests' own."""
    data, ending = path.read_bytes(), path.suffix
    if ending == ".ply":
        rows = read_ply(path)[0]
        return np.stack([rows[name] for name in ("red", "green", "blue")], axis=1)
    if ending == ".csv":
        rows = np.genfromtxt(data.decode().splitlines(), delimiter=",", names=True)
        return np.stack([rows[name] for name in ("red", "green", "blue")], axis=1)
    if ending == ".pcd":
        head, _, body = data.partition(b"DATA binary\n")
        fields = next(line.split()[1:] for line in head.decode().splitlines() if line.startswith("FIELDS"))
        packed = np.frombuffer(body, "<u4").reshape(-1, len(fields))[:, fields.index("rgb")]
        return np.stack([packed >> 16 & 255, packed >> 8 & 255, packed & 255], axis=1)
    if ending == ".obj":
        lines = [line[2:] for line in data.decode().splitlines() if line.startswith("v ")]
        return np.round(255 * np.loadtxt(lines)[:, 3:])
    if ending == ".vtp":
        import pyvista

        return pyvista.read(path)["RGB"]
    return tree_of(path)[2]["COLOR_0"][:, :3]


@pytest.mark.parametrize(
    ("what", "scalar", "ending"),
    [
        *(("cloud", "friction", ending) for ending in (".ply", ".pcd", ".vtp", ".csv")),
        *(("cloud", "force", ending) for ending in (".ply", ".glb")),
        *(("surface", "bound", ending) for ending in (".ply", ".obj", ".glb", ".vtp")),
    ],
)
def test_colours_are_those_of_the_scalar_beside_them(folder, tmp_path, what, scalar, ending):
    export(folder, tmp_path / f"a{ending}", what, color=scalar)
    shape = read_shape(folder / f"{what}.ply")
    values = shape.columns[scalar].astype(float)
    if ending == ".glb":
        values = values[np.isfinite(shape.normals).all(axis=1)]
    known = np.isfinite(values)
    # forces and lengths begin at zero, others at their smallest value
    low = 0.0 if scalar in ("force", "bound") else values[known].min()
    expected = np.full((len(values), 3), 154.0)
    fraction = (values[known] - low) / (values[known].max() - low)
    expected[known] = np.round(255 * matplotlib.colormaps["viridis"](fraction)[:, :3])
    assert np.array_equal(colors_in(tmp_path / f"a{ending}"), expected)
    if ending == ".ply":
        rows, _, comments = read_ply(tmp_path / "a.ply")
        assert np.array_equal(rows[scalar], shape.rows[scalar], equal_nan=True)
        assert f"colour {scalar} from {low:.6g} to {values[known].max():.6g}, viridis" in comments
        assert scalar in read_shape(tmp_path / "a.ply").columns
        assert "red" not in read_shape(tmp_path / "a.ply").columns


# --- GLB ---


def test_a_cloud_in_glb_counts_the_points_that_it_leaves_out(folder, tmp_path, capsys):
    cloud = read_shape(folder / "cloud.ply")
    kept = np.isfinite(cloud.normals).all(axis=1)
    result = export(folder, tmp_path / "a.glb", "cloud")
    assert (result["points"], result["left_out"], result["unit"]) == (kept.sum(), 4, "m")
    tree, primitive, arrays = tree_of(tmp_path / "a.glb")
    assert primitive["mode"] == 0
    x, y, z = 1e-3 * cloud.points[kept].T
    assert np.allclose(arrays["POSITION"], np.stack([x, z, -y], axis=1), rtol=1e-6)
    nx, ny, nz = cloud.normals[kept].T
    assert np.allclose(arrays["NORMAL"], np.stack([nx, nz, -ny], axis=1), atol=1e-6)
    assert np.allclose(arrays["_QUALITY"][:, 0], 1e-3 * cloud.columns["quality"][kept], rtol=1e-6)
    assert "_FRICTION" in arrays  # known wherever there is a normal
    assert tree["materials"][0]["name"] == "scan3d cloud"
    assert main(["export", str(folder), "--to", str(tmp_path / "b.glb"), "--what", "cloud"]) == 0
    assert "158 contacts (4 without a normal are left out) in m, written to" in capsys.readouterr().out


def test_a_cloud_without_any_normal_keeps_all_its_points(folder, tmp_path):
    cloud = read_shape(folder / "cloud.ply")
    rows = cloud.rows.copy()
    for name in ("nx", "ny", "nz"):
        rows[name] = np.nan
    (tmp_path / "bare.ply").write_bytes(ply(rows, None, ("unit mm",)))
    result = export(tmp_path / "bare.ply", tmp_path / "a.glb")
    assert (result["points"], result["left_out"]) == (len(rows), 0)
    _, _, arrays = tree_of(tmp_path / "a.glb")
    assert len(arrays["POSITION"]) == len(rows)
    assert "NORMAL" not in arrays
    assert "_FRICTION" not in arrays  # glTF has no NaN


def test_a_surface_in_glb_has_y_up_a_material_and_comes_back(folder, tmp_path):
    export(folder, tmp_path / "a.glb")
    tree, primitive, arrays = tree_of(tmp_path / "a.glb")
    assert (primitive["mode"], tree["materials"][primitive["material"]]["name"]) == (4, "scan3d surface")
    surface = read_shape(folder / "surface.ply")
    # the height of the world is the y axis of the file
    assert np.allclose(arrays["POSITION"][:, 1], 1e-3 * surface.points[:, 2], rtol=1e-6)
    assert np.allclose(np.linalg.norm(arrays["NORMAL"], axis=1), 1, atol=1e-6)
    extremes = tree["accessors"][primitive["attributes"]["POSITION"]]
    assert extremes["min"] == arrays["POSITION"].min(axis=0).tolist()
    assert extremes["max"] == arrays["POSITION"].max(axis=0).tolist()
    # scan3d turns its own files back
    back = scan3d.load_mesh(tmp_path / "a.glb", hull=True)
    assert back.bounds == pytest.approx(np.stack([surface.points.min(axis=0), surface.points.max(axis=0)]), rel=1e-6)
    # but not those of others, whose axes it does not know
    trimesh.creation.box((1, 2, 3)).export(tmp_path / "box.glb")
    assert scan3d.load_mesh(tmp_path / "box.glb").extents == pytest.approx([1000, 2000, 3000])


# --- ROS ---


def test_a_bag_of_ros_has_the_cloud_in_metres(folder, tmp_path):
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    result = export(folder, tmp_path / "a.mcap", color="force")
    assert (result["what"], result["unit"]) == ("cloud", "m")
    with AnyReader([tmp_path / "a.mcap"], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        ((connection, stamp, raw),) = reader.messages()
        message = reader.deserialize(raw, connection.msgtype)
    assert (connection.topic, connection.msgtype, stamp) == ("/scan3d/contacts", "sensor_msgs/msg/PointCloud2", 0)
    assert (message.header.frame_id, message.height, message.is_bigendian) == ("world", 1, False)
    kinds = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}
    layout = {
        "names": [field.name for field in message.fields],
        "formats": [kinds[field.datatype] for field in message.fields],
        "offsets": [field.offset for field in message.fields],
        "itemsize": message.point_step,
    }
    rows = np.frombuffer(message.data.tobytes(), np.dtype(layout))
    cloud = read_shape(folder / "cloud.ply")
    assert len(rows) == message.width == len(cloud.rows)
    assert message.row_step == message.width * message.point_step
    points = np.stack([rows[name] for name in "xyz"], axis=1)
    assert points.dtype == np.float32
    assert points == pytest.approx(1e-3 * cloud.points, rel=1e-6)
    assert np.array_equal(rows["normal_z"], cloud.rows["nz"], equal_nan=True)
    assert rows["quality"] == pytest.approx(1e-3 * cloud.columns["quality"])
    assert np.array_equal(rows["force"], cloud.columns["force"])
    assert np.array_equal(rows["sweep"], cloud.columns["sweep"])
    packed = rows["rgb"].copy().view("<u4")
    export(folder, tmp_path / "a.ply", "cloud", color="force")
    assert np.array_equal(packed >> 16 & 255, read_ply(tmp_path / "a.ply")[0]["red"])
    # the same cloud gives the same bytes; an earlier export is recognised, and replaced
    before = (tmp_path / "a.mcap").read_bytes()
    export(folder, tmp_path / "a.mcap", color="force")
    assert (tmp_path / "a.mcap").read_bytes() == before
    export(folder, tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_bytes() != before


def test_a_bag_needs_rosbags(folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(
        InputError, match=r"a bag of ROS 2 needs rosbags: pip install 'scan3d\[ros\]'; or export the cloud as"
    ):
        export(folder, tmp_path / "a.mcap")
    assert not (tmp_path / "a.mcap").exists()


# --- names ---


def test_names_of_scalars_that_cloudcompare_recognises(folder, tmp_path):
    export(folder, tmp_path / "a.ply", "cloud", color="force", scalar_names="cloudcompare")
    rows, _, _ = read_ply(tmp_path / "a.ply")
    spatial = ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"]
    cloud = read_shape(folder / "cloud.ply")
    assert list(rows.dtype.names) == [*spatial, *(f"scalar_{name}" for name in cloud.columns)]
    assert np.array_equal(rows["scalar_force"], cloud.rows["force"])


@pytest.mark.parametrize(
    ("what", "color", "shown"), [("cloud", None, "force"), ("surface", None, "bound"), ("cloud", "sweep", "sweep")]
)
def test_meshlab_shows_the_scalar(folder, tmp_path, what, color, shown):
    export(folder, tmp_path / "a.ply", what, color=color, scalar_names="meshlab")
    rows, _, _ = read_ply(tmp_path / "a.ply")
    before = read_shape(folder / f"{what}.ply")
    assert np.array_equal(rows["quality"], before.rows[shown])
    assert np.array_equal(rows[shown], before.rows[shown])
    if what == "cloud":
        assert np.array_equal(rows["distance"], before.rows["quality"])
    if find_spec("pymeshlab"):
        code = "import sys, numpy, pymeshlab; s = pymeshlab.MeshSet(); s.load_new_mesh(sys.argv[1]); "
        code += "numpy.save(sys.argv[2], s.current_mesh().vertex_scalar_array())"
        call = [sys.executable, "-c", code, str(tmp_path / "a.ply"), str(tmp_path / "read.npy")]
        subprocess.run(call, check=True, capture_output=True)
        assert np.allclose(np.load(tmp_path / "read.npy"), before.rows[shown], rtol=1e-6)


@pytest.mark.parametrize(
    ("to", "options", "sentence"),
    [
        ("a.glb", {"unit": "mm"}, r"\.glb is in metres by its specification, and can't be in mm; leave the unit out"),
        ("a.mcap", {"unit": "in"}, r"\.mcap is in metres by its specification, and can't be in in; leave the unit out"),
        ("a.ply", {"unit": "furlong"}, r"unit must be one of m, cm, mm, um, in, got 'furlong'"),
        ("a.stl", {"color": "bound"}, r"\.stl has no place for colours; choose \.ply, \.pcd"),
        ("a.xyz", {"color": "force"}, r"\.xyz has no place for colours"),
        ("a.ply", {"color": "beauty"}, r"there is no 'beauty' to colour the surface by; it has bound"),
        (
            "a.vtp",
            {"scalar_names": "meshlab"},
            r"names of scalars are chosen for \.ply, which meshlab reads, and not for \.vtp",
        ),
        (
            "a.ply",
            {"scalar_names": "paraview"},
            r"names of scalars are known for meshlab and cloudcompare, got 'paraview'",
        ),
    ],
)
def test_mistakes(folder, tmp_path, to, options, sentence):
    with pytest.raises(InputError, match=sentence):
        export(folder, tmp_path / to, **options)
    assert not (tmp_path / to).exists()


def test_scalars_without_values_or_names(folder, tmp_path):
    cloud = read_shape(folder / "cloud.ply")
    rows = cloud.rows.copy()
    rows["quality"] = np.nan
    (tmp_path / "unknown.ply").write_bytes(ply(rows, None, ("unit mm",)))
    with pytest.raises(InputError, match=r"no value of quality is known, by which the cloud is to be coloured"):
        export(tmp_path / "unknown.ply", tmp_path / "a.ply", color="quality")
    bare = np.ascontiguousarray(rows[["x", "y", "z", "nx", "ny", "nz", "sweep"]])
    (tmp_path / "bare.ply").write_bytes(
        ply(bare.astype([(n, bare.dtype[n]) for n in bare.dtype.names]), None, ("unit mm",))
    )
    with pytest.raises(InputError, match=r"there is no 'force' for MeshLab to show; name one of sweep with --color"):
        export(tmp_path / "bare.ply", tmp_path / "a.ply", scalar_names="meshlab")


def test_the_command_passes_its_options_on(folder, tmp_path, capsys):
    call = ["export", str(folder), "--to", str(tmp_path / "a.ply"), "--unit", "m", "--color", "bound"]
    assert main([*call, "--scalar-names", "meshlab", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["unit"] == "m"
    rows, _, comments = read_ply(tmp_path / "a.ply")
    assert {"red", "quality", "bound"} <= set(rows.dtype.names)
    assert "unit m" in comments


# --- every mesh, read with the defaults of every program ---


def odd_bodies():
    """Bodies on which readers and writers stumble."""
    random = np.random.default_rng(3)
    box, ball = trimesh.creation.box, trimesh.creation.icosphere
    hull = trimesh.convex.convex_hull
    flattened = ball(subdivisions=3)
    flattened.apply_scale([1, 1, 1e-3])
    grains = random.normal(size=(300, 3))
    return {
        "tetrahedron": hull(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])),
        "far": box((1, 2, 3), trimesh.transformations.translation_matrix([1000, -2000, 500])),
        "tiny": ball(subdivisions=3, radius=0.5),
        "huge": ball(subdivisions=3, radius=1e6),
        "plate": box((100, 100, 0.01)),
        "needle": box((0.01, 0.01, 100)),
        "lens": flattened,
        "pebble": hull(grains / np.linalg.norm(grains, axis=1, keepdims=True) * [30, 20, 10]),
        "cylinder": trimesh.creation.cylinder(radius=10, height=20, sections=200),
        "cone": trimesh.creation.cone(radius=5, height=40, sections=64),
    }


BODIES = {path.stem: path for path in MESHES} | odd_bodies()
READER = """
import sys, json
import numpy as np
program, *files = sys.argv[1:]
found = {}
for file in files:
    if program == "open3d":
        import open3d
        mesh = open3d.io.read_triangle_mesh(file)
        if file.endswith(".stl"):
            mesh.remove_duplicated_vertices()  # its reader keeps three corners for every triangle
        points, normals = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
        colors, closed = 255 * np.asarray(mesh.vertex_colors), mesh.is_edge_manifold(False)
    if program == "trimesh":
        import trimesh
        mesh = trimesh.load(file)
        if isinstance(mesh, trimesh.Scene):
            (mesh,) = mesh.geometry.values()
        points, normals, closed = mesh.vertices, mesh.vertex_normals, mesh.is_watertight
        attributes = getattr(mesh.visual, "vertex_attributes", {})
        colors = attributes["color"] if "color" in attributes else getattr(mesh.visual, "vertex_colors", [])
    if program == "pyvista":
        import pyvista
        mesh = pyvista.read(file)
        while isinstance(mesh, pyvista.MultiBlock):
            (mesh,) = mesh
        data, points, closed = mesh.point_data, mesh.points, mesh.n_open_edges == 0
        normals = next((data[name] for name in ("Normals", "NORMAL") if name in data), [])
        colors = next((data[name] for name in ("RGB", "RGBA", "COLOR_0") if name in data), [])
    if program == "pymeshlab":
        import pymeshlab
        meshes = pymeshlab.MeshSet()
        meshes.load_new_mesh(file)
        mesh = meshes.current_mesh()
        points, normals = mesh.vertex_matrix(), mesh.vertex_normal_matrix()
        colors = 255 * mesh.vertex_color_matrix() if mesh.has_vertex_color() else []
        closed = meshes.get_topological_measures()["boundary_edges"] == 0
    colors = np.asarray(colors, dtype=float)
    if len(colors) and 0 < colors.max() <= 1:
        colors = 255 * colors
    found[file] = {
        "closed": bool(closed), "points": len(points), "low": np.min(points, axis=0).tolist(),
        "high": np.max(points, axis=0).tolist(), "normals": len(normals),
        "colors": np.round(colors[:, :3].mean(axis=0), 1).tolist() if len(colors) else None,
    }
json.dump(found, sys.stdout)
"""


@pytest.mark.slow
@pytest.mark.open3d
@pytest.mark.parametrize(
    "names",
    [("cube", "far", "needle", "lens"), pytest.param(tuple(BODIES), marks=pytest.mark.trust)],
    ids=["some", "all"],
)
def test_every_program_reads_every_body_closed_coloured_and_in_its_unit(tmp_path, names):
    """Where the format has normals and colours they are read too; STL has neither at its vertices."""
    expected = {}
    for name in names:
        body = BODIES[name]
        mesh = scan3d.load_mesh(body) if isinstance(body, Path) else body
        bound = np.linspace(0, 1, len(mesh.vertices))
        source = tmp_path / f"{name}.ply"
        source.write_bytes(ply(surface_table(mesh, bound), np.asarray(mesh.faces), ("unit mm",)))
        for ending in (".stl", ".ply", ".obj", ".glb", ".vtp"):
            file = tmp_path / "exported" / f"{name}{ending}"
            unit = None if ending == ".glb" else "m"
            export(source, file, color=None if ending == ".stl" else "bound", unit=unit)
            expected[str(file)] = 1e-3 * np.asarray(mesh.bounds)
    tools = {"open3d": 4, "trimesh": 4, "pyvista": 5, "pymeshlab": 4}
    for program, count in tools.items():
        if not find_spec(program):
            continue
        files = [file for file in expected if program == "pyvista" or not file.endswith(".vtp")]
        call = [sys.executable, "-W", "ignore", "-c", READER, program, *files]
        done = subprocess.run(call, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        found = json.loads(done.stdout[done.stdout.index("{") :])
        assert len(found) == count * len(names)
        means = {}
        for file, read in found.items():
            what = f"{program} {Path(file).name}"
            assert read["closed"], what
            low, high = expected[file]
            if file.endswith(".glb"):  # y up
                low, high = low[[0, 2, 1]] * [1, 1, -1], high[[0, 2, 1]] * [1, 1, -1]
                low, high = np.minimum(low, high), np.maximum(low, high)
            size = np.abs([low, high]).max()
            assert np.abs(np.array([read["low"], read["high"]]) - [low, high]).max() < 1e-5 * size, what
            if not file.endswith(".stl"):
                assert read["normals"] == read["points"], what
                assert read["colors"] is not None, what
                means.setdefault(Path(file).stem, []).append(read["colors"])
        # the colours are the same in all formats
        for name, colors in means.items():
            assert np.ptp(colors, axis=0).max() <= 2, (program, name, colors)


def test_the_command_names_every_format(capsys):
    assert main(["export", "--help"]) == 0
    text = capsys.readouterr().out
    assert all(ending in text for ending in (*POINT_ENDINGS, *SURFACE_ENDINGS))
