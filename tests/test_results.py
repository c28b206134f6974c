"""`scan3d.scan` and `scan3d.open`: the results of the command, in Python, read back from a folder, and printed."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from small_scans import CUBE, EGG, FEW, SETTINGS, undrawn

import scan3d
from scan3d.bounds import Certificate
from scan3d.cli import main
from scan3d.files.text import to_json
from scan3d.pictures import canvas
from scan3d.settings import settings

pytestmark = pytest.mark.usefixtures("no_pictures")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scans") / "out"
    with undrawn():
        return folder, scan3d.scan(EGG, folder, **SETTINGS)


def contents(folder):
    found = {path.name: path.read_bytes() for path in folder.iterdir()}
    report = json.loads(found.pop("report.json"))
    del report["timings_s"]
    return found, report


@pytest.mark.slow
def test_scan_writes_what_the_command_writes(made, tmp_path):
    folder, result = made
    assert main(["scan", str(EGG), "--out", str(tmp_path / "out"), *FEW]) == 0
    assert contents(folder) == contents(tmp_path / "out")
    assert json.loads(to_json(result.report)) == json.loads((folder / "report.json").read_text())


@pytest.mark.slow
def test_a_folder_gives_the_result_back(made):
    folder, result = made
    stored = scan3d.open(folder)
    assert isinstance(stored, scan3d.Result)
    for name in ("points", "normals", "row", "force_N", "slice_height"):
        np.testing.assert_array_equal(getattr(stored.cloud, name), getattr(result.cloud, name), err_msg=name)
    np.testing.assert_array_equal(stored.recording.force_N, result.recording.force_N)
    np.testing.assert_array_equal(stored.surface.vertices, result.surface.vertices)
    np.testing.assert_array_equal(stored.surface.faces, result.surface.faces)
    assert stored.surface.metadata["method"] == result.surface.metadata["method"]
    assert stored.certificate.bound == result.certificate.bound
    # surface.ply has the local bounds in float32
    np.testing.assert_allclose(stored.certificate.at_vertices, result.certificate.at_vertices, rtol=1e-7)
    for field in dataclasses.fields(stored.comparison):
        np.testing.assert_array_equal(
            getattr(stored.comparison, field.name), getattr(result.comparison, field.name), err_msg=field.name
        )
    assert repr(stored) == repr(result)
    assert repr(stored).startswith("Scan of egg.stl: ")
    assert len(repr(stored).splitlines()) < 11


def test_save_writes_the_same_files(made, tmp_path):
    folder, result = made
    result.save(tmp_path / "first")
    assert contents(tmp_path / "first") == contents(folder)
    scan3d.open(folder).save(tmp_path / "second")
    for path in folder.iterdir():
        assert (tmp_path / "second" / path.name).read_bytes() == path.read_bytes()
    # a file of somebody else
    (tmp_path / "second" / "cloud.ply").write_text("mine")
    with pytest.raises(scan3d.InputError, match=r"cloud\.ply was not written by scan3d or was changed since"):
        scan3d.open(folder).save(tmp_path / "second")
    scan3d.open(folder).save(tmp_path / "second", overwrite=True)
    assert (tmp_path / "second" / "cloud.ply").read_bytes() == (folder / "cloud.ply").read_bytes()


def test_scan_writes_nothing_unless_asked_to(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    result = scan3d.scan(CUBE, **SETTINGS, friction=(0.1, 0.3))
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")
    assert result.report["settings"]["friction"] == "0.1:0.3"
    assert result.report["friction"]["set"] == "0.1:0.3"
    assert set(result.report["timings_s"]) >= {"load", "simulate", "reconstruct", "compare"}
    comparison = result.report["comparison"]
    assert result.report["surface"]["volume_error"] == comparison["volume_error"]
    assert result.report["normals"]["median_deg"] == comparison["normal_median_deg"]


def test_numbers_of_numpy_are_settings():
    given = settings({"slices": np.int64(4), "friction": np.array([0.1, 0.25]), "axis": [0, 0, 1]})
    assert (given.slices, given.friction, given.axis) == (4, "0.1:0.25", "0,0,1")


def test_a_mesh_in_memory_is_scanned_as_its_file():
    mesh = scan3d.load_mesh(CUBE)
    from_file, in_memory = scan3d.scan(CUBE, **SETTINGS), scan3d.scan(mesh, **SETTINGS)
    without_times = [{**result.report, "timings_s": None} for result in (from_file, in_memory)]
    np.testing.assert_equal(*without_times)
    # the mesh and the recording are as they were before the analysis
    np.testing.assert_array_equal(mesh.vertices, scan3d.load_mesh(CUBE).vertices)
    recordings = in_memory.recording, scan3d.simulate(mesh, scan3d.Plan(**SETTINGS))
    np.testing.assert_equal(*(vars(dataclasses.replace(recording, source={})) for recording in recordings))


def test_the_steps_take_paths_and_keep_the_unit(tmp_path):
    mesh, plan = scan3d.load_mesh(CUBE, unit="in"), scan3d.Plan(**SETTINGS, unit="in")
    recording = scan3d.simulate(mesh, plan)
    scan3d.write_recording(recording, tmp_path / "log.csv")
    cloud = scan3d.reconstruct(recording)
    assert scan3d.surface(cloud, "hull").units == "in"
    for kind in (Path, str):
        assert np.array_equal(scan3d.simulate(kind(CUBE), plan).force_N, recording.force_N)
        assert np.array_equal(scan3d.reconstruct(kind(tmp_path / "log.csv")).points, cloud.points)
        assert scan3d.compare(kind(CUBE), mesh).hausdorff == scan3d.compare(mesh, kind(CUBE)).hausdorff == 0


def test_a_mesh_that_was_changed_is_no_longer_that_of_its_file():
    mesh = scan3d.load_mesh(CUBE)
    mesh.apply_scale(2.0)
    result = scan3d.scan(mesh, **SETTINGS)
    assert result.report["mesh"]["file"] is None
    assert result.report["mesh"]["sha256"] != scan3d.load_mesh(CUBE).metadata["sha256"]
    assert "mesh" not in result.recording.source
    assert result.report["mesh"]["extents"][0] == pytest.approx(2 * scan3d.load_mesh(CUBE).extents[0])
    assert repr(result).startswith("Scan: ")


def test_a_mesh_of_trimesh_is_judged_and_stored(tmp_path):
    result = scan3d.scan(trimesh.creation.box((20, 30, 40)), tmp_path / "out", **SETTINGS)
    assert result.comparison.relative < 0.05
    assert scan3d.open(tmp_path / "out").report["mesh"]["file"] is None
    with pytest.raises(scan3d.InputError, match=r"the mesh is open: .*hull=True"):
        scan3d.scan(
            trimesh.Trimesh(*(lambda torus: (torus.vertices, torus.faces[1:]))(trimesh.creation.torus(3.0, 1.0)))
        )


@pytest.fixture
def copy(made, tmp_path):
    shutil.copytree(made[0], tmp_path / "copy")
    return tmp_path / "copy"


def test_a_folder_without_a_scan(tmp_path):
    with pytest.raises(scan3d.InputError, match=r"there is no folder .*nowhere"):
        scan3d.open(tmp_path / "nowhere")
    with pytest.raises(scan3d.InputError, match=r"holds no report\.json, so it is no scan"):
        scan3d.open(tmp_path)


@pytest.mark.slow
def test_a_folder_of_a_reconstruction_holds_its_recording(made, tmp_path):
    """Also in the folder of the scan, where it is not written again."""
    log = str(made[0] / "recording.csv")
    assert main(["reconstruct", log, "--out", str(tmp_path / "out"), "--quiet"]) == 0
    stored = scan3d.open(tmp_path / "out")
    assert stored.surface.is_watertight
    assert np.isfinite(stored.certificate.bound)
    assert stored.comparison is None
    assert len(stored.cloud) == len(scan3d.open(made[0]).cloud)
    assert (tmp_path / "out" / "recording.csv").read_bytes() == (made[0] / "recording.csv").read_bytes()
    (tmp_path / "own").mkdir()
    for name in ("recording.csv", "recording.toml"):
        shutil.copy(made[0] / name, tmp_path / "own")
    own = str(tmp_path / "own")
    assert main(["reconstruct", f"{own}/recording.csv", "--out", own, "--quiet"]) == 0
    scan3d.open(own).save(tmp_path / "copy")
    assert {path.name for path in (tmp_path / "copy").iterdir()} == set(stored.report["files"])
    (tmp_path / "copy" / "recording.csv").unlink()
    with pytest.raises(scan3d.InputError, match=r"has no recording\.csv, which results have"):
        _ = scan3d.open(tmp_path / "copy").recording


def test_a_recording_of_another_run_is_refused(copy):
    log = copy / "recording.csv"
    log.write_text(log.read_text().replace("\n0,", "\n7,", 1))
    with pytest.raises(scan3d.InputError, match=r"recording\.csv is not the file that report\.json beside it names"):
        _ = scan3d.open(copy).recording


def test_the_table_without_a_renderer_says_why(made):
    assert canvas.NO_RENDERER.partition("'")[0] in made[1]._repr_html_()


@pytest.fixture
def result(made):
    return made[1]


def everything(result):
    session = scan3d.Session("cylinder:80x90")
    return {
        "recording": result.recording,
        "cloud": result.cloud,
        "surface": result.surface,
        "certificate": result.certificate,
        "comparison": result.comparison,
        "bounds": result.analysis.bounds,
        "analysis": result.analysis,
        "scan": result,
        "plan": scan3d.Plan(),
        "rod": result.recording.rod,
        "session": session,
        "poses": session.ask(),
    }


def test_everything_prints_in_ten_lines_of_120_characters(result):
    for name, thing in everything(result).items():
        lines = repr(thing).splitlines()
        assert 1 <= len(lines) <= 10, name
        assert name == "plan" or max(map(len, lines)) <= 120, name


def rows(thing):
    title, *lines = repr(thing).splitlines()
    return title, {line[2:23].strip(): line[24:] for line in lines}


def test_the_rows_hold_the_numbers_of_the_results(result):
    """Those of a recording and of a cloud are the same in a notebook, where they have tests."""
    title, comparison = rows(result.comparison)
    assert "units of the meshes" in title
    assert comparison["Hausdorff distance"].startswith(f"{result.comparison.hausdorff:.4g} (")
    _, bounds = rows(result.analysis.bounds)
    assert bounds["bound"].startswith(f"{result.analysis.bounds.bound:.4g} with 100 % confidence; parts: slices ")
    assert f"bound={result.certificate.bound:.6g}, " in repr(result.certificate)
    title, scan = rows(result)
    assert title.startswith("Scan of egg.stl: ")
    assert scan.keys() == dict(result.summary()).keys()
    assert all(value.startswith(scan[name].removesuffix("...")) for name, value in result.summary())


def test_unknown_bounds_print():
    unknown = Certificate(np.inf, np.array([np.inf, np.inf]))
    assert repr(unknown) == "Certificate(bound=inf, at_vertices: unknown at 0 of 2)"
