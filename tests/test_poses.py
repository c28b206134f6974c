"""Poses of the clamp along a base line, against the definitions of its frame."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapes import rotation

from scan3d.planning.aims import base_line, clamp_axes, positions

OUTLINE = np.array([[3.0, 1.0], [7.0, 2.0], [6.0, 8.0], [2.0, 5.0]])
angles = st.floats(0.0, 2 * np.pi)


@given(angles, st.floats(1e-3, 50.0))
def test_the_base_line_keeps_its_distance_from_the_outline(angle, clearance):
    line = base_line(OUTLINE, angle, clearance)
    across = (OUTLINE - line.origin) @ line.axes[1]
    assert across.min() == pytest.approx(clearance, abs=1e-12)


@given(angles)
def test_the_undeformed_rod_points_in_the_direction_of_approach(angle):
    x, y = base_line(OUTLINE, angle, 1.0).axes
    assert y == pytest.approx([np.cos(angle), np.sin(angle)], abs=1e-15)
    # x, y and the slice's normal are right-handed
    assert x[0] * y[1] - x[1] * y[0] == pytest.approx(1.0, abs=1e-15)


@given(angles)
def test_the_origin_lies_below_the_middle_of_the_outlines_box(angle):
    line = base_line(OUTLINE, angle, 1.0)
    assert (np.array([4.5, 4.5]) - line.origin) @ line.axes[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_the_clamp_moves_along_its_x_axis_in_the_plane_of_the_slice(seed):
    frame, x0, height = rotation(seed), np.array([2.0, 0.5, -3.0]), 12.5
    line = base_line(OUTLINE, 0.7, 2.0)
    places, axes = positions(line, x0, height, frame), clamp_axes(line, frame)
    assert places.shape == axes.shape == (3, 3)
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-14)
    assert np.linalg.det(axes) == pytest.approx(1.0, abs=1e-14)
    assert axes[2] == pytest.approx(frame[2], abs=1e-15)
    assert places @ frame[2] == pytest.approx(np.full(3, height), abs=1e-12)
    assert places - places[1] == pytest.approx((x0 - x0[1])[:, None] * axes[0], abs=1e-12)


def test_in_the_world_frame_the_base_line_is_read_off():
    # the rod points along +y from below a square; sweeps move in -x
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    line = base_line(square, np.pi / 2, 1.5)
    assert positions(line, np.array([2.0, -2.0]), 7.0, np.eye(3)) == pytest.approx(
        np.array([[4.0, -1.5, 7.0], [0.0, -1.5, 7.0]])
    )
    assert clamp_axes(line, np.eye(3)) == pytest.approx(np.eye(3))
