"""The choice among the methods, and the errors of surfaces at contacts that are held out."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from sample_bodies import MESHES, rotated, scanned

import scan3d
from scan3d.geometry.distance import signed_distances
from scan3d.geometry.hulls import hull
from scan3d.reconstruction.contacts import contacts
from scan3d.surfaces import certificate, choice, enclosure, surface
from scan3d.surfaces.choice import error_of_surface, hold_out


@pytest.fixture(scope="module")
def box():
    mesh = rotated(trimesh.creation.box((40, 30, 50)))
    return mesh, scanned(mesh, spacing="cosine")


@pytest.fixture(scope="module")
def ball():
    # fine enough that 24 slices, and not the facets, limit the scan
    mesh = trimesh.creation.icosphere(6, 20.0)
    return mesh, scanned(mesh)


@pytest.mark.slow
def test_a_polyhedron_between_its_slices_is_recognised_by_its_facets(box, monkeypatch):
    mesh, cloud = box
    estimate = surface(cloud)
    assert estimate.metadata["method"] == "bracket"
    assert "a polyhedron of 6 facets" in estimate.metadata["reason"]
    assert scan3d.compare(estimate, mesh).relative < 1e-12
    monkeypatch.setattr("scan3d.surfaces.between.facets", lambda _: np.empty((0, 4)))
    by_turns = surface(cloud)
    assert "to the corners of the outer body: held-out slices lie within" in by_turns.metadata["reason"]
    # what remains is largest two slices from the ends, where three on one side would be needed
    assert scan3d.compare(by_turns, mesh).relative < 1e-3
    assert scan3d.compare(surface(cloud, "hull"), mesh).relative > 1e-2
    assert estimate.is_watertight


@pytest.mark.slow
def test_a_smooth_body_is_fitted(ball):
    mesh, cloud = ball
    fitted = surface(cloud)
    assert fitted.metadata["method"] == "support"
    assert "degree" in fitted.metadata["reason"]
    assert scan3d.compare(fitted, mesh).relative < 1e-4


@pytest.mark.slow
def test_the_estimate_between_the_bounds_is_closer_to_a_smooth_body_than_its_hull(ball):
    mesh, cloud = ball
    bounds = enclosure(cloud)
    estimate = surface(cloud, "bracket", bounds=bounds)
    assert estimate.metadata["method"] == "bracket"
    distance, distance_of_hull = (scan3d.compare(shape, mesh).hausdorff for shape in (estimate, bounds.inner))
    assert distance < 0.8 * distance_of_hull
    assert distance <= certificate(bounds, estimate).bound <= bounds.bound


@pytest.mark.slow
def test_a_proven_hull_is_taken_without_an_estimate():
    cloud = scanned(trimesh.creation.box((40, 30, 50)), spacing="adaptive", slices=40)
    proven = surface(cloud)
    assert proven.metadata["method"] == "hull"
    assert "proven" in proven.metadata["reason"]


@pytest.mark.slow
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


@pytest.mark.slow
def test_without_empty_slices_there_is_still_a_surface(box):
    """Nothing bounds the ends then: the surface ends where the contacts do."""
    _, cloud = box
    filled = np.unique(cloud.slice)
    without_empty_slices = replace(
        cloud,
        slice=np.searchsorted(filled, cloud.slice).astype(np.int32),
        slice_axis=cloud.slice_axis[filled],
        slice_height=cloud.slice_height[filled],
    )
    estimate = surface(without_empty_slices)
    assert estimate.metadata["method"] == "bracket"
    assert np.isfinite(estimate.vertices).all()


@pytest.mark.slow
def test_under_noise_a_smooth_body_is_still_fitted():
    mesh = trimesh.creation.icosphere(5, 20.0)
    cloud = scanned(mesh, noise=1e-3)
    fitted = surface(cloud)
    assert fitted.metadata["method"] == "support"
    distance, distance_of_hull = (scan3d.compare(shape, mesh).hausdorff for shape in (fitted, surface(cloud, "hull")))
    assert distance < 0.5 * distance_of_hull


@pytest.mark.open3d
@pytest.mark.parametrize(
    "method",
    [pytest.param("poisson", marks=pytest.mark.slow), pytest.param("ball-pivoting", marks=pytest.mark.trust)],
)
def test_the_certificate_holds_for_surfaces_that_are_not_convex(ball, method):
    mesh, cloud = ball
    bounds = enclosure(cloud)
    made = surface(cloud, method)
    assert made.metadata["method"] == method
    bound, at_vertices, _ = certificate(bounds, made)
    assert bound >= scan3d.compare(made, mesh).upper
    assert bound < 0.05 * 40
    assert at_vertices.shape == (len(made.vertices),)
    assert (at_vertices >= bounds.bound).all()


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("cylinder.off", marks=pytest.mark.slow),
        pytest.param("hexagonal_prism.obj", marks=pytest.mark.trust),
    ],
)
def test_three_axes_close_flat_ends_that_one_axis_never_touches(name):
    """Slices across the flat ends lie in them: three times the slices along the axis can only enclose them."""
    mesh = scan3d.load_mesh(MESHES / name)
    top = mesh.vertices[:, 2].max()
    along_z, along_xyz = (
        scanned(mesh, slices=slices, axis=axis, samples=32, spacing="uniform")
        for slices, axis in ((36, "z"), (12, "xyz"))
    )
    assert top - hull(along_xyz.points).vertices[:, 2].max() < 1e-9
    assert top - hull(along_z.points).vertices[:, 2].max() > 0.1
    assert enclosure(along_xyz).bound < enclosure(along_z).bound
    distance = scan3d.compare(surface(along_xyz), mesh).hausdorff
    assert distance < scan3d.compare(hull(along_z.points), mesh).hausdorff / 3


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


def test_an_unknown_method_and_contacts_in_one_plane_are_refused():
    cloud = contacts(scan3d.simulate(trimesh.creation.box((20, 30, 40)), scan3d.Plan(slices=1, samples=16)))
    with pytest.raises(scan3d.InputError, match="method must be one of"):
        surface(cloud, "magic")
    with pytest.raises(scan3d.InputError, match="span no body"):
        surface(cloud, "hull")


@pytest.mark.slow
def test_the_estimate_with_the_least_expected_error_is_close_to_the_best(box, monkeypatch):
    mesh, cloud = box
    monkeypatch.setattr("scan3d.surfaces.between.facets", lambda _: np.empty((0, 4)))  # on which all contacts lie
    kept, held_out = hold_out(cloud)
    (of_kept, part), (estimates, whole) = choice._estimates(kept, None, False), choice._estimates(cloud, None, False)
    falls = choice._falls(part, whole, held_out)
    assert 0 <= falls.min() < falls.max() <= 1
    expected = {name: error_of_surface(make(), held_out, falls).expected for name, make in of_kept.items()}
    true = {name: scan3d.compare(make(), mesh).hausdorff for name, make in estimates.items()}
    assert true[min(expected, key=expected.get)] <= 1.2 * min(true.values())


# --- what is held out, and the errors there ---


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
