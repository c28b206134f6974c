"""`scan3d import --rig`: the frames and the rod of a calibration in the place of those of the map.

The touches are those of `rigs`, whose true frames are known; an import with a map that states them is the reference.
"""

import dataclasses
import tomllib

import numpy as np
import pytest
from raw_tables import POSED, si_map, write_numbers
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import scan3d
from scan3d.cli import main
from scan3d.files.text import rod_section, to_toml
from tests import rigs

TRUTH = dataclasses.replace(rigs.EXACT, drift=(0.0,) * 6)
NOMINAL = {"position_mm": [2.0, -15.0, 1.0], "euler_deg": [5.0, 20.0, -3.0]}
CLAMP = {"position_mm": [1.0, 2.0, -0.5], "euler_deg": [1.0, 0.0, 2.0]}


# all share one calibration, which takes long
pytestmark = pytest.mark.slow


def a_map(**sections):
    made = si_map(rigs.ROD, tare={"air": "auto"}, **sections)
    made["columns"]["time"], made["units"]["time"] = "t", "s"
    return made


def true_frames():
    return {
        "sensor": {"position_mm": [1000 * x for x in TRUTH.sensor], "euler_deg": list(TRUTH.sensor_turn)},
        "clamp": {"position_mm": [1000 * x for x in TRUTH.clamp], "euler_deg": list(TRUTH.clamp_turn)},
        "rod": {**rod_section(rigs.ROD), "bending_stiffness_Nm2": TRUTH.stiffness},
    }


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    recording = rigs.recorded(TRUTH, samples=60)
    columns = [recording.sweep, recording.position_m, recording.quaternion, *recording.wrench()]
    path = tmp_path_factory.mktemp("log") / "log.csv"
    return write_numbers(path, f"t,{POSED},fx,fy,fz,mx,my,mz", np.arange(len(recording)) / 100, *columns)


@pytest.fixture(scope="module")
def calibration(table):
    return scan3d.calibrate(scan3d.import_table(table, a_map()), rigs.DIAMETER)


def assert_same(found, expected, tolerance):
    """Recordings that agree up to a part of the rod's length, of the largest force, and of the largest moment."""
    assert found.rod.bending_stiffness_Nm2 == pytest.approx(expected.rod.bending_stiffness_Nm2, rel=tolerance)
    assert found.rod.length_m == pytest.approx(expected.rod.length_m, rel=tolerance)
    np.testing.assert_allclose(found.position_m, expected.position_m, rtol=0, atol=0.06 * tolerance)
    turns = [Rotation.from_quat(part.quaternion, scalar_first=True) for part in (found, expected)]
    assert (turns[0].inv() * turns[1]).magnitude().max() < 3 * tolerance
    for part, same in zip(found.wrench(), expected.wrench(), strict=True):
        np.testing.assert_allclose(part, same, rtol=0, atol=tolerance * np.abs(same).max())


def about_the_rod(rig):
    """The turn of the sensor contains that of the clamp about the rod, which is zero in a calibration."""
    return Rotation.from_euler("xyz", rig.clamp_turn, degrees=True).as_euler("xyz", degrees=True)[1]


def test_a_calibration_and_the_true_frames_agree(table, calibration):
    assert about_the_rod(TRUTH) == pytest.approx(0, abs=1e-12)
    expected = scan3d.import_table(table, a_map(**true_frames()))
    found = scan3d.import_table(table, a_map(), rig=calibration)
    assert_same(found, expected, 1e-5)
    assert (found.noise_pose_m, expected.noise_pose_m) == (calibration.pose_noise_m, 0.0)
    assert scan3d.import_table(table, a_map(noise={"pose_m": 2e-5}), rig=calibration).noise_pose_m == 2e-5
    assert found.rig == calibration.uncertainty()
    assert (found.rig.covariance.shape, expected.rig) == ((14, 14), None)
    # and both are the sphere: the tangential contacts are a radius away from its centre
    cloud = scan3d.reconstruct(found)
    distance = np.linalg.norm(cloud.points / 1000 - rigs.CENTRE, axis=1)
    assert np.median(np.abs(distance - rigs.DIAMETER / 2)) < 1e-5


def test_an_import_with_a_rig_is_an_import_that_is_corrected_by_it(table, tmp_path):
    # the touches were imported with frames that are wrong, which the calibration corrects
    wrong = a_map(sensor=NOMINAL, clamp=CLAMP)
    touches = scan3d.import_table(table, wrong)
    rig = scan3d.calibrate(touches, rigs.DIAMETER)
    path = tmp_path / "rig.toml"
    scan3d.write_rig(rig, path)
    written = tomllib.loads(path.read_text())["map"]
    assert written == {"sensor": NOMINAL, "clamp": CLAMP}
    corrected = rig.applied(touches, tare="sweep")
    for either in (wrong, a_map()):  # the frames of the map are replaced
        assert_same(scan3d.import_table(table, either, rig=path), corrected, 1e-9)
    # the same contacts as with the true frames: a turn of the clamp about the rod belongs to the sensor here
    points, expected = (
        scan3d.reconstruct(part).points for part in (corrected, scan3d.import_table(table, a_map(**true_frames())))
    )
    assert np.quantile(cKDTree(expected).query(points)[0], 0.99) < 1e-3


def test_the_command_writes_a_recording_that_is_corrected_once(table, calibration, tmp_path, capsys):
    by, rig, out = tmp_path / "map.toml", tmp_path / "rig.toml", tmp_path / "specimen.csv"
    by.write_text(to_toml(a_map()))
    scan3d.write_rig(calibration, rig)
    command = ["import", str(table), "--map", str(by), "--rig", str(rig), "--out", str(out), "--quiet"]
    assert main(command) == 0
    found = scan3d.read_recording(out)
    assert found.source["rig"]["name"] == "rig.toml"
    assert found.source["rig"]["sensor"]["position_mm"] == pytest.approx([4, -19, 5], abs=1e-3)
    assert_same(found, scan3d.import_table(table, a_map(), rig=calibration), 1e-12)
    for again in (["reconstruct", out, "--rig", rig], ["calibrate", out, "--sphere", "30"]):
        assert main([*map(str, again), "--out", str(tmp_path / "again.toml")]) == 1
        assert "was corrected by a calibrated rig already" in capsys.readouterr().err
