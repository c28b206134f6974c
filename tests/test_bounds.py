"""The certificate: the bound from touch alone is never below the true distance, which `compare` computes with the truth."""

import dataclasses

import numpy as np
import pytest
import trimesh
from sample_bodies import convex_hausdorff, random_body

import planar
import scan3d
from scan3d.geometry.hulls import hull
from scan3d.reconstruction.contacts import contacts
from scan3d.surfaces import Gap, certificate, enclosure, surface


@pytest.mark.parametrize("block", range(24))
def test_the_bound_is_never_below_the_true_distance(block):
    """240 bodies, most with few slices: the hull's bound, that of the surface between the bounds, and the volume's."""
    for seed in range(10 * block, 10 * block + 10):
        mesh = random_body(seed)
        plan = scan3d.Plan(
            slices=6 + seed % 7 if seed % 10 else 24,
            friction=(0.0, 0.4),
            spacing=("cosine", "uniform", "adaptive")[seed % 3],
            samples=16,
            sweeps=6,
        )
        cloud = contacts(scan3d.simulate(mesh, plan))
        bounds = enclosure(cloud)
        rounding = 1e-9 * np.linalg.norm(mesh.extents)
        assert np.isfinite(bounds.bound)
        assert bounds.bound >= convex_hausdorff(bounds.inner, mesh) - rounding
        assert bounds.volume[0] * (1 - 1e-9) <= mesh.volume <= bounds.volume[1] * (1 + 1e-9)
        assert bounds.bound == pytest.approx(max(bounds.part(gap) for gap in Gap), abs=rounding)
        if seed % 5 == 0:
            estimate = surface(cloud, "bracket", bounds=bounds)
            assert certificate(bounds, estimate).bound >= convex_hausdorff(estimate, mesh) - rounding


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_the_certificate_holds_for_any_convex_surface(seed):
    mesh = random_body(seed)
    bounds = enclosure(contacts(scan3d.simulate(mesh, scan3d.Plan(slices=16, friction=(0.0, 0.4)))))
    larger = trimesh.Trimesh(bounds.inner.vertices * 1.01, bounds.inner.faces, process=False)
    bound, at_vertices = certificate(bounds, larger)
    assert bound >= scan3d.compare(larger, mesh).hausdorff
    assert at_vertices.shape == (len(larger.vertices),)
    assert at_vertices.max() == pytest.approx(bound)


def test_adaptive_slices_find_the_corners_of_an_oblique_cube():
    """Cosine spacing leaves 5e-3 of the diagonal there; a slice at a vertex's own height closes the gap at once."""
    mesh = trimesh.creation.box((40, 40, 40))
    mesh.apply_transform(trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.6, 0.8])))
    plan = scan3d.Plan(slices=64, spacing="adaptive", friction=(0.0, 0.4))
    cloud = contacts(scan3d.simulate(mesh, plan))
    assert len(cloud.slice_height) <= 64
    assert scan3d.compare(hull(cloud.points), mesh).relative < 1e-5


def test_adaptive_slices_stop_at_the_tolerance():
    mesh = trimesh.creation.box((40, 40, 40))
    plan = scan3d.Plan(slices=64, spacing="adaptive", tolerance=1e-3)
    cloud = contacts(scan3d.simulate(mesh, plan))
    assert len(cloud.slice_height) < 40
    assert enclosure(cloud).bound <= 1e-3 * np.linalg.norm(mesh.extents)


def test_slices_along_several_axes_bound_each_others_ends():
    mesh = trimesh.creation.box((20, 30, 40))
    cloud = contacts(scan3d.simulate(mesh, scan3d.Plan(slices=6, axis="xyz", samples=32)))
    bounds = enclosure(cloud)
    assert np.isfinite(bounds.bound)
    assert bounds.bound >= scan3d.compare(bounds.inner, mesh).hausdorff - 1e-9


def test_the_certificate_does_not_rest_on_an_inferred_friction():
    """A wrong coefficient would make the bound wrong: the enclosure is that of the tangential contacts alone."""
    recording = scan3d.simulate(trimesh.creation.icosphere(3, 20.0), scan3d.Plan(slices=8, samples=16, friction=0.3))
    cloud = contacts(recording)
    tip = cloud.phase == planar.Phase.TIP
    assert np.isfinite(cloud.in_plane_normals[tip]).all()
    without_tip_normals = cloud.in_plane_normals.copy()
    without_tip_normals[tip] = np.nan
    assert enclosure(cloud).bound == enclosure(dataclasses.replace(cloud, in_plane_normals=without_tip_normals)).bound
