"""Movies: the rod of a sweep with its reactions growing beside it, and the body growing slice by slice."""

import sys
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from image_checks import of_color
from PIL import Image, ImageSequence
from small_scans import EGG, scanned, scanned_in_space

import scan3d
from scan3d.pictures import movie, parts, rendering

SIZE = (980, 560)
LEFT, RIGHT = (slice(0, 500), slice(0, 550)), (slice(0, 500), slice(640, 980))


@pytest.fixture(scope="module")
def egg():
    return scanned(EGG)


def images(path):
    with Image.open(path) as film:
        assert film.size == SIZE
        return [np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(film)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "colors"),
    [(lambda: scanned(EGG), [parts.ROD]), (scanned_in_space, parts.REACTION_COLORS)],
    ids=["planar", "spatial"],
)
def test_a_sweep(make, colors, tmp_path):
    movie.movie(make(), tmp_path / "sweep.gif", frames=5)
    shown = images(tmp_path / "sweep.gif")
    assert len(shown) == 5
    for image in shown:
        assert (image[:5] == 255).all()
        assert of_color(image[LEFT], parts.BODY).mean() > 0.03
        assert of_color(image[LEFT], parts.ROD).sum() > 200
    # the trace of contacts and the curves grow, in space those of three components of force and moment
    for color, part in [(parts.TANGENTIAL, LEFT)] * (len(colors) == 1) + [(color, RIGHT) for color in colors]:
        assert np.all(np.diff([of_color(image[part], color).sum() for image in shown]) > 0)


@pytest.mark.slow
@pytest.mark.rendering
@pytest.mark.parametrize("make", [lambda: scanned(EGG), scanned_in_space], ids=["planar", "spatial"])
def test_growth(make, tmp_path):
    # the rod is seen in every frame, and not without a recording
    movie.movie(make(), tmp_path / "rod.gif", "growth", frames=2)
    movie.movie(replace(make(), recording=None), tmp_path / "growth.gif", "growth", frames=3)
    with_rod, shown = images(tmp_path / "rod.gif"), images(tmp_path / "growth.gif")
    blue = [(image[:500, :, 2].astype(int) - image[:500, :, 0] > 40).sum() for image in (*with_rod, *shown)]
    assert min(blue[:2]) > 300
    assert max(blue[2:]) == 0
    size = [(image[:500] < 250).any(axis=2).sum() for image in shown]
    assert len(shown) == 3
    assert np.all(np.diff(size) > 0)
    assert 0.1 < size[-1] / (500 * 980) < 0.6
    # every frame by the same camera: contacts that are drawn once stay
    for before, after in zip(shown, shown[1:], strict=False):
        earlier, later = ((image[:500] < 250).any(axis=2) for image in (before, after))
        assert (earlier & ~later).sum() < 0.01 * earlier.sum()


def test_the_same_scene_gives_the_same_movie(egg, tmp_path):
    for name in ("a.gif", "b.gif"):
        movie.movie(egg, tmp_path / name, frames=2)
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


def test_an_mp4_is_written_by_ffmpeg(egg, tmp_path, monkeypatch):
    written = []

    def write_frames(path, size, fps, macro_block_size, ffmpeg_log_level, output_params):
        assert (size, macro_block_size) == (SIZE, 2)
        assert output_params == ["-metadata", "comment=scan3d"]
        Path(path).touch()
        while True:
            image = yield
            written.append(image)

    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", types.SimpleNamespace(write_frames=write_frames))
    movie.movie(egg, tmp_path / "a.mp4", frames=3)
    # images as ffmpeg takes them; the last one is held
    assert {(image.shape, image.dtype) for image in written} == {((560, 980, 3), np.dtype(np.uint8))}
    assert all(image.flags["C_CONTIGUOUS"] for image in written)
    assert np.array_equal(written[-1], written[-2])
    assert not np.array_equal(written[0], written[1])


def test_movies_that_can_not_be_made(egg, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # importing it fails
    monkeypatch.setattr(rendering, "can_render", lambda: False)  # which the movie of a sweep does not need
    for change, name, of, sentence in (
        ({}, "x.gif", "dance", "a movie is of sweep or growth, got 'dance'"),
        ({}, "x.avi", "sweep", r"a movie is written as \.gif or \.mp4, got 'x\.avi'"),
        ({}, "x.mp4", "sweep", "an .mp4 needs .*: 'pip install imageio-ffmpeg'; or write a .gif"),
        (dict(recording=None), "x.gif", "sweep", "egg has no recording, which rods are drawn from"),
        (dict(contacts=None), "x.gif", "growth", "egg does not say which slices its contacts lie in"),
        ({}, "x.gif", "growth", "nothing here can render off screen"),
    ):
        with pytest.raises(scan3d.InputError, match=sentence):
            movie.movie(replace(egg, **change), tmp_path / name, of)
        assert not list(tmp_path.iterdir())
