"""The estimate between the bounds, on stacks of slices of bodies whose support function is known, and on scans of bodies."""

from itertools import pairwise

import numpy as np
import pytest

from scan3d.reconstruction.slices import Slice, SliceStack
from scan3d.surfaces.estimates import _local, contours_between


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


def fraction_at(profile, heights, z):
    """The fraction for a body of revolution with the radius `profile(z)`, in the slab of the height z."""
    (found,) = _local(round_stack(profile, heights), np.searchsorted(heights, [z]), np.array([[0.1, 0.0, 0.0]]))
    return float(found)


def test_an_evenly_sliced_parabola_reaches_a_quarter_of_the_distance():
    """Chord's height c d²/8, secants' apex 4 times that."""
    assert fraction_at(lambda z: 10 - z * z, [-3, -2, -1, 0, 1, 2, 3], 0.5) == pytest.approx(0.25)


def test_two_cones_with_a_common_base_reach_the_corner():
    assert fraction_at(lambda z: 10 - abs(z), [-3, -2, -1, 1, 2, 3], 0.0) == pytest.approx(1.0)


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
    points = contours_between(round_stack(profile, heights))
    levels, member = np.unique(np.round(points[:, 2], 9), return_inverse=True)
    assert levels == pytest.approx([z + up * (after - z) for z, after in pairwise(heights) for up in (1 / 3, 2 / 3)])
    radius = np.hypot(points[:, 0], points[:, 1])
    for k, z in enumerate(levels):
        assert radius[member == k].min() == pytest.approx(profile(z), rel=1e-9)
        # not beyond the corners of 36 support lines
        assert radius[member == k].max() < profile(z) / np.cos(np.pi / 36)
