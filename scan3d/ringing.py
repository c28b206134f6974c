"""Rows in which a rod that touches nothing rings: after a snap-off it swings about its rest until damping ends that.

A rod in the air is linear.  Swinging with one frequency, in whatever direction across itself, each channel of its wrench obeys

    ``w(t + s) = a w(t) - b w(t - s)``,   ``a = 2 cos(ω s) exp(-δ s)``,   ``b = exp(-2 δ s)``,

with the same two numbers in all channels and no constant, at any sampling rate, also where the swing is sampled more slowly
than it moves.  A contact pushes: its wrench does not swing about zero, and the axial force swings twice as often as the
forces across the rod.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array, Mask

# Rows of a window, in steps s between the rows that the equation connects, and the least angle ω s of a step: together more
# than a period, so that the sign has changed more often than that of any sweep past a convex body.
_WINDOW, _ANGLE = 8, 1.0
# Least part of its square that a swing keeps over two steps.
_DAMPED = 0.25
# Part of the mean square of a swing that its equation may leave: other modes, and a frequency that changes with the bend.
_LEFT = 0.02
# Mean square over the variance of the noise from which a swing stands out, in which part of the rows it does, and what noise
# leaves over its expectation.
_FELT, _NEARLY_ALL, _CHANCE = 4.0, 0.6, 1.5


def ringing(wrench: Array, noise: Array, run: NDArray[np.int64]) -> Mask:
    """Rows (n,) of a tared wrench (n, c) that belong to a swing about zero.

    noise
        (c,) standard deviations; 0 where they are no more than rounding.
    run
        (n,) numbers of the stretches within which rows follow one another evenly.
    """
    found = np.zeros(len(wrench), dtype=bool)
    half = wrench.shape[1] // 2
    largest = np.repeat([np.abs(part).max(initial=0.0) for part in (wrench[:, :half], wrench[:, half:])], half)
    unit = np.hypot(noise, 1e-3 * largest)  # the weaker channels of a sensor without noise count as well
    scaled = wrench / np.where(unit > 0, unit, 1.0)
    variance = float(((noise / np.where(unit > 0, unit, 1.0)) ** 2).sum())
    edges = np.flatnonzero(np.diff(run, prepend=run[:1] - 1, append=run[-1:] + 1))
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        step = 1
        while _WINDOW * step <= last - first:
            _mark(found[first:last], scaled[first:last], step, variance)
            step *= 2
    return found


def _mark(found: Mask, wrench: Array, step: int, variance: float) -> None:
    """Mark the rows (n,) of a run in windows that swing by at least the least angle a step.

    Windows with rows that are found already are left out: longer ones would reach into contact.  `variance` is that of a
    row's noise.
    """
    before, now, after = wrench[: -2 * step], wrench[step:-step], wrench[2 * step :]
    size = (before**2).sum(axis=1) + (now**2).sum(axis=1) + (after**2).sum(axis=1)
    # rows count alike, however far the swing has died away, so that none of them is a contact
    weight = 1 / np.where(size > 0, np.maximum(size, 3 * variance), 1.0)
    products = [
        weight * (one * other).sum(axis=1)
        for one, other in ((now, now), (before, before), (before, now), (now, after), (before, after), (after, after))
    ]
    total = np.cumsum(
        np.pad(np.stack([*products, variance * weight, size > 3 * _FELT * variance], axis=1), ((1, 0), (0, 0))), axis=0
    )
    count = (_WINDOW - 2) * step
    xx, yy, xy, xz, yz, zz, share, felt = ((total[count:] - total[:-count]) / count).T
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = xx * yy - xy**2
        a, b = (xz * yy - xy * yz) / determinant, (xy * xz - xx * yz) / determinant
        left = zz - a * xz + b * yz
        swings = (b > _DAMPED) & (b < 1 + _LEFT) & (a < 2 * np.cos(_ANGLE) * np.sqrt(b)) & (felt > _NEARLY_ALL)
        swings &= left < _LEFT * xx + _CHANCE * share * (1 + a**2 + b**2)
    known = np.cumsum(np.pad(found, (1, 0)))
    start = np.flatnonzero(swings & (known[_WINDOW * step :] == known[: -_WINDOW * step]))
    inside = (
        np.bincount(start, minlength=len(wrench)) - np.bincount(start + _WINDOW * step, minlength=len(wrench) + 1)[:-1]
    )
    found |= np.cumsum(inside) > 0
