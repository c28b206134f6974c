"""Movies: the rod of a sweep with its reactions growing beside it, and the body growing slice by slice."""

import re
import sys
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from image_checks import of_color
from PIL import Image, ImageSequence
from small_scans import CUBE, EGG, scanned, scanned_in_space

import scan3d
from scan3d.cli import main, show
from scan3d.pictures import movie, rendering, shading
from scan3d.pictures.parts import evenly_chosen

SIZE = (980, 560)
LEFT, RIGHT = (slice(0, 500), slice(0, 550)), (slice(0, 500), slice(640, 980))


@pytest.fixture(scope="module")
def egg():
    return scanned(EGG)


def images(path):
    with Image.open(path) as film:
        assert film.size == SIZE
        return [np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(film)]


def test_a_sweep(egg, tmp_path):
    movie.movie(egg, tmp_path / "sweep.gif", frames=6)
    shown = images(tmp_path / "sweep.gif")
    assert len(shown) == 6
    for image in shown:
        assert (image[:5] == 255).all()
        assert of_color(image[LEFT], shading.BODY).mean() > 0.05
        assert of_color(image[LEFT], shading.ROD).sum() > 200
    # the trace of contacts and the curves grow
    traces = [of_color(image[LEFT], shading.TANGENTIAL).sum() for image in shown]
    curves = [of_color(image[RIGHT], shading.ROD).sum() for image in shown]
    assert np.all(np.diff(traces) > 0)
    assert np.all(np.diff(curves) > 0)


def test_the_rod_moves_as_the_clamp_did(egg):
    # in the clamp's frame the base goes in -x: its black square in the picture to the left
    frames = list(movie._sweep_frames(egg, 5))
    squares = []
    for image in frames:
        ink = of_color(image[:500, :550].astype(int), shading.INK)
        # the square is the only black thing some pixels thick
        thick = ink[2:-2, 2:-2] & ink[:-4, 2:-2] & ink[4:, 2:-2] & ink[2:-2, :-4] & ink[2:-2, 4:]
        squares.append(np.argwhere(thick)[:, 1].mean())
    assert np.all(np.diff(squares) < 0)


def test_a_sweep_in_space(tmp_path):
    movie.movie(scanned_in_space(), tmp_path / "sweep.gif", frames=5)
    shown = images(tmp_path / "sweep.gif")
    assert len(shown) == 5
    for image in shown:
        assert (image[:5] == 255).all()
        assert of_color(image[LEFT], shading.BODY).mean() > 0.03
        assert of_color(image[LEFT], shading.ROD).sum() > 200
    # three components of force and moment, each in its colour
    for color in (shading.ROD, shading.TIP, shading.TANGENTIAL):
        curves = [of_color(image[RIGHT], color).sum() for image in shown]
        assert np.all(np.diff(curves) > 0)


@pytest.mark.rendering
def test_growth_in_space_adds_sweeps(tmp_path):
    scene = scanned_in_space()
    movie.movie(scene, tmp_path / "growth.gif", "growth", frames=3)
    shown = images(tmp_path / "growth.gif")
    size = [(image[:500] < 250).any(axis=2).sum() for image in shown]
    assert len(shown) == 3
    assert np.all(np.diff(size) > 0)


@pytest.mark.rendering
@pytest.mark.slow
def test_growth(egg, tmp_path):
    movie.movie(egg, tmp_path / "growth.gif", "growth", frames=4)
    shown = images(tmp_path / "growth.gif")
    assert len(shown) == 4
    size = [(image[:500] < 250).any(axis=2).sum() for image in shown]
    assert np.all(np.diff(size) > 0)
    assert 0.1 < size[-1] / (500 * 980) < 0.6
    # every frame by the same camera: contacts that are drawn once stay
    for before, after in zip(shown, shown[1:], strict=False):
        earlier, later = ((image[:500] < 250).any(axis=2) for image in (before, after))
        assert (earlier & ~later).sum() < 0.01 * earlier.sum()
    # the first slice's contacts alone, in red
    assert (shown[0][:500, :, 0] - shown[0][:500, :, 1] > 60).sum() > 20


