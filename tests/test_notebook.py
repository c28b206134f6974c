"""Notebooks: results show themselves as tables with a small picture, and nothing crashes where nothing can be rendered."""

import base64
import io
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image
from small_scans import CUBE, EGG, scanned

import planar
import scan3d
from scan3d.pictures import canvas
from scan3d.units import number


@pytest.fixture(scope="module")
def recording():
    return scanned(CUBE).recording


@pytest.fixture(scope="module")
def cloud(recording):
    return scan3d.reconstruct(recording)


@pytest.fixture(scope="module")
def surface():
    return scanned(CUBE).surface


def read(text):
    """Rows of cells, by their first one, the pictures, and the text; an error for tags that are not closed in order."""
    root = ElementTree.fromstring("<div>" + re.sub(r"(<img[^>]*)>", r"\1/>", text) + "</div>")
    rows = [["".join(cell.itertext()) for cell in row] for row in root.iter("tr")]
    return dict(rows), [picture.attrib for picture in root.iter("img")], "".join(root.itertext())


def embedded(picture):
    kind, _, data = picture["src"].partition(",")
    assert kind == "data:image/png;base64"
    with Image.open(io.BytesIO(base64.b64decode(data))) as image:
        assert image.size == (int(picture["width"]), int(picture["height"]))
        return np.asarray(image.convert("RGB")).astype(int)


@pytest.mark.slow
def test_a_recording_shows_itself(recording):
    rows, pictures, _ = read(recording._repr_html_())
    with_force = int(np.any(recording.force_N != 0, axis=1).sum())
    assert with_force < len(recording)
    assert rows["samples"] == f"{len(recording)}, {with_force} with a force"
    assert rows["sweeps"] == str(len(np.unique(recording.sweep)))
    assert rows["normals of the slices"] == "(0, 0, 1)"
    assert rows["rod"].startswith(f"{1e3 * recording.rod.length_m:.4g} mm long, EI = ")
    assert rows["noise"] == "none"
    assert rows["clamp from"].endswith(" mm")
    assert rows["source: kind"] == "simulation"
    # reactions as lines on white paper: violet to yellow
    image = embedded(pictures[0])
    assert image.shape == (500, 700, 3)
    assert (image[:5] == 255).all()
    assert 0.01 < (np.ptp(image, axis=2) > 60).mean() < 0.3


@pytest.mark.slow
@pytest.mark.rendering
def test_a_cloud_shows_itself(cloud):
    rows, pictures, text = read(cloud._repr_html_())
    tips = int((cloud.phase == planar.Phase.TIP).sum())
    assert rows["contacts"] == f"{len(cloud)}: {len(cloud) - tips} tangential, {tips} at the tip"
    assert rows["slices"] == f"{len(np.unique(cloud.slice))} with contacts of {len(cloud.slice_height)}"
    assert rows["size"] == " × ".join(f"{extent:.4g}" for extent in np.ptp(cloud.points, axis=0)) + " mm"
    assert rows["friction"].startswith(f"{number(np.nanmedian(cloud.friction))} (median; 0.1")
    assert "position noise" not in rows
    assert "render" not in text
    # the body in the middle, the bar at the right
    image = embedded(pictures[0])
    assert image.shape[1] == 700
    height = image.shape[0]
    assert (image[height // 3 : height // 2, 200:300] < 250).all()
    colored = (np.ptp(image[:, 560:], axis=2) > 60).mean(axis=0)
    assert colored.max() > 0.6
    assert (colored > 0.6).sum() > 10
    assert len(base64.b64decode(pictures[0]["src"].partition(",")[2])) < 300_000


def test_clouds_without_a_renderer_and_without_contacts_are_tables(cloud, no_pictures):
    rows, pictures, text = read(replace(cloud, noise=0.1, unit="um")._repr_html_())
    assert pictures == []
    assert canvas.NO_RENDERER in text
    assert rows["position noise"] == "100 nm (standard deviation)"
    with pytest.raises(scan3d.InputError, match="nothing here can render off screen"):
        cloud.plot()
    rows, pictures, _ = read(cloud.select(np.zeros(len(cloud), dtype=bool))._repr_html_())
    assert rows["contacts"] == "0: 0 tangential, 0 at the tip"
    assert pictures == []


def test_what_can_not_be_plotted(recording, cloud, surface, monkeypatch):
    monkeypatch.setattr(canvas, "can_render", lambda *_: True)  # it is refused before anything is drawn
    mesh = scanned(CUBE).truth
    for what, options, sentence in (
        ([1, 2], {}, r"only a recording, a cloud or a surface \(trimesh.Trimesh\) can be plotted, got a list"),
        (surface, dict(unit="ell"), "unit must be one of m, cm, mm, um, in, got 'ell'"),
        (cloud, dict(color="error"), "the error of the contacts of the cloud is not known"),
        (cloud, dict(view="explain"), "the cloud has no recording, which rods are drawn from"),
        (surface, dict(truth=CUBE), "truth must be a trimesh.Trimesh.*load_mesh.*got a \\w+Path"),
        (surface, dict(against=str(EGG)), r"against must be a trimesh\.Trimesh"),
        (surface, dict(against=mesh, view="bound"), "surfaces are compared in the views surface, compare or histogram"),
        (recording, dict(path="a.jpg"), r"a picture is written as \.png, \.pdf or \.svg, got 'a\.jpg'"),
        (recording, dict(camera="top"), "the view forces shows no body, so that it has no camera"),
    ):
        with pytest.raises(scan3d.InputError, match=sentence):
            scan3d.plot(what, **options)
