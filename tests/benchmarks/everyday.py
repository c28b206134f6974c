"""Scans of the everyday bodies of the robustness trials: is any refused, does any fail, how many contacts are wrong?

    python -m tests.benchmarks.everyday --slices 64 [NAME ...]

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
from tests.robustness.everyday import EVERYDAY, mesh_of

PLACES = 10_000  # of the truth
EXACT = 1e-9  # rod lengths


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
        f"{'body':24} facets contacts  wrong share %   worst   two  told  lost   bound false reach surface       hull"
    )
    for name in given.names or EVERYDAY:
        mesh = mesh_of(name)
        try:
            recording, places, outlines = simulated(mesh, plan)
            cloud = scan3d.reconstruct(recording)
            surface = any_shape(recording, cloud).surface
        except scan3d.InputError as error:
            print(f"{name:24} refused: {error}", flush=True)
            continue
        off = np.abs(nearest(cloud.points, mesh)[0])
        wrong = off > EXACT * cloud.rod_length + 5 * (0.0 if cloud.place_sd is None else cloud.place_sd)
        found = np.zeros(len(recording), dtype=bool)
        found[cloud.row] = True
        missed = np.isin(np.flatnonzero(places > 1), cloud.row[wrong]).sum()
        two, one = (places > 1).sum(), (places == 1).sum()
        print(
            f"{name:24} {len(mesh.faces):6d} {len(cloud):8d} {wrong.sum():6d} {100 * wrong.mean():7.3f} "
            f"{off.max(initial=0) / cloud.rod_length:7.4f} {two:5d} {100 * (1 - missed / max(two, 1)):5.1f} "
            f"{100 * (~found[places == 1]).sum() / max(one, 1):5.2f} {false_slices(outlines, recording, cloud)} "
            f"{within_reach(mesh, recording, cloud, surface)}",
            flush=True,
        )


if __name__ == "__main__":
    main()
