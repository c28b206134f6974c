"""The bent rod in closed form: the shape that a force at its contact gives to a clamped rod.

The rod (3) ``x' = cos φ, y' = sin φ, φ' = κ, κ' = f cos(φ - α)`` is clamped upright at ``s = 0`` and carries no moment at
its contact ``s = s1``.  On the branch ``κ < 0`` on ``[0, s1)`` its shape depends on two numbers only:

``α``
    direction of the contact force ``f (sin α, -cos α)`` on the rod, in radians;
``q = m0z / (2 √f) ≥ 0``
    the clamping moment over twice the root of the force.

The elliptic parameter is ``m = k² = sin²(α/2) + q²`` (the first integral (11) at the clamp), and everything else scales
with ``√f``.  In the angle ``ψ1 = φ1 - α`` of the rod's end to the force, ``k = sin(π/4 - ψ1/2)``.

Writing ``q`` instead of ``ψ1`` keeps full precision near touch-down, where ``q → 0`` while ``ψ1`` tends to a finite angle.
Derivation: first integral of the elastica, then Legendre's normal form; the complementary amplitude ``u'`` (``F(u') = K -
F(u0)``) avoids the cancellation in that difference.  See L. Merker, J. Steigenberger, C. Behn, "Friction invariant object
reconstruction using a vibrissa-inspired tactile sensor concept", Byrd & Friedman, *Handbook of elliptic integrals*, and
B. C. Carlson, "Numerical computation of real or complex elliptic integrals" (1995), for the forms that are evaluated.

Pieces are stretches of rod that carry one constant force, from any slope and any curvature, as between two contacts.  There the
rod obeys ``x' = cos φ, y' = sin φ, φ' = κ, κ' = N_x sin φ - N_y cos φ`` (C2) with a constant internal force
``N = f (sin α, -cos α)``.  In ``θ = φ - α - π/2`` that is the pendulum ``θ'' = -f sin θ``, whose energy
``λ² = f sin²(θ/2) + κ²/4`` tells the regimes apart: ``m = λ²/f <= 1`` swings, with inflections (C3), ``m > 1`` turns over (C4),
which occurs between two contacts.  The first piece of a rod with a single contact is computed faster, as above.

Weak forces and fast turns, in which the closed forms of the places (C5) cancel, are integrated by Gauss's rule from the closed
form of the slope.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ellipe, ellipj, ellipk, elliprd, elliprf

from planar.arrays import Array


class Shape(NamedTuple):
    """A bent rod in units of ``1/√f``: arrays of one shape, dimensionless."""

    length: Array
    """``√f s1``, arc length from the clamp to the contact."""
    x: Array
    """``√f (x1 - x0)``, contact relative to the clamp, across the undeformed rod."""
    y: Array
    """``√f y1``, contact relative to the clamp, along the undeformed rod."""


class ShapeSlopes(NamedTuple):
    """A bent rod and its partial derivatives, the suffix naming the variable (``α`` or ``q``)."""

    shape: Shape
    length_alpha: Array
    length_q: Array
    x_alpha: Array
    x_q: Array
    y_alpha: Array
    y_q: Array


def bend(alpha: Array, q: Array) -> Shape:
    """Shape of the rod under a force in direction ``alpha`` with ``q = m0z / (2 √f)``.

    Both in the same shape, ``q >= 0``, ``sin²(α/2) + q² <= 1`` (NaN beyond: such a rod does not exist).
    """
    return bend_by_half_angle(np.sin(alpha / 2), np.cos(alpha / 2), q)[0]


def bend_with_slopes(alpha: Array, q: Array) -> ShapeSlopes:
    """`bend` with the partial derivatives of the shape.  ``α = q = 0`` gives NaN, because the shape is undetermined there."""
    s, c = np.sin(alpha / 2), np.cos(alpha / 2)
    shape, first, second = bend_by_half_angle(s, c, q)
    m = s * s + q * q
    complement = c * c - q * q
    with np.errstate(divide="ignore", invalid="ignore"):
        # dF/dm and dE/dm of the incomplete integrals, with the derivative of the amplitude u' folded in
        a = second / complement - first
        b = second - first
        length_q = (s / c + q * a) / m
        length_alpha = (s * c * a - q) / (2 * m)
        second_q = (s / c + q * b) / m
        second_alpha = (s * c * b - q * (c * c - m) / (c * c)) / (2 * m)
        along_q = 2 * second_q - length_q - 2 * s / c
        along_alpha = 2 * second_alpha - length_alpha - q / (c * c)
    cos_alpha, sin_alpha = (c - s) * (c + s), 2 * s * c
    return ShapeSlopes(
        shape,
        length_alpha,
        length_q,
        x_alpha=-shape.y - along_alpha * sin_alpha,
        x_q=2 * cos_alpha - along_q * sin_alpha,
        y_alpha=shape.x + along_alpha * cos_alpha,
        y_q=2 * sin_alpha + along_q * cos_alpha,
    )


def bend_by_half_angle(s: Array, c: Array, q: Array) -> tuple[Shape, Array, Array]:
    """Shape and the elliptic integrals F(u'), E(u') at the complementary amplitude, ``tan u' = q / (k' sin(α/2))``.

    `s` and `c` are sine and cosine of ``α/2``.
    """
    m = s * s + q * q
    complement = c * c - q * q
    # Legendre's integrals in Carlson's form, scaled by (c k)² so that amplitude and modulus need no roots.
    rf, rd = carlson_integrals(complement * s * s, complement * m, c * c * m)
    first = q * rf
    difference = m * q * q * q / 3 * rd  # F - E
    second = first - difference
    beyond = s < 0  # u' > π/2
    if beyond.any():
        first[beyond] = 2 * ellipk(m[beyond]) - first[beyond]
        second[beyond] = 2 * ellipe(m[beyond]) - second[beyond]
        # of these alone: no contact depends on which others there are
        difference[beyond] = first[beyond] - second[beyond]
    # along and across the force; m sin u0 sin u' = q tan(α/2)
    along = first - 2 * (difference + q * (s / c))
    across = 2 * q
    cos_alpha, sin_alpha = (c - s) * (c + s), 2 * s * c
    shape = Shape(first, across * cos_alpha - along * sin_alpha, across * sin_alpha + along * cos_alpha)
    return shape, first, second


def carlson_integrals(x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """Carlson's integrals R_F and R_D of ``0 <= x, y <= z``, both by one sequence of duplications; NaN for negative x or y.

    The duplication brings the arguments together, and a series in their remaining differences gives the integrals
    (https://dlmf.nist.gov/19.36).  A third of the time of scipy's two functions, at the same accuracy of some 1e-15.
    """
    arguments = x, y, z
    x, y, z = x.copy(), y.copy(), z.copy()
    rd_sum = np.zeros_like(z)
    with np.errstate(divide="ignore", invalid="ignore"):
        # five, each of which brings the arguments four times closer together; in place, because moving memory takes most of the
        # time
        for step in range(5):
            root_x, root_y, root_z = np.sqrt(x), np.sqrt(y), np.sqrt(z)
            shift = root_x * root_y
            root_x += root_y
            root_x *= root_z
            shift += root_x
            x += shift
            y += shift
            z += shift
            root_z *= z
            rd_sum += np.divide(2.0**step, root_z, out=root_z)
        scale = 2.0**5

        mean = (x + y + z) / 3
        dx, dy, dz = 1 - x / mean, 1 - y / mean, 1 - z / mean
        product, square = dx * dy, dz * dz
        e2, e3 = product - square, product * dz
        series = (1 / 24 - 5 / 208 * e2) * e2
        series -= 1 / 10
        series *= e2
        series += 1
        series += e3 * (1 / 14 + 3 / 104 * e3 + e2 * (-3 / 44 + e2 / 16))
        rf = scale * series / np.sqrt(mean)
        # so far from the mean the truncation of the series of 7th order exceeds rounding: these few moduli, near 1, are
        # left to scipy's functions, which take three times as long
        distant = dz < -0.02

        # the differences to R_D's mean (x + y + 3z)/5; the series' part of R_D is about 4^-5, so that the 6th order
        # suffices
        weight = 1 / (1 - 0.4 * dz)
        mean /= weight
        dz *= 0.6 * weight
        weight *= weight
        product += 0.56 * square
        product *= weight
        square *= 0.36 * weight
        e2, e3 = product - 6 * square, (3 * product - 8 * square) * dz
        e4, e5 = 3 * (product - square) * square, product * square * dz
        series = (9 / 88 - e2 / 16) * e2
        series -= 3 / 14
        series += 3 / 20 * e4
        series -= 9 / 52 * e3
        series *= e2
        series += 1
        series += e3 * (1 / 6 + 3 / 40 * e3)
        series -= 3 / 22 * e4
        series += 3 / 26 * e5
        rd = scale * series / (mean * np.sqrt(mean)) + 3 * rd_sum
    if distant.any():  # moduli near 1
        rf[distant], rd[distant] = elliprf(*(v[distant] for v in arguments)), elliprd(*(v[distant] for v in arguments))
    return rf, rd


def integrals(amplitude: Array, m: Array) -> tuple[Array, Array]:
    """Legendre's F and E by Carlson's forms: scipy's functions jump where ``tan² = 1/√(1 - m)`` up to rounding."""
    periods = np.round(amplitude / np.pi)
    reduced = amplitude - np.pi * periods
    sine, cosine = np.sin(reduced), np.cos(reduced)
    rf, rd = carlson_integrals(cosine**2, 1 - m * sine**2, np.ones_like(sine))
    first = sine * rf
    second = first - m * sine**3 / 3 * rd
    turned = periods != 0
    if turned.any():
        modulus = np.broadcast_to(m, periods.shape)[turned]
        first[turned] += 2 * periods[turned] * ellipk(modulus)
        second[turned] += 2 * periods[turned] * ellipe(modulus)
    return first, second


def partial_shape(alpha: Array, q: Array, remaining: Array) -> tuple[Array, Array]:
    """The part of a bent rod between a point and its contact: its extents in x and y, times √f.

    `remaining` is ``√f (s1 - s)``; negative values continue the same elastica past the contact.
    """
    m = np.sin(alpha / 2) ** 2 + q * q
    sn, cn, dn, amplitude = ellipj(remaining, m)
    along = 2 * (integrals(amplitude, m)[1] - m * sn * cn / dn) - remaining
    across = 2 * np.sqrt(m * (1 - m)) * sn / dn
    return across * np.cos(alpha) - along * np.sin(alpha), across * np.sin(alpha) + along * np.cos(alpha)


def tangential_q(slope: Array, friction_angle: Array) -> Array:
    """``q`` of a rod in tangential contact with a contour: ``φ1 = α̃``, hence ``ψ1 = -ζ`` (7) and ``α = α̃ + ζ``.

    ``q² = (sin ζ + cos α)/2``, written as a product so that it keeps its precision near a vertical slope.
    """
    steepness = np.maximum(np.pi / 2 - slope, 0.0)
    product = np.sin(steepness / 2) * np.cos(friction_angle - steepness / 2)
    return np.asarray(np.sqrt(np.maximum(product, 0.0)))


def unbowed_height(alpha: Array) -> Array:
    """``y1 / s1`` of the rod whose clamping moment vanishes: the straight rod for ``α >= 0``, else the bow with inflections.

    Tip contacts above it, relative to the rod's length, have no equilibrium with ``κ < 0`` on ``[0, s1)``.
    """
    m = np.sin(np.minimum(alpha, 0.0) / 2) ** 2
    height = np.cos(alpha) * (2 * ellipe(m) / ellipk(m) - 1)
    return np.asarray(np.where(alpha >= 0, 1.0, height))


# Force, and inverse modulus, below which (C5) and (C4) lose more digits to cancellation than Gauss's rule has errors.
_WEAK = 1e-3
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)


