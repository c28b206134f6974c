"""Step 1: states of a sweep, events, extreme contours; errors and their messages."""

import re

import numpy as np
import pytest
import shooting
from shapes import SupportCurve

import planar
from planar import EventKind, Phase, Status, segments

CIRCLE = planar.Circle(radius=0.9, center=(0.0, 1.3))
SQUARE = planar.Polygon(
    np.array([0.0, 0.9]) + 0.5 * np.stack([f(0.3 + np.arange(4) * np.pi / 2) for f in (np.cos, np.sin)], axis=1)
)
CONTOURS = {
    "circle": CIRCLE,
    "low circle": planar.Circle(0.4, (0.2, 0.5)),
    "ellipse": planar.Ellipse((0.7, 0.4), (0.1, 1.0), np.radians(20)),
    "needle": planar.Ellipse((0.6, 0.03), (0.0, 0.8), np.radians(50)),
    "curve": SupportCurve(
        lambda t: 0.5 + 0.05 * np.cos(3 * t) - 0.8 * np.cos(t),
        lambda t: -0.15 * np.sin(3 * t) + 0.8 * np.sin(t),
        lambda t: -0.45 * np.cos(3 * t) + 0.8 * np.cos(t),
    ),
    "square": SQUARE,
    "triangle pointing down": planar.Polygon(np.array([[0.1, 0.4], [0.5, 1.4], [-0.6, 1.2]])),
    "rectangle": planar.Polygon(np.array([[0.0, 0.6], [0.5, 0.6], [0.5, 0.8], [0.0, 0.8]])),
    "heptagon": planar.Polygon(
        np.array([0.1, 0.95])
        + 0.55 * np.stack([f(0.2 + np.arange(7) * 2 * np.pi / 7) for f in (np.cos, np.sin)], axis=1)
    ),
}
STATE = ("f0x", "f0y", "m0z", "s1", "slope", "point")

every_contour = pytest.mark.parametrize("contour", CONTOURS.values(), ids=CONTOURS)


def residual(swept):
    """Largest residual of (5)-(7) in the states of a sweep, with (3) integrated from the clamp.

    The moment of each rod vanishes at its contact and nowhere before, and tips are pushed and not pulled.
    """
    loaded = swept.m0z > 0
    assert loaded[1:].all()
    f, alpha = np.hypot(swept.f0x, swept.f0y)[loaded], np.arctan2(-swept.f0x, swept.f0y)[loaded]
    rods = shooting.integrate(swept.x0[loaded], f, alpha, -swept.m0z[loaded], swept.s1[loaded], np.linspace(0, 1, 41))
    assert (rods[3, :, :-1] < 0).all()
    x, y, phi, kappa = rods[:, :, -1]
    tangential = swept.phase[loaded] == Phase.TANGENTIAL
    assert (swept.s1[loaded][~tangential] == 1).all()
    assert (swept.s1[loaded][tangential] <= 1).all()
    rise = (phi - swept.slope[loaded])[~tangential]
    assert (rise > -1e-9).all()
    assert (rise < np.pi).all()
    residuals = [x - swept.point[loaded, 0], y - swept.point[loaded, 1], kappa, (phi - swept.slope[loaded])[tangential]]
    return max(np.abs(values).max() for values in residuals if len(values))


@pytest.mark.slow
@every_contour
@pytest.mark.parametrize("friction", [0.0, 0.4, 2.0, 5.0])
def test_states_are_equilibria(contour, friction):
    swept = planar.sweep(contour, friction, samples=60)
    assert (swept.phase != Phase.NONE).all()
    assert contour.distance(swept.point).max() < 1e-12
    # forces go up to some 10, and next to a fold the error of a state is the square root of the rounding of x0
    assert residual(swept) < 1e-10
    # the contact force has the friction angle to the normal (2)
    alpha = np.arctan2(-swept.f0x, swept.f0y)
    loaded = swept.m0z > 0
    assert np.abs(alpha - swept.slope - np.arctan(friction))[loaded].max() < 1e-9


