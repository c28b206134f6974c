"""The paper's statements about its circle, r = 0.9 at (0, 1.3), one by one.

L. Merker, J. Steigenberger, C. Behn, "Friction invariant object reconstruction using a vibrissa-inspired tactile sensor
concept", Section III.  Where the paper reads numbers off figures, the bounds here are as wide as such a reading allows.
"""

import numpy as np
import pytest

import planar
from planar import EventKind, NormalSource, Phase, Status

CIRCLE = planar.Circle(radius=0.9, center=(0.0, 1.3))
FRICTIONS = (0.0, 0.2, 0.4, 0.6)
INVARIANT = ("closed-form", "scholz-rahn")
# The paper's errors of the invariant method are "within numerical boundaries"; scholz-rahn integrates to 1e-10.
NUMERICAL = 1e-9
# From just after touch-down, where the force is still 0, to just before the first of the snap-offs.
BASE = np.linspace(0.845, -1.218, 200)


def sweep(friction):
    return planar.sweep(CIRCLE, friction, base=BASE)


def random_friction():
    return np.random.default_rng(50).uniform(0.0, 0.4, len(BASE))


@pytest.fixture(params=[*FRICTIONS, "random"])
def frictional(request):
    """Coefficients of friction (n,) and the sweep with them."""
    mu = random_friction() if request.param == "random" else np.full(len(BASE), request.param)
    return mu, sweep(mu)


def reconstruct(swept, method="closed-form", **options):
    return planar.reconstruct(*swept.reactions, method, **options)


# III-A: generating the support reactions


@pytest.mark.slow
def test_the_clamping_moment_consistently_increases_with_friction():
    moments = np.stack([sweep(mu).m0z for mu in np.linspace(0, 0.6, 13)])
    assert (np.diff(moments, axis=0) > 0).all()


def test_all_reactions_are_affected_by_friction():
    without, with_much = sweep(0.0), sweep(0.6)
    for name in ("f0x", "f0y", "m0z"):
        assert np.median(np.abs(getattr(with_much, name) - getattr(without, name))) > 0.1


@pytest.mark.slow
def test_more_friction_lengthens_the_contact_phase():
    ends = [planar.events(CIRCLE, mu).x0[-1] for mu in np.linspace(0, 0.6, 13)]
    assert (np.diff(ends) < 0).all()


def test_friction_has_little_impact_on_the_transitions():
    for kind in (EventKind.TO_TANGENTIAL, EventKind.TO_TIP):
        places = [planar.events(CIRCLE, mu).of(kind) for mu in FRICTIONS]
        assert all(len(place) == 1 for place in places)
        # over a sweep of two rod lengths
        assert np.ptp(places) < 0.03


def test_random_friction_leaves_the_moment_between_the_curves_of_its_bounds():
    moment = sweep(random_friction()).m0z
    assert (moment > sweep(0.0).m0z).all()
    assert (moment < sweep(0.4).m0z).all()


# III-B: reconstructing contact points


@pytest.mark.parametrize("method", INVARIANT)
def test_reconstruction_is_friction_invariant(method, frictional):
    _, swept = frictional
    contacts = reconstruct(swept, method)
    assert (contacts.status == Status.OK).all()
    assert CIRCLE.distance(contacts.point).max() < NUMERICAL
    assert np.linalg.norm(contacts.point - swept.point, axis=1).max() < NUMERICAL
    assert np.abs(contacts.s1 - swept.s1).max() < NUMERICAL


def test_friction_shifts_the_contacts_along_the_contour():
    shift = np.abs(sweep(0.6).slope - sweep(0.0).slope)
    assert np.median(shift) > np.radians(0.1)


def test_friction_slightly_enlarges_s1():
    sweeps = [sweep(mu) for mu in FRICTIONS]
    always = np.all([swept.phase == Phase.TANGENTIAL for swept in sweeps], axis=0)
    s1 = np.stack([swept.s1[always] for swept in sweeps])
    assert np.ptp(s1, axis=0).max() < 0.02
    assert (np.diff(s1, axis=0) > 0).all()


def test_equation_10_is_as_exact_without_friction_except_at_the_end():
    swept = sweep(0.0)
    contacts = reconstruct(swept, "will")
    error = CIRCLE.distance(contacts.point)
    assert error[swept.x0 > -1.15].max() < NUMERICAL
    assert error[-1] > 0.05


def test_the_error_of_equation_10_grows_with_friction():
    # in general, not everywhere: from 0.4 on it is undefined where it would be worst
    typical, mean = [], []
    for mu in FRICTIONS:
        contacts = reconstruct(sweep(mu), "will")
        error = CIRCLE.distance(contacts.point[contacts.status == Status.OK])
        typical.append(np.median(error))
        mean.append(error.mean())
    assert (np.diff(typical) > 0).all()
    assert (np.diff(mean) > 0).all()
    assert typical[1] > 1e-3


