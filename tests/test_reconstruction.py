"""Step 2: contacts from reactions, row by row; the status of rows without a contact; errors and their messages."""

from dataclasses import fields

import numpy as np
import pytest
import shooting

import planar
from planar import NormalSource, Phase, Status
from planar.reconstruction import contacts_with_errors

CIRCLE = planar.Circle(radius=0.9, center=(0.0, 1.3))
METHODS = ("closed-form", "scholz-rahn", "will")
SWEPT = planar.sweep(CIRCLE, 0.2, samples=25)
# one tangential contact, as x0, f0x, f0y, m0z
ROW = (SWEPT.x0[10], SWEPT.f0x[10], SWEPT.f0y[10], SWEPT.m0z[10])

every_method = pytest.mark.parametrize("method", METHODS)


def row(**changes):
    """`ROW` with some of its columns replaced, as arrays (1,)."""
    columns = dict(zip(("x0", "f0x", "f0y", "m0z"), ROW, strict=True)) | changes
    return [np.array([float(value)]) for value in columns.values()]


def assert_no_contact(contacts, status):
    assert contacts.status.tolist() == [status]
    assert contacts.phase.tolist() == [Phase.NONE]
    assert contacts.normal_source.tolist() == [NormalSource.NONE]
    for name in ("point", "s1", "force", "force_angle", "friction_angle_bound", "slope"):
        assert np.isnan(getattr(contacts, name)).all(), name
    for name in ("friction_angle", "friction", "normal", "normal_force", "tangential_force"):
        assert np.isnan(getattr(contacts, name)).all(), name


NONE = [
    *(
        ({column: value}, Status.NO_FORCE)
        for column in ("x0", "f0x", "f0y", "m0z")
        for value in (np.nan, np.inf, -np.inf)
    ),
    *((dict(f0x=0, f0y=0, m0z=moment), Status.NO_FORCE) for moment in (0.0, 1.0, -1.0)),
    *((dict(m0z=moment), Status.WRONG_SIDE) for moment in (-ROW[3], 0.0)),
]


@every_method
@pytest.mark.parametrize(("changes", "status"), NONE)
def test_values_that_are_missing_zero_or_of_the_wrong_sign(method, changes, status):
    assert_no_contact(planar.reconstruct(*row(**changes), method), status)


@every_method
def test_too_much_moment(method):
    # k² = sin²(α/2) + m0z²/(4f) reaches 1
    f, alpha = np.hypot(ROW[1], ROW[2]), np.arctan2(-ROW[1], ROW[2])
    limit = 2 * np.sqrt(f) * np.cos(alpha / 2)
    assert_no_contact(planar.reconstruct(*row(m0z=limit * (1 + 1e-9)), method), Status.NO_ROD)
    below = planar.reconstruct(*row(m0z=limit * (1 - 1e-9)), "closed-form")
    assert below.status[0] != Status.NO_ROD


@pytest.mark.parametrize("method", METHODS[:2])
def test_a_contact_past_the_tip(method):
    # the same rod enlarged
    scale = 1 / SWEPT.s1[10] + 0.01
    longer = [value * scale**power for value, power in zip(ROW, (1, -2, -2, -1), strict=True)]
    contacts = planar.reconstruct(*([value] for value in longer), method)
    assert_no_contact(contacts, Status.BEYOND_TIP)


@pytest.mark.parametrize("method", METHODS[:2])
def test_a_negative_friction_angle(method):
    tip = SWEPT.phase == Phase.TIP
    # a tip contact with β < 0, scaled so that the contact is not at the tip
    i = np.flatnonzero(tip & (planar.reconstruct(*SWEPT.reactions).friction_angle_bound < -0.1))[0]
    scale = 0.9
    shorter = [column[i] * scale**power for column, power in zip(SWEPT.reactions, (1, -2, -2, -1), strict=True)]
    contacts = planar.reconstruct(*([value] for value in shorter), method)
    assert_no_contact(contacts, Status.INFLECTION)


def test_a_batch_masks_its_bad_rows_and_keeps_the_others():
    bad = [dict(f0x=0, f0y=0), dict(m0z=-1), dict(m0z=100), dict(x0=np.nan), dict()]
    rows = np.array([row(**changes) for changes in bad])[:, :, 0].T
    contacts = planar.reconstruct(*rows)
    assert contacts.status.tolist() == [Status.NO_FORCE, Status.WRONG_SIDE, Status.NO_ROD, Status.NO_FORCE, Status.OK]
    alone = planar.reconstruct(*row())
    for column in fields(contacts):
        np.testing.assert_array_equal(getattr(contacts, column.name)[4:], getattr(alone, column.name))


