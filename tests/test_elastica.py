"""Carlson's integrals, against scipy's functions, and without their help where the series suffices.

Where the series is not accurate, scipy's functions replace it, so that an error in the series may cost time only.
"""

import numpy as np
import pytest
from scipy.special import elliprd, elliprf

from planar import elastica


def refuse(*arguments, **options):
    raise AssertionError("the slower method was used")


@pytest.fixture
def arguments():
    """Arguments ``0 <= x, y <= z`` whose ratios run over 8 decades, for a few of them 0."""
    rng = np.random.default_rng(5)
    z = 10 ** rng.uniform(-6, 2, 4000)
    x, y = z * 10 ** -rng.uniform(0, 8, (2, 4000))
    x[:50] = 0.0
    return x, y, z


def test_carlsons_integrals_against_scipy(arguments):
    rf, rd = elastica.carlson_integrals(*arguments)
    np.testing.assert_allclose(rf, elliprf(*arguments), rtol=5e-15)
    np.testing.assert_allclose(rd, elliprd(*arguments), rtol=1e-14)


def test_carlsons_integrals_at_each_distance_alone(arguments):
    """Where the arguments lie far apart for one of them only, the others are not touched."""
    together = elastica.carlson_integrals(*arguments)
    for i in range(0, 4000, 400):
        alone = elastica.carlson_integrals(*(column[i : i + 1] for column in arguments))
        assert [float(part[i]) for part in together] == [float(part[0]) for part in alone]


@pytest.mark.parametrize("ratio", [1.0, 3.0, 10.0, 100.0])
def test_the_series_suffices_where_the_arguments_are_less_than_a_hundred_times_apart(ratio, monkeypatch):
    monkeypatch.setattr(elastica, "elliprf", refuse)
    monkeypatch.setattr(elastica, "elliprd", refuse)
    rng = np.random.default_rng(6)
    z = rng.uniform(0.1, 10.0, 500)
    x, y = z / rng.uniform(1.0, ratio, (2, 500))
    rf, rd = elastica.carlson_integrals(x, y, z)
    np.testing.assert_allclose(rf, elliprf(x, y, z), rtol=5e-15)
    np.testing.assert_allclose(rd, elliprd(x, y, z), rtol=1e-14)


def test_elliptic_integrals_have_no_jumps():
    """scipy's functions jump at rare amplitudes, as around this one (3.488 for 3.400): the integrals of an arc add up."""
    m = np.full(2001, 0.37767431706)
    amplitude = np.linspace(3.7344, 3.7345, 2001)
    first, second = elastica.integrals(amplitude, m)
    root = np.sqrt(1 - m * np.sin(amplitude) ** 2)
    step = amplitude[1] - amplitude[0]
    for values, rate in ((first, 1 / root), (second, root)):
        np.testing.assert_allclose(np.diff(values), step * (rate[1:] + rate[:-1]) / 2, atol=3e-15)