@pytest.mark.slow
@every_contour
@pytest.mark.parametrize("friction", [0.0, 0.4, 2.0])
def test_the_state_is_the_first_place_on_the_path_that_comes_down_to_its_base(contour, friction):
    # against equilibria at many places, computed without folds, transitions and rows
    swept = planar.sweep(contour, friction, samples=50)
    path = contour.path()
    count = path.offsets[-1]
    piece, t = np.repeat(np.arange(count), 12), np.tile(np.linspace(0, 1, 12), count)
    slope, x, y = path.at(piece, t)
    zeta = np.full(len(slope), np.arctan(friction))
    x0 = segments.states(segments.is_tangential(slope, y, zeta), slope, x, y, zeta).x0
    # no earlier place comes down so far, and no place comes down further than the last sample
    for i in range(len(swept)):
        before = (slope > swept.slope[i] + 1e-9) | ((slope > swept.slope[i] - 1e-9) & (x > swept.point[i, 0] + 1e-9))
        assert np.nanmin(x0[before], initial=np.inf) > swept.x0[i] - 1e-9
    assert np.nanmin(x0) > swept.x0[-1] - 1e-9


def test_nothing_touches_before_touch_down_and_after_the_end():
    events = planar.events(CIRCLE, 0.2)
    start, end = events.x0[0], events.x0[-1]
    base = np.array([5.0, start + 1e-9, start, start - 1e-9, end + 1e-9, end, end - 1e-9, -5.0])
    swept = planar.sweep(CIRCLE, 0.2, base=base)
    untouched = np.array([True, True, False, False, False, False, True, True])
    np.testing.assert_array_equal(swept.phase == Phase.NONE, untouched)
    for name in STATE:
        column = getattr(swept, name)
        assert np.isnan(column[untouched]).all(), name
        assert np.isfinite(column[~untouched]).all(), name
    np.testing.assert_array_equal(swept.x0, base)


@pytest.mark.slow
def test_samples_run_from_touch_down_to_the_end():
    for contour in CONTOURS.values():
        events = planar.events(contour, 0.3)
        swept = planar.sweep(contour, 0.3, samples=9)
        assert swept.x0[0] == events.x0[0]
        assert swept.x0[-1] == events.x0[-1]
        np.testing.assert_allclose(np.diff(swept.x0), (swept.x0[-1] - swept.x0[0]) / 8, rtol=1e-9)
        assert swept.m0z[0] == 0
        assert np.hypot(swept.f0x, swept.f0y)[-1] > 0
        assert len(swept) == 9


def test_a_single_sample_and_empty_sweeps():
    single = planar.sweep(CIRCLE, 0.2, samples=1)
    assert len(single) == 1
    assert single.x0[0] == planar.events(CIRCLE, 0.2).x0[0]
    for contour in (CIRCLE, SQUARE):
        for friction in (0.2, []):
            empty = planar.sweep(contour, friction, base=[])
            assert len(empty) == 0
            assert empty.point.shape == (0, 2)
    assert planar.sweep_all([], [], samples=3) == []


def needle(degrees, lowest):
    angle = np.radians(degrees)
    return planar.Ellipse((1.0, 0.05), (0.0, np.hypot(np.sin(angle), np.cos(angle) / 20) + lowest), angle)


# The last ones lie only just within reach: their height is known to 1e-16, and the base position to the root of that.
JUST = 1 - 1e-12
EXTREME = {
    **{
        f"circle of {radius:g} at {lowest:g}": planar.Circle(radius, (0.3, lowest + radius))
        for radius in (1e-3, 1.0, 100.0)
        for lowest in (1e-6, 0.5, 0.99, 1 - 1e-9)
    },
    **{
        f"needle at {degrees} degrees, {lowest:g} up": needle(degrees, lowest)
        for degrees in range(0, 180, 30)
        for lowest in (0.05, 0.97)
    },
    "circle just within reach": planar.Circle(0.5, (0.0, JUST + 0.5)),
    "triangle just within reach": planar.Polygon(np.array([[0.0, JUST], [0.5, 1.3], [-0.5, 1.2]])),
}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.trust) if re.search("at (30|90|150) deg", n) else n for n in EXTREME]
)
@pytest.mark.slow
def test_extreme_contours_are_swept_and_found_again(name):
    contour = EXTREME[name]
    for friction in (0.0, 5.0):
        swept = planar.sweep(contour, friction, samples=30)
        assert (swept.phase != Phase.NONE).all()
        assert contour.distance(swept.point).max() < 1e-12
        # a millionth above the base line forces are so large that 2e-9 is rounding
        assert residual(swept) < 1e-8
        contacts = planar.reconstruct(*swept.reactions)
        assert (contacts.status[1:] == Status.OK).all()
        off = np.linalg.norm(contacts.point - swept.point, axis=1)[1:].max()
        assert off < (1e-7 if "just" in name else 1e-9)
        assert planar.events(contour, friction).kind[-1] == EventKind.SNAP_OFF


