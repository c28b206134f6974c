"""How do own measurements become a surface, and how far can the surface be from the true body?

In a laboratory a rod on a linear stage is drawn past a specimen on a turntable, at several heights.  A force-torque sensor at
its clamp logs one row per sample: the specimen's rotation, the stage's height and travel in mm, and the force in mN and moment
in µN·m that the rod exerts on the sensor.  Here the table is simulated: `laboratory` writes it.  Everything else would be the
same for a measured table.

`recording` turns it into what `scan3d` reads: SI units, the clamp's pose in the specimen's frame for every row (y along the
undeformed rod, x against the motion, z across the slice), the reactions of the clamp on the rod, and the rod.  From the
recording follow contacts, friction, surface, and the certified bound on its distance to the body, without a mesh of it.

(a) the contacts of the widest slice seen from above, some of their normals, and the clamp travel; (b) the surface, coloured by
the upper bound on its distance to the true one.

    python examples/own_measurements.py [--out FILE]

Reference: L. Merker, J. Steigenberger, R. Marangoni, C. Behn, A Vibrissa-Inspired Highly Flexible Tactile Sensor: Scanning 3D
Object Surfaces Providing Tactile Images, Sensors 21, 2021, doi:10.3390/s21051572 (such a rig); the file is described in
docs/files.md.
"""

import argparse
import csv
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from paper_figure_3 import STYLE

import planar
import scan3d
from scan3d.surfaces import certificate, enclosure

MESH = Path(__file__).parents[1] / "meshes" / "gem.glb"
COLUMNS = ("sweep", "turn_deg", "height_mm", "distance_mm", "travel_mm", "across_mN", "along_mN", "moment_uNm")
# Length of the drawn normals, and which of them are drawn: every fifth, so that they can be distinguished.
NORMAL_MM, SHOWN = 5.0, 5
ROD = scan3d.Rod.wire(length_m=0.06, diameter_m=0.3e-3, modulus_Pa=210e9)


def laboratory(path: Path, slices: int = 24) -> None:
    """Write the table in the laboratory's columns, units and signs.  Only this function uses the mesh of the specimen."""
    plan = scan3d.Plan(slices=slices, spacing="adaptive", friction=(0.1, 0.4), rod=ROD)
    log = scan3d.simulate(scan3d.load_mesh(MESH), plan)
    x, y, _ = log.axes().transpose(1, 0, 2)
    turn = np.degrees(np.arctan2(x[:, 1], x[:, 0]))
    distance, travel = ((log.position_m * axis).sum(axis=1) * 1e3 for axis in (-y, -x))
    measured = -log.force_N * 1e3, -log.moment_Nm * 1e6
    table = np.column_stack([turn, log.position_m[:, 2] * 1e3, distance, travel, *measured])
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows([number, *row] for number, row in zip(log.sweep, table.tolist(), strict=True))


def recording(path: Path) -> scan3d.Recording:
    """The laboratory's table as a recording: poses in the specimen's frame, SI units, reactions on the rod."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    turn = np.radians(table["turn_deg"])
    zero = np.zeros_like(turn)
    # the clamp's axes in the specimen's frame: the motion is along -x, the rod points along y
    x = np.stack([np.cos(turn), np.sin(turn), zero], axis=1)
    y = np.stack([-np.sin(turn), np.cos(turn), zero], axis=1)
    place = -table["travel_mm"][:, None] * x - table["distance_mm"][:, None] * y
    place[:, 2] = table["height_mm"]
    return scan3d.Recording(
        sweep=table["sweep"].astype(int),
        position_m=place * 1e-3,
        # a turn about z, w first
        quaternion=np.stack([np.cos(turn / 2), zero, zero, np.sin(turn / 2)], axis=1),
        # the clamp's action on the rod is the opposite of the rod's action on the sensor
        force_N=-np.stack([table["across_mN"], table["along_mN"]], axis=1) * 1e-3,
        moment_Nm=-table["moment_uNm"] * 1e-6,
        rod=ROD,
        source={"kind": "laboratory", "table": path.name},
    )


def scanned(folder: Path, slices: int = 24) -> tuple[scan3d.Recording, scan3d.Cloud]:
    """From the table to the contacts, through the file that `scan3d reconstruct` reads."""
    laboratory(folder / "table.csv", slices)
    scan3d.write_recording(recording(folder / "table.csv"), folder / "specimen.csv")
    read = scan3d.read_recording(folder / "specimen.csv")
    return read, scan3d.reconstruct(read)


def figure(log: scan3d.Recording, cloud: scan3d.Cloud, surface: Any, bound: np.ndarray) -> Figure:
    """The figure, two columns of a page wide; `bound` (v,) is the certified bound at the surface's vertices."""
    with rc_context(STYLE):
        drawn = Figure(figsize=(7.2, 3.6), layout="constrained")
        draw_slice(drawn.add_subplot(1, 2, 1), log, cloud)
        draw_surface(drawn, drawn.add_subplot(1, 2, 2, projection="3d"), surface, bound)
    return drawn


