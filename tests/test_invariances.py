"""What must not change the answer: mirrors, shifts, scales, other words for the same contour, order and choice of samples.

Over random contours and friction.  1e-9 rod lengths is the tolerance where both sides are computed: next to folds the root
of double precision counts, and no sample lies closer to one than some 1e-6.
"""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import planar
from planar import Phase, equilibria

AGREES = 1e-9
few = settings(max_examples=20, deadline=None)
fewer = settings(max_examples=8, deadline=None)

frictions = st.one_of(st.just(0.0), st.floats(0.01, 2.0))
angles = st.floats(-np.pi, np.pi)


@st.composite
def ellipses(draw):
    a = draw(st.floats(0.05, 2.0))
    b = a * draw(st.floats(0.1, 1.0))
    angle = draw(angles)
    height = np.hypot(a * np.sin(angle), b * np.cos(angle)) + draw(st.floats(0.05, 0.9))
    return planar.Ellipse((a, b), (draw(st.floats(-1.0, 1.0)), height), angle)


@st.composite
def polygons(draw):
    # on an ellipse, so that they are convex
    count, turn, phase = draw(st.integers(3, 12)), draw(angles), draw(st.floats(0.1, 1.0))
    steps = np.cumsum(draw(st.lists(st.floats(0.5, 1.0), min_size=count, max_size=count)))
    around = phase + 2 * np.pi * steps / steps[-1]
    a = draw(st.floats(0.1, 1.5))
    b = a * draw(st.floats(0.3, 1.0))
    c, s = np.cos(turn), np.sin(turn)
    vertices = np.stack([a * np.cos(around), b * np.sin(around)], axis=1) @ [[c, s], [-s, c]]
    vertices += [draw(st.floats(-1.0, 1.0)), draw(st.floats(0.05, 0.9)) - vertices[:, 1].min()]
    return planar.Polygon(vertices)


contours = st.one_of(ellipses(), polygons())


def inner_base(contour, friction, count=20, **options):
    """Base positions within a sweep, away from its ends and from the snaps in it."""
    events = planar.events(contour, friction, **options)
    base = np.linspace(events.x0[0], events.x0[-1], count + 2)[1:-1]
    snaps = events.x0[np.isin(events.kind, (planar.EventKind.SNAP, planar.EventKind.SNAP_OFF))]
    near = np.abs(base[:, None] - snaps) < 1e-6
    return base[~near.any(axis=1)]


def assert_same(one, other):
    assert np.array_equal(one.phase, other.phase)
    for name in ("x0", "f0x", "f0y", "m0z", "s1", "slope", "point"):
        here, there = getattr(one, name), getattr(other, name)
        # reactions reach a thousand where the object is close to the base line
        np.testing.assert_allclose(here, there, rtol=AGREES, atol=AGREES, err_msg=name)


def mirror(contour):
    if isinstance(contour, planar.Polygon):
        return planar.Polygon(contour.vertices * [-1, 1])
    return planar.Ellipse(contour.semi_axes, (-contour.center[0], contour.center[1]), -contour.angle)


@few
@given(contours, frictions)
def test_mirror(contour, friction):
    base = inner_base(contour, friction)
    to_the_left = planar.sweep(contour, friction, base=base)
    to_the_right = planar.sweep(mirror(contour), friction, base=-base, direction=1)
    assert (to_the_left.phase != Phase.NONE).all()
    for name in ("x0", "f0x", "m0z", "slope"):
        np.testing.assert_allclose(
            getattr(to_the_right, name), -getattr(to_the_left, name), rtol=AGREES, atol=AGREES, err_msg=name
        )
    for name in ("f0y", "s1"):
        np.testing.assert_allclose(getattr(to_the_right, name), getattr(to_the_left, name), rtol=AGREES, err_msg=name)
    np.testing.assert_allclose(to_the_right.point, to_the_left.point * [-1, 1], atol=AGREES)


@few
@given(contours, frictions)
def test_mirrored_reactions_give_mirrored_contacts(contour, friction):
    swept = planar.sweep(contour, friction, base=inner_base(contour, friction))
    there = planar.reconstruct(swept.x0, swept.f0x, swept.f0y, swept.m0z, friction=friction)
    back = planar.reconstruct(-swept.x0, -swept.f0x, swept.f0y, -swept.m0z, friction=friction, direction=1)
    assert np.array_equal(there.status, back.status)
    assert np.array_equal(there.phase, back.phase)
    for name in ("slope", "force_angle"):
        np.testing.assert_array_equal(getattr(back, name), -getattr(there, name))
    for name in ("s1", "force", "friction_angle"):
        np.testing.assert_array_equal(getattr(back, name), getattr(there, name))
    for name in ("point", "normal", "normal_force", "tangential_force"):
        np.testing.assert_array_equal(getattr(back, name), getattr(there, name) * [-1, 1])
    lines = planar.elastic_lines(swept.x0, swept.f0x, swept.f0y, swept.m0z, points=7)
    mirrored = planar.elastic_lines(-swept.x0, -swept.f0x, swept.f0y, -swept.m0z, points=7)
    np.testing.assert_allclose(mirrored.curved, lines.curved * [-1, 1], atol=1e-14)
    np.testing.assert_allclose(mirrored.straight, lines.straight * [-1, 1], atol=1e-14)


