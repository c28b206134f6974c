"""Cross-validation: which slices are held out, and the errors at their contacts."""

from dataclasses import replace

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
    assert np.isin(held_out.points[:, 2].round(9), heights[1:-1:2].round(9)).all()
    assert np.allclose(kept.slice_height[kept.slice], kept.points[:, 2])
    # the empty slices stay: they bound the body
    assert len(kept.slice_height) == len(kept_heights) + 2
    assert kept.fit is None


def test_the_error_of_a_surface_is_the_distance_of_the_held_out_contacts():
    box = hull(trimesh.creation.box((2, 2, 2)).vertices)
    error = error_of_surface(box, contacts_at([[0.0, 0.0, 1.5], [0.0, 0.9, 0.0]]))
    assert error.largest == pytest.approx(0.5)
    assert error.rms == pytest.approx(np.sqrt((0.5**2 + 0.1**2) / 2))


def contacts_at(points, normals=None, sd=None):
    """A cloud of contacts at points (n, 3), with standard deviations (n, 3) of their coordinates if they are noisy."""
    points = np.array(points)
    some = scanned(trimesh.creation.box((2, 2, 2)), slices=4, samples=16)
    cloud = some.select(np.resize(np.arange(len(some)), len(points)))
    cloud = replace(
        cloud, points=points, normals=np.full_like(points, np.nan) if normals is None else np.array(normals)
    )
    if sd is None:
        return cloud
    place_sd = np.max(sd, axis=1)
    covariance = np.eye(3) * np.square(sd)[:, None]
    return replace(cloud, covariance=covariance, place_sd=place_sd, noise=float(np.median(place_sd)), rod_length=1e5)


def test_noise_alone_is_no_error_of_the_true_surface_and_a_displaced_one_has_its_displacement():
    chance = np.random.default_rng(1)
    sphere = trimesh.creation.icosphere(6, 10.0)
    directions = sphere.face_normals[:: len(sphere.faces) // 4000]
    sd = np.repeat(chance.uniform(0.05, 0.2, (len(directions), 1)), 3, axis=1)
    cloud = contacts_at(sphere.triangles_center[:: len(sphere.faces) // 4000], directions, sd)
    noisy = replace(cloud, points=cloud.points + chance.normal(0, sd))
    # the weighting adds 0.15 median standard deviations to each, which leaves nothing of the noise
    assert error_of_surface(sphere, noisy).rms < 0.02
    assert error_of_surface(sphere, noisy).largest > 0.5
    larger = trimesh.creation.icosphere(6, 10.3)
    assert error_of_surface(larger, noisy).rms == pytest.approx(0.3, rel=0.03)


def test_a_contact_displaced_around_an_edge_is_judged_by_its_error_across_the_other_face():
    box = hull(trimesh.creation.box((2, 2, 2)).vertices)
    # of the face y = 1 at its edge, displaced along that face, where its error is large
    normals, sd = [[0.0, 1.0, 0.0]], [[0.1, 1e-4, 1e-4]]
    around = error_of_surface(box, contacts_at([[1.1, 1.0, 0.0]], normals, sd))
    across = error_of_surface(box, contacts_at([[0.5, 1.1, 0.0]], normals, sd))
    assert around.largest == pytest.approx(across.largest)
    assert around.rms < 0.01
    assert across.rms > 0.09


@pytest.mark.slow
def test_the_error_of_a_fit_contains_no_facets(ball):
    directions = ball.points[:100] / np.linalg.norm(ball.points[:100], axis=1, keepdims=True)
    error = error_of_fit(ball.fit, contacts_at(20.5 * directions), directions)
    assert error.largest == pytest.approx(0.5, abs=2e-3)
    assert error.rms == pytest.approx(0.5, abs=2e-3)