def test_more_rows_than_are_processed_at_once():
    repeat = 20_000 // len(SWEPT) + 1
    many = [np.tile(column, repeat) for column in SWEPT.reactions]
    friction = np.full(len(many[0]), 0.2)
    contacts = planar.reconstruct(*many, friction=friction)
    once = planar.reconstruct(*SWEPT.reactions, friction=0.2)
    assert len(contacts) == len(many[0])
    for name in ("status", "phase", "normal_source"):
        np.testing.assert_array_equal(getattr(contacts, name), np.tile(getattr(once, name), repeat))
    for name in ("s1", "slope"):
        np.testing.assert_allclose(getattr(contacts, name), np.tile(getattr(once, name), repeat), rtol=1e-13)


def test_tolerance_decides_between_tip_and_tangential():
    contacts = planar.reconstruct(*SWEPT.reactions)
    nearly = (contacts.s1 > 0.95) & (contacts.phase == Phase.TANGENTIAL)
    assert nearly.any()
    tolerant = planar.reconstruct(*SWEPT.reactions, tolerance=np.where(nearly, 0.05, 1e-9))
    assert (tolerant.phase[nearly] == Phase.TIP).all()
    assert np.isnan(tolerant.friction_angle[nearly]).all()
    np.testing.assert_array_equal(tolerant.phase[~nearly], contacts.phase[~nearly])
    # and a contact beyond the tip by less than the tolerance is a tip contact
    longer = [value * (1.01 / SWEPT.s1[10]) ** power for value, power in zip(ROW, (1, -2, -2, -1), strict=True)]
    passed = planar.reconstruct(*([value] for value in longer), tolerance=0.05)
    assert passed.phase.tolist() == [Phase.TIP]
    assert passed.s1[0] == pytest.approx(1.01)
    # rounding puts friction angles of 0 on both sides of 0
    frictionless = planar.sweep(CIRCLE, 0.0, samples=200)
    assert (planar.reconstruct(*frictionless.reactions).status[1:] == Status.OK).all()


@pytest.mark.parametrize("direction", [-1, 1])
@pytest.mark.parametrize("rod", [planar.Rod(), planar.Rod(curvature=0.3), planar.Rod(tip_diameter=0.5)])
def test_a_smaller_tolerance_and_friction_may_come_later(rod, direction):
    rng = np.random.default_rng(0)
    force, angle = rng.uniform(0, 6, 400), rng.uniform(-0.3, 2.0, 400)
    reactions = 0 * force, direction * force * np.sin(angle), force * np.cos(angle), -direction * rng.normal(1, 1, 400)
    tolerance, given = rng.uniform(0, 0.2, 400), {"rod": rod, "direction": direction}
    for friction in (None, rng.uniform(0, 0.5, 400)):
        at_once = planar.reconstruct(*reactions, tolerance=tolerance, friction=friction, **given)
        assert len(set(at_once.status.tolist())) >= 4
        later = planar.reconstruct(*reactions, tolerance=0.5, **given).within(tolerance, friction, direction=direction)
        for column in fields(at_once):
            np.testing.assert_array_equal(getattr(later, column.name), getattr(at_once, column.name))


@pytest.mark.slow
@pytest.mark.parametrize("direction", [-1, 1])
def test_contacts_come_with_their_errors(direction):
    for rod in (planar.Rod(), planar.Rod(curvature=0.3), planar.Rod(tip_diameter=0.5)):
        swept, given = (
            planar.sweep(CIRCLE, 0.2, samples=9, rod=rod, direction=direction),
            {"direction": direction, "rod": rod},
        )
        for told in ({}, {"missing": "f0x", "known": "friction", "known_sd": 0.01}):
            found, error = contacts_with_errors(*swept.reactions, tolerance=0.1, noise=(1e-4, 1e-4), **given, **told)
            alone = planar.reconstruct(*swept.reactions, tolerance=0.1, **given)
            assert found.phase.tolist() == alone.phase.tolist()
            np.testing.assert_allclose(found.point, alone.point, atol=1e-9)
            tip = planar.reconstruct(*swept.reactions, **given).phase == Phase.TIP
            stated = planar.errors(*swept.reactions[1:], noise=(1e-4, 1e-4), **given, **told, tip=tip)
            for values, others in zip(error, stated, strict=True):
                np.testing.assert_allclose(values, others, rtol=1e-4)


