"""From a laboratory's table and a map to a recording, with a summary of what was done.

The columns are read and converted to SI units; the sensor's zero is taken off; the wrench is filtered, turned into the clamp's
frame and moved to the clamp; the log is cut into sweeps, and the noise is stated.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d import units, unmeasured
from scan3d.arrays import Array, Mask
from scan3d.calibration.report import Calibration, read_rig
from scan3d.errors import InputError
from scan3d.files.tables import Table, read_table
from scan3d.files.text import Transducer
from scan3d.laboratory import probed, signals
from scan3d.laboratory.bags import is_bag, read_bag
from scan3d.laboratory.logs import (
    DirectionError,
    Log,
    check_directions,
    ends,
    held,
    read_log,
    strokes,
    travel_angles,
    without_transfers,
)
from scan3d.laboratory.maps import ORIENTATION_OF, WRENCH_IN, Map, read_map
from scan3d.laboratory.signals import Stretches, find_air, given_air, robust_sd, tare
from scan3d.recording import (
    ACROSS,
    CHANNELS,
    FOLLOWED,
    FORCE,
    FORCE_SIGMAS,
    IN_PLANE,
    REACTIONS,
    Recording,
    completed,
    reaction_columns,
    rounding_sd,
)
from scan3d.rigs import Frame, euler_of, wrench_matrix
from scan3d.spatial import inverse
from scan3d.units import share
from scan3d.unmeasured import Jump, amid, jumps_of, steps_of
from scan3d.workers import tell

KIND = "import"
"""What the source of an imported recording is."""
# Part of the rows that another frame of the wrench must make those of a bent rod to be named.
_NEARLY_ALL = 0.9
# Part of the rows in contact that the sweeps of a right log hold, whose retracts begin in contact.
_HALF = 0.55
# Part of the largest force, at least, of one that is felt where sweeps are not the measure: more than rounding.
_ANY = 1e-6
_ELSEWHERE = (
    ": the others are not used; check the order, the convention and the direction of the orientation under [columns], the "
    'clamp\'s frame under [clamp], and whether strokes back are sweeps as well, directions = "both" under [sweeps]'
)


@dataclass(frozen=True)
class Summary:
    """What was done to a table."""

    table: str
    rows: int
    """Of the table."""
    seconds: float | None
    rate_hz: float | None
    samples: int
    """Of the recording."""
    sweeps: int
    """Probings among them."""
    probings: int
    sweeps_with_contact: int
    six_axis: bool
    left_out: Mapping[str, int]
    """Rows of the table that are not in the recording, by reason."""
    air: tuple[tuple[float, float], ...]
    """Stretches in the air, in seconds, or in rows if there is no time."""
    air_fraction: float
    ringing: int
    """Rows in which the rod rings in the air; they count as rows without contact."""
    zero: tuple[float, ...]
    """(6,) mean zero that was taken off, in N and N m, in the sensor's frame."""
    drift: tuple[float, ...]
    """(6,) by how much it changed."""
    noise_force_N: float
    noise_moment_Nm: float
    noise_factor: float
    """Noise that the filter leaves."""
    notes: tuple[str, ...]
    """What a user should know, in sentences."""


@dataclass(frozen=True)
class Imported:
    """A recording with what it was made of."""

    recording: Recording
    summary: Summary
    log: Log
    clock: Array
    """(n,) time of each row of the log in seconds, or its number."""
    zero: Array
    """(n, 6) of the sensor, as it was taken off."""
    air: Mask
    """(n,) rows in the air."""
    wrench: Array
    """(n, 6) support reactions in the clamp's frame."""
    position_m: Array
    """(n, 3) of the clamp."""
    sweep: NDArray[np.int64]
    """(n,) number of the sweep, -1 outside."""
    kept: NDArray[np.int64]
    """(m,) rows of the log that became the recording's."""


def import_table(
    path: str | Path, map: str | Path | Mapping[str, Any] | Map, rig: Calibration | str | Path | None = None
) -> Recording:
    """The recording of a laboratory's table: text, Excel, Parquet, MATLAB, numpy, HDF5, or a ROS bag.

    map
        says what the columns mean: the path of a TOML file, or its contents.
    rig
        a calibration, or the path of its file: its frames of sensor and clamp, and its rod, replace those of the map.

    Raises InputError with the file, the line and the column of what can't be used, and what to do.
    """
    chosen = read_map(map) if rig is None else with_rig(read_map(map), rig)
    return convert(load(path, chosen), chosen).recording


def load(path: str | Path, map: Map) -> Table:
    """The table of a file or a ROS bag."""
    return read_bag(path, map.topics) if is_bag(path) else read_table(path, map.layout, wanted=map.columns.names())


