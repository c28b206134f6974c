"""The estimate between the bounds, on stacks of slices of bodies whose support function is known."""

from itertools import pairwise

import numpy as np
import pytest

from scan3d.reconstruction.slices import Slice, SliceStack
from scan3d.surfaces.between import Edges, Tuning, _contour, _thinned, contours_between, fractions

TUNING = Tuning(damping=0.6, unseen_corners=0.3, parabola=0.25, crease=0.75)


def stack_of(heights, support):
    """Slices whose support function is `support(angle, height)`, known at 36 angles."""
    angle = 2 * np.pi * np.arange(36) / 36 - np.pi
    normals, tangents = (
        np.stack([np.cos(angle), np.sin(angle)], axis=1),
        np.stack([-np.sin(angle), np.cos(angle)], axis=1),
    )
    slices = []
    for z in heights:
        h = support(angle, z)
        slope = np.zeros(36)
        points = h[:, None] * normals + slope[:, None] * tangents
        rows = np.arange(36)
        slices.append(
            Slice(
                height=z,
                rows=rows,
                points=points,
                tangential=rows,
                normals=normals,
                tip=rows[:0],
                tip_normals=normals[:0],
                outline=points,
                angle=angle,
                value=h,
                slope=np.stack([slope, slope]),
                corner=np.stack([points, points], axis=1),
            )
        )
    return SliceStack(np.eye(3), tuple(slices), heights[0] - 1, heights[-1] + 1)


def round_stack(profile, heights):
    """Slices of a body of revolution with the radius `profile(z)`."""
    return stack_of(np.array(heights, dtype=float), lambda angle, z: np.full(len(angle), profile(z)))


def fraction_at(profile, heights, z, straight, edges=Edges.SHARP, tuning=TUNING):
    """The fraction for a body of revolution with the radius `profile(z)`, in the slab of the height z."""
    slab = np.searchsorted(heights, [z])
    away = np.array([[0.1, 0.0, 0.0]])
    (found,) = fractions(round_stack(profile, heights), away, slab, np.array([straight]), (edges,), tuning)
    return float(found[0])


def test_a_parabola_reaches_a_quarter_of_the_distance():
    """Evenly sliced: chord's height c d²/8, secants' apex 4 times that; the damping draws the estimate to the middle."""
    fraction = fraction_at(lambda z: 10 - z * z, [-3, -2, -1, 0, 1, 2, 3], 0.5, (False, False), Edges.SOME)
    assert fraction == pytest.approx(0.4 * 0.25 + 0.6 * 0.5)
    # it is that of the parabola itself if the body is bent everywhere
    fraction = fraction_at(lambda z: 10 - z * z, [-3, -2, -1, 0, 1, 2, 3], 0.5, (False, False), Edges.ROUND)
    assert fraction == pytest.approx(0.25)


def test_two_cones_with_a_common_base_reach_the_corner():
    creased = [-3, -2, -1, 1, 2, 3], 0.0, (True, True)
    assert fraction_at(lambda z: 10 - abs(z), *creased) == 1.0
    assert fraction_at(lambda z: 10 - abs(z), *creased, Edges.SOME) == 0.75


def test_an_arc_at_a_straight_part_comes_close_to_the_corner():
    """A cylinder that goes over into a paraboloid: the later in the slab, the nearer it comes to the corner."""
    early, late = (
        fraction_at(lambda z, start=start: 10 - max(0.0, z - start) ** 2, range(-2, 4), 0.5, (True, False), Edges.SOME)
        for start in (0.0, 0.7)
    )
    # its tangents' apex lies at 3/4 of the secants'; a parabola reaches half of it
    assert early == pytest.approx(0.4 * 0.375 + 0.6 * 0.5)
    assert 0.6 < late < 0.7
    # a polyhedron, straight on one side
    assert fraction_at(lambda z: 10 - max(0.0, z) ** 2, range(-2, 4), 0.5, (True, False)) == 1.0


