"""A rig that is computed: the log of a robot with a rod and a force-torque sensor that goes through a list of poses.

The rig knows the body's mesh; nothing that reads its log does.  The rod's weight is not modelled: in the air all reactions are
zero, up to the faults.

What real rigs do to a log, a TOML file of faults says: the wrench lags, is seen by a sensor that is turned and offset, drifts,
and is noisy.  The order is that of a real chain: the wrench at the clamp, the sensor's filter and clock, its frame and sign,
bias, drift and noise of its bridges, the steps of its converter, and rows that the logger loses.  Sizes of bias, drift, noise
and quanta are given in N and N·m, or as a fraction of the largest force and of the largest moment of the log.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len
from scipy.spatial.transform import Rotation

from scan3d.arrays import NEGLIGIBLE, Array, Index, Mask
from scan3d.errors import InputError
from scan3d.files.text import Section, read_section
from scan3d.geometry.distance import segments_meet
from scan3d.geometry.hulls import check_body, check_convex, hull, is_convex
from scan3d.planning.plan import Plan
from scan3d.planning.probing import Probings
from scan3d.planning.rig import parse_envelope
from scan3d.poses import TABLE, Move, PoseList, measures
from scan3d.recording import Recording, reaction_columns
from scan3d.rigs import SHOWS, axes_of, check_positions, to_inner, turn_of
from scan3d.rods import Rod
from scan3d.simulation.felt import Reactions, Track, drawn_friction, felt, steps_touch
from scan3d.simulation.probing import felt_along
from scan3d.units import UNITS_M
from scan3d.unmeasured import parts
from scan3d.workers import check_memory

# Bytes that a row of a log takes while it is computed and written.
_MEMORY_PER_ROW = 1500
# Rows that are logged, about, while the clamp waits at the end of a probing.
_WAIT = 4
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
        chosen = measures(self.move) if rows is None else rows
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
    """Where the clamp truly is at the rows of a log: its first fields."""

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
    stop_force: float | str = "auto",
) -> RawLog:
    """The log of a rig that goes through a list of poses past a `trimesh.Trimesh`, which is convex if it is swept in space.

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
    stop_force
        at which a probing ends, as in `Plan`.

    Raises InputError for bodies that are not closed, and not convex where they must be, where no rod is known, and where the
    rod touches the body before a sweep begins.
    """
    check_body(mesh)
    nominal, model = rod or poses.rod, model or poses.model
    if nominal is None:
        raise InputError("the poses don't say for which rod they were planned; give one, such as --rod steel:0.3x50")
    convex, planned = is_convex(mesh), nominal
    if (poses.move == Move.SWEEP).any() and model == "spatial":
        check_convex(mesh, "a body that a simulated rig sweeps in space")
    if (model == "planar" and nominal.tapered) or not convex:  # as in scans of meshes
        nominal = nominal.without_thickness()
    check_positions("poses", poses.position_m, nominal.length_m)
    if nominal.bead_diameter_m and (poses.move == Move.SWEEP).any():
        raise InputError(
            "a simulated rod with a bead probes, and does not sweep; plan with probing, or a rod without bead"
        )
    real = nominal if faults is None else true_rod(nominal, faults)
    metres = UNITS_M[unit]
    length, radius = real.length_m / metres, real.diameter_m / metres / 2
    settings = Plan(
        model="planar" if model == "planar" else "spatial",
        friction=friction,
        seed=seed,
        rod=real,
        stop_force=stop_force,
    )
    sweeps = len(poses.sweeps())
    poses, probed = _stopped(mesh, poses, settings, metres, faults)
    slipped = sweeps - len(poses.sweeps())
    rows = _rows_of(poses, faults)
    tracks, members = _tracks(rows, friction, seed, metres)
    around = mesh if convex else hull(mesh.vertices.view(np.ndarray))
    start = np.array([track.position[0] for track in tracks]).reshape(-1, 3)
    touches = segments_meet(
        around, start, np.array([track.axes[0, 1] for track in tracks]).reshape(-1, 3), length, radius
    )
    if touches.any():
        raise InputError(
            f"the rod lies in the body where {touches.sum()} of {len(tracks)} sweeps begin, first sweep "
            f"{tracks[int(np.argmax(touches))].number}: the body is larger than what the poses were planned for, or "
            "stands elsewhere; plan with a larger --around"
        )
    reactions = felt(mesh, tracks, real, metres, model) if tracks else []
    wrench = np.zeros((len(rows.time), 6))
    if len(probed.number):
        of, at_stop = _member(probed.number, rows.sweep)
        at_stop &= rows.move == Move.PROBE
        at_stop &= np.linalg.norm(rows.position_m - probed.place_m[of], axis=1) <= NEGLIGIBLE * real.length_m
        wrench[at_stop] = probed.wrench[of[at_stop]]
    is_known = np.ones(len(wrench), dtype=bool)
    for part, where in zip(reactions, members, strict=True):
        wrench[where] = np.hstack([part.force * real.force_unit_N, part.moment * real.moment_unit_Nm])
        is_known[where] = part.known
    warnings = _warnings(around, poses, reactions, length, radius, metres)
    if slipped:
        warnings += (
            f"{slipped} of {sweeps} sweeps are left out: the end of the rod slips off; a smaller --stop-force leaves fewer",
        )
    if nominal != planned:
        words = "taper" if model == "planar" and planned.tapered else "body that is not convex"
        warnings += (f"the simulated rod has no thickness, because of the {words}; leave its diameter at 0 in the map",)
    source = {"kind": "simulation", "seed": seed, "model": model, "rig": True, "unit": unit}
    if not convex:
        source["convex"] = False
    if not is_known.all():
        source["unresolved"] = int((~is_known).sum())
    if "around" in poses.source:
        stated = str(poses.source["around"])  # in the unit of the poses
        scale = UNITS_M[poses.unit] / UNITS_M[unit]
        source["around"] = stated if scale == 1 else str(parse_envelope(stated).scaled(scale))
    if "placed" in mesh.metadata:
        source["moved"] = mesh.metadata["placed"]
    table = TABLE if "placed" in mesh.metadata else None
    rows = rows._replace(sweep=parts(rows.sweep, is_known))  # the clamp did not sweep over rows that are left out
    log = RawLog(*rows, wrench, nominal, model, faults, unit, source, warnings, table)
    if faults is None:
        columns = ("time_s", "sweep", "move", "position_m", "quaternion", "wrench")
        return log if is_known.all() else replace(log, **{name: getattr(log, name)[is_known] for name in columns})
    keep = kept(len(log), faults) & is_known
    return replace(
        log,
        time_s=log.time_s[keep],
        sweep=np.where(measures(log.move), log.sweep, BETWEEN)[keep],
        move=log.move[keep],
        position_m=logged_positions(log.position_m, faults)[keep],
        quaternion=log.quaternion[keep],
        wrench=measured(wrench[:, :3], wrench[:, 3:], faults, (nominal.force_unit_N, nominal.moment_unit_Nm))[keep],
    )


def true_rod(nominal: Rod, faults: Faults) -> Rod:
    """The rod that is in the clamp: the nominal one, stretched and stiffened."""
    longer, stiffer = 1 + faults.length_error, 1 + faults.stiffness_error
    return replace(
        nominal,
        length_m=nominal.length_m * longer,
        bending_stiffness_Nm2=nominal.bending_stiffness_Nm2 * stiffer,
        stiffness_table=tuple((longer * s, stiffer * value) for s, value in nominal.stiffness_table),
        diameter_table=tuple((longer * s, value) for s, value in nominal.diameter_table),
    )


class _Probed(NamedTuple):
    """Probings (n,) that touch."""

    number: Index
    place_m: Array
    """(n, 3) where the clamp stops."""
    wrench: Array
    """(n, 6) what is felt there, in SI units."""


def _stopped(
    mesh: Any, poses: PoseList, settings: Plan, metres: float, faults: Faults | None
) -> tuple[PoseList, _Probed]:
    """The poses, of which probings end where they touch, and the probings that do.

    Those of which it is not known what they touch are left out.  Where rows are logged at a rate, the clamp waits for a few.
    """
    groups = [rows for rows in poses.sweeps() if poses.move[rows[0]] == Move.PROBE]
    if not groups:
        return poses, _Probed(np.empty(0, dtype=np.intp), np.empty((0, 3)), np.empty((0, 6)))
    rod = settings.rod
    assert rod is not None
    first, last = np.array([rows[0] for rows in groups]), np.array([rows[-1] for rows in groups])
    axes = poses.axes()[first]
    travel = np.einsum("ni,ni->n", axes[:, 1], poses.position_m[last] - poses.position_m[first]) / metres
    moves = Probings(poses.position_m[first] / metres, axes, travel)
    friction = np.array(
        [drawn_friction(settings.friction_range, 1, [settings.seed, 8, int(k)])[0] for k in poses.sweep[first]]
    )
    stop, length = settings.stop_force_of(rod), rod.length_m / metres
    found = felt_along(mesh, moves, rod, length, friction, stop, None, settings.model == "planar")
    place = poses.position_m[first] + found.travel[:, None] * metres * axes[:, 1]
    wrench = np.hstack([found.force * rod.force_unit_N, found.moment * rod.moment_unit_Nm])
    touches = found.touches & found.resolved
    position, repeat = poses.position_m.copy(), np.ones(len(poses), dtype=int)
    position[last[touches]] = place[touches]
    repeat[last[touches]] = 1 if faults is None else 1 + math.ceil(_WAIT / faults.rate_hz / 1e-3)
    of, is_probed = _member(poses.sweep[first], poses.sweep)
    beyond = np.einsum("ni,ni->n", poses.position_m - place[of], axes[of, 1])
    is_end = np.isin(np.arange(len(poses)), np.concatenate([first, last]))
    not_reached = (poses.move == Move.PROBE) & ~is_end & (beyond >= 0)
    # what is drawn back begins where it touched
    not_reached |= (poses.move == Move.RETRACT) & (beyond > 0)
    keep = ~(is_probed & np.where(found.resolved[of], touches[of] & not_reached, True))
    kept_rows = np.repeat(np.flatnonzero(keep), repeat[keep])
    if not len(kept_rows):
        raise InputError("of none of the probings is it known what the rod touches; plan others")
    columns = {name: getattr(poses, name)[kept_rows] for name in ("sweep", "quaternion", "move")}
    probed = _Probed(poses.sweep[first[touches]], place[touches], wrench[touches])
    return replace(poses, position_m=position[kept_rows], **columns), probed


def _member(numbers: Index, sweep: Index) -> tuple[Index, Mask]:
    """Which of some different numbers (k,) the sweeps (n,) of rows have, and whether they have any of these."""
    order = np.argsort(numbers)
    of = order[np.searchsorted(numbers, sweep, sorter=order).clip(max=len(numbers) - 1)]
    return of, numbers[of] == sweep


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
    move = np.where((first == second) & measures(first), first, Move.APPROACH)
    move = np.where(second == Move.RETRACT, Move.RETRACT, move).astype(np.int8)[before]
    return _Rows(time, poses.sweep[before + 1 * ~measures(move)], move, position, quaternion)


def _tracks(
    rows: _Rows, friction: tuple[float, float], seed: int, metres: float
) -> tuple[list[Track], list[NDArray[np.intp]]]:
    """The sweeps of a log, and the rows of each."""
    sweeping = np.flatnonzero(rows.move == Move.SWEEP)
    members = np.split(sweeping, np.flatnonzero(np.diff(rows.sweep[sweeping])) + 1)
    members = [where for where in members if len(where) > 1]
    if not members and len(sweeping):
        raise InputError("no sweep has two rows in this log; choose a higher rate_hz or a lower speed")
    axes = axes_of(rows.quaternion)
    tracks = []
    for where in members:
        number = int(rows.sweep[where[0]])
        drawn = drawn_friction(friction, len(where), [seed, 6, number])
        tracks.append(Track(number, rows.position_m[where] / metres, axes[where], drawn))
    return tracks, members


def _warnings(
    mesh: Any, poses: PoseList, reactions: list[Reactions], length: float, radius: float, metres: float
) -> tuple[str, ...]:
    """Sentences on sweeps whose log is not that of a rod that is free before and after it."""
    touching = steps_touch(mesh, poses.position_m / metres, poses.axes(), length, radius)
    # a rod that was probed with goes back as it came
    outside = ~(measures(poses.move[:-1]) & measures(poses.move[1:])) & (poses.move[:-1] != Move.PROBE)
    hit = np.unique(poses.sweep[1:][touching & outside])
    bent = sum(bool(part.touches[-1]) for part in reactions)
    lost = sum(not part.known.all() for part in reactions)
    sentences = []
    if len(hit):
        sentences.append(
            f"in {len(hit)} sweeps, first {hit[0]}, the straight rod would touch the body in approach or retract, "
            "where the log has no reactions"
        )
    if bent:
        sentences.append(
            f"{bent} sweeps end in contact, and in their retracts the log has no reactions; let them go on farther"
        )
    if lost:
        sentences.append(
            f"in {lost} of {len(reactions)} sweeps rows are left out in which no equilibrium of the rod was found, as after a "
            "snap, or where it is caught or lies along the body"
        )
    return tuple(sentences)


DRIFTS = ("linear", "random-walk")
# Streams of random numbers: each fault draws from a separate one, so that one fault does not change the others.
_STREAMS = ("bias", "drift", "white", "pink", "jitter", "missing")


class Size(NamedTuple):
    """A size of forces and moments: absolute, or relative to the largest of the log."""

    force_N: float = 0.0
    moment_Nm: float = 0.0
    fraction: float = 0.0

    def of(self, largest: tuple[float, float]) -> Array:
        """(6,) of each channel, in N and N·m; the absolute and the relative part are added."""
        return np.repeat([self.force_N + self.fraction * largest[0], self.moment_Nm + self.fraction * largest[1]], 3)

    def __bool__(self) -> bool:
        return any(self[:])


class Place(NamedTuple):
    """Where a sensor sits in the frame of the clamp: its origin in mm, and its turn as "xyz" Euler angles in degrees."""

    position_mm: tuple[float, ...] = (0.0, 0.0, 0.0)
    euler_deg: tuple[float, ...] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Faults:
    """The faults of a rig; by default none.  `read_faults` describes the keys of the file that has them."""

    seed: int = 0
    rate_hz: float = 1000.0
    speed_mm_s: float | None = None
    """Of the clamp; None: as planned."""
    sensor: Place = field(default_factory=Place)
    nominal: Place = field(default_factory=Place)
    """What the experimenter takes for the sensor's place."""
    shows: str = SHOWS[0]
    bias: Size = field(default_factory=Size)
    bias_force_N: tuple[float, ...] | None = None
    bias_moment_Nm: tuple[float, ...] | None = None
    drift: Size = field(default_factory=Size)
    drift_kind: str = DRIFTS[0]
    noise: Size = field(default_factory=Size)
    pink: Size = field(default_factory=Size)
    quantum: Size = field(default_factory=Size)
    quantum_um: float = 0.0
    lag_ms: float = 0.0
    jitter_um: float = 0.0
    clock_ms: float = 0.0
    length_error: float = 0.0
    stiffness_error: float = 0.0
    missing: float = 0.0
    gap_ms: float = 0.0


