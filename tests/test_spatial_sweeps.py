"""Whole sweeps in space: what must hold of every sample, by reactions, contacts and poses alone."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from rods_in_space import (
    HALF,
    cuboid,
    curved,
    elastic_energy,
    follows,
    random_ellipsoid,
    random_paths,
    rods,
    shapes,
    slip,
    turned,
)
from shapes import unit

import planar
from scan3d.spatial.bodies import Ellipsoid
from scan3d.spatial.sweeping import End, Sweeps, sweep


class Scene(NamedTuple):
    """Sweeps past a body, and what is known of the body without them."""

    result: Sweeps
    position: np.ndarray
    clamps: np.ndarray
    friction: float
    gap: Callable
    """Distances (...,) of points (..., 3) from the body's surface, of those close to it and negative inside."""
    outward: Callable
    exact: float
    """Rounding of these distances."""


def past_ellipsoid(seed, friction, bow=0.0):
    """An ellipsoid turned at random, past which clamps that lean at random go straight, or in curves."""
    body, semi_axes, axes = random_ellipsoid(seed)
    rng = np.random.default_rng(seed)
    position, clamps = curved(body, 40, 50, rng, bow) if bow else random_paths(body, 24, 50, rng)

    def gap(points):
        local = points @ axes.T
        return ((local**2 / semi_axes**2).sum(axis=-1) - 1) / (2 * np.linalg.norm(local / semi_axes**2, axis=-1))

    def outward(points):
        return (points @ axes.T / semi_axes**2) @ axes

    return Scene(sweep(body, position, clamps, friction), position, clamps, friction, gap, outward, 1e-11)


def past_cuboid(radius, friction):
    rng = np.random.default_rng(5)
    body, turn = cuboid(radius, rng)
    position, clamps = random_paths(body, 40, 48, rng)

    def away(points):
        return points @ turn.T - np.clip(points @ turn.T, -HALF, HALF)

    def gap(points):
        return np.linalg.norm(away(points), axis=-1) - radius

    result = sweep(body, position, clamps, friction)
    # most contacts lie across edges
    across = np.count_nonzero(away(result.point[np.isfinite(result.s1)]), axis=1) == 2
    assert 0.5 < across.mean() < 0.99
    return Scene(result, position, clamps, friction, gap, lambda points: away(points) @ turn, 1e-12)


SCENES = {
    **{f"ellipsoid {seed}, {mu}": (past_ellipsoid, seed, mu) for seed in range(4) for mu in (0.0, 0.2, 0.6)},
    **{f"cuboid {radius}, {mu}": (past_cuboid, radius, mu) for radius, mu in ((0.005, 0.3), (0.03, 0.0), (0.03, 0.2))},
    **{f"curved, {mu}": (past_ellipsoid, 2, mu, 0.1) for mu in (0.0, 0.3)},
}
FEW = dict.fromkeys(("ellipsoid 0, 0.0", "ellipsoid 1, 0.2", "ellipsoid 2, 0.6"), ())
FEW |= dict.fromkeys(("cuboid 0.005, 0.3", "curved, 0.3"), pytest.mark.slow)


@pytest.fixture(
    scope="module",
    params=[pytest.param(SCENES[name], id=name, marks=FEW.get(name, pytest.mark.trust)) for name in SCENES],
)
def scene(request):
    past, *values = request.param
    return past(*values)


@pytest.mark.slow
def test_sweeps_end_where_the_contact_comes_too_near():
    rng = np.random.default_rng(5)
    body, _ = cuboid(0.03, rng)
    position, clamps = random_paths(body, 20, 48, rng)
    whole, ended = (sweep(body, position, clamps, 0.2, nearest=nearest) for nearest in (0.0, 0.5))
    near = whole.s1 < 0.5
    kept = np.cumsum(near, axis=1) - near == 0
    assert 0.1 < near.any(axis=1).mean() < 0.9
    assert (np.isnan(ended.s1) == np.isnan(whole.s1))[kept].all()
    assert np.nanmax(np.abs(ended.force - whole.force)[kept]) < 1e-9
    assert np.isnan(ended.s1[~kept]).all()
    assert ((ended.end == End.NEAR) == near.any(axis=1)).all()


