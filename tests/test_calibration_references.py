"""Calibration on touches of a plane and of known bodies: what is found agrees with the simulated rig."""

import dataclasses
import json
import tomllib

import numpy as np
import pytest
import trimesh

import scan3d
from scan3d import InputError
from scan3d.laboratory.calibration_body import Body
from scan3d.laboratory.calibration_pose import poses, spread_rotations
from tests import references, rigs

OF_RIG = ("bending", "length", "clamp", "sensor", "tare", "drift")


def deviations(found, truth, recording, kind, name="cube.stl", **raster):
    """Errors of the quantities of the rig and of a plane by name, in their units, and in standard deviations."""
    _, motion, reference = references.of(kind, name, truth)
    true = rigs.truth_of(found, truth, recording, motion=motion, reference=reference, **raster)
    error = found.values - true
    kept = [k for k, title in enumerate(found.names) if not title.startswith("mesh_turn")]
    names = [found.names[k] for k in kept]
    scale = np.array(
        [
            1.0 if name.endswith(("_mm", "_deg")) else max(abs(true[k]), 1e-3)
            for k, name in zip(kept, names, strict=True)
        ]
    )
    return dict(zip(names, np.abs(error[kept]) / scale, strict=True)), error[kept] / found.standard_deviations[kept]


@pytest.fixture(scope="module")
def on_plane():
    return rigs.recorded(motion=references.plane)


@pytest.fixture(scope="module")
def found_on_plane(on_plane):
    return scan3d.calibrate(on_plane, "plane")


def test_a_plane_determines_every_parameter_without_noise():
    recording = rigs.recorded(rigs.EXACT, motion=references.plane)
    found = scan3d.calibrate(recording, "plane")
    assert max(deviations(found, rigs.EXACT, recording, "plane")[0].values()) < 1e-6
    assert found.sentences == ()
    assert np.isfinite(found.standard_deviations).all()


def test_a_plane_with_noise(on_plane, found_on_plane):
    errors = deviations(found_on_plane, rigs.Truth(), on_plane, "plane")[1]
    assert np.abs(errors).max() < 4
    assert np.sqrt((errors**2).mean()) < 1.5
    assert found_on_plane.sentences == ()
    assert all(found_on_plane.well)
    assert found_on_plane.reference["kind"] == "plane"
    normal = references.turned().as_matrix()[:, 2]
    assert np.abs(found_on_plane.reference["normal"] - normal).max() < 5e-4
    assert np.isnan(found_on_plane.sphere_m).all()
    assert np.isnan(found_on_plane.diameter_m)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "least"), [("plane", 0.88), ("mesh", 0.88)])
def test_the_stated_intervals_hold(kind, least):
    """A short version of `tests.robustness.calibrations --reference`, over the quantities of the rig."""
    touched, motion, _ = references.of(kind, "cube.stl", rigs.Truth())
    holds = []
    for seed in range(500, 508):
        recording = rigs.recorded(seed=seed, motion=motion)
        found = scan3d.calibrate(recording, touched)
        holds.append(np.abs(deviations(found, rigs.Truth(), recording, kind)[1]) < 1.96)
    assert least <= np.mean(holds) <= 0.99


def test_strokes_in_one_direction_say_what_they_lack():
    raster = dict(directions=1, rolls=1)
    truth = dataclasses.replace(rigs.EXACT, clamp=(0.0, 0.0, 0.0), clamp_turn=(0.0, 0.0, 0.0))
    recording = rigs.recorded(truth, motion=references.plane, **raster)
    found = scan3d.calibrate(recording, "plane")
    assert any("the clamp turned about the rod's axis by 90 degrees" in sentence for sentence in found.sentences)
    errors = deviations(found, truth, recording, "plane", **raster)[0]
    known = dict(zip(found.names, np.isfinite(found.standard_deviations), strict=True))
    assert known["bending_stiffness_Nm2"]
    assert max(error for name, error in errors.items() if known[name] and name.startswith(OF_RIG)) < 1e-4


def test_strokes_that_never_lie_along_the_plane_or_only_do():
    tips = rigs.recorded(motion=references.plane, depths=(0.2, 0.3))
    found = scan3d.calibrate(tips, "plane")
    errors = deviations(found, rigs.Truth(), tips, "plane", depths=(0.2, 0.3))[1]
    assert np.abs(errors[np.isfinite(errors)]).max() < 4
    assert found.details["tip_contacts"] > 0.9 * found.details["contacts"]


def test_a_sphere_is_no_plane_and_a_plane_is_no_sphere(on_plane):
    with pytest.raises(InputError, match=r"do not fit a plane.*check that only the plane was touched"):
        scan3d.calibrate(rigs.recorded(), "plane")
    with pytest.raises(InputError, match="do not fit a sphere of 30 mm"):
        scan3d.calibrate(on_plane, rigs.DIAMETER)


