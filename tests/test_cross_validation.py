"""Cross-validation: which slices are held out, and the errors at their contacts."""

import numpy as np
import pytest
import trimesh
from sample_bodies import scanned

from scan3d.geometry.hulls import hull
from scan3d.surfaces.choice import surface
from scan3d.surfaces.cross_validation import error_of_fit, error_of_surface, hold_out_slices


@pytest.fixture(scope="module")
def ball():
    # fine enough that 24 slices, and not the facets, limit the scan
    return scanned(trimesh.creation.icosphere(6, 20.0))


def test_with_few_slices_the_estimate_is_made_without_cross_validation():
    cloud = scanned(trimesh.creation.icosphere(3, 20.0), slices=4, samples=16)
    assert hold_out_slices(cloud) is None
    assert "too few slices" in surface(cloud).metadata["reason"]


@pytest.mark.slow
def test_every_second_slice_is_held_out_except_the_end_slices(ball):
    kept, held_out = hold_out_slices(ball)
    heights = np.sort(np.unique(ball.slice_height[ball.slice]))
    kept_heights = np.sort(np.unique(kept.slice_height[kept.slice]))
    assert kept_heights.tolist() == heights[::2].tolist() + ([] if len(heights) % 2 else [heights[-1]])
    assert len(kept) + len(held_out) == len(ball)
    assert np.isin(held_out[:, 2].round(9), heights[1:-1:2].round(9)).all()
    assert np.allclose(kept.slice_height[kept.slice], kept.points[:, 2])
    # the empty slices stay: they bound the body
    assert len(kept.slice_height) == len(kept_heights) + 2
    assert kept.fit is None


def test_the_error_of_a_surface_is_the_distance_of_the_held_out_contacts():
    box = hull(trimesh.creation.box((2, 2, 2)).vertices)
    error = error_of_surface(box, np.array([[0.0, 0.0, 1.5], [0.0, 0.9, 0.0]]))
    assert error.largest == pytest.approx(0.5)
    assert error.rms == pytest.approx(np.sqrt((0.5**2 + 0.1**2) / 2))


@pytest.mark.slow
def test_the_error_of_a_fit_contains_no_facets(ball):
    directions = ball.points[:100] / np.linalg.norm(ball.points[:100], axis=1, keepdims=True)
    error = error_of_fit(ball.fit, 20.5 * directions, directions)
    assert error.largest == pytest.approx(0.5, abs=2e-3)
    assert error.rms == pytest.approx(0.5, abs=2e-3)
