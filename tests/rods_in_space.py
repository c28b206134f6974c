"""What the tests of sweeps in space check rods by: from reactions and poses alone, without the solver's unknowns."""

from typing import NamedTuple

import numpy as np

from planar.elastica import bend, partial_shape
from scan3d.spatial.bodies import Ellipsoid, sphere_directions


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
    """An ellipsoid turned at random about the origin: the body, its semi-axes, and its axes as rows."""
    rng = np.random.default_rng(seed)
    semi_axes, axes = rng.uniform(0.25, 0.55, 3), turned(rng)
    return Ellipsoid(semi_axes, axes=axes), semi_axes, axes


def turned(rng):
    """A random rotation matrix."""
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