class End(NamedTuple):
    """The end of a piece relative to its start: arrays of one shape, dimensionless."""

    x: Array
    y: Array
    phi: Array
    """Slope angle, continuous along the piece, in radians."""
    kappa: Array
    """Curvature."""


def piece(force_x: Array, force_y: Array, phi: Array, kappa: Array, length: Array) -> End:
    """Where pieces lead that start with slope `phi` and curvature `kappa` and carry the internal force (force_x, force_y).

    The arguments broadcast; a negative `length` goes backwards.  Errors are some 1e-13, and up to 1e-11 of rods that are
    pulled almost in line.
    """
    fx, fy, phi0, kappa0, s = np.broadcast_arrays(force_x, force_y, phi, kappa, length)
    force = np.hypot(fx, fy)
    alpha = np.where(force > 0, np.arctan2(fx, -fy), 0.0)
    theta0 = np.remainder(phi0 - alpha - np.pi / 2 + np.pi, 2 * np.pi) - np.pi
    energy = force * np.sin(theta0 / 2) ** 2 + kappa0**2 / 4
    along, theta, kappa1 = np.array(s, dtype=float), np.array(theta0), np.array(kappa0, dtype=float)

    rest = _off_line(theta0)
    steep = np.sqrt(np.maximum(force, _WEAK))
    # where sine and angle agree to rounding: in (C3) ties and struts lose all digits of theirs
    line = (np.abs(rest) + np.abs(kappa0) / steep) * np.exp(np.minimum(steep * np.abs(s), 50.0)) < 5e-4
    line &= force >= _WEAK
    swings = (energy <= force) & (energy > 0) & ~line
    turns = (energy > force) & ~line
    with np.errstate(invalid="ignore", divide="ignore"):
        for regime, solve in ((swings, _swing), (turns, _turn), (line, _along_the_line)):
            inside = np.flatnonzero(regime.ravel())
            if len(inside):
                values = solve(*(v.ravel()[inside] for v in (force, energy, theta0, kappa0, s)))
                for column, value in zip((along, theta, kappa1), values, strict=True):
                    column.ravel()[inside] = value
        straight = energy == 0
        along[straight] = (s * np.cos(theta0))[straight]
        across = np.where(straight, s * np.sin(theta0), -(kappa1 - kappa0) / force)
        x = -np.sin(alpha) * along - np.cos(alpha) * across
        y = np.cos(alpha) * along - np.sin(alpha) * across
    cancels = np.flatnonzero((~straight & (force < _WEAK) | (turns & (force < 0.02 * energy))).ravel())
    if len(cancels):
        rows = [v.ravel()[cancels] for v in (force, energy, theta0, kappa0, s, phi0)]
        x.ravel()[cancels], y.ravel()[cancels] = _integrated(*rows)
    return End(x, y, phi0 + (theta - theta0), kappa1)


