"""`scan3d calibrate` and ``--rig``: the file that is written, what is printed, and sentences for wrong input."""

import dataclasses
import json
import tomllib

import numpy as np
import pytest

import scan3d
from scan3d import InputError
from tests import rigs


@pytest.fixture(scope="module")
def touches(tmp_path_factory):
    """A recording of touches, in files."""
    path = tmp_path_factory.mktemp("touches") / "touches.csv"
    scan3d.write_recording(rigs.recorded(), path)
    return path


@pytest.fixture(scope="module")
def calibration():
    return scan3d.calibrate(rigs.recorded(), rigs.DIAMETER)


def test_the_command_writes_a_rig_and_prints_a_table(call, touches, tmp_path, calibration):
    rig = tmp_path / "new" / "rig.toml"
    code, out, err = call("calibrate", touches, "--sphere", 30, "--out", rig)
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0].split() == ["quantity", "value", "standard", "u", "expanded", "U", "determined"]
    stiffness = lines[1].split()
    assert stiffness[0] == "bending_stiffness_Nm2"
    assert float(stiffness[1]) == pytest.approx(rigs.Truth().stiffness, rel=0.005)
    assert float(stiffness[3]) == pytest.approx(2 * float(stiffness[2]), rel=0.05)
    assert stiffness[4] == "well"
    assert lines[-1] == f"written to {rig}"
    data = tomllib.loads(rig.read_text())
    assert data["rod"]["length_m"] == pytest.approx(0.06, abs=0.0003)
    assert data["sensor"]["position_mm"] == pytest.approx([4, -19, 5], abs=0.4)
    assert data["sensor"]["euler_deg"] == pytest.approx([12, 25, -10], abs=0.6)
    assert data["clamp"]["position_mm"] == pytest.approx([0.6, -1.1, 0.8], abs=0.12)
    assert len(data["covariance"]["matrix"]) == len(data["covariance"]["quantities"]) == len(calibration.names)
    # the digits of the table are all there
    assert data["rod"]["bending_stiffness_Nm2"] == calibration.rod.bending_stiffness_Nm2


def test_units_json_and_quiet(call, touches, tmp_path):
    code, out, _ = call("calibrate", touches, "--sphere", 0.03, "--unit", "m", "--out", tmp_path / "rig.toml", "--json")
    data = json.loads(out)
    assert code == 0
    assert data["sphere"]["diameter_mm"] == pytest.approx(30)
    assert data["fit"]["chi2_per_freedom"] == pytest.approx(1, abs=0.05)
    given = ("--pose-noise", 0.02, "--tare", "linear", "--quiet")
    assert call("calibrate", touches, "--sphere", 30, "--out", tmp_path / "rig.toml", *given) == (0, "", "")
    assert tomllib.loads((tmp_path / "rig.toml").read_text())["noise"]["pose_m"] == pytest.approx(20e-6)


