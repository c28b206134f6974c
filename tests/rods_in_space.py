"""What the tests of sweeps in space check rods by: from reactions and poses alone, without the solver's unknowns."""

from typing import NamedTuple

import numpy as np
import trimesh

from planar.elastica import bend, partial_shape
from scan3d.spatial.bodies import Ellipsoid, RoundedPolyhedron, sphere_directions

# Of sweeps past an ellipsoid with the semi-axes (0.9, 0.675, 0.45) about (0, 1.075, 0), from bases at (x0, 0, 0.1125): x0;
# contact; s1; support reaction; moment's x and z.
FRICTIONLESS = """
0.7  0.7869688 0.9493596 0.2016290 0.9591246 -0.2918141 0.0828239 -0.2990623 -0.2912997 0.2842396
0.5  0.5896206 0.8015688 0.2869811 0.8300092 -0.4491038 0.3702539 -0.8743543 -0.7654575 0.3931700
0.3  0.3587317 0.6953255 0.3259755 0.7367475 -0.4077753 0.7672555 -1.4821631 -1.1943760 0.3285988
0.1  0.1200880 0.6420749 0.3399928 0.6895639 -0.1669100 1.0697269 -1.8902200 -1.4570179 0.1286575
"""
FRICTION_03 = """
0.7  0.824369 0.955204 0.161943 0.966406 -0.412435 0.059358 -0.163965 -0.159555 0.401342
0.5  0.668238 0.814433 0.246351 0.847971 -0.804429 0.330476 -0.640011 -0.565480 0.710752
0.3  0.451591 0.703968 0.300553 0.752470 -1.006529 0.724946 -1.248626 -1.015322 0.818460
0.1  0.216555 0.643373 0.328596 0.697911 -0.947536 1.062197 -1.756758 -1.359788 0.733423
-0.1 -0.025163 0.635967 0.341577 0.689153 -0.627132 1.113808 -1.919658 -1.475988 0.482190
"""


def table(text):
    return np.array([line.split() for line in text.strip().splitlines()], dtype=float)


class Rods(NamedTuple):
    """Bent rods (k,), dimensionless, in the world."""

    across: np.ndarray
    along: np.ndarray
    alpha: np.ndarray
    q: np.ndarray
    root: np.ndarray
    """Root of the force's size."""
    force: np.ndarray
    """(k, 3) contact force on the rod."""


def rods(swept, axes, rows):
    """The rods of the samples `rows` (m, n): bending plane and force, from the reactions (S5) to (S7)."""
    number, _ = np.nonzero(rows)
    x, y, z = (axes[number] if axes.ndim == 3 else axes[rows]).swapaxes(0, 1)
    force, moment = swept.force[rows], swept.moment[rows]
    omega = np.arctan2(-moment[:, 0], moment[:, 2])
    lateral = force[:, 0] * np.cos(omega) + force[:, 2] * np.sin(omega)
    alpha = np.arctan2(-lateral, force[:, 1])
    root = np.linalg.norm(force, axis=1) ** 0.5
    q = np.linalg.norm(moment, axis=1) / 2 / root
    across = np.cos(omega)[:, None] * x + np.sin(omega)[:, None] * z
    world = force[:, :1] * x + force[:, 1:2] * y + force[:, 2:] * z
    return Rods(across, y, alpha, q, root, -world)


def shapes(swept, axes, rows, samples=60):
    """Points (k, 2 * samples, 3) of the rods: of the bent part, and of the straight rest past a tangential contact."""
    rod = rods(swept, axes, rows)
    s1, point = swept.s1[rows], swept.point[rows]
    part = np.linspace(0, 1, samples)
    remaining = (rod.root * s1)[:, None] * (1 - part)
    x, y = partial_shape(rod.alpha[:, None], rod.q[:, None], remaining)
    scale = rod.root[:, None, None]
    bent = point[:, None] - (x[:, :, None] * rod.across[:, None] + y[:, :, None] * rod.along[:, None]) / scale
    straight = point[:, None] + ((1 - s1)[:, None] * part)[:, :, None] * swept.tangent[rows][:, None]
    return np.concatenate([bent, straight], axis=1)


def elastic_energy(swept, axes, rows):
    """Bending energy (k,) in EI/L, half the integral of the squared curvature by the first integral of the elastica."""
    rod = rods(swept, axes, rows)
    shape = bend(rod.alpha, rod.q)
    sine = 1 - 2 * (np.sin(rod.alpha / 2) ** 2 + rod.q**2)  # of the angle from the force to the rod's end
    return rod.root * (shape.y * np.cos(rod.alpha) - shape.x * np.sin(rod.alpha) - shape.length * sine)


def slip(swept, rows):
    """Path (k, 3) of the rod's material point along the surface in the step from the sample before each of `rows`."""
    before = np.roll(rows, -1, axis=1)
    path = swept.point[rows] - swept.point[before]
    path -= (swept.s1[rows] - swept.s1[before])[:, None] * swept.tangent[rows]
    normal = swept.normal[rows]
    return path - (path * normal).sum(axis=1)[:, None] * normal


def follows(swept):
    """Samples (m, n) that one step of the solution leads to from the sample before, in contact and without a snap."""
    touching = np.isfinite(swept.s1)
    result = touching & (swept.steps == 1) & ~swept.snapped
    result[:, 1:] &= touching[:, :-1]
    result[:, 0] = False
    # the step of the touch-down begins between two samples
    result &= np.cumsum(touching, axis=1) > 1
    return result


def random_ellipsoid(seed):
    rng = np.random.default_rng(seed)
    semi_axes, axes = rng.uniform(0.25, 0.55, 3), turned(rng)
    return Ellipsoid(semi_axes, axes=axes), semi_axes, axes


HALF = np.array([0.3, 0.2, 0.25])


def cuboid(radius, rng):
    """A fattened cuboid of the half lengths `HALF`, turned askew: the body, and its axes as rows."""
    turn = turned(rng)
    mesh = trimesh.creation.box(2 * HALF)
    return RoundedPolyhedron(mesh.vertices @ turn, mesh.faces, radius), turn


def turned(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def random_paths(body, count, samples, rng):
    """Straight paths (m, n, 3) past a body about the origin, each with the axes (m, 3, 3) of its clamp, leaning at random."""
    directions = sphere_directions(2000)
    size = np.abs((body.extreme(directions)[2] * directions).sum(axis=0)).max()
    axes = np.array([turned(rng) for _ in range(count)])
    x, y, z = axes.swapaxes(0, 1)
    height, depth = rng.uniform(-0.8, 0.8, (count, 1)) * size, rng.uniform(-0.5 - size, -0.5, (count, 1))
    start = 1.3 * size * x + depth * y + height * z
    return start[:, None] - 2.6 * size * np.linspace(0, 1, samples)[:, None] * x[:, None], axes


def curved(body, count, samples, rng, bow):
    """Paths as of `random_paths`, bowed to parabolas: their middles are displaced at random, by `bow` in each coordinate."""
    position, clamps = random_paths(body, count, samples, rng)
    part = np.linspace(0, 1, samples)
    return position + bow * (4 * part * (1 - part))[:, None] * rng.normal(size=(count, 1, 3)), clamps
