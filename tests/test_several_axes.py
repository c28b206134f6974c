"""Slices along several axes, planned together: how many, where, and how much better than along one axis."""

import functools

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import scan3d
from scan3d import InputError, Plan
from scan3d.geometry.sections import extent_along
from scan3d.planning.heights import BEYOND
from scan3d.planning.several_axes import FIRST_SLICES, first_heights_together, next_slices
from scan3d.reconstruction.contacts import contacts
from scan3d.surfaces import enclosure

TURN = Rotation.from_rotvec([0.3, -0.5, 0.7]).as_matrix()
POLYTOPE = trimesh.convex.convex_hull(np.random.default_rng(3).normal(size=(20, 3)) * [12, 9, 7])
ELLIPSOID = trimesh.convex.convex_hull(trimesh.creation.icosphere(5).vertices * [20, 14, 9] @ TURN)
CORNERS = np.array([[np.cos(a), np.sin(a)] for a in 2 * np.pi * np.arange(80) / 80])
FRUSTUM = trimesh.convex.convex_hull(
    np.concatenate([np.column_stack([r * CORNERS, np.full(80, h)]) for r, h in ((15, 0), (6, 25))]) @ TURN
)
MESHES = {"polytope": POLYTOPE, "ellipsoid": ELLIPSOID, "frustum": FRUSTUM}


@functools.cache
def cloud_of(name, slices, axes, **settings):
    return contacts(scan3d.simulate(MESHES[name], Plan(slices=slices, axis=axes, samples=32, **settings)))


def relative_bound(name, slices, axes):
    return enclosure(cloud_of(name, slices, axes)).bound / np.linalg.norm(MESHES[name].extents)


def slices_along(cloud, axis):
    """Number of slices along an axis, in which something was touched or not."""
    return int((cloud.slice_axis @ axis > 0.5).sum())


@pytest.mark.parametrize("slices", [1, 2, 5, 8])
def test_all_axes_together_get_the_slices_of_the_plan(slices):
    cloud = cloud_of("polytope", slices, "xyz", sweeps=6)
    assert len(cloud.slice_height) == 3 * (slices + BEYOND)
    assert all(slices_along(cloud, axis) >= min(slices, FIRST_SLICES) + BEYOND for axis in np.eye(3))


def test_two_axes_share_their_slices():
    cloud = cloud_of("ellipsoid", 12, "xz", sweeps=6)
    assert len(cloud.slice_height) == 2 * (12 + BEYOND)
    assert slices_along(cloud, np.array([0.0, 1.0, 0.0])) == 0


@pytest.mark.slow
def test_a_polytope_is_found_exactly():
    """To 1e-6 of the diagonal by 16 slices along each of three axes: 5.7e-7, and 4.5e-6 by 48 along one axis."""
    assert relative_bound("polytope", 16, "xyz") < 1e-6
    assert relative_bound("polytope", 16, "xyz") < 0.5 * relative_bound("polytope", 48, "z")


@pytest.mark.slow
def test_a_smooth_body_is_bounded_nearly_as_well_as_along_one_axis():
    """The slices beside the first ones go along one axis: (63 / 57)² = 1.22 times the gap of all along one."""
    assert relative_bound("ellipsoid", 21, "xyz") < 1.3 * relative_bound("ellipsoid", 63, "z")


@pytest.mark.slow
def test_a_body_of_very_many_vertices_is_sliced_along_one_axis():
    """More vertices than slices: all slices beside the first ones and few others go along one axis, as with smooth bodies."""
    cloud = cloud_of("frustum", 21, "xyz")
    most = max(slices_along(cloud, axis) for axis in np.eye(3))
    assert most >= 50
    assert relative_bound("frustum", 21, "xyz") < 1.5 * relative_bound("frustum", 64, "z")
    # all slices of the plan are swept, none more
    assert len(cloud.slice_height) == 3 * (21 + BEYOND)


def test_the_axis_of_all_further_slices_is_told():
    """With more open cells than slices left, early in the scan."""
    cloud = cloud_of("ellipsoid", 5, "xyz", sweeps=6)
    further = next_slices(cloud, Plan(slices=11, axis="xyz"), 18)
    assert further.slices == []
    assert np.abs(np.eye(3) - further.alone).max(axis=1).min() < 1e-12
    assert next_slices(cloud, Plan(slices=99, axis="xyz"), 300).alone is None


@pytest.mark.slow
def test_a_tolerance_ends_the_scan():
    plan = Plan(slices=30, axis="xyz", samples=32, sweeps=6, tolerance=5e-3)
    cloud = contacts(scan3d.simulate(POLYTOPE, plan))
    size = np.linalg.norm(np.ptp(cloud.points, axis=0))
    assert len(cloud.slice_height) < 3 * 30
    assert enclosure(cloud).bound <= plan.tolerance * size


def test_the_plan_is_deterministic():
    cloud = cloud_of("polytope", 5, "xyz", sweeps=6)
    plan = Plan(slices=10, axis="xyz")
    first, second = next_slices(cloud, plan, 9).slices, next_slices(cloud, plan, 9).slices
    assert len(first) == len(second) > 0
    for (axis, heights), (again, same) in zip(first, second, strict=True):
        assert (axis == again).all()
        assert (heights == same).all()


def test_further_slices_lie_in_the_body_and_are_new():
    cloud = cloud_of("ellipsoid", 5, "xyz", sweeps=6)
    further = next_slices(cloud, Plan(slices=9, axis="xyz"), 12).slices
    assert 0 < sum(len(heights) for _, heights in further) <= 12
    for axis, heights in further:
        low, high = extent_along(ELLIPSOID, axis)
        known = cloud.slice_height[cloud.slice_axis @ axis > 0.5]
        assert ((heights > low) & (heights < high)).all()
        assert np.abs(heights[:, None] - known).min() > 1e-6 * (high - low)


def test_no_slices_are_left():
    cloud = cloud_of("polytope", 5, "xyz", sweeps=6)
    assert next_slices(cloud, Plan(slices=5, axis="xyz"), 0).slices == []
    assert next_slices(cloud, Plan(slices=50, axis="xyz", tolerance=1.0), 50).slices == []


def test_contacts_that_span_no_body_are_refused():
    cloud = cloud_of("polytope", 5, "xyz", sweeps=6)
    with pytest.raises(InputError):
        next_slices(cloud.select(np.arange(3)), Plan(slices=5, axis="xyz"), 5)


@pytest.mark.parametrize("slices", [1, 3, 21])
def test_the_first_heights_are_some_of_those_of_one_axis(slices):
    plan = Plan(slices=slices, axis="xyz")
    first = first_heights_together(-2.0, 4.0, plan)
    few = min(slices, FIRST_SLICES)
    assert len(first) == few + BEYOND
    nodes = 1 - 3 * np.cos(np.pi * (np.arange(3 * slices - 2 * few) + 0.5) / (3 * slices - 2 * few))
    assert np.abs(first[:few, None] - nodes).min(axis=1).max() < 1e-12
    assert first[-2] < -2.0
    assert first[-1] > 4.0


@pytest.mark.slow
def test_noisy_contacts_are_planned_axis_by_axis():
    cloud = cloud_of("ellipsoid", 9, "xyz", noise=1e-3)
    assert [slices_along(cloud, axis) for axis in np.eye(3)] == [9 + BEYOND] * 3
