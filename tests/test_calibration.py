"""Calibration on touches of a sphere and of a plane agrees with the simulated rig within the stated uncertainty."""

import dataclasses
import functools
import json
import tomllib

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

import scan3d
from planar.arrays import rows_of
from scan3d import InputError
from scan3d.calibration import fit
from scan3d.calibration.model import MIXING, SENSOR, SHAPE, STIFFNESS, TILT, Kind, equations
from scan3d.calibration.references import Plane, Sphere, six_channels, unloaded, weighed
from scan3d.recording import of_rows
from scan3d.rigs import Frame, to_outer
from tests import references, rigs

pytestmark = pytest.mark.slow

# A rig that differs from the nominal one in all ways, by much.
TURNED = rigs.Truth(
    noise=0, jitter=0, sensor_turn=(170.0, 20.0, 60.0), sensor=(0.01, 0.03, 0.02), stiffness=1.5e-4, length=0.0605
)
SHORT = dict(sweeps=15, samples=60)
# With enough rows in the air to tell noise and drift.
LONGER = dict(samples=60)


def recorded(kind, truth=None, seed=0, **raster):
    """The touches of a rig, and what `scan3d.calibrate` is given besides."""
    touched, motion, _ = references.of(kind, truth or rigs.Truth())
    return rigs.recorded(truth, seed, motion=motion, **raster), touched


def errors(found, recording, kind="sphere", truth=None, **raster):
    """Errors (k,) of the quantities in their units."""
    truth = truth or rigs.Truth()
    _, motion, reference = references.of(kind, truth)
    return found.values - rigs.truth_of(found, truth, recording, motion=motion, reference=reference, **raster)


def scaled(found, error):
    """Errors by name in millimetres, degrees, and relative to the value."""
    units = [name.endswith(("_mm", "_deg")) for name in found.names]
    size = np.where(units, 1.0, np.maximum(np.abs(found.values), 1e-3))
    return dict(zip(found.names, np.abs(error) / size, strict=True))


def of_rig(found):
    return np.array([not name.startswith(("tare", "drift")) for name in found.names])


@functools.cache
def calibrated(kind, **raster):
    recording, touched = recorded(kind, **raster)
    return recording, scan3d.calibrate(recording, touched), kind


@pytest.fixture(autouse=True)
def straight(request, monkeypatch):
    """Wherever a straight rod does not fit, its shape is sought for half a minute: in `make trust`, and in tests of its own."""
    if not request.node.get_closest_marker("trust"):
        monkeypatch.setattr(fit, "_shaped", lambda *_: None)


@pytest.fixture(params=["sphere", pytest.param("plane", marks=pytest.mark.slow)])
def noisy(request):
    return calibrated(request.param)


@pytest.fixture
def on_sphere():
    return calibrated("sphere", **LONGER)[1]


@pytest.mark.parametrize(
    ("kind", "shape", "contact"),
    [
        ("sphere", None, Kind.TANGENTIAL),
        ("plane", None, Kind.TIP),
        ("sphere", [-0.3, -0.1, 0.05], Kind.TANGENTIAL),
        ("sphere", [-0.3, -0.1, 0.05], Kind.TIP),
    ],
)
def test_derivatives_of_the_equations_are_those_of_difference_quotients(kind, shape, contact):
    recording, _ = recorded(kind, **LONGER)
    reference = Plane.of(recording.rod) if kind == "plane" else Sphere.of(rigs.DIAMETER, recording.rod)
    if shape is not None:  # of a rod that is thick enough for its taper to count
        reference = dataclasses.replace(reference, thickness=0.1)
    problem, nominal = fit.measured(recording, reference, "auto")
    every, within = (5, 1e-6) if shape is None else (40, 1e-3)  # differences by steps of 1e-5, of the march
    touches = rows_of(problem.touches, np.arange(0, len(problem.touches.number), every))
    touches = touches._replace(kind=np.full(len(touches.kind), contact, dtype=np.int8))
    rng, size = np.random.default_rng(0), len(problem.free)
    rig, h = nominal.moved(0.02 * rng.normal(size=size)), 1e-6
    chosen = np.arange(size)
    if shape is not None:
        rig, h = dataclasses.replace(rig, shape=np.array(shape), marched=True), 1e-4
        chosen = np.array([STIFFNESS, TILT, SENSOR, *range(SHAPE, MIXING)])
    found = equations(rig, touches)
    by_rig = [
        (equations(rig.moved(d), touches).value - equations(rig.moved(-d), touches).value) / (2 * h)
        for d in h * np.eye(size)[chosen]
    ]
    by_row = [
        (equations(rig, touches.moved(d)).value - equations(rig, touches.moved(-d)).value) / (2 * h)
        for d in h * np.broadcast_to(np.eye(9)[:, None], (9, len(touches.kind), 9))
    ]
    for exact, quotient in ((found.by_rig[..., chosen], np.stack(by_rig, -1)), (found.by_row, np.stack(by_row, -1))):
        good = np.isfinite(quotient).all(axis=(1, 2)) & np.isfinite(exact).all(axis=(1, 2))
        assert good.sum() > 200 / every
        assert np.quantile(np.abs(exact - quotient)[good], 0.99) < within * np.abs(exact[good]).max()


