"""The certificate: the bound from touch alone is never below the true distance, which `compare` computes with the truth."""

import dataclasses

import numpy as np
import pytest
import trimesh
from sample_bodies import convex_hausdorff, random_body, scanned
from slices_by_hand import stack_of_rectangles

import planar
import scan3d
from scan3d.bounds import certificates
from scan3d.bounds.enclosures import _bounded_by_others
from scan3d.bounds.slabs import Slab, slabs
from scan3d.geometry.distance import distances, nearest, signed_distances
from scan3d.geometry.hulls import hull
from scan3d.geometry.sections import slice_frame
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.slices import stacks
from scan3d.surfaces import Gap, certificate, enclosure, surface
from tests.sample_bodies import outside


@pytest.mark.parametrize(
    "block", [pytest.param(block, marks=pytest.mark.slow if block < 5 else pytest.mark.trust) for block in range(24)]
)
def test_the_bound_is_never_below_the_true_distance(block):
    """240 bodies, most with few slices: the hull's bound, that of the surface between the bounds, and the volume's.

    The first 50 have every combination of the spacings and numbers of slices; the others are for `make trust`.
    """
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
@pytest.mark.slow
def test_the_certificate_holds_for_any_convex_surface(seed):
    mesh = random_body(seed)
    bounds = enclosure(contacts(scan3d.simulate(mesh, scan3d.Plan(slices=16, friction=(0.0, 0.4)))))
    larger = trimesh.Trimesh(bounds.inner.vertices * 1.01, bounds.inner.faces, process=False)
    bound, at_vertices = certificate(bounds, larger)
    assert bound >= scan3d.compare(larger, mesh).hausdorff
    assert at_vertices.shape == (len(larger.vertices),)
    assert at_vertices.max() <= bound
    assert (np.abs(nearest(np.asarray(larger.vertices), mesh)[0]) <= at_vertices).all()


@pytest.mark.slow
def test_adaptive_slices_find_the_corners_of_an_oblique_cube():
    """Cosine spacing leaves 5e-3 of the diagonal there; a slice at a vertex's own height closes the gap at once."""
    mesh = trimesh.creation.box((40, 40, 40))
    mesh.apply_transform(trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.6, 0.8])))
    plan = scan3d.Plan(slices=64, spacing="adaptive", friction=(0.0, 0.4))
    cloud = contacts(scan3d.simulate(mesh, plan))
    assert len(cloud.slice_height) <= 64 + 2  # those beyond the ends
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
@pytest.mark.slow
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


@pytest.mark.slow
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
@pytest.mark.slow
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
    end = HALF @ np.abs(bounds.slabs.stack.frame[2])
    assert (bounds.slabs.stack.floor, bounds.slabs.stack.ceiling) == pytest.approx((-end, end))
    assert bounds.slabs.stack.bounded_by_others == (True, True)
    assert np.abs(bounds.corners).max(axis=0) == pytest.approx(HALF)
    assert bounds.volume[1] == pytest.approx(BOX.volume)


@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_the_certificate_of_the_inner_body_is_its_bound(box_cloud, margin):
    bounds = enclosure(box_cloud, margin)
    bound, local = certificate(bounds, bounds.inner)
    assert bounds.bound == pytest.approx(outside(bounds.corners, bounds.inner).max() + margin)
    assert bound == pytest.approx(bounds.bound)
    # the local bound is wide at the vertices next to the farthest corner
    assert bound / 2 < local.max() <= bound
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


# --- several stacks ---


def slab_between(low, high, axis=2):
    """A slab whose corners lie at two heights along an axis of the world."""
    corners = np.zeros((2, 3))
    corners[:, axis] = low, high
    return Slab(corners, np.zeros(2, dtype=np.int8), np.zeros((2, 2), dtype=bool), 1.0)


UNBOUNDED = Slab(np.full((1, 3), np.inf), np.zeros(1, dtype=np.int8), np.zeros((1, 2), dtype=bool), np.inf)


@pytest.mark.parametrize(
    ("others", "floor", "ceiling", "flags"),
    [
        ([(-5.0, 8.0)], -5.0, 8.0, (True, True)),
        ([(-12.0, 8.0)], -10.0, 8.0, (False, True)),
        ([(-5.0, 12.0)], -5.0, 10.0, (True, False)),
        ([(-10.0, 10.0)], -10.0, 10.0, (False, False)),  # no tighter than the empty slices
        ([(-12.0, 12.0)], -10.0, 10.0, (False, False)),
        ([(-5.0, 12.0), (-7.0, 9.0)], -5.0, 9.0, (True, True)),
        ([(-7.0, 8.0), (-5.0, 9.0)], -5.0, 8.0, (True, True)),
        # never closer than the slices, which have contacts
        ([(-0.5, 0.5)], -1.0, 1.0, (True, True)),
        ([None], -10.0, 10.0, (False, False)),
        ([None, (-5.0, 12.0)], -5.0, 10.0, (True, False)),
    ],
)
def test_the_tightest_of_the_other_stacks_bounds_the_ends(others, floor, ceiling, flags):
    stack = stack_of_rectangles([-1.0, 1.0], [2.0, 2.0], -10.0, 10.0)
    # what is unbounded past its end slices bounds nothing, although the slab between the slices is finite
    outer = [[UNBOUNDED, slab_between(-0.2, 0.2)] if other is None else [slab_between(*other)] for other in others]
    for k in range(len(others) + 1):
        # the stack's own slabs, which are tighter still, bound nothing
        by_axis = [stack if j == k else None for j in range(len(others) + 1)]
        bounded = _bounded_by_others(k, by_axis, [*outer[:k], [slab_between(-0.1, 0.1)], *outer[k:]])
        assert (bounded.floor, bounded.ceiling) == (floor, ceiling)
        assert bounded.bounded_by_others == flags
        assert bounded.slices is stack.slices


