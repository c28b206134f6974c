"""Sweeps of a simulated scan along one axis, and the recording of all of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import planar
from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.geometry.sections import extent_along, slice_polygons
from scan3d.planning.aims import (
    MAX_SWEEPS,
    BaseLine,
    base_fractions,
    base_line,
    clamp_axes,
    first_directions,
    further_directions,
    positions,
)
from scan3d.planning.plan import Plan
from scan3d.recording import Recording
from scan3d.rods import Rod
from scan3d.units import UNITS_M

# Rounds of further sweeps for the parts of a contour that earlier sweeps have left open.  More rounds close smaller gaps at
# the cost of more sweeps; fewer leave gaps.
_ROUNDS = 2
# Heights at which the body's width is evaluated to choose a rod for it.  More take longer; fewer could miss the widest slice
# of a pointed body, for which the rod would be too short.
_WIDTH_HEIGHTS = 33
# Distance by which a sweep without contact goes beyond the nearest contour on either side, in rod lengths.  Larger, such
# sweeps are longer than needed; smaller, they could end before the contour does.
_BEYOND = 0.2


class _Sweep(NamedTuple):
    """One sweep in a slice."""

    slice: int
    number: int
    """Of the slice's sweeps."""
    line: BaseLine


class _Swept(NamedTuple):
    """One sweep and what it measured."""

    sweep: _Sweep
    result: planar.Sweep