@pytest.mark.parametrize(("kind", "truth"), [("sphere", TURNED), ("plane", rigs.EXACT)])
def test_every_parameter_is_recovered_without_noise(kind, truth):
    raster = LONGER if kind == "plane" else SHORT
    recording, touched = recorded(kind, truth, **raster)
    found = scan3d.calibrate(recording, touched)
    assert max(scaled(found, errors(found, recording, kind, truth, **raster)).values()) < 1e-6
    assert found.sentences == ()
    assert np.isfinite(found.standard_deviations).all()
    assert set(found.names) >= {"bending_stiffness_Nm2", "length_m", "clamp_y_mm", "sensor_turn_y_deg", "tare_my_Nm"}
    if kind == "plane":
        return
    # the corrected recording is that of the clamp
    corrected = found.applied(recording)
    position, axes, force, moment, _ = rigs.swept(length=truth.length, **SHORT)
    force, moment = force.reshape(-1, 3) * found.rod.force_unit_N, moment.reshape(-1, 3) * found.rod.moment_unit_Nm
    assert np.abs(corrected.wrench()[0] - force).max() < 1e-7 * np.abs(force).max()
    assert np.abs(corrected.wrench()[1] - moment).max() < 1e-7 * np.abs(moment).max()
    assert np.abs(corrected.position_m - position.reshape(-1, 3) * truth.length - rigs.CENTRE).max() < 1e-9
    assert np.abs(corrected.axes() - np.repeat(axes, 60, axis=0)).max() < 1e-8
    assert corrected.rod.bending_stiffness_Nm2 == pytest.approx(truth.stiffness, rel=1e-7)


def test_with_noise_the_errors_are_those_that_are_stated(noisy):
    recording, found, kind = noisy
    deviations = errors(found, recording, kind) / found.standard_deviations
    assert np.abs(deviations).max() < 4
    assert np.sqrt((deviations**2).mean()) < 1.5
    assert found.sentences == ()
    assert all(found.well)
    assert abs(found.chi2 - 1) < 0.05
    assert abs(found.consistency - 1) < 0.1
    # the jitter is found from the contacts alone
    assert found.pose_noise_m == pytest.approx(20e-6, rel=0.6)
    assert np.allclose(found.expanded, 2 * found.standard_deviations)
    assert np.allclose(np.diag(found.covariance), found.standard_deviations**2)
    # half a percent of stiffness and 50 µm of the clamp's offset, at two standard deviations
    uncertain = dict(zip(found.names, found.expanded, strict=True))
    assert uncertain["bending_stiffness_Nm2"] < 0.005 * found.rod.bending_stiffness_Nm2
    assert max(uncertain[f"clamp_{axis}_mm"] for axis in "xyz") < 0.06


@pytest.mark.parametrize("stated", [0.0, 0.5])
def test_noise_that_is_not_stated_or_understated_is_found_in_the_air(on_sphere, stated):
    recording = rigs.recorded(**LONGER)
    force, moment = recording.noise_force_N, recording.noise_moment_Nm
    recording = dataclasses.replace(recording, noise_force_N=stated * force, noise_moment_Nm=stated * moment)
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    assert (found.noise_force_N, found.noise_moment_Nm) == pytest.approx((force, moment), rel=0.03)
    assert (np.abs(found.values - on_sphere.values) < on_sphere.standard_deviations).all()
    assert any("In the air the reactions scatter by" in sentence for sentence in found.sentences) == bool(stated)


