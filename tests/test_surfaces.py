"""Surfaces between the bounds, the choice among the methods, and what slices left out say of them."""

import dataclasses
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh

import scan3d
from scan3d import surfaces
from scan3d.between import _contour, contours_between, shares
from scan3d.bracket import bracket, certificate
from scan3d.comparison import nearest
from scan3d.evidence import of_fit, of_surface, thinned
from scan3d.hulls import hull
from scan3d.layers import Layer, Layers
from scan3d.surfaces import surface

FOLDER = Path(__file__).parents[1] / "meshes"


def turned(mesh, seed=1):
    matrix = trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).uniform(size=3))
    mesh.apply_transform(matrix)
    return mesh


def scanned(mesh, **plan):
    return scan3d.reconstruct(scan3d.simulate(mesh, scan3d.Plan(**{"slices": 24, "friction": (0.0, 0.4), **plan})))


@pytest.fixture(scope="module")
def box():
    mesh = turned(trimesh.creation.box((40, 30, 50)))
    return mesh, scanned(mesh)


@pytest.fixture(scope="module")
def ball():
    # fine enough that 24 slices, and not the facets, limit the scan
    mesh = trimesh.creation.icosphere(6, 20.0)
    return mesh, scanned(mesh)


# --- where between the bounds the body is ---


def stack_of(heights, support):
    """Layers whose support function is `support(angle, height)`, known at 36 angles."""
    angle = 2 * np.pi * np.arange(36) / 36 - np.pi
    normals, tangents = (
        np.stack([np.cos(angle), np.sin(angle)], axis=1),
        np.stack([-np.sin(angle), np.cos(angle)], axis=1),
    )
    layers = []
    for z in heights:
        h = support(angle, z)
        slope = np.zeros(36)
        points = h[:, None] * normals + slope[:, None] * tangents
        rows = np.arange(36)
        corner = np.stack([points, points], axis=1)
        none = rows[:0], normals[:0]
        layers.append(Layer(z, rows, points, rows, normals, *none, points, angle, h, np.stack([slope, slope]), corner))
    return Layers(np.eye(3), tuple(layers), heights[0] - 1, heights[-1] + 1)


def share_at(profile, heights, z, flat, kink=1.0):
    """The share at a round body with the radius `profile(z)`, in the slab of the height z."""
    stack = stack_of(np.array(heights, dtype=float), lambda angle, z: np.full(len(angle), profile(z)))
    slab = np.searchsorted(heights, [z])
    return float(shares(stack, np.array([[0.1, 0.0, 0.0]]), slab, np.array([flat]), kink)[0])


def test_a_parabola_runs_a_quarter_of_the_way():
    """Evenly sliced: chord's height c d²/8, secants' apex 4 times that; the guess is drawn towards the middle by its doubt."""
    found = share_at(lambda z: 10 - z * z, [-3, -2, -1, 0, 1, 2, 3], 0.5, (False, False), kink=0.75)
    assert found == pytest.approx(0.4 * 0.25 + 0.6 * 0.5)


def test_a_cone_on_a_cone_reaches_the_corner():
    kinked = [-3, -2, -1, 1, 2, 3], 0.0, (True, True)
    assert share_at(lambda z: 10 - abs(z), *kinked) == 1.0
    assert share_at(lambda z: 10 - abs(z), *kinked, kink=0.75) == 0.75


def test_an_arc_at_a_flat_part_hugs_the_corner():
    """A cylinder that goes over into a paraboloid: the later in the slab, the nearer it comes to the corner."""
    early, late = (
        share_at(lambda z, start=start: 10 - max(0.0, z - start) ** 2, range(-2, 4), 0.5, (True, False), kink=0.75)
        for start in (0.0, 0.7)
    )
    # its tangents' apex lies at 3/4 of the secants'; a parabola reaches half of it
    assert early == pytest.approx(0.4 * 0.375 + 0.6 * 0.5)
    assert 0.6 < late < 0.7
    # a polyhedron, straight on one side
    assert share_at(lambda z: 10 - max(0.0, z) ** 2, range(-2, 4), 0.5, (True, False), kink=1.0) == 1.0


def test_flat_between_slices_stays_with_the_hull_but_in_the_caps():
    stack = stack_of(np.arange(5.0), lambda angle, z: np.full(len(angle), 10.0))
    away, slab = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.5], [0.0, 0.0, -0.5]]), np.array([2, 5, 0])
    assert shares(stack, away, slab, np.zeros((3, 2), dtype=bool), None).tolist() == [0.0, 0.5, 0.5]


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
def test_between_slices_the_contours_are_the_bodys(profile, heights):
    """Where the guess's assumptions hold, the contours' narrowest radius, at their support lines, is the body's."""
    stack = stack_of(np.array(heights, dtype=float), lambda angle, z: np.full(len(angle), profile(z)))
    points = contours_between(stack)
    levels, member = np.unique(np.round(points[:, 2], 9), return_inverse=True)
    assert levels == pytest.approx([z + up * (after - z) for z, after in pairwise(heights) for up in (1 / 3, 2 / 3)])
    radius = np.hypot(points[:, 0], points[:, 1])
    for k, z in enumerate(levels):
        assert radius[member == k].min() == pytest.approx(profile(z), rel=1e-9)
        # not beyond the corners of 36 support lines
        assert radius[member == k].max() < profile(z) / np.cos(np.pi / 36)


