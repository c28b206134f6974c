"""What is certified by touch alone is true, against the true body: within a margin, of rounded poses, anywhere, on a table.

That of random scans in slices and in space is the subject of `tests.robustness.bounds`.
"""

import dataclasses
import functools

import numpy as np
import pytest
import trimesh
from sample_bodies import random_body, scanned
from scipy.spatial.transform import Rotation
from spatial_bodies import largest_difference, random_shape, spatial_cloud

import planar
import scan3d
from scan3d.bounds import bounding_nothing
from scan3d.geometry.distance import distances, signed_distances
from scan3d.geometry.hulls import hull
from scan3d.reconstruction.contacts import contacts
from scan3d.session import Session
from scan3d.simulation.rig import simulate_rig, standing
from scan3d.surfaces import Gap, certificate, enclosure, surface
from tests.robustness.bounds import DIRECTIONS, false_bounds, false_certificates

pytestmark = pytest.mark.slow

ROD = scan3d.Rod(0.06, 1.9e-4, 0.0003)


def check(cloud, body, margin=None):
    """All statements of an enclosure, and certificates of surfaces that are right, too large and moved."""
    bounds = enclosure(cloud, margin)
    more = [surface(cloud, "bracket", bounds=bounds)] if margin is None else []
    assert false_bounds(body, bounds) + false_certificates(body, bounds, *more) == []
    return bounds


def parts(count):
    """Seeds for all tests, and those for `make trust`."""
    return [seed if seed < count else pytest.param(seed, marks=pytest.mark.trust) for seed in range(60)]


@pytest.mark.parametrize("seed", parts(1))
@pytest.mark.parametrize("margin", [1e-3, 0.3])
def test_what_is_certified_of_contacts_within_a_margin_is_true(margin, seed):
    """Contacts that are off in their slices by no more than the margin; without errors the bound is not much wider."""
    body = random_body(seed)
    cloud = contacts(scan3d.simulate(body, scan3d.Plan(slices=8, samples=16)))
    off = np.random.default_rng(seed).normal(size=cloud.points.shape) * [1, 1, 0]
    off *= margin / np.linalg.norm(off, axis=1)[:, None]
    check(dataclasses.replace(cloud, points=cloud.points + off), body, margin)
    exact, wider = enclosure(cloud), enclosure(cloud, margin)
    assert margin <= wider.margin == margin
    assert exact.bound + 0.5 * margin < wider.bound < 2 * exact.bound + 20 * margin


@pytest.mark.parametrize("seed", parts(1))
@pytest.mark.parametrize("axis", ["z", "xyz"])
def test_what_is_certified_of_poses_with_few_digits_is_true(axis, seed):
    """Also of sharp and thin bodies: their bounds were false where a margin alone allowed for the digits."""
    body = hull(np.random.default_rng(seed).standard_normal((12, 3)) * [10, 10, 0.3])
    recording = scan3d.simulate(body, scan3d.Plan(slices=10, axis=axis, samples=16, sweeps=6))
    rounded = dataclasses.replace(recording, position_m=np.round(recording.position_m / 5e-6) * 5e-6)
    cloud = scan3d.reconstruct(rounded)
    bounds = check(cloud, body)
    assert bounds.slabs.stack.height_error >= cloud.pose_error > 4e-3


@pytest.mark.parametrize("noise", [0.0, 2e-3])
@pytest.mark.parametrize("seed", parts(4))
def test_what_is_certified_of_contacts_anywhere_is_true(seed, noise):
    """Of polyhedra and smooth bodies, with rods of different thickness; contacts are off by no more than is stated."""
    shape, radius = random_shape(seed)
    cloud = spatial_cloud(shape, (600, 400, 2000)[seed % 3], seed, radius)
    if noise:
        off = np.random.default_rng(seed).normal(size=cloud.points.shape)
        off *= noise / np.linalg.norm(off, axis=1)[:, None]
        cloud = dataclasses.replace(cloud, points=cloud.points + off, centre_points=cloud.centre_points + off)
    bounds = enclosure(cloud, noise or None)
    rounding = 1e-8 * shape.size
    lower, upper = bounds.support(DIRECTIONS)
    truth = shape.support(DIRECTIONS)
    assert ((lower <= truth + rounding) & (truth <= upper + rounding)).all()
    assert largest_difference(bounds.inner, shape) <= bounds.bound + rounding
    assert noise or np.isfinite(bounds.bound)
    assert set(bounds.parts()) == {"contacts", "rod"}
    made = [hull(factor * bounds.inner.vertices.view(np.ndarray)) for factor in (1.0, 1.02)]
    if not noise:
        made.append(surface(cloud, "bracket", bounds=bounds))
    for mesh in made:
        assert largest_difference(mesh, shape) <= certificate(bounds, mesh).bound + rounding