def with_rig(map: Map, rig: Calibration | str | Path) -> Map:
    """The map with the sensor, the clamp and the rod of a calibration, which may be the path of its file.

    A calibration states the clamp in the frame of the poses that it was given, and the sensor in that clamp's frame.  If these
    came from an import, its map had turned and moved them already: the calibration keeps that map's frames, so that the same
    physical frames follow for any later map.  Sign, units and columns stay those of the map, and the zero is found in the log's
    own stretches in the air, because it changes from day to day.  Raises InputError as `scan3d.read_rig`.
    """
    found = rig if isinstance(rig, Calibration) else read_rig(rig)
    (sensor, clamp), transducer = found.frames(imported=False), map.transducer
    if found.channels:  # places in the clamp's frame say nothing of that
        clamp = map.clamp
        units = np.array([map.factors["force" if name[0] == "f" else "moment"] for name in found.channels])
        matrix = tuple(tuple(row) for row in (found.matrix / units[:, None]).tolist())
        transducer = Transducer(found.channels, matrix, tuple(found.offset.tolist()))
        if not map.columns.signals:
            raise InputError(
                f"the calibrated rig has the matrix of {len(found.offset)} signals: name their columns as signals under "
                f"[columns] of {map.name}, in the place of force and moment"
            )
    used = {
        name: {"position_mm": (1000 * frame.position_m).tolist(), "euler_deg": euler_of(frame.turn).tolist()}
        for name, frame in (("sensor", sensor), ("clamp", clamp))
    }
    return replace(
        map,
        sensor=sensor,
        transducer=transducer,
        gains=found.gains,
        clamp=clamp,
        rod=found.rod,
        rig={"name": "calibration" if isinstance(rig, Calibration) else Path(rig).name, **used},
        uncertainty=found.uncertainty(),
        noise_pose_m=found.pose_noise_m if map.noise_pose_m is None else map.noise_pose_m,
    )


def not_rigged(source: Mapping[str, Any]) -> None:
    """Raise InputError for the source of a recording that a rig has corrected: frames would be applied twice."""
    if source.get("calibrated"):
        raise InputError(
            "the recording was corrected by a calibrated rig already; leave --rig out, or import the table again "
            "without it"
        )


def convert(table: Table, map: Map) -> Imported:
    """The recording of a table that is read already, with what it was made of.  Raises InputError as `import_table`."""
    try:
        imported = _converted(table, map)
    except InputError as error:
        if isinstance(error, DirectionError) and map.columns.sweep is not None and map.columns.move is None:
            with contextlib.suppress(InputError):  # a number that stays until the next sweep begins
                imported = convert(table, replace(map, columns=replace(map.columns, sweep=None)))
                words = f"rows of one number in {map.columns.sweep!r} are no straight stroke"
                notes = (f"{words}: sweeps are those of the clamp's motion", *imported.summary.notes)
                return replace(imported, summary=replace(imported.summary, notes=notes))
        for note in _other_frame(None, table, map):
            raise InputError(f"{error}; or {note}") from None
        if words := _better_reading(table, map, _HALF):
            raise InputError(f"{error}; all would be right if {words}") from None
        raise
    notes = (*_other_frame(imported.recording, table, map), *imported.summary.notes)
    part = _held(imported)
    # retracts and strokes back hold contacts as well, but not most of them
    words = _better_reading(table, map, _NEARLY_ALL) if part < 0.7 else ""
    if words or part < _HALF:
        doubt = f"only {share(part)} of the rows in contact lie in sweeps along -x of the clamp's frame"
        likely = f", and nearly all do if {words}: check [columns] orientation of {map.name}" if words else _ELSEWHERE
        notes = (doubt + likely, *notes)
    return replace(imported, summary=replace(imported.summary, notes=notes))


