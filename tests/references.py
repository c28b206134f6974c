"""Touches of a plane, for the rig of `tests.rigs`: exact sweeps, and where the reference is."""

from functools import cache

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from scan3d.spatial.bodies import RoundedPolyhedron
from tests import rigs

# The turn of the reference's frame in the world, in degrees about fixed axes.
TURN = (20.0, -35.0, 130.0)
# The plane: tilts of the rod against it in degrees, how deep the clamp is pressed in heights of the straight rod above it, and
# directions in degrees in which the clamp is drawn while it is pressed, from that which trails the rod.
TILTS, DEPTHS, DRAWN = (25, 40, 55, 35, 65), (0.35, 0.6, 0.7, 0.8), (0, 40, -40, 70, -70, 20)


def turned():
    return Rotation.from_euler("xyz", TURN, degrees=True)


@cache
def plane(samples=120, friction=0.2, sweeps=30, directions=6, rolls=5, depths=DEPTHS, length=rigs.ROD.length_m):
    """Exact strokes on a plane through the origin, in the world, as `rigs.swept` has those about a sphere."""
    axes, position = [], []
    at = np.linspace(-1, 1, samples)[:, None]
    for k in range(sweeps):
        tilt, azimuth = np.radians(TILTS[k % 5]), 2 * np.pi * (k % directions) / directions + 0.2 * k * (directions > 1)
        roll = 2 * np.pi * (k // directions) / rolls + 0.4 * k * (rolls > 1)
        turn = Rotation.from_euler("z", azimuth) * Rotation.from_euler("x", -tilt) * Rotation.from_euler("y", roll)
        axes.append(turn.as_matrix().T)
        rod = axes[-1][1]
        drawn = Rotation.from_euler("z", DRAWN[k % 6], degrees=True).apply(-rod * [1, 1, 0] / np.cos(tilt))
        deepest = depths[k % len(depths)] * np.sin(tilt)
        height = np.sin(tilt) + 0.1 - (deepest + 0.1) * (1 - at**2)
        position.append(0.6 * at * drawn + height * [0, 0, 1])
    slab = trimesh.creation.box((8, 8, 2))
    slab.apply_translation([0, 0, -1])
    body = RoundedPolyhedron(slab.vertices, slab.faces, rigs.ROD.diameter_m / 2 / length)
    position, axes = np.array(position), np.array(axes)
    reactions = rigs.felt(body, position, axes, friction)
    return turned().apply(position.reshape(-1, 3)).reshape(position.shape), axes @ turned().as_matrix().T, *reactions


def at_plane(truth):
    """The true quantities of the plane."""
    normal = turned().as_matrix()[:, 2]
    named = {f"plane_normal_{axis}": value for axis, value in zip("xyz", normal, strict=True)}
    return {**named, "plane_offset_mm": 1000 * float(normal @ truth.centre)}


def of(kind, truth):
    """What `scan3d.calibrate` is given, the exact sweeps, and the true quantities of a reference."""
    if kind == "plane":
        return "plane", plane, at_plane(truth)
    return rigs.DIAMETER, rigs.swept, None
