"""The inverse in space: reference values, invariances, limits, errors and impossible rows."""

import numpy as np
import pytest
from rods_in_space import FRICTION_03, FRICTIONLESS, table
from scipy.spatial.transform import Rotation
from shapes import unit

import planar
from scan3d.spatial.inverse import Status, errors, reconstruct


def parts(text):
    """x0, r1, s1, f0, and (m0x, m0z) of each row of reference values."""
    return [(row[0], row[1:4], row[4], row[5:8], row[8:]) for row in table(text)]


@pytest.fixture(scope="module")
def reactions():
    """Reactions of tangential and tip contacts in bending planes at random angles, and the contacts in these planes."""
    swept = planar.sweep(planar.Circle(0.9, (0.0, 1.3)), 0.3, samples=400)
    rows = slice(1, -1)
    omega = np.random.default_rng(3).uniform(-np.pi, np.pi, 400)[rows]
    f0x, f0y, m0z = swept.f0x[rows], swept.f0y[rows], swept.m0z[rows]
    force = np.stack([f0x * np.cos(omega), f0y, f0x * np.sin(omega)], axis=1)
    moment = np.stack([-m0z * np.sin(omega), 0 * m0z, m0z * np.cos(omega)], axis=1)
    return force, moment, omega, planar.reconstruct(np.zeros_like(f0x), f0x, f0y, m0z)


# The seventh digit of the reactions is rounded, and the contact follows from them with a condition of some 2 to 20.
@pytest.mark.parametrize(("rows", "digits"), [(parts(FRICTIONLESS), 2e-7), (parts(FRICTION_03), 2e-6)])
def test_the_reference_values_return(rows, digits):
    for x0, r1, s1, f0, (m0x, m0z) in rows:
        found = reconstruct([f0], [(m0x, 0.0, m0z)])
        assert found.status[0] == Status.OK
        assert found.phase[0] == planar.Phase.TANGENTIAL
        np.testing.assert_allclose(found.point[0] + [x0, 0, 0.1125], r1, rtol=0, atol=digits)
        assert found.s1[0] == pytest.approx(s1, abs=digits)
        assert abs(found.skew[0]) < 3 * digits


def test_frictionless_reference_contacts_have_the_ellipsoids_normal():
    for x0, r1, _, f0, (m0x, m0z) in parts(FRICTIONLESS):
        found = reconstruct([f0], [(m0x, 0.0, m0z)])
        # below the body's centre (0, 1.075, 0); the force on the rod is along the outward normal
        normal = unit((np.array(r1) - [0, 1.075, 0]) / np.square([0.9, 0.675, 0.45]))
        np.testing.assert_allclose(found.force[0] / np.linalg.norm(found.force[0]), normal, atol=1e-6)
        assert abs(found.friction_angle_bound[0]) < 1e-6
        assert x0 > 0


def test_in_every_bending_plane_the_planar_inverse_returns(reactions):
    force, moment, omega, plane = reactions
    found = reconstruct(force, moment)
    np.testing.assert_array_equal(found.phase, plane.phase)
    across = (found.point * np.stack([np.cos(omega), 0 * omega, np.sin(omega)], axis=1)).sum(axis=1)
    np.testing.assert_allclose(across, plane.point[:, 0], atol=2e-13)
    np.testing.assert_allclose(found.point[:, 1], plane.point[:, 1], atol=2e-13)
    np.testing.assert_allclose(found.s1, plane.s1, atol=2e-13)
    np.testing.assert_allclose(found.friction_angle_bound, plane.friction_angle_bound, atol=2e-12)
    np.testing.assert_allclose(np.exp(1j * found.bending_angle), np.exp(1j * omega), atol=1e-13)
    assert np.abs(found.torsion).max() == 0
    assert np.abs(found.skew).max() < 1e-13


def test_turning_the_clamp_about_its_axis_turns_the_contact(reactions):
    force, moment, _, _ = reactions
    turn = Rotation.from_rotvec([0, 1.234, 0])
    found, turned = reconstruct(force, moment), reconstruct(turn.apply(force), turn.apply(moment))
    for name in ("point", "tangent", "bending"):
        np.testing.assert_allclose(getattr(turned, name), turn.apply(getattr(found, name)), atol=1e-12)
    np.testing.assert_allclose(turned.s1, found.s1, atol=1e-13)


def test_the_mirror_image_has_the_mirrored_contact(reactions):
    force, moment, _, _ = reactions
    mirror = np.array([1, 1, -1])
    found, mirrored = reconstruct(force, moment), reconstruct(force * mirror, -moment * mirror)
    np.testing.assert_allclose(mirrored.point, found.point * mirror, atol=1e-14)
    np.testing.assert_allclose(mirrored.tangent, found.tangent * mirror, atol=1e-14)


def test_a_shorter_rod_of_the_same_stiffness_has_the_same_contact(reactions):
    """The part of a rod past its contact bears nothing: scaled by s1, a tangential contact becomes a tip contact."""
    force, moment, _, _ = reactions
    found = reconstruct(force, moment)
    s1 = found.s1[:, None]
    scaled = reconstruct(force * s1**2, moment * s1)
    np.testing.assert_allclose(scaled.s1, 1, atol=1e-13)
    assert (scaled.phase == planar.Phase.TIP).all()
    np.testing.assert_allclose(scaled.point * s1, found.point, atol=1e-13)


