"""Binary PLY files are read back by other readers and by the reader of scan3d."""

import math

import numpy as np
import pytest
import trimesh

from scan3d import InputError
from scan3d.files.shapes import ply
from scan3d.files.shapes import read_ply as read_our_ply

ROWS = np.dtype(
    [(name, "f8") for name in "xyz"]
    + [("nx", "f4"), ("phase", "u1"), ("slice", "i4"), ("sweep", "u4"), ("a", "i1"), ("b", "i2")]
)


_PLY_TYPES = {"double": "<f8", "float": "<f4", "int": "<i4", "uint": "<u4", "short": "<i2", "char": "i1", "uchar": "u1"}


def read_ply(path):
    """A reader of binary PLY of the tests' own: (vertices as a structured array, faces (m, 3) or None, comments)."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = [line.split() for line in head.decode("ascii").splitlines()]
    assert lines[:2] == [["ply"], ["format", "binary_little_endian", "1.0"]]
    counts = {line[1]: int(line[2]) for line in lines if line[0] == "element"}
    properties = [line for line in lines if line[0] == "property"]
    row = np.dtype([(name, _PLY_TYPES[kind]) for _, kind, name in (p for p in properties if p[1] != "list")])
    vertices = np.frombuffer(body, row, counts["vertex"])
    rest, faces = body[vertices.nbytes :], None
    if "face" in counts:
        assert properties[-1] == ["property", "list", "uchar", "int", "vertex_indices"]
        rows = np.frombuffer(rest, [("count", "u1"), ("corners", "<i4", 3)], counts["face"])
        assert (rows["count"] == 3).all()
        faces, rest = rows["corners"], rest[rows.nbytes :]
    assert rest == b""
    return vertices, faces, [" ".join(line[1:]) for line in lines if line[0] == "comment"]


def rows(n=7):
    table = np.zeros(n, ROWS)
    rng = np.random.default_rng(1)
    for name in "xyz":
        table[name] = rng.standard_normal(n) / 3
    table["x"][0], table["y"][0], table["nx"][1] = math.nan, 1e-300, math.nan
    table["nx"][2:] = rng.standard_normal(n - 2)
    table["phase"], table["slice"], table["sweep"] = 2, -5, 2**32 - 1
    table["a"], table["b"] = -100, -30000
    return table


FACES = np.array([[0, 1, 2], [2, 1, 3], [4, 5, 6]])


def test_ply_is_read_back_bit_for_bit(tmp_path):
    (tmp_path / "a.ply").write_bytes(ply(rows(), FACES, comments=("unit mm", "two")))
    vertices, faces, comments = read_ply(tmp_path / "a.ply")
    assert vertices.tobytes() == rows().tobytes()
    assert vertices.dtype.names == ROWS.names
    assert np.array_equal(faces, FACES)
    assert comments == ["unit mm", "two"]


def test_ply_against_trimesh(tmp_path):
    table = rows()
    table["x"][0] = 1.25
    (tmp_path / "a.ply").write_bytes(ply(table, FACES))
    mesh = trimesh.load_mesh(tmp_path / "a.ply", process=False)
    assert np.array_equal(mesh.faces, FACES)
    assert np.array_equal(mesh.vertices, np.stack([table["x"], table["y"], table["z"]], axis=1))
    data = mesh.metadata["_ply_raw"]["vertex"]["data"]
    assert all(np.array_equal(data[name].reshape(-1), table[name], equal_nan=True) for name in ROWS.names)


# --- the reader of scan3d ---


def test_a_ply_is_read_as_it_was_written(tmp_path):
    kinds = ("f8", "f4", "i4", "u4", "i2", "u1", "i1")
    rows = np.zeros(5, [(kind, kind) for kind in kinds])
    for kind in kinds:
        rows[kind] = np.arange(5) + 1
    faces = np.array([[0, 1, 2], [2, 3, 4]])
    for corners in (None, faces, faces[:0]):
        (tmp_path / "a.ply").write_bytes(ply(rows, corners, ("unit mm", "end_header of a poem")))
        vertices, triangles, comments = read_our_ply(tmp_path / "a.ply")
        assert vertices.dtype == rows.dtype
        assert np.array_equal(vertices, rows)
        assert (triangles is None) if corners is None else np.array_equal(triangles, corners)
        assert comments == ("unit mm", "end_header of a poem")


HEAD = "ply\nformat binary_little_endian 1.0\n"


def test_a_ply_that_can_not_be_read(tmp_path):
    for path, why in ((tmp_path / "missing.ply", "No such file"), (tmp_path, "Is a directory")):
        with pytest.raises(InputError, match=rf"can't read .*: {why}.*; give a PLY written by scan3d"):
            read_our_ply(path)
