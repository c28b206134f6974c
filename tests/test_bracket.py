"""The certificate: the bound from touch alone is never below the true distance, which `compare` knows and it does not."""

import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

import scan3d
from scan3d.bracket import Gap, bracket, certificate
from scan3d.cloud import contacts
from scan3d.comparison import nearest
from scan3d.hulls import hull
from scan3d.surfaces import surface


def random_body(seed):
    """Polytopes, ellipsoids, their Minkowski sums, needles and discs, turned any way."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    kind = seed % 4
    polytope = rng.normal(size=(12, 3))
    round_ = directions * [1.0, 0.7, 0.5]
    if kind == 0:
        points = polytope
    elif kind == 1:
        points = round_
    elif kind == 2:
        points = (polytope[:, None] + 0.3 * round_[::4]).reshape(-1, 3)
    else:
        points = directions * ([1.0, 0.05, 0.05] if seed % 8 < 4 else [1.0, 1.0, 0.05])
    points = 20 * points @ trimesh.transformations.random_rotation_matrix(rng.uniform(size=3))[:3, :3].T
    return hull(points[ConvexHull(points).vertices])


def apart(first, second):
    """Hausdorff distance of two convex surfaces: the largest distance of a vertex of either from the other one."""
    return max(np.abs(nearest(a.vertices, b)[0]).max() for a, b in ((first, second), (second, first)))


@pytest.mark.parametrize("block", range(24))
def test_the_bound_is_never_below_the_true_distance(block):
    """240 bodies, few slices on most: the hull's bound, that of the surface between the bounds, and the volume's."""
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
        found = bracket(cloud)
        rounding = 1e-9 * np.linalg.norm(mesh.extents)
        assert np.isfinite(found.bound)
        assert found.bound >= apart(found.inner, mesh) - rounding
        assert found.volume[0] * (1 - 1e-9) <= mesh.volume <= found.volume[1] * (1 + 1e-9)
        assert found.bound == pytest.approx(max(found.part(gap) for gap in Gap), abs=rounding)
        if seed % 5 == 0:
            between = surface(cloud, "bracket", found=found)
            assert certificate(found, between)[0] >= apart(between, mesh) - rounding


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_the_certificate_holds_for_any_convex_surface(seed):
    mesh = random_body(seed)
    found = bracket(contacts(scan3d.simulate(mesh, scan3d.Plan(slices=16, friction=(0.0, 0.4)))))
    bigger = trimesh.Trimesh(found.inner.vertices * 1.01, found.inner.faces, process=False)
    bound, local = certificate(found, bigger)
    assert bound >= scan3d.compare(bigger, mesh).hausdorff
    assert local.shape == (len(bigger.vertices),)
    assert local.max() == pytest.approx(bound)


def test_nothing_bounds_a_body_past_its_end_slices_unless_an_empty_slice_does():
    mesh = trimesh.creation.box((20, 30, 40))
    cloud = contacts(scan3d.simulate(mesh, scan3d.Plan(slices=6)))
    filled = np.unique(cloud.slice)
    assert len(cloud.slice_height) == len(filled) + 2
    assert np.isfinite(bracket(cloud).bound)
    rank = np.searchsorted(filled, cloud.slice).astype(np.int32)
    blind = dataclasses.replace(
        cloud, slice=rank, slice_axis=cloud.slice_axis[filled], slice_height=cloud.slice_height[filled]
    )
    assert np.isinf(bracket(blind).bound)


def test_adaptive_slices_find_the_corners_of_an_oblique_cube():
    """Cosine spacing leaves 5e-3 of the diagonal there; a vertex's own height closes the bracket at once."""
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
    assert bracket(cloud).bound <= 1e-3 * np.linalg.norm(mesh.extents)


def test_several_axes_bound_each_others_ends():
    mesh = trimesh.creation.box((20, 30, 40))
    cloud = contacts(scan3d.simulate(mesh, scan3d.Plan(slices=6, axis="xyz", samples=32)))
    found = bracket(cloud)
    assert np.isfinite(found.bound)
    assert found.bound >= scan3d.compare(found.inner, mesh).hausdorff - 1e-9


def test_a_margin_for_noise_widens_the_bracket():
    cloud = contacts(scan3d.simulate(trimesh.creation.box((20, 30, 40)), scan3d.Plan(slices=8, samples=32)))
    assert bracket(cloud, margin=0.1).bound >= bracket(cloud).bound + 0.1


def test_contours_that_are_seen_from_one_side_only_are_not_bounded():
    """Half-spaces that do not close have corners at infinity, which must not get lost."""
    mesh = trimesh.creation.icosphere(3, 20.0)
    assert np.isinf(bracket(contacts(scan3d.simulate(mesh, scan3d.Plan(slices=8, sweeps=1)))).bound)
    assert np.isfinite(bracket(contacts(scan3d.simulate(mesh, scan3d.Plan(slices=8, sweeps=4)))).bound)


@pytest.mark.parametrize("noise", [0.3, 0.6])
def test_noise_beyond_reason_is_no_traceback(noise):
    plan = scan3d.Plan(slices=4, samples=16, noise=noise)
    recording = scan3d.simulate(trimesh.creation.box((20, 30, 40)), plan)
    assert np.isfinite(contacts(recording).points).all()
