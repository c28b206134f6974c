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
from scan3d.surfaces import Gap, enclosure
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


# --- an upright box, whose slices all have the same support function: its outer body is known at every height ---

# Half the lengths of its edges.
HALF = np.array([10.0, 15.0, 20.0])


@pytest.fixture(scope="module")
def box_cloud():
    return contacts(scan3d.simulate(trimesh.creation.box(2 * HALF), scan3d.Plan(slices=8, spacing="uniform")))


def grown(z, levels, margin):
    """How far the outer body of an upright box extends beyond the box at the heights z, for contacts accurate to `margin`.

    The half-spaces are inclined along the secant from the slice behind, whose support function may be smaller by the margin, to
    this slice, whose support function may be larger by the margin: by 2 margin / spacing.  They are those of the slice below,
    from the second slice on, and those of the slice above, down to the last slice but one.
    """
    growth = np.full(len(z), np.inf)
    for i, level in enumerate(levels):
        for behind in (i - 1, i + 1):
            if 0 <= behind < len(levels):
                spacing = level - levels[behind]
                beyond = (z - level) * np.sign(spacing) >= -1e-9
                # half-spaces bound only the slab next to their slice
                next_to = levels[2 * i - behind] if 0 <= 2 * i - behind < len(levels) else np.sign(spacing) * np.inf
                beyond &= (z - next_to) * np.sign(spacing) <= 1e-9
                inclined = margin + 2 * margin * (z - level) / spacing
                growth = np.where(beyond, np.minimum(growth, inclined), growth)
    return growth


def check_growth(corners, growth):
    """Corners (w, 3) of the outer body are as far from the box as its growth says, except for the angle between normals."""
    beyond = np.maximum(np.abs(corners[:, :2]) - HALF[:2], 0)
    assert (beyond <= growth[:, None] + 1e-9).all()
    distance = np.linalg.norm(beyond, axis=1)
    assert (distance >= growth - 1e-9).all()
    assert (distance <= 1.05 * growth + 1e-9).all()


@pytest.mark.parametrize("margin", [0.0, 0.01, 0.3])
def test_a_margin_moves_and_inclines_the_half_spaces(box_cloud, margin):
    bounds = enclosure(box_cloud, margin)
    levels = np.unique(box_cloud.slice_height[np.unique(box_cloud.slice)])
    corners = bounds.corners[(bounds.corners[:, 2] > levels[0]) & (bounds.corners[:, 2] < levels[-1])]
    assert len(corners) >= 4 * (len(levels) - 2)
    check_growth(corners, grown(corners[:, 2], levels, margin))
    if margin:
        # halfway between two slices both half-spaces have moved outwards by the margin once more
        middle = (levels[2] + levels[3]) / 2
        assert np.abs(corners[:, 2] - middle).min() < 1e-9
        assert grown(np.array([middle]), levels, margin) == pytest.approx(2 * margin)


@pytest.mark.parametrize("margin", [0.0, 0.01, 0.3])
def test_a_margin_inclines_the_caps_up_to_the_next_empty_slice(box_cloud, margin):
    levels = np.unique(box_cloud.slice_height[np.unique(box_cloud.slice)])
    floor, ceiling = box_cloud.slice_height.min(), box_cloud.slice_height.max()
    bounds = enclosure(box_cloud, margin)
    for end, last, before in ((ceiling, levels[-1], levels[-2]), (floor, levels[0], levels[1])):
        corners = bounds.corners[np.abs(bounds.corners[:, 2] - end) < 1e-9]
        reach = margin + 2 * margin * (end - last) / (last - before)
        check_growth(corners, np.full(len(corners), reach))


@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_the_upper_bound_of_the_volume_is_the_volume_of_the_outer_body(box_cloud, margin):
    """Integrated over the height: at each height the outer body is a rectangle with everything within the growth of it."""
    levels = np.unique(box_cloud.slice_height[np.unique(box_cloud.slice)])
    z = np.linspace(box_cloud.slice_height.min(), box_cloud.slice_height.max(), 200_001)
    middles = (z[1:] + z[:-1]) / 2
    growth = grown(middles, levels, margin)
    area = 4 * HALF[:2].prod() + 4 * HALF[:2].sum() * growth + np.pi * growth**2
    bounds = enclosure(box_cloud, margin)
    assert bounds.volume[1] == pytest.approx((area * np.diff(z)).sum(), rel=1e-5)
    assert bounds.volume[0] == pytest.approx(bounds.inner.volume)
    assert bounds.margin == margin


@pytest.fixture(scope="module")
def levels(box_cloud):
    return np.unique(box_cloud.slice_height[np.unique(box_cloud.slice)])


@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_the_kind_of_a_corner_is_that_of_its_place(box_cloud, levels, margin):
    bounds = enclosure(box_cloud, margin)
    z = bounds.corners[:, 2]
    in_slice = np.abs(z[:, None] - levels[1:-1]).min(axis=1) < 1e-9
    beyond = (z > levels[-1] + 1e-9) | (z < levels[0] - 1e-9)
    between = (z > levels[0] + 1e-9) & (z < levels[-1] - 1e-9) & ~in_slice
    assert in_slice.any()
    assert (bounds.kind[in_slice] == Gap.CONTACTS).all()
    assert (bounds.kind[beyond] == Gap.CAPS).all()
    assert (bounds.kind[between] == Gap.SLICES).all()
    assert between.any() == (margin > 0)


def test_corners_lie_in_their_slab(box_cloud, levels):
    bounds = enclosure(box_cloud, 0.1)
    below = np.array([bounds.stack.floor, *levels])[bounds.slab]
    above = np.array([*levels, bounds.stack.ceiling])[bounds.slab]
    assert (bounds.corners[:, 2] >= below - 1e-9).all()
    assert (bounds.corners[:, 2] <= above + 1e-9).all()
    assert set(bounds.slab) == set(range(len(levels) + 1))


def test_upright_walls_go_on_straight_where_three_slices_agree(box_cloud, levels):
    bounds = enclosure(box_cloud, 0.3)
    # halfway between two slices half-spaces from both meet
    inner = (bounds.kind == Gap.SLICES) & (bounds.slab > 1) & (bounds.slab < len(levels) - 1)
    assert inner.any()
    assert (bounds.straight[inner, 0] == (bounds.slab[inner] >= 3)).all()
    assert (bounds.straight[inner, 1] == (bounds.slab[inner] <= len(levels) - 3)).all()
