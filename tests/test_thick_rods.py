"""Planar scans with thick rods: the centre line touches the fattened body, and bounds are those of the body itself."""

from dataclasses import replace

import numpy as np
import pytest
import shooting
import trimesh
from sample_bodies import random_body

import planar
import scan3d
from planar.segments import tangential
from scan3d import Rod
from scan3d.bounds.enclosures import _thinner, _volumes, enclosure, shell, sticking_out
from scan3d.files.text import parse_rod
from scan3d.geometry.distance import nearest
from scan3d.geometry.sections import slice_frame
from scan3d.pipeline import analyse
from scan3d.report import report, summary
from scan3d.simulation.felt import grown_extent, sections
from tests.robustness.bounds import false_statements

pytestmark = pytest.mark.slow

WIRE = parse_rod("steel:0.3x50")


def ball(radius):
    return trimesh.creation.icosphere(subdivisions=4, radius=radius)


@pytest.mark.parametrize(
    ("body", "axis"),
    [
        (trimesh.creation.box((20, 16, 12)), (0, 0, 1)),
        (random_body(0), (0.3, 0.5, 0.8)),
        pytest.param(random_body(2), (0.3, 0.5, 0.8), marks=pytest.mark.trust),
        pytest.param(ball(20.0), (0, 0, 1), marks=pytest.mark.slow),
    ],
)
def test_sections_of_a_fattened_body_lie_at_its_radius(body, axis):
    frame, radius, length = slice_frame(np.array(axis, dtype=float)), 0.3, 50.0
    low, high = grown_extent(body, frame[2], radius)
    heights = np.linspace(low, high, 9)[1:-1]
    for height, (polygon,) in zip(heights, sections(body, frame, heights, radius, length), strict=True):
        following = np.roll(polygon, -1, axis=0)
        corners, middles = (
            np.column_stack([points, np.full(len(points), height)]) @ frame
            for points in (polygon, (polygon + following) / 2)
        )
        assert np.abs(nearest(corners, body)[0] - radius).max() < 1e-12 * length
        off = nearest(middles, body)[0] - radius
        assert off.max() < 1e-12 * length
        assert off.min() > -3e-10 * length


@pytest.mark.parametrize("noise", [1e-4, *(pytest.param(noise, marks=pytest.mark.trust) for noise in (0.0, 1e-3))])
def test_a_thick_rod_on_a_ball_is_a_thin_one_on_a_larger_ball(noise):
    truth, larger = ball(20.0), ball(20.15)
    plan = scan3d.Plan(slices=6, samples=24, friction=0.3, noise=noise, rod=WIRE.without_thickness())
    log = replace(scan3d.simulate(larger, plan), rod=WIRE)
    thick = analyse(log, truth, model="planar")
    assert thick.warnings == ()
    assert false_statements(truth, thick) == []
    assert thick.cloud.rod_radius == pytest.approx(0.15)
    # it is no weaker than the bound of the larger ball
    assert thick.bounds.bound < 1.01 * thick.bounds.fattened.bound
    assert thick.contact_error.max() < 0.01 + 200 * noise


@pytest.mark.parametrize("seed", [6, *(pytest.param(seed, marks=pytest.mark.trust) for seed in range(20) if seed != 6)])
def test_scans_with_thick_rods_are_certified(seed):
    body = random_body(seed)
    rod = Rod.wire(float(np.linalg.norm(body.extents)) / 1000, 0.6e-3, 210e9)
    plan = scan3d.Plan(slices=8, samples=30, sweeps=6, friction=(0.0, 0.4), rod=rod, noise=(0.0, 1e-4, 1e-3)[seed % 3])
    log = scan3d.simulate(body, plan)
    assert log.rod == rod
    found = analyse(log, body)
    assert found.warnings == ()
    assert np.isfinite(found.bounds.bound)
    assert false_statements(body, found) == []
    if not plan.noise:
        off = np.abs(nearest(found.cloud.fattened.points, body)[0] - found.cloud.rod_radius)
        assert off.max() < 1e-9 * found.cloud.rod_length


