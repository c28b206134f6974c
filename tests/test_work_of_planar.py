"""Nothing is computed twice over: the series, Newton's method and its start values do the work that they are there for.

Each of them has a slower way behind it that gives the same result, so that an error in them shows in the time only.
"""

import numpy as np
import pytest
from scipy.special import elliprd, elliprf

import planar
from planar import elastica, equilibria, segments, sweeping

CONTOURS = {
    "circle": planar.Circle(0.9, (0.2, 1.3)),
    "ellipse": planar.Ellipse((0.6, 0.3), (0.2, 0.8), 0.35),
    "square": planar.Polygon([(-0.4, 0.3), (0.4, 0.3), (0.4, 1.1), (-0.4, 1.1)]),
    "heptagon": planar.Polygon([(np.cos(t) / 3, 0.6 + np.sin(t) / 3) for t in 0.2 + 2 * np.pi * np.arange(7) / 7]),
}


def refuse(*arguments, **options):
    raise AssertionError("the slower way was taken")


# --- Carlson's integrals ---


@pytest.fixture
def arguments():
    """Arguments ``0 <= x, y <= z`` whose ratios run over 8 decades, for a few of them 0."""
    rng = np.random.default_rng(5)
    z = 10 ** rng.uniform(-6, 2, 4000)
    x, y = z * 10 ** -rng.uniform(0, 8, (2, 4000))
    x[:50] = 0.0
    return x, y, z


def test_carlsons_integrals_against_scipy(arguments):
    rf, rd = elastica._carlson(*arguments)
    np.testing.assert_allclose(rf, elliprf(*arguments), rtol=5e-15)
    np.testing.assert_allclose(rd, elliprd(*arguments), rtol=1e-14)


def test_carlsons_integrals_at_each_distance_alone(arguments):
    """Where the arguments lie far apart for one of them only, the others are not touched."""
    together = elastica._carlson(*arguments)
    for i in range(0, 4000, 400):
        alone = elastica._carlson(*(column[i : i + 1] for column in arguments))
        assert [float(part[i]) for part in together] == [float(part[0]) for part in alone]


@pytest.mark.parametrize("ratio", [1.0, 3.0, 10.0, 100.0])
def test_the_series_suffices_where_the_arguments_are_less_than_a_hundred_times_apart(ratio, monkeypatch):
    monkeypatch.setattr(elastica, "elliprf", refuse)
    monkeypatch.setattr(elastica, "elliprd", refuse)
    rng = np.random.default_rng(6)
    z = rng.uniform(0.1, 10.0, 500)
    x, y = z / rng.uniform(1.0, ratio, (2, 500))
    rf, rd = elastica._carlson(x, y, z)
    np.testing.assert_allclose(rf, elliprf(x, y, z), rtol=5e-15)
    np.testing.assert_allclose(rd, elliprd(x, y, z), rtol=1e-14)


# --- sweeps ---


@pytest.mark.parametrize("friction", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("contour", CONTOURS.values(), ids=CONTOURS)
def test_newtons_method_finds_all_but_a_few_states_of_a_sweep(contour, friction, monkeypatch):
    """What is left to bracketing lies next to touch-down and to folds, where x0 is no smooth function of the place."""
    left, steps = [], []

    def counted(function, calls):
        def run(path, piece, *others):
            calls.append(len(piece))
            return function(path, piece, *others)

        return run

    monkeypatch.setattr(segments, "_bracketed", counted(segments._bracketed, left))
    monkeypatch.setattr(segments, "_newton_step", counted(segments._newton_step, steps))
    planar.sweep(contour, friction, samples=400)
    assert sum(left) <= 4, sum(left)
    assert sum(steps) <= 2.8 * 400, sum(steps) / 400


def test_the_bend_of_a_tip_contact_is_found_in_few_steps(monkeypatch):
    """Over all directions of the force, at heights all the way between the straight rod's and the tangential contact's."""
    rng = np.random.default_rng(7)
    slope, friction = rng.uniform(-1.0, 1.4, 500), rng.uniform(0.0, 0.5, 500)
    alpha, q_most = slope + friction, elastica.tangential_q(slope, friction)
    bent = elastica.bend(alpha, q_most)
    low, high = bent.y / bent.length, elastica.unbowed_height(alpha)
    height = low + rng.uniform(0.05, 0.95, 500) * (high - low)
    steps = []

    def counted(bent):
        steps.append(len(bent.shape.length))
        return original(bent)

    original = equilibria.tip_ratios
    monkeypatch.setattr(equilibria, "tip_ratios", counted)
    root = equilibria._tip_root(alpha, height, q_most)
    bent = elastica.bend(alpha, root)
    assert bent.y / bent.length == pytest.approx(height, abs=1e-14)
    assert sum(steps) < 5.3 * len(alpha), sum(steps) / len(alpha)


@pytest.mark.parametrize("contour", CONTOURS.values(), ids=CONTOURS)
def test_samples_with_friction_of_their_own_search_a_small_part_of_the_path(contour, monkeypatch):
    """And find their place there: what they miss is searched for on the whole path."""
    pieces, missed = [], []
    original = sweeping._search_each

    def counted(path, samples, stretch, swept):
        pieces.append((stretch[1] - stretch[0]).sum())
        missed.append(original(path, samples, stretch, swept))
        return missed[-1]

    monkeypatch.setattr(sweeping, "_search_each", counted)
    friction = np.random.default_rng(8).uniform(0.0, 0.6, 300)
    swept = planar.sweep(contour, friction, samples=300)
    assert (swept.phase != planar.Phase.NONE).all()
    assert [len(part) for part in missed] == [0]
    # of some 60 pieces
    assert sum(pieces) <= 3.6 * 300, sum(pieces) / 300
