"""Contours: points by slope, distances, paths; removal of superfluous vertices; errors and their messages."""

import time

import numpy as np
import pytest

import planar

SLOPES = np.linspace(-np.pi / 2, np.pi / 2, 181)
SQUARE = np.array([[0.0, 0.5], [0.4, 0.5], [0.4, 0.9], [0.0, 0.9]])


SMOOTH = {
    "circle": planar.Circle(0.9, (0.1, 1.3)),
    "ellipse": planar.Ellipse((0.7, 0.4), (0.2, 0.9), 0.35),
    "needle": planar.Ellipse((0.6, 0.03), (0.0, 0.7), 1.0),
}


@pytest.mark.parametrize("contour", SMOOTH.values(), ids=SMOOTH)
def test_points_have_the_slope_they_are_asked_for(contour):
    # the tangent by central differences, whose error is that of third derivatives times the step squared
    inner, step = SLOPES[1:-1], 1e-5
    chords = contour.points(inner + step) - contour.points(inner - step)
    tangents = np.stack([np.cos(inner), np.sin(inner)], axis=1)
    along = (chords * tangents).sum(axis=1)
    across = chords[:, 1] * tangents[:, 0] - chords[:, 0] * tangents[:, 1]
    assert (along > 0).all()
    assert np.abs(across / along).max() < 1e-6
    np.testing.assert_allclose(contour.radius_of_curvature(inner), along / (2 * step), rtol=1e-4)


@pytest.mark.parametrize("contour", SMOOTH.values(), ids=SMOOTH)
def test_distance(contour):
    normals = np.stack([np.sin(SLOPES), -np.cos(SLOPES)], axis=1)
    points = contour.points(SLOPES)
    assert contour.distance(points).max() < 1e-14
    for gap in (1e-9, 0.05):
        assert np.abs(contour.distance(points + gap * normals) - gap).max() < 1e-14
    # inside too, as far as the centre of curvature is farther
    inside = min(1e-3, 0.5 * contour.radius_of_curvature(SLOPES).min())
    assert np.abs(contour.distance(points - inside * normals) - inside).max() < 1e-14


def test_distance_to_an_ellipse_from_everywhere():
    # against the nearest of many points
    ellipse = planar.Ellipse((0.6, 0.2), (0.1, 0.7), 0.5)
    rng = np.random.default_rng(70)
    points = ellipse.center + rng.normal(size=(50, 2))
    around = np.linspace(0, 2 * np.pi, 20_001)
    c, s = np.cos(0.5), np.sin(0.5)
    curve = ellipse.center + np.stack([0.6 * np.cos(around), 0.2 * np.sin(around)], axis=1) @ [[c, s], [-s, c]]
    nearest = np.array([np.linalg.norm(curve - point, axis=1).min() for point in points])
    assert np.abs(ellipse.distance(points) - nearest).max() < 1e-6
    assert ellipse.distance(np.array([ellipse.center]))[0] == pytest.approx(0.2)


@pytest.mark.parametrize("contour", SMOOTH.values(), ids=SMOOTH)
def test_path_begins_where_the_tip_of_the_straight_rod_touches(contour):
    path = contour.path()
    slope, x, y = path.at(np.array([0]), np.array([0.0]))
    if contour.points(np.array([np.pi / 2]))[0, 1] > 1:
        assert y[0] == 1.0
        assert contour.distance(np.array([[x[0], y[0]]]))[0] < 1e-14
    else:
        assert slope[0] == np.pi / 2
    assert (path.turn < 0).all()
    np.testing.assert_allclose((path.slope + path.turn)[:-1], path.slope[1:], atol=1e-15)


@pytest.mark.parametrize("lowest", [0.2, 0.7, 0.99])
@pytest.mark.parametrize("radius", [0.1, 0.6])
def test_path_ends_at_the_leftmost_point_or_at_the_tips_height(radius, lowest):
    """Past slopes of -75° there still are equilibria: nothing of the side that the rod can reach may be missing."""
    path = planar.Circle(radius, (0.3, lowest + radius)).path()
    above = (1.0 - lowest - radius) / radius  # of the tip over the centre, in radii
    assert path.slope[-1] + path.turn[-1] == pytest.approx(-np.pi / 2 if above > 0 else -np.arccos(-above))
    assert path.slope[0] == pytest.approx(np.pi / 2 if above > 0 else np.arccos(-above))


def test_duplicate_and_collinear_vertices_are_dropped():
    tilted = SQUARE @ [[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]]
    for square in (SQUARE, tilted):
        following = np.roll(square, -1, axis=0)
        fractions = np.linspace(0, 1, 38)
        many = np.concatenate(
            [a + fractions[:, None] * (b - a) for a, b in zip(square, following, strict=True)]  # corners come twice
        )
        tidied = planar.Polygon(many).vertices
        assert len(tidied) == 4
        np.testing.assert_allclose(sorted(map(tuple, tidied)), sorted(map(tuple, square)), atol=1e-15)
    closed = np.concatenate([SQUARE, SQUARE[:1]])
    assert len(planar.Polygon(closed).vertices) == 4


def circle_of(count):
    around = 2 * np.pi * np.arange(count) / count
    return np.array([0.0, 1.0]) + 0.5 * np.stack([np.cos(around), np.sin(around)], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 4, 7, 1000, 100_000])
def test_polygons_from_3_to_100_000_vertices(count):
    started = time.perf_counter()
    polygon = planar.Polygon(circle_of(count))
    assert len(polygon.vertices) == count
    swept = planar.sweep(polygon, 0.3, samples=50)
    # under a second on an idle machine; a quadratic algorithm takes far longer than the bound
    assert time.perf_counter() - started < 15
    assert (swept.phase != planar.Phase.NONE).all()
    assert polygon.distance(swept.point).max() < 1e-12