def test_a_body_that_is_flat_between_slices_stays_with_the_hull_except_in_the_caps():
    stack = stack_of(np.arange(5.0), lambda angle, z: np.full(len(angle), 10.0))
    away, slab = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.5], [0.0, 0.0, -0.5]]), np.array([2, 5, 0])
    (estimate,) = fractions(stack, away, slab, np.zeros((3, 2), dtype=bool), (Edges.NONE,), Tuning())
    assert estimate.tolist() == [0.0, 0.5, 0.5]


@pytest.mark.parametrize(
    ("profile", "heights"),
    [
        (lambda z: 10 - z * z, (-3, -2, -1, 0, 1, 2, 3)),
        (lambda z: 10 - abs(z), (-3, -2, -1, 1, 2, 3)),
        (lambda z: 10 - max(0.0, z) ** 2, (-3, -2, -1, 0, 1, 2, 3)),
        (lambda z: 10 - z, (0, 1, 3, 4)),
    ],
    ids=["parabola", "cone on cone", "cylinder and paraboloid", "cone"],
)
def test_the_contours_between_slices_are_the_bodys(profile, heights):
    """Where the estimate's assumptions hold, the contours' narrowest radius, at their support lines, is the body's."""
    points = contours_between(round_stack(profile, heights), Tuning())
    levels, member = np.unique(np.round(points[:, 2], 9), return_inverse=True)
    assert levels == pytest.approx([z + up * (after - z) for z, after in pairwise(heights) for up in (1 / 3, 2 / 3)])
    radius = np.hypot(points[:, 0], points[:, 1])
    for k, z in enumerate(levels):
        assert radius[member == k].min() == pytest.approx(profile(z), rel=1e-9)
        # not beyond the corners of 36 support lines
        assert radius[member == k].max() < profile(z) / np.cos(np.pi / 36)


def test_an_arc_that_begins_in_the_straight_part_is_followed_back():
    """It begins a fifth of a step before the slice, which the slope of the slab there hardly shows."""

    def profile(z):
        return 10 - max(0.0, z + 0.2) ** 2

    points = contours_between(round_stack(profile, np.arange(-3.0, 4.0)), Tuning())
    for z in (1 / 3, 2 / 3):
        contour = points[np.abs(points[:, 2] - z) < 1e-9]
        assert np.hypot(contour[:, 0], contour[:, 1]).min() == pytest.approx(profile(z), rel=1e-12)


def test_support_lines_that_enclose_nothing_give_no_contour():
    angle = np.arange(4) * np.pi / 2
    assert _contour(angle, np.ones(4), np.zeros(2)).shape == (4, 2)
    # the point is outside; and what Qhull can't process
    assert _contour(angle, -np.ones(4), np.zeros(2)).shape == (0, 2)
    assert _contour(np.zeros(4), np.ones(4), np.zeros(2)).shape == (0, 2)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 400, 401])
def test_every_second_point_of_a_fine_contour_is_left_out(count):
    angle = 2 * np.pi * np.arange(count) / max(count, 1)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    # the chord of two neighbours is 1 - cos(2π/n) below the point between them
    least = 1 - np.cos(2 * np.pi / count) if count else 0.0
    if count > 3:
        assert len(_thinned(circle, 1.001 * least)) == (count + 1) // 2
    assert np.array_equal(_thinned(circle, 0.999 * least), circle)


def test_a_polyhedrons_vertices_lie_beyond_those_of_a_curved_body():
    """Where too few slices show the planes, the estimate of a polyhedron lies farther out than that of a curved body."""
    curved, sharp = (
        fraction_at(lambda z: 10 - z * z, range(-3, 4), 0.5, (False, False), edges)
        for edges in (Edges.SOME, Edges.SHARP)
    )
    assert sharp == pytest.approx(curved + 0.3 * (1 - curved))
