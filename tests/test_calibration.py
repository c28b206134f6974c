"""Calibration on touches of a reference sphere: what is found agrees with the simulated rig within the stated uncertainty."""

import dataclasses

import numpy as np
import pytest

import scan3d
from scan3d import InputError
from scan3d.laboratory.calibration_rows import neighbours
from scan3d.spatial.inverse import reconstruct
from tests import rigs

# Rigs that differ from the nominal one in other ways.
TURNED = rigs.Truth(
    noise=0, jitter=0, sensor_turn=(170.0, 20.0, 60.0), sensor=(0.01, 0.03, 0.02), stiffness=1.5e-4, length=0.0605
)
PLAIN = rigs.Truth(noise=0, jitter=0, sensor_turn=(0.0, 0.0, 0.0), sensor=(0.0, 0.0, 0.0), clamp=(0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def noisy():
    return scan3d.calibrate(rigs.recorded(), rigs.DIAMETER)


def errors(calibration, truth, recording, **raster):
    """Errors by name, in millimetres, degrees, and relative to the largest value of the quantity's group."""
    true = rigs.truth_of(calibration, truth, recording, **raster)
    found = {}
    for name, value, right in zip(calibration.names, calibration.values, true, strict=True):
        scale = 1.0 if name.endswith(("_mm", "_deg")) else 1e-3 if name == "length_m" else abs(right) or 1e-3
        found[name] = abs(value - right) / scale
    return found


@pytest.mark.parametrize("truth", [rigs.EXACT, TURNED, PLAIN])
def test_every_parameter_is_recovered_without_noise(truth):
    recording = rigs.recorded(truth)
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    assert max(errors(found, truth, recording).values()) < 1e-6
    assert found.sentences == ()
    assert set(found.names) >= {"bending_stiffness_Nm2", "length_m", "clamp_y_mm", "sensor_turn_y_deg", "tare_my_Nm"}


def test_with_noise_the_errors_are_those_that_are_stated(noisy):
    truth = rigs.Truth()
    recording = rigs.recorded()
    deviations = (noisy.values - rigs.truth_of(noisy, truth, recording)) / noisy.standard_deviations
    assert np.abs(deviations).max() < 4
    assert np.sqrt((deviations**2).mean()) < 1.5
    assert noisy.sentences == ()
    assert abs(noisy.chi2 - 1) < 0.05
    assert abs(noisy.consistency - 1) < 0.1
    # the jitter is found from the contacts alone
    assert noisy.pose_noise_m == pytest.approx(20e-6, rel=0.6)
    assert np.allclose(noisy.expanded, 2 * noisy.standard_deviations)
    assert np.allclose(np.diag(noisy.covariance), noisy.standard_deviations**2)


@pytest.mark.slow
def test_the_stated_intervals_hold():
    """A tenth of `tests.robustness.calibrations`: 16 quantities of 12 seeds, whose 95 % intervals hold in 90 % at least."""
    holds = []
    for seed in range(100, 112):
        recording = rigs.recorded(seed=seed)
        found = scan3d.calibrate(recording, rigs.DIAMETER)
        errors_in_sd = (found.values - rigs.truth_of(found, rigs.Truth(), recording)) / found.standard_deviations
        holds.append(np.abs(errors_in_sd) < 1.96)
    assert 0.9 <= np.mean(holds) <= 0.99


@pytest.mark.parametrize("seed", [1002, 1071])
def test_a_single_contact_that_noise_puts_past_the_tip_hides_no_tip_contacts(seed):
    recording = rigs.recorded(seed=seed)
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    assert found.details["tip_contacts"] > 100
    deviations = (found.values - rigs.truth_of(found, rigs.Truth(), recording)) / found.standard_deviations
    assert np.abs(deviations).max() < 4


def test_rows_are_chosen_by_their_neighbours_alone():
    rng = np.random.default_rng(0)
    sweep = np.repeat([0, 1, 2], [20, 30, 1])
    contact = np.ones(51, dtype=bool)
    contact[8] = False
    line = np.arange(51.0)[:, None] * np.arange(1, 7)
    # a straight line is what the neighbours predict, whatever the row's own value; a row alone has no neighbours
    for row in (0, 7, 25, 49):
        wrench = line.copy()
        wrench[row] += rng.normal(size=6)
        assert np.allclose(neighbours(wrench, sweep, contact)[row], line[row])
    assert (neighbours(line, sweep, contact)[50] == line[50]).all()


def test_with_noise_the_goals_are_met(noisy):
    """Half a percent of stiffness and 50 µm of the clamp's offset, at two standard deviations, from 120 rows in each sweep."""
    uncertain = dict(zip(noisy.names, noisy.expanded, strict=True))
    assert uncertain["bending_stiffness_Nm2"] < 0.005 * noisy.rod.bending_stiffness_Nm2
    assert max(uncertain[f"clamp_{axis}_mm"] for axis in "xyz") < 0.05


def test_noise_that_is_not_stated_is_found_in_the_air(noisy):
    found = scan3d.calibrate(rigs.recorded(stated=False), rigs.DIAMETER)
    assert found.noise_force_N == pytest.approx(noisy.noise_force_N, rel=0.03)
    assert found.noise_moment_Nm == pytest.approx(noisy.noise_moment_Nm, rel=0.03)
    assert (np.abs(found.values - noisy.values) < noisy.standard_deviations).all()


def test_a_given_pose_noise_is_tested(noisy):
    recording = rigs.recorded()
    right = scan3d.calibrate(recording, rigs.DIAMETER, pose_noise_m=20e-6)
    assert right.sentences == ()
    assert right.pose_noise_m == pytest.approx(20e-6)
    jittering = rigs.recorded(dataclasses.replace(rigs.Truth(), jitter=200e-6))
    wrong = scan3d.calibrate(jittering, rigs.DIAMETER, pose_noise_m=20e-6)
    assert any("The contacts deviate from the sphere" in sentence for sentence in wrong.sentences)


def test_a_diameter_that_is_wrong_by_a_thirtieth_is_noticed():
    found = scan3d.calibrate(rigs.recorded(), 0.031)
    assert any("as if the poses scattered by 0.1" in sentence for sentence in found.sentences)


@pytest.mark.slow
def test_noise_that_is_understated_is_noticed():
    recording = rigs.recorded()
    recording = dataclasses.replace(
        recording, noise_force_N=recording.noise_force_N / 2, noise_moment_Nm=recording.noise_moment_Nm / 2
    )
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    assert any("In the air the reactions scatter by" in sentence for sentence in found.sentences)
    assert found.noise_force_N == pytest.approx(2 * recording.noise_force_N, rel=0.03)


@pytest.mark.slow
def test_a_tare_that_jumps_between_sweeps_is_found_for_each():
    recording = rigs.recorded()
    jumps = np.random.default_rng(5).normal(scale=3 * recording.noise_force_N, size=(30, 2))
    jumping = dataclasses.replace(recording, force_N=recording.force_N + jumps[recording.sweep])
    found = scan3d.calibrate(jumping, rigs.DIAMETER)
    assert found.details["tare"] == "sweep"
    true = rigs.truth_of(found, rigs.Truth(), recording)
    rig = ~np.char.startswith(found.names, "tare")
    assert np.abs((found.values - true) / found.standard_deviations)[rig].max() < 4
    assert any("In the air" in s for s in scan3d.calibrate(jumping, rigs.DIAMETER, tare="linear").sentences)
    constant = scan3d.calibrate(
        rigs.recorded(dataclasses.replace(rigs.Truth(), drift=(0,) * 6)), rigs.DIAMETER, tare="constant"
    )
    assert not any(name.startswith("drift") for name in constant.names)
    assert constant.sentences == ()


def test_the_weight_of_the_clamp_turns_with_it():
    recording = rigs.recorded()
    force, moment = recording.wrench()
    # three times the largest force of the rod, 5 mm from the sensor
    weight = recording.axes() @ np.array([0, 0, -3.0]) * np.linalg.norm(force, axis=1).max()
    lever = np.cross([0.001, 0.004, -0.003], weight)
    heavy = dataclasses.replace(
        recording,
        force_N=force[:, :2] + weight[:, :2],
        force_z_N=force[:, 2] + weight[:, 2],
        moment_x_Nm=moment[:, 0] + lever[:, 0],
        moment_y_Nm=moment[:, 1] + lever[:, 1],
        moment_Nm=moment[:, 2] + lever[:, 2],
    )
    found = scan3d.calibrate(heavy, rigs.DIAMETER)
    assert found.details["tare"] == "sweep"
    rig = ~np.char.startswith(found.names, "tare")
    deviations = (found.values - rigs.truth_of(found, rigs.Truth(), recording)) / found.standard_deviations
    assert np.abs(deviations[rig]).max() < 4


def test_one_direction_of_the_rod_leaves_the_offset_along_it_at_its_nominal_value():
    raster = dict(directions=1, rolls=30)
    truth = dataclasses.replace(rigs.EXACT, clamp=(0.0006, 0.0, 0.0008), drift=(0.0,) * 6)
    recording = rigs.recorded(truth, **raster)
    same = recording.sweep % 3 == 0
    found = scan3d.calibrate(part(recording, same), rigs.DIAMETER)
    assert not found.well[found.names.index("clamp_y_mm")]
    assert found.values[found.names.index("clamp_y_mm")] == 0
    assert any("clamp_y_mm stays at its nominal value" in sentence for sentence in found.sentences)
    assert any("with the rod in other directions" in sentence for sentence in found.sentences)
    names = ("bending_stiffness_Nm2", "clamp_x_mm", "clamp_z_mm", "sensor_y_mm", "sensor_turn_y_deg")
    assert max(errors(found, truth, recording, **raster)[name] for name in names) < 1e-6


def test_without_tip_contacts_the_free_length_stays_at_its_nominal_value():
    raster = dict(reach=(0.7, 0.75, 0.8, 0.85, 0.9))
    truth = dataclasses.replace(rigs.EXACT, length=0.0602)
    recording = rigs.recorded(truth, **raster)
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    assert found.rod.length_m == 0.06
    assert np.isinf(found.standard_deviations[found.names.index("length_m")])
    assert "length_m stays at its nominal value. It needs tip contacts" in found.sentences[0]
    remaining = {name: error for name, error in errors(found, truth, recording, **raster).items() if name != "length_m"}
    assert max(remaining.values()) < 1e-6


def test_without_friction_the_turn_about_the_rod_is_not_determined():
    recording = rigs.recorded(friction=0.0)
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    assert any("do not determine the sensor's turn about the rod" in sentence for sentence in found.sentences)
    unknown = {name for name, sd in zip(found.names, found.standard_deviations, strict=True) if np.isinf(sd)}
    assert unknown == {f"sensor_{name}" for name in ("x_mm", "z_mm", "turn_x_deg", "turn_y_deg", "turn_z_deg")}
    deviations = (
        found.values - rigs.truth_of(found, rigs.Truth(), recording, friction=0.0)
    ) / found.standard_deviations
    assert np.abs(deviations).max() < 4


def test_few_light_touches_determine_poorly():
    recording = rigs.recorded()
    found = scan3d.calibrate(part(recording, recording.sweep < 8), rigs.DIAMETER)
    poor = [sentence for sentence in found.sentences if "poorly" in sentence]
    assert any("the sensor's turn poorly" in sentence and "more friction" in sentence for sentence in poor)


def test_the_corrected_recording_is_that_of_the_clamp():
    recording = rigs.recorded(rigs.EXACT)
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    corrected = found.applied(recording)
    position, axes, force, moment, state = rigs.swept()
    force, moment = force.reshape(-1, 3) * found.rod.force_unit_N, moment.reshape(-1, 3) * found.rod.moment_unit_Nm
    assert np.abs(corrected.wrench()[0] - force).max() < 1e-8 * np.abs(force).max()
    assert np.abs(corrected.wrench()[1] - moment).max() < 1e-8 * np.abs(moment).max()
    assert np.abs(corrected.position_m - position.reshape(-1, 3) * 0.06 - rigs.CENTRE).max() < 1e-9
    assert np.abs(corrected.axes() - np.repeat(axes, 120, axis=0)).max() < 1e-8
    assert corrected.rod.bending_stiffness_Nm2 == pytest.approx(rigs.EXACT.stiffness, rel=1e-8)


def test_contacts_of_another_recording_lie_on_the_sphere_after_the_correction(noisy):
    # a day later the sensor shows another tare
    later = rigs.recorded(dataclasses.replace(rigs.EXACT, bias=(-0.02, 0.03, 0.05, 0.01, -0.05, 0.02)))
    corrected = noisy.applied(later)
    force, moment = corrected.wrench()
    strong = np.linalg.norm(force, axis=1) > 0.5 * corrected.rod.force_unit_N
    found = reconstruct(
        force[strong] / corrected.rod.force_unit_N, moment[strong] / corrected.rod.moment_unit_Nm, tolerance=0.5
    )
    points = np.einsum("ni,nij->nj", found.point, corrected.axes()[strong]) * corrected.rod.length_m
    distance = np.linalg.norm(points + corrected.position_m[strong] - rigs.CENTRE, axis=1)
    assert np.abs(distance - rigs.DIAMETER / 2 - 0.00015).max() < 0.0002
    # not corrected, they lie millimetres away
    kept = noisy.applied(rigs.recorded(), tare="calibration")
    assert np.abs(kept.force_N - noisy.applied(rigs.recorded()).force_N).max() < 0.02 * np.abs(kept.force_N).max()


@pytest.mark.parametrize("tip", [True, False])
def test_a_rod_in_a_plane_has_fewer_parameters(tip):
    recording, truth = rigs.planar_recorded(tip=tip)
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    assert not any(
        name in found.names for name in ("clamp_turn_x_deg", "sensor_z_mm", "sensor_turn_x_deg", "tare_fz_N")
    )
    for name, value, known in zip(found.names, found.values, np.isfinite(found.standard_deviations), strict=True):
        if name in truth and known:
            assert value == pytest.approx(truth[name], rel=1e-6, abs=1e-7), name
    assert np.isfinite(found.standard_deviations[found.names.index("sensor_turn_z_deg")])
    assert np.isfinite(found.standard_deviations[found.names.index("length_m")]) == tip
    assert any("The sweeps lie in one plane" in sentence for sentence in found.sentences)
    corrected = found.applied(recording)
    assert not corrected.six_axis
    # the rod of the plane through the centre bends as without faults
    contacts = scan3d.reconstruct(corrected)
    assert len(contacts) > 300


def test_a_rod_in_a_plane_with_noise():
    recording, truth = rigs.planar_recorded(3, noise=0.001)
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    rows = [k for k, name in enumerate(found.names) if name in truth and np.isfinite(found.standard_deviations[k])]
    right = np.array([truth[found.names[k]] for k in rows])
    assert np.abs((found.values[rows] - right) / found.standard_deviations[rows]).max() < 4


def part(recording, rows):
    """The rows (n,) of a recording."""
    columns = {
        field.name: getattr(recording, field.name)[rows]
        for field in dataclasses.fields(recording)
        if isinstance(getattr(recording, field.name), np.ndarray)
    }
    return dataclasses.replace(recording, **columns)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (dict(sphere=0.0), "needs a diameter above 0"),
        (dict(sphere=float("nan")), "needs a diameter above 0"),
        (dict(sphere="30 mm"), "needs a diameter above 0"),
        (dict(sphere=1e297), r"a diameter of 1e\+297 m, and the rod a length of 0.06 m; check the unit"),
        (dict(sphere=0.03, tare="cubic"), "tare must be one of auto, constant, linear, sweep"),
        (dict(sphere=0.03, pose_noise_m=-1.0), "noise of the poses"),
        (dict(sphere=30.0), "do not fit a sphere of 30000 mm"),
        (dict(sphere=0.02), "do not fit a sphere of 20 mm"),
    ],
)
def test_wrong_arguments_have_a_sentence(arguments, sentence):
    with pytest.raises(InputError, match=sentence):
        scan3d.calibrate(rigs.recorded(), **arguments)