def _converted(table: Table, map: Map) -> Imported:
    log = read_log(table, map)
    clock = np.arange(len(log), dtype=np.float64) if log.time_s is None else log.time_s
    position, quaternion = map.clamp.carried(log.position_m, log.quaternion)
    tell("finding the sensor's zero")
    at_ends = probed.ends_of(position, quaternion, map.rod.length_m)
    sensed = _filtered(_tared(log, clock, map, table.name, at_ends), log, clock, map, table.name)
    measured = np.ones(len(log), dtype=bool) if sensed.measured is None else sensed.measured
    sensed = sensed._replace(wrench=np.where(measured[:, None], sensed.wrench, 0.0))
    wrench, known = _clamp_wrench(sensed.wrench * (1 + map.gains), log.present, map, table.name)
    reach = float(np.ptp(position, axis=0).max()) / map.rod.length_m
    if reach < 0.02:
        raise InputError(
            f"{table.name}: the clamp moves over {reach:.3g} rod lengths only; check [units] length, [columns] "
            f"position and [rod] length_m of {map.name}"
        )
    noise = _clamp_noise(sensed.noise, map, known)
    tell("finding the sweeps")
    sweep, backwards, probing, notes = _sweeps(log, wrench, position, quaternion, map, noise, table.name)
    touched = _touching(sensed.wrench, noise, 0.05)  # a part that only contact has
    check_directions(map, table.name, np.where(measured, sweep, -1), position, quaternion, touched, probing)
    notes = [*log.notes, *sensed.notes, *notes]
    if backwards.any():
        if any(map.rod.curvatures[:2]):
            raise InputError(
                f"{table.name}: the rod of {map.name} is curved, and curves the other way in the frame of a stroke back, "
                "which is turned by half a turn about the rod; import the two directions apart, those "
                "back with the frames under [clamp] and [sensor] turned by 180° about y, and curvature about z and x reversed"
            )
        # after half a turn about the rod a stroke along +x is one along -x
        quaternion, wrench, signs = quaternion.copy(), wrench.copy(), np.array([-1.0, 1.0, -1.0])
        half_turn = Frame(np.zeros(3), np.diag(signs))
        quaternion[backwards] = half_turn.carried(position[backwards], quaternion[backwards])[1]
        wrench[backwards] *= np.tile(signs, 2)
    within = np.flatnonzero((sweep >= 0) & ~sensed.blurred & measured)
    if not len(within):
        raise InputError(
            f"{table.name} has no row of a sweep that can be used: the filter blurs all that were measured; raise "
            f"lowpass_hz of {map.name}, or leave [filter] out"
        )
    every = max(1, round(sensed.rate / map.rate_hz)) if map.rate_hz and sensed.rate else 1
    kept = within[signals.thinned(sweep[within], every)]
    if probing.any() and every > 1:  # of a probing the first row with a force is the contact
        pressed = within[probing[within] & _touching(wrench, noise, _ANY)[within]]
        kept = np.union1d(kept, pressed[np.unique(sweep[pressed], return_index=True)[1]])
    recording = _recording(table, map, noise, sweep[kept], position[kept], quaternion[kept], wrench[kept], known)
    recording = _with_steps(recording, _in_clamp(_rounding(log, measured, map), map, known))
    count = len(kept)
    if recording.completed is not None:
        recording, single = completed(recording)
        kept = kept[single]
    if log.time_s is not None:
        recording = replace(recording, source={**recording.source, "speed_m_per_s": _speed(recording, clock[kept])})
    if rung := int(sensed.ringing[kept].sum()):  # which are zeros, though the others have noise
        recording = replace(recording, source={**recording.source, "ringing": rung})
    _check_sizes(recording, map, table.name)
    sweeps = len(np.unique(recording.sweep))
    # a rod that goes on along itself comes from where it was, whatever was not measured on its way
    parts = unmeasured.parts(sweep, measured | probing)
    recording = replace(recording, sweep=parts[kept])
    touching = felt(recording.force_N, noise[0])
    summary = Summary(
        table=table.name,
        rows=len(table) + sum(table.left_out.values()),
        seconds=None if log.time_s is None else float(clock[-1] - clock[0]),
        rate_hz=None if log.time_s is None or clock[-1] == clock[0] else float((len(log) - 1) / (clock[-1] - clock[0])),
        samples=len(recording),
        sweeps=sweeps,
        probings=len(np.unique(sweep[kept][probing[kept]])),
        sweeps_with_contact=len(np.unique(sweep[kept][touching])),
        six_axis=recording.six_axis,
        left_out={
            **table.left_out,
            "without numbers": len(table) - len(log) - log.repeated,
            "repeated": log.repeated,
            "between sweeps": int((sweep < 0).sum()),
            "not measured": int((~measured & (sweep >= 0)).sum()),
            "blurred by the filter": int((sensed.blurred & measured & (sweep >= 0)).sum()),
            "thinned": len(within) - count,
            "left open by the channels": count - len(kept),
        },
        air=tuple((float(clock[a]), float(clock[b - 1])) for a, b in sensed.stretches),
        air_fraction=float(sensed.air.mean()),
        ringing=int(sensed.ringing.sum()),
        zero=tuple(sensed.zero.mean(axis=0).tolist()),
        drift=tuple(np.ptp(sensed.zero, axis=0).tolist()),
        noise_force_N=recording.noise_force_N,
        noise_moment_Nm=recording.noise_moment_Nm,
        noise_factor=sensed.factor,
        notes=(*notes, *_contact_notes(wrench[kept], touching, probing[kept], known | recording.six_axis, map)),
    )
    return Imported(recording, summary, log, clock, sensed.zero, sensed.air, wrench, position, sweep, kept)


