"""Surfaces between the bounds, and the choice among the methods."""

import dataclasses

import numpy as np
import pytest
import trimesh
from sample_bodies import MESHES, rotated, scanned

import scan3d
from scan3d.geometry.distance import signed_distances
from scan3d.geometry.hulls import hull
from scan3d.reconstruction.contacts import contacts
from scan3d.surfaces import certificate, choice, enclosure, surface
from scan3d.surfaces.between import Edges, Tuning
from scan3d.surfaces.cross_validation import HeldOutError


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
def test_a_polyhedron_between_its_slices_is_recognised_by_its_planes(box):
    mesh, cloud = box
    estimate = surface(cloud)
    assert estimate.metadata["method"] == "bracket"
    assert "polyhedron" in estimate.metadata["reason"]
    # what remains is largest two slices from the ends, where three on one side would be needed
    assert scan3d.compare(estimate, mesh).relative < 1e-3
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


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.trust) for seed in range(1, 8))])
def test_the_estimate_lies_between_the_bounds(seed):
    """Whatever the body: no point lies outside the outer body, and the certificate holds."""
    rng = np.random.default_rng(seed)
    mesh = hull(20 * rng.normal(size=(int(rng.integers(8, 60)), 3)))
    cloud = scanned(mesh, slices=12, samples=32)
    bounds = enclosure(cloud)
    estimate = surface(cloud, "bracket", bounds=bounds)
    outer = hull(bounds.corners)
    assert signed_distances(estimate.vertices, outer).max() < 1e-9 * bounds.bound + 1e-12
    assert signed_distances(bounds.inner.vertices, estimate).max() < 1e-9 * bounds.bound + 1e-12
    assert certificate(bounds, estimate).bound >= scan3d.compare(estimate, mesh).hausdorff * (1 - 1e-9)


@pytest.mark.slow
def test_without_empty_slices_there_is_still_a_surface(box):
    """Nothing bounds the ends then: the surface ends where the contacts do."""
    _, cloud = box
    filled = np.unique(cloud.slice)
    without_empty_slices = dataclasses.replace(
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
    bound, at_vertices = certificate(bounds, made)
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


def test_where_no_planes_can_be_fitted_the_other_estimates_are_compared(monkeypatch):
    def fitted(_):
        raise scan3d.InputError("the 0 contacts span no body")

    cloud = scanned(trimesh.creation.box((20, 30, 40)), slices=12, noise=1e-3)
    assert surface(cloud).metadata["method"] == "regression"
    monkeypatch.setattr(choice, "regression", fitted)
    made = surface(cloud)
    assert made.metadata["method"] in ("bracket", "support")
    assert made.is_watertight


def test_an_unknown_method_and_contacts_in_one_plane_are_refused():
    cloud = contacts(scan3d.simulate(trimesh.creation.box((20, 30, 40)), scan3d.Plan(slices=1, samples=16)))
    with pytest.raises(scan3d.InputError, match="method must be one of"):
        surface(cloud, "magic")
    with pytest.raises(scan3d.InputError, match="span no body"):
        surface(cloud, "hull")


def test_the_choice_follows_the_cross_validation(box, monkeypatch):
    _, cloud = box
    equal = dict.fromkeys(Edges, HeldOutError(1.0, 1.0))
    for best, description in choice._DESCRIPTIONS.items():
        errors = choice._CrossValidation({**equal, best: HeldOutError(0.5, 0.5)}, None)
        monkeypatch.setattr(choice, "_cross_validate", lambda *_, errors=errors, **__: errors)
        assert description in surface(cloud).metadata["reason"]


def test_a_fit_that_is_better_than_a_smooth_body_s_estimate_is_compared_with_no_others():
    cloud = scanned(trimesh.creation.icosphere(4, 20.0), slices=12, samples=32)
    alone = choice._cross_validate(cloud, Tuning(), 0.0, with_fit=True, by_cells=False)
    assert set(alone.estimates) == {Edges.ROUND}
    # where the fit does not win, all are compared, with the same errors
    lost = choice._cross_validate(cloud, Tuning(fit_gain=0.0), 0.0, with_fit=True, by_cells=False)
    assert set(lost.estimates) == set(Edges)
    assert (lost.estimates[Edges.ROUND], lost.fit) == (alone.estimates[Edges.ROUND], alone.fit)
    assert min(lost.estimates, key=lambda edges: lost.estimates[edges].score(0.0)) is Edges.ROUND


# --- the numbers of the estimate ---


@pytest.fixture(scope="module")
def bodies():
    """Cloud and enclosure of a box, a ball and a cylinder, with 12 slices each."""
    meshes = {
        "box": rotated(trimesh.creation.box((40, 30, 50))),
        "ball": trimesh.creation.icosphere(4, 20.0),
        "cylinder": rotated(trimesh.creation.cylinder(radius=15, height=40, sections=48)),
    }
    clouds = {name: scanned(mesh, slices=12, samples=32) for name, mesh in meshes.items()}
    return {name: (cloud, enclosure(cloud)) for name, cloud in clouds.items()}


ALWAYS_SHARP, NEVER_SHARP = {"sharp_advantage": 1e3}, {"sharp_advantage": 1e-3}


@pytest.mark.parametrize(
    ("field", "value", "body", "others", "method"),
    [
        ("unknown", 0.6, "cylinder", {}, "bracket"),
        ("damping", 0.3, "cylinder", {}, "bracket"),
        ("unseen_corners", 0.6, "cylinder", ALWAYS_SHARP, "bracket"),
        ("straight", 0.3, "cylinder", {}, "bracket"),
        ("parabola", 0.4, "cylinder", {}, "bracket"),
        ("crease", 0.5, "box", NEVER_SHARP, "bracket"),
        ("sharp_advantage", 1e-3, "box", {}, "bracket"),
        ("round_advantage", 1e-3, "ball", {}, "bracket"),
        ("flat_advantage", 1e3, "cylinder", {}, "bracket"),
        ("fit_gain", 0.0, "ball", {"fit_close": 0.0}, "auto"),
        ("fit_close", 0.1, "ball", {"fit_close": 0.0, "fit_gain": 0.0}, "auto"),
        ("proven", 1.0, "box", {}, "auto"),
    ],
)
@pytest.mark.slow
def test_every_number_of_the_tuning_reaches_the_surface_and_none_the_enclosure(
    bodies, field, value, body, others, method
):
    cloud, bounds = bodies[body]
    tuning = Tuning(**others)
    before = surface(cloud, method, tuning=tuning)
    after = surface(cloud, method, tuning=dataclasses.replace(tuning, **{field: value}))
    assert not np.array_equal(before.vertices, after.vertices)
    again = enclosure(cloud)
    assert again.bound == bounds.bound
    np.testing.assert_array_equal(again.corners, bounds.corners)
    # the certificate of either surface holds with the same enclosure
    inner = certificate(again, again.inner).bound
    assert inner == certificate(bounds, bounds.inner).bound == pytest.approx(bounds.bound, rel=1e-9)


def test_every_number_of_the_tuning_is_tested():
    marks = test_every_number_of_the_tuning_reaches_the_surface_and_none_the_enclosure.pytestmark
    (cases,) = (mark.args[1] for mark in marks if mark.name == "parametrize")
    assert [field for field, *_ in cases] == [field.name for field in dataclasses.fields(Tuning)]
