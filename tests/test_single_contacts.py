"""Tables of single contacts on any polygon: their paths, whether their rods are clear, and sweeps led by them."""

import numpy as np
import pytest
from shapes import letter_l_outline, star
from test_hard_corners import CORNERS

import planar
from planar import any_body, singles
from planar.contours import Outlines
from planar.elastica import bend, piece
from planar.several import reactions
from planar.singles import runs


def gear(turn, count=60):
    return planar.Polygon(np.stack(star(turn, count), axis=1))


def test_the_path_of_a_convex_polygon_is_the_known_one():
    angle = np.linspace(0.1, 2 * np.pi, 30)
    for height in (0.8, 0.95):
        polygon = planar.Polygon(np.stack([0.3 * np.cos(angle), 0.25 * np.sin(angle) + height], axis=1))
        mine, known = runs(Outlines([polygon.loops()])).path, polygon.path()
        np.testing.assert_array_equal(mine.offsets, known.offsets)
        for name in ("slope", "turn", "point", "move"):
            np.testing.assert_allclose(getattr(mine, name), getattr(known, name), atol=1e-15)


def test_runs_follow_the_outline_on_the_side_of_the_rod():
    polygons = [gear(0.3), planar.Polygon(letter_l_outline(1.2)), planar.Polygon(letter_l_outline(4.5))]
    outlines = Outlines([polygon.loops() for polygon in polygons])
    found = runs(outlines)
    path = found.path
    for end in (0.0, 1.0):
        place = outlines.at(found.piece, found.u + end * found.u_move)
        np.testing.assert_allclose(place.point, path.point + end * path.move, atol=1e-14)
        assert np.abs(np.sin(place.tau - path.slope - end * path.turn)).max() < 1e-14
        assert np.abs(path.slope + end * path.turn).max() <= np.pi / 2 + 1e-15
        assert place.point[:, 1].max() <= 1 + 1e-15
    joined = np.flatnonzero(found.run[1:] == found.run[:-1])
    for column, move in ((path.slope, path.turn), (path.point, path.move)):
        np.testing.assert_allclose((column + move)[joined], column[joined + 1], atol=1e-14)
    first = path.offsets[np.searchsorted(found.body, np.arange(3))]
    np.testing.assert_allclose(path.point[first, 0], [outlines.touch_down(body) for body in range(3)], atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("polygon", [gear(0.3), planar.Polygon(letter_l_outline(1.2))], ids=["gear", "letter L"])
def test_clearance_agrees_with_signed_distances(polygon):
    rng = np.random.default_rng(3)
    outlines = Outlines([polygon.loops()])
    following = np.roll(np.arange(len(polygon.vertices)), -1)
    alpha, q = rng.uniform(0, 1.2, 300), rng.uniform(0.01, 0.7, 300)
    length = bend(alpha, q).length
    exists = np.isfinite(length)
    alpha, q, s1 = alpha[exists], q[exists], rng.uniform(0.4, 1, exists.sum())
    root_f, x0 = length[exists] / s1, rng.uniform(-0.9, 0.5, exists.sum())
    force = root_f**2 * np.sin(alpha), -(root_f**2) * np.cos(alpha)
    found = singles.crosses(polygon.vertices, following, singles.lines_of(x0, -2 * q * root_f, *force, s1))
    at = np.linspace(0, 1, 1500)
    end = piece(
        force[0][:, None],
        force[1][:, None],
        np.full((len(q), 1), np.pi / 2),
        -2 * (q * root_f)[:, None],
        np.minimum(at, s1[:, None]),
    )
    rest = np.maximum(at - s1[:, None], 0)
    points = np.stack([x0[:, None] + end.x + rest * np.cos(end.phi), end.y + rest * np.sin(end.phi)], axis=2)
    gap = outlines.nearest(np.zeros(end.x.size, dtype=np.intp), points.reshape(-1, 2), 0.01).gap.reshape(end.x.shape)
    np.testing.assert_array_equal(found, gap.min(axis=1) < 0)
    assert 0.05 < found.mean() < 0.95
    upright = np.linspace(-0.5, 0.5, 41)
    points = np.stack(np.broadcast_arrays(upright[:, None], at), axis=2).reshape(-1, 2)
    gap = outlines.nearest(np.zeros(len(points), dtype=np.intp), points, 0.01).gap.reshape(41, -1)
    crossing = singles.straight_crosses(polygon.vertices, following, upright)
    np.testing.assert_array_equal(crossing, gap.min(axis=1) < 0)


class Without(singles.Singles):
    """Tables that know nothing, so that every rod is followed."""

    def __init__(self, *columns):
        super().__init__(*columns)
        self.known[:] = False


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.3, (0.1, 0.4)], ids=["constant", "per sample"])
def test_sweeps_led_by_tables_are_those_that_follow_the_rod(friction, monkeypatch):
    """Every sample, those with two contacts and behind snaps as well, but for one at which a snap may come a sample apart."""
    polygon, base = planar.Polygon(letter_l_outline(4.5)), np.linspace(0.25, -1.15, 29)
    mu = friction if np.ndim(friction) == 0 else np.random.default_rng(8).uniform(*friction, len(base))
    led = planar.sweep(polygon, mu, base=base)

    monkeypatch.setattr(any_body, "Singles", Without)
    followed = planar.sweep(polygon, mu, base=base)
    same = led.status == followed.status
    same &= np.abs(np.nan_to_num(led.m0z) - np.nan_to_num(followed.m0z)) < 1e-8
    assert (~same).sum() <= 1
    assert (led.status == planar.SweepStatus.SEVERAL_CONTACTS).any()
    assert (led.status == planar.SweepStatus.FREE).any()


@pytest.mark.trust
def test_hard_corners_led_by_tables_are_those_that_follow_the_rod(monkeypatch):
    names = ["a slot narrower than the bent rod", "a wedge of 20 degrees", "a hook", "a hook the other way"]
    outlines = Outlines([CORNERS[name].loops() for name in names])
    bases = [np.linspace(outlines.touch_down(i) - 1e-3, outlines.low[i, 0] - 0.9, 40) for i in range(len(names))]
    angles = [np.full(40, np.arctan(0.3))] * len(names)
    led = any_body.follow(outlines, bases, angles)
    monkeypatch.setattr(any_body, "Singles", Without)
    for one, other in zip(led, any_body.follow(outlines, bases, angles), strict=True):
        np.testing.assert_array_equal(one.status, other.status)
        np.testing.assert_allclose(*(reactions(outlines, swept.rods) for swept in (one, other)), atol=1e-8)