def with_friction_on_the_surface(log, body):
    """The tangential contacts of a thin rod with the fattened body, as those of a thick one: the force acts on its surface.

    So it has a moment about the centre line, which it would lack farther along the rod (MODEL3D (S25)).  Other rows stay.
    """
    cloud = scan3d.reconstruct(log).fattened
    rows = cloud.row[cloud.phase == planar.Phase.TANGENTIAL]
    kept = cloud.select(cloud.phase == planar.Phase.TANGENTIAL)
    foot = nearest(kept.points, body)[2]
    outward = kept.points - foot
    radius, length = float(np.linalg.norm(outward, axis=1).mean()), kept.rod_length
    axes = log.axes()[rows]
    place = np.einsum("nij,nj->ni", axes, kept.points - log.position_m[rows] * 1000) / length
    inside = np.einsum("nij,nj->ni", axes, outward)[:, :2] / length  # the part of the radius in the plane
    slope = np.arctan2(inside[:, 0], -inside[:, 1])
    lever = np.linalg.norm(inside, axis=1) * kept.friction
    x, y = place[:, 0] - lever * np.cos(slope), place[:, 1] - lever * np.sin(slope)
    angle = np.arctan(kept.friction)
    state = tangential(slope, x, y, angle)
    good = np.isfinite(state.x0) & (state.s1 + lever < 1) & (state.q > 0)
    force, direction = state.force, slope + angle
    rod = log.rod
    columns = {
        name: getattr(log, name).copy() for name in ("sweep", "position_m", "quaternion", "force_N", "moment_Nm")
    }
    columns["position_m"][rows] += state.x0[:, None] * rod.length_m * axes[:, 0]
    columns["force_N"][rows] = rod.force_unit_N * np.stack(
        [-force * np.sin(direction), force * np.cos(direction)], axis=1
    )
    columns["moment_Nm"][rows] = state.m0z * rod.moment_unit_Nm
    moved = replace(log, **{name: np.delete(column, rows[~good], axis=0) for name, column in columns.items()})
    return moved, radius, (state, slope, angle, lever, x, y)


def test_a_thick_rod_with_friction_bends_as_a_thin_one_beyond_its_contact():
    body = ball(20.0)
    log = scan3d.simulate(body, scan3d.Plan(slices=3, samples=20, sweeps=2, friction=0.3, rod=WIRE))
    _, _, (state, slope, angle, lever, x, y) = with_friction_on_the_surface(log, body)
    k = np.flatnonzero(np.isfinite(state.x0) & (state.q > 0.1))[::20]
    slope, angle, lever, force = slope[k], angle[k], lever[k], state.force[k]
    end = shooting.integrate(state.x0[k], force, slope + angle, -state.m0z[k], state.s1[k] + lever)[..., 0]
    # at the contact itself: its place, its tangent, and the moment of the force about it
    np.testing.assert_allclose(end[:2], [x[k] + lever * np.cos(slope), y[k] + lever * np.sin(slope)], atol=1e-7)
    np.testing.assert_allclose(end[2], slope, atol=1e-5)
    np.testing.assert_allclose(np.abs(end[3]), lever * force * np.cos(angle), rtol=1e-3)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.trust) for seed in range(1, 20))])
def test_bounds_hold_with_friction_on_the_surface_of_the_rod(seed):
    body = random_body(seed)
    rod = Rod.wire(float(np.linalg.norm(body.extents)) / 1000, 0.8e-3, 210e9)
    plan = scan3d.Plan(slices=8, samples=30, sweeps=6, friction=0.5, rod=rod)
    log, radius, _ = with_friction_on_the_surface(scan3d.simulate(body, plan), body)
    assert radius == pytest.approx(0.4, abs=1e-6)
    found = analyse(log, body)
    assert found.warnings == ()
    assert np.isfinite(found.bounds.bound)
    assert found.cloud.fattened.lever == pytest.approx(radius * (np.hypot(1, 0.5) - 1), rel=1e-3)
    assert false_statements(body, found) == []


