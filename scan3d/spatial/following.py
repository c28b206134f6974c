"""Contacts of a straight rod in space by its two bending moments, along frictionless sweeps.

The rod bends in the plane across its moment, and without friction the force, which lies in that plane, has the direction of the
body's normal: the two equations of `planar.following` hold.  With friction the force does not tell the normal, and neither is
left: a coefficient of friction can't be given.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

import planar
from planar.following import Frames, follow
from scan3d.arrays import Array, Index


class ByMoments(NamedTuple):
    """Contacts (n,) in rod lengths, in the world; NaN from the first row on that has no tangential contact."""

    point: Array
    """(n, 3)"""
    covariance: Array
    """(n, 3, 3) of the place."""
    force: Array
    """(n, 3) unit vectors: direction of the contact force on the rod, and outward normal of the body."""


def by_two_moments(
    position: Array,
    axes: Array,
    m0x: ArrayLike,
    m0z: ArrayLike,
    *,
    start: ArrayLike,
    sweep: Index | None = None,
    noise: float = 0.0,
    start_sd: float = 0.0,
    rod: planar.Rod | None = None,
) -> ByMoments:
    """The tangential contacts (n,) of frictionless sweeps, by the moments ``m0x`` and ``m0z`` at the clamp in ``EI/L``.

    position, axes
        (n, 3) the clamp in rod lengths, and (3, 3) or (n, 3, 3) its x, y and z axes as rows, in the world.
    start, start_sd
        arc length s1 of the first contact of each sweep (m,), in rod lengths, and its standard deviation; a push tells it
        (`planar.touched_at`).
    sweep
        (n,) numbers of the sweeps, whose rows follow one another; by default it is one.
    noise
        standard deviation of each moment.
    rod
        straight and weightless; by default uniform.

    The step between two rows costs an error of the second order, which the covariance does not hold.  Friction is assumed to be
    absent.  Raises ValueError for a rod that is curved or has weight, whose bending is not in a plane, and for a start outside
    of the rod.
    """
    rod = planar.Rod() if rod is None else rod
    if rod.curvature or rod.weight:
        raise ValueError("two moments locate contacts of straight rods without weight only; measure six channels")
    begin = np.atleast_1d(np.asarray(start, dtype=float))
    number = np.zeros(len(position), dtype=np.intp) if sweep is None else np.asarray(sweep, dtype=np.intp)
    if begin.shape != np.unique(number).shape or not ((begin > 0) & (begin <= 1)).all():
        raise ValueError(f"start must be an arc length in (0, 1] for each sweep, got {start!r}")
    about_x, about_z = np.asarray(m0x, dtype=float), np.asarray(m0z, dtype=float)
    moment = np.hypot(about_x, about_z)
    with np.errstate(invalid="ignore"):
        x, z = about_x / moment, about_z / moment
    own = np.broadcast_to(axes, (len(moment), 3, 3))
    across = z[:, None] * own[:, 0] - x[:, None] * own[:, 2]
    normal = x[:, None] * own[:, 0] + z[:, None] * own[:, 2]
    plane = np.stack([across, own[:, 1]], axis=1)
    frames = Frames(number, position, plane, -normal)
    found = follow(frames, moment, begin, rod=rod, noise=noise, start_sd=start_sd)
    fx, fy = found.force.T
    contacts = planar.reconstruct(np.zeros(len(moment)), fx, fy, moment, rod=rod, tolerance=1e-6)
    rates = np.zeros((len(moment), 3, 4))
    by_x, by_y = planar.jacobian(fx, fy, moment, rod=rod)[:, :2].swapaxes(0, 1)
    rates[:, :, :3] = across[:, :, None] * by_x[:, None] + own[:, 1, :, None] * by_y[:, None]
    rates[:, :, 3] = contacts.point[:, :1] * -normal
    size = np.hypot(fx, fy)[:, None]
    return ByMoments(
        position + np.einsum("ni,nik->nk", contacts.point, plane),
        rates @ found.covariance @ rates.transpose(0, 2, 1),
        -np.einsum("ni,nik->nk", found.force, plane) / size,
    )
