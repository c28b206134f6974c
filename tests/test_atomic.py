"""Files are written completely or not at all, and so are folders."""

import os

import pytest

from scan3d import InputError
from scan3d.files.atomic import atomic, folder, write_atomic, write_together


def names(path):
    return sorted(p.name for p in path.iterdir())


def test_a_file_is_written(tmp_path):
    write_atomic(tmp_path / "a.bin", b"\x00new\n")
    assert (tmp_path / "a.bin").read_bytes() == b"\x00new\n"
    assert names(tmp_path) == ["a.bin"]


def test_a_file_gets_the_permissions_of_any_new_file(tmp_path):
    # a temporary file is readable by its owner only; the written file must not be
    (tmp_path / "plain").write_bytes(b"")
    write_atomic(tmp_path / "ours", b"")
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
        write_atomic(path, b"new")
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["a.txt"]


def test_the_old_file_stays_when_the_writing_fails(tmp_path):
    path = tmp_path / "picture.png"
    path.write_bytes(b"old")

    def draw():
        with atomic(path) as temporary:
            # beside it, on the same disk, with the name whose ending determines the format
            assert temporary.parent.parent == tmp_path
            assert temporary.name == "picture.png"
            temporary.write_bytes(b"ne")
            raise DisasterError

    with pytest.raises(DisasterError):
        draw()
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["picture.png"]


def test_of_files_that_belong_together_none_is_written_if_one_cannot_be(tmp_path):
    (tmp_path / "a").write_bytes(b"old")
    (tmp_path / "b").mkdir()
    with pytest.raises(InputError, match=r"can't write .*: Is a directory"):
        write_together(tmp_path / "a", {"a": b"new", "b": b"new"})
    with pytest.raises(InputError, match=r"can't write .*missing"):
        write_together(tmp_path / "missing" / "a", {"a": b"new", "b": b"new"})
    assert (tmp_path / "a").read_bytes() == b"old"
    assert names(tmp_path) == ["a", "b"]


def test_a_path_that_cannot_be_written_is_named_with_the_option_to_change(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(InputError, match=r"can't write .*file/a.txt: Not a directory; choose another place with --out"):
        write_atomic(tmp_path / "file" / "a.txt", b"")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=r"can't write .*folder: Is a directory"):
        write_atomic(tmp_path / "folder", b"")
    assert names(tmp_path) == ["file", "folder"]


def test_a_folder_is_created_with_its_parents(tmp_path):
    with folder(tmp_path / "a" / "b") as made:
        assert made == tmp_path / "a" / "b"
        assert names(made) == []
    assert made.is_dir()


def test_a_folder_created_in_vain_is_removed_and_an_existing_one_is_kept(tmp_path):
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
