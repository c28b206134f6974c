"""A scene in words: key figures and what was measured at a contact."""

import json
from dataclasses import replace

import numpy as np
import pytest
from small_scans import EGG, scanned, scanned_folder

import planar
from scan3d.pictures.words import contact_sentence, key_figures


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
    assert key_figures({}) == ()


def test_the_sentence_of_a_contact(egg):
    contact = int(np.flatnonzero(egg.column("phase") == planar.Phase.TANGENTIAL)[0])
    sentence = contact_sentence(egg, contact)
    assert sentence.startswith(f"contact {contact}: ({egg.points[contact][0]:.6g}, ")
    for part in ("mm, sweep 0, slice 0, tangential contact, force ", " mN, friction 0.", "normal ("):
        assert part in sentence
    points_only = replace(egg, contacts=egg.contacts[["x", "y", "z"]])
    assert contact_sentence(points_only, 0) == "contact 0: ({:.6g}, {:.6g}, {:.6g}) mm".format(*egg.points[0])
