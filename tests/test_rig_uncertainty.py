"""What a calibration leaves uncertain: stated by a recording, and set by an import with a rig."""

import dataclasses
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scan3d import InputError
from scan3d.calibration.report import OF_CONTACTS, Calibration, read_rig, write_rig
from scan3d.recording import joined
from scan3d.rigs import GAINS, RIG_QUANTITIES, RigUncertainty
from tests import rigs
from tests.rig_errors import calibrated, typical
from tests.test_recording import random_recording

TWO = ("stiffness_relative", "clamp_x_m")


def test_components_have_the_covariance_whatever_the_units():
    """Their squares add up to the covariance, which has entries from 1e-10 to 1e-5."""
    rig = typical()
    parts = rig.components()
    assert parts.shape == (24, 14)
    np.testing.assert_allclose((parts @ parts.T)[:14, :14], rig.covariance, rtol=1e-9, atol=1e-20)
    alike = RigUncertainty(TWO, [[4e-6, 2e-8], [2e-8, 1e-10]])  # correlation 1
    assert alike.components().shape == (24, 1)
    assert RigUncertainty((), []).components().shape == (24, 0)


def test_recordings_are_joined_with_one_calibration():
    """The errors of two calibrations are not the same in all rows."""
    one = random_recording(rig=typical())
    assert joined([one, random_recording(rig=typical())]).rig == typical()
    assert hash(one.rig) == hash(typical())
    assert joined([random_recording(), random_recording(noise_pose_m=2e-5)]).noise_pose_m == 2e-5
    assert not joined([random_recording(), random_recording(noise_independent=False)]).noise_independent
    for other in (None, typical(2.0)):
        with pytest.raises(
            InputError, match=r"corrected by another calibration than those before, or only one of them"
        ):
            joined([one, random_recording(rig=other)])


def test_a_recording_that_is_joined_to_others_keeps_its_digits_and_its_cavities():
    """The digits of one part were lost among those of the other, and so was what is stated of the body."""
    exact = random_recording(200)
    hollow = {"source": {"convex": False}}
    coarse = random_recording(200, force_N=exact.force_N.round(2), moment_Nm=exact.moment_Nm.round(9), **hollow)
    for parts in ([exact, coarse], [coarse, exact], [coarse, coarse]):
        both = joined(parts)
        assert both.stated_hollow
        assert (both.noise.force_N, both.noise.moment_Nm) == (coarse.noise.force_N, coarse.noise.moment_Nm)
        assert not both.noise.independent or not both.noise_independent
    assert joined([exact, exact]).noise.force_N == 0
    assert not joined([exact, exact]).stated_hollow


def of_frame(position_m=(0.0, 0.0, 0.0), euler_deg=(0.0, 0.0, 0.0)):
    """A calibration that has found the sensor's frame, and nothing else."""
    nothing, six = np.zeros(0), np.zeros(6)
    return Calibration(
        random_recording().rod, np.array(position_m), np.array(euler_deg), np.zeros(3), np.zeros(3), six, six, (), nothing,
        nothing, np.zeros((0, 0)), (), (), 1.0, 1.0, 1, 0.0, 0.0, 0.0,
    )  # fmt: skip


def test_frames_that_an_import_turned_are_not_corrected_by_a_rig():
    """The rows of strokes back were corrected as if clamp and sensor were not turned."""
    log = random_recording(source={"map": {"sweeps": {"directions": "both"}}})
    with pytest.raises(
        InputError, match=r'imported with directions = "both".*; import the table with scan3d import --rig'
    ):
        of_frame().applied(log, "calibration")


def test_the_moment_has_the_noise_of_its_component_with_the_longest_lever():
    """The mean over the components, 18 % less, was stated."""
    rig, rng = of_frame((0.0, -0.1, 0.0)), np.random.default_rng(0)
    wrench = rng.standard_normal((20000, 6)) * np.repeat([1e-2, 1e-5], 3)
    moment = rig.corrected(wrench, np.zeros((20000, 3)), np.tile([1.0, 0, 0, 0], (20000, 1)))[1]
    assert rig.moment_noise(1e-2, 1e-5) == pytest.approx(moment.std(axis=0).max(), rel=0.02)


