"""Rods with several contacts: against reference values, a boundary value solver, today's tables of convex contours."""

import numpy as np
import pytest
import scipy
from shapes import cassini, letter_l_outline, star

import planar
from planar import SweepStatus
from planar.any_body import follow
from planar.contours import Outlines
from planar.several import reactions as reactions_of

PEANUT = lambda: planar.Curve.from_points(*cassini(0.8, 4000))  # noqa: E731
STAR = lambda: planar.Curve.from_points(*star(0.3, 16_000))  # noqa: E731
LETTER = lambda: planar.Polygon(letter_l_outline(4.5))  # noqa: E731
# x0, μ, f0x, f0y, m0z; then s, f, x, y and slope in degrees of each contact, of two independent integrations
NUMBERS = {
    "peanut": (PEANUT, """
        -0.28 0.0 -2.155438814938 2.159908591476 1.987682850439
        0.582106506761 2.198794479330 -0.040751879202 0.516929394708 49.604162500
        1.0 0.878284292928 0.245510394937 0.821235253897 33.196326736"""),
    "peanut with friction": (PEANUT, """
        -0.30 0.3 -3.187816170946 1.615954825662 2.248359133772
        0.587384610687 3.115968149393 -0.043565134220 0.513677779287 48.661083043
        1.0 0.476273190370 0.237221576444 0.815978010322 31.593612112"""),
    "star": (STAR, """
        -0.64 0.3 1.379781328227 4.026994334635 1.916910611464
        0.789208422090 0.360433300642 -0.149790571806 0.541078579865 15.853117269
        1.0 4.042115897443 0.055501400473 0.588691801214 -39.612102923"""),
    "letter L": (LETTER, """
        -0.40 0.3 -2.653538887130 2.168866046887 2.511621301187
        0.647937983964 2.248305041866 -0.050590991863 0.515392771760 35.328994370
        0.987413626227 1.180482093484 0.234607228240 0.699409008137 31.584366809"""),
    "peanut, one contact": (PEANUT, """
        -0.22 0.0 -1.040670211907 1.293650134663 1.506890620380
        1.0 1.660278639526 0.269952658232 0.838943296436 38.814759820"""),
}  # fmt: skip


def reference(make, text):
    rows = [[float(number) for number in line.split()] for line in text.strip().splitlines()]
    (x0, friction, *reactions), *contacts = rows
    return (make, x0, friction), reactions, [(s, f, (x, y), slope) for s, f, x, y, slope in contacts]


REFERENCES = {name: reference(*given) for name, given in NUMBERS.items()}


@pytest.mark.slow
@pytest.mark.parametrize(("given", "reactions", "contacts"), REFERENCES.values(), ids=REFERENCES)
def test_reference_values(given, reactions, contacts):
    make, x0, friction = given
    swept = planar.sweep(make(), friction, base=[x0])
    # the splines' slopes differ from the curves' by some 1e-10
    tolerance = 1e-12 if isinstance(make(), planar.Polygon) else 2e-9
    np.testing.assert_allclose([swept.f0x[0], swept.f0y[0], swept.m0z[0]], reactions, rtol=0, atol=tolerance)
    assert swept.status[0] == min(len(contacts), 2)
    found = swept.contacts[0, : len(contacts)]
    np.testing.assert_allclose(found["s1"], [c[0] for c in contacts], atol=tolerance)
    np.testing.assert_allclose(found["force"], [c[1] for c in contacts], atol=tolerance)
    np.testing.assert_allclose(found["point"], [c[2] for c in contacts], atol=tolerance)
    np.testing.assert_allclose(found["slope"], np.radians([c[3] for c in contacts]), atol=tolerance)
    assert (swept.s1[0], swept.slope[0]) == (found["s1"][0], found["slope"][0])
    assert np.isnan(swept.contacts["s1"][0, len(contacts) :]).all()


