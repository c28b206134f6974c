"""The certificate: the bound from touch alone is never below the true distance, which `compare` computes with the truth."""

import dataclasses

import numpy as np
import pytest
import trimesh
from sample_bodies import convex_hausdorff, random_body, scanned

import planar
import scan3d
from scan3d.geometry.hulls import hull
from scan3d.reconstruction.contacts import contacts
from scan3d.surfaces import Gap, certificate, enclosure, surface
from scan3d.surfaces.bounds import outside


@pytest.mark.parametrize("block", range(24))
def test_the_bound_is_never_below_the_true_distance(block):
    """240 bodies, most with few slices: the hull's bound, that of the surface between the bounds, and the volume's."""
    for seed in range(10 * block, 10 * block + 10):
        mesh = random_body(seed)
        plan = scan3d.Plan(
            slices=6 + seed % 7 if seed % 10 else 24,
            friction=(0.0, 0.4),
            spacing=("cosine", "uniform", "adaptive")[seed % 3],
            samples=16,
            sweeps=6,
        )
        cloud = contacts(scan3d.simulate(mesh, plan))
        bounds = enclosure(cloud)
        rounding = 1e-9 * np.linalg.norm(mesh.extents)
        assert np.isfinite(bounds.bound)
        assert bounds.bound >= convex_hausdorff(bounds.inner, mesh) - rounding
        assert bounds.volume[0] * (1 - 1e-9) <= mesh.volume <= bounds.volume[1] * (1 + 1e-9)
        assert bounds.bound == pytest.approx(max(bounds.part(gap) for gap in Gap), abs=rounding)
        if seed % 5 == 0:
            estimate = surface(cloud, "bracket", bounds=bounds)
            assert certificate(bounds, estimate).bound >= convex_hausdorff(estimate, mesh) - rounding


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_the_certificate_holds_for_any_convex_surface(seed):
    mesh = random_body(seed)
    bounds = enclosure(contacts(scan3d.simulate(mesh, scan3d.Plan(slices=16, friction=(0.0, 0.4)))))
    larger = trimesh.Trimesh(bounds.inner.vertices * 1.01, bounds.inner.faces, process=False)
    bound, at_vertices = certificate(bounds, larger)
    assert bound >= scan3d.compare(larger, mesh).hausdorff
    assert at_vertices.shape == (len(larger.vertices),)
    assert at_vertices.max() == pytest.approx(bound)


def test_adaptive_slices_find_the_corners_of_an_oblique_cube():
    """Cosine spacing leaves 5e-3 of the diagonal there; a slice at a vertex's own height closes the gap at once."""
    mesh = trimesh.creation.box((40, 40, 40))
    mesh.apply_transform(trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.6, 0.8])))
    plan = scan3d.Plan(slices=64, spacing="adaptive", friction=(0.0, 0.4))
    cloud = contacts(scan3d.simulate(mesh, plan))
    assert len(cloud.slice_height) <= 64
    assert scan3d.compare(hull(cloud.points), mesh).relative < 1e-5


def test_adaptive_slices_stop_at_the_tolerance():
    mesh = trimesh.creation.box((40, 40, 40))
    plan = scan3d.Plan(slices=64, spacing="adaptive", tolerance=1e-3)
    cloud = contacts(scan3d.simulate(mesh, plan))
    assert len(cloud.slice_height) < 40
    assert enclosure(cloud).bound <= 1e-3 * np.linalg.norm(mesh.extents)


def test_slices_along_several_axes_bound_each_others_ends():
    mesh = trimesh.creation.box((20, 30, 40))
    cloud = contacts(scan3d.simulate(mesh, scan3d.Plan(slices=6, axis="xyz", samples=32)))
    bounds = enclosure(cloud)
    assert np.isfinite(bounds.bound)
    assert bounds.bound >= scan3d.compare(bounds.inner, mesh).hausdorff - 1e-9


def test_the_certificate_does_not_rest_on_an_inferred_friction():
    """A wrong coefficient would make the bound wrong: the enclosure is that of the tangential contacts alone."""
    recording = scan3d.simulate(trimesh.creation.icosphere(3, 20.0), scan3d.Plan(slices=8, samples=16, friction=0.3))
    cloud = contacts(recording)
    tip = cloud.phase == planar.Phase.TIP
    assert np.isfinite(cloud.in_plane_normals[tip]).all()
    without_tip_normals = cloud.in_plane_normals.copy()
    without_tip_normals[tip] = np.nan
    assert enclosure(cloud).bound == enclosure(dataclasses.replace(cloud, in_plane_normals=without_tip_normals)).bound


# --- what decides whether a surface is certified as convex ---


@pytest.fixture(scope="module")
def ball():
    mesh = trimesh.creation.icosphere(4, 20.0)
    cloud = scanned(mesh, slices=12, samples=24)
    return mesh, cloud, enclosure(cloud)


def with_vertex_moved(hull_surface, distance):
    """The hull with the vertex farthest from its middle moved outwards by a distance, and marked as convex."""
    vertices = hull_surface.vertices.view(np.ndarray).copy()
    outward = vertices - vertices.mean(axis=0)
    farthest = np.linalg.norm(outward, axis=1).argmax()
    vertices[farthest] += distance * outward[farthest] / np.linalg.norm(outward[farthest])
    moved = trimesh.Trimesh(vertices, hull_surface.faces, process=False)
    moved.metadata["convex"] = True
    return moved


