"""Rods that are not straight, uniform and weightless: their descriptions, files and scans; text and numbers of rods."""

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from raw_tables import POSED, si_map
from shapes import unit

import planar
import scan3d
from scan3d import Gravity, InputError, Rod
from scan3d.files.text import parse_rod, rod_section, rod_text, to_toml
from scan3d.geometry.distance import distances
from scan3d.laboratory.maps import read_map
from scan3d.reconstruction.contacts import readings
from scan3d.rods import SLENDERNESS
from scan3d.settings import settings
from scan3d.spatial import march
from tests.rigs import six_axis_recording

MESH = "meshes/egg.stl"
WIRE = Rod.wire(0.04, 0.25e-3, 210e9)
CONE = replace(WIRE, tip_diameter_m=0.1e-3)
TABLE = Rod(0.04, ((0.0, 4e-5), (0.01, 3e-5), (0.04, 1e-5)))
CURVED = replace(WIRE, curvature_per_m=-7.5)
RODS = [
    CONE,
    TABLE,
    CURVED,
    Rod(0.04, 4e-5, [[0, 3e-4], [0.04, 2e-4]]),
    replace(WIRE, clamp_compliance_rad_per_Nm=20.0),
]


@pytest.mark.parametrize("rod", RODS)
def test_scans_take_any_rod_as_an_object_a_table_and_text(rod, tmp_path):
    text = rod_text(rod)
    assert parse_rod(text) == rod
    config = tmp_path / "settings.toml"
    config.write_text(to_toml({"rod": rod_section(rod)}))
    for chosen in (settings({"rod": rod}), settings({"rod": text}), settings({}, config)):
        assert chosen.plan().rod == rod
        assert settings({"rod": chosen.rod}) == chosen


def test_descriptions_of_one_rod_agree():
    cone = CONE.in_plane()
    by_diameters = Rod(0.04, CONE.bending_stiffness_Nm2, ((0.0, 0.25e-3), (0.04, 0.1e-3))).in_plane()
    np.testing.assert_allclose(cone.profile.diameters, by_diameters.profile.diameters)
    stiffness = [(s, CONE.bending_stiffness_Nm2 * (1 - 0.6 * s / 0.04) ** 4) for s in np.linspace(0, 0.04, 5)]
    by_stiffness = Rod(0.04, tuple(stiffness)).in_plane()
    np.testing.assert_allclose(by_stiffness.profile.diameter(np.linspace(0, 1, 9)), 1 - 0.6 * np.linspace(0, 1, 9))
    assert WIRE.in_plane() == planar.Rod()
    assert WIRE.is_simple
    assert not any(rod.is_simple for rod in RODS)
    heavy = replace(WIRE, weight_N=0.05, curvature_per_m=(1.0, 2.0, 3.0)).in_space()
    assert heavy.profile.weight == pytest.approx(0.05 / WIRE.force_unit_N)
    assert heavy.curvature == pytest.approx((0.04, 0.08, 0.12))


@pytest.mark.slow
@pytest.mark.parametrize("rod", [*RODS[:2], *(pytest.param(rod, marks=pytest.mark.trust) for rod in RODS[2:])])
def test_planar_scans_with_any_rod_find_the_body(rod, tmp_path):
    mesh = scan3d.load_mesh(MESH)
    plan = scan3d.Plan(slices=4, sweeps=3, samples=24, friction=0.3, rod=rod)
    recording = scan3d.simulate(mesh, plan)
    scan3d.write_recording(recording, tmp_path / "recording.csv")
    stored = scan3d.read_recording(tmp_path / "recording.csv")
    assert any(words in str(stored) for words in ("other along the rod", "curved", "in a clamp that gives"))
    # of a tapered rod the stiffness alone, since its contacts are simulated without thickness
    assert stored.rod == (rod.without_thickness() if rod.tapered else rod)
    cloud = scan3d.reconstruct(stored)
    length, radius = 1000 * rod.length_m, 500 * stored.rod.diameter_m
    assert len(cloud) > 150
    touched = cloud.fattened if radius else cloud
    assert np.abs(distances(touched.points, mesh) - radius).max() < 1e-9 * length
    assert np.nanmedian(cloud.friction) == pytest.approx(0.3, abs=1e-6)
    # read as straight and uniform the contacts are elsewhere
    wrong = scan3d.reconstruct(replace(recording, rod=replace(WIRE, bending_stiffness_Nm2=rod.bending_stiffness_Nm2)))
    assert distances(wrong.points, mesh).max() > 1e-3 * length