def _swing(force: Array, energy: Array, theta0: Array, kappa0: Array, s: Array) -> tuple[Array, Array, Array]:
    """(C3): extent along the force, θ and κ at the end of pieces with m <= 1."""
    m, root = energy / force, np.sqrt(force)
    k = np.sqrt(m)
    amplitude, lost = _advanced(np.arctan2(np.sin(theta0 / 2), kappa0 / (2 * root)), m, root * s)
    sn, cn = np.sin(amplitude), np.cos(amplitude)
    theta = 2 * np.arctan2(k * sn, np.hypot(cn, np.sqrt(np.maximum(1 - m, 0.0)) * sn))
    return s - 2 * lost / root, theta, 2 * k * root * cn


def _turn(force: Array, energy: Array, theta0: Array, kappa0: Array, s: Array) -> tuple[Array, Array, Array]:
    """(C4): the same of pieces with m > 1, whose curvature keeps its sign."""
    p, rate, sign = force / energy, np.sqrt(energy), np.sign(kappa0)
    amplitude, lost = _advanced(sign * theta0 / 2, p, rate * s)
    dn = np.hypot(np.cos(amplitude), np.sqrt(1 - p) * np.sin(amplitude))
    return s - 2 * lost / (rate * p), 2 * sign * amplitude, 2 * sign * rate * dn


