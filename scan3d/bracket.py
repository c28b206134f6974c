"""An inner and an outer body from touch alone, and the certified distance between them.

The convex hull of the contacts lies inside the body.  Outside it: at a fixed normal angle θ a slice's support function is
concave in the height z, so that beyond a contact it stays below the secant from the slice behind, extrapolated,

    <n, p> <= h + σ (z - z_i),        σ = (h - h_before) / (z_i - z_before),

with h exact at the contact and ``h_before`` at least the support of the contacts there.  Between two slices this holds from
both sides; past the end slices from one, up to the next height at which a slice has found nothing.  These half-spaces cut
each slab between slices to a polyhedron, and the body lies in their union.

The distance to a convex set is convex, so over a polyhedron it is largest at a corner: the largest distance of the corners
from the hull bounds the Hausdorff distance of the hull to the unknown body, whatever that is, as long as it is convex and
the contacts are right.  Half-spaces that noisy contacts give are moved out by a margin first.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from scan3d.cloud import Cloud
from scan3d.comparison import compare, nearest
from scan3d.hulls import hull
from scan3d.layers import Layer, Layers, stacks

Array = NDArray[np.float64]

# Corners this close to a slice's plane, relative to the slab's thickness, lie in it.
_IN_PLANE = 1e-9

# Corners farther than this many widths of the slices belong to half-spaces that do not close.
_FAR = 1e6

# Slopes behind a slab are equal if they differ by less than this share of their difference to the slab's.
_FLAT = 0.03

# Rounding of a support function, relative to it.
_ROUNDING = 1e-12

# Offset of a dual facet that is zero to rounding: its corner lies at infinity.
_ON_THE_EDGE = 1e-12


class Gap(IntEnum):
    """What a part of the uncertainty comes from."""

    SLICES = 0
    """The body between two slices."""
    CONTACTS = 1
    """A slice's contour between two contacts."""
    CAPS = 2
    """The body past its end slices."""


@dataclass(frozen=True)
class Bracket:
    """Inner and outer body, in the cloud's unit."""

    inner: Any
    """Convex hull of the contacts, a `trimesh.Trimesh`."""
    corners: Array
    """(w, 3) corners of the outer body's slabs."""
    gap: Array
    """(w,) their distance from the inner body."""
    kind: NDArray[np.int8]
    """(w,) of `Gap`."""
    flat: NDArray[np.bool_]
    """(w, 2) whether the body goes on straight below and above the corner's slab."""
    slab: NDArray[np.intp]
    """(w,) the slab's number: that below the layer of this number in `stack`."""
    stack: Layers
    """The slices between which the slabs are."""
    bound: float
    """The Hausdorff distance of the inner body to the true one is no larger; infinite if nothing bounds its height."""
    margin: float
    """Distance by which noisy contacts may be off, contained in `bound`."""
    volume: tuple[float, float]
    """Bounds of the true volume."""

    def part(self, kind: Gap) -> float:
        """The bound as far as it comes from one kind of gap."""
        mine = self.gap[self.kind == kind]
        return float(mine.max()) if len(mine) else 0.0


class Slab(NamedTuple):
    """The outer body between two heights."""

    corners: Array
    """(w, 3) in the world; one infinite corner if nothing bounds the slab."""
    kind: NDArray[np.int8]
    """(w,) of `Gap`."""
    flat: NDArray[np.bool_]
    """(w, 2) whether all half-spaces of the corner that come from below, and from above, go on straight beyond the slab."""
    volume: float


def bracket(cloud: Cloud, margin: float = 0.0) -> Bracket:
    """The bracket of a cloud whose contacts and normals are off by no more than `margin`, in its unit."""
    inner = hull(cloud.points)
    found = stacks(cloud)
    outer = [slabs(stack, margin) for stack in found]
    if len(found) > 1:
        # another stack may bound a stack's height where no empty slice does, or more tightly
        found = [_lidded(k, found, outer) for k in range(len(found))]
        outer = [slabs(stack, margin) for stack in found]
    best: Bracket | None = None
    for stack, parts in zip(found, outer, strict=True):
        corners, kind, flat = (np.concatenate([part[i] for part in parts]) for i in range(3))
        slab = np.repeat(np.arange(len(parts)), [len(part.corners) for part in parts])
        gap = np.full(len(corners), np.inf)
        bounded = np.isfinite(corners).all(axis=1)
        gap[bounded] = outside(corners[bounded], inner)
        volume = inner.volume, max(sum(part.volume for part in parts), inner.volume)
        if best is None or gap.max() + margin < best.bound:
            best = Bracket(inner, corners, gap, kind, flat, slab, stack, float(gap.max()) + margin, margin, volume)
    assert best is not None
    return best


