"""Bounds under noise: what noisy contacts prove holds of the true body, and is not much wider than it need be."""

import dataclasses
import functools

import numpy as np
import pytest
import trimesh
from sample_bodies import MESHES
from scipy.signal import lfilter

import planar
import scan3d
from scan3d.bounds.constraints import allowed, sigmas
from scan3d.bounds.noise import averages_of, beyond, confident
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import hull
from scan3d.geometry.sections import slice_polygons
from scan3d.pipeline import analyse
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.errors import independent
from scan3d.reconstruction.slices import stacks
from scan3d.recording import of_rows
from scan3d.simulation.rig import pink_noise
from scan3d.surfaces import enclosure

pytestmark = pytest.mark.slow


@functools.cache
def scanned(name, noise, seed=1, slices=16, **plan):
    mesh = scan3d.load_mesh(MESHES / name)
    recording = scan3d.simulate(mesh, scan3d.Plan(slices=slices, friction=0.3, noise=noise, seed=seed, **plan))
    return mesh, recording, scan3d.reconstruct(recording)


def test_errors_stay_within_the_standard_deviations_that_are_allowed():
    """Of the errors of 100 contacts in all directions, the longest is longer in fewer than 5 % of all draws."""
    longest = np.linalg.norm(np.random.default_rng(0).normal(size=(4000, 100, 3)), axis=2).max(axis=1)
    assert 0.001 < (longest > sigmas(100)).mean() < 0.05
    assert sigmas(100) < sigmas(100_000) < 7.0
    assert sigmas(100, 0.5) < sigmas(100, 0.95) < sigmas(100, 0.999)


BODIES = ("egg.stl", "cube.stl", "pebble.obj", "needle.ply")


@pytest.mark.parametrize("names", [BODIES[:1], pytest.param(BODIES, marks=pytest.mark.trust)])
def test_contacts_and_normals_lie_within_what_is_stated_of_them(names):
    """95 % in their ellipses in the slice's plane, those of the tip, along the rod and of each tenth by force as well, and of
    the tangential contacts' normals within 1.96 standard deviations.  By chance a share of 1000 contacts is off by 0.7 %."""
    every, tenths = [], []
    for name in names:
        mesh = scan3d.load_mesh(MESHES / name)
        # heights that do not depend on the noise
        plan = scan3d.Plan(slices=24, spacing="cosine", friction=0.3)
        exact = contacts(scan3d.simulate(mesh, plan))
        for seed, noise in enumerate((1e-5, 1e-4, 1e-3)):
            noisy = contacts(scan3d.simulate(mesh, dataclasses.replace(plan, noise=noise, seed=seed)))
            _, rows, true = np.intersect1d(noisy.row, exact.row, return_indices=True)
            error = (noisy.points[rows] - exact.points[true])[:, :2]
            inverse = np.linalg.inv(noisy.covariance[rows][:, :2, :2])
            inside = np.einsum("ni,nij,nj->n", error, inverse, error) < -2 * np.log(0.05)
            n, m = noisy.in_plane_normals[rows], exact.in_plane_normals[true]
            turned = np.arctan2(n[:, 1] * m[:, 0] - n[:, 0] * m[:, 1], (n * m).sum(axis=1))
            slides = noisy.phase[rows] == planar.Phase.TANGENTIAL
            both = slides & (exact.phase[true] == planar.Phase.TANGENTIAL)
            every.append(
                (inside, inside[~slides], inside[slides], (np.abs(turned) < 1.96 * noisy.normal_sd[rows])[both])
            )
            by_force = np.argsort(exact.force_N[true])
            tenths.append([inside[part] for part in np.array_split(by_force, 10)])
            assert all(len(part) < 1000 or 0.93 <= part.mean() <= 0.97 for part in every[-1]), (name, noise)
    for parts in (*zip(*every, strict=True), *zip(*tenths, strict=True)):
        assert 0.93 <= np.concatenate(parts).mean() <= 0.97


