"""Contacts from a recording: what they are under extreme noise, and which row of the recording each one comes from."""

import dataclasses

import numpy as np
import pytest
import trimesh

import planar
import scan3d
from scan3d.files.ply import ply
from scan3d.files.tables import cloud_table
from scan3d.reconstruction.contacts import contacts
from scan3d.units import UNITS_M


@pytest.mark.parametrize("noise", [0.3, 0.6])
def test_noise_beyond_the_signal_raises_nothing(noise):
    plan = scan3d.Plan(slices=4, samples=16, noise=noise)
    recording = scan3d.simulate(trimesh.creation.box((20, 30, 40)), plan)
    assert np.isfinite(contacts(recording).points).all()


# --- the row of the recording that a contact comes from ---


def force_of_rows(recording, cloud):
    """Contact force (n,) by the reactions of each contact's row: the rod's only loads are at its two ends."""
    return np.hypot(*recording.force_N[cloud.row].T)


def recording_with_gaps():
    """A scan with samples before touch-down and empty slices, so that contacts and rows do not run in step."""
    recording = scan3d.simulate(
        trimesh.creation.box((20, 30, 40)), scan3d.Plan(slices=6, samples=16, sweeps=4, friction=(0.0, 0.4))
    )
    without_contact = np.arange(len(recording)) % 5 == 2
    return dataclasses.replace(
        recording,
        force_N=np.where(without_contact[:, None], 0.0, recording.force_N),
        moment_Nm=np.where(without_contact, 0.0, recording.moment_Nm),
    ), without_contact


def test_a_contacts_row_has_its_force():
    recording, without_contact = recording_with_gaps()
    cloud = contacts(recording)
    assert len(cloud) < len(recording)
    assert not without_contact[cloud.row].any()
    assert (np.diff(cloud.row) > 0).all()
    np.testing.assert_allclose(force_of_rows(recording, cloud), cloud.force_N, rtol=1e-12)
    np.testing.assert_array_equal(recording.sweep[cloud.row], cloud.sweep)


def test_a_contacts_row_has_its_force_under_noise():
    plan = scan3d.Plan(slices=6, samples=16, sweeps=4, noise=1e-3, seed=2)
    recording = scan3d.simulate(trimesh.creation.icosphere(3, 20.0), plan)
    cloud = contacts(recording)
    # under noise, rows with small forces are left out
    assert len(cloud) < len(recording)
    np.testing.assert_allclose(force_of_rows(recording, cloud), cloud.force_N, rtol=1e-12)


def test_a_contact_is_within_a_rod_length_of_its_rows_clamp():
    recording, _ = recording_with_gaps()
    cloud = contacts(recording)
    distance = np.linalg.norm(cloud.points - recording.position_m[cloud.row] / UNITS_M[recording.unit], axis=1)
    assert distance.max() <= cloud.rod_length * (1 + 1e-9)


def test_the_file_of_the_cloud_has_the_rows(tmp_path, read_ply):
    recording, _ = recording_with_gaps()
    cloud = contacts(recording)
    path = tmp_path / "cloud.ply"
    path.write_bytes(ply(cloud_table(cloud)))
    vertices, _, _ = read_ply(path)
    np.testing.assert_array_equal(vertices["row"], cloud.row)
    np.testing.assert_allclose(np.hypot(*recording.force_N[vertices["row"]].T), vertices["force"], rtol=1e-12)


def test_selected_contacts_keep_their_rows():
    recording, _ = recording_with_gaps()
    cloud = contacts(recording)
    selected = cloud.select(cloud.phase == planar.Phase.TANGENTIAL)
    assert 0 < len(selected) < len(cloud)
    np.testing.assert_allclose(force_of_rows(recording, selected), selected.force_N, rtol=1e-12)
    np.testing.assert_array_equal(cloud.select(np.array([3, 1])).row, cloud.row[[3, 1]])


def test_the_file_of_a_noisy_cloud_has_the_uncertainty_of_each_contact(read_ply, tmp_path):
    plan = scan3d.Plan(slices=4, samples=16, sweeps=4)
    mesh = trimesh.creation.box((20, 30, 40))
    exact, noisy = (contacts(scan3d.simulate(mesh, dataclasses.replace(plan, noise=noise))) for noise in (0.0, 1e-4))
    path = tmp_path / "cloud.ply"
    path.write_bytes(ply(cloud_table(noisy)))
    vertices, _, _ = read_ply(path)
    np.testing.assert_allclose(vertices["place_sd"], noisy.place_sd, rtol=1e-6)
    tip = noisy.phase == planar.Phase.TIP
    assert np.isnan(vertices["normal_sd"][tip]).all()
    np.testing.assert_allclose(vertices["normal_sd"][~tip], noisy.normal_sd[~tip], rtol=1e-6)
    assert "place_sd" not in cloud_table(exact).dtype.names
