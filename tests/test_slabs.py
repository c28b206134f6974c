"""The outer body, slab by slab: where it is bounded, where it is not, and how a margin for noise widens it."""

import dataclasses

import numpy as np
import pytest
import trimesh
from sample_bodies import convex_hausdorff
from slices_by_hand import rectangle, slice_of, stack_of_rectangles

import scan3d
from scan3d.bounds.slabs import _corners_are_straight, _goes_on_straight, _half_spaces, slab_keys, slabs
from scan3d.geometry.distance import signed_distances
from scan3d.geometry.hulls import hull
from scan3d.geometry.sections import slice_frame
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.slices import SliceStack, stacks
from scan3d.surfaces import Gap, enclosure


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
        exact = _half_spaces(below, (behind,), 0.0)
        widened = _half_spaces(below, (behind,), margin)
        # the support function is larger by the margin at this slice, and may be smaller by it at the one behind
        for z, change in ((below.height, margin), (behind.height, -margin)):
            supports = [-(planes[:, 2] * z + planes[:, 3]) for planes in (exact, widened)]
            np.testing.assert_allclose(supports[1] - supports[0], change, rtol=1e-9, atol=1e-9)
    # contacts that are too far inside by the margin, as noise may put them
    inwards = -margin * cloud.points / np.linalg.norm(cloud.points, axis=1, keepdims=True)
    inwards[:, 2] = 0.0
    noisy = dataclasses.replace(cloud, points=cloud.points + rng.uniform(size=(len(cloud), 1)) * inwards)
    bounds = enclosure(noisy, margin)
    slab_height = np.searchsorted(bounds.slabs.stack.heights, mesh.vertices[:, 2])
    for i in np.unique(slab_height):
        outer = hull(bounds.corners[bounds.slabs.number == i])
        assert signed_distances(mesh.vertices[slab_height == i], outer).max() < 1e-9
    assert bounds.bound >= convex_hausdorff(bounds.inner, mesh)


@pytest.mark.parametrize("error", [0.01, 0.03, 0.1])
def test_slices_moved_by_less_than_the_error_of_heights_leave_the_body_inside(error):
    """Secants of slices that lie close together turn by much where their heights are off; a margin does not allow for that."""
    mesh = trimesh.creation.icosphere(3, 20.0)
    cloud = contacts(scan3d.simulate(mesh, scan3d.Plan(slices=20, samples=16, sweeps=6)))
    (stack,) = stacks(cloud)
    rng = np.random.default_rng(0)
    for _ in range(5):
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


def test_a_slice_near_another_does_not_make_the_outer_body_larger():
    """The secant between slices that lie hardly more than twice the error of their heights apart is nearly infinite."""
    halves = {z: np.sqrt(20**2 - z**2) for z in (-16.0, -8.0, 0.0, 8.0, 16.0, 16.41)}
    volumes = []
    for heights in (list(halves)[:-1], list(halves)):
        stack = stack_of_rectangles(heights, [halves[z] for z in heights], floor=-20.0, ceiling=20.0)
        volumes.append(sum(slab.volume for slab in slabs(dataclasses.replace(stack, height_error=0.2))))
    assert volumes[1] < 1.01 * volumes[0]


@pytest.mark.parametrize("seed", [2, 3, 40])
def test_the_bound_allows_for_the_digits_of_heights(seed):
    """Of 60 thin bodies, scanned with poses in steps of 5 µm, the bound or the volume of 46 was false."""
    mesh = hull(np.random.default_rng(seed).standard_normal((12, 3)) * [10, 10, 0.3])
    recording = scan3d.simulate(mesh, scan3d.Plan(slices=14, samples=16, sweeps=6))
    cloud = scan3d.reconstruct(dataclasses.replace(recording, position_m=np.round(recording.position_m / 5e-6) * 5e-6))
    bounds = enclosure(cloud)
    assert bounds.slabs.stack.height_error == cloud.pose_error > 4e-3
    assert convex_hausdorff(bounds.inner, mesh) <= bounds.bound < 4
    assert bounds.volume[0] <= mesh.volume <= bounds.volume[1]