@pytest.mark.parametrize(
    ("name", "noise"),
    [
        ("cube.stl", 1e-3),
        ("pebble.obj", 1e-5),
        *(pytest.param(*case, marks=pytest.mark.trust) for case in (("egg.stl", 1e-4), ("needle.ply", 1e-3))),
    ],
)
def test_the_section_lies_between_the_polygons(name, noise):
    mesh, _, cloud = scanned(name, noise)
    (stack,) = stacks(cloud)
    proven = confident(stack, cloud, allowed(cloud))
    assert proven.confident
    assert len(proven.slices) >= len(stack.slices) - 2
    contours = slice_polygons(mesh, stack.frame, proven.heights)
    for slice_, contour in zip(proven.slices, contours, strict=True):
        normals = np.stack([np.cos(slice_.angle), np.sin(slice_.angle)], axis=1)
        support = (normals @ contour.T).max(axis=1)
        rounding = 1e-9 * np.ptp(contour)
        assert len(slice_.angle) >= 3
        assert (slice_.value >= support - rounding).all()
        assert ((normals @ slice_.points.T).max(axis=1) <= support + rounding).all()


def test_a_mean_of_contacts_lies_as_close_as_its_covariance_says():
    """The rows that are averaged do not depend on the errors, so that the errors of the mean are those of the sum."""
    _, _, cloud = scanned("cube.stl", 1e-4)
    (stack,) = stacks(cloud)
    slice_ = stack.slices[3]
    order = np.lexsort((cloud.row[slice_.rows], cloud.sweep[slice_.rows]))
    rows = slice_.rows[order]
    covariance = np.einsum("ij,njk,lk->nil", stack.frame[:2], cloud.covariance[rows], stack.frame[:2])
    averages = averages_of(slice_.points[order], cloud.sweep[rows], np.ones(len(rows)), 5.0)
    expected = np.zeros((len(averages.kappa), 2, 2))
    np.add.at(expected, averages.group, averages.weight[:, None, None] ** 2 * covariance[averages.row])
    np.testing.assert_allclose(averages.variance(covariance), expected)


def test_means_of_rounded_numbers_are_no_more_accurate():
    """Of 500 samples of 8 bit many have the same error; their means were taken for accurate, and false."""
    mesh = trimesh.convex.convex_hull(np.random.default_rng(24).standard_normal((4, 3)) * 10)
    recording = scan3d.simulate(mesh, scan3d.Plan(slices=4, sweeps=4, samples=500, spacing="uniform"))
    steps = (2.0**-7 * np.abs(recording.force_N).max(), 2.0**-7 * np.abs(recording.moment_Nm).max())
    log = dataclasses.replace(
        recording,
        force_N=steps[0] * np.round(recording.force_N / steps[0]),
        moment_Nm=steps[1] * np.round(recording.moment_Nm / steps[1]),
    )
    cloud = scan3d.reconstruct(log)
    assert not cloud.independent
    assert nearest(np.asarray(enclosure(cloud).inner.vertices), mesh)[0].max() <= 0
    by_means = enclosure(dataclasses.replace(cloud, independent=True)).inner
    assert nearest(np.asarray(by_means.vertices), mesh)[0].max() > 0
    assert len(averages_of(cloud.points, None, np.ones(len(cloud)), 5.0).kappa) == 0


def with_errors(recording, errors):
    """The recording of a plane with other errors (n, 3) of force and moment, in their standard deviations."""
    sd = np.array([recording.noise_force_N] * 2 + [recording.noise_moment_Nm])
    return dataclasses.replace(
        recording,
        force_N=recording.force_N + sd[:2] * errors[:, :2],
        moment_Nm=recording.moment_Nm + sd[2] * errors[:, 2],
    )


@functools.cache
def exact_with_stated(noise=1e-3):
    """A right recording without errors that states noise, with rows before its touches."""
    mesh, noisy, _ = scanned("egg.stl", noise, slices=8, samples=200, clearance=0.6)
    exact = scanned("egg.stl", 0.0, slices=8, samples=200, clearance=0.6)[1]
    return mesh, dataclasses.replace(exact, noise_force_N=noisy.noise_force_N, noise_moment_Nm=noisy.noise_moment_Nm)


SHARED = {
    "1/f noise": lambda white, draw: np.stack([pink_noise(len(white), draw) for _ in range(3)], axis=1),
    "a low-pass": lambda white, draw: 2 * lfilter([0.25], [1, -0.75], white, axis=0),
    "a zero off": lambda white, draw: white + np.array([0.5, 0.5, -0.5]),
}


