"""The heights of further slices, asked for by a rig that is not the simulation, and where they stop."""

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

import planar
import scan3d
from scan3d import InputError, Plan, Recording, Rod
from scan3d.geometry.sections import extent_along, slice_polygons
from scan3d.planning import next_heights
from scan3d.planning.aims import base_fractions, first_directions
from scan3d.planning.heights import BEYOND, SlabMemory, first_heights
from scan3d.reconstruction.contacts import contacts
from scan3d.surfaces import enclosure

GEM = Path(__file__).parents[1] / "meshes" / "gem.glb"
ROD = Rod.of_length(0.06)
PLAN = Plan(slices=24, spacing="adaptive", sweeps=6, samples=20, friction=0.2, rod=ROD)


class Rig:
    """A rig that sweeps a body in horizontal slices, written by hand on `planar` alone, and logs in metres."""

    def __init__(self, mesh, plan):
        self.mesh, self.plan = mesh, plan
        self.length = plan.rod.length_m * 1e3
        self.heights, self.columns = [], []

    def sweep(self, heights):
        for height in map(float, heights):
            self.heights.append(height)
            (polygon,) = slice_polygons(self.mesh, np.eye(3), [height])
            for angle in first_directions(self.plan):
                self._sweep_from(angle, polygon, height)

    def _sweep_from(self, angle, polygon, height):
        # the clamp's x and y axes as rows; the base line lies below the middle of the contour's box, at the clearance
        turn = np.array([[np.sin(angle), -np.cos(angle)], [np.cos(angle), np.sin(angle)]])
        n = self.plan.samples
        if len(polygon):
            middle = (polygon.min(axis=0) + polygon.max(axis=0)) / 2
            away = ((polygon - middle) @ turn[1]).min() - self.plan.clearance * self.length
            origin = middle + away * turn[1]
            contour = planar.Polygon((polygon - origin) @ turn.T / self.length)
            (swept,) = planar.sweep_all([contour], [self.plan.friction], shares=base_fractions(n))
            x0, wrench = swept.x0, np.nan_to_num(np.stack([swept.f0x, swept.f0y, swept.m0z]))
        else:
            origin, x0, wrench = np.zeros(2), np.linspace(0.5, -0.5, n), np.zeros((3, n))
        place = np.column_stack([origin + self.length * x0[:, None] * turn[0], np.full(n, height)])
        half = (angle - np.pi / 2) / 2  # the turn about z that brings the world's y axis to the rod's direction
        quaternion = np.tile([np.cos(half), 0.0, 0.0, np.sin(half)], (n, 1))
        self.columns.append((np.full(n, len(self.columns)), place * 1e-3, quaternion, wrench))

    def recording(self):
        sweep, place, quaternion, wrench = zip(*self.columns, strict=True)
        fx, fy, mz = np.concatenate(wrench, axis=1)
        rod = self.plan.rod
        return Recording(
            sweep=np.concatenate(sweep),
            position_m=np.concatenate(place),
            quaternion=np.concatenate(quaternion),
            force_N=np.stack([fx, fy], axis=1) * rod.bending_stiffness_Nm2 / rod.length_m**2,
            moment_Nm=mz * rod.bending_stiffness_Nm2 / rod.length_m,
            rod=rod,
        )


def scanned_by_rig(mesh, plan):
    """The rig after a scan, and the bound of the enclosure, over the contacts' diagonal, before every question."""
    rig, bounds, memory = Rig(mesh, plan), [], SlabMemory()
    rig.sweep(first_heights(*extent_along(mesh, [0, 0, 1]), plan))
    while True:
        cloud = contacts(rig.recording())
        bounds.append(enclosure(cloud).bound / np.linalg.norm(np.ptp(cloud.points, axis=0)))
        heights = next_heights(cloud, plan, memory=memory)
        if not len(heights):
            return rig, bounds
        rig.sweep(heights)


@pytest.fixture(scope="module")
def gem():
    return scan3d.load_mesh(GEM)


@pytest.fixture(scope="module")
def first_cloud(gem):
    """The contacts in the first slices of an adaptive scan."""
    rig = Rig(gem, PLAN)
    rig.sweep(first_heights(*extent_along(gem, [0, 0, 1]), PLAN))
    return contacts(rig.recording())


@pytest.mark.slow
def test_a_rig_is_given_the_heights_of_the_simulation(gem):
    rig, bounds = scanned_by_rig(gem, PLAN)
    simulated = contacts(scan3d.simulate(gem, PLAN))
    assert len(rig.heights) == len(simulated.slice_height) == PLAN.slices + BEYOND
    # heights of vertices found by touch: to rounding in sections of unit size, larger where slices are close
    assert np.sort(rig.heights) == pytest.approx(np.sort(simulated.slice_height), abs=1e-6 * gem.scale)
    assert bounds[-1] < 0.2 * bounds[0]


