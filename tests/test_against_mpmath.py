"""The closed form agrees with Legendre's elliptic integrals to 40 digits, by mpmath.

The reference is the textbook's derivation: the first integral (11) at the clamp gives the modulus, Legendre's integrals
``K - F(u0)`` and ``E - E(u0)`` the rod, and the additional digits outweigh the cancellation in both differences.  It is
itself checked against the integral over the rod's slope that these integrals represent.

The tolerance is 1e-12 of the rod's length.  Where ``k`` is close to 1, the rounding of the inputs changes the
result by ``eps / (1 - k²)``, which is added.
"""

from typing import Any, NamedTuple

import mpmath
import numpy as np
import pytest

import planar
from planar import elastica
from planar.elastica import bend, carlson_integrals, partial_shape, tangential_q

AGREES = 1e-12
EPS = np.finfo(float).eps


class Rod(NamedTuple):
    """A rod up to its contact, and its β (12), as multiple-precision numbers."""

    length: Any
    x: Any
    y: Any
    beta: Any


def rod(alpha, q):
    """The rod times √f."""
    with mpmath.workdps(40):
        m = mpmath.sin(alpha / 2) ** 2 + q * q
        u0 = mpmath.asin(mpmath.sin(alpha / 2) / mpmath.sqrt(m))
        first = mpmath.ellipk(m) - mpmath.ellipf(u0, m)
        second = mpmath.ellipe(m) - mpmath.ellipe(u0, m)
        along, across = 2 * second - first, 2 * q
        x = across * mpmath.cos(alpha) - along * mpmath.sin(alpha)
        y = across * mpmath.sin(alpha) + along * mpmath.cos(alpha)
        return Rod(first, x, y, mpmath.asin(2 * m - 1))


def measured_rod(x0, f0x, f0y, m0z):
    """The rod from its reactions, by (9): length s1, contact (x, y)."""
    with mpmath.workdps(40):
        x0, f0x, f0y, m0z = (mpmath.mpf(float(value)) for value in (x0, f0x, f0y, m0z))
        root_f = mpmath.sqrt(mpmath.hypot(f0x, f0y))
        length, x, y, beta = rod(mpmath.atan2(-f0x, f0y), m0z / (2 * root_f))
        return Rod(length / root_f, x0 + x / root_f, y / root_f, beta)


def corner(name, count=40):
    """Directions and bends (n,) in a corner of their domain."""
    rng = np.random.default_rng(30)
    anywhere = rng.uniform(-1.4, 2.6, count)
    q_limit = np.cos(anywhere / 2)
    small = 10 ** rng.uniform(-13, -2, count)
    return {
        "everywhere": (anywhere, q_limit * np.sqrt(rng.uniform(0, 0.99, count))),
        "touch-down": (np.abs(anywhere), 10 ** rng.uniform(-14, -10, count)),
        "a bow barely bent": (-np.abs(anywhere), 10 ** rng.uniform(-14, -10, count)),
        "force along the rod, from the right": (small, rng.uniform(0.01, 0.95, count)),
        "force along the rod, from the left": (-small, rng.uniform(0.01, 0.95, count)),
        "everything small": (small * rng.choice([-1, 1], count), small[::-1]),
        "tension": (rng.uniform(np.pi / 2, 3.0, count), 10 ** rng.uniform(-6, -1.5, count)),
        "more moment is impossible": (anywhere, np.sqrt(q_limit**2 - 10 ** rng.uniform(-9, -2, count))),
    }[name]


CORNERS = [
    "everywhere",
    "touch-down",
    "a bow barely bent",
    "force along the rod, from the right",
    "force along the rod, from the left",
    "everything small",
    "tension",
    "more moment is impossible",
]


@pytest.mark.parametrize(
    ("x_range", "y_range"),
    [((-9, 0), (-9, 0)), ((-1, 0), (-1, 0)), ((-9, -3), (-9, -3)), ((-20, -6), (-1, 0))],
    ids=["everywhere", "moduli far from 1", "x and y small", "x small"],
)
def test_carlson_integrals_are_exact_to_rounding_on_both_sides_of_the_reach_of_their_series(x_range, y_range):
    # The arguments come together by a factor of 4^5, so that the smallest ones leave the series' reach.  Its truncation is
    # 1e-13 at two and a half times that reach, where `test_bend`, which allows for rounded inputs, does not notice it.
    rng = np.random.default_rng(32)
    z = 10 ** rng.uniform(-1, 1, 80)
    x, y = z * 10 ** rng.uniform(*x_range, 80), z * 10 ** rng.uniform(*y_range, 80)
    computed = np.stack(carlson_integrals(x, y, z))
    with mpmath.workdps(40):
        exact = [
            [function(*map(mpmath.mpf, row)) for row in zip(x.tolist(), y.tolist(), z.tolist(), strict=True)]
            for function in (mpmath.elliprf, mpmath.elliprd)
        ]
        errors = [
            abs(mpmath.mpf(float(a)) / b - 1)
            for row in zip(computed, exact, strict=True)
            for a, b in zip(*row, strict=True)
        ]
    assert max(errors) < 2e-15