def test_equation_10_scatters_under_random_friction():
    swept = sweep(random_friction())
    contacts = reconstruct(swept, "will")
    good = contacts.status == Status.OK
    assert np.std(contacts.s1[good] - swept.s1[good]) > 1e-2


def test_equation_10_is_undefined_for_some_clamping_positions_from_a_threshold_on():
    for mu in FRICTIONS:
        undefined = reconstruct(sweep(mu), "will").status == Status.UNDEFINED
        assert undefined.any() == (mu >= 0.4)
        # at the beginning of the sweep: one interval, from the first sample
        assert (np.diff(undefined.astype(int)) <= 0).all()
        assert undefined[0] == (mu >= 0.4)
        assert not undefined[len(undefined) // 2 :].any()


def test_equation_10_is_no_criterion_for_the_kind_of_contact():
    # μ = 0: s1 < 1 in tip contact at the end of the sweep, from -1.1587 on, a reference value; μ > 0: no information
    swept = planar.sweep(CIRCLE, 0.0, samples=4000)
    mistaken = (swept.phase == Phase.TIP) & (reconstruct(swept, "will").s1 < 1 - 1e-9)
    step = swept.x0[0] - swept.x0[1]
    assert abs(swept.x0[mistaken].max() - -1.1587) <= 0.5e-4 + step
    assert mistaken[swept.x0 < -1.1587 - step].all()
    for mu in FRICTIONS[1:]:
        swept = sweep(mu)
        contacts = reconstruct(swept, "will")
        wrong = (contacts.status == Status.OK) & ((contacts.s1 < 1 - 1e-6) != (swept.phase == Phase.TANGENTIAL))
        assert wrong[swept.x0 > -1.1].mean() > 0.02


@pytest.mark.slow
@pytest.mark.parametrize("method", INVARIANT)
def test_s1_distinguishes_tip_from_tangential_contact_for_every_friction(method, frictional):
    # the future work of the paper: (10) adapted to be friction invariant
    _, swept = frictional
    contacts = reconstruct(swept, method, tolerance=1e-7 if method == "scholz-rahn" else planar.TOLERANCE)
    assert (contacts.phase == swept.phase).all()


# III-C: reconstructing friction parameters


def test_beta_is_the_friction_angle_in_tangential_contact_and_below_it_in_tip_contact(frictional):
    mu, swept = frictional
    contacts = reconstruct(swept)
    tangential = swept.phase == Phase.TANGENTIAL
    assert np.abs(contacts.friction_angle_bound - np.arctan(mu))[tangential].max() < NUMERICAL
    assert (contacts.friction_angle_bound < np.arctan(mu))[~tangential].all()
    assert np.abs(contacts.friction - mu)[tangential].max() < NUMERICAL
    assert np.isnan(contacts.friction[~tangential]).all()


def test_beta_is_what_12_says():
    swept = sweep(0.3)
    contacts = reconstruct(swept)
    f = np.hypot(swept.f0x, swept.f0y)
    assert np.abs(contacts.friction_angle_bound - np.arcsin((swept.m0z**2 - 2 * swept.f0y) / (2 * f))).max() < 1e-12


def test_the_contact_force_decomposes_into_its_normal_and_tangential_components(frictional):
    mu, swept = frictional
    is_tangential = swept.phase == Phase.TANGENTIAL
    contacts = reconstruct(swept)
    # the clamp holds against the contact: its reaction is the force's negative (8)
    force = -np.stack([swept.f0x, swept.f0y], axis=1)
    normal, tangential = contacts.normal_force, contacts.tangential_force
    assert np.abs(normal + tangential - force)[is_tangential].max() < 1e-12
    assert np.abs((normal * tangential).sum(axis=1))[is_tangential].max() < 1e-12
    ratio = np.linalg.norm(tangential, axis=1) / np.linalg.norm(normal, axis=1)
    assert np.abs(ratio - mu)[is_tangential].max() < NUMERICAL
    # the object presses on the rod along its outward normal, away from the centre
    outward = (swept.point - CIRCLE.center) / CIRCLE.radius
    assert np.abs(contacts.normal - outward)[is_tangential].max() < NUMERICAL
    assert ((normal * outward).sum(axis=1) > 0)[is_tangential].all()
    # in tip contact (15) would need the friction angle
    assert np.isnan(normal[~is_tangential]).all()


def test_a_known_friction_gives_tip_contacts_their_slope(frictional):
    mu, swept = frictional
    contacts = reconstruct(swept, friction=mu)
    tip = swept.phase == Phase.TIP
    assert np.abs(contacts.slope - swept.slope).max() < NUMERICAL
    outward = (swept.point - CIRCLE.center) / CIRCLE.radius
    assert np.abs(contacts.normal - outward).max() < NUMERICAL
    assert (contacts.normal_source == np.where(tip, NormalSource.FRICTION, NormalSource.TANGENTIAL)).all()
    unknown = reconstruct(swept)
    assert np.isnan(unknown.slope[tip]).all()
    assert (unknown.normal_source[tip] == NormalSource.NONE).all()
    assert np.isnan(unknown.normal[tip]).all()
