"""The choice among the methods, errors of surfaces at contacts that are held out, and contours between slices."""

from itertools import pairwise

import numpy as np
import pytest
import trimesh
from sample_bodies import MESHES, rotated, scanned

import scan3d
from scan3d.geometry.distance import signed_distances
from scan3d.geometry.hulls import hull
from scan3d.reconstruction.slices import Slice, SliceStack
from scan3d.surfaces import certificate, enclosure, surface
from scan3d.surfaces.estimates import contours_between

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def box():
    mesh = rotated(trimesh.creation.box((40, 30, 50)))
    return mesh, scanned(mesh, spacing="cosine")


@pytest.fixture(scope="module")
def ball():
    # fine enough that 24 slices, and not the facets, limit the scan
    mesh = trimesh.creation.icosphere(5, 20.0)
    return mesh, scanned(mesh)


def test_a_polyhedron_between_its_slices_is_recognised_by_its_facets(box, monkeypatch):
    mesh, cloud = box
    estimate = surface(cloud)
    assert estimate.metadata["method"] == "bracket"
    assert "a polyhedron of 6 facets" in estimate.metadata["reason"]
    assert scan3d.compare(estimate, mesh).relative < 1e-12
    monkeypatch.setattr("scan3d.reconstruction.facets.facets", lambda _: np.empty((0, 4)))
    by_turns = surface(cloud)
    assert "as the slopes of neighbouring slices tell" in by_turns.metadata["reason"]
    # what remains is largest two slices from the ends, where three on one side would be needed
    assert scan3d.compare(by_turns, mesh).relative < 1e-3
    assert scan3d.compare(surface(cloud, "hull"), mesh).relative > 1e-2
    assert estimate.is_watertight


def test_a_smooth_body_is_fitted(ball):
    mesh, cloud = ball
    fitted = surface(cloud)
    assert fitted.metadata["method"] == "support"
    assert "degree" in fitted.metadata["reason"]
    assert scan3d.compare(fitted, mesh).relative < 1e-4


@pytest.mark.parametrize(("slices", "noise"), [(6, 1e-2), (9, 3e-2)])
def test_a_fit_does_not_follow_noise_between_few_slices(slices, noise):
    mesh = scan3d.load_mesh(MESHES / "egg.stl")
    plan = scan3d.Plan(slices=slices, sweeps=4, samples=320, spacing="uniform", noise=noise)
    fitted = surface(scan3d.reconstruct(scan3d.simulate(mesh, plan)))
    assert fitted.metadata["method"] == "support"
    assert scan3d.compare(fitted, mesh).relative < 6e-3


def test_the_estimate_between_the_bounds_is_closer_to_a_smooth_body_than_its_hull(ball):
    mesh, cloud = ball
    bounds = enclosure(cloud)
    estimate = surface(cloud, "bracket", bounds=bounds)
    assert estimate.metadata["method"] == "bracket"
    distance, distance_of_hull = (scan3d.compare(shape, mesh).hausdorff for shape in (estimate, bounds.inner))
    assert distance < 0.8 * distance_of_hull
    assert distance <= certificate(bounds, estimate).bound <= bounds.bound


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.trust) for seed in range(1, 8))])
def test_the_estimate_lies_between_the_bounds(seed):
    """Whatever the body: no point lies outside the outer body by more than interpolation, and the certificate holds."""
    rng = np.random.default_rng(seed)
    mesh = hull(20 * rng.normal(size=(int(rng.integers(8, 60)), 3)))
    cloud = scanned(mesh, slices=12, samples=32)
    bounds = enclosure(cloud)
    estimate = surface(cloud, "bracket", bounds=bounds)
    assert signed_distances(estimate.vertices, hull(bounds.corners)).max() < 1e-4 * bounds.bound
    assert signed_distances(bounds.inner.vertices, estimate).max() < 1e-9 * bounds.bound + 1e-12
    assert certificate(bounds, estimate).bound >= scan3d.compare(estimate, mesh).hausdorff * (1 - 1e-9)


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        pytest.param("cube.stl", 1, marks=pytest.mark.slow),
        *(
            pytest.param(name, seed, marks=pytest.mark.trust)
            for name, seed in [("gem.glb", 4), ("cylinder.off", 4), ("rounded_box.glb", 2), ("capsule.stl", 2)]
        ),
    ],
)
def test_bodies_in_any_orientation_with_64_adaptive_slices(name, seed):
    mesh = rotated(scan3d.load_mesh(MESHES / name), seed)
    cloud = scanned(mesh, slices=64, spacing="adaptive")
    bounds = enclosure(cloud)
    made = surface(cloud, bounds=bounds)
    assert scan3d.compare(made, mesh).relative < 5e-4
    assert certificate(bounds, made).bound < 2e-3 * np.linalg.norm(mesh.extents)


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
    return stack_of(np.array(heights, dtype=float), lambda angle, z: np.full(len(angle), profile(z)))


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