def test_rows_without_a_contact_say_why():
    rows = {
        ((0, 0, 0), (0, 0, 0)): Status.NO_FORCE,
        ((0, 0, 0), (0, 0, 1)): Status.NO_FORCE,
        ((np.nan, 1, 0), (0, 0, 1)): Status.NO_FORCE,
        ((1, 1, 0), (0, np.inf, 1)): Status.NO_FORCE,
        ((-1, 1, 0), (0, 0, 0)): Status.NO_MOMENT,
        ((0, 2, 0), (0, 1, 0)): Status.NO_MOMENT,
        ((0, -2, 0), (0, 0, 0.1)): Status.NO_ROD,
        ((-1, 0, 0), (0, 0, 9)): Status.NO_ROD,
        ((-0.1, 0, 0), (0, 0, 0.2)): Status.BEYOND_TIP,
    }
    force, moment = (np.array([row[i] for row in rows], dtype=float) for i in (0, 1))
    for noise in (None, (1e-3, 1e-3), (1e-3, 0.0), (0.0, 1e-3)):
        found = reconstruct(force, moment, noise=noise)
        assert [Status(code) for code in found.status] == list(rows.values())
        assert (found.phase == planar.Phase.NONE).all()
        assert np.isnan(found.point).all()
        assert all(Status(code).sentence for code in found.status)


def test_huge_tiny_and_random_numbers_give_a_status_and_never_an_exception():
    rng = np.random.default_rng(5)
    n = 20_000
    values = rng.normal(size=(n, 6)) * 10.0 ** rng.integers(-320, 308, (n, 1))
    with np.errstate(over="ignore"):
        values *= 10.0 ** rng.integers(-8, 8, (n, 6))
    special = np.array([0.0, -0.0, np.nan, np.inf, -np.inf, 5e-324, 1.7e308, -1.7e308, 1.0])
    mixed = rng.random((n, 6)) < 0.2
    values[mixed] = rng.choice(special, mixed.sum())
    for noise in (None, (1e-3, 1e-4)):
        found = reconstruct(values[:, :3], values[:, 3:], noise=noise)
        good = found.status == Status.OK
        assert np.isfinite(found.point[good]).all()
        assert np.isnan(found.point[~good]).all()
        assert (found.s1[good] <= 1 + 1e-9).all()
        np.testing.assert_allclose(np.linalg.norm(found.tangent[good], axis=1), 1, atol=1e-9)
    errors(values[:, :3], values[:, 3:], (1e-3, 1e-4))


@pytest.mark.parametrize("scale", [1e-120, 1e-30])
def test_tiny_reactions_near_touch_down_keep_their_digits(scale):
    """Force and moment vanish together at touch-down: their quotient is the contact's place."""
    found = reconstruct([(-0.6 * scale, 0, -0.8 * scale)], [(-0.8 * 0.7 * scale, 0, 0.6 * 0.7 * scale)])
    assert found.status[0] == Status.OK
    assert found.s1[0] == pytest.approx(0.7, rel=1e-12)
    np.testing.assert_allclose(found.point[0], [0, 0.7, 0], atol=1e-12)


@pytest.mark.parametrize("noise", [(1e-4, 1e-6), (1e-6, 1e-4), (1e-5, 0.0)])
def test_errors_are_those_of_monte_carlo(noise):
    rng = np.random.default_rng(7)
    rows, trials = [*parts(FRICTIONLESS)[::2], parts(FRICTION_03)[1]], 20_000
    for _, _, _, f0, (m0x, m0z) in rows:
        f0, m0 = np.array(f0), np.array([m0x, 0.0, m0z])
        known = errors(f0[None], m0[None], noise)
        force = f0 + noise[0] * rng.normal(size=(trials, 3))
        moment = m0 + noise[1] * rng.normal(size=(trials, 3))
        found = reconstruct(force, moment, noise=noise)
        covariance = np.cov(found.point.T)
        scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
        # the entries' sampling error is 1/√trials of the scale
        np.testing.assert_allclose(known.point[0] / scale, covariance / scale, atol=0.05)
        assert known.largest[0] == pytest.approx(np.sqrt(np.linalg.eigvalsh(covariance).max()), rel=0.03)
        assert known.s1[0] == pytest.approx(found.s1.std(), rel=0.03)
        assert known.beta[0] == pytest.approx(found.friction_angle_bound.std(), rel=0.03)
        tangent_error = np.sqrt(((found.tangent - found.tangent.mean(axis=0)) ** 2).sum(axis=1).mean())
        assert known.tangent[0] == pytest.approx(tangent_error, rel=0.03)


def test_force_and_moment_together_know_the_bending_plane_better_than_the_moment_alone():
    _, _, _, f0, (m0x, m0z) = parts(FRICTIONLESS)[2]
    rng = np.random.default_rng(8)
    force = f0 + 1e-5 * rng.normal(size=(4000, 3))
    moment = np.array([m0x, 0, m0z]) + 1e-4 * rng.normal(size=(4000, 3))
    together, alone = reconstruct(force, moment, noise=(1e-5, 1e-4)), reconstruct(force, moment)
    assert together.bending_angle.std() < 0.2 * alone.bending_angle.std()
