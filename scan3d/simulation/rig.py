"""A rig that is computed: the log of a robot with a rod and a force-torque sensor that goes through a list of poses.

The rig knows the body's mesh; nothing that reads its log does.  The rod's weight is not modelled: in the air all reactions are
zero, up to the faults.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scan3d.arrays import NEGLIGIBLE, Array
from scan3d.errors import InputError
from scan3d.frames import check_positions
from scan3d.geometry.convexity import check_body, check_convex
from scan3d.geometry.distance import segments_meet
from scan3d.poses import TABLE, Move, PoseList
from scan3d.processes import check_memory
from scan3d.recording import Recording, reaction_columns
from scan3d.rods import Rod
from scan3d.simulation.faults import Faults, kept, logged_positions, measured
from scan3d.simulation.felt import Reactions, Track, drawn_friction, felt, steps_touch
from scan3d.units import UNITS_M

# Bytes that a row of a log takes while it is computed and written.
_MEMORY_PER_ROW = 1500
BETWEEN = -1
"""Number of the sweep in rows between sweeps of a log with faults."""


@dataclass(frozen=True)
class RawLog:
    """What a rig writes: n rows of times, poses and wrenches."""

    time_s: Array
    """(n,)"""
    sweep: NDArray[np.int64]
    """(n,) number of the sweep, of approach and retract as well; with faults `BETWEEN` in these."""
    move: NDArray[np.int8]
    """(n,) of `Move`."""
    position_m: Array
    """(n, 3) as logged."""
    quaternion: Array
    """(n, 4) w first."""
    wrench: Array
    """(n, 6) force and moment in the sensor's frame; without faults the support reaction in the clamp's."""
    rod: Rod
    """The nominal rod: what the experimenter takes it for."""
    model: str
    faults: Faults | None
    unit: str
    source: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    table_m: float | None = None
    """Height of the table on which the body stands; None for a body that was not placed on it."""

    def __len__(self) -> int:
        return len(self.time_s)

    def recording(self, rows: slice | NDArray[Any] | None = None) -> Recording:
        """The rows of a log without faults as a recording, by default those of the sweeps.

        Raises InputError for a log with faults, which is to be imported.
        """
        if self.faults is not None:
            raise InputError("a log with faults is no recording; import it")
        chosen = self.move == Move.SWEEP if rows is None else rows
        wrench = self.wrench[chosen]
        return Recording(
            sweep=self.sweep[chosen],
            position_m=self.position_m[chosen],
            quaternion=self.quaternion[chosen],
            **reaction_columns(wrench[:, :3], wrench[:, 3:], self.model == "spatial"),
            rod=self.rod,
            unit=self.unit,
            table_m=self.table_m,
            source=self.source,
        )


class _Rows(NamedTuple):
    """Where the clamp truly is at the rows of a log."""

    time: Array
    sweep: NDArray[np.int64]
    move: NDArray[np.int8]
    position_m: Array
    quaternion: Array


def standing(mesh: Any) -> Any:
    """A copy of a mesh that stands on the table, z = 0, with the middle of its bounding box on the z axis.

    Its `metadata` has `placed`: by how much it was moved.
    """
    low, high = np.asarray(mesh.bounds)
    move = -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    placed = mesh.copy()
    placed.apply_translation(move)
    placed.metadata["placed"] = move.tolist()
    return placed


def simulate_rig(
    mesh: Any,
    poses: PoseList,
    *,
    faults: Faults | None = None,
    rod: Rod | None = None,
    model: str | None = None,
    friction: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
    unit: str = "mm",
) -> RawLog:
    """The log of a rig that goes through a list of poses past a convex `trimesh.Trimesh`.

    mesh
        the body where it stands in the world, with coordinates in `unit`; `standing` puts it on the table.
    faults
        None: one row for each pose, exact.  Otherwise rows at their rate, with these faults.
    rod
        the nominal rod; that of the poses by default.
    model
        of contact; that of the poses by default.
    friction
        lowest and highest coefficient of friction, of which every row draws its own.
    seed
        of the random friction.

    Raises InputError for bodies that are not closed and convex, where no rod is known, and where the rod touches the body
    before a sweep begins.
    """
    check_body(mesh)
    check_convex(mesh, "a simulated rig")
    nominal, model = rod or poses.rod, model or poses.model
    if nominal is None:
        raise InputError("the poses don't say for which rod they were planned; give one, such as --rod steel:0.3x50")
    if model == "planar" and nominal.tapered:  # as in scans of meshes
        nominal = nominal.without_thickness()
    check_positions("poses", poses.position_m, nominal.length_m)
    real = nominal  # the rod that is in the clamp
    if faults is not None:
        length = nominal.length_m * (1 + faults.length_error)
        stiffness = nominal.bending_stiffness_Nm2 * (1 + faults.stiffness_error)
        real = Rod(length, stiffness, nominal.diameter_m)
    rows = _rows_of(poses, faults)
    metres = UNITS_M[unit]
    length, radius = real.length_m / metres, real.diameter_m / metres / 2
    tracks, members = _tracks(rows, friction, seed, metres)
    start = np.array([track.position[0] for track in tracks])
    touches = segments_meet(mesh, start, np.array([track.axes[0, 1] for track in tracks]), length, radius)
    if touches.any():
        raise InputError(
            f"the rod lies in the body where {touches.sum()} of {len(tracks)} sweeps begin, first sweep "
            f"{tracks[int(np.argmax(touches))].number}: the body is larger than what the poses were planned for, or stands "
            "elsewhere; plan with a larger --around"
        )
    reactions = felt(mesh, tracks, real, metres, model)
    wrench = np.zeros((len(rows.time), 6))
    for part, where in zip(reactions, members, strict=True):
        wrench[where] = np.hstack([part.force * real.force_unit_N, part.moment * real.moment_unit_Nm])
    warnings = _warnings(mesh, poses, reactions, (length, radius, metres))
    source = {"kind": "simulation", "seed": seed, "model": model, "rig": True, "unit": unit}
    if "around" in poses.source:
        source["around"] = poses.source["around"]
    if "placed" in mesh.metadata:
        source["moved"] = mesh.metadata["placed"]
    table = TABLE if "placed" in mesh.metadata else None
    log = RawLog(*rows, wrench, nominal, model, faults, unit, source, warnings, table)
    if faults is None:
        return log
    keep = kept(len(log), faults)
    return replace(
        log,
        time_s=log.time_s[keep],
        sweep=np.where(log.move == Move.SWEEP, log.sweep, BETWEEN)[keep],
        move=log.move[keep],
        position_m=logged_positions(log.position_m, faults)[keep],
        quaternion=log.quaternion[keep],
        wrench=measured(wrench[:, :3], wrench[:, 3:], faults, (nominal.force_unit_N, nominal.moment_unit_Nm))[keep],
    )


def _rows_of(poses: PoseList, faults: Faults | None) -> _Rows:
    """One row for each pose, or rows at the rate of faults, on straight lines and in steady turns between the poses."""
    if faults is None:
        check_memory(_MEMORY_PER_ROW * len(poses), f"a log of {len(poses)} rows", "plan fewer sweeps or samples")
        return _Rows(poses.times(), poses.sweep, poses.move, poses.position_m, poses.quaternion)
    if faults.speed_mm_s is not None:
        poses = replace(poses, speed_m_s=faults.speed_mm_s / 1000)
    times = poses.times()
    count = math.floor(times[-1] * faults.rate_hz) + 1
    check_memory(_MEMORY_PER_ROW * count, f"a log of {count} rows", "choose a lower rate_hz, or fewer sweeps")
    time = np.arange(count) / faults.rate_hz
    before = np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2)
    part = (time - times[before]) / (times[before + 1] - times[before])
    position = poses.position_m[before] + part[:, None] * np.diff(poses.position_m, axis=0)[before]
    turns = Rotation.from_quat(poses.quaternion, scalar_first=True)
    vector = (turns[:-1].inv() * turns[1:]).as_rotvec()
    turning = np.linalg.norm(vector, axis=1) > NEGLIGIBLE
    quaternion = poses.quaternion[before]
    rows = np.flatnonzero(turning[before])
    if len(rows):
        step = Rotation.from_rotvec(part[rows, None] * vector[before[rows]])
        quaternion[rows] = (turns[before[rows]] * step).as_quat(canonical=True, scalar_first=True)
    # what the clamp does until the next pose: it sweeps between two poses of a sweep
    first, second = poses.move[:-1], poses.move[1:]
    move = np.where((first == Move.SWEEP) & (second == Move.SWEEP), Move.SWEEP, Move.APPROACH)
    move = np.where(second == Move.RETRACT, Move.RETRACT, move).astype(np.int8)[before]
    return _Rows(time, poses.sweep[before + 1 * (move != Move.SWEEP)], move, position, quaternion)


def _tracks(
    rows: _Rows, friction: tuple[float, float], seed: int, metres: float
) -> tuple[list[Track], list[NDArray[np.intp]]]:
    """The sweeps of a log, and the rows of each."""
    sweeping = np.flatnonzero(rows.move == Move.SWEEP)
    members = np.split(sweeping, np.flatnonzero(np.diff(rows.sweep[sweeping])) + 1)
    members = [where for where in members if len(where) > 1]
    if not members:
        raise InputError("no sweep has two rows in this log; choose a higher rate_hz or a lower speed")
    axes = Rotation.from_quat(rows.quaternion, scalar_first=True).as_matrix().swapaxes(1, 2)
    tracks = []
    for where in members:
        number = int(rows.sweep[where[0]])
        drawn = drawn_friction(friction, len(where), [seed, 6, number])
        tracks.append(Track(number, rows.position_m[where] / metres, axes[where], drawn))
    return tracks, members


def _warnings(
    mesh: Any, poses: PoseList, reactions: list[Reactions], sizes: tuple[float, float, float]
) -> tuple[str, ...]:
    """Sentences on sweeps whose log is not that of a rod that is free before and after it."""
    length, radius, metres = sizes
    touching = steps_touch(mesh, poses.position_m / metres, poses.axes(), length, radius)
    outside = (poses.move[:-1] != Move.SWEEP) | (poses.move[1:] != Move.SWEEP)
    hit = np.unique(poses.sweep[1:][touching & outside])
    bent = sum(bool(part.touches[-1]) for part in reactions)
    lost = sum(part.lost for part in reactions)
    sentences = []
    if len(hit):
        sentences.append(
            f"in {len(hit)} sweeps, first {hit[0]}, the straight rod would touch the body in approach or retract, where the "
            "log has no reactions"
        )
    if bent:
        sentences.append(
            f"{bent} sweeps end in contact, and in their retracts the log has no reactions; let them go on farther"
        )
    if lost:
        sentences.append(
            f"in {lost} sweeps the computation found no equilibrium after some place, as at a snap; none is logged"
        )
    return tuple(sentences)
