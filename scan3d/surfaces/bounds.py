"""An inner and an outer body from touch alone, and the certified distance between them.

The convex hull of the contacts lies inside the body.  The body lies in the union of the slabs that the half-spaces of the
slices leave (`scan3d.surfaces.slabs`).

The distance to a convex set is a convex function, and so it is largest over a polyhedron at one of the polyhedron's corners.
The largest distance of the outer body's corners from the hull is therefore an upper bound of the Hausdorff distance between
the hull and the unknown body, provided that the body is convex and the contacts are exact.  Where contacts are noisy, each
slice's contour is first replaced by a polygon inside it and one around it, which hold with a stated confidence
(`scan3d.surfaces.confidence`), or the half-spaces are moved outwards by a given margin.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.cloud import Cloud, Tilt
from scan3d.errors import InputError
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import hull
from scan3d.reconstruction.planes import SAME_HEIGHT
from scan3d.reconstruction.slices import SliceStack, stacks
from scan3d.surfaces.allowances import CONFIDENCE, Allowed, allowed
from scan3d.surfaces.cells import applicable, cells_of_cloud, tighter_cells
from scan3d.surfaces.confidence import confident
from scan3d.surfaces.enclosures import CellEnclosure, Enclosure, SliceEnclosure
from scan3d.surfaces.inclined import exact_error
from scan3d.surfaces.slabs import Gap, Slab, slabs
from scan3d.surfaces.spatial_bounds import spatial_enclosure

# Facets of a hull of contacts that is taken for a polyhedron, whose tangents are tried.  Larger, time is spent on curved
# bodies, which slabs bound more tightly; smaller, polyhedra are bounded less tightly.
_FEW_FACETS = 500
# Radius of the cylinder in which the body is sought whose slices are tilted, larger than the contacts by this fraction of their
# radius; the second is tried where the outer body leaves the first.  Larger, heights are more uncertain.
_WIDENED = (0.25, 2.0)
# The enclosure by cells is used if its bound is below this fraction of that by slabs.  Larger, cells are kept that hardly bound
# the body more tightly, and estimates, certificates and local bounds take several times as long; smaller, bounds are lost.
_TIGHTER = 0.95
# Rounding of volumes, relative to them: a few thousand units in the last place.
_ROUNDING = 1e-12


def enclosure(cloud: Cloud, margin: float | None = None, *, confidence: float = CONFIDENCE) -> Enclosure:
    """The enclosure of a cloud's body.

    margin
        the largest error of a contact's place, in the cloud's unit, if it is known.  By default the contacts' own uncertainty
        counts: of exact contacts the enclosure is certain, of noisy ones it holds with `confidence`, and it allows for the
        digits of the poses and for tilted slices.  With a given margin slices count as parallel.
    confidence
        probability with which the enclosure of noisy contacts holds.

    Where the cloud was sliced along several axes, the stack whose slabs give the smallest bound is used.  Exact contacts bound
    the body by the cells between the slices of all axes as well, if that is tighter, and those of a polyhedron by their
    tangents.  Contacts of the spatial model lie in no slices; their enclosure is that of `scan3d.surfaces.spatial_bounds`.
    Raises InputError for contacts that do not span a body.
    """
    if cloud.model == "spatial":
        return spatial_enclosure(cloud, margin, confidence)
    bounds = slice_enclosure(cloud, margin, confidence)
    exact = margin is None and cloud.covariance is None and cloud.calibration is None and cloud.tilt is None
    bounds = _with_cells(bounds, cloud) if exact else bounds
    return _with_tangents(bounds, cloud) if exact and len(bounds.inner.faces) <= _FEW_FACETS else bounds


def _with_cells(bounds: SliceEnclosure, cloud: Cloud) -> SliceEnclosure:
    """The enclosure with that by the cells between the slices of all axes, if it is tighter by more than a few percent."""
    by_axis = stacks(cloud)
    if not applicable(cloud, by_axis):
        return bounds
    worst = bounds.corners[bounds.gap.argmax()]
    found = (
        tighter_cells(cloud, by_axis, bounds.inner, worst, _TIGHTER * bounds.bound)
        if np.isfinite(worst).all()
        else cells_of_cloud(cloud, by_axis, bounds.inner)
    )
    if found is None:
        return bounds
    bound = max(float(found.gap.max()) if len(found.gap) else np.inf, exact_error(cloud))
    if bound >= _TIGHTER * bounds.bound:
        return bounds
    volume = bounds.volume[0], max(min(bounds.volume[1], _volume_within(bounds.inner, bound)), bounds.volume[0])
    inside = CellEnclosure(
        inner=bounds.inner, corners=found.corners, gap=found.gap, bound=bound, margin=0.0, volume=volume
    )
    return replace(bounds, tangents=inside, bound=bound, volume=volume)


def _volume_within(body: Any, distance: float) -> float:
    """Volume of all that is nearer to a convex body than `distance`, by Steiner's formula."""
    edges = np.linalg.norm(np.diff(body.vertices.view(np.ndarray)[body.face_adjacency_edges], axis=1)[:, 0], axis=1)
    curvature = float((edges * body.face_adjacency_angles).sum()) / 2
    volume = body.volume + distance * (body.area + distance * (curvature + 4 / 3 * np.pi * distance))
    return float(volume) * (1 + _ROUNDING)


