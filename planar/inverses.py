"""The methods of step 2: from the reactions of a rod to the place of its contact.

``closed-form``
    The elastica in closed form (`planar.elastica`) with ``q = m0z / (2 √f)``.  Friction changes the direction of the force,
    which is measured: the contact does not depend on friction otherwise.  Rods that are arcs of circles have a closed form as
    well; all others are marched.
``scholz-rahn``
    Numerical integration of (3) up to the contact (G. R. Scholz, C. D. Rahn, "Profile sensing with an actuated whisker",
    2004), in the steps of `planar.march`.  Friction invariant as well; the reference of the closed forms.
``will``
    Equation (10) (C. Will, "Continuum models for biologically inspired tactile sensors", 2018), clipped to 1.  It assumes a
    rod tangential to the force at its contact, which holds for ``μ = 0`` only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planar import march
from planar.arrays import Array, Mask
from planar.elastica import bend, bend_by_half_angle, integrals, partial_shape, tangential_q
from planar.rods import Rod

METHODS = ("closed-form", "scholz-rahn", "will")


class Solved(NamedTuple):
    """Contacts (n,) on rods that a sweep in -x bends; lengths in rod lengths, angles in radians."""

    force: Array
    """Size f of the contact force on the rod."""
    alpha: Array
    """Its direction (9)."""
    s1: Array
    x: Array
    """Relative to the clamp."""
    y: Array
    beta: Array
    """β (12), the angle between the rod's normal at the contact and the force."""
    wrong_side: Mask
    """Where the moment is that of a rod bent against the sweep."""
    no_rod: Mask
    """Where no rod has these reactions."""
    undefined: Mask
    """Where the method does not have a solution."""


def solve(method: str, rod: Rod, f0x: Array, f0y: Array, m0z: Array) -> Solved:
    """The contacts of reactions (n,) by one of `METHODS`; 'will' takes the straight uniform rod whatever the rod is."""
    if method == "scholz-rahn" or not rod.is_uniform:
        return _marched(rod, f0x, f0y, m0z)
    if rod.curvature:
        return _arc(rod, f0x, f0y, m0z)
    force, s, c = _polar(f0x, f0y)
    root_f = np.sqrt(force)
    q = m0z / (2 * root_f)
    square = q * q
    m, complement = s * s + square, c * c - square
    beta = 2 * np.arctan2(np.sqrt(m), np.sqrt(complement)) - np.pi / 2  # (12): sin β = 2m - 1
    exists = (complement >= 0) & (q > 0)
    alpha = 2 * np.arctan2(s, c)
    q = q if exists.all() else np.where(exists, q, np.nan)
    undefined = np.zeros(len(q), dtype=bool)
    if method == "will":
        s1, x, y, undefined = _will(alpha, q, root_f)
    else:
        shape, _, _ = bend_by_half_angle(s, c, q)
        s1, x, y = shape.length / root_f, shape.x / root_f, shape.y / root_f
    return Solved(force, alpha, s1, x, y, beta, m0z <= 0, complement < 0, undefined)


def _will(alpha: Array, q: Array, root_f: Array) -> tuple[Array, Array, Array, Mask]:
    # ERRATUM: (10) as printed has α̃ in its integrand; it stands for α.  The integral is that of a frictionless rod.
    undefined = np.abs(alpha) > np.pi / 2
    frictionless = bend(alpha, np.where(undefined, np.nan, tangential_q(alpha, np.zeros(len(alpha)))))
    s1 = np.minimum(frictionless.length / root_f, 1.0)
    # the point at s1 of the rod that the reactions bend
    shape = bend(alpha, q)
    x, y = partial_shape(alpha, q, shape.length - s1 * root_f)
    return s1, (shape.x - x) / root_f, (shape.y - y) / root_f, undefined


def _arc(rod: Rod, f0x: Array, f0y: Array, m0z: Array) -> Solved:
    """Arcs of circles: (3) holds for the whole curvature, which is ``κ̂ - m0z`` at the clamp and ``κ̂`` at the contact.

    With the amplitude u of Legendre's form, ``κ = -2k √f cos u``.  Rods with ``k >= 1``, strongly curved ones under small
    forces, have none and are marched.
    """
    force, s, c = _polar(f0x, f0y)
    root_f, alpha = np.sqrt(force), 2 * np.arctan2(s, c)
    q = (m0z - rod.curvature) / (2 * root_f)
    m = s * s + q * q
    k = np.sqrt(m)
    cosine = -rod.curvature / (2 * k * root_f)
    start, end = np.arctan2(s, q), np.arccos(cosine)
    (first, second), (begun, passed) = integrals(end, m), integrals(start, m)
    length = first - begun
    along = 2 * (second - passed) - length
    across = 2 * k * (np.cos(start) - cosine)
    x, y = across * np.cos(alpha) - along * np.sin(alpha), across * np.sin(alpha) + along * np.cos(alpha)
    beta = 2 * np.arcsin(k * np.sin(end)) - np.pi / 2
    nowhere = np.zeros(len(q), dtype=bool)
    wrong_side = m0z <= 0
    no_rod = (np.abs(cosine) > 1) & (m < 1)
    solved = Solved(force, alpha, length / root_f, x / root_f, y / root_f, beta, wrong_side, no_rod, nowhere)
    rows = np.flatnonzero(m >= 1)
    if len(rows):
        for column, values in zip(solved, _marched(rod, f0x[rows], f0y[rows], m0z[rows]), strict=True):
            column[rows] = values
    return solved


def _marched(rod: Rod, f0x: Array, f0y: Array, m0z: Array) -> Solved:
    carried = np.stack([f0x, f0y]) + rod.pull
    force, s, c = _polar(*carried)
    found = march.contacts(rod, -carried, -m0z)
    alpha = 2 * np.arctan2(s, c)
    beta = np.remainder(alpha - found.slope + np.pi, 2 * np.pi) - np.pi
    undefined = np.zeros(len(alpha), dtype=bool)
    return Solved(force, alpha, found.s1, found.x, found.y, beta, found.start >= 0, np.isnan(found.s1), undefined)


def _polar(fx: Array, fy: Array) -> tuple[Array, Array, Array]:
    """Size f of the contact force, sine and cosine of ``α/2``, from ``sin α = -f0x/f`` and ``cos α = f0y/f`` (9).

    By algebra, in a tenth of the time of hypot, sin and cos; ``cos α/2 >= 0``.
    """
    across, along = np.abs(fx), np.abs(fy)
    largest = np.maximum(across, along)
    across, along = across / largest, along / largest  # no overflow, no underflow
    size = np.sqrt(across * across + along * along)
    larger = np.sqrt((size + along) / (2 * size))
    smaller = across / (2 * size * larger)
    forward = fy >= 0
    s, c = smaller, larger
    if not forward.all():
        s, c = np.where(forward, smaller, larger), np.where(forward, larger, smaller)
    return largest * size, np.copysign(s, -fx), c
