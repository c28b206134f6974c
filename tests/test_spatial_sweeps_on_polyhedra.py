"""Sweeps in space past fattened polyhedra: a fine mesh beside the smooth body it stands for, and faces that are pressed."""

import numpy as np
import pytest
import trimesh
from rods_in_space import random_paths
from scipy.spatial.transform import Rotation

from scan3d.spatial.bodies import Ellipsoid, RoundedPolyhedron
from scan3d.spatial.sweeping import End, passages, sweep


@pytest.mark.parametrize(
    "friction", [pytest.param(0.0, marks=pytest.mark.trust), pytest.param(0.3, marks=pytest.mark.trust)]
)
def test_a_fine_mesh_of_a_sphere_is_the_sphere(friction):
    """Forces differ by the angles between the facets, by which their normals jump; four times the facets halve that."""
    ball = Ellipsoid((0.5, 0.5, 0.5), radius=0.01)
    position, clamps = random_paths(ball, 40, 40, np.random.default_rng(8))
    exact = sweep(ball, position, clamps, friction)
    differences, angles = [], []
    for subdivisions in (2, 3, 4):
        mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.5)
        # vertices on a sphere that is larger, so that the polyhedron is as large as the ball in the mean
        vertices = mesh.vertices * (np.pi / 6 / mesh.volume) ** (1 / 3)
        result = sweep(RoundedPolyhedron(vertices, mesh.faces, 0.01), position, clamps, friction)
        angles.append(np.median(mesh.face_adjacency_angles))
        both = np.isfinite(exact.s1) & np.isfinite(result.s1)
        assert both.sum() > 0.95 * np.isfinite(exact.s1).sum()
        difference = np.linalg.norm(result.force - exact.force, axis=2)[both]
        differences.append(np.quantile(difference / (1 + np.linalg.norm(exact.force, axis=2)[both]), 0.9))
    assert (np.array(differences) < 1.5 * np.array(angles)).all(), (differences, angles)
    assert differences[2] < 0.6 * differences[1] < 0.36 * differences[0]


@pytest.mark.trust
def test_contacts_end_only_where_the_straight_rod_is_clear():
    """A thin rod past a cube, with friction: rods that have just touched are nearly straight, too, but do not lift off."""
    mesh = trimesh.creation.box(np.full(3, 1 / np.sqrt(3)))
    body = RoundedPolyhedron(mesh.vertices, mesh.faces, 0.003)
    rng, axes = np.random.default_rng(0), Rotation.random(200, random_state=2).as_matrix()
    x, y, z = axes.swapaxes(0, 1)
    height, lift = rng.uniform(-0.3, 0.3, (200, 1)), rng.uniform(-0.1, 0.1, (200, 1))
    start = x + (lift - 0.75) * y + height * z
    passage = passages(body, start.T, y.T, -x.T)
    assert passage.touches.mean() > 0.9
    begin, end = passage.begin[passage.touches, None], passage.end[passage.touches, None]
    travel = begin - 1e-6 + (end - begin) * np.linspace(0, 1.02, 64)
    x, start = x[passage.touches], start[passage.touches]
    result = sweep(body, start[:, None] - travel[:, :, None] * x[:, None], axes[passage.touches], 0.3)
    left = result.end == End.OFF
    touching = np.isfinite(result.s1)
    last = touching.shape[1] - 1 - np.argmax(touching[:, ::-1], axis=1)
    assert left.sum() > 40
    after = np.take_along_axis(travel, np.minimum(last + 1, 63)[:, None], axis=1)
    assert (after >= end - 0.02)[left].all()
    assert (result.end == End.LOST).mean() < 0.05


def test_strokes_on_a_flat_face_that_press_and_lift():
    """The straight rod crosses the face at an angle, and is nowhere tangential to it: that place is not on the path."""
    slab = trimesh.creation.box((8, 8, 2))
    slab.apply_translation([0, 0, -1])
    body = RoundedPolyhedron(slab.vertices, slab.faces, 0.0025)
    at = np.linspace(-1, 1, 40)[:, None]
    axes = np.array([Rotation.from_euler("ZXY", [azimuth, -40, 30], degrees=True).as_matrix().T for azimuth in (0, 50)])
    height = np.sin(np.radians(40)) + 0.1 - 0.5 * (1 - at**2)
    drawn = -axes[:, None, 1] * [1, 1, 0]
    result = sweep(body, 0.6 * at * drawn + height * [0, 0, 1], axes, 0.2)
    touching = np.isfinite(result.s1)
    assert (touching.sum(axis=1) > 30).all()
    assert not touching[:, [0, -1]].any()
    assert np.abs(result.point[touching][:, 2] - 0.0025).max() < 1e-9


@pytest.mark.slow
def test_sweeps_that_are_not_followed_past_snaps_end_there():
    """Up to there they are the same, to the last bit."""
    mesh = trimesh.creation.box(np.full(3, 1 / np.sqrt(3)))
    body = RoundedPolyhedron(mesh.vertices, mesh.faces, 0.003)
    axes = Rotation.random(60, random_state=2).as_matrix()
    x, y, _ = axes.swapaxes(0, 1)
    start = x - 0.75 * y
    passage = passages(body, start.T, y.T, -x.T)
    rows = passage.touches
    travel = passage.begin[rows, None] - 1e-6 + (passage.end - passage.begin)[rows, None] * np.linspace(0, 1.02, 40)
    position = start[rows][:, None] - travel[:, :, None] * x[rows][:, None]
    followed, ended = (sweep(body, position, axes[rows], 0.3, snaps=snaps) for snaps in (True, False))
    snapped = ended.end == End.SNAP
    assert snapped.sum() > 5
    known = np.isfinite(ended.s1)
    np.testing.assert_array_equal(followed.force[known], ended.force[known])
    assert not ended.snapped.any()
    # nothing is known after the last place, from which on the other sweeps have snapped, left the body or been given up
    after = np.minimum(known.sum(axis=1) + np.argmax(known, axis=1), 39)[snapped]
    later = followed.s1[snapped, after]
    assert (np.isnan(later) | followed.snapped[snapped, after]).all()
    np.testing.assert_array_equal(followed.end[~snapped], ended.end[~snapped])
