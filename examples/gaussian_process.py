"""What does a Gaussian process make of the same touches?

Robots that feel often describe a body by a Gaussian process: a random function that is 0 where the body was touched, positive
outside and negative inside.  Its mean is 0 on the estimated surface, and its variance says how far that can be believed.  Here
touches with normals, as of any probe, are given to it and to `scan3d.touches`: places are off by 0.05 % of the diagonal,
normals by 1° in each direction, and both are stated.

The process is told the distance at each touch, and at the places before and behind it along the normal.  The size and length of
its kernel are the likeliest ones.  Printed are, as a table in Markdown, the Hausdorff distance and the mean distance between
surface and truth in per cent of the diagonal, what each says of its error, and the time.  What the process says is tested where
it is asked: 95 % of the places of the true surface should lie within 1.96 standard deviations of its zero.  The certificate
holds of all places at once, with 95 % confidence, and of convex bodies only.

    python examples/gaussian_process.py [MESH ...] [--touches 1000]

scikit-learn is not installed with the program: ``pip install scikit-learn``.

Reference: S. Dragiev, M. Toussaint, M. Gienger, "Gaussian process implicit surfaces for shape estimation and grasping", IEEE
International Conference on Robotics and Automation, 2011.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyvista
import trimesh
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

import scan3d
from scan3d.surfaces import certificate, enclosure

MESHES = Path(__file__).parents[1] / "meshes"
PLACE_SD, NORMAL_SD = 5e-4, np.radians(1.0)
# Places before and behind a touch, and the cells of the grid along the longest side, both of the diagonal.
BESIDE, CELL = 0.02, 1 / 64
# Touches from which the kernel is estimated: the time grows with the third power.
FEW = 150


def touched(mesh: trimesh.Trimesh, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Places and normals (n, 3) of touches spread over a mesh by area, with their errors."""
    rng = np.random.default_rng(seed)
    points, faces = trimesh.sample.sample_surface(mesh, count, seed=seed)
    normals = mesh.face_normals[faces] + NORMAL_SD * rng.normal(size=(count, 3))
    points = points + PLACE_SD * mesh.scale * rng.normal(size=(count, 3))
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def process(points: np.ndarray, normals: np.ndarray, size: float) -> GaussianProcessRegressor:
    """The process of the distance, told at touches (n, 3) of a body of this diagonal and beside them."""
    few = np.random.default_rng(0).permutation(len(points))[:FEW]
    beside = BESIDE * size
    noise = size * PLACE_SD + beside * NORMAL_SD
    kernel = ConstantKernel(size**2, (1e-4 * size**2, 1e4 * size**2)) * Matern(
        0.3 * size, (0.02 * size, 5 * size), nu=2.5
    )

    def told(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        places = [points[rows] + offset * normals[rows] for offset in (0.0, beside, -beside)]
        return np.concatenate(places), np.repeat([0.0, beside, -beside], len(rows))

    likeliest = GaussianProcessRegressor(kernel, alpha=noise**2).fit(*told(few)).kernel_
    return GaussianProcessRegressor(likeliest, alpha=noise**2, optimizer=None).fit(*told(np.arange(len(points))))


def zero_of(gp: GaussianProcessRegressor, points: np.ndarray, size: float) -> trimesh.Trimesh:
    """The surface on which the mean is 0."""
    low = points.min(axis=0) - 0.1 * size
    count = np.ceil((points.max(axis=0) + 0.1 * size - low) / (CELL * size)).astype(int)
    grid = pyvista.ImageData(dimensions=count + 1, spacing=np.full(3, CELL * size), origin=low)
    grid["distance"] = np.concatenate([gp.predict(part) for part in np.array_split(np.asarray(grid.points), 64)])
    zero = grid.contour([0.0], scalars="distance", method="flying_edges").triangulate()
    return trimesh.Trimesh(zero.points, zero.faces.reshape(-1, 4)[:, 1:])


def row(name: str, surface: trimesh.Trimesh, mesh: trimesh.Trimesh, says: str, seconds: float) -> str:
    found = scan3d.compare(surface, mesh)
    off = f"{found.relative:.2%} | {found.mean / found.diagonal:.3%}"
    return f"| {name} | {off} | {says} | {seconds:.1f} s |"


def rows(path: Path, count: int) -> list[str]:
    """The lines of the table for one body."""
    mesh = scan3d.load_mesh(path)
    points, normals = touched(mesh, count)
    start = time.perf_counter()
    gp = process(points, normals, mesh.scale)
    surface = zero_of(gp, points, mesh.scale)
    seconds = time.perf_counter() - start
    value, deviation = gp.predict(trimesh.sample.sample_surface(mesh, 5000, seed=1)[0], return_std=True)
    within = float((np.abs(value) < 1.96 * deviation).mean())
    says = f"±{1.96 * np.median(deviation) / mesh.scale:.2%}, holds of {within:.0%}"
    found = [row(f"{path.stem}, Gaussian process", surface, mesh, says, seconds)]
    start = time.perf_counter()
    cloud = scan3d.touches(points, normals, place_sd=PLACE_SD * mesh.scale, normal_sd=NORMAL_SD)
    surface = scan3d.surface(cloud)
    bound = certificate(enclosure(cloud), surface).bound if cloud.convex else np.inf
    seconds = time.perf_counter() - start
    says = f"at most {bound / mesh.scale:.2%}" if bound < np.inf else "nothing"
    return [*found, row(f"{path.stem}, scan3d", surface, mesh, says, seconds)]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Surfaces of the same touches by a Gaussian process and by scan3d.")
    parser.add_argument("mesh", nargs="*", type=Path, default=[MESHES / "egg.stl", MESHES / "hollow" / "mug.stl"])
    parser.add_argument("--touches", type=int, default=1000)
    given = parser.parse_args(arguments)
    print("| body, method | Hausdorff distance | mean | what it says of its error | time |")
    print("|---" * 5 + "|")
    for path in given.mesh:
        print(*rows(path, given.touches), sep="\n", flush=True)


if __name__ == "__main__":
    main()