@pytest.mark.parametrize("name", SHARED)
def test_errors_that_successive_rows_share_are_seen_in_the_air(name):
    """Their means were taken for those of independent ones: with 1/f noise the inner body stood out of the true one."""
    mesh, exact = exact_with_stated()
    draw = np.random.default_rng(4)
    cloud = contacts(with_errors(exact, SHARED[name](draw.standard_normal((len(exact), 3)), draw)))
    assert not cloud.independent
    assert nearest(np.asarray(enclosure(cloud).inner.vertices), mesh)[0].max() <= 0


@pytest.mark.parametrize("noise", [1e-4, 1e-2])
def test_independent_errors_are_taken_for_independent(noise):
    """Touches too light to be felt, of which large noise hides many, are no errors, nor is a wild value."""
    _, exact = exact_with_stated(noise)
    for seed in range(20):
        errors = np.random.default_rng(seed).standard_normal((len(exact), 3))
        errors[7 * seed] *= 30
        assert independent(with_errors(exact, errors))


@pytest.mark.parametrize("count", range(1, 7))
def test_a_few_rows_have_contacts(count):
    """Whose errors nothing in the air shows."""
    _, exact = exact_with_stated()
    pressed = np.flatnonzero(np.abs(exact.force_N[:, 0]) > 0.3 * np.abs(exact.force_N).max())
    cloud = contacts(of_rows(exact, pressed[:count]))
    assert (len(cloud), cloud.independent) == (count, True)


def test_the_part_of_a_polygon_beyond_a_line():
    square = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    normals, tangents = np.array([[1.0, 0], [1, 0], [1, 0]]), np.array([[0.0, 1], [0, 1], [0, 1]])
    points, offset = np.array([[0.5, 0.25], [1.0, 0], [2.0, 0]]), np.array([0.5, 1.0, 2.0])
    extent, height = beyond(square, points, normals, tangents, offset)
    np.testing.assert_allclose(extent, [1.25, 1.0, 0.0])
    np.testing.assert_allclose(height, [0.5, 0.0, 0.0])
    diagonal = np.array([[np.sqrt(0.5), np.sqrt(0.5)]])
    extent, height = beyond(
        square, np.array([[0.5, 0.5]]), diagonal, diagonal[:, ::-1] * [-1, 1], np.array([np.sqrt(0.5)])
    )
    np.testing.assert_allclose(extent, np.sqrt(0.5))
    np.testing.assert_allclose(height, np.sqrt(0.5))


@pytest.mark.parametrize(
    ("name", "noise"), [("cube.stl", 1e-3), pytest.param("egg.stl", 1e-4, marks=pytest.mark.trust)]
)
def test_the_bound_is_at_most_five_times_the_least_one_that_holds(name, noise):
    """The hull of the true contacts is a body with the same contacts, so that the surface may lie as far from the body as from
    that hull, however close to the body it does lie."""
    # heights that do not depend on the noise
    mesh, recording, _ = scanned(name, noise, slices=10, spacing="cosine")
    touched = hull(scanned(name, 0.0, slices=10, spacing="cosine")[2].points)
    analysis = analyse(recording, mesh)
    bounds, bound, truth = analysis.bounds, analysis.certificate.bound, analysis.comparison.hausdorff
    least = float(nearest(np.asarray(analysis.surface.vertices), touched)[0].max())
    assert max(least, truth) <= bound <= 5 * max(least, truth)
    assert bounds.bound <= 5 * nearest(np.asarray(mesh.vertices), bounds.inner)[0].max()
    # five times the truth itself would be less than the least bound
    assert least > 5 * truth


def test_a_slice_with_a_force_but_no_contact_is_not_empty():
    """It would bound the body's height."""
    mesh = scan3d.load_mesh(MESHES / "egg.stl")
    recording = scan3d.simulate(mesh, scan3d.Plan(slices=12, friction=0.3, samples=40))
    (stack,) = stacks(contacts(recording))
    assert np.isfinite(stack.ceiling)
    heights = recording.position_m[:, 2] * 1e3
    above = heights > stack.heights[-1] + 1e-6
    assert above.any()
    # a force along the rod alone, which no bent rod has
    pushed = dataclasses.replace(
        recording, force_N=recording.force_N + np.where(above, 1e-3, 0.0)[:, None] * [0.0, 1.0]
    )
    (stack,) = stacks(contacts(pushed))
    assert np.isinf(stack.ceiling)
