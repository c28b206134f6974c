"""Outer and inner bodies of bodies without fine features, against the Cassini oval turned about its axis."""

import functools
import json
import os
import re
from dataclasses import replace

import numpy as np
import pytest
from rings import cassini, recording_of

import scan3d
from scan3d import pipeline
from scan3d.bounds import grids
from scan3d.bounds import reach as module
from scan3d.bounds.reach import reach
from scan3d.errors import InputError
from scan3d.geometry.distance import Search
from scan3d.pipeline import analyse, write
from scan3d.reconstruction.contacts import contacts
from scan3d.recording import of_rows
from scan3d.report import report, summary
from scan3d.settings import settings
from tests.robustness.shot_rods import noisy

pytestmark = pytest.mark.slow
TOP = np.sqrt(18.0**2 + 19.08**2)
# one slice beyond either end, which is empty
HEIGHTS = np.linspace(-27.3, 27.3, 30)


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(grids, "AT_ONCE", 250_000)


@functools.cache
def peanut():
    recording = recording_of(cassini, HEIGHTS, samples=24)
    return recording, contacts(recording)


def distances(points, mesh):
    return Search(np.asarray(mesh.triangles)).nearest(points)[0]


def oval():
    z = TOP * np.cos(np.linspace(0, np.pi, 100))
    points = np.column_stack([cassini(z), z])
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    return np.concatenate([np.column_stack([points[:, :1] * [np.cos(t), np.sin(t)], z]) for t in turn])


def test_the_body_lies_between_the_two_and_within_the_bound():
    found = reach(*peanut(), 5.0)
    assert found.refuted is None
    assert found.unbounded is None
    surface = oval()
    for mesh, inside in ((found.outer, False), (found.inner, True)):
        assert mesh.is_watertight
        assert distances(surface, mesh).max() <= found.bound
        radius, z = np.hypot(*mesh.vertices[:, :2].T), mesh.vertices[:, 2]
        # the oval is where (r² + z² + a²)² - 4 a² z² = b⁴
        excess = (radius**2 + z**2 + 18.0**2) ** 2 - 4 * 18.0**2 * z**2 - 19.08**4
        assert ((excess < 0) == inside).all()
    true = np.pi * np.sum(cassini(np.linspace(-TOP, TOP, 1000)) ** 2) * 2 * TOP / 1000
    assert found.inner.volume < true < found.outer_volume
    assert found.volume_between == pytest.approx(found.outer.volume - found.inner.volume)
    assert found.widest[0]["volume"] < found.volume_between
    assert found.bound < 7.0  # of which the grid of 0.8 mm takes more than half


def thin():
    recording = peanut()[0]
    return replace(recording, rod=recording.rod.without_thickness())


@functools.cache
def refuted():
    return analyse(thin(), reach=12.0)


def test_the_report_has_the_bound_and_its_premise_but_none_for_a_thick_rod():
    recording, _ = peanut()
    assert recording.rod.diameter_m > 0
    found = reach(recording, scan3d.reconstruct(recording), 5.0)
    assert "grown by the rod's radius" in found.unbounded
    assert found.bound == np.inf
    analysis = analyse(thin(), reach=5.0)
    assert not analysis.warnings
    assert analysis.surface.metadata["method"] == "cut"
    certificate = report(analysis, settings={})["certificate"]
    assert 0 < certificate["bound"] == analysis.reach.bound < 7.0
    assert "without features finer than the reach" in certificate["premise"]
    assert certificate["volume_between"] == analysis.reach.volume_between
    assert certificate["volume_between_missing"] == ""
    said = dict(summary(report(refuted(), settings={}))[1])["certified"]
    assert "nothing: the body has features finer than 12 mm" in said
    without = report(replace(analysis, reach=None), settings={})["certificate"]
    assert without["volume_between"] is None
    assert "no reach is stated" in without["volume_between_missing"]


def test_nothing_is_proven_by_a_reach_that_is_refuted_or_a_recording_that_is_contradicted(
    tmp_path, no_pictures, undiagnosed
):
    below = replace(thin(), table_m=float(thin().position_m[:, 2].min()) + 3e-3)  # the table is above contacts
    for name, analysis, why in (
        ("refuted", refuted(), "features finer than 12 mm"),
        ("contradicted", analyse(below, reach=5.0), "the recording contradicts the model"),
    ):
        write(analysis, tmp_path / name, settings={"method": "auto"})
        certificate = json.loads((tmp_path / name / "report.json").read_text())["certificate"]
        assert why in certificate["volume_between_missing"]
        assert [certificate[key] for key in ("bound", "outer_volume", "volume_between")] == [None] * 3
        # a refuted reach leaves the contours in the slices
        assert certificate["confidence"] == (1.0 if name == "refuted" else None)
        assert not {*os.listdir(tmp_path / name)} & {"outer.ply", "inner.ply"}


