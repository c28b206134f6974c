"""What a stated reach proves of random smooth bodies that are probed, swept or both, against the bodies themselves.

    python -m tests.robustness.reach [--first 0] [--bodies 100] [--slices 32] [--noise 1e-4] [--bead 0.05]

Bodies are level sets of sums of Gaussian bells: blobs, bars, rings and bowls, whose own reach is that of H. Federer (Curvature
measures, 1959): the least ``|q - p|² / 2 |(q - p)·n|`` of all pairs of their places.  Each is scanned by probings alone, or
with sweeps before (one in ten, for sweeps take minutes where probings take seconds), and bounded with a reach from 0.6 to 0.95
of its own; every fifth again with one that is 1.4 to 2.2 times too large.

With `--bead` nothing is taken for granted of a body: the everyday ones, turned at random, and between them random ones are
probed with a bead of a diameter relative to the diagonal.  Printed is what share of the hull of each that is not of the body is
proven to be free.

False is what is stated where a place of the body lies outside the outer body, where one of the inner body lies outside the
body, where the surface and the body are farther apart than the bound, or where volumes are on the wrong side.  The exit code is
1 if anything that is stated is false, if what is true is refuted, and by a reach if fewer than 80 % of the bodies are bounded,
or if fewer than 90 % of the reaches that are too large are refuted or bound nothing.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

import scan3d
from scan3d.bounds.reach import Reach, reach
from scan3d.geometry.distance import Search
from scan3d.reconstruction import as_measured
from tests.robustness import options
from tests.robustness.everyday import EVERYDAY
from tests.robustness.everyday import mesh_of as mesh_of_everyday
from tests.robustness.probing import signed

SIZE = 60.0
"""Diagonal of the bodies, in mm."""


class Bells(NamedTuple):
    """A function whose level sets are the bodies: the sum of ``exp(-|x - c|² / 2 w²)``."""

    centres: np.ndarray
    """(k, 3)"""
    widths: np.ndarray
    """(k,)"""
    level: float

    def value(self, points: np.ndarray) -> np.ndarray:
        """(n,) above 0 in the body."""
        found = np.full(len(points), -self.level)
        for centre, width in zip(self.centres, self.widths, strict=True):
            found += np.exp(-((points - centre) ** 2).sum(axis=1) / (2 * width**2))
        return found

    def gradient(self, points: np.ndarray) -> np.ndarray:
        """(n, 3)"""
        found = np.zeros_like(points)
        for centre, width in zip(self.centres, self.widths, strict=True):
            offset = points - centre
            found -= (np.exp(-(offset**2).sum(axis=1) / (2 * width**2)) / width**2)[:, None] * offset
        return found


def bells(kind: int, random: np.random.Generator) -> Bells:
    """Blobs, a closed or an open bar, or a bowl."""
    if kind == 0:
        count = int(random.integers(2, 6))
        return Bells(random.normal(0, 1.0, (count, 3)), random.uniform(0.6, 1.0, count), random.uniform(0.4, 0.7))
    if kind == 3:
        # bells all over a part of a sphere
        k = np.arange(150) + 0.5
        z, angle = 1 - random.uniform(0.6, 1.4) * k / 150, np.pi * (1 + 5**0.5) * k
        flat = np.sqrt(1 - z**2)
        places = 2.7 * np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)
        return Bells(places, np.full(150, random.uniform(0.35, 0.5)), random.uniform(1.0, 2.5))
    time = np.linspace(0, 2 * np.pi if kind == 1 else 1.4 * np.pi, 80, endpoint=kind == 2)
    waves = random.normal(0, 0.15, (3, 2, 3))
    waves[0, [0, 1], [0, 1]] += 1  # a circle that is bent
    places = sum(
        np.cos(n * time)[:, None] * a + np.sin(n * time)[:, None] * b for n, (a, b) in enumerate(waves, start=1)
    )
    places = 2.6 * places / np.linalg.norm(places, axis=1).max()
    return Bells(places, np.full(80, random.uniform(0.3, 0.55)), random.uniform(1.0, 3.0))


def mesh_of(form: Bells, step: float) -> trimesh.Trimesh | None:
    """The level set by cubes of a size, its vertices on it; None where it is not in the box."""
    low, high = form.centres.min(axis=0) - 2.5, form.centres.max(axis=0) + 2.5
    shape = np.ceil((high - low) / step).astype(int)
    axes = [low[k] + step * np.arange(shape[k]) for k in range(3)]
    field = np.full(shape, -form.level)
    for centre, width in zip(form.centres, form.widths, strict=True):
        x, y, z = (np.exp(-((axis - c) ** 2) / (2 * width**2)) for axis, c in zip(axes, centre, strict=True))
        field += x[:, None, None] * y[:, None] * z
    image = vtkImageData()
    image.SetDimensions(*shape.tolist())
    image.SetOrigin(*low.tolist())
    image.SetSpacing(step, step, step)
    image.GetPointData().SetScalars(numpy_to_vtk(field.ravel(order="F"), deep=True))
    edges = vtkFlyingEdges3D()
    edges.SetInputData(image)
    edges.SetValue(0, 0.0)
    edges.ComputeNormalsOff()
    edges.Update()
    found = edges.GetOutput()
    if not found.GetNumberOfPolys():
        return None
    points = vtk_to_numpy(found.GetPoints().GetData()).astype(float)
    for _ in range(4):
        slope = form.gradient(points)
        points = points - (form.value(points) / (slope**2).sum(axis=1))[:, None] * slope
    mesh = trimesh.Trimesh(points, vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3), process=False)
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def reach_of(form: Bells, points: np.ndarray) -> float:
    """Federer's reach of the level set, by pairs of places (n, 3) on it."""
    normals = form.gradient(points)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    least = np.inf
    for k in range(0, len(points), 500):
        offset = points[None] - points[k : k + 500, None]
        square, along = (offset**2).sum(axis=2), np.abs(np.einsum("ijk,ik->ij", offset, normals[k : k + 500]))
        least = min(least, float((square / np.maximum(2 * along, 1e-12))[square > 1e-6].min()))
    return least