@pytest.mark.slow
def test_sweeps_touch_leave_and_are_stable(scene):
    result, touching = scene.result, np.isfinite(scene.result.s1)
    assert touching.any(axis=1).mean() > 0.3
    # a lost sweep is one whose snap was not followed to its end
    assert (result.end == End.LOST).mean() <= 0.1
    assert (result.end[~touching.any(axis=1)] != End.PATH).all()
    assert ((result.phase == planar.Phase.TIP) == (np.abs(result.s1 - 1) < 1e-9)).all()
    # off the mirror planes
    assert not result.stable[~touching].any()
    assert result.stable[touching].mean() > (0.98 if scene.friction else 0.99)


def test_contacts_lie_on_the_body_with_its_normal(scene):
    touching = np.isfinite(scene.result.s1)
    point = scene.result.point[touching]
    assert np.abs(scene.gap(point)).max() < scene.exact
    normal = unit(scene.outward(point))
    assert np.abs(normal - scene.result.normal[touching]).max() < 2e-10


def test_the_rod_of_the_reactions_lies_outside_the_body_from_the_clamp_to_the_contact(scene):
    touching = np.isfinite(scene.result.s1)
    shape = shapes(scene.result, scene.clamps, touching)
    assert scene.gap(shape).min() > -1e-10
    assert np.abs(shape[:, 0] - scene.position[touching]).max() < 1e-9
    part = np.linalg.norm(np.diff(shape[:, :60], axis=1), axis=2).sum(axis=1)
    assert np.abs(part - scene.result.s1[touching]).max() < 1e-3  # chords of the arc


@pytest.mark.slow
def test_contacts_are_tangential_or_the_tip(scene):
    result, touching = scene.result, np.isfinite(scene.result.s1)
    lean = (result.tangent * result.normal).sum(axis=2)
    assert np.abs(lean[result.phase == planar.Phase.TANGENTIAL]).max(initial=0) < 1e-10
    assert lean[touching].max() < 1e-10
    assert ((result.s1[touching] > 0) & (result.s1[touching] < 1 + 1e-10)).all()


def test_forces_lie_in_the_cone(scene):
    result, touching = scene.result, np.isfinite(scene.result.s1)
    force = rods(result, scene.clamps, touching).force
    normal = result.normal[touching]
    pressed = (force * normal).sum(axis=1)
    assert (pressed > 0).all()
    tangential = np.linalg.norm(force - pressed[:, None] * normal, axis=1)
    excess = (tangential - scene.friction * pressed) / np.linalg.norm(force, axis=1)
    assert excess.max() < 1e-9
    assert np.abs(excess[~result.sticks[touching]]).max() < 1e-9


def test_friction_is_against_the_slip(scene):
    result, rows = scene.result, follows(scene.result) & ~scene.result.sticks
    assert rows.sum() > 100
    force, normal, path = rods(result, scene.clamps, rows).force, result.normal[rows], slip(result, rows)
    pressed = (force * normal).sum(axis=1)[:, None]
    length = np.linalg.norm(path, axis=1)
    amiss = force - pressed * normal + scene.friction * pressed * path / length[:, None]
    # the direction of a short path is known only to the solution's tolerance over its length
    long_enough = length > 1e-4
    assert long_enough.mean() > 0.9
    assert (np.linalg.norm(amiss, axis=1) / np.linalg.norm(force, axis=1))[long_enough].max() < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("friction", [pytest.param(0.0, marks=pytest.mark.trust), 0.3])