def _with_tangents(bounds: SliceEnclosure, cloud: Cloud) -> SliceEnclosure:
    """The enclosure with that by the tangents of all contacts, if it is tighter."""
    tangents = np.cross(cloud.in_plane_normals, cloud.slice_axis[cloud.slice])
    anywhere = replace(cloud, centre_points=cloud.points, tangents=tangents, rod_radius=0.0)
    found = spatial_enclosure(anywhere, None, bounds.confidence)
    if found.bound >= bounds.bound:
        return bounds
    volume = max(bounds.volume[0], found.volume[0]), min(bounds.volume[1], found.volume[1])
    return replace(bounds, tangents=found, bound=found.bound, volume=volume)


def slice_enclosure(cloud: Cloud, margin: float | None = None, confidence: float = CONFIDENCE) -> SliceEnclosure:
    """The enclosure by contacts in slices, as `enclosure`.

    Let a row's plane be tilted against its slice by the angle τ, and let the body lie within a distance R of an axis
    through the contacts, which lie within r of it.  A body's supporting plane through a contact p contains the rod's
    tangent there.  With the tangent's direction t and the normal n across it, both seen along the axis,
    ``<n, x - p> <= g (z - z')`` holds for all x of the body and some slope g, with the height z' of the row's plane at
    the point of the tangent that is nearest to x as seen along the axis.  That point lies within √(R² + r²) of the axis, and z'
    differs from the height of the slice by at most ``spread + √(R² + r²) tan τ`` (`scan3d.cloud.Tilt`).  So the
    half-spaces are those of heights that are uncertain by this.  They hold within the cylinder; if the outer body
    between two slices lies in its interior, then so does the body there, since it is connected.
    """
    if cloud.tilt is None or margin is not None:
        return _by_slices(cloud, margin, confidence)
    for widened in _WIDENED:
        bounds = _by_slices(cloud, None, confidence, 1 + widened)
        corners = bounds.corners[np.isfinite(bounds.corners).all(axis=1)]
        reach = _distances(corners, bounds.stack, cloud.tilt).max(initial=0.0)
        if reach < (1 + widened) * _distances(cloud.points, bounds.stack, cloud.tilt).max():
            return bounds
    return _unbounded(hull(cloud.points), bounds.stack, bounds.confidence)


def _distances(points: Array, stack: SliceStack, tilt: Tilt) -> Array:
    """Distances (n,) of points (n, 3) from the stack's axis through the centre of the tilted planes."""
    across: Array = np.linalg.norm((points - tilt.centre) @ stack.frame[:2].T, axis=1)
    return across


def _by_slices(cloud: Cloud, margin: float | None, confidence: float, widened: float = 1.0) -> SliceEnclosure:
    """The enclosure by contacts in slices, of a body that lies in a cylinder `widened` times as wide as the contacts."""
    by_axis = stacks(cloud)
    inner = hull(cloud.points)
    excess = 0.0
    if margin is None:
        off = [_height_error(stack, cloud) for stack in by_axis]
        allow = allowed(cloud, confidence)
        confidence = allow.confidence
        by_axis = [
            replace(stack, height_error=max(error, _tilt_error(stack, cloud, widened)) + allow.height)
            for stack, error in zip(by_axis, off, strict=True)
        ]
        if cloud.covariance is not None or allow.factor:
            confident_stacks = [confident(stack, cloud, allow) for stack in by_axis]
            proven = _proven_hull(confident_stacks)
            if proven is None:
                return _unbounded(inner, by_axis[0], confidence)
            by_axis, inner = [stack for stack in confident_stacks if stack.slices], proven
            excess = _excess(cloud, allow, by_axis)
        margin = max(off)
        shrunk = _shrunk(inner, margin) if margin else inner
        if shrunk is None:
            return _unbounded(inner, by_axis[0], confidence)
        inner = shrunk
    else:
        confidence = 1.0
    outer = [slabs(stack, margin) for stack in by_axis]
    if len(by_axis) > 1 and cloud.tilt is None:
        # another stack may bound the height of a stack more tightly than its empty slices do
        by_axis = [_bounded_by_others(k, by_axis, outer) for k in range(len(by_axis))]
        outer = [slabs(stack, margin) for stack in by_axis]
    candidates = [
        _of_stack(inner, stack, parts, (margin, excess), confidence)
        for stack, parts in zip(by_axis, outer, strict=True)
    ]
    return min(candidates, key=lambda candidate: candidate.bound)


