"""Clouds: each contact knows its row of the recording, and contacts can be selected."""

import dataclasses

import numpy as np
import pytest
import trimesh
from sample_bodies import MESHES

import planar
import scan3d
from scan3d.files.shapes import cloud_table, ply, read_ply
from scan3d.reconstruction.contacts import contacts

PER_CONTACT = {"points", "normals", "normal_source", "in_plane_normals", "phase", "slice", "sweep", "row"}
PER_CONTACT |= {"force_N", "friction", "covariance", "place_sd", "normal_sd"}


@pytest.fixture(scope="module")
def recording():
    # with noise, rows near touch-down are lost, so that rows and contacts differ
    plan = scan3d.Plan(slices=6, sweeps=5, samples=16, friction=(0.0, 0.4), noise=1e-4)
    return scan3d.simulate(scan3d.load_mesh(MESHES / "egg.stl"), plan)


@pytest.fixture(scope="module")
def cloud(recording):
    return contacts(recording)


def test_each_contact_has_the_force_and_the_sweep_of_its_row(recording, cloud):
    assert np.all(np.diff(cloud.row) > 0)
    assert 0 < len(cloud) < len(recording)
    assert cloud.force_N == pytest.approx(np.hypot(*recording.force_N[cloud.row].T), rel=1e-12)
    assert np.array_equal(cloud.sweep, recording.sweep[cloud.row])


@pytest.mark.parametrize("kind", ["mask", "indices"])
def test_selected_contacts_keep_their_rows_and_the_cloud_its_slices(cloud, kind):
    mask = cloud.phase == planar.Phase.TANGENTIAL
    selected = cloud.select(mask if kind == "mask" else np.flatnonzero(mask))
    assert 0 < len(selected) == mask.sum() < len(cloud)
    for field in dataclasses.fields(cloud):
        before, after = getattr(cloud, field.name), getattr(selected, field.name)
        if field.name in PER_CONTACT:
            assert after.dtype == before.dtype
            assert np.array_equal(after, before[mask], equal_nan=True)
        elif field.compare:
            assert after is before, field.name


@pytest.mark.parametrize("noise", [0.3, 0.6])
def test_noise_beyond_the_signal_raises_nothing(noise):
    plan = scan3d.Plan(slices=4, samples=16, noise=noise)
    recording = scan3d.simulate(trimesh.creation.box((20, 30, 40)), plan)
    assert np.isfinite(contacts(recording).points).all()


def test_the_file_of_a_noisy_cloud_has_the_uncertainty_of_each_contact(tmp_path):
    plan = scan3d.Plan(slices=4, samples=16, sweeps=4)
    mesh = trimesh.creation.box((20, 30, 40))
    exact, noisy = (contacts(scan3d.simulate(mesh, dataclasses.replace(plan, noise=noise))) for noise in (0.0, 1e-4))
    path = tmp_path / "cloud.ply"
    path.write_bytes(ply(cloud_table(noisy)))
    vertices, _, _ = read_ply(path)
    np.testing.assert_allclose(vertices["place_sd"], noisy.place_sd, rtol=1e-6)
    np.testing.assert_allclose(scan3d.touches(path).covariance, noisy.covariance, rtol=1e-6, atol=1e-7 * noisy.noise**2)
    tip = noisy.phase == planar.Phase.TIP
    assert np.isnan(vertices["normal_sd"][tip]).all()
    np.testing.assert_allclose(vertices["normal_sd"][~tip], noisy.normal_sd[~tip], rtol=1e-6)
    assert "place_sd" not in cloud_table(exact).dtype.names