@pytest.mark.parametrize("seed", [5, 23])
def test_the_bound_of_sharp_sections_allows_for_the_digits_of_poses(seed):
    """Sides that are moved move a sharp corner between them by much more than a margin in the corner's direction."""
    mesh = hull(np.random.default_rng(seed).standard_normal((12, 3)) * [10, 0.3, 10])
    plan = scan3d.Plan(slices=10, samples=24, sweeps=6, spacing="uniform", noise=1e-6)
    recording = scan3d.simulate(mesh, plan)
    cloud = scan3d.reconstruct(dataclasses.replace(recording, position_m=np.round(recording.position_m / 3e-6) * 3e-6))
    bounds = enclosure(cloud)
    assert convex_hausdorff(bounds.inner, mesh) <= bounds.bound < 6


def test_heights_that_differ_within_a_slice_are_uncertain_by_their_spread():
    mesh = trimesh.creation.icosphere(3, 20.0)
    recording = scan3d.simulate(mesh, scan3d.Plan(slices=12, samples=16, sweeps=6))
    assert enclosure(scan3d.reconstruct(recording)).stack.height_error == 0
    off = 1e-5 * np.random.default_rng(0).uniform(-1, 1, len(recording))
    measured = dataclasses.replace(recording, position_m=recording.position_m + off[:, None] * [0.0, 0.0, 1.0])
    bounds = enclosure(scan3d.reconstruct(measured))
    assert 5e-3 < bounds.slabs.stack.height_error < 2e-2
    assert convex_hausdorff(bounds.inner, mesh) <= bounds.bound


def test_slices_a_few_spreads_apart_stay_separate():
    """Sweeps of three planned slices that are 0.35 mm apart became one with poses that jitter by 20 µm."""
    mesh = trimesh.creation.icosphere(3, 20.0)
    recording = scan3d.simulate(mesh, scan3d.Plan(slices=100, samples=200, sweeps=4, spacing="uniform"))
    heights = np.unique(np.round(recording.position_m[:, 2], 9))
    assert 0.00035 < np.diff(heights).min() < 0.00045
    off = 2e-5 * np.random.default_rng(0).standard_normal(recording.position_m.shape)
    measured = scan3d.reconstruct(dataclasses.replace(recording, position_m=recording.position_m + off))
    assert len(measured.slice_height) == len(heights)


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
    assert (bounds.slabs.kind[in_slice] == Gap.CONTACTS).all()
    assert (bounds.slabs.kind[beyond] == Gap.CAPS).all()
    assert (bounds.slabs.kind[between] == Gap.SLICES).all()
    assert between.any() == (margin > 0)


def test_corners_lie_in_their_slab(box_cloud, levels):
    bounds = enclosure(box_cloud, 0.1)
    below = np.array([bounds.slabs.stack.floor, *levels])[bounds.slabs.number]
    above = np.array([*levels, bounds.slabs.stack.ceiling])[bounds.slabs.number]
    assert (bounds.corners[:, 2] >= below - 1e-9).all()
    assert (bounds.corners[:, 2] <= above + 1e-9).all()
    assert set(bounds.slabs.number) == set(range(len(levels) + 1))


def test_upright_walls_go_on_straight_where_three_slices_agree(box_cloud, levels):
    bounds = enclosure(box_cloud, 0.3)
    # halfway between two slices half-spaces from both meet
    inner = (bounds.slabs.kind == Gap.SLICES) & (bounds.slabs.number > 1) & (bounds.slabs.number < len(levels) - 1)
    assert inner.any()
    assert (bounds.slabs.straight[inner, 0] == (bounds.slabs.number[inner] >= 3)).all()
    assert (bounds.slabs.straight[inner, 1] == (bounds.slabs.number[inner] <= len(levels) - 3)).all()


# --- where the body goes on straight ---