def random_body(seed: int, *, smooth: bool = True) -> tuple[trimesh.Trimesh, float]:
    """A connected smooth body, few of which are convex, of diagonal `SIZE`, and its reach; or one of few facets."""
    for attempt in range(1000):
        random = np.random.default_rng([seed, attempt])
        form = bells(seed % 4, random)
        coarse = mesh_of(form, 0.12)
        if coarse is None or coarse.body_count != 1:
            continue
        some = random.permutation(len(coarse.vertices))[:2000]
        size, R = float(np.linalg.norm(coarse.extents)), reach_of(form, coarse.vertices[some])
        # neither walls that are thinner than a scan of so many planes can tell, nor bodies that are nearly balls
        if not 0.045 < R / size < 0.15:
            continue
        if not smooth:
            coarse.apply_scale(SIZE / size)
            coarse.units = "mm"
            return coarse, R * SIZE / size
        # edges of up to 6 degrees, along diagonals of cubes, which count as none
        fine = mesh_of(form, 0.06 * R)
        if fine is None or fine.body_count != 1 or not fine.is_watertight:
            continue
        some = random.permutation(len(fine.vertices))[:5000]
        R = min(R, reach_of(form, fine.vertices[some]))
        fine.apply_scale(SIZE / size)
        fine.units = "mm"
        return fine, R * SIZE / size
    raise RuntimeError("no body was drawn")


def wrongs(found: Reach, mesh: trimesh.Trimesh, surface: Any, seed: int) -> list[str]:
    """What is false of what is stated of a body, in words."""
    wrong = []
    places = np.concatenate([mesh.vertices, trimesh.sample.sample_surface(mesh, 5000, seed=seed)[0]])
    rounding = 1e-6 * SIZE  # vertices of marched cubes are of single precision
    if found.refuted:
        return wrong
    if len(found.outer.faces):
        if (out := float(signed(found.outer, places).max())) > rounding:
            wrong.append(f"the body is {out:.3g} outside the outer body")
        if found.outer.volume < mesh.volume:
            wrong.append("the outer body is smaller than the body")
    if len(found.inner.faces):
        if (out := float(signed(mesh, np.asarray(found.inner.vertices)).max())) > rounding:
            wrong.append(f"the inner body is {out:.3g} outside the body")
        if found.inner.volume > mesh.volume:
            wrong.append("the inner body is larger than the body")
    if np.isfinite(found.bound):
        there = Search(np.asarray(mesh.triangles)).nearest(np.asarray(surface.vertices))[0].max()
        back = Search(np.asarray(surface.triangles)).nearest(places)[0].max()
        if (off := float(max(there, back))) > found.bound:
            wrong.append(f"the surface is {off:.3g} off, and the bound is {found.bound:.3g}")
    return wrong


