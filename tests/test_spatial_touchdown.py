"""Where straight rods touch a body, by brute force: the rod's smallest distance from the body along its path."""

import numpy as np
import pytest
from rods_in_space import HALF, cuboid, curved, random_ellipsoid, random_paths

from scan3d.spatial.bodies import Ellipsoid
from scan3d.spatial.sweeping import End, Paths, first_touches, passages, sweep


def depth_of_ellipsoid(semi_axes, axes):
    """Smallest value, over segments (..., 3) of length 1, of |A⁻¹x|² - 1: a parabola along each."""

    def depth(start, along):
        p, d = start @ axes.T / semi_axes, along @ axes.T / semi_axes
        s = np.clip(-(p * d).sum(-1) / (d * d).sum(-1), 0, 1)
        return ((p + s[..., None] * d) ** 2).sum(-1) - 1

    return depth


def depth_of_cuboid(turn, radius):
    """Smallest distance of segments from a fattened cuboid, by ternary search, since it is convex along the rod."""

    def distance(points):
        local = points @ turn.T
        return np.linalg.norm(local - np.clip(local, -HALF, HALF), axis=-1) - radius

    def depth(start, along):
        low, high = np.zeros(start.shape[:-1]), np.ones(start.shape[:-1])
        for _ in range(70):
            first, second = low + (high - low) / 3, high - (high - low) / 3
            left = distance(start + first[..., None] * along) < distance(start + second[..., None] * along)
            low, high = np.where(left, low, first), np.where(left, second, high)
        return distance(start + low[..., None] * along)

    return depth


def crossings(depth, position, along, samples=1500):
    """Fractions of straight paths at which rods enter and leave, by scanning and bisection; NaN for rods that do not."""
    start, travel = position[:, 0], position[:, -1] - position[:, 0]
    places = np.linspace(0, 1, samples)
    inside = np.array([depth(start + t * travel, along) < 0 for t in places])
    hit = inside.any(axis=0)
    ends = []
    for first, step in ((np.argmax(inside, axis=0), -1), (samples - 1 - np.argmax(inside[::-1], axis=0), 1)):
        within, without = places[first], places[np.clip(first + step, 0, samples - 1)]
        for _ in range(40):
            middle = (within + without) / 2
            now = depth(start + middle[:, None] * travel, along) < 0
            within, without = np.where(now, middle, within), np.where(now, without, middle)
        ends.append(np.where(hit, within, np.nan))
    return ends


def check(body, depth, rng, exact):
    position, clamps = random_paths(body, 120, 2, rng)
    along = clamps[:, 1]
    travel = position[:, -1] - position[:, 0]
    passage = passages(body, position[:, 0].T, along.T, travel.T)
    begin, end = crossings(depth, position, along)
    # grazes shorter than the brute force's steps are left out
    clear = ~(np.nan_to_num(passage.end - passage.begin, nan=1.0) < 4e-3)
    assert np.array_equal(passage.touches[clear], np.isfinite(begin)[clear])
    touches = passage.touches & clear
    assert 40 < touches.sum() < 120
    assert np.abs(passage.begin - begin)[touches].max() < exact
    assert np.abs(passage.end - end)[touches].max() < 0.004
    place = body.patch(passage.feature, passage.coordinates)
    contact = position[:, 0] + passage.begin[:, None] * travel + passage.s1[:, None] * along
    assert np.abs(contact - place.point.T)[touches].max() < 1e-10
    lean = (along * place.normal.T).sum(axis=1)
    tip = passage.s1 > 1 - 1e-9
    assert np.abs(lean[touches & ~tip]).max() < 1e-9
    assert lean[touches & tip].max(initial=-1.0) < 1e-9
    assert (touches & tip).any()


@pytest.mark.parametrize("seed", range(2))
def test_ellipsoids(seed):
    body, semi_axes, axes = random_ellipsoid(seed)
    check(body, depth_of_ellipsoid(semi_axes, axes), np.random.default_rng(seed), 1e-9)


@pytest.mark.parametrize(
    "radius", [pytest.param(0.003, marks=pytest.mark.slow), pytest.param(0.05, marks=pytest.mark.trust)]
)
def test_cuboids(radius):
    rng = np.random.default_rng(3)
    body, turn = cuboid(radius, rng)
    check(body, depth_of_cuboid(turn, radius), rng, 1e-9)


def test_first_touches_of_curved_paths():
    body, semi_axes, axes = random_ellipsoid(3)
    position, clamps = curved(body, 120, 40, np.random.default_rng(5), 0.2)
    place = np.linspace(0, 39, 3901)
    path = np.stack([[np.interp(place, np.arange(40), column) for column in one.T] for one in position])
    inside = depth_of_ellipsoid(semi_axes, axes)(path.swapaxes(1, 2), clamps[:, None, 1]) < 0
    touch = first_touches(body, Paths(position, clamps))
    assert len(touch.number) > 40
    # grazes shorter than a step of the brute force are left out
    assert set(np.flatnonzero(inside.any(axis=1))) <= set(touch.number)
    assert len(touch.number) < inside.any(axis=1).sum() + 3
    seen = inside[touch.number].any(axis=1)
    inside, begin, end = inside[touch.number][seen], touch.progress[seen], touch.clear_after[seen]
    behind = place[np.argmax(inside, axis=1)] - begin
    assert ((behind >= -1e-9) & (behind <= 0.0101)).all()
    after = ~inside & (place > begin[:, None] + 0.01)
    left = np.where(after.any(axis=1), place[np.argmax(after, axis=1)], np.inf)
    assert ((left == end) | ((left - end >= -0.01) & (left - end <= 0.0101))).all()


def test_paths_that_begin_in_the_body_are_refused():
    body, axes = Ellipsoid((0.4, 0.3, 0.3)), np.eye(3)[None]
    path = np.zeros((1, 10, 3))
    path[0, :, 0], path[0, :, 1] = np.linspace(0.1, -1, 10), -0.8
    with pytest.raises(ValueError, match="sweep 0"):
        sweep(body, path, axes)
    path[0, :, 0] += 0.5
    sweep(body, path, axes)
    path[0, :, 0] -= 2
    assert sweep(body, path, axes).end[0] == End.NO_TOUCH