@few
@given(contours, frictions)
def test_events_of_the_mirror_image(contour, friction):
    there, back = planar.events(contour, friction), planar.events(mirror(contour), friction, direction=1)
    assert np.array_equal(there.kind, back.kind)
    # a snap off a fold: the place has the root of double precision, its base position all of it
    np.testing.assert_allclose(back.x0, -there.x0, atol=1e-9)
    np.testing.assert_allclose(back.slope, -there.slope, atol=1e-5)
    np.testing.assert_allclose(back.m0z, -there.m0z, rtol=1e-5, atol=1e-6)


@fewer
@given(contours, frictions, st.floats(-5.0, 5.0))
def test_shift(contour, friction, shift):
    base = inner_base(contour, friction)
    if isinstance(contour, planar.Polygon):
        shifted = planar.Polygon(contour.vertices + np.array([shift, 0]))
    else:
        shifted = planar.Ellipse(contour.semi_axes, (contour.center[0] + shift, contour.center[1]), contour.angle)
    here, there = planar.sweep(contour, friction, base=base), planar.sweep(shifted, friction, base=base + shift)
    assert np.array_equal(here.phase, there.phase)
    # shifting rounds x0, and the reactions with it, most where they change fastest
    np.testing.assert_allclose(there.point - [shift, 0], here.point, atol=1e-7)
    np.testing.assert_allclose(there.m0z, here.m0z, rtol=1e-7, atol=1e-7)


@few
@given(st.floats(0.05, 1.0), st.floats(-1.3, 1.5), st.floats(0.05, 0.9), frictions)
def test_lengths_forces_and_moments_scale_with_the_rod(scale, slope, y, friction):
    # (1): a rod of λ L in the same shape has λ times the lengths, 1/λ² of the force, 1/λ of the moment
    slope, x, zeta = np.array([slope]), np.array([0.3]), np.arctan([friction])
    whole = equilibria.tangential(slope, x, np.array([y]), zeta)
    part = equilibria.tangential(slope, scale * x, np.array([scale * y]), zeta)
    np.testing.assert_allclose(part.x0, scale * whole.x0, atol=1e-13)
    np.testing.assert_allclose(part.s1, scale * whole.s1, rtol=1e-13)
    np.testing.assert_allclose(part.root_f, whole.root_f / scale, rtol=1e-13)
    np.testing.assert_array_equal(part.q, whole.q)


@few
@given(contours, frictions, st.floats(0.05, 1.0))
def test_contacts_scale_with_the_reactions(contour, friction, scale):
    swept = planar.sweep(contour, friction, base=inner_base(contour, friction))
    lies = swept.phase == Phase.TANGENTIAL
    reactions = (swept.x0[lies], swept.f0x[lies], swept.f0y[lies], swept.m0z[lies])
    whole = planar.reconstruct(*reactions)
    part = planar.reconstruct(*(v * scale**power for v, power in zip(reactions, (1, -2, -2, -1), strict=True)))
    assert (part.status == planar.Status.OK).all()
    np.testing.assert_allclose(part.point, scale * whole.point, atol=1e-12)
    np.testing.assert_allclose(part.s1, scale * whole.s1, atol=1e-12)
    np.testing.assert_allclose(part.friction_angle_bound, whole.friction_angle_bound, atol=1e-11)


@fewer
@given(ellipses(), frictions)
def test_an_ellipse_by_other_parameters(ellipse, friction):
    (a, b), base = ellipse.semi_axes, inner_base(ellipse, friction)
    swept = planar.sweep(ellipse, friction, base=base)
    half_turn = planar.Ellipse((a, b), ellipse.center, ellipse.angle + np.pi)
    swapped = planar.Ellipse((b, a), ellipse.center, ellipse.angle + np.pi / 2)
    for other in (half_turn, swapped):
        assert_same(planar.sweep(other, friction, base=base), swept)


