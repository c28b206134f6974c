"""What works without the libraries that only some installations have, and what is said where one is missing."""

import re
import sys
from importlib.metadata import requires

import pytest
from small_scans import CUBE, FEW


@pytest.fixture
def without_open3d(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)


def test_open3d_is_an_extra_and_the_tests_have_it():
    asked = {line for line in requires("scan3d") if line.startswith("open3d")}
    assert asked
    assert all(re.search(r'extra == "open3d"$', line) for line in asked)
    assert any(re.match(r'scan3d\[.*\bopen3d\b.*\]; extra == "test"$', line) for line in requires("scan3d"))


@pytest.mark.slow
def test_the_commands_work_without_open3d(call, tmp_path, no_pictures, without_open3d):
    out = tmp_path / "out"
    commands = [
        ["scan", CUBE, "--out", out, *FEW],
        ["reconstruct", out / "recording.csv", "--out", tmp_path / "again", "--truth", CUBE],
        ["show", out, "--html", tmp_path / "page.html"],
        ["export", out, "--to", tmp_path / "cube.glb"],
        ["compare", out / "surface.ply", CUBE],
    ]
    for command in commands:
        code, _, stderr = call(*command)
        assert code == 0, stderr


@pytest.mark.parametrize("method", ["poisson", "ball-pivoting"])
def test_a_method_that_needs_open3d_is_refused_before_the_scan(
    call, tmp_path, no_pictures, without_open3d, monkeypatch, method
):
    monkeypatch.setattr("scan3d.pipeline.simulate_judged", None)  # not called
    code, stdout, stderr = call("scan", CUBE, "--out", tmp_path / "out", *FEW, "--method", method)
    assert (code, stdout) == (1, "")
    assert re.fullmatch(
        r"scan3d: the methods poisson and ball-pivoting need open3d, which can't be imported \(.*\): "
        r"pip install 'scan3d\[open3d\]', or use the method auto, bracket, hull or support\n",
        stderr,
    )
    assert not (tmp_path / "out").exists()