def test_a_given_pose_noise_is_tested():
    jittering = rigs.recorded(dataclasses.replace(rigs.Truth(), jitter=200e-6), **SHORT)
    found = scan3d.calibrate(jittering, rigs.DIAMETER, pose_noise_m=20e-6)
    assert found.pose_noise_m == pytest.approx(20e-6)
    assert any("The contacts deviate from the sphere" in sentence for sentence in found.sentences)


def added(recording, force, moment):
    before = recording.wrench()
    return rigs.with_wrench(recording, before[0] + force, before[1] + moment)


def test_a_weight_that_turns_with_the_clamp_is_a_tare_of_each_sweep():
    recording = rigs.recorded(**SHORT)
    # three times the largest force of the rod, 5 mm from the sensor
    weight = recording.axes() @ np.array([0, 0, -3.0]) * np.linalg.norm(recording.wrench()[0], axis=1).max()
    found = scan3d.calibrate(added(recording, weight, np.cross([0.001, 0.004, -0.003], weight)), rigs.DIAMETER)
    assert found.details["tare"] == "sweep"
    deviations = errors(found, recording, **SHORT) / found.standard_deviations
    assert np.abs(deviations[of_rig(found)]).max() < 4


@pytest.mark.parametrize(("other", "seeds"), [(0.0, 1), (1.0, 1), pytest.param(0.0, 40, marks=pytest.mark.trust)])
def test_a_rod_is_weighed_in_the_air(other, seeds, tmp_path):
    """One that hardly sags, so that its weight acts in its middle, beside `other` times its weight at the clamp."""
    truth, deviations = rigs.Truth(), []
    clamp = Rotation.from_euler("xyz", truth.clamp_turn, degrees=True).as_matrix()
    weight = 0.05 * truth.stiffness / truth.length**2
    arm = weight * np.array([0, truth.length / 2, 0]) + other * weight * np.array([0.001, -0.004, -0.003])
    for seed in range(seeds):
        recording = rigs.recorded(seed=seed, **SHORT)
        down = recording.axes() @ [0, 0, -1.0] @ clamp
        carried = rigs.in_sensor(truth, -(1 + other) * weight * down, -np.cross(arm, down))
        heavy = dataclasses.replace(added(recording, *carried), gravity=scan3d.Gravity((0, 0, -1), False))
        found = scan3d.calibrate(heavy, rigs.DIAMETER)
        assert found.names[-1] == "weight_N"
        deviations.append((found.values[-1] - (1 + other) * weight) / found.standard_deviations[-1])
        assert found.rod.weight_N == (0 if other else found.values[-1])
        assert any("whose centre is not the rod's" in sentence for sentence in found.sentences) == bool(other)
    assert np.square(deviations).sum() < chdtri(seeds, 1e-3)
    if not other:
        # the sensor's zero, and the rod's weight, are those of the corrected log in the air
        of_zero, of_sweep = (found.applied(heavy, tare) for tare in ("calibration", "auto"))
        assert (of_zero.gravity.tared, of_sweep.gravity.tared) == (False, True)
        alike = [np.hstack(log.reactions(six_axis=True)).mean(axis=0) for log in (of_zero, of_sweep)]
        np.testing.assert_allclose(*alike, atol=truth.noise)
        # one sweep tells no weight
        one = of_rows(heavy, heavy.sweep == 0)
        air = unloaded(one.sweep, *six_channels(one)[::-1], (0, 0), "constant")
        assert weighed(one, one.rod, found.frames()[0], np.eye(3), air, np.zeros((3, 3))).sd_N == np.inf
        assert "weight_N" in found.uncertainty().names
        scan3d.write_rig(found, tmp_path / "rig.toml")
        assert scan3d.read_rig(tmp_path / "rig.toml").rod == found.rod


def test_one_direction_of_the_rod_leaves_the_offset_along_it_at_its_nominal_value():
    raster = dict(directions=1, rolls=30, samples=60)
    truth = dataclasses.replace(rigs.EXACT, clamp=(0.0006, 0.0, 0.0008), drift=(0.0,) * 6)
    recording = rigs.recorded(truth, **raster)
    found = scan3d.calibrate(of_rows(recording, recording.sweep % 3 == 0), rigs.DIAMETER)
    assert not found.well[found.names.index("clamp_y_mm")]
    assert found.values[found.names.index("clamp_y_mm")] == 0
    assert any("clamp_y_mm stays at the nominal value" in sentence for sentence in found.sentences)
    assert any("with the rod in other directions" in sentence for sentence in found.sentences)
    names = ("bending_stiffness_Nm2", "clamp_x_mm", "clamp_z_mm", "sensor_y_mm", "sensor_turn_y_deg")
    error = scaled(found, errors(found, recording, truth=truth, **raster))
    assert max(error[name] for name in names) < 1e-6


