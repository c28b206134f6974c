"""Arcs of supporting planes, and normals by the hull of the contacts, contain the true normals, and planes the body."""

import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from shapes import unit
from spatial_bodies import Cylinder, Ellipsoid, Polyhedron, box, random_polyhedron, spatial_cloud
from spatial_scans import recorded

import planar
import scan3d
from planar import Phase
from scan3d.bounds.planes import outer_body, planes_of_arcs, planes_of_touches
from scan3d.geometry.arcs import Arcs, Places, arcs_at
from scan3d.geometry.hulls import edges_of, hull
from scan3d.reconstruction.normals import hull_normals
from scan3d.spatial.normals import angles

BODIES = {
    "sphere": Ellipsoid(np.ones(3)),
    "ellipsoid": Ellipsoid(np.array([1.0, 0.5, 0.3])),
    "box": box([1, 0.7, 0.5]),
    "round edges": box([1, 0.7, 0.5], 0.1, corners=0.1),
    "cylinder": Cylinder(0.4, 1.0),
    "polyhedron": random_polyhedron(2),
}


def arcs_of(cloud, errors=1e-9, turns=0.0):
    rows = np.flatnonzero(cloud.phase == Phase.TANGENTIAL)
    vertices, edges = edges_of(ConvexHull(cloud.centre_points))
    places = Places(cloud.centre_points, np.full(len(cloud), errors))
    turn = np.full(len(rows), turns)
    return rows, arcs_at(places.select(rows), cloud.tangents[rows], turn, places.select(vertices), edges)


def angle_beyond(normals, found):
    """How far the normals lie outside of their arcs, in radians."""
    angle = np.arctan2((normals * found.across).sum(axis=1), (normals * found.middle).sum(axis=1))
    return np.abs(angle) - found.half_width


@pytest.mark.parametrize("radius", [0.0, 0.01])
@pytest.mark.parametrize("name", BODIES)
def test_an_arc_contains_the_true_normal(name, radius):
    for count in (30, 1000):
        cloud = spatial_cloud(BODIES[name], count, count, radius)
        rows, found = arcs_of(cloud)
        assert np.isfinite(found.half_width).all()
        assert angle_beyond(cloud.normals[rows], found).max() <= 0
        assert np.abs((found.middle * cloud.tangents[rows]).sum(axis=1)).max() < 1e-12


def test_arcs_narrow_with_the_spacing_and_are_exact_inside_edges():
    medians = [np.median(arcs_of(spatial_cloud(BODIES["ellipsoid"], n, 1))[1].half_width) for n in (500, 2000, 8000)]
    assert medians[0] > 1.8 * medians[1] > 3.2 * medians[2]
    edges = spatial_cloud(Polyhedron(random_polyhedron(2).vertices, faces=0.0, corners=0.0), 2000, 1)
    assert np.quantile(arcs_of(edges)[1].half_width, 0.9) < 1e-6


def test_errors_of_places_and_tangents_widen_an_arc():
    cloud = spatial_cloud(BODIES["ellipsoid"], 1000, 4)
    _, exact = arcs_of(cloud)
    rng = np.random.default_rng(0)
    off = 1e-3 * unit(rng.normal(size=cloud.points.shape))
    turn = rng.normal(size=cloud.points.shape)
    turn -= (turn * cloud.tangents).sum(axis=1)[:, None] * cloud.tangents
    tangents = unit(cloud.tangents + 0.01 * unit(turn))
    noisy = dataclasses.replace(cloud, centre_points=cloud.centre_points + off, tangents=tangents)
    rows, found = arcs_of(noisy, 1e-3, 0.0101)
    assert np.isfinite(found.half_width).mean() > 0.9
    assert np.nanmedian(found.half_width) > np.median(exact.half_width)
    # the true normal, turned until it is perpendicular to the measured tangent
    turned = cloud.normals - (cloud.normals * tangents).sum(axis=1)[:, None] * tangents
    assert np.nanmax(angle_beyond(turned[rows], found)) <= 0


def planes_turned(points, normals, half_width, turn, rng):
    """Planes of arcs and tangents (n,); the true normals lie anywhere or at the ends, and the tangents are off by `turn`."""
    across = unit(np.cross(normals, rng.normal(size=normals.shape)))
    off = rng.choice([-1.0, 1.0, rng.uniform(-1, 1)], (len(normals), 1)) * half_width
    middle, along = np.cos(off) * normals + np.sin(off) * across, np.cos(off) * across - np.sin(off) * normals
    tangents = np.cross(along, middle)
    lean = rng.choice([-1.0, 1.0], (len(normals), 1)) * turn
    middle, tangents = np.cos(lean) * middle + np.sin(lean) * tangents, np.cos(lean) * tangents - np.sin(lean) * middle
    arcs = Arcs(middle, along, np.full(len(normals), half_width))
    nothing = np.zeros(len(normals))
    return planes_of_arcs(arcs, Places(points, nothing), tangents, np.full(len(normals), turn))


