"""Contacts from two of three reactions, against the sweep that made them and against drawn noise."""

from functools import cache

import numpy as np
import pytest

import planar
from planar.channels import Frames, by_push
from planar.rods import solve

CIRCLE = planar.Circle(radius=0.9, center=(0.0, 1.3))
CONE = planar.Rod(tip_diameter=0.5)
CHANNELS = ("f0x", "f0y", "m0z")


def without(sweep, missing):
    return [
        None if name == missing else column for name, column in zip(("x0", *CHANNELS), sweep.reactions, strict=True)
    ]


def felt(sweep):
    return np.hypot(sweep.f0x, sweep.f0y) > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("direction", [-1, 1])
@pytest.mark.parametrize(
    ("missing", "friction"), [("f0x", 0.3), ("f0y", 0.0), ("f0y", 0.3), ("m0z", 0.0), ("m0z", 0.3)]
)
def test_known_friction_stands_for_a_channel(missing, friction, direction):
    sweep = planar.sweep(CIRCLE, friction, samples=60, direction=direction)
    near = 0.99 * getattr(sweep, missing)
    done = planar.complete(*without(sweep, missing), friction=friction, near=near, direction=direction)
    found = planar.reconstruct(*done.reactions, direction=direction)
    rows = felt(sweep)
    assert np.abs(found.point - sweep.point)[rows].max() < 1e-12
    # a single value where it is unique: no other one is taken for the truth
    alone = planar.complete(*without(sweep, missing), friction=friction, direction=direction)
    unique = rows & (alone.roots == 1)
    values = getattr(alone.reactions, missing)
    np.testing.assert_allclose(values[unique], getattr(sweep, missing)[unique], atol=1e-9)
    assert np.isnan(values[alone.roots > 1]).all()
    assert (alone.roots[rows] >= 1).all()
    assert unique[rows].mean() == {"f0x": 0, "f0y": 1}.get(missing, pytest.approx(0.8, abs=0.1))


@pytest.mark.parametrize("missing", CHANNELS)
def test_known_slopes_and_tips_stand_for_a_channel(missing):
    sweep = planar.sweep(CIRCLE, 0.2, samples=60)
    near = getattr(sweep, missing)
    for rows, known in (
        (sweep.phase == planar.Phase.TANGENTIAL, {"slope": np.nan_to_num(sweep.slope)}),
        (sweep.phase == planar.Phase.TIP, {"tip": True}),
    ):
        done = planar.complete(*without(sweep, missing), near=near, **known)
        found = planar.reconstruct(*done.reactions)
        assert np.abs(found.point - sweep.point)[rows & felt(sweep)].max() < 1e-12


@pytest.mark.parametrize("missing", CHANNELS)
def test_no_root_is_lost_at_the_border_of_all_rods(missing):
    # any rods, scaled so that they touch with their tips
    rng, count = np.random.default_rng(0), 2000
    angle = rng.uniform(-3, 3, count)
    reactions = np.stack([-np.sin(angle), np.cos(angle), 2 * np.cos(angle / 2) * rng.uniform(0.001, 1, count)])
    s1 = solve("closed-form", planar.Rod(), *reactions).s1
    reactions *= s1 ** [[2], [2], [1]]
    reactions = reactions[:, (s1 > 0.01) & (s1 < 11)]
    assert reactions.shape[1] > 500
    true = reactions[CHANNELS.index(missing)]
    given = [None if name == missing else column for name, column in zip(CHANNELS, reactions, strict=True)]
    x0 = np.zeros(len(true))
    found = getattr(planar.complete(x0, *given, tip=True, near=true).reactions, missing)
    alone = planar.complete(x0, *given, tip=True)
    np.testing.assert_allclose(found, true, rtol=1e-5)
    np.testing.assert_allclose(getattr(alone.reactions, missing)[alone.roots == 1], true[alone.roots == 1], rtol=1e-5)


def test_all_rows_of_sweeps_along_tapered_rods_are_completed():
    rod = planar.Rod(tip_diameter=0.4)
    sweep = planar.sweep(planar.Circle(0.5, (0.0, 1.0)), 0.9, samples=20, rod=rod)
    done = planar.complete(*without(sweep, "m0z"), friction=0.9, near=sweep.m0z, rod=rod)
    np.testing.assert_allclose(done.reactions.m0z[felt(sweep)], sweep.m0z[felt(sweep)], rtol=1e-6)