def test_without_friction_the_turn_about_the_rod_is_not_determined():
    raster = dict(friction=0.0, **SHORT)
    recording = rigs.recorded(**raster)
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    assert any("do not determine the sensor's turn about the rod" in sentence for sentence in found.sentences)
    unknown = {name for name, sd in zip(found.names, found.standard_deviations, strict=True) if np.isinf(sd)}
    assert unknown == {f"sensor_{name}" for name in ("x_mm", "z_mm", "turn_x_deg", "turn_y_deg", "turn_z_deg")}
    assert np.abs(errors(found, recording, **raster) / found.standard_deviations).max() < 4


@pytest.mark.parametrize(
    ("noise", "tip"), [pytest.param(0.0, True, marks=pytest.mark.trust), (0.0, False), (0.001, True)]
)
def test_a_rod_in_a_plane_has_fewer_parameters(noise, tip):
    recording, truth = rigs.planar_recorded(3, noise=noise, tip=tip)
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    assert not set(found.names) & {"clamp_turn_x_deg", "sensor_z_mm", "sensor_turn_x_deg", "tare_fz_N"}
    known = np.isfinite(found.standard_deviations)
    for name, value, deviation in zip(found.names, found.values, found.standard_deviations, strict=True):
        if name in truth and np.isfinite(deviation):
            assert value == pytest.approx(truth[name], rel=1e-6, abs=4 * deviation if noise else 1e-7), name
    assert known[found.names.index("sensor_turn_z_deg")]
    assert known[found.names.index("length_m")] == tip
    # how far the plane is from the sphere's centre would enter by its square
    assert not known[[found.names.index(name) for name in ("clamp_z_mm", "sphere_z_mm")]].any()
    assert any("The sweeps lie in one plane" in sentence for sentence in found.sentences)
    corrected = found.applied(recording)
    assert not corrected.six_axis
    # the rod of the plane through the centre bends as without faults
    assert len(scan3d.reconstruct(corrected)) > 300
    if not tip:
        return
    # a map has turned and moved the sensor, and the rig is what it is
    frame = Frame.of((0.004, -0.02, 0.01), (180.0, 0.0, 30.0))
    zero = np.zeros(len(recording))
    shown = [np.column_stack([recording.force_N, zero]), np.column_stack([zero, zero, recording.moment_Nm])]
    force, moment = to_outer(*shown, frame.turn, frame.position_m)
    mapped = dataclasses.replace(recording, force_N=force[:, :2], moment_Nm=moment[:, 2])
    mapped = replace_noise(mapped, float(np.hypot(0.004, 0.02)))
    again = scan3d.calibrate(stated(mapped, position_mm=[4, -20, 10], euler_deg=[180, 0, 30]), rigs.DIAMETER)
    for one, other in zip(found.frames(imported=False), again.frames(imported=False), strict=True):
        assert other.position_m[:2] == pytest.approx(one.position_m[:2], abs=2e-4)
    assert again.values[:2] == pytest.approx(found.values[:2], rel=2e-3)


@pytest.mark.parametrize(
    "case", ["diameter", "planar", *(pytest.param(case, marks=pytest.mark.trust) for case in ("facets", "diameter"))]
)
def test_touches_that_the_model_does_not_fit_leave_nothing_well_determined(case):
    touched, raster, sentence = rigs.DIAMETER, {}, "a reference that is no sphere, such as one of facets"
    if case == "facets":
        raster = dict(facets=3)
        recording = rigs.recorded(**raster)
    elif case == "planar":
        recording, sentence = rigs.planar_model_recorded(), "forces lie in one plane, as those of a planar model"
    else:
        recording, touched = rigs.recorded(sweeps=15, samples=40), 0.031
        sentence = "The likeliest cause is the diameter: one of"
    found = scan3d.calibrate(recording, touched)
    assert not np.array(found.well)[of_rig(found)].any()
    assert sentence in found.sentences[-1]
    if case == "diameter":
        assert float(found.sentences[-1].split("one of ")[1].split()[0]) == pytest.approx(30, abs=0.1)
    if case == "facets":
        assert (np.abs(errors(found, recording, **raster)) < 3 * found.standard_deviations).all()


