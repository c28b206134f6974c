"""The local bound: nowhere is a vertex of a surface farther from the body's surface than is stated there."""

import dataclasses

import numpy as np
import pytest
import trimesh
from sample_bodies import random_body

import scan3d
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import support_values
from scan3d.geometry.vectors import highest
from scan3d.reconstruction.contacts import contacts
from scan3d.surfaces import certificate, enclosure, surface


def turned(body, seed):
    body.apply_transform(trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).uniform(size=3)))
    return body


@pytest.mark.parametrize("seed", range(12))
def test_it_holds_at_every_vertex(seed):
    """With few slices, on the hull, the estimate and a body that is too large; also where a slab is not bounded."""
    body = turned(random_body(seed), seed)
    plan = scan3d.Plan(
        slices=3 + seed % 5, spacing="uniform" if seed % 2 else "adaptive", friction=(0.0, 0.4), samples=24
    )
    cloud = contacts(scan3d.simulate(body, plan))
    ends = cloud.slice_height.argmax()
    open_above = dataclasses.replace(cloud, unresolved=np.arange(len(cloud.slice_height)) == ends)
    for known in (cloud, open_above):
        bounds = enclosure(known)
        for mesh in (bounds.inner, surface(known, "bracket", bounds=bounds)):
            for larger in (1.0, 1.05):
                shape = trimesh.Trimesh(mesh.vertices * larger, mesh.faces, process=False)
                certified = certificate(bounds, shape)
                off = np.abs(nearest(np.asarray(shape.vertices), body)[0])
                assert (off <= certified.at_vertices + 1e-9).all()
                assert (certified.at_vertices <= certified.bound).all()
                assert not np.isnan(certified.at_vertices).any()
    assert np.isfinite(enclosure(cloud).bound)
    assert enclosure(open_above).bound > enclosure(cloud).bound


def test_places_that_are_known_have_a_small_one():
    body = turned(trimesh.creation.box((20, 30, 40)), 3)
    bounds = enclosure(contacts(scan3d.simulate(body, scan3d.Plan(slices=40))))
    local = certificate(bounds, bounds.inner).at_vertices
    assert local.max() < 1e-4
    round_body = enclosure(
        contacts(scan3d.simulate(turned(trimesh.creation.capsule(20, 8), 2), scan3d.Plan(slices=12)))
    )
    certified = certificate(round_body, round_body.inner)
    assert np.median(certified.at_vertices) < 0.7 * certified.bound


def test_the_tangents_bound_a_polyhedron_more_tightly():
    """Of all axes together, and no tighter than the truth."""
    points = np.random.default_rng(5).normal(size=(12, 3)) * [10, 14, 8]
    polytope = trimesh.convex.convex_hull(points)
    for body, axis, slices in ((polytope, "z", 64), (scan3d.load_mesh("meshes/gem.glb"), "xyz", 21)):
        cloud = contacts(scan3d.simulate(body, scan3d.Plan(slices=slices, axis=axis)))
        bounds = enclosure(cloud)
        assert bounds.tighter.directions is not None
        alone = dataclasses.replace(bounds, tangents=None, bound=float(bounds.gap.max()))
        assert scan3d.compare(bounds.inner, body).hausdorff <= bounds.bound < 0.5 * alone.bound
        assert max(bounds.parts().values()) <= bounds.bound
        assert bounds.volume[0] * (1 - 1e-12) <= body.volume <= bounds.volume[1] * (1 + 1e-12)
        assert certificate(bounds, bounds.inner).bound <= certificate(alone, bounds.inner).bound
        directions = np.random.default_rng(1).normal(size=(50, 3))
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        lower, upper = bounds.support(directions)
        truth = (body.vertices @ directions.T).max(axis=0)
        assert (lower <= truth + 1e-9).all()
        assert (truth <= upper + 1e-9).all()
        assert (upper <= alone.support(directions)[1]).all()


@pytest.mark.parametrize("shape", ["ball", "box", "flat", "plane"])
def test_the_support_function_of_many_points(shape):
    """In blocks, and along the edges of the hull; also of points that span no body."""
    random = np.random.default_rng(0)
    points, directions = random.normal(size=(6000, 3)), random.normal(size=(3000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    if shape == "ball":
        points /= np.linalg.norm(points, axis=1)[:, None]
    if shape == "box":
        points = np.clip(points, -1, 1)
        directions[:6] = [*np.eye(3), *-np.eye(3)]
    points *= {"flat": [1, 1, 1e-6], "plane": [1, 1, 0]}.get(shape, [1, 2, 3])
    truth = (points @ directions.T).max(axis=0)
    assert highest(points, directions) == pytest.approx(truth, abs=1e-14)
    assert support_values(points, directions) == pytest.approx(truth, abs=1e-12)