@pytest.mark.parametrize("tare", ["auto", "calibration"])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_the_steps_that_a_rig_turns_are_no_independent_noise(tare, noise):
    """Columns of steps had full precision after the turn, and their rounding counted as white noise."""
    rng, row = np.random.default_rng(0), np.arange(400)
    pressed = np.sin(np.clip((row % 100 - 20) / 60, 0, 1) * np.pi)
    wrench = pressed[:, None] * [-0.5, -0.05, -0.15, 5e-3, 0, 0.015]
    wrench = wrench + noise * rng.standard_normal((400, 6)) * np.repeat([1.0, 0.01], 3)
    force, moment = wrench[:, :3].round(2), wrench[:, 3:].round(4)
    columns = dict(
        sweep=row // 100, position_m=rng.standard_normal((400, 3)), force_N=force[:, :2], moment_Nm=moment[:, 2]
    )
    columns |= dict(force_z_N=force[:, 2], moment_x_Nm=moment[:, 0], moment_y_Nm=moment[:, 1])
    log = random_recording(400, **columns, noise_force_N=noise, noise_moment_Nm=0.01 * noise)
    corrected = of_frame((1e-3, 0.02, 3e-3), (1.0, 2.0, 3.0)).applied(log, tare)
    assert corrected.noise.force_N > 0.99 * log.noise.force_N
    assert (corrected.noise_independent and corrected.noise.independent) == log.noise.independent == (noise > 0)


@pytest.mark.slow
def test_the_covariance_is_that_of_finite_changes_of_the_calibration(tmp_path):
    """The quantities of a calibration are moved one by one, and the recording is corrected again.

    Poses and wrenches move by what the errors of the rig say, to the second order.
    """
    rig, truth = calibrated(0, sweeps=12)
    recording = rigs.recorded(truth, 5, sweeps=4, samples=20)
    stated = rig.uncertainty()
    assert set(stated.exact) <= {"length_m"}
    assert not set(stated.exact) & set(stated.names)
    before = rig.applied(recording, "calibration")
    assert before.rig == stated
    known = [
        name
        for name in OF_CONTACTS
        if name in rig.names and np.isfinite(rig.standard_deviations[rig.names.index(name)])
    ]
    known = [name for name in known if name != "length_m"] + [*GAINS]  # the length moves neither poses nor wrenches
    errors = np.column_stack(
        [_error(before, _moved(rig, name, 1e-4).applied(recording, "calibration")) for name in known]
    )
    rows = [(rig.names + GAINS).index(name) for name in known]
    steps = 1e-4 * np.array([_unit(rig, name) for name in known])
    gains = rig.gains_covariance
    covariance = np.block([[rig.covariance, gains[:, 6:].T], [gains[:, 6:], gains[:, :6]]])
    covariance = covariance[np.ix_(rows, rows)] / steps / steps[:, None]
    found = errors @ covariance @ errors.T
    kept = [k for k, name in enumerate(stated.names) if name != "length_relative"]
    names, count = (*stated.names, *GAINS), len(stated.names)
    kept += range(count, count + 6)
    joint = np.block([[stated.covariance, stated.gains[:, 6:].T], [stated.gains[:, 6:], stated.gains[:, :6]]])
    chosen, expected = [(RIG_QUANTITIES + GAINS).index(names[k]) for k in kept], joint[np.ix_(kept, kept)]
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found[np.ix_(chosen, chosen)] / size / size[:, None], expected / size / size[:, None], atol=2e-3
    )
    write_rig(rig, tmp_path / "rig.toml")
    again = read_rig(tmp_path / "rig.toml").uncertainty()
    assert again.names == stated.names
    np.testing.assert_allclose(again.covariance, stated.covariance, rtol=1e-12)