@pytest.mark.parametrize("kind", ["sphere", pytest.param("plane", marks=pytest.mark.trust)])
def test_gains_and_cross_talk_of_the_sensor_are_part_of_the_uncertainties(kind):
    """One per cent between all channels: what the touches do not tell of them makes wide intervals, and no refusal."""
    truth = rigs.Truth(mixing=0.01)
    raster = SHORT if kind == "sphere" else {}
    recording, touched = recorded(kind, truth, seed=1, **raster)
    found = scan3d.calibrate(recording, touched)
    error = np.abs(errors(found, recording, kind, truth, **raster)) / found.standard_deviations
    assert error.max() < 4
    assert np.sqrt((error[of_rig(found)] ** 2).mean()) < 1.6
    assert found.details["relative_error"] == pytest.approx(0.01, rel=0.5)
    assert found.standard_deviations[0] > 0.002 * found.rod.bending_stiffness_Nm2
    contradiction = next(sentence for sentence in found.sentences if "contradict a single force by" in sentence)
    assert "the noise in the air is" in contradiction


def test_a_gain_that_changes_from_row_to_row_is_allowed_for():
    recording = rigs.recorded(**SHORT)
    gain = 1 + 0.01 * np.random.default_rng(3).normal(size=(len(recording), 6))
    force, moment = recording.wrench()
    wrong = added(recording, force * (gain[:, :3] - 1), moment * (gain[:, 3:] - 1))
    found = scan3d.calibrate(wrong, rigs.DIAMETER)
    error = np.abs(errors(found, recording, **SHORT)) / found.standard_deviations
    assert error[of_rig(found)].max() < 4


def test_noise_that_is_alike_in_neighbouring_rows_enlarges_the_uncertainties(on_sphere):
    """Half of the noise's variance is 1/f."""
    recording = rigs.recorded(pink=0.5, stated=False, **LONGER)
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    rig = of_rig(found)
    assert np.median(found.standard_deviations[rig] / on_sphere.standard_deviations[of_rig(on_sphere)]) > 1.1
    names = tuple(np.array(found.names)[rig])
    true = rigs.truth_of(dataclasses.replace(found, names=names), rigs.Truth(), recording, **LONGER)
    assert np.abs((found.values[rig] - true) / found.standard_deviations[rig]).max() < 4


def replace_noise(recording, lever):
    """A recording whose noise of the moment is that of a clamp so far from the sensor."""
    moment = np.hypot(recording.noise_moment_Nm, lever * recording.noise_force_N)
    return dataclasses.replace(recording, noise_moment_Nm=float(moment))


def stated(recording, **frame):
    """A recording that was imported by a map that states the frame of the sensor."""
    return dataclasses.replace(recording, source={"map": {"sensor": frame}})


def test_recordings_that_can_not_be_calibrated_have_a_sentence():
    some = np.repeat(np.arange(15), 60) < 9
    recording = of_rows(rigs.recorded(**SHORT), some)
    touching = np.isfinite(rigs.swept(**SHORT)[4].s1).ravel()[some]
    on_plane = recorded("plane", **LONGER)[0]
    zero = np.zeros(len(recording))
    silent = dataclasses.replace(
        added(recording, -recording.wrench()[0], -recording.wrench()[1]), noise_force_N=0.0, noise_moment_Nm=0.0
    )
    wrong_sign = dataclasses.replace(recording, force_N=-recording.force_N, force_z_N=-recording.force_z_N)
    late = of_rows(recording, (recording.sweep != 7) | touching)
    both = dataclasses.replace(recording, source={"map": {"sweeps": {"directions": "both"}}})
    assert (silent.force_z_N == zero).all()
    for given, reference, sentence in (
        (of_rows(recording, touching), rigs.DIAMETER, "has 0 rows in the air, and a calibration needs"),
        (of_rows(recording, ~touching), rigs.DIAMETER, "rows in contact that stand out from the noise"),
        (silent, rigs.DIAMETER, "has 0 rows in contact"),
        (wrong_sign, rigs.DIAMETER, "signs of forces and moments"),
        (both, rigs.DIAMETER, 'directions = "both".*; calibrate by the strokes of one direction'),
        (of_rows(on_plane, on_plane.sweep < 9), rigs.DIAMETER, "do not fit a sphere of 30 mm"),
        (rigs.planar_recorded()[0], "plane", "all six components; with three, touch a sphere"),
        (stated(rigs.planar_recorded()[0], euler_deg=[90, 0, 0]), rigs.DIAMETER, "whose z axis is along the clamp's"),
    ):
        with pytest.raises(InputError, match=sentence):
            scan3d.calibrate(given, reference)
    with pytest.raises(InputError, match="sweep 7 has no rows in the air"):
        scan3d.calibrate(late, rigs.DIAMETER, tare="sweep")


