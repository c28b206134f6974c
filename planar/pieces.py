"""Pieces of the elastica: a stretch of rod that carries one constant force, from any slope and any curvature.

Between two contacts the rod obeys ``x' = cos φ, y' = sin φ, φ' = κ, κ' = N_x sin φ - N_y cos φ`` (C2) with a constant internal
force ``N = f (sin α, -cos α)``.  In ``θ = φ - α - π/2`` that is the pendulum ``θ'' = -f sin θ``, whose energy
``λ² = f sin²(θ/2) + κ²/4`` tells the regimes apart: ``m = λ²/f <= 1`` swings, with inflections (C3), ``m > 1`` turns over (C4),
which occurs between two contacts.  `planar.elastica` has the first piece of a rod with a single contact, faster.

Weak forces and fast turns, in which the closed forms of the places (C5) cancel, are integrated by Gauss's rule from the closed
form of the slope.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planar.arrays import Array

# Force, and inverse modulus, below which (C5) and (C4) lose more digits to cancellation than Gauss's rule has errors.
_WEAK, _FAST = 1e-3, 0.02
# Modulus at which the means are one, and the least square of the complementary one.
_SMALL, _SINGULAR = 1e-8, 1e-40
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
    cancels = np.flatnonzero((~straight & (force < _WEAK) | (turns & (force < _FAST * energy))).ravel())
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
    b = np.sqrt(np.maximum(1 - m[new], _SINGULAR))
    zeta, share, levels = np.zeros_like(phi), c * c / 2, list[tuple[Array, Array, Array]]()
    while (c > _SMALL).any():
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