@pytest.mark.parametrize(
    ("side", "straight", "one_sided", "expected"),
    [
        ([0, 0, 1], [True, True, True], False, (True, True)),
        ([0, 0, 1], [True, False, True], False, (False, True)),
        ([0, 0, 1], [True, True, False], False, (True, False)),
        # no half-space from that side
        ([0, 0, 0], [True, True, True], False, (True, False)),
        ([1, 1, 1], [True, True, True], False, (False, True)),
        # the slab's own planes, of side -1, do not count between two slices
        ([0, 1, -1], [True, True, False], False, (True, True)),
        # but they do in a cap, which has slices on one side only
        ([0, 0, -1], [True, True, True], True, (True, True)),
        ([0, 0, -1], [True, True, False], True, (False, False)),
        ([0, 0, -1], [True, False, True], True, (False, False)),
        ([1, 1, -1], [True, True, True], True, (True, True)),
    ],
)
def test_a_corner_is_straight_if_all_its_half_spaces_are(side, straight, one_sided, expected):
    facets, before = [[0, 1], list(range(2, 2 + len(side)))], [0.0, 1.0]
    found = _corners_are_straight(facets, np.array(before + side, float), np.array([True, False, *straight]), one_sided)
    assert tuple(found[1]) == expected
    assert tuple(found[0]) == ((False, False) if one_sided else (True, False))


def slices_of_squares(heights, halves):
    return stack_of_rectangles(heights, halves).slices


def test_equal_slopes_go_on_straight():
    """Squares whose half lengths are 9, 8, 7 at the heights 0, 1, 2, seen from above and from below."""
    upward = slices_of_squares([2.0, 1.0, 0.0], [7.0, 8.0, 9.0])
    assert _goes_on_straight(upward, None).tolist() == [True] * 4
    assert _goes_on_straight(slices_of_squares([0.0, 1.0, 2.0], [9.0, 8.0, 7.0]), None).all()
    # heights that are not evenly spaced
    assert _goes_on_straight(slices_of_squares([5.0, 4.0, 0.0], [4.0, 5.0, 9.0]), None).all()
    assert not _goes_on_straight(slices_of_squares([5.0, 4.0, 0.0], [4.0, 5.0, 6.0]), None).any()
    # two slices are not enough
    assert _goes_on_straight(upward[:2], None).tolist() == [False] * 4
    # only the first three count
    assert _goes_on_straight((*upward, *slices_of_squares([-1.0], [3.0])), None).all()


@pytest.mark.parametrize("change", [1e-9, 0.1])
def test_in_a_cap_slopes_may_differ_by_rounding_only(change):
    assert not _goes_on_straight(slices_of_squares([2.0, 1.0, 0.0], [7.0, 8.0, 9.0 - change]), None).any()
    assert _goes_on_straight(slices_of_squares([2.0, 1.0, 0.0], [7.0, 8.0, 9.0 - 1e-14]), None).all()


@pytest.mark.parametrize(
    ("beyond", "straight"), [(3.0, True), (5.9, False), (5.5, False), (5.0, True), (-4.0, True), (6.0, False)]
)
def test_slopes_are_equal_relative_to_the_slope_across_the_slab(beyond, straight):
    """The slopes behind the slab are -1 and -0.98; across it, to a slice 1 above, the slope is `beyond` - 7."""
    behind = slices_of_squares([2.0, 1.0, 0.0], [7.0, 8.0, 8.98])
    (above,) = slices_of_squares([3.0], [abs(beyond)])
    # 0.02 <= 0.03 |-1 - (beyond - 7)|
    expected = 0.03 * abs(6 - abs(beyond)) >= 0.02
    assert expected == straight
    assert _goes_on_straight(behind, above).tolist() == [straight] * 4


def test_only_the_sides_that_go_on_straight_do():
    """Rectangles whose x sides stay upright while the y sides narrow by unequal amounts."""
    stack = stack_of_rectangles([2.0, 1.0, 0.0], [(5.0, 6.0), (5.0, 8.0), (5.0, 9.0)])
    straight = _goes_on_straight(stack.slices, None)
    upright = np.abs(np.sin(stack.slices[0].angle)) < 0.5
    assert (straight == upright).all()


# --- slabs of squares, whose half-spaces are known ---


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


