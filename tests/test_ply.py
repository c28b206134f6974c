"""Binary PLY files are read back by trimesh and by the reader of scan3d."""

import math

import numpy as np
import pytest
import trimesh

from scan3d import InputError
from scan3d.files.shapes import ply, read_ply

ROWS = np.dtype(
    [(name, "f8") for name in "xyz"]
    + [("nx", "f4"), ("phase", "u1"), ("slice", "i4"), ("sweep", "u4"), ("a", "i1"), ("b", "i2")]
)


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


def test_ply_against_trimesh(tmp_path):
    table = rows()
    table["x"][0] = 1.25
    (tmp_path / "a.ply").write_bytes(ply(table, FACES))
    mesh = trimesh.load_mesh(tmp_path / "a.ply", process=False)
    assert np.array_equal(mesh.faces, FACES)
    assert np.array_equal(mesh.vertices, np.stack([table["x"], table["y"], table["z"]], axis=1))
    data = mesh.metadata["_ply_raw"]["vertex"]["data"]
    assert all(np.array_equal(data[name].reshape(-1), table[name], equal_nan=True) for name in ROWS.names)


def test_a_ply_is_read_as_it_was_written(tmp_path):
    kinds = ("f8", "f4", "i4", "u4", "i2", "u1", "i1")
    rows = np.zeros(5, [(kind, kind) for kind in kinds])
    for kind in kinds:
        rows[kind] = np.arange(5) + 1
    faces = np.array([[0, 1, 2], [2, 3, 4]])
    for corners in (None, faces, faces[:0]):
        (tmp_path / "a.ply").write_bytes(ply(rows, corners, ("unit mm", "end_header of a poem")))
        vertices, triangles, comments = read_ply(tmp_path / "a.ply")
        assert vertices.dtype == rows.dtype
        assert np.array_equal(vertices, rows)
        assert (triangles is None) if corners is None else np.array_equal(triangles, corners)
        assert comments == ("unit mm", "end_header of a poem")


def test_a_ply_that_can_not_be_read(tmp_path):
    for path, why in ((tmp_path / "missing.ply", "No such file"), (tmp_path, "Is a directory")):
        with pytest.raises(InputError, match=rf"can't read .*: {why}.*; give a PLY written by scan3d"):
            read_ply(path)
