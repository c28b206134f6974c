"""Logs of a rig in which something was not measured: is it seen, is it named, and is anything false that is certified?

    python -m tests.robustness.unmeasured_rows [--count 300] [--first 0] [--faults stopped jumps] [--verbose]

Each seed is a random body whose log has noise, a bias and a drift, and one of the faults below, at a random place, in a random
channel, of a random length: half of them in the log before the import, half in the recording that it gives.  Every false
statement is printed with its seed, and every fault that is not named; then a table.  Fails if a statement is false, if fewer
than 95 % of the faults are named, or if a log without a fault is said to have one.
"""

from __future__ import annotations

import collections
import functools
import sys
from dataclasses import replace
from typing import NamedTuple

import numpy as np

import scan3d
from scan3d.errors import InputError
from scan3d.files.tables import Table
from scan3d.laboratory.importing import convert
from scan3d.laboratory.maps import read_map
from scan3d.pipeline import analyse
from scan3d.planning.rig import RigPlan, parse_envelope, plan_poses
from scan3d.simulation.rig import Faults, Size, simulate_rig, standing
from tests.raw_tables import si_map
from tests.rigs import with_wrench
from tests.robustness import options
from tests.robustness.bounds import false_statements
from tests.robustness.faults import body

NAMES = ("t", "x", "y", "z", "qw", "qx", "qy", "qz", "fx", "fy", "fz", "mx", "my", "mz")
ROD = scan3d.Rod(0.06, 8.35e-5)


class Rows(NamedTuple):
    """What a log or a recording has in its rows."""

    pose: np.ndarray
    """(n, 7)"""
    wrench: np.ndarray
    """(n, 6)"""