def any_body(seed: int) -> tuple[str, trimesh.Trimesh]:
    """An everyday body turned at random, or every third time a smooth one, and its name."""
    if seed % 3 == 2:
        return f"smooth {seed}", random_body(seed, smooth=False)[0]
    name = list(EVERYDAY)[(seed - seed // 3) % len(EVERYDAY)]
    mesh, turn = mesh_of_everyday(name), np.eye(4)
    turn[:3, :3] = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    mesh.apply_transform(turn)
    mesh.apply_scale(SIZE / float(np.linalg.norm(mesh.extents)))
    return name, mesh


def by_beads(seeds: range, slices: int, noise: float, bead: float) -> int:
    """The trial of bodies of any shape."""
    false, closed = 0, []
    print("seed  body                     contacts  proven in hull  scan s  bounds s  patches  what", flush=True)
    for seed in seeds:
        name, mesh = any_body(seed)
        start = time.process_time()
        scan = scan3d.scan(
            mesh, model="spatial", bead=bead * SIZE, friction=(0.0, 0.4), seed=seed, slices=slices, noise=noise
        )
        scanned = time.process_time()
        found = reach(*as_measured(scan.recording, scan.cloud), surface=scan.surface)
        took = time.process_time() - scanned
        wrong = wrongs(found, mesh, scan.surface, seed) + ([found.refuted] if found.refuted else [])
        false += bool(wrong)
        share = np.nan
        if len(found.outer.faces):
            places = np.random.default_rng(seed).uniform(*mesh.bounds, (20000, 3))
            around = ConvexHull(mesh.vertices).equations
            places = places[(places @ around[:, :3].T + around[:, 3] < 0).all(axis=1)]
            outside = places[signed(mesh, places) > 0]
            share = float((signed(found.outer, outside) > 0).mean())
        closed.append(share)
        print(
            f"{seed:4}  {name:24} {len(scan.cloud):8} {share:15.3f} {scanned - start:7.0f} {took:9.1f} "
            f"{len(found.widest):8}  {'; '.join(wrong)} {found.unbounded or ''}",
            flush=True,
        )
    bounded = np.isfinite(closed)
    print(
        f"{len(closed)} bodies: false {false}, bounded {bounded.sum()}, proven {np.nanmedian(closed):.3f} in the median"
    )
    return int(bool(false))


def main() -> int:
    given = options(__doc__, first=0, bodies=100, slices=32, noise=0.0, bead=0.0)
    if given.bead:
        return by_beads(range(given.first, given.first + given.bodies), given.slices, given.noise, given.bead)
    counts = dict.fromkeys(("false", "refuted", "bounded", "too large", "told"), 0)
    print("seed  reach/D  stated  probing  contacts  bound/R  volume between  scan s  reach s  what", flush=True)
    for seed in range(given.first, given.first + given.bodies):
        mesh, own = random_body(seed)
        random = np.random.default_rng([seed, 7])
        part, factor = random.uniform(0.6, 0.95), random.uniform(1.4, 2.2)
        probing = "only" if seed % 10 else "auto"
        start = time.process_time()
        settings: dict[str, Any] = {"friction": (0.0, 0.4), "seed": seed, "slices": given.slices, "noise": given.noise}
        scan = scan3d.scan(mesh, probing=probing, **settings)
        scanned = time.process_time()
        measured = as_measured(scan.recording, scan.cloud)
        found = reach(*measured, part * own, scan.surface)
        reached = time.process_time()
        wrong = wrongs(found, mesh, scan.surface, seed)
        said = found.refuted or found.unbounded or ""
        counts["refuted"] += found.refuted is not None
        counts["bounded"] += bool(np.isfinite(found.bound))
        if seed % 5 == 4:
            larger = reach(*measured, factor * own, scan.surface)
            wrong += wrongs(larger, mesh, scan.surface, seed)
            told = larger.refuted is not None or not np.isfinite(larger.bound)
            said += f" | {factor:.1f} times: {larger.refuted or larger.unbounded or 'NOT TOLD'}"
            counts["too large"] += 1
            counts["told"] += told
        counts["false"] += bool(wrong)
        between = (found.outer.volume - found.inner.volume) / mesh.volume if len(found.outer.faces) else np.nan
        print(
            f"{seed:4} {own / SIZE:8.3f} {part:7.2f}  {probing:7} {len(scan.cloud):9} {found.bound / own:8.3f} "
            f"{between:15.3f} {scanned - start:7.0f} {reached - scanned:8.1f}  {'; '.join(wrong)} {said}",
            flush=True,
        )
    print(given.bodies, "bodies:", ", ".join(f"{name} {count}" for name, count in counts.items()))
    few = counts["bounded"] < 0.8 * given.bodies or counts["told"] < 0.9 * counts["too large"]
    return int(bool(counts["false"] or counts["refuted"] or few))


if __name__ == "__main__":
    raise SystemExit(main())
