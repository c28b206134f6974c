"""The outer body, slab by slab: where it is bounded, where it is not, and how a margin for noise widens it."""

import dataclasses

import numpy as np
import pytest
import trimesh
from sample_bodies import convex_hausdorff

import scan3d
from scan3d.geometry.distance import signed_distances
from scan3d.geometry.hulls import hull
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.slices import stacks
from scan3d.surfaces import enclosure
from scan3d.surfaces.slabs import _half_spaces


def test_nothing_bounds_a_body_past_its_end_slices_unless_an_empty_slice_does():
    mesh = trimesh.creation.box((20, 30, 40))
    cloud = contacts(scan3d.simulate(mesh, scan3d.Plan(slices=6)))
    filled = np.unique(cloud.slice)
    assert len(cloud.slice_height) == len(filled) + 2
    assert np.isfinite(enclosure(cloud).bound)
    rank = np.searchsorted(filled, cloud.slice).astype(np.int32)
    without_empty_slices = dataclasses.replace(
        cloud, slice=rank, slice_axis=cloud.slice_axis[filled], slice_height=cloud.slice_height[filled]
    )
    assert np.isinf(enclosure(without_empty_slices).bound)


def test_a_margin_for_noise_widens_the_enclosure():
    cloud = contacts(scan3d.simulate(trimesh.creation.box((20, 30, 40)), scan3d.Plan(slices=8, samples=32)))
    assert enclosure(cloud, margin=0.1).bound >= enclosure(cloud).bound + 0.1


def test_contours_that_are_touched_from_one_side_only_are_not_bounded():
    """Half-spaces that do not close have corners at infinity, which must not get lost."""
    mesh = trimesh.creation.icosphere(3, 20.0)
    assert np.isinf(enclosure(contacts(scan3d.simulate(mesh, scan3d.Plan(slices=8, sweeps=1)))).bound)
    assert np.isfinite(enclosure(contacts(scan3d.simulate(mesh, scan3d.Plan(slices=8, sweeps=4)))).bound)


@pytest.mark.parametrize("margin", [0.05, 0.5])
def test_contacts_moved_by_less_than_the_margin_leave_the_body_inside(margin):
    """Every half-space is moved outwards by the margin, at its slice and at the one behind it: against exact vertices."""
    mesh = trimesh.creation.icosphere(3, 20.0)
    cloud = contacts(scan3d.simulate(mesh, scan3d.Plan(slices=8, samples=16, sweeps=6)))
    (stack,) = stacks(cloud)
    rng = np.random.default_rng(0)
    for i in range(2, len(stack.slices)):
        below, behind = stack.slices[i - 1], stack.slices[i - 2]
        exact = _half_spaces(below, behind, 0.0)
        widened = _half_spaces(below, behind, margin)
        # the support function is larger by the margin at this slice, and may be smaller by it at the one behind
        for z, change in ((below.height, margin), (behind.height, -margin)):
            supports = [-(planes[:, 2] * z + planes[:, 3]) for planes in (exact, widened)]
            np.testing.assert_allclose(supports[1] - supports[0], change, rtol=1e-9, atol=1e-9)
    # contacts that are too far inside by the margin, as noise may put them
    inwards = -margin * cloud.points / np.linalg.norm(cloud.points, axis=1, keepdims=True)
    inwards[:, 2] = 0.0
    noisy = dataclasses.replace(cloud, points=cloud.points + rng.uniform(size=(len(cloud), 1)) * inwards)
    bounds = enclosure(noisy, margin)
    slab_height = np.searchsorted(bounds.stack.heights, mesh.vertices[:, 2])
    for i in np.unique(slab_height):
        outer = hull(bounds.corners[bounds.slab == i])
        assert signed_distances(mesh.vertices[slab_height == i], outer).max() < 1e-9
    assert bounds.bound >= convex_hausdorff(bounds.inner, mesh)
