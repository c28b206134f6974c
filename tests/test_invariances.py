"""Invariances: mirror images, shifts, scales, other parameters of the same contour, order and choice of samples.

Over random contours and friction.  1e-9 rod lengths is the tolerance where both sides are computed: next to folds errors are
the square root of rounding, and no sample lies closer to a fold than some 1e-6.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import SupportCurve

import planar
from planar import Phase, segments

pytestmark = pytest.mark.slow

AGREES = 1e-9
twenty_examples = settings(max_examples=20, deadline=None)
eight_examples = settings(max_examples=8, deadline=None)

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


def assert_same(first, second):
    assert np.array_equal(first.phase, second.phase)
    for name in ("x0", "f0x", "f0y", "m0z", "s1", "slope", "point"):
        expected, actual = getattr(second, name), getattr(first, name)
        # reactions reach a thousand where the object is close to the base line
        np.testing.assert_allclose(actual, expected, rtol=AGREES, atol=AGREES, err_msg=name)


def mirror(contour):
    if isinstance(contour, planar.Polygon):
        return planar.Polygon(contour.vertices * [-1, 1])
    return planar.Ellipse(contour.semi_axes, (-contour.center[0], contour.center[1]), -contour.angle)


@twenty_examples
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


@twenty_examples
@given(contours, frictions)
def test_mirrored_reactions_give_mirrored_contacts(contour, friction):
    swept = planar.sweep(contour, friction, base=inner_base(contour, friction))
    leftward = planar.reconstruct(*swept.reactions, friction=friction)
    rightward = planar.reconstruct(-swept.x0, -swept.f0x, swept.f0y, -swept.m0z, friction=friction, direction=1)
    assert np.array_equal(leftward.status, rightward.status)
    assert np.array_equal(leftward.phase, rightward.phase)
    for name in ("slope", "force_angle"):
        np.testing.assert_array_equal(getattr(rightward, name), -getattr(leftward, name))
    for name in ("s1", "force", "friction_angle"):
        np.testing.assert_array_equal(getattr(rightward, name), getattr(leftward, name))
    for name in ("point", "normal", "normal_force", "tangential_force"):
        np.testing.assert_array_equal(getattr(rightward, name), getattr(leftward, name) * [-1, 1])
    lines = planar.elastic_lines(*swept.reactions, points=7)
    mirrored = planar.elastic_lines(-swept.x0, -swept.f0x, swept.f0y, -swept.m0z, points=7)
    np.testing.assert_allclose(mirrored.curved, lines.curved * [-1, 1], atol=1e-14)
    np.testing.assert_allclose(mirrored.straight, lines.straight * [-1, 1], atol=1e-14)


@twenty_examples
@given(contours, frictions)
def test_events_of_the_mirror_image(contour, friction):
    leftward, rightward = planar.events(contour, friction), planar.events(mirror(contour), friction, direction=1)
    assert np.array_equal(leftward.kind, rightward.kind)
    # at a fold the error of the place is the square root of rounding, that of the base position is rounding
    np.testing.assert_allclose(rightward.x0, -leftward.x0, atol=1e-9)
    np.testing.assert_allclose(rightward.slope, -leftward.slope, atol=1e-5)
    np.testing.assert_allclose(rightward.m0z, -leftward.m0z, rtol=1e-5, atol=1e-6)


@eight_examples
@given(contours, frictions, st.floats(-5.0, 5.0))
def test_shift(contour, friction, shift):
    base = inner_base(contour, friction)
    if isinstance(contour, planar.Polygon):
        shifted = planar.Polygon(contour.vertices + np.array([shift, 0]))
    else:
        shifted = planar.Ellipse(contour.semi_axes, (contour.center[0] + shift, contour.center[1]), contour.angle)
    swept = planar.sweep(contour, friction, base=base)
    shifted_sweep = planar.sweep(shifted, friction, base=base + shift)
    assert np.array_equal(swept.phase, shifted_sweep.phase)
    # shifting rounds x0 and with it the reactions, by more where they change faster
    np.testing.assert_allclose(shifted_sweep.point - [shift, 0], swept.point, atol=1e-7)
    np.testing.assert_allclose(shifted_sweep.m0z, swept.m0z, rtol=1e-7, atol=1e-7)


@twenty_examples
@given(st.floats(0.05, 1.0), st.floats(-1.3, 1.5), st.floats(0.05, 0.9), frictions)
def test_lengths_forces_and_moments_scale_with_the_rod(scale, slope, y, friction):
    # (1): a rod of λ L in the same shape has λ times the lengths, 1/λ² of the force, 1/λ of the moment
    slope, x, zeta = np.array([slope]), np.array([0.3]), np.arctan([friction])
    full = segments.tangential(slope, x, np.array([y]), zeta)
    scaled = segments.tangential(slope, scale * x, np.array([scale * y]), zeta)
    np.testing.assert_allclose(scaled.x0, scale * full.x0, atol=1e-13)
    np.testing.assert_allclose(scaled.s1, scale * full.s1, rtol=1e-13)
    np.testing.assert_allclose(scaled.force, full.force / scale**2, rtol=1e-13)
    np.testing.assert_array_equal(scaled.q, full.q)


@twenty_examples
@given(contours, frictions, st.floats(0.05, 1.0))
def test_contacts_scale_with_the_reactions(contour, friction, scale):
    swept = planar.sweep(contour, friction, base=inner_base(contour, friction))
    tangential = swept.phase == Phase.TANGENTIAL
    reactions = (swept.x0[tangential], swept.f0x[tangential], swept.f0y[tangential], swept.m0z[tangential])
    full = planar.reconstruct(*reactions)
    scaled = planar.reconstruct(
        *(column * scale**power for column, power in zip(reactions, (1, -2, -2, -1), strict=True))
    )
    assert (scaled.status == planar.Status.OK).all()
    np.testing.assert_allclose(scaled.point, scale * full.point, atol=1e-12)
    np.testing.assert_allclose(scaled.s1, scale * full.s1, atol=1e-12)
    np.testing.assert_allclose(scaled.friction_angle_bound, full.friction_angle_bound, atol=1e-11)


@eight_examples
@given(ellipses(), frictions)
def test_an_ellipse_by_other_parameters(ellipse, friction):
    (a, b), base = ellipse.semi_axes, inner_base(ellipse, friction)
    swept = planar.sweep(ellipse, friction, base=base)
    half_turn = planar.Ellipse((a, b), ellipse.center, ellipse.angle + np.pi)
    swapped = planar.Ellipse((b, a), ellipse.center, ellipse.angle + np.pi / 2)
    for other in (half_turn, swapped):
        assert_same(planar.sweep(other, friction, base=base), swept)


@eight_examples
@given(st.floats(0.02, 3.0), st.floats(0.05, 0.9), frictions)
def test_a_circle_by_other_classes(radius, gap, friction):
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

    for other in (planar.Ellipse((radius, radius), center, 0.7), SupportCurve(support, derivative, second_derivative)):
        assert_same(planar.sweep(other, friction, base=base), swept)


@twenty_examples
@given(st.floats(0.1, 1.5), st.floats(0.1, 0.9), frictions)
def test_a_circle_by_its_polygon(radius, gap, friction):
    count = 2000
    around = 2 * np.pi * np.arange(count) / count
    circle = planar.Circle(radius, (0.0, gap + radius))
    vertices = circle.center + radius * np.stack([np.cos(around), np.sin(around)], axis=1)
    base = inner_base(circle, friction)
    # next to the snap-off of the circle the two differ by more
    base = base[base > base[-1] + 0.05]
    smooth, faceted = (
        planar.sweep(circle, friction, base=base),
        planar.sweep(planar.Polygon(vertices), friction, base=base),
    )
    sagitta, edge = radius * (1 - np.cos(np.pi / count)), 2 * np.pi / count
    assert circle.distance(faceted.point).max() <= sagitta * (1 + 1e-9)
    # the slope is that of a neighbouring edge, and the tip touches somewhere on it
    assert np.abs(faceted.slope - smooth.slope).max() < edge
    assert np.linalg.norm(faceted.point - smooth.point, axis=1).max() < radius * edge
    same = faceted.phase == smooth.phase
    assert same.mean() > 0.9
    assert np.abs(faceted.m0z - smooth.m0z)[same].max() < 0.02


@twenty_examples
@given(contours, frictions, st.integers(0, 2**32 - 1))
def test_reconstruction_treats_every_row_separately(contour, friction, seed):
    swept = planar.sweep(contour, friction, base=inner_base(contour, friction))
    columns = swept.reactions
    order = np.random.default_rng(seed).permutation(len(swept))
    in_order, shuffled = planar.reconstruct(*columns), planar.reconstruct(*(column[order] for column in columns))
    for name in ("point", "s1", "phase", "status", "friction_angle_bound", "slope"):
        # SIMD lanes differ by a rounding
        np.testing.assert_allclose(getattr(shuffled, name), getattr(in_order, name)[order], rtol=1e-13, atol=1e-13)


@twenty_examples
@given(contours, frictions, st.integers(2, 7))
def test_a_sweep_does_not_depend_on_its_samples(contour, friction, step):
    base = inner_base(contour, friction, count=40)
    swept, selected = planar.sweep(contour, friction, base=base), planar.sweep(contour, friction, base=base[::step])
    assert np.array_equal(selected.phase, swept.phase[::step])
    for name in ("f0x", "f0y", "m0z", "s1", "slope", "point"):
        np.testing.assert_allclose(getattr(selected, name), getattr(swept, name)[::step], rtol=AGREES, atol=AGREES)


@twenty_examples
@given(contours, frictions)
def test_the_same_friction_for_every_sample(contour, friction):
    base = inner_base(contour, friction)
    swept = planar.sweep(contour, friction, base=base)
    assert_same(planar.sweep(contour, np.full(len(base), friction), base=base), swept)


@eight_examples
@given(contours, st.integers(0, 2**32 - 1))
def test_friction_per_sample_gives_the_state_of_a_sweep_with_that_friction(contour, seed):
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


@eight_examples
@given(st.lists(contours, min_size=1, max_size=4), frictions)
def test_sweeping_together_is_sweeping_alone(several, friction):
    bases = [inner_base(contour, friction, count=8) for contour in several]
    together = planar.sweep_all(several, [friction] * len(several), base=bases)
    for contour, base, swept in zip(several, bases, together, strict=True):
        assert_same(swept, planar.sweep(contour, friction, base=base))
