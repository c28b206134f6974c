"""A ball on the rod's tip: where it touches, against signed distances, and what is proven by where it has passed."""

import functools
import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import scan3d
from scan3d.bounds import grids
from scan3d.bounds.reach import reach
from scan3d.calibration.fit import calibrated
from scan3d.errors import InputError
from scan3d.files.whole import unchanged
from scan3d.geometry.crossings import first_touches
from scan3d.laboratory.one_sweep import read_sweep
from scan3d.pipeline import analyse, write
from scan3d.planning.probing import Probings
from scan3d.planning.rig import RigPlan, parse_envelope, plan_poses
from scan3d.reconstruction.probings import passed_in_probings
from scan3d.recording import SIX_AXES
from scan3d.report import report, summary
from scan3d.rods import Rod
from scan3d.settings import Settings
from scan3d.simulation import rig
from scan3d.simulation.probing import recorded_probings
from tests.robustness.probing import signed

pytestmark = pytest.mark.slow

BEAD = 2.0
"""Radius, in mm."""
ROD = Rod(0.05, 1e-4, bead_diameter_m=2e-3 * BEAD)


def bodies(rng):
    """A ring, bars close together and a torus, turned at random: faces, edges and corners."""
    bars = [trimesh.creation.box((20, 2, 2)).apply_translation((0, y, y)) for y in (-6, 0, 6)]
    for body in (trimesh.creation.annulus(8, 11, 6), trimesh.util.concatenate(bars), trimesh.creation.torus(10, 4)):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.random(rng=rng).as_matrix()
        yield body.apply_transform(turn)