@pytest.mark.parametrize("direction", [-1, 1])
def test_whole_moments_of_heavy_rods_may_have_either_sign(direction):
    # gravity bends the rod as the sweep moves, the contact against it: the moment passes zero
    rod = planar.Rod(weight=3.0, gravity=(direction, 0.2), compliance=0.05)
    sweep = planar.sweep(planar.Circle(0.3, (0.0, 0.75)), 0.3, samples=60, rod=rod, direction=direction)
    rows = np.flatnonzero(sweep.phase == planar.Phase.TANGENTIAL)[1:6]
    x0, f0x, f0y, m0z = np.array(sweep.reactions)[:, rows]
    assert (m0z > 0).any()
    assert (m0z < 0).any()
    told = {"friction": 0.3, "direction": direction, "rod": rod}
    done = planar.complete(x0, f0x, f0y, None, near=m0z, **told)
    np.testing.assert_allclose(done.reactions.m0z, m0z, atol=1e-8)
    followed = planar.complete_by_moment(x0, m0z, float(sweep.s1[rows[0]]), **told)
    np.testing.assert_allclose(followed[1:], [f0x, f0y, m0z], atol=1e-8)


@pytest.mark.slow
def test_axial_force_and_moment_locate_contacts_of_tapered_rods_only():
    sweep = planar.sweep(CIRCLE, 0.0, samples=9)
    with pytest.raises(ValueError, match="do not locate"):
        planar.complete(*without(sweep, "f0x"), friction=0.0, rod=planar.Rod(curvature=-0.2))
    sweep = planar.sweep(CIRCLE, 0.0, samples=5, rod=CONE)
    done = planar.complete(*without(sweep, "f0x"), friction=0.0, rod=CONE)
    rows = felt(sweep) & (done.roots == 1)
    assert rows.sum() >= 3
    found = planar.reconstruct(*done.reactions, rod=CONE)
    assert np.abs(found.point - sweep.point)[rows].max() < 1e-8


@pytest.mark.parametrize("missing", CHANNELS)
def test_errors_are_those_of_drawn_noise(missing):
    sweep = planar.sweep(CIRCLE, 0.3, samples=12)
    rows = np.flatnonzero(felt(sweep) & (np.abs(sweep.s1 - 1) > 0.01) | (sweep.phase == planar.Phase.TIP))[2:-2]
    draws, noise, sd = 200, (1e-7, 2e-7), 3e-7
    rng = np.random.default_rng(1)
    columns = np.repeat(np.array(sweep.reactions)[:, rows], draws, axis=1)
    columns[1:] += rng.standard_normal(columns[1:].shape) * np.array([noise[0], noise[0], noise[1]])[:, None]
    friction = np.tan(np.arctan(0.3) + sd * rng.standard_normal(columns.shape[1]))
    near = np.repeat(getattr(sweep, missing)[rows], draws)
    given = [None if name == missing else column for name, column in zip(("x0", *CHANNELS), columns, strict=True)]
    found = planar.reconstruct(*planar.complete(*given, friction=friction, near=near).reactions, tolerance=1e-5)
    tip = sweep.phase[rows] == planar.Phase.TIP
    reactions = [column[rows] for column in sweep.reactions[1:]]
    stated = planar.errors(*reactions, noise=noise, missing=missing, known_sd=sd, tip=tip)
    covariance = np.tile(np.diag(np.square([noise[0], noise[0], noise[1]])), (len(rows), 1, 1))
    by_covariance = planar.errors(
        *reactions, noise=(0, 0), covariance=covariance, missing=missing, known_sd=sd, tip=tip
    )
    for one, other in zip(stated, by_covariance, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-20)
    off = found.point.reshape(len(rows), draws, 2) - sweep.point[rows][:, None]
    chi = np.einsum("nki,nij,nkj->nk", off, np.linalg.inv(stated.point + 1e-22 * np.eye(2)), off).mean(axis=1) / 2
    np.testing.assert_allclose(chi, 1, atol=5 / np.sqrt(draws))


