"""Step 1 over a plan: a body swept slice by slice, from several sides, into a recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import planar
from scan3d import planning
from scan3d.bodies import extent_along, slice_polygons
from scan3d.bracket import Gap, Slab, outside, slabs
from scan3d.cloud import contacts
from scan3d.errors import InputError
from scan3d.hulls import hull
from scan3d.layers import slice_frame, stacks
from scan3d.planning import Plan
from scan3d.recording import Recording
from scan3d.rods import Rod
from scan3d.units import UNITS_M

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

# Slices that are swept in one go: enough to fill the arrays, few enough to report progress.
_SLICES_AT_ONCE = 16
# Rounds of further sweeps for what the ones before have left open.
_ROUNDS = 2
# Adaptive spacing adds this share of the slices so far in each round.
_GROWTH = 0.12
# Heights at which the body's width is looked up to choose a rod for it.
_WIDTH_HEIGHTS = 33


class _Approach(NamedTuple):
    """One sweep: a slice, a direction of the undeformed rod in it, and the clamp's frame."""

    slice: int
    number: int
    """Of the slice's sweeps."""
    axes: Array
    """(2, 2) the clamp's x and y axes in the slice's frame, as rows."""
    origin: Array
    """(2,) point of the base line, in the slice's frame and the mesh's unit."""


@dataclass
class _Axis:
    """The scan along one axis as far as it has come."""

    mesh: Any
    plan: Plan
    length: float
    """Of the rod, in the mesh's unit."""
    frame: Array
    number: int
    heights: list[float] = field(default_factory=list)
    polygons: list[Array] = field(default_factory=list)
    sweeps: list[tuple[_Approach, planar.Sweep]] = field(default_factory=list)
    unreached: int = 0
    """Sweeps that were not made, their slice being out of the rod's reach."""

    def scan(self, heights: Array) -> None:
        """Sweep further slices."""
        first = len(self.heights)
        self.heights += heights.tolist()
        self.polygons += slice_polygons(self.mesh, self.frame, heights)
        new = range(first, len(self.heights))
        self.sweeps += self._sweep_slices([i for i in new if len(self.polygons[i])])
        for i in new:
            if not len(self.polygons[i]):
                self.sweeps += self._sweep_empty(i)

    def _sweep_slices(self, block: list[int]) -> list[tuple[_Approach, planar.Sweep]]:
        """All sweeps of some slices, in the order of slices and directions."""
        todo = {i: planning.first_directions(self.plan) for i in block}
        done: dict[int, list[tuple[_Approach, planar.Sweep]]] = {i: [] for i in block}
        for round_ in range(1 + _ROUNDS):
            approaches = [
                self._approach(i, len(done[i]) + k, angle, self.polygons[i])
                for i, angles in todo.items()
                for k, angle in enumerate(angles)
            ]
            for approach, sweep in zip(approaches, self._sweep(approaches), strict=True):
                # what is out of the rod's reach is not swept: it must not pass for empty
                if sweep is not None:
                    done[approach.slice].append((approach, sweep))
                else:
                    self.unreached += 1
            if self.plan.sweeps is not None or round_ == _ROUNDS:
                break
            todo = {i: self._open(done[i], self.polygons[i])[: planning.MOST_SWEEPS - len(done[i])] for i in todo}
            todo = {i: angles for i, angles in todo.items() if len(angles)}
        return [pair for i in block for pair in done[i]]

    def _sweep_empty(self, i: int) -> list[tuple[_Approach, planar.Sweep]]:
        """Sweeps that find nothing, where the nearest slice with a contour is swept."""
        filled = [j for j, polygon in enumerate(self.polygons) if len(polygon)]
        if not filled:
            return []
        nearest = min(filled, key=lambda j: abs(self.heights[j] - self.heights[i]))
        pairs = []
        for k, angle in enumerate(planning.first_directions(self.plan)):
            approach = self._approach(i, k, angle, self.polygons[nearest])
            across = (self.polygons[nearest] - approach.origin) @ approach.axes[0] / self.length
            pairs.append((approach, self._nothing(across)))
        return pairs

    def _nothing(self, across: Array) -> planar.Sweep:
        """A sweep past some places (n,) along its line that touches nothing."""
        n = self.plan.samples
        x0 = np.linspace(across.max() + 0.01, across.min() - 0.01, n)
        none = np.full(n, np.nan)
        phase = np.full(n, planar.Phase.NONE, dtype=np.int8)
        return planar.Sweep(x0, none, none, none, none, np.full((n, 2), np.nan), none, phase, none)

    def _approach(self, slice_: int, number: int, angle: float, polygon: Array) -> _Approach:
        y = np.array([np.cos(angle), np.sin(angle)])
        x = np.array([y[1], -y[0]])
        fixed = self.plan.standoff == "fixed"
        outline = self.mesh.vertices.view(np.ndarray) @ self.frame[:2].T if fixed else polygon
        # the base line's origin lies below the middle of the outline's box, which keeps the coordinates small
        middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
        depth = ((outline - middle) @ y).min() - self.plan.clearance * self.length
        return _Approach(slice_, number, np.stack([x, y]), middle + depth * y)

    def _sweep(self, approaches: list[_Approach]) -> list[planar.Sweep | None]:
        """The sweeps, None where the slice is out of the rod's reach."""
        outlines = [(self.polygons[a.slice] - a.origin) @ a.axes.T / self.length for a in approaches]
        within = [k for k, outline in enumerate(outlines) if outline[:, 1].min() <= 1]
        low, high = self.plan.friction_range
        friction: list[Any] = [low] * len(approaches)
        if high > low:
            # a stream of its own for each sweep, so that its draws don't depend on the order of work
            keys = [[self.plan.seed, 0, self.number, a.slice, a.number] for a in approaches]
            friction = [np.random.default_rng(key).uniform(low, high, self.plan.samples) for key in keys]
        contours = [planar.Polygon(outlines[k]) for k in within]
        shares = planning.base_shares(self.plan.samples)
        swept = planar.sweep_all(contours, [friction[k] for k in within], shares=shares) if within else []
        found = dict(zip(within, swept, strict=True))
        return [found.get(k) for k in range(len(approaches))]

    def _open(self, done: list[tuple[_Approach, planar.Sweep]], polygon: Array) -> Array:
        """Approach directions for what the sweeps have left open of a slice."""
        points, normals = [], []
        for approach, sweep in done:
            lying = sweep.phase == planar.Phase.TANGENTIAL
            slope = sweep.slope[lying]
            points.append(sweep.point[lying] @ approach.axes * self.length + approach.origin)
            normals.append(np.stack([np.sin(slope), -np.cos(slope)], axis=1) @ approach.axes)
        if not sum(map(len, points)):
            return np.empty(0)
        width = float(np.ptp(polygon, axis=0).max())
        return planning.further_directions(np.concatenate(points), np.concatenate(normals), width)


