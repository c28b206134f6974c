"""What reveals a second contact, and what the rods of a sweep prove to be free."""

import numpy as np
import pytest
from shapes import polar
from test_several_contacts import REFERENCES

import planar
from planar import (
    Phase,
    Status,
    bridging,
    constant_friction_angle,
    passed,
    second_contacts,
)
from planar.hidden import EXPANDED, drawn, near

ZETA = np.arctan(0.3)
RUBBING = ["peanut with friction", "star", "letter L"]


def rows_of(name):
    (_, x0, friction), reactions, contacts = REFERENCES[name]
    return x0, reactions, friction, contacts


def among_single_contacts(names):
    """x0 and reactions of a sweep with single contacts and friction 0.3, and the rows of rods with two contacts after them."""
    swept = planar.sweep(planar.Circle(0.4, (0.0, 0.9)), 0.3, samples=80)
    columns = [swept.x0[1:], swept.f0x[1:], swept.f0y[1:], swept.m0z[1:]]
    more = np.array([[x0, *reactions] for x0, reactions, _, _ in map(rows_of, names)]).T
    return [np.concatenate([column, extra]) for column, extra in zip(columns, more, strict=True)]


@pytest.mark.parametrize("friction", [None, 0.3])
def test_friction_reveals_a_second_contact(friction):
    """With one contact β is the friction angle or the contact at the tip: of exact rows none is wrong, and none is missed.

    The rod on the star is refused as it is: it would have to be pulled.
    """
    columns = among_single_contacts(RUBBING)
    found = planar.reconstruct(*columns)
    second = second_contacts(*columns, contacts=found, friction=friction)
    assert found.status[80] == Status.INFLECTION
    assert np.flatnonzero(second).tolist() == [79, 81]
    kept = found.refused(second, Status.SECOND_CONTACT)
    assert (kept.status[second] == Status.SECOND_CONTACT).all()
    assert (kept.phase[second] == Phase.NONE).all()
    assert np.isnan(kept.point[second]).all()
    np.testing.assert_array_equal(kept.point[~second], found.point[~second])
    assert "second place" in Status.SECOND_CONTACT.sentence


def test_a_single_contact_is_not_taken_for_two_under_noise():
    rng = np.random.default_rng(12)
    swept = planar.sweep(planar.Ellipse((0.5, 0.3), (0.0, 0.9), 0.5), 0.3, samples=300)
    columns = [swept.x0, *(column + 1e-3 * rng.normal(size=300) for column in (swept.f0x, swept.f0y, swept.m0z))]
    errors = planar.errors(*columns[1:], noise=(1e-3, 1e-3))
    found = planar.reconstruct(*columns, tolerance=np.minimum(4 * np.nan_to_num(errors.s1, nan=0.2, posinf=0.2), 0.2))
    assert abs(constant_friction_angle(found, errors) - ZETA) < 5e-3
    for friction in (None, 0.3):
        assert second_contacts(*columns, contacts=found, friction=friction, errors=errors).sum() <= 2


def test_friction_that_varies_is_not_taken_for_constant():
    rng = np.random.default_rng(13)
    base = planar.sweep(planar.Circle(0.4, (0.0, 0.9)), 0.0, samples=60).x0
    swept = planar.sweep(planar.Circle(0.4, (0.0, 0.9)), rng.uniform(0, 0.4, 60), base=base)
    found = planar.reconstruct(*swept.reactions)
    assert np.isnan(constant_friction_angle(found))
    assert not second_contacts(*swept.reactions, contacts=found).any()


def test_a_contact_that_leaves_the_rods_line_is_not_single():
    """Without friction a row alone does not tell; a contact that moves across the rod does."""
    swept = planar.sweep(planar.Circle(0.4, (0.0, 0.9)), 0.0, samples=120)
    found = planar.reconstruct(*swept.reactions)
    assert not second_contacts(*swept.reactions, contacts=found).any()
    shifted = found.point.copy()
    middle = int(np.flatnonzero(found.phase == Phase.TANGENTIAL)[20])
    shifted[middle] += 0.003 * found.normal[middle]
    moved = planar.Contacts(**{**vars(found), "point": shifted})
    assert np.flatnonzero(second_contacts(*swept.reactions, contacts=moved)).tolist() == [
        middle - 1,
        middle,
        middle + 1,
    ]


@pytest.mark.slow
def test_what_rods_passed_is_free():
    """Random ellipses, from both sides: no place of the body is passed, and most of those close to it are."""
    rng = np.random.default_rng(14)
    for _ in range(6):
        axes, angle = rng.uniform(0.05, 0.4, 2), rng.uniform(0, np.pi)
        around, share = rng.uniform(0, 2 * np.pi, 3000), np.sqrt(rng.uniform(0, 1, 3000))
        c, s = np.cos(angle), np.sin(angle)
        local = np.stack([axes[0] * np.cos(around), axes[1] * np.sin(around)], axis=1) @ [[c, s], [-s, c]]
        outward = 0.02 * local / np.linalg.norm(local, axis=1)[:, None]
        low = local[:, 1] < -0.7 * np.abs(local[:, 1]).max()
        places = np.concatenate([local, share[:, None] * local, (local + outward)[low]])
        met = np.zeros(len(places), dtype=bool)
        for side in (1, -1):  # a sweep in +x is that in -x along the mirrored ellipse
            swept = planar.sweep(planar.Ellipse(tuple(axes), (0.0, 0.95), side * angle), 0.3, samples=50)
            asked = places * [side, 1] + [0.0, 0.95], np.ones(50, dtype=bool)
            met[passed(*swept.reactions, swept.s1, asked[0], single=asked[1])[1]] = True
            assert not len(passed(*swept.reactions, swept.s1, asked[0], single=~asked[1])[0])
        assert not met[:6000].any()
        assert met[6000:].mean() > 0.5