def felt(force_N: Array, noise_N: float, part: float = 1e-3) -> Mask:
    """Rows (n,) whose force (n, k) stands out from the noise, and is more than a part of the largest one."""
    force = np.linalg.norm(force_N, axis=1)
    return np.asarray(force > max(FORCE_SIGMAS * noise_N, part * float(force.max(initial=0.0))))


def _touching(wrench: Array, noise: tuple[float, float], part: float = 1e-3) -> Mask:
    """`felt` of wrenches (n, 6): of their moments where no force was measured."""
    k = 0 if wrench[:, :3].any() else 1
    return felt(wrench[:, 3 * k : 3 * k + 3], noise[k], part)


class _Sensed(NamedTuple):
    """What the sensor measured, tared and filtered, in its own frame."""

    wrench: Array
    """(n, 6)"""
    zero: Array
    """(n, 6), or (1, 6) if nothing was taken off."""
    air: Mask
    """(n,)"""
    stretches: list[tuple[int, int]]
    noise: Array
    """(6,) standard deviations that are left."""
    ringing: Mask
    """(n,) rows in which the rod rings in the air: no wrench."""
    blurred: Mask
    """(n,) rows that the filter changes by more than their noise."""
    factor: float = 1.0
    """Noise that the filter leaves, over that before it."""
    rate: float | None = None
    """Rows per second, if there is a filter."""
    measured: Mask | None = None
    """(n,) rows whose wrench and pose were measured."""
    notes: tuple[str, ...] = ()


def _tared(log: Log, clock: Array, map: Map, where: str, at_ends: Mask) -> _Sensed:
    """The log without its zero; in rows (n,) `at_ends` of strokes along the rod it may touch, however lightly."""
    none, calm = np.zeros(len(log), dtype=bool), ~log.unmeasured
    jumps = jumps_of(log.wrench, calm)
    calm = calm & ~amid(jumps, len(log))
    if not calm.any():
        raise InputError(f"{where} has no row that was measured: {'; '.join(log.notes)}")
    step = np.diff(clock)
    run = np.append(0, np.cumsum((step > 1.5 * np.median(step)) | (np.diff(calm) != 0)))
    if map.air == "none":
        zero = steps_of(jumps, len(log))
        zero = zero - min(np.unique(zero, axis=0), key=lambda level: _away(log.wrench[calm] - level))
        sensed = _Sensed(log.wrench - zero, zero, none, [], np.zeros(6), none, none)
    elif isinstance(map.air, str):
        sensed = _levelled(
            log, clock, jumps, lambda wrench: find_air(wrench, clock, calm & ~at_ends, where, calm), calm
        )
    elif log.time_s is None:
        raise InputError(
            f"{where}: [tare] air in seconds needs the time of the rows; name its column as time under [columns]"
        )
    else:
        given = given_air(clock, map.air, where)
        sensed = _levelled(log, clock, jumps, lambda _: given, calm)
    swings = signals.ringing(sensed.wrench, sensed.noise, run)
    if swings.any() and map.air == "auto":
        # where the rod rings is neither zero nor noise; a rod that rings all the time leaves what was found before
        with contextlib.suppress(InputError):
            quiet = calm & ~swings
            sensed = _levelled(
                log, clock, jumps, lambda wrench: find_air(wrench, clock, quiet & ~at_ends, where, calm), quiet
            )
            swings = signals.ringing(sensed.wrench, sensed.noise, run)
    still = np.where(swings[:, None], 0.0, sensed.wrench)
    notes = _of_jumps(jumps, log.time_s)
    return sensed._replace(wrench=still, air=sensed.air & ~swings, ringing=swings, measured=calm, notes=notes)


def _levelled(
    log: Log, clock: Array, jumps: list[Jump], stretches: Callable[[Array], Stretches], calm: Mask
) -> _Sensed:
    """The log without its zero, by its stretches in the air, which a function finds in the wrench without jumps of the zero."""
    steps = steps_of(jumps, len(log))
    found = signals.separated(stretches(log.wrench - steps), calm, jumps)
    steps = steps_of(signals.measured_jumps(log.wrench, jumps, found), len(log))
    air = tare(log.wrench - steps, clock, found)
    zero = air.zero + steps
    wrench = log.wrench - zero
    # rows in which all channels are no more than rounding would count as forces
    largest = np.repeat([np.abs(log.wrench[:, :3]).max(), np.abs(log.wrench[:, 3:]).max()], 3)
    nothing = np.asarray((np.abs(wrench) <= 1e-13 * largest).all(axis=1))
    none = np.zeros(len(log), dtype=bool)
    return _Sensed(np.where(nothing[:, None], 0.0, wrench), zero, air.rows & calm, found, air.noise, none, none)