def test_an_arc_that_begins_in_the_flat_part_is_followed_back():
    """A fifth of a step before the slice, which the slope of the slab there hardly shows."""

    def profile(z):
        return 10 - max(0.0, z + 0.2) ** 2

    points = contours_between(stack_of(np.arange(-3.0, 4.0), lambda angle, z: np.full(len(angle), profile(z))))
    for z in (1 / 3, 2 / 3):
        here = points[np.abs(points[:, 2] - z) < 1e-9]
        assert np.hypot(here[:, 0], here[:, 1]).min() == pytest.approx(profile(z), rel=1e-12)


def test_contours_that_are_none_are_left_out():
    angle = np.arange(4) * np.pi / 2
    assert _contour(angle, np.ones(4), np.zeros(2)).shape == (4, 2)
    # the point is outside; and what Qhull can't take
    assert _contour(angle, -np.ones(4), np.zeros(2)).shape == (0, 2)
    assert _contour(np.zeros(4), np.ones(4), np.zeros(2)).shape == (0, 2)


def test_the_vertices_of_a_polyhedron_lie_beyond_what_bends():
    """Where too few slices show the planes, a polyhedron's guess goes further out than that of a bent body."""
    bent, sharp = (share_at(lambda z: 10 - z * z, range(-3, 4), 0.5, (False, False), kink) for kink in (0.75, 1.0))
    assert sharp == pytest.approx(bent + 0.3 * (1 - bent))


# --- surfaces ---


def test_a_polyhedron_between_its_slices_is_found_by_its_planes(box):
    mesh, cloud = box
    found = surface(cloud)
    assert found.metadata["method"] == "bracket"
    assert "polyhedron" in found.metadata["reason"]
    # slices two from the ends, of which three would be needed on one side, leave most
    assert scan3d.compare(found, mesh).relative < 1e-3
    assert scan3d.compare(surface(cloud, "hull"), mesh).relative > 1e-2
    assert found.is_watertight


def test_a_smooth_body_is_fitted(ball):
    mesh, cloud = ball
    found = surface(cloud)
    assert found.metadata["method"] == "support"
    assert "degree" in found.metadata["reason"]
    assert scan3d.compare(found, mesh).relative < 1e-4


def test_between_the_bounds_a_smooth_body_is_nearer_than_its_hull(ball):
    mesh, cloud = ball
    found = bracket(cloud)
    between = surface(cloud, "bracket", found=found)
    assert between.metadata["method"] == "bracket"
    distance, hulls = (scan3d.compare(shape, mesh).hausdorff for shape in (between, found.inner))
    assert distance < 0.8 * hulls
    assert distance <= certificate(found, between)[0] <= found.bound


def test_a_hull_that_is_proven_needs_no_guess():
    cloud = scanned(trimesh.creation.box((40, 30, 50)), spacing="adaptive", slices=40)
    found = surface(cloud)
    assert found.metadata["method"] == "hull"
    assert "proven" in found.metadata["reason"]


@pytest.mark.parametrize("seed", range(8))
def test_between_the_bounds_is_between_the_bounds(seed):
    """Whatever the body: no point lies outside the outer body, and the certificate holds."""
    rng = np.random.default_rng(seed)
    mesh = hull(20 * rng.normal(size=(int(rng.integers(8, 60)), 3)))
    cloud = scanned(mesh, slices=12, samples=32)
    found = bracket(cloud)
    between = surface(cloud, "bracket", found=found)
    outer = hull(found.corners)
    assert nearest(between.vertices, outer)[0].max() < 1e-9 * found.bound + 1e-12
    assert nearest(found.inner.vertices, between)[0].max() < 1e-9 * found.bound + 1e-12
    assert certificate(found, between)[0] >= scan3d.compare(between, mesh).hausdorff * (1 - 1e-9)


def test_with_few_slices_the_guess_is_made_without_a_trial():
    cloud = scanned(trimesh.creation.icosphere(3, 20.0), slices=4, samples=16)
    assert thinned(cloud) is None
    assert "too few slices" in surface(cloud).metadata["reason"]


def test_without_empty_slices_there_is_still_a_surface(box):
    """Nothing bounds the ends then: the surface ends where the contacts do."""
    _, cloud = box
    filled = np.unique(cloud.slice)
    blind = dataclasses.replace(
        cloud,
        slice=np.searchsorted(filled, cloud.slice).astype(np.int32),
        slice_axis=cloud.slice_axis[filled],
        slice_height=cloud.slice_height[filled],
    )
    found = surface(blind)
    assert found.metadata["method"] == "bracket"
    assert np.isfinite(found.vertices).all()