def test_the_same_scene_gives_the_same_movie(egg, tmp_path):
    for name in ("a.gif", "b.gif"):
        movie.movie(egg, tmp_path / name, frames=3)
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


def test_no_more_frames_than_there_are_samples():
    assert evenly_chosen(5, 60).tolist() == [0, 1, 2, 3, 4]
    assert evenly_chosen(100, 4).tolist() == [0, 33, 66, 99]


@pytest.mark.parametrize("name", ["sweep.gif", "sweep.mp4"])
@pytest.mark.slow
def test_the_command(tmp_path, monkeypatch, capsys, name):
    recording = tmp_path / "log.csv"
    scan3d.write_recording(scanned(CUBE).recording, recording)
    written = []

    def write_frames(path, size, fps, macro_block_size, ffmpeg_log_level, output_params):
        assert (size, macro_block_size) == (SIZE, 2)
        assert output_params == ["-metadata", "comment=scan3d"]
        Path(path).touch()
        while True:
            image = yield
            written.append(image)

    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", types.SimpleNamespace(write_frames=write_frames))
    out = tmp_path / name
    assert main(["show", str(recording), "--movie", str(out)]) == 0
    assert capsys.readouterr().out == f"written to {out}\n"
    assert out.exists()
    if name.endswith("mp4"):
        # images as ffmpeg takes them; the last one is held
        assert {(image.shape, image.dtype) for image in written} == {((560, 980, 3), np.dtype(np.uint8))}
        assert all(image.flags["C_CONTIGUOUS"] for image in written)
        assert np.array_equal(written[-1], written[-2])
        assert not np.array_equal(written[0], written[1])
    else:
        assert len(images(out)) > 1


@pytest.mark.parametrize(
    ("change", "name", "of", "sentence"),
    [
        ({}, "x.gif", "dance", "a movie is of sweep or growth, got 'dance'"),
        ({}, "x.avi", "sweep", r"a movie is written as \.gif or \.mp4, got 'x\.avi'"),
        (
            {},
            "x.mp4",
            "sweep",
            "an .mp4 needs the package imageio-ffmpeg: 'pip install imageio-ffmpeg'; or write a .gif",
        ),
        (dict(recording=None), "x.gif", "sweep", "egg has no recording, which rods are drawn from"),
        (dict(contacts=None), "x.gif", "growth", "egg does not say which slices its contacts lie in"),
    ],
)
def test_movies_that_can_not_be_made(egg, tmp_path, monkeypatch, change, name, of, sentence):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # importing it fails
    with pytest.raises(scan3d.InputError, match=sentence):
        movie.movie(replace(egg, **change), tmp_path / name, of)
    assert not list(tmp_path.iterdir())


def test_growth_without_a_renderer(egg, tmp_path, monkeypatch):
    monkeypatch.setattr(rendering, "can_render", lambda: False)
    with pytest.raises(scan3d.InputError, match="nothing here can render off screen"):
        movie.movie(egg, tmp_path / "x.gif", "growth")
    # the movie of a sweep needs no renderer
    movie.movie(egg, tmp_path / "x.gif", "sweep", frames=2)


@pytest.mark.parametrize(
    ("what", "name", "sentence"),
    [
        ("movie", "x.avi", r"a movie is written as \.gif or \.mp4, got 'x\.avi'"),
        ("movie", "x.mp4", "an .mp4 needs the package imageio-ffmpeg"),
        ("screenshot", "x.bmp", r"a picture is written as \.png, \.pdf or \.svg, got 'x\.bmp'"),
    ],
)
def test_endings_are_checked_before_the_scene_is_read(tmp_path, monkeypatch, capsys, what, name, sentence):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setattr(show, "read_scene", None)  # calling it would fail in another way
    assert main(["show", "x", f"--{what}", str(tmp_path / name)]) == 1
    assert re.search(sentence, capsys.readouterr().err)


def test_a_movie_that_fails_leaves_no_file(tmp_path, monkeypatch, capsys):
    def fails(*_):
        raise scan3d.InputError("no")

    monkeypatch.setattr(movie, "movie", fails)
    assert main(["show", str(CUBE), "--movie", str(tmp_path / "x.gif")]) == 1
    assert capsys.readouterr().err == "scan3d: no\n"
    assert not list(tmp_path.iterdir())
