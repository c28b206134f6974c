"""The slices of a cloud: their support functions in the plane, and how these change from slice to slice.

A slice of a convex body has the support function ``h(θ, z) = max <n(θ), p>``, with θ the angle of the in-plane normal.  A
tangential contact gives value and derivative, ``h = <n, p>`` and ``∂h/∂θ = <t, p>``.  The surface's normal at the contact is
``(n(θ), -∂h/∂z)``, normalised, at fixed θ: not the slice's own normal.  h is concave in z, so the secants to the slices
below and above bound its slope with certainty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import ConvexHull, QhullError

import planar
from scan3d.cloud import Cloud

Array = NDArray[np.float64]
Index = NDArray[np.intp]

# Contacts whose normals differ by less, in radians, lie on one edge.
_ONE_NORMAL = 1e-9
# Directions over which a slice's Steiner point is averaged.
_STEINER_DIRECTIONS = 360


@dataclass(frozen=True)
class Layer:
    """One slice: its height, its contacts in the plane, and its support function between their normals."""

    height: float
    rows: Index
    """Contacts of the cloud (n,)."""
    points: Array
    """(n, 2) in the layers' frame."""
    lying: Index
    """Those of `rows`, by position, in tangential contact (k,): their normals are measured."""
    normals: Array
    """(k, 2) their in-plane normals."""
    tips: Index
    """Those in tip contact whose normals follow from a common friction (l,): no more than an inference."""
    tip_normals: Array
    """(l, 2) their in-plane normals."""
    outline: Array
    """(v, 2) vertices of the convex hull of the points, empty if they lie on a line."""
    angle: Array
    """(a,) distinct angles of the normals, rising."""
    value: Array
    """(a,) support function there."""
    slope: Array
    """(2, a) its one-sided derivatives in θ, left and right: they differ on an edge."""
    corner: Array
    """(a, 2, 2) contacts with that normal at the edge's left and right end."""

    @property
    def closed(self) -> bool:
        """Whether the known normals leave no gap of half a turn: the support lines enclose the slice."""
        return len(self.angle) >= 3 and bool(np.diff(self.angle, append=self.angle[0] + 2 * np.pi).max() < np.pi - 1e-9)

    def least(self, normals: Array) -> Array:
        """Lower bound (n,) of the support function for unit normals (n, 2): the support function of the contacts."""
        corners = self.outline if len(self.outline) else self.points
        return (normals @ corners.T).max(axis=1)

    def support(self, angle: Array) -> Array:
        """Support function (n,) at angles (n,): Hermite's cubic between the known normals, inside what is certain."""
        shifted = self.angle[0] + np.mod(angle - self.angle[0], 2 * np.pi)
        i = np.searchsorted(self.angle, shifted, side="right") - 1
        j = (i + 1) % len(self.angle)
        width = np.mod(self.angle[j] - self.angle[i], 2 * np.pi)
        width = np.where(width == 0, 2 * np.pi, width)
        t = (shifted - self.angle[i]) / width
        a, b, da, db = self.value[i], self.value[j], self.slope[1, i], self.slope[0, j]
        cubic = (1 - t) ** 2 * (a * (1 + 2 * t) + width * da * t) + t * t * (b * (3 - 2 * t) - width * db * (1 - t))
        n = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        least = np.maximum((n * self.corner[i, 1]).sum(axis=1), (n * self.corner[j, 0]).sum(axis=1))
        # the corner of the two support lines bounds h from above
        with np.errstate(divide="ignore", invalid="ignore"):
            most = (a * np.sin(width * (1 - t)) + b * np.sin(width * t)) / np.sin(width)
        most = np.where((width < np.pi) & np.isfinite(most), np.maximum(most, least), np.inf)
        return np.clip(cubic, least, most)

    def steiner_point(self) -> Array:
        """(2,) the slice's Steiner point, ``(1/π) ∫ h n dθ``."""
        angle = 2 * np.pi * np.arange(_STEINER_DIRECTIONS) / _STEINER_DIRECTIONS
        h = self.support(angle)
        return 2 * np.array([np.mean(h * np.cos(angle)), np.mean(h * np.sin(angle))])


@dataclass(frozen=True)
class Layers:
    """Parallel slices of a cloud, from below, and the heights of the nearest empty ones."""

    frame: Array
    """(3, 3) rows: x, y and z axes of the layers' frame in the world."""
    layers: tuple[Layer, ...]
    floor: float
    """Height of the nearest empty slice below, -inf if there is none."""
    ceiling: float
    firm: tuple[bool, bool] = (False, False)
    """Whether floor and ceiling are where contacts of other slices say that the body ends, rather than empty slices."""

    @property
    def heights(self) -> Array:
        return np.array([layer.height for layer in self.layers])