def _away(wrench: Array) -> float:
    """How far wrenches (n, c) are from zero, in the ranges of force and moment: the smallest of most rows."""
    size = np.abs(wrench).max(axis=0)
    return float(np.median((np.abs(wrench) / np.where(size > 0, size, 1.0)).max(axis=1)))


def _of_jumps(jumps: list[Jump], time: Array | None) -> tuple[str, ...]:
    """A sentence on a zero that jumps."""
    if not jumps:
        return ()
    at = [f"row {jump.row + 1}" if time is None else f"{time[jump.row]:.1f} s" for jump in jumps]
    sizes = [max(np.abs(jump.size[part]).max() for jump in jumps) for part in (slice(0, 3), slice(3, 6))]
    by = f"by up to {units.force(float(sizes[0]))} and {units.moment(float(sizes[1]))}"
    return (
        f"the sensor's zero jumps at {', '.join(at)}, {by}: the sensor was tared again; each part has its own zero",
    )


def _filtered(sensed: _Sensed, log: Log, clock: Array, map: Map, where: str) -> _Sensed:
    if not (map.lowpass_hz or map.rate_hz):
        return sensed
    rate = signals.sampling_rate(log.time_s, where)
    if not map.lowpass_hz:
        return sensed._replace(rate=rate)
    wrench = signals.low_pass(sensed.wrench, clock, map.lowpass_hz, rate, where)
    blurred = signals.blurred(sensed.wrench, wrench, clock, map.lowpass_hz, rate, where)
    factor = signals.noise_factor(map.lowpass_hz, rate)
    left = factor * sensed.noise
    notes = sensed.notes
    if sensed.air.any():
        found = np.where(sensed.noise > 0, robust_sd(wrench[sensed.air]), 0.0)
        if (found > 1.3 * left).any():
            notes += ("the filter leaves more noise than it would of white noise; the noise found after it is stated",)
        left = np.maximum(left, found)
    return sensed._replace(wrench=wrench, noise=left, blurred=blurred, factor=factor, rate=rate, notes=notes)


def _clamp_wrench(wrench: Array, present: Mask, map: Map, where: str) -> tuple[Array, Mask]:
    """The wrench (n, 6) in the clamp's frame, and which of its channels (6,) the sensor's channels determine.

    Raises InputError if fx, fy and mz of the clamp are not among them, with the channel that is missing; of one of them
    something else may be known in its place.
    """
    sensor = map.sensor
    matrix = wrench_matrix(sensor.turn, sensor.position_m)
    scale = np.abs(matrix).max(axis=1, keepdims=True)
    needed = np.abs(matrix) > 1e-12 * scale  # less is rounding of the turn
    known: Mask = ~(needed & ~present).any(axis=1)
    missing = [channel for channel in IN_PLANE if not known[channel]]
    if map.known is not None and len(missing) != 1 and missing != [0, 1]:
        raise InputError(
            f"{where}: [known] of {map.name} stands for one of fx, fy and mz of the clamp, or for fx and fy, and of "
            "these "
            f'{len(missing)} are missing; leave its column empty (""), or leave out [known]'
        )
    for channel in missing:
        if map.known is None:
            absent = ", ".join(CHANNELS[k] for k in np.flatnonzero(needed[channel] & ~present))
            raise InputError(
                f"{where}: {CHANNELS[channel]} of the clamp needs {absent} of the sensor as well, because [sensor] "
                "turns or moves it; add the column, or give the wrench in the clamp's frame"
                if not sensor.trivial
                else f"{where}: {absent} was not measured; [known] of {map.name} may state friction, or contact = 'tip'"
            )
    return (wrench if sensor.trivial else np.where(known, wrench @ matrix.T, 0.0)), known


def _clamp_noise(noise: Array, map: Map, known: Mask) -> tuple[float, float]:
    """Standard deviations of force and moment in the clamp's frame, as stated or as found."""
    force, moment = _in_clamp(noise, map, known)
    return (
        force if map.noise_force_N is None else map.noise_force_N,
        moment if map.noise_moment_Nm is None else map.noise_moment_Nm,
    )


