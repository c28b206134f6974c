"""Simulation of a scan (step 1): a body is swept slice by slice, from several directions, and the reactions are recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.files.reading import to_float
from scan3d.geometry.meshes import check_body
from scan3d.geometry.sections import extent_along, slice_frame
from scan3d.memory import check_memory
from scan3d.planning.adaptive import SlabMemory, next_heights
from scan3d.planning.aims import FIRST_SWEEPS
from scan3d.planning.heights import BEYOND, first_heights, open_contours
from scan3d.planning.plan import Plan
from scan3d.planning.several_axes import first_heights_together, next_slices
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.growing_contacts import GrowingContacts
from scan3d.recording import Recording
from scan3d.rods import Rod
from scan3d.simulation.axis_scans import AxisScan, recording_of, width_of
from scan3d.simulation.spatial import simulate_spatial
from scan3d.units import UNITS_M

Progress = Callable[[int, int], None]

# Slices that are swept in one call.  More make progress reports rare; fewer leave the arrays short, which takes longer.
_SLICES_AT_ONCE = 16
# Times the samples of the plan to which those of a sweep are doubled, so that contacts show its contour within the tolerance.
# More are for tolerances near rounding; with fewer, the gaps between contacts stay above it.
_FINEST = 16
# Part of the tolerance within which contours are to be known before further slices are chosen.  Larger, the gaps between
# contacts make secants to close slices steep, and many more slices are needed; smaller, samples are needed that show nothing.
_OF_TOLERANCE = 0.25
# Slices along each axis of a plan with a tolerance up to which all axes are planned together.  Larger, contours that need more
# samples are not swept again, as they are in scans along one axis after another; smaller, more slices are swept.
_MOST_WITH_TOLERANCE = 28
# Bytes that a scan takes while it is simulated and analysed: for each sample, slice and facet of the body, and those of the
# program itself.  The manual's page on performance has what was measured.  Larger, scans are refused that would fit; smaller,
# memory runs out.
_MEMORY_PER_SAMPLE, _MEMORY_PER_SLICE, _MEMORY_PER_FACET, _MEMORY_OF_PROGRAM = 1000, 300_000, 1000, 400_000_000


def simulate(mesh: Any, plan: Plan | None = None, progress: Progress | None = None) -> Recording:
    """Recording of a simulated scan of a convex `trimesh.Trimesh`.

    mesh
        the body, with coordinates in the plan's unit.
    plan
        the settings; those of `Plan()` by default.
    progress
        is called with the number of slices done and the number of all slices.

    Raises InputError if the body is not closed and convex, if it is too thin to be sliced along an axis of the plan, and if the
    recording would not fit into memory.
    """
    plan = plan or Plan()
    if not isinstance(plan, Plan):
        raise InputError(f"the plan must be a scan3d.Plan, got {type(plan).__name__}")
    check_body(mesh)
    return simulate_judged(mesh, plan, progress)


def simulate_judged(mesh: Any, plan: Plan, progress: Progress | None = None) -> Recording:
    """`simulate` for a body that `load_mesh` or `judge_mesh` has just returned, which is not judged again."""
    _check_size(mesh, plan, _most_slices(plan), plan.sweeps or FIRST_SWEEPS)
    if plan.model == "spatial":
        return simulate_spatial(mesh, plan, progress)
    frames = [slice_frame(axis) for axis in plan.axes()]
    metres = UNITS_M[plan.unit]
    rod = plan.rod or Rod.of_length(metres * max(width_of(mesh, frame) for frame in frames))
    scans = [AxisScan(mesh, plan, rod.length_m / metres, frame, k) for k, frame in enumerate(frames)]
    few = not plan.tolerance or plan.slices <= _MOST_WITH_TOLERANCE
    if plan.spacing == "adaptive" and not plan.noise and len(scans) > 1 and few:
        _scan_together(scans, rod, progress)
        return recording_of(scans, rod)
    for k, scan in enumerate(scans):
        count = plan.slices * len(scans)

        def report(done: int, before: int = plan.slices * k, count: int = count) -> None:
            if progress is not None:
                progress(before + min(done, plan.slices), count)

        first = first_heights(*extent_along(mesh, scan.frame[2]), plan)
        for start in range(0, len(first), _SLICES_AT_ONCE):
            scan.scan(first[start : start + _SLICES_AT_ONCE])
            _check_sweeps(scan, plan.samples)
            report(len(scan.heights))
        if plan.spacing == "adaptive":
            _adapt(scan, rod, report)
    return recording_of(scans, rod)


def _check_size(mesh: Any, plan: Plan, slices: int, sweeps: float) -> None:
    """Raise InputError if a scan of so many slices, with so many sweeps in each, needs more memory than there is."""
    samples = to_float(slices) * to_float(sweeps) * to_float(plan.samples)
    check_memory(
        samples * _MEMORY_PER_SAMPLE
        + to_float(slices) * _MEMORY_PER_SLICE
        + len(mesh.faces) * _MEMORY_PER_FACET
        + _MEMORY_OF_PROGRAM,
        f"a scan of {to_float(slices):.4g} slices with {to_float(sweeps):.4g} sweeps of {to_float(plan.samples):.4g} samples",
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
    """All heights of cosine spacing."""
    return first_heights(*extent_along(scan.mesh, scan.frame[2]), replace(scan.plan, spacing="cosine"))


def _adapt(scan: AxisScan, rod: Rod, report: Callable[[int], None], others: Sequence[AxisScan] = ()) -> None:
    """Ask for the next heights, sweep there, and ask again; the contacts given to the planner have the recording's noise.

    Exact contacts of finished scans along other axes are given to the planner as well.
    """

    def nothing_yet() -> tuple[SlabMemory, GrowingContacts, int]:
        grown = GrowingContacts()
        for other in others:
            grown.add(recording_of([other], rod))
        return SlabMemory(), grown, 0

    memory, grown, done = nothing_yet()
    finest = _FINEST * scan.plan.samples
    if scan.plan.tolerance and not scan.plan.noise:
        with suppress(InputError):  # the first slices alone may span no body
            _refine(scan, rod, _OF_TOLERANCE * scan.plan.tolerance, finest)
    while (left := scan.plan.slices + BEYOND - len(scan.heights)) > 0:
        if not scan.plan.noise and len(scan.swept) > done:
            grown.add(recording_of([scan], rod, done))
            done = len(scan.swept)
        try:
            # contacts under noise depend on each other, those of exact reactions on their own slice only
            cloud = contacts(recording_of([scan], rod)) if scan.plan.noise else grown.cloud()
            heights = next_heights(cloud, scan.plan, axis=scan.frame[2], left=left, memory=memory)
        except InputError:  # too few contacts to say where others are needed
            heights = np.setdiff1d(_cosine_heights(scan), scan.heights)[:left]
        if not len(heights):
            if not (scan.plan.tolerance and _refine(scan, rod, scan.plan.tolerance, finest)):
                break
            memory, grown, done = nothing_yet()
            continue
        scan.scan(heights)
        _check_sweeps(scan, scan.plan.samples)
        report(len(scan.heights))


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


def _scan_together(scans: list[AxisScan], rod: Rod, progress: Progress | None) -> None:
    """Scan along several axes, of which the contacts along all choose the next heights, and the axis.

    Only exact contacts along different axes agree well enough for this.
    """
    plan = scans[0].plan
    count = plan.slices * len(scans)

    def report(_: int) -> None:
        if progress is not None:
            progress(min(sum(len(scan.heights) for scan in scans), count), count)

    def scanned(scan: AxisScan, heights: Array) -> None:
        scan.scan(heights)
        _check_sweeps(scan, plan.samples)
        report(0)

    for scan in scans:
        scanned(scan, first_heights_together(*extent_along(scan.mesh, scan.frame[2]), plan))
    while (left := count + BEYOND * len(scans) - sum(len(scan.heights) for scan in scans)) > 0:
        try:
            further, alone = next_slices(contacts(recording_of(scans, rod)), plan, left)
        except InputError:  # too few contacts to say where others are needed
            share = -(-left // len(scans))
            apart = [np.setdiff1d(_cosine_heights(scan), scan.heights)[:share] for scan in scans]
            further = [(scan.frame[2], heights) for scan, heights in zip(scans, apart, strict=True) if len(heights)]
            alone = None
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
    return min(scans, key=lambda scan: float(np.abs(scan.frame[2] - axis).max()))
