"""Simulation of a scan (step 1): a body is swept slice by slice, or in space, from several directions; reactions are recorded.

In space a round rod is free to leave the plane of its sweep.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

import planar
from scan3d.arrays import Array
from scan3d.errors import InputError, UsageError
from scan3d.files.text import to_float
from scan3d.geometry.hulls import check_body, check_convex, is_convex
from scan3d.geometry.sections import extent_along, slice_frame
from scan3d.planning.heights import (
    BEYOND,
    FEW,
    FIRST_PART,
    Aims,
    SlabMemory,
    first_heights,
    next_heights,
    open_contours,
)
from scan3d.planning.plan import (
    FIRST_SWEEPS,
    MAX_SWEEPS,
    Aim,
    BaseLine,
    Lines,
    Plan,
    aimed,
    aimed_line,
    aims,
    base_clearances,
    base_fractions,
    base_line,
    clamp_axes,
    first_directions,
    further_directions,
    positions,
    rasters,
)
from scan3d.planning.probing import PLANES
from scan3d.poses import AWAY
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.slices import SAME_AXIS
from scan3d.recording import Recording
from scan3d.rods import Rod
from scan3d.simulation.felt import (
    check_simple,
    contour_of,
    drawn_friction,
    grown_extent,
    recorded,
    rounded_body,
    sections,
)
from scan3d.simulation.probing import probe
from scan3d.spatial.bodies import RoundedPolyhedron
from scan3d.spatial.march import free_reactions
from scan3d.spatial.sweeping import End, Sweeps, passages, sweep
from scan3d.units import UNITS_M, length
from scan3d.workers import check_memory, counted, shared, tell

Progress = Callable[[int, int], None]

# Rounds of further sweeps for the parts of a contour that earlier sweeps have left open.
_ROUNDS = 2
# Arc length of a contact, in rod lengths, below which a sweep in space ends: the force grows without limit.
_NEAREST = 0.2


def simulate(mesh: Any, plan: Plan | None = None, progress: Progress | None = None) -> Recording:
    """Recording of a simulated scan of a closed `trimesh.Trimesh`.

    mesh
        the body, with coordinates in the plan's unit.
    plan
        the settings; those of `Plan()` by default.
    progress
        is called with how many slices, sweeps or planes of probings are done, and of how many.

    Raises InputError if the body is not closed, if it is too thin to be sliced along an axis of the plan, and if the
    recording would not fit into memory.
    """
    plan = plan or Plan()
    check_body(mesh)
    with counted(progress):
        return simulate_judged(mesh, plan)


def simulate_judged(mesh: Any, plan: Plan) -> Recording:
    """`simulate` for a body that `load_mesh` or `judge_mesh` has just returned, which is not judged again.

    How many slices, sweeps and probings are done is told to who hears of it (`workers.heard`).
    """
    _check_size(mesh, plan, _most_slices(plan), plan.sweeps or FIRST_SWEEPS)
    convex = is_convex(mesh)
    along = plan.probing == "only" or plan.has_bead or (plan.probing == "auto" and not convex)
    if plan.tolerance and (along or not convex):
        raise InputError(
            "a tolerance is met by the certified bound between slices, which a body that is not convex does not have; leave "
            "the tolerance out, or scan the convex hull with --hull"
        )
    only = plan.probing == "only" or plan.model == "spatial" or not (plan.rod is None or plan.rod.is_simple)
    if along and only:
        return probe(mesh, plan, rod_for(mesh, plan))
    if plan.model == "spatial":
        check_convex(mesh, "the spatial model of a simulated scan")
        return simulate_spatial(mesh, plan)
    for setting, given in (("axis free", plan.is_free), ("a tolerance", plan.tolerance)):
        if given and plan.spacing != "adaptive":
            raise UsageError(f"{setting} needs adaptive spacing, got spacing {plan.spacing!r}; leave one of them out")
    frames = [slice_frame(axis) for axis in plan.axes()]
    metres = UNITS_M[plan.unit]
    if along:
        rod = rod_for(mesh, plan)
    else:
        widest = max(width_of(mesh, frame) for frame in frames)
        rod = plan.rod or Rod.of_length(metres * (float(np.linalg.norm(mesh.extents)) if plan.is_free else widest))
    if not convex and not rod.without_thickness().is_simple:
        raise InputError(
            "a body that is not convex is swept by a straight, uniform, weightless rod in a rigid clamp only; choose "
            "such a rod, or scan the convex hull with --hull"
        )
    if not convex and plan.spacing == "adaptive":  # which asks for bounds between slices, as convex bodies have
        plan = replace(plan, spacing="uniform")
    planes = PLANES * plan.slices if along else 0
    if along:  # a few sweeps tell friction and normals; rods that move along themselves reach more
        plan = replace(plan, slices=max(plan.slices // 8, 1))
    if plan.rod is None or rod.tapered or not convex:  # no radius fattens the body for a tapered rod
        rod = rod.without_thickness()
    length, radius = rod.length_m / metres, rod.diameter_m / 2 / metres
    scans = [AxisScan(mesh, plan, length, radius, frame, k) for k, frame in enumerate(frames)]
    if plan.is_free and convex and not plan.noise:
        _scan_in_any_planes(scans, rod)
        return recording_of(scans, rod)
    for k, scan in enumerate(scans):

        def report(done: int, before: int = plan.slices * k) -> None:
            tell("slices", before + min(done, plan.slices), plan.slices * len(scans))

        report(0)
        first = first_heights(*scan.extent, plan)
        # rods of bodies that are not convex are followed together, and by several processes
        together = 16 if convex else 64
        for start in range(0, len(first), together):
            scan.scan(first[start : start + together])
            _check_sweeps(scan, plan.samples)
            report(len(scan.heights))
        if plan.spacing == "adaptive":
            # only exact contacts along different axes agree well enough for one to tell of another
            _adapt(scan, rod, report, [] if plan.noise else scans[:k])
        if not convex and plan.sweeps is None and not along:
            _aim(scan, rod)
    swept = recording_of(scans, rod)
    return probe(mesh, replace(plan, slices=planes // PLANES), rod, [swept]) if along else swept


def rod_for(mesh: Any, plan: Plan) -> Rod:
    """The rod of a body that is probed: that of the plan, or one that reaches through it.

    Raises InputError for a rod that does not follow its end.
    """
    if plan.rod is not None and any(plan.rod.curvatures):
        raise InputError("a body is probed with a rod that is straight at rest; choose such a rod, or probing off")
    diagonal = UNITS_M[plan.unit] * float(np.linalg.norm(mesh.extents))
    # the clamp stays away from the body
    rod = (plan.rod or Rod.of_length(diagonal / (1 - 2 * AWAY))).without_thickness()
    return replace(rod, bead_diameter_m=UNITS_M[plan.unit] * plan.bead) if plan.bead else rod


def _check_size(mesh: Any, plan: Plan, slices: int, sweeps: float) -> None:
    """Raise InputError if a scan of so many slices, with so many sweeps in each, needs more memory than there is."""
    samples = to_float(slices) * to_float(sweeps) * to_float(plan.samples)
    check_memory(
        # as was measured: for each sample, slice and facet of the body, and those of the program itself
        samples * 1000 + to_float(slices) * 300_000 + len(mesh.faces) * 1000 + 400_000_000,
        f"a scan of {to_float(slices):.4g} slices with {to_float(sweeps):.4g} sweeps of {to_float(plan.samples):.4g} "
        "samples",
        "choose fewer slices, sweeps or samples",
    )


def _most_slices(plan: Plan) -> int:
    return len(plan.axes()) * (plan.slices + BEYOND)


def _check_sweeps(scan: AxisScan, samples: int) -> None:
    """`_check_size` with as many sweeps in a slice as those swept so far have needed, of so many samples.

    With a tolerance the slices so far count, because it takes as many as are needed.
    """
    plan = replace(scan.plan, samples=samples)
    slices = len(scan.heights) if plan.tolerance else _most_slices(plan)
    _check_size(scan.mesh, plan, slices, len(scan.swept) / len(scan.heights))


def _cosine_heights(scan: AxisScan) -> Array:
    return first_heights(*scan.extent, replace(scan.plan, spacing="cosine"))


def _adapt(
    scan: AxisScan,
    rod: Rod,
    report: Callable[[int], None],
    others: Sequence[AxisScan] = (),
    until: int | None = None,
) -> None:
    """Ask for the next heights, sweep there, and ask again; the contacts given to the planner have the recording's noise.

    Contacts of finished scans along other axes are given to the planner as well.  Ends at `until` slices, if that is given.
    """
    # four times doubled, so that contacts show the contour within the tolerance
    finest, memory = 16 * scan.plan.samples, SlabMemory()
    if scan.plan.tolerance and not scan.plan.noise:
        with suppress(InputError):  # the first slices alone may span no body
            # gaps between contacts make secants to close slices steep
            _refine(scan, rod, 0.25 * scan.plan.tolerance, finest)
    most = scan.plan.slices + BEYOND
    while (left := most - len(scan.heights)) > 0 and len(scan.heights) < (until or most):
        try:
            cloud = contacts(recording_of([*others, scan], rod))
            heights = next_heights(cloud, scan.frame[2], left, tolerance=scan.plan.tolerance, memory=memory)
        except InputError:  # too few contacts to say where others are needed
            heights = np.setdiff1d(_cosine_heights(scan), scan.heights)[:left]
        if not len(heights):
            if not (scan.plan.tolerance and _refine(scan, rod, scan.plan.tolerance, finest)):
                break
            memory = SlabMemory()
            continue
        scan.scan(heights)
        _check_sweeps(scan, scan.plan.samples)
        report(len(scan.heights))


def _aim(scan: AxisScan, rod: Rod) -> None:
    """Sweep slices of a body that is not convex again, at the widest stretches of their contours that no contact supports."""
    for number in range(_ROUNDS):
        recording = recording_of([scan], rod)
        try:
            aimed = aims(recording, contacts(recording))
        except InputError:  # too few contacts to say where others are needed
            return
        scan.sweep_at(aimed, f"aimed sweeps, round {1 + number} of {_ROUNDS}")
        _check_sweeps(scan, scan.plan.samples)


def _refine(scan: AxisScan, rod: Rod, wanted: float, finest: int) -> bool:
    """Sweep slices again whose contours are not known within `wanted`, relative to the diagonal.

    They are swept with up to `finest` samples, as are further slices then.  Where more samples do not help, a part of the
    contour was touched by the rod's tip only, and they are swept from further directions.  Says whether there are any.
    """
    swept_again, widest = False, np.inf
    limit = wanted * float(np.linalg.norm(scan.mesh.extents))
    while True:
        heights, gap = open_contours(contacts(recording_of([scan], rod)), wanted)
        if not len(heights):
            break
        # gaps fall with the square of the samples, but not those that are due to noise
        if gap <= widest / 2 and scan.plan.samples < finest:
            _check_sweeps(scan, 2 * scan.plan.samples)
            scan.sweep_again(heights)
        elif scan.plan.noise or scan.plan.sweeps is not None or not scan.sweep_further(heights, limit):
            break
        swept_again, widest = True, gap
    return swept_again


def _scan_in_any_planes(scans: list[AxisScan], rod: Rod) -> None:
    """Scan along one axis, and then in planes to which scans are added, as the contacts so far choose them."""
    first, plan, aims = scans[0], scans[0].plan, Aims()

    def report(*_: int) -> None:
        tell("slices", min(sum(len(scan.heights) for scan in scans), plan.slices), plan.slices)

    def scanned(scan: AxisScan, heights: Array) -> None:
        scan.scan(heights)
        _check_sweeps(scan, plan.samples)
        report()

    scanned(first, first_heights(*first.extent, plan))
    _adapt(first, rod, report, until=round(FIRST_PART * min(plan.slices, FEW)))
    while (left := plan.slices + BEYOND - sum(len(scan.heights) for scan in scans)) > 0:
        try:
            further, alone = aims.next_slices(contacts(recording_of(scans, rod)), plan, left)
        except InputError:  # too few contacts to say where others are needed
            heights = np.setdiff1d(_cosine_heights(first), first.heights)
            further, alone = [(first.frame[2], heights)] if len(heights) else [], None
        if alone is not None:
            scan = _along(scans, alone)
            scan.plan = replace(plan, slices=len(scan.heights) + left - BEYOND, axis=tuple(scan.frame[2]))
            _adapt(scan, rod, report, [other for other in scans if other is not scan])
        if not further:
            break
        for axis, heights in further:
            scanned(_along(scans, axis), heights[:left])
            left = max(left - len(heights), 0)


def _along(scans: list[AxisScan], axis: Array) -> AxisScan:
    """The scan along an axis, which is added if there is none."""
    scan = min(scans, key=lambda scan: float(np.abs(scan.frame[2] - axis).max()))
    if np.abs(scan.frame[2] - axis).max() > SAME_AXIS:
        scan = replace(scan, frame=slice_frame(axis), number=len(scans), heights=[], loops=[], swept=[])
        scans.append(scan)
    return scan


class _Swept(NamedTuple):
    slice: int
    line: BaseLine
    result: planar.Sweep
    place: Array
    """(n, 3) positions of the clamp in the world."""
    axes: Array
    """(3, 3) of the clamp, as rows."""
    wrench: Array
    """(n, 3) reactions in the plane, dimensionless."""


@dataclass
class AxisScan:
    """The slices and sweeps made so far along one axis."""

    mesh: Any
    plan: Plan
    length: float
    """Of the rod, in the mesh's unit."""
    radius: float
    """Of the rod, whose centre line touches the mesh fattened by it."""
    frame: Array
    """(3, 3) axes of the slices' frame in the world, as rows."""
    number: int
    """Of the axis among those of the plan."""
    heights: list[float] = field(default_factory=list)
    loops: list[list[Array]] = field(default_factory=list)
    """Contours (m, 2) of each slice."""
    swept: list[_Swept] = field(default_factory=list)

    @cached_property
    def convex(self) -> bool:
        """Whether the body is, so that the rod touches it at one place at a time."""
        return is_convex(self.mesh)

    def outline(self, i: int) -> Array:
        """(m, 2) vertices of the contours of slice i."""
        return np.concatenate([*self.loops[i], np.empty((0, 2))])

    @property
    def extent(self) -> tuple[float, float]:
        """Lowest and highest place of the fattened mesh along the axis."""
        return grown_extent(self.mesh, self.frame[2], self.radius)

    def scan(self, heights: Array) -> None:
        """Sweep further slices."""
        first = len(self.heights)
        self.heights += heights.tolist()
        self.loops += sections(self.mesh, self.frame, heights, self.radius, self.length)
        new = range(first, len(self.heights))
        self.swept += self._sweep_slices([i for i in new if self.loops[i]])
        for i in new:
            if not self.loops[i]:
                self.swept += self._sweep_empty(i)

    def sweep_again(self, heights: Array) -> None:
        """Sweep slices again, with twice the samples in a sweep, as all further slices."""
        self.plan = replace(self.plan, samples=2 * self.plan.samples)
        chosen = self._nearest(heights)
        self.swept = [swept for swept in self.swept if swept.slice not in chosen]
        self.swept += self._sweep_slices(chosen)

    def sweep_further(self, heights: Array, limit: float) -> bool:
        """Sweep slices from further directions as well, towards what their contacts leave open by more than `limit`.

        The limit is a length in the mesh's unit.  Says whether there are such sweeps.
        """
        done = {i: [swept for swept in self.swept if swept.slice == i] for i in self._nearest(heights)}
        further = self._sweep({i: self._lines(i, self._open_directions(done[i], i, limit)) for i in done}, done)
        self.swept += further
        return bool(further)

    def sweep_at(self, aimed: list[Aim], words: str) -> None:
        """Sweep slices again, from base lines from which the rod's end reaches as far as is aimed at; `words` are told."""
        slices = self._nearest(np.array([aim.height for aim in aimed])) if aimed else []
        done = {i: [swept for swept in self.swept if swept.slice == i] for i in slices}
        lines: dict[int, list[BaseLine]] = {i: [] for i in slices}
        for aim in aimed:
            (i,) = self._nearest(np.array([aim.height]))
            lines[i].append(aimed_line(aim, self.outline(i), self.length, self.plan.clearance * self.length))
        self.swept += self._sweep(lines, done, words)

    def _nearest(self, heights: Array) -> list[int]:
        """The numbers of the slices at some heights, each once."""
        nearest = np.abs(np.array(self.heights) - heights[:, None]).argmin(axis=1)
        return list(map(int, np.unique(nearest)))

    def _sweep_slices(self, slices: list[int]) -> list[_Swept]:
        """All sweeps of some slices, in the order of slices and directions."""
        done: dict[int, list[_Swept]] = {i: [] for i in slices}
        lines = {i: self._lines(i, first_directions(self.plan), first=True) for i in slices}
        for rounds_done in range(1 + _ROUNDS):
            for swept in self._sweep(lines, done):
                done[swept.slice].append(swept)
            # what tangents leave open is known of convex contours
            if self.plan.sweeps is not None or rounds_done == _ROUNDS or not self.convex:
                break
            directions = {i: self._open_directions(done[i], i) for i in lines}
            lines = {i: self._lines(i, angles) for i, angles in directions.items() if len(angles)}
        return [swept for i in slices for swept in done[i]]

    def _sweep_empty(self, i: int) -> list[_Swept]:
        """Sweeps without contact of an empty slice, past the nearest contour and where it would be if the body went on."""
        filled = [j for j, loops in enumerate(self.loops) if loops]
        if not filled:
            return []
        nearest = min(filled, key=lambda j: abs(self.heights[j] - self.heights[i]))
        outline = np.concatenate([self.outline(nearest), self._extrapolated(nearest, filled, self.heights[i])])
        swept, n = [], self.plan.samples
        for angle in first_directions(self.plan):
            line = base_line(outline, angle, self.plan.clearance * self.length)
            across = (outline - line.origin) @ line.axes[0] / self.length
            x0 = np.linspace(across.max() + 0.2, across.min() - 0.2, n)  # rod lengths beyond them
            unknown, phase = np.full(n, np.nan), np.full(n, planar.Phase.NONE, dtype=np.int8)
            point = np.full((n, 2), np.nan)
            empty = planar.Sweep(x0, unknown, unknown, unknown, unknown, point, unknown, phase, unknown)
            swept.append(self._logged(i, line, empty))
        return swept

    def _extrapolated(self, i: int, filled: list[int], height: float) -> Array:
        """Slice i's contour (n, 2) at another height, moved and scaled as from the nearest of the other filled slices."""
        contour = self.outline(i)
        others = [j for j in filled if j != i]
        if not others:
            return contour
        behind = min(others, key=lambda j: abs(self.heights[j] - self.heights[i]))
        polygons = (contour, self.outline(behind))
        (centre, size), (before, size_before) = ((one.mean(axis=0), np.ptp(one, axis=0)) for one in polygons)
        ahead = (height - self.heights[i]) / (self.heights[i] - self.heights[behind])
        scaled = np.maximum(1 + ahead * (1 - size_before / size), 0.0)
        return centre + ahead * (centre - before) + scaled * (contour - centre)

    def _lines(self, i: int, directions: Array, *, first: bool = False) -> list[BaseLine]:
        """Base lines of sweeps of slice i from some directions: with the `first` ones, nearer and farther ones, unless probings
        reach into the body."""
        outline, clearances = self.outline(i), [[self.plan.clearance]] * len(directions)
        if first and not self.convex and self.plan.probing == "off":
            clearances = base_clearances(self.plan, len(directions))
        return [
            base_line(outline, angle, clearance * self.length)
            for angle, several in zip(directions, clearances, strict=True)
            for clearance in several
        ]

    def _sweep(
        self, lines: dict[int, list[BaseLine]], done: dict[int, list[_Swept]], words: str = "sweeps"
    ) -> list[_Swept]:
        """Sweeps of slices along some base lines each, after those that are done."""
        aims = [(i, len(done[i]) + k, line) for i, of_slice in lines.items() for k, line in enumerate(of_slice)]
        if not aims:
            return []
        bounds, samples, seed = self.plan.friction_range, self.plan.samples, self.plan.seed
        friction = [drawn_friction(bounds, samples, [seed, 0, self.number, i, number]) for i, number, _ in aims]
        try:
            contours, shares = [self._contour(i, line) for i, _, line in aims], base_fractions(samples)
            down = self.plan.down(np.array([clamp_axes(line, self.frame) for *_, line in aims]))
            rod = None if self.plan.rod is None else self.plan.rod.in_plane(down)
            if self.convex:
                results = planar.sweep_all(contours, friction, shares=shares, rod=rod)
            else:
                sweeps = list(zip(contours, friction, strict=True))
                # fewer that are stepped together take longer for each
                # probings come where contacts behind second ones are left out
                single = self.plan.probing != "off"
                results = shared(partial(_sweep_together, shares=shares, single=single), sweeps, 192, words)
        except InputError:
            raise
        except ValueError as error:
            raise InputError(
                f"this body can't be swept with a rod {length(self.length, self.plan.unit)} long and a clearance of "
                f"{self.plan.clearance:g}: {error}"
            ) from None
        return [self._logged(i, line, result) for (i, _, line), result in zip(aims, results, strict=True)]

    def _logged(self, i: int, line: BaseLine, result: planar.Sweep) -> _Swept:
        place = positions(line, result.x0 * self.length, self.heights[i], self.frame)
        wrench = np.stack([result.f0x, result.f0y, result.m0z], axis=1)
        return _Swept(i, line, result, place, clamp_axes(line, self.frame), wrench)

    def _contour(self, i: int, line: BaseLine) -> planar.Contour:
        """The contour of slice i in the frame of a base line, in rod lengths."""
        return contour_of([(loop - line.origin) @ line.axes.T / self.length for loop in self.loops[i]])

    def _open_directions(self, done: list[_Swept], i: int, limit: float | None = None) -> Array:
        """Approach directions for what the sweeps of slice i have left open of its contour, as `further_directions`."""
        points, normals = [], []
        for _, line, result, *_ in done:
            tangential = result.phase == planar.Phase.TANGENTIAL
            slope = result.slope[tangential]
            points.append(result.point[tangential] @ line.axes * self.length + line.origin)
            normals.append(np.stack([np.sin(slope), -np.cos(slope)], axis=1) @ line.axes)
        width = float(np.ptp(self.outline(i), axis=0).max())
        further = further_directions(np.concatenate(points), np.concatenate(normals), width, limit)
        return further[: max(MAX_SWEEPS - len(done), 0)]