def _in_clamp(deviations: Array, map: Map, known: Mask) -> tuple[float, float]:
    """Standard deviations (6,) of the sensor's channels in the clamp's frame: the largest of the force, and of the moment."""
    variance = wrench_matrix(map.sensor.turn, map.sensor.position_m) ** 2 @ deviations**2
    deviation = np.sqrt(np.where(known, variance, 0.0))
    return float(deviation[:3].max()), float(deviation[3:].max())


def _rounding(log: Log, rows: Mask, map: Map) -> Array:
    """(6,) standard deviations of the sensor's channels by the rounding of what it shows in rows (n,), whose values repeat, as
    those of a converter do.

    Without noise, a drift at even times lies on a grid as well.
    """
    shown = log.shown[rows].T
    steps = [rounding_sd(one, measured=True) if 2 * len(np.unique(one)) < len(one) else 0.0 for one in shown]
    found = np.sqrt(log.by_shown**2 @ np.square(steps))
    # the clamp's turn mixes components along the world's axes
    return np.repeat([found[:3].max(), found[3:].max()], 3) if map.wrench_in == "world" else found


def _with_steps(recording: Recording, rounding: tuple[float, float]) -> Recording:
    """The recording with the rounding of the sensor's force and moment, which taring and turning hide in its columns."""
    noise = recording.noise
    stated, counted = (recording.noise_force_N, recording.noise_moment_Nm), (noise.force_N, noise.moment_Nm)
    # noise of half a step makes the errors of rounding independent, and what is found in the air has them then
    hidden = [deviation < 3**0.5 * step for deviation, step in zip(stated, rounding, strict=True)]
    if not any(hidden):
        return recording
    force, moment = (
        deviation if not coarse or known >= 0.99 * np.hypot(deviation, step) else float(np.hypot(deviation, step))
        for deviation, step, known, coarse in zip(stated, rounding, counted, hidden, strict=True)
    )
    return replace(recording, noise_force_N=force, noise_moment_Nm=moment, noise_independent=False)


def _sweeps(
    log: Log,
    wrench: Array,
    position: Array,
    quaternion: Array,
    map: Map,
    noise: tuple[float, float],
    where: str,
) -> tuple[NDArray[np.int64], Mask, Mask, list[str]]:
    """Number of the sweep (n,) of each row, -1 outside, rows (n,) of strokes along +x that count as sweeps, rows (n,) of
    probings, and notes."""
    none = np.zeros(len(log), dtype=bool)
    both, length = map.directions == "both", map.rod.length_m
    force = np.linalg.norm(wrench[:, :3], axis=1) / map.rod.force_unit_N
    poses = probed.Poses(position, quaternion, np.where(_touching(wrench, noise, _ANY), force, 0.0), length)
    if log.sweep is not None:
        notes: list[str] = []
        if log.probe is None:
            sweep, probing = probed.of_numbers(poses, log.sweep)
        else:
            sweep, probing, notes = probed.of_moves(poses, log.sweep, log.probe, where)
        if both:
            swept = np.where(probing, -1, sweep)
            numbers = np.unique(swept[swept >= 0])
            none = np.isin(swept, numbers[travel_angles(swept, position, quaternion) > np.pi / 2])
        return sweep, none, probing, notes
    stroke, back = strokes(position, quaternion, length)
    counting = ~back | both
    sweep = np.append(np.where(counting, np.cumsum(counting) - 1, -1), -1)[stroke]
    backwards = (sweep >= 0) & np.append(back, False)[stroke]
    motions = probed.of_strokes(poses)
    probing = none.copy()
    for rows in motions:
        probing[rows] = True
    sweep[probing] = -1
    touching = _touching(wrench, noise)
    if motions and not touching[sweep >= 0].any():  # the clamp goes from one probing to the next
        sweep[:] = -1
    sweep, left = without_transfers(sweep, touching, position, quaternion, length)
    for k, rows in enumerate(motions, start=sweep.max() + 1):
        sweep[rows] = k
    if motions:  # in the order of the log
        numbers, first, _ = ends(sweep)
        sweep = np.append(np.argsort(np.argsort(first)), -1)[sweep]
    note = (
        f"{left} strokes without contact are left out, because the rod may have been out of the body's reach; if they "
        "are sweeps, number them in a column and name it as sweep under [columns]"
    )
    return sweep, backwards & (sweep >= 0), probing, [note] if left else []