def test_an_unknown_diameter_is_asked_for():
    plan = scan3d.Plan(slices=4, samples=20, sweeps=3, rod=WIRE.without_thickness())
    simulated = scan3d.simulate(ball(20.0), plan)
    measured = replace(simulated, source={"kind": "import"})
    rows = {}
    for name, log in (("simulated", simulated), ("measured", measured), ("stated", replace(measured, rod=WIRE))):
        data = report(analyse(log), settings={})
        rows[name] = dict(summary(data)[1])
        assert bool(data["certificate"]["grown"]) == (name == "measured")
    assert "state diameter_m" in rows["measured"]["measured"]
    assert "measured" not in rows["stated"]
    assert rows["stated"]["rod's radius"] == "contacts moved by 150 µm from the rod's centre line"


def test_a_tapered_rod_moves_contacts_by_its_radius_there_and_certifies_nothing():
    cone = replace(WIRE, tip_diameter_m=0.1e-3)
    log = scan3d.simulate(ball(20.0), scan3d.Plan(slices=6, samples=20, sweeps=4, rod=cone))
    assert log.rod == cone.without_thickness()
    assert np.isfinite(analyse(log).certificate.bound)
    thick = analyse(replace(log, rod=cone))
    moved = np.linalg.norm(thick.cloud.points - thick.cloud.fattened.points, axis=1)
    assert 0.05 - 1e-9 < moved.min() < moved.max() < 0.15
    assert moved[thick.cloud.phase == planar.Phase.TIP] == pytest.approx(0.05, abs=1e-6)
    data = report(thick, settings={})
    assert thick.certificate.bound == np.inf
    assert "the rod's radius changes along it" in dict(summary(data)[1])["certified"]


def test_an_inner_body_that_is_thinner_than_the_rod_sticks_out_no_farther_than_is_stated():
    wedge = trimesh.convex.convex_hull([[0, 0, 0], [20, 0, 0], [0, 16, 0], [3, 3, 1]])
    bounds = enclosure(scan3d.reconstruct(scan3d.simulate(wedge, scan3d.Plan(slices=8, spacing="cosine", samples=16))))
    found = _thinner(bounds, 0.5)
    # the farthest of its corners, which stick out by different lengths
    assert sticking_out(found.inner.vertices, found.inner_bodies).max() == pytest.approx(found.excess, rel=1e-9)
    assert 0.2 < found.excess <= found.bound


@pytest.mark.parametrize("unit", [1.0, 1e-7])
def test_a_shell_has_the_volume_by_which_a_fattened_body_is_larger(unit):
    """In any unit: trimesh takes faces below an absolute area for none, which made volumes of small bodies false."""
    body = trimesh.creation.box((20 * unit, 16 * unit, 12 * unit)).subdivide()
    flat, round_edges = 2 * (20 * 16 + 20 * 12 + 16 * 12) * 0.3, np.pi * 0.3**2 * (20 + 16 + 12)
    exact = flat + round_edges + 4 / 3 * np.pi * 0.3**3
    assert shell(body, 0.3 * unit) == pytest.approx(exact * unit**3, rel=1e-12)


def test_the_volume_of_a_ball_in_the_hull_of_the_fattened_one_is_known():
    inner, outer = (trimesh.creation.icosphere(5, radius) for radius in (10.0, 12.0))
    low, high = _volumes(inner, 0.0, outer.vertices, 2.0, unbounded=False)
    assert low == pytest.approx(inner.volume)
    assert high == pytest.approx(4 / 3 * np.pi * 1000, rel=5e-3)
    smaller, larger = _volumes(inner, 0.5, outer.vertices, 2.0, unbounded=False)
    assert smaller == pytest.approx(0.95**3 * low, rel=1e-3)
    assert high < larger < 1.1 * high
