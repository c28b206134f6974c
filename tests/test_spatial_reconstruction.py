"""Clouds of the spatial model: contacts, normals, friction and the rod's radius, against an ellipsoid's own formulas."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from spatial_scans import LENGTH, recorded

import planar
import scan3d
from scan3d.cloud import NormalSource
from scan3d.errors import InputError
from scan3d.spatial.normals import angles
from tests.rigs import in_world, six_axis_recording, with_wrench

FEW = {"directions": 4, "heights": 5}  # too few contacts for a fit


@pytest.fixture(scope="module")
def few():
    return recorded(0.3, substeps=6, **FEW)


@pytest.fixture(scope="module")
def random_friction():
    return recorded((0.0, 0.4), diameter=0.01, substeps=1, directions=8, heights=10)


@pytest.mark.slow
def test_contacts_and_normals_of_few_sweeps(few):
    recording, points, normals = few
    cloud = scan3d.reconstruct(recording)
    assert cloud.model == "spatial"
    assert cloud.fit is None
    np.testing.assert_array_equal(np.isfinite(points[:, 0]).sum(), len(cloud))
    np.testing.assert_allclose(cloud.points, points[cloud.row], atol=1e-8)
    expected = {NormalSource.SLIP, NormalSource.PATH, NormalSource.HULL, NormalSource.UNKNOWN}
    assert {NormalSource.SLIP, NormalSource.PATH} < set(cloud.normal_source) <= expected
    known = np.isin(cloud.normal_source, (NormalSource.SLIP, NormalSource.PATH))
    assert known.mean() > 0.8
    error = np.degrees(angles(cloud.normals[known], normals[cloud.row[known]]))
    assert np.median(error) < 0.02
    assert np.percentile(error, 95) < 0.2
    # the sweeps' own error, of the first order in their step, is 0.001
    assert np.nanmedian(np.abs(cloud.friction - 0.3)) < 1e-4
    compared = np.isfinite(cloud.slip_to_path)
    assert compared.sum() > 50
    assert np.degrees(np.median(cloud.slip_to_path[compared])) < 0.05
    assert np.isnan(cloud.in_plane_normals).all()
    assert (cloud.slice == -1).all()
    assert cloud.slice_axis.shape == (0, 3)
    assert cloud.slice_height.shape == (0,)
    np.testing.assert_allclose((normals[cloud.row] * cloud.tangents)[cloud.phase == 2].sum(axis=1), 0, atol=1e-8)
    assert np.abs(cloud.bending_angle).max() > 0.3


def test_without_friction_the_force_is_the_normal():
    recording, _, normals = recorded(0.0, **FEW)
    cloud = scan3d.reconstruct(recording)
    assert (cloud.normal_source == NormalSource.FORCE).all()
    np.testing.assert_allclose(cloud.normals, normals[cloud.row], atol=1e-9)
    assert (cloud.friction == 0).all()


@pytest.mark.slow
def test_smooth_bodies_are_fitted_whatever_the_friction_and_points_move_by_the_radius(random_friction):
    recording, points, normals = random_friction
    cloud = scan3d.reconstruct(recording)
    assert (cloud.normal_source == NormalSource.FIT).all()
    error = angles(cloud.normals, normals[cloud.row])
    assert np.degrees(error).max() < 5e-3
    assert np.mean(error < 3 * cloud.normal_sd) > 0.98
    assert cloud.rod_radius == pytest.approx(0.005 * cloud.rod_length)
    np.testing.assert_allclose(cloud.centre_points, points[cloud.row], atol=1e-8)
    np.testing.assert_allclose(cloud.points, (points - cloud.rod_radius * normals)[cloud.row], atol=5e-5)
    offset = cloud.points - cloud.fit.points(cloud.normals)
    assert np.abs(offset).max() < 5e-4
    assert np.nanmin(cloud.friction) >= 0
    assert np.nanmax(cloud.friction) < 0.4001


@pytest.mark.slow
@pytest.mark.parametrize("noise", [(1e-4, 1e-4), pytest.param((1e-3, 1e-4), marks=pytest.mark.trust)])
def test_noise_gives_the_errors_that_are_stated(noise):
    recording, points, normals = recorded(0.3, noise=noise, substeps=2, directions=8, heights=10)
    cloud = scan3d.reconstruct(recording)
    assert np.isfinite(points[cloud.row, 0]).all()
    assert len(cloud) > 0.7 * np.isfinite(points[:, 0]).sum()
    offset = cloud.centre_points - points[cloud.row]
    inner = np.linalg.inv(cloud.covariance)
    square = np.einsum("ni,nij,nj->n", offset, inner, offset)
    assert np.median(square) == pytest.approx(2.37, rel=0.15)  # of chi squared with three degrees of freedom
    assert np.mean(square > 16.3) < 0.01
    assert np.isfinite(cloud.place_sd).all()
    error = angles(cloud.normals, normals[cloud.row])
    assert np.mean(error < 3 * cloud.normal_sd) > 0.95


def test_turning_moving_and_scaling_the_scene_moves_the_cloud(few):
    recording, _, _ = few
    turn, shift, scale = Rotation.from_rotvec([0.3, -1.1, 0.7]), np.array([0.1, 0.2, -0.3]), 3.0
    force, moment = recording.wrench()
    scaled = replace(
        recording, position_m=scale * recording.position_m, rod=scan3d.Rod(scale * LENGTH, scale**2 * 1e-4)
    )
    moved = in_world(with_wrench(scaled, force, scale * moment), turn, shift)
    cloud, other = scan3d.reconstruct(recording), scan3d.reconstruct(moved)
    np.testing.assert_allclose(other.points, scale * turn.apply(cloud.points) + 1000 * shift, atol=1e-7)
    both = np.isfinite(cloud.normals[:, 0]) & np.isfinite(other.normals[:, 0])
    assert both.mean() > 0.85
    error = angles(other.normals, turn.apply(cloud.normals))[both]
    assert np.median(error) < 1e-9
    assert error.max() < 1e-5  # normals of slip and path differ by the error of the sweeps themselves


def test_the_model_is_chosen_by_the_axes_or_by_name(few):
    recording, _, _ = few
    plane = replace(recording, force_z_N=None, moment_x_Nm=None, moment_y_Nm=None)
    assert scan3d.reconstruct(recording).model == "spatial"
    assert scan3d.reconstruct(recording, model="planar").model == "planar"
    assert scan3d.reconstruct(plane).model == "planar"
    with pytest.raises(InputError, match="six-axis"):
        scan3d.reconstruct(plane, model="spatial")
    with pytest.raises(InputError, match="model must be"):
        scan3d.reconstruct(recording, model="cubic")


def test_a_recording_in_the_mirror_plane_has_the_planar_contacts():
    """A planar sweep of a circle, as six axes: the contacts of both models agree."""
    swept = planar.sweep(planar.Circle(0.45, (0.0, 0.75)), 0.3, samples=200)
    n, rod = len(swept), scan3d.Rod(LENGTH, 1e-4)
    place, force, moment = np.zeros((3, n, 3))
    place[:, 0] = LENGTH * swept.x0
    force[:, :2] = np.column_stack([swept.f0x, swept.f0y]) * rod.force_unit_N
    moment[:, 2] = swept.m0z * rod.moment_unit_Nm
    recording = six_axis_recording(rod, np.zeros(n, dtype=int), place, np.tile([1.0, 0, 0, 0], (n, 1)), force, moment)
    cloud, other = scan3d.reconstruct(recording), scan3d.reconstruct(recording, model="planar")
    np.testing.assert_array_equal(cloud.row, other.row)
    np.testing.assert_allclose(cloud.points, other.points, atol=1e-9)
    known = np.isfinite(cloud.normals[:, 0]) & (cloud.phase == planar.Phase.TANGENTIAL)
    assert known.mean() > 0.5
    # the path runs along the rod, so that the slip gives these normals
    assert (cloud.normal_source[known] == NormalSource.SLIP).all()
    error = angles(cloud.normals[known], other.in_plane_normals[known])
    assert np.median(error) < 1e-9


@pytest.mark.slow
def test_under_noise_centre_points_and_tangents_have_errors_as_stated(few):
    exact = scan3d.reconstruct(few[0])
    assert exact.centre_covariance is None
    assert exact.tangent_sd is None
    recording, points, _ = recorded(0.3, diameter=0.01, noise=(1e-4, 1e-4), substeps=10, **FEW)
    cloud = scan3d.reconstruct(recording)
    without, points_without, _ = recorded(0.3, diameter=0.01, substeps=10, **FEW)
    true = scan3d.reconstruct(without)
    # both clouds leave out rows without contact, and under noise light touches as well
    both, here, there = np.intersect1d(cloud.row, true.row, return_indices=True)
    np.testing.assert_array_equal(points, points_without)
    assert len(both) > 0.8 * len(true)
    turned = angles(cloud.tangents[here], true.tangents[there])
    assert np.sqrt(np.mean((turned / cloud.tangent_sd[here]) ** 2)) == pytest.approx(1, abs=0.1)
    moved = np.linalg.norm(cloud.centre_points - points[cloud.row], axis=1)
    centre_sd = np.sqrt(np.linalg.eigvalsh(cloud.centre_covariance)[:, -1])
    assert 0.4 < np.sqrt(np.mean((moved / centre_sd) ** 2)) < 1.5
    # the rod's radius adds the errors of the normals
    assert (cloud.place_sd >= centre_sd * (1 - 1e-9)).all()