def test_recordings_without_air_or_contacts_have_a_sentence():
    recording = rigs.recorded()
    touching = np.isfinite(rigs.swept()[4].s1).ravel()
    with pytest.raises(InputError, match="has 0 rows in the air, and a calibration needs"):
        scan3d.calibrate(part(recording, touching), rigs.DIAMETER)
    with pytest.raises(InputError, match="rows in contact that stand out from the noise"):
        scan3d.calibrate(part(recording, ~touching), rigs.DIAMETER)


def test_a_tare_for_each_sweep_needs_air_in_each():
    recording = rigs.recorded()
    touching = np.isfinite(rigs.swept()[4].s1).ravel()
    begun_late = part(recording, (recording.sweep != 7) | touching)
    assert scan3d.calibrate(begun_late, rigs.DIAMETER).details["tare"] == "linear"
    with pytest.raises(InputError, match="sweep 7 has no rows in the air"):
        scan3d.calibrate(begun_late, rigs.DIAMETER, tare="sweep")


def test_forces_that_are_all_zero_have_a_sentence():
    recording = rigs.recorded()
    zeros = {
        name: 0 * getattr(recording, name)
        for name in ("force_N", "force_z_N", "moment_Nm", "moment_x_Nm", "moment_y_Nm")
    }
    zeros |= {"noise_force_N": 0.0, "noise_moment_Nm": 0.0}
    with pytest.raises(InputError, match="has 0 rows in contact"):
        scan3d.calibrate(dataclasses.replace(recording, **zeros), rigs.DIAMETER)


def test_forces_of_the_wrong_sign_have_a_sentence():
    recording = rigs.recorded()
    wrong = dataclasses.replace(recording, force_N=-recording.force_N, force_z_N=-recording.force_z_N)
    with pytest.raises(InputError, match="signs of forces and moments"):
        scan3d.calibrate(wrong, rigs.DIAMETER)


def test_long_recordings_are_begun_with_some_rows_and_end_with_all(noisy, monkeypatch):
    monkeypatch.setattr("scan3d.laboratory.calibration._MANY", 700)
    found = scan3d.calibrate(rigs.recorded(), rigs.DIAMETER)
    assert found.details["air"] == noisy.details["air"]
    assert found.details["contacts"] == pytest.approx(noisy.details["contacts"], rel=0.01)
    assert (np.abs(found.values - noisy.values) < 0.5 * noisy.standard_deviations).all()
    assert found.standard_deviations == pytest.approx(noisy.standard_deviations, rel=0.1)
