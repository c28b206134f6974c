"""The command `show` and the window: what it writes, what it refuses, and without a renderer everything else."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from image_checks import pixels
from small_scans import CUBE, EGG, FEW, RESULTS, scanned, scanned_in_space

import scan3d
from scan3d.pictures import canvas, parts
from scan3d.pictures.parts import contact_sentence

MISSING = ("libraries", "display")
"""Either the OpenGL libraries are missing, or VTK is set to open its window on an X server, which does not run."""
_LIBRARIES = ("libEGL.so.1", "libEGL.so", "libGL.so.1", "libGL.so", "libOpenGL.so.0", "libGLX.so.0", "libOSMesa.so.8")


def headless(**more):
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("DISPLAY", "WAYLAND", "VTK_"))}
    return {**kept, **more}


def hidden_renderer(missing, place):
    """An environment without a renderer; `missing` is one of `MISSING`, and the folder `place` holds empty files for it."""
    if missing == "display":
        return headless(VTK_DEFAULT_OPENGL_WINDOW="vtkXOpenGLRenderWindow")
    place.mkdir(exist_ok=True)
    for name in _LIBRARIES:
        (place / name).touch()  # empty files are found before the libraries
    return headless(LD_LIBRARY_PATH=str(place))


COMMAND = Path(sys.executable).with_name("scan3d")
# The notebook is tried without a display, the command without libraries; `make trust` runs the rest.
LANES = (pytest.mark.slow, pytest.mark.trust)


@pytest.fixture
def shown(folder, call):
    return lambda *options: call("show", folder, *options)


@pytest.mark.slow
def test_a_true_body_that_refutes_the_certificate_is_told(folder, tmp_path, shown):
    """The recorded mesh is not; the same one a bound aside is."""
    other = scan3d.load_mesh(EGG)
    other.apply_translation([0.0, 0.05 * np.linalg.norm(other.extents), 0.0]).export(tmp_path / "other.stl")
    for mesh, says in ((EGG, ""), (tmp_path / "other.stl", "more than is certified")):
        code, _, err = shown("--truth", mesh, "--html", tmp_path / "a.html", "--overwrite")
        assert (code, says in err, bool(err)) == (0, True, bool(says))
        assert (f"refuted: {mesh}" in (tmp_path / "a.html").read_text()) is bool(says)


@pytest.mark.slow
@pytest.mark.rendering
def test_show_writes_what_it_is_asked_for_as_python_does(folder, tmp_path, shown, call):
    picture, page = tmp_path / "a.svg", tmp_path / "a.html"
    options = ["--size", "85x60mm", "--dpi", "150", "--camera", "-60,25", "--view", "compare"]
    assert shown("--screenshot", picture, "--html", page, *options) == (
        0, f"written to {page}\nwritten to {picture}\n", "",
    )  # fmt: skip
    assert page.read_bytes() == (folder / "view.html").read_bytes()
    scan3d.open(folder).plot(size="85x60mm", dpi=150, camera="-60,25", view="compare", path=tmp_path / "b.svg")
    assert picture.read_bytes() == (tmp_path / "b.svg").read_bytes()
    code, out, _ = call("show", folder / "cloud.ply", "--html", page, "--json")
    assert (code, json.loads(out)) == (0, {"shown": "cloud", "files": [str(page)]})


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ("--view bound --html x.html", "--view says what a picture shows: give --screenshot FILE as well"),
        ("--color phase --view bound --screenshot x.png", "--color is that of the contacts in the view cloud: leave"),
        ("--camera -60,95 --screenshot x.png", "a camera is front, back, .* got '-60,95'"),
        ("--against b --movie x.gif", "--against is for a picture, a page or the window: leave out --movie"),
    ],
)
def test_wrong_options_are_one_sentence(tmp_path, monkeypatch, shown, options, sentence):
    monkeypatch.chdir(tmp_path)
    code, out, err = shown(*options.split())
    assert (code, out) == (2, "")
    assert re.fullmatch(rf"scan3d: {sentence}.*; see 'scan3d show --help'\n", err)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("missing", [pytest.param(name, marks=m) for name, m in zip(MISSING, LANES, strict=True)])
def test_without_a_renderer_all_other_files_are_written(folder, tmp_path, missing):
    environment = hidden_renderer(missing, tmp_path / "lib")

    def run(*arguments):
        return subprocess.run(
            [COMMAND, *map(str, arguments)], env=environment, capture_output=True, text=True, check=False
        )

    out = tmp_path / "out"
    done = run("scan", CUBE, "--out", out, *FEW)
    assert (done.returncode, done.stderr) == (0, f"scan3d: {canvas.NO_RENDERER}\n")
    assert {path.name for path in out.iterdir()} == set(scan3d.open(out).report["files"]) == RESULTS
    page = tmp_path / "page.html"
    done = run("show", folder, "--html", page, "--screenshot", tmp_path / "picture.png")
    assert (done.returncode, done.stderr) == (1, f"scan3d: {canvas.NO_RENDERER}\n")
    assert page.exists()
    assert not (tmp_path / "picture.png").exists()


@pytest.mark.rendering
@pytest.mark.slow
def test_the_difference_of_two_results(folder, tmp_path, shown, call):
    picture, other = tmp_path / "difference.png", tmp_path / "other"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(canvas, "can_render", lambda *_: False)
        recording = folder / "recording.csv"
        assert call("reconstruct", recording, "--out", other, "--method", "hull", "--quiet")[0] == 0
    assert shown("--screenshot", picture, "--html", tmp_path / "a.html", "--against", other)[0] == 0
    assert "signed distance from the other surface in mm" in (tmp_path / "a.html").read_text()
    # in Python the same
    result = scan3d.open(folder)
    np.testing.assert_array_equal(pixels(picture), np.asarray(result.plot(against=other / "surface.ply")))
    charts = [result.plot(against=given, view="histogram") for given in (scan3d.open(other), other / "surface.ply")]
    np.testing.assert_array_equal(*map(np.asarray, charts))
    assert result.plot(against=EGG, view="histogram").size == (1400, round(1400 / 2.3))


@pytest.mark.slow
@pytest.mark.rendering
@pytest.mark.parametrize("spatial", [False, True])
def test_the_window(spatial):
    scene, sentences = scanned_in_space() if spatial else scanned(EGG), []
    built = canvas.Window(scene, sentences.append, "bending" if spatial else "phase", off_screen=True)
    try:
        lines = ["contact paths"] if spatial else ["slices"]
        truth = [] if spatial else ["truth"]
        assert list(built.layers) == ["surface", *truth, "contacts", "normals", *lines, "rods"]
        visible = {name: all(actor.GetVisibility() for actor in actors) for name, actors in built.layers.items()}
        assert visible == {name: name in ("surface", "contacts") for name in built.layers}
        assert all(built.layers.values())
        built.switch("rods", True)
        assert built.layers["rods"][0].GetVisibility()
        for color in ("bending" if spatial else "phase", "force"):
            assert np.array_equal(built.contacts["rgb"], parts.shade_contacts(scene, color, parts.ON_DEVIATION).rgb)
            built.paint("force")
        built.pick(scene.points[17])
        built.pick(scene.points[17] + 100.0)
        assert sentences == [contact_sentence(scene, 17)]
    finally:
        built.plotter.close()


@pytest.mark.parametrize("display", [None, ":98765"])
def test_without_a_display_there_is_no_window(shown, monkeypatch, display):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if display:
        monkeypatch.setenv("DISPLAY", display)
    monkeypatch.setattr(canvas.sys, "platform", "linux")
    canvas.can_open.cache_clear()
    try:
        assert shown() == (1, "", f"scan3d: {canvas.NO_DISPLAY}\n")
        with pytest.raises(
            scan3d.InputError, match="there is no display to open a window on; write a picture with --scr"
        ):
            canvas.need_display()
    finally:
        canvas.can_open.cache_clear()
