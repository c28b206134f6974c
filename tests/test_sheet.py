"""Size, resolution and camera of pictures, as they are given."""

import numpy as np
import pytest

import scan3d
from scan3d import memory
from scan3d.choices import CAMERAS
from scan3d.pictures.sheet import Camera, Sheet, sheet


@pytest.mark.parametrize(
    ("size", "dpi", "inches"),
    [
        (None, None, (7.0, None)),
        ("85mm", None, (85 / 25.4, None)),
        ("85x60mm", 300, (85 / 25.4, 60 / 25.4)),
        (" 8.5 X 6 CM ", 600, (85 / 25.4, 60 / 25.4)),
        ("3.5×2.5in", 300, (3.5, 2.5)),
        ("240x180pt", 300, (240 / 72, 2.5)),
        ("1200x900px", 300, (4.0, 3.0)),
        ("1200x900px", 200, (6.0, 4.5)),
        (".3x.2in".replace(".3", "3.").replace(".2", "2."), 200, (3.0, 2.0)),
    ],
)
def test_sizes(size, dpi, inches):
    given = sheet(size, dpi)
    assert (given.width, given.height) == pytest.approx(inches) if inches[1] else (given.width, None)
    assert given.width == pytest.approx(inches[0])
    assert given.dpi == (dpi or 200)


def test_letters_are_those_of_a_column_and_keep_to_what_journals_ask_for():
    assert Sheet().font == 12
    assert sheet("85mm").font == 8
    assert sheet("150mm").font == pytest.approx(12 * 150 / 25.4 / 7)
    assert sheet("300mm").font == 12
    # points and lines are in proportion to letters, whatever the resolution
    assert sheet("85mm", 600).scale == pytest.approx(3 * sheet("85mm", 200).scale)
    assert Sheet().scale == 1


@pytest.mark.parametrize(
    "size", ["85", "85 60", "85x60", "x60mm", "85x60x40mm", "-85mm", "85em", "", "wide", "85x60mm ."]
)
def test_what_is_no_size(size):
    with pytest.raises(
        scan3d.InputError,
        match=r"the size of a picture is WIDTH or WIDTHxHEIGHT with a unit .*such as 85mm or 85x60mm, got '",
    ):
        sheet(size)


@pytest.mark.parametrize(
    ("size", "got"),
    [
        ("10mm", "'10mm'"),
        ("85x10mm", "'85x10mm'"),
        ("0x0mm", "'0x0mm'"),
        ("3000mm", "'3000mm'"),
        ("100px", "'100px' at 200"),
    ],
)
def test_sizes_that_no_picture_can_have(size, got):
    with pytest.raises(
        scan3d.InputError, match=rf"a picture is at least 50 mm wide and 35 mm high, and at most 2540 mm, got {got}"
    ):
        sheet(size)


@pytest.mark.parametrize("dpi", [0, -300, 49, 2401, "fine", "", "300.5", 1e400, float("nan"), None.__class__])
def test_what_is_no_resolution(dpi):
    with pytest.raises(scan3d.InputError, match="a whole number of dots per inch from 50 to 2400, such as 300, got"):
        sheet(dpi=dpi)


def test_pictures_of_too_many_pixels(monkeypatch):
    assert sheet("85mm", 2400).sampling == 1
    with pytest.raises(
        scan3d.InputError, match="at most 8192 pixels along a side, and this one would have 16800; choose"
    ):
        sheet(dpi=2400)
    monkeypatch.setattr(memory, "memory_bytes", lambda: 10**8)
    with pytest.raises(
        scan3d.InputError, match=r"a picture of 4200 x 3150 pixels needs about .* choose a smaller size or res"
    ):
        sheet(dpi=600)


def test_cameras():
    assert sheet().camera is None
    assert sheet(camera="300,25").camera == Camera(300, 25, 1)
    assert sheet(camera=" -60 , 25.5, 1.5").camera == Camera(-60, 25.5, 1.5)
    assert sheet(camera="Top,2").camera == Camera(-90, 90, 2)
    seen_from = {
        "front": (0, -1, 0), "back": (0, 1, 0), "left": (-1, 0, 0), "right": (1, 0, 0), "top": (0, 0, 1), "bottom": (0, 0, -1),
        "iso": np.array([1, -1, 1]) / np.sqrt(3),
    }  # fmt: skip
    assert set(seen_from) == set(CAMERAS)
    for name, direction in seen_from.items():
        np.testing.assert_allclose(sheet(camera=name).camera.toward, direction, atol=1e-15)


@pytest.mark.parametrize("azimuth", [-90.0, 0.0, 37.0, 300.0])
@pytest.mark.parametrize("elevation", [-90.0, -20.0, 0.0, 60.0, 90.0])
def test_a_camera_stands_upright(azimuth, elevation):
    camera = Camera(azimuth, elevation)
    toward, up = np.array(camera.toward), np.array(camera.up)
    assert np.linalg.norm(toward) == pytest.approx(1)
    assert np.linalg.norm(up) == pytest.approx(1)
    assert toward @ up == pytest.approx(0, abs=1e-15)
    assert up[2] == pytest.approx(np.cos(np.deg2rad(elevation)), abs=1e-15)
    # to the right the picture has a horizontal direction
    assert np.cross(up, toward)[2] == pytest.approx(0, abs=1e-15)


@pytest.mark.parametrize(
    "camera",
    [
        "",
        "above",
        "30",
        "30,",
        "30,91",
        "30,-91",
        "361,0",
        "30,20,0",
        "30,20,1000",
        "30,20,1,1",
        "nan,0",
        "top,,2",
        "top,1,1",
    ],
)
def test_what_is_no_camera(camera):
    with pytest.raises(
        scan3d.InputError, match=r"a camera is front, back, .* iso, or AZIMUTH,ELEVATION in degrees .*, got '"
    ):
        sheet(camera=camera)