@fewer
@given(st.floats(0.02, 3.0), st.floats(0.05, 0.9), frictions)
def test_a_circle_by_other_names(radius, gap, friction):
    center = (0.1, gap + radius)
    circle = planar.Circle(radius, center)
    base = inner_base(circle, friction)
    swept = planar.sweep(circle, friction, base=base)

    def support(slope):
        return radius + center[0] * np.sin(slope) - center[1] * np.cos(slope)

    def derivative(slope):
        return center[0] * np.cos(slope) + center[1] * np.sin(slope)

    def second_derivative(slope):
        return -center[0] * np.sin(slope) + center[1] * np.cos(slope)

    for other in (
        planar.Ellipse((radius, radius), center, 0.7),
        planar.Curve.from_support(support, derivative, second_derivative),
        planar.Curve.from_support(support, derivative),
        planar.Curve(circle.points),
    ):
        assert_same(planar.sweep(other, friction, base=base), swept)


@few
@given(st.floats(0.1, 1.5), st.floats(0.1, 0.9), frictions)
def test_a_circle_by_its_polygon(radius, gap, friction):
    count = 2000
    around = 2 * np.pi * np.arange(count) / count
    circle = planar.Circle(radius, (0.0, gap + radius))
    vertices = circle.center + radius * np.stack([np.cos(around), np.sin(around)], axis=1)
    base = inner_base(circle, friction)
    # the circle's snap-off is the last thing the polygon can follow
    base = base[base > base[-1] + 0.05]
    smooth, faceted = (
        planar.sweep(circle, friction, base=base),
        planar.sweep(planar.Polygon(vertices), friction, base=base),
    )
    sagitta, edge = radius * (1 - np.cos(np.pi / count)), 2 * np.pi / count
    assert circle.distance(faceted.point).max() <= sagitta * (1 + 1e-9)
    # the slope is that of the edge next to it, and a tip rests where on the edge it can
    assert np.abs(faceted.slope - smooth.slope).max() < edge
    assert np.linalg.norm(faceted.point - smooth.point, axis=1).max() < radius * edge
    same = faceted.phase == smooth.phase
    assert same.mean() > 0.9
    assert np.abs(faceted.m0z - smooth.m0z)[same].max() < 0.02


@few
@given(contours, frictions, st.integers(0, 2**32 - 1))
def test_reconstruction_takes_every_row_by_itself(contour, friction, seed):
    swept = planar.sweep(contour, friction, base=inner_base(contour, friction))
    columns = (swept.x0, swept.f0x, swept.f0y, swept.m0z)
    order = np.random.default_rng(seed).permutation(len(swept))
    in_order, shuffled = planar.reconstruct(*columns), planar.reconstruct(*(column[order] for column in columns))
    for name in ("point", "s1", "phase", "status", "friction_angle_bound", "slope"):
        # SIMD lanes differ by a rounding
        np.testing.assert_allclose(getattr(shuffled, name), getattr(in_order, name)[order], rtol=1e-13, atol=1e-13)


@few
@given(contours, frictions, st.integers(2, 7))
def test_a_sweep_does_not_depend_on_its_samples(contour, friction, step):
    base = inner_base(contour, friction, count=40)
    swept, some = planar.sweep(contour, friction, base=base), planar.sweep(contour, friction, base=base[::step])
    assert np.array_equal(some.phase, swept.phase[::step])
    for name in ("f0x", "f0y", "m0z", "s1", "slope", "point"):
        np.testing.assert_allclose(getattr(some, name), getattr(swept, name)[::step], rtol=AGREES, atol=AGREES)


@few
@given(contours, frictions)
def test_the_same_friction_for_every_sample(contour, friction):
    base = inner_base(contour, friction)
    swept = planar.sweep(contour, friction, base=base)
    assert_same(planar.sweep(contour, np.full(len(base), friction), base=base), swept)


@fewer
@given(contours, st.integers(0, 2**32 - 1))
def test_friction_of_its_own_puts_a_sample_where_a_sweep_with_it_is(contour, seed):
    rng = np.random.default_rng(seed)
    # the bases of the sweep that ends first
    base = inner_base(contour, 0.0, count=6)
    friction = rng.uniform(0, 1, len(base))
    swept = planar.sweep(contour, friction, base=base)
    for i in np.flatnonzero(swept.phase != Phase.NONE):
        alone = planar.sweep(contour, friction[i], base=base[i : i + 1])
        assert alone.phase[0] == swept.phase[i]
        np.testing.assert_allclose(swept.point[i], alone.point[0], atol=AGREES)
        np.testing.assert_allclose(swept.m0z[i], alone.m0z[0], rtol=AGREES, atol=AGREES)


@fewer
@given(st.lists(contours, min_size=1, max_size=4), frictions)
def test_sweeping_together_is_sweeping_alone(several, friction):
    bases = [inner_base(contour, friction, count=8) for contour in several]
    together = planar.sweep_all(several, [friction] * len(several), base=bases)
    for contour, base, swept in zip(several, bases, together, strict=True):
        assert_same(swept, planar.sweep(contour, friction, base=base))
