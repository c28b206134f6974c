"""Tables as a rig writes them, made from recordings: the inverse of what `scan3d.laboratory` does, written separately."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from scan3d.files.text import rod_section
from tests.rig_errors import six_axis

RATE_HZ = 1000.0


class Rig(NamedTuple):
    """What is wrong with a sensor and how it stands."""

    turn_deg: tuple = (0.0, 30.0, 0.0)
    position_mm: tuple = (0.0, -20.0, 0.0)
    shows: str = "clamp-on-rod"
    bias: float = 0.05
    """Of each channel, over its largest reaction."""
    drift: float = 0.01
    """Over the log, likewise."""
    noise: float = 0.0
    seed: int = 0


class Track(NamedTuple):
    """A continuous log: poses and reactions in the clamp's frame, and the row of the recording (-1 between sweeps)."""

    time: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    wrench: np.ndarray
    row: np.ndarray
    move: np.ndarray


def track(recording, air=40, lift_m=0.004):
    """The sweeps of a recording at 1 kHz, each with approach and retract along the rod, and transfers between them."""
    wrench = np.hstack(six_axis(recording).wrench())
    axes = recording.axes()
    parts, last = [], None
    for number in dict.fromkeys(recording.sweep.tolist()):
        rows = np.flatnonzero(recording.sweep == number)
        first, end = rows[0], rows[-1]
        up = np.linspace(1, 0, air, endpoint=False)[:, None] * lift_m
        down = np.linspace(0, 1, air + 1)[1:, None] * lift_m
        begin = recording.position_m[first] - up * axes[first, 1]
        away = recording.position_m[end] - down * axes[end, 1]
        if last is not None:
            parts.append(_transfer(*last, begin[0], recording.quaternion[first], air))
        fade = np.clip(np.linspace(1, -3, air), 0, 1)[:, None]
        parts.append((begin, _same(recording.quaternion[first], air), np.zeros((air, 6)), np.full(air, -1), "approach"))
        parts.append((recording.position_m[rows], recording.quaternion[rows], wrench[rows], rows, "sweep"))
        parts.append((away, _same(recording.quaternion[end], air), fade * wrench[end], np.full(air, -1), "retract"))
        last = away[-1], recording.quaternion[end]
    columns = [np.concatenate([part[k] for part in parts]) for k in range(4)]
    move = np.concatenate([np.full(len(part[0]), part[4]) for part in parts])
    return Track(np.arange(len(move)) / RATE_HZ, *columns, move)


def _same(quaternion, count):
    return np.repeat(quaternion[None], count, axis=0)


def _transfer(position, quaternion, to, turned, count):
    part = np.linspace(0, 1, count + 2)[1:-1]
    # over a detour, so that it is no stroke in the plane of a sweep
    place = position + part[:, None] * (to - position) + 0.003 * np.sin(np.pi * part)[:, None] * [0.3, 0.4, 0.8]
    turn = Slerp([0, 1], Rotation.from_quat([quaternion, turned], scalar_first=True))(part)
    return place, turn.as_quat(scalar_first=True), np.zeros((count, 6)), np.full(count, -1), "approach"


def sensed(wrench, rig):
    """What the sensor of a rig shows (n, 6) for reactions in the clamp's frame: moments about its origin, in its axes."""
    turn = Rotation.from_euler("xyz", rig.turn_deg, degrees=True)
    arm = np.array(rig.position_mm) * 1e-3
    force, moment = wrench[:, :3], wrench[:, 3:]
    # the moment about the sensor's origin is that about the clamp's plus the arm from the sensor to the clamp times the force
    moment = moment + np.cross(-arm, force)
    shown = np.concatenate([turn.inv().apply(force), turn.inv().apply(moment)], axis=1)
    return -shown if rig.shows == "rod-on-clamp" else shown


def disturbed(shown, rig):
    """A sensor's values with bias, a drift that grows evenly, and white noise; and the standard deviations (6,)."""
    rng = np.random.default_rng(rig.seed)
    largest = np.repeat([np.abs(shown[:, :3]).max(), np.abs(shown[:, 3:]).max()], 3)
    signs = np.array([1.0, -1.0, 0.7, -0.6, 1.0, 0.8])
    time = np.linspace(0, 1, len(shown))[:, None]
    noise = rig.noise * largest
    return shown + largest * signs * (rig.bias + rig.drift * time) + noise * rng.standard_normal(shown.shape), noise


def table(log, rig, euler="xyz"):
    """Columns of a table by name: s, mm, Euler angles in deg, N and N mm."""
    values, _ = disturbed(sensed(log.wrench, rig), rig)
    angles = Rotation.from_quat(log.quaternion, scalar_first=True).as_euler(euler, degrees=True)
    names = ["t", "x", "y", "z", "a", "b", "c", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz"]
    columns = [log.time, *(1e3 * log.position.T), *angles.T, *values[:, :3].T, *(1e3 * values[:, 3:].T)]
    return dict(zip(names, columns, strict=True))


def write(path, columns, delimiter=",", decimal="."):
    lines = [delimiter.join(columns)]
    for row in zip(*(column.tolist() for column in columns.values()), strict=True):
        cells = (cell if isinstance(cell, str) else repr(cell).replace(".", decimal) for cell in row)
        lines.append(delimiter.join(cells))
    path.write_text("\n".join(lines) + "\n")
    return path


POSED = "sweep,x,y,z,qw,qx,qy,qz"
"""Columns of a table as `si_map` has them, but for the reactions."""


def write_numbers(path, header, *columns):
    """Write columns (n,) or (n, k) as text, without losing a digit."""
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.17g")
    return path


def si_map(rod, force=("fx", "fy", "fz"), moment=("mx", "my", "mz"), /, **sections):
    """The map of a tared table in SI units with the poses of the clamp; `sections` replace or add sections."""
    _, *position, w, x, y, z = POSED.split(",")
    columns = {"sweep": "sweep", "position": position, "orientation": {"quaternion": [w, x, y, z]}}
    data = {
        "columns": columns | {"force": list(force), "moment": list(moment)},
        "units": {"length": "m", "force": "N", "moment": "N m"},
        "tare": {"air": "none"},
        "rod": rod_section(rod),
    }
    return data | sections


def map_of(rod, rig, euler="xyz", **sections):
    """The map of such a table, as the contents of its TOML file; `sections` replace or add sections."""
    data = {
        "columns": {
            "time": "t",
            "position": ["x", "y", "z"],
            "orientation": {"euler": ["a", "b", "c"], "convention": euler},
            "force": ["Fx", "Fy", "Fz"],
            "moment": ["Tx", "Ty", "Tz"],
        },
        "units": {"time": "s", "length": "mm", "angle": "deg", "force": "N", "moment": "N mm"},
        "sensor": {"position_mm": list(rig.position_mm), "euler_deg": list(rig.turn_deg), "shows": rig.shows},
        "rod": rod_section(rod),
    }
    return data | sections
