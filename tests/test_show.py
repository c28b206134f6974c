"""The command `show`: it writes what it is asked for, and without a renderer everything else."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from image_checks import pixels
from small_scans import CUBE, FEW, scanned_folder
from without_renderer import MISSING, hidden_renderer

from scan3d.cli import main, show
from scan3d.pictures import rendering, views

COMMAND = Path(sys.executable).with_name("scan3d")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return scanned_folder(tmp_path_factory.mktemp("show"))


@pytest.mark.rendering
@pytest.mark.slow
def test_show_writes_what_it_is_asked_for(folder, tmp_path, capsys):
    picture, page = tmp_path / "a.png", tmp_path / "a.html"
    assert main(["show", str(folder), "--screenshot", str(picture), "--html", str(page), "--view", "compare"]) == 0
    printed = capsys.readouterr()
    assert printed.out == f"written to {page}\nwritten to {picture}\n"
    assert printed.err == ""
    assert page.read_bytes().startswith(b"<!DOCTYPE html>")
    assert (pixels(picture) < 128).any()
    assert main(["show", str(folder / "cloud.ply"), "--screenshot", str(picture), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"shown": "cloud", "files": [str(picture)]}


@pytest.mark.slow
def test_the_page_of_a_folder_is_that_of_its_scan(folder, tmp_path):
    assert main(["show", str(folder), "--html", str(tmp_path / "again.html"), "--quiet"]) == 0
    assert (tmp_path / "again.html").read_bytes() == (folder / "view.html").read_bytes()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--view", "bound"), "--view says what a picture shows: give --screenshot FILE as well"),
        (("--view", "bound", "--html", "x.html"), "--view says what a picture shows: give --screenshot FILE as well"),
        (
            ("--color", "phase", "--html", "x.html"),
            "--color is for a picture or the window: give --screenshot FILE as well",
        ),
        (
            ("--color", "phase", "--movie", "x.gif"),
            "--color is for a picture or the window: give --screenshot FILE as well",
        ),
        (
            ("--color", "phase", "--view", "bound", "--screenshot", "x.png"),
            "--color is that of the contacts in the view cloud: leave it out with --view bound",
        ),
        (("--movie-of", "growth", "--html", "x.html"), "--movie-of says what a movie shows: give --movie FILE as well"),
    ],
)
def test_options_that_would_change_nothing(folder, tmp_path, monkeypatch, capsys, options, sentence):
    monkeypatch.chdir(tmp_path)
    assert main(["show", str(folder), *options]) == 2
    assert capsys.readouterr() == ("", f"scan3d: {sentence}; see 'scan3d show --help'\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.rendering
@pytest.mark.parametrize(("options", "same_as"), [(("--color", "phase"), "cloud"), ((), "surface")])
@pytest.mark.slow
def test_a_colour_shows_the_contacts(folder, tmp_path, options, same_as):
    """Without a view: the contacts if their colour is named, else the surface."""
    written = tmp_path / "written.png"
    assert main(["show", str(folder), "--screenshot", str(written), "--quiet", *options]) == 0
    expected = tmp_path / "expected.png"
    scene = show.read_scene(folder, None, False, "mm")
    views.picture(scene, expected, same_as, "phase")
    assert written.read_bytes() == expected.read_bytes()


@pytest.mark.parametrize("missing", MISSING)
@pytest.mark.slow
def test_without_a_renderer_all_other_files_are_written(folder, tmp_path, missing):
    environment = hidden_renderer(missing, tmp_path / "lib")

    def run(*arguments):
        return subprocess.run(
            [COMMAND, *map(str, arguments)], env=environment, capture_output=True, text=True, check=False
        )

    out = tmp_path / "out"
    done = run("scan", CUBE, "--out", out, *FEW)
    assert (done.returncode, done.stderr) == (0, f"scan3d: {rendering.NO_RENDERER}\n")
    assert {path.name for path in out.iterdir()} == {
        "recording.csv", "recording.toml", "cloud.ply", "surface.ply", "report.json", "view.html",
    }  # fmt: skip
    page = tmp_path / "page.html"
    done = run("show", folder, "--html", page, "--screenshot", tmp_path / "picture.png")
    assert (done.returncode, done.stderr) == (1, f"scan3d: {rendering.NO_RENDERER}\n")
    assert page.exists()
    assert not (tmp_path / "picture.png").exists()