def test_noise_leaves_the_smooth_bodys_fit():
    mesh = trimesh.creation.icosphere(5, 20.0)
    cloud = scanned(mesh, noise=1e-3)
    found = surface(cloud)
    assert found.metadata["method"] == "support"
    fitted, hulls = (scan3d.compare(shape, mesh).hausdorff for shape in (found, surface(cloud, "hull")))
    assert fitted < 0.5 * hulls


@pytest.mark.open3d
@pytest.mark.parametrize("method", ["poisson", "ball-pivoting"])
def test_the_certificate_holds_for_surfaces_that_are_not_convex(ball, method):
    mesh, cloud = ball
    found = bracket(cloud)
    made = surface(cloud, method)
    assert made.metadata["method"] == method
    bound, local = certificate(found, made)
    assert bound >= scan3d.compare(made, mesh).upper
    assert bound < 0.05 * 40
    assert local.shape == (len(made.vertices),)
    assert (local >= found.bound).all()


@pytest.mark.parametrize("name", ["cylinder.off", "hexagonal_prism.obj"])
def test_three_axes_close_flat_ends_that_one_axis_never_touches(name):
    """Slices across the flat ends lie in them: three times the slices along the axis can only bracket them."""
    mesh = scan3d.load_mesh(FOLDER / name)
    top = mesh.vertices[:, 2].max()
    one, three = (
        scanned(mesh, slices=slices, axis=axis, samples=32, spacing="uniform")
        for slices, axis in ((36, "z"), (12, "xyz"))
    )
    assert top - hull(three.points).vertices[:, 2].max() < 1e-9
    assert top - hull(one.points).vertices[:, 2].max() > 0.1
    assert bracket(three).bound < bracket(one).bound
    assert scan3d.compare(surface(three), mesh).hausdorff < scan3d.compare(hull(one.points), mesh).hausdorff / 3


@pytest.mark.parametrize(
    ("name", "seed"), [("cube.stl", 1), ("gem.glb", 4), ("cylinder.off", 4), ("rounded_box.glb", 2), ("capsule.stl", 2)]
)
def test_bodies_turned_any_way_with_64_adaptive_slices(name, seed):
    mesh = turned(scan3d.load_mesh(FOLDER / name), seed)
    cloud = scanned(mesh, slices=64, spacing="adaptive")
    found = bracket(cloud)
    made = surface(cloud, found=found)
    assert scan3d.compare(made, mesh).relative < 5e-4
    assert certificate(found, made)[0] < 2e-3 * np.linalg.norm(mesh.extents)


# --- evidence ---


def test_every_second_slice_is_left_out_but_the_ends(ball):
    _, cloud = ball
    rest, left_out = thinned(cloud)
    heights = np.sort(np.unique(cloud.slice_height[cloud.slice]))
    kept = np.sort(np.unique(rest.slice_height[rest.slice]))
    assert kept.tolist() == heights[::2].tolist() + ([] if len(heights) % 2 else [heights[-1]])
    assert len(rest) + len(left_out) == len(cloud)
    assert np.isin(left_out[:, 2].round(9), heights[1:-1:2].round(9)).all()
    assert np.allclose(rest.slice_height[rest.slice], rest.points[:, 2])
    # the empty slices stay: they bound the body
    assert len(rest.slice_height) == len(kept) + 2
    assert rest.fit is None


def test_evidence_is_the_distance_of_what_was_left_out():
    box = hull(trimesh.creation.box((2, 2, 2)).vertices)
    found = of_surface(box, np.array([[0.0, 0.0, 1.5], [0.0, 0.9, 0.0]]))
    assert found.largest == pytest.approx(0.5)
    assert found.rms == pytest.approx(np.sqrt((0.5**2 + 0.1**2) / 2))


def test_evidence_of_a_fit_has_no_facets(ball):
    _, cloud = ball
    directions = cloud.points[:100] / np.linalg.norm(cloud.points[:100], axis=1, keepdims=True)
    found = of_fit(cloud.fit, 20.5 * directions, directions)
    assert found.largest == pytest.approx(0.5, abs=2e-3)
    assert found.rms == pytest.approx(0.5, abs=2e-3)


def test_the_choice_follows_the_evidence(box, monkeypatch):
    _, cloud = box
    given = dict.fromkeys(surfaces._KINKS, surfaces.Evidence(1.0, 1.0))
    for best, word in surfaces._GUESSES.items():
        trial = {**given, best: surfaces.Evidence(0.5, 0.5)}
        monkeypatch.setattr(surfaces, "_trial", lambda *_, trial=trial, **__: trial)
        assert word in surface(cloud).metadata["reason"]