def _recording(
    table: Table,
    map: Map,
    noise: tuple[float, float],
    sweep: NDArray[np.int64],
    position: Array,
    quaternion: Array,
    wrench: Array,
    known: Mask,
) -> Recording:
    channel = _completed_channel(known)
    six_axis = bool(known.all() or (map.known is not None and channel in FOLLOWED and known[3]))
    source = {"kind": KIND, "table": table.name, "table_sha256": table.sha256, "map": dict(map.text)}
    return Recording(
        sweep=sweep,
        position_m=position,
        quaternion=quaternion,
        **reaction_columns(wrench[:, :3], wrench[:, 3:], six_axis),
        rod=map.rod,
        noise_force_N=noise[0],
        noise_moment_Nm=noise[1],
        noise_pose_m=map.noise_pose_m or 0.0,
        unit=map.unit,
        table_m=map.table_m,
        source=source | ({"rig": dict(map.rig), "calibrated": True} if map.rig else {}),
        rig=map.uncertainty,
        gravity=map.gravity,
        completed=None if map.known is None else replace(map.known, channel=channel),
    )


def _completed_channel(known: Mask) -> str:
    """What is completed of the clamp's channels (6,) that are known."""
    if not known[:2].any():
        return FORCE
    # with both moments the rod's plane is known, and the force across it is not
    return (
        ACROSS if known[1] and known[3] and not known[:3:2].any() else list(REACTIONS)[int(np.argmin(known[IN_PLANE]))]
    )


def _speed(recording: Recording, clock: Array) -> float:
    """The usual speed of the clamp in the sweeps, by which a diagnosis tells a time from a way."""
    same, time = np.diff(recording.sweep) == 0, np.diff(clock)
    way = np.linalg.norm(np.diff(recording.position_m, axis=0), axis=1)
    moving = same & (time > 0) & (way > 0)
    return float(np.median(way[moving] / time[moving])) if moving.any() else 0.0


def _check_sizes(recording: Recording, map: Map, table: str) -> None:
    """Raise InputError if travel, force or moment can't be those of the rod, with the entry of the map to check.

    A wrong unit makes them wrong by a factor of a thousand.
    """
    rod = recording.rod
    _, first, last = ends(recording.sweep)
    travel = np.linalg.norm(recording.position_m[last] - recording.position_m[first], axis=1) / rod.length_m
    median = float(np.median(travel))
    if not 0.005 <= median <= 50:
        raise InputError(
            f"{table}: the sweeps are {median:.3g} rod lengths long, where 0.005 to 50 are expected; check [units] "
            f"length, [columns] position and [rod] length_m of {map.name}"
        )
    touching = felt(recording.force_N, recording.noise_force_N)
    if not touching.any():
        return
    force = np.linalg.norm(recording.force_N[touching], axis=1)
    largest = float(force.max()) / rod.force_unit_N
    # a rod whose contact has slid to a tenth of its length has a few hundred
    if not 1e-4 < largest < 2000:
        raise InputError(
            f"{table}: the largest force, {units.force(force.max())}, is {largest:.3g} times EI/L² of the rod, where "
            "0.0001 to 2000 are expected; check [units] force, the columns of the force, [tare] and [rod] of "
            f"{map.name}"
        )
    # a rod that is pushed along itself has hardly any
    touching &= ~recording.in_probings
    force = np.linalg.norm(recording.force_N[touching], axis=1)
    if not len(force):
        return
    strong = force >= np.median(force)
    moment = np.abs(recording.moment_Nm[touching][strong])
    # over the largest possible value, which follows from the energy of the bent rod with a free end
    ratio = float(np.median(moment / (2 * np.sqrt(force[strong] * rod.bending_stiffness_Nm2))))
    if not 0.01 < ratio < 2:
        raise InputError(
            f"{table}: the moments in contact are {ratio:.3g} times the largest that the rod can have under such "
            "forces, where 0.01 to 1 are expected; check [units] force and moment, the columns of mz, [tare], "
            f"[sensor] and [rod] of {map.name}"
        )


def _bent(recording: Recording) -> float:
    """The part of the rows of sweeps with a force that are those of a bent rod whose contact presses against the sweep."""
    force, moment = recording.wrench()
    touching = felt(force, recording.noise_force_N, 0.05) & ~recording.in_probings
    force, moment = force[touching] / recording.rod.force_unit_N, moment[touching] / recording.rod.moment_unit_Nm
    found = inverse.reconstruct(force, moment, tolerance=inverse.PAST_TIP)
    return float(((found.status == inverse.Status.OK) & (force[:, 0] < 0)).mean()) if len(force) else 1.0