@functools.cache
def tilted(seed, turn):
    """A body on a table, and its recording by a clamp that is turned in its own frame by known angles in degrees."""
    body = standing(random_body(seed))
    poses = Session("cylinder:80x90", ROD, slices=7, samples=30).ask()
    planned = Rotation.from_quat(poses.quaternion, scalar_first=True)
    turned = planned * Rotation.from_euler("xyz", turn, degrees=True)
    position = poses.position_m.copy()
    for rows in poses.sweeps():  # each goes along the clamp's own x axis through the middle of the planned one
        middle = position[rows].mean(axis=0)
        position[rows] = middle + (turned[rows] * planned[rows].inv()).apply(position[rows] - middle)
    poses = dataclasses.replace(poses, position_m=position, quaternion=turned.as_quat(scalar_first=True))
    return body, simulate_rig(body, poses, model="planar", friction=(0.2, 0.2)).recording()


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.trust) for seed in (1, 2, 4, 5, 6))])
def test_what_is_certified_of_tilted_slices_on_a_table_is_true(seed):
    turn = (0.5, -0.4, 0.3)
    body, recording = tilted(seed, turn)
    cloud = scan3d.reconstruct(recording)
    assert cloud.tilt.slope == pytest.approx(np.hypot(*np.radians(turn[:2])), rel=0.05)
    bounds = check(cloud, body)
    assert bounds.slabs.stack.height_error >= cloud.tilt.spread
    _, level = tilted(seed, (0.0, 0.0, 0.0))
    assert scan3d.reconstruct(level).tilt is None


# --- how tight the bounds are ---


def test_the_certificate_does_not_rest_on_an_inferred_friction():
    """A wrong coefficient would make the bound wrong: the enclosure is that of the tangential contacts alone."""
    cloud = scanned(random_body(2), slices=12, samples=24)
    tip = cloud.phase == planar.Phase.TIP
    unknown = cloud.in_plane_normals.copy()
    unknown[tip] = np.nan
    assert enclosure(cloud).bound == enclosure(dataclasses.replace(cloud, in_plane_normals=unknown)).bound


# --- the certificate of a surface ---


@pytest.fixture(scope="module")
def ball():
    mesh = trimesh.creation.icosphere(4, 20.0)
    cloud = scanned(mesh, slices=12, samples=24)
    return mesh, cloud, enclosure(cloud)


@pytest.mark.parametrize("fraction", [-0.1, 1e-5])
def test_a_hull_with_a_vertex_moved_is_certified_by_its_shape(ball, fraction):
    """Nothing but the shape decides: what is pushed in by 10 % of the diagonal is not certified as convex."""
    mesh, cloud, bounds = ball
    convex = surface(cloud, "hull")
    vertices = convex.vertices.view(np.ndarray).copy()
    farthest = np.linalg.norm(vertices, axis=1).argmax()
    vertices[farthest] *= 1 + fraction * np.linalg.norm(convex.extents) / np.linalg.norm(vertices[farthest])
    moved = trimesh.Trimesh(vertices, convex.faces, process=False)
    bound, at_vertices, _ = certificate(bounds, moved)
    distance = scan3d.compare(moved, mesh)
    assert distance.upper * (1 - 1e-9) <= bound < 0.2 * distance.diagonal
    assert at_vertices.max() <= bound * (1 + 1e-9)


