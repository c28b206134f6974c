"""Simulated forces lie in the cone of friction, |β| <= ζ in tangential contact (S11), which wrenches show without a normal."""

from dataclasses import replace

import numpy as np
import pytest
from sample_bodies import formulas
from shapes import ball

import planar
import scan3d
from scan3d.geometry.distance import nearest
from scan3d.planning.rig import RigPlan, parse_envelope, plan_poses
from scan3d.reconstruction.contacts import readings
from scan3d.simulation.rig import Faults, simulate_rig, standing

ROD = scan3d.Rod(0.06, 1.9e-4, 0.0003)


def forces(recording):
    """Unit forces on the rod (n, 3) in the clamp's frame at the n contacts, what is known of all rows, and theirs (n,)."""
    known = readings(recording)
    rows = np.flatnonzero(known.touching)
    force = known.found.force[rows]
    return force / np.linalg.norm(force, axis=1, keepdims=True), known.found, rows


def beta(recording):
    force, found, rows = forces(recording)
    tangential = found.phase[rows] == planar.Phase.TANGENTIAL
    return np.arcsin((force * found.tangent[rows]).sum(axis=1)[tangential])


@pytest.mark.slow
@pytest.mark.parametrize("friction", [pytest.param(0.0, marks=pytest.mark.trust), (0.0, 0.4)])
def test_friction_on_a_fine_mesh_shows_no_more_than_was_set(friction):
    """Where facets stand for a smooth body; 1 % of the samples showed up to 0.43 for 0.4, and all up to 0.04 for 0."""
    mesh = formulas.make("egg", 3)
    recording = scan3d.simulate(mesh, scan3d.Plan(model="spatial", sweeps=1, samples=24, friction=friction))
    shown = np.tan(np.abs(beta(recording)))
    assert len(shown) > 60
    assert shown.max() < np.max(friction) + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.trust) for k in range(1, 6))])
def test_rows_between_solved_ones_are_those_of_rods_that_touch(seed):
    """A dense log of a rig, whose rows are partly interpolated: 1 to 4 % were not in the cone of 0.4, and up to 0.6 mm off."""
    body = standing(ball(seed, 12, 20 * np.random.default_rng(seed).uniform(0.4, 1, 3)))
    across = 2 * np.linalg.norm(body.vertices[:, :2], axis=1).max()
    around = parse_envelope(f"cylinder:{across}x{body.bounds[1, 2]}")
    plan = RigPlan(around, model="spatial", rod=ROD, slices=1, sweeps=4)
    poses = plan_poses(plan)
    some = np.flatnonzero(poses.sweep % 8 == 1)  # from all sides
    few = replace(poses, **{name: getattr(poses, name)[some] for name in ("sweep", "position_m", "quaternion", "move")})
    log = simulate_rig(body, few, faults=Faults(rate_hz=200.0), friction=(0.0, 0.4))
    recording = replace(log, faults=None).recording()
    force, found, rows = forces(recording)
    axes = recording.axes()[rows]
    point = recording.position_m[rows] + np.einsum("ni,nij->nj", found.point[rows] * ROD.length_m, axes)
    distance, _, foot = nearest(1000 * point, body)
    assert len(rows) > 100
    assert np.abs(distance - 500 * ROD.diameter_m).max() < 1e-3 * 1000 * ROD.length_m
    normal = (1000 * point - foot) / distance[:, None]
    cosine = (normal * np.einsum("ni,nij->nj", force, axes)).sum(axis=1)
    assert cosine.min() > np.cos(np.arctan(0.4)) - 1e-3
    assert np.tan(np.abs(beta(recording))).max() < 0.4 + 1e-6