def stacks(cloud: Cloud) -> list[Layers]:
    """The cloud's slices, one stack for each axis it was sliced along."""
    found = []
    for axis in np.unique(np.round(cloud.slice_axis, 9), axis=0):
        mine = np.flatnonzero(np.abs(cloud.slice_axis - axis).max(axis=1) < 1e-8)
        frame = slice_frame(cloud.slice_axis[mine[0]])
        order = mine[np.argsort(cloud.slice_height[mine])]
        layers = [_layer(cloud, frame, number) for number in order]
        filled = [layer for layer in layers if len(layer.rows)]
        if not filled:
            continue
        empty = [layer.height for layer in layers if not len(layer.rows)]
        low, high = filled[0].height, filled[-1].height
        floor = max((z for z in empty if z < low), default=-np.inf)
        ceiling = min((z for z in empty if z > high), default=np.inf)
        found.append(Layers(frame, tuple(filled), floor, ceiling))
    return found


def slice_frame(axis: Array) -> Array:
    """Rows: x, y and z axes (3, 3) of the slices' frame, z along `axis` (3,); the identity for the z axis."""
    z = axis / np.linalg.norm(axis)
    helper = np.eye(3)[[2, 0, 1][int(np.argmax(np.abs(z)))]]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _layer(cloud: Cloud, frame: Array, number: int) -> Layer:
    rows = np.flatnonzero(cloud.slice == number)
    points = cloud.points[rows] @ frame[:2].T
    known = np.isfinite(cloud.in_plane_normals[rows, 0])
    tangential = cloud.phase[rows] == planar.Phase.TANGENTIAL
    lying, tips = np.flatnonzero(known & tangential), np.flatnonzero(known & ~tangential)
    normals, tip_normals = (cloud.in_plane_normals[rows[part]] @ frame[:2].T for part in (lying, tips))
    raw = np.arctan2(normals[:, 1], normals[:, 0])
    order = np.argsort(raw, kind="stable")
    group = np.cumsum(np.diff(raw[order], prepend=raw[order][:1]) > _ONE_NORMAL)
    member = np.empty(len(raw), dtype=np.intp)
    member[order] = group
    count = int(group[-1]) + 1 if len(group) else 0
    angle = raw[order][np.searchsorted(group, np.arange(count))]
    n, t = np.stack([np.cos(angle), np.sin(angle)], axis=1), np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    at = points[lying]
    value = np.full(count, -np.inf)
    np.maximum.at(value, member, (at * n[member]).sum(axis=1))
    along = (at * t[member]).sum(axis=1)
    ends = np.lexsort((along, member))
    left = ends[np.searchsorted(member[ends], np.arange(count))]
    right = ends[np.searchsorted(member[ends], np.arange(count), side="right") - 1]
    slope = np.stack([along[left], along[right]])
    corner = np.stack([at[left], at[right]], axis=1)
    return Layer(
        float(cloud.slice_height[number]),
        rows,
        points,
        lying,
        normals,
        tips,
        tip_normals,
        _outline(points),
        angle,
        value,
        slope,
        corner,
    )


def _outline(points: Array) -> Array:
    if len(points) < 3:
        return np.empty((0, 2))
    try:
        return points[ConvexHull(points - points.mean(axis=0)).vertices]
    except QhullError:
        return np.empty((0, 2))


def height_slopes(stack: Layers) -> list[tuple[Array, Array]]:
    """∂h/∂z at the contacts of every layer, `lying` (k,) and `tips` (l,); NaN where one layer is all there is.

    ``(h - <c, n>)²``, with c(z) the Steiner point, is nearly a parabola in z, poles included (it is one for ellipsoids); its
    cubic spline gives the slope, which is then held between the secants that concavity prescribes.
    """
    z = stack.heights
    usable = np.array([layer.closed for layer in stack.layers])
    slopes = [(np.full(len(layer.lying), np.nan), np.full(len(layer.tips), np.nan)) for layer in stack.layers]
    known = np.flatnonzero(usable)
    if len(known) < 2:
        return slopes
    centers = np.array([stack.layers[i].steiner_point() for i in known])
    center_slope = _spline(z[known], centers)(z[known], 1)
    for k, i in enumerate(known):
        layer = stack.layers[i]
        normals = np.concatenate([layer.normals, layer.tip_normals])
        angle = np.arctan2(normals[:, 1], normals[:, 0])
        h = np.stack([stack.layers[j].support(angle) for j in known])
        below = (h[k] - h[k - 1]) / (z[i] - z[known[k - 1]]) if k else np.full(len(angle), np.inf)
        above = (h[k + 1] - h[k]) / (z[known[k + 1]] - z[i]) if k + 1 < len(known) else np.full(len(angle), -np.inf)
        reach = h - centers @ normals.T
        squared_slope = _spline(z[known], reach**2)(z[i], 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = normals @ center_slope[k] + squared_slope / (2 * reach[k])
        slope = np.where(np.isfinite(slope), slope, np.where(np.isfinite(above), above, below))
        slope = np.clip(slope, np.minimum(above, below), np.maximum(above, below))
        slopes[i] = slope[: len(layer.lying)], slope[len(layer.lying) :]
    return slopes


def _spline(z: Array, values: Array) -> CubicSpline:
    return CubicSpline(z, values, bc_type="not-a-knot" if len(z) > 3 else "natural")
