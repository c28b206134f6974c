"""Scans in space: their plans, the sweeps that are chosen, the recording, and the command."""

import json

import numpy as np
import pytest
from shapes import unit
from small_scans import CUBE, undrawn

import scan3d
from scan3d.cli import main
from scan3d.geometry.distance import nearest
from scan3d.planning import plan as aims


@pytest.fixture(scope="module")
def cube():
    return scan3d.load_mesh(CUBE)


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    out = tmp_path_factory.mktemp("space") / "out"
    few = ["--slices", "2", "--sweeps", "4", "--samples", "8", "--friction", "0.0:0.4", "--method", "hull", "--quiet"]
    with undrawn():
        assert main(["scan", str(CUBE), "--out", str(out), "--model", "spatial", *few]) == 0
    return out


def test_rasters_cross_the_body(cube):
    points = np.asarray(cube.vertices) / 40
    lines = aims.rasters(points, 10, 0.3)
    assert 12 * 9 <= len(lines.origin) <= 12 * 11
    np.testing.assert_allclose(
        lines.axes @ lines.axes.swapaxes(1, 2), np.tile(np.eye(3), (len(lines.axes), 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(lines.axes), 1)
    x, y, z = lines.axes.swapaxes(0, 1)
    # the clamp keeps its distance, and its path lies beside the middle by less than the body does
    nearest_point = (points @ y.T).min(axis=0)
    np.testing.assert_allclose(nearest_point - (lines.origin * y).sum(axis=1), 0.3)
    offset, places = (lines.origin * z).sum(axis=1), points @ z.T
    assert ((offset > places.min(axis=0)) & (offset < places.max(axis=0))).all()
    # every other line runs backwards
    assert np.mean([(x[k] @ x[k + 1]) < -0.9 for k in range(len(x) - 1)]) > 0.7


def test_sweeps_are_aimed_at_a_missing_corner():
    rng = np.random.default_rng(0)
    points = unit(rng.normal(size=(4000, 3)))
    towards = np.array([0.6, 0.0, 0.8])
    felt = points[points @ towards < 0.9]
    lines = aims.aimed(felt, felt, 5, rng)
    x, y, _ = lines.axes.swapaxes(0, 1)
    assert (x[0] @ towards) > 0.95
    np.testing.assert_allclose((x * y).sum(axis=1), 0, atol=1e-12)
    # the rod's straight line touches the sphere's gap from outside
    foot = lines.origin[0] - (lines.origin[0] @ y[0]) * y[0]
    assert 0.85 < np.linalg.norm(foot) < 1


@pytest.mark.slow
def test_recordings_have_six_axes_and_touch_the_fattened_body(scanned, cube):
    recording = scan3d.read_recording(scanned / "recording.csv")
    assert recording.six_axis
    assert recording.source["model"] == "spatial"
    assert recording.rod.diameter_m == pytest.approx(0.006 * recording.rod.length_m)
    assert recording.rod.length_m == pytest.approx(0.04)
    cloud = scan3d.reconstruct(recording)
    assert cloud.model == "spatial"
    assert len(cloud) > 100
    distance = nearest(cloud.centre_points, cube)[0]
    assert np.abs(distance - cloud.rod_radius).max() < 1e-9 * cloud.rod_length
    force = np.linalg.norm(recording.wrench()[0], axis=1)
    assert force.max() < 60 * recording.rod.force_unit_N
    # each sweep begins before its touch-down, and ends with the first sample after its last contact
    felt = []
    for number in np.unique(recording.sweep):
        rows = np.flatnonzero(recording.sweep == number)
        assert force[rows[0]] == 0
        felt += (force[rows[1:-1]] > 0).tolist()
    assert np.mean(felt) > 0.9
    # the sweeps of a direction move along straight lines
    longest = np.argmax(np.bincount(recording.sweep))
    step = np.diff(recording.position_m[recording.sweep == longest], axis=0)
    np.testing.assert_allclose(step, np.tile(step[0], (len(step), 1)), atol=1e-15)


@pytest.mark.slow
def test_the_command_scans_in_space(scanned, tmp_path, no_pictures):
    report = json.loads((scanned / "report.json").read_text())
    assert report["model"] == "spatial"
    assert report["warnings"] == []
    assert report["hausdorff"]["two_sided"] <= report["certificate"]["bound"]
    assert report["counts"]["slices"] == 0
    again = ["reconstruct", str(scanned / "recording.csv"), "--method", "hull", "--out", str(tmp_path / "again")]
    assert main([*again, "--truth", str(CUBE)]) == 0
    found = json.loads((tmp_path / "again" / "report.json").read_text())
    assert found["certificate"] == report["certificate"]


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param("cube.stl", marks=pytest.mark.trust), "gem.glb"])
def test_no_rod_without_thickness_lies_in_the_body_without_a_force(name):
    """Where such a rod meets vertices its equations are singular: it left the body there, or was not seen to touch."""
    mesh = scan3d.load_mesh(CUBE.with_name(name))
    length = float(np.ptp(mesh.vertices, axis=0).max())
    thin, thick = (
        scan3d.simulate(
            mesh,
            scan3d.Plan(
                model="spatial", slices=5, samples=24, friction=0.2, rod=scan3d.Rod(1.5e-3 * length, 1e-4, diameter)
            ),
        )
        for diameter in (0.0, 1e-6 * length)
    )
    assert len(np.unique(thin.sweep)) > 0.9 * len(np.unique(thick.sweep))
    free = np.linalg.norm(thin.pressing(six_axis=True), axis=1) == 0
    along = np.linspace(0.0, 1.5 * length, 200)
    places = 1e3 * thin.position_m[free, None] + along[:, None] * thin.axes()[free, None, 1]
    outside = (mesh.face_normals @ places[..., None])[..., 0] - (mesh.face_normals * mesh.triangles_center).sum(axis=1)
    assert outside.max(axis=2).min() > -1e-3 * length
