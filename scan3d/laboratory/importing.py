"""From a laboratory's table and a map to a recording, with a summary of what was done."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array, Mask
from scan3d.errors import InputError
from scan3d.frames import Frame, wrench_matrix
from scan3d.laboratory import filtering, segments, taring
from scan3d.laboratory.air import find_air
from scan3d.laboratory.bags import is_bag, read_bag
from scan3d.laboratory.calibration_result import Calibration
from scan3d.laboratory.columns import CHANNELS, Log, read_log
from scan3d.laboratory.directions import check_directions
from scan3d.laboratory.maps import Map, read_map
from scan3d.laboratory.notes import contact_notes, filter_notes
from scan3d.laboratory.plausibility import check_range, check_sizes, felt, in_contact, stands_out
from scan3d.laboratory.rigged import with_rig
from scan3d.laboratory.tables import RawTable, read_table
from scan3d.recording import Recording

KIND = "import"
"""What the source of an imported recording is."""
# Noise that is this many times as large as that of a white one would be after the filter is stated as it is found.
_COLOURED = 1.3
# Rounding of a wrench from which its zero was taken off, relative to the largest one.
_ROUNDING = 1e-13
# Parts of a channel that count as rounding of a turn, relative to the whole.
_TURN_ROUNDING = 1e-12
# Half a turn about the rod, in which a stroke along +x is one along -x.
_HALF_TURN = Frame(np.zeros(3), np.diag([-1.0, 1.0, -1.0]))


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
    sweeps_with_contact: int
    six_axis: bool
    left_out: Mapping[str, int]
    """Rows of the table that are not in the recording, by reason."""
    air: tuple[tuple[float, float], ...]
    """Stretches in the air, in seconds, or in rows if there is no time."""
    air_fraction: float
    zero: tuple[float, ...]
    """(6,) mean zero that was taken off, in N and N m, in the sensor's frame."""
    drift: tuple[float, ...]
    """(6,) by how much it changed."""
    noise_force_N: float
    noise_moment_Nm: float
    noise_factor: float
    """Noise that the filter leaves."""
    notes: tuple[str, ...]


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
    """The recording of a laboratory's table: text with any delimiter, Parquet, or a ROS bag.

    map
        says what the columns mean: the path of a TOML file, or its contents.
    rig
        a calibration, or the path of its file: its frames of sensor and clamp, and its rod, replace those of the map.

    Raises InputError with the file, the line and the column of what can't be used, and what to do.
    """
    chosen = read_map(map) if rig is None else with_rig(read_map(map), rig)
    return convert(load(path, chosen), chosen).recording


def load(path: str | Path, map: Map) -> RawTable:
    """The table of a file or a ROS bag."""
    return read_bag(path, map.topics) if is_bag(path) else read_table(path, map.layout)


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
    factor: float
    """Noise that the filter leaves, over that before it."""
    blurred: Mask
    """(n,) rows that the filter changes by more than their noise."""
    rate: float | None
    """Rows per second, if there is a filter."""
    notes: list[str]


def convert(table: RawTable, map: Map) -> Imported:
    """The recording of a table that is read already, with what it was made of.  Raises InputError as `import_table`."""
    log = read_log(table, map)
    clock = np.arange(len(log), dtype=np.float64) if log.time_s is None else log.time_s
    sensed = _sensed(log, clock, map, table.name)
    wrench, known = _clamp_wrench(sensed.wrench, log.present, map.sensor, table.name)
    position, quaternion = map.clamp.carried(log.position_m, log.quaternion)
    check_range(position, map, table.name)
    sweep, backwards = _sweeps(log, position, quaternion, map)
    noise = _clamp_noise(sensed.noise, map, known)
    sweep, transfers = _without_transfers(sweep, log, wrench, position, quaternion, map, noise[0])
    directions = check_directions(table, map, sweep, position, quaternion, in_contact(sensed.wrench[:, :3], noise[0]))
    if backwards.any():
        quaternion, wrench = quaternion.copy(), wrench.copy()
        quaternion[backwards] = _HALF_TURN.carried(position[backwards], quaternion[backwards])[1]
        wrench[backwards] *= np.tile(np.diag(_HALF_TURN.turn), 2)
    within = np.flatnonzero((sweep >= 0) & ~sensed.blurred)
    every = max(1, round(sensed.rate / map.rate_hz)) if map.rate_hz and sensed.rate else 1
    kept = within[filtering.thinned(sweep[within], every)] if every > 1 else within
    rows = _Rows(sweep[kept], position[kept], quaternion[kept], wrench[kept])
    recording = _recording(table, map, rows, bool(known.all()), noise)
    check_sizes(recording, map, table.name)
    notes = [*sensed.notes, *directions, *transfers, *filter_notes(map, sensed.rate, every)]
    notes += contact_notes(recording, wrench[kept], known, map)
    left_out = {
        "without numbers": len(table) - len(log), "between sweeps": int((sweep < 0).sum()),
        "blurred by the filter": int((sensed.blurred & (sweep >= 0)).sum()), "thinned": len(within) - len(kept),
    }  # fmt: skip
    summary = _summary(table, log, clock, sensed, recording, left_out, notes)
    return Imported(recording, summary, log, clock, sensed.zero, sensed.air, wrench, position, sweep, kept)