@pytest.mark.parametrize("name", CORNERS)
def test_bend(name):
    alpha, q = corner(name)
    shape = bend(alpha, q)
    for i in range(len(q)):
        length, x, y, beta = rod(mpmath.mpf(float(alpha[i])), mpmath.mpf(float(q[i])))
        allowed = AGREES + 4 * EPS / float(1 - mpmath.sin(beta))
        for computed, exact in zip((shape.length[i], shape.x[i], shape.y[i]), (length, x, y), strict=True):
            assert abs((mpmath.mpf(float(computed)) - exact) / length) < allowed, (alpha[i], q[i])


@pytest.mark.parametrize("name", CORNERS)
def test_reconstruct(name):
    alpha, q = corner(name)
    rng = np.random.default_rng(31)
    s1 = rng.uniform(0.3, 0.999, len(q))
    f = (bend(alpha, q).length / s1) ** 2
    columns = rng.normal(size=len(q)), -f * np.sin(alpha), f * np.cos(alpha), 2 * q * np.sqrt(f)
    # A wide tolerance accepts friction angles below 0, which this test does not concern.
    contacts = planar.reconstruct(*columns, tolerance=0.9999)
    passed = contacts.status == planar.Status.OK
    assert passed.sum() > 0.9 * len(q)
    for i in np.flatnonzero(passed):
        true_s1, x, y, beta = measured_rod(*(column[i] for column in columns))
        rest = float(1 - mpmath.sin(beta))
        allowed = AGREES + 4 * EPS / rest
        scale = 1 + abs(columns[0][i])
        assert abs(contacts.s1[i] - true_s1) < allowed, (alpha[i], q[i])
        assert abs(contacts.point[i, 0] - x) < allowed * scale
        assert abs(contacts.point[i, 1] - y) < allowed
        # next to ±π/2, β varies with the square root of its distance, 1 - sin β or 1 + sin β
        assert abs(contacts.friction_angle_bound[i] - beta) < AGREES + 4 * EPS / np.sqrt(max(min(rest, 2 - rest), EPS))


def test_friction_angle_of_sweeps():
    # compared with the friction that the sweep was given, not with that of its rounded reactions: (14) in double precision
    for contour, mu in ((planar.Circle(0.9, (0, 1.3)), 0.3), (planar.Ellipse((0.6, 0.3), (0.2, 0.8), 0.35), 1.2)):
        swept = planar.sweep(contour, mu, samples=60)
        tangential = (swept.phase == planar.Phase.TANGENTIAL) & (swept.m0z > 0)
        for i in np.flatnonzero(tangential)[::4]:
            s1, x, y, beta = measured_rod(swept.x0[i], swept.f0x[i], swept.f0y[i], swept.m0z[i])
            assert abs(s1 - swept.s1[i]) < AGREES
            assert abs(x - swept.point[i, 0]) < AGREES
            assert abs(y - swept.point[i, 1]) < AGREES
            assert abs(mpmath.tan(beta) - mu) < AGREES


def test_bend_of_a_rod_in_tangential_contact_with_a_nearly_vertical_wall():
    steepness = np.logspace(-7, -1, 20)
    zeta = np.arctan(np.linspace(0, 2, 20))
    alpha, q = np.pi / 2 - steepness + zeta, tangential_q(np.pi / 2 - steepness, zeta)
    shape = bend(alpha, q)
    for i in range(len(q)):
        with mpmath.workdps(40):
            # q² = (sin ζ + cos α)/2; the vertical is π/2 as rounded, because slopes are measured from there
            wall = mpmath.mpf(float(np.pi / 2)) - mpmath.mpf(float(np.pi / 2 - steepness[i]))
            true_q = mpmath.sqrt(mpmath.sin(wall / 2) * mpmath.cos(mpmath.mpf(float(zeta[i])) - wall / 2))
            assert abs(q[i] / true_q - 1) < AGREES
        length = rod(mpmath.mpf(float(alpha[i])), mpmath.mpf(float(q[i]))).length
        assert abs(shape.length[i] / length - 1) < AGREES