def test_a_reach_that_the_waist_does_not_have_is_refuted():
    found = refuted().reach
    assert "contacts lie outside the outer body" in found.refuted
    assert found.bound == np.inf
    assert found.unbounded is None


@functools.cache
def two_balls(noise=0.0):
    """Radius, in mm, of two balls with a fillet of 8 mm between them; circles of 15 mm, 16 mm apart."""
    ball, fillet, half = 15.0, 8.0, 8.0
    away = np.sqrt((ball + fillet) ** 2 - half**2)

    def radius(z):
        z = np.abs(np.asarray(z, dtype=float))
        of_ball = np.sqrt(np.maximum(ball**2 - (z - half) ** 2, 0.0))
        return np.where(z < half * fillet / (ball + fillet), away - np.sqrt(np.maximum(fillet**2 - z**2, 0.0)), of_ball)

    recording = recording_of(radius, np.linspace(-24.2, 24.2, 26), samples=18)
    if noise:
        recording = noisy(recording, noise, np.random.default_rng(0))
    return recording, contacts(recording)


@functools.cache
def of_fillet(R):
    return reach(*two_balls(), R)


def test_a_reach_that_a_fillet_does_not_have_is_refuted():
    """Balls that touch at a contact tell more than the two bodies, whose grid hides 1 mm: the fillet has 8 mm."""
    assert not of_fillet(7.6).refuted
    assert "contacts lie where no two balls of this radius touch" in of_fillet(9.6).refuted


def test_without_slices_beyond_its_ends_nothing_bounds_the_body():
    inner = of_rows(peanut()[0], np.abs(peanut()[0].position_m[:, 2]) < 0.027)
    found = reach(inner, contacts(inner), 5.0)
    assert found.refuted is None
    assert "nothing bounds the body towards" in found.unbounded
    sides, why = found.unbounded.split("towards ")[1].split(": ")
    assert {"-z", "+z"} <= {*sides.split(", ")}
    assert "no slice without contact lies beyond the body's end" in why
    assert found.bound == np.inf
    assert not len(found.outer.faces)  # an open surface would contain nothing


def test_noise_that_lets_balls_through_is_named():
    """The same slices bound the body without noise."""
    exact, found = of_fillet(7.6), reach(*two_balls(3e-3), 7.6)
    assert exact.unbounded is None
    assert exact.outer.is_watertight
    assert found.refuted is None
    assert "that noise moves by up to" in found.unbounded
    assert not len(found.outer.faces)


def test_a_reach_finer_than_the_slices_are_apart_bounds_nothing(monkeypatch):
    monkeypatch.setattr(module, "_COARSEST", 0.5)
    found = reach(*peanut(), 0.6)
    assert found.refuted is None
    assert found.bound == np.inf


def test_a_reach_is_positive_and_not_too_fine_for_the_grid():
    for wrong in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match="positive number"):
            reach(*peanut(), wrong)
    assert "a reach of 100 µm is too fine for a body of this size" in reach(*peanut(), 0.1).unbounded


@pytest.mark.parametrize("extent", [(40, 40, 40), (60, 60, 0.5), (100, 100, 0.01), (200, 0.1, 0.1)])
def test_the_least_reach_that_is_advised_is_one_although_the_cells_grow_with_it(extent):
    places = np.array([(0, 0, 0), extent])
    least = re.search(r"at least ([\d.]+) (µm|mm)", module.too_fine(places, 1e-4, 0.0, "mm"))
    assert module.too_fine(places, float(least[1]) / {"µm": 1000, "mm": 1}[least[2]], 0.0, "mm") is None


def test_a_scan_says_before_it_begins_that_a_reach_is_too_fine(monkeypatch):
    said = []
    monkeypatch.setattr(pipeline, "simulate_judged", lambda *_: said.append("simulating") or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        pipeline.scan("meshes/hollow/peanut.stl", settings({"reach": 0.01}), notify=said.append)
    assert "the reach will bound nothing: a reach of 10 µm is too fine for a body of this size" in said[0]
    assert said[1:] == ["simulating"]
    # a convex body is bounded without it
    said.clear()
    with pytest.raises(ZeroDivisionError):
        pipeline.scan("meshes/egg.stl", settings({"reach": 0.01}), notify=said.append)
    assert said == ["simulating"]