@pytest.mark.slow
def test_a_heavy_curved_rod_in_space_is_read_from_its_recording(tmp_path):
    # reactions of a rod in any orientation under its weight, by the march itself with the contact's moment for its start
    rod = replace(CONE, curvature_per_m=(-3.0, 2.0, 4.0), weight_N=0.001)
    rng, n = np.random.default_rng(0), 40
    quaternion = unit(rng.normal(size=(n, 4)))
    force, moment = rng.normal(size=(2, n, 3)) * [[[0.3, 0.1, 0.3]], [[0.25, 0.03, 0.25]]]
    position = rng.normal(size=(n, 3)) * 0.01
    gravity = Gravity((0.0, 0.0, -2.0), tared=False)
    poses = np.zeros(n, int), position, quaternion

    def recording(force, moment, gravity):
        wrench = force * rod.force_unit_N, moment * rod.moment_unit_Nm
        return six_axis_recording(rod, *poses, *wrench, gravity=gravity)

    whole = recording(force, moment, gravity)
    down = whole.down()
    np.testing.assert_allclose(np.einsum("nij,ni->nj", whole.axes(), down), np.tile([0, 0, -1.0], (n, 1)), atol=1e-12)
    found = march.contacts(rod.in_space(), force.T, moment.T, down.T)
    known = found.s1 < 1
    assert known.sum() > 5
    got = readings(whole).found
    np.testing.assert_allclose(got.point[known], found.point.T[known], atol=1e-9)
    # a sensor that was tared in the air shows what the contact adds
    in_air = march.free_reactions(rod.in_space(), down.T)
    tared = recording(force - in_air[0].T, moment - in_air[1].T, replace(gravity, tared=True))
    np.testing.assert_allclose(readings(tared).found.point[known], found.point.T[known], atol=1e-9)
    scan3d.write_recording(tared, tmp_path / "tared.csv")
    back = scan3d.read_recording(tmp_path / "tared.csv")
    assert back.gravity == tared.gravity
    assert back.rod == rod
    with pytest.raises(InputError, match="needs \\[gravity\\]"):
        recording(force, moment, None)
    with pytest.raises(InputError, match="bends it out of the plane of its sweep"):
        scan3d.reconstruct(replace(whole, rod=replace(rod, curvature_per_m=-3.0)), model="planar")


def test_sweeps_of_a_body_that_is_not_convex_need_the_straight_rod():
    """They pass it in more than one way, which is known of that rod only: nothing is read of others as if it were convex."""
    plan = scan3d.Plan(slices=3, sweeps=4, samples=40, rod=CONE)
    swept = scan3d.simulate(trimesh.creation.icosphere(1, 8.0), plan)
    assert len(scan3d.reconstruct(swept)) > 0
    for rod in (CONE, CURVED, replace(CONE, curvature_per_m=-2.0)):
        stated = replace(swept, rod=rod, source={**swept.source, "convex": False})
        with pytest.raises(InputError, match="read by a straight, uniform, weightless rod"):
            scan3d.reconstruct(stated)


@pytest.mark.slow
def test_planar_scans_with_heavy_rods_find_the_body_where_gravity_lies_in_their_planes(tmp_path):
    mesh, rod = trimesh.creation.icosphere(1, 8.0), replace(WIRE, weight_N=0.1 * WIRE.force_unit_N)
    plan = scan3d.Plan(slices=1, sweeps=2, samples=12, spacing="uniform", rod=rod, gravity=Gravity((0.3, -1, 0), True))
    recording = scan3d.simulate(mesh, plan)
    scan3d.write_recording(recording, tmp_path / "recording.csv")
    stored = scan3d.read_recording(tmp_path / "recording.csv")
    # a sensor that was not tared shows the weight as well
    air = np.array([planar.free_reactions(rod.in_plane(down)) for down in recording.down()])
    force, moment = air[:, :2] * rod.force_unit_N, air[:, 2] * rod.moment_unit_Nm
    whole = replace(
        recording,
        force_N=recording.force_N + force,
        moment_Nm=recording.moment_Nm + moment,
        gravity=Gravity((0.3, -1, 0), False),
    )
    clouds = [scan3d.reconstruct(log) for log in (stored, whole)]
    for cloud in clouds:
        assert len(cloud) >= 20
        off = distances(cloud.fattened.points, mesh) - 500 * rod.diameter_m
        assert np.abs(off).max() < 1e-9 * 1000 * rod.length_m
        assert np.nanmedian(cloud.friction) == pytest.approx(0.3, abs=1e-6)
    np.testing.assert_array_equal(*(cloud.row for cloud in clouds))


def test_maps_state_gravity(tmp_path):
    def stated(air, **tared):
        rod = Rod(0.06, 1e-4, weight_N=1e-3)
        return si_map(rod, tare={"air": air}, gravity={"direction": [0, 0, -1], **tared})

    with pytest.raises(InputError, match="tared is missing"):  # nothing is taken off: only the laboratory knows
        read_map(stated("none"))
    for air, tared, result in (("none", False, False), ("none", True, True), ("auto", False, True)):
        assert read_map(stated(air, tared=tared)).gravity == Gravity((0.0, 0.0, -1.0), tared=result)
    assert read_map(stated("auto")).gravity.tared
    # and recordings have it
    rows = [f"0,{x},0,0,1,0,0,0,0,{-1e-3 if x else -2e-3},0,0,0,{1e-5 * x}" for x in (0.0, -1.0, -2.0)]
    (tmp_path / "log.csv").write_text("\n".join([f"{POSED},fx,fy,fz,mx,my,mz", *rows, ""]))
    found = scan3d.import_table(tmp_path / "log.csv", stated("none", tared=False))
    assert found.gravity == Gravity((0, 0, -1), tared=False)


def test_against_the_formula_of_a_round_bar():
    """As text, and by its length alone, which is that of a slender wire of steel."""
    rod, by_length = parse_rod("steel:0.3x50"), Rod.of_length(0.05)
    assert rod.length_m == pytest.approx(0.05, rel=1e-15)
    assert rod.bending_stiffness_Nm2 == pytest.approx(210e9 * math.pi * (0.15e-3) ** 4 / 4, rel=1e-12)
    assert rod.moment_unit_Nm == pytest.approx(rod.force_unit_N * rod.length_m, rel=1e-12)
    assert by_length == Rod.wire(0.05, 0.05 * SLENDERNESS, 210e9)
    assert by_length.bending_stiffness_Nm2 == pytest.approx(rod.bending_stiffness_Nm2, rel=1e-12)