def _advanced(start: Array, m: Array, by: Array) -> tuple[Array, Array]:
    """The amplitude (n,) at F(start) + by, and by how much F grows more than E up to there, by arithmetic-geometric means.

    The descending Landen transformation of F and E, and its inverse (Abramowitz and Stegun 17.6 and 16.4).
    """
    # rows of one piece follow one another
    new = (np.diff(start, prepend=np.nan) != 0) | (np.diff(m, prepend=np.nan) != 0)
    of, phi = np.cumsum(new) - 1, start[new]
    a, c = np.ones_like(phi), np.sqrt(m[new])
    b = np.sqrt(np.maximum(1 - m[new], 1e-40))
    zeta, share, levels = np.zeros_like(phi), c * c / 2, list[tuple[Array, Array, Array]]()
    while (c > 1e-8).any():
        phi = phi + np.arctan(b / a * np.tan(phi)) + np.pi * np.round(phi / np.pi)
        a, b, c = (a + b) / 2, np.sqrt(a * b), c * c / (2 * (a + b))
        levels.append((a, b, c))
        zeta += c * np.sin(phi)
        share += 2.0 ** (len(levels) - 1) * c * c
    phi, lost = phi[of] + 2.0 ** len(levels) * a[of] * by, share[of] * by + zeta[of]
    for a, b, c in reversed(levels):
        sine = np.sin(phi)
        lost -= c[of] * sine
        phi = (phi + np.arctan2((c / a)[of] * sine, np.hypot(np.cos(phi), (b / a)[of] * sine))) / 2
    return phi, lost


