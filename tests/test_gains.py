"""Gains of the sensor's channels: what a calibration says of them, against rigs whose gains are known."""

import dataclasses
import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import scan3d
from scan3d import InputError
from scan3d.pipeline import analyse
from scan3d.rigs import GAINS, Frame, RigUncertainty, accuracy_of, wrench_matrix
from tests import references, rigs
from tests.rig_errors import logged
from tests.robustness.calibrations import standardised
from tests.sample_bodies import MESHES

pytestmark = pytest.mark.slow

# Half a per cent, which is what a sensor is taken to have that states nothing.
DRAWN = tuple(0.005 * np.random.default_rng(1).normal(size=6))
MOMENTS = (0.0, 0.0, 0.0, *[1 / 1.005 - 1] * 3)


SAMPLES = {"sphere": 60, "plane": 120}


@functools.cache
def calibrated(gains, accuracy=None, kind="sphere", **faults):
    """A rig whose channels show too little by some gains (6,), the calibration by its touches, and these."""
    truth = rigs.Truth(gains=tuple(gains), **faults)
    touched, motion, _ = references.of(kind, truth)
    recording = rigs.recorded(truth, 1, motion=motion, samples=SAMPLES[kind])
    return truth, scan3d.calibrate(recording, touched, accuracy=accuracy), recording


@pytest.mark.parametrize(
    ("kind", "gains"),
    [
        ("sphere", MOMENTS),
        ("plane", DRAWN),
        *(pytest.param(*case, marks=pytest.mark.trust) for case in (("sphere", DRAWN), ("plane", MOMENTS))),
    ],
)
def test_gains_that_are_not_stated_are_part_of_the_uncertainties(kind, gains):
    """A common gain of the moments looks like another place of the sensor along the rod: off by 10 deviations if left out."""
    truth, found, recording = calibrated(gains, kind=kind)
    names, error = standardised(found, truth, recording, kind, samples=SAMPLES[kind])
    assert {*GAINS} < {*names}
    assert np.abs(error).max() < 4
    assert np.sqrt((error**2).mean()) < 1.6
    assert found.details["accuracy"] == "assumed"
    assert "0.5 % (one standard deviation), which is assumed" in dict(found.summary())["gains"]
    assert not any("check the sensor's gains" in sentence for sentence in found.sentences)


def test_gains_that_are_stated_as_exact_are_not_sought():
    truth, found, recording = calibrated(MOMENTS, accuracy=0)
    assert not found.gains.any()
    assert not found.gains_covariance.any()
    assert not found.uncertainty().gains.any()
    names, error = standardised(found, truth, recording, "sphere", samples=60)
    assert not {*names} & {*GAINS}
    # what the statement costs where it is false
    assert abs(error[names.index("sensor_y_mm")]) > 5


@pytest.mark.parametrize(
    ("gains", "named", "factor"),
    [
        ((0, 0, 0, -0.1, -0.1, -0.1), "moment-scale, the moments are recorded", 1.11),
        ((0.05, 0, 0, 0, 0, 0), "fx-scale, fx is recorded", 0.95),
        ((0.03, -0.02, 0.01, 0.02, -0.04, 0.01), "several channels are recorded too large or too small, fx", 0.97),
    ],
)
def test_gains_beyond_the_accuracy_are_named(gains, named, factor):
    _, found, _ = calibrated(gains)
    sentence = next(text for text in found.sentences if "check the sensor's gains" in text)
    assert named in sentence
    assert float(sentence.split(named)[1].split()[0].rstrip(",")) == pytest.approx(factor, abs=0.01)
    # the others are known to the accuracy that the found ones show
    assert (
        np.abs(found.gains - gains)[np.array(gains) == 0].max(initial=0)
        < 3 * np.sqrt(np.diag(found.gains_covariance)).max()
    )


def test_a_log_is_corrected_by_the_gains_and_its_bound_allows_for_them():
    truth, found, _ = calibrated(DRAWN)
    assert (np.diag(found.uncertainty().gains) > 0).all()
    mesh = scan3d.load_mesh(MESHES / "egg.stl")
    rod = scan3d.Rod(truth.length, truth.stiffness, rigs.ROD.diameter_m)
    exact = dataclasses.replace(
        scan3d.simulate(mesh, scan3d.Plan(slices=8, friction=0.3, samples=16, rod=rod)),
        table_m=mesh.bounds[0, 2] / 1000,
    )
    log = logged(exact, truth)
    before, after = (
        np.hstack(given.applied(log).wrench()) for given in (dataclasses.replace(found, gains=np.zeros(6)), found)
    )
    added = before @ np.einsum("k,kij->ji", found.gains, found.uncertainty().on_wrench(1.0)[18:])
    np.testing.assert_allclose(after - before, added, atol=1e-3 * np.abs(added).max())
    analysis = analyse(found.applied(log), mesh, "hull", "planar")
    assert analysis.comparison.hausdorff <= analysis.certificate.bound
    low, high = analysis.bounds.volume
    assert low <= mesh.volume <= high


