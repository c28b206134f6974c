"""The whole loop at a computed rig: is the body found, and does the bound hold?

    python -m tests.robustness.loops [--bodies egg.stl cube.stl] [--count 20] [--first 0] [--batches 3] [--model planar]

Each seed calibrates the rig of `examples/rig_loop.py` on a reference sphere, and then lets a `scan3d.Session` ask for sweeps of
the body, in batches, until `--batches` are measured.  The rig has the faults of a good one: force noise of 0.2 % of the largest
force, a sensor turned by 30° and 20 mm away, a bias of 5 %, a drift of 1 %, and poses that jitter by 20 µm.  For each seed a
row has the true error of the surface, that of the same touches without faults, their ratio, the error of the convex hull of
the same exact touches and the ratio to it, the certified 95 % bound, and whether it holds.  At the end of a body: the medians,
and in how many seeds the bound holds.  Fails if a bound fails in more than 5 % of the seeds of a body.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import scan3d
from scan3d.simulation.rig import simulate_rig, standing

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "examples"))
import rig_loop  # noqa: E402

BODIES = ("egg.stl", "pebble.obj", "cube.stl", "cylinder.off")
# By how much the bounding cylinder is larger than the body.
AROUND = 1.15
FRICTION = (0.3, 0.3)


def envelope(truth):
    """Text of a cylinder about a body that stands on the table."""
    radius = np.hypot(*truth.vertices[:, :2].T).max()
    return f"cylinder:{2 * AROUND * radius:.4g}x{AROUND * truth.extents[2]:.4g}"


def session_of(truth, model):
    if model == "planar":
        return scan3d.Session(envelope(truth), rig_loop.ROD, slices=8, samples=64)
    return scan3d.Session(envelope(truth), rig_loop.ROD, "spatial", slices=4, samples=64)


def loop(session, touch, batches):
    """The poses that a session asked for, batch by batch."""
    asked = []
    while len(asked) < batches and (poses := session.ask()) is not None:
        session.tell(touch(poses))
        asked.append(poses)
    return asked


def exact(truth, poses):
    """What the rig without faults measures at poses."""
    return simulate_rig(truth, poses, friction=FRICTION).recording()


def without_faults(truth, asked):
    """Errors of the surface and of the hull of the same touches without faults."""
    session = session_of(truth, asked[0].model)
    for poses in asked:
        session.tell(exact(truth, poses))
    hull = scan3d.surface(session.cloud, "hull")
    return scan3d.compare(session.surface, truth).hausdorff, scan3d.compare(hull, truth).hausdorff


def with_faults(path, truth, model, seed, batches):
    """One seed: its row."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rig = rig_loop.calibrated(folder, 100_000 * (seed + 1))
        seeds = iter(range(1000 * (seed + 1), 1000 * (seed + 2)))
        session = session_of(truth, model)
        asked = loop(
            session,
            lambda poses: scan3d.import_table(*rig_loop.log(path, poses, folder, next(seeds)), rig),
            batches,
        )
        error = scan3d.compare(session.surface, truth).hausdorff
        bound = session.certificate.bound
        sweeps = len(np.unique(session.recording.sweep))
        warned = [warning.code for warning in session.warnings]
    right, hull = without_faults(truth, asked)
    return sweeps, error, right, hull, bound, warned


def measure(name, seeds, model, batches):
    """All seeds of a body.  Returns the number of bounds that fail."""
    path = ROOT / "meshes" / name
    truth = standing(scan3d.load_mesh(path))
    diagonal = float(np.linalg.norm(truth.extents))
    print(f"{name}, {model}: diagonal {diagonal:.4g} mm; errors and bounds in mm")
    print(
        f"{'seed':>5} {'sweeps':>6} {'error':>9} {'exact':>9} {'ratio':>7} {'hull':>9} {'ratio':>7} {'bound':>9} holds"
    )
    rows = []
    for seed in seeds:
        start = time.time()
        sweeps, error, right, hull, bound, warned = with_faults(path, truth, model, seed, batches)
        rows.append((sweeps, error, right, error / right, hull, error / hull, bound, error <= bound))
        print(
            f"{seed:5} {sweeps:6} {error:9.4f} {right:9.3g} {error / right:7.3g} {hull:9.3g} {error / hull:7.3g} {bound:9.4f} "
            f"{'yes' if error <= bound else 'NO'} {' '.join(warned)} {time.time() - start:.0f} s",
            flush=True,
        )
    table = np.array(rows, float)
    print("median" + "".join(f" {value:9.3g}" for value in np.median(table, axis=0)))
    failed = int((table[:, -1] == 0).sum())
    print(f"the bound holds in {len(rows) - failed} of {len(rows)} seeds")
    return failed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bodies", nargs="+", default=BODIES, help="files of meshes")
    parser.add_argument("--count", type=int, default=20, help="seeds of each body (default 20)")
    parser.add_argument("--first", type=int, default=0, help="first seed (default 0)")
    parser.add_argument("--batches", type=int, default=3, help="batches of sweeps (default 3)")
    parser.add_argument("--model", default="planar", choices=("planar", "spatial"))
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.count)
    failed = [measure(name, seeds, given.model, given.batches) for name in given.bodies]
    return int(max(failed) > 0.05 * given.count)


if __name__ == "__main__":
    sys.exit(main())
