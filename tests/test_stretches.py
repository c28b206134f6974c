"""Sweeps at what no contact supports, by a letter L whose bay the first directions do not reach."""

from dataclasses import replace

import numpy as np
import pytest
from shapes import letter_l

import scan3d
from scan3d.bounds.free_space import outer_contours, sheets_of
from scan3d.planning.stretches import aimed_line, aims


@pytest.fixture(scope="module")
def parts():
    """Sheets and contacts of the letter's first sweeps, and of all of them."""
    flat = letter_l()
    flat.vertices *= (1, 1, 0.1)
    recording = scan3d.simulate(flat, scan3d.Plan(slices=1, samples=24))
    # of twelve sweeps in the slice, and of six on either side of it
    rows, columns = recording.sweep < 24, ("sweep", "position_m", "quaternion", "force_N", "moment_Nm")
    first = replace(recording, **{name: getattr(recording, name)[rows] for name in columns})
    return [(sheets_of(part, cloud), cloud) for part in (first, recording) for cloud in [scan3d.reconstruct(part)]]


def test_aimed_sweeps_reach_into_the_bay(parts):
    before, after = (outer_contours(*part).distance.max() for part in parts)
    assert after < 0.9 * before
    # the bay's corner, x = y = 1
    before, after = (np.linalg.norm(cloud.points[:, :2] - 1.0, axis=1).min() for _, cloud in parts)
    assert after < 0.4 * before


def test_aims_point_at_the_widest_stretch(parts):
    sheets, cloud = parts[0]
    found = aims(sheets, cloud)
    assert [aim.width for aim in found] == sorted((aim.width for aim in found), reverse=True)
    widest = outer_contours(sheets, cloud).distance.max()
    assert found[0].width == pytest.approx(widest)
    assert min(aim.width for aim in found) > sheets[0].apart
    # into the bay, from the side of x + y = 3, and as far as half of what may lie behind the stretch
    direction = np.array([np.cos(found[0].angle), np.sin(found[0].angle)])
    assert direction @ (-1, -1) > 0.5 * np.sqrt(2)
    line = aimed_line(found[0], letter_l().vertices[:, :2], 10.0, 0.5)
    assert line.origin @ direction + 10.0 == pytest.approx(found[0].tip)
    near = aimed_line(found[0], letter_l().vertices[:, :2], 1.0, 0.5)
    assert near.origin @ direction == pytest.approx((letter_l().vertices[:, :2] @ direction).min() - 0.5)
