"""Intervals of normals from tangents alone: they contain the true normal, and are narrow where the contacts are dense."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from spatial_bodies import Cylinder, Ellipsoid, Polyhedron, box, random_polyhedron, spatial_cloud

from planar import Phase
from scan3d.geometry.arcs import edges_of, normal_intervals

EXACT = 1e-9
BODIES = {
    "sphere": Ellipsoid(np.ones(3)),
    "ellipsoid": Ellipsoid(np.array([1.0, 0.5, 0.3])),
    "box": box([1, 0.7, 0.5]),
    "round edges": box([1, 0.7, 0.5], 0.1, corners=0.1),
    "cylinder": Cylinder(0.4, 1.0),
    "polyhedron": random_polyhedron(2),
}


def intervals(cloud, errors=EXACT, turns=0.0):
    rows = np.flatnonzero(cloud.phase == Phase.TANGENTIAL)
    vertices, edges = edges_of(ConvexHull(cloud.centre_points))
    error = np.full(len(cloud), errors)
    found = normal_intervals(
        cloud.centre_points[rows],
        cloud.tangents[rows],
        error[rows],
        np.full(len(rows), turns),
        cloud.centre_points[vertices],
        error[vertices],
        edges,
    )
    return rows, found


def angle_beyond(normals, found):
    """How far the normals lie outside of their intervals, in radians."""
    angle = np.arctan2((normals * found.across).sum(axis=1), (normals * found.middle).sum(axis=1))
    return np.abs(angle) - found.half_width


@pytest.mark.parametrize("radius", [0.0, 0.01])
@pytest.mark.parametrize("name", BODIES)
def test_the_interval_contains_the_true_normal(name, radius):
    for count in (30, 300, 3000):
        cloud = spatial_cloud(BODIES[name], count, count, radius)
        rows, found = intervals(cloud)
        assert np.isfinite(found.half_width).all()
        assert angle_beyond(cloud.normals[rows], found).max() <= 0
        assert np.abs((found.middle * cloud.tangents[rows]).sum(axis=1)).max() < 1e-12


def test_it_narrows_with_the_spacing_of_the_contacts():
    medians = []
    for count in (500, 2000, 8000):
        medians.append(np.median(intervals(spatial_cloud(BODIES["ellipsoid"], count, 1))[1].half_width))
    assert medians[0] > 1.8 * medians[1] > 3.2 * medians[2]


def test_it_is_exact_on_an_edge_with_contacts_on_both_sides():
    cloud = spatial_cloud(Polyhedron(random_polyhedron(2).vertices, faces=0.0, corners=0.0), 2000, 1)
    _, found = intervals(cloud)
    assert np.quantile(found.half_width, 0.9) < 1e-6


def test_no_search_is_better_than_all_points():
    """The search among the hull's vertices finds what all points say, against brute force."""
    cloud = spatial_cloud(BODIES["ellipsoid"], 400, 3)
    rows, found = intervals(cloud)
    for i, half in zip(rows[:50], found.half_width[:50], strict=True):
        point, tangent = cloud.centre_points[i], cloud.tangents[i]
        offset = np.delete(cloud.centre_points, i, axis=0) - point
        inward = -cloud.normals[i]
        across = np.cross(tangent, inward)
        angle = np.arctan2(offset @ across, offset @ inward)
        assert half == pytest.approx((np.pi - np.ptp(angle)) / 2, abs=1e-6)


def test_errors_of_places_and_tangents_widen_it():
    cloud = spatial_cloud(BODIES["ellipsoid"], 1000, 4)
    _, exact = intervals(cloud)
    rng = np.random.default_rng(0)
    off = rng.normal(size=cloud.points.shape)
    off *= 1e-3 / np.linalg.norm(off, axis=1)[:, None]
    turn = rng.normal(size=cloud.points.shape)
    turn -= (turn * cloud.tangents).sum(axis=1)[:, None] * cloud.tangents
    turn *= 0.01 / np.linalg.norm(turn, axis=1)[:, None]
    tangents = cloud.tangents + turn
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    noisy = cloud.__class__(**{**vars(cloud), "centre_points": cloud.centre_points + off, "tangents": tangents})
    rows, found = intervals(noisy, 1e-3, 0.0101)
    known = np.isfinite(found.half_width)
    assert known.mean() > 0.9
    assert np.nanmedian(found.half_width) > np.median(exact.half_width)
    # the true normal, turned until it is perpendicular to the measured tangent
    turned = cloud.normals - (cloud.normals * tangents).sum(axis=1)[:, None] * tangents
    assert np.nanmax(angle_beyond(turned[rows], found)) <= 0


def test_a_line_through_the_body_has_no_interval():
    cloud = spatial_cloud(BODIES["sphere"], 300, 5)
    broken = cloud.__class__(**{**vars(cloud), "tangents": cloud.normals})
    assert np.isnan(intervals(broken)[1].half_width).all()


def test_nothing_is_known_if_the_errors_exceed_the_body():
    assert np.isnan(intervals(spatial_cloud(BODIES["sphere"], 100, 6), 10.0)[1].half_width).all()


def test_no_points_have_no_intervals():
    cloud = spatial_cloud(BODIES["sphere"], 100, 7)
    tips = cloud.__class__(**{**vars(cloud), "phase": np.full(100, Phase.TIP)})
    assert all(len(column) == 0 for column in intervals(tips)[1])