def test_the_other_stacks_bound_a_stack_along_its_own_axis():
    frame = slice_frame(np.array([1.0, 0.0, 0.0]))
    stack = stack_of_rectangles([-1.0, 1.0], [2.0, 2.0], frame=frame)
    bounded = _bounded_by_others(0, [stack, None], [[UNBOUNDED], [slab_between(-3.0, 4.0, axis=0)]])
    assert (bounded.floor, bounded.ceiling) == (-3.0, 4.0)
    assert bounded.bounded_by_others == (True, True)


@pytest.mark.parametrize("axes", ["xy", "xyz"])
@pytest.mark.parametrize("margin", [0.0, 0.3])
@pytest.mark.slow
def test_of_several_stacks_the_one_with_the_smallest_bound_is_used(margin, axes):
    mesh = trimesh.creation.icosphere(2, 20.0)
    mesh.apply_scale((1.0, 0.6, 0.3))
    cloud = contacts(scan3d.simulate(mesh, scan3d.Plan(slices=6, axis=axes, samples=16, sweeps=6)))
    by_axis = stacks(cloud)
    outer = [slabs(stack, margin) for stack in by_axis]
    candidates = []
    for k in range(len(axes)):
        stack = _bounded_by_others(k, by_axis, outer)
        corners = np.concatenate([slab.corners for slab in slabs(stack, margin)])
        candidates.append((outside(corners, hull(cloud.points)).max() + margin, stack))
    smallest, stack = min(candidates, key=lambda candidate: candidate[0])
    assert len({round(bound, 9) for bound, _ in candidates}) == len(axes)
    bounds = enclosure(cloud, margin)
    assert bounds.bound == pytest.approx(smallest, rel=1e-12)
    assert (bounds.slabs.stack.frame == stack.frame).all()
    assert (bounds.slabs.stack.floor, bounds.slabs.stack.ceiling) == (stack.floor, stack.ceiling)


@pytest.mark.parametrize("margin", [0.01, 0.3])
@pytest.mark.slow
def test_a_margin_moves_the_ends_that_other_stacks_bound(margin):
    """A box that is larger than the contacts show by the margin is still inside."""
    plan = scan3d.Plan(slices=6, axis="xyz", spacing="cosine", samples=32)
    bounds = enclosure(contacts(scan3d.simulate(BOX, plan)), margin)
    end = HALF @ np.abs(bounds.slabs.stack.frame[2])
    assert bounds.slabs.stack.floor <= -end - margin * (1 - 1e-9)
    assert bounds.slabs.stack.ceiling >= end + margin * (1 - 1e-9)
    assert (np.abs(bounds.corners).max(axis=0) >= HALF + margin * (1 - 1e-9)).all()
    # once for the contacts, twice for the inclination over half a spacing, and once more for that of the other stacks
    assert (np.abs(bounds.corners).max(axis=0) <= HALF + 4.01 * margin).all()


def test_oblique_slices_enclose_the_body():
    """The corners of the slabs are given in the world, whatever the slices' axis."""
    mesh = trimesh.creation.box(2 * HALF)
    for axis in ((1.0, 2.0, 3.0), (-2.0, 1.0, 0.5)):
        bounds = enclosure(contacts(scan3d.simulate(mesh, scan3d.Plan(slices=12, axis=axis, samples=32))))
        assert signed_distances(mesh.vertices, hull(bounds.corners)).max() < 1e-9
        assert bounds.bound >= scan3d.compare(bounds.inner, mesh).hausdorff - 1e-9
        assert bounds.bound < 5.0
        assert bounds.volume[0] <= mesh.volume <= bounds.volume[1] * (1 + 1e-9)


def test_nothing_bounds_a_body_touched_from_one_side():
    cloud = contacts(scan3d.simulate(trimesh.creation.icosphere(2, 20.0), scan3d.Plan(slices=4, sweeps=1)))
    bounds = enclosure(cloud)
    assert bounds.bound == np.inf
    assert bounds.volume[1] == np.inf


def test_the_part_of_a_kind_without_corners_is_zero(box_cloud):
    bounds = dataclasses.replace(
        enclosure(box_cloud), kind=np.full(3, Gap.CAPS, dtype=np.int8), gap=np.array([1.0, 3, 2])
    )
    assert bounds.part(Gap.CAPS) == 3.0
    assert bounds.part(Gap.SLICES) == 0.0