def read_faults(path: str | Path) -> Faults:
    """The faults in a TOML file, all of whose keys are optional.

    ==================  ================================================================================================
    ``seed``            of all random numbers, 0 by default; the option ``--seed`` takes precedence
    ``rate_hz``         rows per second, 1000 by default
    ``speed_mm_s``      of the clamp; by default that of the plan
    ``[sensor]``        ``position_mm``, ``euler_deg`` ("xyz"): its frame in the clamp's; ``shows``: "clamp-on-rod" or
                        "rod-on-clamp"; ``nominal = {position_mm, euler_deg}``: what the experimenter takes them for
    ``[bias]``          ``force_N``, ``moment_Nm``: three numbers each; or ``fraction``, in a random direction
    ``[drift]``         ``kind``: "linear" or "random-walk"; size at the end of the log
    ``[noise]``         standard deviation of each channel: white, and with the prefix ``pink_`` that of 1/f noise
    ``[quantisation]``  steps of the channels; ``position_um``: of the positions
    ``[lag]``           ``ms``: time constant of a low-pass of the first order before the wrench is logged
    ``[pose]``          ``jitter_um``: standard deviation of each logged coordinate; ``clock_ms``: delay of the wrenches
    ``[rod]``           ``length_error``, ``stiffness_error``: relative differences of the true rod from the nominal one
    ``[missing]``       ``fraction`` of the rows that are lost, in gaps of ``gap_ms``; by default of one row
    ==================  ================================================================================================

    Raises InputError with the name of the file and the error in it.
    """
    file = read_section(path, "faults")
    sensor, bias, drift, noise, quantum, lag, pose, rod, missing = (
        file.section(name)
        for name in ("sensor", "bias", "drift", "noise", "quantisation", "lag", "pose", "rod", "missing")
    )
    faults = Faults(
        seed=file.integer("seed", 0, at_least=0),
        rate_hz=file.number("rate_hz", Faults.rate_hz, above=0),
        speed_mm_s=file.number("speed_mm_s", None, above=0),
        sensor=_place(sensor),
        nominal=_place(sensor.section("nominal")),
        shows=sensor.word("shows", SHOWS),
        bias=Size(fraction=bias.number("fraction", 0.0, at_least=0)),
        bias_force_N=bias.numbers("force_N", 3, None),
        bias_moment_Nm=bias.numbers("moment_Nm", 3, None),
        drift=_size(drift),
        drift_kind=drift.word("kind", DRIFTS),
        noise=_size(noise),
        pink=_size(noise, "pink_"),
        quantum=_size(quantum),
        quantum_um=quantum.number("position_um", 0.0, at_least=0),
        lag_ms=lag.number("ms", 0.0, at_least=0),
        jitter_um=pose.number("jitter_um", 0.0, at_least=0),
        clock_ms=pose.number("clock_ms", 0.0),
        length_error=rod.number("length_error", 0.0, above=-1, below=1),
        stiffness_error=rod.number("stiffness_error", 0.0, above=-1, below=1),
        missing=missing.number("fraction", 0.0, at_least=0, below=1),
        gap_ms=missing.number("gap_ms", 0.0, at_least=0),
    )
    file.finish()
    return faults


