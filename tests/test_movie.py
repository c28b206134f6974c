"""Movies: the body grows slice by slice."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image, ImageSequence
from small_scans import EGG, ring, scanned, scanned_in_space

import scan3d
from scan3d.pictures import canvas, views

SIZE = (980, 560)


def images(path):
    with Image.open(path) as film:
        assert film.size == SIZE
        return [np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(film)]


@pytest.mark.slow
@pytest.mark.rendering
@pytest.mark.parametrize("make", [lambda: scanned(EGG), scanned_in_space, ring], ids=["planar", "spatial", "hollow"])
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


def test_movies_that_can_not_be_made(egg, tmp_path, monkeypatch):
    monkeypatch.setattr(canvas, "can_render", lambda *_: False)
    for change, name, sentence in (
        ({}, "x.mp4", r"a movie is written as \.gif, got 'x\.mp4'"),
        (dict(contacts=None), "x.gif", "egg does not say which slices its contacts lie in"),
        ({}, "x.gif", "nothing here can render off screen"),
    ):
        with pytest.raises(scan3d.InputError, match=sentence):
            views.movie(replace(egg, **change), tmp_path / name)
        assert not list(tmp_path.iterdir())
