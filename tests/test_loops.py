"""Outlines of any bodies: signed distances against brute force, closed curves, several contours, refusals."""

import matplotlib.path
import numpy as np
import pytest
from shapes import cassini, letter_l_outline

import planar
from planar.contours import Outlines, crosses_itself

COMB = np.array([[0, 0.5], [0.9, 0.5], [0.9, 0.9], [0.6, 0.9], [0.6, 0.6], [0.3, 0.6], [0.3, 0.9], [0, 0.9]])


def at_zero(points):
    return np.zeros(len(points), dtype=np.intp)


def test_signed_distances_from_a_polygon():
    rng = np.random.default_rng(1)
    for vertices in (COMB, letter_l_outline(0.7)):
        polygon = planar.Polygon(vertices)
        points = vertices.mean(axis=0) + rng.uniform(-0.7, 0.7, (1000, 2))
        near = Outlines([polygon.loops()]).nearest(at_zero(points), points)
        assert np.abs(np.abs(near.gap) - polygon.distance(points)).max() < 1e-14
        inside = matplotlib.path.Path(polygon.vertices).contains_points(points)
        np.testing.assert_array_equal(near.gap < 0, inside)
        # the gap grows along the normal
        step = Outlines([polygon.loops()]).nearest(at_zero(points), points + 1e-7 * near.normal).gap - near.gap
        assert np.abs(step - 1e-7).max() < 1e-8


def test_distances_from_a_vertex_that_faces_an_edge():
    """About as far from both: many samples of the edge are nearer than the first one beside the vertex."""
    rng = np.random.default_rng(4)
    for height in rng.uniform(0.05, 0.5, 30):
        polygon = planar.Polygon([[0, 0], [2, 0], [2, 1], [1.002, 1], [1, height], [0.998, 1], [0, 1]])
        points = np.array([1, height / 2]) + 3e-4 * rng.normal(size=(100, 2))
        gap = Outlines([polygon.loops()]).nearest(at_zero(points), points).gap
        assert np.abs(gap + polygon.distance(points)).max() < 1e-14


def test_signed_distances_from_a_curve():
    x, y = cassini(0.8)
    curve = planar.Curve.from_points(x, y)
    rng = np.random.default_rng(2)
    points = np.array([0, 0.8]) + rng.uniform(-0.6, 0.6, (400, 2))
    fine = np.stack(cassini(0.8, 40_000), axis=1)
    nearest = np.array([np.linalg.norm(fine - point, axis=1).min() for point in points])
    assert np.abs(curve.distance(points) - nearest).max() < 1e-6
    # inside by the curve's own equation
    foci = 0.3 * np.array([np.cos(0.8), np.sin(0.8)])
    product = np.hypot(*(points - [0, 0.8] - foci).T) * np.hypot(*(points - [0, 0.8] + foci).T)
    near = Outlines([curve.loops()]).nearest(at_zero(points), points)
    np.testing.assert_array_equal(near.gap < 0, product < 0.318**2)
    assert curve.distance(np.stack([x, y], axis=1)).max() < 1e-14


# the curve through the first crosses itself, their polygon does not; the curve through the others runs against their polygon
CROSSED = [[38, 953], [-28, 288], [-234, 781], [-197, 88], [-389, 7], [-894, -62], [219, -427], [534, -781]]
AGAINST = [[-368, 576], [-223, -16], [-40, -257], [54, -883], [80, -889]]


def test_curves_that_are_accepted_run_counter_clockwise_and_do_not_cross_themselves():
    rng = np.random.default_rng(5)
    given = [rng.uniform(-1, 1, (rng.integers(3, 9), 2)) for _ in range(100)]
    for near in (CROSSED, AGAINST):
        given += [np.array(near) / 1000 + 0.01 * rng.normal(size=(len(near), 2)) for _ in range(30)]
    accepted = 0
    for points in given:
        try:
            curve = planar.Curve(points)
        except ValueError:
            continue
        accepted += 1
        places = Outlines([curve.loops()]).at(np.zeros(2000, np.intp), np.arange(2000) / 2000).point
        x, y = places.T
        assert crosses_itself(places) is None
        assert (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0
    assert accepted > 50


def test_circles_and_ellipses_are_loops_too():
    rng = np.random.default_rng(3)
    points = rng.uniform([-1, -0.1], [1, 1.9], (300, 2))
    for contour in (planar.Circle(0.4, (0.1, 0.9)), planar.Ellipse((0.5, 0.2), (0, 0.8), 0.6)):
        for one in (contour, planar.contours.mirrored(contour)):
            if one is contour:
                gap = Outlines([one.loops()]).nearest(at_zero(points), points).gap
                assert np.abs(np.abs(gap) - one.distance(points)).max() < 1e-13
            touch = Outlines([one.loops()]).touch_down(0)
            assert abs(touch - planar.events(one).x0[0]) < 1e-12


def test_points_of_a_curve_may_come_in_either_order_and_closed():
    x, y = cassini(0.3, 200)
    first = planar.Curve.from_points(x, y)
    for other in ((x[::-1], y[::-1]), (np.append(x, x[0]), np.append(y, y[0]))):
        again = planar.Curve.from_points(*other)
        assert again.distance(first.points).max() < 1e-14
        assert len(again.points) == 200


def test_contours_inside_others_are_out_of_reach():
    ring = planar.Contours(
        [planar.Circle(0.3, (0, 0.8)), planar.Circle(0.2, (0, 0.8)), planar.Polygon(COMB + np.array([1, 0]))]
    )
    assert len(ring.parts) == 2
    assert ring.distance(np.array([[0.0, 0.8]]))[0] == pytest.approx(0.3)


def test_contours_that_coincide_overlap_and_those_that_share_an_edge_do_not():
    """Whatever rounding makes of their distances."""
    for x, y, size in np.random.default_rng(6).uniform(0.1, 0.9, (10, 3)):
        place = np.array([x, y])
        square, circle = size * np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) + place, planar.Circle(size, (x, y))
        peanut = np.stack(cassini(size, 50), axis=1) + place
        for one, other in (
            (planar.Polygon(square), planar.Polygon(np.roll(square, 1, axis=0))),
            (planar.Curve(peanut), planar.Curve(np.roll(peanut, 7, axis=0))),
            (circle, circle),
            (circle, planar.Ellipse((size, size), (x, y), size)),
        ):
            with pytest.raises(ValueError, match="must not overlap"):
                planar.Contours([one, other])
        assert len(planar.Contours([planar.Polygon(square), planar.Polygon(square + size * np.eye(2)[0])]).parts) == 2


def test_crossings_are_found_wherever_they_are():
    angle = np.linspace(0, 2 * np.pi, 500, endpoint=False)
    wavy = (1 + 0.3 * np.cos(9 * angle))[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert crosses_itself(wavy) is None
    for k in (3, 100, 400):
        crossed = wavy.copy()
        crossed[[k, k + 1]] = crossed[[k + 1, k]]
        assert crosses_itself(crossed) is not None