def test_two_contacts_against_a_boundary_value_solver():
    """The rod on two corners as a problem of 10 equations in two pieces, by collocation: nothing of it is the product's."""
    polygon = planar.Polygon(letter_l_outline(4.5))
    swept = planar.sweep(polygon, 0.3, base=[-0.40])
    first, second = swept.contacts[0, :2]
    zeta = np.arctan(0.3)

    # two pieces of unknown lengths, each over [0, 1]; at the corners the places are given, and the slopes are unknown too
    def slopes(_, z, p):
        force_a, force_b, length_a, length_b, tau_a, tau_b = p
        on_b = force_b * np.array([np.sin(tau_b + zeta), -np.cos(tau_b + zeta)])
        both = on_b + force_a * np.array([np.sin(tau_a + zeta), -np.cos(tau_a + zeta)])
        rows = []
        for (_, _, phi, kappa), force, length in ((z[:4], both, length_a), (z[4:], on_b, length_b)):
            bending = force[0] * np.sin(phi) - force[1] * np.cos(phi)
            rows += [length * np.cos(phi), length * np.sin(phi), length * kappa, length * bending]
        return np.array(rows)

    def ends(a, b, p):
        at_clamp, on_a = a[:3] - [-0.40, 0, np.pi / 2], b[:3] - [*first["point"], p[4]]
        return np.concatenate([at_clamp, on_a, a[4:] - b[:4], b[4:] - [*second["point"], p[5], 0.0]])

    # from a rough guess: straight lines, and forces and slopes that are off by some per cent
    mesh = np.linspace(0, 1, 60)
    line_a = [-0.4 + (first["point"][0] + 0.4) * mesh, first["point"][1] * mesh]
    line_b = first["point"][:, None] + (second["point"] - first["point"])[:, None] * mesh
    start = np.stack([*line_a, np.pi / 2 - 0.9 * mesh, -2.4 + 2 * mesh, *line_b, 0.6 - 0.05 * mesh, -0.4 + 0.4 * mesh])
    solved = scipy.integrate.solve_bvp(
        slopes, ends, mesh, start, p=[2.3, 1.1, 0.66, 0.33, 0.6, 0.55], tol=1e-9, max_nodes=5000
    )
    assert solved.success
    force_a, force_b, length_a, length_b, tau_a, tau_b = solved.p
    np.testing.assert_allclose([first["force"], second["force"]], [force_a, force_b], atol=1e-8)
    np.testing.assert_allclose([first["s1"], second["s1"]], [length_a, length_a + length_b], atol=1e-8)
    np.testing.assert_allclose([first["slope"], second["slope"]], [tau_a, tau_b], atol=1e-8)
    assert swept.m0z[0] == pytest.approx(-solved.y[3, 0], abs=1e-8)


CONVEX = [
    planar.Circle(0.3, (0.0, 0.8)),
    planar.Ellipse((0.5, 0.3), (0.1, 0.9), 0.4),
    planar.Polygon(
        np.array([0.0, 0.9]) + 0.5 * np.stack([f(0.4 + np.arange(4) * np.pi / 2) for f in (np.cos, np.sin)], axis=1)
    ),
]


@pytest.mark.slow
def test_convex_contours_agree_with_their_tables():
    cases = [(contour, friction) for contour in CONVEX for friction in (0.0, 0.3)]
    tables = [planar.sweep(contour, friction, samples=32) for contour, friction in cases]
    angles = [np.full(30, np.arctan(friction)) for _, friction in cases]
    outlines = Outlines([contour.loops() for contour, _ in cases])
    for table, followed in zip(tables, follow(outlines, [table.x0[1:-1] for table in tables], angles), strict=True):
        assert (followed.status == SweepStatus.ONE_CONTACT).all()
        truth = np.stack([table.f0x, table.f0y, table.m0z])[:, 1:-1]
        assert np.abs(np.stack(reactions_of(outlines, followed.rods)) - truth).max() < 1e-9
        np.testing.assert_allclose(followed.rods.s[:, 0], table.s1[1:-1], atol=1e-9)