@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_a_surface_that_is_not_convex_is_compared_with_the_inner_body(box_cloud, margin):
    """The inner body with the middle of a face pushed in: the distance to the inner body is added to the bound of that."""
    bounds = enclosure(box_cloud, margin)
    dented = bounds.inner.subdivide()
    vertices = np.asarray(dented.vertices).copy()
    outer_face = np.abs(np.abs(vertices[:, 0]) - HALF[0]) < 1e-9
    middle = np.flatnonzero(outer_face)[np.abs(vertices[outer_face, 1:]).sum(axis=1).argmin()]
    vertices[middle, 0] *= 0.5
    dented = trimesh.Trimesh(vertices, dented.faces, process=False)
    distance = scan3d.compare(dented, bounds.inner)
    bound, at_vertices = certificate(bounds, dented)
    assert distance.upper > 1.0
    assert bound == pytest.approx(distance.upper + bounds.bound, rel=1e-12)
    assert at_vertices == pytest.approx(np.abs(distances(vertices, bounds.inner)) + bounds.bound)


def test_the_distance_outside_a_convex_body_is_zero_inside():
    points = np.array([(0.0, 0.0, 0.0), (9.9, 0.0, 0.0), (10.1, 0.0, 0.0), (13.0, 19.0, 0.0), (0.0, 0.0, -20.5)])
    assert outside(points, BOX) == pytest.approx([0.0, 0.0, 0.1, 5.0, 0.5])


@pytest.mark.parametrize("at_once", [1, 7, 10**6])
@pytest.mark.parametrize("scale", [0.9, 0.999, 1.0, 1.003, 1.5])
@pytest.mark.parametrize("axis", ["z", "xyz"])
def test_corners_that_are_not_measured_are_no_farther(axis, scale, at_once, monkeypatch):
    """Smaller and larger bodies, moved by more than some of the gaps, against the distances of all corners."""
    monkeypatch.setattr(certificates, "_CORNERS_AT_ONCE", at_once)
    cloud = scanned(trimesh.creation.icosphere(2, 20.0), slices=7, samples=12, axis=axis)
    bounds = enclosure(cloud)
    moved = hull(scale * bounds.inner.vertices.view(np.ndarray) + [0.0, 0.3, 0.1])
    outwards = outside(np.asarray(moved.vertices), bounds.inner).max()
    by_slabs = max(outwards, outside(bounds.corners, moved).max())
    by_others = np.inf if bounds.tighter is None else max(outwards, outside(bounds.tighter.corners, moved).max())
    assert (bounds.tighter is None) == (axis == "z")
    assert certificate(bounds, moved).bound == pytest.approx(min(by_slabs, by_others), rel=1e-10)


@pytest.mark.parametrize(("depth", "convex"), [(0.0, True), (2e-9, True), (1e-6, False)])
def test_a_surface_is_convex_to_rounding_relative_to_its_diagonal(box_cloud, depth, convex):
    """A surface twice as large as the inner body, one vertex of which is pushed into a face."""
    bounds = enclosure(box_cloud)
    larger = bounds.inner.subdivide()
    vertices = 2 * np.asarray(larger.vertices)
    on_face = np.flatnonzero(np.abs(vertices[:, 0] - 2 * HALF[0]) < 1e-9)
    vertices[on_face[np.abs(vertices[on_face, 1:]).sum(axis=1).argmin()], 0] -= depth
    surface = trimesh.Trimesh(vertices, larger.faces, process=False)
    by_vertices = outside(vertices, bounds.inner).max()
    expected = by_vertices if convex else by_vertices + bounds.bound
    assert bounds.bound > 0.1
    assert certificate(bounds, surface).bound == pytest.approx(expected, rel=2e-3 if not convex else 1e-6)


def test_where_nothing_bounds_the_body_the_local_bound_is_infinite_and_never_nan():
    # one sweep for each slice sees one side only, so that no slab is closed
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=20)
    cloud = scan3d.reconstruct(scan3d.simulate(mesh, scan3d.Plan(slices=4, sweeps=1)))
    certified = certificate(enclosure(cloud), hull(cloud.points))
    assert certified.bound == np.inf
    assert (certified.at_vertices == np.inf).all()
    # without the empty slices nothing bounds the caps, while the slabs between the slices are closed
    cloud = scan3d.reconstruct(scan3d.simulate(mesh, scan3d.Plan(slices=6)))
    filled = np.unique(cloud.slice)
    number = np.full(len(cloud.slice_height), -1, dtype=np.int32)
    number[filled] = np.arange(len(filled))
    open_ended = dataclasses.replace(
        cloud,
        slice=number[cloud.slice],
        slice_axis=cloud.slice_axis[filled],
        slice_height=cloud.slice_height[filled],
    )
    body = hull(cloud.points)
    certified = certificate(enclosure(open_ended), body)
    assert certified.bound == np.inf
    heights = body.vertices[:, 2]
    at_ends = np.isclose(heights, heights.min()) | np.isclose(heights, heights.max())
    assert (certified.at_vertices[at_ends] == np.inf).all()
    assert np.isfinite(certified.at_vertices[~at_ends]).all()
