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
# Slopes beyond a slab are equal if they differ by less than this share of their difference to the slab's.
_FLAT = 0.03
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
        share[mine] = _share(stack, int(i), angle[mine])
    # a polyhedron is straight on either side, though three slices may not show it on both
    share[flat.any(axis=1) if kink == 1 else flat.all(axis=1)] = kink
    return share


def _share(stack: Layers, i: int, angle: Array) -> Array:
    """Shares (n,) in the slab below layer i, at angles (n,)."""
    nothing = np.full(len(angle), np.nan)

    def layer(j: int) -> tuple[float, Array]:
        usable = 0 <= j < len(stack.layers) and stack.layers[j].closed
        return (stack.layers[j].height, stack.layers[j].support(angle)) if usable else (np.nan, nothing)

    # three slices on either side; steps and secants 0 1 | 2 | 3 4, with the slab's own in the middle
    z, h = zip(*(layer(j) for j in range(i - 3, i + 3)), strict=True)
    step = np.diff(np.array(z))
    secant = [(above - below) / width for below, above, width in zip(h[:-1], h[1:], step, strict=True)]
    with np.errstate(divide="ignore", invalid="ignore"):
        left, left_flat = _slope(secant[0], secant[1], secant[2], step[1], step[2])
        right, right_flat = _slope(secant[4], secant[3], secant[2], step[3], step[2])
        rise, fall = left - secant[2], secant[2] - right
        # apexes over the chord, in steps: of the tangents, and of the certain secants
        apex = rise * fall / (rise + fall)
        most = (secant[1] - secant[2]) * (secant[2] - secant[3]) / (secant[1] - secant[3])
        room = 2 * np.minimum(rise, fall) / (rise + fall)
        bend = np.fmax(
            np.where(left_flat, 0.0, (secant[1] - secant[2]) / (step[1] + step[2])),
            np.where(right_flat, 0.0, (secant[2] - secant[3]) / (step[2] + step[3])),
        )
        # the share of the turn that so much bending makes, and the length over which it does
        turned = np.minimum(1.0, 2 * bend * room * step[2] / (rise + fall))
        share = (1 - turned * np.minimum(room, 1.0) / 2) * apex / most
    # with slices on one side only, a parabola's share; in the caps nothing is known
    one_sided = _UNKNOWN if i in (0, len(stack.layers)) else _PARABOLA
    return (1 - _DOUBT) * np.where(np.isfinite(share), np.clip(share, 0.0, 1.0), one_sided) + _DOUBT * _UNKNOWN


def _slope(
    far: Array, near: Array, middle: Array, near_step: float, middle_step: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Slope (n,) at the slice between two slabs, and whether the body is flat beyond it.

    It is the neighbour's where that does not change further out, else the parabola's through three slices.
    """
    flat = np.abs(far - near) <= _FLAT * np.abs(near - middle)
    parabola = (near * middle_step + middle * near_step) / (near_step + middle_step)
    return np.where(flat, near, parabola), flat