def test_the_path_of_a_tip_over_a_bump_is_not_free():
    """The tip bends round a spike within a step: the body reaches beyond the chord of its path."""
    angle = np.linspace(0, 2 * np.pi, 96, endpoint=False)
    outline = np.stack(polar(0.3 * (1 + 0.35 * np.cos(5 * angle)), angle, 1.2, (0.0, 0.0)), axis=1)
    outline[:, 1] += 0.5 - outline[:, 1].min()
    swept = planar.sweep(planar.Polygon(outline), 0.3, samples=72)
    single = swept.status < planar.SweepStatus.SEVERAL_CONTACTS
    places = np.concatenate([outline, (outline + np.roll(outline, -1, axis=0)) / 2])
    assert not len(passed(*swept.reactions, swept.s1, places, single=single)[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    "rod", [planar.Rod(tip_diameter=0.9), planar.Rod(curvature=-0.5), planar.Rod(tip_diameter=1 / 6, curvature=-0.5)]
)
def test_exact_contacts_of_any_rod_are_single(rod):
    for contour in (planar.Circle(0.9, (0.0, 1.3)), planar.Ellipse((0.5, 0.3), (0.0, 0.8), 0.3)):
        swept = planar.sweep(contour, 0.3, samples=60, rod=rod)
        contacts = planar.reconstruct(*swept.reactions, rod=rod)
        assert (contacts.phase != planar.Phase.NONE).sum() > 10
        for known in (None, contacts):
            assert not planar.second_contacts(*swept.reactions, contacts=known, rod=rod).any()
        other = -swept.x0, -swept.f0x, swept.f0y, -swept.m0z
        assert not planar.second_contacts(*other, direction=1, rod=rod.mirrored()).any()


def test_places_next_to_rods_against_elastic_lines():
    swept = planar.sweep(planar.Ellipse((0.3, 0.2), (0.0, 0.85), 0.4), 0.3, samples=30)
    rods, rng = drawn(*swept.reactions, swept.s1), np.random.default_rng(15)
    for k in range(1, 30, 4):
        shape = planar.elastic_lines(*(column[k : k + 1] for column in swept.reactions), points=2001)
        turn = np.arctan2(*np.diff(shape.curved[0], axis=0).T[::-1])
        at, aside = rng.integers(1, 2000, 50), rng.uniform(-0.02, 0.02, 50)
        phi = (turn[at - 1] + turn[at]) / 2
        found = near(rods, shape.curved[0, at] + aside[:, None] * np.stack([np.sin(phi), -np.cos(phi)], axis=1), 0.021)
        own = found.row == k
        assert own.sum() == 50
        # the chords' directions, of steps of 1/2000, turn the offsets
        np.testing.assert_allclose(found.off[own], aside, atol=2 * EXPANDED)
        np.testing.assert_allclose(found.s[own], at / 2000 * swept.s1[k], atol=1e-6)


def test_a_rod_that_rests_on_both_sides_of_a_hollow_is_told_from_one_that_does_not():
    """By places on the rod itself on either side of its contact, aside of it, on one side only, and at the contact as well."""
    swept = planar.sweep(planar.Circle(0.4, (0.0, 0.9)), 0.3, samples=40)
    rows = np.flatnonzero(swept.phase == Phase.TANGENTIAL)[5:20:5]
    columns = [column[rows] for column in (swept.x0, swept.f0x, swept.f0y, swept.m0z)]
    contacts = planar.reconstruct(*columns)
    errors = planar.errors(*columns[1:], noise=(1e-6, 1e-6))
    rods = drawn(*columns, contacts.s1)
    for k in range(len(rows)):
        on_rod = (rods.row == k) & (rods.s > 0.3)
        beside = np.abs(rods.s - contacts.s1[k])
        before, behind = (
            np.flatnonzero(on_rod & (beside > 0.02) & (side * (rods.s - contacts.s1[k]) > 0))[::side][0]
            for side in (-1, 1)
        )
        ends, normal = rods.point[[before, behind]], np.array([np.sin(contacts.slope[k]), -np.cos(contacts.slope[k])])
        known = [
            (ends, True),
            (ends + 1e-3 * normal, False),
            (ends[:1], False),
            (ends[1:], False),
            (np.vstack([ends, contacts.point[k]]), False),
        ]
        for points, rests in known:
            places = np.vstack([contacts.point[k], points])
            found = bridging(
                *columns, contacts, places, errors=errors, covariance=np.tile(1e-12 * np.eye(2), (len(places), 1, 1))
            )
            assert found[k] == rests
    nothing = np.empty((0, 2)), np.empty((0, 2, 2))
    assert not bridging(*columns, contacts, nothing[0], errors=errors, covariance=nothing[1]).any()


def test_no_rod_rests_on_both_sides_of_a_convex_contour():
    swept = planar.sweep(planar.Circle(0.4, (0.0, 0.9)), 0.3, samples=200)
    rows = np.flatnonzero(swept.phase == Phase.TANGENTIAL)
    columns = [column[rows] for column in (swept.x0, swept.f0x, swept.f0y, swept.m0z)]
    contacts, errors = planar.reconstruct(*columns), planar.errors(*columns[1:], noise=(1e-6, 1e-6))
    assert not bridging(*columns, contacts, contacts.point, errors=errors, covariance=errors.point)[3:].any()
