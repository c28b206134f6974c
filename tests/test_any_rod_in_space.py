"""Tapered, curved, twisted and heavy rods in space, against reference values, DOP853 with rotation matrices and the plane."""

import numpy as np
import pytest
import scipy

import planar
from planar.rods import Profile
from scan3d.spatial import inverse, march
from scan3d.spatial.march import SpatialRod

CONE = Profile(diameters=(1.0, 0.5))
CURLED = SpatialRod(CONE, (-0.3, 0.2, 0.5), 0.77)
HEAVY = SpatialRod(Profile((0.0, 0.4, 1.0), (1.0, 0.8, 0.5), 0.3), (-0.3, 0.2, 0.5), 0.77, 0.05)
# as heavy as a rod that a force of its own stiffness bends
HEAVIEST = SpatialRod(Profile(diameters=(1.0, 0.7), weight=1.0), (-0.3, 0.2, 0.5), 0.77)
DOWN = np.array([0.48, -0.6, 0.64])


def test_reference_values():
    # by DOP853 with rotation matrices at a relative tolerance of 1e-12
    moment = np.array([[0.092790955710], [-0.017833374684], [0.089214712881]])
    found = march.contacts(CURLED, np.array([[-0.10], [0.08], [0.12]]), moment)
    np.testing.assert_allclose(found.s1, 0.8, atol=1e-10)
    np.testing.assert_allclose(found.point[:, 0], [0.134918185975, 0.784212580034, 0.016431923673], atol=1e-10)
    np.testing.assert_allclose(found.tangent[:, 0], [0.335367096958, 0.941635608555, 0.029176891180], atol=1e-10)
    np.testing.assert_allclose([found.torsion, found.skew], 0.0, atol=1e-10)


