"""Sweeps in space on paths of any form: clamps that turn, paths with corners, and contacts after a lift-off."""

import numpy as np
import pytest
from rods_in_space import random_ellipsoid, random_paths, turning
from scipy.spatial.transform import Rotation

from scan3d.spatial.bodies import Ellipsoid
from scan3d.spatial.sweeping import End, sweep
from scan3d.spatial.touchdown import Paths, first_touches


def test_poses_between_samples_turn_steadily():
    rng = np.random.default_rng(0)
    position, axes = turning(Ellipsoid((0.3, 0.3, 0.3)), 5, 4, rng, 3.0)
    paths = Paths(position, axes)
    lane, progress = np.repeat(np.arange(5), 7), np.tile([0.0, 0.3, 1.0, 1.5, 2.25, 2.999, 3.0], 5)
    clamp = paths.clamp(lane, progress)
    number = np.minimum(progress.astype(int), 2)
    before, after = (Rotation.from_matrix(axes[lane, k].swapaxes(1, 2)) for k in (number, number + 1))
    turn = (after * before.inv()).as_rotvec()
    expected = (Rotation.from_rotvec((progress - number)[:, None] * turn) * before).as_matrix()
    for k, axis in enumerate((clamp.x, clamp.y, clamp.z)):
        assert np.abs(axis.T - expected[:, :, k]).max() < 1e-14
    step = 1e-6
    ahead, behind = paths.clamp(lane, progress + step), paths.clamp(lane, np.maximum(progress - step, 0))
    speed, turning_of_rod = paths.speed(lane, progress)
    inner = (progress > 0) & (progress % 1 > 1e-5) & (progress < 2.99)
    assert np.abs((ahead.position - behind.position) / (2 * step) - speed)[:, inner].max() < 1e-8
    assert np.abs((ahead.y - behind.y) / (2 * step) - turning_of_rod)[:, inner].max() < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("friction", [pytest.param(0.0, marks=pytest.mark.trust), 0.3])
def test_a_clamp_that_turns_about_the_rod_changes_nothing(friction):
    body, _, _ = random_ellipsoid(1)
    position, clamps = random_paths(body, 30, 50, np.random.default_rng(11))
    fixed = sweep(body, position, clamps, friction)
    angle = np.linspace(0, 2.0, 50)
    cos, sin, zero = np.cos(angle), np.sin(angle), 0 * angle
    about = np.array([[cos, zero, sin], [zero, zero + 1, zero], [-sin, zero, cos]]).transpose(2, 0, 1)
    turned = sweep(body, position, about @ clamps[:, None], friction)
    # the result with friction depends on the steps, a few of which are halved in one and not in the other
    differs = fixed.snapped | turned.snapped | (fixed.steps != turned.steps)
    regular = ~np.logical_or.accumulate(differs, axis=1)
    touching = np.isfinite(fixed.s1) & np.isfinite(turned.s1) & regular
    assert (np.isfinite(fixed.s1) != np.isfinite(turned.s1))[regular].mean() < 0.01
    assert touching.sum() > 300
    assert np.abs(fixed.point - turned.point)[touching].max() < 1e-7
    back = np.einsum("nji,mnj->mni", about, turned.force)
    assert np.abs(fixed.force - back)[touching].max() < 1e-6


def test_an_orbit_about_a_sphere_keeps_the_reactions():
    """Without friction: in the clamp's frame the sphere rests."""
    approach = np.stack([np.linspace(0.7, 0.35, 15), np.full(15, -0.7), np.full(15, 0.1)], axis=1)
    rotations = Rotation.from_rotvec(np.linspace(0, 1.2, 30)[1:, None] * np.array([0.48, 0.6, 0.64])).as_matrix()
    position = np.concatenate([approach, rotations @ approach[-1]])[None]
    axes = np.concatenate([np.broadcast_to(np.eye(3), (15, 3, 3)), rotations.swapaxes(1, 2)])[None]
    swept = sweep(Ellipsoid((0.4, 0.4, 0.4)), position, axes)
    assert np.isfinite(swept.s1[0, 14:]).all()
    assert np.linalg.norm(swept.force[0, 14]) > 0.3
    assert np.abs(swept.force[0, 14:] - swept.force[0, 14]).max() < 1e-9
    assert np.abs(swept.moment[0, 14:] - swept.moment[0, 14]).max() < 1e-9


def test_touch_downs_of_turning_clamps_are_the_first_by_brute_force():
    body, semi_axes, axes = random_ellipsoid(3)
    position, clamps = turning(body, 60, 40, np.random.default_rng(5), 2.0)
    paths = Paths(position, clamps)
    progress = np.linspace(0, 39, 3901)
    entered = np.full(60, np.nan)
    for k in range(60):
        clamp = paths.clamp(np.full(len(progress), k), progress)
        p, d = clamp.position.T @ axes.T / semi_axes, clamp.y.T @ axes.T / semi_axes
        s = np.clip(-(p * d).sum(-1) / (d * d).sum(-1), 0, 1)
        inside = ((p + s[:, None] * d) ** 2).sum(-1) < 1
        if inside.any():
            entered[k] = progress[np.argmax(inside)]
    touch = first_touches(body, paths)
    found = np.full(60, np.nan)
    found[touch.number] = touch.progress
    assert np.isfinite(entered).sum() > 20
    assert np.array_equal(np.isfinite(found), np.isfinite(entered))
    # the first sample inside lies less than a step of 0.01 behind the touch-down
    behind = (entered - found)[np.isfinite(entered)]
    assert ((behind >= -1e-9) & (behind <= 0.0101)).all()


@pytest.mark.parametrize("friction", [pytest.param(0.0, marks=pytest.mark.trust), 0.2])
def test_a_rod_that_comes_back_touches_again(friction):
    """There along one line and back along another: the second contact is that of a separate sweep."""
    body = Ellipsoid((0.4, 0.3, 0.35))
    there = np.stack([np.linspace(0.8, -1.0, 60), np.full(60, -0.7), np.full(60, 0.12)], axis=1)
    back = there[::-1] * [1, 1, -1.2]
    position = np.concatenate([there, back])[None]
    first, second = (
        sweep(body, there[None], np.eye(3)[None], friction),
        sweep(body, back[None], np.eye(3)[None], friction),
    )
    both = sweep(body, position, np.eye(3)[None], friction)
    for part, alone in ((slice(0, 60), first), (slice(60, 120), second)):
        assert np.array_equal(np.isfinite(both.s1[0, part]), np.isfinite(alone.s1[0]))
        touching = np.isfinite(alone.s1[0])
        assert touching.sum() > 10
        assert np.abs(both.point[0, part] - alone.point[0])[touching].max() < 1e-8
        assert np.abs(both.force[0, part] - alone.force[0])[touching].max() < 1e-7
    assert both.end[0] == End.OFF