def _sweep_together(sweeps: Sequence[tuple[planar.Contour, Array]], shares: Array, single: bool) -> list[planar.Sweep]:
    contours, friction = zip(*sweeps, strict=True)
    return planar.sweep_all(contours, friction, shares=shares, single=single)


def width_of(mesh: Any, frame: Array) -> float:
    """Largest diameter of the slices about their middles; a sweep with a rod of that length sees most of a slice."""
    low, high = extent_along(mesh, frame[2])
    loops = sections(mesh, frame, np.linspace(low, high, 35)[1:-1])
    outlines = [np.concatenate(part) for part in loops if part]
    widths = [2 * np.linalg.norm(p - (p.min(axis=0) + p.max(axis=0)) / 2, axis=1).max() for p in outlines]
    if not widths:
        raise InputError("the body is too thin to be sliced along this axis; choose another one")
    return float(max(widths))


def recording_of(scans: list[AxisScan], rod: Rod) -> Recording:
    """The recording of all sweeps so far, as a rig would log it.

    Samples of which no equilibrium was found are left out, and what follows them counts as another sweep.
    """
    plan = scans[0].plan
    swept = [swept for scan in scans for swept in scan.swept]
    axes = np.array([one.axes for one in swept])
    of_sweep = np.repeat(np.arange(len(swept)), [len(one.result) for one in swept])
    known = np.concatenate([one.result.status != planar.SweepStatus.UNRESOLVED for one in swept])
    begins = known & ((np.diff(of_sweep, prepend=-1) != 0) | ~np.roll(known, 1))
    number = (np.cumsum(begins) - 1)[known]
    place = np.concatenate([one.place for one in swept])[known]
    wrench = np.concatenate([one.wrench for one in swept])[known]
    down = plan.down(axes)
    if down is not None and plan.gravity is not None:
        force, moment = free_reactions(rod.in_space(), down.T)
        in_air = np.stack([*force[:2], moment[2]], axis=1)[of_sweep[known]]
        added = np.nan_to_num(wrench - in_air)
        added[np.hypot(*added.T[:2]) <= planar.TOLERANCE] = 0.0  # at touch-down the difference is rounding
        wrench = added + (0.0 if plan.gravity.tared else in_air)
    unresolved = int((~known).sum())
    source = {"unresolved": unresolved} if unresolved or not scans[0].convex else {}
    source |= {} if scans[0].convex else {"convex": False}
    return recorded(plan, rod, axes[of_sweep[begins]], number, place, wrench, source)


