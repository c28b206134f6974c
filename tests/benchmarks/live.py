"""How long a row takes until its contact is known.

    python tests/benchmarks/live.py

Rows of simulated scans of an egg are pushed one by one into `scan3d.Live`, on one core.  Times are those of the wall clock, in
milliseconds: the median, and the fastest hundredth, which other programs disturb least.
"""

from __future__ import annotations

import itertools
import time
from pathlib import Path

import numpy as np

import scan3d

EGG = Path(__file__).resolve().parents[2] / "meshes" / "egg.stl"
RODS = {"straight": None, "tapered": scan3d.Rod(0.06, 2e-4, 0.0004, tip_diameter_m=0.0002)}


def latencies(model: str, rod: scan3d.Rod | None, rows: int) -> dict[str, np.ndarray]:
    """Milliseconds of the rows in each state."""
    # only uniform rods are simulated in space
    plan = scan3d.Plan(slices=4, sweeps=4, samples=60, model="planar" if rod else model, rod=rod, noise=1e-4)
    recording = scan3d.simulate(scan3d.load_mesh(EGG), plan)
    live, zero = scan3d.Live(recording, model=model), np.zeros(len(recording))
    wrench = np.column_stack([recording.force_N, zero, zero, zero, recording.moment_Nm])
    if recording.six_axis:
        wrench = np.hstack(recording.wrench())
    taken, states = [], []
    for k in range(min(rows, len(recording))):
        start = time.perf_counter()
        live.push(0.01 * k, recording.position_m[k], recording.quaternion[k], wrench[k])
        taken.append(1e3 * (time.perf_counter() - start))
        states.append(live.state)
    return {state: np.array(taken)[np.array(states) == state] for state in sorted(set(states))}


def main() -> None:
    print(f"{'rod':10}{'model':10}{'state':12}{'rows':>6}{'median':>10}{'fastest':>10}")
    for name, model, rows in itertools.product(RODS, ("planar", "spatial"), (300,)):
        for state, taken in latencies(model, RODS[name], rows).items():
            median, fastest = np.median(taken), np.percentile(taken, 1)
            print(f"{name:10}{model:10}{state:12}{len(taken):6}{median:8.2f} ms{fastest:7.2f} ms")


if __name__ == "__main__":
    main()
