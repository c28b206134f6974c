"""What the corners of the outer body are called, and what they say about a surface, on a box, where all of it is known."""

import numpy as np
import pytest
import trimesh

import scan3d
from scan3d.bracket import Gap, bracket, certificate, outside
from scan3d.cloud import contacts

HALF = np.array([10.0, 15.0, 20.0])
BOX = trimesh.creation.box(2 * HALF)


@pytest.fixture(scope="module")
def box_cloud():
    return contacts(scan3d.simulate(BOX, scan3d.Plan(slices=8, spacing="uniform")))


@pytest.fixture(scope="module")
def levels(box_cloud):
    return np.unique(box_cloud.slice_height[np.unique(box_cloud.slice)])


@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_corners_are_of_caps_between_slices_or_in_a_slice(box_cloud, levels, margin):
    found = bracket(box_cloud, margin)
    z = found.corners[:, 2]
    in_slice = np.abs(z[:, None] - levels[1:-1]).min(axis=1) < 1e-9
    beyond = (z > levels[-1] + 1e-9) | (z < levels[0] - 1e-9)
    between = (z > levels[0] + 1e-9) & (z < levels[-1] - 1e-9) & ~in_slice
    assert in_slice.any()
    assert (found.kind[in_slice] == Gap.CONTACTS).all()
    assert (found.kind[beyond] == Gap.CAPS).all()
    assert (found.kind[between] == Gap.SLICES).all()
    assert between.any() == (margin > 0)


def test_corners_know_their_slab(box_cloud, levels):
    found = bracket(box_cloud, 0.1)
    below = np.array([found.stack.floor, *levels])[found.slab]
    above = np.array([*levels, found.stack.ceiling])[found.slab]
    assert (found.corners[:, 2] >= below - 1e-9).all()
    assert (found.corners[:, 2] <= above + 1e-9).all()
    assert set(found.slab) == set(range(len(levels) + 1))


def test_upright_walls_go_on_straight_where_three_slices_say_so(box_cloud, levels):
    found = bracket(box_cloud, 0.3)
    # halfway between two slices half-spaces from both meet
    inner = (found.kind == Gap.SLICES) & (found.slab > 1) & (found.slab < len(levels) - 1)
    assert inner.any()
    assert (found.flat[inner, 0] == (found.slab[inner] >= 3)).all()
    assert (found.flat[inner, 1] == (found.slab[inner] <= len(levels) - 3)).all()


def test_other_axes_bound_the_ends_of_a_box_exactly():
    """The walls seen across one axis are the ends along another."""
    found = bracket(contacts(scan3d.simulate(BOX, scan3d.Plan(slices=6, axis="xyz", samples=32))))
    end = HALF @ np.abs(found.stack.frame[2])
    assert (found.stack.floor, found.stack.ceiling) == pytest.approx((-end, end))
    assert found.stack.firm == (True, True)
    assert np.abs(found.corners).max(axis=0) == pytest.approx(HALF)
    assert found.volume[1] == pytest.approx(BOX.volume)


@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_the_certificate_of_the_inner_body_is_its_bound(box_cloud, margin):
    found = bracket(box_cloud, margin)
    bound, local = certificate(found, found.inner)
    assert found.bound == pytest.approx(outside(found.corners, found.inner).max() + margin)
    assert bound == pytest.approx(found.bound)
    # next to the farthest corner it is as large, at the walls between the slices only as large as there
    assert local.max() == pytest.approx(bound)
    assert local.min() >= margin
    farthest = found.corners[found.gap.argmax()]
    near = np.linalg.norm(found.inner.vertices - farthest, axis=1) < 1.5 * bound
    assert local[near] == pytest.approx(np.full(near.sum(), bound), rel=0.2)


@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_the_certificate_of_a_larger_body_counts_what_stands_out(box_cloud, margin):
    """A hull twice as large: its vertices stand out of the inner body, and all of the outer body is inside of it."""
    found = bracket(box_cloud, margin)
    larger = found.inner.copy()
    larger.vertices = 2 * np.asarray(found.inner.vertices)
    larger.metadata["convex"] = True
    bound, local = certificate(found, larger)
    expected = outside(np.asarray(larger.vertices), found.inner) + margin
    assert local == pytest.approx(expected)
    assert bound == pytest.approx(expected.max())