@pytest.mark.slow
def test_mirror_image():
    polygon, base = planar.Polygon(letter_l_outline(4.5)), np.array([0.2, -0.36, -0.42])
    swept = planar.sweep(polygon, 0.2, base=base)
    image = planar.sweep(planar.contours.mirrored(polygon), 0.2, base=-base, direction=1)
    for one, other in ((swept.x0, -image.x0), (swept.f0x, -image.f0x), (swept.f0y, image.f0y), (swept.m0z, -image.m0z)):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(swept.contacts["point"][..., 0], -image.contacts["point"][..., 0])
    np.testing.assert_array_equal(swept.contacts["force_angle"], -image.contacts["force_angle"])
    assert swept.status.tolist() == [1, 2, 2]


def test_a_sweep_of_single_contacts_ends_at_its_second_one():
    polygon, base = planar.Polygon(letter_l_outline(4.5)), np.linspace(0.2, -0.6, 12)
    (whole,), (single,) = (planar.sweep_all([polygon], [0.2], base=[base], single=single) for single in (False, True))
    end = len(single)
    assert 0 < end <= np.flatnonzero(whole.status == SweepStatus.SEVERAL_CONTACTS)[0] + 1 < len(whole)
    for name in ("x0", "status", "phase", "f0x", "m0z", "friction"):
        np.testing.assert_array_equal(getattr(single, name), getattr(whole, name)[:end])
    (free,) = planar.sweep_all([planar.Circle(0.3, (0.0, 0.8))], [0.2], base=[base], single=True)
    assert len(free) == len(base)


def test_samples_reach_from_touch_down_to_the_end():
    swept = planar.sweep(planar.Polygon(letter_l_outline(1.2)), 0.3, samples=5)
    assert (swept.status > SweepStatus.FREE).all()
    assert (swept.phase != planar.Phase.NONE).all()


def outside_cone(swept):
    """How far forces of contacts lie outside the cone of friction, in radians."""
    angle = np.remainder(swept.contacts.force_angle - swept.contacts.slope + np.pi, 2 * np.pi) - np.pi
    return np.nanmax(np.abs(angle) - np.arctan(swept.friction)[:, None])


@pytest.mark.slow
def test_contacts_that_stick_stay_where_they_were_and_in_the_cone_of_friction():
    """Also where the next sample has another friction: the state is that of a sweep with its coefficient."""
    turn, rng = np.linspace(0, 2 * np.pi, 60, endpoint=False), np.random.default_rng(1)
    for _ in range(8):
        waves = (size * np.cos(rng.integers(2, 6) * turn + rng.uniform(0, 6)) for size in (0.35, 0.15))
        radius = 0.5 * (1 + sum(waves))
        height, _, friction = rng.uniform(0.3, 0.8), rng.random(), rng.uniform(0, 0.5, 150)
        rng.choice([-1, 1])
    x, y = radius * np.cos(turn), radius * np.sin(turn)
    contour = planar.Curve.from_points(x, y - y.min() + height)
    swept = planar.sweep(contour, friction, samples=150)
    assert outside_cone(swept) < 1e-8
    for i in (140, 141):
        alone = planar.sweep(contour, friction[i], base=swept.x0[: i + 1])
        assert swept.m0z[i] == pytest.approx(alone.m0z[i], abs=1e-8)
    rng = np.random.default_rng(90)
    corners = rng.integers(5, 12)
    angle, radius = np.sort(rng.uniform(0, 2 * np.pi, corners)), rng.uniform(0.2, 0.8, corners)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    swept = planar.sweep(
        planar.Polygon(np.column_stack([x, y - y.min() + rng.uniform(0.2, 0.6)])), rng.uniform(0.05, 0.6), samples=100
    )
    assert (swept.status == SweepStatus.SEVERAL_CONTACTS).any()
    assert outside_cone(swept) < 1e-8
