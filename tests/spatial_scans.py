"""Six-axis recordings of smooth bodies, by the sweeps of `scan3d.spatial.sweeping`."""

import functools

import numpy as np
from scipy.spatial.transform import Rotation

import scan3d
from scan3d.spatial.bodies import Ellipsoid
from scan3d.spatial.sweeping import sweep
from tests.rigs import six_axis_recording

SEMI_AXES = (0.45, 0.36, 0.27)
LENGTH = 0.05


def poses(directions=12, heights=12, samples=64, leaning=0.35):
    """Positions (m, n, 3) and axes (m, 3, 3) of sweeps around and over a body of half the rod's length about the origin."""
    position, axes = [], []
    for k in range(directions):
        turn = Rotation.from_euler("zx", [2 * np.pi * k / directions, leaning * (-1) ** k])
        for height in np.linspace(-0.42, 0.42, heights):
            x, y, z = turn.apply(np.eye(3))
            start = 0.75 * x - 0.95 * y + height * z
            position.append(start - np.linspace(0, 1.5, samples)[:, None] * x)
            axes.append([x, y, z])
    return np.array(position), np.array(axes)


def drawn(friction, shape, rng):
    return rng.uniform(*friction, shape) if isinstance(friction, tuple) else friction


@functools.lru_cache(maxsize=8)
def swept(friction, diameter, seed, substeps, semi_axes, raster):
    """The sweeps past an ellipsoid that `recorded` makes a recording of, and their poses; `raster` as a tuple of pairs."""
    position, axes = poses(**dict(raster))
    mu = drawn(friction, position.shape[:2], np.random.default_rng(seed))
    return position, axes, sweep(Ellipsoid(semi_axes, radius=diameter / 2), position, axes, mu, substeps=substeps)


def recorded(friction=0.3, *, diameter=0.0, noise=(0.0, 0.0), seed=0, substeps=4, semi_axes=SEMI_AXES, **raster):
    """A recording of an ellipsoid about the origin, and the true contacts (n, 3) and normals (n, 3) of all rows, NaN without.

    `diameter` is that of the rod over its length, `noise` is that of force and moment in EI/L² and EI/L, `friction` one number
    or a range, from which every sample has its own.
    """
    draws = seed if isinstance(friction, tuple) else 0
    position, axes, result = swept(friction, diameter, draws, substeps, semi_axes, tuple(sorted(raster.items())))
    m, n, _ = position.shape
    rng = np.random.default_rng(seed)
    drawn(friction, (m, n), rng)  # the numbers of the noise come after those of the friction
    rod = scan3d.Rod(LENGTH, 1e-4, diameter * LENGTH)
    touching = np.isfinite(result.s1).reshape(-1, 1)
    force = np.where(touching, result.force.reshape(-1, 3), 0) + noise[0] * rng.normal(size=(m * n, 3))
    moment = np.where(touching, result.moment.reshape(-1, 3), 0) + noise[1] * rng.normal(size=(m * n, 3))
    force, moment = force * rod.force_unit_N, moment * rod.moment_unit_Nm
    quaternion = Rotation.from_matrix(axes.swapaxes(1, 2)).as_quat(scalar_first=True)
    place = np.repeat(np.arange(m), n), position.reshape(-1, 3) * LENGTH, np.repeat(quaternion, n, axis=0)
    known = dict(noise_force_N=noise[0] * rod.force_unit_N, noise_moment_Nm=noise[1] * rod.moment_unit_Nm)
    recording = six_axis_recording(rod, *place, force, moment, **known)
    return recording, result.point.reshape(-1, 3) * LENGTH * 1000, result.normal.reshape(-1, 3)
