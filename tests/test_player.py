"""The data of the page's player: the samples of all sweeps with contacts, as the recording has them."""

import base64
from dataclasses import replace

import numpy as np
import pytest
from small_scans import CUBE, scanned, scanned_in_space

import scan3d
from scan3d.pictures.page import player, samples_of
from scan3d.recording import Recording
from scan3d.rods import Rod


def array(text, kind="<f4"):
    return np.frombuffer(base64.b64decode(text), kind)


@pytest.mark.parametrize("scene", [scanned(CUBE), scanned_in_space()], ids=["planar", "spatial"])
def test_the_player_has_the_poses_and_reactions_of_the_recording(scene):
    center = np.array([1.0, -2.0, 3.0])
    data, recording = player(scene, center), scene.recording
    of_contact, rows = array(data["contact"], "<u4"), scene.column("row").astype(int)
    position = array(data["position"]).reshape(-1, 3) + center
    assert position[of_contact] == pytest.approx(1e3 * recording.position_m[rows], abs=1e-4)
    width = sum(len(chart["names"]) for chart in data["labels"])
    reactions = array(data["reactions"]).reshape(len(position), width)
    force, moment = recording.force_N, recording.moment_Nm[:, None]
    if width == 6:
        force, moment = recording.wrench()
        assert array(data["bending"])[of_contact] == pytest.approx(scene.column("bending"), abs=1e-6)
    expected = np.hstack([1e3 * force, 1e6 * moment])[rows]
    assert reactions[of_contact] == pytest.approx(expected, rel=1e-6)
    # the orientation of a sample is the last one that begins at it or before
    turned, turns = array(data["turned"], "<u4"), array(data["turns"]).reshape(-1, 4)
    chosen = turns[np.searchsorted(turned, of_contact, "right") - 1]
    assert chosen == pytest.approx(recording.quaternion[rows], abs=1e-6)
    # every sample is in the sweep of its contact
    sweeps = np.searchsorted(data["starts"], of_contact, "right") - 1
    assert np.array_equal(np.array(data["numbers"])[sweeps], scene.column("sweep"))
    assert data["numbers"][data["shown"]] in data["numbers"]
    assert data["length"] == pytest.approx(1e3 * recording.rod.length_m)


def log(sweep):
    n = len(sweep)
    return Recording(
        sweep=np.array(sweep),
        position_m=np.column_stack([np.arange(n), np.zeros(n), np.zeros(n)]).astype(float),
        quaternion=np.tile([1.0, 0, 0, 0], (n, 1)),
        force_N=np.zeros((n, 2)),
        moment_Nm=np.zeros(n),
        rod=Rod(0.05, 1e-4),
    )


def test_sweeps_are_shown_with_a_little_air_before_and_after_their_contacts():
    # 100 samples in each of three sweeps, of which the second touches nothing
    recording = log(np.repeat([7, 8, 9], 100))
    rows = np.concatenate([np.arange(50, 58), [299, 296]])
    samples = samples_of(recording, rows)
    assert samples.numbers.tolist() == [7, 9]
    # a quarter of eight contacts is two samples; the third sweep ends with its last contact
    assert samples.rows.tolist() == [*range(48, 60), *range(295, 300)]
    assert samples.starts.tolist() == [0, 12]
    assert samples.rows[samples.of_contact].tolist() == rows.tolist()


def test_samples_of_sweeps_that_alternate_in_the_log_are_put_in_order():
    recording = log([2, 1] * 4)
    samples = samples_of(recording, np.arange(8))
    assert samples.numbers.tolist() == [1, 2]
    assert samples.rows.tolist() == [1, 3, 5, 7, 0, 2, 4, 6]
    assert samples.rows[samples.of_contact].tolist() == list(range(8))


def test_contacts_of_another_recording_have_no_player():
    scene = scanned(CUBE)
    other = replace(scene.recording, force_N=2 * scene.recording.force_N)
    with pytest.raises(scan3d.InputError, match=r"the contacts of cube do not belong to its recording"):
        player(replace(scene, recording=other), np.zeros(3))