def test_rows_that_come_and_go_do_not_spoil_a_fit():
    """The least sum of squares of this noise has a kink, where a row is lost and found."""
    recording = rigs.recorded(seed=103, samples=120)
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    errors = found.values - rigs.truth_of(found, rigs.Truth(), recording, samples=120)
    assert (np.abs(errors) < 4 * found.standard_deviations).all()


def test_the_command_writes_a_rig_and_prints_a_table(call, tmp_path):
    (recording, found, _), rig, touches = calibrated("sphere"), tmp_path / "new" / "rig.toml", tmp_path / "touches.csv"
    scan3d.write_recording(recording, touches)
    code, out, err = call("calibrate", touches, "--sphere", 0.03, "--unit", "m", "--out", rig)
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0].split() == ["quantity", "value", "±", "expanded", "U", "determined"]
    stiffness = lines[1].split()
    assert stiffness[0] == "bending_stiffness_Nm2"
    assert float(stiffness[1]) == pytest.approx(rigs.Truth().stiffness, rel=0.005)
    assert float(stiffness[3]) == pytest.approx(2 * found.standard_deviations[0], rel=0.2)
    assert stiffness[4] == "well"
    assert lines[-1] == f"written to {rig}"
    data = tomllib.loads(rig.read_text())
    assert data["sensor"]["position_mm"] == pytest.approx([4, -19, 5], abs=0.4)
    assert data["clamp"]["position_mm"] == pytest.approx([0.6, -1.1, 0.8], abs=0.12)
    assert len(data["covariance"]["matrix"]) == len(data["covariance"]["quantities"]) == len(found.names)
    # the digits of the table are all there
    assert data["rod"]["bending_stiffness_Nm2"] == found.rod.bending_stiffness_Nm2


def test_a_rig_is_read_back_as_it_was(tmp_path, noisy):
    recording, calibration, kind = noisy
    scan3d.write_rig(calibration, tmp_path / "rig.toml")
    found = scan3d.read_rig(tmp_path / "rig.toml")
    for field in dataclasses.fields(calibration):
        one, other = getattr(calibration, field.name), getattr(found, field.name)
        if isinstance(one, np.ndarray):
            assert np.allclose(one, other, rtol=1e-14, atol=0), field.name
        elif isinstance(one, float):
            assert one == pytest.approx(other, rel=1e-14), field.name
        else:
            assert one == other, field.name
    assert found.reference["kind"] == kind
    assert ("diameter_mm" in found.reference) == ("position_mm" in found.reference) == (kind != "plane")
    assert found.applied(recording).rod == calibration.rod


def test_reconstruct_takes_a_rig(call, tmp_path, no_pictures, undiagnosed, on_sphere):
    scan3d.write_rig(on_sphere, tmp_path / "rig.toml")
    log = rigs.recorded(rigs.EXACT, **SHORT)
    scan3d.write_recording(log, tmp_path / "log.csv")
    given = ("reconstruct", tmp_path / "log.csv", "--out", tmp_path / "out", "--method", "hull", "--json", "--rig")
    code, out, _ = call(*given, tmp_path / "rig.toml")
    assert code == 0
    cloud = scan3d.reconstruct(on_sphere.applied(log))
    assert np.median(np.abs(np.linalg.norm(cloud.points - 1000 * rigs.CENTRE, axis=1) - 15)) < 0.02
    assert json.loads(out)["counts"]["contacts"] == len(cloud)
    code, _, err = call(*given, tmp_path / "none.toml")
    assert (code, "can't read the rig" in err) == (1, True)