ELLIPSE = planar.Ellipse((0.5, 0.3), (0.0, 0.8), 0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("friction", "direction", "rod"),
    [(0.0, -1, None), (0.3, 1, None), pytest.param(0.2, -1, CONE, marks=pytest.mark.slow)],
)
def test_the_moment_alone_is_enough_along_a_sweep(friction, direction, rod):
    off, coarse = [], 40 if rod is None else 8
    for samples in (coarse, 2 * coarse):
        swept = planar.sweep(ELLIPSE, friction, samples=samples, direction=direction, rod=rod)
        rows = np.flatnonzero((swept.phase == planar.Phase.TANGENTIAL) & felt(swept))
        rows = rows[: np.argmin(np.append(np.diff(rows) == 1, False)) + 1]
        given = swept.x0[rows], swept.m0z[rows], float(swept.s1[rows[0]])
        done = planar.complete_by_moment(*given, friction=friction, direction=direction, rod=rod)
        found = planar.reconstruct(*done, tolerance=1e-3, direction=direction, rod=rod)
        assert (found.status == planar.Status.OK).all()
        np.testing.assert_allclose(found.friction, friction, atol=1e-6)
        off.append(ELLIPSE.distance(found.point).max())
        assert np.abs(found.point - swept.point[rows]).max() < 40 * off[-1]
    # of the second order in the step
    assert off[0] < 3e-4 * (40 / coarse) ** 2
    assert off[1] < 0.4 * off[0]
    # an error of the start dies out
    wrong = planar.complete_by_moment(*given[:2], given[2] - 0.01, friction=friction, direction=direction, rod=rod)
    apart = planar.reconstruct(*wrong, tolerance=1e-2, direction=direction, rod=rod).point - swept.point[rows]
    assert np.hypot(*apart[-1]) < 0.2 * np.hypot(*apart[0])


def test_single_touches_are_located_by_a_push():
    # published values, and the rod itself: contact with the tip of a body that is pushed by little
    np.testing.assert_allclose(planar.touched_at([5.833333333, 2.037037037], rod=CONE), [0.6, 0.9], atol=1e-8)
    s1 = np.linspace(0.05, 1.0, 20)
    np.testing.assert_allclose(planar.touched_at(3 / s1**2), s1, atol=1e-9)
    np.testing.assert_allclose(
        planar.touched_at(-1 / (s1 / 3 * s1 + 0.05 * s1), rod=planar.Rod(compliance=0.05)), s1, atol=1e-6
    )
    assert np.isnan(planar.touched_at(2.9)).all()
    rows = np.zeros((5, 2))
    still = Frames(np.zeros(5, dtype=int), rows, np.tile(np.eye(2), (5, 1, 1)), rows)
    assert np.isnan(by_push(still, np.linspace(0.1, 0.5, 5), noise=1e-4)).all()


def test_of_no_rows_nothing_is_completed():
    assert len(planar.complete([], [], [], None, friction=0.3).roots) == 0


# bending stiffness that falls to a twelfth, as that of beams made for such sensors
BEAM = planar.Rod(stiffness=[[s, 12.0**-s] for s in np.linspace(0, 1, 7)])


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [2, pytest.param(30, marks=pytest.mark.trust)])
def test_errors_by_axial_force_and_moment_are_those_of_drawn_noise(seeds):
    swept, noise = planar.sweep(CIRCLE, 0.0, samples=14, rod=BEAM), 1e-4
    rows = np.flatnonzero((swept.phase == planar.Phase.TANGENTIAL) & (np.abs(swept.f0x) > 0.1))
    true = np.tile(np.array(swept.reactions)[:, rows], seeds)
    x0, _, f0y, m0z = true + noise * np.random.default_rng(0).standard_normal(true.shape) * [[0], [1], [1], [1]]
    done = planar.complete(x0, None, f0y, m0z, friction=0.0, near=true[1], rod=BEAM)
    off = planar.reconstruct(*done.reactions, rod=BEAM, tolerance=0.02).point - np.tile(swept.point[rows], (seeds, 1))
    reactions = [column[rows] for column in swept.reactions[1:]]
    tip = np.zeros(len(rows), dtype=bool)
    stated = planar.errors(*reactions, noise=(noise, noise), rod=BEAM, missing="f0x", tip=tip)
    inverse = np.tile(np.linalg.inv(stated.point), (seeds, 1, 1))
    chi = np.einsum("ni,nij,nj->n", off, inverse, off) / 2
    assert len(chi) > 8 * seeds
    assert abs(chi.mean() - 1) < max(0.2, 5 / np.sqrt(len(chi)))


