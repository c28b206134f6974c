"""Arcs of supporting planes contain the true normals."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from spatial_bodies import Cylinder, Ellipsoid, Polyhedron, box, random_polyhedron, spatial_cloud, unit

from planar import Phase
from scan3d.geometry.arcs import Places, arcs_at
from scan3d.geometry.hulls import edges_of

BODIES = {
    "sphere": Ellipsoid(np.ones(3)),
    "ellipsoid": Ellipsoid(np.array([1.0, 0.5, 0.3])),
    "box": box([1, 0.7, 0.5]),
    "round edges": box([1, 0.7, 0.5], 0.1, corners=0.1),
    "cylinder": Cylinder(0.4, 1.0),
    "polyhedron": random_polyhedron(2),
}


def arcs_of(cloud, errors=1e-9, turns=0.0, spread=None):
    rows = np.flatnonzero(cloud.phase == Phase.TANGENTIAL)
    vertices, edges = edges_of(ConvexHull(cloud.centre_points))
    places = Places(cloud.centre_points, np.full(len(cloud), errors), spread)
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


def test_no_search_is_better_than_all_points():
    """The search among the hull's vertices finds what all points say, against brute force."""
    cloud = spatial_cloud(BODIES["ellipsoid"], 400, 3)
    rows, found = arcs_of(cloud)
    for i, half in zip(rows[:50], found.half_width[:50], strict=True):
        inward = -cloud.normals[i]
        offset = np.delete(cloud.centre_points, i, axis=0) - cloud.centre_points[i]
        angle = np.arctan2(offset @ np.cross(cloud.tangents[i], inward), offset @ inward)
        assert half == pytest.approx((np.pi - np.ptp(angle)) / 2, abs=1e-6)


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


def test_errors_along_the_rod_hardly_widen_an_arc():
    """Of errors in an ellipsoid those across the rod count, and where all directions have the same, they are as one number."""
    cloud = spatial_cloud(BODIES["ellipsoid"], 1000, 4)
    error, each = 1e-3, np.ones((len(cloud), 1, 1))
    alike, ball = (arcs_of(cloud, *given)[1] for given in ((error,), (0.0, 0.0, error**2 * each * np.eye(3))))
    np.testing.assert_allclose(ball.half_width, alike.half_width, rtol=0.1)
    along = cloud.tangents[:, :, None] * cloud.tangents[:, None, :]
    rng = np.random.default_rng(0)
    spread = (0.1 * error) ** 2 * np.eye(3) + (10 * error) ** 2 * along
    off = 0.1 * error * unit(rng.normal(size=cloud.points.shape))
    off += 10 * error * rng.uniform(-1, 1, size=(len(cloud), 1)) * cloud.tangents
    noisy = dataclasses.replace(cloud, centre_points=cloud.centre_points + off)
    rows, found = arcs_of(noisy, 0.0, 0.0, spread)
    alike = arcs_of(noisy, 10.1 * error)[1]
    assert np.nanmedian(alike.half_width) > 2 * np.nanmedian(found.half_width)
    assert np.isfinite(found.half_width).mean() > 0.99
    assert np.nanmax(angle_beyond(cloud.normals[rows], found)) <= 0


def test_contradictions_large_errors_and_no_contacts_have_no_arc():
    cloud = spatial_cloud(BODIES["sphere"], 200, 5)
    through = dataclasses.replace(cloud, tangents=cloud.normals)
    assert np.isnan(arcs_of(through)[1].half_width).all()
    assert np.isnan(arcs_of(cloud, 10.0)[1].half_width).all()
    tips = dataclasses.replace(cloud, phase=np.full(len(cloud), Phase.TIP))
    assert all(len(column) == 0 for column in arcs_of(tips)[1])