def test_the_gains_are_those_of_the_channels_whatever_frame_a_map_states(tmp_path):
    """Touches that were imported with a nominal frame of the sensor give the same gains, and the same corrected log."""
    _, found, recording = calibrated(DRAWN)
    frame = Frame.of((0.001, -0.02, 0.003), (5.0, 20.0, -8.0))
    wrench = np.hstack(recording.wrench()) @ wrench_matrix(frame.turn, frame.position_m).T
    stated = {"position_mm": [1.0, -20.0, 3.0], "euler_deg": [5.0, 20.0, -8.0], "accuracy": 0.005}
    turned = dataclasses.replace(
        rigs.with_wrench(recording, wrench[:, :3], wrench[:, 3:]),
        # as an import states that of the clamp's moment
        noise_moment_Nm=np.hypot(recording.noise_moment_Nm, np.hypot(0.02, 0.003) * recording.noise_force_N),
        source={"map": {"sensor": stated}},
    )
    other = scan3d.calibrate(turned, rigs.DIAMETER)
    assert other.details["accuracy"] == "stated"
    deviations = np.sqrt(np.diag(found.gains_covariance))
    assert np.abs(other.gains - found.gains).max() < 0.01 * deviations.max()
    np.testing.assert_allclose(np.sqrt(np.diag(other.gains_covariance)), deviations, rtol=0.01)
    np.testing.assert_allclose(other.frames(imported=False)[0].turn, found.frames(imported=False)[0].turn, atol=1e-4)
    # as well known as without the map, whose lever makes the noise of the clamp's moment depend on that of its force
    known = [k for k, name in enumerate(found.names) if not name.startswith(("sensor", "tare", "drift"))]
    np.testing.assert_allclose(other.standard_deviations[known], found.standard_deviations[known], rtol=0.01)
    assert other.consistency == pytest.approx(found.consistency, rel=0.01)
    one, two = (rig.applied(log) for rig, log in ((found, recording), (other, turned)))
    size = np.abs(one.moment_Nm).max()
    assert np.abs(one.moment_Nm - two.moment_Nm).max() < 3e-3 * size
    assert one.rig.sensor == pytest.approx(two.rig.sensor, abs=0.5)
    scan3d.write_rig(other, tmp_path / "rig.toml")
    again = scan3d.read_rig(tmp_path / "rig.toml")
    for name in ("gains", "gains_covariance", "accuracy"):
        np.testing.assert_array_equal(getattr(again, name), getattr(other, name))
    np.testing.assert_allclose(again.uncertainty().covariance, other.uncertainty().covariance, rtol=1e-9)
    np.testing.assert_array_equal(again.uncertainty().gains[:, :6], other.uncertainty().gains[:, :6])
    assert again.uncertainty().sensor == pytest.approx(other.uncertainty().sensor, rel=1e-9)
    text = (tmp_path / "rig.toml").read_text()
    begin = text.index("\ngains = [", text.index("[covariance]"))
    (tmp_path / "rig.toml").write_text(f"{text[:begin]}\ngains = [[1.0]]{text[text.index('[map', begin) - 1 :]}")
    with pytest.raises(InputError, match="of the gains 6 or 36 rows"):
        scan3d.read_rig(tmp_path / "rig.toml")


def test_an_accuracy_is_one_number_or_one_of_each_channel():
    np.testing.assert_array_equal(accuracy_of(0.01), np.full(6, 0.01))
    np.testing.assert_array_equal(accuracy_of([0.0, 0.0, 0.0, 0.01, 0.01, 0.02])[3:], [0.01, 0.01, 0.02])


def test_gains_act_in_the_frame_of_the_sensor():
    """Against the chain of frames: into the sensor's frame, times the gains, and back."""
    frame = (0.004, -0.019, 0.005, 12.0, 25.0, -10.0)
    rig = RigUncertainty((), [], gains=np.eye(6), sensor=frame)
    rng = np.random.default_rng(0)
    force, moment, gains = rng.normal(size=3), rng.normal(size=3), rng.normal(size=6)
    turn = Rotation.from_euler("xyz", frame[3:], degrees=True)
    own = [turn.inv().apply(part) for part in (force, moment - np.cross(frame[:3], force))]
    added = [turn.apply(part * of) for part, of in zip(own, (gains[:3], gains[3:]), strict=True)]
    added[1] = added[1] + np.cross(frame[:3], added[0])
    found = np.einsum("k,kij,j->i", gains, rig.on_wrench(1.0)[18:], np.append(force, moment))
    np.testing.assert_allclose(found, np.concatenate(added), atol=1e-12)
