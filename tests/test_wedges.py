"""Bounds by noisy contacts anywhere: the body never reaches into a wedge, and lies behind the triangles over all directions."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from spatial_bodies import Cylinder, box, largest_difference, random_ellipsoid, random_polyhedron, spatial_cloud, unit

from scan3d.bounds import allowed, constraints, enclosure
from scan3d.geometry.arcs import Places


def noisy_cloud(seed, count=1500, across=1e-3, along=6e-3, turn=2e-3):
    """A body, and a cloud of contacts whose places are much less certain along the rod, as those of a rig are."""
    kind = (random_ellipsoid, random_polyhedron, lambda s: box([1, 0.7, 0.5], 0.1), lambda s: Cylinder(0.3, 0.5))[
        seed % 4
    ]
    body, rng = kind(seed), np.random.default_rng(seed)
    exact = spatial_cloud(body, count, seed, (0.0, 0.01)[seed % 2])
    t = exact.tangents
    covariance = across**2 * np.eye(3) + (along**2 - across**2) * t[:, :, None] * t[:, None, :]
    off = across * rng.normal(size=t.shape)
    off += (along * rng.normal(size=(count, 1)) - (off * t).sum(axis=1)[:, None]) * t
    turned = turn / np.sqrt(2) * rng.normal(size=t.shape)
    cloud = dataclasses.replace(
        exact,
        points=exact.points + off,
        centre_points=exact.centre_points + off,
        tangents=unit(t + turned - (turned * t).sum(axis=1)[:, None] * t),
        covariance=covariance,
        centre_covariance=covariance,
        place_sd=np.full(count, along),
        tangent_sd=np.full(count, turn),
        normal_sd=np.full(count, np.inf),
        noise=along,
    )
    return body, cloud


def entered(body, cloud, kappa):
    """How many wedges the fattened body reaches into, and of how many."""
    places = Places(cloud.centre_points, np.zeros(len(cloud)), kappa**2 * cloud.centre_covariance)
    centre = cloud.centre_points.mean(axis=0)
    normals, values = constraints._wedges(cloud, places, kappa * cloud.tangent_sd, centre)
    found = [
        not misses(body, cloud.rod_radius, n, v + n @ centre) for n, v in zip(normals[1:], values[1:], strict=True)
    ]
    return sum(found), len(found)


def misses(body, radius, normals, values):
    """Whether a convex body misses a wedge: it does if, and only if, a mean of the wedge's planes does not cut it."""
    rng = np.random.default_rng(0)
    share, width = np.concatenate([rng.dirichlet(np.ones(4), size=60), np.eye(4)]), 0.3
    while width > 1e-6:
        mean = share @ normals
        size = np.linalg.norm(mean, axis=1)
        beyond = size * (body.support(mean / size[:, None]) + radius) - share @ values
        if beyond.min() <= 1e-9:
            return True
        share = np.abs(share[beyond.argmin()] + width * rng.normal(size=(60, 4)))
        share, width = share / share.sum(axis=1, keepdims=True), 0.7 * width
    return False


def test_the_body_reaches_into_no_wedge():
    for seed in range(4):
        body, cloud = noisy_cloud(seed, 600)
        kappa = allowed(cloud).kappa
        found, of = entered(body, cloud, kappa)
        assert found == 0
        assert of > 400
    # the errors matter: with a third of them the body would
    assert entered(body, cloud, kappa / 4)[0] > 0.005 * of


@pytest.mark.slow
def test_the_triangles_bound_the_body():
    body, cloud = noisy_cloud(0)
    bounds = enclosure(cloud)
    assert bounds.confidence == 0.95
    true = largest_difference(bounds.inner, body)
    assert true <= bounds.bound < 0.05 * body.size
    # errors alike in all directions, of the size of those along the rod, leave far more
    alike = dataclasses.replace(cloud, centre_covariance=None)
    assert enclosure(alike).bound > 2 * bounds.bound
    outer = ConvexHull(bounds.corners)
    u = outer.equations[:, :3]
    assert (body.support(u) + cloud.rod_radius <= -outer.equations[:, 3] + 1e-9).all()


@pytest.mark.trust
@pytest.mark.parametrize("block", range(10))
def test_sixty_noisy_clouds_are_bounded(block):
    for seed in range(6 * block, 6 * block + 6):
        body, cloud = noisy_cloud(seed, (400, 1000, 2500)[seed % 3])
        bounds = enclosure(cloud)
        assert bounds.bound >= largest_difference(bounds.inner, body)
        assert entered(body, cloud, allowed(cloud).kappa)[0] == 0