@pytest.mark.slow
def test_of_a_smooth_body_that_is_known_well_all_heights_that_are_left_are_swept_at_once():
    egg = scan3d.load_mesh(GEM.with_name("egg.stl"))
    numbers = []
    for tolerance in (0.0, 1e-9):
        plan = Plan(**{**vars(PLAN), "slices": 64, "tolerance": tolerance})
        rig, memory, done = Rig(egg, plan), SlabMemory(), []
        heights = first_heights(*extent_along(egg, [0, 0, 1]), plan)
        while len(heights):
            rig.sweep(heights)
            done.append(len(rig.heights))
            heights = next_heights(contacts(rig.recording()), plan, memory=memory)
        numbers.append(done)
        assert done[-1] == plan.slices + BEYOND
    # with a tolerance slabs are halved, so that the scan may stop earlier
    assert len(numbers[0]) == 4 < len(numbers[1])


def test_a_rig_stops_where_the_bound_meets_the_tolerance(gem):
    rig, bounds = scanned_by_rig(gem, Plan(**{**vars(PLAN), "tolerance": 0.03}))
    assert 10 <= len(rig.heights) < PLAN.slices
    assert bounds[-1] <= 0.03
    assert min(bounds[:-1]) > 0.03


def test_the_memory_changes_no_answer(first_cloud):
    memory = SlabMemory()
    plain = next_heights(first_cloud, PLAN)
    assert len(plain) > 0
    assert np.array_equal(next_heights(first_cloud, PLAN, memory=memory), plain)
    assert set(memory.gaps) == set(memory.slabs) != set()
    # filled, it is used, and gives the same
    assert np.array_equal(next_heights(first_cloud, PLAN, memory=memory), plain)


def test_the_heights_are_new_and_inside_the_body(first_cloud, gem):
    heights = next_heights(first_cloud, PLAN)
    low, high = extent_along(gem, [0, 0, 1])
    beyond = np.ptp(first_cloud.slice_height)
    assert np.all((heights > low - beyond) & (heights < high + beyond))
    assert np.abs(heights[:, None] - first_cloud.slice_height).min() > 0


@pytest.mark.parametrize("turned", [False, True])
def test_of_a_prism_along_the_axis_only_the_ends_are_sliced(turned):
    """Rounding of its gaps decides nothing: between the first slices nothing is left to be found."""
    mesh = trimesh.creation.box((40, 30, 50))
    if turned:
        mesh.apply_transform(trimesh.transformations.rotation_matrix(0.7, (0, 0, 1)))
    plan = Plan(slices=24, sweeps=4, samples=16)
    heights = np.sort(contacts(scan3d.simulate(mesh, plan)).slice_height)
    first = np.sort(first_heights(-25, 25, plan))
    inside = heights[(heights > first[1] + 1e-9) & (heights < first[-2] - 1e-9)]
    np.testing.assert_allclose(inside, first[2:-2])
    assert len(heights) > len(first)


def test_no_heights_without_slices_left(first_cloud):
    done = len(first_cloud.slice_height)
    assert len(next_heights(first_cloud, PLAN, left=0)) == 0
    assert len(next_heights(first_cloud, PLAN, left=-1)) == 0
    assert len(next_heights(first_cloud, Plan(slices=done - BEYOND, spacing="adaptive"))) == 0
    assert len(next_heights(first_cloud, Plan(slices=done - BEYOND + 1, spacing="adaptive"))) == 1
    assert len(next_heights(first_cloud, PLAN, left=1)) == 1


def test_no_heights_within_a_tolerance_as_large_as_the_body(first_cloud):
    assert len(next_heights(first_cloud, Plan(slices=64, spacing="adaptive", tolerance=1.0))) == 0


@pytest.fixture(scope="module")
def three_axes(gem):
    return contacts(scan3d.simulate(gem, Plan(slices=4, axis="xyz", sweeps=4, samples=12)))


def test_of_several_axes_one_must_be_given(three_axes):
    message = (
        "next heights are chosen along one axis, and the cloud has contacts in slices along "
        "(0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0); give one of them as axis, got None"
    )
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        next_heights(three_axes, PLAN)


def test_an_axis_without_slices_is_refused(three_axes, first_cloud):
    with pytest.raises(InputError, match=r"give one of them as axis, got \(1\.0, 1\.0, 0\.0\)$"):
        next_heights(three_axes, PLAN, axis=np.array([1.0, 1.0, 0.0]))
    with pytest.raises(InputError, match=r"slices along \(0\.0, 0\.0, 1\.0\); give .* got \(1\.0, 0\.0, 0\.0\)$"):
        next_heights(first_cloud, PLAN, axis=np.array([1.0, 0.0, 0.0]))


def test_the_axis_that_is_given_is_the_one_that_is_sliced(three_axes, gem):
    for axis in np.eye(3):
        heights = next_heights(three_axes, PLAN, axis=3.0 * axis, left=3)  # of any length
        low, high = extent_along(gem, axis)
        known = three_axes.slice_height[three_axes.slice_axis @ axis > 0.5]
        assert 1 <= len(heights) <= 3
        # the lowest and the highest of the known slices are empty
        assert np.all((heights > known.min()) & (heights < known.max()))
        assert np.all((heights > low) & (heights < high))