def slabs(stack: Layers, margin: float = 0.0, known: dict[tuple[float, ...], Slab] | None = None) -> list[Slab]:
    """The slabs of a stack from below; those that depend on the same slices are taken from `known`, and added to it."""
    known = {} if known is None else known
    heights = [-np.inf, -np.inf, stack.floor, *stack.heights, stack.ceiling, np.inf, np.inf]
    found = []
    for i in range(len(stack.layers) + 1):
        key = tuple(heights[i : i + 6])
        if key not in known:
            known[key] = _slab(stack, i, margin)
        found.append(known[key])
    return found


def certificate(found: Bracket, surface: Any) -> tuple[float, Array]:
    """Certified bound of a surface's Hausdorff distance to the true body, and the local bound at its vertices (v,).

    Of a hull (``hulls.hull``) by the outer body's corners.  A surface that is not convex, or open, is held against the inner
    body, whose own bound is added.
    """
    if not surface.metadata.get("convex"):
        local = np.abs(nearest(np.asarray(surface.vertices), found.inner)[0])
        return compare(surface, found.inner).upper + found.bound, local + found.bound
    local = outside(np.asarray(surface.vertices), found.inner)
    distance, face = _outside_with_face(found.corners, surface)
    np.maximum.at(local, surface.faces[face].ravel(), np.repeat(distance, 3))
    bound = float(max(local.max(), distance.max(initial=0.0))) if np.isfinite(found.bound) else np.inf
    return bound + found.margin, local + found.margin


def outside(points: Array, body: Any) -> Array:
    """Distance (n,) of points (n, 3) to a convex body, 0 inside."""
    return _outside_with_face(points, body)[0]


def _outside_with_face(points: Array, body: Any) -> tuple[Array, NDArray[np.int64]]:
    signed, face, _ = nearest(points, body)
    return np.maximum(signed, 0.0), face


def _lidded(k: int, found: list[Layers], outer: list[list[Slab]]) -> Layers:
    """A stack whose floor and ceiling are also bounded by the other stacks' outer bodies."""
    stack = found[k]
    low, high = stack.floor, stack.ceiling
    firm = [False, False]
    for j, parts in enumerate(outer):
        corners = np.concatenate([slab.corners for slab in parts])
        if j != k and np.isfinite(corners).all():
            heights = corners @ stack.frame[2]
            firm = [firm[0] or bool(heights.min() > low), firm[1] or bool(heights.max() < high)]
            low, high = max(low, float(heights.min())), min(high, float(heights.max()))
    low, high = min(low, stack.layers[0].height), max(high, stack.layers[-1].height)
    return Layers(stack.frame, stack.layers, low, high, (firm[0], firm[1]))


def _slab(stack: Layers, i: int, margin: float) -> Slab:
    """The slab below layer i."""
    layers, count = stack.layers, len(stack.layers)
    below, above = (layers[i - 1] if i else None), (layers[i] if i < count else None)
    low = below.height if below else stack.floor
    high = above.height if above else stack.ceiling
    inner_kind = Gap.CAPS if below is None or above is None else Gap.SLICES
    unbounded = Slab(
        np.full((1, 3), np.inf), np.array([inner_kind], dtype=np.int8), np.zeros((1, 2), dtype=bool), np.inf
    )
    if not (np.isfinite(low) and np.isfinite(high)):
        return unbounded
    if high <= low:
        return Slab(np.empty((0, 3)), np.empty(0, dtype=np.int8), np.empty((0, 2), dtype=bool), 0.0)
    rows = []
    if below is not None and i >= 2:
        rows.append(_half_spaces(below, layers[i - 2], margin))
    if above is not None and i + 1 < count:
        rows.append(_half_spaces(above, layers[i + 1], margin))
    inside = _inner_point(below, above, low, high, rows)
    if not rows or inside is None:
        return unbounded
    thickness = high - low
    planes = np.concatenate([*rows, [[0.0, 0.0, 1.0, -high], [0.0, 0.0, -1.0, low]]])
    # from below, from above, or of an empty slice, which cuts off what is not the body's shape
    side = np.full(len(planes), -1)
    straight = np.zeros(len(planes), dtype=bool)
    if below is not None and i >= 2:
        side[: len(rows[0])] = 0
        straight[: len(rows[0])] = _straight(layers[:i][::-1], above)
    if above is not None and i + 1 < count:
        side[-2 - len(rows[-1]) : -2] = 1
        straight[-2 - len(rows[-1]) : -2] = _straight(layers[i:], below)
    straight[-2:] = stack.firm[1] and above is None, stack.firm[0] and below is None
    # past an end slice there is one side only
    lone = above is None or below is None
    # shifted to the inner point and stretched to unit size, the thin slabs are no trouble for Qhull
    planes[:, 3] += planes[:, :3] @ inside
    size = np.array([max(float(np.ptp(layer.points)) for layer in (below, above) if layer)] * 2 + [thickness])
    planes[:, :3] *= size
    planes /= np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    try:
        with np.errstate(divide="ignore", invalid="ignore"):
            cut = _qhull(HalfspaceIntersection, planes, np.zeros(3))
        # the half-spaces close only where their dual points have the inner point among them
        if not (cut.dual_equations[:, 3] < -_ON_THE_EDGE).all():
            return unbounded
        corners = cut.intersections
        volume = _qhull(ConvexHull, corners).volume * float(np.prod(size))
    except (QhullError, ValueError):
        return unbounded
    if np.abs(corners[:, :2]).max() > _FAR:
        return unbounded
    corners = inside + corners * size
    # in the plane of a slice: of one whose half-spaces bound it there, or of an end slice, where the body can't be so wide
    on_low, on_high = (np.abs(corners[:, 2] - z) <= _IN_PLANE * thickness for z in (low, high))
    in_plane = (on_low & (i >= 2)) | (on_high & (above is not None) & (i + 1 < count))
    on_end = (on_low & (i == 1)) | (on_high & (above is not None) & (i + 1 == count))
    kind = np.where(in_plane, Gap.CONTACTS, inner_kind).astype(np.int8)
    flat = np.array([_flat(side[of], straight[of], lone) for of in cut.dual_facets]) & ~on_end[:, None]
    return Slab(corners @ stack.frame, kind, flat, volume)