def _off_line(theta: Array) -> Array:
    """Angle of a rod to the line of a force that pulls it, θ = ±π."""
    return np.asarray(theta - np.where(theta > 0, np.pi, -np.pi))


def _along_the_line(force: Array, energy: Array, theta0: Array, kappa0: Array, s: Array) -> tuple[Array, Array, Array]:
    """The same of rods that a force pulls, almost in its line: the angle to it is a sum of exponentials."""
    root, angle = np.sqrt(force), _off_line(theta0)
    grown, steeper = np.cosh(root * s), np.sinh(root * s)
    theta, kappa = angle * grown + kappa0 / root * steeper, angle * root * steeper + kappa0 * grown
    # cos θ = -1 + θ²/2, and ∫ θ² = (θ κ - θ0 κ0 - (κ0² - f θ0²) s)/2f by parts, with the energy κ² - f θ²
    square = (theta * kappa - angle * kappa0 - (kappa0**2 - force * angle**2) * s) / (2 * force)
    return -s + square / 2, theta0 + (theta - angle), kappa


def _integrated(
    force: Array, energy: Array, theta0: Array, kappa0: Array, s: Array, phi0: Array
) -> tuple[Array, Array]:
    """Places at the ends by Gauss's rule over the closed form of the slope."""
    at = s[:, None] * (_NODES + 1) / 2
    force, energy, theta0, kappa0 = (
        np.broadcast_to(v[:, None], at.shape).ravel() for v in (force, energy, theta0, kappa0)
    )
    theta, turns = theta0.copy(), energy > force
    with np.errstate(invalid="ignore", divide="ignore"):
        for rows, solve in ((turns, _turn), (~turns & (energy > 0), _swing)):
            if rows.any():
                theta[rows] = solve(force[rows], energy[rows], theta0[rows], kappa0[rows], at.ravel()[rows])[1]
    phi = phi0[:, None] + (theta - theta0).reshape(at.shape)
    return (np.cos(phi) @ _WEIGHTS) * s / 2, (np.sin(phi) @ _WEIGHTS) * s / 2