def _summary(
    table: RawTable,
    log: Log,
    clock: Array,
    sensed: _Sensed,
    recording: Recording,
    left_out: Mapping[str, int],
    notes: list[str],
) -> Summary:
    return Summary(
        table=table.name,
        rows=len(table),
        seconds=None if log.time_s is None else float(clock[-1] - clock[0]),
        rate_hz=_rate(log.time_s),
        samples=len(recording),
        sweeps=len(np.unique(recording.sweep)),
        sweeps_with_contact=len(np.unique(recording.sweep[felt(recording)])),
        six_axis=recording.six_axis,
        left_out=left_out,
        air=tuple((float(clock[a]), float(clock[b - 1])) for a, b in sensed.stretches),
        air_fraction=float(sensed.air.mean()),
        zero=tuple(sensed.zero.mean(axis=0).tolist()),
        drift=tuple(np.ptp(sensed.zero, axis=0).tolist()),
        noise_force_N=recording.noise_force_N,
        noise_moment_Nm=recording.noise_moment_Nm,
        noise_factor=sensed.factor,
        notes=tuple(notes),
    )


def _sensed(log: Log, clock: Array, map: Map, where: str) -> _Sensed:
    """The wrench of a log without the sensor's zero, and filtered if the map says so."""
    zero, air, noise, stretches = _tared(log, clock, map, where)
    wrench = _without_rounding(log.wrench - zero, log.wrench) if zero.any() else log.wrench
    sharp = np.zeros(len(log), dtype=bool)
    if not (map.lowpass_hz or map.rate_hz):
        return _Sensed(wrench, zero, air, stretches, noise, 1.0, sharp, None, [])
    if log.time_s is None:
        raise InputError(f"{where}: [filter] needs the time of the rows; name its column as time under [columns]")
    rate = filtering.sampling_rate(clock, where)
    if not map.lowpass_hz:
        return _Sensed(wrench, zero, air, stretches, noise, 1.0, sharp, rate, [])
    measured = wrench
    wrench = filtering.low_pass(measured, clock, map.lowpass_hz, rate, where)
    blurred = filtering.blurred(measured, wrench, clock, map.lowpass_hz, rate, where)
    factor = filtering.noise_factor(map.lowpass_hz, rate)
    notes = []
    left = factor * noise
    if air.any():
        found = np.where(noise > 0, taring.robust_sd(wrench[air]), 0.0)
        if (found > _COLOURED * left).any():
            notes.append(
                "the filter leaves more noise than it would of white noise; the noise found after it is stated"
            )
        left = np.maximum(left, found)
    return _Sensed(wrench, zero, air, stretches, left, factor, blurred, rate, notes)


def _rate(time: Array | None) -> float | None:
    if time is None or len(time) < 2 or time[-1] == time[0]:
        return None
    return float((len(time) - 1) / (time[-1] - time[0]))


def _tared(log: Log, clock: Array, map: Map, where: str) -> tuple[Array, Mask, Array, list[tuple[int, int]]]:
    """The sensor's zero (n, 6), the rows in the air (n,), the noise (6,) there, and the stretches."""
    if map.air == "none":
        return np.zeros((1, 6)), np.zeros(len(log), dtype=bool), np.zeros(6), []
    if isinstance(map.air, str):
        stretches = find_air(log.wrench, clock, where)
    elif log.time_s is None:
        raise InputError(
            f"{where}: [tare] air in seconds needs the time of the rows; name its column as time under [columns]"
        )
    else:
        stretches = taring.given_air(clock, map.air, where)
    air = taring.tare(log.wrench, clock, stretches)
    return air.zero, air.rows, air.noise, stretches


def _without_rounding(tared: Array, before: Array) -> Array:
    """The tared wrench (n, 6), zero in rows in which all channels are no more than rounding: those would count as forces."""
    largest = np.repeat([np.abs(before[:, :3]).max(), np.abs(before[:, 3:]).max()], 3)
    nothing: Mask = np.asarray((np.abs(tared) <= _ROUNDING * largest).all(axis=1))
    return np.where(nothing[:, None], 0.0, tared) if nothing.any() else tared