def draw_slice(axes: Axes, log: scan3d.Recording, cloud: scan3d.Cloud) -> None:
    """Contacts, some normals and the clamp travel in the widest slice."""
    reach = np.zeros(len(cloud.slice_height))
    np.maximum.at(reach, cloud.slice, np.hypot(*cloud.points[:, :2].T))
    number = int(reach.argmax())
    selected = cloud.slice == number
    for sweep in np.unique(cloud.sweep[selected]):
        travel = log.position_m[log.sweep == sweep, :2] * 1e3
        axes.annotate("", travel[-1], travel[0], arrowprops=dict(arrowstyle="->", color="0.6", linewidth=0.8))
        axes.plot(*travel.T, color="0.6", linewidth=0.8)
    points, normals = cloud.points[selected, :2], cloud.in_plane_normals[selected, :2]
    axes.plot(
        *np.stack([points, points + NORMAL_MM * normals])[:, ::SHOWN].transpose(2, 0, 1), color="#b2182b", linewidth=0.8
    )
    tip = cloud.phase[selected] == planar.Phase.TIP
    axes.plot(*points[~tip].T, ".", color="black", ms=3, label="tangential")
    axes.plot(*points[tip].T, ".", color="#d98200", ms=3, label="tip")
    axes.set(xlabel="x in mm", ylabel="y in mm", aspect="equal")
    axes.set_title("(a)", loc="left")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.22), ncols=2, handletextpad=0.1)


def draw_surface(drawn: Figure, axes: Any, surface: Any, bound: np.ndarray) -> None:
    """The surface, its triangles coloured by the certified local bound."""
    faces = Poly3DCollection(surface.triangles, cmap="viridis")
    faces.set_array(1e3 * bound[surface.faces].mean(axis=1))
    axes.add_collection3d(faces)
    faces.set_edgecolor("face")
    low, high = surface.bounds
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.1)
    axes.view_init(elev=25, azim=-50)
    axes.set(xlabel="x in mm", ylabel="y in mm", zlabel="z in mm")
    axes.set_title("(b)", loc="left")
    drawn.colorbar(faces, ax=axes, label="true surface within, µm", location="bottom", shrink=0.8, aspect=30, pad=0.0)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="From a laboratory's table to a surface with its certificate.")
    parser.add_argument("--out", type=Path, default=Path(Path(__file__).with_suffix(".png").name))
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        log, cloud = scanned(Path(folder))
    bounds = enclosure(cloud)
    surface = scan3d.surface(cloud, bounds=bounds)
    bound, at_vertices, _ = certificate(bounds, surface)
    print(
        f"{len(log)} rows, {len(cloud)} contacts, friction {np.nanmin(cloud.friction):.3f}...{np.nanmax(cloud.friction):.3f}"
    )
    print(f"surface: {surface.metadata['reason']}")
    print(f"certified within {bound:.2g} mm; volume between {bounds.volume[0]:.6g} and {bounds.volume[1]:.6g} mm³")
    truth = scan3d.load_mesh(MESH)
    error = scan3d.compare(surface, truth).hausdorff
    print(f"compared with the true specimen: within {error:.2g} mm, volume {truth.volume:.6g} mm³")
    figure(log, cloud, surface, at_vertices).savefig(given.out, dpi=150, bbox_inches="tight")


if __name__ == "__main__":
    main()