def test_known_friction_fills_in_tip_contacts_only():
    tangential = SWEPT.phase == Phase.TANGENTIAL
    without = planar.reconstruct(*SWEPT.reactions)
    # with a wrong coefficient: in tangential contact the slope measured by the rod takes precedence
    given = planar.reconstruct(*SWEPT.reactions, friction=np.full(len(SWEPT), 0.9))
    np.testing.assert_array_equal(given.slope[tangential], without.slope[tangential])
    tip = given.phase == Phase.TIP
    np.testing.assert_allclose(given.slope[tip], (given.force_angle - np.arctan(0.9))[tip])
    assert (given.normal_source[tip] == NormalSource.FRICTION).all()
    assert np.isnan(given.friction_angle[tip]).all()  # it was given, not measured


def test_equation_10_is_its_integral_clipped_to_the_tip():
    # s1 = (1/√(2f)) ∫_α^{π/2} dt/√sin(t - α), by quadrature: t = α + w² removes the root from the denominator
    from scipy.integrate import quad

    contacts = planar.reconstruct(*SWEPT.reactions, "will")
    clipped = 0
    for i in np.flatnonzero(contacts.status == Status.OK):
        f, alpha = np.hypot(SWEPT.f0x, SWEPT.f0y)[i], np.arctan2(-SWEPT.f0x, SWEPT.f0y)[i]
        integral = quad(lambda w: 2 / np.sqrt(np.sinc(w * w / np.pi)), 0, np.sqrt(np.pi / 2 - alpha), epsabs=1e-12)[0]
        length = integral / np.sqrt(2 * f)
        if length > 1:
            assert contacts.s1[i] == 1
            clipped += 1
        else:
            assert contacts.s1[i] == pytest.approx(length, abs=1e-10)
    assert 0 < clipped < (contacts.status == Status.OK).sum()


def test_elastic_lines_run_from_the_clamp_to_the_contact_and_on_to_the_tip():
    lines = planar.elastic_lines(*SWEPT.reactions, points=400)
    np.testing.assert_allclose(lines.curved[:, 0], np.stack([SWEPT.x0, np.zeros(25)], axis=1), atol=1e-14)
    np.testing.assert_allclose(lines.curved[:, -1], SWEPT.point, atol=1e-13)
    np.testing.assert_array_equal(lines.straight[:, 0], lines.curved[:, -1])
    # evenly in arc length, and one rod length in all; a polyline of 400 points is shorter by less than 1e-5
    steps = np.linalg.norm(np.diff(lines.curved, axis=1), axis=2)
    np.testing.assert_allclose(steps, SWEPT.s1[:, None] / 399 * np.ones(399), rtol=1e-4)
    straight = np.linalg.norm(np.diff(lines.straight, axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(straight, 1 - SWEPT.s1, atol=1e-13)
    # beyond a tangential contact the rod has the direction of the contour
    tangential = SWEPT.s1 < 1
    direction = np.diff(lines.straight[tangential], axis=1)[:, 0] / straight[tangential, None]
    np.testing.assert_allclose(
        direction, np.stack([np.cos(SWEPT.slope), np.sin(SWEPT.slope)], axis=1)[tangential], atol=1e-9
    )


def test_elastic_lines_never_enter_the_object():
    lines = planar.elastic_lines(*SWEPT.reactions, points=200)
    for points in (lines.curved, lines.straight):
        assert np.linalg.norm(points - CIRCLE.center, axis=2).min() > CIRCLE.radius - 1e-12


def test_wills_contact_lies_on_the_rod_that_the_reactions_bend():
    """Under friction (10) finds another arc length, and the point there must be the rod's, integrated from the clamp."""
    sweep = planar.sweep(planar.Circle(radius=0.6, center=(0.1, 1.0)), friction=0.4, samples=40)
    rows = np.flatnonzero(sweep.phase == Phase.TANGENTIAL)[::6]
    columns = [getattr(sweep, name)[rows] for name in ("x0", "f0x", "f0y", "m0z")]
    contacts = planar.reconstruct(*columns, method="will")
    defined = np.flatnonzero(np.isfinite(contacts.s1))
    assert len(defined) >= 3
    assert (np.abs(contacts.s1 - sweep.s1[rows])[defined] > 1e-3).any()  # friction misleads it
    x0, fx, fy, m0z = (column[defined] for column in columns)
    ends = shooting.integrate(x0, np.hypot(fx, fy), np.arctan2(-fx, fy), -m0z, contacts.s1[defined])[:2, :, 0]
    np.testing.assert_allclose(contacts.point[defined].T, ends, atol=1e-8)