@pytest.mark.parametrize("turn", [0.0, 0.01])
@pytest.mark.parametrize("half_width", [0.0, 1e-3, 0.05])
@pytest.mark.parametrize("shape", ["box", "ball"])
def test_the_planes_of_arcs_enclose_the_body(shape, half_width, turn):
    rng, count = np.random.default_rng(5), 300
    if shape == "box":
        body = trimesh.creation.box([2.0, 1.4, 0.6])
        points, face = trimesh.sample.sample_surface(body, count, seed=1)
        normals = body.face_normals[face]
    else:
        body = trimesh.creation.icosphere(subdivisions=4)
        points = normals = unit(rng.normal(size=(count, 3)))
    corners, far = outer_body(planes_turned(points, normals, half_width, turn, rng), hull(points))
    assert not len(far)
    left = ConvexHull(corners)
    assert (body.vertices @ left.equations[:, :3].T + left.equations[:, 3]).max() < 1e-9
    assert left.volume < (1.02 + 0.05 * (shape == "ball") + 8 * (half_width + turn)) * body.volume


def test_a_body_is_bounded_only_where_planes_close_it():
    """Of a ball that is touched from above the planes leave open what lies below, and bound the rest as if it were not."""
    rng = np.random.default_rng(0)
    points = unit(rng.normal(size=(1000, 3)))
    points = points[points[:, 2] > 0.02]
    nothing = np.zeros(len(points))
    corners, far = outer_body(planes_of_touches(points, points, nothing, nothing), hull(points))
    assert len(far)
    up = unit(rng.normal(size=(500, 3)) * [1, 1, 0.3] + [0, 0, 2])
    assert (far @ up.T).max() < 0
    assert 1 <= (corners @ up.T).max(axis=0).max() < 1.02


@pytest.fixture(scope="module")
def ellipsoid():
    recording, _, normals = recorded((0.0, 0.4), diameter=0.01, substeps=1, directions=6, heights=6)
    cloud = scan3d.reconstruct(recording)
    return cloud, normals[cloud.row]


@pytest.mark.slow
def test_the_intervals_contain_the_normals(ellipsoid):
    cloud, exact = ellipsoid
    tangential = cloud.phase == planar.Phase.TANGENTIAL
    found = hull_normals(cloud.centre_points, cloud.tangents, tangential)
    assert np.isfinite(found.half_width).all()
    # those of tip contacts are cones about the means of the facets' normals
    assert (angles(found.normal, exact) <= found.half_width + 1e-7).mean() > 0.999
    assert (angles(found.normal, exact)[tangential] <= found.half_width[tangential] + 1e-7).all()
    np.testing.assert_allclose((found.normal * cloud.tangents).sum(axis=1)[tangential], 0, atol=1e-12)


@pytest.mark.slow
def test_contacts_on_faces_and_inside_edges_of_a_cube():
    """A tip contact on a face has the face's normal; a contact across an edge, whose neighbours lie on one line, one normal."""
    rng = np.random.default_rng(2)
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T.astype(float)
    faces = np.column_stack([rng.uniform(-0.9, 0.9, (20, 2)), np.ones(20)])
    edge = np.column_stack([rng.uniform(-0.9, 0.9, 20), np.ones(20), np.ones(20)])
    tangents = np.tile([0.0, 0.0, 1.0], (48, 1))
    tangents[28:] = np.array([0.2, 1.0, -0.6]) / np.sqrt(1.4)
    tangential = np.arange(48) >= 28
    turn = Rotation.from_rotvec([0.3, 0.5, -0.2])
    found = hull_normals(turn.apply(np.concatenate([corners, faces, edge])), turn.apply(tangents), tangential)
    normal = turn.inv().apply(found.normal)
    np.testing.assert_allclose(normal[8:28], np.tile([0, 0, 1], (20, 1)), atol=1e-9)
    assert found.half_width[8:28].max() < 1e-6
    np.testing.assert_allclose(normal[28:], np.tile([0, 0.6, 1] / np.sqrt(1.36), (20, 1)), atol=1e-9)
    assert found.half_width[28:].max() < 1e-10  # rounding
    # at a corner the normal is only known to lie between those of three faces
    assert (found.half_width[:8] > 0.9).all()


@pytest.mark.slow
def test_contacts_inside_the_hull_contradict_and_have_no_normal():
    points = np.vstack([np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T, [[0.0, 0.0, 0.0]]])
    tangents = np.tile([0.6, 0.8, 0.0], (9, 1))
    assert np.isinf(hull_normals(points, tangents, np.ones(9, dtype=bool)).half_width[8])
    for flat in (points[:3], points * [1, 1, 0], 0 * points):  # as have few and flat ones
        assert np.isinf(hull_normals(flat, tangents[: len(flat)], np.ones(len(flat), dtype=bool)).half_width).all()