# --- in space ---


class _SpatialSweeps(NamedTuple):
    """Sweeps and their clamps, in rod lengths."""

    position: Array
    """(m, n, 3)"""
    axes: Array
    """(m, 3, 3)"""
    result: Sweeps


def simulate_spatial(mesh: Any, plan: Plan) -> Recording:
    """Recording of a scan in space of a convex `trimesh.Trimesh`, with six axes.

    The rod's centre line touches the mesh fattened by the rod's radius.  Raises InputError if the rod touches nothing.
    """
    metres = UNITS_M[plan.unit]
    vertices = np.asarray(mesh.vertices, dtype=float)
    rod = plan.rod or Rod.of_length(metres * float(np.ptp(vertices, axis=0).max()))
    check_simple(rod)
    length = rod.length_m / metres
    body, middle = rounded_body(mesh, length, rod.diameter_m / metres / 2)
    points = (vertices - middle) / length
    per_direction = plan.sweeps or max(2, round(0.4 * plan.slices))
    rounds = 5  # in which the aimed sweeps are made
    tell("rounds", 0, 1 + rounds)
    swept = _sweep_in_space(body, rasters(points, per_direction, plan.clearance), plan, 0)
    if not swept:
        raise InputError(
            "the rod touches nothing: its sweeps do not reach the body; choose a longer rod or less clearance"
        )
    generator = np.random.default_rng([plan.seed, 2])
    # with these, a scan in space has at most one and a half times as many samples as a planar one
    further = 0 if plan.sweeps else round(3.5 * 12 * per_direction / rounds)
    for number in range(rounds if further else 0):
        contacts, normals = (
            np.concatenate([vectors[np.isfinite(part.result.s1)] for part, vectors in zip(swept, columns, strict=True)])
            for columns in ([part.result.point for part in swept], [part.result.normal for part in swept])
        )
        if len(contacts) < 4:
            break
        tell("rounds", 1 + number, 1 + rounds)
        lines = aimed(contacts, normals, further, generator)
        swept += _sweep_in_space(body, lines, plan, 1 + number)
    return _recording_in_space(swept, plan, rod, middle, length)