def _size(section: Section, prefix: str = "") -> Size:
    return Size(*(section.number(prefix + key, 0.0, at_least=0) for key in Size._fields))


def _place(section: Section) -> Place:
    none = (0.0, 0.0, 0.0)
    return Place(section.numbers("position_mm", 3, none), section.numbers("euler_deg", 3, none))


def _generator(faults: Faults, stream: str) -> np.random.Generator:
    return np.random.default_rng([faults.seed, 5, _STREAMS.index(stream)])


def measured(force: Array, moment: Array, faults: Faults, untouched: tuple[float, float] = (0.0, 0.0)) -> Array:
    """(n, 6) what the sensor logs of the true force (n, 3) and moment (n, 3) at the clamp, sampled at `faults.rate_hz`.

    untouched
        force and moment that fractions are relative to if nothing is touched.
    """
    largest = float(np.linalg.norm(force, axis=1).max()), float(np.linalg.norm(moment, axis=1).max())
    largest = largest if any(largest) else untouched
    delayed = lagged(np.concatenate([force, moment], axis=1), faults)
    turn, place = turn_of(faults.sensor.euler_deg), np.array(faults.sensor.position_mm) / 1000
    wrench: Array = np.hstack(to_inner(delayed[:, :3], delayed[:, 3:], turn, place))
    if faults.shows != SHOWS[0]:
        wrench = -wrench
    wrench = wrench + _bias(faults, largest) + _drift(len(wrench), faults, largest)
    if faults.noise:
        white = _generator(faults, "white").standard_normal(wrench.shape)
        wrench = wrench + white * faults.noise.of(largest)
    if faults.pink:
        random, sizes = _generator(faults, "pink"), faults.pink.of(largest)
        wrench = wrench + np.stack([size * pink_noise(len(wrench), random) for size in sizes], axis=1)
    return rounded(wrench, faults.quantum.of(largest))