@pytest.mark.parametrize("thickness", [1.5, 3.0, 15.0, 150.0, 2e4, 1e7])
def test_a_cap_that_reaches_the_apex_ends_there(thickness):
    """However much farther away the next empty slice is."""
    (*_, cap) = slabs(pyramid(-1.0, 3 + thickness))
    assert cap.corners[:, 2].max() == pytest.approx(4.0, abs=1e-15 * thickness + 1e-9)
    assert cap.volume == pytest.approx(volume_of_frustum(3.0, 4.0), rel=1e-6)
    assert (cap.kind[cap.corners[:, 2] > 3.5] == Gap.CAPS).all()
    # all its half-spaces are straight, whether or not the cap's plane is bounded by others
    assert cap.straight[cap.corners[:, 2] > 3.5].all()


@pytest.mark.parametrize("bounded_by_others", [(False, False), (True, False), (False, True), (True, True)])
def test_corners_at_an_end_are_straight_only_if_other_stacks_bound_it(bounded_by_others):
    parts = slabs(pyramid(-1.0, 3.5, bounded_by_others))
    for part, end, expected in ((parts[0], -1.0, bounded_by_others[0]), (parts[-1], 3.5, bounded_by_others[1])):
        at_end = np.abs(part.corners[:, 2] - end) < 1e-9
        assert at_end.sum() == 4
        assert (part.straight[at_end] == expected).all()
        # the corners in the plane of the end slice are not, because the slice's own contour bounds the body there
        assert not part.straight[~at_end].any()


def test_straight_walls_end_where_slopes_change():
    """A wall of four slices under a pyramid of four: between the two, the slopes differ on either side."""
    stack = stack_of_rectangles(range(8), [4.0, 4.0, 4.0, 4.0, 3.5, 2.5, 1.5, 0.5], -1.0, 8.0)
    parts = slabs(stack)
    between = parts[4]
    # wall and roof meet at the height 3.5, half an edge above the last slice of the wall
    ridge = np.abs(between.corners[:, 2] - 3.5) < 1e-6
    assert ridge.sum() == 4
    assert np.abs(between.corners[ridge, :2]) == pytest.approx(np.full((4, 2), 4.0))
    assert (between.kind[ridge] == Gap.SLICES).all()
    assert between.straight[ridge].all()


@pytest.mark.parametrize("end", [False, True])
def test_the_walls_of_a_pyramid_go_on_straight_where_three_slices_agree(end):
    """Below and above each slab, at its corners in the lower and in the upper plane."""
    parts = slabs(pyramid(-1.0, 3.5, (end, end)))
    expected = [
        ((end, end), (False, False)),
        # in the planes of the first and the last slice the body is narrower than the slab
        ((False, False), (False, True)),
        # two slices below and two above
        ((False, False), (False, False)),
        ((True, False), (False, False)),
        ((False, False), (end, end)),
    ]
    for part, (at_low, at_high) in zip(parts, expected, strict=True):
        height = part.corners[:, 2]
        above = height > height.mean()
        assert (part.straight[~above] == at_low).all()
        assert (part.straight[above] == at_high).all()


@pytest.mark.parametrize("edges", [[0, 1, 2], [1, 2, 3], [0, 2], [1, 3]])
def test_slabs_are_unbounded_where_no_contact_shows_a_side(edges):
    """Squares of which one side, or two, are not touched: the half-spaces have room inside, and do not close."""
    upright = slice_of(rectangle(2.0), 0.0)
    slices = tuple(
        dataclasses.replace(slice_of(rectangle(2.0), z, edges=edges), outline=upright.outline) for z in range(4)
    )
    parts = slabs(SliceStack(np.eye(3), slices, -1.0, 4.0))
    kinds = [Gap.CAPS, Gap.SLICES, Gap.SLICES, Gap.SLICES, Gap.CAPS]
    for part, kind in zip(parts, kinds, strict=True):
        assert np.isinf(part.corners).all()
        assert part.corners.shape == (1, 3)
        assert part.kind.tolist() == [kind]
        assert not part.straight.any()
        assert part.volume == np.inf


def test_a_slice_without_outline_has_no_inner_point():
    """Contacts on a line, in all slices: no half-space has a point behind it that is known to be inside."""
    slices = tuple(slice_of(rectangle(2.0), z, edges=[1]) for z in range(4))
    assert all(np.isinf(part.volume) for part in slabs(SliceStack(np.eye(3), slices, -1.0, 4.0)))


