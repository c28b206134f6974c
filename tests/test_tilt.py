"""Slices by a clamp that is tilted against the plan, as a calibration finds it: the certificate allows for what tilts do."""

import dataclasses

import numpy as np
import pytest
from sample_bodies import convex_hausdorff
from scipy.spatial.transform import Rotation
from spatial_bodies import unit

import scan3d
from scan3d.geometry.distance import signed_distances
from scan3d.geometry.hulls import hull
from scan3d.reconstruction import contradictions
from scan3d.session import Session
from scan3d.simulation.rig import simulate_rig, standing
from scan3d.surfaces import certificate, enclosure, surface

ROD = scan3d.Rod(0.06, 1.9e-4, 0.0003)


def body(seed, size=15.0):
    """A polyhedron, an ellipsoid or a double pyramid with a sharp rim, that stands on the table."""
    rng = np.random.default_rng(seed)
    if seed % 3 == 0:
        vertices = unit(rng.standard_normal((int(rng.integers(6, 24)), 3)))
    elif seed % 3 == 1:
        vertices = unit(rng.standard_normal((600, 3)))
    else:
        angle = 2 * np.pi * (np.arange(5) + rng.uniform()) / 5
        rim = np.stack([np.cos(angle), np.sin(angle), np.full(5, rng.uniform(-0.5, 0.5))], axis=1)
        vertices = np.vstack([rim, [[0.1, 0, 1], [0, 0.1, -1]]])
    return standing(hull(size * vertices * rng.uniform(0.6, 1.0, 3)))


def swept(mesh, turn_deg, slices=8, samples=40, around="cylinder:32x32"):
    """A recording by a clamp that is turned in its own frame, and whose turn is known.

    Each sweep goes along the clamp's own x axis through the middle of the planned one, as the planar model needs it.
    """
    poses = Session(around, ROD, slices=slices, samples=samples).ask()
    planned = Rotation.from_quat(poses.quaternion, scalar_first=True)
    turned = planned * Rotation.from_euler("xyz", turn_deg, degrees=True)
    position = poses.position_m.copy()
    for rows in poses.sweeps():
        middle = position[rows].mean(axis=0)
        position[rows] = middle + (turned[rows] * planned[rows].inv()).apply(position[rows] - middle)
    poses = dataclasses.replace(poses, position_m=position, quaternion=turned.as_quat(scalar_first=True))
    return simulate_rig(mesh, poses, model="planar", friction=(0.2, 0.2)).recording()


def check(mesh, cloud):
    """Inner and outer body, surface and volume against the truth; the bound."""
    bounds = enclosure(cloud)
    assert convex_hausdorff(bounds.inner, mesh) <= bounds.bound
    assert bounds.volume[0] <= mesh.volume <= bounds.volume[1]
    made = surface(cloud, bounds=bounds)
    assert convex_hausdorff(made, mesh) <= certificate(bounds, made).bound
    outer = [hull(bounds.corners[bounds.slabs.number == number]) for number in np.unique(bounds.slabs.number)]
    missing = np.min([signed_distances(mesh.vertices, part) for part in outer], axis=0)
    assert missing.max() <= bounds.margin + 1e-9
    return bounds


@pytest.mark.parametrize("block", range(4))
def test_the_certificate_holds_for_tilted_clamps(block):
    for seed in range(6 * block, 6 * block + 6):
        rng = np.random.default_rng(seed)
        mesh, turn = body(seed), rng.uniform(-1, 1, 3) * [0.8, 0.8, 0.5]
        recording = swept(mesh, turn)
        cloud = scan3d.reconstruct(recording)
        assert cloud.tilt.slope == pytest.approx(np.hypot(*np.radians(turn[:2])), rel=0.05)
        assert contradictions(recording, cloud) == []
        bounds = check(mesh, cloud)
        assert bounds.slabs.stack.height_error >= cloud.tilt.spread
        assert np.isfinite(bounds.bound)


def test_a_small_tilt_makes_the_bound_a_little_larger():
    mesh = body(1)
    level = check(mesh, scan3d.reconstruct(swept(mesh, (0.0, 0.0, 0.0)))).bound
    for degrees, allowed in ((0.01, 0.05), (0.1, 0.4)):
        cloud = scan3d.reconstruct(swept(mesh, (degrees, -degrees, 0.3)))
        assert check(mesh, cloud).bound < level + allowed


def test_level_slices_have_no_tilt():
    mesh = body(2)
    cloud = scan3d.reconstruct(swept(mesh, (0.0, 0.0, 0.7)))
    assert cloud.tilt is None
    assert enclosure(cloud).stack.height_error == 0.0
    assert enclosure(cloud).margin == 0.0


@pytest.mark.slow
def test_the_certificate_holds_for_tilted_clamps_and_noise():
    """20 seeds with noise of 0.2 % of the largest force and poses that jitter: the bound is false in one of them at most."""
    false = 0
    for seed in range(20):
        rng = np.random.default_rng(100 + seed)
        mesh = body(seed)
        recording = swept(mesh, rng.uniform(-0.2, 0.2, 3), samples=100)
        force, moment = (0.002 * float(np.abs(part).max()) for part in (recording.force_N, recording.moment_Nm))
        noisy = dataclasses.replace(
            recording,
            position_m=recording.position_m + 2e-6 * rng.standard_normal((len(recording), 3)),
            force_N=recording.force_N + force * rng.standard_normal((len(recording), 2)),
            moment_Nm=recording.moment_Nm + moment * rng.standard_normal(len(recording)),
            noise_force_N=force,
            noise_moment_Nm=moment,
        )
        bounds = enclosure(scan3d.reconstruct(noisy))
        assert bounds.confidence == 0.95
        false += convex_hausdorff(bounds.inner, mesh) > bounds.bound
        false += not bounds.volume[0] <= mesh.volume <= bounds.volume[1]
    assert false <= 1