def lagged(values: Array, faults: Faults) -> Array:
    """Columns (n, k) after a low-pass of the first order, and later by the clock's offset."""
    if faults.lag_ms:
        from scipy.signal import lfilter  # takes half a second, also where nothing is disturbed

        keep = np.exp(-1000 / faults.rate_hz / faults.lag_ms)
        values = lfilter([1 - keep], [1, -keep], values, axis=0)
    if faults.clock_ms:
        time = np.arange(len(values)) / faults.rate_hz
        shifted = time - faults.clock_ms / 1000
        values = np.stack([np.interp(shifted, time, column) for column in values.T], axis=1)
    return values


def _bias(faults: Faults, largest: tuple[float, float]) -> Array:
    """(6,) the offsets of the channels; those given as a fraction point in a random direction."""
    bias: Array = _directions(_generator(faults, "bias")) * faults.bias.of(largest)
    for part, given in ((slice(0, 3), faults.bias_force_N), (slice(3, 6), faults.bias_moment_Nm)):
        if given is not None:
            bias[part] = given
    return bias


def _directions(random: np.random.Generator) -> Array:
    """(6,) two random unit vectors, of a force and of a moment."""
    vectors = random.standard_normal((2, 3))
    return np.asarray((vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).ravel())


def _drift(rows: int, faults: Faults, largest: tuple[float, float]) -> Array:
    """(n, 6) drift from zero.

    A linear one has the stated size at the end of the log, in a random direction; a random walk has it as the root mean square
    at the end of many logs.
    """
    if not faults.drift:
        return np.zeros((rows, 6))
    random, size = _generator(faults, "drift"), faults.drift.of(largest)
    if faults.drift_kind == "linear":
        return np.linspace(0, 1, rows)[:, None] * (_directions(random) * size)
    steps = random.standard_normal((rows, 6)) * (size / np.sqrt(3 * max(rows - 1, 1)))
    steps[0] = 0.0
    return np.asarray(np.cumsum(steps, axis=0))


