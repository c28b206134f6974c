"""A scene in words: key figures and what was measured at a contact."""

import json
from dataclasses import replace

import numpy as np
import pytest
from small_scans import EGG, scanned, scanned_folder, scanned_in_space

import planar
import scan3d
from scan3d.pictures.scene import contact_sentence, out_of_plane_deg
from scan3d.report import key_figures


@pytest.fixture(scope="module")
def egg():
    return scanned(EGG)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return scanned_folder(tmp_path_factory.mktemp("show"))


def test_key_figures_are_those_of_the_report(folder):
    report = json.loads((folder / "report.json").read_text())
    shown = dict(key_figures(report))
    assert [shown[name] for name in ("contacts", "slices", "sweeps")] == [
        str(report["counts"][name]) for name in ("contacts", "slices", "sweeps")
    ]
    assert shown["Hausdorff distance"].startswith(f"{report['hausdorff']['two_sided']:.3g} mm (")
    assert shown["size"] == "42.31 × 42.31 × 56 mm"
    # without the truth
    assert "Hausdorff distance" not in dict(key_figures({**report, "hausdorff": None}))


def test_the_sentence_of_a_contact(egg):
    contact = int(np.flatnonzero(egg.column("phase") == planar.Phase.TANGENTIAL)[0])
    sentence = contact_sentence(egg, contact)
    assert sentence.startswith(f"contact {contact}: ({egg.points[contact][0]:.6g}, ")
    for part in ("mm, sweep 0, slice 0, tangential contact, force ", " mN, friction 0.", "normal ("):
        assert part in sentence
    points_only = replace(egg, contacts=egg.contacts[["x", "y", "z"]])
    assert contact_sentence(points_only, 0) == "contact 0: ({:.6g}, {:.6g}, {:.6g}) mm".format(*egg.points[0])


def test_the_sentence_of_a_contact_in_space():
    scene = scanned_in_space()
    angle = scan3d.reconstruct(scene.recording).bending_angle
    contact = int(np.argmax(np.abs(np.sin(angle))))
    sentence = contact_sentence(scene, contact)
    assert f", bending {np.rad2deg(np.arcsin(np.sin(angle[contact]))):.1f}° out of the sweep's plane" in sentence
    assert "slice" not in sentence


def test_the_angle_out_of_the_plane_is_small_for_rods_that_bend_backward():
    angles = np.deg2rad([0.0, 30.0, 90.0, 150.0, 180.0, -170.0, -90.0, -10.0])
    assert out_of_plane_deg(angles) == pytest.approx([0, 30, 90, 30, 0, -10, -90, -10], abs=1e-9)