def lattice(mesh, apart, length):
    """Probings from six sides, on a square lattice."""
    low, high = mesh.bounds[0] - 2 * BEAD, mesh.bounds[1] + 2 * BEAD
    parts = []
    for k in range(3):
        across = [np.arange(low[j], high[j] + apart, apart) for j in range(3) if j != k]
        places = np.insert(np.stack(np.meshgrid(*across), axis=-1).reshape(-1, 2), k, 0.0, axis=1)
        for sign in (-1.0, 1.0):
            along = sign * np.eye(3)[k]
            first = np.eye(3)[(k + 1) % 3]
            axes = np.broadcast_to(np.stack([first, along, np.cross(first, along)]), (len(places), 3, 3))
            begin = (low[k] if sign > 0 else high[k]) - sign * length
            travel = np.full(len(places), high[k] - low[k])
            parts.append(Probings(places + begin * np.eye(3)[k], axes, travel))
    return Probings(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def recording_of(mesh, apart=0.75 * BEAD, noise=0.0, rod=ROD, friction=(0.0, 0.4)):
    plan = scan3d.Plan(model="spatial", probing="only", rod=rod, noise=noise, friction=friction, slices=1)
    length = 1e3 * rod.length_m
    return recorded_probings(mesh, lattice(mesh, apart, length), plan, rod, length, 0)


@pytest.fixture
def coarse(monkeypatch):
    monkeypatch.setattr(grids, "AT_ONCE", 250_000)


@functools.cache
def analysed_torus():
    """Of a test with `coarse`: the analysis of a torus, with its truth."""
    mesh = trimesh.creation.torus(10, 4)
    return analyse(recording_of(mesh), mesh)


def test_balls_stop_where_they_first_touch_faces_edges_or_corners():
    rng = np.random.default_rng(0)
    for mesh in bodies(rng):
        size, radius = float(np.linalg.norm(mesh.extents)), rng.uniform(0.01, 0.1) * np.linalg.norm(mesh.extents)
        along = Rotation.random(40, rng=rng).as_matrix()[:, 0].repeat(5, axis=0)
        start = (
            trimesh.sample.sample_surface(mesh, 200, seed=1)[0]
            + rng.normal(0, 0.05 * size, (200, 3))
            - 2 * size * along
        )
        distance, normal = first_touches(mesh, start, along, radius)
        met = np.isfinite(distance)
        assert 0.5 < met.mean() < 1
        centre = start[met] + distance[met, None] * along[met]
        np.testing.assert_allclose(signed(mesh, centre), radius, atol=1e-12 * size)
        np.testing.assert_allclose(np.linalg.norm(normal[met], axis=1), 1, atol=1e-9)
        np.testing.assert_allclose(signed(mesh, centre - radius * normal[met]), 0, atol=1e-12 * size)
        # before they touch, and where they do not, they are nowhere nearer
        travel = np.where(met, distance, 4 * size)
        path = start[:, None] + (rng.uniform(0, 1, (200, 50)) * travel[:, None])[..., None] * along[:, None]
        assert signed(mesh, path.reshape(-1, 3)).min() > radius - 1e-12 * size


def test_contacts_of_a_bead_lie_on_the_body_and_its_centres_as_far_away_as_it_is_thick():
    rng = np.random.default_rng(1)
    for mesh in bodies(rng):
        recording = recording_of(mesh, apart=1.5 * BEAD)
        cloud = scan3d.reconstruct(recording)
        size = cloud.rod_length
        np.testing.assert_allclose(signed(mesh, cloud.bead_centres), BEAD, atol=1e-9 * size)
        np.testing.assert_allclose(signed(mesh, cloud.points), 0, atol=1e-9 * size)
        np.testing.assert_allclose(np.linalg.norm(cloud.points - cloud.bead_centres, axis=1), BEAD, atol=1e-9 * size)
        # friction lets the force be within its cone
        force = np.einsum("ni,nij->nj", recording.wrench()[0], recording.axes())[cloud.row]
        outward = (cloud.bead_centres - cloud.points) / BEAD
        cosine = -(force * outward).sum(axis=1) / np.linalg.norm(force, axis=1)
        assert cosine.min() >= np.cos(np.arctan(0.4)) - 1e-9
        assert cosine.min() < 0.99
        # along the axis, the bead was aside by no more than the force can bend the rod
        passed = passed_in_probings(recording, cloud)
        assert signed(mesh, passed.places(1.0)).min() > BEAD - 0.01 / 3 * size


def test_errors_of_a_bead_are_those_of_its_centre_and_of_where_it_is_touched():
    mesh = trimesh.creation.icosphere(4, radius=12.0)
    cloud = scan3d.reconstruct(recording_of(mesh, noise=1e-4))
    assert len(cloud) > 100
    for off, sd in (
        (signed(mesh, cloud.bead_centres) - BEAD, cloud.bead_sd),
        (signed(mesh, cloud.points), cloud.place_sd),
    ):
        assert (np.abs(off) <= 2 * sd).mean() > 0.9
        assert np.abs(off).max() < 5 * sd.max()
    assert (cloud.bead_sd < cloud.place_sd).all()


def test_a_body_of_any_shape_lies_where_no_bead_has_passed(coarse):
    rng = np.random.default_rng(2)
    for noise, mesh in zip((0.0, 1e-4, 0.0), bodies(rng), strict=True):
        recording = recording_of(mesh, noise=noise)
        cloud = scan3d.reconstruct(recording)
        found = reach(recording, cloud)
        assert found.refuted is None
        assert found.outer.is_watertight
        places = np.concatenate([mesh.vertices, trimesh.sample.sample_surface(mesh, 3000, seed=1)[0]])
        assert signed(found.outer, places).max() < 0
        assert mesh.volume < found.outer_volume < 0.95 * mesh.convex_hull.volume
        assert found.volume_between is None
        assert not len(found.inner.faces)
        assert "in one piece" in found.premise
        assert "from outside" in found.unbounded


def test_where_two_bars_are_closer_than_the_bead_is_thick_the_gap_is_listed(coarse):
    bars = [trimesh.creation.box((30, 6, 12)).apply_translation((0, y, 0)) for y in (-4.5, 4.5)]
    mesh = trimesh.util.concatenate([*bars, trimesh.creation.box((4, 12, 12)).apply_translation((-13, 0, 0))])
    recording = recording_of(mesh)
    found = reach(recording, scan3d.reconstruct(recording), surface=mesh)
    gap = found.widest[0]
    assert (np.abs(gap["center"]) < [10, 1, 2]).all()
    assert "narrower than the bead of 4 mm" in gap["reason"]


def test_contacts_where_the_bead_has_passed_refute_the_poses(coarse):
    mesh = trimesh.creation.icosphere(3, radius=12.0)
    recording = recording_of(mesh)
    cloud = scan3d.reconstruct(recording)
    points = cloud.points.copy()
    points[0] *= 1.5
    found = reach(recording, replace(cloud, points=points))
    assert "1 contacts lie where the bead has passed" in found.refuted
    assert found.outer_volume is None


@pytest.mark.parametrize(
    ("diameter", "apart", "words"),
    [
        (4e-4, 0.75, "the radius of a bead, 200 µm, is too fine"),
        (ROD.bead_diameter_m, 2.4, "nothing bounds the body towards .* or take a larger bead$"),
        # cells that let a bead through are named, and no noise
        (ROD.bead_diameter_m, 1.3, "the cells of 443 µm"),
    ],
)
def test_probings_whose_beads_bound_nothing_say_why(coarse, diameter, apart, words):
    rod = replace(ROD, bead_diameter_m=diameter)
    recording = recording_of(trimesh.creation.icosphere(3, radius=12.0), rod=rod, apart=apart * BEAD)
    found = reach(recording, scan3d.reconstruct(recording))
    assert re.search(words, found.unbounded)
    assert not len(found.outer.faces)


def test_report_and_summary_say_what_a_bead_proves(coarse):
    analysis = analysed_torus()
    data = report(analysis, settings={})
    certificate = data["certificate"]
    assert certificate["outer_volume"] == analysis.reach.outer_volume > trimesh.creation.torus(10, 4).volume
    assert data["rod"]["bead_diameter"] == pytest.approx(2 * BEAD)
    assert certificate["volume_between"] is None
    assert "from outside" in certificate["volume_between_missing"]
    assert certificate["confidence"] == 1
    assert "a body of any shape" in certificate["premise"]
    assert ("certified", "from outside, by the bead: the body lies in that of outer.ply") in [
        (name, words.split(";")[0]) for name, words in summary(data)[1]
    ]


def test_the_bodies_that_bound_belong_to_the_result(coarse, no_pictures, tmp_path):
    analysis = analysed_torus()
    written = write(analysis, tmp_path, settings={})
    assert unchanged(tmp_path) == set(written["files"]) >= {"outer.ply"}
    write(replace(analysis, reach=None), tmp_path, settings={})
    assert not (tmp_path / "outer.ply").exists()
    (tmp_path / "outer.ply").write_text("somebody's")
    with pytest.raises(InputError, match=r"outer\.ply"):
        write(analysis, tmp_path, settings={})


def test_a_reach_and_a_bead_add_up(coarse):
    mesh = trimesh.creation.torus(10, 4, major_sections=96, minor_sections=48)
    recording = recording_of(mesh)
    cloud = scan3d.reconstruct(recording)
    both = reach(recording, cloud, 3.5)
    assert both.refuted is None
    assert signed(both.outer, mesh.vertices).max() < 0
    assert signed(mesh, both.inner.vertices).max() < 0
    assert both.volume_between == pytest.approx(both.outer.volume - both.inner.volume)
    assert mesh.volume < both.outer_volume


def test_what_is_not_that_of_a_bead_is_refused(tmp_path):
    mesh = trimesh.creation.icosphere(2, radius=12.0)
    recording = recording_of(mesh, apart=4 * BEAD)
    swept = scan3d.simulate(mesh, scan3d.Plan(slices=1, samples=8, sweeps=2))
    swept = replace(swept, rod=replace(swept.rod, bead_diameter_m=2e-3))
    (tmp_path / "sweep.csv").write_text("x0_m,f0x_N,f0y_N,m0z_Nm\n0.01,0,0,0\n0,1e-3,1e-3,1e-5\n", encoding="utf-8")
    table = "[rod]\nlength_m = 0.05\nbending_stiffness_Nm2 = 1e-4\nbead_diameter_m = 4e-3\n"
    (tmp_path / "sweep.toml").write_text(table, encoding="utf-8")
    poses = plan_poses(RigPlan(parse_envelope("cylinder:26x14"), rod=ROD, sweeps=4))
    body = rig.standing(trimesh.creation.icosphere(2, radius=6.0))
    for call, words in (
        (lambda: scan3d.reconstruct(replace(recording, **dict.fromkeys(SIX_AXES))), "measure six axes"),
        (lambda: scan3d.reconstruct(swept), "contacts of probings only"),
        (lambda: calibrated(recording, 24.0), "calibrate it without"),
        (lambda: read_sweep(tmp_path / "sweep.csv"), r"sweep\.toml: \[rod\] bead_diameter_m"),
        (lambda: rig.simulate_rig(body, poses, rod=ROD), "a simulated rod with a bead probes"),
    ):
        with pytest.raises(InputError, match=words):
            call()


def test_a_scan_takes_a_bead():
    chosen = Settings(model="spatial", bead=3.0, slices=1, known=0.1)
    recording = scan3d.simulate(trimesh.creation.icosphere(1, radius=12.0), chosen.plan())
    assert recording.in_probings.all()
    assert recording.rod.bead_diameter_m == pytest.approx(3e-3)


def test_what_is_probed_by_a_thick_rod_bounds_the_body_that_is_grown_by_it(coarse):
    """Its contacts are off by its radius: taken as exact they certified 2.7 mm of a sphere's 3.0."""
    recording = recording_of(trimesh.creation.icosphere(4, radius=12.0), rod=replace(ROD, bead_diameter_m=0.0))
    thin, thick = (
        reach(each, scan3d.reconstruct(each), 3.5)
        for each in (recording, replace(recording, rod=replace(recording.rod, diameter_m=1e-3)))
    )
    assert np.isfinite(thin.bound)
    assert np.isinf(thick.bound)
    assert "grown by the rod's radius" in thick.unbounded
