"""Sweeps for an unknown body: only a bounding body is known, the cylinder, sphere or box around it, and the table, z = 0.

Every sweep lies behind a plane: no part of the straight rod is nearer to the body along the rod than where the rod's tip ends
when it is drawn back.  Rods that are drawn back behind the supporting plane of the bounding body across the rod stay there on
straight lines.  To turn from one direction to another, the clamp goes to a place that lies behind both planes by more than a
rod length, where the rod may turn without coming near the body.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from scan3d import units
from scan3d.arrays import NEGLIGIBLE, Array
from scan3d.choices import MODELS
from scan3d.errors import InputError
from scan3d.files.text import to_float
from scan3d.geometry.distance import segments_meet
from scan3d.geometry.hulls import hull
from scan3d.geometry.sections import slice_frame
from scan3d.planning.heights import first_heights
from scan3d.planning.plan import (
    SMALLEST_CLEARANCE,
    Plan,
    across,
    base_line,
    check_choice,
    check_whole,
    clamp_axes,
    cosine_fractions,
    icosahedron,
    positions,
)
from scan3d.planning.probing import Probings, Unknown
from scan3d.poses import AWAY, SPEED_M_S, Move, PoseList
from scan3d.rods import Rod
from scan3d.spatial.bodies import sphere_directions
from scan3d.units import UNITS_M
from scan3d.workers import check_memory

FORCE_FACTOR = 2.0
"""Largest force on the rod's side in EI/d², for contacts at least the distance d in front of the clamp: 1.93 is the most that
``f y1²`` of a bent rod (S9) can be where the force is inclined to the rod's normal by at most 45°, friction up to 1."""
TIP_FACTOR = 9.0
"""Largest force on its tip in EI/L²: clearance does not lessen it."""
FARTHEST = 0.8
"""Largest distance of the clamp from the bounding body, in rod lengths.  Farther away, hardly any of the rod is left to touch
with."""
SIDES = 4
"""Sweeps of each slice, from directions evenly around it."""
# Corners of the polygon that stands for a circle, around which it lies by 0.1 %.
_AROUND = 72
_COUNTS = {"cylinder": 2, "sphere": 1, "box": 3}
# Part of the rod, from its tip, that must enter the body somewhere on a line.
_LEAST = 0.1
# The frame of horizontal slices.
_LEVEL = slice_frame(np.array([0.0, 0.0, 1.0]))


