"""Files: whole or not at all, and small formats that other readers read back."""

import datetime
import json
import math
import os
import tomllib

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from scan3d import InputError
from scan3d.files import folder, ply, to_json, to_toml, whole, write_together, write_whole


def names(path):
    return sorted(p.name for p in path.iterdir())


def test_a_file_is_written(tmp_path):
    write_whole(tmp_path / "a.bin", b"\x00new\n")
    assert (tmp_path / "a.bin").read_bytes() == b"\x00new\n"
    assert names(tmp_path) == ["a.bin"]


def test_a_file_gets_the_rights_that_any_new_file_gets(tmp_path):
    # a temporary file is its owner's alone; that must not stay so
    (tmp_path / "plain").write_bytes(b"")
    write_whole(tmp_path / "ours", b"")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


class DisasterError(Exception):
    pass


@pytest.mark.parametrize(
    ("disaster", "raised"),
    [
        (KeyboardInterrupt(), KeyboardInterrupt),
        (OSError(28, "No space left on device"), InputError),
        (DisasterError(), DisasterError),
    ],
    ids=["interrupted", "full disk", "other"],
)
def test_the_old_file_stays_when_the_last_step_fails(tmp_path, monkeypatch, disaster, raised):
    path = tmp_path / "a.txt"
    path.write_bytes(b"old")

    def fail(*_):
        raise disaster

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(raised):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["a.txt"]


def test_the_old_file_stays_when_the_writing_fails(tmp_path):
    path = tmp_path / "picture.png"
    path.write_bytes(b"old")

    def draw():
        with whole(path) as temporary:
            assert temporary.parent == tmp_path
            assert temporary.suffix == ".png"
            temporary.write_bytes(b"ne")
            raise DisasterError

    with pytest.raises(DisasterError):
        draw()
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["picture.png"]


def test_of_files_that_belong_together_none_is_written_if_one_can_not(tmp_path):
    (tmp_path / "a").write_bytes(b"old")
    with pytest.raises(InputError, match=r"can't write .*missing"):
        write_together({tmp_path / "a": b"new", tmp_path / "missing" / "b": b"new"})
    assert (tmp_path / "a").read_bytes() == b"old"
    assert names(tmp_path) == ["a"]


def test_a_place_that_can_not_be_written_is_named_with_the_way_out(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(InputError, match=r"can't write .*file/a.txt: Not a directory; choose another place with --out"):
        write_whole(tmp_path / "file" / "a.txt", b"")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=r"can't write .*folder: Is a directory"):
        write_whole(tmp_path / "folder", b"")
    assert names(tmp_path) == ["file", "folder"]


def test_a_folder_is_made_with_its_parents(tmp_path):
    with folder(tmp_path / "a" / "b") as made:
        assert made == tmp_path / "a" / "b"
        assert names(made) == []
    assert made.is_dir()


def test_a_folder_made_in_vain_goes_again_and_one_that_was_there_stays(tmp_path):
    def work(path, file=None):
        with folder(path):
            if file:
                (path / file).write_bytes(b"")
            raise DisasterError

    (tmp_path / "there").mkdir()
    for path in (tmp_path / "a" / "b", tmp_path / "there", tmp_path / "there" / "c"):
        with pytest.raises(DisasterError):
            work(path)
    assert names(tmp_path) == ["there"]
    assert names(tmp_path / "there") == []
    with pytest.raises(DisasterError):
        work(tmp_path / "a" / "b", "result")
    assert names(tmp_path / "a" / "b") == ["result"]


@pytest.mark.parametrize("path", ["/proc/nowhere/out", "file/out", "file"])
def test_a_folder_that_can_not_be_written_into(tmp_path, path):
    (tmp_path / "file").write_bytes(b"old")
    with (
        pytest.raises(InputError, match=r"can't write into the folder .*; choose another one with --out"),
        folder(tmp_path / path),
    ):
        pass
    assert names(tmp_path) == ["file"]


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


def test_ply_is_read_back_bit_for_bit(tmp_path, read_ply):
    (tmp_path / "a.ply").write_bytes(ply(rows(), FACES, comments=("unit mm", "two")))
    vertices, faces, comments = read_ply(tmp_path / "a.ply")
    assert vertices.tobytes() == rows().tobytes()
    assert vertices.dtype.names == ROWS.names
    assert np.array_equal(faces, FACES)
    assert comments == ["unit mm", "two"]


def test_ply_without_faces_and_of_big_endian_rows(tmp_path, read_ply):
    big = rows().astype([(name, ROWS[name].newbyteorder(">")) for name in ROWS.names])
    (tmp_path / "a.ply").write_bytes(ply(big))
    vertices, faces, _ = read_ply(tmp_path / "a.ply")
    assert vertices.tobytes() == rows().tobytes()
    assert faces is None


def test_ply_against_trimesh(tmp_path):
    table = rows()
    table["x"][0] = 1.25
    (tmp_path / "a.ply").write_bytes(ply(table, FACES))
    mesh = trimesh.load_mesh(tmp_path / "a.ply", process=False)
    assert np.array_equal(mesh.faces, FACES)
    assert np.array_equal(mesh.vertices, np.stack([table["x"], table["y"], table["z"]], axis=1))
    data = mesh.metadata["_ply_raw"]["vertex"]["data"]
    assert all(np.array_equal(data[name].reshape(-1), table[name], equal_nan=True) for name in ROWS.names)


def test_json_has_null_for_what_is_no_number():
    data = {"a": math.nan, "b": [math.inf, 1.5, -math.inf], "c": {"d": np.float64(math.nan), "e": np.int64(3)}}
    data |= {
        "f": np.array([[1.0, math.nan]]),
        "g": (True, None, "µ"),
        "h": np.bool_(False),
        "i": datetime.date(2024, 5, 1),
    }
    text = to_json(data)
    assert text.endswith(b"}\n")
    assert json.loads(text, parse_constant=pytest.fail) == {
        "a": None,
        "b": [None, 1.5, None],
        "c": {"d": None, "e": 3},
        "f": [[1.0, None]],
        "g": [True, None, "µ"],
        "h": False,
        "i": "2024-05-01",
    }


def test_json_holds_floats_in_full():
    values = np.random.default_rng(2).standard_normal(100)
    assert json.loads(to_json({"a": values}))["a"] == values.tolist()


text = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
plain = st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats() | text | st.dates() | st.datetimes()
values = st.recursive(
    plain, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(text, inner, max_size=3), max_leaves=5
)


def same(a, b):
    if isinstance(a, float):
        return isinstance(b, float) and (a == b or (math.isnan(a) and math.isnan(b)))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and a == b


@given(st.dictionaries(text, values, max_size=5))
def test_toml_against_tomllib(data):
    assert same(data, tomllib.loads(to_toml(data)))


def test_toml_of_numpys_numbers():
    data = {"a": np.float64(0.1), "b": np.int64(3), "c": {"d": np.float32(0.5), "e": (1, 2)}}
    assert tomllib.loads(to_toml(data)) == {"a": 0.1, "b": 3, "c": {"d": 0.5, "e": [1, 2]}}


def test_a_file_name_that_is_no_utf8_does_not_stop_the_writing():
    name = os.fsdecode(b"caf\xe9.stl")
    assert json.loads(to_json({"file": name})) == {"file": "caf?.stl"}
    assert tomllib.loads(to_toml({"file": name}).encode(errors="replace").decode()) == {"file": "caf?.stl"}
