"""Exports as other programs want them: units, colours, names of scalars, GLB of clouds, and bags of ROS."""

import json
import struct
import subprocess
import sys
from importlib.util import find_spec

import matplotlib
import numpy as np
import other_programs
import pytest
import trimesh

import scan3d
from scan3d import InputError
from scan3d.cli import main
from scan3d.files.formats import export
from scan3d.files.shapes import ply, read_ply, read_shape


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
        ("a.ply", {"unit": "furlong"}, r"unit must be one of m, cm, mm, um, in, got 'furlong'"),
        ("a.stl", {"color": "bound"}, r"\.stl has no place for colours; choose \.ply, \.pcd"),
        ("a.ply", {"color": "beauty"}, r"there is no 'beauty' to colour the surface by; it has bound"),
        (
            "a.vtp",
            {"scalar_names": "meshlab"},
            r"names of scalars are chosen for \.ply, which meshlab reads, and not for \.vtp",
        ),
    ],
)
def test_mistakes(folder, tmp_path, to, options, sentence):
    with pytest.raises(InputError, match=sentence):
        export(folder, tmp_path / to, **options)
    assert not (tmp_path / to).exists()


def test_the_command_passes_its_options_on(folder, tmp_path, capsys):
    call = ["export", str(folder), "--to", str(tmp_path / "a.ply"), "--unit", "m", "--color", "bound"]
    assert main([*call, "--scalar-names", "meshlab", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["unit"] == "m"
    rows, _, comments = read_ply(tmp_path / "a.ply")
    assert {"red", "quality", "bound"} <= set(rows.dtype.names)
    assert "unit m" in comments