def test_files_that_are_no_rigs_are_kept(call, touches, tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text("x = 1\n")
    code, _, err = call("calibrate", touches, "--sphere", 30, "--out", mine)
    assert code == 1
    assert "can't be recognised as written by scan3d" in err
    assert mine.read_text() == "x = 1\n"
    assert call("calibrate", touches, "--sphere", 30, "--out", mine, "--overwrite", "--quiet")[0] == 0
    # a rig may be written again
    assert call("calibrate", touches, "--sphere", 30, "--out", mine, "--quiet")[0] == 0
    code, _, err = call("calibrate", touches, "--sphere", 30, "--out", touches.with_suffix(".toml"), "--overwrite")
    assert (code, "TOML file of the recording" in err) == (1, True)
    code, _, err = call("calibrate", touches, "--sphere", 30, "--out", tmp_path / "rig.csv")
    assert (code, "a rig is written as .toml" in err) == (1, True)


def test_what_is_poorly_determined_is_said_on_stderr(call, tmp_path):
    raster = dict(reach=(0.7, 0.75, 0.8, 0.85, 0.9))
    scan3d.write_recording(rigs.recorded(rigs.EXACT, **raster), tmp_path / "touches.csv")
    code, out, err = call("calibrate", tmp_path / "touches.csv", "--sphere", 30, "--out", tmp_path / "rig.toml")
    assert code == 0
    assert "scan3d: These touches do not determine the free length" in err
    assert [line.split()[-2:] for line in out.splitlines() if line.startswith("length_m")] == [["no,", "nominal"]]
    data = tomllib.loads((tmp_path / "rig.toml").read_text())
    assert "length_m" not in data["uncertainty"]
    assert data["rod"]["length_m"] == 0.06
    found = scan3d.read_rig(tmp_path / "rig.toml")
    assert np.isinf(found.standard_deviations[found.names.index("length_m")])


def test_a_rig_is_read_back_as_it_was(tmp_path, calibration):
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


@pytest.mark.slow
def test_reconstruct_takes_a_rig(call, touches, tmp_path, monkeypatch, calibration):
    monkeypatch.setattr("scan3d.pictures.rendering.can_render", lambda: False)
    scan3d.write_rig(calibration, tmp_path / "rig.toml")
    exact = rigs.recorded(rigs.EXACT)
    scan3d.write_recording(exact, tmp_path / "log.csv")
    code, out, _ = call(
        "reconstruct", tmp_path / "log.csv", "--rig", tmp_path / "rig.toml", "--out", tmp_path / "out", "--json"
    )
    assert code == 0
    cloud = scan3d.reconstruct(scan3d.read_rig(tmp_path / "rig.toml").applied(exact))
    distance = np.linalg.norm(cloud.points - 1000 * rigs.CENTRE, axis=1)
    assert np.median(np.abs(distance - 15)) < 0.02
    assert json.loads(out)["counts"]["contacts"] == len(cloud)
    code, _, err = call("reconstruct", tmp_path / "log.csv", "--rig", tmp_path / "none.toml", "--out", tmp_path / "out")
    assert (code, "can't read the rig" in err) == (1, True)


MINIMAL = "[rod]\nlength_m = 0.06\nbending_stiffness_Nm2 = 2e-4\n"


def test_a_rig_by_hand_needs_the_rod_only(tmp_path):
    (tmp_path / "rig.toml").write_text(MINIMAL + "[sensor]\nposition_mm = [0, -20, 0]\neuler_deg = [0, 30, 0]\n")
    found = scan3d.read_rig(tmp_path / "rig.toml")
    assert found.names == ()
    assert found.sensor_position_m == pytest.approx([0, -0.02, 0])
    applied = found.applied(rigs.recorded())
    assert applied.rod.bending_stiffness_Nm2 == 2e-4


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", r"rig.toml: \[rod\] lacks length_m"),
        ("rod = 3", r"rod must be a section \[rod\], got 3"),
        ("[rod", "can't read the rig"),
        (MINIMAL + "[sensr]\n", "unknown names: sensr; did you mean sensor"),
        ("schema = 7\n" + MINIMAL, "schema 7, expected 1"),
        (MINIMAL + "[sensor]\nposition_mm = [1, 2]\n", r"\[sensor\] position_mm must be three numbers"),
        (MINIMAL + "[clamp]\neuler_deg = [1, 2, nan]\n", r"\[clamp\] euler_deg must be three numbers"),
        (MINIMAL.replace("2e-4", "true"), "bending_stiffness_Nm2 must be a number, got True"),
        (MINIMAL.replace("2e-4", "-1"), "positive bending stiffness"),
        (MINIMAL + '[covariance]\nquantities = ["length_m"]\nmatrix = [[1.0]]\nwell = [true]\n', "quantities of"),
        (
            MINIMAL + '[quantities]\na_mm = 1\n[covariance]\nquantities = ["a_mm"]\nmatrix = [["x"]]\n',
            r"\[covariance\]",
        ),
    ],
)
def test_wrong_files_have_a_sentence(tmp_path, text, sentence):
    (tmp_path / "rig.toml").write_text(text)
    with pytest.raises(InputError, match=sentence):
        scan3d.read_rig(tmp_path / "rig.toml")


@pytest.mark.parametrize("options", [("--sphere", "0"), ("--sphere", "30", "--pose-noise", "-1")])
def test_impossible_options_have_a_sentence(call, touches, tmp_path, options):
    code, _, err = call("calibrate", touches, *options, "--out", tmp_path / "rig.toml")
    assert code == 1
    assert err.count("\n") == 1
    assert not (tmp_path / "rig.toml").exists()
