"""The noise of the clamp's poses: in files, in the covariances of contacts, in bounds and in calibrations."""

import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.stats import chi2

import scan3d
from scan3d.files.recordings import read_recording, write_recording
from scan3d.reconstruction.contacts import readings, without_normals
from scan3d.recording import joined
from scan3d.surfaces import enclosure
from tests import rigs
from tests.spatial_scans import LENGTH, SEMI_AXES, recorded

SD_M = 20e-6
BODY = scan3d.load_mesh("meshes/cube.stl")


def plan_of(noise):
    return scan3d.Plan(slices=8, samples=30, friction=0.3, rod=scan3d.Rod(0.06, 1.9e-4, 0.0003), noise=noise)


def scanned(model, noise):
    """A recording of a cube in slices, or of an ellipsoid in space, and the body."""
    if model == "planar":
        return scan3d.simulate(BODY, plan_of(noise)), BODY
    ellipsoid = trimesh.creation.icosphere(5)
    ellipsoid.apply_scale(1000 * LENGTH * np.array(SEMI_AXES))
    return recorded(0.3, directions=5, heights=6, samples=128, noise=(noise, noise))[0], ellipsoid


def jittering(recording, seed):
    """The recording with poses that are off by white noise, and that say so."""
    noise = SD_M * np.random.default_rng(seed).normal(size=recording.position_m.shape)
    return dataclasses.replace(recording, position_m=recording.position_m + noise, noise_pose_m=SD_M)


def places(recording):
    """The contacts of a recording before normals are sought."""
    return without_normals(recording, readings(recording)) if recording.six_axis else scan3d.reconstruct(recording)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["planar", "spatial"])
@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_the_covariances_hold_and_so_does_the_bound(model, noise):
    """Contacts, in space those of the rod's centre line, against those of exact reactions at exact poses."""
    recording, body = scanned(model, noise)
    recording = jittering(recording, 1)
    exact, cloud = places(scanned(model, 0.0)[0]), places(recording)
    _, rows, of_exact = np.intersect1d(cloud.row, exact.row, return_indices=True)
    assert len(rows) > 500
    off = cloud.points[rows] - exact.points[of_exact]
    inside = np.einsum("ni,nij,nj->n", off, np.linalg.inv(cloud.covariance[rows]), off) < chi2.isf(0.05, 3)
    assert 0.93 < inside.mean() < 0.97
    assert (cloud.place_sd >= 1000 * SD_M).all()
    bounds = enclosure(scan3d.reconstruct(recording))
    assert bounds.confidence == 0.95
    assert scan3d.compare(bounds.inner, body).hausdorff <= bounds.bound


@pytest.mark.slow
def test_without_the_statement_the_same_poses_are_trusted_too_far():
    """The test above can fail: unstated, the jitter leaves few contacts in their regions."""
    exact, noisy = (scan3d.simulate(BODY, plan_of(noise)) for noise in (0.0, 1e-5))
    exact, cloud = places(exact), places(dataclasses.replace(jittering(noisy, 1), noise_pose_m=0.0))
    _, rows, of_exact = np.intersect1d(cloud.row, exact.row, return_indices=True)
    off = cloud.points[rows] - exact.points[of_exact]
    assert (np.linalg.norm(off, axis=1) > 5 * cloud.place_sd[rows]).mean() > 0.5


def test_the_file_of_a_recording_keeps_it(tmp_path):
    recording = jittering(scan3d.simulate(BODY, plan_of(0.0)), 1)
    write_recording(recording, tmp_path / "r.csv")
    assert read_recording(tmp_path / "r.csv").noise_pose_m == SD_M
    assert "20 µm of the pose" in str(recording)
    write_recording(dataclasses.replace(recording, noise_pose_m=0.0), tmp_path / "r.csv", overwrite=True)
    assert "pose_m" not in (tmp_path / "r.toml").read_text()
    assert read_recording(tmp_path / "r.csv").noise_pose_m == 0


@pytest.mark.slow
def test_a_calibration_takes_it_from_the_recording_and_gives_it_to_others():
    touches = rigs.recorded(sweeps=8, samples=60)
    recording = dataclasses.replace(touches, noise_pose_m=SD_M)
    stated = scan3d.calibrate(recording, rigs.DIAMETER)
    assert (stated.details["pose_noise"], stated.pose_noise_m) == ("given", pytest.approx(SD_M))
    assert stated.applied(recording).noise_pose_m == SD_M
    estimated = scan3d.calibrate(touches, rigs.DIAMETER)
    assert estimated.details["pose_noise"] == "estimated"
    assert estimated.applied(touches).noise_pose_m == estimated.pose_noise_m > 0


def test_joined_recordings_state_the_larger_one():
    recording = scan3d.simulate(BODY, plan_of(0.0))
    assert joined([jittering(recording, 1), recording]).noise_pose_m == SD_M