@pytest.mark.parametrize(("alpha", "q"), [(0.7, 0.5), (-0.4, 0.8), (2.1, 0.2), (1.0, 1e-6)])
def test_elastic_line(alpha, q):
    # points of the rod and of its continuation past the contact, by amplitudes from mpmath
    length = float(bend(np.array([alpha]), np.array([q])).length[0])
    fraction = np.linspace(-0.3, 1.0, 9)
    x, y = partial_shape(np.full(9, alpha), np.full(9, q), fraction * length)
    with mpmath.workdps(40):
        a, b = mpmath.mpf(alpha), mpmath.mpf(q)
        m = mpmath.sin(a / 2) ** 2 + b * b
        for i, remaining in enumerate(fraction * length):
            u = mpmath.asin(mpmath.ellipfun("sn", mpmath.ellipk(m) - mpmath.mpf(float(remaining)), m=m))
            past = remaining < 0
            second = mpmath.ellipe(m) - mpmath.ellipe(u, m)
            along = 2 * (-second if past else second) - mpmath.mpf(float(remaining))
            across = 2 * mpmath.sqrt(m) * mpmath.cos(u) * (-1 if past else 1)
            assert abs(x[i] - (across * mpmath.cos(a) - along * mpmath.sin(a))) < AGREES * length
            assert abs(y[i] - (across * mpmath.sin(a) + along * mpmath.cos(a))) < AGREES * length


@pytest.mark.parametrize(("alpha", "q"), [(0.7, 0.5), (-0.4, 0.8), (2.1, 0.2), (0.0, 0.3)])
def test_the_reference_is_the_integral_over_the_slope(alpha, q):
    # √f ds = -dψ / √(2 (sin ψ - sin ψ1)) from the clamp, ψ = π/2 - α, to the contact, sin ψ1 = cos α - 2 q² (11)
    with mpmath.workdps(30):
        a, b = mpmath.mpf(alpha), mpmath.mpf(q)
        clamp, end = mpmath.pi / 2 - a, mpmath.asin(mpmath.cos(a) - 2 * b * b)

        def integral_of(function):
            # ψ = ψ1 + w² removes the root from the denominator; the sum formula removes the cancellation
            def integrand(w):
                rise = 2 * mpmath.cos(end + w * w / 2) * mpmath.sin(w * w / 2)
                return function(end + w * w + a) * 2 * w / mpmath.sqrt(2 * rise) if w else 0

            return mpmath.quad(integrand, [0, mpmath.sqrt(clamp - end)])

        length, x, y, beta = rod(a, b)
        assert abs(integral_of(lambda phi: 1) - length) < 1e-20
        assert abs(integral_of(mpmath.cos) - x) < 1e-20
        assert abs(integral_of(mpmath.sin) - y) < 1e-20
        assert abs(beta + end) < 1e-20


def test_amplitudes_and_integrals_of_pieces():
    """Where m is close to 1, the amplitude's own rounding changes F - E by that of F, and the amplitude alone is compared."""
    draw = np.random.default_rng(4)
    m = np.concatenate(
        [draw.uniform(0, 1, 20), 1 - 10.0 ** draw.uniform(-15, -2, 20), 10.0 ** draw.uniform(-12, -2, 8)]
    )
    start, by = draw.uniform(-4, 4, len(m)), draw.uniform(0, 3, len(m))
    with mpmath.workdps(40):
        for s, way, parameter, found, lost in zip(start, by, m, *elastica._advanced(start, m, by), strict=True):
            amplitude = mpmath.mpf(found)
            rate = mpmath.sqrt(1 - parameter * mpmath.sin(amplitude) ** 2)
            off = mpmath.ellipf(amplitude, parameter) - mpmath.ellipf(s, parameter) - way
            assert abs(off * rate) < 1e-14
            if parameter < 0.99:
                second = mpmath.ellipe(amplitude, parameter) - mpmath.ellipe(s, parameter)
                assert abs(way - second - lost) < 1e-13


def test_elliptic_integrals_have_no_jumps():
    """scipy's functions jump at rare amplitudes, as around this one (3.488 for 3.400): the integrals of an arc add up."""
    m = np.full(2001, 0.37767431706)
    amplitude = np.linspace(3.7344, 3.7345, 2001)
    first, second = elastica.integrals(amplitude, m)
    root = np.sqrt(1 - m * np.sin(amplitude) ** 2)
    step = amplitude[1] - amplitude[0]
    for values, rate in ((first, 1 / root), (second, root)):
        np.testing.assert_allclose(np.diff(values), step * (rate[1:] + rate[:-1]) / 2, atol=3e-15)
