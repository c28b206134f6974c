"""The outer body between slices along one axis, slab by slab."""

import numpy as np
import pytest
import trimesh
from slices_by_hand import slice_of, square, stack_of_squares

import scan3d
from scan3d.bounds import enclosure
from scan3d.bounds.slabs import _left, slabs
from scan3d.geometry.hulls import hull
from scan3d.geometry.sections import slice_frame
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.slices import SliceStack, stacks
from scan3d.surfaces import Gap


def test_a_thin_cell_that_no_tried_point_lies_in_has_its_corners():
    low, high = np.array([5.0, 3.0, -1.0]), np.array([6.0, 4.0, -0.99])
    planes = np.hstack([np.vstack([np.eye(3), -np.eye(3)]), np.concatenate([-high, low])[:, None]])
    corners, _ = _left(planes, np.zeros(3), np.eye(3), np.zeros((1, 3)))
    assert hull(corners).bounds == pytest.approx(np.stack([low, high]))


@pytest.mark.slow
@pytest.mark.parametrize("frame", [np.eye(3), slice_frame(np.array([1.0, 2.0, 0.5]))])
def test_a_box_is_found_nearly_exactly(frame):
    """By the tangents of slices along all three axes, whether the box lies along them or not."""
    mesh = trimesh.creation.box((20, 14, 9))
    mesh.apply_transform(np.block([[frame, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]]))
    cloud = contacts(scan3d.simulate(mesh, scan3d.Plan(slices=12, axis="xyz", samples=24)))
    bounds = enclosure(cloud)
    assert bounds.bound < 1e-4 * np.linalg.norm(mesh.extents)


def volume_of_frustum(low, high):
    return ((2 * (4 - low)) ** 3 - (2 * (4 - high)) ** 3) / 6


def test_the_slabs_of_a_pyramid():
    """Its apex is at the height 4."""
    parts = slabs(stack_of_squares(np.arange(4.0), [4, 3, 2, 1], -1.0, 3.5))
    limits = [(-1.0, 0.0), (0.0, 1.0), (1.0, 2.0), (2.0, 3.0), (3.0, 3.5)]
    # in the plane of a slice whose half-spaces bound the slab the corners lie between contacts
    kinds = [
        (Gap.CAPS, Gap.CONTACTS),
        (Gap.SLICES, Gap.CONTACTS),
        (Gap.CONTACTS, Gap.CONTACTS),
        (Gap.CONTACTS, Gap.SLICES),
        (Gap.CONTACTS, Gap.CAPS),
    ]
    for part, (low, high), (kind_below, kind_above) in zip(parts, limits, kinds, strict=True):
        height = part.corners[:, 2]
        assert np.abs(part.corners[:, :2]) == pytest.approx(np.stack([4 - height, 4 - height], axis=1))
        above = height > (low + high) / 2
        assert height == pytest.approx(np.where(above, high, low))
        assert (above.sum(), (~above).sum()) == (4, 4)
        assert (part.kind == np.where(above, kind_above, kind_below)).all()
        assert part.volume == pytest.approx(volume_of_frustum(low, high))


@pytest.mark.parametrize(
    ("half_lengths", "straight"), [([7, 6, 5, 4, 3, 2, 1], True), ([4, 4.9, 5.3, 5.4, 5.3, 4.9, 4], False)]
)
def test_walls_go_on_straight_where_three_slices_agree(half_lengths, straight):
    parts = slabs(stack_of_squares(np.arange(7.0), half_lengths, -1.0, 7.5))
    assert (parts[3].straight.any(axis=1) == straight).all()
    # a corner in the plane of an end slice means only that the body may end there
    assert not parts[1].straight[parts[1].corners[:, 2] < 0.1].any()


@pytest.mark.parametrize("edges", [[0, 1, 2], [1, 2, 3], [0, 2], [1, 3]])
def test_slabs_are_unbounded_where_no_contact_shows_a_side(edges):
    """Squares of which one side, or two, are not touched: the half-spaces have room inside, and do not close."""
    slices = tuple(slice_of(square(2.0), z, edges=edges) for z in range(4))
    parts = slabs(SliceStack(np.eye(3), slices, -1.0, 4.0))
    kinds = [Gap.CAPS, Gap.SLICES, Gap.SLICES, Gap.SLICES, Gap.CAPS]
    for part, kind in zip(parts, kinds, strict=True):
        assert np.isinf(part.corners).all()
        assert part.corners.shape == (1, 3)
        assert part.kind.tolist() == [kind]
        assert not part.straight.any()
        assert part.volume == np.inf


def test_a_slice_with_one_contact_bounds_nothing_above_it():
    cloud = scan3d.reconstruct(scan3d.simulate(trimesh.creation.box((20, 16, 12)), scan3d.Plan(slices=4, samples=8)))
    top = cloud.slice == cloud.slice_height.argsort()[-2]
    few = cloud.select(~top | (np.arange(len(cloud)) == np.flatnonzero(top)[0]))
    (stack,) = stacks(few)
    assert len(stack.slices[-1].points) == 1
    assert not np.isfinite(slabs(stack)[-1].corners).all()