@dataclass
class AxisScan:
    """The slices and sweeps made so far along one axis."""

    mesh: Any
    plan: Plan
    length: float
    """Of the rod, in the mesh's unit."""
    frame: Array
    """(3, 3) axes of the slices' frame in the world, as rows."""
    number: int
    """Of the axis among those of the plan."""
    heights: list[float] = field(default_factory=list)
    polygons: list[Array] = field(default_factory=list)
    swept: list[_Swept] = field(default_factory=list)
    unreached: int = 0
    """Sweeps that were not made, because the slice is out of the rod's reach."""

    def scan(self, heights: Array) -> None:
        """Sweep further slices."""
        first = len(self.heights)
        self.heights += heights.tolist()
        self.polygons += slice_polygons(self.mesh, self.frame, heights)
        new = range(first, len(self.heights))
        self.swept += self._sweep_slices([i for i in new if len(self.polygons[i])])
        for i in new:
            if not len(self.polygons[i]):
                self.swept += self._sweep_empty(i)

    def sweep_again(self, heights: Array) -> None:
        """Sweep slices again, with twice the samples in a sweep, as all further slices."""
        self.plan = replace(self.plan, samples=2 * self.plan.samples)
        chosen = set(np.abs(np.array(self.heights) - heights[:, None]).argmin(axis=1).tolist())
        self.swept = [swept for swept in self.swept if swept.sweep.slice not in chosen]
        self.swept += self._sweep_slices(sorted(chosen))

    def sweep_further(self, heights: Array, limit: float) -> bool:
        """Sweep slices from further directions as well, towards what their contacts leave open by more than `limit`.

        The limit is a length in the mesh's unit.  Says whether there are such sweeps.
        """
        chosen = np.abs(np.array(self.heights) - heights[:, None]).argmin(axis=1).tolist()
        sweeps = []
        for i in sorted(set(chosen)):
            done = [swept for swept in self.swept if swept.sweep.slice == i]
            angles = self._open_directions(done, self.polygons[i], limit)[: max(MAX_SWEEPS - len(done), 0)]
            lines = [self._base_line(angle, self.polygons[i]) for angle in angles]
            sweeps += [_Sweep(i, len(done) + k, line) for k, line in enumerate(lines)]
        results = zip(sweeps, self._simulate(sweeps), strict=True)
        further = [_Swept(sweep, result) for sweep, result in results if result is not None]
        self.swept += further
        return bool(further)

    def _sweep_slices(self, slices: list[int]) -> list[_Swept]:
        """All sweeps of some slices, in the order of slices and directions."""
        directions = {i: first_directions(self.plan) for i in slices}
        done: dict[int, list[_Swept]] = {i: [] for i in slices}
        for rounds_done in range(1 + _ROUNDS):
            sweeps = [
                _Sweep(i, len(done[i]) + k, self._base_line(angle, self.polygons[i]))
                for i, angles in directions.items()
                for k, angle in enumerate(angles)
            ]
            for sweep, result in zip(sweeps, self._simulate(sweeps), strict=True):
                # a sweep out of the rod's reach is left out, because an empty sweep is evidence that nothing is there
                if result is not None:
                    done[sweep.slice].append(_Swept(sweep, result))
                else:
                    self.unreached += 1
            if self.plan.sweeps is not None or rounds_done == _ROUNDS:
                break
            directions = {
                i: self._open_directions(done[i], self.polygons[i])[: MAX_SWEEPS - len(done[i])] for i in directions
            }
            directions = {i: angles for i, angles in directions.items() if len(angles)}
        return [swept for i in slices for swept in done[i]]

    def _sweep_empty(self, i: int) -> list[_Swept]:
        """Sweeps without contact of an empty slice, past the nearest contour and where it would be if the body went on."""
        filled = [j for j, polygon in enumerate(self.polygons) if len(polygon)]
        if not filled:
            return []
        nearest = min(filled, key=lambda j: abs(self.heights[j] - self.heights[i]))
        outline = np.concatenate([self.polygons[nearest], self._extrapolated(nearest, filled, self.heights[i])])
        swept = []
        for k, angle in enumerate(first_directions(self.plan)):
            line = self._base_line(angle, outline)
            across = (outline - line.origin) @ line.axes[0] / self.length
            swept.append(_Swept(_Sweep(i, k, line), self._nothing(across)))
        return swept

    def _extrapolated(self, i: int, filled: list[int], height: float) -> Array:
        """Slice i's contour (n, 2) at another height, moved and scaled as from the nearest of the other filled slices."""
        contour = self.polygons[i]
        others = [j for j in filled if j != i]
        if not others:
            return contour
        behind = min(others, key=lambda j: abs(self.heights[j] - self.heights[i]))
        (centre, size), (before, size_before) = (
            (polygon.mean(axis=0), np.ptp(polygon, axis=0)) for polygon in (contour, self.polygons[behind])
        )
        ahead = (height - self.heights[i]) / (self.heights[i] - self.heights[behind])
        scaled = np.maximum(1 + ahead * (1 - size_before / size), 0.0)
        moved: Array = centre + ahead * (centre - before) + scaled * (contour - centre)
        return moved

    def _nothing(self, across: Array) -> planar.Sweep:
        """A sweep without contact, past positions (n,) along its base line in rod lengths."""
        n = self.plan.samples
        x0 = np.linspace(across.max() + _BEYOND, across.min() - _BEYOND, n)
        unknown = np.full(n, np.nan)
        phase = np.full(n, planar.Phase.NONE, dtype=np.int8)
        return planar.Sweep(x0, unknown, unknown, unknown, unknown, np.full((n, 2), np.nan), unknown, phase, unknown)

    def _base_line(self, angle: float, polygon: Array) -> BaseLine:
        fixed = self.plan.standoff == "fixed"
        outline = self.mesh.vertices.view(np.ndarray) @ self.frame[:2].T if fixed else polygon
        return base_line(outline, angle, self.plan.clearance * self.length)

    def _simulate(self, sweeps: list[_Sweep]) -> list[planar.Sweep | None]:
        """The results of sweeps, None where the slice is out of the rod's reach."""
        outlines = [(self.polygons[s.slice] - s.line.origin) @ s.line.axes.T / self.length for s in sweeps]
        within = [k for k, outline in enumerate(outlines) if outline[:, 1].min() <= 1]
        low, high = self.plan.friction_range
        friction: list[Any] = [low] * len(sweeps)
        if high > low:
            # a separate random stream for each sweep, so that its draws don't depend on the order of work
            keys = [[self.plan.seed, 0, self.number, s.slice, s.number] for s in sweeps]
            friction = [np.random.default_rng(key).uniform(low, high, self.plan.samples) for key in keys]
        fractions = base_fractions(self.plan.samples)
        try:
            contours = [planar.Polygon(outlines[k]) for k in within]
            results = planar.sweep_all(contours, [friction[k] for k in within], shares=fractions) if within else []
        except ValueError as error:
            raise InputError(
                f"this body can't be swept with a rod {self.length:.3g} {self.plan.unit} long and a clearance of "
                f"{self.plan.clearance:g}: {error}"
            ) from None
        by_sweep = dict(zip(within, results, strict=True))
        return [by_sweep.get(k) for k in range(len(sweeps))]

    def _open_directions(self, done: list[_Swept], polygon: Array, limit: float | None = None) -> Array:
        """Approach directions for the parts of a slice's contour that the sweeps have left open, as `further_directions`."""
        points, normals = [], []
        for sweep, result in done:
            tangential = result.phase == planar.Phase.TANGENTIAL
            slope = result.slope[tangential]
            points.append(result.point[tangential] @ sweep.line.axes * self.length + sweep.line.origin)
            normals.append(np.stack([np.sin(slope), -np.cos(slope)], axis=1) @ sweep.line.axes)
        if not sum(map(len, points)):
            return np.empty(0)
        width = float(np.ptp(polygon, axis=0).max())
        return further_directions(np.concatenate(points), np.concatenate(normals), width, limit)


