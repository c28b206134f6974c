"""Scans of bodies that are not convex though each of their slices is: round ones about the z axis, with waists."""

import numpy as np
from scipy.spatial.transform import Rotation

import planar
from scan3d.recording import Recording
from scan3d.rods import Rod

LENGTH = 60.0
"""Of the rod, in mm."""


def cassini(z):
    """Radius, in mm, of the Cassini oval with foci 18 mm above and below z = 0 and the constant 19.08 mm, turned about z."""
    a, b = 18.0, 19.08
    return np.sqrt(np.maximum(np.sqrt(4 * a**2 * z**2 + b**4) - z**2 - a**2, 0.0))


def recording_of(radius, heights, directions=6, samples=32, friction=0.3, base=0.5):
    """Recording of slices at some heights, empty where the radius is 0, of a round body of the radius(z)."""
    radii = radius(np.asarray(heights, dtype=float))
    filled = np.flatnonzero(radii > 0)
    contours = [planar.Circle(radii[k] / LENGTH, (0.0, radii[k] / LENGTH + base)) for k in filled]
    swept = dict(
        zip(filled.tolist(), planar.sweep_all(contours, [friction] * len(filled), samples=samples), strict=True)
    )
    rod = Rod.of_length(LENGTH * 1e-3)
    columns = [[], [], [], []]
    for k, z in enumerate(heights):
        x0, wrench = np.linspace(0.5, -0.5, samples), np.zeros((samples, 3))
        if k in swept:
            result = swept[k]
            x0, wrench = result.x0, np.nan_to_num(np.stack([result.f0x, result.f0y, result.m0z], axis=1))
        for angle in 2 * np.pi * np.arange(directions) / directions:
            x, y = np.array([np.sin(angle), -np.cos(angle)]), np.array([np.cos(angle), np.sin(angle)])
            place = LENGTH * x0[:, None] * x - (radii[k] + base * LENGTH) * y
            axes = np.stack([np.append(x, 0.0), np.append(y, 0.0), [0.0, 0.0, 1.0]], axis=1)
            quaternion = Rotation.from_matrix(axes).as_quat(scalar_first=True)
            values = (
                1e-3 * np.column_stack([place, np.full(samples, z)]),
                np.tile(quaternion, (samples, 1)),
                wrench[:, :2] * rod.force_unit_N,
                wrench[:, 2] * rod.moment_unit_Nm,
            )
            for column, value in zip(columns, values, strict=True):
                column.append(value)
    position, quaternion, force, moment = (np.concatenate(column) for column in columns)
    sweep = np.repeat(np.arange(len(columns[0])), samples)
    return Recording(sweep, position, quaternion, force, moment, rod, unit="mm", source={"convex": False})
