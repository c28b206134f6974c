"""Scans in space: their plans, the sweeps that are chosen, the recording, and the command."""

import json

import numpy as np
import pytest
import trimesh
from small_scans import CUBE

import scan3d
from scan3d.cli import main
from scan3d.errors import InputError
from scan3d.geometry.distance import nearest
from scan3d.pictures import rendering
from scan3d.planning import plan as aims
from scan3d.simulation import spatial
from scan3d.spatial.bodies import RoundedPolyhedron

SMALL = dict(model="spatial", slices=8, samples=24)
TINY = dict(model="spatial", slices=4, samples=8, friction=(0.0, 0.4))


@pytest.fixture(scope="module")
def cube():
    return scan3d.load_mesh(CUBE)


@pytest.fixture(scope="module")
def tiny(cube):
    """The recording of a scan with all rounds of aimed sweeps, and what was told of its progress."""
    told = []
    return scan3d.simulate(cube, scan3d.Plan(**TINY), lambda *done: told.append(done)), told


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (dict(model="flat"), r"model must be one of planar, spatial, got 'flat'"),
        (
            dict(spacing="cosine"),
            r"spacing is a setting of slices, and the spatial model has none; leave out spacing 'cosine'",
        ),
        (dict(axis="x"), r"axis is a setting of slices"),
        (dict(axis=[0.0, 0.0, 1.0]), r"axis is a setting of slices"),
        (dict(tolerance=1e-3), r"tolerance is a setting of slices"),
    ],
)
def test_impossible_plans(given, sentence):
    with pytest.raises(InputError, match=sentence):
        scan3d.Plan(**{"model": "spatial", **given})