def _excess(cloud: Cloud, allow: Allowed, by_axis: list[SliceStack]) -> float:
    """How far the proven points may stick out of the body, because the heights of contacts depend on the calibration."""
    if cloud.calibration is None:
        return 0.0
    along = [np.einsum("i,nij,j->n", stack.frame[2], cloud.calibration.covariance, stack.frame[2]) for stack in by_axis]
    return allow.factor * float(np.sqrt(max(np.max(variance, initial=0.0) for variance in along)))


def _proven_hull(by_axis: list[SliceStack]) -> Any:
    """The hull of all points that lie in the body with the stacks' confidence; None if they span no body."""
    points = [
        np.column_stack([slice_.points, np.full(len(slice_.points), slice_.height)]) @ stack.frame
        for stack in by_axis
        for slice_ in stack.slices
    ]
    with suppress(InputError):
        return hull(np.concatenate(points)) if points else None
    return None


def _height_error(stack: SliceStack, cloud: Cloud) -> float:
    """Largest error of the height that a contact has by its slice: the poses' digits and their spread in the slice."""
    spread = max(
        float(np.abs(cloud.points[slice_.rows] @ stack.frame[2] - slice_.height).max()) for slice_ in stack.slices
    )
    return cloud.pose_error + (spread if spread > SAME_HEIGHT * cloud.rod_length else 0.0)


def _tilt_error(stack: SliceStack, cloud: Cloud, widened: float) -> float:
    """Largest difference between the height of a slice and that at which a contact's half-space begins."""
    if cloud.tilt is None:
        return 0.0
    radius = float(_distances(cloud.points, stack, cloud.tilt).max())
    return cloud.pose_error + cloud.tilt.spread + cloud.tilt.slope * radius * float(np.hypot(widened, 1.0))


def _shrunk(body: Any, distance: float) -> Any:
    """A convex body scaled about a point of it, so that it lies in the body deeper than `distance`; None if it is too thin."""
    vertices = body.vertices.view(np.ndarray)
    centre = vertices.mean(axis=0)
    # the support function about the centre is at least the depth of the centre, and falls by the depth's part of itself
    depth = -float(nearest(centre[None], body)[0][0])
    return hull(centre + (1 - distance / depth) * (vertices - centre)) if depth > distance else None


def _unbounded(inner: Any, stack: SliceStack, confidence: float) -> SliceEnclosure:
    """The enclosure by contacts that prove nothing, because their errors are too large."""
    return SliceEnclosure(
        inner=inner,
        corners=np.full((1, 3), np.inf),
        gap=np.full(1, np.inf),
        foot=np.full((1, 3), np.inf),
        kind=np.full(1, Gap.SLICES, dtype=np.int8),
        straight=np.zeros((1, 2), dtype=bool),
        slab=np.zeros(1, dtype=np.intp),
        stack=stack,
        bound=np.inf,
        margin=np.inf,
        volume=(0.0, np.inf),
        confidence=confidence,
    )


def _of_stack(
    inner: Any, stack: SliceStack, parts: list[Slab], errors: tuple[float, float], confidence: float
) -> SliceEnclosure:
    """The enclosure by the slabs of one stack; `errors` are the margin, and how far the inner body may stick out."""
    corners = np.concatenate([part.corners for part in parts])
    gap, foot = np.full(len(corners), np.inf), np.full((len(corners), 3), np.inf)
    bounded = np.isfinite(corners).all(axis=1)
    distance, _, foot[bounded] = nearest(corners[bounded], inner)
    gap[bounded] = np.maximum(distance, 0.0)
    margin, excess = errors
    within = _shrunk(inner, excess) if excess else inner
    least = 0.0 if within is None else within.volume * (1 - _ROUNDING)
    return SliceEnclosure(
        inner=inner,
        corners=corners,
        gap=gap,
        foot=foot,
        kind=np.concatenate([part.kind for part in parts]),
        straight=np.concatenate([part.straight for part in parts]),
        slab=np.repeat(np.arange(len(parts)), [len(part.corners) for part in parts]),
        stack=stack,
        bound=max(float(gap.max()), excess) + margin,
        margin=margin,
        volume=(least, max(sum(part.volume for part in parts), least) * (1 + _ROUNDING)),
        confidence=confidence,
        excess=excess,
    )


def _bounded_by_others(k: int, by_axis: list[SliceStack], outer: list[list[Slab]]) -> SliceStack:
    """Stack k with its floor and ceiling also bounded by the other stacks' outer bodies."""
    stack = by_axis[k]
    low, high = stack.floor, stack.ceiling
    floor_bounded = ceiling_bounded = False
    for j, parts in enumerate(outer):
        corners = np.concatenate([slab.corners for slab in parts])
        if j != k and np.isfinite(corners).all():
            heights = corners @ stack.frame[2]
            floor_bounded |= bool(heights.min() > low)
            ceiling_bounded |= bool(heights.max() < high)
            low, high = max(low, float(heights.min())), min(high, float(heights.max()))
    low, high = min(low, stack.slices[0].height), max(high, stack.slices[-1].height)
    return replace(stack, floor=low, ceiling=high, bounded_by_others=(floor_bounded, ceiling_bounded))