def _unit(rig, name):
    return rig.rod.bending_stiffness_Nm2 if name.startswith("bending") else 1.0


def _moved(rig, name, step):
    if name.startswith("bending"):
        return dataclasses.replace(
            rig, rod=dataclasses.replace(rig.rod, bending_stiffness_Nm2=rig.rod.bending_stiffness_Nm2 * (1 + step))
        )
    if name in GAINS:
        return dataclasses.replace(rig, gains=rig.gains + step * (np.array(GAINS) == name))
    field, factor = {
        "clamp": ("clamp_position_m", 1e-3),
        "clamp_turn": ("clamp_euler_deg", 1.0),
        "sensor": ("sensor_position_m", 1e-3),
        "sensor_turn": ("sensor_euler_deg", 1.0),
    }[re.sub(r"_[xyz]_(mm|deg)$", "", name)]
    values = np.array(getattr(rig, field))
    values["xyz".index(name.rsplit("_", 2)[1])] += factor * step
    return dataclasses.replace(rig, **{field: values})


def _error(before, after):
    """The error (24,) of `RIG_QUANTITIES` and gains between two corrections of a recording, by least squares over its rows."""
    (f, m), (g, k) = before.wrench(), after.wrench()
    axes = before.axes()
    offset = np.einsum("nij,nj->ni", axes, after.position_m - before.position_m).mean(axis=0)
    one, other = (Rotation.from_quat(r.quaternion, scalar_first=True) for r in (before, after))
    turn = (one.inv() * other).as_rotvec().mean(axis=0)

    def crossed(v):  # w × v as a matrix of w
        return np.stack([np.cross(e, v) for e in np.eye(3)], axis=-1).reshape(-1, 3)

    scale = np.abs(m).max() / np.abs(f).max()
    zero = np.zeros((3 * len(f), 3))
    gains = np.einsum("kij,nj->nik", before.rig.on_wrench(1.0)[18:], np.hstack([f, m]))
    by_gains = [part.reshape(-1, 6) for part in (scale * gains[:, :3], gains[:, 3:])]
    matrix = np.vstack(
        [np.hstack([zero, scale * crossed(f), by_gains[0]]), np.hstack([crossed(f), crossed(m), by_gains[1]])]
    )
    right = np.concatenate([scale * (g - f).ravel(), (k - m).ravel()])
    wrench = np.linalg.lstsq(matrix, right, rcond=None)[0]
    stiffness = after.rod.bending_stiffness_Nm2 / before.rod.bending_stiffness_Nm2 - 1
    return np.concatenate([[stiffness, 0.0], offset, turn, wrench[:6], np.zeros(4), wrench[6:]])


def test_a_rig_by_hand_states_the_accuracy_of_its_sensor(tmp_path):
    """Gains that are known to 0.2 %, of a sensor that is turned and moved in the clamp."""
    rod, frame = "length_m = 0.06\nbending_stiffness_Nm2 = 1.9e-4", "position_mm = [0, -20, 5]\neuler_deg = [0, 30, 0]"
    (tmp_path / "rig.toml").write_text(f"[rod]\n{rod}\n")
    assert read_rig(tmp_path / "rig.toml").uncertainty() == RigUncertainty((), [], OF_CONTACTS)
    text = f"[rod]\n{rod}\n[sensor]\n{frame}\n"
    (tmp_path / "rig.toml").write_text(text + "accuracy = 0.002\n")
    found = read_rig(tmp_path / "rig.toml").uncertainty()
    assert found.names == ()
    np.testing.assert_allclose(found.gains, 4e-6 * np.eye(6), rtol=1e-12)
    np.testing.assert_allclose(found.sensor, [0, -0.02, 0.005, 0, 30, 0], atol=1e-12)
    assert found.exact == OF_CONTACTS
    (tmp_path / "rig.toml").write_text(text + 'accuracy = "good"\n')
    with pytest.raises(InputError, match=r"accuracy must be a number from 0 to 0\.3"):
        read_rig(tmp_path / "rig.toml")
