"""Convex regression: planes fitted to noisy contacts, against least squares, known bodies, and the hull of the contacts."""

import numpy as np
import pytest
import trimesh
from sample_bodies import MESHES
from scipy.spatial.transform import Rotation
from shapes import unit

import scan3d
from scan3d.geometry.distance import distances
from scan3d.surfaces import certificate, enclosure
from scan3d.surfaces.choice import surface
from scan3d.surfaces.estimates import Contacts, fit_planes, regression
from tests.robustness.shot_rods import with_noise

pytestmark = pytest.mark.slow


def contacts(points, sd):
    entries = np.tile(np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]) * sd**2, (len(points), 1))
    return Contacts(points, entries, np.zeros(len(points)))


def on_box(count, extents, chance):
    face = chance.integers(0, 6, count)
    points = chance.uniform(-0.5, 0.5, (count, 3)) * extents
    normals = np.concatenate([np.eye(3), -np.eye(3)])[face]
    points[np.arange(count), face % 3] = (normals * extents).sum(axis=1) / 2
    return points, normals


def test_the_planes_of_a_box_are_found_within_their_standard_errors():
    chance, sd = np.random.default_rng(1), 0.2
    turn = Rotation.from_euler("xyz", [20, 30, 40], degrees=True).as_matrix()
    points, normals = on_box(6000, np.array([40.0, 30.0, 20.0]), chance)
    noisy = points @ turn.T + chance.normal(0, sd, points.shape)
    planes = fit_planes(contacts(noisy, sd), chance.integers(0, 40, len(noisy)))
    assert len(planes) == 6
    cosine = planes.normals @ (turn @ np.concatenate([np.eye(3), -np.eye(3)]).T)
    assert sorted(cosine.argmax(axis=1)) == [0, 1, 2, 3, 4, 5]
    # slopes of a plane over a face of width b are known to sd √12 / (b √n); 5 standard errors of the narrowest face
    assert np.arccos(cosine.max(axis=1)).max() < 5 * sd * np.sqrt(12) / (20 * np.sqrt(900))
    offsets = np.tile([20.0, 15.0, 10.0], 2)[cosine.argmax(axis=1)]
    # contacts near the edges belong to the wrong plane now and then, which adds a little
    assert np.abs(planes.offsets - offsets).max() < 0.04


def test_a_ball_is_fitted_by_many_planes_and_less_noise_by_more():
    chance = np.random.default_rng(3)
    directions = unit(chance.normal(size=(8000, 3)))
    found = []
    for sd in (0.4, 0.1):
        points = 20 * directions + chance.normal(0, sd, directions.shape)
        planes = fit_planes(contacts(points, sd), (directions[:, 2] * 4).astype(int))
        found.append((len(planes), np.abs(planes.offsets - 20).max()))
    assert 20 < found[0][0] < found[1][0]
    assert found[1][1] < 0.2 < found[0][1] < 0.5


def scan(mesh, fraction, slices, seed=1):
    """Contacts under noise of a fraction of the largest force and of the largest moment."""
    recording = scan3d.simulate(mesh, scan3d.Plan(slices=slices, spacing="cosine", friction=(0.0, 0.4)))
    sizes = (fraction * np.abs(values).max() for values in (recording.force_N, recording.moment_Nm))
    return scan3d.reconstruct(with_noise(recording, *sizes, np.random.default_rng(seed)))


@pytest.mark.parametrize(
    "name",
    ["cube.stl", *(pytest.param(name, marks=pytest.mark.trust) for name in ("hexagonal_prism.obj", "cylinder.off"))],
)
def test_with_one_per_cent_of_noise_bodies_with_edges_are_found_ten_times_better_than_by_the_hull(name):
    mesh = scan3d.load_mesh(MESHES / name)
    cloud = scan(mesh, 0.01, 24)
    bounds = enclosure(cloud)
    found = surface(cloud, bounds=bounds)
    assert found.metadata["method"] == "regression"
    assert "planes, fitted to the contacts with their uncertainties" in found.metadata["reason"]
    error, diagonal = scan3d.compare(found, mesh).hausdorff, np.linalg.norm(mesh.extents)
    assert error < 1e-2 * diagonal
    assert error < 0.1 * scan3d.compare(surface(cloud, "hull"), mesh).hausdorff
    assert error < certificate(bounds, found).bound