def test_surfaces_that_are_open_or_dented_are_compared_with_the_inner_body(ball):
    mesh, cloud, bounds = ball
    closed = surface(cloud, "hull")
    open_surface = closed.submesh([np.flatnonzero(closed.triangles_center[:, 2] < 10.0)], append=True)
    distance = scan3d.compare(open_surface, mesh)
    assert distance.hausdorff > 5.0
    assert certificate(bounds, open_surface).bound >= distance.upper
    dented = bounds.inner.copy()
    dented.vertices[0] *= 0.8
    bound, at_vertices, _ = certificate(bounds, dented)
    assert bound == pytest.approx(scan3d.compare(dented, bounds.inner).upper + bounds.bound, rel=1e-12)
    assert at_vertices == pytest.approx(distances(dented.vertices, bounds.inner) + bounds.bound)


@pytest.mark.open3d
@pytest.mark.parametrize(
    "method", [pytest.param("poisson", marks=pytest.mark.slow), pytest.param("ball-pivoting", marks=pytest.mark.trust)]
)
def test_the_certificate_holds_for_surfaces_that_are_not_convex(ball, method):
    mesh, cloud, bounds = ball
    made = surface(cloud, method)
    assert made.metadata["method"] == method
    bound, at_vertices, _ = certificate(bounds, made)
    assert bound >= scan3d.compare(made, mesh).upper
    assert bound < 0.05 * 40
    assert at_vertices.shape == (len(made.vertices),)
    assert (at_vertices >= bounds.bound).all()


@pytest.mark.parametrize("margin", [0.0, 0.05])
def test_the_certificate_is_the_largest_distance_of_a_corner_or_a_vertex(ball, margin):
    """Of smaller, larger and moved bodies: against all corners and vertices."""
    _, cloud, _ = ball
    bounds = enclosure(cloud, margin)
    assert certificate(bounds, bounds.inner).bound == pytest.approx(bounds.bound, rel=1e-9)
    for scale in (0.9, 0.999, 1.003, 1.5):
        moved = hull(scale * bounds.inner.vertices.view(np.ndarray) + [0.0, 0.3, 0.1])
        pairs = ((moved.vertices, bounds.inner), (bounds.corners, moved))
        expected = max(0.0, *(signed_distances(points, body).max() for points, body in pairs)) + margin
        assert certificate(bounds, moved).bound == pytest.approx(expected, rel=1e-9)


def test_where_nothing_bounds_the_body_the_local_bound_is_infinite():
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=20)
    # one sweep for each slice sees one side only, so that no slab is closed
    cloud = scanned(mesh, slices=4, sweeps=1)
    bounds = enclosure(cloud)
    certified = certificate(bounds, hull(cloud.points))
    assert certified.bound == np.inf
    assert (certified.at_vertices == np.inf).all()
    assert (bounds.support(DIRECTIONS)[1] == np.inf).all()
    assert len(bounds.outer_planes()) == 0
    # without the empty slices nothing bounds the caps, while the slabs between the slices are closed
    cloud = scanned(mesh, slices=6)
    filled = np.unique(cloud.slice)
    number = np.full(len(cloud.slice_height), -1, dtype=np.int32)
    number[filled] = np.arange(len(filled))
    open_ended = dataclasses.replace(
        cloud, slice=number[cloud.slice], slice_axis=cloud.slice_axis[filled], slice_height=cloud.slice_height[filled]
    )
    body = hull(cloud.points)
    assert enclosure(open_ended).part(Gap.CAPS) == np.inf
    certified = certificate(enclosure(open_ended), body)
    assert certified.bound == np.inf
    heights = body.vertices[:, 2]
    at_ends = np.isclose(heights, heights.min()) | np.isclose(heights, heights.max())
    assert (certified.at_vertices[at_ends] == np.inf).all()
    assert np.isfinite(certified.at_vertices[~at_ends]).all()


@pytest.mark.parametrize("axis", ["z", "xyz"])
def test_a_withdrawn_enclosure_states_nothing(axis):
    bounds = enclosure(scanned(random_body(1), slices=4, samples=24, axis=axis))
    nothing = bounding_nothing(bounds)
    certified = certificate(nothing, bounds.inner)
    assert certified.bound == nothing.bound == np.inf
    assert np.isinf(certified.at_vertices).all()
    assert nothing.tighter is None
    assert nothing.confidence == 0
    lower, upper = nothing.support(DIRECTIONS)
    assert (lower == -np.inf).all()
    assert (upper == np.inf).all()
