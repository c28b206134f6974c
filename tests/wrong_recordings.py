"""Wrong recordings, made from right ones.

Signs, axes, units, scales, offsets, drift, delay, stuck and shuffled rows, wrong poses, a wrong rod.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.recording import Recording
from scan3d.rods import Rod
from tests.rigs import with_wrench

Fault = Callable[[Recording], Recording]


def scaled(force_x=1.0, force_y=1.0, moment=1.0):
    return lambda r: replace(r, force_N=r.force_N * [force_x, force_y], moment_Nm=r.moment_Nm * moment)


def turned(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return lambda r: replace(r, force_N=r.force_N @ np.array([[c, s], [-s, c]]))


def offset(force_x=0.0, force_y=0.0, moment=0.0):
    """A zero that is off by fractions of the observable units EI/L² and EI/L."""
    return lambda r: replace(
        r,
        force_N=r.force_N + np.array([force_x, force_y]) * r.rod.force_unit_N,
        moment_Nm=r.moment_Nm + moment * r.rod.moment_unit_Nm,
    )


def drift(amount):
    """A zero that runs away by a fraction of the observable units from the first to the last row."""

    def wrong(r):
        time = np.linspace(0, amount, len(r))
        force = r.force_N + np.outer(time, [1.0, 0.6]) * r.rod.force_unit_N
        return replace(r, force_N=force, moment_Nm=r.moment_Nm + 0.5 * time * r.rod.moment_unit_Nm)

    return wrong


def delayed(rows, moment_only=False):
    return lambda r: replace(
        r,
        force_N=r.force_N if moment_only else np.roll(r.force_N, rows, axis=0),
        moment_Nm=np.roll(r.moment_Nm, rows),
    )


def stuck(rows):
    """Successive rows that repeat the reactions of the first of them, under a force."""

    def wrong(r):
        force, moment = r.force_N.copy(), r.moment_Nm.copy()
        size = np.hypot(*force.T)
        start = np.flatnonzero(size > 0.3 * size.max())[len(size) // 7]
        force[start : start + rows], moment[start : start + rows] = force[start], moment[start]
        return replace(r, force_N=force, moment_Nm=moment)

    return wrong


def interleaved(r):
    other = np.arange(len(r))
    half = len(r) // 2
    first = np.arange(0, half, 2)
    other[first], other[first + half] = first + half, first
    return replace(r, force_N=r.force_N[other], moment_Nm=r.moment_Nm[other])


def shuffled(r):
    sweeps = np.unique(r.sweep)
    order = np.concatenate(
        [np.flatnonzero(r.sweep == number) for number in np.random.default_rng(1).permutation(sweeps)]
    )
    return replace(r, force_N=r.force_N[order], moment_Nm=r.moment_Nm[order])


def rod(length=1.0, stiffness=1.0):
    return lambda r: replace(r, rod=Rod(length * r.rod.length_m, stiffness * r.rod.bending_stiffness_Nm2))


def positions(matrix):
    return lambda r: replace(r, position_m=r.position_m @ np.asarray(matrix, dtype=float))


FAULTS: dict[str, Fault] = {
    "fx of the other sign": scaled(-1, 1, 1),
    "fy of the other sign": scaled(1, -1, 1),
    "mz of the other sign": scaled(1, 1, -1),
    "forces of the other sign": scaled(-1, -1, 1),
    "fx and mz of the other sign": scaled(-1, 1, -1),
    "fy and mz of the other sign": scaled(1, -1, -1),
    "wrench of the other sign": scaled(-1, -1, -1),
    "fx and fy exchanged": lambda r: replace(r, force_N=r.force_N[:, ::-1]),
    "sensor turned by 5 degrees": turned(5),
    "sensor turned by -30 degrees": turned(-30),
    "sensor turned by 90 degrees": turned(90),
    "wrench doubled": scaled(2, 2, 2),
    "wrench halved": scaled(0.5, 0.5, 0.5),
    "wrench 5 % too large": scaled(1.05, 1.05, 1.05),
    "moment 10 % too large": scaled(1, 1, 1.1),
    "moment 10 % too small": scaled(1, 1, 0.9),
    "moment 2 % too large": scaled(1, 1, 1.02),
    "forces 10 % too large": scaled(1.1, 1.1, 1),
    "forces 10 % too small": scaled(0.9, 0.9, 1),
    "fy 10 % too large": scaled(1, 1.1, 1),
    "moment in N mm": scaled(1, 1, 1e3),
    "forces in mN": scaled(1e3, 1e3, 1),
    "forces in kN": scaled(1e-3, 1e-3, 1),
    "fx off by 1 %": offset(force_x=0.01),
    "fx off by -1 %": offset(force_x=-0.01),
    "fy off by 1 %": offset(force_y=0.01),
    "mz off by 1 %": offset(moment=0.01),
    "mz off by -1 %": offset(moment=-0.01),
    "everything off by 10 %": offset(0.1, 0.1, 0.1),
    "drift of 2 %": drift(0.02),
    "drift of -10 %": drift(-0.1),
    "delay of 1 row": delayed(1),
    "delay of 20 rows": delayed(20),
    "moment delayed by 1 row": delayed(1, moment_only=True),
    "20 stuck rows": stuck(20),
    "60 stuck rows": stuck(60),
    "300 stuck rows": stuck(300),
    "interleaved": interleaved,
    "sweeps shuffled": shuffled,
    "quaternions with qw last": lambda r: replace(r, quaternion=r.quaternion[:, [1, 2, 3, 0]]),
    "quaternions conjugated": lambda r: replace(r, quaternion=r.quaternion * [1, -1, -1, -1]),
    "positions in mm": positions(1e3 * np.eye(3)),
    "x of the other sign": positions(np.diag([-1, 1, 1])),
    "y and z exchanged": positions([[1, 0, 0], [0, 0, 1], [0, 1, 0]]),
    "rod 10 % too long": rod(length=1.1),
    "rod twice as stiff": rod(stiffness=2.0),
}


def changed(recording, change):
    """A six-axis recording with force and moment (n, 3) changed by a function of both."""
    return with_wrench(recording, *change(*recording.wrench()))


def sensor(euler_deg=(0, 0, 0), place_mm=(0, 0, 0)):
    """A sensor that is turned in the clamp's frame, and shows the moment about a place beside the clamp."""
    back = Rotation.from_euler("xyz", euler_deg, degrees=True).inv()
    return lambda f, m: (back.apply(f), back.apply(m - np.cross(np.array(place_mm) / 1000, f)))