def test_a_plane_that_is_not_flat_withdraws_what_is_well_determined(on_plane):
    # a table that sags by 1.5 mm over the strokes
    inner = references.turned().inv().apply(on_plane.position_m - rigs.CENTRE)
    sag = 2.0 * (inner[:, :2] ** 2).sum(axis=1)
    bent = dataclasses.replace(
        on_plane, position_m=on_plane.position_m + sag[:, None] * references.turned().as_matrix()[:, 2]
    )
    found = scan3d.calibrate(bent, "plane")
    rig = [well for name, well in zip(found.names, found.well, strict=True) if not name.startswith(("tare", "drift"))]
    assert not any(rig)
    assert any("a reference that is not flat" in sentence for sentence in found.sentences)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "most"), [("cube.stl", 1e-6), ("gem.glb", 5e-4)])
def test_a_known_body_determines_every_parameter_without_noise(name, most):
    """Of the poses of a symmetric body the nearest one is found, to the single precision of the gem's file."""
    recording = rigs.recorded(rigs.EXACT, motion=references.body, name=name, samples=60)
    found = scan3d.calibrate(recording, references.mesh(name))
    assert max(deviations(found, rigs.EXACT, recording, "mesh", name, samples=60)[0].values()) < most
    assert found.details["pose_noise"] == "estimated"
    assert found.pose_noise_m < 1e-8


def test_a_body_of_another_size_withdraws_what_is_well_determined():
    recording = rigs.recorded(motion=references.body, samples=60)
    larger = references.mesh("cube.stl").copy()
    larger.apply_scale(1.02)
    found = scan3d.calibrate(recording, larger)
    rig = [well for name, well in zip(found.names, found.well, strict=True) if not name.startswith(("tare", "drift"))]
    assert not any(rig)
    assert np.abs(deviations(found, rigs.Truth(), recording, "mesh", samples=60)[1]).max() < 2
    assert "a body that differs from its mesh, in shape or in size" in found.sentences[-1]


@pytest.mark.slow
def test_a_mesh_of_a_smooth_body_is_refused_under_noise():
    recording = rigs.recorded(motion=references.body, name="cylinder.off", samples=60)
    with pytest.raises(
        InputError, match=r"the body of cylinder\.off does not come to rest.* calibrate with a body of flat faces"
    ):
        scan3d.calibrate(recording, references.mesh("cylinder.off"))


@pytest.mark.parametrize("reference", ["plane", trimesh.creation.box((20, 20, 20))])
def test_a_rod_in_a_plane_needs_a_sphere(reference):
    with pytest.raises(InputError, match=r"all six components; with three, touch a sphere"):
        scan3d.calibrate(rigs.planar_recorded()[0], reference)


@pytest.mark.parametrize(
    ("reference", "sentence"),
    [
        ("plain", "other references are 'plane' and the trimesh.Trimesh of a convex body"),
        (None, "needs a diameter above 0, got None"),
        (trimesh.creation.torus(10, 3), "isn't a closed convex surface"),
    ],
)
def test_wrong_references_have_a_sentence(reference, sentence):
    with pytest.raises(InputError, match=sentence):
        scan3d.calibrate(rigs.recorded(), reference)


def test_a_wrong_unit_has_a_sentence():
    with pytest.raises(InputError, match="give either a reference or the diameter"):
        scan3d.calibrate(rigs.recorded(), "plane", sphere=0.03)
    with pytest.raises(InputError, match="unit must be one of"):
        scan3d.calibrate(rigs.recorded(), trimesh.creation.box((20, 20, 20)), unit="ell")
    with pytest.raises(InputError, match="do not fit the body of the mesh"):
        scan3d.calibrate(rigs.recorded(), trimesh.creation.box((20, 20, 20)), unit="m")


@pytest.mark.parametrize("solid", [trimesh.creation.box((1, 1.2, 0.8)), trimesh.creation.icosphere(2, 0.6)])
def test_lines_past_a_body_against_a_search_along_them(solid):
    body = Body(solid, "m", scan3d.Rod(1.0, 1e-4, 0.02))
    rng = np.random.default_rng(0)
    point, tangent = 0.6 * rng.normal(size=(40, 3)), rng.normal(size=(40, 3))
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    line = body.lines(point, tangent)
    along = np.linspace(-3, 3, 2001)
    least = np.array([body.points(p + along[:, None] * t)[0].min() for p, t in zip(point, tangent, strict=True)])
    outside = line.distance > 0
    assert outside.sum() > 10
    assert np.abs(line.distance - least)[outside].max() < 1e-3
    assert (least[~outside] < 1e-4).all()
    # through the body: the farthest direction across the line
    across = np.linalg.svd(tangent[:, None])[2][:, 1:]
    angle = np.linspace(0, 2 * np.pi, 5001)
    directions = np.cos(angle)[:, None, None] * across[:, 0] + np.sin(angle)[:, None, None] * across[:, 1]
    height = (directions * point).sum(axis=2) - (directions @ body.vertices.T).max(axis=2)
    assert np.abs(line.distance - height.max(axis=0))[~outside].max() < 1e-3


