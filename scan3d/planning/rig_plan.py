"""Sweeps for an unknown body: only a bounding body is known, and the table on which it stands."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, Index
from scan3d.choices import MODELS
from scan3d.errors import InputError
from scan3d.files.reading import to_float
from scan3d.geometry.sections import slice_frame
from scan3d.memory import check_memory
from scan3d.planning.envelopes import Envelope
from scan3d.planning.heights import first_heights
from scan3d.planning.plan import Plan
from scan3d.planning.poses import base_line, clamp_axes, positions
from scan3d.planning.table_rasters import rasters_above
from scan3d.planning.transits import Space, Sweep, joined
from scan3d.poses import PoseList
from scan3d.rods import Rod
from scan3d.units import UNITS_M

FORCE_FACTOR = 6.0
"""Largest contact force in EI/d², for a contact at the arc length d from the clamp.  A rod that the body has turned there by
the angle δ, without friction, is pushed with ``(∫ dδ / √(2 sin δ))²``, from 0 to δ: 3.4 for 90°, 5.9 for 135°, and no sweep
turns it farther.  With friction the rod is turned less before it slides off; up to a coefficient of 1 the factor is below 6."""
FARTHEST = 0.8
"""Largest distance of the clamp from the bounding body, in rod lengths.  Farther away, hardly any of the rod is left to touch
with, and the force on its tip, up to 9 EI/L², would exceed what the rule above promises."""
# Distance that the rod keeps from the bounding body outside of sweeps, in rod lengths, and no more than the clearance.
_MARGIN = 0.05
# Height above the table that clamp and rod keep by default, in heights of the bounding body, and in diameters of the rod.
_FLOOR, _FLOOR_DIAMETERS = 0.02, 2.0
# Sweeps of each slice, from directions evenly around it.
_SIDES = 4
# Lines from each direction in space, per slice of the plan, as in the scan of a known body.
_LINES_PER_SLICE = 0.6
# Directions of the rasters in space that lie above the table.
_DIRECTIONS = 6
# Bytes that a pose takes while it is planned, and poses between two sweeps.
_MEMORY_PER_POSE, _POSES_BETWEEN = 420, 6
# Digits to which lengths in messages are rounded up.
_DIGITS = 3


@dataclass(frozen=True)
class RigPlan:
    """Settings of sweeps for an unknown body; lengths in `unit`.  Raises InputError for values out of their range."""

    around: Envelope
    """Where the body is known to be."""
    model: str = "planar"
    """'planar': stacks of horizontal slices; 'spatial': rasters from the directions above the table."""
    slices: int = 32
    """Number of slices; in the spatial model 0.6 times as many sweeps from each direction."""
    sweeps: int | None = None
    """Sweeps per slice, from directions evenly around it, four by default; in the spatial model per direction."""
    samples: int = 128
    """Poses of a sweep."""
    rod: Rod | None = None
    """None: a steel wire as long as the bounding body is wide, or in space as its largest extent."""
    clearance: float = 0.3
    """Distance of the clamp from the bounding body, in rod lengths."""
    max_force_N: float | None = None
    """Largest contact force; sweeps keep as far away as it demands."""
    floor: float | None = None
    """Height above which clamp and rod stay; None: 2 % of the bounding body's height, at least two diameters of the rod."""
    workspace: Envelope | None = None
    """Where the clamp may go."""
    speed: float = 20.0
    """Of the clamp, in units per second."""
    unit: str = "mm"

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise InputError(f"model must be one of {', '.join(MODELS)}, got {self.model!r}")
        if self.unit not in UNITS_M:
            raise InputError(f"unit must be one of {', '.join(UNITS_M)}, got {self.unit!r}")
        for name, minimum in (("slices", 1), ("samples", 2), ("sweeps", 1)):
            value = getattr(self, name)
            if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < minimum):
                raise InputError(f"{name} must be a whole number of at least {minimum}, got {value!r}")
        if not (0 < self.clearance <= FARTHEST):
            raise InputError(f"clearance must be above 0 and at most {FARTHEST} rod lengths, got {self.clearance}")
        for name in ("speed", "max_force_N"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise InputError(f"{name.partition('_N')[0].replace('_', '-')} must be a number above 0, got {value}")
        if self.floor is not None and not 0 <= self.floor < self.around.height:
            raise InputError(
                f"floor must be a height from 0 to less than that of the bounding body, {self.around.height:g} {self.unit}, "
                f"got {self.floor:g}"
            )

    def resolved_rod(self) -> Rod:
        """The rod, or the one that is taken by default."""
        if self.rod is not None:
            return self.rod
        around = self.around
        length = around.width if self.model == "planar" else max(around.width, around.height)
        return Rod.of_length(UNITS_M[self.unit] * length)

    def resolved_clearance(self) -> float:
        """The clearance in rod lengths, as much larger as `max_force_N` demands.  Raises InputError if that is too far away."""
        rod, unit = self.resolved_rod(), self.unit
        length = rod.length_m / UNITS_M[unit]
        largest = min(FARTHEST, 1 - self.around.width / 2 / length)
        if self.clearance > largest:
            needed = self.around.width / 2 / (1 - self.clearance)
            raise InputError(
                f"a rod of {length:.4g} {unit} doesn't reach the axis of {self.around} from a clearance of "
                f"{self.clearance:g} rod lengths; choose a rod of at least {_up(needed):g} {unit}, or less clearance"
            )
        if self.max_force_N is None:
            return self.clearance
        demanded = math.sqrt(FORCE_FACTOR * rod.force_unit_N / self.max_force_N)
        if demanded > largest:
            thinner = math.sqrt(largest / demanded)
            raise InputError(
                f"this rod may push with up to {FORCE_FACTOR * rod.force_unit_N / largest**2:.3g} N where it still reaches "
                f"the axis of {self.around}, and the limit is {self.max_force_N:g} N; choose a rod of {thinner:.2g} times the "
                f"diameter, or a longer one"
            )
        return max(self.clearance, demanded)

    def space(self) -> Space:
        """Where the clamp may go between sweeps."""
        rod, metres = self.resolved_rod(), UNITS_M[self.unit]
        length = rod.length_m / metres
        floor = self.floor
        if floor is None:
            floor = max(_FLOOR * self.around.height, _FLOOR_DIAMETERS * rod.diameter_m / metres)
        return Space(self.around, length, min(_MARGIN, self.resolved_clearance()) * length, floor)


def _up(value: float) -> float:
    """A number rounded up to a few digits."""
    step = 10.0 ** (math.floor(math.log10(value)) + 1 - _DIGITS)
    return math.ceil(value / step) * step


def plan_poses(plan: RigPlan) -> PoseList:
    """The poses of all sweeps with their approaches and retracts.

    Each sweep begins and ends where neither the straight rod nor a bent one can touch the bounding body.  Raises InputError if
    the rod does not reach into the bounding body, if it is too stiff for the force, or if the clamp would leave the workspace.
    """
    _check_size(plan)
    space = plan.space()
    sweeps = _slices(plan, space) if plan.model == "planar" else _rasters(plan, space)
    if not sweeps:
        raise InputError(
            f"no sweep from above the table reaches into {plan.around}; choose a longer rod or less clearance"
        )
    return pose_list(sweeps, plan)


def _check_size(plan: RigPlan) -> None:
    """Raise InputError if the poses of a plan need more memory than there is."""
    planar = plan.model == "planar"
    lines = plan.slices * (plan.sweeps or _SIDES) if planar else _DIRECTIONS * (plan.sweeps or plan.slices)
    count, samples = to_float(lines), to_float(plan.samples)
    check_memory(
        _MEMORY_PER_POSE * count * (samples + _POSES_BETWEEN),
        f"a plan of {count:.4g} sweeps with {samples:.4g} poses",
        "choose fewer slices, sweeps or samples",
    )


def pose_list(sweeps: list[Sweep], plan: RigPlan, first: int = 0) -> PoseList:
    """Sweeps, numbered from `first`, with their approaches and retracts, as a list of poses."""
    space, metres = plan.space(), UNITS_M[plan.unit]
    path = joined(sweeps, space, first)
    _check_workspace(plan, path.position, path.sweep)
    source: dict[str, Any] = {
        "around": str(plan.around),
        "clearance": plan.resolved_clearance(),
        "floor": space.floor,
        "samples": plan.samples,
        "slices": plan.slices,
    }
    for name, value in (("sweeps", plan.sweeps), ("max_force_N", plan.max_force_N), ("workspace", plan.workspace)):
        if value is not None:
            source[name] = str(value) if isinstance(value, Envelope) else value
    return PoseList(
        sweep=path.sweep.astype(np.int64),
        position_m=path.position * metres,
        # scipy wants the clamp's axes as columns
        quaternion=Rotation.from_matrix(np.swapaxes(path.axes, 1, 2)).as_quat(canonical=True, scalar_first=True),
        move=path.move.astype(np.int8),
        rod=plan.resolved_rod(),
        speed_m_s=plan.speed * metres,
        model=plan.model,
        unit=plan.unit,
        source=source,
    )


def overtravel(clearance: float) -> float:
    """How far a clamp goes on past a body, in rod lengths, so that even a bent rod has come off it.

    A contact at least `clearance` in front of the clamp and at most a rod length away from it lies no farther back.
    """
    return math.sqrt(1 - clearance**2)


def _slices(plan: RigPlan, space: Space) -> list[Sweep]:
    """Horizontal sweeps: all heights from one side, then from the next."""
    clearance, frame = plan.resolved_clearance(), slice_frame(np.array([0.0, 0.0, 1.0]))
    inside = first_heights(space.floor, plan.around.height, Plan(slices=plan.slices, spacing="cosine"))
    heights = np.concatenate([inside[:-2], inside[-1:]])  # none below the table
    return [
        swept
        for number, angle in enumerate(2 * np.pi * np.arange(plan.sweeps or _SIDES) / (plan.sweeps or _SIDES))
        for swept in (slice_sweep(plan, space, angle, z, clearance, frame) for z in heights[:: 1 - 2 * (number % 2)])
    ]


def slice_sweep(plan: RigPlan, space: Space, angle: float, height: float, clearance: float, frame: Array) -> Sweep:
    """The sweep at a height with the rod in a direction, past the whole bounding body."""
    outline = plan.around.outline()
    line = base_line(outline, angle, clearance * space.length)
    across = (outline - line.origin) @ line.axes[0]
    end = across.min() - space.margin - overtravel(clearance) * space.length
    x0 = np.linspace(across.max() + space.margin, end, plan.samples)
    return Sweep(positions(line, x0, height, frame), clamp_axes(line, frame))


def _rasters(plan: RigPlan, space: Space) -> list[Sweep]:
    """Rasters of lines from the directions above the table."""
    clearance = plan.resolved_clearance()
    count = plan.sweeps or max(2, round(_LINES_PER_SLICE * plan.slices))
    lines = rasters_above(
        space.envelope.points(),
        count,
        space.length,
        (clearance, space.margin / space.length, overtravel(clearance)),
        space.floor,
    )
    fraction = np.linspace(0, 1, plan.samples)[:, None]
    return [Sweep(start + fraction * (end - start), axes) for start, end, axes in lines]


def _check_workspace(plan: RigPlan, position: Array, sweep: Index) -> None:
    if plan.workspace is None:
        return
    outside = ~plan.workspace.contains(position)
    if outside.any():
        row = int(np.argmax(outside))
        place = ", ".join(f"{value:.4g}" for value in position[row])
        raise InputError(
            f"the clamp would leave the workspace {plan.workspace}: {outside.sum()} of {len(outside)} poses lie outside, the "
            f"first of sweep {sweep[row]} at ({place}) {plan.unit}; choose a shorter rod or less clearance, or state more space"
        )
