"""Plans: their settings, approach directions, base lines and frames of the slices."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scan3d.planning.plan import (
    AIMED_SLOPE,
    OPEN_FRACTION,
    base_fractions,
    base_line,
    further_directions,
)


@pytest.mark.parametrize("samples", [2, 3, 64])
def test_samples_go_from_touch_down_to_the_end_denser_at_the_start(samples):
    shares = base_fractions(samples)
    assert (shares[0], shares[-1]) == (0.0, pytest.approx(1.0))
    assert np.all(np.diff(shares) > 0)
    assert np.all(np.diff(shares, 2) > 0)


def circle(angles):
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return normals, normals


def test_a_gap_is_aimed_at_in_its_middle():
    angles = np.deg2rad(np.arange(0, 300.5, 0.5))  # nothing between 300° and 360°
    (direction,) = further_directions(*circle(angles), width=2.0)
    # the rod, pointing along the direction, meets the normal n = (sin α̃, -cos α̃) of the clamp's frame at the slope aimed at
    y = np.array([np.cos(direction), np.sin(direction)])
    x = np.array([y[1], -y[0]])
    met = np.sin(AIMED_SLOPE) * x - np.cos(AIMED_SLOPE) * y
    assert met == pytest.approx([np.cos(np.deg2rad(330)), np.sin(np.deg2rad(330))], abs=2e-3)  # rounded to 0.001 rad


def square(reach):
    """Contacts on the sides of the square from -1 to 1, as far as `reach` from their middles."""
    along, side = np.linspace(-reach, reach, 11), np.ones(11)
    sides = [(side, along), (-along, side), (-side, -along), (along, -side)]
    normals = np.repeat([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]], 11, axis=0)
    return np.concatenate([np.stack(places, axis=1) for places in sides]), normals


def test_a_corner_that_was_not_reached_is_open():
    # its triangle is (1 - reach) / sqrt(2) high
    closed, open_ = (1 - fraction * OPEN_FRACTION * 2.0 * math.sqrt(2) for fraction in (0.9, 1.1))
    assert len(further_directions(*square(closed), width=2.0)) == 0
    assert len(further_directions(*square(open_), width=2.0)) == 4


OUTLINE = np.array([[3.0, 1.0], [7.0, 2.0], [6.0, 8.0], [2.0, 5.0]])
angles = st.floats(0.0, 2 * np.pi)


@given(angles, st.floats(1e-3, 50.0))
def test_the_base_line_keeps_its_distance_from_the_outline(angle, clearance):
    line = base_line(OUTLINE, angle, clearance)
    across = (OUTLINE - line.origin) @ line.axes[1]
    assert across.min() == pytest.approx(clearance, abs=1e-12)
