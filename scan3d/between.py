"""Where between the inner and the outer body the true one most likely lies.

At a fixed normal angle θ the support function is concave in the height z.  In the slab between two slices it runs above
their chord and below the tangents there, and the outer body's corner is where the extrapolated neighbouring secants meet.
How near to that corner the body comes depends on how the turn of the slope is spread over the slab:

- where the slopes beyond either end do not change, the body is a polyhedron's, and turns in one kink: it reaches the corner;
- where they change steadily, it turns all along, as a parabola does, which passes half way below the tangents' apex;
- between a flat and a curved part the turn is an arc about the apex, as long as fits into the slab: for an arc over a share
  ``a`` of the slab, the body comes as near as ``1 - a/2`` of the apex's height over the chord.

This is a guess, by the slices on either side, and where it fails the certificate still holds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scan3d.layers import Layers

Array = NDArray[np.float64]
Index = NDArray[np.intp]

# In the caps, and where slices lack normals; every guess is drawn towards it by this weight, for half way the error is at
# most half the gap.
_UNKNOWN, _DOUBT = 0.5, 0.35
# Evenly sliced, a parabola's height over the chord, in those of the secants' apex.
_PARABOLA = 0.25


def shares(stack: Layers, away: Array, slab: Index, flat: NDArray[np.bool_], kink: float | None) -> Array:
    """Shares (w,) of the way to the outer body's corners, which are `away` (w, 3) from the inner body's nearest points.

    slab (w,) and flat (w, 2) are those of the `Bracket`.  `kink` is the share where the body goes on straight on both sides
    of a slab: 1 if it is a polyhedron; with None the body is taken for flat between its slices: 0 but in the caps.
    """
    if kink is None:
        return np.where((slab == 0) | (slab == len(stack.layers)), _UNKNOWN, 0.0)
    across = away @ stack.frame[:2].T
    angle = np.arctan2(across[:, 1], across[:, 0])
    share = np.full(len(angle), _UNKNOWN)
    for i in np.unique(slab):
        mine = slab == i
        share[mine] = _share(stack, int(i), angle[mine], flat[mine])
    # a polyhedron is straight on either side, though three slices may not show it on both
    share[flat.any(axis=1) if kink == 1 else flat.all(axis=1)] = kink
    return share


def _share(stack: Layers, i: int, angle: Array, flat: NDArray[np.bool_]) -> Array:
    """Shares (n,) in the slab below layer i, at angles (n,), with the body flat (n, 2) below and above it or not."""
    nothing = np.full(len(angle), np.nan)

    def layer(j: int) -> tuple[float, Array]:
        usable = 0 <= j < len(stack.layers) and stack.layers[j].closed
        return (stack.layers[j].height, stack.layers[j].support(angle)) if usable else (np.nan, nothing)

    # two slices on either side; steps and secants 0 | 1 | 2, with the slab's own in the middle
    z, h = zip(*(layer(j) for j in range(i - 2, i + 2)), strict=True)
    step = np.diff(np.array(z))
    secant = [(above - below) / width for below, above, width in zip(h[:-1], h[1:], step, strict=True)]
    with np.errstate(divide="ignore", invalid="ignore"):
        left_flat, right_flat = flat.T
        left = np.where(left_flat, secant[0], _slope(secant[0], secant[1], step[0], step[1]))
        right = np.where(right_flat, secant[2], _slope(secant[2], secant[1], step[2], step[1]))
        rise, fall = left - secant[1], secant[1] - right
        # apexes over the chord, in steps: of the tangents, and of the certain secants
        apex = rise * fall / (rise + fall)
        most = (secant[0] - secant[1]) * (secant[1] - secant[2]) / (secant[0] - secant[2])
        room = 2 * np.minimum(rise, fall) / (rise + fall)
        bend = np.fmax(
            np.where(left_flat, 0.0, (secant[0] - secant[1]) / (step[0] + step[1])),
            np.where(right_flat, 0.0, (secant[1] - secant[2]) / (step[1] + step[2])),
        )
        # the share of the turn that so much bending makes, and the length over which it does
        turned = np.minimum(1.0, 2 * bend * room * step[1] / (rise + fall))
        share = (1 - turned * np.minimum(room, 1.0) / 2) * apex / most
    # with slices on one side only, a parabola's share, unless the body comes straight; in the caps nothing is known
    one_sided = np.where(flat.any(axis=1) | (i == 0) | (i == len(stack.layers)), _UNKNOWN, _PARABOLA)
    return (1 - _DOUBT) * np.where(np.isfinite(share), np.clip(share, 0.0, 1.0), one_sided) + _DOUBT * _UNKNOWN


def _slope(outer: Array, middle: Array, outer_step: float, middle_step: float) -> Array:
    """Slope (n,) at the slice between two slabs, of the parabola through their three slices."""
    return (outer * middle_step + middle * outer_step) / (outer_step + middle_step)
