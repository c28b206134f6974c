"""How does the bound shrink, from the calibration of a rig to the last sweep?

The whole loop with a computed rig: it touches a reference sphere and is calibrated, then it sweeps an egg that only the rig
knows, in batches that `scan3d.Session` asks for.  The rig has the faults of a good one: force noise of 0.2 % of the largest
force, a sensor that is turned by 30° and 20 mm away, of which the map says nothing, a bias of 5 %, a drift of 1 %, and poses
that jitter by 20 µm.  Each log is a table, which is imported with the calibration.  The same touches without faults are drawn
for comparison.

    python examples/rig_loop.py [--out FILE] [--quick]

Reference: JCGM 100:2008, Evaluation of measurement data: Guide to the expression of uncertainty in measurement (calibration and
its uncertainty); docs/rig.md and docs/calibration.md for the faults and the equations.
"""

import argparse
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import trimesh
from matplotlib import rc_context
from matplotlib.figure import Figure
from paper_figure_3 import STYLE

import scan3d
from scan3d.cli import main as command
from scan3d.files.recordings import write_poses
from scan3d.planning.rig import RigPlan, parse_envelope, plan_poses
from scan3d.poses import PoseList
from scan3d.simulation.rig import simulate_rig, standing

EGG = Path(__file__).parents[1] / "meshes" / "egg.stl"
ROD = scan3d.Rod(length_m=0.06, bending_stiffness_Nm2=1.9e-4, diameter_m=0.0003)
FAULTS = """rate_hz = 100
sensor = {position_mm = [0, -20, 0], euler_deg = [0, 30, 0]}
bias = {fraction = 0.05}
drift = {fraction = 0.01}
noise = {fraction = 0.002}
pose = {jitter_um = 20}
"""
Touch = Callable[[PoseList], scan3d.Recording]


def log(body: Path, poses: PoseList, folder: Path, seed: int) -> tuple[Path, Path]:
    """The table that the rig writes when it goes through the poses, and its map."""
    write_poses(poses, folder / "poses.csv")
    (folder / "faults.toml").write_text(FAULTS)
    files = ["--poses", folder / "poses.csv", "--faults", folder / "faults.toml", "--out", folder / "raw.csv"]
    command([*map(str, ["simulate", body, *files, "--friction", 0.3, "--seed", seed]), "--quiet", "--overwrite"])
    return folder / "raw.csv", folder / "raw_map.toml"


def calibrated(folder: Path, seed: int = 1) -> scan3d.Calibration:
    """The rig, from touches of a sphere of 30 mm by rods in several directions."""
    trimesh.creation.icosphere(5, 15.0).export(folder / "sphere.stl")
    poses = plan_poses(RigPlan(parse_envelope("sphere:30"), "spatial", rod=ROD, sweeps=5))
    return scan3d.calibrate(scan3d.import_table(*log(folder / "sphere.stl", poses, folder, seed)), 0.030)


def loop(touch: Touch, batches: int, truth: trimesh.Trimesh) -> np.ndarray:
    """Rows of the number of sweeps, the certified bound, and the true error, in mm."""
    session, rows = scan3d.Session("cylinder:50x64", ROD, slices=8, samples=64), []
    while len(rows) < batches and (poses := session.ask()) is not None:
        session.tell(touch(poses))
        error = scan3d.compare(session.surface, truth).hausdorff
        rows.append((len(np.unique(session.recording.sweep)), session.certificate.bound, error))
    return np.array(rows)


def measure(batches: int) -> dict[str, np.ndarray]:
    """The loop with faults and without."""
    truth = standing(scan3d.load_mesh(EGG))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rig = calibrated(folder)
        seeds = iter(range(2, 100))
        with_faults = loop(
            lambda poses: scan3d.import_table(*log(EGG, poses, folder, next(seeds)), rig), batches, truth
        )
    exact = loop(lambda poses: simulate_rig(truth, poses, friction=(0.3, 0.3)).recording(), batches, truth)
    return {"with the faults of a rig": with_faults, "without faults": exact}


def figure(results: dict[str, np.ndarray]) -> Figure:
    """Certified bound and true error over the number of sweeps."""
    with rc_context(STYLE):
        drawn = Figure(figsize=(5.6, 3.7), layout="constrained")
        axes = drawn.subplots()
        for (name, (sweeps, bound, error)), color in zip(
            ((name, rows.T) for name, rows in results.items()), ("#D55E00", "#0072B2"), strict=True
        ):
            axes.plot(sweeps, bound, "o-", color=color, label=f"certified bound, {name}")
            axes.plot(sweeps, error, "s--", color=color, markerfacecolor="white", label=f"true error, {name}")
        axes.set(xlabel="number of sweeps", ylabel="distance in mm", yscale="log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.grid(color="0.92", linewidth=0.6)
        drawn.legend(loc="outside upper center", ncols=2)
    return drawn


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Figure of the bound over the number of sweeps of a rig.")
    parser.add_argument("--out", type=Path, default=Path(Path(__file__).with_suffix(".png").name))
    parser.add_argument("--quick", action="store_true", help="two batches of sweeps instead of three")
    given = parser.parse_args(arguments)
    figure(measure(2 if given.quick else 3)).savefig(given.out, dpi=150)


if __name__ == "__main__":
    main()
