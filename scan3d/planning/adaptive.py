"""Heights of further slices, chosen by the contacts so far.

This module knows no simulation: a simulated scan and a real rig both ask it for heights, sweep there, and ask again.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import QhullError

from scan3d.arrays import Array, Mask
from scan3d.bounds.slabs import Gap, Slab, SlabGaps, SlabKey, slab_keys, slabs
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.geometry.distance import nearest_on
from scan3d.geometry.hulls import hull
from scan3d.planning.heights import (
    BEYOND,
    FEW_STRAIGHT,
    NO_GAP,
    cosine_gap,
    cosine_heights_left,
    heights_at_gaps,
)
from scan3d.planning.plan import Plan
from scan3d.planning.sharing import evened, least_parts, parts_within
from scan3d.reconstruction.slices import SliceStack, stacks

# Fraction of the number of slices so far that is added in one round, and the smallest number of slices left for each height
# that it adds: of bodies that are bent nearly everywhere, and of others.  Larger rounds need fewer evaluations, but choose more
# heights without knowing the contacts of the others, which shift the corners where vertices are expected.
_GROWTH_OF_BENT, _LEFT_OF_BENT = 0.3, 2
_GROWTH, _LEFT_PER_HEIGHT = 0.12, 3
# Slices from which on rounds are that large for any body, and the fraction of the slices so far that the last rounds add even
# so.  Fewer, or a larger fraction, and heights are chosen without knowing each other; more, or a smaller fraction, and a scan
# of a thousand slices takes half as long again, with the same bound.
_MANY, _LAST_ROUNDS = 128, 0.04
# Largest difference of the components of two unit normals that are the same axis: in the cloud, where slices along one axis
# have one normal up to rounding; and as given by the caller, who may have rounded them.  Larger, axes that are nearly
# parallel would be mixed; smaller, rounding would separate what belongs together.
_SAME_AXIS, _GIVEN_AXIS = 1e-8, 1e-6
# Corners count for this if their gaps are wider than this fraction of the widest.  Larger, few corners decide; smaller, those
# decide at which nothing is left to be found.
_WIDE = 0.01
# The heights of cosine spacing are taken if they leave at most this many times the gap of those that make it least, as far as
# the slices so far tell.  Larger, edges are sliced too coarsely; smaller, bodies for which cosine spacing is best are not.
_AS_GOOD = 1.1
# Without a tolerance, all heights of cosine spacing that are left are taken at once if so many slices of the body are known,
# and no more are left than this multiple of them.  Fewer, or a larger multiple, and edges between the slices are not seen in
# time; more, or a smaller multiple, and bounds are computed that change nothing.
_WELL_KNOWN, _LEFT_PER_KNOWN = 24, 2
# Decimals of the axes in messages.
_AXIS_DECIMALS = 6


Distances = Callable[[int, Array], Array]
"""From the number of a slab and its corners (w, 3) to their distances (w,) from the hull of the contacts."""


@dataclass
class SlabMemory:
    """Slices, slabs and gaps that the last call of `next_heights` has computed, for the next call with the same cloud grown."""

    stacks: list[SliceStack] = field(default_factory=list)
    """The slices, which the next call finds in use."""
    slabs: dict[SlabKey, Slab] = field(default_factory=dict)
    gaps: dict[SlabKey, Array] = field(default_factory=dict)
    """(w,) distances of each slab's corners from the hull of the contacts in the first call with that slab: upper bounds of the
    present ones, because the hull only grows; (1,) infinite where the slab is unbounded."""

    def measured(self, stack: SliceStack, distances: Distances) -> tuple[list[Slab], Array]:
        """The slabs of a stack, and the gaps (w,) of all corners: of new slabs, by the distances."""
        parts, keys = slabs(stack, known=self.slabs, volumes=False), slab_keys(stack)
        for i, (key, slab) in enumerate(zip(keys, parts, strict=True)):
            if key not in self.gaps:
                bounded = np.isfinite(slab.corners).all()
                self.gaps[key] = distances(i, slab.corners) if bounded else np.full(1, np.inf)
        self.slabs, self.gaps = {key: self.slabs[key] for key in keys}, {key: self.gaps[key] for key in keys}
        return parts, np.concatenate([self.gaps[key] for key in keys])


def next_heights(
    cloud: Cloud,
    plan: Plan,
    *,
    axis: Array | None = None,
    left: int | None = None,
    memory: SlabMemory | None = None,
) -> Array:
    """Heights (k,) of the slices to be swept next along an axis: where the contacts so far leave most room for the body.

    cloud
        the contacts so far, and their slices, including those in which nothing was touched.
    plan
        its `slices` (number of slices along the axis) and its `tolerance` say when to stop.
    axis (3,)
        normal of the slices; needed only if the cloud has slices along several axes.
    left
        number of slices that may still be swept; by default `plan.slices` and the two beyond the ends, less the cloud's
        slices along the axis.
    memory
        speeds up repeated calls for the same scan; filled by this function.

    Returns an empty array if no slices are left, if the tolerance is met, or if further slices would add no information.
    Raises InputError if the axis is not among those of the cloud, or is not given where there are several, and if the contacts
    span no body.
    """
    memory = memory or SlabMemory()
    candidates = memory.stacks = stacks(cloud)
    stack = _stack(candidates, cloud, axis)
    done = int((np.abs(cloud.slice_axis - stack.frame[2]).max(axis=1) < _SAME_AXIS).sum())
    left = plan.slices + BEYOND - done if left is None else left
    if left <= 0:
        return np.empty(0)
    parts, gap = memory.measured(stack, _distances(stack, cloud, alone=len(candidates) == 1))
    corners = np.concatenate([slab.corners for slab in parts])
    kind = np.concatenate([slab.kind for slab in parts])
    straight = np.concatenate([slab.straight for slab in parts])
    diagonal = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    if gap.max() <= plan.tolerance * diagonal:
        return np.empty(0)
    between = np.isfinite(gap) & (kind != Gap.CONTACTS)
    number = np.repeat(np.arange(len(parts)), [len(slab.corners) for slab in parts])
    tolerance = plan.tolerance * diagonal
    bent = _nearly_all_bent(gap[between], straight[between])
    if bent:
        widest = np.zeros(len(parts))
        np.maximum.at(widest, number, gap)
        further = _cosine_heights(np.array(stack.heights), widest[1:-1], plan.slices, tolerance, left)
        if len(further) or not between.any():
            return further[:left]
    number = number[between]
    ends = (stack.floor, stack.heights[0]), (stack.ceiling, stack.heights[-1])
    # an end that nothing bounds gets no height
    low, high = (end if np.isfinite(end) else nearest for end, nearest in ends)
    levels = np.array([low, *stack.heights, high])
    at = corners[between] @ stack.frame[2]
    count = _heights_of_round(plan.slices - left, left, bent=bent)
    return heights_at_gaps(
        levels, number, at, gap[between], straight[between], count, tolerance, left if bent else None
    )


def _nearly_all_bent(gaps: Array, straight: Mask) -> bool:
    """Whether the body is bent at nearly all corners that are still open; their gaps (w,) and where it is straight (w, 2)."""
    wide = gaps > _WIDE * gaps.max(initial=0.0)
    return not wide.any() or bool(straight[wide].any(axis=1).mean() < FEW_STRAIGHT)


def _heights_of_round(done: int, left: int, *, bent: bool) -> int:
    """Number of heights that a round adds to those that are done; `bent` says whether the body is bent nearly everywhere."""
    growth, each = (_GROWTH_OF_BENT, _LEFT_OF_BENT) if bent or done >= _MANY else (_GROWTH, _LEFT_PER_HEIGHT)
    least = int(_LAST_ROUNDS * done) if done >= _MANY else 1
    return max(1, min(round(growth * done), left // each), min(least, left))


def _cosine_heights(known: Array, gaps: Array, slices: int, tolerance: float, left: int) -> Array:
    """Heights (k,) of cosine spacing that are still to be swept in slabs with gaps (s - 1,); none if others are better."""
    if not (gaps > NO_GAP * (known[-1] - known[0])).any():  # a prism along the axis: its ends alone are not known
        return np.empty(0)
    if np.isfinite(gaps).all():
        gaps = evened(gaps)
        if cosine_gap(known, gaps, slices) > _AS_GOOD * least_parts(gaps, left)[1]:
            return np.empty(0)
    at_once = not tolerance and len(known) >= _WELL_KNOWN and left <= _LEFT_PER_KNOWN * len(known)
    return cosine_heights_left(known, parts_within(gaps, tolerance), slices, at_once=at_once)


def _distances(stack: SliceStack, cloud: Cloud, *, alone: bool) -> Distances:
    """Distances from the hull of a cloud's contacts; `alone` says whether all of them are those of the stack.

    Raises InputError if they span no body.
    """
    if alone:
        with suppress(QhullError):
            return SlabGaps(stack).at
    distances = nearest_on(hull(cloud.points))
    return lambda _, corners: np.maximum(distances(corners)[0], 0.0)


def _stack(candidates: list[SliceStack], cloud: Cloud, axis: Array | None) -> SliceStack:
    """That of the cloud's stacks along an axis."""
    if axis is not None:
        unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
        candidates = [stack for stack in candidates if np.abs(stack.frame[2] - unit).max() < _GIVEN_AXIS]
    if len(candidates) != 1:
        normals = np.unique(np.round(cloud.slice_axis, _AXIS_DECIMALS), axis=0) + 0.0  # -0 becomes 0
        axes = ", ".join(str(tuple(map(float, row))) for row in normals)
        raise InputError(
            f"next heights are chosen along one axis, and the cloud has contacts in slices along {axes}; give one of them "
            f"as axis, got {axis if axis is None else tuple(np.asarray(axis).tolist())}"
        )
    return candidates[0]