# Root mean square errors of the place by noise of 0.005 on each channel that is measured, over the tangential contacts of a
# sweep, or those at the tip: median and 90th percentile, by channels, of a uniform rod and of one of half the diameter at its
# tip.  What stands for the channel: the friction angle of 0.3 or of 0, the slope, or the tip.
PUBLISHED = [
    (None, 0.3, "", ((0.0025, 0.006), (0.0035, 0.012))),
    ("m0z", 0.3, "friction", ((0.0008, 0.0035), (0.0006, 0.005))),
    ("f0y", 0.3, "friction", ((0.0013, 0.004), (0.0013, 0.008))),
    ("f0y", 0.3, "slope", ((0.0017, 0.006), (0.0013, 0.007))),
    ("f0x", 0.0, "friction", (None, (0.0027, 0.015))),
    ("f0x", 0.3, "friction", ((0.013, 0.029), (0.0025, 0.010))),
    ("f0x", 0.3, "tip", ((0.0017,), (0.0033,))),
    ("m0z", 0.3, "tip", ((0.0017,), (0.0033,))),
]


@cache
def swept_once(friction, rod):
    return planar.sweep(CIRCLE, friction, samples=60, rod=rod)


@pytest.mark.slow
@pytest.mark.parametrize(("missing", "friction", "known", "published"), PUBLISHED)
def test_errors_of_each_set_of_channels_are_the_published_ones(missing, friction, known, published):
    draws = 24
    for rod, figures in zip((planar.Rod(), CONE), published, strict=True):
        if figures is None:  # one number measured twice
            continue
        swept = swept_once(friction, rod)
        phase = planar.Phase.TIP if known == "tip" else planar.Phase.TANGENTIAL
        rows = np.flatnonzero((swept.phase == phase) & felt(swept))
        reactions = [column[rows] for column in swept.reactions[1:]]
        told = {} if missing is None else {"missing": missing, "known": "slope" if known == "slope" else "friction"}
        stated = planar.errors(*reactions, noise=(0.005, 0.005), rod=rod, **told, tip=known == "tip")
        rms = np.sqrt(np.trace(stated.point, axis1=1, axis2=2))
        np.testing.assert_allclose(np.percentile(rms, (50, 90))[: len(figures)], figures, rtol=0.2)
        if missing == "m0z":  # whose noise nobody states
            without = planar.errors(*reactions, noise=(0.005, 0.0), rod=rod, **told, tip=known == "tip")
            np.testing.assert_allclose(without.point, stated.point, rtol=1e-6)
        # and those of contacts found from drawn noise, so small that they are linear in it
        if missing is None or not rod.is_uniform:
            continue
        true = np.repeat(np.array(swept.reactions)[:, rows], draws, axis=1)
        drawn = true + 1e-4 * np.random.default_rng(2).standard_normal(true.shape) * [[0], [1], [1], [1]]
        given = [None if name == missing else column for name, column in zip(("x0", *CHANNELS), drawn, strict=True)]
        slope = np.repeat(np.nan_to_num(swept.slope[rows]), draws)
        instead = {"friction": friction, "slope": slope, "tip": True}[known]
        done = planar.complete(*given, **{known: instead}, near=true[1 + CHANNELS.index(missing)], rod=rod)
        off = planar.reconstruct(*done.reactions, rod=rod, tolerance=0.2).point.reshape(len(rows), draws, 2)
        drawn_rms = np.sqrt(((off - swept.point[rows][:, None]) ** 2).sum(axis=2).mean(axis=1)) * 50
        np.testing.assert_allclose(np.nanmedian(drawn_rms), figures[0], rtol=0.25)