def test_derivatives_of_lines_against_difference_quotients():
    body = Body(trimesh.creation.box((1, 1.2, 0.8)), "m", scan3d.Rod(1.0, 1e-4, 0.02))
    rng = np.random.default_rng(1)
    point, tangent = 0.6 * rng.normal(size=(100, 3)), rng.normal(size=(100, 3))
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    line, step = body.lines(point, tangent), 1e-7
    for axis in np.eye(3):
        turn = np.cross(tangent, axis)
        for by_point, by_tangent, moved in ((axis, 0, (step * axis, 0)), (0, turn, (0, step * turn))):
            ahead, behind = (body.lines(point + s * moved[0], tangent + s * moved[1]) for s in (1, -1))
            gap = (line.normal * by_point + line.place[:, None] * line.normal * by_tangent).sum(axis=1)
            place = (line.place_by_point * by_point + line.place_by_tangent * by_tangent).sum(axis=1)
            # one line or the other may pass from one edge to the next within the step
            assert np.quantile(np.abs((ahead.distance - behind.distance) / 2 / step - gap), 0.97) < 1e-5
            assert np.quantile(np.abs((ahead.place - behind.place) / 2 / step - place), 0.97) < 1e-5


def test_the_pose_of_a_body_is_found_from_points_on_it():
    body = Body(scan3d.load_mesh("meshes/gem.glb"), "mm", scan3d.Rod(0.06, 1e-4, 0.0))
    rng = np.random.default_rng(2)
    face = rng.integers(len(body.faces), size=200)
    weight = rng.dirichlet(np.ones(3), size=200)
    inner = (weight[:, :, None] * body.vertices[body.faces[face]]).sum(axis=1)
    for turn in spread_rotations(3):
        found = poses(body, inner @ turn.T + [3.0, -2.0, 1.0], 3)
        assert found.misfit[0] < 1e-6
        assert found.centre[0] == pytest.approx([3.0, -2.0, 1.0], abs=1e-5)


def test_the_command_takes_a_plane(call, tmp_path, on_plane, found_on_plane):
    scan3d.write_recording(on_plane, tmp_path / "touches.csv")
    rig = tmp_path / "rig.toml"
    code, out, err = call("calibrate", tmp_path / "touches.csv", "--plane", "--out", rig)
    assert (code, err) == (0, "")
    assert any(line.startswith("plane_offset_mm") for line in out.splitlines())
    data = tomllib.loads(rig.read_text())
    assert data["plane"]["normal"] == pytest.approx(found_on_plane.reference["normal"])
    assert "sphere" not in data
    found = scan3d.read_rig(rig)
    assert found.reference == found_on_plane.reference
    assert found.applied(on_plane).rod == found_on_plane.rod
    for wrong in ((), ("--plane", "--sphere", 30), ("--plane", "--mesh", "cube.stl")):
        assert call("calibrate", tmp_path / "touches.csv", *wrong, "--out", rig)[0] == 2


def test_the_command_takes_a_mesh(call, tmp_path):
    recording = rigs.recorded(motion=references.body, samples=60)
    scan3d.write_recording(recording, tmp_path / "touches.csv")
    references.mesh("cube.stl").export(tmp_path / "block.stl")
    rig = tmp_path / "rig.toml"
    given = ("calibrate", tmp_path / "touches.csv", "--mesh")
    code, out, _ = call(*given, tmp_path / "block.stl", "--out", rig, "--json")
    assert code == 0
    data = json.loads(out)
    assert data["mesh"]["file"] == "block.stl"
    assert data["mesh"]["position_mm"] == pytest.approx(1000 * rigs.CENTRE, abs=0.1)
    assert data["rod"]["bending_stiffness_Nm2"] == pytest.approx(rigs.Truth().stiffness, rel=0.02)
    assert scan3d.read_rig(rig).reference["kind"] == "mesh"
    code, _, err = call(*given, tmp_path / "none.stl", "--out", rig)
    assert (code, err.count("\n")) == (1, 1)
    code, _, err = call(*given, tmp_path / "block.stl", "--out", rig, "--unit", "m")
    assert code == 1
    assert "check the mesh and its unit" in err
