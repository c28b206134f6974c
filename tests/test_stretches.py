"""Sweeps at what no contact supports, by a letter L whose bay the first directions do not reach."""

from dataclasses import replace

import numpy as np
import pytest
from shapes import letter_l

import scan3d
from scan3d.bounds.free_space import outer_contours, sheets_of
from scan3d.planning.plan import aimed_line, aims


@pytest.fixture(scope="module")
def parts():
    """Recordings and contacts of the letter's first sweeps, and of all of them."""
    flat = letter_l()
    flat.vertices *= (1, 1, 0.1)
    recording = scan3d.simulate(flat, scan3d.Plan(slices=2, samples=24))
    # of twelve sweeps in each slice, and of six beyond either end
    rows, columns = recording.sweep < 36, ("sweep", "position_m", "quaternion", "force_N", "moment_Nm")
    first = replace(recording, **{name: getattr(recording, name)[rows] for name in columns})
    return [(part, scan3d.reconstruct(part)) for part in (first, recording)]


@pytest.mark.slow
def test_aimed_sweeps_reach_into_the_bay(parts):
    before, after = (outer_contours(sheets_of(*part), part[1]).distance.max() for part in parts)
    assert after < 0.9 * before
    # the bay's corner, x = y = 1
    before, after = (np.linalg.norm(cloud.points[:, :2] - 1.0, axis=1).min() for _, cloud in parts)
    assert after < 0.4 * before


@pytest.mark.slow
def test_aims_point_at_the_widest_stretch(parts):
    recording, cloud = parts[0]
    sheets, found = sheets_of(recording, cloud), aims(recording, cloud)
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


@pytest.mark.slow
def test_a_session_aims_at_stretches_and_then_between_slices(parts):
    recording, cloud = parts[0]
    moved = replace(recording, position_m=recording.position_m - np.array([1e-3, 1e-3, 0.0]))
    session = scan3d.Session("cylinder:2.9x0.6", recording.rod, tolerance=0.1)
    session.tell(moved)
    assert "between them nothing" in session.known
    assert session.known in session.summary()[-1][1]
    poses = session.ask(16)
    heights = [1000 * poses.position_m[rows[0], 2] for rows in poses.sweeps()]
    at_stretches = len(aims(recording, cloud))
    assert 0 < at_stretches < 16
    assert set(np.round(heights[:at_stretches], 6)) == {0.075, 0.225}
    # none below the table
    assert set(np.round(heights[at_stretches:], 6)) <= {0.15, 0.3}