def _qhull(build: Any, *inputs: Array) -> Any:
    """Qhull, joggling the input by rounding where nearly equal planes or points confuse it."""
    try:
        return build(*inputs)
    except QhullError:
        return build(*inputs, qhull_options="QJ")


def _half_spaces(layer: Layer, behind: Layer, margin: float) -> Array:
    """Rows (k, 4) ``a·x + b <= 0``: the layer's supporting lines, leaned along the secants from the layer behind."""
    normals = np.stack([np.cos(layer.angle), np.sin(layer.angle)], axis=1)
    value = layer.value + margin
    secant = (value - (behind.least(normals) - margin)) / (layer.height - behind.height)
    return np.column_stack([normals, -secant, secant * layer.height - value])


def _flat(side: Array, straight: NDArray[np.bool_], lone: bool) -> tuple[bool, bool]:
    """Whether a corner's half-spaces from below, and from above, all go on straight behind the slab; both if one is lone."""
    if lone:
        good = bool(straight.all())
        return good, good
    below, above = side == 0, side == 1
    return bool(below.any() and straight[below].all()), bool(above.any() and straight[above].all())


def _straight(behind: tuple[Layer, ...], beyond: Layer | None) -> NDArray[np.bool_]:
    """Whether the body goes on straight behind a slab's layer at the layer's normals (k,).

    `behind` are the layer and those farther and farther from the slab, `beyond` is the one on the slab's other side; past an
    end slice there is none, and only rounding is allowed for.
    """
    if len(behind) < 3:
        return np.zeros(len(behind[0].angle), dtype=bool)
    normals = np.stack([np.cos(behind[0].angle), np.sin(behind[0].angle)], axis=1)
    near, far, turned = (
        (b.least(normals) - a.least(normals)) / (b.height - a.height)
        for a, b in ((behind[0], behind[1]), (behind[1], behind[2]), (behind[0], beyond or behind[1]))
    )
    rounding = (
        _ROUNDING * np.abs(behind[0].value).max() / min(abs(a.height - b.height) for a, b in pairwise(behind[:3]))
    )
    return np.abs(near - far) <= _FLAT * np.abs(near - turned) + rounding


def _inner_point(below: Layer | None, above: Layer | None, low: float, high: float, rows: list[Array]) -> Array | None:
    """A point well inside the slab's half-spaces, on the way between the middles of its slices."""
    middles = [layer.outline.mean(axis=0) for layer in (below, above) if layer is not None and len(layer.outline)]
    if not middles or not rows:
        return None
    planes = np.concatenate(rows)
    shares = (0.5, 0.1, 1e-2, 1e-3, 1e-5, 1e-8)
    for share in shares:
        if below is not None and above is not None:
            z = (low + high) / 2
        else:
            z = low + share * (high - low) if below is not None else high - share * (high - low)
        point = np.array([*np.mean(middles, axis=0), z])
        if (planes[:, :3] @ point + planes[:, 3] < 0).all():
            return point
    return None
