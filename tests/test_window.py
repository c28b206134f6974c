"""The window: its layers, colours and contacts, and what happens where there is no display."""

import numpy as np
import pytest
from small_scans import EGG, scanned, scanned_folder, scanned_in_space

import scan3d
from scan3d.cli import main
from scan3d.pictures import shading, window
from scan3d.pictures.scene import contact_sentence


@pytest.fixture(scope="module")
def egg():
    return scanned(EGG)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return scanned_folder(tmp_path_factory.mktemp("show"))


@pytest.mark.rendering
def test_the_window(egg):
    sentences = []
    built = window.Window(egg, sentences.append, "phase", off_screen=True)
    try:
        assert list(built.layers) == ["surface", "truth", "contacts", "normals", "slices", "rods"]
        visible = {name: all(actor.GetVisibility() for actor in actors) for name, actors in built.layers.items()}
        assert visible == {name: name in ("surface", "contacts") for name in built.layers}
        assert all(built.layers.values())
        built.switch("truth", True)
        assert built.layers["truth"][0].GetVisibility()
        assert np.array_equal(built.contacts["rgb"], shading.shade_contacts(egg, "phase").rgb)
        built.paint("force")
        assert np.array_equal(built.contacts["rgb"], shading.shade_contacts(egg, "force").rgb)
        built.pick(egg.points[17])
        built.pick(egg.points[17] + 100.0)
        assert sentences == [contact_sentence(egg, 17)]
    finally:
        built.plotter.close()


@pytest.mark.rendering
def test_the_window_of_a_scan_in_space():
    scene = scanned_in_space()
    built = window.Window(scene, print, "bending", off_screen=True)
    try:
        assert list(built.layers) == ["surface", "contacts", "normals", "contact paths", "rods"]
        assert all(built.layers.values())
        assert np.array_equal(built.contacts["rgb"], shading.shade_contacts(scene, "bending").rgb)
    finally:
        built.plotter.close()


def test_without_a_display_there_is_no_window(folder, monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(window.sys, "platform", "linux")
    window.can_open.cache_clear()
    try:
        assert main(["show", str(folder)]) == 1
    finally:
        window.can_open.cache_clear()
    assert capsys.readouterr().err == (
        "scan3d: there is no display to open a window on; write a picture with --screenshot FILE, or a page with --html FILE\n"
    )
    monkeypatch.setattr(window, "can_open", lambda: False)
    with pytest.raises(scan3d.InputError, match="there is no display to open a window on"):
        window.open_window(scanned(EGG), print)
