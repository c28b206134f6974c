"""Where to slice next, by the contacts so far.

Nothing here knows a simulation: a computed scan and a rig ask the same question, sweep, and ask again.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from scan3d.arrays import Array
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.geometry.hulls import hull
from scan3d.planning.heights import heights_at_gaps
from scan3d.planning.plan import Plan
from scan3d.reconstruction.slices import SliceStack, stacks
from scan3d.surfaces.bounds import outside
from scan3d.surfaces.slabs import Gap, Slab, SlabKey, slab_keys, slabs

# Fraction of the slices so far that is added in one round.  Larger rounds need fewer evaluations, but choose more heights
# without seeing what the others of the round have found.
_GROWTH = 0.12


@dataclass
class SlabMemory:
    """What earlier calls of `next_heights` have computed for the same growing cloud, so that it is computed once.

    The gap of a slab is that of the call that saw the slab first: an upper bound of the gap now, since the hull of the
    contacts only grows.
    """

    slabs: dict[SlabKey, Slab] = field(default_factory=dict)
    gaps: dict[SlabKey, Array] = field(default_factory=dict)


def next_heights(
    cloud: Cloud,
    plan: Plan,
    *,
    axis: Array | None = None,
    left: int | None = None,
    memory: SlabMemory | None = None,
) -> Array:
    """Heights (k,) of the slices to be swept next along an axis, where the contacts so far leave most room for the body.

    cloud
        the contacts so far, and the slices they lie in, empty ones included.
    plan
        its `slices` (number of slices along the axis) and `tolerance` say when to stop.
    axis (3,)
        normal of the slices; needed only where the cloud has slices along several axes.
    left
        number of slices that may still be swept; `plan.slices` less those in the cloud unless given.
    memory
        speeds up repeated calls for the same scan; filled by this function.

    Returns no heights where none are left, where the tolerance is met, or where no further slice would tell anything new.
    Raises InputError if the axis is not among those of the cloud, or is not given where there are several.
    """
    stack = _stack(cloud, axis)
    inner = hull(cloud.points)
    done = int((np.abs(cloud.slice_axis - stack.frame[2]).max(axis=1) < 1e-8).sum())
    left = plan.slices - done if left is None else left
    if left <= 0:
        return np.empty(0)
    memory = memory or SlabMemory()
    keys, parts = slab_keys(stack), slabs(stack, known=memory.slabs)
    for key, slab in zip(keys, parts, strict=True):
        if key not in memory.gaps:
            bounded = np.isfinite(slab.corners).all()
            memory.gaps[key] = outside(slab.corners, inner) if bounded else np.full(1, np.inf)
    gap = np.concatenate([memory.gaps[key] for key in keys])
    corners = np.concatenate([slab.corners for slab in parts])
    kind = np.concatenate([slab.kind for slab in parts])
    straight = np.concatenate([slab.straight for slab in parts])
    diagonal = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    if gap.max() <= plan.tolerance * diagonal:
        return np.empty(0)
    count = max(1, min(round(_GROWTH * (plan.slices - left)), left // 3))
    between = np.isfinite(gap) & (kind != Gap.CONTACTS)
    number = np.repeat(np.arange(len(parts)), [len(slab.corners) for slab in parts])[between]
    levels = np.array([stack.floor, *stack.heights, stack.ceiling])
    creases = straight[between].all(axis=1)
    return heights_at_gaps(levels, number, corners[between] @ stack.frame[2], gap[between], creases, count, left)


def _stack(cloud: Cloud, axis: Array | None) -> SliceStack:
    found = stacks(cloud)
    if axis is not None:
        unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
        found = [stack for stack in found if np.abs(stack.frame[2] - unit).max() < 1e-6]
    if len(found) != 1:
        axes = ", ".join(str(tuple(map(float, row))) for row in np.unique(np.round(cloud.slice_axis, 6), axis=0))
        raise InputError(
            f"next heights are chosen along one axis, and the cloud has contacts in slices along {axes}; give one of them "
            f"as axis, got {axis if axis is None else tuple(np.asarray(axis).tolist())}"
        )
    return found[0]