def test_the_base_does_the_work_of_bending_and_of_friction(friction):
    """Trapezoids of work over the steps: the balance is of second order in them, as is theirs."""
    body, _, _ = random_ellipsoid(3)
    missing = []
    for samples in (80, 160, 320):
        position, clamps = random_paths(body, 12, samples, np.random.default_rng(3))
        result = sweep(body, position, clamps, friction)
        touching = np.isfinite(result.s1)
        force = np.full((*touching.shape, 3), np.nan)
        force[touching] = rods(result, clamps, touching).force
        energy = np.full(touching.shape, np.nan)
        energy[touching] = elastic_energy(result, clamps, touching)
        path = np.full((*touching.shape, 3), np.nan)
        rows = follows(result)
        path[rows] = slip(result, rows)
        mean = (force[:, 1:] + force[:, :-1]) / 2
        base = -(mean * np.diff(position, axis=1)).sum(axis=2)
        pressed = (force * result.normal).sum(axis=2)
        tangential = force - pressed[:, :, None] * result.normal
        # the chord of the surface leaves the tangent plane, and the normal force takes part along it
        lost = -((tangential[:, 1:] + tangential[:, :-1]) / 2 * path[:, 1:]).sum(axis=2)
        balance = base - lost - np.diff(energy, axis=1)
        kept = rows[:, 1:] & (result.steps[:, 1:] == 1)
        # sweeps that follow without a snap or a stick
        regular = ~(result.snapped | result.sticks).any(axis=1) & (result.end != End.LOST) & touching.any(axis=1)
        regular &= np.nan_to_num(np.linalg.norm(force, axis=2)).max(axis=1) < 20
        sums = np.where(kept, balance, 0)[regular].sum(axis=1)
        work = np.where(kept, np.abs(base), 0)[regular].sum(axis=1)
        assert regular.sum() > 4
        missing.append(np.median(np.abs(sums) / work))
    assert missing[0] < 0.02
    order = np.log2(np.array(missing[:-1]) / missing[1:])
    assert (order > 0.9).all(), missing


@pytest.mark.parametrize(
    "semi_axes",
    [
        pytest.param((0.9, 0.675, 0.45), marks=pytest.mark.slow),
        pytest.param((0.6, 0.6, 0.6), marks=pytest.mark.trust),
        pytest.param((0.7, 0.4, 0.63), marks=pytest.mark.trust),
    ],
    ids=str,
)
def test_stability_in_a_mirror_plane_changes_where_it_should(semi_axes):
    """(S23): the rod beside the plane is pushed out of it without bound where x1 - x0 = (C/A)² (x1 - x_c)."""
    a, b, c = semi_axes
    centre = (0.0, b + 0.4, 0.0)
    contour = planar.Ellipse((a, b), centre[:2])
    base = np.linspace(planar.events(contour).x0[0] + 1e-3, -a, 1200)
    plane = planar.sweep(contour, base=base)
    measure = plane.point[:, 0] - base - (c / a) ** 2 * plane.point[:, 0]
    first = np.flatnonzero(measure > 0)[0]
    part = -measure[first - 1] / (measure[first] - measure[first - 1])
    critical = base[first - 1] + part * (base[first] - base[first - 1])

    # finely only where it is read
    base = np.append(np.linspace(base[0], critical + 0.05, 120), np.linspace(critical + 0.049, critical - 0.05, 120))
    aside = 1e-7
    position = np.stack([base, 0 * base, 0 * base + aside], axis=1)[None]
    swept = sweep(Ellipsoid(semi_axes, centre), position, np.eye(3)[None])
    compliance = aside / swept.point[0, :, 2]
    near = (base > critical + 0.01) & (base < critical + 0.03)
    assert (compliance[near] > 0).all()
    # it falls to zero there: linearly, as the lateral stiffness does
    slope, offset = np.polyfit(base[near], compliance[near], 1)
    assert abs(-offset / slope - critical) < 0.002
    beyond = (base < critical - 0.01) & (base > critical - 0.03)
    mirror = sweep(Ellipsoid(semi_axes, centre), position * [1, 1, 0], np.eye(3)[None])
    turns = base[np.flatnonzero(np.isfinite(mirror.s1[0]) & ~mirror.stable[0])[0]]
    assert mirror.stable[0, np.isfinite(mirror.s1[0]) & (base > turns)].all()
    assert abs(turns - critical) < 0.002
    # the rod has left the plane, or stays near it on the branch that is unstable, with a negative lateral stiffness
    left = np.nan_to_num(np.abs(swept.point[0, beyond, 2]), nan=1.0) > 0.01
    assert (left | (compliance[beyond] < 0)).all()