def simulate(mesh: Any, plan: Plan | None = None, progress: Progress | None = None) -> Recording:
    """Recording of a simulated scan of a convex `trimesh.Trimesh`.

    `progress` is called with the number of slices done and of all.  Raises InputError if the body can't be scanned so.
    """
    plan = plan or Plan()
    frames = [slice_frame(axis) for axis in plan.axes()]
    metres = UNITS_M[plan.unit]
    rod = plan.rod or Rod.of_length(metres * max(_width(mesh, frame) for frame in frames))
    scans = [_Axis(mesh, plan, rod.length_m / metres, frame, k) for k, frame in enumerate(frames)]
    for k, scan in enumerate(scans):
        count = plan.slices * len(scans)

        def report(done: int, before: int = plan.slices * k, count: int = count) -> None:
            if progress is not None:
                progress(before + min(done, plan.slices), count)

        todo = planning.first_heights(*extent_along(mesh, scan.frame[2]), plan)
        for first in range(0, len(todo), _SLICES_AT_ONCE):
            scan.scan(todo[first : first + _SLICES_AT_ONCE])
            report(len(scan.heights))
        if plan.spacing == "adaptive":
            _adapt(scan, rod, report)
    return _recording(scans, rod)


def _adapt(scan: _Axis, rod: Rod, report: Callable[[int], None]) -> None:
    """Sweep further slices where the contacts so far, noise included, leave most room for the body."""
    known: dict[tuple[float, ...], Slab] = {}
    gaps: dict[int, Array] = {}
    while len(scan.heights) < scan.plan.slices:
        cloud = contacts(_recording([scan], rod))
        stack, inner = stacks(cloud)[0], hull(cloud.points)
        parts = slabs(stack, known=known)
        # a slab's gap is computed once: it only shrinks when the hull grows elsewhere
        for slab in parts:
            if id(slab) not in gaps:
                gaps[id(slab)] = outside(slab.corners, inner) if np.isfinite(slab.corners).all() else np.full(1, np.inf)
        corners, kind, flat = (np.concatenate([slab[i] for slab in parts]) for i in range(3))
        gap = np.concatenate([gaps[id(slab)] for slab in parts])
        diagonal = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
        if gap.max() <= scan.plan.tolerance * diagonal:
            break
        levels = np.array([stack.floor, *stack.heights, stack.ceiling])
        left = scan.plan.slices - len(scan.heights)
        room = max(1, min(round(_GROWTH * len(scan.heights)), left // 3))
        between = np.isfinite(gap) & (kind != Gap.CONTACTS)
        slab = np.repeat(np.arange(len(parts)), [len(part.corners) for part in parts])[between]
        heights, kinks = corners[between] @ stack.frame[2], flat[between].all(axis=1)
        new = planning.next_heights(levels, slab, heights, gap[between], kinks, room, left)
        if not len(new):
            break
        scan.scan(new)
        report(len(scan.heights))


def _width(mesh: Any, frame: Array) -> float:
    """Diameter of the widest slice about its middle: with a rod of that length, a sweep sees most of a slice."""
    low, high = extent_along(mesh, frame[2])
    polygons = slice_polygons(mesh, frame, np.linspace(low, high, _WIDTH_HEIGHTS + 2)[1:-1])
    wide = [2 * np.linalg.norm(p - (p.min(axis=0) + p.max(axis=0)) / 2, axis=1).max() for p in polygons if len(p)]
    if not wide:
        raise InputError("the body is too thin to be sliced along this axis; choose another one")
    return float(max(wide))


def _recording(scans: list[_Axis], rod: Rod) -> Recording:
    """All that has been swept, as a rig would log it."""
    plan, length = scans[0].plan, scans[0].length
    metres = UNITS_M[plan.unit]
    pairs = [(scan, *pair) for scan in scans for pair in scan.sweeps]
    unreached = sum(scan.unreached for scan in scans)
    count = np.array([len(sweep) for *_, sweep in pairs])
    position, turned, wrench = [], [], []
    for scan, approach, sweep in pairs:
        in_slice = approach.origin + sweep.x0[:, None] * length * approach.axes[0]
        level = np.full(len(sweep), scan.heights[approach.slice])
        position.append(np.column_stack([in_slice, level]) @ scan.frame)
        turned.append(np.vstack([approach.axes @ scan.frame[:2], scan.frame[2]]))
        wrench.append(np.stack([sweep.f0x, sweep.f0y, sweep.m0z], axis=1))
    # scipy wants the clamp's axes as columns
    quaternion = Rotation.from_matrix(np.swapaxes(np.array(turned), 1, 2)).as_quat(scalar_first=True)
    measured = np.concatenate(wrench)
    measured = np.where(np.isnan(measured), 0.0, measured)
    if plan.noise > 0:
        measured += plan.noise * np.random.default_rng([plan.seed, 1]).standard_normal(measured.shape)
    return Recording(
        sweep=np.repeat(np.arange(len(pairs)), count),
        position_m=np.concatenate(position) * metres,
        quaternion=np.repeat(quaternion, count, axis=0),
        force_N=measured[:, :2] * rod.force_unit_N,
        moment_Nm=measured[:, 2] * rod.moment_unit_Nm,
        rod=rod,
        noise_force_N=plan.noise * rod.force_unit_N,
        noise_moment_Nm=plan.noise * rod.moment_unit_Nm,
        unit=plan.unit,
        source={"kind": "simulation", "seed": plan.seed, **({"sweeps_out_of_reach": unreached} if unreached else {})},
    )