@pytest.mark.parametrize("fraction", [-0.1, -1e-3, -1e-5, 1e-5, 1e-3, 0.1])
def test_a_hull_with_a_vertex_moved_is_certified_by_its_shape(ball, fraction):
    """The mark on the mesh decides nothing: what is pushed in by 10 % of the diagonal used to be certified as convex."""
    mesh, cloud, bounds = ball
    convex = surface(cloud, "hull")
    moved = with_vertex_moved(convex, fraction * np.linalg.norm(np.ptp(convex.vertices, axis=0)))
    bound, at_vertices = certificate(bounds, moved)
    distance = scan3d.compare(moved, mesh)
    assert bound >= distance.upper * (1 - 1e-9)
    assert at_vertices.max() <= bound * (1 + 1e-9)
    if abs(fraction) == 0.1:
        assert distance.hausdorff > 0.05 * distance.diagonal
        assert bound < 0.2 * distance.diagonal


def test_an_open_hull_is_not_certified_as_convex(ball):
    """The hull without the faces above a height: nothing of the surface is near the removed part's pole."""
    mesh, cloud, bounds = ball
    closed = surface(cloud, "hull")
    open_surface = closed.submesh([np.flatnonzero(closed.triangles_center[:, 2] < 10.0)], append=True)
    open_surface.metadata["convex"] = True
    assert not open_surface.is_watertight
    distance = scan3d.compare(open_surface, mesh)
    assert distance.hausdorff > 5.0
    assert certificate(bounds, open_surface).bound >= distance.upper


@pytest.mark.parametrize("margin", [0.0, 0.05])
def test_the_certificate_of_a_hull_is_the_largest_distance_of_an_outer_corner(margin):
    """Against the distance of every outer corner from every face, in its plane, from its edges and from its vertices."""
    cloud = scanned(trimesh.creation.icosphere(3, 20.0), slices=7, samples=12, sweeps=6)
    bounds = enclosure(cloud, margin)
    convex = surface(cloud, "hull")
    triangles = convex.vertices.view(np.ndarray)[convex.faces]
    largest = max(point_to_triangles(corner, triangles) for corner in bounds.corners)
    assert certificate(bounds, convex).bound == pytest.approx(largest + margin, rel=1e-9)
    assert bounds.bound == pytest.approx(largest + margin, rel=1e-9)


def point_to_triangles(point, triangles):
    """Distance of a point (3,) outside a body from its surface's triangles (m, 3, 3): in planes, on edges, at corners."""
    a, b, c = triangles.swapaxes(0, 1)
    distances = [np.linalg.norm(triangles - point, axis=2).min()]
    for start, end in ((a, b), (b, c), (c, a)):
        along = end - start
        t = np.clip(((point - start) * along).sum(axis=1) / (along * along).sum(axis=1), 0, 1)
        distances.append(np.linalg.norm(start + t[:, None] * along - point, axis=1).min())
    normal = np.cross(b - a, c - a)
    foot = point - (((point - a) * normal).sum(axis=1) / (normal * normal).sum(axis=1))[:, None] * normal
    inside = np.ones(len(triangles), dtype=bool)
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(end - start, foot - start) * normal).sum(axis=1) >= 0
    distances.append(np.linalg.norm(foot - point, axis=1)[inside].min(initial=np.inf))
    return min(distances)


def test_a_hull_with_slivers_wound_the_wrong_way_is_certified_as_convex(ball):
    """Qhull winds triangles without area by rounding; such a hull is as closed as with them the right way round."""
    _, _, bounds = ball
    inner = bounds.inner
    faces = inner.faces.copy()
    faces[::50] = faces[::50, ::-1]
    turned = trimesh.Trimesh(inner.vertices, faces, process=False)
    assert certificate(bounds, turned).bound == pytest.approx(certificate(bounds, inner).bound, rel=1e-9)


# --- a box, whose outer body is known ---

HALF = np.array([10.0, 15.0, 20.0])
BOX = trimesh.creation.box(2 * HALF)


@pytest.fixture(scope="module")
def box_cloud():
    return contacts(scan3d.simulate(BOX, scan3d.Plan(slices=8, spacing="uniform")))


def test_other_axes_bound_the_ends_of_a_box_exactly():
    """The walls that slices along one axis touch are the ends along another axis."""
    bounds = enclosure(contacts(scan3d.simulate(BOX, scan3d.Plan(slices=6, axis="xyz", samples=32))))
    end = HALF @ np.abs(bounds.stack.frame[2])
    assert (bounds.stack.floor, bounds.stack.ceiling) == pytest.approx((-end, end))
    assert bounds.stack.bounded_by_others == (True, True)
    assert np.abs(bounds.corners).max(axis=0) == pytest.approx(HALF)
    assert bounds.volume[1] == pytest.approx(BOX.volume)


@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_the_certificate_of_the_inner_body_is_its_bound(box_cloud, margin):
    bounds = enclosure(box_cloud, margin)
    bound, local = certificate(bounds, bounds.inner)
    assert bounds.bound == pytest.approx(outside(bounds.corners, bounds.inner).max() + margin)
    assert bound == pytest.approx(bounds.bound)
    # the local bound is the largest next to the farthest corner
    assert local.max() == pytest.approx(bound)
    assert local.min() >= margin
    farthest = bounds.corners[bounds.gap.argmax()]
    near = np.linalg.norm(bounds.inner.vertices - farthest, axis=1) < 1.5 * bound
    assert local[near] == pytest.approx(np.full(near.sum(), bound), rel=0.2)


@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_the_certificate_of_a_larger_body_counts_its_vertices_outside(box_cloud, margin):
    """A hull twice as large: its vertices lie outside the inner body, and it contains all of the outer body."""
    bounds = enclosure(box_cloud, margin)
    larger = bounds.inner.copy()
    larger.vertices = 2 * np.asarray(bounds.inner.vertices)
    bound, local = certificate(bounds, larger)
    expected = outside(np.asarray(larger.vertices), bounds.inner) + margin
    assert local == pytest.approx(expected)
    assert bound == pytest.approx(expected.max())