def _sweeps(log: Log, position: Array, quaternion: Array, map: Map) -> tuple[NDArray[np.int64], Mask]:
    """Number of the sweep (n,) of each row, -1 outside, and rows (n,) of strokes along +x that count as sweeps."""
    none = np.zeros(len(log), dtype=bool)
    if log.sweep is not None or log.sweeping is not None:
        if log.sweep is None:
            assert log.sweeping is not None
            sweep = segments.runs_of(log.sweeping)
        else:
            sweep = log.sweep if log.sweeping is None else segments.numbered(log.sweep, log.sweeping)
        if map.directions == "both":
            numbers = np.unique(sweep[sweep >= 0])
            back = numbers[segments.travel_angles(sweep, position, quaternion) > np.pi / 2]
            none = np.isin(sweep, back)
        return sweep, none
    found = segments.strokes(position, quaternion, map.rod.length_m)
    if map.directions == "both":
        return found.sweep, (found.sweep >= 0) & np.append(found.backwards, False)[found.sweep]
    number = np.append(np.where(found.backwards, -1, np.cumsum(~found.backwards) - 1), -1)
    return number[found.sweep], none


def _without_transfers(
    sweep: NDArray[np.int64], log: Log, wrench: Array, position: Array, quaternion: Array, map: Map, noise: float
) -> tuple[NDArray[np.int64], list[str]]:
    """The numbers of the sweeps (n,) without strokes found by motion that touch nothing and may be out of reach, and a note."""
    if log.sweep is not None or log.sweeping is not None:
        return sweep, []
    touched = stands_out(wrench[:, :3], noise)
    within = segments.with_rows(sweep, touched)
    left = segments.transfers(sweep, within, position, quaternion, map.rod.length_m)
    if not len(left) or not len(within):
        return sweep, []
    kept = np.where(np.isin(sweep, left), -1, sweep)
    numbers = np.unique(kept[kept >= 0])
    renumbered = np.where(kept >= 0, np.searchsorted(numbers, kept), -1)
    return renumbered, [
        f"{len(left)} strokes without contact are left out, because the rod may have been out of the body's reach; if they are "
        "sweeps, number them in a column and name it as sweep under [columns]"
    ]


def _clamp_wrench(wrench: Array, present: Mask, sensor: Frame, where: str) -> tuple[Array, Mask]:
    """The wrench (n, 6) in the clamp's frame, and which of its channels (6,) the sensor's channels determine.

    Raises InputError if fx, fy and mz of the clamp are not among them, with the channel that is missing.
    """
    matrix = wrench_matrix(sensor.turn, sensor.position_m)
    scale = np.abs(matrix).max(axis=1, keepdims=True)
    needed = np.abs(matrix) > _TURN_ROUNDING * scale
    known: Mask = ~(needed & ~present).any(axis=1)
    for channel in (0, 1, 5):
        if not known[channel]:
            absent = ", ".join(CHANNELS[k] for k in np.flatnonzero(needed[channel] & ~present))
            raise InputError(
                f"{where}: {CHANNELS[channel]} of the clamp needs {absent} of the sensor as well, because [sensor] turns or "
                "moves it; add the column, or give the wrench in the clamp's frame"
            )
    if sensor.trivial:
        return wrench, known
    return np.where(known, wrench @ matrix.T, 0.0), known


def _clamp_noise(noise: Array, map: Map, known: Mask) -> tuple[float, float]:
    """Standard deviations of force and moment in the clamp's frame: the largest of their channels."""
    variance = wrench_matrix(map.sensor.turn, map.sensor.position_m) ** 2 @ noise**2
    deviation = np.sqrt(np.where(known, variance, 0.0))
    force = float(deviation[:3].max()) if map.noise_force_N is None else map.noise_force_N
    moment = float(deviation[3:].max()) if map.noise_moment_Nm is None else map.noise_moment_Nm
    return force, moment


class _Rows(NamedTuple):
    """The rows of a recording."""

    sweep: NDArray[np.int64]
    position: Array
    quaternion: Array
    wrench: Array
    """(n, 6) in the clamp's frame."""


def _recording(table: RawTable, map: Map, rows: _Rows, six_axis: bool, noise: tuple[float, float]) -> Recording:
    force, moment = rows.wrench[:, :3], rows.wrench[:, 3:]
    source = {"kind": KIND, "table": table.name, "table_sha256": table.sha256, "map": dict(map.text)}
    recording = Recording(
        sweep=rows.sweep,
        position_m=rows.position,
        quaternion=rows.quaternion,
        force_N=force[:, :2],
        moment_Nm=moment[:, 2],
        rod=map.rod,
        noise_force_N=noise[0],
        noise_moment_Nm=noise[1],
        noise_pose_m=map.noise_pose_m or 0.0,
        unit=map.unit,
        table_m=map.table_m,
        source=source | ({"rig": dict(map.rig), "calibrated": True} if map.rig else {}),
        rig=map.uncertainty,
    )
    if not six_axis:
        return recording
    return replace(recording, force_z_N=force[:, 2], moment_x_Nm=moment[:, 0], moment_y_Nm=moment[:, 1])