def _other_frame(recording: Recording | None, table: Table, map: Map) -> tuple[str, ...]:
    """A note if most rows are those of a bent rod only in the other frame of the wrench that a map can state.

    `recording` is None if there is none with the frame of the map.  In a single orientation of the clamp the two frames differ
    by a turn of the sensor, and nothing tells them apart.
    """
    if recording is not None and (not recording.six_axis or _bent(recording) >= 0.5):
        return ()
    frame = next(frame for frame in WRENCH_IN if frame != map.wrench_in)
    try:
        other = _converted(table, replace(map, wrench_in=frame)).recording
    except InputError:
        return ()
    together = np.linalg.norm(other.axes().mean(axis=0), axis=1).min()
    if not other.six_axis or together > _NEARLY_ALL or (part := _bent(other)) < _NEARLY_ALL:
        return ()
    return (
        f"force and moment have their components in the frame of the {frame}, in which {share(part)} of the rows with "
        "a "
        f'force are those of a bent rod: check wrench_in = "{frame}" under [columns] or [ros] of {map.name}',
    )


def _held(imported: Imported) -> float:
    """The part of the rows in contact that lie in sweeps."""
    noise = imported.summary.noise_force_N, imported.summary.noise_moment_Nm
    return held(imported.sweep, _touching(imported.wrench, noise, 0.05))


def _better_reading(table: Table, map: Map, least: float) -> str:
    """Words for another reading of the orientation with which sweeps hold at least this part of the contacts, or ""."""
    for words, other in _other_readings(map):
        with contextlib.suppress(InputError):
            imported = _converted(table, other)
            if imported.summary.sweeps_with_contact and _held(imported) >= least:
                return words
    return ""


def _other_readings(map: Map) -> Iterator[tuple[str, Map]]:
    """Other ways to read the orientation, with the words for them."""
    orientation = map.columns.orientation

    def changed(position_in: str = map.columns.position_in, **fields: Any) -> Map:
        columns = replace(map.columns, position_in=position_in, orientation=replace(orientation, **fields))
        return replace(map, columns=columns)

    if orientation.kind == "quaternion":
        other, place = ("xyzw", "last") if orientation.order == "wxyz" else ("wxyz", "first")
        yield f'qw is the {place} of the four columns, order = "{other}"', changed(order=other)
    elif orientation.kind != "matrix":
        unit, factor = ("rad", 1.0) if map.factors["angle"] != 1 else ("deg", np.pi / 180)
        turned = replace(map, factors={**map.factors, "angle": factor})
        yield f'the angles are in {unit}, angle = "{unit}" under [units]', turned
    if orientation.kind == "euler":
        convention = orientation.convention
        for other in (convention.swapcase(), convention[::-1], convention[::-1].swapcase()):
            if other != convention:
                yield f'the convention is "{other}"', changed(convention=other)
    of = next(of for of in ORIENTATION_OF if of != orientation.of)
    whose = "world in the clamp's frame" if of == "world" else "clamp in the world"
    yield f'the orientation is that of the {whose}, of = "{of}" in its braces', changed(of=of)
    if of == "world":
        words = (
            f'the pose is that of the {whose}, of = "{of}" in the braces of the orientation and position_in = "inverse"'
        )
        yield words, changed("inverse", of=of)


def _contact_notes(wrench: Array, touched: Mask, probing: Mask, known: Mask, map: Map) -> list[str]:
    """What the channels (6,) that are known, and the wrench (n, 6) of the recording's rows, say about its use."""
    silent = (
        "no row has a force that stands out from the noise: either the rod touched nothing, or the sensor is silent"
    )
    notes = [] if touched.any() else [silent]
    swept = touched & ~probing
    if known[0] and (onward := int((wrench[swept, 0] > 0).sum())) > _HALF * swept.sum():
        notes.append(
            f"in {onward} of {swept.sum()} rows of sweeps in contact the body would pull the rod on (fx above 0): check the "
            f"sign of force and moment, shows and the frame under [sensor] of {map.name}"
        )
    further = [CHANNELS[k] for k in (2, 3, 4) if known[k]]
    if not known.all() and further:
        text = (
            f"{', '.join(further)} are left out, because a planar recording has fx, fy and mz, and all six are needed "
            "for the model in space"
        )
        if known[2] and touched.any():
            part = float(np.median(np.abs(wrench[touched, 2]) / np.linalg.norm(wrench[touched, :3], axis=1)))
            if part > 0.05:
                text += f"; fz is {share(part)} of the force in contact, and the planar model takes it for zero"
        notes.append(text)
    if map.air == "none" and map.noise_force_N is None:
        notes.append(
            "nothing is known of the noise: state force_N and moment_Nm under [noise], or stretches in the air under "
            "[tare]"
        )
    return notes
