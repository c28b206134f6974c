"""The body between its slices: support functions interpolated from slice to slice, within what concavity allows.

At a fixed normal angle θ the square of the support function about the Steiner point is nearly a parabola in the height.
Between two slices it is Hermite's cubic of the values and slopes there (`layers.height_slopes`); the support function that
follows is held between its certain bounds, the chord below and the neighbouring secants above.  Past an end slice the
parabola of the last spacing goes on, if it closes before the next empty slice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import HalfspaceIntersection, QhullError

from scan3d.layers import Layer, Layers, height_slopes

Array = NDArray[np.float64]

# Slices put between two neighbours: the chord's error falls with the square of their number plus one.
_BETWEEN = np.array([0.25, 0.5, 0.75])
# Slices put between an end slice and the pole, as shares of the way.
_TOWARDS_POLE = np.array([0.4, 0.7, 0.9, 0.98, 0.999])
# Normals of an interpolated slice besides those of its neighbours.
_DIRECTIONS = 360


def interpolated(stack: Layers) -> Array:
    """Points (n, 3), in the world, of slices between those of a stack: the corners of their support lines."""
    slopes = height_slopes(stack)
    usable = [i for i, layer in enumerate(stack.layers) if layer.closed and np.isfinite(slopes[i]).any()]
    if len(usable) < 4:
        return np.empty((0, 3))
    layers = [stack.layers[i] for i in usable]
    lean = [_Lean(layers[k], slopes[i]) for k, i in enumerate(usable)]
    z = np.array([layer.height for layer in layers])
    centers = np.array([layer.steiner_point() for layer in layers])
    center_slopes = np.gradient(centers, z, axis=0)
    points = []
    for i in range(len(layers) - 1):
        points += _between(layers, lean, z, centers, center_slopes, i)
    for end, behind, limit in ((0, 1, stack.floor), (-1, -2, stack.ceiling)):
        points += _past(layers, lean, z, centers, center_slopes, end, behind, limit)
    return np.concatenate(points) @ stack.frame if points else np.empty((0, 3))


class _Lean:
    """∂h/∂z of a layer as a function of θ."""

    def __init__(self, layer: Layer, slopes: Array) -> None:
        angle = np.arctan2(layer.normals[:, 1], layer.normals[:, 0])
        order = np.argsort(angle)
        self._angle, self._slope = angle[order], slopes[order]

    def __call__(self, angle: Array) -> Array:
        return np.interp(angle, self._angle, self._slope, period=2 * np.pi)


def _normals(*layers: Layer) -> tuple[Array, Array]:
    """Angles (a,) and unit vectors (a, 2): those of the layers, where their edges are, and evenly spread ones."""
    even = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS - np.pi
    angle = np.unique(np.round(np.concatenate([even, *(layer.angle for layer in layers)]), 10))
    return angle, np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _between(
    layers: list[Layer], lean: list[_Lean], z: Array, centers: Array, center_slopes: Array, i: int
) -> list[Array]:
    low, high = layers[i], layers[i + 1]
    angle, normals = _normals(low, high)
    step = z[i + 1] - z[i]
    h = [layer.support(angle) for layer in (low, high)]
    reach = [h[k] - normals @ centers[i + k] for k in (0, 1)]
    rate = [2 * reach[k] * (lean[i + k](angle) - normals @ center_slopes[i + k]) for k in (0, 1)]
    secant = (h[1] - h[0]) / step
    before = (h[0] - layers[i - 1].support(angle)) / (z[i] - z[i - 1]) if i else np.full(len(angle), np.inf)
    after = np.full(len(angle), -np.inf)
    if i + 2 < len(layers):
        after = (layers[i + 2].support(angle) - h[1]) / (z[i + 2] - z[i + 1])
    found = []
    for t in _BETWEEN:
        squared = _hermite(t, step, reach[0] ** 2, reach[1] ** 2, rate[0], rate[1])
        center = _hermite(t, step, centers[i], centers[i + 1], center_slopes[i], center_slopes[i + 1])
        value = normals @ center + np.sqrt(np.maximum(squared, 0.0))
        least = h[0] + t * step * secant
        most = np.minimum(
            h[0] + t * step * np.maximum(before, secant), h[1] - (1 - t) * step * np.minimum(after, secant)
        )
        found.append(_outline(normals, np.clip(value, least, most), center, z[i] + t * step))
    return found


def _past(
    layers: list[Layer],
    lean: list[_Lean],
    z: Array,
    centers: Array,
    center_slopes: Array,
    end: int,
    behind: int,
    limit: float,
) -> list[Array]:
    """Slices on the way from an end slice to the pole; none if the body does not close before the limit."""
    angle, normals = _normals(layers[end])
    step = z[behind] - z[end]  # away from the pole
    h, inner = layers[end].support(angle), layers[behind].support(angle)
    reach, inner_reach = h - normals @ centers[end], inner - normals @ centers[behind]
    rate = 2 * reach * (lean[end](angle) - normals @ center_slopes[end])
    bend = (inner_reach**2 - reach**2 - rate * step) / step**2
    # where the parabola reach² + rate w + bend w² vanishes, w against the step
    discriminant = rate**2 - 4 * bend * reach**2
    with np.errstate(divide="ignore", invalid="ignore"):
        root = 2 * reach**2 / (-rate * np.sign(step) + np.sqrt(np.maximum(discriminant, 0.0))) * -np.sign(step)
        root = np.where((discriminant >= 0) & (root * step < 0), root, -np.sign(step) * np.inf)
    way = float(np.median(root))
    if not np.isfinite(way) or abs(way) >= abs(limit - z[end]):
        return []
    secant = (inner - h) / step
    found = []
    for share in _TOWARDS_POLE:
        w = share * way
        squared = reach**2 + rate * w + bend * w**2
        center = centers[end] + w * center_slopes[end]
        value = np.minimum(normals @ center + np.sqrt(np.maximum(squared, 0.0)), h + w * secant)
        found.append(_outline(normals, value, center, z[end] + w))
    return found


def _hermite(t: float, step: float, a: Array, b: Array, da: Array, db: Array) -> Array:
    return (1 - t) ** 2 * ((1 + 2 * t) * a + t * step * da) + t**2 * ((3 - 2 * t) * b - (1 - t) * step * db)


def _outline(normals: Array, value: Array, center: Array, height: float) -> Array:
    """Corners (n, 3) of the support lines ``<n, p> <= value`` at a height; none where they enclose nothing."""
    room = value - normals @ center
    if not (room > 0).all():
        return np.empty((0, 3))
    try:
        corners = HalfspaceIntersection(np.column_stack([normals, -room]), np.zeros(2)).intersections
    except QhullError:
        return np.empty((0, 3))
    corners = corners[np.isfinite(corners).all(axis=1)]
    return np.column_stack([center + corners, np.full(len(corners), height)])
