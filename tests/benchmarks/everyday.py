"""Scans of thirty everyday bodies that are not convex: is any refused, does any fail, how many contacts are wrong?

    python tests/benchmarks/everyday.py --slices 64 [NAME ...]

wrong
    contacts farther from the body than 1e-9 rod lengths: a second one stayed hidden.  Of bodies without noise that is rounding;
    under noise it is what its standard deviation does not explain.
two, told
    samples in which the rod touches at several places, and the share in per cent of them that gave no contact or the right one.
lost
    share in per cent of the samples with one contact that gave none.
bound, false
    the contours' bound in rod lengths, and the slices in which a place of the outer contour is farther from the true one.
reach
    share in per cent of the truth within reach: a contact lies no farther from it than the slices are apart.  Mean and largest
    distance of these places from the surface and from the hull of the contacts follow, in per cent of the diagonal.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np
import trimesh
from scipy.spatial import cKDTree

import planar
import scan3d
from scan3d.bounds.free_space import contradicted, outer_contours, sheets_of
from scan3d.geometry.distance import Search, nearest
from scan3d.geometry.hulls import hull
from scan3d.simulation import scan
from scan3d.surfaces.any_shape import any_shape

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "meshes"))

from make_hollow_meshes import BODIES, closed, turned

PLACES = 10_000  # of the truth
EXACT = 1e-9  # rod lengths
AROUND = 2 * np.pi * np.arange(96) / 96
CIRCLE = np.stack([np.cos(AROUND), np.sin(AROUND)], axis=1)


def together(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(parts)


def box(x: float, y: float, z: float, *at: float) -> trimesh.Trimesh:
    mesh = trimesh.creation.box((x, y, z))
    mesh.apply_translation(at or (0, 0, 0))
    return mesh


def ball(radius: float, *at: float, stretch: tuple[float, float, float] = (1, 1, 1)) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(3, radius)
    mesh.apply_scale(stretch)
    mesh.apply_translation(at or (0, 0, 0))
    return mesh


def ring(outer: np.ndarray, inner: np.ndarray, height: float) -> trimesh.Trimesh:
    """A plate with an outline (n, 2) and a hole (n, 2)."""
    low, high = np.zeros((len(outer), 1)), np.full((len(outer), 1), height)
    return closed(
        np.array([np.hstack(part) for part in ((outer, low), (outer, high), (inner, high), (inner, low))]), around=True
    )


def plate(outline: np.ndarray, height: float) -> trimesh.Trimesh:
    """A plate whose outline is seen whole from its middle."""
    rings = [np.column_stack([outline, np.full(len(outline), z)]) for z in (0.0, height)]
    return closed(np.array(rings), around=False)


def tube(path: np.ndarray, radius: float, *, around: bool = False) -> trimesh.Trimesh:
    """A round tube along a path (n, 3)."""
    ahead = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0) if around else np.gradient(path, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    side = np.cross(ahead, [0.1, 0.3, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    across = np.cross(ahead, side)
    rings = [
        p + radius * (CIRCLE[::4, :1] * s + CIRCLE[::4, 1:] * a) for p, s, a in zip(path, side, across, strict=True)
    ]
    return closed(np.array(rings), around=around)


def bent(*corners: tuple[float, float, float]) -> np.ndarray:
    """A path (n, 3) round its corners."""
    points = np.array(corners, dtype=float)
    for _ in range(3):  # cutting corners
        inner = np.stack([0.75 * points[:-1] + 0.25 * points[1:], 0.25 * points[:-1] + 0.75 * points[1:]], axis=1)
        points = np.concatenate([points[:1], inner.reshape(-1, 3), points[-1:]])
    return points


def profile(*corners: tuple[float, float], around: bool = False) -> trimesh.Trimesh:
    """Turned from a profile of radius and height."""
    return turned(np.array(corners, dtype=float), around=around)


def hexagon(radius: float) -> np.ndarray:
    return radius * CIRCLE / np.cos(np.remainder(AROUND, np.pi / 3) - np.pi / 6)[:, None]


def wavy(radius: float, depth: float, count: int) -> np.ndarray:
    return radius * (1 + depth * np.cos(count * AROUND))[:, None] * CIRCLE


def cogs(radius: float, depth: float, count: int) -> np.ndarray:
    height = np.clip(2 * np.cos(count * AROUND), -1, 1)
    return (radius + depth * height)[:, None] * CIRCLE


TURN = np.linspace(0, 2 * np.pi, 80, endpoint=False)
EVERYDAY: dict[str, Callable[[], trimesh.Trimesh]] = {
    **{Path(name).stem: make for name, make in BODIES.items()},
    "nut": lambda: ring(hexagon(12), 6 * CIRCLE, 8),
    "bottle": lambda: profile((14, 0), (15, 1), (15, 30), (6, 40), (5, 41), (5, 50), (6, 50.5), (6, 52), (5, 53)),
    "gear": lambda: ring(cogs(16, 1.5, 8), 4 * CIRCLE, 6),
    "bulb": lambda: profile((3, 0), (6, 2), (6.5, 12), (8, 18), (13, 28), (14, 34), (12, 41), (7, 46), (2, 47.5)),
    "shaft": lambda: profile(
        (5, 0), (5, 15), (8, 15), (8, 25), (6.5, 25), (6.5, 28), (8, 28), (8, 40), (4, 40), (4, 60)
    ),
    "bowl": lambda: profile((8, 0), (16, 4), (22, 12), (24, 20), (22.5, 20), (20, 12.5), (14.5, 5.5), (2, 3)),
    "clamp": lambda: together(
        box(30, 8, 6), box(6, 8, 30, -12, 0, 12), box(30, 8, 6, 0, 0, 24), box(4, 4, 18, 12, 0, 16)
    ),
    "hook": lambda: tube(bent((0, 0, 40), (0, 0, 12), (2, 0, 0), (12, 0, -4), (20, 0, 2), (20, 0, 10)), 3),
    "link": lambda: tube(
        np.stack([8 * np.cos(TURN), np.zeros(80), 8 * np.sin(TURN) + 10 * np.sign(np.sin(TURN))], axis=1),
        2.5,
        around=True,
    ),
    "channel": lambda: together(box(30, 50, 4), box(4, 50, 20, -13, 0, 8), box(4, 50, 20, 13, 0, 8)),
    "beam": lambda: together(box(24, 50, 4), box(4, 50, 22, 0, 0, 11), box(24, 50, 4, 0, 0, 22)),
    "wrench": lambda: together(
        box(50, 8, 5), ring(10 * CIRCLE, 5 * CIRCLE, 5), box(8, 4, 5, 28, 6, 0), box(8, 4, 5, 28, -6, 0)
    ),
    "key": lambda: together(
        ring(9 * CIRCLE, 5 * CIRCLE, 3),
        box(30, 4, 3, 22, 0, 1.5),
        box(3, 6, 3, 30, -4, 1.5),
        box(3, 5, 3, 35, -3.5, 1.5),
    ),
    "dumbbell": lambda: profile(
        (8, 0), (12, 2), (12, 12), (8, 14), (3, 14), (3, 34), (8, 34), (12, 36), (12, 46), (8, 48)
    ),
    "glass": lambda: profile(
        (12, 0), (12, 1), (2, 3), (1.5, 22), (8, 27), (11, 36), (9, 46), (8, 46), (10, 36), (7, 28), (1, 24)
    ),
    "vase": lambda: profile(
        (8, 0), (13, 10), (12, 20), (6, 30), (5, 36), (8, 42), (7, 42), (4, 36), (5, 30), (11, 20), (12, 10), (2, 2)
    ),
    "table": lambda: together(
        box(40, 30, 3, 0, 0, 24), *(box(4, 4, 24, x, y, 12) for x in (-16, 16) for y in (-11, 11))
    ),
    "chair": lambda: together(
        box(20, 20, 3, 0, 0, 18),
        box(3, 20, 22, -8.5, 0, 30),
        *(box(3, 3, 18, x, y, 9) for x in (-8, 8) for y in (-8, 8)),
    ),
    "stairs": lambda: together(*(box(40 - 8 * k, 20, 6, -4 * k, 0, 5 * k) for k in range(5))),
    "cross": lambda: together(box(40, 10, 10), box(10, 40, 10), box(10, 10, 40)),
    "star": lambda: plate(wavy(15, 0.35, 5), 10),
    "spring": lambda: tube(np.stack([10 * np.cos(4 * TURN), 10 * np.sin(4 * TURN), 6 * TURN], axis=1), 1.5),
    "spool": lambda: profile((14, 0), (14, 3), (6, 4), (6, 24), (14, 25), (14, 28)),
    "pulley": lambda: profile((4, 0), (16, 0), (16, 2), (12, 5), (16, 8), (16, 10), (4, 10), around=True),
    "propeller": lambda: together(
        ball(6),
        *(
            ball(1, 16 * c, 16 * s, 0, stretch=(4 + 12 * abs(c), 4 + 12 * abs(s), 2))
            for c, s in ((1, 0), (-0.5, 0.87), (-0.5, -0.87))
        ),
    ),
    "funnel": lambda: profile((3, 0), (3, 15), (18, 32), (16.5, 32), (2, 16), (2, 0), around=True),
    "crank": lambda: tube(bent((-25, 0, 0), (-8, 0, 0), (-8, 0, 14), (8, 0, 14), (8, 0, 0), (25, 0, 0)), 3),
    "kettlebell": lambda: together(ball(14), tube(bent((-8, 0, 8), (-9, 0, 26), (9, 0, 26), (8, 0, 8)), 2.5)),
    "horseshoe": lambda: tube(15 * np.stack([np.cos(TURN[:60]), np.sin(TURN[:60]), 0 * TURN[:60]], axis=1), 4),
}


class Simulated(NamedTuple):
    recording: scan3d.Recording
    contacts: np.ndarray
    """(n,) places at which the rod touches in each row."""
    outlines: dict[float, list[np.ndarray]]
    """Of the slices that were swept, by their heights: planes of faces are cut just below."""


def simulated(mesh: trimesh.Trimesh, plan: scan3d.Plan) -> Simulated:
    """A recording, and the truth that it does not tell."""
    kept: list[list[scan.AxisScan]] = []

    def recording_of(scans: list[scan.AxisScan], *others: object) -> scan3d.Recording:
        kept.append(scans)
        return of_scans(scans, *others)

    of_scans = scan.recording_of
    with mock.patch.object(scan, "recording_of", recording_of):
        recording = scan3d.simulate(mesh, plan)
    status = np.concatenate([swept.result.status for axis in kept[-1] for swept in axis.swept])
    counts = np.array([0, 1, 2])[status[status != planar.SweepStatus.UNRESOLVED]]
    (axis,) = kept[-1]
    return Simulated(recording, counts, dict(zip(axis.heights, axis.loops, strict=True)))


def false_slices(outlines: dict[float, list[np.ndarray]], recording: scan3d.Recording, cloud: scan3d.Cloud) -> str:
    """The contours' bound, and the slices in which a place of the outer contour is farther from the true one than its bound."""
    sheets, touched, wrong, bound = sheets_of(recording, cloud), cloud, 0, 0.0
    touched = cloud.select(~contradicted(sheets, cloud))
    for sheet in sheets:
        contours = outer_contours([sheet], touched)
        flat = contours.points @ sheet.frame.T
        number = np.abs(flat[:, 2:] - sheet.height).argmin(axis=1)
        for k, height in enumerate(sheet.height):
            loops = outlines[min(outlines, key=lambda swept: abs(swept - height))]
            rows = number == k
            if rows.any() and loops:
                outline = np.concatenate([dense(loop) for loop in loops])
                off = cKDTree(outline).query(flat[rows, :2])[0].max() - sheet.cell / 50
                wrong += off > contours.distance[rows].max()
                bound = max(bound, contours.distance[rows].max())
    return f"{bound / cloud.rod_length:7.4f} {wrong:5d}"