def test_one_slice_alone_has_caps_that_nothing_bounds():
    parts = slabs(stack_of_rectangles([0.0], [2.0], -1.0, 1.0))
    assert len(parts) == 2
    for part in parts:
        assert part.volume == np.inf
        assert part.kind.tolist() == [Gap.CAPS]


@pytest.mark.parametrize(("floor", "ceiling"), [(-np.inf, 3.5), (-1.0, np.inf), (-np.inf, np.inf)])
def test_a_cap_without_an_end_is_unbounded(floor, ceiling):
    parts = slabs(pyramid(floor, ceiling))
    for part, open_end in ((parts[0], np.isinf(floor)), (parts[-1], np.isinf(ceiling))):
        assert np.isinf(part.volume) == open_end
        assert np.isinf(part.corners).any() == open_end
        if open_end:
            assert part.corners.shape == (1, 3)
            assert part.kind.tolist() == [Gap.CAPS]
            assert part.straight.tolist() == [[False, False]]
    assert all(np.isfinite(part.volume) for part in parts[1:-1])


def test_a_cap_without_height_has_no_corners():
    """Another stack may show that the body ends at the end slice."""
    parts = slabs(pyramid(0.0, 3.0))
    for part in (parts[0], parts[-1]):
        assert part.volume == 0.0
        assert part.corners.shape == (0, 3)
        assert part.straight.shape == (0, 2)
        assert len(part.kind) == 0


def test_slabs_without_volumes_are_the_same():
    for stack in (pyramid(-1.0, 3.5), pyramid(-np.inf, 3.5)):
        for one, other in zip(slabs(stack), slabs(stack, volumes=False), strict=True):
            assert all(np.array_equal(a, b) for a, b in zip(one[:3], other[:3], strict=True))
            assert np.isnan(other.volume) if np.isfinite(one.volume) else other.volume == np.inf


def test_slabs_that_are_known_are_not_computed_again():
    stack = pyramid(-1.0, 3.5)
    known = {}
    parts = slabs(stack, known=known)
    assert set(known) == set(slab_keys(stack))
    again = slabs(stack, known=known)
    assert all(one is other for one, other in zip(parts, again, strict=True))
    # another ceiling changes the cap, and the two slabs below that depend on three slices or ends above
    higher = slabs(pyramid(-1.0, 3.6), known=known)
    assert [one is other for one, other in zip(parts, higher, strict=True)] == [True, True, False, False, False]
    # as does another number of contacts in a slice
    fewer = dataclasses.replace(stack.slices[3], rows=stack.slices[3].rows[:-1])
    changed = slabs(dataclasses.replace(stack, slices=(*stack.slices[:3], fewer)), known=known)
    assert [one is other for one, other in zip(parts, changed, strict=True)] == [True, False, False, False, False]


def test_corners_are_given_in_the_world():
    frame = slice_frame(np.array([1.0, 2.0, 3.0]))
    upright = pyramid(-1.0, 3.5)
    for part, turned in zip(slabs(upright), slabs(dataclasses.replace(upright, frame=frame)), strict=True):
        assert turned.corners @ frame.T == pytest.approx(part.corners, abs=1e-9)
        assert turned.volume == pytest.approx(part.volume)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("thickness", [1e-7, 1.0])
def test_thin_slabs_are_as_exact(scale, thickness):
    """Upright walls between slices that are close together, about a place far from the origin."""
    heights = scale * thickness * np.arange(4.0)
    stack = stack_of_rectangles(heights, [scale * 2.0] * 4, -scale * thickness, 4 * scale * thickness)
    parts = slabs(stack)
    for part in parts:
        assert part.volume == pytest.approx(16 * scale**3 * thickness, rel=1e-9)
        assert np.abs(part.corners[:, :2]) == pytest.approx(np.full((len(part.corners), 2), 2.0 * scale), rel=1e-9)
    # in the plane of the first slice, which has no slice below, no half-space of a slice bounds the slab above it
    height = parts[1].corners[:, 2]
    assert (parts[1].kind == np.where(height > height.mean(), Gap.CONTACTS, Gap.SLICES)).all()
