"""`scan3d doctor`: its result if everything works, and if something is missing."""

import json
import re
import sys
from importlib.metadata import version

import pytest

from scan3d.cli import doctor, main
from scan3d.cli.terminal import table
from scan3d.pictures import canvas

_VERSION = doctor._version


@pytest.fixture
def well(monkeypatch):
    """Nothing is missing, and no child process is run."""
    monkeypatch.setattr(doctor, "_error_of", lambda code: None)
    monkeypatch.setattr(canvas, "can_render", lambda *_: True)


@pytest.mark.slow
def test_a_scan_is_tried(monkeypatch):
    monkeypatch.setattr(canvas, "can_render", lambda *_: True)
    tried = doctor._error_of
    monkeypatch.setattr(doctor, "_error_of", lambda code: None if "import open3d" in code else tried(code))
    state = doctor.examine()
    assert state["ok"]
    assert state["scan"] == {"works": True, "why_not": None}
    assert state["scan3d"] == version("scan3d")
    assert state["packages"]["numpy"] == version("numpy")


def test_nothing_missing(well, capsys):
    assert main(["doctor"]) == 0
    stdout, stderr = capsys.readouterr()
    assert stderr == ""
    lines = {line[:18].strip(): line[19:] for line in stdout.splitlines()}
    assert lines["scan3d"].startswith(f"{version('scan3d')}, Python {sys.version.split()[0]}, ")
    assert (lines["scans"], lines["pictures"], lines["open3d"]) == ("work", "work", "works")
    assert f"numpy {version('numpy')}" in lines["packages"]
    assert lines["missing"] == "nothing"
    assert main(["doctor", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def without(monkeypatch, *names):
    monkeypatch.setattr(doctor, "_version", lambda name: None if name in names else _VERSION(name))


def test_a_missing_package_stops_a_scan(well, monkeypatch, capsys):
    without(monkeypatch, "scipy")
    monkeypatch.setattr(doctor, "_error_of", lambda code: "No module named 'scipy'" if "scan3d" in code else None)
    assert main(["doctor"]) == 1
    stdout = capsys.readouterr().out
    assert "scans              don't work (No module named 'scipy')" in stdout
    assert re.search(r"missing +scipy \(not installed\), for every scan: .* -m pip install 'scipy>=1\.\d+'", stdout)
    assert main(["doctor", "--json"]) == 1
    state = json.loads(capsys.readouterr().out)
    assert (state["ok"], state["packages"]["scipy"]) == (False, None)
    assert [item["what"] for item in state["missing"]] == ["scipy"]


@pytest.mark.parametrize(("platform", "known"), [("linux", True), ("darwin", False)])
def test_missing_system_libraries(monkeypatch, platform, known):
    found = "libGL.so.1: no such file"
    monkeypatch.setattr(doctor, "_error_of", lambda code: found if "import open3d" in code else None)
    monkeypatch.setattr(canvas, "can_render", lambda *_: False)
    monkeypatch.setattr(doctor.sys, "platform", platform)
    state = doctor.examine()
    assert state["ok"]
    assert (state["rendering"], state["open3d"]["works"]) == (False, False)
    assert {item["what"]: item["command"] for item in state["missing"]} == {
        "open3d": "apt-get install libgl1 libgomp1 libusb-1.0-0" if known else None,
        "renderer": "apt-get install libegl1 libgl1" if known else None,
    }
    stdout = table("", doctor.summary(state))
    assert f"open3d             doesn't work ({found})" in stdout
    assert "pictures           don't work (nothing can render off screen)" in stdout
    assert ("apt-get" in stdout) == known