def stretches(draw, count):
    """A mask of rows: one stretch, which may last to the end, or several."""
    rows, length = np.zeros(count, dtype=bool), int(count * 10 ** draw.uniform(-2, -0.4))
    for _ in range(int(draw.integers(1, 4))):
        start = int(draw.integers(count // 20, count - length))
        rows[start : count if draw.uniform() < 0.3 else start + length] = True
    return rows


def kept(values, rows):
    """Values (n, k) that stay in some rows what they were before."""
    last = np.maximum.accumulate(np.where(rows, 0, np.arange(len(rows))))
    return values[last]


def stopped(rows, draw):
    return rows._replace(wrench=kept(rows.wrench, stretches(draw, len(rows.pose))))


def frozen(rows, draw):
    wrench, channel = rows.wrench.copy(), draw.choice([0, 1, 5])
    wrench[:, channel] = kept(wrench[:, [channel]], stretches(draw, len(wrench)))[:, 0]
    return rows._replace(wrench=wrench)


def zeros(rows, draw):
    return rows._replace(wrench=np.where(stretches(draw, len(rows.pose))[:, None], 0.0, rows.wrench))


def saturated(rows, draw):
    level = np.median(rows.wrench, axis=0)
    limit = draw.uniform(0.4, 0.9) * np.abs(rows.wrench - level).max(axis=0)
    chosen = np.isin(np.arange(6), draw.choice([0, 1, 5], int(draw.integers(1, 4)), replace=False))
    limited = level + np.clip(rows.wrench - level, -limit, limit)
    return rows._replace(wrench=np.where(chosen, limited, rows.wrench))


def jumps(rows, draw):
    wrench, reach = rows.wrench.copy(), np.ptp(rows.wrench, axis=0)
    for _ in range(int(draw.integers(1, 4))):
        start = int(draw.integers(len(wrench) // 10, 9 * len(wrench) // 10))
        wrench[start:] += 10 ** draw.uniform(-1.5, -0.3) * reach * draw.uniform(-1, 1, 6)
    return rows._replace(wrench=wrench)


def held(rows, draw):
    every = int(draw.integers(3, 15))
    return rows._replace(pose=rows.pose[np.arange(len(rows.pose)) // every * every])


def slower(rows, draw):
    """A sensor that is not in step with its log."""
    every, row = draw.uniform(1.3, 12), np.arange(len(rows.wrench))
    return rows._replace(wrench=rows.wrench[(row // every * every).astype(int)])


def paused(rows, draw):
    return rows._replace(pose=kept(rows.pose, stretches(draw, len(rows.pose))))


RIGHT = ("none", "coarse")
"""No fault: a good rig, and one with the steps of a converter, 1/f noise, a drift that wanders, lag, jitter and lost rows."""
FAULTS = {
    "none": (lambda rows, draw: rows, ()),
    "coarse": (lambda rows, draw: rows, ("keeps", "saturates", "jumps", "slower", "the poses change", "is held")),
    "stopped": (stopped, ("keeps",)),
    "slower": (slower, ("slower",)),
    "frozen": (frozen, ("keeps",)),
    "zeros": (zeros, ("keeps",)),
    "saturated": (saturated, ("saturates",)),
    "jumps": (jumps, ("jumps",)),
    "held": (held, ("the poses change",)),
    "paused": (paused, ("is held", "the poses change")),
}
"""What is done to the rows, and the words of which one names it."""


@functools.lru_cache(8)
def logged(seed, coarse=False, rate=40, samples=16, slices=5):
    """The body, and the log of a rig that sweeps past it; `coarse`: of a rig that is less good."""
    mesh, draw = standing(body(seed)), np.random.default_rng([seed, 61])
    width, height = 1.15 * np.hypot(*mesh.extents[:2]), 1.05 * mesh.extents[2]
    plan = RigPlan(
        parse_envelope(f"cylinder:{width:.4g}x{height:.4g}"), "planar", rod=ROD, samples=samples, slices=slices
    )
    size = 10 ** draw.uniform(-3.5, -2.5)
    faults = Faults(
        seed=seed, rate_hz=rate, bias=Size(fraction=0.05), drift=Size(fraction=0.01), noise=Size(fraction=size)
    )
    if coarse:
        sizes = {name: Size(fraction=float(draw.choice([0, 1e-4, 1e-3, 5e-3]))) for name in ("quantum", "pink")}
        lost = {"missing": float(draw.choice([0, 0.01])), "gap_ms": 50.0, "lag_ms": float(draw.choice([0, 10]))}
        poses = {"quantum_um": float(draw.choice([0, 1, 20])), "jitter_um": float(draw.choice([0, 20]))}
        faults = replace(faults, drift_kind=str(draw.choice(["linear", "random-walk"])), **sizes, **lost, **poses)
    friction = draw.uniform(0, 0.4)
    return mesh, simulate_rig(mesh, plan_poses(plan), faults=faults, friction=(friction, friction), seed=seed)


def imported(log, rows, named=True):
    """The recording of a log with other rows, and the notes on it; `named`: whether the column of the sweeps is."""
    columns = (log.time_s, *rows.pose.T, *rows.wrench.T, np.asarray(log.sweep, dtype=float))
    sections = si_map(log.rod, tare={"air": "auto"}, table_height_m=0.0)
    sections["columns"]["time"], sections["units"]["time"] = "t", "s"
    if not named:
        del sections["columns"]["sweep"]
    found = convert(Table("log.csv", (*NAMES, "sweep"), columns), read_map(sections))
    return found.recording, found.summary.notes


class Outcome(NamedTuple):
    false: list
    named: bool
    certified: bool
    said: str


def outcome(seed, name, of_log):
    """What is said of a log with a fault, and what of that is false."""
    mesh, log = logged(seed, name == "coarse")
    draw, (change, words) = np.random.default_rng([seed, 62, list(FAULTS).index(name)]), FAULTS[name]
    rows = Rows(np.hstack([log.position_m, log.quaternion]), log.wrench)
    try:
        recording, notes = imported(log, change(rows, draw) if of_log else rows)
        if not of_log:
            pose = np.hstack([recording.position_m, recording.quaternion])
            changed = change(Rows(pose, np.hstack(recording.wrench())), draw)
            recording = replace(recording, position_m=changed.pose[:, :3], quaternion=changed.pose[:, 3:])
            recording = with_wrench(recording, *np.hsplit(changed.wrench, 2))
        analysis = analyse(recording, mesh, "hull", "planar")
    except InputError as error:
        return Outcome([], any(word in str(error) for word in words), False, f"refused: {error}")
    missing = analysis.cloud.unmeasured
    said = [*notes, *(missing.words if missing else ()), *(warning.message for warning in analysis.warnings)]
    said += [analysis.diagnosis.message] if analysis.diagnosis else []
    certified = bool(np.isfinite(analysis.certificate.bound))
    false = [] if analysis.warnings else false_statements(mesh, analysis)
    return Outcome(false, any(word in text for word in words for text in said), certified, " | ".join(said))


def main() -> int:
    given = options(__doc__, count=300, first=0, faults=[""], verbose=False)
    names = [name for name in FAULTS if name.startswith(tuple(given.faults))]
    rows = collections.defaultdict(list)
    for seed in range(given.first, given.first + given.count):
        name, of_log = names[seed % len(names)], seed // len(names) % 2 == 0
        found = outcome(seed, name, of_log)
        rows[name, of_log].append(found)
        wrong = found.false or found.named == (name in RIGHT) or (name == "none" and found.said)
        if wrong or given.verbose:
            print(f"seed {seed}, {name}, {'log' if of_log else 'recording'}: {found}", flush=True)
    print("fault       of           number  false  named  certified")
    for (name, of_log), found in rows.items():
        counts = (
            len(found),
            *(sum(map(bool, column)) for column in ([o.false for o in found], [o.named for o in found])),
        )
        certified = sum(one.certified for one in found)
        print(f"{name:11} {'log' if of_log else 'recording':11}" + "".join(f"{one:7}" for one in (*counts, certified)))
    faulty = [one for (name, _), found in rows.items() if name not in RIGHT for one in found]
    clean = [one for (name, _), found in rows.items() if name in RIGHT for one in found]
    false = any(one.false for one in (*faulty, *clean)) or any(one.named for one in clean)
    false |= any(one.said for (name, _), found in rows.items() if name == "none" for one in found)
    return int(false or sum(one.named for one in faulty) < 0.95 * len(faulty))


if __name__ == "__main__":
    sys.exit(main())
