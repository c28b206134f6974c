"""The outer body, slab by slab, of slices whose half-spaces are known, and of slices whose heights are not quite."""

import dataclasses

import numpy as np
import pytest
import trimesh
from slices_by_hand import rectangle, slice_of, stack_of_rectangles

import scan3d
from scan3d.bounds.cells import slabs
from scan3d.geometry.distance import signed_distances
from scan3d.geometry.hulls import hull
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.slices import SliceStack, stacks
from scan3d.surfaces import Gap


@pytest.fixture(scope="module")
def ball():
    """A ball and its recording."""
    mesh = trimesh.creation.icosphere(3, 20.0)
    return mesh, scan3d.simulate(mesh, scan3d.Plan(slices=20, samples=16, sweeps=6))


@pytest.mark.slow
@pytest.mark.parametrize("error", [0.01, 0.03, 0.1])
def test_slices_moved_by_less_than_the_error_of_heights_leave_the_body_inside(error, ball):
    """Secants of slices that lie close together turn by much where their heights are off; a margin does not allow for that."""
    mesh, recording = ball
    (stack,) = stacks(contacts(recording))
    rng = np.random.default_rng(0)
    for _ in range(2):
        off = error * rng.uniform(-1, 1, len(stack.slices))
        moved = tuple(
            dataclasses.replace(slice_, height=slice_.height + e) for slice_, e in zip(stack.slices, off, strict=True)
        )
        uncertain = dataclasses.replace(stack, slices=moved, height_error=error)
        missing = []
        for candidate in (uncertain, dataclasses.replace(uncertain, height_error=0.0)):
            outer = [hull(slab.corners) for slab in slabs(candidate)]
            nearest = np.min([signed_distances(mesh.vertices, part) for part in outer], axis=0)
            missing.append(float(nearest.max()))
        assert missing[0] < 1e-9 < missing[1]


def test_volumes_of_slabs_are_those_of_the_hulls_of_their_corners(ball):
    (stack,) = stacks(contacts(ball[1]))
    parts = slabs(stack)
    assert [part.volume for part in parts] == pytest.approx([hull(part.corners).volume for part in parts], rel=1e-9)


def test_sides_of_a_slice_that_were_touched_at_different_heights_leave_the_body_inside():
    """Above the middle the body narrows in x, below it in y, and its sides are touched above and below the middle there."""
    steep, error = 1.0, 0.2

    def halves(z, off):
        return np.array([10 - steep * max(z + off, 0.0), 10 + steep * min(z - off, 0.0)])

    heights = [-6.0, -3.0, 0.0, 3.0, 6.0]
    stack = stack_of_rectangles(heights, [halves(z, error) for z in heights], floor=-8.0, ceiling=8.0)
    outer = [hull(slab.corners) for slab in slabs(dataclasses.replace(stack, height_error=error))]
    z = np.linspace(-8, 8, 321)
    body = np.array([[*(sign * halves(height, 0.0)), height] for height in z for sign in ([1, 1], [1, -1], [-1, 1])])
    missing = np.min([signed_distances(body, part) for part in outer], axis=0)
    assert missing.max() < 1e-9


def pyramid(floor, ceiling, bounded_by_others=(False, False)):
    """Squares of half lengths 4, 3, 2, 1 at heights 0, 1, 2, 3: a pyramid with its apex at the height 4."""
    return stack_of_rectangles([0.0, 1.0, 2.0, 3.0], [4.0, 3.0, 2.0, 1.0], floor, ceiling, bounded_by_others)


def volume_of_frustum(low, high):
    return ((2 * (4 - low)) ** 3 - (2 * (4 - high)) ** 3) / 6


def test_the_slabs_of_a_pyramid():
    parts = slabs(pyramid(-1.0, 3.5))
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
    parts = slabs(stack_of_rectangles(np.arange(7.0), np.array(half_lengths, dtype=float), -1.0, 7.5))
    assert (parts[3].straight.any(axis=1) == straight).all()
    # a corner in the plane of an end slice means only that the body may end there
    assert not parts[1].straight[parts[1].corners[:, 2] < 0.1].any()


@pytest.mark.parametrize("edges", [[0, 1, 2], [1, 2, 3], [0, 2], [1, 3]])
def test_slabs_are_unbounded_where_no_contact_shows_a_side(edges):
    """Squares of which one side, or two, are not touched: the half-spaces have room inside, and do not close."""
    slices = tuple(slice_of(rectangle(2.0), z, edges=edges) for z in range(4))
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