@pytest.mark.parametrize("friction", [0.0, 5.0])
@pytest.mark.parametrize("radius", [0.002, 0.3, *(pytest.param(r, marks=pytest.mark.trust) for r in (0.01, 0.03))])
@pytest.mark.slow
def test_a_contour_whose_rightmost_point_is_at_the_tips_height(radius, friction):
    # tip, tangential, tip contact within a few degrees of slope: the tangential contact is shorter than a piece of the path
    for above in (-1e-9, 0.0, 1e-9, 1e-3):
        circle = planar.Circle(radius, (0.0, 1.0 + above * radius))
        swept = planar.sweep(circle, friction, samples=30)
        assert residual(swept) < 1e-10
        kinds = planar.events(circle, friction).kind.tolist()
        begins = [EventKind.TO_TANGENTIAL, EventKind.TO_TIP] if above >= 0 else [EventKind.TO_TIP]
        assert kinds == [EventKind.TOUCH_DOWN, *begins, EventKind.SNAP_OFF]


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("sides", [4, 7, 60, *(pytest.param(n, marks=pytest.mark.trust) for n in (24, 200))])
@pytest.mark.slow
def test_a_tip_snaps_around_every_corner(sides, friction):
    around = 2 * np.pi * (np.arange(sides) + 0.3) / sides
    polygon = planar.Polygon(CIRCLE.center + 0.9 * np.stack([np.cos(around), np.sin(around)], axis=1))
    events = planar.events(polygon, friction)
    snaps = np.flatnonzero(events.kind == EventKind.SNAP)
    for i in snaps:
        # 1e-12 before a fold the contact is about 1e-6 away from it, the square root
        swept = planar.sweep(polygon, friction, base=[events.x0[i] + 1e-12, events.x0[i] - 1e-12])
        np.testing.assert_allclose(swept.point, events.point[i], atol=1e-4)
        np.testing.assert_allclose(swept.slope, events.slope[i], atol=1e-4)
        np.testing.assert_allclose(swept.m0z, events.m0z[i], atol=1e-2)
    # after the last tangential contact the tip touches one edge after another; it reaches each by a snap, or by a transition
    swept = planar.sweep(polygon, friction, samples=4000)
    begin = np.flatnonzero(swept.phase == Phase.TANGENTIAL)[-1] + 1
    edges = len(np.unique(np.round(swept.slope[begin:], 9)))
    last = events.x0 <= swept.x0[begin - 1]
    arrivals = np.isin(events.kind[last], (EventKind.SNAP, EventKind.TO_TIP)).sum()
    assert arrivals == edges


@every_contour
@pytest.mark.parametrize("friction", [0.0, 0.2, 0.4, 0.6])
def test_events_agree_with_the_sweep(contour, friction):
    events = planar.events(contour, friction)
    x0 = events.x0[1:-1]
    swept = planar.sweep(contour, friction, base=np.sort(np.concatenate([x0 + 1e-10, x0 - 1e-10]))[::-1])
    phases = swept.phase.reshape(-1, 2)
    for kind, (before, after) in zip(events.kind[1:-1], phases, strict=True):
        if kind == EventKind.TO_TANGENTIAL:
            assert (before, after) == (Phase.TIP, Phase.TANGENTIAL)
        if kind == EventKind.TO_TIP:
            assert (before, after) == (Phase.TANGENTIAL, Phase.TIP)


def test_a_sweep_that_begins_before_touch_down_has_the_contacts_of_one_that_begins_there():
    """With friction per sample: samples before touch-down touch nothing, and do not end the sweep."""
    circle = planar.Circle(radius=0.5, center=(0.0, 0.9))
    touching = planar.sweep(circle, friction=0.2, samples=30)
    base = np.concatenate([touching.x0[0] + np.linspace(0.5, 0.01, 5), touching.x0])
    friction = np.full(len(base), 0.2)
    friction[1::2] = 0.1
    early = planar.sweep(circle, friction=friction, base=base)
    late = planar.sweep(circle, friction=friction[5:], base=touching.x0)
    assert (early.phase[:5] == Phase.NONE).all()
    assert (late.phase != Phase.NONE).sum() > 20
    np.testing.assert_array_equal(early.phase[5:], late.phase)
    np.testing.assert_array_equal(early.m0z[5:], late.m0z)