def integrated(rod, force, down, state, ends):
    """``r, R, M`` (3 + 9 + 3,) in the clamp's frame by DOP853, from s = ends[0] to ends[1]."""

    def rates(s, values):
        frame, moment = values[3:12].reshape(3, 3), values[12:]
        stiffness = rod.profile.bending_stiffness(s) * np.array([1, 1, rod.torsion])
        turn = frame @ (frame.T @ moment / stiffness + rod.curvature)
        carried = force + rod.profile.weight_past(np.array(s)) * down
        return np.concatenate([frame[:, 2], np.cross(turn, frame.T).T.ravel(), -np.cross(frame[:, 2], carried)])

    cuts = [ends[0], *(s for s in rod.profile.knots if min(ends) < s < max(ends)), ends[1]]
    for low, high in zip(cuts[:-1], cuts[1:], strict=True):
        state = scipy.integrate.solve_ivp(rates, (low, high), state, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return state


def clamped(rod, moment):
    turn = scipy.spatial.transform.Rotation.from_rotvec(rod.compliance * moment)
    frame = turn.as_matrix() @ np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    return np.concatenate([np.zeros(3), frame.ravel(), moment])


@pytest.mark.slow
@pytest.mark.parametrize(("rod", "down"), [(CURLED, np.zeros(3)), (HEAVY, DOWN), (HEAVIEST, DOWN)])
def test_integrated_rods_are_found(rod, down):
    # rods are shot so that they carry no moment behind a contact at a given place, and their reactions are read back
    rng = np.random.default_rng(3)
    for _ in range(2):
        s1, force = rng.uniform(0.25, 0.95), rng.normal(size=3) * [0.25, 0.1, 0.25]

        def ends(moment, s1=s1, force=force):
            contact = integrated(rod, force, down, clamped(rod, moment), (0.0, s1))
            return contact, integrated(rod, np.zeros(3), down, contact, (s1, 1.0))

        guess = np.cross([0, s1, 0], force) + rod.profile.weight * np.cross([0, 0.4, 0], down)
        shot = scipy.optimize.root(lambda moment: ends(moment)[1][12:], guess, tol=1e-13)
        assert np.abs(shot.fun).max() < 1e-10
        contact = ends(shot.x)[0]
        reaction = -force - rod.profile.weight * down
        found = march.contacts(rod, reaction[:, None], -shot.x[:, None], down[:, None])
        np.testing.assert_allclose(found.s1, s1, atol=1e-9)
        np.testing.assert_allclose(found.point[:, 0], contact[:3], atol=1e-9)
        np.testing.assert_allclose(found.tangent[:, 0], contact[3:12].reshape(3, 3)[:, 2], atol=1e-9)
        np.testing.assert_allclose(found.force[:, 0], force, atol=1e-12)
        np.testing.assert_allclose([found.torsion, found.skew], 0.0, atol=1e-9)


@pytest.mark.parametrize("rod", [CURLED, SpatialRod(Profile((0.0, 1.0), (1.0, 0.6)))])
def test_reactions_that_contradict_a_single_force_have_the_place_of_the_least_excess(rod):
    rng = np.random.default_rng(1)
    force = np.array([[-0.10, 0.08, 0.12]]).T + 0.02 * rng.normal(size=(3, 4))
    moment = np.array([[0.0928, -0.0178, 0.0892]]).T + 0.01 * rng.normal(size=(3, 4))
    found = march.contacts(rod, force, moment)
    assert (np.abs(found.skew) > 1e-5).all()
    for k in range(4):
        state = clamped(rod, -moment[:, k])

        def turning(s, k=k, state=state):
            at = integrated(rod, -force[:, k], np.zeros(3), state, (0.0, s))
            return at[12:] @ np.cross(at[3:12].reshape(3, 3)[:, 2], -force[:, k])

        s1 = scipy.optimize.brentq(turning, found.s1[k] - 0.05, found.s1[k] + 0.05, xtol=1e-12)
        np.testing.assert_allclose(found.s1[k], s1, atol=1e-9)


PLANAR = [
    planar.Rod(tip_diameter=0.5),
    planar.Rod(tip_diameter=0.6, curvature=-0.3, compliance=0.02),
    planar.Rod(tip_diameter=0.6, weight=0.3, gravity=(0.3, -1)),
]


@pytest.mark.slow
@pytest.mark.parametrize("rod", PLANAR)
def test_rods_in_a_plane_are_those_of_planar(rod):
    circle = planar.Circle(radius=0.9, center=(0.0, 1.3))
    swept = planar.sweep(circle, 0.3, samples=40, rod=rod)
    rows = np.flatnonzero(swept.phase != planar.Phase.NONE)[2:]
    # the plane is turned about the rod, and gravity with it
    for turn in (0.0, 1.0, 2.5):
        turned = np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
        zero = np.zeros(len(rows))
        force = turned @ np.stack([swept.f0x[rows], swept.f0y[rows], zero])
        moment = turned @ np.stack([zero, zero, swept.m0z[rows]])
        about = turned @ [0.0, 0.0, rod.curvature]
        # the material frame at the clamp is d1 = z, d2 = x, d3 = y
        spatial = SpatialRod(rod.profile, (about[2], about[0], about[1]), 0.77, rod.compliance)
        found = march.contacts(spatial, force, moment, (turned @ [*rod.down, 0.0])[:, None])
        point = turned.T @ found.point
        np.testing.assert_allclose(point[0] + swept.x0[rows], swept.point[rows, 0], atol=1e-9)
        np.testing.assert_allclose(point[1:], [swept.point[rows, 1], zero], atol=1e-9)
        np.testing.assert_allclose([found.torsion, found.skew], 0.0, atol=1e-9)


def test_the_straight_uniform_rod_is_that_of_the_closed_form():
    rng = np.random.default_rng(3)
    force, moment = rng.normal(size=(2, 200, 3)) * [[[0.4, 0.2, 0.4]], [[0.4, 0.0, 0.4]]]
    moment -= force * ((force * moment).sum(axis=1) / (force**2).sum(axis=1))[:, None]  # of a single force
    moment[:, 1] = 0
    moment[:, 2] = -force[:, 0] * moment[:, 0] / force[:, 2]
    known = inverse.reconstruct(force, moment)
    ok = known.status == inverse.Status.OK
    assert ok.sum() > 20
    found = march.contacts(SpatialRod(), force[ok].T, moment[ok].T)
    np.testing.assert_allclose(found.s1, known.s1[ok], atol=1e-9)
    np.testing.assert_allclose(found.point.T, known.point[ok], atol=1e-9)
    np.testing.assert_allclose(found.tangent.T, known.tangent[ok], atol=1e-9)


def test_reactions_of_the_free_rod():
    f0, m0 = (part[:, 0] for part in march.free_reactions(HEAVY, DOWN[:, None]))
    np.testing.assert_allclose(f0, -HEAVY.profile.weight * DOWN)
    tip = integrated(HEAVY, np.zeros(3), DOWN, clamped(HEAVY, -m0), (0.0, 1.0))
    np.testing.assert_allclose(tip[12:], 0.0, atol=1e-10)


def test_residuals_have_the_noise_of_the_reactions():
    # two residuals for four unknowns and six reactions: their sum of squares over the variances has the mean 2
    rng, sigma = np.random.default_rng(1), 1e-4
    force = np.tile([[-0.10], [0.08], [0.12]], (1, 2000))
    moment = np.tile([[0.092790955710], [-0.017833374684], [0.089214712881]], (1, 2000))
    found = march.contacts(
        CURLED, force + rng.normal(0, sigma, force.shape), moment + rng.normal(0, sigma, force.shape)
    )
    residuals = np.stack([found.torsion, found.skew / np.linalg.norm([0.10, 0.08, 0.12])])
    one = np.cov(residuals)
    assert np.linalg.norm(residuals.mean(axis=1)) < 6 * np.sqrt(np.trace(one) / 2000)
    assert 0.5 * sigma < np.sqrt(one[0, 0]) < 4 * sigma
    assert 0.5 * sigma < np.sqrt(one[1, 1]) < 4 * sigma


def test_a_weight_needs_gravity():
    with pytest.raises(ValueError, match="needs the direction of gravity"):
        march.contacts(HEAVY, np.ones((3, 1)), np.ones((3, 1)))
    with pytest.raises(ValueError, match="bends too much under it"):
        march.free_reactions(SpatialRod(Profile(weight=6.0)), DOWN[:, None])


def test_contacts_and_statuses():
    force, moment = [-0.10, 0.08, 0.12], [0.092790955710, -0.017833374684, 0.089214712881]
    rows = np.array([force, [0, 0, 0], force, [np.nan, 0, 0], np.array(force) * 0.5, force])
    moments = np.array([moment, moment, np.array(moment) * 40, moment, moment, moment])
    found = inverse.reconstruct(rows, moments, rod=CURLED, tolerance=1e-9)
    Status = inverse.Status
    assert found.status[[0, 1, 3, 5]].tolist() == [Status.OK, Status.NO_FORCE, Status.NO_FORCE, Status.OK]
    assert found.status[2] != Status.OK
    assert found.status[4] in (Status.BEYOND_TIP, Status.NO_ROD)
    assert np.isnan(found.point[1:5]).all()
    assert found.phase[0] == planar.Phase.TANGENTIAL
    along = (found.force[0] * found.tangent[0]).sum() / np.linalg.norm(force)
    np.testing.assert_allclose(np.sin(found.friction_angle_bound[0]), along)
    straight = inverse.reconstruct(rows[:1], moments[:1], rod=SpatialRod())
    np.testing.assert_array_equal(straight.point, inverse.reconstruct(rows[:1], moments[:1]).point)


@pytest.mark.slow
@pytest.mark.parametrize("rod", [CURLED, HEAVY])
def test_stated_errors_are_those_of_noisy_reactions(rod):
    rng, noise = np.random.default_rng(2), (1e-4, 2e-4)
    force, moment = np.array([-0.10, 0.08, 0.12]), np.array([0.092790955710, -0.017833374684, 0.089214712881])
    if rod is HEAVY:
        force, moment = force - rod.profile.weight * DOWN, moment + march.free_reactions(rod, DOWN[:, None])[1][:, 0]
    gravity = np.tile(DOWN, (400, 1))
    f0 = force + rng.normal(0, noise[0], (400, 3))
    m0 = moment + rng.normal(0, noise[1], (400, 3))
    found = inverse.reconstruct(f0, m0, rod=rod, gravity=gravity, tolerance=0.2)
    stated = inverse.errors(force[None], moment[None], noise, rod=rod, gravity=gravity[:1])
    apart = found.point - found.point.mean(axis=0)
    np.testing.assert_allclose(np.sqrt((apart**2).sum(axis=1).mean()), np.sqrt(np.trace(stated.point[0])), rtol=0.15)
    np.testing.assert_allclose(found.s1.std(), stated.s1[0], rtol=0.15)
    np.testing.assert_allclose(found.friction_angle_bound.std(), stated.beta[0], rtol=0.15)
    # the direction of the contact's force, beside the weight
    pull = -f0 - rod.profile.weight * DOWN
    mean = -force - rod.profile.weight * DOWN
    turned = pull / np.linalg.norm(pull, axis=1)[:, None] - mean / np.linalg.norm(mean)
    np.testing.assert_allclose(np.sqrt((turned**2).sum(axis=1).mean()), stated.force[0], rtol=0.15)


def test_a_force_without_a_moment_does_not_bend_a_straight_rod_whatever_its_taper():
    for rod in (None, SpatialRod(compliance=0.01), SpatialRod(Profile(diameters=(1.0, 0.5)))):
        assert inverse.reconstruct([[1.0, 1.0, 0.0]], [[0.0] * 3], rod=rod).status == inverse.Status.NO_MOMENT


def test_errors_of_the_straight_uniform_rod_are_those_of_the_closed_form():
    swept = planar.sweep(planar.Circle(radius=0.9, center=(0.0, 1.3)), 0.3, samples=20)
    zero = 0 * swept.x0[3:-1]
    f0 = np.stack([swept.f0x[3:-1], swept.f0y[3:-1], zero], axis=1)
    m0 = np.stack([zero, zero, swept.m0z[3:-1]], axis=1)
    noise = (1e-4, 1e-4)
    closed = inverse.errors(f0, m0, noise)
    differences = inverse.errors(f0, m0, noise, rod=SpatialRod(compliance=1e-13))
    np.testing.assert_allclose(differences.s1, closed.s1, rtol=0.02)
    np.testing.assert_allclose(differences.beta, closed.beta, rtol=0.02)
