"""Scenes from files: folders, recordings, clouds, surfaces, and files of other programs."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from small_scans import CUBE, EGG, scanned_folder, scanned_in_space

import scan3d
from scan3d import scenes
from scan3d.cli import main, show
from scan3d.files.ply import ply
from scan3d.pictures import rendering
from scan3d.pictures.parts import contact_paths, shown_sweep


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return scanned_folder(tmp_path_factory.mktemp("show"))


def test_a_stored_scan_in_space_has_all_that_its_pictures_need(tmp_path, monkeypatch):
    scene = scanned_in_space()
    scan3d.write_recording(scene.recording, tmp_path / "recording.csv")
    monkeypatch.setattr(rendering, "can_render", lambda: False)
    assert main(["reconstruct", str(tmp_path / "recording.csv"), "--out", str(tmp_path), "--quiet"]) == 0
    read, report = scenes.read_folder(tmp_path, "mm")
    assert report["model"] == "spatial"
    cloud = scan3d.reconstruct(read.recording)
    assert read.column("slice") is None
    assert "slices" not in dict(read.key_figures)
    assert read.column("bending") == pytest.approx(cloud.bending_angle, abs=1e-6)
    tangents = np.stack([read.column(f"t{axis}") for axis in "xyz"], axis=1)
    assert tangents == pytest.approx(cloud.tangents, abs=1e-6)
    sweep = shown_sweep(read)
    assert sweep.contact == pytest.approx(cloud.centre_points[cloud.sweep == sweep.number], abs=1e-9 * read.diagonal)
    assert len(contact_paths(read)) == len(contact_paths(scene))


@pytest.mark.slow
def test_the_truth_is_found_beside_the_folder_unless_it_has_changed(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    report = scenes.read_report(folder)
    assert Path(scenes.find_truth(folder, report)).samefile(folder.parent / "egg.stl")
    (tmp_path / "parts").mkdir()
    (tmp_path / "elsewhere").mkdir()
    assert scenes.find_truth(tmp_path / "elsewhere", report) is None
    (tmp_path / "parts" / "egg.stl").write_bytes(CUBE.read_bytes())
    assert scenes.find_truth(tmp_path / "elsewhere", report) is None
    (tmp_path / "parts" / "egg.stl").write_bytes(EGG.read_bytes())
    assert scenes.find_truth(tmp_path / "elsewhere", report) == "parts/egg.stl"
    assert scenes.find_truth(tmp_path / "elsewhere", {}) is None


def strings(value):
    if isinstance(value, dict):
        value = [*value, *value.values()]
    return [text for item in value for text in strings(item)] if isinstance(value, list) else [str(value)]


def test_a_report_names_no_place_outside_its_folder(folder):
    report = scenes.read_report(folder)
    assert report["mesh"]["file"] == report["source"]["mesh"] == "egg.stl"
    words = strings(dict(report))
    assert len(words) > 100
    assert not [word for word in words if ".." in word or "/" in word.replace("Hausdorff/", "") or "\\" in word]


def test_a_folder_is_shown_as_it_was_scanned(folder):
    scene = show.read_scene(folder, None, False, "mm")
    assert (scene.name, scene.unit) == ("egg", "mm")
    assert scene.truth.extents == pytest.approx(scan3d.load_mesh(EGG).extents)
    log = scan3d.read_recording(folder / "recording.csv")
    assert np.array_equal(scene.recording.force_N, log.force_N)
    assert np.array_equal(scene.points, scan3d.reconstruct(log).points)
    assert len(scene.bound) == len(scene.surface.vertices)
    assert dict(scene.key_figures)["contacts"] == str(len(scene.points))
    # a recording alone gives the same, but for the truth
    alone = show.read_scene(folder / "recording.csv", None, False, "mm")
    assert np.array_equal(alone.points, scene.points)
    assert np.asarray(alone.surface.vertices) == pytest.approx(np.asarray(scene.surface.vertices))
    assert alone.bound == pytest.approx(scene.bound, rel=1e-6)
    assert alone.truth is None


def test_plys_and_meshes(folder, tmp_path):
    cloud, surface = (show.read_scene(folder / f"{name}.ply", None, False, "in") for name in ("cloud", "surface"))
    assert cloud.unit == surface.unit == "mm"  # as the files say
    assert cloud.surface is None
    assert surface.contacts is None
    assert len(surface.bound) == len(surface.surface.vertices)

    points = np.random.default_rng(0).normal(size=(50, 3))
    trimesh.PointCloud(points).export(tmp_path / "foreign.ply")
    foreign = show.read_scene(tmp_path / "foreign.ply", None, False, "in")
    assert foreign.unit == "in"
    assert foreign.points == pytest.approx(points, rel=1e-6)
    scan3d.load_mesh(CUBE).export(tmp_path / "mesh.ply", encoding="ascii")
    for path in (CUBE, tmp_path / "mesh.ply"):
        mesh = show.read_scene(path, EGG, False, "mm")
        assert mesh.surface.extents == pytest.approx([40.0, 40.0, 40.0])
        assert mesh.truth is not None


def test_contacts_in_one_plane_are_still_shown(folder, tmp_path):
    log = scan3d.read_recording(folder / "recording.csv")
    rows = log.sweep == np.unique(log.sweep)[5]
    columns = ("sweep", "position_m", "quaternion", "force_N", "moment_Nm")
    scan3d.write_recording(replace(log, **{name: getattr(log, name)[rows] for name in columns}), tmp_path / "one.csv")
    scene = show.read_scene(tmp_path / "one.csv", None, False, "mm")
    assert scene.surface is None
    assert len(scene.points) > 3


def missing_file(place):
    return place / "nothing"


def empty_folder(place):
    (place / "empty").mkdir()
    return place / "empty"


def no_report(place):
    (place / "cloud.ply").write_bytes(b"ply\n")
    (place / "report.json").write_text("[1]")
    return place


def torn_report(place):
    (place / "report.json").write_text("{")
    return place


def surface_for_cloud(place):
    rows = np.zeros(3, dtype=[(name, "f8") for name in "xyz"])
    (place / "cloud.ply").write_bytes(ply(rows, np.array([[0, 1, 2]])))
    return place


def no_points(place):
    (place / "no_points.ply").write_bytes(ply(np.zeros(3, dtype=[("force", "f8")])))
    return place / "no_points.ply"


def points_of_nan(place):
    (place / "nan.ply").write_bytes(ply(np.full(3, np.nan, dtype=[(name, "f8") for name in "xyz"])))
    return place / "nan.ply"


def torn(place):
    (place / "torn.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n")
    return place / "torn.ply"


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (missing_file, "there is no .*nothing; show a scan's folder, a recording"),
        (empty_folder, "holds no scan: expected cloud.ply or surface.ply in it; make it with 'scan3d scan'"),
        (no_report, "is not a report: expected a JSON object; run the scan again"),
        (torn_report, "can't read .*report.json: .*; run the scan again"),
        (surface_for_cloud, "cloud.ply does not hold what its name says; run the scan again"),
        (no_points, "no_points.ply has no points: expected the columns x, y and z"),
        (points_of_nan, "nan.ply has no points, or points that are not numbers; expected a cloud of contacts"),
        (torn, "can't read .*torn.ply: .*; expected a PLY of points or triangles"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_files_that_can_not_be_shown(tmp_path, capsys, make, sentence):
    page = tmp_path / "page.html"
    assert main(["show", str(make(tmp_path)), "--html", str(page)]) == 1
    assert re.search(sentence, capsys.readouterr().err)
    assert not page.exists()
