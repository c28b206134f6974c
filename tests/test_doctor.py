"""`scan3d doctor`: what it finds where all is well, and where something is missing."""

import json
import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, requires, version

import pytest

from scan3d.cli import doctor, main
from scan3d.cli.terminal import table
from scan3d.pictures import rendering


def installed(name):
    """Versions as they are, and imageio-ffmpeg, which no test needs, as if it were there."""
    return "0.6.0" if name.startswith("imageio-ffmpeg") else version(name)


@pytest.fixture(autouse=True)
def with_ffmpeg(monkeypatch):
    monkeypatch.setattr(doctor, "version", installed)


@pytest.fixture
def well(monkeypatch):
    """Nothing wrong, and no waiting for child processes."""
    monkeypatch.setattr(doctor, "_error_of", lambda code: None)
    monkeypatch.setattr(rendering, "can_render", lambda: True)


def test_a_scan_is_tried_out(monkeypatch):
    monkeypatch.setattr(rendering, "can_render", lambda: True)
    found = doctor.examine()
    assert found["ok"]
    assert found["scan"] == {"works": True, "why_not": None}
    assert found["scan3d"] == version("scan3d")
    assert found["packages"]["numpy"] == version("numpy")
    assert found["recordings"][".csv"] is True


def test_it_knows_what_the_package_asks_for():
    asked = {re.match(r"[\w-]+", line)[0].removesuffix("-cpu") for line in requires("scan3d") if "extra ==" not in line}
    assert asked == {*doctor.NEEDED, "open3d"}


def test_nothing_missing(well, capsys):
    assert main(["doctor"]) == 0
    said, complained = capsys.readouterr()
    assert complained == ""
    lines = {line[:18].strip(): line[19:] for line in said.splitlines()}
    assert lines["scan3d"].startswith(f"{version('scan3d')}, Python {sys.version.split()[0]}, ")
    assert (lines["scans"], lines["pictures"], lines["open3d"]) == ("work", "work", "works")
    assert lines["recordings"].startswith(".csv")
    assert f"numpy {version('numpy')}" in lines["packages"]
    assert lines["missing"] == "nothing"
    assert main(["doctor", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_json(well, capsys):
    assert main(["doctor", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["ok"] is True
    assert found["missing"] == []
    assert found == json.loads(json.dumps(doctor.examine()))


def without(monkeypatch, *names):
    def look(name):
        if name in names:
            raise PackageNotFoundError(name)
        return installed(name)

    monkeypatch.setattr(doctor, "version", look)


def test_without_ffmpeg_there_are_no_mp4(well, monkeypatch):
    without(monkeypatch, "imageio-ffmpeg", "imageio-ffmpeg-cpu")
    found = doctor.examine()
    assert found["ok"]
    (missing,) = found["missing"]
    assert (missing["what"], missing["for"]) == ("imageio-ffmpeg", "movies as .mp4")
    assert re.search(r"-m pip install 'imageio-ffmpeg>=0\.\d+'$", missing["command"])


def test_a_missing_package_stops_a_scan(well, monkeypatch, capsys):
    without(monkeypatch, "scipy")
    monkeypatch.setattr(doctor, "_error_of", lambda code: "No module named 'scipy'" if "scan3d" in code else None)
    assert main(["doctor"]) == 1
    said = capsys.readouterr().out
    assert "scans              don't work (No module named 'scipy')" in said
    assert re.search(r"missing +scipy \(not installed\), for every scan: .* -m pip install 'scipy>=1\.\d+'", said)
    assert main(["doctor", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert (found["ok"], found["packages"]["scipy"]) == (False, None)
    assert [one["what"] for one in found["missing"]] == ["scipy"]


@pytest.mark.parametrize(
    ("platform", "machine", "command"),
    [("linux", "x86_64", "open3d-cpu"), ("linux", "aarch64", "open3d"), ("darwin", "arm64", "open3d")],
)
def test_what_a_scan_can_do_without(well, monkeypatch, platform, machine, command):
    without(monkeypatch, "open3d", "open3d-cpu")
    monkeypatch.setattr(doctor.sys, "platform", platform)
    monkeypatch.setattr(doctor.platform, "machine", lambda: machine)
    found = doctor.examine()
    assert found["ok"]
    commands = {one["what"]: one["command"] for one in found["missing"]}
    assert set(commands) == {"open3d"}
    assert commands["open3d"].endswith(f"-m pip install {command}")


@pytest.mark.parametrize(("platform", "known"), [("linux", True), ("darwin", False)])
def test_missing_system_libraries(monkeypatch, platform, known):
    monkeypatch.setattr(
        doctor, "_error_of", lambda code: "libGL.so.1: no such file" if "import open3d" in code else None
    )
    monkeypatch.setattr(rendering, "can_render", lambda: False)
    monkeypatch.setattr(doctor.sys, "platform", platform)
    found = doctor.examine()
    assert found["ok"]
    assert (found["rendering"], found["open3d"]["works"]) == (False, False)
    commands = {one["what"]: one["command"] for one in found["missing"]}
    assert commands == {
        "open3d": "apt-get install libgl1 libgomp1" if known else None,
        "renderer": "apt-get install libegl1 libgl1" if known else None,
    }
    said = table("", doctor.summary(found), None)
    assert "open3d             doesn't work (libGL.so.1: no such file)" in said
    assert "pictures           don't work (nothing can render off screen)" in said
    assert ("apt-get" in said) == known


def test_a_child_that_fails_says_why():
    assert doctor._error_of("") is None
    assert doctor._error_of("raise OSError('no luck')") == "OSError: no luck"
    assert doctor._error_of("import sys; sys.exit(3)") == "exit code 3"
    if sys.platform != "win32":
        assert doctor._error_of("import os; os.kill(os.getpid(), 9)") == "killed by signal 9"


def test_a_child_that_does_not_end(monkeypatch):
    def run(*_, **__):
        raise subprocess.TimeoutExpired("python", 300)

    monkeypatch.setattr(doctor.subprocess, "run", run)
    assert "timed out after 300 seconds" in doctor._error_of("")


def test_it_runs_where_nothing_can_be_imported():
    # a fresh checkout without its packages: the doctor is what one turns to
    code = "import sys\nfor name in ('numpy', 'scipy', 'trimesh', 'pyvista'): sys.modules[name] = None\n"
    code += "from scan3d.cli import doctor, main\ndoctor._error_of = lambda code: 'broken'\n"
    code += "sys.exit(main(['doctor', '--json']))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "")
    found = json.loads(done.stdout)
    assert found["rendering"] is False
    assert found["recordings"] == {".csv": False}


def test_a_recording_that_can_not_be_written(well, monkeypatch):
    from scan3d.errors import InputError
    from scan3d.files import recordings

    def write(one, path):
        raise InputError("no ink")

    monkeypatch.setattr(recordings, "write_recording", write)
    found = doctor.examine()
    assert found["recordings"][".csv"] is False
    assert {"what": ".csv recordings", "for": "recordings", "why": "no ink", "command": None} in found["missing"]
    assert "recordings         none" in table("", doctor.summary(found), None)