def second_contact(f, m):
    """A further force of a tenth, across the rod at a third of its 50 mm."""
    size = 0.1 * np.linalg.norm(f, axis=1)
    extra = np.stack([size, 0 * size, size], axis=1)
    return f + extra, m + np.cross([0, 0.05 / 3, 0], extra)


IN_SPACE = {
    "signs of the wrench": lambda f, m: (-f, -m),
    "signs of the forces": lambda f, m: (-f, m),
    "sign of fx": lambda f, m: (f * [-1, 1, 1], m),
    "sign of fy": lambda f, m: (f * [1, -1, 1], m),
    "sign of fz": lambda f, m: (f * [1, 1, -1], m),
    "sign of mx": lambda f, m: (f, m * [-1, 1, 1]),
    "sign of mz": lambda f, m: (f, m * [1, 1, -1]),
    "left-handed": lambda f, m: (f * [1, 1, -1], m * [-1, -1, 1]),
    "N mm": lambda f, m: (f, 1000 * m),
    "mN": lambda f, m: (1000 * f, m),
    "fx and fz exchanged": lambda f, m: (f[:, ::-1], m),
    "axes y and z exchanged": lambda f, m: (f[:, [0, 2, 1]], m[:, [0, 2, 1]]),
    "untared": lambda f, m: (f + 0.01 * np.abs(f).max(), m + 0.01 * np.abs(m).max()),
    "gain of fz": lambda f, m: (f * [1, 1, 1.1], m),
    "wrench doubled": lambda f, m: (2 * f, 2 * m),
    "misaligned": sensor((1.7, 0, 1.1)),
    "turned about x": sensor((20, 0, 0)),
    "turned about the rod": sensor((0, 30, 0)),
    "turned about z": sensor((0, 0, -10)),
    "lever arm": sensor(place_mm=(2, 0, 0)),
    "offset": sensor(place_mm=(3, -20, 4)),
    "offset along the rod": sensor(place_mm=(0, -20, 0)),
    "late by two samples": lambda f, m: (np.roll(f, 2, axis=0), np.roll(m, 2, axis=0)),
    "a second contact": second_contact,
}