def test_the_directions_are_spread_evenly():
    directions = aims.icosahedron()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    cosines = np.sort(directions @ directions.T, axis=1)
    np.testing.assert_allclose(cosines[:, 6:11], 1 / np.sqrt(5))
    # none of them lies along an axis of coordinates, or in a plane of two
    assert np.abs(directions).min() > 0.02


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
    points = rng.normal(size=(4000, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    towards = np.array([0.6, 0.0, 0.8])
    felt = points[points @ towards < 0.9]
    lines = aims.aimed(felt, felt, 5, rng)
    x, y, _ = lines.axes.swapaxes(0, 1)
    assert (x[0] @ towards) > 0.95
    np.testing.assert_allclose((x * y).sum(axis=1), 0, atol=1e-12)
    # the rod's straight line touches the sphere's gap from outside
    foot = lines.origin[0] - (lines.origin[0] @ y[0]) * y[0]
    assert 0.85 < np.linalg.norm(foot) < 1


def test_sweeps_are_aimed_at_all_sides_of_a_thin_body():
    """Places whose distance is less than a long facet's size, but whose normals differ, are not one place."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 12, endpoint=False), np.linspace(-1, 1, 5))
    normals = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1).reshape(-1, 3)
    points = np.column_stack([0.02 * normals[:, :2], height.ravel()])
    _, outward = aims.open_places(points, normals, 100)
    sides = outward[np.abs(outward[:, 2]) < 0.5]
    assert len(np.unique(np.arctan2(sides[:, 1], sides[:, 0]).round(1))) >= 10


def test_no_sweep_is_aimed_at_a_flat_face_though_contacts_are_sparse_on_it():
    rng = np.random.default_rng(1)
    points = rng.uniform(-1, 1, (3000, 3))
    axis = np.argmax(np.abs(points), axis=1)
    normals = np.sign(points) * (axis[:, None] == np.arange(3))
    points = np.where(normals != 0, normals, points)
    # one face has few contacts, and two edges have a gap
    gap = (np.abs(points[:, :2]) > 0.7).all(axis=1) & (points[:, 0] > 0)
    kept = ~gap & ((normals[:, 2] < 1) | (rng.uniform(size=len(points)) < 0.01))
    unknown = np.where(rng.uniform(size=(len(points), 1)) < 0.05, np.nan, normals)
    lines = aims.aimed(points[kept], unknown[kept], 8, rng)
    place = lines.origin + aims._TOUCHED * lines.axes[:, 1]
    outside = np.sort(np.abs(place), axis=1)[:, 1] > 0.6  # near an edge or a vertex, not in the middle of a face
    assert len(place) == 8
    assert outside.all()
    assert ((np.abs(place[:, :2]) > 0.6).all(axis=1) & (place[:, 0] > 0)).sum() >= 2


def test_aimed_sweeps_touch_where_they_are_aimed(cube):
    rng = np.random.default_rng(2)
    body = RoundedPolyhedron(cube.vertices / 40, cube.faces, 0.003)
    places = rng.normal(size=(2000, 3))
    places *= 0.503 / np.abs(places).max(axis=1, keepdims=True)
    normals = np.sign(places) * (np.abs(places) == np.abs(places).max(axis=1, keepdims=True))
    lines = aims.aimed(places, normals, 10, rng)
    plan = scan3d.Plan(model="spatial", friction=0.2)
    [swept] = spatial._sweep(body, lines, plan, 1)
    touches = np.isfinite(swept.result.s1)
    first = swept.result.point[np.arange(len(touches)), touches.argmax(axis=1)]
    target = lines.origin + aims._TOUCHED * lines.axes[:, 1]
    distance = np.linalg.norm(first[:, None] - target, axis=2).min(axis=1)
    assert np.median(distance) < 0.05
    assert np.ptp(np.diff(swept.position[:, :, 0], axis=1), axis=1).min() > 0


@pytest.mark.slow
def test_recordings_have_six_axes_and_touch_the_fattened_body(tiny, cube):
    recording, _ = tiny
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
def test_the_same_seed_gives_the_same_recording(tiny, cube):
    def columns(recording):
        return np.concatenate([recording.force_N.ravel(), recording.moment_x_Nm, recording.position_m.ravel()])

    np.testing.assert_array_equal(columns(scan3d.simulate(cube, scan3d.Plan(**TINY))), columns(tiny[0]))


@pytest.mark.trust
def test_a_scan_in_space_depends_neither_on_place_nor_on_unit(cube):
    # without aimed sweeps, whose choice among equally open places rounding may decide
    plan = dict(SMALL, sweeps=3, friction=(0.0, 0.4))
    recording = scan3d.simulate(cube, scan3d.Plan(**plan))
    moved = trimesh.Trimesh(np.asarray(cube.vertices) / 1000 + [5.0, -3.0, 2.0], cube.faces, process=False)
    again = scan3d.simulate(moved, scan3d.Plan(unit="m", **plan))
    np.testing.assert_array_equal(np.unique(again.sweep), np.unique(recording.sweep))
    # where rods snap, rounding may decide when, so that the beginnings of the sweeps are compared
    rows, others = (
        np.concatenate([np.flatnonzero(r.sweep == k)[:4] for k in np.unique(r.sweep)]) for r in (recording, again)
    )
    np.testing.assert_allclose(again.position_m[others], recording.position_m[rows] + [5.0, -3.0, 2.0], atol=1e-9)
    off = np.abs(again.force_N[others] - recording.force_N[rows]).max(axis=1) / np.abs(recording.force_N).max()
    assert (off < 1e-6).mean() > 0.95


def test_a_rod_that_reaches_nothing(cube, monkeypatch):
    def distant(*arguments):
        lines = aims.rasters(*arguments)
        return lines._replace(origin=lines.origin - 2 * lines.axes[:, 1])

    monkeypatch.setattr(spatial, "rasters", distant)
    with pytest.raises(
        InputError, match=r"the rod touches nothing: its sweeps do not reach the body; choose a longer rod"
    ):
        scan3d.simulate(cube, scan3d.Plan(**SMALL))


@pytest.mark.slow
def test_the_command_scans_in_space(tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    few = ["--slices", "4", "--samples", "8", "--friction", "0.0:0.4", "--method", "hull"]
    assert main(["scan", str(CUBE), "--out", str(out), "--model", "spatial", *few]) == 0
    assert "sweeps" in capsys.readouterr().out
    report = json.loads((out / "report.json").read_text())
    assert report["model"] == "spatial"
    assert report["warnings"] == []
    assert report["hausdorff"]["two_sided"] <= report["certificate"]["bound"]
    assert report["counts"]["slices"] == 0
    header = (out / "recording.csv").read_text().splitlines()[0].split(",")
    assert {"fz_N", "mx_Nm", "my_Nm"} <= set(header)
    assert "diameter_m" in (out / "recording.toml").read_text()
    assert (out / "cloud.png").is_file() == rendering.can_render()

    monkeypatch.setattr(rendering, "can_render", lambda: False)  # the other folders need no pictures
    again = ["reconstruct", str(out / "recording.csv"), "--method", "hull", "--out", str(tmp_path / "again")]
    assert main([*again, "--truth", str(CUBE)]) == 0
    found = json.loads((tmp_path / "again" / "report.json").read_text())
    assert found["certificate"] == report["certificate"]
    capsys.readouterr()