def dense(loop: np.ndarray) -> np.ndarray:
    """Points along a closed polygon (n, 2), 4,000 in all."""
    closed_loop = np.concatenate([loop, loop[:1]])
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(closed_loop, axis=0), axis=1))])
    at = np.linspace(0, along[-1], 4000)
    return np.stack([np.interp(at, along, column) for column in closed_loop.T], axis=1)


def within_reach(mesh: trimesh.Trimesh, recording: scan3d.Recording, cloud: scan3d.Cloud, made: trimesh.Trimesh) -> str:
    """The share of the truth within reach, and its mean and largest distance from the surface and from the hull."""
    truth = np.asarray(trimesh.sample.sample_surface(mesh, PLACES, seed=0)[0])
    apart = max(sheet.apart for sheet in sheets_of(recording, cloud))
    reached = truth[cKDTree(cloud.points).query(truth)[0] <= apart]
    found = f"{100 * len(reached) / PLACES:5.0f}"
    for surface in (made, hull(cloud.points)):
        off = 100 * Search(np.asarray(surface.triangles)).nearest(reached)[0] / np.linalg.norm(mesh.extents)
        found += f" {off.mean():7.3f} {off.max():6.2f}"
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="bodies, all by default")
    parser.add_argument("--slices", type=int, default=8)
    parser.add_argument("--noise", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--friction", default="0.0:0.4", help="a number, or LOW:HIGH")
    given = parser.parse_args()
    friction = tuple(map(float, given.friction.split(":")))
    plan = scan3d.Plan(
        probing="off",
        slices=given.slices,
        noise=given.noise,
        seed=given.seed,
        friction=friction[0] if len(friction) == 1 else friction,
    )
    print(
        "body         facets contacts  wrong share %   worst   two  told  lost   bound false reach surface       hull"
    )
    for name in given.names or EVERYDAY:
        mesh = EVERYDAY[name]()
        try:
            recording, places, outlines = simulated(mesh, plan)
            cloud = scan3d.reconstruct(recording)
            surface = any_shape(recording, cloud).surface
        except scan3d.InputError as error:
            print(f"{name:12} refused: {error}", flush=True)
            continue
        off = np.abs(nearest(cloud.points, mesh)[0])
        wrong = off > EXACT * cloud.rod_length + 5 * (0.0 if cloud.place_sd is None else cloud.place_sd)
        found = np.zeros(len(recording), dtype=bool)
        found[cloud.row] = True
        missed = np.isin(np.flatnonzero(places > 1), cloud.row[wrong]).sum()
        two, one = (places > 1).sum(), (places == 1).sum()
        print(
            f"{name:12} {len(mesh.faces):6d} {len(cloud):8d} {wrong.sum():6d} {100 * wrong.mean():7.3f} "
            f"{off.max(initial=0) / cloud.rod_length:7.4f} {two:5d} {100 * (1 - missed / max(two, 1)):5.1f} "
            f"{100 * (~found[places == 1]).sum() / max(one, 1):5.2f} {false_slices(outlines, recording, cloud)} "
            f"{within_reach(mesh, recording, cloud, surface)}",
            flush=True,
        )


if __name__ == "__main__":
    main()
