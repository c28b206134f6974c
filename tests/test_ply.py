"""Binary PLY files are read back by trimesh and by the reader of scan3d."""

import numpy as np
import pytest
import trimesh

from scan3d import InputError
from scan3d.files.shapes import ply, read_ply


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