def test_no_part_of_the_fitted_polytope_lies_outside_the_outer_body():
    # planes above and below a narrow band, of which few contacts tell, meet outside it
    gem = trimesh.convex.convex_hull(
        [
            [np.cos(a) * r, np.sin(a) * r, z]
            for r, z in ((6, -12), (15, -0.4), (15, 0.4), (6, 7))
            for a in np.arange(0.2, 6.4, 0.5236)
        ]
    )
    cloud = scan(gem, 0.004, 24)
    bounds = enclosure(cloud)
    outer = bounds.outer_planes()
    free = regression(cloud.accurate())[0]
    assert (free.vertices @ outer[:, :3].T - outer[:, 3]).max() > 0.01
    found = surface(cloud, "regression", bounds=bounds)
    assert (found.vertices @ outer[:, :3].T - outer[:, 3]).max() < 1e-6
    # the largest error may be one inside the outer body
    cut, whole = scan3d.compare(found, gem), scan3d.compare(free, gem)
    assert cut.hausdorff < whole.hausdorff + 1e-9
    assert abs(cut.volume_error) < 0.9 * abs(whole.volume_error)


def test_with_one_per_cent_of_noise_the_egg_is_found_to_a_third_of_the_largest_error_of_a_contact():
    mesh = scan3d.load_mesh(MESHES / "egg.stl")
    cloud = scan(mesh, 0.01, 28)
    off = distances(cloud.points, mesh)
    assert np.sqrt(np.mean(off**2)) < 0.01 * cloud.rod_length
    found = surface(cloud)
    assert found.metadata["method"] == "support"
    error = scan3d.compare(found, mesh).hausdorff
    # the goal is a third: weights, and all contacts, make it a twentieth
    assert error < off.max() / 20


def test_a_body_with_a_sharp_rim_does_not_pass_for_smooth_because_of_noise():
    mesh = scan3d.load_mesh(MESHES / "lens.off")
    cloud = scan(mesh, 0.002, 25)
    assert cloud.fit is not None  # its error at the contacts is that of noise
    found = surface(cloud)
    assert found.metadata["method"] != "support"
    assert scan3d.compare(found, mesh).hausdorff < 0.01 * np.linalg.norm(mesh.extents)
    assert scan3d.compare(surface(cloud, "support"), mesh).hausdorff > 0.02 * np.linalg.norm(mesh.extents)


def test_contacts_in_space_are_fitted_as_well():
    mesh = trimesh.creation.box((30, 40, 50))
    recording = scan3d.simulate(
        mesh, scan3d.Plan(slices=6, sweeps=1, samples=40, friction=0.2, model="spatial", noise=1e-3)
    )
    cloud = scan3d.reconstruct(recording)
    found = surface(cloud)
    assert found.metadata["method"] == "regression"
    error = scan3d.compare(found, mesh).hausdorff
    assert error < 0.2 * scan3d.compare(surface(cloud, "hull"), mesh).hausdorff
    assert error < 0.01 * np.linalg.norm(mesh.extents)


def test_where_few_contacts_show_a_plane_the_polytope_goes_half_way_to_its_vertices():
    mesh = trimesh.creation.cone(20.0, 40.0, sections=6)
    mesh.apply_translation([0, 0, -10])
    cloud = scan(mesh, 0.002, 12)
    low, high = surface(cloud, "regression").bounds
    # no farther than half way from the last slice to the empty slice beyond it
    heights = np.unique(cloud.slice_height)
    assert low[2] >= heights[0]
    assert high[2] <= heights[-1]
