"""Movies: the body grows slice by slice."""

import sys
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence
from small_scans import EGG, scanned, scanned_in_space

import scan3d
from scan3d.pictures import canvas, views

SIZE = (980, 560)


def images(path):
    with Image.open(path) as film:
        assert film.size == SIZE
        return [np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(film)]


@pytest.mark.slow
@pytest.mark.rendering
@pytest.mark.parametrize("make", [lambda: scanned(EGG), scanned_in_space], ids=["planar", "spatial"])
def test_growth(make, tmp_path):
    # the rod is seen in every frame, and not without a recording
    views.movie(make(), tmp_path / "rod.gif", frames=2)
    views.movie(replace(make(), recording=None), tmp_path / "growth.gif", frames=3)
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


@pytest.mark.slow
@pytest.mark.rendering
def test_the_same_scene_gives_the_same_movie(egg, tmp_path):
    for name in ("a.gif", "b.gif"):
        views.movie(egg, tmp_path / name, frames=2)
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()


@pytest.mark.rendering
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
    views.movie(egg, tmp_path / "a.mp4", frames=3)
    # images as ffmpeg takes them; the last one is held
    assert {(image.shape, image.dtype) for image in written} == {((560, 980, 3), np.dtype(np.uint8))}
    assert all(image.flags["C_CONTIGUOUS"] for image in written)
    assert np.array_equal(written[-1], written[-2])
    assert not np.array_equal(written[0], written[1])


def test_movies_that_can_not_be_made(egg, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)  # importing it fails
    monkeypatch.setattr(canvas, "can_render", lambda: False)
    for change, name, sentence in (
        ({}, "x.avi", r"a movie is written as \.gif or \.mp4, got 'x\.avi'"),
        ({}, "x.mp4", "an .mp4 needs .*: 'pip install imageio-ffmpeg'; or write a .gif"),
        (dict(contacts=None), "x.gif", "egg does not say which slices its contacts lie in"),
        ({}, "x.gif", "nothing here can render off screen"),
    ):
        with pytest.raises(scan3d.InputError, match=sentence):
            views.movie(replace(egg, **change), tmp_path / name)
        assert not list(tmp_path.iterdir())
