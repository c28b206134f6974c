"""How errors of the six reactions carry over to the contact in space, to the first order.

In the bending plane the derivatives are those of `planar.jacobian`.  Across it the plane's angle ω follows from the moment with
the standard deviation ``σ_m/|m0|`` and from the force across the rod with ``σ_f/|f0⊥|``, together with the weights of
`scan3d.spatial.inverse.bending_direction`.  Equal errors in all directions make both parts independent of each other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import planar
from scan3d.arrays import Array
from scan3d.spatial.inverse import bending_direction, reconstruct

# Contacts that the noise puts past the tip by this part of the rod have errors as well.
_PAST_TIP = 0.999


class SpatialErrors(NamedTuple):
    """Standard deviations (n,) and covariances of what six reactions give, dimensionless; infinite where there is no rod."""

    point: Array
    """(n, 3, 3) covariance of the contact's place in the clamp's frame."""
    largest: Array
    """(n,) standard deviation of the place in its least certain direction."""
    s1: Array
    """(n,)"""
    beta: Array
    """(n,) of the angle β."""
    tangent: Array
    """(n,) of the tangent: root of the mean square angle, in radians."""
    plane: Array
    """(n,) of the bending plane's angle ω, in radians."""
    force: Array
    """(n,) of the direction of the force: root of the mean square angle, in radians."""


def errors(f0: Array, m0: Array, noise: tuple[float, float]) -> SpatialErrors:
    """Errors of the contacts that `reconstruct` finds for reactions (n, 3), by the noise of force and moment."""
    sigma_f, sigma_m = noise
    with np.errstate(all="ignore"):  # rows without a force have no errors that are numbers
        # exact reactions, of rods whose poses alone are noisy, give the same direction with any weights
        ex, ez = bending_direction(f0.T, m0.T, noise if max(noise) else (1.0, 1.0))
        m, f0e = m0[:, 2] * ex - m0[:, 0] * ez, f0[:, 0] * ex + f0[:, 2] * ez
        slopes = planar.jacobian(f0e, f0[:, 1], m) * [sigma_f, sigma_f, sigma_m]
        angle = 1 / np.sqrt((m / sigma_m) ** 2 + (f0e / sigma_f) ** 2)
        x, y, s1, alpha, beta = (slopes[:, k] for k in range(5))
        found = reconstruct(f0, m0, noise=noise, tolerance=_PAST_TIP)
        zero = np.zeros_like(ex)
        across, normal = np.stack([ex, zero, ez], axis=1), np.stack([-ez, zero, ex], axis=1)
        place = across[:, :, None] * x[:, None, :]
        place[:, 1] += y
        sideways = ((found.point * across).sum(axis=1) * angle)[:, None] * normal
        point = place @ place.transpose(0, 2, 1) + sideways[:, :, None] * sideways[:, None, :]
        sideways_turn = (found.tangent * across).sum(axis=1) * angle
        tangent = np.sqrt(((alpha - beta) ** 2).sum(axis=1) + sideways_turn**2)
        s1_sd, beta_sd = (np.linalg.norm(row, axis=1) for row in (s1, beta))
        force = sigma_f * np.sqrt(2) / np.linalg.norm(f0, axis=1)
        known = np.isfinite(point).all(axis=(1, 2)) & np.isfinite(tangent)
        largest = np.full(len(m), np.inf)
        largest[known] = np.sqrt(np.maximum(np.linalg.eigvalsh(point[known])[:, 2], 0.0))

    def certain(values: Array) -> Array:
        return np.where(known & np.isfinite(values), values, np.inf)

    point[~known] = np.inf
    return SpatialErrors(point, largest, *(certain(value) for value in (s1_sd, beta_sd, tangent, angle, force)))