def _sweep_in_space(body: RoundedPolyhedron, lines: Lines, plan: Plan, number: int) -> list[_SpatialSweeps]:
    """Sweep along those lines on which the rod touches the body; an empty list if there are none."""
    x, y = lines.axes[:, 0].T, lines.axes[:, 1].T
    reach = 2 * np.abs(body.vertices).max() + 1
    start = lines.origin.T + reach * x
    passage = passages(body, start, y, -x)
    before = 1e-6  # rod lengths before the touch-down a sweep begins
    rows = np.flatnonzero(passage.touches & (passage.end > passage.begin + before))
    if not len(rows):
        return []
    begin, end = passage.begin[rows], passage.end[rows]
    # a sweep that is aimed at a place touches it at the beginning, where its samples are dense
    samples = max(2, round(0.35 * plan.samples)) if number else plan.samples
    spacing = np.linspace(0, 1, samples) ** (2 if number else 1)
    # the bent rod may follow the body
    distance = begin[:, None] - before + (1.1 * (end - begin))[:, None] * spacing
    position = (start[:, rows, None] - distance * x[:, rows, None]).transpose(1, 2, 0)
    # where rod and face are nearly parallel, the touch-down is found to some thousandths only, and may lie before the beginning
    again = passages(body, position[:, 0].T, y[:, rows], (position[:, -1] - position[:, 0]).T)
    clear = again.touches & (again.begin >= 0)
    rows, position = rows[clear], position[clear]
    if not len(rows):
        return []
    keys = [[plan.seed, 3, number, int(row)] for row in rows]
    friction = np.array([drawn_friction(plan.friction_range, samples, key) for key in keys])
    axes = lines.axes[rows]
    result = sweep(body, position, axes, friction, nearest=_NEAREST, snaps=False)
    return [_SpatialSweeps(position, axes, result)]


def _recording_in_space(swept: list[_SpatialSweeps], plan: Plan, rod: Rod, middle: Array, length: float) -> Recording:
    """The recording of all sweeps, as a rig would log it, each up to the first sample after its last contact if it is known."""
    number, position, wrench, sweeps = [], [], [], 0
    for part in swept:
        too_near = np.maximum.accumulate(part.result.s1 < _NEAREST, axis=1)
        touching = np.isfinite(part.result.s1) & ~too_near
        n = touching.shape[1]
        last = np.where(touching.any(axis=1), n - np.argmax(touching[:, ::-1], axis=1), 0)
        # of a rod that was not followed on nothing is known
        ends = last + ~np.isin(part.result.end, (End.LOST, End.SNAP))
        kept = (np.arange(n) < ends[:, None]) & ~too_near
        number.append(sweeps + np.nonzero(kept)[0])
        sweeps += len(touching)
        position.append(part.position[kept] * length + middle)
        wrench.append(np.hstack([part.result.force[kept], part.result.moment[kept]]))
    axes = np.concatenate([part.axes for part in swept])
    rows = np.concatenate(number), np.concatenate(position), np.concatenate(wrench)
    return recorded(plan, rod, axes, *rows, {"model": "spatial"})