@dataclass(frozen=True)
class Envelope:
    """A bounding body; lengths in the user's unit.  Raises InputError for sizes that are not positive numbers."""

    shape: str
    """'cylinder', 'sphere' or 'box'."""
    sizes: tuple[float, ...]
    """Diameter and height of the cylinder, diameter of the sphere, or extents of the box along x, y and z."""

    def __post_init__(self) -> None:
        if self.shape not in _COUNTS or len(self.sizes) != _COUNTS[self.shape]:
            raise InputError(_expected(str(self)))
        if not all(0 < size < math.inf for size in self.sizes):
            raise InputError(f"the sizes of {self} must be above 0")

    def __str__(self) -> str:
        return f"{self.shape}:{'x'.join(f'{size:g}' for size in self.sizes)}"

    def scaled(self, factor: float) -> Envelope:
        """The same body in another unit of length."""
        return Envelope(self.shape, tuple(factor * size for size in self.sizes))

    @property
    def height(self) -> float:
        """Of its top above z = 0."""
        return self.sizes[-1]

    @property
    def width(self) -> float:
        """Largest horizontal diameter."""
        return math.hypot(*self.sizes[:2]) if self.shape == "box" else self.sizes[0]

    def points(self) -> Array:
        """(n, 3) corners of a polyhedron in which the bounding body lies."""
        if self.shape == "sphere":
            radius = self.sizes[0] / 2
            directions = sphere_directions(600).T
            # the polyhedron of points on a sphere has faces nearer to the middle, by which it is enlarged
            faces = hull(directions)
            nearest = float((faces.triangles_center * faces.face_normals).sum(axis=1).min())
            points = np.asarray(directions * radius / nearest + [0, 0, radius])
            return np.column_stack([points[:, :2], np.maximum(points[:, 2], 0.0)])
        outline = self.outline()
        return np.concatenate([np.column_stack([outline, np.full(len(outline), z)]) for z in (0.0, self.height)])

    def outline(self) -> Array:
        """(n, 2) corners of a polygon in which the bounding body lies, seen from above."""
        if self.shape == "box":
            corners = np.array([(x, y) for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
            return np.asarray(corners * self.sizes[:2])
        angle = 2 * np.pi * (np.arange(_AROUND) + 0.5) / _AROUND
        radius = self.sizes[0] / 2 / np.cos(np.pi / _AROUND)
        return np.asarray(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def parse_envelope(text: str) -> Envelope:
    """The bounding body named by ``cylinder:DxH``, ``sphere:D`` or ``box:AxBxC``.  Raises InputError for any other text."""
    match = re.fullmatch(r"(\w+):([0-9.eE+-]+(?:x[0-9.eE+-]+)*)", text)
    try:
        sizes = tuple(float(part) for part in match[2].split("x")) if match else ()
    except ValueError:
        match = None
    if match is None:
        raise InputError(_expected(text))
    return Envelope(match[1], sizes)


def _expected(text: str) -> str:
    return (
        "a bounding body is cylinder:DIAMETERxHEIGHT, sphere:DIAMETER or box:AxBxC, such as cylinder:80x120; "
        f"got {text!r}"
    )


class Sweep(NamedTuple):
    """One sweep: where its clamp goes, in the user's unit."""

    position: Array
    """(n, 3)"""
    axes: Array
    """(3, 3) as rows."""
    move: Move = Move.SWEEP


class Space(NamedTuple):
    """Where a clamp with a rod may go, lengths in the user's unit."""

    points: Array
    """(n, 3) in whose hull the body lies."""
    length: float
    """Of the rod."""
    clearance: float
    """Of the clamp from the body along the rod in a sweep."""
    beyond: float
    """How far the clamp goes on past the body, so that even a bent rod has come off it: a contact at least the clearance in
    front of the clamp and at most a rod length away from it lies no farther back."""
    margin: float
    """Distance that the rod keeps from the bounding body when it does not sweep."""
    floor: float
    """Height above which clamp and rod stay."""
    aside: float
    """How far the free rod may reach from the clamp's axis, by its curvature."""

    def behind(self, along: Array) -> float:
        """Coordinate along the direction `along` (3,) of a rod behind which its tip is clear of the bounding body."""
        return float((self.points @ along).min()) - self.margin


@dataclass(frozen=True)
class RigPlan:
    """Settings of sweeps for an unknown body; lengths in `unit`.  Raises InputError for values out of their range."""

    around: Envelope
    """Where the body is known to be."""
    model: str = "planar"
    """'planar': stacks of horizontal slices; 'spatial': rasters from the directions above the table."""
    probing: bool = False
    """Probings in the place of sweeps: three planes across each axis."""
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
    speed: float | None = None
    """Of the clamp, in units per second; None: 20 mm/s."""
    unit: str = "mm"

    def __post_init__(self) -> None:
        check_choice("model", self.model, MODELS)
        check_choice("unit", self.unit, UNITS_M)
        for name, minimum in (("slices", 1), ("samples", 2), ("sweeps", 1)):
            if getattr(self, name) is not None:
                check_whole(name, getattr(self, name), minimum)
        if not (SMALLEST_CLEARANCE <= self.clearance <= FARTHEST):
            raise InputError(
                f"clearance must lie between {SMALLEST_CLEARANCE:g} and {FARTHEST} rod lengths, got {self.clearance}"
            )
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
        """The rod, or the one that is taken by default: in the planar model one without thickness, as in scans of meshes."""
        wire = self.wire()
        return wire.without_thickness() if self.rod is None and self.model == "planar" else wire

    def wire(self) -> Rod:
        """The rod with its thickness, or the wire that is taken by default."""
        if self.rod is not None:
            return self.rod
        around = self.around
        length = around.width if self.model == "planar" else max(around.width, around.height)
        if self.probing:  # through the body, while the clamp stays outside
            length = math.hypot(around.width, around.height) / (1 - 2 * AWAY)
        return Rod.of_length(UNITS_M[self.unit] * length)

    def resolved_clearance(self) -> float:
        """The clearance in rod lengths, as much larger as `max_force_N` demands.  Raises InputError if that is too far away."""
        rod, unit = self.resolved_rod(), self.unit
        length = rod.length_m / UNITS_M[unit]
        largest = min(FARTHEST, 1 - self.around.width / 2 / length)
        if self.clearance > largest:
            needed = self.around.width / 2 / (1 - self.clearance)
            raise InputError(
                f"a rod of {units.length(length, unit, digits=4)} doesn't reach the axis of {self.around} from a "
                f"clearance of {self.clearance:g} rod lengths; choose a rod of at least "
                f"{units.length(1.01 * needed, unit, up=True)}, or less clearance"
            )
        if self.max_force_N is None:
            return self.clearance
        least = largest_force(rod, largest)
        if least > self.max_force_N:
            raise InputError(
                f"this rod may push with up to {units.force(least)} where it still reaches the axis of {self.around}, "
                f"and the limit is {units.force(self.max_force_N)}; choose a rod of "
                f"{(self.max_force_N / least) ** 0.25:.2g} times the diameter, or a longer one"
            )
        return max(self.clearance, math.sqrt(FORCE_FACTOR * _stiffest_unit(rod) / self.max_force_N))

    def space(self) -> Space:
        """Where the clamp may go between sweeps."""
        rod, metres = self.resolved_rod(), UNITS_M[self.unit]
        length = rod.length_m / metres
        floor = self.floor
        if floor is None:
            floor = max(0.02 * self.around.height, 2 * self.wire().diameter_m / metres)
        clearance = self.resolved_clearance()
        return Space(
            self.around.points(),
            length,
            clearance * length,
            math.sqrt(1 - clearance**2) * length,
            min(0.05, clearance) * length,
            floor,
            min(0.5 * math.hypot(*rod.curvatures[:2]) * rod.length_m, 1.0) * length,
        )


def largest_force(rod: Rod, clearance: float) -> float:
    """The force in N below which a rod pushes any body that is a clearance, in rod lengths, in front of its clamp."""
    return _stiffest_unit(rod) * max(FORCE_FACTOR / clearance**2, TIP_FACTOR)


def _stiffest_unit(rod: Rod) -> float:
    """EI/L² in N where the rod is stiffest."""
    return rod.force_unit_N * max(rod.profile.diameters) ** 4


def plan_poses(plan: RigPlan) -> PoseList:
    """The poses of all sweeps with their approaches and retracts.

    Each sweep begins and ends where neither the straight rod nor a bent one can touch the bounding body.  Raises InputError if
    the rod does not reach into the bounding body, or if it is too stiff for the force.
    """
    _check_size(plan)
    space = plan.space()
    if plan.probing:
        sweeps = probings(unknown(space).first_round().moves, space)
    else:
        sweeps = _slices(plan, space) if plan.model == "planar" else _rasters(plan, space)
    if not sweeps:
        raise InputError(
            f"no sweep from above the table reaches into {plan.around}; choose a longer rod or less clearance"
        )
    return pose_list(sweeps, plan)


def _check_size(plan: RigPlan) -> None:
    """Raise InputError if the poses of a plan need more memory than there is."""
    planar = plan.model == "planar"
    lines = plan.slices * (plan.sweeps or SIDES) if planar else 6 * (plan.sweeps or plan.slices)
    count, samples = to_float(lines), to_float(plan.samples)
    check_memory(
        420 * count * (samples + 6),  # bytes for each pose, six of which lie between two sweeps
        f"a plan of {count:.4g} sweeps with {samples:.4g} poses",
        "choose fewer slices, sweeps or samples",
    )


def pose_list(sweeps: list[Sweep], plan: RigPlan, first: int = 0) -> PoseList:
    """Sweeps, numbered from `first`, with their approaches and retracts, as a list of poses."""
    space, metres = plan.space(), UNITS_M[plan.unit]
    number, position, axes, move = map(np.array, zip(*_poses(sweeps, space, first), strict=True))
    source: dict[str, Any] = {
        "around": str(plan.around),
        "clearance": plan.resolved_clearance(),
        "floor": space.floor,
        "samples": plan.samples,
        "slices": plan.slices,
    }
    source |= {name: getattr(plan, name) for name in ("sweeps", "max_force_N") if getattr(plan, name) is not None}
    return PoseList(
        sweep=number.astype(np.int64),
        position_m=position * metres,
        # scipy wants the clamp's axes as columns
        quaternion=Rotation.from_matrix(np.swapaxes(axes, 1, 2)).as_quat(canonical=True, scalar_first=True),
        move=move.astype(np.int8),
        rod=plan.resolved_rod(),
        speed_m_s=SPEED_M_S if plan.speed is None else plan.speed * metres,
        model=plan.model,
        unit=plan.unit,
        source=source,
    )


def _slices(plan: RigPlan, space: Space) -> list[Sweep]:
    """Horizontal sweeps: all heights from one side, then from the next."""
    inside = first_heights(space.floor, plan.around.height, Plan(slices=plan.slices, spacing="cosine"))
    heights = np.concatenate([inside[:-2], inside[-1:]])  # none below the table
    sides = plan.sweeps or SIDES
    return [
        slice_sweep(plan, space, float(angle), z)
        for number, angle in enumerate(2 * np.pi * np.arange(sides) / sides)
        for z in heights[:: 1 - 2 * (number % 2)]
    ]


def slice_sweep(plan: RigPlan, space: Space, angle: float, height: float, frame: Array = _LEVEL) -> Sweep:
    """The sweep at a height with the rod in a direction, past the whole bounding body, on the nearest base line.

    frame (3, 3)
        axes of the slices' frame as rows, z across the slice; by default that of horizontal slices.
    """
    outline = plan.around.outline() if np.array_equal(frame, _LEVEL) else space.points @ frame[:2].T
    line = base_line(outline, angle, space.clearance)
    across = (outline - line.origin) @ line.axes[0]
    margin = space.margin + space.aside
    x0 = np.linspace(across.max() + margin, across.min() - margin - space.beyond, plan.samples)
    return Sweep(positions(line, x0, height, frame), clamp_axes(line, frame))


def above_floor(sweeps: list[Sweep], space: Space) -> list[Sweep]:
    """Those of the sweeps on which clamp and straight rod stay above the floor, also where the rod is drawn back.

    Raises InputError if none of them does, and they are not level.
    """
    kept = []
    for sweep in sweeps:
        ends = np.concatenate([sweep.position, _drawn_back(sweep, space)])
        lowest = float(ends[:, 2].min()) + min(space.length * float(sweep.axes[1, 2]), 0.0)
        if lowest >= space.floor - NEGLIGIBLE * space.length:
            kept.append(sweep)
    if not kept and any(abs(sweep.axes[1, 2]) > NEGLIGIBLE for sweep in sweeps):
        raise InputError(
            f"on none of {len(sweeps)} further sweeps, in the planes of the recording's slices, do clamp and rod stay above "
            f"z = {space.floor:g}: give a lower floor, or touch the body in horizontal slices"
        )
    return kept


def _drawn_back(sweep: Sweep, space: Space) -> Array:
    """Places (2, 3) of the clamp before and after a sweep: along the rod, until the tip is behind the supporting plane."""
    along, ends = sweep.axes[1], sweep.position[[0, -1]]
    back = np.maximum(ends @ along + space.length - space.behind(along), 0.0)
    return np.asarray(ends - back[:, None] * along)


_Pose = tuple[int, Array, Array, int]
"""Number of the sweep, place (3,) and axes (3, 3) of the clamp, and `Move`."""


def _poses(sweeps: list[Sweep], space: Space, first: int) -> Iterator[_Pose]:
    """All sweeps, each with its approach before it and its retract after it; numbered from `first`."""
    previous: tuple[Array, Array] | None = None
    for number, sweep in enumerate(sweeps, start=first):
        position, axes, move = sweep
        start, end = _drawn_back(sweep, space)
        if previous is not None:
            yield from (
                (number, place, turned, Move.APPROACH) for place, turned in _turn(previous, (start, axes), space)
            )
        yield number, start, axes, Move.APPROACH
        yield from ((number, place, axes, move) for place in position)
        yield number, end, axes, Move.RETRACT
        previous = end, axes


def _turn(start: tuple[Array, Array], end: tuple[Array, Array], space: Space) -> list[tuple[Array, Array]]:
    """Places and axes at which the clamp turns on its path from one pose, drawn back, to another; none if it need not."""
    (_, before), (_, after) = start, end
    old, new = before[1], after[1]
    cosine = float(old @ new)
    across = np.cross(old, new)
    sine = float(np.linalg.norm(across))
    if sine < NEGLIGIBLE and cosine > 0:
        return []
    if cosine < -0.98:
        # both rods are nearly level, and no place lies behind both planes: a quarter of a turn first
        halfway = start[0], before @ Rotation.from_rotvec([0.0, 0.0, np.pi / 2]).as_matrix().T
        return _turn(start, halfway, space) + _turn(halfway, end, space)
    middle = (space.points.max(axis=0) + space.points.min(axis=0)) / 2
    # the place lies a rod length behind both planes
    depth = max(middle @ along - space.behind(along) for along in (old, new)) + space.length
    place = middle - depth / (1 + cosine) * (old + new)
    part = np.linspace(0, 1, 33)[:, None]
    between = (1 - part) * old + part * new
    lowest = min(0.0, float((between[:, 2] / np.linalg.norm(between, axis=1)).min()))
    place[2] = max(place[2], space.floor - space.length * lowest)
    turned = before @ Rotation.from_rotvec(across / sine * np.arctan2(sine, cosine)).as_matrix().T
    return [(place, axes) for axes in (before, turned, after)]


class Line(NamedTuple):
    """A straight sweep in space: where it begins and ends (3,), and the clamp's axes (3, 3) as rows."""

    start: Array
    end: Array
    axes: Array

    def sweep(self, samples: int) -> Sweep:
        """It, with so many poses."""
        fraction = np.linspace(0, 1, samples)[:, None]
        return Sweep(self.start + fraction * (self.end - self.start), self.axes)


def _base(space: Space, along: Array) -> Array:
    """The place (3,) of a clamp whose rod points along a direction at the middle of the body, with the clearance from it."""
    middle = space.points.mean(axis=0)
    depth = (space.points @ along).min() - space.clearance
    return np.asarray(middle + (depth - middle @ along) * along)


def _line(space: Space, along: Array, spread: Array, x: Array, offset: float) -> Line:
    """The line against the direction `x` of the clamp, at an offset along `spread`, drawn back as the table demands.

    The rod points down, along the direction `along`.
    """
    base = _base(space, along)
    # the width of the body is looked up about the line
    margin = space.margin + space.aside
    at = offset + margin * np.linspace(-1, 1, 17)
    across, moved = space.points @ spread, space.points @ x
    high, low = -_lowest(across, -moved, at), _lowest(across, moved, at)
    origin = base + (offset - base @ spread) * spread
    ends = (high + margin, low - margin - space.beyond)
    start, end = (origin + (value - origin @ x) * x for value in ends)
    lowest_point = min(start[2], end[2]) + space.length * along[2]
    raised = max(space.floor - lowest_point, 0.0) / -along[2]
    axes = np.stack([x, along, np.cross(x, along)])
    return Line(start - raised * along, end - raised * along, axes)


def _lowest(x: Array, y: Array, at: Array) -> float:
    """The smallest y of the hull of points (n,) at some x, or at the end of the hull that is nearest to it."""
    points = np.stack([x, y], axis=1)
    corners = points[ConvexHull(points).vertices]  # counterclockwise
    corners = np.roll(corners, -int(np.lexsort(corners.T[::-1])[0]), axis=0)
    lower = corners[: int(corners[:, 0].argmax()) + 1]
    return float(np.interp(at, *lower.T).min())


def _rasters(plan: RigPlan, space: Space) -> list[Sweep]:
    """Sweeps along lines from each direction above the table.

    The first lines of a direction move across the slope of the rod and up and down along it, the others level.  A line whose
    rod would hit the table is drawn back along the rod; one that then does not reach the body is left out.
    """
    # as in the scan of a known body
    count = plan.sweeps or max(2, round(0.6 * plan.slices))
    body = hull(space.points)
    lines = []
    for along in -icosahedron():
        if along[2] >= 0:
            continue
        level = np.cross([0.0, 0.0, 1.0], along)
        level /= np.linalg.norm(level)
        slope = np.cross(along, level)
        widths = [float(np.ptp(space.points @ axis)) for axis in (level, slope)]
        first = _lines(space, body, along, level, slope, max(1, round(count * widths[0] / sum(widths))))
        lines += first + _lines(space, body, along, slope, level, max(1, count - len(first)))
    return [line.sweep(plan.samples) for line in lines]


def _lines(space: Space, body: Any, along: Array, spread: Array, moved: Array, number: int) -> list[Line]:
    """`number` lines in the direction `moved`, every other one backwards, next to each other in the direction `spread`.

    Only those are kept on which the straight rod enters the body, a convex `trimesh.Trimesh`, by a part of its length.
    """
    place, base = space.points @ spread, _base(space, along)
    lowest = place.min()
    if spread[2] > 0 and moved[2] == 0:
        # lower lines would have to be drawn back too far
        tip = base[2] + space.length * along[2] - (base @ spread) * spread[2]
        lowest = max(lowest, (space.floor + 0.3 * space.length * along[2] - tip) / spread[2])
    offsets = lowest + cosine_fractions(number) * (place.max() - lowest)
    lines = []
    for k, offset in enumerate(offsets):
        line = _line(space, along, spread, -moved if k % 2 else moved, offset)
        places = line.sweep(65).position
        rods = np.broadcast_to(along, places.shape)
        if segments_meet(body, places, rods, (1 - _LEAST) * space.length).any():
            lines.append(line)
    return lines


def unknown(space: Space, contacts: Array | None = None, seed: Sequence[int] = (0,)) -> Unknown:
    """What is unknown of a body in a space, of which contacts (n, 3) are known."""
    low, high = space.points.min(axis=0), space.points.max(axis=0)
    if contacts is not None:  # what is touched already tells where the body is better
        size = 0.1 * np.ptp(contacts, axis=0)
        low, high = np.maximum(low, contacts.min(axis=0) - size), np.minimum(high, contacts.max(axis=0) + size)
    return Unknown(low, high, space.length, seed, space.floor, space.margin)


def probings(moves: Probings, space: Space) -> list[Sweep]:
    """Probings as sweeps of two poses each, which begin where the rod is behind the bounding body."""
    found = []
    for start, axes, travel in zip(*moves, strict=True):
        end = start + travel * axes[1]
        back = _drawn_back(Sweep(np.stack([start, end]), axes), space)[0]
        if min(back[2], back[2] + space.length * axes[1, 2]) >= space.floor - NEGLIGIBLE * space.length:
            found.append(Sweep(np.stack([back, end]), axes, Move.PROBE))
    return found


def lines_to(targets: Array, normals: Array, space: Space, random: np.random.Generator) -> list[Line]:
    """Lines to places (k, 3) of a body's surface with outward normals (k, 3), as by `aims.aimed`, for a body on a table.

    The rod lies across the normal and comes down on the place along it.  Places to which no such line leads from above the
    table are left out.
    """
    lines = []
    for target, normal in zip(targets, normals, strict=True):
        first, second = across(normal)
        for angle in random.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(16) / 16:
            along = np.cos(angle) * first + np.sin(angle) * second
            if along[2] > -0.02:  # nearly level, or upwards
                continue
            spread = np.cross(normal, along)
            line = _line(space, along, spread, normal, float(target @ spread))
            if (target - line.start) @ along <= (1 - _LEAST) * space.length:
                lines.append(line)
                break
    return lines