def width_of(mesh: Any, frame: Array) -> float:
    """Largest diameter of the slices about their middles; a sweep with a rod of that length sees most of a slice."""
    low, high = extent_along(mesh, frame[2])
    polygons = slice_polygons(mesh, frame, np.linspace(low, high, _WIDTH_HEIGHTS + 2)[1:-1])
    widths = [2 * np.linalg.norm(p - (p.min(axis=0) + p.max(axis=0)) / 2, axis=1).max() for p in polygons if len(p)]
    if not widths:
        raise InputError("the body is too thin to be sliced along this axis; choose another one")
    return float(max(widths))


def recording_of(scans: list[AxisScan], rod: Rod, first: int = 0) -> Recording:
    """The recording of all sweeps so far, as a rig would log it; of each axis from sweep number `first` on."""
    plan, length = scans[0].plan, scans[0].length
    metres = UNITS_M[plan.unit]
    all_swept = [(scan, swept) for scan in scans for swept in scan.swept[first:]]
    unreached = sum(scan.unreached for scan in scans)
    count = np.array([len(swept.result) for _, swept in all_swept])
    clamp_positions, axes, wrenches = [], [], []
    for scan, (sweep, result) in all_swept:
        clamp_positions.append(positions(sweep.line, result.x0 * length, scan.heights[sweep.slice], scan.frame))
        axes.append(clamp_axes(sweep.line, scan.frame))
        wrenches.append(np.stack([result.f0x, result.f0y, result.m0z], axis=1))
    # scipy wants the clamp's axes as columns
    quaternion = Rotation.from_matrix(np.swapaxes(np.array(axes), 1, 2)).as_quat(scalar_first=True)
    measured = np.concatenate(wrenches)
    measured = np.where(np.isnan(measured), 0.0, measured)
    if plan.noise > 0:
        measured += plan.noise * np.random.default_rng([plan.seed, 1]).standard_normal(measured.shape)
    return Recording(
        sweep=np.repeat(first + np.arange(len(all_swept)), count),
        position_m=np.concatenate(clamp_positions) * metres,
        quaternion=np.repeat(quaternion, count, axis=0),
        force_N=measured[:, :2] * rod.force_unit_N,
        moment_Nm=measured[:, 2] * rod.moment_unit_Nm,
        rod=rod,
        noise_force_N=plan.noise * rod.force_unit_N,
        noise_moment_Nm=plan.noise * rod.moment_unit_Nm,
        unit=plan.unit,
        source={"kind": "simulation", "seed": plan.seed, **({"sweeps_out_of_reach": unreached} if unreached else {})},
    )
