"""Apexes of supporting planes: they bound the body for all normals of the arcs."""

import numpy as np
import pytest
from spatial_bodies import unit

from scan3d.bounds.apexes import cover, cut_depths, thinned
from scan3d.geometry.arcs import Arcs


def planes_of_ball(count, half_width, seed=0, *, seen=lambda normals: np.full(len(normals), True)):
    """Planes that touch the unit ball, whose normals lie anywhere in arcs of a half-width."""
    rng = np.random.default_rng(seed)
    normals = unit(rng.normal(size=(count, 3)))
    normals = normals[seen(normals)]
    across = unit(np.cross(normals, rng.normal(size=normals.shape)))
    off = rng.uniform(-1, 1, size=(len(normals), 1)) * half_width
    middle = np.cos(off) * normals + np.sin(off) * across
    return Arcs(normals, middle, np.cos(off) * across - np.sin(off) * normals, np.full(len(normals), half_width))


@pytest.mark.parametrize("half_width", [0.0, 1e-3, 0.02])
def test_the_apexes_enclose_the_body(half_width):
    planes = planes_of_ball(300, half_width)
    found = cover(planes, thinned(planes, 3.0, 0.1))
    assert found is not None
    assert np.isfinite(found.apexes).all()
    u = unit(np.random.default_rng(1).normal(size=(2000, 3)))
    assert (u @ found.apexes.reshape(-1, 3).T).max(axis=1).min() >= 1
    assert np.linalg.norm(found.apexes, axis=2).min() >= 1 - 1e-9


def test_the_support_function_is_bounded_from_above():
    for half_width in (0.0, 0.01):
        planes = planes_of_ball(200, half_width)
        directions, values = support_bounds(planes, cover(planes, thinned(planes, 3.0, 0.1)))
        assert len(directions) > 500
        assert np.linalg.norm(directions, axis=1) == pytest.approx(np.ones(len(directions)))
        assert values.min() >= 1
        assert np.median(values) < 1.2


def test_apexes_lie_on_the_planes_of_a_cube():
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    planes = Arcs(axes, axes, np.roll(axes, 1, axis=1), np.zeros(6))
    found = cover(planes, np.arange(6))
    assert len(found.planes) == 8
    assert np.abs(found.apexes) == pytest.approx(np.ones((8, 8, 3)))
    assert np.abs(found.nominal) == pytest.approx(np.ones((8, 3)))


def test_directions_without_planes_are_open():
    planes = planes_of_ball(300, 1e-3, seen=lambda normals: normals[:, 2] > 0)
    found = cover(planes, thinned(planes, 3.0, 0.1))
    is_open = np.isinf(found.apexes[:, 0, 0])
    assert is_open.any()
    assert not is_open.all()
    assert ((found.planes < 0).any(axis=1) == is_open).all()
    directions, _ = support_bounds(planes, found)
    assert directions[:, 2].min() > 0


def test_planes_whose_triangles_turn_over_are_removed():
    planes = planes_of_ball(100, 0.15)
    found = cover(planes, np.arange(100))
    assert len(found.removed)
    assert not np.isin(found.removed, found.planes).any()


def test_planes_through_the_middle_are_left_out():
    planes = planes_of_ball(50, 0.0)
    points = planes.points.copy()
    points[0] = 0
    found = cover(planes._replace(points=points), np.arange(50))
    assert 0 in found.removed


def test_only_planes_far_away_bound_nothing():
    planes = planes_of_ball(10, 0.0)
    found = cover(planes, np.empty(0, dtype=np.intp))
    assert np.isinf(found.apexes).all()


def test_a_cut_counts_by_the_end_at_which_it_is_least():
    planes = Arcs(np.eye(3)[:1], np.eye(3)[:1], np.eye(3)[1:2], np.array([0.1]))
    depth = cut_depths(planes, np.array([0]), np.array([[2.0, 0, 0], [1.0, 0.5, 0]]))
    assert depth[:, 0] == pytest.approx([np.cos(0.1), -0.5 * np.sin(0.1)])


def test_thinned_planes_are_apart():
    planes = planes_of_ball(1500, 0.02)
    chosen = thinned(planes, 3.0, 0.2)
    cosines = planes.middle[chosen] @ planes.middle[chosen].T - 2 * np.eye(len(chosen))
    assert cosines.max() < np.cos(0.2) + 1e-12
    far = (planes.middle @ planes.middle[chosen].T).max(axis=1)
    assert far.min() >= np.cos(0.2) - 1e-12
    assert len(thinned(planes._replace(half_width=np.full(1500, np.nan)), 3.0, 0.2)) == 0
