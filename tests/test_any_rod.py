"""Tapered, curved and heavy rods in clamps that give, against reference values, scipy's integrators and the closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from rods_in_space import table

import planar
from planar import Phase, Rod, Status
from scan3d.spatial.march import SpatialRod, free_reactions

# f0x, f0y, m0z; then s1, x1 - x0, y1, φ1 and β of these rods, by DOP853 at a relative tolerance of 1e-12.
CASES = [Rod(), Rod(tip_diameter=0.6), Rod(curvature=-0.3), Rod(compliance=0.05), Rod(tip_diameter=0.6, curvature=-0.3)]
REFERENCES = """
-0.55 0.15 0.55 0.971568828353 0.172332371782 0.953000262241 1.302351630839 0.002192646805
-0.55 0.15 0.55 0.978969209168 0.280220336786 0.923576271786 1.036002479011 0.268541798633
-0.55 0.15 0.55 0.979545625122 0.309935112378 0.915472242079 1.008622389065 0.295921888579
-0.55 0.15 0.55 0.969610668882 0.197568623419 0.946117648158 1.275720495381 0.028823782263
-0.90 0.50 0.90 0.923427223045 0.476557460948 0.735245855029 0.522284150891 0.541413671511
"""
# without friction that would hold them, so that only the march takes them
PULLED = [
    Rod(weight=0.2, gravity=(0, -1)),
    Rod(weight=0.2, gravity=(1, 0)),
    Rod(tip_diameter=0.8, curvature=-0.3, weight=0.05, gravity=(0.6, -0.8), compliance=0.05),
]
OF_PULLED = """
-0.6 0.35 0.42 0.672879563881 0.063674987209 0.669248527179 1.428171149647
-0.6 0.35 0.42 0.739971458668 0.075410453228 0.735351452337 1.417557130186
-0.6 0.35 0.42 0.648226311094 0.143175065057 0.628444442975 1.187946837240
"""
CIRCLE = planar.Circle(radius=0.9, center=(0.0, 1.3))
HEXAGON = planar.Polygon([(0.5 * np.cos(a), 1 + 0.5 * np.sin(a)) for a in np.arange(6) * np.pi / 3 + 0.2])
CONTOURS = [CIRCLE, planar.Ellipse((0.5, 0.3), (0.0, 0.8), 0.3), HEXAGON]
# with a piece that is short and steep
STEPPED = Rod(stiffness=[[0, 1], [0.3, 0.9], [0.36, 0.05], [1, 0.03]])
EVERYTHING = Rod(tip_diameter=0.6, curvature=-0.3, weight=0.05, gravity=(0.3, -1), compliance=0.02)
RODS = [Rod(tip_diameter=0.4), STEPPED, Rod(curvature=-0.3), Rod(weight=0.1, gravity=(0, -1)), EVERYTHING]


@pytest.mark.parametrize(("rod", "row"), list(zip(CASES, table(REFERENCES), strict=True)))
@pytest.mark.parametrize("method", ["closed-form", "scholz-rahn"])
def test_reference_values(rod, row, method):
    reactions, expected = row[:3], row[3:]
    contacts = planar.reconstruct(0.0, *reactions, method, rod=rod)
    slope = contacts.force_angle - contacts.friction_angle_bound
    got = [contacts.s1, *contacts.point.T, slope, contacts.friction_angle_bound]
    if expected[-1] < 0:
        assert contacts.status[0] == Status.INFLECTION
    else:
        np.testing.assert_allclose(np.concatenate(got), expected, atol=1e-10)


@pytest.mark.parametrize(("rod", "row"), list(zip(PULLED, table(OF_PULLED), strict=True)))
def test_reference_values_of_heavy_rods(rod, row):
    reactions, expected = row[:3], row[3:]
    force = -np.array([[reactions[0]], [reactions[1]]]) - rod.weight * rod.down[:, None]
    found = planar.rods.contacts(rod, force, np.array([-reactions[2]]))
    np.testing.assert_allclose(np.concatenate(found[:4]), expected, atol=1e-10)
    # such rods would have to be pulled along the contour
    assert planar.reconstruct(0.0, *reactions, rod=rod).status[0] == Status.INFLECTION


def integrated(rod, force, start, ends):
    """``φ, M, x, y`` of one rod by DOP853 from s = ends[0] to ends[1]."""

    def rates(s, state):
        phi, moment, _, _ = state
        fx, fy = force + rod.profile.weight_past(s) * rod.down
        bent = moment / rod.profile.bending_stiffness(s) + rod.curvature
        return [bent, fx * np.sin(phi) - fy * np.cos(phi), np.cos(phi), np.sin(phi)]

    knots = [s for s in rod.profile.knots if ends[0] < s < ends[1]]
    state = np.asarray(start, dtype=float)
    for low, high in zip([ends[0], *knots], [*knots, ends[1]], strict=True):
        state = scipy.integrate.solve_ivp(rates, (low, high), state, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    return state


@pytest.mark.slow
@pytest.mark.parametrize("rod", RODS)
def test_an_integration_from_the_clamp_touches_the_body_and_ends_without_moment(rod):
    # with the contact force up to the contact and without it behind
    swept = planar.sweep(CIRCLE, 0.3, samples=40, rod=rod)
    contacts = planar.reconstruct(*swept.reactions, rod=rod)
    lines = planar.elastic_lines(*swept.reactions, points=3, rod=rod)
    other = planar.elastic_lines(-swept.x0, -swept.f0x, swept.f0y, -swept.m0z, points=3, rod=rod.mirrored())
    for line, mirrored in zip(lines, other, strict=True):
        np.testing.assert_allclose(mirrored * [-1, 1], line, atol=1e-9)
    rows = np.flatnonzero(contacts.status == Status.OK)[1::6]
    assert len(rows) >= 5
    assert (swept.phase[rows] == Phase.TANGENTIAL).sum() >= 3
    for i in rows:
        f, alpha = contacts.force[i], contacts.force_angle[i]
        assert swept.contacts[i, 0][["force", "force_angle"]].tolist() == pytest.approx((f, alpha), abs=1e-9)
        force = f * np.array([np.sin(alpha), -np.cos(alpha)])
        start = [np.pi / 2 - rod.compliance * swept.m0z[i], -swept.m0z[i], swept.x0[i], 0.0]
        contact = integrated(rod, force, start, (0.0, contacts.s1[i]))
        np.testing.assert_allclose(contact[2:], contacts.point[i], atol=2e-10)
        assert CIRCLE.distance(contact[2:]) < 1e-9
        if swept.phase[i] == Phase.TANGENTIAL:
            # along the body, with the friction that was set
            slope = swept.slope[i]
            found = [contacts.s1[i], contact[0], alpha]
            np.testing.assert_allclose(found, [swept.s1[i], slope, slope + np.arctan(0.3)], atol=1e-8)
            np.testing.assert_allclose(contact[2:], CIRCLE.points(slope), atol=1e-9)
        halfway = integrated(rod, force, start, (0.0, contacts.s1[i] / 2))
        np.testing.assert_allclose(lines.curved[i], [start[2:], halfway[2:], contact[2:]], atol=1e-9)
        tip = integrated(rod, np.zeros(2), contact, (contacts.s1[i], 1.0)) if contacts.s1[i] < 1 else contact
        assert abs(tip[1]) < 1e-9
        np.testing.assert_allclose(lines.straight[i, [0, -1]], [contact[2:], tip[2:]], atol=1e-9)
        weight = -rod.weight * rod.down
        np.testing.assert_allclose(-force + weight, [swept.f0x[i], swept.f0y[i]], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("radius", "friction", "curvature"), [(8, 0.3, -0.6), (2, 0.4, -0.6), (4, 0.4, -1.0)])
def test_rods_that_curve_far_away_from_the_body_are_found(radius, friction, curvature):
    rod = Rod(tip_diameter=1 / 6, curvature=curvature)
    swept = planar.sweep(planar.Circle(radius, (0.0, radius + 0.6)), friction, samples=60, rod=rod)
    contacts = planar.reconstruct(*swept.reactions, rod=rod)
    touching = swept.phase != Phase.NONE
    assert touching.sum() > 50
    assert (contacts.status[touching] == Status.OK).mean() > 0.9
    np.testing.assert_allclose(
        contacts.point[contacts.status == Status.OK], swept.point[contacts.status == Status.OK], atol=1e-8
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("contour", "rod", "direction"),
    [
        pytest.param(i, k, direction, marks=() if (i, direction) == (k % 3, 1 - k % 2 * 2) else pytest.mark.trust)
        for i in range(3)
        for k in range(5)
        for direction in (-1, 1)
    ],
)
def test_sweeps_are_reconstructed(contour, rod, direction):
    contour, rod = CONTOURS[contour], RODS[rod] if direction < 0 else RODS[rod].mirrored()
    friction = np.random.default_rng(0).uniform(0.0, 0.4, 36)
    swept = planar.sweep(contour, friction, samples=36, rod=rod, direction=direction)
    touching = swept.phase != Phase.NONE
    assert touching[1:-1].mean() > 0.95
    contacts = planar.reconstruct(*swept.reactions, rod=rod, direction=direction)
    # at touch-down there is no force
    found = contacts.status == Status.OK
    assert found.sum() >= touching.sum() - 2
    # errors of contacts grow as the inverse of the force
    felt = found & (contacts.force > 1e-3)
    assert felt.sum() >= found.sum() - 1
    np.testing.assert_allclose(contacts.point[felt], swept.point[felt], atol=1e-9)
    found = felt
    assert contour.distance(contacts.point[found]).max() < 1e-9
    np.testing.assert_array_equal(contacts.phase[found], swept.phase[found])
    tangential = found & (swept.phase == Phase.TANGENTIAL)
    assert tangential.sum() > 5
    np.testing.assert_allclose(contacts.friction[tangential], friction[tangential], atol=1e-7)
    np.testing.assert_allclose(contacts.slope[tangential], swept.slope[tangential], atol=1e-7)
    tip = found & (swept.phase == Phase.TIP)
    assert (contacts.friction_angle_bound[tip] < np.arctan(friction[tip]) + 1e-7).all()


@pytest.mark.slow
@pytest.mark.parametrize("rod", [*RODS, Rod(tip_diameter=0.1), Rod(curvature=0.2)])
def test_sweeps_touch_from_touch_down_to_their_end(rod):
    polygons = [HEXAGON, planar.Polygon(HEXAGON.vertices * [0.4, 0.8])]
    for swept in planar.sweep_all([*CONTOURS[:2], *polygons], [0.0, 0.3, 0.3, 0.0], samples=20, rod=rod):
        assert (swept.status != planar.SweepStatus.FREE).all()


@pytest.mark.slow
@pytest.mark.parametrize("contour", CONTOURS)
@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_a_table_of_stiffness_that_does_not_vary_gives_the_uniform_rod(contour, friction):
    # a clamp that hardly gives takes the way of any rod
    uniform = planar.sweep(contour, friction, samples=50)
    marched = planar.sweep(contour, friction, base=uniform.x0, rod=Rod(compliance=1e-14))
    both = (uniform.phase != Phase.NONE) & (marched.phase != Phase.NONE)
    assert both.sum() >= len(uniform) - 2
    # the last place is a fold, at which a change of x0 by rounding moves the contact by its root
    inside = both & (uniform.x0 > uniform.x0[-1] + 1e-6)
    for name in ("f0x", "f0y", "m0z", "s1"):
        np.testing.assert_allclose(getattr(marched, name)[inside], getattr(uniform, name)[inside], atol=1e-8)
    straight = planar.sweep(contour, friction, samples=50, rod=Rod(stiffness=[[0, 1], [0.4, 1], [1, 1]]))
    np.testing.assert_array_equal(straight.m0z, uniform.m0z)


@pytest.mark.parametrize("curvature", [-1.0, -0.3, 0.3])
def test_arcs_in_closed_form_agree_with_the_march(curvature):
    rng = np.random.default_rng(1)
    f0x, f0y, m0z = -rng.uniform(0.1, 3, 400), rng.uniform(-0.5, 3, 400), rng.uniform(0.1, 3, 400)
    rod = Rod(curvature=curvature)
    arc, marched = (
        planar.reconstruct(0 * m0z, f0x, f0y, m0z, method, rod=rod) for method in ("closed-form", "scholz-rahn")
    )
    ok = (arc.status == Status.OK) & (marched.status == Status.OK)
    assert ok.sum() > 30
    np.testing.assert_array_equal((arc.status == Status.OK), (marched.status == Status.OK))
    np.testing.assert_allclose(arc.point[ok], marched.point[ok], atol=1e-9)
    np.testing.assert_allclose(arc.friction_angle_bound[ok], marched.friction_angle_bound[ok], atol=1e-8)


def test_derivatives_agree_with_those_of_the_closed_form():
    swept = planar.sweep(CIRCLE, 0.3, samples=20)
    reactions = [column[2:] for column in swept.reactions[1:]]
    for sign, direction in ((1, -1), (-1, 1)):
        f0x, f0y, m0z = sign * reactions[0], reactions[1], sign * reactions[2]
        exact = planar.jacobian(f0x, f0y, m0z, direction=direction)
        differences = planar.jacobian(f0x, f0y, m0z, direction=direction, rod=Rod(compliance=1e-14))
        largest = np.abs(exact).max(axis=(1, 2), keepdims=True)
        assert np.abs((differences - exact) / largest).max() < 1e-6


@pytest.mark.slow
def test_stated_errors_are_those_of_noisy_reactions():
    rod, noise, rng = EVERYTHING, 1e-4, np.random.default_rng(0)
    swept = planar.sweep(CIRCLE, 0.3, samples=12, rod=rod)
    rows = np.flatnonzero(swept.phase != Phase.NONE)[3:]
    x0, *reactions = (np.repeat(column[rows], 400) for column in swept.reactions)
    noisy = [column + rng.normal(0, noise, len(column)) for column in reactions]
    contacts = planar.reconstruct(x0, *noisy, rod=rod, tolerance=0.05)
    apart = contacts.point.reshape(len(rows), 400, 2) - swept.point[rows, None]
    errors = planar.errors(*(column[rows] for column in swept.reactions[1:]), noise=(noise, noise), rod=rod)
    stated = np.sqrt(np.trace(errors.point, axis1=1, axis2=2))
    np.testing.assert_allclose(np.sqrt((apart**2).sum(axis=2).mean(axis=1)), stated, rtol=0.15)


@pytest.mark.parametrize(
    "rod",
    [
        Rod(tip_diameter=0.5, curvature=0.2, weight=0.5, gravity=(1, -1), compliance=0.1),
        Rod(weight=2.0, gravity=(0.5, 0.9), compliance=1.0),  # a clamp that gives much
    ],
)
def test_reactions_of_the_free_rod(rod):
    f0x, f0y, m0z = planar.free_reactions(rod)
    np.testing.assert_allclose([f0x, f0y], -rod.weight * rod.down)
    tip = integrated(rod, np.zeros(2), [np.pi / 2 - rod.compliance * m0z, -m0z, 0.0, 0.0], (0.0, 1.0))
    assert abs(tip[1]) < 1e-11
    space = SpatialRod(rod.profile, (rod.curvature, 0.0, 0.0), compliance=rod.compliance)
    in_space = free_reactions(space, np.append(rod.down, 0.0)[:, None])
    np.testing.assert_allclose(np.concatenate(in_space)[:, 0], [f0x, f0y, 0, 0, 0, m0z], atol=1e-10)
    assert planar.free_reactions(Rod(tip_diameter=0.5)) == (0, 0, 0)


def test_a_clamp_that_gives_too_much_has_no_rest():
    rod = Rod(weight=2.0, gravity=(0.5, 0.9), compliance=10.0)
    for find in (
        lambda: planar.free_reactions(rod),
        lambda: free_reactions(SpatialRod(rod.profile, compliance=10.0), np.append(rod.down, 0.0)[:, None]),
    ):
        with pytest.raises(ValueError, match="gives so much under the rod's weight that no rest is found"):
            find()


def test_statuses_of_any_rod():
    rod = Rod(tip_diameter=0.6)
    swept = planar.sweep(CIRCLE, 0.3, samples=20, rod=rod)
    x0, f0x, f0y, m0z = (column[8] for column in swept.reactions)
    rows = np.array(
        [[x0, 0, 0, m0z], [x0, f0x, f0y, -m0z], [x0, f0x, f0y, 100], [np.nan, f0x, f0y, m0z], [x0, f0x, f0y, m0z]]
    )
    statuses = planar.reconstruct(*rows.T, rod=rod).status
    assert statuses.tolist() == [Status.NO_FORCE, Status.WRONG_SIDE, Status.NO_ROD, Status.NO_FORCE, Status.OK]


@pytest.mark.slow
def test_rows_may_have_a_gravity_each():
    rng, triangle = np.random.default_rng(3), planar.Polygon([(-0.3, 1.0), (0.0, 0.6), (0.3, 1.0)])
    gravity = np.array([(0.0, -1.0), (1.0, 0.2), (-0.6, 2.0)])
    rod = replace(EVERYTHING, gravity=gravity)
    swept = planar.sweep_all([triangle] * 3, [0.3] * 3, samples=8, rod=rod)
    alone = [planar.sweep(triangle, 0.3, samples=8, rod=replace(EVERYTHING, gravity=down)) for down in gravity]
    rows, shuffled = np.concatenate([np.array(sweep.reactions).T for sweep in swept]), rng.permutation(24)
    np.testing.assert_allclose(rows, np.concatenate([np.array(sweep.reactions).T for sweep in alone]), atol=1e-9)
    own = replace(EVERYTHING, gravity=np.repeat(gravity, 8, axis=0)[shuffled])
    found = planar.reconstruct(*rows[shuffled].T, rod=own)
    truth = np.concatenate([sweep.point for sweep in alone])[shuffled]
    touching = np.hypot(*(rows[shuffled, 1:3].T + own.pull)) > 0.01
    assert touching.sum() > 12
    np.testing.assert_allclose(found.point[touching], truth[touching], atol=1e-9)
    for call, words in (
        (lambda: planar.reconstruct(*rows[:5].T, rod=own), "one for each row, got 24"),
        (lambda: planar.sweep_all([triangle], [0.3], samples=3, rod=own), "one for each sweep, got 24"),
        (lambda: planar.free_reactions(own), "one direction"),
    ):
        with pytest.raises(ValueError, match=words):
            call()


@pytest.mark.slow
@pytest.mark.parametrize("lean", [-1.0, 0.3, 1.0])
@pytest.mark.parametrize("direction", [-1, 1])
@pytest.mark.parametrize("by_weight", [False, True])
def test_no_rod_lies_in_the_contour(lean, direction, by_weight):
    """A rod that curves or hangs towards a side touches it at a second place, or before any state that is known; such samples,
    which counted as free, are unresolved."""
    square = [(-0.3, 0.5), (0.3, 0.5), (0.3, 1.1), (-0.3, 1.1)]

    def in_square(x, y):
        return np.minimum(0.3 - np.abs(x), np.minimum(y - 0.5, 1.1 - y))

    def in_ellipse(x, y):
        return 0.1 * (1 - np.hypot(x / 0.1, (y - 0.9) / 0.5))

    rod, unresolved = planar.Rod(curvature=lean, tip_diameter=0.8), 0
    turn = lean * np.linspace(0, 1, 200)
    free = np.stack([(np.cos(turn) - 1) / lean, np.sin(turn) / lean])
    if by_weight:
        rod = planar.Rod(weight=2 * abs(lean), gravity=(-np.sign(lean), 0.0))
        free = integrated(rod, np.zeros(2), [np.pi / 2, -planar.free_reactions(rod)[2], 0, 0], (0.0, 1.0))[2:, None]
    for contour, depth in ((planar.Polygon(square), in_square), (planar.Ellipse((0.1, 0.5), (0, 0.9)), in_ellipse)):
        base = -direction * np.linspace(1.2, -0.5, 80)
        swept = planar.sweep(contour, 0.2, base=base, rod=rod, direction=direction)
        before = base[swept.status == planar.SweepStatus.FREE]
        assert len(before)
        assert depth(before[:, None] + free[0], free[1]).max() < 1e-3
        lines = planar.elastic_lines(*swept.reactions, rod=rod)
        places = np.concatenate([lines.curved, lines.straight], axis=1)[swept.phase != planar.Phase.NONE]
        assert depth(*places.transpose(2, 0, 1)).max() < 1e-6
        assert (swept.status[swept.phase == planar.Phase.NONE] != planar.SweepStatus.ONE_CONTACT).all()
        unresolved += int((swept.status == planar.SweepStatus.UNRESOLVED).sum())
        assert len(swept.contacts) == len(swept)
    assert (unresolved > 0) == (lean * direction < 0)


@pytest.mark.slow
def test_sweeps_that_go_on_past_their_end_with_a_friction_for_each_sample():
    friction = np.random.default_rng(0).uniform(0.0, 0.6, 40)
    for rod in RODS:
        swept = planar.sweep(CONTOURS[1], friction, base=np.linspace(0.7, -1.7, 40), rod=rod)
        contacts = planar.reconstruct(*swept.reactions, rod=rod)
        found = contacts.status == Status.OK
        assert found.sum() > 10
        assert swept.phase[-5:].max() == Phase.NONE
        np.testing.assert_allclose(contacts.point[found], swept.point[found], atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("rod", [Rod(tip_diameter=0.6), STEPPED, Rod(compliance=0.05)])
@pytest.mark.parametrize("direction", [-1, 1])
def test_events_are_where_sweeps_change(rod, direction):
    for contour in CONTOURS:
        found = planar.events(contour, 0.2, rod=rod, direction=direction)
        swept = planar.sweep(contour, 0.2, rod=rod, direction=direction, samples=2000)
        assert [found.x0[0], found.x0[-1]] == pytest.approx([swept.x0[0], swept.x0[-1]], abs=1e-9)
        last = np.flatnonzero(np.diff(swept.phase))
        for at in direction * np.array([swept.x0[last], swept.x0[last + 1]]).T:
            assert ((at[0] - 1e-9 <= direction * found.x0) & (direction * found.x0 <= at[1] + 1e-9)).any()
        kinds = [planar.EventKind.TO_TIP, planar.EventKind.TO_TANGENTIAL]
        assert len(last) >= np.isin(found.kind, kinds).sum()
        np.testing.assert_allclose(found.m0z[0, 1], 0.0, atol=1e-9)