def pink_noise(rows: int, random: np.random.Generator) -> Array:
    """(n,) noise with the power spectrum 1/f and the standard deviation 1 in the mean over many logs."""
    length = next_fast_len(max(rows, 2), real=True)
    count = length // 2 + 1
    frequency = np.arange(1, count)
    amplitude = np.concatenate([[0.0], frequency**-0.5])
    spectrum = amplitude * (random.standard_normal(count) + 1j * random.standard_normal(count))
    # the sum over both halves of the spectrum of the expected power
    power = 2 * (amplitude[1:] ** 2 * 2).sum() / length**2
    noise: Array = irfft(spectrum, length)[:rows]
    return np.asarray(noise / np.sqrt(power))


def rounded(values: Array, step: Array) -> Array:
    """Columns (n, k) in whole steps (k,); a step of 0 leaves a column as it is."""
    safe = np.where(step > 0, step, 1.0)
    return np.where(step > 0, np.round(values / safe) * safe, values)


def logged_positions(position_m: Array, faults: Faults) -> Array:
    """(n, 3) positions as they are logged: with jitter, and in steps."""
    if faults.jitter_um:
        jitter = _generator(faults, "jitter").standard_normal(position_m.shape)
        position_m = position_m + faults.jitter_um * 1e-6 * jitter
    return rounded(position_m, np.full(3, faults.quantum_um * 1e-6))


def kept(rows: int, faults: Faults) -> Mask:
    """(n,) which rows are not lost."""
    keep = np.ones(rows, dtype=bool)
    if not faults.missing:
        return keep
    gap = max(1, round(faults.gap_ms * faults.rate_hz / 1000))
    random = _generator(faults, "missing")
    # where gaps may overlap, so many begin that the stated fraction is lost in the mean
    begins = random.random(rows) < 1 - (1 - faults.missing) ** (1 / gap)
    for row in np.flatnonzero(begins):
        keep[row : row + gap] = False
    keep[[0, -1]] = True
    return keep
