"""Where between the inner and the outer body the true one most likely lies.

At a fixed normal angle θ the support function is concave in the height z.  In the slab between two slices it runs above
their chord and below the tangents there, and the outer body's corner is where the extrapolated neighbouring secants meet.
How near to that corner the body comes depends on how the turn of the slope is spread over the slab:

- where the slopes beyond either end do not change, the body is a polyhedron's, and turns in one kink: it reaches the corner;
- where they change steadily, it turns all along, as a parabola does, which passes half way below the tangents' apex;
- between a flat and a curved part it turns in an arc about the apex, as long as the curvature beyond the slab makes it: a
  parabola from tangent to tangent, a quarter of the turn times its half length below the apex.

This is a guess, by the slices on either side, and where it fails the certificate still holds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from scan3d.layers import Layer, Layers

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


def middles(stack: Layers) -> Array:
    """Points (n, 3) in the world on the contours that the body most likely has half way between its slices.

    The outer body's corners are far between where a flat face ends inside a slab; these go all around it.
    """
    found = [np.empty((0, 3))]
    for i in range(1, len(stack.layers)):
        below, above = stack.layers[i - 1], stack.layers[i]
        if not (below.closed and above.closed):
            continue
        angle = np.concatenate([below.angle, above.angle])
        chord = (below.support(angle) + above.support(angle)) / 2
        most = np.concatenate(
            [
                _beyond(below, stack.layers[i - 2] if i > 1 else None, above),
                _beyond(above, stack.layers[i + 1] if i + 1 < len(stack.layers) else None, below),
            ]
        )
        height = np.minimum(chord + _turn(stack, i, angle).above_chord(), most)
        contour = _contour(angle, height, (below.outline.mean(axis=0) + above.outline.mean(axis=0)) / 2)
        level = np.full((len(contour), 1), (below.height + above.height) / 2)
        found.append(np.hstack([contour, level]) @ stack.frame)
    return np.concatenate(found)


def _beyond(layer: Layer, behind: Layer | None, ahead: Layer) -> Array:
    """Upper bound (a,) of the support function half way to the layer ahead, at the layer's angles; inf if none is behind."""
    if behind is None:
        return np.full(len(layer.angle), np.inf)
    normals = np.stack([np.cos(layer.angle), np.sin(layer.angle)], axis=1)
    secant = (layer.value - behind.least(normals)) / (layer.height - behind.height)
    return layer.value + secant * (ahead.height - layer.height) / 2


def _contour(angle: Array, height: Array, inside: Array) -> Array:
    """Points (n, 2) on the contour about the point `inside` (2,) whose support lines at angles (k,) have heights (k,)."""
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    room = height - normals @ inside
    if not (room > 0).all():
        return np.empty((0, 2))
    edges = ConvexHull(normals / room[:, None]).equations
    corners = inside - edges[:, :2] / edges[:, 2:]
    corners = corners[np.argsort(np.arctan2(*(corners - inside).T))]
    touched = (corners + np.roll(corners, -1, axis=0)) / 2
    # between two support lines it may be round or have their corner
    return np.concatenate([touched, (2 * corners + touched + np.roll(touched, 1, axis=0)) / 4])


def _share(stack: Layers, i: int, angle: Array) -> Array:
    """Shares (n,) in the slab below layer i, at angles (n,)."""
    # with slices on one side only, a parabola's share; in the caps nothing is known
    one_sided = _UNKNOWN if i in (0, len(stack.layers)) else _PARABOLA
    share = _turn(stack, i, angle).share()
    return (1 - _DOUBT) * np.where(np.isfinite(share), np.clip(share, 0.0, 1.0), one_sided) + _DOUBT * _UNKNOWN


@dataclass(frozen=True)
class _Turn:
    """How the slope of the support function turns in a slab, at angles (n,); NaN where there are too few slices."""

    step: float
    """The slab's thickness."""
    rise: Array
    """Slope at the lower end, less that of the chord."""
    fall: Array
    """Slope of the chord, less that at the upper end."""
    certain_rise: Array
    """The same of the secants next to the slab: never less."""
    certain_fall: Array
    arc: Array
    """Half the length of the arc about the tangents' apex, in steps."""

    def share(self) -> Array:
        """Height above the chord at the tangents' apex, in that of the secants' apex."""
        with np.errstate(divide="ignore", invalid="ignore"):
            most = self.certain_rise * self.certain_fall / (self.certain_rise + self.certain_fall)
            turn = self.rise + self.fall
            return (self.rise * self.fall / turn - turn * self.arc / 4) / most

    def above_chord(self) -> Array:
        """Height above the chord half way up; where it is known from one side only, that of a parabola."""
        rise, fall = np.fmax(self.rise, 0.0), np.fmax(self.fall, 0.0)
        rise, fall = np.where(np.isnan(self.rise), fall, rise), np.where(np.isnan(self.fall), rise, fall)
        turn = rise + fall
        with np.errstate(divide="ignore", invalid="ignore"):
            arc = np.where(np.isnan(self.arc), 0.5, self.arc)
            overlap = np.maximum(arc - np.abs(0.5 - fall / turn), 0.0)
            height = np.minimum(rise, fall) / 2 - np.where(overlap > 0, turn * overlap**2 / (4 * arc), 0.0)
        return self.step * np.fmax(height, 0.0)


def _turn(stack: Layers, i: int, angle: Array) -> _Turn:
    """The turn in the slab below layer i, at angles (n,)."""
    nothing = np.full(len(angle), np.nan)

    def layer(j: int) -> tuple[float, Array]:
        usable = 0 <= j < len(stack.layers) and stack.layers[j].closed
        return (stack.layers[j].height, stack.layers[j].support(angle)) if usable else (np.nan, nothing)

    # three slices on either side; steps and secants 0 1 | 2 | 3 4, with the slab's own in the middle
    z, h = zip(*(layer(j) for j in range(i - 3, i + 3)), strict=True)
    step = np.diff(np.array(z))
    secant = [(above - below) / width for below, above, width in zip(h[:-1], h[1:], step, strict=True)]
    certain_rise, certain_fall = secant[1] - secant[2], secant[2] - secant[3]
    with np.errstate(divide="ignore", invalid="ignore"):
        left, left_flat = _slope(secant[0], secant[1], secant[2], step[1], step[2])
        right, right_flat = _slope(secant[4], secant[3], secant[2], step[3], step[2])
        rise, fall = left - secant[2], secant[2] - right
        bend = np.fmax(
            np.where(left_flat, 0.0, certain_rise / (step[1] + step[2])),
            np.where(right_flat, 0.0, certain_fall / (step[2] + step[3])),
        )
        # the arc fits in on both sides of the apex, and is no longer than so much bending makes the turn
        fits = np.minimum(rise, fall) / (rise + fall)
        turned = np.minimum(1.0, 4 * bend * fits * step[2] / (rise + fall))
    return _Turn(float(step[2]), rise, fall, certain_rise, certain_fall, turned * fits)


def _slope(
    far: Array, near: Array, middle: Array, near_step: float, middle_step: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Slope (n,) at the slice between two slabs, and whether the body is flat beyond it.

    It is the neighbour's where that does not change further out, else the parabola's through three slices.
    """
    flat = np.abs(far - near) <= _FLAT * np.abs(near - middle)
    parabola = (near * middle_step + middle * near_step) / (near_step + middle_step)
    return np.where(flat, near, parabola), flat
