"""The scenes of the benchmark of step 1 in space, and the integrated rod beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from scan3d.spatial.bodies import Body, Ellipsoid, RoundedPolyhedron
from scan3d.spatial.sweeping import Sweeps, sweep
from scan3d.spatial.touchdown import passages

Array = NDArray[np.float64]

MESHES = Path(__file__).parents[2] / "meshes"
# Of the rod, in rod lengths.
RADIUS = 0.003
SAMPLES = 64


def ellipsoid() -> Ellipsoid:
    """About as large as the rod is long, turned askew."""
    return Ellipsoid((0.5, 0.35, 0.25), axes=Rotation.random(random_state=1).as_matrix(), radius=RADIUS)


def polyhedron(name: str) -> RoundedPolyhedron:
    """A mesh whose diagonal is as long as the rod."""
    mesh = trimesh.load_mesh(MESHES / name)
    vertices = mesh.vertices - mesh.bounds.mean(axis=0)
    return RoundedPolyhedron(vertices / np.linalg.norm(mesh.extents), mesh.faces, RADIUS)


def paths(body: Body, count: int) -> tuple[Array, Array]:
    """Clamps at random about a body: positions (m, SAMPLES, 3) from before the touch-down to behind the body, and axes."""
    rng = np.random.default_rng(0)
    axes = Rotation.random(count, random_state=2).as_matrix()
    x, y, z = axes.swapaxes(0, 1)
    height, lift = rng.uniform(-0.3, 0.3, (count, 1)), rng.uniform(-0.1, 0.1, (count, 1))
    start = x + (lift - 0.75) * y + height * z
    passage = passages(body, start.T, y.T, -x.T)
    rows = passage.touches
    begin, end = passage.begin[rows, None], passage.end[rows, None]
    travel = begin - 1e-6 + (end - begin) * np.linspace(0, 1.02, SAMPLES)
    return start[rows, None] - travel[:, :, None] * x[rows, None], axes[rows]


def contacts(swept: Sweeps) -> int:
    return int(np.isfinite(swept.s1).sum())


def swept(body: Body, scene: tuple[Array, Array], friction: float) -> Sweeps:
    return sweep(body, *scene, friction)


def integrated(swept: Sweeps, axes: Array, position: Array) -> Array:
    """Where the rods (k, 3) of contacts end, by integrating the rod in space from the clamp: `scipy`'s DOP853, one by one.

    This only follows a rod whose reactions are known, as one step of a shooting method does.
    """
    ends = []
    for lane, sample in zip(*np.nonzero(np.isfinite(swept.s1)), strict=True):
        force, moment, s1 = -swept.force[lane, sample], -swept.moment[lane, sample], swept.s1[lane, sample]

        def slopes(_: float, state: Array, force: Array = force) -> Array:
            tangent, bending = state[3:6], state[6:]
            return np.concatenate([tangent, np.cross(bending, tangent), -np.cross(tangent, force)])

        start = np.concatenate([np.zeros(3), [0.0, 1.0, 0.0], moment])
        end = solve_ivp(slopes, (0, s1), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:3, -1]
        ends.append(position[lane, sample] + end @ axes[lane])
    return np.array(ends)


def distance(swept: Sweeps, scene: tuple[Array, Array]) -> float:
    """Largest distance of the contacts of some sweeps from the ends of their integrated rods."""
    position, axes = scene
    return float(np.linalg.norm(integrated(swept, axes, position) - swept.point[np.isfinite(swept.s1)], axis=1).max())
