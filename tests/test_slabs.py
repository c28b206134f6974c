"""The outer body, slab by slab: where it is bounded, where it is not, and how a margin for noise widens it."""

import dataclasses

import numpy as np
import trimesh

import scan3d
from scan3d.reconstruction.contacts import contacts
from scan3d.surfaces import enclosure


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