def same(result, other, point, vectors=1e-7):
    """Whether reactions, arc lengths and contacts agree; samples after a snap, which rounding may lead elsewhere, left out."""
    regular = ~np.logical_or.accumulate(result.snapped | other.snapped, axis=1)
    touching = np.isfinite(result.s1) & np.isfinite(other.s1) & regular
    assert (np.isfinite(result.s1) != np.isfinite(other.s1))[regular].mean() < 0.01
    assert touching.sum() > 300
    assert np.abs(result.s1 - other.s1)[touching].max() < vectors
    assert np.abs(point - other.point)[touching].max() < vectors
    return touching


@pytest.fixture(scope="module", params=[pytest.param(0.0, marks=pytest.mark.trust), 0.3])
def resting(request):
    body, semi_axes, axes = random_ellipsoid(1)
    position, clamps = random_paths(body, 30, 50, np.random.default_rng(11))
    return semi_axes, axes, position, clamps, request.param, sweep(body, position, clamps, request.param)


@pytest.mark.slow
def test_the_scene_may_be_turned_and_shifted(resting):
    semi_axes, axes, position, clamps, friction, result = resting
    rng = np.random.default_rng(12)
    turn, shift = turned(rng), rng.normal(size=3)
    other = sweep(Ellipsoid(semi_axes, shift, axes=axes @ turn.T), position @ turn.T + shift, clamps @ turn.T, friction)
    rows = same(result, other, result.point @ turn.T + shift)
    assert np.abs(result.force - other.force)[rows].max() < 1e-6
    assert np.abs(result.moment - other.moment)[rows].max() < 1e-6


@pytest.mark.slow
def test_the_scene_may_be_mirrored(resting):
    """A mirror image of the clamp's frame is left-handed, so its z is reversed: with it the reactions along z."""
    semi_axes, axes, position, clamps, friction, result = resting
    mirror = np.diag([1.0, 1.0, -1.0])
    reversed_z = clamps @ mirror * np.array([1.0, 1, -1])[:, None]
    other = sweep(Ellipsoid(semi_axes, axes=axes @ mirror), position @ mirror, reversed_z, friction)
    rows = same(result, other, result.point @ mirror)
    assert np.abs(result.force - other.force * [1, 1, -1])[rows].max() < 1e-6
    assert np.abs(result.moment - other.moment * [-1, -1, 1])[rows].max() < 1e-6


@pytest.mark.slow
def test_the_clamp_may_be_turned_about_its_axis(resting):
    semi_axes, axes, position, clamps, friction, result = resting
    angle = np.random.default_rng(13).uniform(-np.pi, np.pi, 30)
    cos, sin, zero = np.cos(angle), np.sin(angle), 0 * angle
    about = np.array([[cos, zero, sin], [zero, zero + 1, zero], [-sin, zero, cos]]).transpose(2, 0, 1)
    other = sweep(Ellipsoid(semi_axes, axes=axes), position, about @ clamps, friction)
    rows = same(result, other, result.point)
    turned_back = np.einsum("mji,mnj->mni", about, other.force)
    assert np.abs(result.force - turned_back)[rows].max() < 1e-6
    assert np.abs(result.moment - np.einsum("mji,mnj->mni", about, other.moment))[rows].max() < 1e-6


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
